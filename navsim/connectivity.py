"""Which places of a room are connected, exactly and without a grid.

A disc-shaped robot passes between two obstacles when they are at least its diameter apart. Link every two obstacles
that are closer than that: two places are cut off from each other exactly when some closed chain of links runs around
one of them and not around the other (Janiszewski's theorem, applied to the obstacles grown by the robot's radius).
A chain runs around a place when it crosses a ray from there an odd number of times, and looking at one basis of the
closed chains, the links outside a spanning forest, is enough.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from navsim.footprints import Footprints, overlapping_boxes
from navsim.view import expand

TOLERANCE = 1e-9
"""Metres: a gap that is this much too narrow is wide enough."""
COMPARED_WITH_ALL = 128
"""Footprints up to which every two are compared at once: looking for neighbours first would take longer."""
CROSSINGS_A_CHUNK = 1_000_000
"""Pairs of a ray and a link looked at in one go; it bounds the memory in use."""


class Chains:
    """The links between obstacles that are too close for a robot to pass between them, ready for many questions.

    Args:
        footprints: obstacles, and whatever else bounds the places that the robot's centre may take.
        robot_radius: metres.
    """

    def __init__(self, footprints: Footprints, robot_radius: float) -> None:
        first, second, knee = _links(footprints, robot_radius)
        corners = np.stack([footprints.centre[first], knee, footprints.centre[second]], axis=1)
        keys = _keys(len(footprints), first, second)
        matters = keys != 0  # a link of no closed chain surrounds nothing
        self._corners, self._keys = corners[matters], keys[matters]
        self._top = self._corners[:, :, 1].max(axis=1)
        self._columns = _Columns(self._corners[:, :, 0])

    def regions(self, points: np.ndarray) -> np.ndarray:
        """A number ``(K,)`` for each of ``points`` ``(K, 2)``, free places of the robot's centre, metres.

        Places with equal numbers are connected, others are not.
        """
        if not len(points) or not len(self._keys):
            return np.zeros(len(points), dtype=np.intp)
        seen = np.zeros(len(points), dtype=np.uint64)
        for point, link in self._columns.lookup(points[:, 0]):
            below = np.flatnonzero(points[point, 1] < self._top[link])
            point, link = point[below], link[below]
            crossed = _is_crossed(self._corners[link], points[point])
            point, link = point[crossed], link[crossed]
            begin = np.flatnonzero(np.diff(point, prepend=-1))
            if len(point):
                seen[point[begin]] = np.bitwise_xor.reduceat(self._keys[link], begin)
        return np.unique(seen, return_inverse=True)[1].reshape(-1)


class _Columns:
    """Which of many ranges of x hold a given x: the plane is cut into columns of about their width.

    Args:
        x: ``(L, C)``, metres; a range reaches from the least to the greatest x of its row.
    """

    _MOST = 4096  # columns

    def __init__(self, x: np.ndarray) -> None:
        low, high = self._low, self._high = x.min(axis=1), x.max(axis=1)
        self._origin = float(low.min(initial=0.0))
        span = float(high.max(initial=0.0)) - self._origin
        width = float(np.median(high - low)) if len(x) else 1.0
        self._width = max(width, span / self._MOST, 1e-9)
        first = self._column_of(low)
        span_of = self._column_of(high) - first + 1
        owner, inside = expand(span_of)
        column = first[owner] + inside
        self._links = owner[np.argsort(column, kind="stable")]
        count = np.bincount(column, minlength=self._column_of(np.array([self._origin + span]))[0] + 1)
        self._begin = np.concatenate([[0], np.cumsum(count)])

    def _column_of(self, x: np.ndarray) -> np.ndarray:
        return ((x - self._origin) / self._width).astype(np.intp)

    def lookup(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of an index into ``x`` ``(K,)`` and a range with ``low <= x < high``, ordered by the former."""
        inside = np.flatnonzero((x >= self._origin) & (x < self._origin + self._width * (len(self._begin) - 1)))
        column = self._column_of(x[inside])
        begin, count = self._begin[column], self._begin[column + 1] - self._begin[column]
        total = np.cumsum(count)
        done = 0
        while done < len(inside):
            before = int(total[done - 1]) if done else 0
            upto = max(done + 1, int(np.searchsorted(total, before + CROSSINGS_A_CHUNK, side="right")))
            owner, step = expand(count[done:upto])
            owner += done
            index, link = inside[owner], self._links[begin[owner] + step]
            within = np.flatnonzero((self._low[link] <= x[index]) & (x[index] < self._high[link]))
            yield index[within], link[within]
            done = upto


