"""Changes to a world file that leave the author's text alone, but for the words that have to change.

An edit names an entry and what it shall say. The text of a number is replaced where it stands; a setting that is new
is written where such files have it; whatever an entry gets from an alias or a merge key is overridden in the entry
itself. Every other character, comments and blanks included, stays as it was. After each edit the text is read again:
one that would not say what was meant, nothing more and nothing less, is refused.

>>> text = "format: 1\\nsize: [4.0, 4.0]   # a closet\\nobstacles:\\n  - cylinder: {at: [1.0, 0.5], radius: 0.2, height: 1}\\n"
>>> print(patched(text, [{"op": "set", "where": ["obstacles", 0], "values": {"at": [1.25, 0.5]}}]), end="")
format: 1
size: [4.0, 4.0]   # a closet
obstacles:
  - cylinder: {at: [1.25, 0.5], radius: 0.2, height: 1}
"""  # noqa: E501

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import yaml

from navsim.editor.yamltree import Node, Tree
from navsim.worldfile import plain_scalar

LISTS = ("obstacles", "starts", "goals")
"""The keys of a world whose entries can be added and removed."""
DECIMALS = 6
"""Digits that are written after the point: micrometres. What is moved by hand is rounded further, where it is moved."""
DEEPEST_VALUE = 8
"""Lists and mappings inside one another in a new value; a world's settings need four."""

_KEY_ORDER = (
    ["<<", "format", "name", "size", "walls", "obstacles", "starts", "goals"],
    ["<<", "name", "at", "points", "size", "radius", "base", "height", "yaw_deg", "motion", "pushable"],
)
"""Of a world and of its entries: where a new key goes."""
_PLAIN_WORDS = re.compile(r"[^\W\d_](?:[\w ().+/-]*[\w).+/-])?")
"""Text that needs no quotes wherever it stands."""


class EditError(ValueError):
    """An edit that cannot be made; the message says why in a sentence."""


class _Change(NamedTuple):
    """``text[start:end]`` becomes ``new``."""

    start: int
    end: int
    new: str


def patched(text: str, edits: Sequence[Mapping[str, Any]]) -> str:
    """``text`` after ``edits``, one after the other.

    Args:
        text: of a world file; it must be readable (:func:`navsim.editor.reading.read_world` gives a world for it), but
            may break geometric rules. A byte order mark stays.
        edits: each is one of

            - ``{"op": "set", "where": ["obstacles", 2], "values": {"at": [1.0, 2.0]}}``: gives the entry's settings new
              values; None takes a setting out, with the comment on its line. ``where: []`` is the world itself, with
              keys such as ``size``.
            - ``{"op": "add", "list": "goals", "entry": [1.0, 2.0], "index": 3}``: puts an entry into a list, at its end
              unless ``index`` says where. A list that is missing or ``random`` is begun.
            - ``{"op": "remove", "where": ["starts", 0]}``: takes an entry out, with the comment on its line. The last
              start or goal makes way for ``random``.

    Returns:
        the new text.

    Raises:
        EditError: for an edit of another form, or one that the text offers no place for.
    """
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    text = text.removeprefix("\ufeff")
    for edit in edits:
        text = _edited(text, edit)
    return mark + text


def dependants(tree: Tree, where: Sequence[Any]) -> list[tuple[Any, ...]]:
    """What else changes with the value at ``where`` because it is, or holds, an alias of something inside it.

    Args:
        tree: a text.
        where: an entry such as ``("obstacles", 2)``, or a key of the world such as ``("size",)``.

    Returns:
        entries and keys, in the same form.
    """
    places = {place: node for place, node in _places(tree) if not (place[0] == where[0] and len(place) != len(where))}
    node = places.get(tuple(where))
    if node is None:  # it stands in a merge key and cannot be changed here
        return []
    return [
        place for place, other in places.items() if place != tuple(where) and (other is node or _reaches(other, node))
    ]


def _places(tree: Tree) -> Iterator[tuple[tuple[Any, ...], Node]]:
    for key, value in tree.root.pairs:
        if key.key not in LISTS or value.meant.kind != "list":
            yield (key.key,), value
    for name, i, item in entries(tree):
        yield (name, i), item


