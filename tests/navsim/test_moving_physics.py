"""Robots among obstacles that move and that can be pushed."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from navsim.dynamics import dynamic_obstacles, outlines
from navsim.physics import Physics
from navsim.robot import ACTIONS, INITIAL_COMMAND, TURTLEBOT2, Robot, apply_actions, follow_arc
from navsim.world import World

RADIUS, MASS, G = TURTLEBOT2.radius, TURTLEBOT2.mass, 9.81
CONTROL_PERIOD = 0.2


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def walker(path, speed=0.5, radius=0.2, **motion):
    motion = {"path": path, "speed": speed, **motion}
    return {"cylinder": {"at": path[0], "radius": radius, "height": 1.7, "motion": motion}}


def moving_box(path, size, speed):
    return {"box": {"at": path[0], "size": size, "height": 1.0, "motion": {"path": path, "speed": speed}}}


def can(at, radius=0.1, height=0.2, mass=1.0, friction=0.4):
    return {
        "cylinder": {"at": at, "radius": radius, "height": height, "pushable": {"mass": mass, "friction": friction}}
    }


def crate(at, size=(0.4, 0.3), yaw_deg=0.0, mass=2.0, friction=0.4, height=0.3):
    pushable = {"mass": mass, "friction": friction}
    return {"box": {"at": at, "size": list(size), "yaw_deg": yaw_deg, "height": height, "pushable": pushable}}


def placed(world, pose, phases=(), robot=TURTLEBOT2):
    physics = Physics([world], 1, robot)
    physics.place([0], 0, np.array([pose], dtype=float), phases)
    return physics


def drive(physics, linear=0.0, angular=0.0, duration=CONTROL_PERIOD):
    poses, bumper = physics.drive(np.array([[linear, angular]]), duration)
    return poses[0], bool(bumper[0])


def thrown(physics, slot, *velocity):
    physics.obstacle_speeds[0, slot] = velocity


def shapes_of(world, row):
    """The dynamic obstacles at poses ``row``, as Shapely sees them."""
    shapes = []
    for pieces in outlines(world, row):
        parts = [
            shapely.Point(vertices[0]).buffer(radius, quad_segs=100) if radius else shapely.Polygon(vertices)
            for vertices, radius in pieces
        ]
        shapes.append(shapely.union_all(parts))
    return shapes


# What moves


@pytest.mark.parametrize("speed", [0.6, 3.0, 10.0])
def test_a_walker_that_runs_into_a_standing_robot_is_felt_when_it_gets_there(speed):
    physics = placed(make_world(walker([[-3, 0.05], [3, 0.05]], speed)), (0.0, 0.0, 1.0))
    reached = (3.0 - math.sqrt((0.2 + RADIUS) ** 2 - 0.05**2)) / speed
    time, period = 0.0, 0.01
    while not drive(physics, duration=period)[1]:
        time += period
        assert time < reached + period
    assert time + period >= reached - 1e-9
    assert physics.touched_solid[0]
    assert not physics.touched_pushable[0]


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_a_robot_that_a_walker_pushes_stays_in_front_of_it(speed):
    physics = placed(make_world(walker([[-3, 0.0], [2.5, 0.0]], speed)), (0.0, 0.0, 0.0))
    for _ in range(math.ceil(4.5 / speed / 0.02)):
        pose, touched = drive(physics, duration=0.02)
        gap = np.hypot(*(pose[:2] - physics.obstacle_poses[0, 0, :2])) - 0.2 - RADIUS
        assert gap > -2e-3
        if touched:
            assert pose[0] > physics.obstacle_poses[0, 0, 0]


@pytest.mark.parametrize("speed", [0.65, 5.0, 10.0])
def test_a_thin_wall_on_the_move_does_not_tunnel_through_a_robot_that_drives_at_it(speed):
    physics = placed(make_world(moving_box([[3, 0], [-3, 0]], [0.01, 3.0], speed)), (-1.0, 0.2, 0.0))
    touched = False
    for _ in range(80):
        pose, bumper = drive(physics, 0.65, duration=0.05)
        touched |= bumper
        if physics.obstacle_poses[0, 0, 0] < -2.0:
            break
        assert pose[0] + RADIUS < physics.obstacle_poses[0, 0, 0] + 5e-3
    assert touched


def test_a_walker_crushes_nobody_through_a_wall():
    for speed in (0.5, 10.0):
        physics = placed(make_world(walker([[0, 0], [3.25, 0]], speed)), (2.5, 0.01, 0.0))
        for _ in range(120):
            pose, _ = drive(physics, duration=0.1)
            assert np.abs(pose[:2]).max() < 3.5 - RADIUS + 1e-3


def test_a_door_pushes_a_robot_out_of_its_way():
    door = {"box": {"at": [0.5, 0], "size": [1.0, 0.04], "height": 2}}
    door["box"]["motion"] = {"hinge": [0, 0], "swing_deg": [0, 90], "speed_deg": 60}
    world = make_world(door)
    physics = placed(world, (0.6, 0.5, 0.0))
    touched = False
    for _ in range(75):
        pose, bumper = drive(physics, duration=0.02)
        touched |= bumper
        (shape,) = shapes_of(world, physics.obstacle_poses[0])
        assert shape.distance(shapely.Point(pose[:2])) > RADIUS - 2e-3
    assert touched


def test_contact_with_what_moves_begins_where_shapely_says():
    door = {"box": {"at": [0.5, 0], "size": [1.0, 0.06], "height": 2}}
    door["box"]["motion"] = {"hinge": [0, 0], "swing_deg": [0, 180], "speed_deg": 40}
    bar = moving_box([[-2, -2], [2, -1.5]], [0.3, 0.1], 0.7)
    hexagon = [[round(2 + 0.4 * math.cos(a), 3), round(2 + 0.4 * math.sin(a), 3)] for a in np.arange(6) * math.pi / 3]
    rock = {"polygon": {"points": hexagon, "height": 1, "motion": {"path": [[0, 0], [-4, 0]], "speed": 0.4}}}
    world = make_world(door, bar, rock, walker([[-3, 3], [-3, -3]], 0.6))
    generator = np.random.default_rng(0)
    touches = 0
    for trial in range(40):
        phases = generator.random(4)
        shapes = shapes_of(world, placed(world, (3, -3, 0), phases).obstacle_poses[0])
        ring = shapes[trial % 4].buffer(RADIUS + generator.uniform(0.005, 0.03)).exterior
        start = ring.interpolate(generator.random(), normalized=True)
        if min(shape.distance(start) for shape in shapes) < RADIUS or max(abs(start.x), abs(start.y)) > 3.2:
            continue
        physics = placed(world, (start.x, start.y, generator.uniform(-3, 3)), phases)
        for _ in range(5):
            pose, bumper = drive(physics, 0.65, 0.4, 0.02)
            distance = min(s.distance(shapely.Point(pose[:2])) for s in shapes_of(world, physics.obstacle_poses[0]))
            if bumper:
                assert distance < RADIUS + 1e-4
                touches += 1
                break
            assert distance > RADIUS - 1e-4
    assert touches > 10


def test_a_crane_that_moves_above_the_robot_does_not_touch_it():
    crane = moving_box([[-2, 0], [2, 0]], [0.3, 0.3], 0.5)
    crane["box"] |= {"base": 0.42, "height": 0.5}
    physics = placed(make_world(crane), (0.0, 0.0, 0.0))
    assert not any(drive(physics)[1] for _ in range(100))


def test_a_robot_away_from_all_that_moves_follows_its_arc():
    physics = placed(make_world(walker([[3, 3], [-3, 3]], 1.0), can([3, -3])), (0.0, -1.0, 0.3))
    for _ in range(20):
        pose, bumper = drive(physics, 0.2, math.pi / 4)
    assert not bumper
    np.testing.assert_allclose(
        pose, follow_arc(np.array([0.0, -1.0, 0.3]), np.array([0.2, math.pi / 4]), 4.0), atol=1e-9
    )


# What can be pushed


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("friction", [0.1, 0.4, 0.9])
@pytest.mark.parametrize("make", [can, crate])
def test_a_sliding_body_stops_after_v_squared_over_two_mu_g(speed, friction, make):
    physics = placed(make_world(make([-2.5, 1.0], friction=friction), size=(9, 9)), (0.0, -3.0, 0.0))
    direction = np.array([math.cos(0.3), math.sin(0.3)])
    thrown(physics, 0, *(speed * direction), 0.0)
    begin = physics.obstacle_poses[0, 0].copy()
    for _ in range(60):
        drive(physics)
    assert not physics.obstacle_speeds.any()
    way = physics.obstacle_poses[0, 0] - begin
    np.testing.assert_allclose(way[:2], speed**2 / (2 * friction * G) * direction, rtol=1e-9)
    assert way[2] == 0.0


def test_a_spinning_body_stops_when_the_friction_of_its_whole_footprint_says():
    world = make_world(crate([0.0, 0.0], size=(0.6, 0.2)))
    points = np.random.default_rng(0).uniform([-0.3, -0.1], [0.3, 0.1], (200_000, 2))
    arm, inertia = np.hypot(*points.T).mean(), (0.6**2 + 0.2**2) / 12  # per kilogram
    (one,) = dynamic_obstacles(world)
    assert one.solid.friction_radius == pytest.approx(arm, rel=2e-3)
    assert one.solid.inertia == pytest.approx(2.0 * inertia)
    physics = placed(world, (0.0, -3.0, 0.0))
    thrown(physics, 0, 0.0, 0.0, 6.0)
    for _ in range(30):
        drive(physics)
    assert physics.obstacle_poses[0, 0, 2] == pytest.approx(6.0**2 * inertia / (2 * 0.4 * G * arm), rel=0.01)
    assert not physics.obstacle_speeds.any()


def test_the_centroid_of_a_concave_body_is_that_of_shapely():
    corners = [[0, 0], [1, 0], [1, 0.4], [0.3, 0.4], [0.3, 1.2], [0, 1.2]]
    world = make_world({"polygon": {"points": corners, "height": 0.3, "pushable": {"mass": 3}}})
    (one,) = dynamic_obstacles(world)
    shape = shapely.Polygon(corners)
    np.testing.assert_allclose(one.reference, [shape.centroid.x, shape.centroid.y], atol=1e-12)
    points = np.random.default_rng(0).uniform([0, 0], [1, 1.2], (100_000, 2))
    inside = points[shapely.contains_xy(shape, points)] - one.reference
    assert one.solid.friction_radius == pytest.approx(np.hypot(*inside.T).mean(), rel=0.01)
    assert one.solid.inertia == pytest.approx(3 * (inside**2).sum(axis=1).mean(), rel=0.01)


def test_momentum_goes_over_from_one_body_to_another():
    world = make_world(can([-1.0, 0.0], mass=3.0, friction=0.0), can([0.0, 0.0], mass=1.0, friction=0.0))
    physics = placed(world, (0.0, -3.0, 0.0))
    thrown(physics, 0, 0.8, 0.0, 0.0)
    for _ in range(8):
        drive(physics)
    np.testing.assert_allclose(physics.obstacle_speeds[0, :2, 0], 3 * 0.8 / 4, rtol=1e-6)  # no bounce: they go together
    gap = physics.obstacle_poses[0, 1, 0] - physics.obstacle_poses[0, 0, 0]
    assert gap == pytest.approx(0.2, abs=1.1e-3)


def test_an_oblique_blow_keeps_both_components_of_momentum():
    world = make_world(can([-1.0, 0.0], mass=2.0, friction=0.0), crate([0.0, 0.12], mass=1.5, friction=0.0))
    physics = placed(world, (0.0, -3.0, 0.0))
    thrown(physics, 0, 1.0, 0.1, 0.0)
    for _ in range(7):
        drive(physics)
    masses = np.array([2.0, 1.5])
    assert (physics.obstacle_speeds[0, 1] != 0).any()
    np.testing.assert_allclose(masses @ physics.obstacle_speeds[0, :2, :2], [2.0, 0.2], atol=1e-9)


def test_a_robot_pushes_a_can_along_and_leaves_it_where_friction_stops_it():
    physics = placed(make_world(can([-1.0, 0.0])), (-2.0, 0.0, 0.0))
    pushed_at = []
    for _ in range(20):
        pose, bumper = drive(physics, 0.4)
        if bumper:
            assert physics.touched_pushable[0]
            assert not physics.touched_solid[0]
            pushed_at.append((pose[0], physics.obstacle_poses[0, 0, 0]))
    robot, body = np.array(pushed_at[2:]).T
    assert len(robot) > 5
    np.testing.assert_allclose(body - robot, RADIUS + 0.1, atol=2e-3)
    assert np.diff(robot).min() > 0.9 * 0.4 * CONTROL_PERIOD
    for _ in range(10):
        drive(physics, 0.0, math.pi)
    rest = physics.obstacle_poses[0, 0].copy()
    for _ in range(10):
        drive(physics, 0.0, math.pi)
    np.testing.assert_array_equal(physics.obstacle_poses[0, 0], rest)


def test_a_crate_that_is_pushed_off_its_centre_turns():
    physics = placed(make_world(crate([-1.0, 0.12])), (-2.0, 0.0, 0.0))
    for _ in range(15):
        drive(physics, 0.4)
    assert physics.obstacle_poses[0, 0, 2] > 0.2


def test_what_is_too_heavy_for_the_wheels_stops_the_robot():
    physics = placed(make_world(crate([-1.0, 0.0], mass=60.0, friction=0.6)), (-2.0, 0.0, 0.0))
    for _ in range(40):
        pose, bumper = drive(physics, 0.4)
    assert bumper
    assert physics.obstacle_poses[0, 0, 0] < -1.0 + 0.03
    assert pose[0] == pytest.approx(physics.obstacle_poses[0, 0, 0] - 0.2 - RADIUS, abs=5e-3)


def test_a_can_against_a_wall_stops_the_robot():
    physics = placed(make_world(can([3.3, 0.0])), (2.0, 0.0, 0.0))
    for _ in range(40):
        pose, bumper = drive(physics, 0.4)
    assert bumper
    assert physics.obstacle_poses[0, 0, 0] == pytest.approx(3.4, abs=2e-3)
    assert pose[0] == pytest.approx(3.3 - RADIUS, abs=6e-3)


def test_what_is_pushed_goes_under_what_is_higher():
    board = {"box": {"at": [0, 0], "size": [0.2, 2], "base": 0.5, "height": 0.1}}
    for height, passes in ((0.3, True), (0.6, False)):
        physics = placed(make_world(can([-1.0, 0.0], height=height), board), (-2.0, 0.0, 0.0))
        for _ in range(60):
            drive(physics, 0.4)
        assert bool(physics.obstacle_poses[0, 0, 0] > 0.2) is passes


def test_a_walker_shoves_what_lies_in_its_way():
    physics = placed(make_world(walker([[-2, 0], [2, 0]]), can([0.0, 0.1])), (0.0, -3.0, 0.0))
    for _ in range(40):
        drive(physics)
        gap = np.hypot(*(physics.obstacle_poses[0, 1, :2] - physics.obstacle_poses[0, 0, :2])) - 0.3
        assert gap > -2e-3
    assert physics.obstacle_poses[0, 1, 1] > 0.2


THINGS = st.lists(
    st.builds(
        lambda x, y, size, kind, yaw, mass, friction: (
            can([x, y], radius=size / 2, mass=mass, friction=friction)
            if kind
            else crate([x, y], (size, 0.15), yaw, mass, friction)
        ),
        st.floats(-1.2, 1.2),
        st.floats(-1.2, 1.2),
        st.floats(0.03, 0.6),
        st.booleans(),
        st.floats(-180, 180),
        st.floats(0.05, 30.0),
        st.floats(0.0, 1.0),
    ),
    min_size=1,
    max_size=5,
)
WAYS = st.lists(
    st.tuples(st.floats(-1.25, 1.25), st.floats(-1.25, 1.25), st.floats(-1.25, 1.25), st.floats(0.1, 10.0)), max_size=2
)


@settings(max_examples=25, deadline=None)
@given(
    things=THINGS,
    ways=WAYS,
    commands=st.lists(
        st.tuples(st.sampled_from([0.2, 0.4, 0.65]), st.sampled_from([-math.pi, -0.8, 0.0, 0.8, math.pi])),
        min_size=6,
        max_size=14,
    ),
)
def test_nothing_that_is_pushed_ever_leaves_the_room(things, ways, commands):
    partition = {"box": {"at": [0, 0], "size": [0.01, 1.0], "height": 1}}
    walkers = [walker([[a, b], [a, c]], v, 0.2) for a, b, c, v in ways if abs(a) > 0.21 and abs(b - c) > 0.01]
    kept = []
    for thing in things:
        try:
            make_world(*kept, thing, partition, size=(3, 3))
        except ValueError:
            continue
        kept.append(thing)
    world = make_world(*kept, *walkers, partition, size=(3, 3))
    physics = placed(world, (-1.2, -1.2, 0.7))
    room, thin = shapely.box(-1.5, -1.5, 1.5, 1.5), shapely.box(-0.005, -0.5, 0.005, 0.5)
    for command in commands:
        pose, _ = drive(physics, *command)
        assert np.abs(pose[:2]).max() < 1.5 - RADIUS + 2e-3
        assert np.isfinite(physics.obstacle_poses).all()
        for one, shape in zip(dynamic_obstacles(world), shapes_of(world, physics.obstacle_poses[0]), strict=True):
            if not one.moves:
                assert room.buffer(3e-3).covers(shape)
                assert shape.buffer(-3e-3).intersection(thin).is_empty


# Robots and their own copies


def lively_world():
    door = {"box": {"at": [0.5, 0], "size": [1.0, 0.04], "height": 2}}
    door["box"]["motion"] = {"hinge": [0, 0], "swing_deg": [0, 90], "speed_deg": 60}
    fixed = [{"cylinder": {"at": [2, -2], "radius": 0.3, "height": 0.5}}]
    things = [can([-1, 1], mass=0.5), crate([-1.5, -1], yaw_deg=20), can([1.5, 2.0], radius=0.15), crate([-2, 2])]
    return make_world(door, walker([[-2.5, 0.5], [1.0, 2.5], [2, 1.5]], 0.9, repeat="circuit"), *fixed, *things)


def random_drive(generator, num_robots, steps):
    command = np.tile(INITIAL_COMMAND, (num_robots, 1))
    for _ in range(steps):
        command = apply_actions(command, generator.integers(len(ACTIONS), size=num_robots))
        yield command


def everything(physics, robot):
    return b"".join(getattr(physics, name)[robot].tobytes() for name in physics.state_dict())


def test_robots_together_do_exactly_what_each_does_alone():
    generator = np.random.default_rng(4)
    worlds = [lively_world(), make_world(can([0.5, 0.0]), can([1.0, 0.1]))]
    homes, poses = np.arange(8) % 2, generator.uniform([-3, -3, -3], [3, 3, 3], (8, 3))
    phases = generator.random((8, 6))
    together = Physics(worlds, 8)
    together.place(np.arange(8), homes, poses, phases)
    alone = [Physics(worlds) for _ in range(8)]
    for number, physics in enumerate(alone):
        physics.place([0], homes[number], poses[number : number + 1], phases[number : number + 1])
    pushes = 0
    for command in random_drive(generator, 8, 80):
        together.drive(command, CONTROL_PERIOD)
        pushes += together.touched_pushable.sum()
        for number, physics in enumerate(alone):
            physics.drive(command[number : number + 1], CONTROL_PERIOD)
            assert everything(physics, 0) == everything(together, number)
    assert pushes > 10


def test_a_run_among_moving_things_resumes_from_its_state_bit_for_bit():
    generator = np.random.default_rng(8)
    world = lively_world()
    physics = Physics([world], 5)
    physics.place(np.arange(5), 0, generator.uniform([-3, -3, -3], [3, 3, 3], (5, 3)), generator.random((5, 6)))
    commands = list(random_drive(generator, 5, 60))
    for command in commands[:30]:
        physics.drive(command, CONTROL_PERIOD)
    resumed = Physics([world], 5)
    resumed.load_state_dict(physics.state_dict())
    begun = physics.obstacle_poses.copy()
    for command in commands[30:]:
        physics.drive(command, CONTROL_PERIOD)
        resumed.drive(command, CONTROL_PERIOD)
        for robot in range(5):
            assert everything(physics, robot) == everything(resumed, robot)
    assert (physics.obstacle_poses[:, 2:] != begun[:, 2:]).any()


def test_placing_a_robot_anew_puts_everything_back():
    physics = placed(make_world(can([-1.0, 0.0]), walker([[3, 3], [-3, 3]])), (-2.0, 0.0, 0.0), [0.3])
    first = physics.state_dict()
    for _ in range(15):
        drive(physics, 0.4)
    assert physics.obstacle_poses[0, 1, 0] > -0.9
    physics.place([0], 0, np.array([[-2.0, 0.0, 0.0]]), [0.3])
    for name, value in physics.state_dict().items():
        np.testing.assert_array_equal(value, first[name])


def test_a_small_robot_does_not_tunnel_either():
    physics = placed(make_world(walker([[-3, 0], [3, 0]], 10.0)), (0.0, 0.0, 0.0), robot=Robot(radius=0.03))
    touched = any(drive(physics, duration=0.02)[1] for _ in range(40))
    assert touched


def test_spaces_of_worlds_that_were_not_used_for_long_are_let_go(monkeypatch):
    monkeypatch.setattr("navsim.physics._MOST_SPACES", 3)
    worlds = [make_world(walker([[1.0 + 0.02 * i, 0.1], [1.0, 3.0]])) for i in range(5)]
    physics = Physics(worlds, 5)
    physics.place(np.arange(5), np.arange(5), np.tile([0.7, 0.0, 0.0], (5, 1)))
    for index, world in enumerate(worlds):  # the same one by one, each with a space of its own
        alone = placed(world, (0.7, 0.0, 0.0))
        if index == 0:
            physics.drive(np.tile([0.4, 0.0], (5, 1)), CONTROL_PERIOD)
        pose, bumper = drive(alone, 0.4)
        np.testing.assert_array_equal(physics.poses[index], pose)
        assert (physics.touched_solid[index] or physics.touched_pushable[index]) == bumper
    assert 0 < len(physics._contact_spaces) <= 3
    assert len(physics._spaces) <= 3
