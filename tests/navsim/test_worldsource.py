"""Worlds by their source: files, names, generated rooms, and how mistakes are told."""

from __future__ import annotations

import pytest

from navsim import WorldError, generate_world, load_world, worlds_from
from navsim.generate import RoomSettings
from navsim.worldfile import dump_world
from navsim.worldsource import (
    TRAINING_SEED,
    GeneratedRooms,
    check_sources,
    have_rooms_in_common,
    parse_size,
    parse_source,
    short_name,
)


def test_a_source_names_kind_size_density_seed_and_count():
    source = "generate:office, size=8x6.5, density=0.12, seed=3, count=20"
    assert parse_source(source) == GeneratedRooms(RoomSettings("office", (8.0, 6.5), 0.12, 3), 20)
    assert parse_source("generate:blocks,size=5") == GeneratedRooms(RoomSettings("blocks", (5.0, 5.0)), 1)


def test_files_names_worlds_and_generated_rooms_may_be_mixed(tmp_path):
    file = tmp_path / "room.yaml"
    file.write_text("format: 1\nsize: [4, 4]\n")
    world = load_world("simple_eval")
    sources = [str(file), "generate:blocks,seed=4,count=2", world, "simple_train", file]
    expected = [
        load_world(file),
        generate_world("blocks", seed=4),
        generate_world("blocks", seed=4, index=1),
        world,
        load_world("simple_train"),
        load_world(file),
    ]
    assert worlds_from(sources) == expected
    assert worlds_from(sources[1]) == expected[1:3]
    assert worlds_from(world) == [world]


def test_fewer_rooms_are_the_first_of_more():
    assert worlds_from("generate:forest,count=3")[:2] == worlds_from("generate:forest,count=2")


def test_the_default_seed_is_for_sources_that_name_none():
    assert worlds_from("generate:blocks", default_seed=9) == worlds_from("generate:blocks,seed=9")
    assert worlds_from("generate:blocks,seed=2", default_seed=9) == worlds_from("generate:blocks,seed=2")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("generate:cluter", '"cluter" is not a kind of room; did you mean "clutter"?'),
        ("generate:", '"" is not a kind of room; there are clutter, blocks, corridors, office, warehouse, forest'),
        ("generate:clutter,densty=0.3", '"densty" is not a setting of generated rooms; did you mean "density"?'),
        ("generate:clutter,walls=2", "there are size, density, seed, count"),
        ("generate:clutter,density", '"density" has no value; write density=0.11'),
        ("generate:clutter,density=", '"density" has no value; write density=0.11'),
        ("generate:clutter,density=high", 'density must be a share of the floor, such as 0.11; got "high"'),
        ("generate:clutter,density=2", "at most 0.6; got 2"),
        ("generate:clutter,size=7x7x7", 'size must be two lengths in metres, such as 7x6; got "7x7x7"'),
        ("generate:clutter,size=700", "size must be two lengths from 2 to 60 m; got 700 by 700"),
        ("generate:clutter,seed=one", 'seed must be a whole number; got "one"'),
        ("generate:clutter,seed=-1", "seed must be a whole number, at least 0; got -1"),
        ("generate:clutter,count=0", "count must be from 1 to 100000; got 0"),
        ("generate:clutter,count=1.5", 'count must be a whole number; got "1.5"'),
        ("generate:clutter,seed=1,seed=2", '"seed" is given twice; leave one of them out'),
    ],
)
def test_mistakes_are_told_in_one_sentence(source, message):
    with pytest.raises(WorldError) as caught:
        check_sources(["complex_train", source])
    assert str(caught.value).startswith(f"{source}: ")
    assert message in str(caught.value)
    assert len(caught.value.problems) == 1


def test_settings_that_no_room_fulfils_are_told_with_their_source():
    with pytest.raises(WorldError, match=r"^generate:office,size=4x4: an office needs a room with a side of at least"):
        worlds_from("generate:office,size=4x4")


def test_rooms_to_train_in_and_to_evaluate_in_are_others_unless_seeds_say_so(tmp_path):
    same = "generate:clutter,count=5"
    assert not have_rooms_in_common([same], [same], TRAINING_SEED)
    assert have_rooms_in_common(["simple_train", "generate:clutter,seed=1,count=5"], ["generate:clutter,seed=1"])
    assert not have_rooms_in_common(["generate:clutter,seed=1"], ["generate:clutter,seed=1,density=0.1"])
    assert have_rooms_in_common(["generate:clutter"], [f"generate:clutter,seed={TRAINING_SEED}"], TRAINING_SEED)
    assert have_rooms_in_common(["complex_train"], ["complex_train"])
    assert not have_rooms_in_common(["complex_train"], ["complex_eval"])
    elsewhere = load_world("complex_eval").model_copy(update={"goals": "random"})
    assert have_rooms_in_common([elsewhere], ["complex_eval"])
    (tmp_path / "copy.yaml").write_text(dump_world(load_world("complex_eval")))
    assert have_rooms_in_common([str(tmp_path / "copy.yaml")], ["complex_eval"])
    assert not have_rooms_in_common([str(tmp_path / "copy.yaml")], ["complex_train"])
    assert not have_rooms_in_common([str(tmp_path / "missing.yaml")], ["complex_train"])


def test_names_for_directories_keep_the_settings():
    assert short_name("generate:clutter, density=0.11") == "clutter,density=0.11"
    assert short_name("worlds/a.b.yaml") == "a.b"
    assert short_name(load_world("simple_train")) == "simple_train"


def test_sizes_are_written_in_several_ways():
    assert parse_size("7x6") == parse_size("7,6") == parse_size("7 X 6") == (7.0, 6.0)
    assert parse_size("5") == (5.0, 5.0)
