"""Filming one drive of a policy."""

from __future__ import annotations

import dataclasses

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from small_runs import HALL
from tensordict.nn import TensorDictModule

import rl.drive
from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.sensor import SensorModel
from navsim.task import Task
from navsim.worldfile import load_world
from navsim.worldsource import world_from
from rl.cli import main
from rl.config import TrainConfig
from rl.drive import drive
from rl.evaluation import evaluate
from rl.learner import make_actor
from rl.policies import load_policy
from rl.run import Run
from rl.surroundings import Surroundings


@pytest.fixture
def run(tmp_path):
    torch.manual_seed(0)
    inputs = ("depth", "heading", "command", "surroundings")
    run = Run.create(TrainConfig(inputs=inputs, camera=DepthCamera(width=14, height=10), out=tmp_path / "run"))
    run.save_policy("policy", make_actor(run.config).state_dict())
    return run


@pytest.fixture
def filmed(monkeypatch):
    """What is given to the animation, which is tested where it is."""
    given = {}

    def note(path, world, poses, goal, **settings):
        given.update(settings, path=path, world=world, poses=poses, goal=goal)
        return path

    monkeypatch.setattr(rl.drive, "animate_episode", note)
    return given


def test_the_q_values_shown_are_those_that_were_acted_on(run, filmed, tmp_path):
    result = drive(str(run.directory), "simple_eval", tmp_path / "a.mp4")
    assert filmed["q_values"].shape == (result.steps, 7)
    assert (filmed["q_values"].argmax(axis=1) == result.actions).all()
    assert (filmed["actions"] == result.actions).all()


def test_what_is_shown_as_remembered_is_what_the_robot_was_told(run, filmed, tmp_path):
    result = drive(str(run.directory), "simple_eval", tmp_path / "a.mp4", start=1)
    remembered = filmed["remembered"]
    assert remembered.shape == (result.steps, 36)
    near = np.isfinite(remembered)
    assert near.any()
    assert not near.all()
    assert remembered[near].max() < 2.0
    world = load_world("simple_eval")
    memory = Surroundings(1, run.config.camera)
    images = render_depth(world, result.trajectory[:-1], run.config.camera)
    depth = run.config.camera.to_uint8(run.config.camera.from_planar(images))
    memory.begin(depth[:1], result.trajectory[:1])
    for step in range(1, result.steps):
        memory.see(depth[step : step + 1], result.trajectory[step : step + 1])
    last = memory.nearest(result.trajectory[result.steps - 1 : result.steps])[0]
    np.testing.assert_allclose(np.minimum(remembered[-1], 2.0), last, atol=1e-5)


def test_the_path_is_the_one_that_was_asked_for(filmed, tmp_path):
    world = load_world("simple_eval")
    result = drive("straight", "simple_eval", tmp_path / "a.gif", start=2, goal=3)
    np.testing.assert_allclose(result.trajectory[0, :2], world.starts[2].at)
    assert result.goal == world.goals[3].at
    assert "q_values" not in filmed
    assert "remembered" not in filmed


def test_by_default_it_drives_from_the_first_start_to_the_goal_farthest_from_it(filmed, tmp_path):
    world = load_world("simple_eval")
    result = drive("straight", "simple_eval", tmp_path / "a.gif")
    np.testing.assert_allclose(result.trajectory[0, :2], world.starts[0].at)
    offsets = np.subtract([goal.at for goal in world.goals], world.starts[0].at)
    assert np.hypot(*np.subtract(result.goal, world.starts[0].at)) == pytest.approx(np.hypot(*offsets.T).max())


def images_of(world, poses, camera):
    return camera.to_uint8(camera.from_planar(render_depth(world, poses, camera)))


@pytest.fixture
def late(tmp_path):
    """A run whose images come two steps late."""
    late = SensorModel(latency=2)
    run = Run.create(TrainConfig(camera=DepthCamera(width=14, height=10), sensor=late, out=tmp_path / "late"))
    torch.manual_seed(0)
    run.save_policy("policy", make_actor(run.config).state_dict())
    return run


def test_the_images_shown_are_those_that_the_robot_saw(late, filmed, tmp_path):
    result = drive(str(late.directory), "simple_eval", tmp_path / "a.gif")
    at = np.maximum(np.arange(result.steps) - 2, 0)
    expected = images_of(load_world("simple_eval"), result.trajectory[at], late.config.camera)
    np.testing.assert_array_equal(filmed["images"], expected)


def test_ideal_images_are_shown_to_who_asks_for_them(late, filmed, tmp_path):
    result = drive(str(late.directory), "simple_eval", tmp_path / "a.gif", sensor=SensorModel())
    expected = images_of(load_world("simple_eval"), result.trajectory[:-1], late.config.camera)
    np.testing.assert_array_equal(filmed["images"], expected)


