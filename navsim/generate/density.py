"""How much of a world's floor is covered."""

from __future__ import annotations

import numpy as np

from navsim.prism import Prism
from navsim.world import World

_LINES = 2000
"""Lines across the room on which the covered length is summed up."""


def floor_covered(world: World) -> float:
    """Share of the floor under obstacles, seen from above, table tops and all: 0 to 1, good to about 0.001."""
    half_x, half_y = world.half_size
    jitter = np.random.default_rng(0).random(_LINES)  # walls along the lines would fall between evenly spaced ones
    x = (2.0 * (np.arange(_LINES) + jitter) / _LINES - 1.0) * half_x
    prisms = [prism for prism in world.prisms if prism.obstacle >= 0]
    if not prisms:
        return 0.0
    begins, ends = (
        np.clip(bound, -half_y, half_y) for bound in np.array([_crossing(p, x) for p in prisms]).swapaxes(0, 1)
    )
    order = np.argsort(begins, axis=0)
    begins, ends = np.take_along_axis(begins, order, axis=0), np.take_along_axis(ends, order, axis=0)
    reached = np.maximum.accumulate(ends, axis=0)
    before = np.vstack([np.full((1, _LINES), -half_y), reached[:-1]])
    covered = np.maximum(0.0, ends - np.maximum(begins, before)).sum(axis=0)
    return float(covered.mean() / (2.0 * half_y))


def _crossing(prism: Prism, x: np.ndarray) -> np.ndarray:
    """Where the lines at ``x`` ``(L,)`` along y enter and leave a footprint: ``(2, L)``; the same twice where not."""
    if prism.is_cylinder:
        centre_x, centre_y = prism.vertices[0]
        reach = np.sqrt(np.maximum(prism.radius**2 - (x - centre_x) ** 2, 0.0))
        return np.array([centre_y - reach, centre_y + reach])
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    for (ax, ay), (bx, by) in zip(prism.vertices, np.roll(prism.vertices, -1, axis=0), strict=True):
        crosses = (x >= min(ax, bx)) & (x < max(ax, bx))
        y = ay + (x[crosses] - ax) / (bx - ax) * (by - ay) if ax != bx else np.empty(0)
        low[crosses], high[crosses] = np.minimum(low[crosses], y), np.maximum(high[crosses], y)
    missed = low > high
    low[missed] = high[missed] = 0.0
    return np.array([low, high])
