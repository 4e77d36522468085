"""The same furniture in another arrangement: many rooms out of one.

A robot that trains in one room learns that room. What stands together in a world (a table top and its legs, a can on a
step) is moved as one piece, to a random place with a random turn, so that every gap is either closed or wide enough.
What moves takes its way along: a piece is as large as all the floor that it sweeps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from navsim.dynamics import DynamicObstacle, dynamic_obstacles
from navsim.footprints import Footprints
from navsim.motion_rules import sweeps
from navsim.prism import Prism
from navsim.world import World

TOGETHER = 0.06
"""Obstacles that are nearer to each other than this, metres, are one piece of furniture."""
_TRIES = 150  # places tried for a piece before it is left out: the room is full
_SWEEP_MARGIN = 1e-3  # metres to the walls, at least, for what moves or can be pushed: its outline is made of points
_SPACING = 0.05  # of the points that stand for a piece's outline, metres


def rearrange(world: World, count: int, generator: np.random.Generator, gap: float = 0.9) -> list[World]:
    """Moves the furniture of a world to random places, many times.

    Args:
        world: the room and its furniture.
        count: arrangements to make.
        generator: the only source of chance.
        gap: least space between two pieces, metres, and between a piece and a wall that it does not stand against.

    Returns:
        worlds with the same pieces, but for those that found no place, and with starts and goals drawn at random.
    """
    pieces = sorted(_pieces(world), key=lambda piece: -piece.extent)
    return [_arranged(world, pieces, generator, gap, f"{world.name} {number + 1}") for number in range(count)]


def _arranged(world: World, pieces: list[_Piece], generator: np.random.Generator, gap: float, name: str) -> World:
    description = world.to_dict()
    obstacles: list[dict[str, Any]] = []
    outlines = np.zeros((0, 2))
    placed: list[tuple[_Piece, np.ndarray, np.ndarray]] = []
    for piece in pieces:
        for _ in range(_TRIES):
            turn, offset = piece.place(generator, world.half_size - piece.margin, gap)
            if offset is None:
                continue
            outline = piece.outline @ turn.T + offset
            if (np.abs(outline) > world.half_size).any():
                continue
            if len(outlines) and piece.footprints.nearest((outlines - offset) @ turn)[0].min() < gap:
                continue
            # What keeps clear of all outlines may still lie within one.
            if any(other.footprints.nearest((outline[:1] - at) @ by)[0].min() < gap for other, by, at in placed):
                continue
            placed.append((piece, turn, offset))
            outlines = np.concatenate([outlines, outline])
            obstacles += [_moved(description["obstacles"][i], turn, offset, piece.centre) for i in piece.members]
            break
    return World.from_dict(description | {"obstacles": obstacles, "starts": "random", "goals": "random", "name": name})


class _Piece:
    """Obstacles that stay together, in coordinates around the middle of them all."""

    def __init__(self, prisms: list[Prism], margins: dict[int, float]) -> None:
        self.members = sorted({prism.obstacle for prism in prisms})
        outline = np.concatenate([_outline(prism) for prism in prisms])
        self.margin = max(margins.get(member, 0.0) for member in self.members)
        self.centre = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
        self.outline = outline - self.centre
        self.extent = float(np.linalg.norm(self.outline, axis=1).max())
        self.footprints = Footprints.of(
            [Prism(p.name, p.obstacle, p.base, p.top, p.vertices - self.centre, p.radius) for p in prisms]
        )

    def place(
        self, generator: np.random.Generator, half_size: np.ndarray, gap: float
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """A rotation ``(2, 2)`` and an offset ``(2,)``: half of the time somewhere in the room, else against a wall.

        There is no offset where it would leave a gap that is narrower than ``gap`` to a wall.
        """
        against_wall = generator.random() < 0.5
        angle = generator.integers(4) * math.pi / 2 if against_wall else generator.uniform(-math.pi, math.pi)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        turned = self.outline @ turn.T
        low, high = -half_size - turned.min(axis=0), half_size - turned.max(axis=0)
        inner_low, inner_high = low + gap, high - gap
        offset = generator.uniform(np.minimum(inner_low, inner_high), np.maximum(inner_low, inner_high))
        needed = np.full(2, 2.0 * gap)
        if against_wall:
            axis = int(generator.integers(2))
            # A hair's breadth off the wall, or rounding would put corners behind it.
            offset[axis] = low[axis] + 1e-6 if generator.random() < 0.5 else high[axis] - 1e-6
            needed[axis] = gap
        return turn, offset if (high - low >= needed).all() else None


def _pieces(world: World) -> list[_Piece]:
    """What stands together, found by following neighbours."""
    prisms = [prism for prism in world.standing_prisms if prism.obstacle >= 0]
    for one in dynamic_obstacles(world):
        if one.moves:
            name = world.obstacles[one.index].name
            swept = sweeps(one, swing_step=_SPACING)
            prisms += [Prism(name, one.index, one.base, one.top, floor.vertices, floor.radius) for floor in swept]
    outlines = [_outline(prism) for prism in prisms]
    piece_of = list(range(len(prisms)))
    for i, prism in enumerate(prisms):
        footprint = Footprints.of([prism])
        for j in range(len(prisms)):
            near = prisms[j].obstacle == prism.obstacle or footprint.nearest(outlines[j])[0].min() < TOGETHER
            if piece_of[j] != piece_of[i] and near:
                old, new = piece_of[j], piece_of[i]
                piece_of = [new if piece == old else piece for piece in piece_of]
    margins = {one.index: _margin(one) for one in dynamic_obstacles(world)}
    members = ([p for p, own in zip(prisms, piece_of, strict=True) if own == piece] for piece in set(piece_of))
    return [_Piece(prisms, margins) for prisms in members]


def _margin(one: DynamicObstacle) -> float:
    """Metres that it keeps to the walls: between the angles at which a swing is looked at, it reaches out further."""
    if not one.swings:
        return _SWEEP_MARGIN
    return max(_SWEEP_MARGIN, one.reach * (1.0 - math.cos(min(0.5 * _SPACING / one.reach, math.pi))))


def _outline(prism: Prism) -> np.ndarray:
    """``(K, 2)`` points along the edge of a footprint, metres; none of it lies beyond them."""
    if prism.is_cylinder and len(prism.vertices) == 1:
        count = max(16, math.ceil(2.0 * math.pi * prism.radius / _SPACING))
        angles = np.linspace(0.0, 2.0 * math.pi, count)
        # What must not reach out of the room lies within its points: they are the corners of a polygon that holds it.
        radius = prism.radius / math.cos(math.pi / (count - 1))
        return prism.vertices[0] + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    if prism.is_cylinder:  # the floor that a cylinder sweeps on a straight way
        ends = [Prism(prism.name, prism.obstacle, 0.0, 1.0, end[None], prism.radius) for end in prism.vertices]
        along = prism.vertices[1] - prism.vertices[0]
        aside = prism.radius * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        steps = np.linspace(0.0, 1.0, max(2, math.ceil(np.linalg.norm(along) / _SPACING)))[:, None]
        sides = [prism.vertices[0] + steps * along + side for side in (aside, -aside)]
        return np.concatenate([*(_outline(end) for end in ends), *sides])
    following = np.roll(prism.vertices, -1, axis=0)
    parts = []
    for begin, end in zip(prism.vertices, following, strict=True):
        count = max(2, math.ceil(np.linalg.norm(end - begin) / _SPACING))
        parts.append(begin + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (end - begin))
    return np.concatenate(parts)


def _moved(obstacle: dict[str, Any], turn: np.ndarray, offset: np.ndarray, centre: np.ndarray) -> dict[str, Any]:
    ((kind, settings),) = obstacle.items()
    moved = dict(settings)
    for key in ("at", "points"):
        if key in moved:
            moved[key] = ((np.asarray(moved[key]) - centre) @ turn.T + offset).tolist()
    if "motion" in moved:
        moved["motion"] = dict(moved["motion"])
        for key in ("path", "hinge"):
            if key in moved["motion"]:
                moved["motion"][key] = ((np.asarray(moved["motion"][key]) - centre) @ turn.T + offset).tolist()
    if kind == "box":
        yaw_deg = float(moved.get("yaw_deg", 0.0)) + math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        moved["yaw_deg"] = math.remainder(yaw_deg, 360.0)
    return {kind: moved}
