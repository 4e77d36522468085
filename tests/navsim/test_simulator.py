import copy
import gc
import math
import pickle

import numpy as np
import pymunk
import pytest

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.robot import INITIAL_COMMAND, NUM_ACTIONS, TURTLEBOT2, apply_actions, follow_arc
from navsim.sensor import SensorModel
from navsim.simulator import Observation, Simulator, Transition
from navsim.task import Path, Task
from navsim.world import World
from navsim.worldsource import worlds_from

SMALL = DepthCamera(width=20, height=16)
FASTER, LEFT, AHEAD = 1, 2, 4


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def straight_world(*obstacles, goal=(3.0, 0.0), start=(-3.0, 0.0), yaw_deg=0.0, **settings):
    return make_world(*obstacles, starts=[{"at": list(start), "yaw_deg": yaw_deg}], goals=[list(goal)], **settings)


def cluttered_world(seed, **settings):
    generator = np.random.default_rng(seed)
    obstacles = []
    for _ in range(7):
        obstacles.append(
            {
                "box": {
                    "at": generator.uniform(-2.3, 2.3, 2).tolist(),
                    "size": generator.uniform(0.1, 0.6, 2).tolist(),
                    "yaw_deg": float(generator.uniform(-180, 180)),
                    "height": float(generator.uniform(0.1, 1.0)),
                }
            }
        )
        obstacles.append(
            {
                "cylinder": {
                    "at": generator.uniform(-2.3, 2.3, 2).tolist(),
                    "radius": float(generator.uniform(0.05, 0.2)),
                    "height": float(generator.uniform(0.1, 1.0)),
                }
            }
        )
    corners = [[3, 3], [-3, 3], [3, -3], [-3, -3]]
    settings = {"starts": corners, "goals": [[0.0, 3.0], [3.0, 0.0], [0.0, -3.0], [-3.0, 0.0]], **settings}
    return make_world(*obstacles, **settings)


def ended(transition):
    return transition.terminated | transition.truncated


def rollout(simulator, generator, steps):
    """Random actions with resets, as bytes: everything that a user sees."""
    seen = [b"".join(part.tobytes() for part in simulator.reset())]
    for _ in range(steps):
        transition = simulator.step(generator.integers(NUM_ACTIONS, size=simulator.num_robots))
        seen.append(b"".join(part.tobytes() for part in transition))
        if ended(transition).any():
            seen.append(b"".join(part.tobytes() for part in simulator.reset(ended(transition))))
    return seen


def until_it_ends(simulator, action=AHEAD, first=None, limit=600):
    simulator.reset()
    for number in range(limit):
        transition = simulator.step(np.array([first if number == 0 and first is not None else action]))
        if ended(transition)[0]:
            return transition, number + 1
    raise AssertionError("the episode does not end")


def test_shapes_and_types_are_those_of_the_contract():
    simulator = Simulator(cluttered_world(0), 3, camera=SMALL, seed=0)
    observation = simulator.reset()
    transition = simulator.step(np.array([0, 1, 2]))
    assert isinstance(observation, Observation)
    assert isinstance(transition, Transition)
    for seen in (observation, transition):
        assert (seen.depth.dtype, seen.depth.shape) == (np.uint8, (3, 16, 20))
        assert (seen.heading.dtype, seen.heading.shape) == (np.float32, (3,))
        assert (seen.pose.dtype, seen.pose.shape) == (np.float32, (3, 3))
    assert (transition.reward.dtype, transition.reward.shape) == (np.float32, (3,))
    for name in ("terminated", "truncated", "success", "collision", "bumper", "too_near"):
        flag = getattr(transition, name)
        assert (flag.dtype, flag.shape) == (bool, (3,))


