"""One navigation episode: where it starts, what it is after, what it earns, and how it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navsim.camera import DepthCamera, Mounts
from navsim.dynamics import Dynamics, outlines
from navsim.motion_rules import meet
from navsim.places import START_CLEARANCE, RandomPlaces
from navsim.planner import OPEN_FLOOR_MARGIN
from navsim.prism import walls_around
from navsim.raycast import Scene, nearest_depth
from navsim.robot import Robot, wrap_angle
from navsim.settings import check_kinds
from navsim.world import World

_YAWS = np.deg2rad(np.arange(-175.0, 181.0, 5.0))  # what an open start yaw is drawn from
_PHASES = 200  # times that the phases of moving obstacles are drawn before a start is said to be never free
_PATIENCE = 40  # times after which it is enough that what moves does not end the episode at once
_OFFSETS = 40  # offsets from a listed start that are tried before it is taken as it is


@dataclass(frozen=True)
class Task:
    """The rules of an episode; the defaults are the thesis's (R. Weideman, Cal Poly 2019, section 5.3).

    An episode ends in success within ``goal_radius`` of the goal, or in a collision: the bumper touches something, or
    a pixel of the ideal depth image is nearer than ``collision_depth``. The goal wins where both happen in one step.
    ``max_steps`` steps without an end truncate it.

    With ``pushing_is_collision`` off, obstacles that can be pushed may be touched, and the depth rule looks through
    them as if they were glass: it asks how near everything else is. The robot still sees them.
    """

    goal_radius: float = 0.5
    """Distance to the goal under which it is reached, metres."""
    collision_depth: float = 0.4
    """Depth under which any pixel counts as a collision, metres; 0 leaves it to the bumper."""
    pushing_is_collision: bool = True
    """Whether touching, or seeing too near, an obstacle that can be pushed is a collision as with any other."""
    goal_reward: float = 1.0
    """Reward of the step that reaches the goal."""
    collision_reward: float = -1.0
    """Reward of the step that collides."""
    progress_weight: float = 1.0
    """Factor of v·cos(θ)·δt in the reward of any other step, per metre; 5 is the thesis's equation 4.1 as printed,
    without δt."""
    step_penalty: float = 0.01
    """What is taken from the reward of any other step."""
    length_penalty: float = 0.0
    """What is taken from it for each metre driven besides, v·δt: what makes shorter ways worth more."""
    control_period: float = 0.2
    """Time from one action to the next, δt, seconds."""
    substep: float = 0.02
    """Greatest length of a physics step, seconds."""
    max_steps: int = 500
    """Steps after which an episode is truncated."""
    start_view: float = 1.0
    """Free view that a start needs whose yaw is drawn, metres: no obstacle anywhere in the picture is nearer."""

    def __post_init__(self) -> None:
        check_kinds(self, "task")
        for name in ("goal_radius", "control_period", "substep"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"task {name} must be a positive finite number; got {value!r}")
        for name in ("collision_depth", "start_view"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"task {name} must be a finite number of metres, at least 0; got {value!r}")
        for name in ("goal_reward", "collision_reward", "progress_weight", "step_penalty", "length_penalty"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"task {name} must be a finite number; got {getattr(self, name)!r}")
        if not isinstance(self.pushing_is_collision, bool):
            raise ValueError(f"task pushing_is_collision must be true or false; got {self.pushing_is_collision!r}")
        if isinstance(self.max_steps, bool) or not isinstance(self.max_steps, int | np.integer) or self.max_steps < 1:
            raise ValueError(f"task max_steps must be a whole number, at least 1; got {self.max_steps!r}")

    def check_camera(self, camera: DepthCamera) -> None:
        """Raises ValueError for a camera that sees the floor, or all that it sees, nearer than ``collision_depth``."""
        if camera.max_range < self.collision_depth:
            raise ValueError(
                f"the camera sees no further than its max_range of {camera.max_range:g} m, nearer than the task's "
                f"collision_depth of {self.collision_depth:g} m, so that every step would collide: lower "
                "collision_depth, or raise max_range"
            )
        floor = camera.least_floor_depth
        if floor < self.collision_depth:
            raise ValueError(
                f"the camera sees the floor {floor:.2f} m away, nearer than the task's collision_depth of "
                f"{self.collision_depth:g} m, so that every step would collide: lower collision_depth, "
                "raise the camera (mount_z), tilt it up (pitch_deg) or narrow its vertical_fov_deg"
            )


def heading(poses: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """The goal's bearing in the robot's frame, θ.

    Args:
        poses: ``(..., 3)`` x, y (metres) and yaw (radians).
        goals: ``(..., 2)`` metres.

    Returns:
        ``(...)`` float64, radians in (−π, π], positive when the goal is to the left.

    >>> heading(np.array([1.0, 1.0, 0.0]), np.array([1.0, 3.0])).round(4).item()
    1.5708
    """
    offset = goals - poses[..., :2]
    return wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - poses[..., 2])


def goal_distance(poses: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """``(...)`` metres from poses ``(..., 2 or more)`` to goals ``(..., 2)``. The robot is never told."""
    return np.hypot(goals[..., 0] - poses[..., 0], goals[..., 1] - poses[..., 1])


def rewards(
    task: Task, linear_commands: np.ndarray, headings: np.ndarray, success: np.ndarray, collision: np.ndarray
) -> np.ndarray:
    """Rewards of one step each: Xie et al. 2017 (arXiv 1706.09829), as the thesis extends it.

    ``v·cos(θ)·δt − 0.01`` pays for moving towards the goal; v is the command during the step and θ the heading at its
    end, which is what a robot that reads its odometry after each step knows.

    Args:
        task: the rules.
        linear_commands: ``(N,)`` v, m/s.
        headings: ``(N,)`` θ, radians, after the step.
        success: ``(N,)`` bool.
        collision: ``(N,)`` bool; ``success`` wins where both hold.

    Returns:
        ``(N,)`` float32.

    >>> still_going = np.array([False])
    >>> rewards(Task(), np.array([0.4]), np.array([0.0]), still_going, still_going).tolist()  # 0.4 · 0.2 − 0.01
    [0.07000000029802322]
    """
    progress = task.progress_weight * task.control_period * linear_commands * np.cos(headings)
    cost = task.step_penalty + task.length_penalty * task.control_period * np.abs(linear_commands)
    ended = np.where(success, task.goal_reward, task.collision_reward)
    return np.where(success | collision, ended, progress - cost).astype(np.float32)


class NoFreeMomentError(ValueError):
    """A start that what moves never leaves free."""


class Path(NamedTuple):
    """A start and a goal of a world. An index of −1 is a place drawn at random, for worlds that leave it open."""

    start_index: int
    goal_index: int
    world_index: int = 0


class Episode(NamedTuple):
    """How an episode begins."""

    path: Path
    pose: np.ndarray
    """``(3,)`` x, y (metres), yaw (radians) of the start"""
    goal: np.ndarray
    """``(2,)`` metres"""
    phases: np.ndarray
    """``(D,)`` of the world's dynamic obstacles: where in its period each one that moves is; see ``navsim.dynamics``"""


