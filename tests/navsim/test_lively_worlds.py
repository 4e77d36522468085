"""Episodes, plans and pictures in worlds where something moves or can be pushed."""

import pickle

import numpy as np
import pytest
import shapely

import navsim
from navsim.animation import animate_episode
from navsim.camera import DepthCamera
from navsim.dynamics import Dynamics
from navsim.oracle import Oracle
from navsim.physics import obstacle_poses_along
from navsim.raycast import render_depth
from navsim.rearrange import rearrange
from navsim.robot import NUM_ACTIONS, TURTLEBOT2
from navsim.simulator import Simulator
from navsim.task import Path, Task
from navsim.world import Box, World

SMALL = DepthCamera(width=20, height=16)
AHEAD, FASTER = 4, 1


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def straight_world(*obstacles, **settings):
    return make_world(*obstacles, starts=[{"at": [-3.0, 0.0], "yaw_deg": 0}], goals=[[3.0, 0.0]], **settings)


def can(at, **pushable):
    return {"cylinder": {"at": at, "radius": 0.1, "height": 0.45, "pushable": {"mass": 0.5, **pushable}}}


def walker(path, speed=0.5, **motion):
    motion = {"path": path, "speed": speed, **motion}
    return {"cylinder": {"at": path[0], "radius": 0.2, "height": 1.7, "motion": motion}}


def crowded(**settings):
    return World.from_dict({**navsim.load_world("crowded").to_dict(), **settings})


def ended(transition):
    return transition.terminated | transition.truncated


def rollout(simulator, generator, steps):
    seen = [b"".join(part.tobytes() for part in simulator.reset())]
    for _ in range(steps):
        transition = simulator.step(generator.integers(NUM_ACTIONS, size=simulator.num_robots))
        seen.append(b"".join(part.tobytes() for part in transition) + simulator.obstacle_poses.tobytes())
        if ended(transition).any():
            seen.append(b"".join(part.tobytes() for part in simulator.reset(ended(transition))))
    return seen


PUSHING = Task(pushing_is_collision=False, collision_depth=0.05)


def test_the_same_seed_gives_the_same_bytes_where_things_move_and_are_pushed():
    worlds = [crowded(), crowded(starts="random", goals="random")]
    runs = [
        rollout(Simulator(worlds, 4, camera=SMALL, task=PUSHING, seed=seed), np.random.default_rng(0), 40)
        for seed in (11, 11, 12)
    ]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_robot_does_what_it_does_whoever_else_is_there():
    world, drive = crowded(), np.random.default_rng(1).integers(NUM_ACTIONS, size=(50, 5))
    few, many = (Simulator(world, count, camera=SMALL, task=PUSHING, seed=9) for count in (2, 5))
    few.reset()
    many.reset()
    for actions in drive:
        one, other = few.step(actions[:2]), many.step(actions)
        for part, whole in zip(one, other, strict=True):
            assert part.tobytes() == whole[:2].tobytes()
        assert few.obstacle_poses.tobytes() == many.obstacle_poses[:2].tobytes()
        few.reset(ended(one))
        many.reset(ended(other))


def test_a_run_resumes_from_its_state_bit_for_bit():
    world = crowded()
    original = Simulator(world, 4, camera=SMALL, task=PUSHING, seed=2)
    generator = np.random.default_rng(3)
    rollout(original, generator, 15)
    resumed = Simulator(world, 4, camera=SMALL, task=PUSHING, seed=77)
    resumed.load_state_dict(pickle.loads(pickle.dumps(original.state_dict())))
    np.testing.assert_array_equal(resumed.ideal_depth, original.ideal_depth)
    for _ in range(30):
        actions = generator.integers(NUM_ACTIONS, size=4)
        one, other = original.step(actions), resumed.step(actions)
        for expected, got in zip(one, other, strict=True):
            assert expected.tobytes() == got.tobytes()
        original.reset(ended(one))
        resumed.reset(ended(other))
    assert original.obstacle_poses.tobytes() == resumed.obstacle_poses.tobytes()


def test_the_picture_shows_everything_where_it_is_at_that_moment():
    simulator = Simulator(crowded(), 3, camera=SMALL, task=Task(collision_depth=0.0), seed=1)
    simulator.reset()
    still = simulator.obstacle_poses.copy()
    for _ in range(5):
        transition = simulator.step(np.array([AHEAD] * 3))
        expected = render_depth([simulator.worlds[0]] * 3, simulator.poses, SMALL, simulator.obstacle_poses)
        np.testing.assert_array_equal(simulator.ideal_depth, expected)
        simulator.reset(ended(transition))
    assert (simulator.obstacle_poses[:, :4] != still[:, :4]).any(axis=2).all()


