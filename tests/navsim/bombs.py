"""Small files that ask for much: each is to be refused, or read, in no time. Made here, for most are large."""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Callable

ROOM = "format: 1\nsize: [7.0, 7.0]\n"


def _room(size: object, rest: str = "") -> str:
    return f"format: 1\nsize: [{size}, {size}]\n{rest}"


def _laughs(levels: int, width: int = 10) -> str:
    lines = ["x0: &a0 [0, 0]"]
    lines += [f"x{i}: &a{i} [{', '.join([f'*a{i - 1}'] * width)}]" for i in range(1, levels)]
    return ROOM + "\n".join(lines) + "\n"


def _merges(levels: int, width: int = 10) -> str:
    lines = ["x0: &a0 {a: 1, b: 2}"]
    lines += [f"x{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * width)}], k{i}: 1}}" for i in range(1, levels)]
    return ROOM + "\n".join(lines) + "\n"


def _wide_merges() -> str:
    """One mapping of many keys, merged many times: work that grows with the square of the text."""
    keys = ", ".join(f"k{i}: 1" for i in range(5000))
    return ROOM + f"x: &a {{{keys}}}\n" + "".join(f"y{i}: {{<<: *a}}\n" for i in range(5000))


def _ring(count: int, radius: float = 3.0) -> str:
    corners = ((radius * math.cos(a), radius * math.sin(a)) for a in (2.0 * math.pi * i / count for i in range(count)))
    return ", ".join(f"[{x:.9f}, {y:.9f}]" for x, y in corners)


def _star(count: int, radius: float = 3.0) -> str:
    """Concave in every second corner."""
    corners = (
        (r * math.cos(a), r * math.sin(a))
        for a, r in ((2.0 * math.pi * i / count, radius * (1.0 if i % 2 else 0.6)) for i in range(count))
    )
    return ", ".join(f"[{x:.9f}, {y:.9f}]" for x, y in corners)


def _comb(count: int) -> str:
    """Teeth side by side, whose bounding boxes are all as high as the comb."""
    corners: list[tuple[float, float]] = []
    for i in range(count):
        x = -3.0 + 6.0 * i / count
        corners += [(x, -3.0), (x + 2.0 / count, 3.0)]
    corners += [(3.0, 3.2), (-3.2, 3.2)]
    return ", ".join(f"[{x:.9f}, {y:.9f}]" for x, y in corners)


def _polygon(points: str) -> str:
    return ROOM + f"obstacles: [{{polygon: {{points: [{points}], height: 1}}}}]\n"


def _many(count: int, entry: str = "cylinder: {at: [1, 1], radius: 0.1, height: 1}") -> str:
    return ROOM + "obstacles:\n" + f"  - {entry}\n" * count


def _obstacle_of(**settings: object) -> str:
    settings = {"at": "[1, 1]", "size": "[1, 1]", "height": "1", **settings}
    return ROOM + "obstacles: [{box: {" + ", ".join(f"{key}: {value}" for key, value in settings.items()) + "}}]\n"


def _grid(side: int, entry: str = "cylinder: {{at: [{x}, {y}], radius: 0.1, height: 1}}") -> str:
    """Obstacles in rows 2 m apart."""
    places = ((2.0 * i - side + 1.0, 2.0 * j - side + 1.0) for i in range(side) for j in range(side))
    entries = "".join(f"  - {entry.format(i=i, x=x, y=y)}\n" for i, (x, y) in enumerate(places))
    return _room(2 * side, "obstacles:\n" + entries)


