"""What each part of learning is worth: runs that differ from one another in one thing, side by side.

A *row* is the base, or the base with some settings changed. Each row is trained with several seeds; the last weights,
which nobody has chosen, then drive the paths of ``complex_eval`` and of generated rooms that no run has trained in.
Finished runs are skipped, and interrupted ones go on, so that rows can be added one evening at a time.
"""

from __future__ import annotations

import dataclasses
import os
import shlex
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from torchrl.modules import QValueActor

from navsim.draw import INK, QUIET_INK, new_figure, save_figure
from navsim.files import atomic_write
from navsim.task import Task
from rl.config import DEFAULT_PRESET, PRESETS, TrainConfig
from rl.evaluation import evaluate_as_trained
from rl.metrics import Evaluation
from rl.policies import load_policy
from rl.run import Run
from rl.series import Planned, read_results, run_series

DENSITY = 0.11
"""Share of the floor under obstacles in generated rooms, as in ``complex_eval``."""
UNSEEN_ROOMS = f"generate:clutter,density={DENSITY},count=200"
"""Rooms that no run trains in, whose seeds lie elsewhere (``navsim.worldsource.TRAINING_SEED``)."""
UNSEEN_PATHS = 1000
COMPLEX, UNSEEN = "complex_eval", "unseen rooms"
PLACES: dict[str, tuple[str, int | None]] = {COMPLEX: ("complex_eval", None), UNSEEN: (UNSEEN_ROOMS, UNSEEN_PATHS)}
"""Where final weights are measured: the world, and how many of its paths; None: all."""
EQUAL_MINUTES = 20
"""Of processor time, at which runs that cost more or less a step are compared, too."""


_INTRODUCTION = f"""# Ablations

What each part of learning is worth: runs that differ from preset `memoryless` with D3QN-I, or from the preset that
they name, in what is named. Success and SPL are those of the
last weights, greedy: in `complex_eval` (100 paths), and in 200 generated rooms of the same density that no run has
trained in ({UNSEEN_PATHS:,} paths); the mean over the seeds, and each seed. Success at {EQUAL_MINUTES} minutes is that
of the last evaluation in `complex_eval` within {EQUAL_MINUTES} minutes of processor time: the last of all, if the run
had ended; else its learning rate had not come down yet. Evaluations on the way differ from those of the last weights by
chance: they draw other yaws; of symmetric policies some are of the network alone (measurements.md). Minutes compare
within one machine and number format only, which stand with the commands; where a row has several, the least and the
most are given; the curves' minutes are of the runs on the one machine that most of a row's were made on. Rows of three
seeds or more have colours there. `scripts/ablations.py` trains, evaluates and writes this page, and the JSON behind it
in [{{results}}]({{results}}).
"""


def _rooms(count: int = 400, densities: Sequence[float] = (DENSITY,)) -> dict[str, Any]:
    each = count // len(densities)
    world = tuple(f"generate:clutter,density={density},count={each}" for density in densities)
    return {"world": world, "rearrangements": 100}  # of which generated rooms have none


BASE: dict[str, Any] = {"num_threads": 1, "report": False}
"""What all rows share, in place of their presets' settings."""

_TWICE_AS_LONG = {"total_steps": 200_000, "eval_interval": 25_000}
_THRICE_AS_LONG = {"total_steps": 300_000, "eval_interval": 25_000}  # of preset fast
_PLAIN_LENGTH = {**_TWICE_AS_LONG, "steps_per_update": 8.0, "epsilon_steps": 25_000}
_SEEDS_TO_BE_NAMED = 3
"""That a row needs to have a colour of its own among the curves."""
_STYLES = [(dashes, colour) for dashes in ("-", "--", ":") for colour in map(matplotlib.colormaps["tab10"], range(10))]
"""Lines that are told apart."""
_BOTH_MODELS: tuple[tuple[str, str, dict[str, Any]], ...] = (("", "", {}), ("S-", "D3QN-S, ", {"model": "S"}))
"""What stands before a row's name, what before its description, and settings."""
_ALONE: dict[str, Any] = {"symmetric": False}
_PLAIN_RETURNS: dict[str, Any] = {"n_step": 5, "epsilon_end": 0.3}
_PLAIN_ROOMS: dict[str, Any] = {"margin": 0.0, **_rooms()}
_DENSER_ROOMS: dict[str, Any] = {"margin": 0.0, **_rooms(densities=[0.17])}
_PLAIN_WORLD = "no margin, in 400 generated rooms"
_PLAIN: dict[str, Any] = {**_ALONE, **_PLAIN_LENGTH, **_PLAIN_RETURNS, **_PLAIN_ROOMS}
"""What preset ``memoryless`` was before it learnt with a margin, longer returns, other rooms and more of them, and
before its policies were symmetric."""
_PLAIN_LEARNING = "the network alone, five-step returns, random actions down to 0.3"
_PLAINLY = f"{_PLAIN_LEARNING}, 200,000 steps, an update every 8, {_PLAIN_WORLD}"
_MIXED = _rooms(densities=[DENSITY, 0.17])
_LONGER_MIXED = f"{_PLAIN_LEARNING}, no margin, in generated rooms alone"


