"""Worlds as plain data, and the same worlds written down in every style that YAML has."""

from __future__ import annotations

import json
import math
import random
import re

from hypothesis import strategies as st

from navsim.worldfile import plain_scalar

lengths = st.integers(1, 3000).map(lambda mm: mm / 1000) | st.integers(1, 3).map(float)
coordinates = st.integers(-3000, 3000).map(lambda mm: mm / 1000) | st.integers(-3, 3)
points = st.tuples(coordinates, coordinates).map(list)
degrees = st.integers(-1800, 1800).map(lambda tenths: tenths / 10) | st.sampled_from([90, 45, -30])
names = st.sampled_from(
    ["sofa", "table leg 1", "Stühle: zwei", "no", "1e3", "a #b", "d'or", '"', "椅子", "😀 leg", "true"]
)


@st.composite
def outlines(draw) -> list[list[float]]:
    """Corners of a polygon that is seen whole from its middle, so that it does not cross itself."""
    count = draw(st.integers(3, 6))
    radii = draw(st.lists(st.integers(300, 900), min_size=count, max_size=count))
    turns = (2 * math.pi * i / count for i in range(count))
    return [
        [round(r / 1000 * math.cos(t), 3), round(r / 1000 * math.sin(t), 3)] for r, t in zip(radii, turns, strict=True)
    ]


@st.composite
def shapes(draw) -> dict[str, dict]:
    """An entry of ``obstacles``."""
    kind = draw(st.sampled_from(["box", "cylinder", "polygon"]))
    settings = {"name": draw(names)} if draw(st.booleans()) else {}
    if kind == "polygon":
        settings["points"] = draw(outlines())
    else:
        settings["at"] = draw(points)
        settings |= (
            {"size": draw(st.tuples(lengths, lengths).map(list))} if kind == "box" else {"radius": draw(lengths)}
        )
    settings |= {"base": draw(lengths)} if draw(st.booleans()) else {}
    settings["height"] = draw(lengths)
    if kind == "box" and draw(st.booleans()):
        settings["yaw_deg"] = draw(degrees)
    return {kind: settings}


places = points | st.fixed_dictionaries({"at": points}, optional={"yaw_deg": degrees})
place_lists = st.just("random") | st.lists(places, min_size=1, max_size=4)
goal_lists = st.just("random") | st.lists(points | st.fixed_dictionaries({"at": points}), min_size=1, max_size=4)
worlds = st.fixed_dictionaries(
    {"format": st.just(1), "size": st.just([8.0, 8])},
    optional={
        "name": names,
        "walls": st.just("none") | st.fixed_dictionaries({"height": lengths}),
        "obstacles": st.lists(shapes(), max_size=4),
        "starts": place_lists,
        "goals": goal_lists,
    },
)


