"""Generated rooms keep what they promise; geometry is checked with shapely, not with what placed it."""

from __future__ import annotations

import hashlib
import itertools
import math
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navsim.camera import DepthCamera
from navsim.generate import (
    KINDS,
    PASSAGE,
    RoomSettings,
    floor_covered,
    generate_world,
    generate_worlds,
    room_text,
    write_rooms,
)
from navsim.generate.placing import Rectangle, rectangle_distance
from navsim.oracle import Oracle
from navsim.processes import WorkerDeathError
from navsim.raycast import Scene, nearest_depth
from navsim.robot import TURTLEBOT2
from navsim.simulator import Simulator
from navsim.task import Path as TaskPath
from navsim.world import Box, World
from navsim.worldfile import load_world, parse_text
from navsim.worldsource import parse_size

CAMERA = DepthCamera()
SEEN_UP_TO = CAMERA.mount_z + 0.4 * math.tan(math.radians(CAMERA.vertical_fov_deg / 2))
"""Height, metres, that the camera sees at 0.4 m; what hangs higher can never be nearer than the depth rule allows."""
REPOSITORY = Path(__file__).parents[2]
ROOMS = {kind: list(generate_worlds(kind, seed=5, count=4)) for kind in KINDS}
DENSITIES = {
    "clutter": (0.04, 0.11, 0.3),
    "blocks": (0.05, 0.25),
    "corridors": (0.02, 0.1),
    "office": (0.05, 0.18),
    "warehouse": (0.08, 0.3),
    "forest": (0.02, 0.1),
}

every_kind = pytest.mark.parametrize("kind", KINDS)


def footprint(obstacle) -> shapely.Geometry:
    if isinstance(obstacle, Box):
        (x, y), (a, b) = obstacle.at, obstacle.size
        upright = shapely.box(x - a / 2, y - b / 2, x + a / 2, y + b / 2)
        return shapely.affinity.rotate(upright, obstacle.yaw_deg, origin=(x, y))
    return shapely.Point(obstacle.at).buffer(obstacle.radius, quad_segs=64)


def joined_by_passages(world: World, width: float) -> bool:
    """Whether a disc of that width gets from every start to every goal past all that is hit or seen too near.

    Most places where it fits must belong to the same part of the floor: little is walled up.
    """
    half = world.half_size - width / 2
    blocked = [footprint(o).buffer(width / 2, quad_segs=64) for o in world.obstacles if o.base < SEEN_UP_TO]
    parts = shapely.get_parts(shapely.box(*-half, *half).difference(shapely.union_all(blocked)))
    places = [shapely.Point(place.at) for place in (*world.starts, *world.goals)]
    around = [{i for i, part in enumerate(parts) if part.distance(point) < 1e-6} for point in places]
    shared = set.intersection(*around)
    return len(shared) == 1 and parts[min(shared)].area > 0.75 * sum(part.area for part in parts)


def is_low(obstacle) -> bool:
    return obstacle.top < CAMERA.mount_z


def is_raised(obstacle) -> bool:
    return obstacle.base > 0.0


# What every room keeps


@every_kind
def test_every_start_and_goal_are_joined_by_passages_of_a_metre(kind):
    for world in ROOMS[kind]:
        assert joined_by_passages(world, PASSAGE - 0.002)
        assert 2 <= len(world.starts) <= 5
        assert 3 <= len(world.goals) <= 10
        assert kind in ("corridors", "warehouse") or (len(world.starts), len(world.goals)) == (5, 10)


@pytest.mark.parametrize(("kind", "density"), [(kind, d) for kind, ds in DENSITIES.items() for d in ds])
def test_density_is_the_share_of_the_floor_under_obstacles(kind, density):
    for world in generate_worlds(kind, density=density, seed=1, count=2):
        covered = shapely.union_all([footprint(obstacle) for obstacle in world.obstacles]).area / 49.0
        assert covered == pytest.approx(density, abs=0.003)
        assert floor_covered(world) == pytest.approx(covered, abs=0.0015)
        assert joined_by_passages(world, PASSAGE - 0.002)


