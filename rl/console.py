"""What all commands print with."""

from __future__ import annotations

from rich.console import Console
from rich.status import Status


def busy(what: str) -> Status:
    """A sign of life beside the output, for what takes a few seconds."""
    return Console(stderr=True).status(what)
