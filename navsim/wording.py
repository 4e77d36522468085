"""How mistakes in a world are told to its author: what is wrong, and what to write instead."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from navsim.errors import Problem

EXAMPLES = {
    "format": "1",
    "size": "[7.0, 7.0]",
    "box.size": "[0.6, 0.4]",
    "walls": "{height: 2.0, thickness: 0.1}",
    "at": "[0.0, 0.0]",
    "height": "0.5",
    "radius": "0.2",
    "points": "[[0, 0], [1, 0], [0.4, 0.8]]",
    "path": "[[2, 2], [2, -2]]",
    "speed": "0.5",
    "hinge": "[1.0, 0.0]",
    "swing_deg": "[0, 90]",
    "speed_deg": "45",
    "mass": "0.35",
    "obstacles": "'- box: {at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8}'",
    "box": "{at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8}",
    "cylinder": "{at: [-1.0, 1.2], radius: 0.15, height: 0.3}",
    "polygon": "{points: [[0, 0], [1, 0], [0.4, 0.8]], height: 1.0}",
    "starts": "{at: [0.0, 0.0], yaw_deg: 90} or [0.0, 0.0]",
    "goals": "[2.0, -2.5]",
    "motion": "{path: [[2, 2], [2, -2]], speed: 0.5} or {hinge: [1, 0], swing_deg: [0, 90], speed_deg: 45}",
    "pushable": "{mass: 0.35}",
    "friction": "0.4",
}
"""What may stand after a key, for the remedies of error messages."""

_LESS = {
    "points": "leave out those that matter least, or cut the polygon into several",
    "obstacles": "split the world into several",
}
"""What to do about a list that is too long."""


@dataclass(frozen=True)
class Wording:
    """Tells the mistakes that pydantic found in a world in the words of somebody who writes world files."""

    models: Mapping[str, type[BaseModel]]
    """Whose keys are known below each key; under ``""`` that of the file itself."""
    shapes: Sequence[str]
    """The keys of which an obstacle has one."""

    def problems(self, details: Iterable[Mapping[str, Any]], data: object) -> list[Problem]:
        """pydantic's errors in the words of somebody who writes world files."""
        located = [(_path_in(data, detail["loc"]), detail) for detail in details]
        misspelt = {
            (*where[:-1], meant)
            for where, detail in located
            if detail["type"] == "extra_forbidden"
            for meant in _nearest(where[-1], self._known_keys(where[:-1], detail["loc"]))
        }
        bare = {
            (key,): Problem((key,), f"must be a list of places, such as [{shown(data[key])}], not {shown(data[key])}")
            for key in ("starts", "goals")
            if isinstance(data, Mapping) and _is_a_place(data.get(key))
        }
        return [
            *bare.values(),
            *(
                self._word(where, detail)
                for where, detail in located
                if where[:1] not in bare
                and (detail["type"] != "missing" or (*where, detail["loc"][-1]) not in misspelt)
            ),
        ]

    def _word(self, where: tuple[str | int, ...], detail: Mapping[str, Any]) -> Problem:
        kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
        text = shown(value)
        example = EXAMPLES.get(next((str(part) for part in reversed(where) if isinstance(part, str)), ""), "")
        if kind == "missing":
            key = detail["loc"][-1]
            if isinstance(key, int):
                return Problem(where, f"must be two numbers, not {text}")
            fitting = EXAMPLES.get(f"{where[-1]}.{key}" if where else key, EXAMPLES[key])
            return Problem(where, f"key '{key}' is missing; add '{key}: {fitting}'")
        if kind == "extra_forbidden":
            known = self._known_keys(where[:-1], detail["loc"])
            meant = _nearest(where[-1], known)
            remedy = f"did you mean '{meant[0]}'?" if meant else f"the keys here are {', '.join(known)}"
            return Problem(where, f"is not a known key; {remedy}", at_key=True)
        if kind == "union_tag_not_found":
            return self._word_shape(where, value)
        if kind == "value_error":
            return Problem(where, str(context["error"]))
        if kind == "finite_number":
            return Problem(where, f"must be a finite number, not {text}")
        if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
            return Problem(where, f"{_range(kind, context, value)}, not {text}")
        if kind == "float_type":
            return Problem(
                where, f"must be a number, not {text}" if not _is_integer(value) else "is too large a number"
            )
        if kind == "too_long" and context["max_length"] > 2:
            what = {
                "points": "corners",
                "path": "points",
                "obstacles": "obstacles",
                "starts": "starts",
                "goals": "goals",
            }
            limit = f"must be at most {context['max_length']} {what[str(where[-1])]}, not {len(value)}"
            return Problem(where, f"{limit}; {_LESS.get(str(where[-1]), 'leave some of them out')}")
        if kind == "string_too_long":
            return Problem(where, f"must be at most {context['max_length']} letters long, not {len(value)}; shorten it")
        if kind in ("tuple_type", "too_short", "too_long"):
            fewest = {"points": "a list of three points or more", "path": "a list of two points or more"}
            if where[-1] in fewest:
                return Problem(where, f"must be {fewest[str(where[-1])]}, such as {example}, not {text}")
            return Problem(where, f"must be two numbers, such as [1.0, 2.0], not {text}")
        if kind == "invalid_key":
            return Problem(where[:-1] if where and where[-1] == value else where, f"a key must be a word, not {text}")
        if kind in ("string_type", "string_unicode"):
            remedy = "give one or leave the key out" if value is None else "put it in quotes"
            return Problem(where, f"must be text, not {text}; {remedy}")
        if kind == "string_too_short":
            return Problem(where, "is empty; write a name or leave the key out")
        if kind == "literal_error":
            return Problem(where, f"must be {context['expected']}, not {text}")
        return Problem(where, f"must be settings such as {example}, not {text}")

    def _word_shape(self, where: tuple[str | int, ...], entry: object) -> Problem:
        """What is wrong with an entry of ``obstacles`` that is not one shape."""
        if not isinstance(entry, Mapping) or not entry:
            return Problem(where, f"must be a shape such as {EXAMPLES['obstacles']}, not {shown(entry)}")
        shapes = [key for key in entry if key in self.shapes]
        if len(shapes) > 1:
            return Problem(
                where, f"holds {' and '.join(map(repr, shapes))}; give each shape a list entry ('- ') of its own"
            )
        if shapes:
            remedy = f"indent them below it, as in '{shapes[0]}: {EXAMPLES[shapes[0]]}'"
            return Problem(where, f"has keys beside '{shapes[0]}'; {remedy}")
        key = next(iter(entry))
        meant = _nearest(key, list(self.shapes))
        remedy = f"did you mean '{meant[0]}'?" if meant else f"write one of them first, as in {EXAMPLES['obstacles']}"
        return Problem((*where, key), f"is not a shape ({', '.join(self.shapes)}); {remedy}", at_key=True)

    def _known_keys(self, where: tuple[str | int, ...], location: tuple[str | int, ...] = ()) -> list[str]:
        """The keys of the mapping at ``where``; pydantic's ``location`` tells one kind of motion from the other."""
        name = next((part for part in reversed(where) if isinstance(part, str)), "")
        if name == "motion" and "a swing" in location:
            name = "swing"
        return list(self.models.get(name, self.models[""]).model_fields)


