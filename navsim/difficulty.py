"""How hard a world is to drive through, as one number: the share of its paths on which a reactive robot should fail.

A logistic model of two measures that need no driving: how much longer than the straight line the ways are, and how
near things stand on the free floor. Its coefficients were fitted to the failures of the reactive baseline
(``rl.baselines``) in generated rooms of all kinds and densities, and judged in others: ``scripts/difficulty.py`` does
both, and docs/results/difficulty.json holds what came out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from navsim.camera import DepthCamera
from navsim.footprints import Footprints
from navsim.robot import TURTLEBOT2
from navsim.task import Task
from navsim.world import World

EFFECTIVE_RADIUS = 0.4
"""Metres: with the 0.4 m rule of the depth image, the robot is about twice as wide as its body in front."""
SEEN_BELOW = DepthCamera().mount_z + Task.collision_depth * float(abs(DepthCamera().row_slopes[-1]))
"""Height, metres, below which the camera may see a thing as near as the depth rule forbids."""
LONGEST_DETOUR = 4.0
"""A way so many times longer than the straight line, or one that does not exist, counts as this."""
NEAR = 1.0
"""Metres from an obstacle within which the floor counts as narrow."""
COEFFICIENTS = (-3.59, 7.09, 3.23)
"""Of the logistic model: the constant, and the factors of ``detour`` and ``narrow``."""
_SPACING = 0.1  # metres, of the grid
_PLACES = 24  # of a world that leaves its starts or goals open


class Measures(NamedTuple):
    """What difficulty is made of."""

    detour: float
    """Mean over the paths of log(length of the way / length of the straight line), for a disc of ``EFFECTIVE_RADIUS``.
    """
    narrow: float
    """Mean over the free floor of max(0, 1 − d / ``NEAR``), d the distance to the nearest obstacle or wall."""


def difficulty(world: World) -> float:
    """A number from 0 to 1: about the share of the world's paths on which the reactive baseline fails.

    It is made for rooms like the generated and the shipped ones; elsewhere it tells which of two rooms is the harder.
    Listed starts and goals are what it is about; where a world leaves them open, places all over its floor.

    >>> easy = World.from_dict({"format": 1, "size": [7, 7]})
    >>> wall = {"box": {"at": [0, 0.75], "size": [0.1, 5.5], "height": 1}}
    >>> difficulty(easy) < difficulty(World.from_dict({"format": 1, "size": [7, 7], "obstacles": [wall]}))
    True
    """
    return predicted(measure(world))


def predicted(measures: Measures, coefficients: tuple[float, ...] = COEFFICIENTS) -> float:
    """The model's answer to some measures."""
    exponent = coefficients[0] + sum(b * value for b, value in zip(coefficients[1:], measures, strict=True))
    return 1.0 / (1.0 + math.exp(-exponent))


def measure(world: World) -> Measures:
    """The measures of a world."""
    half = world.half_size
    columns, rows = (max(2, math.ceil(2.0 * length / _SPACING)) for length in half)
    spacing = 2.0 * half / (columns, rows)
    x, y = (low + step * (np.arange(n) + 0.5) for low, step, n in zip(-half, spacing, (columns, rows), strict=True))
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    clear = _clearance(world, points.reshape(-1, 2)).reshape(columns, rows)
    passable = clear >= EFFECTIVE_RADIUS

    starts, goals = _places(world, passable, points)
    begins, ends = (np.floor((places + half) / spacing).astype(np.intp) for places in (starts, goals))
    begins, ends = (np.clip(cells, 0, (columns - 1, rows - 1)) for cells in (begins, ends))
    ways = _ways(passable, spacing, begins, ends)
    straight = _octile(begins, ends, spacing)
    apart = straight > 0.0
    if not apart.any():
        return Measures(0.0, _narrow(clear))
    ratio = np.clip(ways[apart] / straight[apart], 1.0, LONGEST_DETOUR)
    return Measures(
        detour=float(np.log(ratio).mean()),
        narrow=_narrow(clear),
    )


def _clearance(world: World, points: np.ndarray) -> np.ndarray:
    """Metres from ``points`` ``(K, 2)`` to what the robot would hit or see too near, walls included: ``(K,)``."""
    height = max(TURTLEBOT2.height, SEEN_BELOW)
    footprints = Footprints.of([p for p in world.prisms if p.obstacle >= 0 and p.overlaps_heights(0.0, height)])
    clear, _ = footprints.nearest(points)
    if world.walls is None:
        return clear
    return np.minimum(clear, (world.half_size - np.abs(points)).min(axis=1))


def _narrow(clear: np.ndarray) -> float:
    free = clear[clear > TURTLEBOT2.radius]
    return float(np.maximum(0.0, 1.0 - free / NEAR).mean()) if len(free) else 1.0


def _places(world: World, passable: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts ``(S, 2)`` and goals ``(G, 2)``, metres: the listed ones, or some of the passable grid."""
    floor = points[passable]
    chosen = np.random.default_rng(0).permutation(len(floor))[:_PLACES]
    drawn = np.array_split(floor[chosen], 2) if len(floor) > 1 else [points[:1, 0], points[:1, 0]]
    starts = drawn[0] if isinstance(world.starts, str) else np.array([start.at for start in world.starts])
    goals = drawn[1] if isinstance(world.goals, str) else np.array([goal.at for goal in world.goals])
    return starts, goals


def _ways(passable: np.ndarray, spacing: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """``(S, G)`` metres from cells ``begins`` to cells ``ends`` over passable ones, in eight directions."""
    passable = passable.copy()
    for cells in (begins, ends):
        passable[tuple(cells.T)] = True  # a place that is listed can be left, however narrow it is there
    index = np.arange(passable.size).reshape(passable.shape)
    tails, heads, lengths = [], [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        above = slice(None) if dy == 0 else slice(1, None) if dy > 0 else slice(None, -1)
        below = slice(None) if dy == 0 else slice(None, -1) if dy > 0 else slice(1, None)
        right, left = (slice(1, None), slice(None, -1)) if dx else (slice(None), slice(None))
        both = passable[left, below] & passable[right, above]
        tails.append(index[left, below][both])
        heads.append(index[right, above][both])
        lengths.append(np.full(int(both.sum()), math.hypot(*(spacing * (dx, dy)))))
    edges = np.concatenate(tails), np.concatenate(heads)
    graph = coo_array((np.concatenate(lengths), edges), shape=(index.size,) * 2).tocsr()
    distance = dijkstra(graph, directed=False, indices=index[tuple(begins.T)])
    return distance[:, index[tuple(ends.T)]]


def _octile(begins: np.ndarray, ends: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """``(S, G)`` metres between cells in eight directions, with nothing in between."""
    steps = np.abs(begins[:, None] - ends)
    diagonal = steps.min(axis=-1)
    rest = steps - diagonal[..., None]
    return diagonal * math.hypot(*spacing) + (rest * spacing).sum(axis=-1)