class Row(NamedTuple):
    """One way to train."""

    what: str
    """Is different, in a few words."""
    changes: dict[str, Any]
    """Settings in place of the preset's."""
    preset: str = "memoryless"
    """What they are changes of."""

    def config(self, name: str, seed: int, directory: Path, total_steps: int | None = None) -> TrainConfig:
        """The settings of a run."""
        settings = {**BASE, **self.changes, "seed": seed, "out": directory / f"{name}-seed{seed}"}
        if total_steps is not None:
            settings["total_steps"] = total_steps
        return dataclasses.replace(PRESETS[self.preset], **settings)


ROWS: dict[str, Row] = {
    "base": Row("preset memoryless, D3QN-I", {}),
    "S": Row("D3QN-S", {"model": "S"}),
    "fast": Row("preset fast: sees depth inverted, its command, and what it remembers around it", {}, "fast"),
    "S-fast": Row("preset fast, D3QN-S", {"model": "S"}, "fast"),
    "fast-longer": Row("preset fast, 200,000 steps", _TWICE_AS_LONG, "fast"),
    "S-fast-longer": Row("preset fast, D3QN-S, 200,000 steps", {"model": "S", **_TWICE_AS_LONG}, "fast"),
    "fast-linear": Row("preset fast, sees depth as it is", {"depth_scale": "linear"}, "fast"),
    "fast-no-memory": Row("preset fast without the memory", {"inputs": ("depth", "heading", "command")}, "fast"),
    "fast-no-memory-centred": Row(
        "preset fast without the memory, what conv1 sees centred on zero",
        {"inputs": ("depth", "heading", "command"), "centred": True},
        "fast",
    ),
    "fast-no-command": Row("preset fast without its command", {"inputs": ("depth", "heading", "surroundings")}, "fast"),
    "fast-12-steps": Row(
        "preset fast, twelve-step returns, fewer random actions", {"n_step": 12, "epsilon_end": 0.1}, "fast"
    ),
    "fast-no-margin": Row("preset fast, with the rules of evaluations", {"margin": 0.0}, "fast"),
    "fast-plain": Row(f"preset fast, {_PLAIN_WORLD}", _PLAIN_ROOMS, "fast"),
    "S-fast-plain": Row(f"preset fast, D3QN-S, {_PLAIN_WORLD}", {"model": "S", **_PLAIN_ROOMS}, "fast"),
    "fast-plain-denser": Row(f"preset fast, {_PLAIN_WORLD}, which have density 0.17", _DENSER_ROOMS, "fast"),
    "S-fast-plain-denser": Row(
        f"preset fast, D3QN-S, {_PLAIN_WORLD}, which have density 0.17", {"model": "S", **_DENSER_ROOMS}, "fast"
    ),
    **{
        f"{prefix}fast-plain-length-{penalty:g}": Row(
            f"preset fast, {model}{_PLAIN_WORLD}, where a metre costs {penalty:g}",
            {**settings, **_PLAIN_ROOMS, "task": Task(length_penalty=penalty)},
            "fast",
        )
        for prefix, model, settings in _BOTH_MODELS
        for penalty in (0.3, 0.6)
    },
    **{
        f"{prefix}fast-plain-length-0.3-longer": Row(
            f"preset fast, {model}{_PLAIN_WORLD}, where a metre costs 0.3, 300,000 steps",
            {**settings, **_THRICE_AS_LONG, **_PLAIN_ROOMS, "task": Task(length_penalty=0.3)},
            "fast",
        )
        for prefix, model, settings in _BOTH_MODELS
    },
    "S-fast-plain-glorot": Row(
        f"preset fast, D3QN-S, {_PLAIN_WORLD}, weights for the heading begin as all others",
        {"model": "S", "heading_init": "glorot", **_PLAIN_ROOMS},
        "fast",
    ),
    "S-glorot": Row("D3QN-S, weights for the heading begin as all others", {"model": "S", "heading_init": "glorot"}),
    "centred": Row("what conv1 sees centred on zero", {"centred": True}),
    "S-centred": Row("D3QN-S, what conv1 sees centred on zero", {"model": "S", "centred": True}),
    "fast-centred": Row("preset fast, what conv1 sees centred on zero", {"centred": True}, "fast"),
    "inverse": Row("sees depth inverted", {"depth_scale": "inverse"}),
    "S-inverse": Row("D3QN-S, sees depth inverted", {"model": "S", "depth_scale": "inverse"}),
    "command": Row("sees its command (v, ω), too", {"inputs": ("depth", "heading", "command")}),
    "apart": Row("images three steps apart", {"frame_interval": 3}),
    "command-apart": Row(
        "sees its command, and images three steps apart",
        {"inputs": ("depth", "heading", "command"), "frame_interval": 3},
    ),
    "depth-only": Row("sees no heading", {"inputs": ("depth",)}),
    "blind": Row("sees no images", {"inputs": ("heading",)}),
    "no-margin": Row("with the rules of evaluations", {"margin": 0.0}),
    "margin-0.06": Row("0.06 m stricter, not 0.1", {"margin": 0.06}),
    "S-margin-0.06": Row(
        "D3QN-S, the network alone, 0.06 m stricter, not 0.1", {"model": "S", "margin": 0.06, **_ALONE}
    ),
    "alone": Row("the network alone, no symmetric policy", _ALONE),
    "S-alone": Row("D3QN-S, the network alone, no symmetric policy", {"model": "S", **_ALONE}),
    "generated-rooms": Row("in generated rooms alone", _MIXED),
    "one-room": Row("in one room, complex_train", {"world": ("complex_train",), "rearrangements": 0}),
    "rearranged": Row("in complex_train and 200 rearrangements of it", {"world": ("complex_train",)}),
    "rooms-50": Row("in 50 generated rooms", _rooms(50, [DENSITY, 0.17])),
    "rooms-2000": Row("in 2,000 generated rooms", _rooms(2000, [DENSITY, 0.17])),
    "squared-error": Row("mean squared error instead of a categorical loss", {"loss_function": "l2"}),
    "huber": Row("Huber's loss instead of a categorical one", {"loss_function": "smooth_l1"}),
    "n-step-1": Row("one-step returns", {"n_step": 1}),
    "n-step-5": Row("five-step returns, more random actions", _PLAIN_RETURNS),
    "n-step-20": Row("twenty-step returns", {"n_step": 20}),
    "not-mirrored": Row("no mirrored samples", {"mirror": False}),
    "same-epsilon": Row(
        "the same share of random actions for all robots", {"epsilon_least": None, "epsilon_end": 0.05}
    ),
    "constant-rate": Row("a learning rate that does not fall", {"learning_rate_decay": "none"}),
    "prioritized": Row("prioritised replay", {"prioritized": True}),
    "gamma-0.95": Row("a discount of 0.95", {"gamma": 0.95, "greatest_return": 1.8}),
    "gamma-0.99": Row("a discount of 0.99", {"gamma": 0.99, "greatest_return": 5.0}),
    "twice-the-samples": Row("an update every 8 steps", {"steps_per_update": 8.0}),
    "half-the-samples": Row("an update every 32 steps", {"steps_per_update": 32.0}),
    "half-as-long": Row("200,000 steps", _TWICE_AS_LONG),
    "twice-the-steps": Row(
        "800,000 steps, an update every 32",
        {"total_steps": 800_000, "steps_per_update": 32.0, "epsilon_steps": 100_000, "eval_interval": 100_000},
    ),
    "batch-128": Row("batches of 128, an update every 32 steps", {"batch_size": 128, "steps_per_update": 32.0}),
    "64-robots": Row("64 robots", {"num_envs": 64}),
    "plain": Row(_PLAINLY, _PLAIN),
    "S-plain": Row(f"D3QN-S, {_PLAINLY}", {"model": "S", **_PLAIN}),
    "S-plain-denser": Row(f"D3QN-S, {_PLAINLY}, which have density 0.17", {"model": "S", **_PLAIN, **_DENSER_ROOMS}),
    "plain-inverse-12-steps": Row(
        f"sees depth inverted; {_PLAINLY}, but twelve-step returns",
        {"depth_scale": "inverse", **_ALONE, **_PLAIN_LENGTH, **_PLAIN_ROOMS},
    ),
    "plain-command-apart": Row(
        f"sees its command, and images three steps apart; {_PLAINLY}",
        {"inputs": ("depth", "heading", "command"), "frame_interval": 3, **_PLAIN},
    ),
    "plain-longer-mixed": Row(_LONGER_MIXED, {"margin": 0.0, **_ALONE, **_PLAIN_RETURNS, **_MIXED}),
    "S-plain-longer-mixed": Row(
        f"D3QN-S, {_LONGER_MIXED}", {"model": "S", "margin": 0.0, **_ALONE, **_PLAIN_RETURNS, **_MIXED}
    ),
    "plain-longer-mixed-margin": Row(
        f"{_LONGER_MIXED}, but 0.06 m stricter", {"margin": 0.06, **_ALONE, **_PLAIN_RETURNS, **_MIXED}
    ),
}
"""The base first; then what the robot sees, where it learns, and how."""


