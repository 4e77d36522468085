"""Worlds built and changed in Python: the same checks and the same sentences as for files."""

from __future__ import annotations

import pickle

import pytest
from matplotlib import pyplot

import navsim
from navsim import Box, Cylinder, Goal, Motion, Polygon, Pushable, Start, Swing, Walls, World, WorldError


def desk(**settings) -> Box:
    return Box(**{"name": "desk", "at": (1, 0), "size": (1.2, 0.6), "height": 0.75, **settings})


def refused(make, *arguments, **settings) -> list[str]:
    with pytest.raises(WorldError) as caught:
        make(*arguments, **settings)
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    return list(caught.value.problems)


def test_a_world_is_built_of_its_parts():
    world = World(
        name="hall",
        size=(7, 7),
        walls=Walls(height=1),
        obstacles=[
            desk(),
            Cylinder(at=(-1, 1), radius=0.2, height=1, pushable=Pushable(mass=2)),
            Polygon(points=[(-3, 3), (-2, 3), (-2, 2)], height=1),
            Cylinder(at=(3, 2), radius=0.2, height=1, motion=Motion(path=[(3, 2), (3, 0)], speed=1)),
            Box(at=(0, 3), size=(1, 0.05), height=2, motion=Swing(hinge=(-0.5, 3), swing_deg=(0, -60), speed_deg=20)),
        ],
        starts=[Start(at=(-3, -3), yaw_deg=45), (2, -2)],
        goals=[Goal(at=(-3, 0)), [0, -3]],
    )
    assert world == World.from_dict(world.to_dict()) == World.from_yaml(world.to_yaml())
    assert [obstacle.name for obstacle in world.obstacles] == ["desk", "cylinder 2", "polygon 3", "cylinder 4", "box 5"]
    assert pickle.loads(pickle.dumps(world)) == world


@pytest.mark.parametrize(
    ("make", "settings", "problems"),
    [
        (World, {"size": (7, -7)}, ["size[1]: must be greater than 0, not -7"]),
        (World, {}, ["key 'size' is missing; add 'size: [7.0, 7.0]'"]),
        (World, {"size": (7, 7), "obstcles": []}, ["obstcles: is not a known key; did you mean 'obstacles'?"]),
        (World, {"size": (7, 7), "starts": [(9, 0)]}, ["starts[0]: [9, 0] is outside the room, x from -3.5 to 3.5 "
            "and y from -3.5 to 3.5; move it or enlarge 'size'"]),
        (World, {"size": (7, 7), "obstacles": [{"box": {"at": [0, 0], "size": [1, 1]}}]},
            ["obstacles[0].box: key 'height' is missing; add 'height: 0.5'"]),
        (Box, {"at": (0, 0), "height": 1}, ["box: key 'size' is missing; add 'size: [0.6, 0.4]'"]),
        (Box, {"at": (0, 0), "size": (1, 0), "hieght": 1},
            ["box.size[1]: must be greater than 0, not 0", "box.hieght: is not a known key; did you mean 'height'?"]),
        (Cylinder, {"at": (0, 0), "radius": "1", "height": 1}, ["cylinder.radius: must be a number, not '1'"]),
        (Polygon, {"points": [(0, 0), (1, 1), (1, 0), (0, 1)], "height": 1}, ["polygon.points: the edges between "
            "points 1-2 and 3-4 cross or touch; list the corners in order around the outline"]),
        (Walls, {"hight": 1}, ["walls.hight: is not a known key; did you mean 'height'?"]),
        (Start, {"at": (0, 0), "yaw": 3}, ["start.yaw: is not a known key; did you mean 'yaw_deg'?"]),
        (Goal, {"at": 3}, ["goal.at: must be two numbers, such as [1.0, 2.0], not 3"]),
        (Swing, {"hinge": (0, 0), "swing_deg": (0, 3), "speed": 3}, ["swing.speed: is not a known key; "
            "did you mean 'speed_deg'?"]),
        (Pushable, {"mass": 0}, ["pushable.mass: must be greater than 0, not 0"]),
    ],
)  # fmt: skip
def test_a_mistake_is_told_in_the_words_of_files(make, settings, problems):
    assert refused(make, **settings) == problems


def test_changes_return_other_worlds_and_leave_this_one_alone():
    world = World(size=(7, 7), obstacles=[desk()], starts=[(-3, 0)], goals=[(3, 3)])
    before = world.to_yaml()
    larger = world.add(desk(name="", at=(-1, 2)), Cylinder(at=(0, 2), radius=0.1, height=1))
    assert [one.name for one in larger.obstacles] == ["desk", "box 2", "cylinder 3"]
    assert world.without("desk").obstacles == ()
    assert world.change("desk", at=(2, 0), name="table").obstacles == (desk(at=(2, 0), name="table"),)
    assert world.replace(size=(9, 8), walls=None, starts="random").size == (9.0, 8.0)
    assert desk().replace(height=1.0) == desk(height=1.0)
    assert world.to_yaml() == before


def test_derived_values_are_those_of_the_changed_world():
    world = World(size=(7, 7), obstacles=[desk()])
    assert len(world.prisms) == 5
    assert len(world.without("desk").prisms) == 4
    assert world.change("desk", height=2).prisms[-1].top == 2.0


def test_names_given_to_added_obstacles_are_free():
    world = World(size=(7, 7), obstacles=[Box(at=(i, 0), size=(0.1, 0.1), height=1) for i in range(3)])
    world = world.without("box 1").add(Box(at=(0, 2), size=(0.1, 0.1), height=1), desk(name="box 4", at=(-2, 2)))
    assert [obstacle.name for obstacle in world.obstacles] == ["box 2", "box 3", "box 5", "box 4"]
    assert World.from_yaml(world.to_yaml()) == world


def test_changes_are_checked():
    world = World(size=(7, 7), obstacles=[desk()], starts=[(-3, 0)], goals=[(3, 3)])
    free = "until 0.2255 m around it are free"
    assert refused(world.change, "desk", at=(-3, 0)) == [f"starts[0]: is inside 'desk'; move it {free}"]
    assert refused(world.add, desk(at=(-3, 0))) == [f"starts[0]: is inside 'desk'; move it {free}"]
    assert refused(world.change, "desk", heigth=2) == ["box.heigth: is not a known key; did you mean 'height'?"]
    assert refused(world.change, "dsk", height=2) == ["no obstacle is called 'dsk'; did you mean 'desk'?"]
    assert refused(world.without, "sofa") == ["no obstacle is called 'sofa'; there are ['desk']"]
    assert refused(World(size=(7, 7)).without, "sofa") == ["no obstacle is called 'sofa'; there are none"]
    assert refused(world.replace, size=(3, 3))[0].startswith("starts[0]: [-3, 0] is outside the room")


def test_a_notebook_shows_a_picture_without_global_state():
    world = World(size=(7, 3), obstacles=[desk()], starts=[(-3, 0)], goals=[(3, 1)])
    figures = pyplot.get_fignums()
    picture = world._repr_png_()
    assert picture.startswith(b"\x89PNG")
    assert pyplot.get_fignums() == figures
    assert picture != world.without("desk")._repr_png_()


def test_every_part_of_a_world_is_offered():
    for part in (Box, Cylinder, Goal, Motion, Polygon, Pushable, Start, Swing, Walls, World):
        assert part.__name__ in navsim.__all__