def _is_a_place(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(isinstance(number, int | float) for number in value)


def _range(kind: str, context: Mapping[str, Any], value: float) -> str:
    if kind == "less_than_equal":
        return f"must be at most {context['le']:g}"
    if kind == "greater_than":
        return f"must be greater than {context['gt']:g}"
    return "must be greater than 0" if value <= 0.0 < context["ge"] else f"must be at least {context['ge']:g}"


def _path_in(data: object, location: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """The part of pydantic's ``location`` that names keys and positions of ``data`` itself."""
    where: list[str | int] = []
    for part in location:
        keys: Any = data if isinstance(data, Mapping) else range(len(data)) if isinstance(data, (list, tuple)) else ()
        if part in keys:
            data = data[part]  # type: ignore[index]
            where.append(part)
    return tuple(where)


def _nearest(key: object, known: list[str]) -> list[str]:
    """The known key that ``key`` probably stands for: a list of one, or an empty one."""
    return difflib.get_close_matches(str(key).lower(), known, n=1, cutoff=0.6)


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def shown(value: object) -> str:
    """``value`` as it reads in a message: short, and on one line."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    return _REPR.repr(value)


_REPR = reprlib.Repr()
_REPR.maxdict, _REPR.maxlist, _REPR.maxtuple, _REPR.maxlevel = 3, 4, 4, 3
_REPR.maxstring, _REPR.maxlong, _REPR.maxother = 40, 24, 40
