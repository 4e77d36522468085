"""Placing furniture so that every gap is either closed or wide enough to drive through.

Outlines are rectangles. A piece stands free in the room, or with its back to a wall, or beside other furniture. What
touches belongs to one *group*; between two groups, and between a group and a wall that it does not stand against, there
is at least ``PASSAGE``.

Numbers are plain floats: most places are refused by one of the first rectangles that they are compared with, which is
over before an array would have been made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navsim.generate.pieces import Part, Piece
from navsim.rearrange import TOGETHER

PASSAGE = 1.0
"""Least width of a passage, metres. The 0.4 m rule of the depth image makes the robot effectively 0.8 m wide in
front; the shipped complex rooms have gaps of 1 m as well."""
SLACK = 0.003
"""Metres by which a gap is chosen wider, and furniture stands off a wall: coordinates are then rounded to 1 mm."""
_TRIES = 150  # places tried for a piece before it is given up
_OUTER_WALLS = 4
_WALL, _KEPT_FREE = -1, -2  # groups of what is no furniture


class Rectangle(NamedTuple):
    """A turned rectangle; metres and radians."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float
    cos: float
    sin: float
    reach: float
    """From the middle to a corner."""

    @classmethod
    def of(cls, at: Sequence[float], half: Sequence[float], yaw: float) -> Rectangle:
        """The rectangle around ``at`` with half the extents ``half``."""
        return cls(
            float(at[0]),
            float(at[1]),
            half[0],
            half[1],
            yaw,
            math.cos(yaw),
            math.sin(yaw),
            math.hypot(half[0], half[1]),
        )

    def at(self, along: float, across: float) -> tuple[float, float]:
        """A place given in the rectangle's own frame."""
        return self.x + along * self.cos - across * self.sin, self.y + along * self.sin + across * self.cos


class Placer:
    """Rectangles in a room, to which others are added.

    Args:
        generator: the only source of chance.
        size: of the room, metres.
    """

    def __init__(self, generator: np.random.Generator, size: tuple[float, float]) -> None:
        self._generator = generator
        self._half_size = (0.5 * size[0], 0.5 * size[1])
        self.parts: list[Part] = []
        """What has been placed, in the room's coordinates."""
        self._rectangles: list[Rectangle] = []
        self._groups: list[int] = []  # of each rectangle: furniture from 0 up, or _WALL or _KEPT_FREE
        self._walls: list[int] = []  # positions in _rectangles
        self._furniture: list[int] = []
        self._number_of_groups = 0
        (x, y), t = self._half_size, 0.5
        for centre, half, yaw in (
            ((0.0, -y - t), (x, t), 0.0),
            ((x + t, 0.0), (y, t), math.pi / 2),
            ((0.0, y + t), (x, t), math.pi),
            ((-x - t, 0.0), (y, t), -math.pi / 2),
        ):
            self._add(Rectangle.of(centre, half, yaw), _WALL)

    def add_wall(self, part: Part) -> None:
        """A wall in the room: furniture may stand against its long sides."""
        assert part.size is not None
        self.parts.append(part)
        half = (part.size[0] / 2, part.size[1] / 2)
        self._add(Rectangle.of(part.at, half, math.radians(part.yaw_deg)), _WALL)

    def add_fixed(self, piece: Piece, at: tuple[float, float], yaw_deg: float) -> None:
        """Furniture whose place is decided already."""
        self._put(piece, Rectangle.of(at, piece.half, math.radians(yaw_deg)), None)

    def keep_free(self, centre: tuple[float, float], half: tuple[float, float]) -> None:
        """A rectangle along the axes that nothing may be placed in."""
        self._add(Rectangle.of(centre, half, 0.0), _KEPT_FREE)

    def place(self, piece: Piece, *, square: bool = False, joins: float = 0.15) -> bool:
        """Finds a place for a piece, and says whether there was one.

        Args:
            piece: what to place.
            square: free in the room, turn it by multiples of 90° only.
            joins: share of the tries in which it is put beside other furniture.
        """
        for chances in self._generator.random((_TRIES, 5)).tolist():
            place, host = self._candidate(piece, chances, square, joins)
            if self._fits(place, host):
                self._put(piece, place, host)
                return True
        return False

    def _put(self, piece: Piece, place: Rectangle, host: int | None) -> None:
        group = self._groups[host] if host is not None else _WALL
        if group < 0:
            group = self._number_of_groups
            self._number_of_groups += 1
        self.parts += [part.moved((place.x, place.y), math.degrees(place.yaw)) for part in piece.parts]
        self._add(place, group)

    def _add(self, rectangle: Rectangle, group: int) -> None:
        if group != _KEPT_FREE:
            (self._walls if group == _WALL else self._furniture).append(len(self._rectangles))
        self._rectangles.append(rectangle)
        self._groups.append(group)

    def _candidate(
        self, piece: Piece, chances: Sequence[float], square: bool, joins: float
    ) -> tuple[Rectangle, int | None]:
        """A place to try, and the position of what it stands against."""
        manner, which, side, along, turn = chances
        joins = joins if self._furniture and piece.at_walls > 0.0 else 0.0
        if manner < joins:
            host = self._furniture[int(which * len(self._furniture))]
            return self._beside(piece, self._rectangles[host], side, along, turn), host
        if manner < joins + (1.0 - joins) * piece.at_walls:
            host = self._wall(which)
            return self._against(piece, host, side, along), host
        room_x, room_y = (max(0.0, half - min(piece.half) - SLACK) for half in self._half_size)
        yaw = math.floor(4.0 * turn) * math.pi / 2 if square else (2.0 * turn - 1.0) * math.pi
        return Rectangle.of(((2.0 * which - 1.0) * room_x, (2.0 * along - 1.0) * room_y), piece.half, yaw), None

    def _wall(self, chance: float) -> int:
        """One of the walls, as likely as it is long."""
        left = chance * sum(self._rectangles[wall].half_x for wall in self._walls)
        for wall in self._walls:
            left -= self._rectangles[wall].half_x
            if left < 0.0:
                return wall
        return self._walls[-1]

    def _against(self, piece: Piece, host: int, side: float, along: float) -> Rectangle:
        """With its back to a wall; in a corner, now and then."""
        wall = self._rectangles[host]
        turned = host >= _OUTER_WALLS and side < 0.5  # partitions have two sides
        reach = max(0.0, wall.half_x - piece.half[0] - SLACK)
        shift = min(reach, max(-reach, (2.0 * along - 1.0) * 1.15 * reach))
        across = wall.half_y + piece.half[1] + SLACK
        return Rectangle.of(
            wall.at(shift, -across if turned else across), piece.half, wall.yaw + (math.pi if turned else 0.0)
        )

    def _beside(self, piece: Piece, host: Rectangle, side: float, along: float, turn: float) -> Rectangle:
        """Beside other furniture with the backs in line, or in front of it."""
        if side < 0.7:
            away = host.half_x + piece.half[0] + SLACK
            place = host.at(away if along < 0.5 else -away, piece.half[1] - host.half_y)
        else:
            place = host.at((2.0 * turn - 1.0) * host.half_x, host.half_y + piece.half[1] + SLACK)
        return Rectangle.of(place, piece.half, host.yaw)

    def _fits(self, place: Rectangle, host: int | None) -> bool:
        """Whether a piece there keeps its distance from all that stands already."""
        if abs(place.x) > self._half_size[0] or abs(place.y) > self._half_size[1]:
            return False
        own = self._groups[host] if host is not None else _WALL
        gap = PASSAGE + SLACK
        for rectangle, group in zip(self._rectangles, self._groups, strict=True):
            if math.hypot(rectangle.x - place.x, rectangle.y - place.y) - rectangle.reach - place.reach >= gap:
                continue
            distance = rectangle_distance(place, rectangle, gap)
            touches = distance >= 0.5 * SLACK
            if group == _KEPT_FREE or (group == own and group >= 0):
                if not touches:
                    return False
            elif distance < gap and not (group == _WALL and touches and distance <= TOGETHER):
                return False
        return True


