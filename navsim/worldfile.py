"""World files: YAML in, a :class:`World` or errors with line numbers out; and back.

PyYAML's event stream (made by libyaml, an order of magnitude faster than a parser in Python) is turned into plain
dicts, lists and scalars here rather than by one of YAML's usual constructors, for three reasons: every value keeps
its line and column, a key that is written twice is noticed, and scalars follow YAML 1.2, where ``1e-3`` is a number
and ``no`` is a word.
"""

from __future__ import annotations

import contextlib
import difflib
import gc
import itertools
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn

import yaml

from navsim.errors import Finding, Problem, WorldError
from navsim.files import write_text
from navsim.world import MOST_OBSTACLES, MOST_TOLD, World, parse_world

DEEPEST_NESTING = 50
"""Lists and mappings inside one another; a world needs six."""
MOST_VALUES = 120_000
"""Values that a file may hold after its aliases are replaced by what they stand for."""
LONGEST_COLLECTION = MOST_OBSTACLES
"""Entries of one list, and keys of one mapping."""
LARGEST_FILE = 16 * 2**20
"""Bytes."""
_MOST_EVENTS = 60_000
"""Of YAML: those that are looked at a second time to underline what is told, of which more would take too long."""
LONGEST_KEY = 500
"""Letters."""

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Quotes the words that this reader would take for numbers, as PyYAML's own YAML 1.1 does not do for ``1e5``."""


def _quoted_where_needed(dumper: Any, text: str) -> Any:
    is_plain = text.isprintable() and isinstance(plain_scalar(text), str)
    return dumper.represent_scalar(_TAG + "str", text, style=None if is_plain else '"')


_Dumper.add_representer(str, _quoted_where_needed)


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
    file, content = read_file(path)
    return parse_text(content, source=str(file), default_name=file.stem)


def read_file(path: str | os.PathLike[str]) -> tuple[Path, bytes]:
    """The file that ``path``, or the name of a shipped world, stands for, and its content.

    Raises:
        WorldError: when there is no such file, or it cannot be read, or it is too large to be a world.
    """
    file = _find(path)
    try:
        content = file.read_bytes()
    except OSError as error:
        reason = "is a directory, not a world file" if file.is_dir() else f"cannot be read ({error.strerror})"
        raise WorldError([f"{file}: {reason}; name a file such as 'room.yaml'"]) from None
    if len(content) > LARGEST_FILE:
        raise WorldError([f"{file}: is larger than {LARGEST_FILE // 2**20} MiB; split it into several worlds"])
    return file, content


def parse_text(content: bytes | str, source: str = "<text>", default_name: str = "world") -> World:
    """The world that the text of a world file describes.

    Args:
        content: the text, or its UTF-8 bytes.
        source: what errors call the file.
        default_name: name of a world whose text does not name it.

    Raises:
        WorldError: when the text breaks the format's rules; with every problem of the text.
    """
    text = decoded(content, source) if isinstance(content, bytes) else content
    with _without_garbage_collection():
        document = read_document(text, source)
        world, problems = parse_world(document.data, default_name)
    if world is None or document.problems:
        document.refuse(problems)
    return world


def read_document(text: str, source: str = "<text>") -> _Document:
    """The plain data of a YAML text, for :func:`navsim.world.parse_world`, and the place of every value.

    Raises:
        WorldError: when the text is not YAML, or uses what world files do without.
    """
    return _Document(text, source)


def save_world(world: World, path: str | os.PathLike[str]) -> None:
    """Writes ``world`` as a world file, one obstacle, start or goal a line; :func:`load_world` reads it back.

    The file is there as a whole or not at all: an interrupted save leaves the one that was there before.
    """
    write_text(path, dump_world(world))


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
    text = yaml.dump(
        value, Dumper=_Dumper, default_flow_style=True, sort_keys=False, width=2**31 - 1, allow_unicode=True
    )
    text = text.removesuffix("\n...\n").rstrip("\n")
    if isinstance(value, dict) and len(value) == 1 and isinstance(next(iter(value.values())), dict):
        return text[1:-1]
    return text


@contextlib.contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Nothing that is made while a file is read can be freed before it is read: looking for garbage costs a third."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _find(path: str | os.PathLike[str]) -> Path:
    file, shipped = Path(path), shipped_worlds()
    if file.exists() and not (file.is_dir() and str(path) in shipped):
        return file
    if str(path) in shipped:
        return SHIPPED_WORLDS_DIRECTORY / f"{path}.yaml"
    meant = difflib.get_close_matches(file.stem, shipped, n=1)
    neighbours = [str(file.with_name(name)) for name in _yaml_files(file.parent)]
    meant = meant or difflib.get_close_matches(str(file), neighbours, n=1)
    choice = f"name a file or one of the shipped worlds: {', '.join(shipped)}"
    remedy = f"did you mean '{meant[0]}'?" if meant else choice
    raise WorldError([f"{path}: there is no such world file; {remedy}"])


