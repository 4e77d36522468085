"""The checkpoints of a run: written whole or not at all, with checksums, and the newest intact one found again.

A checkpoint is a directory of TorchRL's ``torchrl.checkpoint``, with one file more::

    checkpoints/checkpoint-000000050000/
        manifest.json        what is in it, the run's settings, versions
        components/          a file for the learner, the replay, the collector, ...
        SHA256SUMS           of all the other files; ``sha256sum -c SHA256SUMS`` checks them, too
"""

from __future__ import annotations

import hashlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointRotation, StateDictCheckpointAdapter

from navsim.files import flush_to_disk
from rl.config import TrainConfig
from rl.run import RunError, settings_of, writing
from rl.safe_loading import nothing_executed_from

KEPT = 3
"""Checkpoints on the disk: the last two, and the best by evaluation, which may be one of them."""
_CHECKSUMS = "SHA256SUMS"
_SCORE = "score"


class StateFile(StateDictCheckpointAdapter):
    """TorchRL's adapter for ``state_dict``, one file by ``torch.save`` for each component.

    TorchRL's default maps the files into memory, and a process that writes to a mapped file on a full disk is killed
    by a signal instead of being told. Reading executes nothing that is in the file.

    Args:
        mapped: whether reading maps the file, for a component that copies what it is given: else its state would be in
            the memory twice.
    """

    def __init__(self, *, mapped: bool = False) -> None:
        super().__init__("torch")
        self._mapped = mapped

    def load(self, component: Any, path: Path, **settings: Any) -> Any:
        """Puts back what was saved below ``path``."""
        return super().load(component, path, **{**settings, "tensor_load_kwargs": {"mmap": self._mapped}})


class Checkpoints:
    """A directory of checkpoints: the last two and the best are kept.

    Args:
        directory: where they are, or will be.
        settings: of the run, as plain values; a checkpoint of other settings is refused.
    """

    def __init__(self, directory: Path, settings: dict[str, Any]) -> None:
        self.directory, self._settings = directory, settings
        self._rotation = CheckpointRotation(directory, keep_last=2, keep_best=(_SCORE, "max"))

    def paths(self) -> list[Path]:
        """All checkpoints, the oldest first, damaged ones included."""
        return sorted(path for path in self.directory.glob("checkpoint-*") if path.name[len("checkpoint-") :].isdigit())

    def save(self, checkpoint: Checkpoint, step: int, score: float) -> Path:
        """Writes a checkpoint; it appears under its name when all of it is on the disk.

        Args:
            checkpoint: what is to be written.
            step: transitions collected.
            score: the greater, the better; of all checkpoints, the best is kept.

        Raises:
            RunError: if the disk is full or refuses the files. Older checkpoints are untouched.
        """
        final = self.directory / f"checkpoint-{step:012d}"
        new = self.directory / f".{final.name}.{uuid.uuid4().hex}"
        try:
            with writing(final):
                checkpoint.save(new, metadata={"settings": self._settings, _SCORE: score})
                _seal(new)
                _remove(final)  # where there is one, it is damaged, or it would have been gone on from
                os.replace(new, final)
                flush_to_disk(self.directory)
        finally:
            shutil.rmtree(new, ignore_errors=True)
        self._rotation.prune()
        return final

    def newest_intact(self, say: Callable[[str], None]) -> Path | None:
        """The checkpoint to go on from; None where none has been written yet.

        Args:
            say: is told of each damaged checkpoint that is passed over, in one sentence.

        Raises:
            RunError: if all are damaged.
        """
        damaged: list[tuple[Path, str]] = []
        for path in reversed(self.paths()):
            damage = find_damage(path)
            if not damage:
                for passed, why in damaged:
                    say(f"{passed} is damaged ({why}): it is removed, and the run goes on from {path.name}")
                    _remove(passed)
                return path
            damaged.append((path, damage))
        if damaged:
            reasons = ", ".join(f"{path.name}: {damage}" for path, damage in damaged)
            raise RunError(
                f"every checkpoint in {self.directory} is damaged ({reasons}); restore one, or delete that directory "
                "to begin the run anew"
            )
        return None

    def load(self, checkpoint: Checkpoint, path: Path) -> None:
        """Puts everything back as it was.

        Raises:
            RunError: for a checkpoint of other settings or another version.
        """
        try:
            written = Checkpoint.manifest(path)["metadata"]["settings"]
            settings = settings_of(TrainConfig.from_dict(written))  # those that came later at their defaults
            unlike = sorted(name for name, value in settings.items() if value != self._settings[name])
            if unlike:
                raise RunError(
                    f"{path} was written with other settings than {self.directory.parent / 'config.json'} holds "
                    f"({', '.join(unlike)}); restore the file that belongs to the run, or delete the checkpoint"
                )
            with nothing_executed_from(path):
                checkpoint.load(path)
        except RunError:
            raise
        except Exception as error:  # intact, but what it holds is not what this version's parts take
            raise RunError(
                f"{path} is intact, but cannot be gone on with ({_first_line(error)}); use the versions that "
                f"{self.directory.parent / 'versions.json'} names, or choose another directory (--out) to begin anew"
            ) from error

    def remove_rubbish(self) -> None:
        """Removes what a process that was killed had begun to write or to delete."""
        for path in self.directory.glob(".*"):
            shutil.rmtree(path, ignore_errors=True)


def step_of(path: Path) -> int:
    """Transitions that had been collected when a checkpoint was written."""
    return int(path.name.rpartition("-")[2])


def _remove(path: Path) -> None:
    """Removes whatever has the name of a checkpoint: a directory, or a file or link that somebody has put there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def find_damage(path: Path) -> str:
    """What is wrong with a checkpoint's files, in a few words; empty where nothing is."""
    try:
        lines = (path / _CHECKSUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeError):
        return f"{_CHECKSUMS} cannot be read"
    listed = {}
    for line in lines:
        digest, gap, name = line.partition("  ")
        if not gap:
            return f"{_CHECKSUMS} is cut off"
        listed[name] = digest
    present = {name for name, _ in _files(path)}
    for name in sorted(listed.keys() | present):
        if name not in present:
            return f"{name} is missing"
        if name not in listed:
            return f"{_CHECKSUMS} does not name {name}"
        try:
            if _digest(path / name) != listed[name]:
                return f"{name} does not have the checksum that it was written with"
        except OSError as error:
            return f"{name} cannot be read: {error.strerror}"
    return "" if listed else f"{_CHECKSUMS} is empty"


def _seal(path: Path) -> None:
    """Adds the checksums, and sees to it that everything is on the disk."""
    lines = [f"{_digest(file)}  {name}\n" for name, file in _files(path)]
    (path / _CHECKSUMS).write_text("".join(lines), encoding="utf-8")
    for entry in sorted(path.rglob("*")):
        flush_to_disk(entry)
    flush_to_disk(path)


def _files(path: Path) -> Iterator[tuple[str, Path]]:
    """Names and paths of the files that checksums are of."""
    for file in sorted(path.rglob("*")):
        name = file.relative_to(path).as_posix()
        if file.is_file() and name != _CHECKSUMS:
            yield name, file


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