def test_an_episode_begins_at_its_start_with_the_initial_command():
    simulator = Simulator(straight_world(goal=(-3.0, 2.0)), camera=SMALL)
    observation = simulator.reset()
    np.testing.assert_allclose(observation.pose, [[-3.0, 0.0, 0.0]])
    np.testing.assert_allclose(observation.heading, [math.pi / 2], rtol=1e-6)
    np.testing.assert_array_equal(simulator.commands, [INITIAL_COMMAND])
    transition = simulator.step(np.array([AHEAD]))
    np.testing.assert_allclose(transition.pose, [[-2.96, 0.0, 0.0]], rtol=1e-6)


def test_the_picture_is_that_of_the_ray_caster_where_the_robot_is():
    worlds = [cluttered_world(0), cluttered_world(1)]
    camera = DepthCamera(width=20, height=16, depth="range")
    simulator = Simulator(worlds, 4, camera=camera, seed=1)
    simulator.reset()
    for _ in range(3):
        transition = simulator.step(np.array([1, 2, 3, 4]))
        planar = render_depth([worlds[i % 2] for i in range(4)], simulator.poses, camera)
        expected = np.minimum(planar * camera.ray_lengths, camera.max_range)
        np.testing.assert_allclose(simulator.ideal_depth, expected, rtol=1e-6)
        np.testing.assert_array_equal(transition.depth, camera.to_uint8(simulator.ideal_depth))
        if ended(transition).any():
            simulator.reset(ended(transition))


def test_a_step_follows_the_arc_and_pays_for_progress():
    simulator = Simulator(straight_world(start=(0, 0), goal=(2.0, 2.0)), camera=SMALL)
    simulator.reset()
    pose, command = np.zeros(3), np.array([INITIAL_COMMAND])
    for action in (1, 2, 2, 6, 0, 3):
        command = apply_actions(command, np.array([action]))
        pose = follow_arc(pose, command[0], 0.2)
        bearing = math.atan2(2.0 - pose[1], 2.0 - pose[0]) - pose[2]
        transition = simulator.step(np.array([action]))
        np.testing.assert_allclose(simulator.poses[0], pose, atol=1e-12)
        assert transition.heading[0] == pytest.approx(bearing, abs=1e-6)
        assert transition.reward[0] == pytest.approx(command[0, 0] * math.cos(bearing) * 0.2 - 0.01, abs=1e-6)


def test_the_goal_ends_an_episode_in_success():
    transition, steps = until_it_ends(Simulator(straight_world(goal=(0.0, 0.0)), camera=SMALL), first=FASTER)
    assert steps == math.floor((3.0 - 0.5) / 0.08) + 1
    assert transition.success[0]
    assert transition.terminated[0]
    assert not (transition.truncated | transition.collision)[0]
    assert transition.reward[0] == 1.0


@pytest.mark.parametrize("collision_depth", [0.05, 0.4, 0.6])
def test_a_pixel_nearer_than_the_collision_depth_ends_an_episode(collision_depth):
    world = straight_world(goal=(-3.0, 3.0))
    task = Task(collision_depth=collision_depth)
    transition, _ = until_it_ends(Simulator(world, camera=DepthCamera(mount_x=0.2), task=task), first=FASTER)
    gap = 3.5 - (transition.pose[0, 0] + 0.2)
    assert collision_depth - 0.08 <= gap < collision_depth
    assert transition.too_near[0]
    assert transition.collision[0]


def test_the_depth_rule_and_the_bumper_are_reported_apart():
    wall_ahead = {"box": {"at": [0.0, 0.0], "size": [0.2, 3.0], "height": 1.0}}
    seen, _ = until_it_ends(Simulator(straight_world(wall_ahead), camera=SMALL))
    assert (seen.too_near[0], seen.bumper[0], seen.collision[0], seen.reward[0]) == (True, False, True, -1.0)
    ideal_distance = -0.1 - (seen.pose[0, 0] + SMALL.mount_x)
    assert 0.36 - 1e-6 <= ideal_distance < 0.4

    unseen, _ = until_it_ends(Simulator(straight_world(wall_ahead), camera=SMALL, task=Task(collision_depth=0.0)))
    assert (unseen.too_near[0], unseen.bumper[0], unseen.collision[0], unseen.reward[0]) == (False, True, True, -1.0)
    assert unseen.pose[0, 0] == pytest.approx(-0.1 - TURTLEBOT2.radius, abs=1e-3)