@every_kind
def test_obstacles_stay_in_the_room_and_do_not_run_into_each_other(kind):
    for world in ROOMS[kind]:
        room = shapely.box(*-world.half_size, *world.half_size)
        shapes = [footprint(obstacle) for obstacle in world.obstacles]
        for i, (obstacle, shape) in enumerate(zip(world.obstacles, shapes, strict=True)):
            assert shape.difference(room).area < 1e-6, obstacle.name
            if kind == "corridors":  # its walls cross
                continue
            for other, other_shape in zip(world.obstacles[:i], shapes[:i], strict=True):
                if obstacle.name.split(" ")[:2] == other.name.split(" ")[:2]:  # parts of one thing
                    continue
                if obstacle.base < other.top - 1e-9 and other.base < obstacle.top - 1e-9:
                    # Coordinates are whole millimetres, so that what touches may overlap by one.
                    assert shape.intersection(other_shape).area < 2e-3, f"{obstacle.name} and {other.name}"


@every_kind
def test_every_start_has_a_metre_of_free_view_in_some_direction(kind):
    yaws = np.deg2rad(np.arange(-175.0, 181.0, 5.0))
    for world in ROOMS[kind]:
        scene = Scene([world])
        for start in world.starts:
            poses = np.column_stack([np.full(len(yaws), start.at[0]), np.full(len(yaws), start.at[1]), yaws])
            views = nearest_depth(scene, np.zeros(len(yaws), dtype=np.intp), poses, CAMERA, within=1.0)
            assert np.count_nonzero(views >= 1.0) >= 1
            if start.yaw_deg is not None:
                assert views[round((start.yaw_deg + 175.0) / 5.0)] >= 1.0


@every_kind
def test_a_goal_is_never_reached_at_the_start(kind):
    for world in ROOMS[kind]:
        assert min(math.dist(start.at, goal.at) for start in world.starts for goal in world.goals) > 1.0


# The same settings, the same room


@every_kind
def test_a_room_does_not_depend_on_those_made_with_it(kind):
    batch = ROOMS[kind]
    alone = generate_world(kind, seed=5, index=2)
    rooms = RoomSettings(kind, seed=5)
    assert room_text(rooms, 2, alone) == room_text(rooms, 2, batch[2])
    assert alone.name == f"{kind}-0003"


def test_rooms_differ_by_number_seed_kind_and_density():
    rooms = [
        *generate_worlds("clutter", seed=0, count=3),
        *generate_worlds("clutter", seed=1, count=3),
        *generate_worlds("clutter", density=0.1, seed=0, count=3),
    ]
    assert len({repr(room.obstacles) for room in rooms}) == len(rooms)


def test_another_process_makes_the_same_bytes():
    code = (
        "import hashlib; from navsim.generate import *; "
        "print([hashlib.sha256(room_text(r, 7, r.room(7)).encode()).hexdigest() for r in map(RoomSettings, KINDS)])"
    )
    environment = os.environ | {"PYTHONHASHSEED": "12345", "PYTHONPATH": str(REPOSITORY)}
    printed = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    ).stdout
    here = [
        hashlib.sha256(room_text(rooms, 7, rooms.room(7)).encode()).hexdigest() for rooms in map(RoomSettings, KINDS)
    ]
    assert printed.strip() == str(here)


@every_kind
def test_a_room_is_read_back_from_its_file(kind):
    for index, world in enumerate(ROOMS[kind]):
        assert parse_text(room_text(RoomSettings(kind, seed=5), index, world)) == world


def test_the_command_in_a_file_makes_it_again():
    settings = RoomSettings("blocks", (7.123456789, 7.0), 0.1234567, seed=3)
    room = settings.room(0)
    words = room_text(settings, 0, room).splitlines()[0].split()
    size, density = words[words.index("--size") + 1], words[words.index("--density") + 1]
    assert size == "7.123456789,7"
    assert RoomSettings("blocks", parse_size(size), float(density), seed=3).room(0) == room


