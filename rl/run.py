"""A run's directory: what lies in it, and writing it so that nothing is ever half there.

::

    config.json          every setting                    metrics.csv       one row each log interval
    versions.json        of Python and the libraries      evaluations.csv   one row each evaluation
    worlds/              the world files used             tensorboard/      the same curves for TensorBoard
    policy.pt            weights, best by evaluation      evaluation/       final evaluations, JSON
    policy_last.pt       weights of the last step         checkpoints/      from which a run is resumed
    report.html          the report
"""

from __future__ import annotations

import csv
import importlib.metadata
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import torch

from rl.config import TrainConfig

METRICS = [
    *("step", "episodes", "seconds", "steps_per_second"),
    *("success_rate", "collision_rate", "timeout_rate", "reward", "episode_length"),
    *("loss", "q_mean", "max_q", "epsilon", "learning_rate"),
]
"""Columns of metrics.csv."""
EVALUATIONS = ["step", "seconds", "world", "success_rate", "collision_rate", "timeout_rate", "spl", "reward", "steps"]
"""Columns of evaluations.csv."""
_LIBRARIES = ("torch", "torchrl", "tensordict", "pymunk", "numpy", "pydantic", "scipy")


class RunError(ValueError):
    """A run's directory that cannot be used."""


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """A file that takes ``path``'s place when it is complete, and leaves no trace when it is not."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, mode, encoding=None if "b" in mode else "utf-8") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes files that only their owner can read; a result is as readable as any other file.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_json(path: Path, value: Any) -> None:
    """Writes ``value`` as indented JSON, atomically."""
    with atomic_write(path) as file:
        json.dump(value, file, indent=2, allow_nan=False)
        file.write("\n")


class Table:
    """A CSV file that grows by rows, and can be cut back to a step when a run is resumed."""

    def __init__(self, path: Path, columns: list[str]) -> None:
        self.path, self.columns = path, columns

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row; keys that are not columns are an error."""
        is_new = not self.path.exists()
        with self.path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns)
            if is_new:
                writer.writeheader()
            writer.writerow({key: _short(value) for key, value in row.items()})

    def rows(self) -> list[dict[str, str]]:
        """All rows, as text."""
        if not self.path.exists():
            return []
        with self.path.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def truncate_after(self, step: int) -> None:
        """Drops the rows beyond ``step``: they belong to what a resumed run does again."""
        kept = [row for row in self.rows() if int(row["step"]) <= step]
        with atomic_write(self.path) as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(kept)


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value


class Run:
    """The files of one training run.

    Args:
        directory: where they are, or will be.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        self.metrics = Table(self.directory / "metrics.csv", METRICS)
        self.evaluations = Table(self.directory / "evaluations.csv", EVALUATIONS)

    @classmethod
    def create(cls, config: TrainConfig) -> Run:
        """A new run's directory.

        Raises:
            RunError: if one is there already.
        """
        run = cls(config.directory)
        if run.exists:
            raise RunError(
                f"{run.directory} already holds a run; go on with it (--resume), or choose another directory (--out)"
            )
        run.directory.mkdir(parents=True, exist_ok=True)
        write_json(run.directory / "versions.json", versions())
        write_json(run.directory / "config.json", config.to_dict())
        return run

    @classmethod
    def open(cls, directory: Path | str) -> Run:
        """An existing run.

        Raises:
            RunError: if there is none.
        """
        run = cls(directory)
        if not run.exists:
            raise RunError(f"{run.directory} is not a run's directory: it has no config.json")
        return run

    @property
    def exists(self) -> bool:
        """Whether the directory holds a run."""
        return (self.directory / "config.json").is_file()

    @property
    def config(self) -> TrainConfig:
        """The run's settings.

        Raises:
            RunError: if they cannot be read.
        """
        path = self.directory / "config.json"
        try:
            return TrainConfig.from_dict(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, RecursionError) as error:
            raise RunError(f"{path} cannot be used: {error}") from error

    def save_policy(self, name: str, state_dict: Mapping[str, torch.Tensor]) -> None:
        """Writes weights to ``NAME.pt``, atomically."""
        with atomic_write(self.directory / f"{name}.pt", "wb") as file:
            torch.save({key: value.detach().cpu() for key, value in state_dict.items()}, file)

    def load_policy(self, name: str) -> dict[str, torch.Tensor]:
        """Weights from ``NAME.pt``.

        Raises:
            RunError: if they are missing or damaged. Nothing in the file is executed.
        """
        path = self.directory / f"{name}.pt"
        if not path.is_file():
            raise RunError(f"{path} is missing: the run has not been evaluated yet, or is not complete")
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # torch.load raises a dozen types for a damaged file
            first_line = (str(error).splitlines() or [type(error).__name__])[0]
            raise RunError(
                f"{path} is damaged or not a file of weights ({first_line}); train again or restore it"
            ) from error


def versions() -> dict[str, str]:
    """Versions of Python, the libraries and the machine's kind."""
    found = {"python": sys.version.split()[0], "platform": platform.platform(), "processor": processor()}
    for library in _LIBRARIES:
        found[library] = importlib.metadata.version(library)
    try:
        found["navsim-rl"] = importlib.metadata.version("navsim-rl")
    except importlib.metadata.PackageNotFoundError:
        found["navsim-rl"] = "from source"
    return found


def processor() -> str:
    """The processor's name, as far as the system tells."""
    return _first(
        lambda: next(
            line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo", encoding="utf-8") if "model name" in line
        ),
        lambda: platform.processor() or platform.machine(),
    )


def _first(*attempts: Callable[[], str]) -> str:
    for attempt in attempts:
        try:
            return attempt()
        except (OSError, StopIteration):
            continue
    return "unknown"