def test_the_goal_wins_over_a_collision_in_the_same_step():
    wall_ahead = {"box": {"at": [0.0, 0.0], "size": [0.2, 3.0], "height": 1.0}}
    # The camera is 0.4 m from the wall with the robot at x = -0.413, and the goal's edge lies at -0.42.
    world = straight_world(wall_ahead, start=(-2.0, 0.0), goal=(-0.3, 0.485))
    transition, _ = until_it_ends(Simulator(world, camera=SMALL))
    assert transition.too_near[0]
    assert (transition.success[0], transition.collision[0], transition.reward[0]) == (True, False, 1.0)


def test_an_episode_is_truncated_when_its_time_is_up():
    circling = Simulator(straight_world(start=(0, 0)), camera=SMALL, task=Task(max_steps=7))
    transition, steps = until_it_ends(circling, action=LEFT)
    assert steps == 7
    assert transition.truncated[0]
    assert not (transition.terminated | transition.collision | transition.success)[0]
    assert transition.reward[0] < 0.1


def test_an_episode_that_ends_in_its_last_step_is_not_truncated():
    world = straight_world(start=(0, 0), goal=(0.6, 0.0))
    transition, steps = until_it_ends(Simulator(world, camera=SMALL, task=Task(max_steps=3)))
    assert steps == 3
    assert transition.terminated[0]
    assert not transition.truncated[0]


def test_five_hundred_steps_are_the_default():
    transition, steps = until_it_ends(Simulator(straight_world(start=(0, 0)), camera=SMALL), action=LEFT)
    assert (steps, transition.truncated[0]) == (500, True)


def test_stepping_an_ended_episode_is_refused():
    simulator = Simulator(straight_world(), 2, camera=SMALL, task=Task(max_steps=1))
    with pytest.raises(RuntimeError, match="robot 0 has no running episode"):
        simulator.step(np.array([4, 4]))
    simulator.reset()
    simulator.step(np.array([4, 4]))
    simulator.reset(np.array([True, False]))
    with pytest.raises(RuntimeError, match="robot 1 has no running episode"):
        simulator.step(np.array([4, 4]))


def test_a_partial_reset_leaves_the_others_running():
    simulator = Simulator(cluttered_world(2), 4, camera=SMALL, seed=3)
    simulator.reset()
    simulator.step(np.array([1, 1, 2, 3]))
    before = copy.deepcopy(simulator.state_dict())
    depth_before = simulator.ideal_depth.copy()
    mask = np.array([False, True, False, True])
    observation = simulator.reset(mask)
    np.testing.assert_array_equal(simulator.steps, [1, 0, 1, 0])
    np.testing.assert_array_equal(simulator.poses[~mask], before["physics"]["poses"][~mask])
    np.testing.assert_array_equal(simulator.commands[~mask], before["commands"][~mask])
    np.testing.assert_array_equal(simulator.ideal_depth[~mask], depth_before[~mask])
    np.testing.assert_array_equal(simulator.commands[mask], [INITIAL_COMMAND] * 2)
    np.testing.assert_array_equal(observation.depth, SMALL.to_uint8(simulator.ideal_depth))
    starts = np.array([[3, 3], [-3, 3], [3, -3], [-3, -3]])
    assert all((starts == pose[:2]).all(axis=1).any() for pose in observation.pose[mask])


