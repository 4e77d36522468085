"""Edits of a text: the world says what was meant, and nothing else in the text has moved."""

from __future__ import annotations

import copy
import difflib
import random
import re

import pytest
from hypothesis import Phase, assume, given, note, settings
from hypothesis import strategies as st
from yaml_styles import Writer, degrees, lengths, outlines, places, points, shapes, worlds

import navsim
from navsim.editor.patch import EditError, dependants, entries, patched
from navsim.editor.reading import Sketch, read_world
from navsim.editor.scene import describe
from navsim.editor.yamltree import Tree

ROOM = "format: 1\nsize: [8, 8]\n"
LINE_BREAK = re.compile(r"(?<=\n)|(?<=\r)(?!\n)")


def meaning(text: str) -> dict:
    world = read_world(text).world
    assert world is not None
    return world.to_dict()


def lines_of(text: str) -> list[str]:
    return [line for line in LINE_BREAK.split(text) if line]


def changed_lines(old: str, new: str) -> set[int]:
    """Lines of the old text, counted from 0, that are not in the new one."""
    matcher = difflib.SequenceMatcher(None, lines_of(old), lines_of(new), autojunk=False)
    kept = {block.a + i for block in matcher.get_matching_blocks() for i in range(block.size)}
    return set(range(len(lines_of(old)))) - kept


def lines_of_entry(text: str, name: str, index: int) -> set[int]:
    """Where an entry stands, from its dash on, counted from 0."""
    tree = Tree(text.removeprefix("\ufeff"))
    values = tree.root.own(name).meant
    node = values.items[index]
    start = node.start
    if not values.flow:
        start = tree.find("-", values.items[index - 1].end, start) if index else values.content
    first = len(lines_of(tree.text[: tree.line_start(start)]))
    return set(range(first, first + len(lines_of(tree.text[tree.line_start(start) : node.end]))))


def lines_of_settings_taken_out(text: str, edit: dict) -> set[int]:
    """Lines that hold nothing but a setting that the edit sets to None, counted from 0."""
    tree = Tree(text.removeprefix("\ufeff"))
    name, index = edit["where"]
    node = tree.root.own(name).meant.items[index].meant
    settings = node.pairs[0][1].meant if name == "obstacles" else node
    lines = set()
    for key, value in settings.pairs if not settings.flow else ():
        if key.key in edit["values"] and edit["values"][key.key] is None and tree.is_first_on_line(key.start):
            first = len(lines_of(tree.text[: tree.line_start(key.start)]))
            lines |= set(range(first, first + len(lines_of(tree.text[tree.line_start(key.start) : value.end]))))
    return lines


@st.composite
def edits_of(draw, data: dict):
    """An edit of ``data``, and the data that it should make of it."""
    data = copy.deepcopy(data)
    lists = [name for name in ("obstacles", "starts", "goals") if isinstance(data.get(name), list) and data[name]]
    ops = ["add", "world", *(["set", "set", "set", "remove"] if lists else [])]
    op = draw(st.sampled_from(ops))
    if op == "world":
        values = draw(
            st.fixed_dictionaries(
                {},
                optional={
                    "size": st.tuples(st.integers(8, 9), st.sampled_from([8.5, 9.25])).map(list),
                    "name": st.sampled_from(["hall", "a: b", "7"]),
                    "walls": st.just("none") | st.fixed_dictionaries({"height": lengths, "thickness": lengths}),
                },
            )
        )
        return {"op": "set", "where": [], "values": values}, {**data, **values}
    if op == "add":
        name = draw(st.sampled_from(["obstacles", "starts", "goals"]))
        entry = draw(shapes() if name == "obstacles" else places if name == "starts" else points)
        before = data[name] if isinstance(data.get(name), list) else []
        index = draw(st.none() | st.integers(0, len(before)))
        place = len(before) if index is None else index
        data[name] = [*before[:place], entry, *before[place:]]
        return {"op": "add", "list": name, "entry": entry, **({} if index is None else {"index": index})}, data
    name = draw(st.sampled_from(lists))
    index = draw(st.integers(0, len(data[name]) - 1))
    if op == "remove":
        del data[name][index]
        if not data[name] and name != "obstacles":
            data[name] = "random"
        return {"op": "remove", "where": [name, index]}, data
    entry = data[name][index]
    if name == "obstacles":
        ((kind, now),) = entry.items()
        offered = {"name": st.sampled_from(["desk", "a: b", "é", "12"]), "base": lengths, "height": lengths}
        offered |= {
            "box": {"at": points, "size": st.tuples(lengths, lengths).map(list), "yaw_deg": degrees},
            "cylinder": {"at": points, "radius": lengths},
            "polygon": {"points": outlines()},
        }[kind]
        offered |= {key: st.none() for key in ("name", "yaw_deg", "base") if key in now and draw(st.booleans())}
    else:
        now = entry if isinstance(entry, dict) else {"at": entry}
        offered = {"at": points} | ({"yaw_deg": degrees | st.none()} if name == "starts" else {})
    values = draw(st.fixed_dictionaries({}, optional=offered))
    new = {key: value for key, value in {**now, **values}.items() if value is not None}
    if name == "obstacles":
        data[name][index] = {kind: new}
    else:
        data[name][index] = new
    return {"op": "set", "where": [name, index], "values": values}, data


