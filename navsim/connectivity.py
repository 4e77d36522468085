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

TOLERANCE = 1e-9
"""Metres: a gap that is this much too narrow is wide enough."""
COMPARED_WITH_ALL = 128
"""Footprints up to which every two are compared at once: looking for neighbours first would take longer."""
CROSSINGS_A_CHUNK = 4_000_000
"""Rays against links looked at in one go; it bounds the memory in use."""


class Chains:
    """The links between obstacles that are too close for a robot to pass between them, ready for many questions.

    Args:
        footprints: obstacles, and whatever else bounds the places that the robot's centre may take.
        robot_radius: metres.
    """

    def __init__(self, footprints: Footprints, robot_radius: float) -> None:
        first, second, knee = _links(footprints, robot_radius)
        self._corners = np.stack([footprints.centre[first], knee, footprints.centre[second]], axis=1)
        self._first, self._second = first, second
        self._parent, self._generations, self._closing = _spanning_forest(len(footprints), first, second)

    def regions(self, points: np.ndarray) -> np.ndarray:
        """A number ``(K,)`` for each of ``points`` ``(K, 2)``, free places of the robot's centre, metres.

        Places with equal numbers are connected, others are not.
        """
        if not len(points) or not len(self._closing):
            return np.zeros(len(points), dtype=np.intp)
        chunk = max(1, CROSSINGS_A_CHUNK // len(self._first))
        surrounded = [self._surrounded(points[i : i + chunk]) for i in range(0, len(points), chunk)]
        return np.unique(np.concatenate(surrounded), axis=0, return_inverse=True)[1].reshape(-1)

    def _surrounded(self, points: np.ndarray) -> np.ndarray:
        """Whether each closed chain of the basis runs around each point: packed bits, a row for each point."""
        crossed = _is_crossed(self._corners, points)
        parity = np.zeros((len(self._parent), len(points)), dtype=bool)
        for nodes, links in self._generations:
            parity[nodes] = parity[self._parent[nodes]] ^ crossed[links]
        closing = self._closing
        around = parity[self._first[closing]] ^ parity[self._second[closing]] ^ crossed[closing]
        return np.packbits(around, axis=0).T


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
    """Whether a ray from each point towards +y crosses each chain of corners an odd number of times: ``(L, K)``.

    Args:
        corners: ``(L, C, 2)``; none of their lines runs through a point.
        points: ``(K, 2)``.
    """
    x, y = points[:, 0], points[:, 1]
    odd = np.zeros((len(corners), len(points)), dtype=bool)
    is_left = corners[:, :, 0, None] <= x
    for c in range(corners.shape[1] - 1):
        straddling = np.nonzero(is_left[:, c] != is_left[:, c + 1])
        (ax, ay), (bx, by) = corners[straddling[0], c].T, corners[straddling[0], c + 1].T
        above = ay + (x[straddling[1]] - ax) / (bx - ax) * (by - ay) > y[straddling[1]]
        odd[straddling[0][above], straddling[1][above]] ^= True
    return odd
