"""The picture that authors look at: what is on it, and that the view is what can be seen from there."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.patches import Polygon as PolygonPatch

from navsim import show
from navsim.draw import VIEW
from navsim.errors import WorldError
from navsim.oddities import outlines
from navsim.planner import shortest_path
from navsim.world import Box, Cylinder, Polygon, World

WORLD = World(
    name="hall",
    size=(7, 7),
    obstacles=[
        Box(name="chest", at=(1.5, 0.2), size=(0.5, 0.9), height=0.8),
        Cylinder(name="post", at=(2.4, 1.6), radius=0.1, height=1.8),
        Polygon(name="corner", points=[(-3, 3), (-1, 3), (-1, 2.6), (-2.6, 2.6), (-2.6, 1), (-3, 1)], height=1),
    ],
    starts=[(-2, -2), {"at": (2, -2), "yaw_deg": 90}],
    goals=[(3, 0), (-2, 0)],
)


def plan(pose=None, names=True, world=WORLD):
    return show._plan_view(world, names, pose)


def test_every_goal_has_the_disc_that_counts_as_reached():
    discs = [patch for patch in plan().axes[0].patches if isinstance(patch, Circle) and patch.radius == 0.5]
    assert [disc.center for disc in discs] == [(3.0, 0.0), (-2.0, 0.0)]


def test_every_pair_has_its_shortest_path():
    (lines,) = [one for one in plan().axes[0].collections if isinstance(one, LineCollection)]
    drawn = [np.asarray(segment) for segment in lines.get_segments()]
    expected = [shortest_path(WORLD, s.at, g.at, goal_radius=0.0) for s in WORLD.starts for g in WORLD.goals]
    assert len(drawn) == 4
    for line, path in zip(drawn, expected, strict=True):
        np.testing.assert_allclose(line, path)
    assert not list(plan(world=WORLD.replace(goals="random")).axes[0].collections)


def test_names_stand_on_their_obstacles_and_can_be_left_out():
    texts = {text.get_text(): text for text in plan().axes[0].texts}
    assert {"chest", "post", "corner"} <= set(texts)
    for obstacle in WORLD.obstacles:
        assert outlines([obstacle])[0].contains(shapely.Point(texts[obstacle.name].xy))
    assert "chest" not in {text.get_text() for text in plan(names=False).axes[0].texts}


def test_names_that_would_cover_one_another_move_aside():
    world = World(size=(7, 7), obstacles=[Cylinder(at=(0, 0), radius=0.1 + 0.01 * i, height=1) for i in range(4)])
    figure = plan(world=world)
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


@pytest.mark.parametrize("pose", [(-0.5, 0.1, 0.2), (0.3, -1.0, 1.0), (-2.0, 0.5, math.pi / 2)])
def test_the_floor_in_view_is_what_a_straight_look_reaches(pose):
    (view,) = [
        patch
        for patch in plan(pose).axes[0].patches
        if isinstance(patch, PolygonPatch) and patch.get_facecolor()[:3] == Circle((0, 0), fc=VIEW).get_facecolor()[:3]
    ]
    cone = shapely.Polygon(view.get_xy())
    x, y, yaw = pose
    eye = np.array([x - 0.087 * math.cos(yaw), y - 0.087 * math.sin(yaw)])
    solid = shapely.union_all(outlines(WORLD.obstacles))
    room = shapely.box(-3.5, -3.5, 3.5, 3.5)
    rng = np.random.default_rng(0)
    compared = 0
    for point in rng.uniform(-3.4, 3.4, (400, 2)):
        off = point - eye
        ahead = off @ (math.cos(yaw), math.sin(yaw))
        aside = abs(off @ (-math.sin(yaw), math.cos(yaw)))
        in_picture = 0.0 < ahead < 5.0 and aside < ahead * math.tan(math.radians(30))
        seen = (
            in_picture
            and not shapely.LineString([eye, point]).intersects(solid)
            and room.contains(shapely.Point(point))
        )
        if cone.boundary.distance(shapely.Point(point)) > 0.05:
            assert cone.contains(shapely.Point(point)) == seen
            compared += seen
    assert compared > 5


def test_the_floor_under_a_table_is_in_view():
    table = Box(at=(2.0, 0.0), size=(1.2, 2.4), base=0.7, height=0.04)
    axes = plan((0.9, 0.0, 0.0), world=World(size=(8, 6), obstacles=[table])).axes[0]
    colour = Circle((0, 0), fc=VIEW).get_facecolor()[:3]
    (view,) = [p for p in axes.patches if isinstance(p, PolygonPatch) and p.get_facecolor()[:3] == colour]
    assert shapely.Polygon(view.get_xy()).contains(shapely.Point(3.0, 0.0))


def test_the_view_is_drawn_beside_the_plan():
    figure = plan((0.0, 0.0, math.pi / 2))
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:2] == ["hall", "seen from (0, 0), facing 90°"]
    assert len(figure.axes[1].images) == 1
    assert figure.axes[1].get_xlabel().startswith("nearest: ")
    assert plan((1.5, 0.2, 0.0)).axes[1].get_xlabel() == "inside an obstacle"


@pytest.mark.parametrize("text", ["1,2", "1,2,3,4", "", "a,b,c", "1,2,nan", "1;2;3"])
def test_a_place_is_three_finite_numbers(text):
    with pytest.raises(WorldError, match=r"is not a place to look from; write three numbers x,y,yaw"):
        show.parse_pose(text)


def test_names_are_no_formulas():
    """Which two dollar signs begin and end, for matplotlib."""
    (post,) = [obstacle for obstacle in WORLD.obstacles if obstacle.name == "post"]
    world = WORLD.replace(name="5$ room, 7$", obstacles=[post.replace(name="$x_$")])
    figure = show._plan_view(world, True, None)
    figure.canvas.draw()
    assert "$x_$" in {text.get_text() for text in figure.axes[0].texts}
    assert show.plan_png(world).startswith(b"\x89PNG")


def test_a_place_is_given_in_metres_and_degrees():
    assert show.parse_pose("-1, 2.5 ,-90") == (-1.0, 2.5, -math.pi / 2)


@pytest.mark.parametrize("size", [(1, 1), (40, 3), (3, 40)])
def test_rooms_of_any_shape_are_drawn(size, tmp_path):
    picture = show.save_plan_view(World(size=size), tmp_path / "plan.png", pose=(0.0, 0.0, 0.0))
    assert picture.stat().st_size > 10_000
    assert show.plan_png(World(size=size)).startswith(b"\x89PNG")
