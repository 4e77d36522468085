"""Obstacles that do not stand still: where those that move are at any time, and what those that are pushed weigh.

An obstacle's *pose* (x, y, angle) places its footprint: the point of it that the file puts at its *reference point*
stands at (x, y), and the footprint is turned by the angle (radians) from how the file draws it. The reference point is
the first point of a path, the hinge of a swing, the centroid of what can be pushed.

Motion is a closed form of time: a point runs along *knots* (poses) at a constant rate, there and back or round and
round, and a *phase* in [0, 1) says where in its period it is when an episode begins. No state is integrated, nothing
drifts, and any time can be asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navsim.footprints import Footprints
from navsim.prism import Prism
from navsim.view import expand

if TYPE_CHECKING:
    from navsim.world import Obstacle, Pushable, World

GRAVITY = 9.81
"""m/s²"""


class MovingPrisms(NamedTuple):
    """Prisms that robots see where they are, each for one robot; otherwise as the arrays of ``navsim.raycast.Scene``.

    ``M`` prisms with ``V`` vertices in all.
    """

    robot: np.ndarray
    """``(M,)`` intp, the robot that sees each prism, in ascending order"""
    base: np.ndarray
    """``(M,)`` metres"""
    top: np.ndarray
    """``(M,)`` metres"""
    radius: np.ndarray
    """``(M,)`` metres; 0 for polygons"""
    vertices: np.ndarray
    """``(V, 2)`` metres"""
    first_vertex: np.ndarray
    """``(M,)`` intp"""
    vertex_count: np.ndarray
    """``(M,)`` intp"""
    centre: np.ndarray
    """``(M, 2)`` metres"""
    bounding_radius: np.ndarray
    """``(M,)`` metres"""

    def of(self, robots: np.ndarray) -> MovingPrisms:
        """What the robots ``(N,)`` bool see, who are counted anew."""
        kept = np.flatnonzero(robots[self.robot])
        number = np.cumsum(robots) - 1
        own = {name: getattr(self, name)[kept] for name in self._fields if name not in ("robot", "vertices")}
        return self._replace(robot=number[self.robot[kept]], **own)


class Solid(NamedTuple):
    """What the physics of a pushable obstacle depends on."""

    mass: float
    """Kilograms."""
    inertia: float
    """Moment about the vertical through the centroid, kg·m²."""
    deceleration: float
    """μ·g, m/s²."""
    friction_radius: float
    """Mean distance of the footprint's points from the centroid, metres: the arm of floor friction in a pure turn."""


@dataclass(frozen=True, eq=False)
class Part:
    """A convex piece of an obstacle that does not stand still."""

    vertices: np.ndarray
    """``(V, 2)`` metres from the reference point, as the file draws it; ``(1, 2)`` for a cylinder."""
    radius: float
    """Metres; 0 for a polygon."""


@dataclass(frozen=True, eq=False)
class DynamicObstacle:
    """One obstacle that moves or can be pushed."""

    index: int
    """In ``World.obstacles``."""
    reference: np.ndarray
    """``(2,)`` metres."""
    reach: float
    """Metres from the reference point to the farthest point of the footprint."""
    base: float
    top: float
    parts: tuple[Part, ...]
    knots: np.ndarray
    """``(C, 3)`` poses that it moves along; one for a pushable obstacle, where the file puts it."""
    rate: float
    """Metres per second along a path, radians per second about a hinge; 0 for a pushable obstacle."""
    is_circuit: bool
    solid: Solid | None
    """Of a pushable obstacle; None for one that moves by itself."""

    @property
    def moves(self) -> bool:
        """Whether it moves by itself."""
        return self.solid is None

    @property
    def top_speed(self) -> float:
        """Of its fastest point, m/s; 0 for a pushable obstacle."""
        return self.rate * self.reach if self.swings else self.rate

    @property
    def swings(self) -> bool:
        """Whether it turns about a hinge."""
        return bool((self.knots[:, 2] != 0.0).any())