@pytest.mark.parametrize("draw_worlds", [False, True])
def test_the_same_seed_gives_the_same_bytes(draw_worlds):
    worlds = [cluttered_world(0), cluttered_world(1, starts="random", goals="random")]
    runs = [
        rollout(Simulator(worlds, 5, camera=SMALL, seed=seed, draw_worlds=draw_worlds), np.random.default_rng(0), 60)
        for seed in (11, 11, 12)
    ]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_reseeding_draws_the_same_episodes_again():
    simulator = Simulator(cluttered_world(0), 3, camera=SMALL, seed=5)
    first = simulator.reset()
    simulator.reset()
    simulator.reseed(5)
    np.testing.assert_array_equal(simulator.reset().pose, first.pose)


@pytest.mark.parametrize("places", [{}, {"starts": "random", "goals": "random"}])
def test_a_robot_does_what_it_does_whoever_else_is_there(places):
    world, drive = cluttered_world(4, **places), np.random.default_rng(1).integers(NUM_ACTIONS, size=(80, 6))
    few, many = (Simulator(world, count, camera=SMALL, task=Task(max_steps=20), seed=9) for count in (2, 6))
    begun = few.reset(), many.reset()
    np.testing.assert_array_equal(begun[0].pose, begun[1].pose[:2])
    endings = 0
    for actions in drive:
        one, other = few.step(actions[:2]), many.step(actions)
        for part, whole in zip(one, other, strict=True):
            assert part.tobytes() == whole[:2].tobytes()
        endings += ended(one).sum()
        few.reset(ended(one))
        many.reset(ended(other))
    assert endings >= 8


def test_a_run_resumes_from_its_state_bit_for_bit():
    worlds = [cluttered_world(0), cluttered_world(1, starts="random", goals="random")]
    settings = {"camera": SMALL, "task": Task(max_steps=25), "draw_worlds": True}
    original = Simulator(worlds, 6, seed=2, **settings)
    generator = np.random.default_rng(6)
    original.reset()

    def advance(simulator, generator):
        transition = simulator.step(generator.integers(NUM_ACTIONS, size=6))
        return transition, simulator.reset(ended(transition))

    for _ in range(30):
        advance(original, generator)
    resumed = Simulator(worlds, 6, seed=77, **settings)
    resumed.load_state_dict(pickle.loads(pickle.dumps(original.state_dict())))
    np.testing.assert_array_equal(resumed.ideal_depth, original.ideal_depth)
    assert resumed.paths == original.paths
    twin = copy.deepcopy(generator)
    endings = 0
    for _ in range(60):
        one, other = advance(original, generator), advance(resumed, twin)
        for expected, got in zip((*one[0], *one[1]), (*other[0], *other[1]), strict=True):
            assert expected.tobytes() == got.tobytes()
        endings += ended(one[0]).sum()
    assert endings > 10


def test_a_state_of_another_number_of_robots_is_refused():
    state = Simulator(straight_world(), 2, camera=SMALL).state_dict()
    with pytest.raises(ValueError, match="holds 2 robots, but this simulator has 3"):
        Simulator(straight_world(), 3, camera=SMALL).load_state_dict(state)


def test_robots_are_at_home_in_their_worlds():
    worlds = [straight_world(start=(x, 0.0)) for x in (-1.0, 0.0, 1.0)]
    simulator = Simulator(worlds, 5, camera=SMALL)
    for _ in range(2):
        np.testing.assert_allclose(simulator.reset().pose[:, 0], [-1, 0, 1, -1, 0])
        np.testing.assert_array_equal(simulator.world_index, [0, 1, 2, 0, 1])


def test_drawn_worlds_are_drawn_evenly():
    worlds = [straight_world(start=(x, 0.0)) for x in (-1.0, 0.0, 1.0)]
    simulator = Simulator(worlds, 10, camera=SMALL, seed=0, draw_worlds=True)
    counts = np.zeros(3)
    for _ in range(60):
        simulator.reset()
        np.testing.assert_allclose(simulator.poses[:, 0], simulator.world_index - 1.0)
        counts += np.bincount(simulator.world_index, minlength=3)
    assert abs(counts - 200).max() < 50  # 4.3 standard deviations


