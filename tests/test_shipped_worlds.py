"""What the shipped worlds promise, one rule a test; geometry is checked with shapely, not with the planner."""

from __future__ import annotations

import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
import shapely

import navsim
from navsim.camera import DepthCamera
from navsim.oracle import Oracle
from navsim.planner import shortest_path_length
from navsim.raycast import Scene, nearest_depth
from navsim.robot import ACTIONS, TURTLEBOT2
from navsim.simulator import Simulator
from navsim.task import Path, Task
from navsim.world import Box, World

NAMES = ("simple_train", "simple_eval", "complex_train", "complex_eval")
ROOMS = ("simple", "complex")
CAMERA = DepthCamera()
SEEN_UP_TO = CAMERA.mount_z + 0.4 * math.tan(math.radians(CAMERA.vertical_fov_deg / 2))
"""Height, metres, that the camera sees at 0.4 m; what hangs higher can never be nearer than the depth rule allows."""
PASSABLE = 1.0
"""Width, metres, of the gaps on the way from every start to every goal."""

every_world = pytest.mark.parametrize("name", NAMES)
every_room = pytest.mark.parametrize("room", ROOMS)
complex_worlds = pytest.mark.parametrize("name", NAMES[2:])


@cache
def load(name: str) -> World:
    return navsim.load_world(name)


def footprint(obstacle) -> shapely.Geometry:
    if isinstance(obstacle, Box):
        (x, y), (a, b) = obstacle.at, obstacle.size
        upright = shapely.box(x - a / 2, y - b / 2, x + a / 2, y + b / 2)
        return shapely.affinity.rotate(upright, obstacle.yaw_deg, origin=(x, y))
    return shapely.Point(obstacle.at).buffer(obstacle.radius, quad_segs=64)


def places(world: World) -> tuple[np.ndarray, np.ndarray]:
    return np.array([start.at for start in world.starts]), np.array([goal.at for goal in world.goals])


def is_low(obstacle) -> bool:
    return obstacle.top < CAMERA.mount_z


def is_raised(obstacle) -> bool:
    return obstacle.base > 0.0


def is_in_the_way(obstacle) -> bool:
    """Whether the robot would hit it, or see it nearer than 0.4 m."""
    return obstacle.base < max(TURTLEBOT2.height, SEEN_UP_TO)


def free_floor(world: World, width: float) -> shapely.Geometry:
    """Where the centre of a disc of that width may be."""
    half = world.half_size - width / 2
    blocked = shapely.union_all([footprint(obstacle) for obstacle in world.obstacles if is_in_the_way(obstacle)])
    return shapely.box(*-half, *half).difference(blocked.buffer(width / 2, quad_segs=64))


def test_these_four_worlds_are_shipped():
    assert set(navsim.shipped_worlds()) >= set(NAMES)


@every_world
def test_the_room_is_seven_metres_square_with_walls_of_two_metres(name):
    world = load(name)
    assert world.size == (7.0, 7.0)
    assert world.walls.height == 2.0


@every_world
def test_episodes_start_in_the_centre_and_the_four_corners_facing_anywhere(name):
    starts, _ = places(load(name))
    sectors = sorted(tuple(np.sign(start).astype(int)) for start in starts)
    assert sectors == [(-1, -1), (-1, 1), (0, 0), (1, -1), (1, 1)]
    assert np.abs(starts[np.abs(starts).sum(axis=1) > 0]).min() >= 2.5
    assert all(start.yaw_deg is None for start in load(name).starts)


@every_world
def test_every_start_has_a_metre_of_free_view_in_some_direction(name):
    world = load(name)
    scene = Scene([world])
    yaws = np.deg2rad(np.arange(-175.0, 181.0, 5.0))
    for x, y in places(world)[0]:
        poses = np.column_stack([np.full(len(yaws), x), np.full(len(yaws), y), yaws])
        views = nearest_depth(scene, np.zeros(len(yaws), dtype=np.intp), poses, CAMERA, within=1.0)
        assert np.count_nonzero(views >= 1.0) >= 5