class Episodes:
    """The episodes of one world: draws starts, yaws and goals.

    Listed starts and goals are paired uniformly, without those pairs that would end at once: a start within
    ``goal_radius`` of the goal, or one that collides by the depth rule whichever way it may face. Only where nothing
    else is listed do such pairs occur.

    A listed start without a yaw faces one of 72 directions, uniformly among those with a free view of
    ``task.start_view``; where there is none, the direction with the longest. A random place is one of the room where
    the robot fits, uniformly; a start has 5 cm to spare there, and that free view in the direction that is drawn with
    it. Starts and goals are further apart than ``goal_radius`` and connected. In a world where they are hard to find,
    a view of ``collision_depth`` is enough, and they are drawn around the other end, or where a robot could start.

    Where something moves, its phases are drawn first, and again (with the yaw, or the place) until nothing that moves
    is nearer to the start than 5 cm or overlaps with what can be pushed, and until the view is as free as it would be
    without it. Where it never is, the freest start that was drawn counts.

    Args:
        world: the world.
        world_index: its index in ``scene``.
        scene: for the ray-caster: what is fixed in the worlds.
        camera: what the depth rule sees with.
        task: the rules.
        robot: who drives.
    """

    def __init__(
        self, world: World, world_index: int, scene: Scene, camera: DepthCamera, task: Task, robot: Robot
    ) -> None:
        self._world, self._world_index, self._scene = world, world_index, scene
        self._dynamics = Dynamics([world])
        self._camera, self._task, self._robot = camera, task, robot
        starts = () if isinstance(world.starts, str) else world.starts
        goals = () if isinstance(world.goals, str) else world.goals
        # A yaw that is left open is NaN; a world that draws its places lists none.
        yaws = [math.nan if start.yaw_deg is None else math.radians(start.yaw_deg) for start in starts]
        self._starts = np.array([(*start.at, yaw) for start, yaw in zip(starts, yaws, strict=True)]).reshape(-1, 3)
        self._goals = np.array([goal.at for goal in goals], dtype=np.float64).reshape(-1, 2)

    def draw(self, generator: np.random.Generator, path: Path | None = None) -> Episode:
        """How the next episode begins.

        Args:
            generator: the only source of chance.
            path: the start and the goal to take; drawn by default.

        Raises:
            ValueError: for a path that the world does not have, or a world without room for a random place.
            NoFreeMomentError: for a start that what moves never leaves free.
        """
        return self.draw_many([generator], [path])[0]

    def draw_many(self, generators: Sequence[np.random.Generator], paths: Sequence[Path | None]) -> list[Episode]:
        """How the next episodes of several robots begin: for each what ``draw`` gives it, in less time."""
        indices = [self._indices(generator, path) for generator, path in zip(generators, paths, strict=True)]
        if self._dynamics.moves.any():
            begun = [self._free_moment(generator, ends) for generator, ends in zip(generators, indices, strict=True)]
        else:
            nothing_moves = np.zeros(self._dynamics.most)
            begun = [(nothing_moves, *places) for places in self._places(generators, indices)]
        return [
            Episode(Path(*ends, self._world_index), start, goal, phases)
            for ends, (phases, start, goal) in zip(indices, begun, strict=True)
        ]

    def _indices(self, generator: np.random.Generator, path: Path | None) -> tuple[int, int]:
        if path is not None:
            return self._checked(path)
        start_index, goal_index = self._pairs[generator.integers(len(self._pairs))].tolist()
        return start_index, goal_index

    def _free_moment(
        self, generator: np.random.Generator, indices: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Phases ``(D,)`` of what moves, a start ``(3,)`` that it leaves free, and a goal ``(2,)``."""
        freest, best = -math.inf, None
        for attempt in range(_PHASES):
            if attempt >= _PATIENCE and freest >= self._task.collision_depth:
                break
            phases = self._dynamics.draw_phases(0, generator)
            ((start, goal),) = self._places([generator], [indices])
            if not self._moving_keep_clear(phases, start):
                continue
            view = float(self._views(start[None], phases)[0])
            if view > freest:
                freest, best = view, (phases, start, goal)
            if view >= self._wanted_view or view >= self._views(start[None])[0]:
                break
        if best is None:
            where = f"[{start[0]:g}, {start[1]:g}]"
            raise NoFreeMomentError(
                f'world "{self._world.name}" has no free moment for a start at {where}: of {_PHASES} draws, a moving '
                f"obstacle was there or in something pushable each time; move the start, or the obstacle's path"
            )
        return best

    def _moving_keep_clear(self, phases: np.ndarray, start: np.ndarray) -> bool:
        """Whether nothing that moves is near a start ``(3,)`` or in something pushable when the episode begins."""
        dynamics, row = self._dynamics, np.zeros(1, dtype=np.intp)
        poses = dynamics.poses(row, phases[None], np.zeros(1))[0]
        points = np.vstack([start[:2], poses[:, :2]])
        tops = np.append(self._robot.height, dynamics.top[0])
        needed = np.append(self._robot.radius + START_CLEARANCE, dynamics.reach[0])
        may_meet = dynamics.moves[0][:, None] & np.append(True, dynamics.is_pushable[0])
        slot, point = np.nonzero(may_meet & (dynamics.base[0][:, None] < tops))
        distance = dynamics.distances(row.repeat(len(slot)), slot, poses[slot], points[point])
        near = distance < needed[point]
        if (near & (point == 0)).any():
            return False
        if not near.any():
            return True
        shapes = outlines(self._world, poses)
        return not any(meet(shapes[s], shapes[p - 1]) for s, p in zip(slot[near], point[near], strict=True))

    def _places(
        self, generators: Sequence[np.random.Generator], indices: Sequence[tuple[int, int]]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """A start ``(3,)`` and a goal ``(2,)`` for each generator and its indices, as if nothing moved."""
        places = [self._listed(generator, *ends) for generator, ends in zip(generators, indices, strict=True)]
        incomplete = [number for number, (start, goal) in enumerate(places) if start is None or goal is None]
        if incomplete:
            starts, goals = zip(*(places[number] for number in incomplete), strict=True)
            drawn = self._random_places.draw([generators[number] for number in incomplete], starts, goals)
            for number, ends in zip(incomplete, drawn, strict=True):
                places[number] = ends
        return places  # type: ignore[return-value] # none is missing any more

    def _listed(
        self, generator: np.random.Generator, start_index: int, goal_index: int
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The start ``(3,)``, its yaw drawn, and the goal ``(2,)`` of the file; None for what it leaves open."""
        start = goal = None
        if start_index >= 0:
            yaws, _ = self._yaws[start_index]
            start = np.array([*self._starts[start_index, :2], yaws[generator.integers(len(yaws))]])
        if goal_index >= 0:
            goal = self._goals[goal_index]
        return start, goal

    def displace(
        self,
        episode: Episode,
        draw_offset: Callable[[], np.ndarray],
        mount: tuple[float, float, float, float],
    ) -> np.ndarray:
        """A start near a listed one, at which the robot has the clearance, the way and the view that a start needs.

        Args:
            episode: as it begins at the listed start.
            draw_offset: draws what to add to the pose, ``(3,)``.
            mount: how the robot carries its camera, as in ``Mounts``.

        Returns:
            ``(3,)``, the first of some drawn poses that will do; the listed one where none does.
        """
        mounts = Mounts(*(np.array([value]) for value in mount))
        for _ in range(_OFFSETS):
            moved = episode.pose + draw_offset()
            if not self._random_places.suits(moved, episode.goal) or not self._moving_keep_clear(episode.phases, moved):
                continue
            if self._views(moved[None], episode.phases, mounts)[0] >= self._task.collision_depth:
                return np.array([*moved[:2], wrap_angle(moved[2])])
        return episode.pose

    def _checked(self, path: Path) -> tuple[int, int]:
        for kind, index, places in (("start", path.start_index, self._starts), ("goal", path.goal_index, self._goals)):
            allowed = range(len(places)) if len(places) else (-1,)
            if index not in allowed:
                has = f"{kind}s 0 to {len(places) - 1}" if len(places) else f"{kind}s drawn at random, index -1"
                raise ValueError(f'world "{self._world.name}" has no {kind} {index}: it has {has}')
        return int(path.start_index), int(path.goal_index)

    @property
    def _wanted_view(self) -> float:
        return max(self._task.start_view, self._task.collision_depth)

    def _views(self, poses: np.ndarray, phases: np.ndarray | None = None, mounts: Mounts | None = None) -> np.ndarray:
        """``(K,)`` float32: least depth of anything but the floor, metres, at most ``_wanted_view``.

        What can be pushed is where the file puts it; what moves is left out, unless its phases ``(D,)`` are given.
        """
        world_index = np.full(len(poses), self._world_index)
        moving, dynamics = None, self._dynamics
        if dynamics.most:
            row = np.zeros((len(poses), dynamics.most)) if phases is None else np.tile(phases, (len(poses), 1))
            own = np.zeros(len(poses), dtype=np.intp)
            obstacles = dynamics.poses(own, row, np.zeros(len(poses)))
            moving = dynamics.prisms(own, obstacles, dynamics.is_pushable if phases is None else None)
        return nearest_depth(
            self._scene, world_index, poses, self._camera, self._wanted_view, mounts=mounts, moving=moving
        )

    @cached_property
    def _yaws(self) -> list[tuple[np.ndarray, float]]:
        """For each listed start: the yaws to draw from, radians, and the least view that any of them has, metres."""
        choices = []
        for x, y, yaw in self._starts:
            yaws = _YAWS if math.isnan(yaw) else wrap_angle(np.array([yaw]))
            views = self._views(np.column_stack([np.full(len(yaws), x), np.full(len(yaws), y), yaws]))
            best = views == views.max()  # all that are free have the same: the view is cut at the one that is wanted
            choices.append((yaws[best], float(views.max())))
        return choices

    @cached_property
    def _pairs(self) -> np.ndarray:
        """``(K, 2)`` start and goal index of the pairs to draw from; −1 is a random place."""
        starts = range(len(self._starts)) if len(self._starts) else [-1]
        goals = range(len(self._goals)) if len(self._goals) else [-1]
        pairs = np.array([(start, goal) for start in starts for goal in goals])
        lasting = np.ones(len(pairs), dtype=bool)
        if len(self._starts):
            views = np.array([view for _, view in self._yaws], dtype=np.float32)
            lasting &= views[pairs[:, 0]] >= self._task.collision_depth
        if len(self._starts) and len(self._goals):
            lasting &= goal_distance(self._starts[pairs[:, 0]], self._goals[pairs[:, 1]]) >= self._task.goal_radius
        return pairs[lasting] if lasting.any() else pairs

    @cached_property
    def _random_places(self) -> RandomPlaces:
        reach = self._world.half_size + OPEN_FLOOR_MARGIN + self._robot.radius  # as far as planned ways may lead
        return RandomPlaces(
            self._world.name,
            self._world.half_size,
            [prism for prism in self._world.standing_prisms if prism.overlaps_heights(0.0, self._robot.height)],
            () if self._world.walls else tuple(walls_around(reach, height=1.0, thickness=1.0)),
            robot_radius=self._robot.radius,
            apart=self._task.goal_radius,
            views=self._views,
            wanted_view=self._wanted_view,
            least_view=self._task.collision_depth,
        )
