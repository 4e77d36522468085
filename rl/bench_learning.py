"""Whether what makes training fast costs learning: runs of equal length with each collector and number format."""

from __future__ import annotations

import dataclasses
import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from rich.console import Console
from rich.table import Table

from rl.config import DEFAULT_PRESET, PRESETS, TrainConfig
from rl.loss import fastest_autocast
from rl.run import Run, processor, versions, write_json

Collector = Literal["sync", "async"]
Format = Literal["float32", "bfloat16"]


class Setting(NamedTuple):
    """One cell of the matrix."""

    collector: Collector
    number_format: Format


def matrix(formats: Sequence[Format] | None = None) -> list[Setting]:
    """Both collectors with each format; by default bfloat16 only where the processor multiplies faster in it."""
    chosen: Sequence[Format] = formats or (("float32", "bfloat16") if fastest_autocast() is not None else ("float32",))
    collectors: tuple[Collector, ...] = ("sync", "async")
    return [Setting(collector, number_format) for number_format in chosen for collector in collectors]


def run(
    console: Console,
    *,
    out: Path,
    runs: Path,
    seeds: Sequence[int] = (0, 1, 2),
    steps: int = 100_000,
    formats: Sequence[Format] | None = None,
    **settings: Any,
) -> dict[str, Any]:
    """Trains every setting with every seed, seed by seed, and prints their successes side by side.

    It survives interruptions: finished runs are not repeated, and one that was under way goes on from its checkpoint.

    Args:
        console: where to.
        out: JSON file that is written after each run.
        runs: directory of the runs' directories.
        seeds: of the runs.
        steps: transitions in each.
        formats: see ``matrix``.
        settings: of ``TrainConfig``, in place of the default preset's.

    Returns:
        what the file holds: ``machine``, ``steps`` and ``runs``, each with its setting, seed, successes and seconds.
    """
    chosen = matrix(formats)
    finished = []
    for seed in seeds:
        for setting in chosen:
            name = f"{setting.collector}-{setting.number_format}-seed{seed}"
            console.print(f"{name}, {steps:,} steps")
            config = dataclasses.replace(
                PRESETS[DEFAULT_PRESET],
                **{
                    "collector": setting.collector,
                    "autocast": setting.number_format,
                    "seed": seed,
                    "total_steps": steps,
                    "eval_interval": max(1, steps // 4),
                    "checkpoint_interval": max(1, steps // 4),
                    "report": False,
                    "out": runs / name,
                    **settings,
                },
            )
            finished.append({**setting._asdict(), "seed": seed, **_result(config, console)})
            write_json(out, {"machine": versions(), "steps": steps, "runs": finished})
    console.print(_table(finished, steps))
    return json.loads(out.read_text(encoding="utf-8"))


def _result(config: TrainConfig, console: Console) -> dict[str, Any]:
    from rl.train import train

    run = Run(config.directory)
    if not (run.exists and run.has_ended):
        run = train(config, resume=run.exists, console=console)
    rows = run.evaluations.rows()
    return {
        "steps": [int(row["step"]) for row in rows],
        "success": [float(row["success_rate"]) for row in rows],
        "spl": [float(row["spl"]) for row in rows],
        "seconds": float(rows[-1]["seconds"]),
    }


def _table(finished: Sequence[dict[str, Any]], steps: int) -> Table:
    table = Table(title=f"goals reached after {steps:,} steps, {processor()}", title_justify="left")
    for heading in ("collector", "format", "each seed, %", "mean", "best evaluation, mean", "seconds, median"):
        table.add_column(heading, justify="left" if heading in ("collector", "format") else "right")
    for setting in dict.fromkeys((row["collector"], row["number_format"]) for row in finished):
        rows = [row for row in finished if (row["collector"], row["number_format"]) == setting]
        last = [100 * row["success"][-1] for row in rows]
        table.add_row(
            *setting,
            " ".join(f"{value:.0f}" for value in last),
            f"{statistics.mean(last):.0f}",
            f"{statistics.mean(100 * max(row['success']) for row in rows):.0f}",
            f"{statistics.median(row['seconds'] for row in rows):,.0f}",
        )
    return table
