"""One episode as a film: a policy drives a path of a world, and what it sees and expects is shown."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from rich.console import Console
from tensordict import TensorDictBase

from navsim.animation import animate_episode, check_animation
from navsim.robot import NUM_ACTIONS
from navsim.sensor import SensorModel
from navsim.world import Goal, Start
from navsim.worldsource import WorldSource, world_from
from rl.acting import answered, of_policy
from rl.config import TrainConfig
from rl.evaluation import Planner, Policy, evaluate_as_trained
from rl.metrics import PathResult
from rl.policies import find_policy
from rl.surroundings import REACH

_Place = TypeVar("_Place", Start, Goal)


def drive(
    policy: str | Policy,
    world: WorldSource,
    output: str | os.PathLike[str],
    *,
    start: int | None = None,
    goal: int | None = None,
    seed: int = 0,
    speed: float = 2.0,
    weights: Literal["best", "last"] = "best",
    symmetric: bool | None = None,
    sensor: SensorModel | None = None,
    console: Console | None = None,
) -> PathResult:
    """Drives one path with a policy and writes the episode as a film.

    Args:
        policy: a run's directory, ``pretrained:NAME``, or the name of a baseline; or a policy as ``rl.evaluate`` takes
            it, which is driven with the Kinect at 80x64 unless it is from ``rl.load_policy``.
        world: a world file, the name of a shipped world, or a generated room, such as ``generate:clutter,seed=3``.
        output: film to write, ``.mp4`` or ``.gif``.
        start: which of the world's starts, counted from 0 as in pictures, reports and messages; by default the first.
        goal: which of the world's goals, counted from 0; by default the one that is farthest from the start, or the
            first where starts are random.
        seed: of what the world leaves open: yaws, random starts and goals.
        speed: how many times faster than real time the film plays, 0.01 to 100.
        weights: of a run: those that did best in its evaluations, or the last.
        symmetric: of what is named: whether to go by the mean of the network's values for what it sees and for the
            mirror image of that; by default as it was trained for.
        sensor: what makes its images; by default the one that it was trained with.
        console: where progress is shown; nowhere by default.

    Returns:
        what became of the path.

    Raises:
        ValueError: for a file name with another suffix, a start or goal that the world does not have, or a speed or
            seed that cannot be used.
        RunError: for a policy that there is not, or that cannot be used.
        navsim.WorldError: for a world that cannot be used.
    """
    output = Path(output)
    check_animation(output, speed)
    room = world_from(world)
    starts = _chosen("start", room.starts, start, room.name)
    goals = _chosen("goal", room.goals, goal, room.name)
    if not isinstance(starts, str) and start is None:
        starts = starts[:1]
    if not isinstance(goals, str) and not isinstance(starts, str) and goal is None:
        goals = (max(goals, key=lambda place: np.hypot(*np.subtract(place.at, starts[0].at))),)
    elif not isinstance(goals, str) and goal is None:
        goals = goals[:1]
    if isinstance(policy, str):
        driver, config = find_policy(policy, weights=weights, symmetric=symmetric)
    else:
        driver, config = policy, of_policy(policy, "trained_as") or TrainConfig()
    watched = driver if isinstance(driver, Planner) else _Watched(driver)
    result = evaluate_as_trained(
        watched,
        config,
        room.model_copy(update={"starts": starts, "goals": goals}),
        name=policy if isinstance(policy, str) else "",
        sensor=sensor,
        seed=seed,
        num_paths=1,
        console=console,
    ).paths[0]
    animate_episode(
        output,
        room,
        result.trajectory,
        result.goal,
        actions=result.actions,
        outcome=result.outcome,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        obstacle_poses=result.obstacle_poses(room, config.task, config.robot),
        **(watched.kept() if isinstance(watched, _Watched) else {}),
        speed=speed,
    )
    return result


def _chosen(
    kind: str, places: tuple[_Place, ...] | Literal["random"], number: int | None, world: str
) -> tuple[_Place, ...] | Literal["random"]:
    """The places to draw from, or the one that ``number`` names."""
    if number is None:
        return places
    if isinstance(places, str):
        raise ValueError(f'world "{world}" draws its {kind}s at random; leave --{kind} out, and vary --seed instead')
    if not 0 <= number < len(places):
        raise ValueError(f'world "{world}" has {kind}s 0 to {len(places) - 1}; --{kind} asks for {number}')
    return (places[number],)


class _Watched(torch.nn.Module):
    """A policy that keeps what it acted on, for the film: images, its Q-values and what it remembers, if it has any."""

    def __init__(self, policy: Callable[[TensorDictBase], Any]) -> None:
        super().__init__()
        self._policy = policy
        self.training = getattr(policy, "training", False)  # to which an evaluation returns
        self.in_keys = of_policy(policy, "in_keys") or ()
        self._images: list[torch.Tensor] = []
        self._values: list[torch.Tensor] = []
        self._surroundings: list[torch.Tensor] = []

    def forward(self, state: TensorDictBase) -> TensorDictBase:
        """What the policy does."""
        answer = self._policy(state)
        if answer is not None and answer is not state:
            state.update(answered(answer, len(state)))
        self._images.append(state["depth"][0, -1].clone())
        values = state.get("action_value", None)
        if values is not None and values.shape[1:] == (NUM_ACTIONS,):  # else they are another kind's, such as logits
            self._values.append(values[0].clone())
        if "surroundings" in self.in_keys:
            self._surroundings.append(state["surroundings"][0].clone())
        return state

    def kept(self) -> dict[str, np.ndarray]:
        """What ``animate_episode`` shows of the K steps: the newest ``images`` ``(K, H, W)``, ``q_values`` ``(K, 7)``,
        ``remembered`` ``(K, SECTORS)``."""
        kept = {"images": torch.stack(self._images).cpu().numpy()}
        if self._values:
            kept["q_values"] = torch.stack(self._values).cpu().numpy()
        if self._surroundings:
            near = torch.stack(self._surroundings).cpu().numpy()
            kept["remembered"] = np.where(near < REACH, near, np.inf)
        return kept
