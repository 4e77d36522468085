"""The evaluation of a policy: every path of a world, greedy, many at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navsim.camera import DepthCamera
from navsim.dynamics import dynamic_obstacles
from navsim.errors import counted
from navsim.planner import shortest_path_length
from navsim.randomization import Randomization
from navsim.robot import ACTIONS, TURTLEBOT2, Action, Robot
from navsim.sensor import SensorModel
from navsim.simulator import Observation, Simulator, Transition
from navsim.task import Path, Task
from navsim.world import World
from navsim.worldsource import WorldSource, is_generated, worlds_from
from rl.acting import answered, device_of, evaluation_mode, of_policy, one_thread, seeded
from rl.config import GREATEST_SEED, TrainConfig
from rl.metrics import Evaluation, Outcome, PathResult
from rl.observation import history_length, stack_of
from rl.paths import all_paths
from rl.surroundings import Surroundings

_HISTORY = "_history"  # in the states that policies get: the images that their stacks are taken from
_TOGETHER = 100  # paths driven at a time, and the rest of their world's


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
    paths = all_paths(worlds, num_paths, seed)
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
        lossy = simulator.sensor.loses_returns
        memory = Surroundings(len(paths), simulator.camera, robot=robot, lossy=lossy)
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
        with seeded(device_of(policy), seed):
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
    device = device_of(policy)
    with torch.no_grad(), greedily, evaluation_mode(policy), one_thread():
        while len(running):
            given = state.exclude(_HISTORY)
            given = given if device.type == "cpu" else given.to(device)
            answer = policy(given)
            answer = answered(given if answer is None else answer, len(running))
            state.update(answer.to("cpu"))
            if state.get("action", None) is None:
                raise ValueError(f'the policy gave no "action", only {", ".join(map(str, answer.keys()))}')
            if state["action"].numel() != len(running):
                raise ValueError(
                    f"the policy gave actions of shape {tuple(state['action'].shape)} for "
                    f"{counted(len(running), 'robot')}; an action is one integer, its index in navsim.robot.ACTIONS"
                )
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
