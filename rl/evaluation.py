"""The evaluation of a policy: every path of a world, greedy, with the metrics of robot navigation."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path as FilePath
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
import torch
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navsim.camera import DepthCamera
from navsim.dynamics import dynamic_obstacles
from navsim.errors import counted
from navsim.files import atomic_write
from navsim.physics import obstacle_poses_along
from navsim.planner import shortest_path_length
from navsim.randomization import Randomization
from navsim.robot import ACTIONS, INITIAL_COMMAND, NUM_ACTIONS, TURTLEBOT2, Action, Robot, apply_actions
from navsim.sensor import SensorModel
from navsim.simulator import Observation, Simulator, Transition
from navsim.task import Path, Task
from navsim.world import World
from navsim.worldsource import WorldSource, is_generated, worlds_from
from rl.config import GREATEST_SEED, TrainConfig
from rl.observation import history_length, stack_of
from rl.surroundings import Surroundings

Outcome = Literal["success", "collision", "timeout"]
OUTCOMES: tuple[Outcome, ...] = ("success", "collision", "timeout")
"""How a path ends."""

_FORMAT = 1
_HISTORY = "_history"  # in the states that policies get: the images that their stacks are taken from
_DRAWN_PATHS = 100
MOST_PATHS = 1000
"""Of several worlds together, where it is not said how many."""
_TOGETHER = 100  # paths driven at a time, and the rest of their world's
_Z_95 = 1.959963984540054  # the normal distribution's 97.5% quantile


@runtime_checkable
class Planner(Protocol):
    """A policy that knows the map: it plans whole paths, which are then driven without looking."""

    def plan(
        self,
        world: World,
        starts: np.ndarray,
        goals: np.ndarray,
        camera: DepthCamera,
        task: Task,
        robot: Robot,
        phases: np.ndarray,
    ) -> Iterable[np.ndarray | None]:
        """For each start pose ``(P, 3)`` and goal ``(P, 2)``, ``(K,)`` actions, or None where no way was found.

        ``phases`` ``(P, D)`` tell where the moving obstacles are in their periods when each episode begins.
        """
        ...


Policy = Callable[[TensorDictBase], TensorDictBase | torch.Tensor | Mapping[str, Any] | None] | Planner
"""What can be evaluated: see :func:`evaluate`."""


@dataclass(frozen=True, eq=False)
class PathResult:
    """What became of one path."""

    start_index: int
    """In the world's ``starts``; −1 for a start drawn at random."""
    goal_index: int
    """In the world's ``goals``; −1 for a goal drawn at random."""
    goal: tuple[float, float]
    """Metres."""
    outcome: Outcome
    reward: float
    """Undiscounted sum."""
    shortest_path_length: float
    """Geodesic distance for the robot's radius from the start to the edge of the goal disc, metres."""
    trajectory: np.ndarray
    """``(K + 1, 3)`` x, y (metres), yaw (radians): at the start and after each of the K steps."""
    actions: np.ndarray
    """``(K,)`` int64."""
    bumper: bool = False
    """Of a collision: whether the bumper hit something."""
    too_near: bool = False
    """Of a collision: whether something was seen nearer than the task's ``collision_depth``."""
    phases: tuple[float, ...] = ()
    """Where in their periods, from 0 to 1, the world's moving obstacles were at the start."""
    world_index: int = 0
    """In the evaluation's ``worlds``."""
    wheel_errors: tuple[float, float] = (0.0, 0.0)
    """Shares by which the left and the right wheel turned faster than they were told."""

    @property
    def steps(self) -> int:
        """Control periods that were driven."""
        return len(self.actions)

    @cached_property
    def path_length(self) -> float:
        """Metres driven."""
        return float(np.linalg.norm(np.diff(self.trajectory[:, :2], axis=0), axis=1).sum())

    @cached_property
    def commands(self) -> np.ndarray:
        """``(K + 1, 2)`` linear (m/s) and angular (rad/s) commands in force: at the start and after each action."""
        command, commands = np.array([INITIAL_COMMAND]), [np.array(INITIAL_COMMAND)]
        for action in self.actions:
            command = apply_actions(command, np.array([action]))
            commands.append(command[0])
        return np.array(commands)

    def obstacle_poses(self, world: World, task: Task, robot: Robot = TURTLEBOT2) -> np.ndarray | None:
        """``(K + 1, D, 3)`` where what moves or can be pushed was all along; None in a world where nothing does.

        See ``navsim.physics.obstacle_poses_along``; what was pushed ends where it did up to the rounding of files.
        """
        if not dynamic_obstacles(world):
            return None
        start, period = self.trajectory[0], task.control_period
        return obstacle_poses_along(
            world, start, self.phases, self.commands[1:], period, robot, task.substep, self.wheel_errors
        )

    @property
    def spl(self) -> float:
        """Success weighted by path length: S·l / max(p, l).

        A start on the goal's disc counts as S alone, and so does a way that was pushed free, where there was none.
        """
        if self.outcome != "success":
            return 0.0
        shortest = self.shortest_path_length
        return shortest / max(self.path_length, shortest) if 0.0 < shortest < math.inf else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; positions to 0.1 mm, yaws to 0.0001 rad."""
        return {
            "world_index": self.world_index,
            "start_index": self.start_index,
            "goal_index": self.goal_index,
            "goal": list(self.goal),
            "outcome": self.outcome,
            "bumper": self.bumper,
            "too_near": self.too_near,
            "steps": self.steps,
            "reward": self.reward,
            "path_length": self.path_length,
            "shortest_path_length": self.shortest_path_length if math.isfinite(self.shortest_path_length) else None,
            "phases": list(self.phases),
            "wheel_errors": list(self.wheel_errors),
            "actions": self.actions.tolist(),
            "trajectory": np.round(self.trajectory, 4).tolist(),
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PathResult:
        """The inverse of ``to_dict``."""
        return cls(
            start_index=values["start_index"],
            goal_index=values["goal_index"],
            goal=tuple(values["goal"]),
            outcome=values["outcome"],
            bumper=values.get("bumper", False),  # files of earlier versions do not say
            too_near=values.get("too_near", False),
            phases=tuple(values.get("phases", ())),
            reward=values["reward"],
            shortest_path_length=math.inf if (shortest := values["shortest_path_length"]) is None else shortest,
            trajectory=np.array(values["trajectory"], dtype=np.float64).reshape(-1, 3),
            actions=np.array(values["actions"], dtype=np.int64),
            world_index=values.get("world_index", 0),
            wheel_errors=tuple(values.get("wheel_errors", (0.0, 0.0))),
        )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How a policy did on the paths of a world, or of several."""

    policy: str
    """The policy's name."""
    world: str
    """The world's name; of several, what they are called together."""
    seed: int
    """Of the starts' yaws and of whatever else was drawn."""
    paths: tuple[PathResult, ...]
    """At least one."""
    worlds: tuple[str, ...] = ()
    """Names of the worlds that the paths lie in; by default the one of ``world``."""

    def __post_init__(self) -> None:
        if not self.worlds:
            object.__setattr__(self, "worlds", (self.world,))

    def by_world(self) -> list[Evaluation]:
        """One evaluation for each world that has paths in this one, in the order of ``worlds``."""
        parts = []
        for index, name in enumerate(self.worlds):
            paths = tuple(replace(path, world_index=0) for path in self.paths if path.world_index == index)
            if paths:
                parts.append(Evaluation(self.policy, name, self.seed, paths))
        return parts

    def count(self, outcome: Outcome) -> int:
        """Paths that ended so."""
        return sum(path.outcome == outcome for path in self.paths)

    def rate(self, outcome: Outcome) -> float:
        """Share of the paths that ended so, 0 to 1."""
        return self.count(outcome) / len(self.paths)

    def interval(self, outcome: Outcome) -> tuple[float, float]:
        """Wilson's 95% interval of that share."""
        return wilson_interval(self.count(outcome), len(self.paths))

    @property
    def success_rate(self) -> float:
        """Share of the paths that reached the goal."""
        return self.rate("success")

    @property
    def collision_rate(self) -> float:
        """Share of the paths that ended in a collision."""
        return self.rate("collision")

    @property
    def bumper_rate(self) -> float:
        """Share of the paths that ended in a collision in which the bumper hit something."""
        return sum(path.bumper for path in self.paths) / len(self.paths)

    @property
    def too_near_rate(self) -> float:
        """Share of the paths that ended in a collision by the depth rule; both may happen in one step."""
        return sum(path.too_near for path in self.paths) / len(self.paths)

    @property
    def timeout_rate(self) -> float:
        """Share of the paths that ran into the time limit."""
        return self.rate("timeout")

    @property
    def spl(self) -> float:
        """Success weighted by path length, the mean over all paths (Anderson et al. 2018, arXiv 1807.06757)."""
        return float(np.mean([path.spl for path in self.paths]))

    @property
    def mean_steps(self) -> float:
        """Mean length of a path, steps."""
        return float(np.mean([path.steps for path in self.paths]))

    @property
    def mean_reward(self) -> float:
        """Mean undiscounted return of a path."""
        return float(np.mean([path.reward for path in self.paths]))

    @property
    def action_distribution(self) -> np.ndarray:
        """``(7,)`` share of each action among all that were taken; zeros when none was."""
        counts = np.bincount(np.concatenate([path.actions for path in self.paths]), minlength=NUM_ACTIONS)
        return counts / max(1, counts.sum())

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values: aggregates under ``"summary"``, the paths under ``"paths"``."""
        summary: dict[str, Any] = {"paths": len(self.paths)}
        for outcome in OUTCOMES:
            summary[f"{outcome}_rate"] = self.rate(outcome)
            summary[f"{outcome}_interval"] = list(self.interval(outcome))
        summary |= {
            "bumper_rate": self.bumper_rate,
            "too_near_rate": self.too_near_rate,
            "spl": self.spl,
            "mean_steps": self.mean_steps,
            "mean_reward": self.mean_reward,
            "action_distribution": self.action_distribution.tolist(),
        }
        return {
            "format": _FORMAT,
            "policy": self.policy,
            "world": self.world,
            "worlds": list(self.worlds),
            "seed": self.seed,
            "summary": summary,
            "paths": [path.to_dict() for path in self.paths],
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Evaluation:
        """The inverse of ``to_dict``; aggregates are computed anew from the paths.

        Raises:
            ValueError: for values that ``to_dict`` did not make.
        """
        try:
            if values["format"] != _FORMAT:
                raise ValueError(f"its format is {values['format']!r}; this version reads format {_FORMAT}")
            paths = tuple(PathResult.from_dict(path) for path in values["paths"])
            if not paths:
                raise ValueError("it has no paths")
            worlds = tuple(values.get("worlds", ()))  # files of earlier versions have one world
            if not all(0 <= path.world_index < max(1, len(worlds)) for path in paths):
                raise ValueError(f"a path lies in a world that it does not name among {list(worlds)}")
            return cls(policy=values["policy"], world=values["world"], seed=values["seed"], paths=paths, worlds=worlds)
        except KeyError as error:
            raise ValueError(f"it has no {error}") from error
        except TypeError as error:
            raise ValueError(str(error)) from error

    def to_json(self) -> str:
        """``to_dict`` as JSON text."""
        return json.dumps(self.to_dict(), allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Evaluation:
        """The inverse of ``to_json``.

        Raises:
            ValueError: for text that ``to_json`` did not write.
        """
        return cls.from_dict(json.loads(text))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes ``to_json`` to a file, which appears when it is complete."""
        with atomic_write(FilePath(path)) as file:
            file.write(self.to_json())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Evaluation:
        """Reads what ``save`` wrote.

        Raises:
            ValueError: for a file that is missing or is no evaluation.
        """
        try:
            return cls.from_json(FilePath(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ValueError(f"{os.fspath(path)} cannot be read as an evaluation: {error}") from error


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95% interval of a proportion by Wilson's score (E. B. Wilson, JASA 22, 1927).

    >>> [round(bound, 4) for bound in wilson_interval(8, 10)]
    [0.4902, 0.9433]

    Raises:
        ValueError: without trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} of {trials}: a proportion needs at least one trial, and no more successes")
    share = successes / trials
    weight = _Z_95**2 / trials
    centre = (share + weight / 2) / (1 + weight)
    half_width = math.sqrt(share * (1 - share) * weight + weight**2 / 4) / (1 + weight)
    # At 0 and at 1 the interval touches the end exactly; rounding must not carry it past.
    return (0.0 if successes == 0 else centre - half_width), (1.0 if successes == trials else centre + half_width)


def evaluate(
    policy: Policy,
    world: WorldSource | Sequence[WorldSource],
    *,
    name: str = "",
    camera: DepthCamera | None = None,
    task: Task | None = None,
    robot: Robot | None = None,
    sensor: SensorModel | None = None,
    randomization: Randomization | None = None,
    frame_interval: int | None = None,
    seed: int = 0,
    num_paths: int | None = None,
    console: Console | None = None,
) -> Evaluation:
    """Drives the paths of a world or of several with a policy, greedily, many at once, each in an episode of its own.

    The seed decides the yaws of starts that leave them open, whatever the policy does, so that policies can be
    compared path by path. What a policy draws (from torch's generator) is seeded as well; the generator is put back
    afterwards.

    Args:
        policy: takes a tensordict with ``depth`` uint8 ``(N, 4, H, W)``, ``heading`` float32 ``(N, 1)``, ``command``
            float32 ``(N, 2)``, if its ``in_keys`` name them ``surroundings`` float32 ``(N, 36)``, ``pose`` float32
            ``(N, 3)`` and ``is_init`` bool ``(N, 1)``, true in an episode's first step, and writes ``action`` ``(N,)``,
            or returns the actions alone. What else it writes is there in the next step: its memory, one row a robot;
            what it writes under ``next``, as TorchRL's recurrent modules do, in its place at the root. It gets all this
            on the device of its weights.
            Or a ``Planner``; a path for which it has no plan counts as a timeout of no steps.
        world: a world, the path or name of a world file, or generated rooms such as
            ``"generate:clutter,count=200,seed=1"`` (see ``navsim.worldsource``); or several of these.
        name: of the policy, for tables; by default the policy's own ``name``, or its class's.
        camera: image size and everything else about the camera. This and the four that follow are by default what the
            policy was trained with, if it is from ``rl.load_policy`` (its attribute ``trained_as``).
        task: rewards, ends and time limit.
        robot: its size and limits.
        sensor: noise, lost returns and latency of the images that the policy sees; else none by default.
        frame_interval: steps from one image of the policy's stack to the next; else 1 by default.
        randomization: what each path draws anew of camera, wheels, sensor and start; nothing by default.
        seed: of all that is drawn. In several worlds, paths are driven some hundred at a time, and each hundred draws
            the same numbers.
        num_paths: how many paths to drive. Of one world, the first ones; by default all. Of several, as many in each
            (one more in the first, where that does not come out even), drawn with ``seed`` from those that the world
            lists; by default all, up to ``MOST_PATHS`` together. A world whose starts or goals are random has as many
            as wanted, by default 100.
        console: where a progress bar is shown; nowhere by default.

    Raises:
        navsim.WorldError: for a world that cannot be used.
        ValueError: for settings that cannot be used.
    """
    if not 0 <= seed <= GREATEST_SEED:
        raise ValueError(f"seed must lie between 0 and {GREATEST_SEED}; got {seed}")
    worlds = worlds_from(world)
    if not worlds:
        raise ValueError("an evaluation needs at least one world; got none")
    label = _label(world, worlds)
    paths = _all_paths(worlds, num_paths, seed)
    if not callable(policy) and not isinstance(policy, Planner):
        raise ValueError(
            f"evaluate takes a policy; got {policy!r}: give rl.load_policy of a run or of pretrained:NAME, or "
            "rl.baselines.make_baseline of a baseline's name"
        )
    trained_as: TrainConfig | None = of_policy(policy, "trained_as")
    if trained_as is not None:
        camera, task, robot = camera or trained_as.camera, task or trained_as.task, robot or trained_as.robot
        sensor, frame_interval = sensor or trained_as.sensor, frame_interval or trained_as.frame_interval
    drive = partial(
        _drive_paths,
        policy,
        camera=camera,
        task=task,
        robot=robot or TURTLEBOT2,
        sensor=sensor,
        randomization=randomization,
        frame_interval=frame_interval or 1,
        seed=seed,
    )
    results: list[PathResult] = []
    with _progress(console, label, len(paths)) as advance:
        for part in _parts(paths):
            results += drive(worlds, part, advance=advance)
    policy_name = name or getattr(policy, "name", "") or type(policy).__name__
    return Evaluation(policy_name, label, seed, tuple(results), tuple(world.name for world in worlds))


def evaluate_as_trained(
    policy: Policy,
    config: TrainConfig,
    world: WorldSource | Sequence[WorldSource],
    *,
    name: str = "",
    sensor: SensorModel | None = None,
    randomization: Randomization | None = None,
    seed: int = 0,
    num_paths: int | None = None,
    console: Console | None = None,
) -> Evaluation:
    """``evaluate`` with the camera, rules, robot, sensor and images that a policy was trained with.

    Args:
        policy: see :func:`evaluate`, as all that is not named here.
        config: the settings that it was trained with, which policies from ``rl.load_policy`` bring with them.
        sensor: in place of its own.
    """
    return evaluate(
        policy,
        world,
        name=name,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        sensor=sensor or config.sensor,
        randomization=randomization,
        frame_interval=config.frame_interval,
        seed=seed,
        num_paths=num_paths,
        console=console,
    )


def _label(source: WorldSource | Sequence[WorldSource], worlds: Sequence[World]) -> str:
    listed = [source] if isinstance(source, World | str | os.PathLike) else list(source)
    if len(worlds) == 1 and not is_generated(listed[0]):
        return worlds[0].name
    names = [entry.name if isinstance(entry, World) else os.fspath(entry) for entry in listed]
    return ", ".join(names) if len(names) <= 4 else f"{len(worlds)} worlds"


def _parts(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """The paths, some hundred at a time, in few worlds: a step costs by the robots, starting by the worlds."""
    part: list[Path] = []
    for path in paths:
        if len(part) >= _TOGETHER and path.world_index != part[-1].world_index:
            yield part
            part = []
        part.append(path)
    yield part


def _drive_paths(
    policy: Policy,
    all_worlds: Sequence[World],
    paths: Sequence[Path],
    *,
    camera: DepthCamera | None,
    task: Task | None,
    robot: Robot,
    sensor: SensorModel | None,
    randomization: Randomization | None,
    frame_interval: int,
    seed: int,
    advance: Callable[[int], None],
) -> list[PathResult]:
    """Drives paths, ordered by their worlds, all at once."""
    used = list(dict.fromkeys(path.world_index for path in paths))
    worlds = [all_worlds[index] for index in used]
    local = [path._replace(world_index=used.index(path.world_index)) for path in paths]
    simulator = Simulator(
        worlds,
        len(paths),
        camera=camera,
        task=task,
        robot=robot,
        sensor=sensor,
        randomization=randomization,
        seed=seed,
    )
    observation = simulator.reset(paths=local)
    starts, goals, phases = simulator.poses.copy(), simulator.goals.copy(), simulator.phases.copy()
    wheel_errors = simulator.wheel_errors.copy()
    memory = None
    if "surroundings" in (of_policy(policy, "in_keys") or ()):
        memory = Surroundings(len(paths), simulator.camera, lossy=simulator.sensor.loses_returns)
    state = _first_state(observation, simulator, memory, frame_interval)
    driven = np.ones(len(paths), dtype=bool)
    if isinstance(policy, Planner):
        plans: list[np.ndarray | None] = []
        for index, world in enumerate(worlds):
            own = np.array([path.world_index == index for path in local])
            own_phases = phases[own, : len(dynamic_obstacles(world))]
            for plan in policy.plan(
                world, starts[own], goals[own], simulator.camera, simulator.task, robot, own_phases
            ):
                plans.append(plan)
                advance(1)
        driven = np.array([plan is not None for plan in plans])
        state["plan"] = _padded(plans, simulator.task.max_steps)
        episodes = _drive(_follow_plan, simulator, memory, state, driven, lambda ended: None)
    else:
        with _seeded(_device_of(policy), seed):
            episodes = _drive(policy, simulator, memory, state, driven, advance)
    return [
        PathResult(
            start_index=path.start_index,
            goal_index=path.goal_index,
            goal=_point(goal),
            outcome=episode.outcome,
            reward=episode.reward,
            shortest_path_length=_shortest(
                all_worlds[path.world_index], _point(start), _point(goal), simulator.task, robot
            ),
            trajectory=np.array([start, *episode.poses]),
            actions=np.array(episode.actions, dtype=np.int64),
            bumper=episode.bumper,
            too_near=episode.too_near,
            phases=tuple(own[: len(dynamic_obstacles(all_worlds[path.world_index]))].tolist()),
            world_index=path.world_index,
            wheel_errors=(float(errors[0]), float(errors[1])),
        )
        for path, start, goal, own, errors, episode in zip(
            paths, starts, goals, phases, wheel_errors, episodes, strict=True
        )
    ]


def _point(place: np.ndarray) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def few_paths(worlds: Sequence[World]) -> int | None:
    """How many paths tell enough while training: all of one world; of several 100, or one in each."""
    return None if len(worlds) == 1 else min(max(_DRAWN_PATHS, len(worlds)), sum(map(_number_of_paths, worlds)))


def _number_of_paths(world: World) -> int:
    return len(world.paths) or _DRAWN_PATHS


def _all_paths(worlds: Sequence[World], num_paths: int | None, seed: int) -> list[Path]:
    """The paths to drive, ordered by their worlds."""
    if num_paths is not None and num_paths < 1:
        raise ValueError(f"num_paths must be at least 1; got {num_paths}")
    if len(worlds) == 1:
        return _paths_of(worlds[0], num_paths)
    if num_paths is None:
        num_paths = min(max(MOST_PATHS, len(worlds)), sum(map(_number_of_paths, worlds)))
    if num_paths < len(worlds):
        raise ValueError(f"num_paths ({num_paths}) must be at least 1 in each of the {len(worlds)} worlds")
    shares = _shared_out(num_paths, [len(world.paths) or num_paths for world in worlds])
    generators = np.random.default_rng(seed).spawn(len(worlds))
    paths = []
    for index, (world, share, generator) in enumerate(zip(worlds, shares, generators, strict=True)):
        own = _paths_of(world, None if world.paths else share)
        chosen = np.sort(generator.permutation(len(own))[:share])
        paths += [own[i]._replace(world_index=index) for i in chosen]
    return paths


def _shared_out(wanted: int, most: Sequence[int]) -> list[int]:
    """``wanted`` in shares as even as can be, none of them over ``most``; the first ones take what is left over.

    >>> _shared_out(10, [9, 2, 9])
    [4, 2, 4]
    """
    if wanted > sum(most):
        raise ValueError(f"the {len(most)} worlds have {sum(most)} paths together; num_paths asks for {wanted}")
    shares = [0] * len(most)
    while wanted:
        open_ones = [i for i, share in enumerate(shares) if share < most[i]]
        each = max(1, wanted // len(open_ones))
        for i in open_ones:
            added = min(each, most[i] - shares[i], wanted)
            shares[i] += added
            wanted -= added
    return shares


def _paths_of(world: World, num_paths: int | None) -> list[Path]:
    if num_paths is not None and num_paths < 1:
        raise ValueError(f"num_paths must be at least 1; got {num_paths}")
    if not world.paths:  # starts, goals or both are drawn: the listed ones take turns
        starts = [-1] if isinstance(world.starts, str) else range(len(world.starts))
        goals = [-1] if isinstance(world.goals, str) else range(len(world.goals))
        turns = itertools.cycle(itertools.product(starts, goals))
        return [Path(start, goal) for start, goal in itertools.islice(turns, num_paths or _DRAWN_PATHS)]
    if num_paths is not None and num_paths > len(world.paths):
        raise ValueError(f'world "{world.name}" has {len(world.paths)} paths; num_paths asks for {num_paths}')
    return [Path(start, goal) for start, goal in world.paths[:num_paths]]


def _first_state(
    observation: Observation, simulator: Simulator, memory: Surroundings | None, frame_interval: int
) -> TensorDict:
    count = len(observation.heading)
    images = torch.from_numpy(observation.depth).unsqueeze(1).repeat(1, history_length(frame_interval), 1, 1)
    state = TensorDict(
        {
            _HISTORY: images,
            "depth": stack_of(images),
            "heading": torch.from_numpy(observation.heading).unsqueeze(-1),
            "command": torch.from_numpy(simulator.commands.astype(np.float32)),
            "pose": torch.from_numpy(observation.pose),
            "is_init": torch.ones((count, 1), dtype=torch.bool),
        },
        batch_size=[count],
    )
    if memory is not None:
        memory.begin(observation.depth, simulator.image_poses)
        state["surroundings"] = torch.from_numpy(memory.nearest(simulator.poses))
    return state


@dataclass
class _Episode:
    outcome: Outcome = "timeout"
    bumper: bool = False
    too_near: bool = False
    reward: float = 0.0
    poses: list[np.ndarray] = field(default_factory=list)
    actions: list[int] = field(default_factory=list)


def _drive(
    policy: Callable[[TensorDictBase], TensorDictBase],
    simulator: Simulator,
    memory: Surroundings | None,
    state: TensorDictBase,
    driven: np.ndarray,
    advance: Callable[[int], None],
) -> list[_Episode]:
    """Drives the robots that are in ``driven`` (N,) to the ends of their episodes; the others stay at their starts."""
    episodes = [_Episode() for _ in driven]
    running = np.flatnonzero(driven)  # the episode of each of the simulator's robots
    if 0 < len(running) < len(driven):
        simulator, memory, state = _subset(simulator, memory, state, driven)
    greedily = set_exploration_type(ExplorationType.DETERMINISTIC)
    device = _device_of(policy)
    with torch.no_grad(), greedily, _evaluation_mode(policy), _one_thread():
        while len(running):
            given = state.exclude(_HISTORY)
            given = given if device.type == "cpu" else given.to(device)
            answer = policy(given)
            answer = answered(given if answer is None else answer, len(running))
            state.update(answer.to("cpu"))
            if state.get("action", None) is None:
                raise ValueError(f'the policy gave no "action", only {", ".join(map(str, answer.keys()))}')
            actions = state["action"].reshape(-1).numpy()
            moved = simulator.step(actions)
            ended = moved.terminated | moved.truncated
            for robot, index in enumerate(running):
                episode = episodes[index]
                episode.actions.append(int(actions[robot]))
                episode.poses.append(simulator.poses[robot].copy())
                episode.reward += float(moved.reward[robot])
                if ended[robot]:
                    episode.outcome = _outcome(moved, robot)
                    collided = episode.outcome == "collision"
                    episode.bumper = collided and bool(moved.bumper[robot])
                    episode.too_near = collided and bool(moved.too_near[robot])
            state = _next_state(state, moved, simulator, memory)
            if ended.any():
                running = running[~ended]
                advance(int(ended.sum()))
                if len(running):
                    simulator, memory, state = _subset(simulator, memory, state, ~ended)
    return episodes


def answered(answer: Any, count: int) -> TensorDictBase:
    """What a policy says of ``count`` robots; one that returns a tensor alone returns actions."""
    if isinstance(answer, torch.Tensor):
        answer = {"action": answer}
    if isinstance(answer, Mapping):
        answer = TensorDict(dict(answer), [count])
    if not isinstance(answer, TensorDictBase):
        raise ValueError(f"a policy must return a tensordict or the actions; got {type(answer).__name__}")
    return answer


def _outcome(moved: Transition, robot: int) -> Outcome:
    if moved.success[robot]:
        return "success"
    return "collision" if moved.collision[robot] else "timeout"


def _next_state(
    state: TensorDictBase, moved: Transition, simulator: Simulator, memory: Surroundings | None
) -> TensorDictBase:
    if (for_next := state.pop("next", None)) is not None:
        state.update(for_next)
    images = torch.cat([state[_HISTORY][:, 1:], torch.from_numpy(moved.depth).unsqueeze(1)], dim=1)
    state[_HISTORY], state["depth"] = images, stack_of(images)
    state["heading"] = torch.from_numpy(moved.heading).unsqueeze(-1)
    state["command"] = torch.from_numpy(simulator.commands.astype(np.float32))
    state["pose"] = torch.from_numpy(moved.pose)
    state["is_init"] = torch.zeros_like(state["is_init"])
    if memory is not None:
        memory.see(moved.depth, simulator.image_poses)
        state["surroundings"] = torch.from_numpy(memory.nearest(simulator.poses))
    return state


def _subset(
    simulator: Simulator, memory: Surroundings | None, state: TensorDictBase, kept: np.ndarray
) -> tuple[Simulator, Surroundings | None, TensorDictBase]:
    """Those robots alone, in the middle of their episodes: finished ones cost nothing any more."""
    memory = None if memory is None else memory.take(kept)
    return _simulator_of(simulator, kept), memory, state[torch.from_numpy(kept)]


def _simulator_of(simulator: Simulator, kept: np.ndarray) -> Simulator:
    """A simulator of those robots alone."""

    def pick(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: pick(entry) for key, entry in value.items()}
        if isinstance(value, np.ndarray):
            return value[kept]
        return [entry for entry, keep in zip(value, kept, strict=True) if keep]

    smaller = Simulator(
        simulator.worlds,
        int(kept.sum()),
        camera=simulator.camera,
        task=simulator.task,
        robot=simulator.robot,
        sensor=simulator.sensor,
        randomization=simulator.randomization,
    )
    state = simulator.state_dict()
    del state["worlds"]  # which are the same
    smaller.load_state_dict(pick(state))
    return smaller


@contextmanager
def _one_thread() -> Iterator[None]:
    """Products are computed by one thread: shared out among others, their sums might differ in the last digit."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _seeded(device: torch.device, seed: int) -> Iterator[None]:
    """Seeds torch's generators of the CPU and of a policy's device for a while; no other device's is touched."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.default_generator.manual_seed(seed)
        if device.type == "cuda":
            with torch.cuda.device(device):
                torch.cuda.manual_seed(seed)
        yield


def of_policy(policy: object, name: str) -> Any:
    """An attribute of a policy, or of the module that it wraps, such as torch's ``AveragedModel`` does; else None."""
    while not hasattr(policy, name) and isinstance(inner := getattr(policy, "module", None), torch.nn.Module):
        policy = inner
    return getattr(policy, name, None)


def _device_of(policy: object) -> torch.device:
    """Where a policy's weights are; the CPU if it has none."""
    if isinstance(policy, torch.nn.Module):
        for tensor in itertools.chain(policy.parameters(), policy.buffers()):
            return tensor.device
    return torch.device("cpu")


@contextmanager
def _evaluation_mode(policy: Any) -> Iterator[None]:
    """Modules are switched to evaluation, and each back to what it was."""
    if not isinstance(policy, torch.nn.Module):
        yield
        return
    were_training = {module: module.training for module in policy.modules()}
    policy.eval()
    try:
        yield
    finally:
        for module, was_training in were_training.items():
            module.training = was_training


def _padded(plans: Sequence[np.ndarray | None], length: int) -> torch.Tensor:
    """``(N, length)`` int64: each plan, then "turn no more", by which a plan that falls short is driven on."""
    straight = ACTIONS.index(Action(None, 0.0))
    padded = torch.full((len(plans), length + 1), straight)
    for row, plan in zip(padded, plans, strict=True):
        if plan is not None:
            actions = torch.as_tensor(np.asarray(plan, dtype=np.int64)[:length])
            row[: len(actions)] = actions
    return padded


def _follow_plan(state: TensorDictBase) -> TensorDictBase:
    """Plays the first action of every robot's plan, and moves the plan up."""
    state["action"] = state["plan"][:, 0]
    state["plan"] = state["plan"].roll(-1, dims=1)
    return state


@lru_cache(maxsize=4096)
def _shortest(world: World, start: tuple[float, float], goal: tuple[float, float], task: Task, robot: Robot) -> float:
    """Metres from a start to the edge of the goal's disc. Kept: a world's paths are evaluated again and again."""
    return float(
        shortest_path_length(
            world,
            start,
            goal,
            robot_radius=robot.radius,
            robot_height=robot.height,
            goal_radius=task.goal_radius,
        )
    )


@contextmanager
def _progress(console: Console | None, label: str, total: int) -> Iterator[Callable[[int], None]]:
    """A progress bar over the paths; gives the function that counts those that ended."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=console is None or not console.is_terminal) as bar:
        task = bar.add_task(f"evaluating in {label}", total=total)
        yield lambda ended: bar.advance(task, ended)


def comparison_table(evaluations: Sequence[Evaluation], *, title: str | None = None) -> Table:
    """A table for the screen, one row an evaluation: rates in percent with their 95% intervals.

    Beside the collisions (b/n) stand the shares in which the bumper hit something, and in which something was too near.

    Args:
        evaluations: of one policy in one world each.
        title: over the table; by default the worlds' names, and how many paths were driven.
    """
    worlds = dict.fromkeys(evaluation.world for evaluation in evaluations)
    counts = {len(evaluation.paths) for evaluation in evaluations}
    same_count = f", {counted(counts.pop(), 'path')}" if len(counts) == 1 else ""
    # Without vertical lines it fits a terminal of 80 columns.
    table = Table(
        title=title or escape(", ".join(worlds) + same_count),
        caption="percent; in brackets: Wilson's 95% intervals; bump/near: collisions by the bumper / by the depth rule",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 0, 0, 1),
    )
    table.add_column("policy", style="bold", overflow="fold")  # rather two lines of name than numbers cut short
    if len(worlds) > 1:
        table.add_column("world", overflow="fold")
    if not same_count:
        table.add_column("paths", justify="right", no_wrap=True)
    for heading in ("success", "collision", "bump/near", "timeout", "SPL", "steps", "reward"):
        table.add_column(heading, justify="right", no_wrap=True)
    for evaluation in evaluations:
        rates = []
        for outcome in OUTCOMES:
            low, high = evaluation.interval(outcome)
            rates.append(f"{100 * evaluation.rate(outcome):.0f} [dim]({100 * low:.0f}–{100 * high:.0f})[/dim]")
        table.add_row(
            escape(evaluation.policy),
            *([escape(evaluation.world)] if len(worlds) > 1 else []),
            *([] if same_count else [str(len(evaluation.paths))]),
            *rates[:2],
            f"{100 * evaluation.bumper_rate:.0f}/{100 * evaluation.too_near_rate:.0f}",
            *rates[2:],
            f"{evaluation.spl:.2f}",
            f"{evaluation.mean_steps:.0f}",
            f"{evaluation.mean_reward:+.2f}",
        )
    return table
