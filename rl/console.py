"""What all commands print with."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress

from rich.console import Console
from rich.status import Status


class Output(Console):
    """Standard output. A reader that has gone away is told as Python's own ``print`` does; rich would end the program.

    Raises:
        BrokenPipeError: from whatever prints.
    """

    def on_broken_pipe(self) -> None:
        """What rich calls then."""
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


class LastingOutput(Console):
    """Standard output of what takes hours: it goes on when its reader has gone away, and says so on standard error."""

    def on_broken_pipe(self) -> None:
        """What rich calls then."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        with suppress(OSError):  # whose reader may have gone with it
            print("nobody reads the output any more: going on without it", file=sys.stderr, flush=True)


def busy(what: str) -> Status:
    """A sign of life beside the output, for what takes a few seconds."""
    return Console(stderr=True).status(what)
