import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from navsim.physics import Physics
from navsim.robot import ACTIONS, INITIAL_COMMAND, TURTLEBOT2, Robot, apply_actions, follow_arc, wrap_angle
from navsim.world import World

RADIUS = TURTLEBOT2.radius
CONTROL_PERIOD = 0.2


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def footprints(world, robot=TURTLEBOT2):
    """What stands in the robot's way, built by Shapely from the world file's own keys."""
    shapes = []
    for obstacle in world.obstacles:
        if obstacle.base >= robot.height:
            continue
        if obstacle.kind == "cylinder":
            shapes.append(shapely.Point(obstacle.at).buffer(obstacle.radius, quad_segs=2000))
        elif obstacle.kind == "box":
            length, width = obstacle.size
            box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
            turned = shapely.affinity.rotate(box, obstacle.yaw_deg, origin=(0, 0))
            shapes.append(shapely.affinity.translate(turned, *obstacle.at))
        else:
            shapes.append(shapely.Polygon(obstacle.points))
    if world.walls is not None:
        x, y = world.half_size
        t = world.walls.thickness
        shapes.append(shapely.box(-x - t, -y - t, x + t, y + t).difference(shapely.box(-x, -y, x, y)))
    return shapely.union_all(shapes)


def overlap(standing, position):
    """How deep the robot's disc is in the obstacles, metres; negative is free space."""
    point = shapely.Point(position)
    distance = point.distance(standing)
    if distance == 0.0:
        distance = -point.distance(standing.boundary)
    return RADIUS - distance


def placed(world, *poses, robot=TURTLEBOT2, substep=0.02):
    physics = Physics([world], len(poses), robot, substep)
    physics.place(np.arange(len(poses)), 0, np.array(poses, dtype=float))
    return physics


def commands(*rows):
    return np.array(rows, dtype=float)


EMPTY = make_world(size=(100.0, 100.0))


@pytest.mark.parametrize("linear", [0.2, 0.4, 0.65])
@pytest.mark.parametrize("angular", [0.0, math.pi / 8, -math.pi / 4, math.pi])
def test_free_motion_follows_the_arc_for_a_hundred_control_steps(linear, angular):
    start = np.array([1.0, -2.0, 0.4])
    physics = placed(EMPTY, start)
    for _ in range(100):
        poses, bumper = physics.drive(commands((linear, angular)), CONTROL_PERIOD)
    expected = follow_arc(start, np.array([linear, angular]), 100 * CONTROL_PERIOD)
    assert np.hypot(*(poses[0, :2] - expected[:2])) < 1e-9
    assert abs(wrap_angle(poses[0, 2] - expected[2])) < 1e-9
    assert not bumper.any()


def test_chipmunk_and_the_closed_form_agree_on_free_motion(monkeypatch):
    world = make_world({"box": {"at": [0, 0], "size": [0.3, 0.3], "height": 1}})
    generator = np.random.default_rng(3)
    start = (1.5, 1.5, 0.0)
    closed, chipmunk = placed(world, start), placed(world, start)
    monkeypatch.setattr(chipmunk, "_near_something", lambda travel: np.array([0]))
    for turn in generator.uniform(-1.0, 1.0, 15):
        for physics in (closed, chipmunk):
            _, bumper = physics.drive(commands((0.3, turn)), CONTROL_PERIOD)
            assert not bumper.any()
        np.testing.assert_allclose(chipmunk.poses, closed.poses, rtol=0, atol=1e-14)
    assert (overlap(footprints(world), closed.poses[0, :2])) < -0.3


def test_robots_in_the_open_leave_chipmunk_alone(monkeypatch):
    physics = placed(make_world({"cylinder": {"at": [2, 0], "radius": 0.2, "height": 1}}), (0, 0, 0))
    simulated = []
    real = type(physics._space(0)).simulate
    monkeypatch.setattr(type(physics._space(0)), "simulate", lambda self, *a: simulated.append(1) or real(self, *a))
    for _ in range(60):
        physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)
        near = 2.0 - 0.2 - physics.poses[0, 0] < RADIUS + 0.4 * CONTROL_PERIOD * 2
        assert near or not simulated
    assert simulated


@pytest.mark.parametrize("speed", [0.2, 0.65])
def test_a_thin_wall_stops_the_robot(speed):
    world = make_world({"box": {"at": [1.0, 0], "size": [0.01, 6], "height": 1}})
    physics = placed(world, (0, 0.3, 0.05))
    touched = False
    for _ in range(60):
        poses, bumper = physics.drive(commands((speed, 0.0)), CONTROL_PERIOD)
        touched |= bool(bumper[0])
        assert overlap(footprints(world), poses[0, :2]) < 0.005
        assert poses[0, 0] < 1.0
    assert touched


