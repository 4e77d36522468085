"""World files: YAML in, a :class:`World` or errors with line numbers out; and back.

PyYAML's event stream (libyaml where it is installed: a hundred times faster than a parser in Python) is turned into plain
dicts, lists and scalars here rather than by one of YAML's usual constructors, for three reasons: every value keeps
its line and column, a key that is written twice is noticed, and scalars follow YAML 1.2, where ``1e-3`` is a number
and ``no`` is a word.
"""

from __future__ import annotations

import difflib
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import yaml

from navsim.errors import Problem, WorldError, key_path
from navsim.world import World, parse_world

DEEPEST_NESTING = 50
"""Lists and mappings inside one another; a world needs six."""
MOST_VALUES = 5_000_000
"""Values that a file may hold after its aliases are replaced by what they stand for."""
LARGEST_FILE = 64 * 2**20
"""Bytes."""

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _shipped_worlds_directory() -> Path:
    """``navsim/worlds`` of an installed package, ``worlds`` beside ``navsim`` in a checkout."""
    here = Path(__file__).resolve().parent
    return here / "worlds" if (here / "worlds").is_dir() else here.parent / "worlds"


SHIPPED_WORLDS_DIRECTORY = _shipped_worlds_directory()
"""Where the worlds that come with the library lie."""


def shipped_worlds() -> list[str]:
    """Names of the worlds that come with the library, in alphabetical order; :func:`load_world` takes them."""
    return sorted(path.stem for path in SHIPPED_WORLDS_DIRECTORY.glob("*.yaml"))


def load_world(path: str | os.PathLike[str]) -> World:
    """The world of a world file.

    Args:
        path: a file, or the name of a shipped world such as ``"complex_train"``.

    Raises:
        WorldError: when there is no such file, or the file breaks the format's rules; with every problem of the
            file, each with file, line, column and key.
    """
    file = _find(path)
    try:
        content = file.read_bytes()
    except OSError as error:
        reason = "is a directory, not a world file" if file.is_dir() else f"cannot be read ({error.strerror})"
        raise WorldError([f"{file}: {reason}; name a file such as 'room.yaml'"]) from None
    if len(content) > LARGEST_FILE:
        raise WorldError([f"{file}: is larger than {LARGEST_FILE // 2**20} MiB; split it into several worlds"])
    return parse_text(content, source=str(file), default_name=file.stem)


def parse_text(content: bytes | str, source: str = "<text>", default_name: str = "world") -> World:
    """The world that the text of a world file describes.

    Args:
        content: the text, or its UTF-8 bytes.
        source: what errors call the file.
        default_name: name of a world whose text does not name it.

    Raises:
        WorldError: when the text breaks the format's rules; with every problem of the text.
    """
    document = _Document(_decoded(content, source) if isinstance(content, bytes) else content, source)
    world, problems = parse_world(document.data, default_name)
    located = [document.located(problem) for problem in problems] + document.problems
    if located or world is None:
        located.sort(key=lambda problem: problem.mark)
        raise WorldError(list(dict.fromkeys(f"{source}:{p.mark.line}:{p.mark.column}: {p.text}" for p in located)))
    return world


def save_world(world: World, path: str | os.PathLike[str]) -> None:
    """Writes ``world`` as a world file, one obstacle, start or goal a line; :func:`load_world` reads it back."""
    Path(path).write_text(dump_world(world), encoding="utf-8")


def dump_world(world: World) -> str:
    """The text of a world file that describes ``world``."""
    lines = []
    for key, value in world.to_dict().items():
        if isinstance(value, list) and key != "size":
            lines += [f"\n{key}:" if value else f"\n{key}: []", *(f"  - {_flow(entry)}" for entry in value)]
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    """``value`` in YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10**9, allow_unicode=True)
    text = text.removesuffix("\n...\n").rstrip("\n")
    if isinstance(value, dict) and len(value) == 1 and isinstance(next(iter(value.values())), dict):
        return text[1:-1]
    return text


def _find(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    if file.exists():
        return file
    shipped = shipped_worlds()
    if str(path) in shipped:
        return SHIPPED_WORLDS_DIRECTORY / f"{path}.yaml"
    meant = difflib.get_close_matches(file.stem, shipped, n=1)
    neighbours = [str(file.with_name(name)) for name in _yaml_files(file.parent)]
    meant = meant or difflib.get_close_matches(str(file), neighbours, n=1)
    remedy = (
        f"did you mean '{meant[0]}'?" if meant else f"name a file or one of the shipped worlds: {', '.join(shipped)}"
    )
    raise WorldError([f"{path}: there is no such world file; {remedy}"])


def _yaml_files(directory: Path) -> list[str]:
    try:
        return [name for name in os.listdir(directory) if name.endswith((".yaml", ".yml"))]
    except OSError:
        return []


def _decoded(content: bytes, source: str) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        text = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file with UTF-8 encoding"
        raise WorldError([f"{source}:{line}:{column}: {text}"]) from None


class _Mark(NamedTuple):
    """A place in a file, counted from 1 as editors do."""

    line: int
    column: int


class _Located(NamedTuple):
    mark: _Mark
    text: str


class _Places(NamedTuple):
    """Where a key and its value stand; a list's entry has its position for a key and no mark of its own."""

    key: _Mark
    value: _Mark


