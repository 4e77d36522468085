"""Clearance, shortest paths and distance fields for a disc-shaped robot in a world.

Only prisms that share some height with the robot block it, and of these only what stands: a moving obstacle lets the
robot pass sooner or later, and a pushable one stands where the file puts it. The robot's centre stays at least its
radius from them and from the walls. Where there are no walls, paths may leave the room's rectangle by up to
``OPEN_FLOOR_MARGIN``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from navsim.connectivity import Chains
from navsim.footprints import Footprints
from navsim.prism import Prism
from navsim.robot import TURTLEBOT2
from navsim.tangents import TangentGraph

if TYPE_CHECKING:
    from navsim.world import World

OPEN_FLOOR_MARGIN = 2.0
"""Metres that a path may lead outside the rectangle of a room without walls."""
EXACT_UP_TO = 300
"""Obstacles in the robot's way up to which shortest paths are exact."""
SIGHT_LINES = 4.0
"""Among more obstacles, sight lines are looked for up to this many times the mean way to the next obstacle."""
CONTACT = 1e-7
"""Metres: the robot fits where it lacks this much room."""


def clearance(prisms: Sequence[Prism], points: ArrayLike, low: float = 0.0, high: float = math.inf) -> np.ndarray:
    """Distance, metres, from each point to the nearest footprint: ``(K,)`` float64.

    Negative inside a footprint; infinite where no prism counts.

    Args:
        prisms: what to keep clear of, such as ``world.prisms``.
        points: ``(K, 2)``, metres.
        low: a prism counts when some height in the open range (``low``, ``high``) belongs to it, metres.
        high: metres.
    """
    places = _points(points, "points")
    return _footprints(tuple(prisms), low, high).nearest(places)[0]


def connected(
    world: World,
    starts: ArrayLike,
    goals: ArrayLike,
    robot_radius: float = TURTLEBOT2.radius,
    robot_height: float = TURTLEBOT2.height,
) -> np.ndarray:
    """Whether the robot's centre can move from ``starts[k]`` to ``goals[k]``: ``(K,)`` bool. Exact.

    False where it does not fit at either of them.

    Args:
        world: where it moves.
        starts: ``(K, 2)``, metres.
        goals: ``(K, 2)``, metres.
        robot_radius: metres.
        robot_height: metres.
    """
    begins, ends = _points(starts, "starts"), _points(goals, "goals")
    if begins.shape != ends.shape:
        raise ValueError(f"starts and goals must be as many as each other, not {len(begins)} and {len(ends)}")
    begin, end = np.split(free_space(world, robot_radius, robot_height).regions(np.concatenate([begins, ends])), 2)
    return (begin == end) & (begin >= 0)


def shortest_path(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    robot_radius: float = TURTLEBOT2.radius,
    robot_height: float = TURTLEBOT2.height,
    goal_radius: float = 0.5,
) -> np.ndarray | None:
    """The shortest way of the robot's centre from ``start`` to the disc around ``goal``: a polyline ``(K, 2)``, metres.

    None when there is no way, or when the robot does not fit at ``start``. Turns around obstacles are arcs, given by
    points 3° apart. The path is exact among up to ``EXACT_UP_TO`` obstacles; in larger worlds very long sight lines
    are left out, and it may be longer than the shortest by a fraction of a percent.

    Args:
        world: where it leads.
        start: ``(2,)``, metres.
        goal: ``(2,)``, metres.
        robot_radius: metres.
        robot_height: metres.
        goal_radius: distance from ``goal`` at which the path ends, metres.
    """
    length, corners = _shortest(world, start, goal, robot_radius, robot_height, goal_radius)
    return corners if math.isfinite(length) else None


def shortest_path_length(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    robot_radius: float = TURTLEBOT2.radius,
    robot_height: float = TURTLEBOT2.height,
    goal_radius: float = 0.5,
) -> float:
    """Length of :func:`shortest_path`, metres, with its turns as true arcs; infinite when there is no way."""
    return _shortest(world, start, goal, robot_radius, robot_height, goal_radius)[0]


