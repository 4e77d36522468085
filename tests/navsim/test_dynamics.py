import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from navsim.camera import DepthCamera
from navsim.dynamics import Dynamics, dynamic_obstacles, outlines
from navsim.errors import WorldError
from navsim.raycast import Scene, cast, nearest_depth, render_depth
from navsim.world import World

WALKER = {"at": [2, 2], "radius": 0.2, "height": 1.7}
DOOR = {"at": [0.45, 0], "size": [0.9, 0.04], "height": 1.9}
SWING = {"hinge": [0, 0], "swing_deg": [0, 90], "speed_deg": 45}


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def walker(path, speed=0.5, **motion):
    return {"cylinder": {**WALKER, "at": path[0], "motion": {"path": path, "speed": speed, **motion}}}


def door(**settings):
    return {"box": {**DOOR, **settings, "motion": SWING}}


def poses_at(world, times, phases=None):
    dynamics = Dynamics([world])
    rows = np.zeros(len(times), dtype=np.intp)
    own = np.zeros(dynamics.most) if phases is None else np.asarray(phases, dtype=float)
    return dynamics.poses(rows, np.broadcast_to(own, (len(times), dynamics.most)), np.asarray(times, dtype=float))


PATH = [[2.0, 2.0], [2.0, -1.0], [-2.0, -1.0]]


def test_there_and_back_follows_the_closed_form():
    world, line = make_world(walker(PATH, speed=0.7)), shapely.LineString(PATH)
    times = np.linspace(0.0, 60.0, 301)
    for time, pose in zip(times, poses_at(world, times)[:, 0], strict=True):
        turns, rest = divmod(0.7 * time, line.length)
        expected = line.interpolate(rest if turns % 2 == 0 else line.length - rest)
        np.testing.assert_allclose(pose, [expected.x, expected.y, 0.0], atol=1e-9)


def test_a_circuit_closes_and_follows_the_closed_form():
    world, ring = make_world(walker(PATH, speed=1.3, repeat="circuit")), shapely.LineString([*PATH, PATH[0]])
    times = np.linspace(0.0, 60.0, 301)
    for time, pose in zip(times, poses_at(world, times)[:, 0], strict=True):
        expected = ring.interpolate(1.3 * time % ring.length)
        np.testing.assert_allclose(pose, [expected.x, expected.y, 0.0], atol=1e-9)


def test_a_door_swings_from_angle_to_angle_and_back():
    times = np.linspace(0.0, 20.0, 401)
    poses = poses_at(make_world(door()), times)[:, 0]
    away = 45.0 * times % 180.0
    expected = np.where(away <= 90.0, away, 180.0 - away)
    np.testing.assert_allclose(np.rad2deg(poses[:, 2]), expected, atol=1e-9)
    np.testing.assert_array_equal(poses[:, :2], 0.0)


@pytest.mark.parametrize("repeat", ["there-and-back", "circuit"])
def test_a_phase_is_a_share_of_the_period(repeat):
    world = make_world(walker(PATH, speed=0.5, repeat=repeat))
    length = 7.0 if repeat == "there-and-back" else 12.0
    period = (2 * length if repeat == "there-and-back" else length) / 0.5
    times = np.linspace(0.0, 30.0, 61)
    np.testing.assert_allclose(poses_at(world, times, [0.25]), poses_at(world, times + 0.25 * period), atol=1e-9)
    np.testing.assert_allclose(poses_at(world, times), poses_at(world, times + period), atol=1e-9)


def test_phases_are_drawn_evenly_for_what_moves_only():
    world = make_world(walker(PATH), door(), {"cylinder": {**WALKER, "at": [-3, -3], "pushable": {"mass": 1}}})
    dynamics, generator = Dynamics([world]), np.random.default_rng(0)
    phases = np.array([dynamics.draw_phases(0, generator) for _ in range(2000)])
    np.testing.assert_array_equal(phases[:, 2], 0.0)
    for drawn in phases[:, :2].T:
        assert np.abs(np.histogram(drawn, 10, (0, 1))[0] - 200).max() < 60  # 4.5 standard deviations
    assert abs(np.corrcoef(phases[:, :2].T)[0, 1]) < 0.1