def check_edit(text: str, edit: dict, intended: dict, comments: list[str]) -> str:
    """Makes the edit and checks it from outside; returns the new text."""
    note(text)
    note(edit)
    new = patched(text, [edit])
    note(new)
    assert meaning(new) == Sketch.model_validate({"name": "world", **intended}).to_dict()
    allowed, gone = set(), ""
    if edit["op"] != "add" and edit["where"]:
        own_lines = lines_of_entry(text, *edit["where"])
        allowed |= own_lines
        taken_out = own_lines if edit["op"] == "remove" else lines_of_settings_taken_out(text, edit)
        gone = "".join(lines_of(text.removeprefix("\ufeff"))[i] for i in taken_out)
    missing = [comment for comment in comments if comment not in new and comment not in gone]
    assert not missing
    old_breaks = set(re.findall(r"\r\n|\n|\r", text))
    assert set(re.findall(r"\r\n|\n|\r", new)) <= (old_breaks or {"\n"})
    changed = changed_lines(text.removeprefix("\ufeff"), new.removeprefix("\ufeff"))
    if edit["op"] == "set" and edit["where"] and "&" not in text:
        assert changed <= allowed
    if edit["op"] == "set" and edit["where"]:
        assert len(changed) <= len(allowed)
    if edit["op"] == "add" and "&" not in text:
        assert len(changed) <= 1
    return new


texts = given(
    worlds, st.randoms(use_true_random=False), st.sampled_from(["\n", "\n", "\r\n"]), st.booleans(), st.data()
)


def check_edits(data, chance, line_break, with_mark, draws) -> None:
    writer = Writer(chance, line_break)
    text = ("\ufeff" if with_mark else "") + writer.document(data)
    note(text)
    assume(meaning(text) == Sketch.model_validate({"name": "world", **data}).to_dict())
    for _ in range(2):
        edit, intended = draws.draw(edits_of(data))
        if edit["op"] == "set":
            tree = Tree(text.removeprefix("\ufeff"))
            places = [edit["where"]] if edit["where"] else [[key] for key in edit["values"] if tree.root.own(key)]
            if any(dependants(tree, place) for place in places):
                return  # what others share is another test's
        refusal = None
        try:
            text = check_edit(text, edit, intended, [c for c in writer.comments if c in text])
        except EditError as error:
            refusal = str(error)
        if refusal is not None:  # what the entry says itself can be taken out, what it says by "<<" as well cannot
            assert re.fullmatch(r"'\w+' comes from a merge key \('<<'\) here; take it out in the text", refusal)
            assert None in edit["values"].values()
            return
        data = intended


