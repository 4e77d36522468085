"""The figures of a run's report: how training went, and what the trained robot does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter, PercentFormatter

from navsim.draw import (
    ACTION_LABELS,
    GOAL,
    INK,
    OUTCOME_COLOURS,
    QUIET_INK,
    draw_goal,
    draw_paths,
    draw_world,
    new_figure,
)
from navsim.task import Task
from navsim.world import World
from rl.metrics import OUTCOMES, Evaluation, PathResult

_MARKERS = ("o", "D", "^", "s", "v", "P", "X")


def training_curves(metrics: Sequence[Mapping[str, str]], evaluations: Sequence[Mapping[str, str]]) -> Figure:
    """How training went: ends of episodes, reward, mean greatest Q-value over fixed states, loss; by step.

    Figures 6.1 and 6.3 of the thesis, with the evaluations (greedy, in the room that is not trained in) as points.

    Args:
        metrics: rows of a run's ``metrics.csv``.
        evaluations: rows of its ``evaluations.csv``.
    """
    figure = new_figure(9.0, 6.0)
    (ends, reward), (max_q, loss) = figure.subplots(2, 2)
    step = _column(metrics, "step")
    evaluated = _column(evaluations, "step")

    for outcome in OUTCOMES:
        colour = OUTCOME_COLOURS[outcome]
        ends.plot(step, _column(metrics, f"{outcome}_rate"), color=colour, lw=1.5, label=outcome)
        ends.plot(evaluated, _column(evaluations, f"{outcome}_rate"), "o", color=colour, ms=4.5, mec="white", mew=0.6)
    ends.set_ylim(-0.02, 1.02)
    ends.yaxis.set_major_formatter(PercentFormatter(1.0))
    ends.legend(fontsize=8, frameon=False, labelcolor=INK, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    _title(ends, "how episodes ended", pad=22)

    colour = OUTCOME_COLOURS["success"]
    reward.plot(step, _column(metrics, "reward"), color=colour, lw=1.5)
    reward.plot(evaluated, _column(evaluations, "reward"), "o", color=colour, ms=4.5, mec="white", mew=0.6)
    handles = [
        Line2D([], [], color=QUIET_INK, lw=1.5, label="training, exploring"),
        Line2D([], [], color=QUIET_INK, ls="none", marker="o", ms=4.5, label="evaluation, greedy"),
    ]
    reward.legend(
        handles=handles,
        fontsize=8,
        frameon=False,
        labelcolor=INK,
        ncols=2,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )
    _title(reward, "reward of an episode", pad=22)

    max_q.plot(step, _column(metrics, "max_q"), color=colour, lw=1.5)
    _title(max_q, "greatest Q-value, mean over fixed states")
    loss.plot(step, _column(metrics, "loss"), color=colour, lw=1.2)
    positive = _column(metrics, "loss")
    if np.nanmax(positive, initial=0.0) > 0.0:
        loss.set_yscale("log")
    _title(loss, "loss")
    for axes in (ends, reward, max_q, loss):
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set_xlim(left=0)
        _quieten(axes)
    for axes in (max_q, loss):
        axes.set_xlabel("environment steps", fontsize=8, color=QUIET_INK)
    return figure


def all_paths(world: World, evaluation: Evaluation) -> Figure:
    """The plan view of a world with every path of an evaluation, coloured by how it ended."""
    figure = new_figure(7.0, 7.4)
    axes = figure.add_subplot()
    draw_world(axes, world)
    draw_paths(axes, [path.trajectory for path in evaluation.paths], [path.outcome for path in evaluation.paths])
    return figure


def choose_examples(evaluation: Evaluation, count: int = 4) -> list[PathResult]:
    """Paths that show the most: the successes that were furthest, one where each failure went furthest.

    Args:
        evaluation: at least one path.
        count: how many; fewer when there are fewer paths.
    """
    by_length = sorted(evaluation.paths, key=lambda path: path.path_length, reverse=True)
    failures = [next((path for path in by_length if path.outcome == outcome), None) for outcome in OUTCOMES[1:]]
    chosen = [path for path in failures if path is not None][: count - 1]
    # Successes from different starts, as far as there are: drives out of the same corner look alike.
    successes = [path for path in by_length if path.outcome == "success"]
    firsts = [path for rank, path in enumerate(successes) if path.start_index not in _starts(successes[:rank])]
    others = [path for path in successes if path not in firsts]
    chosen = [*firsts, *others][: count - len(chosen)] + chosen
    return (chosen + [path for path in by_length if path not in chosen])[:count]


def _starts(paths: Sequence[PathResult]) -> set[int]:
    return {path.start_index for path in paths}


def example_paths(world: World, paths: Sequence[PathResult], task: Task) -> Figure:
    """Plan views with one path each, the robot's start and the goal's disc (figures 6.10 and 6.11 of the thesis)."""
    columns = 2
    rows = -(-len(paths) // columns)
    figure = new_figure(7.6, 4.0 * rows)
    for index, path in enumerate(paths):
        axes = figure.add_subplot(rows, columns, index + 1)
        draw_world(axes, world, starts=False, goals=False, colour_bar=False, legend=False)
        axes.add_patch(Circle(path.goal, task.goal_radius, fc=GOAL, ec=GOAL, alpha=0.25, zorder=1.5))
        draw_goal(axes, path.goal)
        x, y, yaw = path.trajectory[0]
        axes.plot(x, y, marker="o", ms=8, mfc="white", mec=INK, zorder=6)
        axes.annotate(
            "",
            xy=(x + 0.45 * np.cos(yaw), y + 0.45 * np.sin(yaw)),
            xytext=(x, y),
            arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2},
            zorder=6,
        )
        draw_paths(axes, [path.trajectory], [path.outcome], legend=False, line_width=1.8, alpha=1.0)
        axes.axis("off")
        axes.set_title(
            f"{describe(path)}\n{path.outcome} after {path.steps} steps, {path.path_length:.1f} m",
            fontsize=9,
            color=INK,
        )
    return figure


def describe(path: PathResult) -> str:
    """A path's start and goal in words."""
    start = "a drawn start" if path.start_index < 0 else f"start {path.start_index}"
    goal = "a drawn goal" if path.goal_index < 0 else f"goal {path.goal_index}"
    return f"{start} to {goal}"