class Writer:
    """Writes plain data as YAML, choosing a style for everything by chance; each comment is one of a kind.

    Args:
        chance: what chooses.
        line_break: between lines.
    """

    def __init__(self, chance: random.Random, line_break: str = "\n") -> None:
        self.chance = chance
        self.comments: list[str] = []
        self._line_break = line_break
        self._number_of_comments = 0
        self._anchors: list[tuple[object, str]] = []
        self.uses_aliases = chance.random() < 0.4
        self._commented = chance.choice([0.0, 0.2, 0.6])

    def document(self, data: dict) -> str:
        if self.chance.random() < 0.1:
            return self._flow(data, 0) + self._line_break
        lines = [*self._own_line(0), *self._block(data, 0), *self._own_line(2)]
        text = self._line_break.join(lines)
        return text + self._line_break if self.chance.random() < 0.9 else text

    def _comment(self) -> str:
        self._number_of_comments += 1
        self.comments.append(f"# c{self._number_of_comments}, é: 'x' [")
        return self.comments[-1]

    def _own_line(self, indent: int) -> list[str]:
        draw = self.chance.random()
        if draw < self._commented / 2:
            return [" " * self.chance.choice([0, indent, indent + 3]) + self._comment()]
        return [""] if draw > 0.9 else []

    def _end(self) -> str:
        draw = self.chance.random()
        return " " * self.chance.randint(1, 3) + self._comment() if draw < self._commented else " " * (draw > 0.95)

    def _block(self, value, indent: int) -> list[str]:
        lines: list[str] = []
        if isinstance(value, dict):
            for key, item in value.items():
                lines += [*self._own_line(indent), *self._under(" " * indent + f"{key}:", item, indent, False)]
        else:
            for item in value:
                lines += [*self._own_line(indent), *self._under(" " * indent + "-", item, indent, True)]
        return lines

    def _under(self, head: str, value, indent: int, is_item: bool) -> list[str]:
        is_collection = isinstance(value, (dict, list)) and len(value) > 0
        if not is_collection or self.chance.random() < 0.5:
            blanks = " " * self.chance.choice([1, 1, 1, 4])
            return [head + blanks + self._flow(value, indent + 2) + self._end()]
        deeper = indent + self.chance.choice([2, 2, 3, 4])
        if isinstance(value, list) and not is_item and self.chance.random() < 0.3:
            deeper = indent
        if is_item and self.chance.random() < 0.7:  # compact: the first line goes on behind the dash
            first, *rest = self._uncommented_first(value, deeper)
            return [head + first[indent + 1 :], *rest]
        anchor = self._new_anchor(value, " ")
        return [head + anchor.rstrip() + self._end(), *self._block(value, deeper)]

    def _uncommented_first(self, value, indent: int) -> list[str]:
        lines = self._block(value, indent)
        while not lines[0].strip() or lines[0].lstrip().startswith("#"):
            dropped = lines.pop(0)
            if dropped.strip():
                self.comments.remove(dropped.strip())
        return lines

    def _new_anchor(self, value, before: str) -> str:
        if not self.uses_aliases or self.chance.random() < 0.7:
            return ""
        self._anchors.append((value, f"a{len(self._anchors)}"))
        return f"{before}&{self._anchors[-1][1]} "

    def _flow(self, value, indent: int) -> str:
        for known, anchor in self._anchors:
            if known == value and type(known) is type(value) and self.chance.random() < 0.8:
                return f"*{anchor} "
        if self.uses_aliases and isinstance(value, dict) and self.chance.random() < 0.8:
            for known, anchor in self._anchors:
                if isinstance(known, dict) and known and "height" in known and known.keys() <= value.keys():
                    rest = {key: item for key, item in value.items() if known.get(key) != item}
                    return "{" + ", ".join([f"<<: *{anchor} ", *self._pairs(rest, indent)]) + "}"
        if isinstance(value, dict):
            inside = self._separated(self._pairs(value, indent), indent)
            return self._anchored(value, "{" + inside + "}")
        if isinstance(value, list):
            inside = self._separated([self._flow(item, indent + 2) for item in value], indent)
            return self._anchored(value, "[" + inside + "]")
        if isinstance(value, str):
            return self._anchored(value, self._word(value))
        return self._anchored(value, self._number(value))

    def _anchored(self, value, text: str) -> str:
        return self._new_anchor(value, "") + text

    def _pairs(self, value: dict, indent: int) -> list[str]:
        quote = self.chance.choice(["", "", "", '"'])
        return [f"{quote}{key}{quote}: {self._flow(item, indent + 2)}" for key, item in value.items()]

    def _separated(self, parts: list[str], indent: int) -> str:
        draw = self.chance.random()
        if not parts or draw < 0.6:
            return ", ".join(parts)
        if draw < 0.75:
            return " " + " , ".join(parts) + " "
        new_line = self._line_break + " " * (indent + 2)
        lines = [new_line + part + ("," if i + 1 < len(parts) else "") + self._end() for i, part in enumerate(parts)]
        return "".join(lines) + self._line_break + " " * indent

    def _number(self, value: float) -> str:
        text = str(value)
        if isinstance(value, float) and value.is_integer():
            return self.chance.choice([text, f"{int(value)}", f"{value:.2f}"])
        return self.chance.choice([text, text, text + "0" if "." in text else text, f"{value:e}"])

    def _word(self, value: str) -> str:
        plain = re.fullmatch(r"\w[\w ]*", value) and isinstance(plain_scalar(value), str)
        styles = ["'" + value.replace("'", "''") + "'", json.dumps(value, ensure_ascii=False)]
        return self.chance.choice([*styles, value, value] if plain else styles)