def dynamic_obstacles(world: World) -> tuple[DynamicObstacle, ...]:
    """The obstacles of ``world`` that move by themselves, then those that can be pushed; each in the file's order."""
    if DynamicObstacle not in world.derived:
        moving = [i for i, obstacle in enumerate(world.obstacles) if obstacle.motion is not None]
        pushable = [i for i, obstacle in enumerate(world.obstacles) if obstacle.pushable is not None]
        world.derived[DynamicObstacle] = tuple(_compiled(world.obstacles[i], i) for i in (*moving, *pushable))
    return world.derived[DynamicObstacle]


def _compiled(obstacle: Obstacle, index: int) -> DynamicObstacle:
    motion, footprints = obstacle.motion, obstacle.footprints()
    if motion is not None:
        knots, rate, is_circuit, solid = motion.knots(), motion.rate, motion.is_circuit, None
    else:
        assert obstacle.pushable is not None
        centroid, solid = _weighed(footprints, obstacle.pushable)
        knots, rate, is_circuit = np.array([[*centroid, 0.0]]), 0.0, False
    reference = knots[0, :2]
    parts = tuple(Part(vertices - reference, radius) for vertices, radius in footprints)
    reach = max(float(np.hypot(*part.vertices.T).max()) + part.radius for part in parts)
    return DynamicObstacle(index, reference, reach, obstacle.base, obstacle.top, parts, knots, rate, is_circuit, solid)


def _weighed(footprints: Sequence[tuple[np.ndarray, float]], pushable: Pushable) -> tuple[np.ndarray, Solid]:
    """The centroid ``(2,)``, metres, of a body of even density, and what its physics depends on."""
    deceleration = pushable.friction * GRAVITY
    (vertices, radius), *_ = footprints
    if radius > 0.0:
        solid = Solid(pushable.mass, 0.5 * pushable.mass * radius**2, deceleration, 2.0 / 3.0 * radius)
        return vertices[0], solid
    # Triangles from a point to every edge, with their signs: the edges that convex pieces share cancel out.
    begin = np.concatenate([vertices for vertices, _ in footprints])
    end = np.concatenate([np.roll(vertices, -1, axis=0) for vertices, _ in footprints])
    origin = begin.mean(axis=0)
    a, b = begin - origin, end - origin
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    centroid = origin + ((a + b) * twice[:, None]).sum(axis=0) / (3.0 * twice.sum())
    a, b = begin - centroid, end - centroid
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = 0.5 * twice.sum()
    squared = (twice * ((a * a).sum(axis=1) + (a * b).sum(axis=1) + (b * b).sum(axis=1))).sum() / 12.0
    # Over such a triangle of height h, whose base runs from t to u, the integral of the distance r from its apex is
    # that of r^2 over the angle: h/6 (t sqrt(h^2 + t^2) + h^2 asinh(t/h)) between the two.
    length = np.hypot(*(b - a).T)
    height, along = twice / length, (b - a) / length[:, None]
    beside = np.abs(height) > 1e-12
    h = np.where(beside, height, 1.0)

    def primitive(t: np.ndarray) -> np.ndarray:
        return h / 6.0 * (t * np.hypot(h, t) + h**2 * np.arcsinh(t / np.abs(h)))

    distance = (primitive((b * along).sum(axis=1)) - primitive((a * along).sum(axis=1)))[beside].sum()
    return centroid, Solid(pushable.mass, pushable.mass * squared / area, deceleration, distance / area)