def action_distribution(evaluations: Sequence[Evaluation]) -> Figure:
    """Shares of the seven actions: bars for the first evaluation, marks for the others (figure 6.9 of the thesis)."""
    figure = new_figure(8.0, 3.4)
    axes = figure.add_subplot()
    positions = np.arange(len(ACTION_LABELS))
    policy, *baselines = evaluations
    axes.bar(positions, policy.action_distribution, width=0.7, color=OUTCOME_COLOURS["success"], label=policy.policy)
    for index, baseline in enumerate(baselines):
        axes.plot(
            positions,
            baseline.action_distribution,
            ls="none",
            marker=_MARKERS[index % len(_MARKERS)],
            ms=6,
            mfc="white",
            mec=INK,
            mew=1.1,
            label=baseline.policy,
        )
    axes.set_xticks(positions, ACTION_LABELS, fontsize=9, color=INK)
    axes.tick_params(axis="x", length=0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.legend(
        fontsize=8, frameon=False, labelcolor=INK, ncols=len(evaluations), loc="lower center", bbox_to_anchor=(0.5, 1.0)
    )
    _quieten(axes)
    return figure


def _column(rows: Sequence[Mapping[str, str]], name: str) -> np.ndarray:
    """A column of a CSV file as floats; cells without a value are NaN."""
    return np.array([float(row[name]) if row.get(name) else np.nan for row in rows])


def _title(axes: Axes, text: str, pad: float = 6.0) -> None:
    axes.set_title(text, fontsize=10, color=INK, loc="left", pad=pad)


def _quieten(axes: Axes) -> None:
    axes.tick_params(which="both", labelsize=8, color=QUIET_INK, labelcolor=QUIET_INK)
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b9c0c8")
