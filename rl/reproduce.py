"""The thesis's experiment as a matrix of runs, its tables 6.1 to 6.4 and its figures 6.1 to 6.11.

A *cell* is one training run: a model, an image size, a room and a seed. Each is trained with the preset ``thesis``, and
then its last weights (the thesis had no other) drive the paths of both evaluation rooms. ``rl.series`` runs them.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from tensordict import TensorDict
from torchrl.modules import QValueActor

from navsim.camera import DepthCamera
from navsim.draw import ACTION_LABELS, INK, OUTCOME_COLOURS, QUIET_INK, new_figure, save_figure
from navsim.files import atomic_write
from navsim.raycast import render_depth
from navsim.worldfile import load_world
from rl.config import PRESETS, Model, TrainConfig
from rl.evaluation import evaluate
from rl.figures import choose_examples, example_paths
from rl.metrics import Evaluation
from rl.observation import NUM_FRAMES
from rl.policies import load_policy
from rl.run import Run, Table
from rl.series import Planned, read_results, run_series

ROOMS = ("simple", "complex")
"""Each is trained in as ``ROOM_train`` and evaluated in as ``ROOM_eval``."""
SIZES = ((80, 64), (160, 128))
"""Depth images, columns and rows."""
MODELS: tuple[Model, ...] = ("I", "S")
REPORTED = {("I", "complex"): 0.88, ("S", "complex"): 0.67}
"""Share of goals that the thesis reports for a model trained and evaluated in a room, where this project knows it; of
which image size, it does not."""

_MODEL_COLOURS = {"I": OUTCOME_COLOURS["success"], "S": OUTCOME_COLOURS["collision"]}
_ACTION_COLOURS = ("#9aa3ad", INK, "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00")


class Cell(NamedTuple):
    """One training run of the matrix."""

    model: Model
    width: int
    height: int
    room: str
    seed: int

    @property
    def name(self) -> str:
        """Of the run's directory and of its results."""
        return f"{self.model}-{self.width}x{self.height}-{self.room}-seed{self.seed}"

    def config(self, directory: Path, total_steps: int | None = None) -> TrainConfig:
        """The settings of its run, which lies in ``directory``; ``total_steps`` for a shorter one than the thesis's."""
        thesis = PRESETS["thesis"]
        return dataclasses.replace(
            thesis,
            model=self.model,
            camera=dataclasses.replace(thesis.camera, width=self.width, height=self.height),
            world=(f"{self.room}_train",),
            eval_world=f"{self.room}_eval",
            seed=self.seed,
            total_steps=total_steps or thesis.total_steps,
            num_threads=1,
            checkpoint_interval=25_000,
            report=False,
            out=directory / self.name,
        )


def cells(
    models: Sequence[Model] = MODELS,
    sizes: Sequence[tuple[int, int]] = SIZES,
    rooms: Sequence[str] = ROOMS,
    seeds: Sequence[int] = (0, 1, 2),
) -> list[Cell]:
    """The matrix: small images first, and the first seed of everything before the second of anything."""
    return [
        Cell(model, *size, room, seed)
        for size in sizes
        for seed in seeds
        for room in reversed(rooms)
        for model in models
    ]


def reproduce(
    chosen: Iterable[Cell],
    *,
    runs: Path,
    results: Path,
    total_steps: int | None = None,
    console: Console | None = None,
) -> None:
    """Trains and evaluates what is not finished yet, and writes tables and figures of what is.

    Args:
        chosen: the cells, in the order in which they are run.
        runs: where the runs lie; large, needed only to go on with them.
        results: where JSON, tables and figures go; they are written anew after each cell.
        total_steps: transitions of each run in place of the thesis's 400,000, to try it out.
        console: where progress is shown; standard output by default.

    Raises:
        ValueError: for results of another length that lie where a run's are to go.
        SeriesError: at the end, if runs could not be finished.
    """
    console = console or Console()
    planned = [
        Planned(
            name=cell.name,
            what=f"D3QN-{cell.model} in {cell.room}_train",
            labels=cell._asdict(),
            config=cell.config(runs, total_steps),
            results=results / "cells" / f"{cell.name}.json",
        )
        for cell in chosen
    ]
    run_series(planned, lambda run: _results_of(run, console), lambda: write_up(results), console)


def _results_of(run: Run, console: Console) -> dict[str, Any]:
    """What becomes of a finished run: its logs, and its last weights' evaluations in both rooms."""
    config, actor = run.config, load_policy(run.directory, weights="last")
    evaluations = {
        room: evaluate(
            actor,
            f"{room}_eval",
            name=f"D3QN-{config.model}",
            camera=config.camera,
            task=config.task,
            robot=config.robot,
            console=console,
        )
        for room in ROOMS
    }
    return {
        "training": _columns(run.metrics),
        "evaluations": _columns(run.evaluations),
        "final": {room: evaluation.to_dict() for room, evaluation in evaluations.items()},
        "q_over_headings": {
            place: q_over_headings(actor, config.camera, pose, config.eval_world).round(5).tolist()
            for place, pose in Q_PLACES.items()
        },
    }