def test_a_robot_pressed_against_a_wall_slides_along_it():
    world = make_world({"box": {"at": [1.0, 0], "size": [0.2, 6], "height": 1}})
    angle = math.radians(40)
    physics = placed(world, (0.9 - RADIUS, -1.0, angle))
    for _ in range(20):
        before = physics.poses.copy()
        poses, bumper = physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)
        assert bumper[0]
        assert poses[0, 0] == pytest.approx(0.9 - RADIUS, abs=1e-3)
        assert poses[0, 1] - before[0, 1] == pytest.approx(0.4 * math.sin(angle) * CONTROL_PERIOD, abs=1e-6)


def test_a_robot_pressed_into_a_corner_stays_there():
    physics = placed(make_world(size=(4, 4)), (1.5, 1.4, math.pi / 4))
    for _ in range(20):
        poses, bumper = physics.drive(commands((0.65, 0.0)), CONTROL_PERIOD)
    assert bumper[0]
    np.testing.assert_allclose(poses[0, :2], 2.0 - RADIUS, atol=1e-3)


def test_a_robot_that_turns_away_leaves_the_wall():
    physics = placed(make_world(size=(4, 4)), (2.0 - RADIUS, 0.0, math.pi / 2))
    physics.drive(commands((0.2, -math.pi / 4)), CONTROL_PERIOD)
    for _ in range(20):
        _, bumper = physics.drive(commands((0.2, math.pi / 4)), CONTROL_PERIOD)
    assert not bumper[0]
    assert physics.poses[0, 0] < 2.0 - RADIUS - 0.1


def test_the_bumper_touches_exactly_where_the_disc_does():
    world = make_world({"cylinder": {"at": [1.0, 0.0], "radius": 0.2, "height": 1}})
    gap = 1e-4
    for side, touches in ((0.2 + RADIUS + gap, False), (0.2 + RADIUS - gap, True)):
        physics = placed(world, (0.0, side, 0.0))
        touched = [physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)[1][0] for _ in range(25)]
        assert any(touched) is touches


@pytest.mark.parametrize(
    ("base", "height", "stops"),
    [(0.0, 0.02, True), (0.35, 0.05, True), (0.419, 1.0, True), (0.42, 1.0, False), (0.7, 0.03, False)],
)
def test_an_obstacle_touches_only_where_heights_overlap(base, height, stops):
    world = make_world({"box": {"at": [1.0, 0], "size": [0.2, 2], "base": base, "height": height}})
    physics = placed(world, (0, 0, 0))
    touched = [physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)[1][0] for _ in range(20)]
    assert any(touched) is stops


def test_a_taller_robot_touches_what_a_lower_one_passes_under():
    world = make_world({"box": {"at": [1.0, 0], "size": [0.2, 2], "base": 0.5, "height": 0.1}})
    touches = {}
    for robot in (TURTLEBOT2, Robot(height=0.6)):
        physics = placed(world, (0, 0, 0), robot=robot)
        touches[robot] = any(physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)[1][0] for _ in range(20))
    assert list(touches.values()) == [False, True]


def test_robots_that_slide_along_a_wall_pass_through_each_other():
    angle = math.radians(30)
    world = make_world({"box": {"at": [0, 1.0], "size": [6, 0.2], "height": 1}})
    physics = placed(world, (-0.5, 0.9 - RADIUS, angle), (0.5, 0.9 - RADIUS, math.pi - angle))
    for _ in range(10):
        _, bumper = physics.drive(commands((0.4, 0.0), (0.4, 0.0)), CONTROL_PERIOD)
        assert bumper.all()
    far = 10 * 0.08 * math.cos(angle) - 0.5
    np.testing.assert_allclose(physics.poses[:, 0], [far, -far], atol=1e-6)


def test_a_robot_is_wedged_where_contact_normals_leave_no_way_out():
    narrow = {"polygon": {"points": [[2, -0.3], [-2, 0], [2, 0.3], [2, 1], [-3, 1], [-3, -1], [2, -1]], "height": 1.0}}
    world = make_world(narrow)
    physics = placed(world, (1.5, 0.01, math.pi))
    standing = footprints(world)
    assert overlap(standing, physics.poses[0, :2]) < 0
    for _ in range(20):
        poses, bumper = physics.drive(commands((0.65, 0.0)), CONTROL_PERIOD)
        assert overlap(standing, poses[0, :2]) < 0.005
    assert bumper[0]
    half_opening = math.atan2(0.3, 4.0)
    assert poses[0, 0] == pytest.approx(-2 + RADIUS / math.sin(half_opening), abs=0.03)


