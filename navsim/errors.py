"""What is wrong with a world, told to its author."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple


class Problem(NamedTuple):
    """One thing that is wrong with a world."""

    where: tuple[str | int, ...]
    """The keys and list positions that lead to it, such as ``("obstacles", 2, "box", "height")``."""
    text: str
    """What is wrong and what to do; it reads on after ``where``."""
    at_key: bool = False
    """Whether the key itself is at fault (it is unknown, say), not its value."""

    def __str__(self) -> str:
        return f"{key_path(self.where)}: {self.text}" if self.where else self.text


class Finding(NamedTuple):
    """Something to tell the author about a place in a file; lines and columns count from 1, as editors do."""

    line: int
    column: int
    end_column: int
    """Column behind the last character of the text at fault, in the same line; at least ``column + 1``."""
    text: str
    """One sentence, without the place."""
    severity: Literal["error", "warning"] = "error"
    where: tuple[str | int, ...] = ()
    """The keys and list positions that lead to it; empty for the file as a whole."""


class WorldError(ValueError):
    """A world that breaks the rules of the format; the message lists every problem found, one a line."""

    def __init__(self, problems: Sequence[str], findings: Sequence[Finding] = ()) -> None:
        super().__init__(tuple(problems))
        self.problems: tuple[str, ...] = tuple(problems)
        """One sentence for each problem, with its place."""
        self.findings: tuple[Finding, ...] = tuple(findings)
        """The same problems for a program to work with, where they are about places in a text."""

    def __str__(self) -> str:
        return "\n".join(self.problems)


def key_path(where: Sequence[str | int]) -> str:
    """How ``where`` reads in a message.

    >>> key_path(("obstacles", 2, "box", "height"))
    'obstacles[2].box.height'
    """
    text = ""
    for part in where:
        word = str(part) if str(part).isprintable() else repr(part)[1:-1]
        text += f"[{word}]" if isinstance(part, int) else f".{word}" if text else word
    return text


def counted(count: int, noun: str) -> str:
    """So many of what ``noun`` names.

    >>> counted(1, "path"), counted(0, "path"), counted(2, "box")
    ('1 path', '0 paths', '2 boxes')
    """
    plural = f"{noun}es" if noun.endswith("x") else f"{noun}s"
    return f"{count} {noun if count == 1 else plural}"
