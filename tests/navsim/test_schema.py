"""The schema: it says what the loader says, has a description for every key, and what is shipped is up to date."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any
from unittest import mock

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML
from world_corpus import RICH, RIGHT, WRONG_GEOMETRY, WRONG_STRUCTURE, WRONG_YAML

import navsim
from navsim.errors import WorldError
from navsim.schema import reference, schema_text, world_schema
from navsim.world import parse_world
from navsim.worldfile import load_world, parse_text

ROOT = Path(__file__).resolve().parents[2]
VALIDATOR = jsonschema.Draft202012Validator(world_schema())
SHAPES_OF_OUTLINES = ("are the same", "both angles are the same", "cross or touch", "lie on one line")
"""How the loader words the geometric rules of a single value."""


def plain(text: str) -> Any:
    """The data of a YAML 1.2 text, read by another library than the loader's."""
    return YAML(typ="safe", pure=True).load(text)


def has_the_structure(data: object) -> bool:
    """The loader's verdict on keys, types and ranges alone."""
    with mock.patch("navsim.world.broken_rules", return_value=[]):
        _, problems = parse_world(data)
    return all(any(words in problem.text for words in SHAPES_OF_OUTLINES) for problem in problems)


def test_the_schema_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(world_schema())
    assert world_schema()["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize("text", RIGHT.values(), ids=RIGHT)
def test_schema_and_loader_accept_what_is_right(text):
    parse_text(text)
    VALIDATOR.validate(plain(text))


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_the_schema_accepts_the_shipped_worlds(name):
    VALIDATOR.validate(plain((navsim.SHIPPED_WORLDS_DIRECTORY / f"{name}.yaml").read_text()))


@pytest.mark.parametrize("text", WRONG_STRUCTURE.values(), ids=WRONG_STRUCTURE)
def test_schema_and_loader_refuse_a_wrong_structure(text):
    with pytest.raises(WorldError):
        parse_text(text)
    assert not has_the_structure(plain(text))
    assert not VALIDATOR.is_valid(plain(text))


@pytest.mark.parametrize("text", WRONG_GEOMETRY.values(), ids=WRONG_GEOMETRY)
def test_geometry_is_beyond_the_schema_but_not_beyond_the_loader(text):
    with pytest.raises(WorldError):
        parse_text(text)
    assert has_the_structure(plain(text))
    assert VALIDATOR.is_valid(plain(text))


@pytest.mark.parametrize("text", WRONG_YAML.values(), ids=WRONG_YAML)
def test_the_loader_refuses_yaml_that_no_schema_gets_to_see(text):
    with pytest.raises(WorldError):
        parse_text(text)


def places(data: Any, where: tuple = ()) -> list[tuple]:
    """The keys and positions that lead to each value of ``data``, the whole first."""
    parts = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [where, *(place for key, part in parts for place in places(part, (*where, key)))]


def at(data: Any, where: tuple) -> Any:
    for key in where:
        data = data[key]
    return data


KEYS = ["format", "name", "at", "size", "hight", "points", "yaw_deg", "motion", "hinge", "speed", "box", "mass", "path"]
NUMBERS = st.one_of(
    st.sampled_from([0, 1, 2, -1, 0.5, 1e-7, 1e-6, 360, 361, 1e4, 10_001, 10**25, -0.0, 1.0, 720.5, 1e6]),
    st.floats(allow_nan=False, allow_infinity=False),
)
VALUES = st.recursive(
    st.one_of(NUMBERS, st.none(), st.booleans(), st.sampled_from(["none", "random", "", "x", "1", "circuit"])),
    lambda part: st.one_of(st.lists(part, max_size=3), st.dictionaries(st.sampled_from(KEYS), part, max_size=3)),
    max_leaves=5,
)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_schema_and_loader_agree_on_whatever_is_changed_in_a_file(data):
    world = plain(RICH)
    for _ in range(data.draw(st.integers(1, 3))):
        where = data.draw(st.sampled_from(places(world)[1:]))
        holder, key = at(world, where[:-1]), where[-1]
        kind = data.draw(st.sampled_from(["replace", "remove", "copy", "add", "rename"]))
        if kind == "replace":
            holder[key] = data.draw(VALUES)
        elif kind == "remove":
            del holder[key]
        elif kind == "copy":
            holder[key] = copy.deepcopy(at(world, data.draw(st.sampled_from(places(world)[1:]))))
        elif isinstance(holder, list):
            holder.append(data.draw(VALUES))
        elif kind == "add":
            holder[data.draw(st.sampled_from(KEYS))] = data.draw(VALUES)
        else:
            holder[data.draw(st.sampled_from(KEYS))] = holder.pop(key)
        if len(places(world)) < 2:
            break
    assert VALIDATOR.is_valid(world) == has_the_structure(world), world


def test_every_key_has_a_description_and_every_quantity_its_unit():
    schema = world_schema()
    units = ("metres", "degrees", "kilograms", "coefficient")
    for name, model in {"": schema, **schema["$defs"]}.items():
        for key, value in model.get("properties", {}).items():
            described = value.get("description", "")
            assert described, f"{name}.{key}"
            is_quantity = '"maximum"' in json.dumps(value) and key not in ("starts", "goals", "motion")
            assert not is_quantity or any(unit in described.lower() for unit in units), f"{name}.{key}"


def test_examples_keep_the_schema():
    schema = world_schema()
    count = 0
    for model in (schema, *schema["$defs"].values()):
        for value in model.get("properties", {}).values():
            for example in value.get("examples", ()):
                jsonschema.Draft202012Validator({**value, "$defs": schema["$defs"]}).validate(example)
                count += 1
    assert count > 30


def test_the_shipped_schema_is_up_to_date():
    shipped = navsim.SHIPPED_WORLDS_DIRECTORY / "world.schema.json"
    assert shipped.read_text(encoding="utf-8") == schema_text(), "run: navsim world schema -o worlds/world.schema.json"


def test_the_reference_page_is_up_to_date():
    page = (ROOT / "docs" / "worlds.md").read_text(encoding="utf-8")
    assert reference() in page, "run: python scripts/reference.py"


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_shipped_worlds_name_the_schema_for_editors(name):
    file = navsim.SHIPPED_WORLDS_DIRECTORY / f"{name}.yaml"
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    assert first == "# yaml-language-server: $schema=world.schema.json"
    assert (file.parent / first.partition("=")[2]).is_file()
    load_world(file)