def test_chipmunks_solver_holds_a_robot_off_the_wall(monkeypatch):
    world = make_world({"box": {"at": [1.0, 0], "size": [0.2, 6], "height": 1}})
    physics = placed(world, (0.9 - RADIUS, -1.0, math.radians(40)))
    overlaps = []
    space = type(physics._space(0))
    monkeypatch.setattr(
        space, "_push_out", lambda self, robot, start: overlaps.append(overlap(footprints(world), robot.body.position))
    )
    physics.drive(commands((0.65, 0.0)), CONTROL_PERIOD)
    entered, *later = overlaps
    assert 0.005 < entered < 0.013
    np.testing.assert_allclose(later, entered, atol=1e-9)  # nothing pushes it out here, and it goes no deeper


LENGTHS = st.floats(0.01, 1.5)
PLACES = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)).map(list)
BOXES = st.fixed_dictionaries(
    {
        "at": PLACES,
        "size": st.tuples(LENGTHS, LENGTHS).map(list),
        "yaw_deg": st.floats(-180, 180),
        "height": st.just(1.0),
    }
).map(lambda box: {"box": box})
CYLINDERS = st.fixed_dictionaries({"at": PLACES, "radius": st.floats(0.01, 0.8), "height": st.just(1.0)}).map(
    lambda cylinder: {"cylinder": cylinder}
)
NOTCHES = st.tuples(PLACES, st.floats(0.05, 0.95), st.floats(0.3, 1.5)).map(
    lambda drawn: {  # a V that opens to the right: a concave corner of any angle
        "polygon": {
            "points": [
                [drawn[0][0] + x * drawn[2], drawn[0][1] + y * drawn[2]]
                for x, y in [(1, -1), (1 - 2 * drawn[1], 0), (1, 1), (-1, 1), (-1, -1)]
            ],
            "height": 1.0,
        }
    }
)


@settings(max_examples=60, deadline=None)
@given(
    obstacles=st.lists(BOXES | CYLINDERS | NOTCHES, min_size=1, max_size=8),
    start=st.tuples(st.floats(-2.3, 2.3), st.floats(-2.3, 2.3), st.floats(-math.pi, math.pi)),
    drive=st.lists(
        st.tuples(st.sampled_from([0.2, 0.4, 0.65]), st.sampled_from([-math.pi, -0.8, 0.0, 0.8, math.pi])),
        min_size=10,
        max_size=25,
    ),
)
def test_a_robot_never_ends_a_step_inside_an_obstacle(obstacles, start, drive):
    world = make_world(*obstacles, size=(8.0, 8.0))
    standing = footprints(world)
    if overlap(standing, start[:2]) > 0:
        return
    physics = placed(world, start)
    for command in drive:
        before = physics.poses[0, :2].copy()
        poses, bumper = physics.drive(commands(command), CONTROL_PERIOD)
        assert overlap(standing, poses[0, :2]) < 0.005
        assert np.hypot(*(poses[0, :2] - before)) < command[0] * CONTROL_PERIOD + 0.005
        if not bumper[0]:
            assert overlap(standing, poses[0, :2]) < 1e-6


def crowded_world(generator):
    obstacles = [
        {
            "box": {
                "at": generator.uniform(-3, 3, 2).tolist(),
                "size": generator.uniform(0.1, 0.8, 2).tolist(),
                "yaw_deg": float(generator.uniform(-180, 180)),
                "height": 0.5,
            }
        }
        for _ in range(8)
    ]
    obstacles += [
        {
            "cylinder": {
                "at": generator.uniform(-3, 3, 2).tolist(),
                "radius": float(generator.uniform(0.05, 0.3)),
                "height": 0.5,
            }
        }
        for _ in range(8)
    ]
    return make_world(*obstacles)


def free_poses(world, count, generator):
    standing, poses = footprints(world), []
    while len(poses) < count:
        pose = generator.uniform([-3, -3, -math.pi], [3, 3, math.pi])
        if overlap(standing, pose[:2]) < -0.01:
            poses.append(pose)
    return np.array(poses)


def random_drive(generator, num_robots, steps):
    command = np.tile(INITIAL_COMMAND, (num_robots, 1))
    for _ in range(steps):
        command = apply_actions(command, generator.integers(len(ACTIONS), size=num_robots))
        yield command


