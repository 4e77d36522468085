"""A YAML text as a tree of nodes that know where they stand in it, for those who change a text in place.

Positions count characters from 0. A node's ``end`` is where its own text ends: trailing blanks and comments are not
part of it, whatever YAML's grammar makes of them.
"""

from __future__ import annotations

import bisect
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import yaml

from navsim.worldfile import plain_scalar

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_BREAK = re.compile(r"\r\n|[\n\r\x85\u2028\u2029]")
_PROPERTY = re.compile(r"[&!][^\s,\[\]{}]*")
_STRING_TAG = "tag:yaml.org,2002:str"


@dataclass(eq=False)
class Node:
    """A value or a key, where it is written."""

    kind: Literal["scalar", "list", "mapping", "alias"]
    start: int
    """Where it begins, with its anchor and tag."""
    end: int
    content: int
    """Where it begins, without its anchor and tag."""
    flow: bool = True
    """Whether a list or a mapping is written in brackets or braces."""
    anchor: str | None = None
    text: str = ""
    """Of a scalar: its text, without quotes."""
    style: str | None = None
    """Of a scalar: ``'"'``, ``"'"``, ``"|"``, ``">"``, or None for a plain one."""
    is_text: bool = False
    """Of a scalar: whether it is text whatever it looks like."""
    items: list[Node] = field(default_factory=list)
    """Of a list."""
    pairs: list[tuple[Node, Node]] = field(default_factory=list)
    """Of a mapping, in the order of the file, merge keys included."""
    target: Node | None = None
    """Of an alias: what it stands for."""

    @property
    def children(self) -> list[Node]:
        """Items, or keys and values in turn."""
        return self.items or [node for pair in self.pairs for node in pair]

    @property
    def meant(self) -> Node:
        """The node itself, or what an alias stands for."""
        return self.target.meant if self.target is not None else self

    @property
    def key(self) -> str:
        """The word that a scalar is when it is a key."""
        return self.meant.text

    def own(self, key: str) -> Node | None:
        """The value that this mapping itself gives ``key``, not counting merge keys."""
        return next((value for name, value in self.pairs if name.key == key), None)

    def data(self) -> Any:
        """What the node says: dicts, lists, numbers, words; aliases and merge keys are resolved."""
        if self.target is not None:
            return self.target.data()
        if self.kind == "scalar":
            return self.text if self.is_text else plain_scalar(self.text)
        if self.kind == "list":
            return [item.data() for item in self.items]
        values = {key.key: value.data() for key, value in self.pairs if key.key != "<<"}
        for key, value in self.pairs:
            if key.key == "<<":
                source = value.meant
                for mapping in source.items if source.kind == "list" else [source]:
                    for name, merged in mapping.data().items():
                        values.setdefault(name, merged)
        return values

    def walk(self) -> Iterator[Node]:
        """The node and all below it in the order of the text; aliases are not followed."""
        yield self
        for child in self.children:
            yield from child.walk()


class Tree:
    """The one document of a YAML text that :func:`navsim.worldfile.parse_text` has found to be readable.

    Args:
        text: without a byte order mark.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._anchors: dict[str, Node] = {}
        self._events: Iterator[Any] = iter(yaml.parse(text, Loader=_Loader))
        next(self._events), next(self._events)
        self.root = self._read(next(self._events))

    def _read(self, event: Any) -> Node:
        start, end = event.start_mark.index, event.end_mark.index
        if isinstance(event, yaml.AliasEvent):
            return Node("alias", start, end, start, target=self._anchors[str(event.anchor)])
        content = self._after_properties(start, end) if event.anchor or event.tag else start
        node = Node("scalar", start, end, content, anchor=event.anchor)
        if isinstance(event, yaml.ScalarEvent):
            node.text, node.style = event.value, None if event.style in (None, "") else event.style
            node.is_text = event.tag == _STRING_TAG or not (event.implicit[0] or event.tag)
            while node.style in ("|", ">") and node.end > node.content and self.text[node.end - 1].isspace():
                node.end -= 1
        else:
            node.flow = bool(event.flow_style)
            if isinstance(event, yaml.MappingStartEvent):
                node.kind = "mapping"
                while not isinstance(event := next(self._events), yaml.MappingEndEvent):
                    node.pairs.append((self._read(event), self._read(next(self._events))))
            else:
                node.kind = "list"
                while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
                    node.items.append(self._read(event))
            if not node.flow and node.children:
                first = node.children[0]
                node.end = node.children[-1].end
                node.content = first.start if node.kind == "mapping" else self.find("-", content, first.start)
            else:
                node.end = event.end_mark.index
        if node.anchor:
            self._anchors[node.anchor] = node
        return node

    def _after_properties(self, start: int, end: int) -> int:
        position = start
        while found := _PROPERTY.match(self.text, position):
            position = self._skip(found.end())
        return position

    def _skip(self, position: int) -> int:
        """The first place from ``position`` on that is neither blank nor in a comment."""
        while position < len(self.text):
            if self.text[position] == "#":
                position = self.line_end(position)
            elif self.text[position].isspace() or self.text[position] in "\x85\u2028\u2029":
                position += 1
            else:
                break
        return position

    def find(self, sign: str, start: int, end: int) -> int:
        """Where ``sign`` stands between two nodes, outside comments; -1 if it does not."""
        position = self._skip(start)
        while position < end:
            if self.text[position] == sign:
                return position
            position = self._skip(position + 1)
        return -1

    def has_comment(self, start: int, end: int) -> bool:
        """Whether there is a comment between two nodes."""
        return "#" in self.text[start:end]

    @cached_property
    def _line_starts(self) -> list[int]:
        return [0, *(match.end() for match in _BREAK.finditer(self.text))]

    def line_start(self, position: int) -> int:
        """Where the line begins that holds ``position``."""
        return self._line_starts[bisect.bisect_right(self._line_starts, position) - 1]

    def line_end(self, position: int) -> int:
        """Where the line ends that holds ``position``: at its line break, or at the end of the text."""
        found = _BREAK.search(self.text, position)
        return found.start() if found else len(self.text)

    def next_line(self, position: int) -> int:
        """Where the next line begins, or the end of the text."""
        found = _BREAK.search(self.text, position)
        return found.end() if found else len(self.text)

    def column(self, position: int) -> int:
        """Characters between the beginning of the line and ``position``."""
        return position - self.line_start(position)

    def is_first_on_line(self, position: int) -> bool:
        """Whether only blanks stand before ``position`` on its line."""
        return not self.text[self.line_start(position) : position].strip(" ")

    def ends_line(self, position: int) -> bool:
        """Whether only blanks and a comment follow ``position`` on its line."""
        rest = self.text[position : self.line_end(position)]
        return not rest.strip(" \t") or (rest[:1] in " \t" and rest.lstrip(" \t").startswith("#"))

    @cached_property
    def line_break(self) -> str:
        """The line break that the text uses first."""
        found = re.search(r"\r\n|[\n\r]", self.text)
        return found.group() if found else "\n"

    @cached_property
    def writes_decimals(self) -> bool:
        """Whether whole lengths are written as ``1.0`` here: as the numbers of the file do, or there are none."""
        numbers = [
            node.text
            for node in self.root.walk()
            if node.kind == "scalar" and not node.is_text and re.fullmatch(r"[-+]?[0-9.]+", node.text)
        ]
        return len(numbers) <= 1 or any("." in number for number in numbers)