WORLDS: dict[str, Callable[[], str | bytes]] = {
    "laughs": lambda: _laughs(12),
    "laughs as obstacles": lambda: (
        ROOM
        + "obstacles: &a0\n  - &c {cylinder: {at: [1, 1], radius: 0.1, height: 1}}\n  - *c\nstarts: &a1 ["
        + "*a0, " * 9
        + "]\ngoals: ["
        + "*a1, " * 999
        + "]\n"
    ),
    "merges": lambda: _merges(12),
    "wide merges": _wide_merges,
    "a mapping that merges itself": lambda: ROOM + "x: &a {<<: *a}\n",
    "nested lists": lambda: ROOM + "starts: " + "[" * 100_000,
    "nested mappings": lambda: ROOM + "walls: " + "{a: " * 100_000,
    "nested blocks": lambda: ROOM + "".join(" " * i + f"a{i}:\n" for i in range(2000)),
    "nested keys": lambda: ROOM + "? " * 50_000,
    "nested dashes": lambda: ROOM + "starts:\n" + "- " * 50_000,
    "a number of 10^5 digits": lambda: _room("9" * 100_000),
    "a number of 10^6 digits": lambda: _room("1" + "0" * 1_000_000),
    "an exponent of 10^5 digits": lambda: _room("1e" + "9" * 100_000),
    "1e308": lambda: _room("1e308"),
    "-1e308": lambda: _obstacle_of(at="[-1e308, 1e308]"),
    "nan": lambda: _obstacle_of(at="[.nan, 0]"),
    "infinity": lambda: _room(".inf"),
    "an infinite height": lambda: _obstacle_of(height=".inf"),
    "a key of 10^7 letters": lambda: ROOM + "a" * 10_000_000 + ": 1\n",
    "a name of 10^7 letters": lambda: ROOM + "name: " + "a" * 10_000_000 + "\n",
    "10^5 unknown keys": lambda: ROOM + "".join(f"key{i}: 1\n" for i in range(100_000)),
    "10^5 wrong obstacles": lambda: ROOM + "obstacles:\n" + "  - box: {}\n" * 100_000,
    "10^5 misspelt obstacles": lambda: ROOM + "obstacles:\n" + "  - bocks: {att: 1}\n" * 100_000,
    "10^5 keys twice": lambda: ROOM + "name: a\n" * 100_000,
    "10^5 keys without a value": lambda: ROOM + "".join(f"k{i}:\n" for i in range(100_000)),
    "10^5 obstacles in one place": lambda: _many(100_000),
    "10^6 obstacles": lambda: _many(1_000_000),
    "10^7 obstacles": lambda: ROOM + "obstacles: [" + "{}," * 10_000_000 + "]\n",
    "7 * 10^6 obstacles in 16 MiB": lambda: ROOM + "obstacles: [" + "a," * 7_000_000 + "]\n",
    "10^4 obstacles that stand apart": lambda: _grid(100),
    "9000 obstacles with ten mistakes each": lambda: (
        ROOM + "obstacles:\n" + "  - box: {a: 1, b: 1, c: 1, d: 1, e: 1, f: 1, g: 1, h: 1, i: 1, j: 1}\n" * 9_000
    ),
    "10^4 obstacles outside": lambda: _many(10_000, "cylinder: {at: [5, 1], radius: 0.1, height: 1}"),
    "10^4 obstacles of one name": lambda: _many(10_000, "cylinder: {name: a, at: [1, 1], radius: 0.1, height: 1}"),
    "500 starts and goals that are cut off": lambda: (
        ROOM
        + "obstacles: [{box: {at: [0, 0], size: [0.5, 7], height: 1}}]\nstarts: ["
        + "[-2, 0], " * 500
        + "]\ngoals: ["
        + "[2, 2], " * 500
        + "]\n"
    ),
    "20 polygons of 500 teeth": lambda: (
        ROOM + "obstacles:\n" + f"  - polygon: {{points: [{_comb(499)}], height: 1}}\n" * 20
    ),
    "118,000 keys without values": lambda: (
        ROOM + "starts: [" + ("{" + ", ".join(f"k{i}: " for i in range(100)) + "}, ") * 1_180 + "]\n"
    ),
    "118,000 unknown keys": lambda: (
        ROOM + "starts: [" + ("{" + ", ".join(f"k{i}: 1" for i in range(100)) + "}, ") * 1_180 + "]\n"
    ),
    "10^5 points that are the same": lambda: _polygon(", ".join(["[1, 1]"] * 100_000)),
    "10^5 corners": lambda: _polygon(_ring(100_000)),
    "2000 corners": lambda: _polygon(_ring(2000)),
    "10^5 concave corners": lambda: _polygon(_star(100_000)),
    "10^4 teeth": lambda: _polygon(_comb(10_000)),
    "1000 teeth": lambda: _polygon(_comb(1000)),
    "60 polygons of 1000 teeth": lambda: (
        ROOM + "obstacles:\n" + f"  - polygon: {{points: [{_comb(1000)}], height: 1}}\n" * 60
    ),
    "10^5 starts and goals": lambda: (
        ROOM + "starts: [" + "[0, 0], " * 100_000 + "]\ngoals: [" + "[2, 2], " * 100_000 + "]\n"
    ),
    "2000 starts and goals": lambda: ROOM + "starts: [" + "[0, 0], " * 2000 + "]\ngoals: [" + "[2, 2], " * 2000 + "]\n",
    "10^4 starts outside": lambda: ROOM + "starts: [" + "[9, 0], " * 10_000 + "]\n",
    "a way of 10^5 points": lambda: _obstacle_of(
        motion="{path: [[1, 1], " + "[1, 1.1], [1, 1], " * 50_000 + "], speed: 1}"
    ),
    "a way of 2000 points": lambda: _obstacle_of(
        motion="{path: [[1, 1], " + "[1, 1.1], [1, 1], " * 1_000 + "], speed: 1}"
    ),
    "301 moving obstacles": lambda: _grid(
        18, "cylinder: {{at: [{x}, {y}], radius: 0.1, height: 1, motion: {{path: [[1, 1], [1, 2]], speed: 1}}}}"
    ),
    "40 polygons of 900 corners": lambda: (
        ROOM + "obstacles:\n" + f"  - polygon: {{points: [{_ring(900)}], height: 1}}\n" * 40
    ),
    "2000 moving obstacles": lambda: _many(
        2000, "cylinder: {at: [1, 1], radius: 0.1, height: 1, motion: {path: [[1, 1], [1, 2]], speed: 1}}"
    ),
    "2000 pushable obstacles": lambda: _many(
        2000, "cylinder: {at: [1, 1], radius: 0.1, height: 1, pushable: {mass: 1}}"
    ),
    "a swing as long as a street": lambda: (
        _room(10_000) + "obstacles: [{box: {at: [2000, 0], size: [4000, 1], height: 1, "
        "motion: {hinge: [0, 0], swing_deg: [-360, 360], speed_deg: 0.01}}}]\n"
    ),
    "a swing of a polygon of many corners": lambda: _polygon(_star(400)).replace(
        "height: 1", "height: 1, motion: {hinge: [0, 0], swing_deg: [-360, 360], speed_deg: 1}"
    ),
    "a world of 10^9 m": lambda: _room("1e9"),
    "a world of 10^4 m": lambda: (
        _room("1e4") + "obstacles:\n" + "  - cylinder: {at: [1, 1], radius: 0.1, height: 1}\n" * 3
    ),
    "a world of a micrometre": lambda: _room("1e-6"),
    "a slit of 10^4 m": lambda: "format: 1\nsize: [10000, 0.36]\n",
    "an anchor of 10^6 letters": lambda: ROOM + "name: *" + "a" * 1_000_000 + "\n",
    "an anchor in itself of 10^6 letters": lambda: ROOM + f"starts: &{'a' * 1_000_000} [*{'a' * 1_000_000} ]\n",
    "a tag of 10^6 letters": lambda: ROOM + "name: !" + "a" * 1_000_000 + " b\n",
    "an explicit key of 10^6 letters": lambda: ROOM + "? " + "a" * 1_000_000 + "\n: 1\n",
    "an explicit key of 10^6 letters in an obstacle": lambda: (
        ROOM + "obstacles:\n  - box:\n      ? " + "a" * 1_000_000 + "\n      : 1\n"
    ),
    "a shape of 10^6 letters": lambda: ROOM + "obstacles:\n  - ? " + "a" * 1_000_000 + "\n    : 1\n",
    "a height of 10^6 letters": lambda: _obstacle_of(height="a" * 1_000_000),
    "starts of 10^6 letters": lambda: ROOM + "starts: " + "a" * 1_000_000 + "\n",
    "a merge of 10^6 letters": lambda: ROOM + "<<: " + "a" * 1_000_000 + "\n",
    "one word of 16 MiB": lambda: ROOM + "name: " + "a" * (16 * 2**20 - 100) + "\n",
    "quotes of 16 MiB": lambda: ROOM + 'name: "' + r"\x41" * (4 * 2**20 - 100) + '"\n',
    "a comment of 16 MiB": lambda: ROOM + "#" * (16 * 2**20 - 100) + "\n",
    "a million comments": lambda: ROOM + "# \n" * 1_000_000,
    "9000 small merges": lambda: ROOM + "walls:\n  <<: [" + ", ".join(f"{{k{i}: 1}}" for i in range(9_000)) + "]\n",
    "a million anchors": lambda: ROOM + "starts: [" + "".join(f"&a{i} [0, 0], " for i in range(300_000)) + "]\n",
    "10^5 documents": lambda: ROOM + "---\n" * 100_000,
    "10^5 tags": lambda: ROOM + "%TAG ! tag:a,2002:\n" * 100_000,
    "one line of 10^7 blanks": lambda: ROOM + " " * 10_000_000,
    "a million tabs": lambda: ROOM + "\t" * 1_000_000,
    "bytes": lambda: bytes(range(256)) * 4000,
    "zeros": lambda: bytes(10_000_000),
    "UTF-16": lambda: ROOM.encode("utf-16"),
    "surrogates": lambda: ROOM.encode() + b"name: \xed\xa0\x80\n",
    "a quoted surrogate": lambda: ROOM + 'name: "\\ud800"\n',
    "a name in control characters": lambda: ROOM + 'name: "\\0\\e[2J\\n"\n',
    "larger than 16 MiB": lambda: b"#" * (16 * 2**20 + 1),
}