class Dynamics:
    """The obstacles of several worlds that do not stand still, in arrays: worlds are rows, obstacles *slots* of a row.

    ``W`` worlds with at most ``D`` such obstacles each, those that move before those that can be pushed.

    Args:
        worlds: the worlds.
    """

    def __init__(self, worlds: Sequence[World]) -> None:
        self.obstacles = [dynamic_obstacles(world) for world in worlds]
        self.most = max((len(row) for row in self.obstacles), default=0)
        """D"""
        shape = len(worlds), self.most
        corners = max((len(one.knots) for row in self.obstacles for one in row), default=0)
        self.count = np.array([len(row) for row in self.obstacles], dtype=np.intp)
        """``(W,)`` how many each world has"""
        self.reach = np.zeros(shape)
        """``(W, D)`` metres from the reference point to the farthest point"""
        self.base, self.top = np.zeros(shape), np.zeros(shape)
        """``(W, D)`` metres above the floor"""
        self.moves = np.zeros(shape, dtype=bool)
        """``(W, D)`` whether it moves by itself"""
        self.is_pushable = np.zeros(shape, dtype=bool)
        """``(W, D)`` whether it can be pushed"""
        self.top_speed = np.zeros(shape)
        """``(W, D)`` of the fastest point of what moves by itself, m/s"""
        self._knots = np.zeros((*shape, max(corners, 2), 3))
        self._along = np.full((*shape, max(corners, 2)), np.inf)  # way to each knot, metres or radians
        self._along[..., 0] = 0.0
        self._last = np.zeros(shape, dtype=np.intp)  # the last piece between knots
        self._length, self._rate = np.ones(shape), np.zeros(shape)
        self._period = np.ones(shape)  # way until the motion repeats
        for w, row in enumerate(self.obstacles):
            for d, one in enumerate(row):
                self._add(w, d, one)
        self._any_moves = bool(self.moves.any())
        self._pack_parts()

    def _add(self, w: int, d: int, one: DynamicObstacle) -> None:
        self.reach[w, d], self.top_speed[w, d] = one.reach, one.top_speed
        self.base[w, d], self.top[w, d] = one.base, one.top
        self.moves[w, d], self.is_pushable[w, d] = one.moves, not one.moves
        self._knots[w, d] = one.knots[-1]
        self._knots[w, d, : len(one.knots)] = one.knots
        if one.moves:
            along = np.cumsum(np.linalg.norm(np.diff(one.knots, axis=0), axis=1))
            self._along[w, d, 1 : len(one.knots)] = along
            self._last[w, d] = len(one.knots) - 2
            self._length[w, d], self._rate[w, d] = along[-1], one.rate
            self._period[w, d] = along[-1] if one.is_circuit else 2.0 * along[-1]

    def _pack_parts(self) -> None:
        parts = [(one, d, part) for row in self.obstacles for d, one in enumerate(row) for part in one.parts]
        self._part_slot = np.array([d for _, d, _ in parts], dtype=np.intp)
        self._part_base = np.array([one.base for one, _, _ in parts])
        self._part_top = np.array([one.top for one, _, _ in parts])
        self._part_radius = np.array([part.radius for *_, part in parts])
        self._vertices = np.concatenate([part.vertices for *_, part in parts]) if parts else np.zeros((0, 2))
        self._vertex_count = np.array([len(part.vertices) for *_, part in parts], dtype=np.intp)
        self._first_vertex = np.cumsum(self._vertex_count) - self._vertex_count
        in_world = np.array([sum(len(one.parts) for one in row) for row in self.obstacles], dtype=np.intp)
        self._parts_in_world, self._first_in_world = in_world, np.cumsum(in_world) - in_world
        self._parts_in_slot = np.zeros(self.moves.shape, dtype=np.intp)
        for w, row in enumerate(self.obstacles):
            self._parts_in_slot[w, : len(row)] = [len(one.parts) for one in row]
        self._first_in_slot = (
            self._first_in_world[:, None] + np.cumsum(self._parts_in_slot, axis=1) - self._parts_in_slot
        )
        self._footprints = Footprints.of(
            [Prism("", one.index, one.base, one.top, part.vertices, part.radius) for one, _, part in parts]
        )

    def draw_phases(self, world: int, generator: np.random.Generator) -> np.ndarray:
        """``(D,)`` phases of a world's moving obstacles, evenly in [0, 1); 0 for all else, for which none is drawn."""
        phases = np.zeros(self.most)
        phases[self.moves[world]] = generator.random(np.count_nonzero(self.moves[world]))
        return phases

    def poses(self, world_index: np.ndarray, phases: np.ndarray, clock: np.ndarray) -> np.ndarray:
        """Where the obstacles that move by themselves are; those that can be pushed, where the file puts them.

        Args:
            world_index: ``(K,)``.
            phases: ``(K, D)``, in [0, 1).
            clock: ``(K,)`` seconds since the phases were drawn.

        Returns:
            ``(K, D, 3)`` x, y (metres) and angle (radians) from how the file draws it; zeros in empty slots.
        """
        if not self._any_moves:
            return self._knots[world_index, :, 0]
        length, period = self._length[world_index], self._period[world_index]
        way = (phases * period + self._rate[world_index] * clock[:, None]) % period
        way = np.where(way <= length, way, period - way)
        along = self._along[world_index]
        piece = np.minimum((along[..., 1:] <= way[..., None]).sum(axis=-1), self._last[world_index])
        row, slot = world_index[:, None], np.arange(self.most)
        begin, end = self._along[row, slot, piece], self._along[row, slot, piece + 1]
        first, second = self._knots[row, slot, piece], self._knots[row, slot, piece + 1]
        return first + ((way - begin) / (end - begin))[..., None] * (second - first)

    def prisms(self, world_index: np.ndarray, poses: np.ndarray, keep: np.ndarray | None = None) -> MovingPrisms:
        """The obstacles at ``poses`` ``(K, D, 3)``, as K robots in ``world_index`` ``(K,)`` see them.

        Args:
            world_index: each robot's world.
            poses: of its obstacles.
            keep: ``(W, D)`` bool, the obstacles to take; all by default.
        """
        robot, part = expanded(self._first_in_world[world_index], self._parts_in_world[world_index])
        if keep is not None:
            kept = keep[world_index[robot], self._part_slot[part]]
            robot, part = robot[kept], part[kept]
        pose = poses[robot, self._part_slot[part]]
        count = self._vertex_count[part]
        owner, vertex = expanded(self._first_vertex[part], count)
        vertices = placed(self._vertices[vertex], pose[owner])
        first = np.cumsum(count) - count
        if len(part):
            low, high = np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)
        else:
            low = high = np.zeros((0, 2))
        radius = self._part_radius[part]
        return MovingPrisms(
            robot,
            self._part_base[part],
            self._part_top[part],
            radius,
            vertices,
            first,
            count,
            0.5 * (low + high),
            np.hypot(*(0.5 * (high - low)).T) + radius,
        )

    def distances(self, world: np.ndarray, slot: np.ndarray, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Signed distance ``(K,)``, metres, from points to the footprints of obstacles, negative inside.

        Args:
            world: ``(K,)``.
            slot: ``(K,)``, of an obstacle of that world.
            poses: ``(K, 3)``, where the obstacle is.
            points: ``(K, 2)``, metres.
        """
        offset = points - poses[:, :2]
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        local = np.column_stack(
            [offset[:, 0] * cosine + offset[:, 1] * sine, offset[:, 1] * cosine - offset[:, 0] * sine]
        )
        count = self._parts_in_slot[world, slot]
        owner, part = expanded(self._first_in_slot[world, slot], count)
        distance = self._footprints.point_distances(local[owner], part)
        return np.minimum.reduceat(distance, np.cumsum(count) - count) if len(count) else distance


def placed(vertices: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """``vertices`` ``(V, 2)`` of obstacles at ``poses`` ``(V, 3)``, or all at one ``(3,)``, in the world's frame, m."""
    cosine, sine = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    return np.column_stack(
        [
            poses[..., 0] + (vertices[:, 0] * cosine - vertices[:, 1] * sine),
            poses[..., 1] + (vertices[:, 0] * sine + vertices[:, 1] * cosine),
        ]
    )


def outlines(world: World, poses: np.ndarray) -> list[list[tuple[np.ndarray, float]]]:
    """Footprints of a world's ``dynamic_obstacles`` at ``poses`` ``(D, 3)``: for each, vertices and radius by piece."""
    return [
        [(placed(part.vertices, pose), part.radius) for part in one.parts]
        for one, pose in zip(dynamic_obstacles(world), poses, strict=False)
    ]


def expanded(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For ranges that begin at ``first`` (5, 9) and are ``count`` (2, 1) long: owners (0, 0, 1), members (5, 6, 9)."""
    owner, place = expand(count)
    return owner, first[owner] + place
