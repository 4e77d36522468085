"""``NavEnv``: specs, stacks of images, partial resets, seeds, and what TorchRL does with it."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, EnvCreator, SerialEnv
from torchrl.envs.utils import check_env_specs

from navsim import World, load_world
from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.robot import INITIAL_COMMAND
from navsim.sensor import KINECT
from navsim.simulator import Simulator
from navsim.task import Path, Task
from rl.env import NavEnv
from rl.observation import NUM_FRAMES

CAMERA = DepthCamera(width=20, height=12)
CORRIDOR = World.from_dict({"format": 1, "size": [8, 4], "starts": [{"at": [-3, 0], "yaw_deg": 0}], "goals": [[3, 0]]})


def act(env: NavEnv, state, actions):
    """One step with these actions; the state after it."""
    state["action"] = torch.as_tensor(actions)
    return env.step(state)


def through_a_file(state):
    file = io.BytesIO()
    torch.save(state, file)
    return torch.load(io.BytesIO(file.getvalue()))  # which executes nothing


@pytest.mark.parametrize(("world", "num_envs"), [("complex_train", 1), ("complex_train", 5), ("crowded", 3)])
def test_specs_hold(world, num_envs):
    env = NavEnv(world, num_envs, camera=CAMERA, seed=0)
    check_env_specs(env, seed=0)
    assert env.batch_size == (num_envs,)
    assert env.observation_spec["depth"].shape == (num_envs, NUM_FRAMES, 12, 20)
    assert env.observation_spec["depth"].dtype == torch.uint8
    assert env.action_spec.n == 7
    assert env.action_spec.shape == (num_envs,)


def test_a_noisy_randomised_environment_keeps_its_specs_and_resumes():
    settings = {
        "camera": CAMERA,
        "sensor": replace(KINECT, latency=1),
        "randomization": Randomization(camera_height=(-0.02, 0.05), camera_pitch_deg=(-2.0, 5.0), latency=(0, 2)),
    }
    check_env_specs(NavEnv("complex_train", 3, seed=0, **settings), seed=0)
    original, resumed = (NavEnv("complex_train", 3, seed=seed, **settings) for seed in (1, 2))
    state = original.rollout(5, break_when_any_done=False)[:, -1]["next"]
    resumed.reset()
    resumed.load_state_dict(through_a_file(original.state_dict()))
    for actions in ([1, 2, 3], [4, 4, 4]):
        one, other = act(original, state.clone(), actions)["next"], act(resumed, state.clone(), actions)["next"]
        torch.testing.assert_close(one["depth"], other["depth"], rtol=0, atol=0)
        state = one


def test_the_default_image_is_80_by_64():
    assert NavEnv(CORRIDOR, 2).reset()["depth"].shape == (2, 4, 64, 80)


@pytest.mark.parametrize("interval", [1, 3])
def test_a_step_brings_what_the_simulator_brings(interval):
    env = NavEnv("complex_train", 4, camera=CAMERA, frame_interval=interval, seed=3)
    simulator = Simulator(load_world("complex_train"), 4, camera=CAMERA, seed=3)
    state, seen = env.reset(), simulator.reset()
    np.testing.assert_array_equal(state["depth"], np.repeat(seen.depth[:, None], NUM_FRAMES, axis=1))
    np.testing.assert_allclose(state["command"], np.tile(INITIAL_COMMAND, (4, 1)))
    images = [seen.depth] * (3 * interval + 1)
    generator = np.random.default_rng(0)
    for _ in range(12):
        actions = generator.integers(0, 7, 4)
        state, moved = act(env, state, actions)["next"], simulator.step(actions)
        images.append(moved.depth)
        np.testing.assert_array_equal(state["depth"], np.stack(images[-1 - 3 * interval :: interval], axis=1))
        np.testing.assert_allclose(state["command"], simulator.commands, rtol=1e-6)
        np.testing.assert_array_equal(state["heading"][:, 0], moved.heading)
        np.testing.assert_array_equal(state["pose"], moved.pose)
        for key in ("reward", "terminated", "truncated", "success", "collision", "bumper", "too_near"):
            np.testing.assert_array_equal(state[key][:, 0], getattr(moved, key))
        done = moved.terminated | moved.truncated
        np.testing.assert_array_equal(state["done"][:, 0], done)
        if done.any():
            break


@pytest.mark.parametrize(("collision_depth", "bumper"), [(0.4, False), (0.0, True)])
def test_the_bumper_and_the_depth_rule_are_told_apart(collision_depth, bumper):
    world = CORRIDOR.model_copy(update={"goals": (CORRIDOR.goals[0].model_copy(update={"at": (3.0, 1.5)}),)})
    env = NavEnv(world, 1, camera=CAMERA, task=Task(collision_depth=collision_depth), seed=0)
    state = env.reset()
    assert not (state["bumper"] | state["too_near"]).any()
    while not state["done"].any():
        state = act(env, state, [1])["next"]
        assert state["bumper"].shape == state["too_near"].shape == (1, 1)
    assert state["collision"].item()
    assert (state["bumper"].item(), state["too_near"].item()) == (bumper, not bumper)


def test_only_the_robots_named_in_reset_begin_anew():
    env = NavEnv(CORRIDOR, 3, camera=CAMERA, seed=0)
    state = env.reset()
    for _ in range(3):
        state = act(env, state, [2, 2, 2])["next"]  # turning, so that the picture changes
    before = {key: state[key].clone() for key in ("depth", "pose", "heading")}
    state["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(state)
    for key, value in before.items():
        assert (after[key][[0, 2]] == value[[0, 2]]).all()
    assert after["pose"][1, 0] == -3.0
    assert (after["depth"][1] == after["depth"][1, :1]).all(), "the first image of an episode is repeated"
    assert not (before["depth"][0] == before["depth"][0, :1]).all(), "the robots that drive on keep their history"


def test_tensors_handed_out_do_not_change_later():
    env = NavEnv(CORRIDOR, 2, camera=CAMERA, seed=0)
    first = env.reset()
    kept, copy = first["depth"], first["depth"].clone()
    second = act(env, first, [1, 1])["next"]
    second_copy = second["depth"].clone()
    env.reset()
    assert (kept == copy).all()
    assert (second["depth"] == second_copy).all()


def drive_fast(tensordict):
    return tensordict.set("action", torch.tensor([1]))


def test_the_goal_terminates():
    end = NavEnv(CORRIDOR, 1, camera=CAMERA, seed=0).rollout(200, policy=drive_fast)[:, -1]["next"]
    assert end["success"].item()
    assert end["terminated"].item()
    assert end["done"].item()
    assert not end["truncated"].item()
    assert end["reward"].item() == 1.0


def test_the_time_limit_truncates():
    driven = NavEnv(CORRIDOR, 1, camera=CAMERA, task=Task(max_steps=7), seed=0).rollout(200, policy=drive_fast)
    assert driven.shape[1] == 7
    assert driven[:, -1]["next", "truncated"].item()
    assert driven[:, -1]["next", "done"].item()
    assert not driven[:, -1]["next", "terminated"].item()


def test_same_seed_same_rollout_and_another_seed_another():
    def rollout(seed):
        env = NavEnv("complex_train", 3, camera=CAMERA)
        env.set_seed(seed)
        torch.manual_seed(0)
        return env.rollout(40, break_when_any_done=False)

    first, again, other = rollout(5), rollout(5), rollout(6)
    assert (first == again).all()
    assert not (first["pose"] == other["pose"]).all()


def test_several_worlds_are_drawn_from():
    narrow = World.from_dict({"format": 1, "size": [3, 3], "starts": [[-1, 0]], "goals": [[1, 0]]})
    env = NavEnv([CORRIDOR, narrow], 32, camera=CAMERA, seed=0)
    assert set(env.reset()["pose"][:, 0].tolist()) == {-3.0, -1.0}


def test_it_goes_on_from_its_state_bit_for_bit():
    def drive(env, state, steps):
        torch.manual_seed(1)
        return env.rollout(steps, auto_reset=False, tensordict=state, break_when_any_done=False)

    env = NavEnv("complex_train", 4, camera=CAMERA, surroundings=True, seed=2)
    state = env.rollout(30, break_when_any_done=False)[:, -1]["next"].exclude("reward")
    state["_reset"] = state["done"].clone()
    state = env.reset(state)
    kept = through_a_file(env.state_dict())
    expected = drive(env, state.clone(), 30)
    fresh = NavEnv("complex_train", 4, camera=CAMERA, surroundings=True, seed=99)
    fresh.reset()
    fresh.load_state_dict(kept)
    assert (drive(fresh, state.clone(), 30) == expected).all()


def test_a_world_that_does_not_exist_is_told():
    with pytest.raises(ValueError, match="complex_trian"):
        NavEnv("complex_trian")


def test_new_episodes_begin_as_torchrl_begins_them():
    """``maybe_reset`` takes a shorter way than ``EnvBase``'s; what comes out must be the same."""
    task = Task(max_steps=3)
    shorter, longer = (NavEnv("complex_train", 5, task=task, seed=0) for _ in range(2))
    before, expected = shorter.reset(), longer.reset()
    generator = torch.Generator().manual_seed(0)
    resets = 0
    for _ in range(12):
        action = torch.randint(7, (5,), generator=generator)
        for data in (before, expected):
            data.set("action", action)
            data.set(("collector", "traj_ids"), torch.arange(5))
        after = shorter.step(before)
        resets += int(after["next", "done"].sum())
        before = shorter.maybe_reset(shorter._step_mdp(after))
        expected = EnvBase.maybe_reset(longer, longer._step_mdp(longer.step(expected)))
        assert set(before.keys(True, True)) == set(expected.keys(True, True))
        assert (before == expected).all()
    assert resets >= 15


