"""Robots in worlds, stepped together: the one door to the simulator."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from functools import cached_property
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from navsim.camera import DepthCamera, Mounts
from navsim.dynamics import MovingPrisms
from navsim.physics import Physics
from navsim.randomization import Randomization
from navsim.raycast import Scene, cast
from navsim.robot import INITIAL_COMMAND, NUM_ACTIONS, TURTLEBOT2, Robot, apply_actions, with_wheel_errors
from navsim.sensor import Sensor, SensorModel
from navsim.settings import is_of_kind
from navsim.task import Episode, Episodes, Path, Task, goal_distance, heading, rewards
from navsim.world import World


class Observation(NamedTuple):
    """What every robot perceives after a reset."""

    depth: np.ndarray
    """``(N, H, W)`` uint8, the depth image as the networks get it now: 255 is the camera's ``max_range``"""
    heading: np.ndarray
    """``(N,)`` float32, θ, the goal's bearing in the robot's frame, radians in (−π, π]"""
    pose: np.ndarray
    """``(N, 3)`` float32, x, y (metres), yaw (radians); for analysis"""


class Transition(NamedTuple):
    """What one step brings every robot. An episode has ended where ``terminated`` or ``truncated`` is set."""

    depth: np.ndarray
    """``(N, H, W)`` uint8, as in ``Observation``"""
    heading: np.ndarray
    """``(N,)`` float32, radians"""
    pose: np.ndarray
    """``(N, 3)`` float32, metres and radians"""
    reward: np.ndarray
    """``(N,)`` float32"""
    terminated: np.ndarray
    """``(N,)`` bool, the goal was reached or the robot collided"""
    truncated: np.ndarray
    """``(N,)`` bool, the time is up, and the episode did not terminate in this very step"""
    success: np.ndarray
    """``(N,)`` bool, the goal was reached"""
    collision: np.ndarray
    """``(N,)`` bool, the robot collided, and did not reach the goal in this very step"""
    bumper: np.ndarray
    """``(N,)`` bool, the bumper hit something that counts as a collision during the step, whatever else happened"""
    too_near: np.ndarray
    """``(N,)`` bool, a pixel that counts is nearer than the task's ``collision_depth``, whatever else happened"""
    pushed: np.ndarray
    """``(N,)`` bool, the bumper touched something pushable during the step; whether that counts, the task says"""


