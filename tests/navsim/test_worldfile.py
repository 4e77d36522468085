"""World files: what the text says, what every mistake is told, and that a saved world is read back."""

from __future__ import annotations

import math
import string
import time
from pathlib import Path

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import navsim
from navsim.errors import WorldError
from navsim.world import World
from navsim.worldfile import LARGEST_FILE, dump_world, load_world, parse_text, save_world

ROOM = "format: 1\nsize: [7.0, 7.0]\n"
BOX = "box: {at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8}"


def problems_of(text: str | bytes) -> list[str]:
    with pytest.raises(WorldError) as caught:
        parse_text(text, source="room.yaml")
    return list(caught.value.problems)


def problem_of(text: str | bytes) -> str:
    (problem,) = problems_of(text)
    return problem


def of_a_box(**settings: str) -> str:
    settings = {"at": "[1, 1]", "size": "[1, 1]", "height": "1", **settings}
    return ROOM + "obstacles:\n  - box:\n" + "".join(f"      {key}: {value}\n" for key, value in settings.items())


def refused(path) -> str:
    with pytest.raises(WorldError) as caught:
        load_world(path)
    (problem,) = caught.value.problems
    return problem


EXAMPLE = """\
format: 1                    # required
name: tabletop
size: [7.0, 7.0]
walls: {height: 1.5, thickness: 0.2}

obstacles:
  - box:      {at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8, yaw_deg: 30}
  - cylinder: {at: [-1.0, 1.2], radius: 0.15, height: 0.3}
  - polygon:  {points: [[0, 0], [1, 0], [0.4, 0.8]], height: 1.0}
  - box:      {name: table top, at: [0, 2], size: [1.2, 0.6], base: 0.70, height: 3e-2}

starts:
  - {at: [-2, 0], yaw_deg: 90}
  - [3.0, 3.0]
goals:
  - [2.0, -2.5]
"""


def test_a_world_file_is_read_as_it_is_written():
    world = parse_text(EXAMPLE)
    box, can, triangle, table_top = world.obstacles
    assert (world.name, world.size, world.walls.height, world.walls.thickness) == ("tabletop", (7.0, 7.0), 1.5, 0.2)
    assert (box.at, box.size, box.height, box.yaw_deg, box.base) == ((1.0, -0.5), (0.6, 0.4), 0.8, 30.0, 0.0)
    assert (can.at, can.radius, can.height) == ((-1.0, 1.2), 0.15, 0.3)
    assert triangle.points == ((0.0, 0.0), (1.0, 0.0), (0.4, 0.8))
    assert (table_top.name, table_top.base, table_top.height, table_top.top) == ("table top", 0.7, 0.03, 0.7 + 0.03)
    assert [obstacle.name for obstacle in world.obstacles] == ["box 1", "cylinder 2", "polygon 3", "table top"]
    assert [(start.at, start.yaw_deg) for start in world.starts] == [((-2.0, 0.0), 90.0), ((3.0, 3.0), None)]
    assert [goal.at for goal in world.goals] == [(2.0, -2.5)]


def test_flow_style_block_style_and_json_say_the_same():
    flow = ROOM + f"name: a\nobstacles: [{BOX[:3]}: {BOX[5:]}]\n".replace("[box: ", "[{box: ").replace("}]", "}}]")
    block = of_a_box(at="[1.0, -0.5]", size="\n        - 0.6\n        - 0.4", height="0.8") + "name: 'a'\n"
    json = (
        '{"format": 1, "size": [7.0, 7.0], "name": "a", '
        '"obstacles": [{"box": {"at": [1.0, -0.5], "size": [0.6, 0.4], "height": 0.8}}]}'
    )
    assert parse_text(flow) == parse_text(block) == parse_text(json)


@pytest.mark.parametrize("place", ["starts", "goals"])
def test_random_draws_starts_and_goals(place):
    assert getattr(parse_text(ROOM + f"{place}: random\n"), place) == "random"


