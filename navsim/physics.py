"""Planar physics: worlds as Chipmunk spaces in which robots drive, touch, and slide along what they touch.

Free motion is exact. Within a substep the command is constant, so the robot runs along an arc; its body gets the
*chord's* velocity, and Chipmunk, which moves bodies by velocity times time, ends each substep on the arc.

A robot that has all it can reach in a control period to itself does not need Chipmunk at all: its substeps are
summed in one vectorised call, with the same result. Only robots near something are simulated.

Chipmunk's step moves the bodies, then finds contacts, then applies forces, then solves contacts for velocities. Thus

- a robot out of contact has its velocity set before the step;
- a robot in contact gets its command as a force, so that the solver takes away the part that presses into the
  obstacle before the next step moves the body: it stays out and slides along;
- on first contact the body has moved into the obstacle by up to a substep's travel (13 mm at 0.65 m/s). It is pushed
  out along the contact normals, or back to where the substep began where they leave no way out (a narrow corner).

A control period depends on nothing but poses, speeds and commands: robots enter a space when they come near
something and leave it at the end of the period, and no contact is remembered from one period to the next. So a
simulation resumes from arrays, and a robot moves in the same way whether it is alone or one of many.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import pymunk

from navsim.contact_space import ALLOWED_OVERLAP, CONTACT_OVERLAP, LONGEST_STEP, PUSHES, ContactSpace
from navsim.dynamics import Dynamics, MovingPrisms
from navsim.robot import TURTLEBOT2, Robot, with_wheel_errors, wrap_angle
from navsim.spaces import ContactSpaceOwner, let_go
from navsim.world import World

_ROBOT, _OBSTACLE = 1, 2  # Chipmunk collision types
_ROBOTS = pymunk.ShapeFilter(group=1)  # shapes of one group do not collide: robots pass through each other
_ANYTHING = pymunk.ShapeFilter()

_HORIZON = 2.0  # metres up to which distances are asked for: farther obstacles need not be looked at
_MOST_SPACES = 64
"""Worlds whose Chipmunk spaces are kept: each takes up to 0.4 MB, whose pools only grow, and half a millisecond to make
anew. (To furnish a space anew instead makes it grow without end.)"""
_STATE = ("poses", "speeds", "world_index", "phases", "clock", "obstacle_poses", "obstacle_speeds")
_Kept = TypeVar("_Kept")
_MARGIN = 1e-6  # metres by which a clearance must exceed what is needed, far above rounding


class Physics:
    """Robots in worlds, stepped together; robots never touch each other.

    Obstacles and walls whose heights overlap the robot's are static shapes; those that it passes under are left out.

    Args:
        worlds: the worlds, each simulated in a space of its own that is built when a robot first comes near something.
        num_robots: how many robots; all stand at the origin of the first world until they are placed.
        robot: what they are.
        substep: greatest length of a physics step, seconds.

    Attributes:
        poses: ``(N, 3)`` float64 x, y (metres) and yaw (radians, in (−π, π]).
        speeds: ``(N, 2)`` float64, forward (m/s) and turning (rad/s) speed of the wheels.
        world_index: ``(N,)`` the world that each robot is in.
        phases: ``(N, D)`` in [0, 1), where in their periods moving obstacles were when each robot was placed.
        clock: ``(N,)`` seconds since then.
        obstacle_poses: ``(N, D, 3)`` where each robot's dynamic obstacles are: x, y (metres), angle (radians); see
            ``navsim.dynamics``. Every robot has its own.
        obstacle_speeds: ``(N, D, 3)`` m/s and rad/s, of pushable ones.
        touched_solid: ``(N,)`` bool, whether each touched something that does not give way in the last ``drive``.
        touched_pushable: ``(N,)`` bool, whether it touched something pushable then.
    """

    def __init__(
        self, worlds: Sequence[World], num_robots: int = 1, robot: Robot = TURTLEBOT2, substep: float = 0.02
    ) -> None:
        if not (math.isfinite(substep) and substep > 0.0):
            raise ValueError(f"the physics substep must be a positive number of seconds; got {substep!r}")
        longest = robot.radius / robot.max_linear_speed
        if substep > longest + 1e-9:
            raise ValueError(
                f"the physics substep must be at most {longest:.3g} s, in which the robot moves by its radius; got "
                f"{substep:g} s, in which it could pass through thin walls"
            )
        self.worlds = tuple(worlds)
        self.robot = robot
        self.substep = substep
        self.poses = np.zeros((num_robots, 3))
        self.speeds = np.zeros((num_robots, 2))
        self.world_index = np.zeros(num_robots, dtype=np.intp)
        self.dynamics = Dynamics(self.worlds)
        self.phases = np.zeros((num_robots, self.dynamics.most))
        self.clock = np.zeros(num_robots)
        self.obstacle_poses = self.dynamics.poses(self.world_index, self.phases, self.clock)
        self.obstacle_speeds = np.zeros((num_robots, self.dynamics.most, 3))
        self.touched_solid: np.ndarray = np.zeros(num_robots, dtype=bool)
        self.touched_pushable: np.ndarray = np.zeros(num_robots, dtype=bool)
        self._furnish()

    def _furnish(self) -> None:
        self._spaces: dict[int, _Space] = {}
        self._contact_spaces: dict[int, ContactSpace] = {}
        self._bodies = [_RobotBody(self.robot) for _ in self.poses]
        # A distance from the robot's centre within which nothing stands, metres; negative where unknown.
        self._free_radius = np.full(len(self.poses), -1.0)

    def __getstate__(self) -> dict[str, Any]:
        # Chipmunk's things lose what they tell of contacts when they are copied, and are made anew where needed.
        made_anew = ("_spaces", "_contact_spaces", "_bodies", "_free_radius")
        return {name: value for name, value in self.__dict__.items() if name not in made_anew}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._furnish()

    def place(
        self,
        robots: np.ndarray | Sequence[int],
        world_index: np.ndarray | int,
        poses: np.ndarray,
        phases: np.ndarray | Sequence[float] = (),
    ) -> None:
        """Puts some robots somewhere, at rest, among pushable obstacles as the file puts them.

        Args:
            robots: ``(K,)`` indices of robots.
            world_index: ``(K,)`` or one for all, the worlds to put them into.
            poses: ``(K, 3)`` x, y (metres) and yaw (radians).
            phases: ``(K, d)``, or ``(d,)`` for all, where in their periods the first d dynamic obstacles are, in
                [0, 1); 0 for the others.
        """
        self.poses[robots] = poses
        self.poses[robots, 2] = wrap_angle(self.poses[robots, 2])
        self.world_index[robots] = world_index
        self.speeds[robots] = 0.0
        self._free_radius[robots] = -1.0
        if self.dynamics.most:
            given = np.broadcast_to(phases, (len(robots), np.shape(phases)[-1]))
            self.phases[robots], self.clock[robots] = 0.0, 0.0
            self.phases[robots, : given.shape[1]] = given
            self.obstacle_poses[robots] = self.dynamics.poses(
                self.world_index[robots], self.phases[robots], self.clock[robots]
            )
            self.obstacle_speeds[robots] = 0.0

    def drive(self, commands: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Lets every robot follow its command for a while.

        Commands beyond the robot's greatest speeds are cut; acceleration limits are met substep by substep. The
        wheels turn as told whatever the robot touches: one that presses against a wall keeps turning.

        Args:
            commands: ``(N, 2)`` linear (m/s) and angular (rad/s) commands.
            duration: seconds; cut into equal substeps of at most ``substep``.

        Returns:
            ``(N, 3)`` float64 poses afterwards (a copy), and ``(N,)`` bool: the bumper touched something on the way,
            whether that gives way or not.
        """
        self.touched_solid[:] = self.touched_pushable[:] = False
        substeps = max(1, math.ceil(duration / self.substep - 1e-9))
        dt = duration / substeps
        speeds = self._speeds_by_substep(commands, substeps, dt)
        # Nothing that a round robot without friction touches can turn it: headings are known in advance.
        turned = np.cumsum(speeds[..., 1] * dt, axis=1)
        headings = self.poses[:, 2, None] + turned
        velocities = _chord_velocities(speeds, headings - 0.5 * dt * speeds[..., 1], dt)
        # Summed one by one, as Chipmunk does.
        track = np.cumsum(np.concatenate([self.poses[:, None, :2], velocities * dt], axis=1), axis=1)

        travel = np.abs(speeds[..., 0]).sum(axis=1) * dt
        near = self._near_something(travel)
        touched = np.zeros(len(self.poses), dtype=bool)
        positions = track[:, -1]
        if self.dynamics.most:
            lively = self._drive_among_dynamic_obstacles(positions, velocities, travel, dt)
            near = near[~lively[near]]
        for world in np.unique(self.world_index[near]):
            members = near[self.world_index[near] == world]
            positions[members], touched[members] = self._space(world).simulate(
                [self._bodies[member] for member in members], self.poses[members, :2], velocities[members], dt
            )
        self.poses[:, :2] = positions
        self.poses[:, 2] = wrap_angle(headings[:, -1])
        self.speeds = speeds[:, -1].copy()
        self.touched_solid |= touched
        bumper: np.ndarray = self.touched_solid | self.touched_pushable
        return self.poses.copy(), bumper

    def moving_prisms(self, robots: np.ndarray, with_pushable: bool = True) -> MovingPrisms | None:
        """What ``navsim.raycast.cast`` needs to show some robots ``(K,)`` their dynamic obstacles; None without any."""
        if not self.dynamics.most:
            return None
        keep = None if with_pushable else self.dynamics.moves
        return self.dynamics.prisms(self.world_index[robots], self.obstacle_poses[robots], keep)

    def _drive_among_dynamic_obstacles(
        self, positions: np.ndarray, velocities: np.ndarray, travel: np.ndarray, dt: float
    ) -> np.ndarray:
        """Moves all dynamic obstacles, and the robots that come near them or whose pushable ones do not rest.

        Args:
            positions: ``(N, 2)`` where robots end if they touch nothing, metres; overwritten for those driven here.
            velocities: ``(N, S, 2)`` m/s, the commanded ones of each substep.
            travel: ``(N,)`` metres that robots may move.
            dt: length of a substep, seconds.

        Returns:
            ``(N,)`` bool: the robots that were driven here.
        """
        substeps = velocities.shape[1]
        involved = self._involved_obstacles(travel, substeps * dt)
        lively: np.ndarray = np.any(involved, axis=1)
        for index in np.flatnonzero(lively).tolist():
            world, near = int(self.world_index[index]), involved[index]
            fastest = float(self.dynamics.top_speed[world, near].max())
            fine = max(1, math.ceil(fastest * dt / LONGEST_STEP))
            times = self.clock[index] + (dt / fine) * np.arange(substeps * fine + 1)
            rows = np.full(len(times), world), np.broadcast_to(self.phases[index], (len(times), self.dynamics.most))
            position, self.touched_solid[index], self.touched_pushable[index] = self._contact_space(world).simulate(
                self.poses[index, :2],
                velocities[index],
                dt,
                self.dynamics.poses(*rows, times),
                near,
                self.obstacle_poses[index],
                self.obstacle_speeds[index],
            )
            positions[index] = position
            self._free_radius[index] = -1.0
        self.clock += substeps * dt
        moved = self.dynamics.poses(self.world_index, self.phases, self.clock)
        self.obstacle_poses = np.where(self.dynamics.moves[self.world_index][..., None], moved, self.obstacle_poses)
        return lively

    def _involved_obstacles(self, travel: np.ndarray, duration: float) -> np.ndarray:
        """``(N, D)`` bool: the dynamic obstacles that might touch the robot or a pushable obstacle in ``duration``.

        Where that concerns a pushable obstacle, all obstacles are involved: it may be pushed into any of them.
        """
        dynamics, world = self.dynamics, self.world_index
        poses, reach = self.obstacle_poses, dynamics.reach[world]
        moves, is_pushable = dynamics.moves[world], dynamics.is_pushable[world]
        way = dynamics.top_speed[world] * duration
        needed = self.robot.radius + travel[:, None] + way + _MARGIN
        offset = poses[..., :2] - self.poses[:, None, :2]
        doubtful = (moves | is_pushable) & (dynamics.base[world] < self.robot.height)
        doubtful &= np.hypot(offset[..., 0], offset[..., 1]) < reach + needed
        involved = doubtful.copy()
        robot, slot = np.nonzero(doubtful)
        distance = dynamics.distances(world[robot], slot, poses[robot, slot], self.poses[robot, :2])
        involved[robot, slot] = distance < needed[robot, slot]

        stirs = (is_pushable & (involved | (self.obstacle_speeds != 0.0).any(axis=-1))).any(axis=1)
        robot, slot, other = np.nonzero(~stirs[:, None, None] & moves[:, :, None] & is_pushable[:, None, :])
        apart = poses[robot, slot, :2] - poses[robot, other, :2]
        needed = reach[robot, other] + way[robot, slot] + _MARGIN
        shares_heights = dynamics.base[world[robot], slot] < dynamics.top[world[robot], other]
        close = np.flatnonzero(shares_heights & (np.hypot(apart[:, 0], apart[:, 1]) < reach[robot, slot] + needed))
        robot, slot, other = robot[close], slot[close], other[close]
        distance = dynamics.distances(world[robot], slot, poses[robot, slot], poses[robot, other, :2])
        stirs[robot[distance < needed[close]]] = True
        involved[stirs] = (moves | is_pushable)[stirs]
        return involved

    def state_dict(self) -> dict[str, np.ndarray]:
        """All that a later ``drive`` depends on, as copies."""
        return {name: getattr(self, name).copy() for name in _STATE}

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Continues from a ``state_dict`` of as many robots in the same worlds."""
        for name in _STATE:
            getattr(self, name)[:] = state[name]
        self._free_radius[:] = -1.0

    def _speeds_by_substep(self, commands: np.ndarray, substeps: int, dt: float) -> np.ndarray:
        """``(N, substeps, 2)`` speeds: the command, or the ramp towards it."""
        robot = self.robot
        greatest = np.array([robot.max_linear_speed, robot.max_angular_speed])
        targets = np.clip(commands, -greatest, greatest)[:, None, :]
        limits = [robot.linear_acceleration, robot.angular_acceleration]
        if limits == [None, None]:
            return np.broadcast_to(targets, (len(targets), substeps, 2))
        acceleration = np.array([np.inf if limit is None else limit for limit in limits])
        change = acceleration * (dt * np.arange(1, substeps + 1)[:, None])
        start = self.speeds[:, None, :]
        return start + np.clip(targets - start, -change, change)

    def _near_something(self, travel: np.ndarray) -> np.ndarray:
        """Indices of the robots that might touch something within ``travel`` (N,) metres.

        Distances are asked for once and then only reduced by what the robot may have moved since, so that a robot in
        the open asks every few steps. They always err on the safe side: the answer is that of the true distance.
        """
        needed = travel + self.robot.radius + _MARGIN
        for index in np.flatnonzero(self._free_radius < needed):
            space = self._space(self.world_index[index])
            self._free_radius[index] = space.distance(self.poses[index, :2]) - _MARGIN / 2
        near = np.flatnonzero(self._free_radius < needed)
        self._free_radius -= travel + _MARGIN / 1000  # the latter for rounding
        self._free_radius[near] = -1.0
        return near

    def _contact_space(self, world: int) -> ContactSpace:
        return _recent(self._contact_spaces, world, lambda: ContactSpace(self.worlds[world], self.robot))

    def _space(self, world: int) -> _Space:
        return _recent(self._spaces, world, lambda: _Space(self.worlds[world], self.robot))


def _recent(spaces: dict[int, _Kept], world: int, make: Callable[[], _Kept]) -> _Kept:
    """A world's space, of those that are kept or new; the one that was not used for longest goes if there are many."""
    spaces[world] = spaces.pop(world, None) or make()  # the one used last is the last
    if len(spaces) > _MOST_SPACES:
        del spaces[next(iter(spaces))]
    return spaces[world]