def run(
    names: Iterable[str],
    seeds: Sequence[int],
    *,
    runs: Path,
    results: Path,
    page: Path,
    total_steps: int | None = None,
    console: Console | None = None,
) -> None:
    """Trains and evaluates what is not finished yet, and writes the page after each run.

    Args:
        names: of rows, in the order in which they are run; the first seed of all before the second of any.
        seeds: of each row's runs.
        runs: where the runs lie; large, needed only to go on with them.
        results: where the JSON of each run and the figure go.
        page: Markdown file with the table.
        total_steps: transitions of each run in place of the preset's, to try it out.
        console: where progress is shown; standard output by default.

    Raises:
        ValueError: for a row that there is not, and for results of another length that lie where a run's are to go.
        SeriesError: at the end, if runs could not be finished.
    """
    console = console or Console()
    names = list(names)
    for name in names:
        if name not in ROWS:
            raise ValueError(f"there is no row {name}; there are: {', '.join(ROWS)}")
    planned = [
        Planned(
            name=f"{name}-seed{seed}",
            what=ROWS[name].what,
            labels={"row": name, "seed": seed},
            config=ROWS[name].config(name, seed, runs, total_steps),
            results=results / f"{name}-seed{seed}.json",
        )
        for seed in seeds
        for name in names
    ]
    run_series(planned, lambda trained: _results_of(trained, console), lambda: write_page(results, page), console)


