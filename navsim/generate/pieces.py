"""Pieces of furniture, each in coordinates of its own: one obstacle, or several that stay together.

A piece's frame has its origin in the middle, x along its front and its back at −y, towards the wall that it may stand
against. Its outline is a rectangle that holds all its parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from navsim.camera import DepthCamera

CAMERA_HEIGHT = DepthCamera().mount_z
"""Metres: what ends below it is *low*."""
DECIMALS = 3
"""Of the lengths in a generated world: whole millimetres."""


@dataclass(frozen=True)
class Part:
    """One obstacle: a box of ``size`` x and y, or a cylinder where ``radius`` is given. Metres and degrees."""

    name: str
    at: tuple[float, float]
    height: float
    base: float = 0.0
    size: tuple[float, float] | None = None
    radius: float | None = None
    yaw_deg: float = 0.0
    is_covered: bool = False
    """Whether, seen from above, it lies within other parts of its piece."""

    @property
    def area(self) -> float:
        """Of the footprint, m²."""
        return self.size[0] * self.size[1] if self.size else math.pi * (self.radius or 0.0) ** 2

    @property
    def is_low_or_raised(self) -> bool:
        """Whether it ends below the camera or begins above the floor: a planar laser at the camera's height fails."""
        return self.base > 0.0 or self.base + self.height < CAMERA_HEIGHT

    def moved(self, at: tuple[float, float], yaw_deg: float) -> Part:
        """Turned about the piece's origin, which then goes to ``at``."""
        yaw = math.radians(yaw_deg)
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = self.at
        place = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos)
        return replace(self, at=place, yaw_deg=self.yaw_deg + yaw_deg)

    def scaled(self, factor: float) -> Part:
        """With all its floor lengths multiplied by ``factor``; heights stay."""
        return replace(
            self,
            at=(self.at[0] * factor, self.at[1] * factor),
            size=self.size and (self.size[0] * factor, self.size[1] * factor),
            radius=self.radius and self.radius * factor,
        )

    def to_dict(self) -> dict[str, Any]:
        """An entry of a world's ``obstacles``, in whole millimetres and hundredths of a degree."""
        settings: dict[str, Any] = {"name": self.name, "at": [_rounded(value) for value in self.at]}
        if self.size:
            settings["size"] = [_length(value) for value in self.size]
        else:
            settings["radius"] = _length(self.radius or 0.0)
        if self.base:
            settings["base"] = _rounded(self.base)
        settings["height"] = _length(self.height)
        if not self.size:
            return {"cylinder": settings}
        yaw_deg = round(math.remainder(self.yaw_deg, 180.0), 2)  # half a turn brings a box back to itself
        if yaw_deg:
            settings["yaw_deg"] = yaw_deg
        return {"box": settings}


def _rounded(value: float) -> float:
    return round(value, DECIMALS) + 0.0  # no negative zeros


def _length(value: float) -> float:
    return max(_rounded(value), 10.0**-DECIMALS)  # nothing is so small that it is not there


@dataclass(frozen=True)
class Piece:
    """Parts that stand together, and the rectangle around them."""

    parts: tuple[Part, ...]
    half: tuple[float, float]
    """Half the extents of the outline along x and y, metres."""
    at_walls: float = 0.5
    """How often it is tried against something rather than free in the room: 0 never, 1 always."""

    @property
    def area(self) -> float:
        """Floor that is covered, seen from above, m²."""
        return sum(part.area for part in self.parts if not part.is_covered)

    @property
    def low_or_raised(self) -> int:
        """Number of parts that are low or raised."""
        return sum(part.is_low_or_raised for part in self.parts)

    def scaled(self, factor: float) -> Piece:
        """With all its floor lengths multiplied by ``factor``."""
        half = (self.half[0] * factor, self.half[1] * factor)
        return replace(self, parts=tuple(part.scaled(factor) for part in self.parts), half=half)


def box_piece(name: str, size: Sequence[float], height: float, *, base: float = 0.0, at_walls: float = 0.5) -> Piece:
    """One box."""
    x, y = float(size[0]), float(size[1])
    return Piece((Part(name, (0.0, 0.0), height, base, size=(x, y)),), (x / 2, y / 2), at_walls)


def cylinder_piece(name: str, radius: float, height: float, *, at_walls: float = 0.5) -> Piece:
    """One cylinder on the floor."""
    return Piece((Part(name, (0.0, 0.0), height, radius=radius),), (radius, radius), at_walls)


def table(name: str, size: Sequence[float], *, top: float = 0.72, leg: float = 0.025, at_walls: float = 0.3) -> Piece:
    """A top that the robot is low enough for, on four legs."""
    x, y = float(size[0]), float(size[1])
    parts = [Part(f"{name} top", (0.0, 0.0), 0.03, top, size=(x, y))]
    inset_x, inset_y = x / 2 - leg - 0.03, y / 2 - leg - 0.03
    for i, (u, v) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
        parts.append(Part(f"{name} leg {i + 1}", (u * inset_x, v * inset_y), top, radius=leg, is_covered=True))
    return Piece(tuple(parts), (x / 2, y / 2), at_walls)


def round_table(name: str, radius: float, *, top: float = 0.7) -> Piece:
    """A disc on one foot."""
    parts = (
        Part(f"{name} top", (0.0, 0.0), 0.04, top, radius=radius),
        Part(f"{name} foot", (0.0, 0.0), top, radius=0.06, is_covered=True),
    )
    return Piece(parts, (radius, radius), at_walls=0.1)


def bench(name: str, length: float, depth: float = 0.3) -> Piece:
    """A seat at the height of the robot's top plate, on two supports."""
    seat, support = 0.38, 0.06
    supports = [
        Part(f"{name} support {i + 1}", (side * (length / 2 - 0.1), 0.0), seat, size=(support, 0.9 * depth))
        for i, side in enumerate((-1, 1))
    ]
    parts = (
        Part(f"{name} seat", (0.0, 0.0), 0.05, seat, size=(length, depth)),
        *(replace(part, is_covered=True) for part in supports),
    )
    return Piece(parts, (length / 2, depth / 2), at_walls=0.7)


def barrier(name: str, length: float) -> Piece:
    """A bar at the height of the camera between two posts; a scanner near the floor sees the posts only."""
    radius = 0.04
    parts = [Part(f"{name} bar", (0.0, 0.0), 0.1, 0.33, size=(length - 4 * radius, 0.06))]
    for i, side in enumerate((-1, 1)):
        parts.append(Part(f"{name} post {i + 1}", (side * (length / 2 - radius), 0.0), 0.9, radius=radius))
    return Piece(tuple(parts), (length / 2, radius), at_walls=0.0)


def numbered(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces with a number after the names that several of them have: ``can 1``, ``can 2``; ``table 2 leg 3``."""
    stems = [piece.parts[0].name.split(" ")[0] for piece in pieces]
    seen: dict[str, int] = {}
    named = []
    for stem, piece in zip(stems, pieces, strict=True):
        seen[stem] = seen.get(stem, 0) + 1
        if stems.count(stem) > 1:
            new = f"{stem} {seen[stem]}"
            parts = tuple(replace(part, name=new + part.name.removeprefix(stem)) for part in piece.parts)
            piece = replace(piece, parts=parts)
        named.append(piece)
    return named
