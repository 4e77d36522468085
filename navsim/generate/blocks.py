"""Blocks: large boxes only, like the shipped simple rooms."""

from __future__ import annotations

import numpy as np

from navsim.generate.furnishing import choose, furnish, size_factor
from navsim.generate.layout import Layout, Shortfall
from navsim.generate.pieces import Piece, box_piece
from navsim.generate.placing import Placer

DENSITY = 0.1
"""Share of the floor that is covered by default: that of the simple rooms."""


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """A room of large blocks."""
    density = DENSITY if density is None else density
    factor = size_factor(density, DENSITY, 1.8)
    placer = Placer(generator, size)
    done = furnish(placer, choose(generator, [(1.0, _block)], density * size[0] * size[1], factor), joins=0.05)
    return Layout(placer.parts) if done else Shortfall(placer.parts)


def _block(generator: np.random.Generator, factor: float) -> Piece:
    sides = generator.uniform((0.7, 0.6), (1.5, 1.0)) * factor
    return box_piece("block", sides.tolist(), generator.uniform(0.7, 2.0), at_walls=0.3)
