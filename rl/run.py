"""A run's directory: what lies in it, and writing it so that nothing is ever half there.

::

    config.json          every setting, the format        metrics.csv       one row each log interval
    versions.json        of Python and the libraries      evaluations.csv   one row each evaluation
    worlds/              copies of the world files used   tensorboard/      the same curves for TensorBoard
    policy.pt            weights, best by evaluation      evaluation/       final evaluations, JSON
    policy_last.pt       weights of the last checkpoint   checkpoints/      from which a run is resumed
    report.html          the report                       warnings.txt      what was warned about, if anything

``config.json`` is written last of what a run begins with: where it is, the run has begun, and everything is there.
Generated rooms are not copied: the name of their source, with its seed, says them all. Where numbers were not finite,
``bad_batch-STEP.safetensors`` holds what they came from.
"""

from __future__ import annotations

import csv
import errno
import fcntl
import importlib.metadata
import io
import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from warnings import warn

import torch

from navsim.files import TEMPORARY, atomic_write
from navsim.worldfile import read_file
from navsim.worldsource import is_generated
from rl.config import TrainConfig

FORMAT = 2
"""Of a run's directory. Format 1 has no processor time in its tables, and format 0, which does not say so, no copies of
worlds, and checkpoints of another kind."""

METRICS = [
    *("step", "episodes", "seconds", "processor_seconds", "steps_per_second"),
    *("success_rate", "collision_rate", "timeout_rate", "reward", "episode_length"),
    *("loss", "q_mean", "max_q", "epsilon", "learning_rate"),
]
"""Columns of metrics.csv."""
EVALUATIONS = [
    *("step", "seconds", "processor_seconds", "world"),
    *("success_rate", "collision_rate", "timeout_rate", "spl", "reward", "steps"),
]
"""Columns of evaluations.csv."""
POLICY_FILES = {"best": "policy", "last": "policy_last"}
"""Names of the files of weights, without their suffix: those that did best in evaluations, and the last."""
_WRITTEN = (
    *("policy.pt", "policy_last.pt", "metrics.csv", "evaluations.csv", "report.html", "episode.mp4"),
    *("evaluation", "tensorboard", "checkpoints"),
)
"""What a run writes into its directory after ``config.json``."""
_FILES = re.compile(r"config\.json|versions\.json|.+\.pt|.+\.csv|report\.html|episode\.mp4|bad_batch-.+\.safetensors")
"""Names of the files that a run writes as a whole or not at all."""
_LIBRARIES = ("torch", "torchrl", "tensordict", "pymunk", "numpy", "pydantic", "scipy")


class RunError(ValueError):
    """A run's directory that cannot be used."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tells in one sentence that a file of a run could not be written, the disk being full, say.

    Raises:
        RunError: in place of the system's errors, and those of ``torch.save``.
    """
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        raise _refused(path, error.strerror or str(error), full) from error
    except RuntimeError as error:
        if "inline_container" not in str(error) and "iostream" not in str(error):
            raise
        raise _refused(path, "the system took only a part of it", full=True) from error


def _refused(path: Path, reason: str, full: bool) -> RunError:
    place = next(parent for parent in path.absolute().parents if parent.exists())
    free = "" if not full else f", {shutil.disk_usage(place).free / 2**20:,.1f} MiB are free there"
    remedy = "make room" if full else "put that right"
    return RunError(
        f"{path} could not be written ({reason}{free}): the run has stopped, what was written before is intact; "
        f"{remedy}, then go on with --resume"
    )


def write_json(path: Path, value: Any, indent: int | None = 2) -> None:
    """Writes ``value`` as JSON, atomically; without ``indent`` in one line."""
    with atomic_write(path) as file:
        file.write(_json(value, indent))


def _json(value: Any, indent: int | None = 2) -> str:
    return json.dumps(value, indent=indent, allow_nan=False) + "\n"


