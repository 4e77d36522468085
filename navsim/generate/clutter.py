"""Clutter: a living room, workshop and storeroom in one, like the shipped complex rooms.

A third of the obstacles is lower than the camera or raised off the floor.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.generate.furnishing import furnish, shrunk, size_factor
from navsim.generate.layout import Layout, Shortfall
from navsim.generate.pieces import Part, Piece, barrier, bench, box_piece, cylinder_piece, round_table, table
from navsim.generate.placing import Placer

OBSTACLES = 24
"""In a room of 7 by 7 m, where no density is asked for; a larger room has more of them."""
_FLOOR = 49.0  # m², of that room
_USUAL_DENSITY = 0.11  # of the shipped complex rooms
_SHARE = 3  # one obstacle in so many is low or raised


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """A cluttered room: ``OBSTACLES`` of them for 49 m², or as many as cover ``density`` of the floor."""
    floor = size[0] * size[1]
    if density is None:
        pieces = _counted(generator, max(3, round(OBSTACLES * floor / _FLOOR)))
    else:
        pieces = _covering(generator, density * floor, size_factor(density, _USUAL_DENSITY, 1.8))
    placer = Placer(generator, size)
    crowded = density is not None and density > 0.15
    if furnish(placer, pieces, joins=0.5 if crowded else 0.1):
        return Layout(placer.parts)
    return Shortfall(placer.parts)


def _counted(generator: np.random.Generator, count: int) -> list[Piece]:
    """Pieces of ``count`` obstacles in all, a third of them, rounded up, low or raised."""
    special = math.ceil(count / _SHARE)
    plain = count - special
    pieces = []
    while plain + special > 0:
        piece = _draw(generator, 1.0, wants_special=generator.random() < special / (plain + special))
        taken = piece.low_or_raised, len(piece.parts) - piece.low_or_raised
        if taken[0] <= special and taken[1] <= plain:
            pieces.append(piece)
            special, plain = special - taken[0], plain - taken[1]
    return pieces


def _covering(generator: np.random.Generator, area: float, factor: float) -> list[Piece]:
    """Pieces that cover ``area``, m²; of their obstacles at least a third is low or raised."""
    pieces: list[Piece] = []
    count = special = 0
    while sum(piece.area for piece in pieces) < area or _SHARE * special < count:
        piece = _draw(generator, factor, wants_special=_SHARE * special < count)
        pieces.append(piece)
        count, special = count + len(piece.parts), special + piece.low_or_raised
    return shrunk(pieces, area)


def _draw(generator: np.random.Generator, factor: float, wants_special: bool) -> Piece:
    makers = _SPECIAL if wants_special else _PLAIN
    return makers[int(generator.integers(len(makers)))](generator, factor)


def _size(generator: np.random.Generator, low: tuple[float, float], high: tuple[float, float], factor: float):
    return (generator.uniform(low, high) * factor).tolist()


def _sofa(g: np.random.Generator, f: float) -> Piece:
    return box_piece("sofa", _size(g, (1.2, 0.6), (1.7, 0.8), f), 0.7, at_walls=0.8)


def _cabinet(g: np.random.Generator, f: float) -> Piece:
    return box_piece("cabinet", _size(g, (0.8, 0.4), (1.2, 0.5), f), g.uniform(1.2, 1.9), at_walls=0.9)


def _chest(g: np.random.Generator, f: float) -> Piece:
    return box_piece("chest", _size(g, (0.7, 0.45), (1.0, 0.6), f), g.uniform(0.6, 1.0), at_walls=0.7)


def _crates(g: np.random.Generator, f: float) -> Piece:
    return box_piece("crates", _size(g, (0.6, 0.6), (0.85, 0.85), f), g.uniform(0.5, 1.3), at_walls=0.3)


def _bin(g: np.random.Generator, f: float) -> Piece:
    return cylinder_piece("bin", g.uniform(0.15, 0.22), g.uniform(0.45, 0.8))


def _post(g: np.random.Generator, f: float) -> Piece:
    return cylinder_piece("post", g.uniform(0.04, 0.08), 1.8, at_walls=0.1)


def _partition(g: np.random.Generator, f: float) -> Piece:
    return box_piece("partition", (g.uniform(0.9, 1.4) * f, 0.1), 1.5, at_walls=0.1)


def _heap(g: np.random.Generator, f: float) -> Piece:
    """Two cartons and a waste bin beside each other."""
    (a, b), (c, d), r = _size(g, (0.35, 0.3), (0.5, 0.4), f), _size(g, (0.3, 0.3), (0.4, 0.4), f), 0.18
    width = a + c + 2 * r + 0.02
    depth = max(b, d, 2 * r)
    parts = (
        Part("heap carton A", (-width / 2 + a / 2, (b - depth) / 2), g.uniform(0.32, 0.6), size=(a, b)),
        Part("heap carton B", (-width / 2 + a + 0.01 + c / 2, (d - depth) / 2), g.uniform(0.32, 0.6), size=(c, d)),
        Part("heap bin", (width / 2 - r, r - depth / 2), 0.65, radius=r),
    )
    return Piece(parts, (width / 2, depth / 2), at_walls=0.4)


def _crates_and_can(g: np.random.Generator, f: float) -> Piece:
    """Stacked crates with a paint can beside them."""
    (a, b), r = _size(g, (0.55, 0.55), (0.75, 0.75), f), 0.1
    width = a + 2 * r + 0.01
    parts = (
        Part("stack", (-width / 2 + a / 2, 0.0), g.uniform(0.6, 1.3), size=(a, b)),
        Part("stack can", (width / 2 - r, g.uniform(-1.0, 1.0) * (b / 2 - r)), 0.22, radius=r),
    )
    return Piece(parts, (width / 2, b / 2), at_walls=0.3)


def _can(g: np.random.Generator, f: float) -> Piece:
    return cylinder_piece("can", g.uniform(0.08, 0.13), g.uniform(0.15, 0.26))


def _pallet(g: np.random.Generator, f: float) -> Piece:
    return box_piece("pallet", _size(g, (0.8, 0.6), (1.0, 0.8), f), 0.15, at_walls=0.3)


def _planter(g: np.random.Generator, f: float) -> Piece:
    return box_piece("planter", _size(g, (0.6, 0.25), (0.9, 0.35), f), 0.28, at_walls=0.7)


def _parcel(g: np.random.Generator, f: float) -> Piece:
    return box_piece("parcel", _size(g, (0.3, 0.3), (0.45, 0.4), f), g.uniform(0.15, 0.27), at_walls=0.4)


def _step(g: np.random.Generator, f: float) -> Piece:
    return box_piece("step", _size(g, (0.5, 0.3), (0.7, 0.4), f), 0.2, at_walls=0.3)


def _shelf(g: np.random.Generator, f: float) -> Piece:
    """On the wall, where the robot's top plate would hit it."""
    return box_piece("shelf", _size(g, (0.8, 0.2), (1.1, 0.3), f), 0.04, base=0.36, at_walls=1.0)


def _table(g: np.random.Generator, f: float) -> Piece:
    return table("table", _size(g, (1.0, 0.6), (1.3, 0.8), f))


def _cafe_table(g: np.random.Generator, f: float) -> Piece:
    return round_table("cafe", g.uniform(0.3, 0.42) * f)


def _bench(g: np.random.Generator, f: float) -> Piece:
    return bench("bench", g.uniform(0.9, 1.3) * f)


def _barrier(g: np.random.Generator, f: float) -> Piece:
    return barrier("barrier", g.uniform(0.9, 1.3) * f)


_PLAIN = (_sofa, _cabinet, _chest, _crates, _crates, _bin, _post, _partition, _heap)
_SPECIAL = (
    *(_can, _pallet, _planter, _parcel, _step, _shelf, _crates_and_can),
    *(_table, _cafe_table, _bench, _barrier),
)