def test_walls_none_leaves_the_floor_open():
    assert parse_text(ROOM + "walls: none\n").walls is None


def test_a_world_without_a_name_is_called_after_its_file(tmp_path):
    (tmp_path / "my office.yaml").write_text(ROOM)
    (tmp_path / "named.yaml").write_text(ROOM + "name: lab\n")
    assert load_world(tmp_path / "my office.yaml").name == "my office"
    assert load_world(str(tmp_path / "named.yaml")).name == "lab"


def test_the_same_text_reads_alike_with_a_byte_order_mark_and_with_windows_line_ends():
    as_windows_saves_it = b"\xef\xbb\xbf" + EXAMPLE.replace("\n", "\r\n").encode()
    assert parse_text(as_windows_saves_it) == parse_text(EXAMPLE)


@pytest.mark.parametrize(
    ("text", "height"), [("1e-3", 1e-3), ("2", 2.0), (".5", 0.5), ("+1.5", 1.5), ("1.", 1.0), ("010", 10.0)]
)
def test_numbers_are_those_of_yaml_1_2(text, height):
    assert parse_text(of_a_box(height=text)).obstacles[0].height == height


@pytest.mark.parametrize("word", ["no", "on", "12:30", "0x1f", "1_000", "2026-01-01", "=", "née"])
def test_words_stay_words(word):
    assert parse_text(ROOM + f"name: {word}\n").name == word


def test_anchors_and_aliases_stand_for_their_values():
    world = parse_text(
        ROOM + "obstacles:\n  - cylinder: &post {at: &spot [1, 1], radius: 0.1, height: &tall 1.5}\n"
        "  - box: {at: *spot, size: [1, 1], height: *tall}\n  - cylinder: *post\n"
    )
    first, box, second = world.obstacles
    assert (first.at, first.radius, first.height) == (second.at, second.radius, second.height) == ((1.0, 1.0), 0.1, 1.5)
    assert (box.at, box.height) == ((1.0, 1.0), 1.5)


def test_merge_keys_fill_in_what_a_mapping_lacks():
    world = parse_text(
        ROOM + "obstacles:\n"
        "  - cylinder: &post {at: [1, 1], radius: 0.1, height: 1.5}\n"
        "  - cylinder: {<<: *post, at: [2, 2]}\n"
        "  - cylinder: {radius: 0.3, <<: [&low {height: 0.2}, *post]}\n"
    )
    assert [(post.at, post.radius, post.height) for post in world.obstacles] == [
        ((1.0, 1.0), 0.1, 1.5),
        ((2.0, 2.0), 0.1, 1.5),
        ((1.0, 1.0), 0.3, 0.2),
    ]


def test_a_mistake_behind_an_alias_is_shown_where_it_is_written():
    text = ROOM + "obstacles:\n  - cylinder: &post {at: [1, 1], radius: -1, height: 1}\n  - cylinder: {<<: *post}\n"
    assert problems_of(text) == [
        "room.yaml:4:42: obstacles[0].cylinder.radius: must be greater than 0, not -1",
        "room.yaml:4:42: obstacles[1].cylinder.radius: must be greater than 0, not -1",
    ]