def test_no_robot_starts_in_a_walker_or_right_in_front_of_one():
    ways = [[[-2, y], [2, y]] for y in (-2.0, -0.7, 0.7, 2.0)]
    for places in ({"starts": [[0, 0.7], [0, -2.0]], "goals": [[3, 3]]}, {"starts": "random", "goals": "random"}):
        world = make_world(*[walker(way, repeat="there-and-back") for way in ways], can([0.0, -0.1]), **places)
        simulator = Simulator(world, 60, seed=4)
        simulator.reset()
        centres = simulator.obstacle_poses[:, :4, :2]
        apart = np.hypot(*(centres - simulator.poses[:, None, :2]).transpose(2, 0, 1)).min(axis=1)
        assert apart.min() >= 0.2 + TURTLEBOT2.radius + 0.05
        assert simulator.ideal_depth.min() >= 0.4
        middle = simulator.ideal_depth[:, :33].min(axis=(1, 2))  # without the floor
        assert (middle >= 1.0).mean() > 0.9
        assert len(np.unique(simulator.phases[:, 0])) == 60


def test_what_moves_may_pace_beside_something_long_that_can_be_pushed_but_not_in_it():
    board = {"box": {"at": [0.0, 0.0], "size": [3.0, 0.1], "height": 0.2, "yaw_deg": 20.0, "pushable": {"mass": 2.0}}}
    beside, across = walker([[-1.0, 0.9], [1.0, 0.9]]), walker([[0.0, -1.0], [0.0, 1.0]])
    simulator = Simulator(straight_world(beside, across, board), 200, seed=3)
    simulator.reset()
    footprint = shapely.Polygon(Box(at=(0.0, 0.0), size=(3.0, 0.1), height=0.2, yaw_deg=20.0).footprints()[0][0])
    distance = shapely.distance(footprint, shapely.points(simulator.obstacle_poses[:, :2, :2]))
    assert distance.min() > 0.2 - 1e-5  # a walker's radius
    reach = np.hypot(*simulator.obstacle_poses[:, 0, :2].T)
    assert (reach < np.hypot(1.5, 0.05)).any()
    assert distance[:, 1].min() < 0.25


def test_a_start_that_is_never_free_is_told():
    world = make_world(walker([[0, 0], [0.1, 0]]), starts=[[0, 0.2]], goals=[[3, 3]])
    with pytest.raises(ValueError, match="has no free moment for a start at"):
        Simulator(world, seed=0).reset()


def test_a_walker_that_runs_into_the_robot_from_behind_is_a_bumper_collision():
    world = straight_world(walker([[-3, -3], [-3, 3], [3, 3]], 5.0))
    simulator = Simulator(world, 30, seed=0)
    simulator.reset()
    for _ in range(60):
        transition = simulator.step(np.array([AHEAD] * 30))
        hit = transition.bumper & ~transition.too_near
        if hit.any():
            assert transition.collision[hit].all()
            assert (transition.reward[hit] == -1.0).all()
            assert not transition.pushed.any()
            return
        simulator.reset(ended(transition))
    raise AssertionError("nobody was hit")


def drive_at_a_can(task, *others, radius=0.1):
    thing = can([0.0, 0.0])
    thing["cylinder"]["radius"] = radius
    simulator = Simulator(straight_world(thing, *others), task=task)
    simulator.reset()
    for _ in range(100):
        transition = simulator.step(np.array([AHEAD]))
        if ended(transition)[0]:
            break
    return simulator, transition


def test_what_can_be_pushed_collides_by_default_as_anything_does():
    seen = drive_at_a_can(Task())[1]
    assert (seen.too_near[0], seen.bumper[0], seen.collision[0]) == (True, False, True)
    unseen = drive_at_a_can(Task(collision_depth=0.0))[1]
    assert (unseen.too_near[0], unseen.bumper[0], unseen.pushed[0], unseen.collision[0]) == (False, True, True, True)


def test_a_task_may_allow_pushing():
    simulator, last = drive_at_a_can(Task(pushing_is_collision=False))
    assert last.pushed[0]
    assert not ended(last)[0]
    assert simulator.obstacle_poses[0, 0, 0] > 0.5
    assert simulator.ideal_depth.min() < 0.4