def _results_of(trained: Run, console: Console) -> dict[str, Any]:
    """A finished run's curves, and what its last weights do in rooms that it has not seen."""
    config, rows = trained.config, trained.evaluations.rows()
    alone, symmetric = (
        rates_in_places(load_policy(trained.directory, weights="last", symmetric=wanted), config, console)
        for wanted in (False, True)
    )
    return {
        "command": f"navsim train {shlex.join(arguments_of(config))}",
        "curve": {
            key: [float(row[key]) for row in rows]
            for key in ("step", "seconds", "processor_seconds", "success_rate", "spl")
        },
        "final": symmetric if config.symmetric else alone,
        "alone": alone,
        "symmetric": symmetric,
    }


def rates_in_places(policy: QValueActor, config: TrainConfig, console: Console) -> dict[str, dict[str, float]]:
    """What a policy reaches in each of ``PLACES``, of a run with these settings."""
    return {
        place: rates_of(evaluate_as_trained(policy, config, world, num_paths=paths, console=console))
        for place, (world, paths) in PLACES.items()
    }


def rates_of(evaluation: Evaluation) -> dict[str, float]:
    return {
        "paths": len(evaluation.paths),
        "success_rate": evaluation.success_rate,
        "collision_rate": evaluation.collision_rate,
        "timeout_rate": evaluation.timeout_rate,
        "spl": evaluation.spl,
        "reward": evaluation.mean_reward,
    }