LARGEST_WORLDS: dict[str, Callable[[], str | bytes]] = {
    "a swing as long as it may be": lambda: (
        _room(100) + "obstacles: [{box: {at: [6, 0], size: [12, 1], height: 1, "
        "motion: {hinge: [0, 0], swing_deg: [-180, 180], speed_deg: 1}}}]\n"
    ),
    "10^4 obstacles that touch": lambda: _grid(100, "cylinder: {{at: [{x}, {y}], radius: 1.9, height: 1}}"),
    "10^4 boxes with everything": lambda: _grid(
        100, "box: {{name: b{i}, at: [{x}, {y}], size: [0.2, 0.2], yaw_deg: 1, base: 0.1, height: 1}}"
    ),
    "500 starts and goals between 10^4 obstacles": lambda: (
        _grid(100) + "starts: [" + "[0, 0], " * 500 + "]\ngoals: [" + "[10, 2], " * 500 + "]\n"
    ),
    "300 pushable obstacles between many": lambda: _grid(100).replace(
        "height: 1}", "height: 1, pushable: {mass: 1}}", 300
    ),
    "300 moving obstacles between many": lambda: _grid(100).replace(
        "height: 1}", "height: 1, motion: {path: [[1, 1], [50, 50], [-50, 50], [1, 1]], speed: 1}}", 300
    ),
    "a swing between many": lambda: (
        _grid(70) + "  - box: {at: [6, 0], size: [12, 1], base: 2, height: 1, "
        "motion: {hinge: [0, 0], swing_deg: [-180, 180], speed_deg: 1}}\n"
    ),
}
"""About as large as the limits allow."""