# Reports are long, and shrinking them takes minutes: what fails is shown as it was drawn.
PHASES = [Phase.explicit, Phase.reuse, Phase.generate]


@settings(max_examples=60, deadline=None, phases=PHASES)
@texts
def test_any_edit_of_any_style_says_what_was_meant_and_touches_nothing_else(data, chance, line_break, with_mark, draws):
    check_edits(data, chance, line_break, with_mark, draws)


@pytest.mark.slow
@settings(max_examples=1000, deadline=None, phases=PHASES)
@texts
def test_many_edits_of_many_styles(data, chance, line_break, with_mark, draws):
    check_edits(data, chance, line_break, with_mark, draws)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(navsim.shipped_worlds()), st.data())
def test_an_edit_of_a_shipped_world_changes_the_lines_concerned_only(name, draws):
    text = (navsim.SHIPPED_WORLDS_DIRECTORY / f"{name}.yaml").read_text()
    data = meaning(text)
    edit, intended = draws.draw(edits_of(data))
    comments = [line.strip() for line in text.splitlines() if line.strip().startswith("#")]
    check_edit(text, edit, intended, comments)


def set_in(text: str, where: list, **values) -> str:
    return patched(text, [{"op": "set", "where": where, "values": values}])


def test_numbers_keep_the_style_of_those_they_replace():
    text = ROOM + "obstacles:\n  - box: {at: [1, 2.50], size: [1.0, 2], height: 3e-1, yaw_deg: 30}  # a desk\n"
    moved = set_in(text, ["obstacles", 0], at=[2, 3], size=[2, 1], height=1.0, yaw_deg=45.0)
    assert moved.endswith("  - box: {at: [2, 3.0], size: [2.0, 1], height: 1.0, yaw_deg: 45}  # a desk\n")
    assert set_in(text, ["obstacles", 0], at=[1.25, 2.5]) == text.replace("[1, 2.50]", "[1.25, 2.50]")
    assert set_in(text, ["obstacles", 0], at=[-0.0, 1e-7]) == text.replace("[1, 2.50]", "[0, 1e-07]")


def test_settings_of_an_entry_that_share_a_value_part_when_one_is_set():
    text = ROOM + "obstacles:\n  - box: {at: [1, 2], size: [&a 3.0, &b 2.0], base: *a, height: *b}\n"
    set_in_one = set_in(text, ["obstacles", 0], size=[3.0, 0.5])
    assert set_in_one.endswith("  - box: {at: [1, 2], size: [&a 3.0, &b 0.5], base: *a, height: 2.0}\n")
    set_in_both = set_in(text, ["obstacles", 0], size=[0.25, 0.5], height=1.0)
    assert set_in_both.endswith("  - box: {at: [1, 2], size: [&a 0.25, &b 0.5], base: 3.0, height: 1.0}\n")
    text = "format: 1\nsize: [&a 8.0, *a]\n"
    assert patched(text, [{"op": "set", "where": [], "values": {"size": [4.0, 8.0]}}]) == text.replace(
        "[&a 8.0, *a]", "[&a 4.0, 8.0]"
    )


def test_a_setting_that_a_merge_key_gives_as_well_is_not_taken_out():
    text = ROOM + (
        "obstacles:\n"
        "  - box: &a {at: [1, 2], size: [3, 2], base: 0.5, height: 1}\n"
        "  - box: {<<: *a, at: [2, 2], base: 1}\n"
    )
    with pytest.raises(EditError, match="'base' comes from a merge key"):
        set_in(text, ["obstacles", 1], base=None)


def test_a_number_that_stays_stays_as_it_is_written():
    text = ROOM + "obstacles:\n  - cylinder: {at: [1.1234567891, 2.000], radius: +.5, height: 1}\n"
    assert set_in(text, ["obstacles", 0], at=[1.1234567891, 2], radius=0.5) == text