def entries(tree: Tree) -> Iterator[tuple[str, int, Node]]:
    """Every entry of the lists of obstacles, starts and goals: name of the list, place in it, node."""
    for name in LISTS:
        values = tree.root.own(name)
        for i, item in enumerate(values.meant.items if values is not None else ()):
            yield name, i, item


def _reaches(node: Node, other: Node) -> bool:
    return any(
        below.target is not None
        and (other.start <= below.target.start < max(other.end, other.start + 1) or _reaches(below.target, other))
        for below in node.walk()
    )


def _edited(text: str, edit: Mapping[str, Any]) -> str:
    tree = Tree(text)
    if not isinstance(edit, Mapping) or edit.get("op") not in ("set", "add", "remove"):
        raise EditError("an edit is a mapping whose 'op' is 'set', 'add' or 'remove'")
    data = tree.root.data()
    if edit["op"] == "add":
        where, changes = _add(tree, data, edit)
    elif edit["op"] == "remove":
        where, changes = _remove(tree, data, edit)
    else:
        where, changes = _set(tree, data, edit)
    new = _applied(text, changes)
    try:
        if edit["op"] == "set":
            new = _with_own_values(new, edit, data)
        is_as_meant = _says(Tree(new).root.data(), data, tree, edit)
    except (yaml.YAMLError, KeyError, AttributeError, TypeError):
        is_as_meant = False
    if not is_as_meant:
        line = _line(tree, where)
        raise EditError(f"the way in which line {line} is written leaves no place for this change; make it in the text")
    return new


def _set(tree: Tree, data: Any, edit: Mapping[str, Any]) -> tuple[list[Any], list[_Change]]:
    where, values = edit.get("where"), edit.get("values")
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise EditError("'values' of an edit must be a mapping from settings to their values")
    values = {key: None if value is None else _checked(value) for key, value in values.items()}
    if where == []:
        intended = _updated(data, values)
        changes = [*_write(tree, tree.root, intended, 0)]
        data.clear()
        data.update(intended)
        return [], changes
    node, (name, i) = _entry(tree, where)
    if name == "obstacles":
        ((kind, settings),) = data[name][i].items()
        intended = {kind: _updated(settings, values)}
    else:
        place = data[name][i]
        settings = _updated(place if isinstance(place, dict) else {"at": place}, values)
        intended = settings["at"] if settings.keys() == {"at"} and isinstance(place, list) else settings
    data[name][i] = intended
    if tree.root.own(name).target is not None:  # type: ignore[union-attr]
        return [name, i], [*_write(tree, tree.root.own(name), data[name], 1)]  # type: ignore[arg-type]
    return [name, i], [*_write(tree, node, intended, 1)]


def _with_own_values(text: str, edit: Mapping[str, Any], intended: Mapping[str, Any]) -> str:
    """``text`` in which what was set holds no alias that has changed with it: others may follow, itself may not."""
    for _ in range(text.count("*")):  # each time, there is an alias less
        tree = Tree(text)
        if edit["where"]:
            node, (name, i) = _entry(tree, edit["where"])
            changes = [*_write(tree, node, intended[name][i], 1)]
        else:
            values = [(tree.root.own(key), intended[key]) for key in edit["values"] if key in intended]
            changes = [change for own, value in values if own is not None for change in _write(tree, own, value, 1)]
        if not changes:
            break
        text = _applied(text, changes)
    return text


def _add(tree: Tree, data: Any, edit: Mapping[str, Any]) -> tuple[list[Any], list[_Change]]:
    name, entry = edit.get("list"), _rounded(_checked(edit.get("entry")), None)
    if name not in LISTS:
        raise EditError(f"'list' of an edit must be one of {', '.join(LISTS)}")
    if entry in (None, [], {}):
        raise EditError("'entry' of an edit must be what shall be added")
    present = data.get(name)
    before = list(present) if isinstance(present, list) else []
    index = edit.get("index", len(before))
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index <= len(before):
        raise EditError(f"'index' of an edit must be a place in the list, 0 to {len(before)}")
    data[name] = [*before[:index], entry, *before[index:]]
    values = tree.root.own(name)
    if values is None:
        return [name, index], [*_insert_pair(tree, tree.root, name, data[name], 0)]
    if values.kind == "list" and values.items:
        return [name, index], [*_insert_item(tree, values, index, entry), *_unshare(tree, values)]
    if values.kind == "alias" or not tree.ends_line(values.end) or tree.root.flow:
        return [name, index], [*_write(tree, values, data[name], 1)]
    # `[]` or `random` makes way for a list below its key; a comment stays beside the key.
    start = values.start
    while tree.text[start - 1] == " ":
        start -= 1
    line = f"{tree.line_break}  - {_flow(entry, tree)}"
    changes = [_Change(start, values.end, ""), _insertion(tree.line_end(values.end), line)]
    return [name, index], [*changes, *_rescue_anchors(tree, values)]


