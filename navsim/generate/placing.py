"""Placing furniture so that every gap is either closed or wide enough to drive through.

Outlines are rectangles. A piece stands free in the room, or with its back to a wall, or beside other furniture; what
touches belongs to one *group*, and between two groups, and between a group and a wall that it does not stand against,
there is at least ``PASSAGE``.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.generate.pieces import Part, Piece
from navsim.rearrange import TOGETHER

PASSAGE = 1.0
"""Least width of a passage, metres. The 0.4 m rule of the depth image makes the robot effectively 0.8 m wide in
front; the shipped complex rooms have gaps of 1 m as well."""
SLACK = 0.003
"""Metres by which a gap is chosen wider, and furniture stands off a wall: coordinates are then rounded to 1 mm."""
_BATCHES = (12, 24, 48, 96)  # places tried for a piece, all at once, before it is given up


class Placer:
    """Rectangles in a room, to which others are added.

    Args:
        generator: the only source of chance.
        size: ``(2,)`` of the room, metres.
    """

    def __init__(self, generator: np.random.Generator, size: tuple[float, float]) -> None:
        self._generator = generator
        self._half_size = 0.5 * np.asarray(size, dtype=np.float64)
        self.parts: list[Part] = []
        """What has been placed, in the room's coordinates."""
        self._centre = np.empty((0, 2))
        self._half = np.empty((0, 2))
        self._yaw = np.empty(0)
        self._group = np.empty(0, dtype=np.intp)  # furniture from 0 up; _WALL and _KEPT_FREE
        self._groups = 0
        (x, y), t = self._half_size, 0.5
        for centre, half, yaw in (
            ((0.0, -y - t), (x + 2 * t, t), 0.0),
            ((x + t, 0.0), (y + 2 * t, t), math.pi / 2),
            ((0.0, y + t), (x + 2 * t, t), math.pi),
            ((-x - t, 0.0), (y + 2 * t, t), -math.pi / 2),
        ):
            self._add(centre, half, yaw, _WALL)

    def add_wall(self, part: Part) -> None:
        """A wall in the room: furniture may stand against its long sides."""
        assert part.size is not None
        self.parts.append(part)
        self._add(part.at, (part.size[0] / 2, part.size[1] / 2), math.radians(part.yaw_deg), _WALL)

    def add_fixed(self, piece: Piece, at: np.ndarray, yaw_deg: float) -> None:
        """Furniture whose place is decided already."""
        self.parts += [part.moved(at, yaw_deg) for part in piece.parts]
        self._add(at, piece.half, math.radians(yaw_deg), self._groups)
        self._groups += 1

    def keep_free(self, centre: np.ndarray, half: tuple[float, float], yaw: float = 0.0) -> None:
        """A rectangle that nothing may be placed in."""
        self._add(centre, half, yaw, _KEPT_FREE)

    def place(self, piece: Piece, *, square: bool = False, joins: float = 0.15) -> bool:
        """Finds a place for a piece, and says whether there was one.

        Args:
            piece: what to place.
            square: free in the room, turn it by multiples of 90° only.
            joins: share of the tries in which it is put beside other furniture.
        """
        half = np.asarray(piece.half) + 0.0
        for count in _BATCHES:
            centre, yaw, host = self._candidates(piece, count, square, joins)
            fits = self._fits(centre, half, yaw, host)
            if fits.any():
                chosen = int(np.argmax(fits))
                group = self._group[host[chosen]] if host[chosen] >= 0 else -1
                if group < 0:
                    group = self._groups
                    self._groups += 1
                self.parts += [part.moved(centre[chosen], math.degrees(yaw[chosen])) for part in piece.parts]
                self._add(centre[chosen], half, float(yaw[chosen]), int(group))
                return True
        return False

    def _add(self, centre, half, yaw: float, group: int) -> None:
        self._centre = np.vstack([self._centre, centre])
        self._half = np.vstack([self._half, half])
        self._yaw = np.append(self._yaw, yaw)
        self._group = np.append(self._group, group)

    def _candidates(
        self, piece: Piece, count: int, square: bool, joins: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places to try: centres ``(K, 2)``, yaws ``(K,)``, and what each one stands against, −1 for nothing."""
        draw = self._generator
        half = np.asarray(piece.half)
        choice = draw.random((count, 5))
        room = np.maximum(self._half_size - half.min() - SLACK, 0.0)
        centre = draw.uniform(-1.0, 1.0, (count, 2)) * room
        yaw = np.floor(4.0 * choice[:, 0]) * (math.pi / 2) if square else (2.0 * choice[:, 0] - 1.0) * math.pi
        host = np.full(count, -1, dtype=np.intp)
        walls, others = np.flatnonzero(self._group == _WALL), np.flatnonzero(self._group >= 0)
        joins = joins if len(others) and piece.at_walls > 0.0 else 0.0
        beside = choice[:, 1] < joins
        against = ~beside & (choice[:, 1] < joins + (1.0 - joins) * piece.at_walls)

        rows = np.flatnonzero(against)
        if len(rows):
            # A wall is as likely as it is long.
            length = np.cumsum(self._half[walls, 0])
            index = walls[np.searchsorted(length, choice[rows, 2] * length[-1]).clip(max=len(walls) - 1)]
            back = np.where(index < 4, 1.0, np.where(choice[rows, 3] < 0.5, 1.0, -1.0))  # partitions have two sides
            reach = np.where(index < 4, self._half[index, 0] - 1.0, self._half[index, 0]) - half[0] - SLACK
            along = (2.0 * choice[rows, 4] - 1.0) * np.maximum(reach, 0.0) * 1.15  # often in the corner
            along = np.clip(along, -np.maximum(reach, 0.0), np.maximum(reach, 0.0))
            across = self._half[index, 1] + half[1] + SLACK
            yaw[rows] = self._yaw[index] + np.where(back > 0, 0.0, math.pi)
            centre[rows] = self._centre[index] + _turned(np.column_stack([along, back * across]), self._yaw[index])
            host[rows] = index
        rows = np.flatnonzero(beside)
        if len(rows):
            index = others[np.minimum((choice[rows, 2] * len(others)).astype(np.intp), len(others) - 1)]
            sideways = choice[rows, 3] < 0.7  # the rest in front
            sign = np.where(choice[rows, 4] < 0.5, -1.0, 1.0)
            flush = half[1] - self._half[index, 1]  # backs in line
            shift = centre[rows, 0] / max(room[0], 1e-9) * self._half[index, 0]
            x = np.where(sideways, sign * (self._half[index, 0] + half[0] + SLACK), shift)
            y = np.where(sideways, flush, self._half[index, 1] + half[1] + SLACK)
            yaw[rows] = self._yaw[index]
            centre[rows] = self._centre[index] + _turned(np.column_stack([x, y]), self._yaw[index])
            host[rows] = index
        return centre, yaw, host

    def _fits(self, centre: np.ndarray, half: np.ndarray, yaw: np.ndarray, host: np.ndarray) -> np.ndarray:
        """Whether a rectangle at each place keeps its distance from all that is there: ``(K,)``."""
        halves = np.broadcast_to(half, centre.shape)
        distance = rectangle_distances(centre, halves, yaw, self._centre, self._half, self._yaw)
        needed = np.where(self._group == _KEPT_FREE, 1e-6, PASSAGE + SLACK)
        own = np.where(host >= 0, self._group[host], -1)
        joined = (self._group == own[:, None]) & (self._group >= 0)
        leans = (self._group == _WALL) & (distance <= TOGETHER)
        touches = np.where(joined | leans, 0.5 * SLACK, needed)
        return (distance >= touches).all(axis=1)


_WALL, _KEPT_FREE = -1, -2


def rectangle_distances(
    centre: np.ndarray,
    half: np.ndarray,
    yaw: np.ndarray,
    other_centre: np.ndarray,
    other_half: np.ndarray,
    other_yaw: np.ndarray,
) -> np.ndarray:
    """Distances between ``K`` and ``M`` turned rectangles, ``(K, M)``, metres; not positive where two overlap.

    Apart, the least distance of two rectangles is at a corner of one of them. Whether they are apart is told by the
    four directions of their sides (the separating axis theorem).

    Args:
        centre: ``(K, 2)``, metres.
        half: ``(K, 2)`` half the extents, metres.
        yaw: ``(K,)`` radians.
        other_centre: ``(M, 2)``.
        other_half: ``(M, 2)``.
        other_yaw: ``(M,)``.
    """
    offset = other_centre - centre[:, None]  # (K, M, 2)
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin
    other_cos, other_sin = np.cos(other_yaw), np.sin(other_yaw)
    u = offset[..., 0] * other_cos + offset[..., 1] * other_sin
    v = offset[..., 1] * other_cos - offset[..., 0] * other_sin
    c, s = cos * other_cos + sin * other_sin, cos * other_sin - sin * other_cos  # of the turn between the two
    a, b = half[:, :1], half[:, 1:]
    p, q = other_half[:, 0], other_half[:, 1]
    here = _outside(x, y, c, s, p, q, a, b)
    there = _outside(-u, -v, c, -s, a, b, p, q)
    reach_x, reach_y = p * abs(c) + q * abs(s), p * abs(s) + q * abs(c)
    reach_u, reach_v = a * abs(c) + b * abs(s), a * abs(s) + b * abs(c)
    apart = np.maximum(
        np.maximum(abs(x) - a - reach_x, abs(y) - b - reach_y), np.maximum(abs(u) - p - reach_u, abs(v) - q - reach_v)
    )
    return np.where(apart > 0.0, np.sqrt(np.minimum(here, there)), apart)


def _outside(x, y, c, s, p, q, a, b) -> np.ndarray:
    """Least squared distance of the corners of a rectangle ``(p, q)`` at ``(x, y)``, turned by c, s, from ``(a, b)``."""
    px, py, qx, qy = p * c, p * s, -q * s, q * c
    least = None
    for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        dx = np.maximum(abs(x + i * px + j * qx) - a, 0.0)
        dy = np.maximum(abs(y + i * py + j * qy) - b, 0.0)
        squared = dx * dx + dy * dy
        least = squared if least is None else np.minimum(least, squared)
    assert least is not None
    return least


def _turned(points: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.column_stack([points[:, 0] * cos - points[:, 1] * sin, points[:, 0] * sin + points[:, 1] * cos])
