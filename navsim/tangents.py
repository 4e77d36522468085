"""Exact shortest paths of a disc-shaped robot among footprints.

Grow every footprint by the robot's radius: its outline becomes arcs (around the corners of a polygon, around the centre
of a cylinder) and straight lines. The shortest path of the robot's centre then consists of arcs and of segments that
are tangent to them, so it is a path in the *tangent graph* (Liu and Arimoto, "Path planning using a tangent graph for
mobile robots among polygonal and curved obstacles", 1992). Its nodes are points of contact, each with a direction of
travel around its arc; Dijkstra's algorithm finds the shortest path in it.

Plane vectors are complex numbers here: a turn is a product.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from navsim.footprints import Footprints, overlapping_boxes

TOLERANCE = 1e-7
"""Metres and radians: contact and clearance are judged with this slack."""
ARC_STEP = math.radians(3.0)
"""Between the points that stand for an arc in a polyline; their chords cut a 0.2 m corner by less than 0.1 mm."""
PAIRS_A_CHUNK = 200_000
"""Pairs of discs looked at in one go; it bounds the memory in use."""
FULL_TURN = 2.0 * math.pi
PLACES = 8.0
"""More than a full turn."""


class _Discs(NamedTuple):
    """The arcs of the grown outlines, as the discs that they belong to; a plain point is a disc without radius."""

    centre: np.ndarray
    """``(D,)`` complex, metres."""
    radius: np.ndarray
    """``(D,)``, metres."""
    sides: np.ndarray
    """``(2, D)`` complex: from a polygon's corner to the one before and the one after it; 0 for cylinders, points."""

    @classmethod
    def around(cls, footprints: Footprints, robot_radius: float) -> _Discs:
        corner, following = _complex(footprints.starts), _complex(footprints.ends)
        sides = np.stack([np.empty_like(corner), following - corner])
        sides[0, footprints.following(np.arange(len(corner)))] = corner - following
        radius = np.repeat(footprints.radius, footprints.count) + robot_radius
        return cls(corner, radius, sides)

    def with_points(self, points: np.ndarray) -> _Discs:
        zero = np.zeros(len(points))
        return _Discs(
            np.concatenate([self.centre, points]),
            np.concatenate([self.radius, zero]),
            np.concatenate([self.sides, np.stack([zero, zero])], axis=1),
        )


class _Segments(NamedTuple):
    """``M`` directed segments between discs; a side is +1 where the path keeps the disc on its left, else −1."""

    tail: np.ndarray
    """``(M,)``: index of the disc that the segment leaves."""
    head: np.ndarray
    """``(M,)``: index of the disc that it arrives at."""
    tail_side: np.ndarray
    head_side: np.ndarray
    begin: np.ndarray
    """``(M,)`` complex, metres."""
    end: np.ndarray
    """``(M,)`` complex, metres."""

    @classmethod
    def none(cls) -> _Segments:
        index, point = np.empty(0, dtype=np.intp), np.empty(0, dtype=complex)
        return cls(index, index, index, index, point, point)

    def reversed(self) -> _Segments:
        return _Segments(self.head, self.tail, -self.head_side, -self.tail_side, self.end, self.begin)

    def where(self, keep: np.ndarray) -> _Segments:
        return _Segments(*(column[keep] for column in self))