BOX_REMEDY = "'- box: {at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8}'"
SETTINGS_OF_A_START = "{at: [0.0, 0.0], yaw_deg: 90} or [0.0, 0.0]"
MISTAKES = {
    # Keys
    "wall: none": "3:1: wall: is not a known key; did you mean 'walls'?",
    "Name: x": "3:1: Name: is not a known key; did you mean 'name'?",
    "gravity: 9.81": "3:1: gravity: is not a known key; the keys here are "
    "format, name, size, walls, obstacles, starts, goals",
    "walls: {height: 1, thick: 1}": "3:20: walls.thick: is not a known key; did you mean 'thickness'?",
    "size: [7, 7]": "3:1: size: is given twice, first in line 2; leave one of them out",
    "name: x\nwalls: {height: 1,\n  height: 1}": "5:3: walls.height: is given twice, first in line 4; "
    "leave one of them out",
    "? [1]\n: 2": "3:3: a key must be a word; put quotes around a key, and braces around settings",
    "name:": "3:1: name: has no value; write one after the colon, or leave the key out",
    "obstacles:": "3:1: obstacles: has no value; write one after the colon, or leave the key out",
    '"na\\nme": x': "3:1: na\\nme: is not a known key; did you mean 'name'?",
    # Values
    "name: 5": "3:7: name: must be text, not 5; put it in quotes",
    "name: true": "3:7: name: must be text, not true; put it in quotes",
    "name: ''": "3:7: name: is empty; write a name or leave the key out",
    "name: null": "3:7: name: must be text, not nothing; give one or leave the key out",
    "goals: [2, 2.5]": "3:8: goals: must be a list of places, such as [[2, 2.5]], not [2, 2.5]",
    "walls: low": "3:8: walls: must be 'none' or settings such as {height: 2.0, thickness: 0.1}, not 'low'",
    "walls: [1]": "3:8: walls: must be settings such as {height: 2.0, thickness: 0.1}, not [1]",
    "starts: anywhere": "3:9: starts: must be 'random' or a list of points, not 'anywhere'",
    "goals: []": "3:8: goals: is empty; list at least one point such as [0.0, 0.0], or write 'random'",
    "goals: 3": "3:8: goals: must be 'random' or a list of points such as [[0.0, 0.0]], not 3",
    "starts: [near]": f"3:10: starts[0]: must be settings such as {SETTINGS_OF_A_START}, not 'near'",
    "starts: [[1]]": "3:10: starts[0]: must be two numbers, not [1]",
    "starts:\n  - [1, 2, 3]": "4:5: starts[0]: must be two numbers, such as [1.0, 2.0], not [1, 2, 3]",
    "starts: [{yaw_deg: 4}]": "3:10: starts[0]: key 'at' is missing; add 'at: [0.0, 0.0]'",
    "starts: [{at: [1, 1], yaw_deg: -361}]": "3:32: starts[0].yaw_deg: must be at least -360, not -361",
    # Shapes
    "obstacles: {box: {}}": f"3:12: obstacles: must be a list with one shape an entry, such as {BOX_REMEDY}",
    "obstacles: [box]": f"3:13: obstacles[0]: must be a shape such as {BOX_REMEDY}, not 'box'",
    "obstacles: [{}]": f"3:13: obstacles[0]: must be a shape such as {BOX_REMEDY}, not {{}}",
    "obstacles: [{Boxes: {}}]": "3:14: obstacles[0].Boxes: is not a shape (box, cylinder, polygon); "
    "did you mean 'box'?",
    "obstacles: [{sphere: {}}]": "3:14: obstacles[0].sphere: is not a shape (box, cylinder, polygon); "
    f"write one of them first, as in {BOX_REMEDY}",
    "obstacles: [{box: {}, polygon: {}}]": "3:13: obstacles[0]: holds 'box' and 'polygon'; "
    "give each shape a list entry ('- ') of its own",
    "obstacles:\n  - box: {}\n    at: [1, 1]": "4:5: obstacles[0]: has keys beside 'box'; "
    "indent them below it, as in 'box: {at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8}'",
    "obstacles: [{cylinder: {at: [1, 1], height: 1}}]": "3:24: obstacles[0].cylinder: key 'radius' is missing; "
    "add 'radius: 0.2'",
    "obstacles: [{cylinder: {at: [1, 1], height: 1, raduis: 1}}]": "3:48: obstacles[0].cylinder.raduis: "
    "is not a known key; did you mean 'radius'?",
    "obstacles: [{polygon: {points: [[0, 0], [1, 0]], height: 1}}]": "3:32: obstacles[0].polygon.points: "
    "must be a list of three points or more, such as [[0, 0], [1, 0], [0.4, 0.8]], not [[0, 0], [1, 0]]",
    "obstacles: [{polygon: {points: [[0, 0], [1, 1], [1, 0], [0, 1]], height: 1}}]": "3:32: "
    "obstacles[0].polygon.points: the edges between points 1-2 and 3-4 cross or touch; "
    "list the corners in order around the outline",
    "obstacles: [{polygon: {points: [[0, 0], [1, 0], [1, 0], [0, 1]], height: 1}}]": "3:32: "
    "obstacles[0].polygon.points: points 2 and 3 are the same; leave one of them out",
    "obstacles: [{polygon: {points: [[0, 0], [0, 1], [1, 1], [0, 0]], height: 1}}]": "3:32: "
    "obstacles[0].polygon.points: points 4 and 1 are the same; leave one of them out",
    "obstacles: [{polygon: {points: [[0, 0], [1, 0], [0.5, 1e-13]], height: 1}}]": "3:32: "
    "obstacles[0].polygon.points: the points lie on one line; move one of them off it",
    # YAML
    "name: !!python/object/apply:os.system ['x']": "3:7: name: the tag '!!python/object/apply:os.system' "
    "is not read in a world file; write plain numbers, words, lists and mappings",
    "name: !!python/name:os.system x": "3:7: name: the tag '!!python/name:os.system' "
    "is not read in a world file; write plain numbers, words, lists and mappings",
    "walls: !mine {height: 1}": "3:8: walls: the tag '!mine' is not read in a world file; "
    "write plain numbers, words, lists and mappings",
    "name: *other": "3:7: name: '*other' stands for nothing; mark a value before it with '&other'",
    "goals: &all [*all]": "3:14: goals[0]: '*all' stands inside the very thing that it stands for; write it out",
    "<<: [1, 1]": "3:1: '<<' takes an alias of a mapping such as '*post', or a list of such aliases",
    "---\nformat: 1": "3:1: a second document ('---') begins here; put each world in a file of its own",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items(), ids=MISTAKES)