def test_worlds_with_unlike_numbers_of_things_share_arrays():
    worlds = [make_world(), make_world(walker(PATH), door()), make_world(walker([[1, 1], [2, 1]], 1.0))]
    dynamics = Dynamics(worlds)
    rows = np.array([2, 0, 1])
    poses = dynamics.poses(rows, np.zeros((3, 2)), np.full(3, 0.5))
    np.testing.assert_allclose(poses[0], [[1.5, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(poses[1], 0.0)
    np.testing.assert_allclose(poses[2], [[2, 1.75, 0], [0, 0, math.radians(22.5)]], atol=1e-12)
    np.testing.assert_array_equal(dynamics.prisms(rows, poses).robot, [0, 2, 2])


L_SHAPE = [[-2, -2], [-1, -2], [-1, -1.6], [-1.6, -1.6], [-1.6, -1], [-2, -1]]


def test_distances_are_those_of_shapely():
    concave = {"polygon": {"points": L_SHAPE, "height": 1, "motion": {**SWING, "hinge": [-2, -2]}}}
    world = make_world(walker(PATH), door(), concave)
    dynamics, generator = Dynamics([world]), np.random.default_rng(1)
    poses = poses_at(world, generator.uniform(0, 30, 40))
    for row in poses:
        hinged = zip((shapely.box(0, -0.02, 0.9, 0.02), shapely.Polygon(L_SHAPE)), ((0, 0), (-2, -2)), strict=True)
        turned = [
            shapely.affinity.rotate(shape, math.degrees(pose[2]), hinge)
            for (shape, hinge), pose in zip(hinged, row[1:], strict=True)
        ]
        shapes = [shapely.Point(row[0, :2]).buffer(0.2, quad_segs=1000), *turned]
        for slot, shape in enumerate(shapes):
            point = generator.uniform(-3, 3, 2)
            found = dynamics.distances(np.array([0]), np.array([slot]), row[slot][None], point[None])[0]
            expected = shape.distance(shapely.Point(point))
            assert found == pytest.approx(expected, abs=1e-6) if expected > 0 else found <= 0


def still(world, row):
    """The same world with everything standing where it is at poses ``row``."""
    standing = [obstacle for obstacle in world.to_dict()["obstacles"] if not ({"motion", "pushable"} & _keys(obstacle))]
    for one, pieces in zip(dynamic_obstacles(world), outlines(world, row), strict=True):
        for vertices, radius in pieces:
            if radius:
                shape = {"cylinder": {"at": vertices[0].tolist(), "radius": radius}}
            else:
                shape = {"polygon": {"points": vertices.tolist()}}
            (settings,) = shape.values()
            settings |= {"base": one.base, "height": one.top - one.base}
            standing.append(shape)
    return make_world(*standing)


def _keys(obstacle):
    (settings,) = obstacle.values()
    return settings.keys()


@pytest.mark.parametrize(
    "camera",
    [DepthCamera(), DepthCamera(width=33, height=25, mount_z=0.8), DepthCamera(pitch_deg=12.0, mount_z=0.4)],
)
def test_depth_equals_that_of_a_still_world_with_everything_in_its_place(camera):
    low = {
        "box": {"at": [-1, 0], "size": [0.5, 0.3], "height": 0.2, "motion": {"path": [[-1, 0], [-2, 1]], "speed": 1}}
    }
    raised = {"box": {"at": [2.5, 0], "size": [0.3, 0.3], "base": 0.9, "height": 0.2, "yaw_deg": 20}}
    raised["box"]["motion"] = {"path": [[2.5, 0], [2.5, 1], [1.5, 2]], "speed": 0.3, "repeat": "circuit"}
    can = {"cylinder": {"at": [1, 1], "radius": 0.1, "height": 0.2, "pushable": {"mass": 1}}}
    fixed = {"box": {"at": [-2, -2], "size": [1, 0.5], "height": 0.7, "yaw_deg": 30}}
    world = make_world(walker(PATH), door(base=0.1), low, raised, can, fixed)
    generator = np.random.default_rng(2)
    views = generator.uniform([-3, -3, -math.pi], [3, 3, math.pi], (40, 3))
    seen = poses_at(world, generator.uniform(0, 60, 40), generator.uniform(0, 1, 5))
    moving = render_depth(world, views, camera, seen)
    standing = render_depth([still(world, row) for row in seen], views, camera)
    assert moving.tobytes() == standing.tobytes()
    assert not np.array_equal(moving, render_depth(world, views, camera))


def test_robots_with_cameras_of_their_own_see_what_moves_for_each():
    world = make_world(walker(PATH), door(base=0.1))
    generator, count = np.random.default_rng(4), 24
    views = generator.uniform([-3, -3, -math.pi], [3, 3, math.pi], (count, 3))
    seen = poses_at(world, generator.uniform(0, 60, count), generator.uniform(0, 1, 2))
    pitch_deg = np.where(np.arange(count) % 3 == 0, 0.0, generator.uniform(-15, 15, count))
    mounts = DepthCamera().mounts(count)._replace(pitch=np.radians(pitch_deg))
    scene, index = Scene([world.fixed_prisms]), np.zeros(count, dtype=np.intp)
    moving = Dynamics([world]).prisms(index, seen)
    images = cast(scene, index, views, DepthCamera(), mounts=mounts, moving=moving)
    nearest = nearest_depth(scene, index, views, DepthCamera(), 5.0, mounts=mounts, moving=moving)
    for robot in range(count):
        camera = DepthCamera(pitch_deg=float(pitch_deg[robot]))
        placed = still(world, seen[robot])
        one = slice(robot, robot + 1)
        np.testing.assert_array_equal(images[robot], render_depth(placed, views[one], camera)[0])
        alone = nearest_depth(Scene([placed]), index[one], views[one], camera, 5.0)
        assert nearest[robot] == alone[0]


def test_nearest_depth_sees_what_moves():
    world = make_world(walker([[2, 0], [1, 0]], 1.0))
    dynamics, index = Dynamics([world]), np.zeros(1, dtype=np.intp)
    scene, view = Scene([world.fixed_prisms]), np.zeros((1, 3))
    for time in (0.0, 0.5, 1.0):
        moving = dynamics.prisms(index, dynamics.poses(index, np.zeros((1, 1)), np.array([time])))
        image = cast(scene, index, view, DepthCamera(), moving=moving)
        nearest = nearest_depth(scene, index, view, DepthCamera(), 3.0, moving=moving)
        assert nearest[0] == image[0, 31].min() == pytest.approx(2 - time - 0.2 + 0.087, abs=1e-3)


@pytest.mark.parametrize(
    ("obstacle", "told"),
    [
        (walker([[2, 2], [2, -3.4]]), "motion: carries it out of the room, x from -3.5 to 3.5 and y from -3.5 to 3.5, "
         "between points 1 and 2 of its path; keep all of it inside"),
        (walker([[2, 2], [-2, 2]]), "motion: carries it into 'bar', between points 1 and 2 of its path; "
         "leave room for the whole of it"),
        ({"cylinder": {**WALKER, "motion": {"path": [[2, 1], [2, 0]], "speed": 1}}},
         "motion.path[0]: must be where the obstacle stands, 'at' [2, 2]"),
        ({"box": {**DOOR, "motion": {**SWING, "swing_deg": [0, 100]}}}, "motion: carries it into 'bar', at 92°; "
         "leave room for the whole of it"),
        ({"box": {**DOOR, "motion": {**SWING, "swing_deg": [10, 10]}}}, "motion.swing_deg: both angles are the same; "
         "give two, such as [0, 90], or leave 'motion' out"),
        ({"box": {**DOOR, "at": [1, -3], "motion": {"hinge": [-0.5, -3], "swing_deg": [0, 10], "speed_deg": 720}}},
         "motion: its farthest point moves at 24.5 m/s, faster than 10 m/s; lower the speed"),
        ({"cylinder": {**WALKER, "motion": {"path": [[2, 2], [2, 2]], "speed": 1}}},
         "motion.path: points 1 and 2 are the same; leave one of them out"),
        ({"cylinder": {**WALKER, "motion": {"path": [[2, 2], [2, 1]], "speed": 11}}},
         "motion.speed: must be at most 10, not 11"),
        ({"cylinder": {**WALKER, "motion": {"hinge": [2, 2], "swing_deg": [0, 90], "speed": 11}}},
         "motion.speed: is not a known key; did you mean 'speed_deg'?"),
        ({"cylinder": {**WALKER, "motion": {"path": [[2, 2], [2, 1]], "sped": 1}}},
         "motion.sped: is not a known key; did you mean 'speed'?"),
        ({"cylinder": {**WALKER, "base": 0.1, "pushable": {"mass": 1}}},
         "base: what can be pushed slides on the floor; leave 'base' out"),
        ({"cylinder": {**WALKER, "at": [3.4, 0], "pushable": {"mass": 1}}},
         "cylinder: reaches out of the room, where nothing could push it; move it inside"),
        ({"cylinder": {**WALKER, "at": [0, 1.1], "pushable": {"mass": 1}}},
         "cylinder: can be pushed, but stands inside 'bar'; move one of them away"),
    ],
)  # fmt: skip
def test_ways_that_are_not_free_and_other_mistakes_are_told_in_one_sentence(obstacle, told):
    bar = {"box": {"name": "bar", "at": [-0.1, 1.6], "size": [0.1, 2.0], "height": 1}}
    with pytest.raises(WorldError) as caught:
        make_world(obstacle, bar)
    (problem,) = caught.value.problems
    assert problem.endswith(told)
    assert problem.startswith("obstacles[0].")


def test_an_obstacle_cannot_both_move_and_be_pushed():
    with pytest.raises(WorldError, match="cannot be pushed as well"):
        make_world({"cylinder": {**WALKER, "motion": {"path": [[2, 2], [2, 1]], "speed": 1}, "pushable": {"mass": 1}}})


@pytest.mark.parametrize(("x", "fits"), [(1.5, True), (1.4999, True), (1.51, False)])
def test_a_way_may_touch_what_stands(x, fits):
    bar = {"box": {"at": [x - 0.5, 0], "size": [1.6, 0.1], "height": 1}}
    if fits:
        assert make_world(walker([[2.5, 2], [2.5, -2]]), bar).obstacles
    else:
        with pytest.raises(WorldError, match="carries it into"):
            make_world(walker([[2.5, 2], [2.5, -2]]), {"box": {"at": [x + 0.5, 0], "size": [1.6, 0.1], "height": 1}})


def test_what_is_over_or_under_a_way_does_not_block_it():
    beam = {"box": {"at": [2, 0], "size": [1, 0.1], "base": 1.7, "height": 0.1}}
    assert make_world(walker([[2, 2], [2, -2]]), beam).obstacles


PLACES = st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(list)


@settings(max_examples=60, deadline=None)
@given(
    path=st.lists(PLACES, min_size=2, max_size=4),
    size=st.tuples(st.floats(0.1, 1.0), st.floats(0.1, 1.0)),
    yaw=st.floats(-180, 180),
    post=PLACES,
)
def test_a_way_is_refused_exactly_where_shapely_finds_something_in_it(path, size, yaw, post):
    footprint = shapely.affinity.rotate(shapely.box(-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2), yaw, (0, 0))
    swept = shapely.union_all(
        [
            shapely.union(
                shapely.affinity.translate(footprint, *a), shapely.affinity.translate(footprint, *b)
            ).convex_hull
            for a, b in itertools.pairwise(path)
        ]
    )
    room, stone = shapely.box(-3.5, -3.5, 3.5, 3.5), shapely.Point(post).buffer(0.2, quad_segs=500)
    inside = -max(0.0, swept.hausdorff_distance(swept.intersection(room))) if not room.covers(swept) else 1.0
    apart = swept.distance(stone)
    if (0.0 < -inside < 1e-3) or apart < 1e-3 < swept.intersection(stone).area * 1e6 < 1e3 or 0 < apart < 1e-3:
        return  # too close to call
    if any(math.dist(a, b) < 1e-6 for a, b in itertools.pairwise(path)):
        return
    box = {"at": path[0], "size": list(size), "yaw_deg": yaw, "height": 1, "motion": {"path": path, "speed": 1}}
    data = [{"box": box}, {"cylinder": {"at": post, "radius": 0.2, "height": 1}}]
    try:
        make_world(*data)
        refused = ""
    except WorldError as error:
        refused = str(error)
    assert ("out of the room" in refused) == (inside < 0)
    if inside > 0:
        assert ("carries it into" in refused) == (apart == 0.0)


def test_moving_worlds_are_written_and_read_back():
    world = make_world(walker(PATH, repeat="circuit"), door(), {"cylinder": {**WALKER, "pushable": {"mass": 2}}})
    assert World.from_dict(world.to_dict()) == world
    assert world.to_dict()["obstacles"][1]["box"]["motion"] == {
        "hinge": [0.0, 0.0],
        "swing_deg": [0.0, 90.0],
        "speed_deg": 45.0,
    }
    assert world.obstacles[2].pushable.friction == 0.4
