"""Forest: trunks of many radii, fallen logs, stumps and low bushes inside a hedge."""

from __future__ import annotations

import math

import numpy as np

from navsim.generate.furnishing import choose, furnish, size_factor
from navsim.generate.layout import Layout, Shortfall
from navsim.generate.pieces import Part, Piece, box_piece, cylinder_piece
from navsim.generate.placing import Placer

DENSITY = 0.05
"""Share of the floor that is covered by default."""
_HEDGE = {"height": 1.2, "thickness": 0.4}


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """A piece of forest."""
    density = DENSITY if density is None else density
    catalogue = [(0.62, _trunk), (0.12, _log), (0.1, _stump), (0.16, _bush)]
    placer = Placer(generator, size)
    factor = size_factor(density, DENSITY, 2.5)
    done = furnish(placer, choose(generator, catalogue, density * size[0] * size[1], factor), joins=0.05)
    return Layout(placer.parts, _HEDGE) if done else Shortfall(placer.parts)


def _trunk(generator: np.random.Generator, factor: float) -> Piece:
    # Many thin stems and a few old trees.
    radius = 0.05 * factor * (0.4 / 0.05) ** (generator.random() ** 1.5)
    return cylinder_piece("trunk", radius, generator.uniform(1.8, 2.6), at_walls=0.05)


def _log(generator: np.random.Generator, factor: float) -> Piece:
    thickness = generator.uniform(0.16, 0.28)
    return box_piece("log", (generator.uniform(0.9, 1.8) * factor, thickness), thickness, at_walls=0.0)


def _stump(generator: np.random.Generator, factor: float) -> Piece:
    return cylinder_piece("stump", generator.uniform(0.12, 0.28) * factor, generator.uniform(0.15, 0.45), at_walls=0.1)


def _bush(generator: np.random.Generator, factor: float) -> Piece:
    """A heart with smaller clumps around it, knee-high at most."""
    heart = generator.uniform(0.14, 0.22) * factor
    turn, count = generator.uniform(0.0, 2.0 * math.pi), int(generator.integers(3, 6))
    parts = [Part("bush heart", (0.0, 0.0), generator.uniform(0.3, 0.55), radius=heart)]
    extent = heart
    for i in range(count):
        radius = heart * generator.uniform(0.4, 0.7)
        away, angle = heart + radius + 0.005, turn + 2.0 * math.pi * i / count
        place = (away * math.cos(angle), away * math.sin(angle))
        parts.append(Part(f"bush clump {i + 1}", place, generator.uniform(0.15, 0.4), radius=radius))
        extent = max(extent, away + radius)
    return Piece(tuple(parts), (extent, extent), at_walls=0.2)
