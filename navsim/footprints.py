"""The footprints of many prisms as flat arrays, and exact distances to them.

Pure functions on arrays. A footprint is a *core* (a convex polygon, or the centre point of a cylinder) and a radius
around it (0, or the cylinder's). Distances are asked for pairs (query, prism), so that a caller prunes first, by
bounding boxes; each pair is then expanded into the edges of its prism.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from navsim.prism import Prism

PAIRS_A_CHUNK = 1_000_000
"""Pairs looked at in one go; it bounds the memory in use, to some tens of megabytes."""
ROUNDING = 1e-9
"""Metres: more than two ways to the same distance differ by."""


@dataclass(frozen=True, eq=False)
class Footprints:
    """``P`` footprints with ``E`` edges in all; the one edge of a cylinder has no length."""

    starts: np.ndarray
    """``(E, 2)``: where each edge begins, metres; the edges of one prism follow one another counter-clockwise."""
    ends: np.ndarray
    """``(E, 2)``: where each edge ends, metres."""
    first: np.ndarray
    """``(P,)``: the first edge of each prism."""
    count: np.ndarray
    """``(P,)``: the number of edges of each prism."""
    radius: np.ndarray
    """``(P,)``: metres around the core."""
    low: np.ndarray
    """``(P, 2)``: least x and y of each footprint, metres."""
    high: np.ndarray
    """``(P, 2)``: greatest x and y of each footprint, metres."""

    centre: np.ndarray
    """``(P, 2)``: a point inside each core, metres."""
    inner: np.ndarray
    """``(P,)``: radius of a disc around ``centre`` that the core holds, metres."""
    outer: np.ndarray
    """``(P,)``: radius of a disc around ``centre`` that holds the core, metres."""

    @classmethod
    def of(cls, prisms: Sequence[Prism]) -> Footprints:
        """The footprints of ``prisms``, in their order."""
        if not prisms:
            none, flat, index = np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.intp)
            return cls(none, none, index, index, flat, none, none, none, flat, flat)
        count = np.array([len(prism.vertices) for prism in prisms], dtype=np.intp)
        first = np.cumsum(count) - count
        starts = np.concatenate([prism.vertices for prism in prisms])
        following = np.arange(1, len(starts) + 1)
        following[first + count - 1] = first
        ends = starts[following]
        radius = np.array([prism.radius for prism in prisms])
        low = np.minimum.reduceat(starts, first) - radius[:, None]
        high = np.maximum.reduceat(starts, first) + radius[:, None]
        centre = np.add.reduceat(starts, first) / count[:, None]
        along, inwards = ends - starts, np.repeat(centre, count, axis=0) - starts
        from_edges = np.minimum.reduceat(_divide(_cross(along, inwards), np.sqrt(_dot(along, along))), first)
        outer = np.sqrt(np.maximum.reduceat(_dot(inwards, inwards), first))
        return cls(starts, ends, first, count, radius, low, high, centre, np.maximum(from_edges, 0.0), outer)

    def __len__(self) -> int:
        return len(self.count)

    def following(self, edge: np.ndarray) -> np.ndarray:
        """The edge ``(N,)`` that comes after each of ``edge`` around its core."""
        after = np.arange(1, len(self.starts) + 1)
        after[self.first + self.count - 1] = self.first
        return after[edge]

    def edges_of(self, prism: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The edges of each entry of ``prism`` ``(N,)``, one after the other.

        Returns:
            index of the edges ``(M,)``; the entry that each one belongs to ``(M,)``; each entry's first place ``(N,)``.
        """
        count = self.count[prism]
        begin = np.cumsum(count) - count
        entry = np.repeat(np.arange(len(prism)), count)
        return np.arange(len(entry)) + np.repeat(self.first[prism] - begin, count), entry, begin

    def point_distances(self, points: np.ndarray, prism: np.ndarray) -> np.ndarray:
        """Signed distance ``(N,)``, metres, from ``points[n]`` to the footprint ``prism[n]``: negative inside it."""
        if not len(points):
            return np.empty(0)
        edge, entry, begin = self.edges_of(prism)
        along, offset = self.ends[edge] - self.starts[edge], points[entry] - self.starts[edge]
        squared = _dot(along, along)
        gap = offset - _share(offset, along)[:, None] * along
        distance = np.sqrt(np.minimum.reduceat(_dot(gap, gap), begin))
        depth = np.where(squared > 0.0, _divide(_cross(along, offset), np.sqrt(squared)), -np.inf)
        depth = np.minimum.reduceat(depth, begin)
        return np.where(depth > 0.0, -depth, distance) - self.radius[prism]

    def nearest_on_core(self, points: np.ndarray, prism: np.ndarray) -> np.ndarray:
        """The point ``(N, 2)`` on the outline of the core ``prism[n]`` that is nearest to ``points[n]``."""
        edge, entry, begin = self.edges_of(prism)
        along, offset = self.ends[edge] - self.starts[edge], points[entry] - self.starts[edge]
        foot = self.starts[edge] + _share(offset, along)[:, None] * along
        gap = points[entry] - foot
        squared = _dot(gap, gap)
        is_nearest = squared == np.minimum.reduceat(squared, begin)[entry]
        nearest = np.empty((len(points), 2))
        nearest[entry[is_nearest]] = foot[is_nearest]
        return nearest

    def entry_shares(self, starts: np.ndarray, ends: np.ndarray, prism: np.ndarray) -> np.ndarray:
        """How far along the segment ``starts[n]``–``ends[n]`` it enters the core ``prism[n]``: ``(N,)``, in [0, 1].

        Infinite when it does not, and for cylinders. The method is Cyrus and Beck's (1978).
        """
        edge, entry, begin = self.edges_of(prism)
        corner, along = self.starts[edge], self.ends[edge] - self.starts[edge]
        at_start, at_end = _cross(along, starts[entry] - corner), _cross(along, ends[entry] - corner)
        crossing = _divide(at_start, at_start - at_end)
        enters = np.where(at_start < 0.0, np.where(at_end > at_start, crossing, np.inf), 0.0)
        leaves = np.where((at_start >= 0.0) & (at_end < 0.0), crossing, 1.0)
        enters, leaves = np.maximum.reduceat(enters, begin), np.minimum.reduceat(leaves, begin)
        return np.where((enters <= leaves) & (self.count[prism] > 1), enters, np.inf)

    def segment_distances(self, starts: np.ndarray, ends: np.ndarray, prism: np.ndarray) -> np.ndarray:
        """Distance ``(N,)``, metres, from the segment ``starts[n]``–``ends[n]`` to the footprint ``prism[n]``.

        Not positive where they meet.
        """
        if not len(starts):
            return np.empty(0)
        edge, entry, begin = self.edges_of(prism)
        segment, offset = (ends - starts)[entry], self.starts[edge] - starts[entry]
        gap = offset - _share(offset, segment)[:, None] * segment
        distance = np.sqrt(np.minimum.reduceat(_dot(gap, gap), begin)) - self.radius[prism]
        for points in (starts, ends):
            distance = np.minimum(distance, self.point_distances(points, prism))
        meets = np.isfinite(self.entry_shares(starts, ends, prism))
        return np.where(meets, np.minimum(distance, 0.0), distance)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance ``(K,)``, metres, from each of ``points`` to the nearest footprint, and its index ``(K,)``.

        Infinite, with the index −1, when there are no footprints. Inside several, the deepest one counts.
        """
        distance = np.full(len(points), np.inf)
        index = np.full(len(points), -1, dtype=np.intp)
        if not len(self):
            return distance, index
        chunk = max(1, PAIRS_A_CHUNK // len(self))
        for begin in range(0, len(points), chunk):
            part = points[begin : begin + chunk]
            outside = np.maximum(np.maximum(self.low - part[:, None], part[:, None] - self.high), 0.0)
            at_least = np.sqrt(_dot(outside, outside))
            towards = self.centre - part[:, None]
            at_most = np.sqrt(_dot(towards, towards)) - self.radius
            # Both bounds are exact for a lone cylinder beside the point: rounding must not put them in the wrong order.
            bound = at_most.min(axis=1, keepdims=True) + ROUNDING
            worth_it = (at_least <= bound) | (at_least == 0.0)
            query, prism = np.nonzero(worth_it)
            found = self.point_distances(part[query], prism)
            first = np.searchsorted(query, np.arange(len(part)))
            least = np.minimum.reduceat(found, first)
            distance[begin : begin + chunk] = least
            is_nearest = np.flatnonzero(found == least[query])
            index[begin + query[is_nearest]] = prism[is_nearest]
        return distance, index

    def points_keep_clear(self, points: np.ndarray, clear: np.ndarray) -> np.ndarray:
        """Whether each of ``points`` ``(N, 2)`` is at least ``clear[p]`` from each core ``p``: ``(N,)``.

        Args:
            points: metres.
            clear: ``(P,)``, metres, from the core: the footprint's own radius is not added.
        """
        keeps = np.ones(len(points), dtype=bool)
        reach = (clear - self.radius)[:, None]
        for point, prism in overlapping_boxes(points, points, self.low - reach, self.high + reach):
            distance = self.point_distances(points[point], prism) + self.radius[prism]
            keeps[point[distance < clear[prism]]] = False
        return keeps

    def segments_keep_clear(self, starts: np.ndarray, ends: np.ndarray, clear: np.ndarray) -> np.ndarray:
        """Whether each segment ``starts[n]``–``ends[n]`` stays at least ``clear[p]`` from each core ``p``: ``(N,)``.

        Args:
            starts: ``(N, 2)``, metres.
            ends: ``(N, 2)``, metres.
            clear: ``(P,)``, metres, from the core: the footprint's own radius is not added.
        """
        keeps = np.ones(len(starts), dtype=bool)
        length = np.sqrt(_dot(ends - starts, ends - starts))
        longest = float(length.max(initial=0.0))
        # Piece by piece from the start, so that a long segment that is soon blocked costs no more than a short one.
        pieces = 1 if not len(self) else min(100, max(1, math.ceil(longest / self._piece(clear))))
        share = np.divide(longest / pieces, length, out=np.ones_like(length), where=length > 0.0)
        for piece in range(pieces):
            alive = np.flatnonzero(keeps & ((piece == 0) | (piece * share < 1.0)))
            if not len(alive):
                break
            way = ends[alive] - starts[alive]
            begin, end = piece * share[alive, None], np.minimum((piece + 1) * share[alive, None], 1.0)
            here, there = starts[alive] + begin * way, starts[alive] + end * way
            keeps[alive] = self._short_segments_keep_clear(here, there, clear)
        return keeps

    def _piece(self, clear: np.ndarray) -> float:
        """A length, metres, of which most segments among many footprints meet one."""
        extents = np.ptp(np.concatenate([self.low, self.high]), axis=0)
        widths = 2.0 * float(np.sum(self.inner + clear))
        return max(float(np.prod(extents)) / widths, float(np.max(clear)))

    def _short_segments_keep_clear(self, starts: np.ndarray, ends: np.ndarray, clear: np.ndarray) -> np.ndarray:
        keeps = np.ones(len(starts), dtype=bool)
        reach = (clear - self.radius)[:, None]
        low, high = np.minimum(starts, ends), np.maximum(starts, ends)
        for segment, prism in overlapping_boxes(low, high, self.low - reach, self.high + reach):
            undecided = keeps[segment]
            segment, prism = segment[undecided], prism[undecided]
            # Most pairs are decided by the discs inside and around a core; only the rest needs its edges.
            begin, way = starts[segment], ends[segment] - starts[segment]
            offset = self.centre[prism] - begin
            gap = offset - _share(offset, way)[:, None] * way
            distance = np.sqrt(_dot(gap, gap))
            keeps[segment[distance < self.inner[prism] + clear[prism]]] = False
            unclear = keeps[segment] & (distance < self.outer[prism] + clear[prism])
            segment, prism = segment[unclear], prism[unclear]
            distance = self.segment_distances(starts[segment], ends[segment], prism) + self.radius[prism]
            keeps[segment[distance < clear[prism]]] = False
        return keeps


def overlapping_boxes(
    low: np.ndarray, high: np.ndarray, other_low: np.ndarray, other_high: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every pair of a box and another box that overlap or touch, in chunks of two index arrays.

    The other boxes are taken size by size, so that a large one does not slow down the search for small ones, and
    sorted into rows of about their height and by x within a row. The cost follows the number of pairs that come near.

    Args:
        low: ``(N, 2)``, least x and y of each box.
        high: ``(N, 2)``, greatest x and y.
        other_low: ``(M, 2)``, the same of the other boxes.
        other_high: ``(M, 2)``.
    """
    extent = (other_high - other_low).max(axis=1, initial=0.0)
    doublings = np.frexp(extent)[1]
    for doubling in np.unique(doublings):
        others = np.flatnonzero(doublings == doubling)
        for boxes, within in _near_in_rows(low, high, other_low[others], extent[others].max()):
            near = others[within]
            overlap = (low[boxes] <= other_high[near]) & (high[boxes] >= other_low[near])
            overlap = overlap[:, 0] & overlap[:, 1]
            yield boxes[overlap], near[overlap]