def _remove(tree: Tree, data: Any, edit: Mapping[str, Any]) -> tuple[list[Any], list[_Change]]:
    node, (name, i) = _entry(tree, edit.get("where"))
    values = tree.root.own(name)
    assert values is not None
    rest = data[name][:i] + data[name][i + 1 :]
    data[name] = rest if rest or name == "obstacles" else "random"
    if values.target is not None:
        return [name], [*_write(tree, values, data[name], 1)]
    changes = [*_unshare(tree, values)]
    is_shared = bool(changes)
    changes = changes or [*_rescue_anchors(tree, node)]
    if not rest and name != "obstacles" and values.flow:
        return [name], [*_write(tree, values, "random", 1)]
    changes += _remove_item(tree, values, i, [(item.start, item.end) for item in values.items])
    if not rest and not values.flow:
        key = next(key for key, value in tree.root.pairs if value is values)
        colon = tree.find(":", key.end, values.start)
        if values.anchor and not is_shared:
            changes.append(_Change(values.start, values.start + 1 + len(values.anchor), ""))
        changes.append(_insertion(colon + 1, " []" if name == "obstacles" else " random"))
    return [name], changes


def _entry(tree: Tree, where: Any) -> tuple[Node, tuple[str, int]]:
    if isinstance(where, (list, tuple)) and len(where) == 2 and where[0] in LISTS and type(where[1]) is int:
        values = tree.root.own(where[0])
        items = values.meant.items if values is not None else []
        if 0 <= where[1] < len(items):
            return items[where[1]], (where[0], where[1])
        if values is None and where[0] in tree.root.data():
            raise EditError(f"'{where[0]}' comes from a merge key ('<<') here; change it in the text")
        raise EditError(f"there is no {where[0]}[{where[1]}] in the text; it has {len(items)} of them")
    raise EditError("'where' of an edit must be an entry such as ['obstacles', 2], or [] for the world")


def _updated(settings: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    new = {key: _rounded(value, settings.get(key)) for key, value in values.items()}
    return {key: value for key, value in {**settings, **new}.items() if value is not None}


def _checked(value: Any, depth: int = 0) -> Any:
    """``value``, if it is something that can stand in a world file."""
    if depth > DEEPEST_VALUE:
        raise EditError(f"a value is nested deeper than {DEEPEST_VALUE} levels; a world's settings need four")
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, (int, float)):
        if not math.isfinite(value) or abs(value) > 1e15:
            raise EditError(f"{value!r} cannot stand in a world file; give a finite number")
        return value
    if isinstance(value, str):
        if any(0xD800 <= ord(sign) < 0xE000 for sign in value):
            raise EditError("a text holds half a character (a lone surrogate); leave it out")
        return value
    if isinstance(value, (list, tuple)):
        return [_checked(item, depth + 1) for item in value]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: _checked(item, depth + 1) for key, item in value.items()}
    raise EditError(f"{value!r} cannot stand in a world file; give numbers, words, lists and mappings")


def _rounded(value: Any, present: Any) -> Any:
    """``value`` with numbers of ``DECIMALS`` digits, but for those that stay as they are ``present``."""
    if isinstance(value, list):
        known = present if isinstance(present, list) else []
        if len(known) == len(value):
            return [_rounded(new, old) for new, old in zip(value, known, strict=True)]
        return [new if new in known else _rounded(new, None) for new in value]
    if isinstance(value, dict):
        known_keys = present if isinstance(present, dict) else {}
        return {key: _rounded(new, known_keys.get(key)) for key, new in value.items()}
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value == present:
        return value
    rounded = round(value, DECIMALS)
    return value if rounded == 0.0 != value else rounded + 0  # -0.0 + 0 is 0.0