def test_rooms_are_written_one_by_one_and_never_over_others(tmp_path):
    rooms = RoomSettings("blocks", (5.0, 6.0), 0.08, seed=2)
    written = list(write_rooms(rooms, tmp_path / "rooms", count=2, first=4))
    assert [file.name for _, file in written] == ["blocks-0004.yaml", "blocks-0005.yaml"]
    assert [load_world(file) for _, file in written] == [rooms.room(3), rooms.room(4)]
    assert sorted(path.name for path in (tmp_path / "rooms").iterdir()) == ["blocks-0004.yaml", "blocks-0005.yaml"]
    with pytest.raises(ValueError, match=r"blocks-0005\.yaml is there already; remove it, or choose another directory"):
        write_rooms(rooms, tmp_path / "rooms", count=1, first=5)


# What each kind is like


def test_clutter_has_24_obstacles_of_which_a_third_is_low_or_raised():
    for world in ROOMS["clutter"]:
        assert len(world.obstacles) == 24
        assert sum(is_low(o) or is_raised(o) for o in world.obstacles) == 8


def test_dense_clutter_keeps_its_third():
    for world in generate_worlds("clutter", density=0.11, seed=0, count=6):
        assert 3 * sum(is_low(o) or is_raised(o) for o in world.obstacles) >= len(world.obstacles)


def test_larger_clutter_has_more_obstacles():
    assert len(generate_world("clutter", (9.9, 9.9)).obstacles) == 48


def test_blocks_are_large_boxes_with_closed_or_wide_gaps():
    for world in ROOMS["blocks"]:
        for obstacle in world.obstacles:
            assert isinstance(obstacle, Box)
            assert obstacle.base == 0.0
            assert obstacle.top > 2 * CAMERA.mount_z
            assert footprint(obstacle).area > 0.25
        groups = shapely.get_parts(shapely.union_all([footprint(o).buffer(0.005) for o in world.obstacles]))
        for one, other in itertools.combinations(groups, 2):
            assert one.distance(other) > PASSAGE - 0.012
        room = shapely.box(*-world.half_size, *world.half_size).exterior
        for group in groups:
            assert room.distance(group) == 0.0 or room.distance(group) > PASSAGE - 0.007


def test_corridors_are_straight_walls_that_hide_much_of_the_room():
    for world in ROOMS["corridors"]:
        assert all(isinstance(o, Box) and o.yaw_deg % 90.0 == 0.0 and o.top >= 1.2 for o in world.obstacles)
        walls = shapely.union_all([footprint(o) for o in world.obstacles])
        lines = [shapely.LineString([s.at, g.at]) for s in world.starts for g in world.goals]
        assert np.mean([line.intersects(walls) for line in lines]) > 0.5


def test_offices_have_rooms_doors_desks_chairs_and_cupboards():
    names = " ".join(obstacle.name for world in ROOMS["office"] for obstacle in world.obstacles)
    assert all(word in names for word in ("partition", "desk", "chair seat", "cupboard", "bin"))
    for world in ROOMS["office"]:
        partitions = [footprint(o) for o in world.obstacles if "partition" in o.name]
        assert len(partitions) >= 2
        tops = [o for o in world.obstacles if o.name.endswith("top")]
        assert all(o.base == 0.72 for o in tops)
        # With the doors shut, the partitions divide the room.
        grown = shapely.union_all([partition.buffer(0.65, join_style="mitre") for partition in partitions])
        shut = grown.buffer(-0.63, join_style="mitre")
        floor = shapely.box(*-world.half_size, *world.half_size).difference(shut)
        assert sum(part.area > 4.0 for part in shapely.get_parts(floor)) >= 2


def test_warehouses_have_boards_on_uprights_in_parallel_rows():
    for world in ROOMS["warehouse"]:
        boards = [o for o in world.obstacles if "board" in o.name]
        assert boards
        assert all(o.base > 0.0 for o in boards)
        assert len({o.yaw_deg % 180.0 for o in boards}) == 1
        uprights = shapely.union_all([footprint(o) for o in world.obstacles if "upright" in o.name])
        for board in boards:
            corners = shapely.get_coordinates(footprint(board))
            assert all(uprights.distance(shapely.Point(corner)) < 0.01 for corner in corners)