def test_a_mistake_is_told_with_its_place_value_and_remedy(text, message):
    assert problems_of(f"{ROOM}{text}\n") == [f"room.yaml:{message}"]


@pytest.mark.parametrize(
    ("height", "message"),
    [
        ("0", "must be greater than 0, not 0"),
        ("-0.5", "must be greater than 0, not -0.5"),
        ("1e-9", "must be at least 1e-06, not 1e-09"),
        ("20000", "must be at most 10000, not 20000"),
        (".inf", "must be a finite number, not inf"),
        ("-.INF", "must be a finite number, not -inf"),
        (".NaN", "must be a finite number, not nan"),
        ("1e999", "must be a finite number, not inf"),
        ("9" * 5000, "must be a finite number, not inf"),
        ("tall", "must be a number, not 'tall'"),
        ("nan", "must be a number, not 'nan'"),
        ("'1.0'", "must be a number, not '1.0'"),
        ("true", "must be a number, not true"),
        ("~", "must be a number, not nothing"),
        ("[1]", "must be a number, not [1]"),
        ("{m: 1}", "must be a number, not {'m': 1}"),
        ("0x10", "must be a number, not '0x10'"),
    ],
)
def test_a_length_is_a_finite_positive_number_of_sensible_size(height, message):
    assert problem_of(of_a_box(height=height)) == f"room.yaml:7:15: obstacles[0].box.height: {message}"


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("at", "[1, .nan]", "5:15: obstacles[0].box.at[1]: must be a finite number, not nan"),
        ("at", "[-1e5, 0]", "5:12: obstacles[0].box.at[0]: must be at least -10000, not -100000.0"),
        ("at", "5", "5:11: obstacles[0].box.at: must be two numbers, such as [1.0, 2.0], not 5"),
        ("size", "[1]", "6:13: obstacles[0].box.size: must be two numbers, not [1]"),
        ("size", "[1, 0]", "6:17: obstacles[0].box.size[1]: must be greater than 0, not 0"),
        ("yaw_deg", ".inf", "8:16: obstacles[0].box.yaw_deg: must be a finite number, not inf"),
        ("base", "-0.1", "8:13: obstacles[0].box.base: must be at least 0, not -0.1"),
        ("name", "7", "8:13: obstacles[0].box.name: must be text, not 7; put it in quotes"),
    ],
)
def test_every_number_of_an_obstacle_is_checked(setting, value, message):
    assert problem_of(of_a_box(**{setting: value})) == f"room.yaml:{message}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("size: [1, 1]\n", "1:1: key 'format' is missing; add 'format: 1'"),
        ("# a room\n\nformat: 1\n", "3:1: key 'size' is missing; add 'size: [7.0, 7.0]'"),
        ("format: 2\nsize: [1, 1]\n", "1:9: format: must be 1, the one format that this version reads, not 2"),
        ("format: true\nsize: [1, 1]\n", "1:9: format: must be 1, the one format that this version reads, not true"),
        ("format: '1'\nsize: [1, 1]\n", "1:9: format: must be 1, the one format that this version reads, not '1'"),
        ("format: 1\nsize: 7\n", "2:7: size: must be two numbers, such as [1.0, 2.0], not 7"),
        ("- format: 1\n", "1:1: a world is a mapping with keys such as 'format', not [{'format': 1}]"),
        ("just words\n", "1:1: a world is a mapping with keys such as 'format', not 'just words'"),
        ("null\n", "1:1: a world is a mapping with keys such as 'format', not nothing"),
    ],
)
def test_a_world_is_a_mapping_with_a_format_and_a_size(text, message):
    assert problem_of(text) == f"room.yaml:{message}"


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n"])
def test_an_empty_file_is_told_what_a_world_needs(text):
    assert problem_of(text).endswith("the file is empty; a world needs at least 'format: 1' and 'size: [7.0, 7.0]'")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("goals: [[1, 2]\nstarts: random\n", "4:1"),
        ("name: 'lab\n", "4:1"),
        ("a: b: c\n", "3:5"),
        ("  name: x\n", "3:3"),
        ("- 1\n", "3:1"),
    ],
)
def test_what_is_not_yaml_is_told_with_its_place_and_a_remedy(text, place):
    problem = problem_of(ROOM + text)
    assert problem.startswith(f"room.yaml:{place}: not YAML: ")
    assert problem.endswith("check the brackets, quotes, colons and indentation before this place")


