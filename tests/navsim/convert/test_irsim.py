"""IR-SIM worlds: what becomes what, and what is listed because it cannot."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from navsim.convert import ConversionError, Room, load_irsim
from navsim.convert.irsim import read_irsim
from navsim.convert.scene import data_of

DATA = Path(__file__).parent / "data" / "irsim.yaml"


def read(tmp_path: Path, text: str):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    return read_irsim(path)


def test_shapes_states_and_the_offset_are_kept():
    world, notes = load_irsim(DATA, wall_height=1.2)
    assert (world.size, world.walls.height) == ((10.0, 8.0), 1.2)
    found = {obstacle.name: obstacle for obstacle in world.obstacles}
    assert all(obstacle.height == 1.2 and obstacle.base == 0.0 for obstacle in found.values())
    # The world reaches from (-1, -2) to (9, 6): its centre is (4, 2).
    assert (found["obstacle 1"].at, found["obstacle 1"].radius) == ((0.0, 0.5), 0.5)
    assert (found["obstacle 2"].at, found["obstacle 2"].size) == ((2.0, 2.0), (1.5, 0.4))
    assert found["obstacle 2"].yaw_deg == pytest.approx(math.degrees(1.0), abs=1e-5)
    dealt = [found[f"obstacle 3.{i}"] for i in (1, 2, 3)]
    assert [(obstacle.kind, obstacle.at) for obstacle in dealt] == [
        ("cylinder", (-4.0, -1.0)), ("box", (-4.0, 0.0)), ("box", (-4.0, 1.0))
    ]  # fmt: skip
    assert found["obstacle 4"].points[3] == (2.3, -1.7)
    assert (found["obstacle 5 1"].at, found["obstacle 5 1"].size) == ((-1.5, -3.0), (1.02, 0.02))
    ring = [found[f"obstacle 8.{i}"].at for i in (1, 2, 3, 4)]
    assert np.allclose(ring, [(0.5, 2.0), (-1.0, 3.5), (-2.5, 2.0), (-1.0, 0.5)])
    assert found["obstacle 9 1"].yaw_deg == pytest.approx(90.0)
    assert found["obstacle 9 2"].at == pytest.approx((4.0, 0.3))
    assert [(start.at, start.yaw_deg) for start in world.starts] == [
        ((-4.0, -3.0), pytest.approx(90.0, abs=1e-3)), ((-2.0, 0.0), 0.0)
    ]  # fmt: skip
    assert [goal.at for goal in world.goals] == [(4.0, 3.0), (-4.0, 3.0), (3.0, -3.0)]
    for name, reason in (
        ("obstacle 6", "unobstructed"), ("obstacle 7", "random_shape"), ("robot 2", "distribution random"),
        ("obstacle 5", "20 mm thick"),
    ):  # fmt: skip
        assert any(f"'{name}'" in note and reason in note for note in notes), (name, notes)


def test_what_goes_round_for_ever_moves_and_what_does_not_is_listed(tmp_path):
    text = """
world: {width: 10, height: 10}
obstacle:
  - {kinematics: {name: omni}, shape: {name: circle, radius: 0.2}, state: [2, 2], goal: [6, 2], vel_max: [0.5, 0.5],
     behavior: {name: dash, loop: true}}
  - {kinematics: {name: diff}, shape: {name: circle, radius: 0.2}, state: [2, 4, 0], goal: [[[6, 4, 0], [6, 6, 0]]],
     behavior: {name: rvo, loop: true}}
  - {kinematics: {name: omni}, shape: {name: circle, radius: 0.2}, state: [2, 8], goal: [6, 8], behavior: {name: dash}}
  - {kinematics: {name: omni}, shape: {name: circle, radius: 0.2}, state: [8, 8], behavior: {name: dash, wander: true}}
  - {shape: {name: circle, radius: 0.2}, state: [8, 1], goal: [6, 8], behavior: {name: dash, loop: true}}
"""
    scene = read(tmp_path, text)
    data, notes = data_of(scene, Room())
    moving = [entry["cylinder"].get("motion") for entry in data["obstacles"]]
    assert moving == [
        {"path": [[-3.0, -3.0], [1.0, -3.0]], "speed": 0.5},
        {"path": [[-3.0, -1.0], [1.0, -1.0], [1.0, 1.0]], "speed": 1.0, "repeat": "circuit"},
        None, None, None,
    ]  # fmt: skip
    for name, reason in (
        ("obstacle 2", "makes way for nobody"), ("obstacle 2", "passes its first place"), ("obstacle 3", "no loop"),
        ("obstacle 4", "wander"),
    ):  # fmt: skip
        assert any(f"'{name}'" in note and reason in note for note in notes), (name, notes)


def test_a_round_that_ends_where_it_begins_is_one(tmp_path):
    text = """
world: {width: 10, height: 10}
obstacle:
  - {kinematics: {name: omni}, shape: {name: circle, radius: 0.2}, state: [2, 4],
     goal: [[[6, 4], [6, 6], [2, 4]]], behavior: {name: dash, loop: true}}