def test_forests_have_trunks_of_many_radii_logs_and_bushes():
    radii = [o.radius for world in ROOMS["forest"] for o in world.obstacles if o.name.startswith("trunk")]
    assert min(radii) < 0.1
    assert max(radii) > 0.2
    assert len(set(radii)) > 0.8 * len(radii)
    for world in ROOMS["forest"]:
        logs = [o for o in world.obstacles if o.name.startswith("log")]
        assert all(is_low(log) and log.size[0] > 4 * log.size[1] for log in logs)
        assert world.walls.height < 2.0


# The oracle


def solves(world: World, pair: tuple[int, int]) -> bool:
    simulator = Simulator(world, seed=0)
    simulator.reset(paths=[TaskPath(*pair)])
    return Oracle(world).plan(simulator.poses[0], simulator.goals[0]) is not None


@every_kind
def test_the_oracle_solves_a_path(kind):
    assert solves(ROOMS[kind][0], (2, 3))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@every_kind
def test_the_oracle_solves_a_path_from_every_start_in_many_rooms(kind):
    density = DENSITIES[kind][-1]
    for world in (*ROOMS[kind], *generate_worlds(kind, density=density, seed=3, count=4)):
        for start in range(len(world.starts)):
            assert solves(world, (start, (3 * start + 1) % len(world.goals))), f"{world.name}, start {start}"


# Any settings


@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    kind=st.sampled_from(KINDS),
    size=st.tuples(st.floats(2.0, 11.0), st.floats(2.0, 11.0)),
    density=st.one_of(st.none(), st.floats(0.005, 0.35)),
    seed=st.integers(0, 2**63),
)
def test_any_settings_make_a_proper_room_or_a_sentence(kind, size, density, seed):
    world, told = None, ""
    try:
        world = generate_world(kind, size, density, seed)
    except ValueError as error:
        told = str(error)
    if world is None:
        assert len(told.splitlines()) == 1
        assert kind in told
        return
    assert world.size == size
    assert joined_by_passages(world, PASSAGE - 0.002)
    if density is not None:
        covered = shapely.union_all([footprint(obstacle) for obstacle in world.obstacles]).area / (size[0] * size[1])
        assert covered == pytest.approx(density, abs=0.004)


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [
        ("warehouse", [(4.0, 4.0), (4.5, 4.5), (4.9, 4.2), (5.4, 4.0), (5.8, 5.2), (6.1, 4.8)]),
        ("office", [(5.3, 4.0), (4.0, 5.3), (5.3, 5.3)]),
    ],
)
def test_the_smallest_rooms_are_made_or_refused_in_a_sentence(kind, sizes):
    """Where what is drawn has hardly a choice, or none."""
    refused = []
    for size, seed in itertools.product(sizes, range(4)):
        try:
            assert generate_world(kind, size, seed=seed).size == size
        except ValueError as error:
            refused.append(str(error))
    assert all(kind in sentence for sentence in refused)
    assert len(refused) < 3 * len(sizes)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "cluter"}, '"cluter" is not a kind of room; did you mean "clutter"?'),
        ({"kind": "sea"}, '"sea" is not a kind of room; the kinds are clutter, blocks, corridors, office, '),
        ({"size": (1.0, 7.0)}, "size must be two lengths from 2 to 60 m; got 1 by 7"),
        ({"size": (7.0, math.nan)}, "size must be two lengths from 2 to 60 m; got 7 by nan"),
        ({"density": 0.0}, "density is the share of the floor that is covered, more than 0 and at most 0.6; got 0"),
        ({"density": 0.61}, "at most 0.6; got 0.61"),
        ({"density": math.nan}, "at most 0.6; got nan"),
        ({"seed": -1}, "seed must be a whole number, at least 0; got -1"),
        ({"index": -1}, "the number of a room must be at least 0; got -1"),
        ({"kind": "corridors", "size": (2.5, 7.0)}, "corridors need a room of at least 2.7 by 2.7 m, not 2.5 by 7 m"),
        (
            {"kind": "corridors", "size": (7.0, 4.0)},
            "4 m cannot be divided into cells of 1.35 to 1.9 m",
        ),
        ({"kind": "corridors", "density": 0.3}, "corridors in a room of 7 by 7 m cover 0.0"),
        ({"kind": "office", "size": (4.0, 5.0)}, "an office needs a room with a side of at least 5.3 m"),
        ({"kind": "warehouse", "size": (3.0, 7.0)}, "a warehouse needs a room of at least 4 by 4 m, not 3 by 7 m"),
        ({"kind": "blocks", "density": 0.6}, "no blocks with density 0.6 was found for a room of 7 by 7 m"),
    ],
)
def test_what_cannot_be_made_is_said_in_a_sentence(arguments, message):
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        generate_world(**arguments)
    assert message in str(caught.value)