@pytest.mark.parametrize(("kind", "number"), [("train", 14), ("eval", 20)])
@every_room
def test_there_are_as_many_goals_as_the_thesis_has(room, kind, number):
    assert len(load(f"{room}_{kind}").goals) == number


@every_world
def test_goals_are_spread_evenly(name):
    starts, goals = places(load(name))
    apart = np.hypot(*(goals[:, None] - goals[None]).transpose(2, 0, 1))
    assert apart[~np.eye(len(goals), dtype=bool)].min() > 0.85
    assert np.hypot(*(goals[:, None] - starts[None]).transpose(2, 0, 1)).min() > 2 * Task().goal_radius
    # Nowhere on the floor is it far to the next start or goal.
    axis = np.linspace(-3.5, 3.5, 71)
    floor = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    listed = np.concatenate([starts, goals])
    away = np.hypot(*(floor[:, None] - listed[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.max() < 1.5


@every_room
def test_the_evaluation_room_holds_the_same_obstacles_in_another_arrangement(room):
    def inventory(world):
        return Counter(
            (obstacle.name, obstacle.kind, obstacle.base, obstacle.height, round(footprint(obstacle).area, 6))
            for obstacle in world.obstacles
        )

    train, evaluation = load(f"{room}_train"), load(f"{room}_eval")
    assert inventory(train) == inventory(evaluation)
    moved = {obstacle.name: np.array(obstacle.at) for obstacle in train.obstacles}
    assert all(np.linalg.norm(moved[obstacle.name] - obstacle.at) > 0.5 for obstacle in evaluation.obstacles)


@every_world
def test_obstacles_lie_in_the_room_and_do_not_run_into_each_other(name):
    obstacles = load(name).obstacles
    shapes = [footprint(obstacle) for obstacle in obstacles]
    room = shapely.box(-3.5, -3.5, 3.5, 3.5)
    for i, (obstacle, shape) in enumerate(zip(obstacles, shapes, strict=True)):
        assert shape.difference(room).area < 1e-6, obstacle.name
        for other, other_shape in zip(obstacles[:i], shapes[:i], strict=True):
            if obstacle.base < other.top and other.base < obstacle.top:
                assert shape.intersection(other_shape).area < 1e-6, f"{obstacle.name} and {other.name}"


@pytest.mark.parametrize("name", NAMES[:2])
def test_simple_rooms_hold_large_blocks_only(name):
    for obstacle in load(name).obstacles:
        assert isinstance(obstacle, Box)
        assert obstacle.base == 0.0
        assert obstacle.top > 2 * CAMERA.mount_z
        assert footprint(obstacle).area > 0.49


@complex_worlds
def test_complex_rooms_hold_at_least_24_obstacles(name):
    assert len(load(name).obstacles) >= 24


@complex_worlds
def test_complex_rooms_are_covered_to_at_least_six_percent(name):
    standing = shapely.union_all([footprint(obstacle) for obstacle in load(name).obstacles if not is_raised(obstacle)])
    assert standing.area >= 0.06 * 49.0


@complex_worlds
def test_a_third_of_the_obstacles_of_complex_rooms_is_low_or_raised(name):
    obstacles = load(name).obstacles
    assert sum(is_low(obstacle) or is_raised(obstacle) for obstacle in obstacles) >= len(obstacles) / 3


@complex_worlds
def test_a_planar_laser_at_any_height_misses_something_that_is_in_the_way(name):
    obstacles = [obstacle for obstacle in load(name).obstacles if obstacle.base < TURTLEBOT2.height]
    for height in np.arange(0.05, TURTLEBOT2.height, 0.01):
        missed = [obstacle for obstacle in obstacles if not obstacle.base <= height <= obstacle.top]
        assert len(missed) >= 3, f"a laser at {height:.2f} m"


@complex_worlds
def test_complex_rooms_hold_large_and_small_things_of_each_kind(name):
    obstacles = load(name).obstacles
    names = " ".join(obstacle.name for obstacle in obstacles)
    assert all(kind in names for kind in ("bin", "can", "post", "table top", "table leg", "carton", "pallet"))
    areas = np.array([footprint(obstacle).area for obstacle in obstacles])
    assert np.count_nonzero(areas >= 0.4) >= 5
    assert np.count_nonzero(areas <= 0.15) >= 10


@every_world
def test_every_start_and_goal_are_joined_by_a_way_whose_gaps_are_a_metre_wide(name):
    world = load(name)
    floor = free_floor(world, PASSABLE)
    parts = shapely.get_parts(floor)
    starts, goals = places(world)
    around = [{i for i, part in enumerate(parts) if part.distance(shapely.Point(p)) < 1e-6} for p in (*starts, *goals)]
    assert len(set.intersection(*around)) == 1


@every_world
def test_a_disc_of_one_metre_finds_its_way_from_every_start_to_every_goal(name):
    world = load(name)
    starts, goals = places(world)
    for start in starts:
        for goal in goals:
            length = shortest_path_length(world, start, goal, robot_radius=PASSABLE / 2, robot_height=SEEN_UP_TO)
            assert math.isfinite(length)


def success_rate_of_driving_straight(world: World, seeds: int = 3) -> float:
    """Share of the paths on which turning towards the goal, whatever is in between, ends in success."""
    turns = {index: action.angular for index, action in enumerate(ACTIONS) if action.angular is not None}
    paths = [Path(*pair) for pair in world.paths]
    successes = 0
    for seed in range(seeds):
        simulator = Simulator(world, len(paths), seed=seed)
        headings = simulator.reset(paths=paths).heading
        running = np.ones(len(paths), dtype=bool)
        while running.any():
            # The turn that brings the goal ahead within about two steps; straight on, faster.
            wanted = np.clip(headings / 0.4, -math.pi / 4, math.pi / 4)
            actions = np.array([min(turns, key=lambda index: abs(turns[index] - w)) for w in wanted])
            turning = np.array([turns[action] for action in actions])
            actions[turning == simulator.commands[:, 1]] = 1
            transition = simulator.step(actions)
            ended = transition.terminated | transition.truncated
            successes += np.count_nonzero(transition.success & running)
            running &= ~ended
            headings = simulator.reset(ended, paths=paths).heading
    return successes / (seeds * len(paths))


@pytest.mark.parametrize(("room", "less_than"), [("simple", 0.60), ("complex", 0.45)])
@pytest.mark.parametrize("kind", ["train", "eval"])
def test_driving_straight_at_the_goal_often_fails(room, less_than, kind):
    assert 0.15 < success_rate_of_driving_straight(load(f"{room}_{kind}"), seeds=1) < less_than


def solve(world: World, oracle: Oracle, path: Path, seed: int) -> tuple[float, float]:
    """Drives the oracle's plan for a path in a fresh simulator; the length driven and that of the shortest way."""
    simulator = Simulator(world, seed=seed)
    simulator.reset(paths=[path])
    start, goal = simulator.poses[0].copy(), simulator.goals[0].copy()
    actions = oracle.plan(start, goal)
    assert actions is not None, f"path {path[:2]} of {world.name}, seed {seed}, from {start}"
    driven, position = 0.0, start[:2]
    for action in actions:
        transition = simulator.step(np.array([action]))
        driven += math.dist(position, simulator.poses[0, :2])
        position = simulator.poses[0, :2].copy()
    assert transition.success[0]
    return driven, shortest_path_length(world, start[:2], goal)


@every_world
def test_the_oracle_solves_a_sample_of_the_paths(name):
    world = load(name)
    oracle = Oracle(world)
    for start in range(len(world.starts)):
        solve(world, oracle, Path(start, (3 * start + 1) % len(world.goals)), seed=start)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@every_world
def test_the_oracle_solves_every_path_by_nearly_the_shortest_way(name):
    world = load(name)
    oracle = Oracle(world)
    lengths = [solve(world, oracle, Path(*pair), seed) for seed, pair in enumerate(world.paths)]
    spl = np.mean([shortest / max(shortest, driven) for driven, shortest in lengths])
    assert spl > 0.92
