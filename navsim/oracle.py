"""The planning oracle: a way to the goal that the robot can drive, found with the map.

It shows what the rules of the task allow, as a ceiling for learned policies and as a test of worlds: a kinodynamic
search with the robot's own seven actions. A node is all that the robot's future depends on: pose, command and speeds.
An edge is one control period. What ends an episode in the simulator ends a branch of the search: a touch of the bumper
anywhere on the way, a pixel nearer than the task's collision depth at the end of a period.

The search is a weighted A* (Pohl 1970) over continuous poses, of which each cell of a lattice keeps the first that is
examined (hybrid A*, Dolgov et al. 2010). The geodesic distance to the goal guides it, and the turn that lies before the
robot. Nodes are checked when their turn comes, many at a time, so that the rules are checked on whole arrays.

Where something moves, time belongs to the state: a node knows the step it is reached in, and so where everything is
then, and the lattice has a cell for each second. What can be pushed counts as standing where the file puts it; if
something that moves displaces it, or if the task allows pushing, plans that would need to reckon with that are not
found, or found wanting in the simulator.

A plan is driven in the simulator before it is handed out.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from navsim.camera import DepthCamera
from navsim.dynamics import Dynamics, MovingPrisms, dynamic_obstacles
from navsim.footprints import Footprints
from navsim.motion_rules import sweeps
from navsim.planner import DistanceField, shortest_path_length
from navsim.raycast import Scene, nearest_depth
from navsim.robot import ACTIONS, INITIAL_COMMAND, NUM_ACTIONS, TURTLEBOT2, Robot, apply_actions, wrap_angle
from navsim.simulator import Simulator
from navsim.task import Task, goal_distance
from navsim.world import Cylinder, Obstacle, Polygon, World


@dataclass(frozen=True)
class _Effort:
    """How one search looks for a plan."""

    margin: float
    """Space to keep around the robot, and depth to keep beyond the collision depth, metres."""
    guide_margin: float
    """Space around the robot that the guiding distances reckon with, metres: the picture is wider than the robot."""
    cell: float
    """Side of a lattice cell, metres."""
    headings: int
    """Number of the lattice's headings."""
    greed: float
    """Weight of the cost to go against the cost so far: 1 looks for the shortest way, more finds one sooner."""
    max_nodes: int
    """Nodes to examine before giving up."""


_EFFORTS = (
    _Effort(margin=0.02, guide_margin=0.1, cell=0.06, headings=40, greed=1.3, max_nodes=12_000),
    _Effort(margin=0.005, guide_margin=0.03, cell=0.04, headings=80, greed=1.5, max_nodes=30_000),
    _Effort(margin=1e-4, guide_margin=0.0, cell=0.03, headings=120, greed=1.5, max_nodes=80_000),
)
"""One after the other until there is a plan: with ease, then tighter, then all that the rules allow."""

_COARSE = _Effort(margin=0.005, guide_margin=0.1, cell=0.08, headings=40, greed=2.0, max_nodes=30_000)
"""The second one where something moves: time multiplies the cells, and who must wait needs to see far, not fine."""

_CELL_LASTS = 1.0  # seconds, where something moves
_SHUT_STEP = 0.1  # metres between the places of a door's edge that stand for the floor that it sweeps
_BATCH = 64  # nodes that are examined at a time
_METRES_A_SECOND = 0.1  # what a second costs beside the metres driven
_GUIDE_RESOLUTION = 0.05  # metres between neighbouring points of the guide's grid
_GUIDE_POINTS = 500_000  # of the guide's grid in a large room
_GUIDES_KEPT = 64  # half a megabyte each in a room of 7 m

_ROUNDING = 1e-6
_FASTEST = max(action.linear for action in ACTIONS if action.linear is not None)
_SLOWEST = min(action.linear for action in ACTIONS if action.linear is not None)
_TURNING_RADIUS = _SLOWEST / max(action.angular for action in ACTIONS if action.angular is not None)