def test_a_new_setting_is_written_where_such_files_have_it():
    flow = ROOM + "obstacles:\n  - box: {at: [1, 2], size: [1, 1], height: 1}\n"
    assert "{name: desk, at: [1, 2], size: [1, 1], base: 0.5, height: 1, yaw_deg: 30}" in set_in(
        flow, ["obstacles", 0], yaw_deg=30, base=0.5, name="desk"
    )
    block = (
        ROOM + "obstacles:\n  - box:\n      # where\n      at: [1, 2]  # x, y\n      size: [1, 1]\n      height: 1\n"
    )
    assert set_in(block, ["obstacles", 0], base=0.5) == block.replace("[1, 1]\n", "[1, 1]\n      base: 0.5\n")
    json = '{"format": 1, "size": [8, 8], "obstacles": [{"cylinder": {"at": [0, 0], "radius": 1, "height": 1}}]}'
    assert '"radius": 1, "base": 2, "height": 1' in set_in(json, ["obstacles", 0], base=2)


def test_names_keep_their_quotes_and_get_them_where_needed():
    text = ROOM + "obstacles:\n  - box: {name: 'a', at: [1, 2], size: [1, 1], height: 1}\n"
    assert "name: 'it''s'" in set_in(text, ["obstacles", 0], name="it's")
    plain = text.replace("'a'", "a")
    assert "name: desk 2" in set_in(plain, ["obstacles", 0], name="desk 2")
    for name in ("12", "a, b", "no: yes", "}", "a #b", "~", "", " x"):
        assert meaning(set_in(plain, ["obstacles", 0], name=name))["obstacles"][0]["box"].get("name", "") == name


def test_a_merged_setting_is_overridden_in_the_entry_alone():
    text = ROOM + (
        "obstacles:\n"
        "  - cylinder: &post {at: [1, 1], radius: 0.1, height: 1.5}  # the model\n"
        "  - cylinder: {<<: *post, at: [2, 2]}\n"
        "  - cylinder: *post\n"
    )
    assert set_in(text, ["obstacles", 1], radius=0.2, at=[3, 2]) == text.replace(
        "at: [2, 2]", "at: [3, 2], radius: 0.2"
    )
    assert set_in(text, ["obstacles", 2], at=[0, 1]) == text.replace(": *post\n", ": {<<: *post, at: [0.0, 1.0]}\n")
    of_the_model = set_in(text, ["obstacles", 0], radius=0.3)
    assert of_the_model == text.replace("radius: 0.1", "radius: 0.3")
    assert [o.radius for o in read_world(of_the_model).world.obstacles] == [0.3, 0.3, 0.3]


def test_entries_that_share_with_another_are_told():
    text = ROOM + (
        "starts: &places\n  - [0, 0]\n  - &b [1, 1]\ngoals:\n  - *b\n  - [3, 3]\n"
        "obstacles:\n  - box: &box {at: [-2, -2], size: [1, 1], height: 1}\n  - box: {<<: *box, at: [2, -2]}\n"
    )
    tree = Tree(text)
    found = {(name, i): dependants(tree, (name, i)) for name, i, _ in entries(tree)}
    assert {where: others for where, others in found.items() if others} == {
        ("starts", 1): [("goals", 0)],
        ("obstacles", 0): [("obstacles", 1)],
    }


def test_an_anchor_outlives_the_entry_that_it_was_given_in():
    text = ROOM + (
        "obstacles:\n"
        "  - cylinder: &post {at: &spot [1, 1], radius: 0.1, height: 1.5}\n"
        "  - cylinder: {<<: *post, at: [2, 2]}\n"
        "  - box: {at: *spot, size: [1, 1], height: 2}\n"
        "  - cylinder: *post\n"
    )
    rest = patched(text, [{"op": "remove", "where": ["obstacles", 0]}])
    assert [o.at for o in read_world(rest).world.obstacles] == [(2, 2), (1, 1), (1, 1)]
    assert "<<: &post {at: &spot [1, 1], radius: 0.1, height: 1.5}, at: [2, 2]}" in rest
    assert "{at: *spot, size" in rest