def test_robots_together_move_exactly_as_each_would_alone():
    generator = np.random.default_rng(5)
    worlds = [crowded_world(generator) for _ in range(2)]
    homes = np.arange(8) % 2
    poses = np.array([free_poses(worlds[home], 1, generator)[0] for home in homes])
    drive = list(random_drive(generator, 8, 60))
    together = Physics(worlds, 8)
    together.place(np.arange(8), homes, poses)
    alone = [Physics(worlds) for _ in range(8)]
    for number, physics in enumerate(alone):
        physics.place([0], homes[number], poses[number])
    bumps = 0
    for command in drive:
        moved, bumper = together.drive(command, CONTROL_PERIOD)
        bumps += bumper.sum()
        for number, physics in enumerate(alone):
            own, own_bumper = physics.drive(command[number : number + 1], CONTROL_PERIOD)
            assert own.tobytes() == moved[number : number + 1].tobytes()
            assert own_bumper[0] == bumper[number]
    assert bumps > 50


def test_a_run_resumes_from_its_state_bit_for_bit():
    generator = np.random.default_rng(7)
    world = crowded_world(generator)
    poses = free_poses(world, 6, generator)
    drive = list(random_drive(generator, 6, 60))
    robot = Robot(linear_acceleration=0.5, angular_acceleration=2.0)
    physics = placed(world, *poses, robot=robot)
    for command in drive[:30]:
        physics.drive(command, CONTROL_PERIOD)
    resumed = Physics([world], 6, robot)
    resumed.load_state_dict(physics.state_dict())
    bumps = 0
    for command in drive[30:]:
        expected, expected_bumper = physics.drive(command, CONTROL_PERIOD)
        moved, bumper = resumed.drive(command, CONTROL_PERIOD)
        assert moved.tobytes() == expected.tobytes()
        np.testing.assert_array_equal(bumper, expected_bumper)
        bumps += bumper.sum()
    assert bumps > 10


def test_a_robot_moves_to_another_world():
    walled, empty = make_world({"box": {"at": [0.5, 0], "size": [0.2, 2], "height": 1}}), make_world()
    physics = Physics([walled, empty])
    ends = []
    for world in (0, 1, 0):
        physics.place([0], world, np.array([[0.0, 0.0, 0.0]]))
        for _ in range(10):
            physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)
        ends.append(physics.poses[0, 0])
    assert ends == [pytest.approx(0.4 - RADIUS, abs=1e-3), pytest.approx(0.8), ends[0]]


def test_acceleration_limits_ramp_the_speeds():
    physics = placed(EMPTY, (0, 0, 0), robot=Robot(linear_acceleration=0.5, angular_acceleration=1.0))
    for _ in range(5):
        physics.drive(commands((0.4, 0.0)), CONTROL_PERIOD)
    # 0.8 s from rest to 0.4 m/s, reached at the end of each substep, then 0.2 s at 0.4 m/s
    assert physics.poses[0, 0] == pytest.approx(sum(0.5 * 0.02 * k for k in range(1, 41)) * 0.02 + 0.4 * 0.2)
    np.testing.assert_allclose(physics.speeds, [[0.4, 0.0]])
    physics.drive(commands((0.4, -1.0)), CONTROL_PERIOD)
    np.testing.assert_allclose(physics.speeds, [[0.4, -0.2]])


def test_commands_beyond_the_robot_are_cut():
    physics = placed(EMPTY, (0, 0, 0))
    physics.drive(commands((5.0, 0.0)), CONTROL_PERIOD)
    assert physics.poses[0, 0] == pytest.approx(0.65 * CONTROL_PERIOD)
    physics.drive(commands((0.0, -50.0)), CONTROL_PERIOD)
    assert physics.poses[0, 2] == pytest.approx(-math.pi * CONTROL_PERIOD)


def test_a_robot_placed_inside_an_obstacle_is_pushed_out():
    world = make_world({"box": {"at": [0, 0], "size": [0.6, 0.6], "height": 1}})
    physics = placed(world, (0.25, 0.0, math.pi))
    poses, bumper = physics.drive(commands((0.2, 0.0)), CONTROL_PERIOD)
    assert bumper[0]
    assert overlap(footprints(world), poses[0, :2]) < 0.005


@pytest.mark.parametrize("substep", [0.0, -0.01, math.nan])
def test_an_impossible_substep_is_refused(substep):
    with pytest.raises(ValueError, match="substep"):
        Physics([EMPTY], substep=substep)
