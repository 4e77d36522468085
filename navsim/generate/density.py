"""How much of a world's floor is covered."""

from __future__ import annotations

import numpy as np

from navsim.footprints import Footprints
from navsim.world import World

_POINTS = 160_000  # of a grid over the floor: the share is good to a thousandth


def floor_covered(world: World) -> float:
    """Share of the floor under obstacles, seen from above, table tops and all: 0 to 1, good to about 0.001."""
    half = world.half_size
    columns = max(2, int(np.sqrt(_POINTS * half[0] / half[1])))
    rows = max(2, _POINTS // columns)
    x, y = ((np.arange(n) + 0.5) / n * 2.0 * length - length for n, length in zip((columns, rows), half, strict=True))
    covered = np.zeros((columns, rows), dtype=bool)
    footprints = [prism for prism in world.prisms if prism.obstacle >= 0]
    for prism in footprints:
        low, high = prism.vertices.min(axis=0) - prism.radius, prism.vertices.max(axis=0) + prism.radius
        inside = slice(*np.searchsorted(x, (low[0], high[0]))), slice(*np.searchsorted(y, (low[1], high[1])))
        points = np.stack(np.meshgrid(x[inside[0]], y[inside[1]], indexing="ij"), axis=-1)
        if points.size:
            distance, _ = Footprints.of([prism]).nearest(points.reshape(-1, 2))
            covered[inside] |= distance.reshape(points.shape[:2]) <= 0.0
    return float(covered.mean())
