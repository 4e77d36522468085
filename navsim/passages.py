"""The narrowest passage on the widest way between two places of a room, exactly and without a grid.

Every two obstacles are linked across the gap between them. Links are taken from the narrowest gap on: as soon as a
closed chain of links runs around one place and not around another, every way between the two crosses one of them, and
the last link taken is the gap that the widest way squeezes through. This is the maximin path of robotics and network
theory (Hu 1961), found in its dual: Kruskal's algorithm (1956) over the gaps, with the parity of each chain's
crossings of a ray from each place kept as potentials of the union-find structure.

What surrounds a place itself does not count: a goal close to a wall is not behind a passage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navsim.connectivity import _nearest_points as nearest_points
from navsim.footprints import Footprints, overlapping_boxes
from navsim.planner import OPEN_FLOOR_MARGIN, free_space
from navsim.prism import Prism
from navsim.robot import TURTLEBOT2

if TYPE_CHECKING:
    from navsim.world import World

LINKED_WITH_ALL = 300
"""Prisms up to which the gaps between all of them are looked at."""
WIDEST_GAP = 1.5
"""Metres: in larger worlds, gaps that are wider count as open floor."""


class Passage(NamedTuple):
    """The narrowest place on the widest way."""

    width: float
    """Metres; infinite where no gap that was looked at lies on the way."""
    sides: tuple[str, str] = ("", "")
    """What stands on its two sides: names of obstacles, or ``"wall north"``."""


def narrowest_passages(
    world: World, starts: np.ndarray, goals: np.ndarray, robot_height: float = TURTLEBOT2.height
) -> list[list[Passage]]:
    """The narrowest passage on the widest way from each start to each goal: a row for each start.

    Only what shares some height with the robot narrows a passage. A way that the robot is too wide for is told like
    any other: its width says so.

    Args:
        world: the room.
        starts: ``(S, 2)``, metres.
        goals: ``(G, 2)``, metres.
        robot_height: metres.
    """
    points = np.concatenate([np.reshape(starts, (-1, 2)), np.reshape(goals, (-1, 2))])
    found = _first_separations(_bounding_prisms(world, robot_height), points)
    first_goal = len(points) - len(goals)
    return [[found[i][j] for j in range(first_goal, len(points))] for i in range(first_goal)]


def _bounding_prisms(world: World, robot_height: float) -> list[Prism]:
    blocking = free_space(world, TURTLEBOT2.radius, robot_height).blocking
    if world.walls is not None:
        return [*[prism for prism in world.prisms if prism.obstacle < 0], *blocking]
    x, y = world.half_size + OPEN_FLOOR_MARGIN
    corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    edges = zip(corners, np.roll(corners, -1, axis=0), np.roll(corners, 1, axis=0), strict=True)
    rim = [Prism("the edge of the open floor", -1, 0.0, 1.0, np.array([a, b, b + 1e-3 * (a - c)])) for a, b, c in edges]
    return [*rim, *blocking]


def _first_separations(prisms: Sequence[Prism], points: np.ndarray) -> list[list[Passage]]:
    """For every two of ``points``, the narrowest gap that completes a chain between them."""
    count = len(points)
    found = [[Passage(math.inf)] * count for _ in range(count)]
    footprints = Footprints.of(prisms)
    first, second, width, crossed = _gaps(footprints, points)
    everything = (1 << count) - 1
    parent, potential = list(range(len(prisms))), [0] * len(prisms)
    groups = [everything]
    for link in np.argsort(width, kind="stable").tolist():
        a, b = int(first[link]), int(second[link])
        (root_a, odd_a), (root_b, odd_b) = _root(parent, potential, a), _root(parent, potential, b)
        odd = odd_a ^ odd_b ^ crossed[link]
        if root_a != root_b:
            parent[root_a], potential[root_a] = root_b, odd
            continue
        if odd in (0, everything):
            continue
        passage = Passage(max(float(width[link]), 0.0), (prisms[a].name, prisms[b].name))
        divided = []
        for group in groups:
            inside, outside = group & odd, group & ~odd
            for i in _members(inside) if outside else ():
                for j in _members(outside):
                    found[i][j] = found[j][i] = passage
            divided += [part for part in (inside, outside) if part]
        groups = divided
        if len(groups) == count:
            break
    return found


def _gaps(footprints: Footprints, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Pairs of prisms ``(L,)``, ``(L,)``; the gap between them ``(L,)``, metres; and which points' rays it crosses.

    The latter as an integer with a bit for each point, set when a ray from it towards +y crosses the chain from one
    prism's centre to the other's an odd number of times.
    """
    total = len(footprints)
    if total <= LINKED_WITH_ALL:
        first, second = np.triu_indices(total, 1)
    else:
        low, high = footprints.low - 0.5 * WIDEST_GAP, footprints.high + 0.5 * WIDEST_GAP
        pairs = [(a[a < b], b[a < b]) for a, b in overlapping_boxes(low, high, low, high)]
        first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    on_first, on_second = nearest_points(footprints, first, second)
    width = np.linalg.norm(on_second - on_first, axis=1) - footprints.radius[first] - footprints.radius[second]
    corners = np.stack([footprints.centre[first], on_first, on_second, footprints.centre[second]], axis=1)
    odd = np.zeros((len(first), len(points)), dtype=bool)
    for (ax, ay), (bx, by) in ((corners[:, c].T, corners[:, c + 1].T) for c in range(3)):
        for k, (x, y) in enumerate(points.tolist()):
            straddling = np.flatnonzero((ax <= x) != (bx <= x))
            share = (x - ax[straddling]) / (bx[straddling] - ax[straddling])
            odd[straddling, k] ^= ay[straddling] + share * (by[straddling] - ay[straddling]) > y
    packed = np.packbits(odd, axis=1, bitorder="little")
    return first, second, width, [int.from_bytes(row.tobytes(), "little") for row in packed]


def _root(parent: list[int], potential: list[int], node: int) -> tuple[int, int]:
    """The root of a node, and the parities of the chain that leads there; the way is made short for the next time."""
    way = []
    while parent[node] != node:
        way.append(node)
        node = parent[node]
    odd = 0
    for step in reversed(way):
        odd ^= potential[step]
        parent[step], potential[step] = node, odd
    return node, odd


def _members(group: int) -> list[int]:
    return [i for i in range(group.bit_length()) if group >> i & 1]
