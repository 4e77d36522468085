"""Worlds made from dicts: their shapes (against shapely), defaults, errors, pickles and way back to dicts."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from navsim.errors import WorldError
from navsim.prism import Prism
from navsim.world import World

L_POINTS = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]]


def make_world(*obstacles, **settings) -> World:
    return World.from_dict({"format": 1, "size": [8.0, 6.0], "obstacles": list(obstacles), **settings})


def box(**settings) -> dict:
    return {"box": {"at": [1.0, 1.0], "size": [0.5, 0.5], "height": 0.4, **settings}}


def cylinder(**settings) -> dict:
    return {"cylinder": {"at": [-1.0, 1.0], "radius": 0.2, "height": 0.3, **settings}}


def polygon(points, **settings) -> dict:
    return {"polygon": {"points": points, "height": 1.0, **settings}}


def problems_of(data) -> list[str]:
    with pytest.raises(WorldError) as caught:
        World.from_dict(data)
    return list(caught.value.problems)


def obstacle_prisms(world: World) -> list[Prism]:
    return [prism for prism in world.prisms if prism.obstacle >= 0]


def wall_prisms(world: World) -> list[Prism]:
    return [prism for prism in world.prisms if prism.obstacle < 0]


def same_area(a: shapely.Geometry, b: shapely.Geometry) -> bool:
    return a.symmetric_difference(b).area < 1e-9 * b.area


def test_a_world_needs_no_more_than_its_format_and_size():
    world = World.from_dict({"format": 1, "size": [8, 6]})
    assert world.name == "world"
    assert (world.walls.height, world.walls.thickness) == (2.0, 0.1)
    assert world.obstacles == ()
    assert world.random_starts
    assert world.random_goals
    assert world.paths == ()
    np.testing.assert_array_equal(world.half_size, [4.0, 3.0])


def test_obstacles_without_a_name_are_called_by_kind_and_place_in_the_file():
    world = make_world(box(), cylinder(), cylinder(name="can"), polygon(L_POINTS))
    assert [obstacle.name for obstacle in world.obstacles] == ["box 1", "cylinder 2", "can", "polygon 4"]
    assert list(dict.fromkeys(prism.name for prism in obstacle_prisms(world))) == [
        "box 1",
        "cylinder 2",
        "can",
        "polygon 4",
    ]


def test_paths_pair_every_start_with_every_goal():
    world = make_world(starts=[[-3, 2], {"at": [-3, -2], "yaw_deg": 90}], goals=[[3, 2], [3, 0], [3, -2]])
    assert world.paths == ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2))
    assert [(start.at, start.yaw_deg) for start in world.starts] == [((-3.0, 2.0), None), ((-3.0, -2.0), 90.0)]


@pytest.mark.parametrize("drawn", ["starts", "goals"])
def test_there_are_no_fixed_paths_when_starts_or_goals_are_random(drawn):
    world = make_world(**{"starts": [[-3, 2]], "goals": [[3, 2]], drawn: "random"})
    assert (world.random_starts, world.random_goals) == (drawn == "starts", drawn == "goals")
    assert world.paths == ()


@pytest.mark.parametrize("yaw_deg", [-360, -90, 0, 17, 30, 45, 90, 135, 180, 270, 300.5])
def test_a_box_is_turned_counter_clockwise_about_its_centre(yaw_deg):
    (prism,) = obstacle_prisms(make_world(box(at=[1.0, -0.5], size=[1.2, 0.4], yaw_deg=yaw_deg)))
    upright = shapely.box(1.0 - 0.6, -0.5 - 0.2, 1.0 + 0.6, -0.5 + 0.2)
    assert same_area(shapely.Polygon(prism.vertices), affinity.rotate(upright, yaw_deg, origin=(1.0, -0.5)))
    assert shapely.LinearRing(prism.vertices).is_ccw


def test_a_quarter_turn_leaves_no_rounding_errors():
    (prism,) = obstacle_prisms(make_world(box(at=[0.0, 0.0], size=[2.0, 1.0], yaw_deg=90)))
    assert {tuple(vertex) for vertex in prism.vertices} == {(0.5, 1.0), (-0.5, 1.0), (-0.5, -1.0), (0.5, -1.0)}


def test_a_cylinder_is_its_centre_and_radius():
    (prism,) = obstacle_prisms(make_world(cylinder(at=[0.5, -1.0], radius=0.25)))
    assert prism.is_cylinder
    assert prism.radius == 0.25
    np.testing.assert_array_equal(prism.vertices, [[0.5, -1.0]])


@pytest.mark.parametrize("turn", [1, -1], ids=["counter-clockwise", "clockwise"])
def test_the_prisms_of_a_concave_polygon_fill_it_without_overlap(turn):
    prisms = obstacle_prisms(make_world(cylinder(), polygon(L_POINTS[::turn])))[1:]
    pieces = [shapely.Polygon(prism.vertices) for prism in prisms]
    assert len(pieces) == 2
    assert sum(piece.area for piece in pieces) == pytest.approx(3.0)
    assert same_area(shapely.union_all(pieces), shapely.Polygon(L_POINTS))
    assert all(shapely.LinearRing(prism.vertices).is_ccw for prism in prisms)
    assert {prism.obstacle for prism in prisms} == {1}


def test_prisms_extend_from_base_to_base_plus_height():
    (shelf,) = obstacle_prisms(make_world(box(base=0.7, height=0.03)))
    assert (shelf.base, shelf.top) == (0.7, pytest.approx(0.73))
    assert shelf.overlaps_heights(0.72, 1.0)
    assert not shelf.overlaps_heights(0.0, 0.7)
    assert not shelf.overlaps_heights(0.74, 1.0)


def test_walls_stand_outside_the_room_and_close_it():
    north, east, south, west = wall_prisms(make_world(walls={"height": 1.5, "thickness": 0.2}))
    outlines = [shapely.Polygon(wall.vertices) for wall in (north, east, south, west)]
    room = shapely.box(-4.0, -3.0, 4.0, 3.0)
    assert same_area(shapely.union_all(outlines), shapely.box(-4.2, -3.2, 4.2, 3.2) - room)
    assert sum(outline.area for outline in outlines) == pytest.approx(8.4 * 6.4 - 8.0 * 6.0)
    assert all(shapely.LinearRing(wall.vertices).is_ccw for wall in (north, east, south, west))
    assert {(wall.base, wall.top) for wall in (north, east, south, west)} == {(0.0, 1.5)}
    assert [wall.name for wall in (north, east, south, west)] == ["wall north", "wall east", "wall south", "wall west"]
    assert north.vertices[:, 1].min() == 3.0
    assert east.vertices[:, 0].min() == 4.0
    assert south.vertices[:, 1].max() == -3.0
    assert west.vertices[:, 0].max() == -4.0


def test_walls_none_leaves_the_floor_open():
    world = make_world(box(), walls="none")
    assert world.walls is None
    assert wall_prisms(world) == []
    assert len(world.prisms) == 1


def test_vertices_of_prisms_cannot_be_written_to():
    for prism in make_world(box(), polygon(L_POINTS)).prisms:
        with pytest.raises(ValueError, match="read-only"):
            prism.vertices[0, 0] = 5.0


@pytest.mark.parametrize("shape", [box(yaw_deg=33), cylinder(), polygon(L_POINTS)], ids=["box", "cylinder", "polygon"])
def test_the_bounding_circle_holds_the_footprint(shape):
    for prism in obstacle_prisms(make_world(shape)):
        centre, radius = prism.bounding_circle
        footprint = shapely.MultiPoint(prism.vertices).convex_hull.buffer(prism.radius)
        assert shapely.Point(centre).buffer(radius + 1e-6, quad_segs=2000).contains(footprint)


def test_worlds_are_immutable_and_compare_by_content():
    world, same = make_world(box()), make_world(box())
    assert world == same
    assert hash(world) == hash(same)
    assert world != make_world(box(height=0.41))
    with pytest.raises(ValueError, match="frozen"):
        world.name = "other"


def test_a_pickled_world_is_the_same_world_without_its_derived_values():
    world = make_world(box(), polygon(L_POINTS), walls="none", starts=[[-3, 2]], goals="random")
    before = pickle.dumps(world)
    outlines = [prism.vertices for prism in world.prisms]
    assert len(pickle.dumps(world)) == len(before)
    for again in (pickle.loads(pickle.dumps(world)), copy.deepcopy(world)):
        assert again == world
        assert hash(again) == hash(world)
        for prism, outline in zip(again.prisms, outlines, strict=True):
            np.testing.assert_array_equal(prism.vertices, outline)


def test_a_changed_copy_derives_its_own_values():
    world = make_world(box())
    assert len(world.prisms) == 5
    world.derived["places"] = 1
    open_floor = world.model_copy(update={"walls": None})
    assert len(open_floor.prisms) == 1
    assert open_floor.derived == {}
    assert world.derived["places"] == 1


def test_a_world_reads_as_what_is_in_it():
    world = make_world(box(), cylinder(), starts=[[-3, 2]], goals=[[3, 2], [3, 0]], name="office")
    assert repr(world) == "World('office', 8 x 6 m, 2 m walls, 2 obstacles, 1 start, 2 goals)"
    assert (
        str(make_world(walls="none")) == "World('world', 8 x 6 m, open floor, 0 obstacles, random starts, random goals)"
    )


def test_to_dict_leaves_defaults_out():
    world = make_world(box(yaw_deg=0.0, base=0.0, name=""), cylinder(name="can"), goals=[{"at": [3, 2]}])
    assert world.to_dict() == {
        "format": 1,
        "name": "world",
        "size": [8.0, 6.0],
        "obstacles": [
            {"box": {"at": [1.0, 1.0], "size": [0.5, 0.5], "height": 0.4}},
            {"cylinder": {"at": [-1.0, 1.0], "radius": 0.2, "height": 0.3, "name": "can"}},
        ],
        "starts": "random",
        "goals": [[3.0, 2.0]],
    }


def test_to_dict_keeps_a_start_that_faces_zero_apart_from_one_that_is_drawn():
    world = make_world(starts=[{"at": [-3, 2], "yaw_deg": 0}, [-3, -2]], walls="none")
    assert world.to_dict()["starts"] == [{"at": [-3.0, 2.0], "yaw_deg": 0.0}, [-3.0, -2.0]]
    assert world.to_dict()["walls"] == "none"
    assert World.from_dict(world.to_dict()) == world


def test_from_dict_leaves_its_argument_alone():
    data = {"format": 1, "size": [8, 6], "obstacles": [box()], "starts": [[-3, 2]], "goals": "random"}
    before = copy.deepcopy(data)
    World.from_dict(data)
    assert data == before


def test_tuples_do_for_lists():
    assert World.from_dict({"format": 1, "size": (8, 6), "obstacles": (box(at=(1.0, 1.0)),)}) == make_world(box())


@pytest.mark.parametrize("data", [None, [], 5, "world"])
def test_what_is_not_a_mapping_is_refused(data):
    (problem,) = problems_of(data)
    assert problem.startswith("a world is a mapping with keys such as 'format', not ")


def test_errors_of_a_dict_name_the_key_and_come_all_at_once():
    data = {
        "format": 1,
        "size": [8.0, -6.0],
        "colour": "red",
        "walls": {"hight": 1.0},
        "obstacles": [
            box(height=0.0),
            box(),
            cylinder(at=[0.0, math.nan]),
            {"cylinder": {"at": [0, 0], "height": 1}},
            polygon([[0, 0], [1, 1], [1, 0], [0, 1]]),
        ],
        "starts": [{"at": [0, 0], "yaw_deg": 361}],
        "goals": "everywhere",
    }
    assert set(problems_of(data)) == {
        "size[1]: must be greater than 0, not -6.0",
        "colour: is not a known key; the keys here are format, name, size, walls, obstacles, starts, goals",
        "walls.hight: is not a known key; did you mean 'height'?",
        "obstacles[0].box.height: must be greater than 0, not 0.0",
        "obstacles[2].cylinder.at[1]: must be a finite number, not nan",
        "obstacles[3].cylinder: key 'radius' is missing; add 'radius: 0.2'",
        "obstacles[4].polygon.points: the edges between points 1-2 and 3-4 cross or touch; "
        "list the corners in order around the outline",
        "starts[0].yaw_deg: must be at most 360, not 361",
        "goals: must be 'random' or a list of points, not 'everywhere'",
    }


def test_the_message_of_an_error_is_its_problems_one_a_line():
    with pytest.raises(WorldError) as caught:
        World.from_dict({"format": 3})
    assert str(caught.value) == "\n".join(caught.value.problems)
    assert len(caught.value.problems) == 2
    assert pickle.loads(pickle.dumps(caught.value)).problems == caught.value.problems
    assert isinstance(caught.value, ValueError)


def test_a_misspelt_required_key_is_not_reported_as_missing_too():
    assert problems_of({"format": 1, "seize": [8, 6]}) == ["seize: is not a known key; did you mean 'size'?"]


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | st.just("random"),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=4) | st.sampled_from(["at", "box", "polygon", "points", "size"]), inner)
        | st.dictionaries(st.integers() | st.tuples(st.integers()), inner, max_size=2)
    ),
    max_leaves=8,
)
FULL = {
    "format": 1,
    "name": "full",
    "size": [8.0, 6.0],
    "walls": {"height": 1.0},
    "obstacles": [
        box(),
        cylinder(),
        polygon(L_POINTS),
        cylinder(at=[3, 1], motion={"path": [[3, 1], [3, -0.5]], "speed": 0.5}),
        cylinder(at=[-3, 0.5], motion={"hinge": [-3, 0.4], "swing_deg": [0, 90], "speed_deg": 30}),
        cylinder(at=[2, -2], radius=0.1, pushable={"mass": 0.35, "friction": 0.3}),
    ],
    "starts": [{"at": [-3, 2], "yaw_deg": 0}, [-3, -2]],
    "goals": [[3, -2]],
}


def branches(data) -> list[tuple]:
    """Where every value of ``data`` stands."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path for key, value in inner for path in [(key,), *((key, *rest) for rest in branches(value))]]


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(branches(FULL)), anything)
def test_whatever_stands_in_the_place_of_a_value_is_a_world_or_a_world_error(path, value):
    data = copy.deepcopy(FULL)
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    try:
        world, problems = World.from_dict(data), ()
    except WorldError as error:
        world, problems = None, error.problems
    assert all(problem and "\n" not in problem and "such as ," not in problem for problem in problems)
    assert bool(problems) or World.from_dict(world.to_dict()) == world


def test_places_may_be_arrays():
    starts, goals = np.array([[0.0, 0.0], [1.0, 1.0]]), [np.array([2.0, 2.0])]
    world = World(size=(7, 7), starts=starts, goals=goals)
    assert world == World(size=(7, 7), starts=starts.tolist(), goals=[(2.0, 2.0)])