def obstacle_poses_along(
    world: World,
    start: np.ndarray,
    phases: np.ndarray | Sequence[float],
    commands: np.ndarray,
    duration: float,
    robot: Robot = TURTLEBOT2,
    substep: float = 0.02,
    wheel_errors: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Where a world's dynamic obstacles are while a robot drives: its episode once more, for pictures of it.

    Args:
        world: the world.
        start: ``(3,)`` the robot's pose at the beginning.
        phases: of the moving obstacles at the beginning.
        commands: ``(K, 2)`` m/s and rad/s.
        duration: of each command, seconds.
        robot: who drives.
        substep: of the physics, seconds.
        wheel_errors: of the left and the right wheel, see ``navsim.robot.with_wheel_errors``.

    Returns:
        ``(K + 1, D, 3)``, at the beginning and after each command; see ``navsim.dynamics``.
    """
    physics = Physics([world], 1, robot, substep)
    own = phases[: physics.dynamics.most]  # a simulator's other worlds have more
    physics.place([0], 0, np.asarray(start, dtype=np.float64)[None], own)
    poses = [physics.obstacle_poses[0].copy()]
    for command in with_wheel_errors(commands, np.array([wheel_errors])):
        physics.drive(command[None], duration)
        poses.append(physics.obstacle_poses[0].copy())
    return np.array(poses)


def _chord_velocities(speeds: np.ndarray, directions: np.ndarray, dt: float) -> np.ndarray:
    """Velocities ``(..., 2)``, m/s, that lead along the chords of the arcs that ``speeds`` (..., 2) run in ``dt``.

    Args:
        speeds: forward (m/s) and turning (rad/s) speed on each arc.
        directions: headings in the middle of each arc, which is where its chord points.
        dt: seconds.
    """
    length = speeds[..., 0] * np.sinc(speeds[..., 1] * dt / (2.0 * np.pi))
    return np.stack([length * np.cos(directions), length * np.sin(directions)], axis=-1)


class _RobotBody:
    """A robot's body and its one shape; in a space only while it drives near something."""

    def __init__(self, robot: Robot) -> None:
        self.body = pymunk.Body(robot.mass, pymunk.moment_for_circle(robot.mass, 0.0, robot.radius))
        self.shape = pymunk.Circle(self.body, robot.radius)
        self.shape.collision_type = _ROBOT
        self.shape.filter = _ROBOTS

    def __del__(self) -> None:
        let_go(self.body, self.shape)

    def accelerate_to(self, velocity: tuple[float, float], dt: float) -> None:
        """Applies the force that makes ``velocity``, m/s, of the present one before contacts are solved."""
        now = self.body.velocity
        gain = self.body.mass / dt
        self.body.force = gain * (velocity[0] - now.x), gain * (velocity[1] - now.y)


class _Space(ContactSpaceOwner):
    """One world's fixed obstacles, as far as they stand in the robot's way, in a Chipmunk space."""

    def __init__(self, world: World, robot: Robot) -> None:
        super().__init__()
        for prism in world.fixed_prisms:
            if prism.overlaps_heights(0.0, robot.height):
                shape: pymunk.Shape
                if prism.is_cylinder:
                    x, y = prism.vertices[0].tolist()
                    shape = pymunk.Circle(self.space.static_body, prism.radius, (x, y))
                else:
                    shape = pymunk.Poly(self.space.static_body, prism.vertices.tolist())
                shape.collision_type = _OBSTACLE
                self.space.add(shape)
        self.tell_contacts(_ROBOT, _OBSTACLE)
        self._in_contact: set[pymunk.Shape] = set()

    def distance(self, point: np.ndarray) -> float:
        """Metres from a point to the nearest obstacle, negative inside one; at most ``_HORIZON``."""
        x, y = point.tolist()
        nearest = self.space.point_query_nearest((x, y), _HORIZON, _ANYTHING)
        return _HORIZON if nearest is None else nearest.distance

    def simulate(
        self, robots: list[_RobotBody], positions: np.ndarray, velocities: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Drives K robots through S substeps.

        Args:
            robots: the K robots' bodies, in no space; they are in none afterwards.
            positions: ``(K, 2)`` metres.
            velocities: ``(K, S, 2)`` m/s, the commanded ones of each substep.
            dt: length of a substep, seconds.

        Returns:
            ``(K, 2)`` positions afterwards, metres, and ``(K,)`` bool: whether each touched something.
        """
        schedules = [[(x, y) for x, y in schedule] for schedule in velocities.tolist()]
        for robot, (x, y), schedule in zip(robots, positions.tolist(), schedules, strict=True):
            robot.body.position, robot.body.velocity = (x, y), schedule[0]
            self.space.add(robot.body, robot.shape)
        touched = np.zeros(len(robots), dtype=bool)
        self._in_contact.clear()
        for substep in range(velocities.shape[1]):
            for robot, schedule in zip(robots, schedules, strict=True):
                if robot.shape in self._in_contact:
                    robot.accelerate_to(schedule[min(substep + 1, len(schedule) - 1)], dt)
                else:
                    robot.body.velocity = schedule[substep]
            starts = [robot.body.position for robot in robots]
            self._in_contact.clear()
            self.space.step(dt)
            if self._in_contact:
                for number, robot in enumerate(robots):
                    if robot.shape in self._in_contact:
                        touched[number] = True
                        self._push_out(robot, starts[number])
        after = np.array([robot.body.position for robot in robots])
        for robot in robots:
            self.space.remove(robot.body, robot.shape)
        return after, touched

    def note_contact(self, arbiter: pymunk.Arbiter) -> None:
        self._in_contact.add(arbiter.shapes[0])

    def _push_out(self, robot: _RobotBody, start: pymunk.Vec2d) -> None:
        """Ends an overlap by moving the body along contact normals, the deepest first, or else back to ``start``."""
        for _ in range(PUSHES):
            depth, normal = self._deepest_contact(robot)
            if depth <= ALLOWED_OVERLAP:
                return
            robot.body.position -= normal * (depth - CONTACT_OVERLAP)
        if self._deepest_contact(robot)[0] > ALLOWED_OVERLAP:
            robot.body.position = start

    def _deepest_contact(self, robot: _RobotBody) -> tuple[float, pymunk.Vec2d]:
        """How deep the robot is in an obstacle, metres, and the direction into it; 0 where it touches nothing."""
        contacts = [info.contact_point_set for info in self.space.shape_query(robot.shape)]
        depths = [max(-point.distance for point in contact.points) for contact in contacts]
        if not depths:
            return 0.0, pymunk.Vec2d.zero()
        deepest = int(np.argmax(depths))
        return depths[deepest], contacts[deepest].normal
