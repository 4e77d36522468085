"""JSON Schema of the world file format, made from the models; and the reference page made from the schema.

The schema accepts what :func:`navsim.load_world` accepts as far as one value at a time can tell: keys, types, ranges.
``BEYOND_THE_SCHEMA`` lists the rules that only the loader checks.

>>> schema = world_schema()
>>> schema["$defs"]["Cylinder"]["properties"]["radius"]["description"]
'Radius of the footprint, metres.'
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from pydantic.json_schema import models_json_schema

from navsim.motion_rules import MOST_MOVABLE, MOST_SWEEPS
from navsim.rules import MOST_OVERLAPS
from navsim.world import (
    MOST_CORNERS_IN_ALL,
    MOST_OBSTACLES,
    MOST_PLACES,
    Box,
    Cylinder,
    Goal,
    Motion,
    Polygon,
    Pushable,
    Start,
    Swing,
    Walls,
    World,
)
from navsim.worldfile import LARGEST_FILE, MOST_VALUES

DIALECT = "https://json-schema.org/draft/2020-12/schema"

BEYOND_THE_SCHEMA = {
    "inside": "Points lie inside the room; the ways of moving obstacles stay in it, too.",
    "simple": "Consecutive corners of a polygon differ, its edges do not cross or touch, and it encloses some area.",
    "clearance": "A start keeps 0.2255 m, the robot's radius and 5 cm, from obstacles and walls; a goal 0.1755 m.",
    "connected": "The robot can drive from every start to every goal; places that are drawn at random exist.",
    "motion": "Consecutive points of a path differ, and so do the two angles of a swing; what moves runs into nothing "
    "that stands, and no point of it is faster than 10 m/s; what can be pushed stands free.",
    "yaml": "No key is given twice or left without a value; there are no tags but YAML's own; aliases stand "
    "for something; numbers are finite.",
    "amounts": f"A file holds at most {MOST_VALUES} values, aliases replaced by what they stand for, and is no larger "
    f"than {LARGEST_FILE // 2**20} MiB; its polygons have at most {MOST_CORNERS_IN_ALL} corners in all; at most "
    f"{MOST_MOVABLE} obstacles move or can be pushed, and their ways have at most {MOST_SWEEPS} pieces; at most "
    f"{MOST_OVERLAPS} pairs of obstacles overlap.",
}
"""Rules that JSON Schema cannot express: the loader tells of them, an editor with the schema alone does not."""

_POINT = {"description": "x and y, metres.", "examples": [[1.0, -0.5]]}
_SHAPES = {"box": Box, "cylinder": Cylinder, "polygon": Polygon}
_LAST = ("height", "yaw_deg", "base", "name", "motion", "pushable")
"""Keys of obstacles that come after those of their footprint."""
_EXAMPLES: dict[str, Any] = {
    "World.name": "tabletop",
    "World.size": [7.0, 7.0],
    "World.walls": {"height": 2.0, "thickness": 0.1},
    "World.obstacles": [{"box": {"at": [1.0, -0.5], "size": [0.6, 0.4], "height": 0.8, "yaw_deg": 30}}],
    "World.starts": [{"at": [0, 0], "yaw_deg": 90}, [3.0, 3.0]],
    "World.goals": [[2.0, -2.5]],
    "Walls.height": 2.0,
    "Walls.thickness": 0.1,
    "Box.name": "table top",
    "Box.at": [1.0, -0.5],
    "Box.size": [0.6, 0.4],
    "Box.height": 0.8,
    "Box.yaw_deg": 30,
    "Cylinder.name": "post",
    "Cylinder.at": [-1.0, 1.2],
    "Cylinder.radius": 0.15,
    "Cylinder.height": 0.3,
    "Polygon.name": "counter",
    "Polygon.points": [[0, 0], [1, 0], [0.4, 0.8]],
    "Polygon.height": 1.0,
    "Start.at": [0, 0],
    "Start.yaw_deg": 90,
    "Goal.at": [2.0, -2.5],
    "Motion.path": [[2, 2], [2, -2]],
    "Motion.speed": 0.5,
    "Swing.hinge": [1.0, 0.0],
    "Swing.swing_deg": [0, 90],
    "Swing.speed_deg": 45,
    "Pushable.mass": 0.35,
    "Pushable.friction": 0.4,
    "*.base": 0.7,
    "*.motion": {"path": [[2, 2], [2, -2]], "speed": 0.5, "repeat": "there-and-back"},
    "*.pushable": {"mass": 0.35},
}
"""What may stand after a key; ``*`` is any obstacle."""


def world_schema() -> dict[str, Any]:
    """JSON Schema, draft 2020-12, of a world file, with a description and a unit for every key."""
    models = (World, Walls, Box, Cylinder, Polygon, Start, Goal, Motion, Swing, Pushable)
    _, made = models_json_schema([(model, "validation") for model in models])
    definitions = made["$defs"]
    for name, definition in definitions.items():
        _tidy(name, definition)
    world = definitions.pop("World")
    properties = world["properties"]
    properties["format"] = {"const": 1, "description": properties["format"]["description"], "examples": [1]}
    properties["walls"] = {
        **_described(properties["walls"]),
        "anyOf": [{"$ref": "#/$defs/Walls"}, {"enum": ["none", None], "description": "The floor is open."}],
    }
    properties["obstacles"] = {
        **_described(properties["obstacles"]),
        "type": "array",
        "maxItems": MOST_OBSTACLES,
        "items": {"$ref": "#/$defs/Obstacle"},
    }
    for key, place in (("starts", "Start"), ("goals", "Goal")):
        definitions[place]["description"] += " The short form is a point, [x, y]."
        properties[key] = {
            **_described(properties[key]),
            "anyOf": [
                {"const": "random", "description": "A place is drawn each episode, with clearance and connected."},
                {
                    "type": "array",
                    "minItems": 1,
                    "maxItems": MOST_PLACES,
                    "items": {"anyOf": [{"$ref": "#/$defs/Point"}, {"$ref": f"#/$defs/{place}"}]},
                },
            ],
        }
    definitions["Point"] = {**definitions["Goal"]["properties"]["at"], **_POINT}
    definitions["Obstacle"] = {
        "type": "object",
        "description": "One shape with its settings; each shape has a list entry ('- ') of its own.",
        "properties": {
            kind: {"$ref": f"#/$defs/{model.__name__}", "description": definitions[model.__name__]["description"]}
            for kind, model in _SHAPES.items()
        },
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": False,
        "examples": _EXAMPLES["World.obstacles"],
    }
    return {
        "$schema": DIALECT,
        "title": "navsim world file, format 1",
        "description": "A room with obstacles, starts and goals. Lengths are metres; the origin is the room's centre.",
        "type": "object",
        "properties": properties,
        "required": ["format", "size"],
        "additionalProperties": False,
        "$defs": dict(sorted(definitions.items())),
    }


def schema_text() -> str:
    """The schema as the text of a file."""
    return json.dumps(world_schema(), indent=2, ensure_ascii=False) + "\n"


def _described(schema: dict[str, Any]) -> dict[str, Any]:
    return {key: schema[key] for key in ("description", "default", "examples") if key in schema}


def _tidy(name: str, definition: dict[str, Any]) -> None:
    """Takes out what pydantic makes up, and what is meant for readers of the code; puts examples in."""
    definition.pop("title", None)
    definition["description"] = definition["description"].replace("``", "")
    properties = definition["properties"]
    definition["properties"] = {key: properties[key] for key in sorted(properties, key=_place_among(properties))}
    for key, schema in definition["properties"].items():
        schema.pop("title", None)
        schema["description"] = schema["description"].replace("``", "")
        example = _EXAMPLES.get(f"{name}.{key}", _EXAMPLES.get(f"*.{key}"))
        if example is not None:
            schema["examples"] = [example]


def _place_among(keys: Iterable[str]) -> Callable[[str], int]:
    """Where a key comes in completion and reference: what an author writes first, first."""
    order = [*(key for key in keys if key not in _LAST), *_LAST]
    return order.index


_LINKS = {
    "Walls": "[settings](#walls)",
    "Obstacle": "[box](#box), [cylinder](#cylinder) or [polygon](#polygon)",
    "Start": "[settings](#an-entry-of-starts)",
    "Goal": "[settings](#an-entry-of-goals)",
    "Motion": "[a path](#motion-along-a-path)",
    "Swing": "[a swing](#motion-about-a-hinge)",
    "Pushable": "[settings](#pushable)",
}


def reference() -> str:
    """The format, key by key, as a section of Markdown."""
    schema = world_schema()
    definitions = schema["$defs"]
    sections = [
        ("The file", "", schema),
        ("`walls`", "", definitions["Walls"]),
        *((f"`{kind}`", "An entry of `obstacles`. ", definitions[model.__name__]) for kind, model in _SHAPES.items()),
        ("An entry of `starts`", "", definitions["Start"]),
        ("An entry of `goals`", "", definitions["Goal"]),
        ("Motion along a path", "", definitions["Motion"]),
        ("Motion about a hinge", "", definitions["Swing"]),
        ("`pushable`", "", definitions["Pushable"]),
    ]
    lines = []
    for title, lead, definition in sections:
        lines += [f"### {title}", "", lead + definition["description"].replace("\n", " "), ""]
        lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
        lines += _rows(definition, definitions)
        lines.append("")
    lines += ["### What the schema cannot say", ""]
    lines += [
        "The schema checks keys, types and ranges. These rules only the loader and `navsim world check` know:",
        "",
    ]
    lines += [f"- {rule}" for rule in BEYOND_THE_SCHEMA.values()]
    return "\n".join(lines) + "\n"


def _rows(definition: dict[str, Any], definitions: dict[str, Any]) -> Iterator[str]:
    required = definition.get("required", ())
    for key, schema in definition["properties"].items():
        default = "required" if key in required else _default(schema)
        example = f" Example: `{_flow(schema['examples'][0])}`." if "examples" in schema and key != "format" else ""
        yield f"| `{key}` | {_values(schema, definitions)} | {default} | {schema['description']}{example} |"


def _default(schema: dict[str, Any]) -> str:
    default = schema.get("default")
    return "none" if default is None else "its place" if default == "" else f"`{_flow(default)}`"


def _values(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What may stand after a key, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return "a point" if name == "Point" else _LINKS[name]
    for word in ("anyOf", "oneOf"):
        if word in schema:
            kinds = [_values(kind, definitions) for kind in schema[word] if kind.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"] if value is not None)
    kind = schema["type"]
    if kind == "array":
        if "prefixItems" in schema:
            return f"[two numbers], each {_values(schema['prefixItems'][0], definitions)}"
        fewest = f"{schema['minItems']} to " if schema.get("minItems", 0) > 1 else "up to "
        return f"list of {fewest}{schema['maxItems']}: {_values(schema['items'], definitions)}"
    if kind == "number":
        return _range(schema)
    return {"string": f"text of up to {schema.get('maxLength')} letters", "object": "a shape"}[kind]


def _range(schema: dict[str, Any]) -> str:
    if "exclusiveMinimum" in schema:
        return f"above {_number(schema['exclusiveMinimum'])}, up to {_number(schema['maximum'])}"
    return f"{_number(schema['minimum'])} to {_number(schema['maximum'])}"


def _number(value: float) -> str:
    """Without an exponent.

    >>> _number(-1e4), _number(1e-6), _number(0.5)
    ('−10000', '0.000001', '0.5')
    """
    return f"{value:.6f}".rstrip("0").rstrip(".").replace("-", "−")


def _flow(value: Any) -> str:
    """``value`` as it stands in a world file, on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return value if isinstance(value, str) else json.dumps(value)