class Table:
    """A CSV file that grows by rows."""

    def __init__(self, path: Path, columns: list[str]) -> None:
        self.path, self.columns = path, columns

    def append(self, row: Mapping[str, Any]) -> dict[str, str]:
        """Adds a row, and returns it as ``rows`` will; keys that are not columns are an error.

        Raises:
            RunError: if the file cannot be written.
        """
        text = {key: str(_short(value)) if value is not None else "" for key, value in row.items()}
        with writing(self.path):
            is_new = not self.path.exists()
            with self.path.open("a", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, self.columns)
                if is_new:
                    writer.writeheader()
                writer.writerow(text)
        return text

    def rows(self) -> list[dict[str, str]]:
        """All rows, as text, but for a last one that was not written to its end."""
        if not self.path.exists():
            return []
        with self.path.open(newline="", encoding="utf-8", errors="replace") as file:
            complete, _, _ = file.read().rpartition("\n")
        return list(csv.DictReader(io.StringIO(complete)))

    def check_beginning(self) -> None:
        """Raises ValueError if there is a file that does not begin as this table does."""
        if self.path.exists():
            with self.path.open(encoding="utf-8", errors="replace") as file:
                first = file.readline(10_000).rstrip("\r\n")
            if not ",".join(self.columns).startswith(first):
                raise ValueError(f"its first line is {first[:40]!r}")

    def replace(self, rows: Sequence[Mapping[str, str]]) -> None:
        """Makes these all the rows; without any, there is no file.

        Raises:
            RunError: if the file cannot be written.
        """
        if not rows:
            self.path.unlink(missing_ok=True)
            return
        with writing(self.path), atomic_write(self.path) as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(rows)


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
            RunError: if one is there already, or it cannot be written.
            navsim.WorldError: for a world file that cannot be read.
        """
        run = cls(config.directory)
        run.check_vacant()
        with writing(run.directory):
            first = {run.directory / "versions.json": _json(versions()).encode()}
            first |= {copy: read_file(source)[1] for source, copy in run._copies(config).items()}
            # What a run that was killed while it began has left is the same, and of no other file is it.
            run._check_free(path for path, content in first.items() if path.exists() and path.read_bytes() != content)
            run.directory.mkdir(parents=True, exist_ok=True)
            run.remove_rubbish()
            for path, content in first.items():
                with atomic_write(path, "wb") as file:
                    file.write(content)
            write_json(run.directory / "config.json", {"format": FORMAT, **config.to_dict()})
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
    def has_ended(self) -> bool:
        """Whether all that the settings ask for has been learnt and written.

        Raises:
            RunError: if the table of evaluations is damaged.
        """
        weights = self.directory / f"{POLICY_FILES['last']}.pt"
        try:
            rows = self.evaluations.rows()
            if not rows:
                self.evaluations.check_beginning()
            return bool(rows) and int(rows[-1]["step"]) >= self.config.total_steps and weights.exists()
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise RunError(f"{self.evaluations.path} is damaged ({error}); restore it") from error

    @property
    def format(self) -> int:
        """The format of the directory, at most ``FORMAT``.

        Raises:
            RunError: if it cannot be read, or is newer than this version of the library.
        """
        return self._read()[0]

    @property
    def processor(self) -> str:
        """What the run was begun on; "unknown" where its ``versions.json`` does not tell."""
        try:
            return json.loads((self.directory / "versions.json").read_text(encoding="utf-8"))["processor"]
        except (OSError, ValueError, KeyError, TypeError):
            return "unknown"

    @property
    def config(self) -> TrainConfig:
        """The run's settings.

        Raises:
            RunError: if they cannot be read.
        """
        _, values = self._read()
        try:
            return TrainConfig.from_dict(values)
        except (ValueError, TypeError) as error:
            raise RunError(f"{self.directory / 'config.json'} cannot be used: {error}") from error

    def _read(self) -> tuple[int, dict[str, Any]]:
        path = self.directory / "config.json"
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            found = values.pop("format", 0)
        except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
            raise RunError(f"{path} cannot be used: {error}") from error
        if not isinstance(found, int) or not 0 <= found <= FORMAT:
            raise RunError(
                f"{path} is of format {found!r}, and this version of navsim-rl reads formats up to {FORMAT}: install "
                "the version that versions.json beside it names, or a newer one"
            )
        return found, values

    def check_vacant(self) -> None:
        """Raises :class:`RunError` if the directory holds a run, or what a run would overwrite."""
        if self.exists:
            raise RunError(
                f"{self.directory} already holds a run; go on with it (--resume), or choose another directory (--out)"
            )
        self._check_free(path for name in _WRITTEN if (path := self.directory / name).exists())

    def _check_free(self, taken: Iterable[Path]) -> None:
        if names := [str(path.relative_to(self.directory)) for path in taken]:
            raise RunError(
                f"{self.directory} is not a run's directory, having no config.json, but holds {', '.join(names)}, "
                "which a run there would overwrite; choose another directory (--out)"
            )

    def check_resumable(self, config: TrainConfig) -> None:
        """Raises :class:`RunError` unless the run can be gone on with, with these settings."""
        if self.format < FORMAT:
            raise RunError(
                f"{self.directory} was written by an earlier version of navsim-rl, whose runs can be evaluated but not "
                "gone on with; choose another directory (--out) to begin anew"
            )
        begun, asked = (settings_of(one) for one in (self.config, config))
        changed = [name for name, value in begun.items() if value != asked[name]]
        if changed:
            raise RunError(
                f"{self.directory} was begun with other settings ({', '.join(changed)}), and a run keeps its settings; "
                "leave them out to go on with it, or choose another directory (--out) to begin anew"
            )

    def with_its_worlds(self, config: TrainConfig) -> TrainConfig:
        """The settings with the run's own copies in place of world files, which may have changed meanwhile.

        Raises:
            RunError: if a copy is missing.
        """
        if self.format < 1:
            return config
        copies = self._copies(config)
        for copy in copies.values():
            if not copy.is_file():
                raise RunError(f"{copy} is missing, the run's copy of a world file; restore it")
        own = {source: str(copy) for source, copy in copies.items()}
        return replace(
            config,
            out=self.directory,
            world=tuple(own.get(source, source) for source in config.world),
            eval_world=own.get(config.eval_world, config.eval_world),
        )

    def _copies(self, config: TrainConfig) -> dict[str, Path]:
        """Where the copy of each world file is; files of the same name are in directories of their own."""
        copies: dict[str, Path] = {}
        for source in (*config.world, config.eval_world):
            if source not in copies and not is_generated(source):
                name = Path(source).stem + ".yaml"
                namesakes = sum(copy.name == name for copy in copies.values())
                copies[source] = self.directory / "worlds" / (str(namesakes + 1) if namesakes else "") / name
        return copies

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Keeps every other process from training in the directory meanwhile.

        Raises:
            RunError: if one is training there, or there can be no such directory.
        """
        with writing(self.directory):
            self.directory.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.directory, os.O_RDONLY)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise RunError(
                    f"another process is training in {self.directory}; wait for its end, or choose another directory "
                    "(--out)"
                ) from None
            except OSError:
                message = f"{self.directory} is on a file system without locks: train there with one process at a time"
                warn(message, stacklevel=3)
            yield
        finally:
            os.close(handle)

    def remove_rubbish(self) -> None:
        """Removes the temporary files of a process that was killed while it wrote, and no other hidden files."""
        for place in (self.directory, *self.directory.glob("worlds/**"), self.directory / "evaluation"):
            written = _FILES if place == self.directory else re.compile(r".+\.(yaml|json)")
            for path in place.glob(".*"):
                temporary = TEMPORARY.fullmatch(path.name)
                if temporary and written.fullmatch(temporary["target"]) and path.is_file():
                    path.unlink()

    def save_policy(self, name: str, state_dict: Mapping[str, torch.Tensor]) -> None:
        """Writes weights to ``NAME.pt``, atomically.

        Raises:
            RunError: if the file cannot be written.
        """
        path = self.directory / f"{name}.pt"
        with writing(path), atomic_write(path, "wb") as file:
            torch.save({key: value.detach().cpu() for key, value in state_dict.items()}, file)

    def note(self, text: str) -> None:
        """Adds to ``warnings.txt``.

        Raises:
            RunError: if the file cannot be written.
        """
        path = self.directory / "warnings.txt"
        with writing(path), path.open("a", encoding="utf-8") as file:
            file.write(f"{text}\n")

    def remove_policy(self, name: str) -> None:
        """Removes ``NAME.pt``, if it is there."""
        (self.directory / f"{name}.pt").unlink(missing_ok=True)

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


