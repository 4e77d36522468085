"""Checkpoints from strangers: nothing that is in their files is executed.

``torch.load`` with ``weights_only=True``, which reads the files that this program writes, has a reader of its own, with
a short list of what it may name. But TorchRL reads whatever format it finds in a component's directory, and TensorDict
loads pickles that lie beside its memory maps; a pickle calls whatever it names. So while a checkpoint is loaded,
pickles may hold plain data and name nothing.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from rl.run import RunError

_IMPORTING = ".tdc"
"""Ending of TensorDict's consolidated files, whose metadata name modules to be imported."""

_named: ContextVar[list[str] | None] = ContextVar("_named", default=None)
"""What pickles have named since loading began; None where pickles are not looked at."""


@contextmanager
def nothing_executed_from(path: Path) -> Iterator[None]:
    """Sees to it that loading a checkpoint executes nothing that is in it.

    Args:
        path: the checkpoint, a directory.

    Raises:
        RunError: for a checkpoint that would have something executed or imported. Whatever was loaded before the place
            at fault stays loaded.
    """
    _check_members(path)
    _install()
    named: list[str] = []
    token = _named.set(named)
    try:
        yield
    except Exception:
        if not named:
            raise
    finally:
        _named.reset(token)
    if named:
        raise RunError(
            f"{path} would execute {named[0]}, and a checkpoint holds nothing to be executed: somebody has tampered "
            "with it; delete it, and restore your own or train from the beginning"
        )


def _check_members(path: Path) -> None:
    for file in path.rglob("*"):
        if file.suffix.lower() == _IMPORTING:
            raise RunError(
                f"{path} holds {file.relative_to(path)}, a kind of file that no checkpoint of this program has: "
                "somebody has tampered with it; delete it, and restore your own or train from the beginning"
            )


@functools.cache
def _install() -> None:
    """Once, for hooks stay for as long as the process."""
    sys.addaudithook(_refuse_names_in_pickles)


def _refuse_names_in_pickles(event: str, arguments: tuple[object, ...]) -> None:
    if event != "pickle.find_class":
        return
    named = _named.get()
    if named is not None:
        named.append(".".join(map(str, arguments)))
        raise RuntimeError("a pickle in a checkpoint may name nothing")