def test_the_depth_rule_looks_through_what_may_be_pushed_at_what_may_not():
    wall = {"box": {"at": [1.0, 0.0], "size": [0.2, 3.0], "height": 1.0}}
    simulator, last = drive_at_a_can(Task(pushing_is_collision=False), wall, radius=0.03)
    assert (last.too_near[0], last.bumper[0], last.collision[0]) == (True, False, True)
    assert 0.36 - 1e-6 <= 0.9 - (simulator.poses[0, 0] + DepthCamera().mount_x) < 0.4


def test_only_true_or_false_decides_about_pushing():
    with pytest.raises(ValueError, match="pushing_is_collision must be true or false; got 'yes'"):
        Task(pushing_is_collision="yes")


def outcome_of(world, phase, actions):
    simulator = Simulator(world, seed=0)
    simulator.reset()
    simulator._physics.place([0], 0, simulator.poses.copy(), [phase])
    for action in actions:
        transition = simulator.step(np.array([action]))
        if ended(transition)[0]:
            break
    return transition


def test_the_oracle_knows_where_a_walker_will_be():
    world, empty = straight_world(walker([[0, -2], [0, 2]])), straight_world()
    start, goal = np.array([-3.0, 0.0, 0.0]), np.array([3.0, 0.0])
    direct = Oracle(empty).plan(start, goal)
    oracle, failed = Oracle(world), 0
    for phase in (0.1, 0.25, 0.5):
        failed += not outcome_of(world, phase, direct).success[0]
        assert outcome_of(world, phase, oracle.plan(start, goal, [phase])).success[0]
    assert 1 <= failed <= 2


def solve_crowded(paths):
    world = navsim.load_world("crowded")
    oracle = Oracle(world)
    for seed, path in paths:
        simulator = Simulator(world, seed=seed)
        simulator.reset(paths=[path])
        actions = oracle.plan(simulator.poses[0].copy(), simulator.goals[0].copy(), simulator.phases[0].copy())
        assert actions is not None, path
        for action in actions:
            transition = simulator.step(np.array([action]))
        assert transition.success[0]


def test_the_oracle_solves_a_sample_of_the_crowded_paths():
    solve_crowded([(2, Path(1, 2)), (3, Path(2, 3)), (11, Path(3, 11))])


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_oracle_solves_every_crowded_path():
    solve_crowded((seed, Path(*pair)) for seed, pair in enumerate(navsim.load_world("crowded").paths))


def test_furniture_that_moves_is_rearranged_with_its_way():
    worlds = rearrange(navsim.load_world("crowded"), 2, np.random.default_rng(0))
    assert len({tuple(one.motion.knots().ravel()) for w in worlds for one in w.obstacles if one.motion}) > 2
    for world in worlds:
        Simulator(world, 4, camera=SMALL, seed=0).reset()


def test_an_episode_is_replayed_for_pictures(tmp_path):
    world = straight_world(can([-2.0, 0.0]), walker([[2, 2], [2, -2]]))
    simulator = Simulator(world, task=PUSHING, seed=3)
    simulator.reset()
    poses, obstacles, commands = [simulator.poses[0].copy()], [simulator.obstacle_poses[0].copy()], []
    for _ in range(12):
        simulator.step(np.array([FASTER]))
        poses.append(simulator.poses[0].copy())
        obstacles.append(simulator.obstacle_poses[0].copy())
        commands.append(simulator.commands[0].copy())
    again = obstacle_poses_along(world, poses[0], simulator.phases[0], np.array(commands), 0.2)
    np.testing.assert_array_equal(again, obstacles)
    assert again[-1, 1, 0] > -1.9
    path = animate_episode(tmp_path / "a.gif", world, np.array(poses), (3, 0), obstacle_poses=again, camera=SMALL)
    assert path.stat().st_size > 1000
    with pytest.raises(ValueError, match="obstacle_poses for 3 times, but poses for 13"):
        animate_episode(tmp_path / "b.gif", world, np.array(poses), (3, 0), obstacle_poses=again[:3])


def test_the_crowded_world_holds_walkers_a_door_and_things_to_push():
    world = navsim.load_world("crowded")
    assert world.size == (7.0, 7.0)
    names = [obstacle.name for obstacle in world.obstacles if obstacle.motion is not None]
    assert names == ["door", "walker 1", "walker 2", "walker 3"]
    assert sum(obstacle.pushable is not None for obstacle in world.obstacles) == 4
    dynamics = Dynamics([world])
    assert dynamics.top_speed.max() < 0.65
    assert len(world.paths) == 70