def settings_of(config: TrainConfig) -> dict[str, Any]:
    """What a run's settings are compared by.

    All but where the directory is, which may be moved, and whether a report is written, which may be wanted later.
    """
    return {name: value for name, value in config.to_dict().items() if name not in ("out", "report")}


def differing_settings(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Names of settings that differ, of those that both know: what was found may be older than some.

    >>> differing_settings({"seed": 0, "task": {"max_steps": 9}}, {"seed": 0, "task": {"max_steps": 8}, "newer": 1})
    ['task.max_steps']
    """
    names = []
    for name in sorted(found.keys() & wanted.keys()):
        if isinstance(found[name], dict) and isinstance(wanted[name], dict):
            names += [f"{name}.{inner}" for inner in differing_settings(found[name], wanted[name])]
        elif found[name] != wanted[name]:
            names.append(name)
    return names


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
    """The processor's name, as far as the system tells; on Linux with its generation, which a name may not tell."""
    return _first(_processor_of_linux, lambda: platform.processor() or platform.machine())


def _processor_of_linux() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return f"{told['model name']} (family {told['cpu family']}, model {told['model']})"


def _first(*attempts: Callable[[], str]) -> str:
    for attempt in attempts:
        try:
            return attempt()
        except (OSError, KeyError):
            continue
    return "unknown"