LINES = World.from_dict(
    {
        "format": 1,
        "size": [8, 4],
        "starts": [{"at": [-3, 0], "yaw_deg": 0}, {"at": [1, 0], "yaw_deg": 0}, {"at": [-1, 0.1], "yaw_deg": 0}],
        "goals": [[3, 0]],
    }
)


def test_a_rollout_until_all_have_arrived_drives_each_robot_as_it_would_drive_alone():
    def fast(tensordict):
        return tensordict.set("action", torch.ones(tensordict.shape, dtype=torch.int64))

    def rollout(*starts):
        env = NavEnv(LINES, len(starts), camera=CAMERA, surroundings=True, seed=0)
        state = env.reset(paths=[Path(start, 0) for start in starts])
        return env.rollout(
            200, fast, tensordict=state, auto_reset=False, break_when_all_done=True, break_when_any_done=False
        )

    together = rollout(0, 1, 2)
    lengths = []
    for robot in range(3):
        alone = rollout(robot)[0]
        lengths.append(len(alone))
        assert alone["next", "success"][-1].item()
        for key in ("depth", "heading", "pose", "surroundings", ("next", "reward"), ("next", "done")):
            assert (together[robot, : len(alone)][key] == alone[key]).all(), key
        assert together[robot]["next", "done"][len(alone) - 1 :].all()
    assert len(set(lengths)) == 3
    assert together.shape == (3, max(lengths))


