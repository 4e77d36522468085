"""Whether what makes training fast costs learning: runs of equal length with each collector and number format."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from rich.console import Console
from rich.table import Table

from rl.ablations import COMPLEX, UNSEEN, rates_in_places
from rl.config import DEFAULT_PRESET, PRESETS, ConfigError
from rl.loss import fastest_autocast
from rl.number_format import FORMATS, NumberFormat
from rl.policies import load_policy
from rl.run import Run
from rl.series import Planned, SeriesError, read_results, run_series
from rl.subnormals import subnormals_are_zero

Collector = Literal["sync", "async"]


class Setting(NamedTuple):
    """One cell of the matrix."""

    collector: Collector
    number_format: NumberFormat


def matrix(
    collectors: Sequence[Collector] = get_args(Collector), formats: Sequence[NumberFormat] | None = None
) -> list[Setting]:
    """The collectors with each format; by default bfloat16 only where the processor multiplies faster in it."""
    with subnormals_are_zero():  # which PyTorch's threads keep to if they begin so
        chosen = formats or (FORMATS if fastest_autocast() is not None else FORMATS[:1])
    return [Setting(collector, number_format) for number_format in chosen for collector in collectors]


def run(
    console: Console,
    *,
    results: Path,
    runs: Path,
    seeds: Sequence[int] = (0, 1, 2),
    steps: int = 100_000,
    collectors: Sequence[Collector] = get_args(Collector),
    formats: Sequence[NumberFormat] | None = None,
    **settings: Any,
) -> list[dict[str, Any]]:
    """Trains every setting with every seed, seed by seed, and prints side by side what their last weights reach.

    It survives interruptions: finished runs are not repeated, and one that was under way goes on from its checkpoint.

    Args:
        console: where to.
        results: directory of a JSON file for each run.
        runs: directory of the runs' directories; large, needed only to go on with them.
        seeds: of the runs.
        steps: transitions in each.
        collectors: see ``matrix``.
        formats: see ``matrix``.
        settings: of ``TrainConfig``, in place of the default preset's.

    Returns:
        what the files hold: setting, seed, the successes in training and of the last weights, minutes, machine.

    Raises:
        ValueError: for settings that cannot be used, and for results of another length where a run's are to go.
        SeriesError: at the end, if runs could not be finished.
    """
    planned = []
    for seed in dict.fromkeys(seeds):
        for setting in matrix(collectors, formats):
            name = f"{setting.collector}-{setting.number_format}-seed{seed}"
            changes = {
                "collector": setting.collector,
                "autocast": setting.number_format,
                "seed": seed,
                "total_steps": steps,
                "eval_interval": max(1, steps // 4),
                "checkpoint_interval": max(1, steps // 4),
                "report": False,
                "out": runs / name,
                **settings,
            }
            try:
                config = dataclasses.replace(PRESETS[DEFAULT_PRESET], **changes)
            except ConfigError as error:
                raise ValueError(str(error).replace("--total-steps", "--steps")) from error  # as it is called here
            planned.append(
                Planned(
                    name=name,
                    what=f"{setting.collector} collector, {setting.number_format}, {steps:,} steps",
                    labels={**setting._asdict(), "seed": seed},
                    config=config,
                    results=results / f"{name}.json",
                )
            )

    def show() -> list[dict[str, Any]]:
        finished = [read_results(one.results, "final", "curve") for one in planned if one.results.exists()]
        if finished:
            console.print(_table(finished, steps))
        return finished

    try:
        run_series(planned, lambda trained: _results_of(trained, console), lambda: None, console)
    except (KeyboardInterrupt, SeriesError):
        show()
        raise
    return show()


def _results_of(trained: Run, console: Console) -> dict[str, Any]:
    rows, policy = trained.evaluations.rows(), load_policy(trained.directory, weights="last")
    return {
        "curve": {key: [float(row[key]) for row in rows] for key in ("step", "seconds", "success_rate", "spl")},
        "final": rates_in_places(policy, trained.config, console),
    }


def _table(finished: Sequence[dict[str, Any]], steps: int) -> Table:
    table = Table(title=f"goals reached after {steps:,} steps, by the last weights, %", title_justify="left")
    for heading in ("collector", "format"):
        table.add_column(heading)
    for place in (COMPLEX, UNSEEN):
        table.add_column(f"{place}, each seed", justify="right")
        table.add_column("mean", justify="right")
    table.add_column("minutes, median", justify="right")
    for setting in dict.fromkeys((one["collector"], one["number_format"]) for one in finished):
        of_setting = [one for one in finished if (one["collector"], one["number_format"]) == setting]
        cells = []
        for place in (COMPLEX, UNSEEN):
            rates = [100 * one["final"][place]["success_rate"] for one in of_setting]
            digits = 0 if place == COMPLEX else 1
            cells += [" ".join(f"{rate:.{digits}f}" for rate in rates), f"{statistics.fmean(rates):.1f}"]
        minutes = statistics.median(one["curve"]["seconds"][-1] for one in of_setting) / 60
        table.add_row(*setting, *cells, f"{minutes:.1f}")
    return table