class Oracle:
    """Plans ways through one world; what they share is worked out once.

    Args:
        world: the map.
        camera: what the depth rule sees with; the Kinect at 80x64 by default.
        task: the rules.
        robot: who drives.

    >>> world = World.from_dict({"format": 1, "size": [6, 6], "obstacles": [
    ...     {"box": {"at": [0, 0], "size": [0.4, 1.0], "height": 1}}]})
    >>> actions = Oracle(world).plan(np.array([-2.0, 0.0, 0.0]), np.array([2.0, 0.0]))
    >>> len(actions) < 60
    True
    """

    def __init__(
        self, world: World, camera: DepthCamera | None = None, task: Task | None = None, robot: Robot = TURTLEBOT2
    ) -> None:
        self.world = world
        self.camera = camera or DepthCamera()
        self.task = task or Task()
        self.robot = robot
        self._simulator = Simulator(world, camera=self.camera, task=self.task, robot=robot)
        self._rules = _Rules(world, self.camera, self.task, robot)
        self._maps = _maps(world)
        self._guides: dict[tuple[int, float, float, float], _Guide] = {}

    def plan(
        self, start_pose: np.ndarray, goal: np.ndarray, phases: np.ndarray | Sequence[float] = ()
    ) -> np.ndarray | None:
        """Actions that lead from a start, at rest with the initial command, to a goal; among the shortest there are.

        Args:
            start_pose: ``(3,)`` x, y (metres) and yaw (radians).
            goal: ``(2,)`` metres.
            phases: ``(D,)`` where in their periods the moving obstacles are at the start; 0 by default.

        Returns:
            ``(K,)`` int64, actions with which an episode of the simulator ends in success in its K-th step; None where
            no such actions were found, be it that there are none or that the search gave up.
        """
        pose, target = np.asarray(start_pose, dtype=np.float64), np.asarray(goal, dtype=np.float64)
        length = shortest_path_length(
            self.world, pose[:2], target, self.robot.radius, self.robot.height, self.task.goal_radius
        )
        # In large worlds that length may be a fraction of a percent too long.
        if 0.99 * length > self._rules.stride * self.task.max_steps:
            return None
        row = np.zeros(self._rules.dynamics.most)
        own = phases[: len(row)]  # a simulator's other worlds have more
        row[: len(own)] = own
        efforts = (_EFFORTS[0], _COARSE, *_EFFORTS[1:]) if self._rules.anything_moves else _EFFORTS
        for effort, world in itertools.product(efforts, self._maps):
            actions = _search(pose, target, row, effort, self._rules, self._guide(world, target, effort))
            if actions is not None and self._succeeds(pose, target, row, actions):
                return actions
        return None

    def _guide(self, world: World, goal: np.ndarray, effort: _Effort) -> _Guide:
        key = (id(world), float(goal[0]), float(goal[1]), effort.guide_margin)
        if key not in self._guides:
            if len(self._guides) >= _GUIDES_KEPT:
                self._guides.clear()
            radius = self.robot.radius + effort.guide_margin
            self._guides[key] = _Guide(world, goal, radius, self.robot.height, self.task.goal_radius)
        return self._guides[key]

    def _succeeds(self, pose: np.ndarray, goal: np.ndarray, phases: np.ndarray, actions: np.ndarray) -> bool:
        """Whether an episode of the simulator that takes these actions ends with the last one, in success."""
        simulator = self._simulator
        state = simulator.state_dict()
        physics = state["physics"]
        physics["poses"][0], physics["speeds"][0], physics["phases"][0], physics["clock"][0] = pose, 0.0, phases, 0.0
        physics["obstacle_poses"] = self._rules.dynamics.poses(physics["world_index"], phases[None], np.zeros(1))
        physics["obstacle_speeds"][:] = 0.0
        state["commands"][0], state["goals"][0] = INITIAL_COMMAND, goal
        state["steps"][0], state["ended"][0] = 0, False
        simulator.load_state_dict(state)
        for step, action in enumerate(actions, start=1):
            transition = simulator.step(np.array([action]))
            if transition.terminated[0] or transition.truncated[0]:
                return bool(transition.success[0]) and step == len(actions)
        return False