def test_for_robots_that_a_step_leaves_out_no_time_passes():
    settings = {"camera": CAMERA, "surroundings": True, "sensor": replace(KINECT, latency=1), "seed": 3}
    randomization = Randomization(camera_pitch_deg=(0.0, 3.0), latency=(0, 2))
    env, other = (NavEnv("crowded", 3, randomization=randomization, **settings) for _ in range(2))
    state, expected = env.reset(), other.reset()
    slow = torch.zeros(3, dtype=torch.int64)
    for skips in (0, 2, 0, 1, 0):
        for _ in range(skips):
            before = state.clone()
            state["_step"] = torch.tensor([[True], [False], [True]])
            after = act(env, state, slow)["next"]
            for key in ("depth", "heading", "pose", "command", "surroundings", "done", "collision"):
                assert (after[key][1] == before[key][1]).all(), key
            assert after["reward"][1] == 0.0
            assert not (after["pose"][0] == before["pose"][0]).all()
            state = after
        state, expected = (act(one, seen, slow)["next"] for one, seen in ((env, state), (other, expected)))
        for key in ("depth", "heading", "pose", "command", "surroundings", "reward", "done"):
            assert (state[key][1] == expected[key][1]).all(), key


def test_episodes_are_those_that_reset_is_given():
    env = NavEnv(LINES, 2, camera=CAMERA, seed=0)
    state = env.reset(paths=[Path(1, 0), Path(2, 0)])
    torch.testing.assert_close(state["pose"][:, :2], torch.tensor([[1.0, 0.0], [-1.0, 0.1]]))
    assert (state["depth"][:, 0] == state["depth"][:, 3]).all()
    with pytest.raises(TypeError, match="path_s"):
        env.reset(path_s=[])