def test_paths_fix_start_goal_and_world():
    worlds = [cluttered_world(0), cluttered_world(1)]
    simulator = Simulator(worlds, 3, camera=SMALL, seed=0)
    paths = [Path(2, 1, 1), Path(0, 3, 0), Path(3, 0, 1)]
    simulator.reset(paths=paths)
    assert list(simulator.paths) == paths
    for number, path in enumerate(paths):
        world = worlds[path.world_index]
        np.testing.assert_array_equal(simulator.poses[number, :2], world.starts[path.start_index].at)
        np.testing.assert_array_equal(simulator.goals[number], world.goals[path.goal_index].at)
    simulator.reset(np.array([False, True, False]), paths=[None, Path(1, 1, 0), None])
    assert list(simulator.paths) == [paths[0], Path(1, 1, 0), paths[2]]


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ([Path(0, 0)], "one path a robot, 2 in all; got 1"),
        ([Path(0, 0, 1), None], "is in world 1, but the worlds are 0 to 0"),
        ([Path(5, 0), None], "no start 5"),
    ],
)
def test_paths_that_do_not_exist_are_refused(paths, message):
    with pytest.raises(ValueError, match=message):
        Simulator(straight_world(), 2, camera=SMALL).reset(paths=paths)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.array([0]), r"shape \(2,\)"),
        (np.array([0.0, 1.0]), "integers"),
        (np.array([0, 7]), "between 0 and 6; got 7"),
        (np.array([-1, 0]), "got -1"),
    ],
)
def test_actions_that_do_not_exist_are_refused(actions, message):
    simulator = Simulator(straight_world(), 2, camera=SMALL)
    simulator.reset()
    with pytest.raises(ValueError, match=message):
        simulator.step(actions)


@pytest.mark.parametrize("mask", [np.array([True]), np.array([0, 1])])
def test_masks_that_are_none_are_refused(mask):
    simulator = Simulator(straight_world(), 2, camera=SMALL)
    with pytest.raises(ValueError, match="reset mask must be bool"):
        simulator.reset(mask)
    simulator.reset()
    with pytest.raises(ValueError, match="step mask must be bool"):
        simulator.step(np.ones(2, dtype=np.int64), mask)


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="at least one world"):
        Simulator([])
    with pytest.raises(ValueError, match="num_robots = 0"):
        Simulator(straight_world(), 0)
    with pytest.raises(ValueError, match="sees the floor"):
        Simulator(straight_world(), camera=DepthCamera(mount_z=0.1))


def test_what_a_step_returns_is_not_changed_by_the_next():
    simulator = Simulator(cluttered_world(0), 2, camera=SMALL, seed=0)
    observation = simulator.reset()
    transition = simulator.step(np.array([1, 1]))
    kept = [part.copy() for part in (*observation, *transition)]
    simulator.step(np.array([2, 2]))
    simulator.reset()
    for part, copied in zip((*observation, *transition), kept, strict=True):
        np.testing.assert_array_equal(part, copied)


@pytest.fixture
def driven(monkeypatch):
    """Four robots driven at random through twelve rooms, of which so many keep their spaces, and where they came."""
    worlds = [
        world.model_copy(update={"starts": "random", "goals": "random"})
        for world in worlds_from("generate:clutter,count=12,seed=4")
    ]

    def drive(most_spaces: int) -> tuple[Simulator, list[np.ndarray]]:
        monkeypatch.setattr("navsim.physics._MOST_SPACES", most_spaces)
        simulator = Simulator(worlds, 4, camera=DepthCamera(width=14, height=10), seed=0, draw_worlds=True)
        simulator.reset()
        generator, poses = np.random.default_rng(0), []
        for _ in range(400):
            moved = simulator.step(generator.integers(0, 7, 4))
            poses.append(simulator.poses.copy())
            simulator.reset(moved.terminated | moved.truncated)
        return simulator, poses

    return drive