def _columns(table: Table) -> dict[str, list[float | None]]:
    rows = table.rows()
    return {column: [_number(row[column]) for row in rows] for column in table.columns if column != "world"}


def _number(text: str) -> float | None:
    return float(text) if text else None


HEADINGS = np.linspace(-math.pi, math.pi, 73)
"""Goal directions of the Q-value figures, radians."""
Q_PLACES = {"free way": (0.3, 1.2, -math.pi / 2), "wall ahead": (2.4, 0.0, 0.0)}
"""Poses (x, y, yaw) of the Q-value figures, in either evaluation room: with 4.8 m of free view, and with 0.8 to 1.2."""


def q_over_headings(
    actor: QValueActor, camera: DepthCamera, pose: tuple[float, float, float], world: str
) -> np.ndarray:
    """Q-values ``(73, 7)`` of a robot that stands at ``pose`` (m, m, rad), for goals in the directions ``HEADINGS``."""
    image = camera.to_uint8(camera.from_planar(render_depth(load_world(world), np.array([pose]), camera)))
    stack = torch.from_numpy(image).unsqueeze(1).repeat(len(HEADINGS), NUM_FRAMES, 1, 1)
    angles = torch.from_numpy(HEADINGS.astype(np.float32)).unsqueeze(-1)
    with torch.no_grad():
        return actor(TensorDict({"depth": stack, "heading": angles}, [len(HEADINGS)]))["action_value"].numpy()


def write_up(results: Path) -> None:
    """Writes ``tables.md`` and the figures from the finished cells' JSON in ``results / "cells"``."""
    finished = [
        read_results(file, *Cell._fields, "final", "training") for file in sorted((results / "cells").glob("*.json"))
    ]
    if not finished:
        return
    with atomic_write(results / "tables.md") as file:
        file.write(tables(finished))
    for name, figure in figures(finished):
        save_figure(figure, results / f"{name}.png")


def tables(finished: Sequence[dict[str, Any]]) -> str:
    """Tables 6.1 to 6.4 in the thesis's form, as Markdown: one a model and image size, trained in by evaluated in."""
    parts = []
    combinations = [(model, size) for size in SIZES for model in MODELS]
    for number, (model, (width, height)) in enumerate(combinations, 1):
        mine = [cell for cell in finished if (cell["model"], cell["width"], cell["height"]) == (model, width, height)]
        parts.append(f"### Table 6.{number}: D3QN-{model}, {width}x{height}\n")
        if not mine:
            parts.append("Not run yet.\n")
            continue
        parts.append(f"{_how(mine)}.\n")
        parts.append(
            "| trained in | evaluated in | goals reached, % | each seed | 95% interval | thesis | reward | SPL |"
        )
        parts.append("|---|---|---|---|---|---|---|---|")
        for trained in ROOMS:
            for evaluated in ROOMS:
                results = [_evaluation(cell, evaluated) for cell in mine if cell["room"] == trained]
                if results:
                    parts.append(_row(model, trained, evaluated, results))
        parts.append("")
    return "\n".join(parts)


def _how(mine: Sequence[dict[str, Any]]) -> str:
    """What runs of one table have been, beside their settings: their lengths, number formats and times."""
    steps = " or ".join(sorted({f"{cell['steps']:,}" for cell in mine}))
    formats = " or ".join(sorted({cell["settings"]["autocast"] for cell in mine}))
    hours = [f"{cell['evaluations']['processor_seconds'][-1] / 3600:.1f}" for cell in mine]
    span = " to ".join(dict.fromkeys([min(hours, key=float), max(hours, key=float)]))
    machines = "; ".join(sorted({cell["machine"] for cell in mine}))
    return f"{steps} steps in {formats}, {span} hours of processor time; {machines}"


def _evaluation(cell: dict[str, Any], room: str) -> Evaluation:
    return Evaluation.from_dict(cell["final"][room])


def _row(model: str, trained: str, evaluated: str, results: Sequence[Evaluation]) -> str:
    pooled = dataclasses.replace(results[0], paths=tuple(path for result in results for path in result.paths))
    low, high = pooled.interval("success")
    thesis = REPORTED.get((model, evaluated)) if trained == evaluated else None
    return " | ".join(
        [
            f"| {trained}",
            evaluated,
            f"{100 * pooled.success_rate:.1f}",
            ", ".join(f"{100 * result.success_rate:.0f}" for result in results),
            f"{100 * low:.0f}–{100 * high:.0f}",
            "" if thesis is None else f"{100 * thesis:.0f}",
            f"{statistics.fmean(result.mean_reward for result in results):+.2f}",
            f"{statistics.fmean(result.spl for result in results):.2f} |",
        ]
    )


