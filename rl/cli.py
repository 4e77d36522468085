"""The ``navsim`` command: what can be typed, and how mistakes are told. Each command calls one part of the library.

Everything that takes long to import is imported where it is used, so that ``navsim --help`` answers at once. That is
also why annotations are not deferred here: tyro reads those of :func:`_training_settings`, which are local.
"""

import argparse
import dataclasses
import shlex
import sys
import traceback
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro
from rich.console import Console
from tyro.conf import OmitArgPrefixes, Positional, arg
from tyro.extras import SubcommandApp

if TYPE_CHECKING:
    from rl.config import TrainConfig

USAGE_ERROR = 2
INTERRUPTED = 130

_DESCRIPTION = """Train and evaluate robots that find their way by depth images.

`navsim COMMAND --help` explains a command, `navsim --version` tells the version."""

_navsim, _world, _bench = SubcommandApp(), SubcommandApp(), SubcommandApp()


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: what follows ``navsim`` on the command line; by default the process's own arguments.

    Returns:
        the exit status: 0, or 2 for what the user can put right (told in a sentence on standard error), or 130 after
        Ctrl-C. Mistakes of this library's own leave as exceptions.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        _dispatch(arguments)
    except SystemExit as end:  # tyro has printed help, or what is wrong with the arguments
        return end.code if isinstance(end.code, int) else USAGE_ERROR
    except KeyboardInterrupt as interruption:
        print(f"\n{interruption or 'interrupted'}", file=sys.stderr)
        return INTERRUPTED
    except (ValueError, OSError) as error:
        if not _is_for_the_user(error):
            raise
        print(error, file=sys.stderr)
        return USAGE_ERROR
    return 0


def _dispatch(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"navsim {_version()}")
    elif arguments[:1] == ["train"]:
        train(*arguments[1:])
    else:
        _navsim.cli(prog="navsim", description=_DESCRIPTION, args=arguments or ["--help"])


def _is_for_the_user(error: ValueError | OSError) -> bool:
    """Whether an error is about a file that the system refuses, or a value that this library itself refuses.

    A ``ValueError`` that comes out of numpy or torch is our own mistake.
    """
    if isinstance(error, OSError):
        return error.filename is not None
    *_, (innermost, _) = traceback.walk_tb(error.__traceback__)
    return innermost.f_globals.get("__name__", "").partition(".")[0] in ("navsim", "rl")


def _version() -> str:
    try:
        return metadata.version("navsim-rl")
    except metadata.PackageNotFoundError:
        return "(not installed: run from its source)"


@_navsim.command
def train(*arguments: str) -> None:
    """Train a robot, evaluate it in a room it has never seen, and write a report."""
    config, resume = _training_settings(arguments)
    from rl.run import Run
    from rl.train import train

    console = Console()
    try:
        run = train(config, resume=resume, console=console)
        ...
    except KeyboardInterrupt:
        again = shlex.join(["navsim", "train", "--resume", "--out", str(config.directory)])
        raise KeyboardInterrupt(f"stopped; to go on from the last checkpoint: {again}") from None
