"""YAML files of other programs: plain data, and the line of every part of it."""

from __future__ import annotations

import os
import re
from typing import Any

import yaml

from navsim.convert.errors import ConversionError
from navsim.convert.textfile import read_bytes

DEEPEST_NESTING = 50
"""Lists and mappings inside one another."""
MOST_VALUES = 60_000
"""Values, after aliases are replaced by what they stand for."""
LARGEST_FILE = 16 * 2**20
"""Bytes."""
LONGEST_TEXT = 1_000
"""Characters of a key or a value."""
LONGEST_NUMBER = 400
"""Characters: numbers to the base 60, as YAML 1.1 has them, take time by the square of their length."""

_EXPONENT = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]{1,3}")
"""Numbers that YAML 1.1 takes for text, for want of a dot or a sign; yaml-cpp, which ROS reads maps with, does not."""

_CORE = "tag:yaml.org,2002:"
_TAGS = {_CORE + kind for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp", "merge")}
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class Node:
    """A value with its file and line; lists hold nodes, mappings map words to nodes."""

    __slots__ = ("file", "line", "value", "where")

    def __init__(self, value: Any, file: str, line: int, where: str) -> None:
        self.value, self.file, self.line, self.where = value, file, line, where

    def get(self, key: str) -> Node | None:
        """What a mapping holds under ``key``; None for no such key, and for a key without a value."""
        found = self.value.get(key) if isinstance(self.value, dict) else None
        return None if found is None or found.value is None else found

    def need(self, key: str, example: str) -> Node:
        """What a mapping holds under ``key``.

        Raises:
            ConversionError: when there is nothing; ``example`` is its remedy.
        """
        found = self.get(key)
        if found is None:
            raise self.error(f"key '{key}' is missing; add '{key}: {example}'")
        return found

    @property
    def entries(self) -> list[Node]:
        """What a list holds; a lone value is taken for a list of one."""
        return self.value if isinstance(self.value, list) else [self]

    def number(self) -> float:
        """Its value as a finite number."""
        value = self.value
        if isinstance(value, str) and _EXPONENT.fullmatch(value):
            value = float(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"must be a number, not {_shown(value)}")
        if not abs(value) <= 1e9:
            raise self.error(f"must be a finite number up to 1e+09, not {_shown(value)}")
        return float(value)

    def numbers(self, fewest: int, most: int) -> list[float]:
        """Its value as a list of ``fewest`` to ``most`` finite numbers."""
        if not isinstance(self.value, list) or not fewest <= len(self.value) <= most:
            count = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise self.error(f"must be a list of {count} numbers, not {_shown(self.plain())}")
        return [entry.number() for entry in self.value]

    def is_numbers(self) -> bool:
        """Whether its value is a list of nothing but numbers."""
        return isinstance(self.value, list) and all(
            isinstance(entry.value, (int, float)) and not isinstance(entry.value, bool) for entry in self.value
        )

    def word(self) -> str:
        """Its value as text."""
        if not isinstance(self.value, str):
            raise self.error(f"must be text, not {_shown(self.plain())}")
        return self.value

    def truth(self) -> bool:
        """Its value as true or false; 0 and 1 will do."""
        if self.value not in (True, False):
            raise self.error(f"must be true or false, not {_shown(self.plain())}")
        return bool(self.value)

    def mapping(self, what: str) -> Node:
        """Itself, if it is a mapping."""
        if not isinstance(self.value, dict):
            raise self.error(f"must be {what}, not {_shown(self.plain())}")
        return self

    def plain(self) -> Any:
        """Its value without lines, as far as a message needs it."""
        if isinstance(self.value, list):
            return [entry.plain() for entry in self.value[:5]]
        if isinstance(self.value, dict):
            return dict.fromkeys(list(self.value)[:5], "…")
        return self.value

    def error(self, text: str) -> ConversionError:
        """What is wrong with it, to be raised."""
        return ConversionError(self.file, self.line, f"{self.where}: {text}" if self.where else text)


def read_yaml(path: str | os.PathLike[str]) -> Node:
    """What a YAML file holds.

    Raises:
        ConversionError: when it cannot be read, is not one plain YAML document, or is excessive.
    """
    content, file = read_bytes(path, LARGEST_FILE), str(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConversionError(file, line, "is not UTF-8 text; save it with UTF-8 encoding") from None
    try:
        _check_size(text, file)
        root = yaml.compose(text, Loader=_Loader)
    except ConversionError:
        raise
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
        remedy = "check brackets, quotes, colons and indentation before this place"
        raise ConversionError(file, mark.line + 1 if mark else 1, f"not YAML: {problem}; {remedy}") from None
    if root is None:
        raise ConversionError(file, 1, "the file is empty; name another")
    return _Reader(file).read(root, "", 0)


def _check_size(text: str, file: str) -> None:
    """Looks at the text without building anything: PyYAML's composer recurses in C, where depth crashes the process."""
    depth = count = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.NodeEvent):
            count += 1
            depth += isinstance(event, yaml.CollectionStartEvent)
            line = event.start_mark.line + 1 if event.start_mark else 1
            _check_excess(file, line, count, depth)


def _check_excess(file: str, line: int, count: int, depth: int) -> None:
    if depth > DEEPEST_NESTING:
        raise ConversionError(
            file, line, f"lists and mappings are nested deeper than {DEEPEST_NESTING} levels; flatten them"
        )
    if count > MOST_VALUES:
        text = f"the file holds more than {MOST_VALUES} values, aliases replaced by what they stand for; split it"
        raise ConversionError(file, line, text)


class _Reader:
    def __init__(self, file: str) -> None:
        self._file, self._count = file, 0
        self._constructor = yaml.SafeLoader("")

    def read(self, node: yaml.Node, where: str, depth: int) -> Node:
        line = node.start_mark.line + 1
        self._count += 1
        _check_excess(self._file, line, self._count, depth)
        if node.tag not in _TAGS:
            raise ConversionError(self._file, line, f"the tag '{node.tag[:40]}' is not read; write plain values")
        value: Any
        if isinstance(node, yaml.MappingNode):
            value = {}
            merged: dict[str, Node] = {}
            for key, entry in node.value:
                name = key.value if isinstance(key, yaml.ScalarNode) else ""
                if len(name) > LONGEST_TEXT:
                    raise ConversionError(
                        self._file, line, f"a key is longer than {LONGEST_TEXT} characters; shorten it"
                    )
                read = self.read(entry, f"{where}.{name}" if where else name, depth + 1)
                if key.tag == _CORE + "merge":
                    for source in read.entries:
                        for key_of_it, value_of_it in source.value.items() if isinstance(source.value, dict) else ():
                            merged.setdefault(key_of_it, value_of_it)
                else:
                    value[name] = read
            value = {**merged, **value}
        elif isinstance(node, yaml.SequenceNode):
            value = [self.read(entry, f"{where}[{i}]", depth + 1) for i, entry in enumerate(node.value)]
        else:
            try:
                if len(node.value) > LONGEST_NUMBER and node.tag != _CORE + "str":
                    raise ValueError
                value = self._constructor.construct_object(node)
            except (yaml.YAMLError, ValueError, OverflowError):
                tag = f"{where}: " if where else ""
                raise ConversionError(
                    self._file, line, f"{tag}cannot be read as a plain value; write a number or a word"
                ) from None
            if len(node.value) > LONGEST_TEXT:
                text = f"is longer than {LONGEST_TEXT} characters; shorten it"
                raise ConversionError(self._file, line, f"{where}: {text}" if where else text)
            if not isinstance(value, (bool, int, float, str, type(None))):
                value = node.value  # a date: the text as it stands
        return Node(value, self._file, line, where)


def _shown(value: object) -> str:
    if isinstance(value, int) and abs(value) > 1e18:
        return "a huge number"
    text = "nothing" if value is None else repr(value)
    return f"{text[:60]}…" if len(text) > 60 else text