def figures(finished: Sequence[dict[str, Any]]) -> Iterable[tuple[str, Figure]]:
    """Figures 6.1 to 6.11 with their file names, of the cells with 80x64 images; those without data are left out."""
    small = [cell for cell in finished if (cell["width"], cell["height"]) == SIZES[0]]
    for number, (key, label) in enumerate((("reward", "reward of an episode"), ("max_q", "mean greatest Q-value"))):
        for offset, room in enumerate(ROOMS):
            mine = [cell for cell in small if cell["room"] == room]
            if mine:
                yield f"figure-6-{2 * number + offset + 1:02d}-{key}-{room}", _curves(mine, key, label, room)
    if small:
        yield "figure-6-05-goals-reached", _goals_reached(small)
        yield "figure-6-06-longer-training", _longer_training(small)
    for number, model in enumerate(MODELS, 7):
        mine = [cell for cell in small if cell["model"] == model and cell["room"] == "complex"]
        if mine:
            yield f"figure-6-{number:02d}-q-values-{model}", _q_values(_typical(mine))
    if small:
        yield "figure-6-09-actions", _actions(small)
    for number, model in enumerate(MODELS, 10):
        mine = [cell for cell in small if cell["model"] == model and cell["room"] == "complex"]
        if mine:
            typical, task = _typical(mine), PRESETS["thesis"].task
            examples = choose_examples(_evaluation(typical, "complex"))
            figure = example_paths(load_world("complex_eval"), examples, task)
            figure.suptitle(f"D3QN-{model}, seed {typical['seed']}", fontsize=11, color=INK)
            yield f"figure-6-{number:02d}-paths-{model}", figure


_CAPTIONS = {
    1: "rewards of episodes while training in the simple room: means of each 4,000 steps; thin: each seed",
    2: "rewards of episodes while training in the complex room: means of each 4,000 steps; thin: each seed",
    3: "greatest Q-values while training in the simple room: means over states of a random drive; thin: each seed",
    4: "greatest Q-values while training in the complex room: means over states of a random drive; thin: each seed",
    5: "goals reached in each evaluation room after training in the room of its kind: means, each seed (circles), and "
    "what the thesis reports (dashed)",
    6: "goals reached in the evaluation room of the kind trained in, by steps of training: each seed; dashed: simple",
    7: "Q-values of D3QN-I's seven actions by the direction of the goal: where 4.8 m are free ahead, and before a wall",
    8: "Q-values of D3QN-S's seven actions by the direction of the goal: where 4.8 m are free ahead, and before a wall",
    9: "share of each action among all steps in complex_eval, trained in the complex room: mean of all seeds",
    10: "example paths of D3QN-I in complex_eval",
    11: "example paths of D3QN-S in complex_eval",
}
_OF_ONE_SEED = (7, 8, 10, 11)


def caption(name: str) -> str:
    """What a figure shows, of its file name without the ending.

    >>> caption("figure-6-10-paths-I")[:45]
    'Figure 6.10: example paths of D3QN-I in compl'
    """
    number = int(name.split("-")[2])
    typical = (
        "; of those trained in the complex room, the seed with the median success" if number in _OF_ONE_SEED else ""
    )
    return f"Figure 6.{number}: {_CAPTIONS[number]}{typical}"


