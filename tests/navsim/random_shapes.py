"""Random footprints, and the same as shapely's shapes: what several tests compare with."""

from __future__ import annotations

import numpy as np
import shapely

from navsim.prism import Prism

ROUND = 1e-5  # metres by which shapely's polygon with 4 × 128 corners misses a circle of 0.5 m


def random_prisms(generator: np.random.Generator, count: int, half_size: float = 3.0) -> list[Prism]:
    """Convex prisms that may touch, overlap, and hold each other."""
    prisms = []
    for i in range(count):
        centre = generator.uniform(-half_size, half_size, 2)
        if generator.random() < 0.4:
            prisms.append(Prism(f"can {i}", i, 0.0, 1.0, centre[None], generator.uniform(0.05, 0.5)))
        else:
            angles = np.sort(generator.uniform(0.0, 2.0 * np.pi, generator.integers(3, 8)))
            corners = generator.uniform(0.1, 0.8) * np.column_stack([np.cos(angles), np.sin(angles)])
            prisms.append(Prism(f"block {i}", i, 0.0, 1.0, centre + corners))
    return prisms


def shape_of(prism: Prism) -> shapely.Geometry:
    if prism.is_cylinder:
        return shapely.Point(prism.vertices[0]).buffer(prism.radius, quad_segs=128)
    return shapely.Polygon(prism.vertices)
