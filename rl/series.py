"""Series of trainings, each with a file of results: any number of evenings, and of processes, until all are finished.

What is finished is skipped, what was interrupted goes on, and what fails is told and does not end the others.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from navsim.errors import WorldError
from rl.background import CollectorError
from rl.config import ConfigError, TrainConfig
from rl.run import Run, RunError, differing_settings, settings_of, versions, write_json
from rl.train import train
from rl.watch import NumbersError


class SeriesError(RuntimeError):
    """Runs of a series that are not finished at its end; all others are."""


class Planned(NamedTuple):
    """One run of a series."""

    name: str
    """Its own among those of the series."""
    what: str
    """It is, in a few words."""
    labels: dict[str, Any]
    """By which its results are told from others'; part of them."""
    config: TrainConfig
    """Its settings."""
    results: Path
    """JSON file of its results; where it is, the run is finished."""


def run_series(
    planned: Sequence[Planned],
    results_of: Callable[[Run], dict[str, Any]],
    write_up: Callable[[], None],
    console: Console,
) -> None:
    """Trains what is not finished yet, one after the other.

    Results hold, besides those of ``results_of``, the run's labels, ``steps``, ``settings``, ``machine`` and
    ``versions``. Once they are written, the run's checkpoints are removed, a gigabyte a run; its weights and logs stay.

    Args:
        planned: the runs, in the order in which they are trained.
        results_of: what is to be kept of a run that has ended.
        write_up: makes pages and figures of the results that there are; called after each run, and at the end.
        console: where progress is shown.

    Raises:
        ValueError: for results of another length or other settings than those planned, and for files that cannot be
            read or written, before anything is trained.
        SeriesError: at the end, if runs have failed or another process is training them.
    """
    for one in planned:
        _check_results(one)
        with _told(one.results.parent):
            one.results.parent.mkdir(parents=True, exist_ok=True)
    if not all(one.results.exists() for one in planned):
        with _told():
            write_up()  # of what there is: now, what is in its way costs no training
    failed = []
    for number, one in enumerate(planned, 1):
        place = f"[{number}/{len(planned)}] {one.name}"
        if one.results.exists():
            console.print(f"{place}: finished before", markup=False, highlight=False)
            _forget_checkpoints_of_ended(one)
            continue
        console.print(f"{place}: {one.what}", markup=False, highlight=False)
        try:
            run = train(one.config, resume=Run(one.config.directory).exists, console=console)
            with run.claimed():
                if not one.results.exists():  # another process may have been as far
                    write_json(one.results, one.labels | _described(run) | results_of(run), indent=None)
                _forget_checkpoints(one)
        except (CollectorError, ConfigError, NumbersError, OSError, RunError, WorldError) as error:
            console.print(f"{one.name}: {error}", markup=False, highlight=False, soft_wrap=True)
            failed.append(one)
            continue
        try:
            write_up()
        except (OSError, ValueError) as error:  # of which the end tells as well, if it lasts
            console.print(f"not written up: {error}", markup=False, highlight=False, soft_wrap=True)
    with _told():
        write_up()
    missing = [one.name for one in failed if not one.results.exists()]  # which another process has finished since
    if missing:
        raise SeriesError(f"not finished: {', '.join(missing)}; the reasons stand above")


def read_results(path: Path, *keys: str) -> dict[str, Any]:
    """What the results file of a run holds, which are ``keys`` besides what all of them hold.

    Raises:
        ValueError: for a file that is not one, which is named.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not (isinstance(found["steps"], int) and isinstance(found.get("settings", {}), dict)):
            raise TypeError("of another kind")
        _ = [found[key] for key in keys]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not hold the results of a run; move it away") from error
    return found


@contextmanager
def _told(directory: Path | None = None) -> Iterator[None]:
    """Files that cannot be read or written are told as other mistakes are."""
    try:
        yield
    except OSError as error:
        raise ValueError(f"{error.filename or directory} cannot be used: {error.strerror or error}") from error


def _check_results(one: Planned) -> None:
    if not one.results.exists():
        return
    found = read_results(one.results)
    steps, settings = found["steps"], found.get("settings", {})
    if steps != one.config.total_steps:
        raise ValueError(
            f"{one.results} has the results of {steps:,} steps, where {one.config.total_steps:,} are asked for; move "
            "it and the run's directory away, or name others (--results, --runs)"
        )
    wanted = json.loads(json.dumps(settings_of(one.config)))
    if wanted["autocast"] == "auto":  # which has been decided there
        del wanted["autocast"]
    others = differing_settings(settings, wanted)
    if others:
        raise ValueError(
            f"{one.results} has the results of other settings than those asked for ({', '.join(others)}); move it and "
            "the run's directory away, or name others (--results, --runs)"
        )


def _forget_checkpoints_of_ended(one: Planned) -> None:
    """What lies there may be another run, with results elsewhere, which is not finished or just being trained."""
    run = Run(one.config.directory)
    with suppress(RunError):
        if run.exists and run.has_ended:
            with run.claimed():
                _forget_checkpoints(one)


def _forget_checkpoints(one: Planned) -> None:
    shutil.rmtree(one.config.directory / "checkpoints", ignore_errors=True)


def _described(run: Run) -> dict[str, Any]:
    return {
        "steps": run.config.total_steps,
        "settings": settings_of(run.config),
        "machine": run.processor,
        "versions": versions(),
    }