@pytest.mark.parametrize(("text", "place"), [("\tname: x\n", "3:1"), ("robots:\n \ta: 1\n", "4:2")])
def test_a_tab_is_named(text, place):
    assert problem_of(ROOM + text) == f"room.yaml:{place}: not YAML: a tab; YAML is indented with spaces"
    assert "a tab" not in problem_of(ROOM + "name:\ta: b\n")


def test_bytes_that_are_not_utf_8_are_told_with_their_place():
    assert problem_of(ROOM.encode() + "name: café".encode("latin-1")) == (
        "room.yaml:3:10: byte 0xe9 is not UTF-8; save the file with UTF-8 encoding"
    )


def test_what_is_nested_without_end_is_refused():
    begin = time.process_time()
    problem = problem_of("[" * 100_000)
    assert time.process_time() - begin < 2.0, "a bomb is refused at once"
    assert problem.endswith("lists and mappings are nested deeper than 50 levels; a world needs six")


def test_aliases_that_multiply_are_refused_before_they_fill_the_memory():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    assert "the file holds more than 120000 values" in problem_of("\n".join(lines))


def test_a_long_value_is_shortened_in_its_message():
    assert len(problem_of(ROOM + f"walls: {'x' * 10_000}\n")) < 200
    assert len(problem_of(ROOM + f"walls: {list(range(10_000))}\n")) < 200