def plan(
    world: World,
    start_pose: np.ndarray,
    goal: np.ndarray,
    *,
    camera: DepthCamera | None = None,
    task: Task | None = None,
    robot: Robot = TURTLEBOT2,
    phases: np.ndarray | Sequence[float] = (),
) -> np.ndarray | None:
    """``Oracle.plan`` for a single path.

    Args:
        world: the map.
        start_pose: ``(3,)`` x, y (metres) and yaw (radians).
        goal: ``(2,)`` metres.
        camera: what the depth rule sees with; the Kinect at 80x64 by default.
        task: the rules.
        robot: who drives.
        phases: ``(D,)`` where in their periods the moving obstacles are at the start; 0 by default.

    Returns:
        ``(K,)`` int64 actions that succeed in the simulator, or None where none were found.
    """
    return Oracle(world, camera, task, robot).plan(start_pose, goal, phases)


def _maps(world: World) -> list[World]:
    """What guides a search: the world without what moves; and, where a door swings, with all its floor shut too.

    A search that is guided through a door waits in front of it for all that its budget allows; one that is guided
    around it finds the other way, if there is one.
    """
    swings = [one for one in dynamic_obstacles(world) if one.moves and (one.knots[:, 2] != 0.0).any()]
    if not swings:
        return [world]
    shut: list[Obstacle] = [obstacle for obstacle in world.obstacles if obstacle.motion is None]
    for one in swings:
        height = one.top - one.base
        for sweep in sweeps(one, swing_step=_SHUT_STEP):
            if sweep.radius > 0.0:
                (x, y), *_ = sweep.vertices.tolist()
                shut.append(Cylinder(at=(x, y), radius=sweep.radius, base=one.base, height=height))
            else:
                corners = tuple((x, y) for x, y in sweep.vertices.tolist())
                shut.append(Polygon(points=corners, base=one.base, height=height))
    return [world, world.model_copy(update={"obstacles": tuple(shut)})]