def _says(new: Any, intended: Any, tree: Tree, edit: Mapping[str, Any]) -> bool:
    """Whether ``new`` is what was ``intended``, but for what shares something with the values that were set."""
    if new.keys() != intended.keys():
        return False
    touched: list[Node] = []
    if edit["op"] == "set":
        own = [tree.root.own(key) for key in edit["values"]]
        touched = [_entry(tree, edit["where"])[0]] if edit["where"] else [value for value in own if value is not None]

    def may_differ(node: Node | None) -> bool:
        return node is not None and node not in touched and any(_reaches(node, other) for other in touched)

    for key, value in intended.items():
        node = tree.root.own(key)
        if key not in LISTS or not isinstance(value, list) or not isinstance(new[key], list):
            if not _is_same(new[key], value) and not may_differ(node):
                return False
        elif len(new[key]) != len(value):
            return False
        else:
            nodes = node.meant.items if node is not None else []
            for i, (said, meant) in enumerate(zip(new[key], value, strict=True)):
                if not _is_same(said, meant) and not (i < len(nodes) and may_differ(nodes[i])):
                    return False
    return True


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_is_same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_is_same, a, b))
    return bool(a == b) and isinstance(a, bool) == isinstance(b, bool)


def _line(tree: Tree, where: Sequence[Any]) -> int:
    position = 0
    if len(where) == 2:
        values = tree.root.own(where[0])
        items = values.meant.items if values is not None else []
        position = items[min(where[1], len(items) - 1)].start if items else 0
    return len(re.findall(r"\r\n|[\n\r]", tree.text[:position])) + 1


def _insertion(position: int, text: str) -> _Change:
    return _Change(position, position, text)


def _applied(text: str, changes: Iterable[_Change]) -> str:
    parts, position = [], 0
    for start, end, new in sorted(changes, key=lambda change: (change.start, change.end)):
        if start < position:
            raise EditError("this change overlaps with another one; make it in the text")
        parts += [text[position:start], new]
        position = end
    return "".join([*parts, text[position:]])


# What a node says


def _write(tree: Tree, node: Node, value: Any, level: int) -> Iterator[_Change]:
    """The changes that make ``node`` say ``value``: none where it does.

    Args:
        tree: the text.
        node: of it.
        value: plain data.
        level: 0 for the world itself, 1 and more below.
    """
    present = node.data()
    if _is_same(present, value):
        return
    if node.target is not None:
        yield _Change(node.start, node.end, _instead_of_alias(tree, node, present, value))
    elif node.kind == "scalar" and not isinstance(value, (list, dict)):
        yield _Change(node.content, node.end, _scalar_like(tree, node, value))
    elif node.kind == "list" and isinstance(value, list) and value:
        yield from _write_list(tree, node, present, value, level)
    elif node.kind == "mapping" and isinstance(value, dict):
        yield from _write_mapping(tree, node, present, value, level)
    else:
        yield from _replace(tree, node, value)


def _write_list(tree: Tree, node: Node, present: list[Any], value: list[Any], level: int) -> Iterator[_Change]:
    if len(present) == len(value):
        for item, new in zip(node.items, value, strict=True):
            yield from _write(tree, item, new, level + 1)
        return
    fewest = min(len(present), len(value))
    same = itertools.takewhile(lambda i: _is_same(present[i], value[i]), range(fewest))
    head = sum(1 for _ in same)
    rest = fewest - head
    tail = sum(1 for _ in itertools.takewhile(lambda i: _is_same(present[-1 - i], value[-1 - i]), range(rest)))
    if len(value) == len(present) + 1 and head + tail == len(present):
        yield from _insert_item(tree, node, head, value[head])
    elif len(value) == len(present) - 1 and head + tail == len(value):
        yield from _rescue_anchors(tree, node.items[head])
        yield from _remove_item(tree, node, head, [(item.start, item.end) for item in node.items])
    else:
        yield from _replace(tree, node, value)


def _write_mapping(
    tree: Tree, node: Node, present: Mapping[str, Any], value: Mapping[str, Any], level: int
) -> Iterator[_Change]:
    for key in present:
        if key not in value:
            position = next((i for i, (name, _) in enumerate(node.pairs) if name.key == key), None)
            if position is None:
                raise EditError(f"'{key}' comes from a merge key ('<<') here; take it out in the text")
            yield from _rescue_anchors(tree, node.pairs[position][1])
            yield from _remove_item(tree, node, position, [(name.start, item.end) for name, item in node.pairs])
    for key, new in value.items():
        own = node.own(key)
        if own is not None:
            yield from _write(tree, own, new, level + 1)
        elif not _is_same(present.get(key), new) or key not in present:
            yield from _insert_pair(tree, node, key, new, level)