def test_all_mistakes_of_a_file_come_in_one_go_in_its_order():
    text = """\
format: 1
size: [7.0, -7.0]
walls: {hight: 2.0}
obstacles:
  - box: {at: [1, 1], size: [1, 1], height: .nan}
  - box: {at: [1, 1], size: [1, 1], height: 1}
  - cylinder: {at: [1, 1], radius: 0.2, height: 1, height: 2}
  - sphere: {}
starts: [{at: [0, 0], yaw: 3}]
goals: some
"""
    assert problems_of(text) == [
        "room.yaml:2:13: size[1]: must be greater than 0, not -7.0",
        "room.yaml:3:9: walls.hight: is not a known key; did you mean 'height'?",
        "room.yaml:5:45: obstacles[0].box.height: must be a finite number, not nan",
        "room.yaml:7:52: obstacles[2].cylinder.height: is given twice, first in line 7; leave one of them out",
        f"room.yaml:8:5: obstacles[3].sphere: is not a shape (box, cylinder, polygon); write one of them first, "
        f"as in {BOX_REMEDY}",
        "room.yaml:9:23: starts[0].yaw: is not a known key; did you mean 'yaw_deg'?",
        "room.yaml:10:8: goals: must be 'random' or a list of points, not 'some'",
    ]


def test_a_mistake_in_the_motion_of_an_obstacle_is_told_all_the_same():
    (problem, *_) = problems_of(of_a_box(motion="{path: [[2, 2]], speed: 0.5}"))
    assert "obstacles[0].box.motion" in problem


