"""Where the time of a whole training goes, and how much memory it takes, with collectors of both kinds."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

from navsim.processes import map_in_processes
from rl.config import PRESETS, TrainConfig
from rl.run import differing_settings, processor, settings_of, versions, write_json

THESIS_STEPS = 400_000
Kind = Literal["sync", "async"]
_SAMPLE_SECONDS = 1.0
_SPEED_DEPENDS_ON = {
    "processor": "on another machine",
    **{name: f"with another {name}" for name in ("torch", "torchrl", "tensordict", "numpy")},
}
_MEASURED = ("seconds", "steady_steps_per_second", "thesis_seconds", "peak_megabytes")
PARTS = ("collect", "wait", "replay", "update", "target network", "hand over", "evaluate", "checkpoint", "the rest")


def settings(kind: Kind, *, steps: int, exact: bool, out: Path) -> TrainConfig:
    """The thesis's settings (D3QN-I, 80x64, 8 samples a transition), with 16 robots, in complex_train.

    Args:
        kind: of the collector.
        steps: transitions in all.
        exact: batches of 8 and an update a transition; else batches of 64 and an update every eighth.
        out: the run's directory.
    """
    return dataclasses.replace(
        PRESETS["thesis"],
        collector=kind,
        num_envs=16,
        steps_per_batch=64,
        steps_per_handover=64,
        total_steps=steps,
        batch_size=8 if exact else 64,
        steps_per_update=1.0 if exact else 8.0,
        warmup_steps=min(1_000, steps // 4),
        eval_interval=max(25_000, steps // 16),
        checkpoint_interval=max(50_000, steps // 8),
        log_interval=max(64, min(4_000, steps // 16)),
        report=False,
        out=out,
    )


def run(
    console: Console, *, steps: int = THESIS_STEPS, exact: bool = False, collectors: Sequence[Kind], out: Path
) -> dict[str, Any]:
    """Trains once with each kind of collector, each in a process of its own, and prints what came out.

    Args:
        console: where to.
        steps: transitions in all.
        exact: see ``settings``.
        collectors: the kinds.
        out: JSON file; results that it holds for the same settings are kept, and new ones written to it as they come.

    Returns:
        what the file holds.

    Raises:
        ValueError: for fewer steps than 512, and a file that cannot be written, or holds something else: another
            machine's results, say, or those of other settings or versions of libraries.
        navsim.processes.WorkerDeathError: if the process that trains is killed.
    """
    if steps < 512:
        raise ValueError(f"--steps must be at least 512, to have a rate at the end; got {steps}")
    keys = {kind: f"{'exact' if exact else 'batch64'}-{kind}-{steps}" for kind in collectors}
    results = _read(out)
    for kind, key in keys.items():
        if key in results["runs"]:
            _check(results["runs"][key], settings(kind, steps=steps, exact=exact, out=Path()), out)
    try:
        write_json(out, results)  # now, what is in its way costs no training
    except OSError as error:
        raise ValueError(f"{out} cannot be written ({error.strerror}); choose another file (--out)") from error
    for kind, key in keys.items():
        if key not in results["runs"]:
            with console.status(f"training with the {kind} collector, {steps:,} steps"):
                (results["runs"][key],) = map_in_processes(
                    partial(measure, kind, steps),
                    [exact],
                    what="that train",
                    remedy="run the command again: what is in its file is not measured anew",
                )
            write_json(out, results)
    rows = {kind: results["runs"][key] for kind, key in keys.items()}
    console.print(f"[bold]{steps:,} steps, {'batches of 8' if exact else 'batches of 64'}[/bold], {processor()}")
    console.print(_table(rows))
    if len(rows) == 2:
        ratio = rows["async"]["steady_steps_per_second"] / rows["sync"]["steady_steps_per_second"]
        console.print(f"async is {ratio:.2f} times as fast as sync; written to {out}")
    return results


def _read(path: Path) -> dict[str, Any]:
    present = versions()
    if not path.exists():
        return {"runs": {}, "versions": present}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found["runs"], dict):
            raise TypeError("runs")
        of_file = {name: found["versions"].get(name, "unknown") for name in _SPEED_DEPENDS_ON}
    except (AttributeError, OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} does not hold results of this benchmark; choose another file (--out)") from error
    for name, what in _SPEED_DEPENDS_ON.items():
        if of_file[name] != present[name]:
            raise ValueError(
                f"{path} holds what was measured {what}, {of_file[name]}, not {present[name]}; choose another file "
                "(--out)"
            )
    return found


def _check(measured: Any, wanted: TrainConfig, path: Path) -> None:
    """That an entry of the file is of these settings, and whole."""
    try:
        others = differing_settings(measured["settings"], settings_of(wanted))
        _ = [float(measured[key]) for key in _MEASURED], [float(part) for part in measured["parts"].values()]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not hold results of this benchmark; choose another file (--out)") from error
    if others:
        raise ValueError(
            f"{path} has the results of other settings than this benchmark's ({', '.join(others)}); choose another "
            "file (--out)"
        )


def measure(kind: Kind, steps: int, exact: bool) -> dict[str, Any]:
    """Trains once in this process, with stopwatches in it.

    Returns:
        ``seconds``, ``parts`` (seconds), ``steady_steps_per_second`` (from a quarter of the run on), ``thesis_seconds``
        (400,000 steps at that rate), ``peak_megabytes`` of all processes together, ``settings``.
    """
    from torchrl.collectors import AsyncCollector, Collector
    from torchrl.data import TensorDictReplayBuffer

    import rl.train
    from rl.checkpoints import Checkpoints
    from rl.learner import Learner
    from rl.optimiser import SoftUpdateAtOnce
    from rl.stopwatch import stopwatch

    parts = {
        "collect": ((Collector, "rollout"),),
        "wait": ((AsyncCollector, "_get_from_queue"),),
        "replay": ((TensorDictReplayBuffer, "extend"), (TensorDictReplayBuffer, "sample")),
        "update": ((Learner, "update"),),
        "target network": ((SoftUpdateAtOnce, "step"),),
        "hand over": ((AsyncCollector, "update_policy_weights_"),),
        "evaluate": ((rl.train, "_evaluate"),),
        "checkpoint": ((Checkpoints, "save"),),
    }
    with tempfile.TemporaryDirectory() as directory, _peak_memory() as peak, stopwatch(parts) as spent:
        config = settings(kind, steps=steps, exact=exact, out=Path(directory) / "run")
        begin = time.perf_counter()
        finished = rl.train.train(config, console=Console(quiet=True))
        seconds = time.perf_counter() - begin
        rows = [(int(row["step"]), float(row["seconds"])) for row in finished.metrics.rows()]
    first = next(row for row in rows if row[0] >= steps // 4)
    rate = (rows[-1][0] - first[0]) / (rows[-1][1] - first[1])
    return {
        "seconds": seconds,
        "parts": {**spent, "the rest": seconds - sum(spent.values())},
        "steady_steps_per_second": rate,
        "thesis_seconds": THESIS_STEPS / rate,
        "peak_megabytes": peak[0],
        "settings": config.to_dict(),
    }


@contextmanager
def _peak_memory() -> Iterator[list[float]]:
    """The most megabytes that this process and its children occupy together, memory that they share counted once."""
    peak, done = [0.0], threading.Event()

    def watch() -> None:
        while not done.wait(_SAMPLE_SECONDS):
            peak[0] = max(peak[0], sum(map(_proportional_megabytes, _family(os.getpid()))))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        done.set()
        thread.join()


def _family(process: int) -> list[int]:
    found = [process]
    with contextlib.suppress(OSError):
        for task in os.listdir(f"/proc/{process}/task"):
            children = Path(f"/proc/{process}/task/{task}/children").read_text(encoding="ascii").split()
            found += [member for child in children for member in _family(int(child))]
    return found


def _proportional_megabytes(process: int) -> float:
    """The proportional set size: private pages, and of those shared with k - 1 others one k-th."""
    with contextlib.suppress(OSError, StopIteration), open(f"/proc/{process}/smaps_rollup", encoding="ascii") as file:
        return next(float(line.split()[1]) / 1e3 * 1.024 for line in file if line.startswith("Pss:"))
    return 0.0


def _table(rows: dict[Kind, dict[str, Any]]) -> Table:
    table = Table()
    table.add_column("")
    for kind in rows:
        table.add_column(kind, justify="right")
    for part in PARTS:
        cells = [row["parts"].get(part) for row in rows.values()]
        if any(cell is not None for cell in cells):
            table.add_row(f"{part}, s", *("" if cell is None else f"{cell:,.1f}" for cell in cells))
    table.add_section()
    table.add_row("all, s", *(f"{row['seconds']:,.1f}" for row in rows.values()))
    table.add_row("steps/s after a quarter", *(f"{row['steady_steps_per_second']:,.0f}" for row in rows.values()))
    table.add_row("400,000 steps, minutes", *(f"{row['thesis_seconds'] / 60:,.1f}" for row in rows.values()))
    table.add_row("peak memory, MB", *(f"{row['peak_megabytes']:,.0f}" for row in rows.values()))
    return table