def _near_in_rows(
    low: np.ndarray, high: np.ndarray, corner: np.ndarray, extent: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of boxes with other boxes, of ``corner`` ``(M, 2)`` and at most ``extent``, that may overlap them."""
    origin, span = corner.min(axis=0), np.ptp(corner, axis=0)
    height = max(extent, span[1] / math.sqrt(len(corner))) or 1.0
    # A row and an x in it become one number; the slack makes up for what that number rounds off.
    stride = 2.0 * (span[0] + extent) + 1.0
    slack = 1e-9 * (stride * (span[1] / height + 1.0) + extent + np.abs(corner).max())
    place = np.floor((corner[:, 1] - origin[1]) / height) * stride + (corner[:, 0] - origin[0])
    order = np.argsort(place)
    place = place[order]
    left = np.clip(low[:, 0] - origin[0] - extent - slack, -0.5 * extent - slack, span[0] + extent)
    right = np.clip(high[:, 0] - origin[0] + slack, -0.5 * extent - slack, span[0] + extent)
    first = np.floor(np.clip((low[:, 1] - origin[1] - extent - slack) / height, -1.0, span[1] / height + 1.0))
    last = np.floor(np.clip((high[:, 1] - origin[1] + slack) / height, -1.0, span[1] / height + 1.0))
    for boxes, rows in _ranges(first, (last - first + 1.0).astype(np.intp)):
        begin = np.searchsorted(place, rows * stride + left[boxes], side="left")
        end = np.searchsorted(place, rows * stride + right[boxes], side="right")
        for within, others in _ranges(begin, np.maximum(end - begin, 0)):
            yield boxes[within], order[others.astype(np.intp)]


def _ranges(begin: np.ndarray, count: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each index ``n`` with each of ``begin[n], …, begin[n] + count[n] - 1``, in chunks of two arrays."""
    total = np.cumsum(count)
    done = 0
    while done < len(count):
        before = int(total[done - 1]) if done else 0
        upto = max(done + 1, int(np.searchsorted(total, before + PAIRS_A_CHUNK, side="right")))
        index = np.repeat(np.arange(done, upto), count[done:upto])
        place = np.arange(before, before + len(index)) - (total - count)[index]
        yield index, begin[index] + place
        done = upto


def _share(offset: np.ndarray, along: np.ndarray) -> np.ndarray:
    """How far along a segment, in [0, 1], its point nearest to a point is that lies ``offset`` from its start."""
    return np.clip(_divide(_dot(along, offset), _dot(along, along)), 0.0, 1.0)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a / b``, and 0 where ``b`` is 0."""
    return np.divide(a, b, out=np.zeros_like(a), where=b != 0.0)