"""
    path = tmp_path / "world.yaml"
    path.write_text(text)
    world, notes = load_irsim(path)
    assert world.obstacles[0].motion.path == ((-3.0, -1.0), (1.0, -1.0), (1.0, 1.0))
    assert world.obstacles[0].motion.is_circuit
    assert not any("first place" in note for note in notes)


def test_a_way_that_is_not_free_is_left_out_and_listed(tmp_path):
    text = """
world: {width: 10, height: 10}
obstacle:
  - {kinematics: {name: omni}, shape: {name: circle, radius: 0.2}, state: [2, 5], goal: [8, 5],
     behavior: {name: dash, loop: true}}
  - {shape: {name: circle, radius: 0.5}, state: [5, 5]}
"""
    path = tmp_path / "world.yaml"
    path.write_text(text)
    world, notes = load_irsim(path)
    assert [obstacle.motion for obstacle in world.obstacles] == [None, None]
    assert any("left out" in note and "obstacles[0].cylinder.motion" in note for note in notes)


def test_merge_keys_fill_in_what_an_entry_lacks(tmp_path):
    text = """
common: &common {shape: {name: circle, radius: 0.3}, state: [1, 1]}
obstacle:
  - <<: *common
  - {<<: [*common], state: [2, 3]}
"""
    solids = read(tmp_path, text).solids
    assert [(solid.radius, solid.centre) for solid in solids] == [(0.3, (1.0, 1.0)), (0.3, (2.0, 3.0))]


def test_an_obstacle_map_is_read(tmp_path):
    pixels = np.full((40, 80), 255, dtype=np.uint8)
    pixels[0:10, 60:80] = 0  # the upper right corner
    Image.fromarray(pixels).save(tmp_path / "map.png")
    for every, size in ((1, 1.0), (2, 1.0)):
        scene = read(tmp_path, f"world: {{width: 8, height: 4, obstacle_map: map.png, mdownsample: {every}}}")
        (patch,) = scene.solids
        low, high = np.min(patch.points, axis=0), np.max(patch.points, axis=0)
        assert np.allclose([low, high], [(6.0, 3.0), (8.0, 3.0 + size)])


def test_a_picture_map_may_have_settings_and_other_generators_are_left_out(tmp_path):
    Image.fromarray(np.pad(np.zeros((10, 10), dtype=np.uint8), 20, constant_values=255)).save(tmp_path / "map.png")
    scene = read(tmp_path, "world: {width: 5, height: 5, obstacle_map: {name: image, path: map.png}}")
    assert len(scene.solids) == 1
    scene = read(tmp_path, "world: {width: 5, height: 5, obstacle_map: {name: perlin, seed: 3}}")
    assert scene.solids == []
    assert any("only pictures are read" in note for note in scene.notes)


def test_colours_of_a_map_are_as_bright_as_ir_sim_takes_them_for(tmp_path):
    pixels = np.full((40, 60, 3), 255, dtype=np.uint8)
    pixels[5:15, 5:15] = (255, 0, 255)  # magenta, 0.41 of white by IR-SIM's _rgb2gray, and two thirds by the mean
    pixels[5:15, 40:50] = (0, 255, 0)  # green, 0.59 and a third
    Image.fromarray(pixels).save(tmp_path / "map.png")
    (patch,) = read(tmp_path, "world: {width: 6, height: 4, obstacle_map: map.png}").solids
    assert np.allclose([np.min(patch.points, axis=0), np.max(patch.points, axis=0)], [(0.5, 2.5), (1.5, 3.5)])


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "the file is empty"),
        ("[1, 2]", "must be a mapping"),
        ("name: nothing", "none of the keys"),
        ("world: 3", "world.yaml:1: world: must be settings"),
        ("world: {width: -1}", "world.width: must be greater than 0"),
        ("world: {width: .inf}", "must be a finite number"),
        ("obstacle:\n  - 5", "world.yaml:2: obstacle[0]: must be settings"),
        ("obstacle:\n  - shape: {radius: 1}", "world.yaml:2: obstacle[0].shape: key 'name' is missing"),
        ("obstacle:\n  - state: [1, .nan]", "obstacle[0].state[1]: must be a finite number"),
        ("obstacle:\n  - number: 1000000000", "number: must lie between 0 and 10000"),
        ("obstacle:\n  - distribution: {name: gauss}", "must be manual, circle or random"),
        ("world: {width: 10", "not YAML"),
        ("world: &a {width: *a}", "nested deeper than 50 levels"),
        ("world: !!python/object:os.system {}", "the tag"),
    ],
)
def test_errors_name_file_line_and_key(tmp_path, text, part):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    with pytest.raises(ConversionError) as error:
        load_irsim(path)
    assert part in str(error.value)
    assert "\n" not in str(error.value)


def test_only_what_reaches_into_the_room_counts_as_cut_off(tmp_path, monkeypatch):
    monkeypatch.setattr("navsim.convert.scene.MOST_CUT", 150)  # a circle of 0.2 m has 100 corners
    path = tmp_path / "world.yaml"
    scene = "world: {{height: 10, width: 10}}\nobstacle: [{{number: 5, state: [{}, 5]}}, {{state: [0.1, 5]}}]\n"
    path.write_text(scene.format(30))
    assert len(load_irsim(path)[0].obstacles) == 1
    path.write_text(scene.format(-0.1))
    with pytest.raises(ConversionError, match="outlines of more than 150 corners reach out of the room"):
        load_irsim(path)