def _instead_of_alias(tree: Tree, node: Node, present: Any, value: Any) -> str:
    """What takes the place of an alias that shall say something else: the alias, merged, and what differs."""
    if node.meant.kind != "mapping" or not isinstance(value, dict) or not present.keys() <= value.keys():
        return _flow(value, tree)
    if not all(re.fullmatch(r"[a-z_]+", key) for key in value):
        return _flow(value, tree)
    if len(present) == 1 and isinstance(next(iter(present.values())), dict):  # a whole entry: {box: {…}}
        return _flow(value, tree)
    differing = {key: new for key, new in value.items() if key not in present or not _is_same(present[key], new)}
    return "{<<: " + tree.text[node.start : node.end] + ", " + _flow(differing, tree)[1:]


def _replace(tree: Tree, node: Node, value: Any) -> Iterator[_Change]:
    """Writes ``node`` anew; comments inside it move behind it."""
    at = value.get("at") if isinstance(value, dict) else None
    if node.kind == "list" and node.flow and isinstance(at, list) and len(at) == len(node.items):
        others = {key: new for key, new in value.items() if key != "at"}
        yield _insertion(node.start, "{at: ")
        yield from _write(tree, node, at, 2)
        yield _insertion(node.end, ", " + _flow(others, tree)[1:])
        return
    yield from _rescue_anchors(tree, node)
    comments = _comments_inside(tree, node)
    if tree.ends_line(node.end):
        yield _Change(node.start, node.end, _flow(value, tree))
        yield _insertion(tree.line_end(node.end), "".join(f"  {comment}" for comment in comments))
    else:
        go_on = tree.line_break + " " * tree.column(node.content)
        behind = "".join(f"  {comment}{go_on}" for comment in comments)
        yield _Change(node.start, node.end, _flow(value, tree) + behind)


def _comments_inside(tree: Tree, node: Node) -> list[str]:
    leaves = [below for below in node.walk() if not below.children]
    ends = [node.start, *(leaf.end for leaf in leaves)]
    starts = [*(leaf.start for leaf in leaves), node.end]
    gaps = (tree.text[end:start] for end, start in zip(ends, starts, strict=True))
    return [comment for gap in gaps for comment in re.findall(r"#[^\n\r\x85\u2028\u2029]*", gap)]


# Pairs and items


def _insert_pair(tree: Tree, node: Node, key: str, value: Any, level: int) -> Iterator[_Change]:
    order = _KEY_ORDER[min(level, 1)]
    rank = order.index(key) if key in order else len(order)
    before = [
        i for i, (name, _) in enumerate(node.pairs) if (order.index(name.key) if name.key in order else -1) < rank
    ]
    quoted = bool(node.pairs) and node.pairs[0][0].style == '"'
    name = f'"{key}"' if quoted else key
    if not node.pairs:
        yield _insertion(node.content + 1, f"{name}: {_flow(value, tree, key)}")
    elif node.flow:
        pair = f"{name}: {_flow(value, tree, key)}"
        if before:
            yield _insertion(node.pairs[before[-1]][1].end, f", {pair}")
        else:
            yield _insertion(node.pairs[0][0].start, f"{pair}, ")
    else:
        column = tree.column(node.pairs[0][0].start)
        pair = f"{name}: {_flow(value, tree, key)}"
        if level == 0 and isinstance(value, list) and key in LISTS:
            pair = f"{name}:" + "".join(f"{tree.line_break}  - {_flow(entry, tree)}" for entry in value)
        if before:
            end = tree.line_end(node.pairs[before[-1]][1].end)
            blank = tree.line_break if level == 0 and key in LISTS else ""
            yield _insertion(end, blank + tree.line_break + " " * column + pair)
        else:
            yield _insertion(node.pairs[0][0].start, pair + tree.line_break + " " * column)


