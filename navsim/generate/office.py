"""Office: rooms behind partitions, joined by doors, with desks, chairs, cupboards and bins."""

from __future__ import annotations

import numpy as np

from navsim.generate.furnishing import choose, furnish, size_factor
from navsim.generate.layout import ImpossibleError, Layout, Shortfall
from navsim.generate.pieces import Part, Piece, box_piece, cylinder_piece, table
from navsim.generate.placing import PASSAGE, SLACK, Placer

DENSITY = 0.1
"""Share of the floor that partitions and furniture cover by default."""
SMALLEST_ROOM = 2.6
"""Metres: a side of a room is at least so long."""
_THICKNESS = 0.1
_DOOR = (PASSAGE + 2 * SLACK, 1.2)  # metres, least and greatest width
_UNDIVIDED = 4.2  # metres: a room whose longer side is no longer than this may stay whole

_Room = tuple[float, float, float, float]
"""West, south, east and north side, metres."""


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """An office: partitions first, then what furniture the rest of ``density`` takes."""
    density = DENSITY if density is None else density
    x, y = size[0] / 2, size[1] / 2
    if max(size) < 2 * SMALLEST_ROOM + _THICKNESS:
        raise ImpossibleError(
            f"an office needs a room with a side of at least {2 * SMALLEST_ROOM + _THICKNESS:g} m, to be divided, not "
            f"{size[0]:g} by {size[1]:g} m; enlarge size"
        )
    placer = Placer(generator, size)
    plan = _Plan(generator, placer)
    plan.divide((-x, -y, x, y), must=True)
    left = density * size[0] * size[1] - plan.area
    if left < 0.0:
        return Shortfall(placer.parts)
    factor = size_factor(density, 0.13, 1.5)
    pieces = choose(generator, _CATALOGUE, left, factor)
    done = furnish(placer, pieces, square=True, joins=0.4 if density > 0.13 else 0.15)
    return Layout(placer.parts) if done else Shortfall(placer.parts)


class _Plan:
    """Partitions and doors."""

    def __init__(self, generator: np.random.Generator, placer: Placer) -> None:
        self._generator, self._placer = generator, placer
        self._doors: list[tuple[int, float, float, float]] = []  # axis of the wall's normal, its place, from, to
        self._walls = 0
        self.area = 0.0
        """Floor under partitions, m²."""

    def divide(self, room: _Room, must: bool = False) -> None:
        """Divides a room in two, and these again, as long as they are large."""
        width, depth = room[2] - room[0], room[3] - room[1]
        axis = 0 if width > depth else 1
        longer = max(width, depth)
        if longer < 2 * SMALLEST_ROOM + _THICKNESS:
            return
        if not must and longer < 2 * _UNDIVIDED and self._generator.random() < 0.25:
            return
        low, high = room[axis] + SMALLEST_ROOM + _THICKNESS / 2, room[axis + 2] - SMALLEST_ROOM - _THICKNESS / 2
        for _ in range(20):
            place = float(self._generator.uniform(low, max(low, high)))  # rounding may have them cross
            if self._meets_no_door(room, axis, place):
                break
        else:
            return
        self._build(axis, place, room[1 - axis], room[3 - axis])
        near, far = list(room), list(room)
        near[axis + 2], far[axis] = place - _THICKNESS / 2, place + _THICKNESS / 2
        self.divide((near[0], near[1], near[2], near[3]))
        self.divide((far[0], far[1], far[2], far[3]))

    def _meets_no_door(self, room: _Room, axis: int, place: float) -> bool:
        """Whether a partition at ``place`` ends in walls, not in a door."""
        for normal, at, low, high in self._doors:
            is_beside = normal == 1 - axis and min(abs(at - room[1 - axis]), abs(at - room[3 - axis])) < _THICKNESS
            if is_beside and low - _THICKNESS < place < high + _THICKNESS:
                return False
        return True

    def _build(self, axis: int, place: float, low: float, high: float) -> None:
        """A partition across ``axis`` with a door in it."""
        width = float(self._generator.uniform(*_DOOR))
        begin = float(self._generator.uniform(low + 0.2, high - 0.2 - width))
        self._doors.append((axis, place, begin, begin + width))
        for start, end in ((low, begin), (begin + width, high)):
            middle, length = 0.5 * (start + end), end - start - 0.002  # rounded to 1 mm, none sticks out
            self._walls += 1
            at = (place, middle) if axis == 0 else (middle, place)
            yaw_deg = 90.0 if axis == 0 else 0.0
            self._placer.add_wall(Part(f"partition {self._walls}", at, 2.0, size=(length, _THICKNESS), yaw_deg=yaw_deg))
            self.area += length * _THICKNESS
        middle = begin + 0.5 * width
        centre = (place, middle) if axis == 0 else (middle, place)
        half = (PASSAGE, 0.5 * width) if axis == 0 else (0.5 * width, PASSAGE)
        self._placer.keep_free(centre, half)


def _desk(generator: np.random.Generator, factor: float) -> Piece:
    """A desk with a swivel chair in front: a foot on the floor, a column, and a seat that the robot passes under."""
    width, depth = generator.uniform(1.1, 1.5) * factor, generator.uniform(0.6, 0.75) * factor
    desk = table("desk", (width, depth))
    foot, seat = 0.27, 0.22
    gap = generator.uniform(0.02, 0.08)
    whole = depth + gap + 2 * foot
    chair = (generator.uniform(-0.2, 0.2) * width, whole / 2 - foot)
    parts = [part.moved((0.0, (depth - whole) / 2), 0.0) for part in desk.parts]
    parts += [
        Part("desk chair foot", chair, 0.08, radius=foot),
        Part("desk chair column", chair, 0.37, 0.08, radius=0.04, is_covered=True),
        Part("desk chair seat", chair, 0.07, 0.45, radius=seat, is_covered=True),
    ]
    return Piece(tuple(parts), (width / 2, whole / 2), at_walls=0.85)


def _meeting_table(generator: np.random.Generator, factor: float) -> Piece:
    return table("meeting-table", (generator.uniform((1.2, 0.7), (1.6, 0.9)) * factor).tolist(), leg=0.04, at_walls=0.1)


def _cupboard(generator: np.random.Generator, factor: float) -> Piece:
    size = generator.uniform((0.8, 0.38), (1.2, 0.48)) * factor
    return box_piece("cupboard", size.tolist(), generator.uniform(1.2, 1.95), at_walls=1.0)


def _drawers(generator: np.random.Generator, factor: float) -> Piece:
    return box_piece("drawers", (0.45 * factor, 0.5 * factor), generator.uniform(0.55, 0.75), at_walls=0.9)


def _bin(generator: np.random.Generator, factor: float) -> Piece:
    return cylinder_piece("bin", generator.uniform(0.12, 0.16), generator.uniform(0.22, 0.4), at_walls=0.9)


def _plant(generator: np.random.Generator, factor: float) -> Piece:
    return cylinder_piece("plant", generator.uniform(0.15, 0.22) * factor, generator.uniform(0.7, 1.4), at_walls=0.9)


def _paper_box(generator: np.random.Generator, factor: float) -> Piece:
    return box_piece("paper", (0.31, 0.22), generator.uniform(0.12, 0.26), at_walls=0.9)


_CATALOGUE = (
    *((0.34, _desk), (0.06, _meeting_table), (0.2, _cupboard), (0.1, _drawers)),
    *((0.14, _bin), (0.1, _plant), (0.06, _paper_box)),
)