_NULL = {"~", "null", "Null", "NULL"}
_BOOLEANS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_TAG = "tag:yaml.org,2002:"
_CONTAINER_TAGS = {"map": dict, "seq": list}


class _Document:
    """The one document of a YAML text, as plain data, with the place of every value."""

    def __init__(self, text: str, source: str) -> None:
        self.source = source
        self.problems: list[_Located] = []
        self._places: dict[int, dict[str | int, _Places]] = {}
        self._anchors: dict[str, tuple[object, int]] = {}
        self._open_anchors: set[str] = set()
        self._count = 0
        self._path: list[str | int] = []
        try:
            self._events: Iterator[Any] = iter(yaml.parse(text, Loader=_Loader))
            self.data = self._read_document()
        except yaml.YAMLError as error:
            self._fail_on_syntax(error)

    def located(self, problem: Problem) -> _Located:
        """``problem`` with the place of what it names, or of the nearest thing around that."""
        mark, data = self._start, self.data
        for depth, part in enumerate(problem.where):
            places = self._places[id(data)][part]
            last = depth == len(problem.where) - 1
            mark = places.key if last and problem.at_key else places.value
            data = data[part]  # type: ignore[index]
        return _Located(mark, str(problem))

    def _read_document(self) -> object:
        next(self._events)
        event = next(self._events)
        if isinstance(event, yaml.StreamEndEvent):
            self._fail(_Mark(1, 1), "the file is empty; a world needs at least 'format: 1' and 'size: [7.0, 7.0]'")
        first = next(self._events)
        self._start = _mark(first)
        data = self._read(first)
        next(self._events)
        event = next(self._events)
        if not isinstance(event, yaml.StreamEndEvent):
            self._fail(_mark(event), "a second document ('---') begins here; put each world in a file of its own")
        return data

    def _read(self, event: Any) -> object:
        self._count += 1
        if self._count > MOST_VALUES:
            self._fail(_mark(event), f"the file holds more than {MOST_VALUES} values; split it into several worlds")
        if isinstance(event, yaml.AliasEvent):
            return self._read_alias(event)
        if event.anchor is None:
            return self._read_content(event)
        before = self._count
        self._open_anchors.add(event.anchor)
        value = self._read_content(event)
        self._open_anchors.discard(event.anchor)
        self._anchors[event.anchor] = (value, self._count - before)
        return value

    def _read_alias(self, event: Any) -> object:
        if event.anchor in self._open_anchors:
            self._fail(_mark(event), f"'*{event.anchor}' stands inside the very thing that it stands for; write it out")
        if event.anchor not in self._anchors:
            self._fail(_mark(event), f"'*{event.anchor}' stands for nothing; mark a value before it '&{event.anchor}'")
        value, size = self._anchors[event.anchor]
        self._count += size
        return value

    def _read_content(self, event: Any) -> object:
        if isinstance(event, yaml.ScalarEvent):
            return self._read_scalar(event)
        if len(self._path) > DEEPEST_NESTING:
            self._fail(_mark(event), f"lists and mappings are nested deeper than {DEEPEST_NESTING} levels")
        kind = "map" if isinstance(event, yaml.MappingStartEvent) else "seq"
        if event.tag not in (None, "!", _TAG + kind):
            self._refuse_tag(event)
        return self._read_mapping() if kind == "map" else self._read_list()

    def _read_list(self) -> list[object]:
        values: list[object] = []
        places = self._places[id(values)] = {}
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            mark = _mark(event)
            places[len(values)] = _Places(mark, mark)
            self._path.append(len(values))
            values.append(self._read(event))
            self._path.pop()
        return values

    def _read_mapping(self) -> dict[str, object]:
        values: dict[str, object] = {}
        places = self._places[id(values)] = {}
        merged: list[tuple[_Mark, object]] = []
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key_mark = _mark(event)
            key = self._read_key(event)
            value_event = next(self._events)
            self._path.append(key)
            if _is_blank(value_event):
                self._report(key_mark, "has no value; write one after the colon, or leave the key out")
            value = self._read(value_event)
            self._path.pop()
            if key == "<<":
                merged.append((key_mark, value))
            elif key in values:
                first = places[key].key
                self._path.append(key)
                self._report(key_mark, f"is given twice, first in line {first.line}; leave one of them out")
                self._path.pop()
            else:
                values[key] = value
                places[key] = _Places(key_mark, _mark(value_event))
        for mark, value in merged:
            self._merge(mark, value, values, places)
        return values

    def _read_key(self, event: Any) -> str:
        if isinstance(event, yaml.AliasEvent):
            key = self._read_alias(event)
        elif isinstance(event, yaml.ScalarEvent):
            key = event.value
        else:
            key = None
        if not isinstance(key, str):
            self._fail(_mark(event), "a key must be a word, not a list or a mapping; put braces '{}' around settings")
        return key

    def _merge(self, mark: _Mark, source: object, values: dict[str, object], places: dict[Any, _Places]) -> None:
        """YAML's merge key ``<<``: fills in what ``values`` lacks from one mapping or several, earlier ones first."""
        for mapping in source if isinstance(source, list) else [source]:
            if not isinstance(mapping, dict):
                self._report(mark, "'<<' must stand before an alias of a mapping, or a list of them")
                return
            for key, value in mapping.items():
                if key not in values:
                    values[key] = value
                    places[key] = self._places[id(mapping)][key]

    def _read_scalar(self, event: Any) -> object:
        text = event.value
        if event.tag is None and event.implicit[0]:
            return _resolved(text)
        kind = (event.tag or "").removeprefix(_TAG)
        if event.tag in (None, "!") or kind == "str":
            return text
        if kind in ("int", "float", "bool", "null"):
            return _resolved(text)
        self._refuse_tag(event)

    def _refuse_tag(self, event: Any) -> NoReturn:
        tag = event.tag.replace(_TAG, "!!")
        self._fail(_mark(event), f"the tag '{tag}' is not read in a world file; write plain numbers, words and lists")

    def _report(self, mark: _Mark, text: str) -> None:
        path = key_path(self._path)
        self.problems.append(_Located(mark, f"{path}: {text}" if path else text))

    def _fail(self, mark: _Mark, text: str) -> NoReturn:
        path = key_path(self._path)
        text = f"{path}: {text}" if path else text
        raise WorldError([f"{self.source}:{mark.line}:{mark.column}: {text}"])

    def _fail_on_syntax(self, error: yaml.YAMLError) -> NoReturn:
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            mark = _Mark(error.problem_mark.line + 1, error.problem_mark.column + 1)
            begun = f" {error.context}" if error.context else ""
            if error.context_mark is not None and error.context:
                begun += f" that begins in line {error.context_mark.line + 1}"
            self._path.clear()
            self._fail(mark, f"not YAML: {error.problem}{begun}; check brackets, quotes, colons and indentation here")
        reason = getattr(error, "reason", str(error))
        raise WorldError([f"{self.source}:1:1: not YAML: {reason}; save the file as plain text"]) from None


def _mark(event: Any) -> _Mark:
    mark = event.start_mark
    return _Mark(mark.line + 1, mark.column + 1)


def _is_blank(event: Any) -> bool:
    return isinstance(event, yaml.ScalarEvent) and not event.value and event.implicit[0] and event.anchor is None


def _resolved(text: str) -> object:
    """A plain scalar's value by the core schema of YAML 1.2, without its octal and hexadecimal numbers."""
    if _FLOAT.fullmatch(text):
        is_small_integer = len(text) < 19 and _INTEGER.fullmatch(text)
        return int(text) if is_small_integer else float(text)
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if text in _NULL or not text:
        return None
    special = _SPECIAL.fullmatch(text)
    if special:
        return float(text.replace(".", "", 1))
    return text