def test_torchrls_own_collector_goes_on_from_its_checkpoint():
    def collector():
        return Collector(NavEnv(LINES, 2, camera=CAMERA, seed=0), None, frames_per_batch=20, total_frames=80)

    first = collector()
    next(iter(first))
    second = collector()
    second.load_state_dict(first.state_dict(), strict=False)  # random actions have no weights
    assert sum(batch.numel() for batch in second) == 60


def test_whoever_writes_into_an_observation_changes_nothing_that_is_seen_later():
    untouched, scribbled = (NavEnv(CORRIDOR, 2, camera=CAMERA, seed=0) for _ in range(2))
    state, other = untouched.reset(), scribbled.reset()
    for _ in range(5):
        other["depth"].zero_()
        state, other = (act(env, one, [1, 1])["next"] for env, one in ((untouched, state), (scribbled, other)))
        assert torch.equal(state["depth"], other["depth"])


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"frame_interval": 3}, r"images are of shape \(2, 10, 12, 20\).* this environment's of \(2, 4, 12, 20\)"),
        ({"surroundings": True}, "the state holds a memory of the surroundings"),
    ],
)
def test_a_state_of_an_environment_with_other_settings_changes_nothing(settings, told):
    other = NavEnv("complex_train", 2, camera=CAMERA, seed=0, **settings)
    env = NavEnv("complex_train", 2, camera=CAMERA, seed=1)
    for one in (env, other):
        one.rollout(3, break_when_any_done=False)
    before = env.state_dict()
    with pytest.raises(ValueError, match=told):
        env.load_state_dict(other.state_dict())
    after = env.state_dict()
    assert torch.equal(before["frames"], after["frames"])
    assert torch.equal(before["simulator"]["physics"]["poses"], after["simulator"]["physics"]["poses"])


@pytest.mark.parametrize("surroundings", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_environments_of_torchrls_creator_drive_each_their_own_way(surroundings, shared):
    """It hands each of them parts of the state of one made to try it; ``ParallelEnv`` does so to lambdas."""
    creator = EnvCreator(
        lambda: NavEnv(World(size=(6, 6)), 2, camera=CAMERA, surroundings=surroundings), share_memory=shared
    )
    env = SerialEnv(2, creator)
    poses = env.reset()["pose"].reshape(-1, 3)
    assert len(poses.unique(dim=0)) == 4
    assert env.rollout(3).batch_size == torch.Size([2, 2, 3])