# Distances of rectangles

_LENGTH = st.floats(0.05, 2.0)
_TURN = st.floats(-math.pi, math.pi)
_PLACE = st.floats(-2.5, 2.5)


@given(one=st.tuples(_PLACE, _PLACE, _LENGTH, _LENGTH, _TURN), other=st.tuples(_PLACE, _PLACE, _LENGTH, _LENGTH, _TURN))
@settings(max_examples=200, deadline=None)
def test_distances_of_rectangles_are_those_of_shapely(one, other):
    first, second = (Rectangle.of(r[:2], r[2:4], r[4]) for r in (one, other))
    shapes = []
    for x, y, a, b, yaw in (one, other):
        upright = shapely.box(x - a, y - b, x + a, y + b)
        shapes.append(shapely.affinity.rotate(upright, yaw, origin=(x, y), use_radians=True))
    distance = rectangle_distance(first, second)
    assert max(distance, 0.0) == pytest.approx(shapes[0].distance(shapes[1]), abs=1e-9)


def test_the_room_is_low_enough_for_the_robot():
    """The heights that passages are checked at are those of the robot and of what its camera sees too near."""
    from navsim.generate.rooms import SEEN_BELOW

    assert pytest.approx(SEEN_UP_TO, abs=0.01) == SEEN_BELOW
    assert max(TURTLEBOT2.height, SEEN_BELOW) >= SEEN_UP_TO - 0.01


def test_rooms_made_in_processes_of_their_own_are_the_same(tmp_path, monkeypatch):
    settings = RoomSettings("blocks", (4.0, 4.0), 0.06, 5)
    alone = [file.read_bytes() for _, file in write_rooms(settings, tmp_path / "alone", 3)]
    monkeypatch.setattr("navsim.generate.writing._WORTH_PROCESSES", 2)
    together = list(write_rooms(settings, tmp_path / "together", 3))
    assert [file.read_bytes() for _, file in together] == alone
    assert [world.name for world, _ in together] == [settings.name(index) for index in range(3)]


def test_a_killed_process_of_those_that_make_rooms_is_told(tmp_path):
    """In a sentence that says what to do, and not by waiting for it forever; no process is left."""
    before = set(multiprocessing.active_children())
    rooms = write_rooms(RoomSettings("clutter", (7.0, 7.0), 0.11, 5), tmp_path, count=4000)
    next(rooms)
    makers = set(multiprocessing.active_children()) - before
    assert makers
    makers.pop().kill()
    with pytest.raises(WorkerDeathError, match=rf"that make rooms was killed.*remove the rooms in {tmp_path}"):
        list(rooms)
    assert set(multiprocessing.active_children()) <= before


def test_so_little_furniture_that_it_would_be_thinner_than_a_millimetre_is_refused():
    with pytest.raises(ValueError, match=r"no clutter with density 0\.0001 was found for a room of 2 by 2 m"):
        generate_world("clutter", (2.0, 2.0), 1e-4, seed=1)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"size": 7}, "size must be two lengths from 2 to 60 m; got 7, choose others"),
        ({"seed": 1.5}, "seed must be a whole number, at least 0; got 1.5"),
    ],
)
def test_near_misses_are_told_in_a_sentence(settings, told):
    with pytest.raises(ValueError, match=told):
        generate_world(**settings)