def test_a_missing_file_suggests_the_shipped_world_that_was_meant(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refused("complex_trian") == "complex_trian: there is no such world file; did you mean 'complex_train'?"
    assert refused("worlds/simple_eval.yml") == (
        "worlds/simple_eval.yml: there is no such world file; did you mean 'simple_eval'?"
    )


def test_a_missing_file_suggests_a_file_beside_it(tmp_path):
    (tmp_path / "warehouse.yaml").write_text(ROOM)
    missing = tmp_path / "warehuose.yaml"
    assert refused(missing) == f"{missing}: there is no such world file; did you mean '{tmp_path / 'warehouse.yaml'}'?"


def test_a_missing_file_that_resembles_none_lists_the_shipped_worlds(tmp_path):
    problem = refused(tmp_path / "nowhere" / "zzz.yaml")
    assert problem.endswith(
        f"there is no such world file; name a file or one of the shipped worlds: {', '.join(navsim.shipped_worlds())}"
    )


def test_a_directory_is_not_a_world_file(tmp_path):
    assert refused(tmp_path) == f"{tmp_path}: is a directory, not a world file; name a file such as 'room.yaml'"


def test_a_file_too_large_to_be_a_world_is_not_read_as_one(tmp_path):
    with open(tmp_path / "huge.yaml", "wb") as file:
        file.truncate(LARGEST_FILE + 1)
    assert refused(tmp_path / "huge.yaml").endswith("is larger than 16 MiB; split it into several worlds")


def test_errors_of_a_file_name_the_file(tmp_path):
    (tmp_path / "room.yaml").write_text(ROOM + "wall: none\n")
    assert refused(tmp_path / "room.yaml") == (
        f"{tmp_path / 'room.yaml'}:3:1: wall: is not a known key; did you mean 'walls'?"
    )


def test_shipped_worlds_are_found_by_name_from_any_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = navsim.shipped_worlds()
    assert {"simple_train", "simple_eval", "complex_train", "complex_eval"} <= set(names)
    assert load_world("simple_train").name == "simple_train"
    assert load_world("simple_train") == load_world(navsim.SHIPPED_WORLDS_DIRECTORY / "simple_train.yaml")


def test_a_file_goes_before_a_shipped_world_of_the_same_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("simple_train").write_text(ROOM + "name: mine\n")
    assert load_world("simple_train").name == "mine"


# Obstacles keep to |x|, |y| < 3 in a room of 14 x 14 m, so that starts and goals around them are free and connected.
numbers = st.floats(-2.0, 2.0)
sizes = st.floats(0.01, 1.0)
names = st.text(max_size=12) | st.sampled_from(["1e5", "+.5", "12:30", "no", "~", "a\nb", ": #", "<<", " x", "'", '"'])
shared = {"name": names, "base": st.floats(0.0, 2.0)}
points = st.tuples(numbers, numbers).map(list)


def shapes(kind: str, **settings) -> st.SearchStrategy[dict]:
    return st.fixed_dictionaries({**settings, "height": st.floats(0.01, 3.0)}, optional=shared).map(lambda s: {kind: s})


@st.composite
def outlines(draw) -> list[list[float]]:
    radii = draw(st.lists(st.floats(0.2, 2.0), min_size=3, max_size=8))
    angles = [math.tau * k / len(radii) for k in range(len(radii))]
    return [[r * math.cos(angle), r * math.sin(angle)] for r, angle in zip(radii, angles, strict=True)]


sides = st.floats(-6.0, 6.0)
starts = st.fixed_dictionaries(
    {"at": st.tuples(sides, st.floats(-6.0, -4.0)).map(list)}, optional={"yaw_deg": st.floats(-360, 360)}
)
goals = st.tuples(sides, st.floats(4.0, 6.0)).map(list)
worlds = st.fixed_dictionaries(
    {"format": st.just(1), "size": st.just([14.0, 14.0])},
    optional={
        "name": names.filter(bool),
        "walls": st.just("none") | st.fixed_dictionaries({}, optional={"height": sizes, "thickness": sizes}),
        "obstacles": st.lists(
            shapes("box", at=points, size=st.tuples(sizes, sizes).map(list), yaw_deg=st.floats(-360, 360))
            | shapes("cylinder", at=points, radius=sizes)
            | shapes("polygon", points=outlines()),
            max_size=5,
        ),
        "starts": st.just("random") | st.lists(starts, min_size=1, max_size=3),
        "goals": st.just("random") | st.lists(goals, min_size=1, max_size=3),
    },
).map(World.from_dict)


@settings(max_examples=60, deadline=None)
@given(worlds)
def test_any_world_survives_the_way_to_text_and_back(world):
    text = dump_world(world)
    assert parse_text(text.encode()) == world
    assert World.from_dict(world.to_dict()) == world


def test_a_saved_world_is_read_back_one_entry_a_line(tmp_path):
    world = parse_text(EXAMPLE)
    save_world(world, tmp_path / "saved.yaml")
    text = (tmp_path / "saved.yaml").read_text(encoding="utf-8")
    assert load_world(tmp_path / "saved.yaml") == world
    assert text.splitlines() == [
        "format: 1",
        "name: tabletop",
        "size: [7.0, 7.0]",
        "walls: {height: 1.5, thickness: 0.2}",
        "",
        "obstacles:",
        "  - box: {height: 0.8, at: [1.0, -0.5], size: [0.6, 0.4], yaw_deg: 30.0}",
        "  - cylinder: {height: 0.3, at: [-1.0, 1.2], radius: 0.15}",
        "  - polygon: {height: 1.0, points: [[0.0, 0.0], [1.0, 0.0], [0.4, 0.8]]}",
        "  - box: {name: table top, base: 0.7, height: 0.03, at: [0.0, 2.0], size: [1.2, 0.6]}",
        "",
        "starts:",
        "  - {at: [-2.0, 0.0], yaw_deg: 90.0}",
        "  - [3.0, 3.0]",
        "",
        "goals:",
        "  - [2.0, -2.5]",
    ]


@pytest.mark.parametrize(
    "name", ["1e5", "1e-3", "+.5", "a\nb", "null", "no", "x: y # z", "naïve", "\x85\u2028\0", "😀"]
)
def test_a_name_that_could_be_read_otherwise_is_quoted(name):
    obstacle = {"box": {"name": name, "at": [1, 1], "size": [1, 1], "height": 1}}
    world = World.from_dict({"format": 1, "name": name, "size": [7, 7], "obstacles": [obstacle]})
    text = dump_world(world)
    assert parse_text(text.encode()) == world
    assert len(text.split("\n")) == len(dump_world(world.model_copy(update={"name": "plain"})).split("\n"))


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_shipped_worlds_survive_the_way_to_text_and_back(name):
    assert parse_text(dump_world(load_world(name))) == load_world(name)


@settings(max_examples=120, deadline=None)
@given(st.data())
def test_whatever_is_typed_into_a_file_is_a_world_or_a_world_error(data):
    text = EXAMPLE
    for _ in range(data.draw(st.integers(1, 3))):
        begin = data.draw(st.integers(0, len(text)))
        end = min(len(text), begin + data.draw(st.integers(0, 8)))
        typed = st.text(alphabet=string.printable, max_size=4) | st.sampled_from(["&a ", "*a", "<<: *a", "\n", "!!x "])
        text = text[:begin] + data.draw(typed) + text[end:]
    problems: tuple[str, ...] = ()
    try:
        parse_text(text.encode(), source="room.yaml")
    except WorldError as error:
        problems = error.problems
    assert all(problem.startswith("room.yaml:") and "\n" not in problem for problem in problems)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=40))