def test_it_drives_by_the_weights_and_the_symmetry_that_are_asked_for(run, filmed, tmp_path):
    torch.manual_seed(7)
    run.save_policy("policy_last", make_actor(run.config).state_dict())
    film = str(tmp_path / "a.mp4")
    arguments = ["drive", str(run.directory), "--world", str(HALL), "--goal", "0", "-o", film]
    assert main([*arguments, "--weights", "last", "--symmetric", "yes"]) == 0
    asked = filmed["q_values"]
    expected = Values(load_policy(run.directory, weights="last", symmetric=True))
    evaluate(expected, str(HALL), camera=run.config.camera, num_paths=1)
    np.testing.assert_allclose(asked, torch.stack(expected.values))
    assert main(arguments) == 0
    assert not np.allclose(filmed["q_values"][0], asked[0])


def test_a_policy_of_ones_own_is_filmed(filmed, tmp_path):
    class Slow(torch.nn.Module):
        def forward(self, state):
            assert not self.training
            return state.set("action", torch.zeros(state.batch_size, dtype=torch.int64))

    policy = Slow().eval()
    result = drive(policy, "simple_eval", tmp_path / "a.mp4")
    assert not policy.training
    assert set(result.actions.tolist()) == {0}
    assert filmed["images"].shape == (result.steps, 64, 80)
    assert "q_values" not in filmed


class Values:
    """A policy that keeps its values."""

    def __init__(self, policy):
        self.policy, self.in_keys, self.values = policy, policy.in_keys, []

    def __call__(self, state):
        state = self.policy(state)
        self.values.append(state["action_value"][0].clone())
        return state


def test_it_drives_in_a_generated_room(filmed, tmp_path):
    drive("straight", "generate:clutter,density=0.05,seed=3", tmp_path / "a.gif")
    assert filmed["world"] == world_from("generate:clutter,density=0.05,seed=3")


def test_a_drive_makes_a_film(run, tmp_path, capsys):
    film = tmp_path / "drive.gif"
    assert main(["drive", str(run.directory), "--world", str(HALL), "-o", str(film)]) == 0
    assert str(film) in capsys.readouterr().out
    assert imageio.imread(film).shape[1:] == (520, 960, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["oracle", "--world", "simple_eval", "-o", "a.avi"], r"a.avi: animations are written as .gif or .mp4"),
        (["oracle", "--world", "simple_eval", "--speed", "0"], "speed must lie between 0.01 and 100; got 0"),
        (["oracle", "--world", "simple_eval", "--speed", "1e9"], "speed must lie between 0.01 and 100; got 1e+09"),
        (["oracle", "--world", "simple_eval", "--speed", "nan"], "speed must lie between 0.01 and 100; got nan"),
        (["oracle", "--world", "simple_eval", "--seed", "-1"], "seed must lie between 0 and 4294967295; got -1"),
        (["oracle", "--world", "simple_eval", "--start", "9"], 'world "simple_eval" has starts 0 to 4; --start asks'),
        (["pretrained:nonsense", "--world", "simple_eval"], 'no policy "pretrained:nonsense"'),
        (["oracle", "--world", "generate:clutter,count=2"], "one world is wanted here, not 2; leave count out"),
        (["oracel", "--world", "simple_eval"], 'did you mean "oracle"?'),
    ],
)
def test_a_mistake_is_told_in_a_sentence(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["drive", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_action_values_of_another_shape_are_not_shown(filmed, tmp_path):
    def policy(state):
        state["action_value"] = torch.rand(*state.batch_size, 11, 7)  # as TorchRL's DistributionalQValueActor writes
        return state.set("action", torch.zeros(state.batch_size, dtype=torch.int64))

    drive(policy, "simple_eval", tmp_path / "a.mp4")
    assert "q_values" not in filmed
    assert "images" in filmed


def test_a_policy_that_returns_only_its_action_is_filmed(filmed, tmp_path):
    module = TensorDictModule(
        lambda heading: torch.zeros(heading.shape[:-1], dtype=torch.int64),
        in_keys=["heading"],
        out_keys=["action"],
        inplace="empty",
    )
    result = drive(module, "simple_eval", tmp_path / "a.mp4")
    assert filmed["images"].shape == (result.steps, 64, 80)


def test_a_wrapped_policy_a_function_of_actions_and_any_kind_of_name_are_taken(run, filmed, tmp_path):
    world, output = load_world("simple_eval"), str(tmp_path / "a.mp4")
    policy = load_policy(run.directory)
    policy.trained_as = dataclasses.replace(policy.trained_as, task=Task(max_steps=15))
    own = drive(policy, world, output)
    wrapped = drive(torch.optim.swa_utils.AveragedModel(policy), world, output)
    np.testing.assert_array_equal(own.trajectory, wrapped.trajectory)
    assert filmed["remembered"].shape[0] == own.steps
    result = drive(lambda state: torch.ones(len(state), dtype=torch.int64), world, output)
    assert (result.actions == 1).all()