SHELL = "<sdf version='1.9'><world name='w'>{}</world></sdf>"
_ENTITIES = [f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in itertools.pairwise("abcdefghijkl")]
_CAN = (
    "<collision name='c{0}'><geometry><cylinder><radius>0.1</radius><length>1</length></cylinder></geometry>"
    "</collision>"
)


def _body(content: str) -> str:
    return SHELL.format(f"<model name='m'><link name='l'>{content}</link></model>")


def _outline(points: str) -> str:
    pairs = points.strip("[]").split("], [")
    inner = "".join(f"<point>{pair.replace(',', '')}</point>" for pair in pairs)
    return _body(f"<collision name='c'><geometry><polyline>{inner}<height>1</height></polyline></geometry></collision>")


def _nested_models(depth: int) -> str:
    return SHELL.format("<model name='m'>" * depth + "</model>" * depth)


SDF: dict[str, Callable[[], str | bytes]] = {
    "laughs": lambda: (
        f"<!DOCTYPE sdf [<!ENTITY a 'ha'>{''.join(_ENTITIES)}]><sdf version='1.9'><world name='&l;'/></sdf>"
    ),
    "one entity many times": lambda: (
        f"<!DOCTYPE sdf [<!ENTITY a '{'x' * 50_000}'>]><sdf version='1.9'><world name='{'&a;' * 50_000}'/></sdf>"
    ),
    "an external entity": lambda: (
        "<!DOCTYPE sdf [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><sdf version='1.9'><world name='w'>&a;</world></sdf>"
    ),
    "an external document type": lambda: "<!DOCTYPE sdf SYSTEM 'http://127.0.0.1:9/x.dtd'><sdf version='1.9'/>",
    "a parameter entity": lambda: "<!DOCTYPE sdf [<!ENTITY % a SYSTEM 'file:///dev/zero'> %a;]><sdf version='1.9'/>",
    "nesting": lambda: "<sdf version='1.9'>" + "<a>" * 1_000_000,
    "nested models": lambda: _nested_models(90),
    "a million elements": lambda: SHELL.format("<a/>" * 1_000_000),
    "a million attributes": lambda: "<sdf version='1.9' " + " ".join(f"a{i}='1'" for i in range(1_000_000)) + "/>",
    "many pieces of text": lambda: SHELL.format("x<a/>" * 300_000),
    "text between a million comments": lambda: SHELL.format("x<!---->" * 1_000_000),
    "a text of 10^7 letters": lambda: SHELL.format("x" * 10_000_000),
    "10^7 models": lambda: SHELL.format("<model/>" * 10_000_000),
    "10^5 bodies": lambda: _body("".join(_CAN.format(i) for i in range(100_000))),
    "10^4 models of one name": lambda: SHELL.format("<model name='m'/>" * 10_000),
    "10^4 frames in a chain": lambda: SHELL.format(
        "<frame name='f0'/>"
        + "".join(f"<frame name='f{i}'><pose relative_to='f{i - 1}'/></frame>" for i in range(1, 10_000))
        + "<model name='m'><pose relative_to='f9999'/></model>"
    ),
    "10^5 corners": lambda: _outline(_ring(100_000)),
    "10^4 teeth": lambda: _outline(_comb(10_000)),
    "10^5 includes of nothing": lambda: SHELL.format("<include><uri>model://none</uri></include>" * 100_000),
    "10^4 includes of nothing": lambda: SHELL.format("<include><uri>model://none</uri></include>" * 9_999),
    "10^4 includes of other things": lambda: SHELL.format(
        "".join(f"<include><uri>model://none{i}</uri></include>" for i in range(9_999))
    ),
    "5000 bodies": lambda: _body("".join(_CAN.format(i) for i in range(5_000))),
    "10^4 bodies of two links": lambda: SHELL.format(
        "<model name='m'>"
        + "".join(f"<link name='{a}'>{''.join(_CAN.format(i) for i in range(5_000))}</link>" for a in "ab")
        + "</model>"
    ),
    "a uri of 10^6 letters": lambda: SHELL.format(f"<include><uri>model://{'a/' * 500_000}</uri></include>"),
    "huge numbers": lambda: _body(_CAN.format("").replace("0.1", "1e308")),
    "10^5 digits": lambda: _body(_CAN.format("").replace("0.1", "9" * 100_000)),
    "a frame of 10^6 letters": lambda: SHELL.format(
        f"<model name='m'><link name='l'/><placement_frame>{'a' * 1_000_000}</placement_frame></model>"
        f"<include><uri>model://none</uri><name>{'a' * 1_000_000}</name></include>"
    ),
    "a placement of 10^6 letters": lambda: SHELL.format(
        f"<model name='m'><link name='l'/><joint name='j'><child>{'a' * 1_000_000}</child></joint>"
        f"<model name='n'><pose relative_to='j'/></model></model>"
    ),
    "nan": lambda: _body(_CAN.format("").replace("0.1", "nan")),
    "a room of 10^9 m": lambda: SHELL.format("<navsim:room size='1e9 1e9'/>"),
    "bytes": lambda: bytes(range(256)) * 4000,
    "UTF-16": lambda: SHELL.format("").encode("utf-16"),
    "UTF-7": lambda: "<?xml version='1.0' encoding='utf-7'?>" + SHELL.format(""),
}