class DistanceField:
    """How far it still is to the disc around a goal for the robot's centre, from anywhere in a world.

    Distances are exact, up to interpolation, where the goal is in sight within ``SIGHT``. Elsewhere they follow moves
    between the points of a grid, in 32 directions: they exceed the length of the shortest path by up to 1.4%, and by
    up to a grid spacing for each turn around an obstacle. Gaps that no row of grid points leads through count as shut.

    Args:
        world: where the robot is.
        goal: ``(2,)``, metres.
        resolution: greatest distance between neighbouring points of the grid along x and y, metres.
        robot_radius: metres.
        robot_height: metres.
        goal_radius: distance from ``goal`` at which the way ends, metres.
    """

    SIGHT = 5.0
    """Metres."""

    def __init__(
        self,
        world: World,
        goal: ArrayLike,
        resolution: float = 0.05,
        robot_radius: float = TURTLEBOT2.radius,
        robot_height: float = TURTLEBOT2.height,
        goal_radius: float = 0.5,
    ) -> None:
        self._goal = _point(goal, "goal")
        self._goal_radius = _not_negative(goal_radius, "goal_radius")
        self._space = free_space(world, robot_radius, robot_height)
        self._grid = self._space.grid(_positive(resolution, "resolution"))
        self._distance = self._distances_on_grid()

    def __call__(self, points: ArrayLike) -> np.ndarray:
        """Distances ``(K,)`` float64, metres, from ``points`` ``(K, 2)``; infinite where the robot does not fit.

        Infinite too where it cannot reach the goal, or stands in a gap too narrow for the grid.
        """
        places = _points(points, "points")
        corners, weights, steps = self._grid.around(places)
        values = self._distance[corners]
        known = np.isfinite(values).all(axis=1)
        blended = (np.where(known[:, None], values, 0.0) * weights).sum(axis=1)
        distance = np.where(known, blended, (values + steps).min(axis=1))
        straight = np.linalg.norm(places - self._goal, axis=1) - self._goal_radius
        return np.where(self._space.fits(places), np.maximum(distance, np.maximum(straight, 0.0)), np.inf)

    def _distances_on_grid(self) -> np.ndarray:
        grid, space = self._grid, self._space
        towards = self._goal - grid.points
        away = np.linalg.norm(towards, axis=1)
        near = np.flatnonzero(grid.free & (away <= self.SIGHT + self._goal_radius))
        left = np.maximum(away[near] - self._goal_radius, 0.0)
        ends = grid.points[near] + (left / np.maximum(away[near], left + CONTACT))[:, None] * towards[near]
        seen = space.passes(grid.points[near], ends)
        return grid.distances(near[seen], left[seen])


