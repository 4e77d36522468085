"""The planning oracle: its plans are driven in a fresh simulator, step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from navsim.camera import DepthCamera
from navsim.oracle import Oracle, plan
from navsim.physics import obstacle_poses_along
from navsim.planner import shortest_path_length
from navsim.raycast import render_depth
from navsim.robot import TURTLEBOT2, Robot
from navsim.simulator import Simulator
from navsim.task import Path, Task
from navsim.world import World

MAZE = [  # three baffles that leave a gap of 1.2 m at alternate ends
    {"box": {"at": [-0.6, 1.5], "size": [4.8, 0.2], "height": 1.0}},
    {"box": {"at": [0.6, 0.0], "size": [4.8, 0.2], "height": 1.0}},
    {"box": {"at": [-0.6, -1.5], "size": [4.8, 0.2], "height": 1.0}},
]
TOO_LOW_TO_SEE_UNDER = {"box": {"at": [0.0, 0.0], "size": [0.1, 2.0], "base": 0.43, "height": 0.05}}
"""A beam just over the robot, across a room 2 m wide: the bumper passes, the camera sees it within 0.4 m."""


def make_world(obstacles, size=(6.0, 6.0), start=(-2.0, 0.0), yaw_deg=0.0, goal=(2.0, 0.0)) -> World:
    return World.from_dict(
        {
            "format": 1,
            "size": list(size),
            "obstacles": obstacles,
            "starts": [{"at": list(start), "yaw_deg": yaw_deg}],
            "goals": [list(goal)],
        }
    )


def planned(world: World, **settings) -> np.ndarray | None:
    start, goal = world.starts[0], world.goals[0]
    pose = np.array([*start.at, math.radians(start.yaw_deg)])
    return plan(world, pose, np.array(goal.at), **settings)


def drive(world: World, actions: np.ndarray, **settings) -> tuple[str, np.ndarray]:
    """How an episode of a fresh simulator ends after exactly these actions, and the positions on the way."""
    simulator = Simulator(world, seed=0, **settings)
    simulator.reset(paths=[Path(0, 0)])
    places = [simulator.poses[0, :2].copy()]
    for number, action in enumerate(actions, start=1):
        transition = simulator.step(np.array([action]))
        places.append(simulator.poses[0, :2].copy())
        if transition.terminated[0] or transition.truncated[0]:
            assert number == len(actions), "the episode ended before the plan did"
            return ("success" if transition.success[0] else "failure"), np.array(places)
    return "still going", np.array(places)


def length(places: np.ndarray) -> float:
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def test_straight_ahead_it_takes_as_few_steps_as_the_speed_allows():
    actions = planned(make_world([]))
    # 4 m to go, less the goal disc of 0.5 m, at 0.4 m/s for 0.2 s a step
    assert len(actions) == math.ceil(3.5 / 0.08)


@pytest.mark.parametrize("yaw_deg", [0.0, 133.0, 180.0, -95.0])
def test_it_turns_first_when_it_faces_elsewhere(yaw_deg):
    world = make_world([{"cylinder": {"at": [0.0, 0.0], "radius": 0.3, "height": 1.0}}], yaw_deg=yaw_deg)
    outcome, places = drive(world, planned(world))
    assert outcome == "success"
    # a turn in place is not among the actions: the circle of 0.25 m at 0.2 m/s is what it costs
    assert length(places) < shortest_path_length(world, (-2.0, 0.0), (2.0, 0.0)) + 2 * math.pi * 0.255


@pytest.mark.parametrize(
    ("start", "yaw_deg", "goal"),
    [((-2.5, 2.3), 0.0, (2.5, -2.4)), ((2.4, -2.2), 180.0, (-2.4, 2.2))],
)
def test_a_maze_is_solved_about_as_short_as_can_be(start, yaw_deg, goal):
    world = make_world(MAZE, start=start, yaw_deg=yaw_deg, goal=goal)
    outcome, places = drive(world, planned(world))
    assert outcome == "success"
    assert length(places) < shortest_path_length(world, start, goal) / 0.9


def test_a_gap_hardly_wider_than_the_picture_is_passed():
    # At 0.4 m the 80 columns' centres see 0.456 m; what is left to either side is 17 mm.
    side = {"size": [0.2, 0.755], "height": 1.0}
    world = make_world(
        [{"box": {"at": [0.0, 0.6225], **side}}, {"box": {"at": [0.0, -0.6225], **side}}],
        size=(4.0, 2.0),
        start=(-1.2, 0.0),
        goal=(1.5, 0.0),
    )
    outcome, _ = drive(world, planned(world))
    assert outcome == "success"


def test_a_low_box_that_is_out_of_the_picture_is_still_driven_around():
    # 0.1 m high: nearer than 0.45 m it is below the picture, and only the bumper tells.
    world = make_world([{"box": {"at": [0.0, 0.0], "size": [0.5, 1.5], "height": 0.1}}])
    outcome, places = drive(world, planned(world))
    assert outcome == "success"
    assert np.abs(places[:, 1]).max() > 0.75 + 0.17


def test_a_table_is_passed_underneath():
    legs = [{"cylinder": {"at": [x, y], "radius": 0.03, "height": 0.7}} for x in (-0.4, 0.4) for y in (-0.6, 0.6)]
    world = make_world([{"box": {"at": [0.0, 0.0], "size": [0.9, 1.3], "base": 0.7, "height": 0.03}}, *legs])
    outcome, places = drive(world, planned(world))
    assert outcome == "success"
    assert np.abs(places[:, 1]).max() < 0.3


def test_there_is_no_plan_into_a_closed_room():
    world = World.from_dict(
        {"format": 1, "size": [6, 6], "obstacles": [{"box": {"at": [0, 0], "size": [0.2, 6], "height": 1}}]}
    )
    assert plan(world, np.array([-2.0, 0.0, 0.0]), np.array([2.0, 0.0])) is None


def test_there_is_no_plan_under_a_beam_that_the_depth_rule_forbids():
    world = make_world([TOO_LOW_TO_SEE_UNDER], size=(4.0, 2.0), start=(-0.6, 0.0), goal=(1.0, 0.0))
    task = Task(max_steps=15)  # 14 are enough
    assert planned(world, task=task) is None
    bumper_only = Task(max_steps=15, collision_depth=0.0)
    outcome, _ = drive(world, planned(world, task=bumper_only), task=bumper_only)
    assert outcome == "success"


def test_there_is_no_plan_within_too_few_steps():
    world = make_world([])
    assert planned(world, task=Task(max_steps=43)) is None
    assert len(planned(world, task=Task(max_steps=44))) == 44


def test_nothing_is_searched_for_a_goal_that_no_episode_is_long_enough_for(monkeypatch):
    def search(*arguments):
        raise AssertionError("there is nothing to be found")

    monkeypatch.setattr("navsim.oracle._search", search)
    field = World.from_dict({"format": 1, "size": [60, 60]})
    assert Oracle(field).plan(np.array([-29.0, -29.0, 0.8]), np.array([29.0, 29.0])) is None


def test_there_is_no_plan_from_a_pose_that_cannot_be_left():
    # 0.45 m before a wall and facing it: the tightest turn takes too long.
    world = make_world([], start=(2.5, 0.0), goal=(-2.0, 0.0))
    assert planned(world) is None


def test_a_goal_that_the_start_lies_in_is_reached_in_one_step():
    world = make_world([])
    oracle = Oracle(world)
    assert len(oracle.plan(np.array([0.0, 0.0, 0.0]), np.array([0.2, 0.0]))) == 1


def test_the_goal_wins_over_a_picture_that_is_too_near():
    # The wall is nearer than 0.4 m from x = 2.687 on; steps of 0.08 m lead to 2.64 and 2.72.
    world = make_world([], start=(2.0, 0.0), goal=(2.8, 0.0))
    task = Task(goal_radius=0.1, max_steps=9)
    outcome, places = drive(world, planned(world, task=task), task=task)
    assert outcome == "success"
    assert render_depth(world, np.array([[*places[-1], 0.0]])).min() < 0.4
    # A goal disc that begins at 2.77 is out of reach from there in a single step.
    assert planned(world, task=Task(goal_radius=0.03, max_steps=10)) is None


def test_a_robot_that_accelerates_slowly_gets_a_plan_of_its_own():
    robot = Robot(linear_acceleration=0.3, angular_acceleration=1.5)
    world = make_world([{"box": {"at": [0.0, 0.0], "size": [0.4, 1.2], "height": 1.0}}])
    outcome, _ = drive(world, planned(world, robot=robot), robot=robot)
    assert outcome == "success"


def test_the_camera_decides_what_is_too_near():
    # A beam at 0.55 m is out of the Kinect's picture at 0.4 m but not out of a camera's that looks up higher.
    world = make_world(
        [{"box": {"at": [0.0, 0.0], "size": [0.1, 2.0], "base": 0.55, "height": 0.05}}],
        size=(4.0, 2.0),
        start=(-0.6, 0.0),
        goal=(1.0, 0.0),
    )
    task = Task(max_steps=15)
    assert planned(world, task=task) is not None
    tall = DepthCamera(vertical_fov_deg=70.0)
    assert planned(world, task=task, camera=tall) is None


def test_depth_along_the_ray_is_what_counts_for_a_range_camera():
    side = {"size": [0.2, 0.78], "height": 1.0}  # 0.44 m between them: too narrow for planar depth
    world = make_world(
        [{"box": {"at": [0.0, 0.61], **side}}, {"box": {"at": [0.0, -0.61], **side}}],
        size=(4.0, 2.0),
        start=(-0.8, 0.0),
        goal=(1.0, 0.0),
    )
    task, camera = Task(max_steps=17), DepthCamera(depth="range")
    assert planned(world, task=task) is None
    outcome, _ = drive(world, planned(world, task=task, camera=camera), task=task, camera=camera)
    assert outcome == "success"


def test_equal_questions_get_equal_answers():
    world = make_world([{"cylinder": {"at": [0.0, 0.1], "radius": 0.3, "height": 1.0}}])
    pose, goal = np.array([-2.0, 0.0, 1.0]), np.array([2.0, 0.0])
    oracle = Oracle(world)
    first, again = oracle.plan(pose, goal), oracle.plan(pose, goal)
    assert first.tolist() == again.tolist() == plan(world, pose, goal).tolist()
    assert first.dtype == np.int64


def test_the_default_robot_is_the_turtlebot():
    assert Oracle(make_world([])).robot == TURTLEBOT2


@pytest.mark.parametrize("width", [0.48, 0.5, 0.6])
@pytest.mark.parametrize("turned", [False, True])
def test_a_way_through_a_room_hardly_wider_than_the_robot_is_found(width, turned):
    size, ahead = ((6.0, width), np.array([1.0, 0.0])) if turned else ((width, 6.0), np.array([0.0, 1.0]))
    world = World(size=size, starts=[tuple(-2.0 * ahead)], goals=[tuple(2.0 * ahead)])
    pose = np.array([*(-2.0 * ahead), math.atan2(ahead[1], ahead[0])])
    assert len(plan(world, pose, 2.0 * ahead)) == 44  # to the goal's disc, straight on


def test_phases_may_be_those_of_a_simulator_with_worlds_where_more_moves():
    cart = {"box": {"at": [0, 2], "size": [0.3, 0.3], "height": 1, "motion": {"path": [[0, 2], [1, 2]], "speed": 0.1}}}
    other = {
        "box": {"at": [0, -2], "size": [0.3, 0.3], "height": 1, "motion": {"path": [[0, -2], [1, -2]], "speed": 0.1}}
    }
    one, two = make_world([cart], start=(-2.0, 0.0)), make_world([cart, other], start=(-2.0, 0.0))
    simulator = Simulator([one, two], 2, seed=0)
    simulator.reset()
    phases = simulator.phases[0]
    assert phases.shape == (2,)
    pose, goal = simulator.poses[0], simulator.goals[0]
    np.testing.assert_array_equal(Oracle(one).plan(pose, goal, phases), Oracle(one).plan(pose, goal, phases[:1]))
    commands = np.array([[0.2, 0.0]] * 3)
    along = obstacle_poses_along(one, pose, phases, commands, 0.2)
    np.testing.assert_array_equal(along, obstacle_poses_along(one, pose, phases[:1], commands, 0.2))