def arguments_of(config: TrainConfig) -> list[str]:
    """What ``navsim train`` is told for these settings, beside its directory.

    >>> arguments_of(TrainConfig(model="S", mirror=False, epsilon_least=None))
    ['--preset', 'memoryless', '--model', 'S', '--epsilon-least', 'None', '--no-mirror']
    >>> arguments_of(dataclasses.replace(PRESETS["fast"], n_step=3))
    ['--n-step', '3']
    """
    told = [] if config.preset == DEFAULT_PRESET else ["--preset", config.preset]
    for setting in dataclasses.fields(config):
        value, default = getattr(config, setting.name), getattr(PRESETS[config.preset], setting.name)
        flag = setting.name.replace("_", "-")
        if value == default or setting.name == "out":
            continue
        if dataclasses.is_dataclass(value):
            for part in dataclasses.fields(value):
                if getattr(value, part.name) != getattr(default, part.name):
                    told += _option(f"{flag}.{part.name.replace('_', '-')}", getattr(value, part.name))
        else:
            told += _option(flag, value)
    return told


def _option(flag: str, value: Any) -> list[str]:
    if isinstance(value, bool):
        group, _, name = flag.rpartition(".")
        return [f"--{flag}" if value else f"--{group}{'.' if group else ''}no-{name}"]
    return [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]


def write_page(results: Path, page: Path) -> None:
    """Writes the table, as Markdown, and the figure of all runs that are finished."""
    found = [read_results(file, "row", "seed", "final", "curve") for file in sorted(results.glob("*-seed*.json"))]
    finished = [one for one in found if one["row"] in ROWS]  # results may be of rows that there are no more
    if not finished:
        return
    picture = results / "curves.png"
    save_figure(curves(finished), picture)
    with atomic_write(page) as file:
        file.write(_page(finished, Path(os.path.relpath(picture, page.parent))))