class TangentGraph:
    """The tangent graph of a robot among footprints, ready for many starts and goals.

    Args:
        footprints: the obstacles.
        robot_radius: metres.
        half_extents: ``(2,)``, metres: the robot's centre stays in the rectangle of twice these around the origin.
        reach: metres: tangents join places no further apart than this along x and y. Paths are exact when that is
            infinite; else the graph is smaller, and may lack the long sight lines that a shorter path would take.
    """

    def __init__(
        self, footprints: Footprints, robot_radius: float, half_extents: np.ndarray, reach: float = math.inf
    ) -> None:
        self._footprints = footprints
        self._half_extents = half_extents
        self._reach = reach
        self._grown = footprints.radius + robot_radius
        self._discs = _Discs.around(footprints, robot_radius)
        self._knots, self._blocked = self._blocked_arcs()
        forward = self._free_segments(self._discs, *self._corner_pairs())
        self._segments = _joined(forward, forward.reversed())

    def shortest_path(self, start: complex, goal: complex, goal_radius: float) -> tuple[float, np.ndarray]:
        """The shortest way from ``start`` to the disc of ``goal_radius``, metres, around ``goal``.

        Returns:
            its length, metres, and its corners ``(K,)``, complex, with arcs as short chords; infinite and empty when
            there is none.
        """
        first = len(self._discs.centre)
        ends = np.append(self.ends_beside_obstacles(goal, goal_radius), goal)
        discs = self._discs.with_points(np.append(start, ends))
        last = first + len(ends)
        near_start, points = self._corners_near(start), np.arange(first + 1, last + 1)
        leaving = np.append(near_start, points)
        begin = self._free_segments(discs, np.full(len(leaving), first), leaving, (last, goal_radius))
        near_goal = self._corners_near(goal)
        tail, head = np.repeat(near_goal, len(points)), np.tile(points, len(near_goal))
        end = self._free_segments(discs, tail, head, (last, goal_radius))
        segments = _joined(self._segments, begin, end)
        length, nodes = _search(segments, self._arcs(discs, segments), first)
        return length, _polyline(discs, segments, nodes)

    def ends_beside_obstacles(self, goal: complex, goal_radius: float) -> np.ndarray:
        """Where the goal's circle meets the outline of the free space, ``(K,)``: a path may end there, at a slant."""
        if goal_radius == 0.0:
            return np.empty(0, dtype=complex)
        _, angles = self._outline_angles(np.array([goal]), np.array([goal_radius]))
        ends = goal + goal_radius * np.exp(1j * angles)
        return ends[self._is_free(ends)]

    def _corners_near(self, point: complex) -> np.ndarray:
        """The discs to look for tangents through ``point``, ``(N,)``."""
        away = self._discs.centre - point
        return np.flatnonzero(np.maximum(np.abs(away.real), np.abs(away.imag)) <= self._reach)

    def _is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot fits at each of ``points`` ``(K,)``: ``(K,)``."""
        points = _plane(points)
        inside = (np.abs(points) <= self._half_extents + TOLERANCE).all(axis=1)
        return inside & self._footprints.points_keep_clear(points, self._grown - TOLERANCE)

    def _corner_pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """The pairs of discs to look for tangents between, ``(N,)`` and ``(N,)``."""
        footprints, count = self._footprints, len(self._discs.centre)
        if self._reach == math.inf or not count:
            return np.triu_indices(count, 1)
        low, high = footprints.starts - 0.5 * self._reach, footprints.starts + 0.5 * self._reach
        tails, heads = zip(*overlapping_boxes(low, high, low, high), strict=True)
        tail, head = np.concatenate(tails), np.concatenate(heads)
        near = tail < head
        # However long a side of an obstacle is, a path may lead along it.
        every = np.arange(count)
        return np.append(tail[near], every), np.append(head[near], footprints.following(every))

    def _free_segments(
        self, discs: _Discs, tail: np.ndarray, head: np.ndarray, goal: tuple[int, float] | None = None
    ) -> _Segments:
        """The tangents of pairs of discs along which the robot passes.

        Args:
            discs: all discs.
            tail: ``(N,)``, where the segments begin.
            head: ``(N,)``, where they end.
            goal: a disc, and how far from its centre the segments that lead to it may end, metres.
        """
        found = [_Segments.none()]
        for begin in range(0, len(tail), PAIRS_A_CHUNK):
            part = slice(begin, begin + PAIRS_A_CHUNK)
            segments = _tangents(discs, tail[part], head[part])
            if goal is not None:
                segments = _cut_short(segments, *goal)
            points = np.abs(_plane(np.stack([segments.begin, segments.end])))
            segments = segments.where((points <= self._half_extents + TOLERANCE).all(axis=(0, 2)))
            clear = self._grown - TOLERANCE
            free = self._footprints.segments_keep_clear(_plane(segments.begin), _plane(segments.end), clear)
            found.append(segments.where(free))
        return _joined(*found)

    def _outline_angles(self, centre: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where circles may cross the outline of the free space: every such place, and others.

        Args:
            centre: ``(C,)``, metres.
            radius: ``(C,)``, metres.

        Returns:
            indices of circles ``(N,)`` and angles ``(N,)``, radians.
        """
        around = np.stack([radius, radius], axis=1)
        grown = (self._grown - self._footprints.radius)[:, None]
        circles, angles = [], []

        def add(circle: np.ndarray, middle: np.ndarray, cosine: np.ndarray) -> None:
            meets = np.abs(cosine) <= 1.0 + TOLERANCE
            half = np.arccos(np.clip(cosine[meets], -1.0, 1.0))
            circles.extend([circle[meets], circle[meets]])
            angles.extend([np.angle(middle[meets]) - half, np.angle(middle[meets]) + half])

        low, high = self._footprints.low - grown, self._footprints.high + grown
        for circle, prism in overlapping_boxes(_plane(centre) - around, _plane(centre) + around, low, high):
            edge, entry, _ = self._footprints.edges_of(prism)
            circle, clear = circle[entry], self._grown[prism[entry]]
            corner = _complex(self._footprints.starts[edge]) - centre[circle]
            along = _complex(self._footprints.ends[edge]) - _complex(self._footprints.starts[edge])
            distance, length = np.abs(corner), np.abs(along)
            apart = distance > TOLERANCE
            own = radius[circle[apart]]
            cosine = (own**2 + distance[apart] ** 2 - clear[apart] ** 2) / (2.0 * own * distance[apart])
            add(circle[apart], corner[apart], cosine)
            straight = length > 0.0
            outward = -1j * along[straight] / length[straight]
            cosine = (clear[straight] + _dot(outward, corner[straight])) / radius[circle[straight]]
            add(circle[straight], outward, cosine)
        for side, extent in ((1.0, 0), (1j, 1), (-1.0, 0), (-1j, 1)):
            outward = np.full(len(centre), side, dtype=complex)
            add(np.arange(len(centre)), outward, (self._half_extents[extent] - _dot(outward, centre)) / radius)
        return np.concatenate(circles), np.concatenate(angles)

    def _blocked_arcs(self) -> tuple[np.ndarray, np.ndarray]:
        """How much of each disc's circle is blocked between angle 0 and any other, as the corners of a polygonal line.

        Returns:
            places of the corners, as :func:`_place` gives them, in ascending order, and radians blocked before each.
        """
        centre, radius = self._discs.centre, self._discs.radius
        if not len(centre):
            return np.zeros(1), np.zeros(1)
        disc, angle = self._outline_angles(centre, radius)
        every = np.arange(len(centre))
        disc = np.concatenate([disc, every, every])
        angle = np.concatenate([angle % FULL_TURN, np.zeros(len(every)), np.full(len(every), FULL_TURN)])
        place = np.sort(_place(disc, angle))
        disc = (place // PLACES).astype(np.intp)
        width = np.where(disc[1:] == disc[:-1], np.diff(place), 0.0)
        middle = 0.5 * (place[1:] + place[:-1]) - PLACES * disc[:-1]
        blocked = ~self._is_free(centre[disc[:-1]] + radius[disc[:-1]] * np.exp(1j * middle))
        return place, np.append(0.0, np.cumsum(np.where(blocked, width, 0.0)))

    def _arcs(self, discs: _Discs, segments: _Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The free arcs between neighbouring points of contact, in the direction of travel.

        Nodes are numbered as in :func:`_search`.

        Returns:
            nodes where arcs begin ``(A,)`` and end ``(A,)``, and lengths ``(A,)``, metres.
        """
        disc = np.append(segments.tail, segments.head)
        side = np.append(segments.tail_side, segments.head_side)
        contact = np.append(segments.begin, segments.end)
        nodes = np.flatnonzero(discs.radius[disc] > 0.0)
        disc, side = disc[nodes], side[nodes]
        angle = np.angle(contact[nodes] - discs.centre[disc]) % FULL_TURN
        ring, travelled = 2 * disc + (side < 0), np.where(side < 0, FULL_TURN - angle, angle)
        order = np.lexsort((travelled, ring))
        nodes, disc, angle, ring, travelled = (column[order] for column in (nodes, disc, angle, ring, travelled))
        following = np.arange(1, len(nodes) + 1)
        starts_ring = np.flatnonzero(np.append(True, ring[1:] != ring[:-1])) if len(ring) else following
        is_last = np.append(ring[1:] != ring[:-1], True) if len(ring) else following.astype(bool)
        following[is_last] = starts_ring
        turn = (travelled[following] - travelled) % FULL_TURN
        before = np.interp(_place(disc, angle), self._knots, self._blocked)
        whole = np.interp(_place(disc, np.full(len(disc), FULL_TURN)), self._knots, self._blocked)
        whole -= np.interp(_place(disc, np.zeros(len(disc))), self._knots, self._blocked)
        between = np.abs(before[following] - before)
        free = np.where(is_last, whole - between, between) <= TOLERANCE
        length = discs.radius[disc] * turn
        same = free & (turn < TOLERANCE)  # one point of contact in two roundings: travel both ways
        return (
            np.append(nodes[free], nodes[following][same]),
            np.append(nodes[following][free], nodes[same]),
            np.append(length[free], length[same]),
        )


def _tangents(discs: _Discs, tail: np.ndarray, head: np.ndarray) -> _Segments:
    """The segments from disc ``tail[n]`` to disc ``head[n]`` that touch both, and leave both polygons on one side."""
    towards = discs.centre[head] - discs.centre[tail]
    distance = np.abs(towards)
    found = [_Segments.none()]
    for tail_side in (1, -1):
        for head_side in (1, -1):
            rise = head_side * discs.radius[head] - tail_side * discs.radius[tail]
            exists = (distance >= np.abs(rise) - TOLERANCE) & (distance > 0.0)
            exists &= (tail_side > 0) | (discs.radius[tail] > 0.0)
            exists &= (head_side > 0) | (discs.radius[head] > 0.0)
            run = np.sqrt(np.maximum(distance[exists] ** 2 - rise[exists] ** 2, 0.0))
            direction = towards[exists] / (run + 1j * rise[exists])
            left = 1j * direction / np.abs(direction)
            t, h = tail[exists], head[exists]
            beside_tail = tail_side * _dot(left, discs.sides[:, t]) >= -TOLERANCE
            beside_head = head_side * _dot(left, discs.sides[:, h]) >= -TOLERANCE
            segments = _Segments(
                t,
                h,
                np.full(len(t), tail_side),
                np.full(len(h), head_side),
                discs.centre[t] - tail_side * discs.radius[t] * left,
                discs.centre[h] - head_side * discs.radius[h] * left,
            )
            found.append(segments.where(np.logical_and.reduce(np.concatenate([beside_tail, beside_head]))))
    return _joined(*found)


def _cut_short(segments: _Segments, goal: int, goal_radius: float) -> _Segments:
    """``segments``, with those that lead to ``goal`` cut off where they reach its disc of ``goal_radius``."""
    way = segments.end - segments.begin
    length = np.abs(way)
    cut = np.where(segments.head == goal, goal_radius, 0.0)
    ends = segments.end - cut * np.divide(way, length, out=np.zeros_like(way), where=length > 0.0)
    return segments._replace(end=ends).where(np.asarray(length >= cut))


def _search(
    segments: _Segments, arcs: tuple[np.ndarray, np.ndarray, np.ndarray], start: int
) -> tuple[float, list[int]]:
    """The shortest way from the point ``start`` to any point with a higher index.

    Node ``m`` is the beginning of segment ``m`` of ``M``, node ``M + m`` its end.

    Returns:
        its length, metres, and the nodes on it; infinite and empty when there is none.
    """
    count = len(segments.tail)
    origin, goal = 2 * count, 2 * count + 1
    leaving, arriving = np.flatnonzero(segments.tail == start), np.flatnonzero(segments.head > start)
    rows = np.concatenate([np.arange(count), arcs[0], np.full(len(leaving), origin), count + arriving])
    columns = np.concatenate([count + np.arange(count), arcs[1], leaving, np.full(len(arriving), goal)])
    lengths = np.abs(segments.end - segments.begin)
    weights = np.concatenate([lengths, arcs[2], np.zeros(len(leaving) + len(arriving))])
    order = np.argsort(rows, kind="stable")
    pointers = np.append(0, np.cumsum(np.bincount(rows, minlength=goal + 1)))
    graph = csr_array((weights[order], columns[order], pointers), shape=(goal + 1, goal + 1))
    distance, predecessor = dijkstra(graph, indices=origin, return_predecessors=True)
    if not np.isfinite(distance[goal]):
        return math.inf, []
    nodes = [int(predecessor[goal])]
    while predecessor[nodes[-1]] != origin:
        nodes.append(int(predecessor[nodes[-1]]))
    return float(distance[goal]), nodes[::-1]


def _polyline(discs: _Discs, segments: _Segments, nodes: list[int]) -> np.ndarray:
    """The corners of the way along ``nodes``, ``(K,)``, with arcs as chords."""
    count = len(segments.tail)
    contact = np.append(segments.begin, segments.end)
    disc = np.append(segments.tail, segments.head)
    side = np.append(segments.tail_side, segments.head_side)
    pieces = [contact[nodes[:1]]]
    for here, there in itertools.pairwise(nodes):
        if there != here + count:
            centre = discs.centre[disc[here]]
            turn = side[here] * np.angle((contact[there] - centre) / (contact[here] - centre)) % FULL_TURN
            steps = np.arange(1, math.ceil(turn / ARC_STEP) if turn < FULL_TURN - TOLERANCE else 1) * ARC_STEP
            pieces.append(centre + (contact[here] - centre) * np.exp(1j * side[here] * steps))
        pieces.append(contact[[there]])
    corners = np.concatenate(pieces)
    return corners[np.append(True, np.abs(np.diff(corners)) > TOLERANCE)] if len(corners) else corners


def _joined(*several: _Segments) -> _Segments:
    return _Segments(*(np.concatenate(columns) for columns in zip(*several, strict=True)))


def _place(disc: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """One number for a place on one of many circles: ``angle``, in [0, 2π], on circle ``disc``."""
    return PLACES * disc + angle


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a.real * b.real + a.imag * b.imag


def _complex(points: np.ndarray) -> np.ndarray:
    return points[..., 0] + 1j * points[..., 1]


def _plane(points: np.ndarray) -> np.ndarray:
    return np.stack([points.real, points.imag], axis=-1)
