"""Choosing furniture for a share of the floor, and placing it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from navsim.generate.pieces import Piece, numbered
from navsim.generate.placing import Placer

Maker = Callable[[np.random.Generator, float], Piece]
"""Draws a piece of some sort; the number is a factor of its usual floor lengths."""
Catalogue = Sequence[tuple[float, Maker]]
"""Weights and makers."""


def choose(generator: np.random.Generator, catalogue: Catalogue, area: float, size_factor: float = 1.0) -> list[Piece]:
    """Pieces that cover ``area``, m²: drawn until they cover it, then all shrunk alike to cover no more."""
    makers = [maker for _, maker in catalogue]
    weights = np.cumsum([weight for weight, _ in catalogue])
    pieces: list[Piece] = []
    while sum(piece.area for piece in pieces) < area:
        index = int(np.searchsorted(weights, generator.random() * weights[-1]).clip(max=len(makers) - 1))
        pieces.append(makers[index](generator, size_factor))
    return shrunk(pieces, area)


def shrunk(pieces: Sequence[Piece], area: float) -> list[Piece]:
    """The pieces, with the floor lengths of all multiplied by what makes them cover ``area``, m²."""
    covered = sum(piece.area for piece in pieces)
    return [piece.scaled(math.sqrt(area / covered)) for piece in pieces] if pieces else []


def size_factor(density: float, usual: float, most: float) -> float:
    """How much longer furniture is than usual: passages keep their width, so denser rooms take larger things."""
    return float(np.clip(math.sqrt(density / usual), 1.0, most))


def furnish(placer: Placer, pieces: Sequence[Piece], *, square: bool = False, joins: float = 0.15) -> bool:
    """Places all pieces, the largest first; False where one of them found no place."""
    order = sorted(numbered(pieces), key=lambda piece: -math.hypot(*piece.half))
    return all(placer.place(piece, square=square, joins=joins) for piece in order)