class FreeSpace:
    """Where a robot's centre may be in a world.

    Args:
        world: the world.
        robot_radius: metres.
        robot_height: metres.
    """

    def __init__(self, world: World, robot_radius: float, robot_height: float) -> None:
        self.blocking = [p for p in world.standing_prisms if p.obstacle >= 0 and p.overlaps_heights(0.0, robot_height)]
        """The prisms in the robot's way, without the walls and without what moves by itself."""
        margin = OPEN_FLOOR_MARGIN if world.walls is None else -robot_radius
        self.robot_radius = robot_radius
        self._has_walls = world.walls is not None
        self.half_extents = world.half_size + margin
        """``(2,)``: the robot's centre stays within these of the origin along x and y, metres."""
        self.obstacles = Footprints.of(self.blocking)
        """Their footprints."""
        self._clear = self.obstacles.radius + robot_radius - CONTACT
        self._graphs: dict[float, TangentGraph] = {}
        self._grids: dict[float, _Grid] = {}

    def fits(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot's centre may be at ``points`` ``(K, 2)``: ``(K,)`` bool."""
        inside = (np.abs(points) <= self.half_extents + CONTACT).all(axis=1)
        return inside & self.obstacles.points_keep_clear(points, self._clear)

    def fits_with_room(self, points: np.ndarray, room: float) -> np.ndarray:
        """Whether, at ``points`` ``(K, 2)``, it fits and could move by ``room``, metres, any way: ``(K,)`` bool."""
        clear = self.obstacles.points_keep_clear(points, self._clear + room)
        if self._has_walls:
            clear &= (np.abs(points) <= self.half_extents - room + CONTACT).all(axis=1)
        return clear

    def passes(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Whether it may move straight from ``starts`` to ``ends``, ``(K, 2)``, both within the extents: ``(K,)``."""
        return self.obstacles.segments_keep_clear(starts, ends, self._clear)

    def regions(self, points: np.ndarray) -> np.ndarray:
        """A number ``(K,)`` for each of ``points`` ``(K, 2)``, equal for connected ones; −1 where it does not fit."""
        regions = np.full(len(points), -1, dtype=np.intp)
        fits = self.fits(points)
        regions[fits] = self._chains.regions(points[fits])
        return regions

    def shortest_path(self, start: np.ndarray, goal: np.ndarray, goal_radius: float) -> tuple[float, np.ndarray]:
        """Length, metres, and corners ``(K, 2)`` of the shortest path; infinite and empty when there is none."""
        begin, end = complex(*start), complex(*goal)
        if not self.fits(start[None])[0]:
            return math.inf, np.empty((0, 2))
        if abs(end - begin) <= goal_radius:
            return 0.0, start[None]
        reach = self._first_reach
        if reach < math.inf and not self._is_reachable(start, goal, goal_radius):
            return math.inf, np.empty((0, 2))
        while True:
            length, corners = self._graph(reach).shortest_path(begin, end, goal_radius)
            if math.isfinite(length) or reach == math.inf:
                return length, np.column_stack([corners.real, corners.imag])
            reach = 2.0 * reach if reach < 4.0 * self.half_extents.max() else math.inf

    def grid(self, resolution: float) -> _Grid:
        """The grid of this space, with neighbouring points at most ``resolution``, metres, apart."""
        if resolution not in self._grids:
            self._grids[resolution] = _Grid(self, resolution)
        return self._grids[resolution]

    def _graph(self, reach: float) -> TangentGraph:
        if reach not in self._graphs:
            self._graphs[reach] = TangentGraph(self.obstacles, self.robot_radius, self.half_extents, reach)
        return self._graphs[reach]

    @property
    def _first_reach(self) -> float:
        count = len(self.obstacles)
        if count <= EXACT_UP_TO:
            return math.inf
        widths = 2.0 * float(np.sum(self.obstacles.inner + self.obstacles.radius + self.robot_radius))
        return SIGHT_LINES * 4.0 * float(np.prod(self.half_extents)) / widths

    def _is_reachable(self, start: np.ndarray, goal: np.ndarray, goal_radius: float) -> bool:
        """Whether ``start``, outside the goal's disc, is connected with it.

        The way in leads over the goal's circle, which is free all around, or in arcs that end beside obstacles.
        """
        beside = self._graph(self._first_reach).ends_beside_obstacles(complex(*goal), goal_radius)
        places = np.column_stack([beside.real, beside.imag])
        regions = self.regions(np.concatenate([start[None], goal[None] + (goal_radius, 0.0), places]))
        return bool((regions[1:] == regions[0]).any())

    @cached_property
    def _chains(self) -> Chains:
        (x, y), r = self.half_extents, self.robot_radius
        rims = []
        for low, high in (
            ((-x - 3.0 * r, y + r), (x + 3.0 * r, y + 3.0 * r)),
            ((x + r, -y - 2.0 * r), (x + 3.0 * r, y + 2.0 * r)),
            ((-x - 3.0 * r, -y - 3.0 * r), (x + 3.0 * r, -y - r)),
            ((-x - 3.0 * r, -y - 2.0 * r), (-x - r, y + 2.0 * r)),
        ):
            corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
            rims.append(Prism("rim", -1, 0.0, 1.0, corners))
        return Chains(Footprints.of([*self.blocking, *rims]), r)


def free_space(world: World, robot_radius: float, robot_height: float) -> FreeSpace:
    """The free space of a robot in ``world``; made once for each world and size of robot."""
    size = (_positive(robot_radius, "robot_radius"), _positive(robot_height, "robot_height"))
    if (FreeSpace, size) not in world.derived:
        world.derived[FreeSpace, size] = FreeSpace(world, *size)
    return world.derived[FreeSpace, size]


class _Grid:
    """Points of a regular grid over a free space, and the straight moves between them that are free.

    Args:
        space: the free space.
        resolution: greatest distance between neighbouring points, metres.
    """

    DIRECTIONS = tuple(
        (dx, dy) for dx in range(4) for dy in range(-3, 4) if math.gcd(dx, dy) == 1 and (dx > 0 or dy > 0)
    )
    """Half of the 32 directions that moves take, as columns and rows; moves lead both ways."""
    MOST_POINTS = 4_000_000

    def __init__(self, space: FreeSpace, resolution: float) -> None:
        shape = np.maximum(np.ceil(2.0 * space.half_extents / resolution), 1.0) + 1.0
        if np.prod(shape) > self.MOST_POINTS:
            coarser = resolution * math.sqrt(np.prod(shape) / self.MOST_POINTS)
            raise ValueError(f"resolution {resolution:g} m is too fine for this room; use {coarser:.2g} m or more")
        self._columns, self._rows = (int(n) for n in shape)
        self._low = -space.half_extents
        self._spacing = 2.0 * space.half_extents / (shape - 1.0)
        y, x = np.divmod(np.arange(self._columns * self._rows), self._columns)
        self.points = self._low + np.column_stack([x, y]) * self._spacing
        """``(N, 2)``, metres, row by row from the least y on."""
        self.free = space.fits(self.points)
        """``(N,)`` bool: whether the robot fits."""
        self._moves = self._free_moves(space)

    def distances(self, sources: np.ndarray, initial: np.ndarray) -> np.ndarray:
        """The length of the shortest way along moves from each point to any of ``sources``: ``(N,)``, metres.

        Args:
            sources: ``(S,)``, indices of points.
            initial: ``(S,)``, metres to be added where the way ends in each of them.
        """
        count, moves = len(self.points), self._moves
        pointers = np.append(moves.indptr, moves.nnz + len(sources))
        columns = np.append(moves.indices, sources)
        graph = csr_array((np.append(moves.data, initial), columns, pointers), shape=(count + 1, count + 1))
        return dijkstra(graph, indices=count)[:count]

    def around(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The four points of the grid around each of ``points`` ``(K, 2)``; the nearest four for places outside.

        Returns:
            indices ``(K, 4)``; bilinear weights ``(K, 4)``; distances from the point ``(K, 4)``, metres.
        """
        cells = np.array([self._columns - 1, self._rows - 1])
        place = np.clip((points - self._low) / self._spacing, 0.0, cells)
        cell = np.minimum(place.astype(np.intp), cells - 1)
        share = place - cell
        x, y = cell.T
        corners = (y * self._columns + x)[:, None] + np.array([0, 1, self._columns, self._columns + 1])
        along_x = np.column_stack([1.0 - share[:, 0], share[:, 0]])
        along_y = np.column_stack([1.0 - share[:, 1], share[:, 1]])
        weights = (along_y[:, :, None] * along_x[:, None, :]).reshape(-1, 4)
        return corners, weights, np.linalg.norm(self.points[corners] - points[:, None], axis=2)

    def _free_moves(self, space: FreeSpace) -> csr_array:
        """The moves that are free, with their lengths, metres, as a graph: ``(N, N)``."""
        index = np.arange(len(self.points)).reshape(self._rows, self._columns)
        tails, heads = [], []
        for dx, dy in self.DIRECTIONS:
            if abs(dy) >= self._rows or dx >= self._columns:
                continue
            last_row, last_column = self._rows - abs(dy), self._columns - dx
            down, up = max(-dy, 0), max(dy, 0)
            tails.append(index[down : down + last_row, :last_column].ravel())
            heads.append(index[up : up + last_row, dx:].ravel())
        tail, head = np.concatenate(tails), np.concatenate(heads)  # a grid has two rows and columns at least
        fits = self.free[tail] & self.free[head]
        tail, head = tail[fits], head[fits]
        length = np.linalg.norm(self.points[head] - self.points[tail], axis=1)
        roomy = space.fits_with_room(self.points, float(length.max(initial=0.0)))
        doubtful = np.flatnonzero(~roomy[tail])
        passes = np.ones(len(tail), dtype=bool)
        passes[doubtful] = space.passes(self.points[tail[doubtful]], self.points[head[doubtful]])
        tail, head, length = tail[passes], head[passes], length[passes]
        ends = (np.append(tail, head), np.append(head, tail))
        return coo_array((np.append(length, length), ends), shape=(len(self.points),) * 2).tocsr()


@lru_cache(maxsize=32)
def _footprints(prisms: tuple[Prism, ...], low: float, high: float) -> Footprints:
    return Footprints.of([prism for prism in prisms if prism.overlaps_heights(low, high)])


def _shortest(
    world: World, start: ArrayLike, goal: ArrayLike, robot_radius: float, robot_height: float, goal_radius: float
) -> tuple[float, np.ndarray]:
    space = free_space(world, robot_radius, robot_height)
    return space.shortest_path(_point(start, "start"), _point(goal, "goal"), _not_negative(goal_radius, "goal_radius"))


def _points(values: ArrayLike, name: str) -> np.ndarray:
    points = np.asarray(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(f"{name} must be finite numbers of shape (K, 2), not of shape {points.shape}")
    return points


def _point(values: ArrayLike, name: str) -> np.ndarray:
    point = np.asarray(values, dtype=np.float64)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"{name} must be two finite numbers, x and y in metres, not {values!r}")
    return point


def _positive(value: float, name: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be a positive finite number of metres, not {value!r}")
    return float(value)


def _not_negative(value: float, name: str) -> float:
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} must be a finite number of metres, at least 0, not {value!r}")
    return float(value)