def _yaml_files(directory: Path) -> list[str]:
    try:
        return [name for name in os.listdir(directory) if name.endswith((".yaml", ".yml"))]
    except OSError:
        return []


def decoded(content: bytes, source: str) -> str:
    """The text of a file in UTF-8.

    Raises:
        WorldError: when it is not.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        text = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file with UTF-8 encoding"
        found = Finding(line, column, column + 1, text)
        raise WorldError([f"{source}:{line}:{column}: {text}"], [found]) from None


_NULL = {"~", "null", "Null", "NULL"}
_BOOLEANS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_UNREADABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # what YAML forbids
_TAG = "tag:yaml.org,2002:"
_RESOLVED_TAGS = {_TAG + kind for kind in ("int", "float", "bool", "null")}


class _Located(NamedTuple):
    """A problem and its place in the file, counted from 1 as editors do."""

    line: int
    column: int
    text: str
    where: tuple[str | int, ...] = ()
    is_scalar: bool = True
    """Whether the text at fault is a key or one value, not a list or mapping that begins in the same place."""


def text_lines(text: str) -> list[str]:
    """The lines of ``text`` as YAML counts them."""
    return re.split("\r\n|[\r\n\x85\u2028\u2029]", text)


class _Extents:
    """Where the keys and values of a text end; worked out only for what an author is told of."""

    def __init__(self, text: str, last_line: int) -> None:
        self._lines = text_lines(text)
        self._scalars: dict[tuple[int, int], tuple[int, int]] = {}
        self._collections: dict[tuple[int, int], tuple[int, int]] = {}
        self._last_end: dict[int, int] = {}
        """By line, the greatest column behind a key or value in it: where its comment has not begun."""
        open_marks: list[Any] = []
        with contextlib.suppress(yaml.YAMLError):
            events: Iterable[Any] = yaml.parse(text, Loader=_Loader)
            for event in itertools.islice(events, _MOST_EVENTS):
                start, end = event.start_mark, event.end_mark
                if start.line > last_line:  # and nothing is asked for that is beyond
                    break
                if isinstance(event, yaml.CollectionStartEvent):
                    open_marks.append((start, event.flow_style))
                    if len(open_marks) > DEEPEST_NESTING + 1:  # read no further than the reader of values has
                        break
                    continue
                if isinstance(event, yaml.CollectionEndEvent):
                    start, is_flow = open_marks.pop()
                    if not is_flow:
                        continue
                    self._collections[start.line, start.column] = (end.line, end.column)
                elif isinstance(event, (yaml.ScalarEvent, yaml.AliasEvent)):
                    self._scalars[start.line, start.column] = (end.line, end.column)
                else:
                    continue
                self._last_end[end.line] = max(self._last_end.get(end.line, 0), end.column)

    def end_column(self, located: _Located) -> int:
        """The column behind the text at fault, counted from 1; the end of the line where it goes on in the next."""
        line, column = located.line - 1, located.column - 1
        extents = self._scalars if located.is_scalar else self._collections
        last_line, end = extents.get((line, column), (line, column))
        if last_line > line or (end <= column and not located.is_scalar):
            length = len(self._lines[line].rstrip()) if line < len(self._lines) else 0
            end = self._last_end.get(line, length) if self._last_end.get(line, 0) > column else length
        return max(end, column + 1) + 1


class _Document:
    """The one document of a YAML text, as plain data, with the place of every value."""

    def __init__(self, text: str, source: str) -> None:
        self.problems: list[_Located] = []
        """What is wrong with the text as YAML, where reading could go on."""
        self._source = source
        self._text = text
        self._blank: set[tuple[str | int, ...]] = set()
        """Keys without a value; whatever else is wrong with them follows from that."""
        self._marks: dict[int, Any] = {}
        """By the ``id`` of a mapping: {key: (mark of the key, mark of the value)}; of a list: [mark of each entry]."""
        self._anchors: dict[str, tuple[object, int]] = {}
        """What each anchor stands for, and of how many values that consists."""
        self._open_anchors: set[str] = set()
        self._count = 0
        self._is_excessive = False
        self._path: list[str | int] = []
        try:
            self._events: Iterator[Any] = iter(yaml.parse(text, Loader=_Loader))
            self.data = self._read_document()
        except yaml.YAMLError as error:
            self._fail_on_syntax(error)

    def refuse(self, problems: list[Problem]) -> NoReturn:
        """Raises a :class:`WorldError` of ``problems`` and of what is wrong with the text itself, in its order."""
        told = (self._located(problem) for problem in problems if problem.where not in self._blank)
        by_place = {located[:3]: located for located in [*told, *self.problems]}
        located = [by_place[place] for place in sorted(by_place)]
        if len(located) > MOST_TOLD:
            rest = f"{len(located) - MOST_TOLD} more mistakes are not told; put these right first"
            located = [*located[:MOST_TOLD], _Located(*located[MOST_TOLD][:2], rest)]
        self._refuse(located)

    def _refuse(self, located: Sequence[_Located]) -> NoReturn:
        sentences = [f"{self._source}:{one.line}:{one.column}: {one.text}" for one in located]
        raise WorldError(sentences, self._findings(located, "error"))

    def findings(self, problems: Iterable[Problem], severity: Literal["error", "warning"]) -> list[Finding]:
        """``problems`` at their places in the text, in its order."""
        return self._findings(sorted(map(self._located, problems)), severity)

    def _findings(self, located: Sequence[_Located], severity: Literal["error", "warning"]) -> list[Finding]:
        if not located:
            return []
        # What is excessive is not read a second time for the sake of an underline.
        text, last_line = ("", 0) if self._is_excessive else (self._text, max(one.line for one in located))
        extents = _Extents(text, last_line)
        return [
            Finding(one.line, one.column, extents.end_column(one), one.text, severity, one.where) for one in located
        ]

    def _located(self, problem: Problem) -> _Located:
        mark, data, is_key = self._start, self.data, False
        for depth, part in enumerate(problem.where):
            try:
                mark = self._marks[id(data)][part]
            except KeyError:  # left out in the file: what it lies in is at fault
                break
            if isinstance(data, dict):
                is_key = problem.at_key and depth == len(problem.where) - 1
                mark = mark[0] if is_key else mark[1]
            data = data[part]  # type: ignore[index]
        is_scalar = is_key or not isinstance(data, (dict, list))
        return _Located(mark.line + 1, mark.column + 1, str(problem), problem.where, is_scalar)

    def _read_document(self) -> object:
        next(self._events)
        event = next(self._events)
        if isinstance(event, yaml.StreamEndEvent):
            self._fail(event, "the file is empty; a world needs at least 'format: 1' and 'size: [7.0, 7.0]'")
        first = next(self._events)
        self._start = first.start_mark
        data = self._read(first)
        next(self._events)
        event = next(self._events)
        if not isinstance(event, yaml.StreamEndEvent):
            self._fail(event, "a second document ('---') begins here; put each world in a file of its own")
        return data

    def _read(self, event: Any) -> object:
        self._count += 1
        if self._count > MOST_VALUES:
            self._fail_on_excess(event, f"the file holds more than {MOST_VALUES} values; split it into several worlds")
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
            self._fail(
                event, f"'*{_short(event.anchor)}' stands inside the very thing that it stands for; write it out"
            )
        if event.anchor not in self._anchors:
            anchor = _short(event.anchor)
            self._fail(event, f"'*{anchor}' stands for nothing; mark a value before it with '&{anchor}'")
        value, size = self._anchors[event.anchor]
        self._count += size
        return value

    def _read_content(self, event: Any) -> object:
        if isinstance(event, yaml.ScalarEvent):
            return self._read_scalar(event)
        if len(self._path) > DEEPEST_NESTING:
            self._fail(event, f"lists and mappings are nested deeper than {DEEPEST_NESTING} levels; a world needs six")
        is_mapping = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, "!", _TAG + ("map" if is_mapping else "seq")):
            self._refuse_tag(event)
        return self._read_mapping() if is_mapping else self._read_list()

    def _read_list(self) -> list[object]:
        values: list[object] = []
        marks = self._marks[id(values)] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            marks.append(event.start_mark)
            self._path.append(len(values))
            if len(values) == LONGEST_COLLECTION:
                self._fail_on_excess(event, f"a list holds at most {LONGEST_COLLECTION} entries; leave some out")
            values.append(self._read(event))
            self._path.pop()
        return values

    def _read_mapping(self) -> dict[str, object]:
        values: dict[str, object] = {}
        marks = self._marks[id(values)] = {}
        merges: list[tuple[Any, object]] = []
        count = 0
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key, value_event = self._read_key(event), next(self._events)
            self._path.append(key)
            count += 1
            if count > LONGEST_COLLECTION:
                self._fail_on_excess(event, f"is one more than the {LONGEST_COLLECTION} keys that may be in one place")
            value = self._read(value_event)
            if value is None and _is_blank(value_event):
                self._report(event, "has no value; write one after the colon, or leave the key out")
                self._blank.add(tuple(self._path))
            if key == "<<":
                merges.append((event, value))
            elif key in values:
                first = marks[key][0].line + 1
                self._report(event, f"is given twice, first in line {first}; leave one of them out")
            else:
                values[key] = value
                marks[key] = (event.start_mark, value_event.start_mark)
            self._path.pop()
        for event, value in merges:
            self._merge(event, value, values, marks)
        return values

    def _read_key(self, event: Any) -> str:
        key = None
        if isinstance(event, yaml.AliasEvent):
            key = self._read_alias(event)
        elif isinstance(event, yaml.ScalarEvent):
            key = event.value
        if not isinstance(key, str):
            self._fail(event, "a key must be a word; put quotes around a key, and braces around settings")
        if len(key) > LONGEST_KEY:
            self._fail(event, f"a key has at most {LONGEST_KEY} letters, not {len(key)}; shorten it")
        return key

    def _merge(self, event: Any, source: object, values: dict[str, object], marks: dict[str, Any]) -> None:
        """YAML's merge key ``<<``: fills in what ``values`` lacks from one mapping or several, earlier ones first."""
        for mapping in source if isinstance(source, list) else [source]:
            if not isinstance(mapping, dict):
                self._report(event, "'<<' takes an alias of a mapping such as '*post', or a list of such aliases")
                return
            for key, value in mapping.items():
                if key not in values:
                    values[key] = value
                    marks[key] = self._marks[id(mapping)][key]

    def _read_scalar(self, event: Any) -> object:
        tag = event.tag
        if (tag is None and event.implicit[0]) or tag in _RESOLVED_TAGS:
            return plain_scalar(event.value)
        if tag in (None, "!", _TAG + "str"):
            return event.value
        return self._refuse_tag(event)

    def _refuse_tag(self, event: Any) -> NoReturn:
        tag = _short(event.tag.replace(_TAG, "!!"))
        self._fail(
            event, f"the tag '{tag}' is not read in a world file; write plain numbers, words, lists and mappings"
        )

    def _report(self, event: Any, text: str) -> None:
        mark = event.start_mark
        where = tuple(self._path)
        if len(self.problems) == MOST_TOLD:
            rest = "what follows is not read; put the mistakes before it right first"
            self._is_excessive = True
            self._refuse([*sorted(self.problems), _Located(mark.line + 1, mark.column + 1, rest)])
        self.problems.append(_Located(mark.line + 1, mark.column + 1, str(Problem(where, text)), where))

    def _fail(self, event: Any, text: str) -> NoReturn:
        """Ends the reading: what follows cannot be understood."""
        self._report(event, text)
        self.refuse([])

    def _fail_on_excess(self, event: Any, text: str) -> NoReturn:
        self._is_excessive = True
        self._fail(event, text)

    def _fail_on_syntax(self, error: yaml.YAMLError) -> NoReturn:
        line, column, found = 1, 1, str(getattr(error, "reason", error))
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            line, column = error.problem_mark.line + 1, error.problem_mark.column + 1
            lines = text_lines(self._text)
            if line > len(lines):  # the end of a text without a last line break is taken for a line of its own
                line, column = len(lines), len(lines[-1]) + 1
            found = " ".join(filter(None, (error.problem, error.context)))
            if error.context and error.context_mark is not None:
                found += f" that begins in line {error.context_mark.line + 1}"
            indentation = lines[line - 1][: -len(lines[line - 1].lstrip()) or None]
            if "\t" in indentation:
                place = indentation.index("\t") + 1
                self.problems.append(_Located(line, place, "not YAML: a tab; YAML is indented with spaces"))
                self.refuse([])
        elif (unreadable := _UNREADABLE.search(self._text)) is not None:
            begin = unreadable.start()
            line = self._text.count("\n", 0, begin) + 1
            column = begin - self._text.rfind("\n", 0, begin)
            text = f"not YAML: the control character U+{ord(unreadable[0]):04X}, which is not shown; remove it"
            self.problems.append(_Located(line, column, text))
            self.refuse([])
        remedy = "check the brackets, quotes, colons and indentation before this place"
        self.problems.append(_Located(line, column, f"not YAML: {found}; {remedy}"))
        self.refuse([])


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}…"


def _is_blank(event: Any) -> bool:
    return isinstance(event, yaml.ScalarEvent) and not event.value and event.implicit[0] and event.anchor is None


def plain_scalar(text: str) -> object:
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