def test_spaces_of_many_worlds_are_let_go_and_made_anew_alike(driven):
    """A space's memory only grows, so that of a thousand worlds would go on growing for hours of training."""
    (few, poses), (all_kept, expected) = driven(2), driven(100)
    assert len(few._physics._spaces) == 2
    assert len(all_kept._physics._spaces) > 6
    np.testing.assert_array_equal(poses, expected)


def test_spaces_and_bodies_are_freed_with_the_last_reference_to_them(driven):
    """Not when Python's garbage collector comes round: the longer a training, the more of them would wait for it."""

    def of_pymunk() -> list[type]:
        return [type(one) for one in gc.get_objects() if isinstance(one, pymunk.Space | pymunk.Body | pymunk.Shape)]

    gc.collect()
    before = len(of_pymunk())
    gc.disable()
    try:
        simulator, _ = driven(2)
        assert of_pymunk().count(pymunk.Space) == 2
        del simulator
        assert len(of_pymunk()) == before
    finally:
        gc.enable()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_collides_like_what_it_is_a_copy_of(copied):
    box = {"box": {"at": [1.2, 0.0], "size": [0.2, 2.0], "height": 1.0}}
    can = {"cylinder": {"at": [-1.0, 1.0], "radius": 0.1, "height": 0.3, "pushable": {"mass": 1.0}}}
    world = straight_world(box, can, start=(0.0, 0.0), goal=(3.0, 0.0))
    one = Simulator(world, camera=SMALL, task=Task(collision_depth=0.0), seed=0)
    one.reset()
    while not one.step(np.array([FASTER])).collision[0]:  # now there is a space of Chipmunk's
        pass
    one.reset()
    other = copied(one)
    for _ in range(20):
        ours, theirs = one.step(np.array([FASTER])), other.step(np.array([FASTER]))
        np.testing.assert_array_equal(one.poses, other.poses)
        for value, another in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(value, another)
        if ours.collision[0]:
            return
    pytest.fail("it has driven through the box")


def test_a_reset_that_is_refused_changes_nothing():
    worlds = [cluttered_world(0), cluttered_world(1), make_world(size=(0.46, 1.2), starts="random", goals="random")]
    simulator = Simulator(worlds, 3, camera=SMALL, seed=0)
    good = [Path(0, 0, 0), Path(1, 1, 1), Path(0, 0, 0)]
    simulator.reset(paths=good)
    simulator.step(np.full(3, FASTER))
    before = simulator.state_dict()
    for paths, message in (
        ([Path(0, 0, 0), Path(99, 0, 1), Path(0, 0, 0)], "has no start 99"),
        ([None, None, Path(-1, -1, 2)], "has no room for an episode"),
        ([None, None, Path(0, 0, 9)], "is in world 9"),
    ):
        with pytest.raises(ValueError, match=message):
            simulator.reset(paths=paths)
        assert_same_state(before, simulator.state_dict())


def assert_same_state(one, other):
    for key, value in one.items():
        if isinstance(value, dict):
            assert_same_state(value, other[key])
        else:
            np.testing.assert_array_equal(value, other[key])


def test_a_state_of_other_settings_changes_nothing():
    def walkers(*heights):
        motion = {"path": [[-2.0, 2.0], [2.0, 2.0]], "speed": 0.5}
        people = [{"cylinder": {"at": [-2.0, 2.0], "radius": 0.2, "height": h, "motion": motion}} for h in heights]
        return straight_world(*people)

    state = Simulator(walkers(1.7), camera=SMALL, seed=1).state_dict()
    three = Simulator(walkers(1.5, 1.6, 1.7), camera=SMALL, seed=0)
    late = Simulator(walkers(1.7), camera=SMALL, sensor=SensorModel(latency=2), seed=0)
    for simulator, wrong in ((three, "robots are in other worlds"), (late, "sensor.images is of shape")):
        simulator.reset()
        before = simulator.state_dict()
        with pytest.raises(ValueError, match=f"the state's {wrong}"):
            simulator.load_state_dict(state)
        assert_same_state(before, simulator.state_dict())