class Simulator:
    """N robots that navigate in one world or many; they do not see or touch each other.

    Each has a copy of its own of whatever moves or can be pushed, as if it were alone in its world.

    Every robot draws its episodes from a random generator of its own, so they do not depend on what the others do or
    on how many there are.

    Args:
        worlds: a world for all robots, or several: robot ``i`` is at home in ``worlds[i % len(worlds)]``.
        num_robots: N.
        camera: the depth camera.
        task: the rules of an episode.
        robot: the robot.
        sensor: what the depth sensor makes of ideal images; by default nothing but ``uint8``.
        randomization: what each episode draws anew; by default nothing.
        seed: of all that is drawn; None for a seed from the operating system.
        draw_worlds: let each episode draw its world from ``worlds`` instead.

    Attributes:
        goals: ``(N, 2)`` float64, metres.
        commands: ``(N, 2)`` float64, linear (m/s) and angular (rad/s) commands in force.
        steps: ``(N,)`` int64, steps since the episode began.
        ideal_depth: ``(N, H, W)`` float32, the last images as the ideal sensor sees them, metres.
        mounts: how each robot carries its camera.
        wheel_errors: ``(N, 2)`` float64, share by which each robot's left and right wheel turn too fast.

    Raises:
        ValueError: for settings that cannot work, in one sentence.

    >>> start, goal = {"at": [-2, 0], "yaw_deg": 0}, [2, 0]
    >>> world = World.from_dict({"format": 1, "size": [7, 7], "starts": [start], "goals": [goal]})
    >>> simulator = Simulator(world, num_robots=2, seed=0)
    >>> simulator.reset().heading.tolist()
    [0.0, 0.0]
    >>> transition = simulator.step(np.array([1, 2]))  # faster; turn left
    >>> transition.reward.astype(float).round(4).tolist()
    [0.07, 0.0295]
    """

    def __init__(
        self,
        worlds: World | Sequence[World],
        num_robots: int = 1,
        *,
        camera: DepthCamera | None = None,
        task: Task | None = None,
        robot: Robot = TURTLEBOT2,
        sensor: SensorModel | None = None,
        randomization: Randomization | None = None,
        seed: int | None = None,
        draw_worlds: bool = False,
    ) -> None:
        if isinstance(worlds, str | PathLike):
            raise TypeError(f"a simulator takes worlds, not their names: load_world({str(worlds)!r}) reads one")
        self.worlds = (worlds,) if isinstance(worlds, World) else tuple(worlds)
        for world in self.worlds:
            if not isinstance(world, World):
                raise TypeError(f"a simulator takes worlds, not {world!r}: load_world reads one from a file")
        if not self.worlds:
            raise ValueError("a simulator needs at least one world; got an empty sequence")
        if not is_of_kind("int", num_robots) or num_robots < 1:
            raise ValueError(
                f"a simulator needs a whole number of robots, at least one; got num_robots = {num_robots!r}"
            )
        self.num_robots = num_robots
        self.camera = camera or DepthCamera()
        self.task = task or Task()
        self.task.check_camera(self.camera)
        self.robot = robot
        self.sensor = sensor or SensorModel()
        self.randomization = randomization or Randomization()
        self.randomization.check(self.camera, self.task, self.sensor)
        self._is_randomized = self.randomization != Randomization()
        self.draw_worlds = draw_worlds
        self.goals = np.zeros((num_robots, 2))
        self.commands = np.tile(np.array(INITIAL_COMMAND), (num_robots, 1))
        self.steps = np.zeros(num_robots, dtype=np.int64)
        self.ideal_depth = np.zeros((num_robots, self.camera.height, self.camera.width), dtype=np.float32)
        self.mounts = self.camera.mounts(num_robots)
        self.wheel_errors = np.zeros((num_robots, 2))
        most_latency = self.sensor.latency + self.randomization.latency[1]
        self._sensor = Sensor(self.camera, self.sensor, num_robots, most_latency)
        # Newest first, as the sensor keeps its images.
        self._past_poses = np.zeros((num_robots, most_latency + 1, 3))
        self._scene = Scene([world.fixed_prisms for world in self.worlds])
        self._physics = Physics(self.worlds, num_robots, robot, self.task.substep)
        self._episodes: dict[int, Episodes] = {}
        self._start_and_goal = np.full((num_robots, 2), -1)
        self._ended = np.ones(num_robots, dtype=bool)
        self.reseed(seed)

    @property
    def poses(self) -> np.ndarray:
        """``(N, 3)`` float64, x, y (metres) and yaw (radians)."""
        return self._physics.poses

    @property
    def phases(self) -> np.ndarray:
        """``(N, D)`` where in their periods, from 0 to 1, moving obstacles were when each robot's episode began."""
        return self._physics.phases

    @property
    def obstacle_poses(self) -> np.ndarray:
        """``(N, D, 3)`` x, y, angle of each robot's own obstacles that move or can be pushed: ``navsim.dynamics``."""
        return self._physics.obstacle_poses

    @property
    def image_poses(self) -> np.ndarray:
        """``(N, 3)`` where the images that the robots get now were taken: their ``poses``, but for latency; a copy."""
        return self._past_poses[np.arange(self.num_robots), self._sensor.latency]

    @property
    def world_index(self) -> np.ndarray:
        """``(N,)`` the world that each robot is in."""
        return self._physics.world_index

    @property
    def paths(self) -> tuple[Path, ...]:
        """The start and goal of each robot's episode, as ``reset`` takes them."""
        ends = zip(self._start_and_goal.tolist(), self.world_index.tolist(), strict=True)
        return tuple(Path(start, goal, world) for (start, goal), world in ends)

    def reseed(self, seed: int | None) -> None:
        """Starts the robots' random generators afresh; running episodes go on."""
        if seed is not None and not (is_of_kind("int", seed) and seed >= 0):
            raise ValueError(f"a seed must be a whole number, at least 0; got {seed!r}")
        sequences = np.random.SeedSequence(seed).spawn(self.num_robots)
        self._generators = [np.random.default_rng(sequence) for sequence in sequences]
        # Episodes are the same ones with and without noise or randomisation: those have generators of their own.
        children = [sequence.spawn(2) for sequence in sequences]
        self._domain_generators = [np.random.default_rng(domain) for domain, _ in children]
        self._sensor.reseed([noise for _, noise in children])

    def reset(self, mask: np.ndarray | None = None, paths: Sequence[Path | None] | None = None) -> Observation:
        """Begins new episodes.

        Args:
            mask: ``(N,)`` bool, the robots to reset; all by default.
            paths: N of them, the starts, goals and worlds to take; None, or None for a robot, draws them.

        Returns:
            What all N robots perceive, reset or not.

        Raises:
            ValueError: for a mask or paths of another length, or a path that does not exist.
        """
        chosen = np.ones(self.num_robots, dtype=bool) if mask is None else self._checked_mask(mask, "reset")
        if paths is not None and len(paths) != self.num_robots:
            raise ValueError(f"there must be one path a robot, {self.num_robots} in all; got {len(paths)}")
        robots = np.flatnonzero(chosen)
        if len(robots):
            wanted = [None if paths is None else paths[robot] for robot in robots.tolist()]
            self._begin(robots, [None if path is None else Path(*path) for path in wanted])
            self.ideal_depth[robots] = self._look(robots)
            self._sensor.begin(robots, self.ideal_depth[robots])
            self._past_poses[robots] = self.poses[robots, None]
        return self._perceived()

    def step(self, actions: np.ndarray, mask: np.ndarray | None = None) -> Transition:
        """One control period for every robot.

        Args:
            actions: ``(N,)`` integers, indices into ``navsim.robot.ACTIONS``.
            mask: ``(N,)`` bool, the robots that are stepped; all by default. For the others no time passes: they stay
                as they are, whether their episodes have ended or not, and their rows of what is returned say what they
                perceive, no reward and no event.

        Raises:
            ValueError: for actions that do not exist, or a mask of another length.
            RuntimeError: when the episode of a robot that is to be stepped has ended and it was not reset.
        """
        if mask is None:
            return self._step_all(actions)
        stepped = self._checked_mask(mask, "step")
        before = self._state()
        self._ended = self._ended & stepped
        try:
            moved = self._step_all(actions)
        except (ValueError, RuntimeError):
            self._ended = before["ended"]
            raise
        self._restore(_rows_of_both(stepped, self._state(), before))
        depth, headings, pose = self._perceived()
        return Transition(
            depth,
            headings,
            pose,
            np.where(stepped, moved.reward, np.float32(0.0)),
            *(stepped & event for event in moved[4:]),
        )

    def _step_all(self, actions: np.ndarray) -> Transition:
        self.commands = apply_actions(self.commands, self._checked(actions))
        driven = with_wheel_errors(self.commands, self.wheel_errors)
        _, bumper = self._physics.drive(driven, self.task.control_period)
        self.steps += 1
        self.ideal_depth = self._look(np.arange(self.num_robots))
        self._sensor.advance(self.ideal_depth)
        self._past_poses = np.concatenate([self.poses[:, None], self._past_poses[:, :-1]], axis=1)
        too_near = self.ideal_depth.min(axis=(1, 2)) < self.task.collision_depth
        if not self.task.pushing_is_collision:
            bumper = self._physics.touched_solid.copy()
            too_near = self._is_too_near_anyway(too_near)
        success = goal_distance(self.poses, self.goals) < self.task.goal_radius
        collision = (bumper | too_near) & ~success
        terminated = success | collision
        truncated = (self.steps >= self.task.max_steps) & ~terminated
        self._ended = terminated | truncated
        headings = heading(self.poses, self.goals)
        return Transition(
            depth=self._sensor.images,
            heading=headings.astype(np.float32),
            pose=self.poses.astype(np.float32),
            reward=rewards(self.task, self.commands[:, 0], headings, success, collision),
            terminated=terminated,
            truncated=truncated,
            success=success,
            collision=collision,
            bumper=bumper,
            too_near=too_near,
            pushed=self._physics.touched_pushable.copy(),
        )

    def state_dict(self) -> dict[str, Any]:
        """All that the simulator's future depends on: numpy arrays, a generator state (a dict) a robot, and a word
        that tells its worlds apart from others."""
        return {**self._state(), "worlds": self._told_worlds}

    def _state(self) -> dict[str, Any]:
        """The same of the robots alone: a row, or an entry, each."""
        return {
            "physics": self._physics.state_dict(),
            "commands": self.commands.copy(),
            "goals": self.goals.copy(),
            "steps": self.steps.copy(),
            "start_and_goal": self._start_and_goal.copy(),
            "ended": self._ended.copy(),
            "generators": [generator.bit_generator.state for generator in self._generators],
            "domain_generators": [generator.bit_generator.state for generator in self._domain_generators],
            "mounts": np.stack(self.mounts, axis=1),
            "wheel_errors": self.wheel_errors.copy(),
            "sensor": self._sensor.state_dict(),
            "past_poses": self._past_poses.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from a ``state_dict`` of a simulator with the same settings, bit for bit.

        Raises:
            ValueError: for a state of another number of robots, of other worlds, or of another shape, such as other
                cameras and sensors have; then nothing is changed. Tasks and robots are not compared.
        """
        if lacking := [key for key in ("steps", "physics") if key not in state]:
            raise ValueError(f"this is no state of a simulator: it has no '{lacking[0]}'")
        if len(state["steps"]) != self.num_robots:
            raise ValueError(
                f"the state holds {len(state['steps'])} robots, but this simulator has {self.num_robots}: "
                "create it with the same num_robots"
            )
        worlds = int(np.max(state["physics"]["world_index"], initial=0)) + 1
        if worlds > len(self.worlds):
            raise ValueError(
                f"the state's robots are in {worlds} worlds or more, and this simulator has {len(self.worlds)}: "
                "create it with the same worlds"
            )
        # States from before they were kept have no such entries.
        missing = {
            "past_poses": np.repeat(np.asarray(state["physics"]["poses"])[:, None], self._past_poses.shape[1], axis=1)
        }
        state = {**missing, **state}
        if "worlds" in state and state["worlds"] != self._told_worlds:
            raise ValueError(
                "the state's robots are in other worlds than this simulator's: create it with the same worlds, in the "
                "same order"
            )
        for key, own, given in _shapes_of_both(self._state(), state):
            if own != given:
                raise ValueError(
                    f"the state's {key} is of shape {given}, and this simulator's of shape {own}: create it with the "
                    "same worlds, camera, sensor and randomization"
                )
        self._restore(state)

    @cached_property
    def _told_worlds(self) -> str:
        return hashlib.sha256("".join(world.fingerprint for world in self.worlds).encode()).hexdigest()

    def _restore(self, state: dict[str, Any]) -> None:
        self._physics.load_state_dict(state["physics"])
        self.commands = np.array(state["commands"], dtype=np.float64)
        self.goals = np.array(state["goals"], dtype=np.float64)
        self.steps = np.array(state["steps"], dtype=np.int64)
        self._start_and_goal = np.array(state["start_and_goal"])
        self._ended = np.array(state["ended"], dtype=bool)
        for name, generators in (("generators", self._generators), ("domain_generators", self._domain_generators)):
            for generator, generator_state in zip(generators, state[name], strict=True):
                generator.bit_generator.state = generator_state
        self.mounts = Mounts(*np.array(state["mounts"], dtype=np.float64).T)
        self.wheel_errors = np.array(state["wheel_errors"], dtype=np.float64)
        self._sensor.load_state_dict(state["sensor"])
        self._past_poses = np.array(state["past_poses"], dtype=np.float64)
        self.ideal_depth = self._look(np.arange(self.num_robots))

    def _begin(self, robots: np.ndarray, paths: list[Path | None]) -> None:
        """Puts ``robots`` ``(K,)`` at the beginnings of episodes, those of one world together."""
        for chosen, world, drawn in self._drawn(robots, paths):
            episodes = self._episodes_of(world)
            poses = [
                self._randomize(robot, episodes, episode) for robot, episode in zip(chosen.tolist(), drawn, strict=True)
            ]
            phases = np.stack([episode.phases for episode in drawn])
            self._physics.place(chosen, world, np.stack(poses), phases)
            self.goals[chosen] = [episode.goal for episode in drawn]
            self._start_and_goal[chosen] = [episode.path[:2] for episode in drawn]
        self.commands[robots] = INITIAL_COMMAND
        self.steps[robots] = 0
        self._ended[robots] = False

    def _drawn(self, robots: np.ndarray, paths: list[Path | None]) -> list[tuple[np.ndarray, int, list[Episode]]]:
        """The next episodes of ``robots`` ``(K,)``: for each world its robots, its index, and theirs.

        What cannot be drawn has changed nothing, not even the generators.
        """
        own = [self._generators[robot] for robot in robots.tolist()]
        before = [(generator, generator.bit_generator.state) for generator in own]
        drawn = []
        try:
            worlds = np.array([self._world_of(robot, path) for robot, path in zip(robots.tolist(), paths, strict=True)])
            for world in np.unique(worlds).tolist():
                members = np.flatnonzero(worlds == world)
                generators = [self._generators[robot] for robot in robots[members]]
                begun = self._episodes_of(world).draw_many(generators, [paths[member] for member in members])
                drawn.append((robots[members], world, begun))
        except ValueError:
            for generator, state in before:
                generator.bit_generator.state = state
            raise
        return drawn

    def _world_of(self, robot: int, path: Path | None) -> int:
        if path is not None:
            if not 0 <= path.world_index < len(self.worlds):
                raise ValueError(
                    f"path {tuple(path)} is in world {path.world_index}, but the worlds are 0 to {len(self.worlds) - 1}"
                )
            return path.world_index
        if self.draw_worlds:
            return int(self._generators[robot].integers(len(self.worlds)))
        return robot % len(self.worlds)

    def _randomize(self, robot: int, episodes: Episodes, episode: Episode) -> np.ndarray:
        """Draws what differs in a robot's next episode; returns its pose at the start, ``(3,)``."""
        if not self._is_randomized:
            return episode.pose
        randomization, generator = self.randomization, self._domain_generators[robot]
        drawn = randomization.draw(generator, self.camera, self.sensor)
        for values, value in zip(self.mounts, drawn.mount, strict=True):
            values[robot] = value
        self.wheel_errors[robot] = drawn.wheel_errors
        self._sensor.latency[robot] = drawn.latency
        self._sensor.noise_level[robot] = drawn.noise_level
        if episode.path.start_index < 0 or not randomization.moves_starts:
            return episode.pose
        return episodes.displace(episode, lambda: randomization.draw_offset(generator), drawn.mount)

    def _episodes_of(self, world: int) -> Episodes:
        if world not in self._episodes:
            self._episodes[world] = Episodes(self.worlds[world], world, self._scene, self.camera, self.task, self.robot)
        return self._episodes[world]

    def _look(self, robots: np.ndarray) -> np.ndarray:
        """``(K, H, W)`` float32, what the ideal sensors of some robots see, metres."""
        return self._images(robots, self._physics.moving_prisms(robots))

    def _images(self, robots: np.ndarray, moving: MovingPrisms | None) -> np.ndarray:
        mounts = self.mounts.take(robots)
        planar = cast(
            self._scene, self.world_index[robots], self.poses[robots], self.camera, mounts=mounts, moving=moving
        )
        return self.camera.from_planar(planar)

    def _is_too_near_anyway(self, too_near: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: those of ``too_near`` that are as near to something else, as if what is pushed were glass."""
        robots = np.flatnonzero(too_near)
        moving = self._physics.moving_prisms(robots, with_pushable=False)
        if moving is None or not len(robots):
            return too_near
        anyway = too_near.copy()
        anyway[robots] = self._images(robots, moving).min(axis=(1, 2)) < self.task.collision_depth
        return anyway

    def _perceived(self) -> Observation:
        headings = heading(self.poses, self.goals)
        return Observation(self._sensor.images, headings.astype(np.float32), self.poses.astype(np.float32))

    def _checked_mask(self, mask: np.ndarray, of: str) -> np.ndarray:
        mask = np.asarray(mask)
        if mask.shape != (self.num_robots,) or mask.dtype != bool:
            raise ValueError(
                f"the {of} mask must be bool of shape ({self.num_robots},); got {mask.dtype} of shape {mask.shape}"
            )
        return mask

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        actions = np.asarray(actions)
        if actions.shape != (self.num_robots,) or not np.issubdtype(actions.dtype, np.integer):
            raise ValueError(
                f"actions must be integers of shape ({self.num_robots},); got {actions.dtype} of shape {actions.shape}"
            )
        if actions.min() < 0 or actions.max() >= NUM_ACTIONS:
            wrong = int(actions[(actions < 0) | (actions >= NUM_ACTIONS)][0])
            raise ValueError(f"actions must lie between 0 and {NUM_ACTIONS - 1}; got {wrong}")
        if self._ended.any():
            raise RuntimeError(f"robot {int(np.argmax(self._ended))} has no running episode: reset it before stepping")
        return actions


def _shapes_of_both(one: dict[str, Any], other: dict[str, Any]) -> Iterator[tuple[str, tuple[int, ...], Any]]:
    """The names of what is in a state, and its shapes in both."""
    for key, value in one.items():
        if isinstance(value, dict):
            yield from ((f"{key}.{name}", *shapes) for name, *shapes in _shapes_of_both(value, other[key]))
        elif isinstance(value, np.ndarray):
            yield key, value.shape, np.shape(other[key])


def _rows_of_both(mask: np.ndarray, ones: Any, others: Any) -> Any:
    """Of two states, the robots in ``mask`` ``(N,)`` of the one and the rest of the other."""
    if isinstance(ones, dict):
        return {key: _rows_of_both(mask, value, others[key]) for key, value in ones.items()}
    if isinstance(ones, np.ndarray):
        return np.where(mask.reshape(-1, *[1] * (ones.ndim - 1)), ones, others)
    return [one if of_one else other for of_one, one, other in zip(mask, ones, others, strict=True)]
