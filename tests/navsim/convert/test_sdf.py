"""Gazebo worlds: what is read, where it comes to stand, what is listed; and the way there and back."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from same_view import assert_same_view, worlds

import navsim
from navsim.convert import ConversionError, Room, load_sdf, save_sdf
from navsim.convert.scene import data_of
from navsim.convert.sdf import read_sdf

DATA = Path(__file__).parent / "data"
BOX = "<geometry><box><size>1 0.5 0.8</size></box></geometry>"
CAN = "<geometry><cylinder><radius>0.2</radius><length>0.6</length></cylinder></geometry>"


def world_file(directory: Path, content: str, version: str = "1.9", name: str = "test.sdf") -> Path:
    path = directory / name
    path.write_text(f"<sdf version='{version}'><world name='test'>{content}</world></sdf>")
    return path


def model(content: str, name: str = "m", pose: str = "", static: str = "<static>true</static>") -> str:
    return f"<model name='{name}'>{static}{pose}{content}</model>"


def link(geometry: str, pose: str = "", link_pose: str = "", name: str = "link", tag: str = "collision") -> str:
    return f"<link name='{name}'>{link_pose}<{tag} name='c'>{pose}{geometry}</{tag}></link>"


def the_only(scene):
    (solid,) = scene.solids
    return solid


# Shapes and poses


def test_a_room_in_the_manner_of_public_worlds_is_read_whole():
    world, notes = load_sdf(DATA / "lab.world")
    assert (world.name, world.size) == ("lab", (6.0, 5.0))
    assert world.walls == navsim.world.Walls(height=0.5, thickness=0.15)
    found = {obstacle.name: obstacle for obstacle in world.obstacles}
    assert set(found) == {
        *("shelf A left", "shelf A right", "shelf A board", "crate", "island block", "island pole", "island step"),
        "odds and ends",
    }
    # The room's centre is at (2, 3) in the file.
    assert found["crate"].at == (-1.0, 1.0)
    assert found["crate"].yaw_deg == pytest.approx(30.0)
    assert found["shelf A board"].at == pytest.approx((1.0, -0.8), abs=1e-5)
    assert (found["shelf A board"].base, found["shelf A board"].height) == pytest.approx((0.59, 0.02))
    # On its side: 0.6 x 1 x 0.2 turned by 90 degrees about x stands 1 m high on 0.6 x 0.2.
    beam = found["odds and ends"]
    assert (beam.at, beam.size, beam.height) == ((1.5, 1.5), (0.6, 0.2), pytest.approx(1.0))
    # Relative to a frame in a corner of the block, which is turned by half a radian.
    turned = math.cos(0.5), math.sin(0.5)
    pole = (0.5 + 0.5 * turned[0] - 0.25 * turned[1] - 2.0, 1.5 + 0.5 * turned[1] + 0.25 * turned[0] - 3.0)
    assert found["island pole"].at == pytest.approx(pole, abs=1e-6)
    # And the step, 0.3 m from there along the block, is turned by a quarter more.
    origin = np.array(pole) + 0.3 * np.array(turned)
    x, y = np.array([-turned[1], turned[0]]), np.array([-turned[0], -turned[1]])
    corners = [origin + a * x + b * y for a, b in ((0, 0), (0.4, 0), (0.4, 0.2), (0.2, 0.2), (0.2, 0.4), (0, 0.4))]
    assert np.allclose(found["island step"].points, corners, atol=2e-6)
    text = "\n".join(notes)
    for name, reason in (
        ("island shade", "sphere"),
        ("odds and ends ramp", "tilted by 17.2 degrees"),
        ("odds and ends barrel lying", "tilted by 90 degrees"),
        ("odds and ends pyramid", "mesh"),
        ("model://robot_dog", "--model-path"),
        ("'crate' has a plugin", "not run"),
        ("'crate' may move", "not static"),
        ("visitor", "actors"),
        ("walls north c", "became its walls"),
        ("(2, 3) in the file", "origin"),
    ):
        assert any(name in line and reason in line for line in notes), (name, reason, text)


def test_what_cannot_be_extruded_can_be_approximated_by_prisms_around_it():
    world, notes = load_sdf(DATA / "lab.world", approximate="convex-hull")
    found = {obstacle.name: obstacle for obstacle in world.obstacles}
    pyramid = found["odds and ends pyramid"]
    assert {tuple(np.round(point, 6)) for point in pyramid.points} == {(2.0, 0.2), (2.4, 0.2), (2.4, 0.6), (2.0, 0.6)}
    assert (pyramid.base, pyramid.height) == (0.0, 0.5)
    ball = found["island shade"]
    assert (ball.base, ball.height) == pytest.approx((1.15, 0.3))
    assert np.hypot(*(np.array(ball.points) - found["island pole"].at).T).min() >= 0.15
    assert np.hypot(*(np.array(ball.points) - found["island pole"].at).T).max() < 0.152
    barrel = load_sdf(DATA / "lab.world", approximate="bounding-box")[0].obstacles[-2]
    assert barrel.name == "odds and ends barrel lying"
    assert (barrel.kind, sorted(barrel.size), barrel.height) == ("box", pytest.approx([0.4, 0.6]), pytest.approx(0.4))
    assert any("ramp" in note and "stands in its place" in note for note in notes)


def test_visuals_are_read_instead_of_collisions_when_asked_for():
    world, _ = load_sdf(DATA / "lab.world", visual=True)
    assert [obstacle.size for obstacle in world.obstacles] == [(0.32, 0.42)]


@pytest.mark.parametrize(
    ("rotation", "size", "height", "yaw_deg"),
    [
        ("0 0 0.3", (1.0, 0.5), 0.8, math.degrees(0.3)),
        ("3.14159265 0 0.3", (1.0, 0.5), 0.8, math.degrees(0.3)),
        ("1.5708 0 0", (1.0, 0.8), 0.5, 0.0),
        ("0 1.5708 0", (0.5, 0.8), 1.0, 90.0),
        ("1.5708 0 1.5708", (1.0, 0.8), 0.5, 90.0),
    ],
)
def test_a_box_may_stand_on_any_of_its_sides(tmp_path, rotation, size, height, yaw_deg):
    scene = read_sdf(world_file(tmp_path, model(link(BOX, f"<pose>1 2 0.7 {rotation}</pose>"))))
    solid = the_only(scene)
    assert solid.size == size
    assert solid.top - solid.base == pytest.approx(height)
    assert 0.5 * (solid.top + solid.base) == pytest.approx(0.7)
    assert math.degrees(solid.yaw) % 180.0 == pytest.approx(yaw_deg % 180.0, abs=1e-3)
    assert scene.notes == []


def test_a_hardly_tilted_box_is_levelled_and_listed_and_a_tilted_one_left_out(tmp_path):
    scene = read_sdf(world_file(tmp_path, model(link(BOX, "<pose>0 0 0.4 0.003 0 0</pose>"))))
    assert the_only(scene).size == (1.0, 0.5)
    assert "levelled" in scene.notes[0]
    assert "mm" in scene.notes[0]
    scene = read_sdf(world_file(tmp_path, model(link(BOX, "<pose>0 0 0.4 0.02 0 0</pose>"))))
    assert scene.solids == []
    assert "'m c' is left out: it is a box tilted by 1.15 degrees" in scene.notes[0]


def test_a_model_file_without_a_world_is_a_world_of_its_own():
    scene = read_sdf(DATA / "models" / "shelf" / "shelf.sdf")
    assert [solid.name for solid in scene.solids] == ["shelf left", "shelf right", "shelf board"]


@pytest.mark.parametrize("version", ["1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "1.10", "1.11", "1.12"])
def test_versions_are_read(tmp_path, version):
    assert the_only(read_sdf(world_file(tmp_path, model(link(CAN)), version))).radius == 0.2


def test_placement_frames_and_frames_of_nested_models_place_what_they_name(tmp_path):
    inner = model(link(CAN, link_pose="<pose>0 0 0.3 0 0 0</pose>", name="foot"), "inner", "<pose>1 0 0 0 0 0</pose>")
    outer = model(
        "<frame name='grip'><pose>0 2 0 0 0 1.5707963267948966</pose></frame>" + inner,
        "outer",
        "<pose>5 5 0 0 0 0</pose>",
    ).replace("<model name='outer'>", "<model name='outer' placement_frame='grip'>")
    beside = model(link(BOX, name="l"), "beside", "<pose relative_to='outer::inner::foot'>0 0 0.1 0 0 0</pose>")
    scene = read_sdf(world_file(tmp_path, outer + beside))
    can, box = scene.solids
    # `grip` comes to (5, 5) unturned: the model is turned by -90 degrees about it.
    assert can.centre == pytest.approx((3.0, 4.0))
    assert box.centre == pytest.approx((3.0, 4.0))
    assert box.yaw == pytest.approx(-0.5 * math.pi)
    assert 0.5 * (box.base + box.top) == pytest.approx(0.4)


def test_a_frame_of_the_world_may_be_attached_to_a_model(tmp_path):
    table = model(link(BOX, name="top"), "table", "<pose>3 1 0 0 0 0</pose>")
    frame = "<frame name='on_table' attached_to='table'><pose>0 0 0.6 0 0 0</pose></frame>"
    start = "<frame name='start' attached_to='table'><pose>-2 0 0 0 0 0</pose></frame>"
    cup = model(link(CAN, name="l"), "cup", "<pose relative_to='on_table'>0 0.1 0 0 0 0</pose>")
    scene = read_sdf(world_file(tmp_path, frame + start + table + cup))
    assert scene.solids[1].centre == pytest.approx((3.0, 1.1))
    assert 0.5 * (scene.solids[1].base + scene.solids[1].top) == pytest.approx(0.6)
    assert (scene.starts[0].x, scene.starts[0].y) == pytest.approx((1.0, 1.0))


def test_merged_includes_share_the_frames_of_the_model_that_includes_them(tmp_path):
    directory = tmp_path / "foot"
    directory.mkdir()
    (directory / "model.sdf").write_text(
        "<sdf version='1.9'><model name='foot'>" + link(CAN, link_pose="<pose>0 0 0.3 0 0 0</pose>", name="sole")
        + "</model></sdf>"
    )  # fmt: skip
    content = (
        "<include merge='true'><uri>model://foot</uri><pose>1 0 0 0 0 0</pose></include>"
        "<link name='top'><pose relative_to='sole'>0 0 1 0 0 0</pose><collision name='t'>" + BOX + "</collision></link>"
    )
    scene = read_sdf(world_file(tmp_path, model(content, pose="<pose>0 3 0 0 0 0</pose>")))
    assert [(solid.name, solid.centre) for solid in scene.solids] == [("m foot", (1.0, 3.0)), ("m", (1.0, 3.0))]
    assert scene.solids[1].base == pytest.approx(0.9)


def test_models_are_found_by_search_path_environment_and_neighbourhood(tmp_path, monkeypatch):
    content = "<include><uri>model://crate</uri></include>"
    path = world_file(tmp_path, content)
    assert "--model-path" in read_sdf(path).notes[0]
    assert the_only(read_sdf(path, model_paths=[DATA / "models"])).name == "crate"
    monkeypatch.setenv("GAZEBO_MODEL_PATH", f"/nowhere{os.pathsep}{DATA / 'models'}")
    assert the_only(read_sdf(path)).name == "crate"
    monkeypatch.delenv("GAZEBO_MODEL_PATH")
    shutil.copytree(DATA / "models" / "crate", tmp_path / "crate")
    assert the_only(read_sdf(path)).name == "crate"


def test_heights_are_measured_from_the_ground_plane_and_what_lies_under_it_is_listed(tmp_path):
    ground = model(
        link("<geometry><plane><normal>0 0 1</normal></plane></geometry>"), "ground", "<pose>0 0 0.5 0 0 0</pose>"
    )
    slab = model(link(BOX), "slab", "<pose>0 0 0.1 0 0 0</pose>")
    post = model(link(CAN), "post", "<pose>0 0 0.9 0 0 0</pose>")
    world, notes = load_sdf(world_file(tmp_path, ground + slab + post))
    (can,) = world.obstacles
    assert (can.base, can.height) == pytest.approx((0.1, 0.6))
    assert any("under the floor" in note and "'slab'" in note for note in notes)
    assert any("0.5 m" in note for note in notes)


def test_what_is_flat_on_the_floor_comes_back(tmp_path):
    carpet = navsim.Box(name="carpet", at=(0, 0), size=(1, 1), height=0.001)
    save_sdf(navsim.World(size=(6, 6), obstacles=[carpet]), tmp_path / "a.sdf")
    world, _ = load_sdf(tmp_path / "a.sdf")
    assert [(one.name, one.height) for one in world.obstacles] == [("carpet", pytest.approx(0.001))]


def test_numbered_names_are_nobody_elses(tmp_path):
    text = "".join(model(link(CAN), name, f"<pose>{x} 0 0.3 0 0 0</pose>") for x, name in enumerate(("a", "a", "a 1")))
    world, _ = load_sdf(world_file(tmp_path, text))
    assert len({obstacle.name for obstacle in world.obstacles}) == 3


def test_what_gazebo_lets_move_can_be_pushed_if_asked_for_and_light(tmp_path):
    heavy = model(
        link(BOX, name="l").replace("<collision", "<inertial><mass>80</mass></inertial><collision"), "heavy", static=""
    )
    scene = read_sdf(
        world_file(tmp_path, heavy + "<include><uri>model://crate</uri></include>"), [DATA / "models"], pushable=True
    )
    data, notes = data_of(scene, Room())
    assert [entry["box"].get("pushable") for entry in data["obstacles"]] == [None, {"mass": 1.5}]
    assert any("'heavy' stands still: it is 80 kg" in note for note in notes)
    fixed = read_sdf(world_file(tmp_path, heavy))
    assert the_only(fixed).mass is None
    assert "it is not static" in fixed.notes[0]


# Rooms


@pytest.mark.parametrize(
    ("change", "becomes_walls"),
    [
        pytest.param(("", ""), True, id="as it is"),
        pytest.param(("6.3 0.15 0.5", "6.3 0.15 0.6"), False, id="not of one height"),
        pytest.param(("5.3 0.15 0.5", "5.3 0.25 0.5"), False, id="not of one thickness"),
        pytest.param(("5.3 0.15 0.5", "4.3 0.15 0.5"), False, id="gaps"),
        pytest.param(("0 2.575 0.25 0 0 0", "0 2.575 0.25 0 0 0.05"), False, id="one is turned"),
    ],
)
def test_four_boxes_become_walls_exactly_if_they_enclose_all(tmp_path, change, becomes_walls):
    text = (DATA / "lab.world").read_text()
    assert change[0] in text
    path = tmp_path / "lab.world"
    path.write_text(text.replace(*change) if change[0] else text)
    world, notes = load_sdf(path, model_paths=[DATA / "models"])
    assert (sum("walls" in obstacle.name for obstacle in world.obstacles) == 0) == becomes_walls
    assert any("became its walls" in note for note in notes) == becomes_walls
    assert any("no four walls" in note for note in notes) != becomes_walls


def test_walls_that_a_size_makes_obstacles_are_told(tmp_path):
    world, notes = load_sdf(DATA / "lab.world", room=Room(size=(9.0, 9.0)), model_paths=[DATA / "models"])
    assert world.size == (9.0, 9.0)
    assert any("and are obstacles, since --size asks for another" in note for note in notes)


def test_a_world_without_walls_gets_a_room_around_what_stands_in_it(tmp_path):
    path = world_file(tmp_path, model(link(BOX), pose="<pose>10 0 0.4 0 0 0</pose>"))
    world, notes = load_sdf(path)
    assert (world.size, world.walls, world.obstacles[0].at) == ((3.0, 2.5), navsim.world.Walls(), (0.0, 0.0))
    assert any("(10, 0) in the file" in note for note in notes)
    world, _ = load_sdf(path, room=Room(margin=2.0, walls=False, starts=((9.0, 1.5),), goals=((11.0, -1.5),)))
    assert (world.size, world.walls) == ((5.0, 4.5), None)
    assert (world.starts[0].at, world.goals[0].at) == ((-1.0, 1.5), (1.0, -1.5))
    world, _ = load_sdf(path, room=Room(size=(8.0, 4.0)))
    assert world.size == (8.0, 4.0)


def test_what_reaches_out_of_a_room_of_given_size_is_cut_off_and_listed(tmp_path):
    content = model(link(CAN), "can", "<pose>0 0 0.3 0 0 0</pose>") + model(
        link(BOX), "box", "<pose>2 0 0.4 0 0 0</pose>"
    )
    content += model(link(BOX), "far", "<pose>-2 0 0.4 0 0 0</pose>")
    world, notes = load_sdf(world_file(tmp_path, content), room=Room(size=(3.2, 3.0)))
    assert [obstacle.name for obstacle in world.obstacles] == ["can", "box", "far"]
    assert set(world.obstacles[1].points) == {(1.5, -0.25), (1.6, -0.25), (1.6, 0.25), (1.5, 0.25)}
    assert any("'far' reaches out of the room" in note for note in notes)
    world, notes = load_sdf(world_file(tmp_path, content), room=Room(size=(2.0, 2.0)))
    assert any("'far' stands outside the room" in note for note in notes)


def test_starts_and_goals_are_frames_of_these_names(tmp_path):
    frames = "<frame name='start_1'><pose>-1 -1 0 0 0 1.5707963</pose></frame>"
    frames += "<frame name='goal'><pose>1 1 0 0 0 0</pose></frame>"
    world, _ = load_sdf(world_file(tmp_path, frames + model(link(CAN))), room=Room(margin=2.0))
    assert (world.starts[0].at, world.starts[0].yaw_deg) == ((-1.0, -1.0), pytest.approx(90.0))
    assert world.goals[0].at == (1.0, 1.0)


def test_places_of_the_files_own_that_are_not_free_are_left_out_and_listed(tmp_path):
    frames = (
        "<frame name='start_1'><pose>0 0 0 0 0 0</pose></frame><frame name='start_2'><pose>1 1 0 0 0 0</pose></frame>"
    )
    world, notes = load_sdf(world_file(tmp_path, frames + model(link(CAN))), room=Room(margin=2.0))
    assert [start.at for start in world.starts] == [(1.0, 1.0)]
    assert any("left out" in note and "starts[0]" in note for note in notes)


def test_what_cannot_be_pushed_where_it_is_stands_still(tmp_path):
    light = "<inertial><mass>0.3</mass></inertial><collision"
    can = link(CAN).replace("<collision", light, 1)
    on_a_table = model(can, "can", "<pose>0 0 1.1 0 0 0</pose>", static="")
    on_the_floor = model(can, "tin", "<pose>1.5 0 0.3 0 0 0</pose>", static="")
    world, notes = load_sdf(world_file(tmp_path, on_a_table + on_the_floor), pushable=True, room=Room(margin=2.0))
    assert [(obstacle.name, obstacle.base, obstacle.pushable is not None) for obstacle in world.obstacles] == [
        ("can", pytest.approx(0.8), False),
        ("tin", 0.0, True),
    ]
    assert any("left out" in note and "base" in note for note in notes)


def with_mass(geometry: str, inertial: str = "<mass>0.3</mass>", attributes: str = "") -> str:
    return link(geometry).replace("<collision", f"<inertial{attributes}>{inertial}</inertial><collision", 1)


TO_WORLD = "<joint name='j' type='{}'><parent>world</parent><child>link</child></joint>"


@pytest.mark.parametrize(
    ("content", "is_pushable"),
    [
        (with_mass(CAN), True),
        (with_mass(CAN) + TO_WORLD.format("fixed"), False),
        (with_mass(CAN) + TO_WORLD.format("revolute"), False),
        (with_mass(CAN).replace("<inertial", "<kinematic>true</kinematic><inertial"), False),
        (
            with_mass(CAN) + "<link name='lid'/><joint name='j' type='revolute'><parent>link</parent>"
            "<child>lid</child></joint>",
            False,
        ),
        (
            with_mass(CAN) + "<link name='lid'/><joint name='j' type='fixed'><parent>link</parent>"
            "<child>lid</child></joint>",
            True,
        ),
    ],
    ids=["loose", "fixed", "hinged", "kinematic", "with a moving lid", "with a fixed lid"],
)
def test_what_a_joint_or_nothing_at_all_can_move_is_not_pushed(tmp_path, content, is_pushable):
    world, _ = load_sdf(
        world_file(tmp_path, model(content, static="", pose="<pose>0 0 0.3 0 0 0</pose>")), pushable=True
    )
    assert (world.obstacles[0].pushable is not None) == is_pushable


def test_what_the_model_around_it_fixes_is_not_pushed(tmp_path):
    inner = model(with_mass(CAN), "can", static="")
    joint = "<joint name='j' type='fixed'><parent>world</parent><child>can::link</child></joint>"
    pose = "<pose>0 0 0.3 0 0 0</pose>"
    by_name = joint.replace("can::link", "can")
    for content, is_pushable in ((inner, True), (inner + joint, False), (inner + by_name, False)):
        world, _ = load_sdf(world_file(tmp_path, model(content, "rig", pose, static="")), pushable=True)
        assert (world.obstacles[0].pushable is not None) == is_pushable
    world, _ = load_sdf(world_file(tmp_path, model(with_mass(CAN), "can", pose, static="") + joint), pushable=True)
    assert world.obstacles[0].pushable is None


def test_a_mass_left_to_be_computed_is_density_times_volume(tmp_path):
    pose, volume = "<pose>0 0 0.3 0 0 0</pose>", math.pi * 0.2**2 * 0.6

    def masses(content):
        world, _ = load_sdf(world_file(tmp_path, model(content, static="", pose=pose), "1.11"), pushable=True)
        return [obstacle.pushable and obstacle.pushable.mass for obstacle in world.obstacles]

    auto = " auto='true'"
    assert masses(with_mass(CAN, "", auto)) == [None]  # water weighs 75 kg
    assert masses(with_mass(CAN, "<density>20</density>", auto)) == [pytest.approx(20 * volume, abs=1e-6)]
    own = with_mass(CAN, "<density>20</density>", auto).replace("<geometry>", "<density>40</density><geometry>")
    assert masses(own) == [pytest.approx(40 * volume, abs=1e-6)]


@given(st.lists(st.integers(1_000_000, 4_000_000), min_size=4, max_size=4))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_reaches_the_border_of_a_room_of_any_size_is_in_it(tmp_path, micrometres):
    """Half of an odd number of micrometres must not be rounded out of the room."""
    content = ""
    for number, (value, (x, y)) in enumerate(zip(micrometres, ((-1, 0), (0, -1), (1, 0), (0, 1)), strict=True)):
        tip = value * 1e-6  # of a wedge that points outwards
        corners = [(tip * x, tip * y), *((x * (tip - 0.1) + s * y, y * (tip - 0.1) + s * x) for s in (-0.05, 0.05))]
        points = "".join(f"<point>{px:.6f} {py:.6f}</point>" for px, py in corners)
        shape = f"<geometry><polyline>{points}<height>1</height></polyline></geometry>"
        content += model(link(shape), f"wedge {number}")
    world, _ = load_sdf(world_file(tmp_path, content), room=Room(margin=0.0))
    assert len(world.obstacles) == 4


def test_a_pose_inside_a_model_is_not_relative_to_the_world(tmp_path):
    content = model(link(CAN, link_pose="<pose relative_to='world'>1 0 0.3 0 0 0</pose>"), "can")
    with pytest.raises(ConversionError, match="inside model 'can' cannot be relative to the world"):
        load_sdf(world_file(tmp_path, content))


def test_the_files_own_starts_and_goals_are_in_the_room_wherever_they_are(tmp_path):
    frames = "<frame name='start'><pose>-4 0 0 0 0 0</pose></frame><frame name='goal'><pose>0 5 0 0 0 0</pose></frame>"
    world, notes = load_sdf(world_file(tmp_path, frames + model(link(CAN))))
    # The can takes 0.2 m around the origin, and 1 m around it are free; 0.5 m around places.
    assert world.size == (1.2 + 4.5, 1.2 + 5.5)
    assert world.starts[0].at == pytest.approx((-4.0 - (1.2 - 4.5) / 2, -(5.5 - 1.2) / 2))
    assert world.goals[0].at == pytest.approx((-(1.2 - 4.5) / 2, 5.0 - (5.5 - 1.2) / 2))
    assert not any("left out" in note for note in notes)


def test_a_joint_may_have_its_links_name_before_version_1_7(tmp_path):
    arm = link(CAN, name="base") + link(CAN, link_pose="<pose>1 0.5 0.3 0 0 0</pose>", name="arm")
    arm += "<joint name='arm' type='fixed'><pose>0 0 0.1 0 0 0</pose><parent>base</parent><child>arm</child></joint>"
    scene = read_sdf(world_file(tmp_path, model(arm), version="1.6"))
    assert [solid.centre for solid in scene.solids] == [(0.0, 0.0), (1.0, 0.5)]


# There and back


def test_walls_come_back_where_something_reaches_through_them(tmp_path):
    world = navsim.World.from_dict(
        {
            "format": 1,
            "size": [7, 7],
            "walls": {"height": 0.5, "thickness": 0.05},
            "obstacles": [{"box": {"at": [3.4, 0], "size": [0.5, 0.5], "height": 1}}],
        }
    )
    save_sdf(world, tmp_path / "test.sdf")
    back, notes = load_sdf(tmp_path / "test.sdf")
    assert back.to_dict() == world.replace(name="test").to_dict() | {"name": back.name}
    assert not any("wall" in note for note in notes)


@pytest.mark.parametrize("walls", ["tall", "2", "2 0", "-1 0.1", "2 20000"])
def test_walls_that_are_none_are_told(tmp_path, walls):
    room = f"<navsim:room xmlns:navsim='urn:navsim:world' size='6 6' walls='{walls}'/>"
    with pytest.raises(ConversionError, match=r"walls of <navsim:room>"):
        load_sdf(world_file(tmp_path, room + model(link(CAN))))


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_shipped_worlds_come_back_from_sdf_as_they_were(name, tmp_path):
    world = navsim.load_world(name)
    path = tmp_path / "world.sdf"
    notes = save_sdf(world, path)
    lively = [obstacle.name for obstacle in world.obstacles if obstacle.motion or obstacle.pushable]
    assert all(any(name in note for note in notes) for name in lively)
    assert bool(notes) == bool(lively)
    back, _ = load_sdf(path)
    still = world.replace(obstacles=[obstacle.replace(motion=None, pushable=None) for obstacle in world.obstacles])
    assert back.to_dict() == still.to_dict()
    assert_same_view(world, back)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(world=worlds())
def test_any_world_comes_back_from_sdf_looking_the_same(world, tmp_path):
    path = tmp_path / "world.sdf"
    save_sdf(world, path)
    back, _ = load_sdf(path)
    assert (back.size, back.walls, len(back.obstacles)) == (world.size, world.walls, len(world.obstacles))
    assert [obstacle.name for obstacle in back.obstacles] == [obstacle.name for obstacle in world.obstacles]
    assert_same_view(world, back, count=12)


def test_an_imported_world_written_and_read_again_looks_the_same(tmp_path):
    world, _ = load_sdf(DATA / "lab.world", approximate="convex-hull")
    save_sdf(world, tmp_path / "again.sdf")
    assert_same_view(world, load_sdf(tmp_path / "again.sdf")[0])


def test_names_that_sdf_forbids_are_changed_and_others_survive(tmp_path):
    names = ["a::b", "__x__", "twin", "twin", 'L <&> "é"', "world"]
    world = navsim.World.from_dict(
        {"format": 1, "size": [9, 9], "obstacles": [
            {"cylinder": {"name": name, "at": [i - 3, 0], "radius": 0.1, "height": 1}} for i, name in enumerate(names)
        ]}
    )  # fmt: skip
    told = [note for note in save_sdf(world, tmp_path / "world.sdf") if "is called" in note]
    assert [note.split(",")[0] for note in told] == [
        "'a::b' is called 'a:b'", "'__x__' is called 'x'", "'twin' is called 'twin_2'", "'world' is called 'world_2'"
    ]  # fmt: skip
    back, _ = load_sdf(tmp_path / "world.sdf")
    assert [obstacle.name for obstacle in back.obstacles] == ["a:b", "x", "twin", "twin_2", 'L <&> "é"', "world_2"]


# Gazebo's own library

CHECKER = Path(__file__).parent / "sdformat_solids.cc"


@pytest.fixture(scope="module")
def sdformat(tmp_path_factory):
    """A program that reads SDF files with libsdformat 12 (Debian: libsdformat-dev)."""
    packages = ["pkg-config", "--cflags", "--libs", "sdformat12"]
    if (
        not shutil.which("g++")
        or not shutil.which("pkg-config")
        or subprocess.run(packages, capture_output=True).returncode
    ):
        pytest.skip("libsdformat 12 and a compiler are not installed")
    flags = subprocess.run(packages, capture_output=True, text=True, check=True).stdout.split()
    program = tmp_path_factory.mktemp("sdformat") / "solids"
    subprocess.run(["g++", "-std=c++17", str(CHECKER), *flags, "-o", str(program)], check=True)

    def solids(path: Path, models: Path = DATA / "models") -> list[tuple[str, str, np.ndarray, np.ndarray]]:
        """Model, shape, sizes and pose (x, y, z, quaternion) of every collision but planes."""
        done = subprocess.run([str(program), str(path), str(models)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        rows = [line.split("\t") for line in done.stdout.splitlines()]
        return [(row[0], row[2], np.fromstring(row[3], sep=" "), np.fromstring(row[4], sep=" ")) for row in rows
                if row[2] != "other"]  # fmt: skip

    return solids


@pytest.mark.slow
@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_gazebos_library_accepts_what_is_written_and_sees_the_same_solids(sdformat, name, tmp_path):
    world = navsim.load_world(name)
    save_sdf(world, tmp_path / "world.sdf")
    solids = sdformat(tmp_path / "world.sdf")
    assert len(solids) == 4 + len(world.obstacles)
    for (model_name, shape, sizes, pose), obstacle in zip(solids[4:], world.obstacles, strict=True):
        assert (model_name, shape) == (obstacle.name, obstacle.kind)
        wanted = [*obstacle.size, obstacle.height] if shape == "box" else [obstacle.radius, obstacle.height]
        assert sizes == pytest.approx(wanted, abs=1e-9)
        assert pose[:3] == pytest.approx([*obstacle.at, obstacle.base + 0.5 * obstacle.height], abs=1e-9)
        yaw = math.radians(getattr(obstacle, "yaw_deg", 0.0))
        assert 2.0 * math.atan2(pose[6], pose[3]) == pytest.approx(yaw, abs=1e-9)


@pytest.mark.slow
def test_gazebos_library_resolves_poses_to_the_same_places(sdformat, tmp_path):
    text = (DATA / "lab.world").read_text()
    for uri in ("https://fuel.gazebosim.org/1.0/OpenRobotics/models/Ground Plane", "model://sun", "model://robot_dog"):
        text = text.replace(f"<include><uri>{uri}</uri></include>", "")
    path = tmp_path / "lab.world"
    path.write_text(text.replace("models/crate", "model://crate"))
    shutil.copytree(DATA / "models", tmp_path / "models")
    config = (DATA / "models" / "shelf" / "model.config").read_text()
    (tmp_path / "models" / "crate" / "model.config").write_text(config.replace("shelf.sdf", "model.sdf"))
    theirs = []
    for _, shape, sizes, pose in sdformat(path, tmp_path / "models"):
        centre = pose[:3]
        if shape == "polyline":
            theirs.append(("polygon", *centre[:2], centre[2], centre[2] + sizes[0]))
        elif shape == "cylinder" and abs(_cosine_of_tilt(pose)) > 0.999:
            theirs.append(("cylinder", *centre[:2], centre[2] - 0.5 * sizes[1], centre[2] + 0.5 * sizes[1]))
        elif shape == "box" and not 0.1 < abs(_cosine_of_tilt(pose)) < 0.999:
            height = sizes[2] if abs(_cosine_of_tilt(pose)) > 0.5 else sizes[1]
            theirs.append(("box", *centre[:2], centre[2] - 0.5 * height, centre[2] + 0.5 * height))
    ours = [
        (solid.kind, *(solid.points[0] if solid.kind == "polygon" else solid.centre), solid.base, solid.top)
        for solid in read_sdf(path).solids
    ]
    assert len(ours) == len(theirs) == 12
    for kind, *numbers in ours:
        assert min(math.dist(numbers, others) for other_kind, *others in theirs if other_kind == kind) < 1e-6


def _cosine_of_tilt(pose: np.ndarray) -> float:
    x, y = pose[4:6]
    return 1.0 - 2.0 * (x * x + y * y)


# Public worlds, from a clone of https://github.com/ROBOTIS-GIT/turtlebot3_simulations (Apache-2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "size", "count"),
    [
        ("turtlebot3_dqn_stage2", (4.7, 4.7), 4),
        ("turtlebot3_dqn_stage4", (4.7, 4.7), 9),
        ("turtlebot3_house", None, 104),
    ],
)
def test_public_worlds_are_read(name, size, count):
    clone = os.environ.get("TURTLEBOT3_SIMULATIONS")
    if clone is None:
        pytest.skip("TURTLEBOT3_SIMULATIONS names no clone of turtlebot3_simulations")
    gazebo = Path(clone) / "turtlebot3_gazebo"
    world, _ = load_sdf(gazebo / "worlds" / f"{name}.world", model_paths=[gazebo / "models"])
    assert len(world.obstacles) == count
    assert size is None or world.size == pytest.approx(size, abs=1e-3)
