"""What can be made of a world file's text while it is being written: a world to draw, and what is wrong with it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from pydantic import ValidationError, model_validator
from typing_extensions import Self

from navsim.editor.yamltree import Tree
from navsim.errors import WorldError
from navsim.world import World
from navsim.worldfile import _Document, parse_text


class Sketch(World):
    """A world that may break the geometric rules: it can be drawn, looked at and mended all the same."""

    @model_validator(mode="after")
    def _keeps_the_rules(self) -> Self:
        return self


class Finding(NamedTuple):
    """Something to tell the author about a line; lines and columns count from 1."""

    line: int
    column: int
    text: str
    severity: str = "error"


@dataclass(frozen=True)
class Reading:
    """What a text says."""

    text: str
    world: World | None
    """None for a text that is not a world at all."""
    findings: tuple[Finding, ...]

    @cached_property
    def tree(self) -> Tree:
        """Where the text says it, for a text that gives a world; positions do not count a byte order mark."""
        return Tree(self.text.removeprefix("\ufeff"))


def read_world(text: str, default_name: str = "world") -> Reading:
    """What ``text`` says, however far it can be understood.

    >>> reading = read_world("format: 1\\nsize: [4, 4]\\ngoals: [[3, 0]]")
    >>> reading.world.goals[0].at
    (3.0, 0.0)
    >>> [(finding.line, finding.text[:34]) for finding in reading.findings]
    [(3, 'goals[0]: [3, 0] is outside the ro')]
    """
    bare = text.removeprefix("\ufeff")
    try:
        return Reading(text, parse_text(bare, _SOURCE, default_name), ())
    except WorldError as error:
        findings = tuple(_finding(problem) for problem in error.problems)
    return Reading(text, _sketched(bare, default_name), findings)


_SOURCE = "<editor>"


def _finding(problem: str) -> Finding:
    place = re.fullmatch(rf"{_SOURCE}:(\d+):(\d+): (.*)", problem, flags=re.DOTALL)
    return Finding(int(place[1]), int(place[2]), place[3]) if place else Finding(1, 1, problem)


def _sketched(text: str, default_name: str) -> World | None:
    try:
        document = _Document(text, _SOURCE)
        if document.problems or not isinstance(document.data, dict):
            return None
        return Sketch.model_validate({"name": default_name, **document.data})
    except (WorldError, ValidationError):
        return None