LARGEST_SDF: dict[str, Callable[[], str | bytes]] = {
    "5000 bodies that stand apart": lambda: SHELL.format(
        "".join(
            f"<model name='m'><pose>{i % 100} {i // 100} 0 0 0 0</pose><link name='l'>{_CAN.format('')}</link></model>"
            for i in range(5_000)
        )
    ),
}

IRSIM: dict[str, Callable[[], str | bytes]] = {
    "laughs": lambda: (
        "x0: &a0 [0]\n"
        + "\n".join(f"x{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12))
        + "\nworld: {}\n"
    ),
    "merges": lambda: (
        "x0: &a0 {a: 1}\n"
        + "\n".join(f"x{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 10)}]}}" for i in range(1, 12))
        + "\nworld: {}\n"
    ),
    "wide merges": lambda: (
        f"x: &a {{{', '.join(f'k{i}: 1' for i in range(400))}}}\n" + "y: {<<: [" + "*a, " * 400 + "]}\nworld: {}\n"
    ),
    "one word of 16 MiB": lambda: "world: {height: 10, width: " + "a" * (16 * 2**20 - 100) + "}\n",
    "an anchor of 10^6 letters": lambda: "world: *" + "a" * 1_000_000 + "\n",
    "a key of 10^6 letters": lambda: "world:\n  ? " + "a" * 1_000_000 + "\n  : !x 1\n",
    "30,000 small merges": lambda: "world:\n  <<: [" + ", ".join(f"{{k{i}: 1}}" for i in range(30_000)) + "]\n",
    "a list in itself": lambda: "world: &a [*a]\n",
    "nested lists": lambda: "world: " + "[" * 100_000,
    "nested blocks": lambda: "world:\n" + "".join(" " * i + f"a{i}:\n" for i in range(1, 2000)),
    "a number of 10^5 digits": lambda: f"world: {{height: {'9' * 100_000}, width: 10}}\n",
    "a hexadecimal number of 10^6 digits": lambda: f"world: {{height: 0x{'f' * 1_000_000}, width: 10}}\n",
    "a sexagesimal number": lambda: f"world: {{height: 1{':59' * 100_000}, width: 10}}\n",
    "a sexagesimal float": lambda: f"world: {{height: 1{':59' * 100_000}.5, width: 10}}\n",
    "a binary": lambda: f"world: {{height: !!binary {'A' * 1_000_000}, width: 10}}\n",
    "nan": lambda: "world: {height: .nan, width: .inf}\n",
    "1e308": lambda: "world: {height: 1.0e+308, width: 10}\n",
    "a date": lambda: "world: {height: 9999-99-99, width: 10}\n",
    "10^7 obstacles": lambda: "obstacle: [" + "{}," * 10_000_000 + "]\n",
    "7 * 10^6 obstacles in 16 MiB": lambda: "obstacle: [" + "a," * 7_000_000 + "]\n",
    "10^9 robots": lambda: "robot: {number: 1000000000}\n",
    "10^4 robots": lambda: "robot: {number: 10000, distribution: {name: circle}}\n",
    "10^4 robots with 10^4 goals": lambda: (
        "robot: {number: 10000, state: [1, 1], goal: [" + "[1, 2], " * 10_000 + "]}\n"
    ),
    "10^4 obstacles of many parts": lambda: (
        "obstacle: {number: 10000, shape: {name: compound, parts: [" + "{name: circle}, " * 1000 + "]}}\n"
    ),
    "10^4 polygons of many corners": lambda: (
        "obstacle: {number: 10000, shape: {name: polygon, vertices: [" + _star(1000) + "]}}\n"
    ),
    "10^4 obstacles outside": lambda: "obstacle: {number: 10000, state: [100, 100]}\n",
    "10^4 obstacles outside in ten entries": lambda: (
        "obstacle:\n" + "  - {number: 1000, state: [100, 100]}\n" * 9 + "  - {number: 999, state: [100, 100]}\n"
    ),
    "10^3 circles that reach in": lambda: (
        "world: {height: 10, width: 10}\n"
        "obstacle: {number: 1000, shape: {name: circle, radius: 4000}, state: [-4000, 5]}\n"
    ),
    "10^4 circles that reach in": lambda: (
        "world: {height: 10, width: 10}\n"
        "obstacle: {number: 9999, shape: {name: circle, radius: 0.2}, state: [-0.1, 5]}\n"
    ),
    "10^4 moving obstacles": lambda: (
        "obstacle: {number: 10000, state: [1, 1], goal: [2, 2], kinematics: {name: omni}, "
        "behavior: {name: dash, loop: true}}\n"
    ),
    "a line of 10^4 corners": lambda: (
        "obstacle: {shape: {name: linestring, vertices: [" + _star(10_000) + "]}, state: [5, 5]}\n"
    ),
    "10^5 corners": lambda: "obstacle: {shape: {name: polygon, vertices: [" + _ring(60_000) + "]}}\n",
    "a distribution of 10^6 letters": lambda: "robot: {distribution: {name: " + "a" * 1_000_000 + "}}\n",
    "a shape of 10^6 letters": lambda: "obstacle: {shape: {name: " + "a" * 1_000_000 + "}}\n",
    "a name of 10^6 letters": lambda: "obstacle: {name: " + "a" * 1_000_000 + ", shape: {name: none}}\n",
    "a map of 10^6 letters": lambda: "world: {obstacle_map: " + "a" * 1_000_000 + "}\nobstacle: {}\n",
    "an unknown key of 10^6 letters": lambda: "? " + "a" * 1_000_000 + "\n: [.nan]\n",
    "a map that is a device": lambda: "world: {obstacle_map: /dev/zero}\nobstacle: {}\n",
}


def png(width: int, height: int, data: bytes = b"") -> bytes:
    """A picture whose header says more than its data holds."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _zeros(width: int, height: int) -> bytes:
    """A complete picture of one colour, which deflates to a thousandth."""
    return png(width, height, zlib.compress(bytes((width + 1) * height), 1))


def _text_bomb() -> bytes:
    """A PNG whose compressed comment unfolds to 64 MiB."""
    comment = b"zTXt" + b"a\0\0" + zlib.compress(bytes(64 * 2**20), 9)
    chunk = struct.pack(">I", len(comment) - 4) + comment + struct.pack(">I", zlib.crc32(comment))
    whole = png(4, 4, zlib.compress(bytes(20)))
    return whole[:33] + chunk * 20 + whole[33:]


def _checkers(size: int) -> bytes:
    """A PGM of cells that are occupied and free by turns: as many outlines as there can be."""
    row = bytes([0, 254] * (size // 2))
    return b"P5\n%d %d\n255\n" % (size, size) + (row + row[::-1]) * (size // 2)


def _holes(size: int) -> bytes:
    """A PGM of one occupied patch full of holes."""
    full, holed = bytes(size), bytes([0, 254] * (size // 2))
    return b"P5\n%d %d\n255\n" % (size, size) + (full + holed) * (size // 2)


def _noise(size: int) -> bytes:
    import random

    pixels = bytes(random.Random(0).choices((0, 254), k=size * size))
    return b"P5\n%d %d\n255\n" % (size, size) + pixels


def _spiral(size: int) -> bytes:
    """A PGM of one winding wall: a single outline with a great many corners."""
    grid = bytearray(b"\xfe" * (size * size))
    x, y, dx, dy = 0, 0, 1, 0
    low_x, low_y, high_x, high_y = 0, 0, size - 1, size - 1
    while low_x <= high_x and low_y <= high_y:
        grid[y * size + x] = 0
        nx, ny = x + dx, y + dy
        if not (low_x <= nx <= high_x and low_y <= ny <= high_y):
            if dx == 1:
                low_y += 2
            elif dy == 1:
                high_x -= 2
            elif dx == -1:
                high_y -= 2
            else:
                low_x += 2
            dx, dy = -dy, dx
            nx, ny = x + dx, y + dy
        x, y = nx, ny
    return b"P5\n%d %d\n255\n" % (size, size) + bytes(grid)


SETTINGS = "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"

MAPS: dict[str, Callable[[], tuple[str, bytes]]] = {
    "a PGM of 10^9 pixels": lambda: (SETTINGS, b"P5\n31623 31623\n255\n\0"),
    "a PGM of 10^30 pixels": lambda: (SETTINGS, b"P5\n" + b"9" * 15 + b" " + b"9" * 15 + b"\n255\n\0"),
    "a PGM of 10^4000 pixels": lambda: (SETTINGS, b"P5\n" + b"9" * 4000 + b" 9\n255\n\0"),
    "a PGM of 36 million pixels": lambda: (SETTINGS, b"P5\n6000 6000\n255\n\0"),
    "a text PGM of 36 million pixels": lambda: (SETTINGS, b"P2\n6000 6000\n255\n0 "),
    "a PGM of no pixels": lambda: (SETTINGS, b"P5\n0 0\n255\n"),
    "a PGM of -1 pixels": lambda: (SETTINGS, b"P5\n-1 -1\n255\n"),
    "a PGM of one endless comment": lambda: (SETTINGS, b"P5\n#" + b"a" * 10_000_000),
    "a PNG of 10^9 pixels": lambda: (SETTINGS, png(31623, 31623)),
    "a PNG of 2^62 pixels": lambda: (SETTINGS, png(2**31 - 1, 2**31 - 1)),
    "a PNG that unfolds": lambda: (SETTINGS, _zeros(6000, 6000)),
    "a PNG that unfolds to more": lambda: (SETTINGS, _zeros(12_000, 12_000)),
    "a PNG whose comment unfolds": lambda: (SETTINGS, _text_bomb()),
    "a PNG whose data unfolds": lambda: (SETTINGS, png(10, 10, zlib.compress(bytes(100 * 2**20), 1))),
    "no picture at all": lambda: (SETTINGS, b""),
    "a picture that is a device": lambda: (SETTINGS.replace("map.pgm", "/dev/zero"), b""),
    "a large empty map": lambda: (SETTINGS, b"P5\n4000 4000\n255\n" + b"\xfe" * 16_000_000),
    "a large full map": lambda: (SETTINGS, b"P5\n4000 4000\n255\n" + b"\0" * 16_000_000),
    "a large map of one block": lambda: (
        SETTINGS,
        b"P5\n4000 4000\n255\n" + b"\xfe" * 12_000_000 + (b"\0" * 2000 + b"\xfe" * 2000) * 500 + b"\xfe" * 2_000_000,
    ),
    "a checkerboard": lambda: (SETTINGS, _checkers(2000)),
    "a sieve": lambda: (SETTINGS, _holes(2000)),
    "noise": lambda: (SETTINGS, _noise(1500)),
    "a large sieve": lambda: (SETTINGS, _holes(6000)),
    "a spiral": lambda: (SETTINGS, _spiral(1500)),
    "a spiral in fine cells": lambda: (SETTINGS.replace("0.05", "0.0001"), _spiral(600)),
    "a resolution of 1e308": lambda: (SETTINGS.replace("0.05", "1.0e+308"), _checkers(10)),
    "a picture of 10^6 letters": lambda: (SETTINGS.replace("map.pgm", "a" * 1_000_000), b""),
    "a mode of 10^6 letters": lambda: (SETTINGS + f"mode: {'a' * 1_000_000}\n", _checkers(10)),
    "a resolution of 0": lambda: (SETTINGS.replace("0.05", "0"), _checkers(10)),
    "a resolution of nan": lambda: (SETTINGS.replace("0.05", ".nan"), _checkers(10)),
    "an origin of 1e308": lambda: (SETTINGS.replace("[0, 0, 0]", "[1.0e+308, 0, 1.0e+308]"), _checkers(10)),
    "an origin of 10^5 digits": lambda: (SETTINGS.replace("[0, 0, 0]", f"[{'9' * 100_000}, 0, 0]"), _checkers(10)),
}

SOURCES = [
    "generate:clutter,count=1000000000",
    "generate:clutter,count=" + "9" * 4000,
    "generate:clutter,count=" + "9" * 5000,
    "generate:clutter,density=1e9",
    "generate:clutter,density=nan",
    "generate:clutter,density=-inf",
    "generate:clutter,size=1e9x1e9",
    "generate:clutter,size=nan",
    "generate:clutter,size=" + "9" * 100_000,
    "generate:clutter,seed=-1",
    "generate:clutter,seed=" + "9" * 5000,
    "generate:" + "a" * 1_000_000,
    "generate:clutter," + "a" * 1_000_000 + "=1",
    "generate:clutter" + ",size=1" * 100_000,
    "generate:" + "," * 1_000_000,
]