def _insert_item(tree: Tree, node: Node, index: int, value: Any) -> Iterator[_Change]:
    items = node.items
    if node.flow:
        text = _flow(value, tree)
        if not items:
            yield _insertion(node.content + 1, text)
        elif index == 0:
            yield _insertion(items[0].start, f"{text}, ")
        elif tree.is_first_on_line(items[index - 1].start):
            yield from _insert_line(tree, node, index, text)
        else:
            yield _insertion(items[index - 1].end, f", {text}")
        return
    starts = [node.content, *(tree.find("-", a.end, b.start) for a, b in itertools.pairwise(items))]
    indent = tree.line_break + " " * tree.column(starts[0])
    like = items[index - 1] if index else items[0]
    text = _item_like(tree, like, starts[items.index(like)], value)
    if index:
        yield _insertion(tree.line_end(items[index - 1].end), f"{indent}- {text}")
    else:
        yield _insertion(starts[0], f"- {text}{indent}")


def _insert_line(tree: Tree, node: Node, index: int, text: str) -> Iterator[_Change]:
    """An item of a list in brackets, on a line of its own as the one before it."""
    before = node.items[index - 1]
    after = node.items[index].start if index < len(node.items) else node.end - 1
    indent = tree.line_break + " " * tree.column(before.start)
    comma = tree.find(",", before.end, after)
    if comma >= 0 and tree.ends_line(comma + 1):
        yield _insertion(tree.line_end(comma), f"{indent}{text},")
    elif comma < 0 and tree.ends_line(before.end):
        yield _insertion(before.end, ",")
        yield _insertion(tree.line_end(before.end), indent + text)
    else:
        yield _insertion(before.end, f", {text}")


def _item_like(tree: Tree, like: Node, dash: int, value: Any) -> str:
    """The text of an item of a block list, in the style of ``like``, its neighbour, whose dash stands at ``dash``."""
    shape = like.meant
    if not (isinstance(value, dict) and shape.kind == "mapping" and shape.pairs) or like.target is not None:
        return _flow(value, tree)
    if shape.flow:
        return _flow(value, tree)
    column = tree.column(dash) + 2
    lines = []
    for key, new in value.items():
        neighbour, settings = shape.pairs[0]
        if isinstance(new, dict) and settings.kind == "mapping" and not settings.flow:
            inner = tree.column(settings.content) if tree.column(settings.content) > column else column + 2
            below = (f"{name}: {_flow(item, tree, name)}" for name, item in new.items())
            lines.append(f"{key}:" + "".join(tree.line_break + " " * inner + line for line in below))
        else:
            pad = settings.content - neighbour.start if isinstance(new, dict) and settings.kind == "mapping" else 0
            is_aligned = pad > len(neighbour.text) + 2 and tree.text[settings.content] == "{"
            lines.append(f"{key}:".ljust(pad if is_aligned else len(key) + 2) + _flow(new, tree, key))
    return (tree.line_break + " " * column).join(lines)


def _remove_item(tree: Tree, node: Node, index: int, spans: Sequence[tuple[int, int]]) -> Iterator[_Change]:
    """Takes an item out of a list, or a pair out of a mapping.

    Args:
        tree: the text.
        node: the list or the mapping.
        index: of the item.
        spans: where each item or pair begins and ends.
    """
    start, end = spans[index]
    if node.flow:
        yield from _remove_from_brackets(tree, node, index, spans)
        return
    if node.kind == "list":
        start = node.content if index == 0 else tree.find("-", spans[index - 1][1], start)
    if tree.is_first_on_line(start):
        begin, stop = tree.line_start(start), tree.next_line(end)
        if stop == len(tree.text) and begin > 0 and not re.search(r"[\n\r\x85\u2028\u2029]\Z", tree.text):
            begin = _before_break(tree, begin)
        yield _Change(begin, stop, "")
    elif index + 1 < len(spans):
        following = spans[index + 1][0]
        if node.kind == "list":
            following = tree.find("-", end, following)
        if tree.has_comment(tree.line_end(end), following):
            while tree.text[start - 1] == " ":
                start -= 1
            yield _Change(start, tree.line_end(end), "")
        else:
            yield _Change(start, following, "")
    else:
        raise EditError("nothing would be left here; make this change in the text")


def _before_break(tree: Tree, line_start: int) -> int:
    """Where the line break begins that ends before ``line_start``."""
    position = line_start - 1
    return position - 1 if tree.text[max(position - 1, 0) : position + 1] == "\r\n" else position