def test_a_list_that_is_drawn_or_missing_is_begun_and_ends_so():
    text = ROOM + "starts: random  # anywhere\n"
    begun = patched(
        text,
        [
            {"op": "add", "list": "starts", "entry": {"at": [1, 2], "yaw_deg": 90}},
            {"op": "add", "list": "goals", "entry": [2, 2.5]},
        ],
    )
    assert begun == ROOM + "starts:  # anywhere\n  - {at: [1, 2], yaw_deg: 90}\n\ngoals:\n  - [2, 2.5]\n"
    ended = patched(begun, [{"op": "remove", "where": ["goals", 0]}, {"op": "remove", "where": ["starts", 0]}])
    assert ended == ROOM + "starts: random  # anywhere\n\ngoals: random\n"


def test_an_entry_is_added_in_the_style_of_its_neighbours():
    aligned = (
        ROOM
        + "obstacles:\n  - cylinder: {at: [0, 0], radius: 1, height: 1}\n"
        + "  - box:      {at: [1, 1], size: [1, 1], height: 1}\n"
    )
    can = {"cylinder": {"at": [2, 2], "radius": 0.5, "height": 1}}
    assert patched(
        aligned, [{"op": "add", "list": "obstacles", "entry": {"box": {"at": [3, 3], "size": [1, 1], "height": 2}}}]
    ).endswith("  - box:      {at: [3, 3], size: [1, 1], height: 2}\n")
    block = ROOM + "obstacles:\n- box:\n    at: [1, 1]\n    size: [1, 1]\n    height: 1  # low\n# the end\n"
    assert patched(block, [{"op": "add", "list": "obstacles", "entry": can}]) == block.replace(
        "# low\n", "# low\n- cylinder:\n    at: [2, 2]\n    radius: 0.5\n    height: 1\n"
    )
    lines = ROOM + "goals: [\n  [1, 1],  # door\n  [2, 2]   # window\n]\n"
    assert patched(lines, [{"op": "add", "list": "goals", "entry": [3, 3]}]) == lines.replace(
        "[2, 2]   # window\n", "[2, 2],   # window\n  [3, 3]\n"
    )


def test_comments_beside_what_is_taken_away_stay():
    compact = ROOM + "starts:\n  - yaw_deg: 30\n    # the middle\n    at: [0, 0]\n"
    assert set_in(compact, ["starts", 0], yaw_deg=None) == compact.replace("- yaw_deg: 30", "-")
    brackets = ROOM + "goals: [\n  [1, 1],  # door, one\n  [2, 2]  # window, two\n]\n"
    first, second = (patched(brackets, [{"op": "remove", "where": ["goals", i]}]) for i in (0, 1))
    assert meaning(first)["goals"] == [[2.0, 2.0]]
    assert meaning(second)["goals"] == [[1.0, 1.0]]
    assert all("# door, one" in text and "# window, two" in text for text in (first, second))
    dashes = ROOM + "goals:\n  - [1, 1]\n  # the door - left\n  -  # far\n    [2, 2]\n"
    assert patched(dashes, [{"op": "remove", "where": ["goals", 1]}]) == dashes.replace("  -  # far\n    [2, 2]\n", "")
    commas = ROOM + "goals: [[1, 1]  # here, there\n  , [2, 2]]\n"
    assert "# here, there" in patched(commas, [{"op": "remove", "where": ["goals", 1]}])


def test_comments_inside_what_is_written_anew_move_behind_it():
    block = ROOM + "starts:\n  - - 1  # east\n    - 2  # north\n"
    assert set_in(block, ["starts", 0], yaw_deg=90) == (
        ROOM + "starts:\n  - {at: [1, 2], yaw_deg: 90}  # north  # east\n"
    )