def test_a_file_of_any_bytes_is_a_world_error(content):
    with pytest.raises(WorldError):
        parse_text(content)


def test_a_world_of_ten_thousand_obstacles_is_read():
    columns = range(100)
    boxes = "".join(
        f"  - box: {{at: [{2 * i - 99}, {2 * j - 99}], size: [0.5, 0.5], height: 1.0, yaw_deg: {(i + j) % 90}}}\n"
        for i in columns
        for j in columns
    )
    text = f"format: 1\nsize: [204, 204]\nobstacles:\n{boxes}starts: [[-101, -101]]\ngoals: [[101, 101]]\n"
    world = parse_text(text)
    assert len(world.obstacles) == 10_000
    assert world.obstacles[-1].at == (99.0, 99.0)
    assert world.obstacles[-1].name == "box 10000"
    assert len(world.prisms) == 10_004
    assert shapely.Polygon(world.prisms[5000].vertices).area == pytest.approx(0.25)


def test_an_interrupted_save_leaves_the_file_that_was_there(tmp_path, monkeypatch):
    file = tmp_path / "room.yaml"
    world = parse_text(EXAMPLE)
    save_world(world, file)
    before = file.read_text()

    def fail(*_):
        raise OSError(28, "No space left on device", "room.yaml")

    for broken in ("os.fsync", "os.replace"):
        with monkeypatch.context() as patch:
            patch.setattr(broken, fail)
            with pytest.raises(OSError, match="No space left"):
                save_world(world.replace(name="other"), file)
        assert file.read_text() == before
        assert [path.name for path in tmp_path.iterdir()] == ["room.yaml"]


def test_a_save_keeps_permissions_and_links(tmp_path):
    file, link = tmp_path / "room.yaml", tmp_path / "link.yaml"
    file.write_text("")
    file.chmod(0o640)
    link.symlink_to(file)
    save_world(parse_text(EXAMPLE), link)
    assert link.is_symlink()
    assert load_world(file) == parse_text(EXAMPLE)
    assert file.stat().st_mode & 0o777 == 0o640
    (tmp_path / "plain").write_text("")
    save_world(parse_text(EXAMPLE), tmp_path / "new.yaml")
    assert (tmp_path / "new.yaml").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_problem_with_a_key_that_is_left_out_is_shown_where_it_is_missing():
    assert problem_of("# small\nformat: 1\nsize: [0.3, 0.3]\n").startswith("room.yaml:2:1: starts: there is no room")


@pytest.mark.parametrize(("character", "code"), [("\x0c", "U+000C"), ("\x00", "U+0000"), ("\x7f", "U+007F")])
def test_a_control_character_is_named_with_its_place(character, code):
    text = f"{ROOM}# a stray {character} here\nname: x\n"
    place = f"{ROOM.count(chr(10)) + 1}:11"
    assert (
        problem_of(text) == f"room.yaml:{place}: not YAML: the control character {code}, which is not shown; remove it"
    )


def test_a_directory_does_not_hide_a_shipped_world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "complex_eval").mkdir()
    assert load_world("complex_eval").name == "complex_eval"