def _by_row(finished: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Runs by their rows, in the order of ``ROWS``, each row's by their seeds."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in ROWS}
    for one in sorted(finished, key=lambda one: one["seed"]):
        rows[one["row"]].append(one)
    return {name: runs for name, runs in rows.items() if runs}


def _page(finished: Sequence[dict[str, Any]], picture: Path) -> str:
    rows = _by_row(finished)
    lines = [
        _INTRODUCTION.format(results=picture.parent),
        "| | trained with | steps | `complex_eval`, % | each seed | SPL | unseen rooms, % | each seed | SPL |"
        f" at {EQUAL_MINUTES} min, % | processor min |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, runs in rows.items():
        cells = [name, ROWS[name].what, ", ".join(sorted({f"{one['steps']:,}" for one in runs}))]
        for place in (COMPLEX, UNSEEN):
            rates = [100 * one["final"][place]["success_rate"] for one in runs]
            digits = 0 if place == COMPLEX else 1
            cells += [
                f"{statistics.fmean(rates):.1f}",
                ", ".join(f"{rate:.{digits}f}" for rate in rates),
                f"{statistics.fmean(one['final'][place]['spl'] for one in runs):.2f}",
            ]
        early = [rate for one in runs if (rate := _success_at(one, 60.0 * EQUAL_MINUTES)) is not None]
        cells.append(f"{100 * statistics.fmean(early):.0f}" if early else "–")
        cells.append(_minutes(runs))
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", *_symmetric_table(rows)]
    lines += [f"![success by samples and by minutes of processor time]({picture})", "", "## Commands", ""]
    for name, runs in rows.items():
        told = sorted({f"{one['machine']}, torch {one['versions']['torch']}, {_number_format(one)}" for one in runs})
        lines.append(f"- {name}: `{_command(runs)}` ({'; '.join(told)})")
    lines += ["", "One thread each, beside other programs."]
    return "\n".join(lines) + "\n"


def _minutes(runs: Sequence[dict[str, Any]]) -> str:
    """Of processor time; a mean only of what compares."""
    minutes = [one["curve"]["processor_seconds"][-1] / 60 for one in runs]
    if len({(one["machine"], _number_format(one)) for one in runs}) == 1:
        return f"{statistics.fmean(minutes):.0f}"
    return f"{min(minutes):.0f}–{max(minutes):.0f}"


def _command(runs: Sequence[dict[str, Any]]) -> str:
    """Of the first run, without a number format that the others do not share."""
    formats, command = {_number_format(one) for one in runs}, runs[0]["command"]
    return command if len(formats) == 1 else command.replace(f" --autocast {_number_format(runs[0])}", "")


def _symmetric_table(rows: dict[str, list[dict[str, Any]]]) -> list[str]:
    """What the same weights do as symmetric policies, of the runs of which that is known."""
    lines = []
    for name, all_runs in rows.items():
        runs = [one for one in all_runs if "symmetric" in one]
        if not runs:
            continue
        cells = [name, str(len(runs))]
        for place, digits in ((COMPLEX, 0), (UNSEEN, 1)):
            alone, mean = ([100 * one[kind][place]["success_rate"] for one in runs] for kind in ("alone", "symmetric"))
            pairs = ", ".join(f"{a:.{digits}f} → {b:.{digits}f}" for a, b in zip(alone, mean, strict=True))
            cells += [f"{statistics.fmean(alone):.1f} → {statistics.fmean(mean):.1f}", pairs]
        lines.append(f"| {' | '.join(cells)} |")
    if not lines:
        return []
    return [
        "The same weights alone → as symmetric policies, which go by the mean of the network's values for what it sees",
        "and for the mirror image of that (`navsim evaluate RUN --weights last --symmetric yes`, or `no`):",
        "",
        "| | seeds | `complex_eval`, % | each seed | unseen rooms, % | each seed |",
        "|---|---|---|---|---|---|",
        *lines,
        "",
    ]


def _number_format(one: dict[str, Any]) -> str:
    """What the run's networks multiplied in, of its command: "auto" has been decided there."""
    command = shlex.split(one["command"])
    return command[command.index("--autocast") + 1] if "--autocast" in command else "auto"


def _success_at(one: dict[str, Any], seconds: float) -> float | None:
    """Success at a run's last evaluation within so much processor time; None before the first."""
    curve = one["curve"]
    within = [rate for rate, at in zip(curve["success_rate"], curve["processor_seconds"], strict=True) if at <= seconds]
    return within[-1] if within else None


def curves(finished: Sequence[dict[str, Any]]) -> Figure:
    """Success in ``complex_eval`` by samples and by processor time: the mean of each row that has enough seeds.

    Rows of fewer seeds are in grey. Minutes are of the runs on that machine, in that number format, which has most.
    """
    figure = new_figure(11.0, 5.6)
    by_steps, by_minutes = figure.subplots(1, 2, sharey=True)
    rows = _by_row(finished)
    named = [name for name, runs in rows.items() if len(runs) >= _SEEDS_TO_BE_NAMED and name != "base"]
    styles: dict[str, dict[str, Any]] = {
        name: {"color": colour, "ls": dashes} for name, (dashes, colour) in zip(named, _STYLES, strict=False)
    }
    styles["base"] = {"color": INK, "lw": 2.2, "zorder": 3}
    for name, runs in rows.items():
        style = {"lw": 1.3, **styles[name]} if name in styles else {"color": "#c9ced4", "lw": 0.8, "zorder": 1}
        label = f"{name} ({len(runs)})" if name in styles else None
        for axes, drawn, key, unit in (
            (by_steps, runs, "step", 1.0),
            (by_minutes, _comparable(runs), "processor_seconds", 60.0),
        ):
            length = min(len(one["curve"]["step"]) for one in drawn)
            success = 100 * np.mean([one["curve"]["success_rate"][:length] for one in drawn], axis=0)
            at = np.mean([one["curve"][key][:length] for one in drawn], axis=0) / unit
            axes.plot(at, success, marker="o", ms=2.5 if name in styles else 1.5, label=label, **style)
    by_minutes.plot([], [], color="#c9ced4", lw=0.8, label="rows of fewer seeds")
    for axes, label in ((by_steps, "environment steps"), (by_minutes, "minutes of processor time")):
        axes.set_xlabel(label, fontsize=9, color=QUIET_INK)
        axes.tick_params(labelsize=8, colors=QUIET_INK)
        axes.grid(axis="y", color="#e4e7eb", lw=0.7)
        axes.spines[["top", "right"]].set_visible(False)
    by_steps.set_ylim(0, 100)
    by_steps.set_ylabel("goals reached in complex_eval, %", fontsize=9, color=QUIET_INK)
    by_minutes.legend(
        fontsize=8, frameon=False, labelcolor=INK, loc="center left", bbox_to_anchor=(1.0, 0.5), title="row (seeds)"
    )
    return figure


def _comparable(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those on the machine, in the number format, that most were made with; the quicker ones of as many."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for one in runs:
        groups.setdefault((one["machine"], _number_format(one)), []).append(one)
    return max(
        groups.values(), key=lambda group: (len(group), -min(one["curve"]["processor_seconds"][-1] for one in group))
    )
