"""Other arrangements of a world's furniture, against shapely."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely

from navsim import World, load_world
from navsim.rearrange import TOGETHER, rearrange
from navsim.world import Box

GAP = 0.9


def shapes(world: World) -> list[shapely.Geometry]:
    """One for each obstacle."""
    by_obstacle: dict[int, list[shapely.Geometry]] = {}
    for prism in world.prisms:
        if prism.obstacle >= 0:
            shape = shapely.Point(prism.vertices[0]).buffer(prism.radius, quad_segs=64)
            shape = shape if prism.is_cylinder else shapely.Polygon(prism.vertices)
            by_obstacle.setdefault(prism.obstacle, []).append(shape)
    return [shapely.union_all(parts) for _, parts in sorted(by_obstacle.items())]


@pytest.fixture(scope="module", params=["complex_train", "simple_train"])
def rooms(request) -> tuple[World, list[World]]:
    world = load_world(request.param)
    return world, rearrange(world, 4, np.random.default_rng(0), GAP)


def test_gaps_are_closed_or_wide(rooms):
    for room in rooms[1]:
        for one, other in itertools.combinations(shapes(room), 2):
            distance = one.distance(other)
            assert distance < TOGETHER + 2e-3 or distance > GAP - 0.02 or _joined(room, one, other)


def _joined(room: World, one: shapely.Geometry, other: shapely.Geometry) -> bool:
    """Whether the two belong to one piece through others between them."""
    group = one
    for _ in range(10):
        near = [shape for shape in shapes(room) if shape.distance(group) < TOGETHER + 2e-3]
        group = shapely.union_all([group, *near])
    return group.distance(other) < 1e-9


def test_pieces_stand_against_a_wall_or_well_away_from_it(rooms):
    for room in rooms[1]:
        half = room.half_size
        inner = shapely.box(*(-half), *half)
        everything = shapely.union_all([shape.buffer(TOGETHER) for shape in shapes(room)])
        for piece in getattr(everything, "geoms", [everything]):
            slack = inner.exterior.distance(piece)
            assert slack == 0.0 or slack > GAP - TOGETHER - 0.02


def test_most_furniture_finds_a_place_and_keeps_its_shape(rooms):
    world, arranged = rooms
    original = {obstacle.name: shape.area for obstacle, shape in zip(world.obstacles, shapes(world), strict=True)}
    heights = {obstacle.name: (obstacle.base, obstacle.height) for obstacle in world.obstacles}
    for room in arranged:
        assert len(room.obstacles) > 0.75 * len(world.obstacles)
        for obstacle, shape in zip(room.obstacles, shapes(room), strict=True):
            assert shape.area == pytest.approx(original[obstacle.name], rel=1e-6)
            assert (obstacle.base, obstacle.height) == heights[obstacle.name]


def test_a_piece_moves_as_a_whole():
    parts = [
        {"box": {"name": "top", "at": [1, 1], "size": [1.0, 0.5], "base": 0.7, "height": 0.03, "yaw_deg": 20}},
        {"cylinder": {"name": "can", "at": [1.1, 1.05], "radius": 0.1, "height": 0.2}},
        {"polygon": {"name": "wedge", "points": [[0.8, 0.9], [1.0, 0.9], [0.9, 1.1]], "height": 0.1}},
    ]
    world = World.from_dict({"format": 1, "size": [7, 7], "obstacles": parts})
    before = shapes(world)
    for room in rearrange(world, 5, np.random.default_rng(1)):
        after = shapes(room)
        for one, other in itertools.combinations(range(3), 2):
            expected = before[one].centroid.distance(before[other].centroid)
            assert after[one].centroid.distance(after[other].centroid) == pytest.approx(expected, abs=1e-6)
            expected = before[one].intersection(before[other]).area
            assert after[one].intersection(after[other]).area == pytest.approx(expected, abs=1e-4)


def test_arrangements_differ_but_not_for_the_same_seed():
    world = load_world("simple_train")
    first, second = (rearrange(world, 2, np.random.default_rng(3)) for _ in range(2))
    assert [room.to_dict() for room in first] == [room.to_dict() for room in second]
    assert first[0].to_dict()["obstacles"] != first[1].to_dict()["obstacles"]
    assert first[0].random_starts
    assert first[0].random_goals


@pytest.mark.parametrize("reach", [0.05, 0.15, 0.3])
def test_small_things_that_swing_stay_in_the_room(reach):
    door = {"at": [reach / 2, 0.0], "size": [reach, 0.004], "height": 1.0}
    motion = {"hinge": [0.0, 0.0], "swing_deg": [-27.0, 27.0], "speed_deg": 30.0}
    world = World.from_dict({"format": 1, "size": [3.0, 3.0], "obstacles": [{"box": {**door, "motion": motion}}]})
    rooms = rearrange(world, 200, np.random.default_rng(1), GAP)  # each is checked as it is made
    assert sum(len(room.obstacles) for room in rooms) == 200


@pytest.mark.parametrize("radius", [0.02, 0.119, 0.5])
def test_cylinders_stay_in_the_room(radius):
    can = {"cylinder": {"at": [0, 0], "radius": radius, "height": 1}}
    world = World.from_dict({"format": 1, "size": [4, 4], "obstacles": [can]})
    places = np.array([room.obstacles[0].at for room in rearrange(world, 60, np.random.default_rng(0), GAP)])
    reach = np.abs(places).max(axis=1) + radius
    assert reach.max() <= 2.0
    assert np.sum(reach > 2.0 - 0.03 * radius) > 10  # against a wall, but for the polygon around it


def test_nothing_small_is_put_into_something_large():
    world = World.from_dict(
        {
            "format": 1,
            "size": [10, 10],
            "obstacles": [
                {"box": {"at": [-2.5, 0.0], "size": [4.5, 4.5], "height": 1.0}},
                {"cylinder": {"at": [3.0, 0.0], "radius": 0.1, "height": 0.3}},
            ],
        }
    )
    rooms = [shapes(room) for room in rearrange(world, 40, np.random.default_rng(0), GAP)]
    apart = [one.distance(other) for one, other in (room for room in rooms if len(room) == 2)]
    assert len(apart) > 30
    assert min(apart) > GAP - 0.02


@pytest.mark.parametrize("sides", [(5.6, 0.3), (1.1, 1.1)])
def test_a_piece_as_long_as_the_room_leaves_no_narrow_gap(sides):
    size = 7.0 if max(sides) > 2.0 else 3.0
    world = World(size=(size, size), obstacles=[Box(at=(0, 0), size=sides, height=1.0)])
    rooms = rearrange(world, 60, np.random.default_rng(0), GAP)
    for room in rooms:
        for shape in shapes(room):
            west, south, east, north = np.asarray(shape.bounds) + size / 2.0
            gaps = np.array([west, south, size - east, size - north])
            assert ((gaps < 0.01) | (gaps >= GAP - 1e-6)).all()
    assert sum(bool(room.obstacles) for room in rooms) > 20
