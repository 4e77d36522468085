"""What can be made of a world file's text while it is being written: a world to draw, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from pydantic import ValidationError, model_validator
from typing_extensions import Self

from navsim.check import check_text
from navsim.editor.yamltree import Tree
from navsim.errors import Finding, WorldError
from navsim.world import World
from navsim.worldfile import parse_text, read_document


class Sketch(World):
    """A world that may break the geometric rules: it can be drawn, looked at and mended all the same."""

    @model_validator(mode="after")
    def _keeps_the_rules(self) -> Self:
        return self


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
        return Reading(text, parse_text(bare, default_name=default_name), ())
    except WorldError as error:
        return Reading(text, _sketched(bare, default_name), error.findings)


def oddities_of(reading: Reading) -> list[Finding]:
    """What is legal in a text but odd; nothing for one with errors. It takes a moment."""
    return [] if reading.findings else list(check_text(reading.text.removeprefix("\ufeff")).warnings)


def _sketched(text: str, default_name: str) -> World | None:
    try:
        document = read_document(text)
        if document.problems or not isinstance(document.data, dict):
            return None
        return Sketch.model_validate({"name": default_name, **document.data})
    except (WorldError, ValidationError):
        return None