def _keys(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """A key ``(L,)`` uint64 for each link between ``count`` obstacles, so that what surrounds a point can be summed.

    Each closed chain of the basis gets 64 random bits, and each link the exclusive or of those of all chains that it
    is a part of. The exclusive or of the links that a ray from a point crosses is then that of the chains that it
    crosses an odd number of times: of those that run around the point. Points that are not surrounded by the same
    chains differ in it, but for a chance of 2^-64. (Zobrist 1970 did the same with positions of board games.)
    """
    parent, generations, closing = _spanning_forest(count, first, second)
    keys = np.zeros(len(first), dtype=np.uint64)
    keys[closing] = np.random.default_rng(0).integers(2**64, size=len(closing), dtype=np.uint64)
    below = np.zeros(count, dtype=np.uint64)
    for ends in (first[closing], second[closing]):
        np.bitwise_xor.at(below, ends, keys[closing])
    for nodes, links in reversed(generations):
        keys[links] = below[nodes]
        np.bitwise_xor.at(below, parent[nodes], below[nodes])
    return keys


def _links(footprints: Footprints, robot_radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of footprints ``(L,)``, ``(L,)`` less than the robot's diameter apart, and a point between them ``(L, 2)``.

    The point lies within the robot's radius of both.
    """
    low, high = footprints.low - robot_radius, footprints.high + robot_radius
    grown = footprints.radius + robot_radius
    links = [(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty((0, 2)))]
    for first, second in _neighbours(low, high):
        on_first, on_second = _nearest_points(footprints, first, second)
        distance = np.linalg.norm(on_second - on_first, axis=1)
        share = grown[first] / (grown[first] + grown[second])
        is_close = distance < grown[first] + grown[second] - TOLERANCE
        knee = on_first + share[:, None] * (on_second - on_first)
        links.append((first[is_close], second[is_close], knee[is_close]))
    first, second, knee = (np.concatenate(parts) for parts in zip(*links, strict=True))
    return first, second, knee


def _neighbours(low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every two boxes that overlap or touch, the earlier one first, in chunks of two index arrays."""
    if len(low) <= COMPARED_WITH_ALL:
        overlap = (low[:, None] <= high) & (high[:, None] >= low)
        first, second = np.nonzero(np.triu(overlap.all(axis=2), 1))
        yield first, second
        return
    for first, second in overlapping_boxes(low, high, low, high):
        yield first[first < second], second[first < second]


def _nearest_points(footprints: Footprints, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each pair of footprints, the point of each core ``(N, 2)`` that is nearest to the other core.

    The same point twice for cores that meet.
    """
    nearest = np.full((2, len(first), 2), np.nan)
    least = np.full(len(first), np.inf)
    for here, there, side in ((first, second, 0), (second, first, 1)):
        if not len(here):
            continue
        edge, entry, begin = footprints.edges_of(here)
        starts, ends, other = footprints.starts[edge], footprints.ends[edge], there[entry]
        share = footprints.entry_shares(starts, ends, other)
        meets = np.isfinite(share)
        on_here = np.where(meets[:, None], starts + np.where(meets, share, 0.0)[:, None] * (ends - starts), starts)
        on_there = np.where(meets[:, None], on_here, footprints.nearest_on_core(starts, other))
        distance = np.linalg.norm(on_there - on_here, axis=1)
        best = np.minimum.reduceat(distance, begin)
        is_best = (distance == best[entry]) & (distance < least[entry])
        nearest[side, entry[is_best]] = on_here[is_best]
        nearest[1 - side, entry[is_best]] = on_there[is_best]
        least = np.minimum(least, best)
    return nearest[0], nearest[1]


def _spanning_forest(
    count: int, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """A spanning forest of the graph of ``count`` nodes with the edges ``first[l]``–``second[l]``.

    Returns:
        each node's parent, ``(count,)``, meaningless for roots;
        generation by generation from the roots' children on, nodes and the edges that lead to their parents;
        the edges that are not in the forest.
    """
    weights = np.ones(len(first))
    graph = coo_array((weights, (first, second)), shape=(count, count)).tocsr()
    components, component = connected_components(graph, directed=False)
    roots = np.full(components, -1)
    roots[component[::-1]] = np.arange(count)[::-1]
    generation, parent, _ = dijkstra(
        graph, directed=False, indices=roots, unweighted=True, min_only=True, return_predecessors=True
    )
    second_is_child, first_is_child = parent[second] == first, parent[first] == second
    in_forest = np.flatnonzero(second_is_child | first_is_child)
    child = np.where(second_is_child, second, first)[in_forest]
    order = np.argsort(generation[child], kind="stable")
    bounds = np.flatnonzero(np.diff(generation[child[order]])) + 1
    generations = [(child[part], in_forest[part]) for part in np.split(order, bounds) if len(part)]
    return parent, generations, np.flatnonzero(~(second_is_child | first_is_child))


def _is_crossed(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether a ray from each point towards +y crosses its own chain of corners an odd number of times: ``(N,)``.

    Args:
        corners: ``(N, C, 2)``; none of their lines runs through the point.
        points: ``(N, 2)``.
    """
    x, y = points.T
    odd = np.zeros(len(points), dtype=bool)
    is_left = corners[:, :, 0] <= x[:, None]
    for c in range(corners.shape[1] - 1):
        straddling = np.flatnonzero(is_left[:, c] != is_left[:, c + 1])
        (ax, ay), (bx, by) = corners[straddling, c].T, corners[straddling, c + 1].T
        odd[straddling] ^= ay + (x[straddling] - ax) / (bx - ax) * (by - ay) > y[straddling]
    return odd
