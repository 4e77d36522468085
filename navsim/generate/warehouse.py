"""Warehouse: rows of shelving with aisles between them, and pallets on the floor.

A rack is boards on uprights. Its lowest board is at the height of the robot's top plate, so that a scanner near the
floor sees nothing but the uprights.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from navsim.generate.furnishing import furnish
from navsim.generate.layout import ImpossibleError, Layout, Shortfall
from navsim.generate.pieces import Part, Piece
from navsim.generate.placing import PASSAGE, SLACK, Placer

DENSITY = 0.2
"""Share of the floor that racks and pallets cover by default."""
SMALLEST = 4.0
"""Metres: either side of the room is at least so long."""
DEPTH = (0.35, 0.75)
"""Metres, least and greatest depth of a rack."""
_AISLE = PASSAGE + 0.1  # metres, the least width between two rows
_BAY = (1.1, 1.6)  # metres, least and greatest length of a bay
_UPRIGHT = 0.06  # metres, thickness
_BOARDS = (0.38, 1.15)  # metres, heights of their under sides
_BOARD = 0.04  # metres, thickness
_BACK_TO_BACK = 0.02  # metres between two racks of a double row


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """A warehouse: as many bays as ``density`` takes, dealt out to the rows at random, then pallets."""
    if min(size) < SMALLEST:
        raise ImpossibleError(
            f"a warehouse needs a room of at least {SMALLEST:g} by {SMALLEST:g} m, not {size[0]:g} by {size[1]:g} m; "
            "enlarge size"
        )
    floor = size[0] * size[1]
    area = (DENSITY if density is None else density) * floor
    along = int(generator.integers(2)) if size[0] == size[1] else int(size[1] > size[0])
    length, breadth = size[along], size[1 - along]

    pallets = [_pallet(generator) for _ in range(int(generator.integers(0, 2 + round(floor / 16.0))))]
    while pallets and sum(pallet.area for pallet in pallets) > 0.3 * area:
        pallets.pop()
    rack_area = area - sum(pallet.area for pallet in pallets)

    aisles = generator.uniform(PASSAGE + 0.05, PASSAGE + 0.4, 2)
    at_wall = None  # the end where rows begin at the wall
    if generator.random() < 0.4 and length > 5.0:
        at_wall = int(generator.integers(2))
        aisles[at_wall] = SLACK
    usable = length - aisles.sum()
    most = math.floor(usable / _BAY[0])
    if most < 1:
        return Shortfall([])
    # Some lengths are no whole number of bays; with fewer of the longest, aisles are wider.
    bays = int(generator.integers(min(max(1, math.ceil(usable / _BAY[1])), most), most + 1))
    bay = min(usable / bays, _BAY[1])
    rows = _rows(generator, breadth, bays * bay, rack_area)
    if rows is None:
        return Shortfall([])
    count = max(1, min(sum(rows) * bays, math.ceil(rack_area / (bay * generator.uniform(0.45, 0.6)))))
    depth = rack_area / (count * bay)
    if not DEPTH[0] <= depth <= DEPTH[1]:
        count = max(1, min(sum(rows) * bays, math.ceil(rack_area / (bay * DEPTH[1]))))
        depth = rack_area / (count * bay)
    places = _places(rows, breadth, depth)
    if places is None or not DEPTH[0] <= depth <= DEPTH[1] + 1e-9:
        return Shortfall([])

    placer = Placer(generator, size)
    taken = np.sort(generator.permutation(len(places) * bays)[:count])
    west = -0.5 * length + aisles[0] + 0.5 * (usable - bays * bay) * (at_wall is None)
    if at_wall == 1:
        west = 0.5 * length - SLACK - bays * bay
    number = 0
    for row, (place, turned) in enumerate(places):
        filled = [int(bay_) for bay_ in taken - row * bays if 0 <= bay_ < bays]
        for first, last in _runs(filled):
            number += 1
            rack = _rack(generator, f"rack {number}", last - first + 1, bay, depth)
            middle = west + 0.5 * (first + last + 1) * bay
            at = (middle, place) if along == 0 else (-place, middle)
            placer.add_fixed(rack, at, 90.0 * along + (180.0 if turned else 0.0))
    if not furnish(placer, pallets, square=True, joins=0.4):
        return Shortfall(placer.parts)
    return Layout(placer.parts)


def _rows(generator: np.random.Generator, breadth: float, length: float, area: float) -> list[int] | None:
    """Racks in each row, side by side over the breadth of the room: 1 against a wall, 2 back to back.

    None where no arrangement holds racks for ``area``, m².
    """
    able = []
    for doubles in range(int(breadth / (2 * DEPTH[0] + _AISLE)) + 1):
        for walls in (0, 1, 2):
            rows = [1] * (walls > 0) + [2] * doubles + [1] * (walls > 1)
            if not rows:
                continue
            deepest = (breadth - _AISLE * _aisles(rows)) / sum(rows)
            deepest = min(DEPTH[1], deepest - _BACK_TO_BACK)
            if deepest >= DEPTH[0] and sum(rows) * length * deepest >= area:
                # Rows that are mostly full look like a warehouse; hardly filled ones like ruins.
                fill = area / (sum(rows) * length * min(deepest, 0.5))
                able.append((rows, 1.0 if 0.5 <= fill <= 1.0 else 0.1))
    if not able:
        return None
    weights = np.cumsum([weight for _, weight in able])
    rows = able[int(np.searchsorted(weights, generator.random() * weights[-1]).clip(max=len(able) - 1))][0]
    return rows if generator.random() < 0.5 else rows[::-1]


def _aisles(rows: list[int]) -> int:
    """Aisles beside and between rows; a single rack at either end stands against the wall."""
    return len(rows) + 1 - (rows[0] == 1) - (len(rows) > 1 and rows[-1] == 1)


def _places(rows: list[int], breadth: float, depth: float) -> list[tuple[float, bool]] | None:
    """The middle of each rack over the breadth of the room, metres, and whether its front looks to the lesser side."""
    stacks = [1 * depth if racks == 1 else 2 * depth + _BACK_TO_BACK for racks in rows]
    aisle = (breadth - sum(stacks) - 2 * SLACK) / _aisles(rows)
    if aisle < PASSAGE + 2 * SLACK:
        return None
    places = []
    front = -0.5 * breadth + SLACK
    for row, (racks, stack) in enumerate(zip(rows, stacks, strict=True)):
        first, last = row == 0, row == len(rows) - 1
        if not (first and racks == 1):
            front += aisle
        if racks == 1:
            places.append((front + 0.5 * depth, last and not first))
        else:
            places += [(front + 0.5 * depth, True), (front + 1.5 * depth + _BACK_TO_BACK, False)]
        front += stack
    return places


def _runs(bays: list[int]) -> list[tuple[int, int]]:
    """First and last of each run of neighbouring bays."""
    runs: list[tuple[int, int]] = []
    for bay in bays:
        if runs and bay == runs[-1][1] + 1:
            runs[-1] = (runs[-1][0], bay)
        else:
            runs.append((bay, bay))
    return runs


def _rack(generator: np.random.Generator, name: str, bays: int, bay: float, depth: float) -> Piece:
    """Boards over all bays, two uprights at the end of each, and goods on some boards."""
    length = bays * bay
    parts = [
        Part(f"{name} board {i + 1}", (0.0, 0.0), _BOARD, base, size=(length, depth)) for i, base in enumerate(_BOARDS)
    ]
    parts[1] = replace(parts[1], is_covered=True)
    inset = 0.5 * _UPRIGHT
    for i in range(bays + 1):
        x = float(np.clip(-0.5 * length + i * bay, inset - 0.5 * length, 0.5 * length - inset))
        for side, y in enumerate((inset - 0.5 * depth, 0.5 * depth - inset)):
            label = f"{name} upright {2 * i + side + 1}"
            parts.append(Part(label, (x, y), 1.7, size=(_UPRIGHT, _UPRIGHT), is_covered=True))
    goods = 0
    for i in range(bays):
        if generator.random() < 0.6:
            goods += 1
            board = _BOARDS[int(generator.integers(2))] + _BOARD
            size = generator.uniform((0.3, 0.5), (0.75, 0.9)) * (bay - 0.1, depth)
            parts.append(
                Part(
                    f"{name} goods {goods}",
                    (-0.5 * length + (i + 0.5) * bay, 0.0),
                    generator.uniform(0.25, 0.6),
                    board,
                    size=(float(size[0]), float(size[1])),
                    is_covered=True,
                )
            )
    return Piece(tuple(parts), (0.5 * length, 0.5 * depth), at_walls=1.0)


def _pallet(generator: np.random.Generator) -> Piece:
    """A pallet, lower than the camera, with or without cartons on it."""
    size = (0.8, 0.6)
    parts = [Part("pallet", (0.0, 0.0), 0.144, size=size)]
    if generator.random() < 0.5:
        cover = generator.uniform(0.6, 0.95)
        load = (size[0] * cover, size[1] * cover)
        parts.append(Part("pallet load", (0.0, 0.0), generator.uniform(0.3, 0.9), 0.144, size=load, is_covered=True))
    return Piece(tuple(parts), (size[0] / 2, size[1] / 2), at_walls=0.6)