def _remove_from_brackets(tree: Tree, node: Node, index: int, spans: Sequence[tuple[int, int]]) -> Iterator[_Change]:
    start, end = spans[index]
    if index > 0:
        comma = tree.find(",", spans[index - 1][1], start)
        gap = (spans[index - 1][1], start)
        whole = (gap[0], end)
    else:
        following = spans[1][0] if len(spans) > 1 else node.end - 1
        comma = tree.find(",", end, following)
        gap = (end, following)
        whole = (start, following if comma >= 0 else end)
    if "#" in tree.text[slice(*gap)] or _BREAKS.search(tree.text[slice(*gap)]):
        if comma >= 0:
            yield _Change(comma, comma + 1, "")
        yield _Change(start, end, "")
    else:
        yield _Change(*whole, "")


_BREAKS = re.compile(r"[\n\r\x85\u2028\u2029]")


def _rescue_anchors(tree: Tree, removed: Node) -> Iterator[_Change]:
    """Moves what ``removed`` has anchors for to where it is first used outside."""
    moved: set[Node] = set()
    for node in tree.root.walk():
        is_outside = not removed.start <= node.start < removed.end
        if node.target is None or not is_outside or not removed.start <= node.target.start < removed.end:
            continue
        if node.target not in moved:
            yield _Change(node.start, node.end, _with_anchors(tree, node.target, moved))


def _unshare(tree: Tree, values: Node) -> Iterator[_Change]:
    """Makes a list the one of its key alone, if it is some other key's as well: entries are to come or go here only."""
    if any(node.target is values for node in tree.root.walk()):
        yield _Change(values.start, values.start + 1 + len(values.anchor or ""), "")
        yield from _rescue_anchors(tree, values)


def _with_anchors(tree: Tree, node: Node, moved: set[Node]) -> str:
    """``node`` in flow style, with its anchors; what ``moved`` holds already becomes an alias."""
    if node.target is not None:
        return tree.text[node.start : node.end] + " "
    if node in moved:
        return f"*{node.anchor} "
    prefix = f"&{node.anchor} " if node.anchor else ""
    if node.anchor:
        moved.add(node)
    if node.kind == "list":
        return prefix + "[" + ", ".join(_with_anchors(tree, item, moved) for item in node.items) + "]"
    if node.kind == "mapping":
        pairs = (f"{_with_anchors(tree, k, moved)}: {_with_anchors(tree, v, moved)}" for k, v in node.pairs)
        return prefix + "{" + ", ".join(pairs) + "}"
    if node.is_text or isinstance(plain_scalar(node.text), str):
        return prefix + ("<<" if node.text == "<<" else _text(node.text))
    return prefix + node.text


# How values are written


def _scalar_like(tree: Tree, node: Node, value: Any) -> str:
    """``value`` in the style of the scalar whose place it takes."""
    if isinstance(value, bool) or value is None:
        return _flow(value, tree)
    if isinstance(value, (int, float)):
        is_number = not node.is_text and isinstance(plain_scalar(node.text), (int, float))
        if tree.text[node.start : node.content].strip().endswith(("!!float", "!!int", "!!str")):
            raise EditError("a tag such as '!!float' stands before the value; make this change in the text")
        return _number(value, bool(re.search(r"[.eE]", node.text)) if is_number else tree.writes_decimals)
    if node.style == "'" and value.isprintable():
        return "'" + value.replace("'", "''") + "'"
    return _quoted(value) if node.style in ('"', "'") else _text(value)


def _flow(value: Any, tree: Tree, key: str = "") -> str:
    """``value`` on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_text(name)}: {_flow(item, tree, name)}" for name, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item, tree, key) for item in value) + "]"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return _number(value, tree.writes_decimals and key not in ("yaw_deg", "format"))


def _number(value: float, with_decimals: bool) -> str:
    if float(value).is_integer():
        return f"{int(value)}.0" if with_decimals else f"{int(value)}"
    text = f"{value:.{DECIMALS}f}".rstrip("0")
    return text if float(text) == value else repr(value)


def _text(value: str) -> str:
    is_plain = _PLAIN_WORDS.fullmatch(value) and value.isprintable() and isinstance(plain_scalar(value), str)
    return value if is_plain else _quoted(value)


def _quoted(value: str) -> str:
    """In double quotes, on one line."""
    text = yaml.dump(value, Dumper=yaml.SafeDumper, default_style='"', width=2**31 - 1, allow_unicode=True)
    return text.rstrip("\n")