def test_paths_are_taken_as_worlds_list_them_and_names_of_worlds_are_not():
    world = cluttered_world(0)
    simulator = Simulator(world, camera=SMALL, seed=0)
    simulator.reset(paths=[world.paths[3]])
    assert simulator.paths == (Path(*world.paths[3]),)
    with pytest.raises(TypeError, match=r"load_world\('complex_eval'\) reads one"):
        Simulator("complex_eval")


def test_a_tilted_camera_may_look_at_nothing_before_it_starts():
    task = Task(collision_depth=0.0, start_view=0.0)
    simulator = Simulator(cluttered_world(0), camera=DepthCamera(width=20, height=16, pitch_deg=5.0), task=task, seed=0)
    assert simulator.reset().depth.any()


def test_a_state_of_more_worlds_is_refused_and_changes_nothing():
    several = Simulator([straight_world()] * 3, 3, camera=SMALL, seed=0)
    several.reset()
    one = Simulator(straight_world(), 3, camera=SMALL, seed=1)
    one.reset()
    before = pickle.dumps(one.state_dict())
    with pytest.raises(ValueError, match="the state's robots are in 3 worlds or more, and this simulator has 1"):
        one.load_state_dict(several.state_dict())
    assert pickle.dumps(one.state_dict()) == before


def test_a_state_of_other_worlds_is_refused_and_changes_nothing():
    there = Simulator([cluttered_world(0), cluttered_world(1)], 2, camera=SMALL, seed=0)
    there.reset()
    for worlds in ([cluttered_world(2)] * 2, [cluttered_world(1), cluttered_world(0)]):
        here = Simulator(worlds, 2, camera=SMALL, seed=1)
        here.reset()
        before = pickle.dumps(here.state_dict())
        with pytest.raises(ValueError, match="in other worlds than this simulator's"):
            here.load_state_dict(there.state_dict())
        assert pickle.dumps(here.state_dict()) == before
    alike = [cluttered_world(number).model_copy(update={"name": "other"}) for number in (0, 1)]
    Simulator(alike, 2, camera=SMALL, seed=1).load_state_dict(there.state_dict())


def test_a_state_from_before_worlds_were_told_apart_is_taken():
    simulator = Simulator(cluttered_world(0), 2, camera=SMALL, seed=0)
    simulator.reset()
    old = simulator.state_dict()
    del old["worlds"]
    resumed = Simulator(cluttered_world(0), 2, camera=SMALL, seed=1)
    resumed.load_state_dict(old)
    assert_same_state(resumed.state_dict(), simulator.state_dict())


def test_names_of_worlds_are_no_worlds():
    with pytest.raises(TypeError, match="a simulator takes worlds, not 'complex_train': load_world reads one"):
        Simulator([straight_world(), "complex_train"])


def test_a_substep_in_which_the_robot_could_pass_a_wall_is_refused():
    with pytest.raises(ValueError, match=r"the physics substep must be at most 0.27 s, .*; got 1 s"):
        Simulator(straight_world(), task=Task(control_period=1.0, substep=1.0))
    wall = {"box": {"at": [0.0, 0.0], "size": [0.01, 4.0], "height": 1.0}}
    task = Task(control_period=1.0, substep=0.27, collision_depth=0.0)
    simulator = Simulator(straight_world(wall, start=(-1.03, 0.0)), camera=SMALL, task=task)
    simulator.reset()
    bumped = [bool(simulator.step(np.array([FASTER])).bumper[0])]
    while not bumped[-1]:
        bumped.append(bool(simulator.step(np.array([FASTER])).bumper[0]))
    assert simulator.poses[0, 0] < 0.0