def test_a_corner_is_added_and_taken_away_in_place():
    text = (
        ROOM
        + "obstacles:\n  - polygon:\n      points:\n"
        + "        - [0, 0]  # door\n        - [2, 0]\n        - [0, 2]\n      height: 1\n"
    )
    more = set_in(text, ["obstacles", 0], points=[[0, 0], [2, 0], [2, 2], [0, 2]])
    assert more == text.replace("[2, 0]\n", "[2, 0]\n        - [2, 2]\n")
    assert set_in(more, ["obstacles", 0], points=[[0, 0], [2, 0], [0, 2]]) == text


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        ({"op": "paint"}, "'op' is 'set', 'add' or 'remove'"),
        ([], "'op' is 'set', 'add' or 'remove'"),
        ({"op": "set", "where": ["obstacles", 3], "values": {}}, "there is no obstacles[3] in the text; it has 1"),
        ({"op": "set", "where": ["obstacles", True], "values": {}}, "'where' of an edit must be"),
        ({"op": "set", "where": ["obstacles", -1], "values": {}}, "there is no obstacles[-1]"),
        ({"op": "set", "where": ["obstacles", 0], "values": [1]}, "'values' of an edit must be a mapping"),
        ({"op": "set", "where": ["obstacles", 0], "values": {"at": [float("nan"), 0]}}, "give a finite number"),
        ({"op": "set", "where": ["obstacles", 0], "values": {"name": "\ud800"}}, "lone surrogate"),
        ({"op": "set", "where": ["obstacles", 0], "values": {"at": [[[[[[[[[[1]]]]]]]]]]}}, "nested deeper"),
        ({"op": "add", "list": "walls", "entry": {}}, "'list' of an edit must be one of"),
        ({"op": "add", "list": "goals", "entry": None}, "what shall be added"),
        ({"op": "add", "list": "goals", "entry": [0, 0], "index": 5}, "a place in the list, 0 to 0"),
        ({"op": "remove", "where": ["goals", 0]}, "there is no goals[0]"),
    ],
)
def test_an_edit_that_makes_no_sense_is_refused_in_a_sentence(edit, told):
    text = ROOM + "obstacles:\n  - box: {at: [1, 2], size: [1, 1], height: 1}\n"
    with pytest.raises(EditError, match=re.escape(told)):
        patched(text, [edit])


def test_what_the_text_offers_no_place_for_is_refused_with_its_line():
    text = (
        ROOM
        + "obstacles:\n  - ? box\n    : ? at\n      : [1, 2]\n      ? size\n      : [1, 1]\n      ? height\n      : 1\n"
    )
    assert meaning(set_in(text, ["obstacles", 0], at=[2, 2]))["obstacles"][0]["box"]["at"] == [2.0, 2.0]
    with pytest.raises(EditError, match="line 4 is written leaves no place"):
        set_in(text, ["obstacles", 0], name="desk")


def test_random_texts_never_slip_through_unread():
    """Small damages to a file: what can still be read can be edited, or the edit is refused."""
    chance = random.Random(0)
    text = (navsim.SHIPPED_WORLDS_DIRECTORY / "simple_train.yaml").read_text()
    for _ in range(80):
        position = chance.randrange(len(text))
        damaged = text[:position] + chance.choice(["", " ", "\n", "#", "&a ", "'", "-", "]"]) + text[position + 1 :]
        reading = read_world(damaged)
        if reading.world is None or not reading.world.obstacles:
            continue
        try:
            moved = set_in(damaged, ["obstacles", 0], at=[0.125, 0.25])
        except EditError:
            continue
        assert read_world(moved).world.obstacles[0].at == (0.125, 0.25)


def test_obstacles_that_a_merge_key_gives_are_shown_but_not_changed():
    text = ROOM + (
        "<<:\n  obstacles:\n    - box: &a {at: [1, 2], size: [1, 1], height: 1}\n    - box: {<<: *a, at: [-1, 2]}\n"
    )
    assert [obstacle["at"] for obstacle in describe(read_world(text))["scene"]["obstacles"]] == [[1, 2], [-1, 2]]
    for edit in ({"op": "set", "values": {"at": [3, 3]}}, {"op": "remove"}):
        with pytest.raises(EditError, match="'obstacles' comes from a merge key"):
            patched(text, [{**edit, "where": ["obstacles", 0]}])