def _typical(mine: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The cell whose success is the median of them in the complex room; the lower one of two."""
    by_success = sorted(mine, key=lambda cell: (_evaluation(cell, "complex").success_rate, cell["seed"]))
    return by_success[(len(mine) - 1) // 2]


def _axes(title: str, x: str, y: str, width: float = 7.0) -> tuple[Figure, Axes]:
    figure = new_figure(width, 4.0)
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=11, color=INK, loc="left")
    axes.set_xlabel(x, fontsize=9, color=QUIET_INK)
    axes.set_ylabel(y, fontsize=9, color=QUIET_INK)
    axes.tick_params(labelsize=8, colors=QUIET_INK)
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _curves(mine: Sequence[dict[str, Any]], key: str, label: str, room: str) -> Figure:
    """A quantity of training by steps: each seed thin, their mean thick, by model."""
    figure, axes = _axes(f"{label}, training in {room}_train", "environment steps", label)
    for model in MODELS:
        runs = [cell["training"] for cell in mine if cell["model"] == model]
        if not runs:
            continue
        length = min(len(run["step"]) for run in runs)
        values = np.array([[np.nan if value is None else value for value in run[key][:length]] for run in runs])
        for line in values:
            axes.plot(runs[0]["step"][:length], line, color=_MODEL_COLOURS[model], lw=0.7, alpha=0.5)
        axes.plot(
            runs[0]["step"][:length],
            values.mean(axis=0),
            color=_MODEL_COLOURS[model],
            lw=2.0,
            label=f"D3QN-{model} ({len(runs)} seed{'s' if len(runs) > 1 else ''})",
        )
    axes.legend(fontsize=8, frameon=False, labelcolor=INK)
    return figure


def _goals_reached(small: Sequence[dict[str, Any]]) -> Figure:
    """Goals reached in each evaluation room, trained in the room of the same kind: mean, each seed, and the thesis."""
    figure, axes = _axes("goals reached after training", "", "% of the paths")
    for position, (room, model) in enumerate((room, model) for room in ROOMS for model in MODELS):
        rates = [
            100 * _evaluation(cell, room).success_rate
            for cell in small
            if (cell["room"], cell["model"]) == (room, model)
        ]
        if rates:
            axes.bar(position, statistics.fmean(rates), width=0.65, color=_MODEL_COLOURS[model], alpha=0.85)
            axes.plot([position] * len(rates), rates, "o", color=INK, ms=4, mfc="white")
        if (model, room) in REPORTED:
            reported = 100 * REPORTED[model, room]
            axes.plot([position - 0.4, position + 0.4], [reported] * 2, color=INK, lw=1.5, ls=(0, (3, 2)))
            axes.text(position + 0.42, reported, "thesis", fontsize=8, va="center", color=INK)
    labels = [f"D3QN-{model}\n{room}" for room in ROOMS for model in MODELS]
    axes.set_xticks(range(len(labels)), labels, fontsize=9, color=INK)
    axes.set_xlim(-0.6, len(labels) - 0.3)
    axes.set_ylim(0, 100)
    return figure


def _longer_training(small: Sequence[dict[str, Any]]) -> Figure:
    """Goals reached in the evaluation room by steps of training: what training longer brings."""
    figure, axes = _axes("goals reached by length of training", "environment steps", "% of the paths")
    for cell in small:
        rates = [100 * value for value in cell["evaluations"]["success_rate"]]
        style = "-" if cell["room"] == "complex" else (0, (3, 2))
        label = f"D3QN-{cell['model']}, {cell['room']}" if cell["seed"] == min(c["seed"] for c in small) else None
        axes.plot(
            cell["evaluations"]["step"],
            rates,
            ls=style,
            marker="o",
            ms=3,
            lw=1.2,
            color=_MODEL_COLOURS[cell["model"]],
            label=label,
        )
    axes.set_ylim(0, 100)
    axes.legend(fontsize=8, frameon=False, labelcolor=INK, ncols=2)
    return figure


def _q_values(cell: dict[str, Any]) -> Figure:
    """Q-values of the seven actions over the goal's direction, where the way is free and before a wall."""
    figure = new_figure(10.0, 4.0)
    all_axes = figure.subplots(1, len(Q_PLACES), sharey=True)
    for axes, place in zip(all_axes, Q_PLACES, strict=True):
        values = np.array(cell["q_over_headings"][place])
        for action, label in enumerate(ACTION_LABELS):
            axes.plot(np.degrees(HEADINGS), values[:, action], color=_ACTION_COLOURS[action], lw=1.4, label=label)
        axes.set_title(f"D3QN-{cell['model']}, seed {cell['seed']}: {place}", fontsize=10, color=INK, loc="left")
        axes.set_xlabel("direction of the goal, degrees (left positive)", fontsize=9, color=QUIET_INK)
        axes.set_xticks(range(-180, 181, 90))
        axes.tick_params(labelsize=8, colors=QUIET_INK)
        axes.spines[["top", "right"]].set_visible(False)
    all_axes[0].set_ylabel("Q", fontsize=9, color=QUIET_INK)
    all_axes[-1].legend(fontsize=8, frameon=False, labelcolor=INK)
    return figure


def _actions(small: Sequence[dict[str, Any]]) -> Figure:
    """Share of each action in the complex evaluation room, by model, over all seeds trained in the complex room."""
    figure, axes = _axes("actions taken in complex_eval", "", "% of the steps")
    for offset, model in zip((-0.2, 0.2), MODELS, strict=True):
        shares = [
            _evaluation(cell, "complex").action_distribution
            for cell in small
            if (cell["model"], cell["room"]) == (model, "complex")
        ]
        if shares:
            positions = np.arange(len(ACTION_LABELS)) + offset
            heights = 100 * np.mean(shares, axis=0)
            axes.bar(positions, heights, width=0.38, color=_MODEL_COLOURS[model], label=f"D3QN-{model}")
    axes.set_xticks(range(len(ACTION_LABELS)), ACTION_LABELS, fontsize=9, color=INK)
    axes.legend(fontsize=8, frameon=False, labelcolor=INK)
    return figure