class _Rules:
    """What the simulator forbids, for many robots at once."""

    def __init__(self, world: World, camera: DepthCamera, task: Task, robot: Robot) -> None:
        self.task, self.robot = task, robot
        self._camera = camera
        self.dynamics = Dynamics([world])
        self._scene = Scene([world.standing_prisms])
        self._all = Footprints.of(world.standing_prisms)
        self._in_the_way = Footprints.of([p for p in world.standing_prisms if p.overlaps_heights(0.0, robot.height)])
        self._substeps = max(1, math.ceil(task.control_period / task.substep - 1e-9))
        self._moving = np.flatnonzero(self.dynamics.moves[0])
        self.stride = min(_FASTEST, robot.max_linear_speed) * task.control_period
        """Metres, as far as a step can lead."""

    def drive(self, poses: np.ndarray, speeds: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One control period on a free floor.

        Args:
            poses: ``(N, 3)``.
            speeds: ``(N, 2)`` at its beginning, m/s and rad/s.
            commands: ``(N, 2)`` m/s and rad/s.

        Returns:
            ``(N, S, 3)`` poses at the end of each physics substep, ``(N, 2)`` speeds at the end.
        """
        robot, substeps = self.robot, self._substeps
        dt = self.task.control_period / substeps
        greatest = np.array([robot.max_linear_speed, robot.max_angular_speed])
        limits = (robot.linear_acceleration, robot.angular_acceleration)
        acceleration = np.array([math.inf if limit is None else limit for limit in limits])
        change = acceleration * dt * np.arange(1, substeps + 1)[:, None]
        targets = np.clip(commands, -greatest, greatest)
        ramp = speeds[:, None] + np.clip((targets - speeds)[:, None], -change, change)  # (N, S, 2)
        turn = ramp[..., 1] * dt
        headings = poses[:, 2, None] + np.cumsum(turn, axis=1)
        chord = ramp[..., 0] * dt * np.sinc(turn / (2.0 * math.pi))
        track = np.empty((len(poses), substeps, 3))
        track[..., 0] = poses[:, 0, None] + np.cumsum(chord * np.cos(headings - 0.5 * turn), axis=1)
        track[..., 1] = poses[:, 1, None] + np.cumsum(chord * np.sin(headings - 0.5 * turn), axis=1)
        track[..., 2] = wrap_angle(headings)
        return track, ramp[:, -1]

    @property
    def anything_moves(self) -> bool:
        """Whether it matters when the robot is somewhere."""
        return len(self._moving) > 0

    def touches(self, track: np.ndarray, steps: np.ndarray, phases: np.ndarray, margin: float) -> np.ndarray:
        """``(N,)`` bool: something comes nearer than ``margin`` to the base at the end of a substep of (N, S, 3).

        ``steps`` ``(N,)`` are the control periods that have passed at the end of each track.
        """
        touching = self._touches_standing(track, margin)
        if self.anything_moves:
            free = np.flatnonzero(~touching)
            touching[free] = self._touches_moving(track[free], steps[free], phases, margin)
        return touching

    def _touches_moving(self, track: np.ndarray, steps: np.ndarray, phases: np.ndarray, margin: float) -> np.ndarray:
        count, substeps = track.shape[:2]
        period = self.task.control_period
        times = (steps[:, None] - 1) * period + period / substeps * np.arange(1, substeps + 1)
        poses = self._obstacles_at(times.ravel(), phases)
        dynamics, needed = self.dynamics, self.robot.radius + margin
        points = track[..., :2].reshape(-1, 2)
        away = np.hypot(*(poses[..., :2] - points[:, None]).transpose(2, 0, 1)) - dynamics.reach[0]
        may_touch = dynamics.moves[0] & (dynamics.base[0] < self.robot.height)
        place, slot = np.nonzero(may_touch & (away < needed))
        distance = dynamics.distances(np.zeros(len(slot), dtype=np.intp), slot, poses[place, slot], points[place])
        touching = np.zeros(count, dtype=bool)
        touching[place[distance < needed] // substeps] = True
        return touching

    def _obstacles_at(self, times: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """``(K, D, 3)`` poses at ``times`` ``(K,)``, seconds."""
        rows = np.zeros(len(times), dtype=np.intp)
        return self.dynamics.poses(rows, np.broadcast_to(phases, (len(times), len(phases))), times)

    def _touches_standing(self, track: np.ndarray, margin: float) -> np.ndarray:
        needed = self.robot.radius + margin
        clear, _ = self._in_the_way.nearest(track[:, -1, :2])
        touching = clear < needed
        travel = np.abs(np.diff(track[..., :2], axis=1)).sum(axis=(1, 2))
        doubtful = np.flatnonzero(~touching & (clear < needed + travel))
        if len(doubtful):
            way = track[doubtful, :-1, :2]
            clear, _ = self._in_the_way.nearest(way.reshape(-1, 2))
            touching[doubtful] = clear.reshape(way.shape[:2]).min(axis=1, initial=math.inf) < needed
        return touching

    def sees_too_near(self, poses: np.ndarray, steps: np.ndarray, phases: np.ndarray, margin: float) -> np.ndarray:
        """``(N,)`` bool: a pixel is less than the collision depth and ``margin`` away, ``steps`` ``(N,)`` after the
        start."""
        near = np.zeros(len(poses), dtype=bool)
        if self.task.collision_depth == 0.0:
            return near
        camera, limit = self._camera, self.task.collision_depth + margin
        # No pixel of that depth is further from the robot's centre than the image's corner columns.
        reach = math.hypot(camera.mount_x, camera.mount_y) + limit * camera.floor_reach
        clear, _ = self._all.nearest(poses[:, :2])
        obstacles = self._obstacles_at(steps * self.task.control_period, phases)
        if self.anything_moves:
            away = np.hypot(*(obstacles[..., :2] - poses[:, None, :2]).transpose(2, 0, 1)) - self.dynamics.reach[0]
            clear = np.minimum(clear, np.where(self.dynamics.moves[0], away, math.inf).min(axis=1))
        doubtful = np.flatnonzero(clear < reach)
        index, moving = self._seen(doubtful, obstacles)
        near[doubtful] = nearest_depth(self._scene, index, poses[doubtful], camera, limit, moving=moving) < limit
        return near

    def _seen(self, nodes: np.ndarray, obstacles: np.ndarray) -> tuple[np.ndarray, MovingPrisms | None]:
        """What the ray-caster needs beside the scene for some of the poses whose ``obstacles`` are ``(N, D, 3)``."""
        index = np.zeros(len(nodes), dtype=np.intp)
        if not self.anything_moves:
            return index, None
        return index, self.dynamics.prisms(index, obstacles[nodes], self.dynamics.moves)


class _Guide:
    """What is left to drive from anywhere in the room to one goal, roughly: looked up in a grid.

    The geodesic distance for a disc, and how far the robot has to turn to follow it. A turn by φ on a circle of
    radius r takes r·(φ − sin φ) more
    than the straight line.
    """

    def __init__(
        self, world: World, goal: np.ndarray, robot_radius: float, robot_height: float, goal_radius: float
    ) -> None:
        half = world.half_size
        resolution = max(_GUIDE_RESOLUTION, math.sqrt(4.0 * half.prod() / _GUIDE_POINTS))
        self._shape = np.maximum(2, np.ceil(2.0 * half / resolution).astype(np.intp) + 1)
        field = DistanceField(world, goal, resolution, robot_radius, robot_height, goal_radius)
        self._origin, self._spacing = -half, 2.0 * half / (self._shape - 1)
        x, y = (low + step * np.arange(n) for low, step, n in zip(-half, self._spacing, self._shape, strict=True))
        points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        distance = field(points.reshape(-1, 2)).reshape(self._shape)
        blocked = ~np.isfinite(distance)
        if blocked.all():
            distance = np.hypot(*(points - goal).transpose(2, 0, 1))
        elif blocked.any():
            # Beside obstacles, where the disc does not fit but the robot may: from the nearest place where it does.
            away, (row, column) = distance_transform_edt(blocked, sampling=self._spacing, return_indices=True)
            distance = distance[row, column] + 2.0 * away
        self._distance = distance
        slope_x, slope_y = np.gradient(distance, *self._spacing)
        self._slope = np.stack([slope_x, slope_y], axis=-1)

    def cost_to_go(self, poses: np.ndarray) -> np.ndarray:
        """``(N,)`` what the cheapest way to the goal costs from poses ``(N, 3)``, about."""
        place = (poses[:, :2] - self._origin) / self._spacing
        cell = np.clip(np.rint(place).astype(np.intp), 0, self._shape - 1)
        slope = self._slope[cell[:, 0], cell[:, 1]]
        offset = (place - cell) * self._spacing
        distance = np.maximum(self._distance[cell[:, 0], cell[:, 1]] + (slope * offset).sum(axis=1), 0.0)
        turn = np.abs(wrap_angle(np.arctan2(-slope[:, 1], -slope[:, 0]) - poses[:, 2]))
        detour = np.minimum(_TURNING_RADIUS * (turn - np.sin(turn)), distance)
        return distance / _FASTEST * (_FASTEST + _METRES_A_SECOND) + detour / _SLOWEST * (_SLOWEST + _METRES_A_SECOND)


def _search(
    start_pose: np.ndarray, goal: np.ndarray, phases: np.ndarray, effort: _Effort, rules: _Rules, guide: _Guide
) -> np.ndarray | None:
    """Actions that lead from a start to a goal by the rules, ``(K,)`` int64; None where the search found none."""
    task = rules.task
    capacity = 1 + (effort.max_nodes + _BATCH) * NUM_ACTIONS
    poses, speeds, commands = np.empty((capacity, 3)), np.empty((capacity, 2)), np.empty((capacity, 2))
    costs, steps = np.empty(capacity), np.empty(capacity, dtype=np.int64)
    parents, taken = np.empty(capacity, dtype=np.int64), np.empty(capacity, dtype=np.int64)
    poses[0], speeds[0], commands[0], costs[0], steps[0], parents[0] = start_pose, 0.0, INITIAL_COMMAND, 0.0, 0, -1
    # Steps that a cell of the lattice lasts: for ever, where all stands still.
    lasting = max(1, round(_CELL_LASTS / task.control_period)) if rules.anything_moves else task.max_steps + 1
    count, examined = 1, 0
    queue: list[tuple[float, int]] = [(0.0, 0)]
    closed: set[tuple[int, ...]] = set()

    while queue and examined < effort.max_nodes:
        batch: list[int] = []
        while queue and len(batch) < _BATCH:
            batch.append(heapq.heappop(queue)[1])
        nodes = np.array(batch)
        examined += len(nodes)
        cells = _cells(poses[nodes], commands[nodes], steps[nodes] // lasting, effort)
        moved = parents[nodes] >= 0
        allowed = np.array([cell not in closed for cell in cells])
        check = np.flatnonzero(allowed & moved)
        origin = parents[nodes[check]]
        track, _ = rules.drive(poses[origin], speeds[origin], commands[nodes[check]])
        free = ~rules.touches(track, steps[nodes[check]], phases, effort.margin)
        arrived = free & (goal_distance(track[:, -1], goal) < task.goal_radius - _ROUNDING)
        if arrived.any():
            return _actions_to(nodes[check[np.argmax(arrived)]], parents, taken)
        free[free] = ~rules.sees_too_near(track[free, -1], steps[nodes[check[free]]], phases, effort.margin)
        allowed[check] = free
        kept = []
        for position in np.flatnonzero(allowed):
            if cells[position] not in closed:
                closed.add(cells[position])
                kept.append(nodes[position])
        if not kept:
            continue

        origin, action, command = _successors(np.array(kept), commands)
        track, speed = rules.drive(poses[origin], speeds[origin], command)
        pose = track[:, -1]
        cells = _cells(pose, command, (steps[origin] + 1) // lasting, effort)
        new = np.array([cell not in closed for cell in cells])
        straight = goal_distance(pose, goal) - task.goal_radius
        new &= (steps[origin] + 1) * rules.stride + straight < task.max_steps * rules.stride + _ROUNDING
        origin, action, command, speed, pose = (part[new] for part in (origin, action, command, speed, pose))
        length = np.hypot(*(pose[:, :2] - poses[origin, :2]).T)
        added = slice(count, count + len(origin))
        poses[added], speeds[added], commands[added] = pose, speed, command
        parents[added], taken[added], steps[added] = origin, action, steps[origin] + 1
        costs[added] = costs[origin] + length + _METRES_A_SECOND * task.control_period
        priority = costs[added] + effort.greed * guide.cost_to_go(pose)
        for entry in zip(priority.tolist(), range(count, added.stop), strict=True):
            heapq.heappush(queue, entry)
        count = added.stop
    return None


def _successors(nodes: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Node, action and new command of each distinct way to go on: of two actions that change nothing, one is enough."""
    origin = np.repeat(nodes, NUM_ACTIONS)
    action = np.tile(np.arange(NUM_ACTIONS), len(nodes))
    command = apply_actions(commands[origin], action)
    turns = np.array([possible.angular is not None for possible in ACTIONS])[action]
    distinct = ~(turns & (command == commands[origin]).all(axis=1))
    return origin[distinct], action[distinct], command[distinct]


def _cells(poses: np.ndarray, commands: np.ndarray, times: np.ndarray, effort: _Effort) -> list[tuple[int, ...]]:
    """The lattice cell of each pose and command at a time, counted in what a cell lasts."""
    place = np.floor(poses[:, :2] / effort.cell)
    heading = np.rint(poses[:, 2] * (effort.headings / (2.0 * math.pi))) % effort.headings
    command = np.rint(commands * 1000.0)
    return list(map(tuple, np.column_stack([place, heading, command, times]).astype(np.int64).tolist()))


def _actions_to(node: int, parents: np.ndarray, taken: np.ndarray) -> np.ndarray:
    actions = []
    while parents[node] >= 0:
        actions.append(taken[node])
        node = parents[node]
    return np.array(actions[::-1], dtype=np.int64)
