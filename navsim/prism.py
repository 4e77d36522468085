"""The one geometric primitive of the simulator: a convex footprint extruded between two heights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True)
class Prism:
    """A convex footprint extruded from ``base`` to ``top`` (metres above the floor).

    A world is a set of these: walls and boxes are one each, a concave polygon is several that share
    edges, a cylinder is a single vertex with a ``radius``.

    Attributes:
        name: what the author called the obstacle, or ``"box 3"``, ``"wall north"``.
        obstacle: index in ``World.obstacles``; −1 for a wall.
        base: height of the under side, metres.
        top: height of the upper side, metres; greater than ``base``.
        vertices: ``(V, 2)`` float64, metres, counter-clockwise and convex; ``(1, 2)``, the centre, for a cylinder.
        radius: of a cylinder, metres; 0 for a polygon.
    """

    name: str
    obstacle: int
    base: float
    top: float
    vertices: np.ndarray
    radius: float = 0.0

    @property
    def is_cylinder(self) -> bool:
        return self.radius > 0.0

    @property
    def bounding_circle(self) -> tuple[np.ndarray, float]:
        """Centre ``(2,)`` and radius, metres, of a circle that holds the footprint."""
        centre = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        reach = np.linalg.norm(self.vertices - centre, axis=1).max()
        return centre, float(reach + self.radius)

    def overlaps_heights(self, low: float, high: float) -> bool:
        """Whether some height in the open range (``low``, ``high``), metres, belongs to the prism."""
        return self.base < high and self.top > low


def walls_around(half_size: np.ndarray, height: float, thickness: float) -> Iterator[Prism]:
    """The four walls around the rectangle from ``-half_size`` to ``half_size`` ``(2,)``; all in metres."""
    (x, y), t = half_size, thickness
    for side, low, high in (
        ("north", (-x - t, y), (x + t, y + t)),
        ("east", (x, -y), (x + t, y)),
        ("south", (-x - t, -y - t), (x + t, -y)),
        ("west", (-x - t, -y), (-x, y)),
    ):
        vertices = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
        vertices.flags.writeable = False
        yield Prism(f"wall {side}", -1, 0.0, height, vertices)
