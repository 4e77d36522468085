"""What became of the paths that a policy drove: the metrics of robot navigation, in files and on the screen."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, Literal

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from navsim.dynamics import dynamic_obstacles
from navsim.errors import counted
from navsim.files import atomic_write
from navsim.physics import obstacle_poses_along
from navsim.robot import INITIAL_COMMAND, NUM_ACTIONS, TURTLEBOT2, Robot, apply_actions
from navsim.task import Task
from navsim.world import World

Outcome = Literal["success", "collision", "timeout"]
OUTCOMES: tuple[Outcome, ...] = ("success", "collision", "timeout")
"""How a path ends."""

_FORMAT = 1
_Z_95 = 1.959963984540054  # the normal distribution's 97.5% quantile


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