def rectangle_distance(one: Rectangle, other: Rectangle, enough: float = math.inf) -> float:
    """Distance of two turned rectangles, metres; not positive where they overlap.

    Whether they are apart is told by the directions of their sides (the separating axis theorem); apart, the least
    distance is at a corner of one of them.

    Args:
        one: a rectangle.
        other: another.
        enough: metres; where they are further apart than this, any number between this and the distance will do.
    """
    dx, dy = other.x - one.x, other.y - one.y
    x, y = dx * one.cos + dy * one.sin, dy * one.cos - dx * one.sin
    u, v = dx * other.cos + dy * other.sin, dy * other.cos - dx * other.sin
    c, s = one.cos * other.cos + one.sin * other.sin, one.cos * other.sin - one.sin * other.cos
    a, b, p, q = one.half_x, one.half_y, other.half_x, other.half_y
    turn_c, turn_s = abs(c), abs(s)
    apart = max(
        abs(x) - a - p * turn_c - q * turn_s,
        abs(y) - b - p * turn_s - q * turn_c,
        abs(u) - p - a * turn_c - b * turn_s,
        abs(v) - q - a * turn_s - b * turn_c,
    )
    if apart <= 0.0 or apart >= enough:
        return apart
    return math.sqrt(min(_outside(x, y, c, s, p, q, a, b), _outside(-u, -v, c, -s, a, b, p, q)))


def _outside(x: float, y: float, c: float, s: float, p: float, q: float, a: float, b: float) -> float:
    """Least squared distance from the corners of a rectangle ``(p, q)``, turned by c and s, to the one ``(a, b)``."""
    least = math.inf
    for i, j in ((p, q), (p, -q), (-p, q), (-p, -q)):
        dx = max(0.0, abs(x + i * c - j * s) - a)
        dy = max(0.0, abs(y + i * s + j * c) - b)
        least = min(least, dx * dx + dy * dy)
    return least
