"""A policy at the wheel of one robot takes the commands that it takes in an environment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import rl
from navsim.camera import DepthCamera
from navsim.holes import fill_holes
from navsim.robot import NUM_ACTIONS, apply_actions
from navsim.sensor import KINECT, SensorModel
from navsim.simulator import Simulator
from navsim.worldfile import load_world
from rl.config import TrainConfig
from rl.env import NavEnv
from rl.learner import make_actor
from rl.pilot import Pilot
from rl.policies import load_policy
from rl.run import Run

INPUTS = ("depth", "heading", "command", "surroundings")


@pytest.mark.parametrize(
    "settings",
    [
        {"inputs": ("depth", "heading"), "model": "S"},
        {"inputs": INPUTS, "frame_interval": 3},
        {"inputs": INPUTS, "sensor": KINECT},
        {"inputs": INPUTS, "sensor": SensorModel(latency=2)},
    ],
    ids=["memoryless", "frames-apart", "lossy", "late"],
)
def test_commands_are_those_of_the_environment(tmp_path, settings):
    torch.manual_seed(3)
    run = Run.create(TrainConfig(camera=DepthCamera(width=20, height=14), out=tmp_path / "run", **settings))
    run.save_policy("policy", make_actor(run.config).state_dict())
    policy = load_policy(run.directory)
    pilot = Pilot(policy)
    env = NavEnv(
        "complex_train",
        1,
        camera=run.config.camera,
        sensor=run.config.sensor,
        frame_interval=run.config.frame_interval,
        surroundings=True,
        seed=0,
    )
    simulator, driven, commands = env.simulator, 0, set()
    state = env.reset()
    for _ in range(120):
        told = pilot.command(
            state["depth"][0, -1].numpy(), simulator.poses[0], simulator.goals[0], simulator.image_poses[0]
        )
        state = env.step(policy(state))["next"]
        assert told == tuple(simulator.commands[0].tolist())
        commands.add(told)
        driven += 1
        if state["done"].item():
            state = env.reset()
            pilot.begin()
    assert pilot.period == 0.2
    assert len(commands) > 1
    assert driven > 60


def test_it_reaches_a_goal_from_images_in_metres():
    world = load_world("simple_eval")
    pilot = Pilot(rl.load_policy("pretrained:I"))
    simulator = Simulator(world, camera=pilot.camera, seed=0)
    simulator.reset()
    for _ in range(500):
        metres = simulator.ideal_depth[0].copy()
        metres[metres >= pilot.camera.max_range] = np.inf
        metres[metres < pilot.camera.blind_zone] = np.nan
        command = pilot.command(metres, simulator.poses[0], simulator.goals[0])
        moved = simulator.step(np.array([action_to(command, simulator.commands)]))
        if (moved.terminated | moved.truncated)[0]:
            break
    assert moved.success[0]


def action_to(command: tuple[float, float], before: np.ndarray) -> int:
    """The action that makes a command ``(1, 2)`` another one."""
    afterwards = apply_actions(before.repeat(NUM_ACTIONS, axis=0), np.arange(NUM_ACTIONS))
    return int(np.flatnonzero((afterwards == command).all(axis=1))[0])


def test_what_cannot_be_used_is_told():
    pilot = Pilot(rl.load_policy("pretrained:I-memoryless"))
    image = np.full((64, 80), 2.0)
    for arguments, message in (
        ((image.T, (0, 0, 0), (1, 1)), r"images of shape \(64, 80\); got \(80, 64\): resize them"),
        ((image.astype(np.uint16), (0, 0, 0), (1, 1)), "got uint16: divide millimetres by 1000"),
        ((1000 * image, (0, 0, 0), (1, 1)), "in metres, and in this one nothing is nearer than 2000: divide"),
        ((image, (0, 0), (1, 1)), r"pose must be 3 finite numbers; got \(0, 0\)"),
        ((image, (0, 0, 0), (np.nan, 1)), "goal must be 2 finite numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            pilot.command(*arguments)
    nothing_is_measured = np.where(image > 0, np.inf, np.nan)
    assert pilot.command(nothing_is_measured, (0, 0, 0), (1, 1))
    with pytest.raises(ValueError, match="a Pilot needs a policy that knows how it was trained"):
        Pilot(rl.make_q_actor("I"))


def test_what_it_remembers_does_not_depend_on_where_the_frame_begins():
    policy, seen = rl.load_policy("pretrained:I"), []
    policy.register_forward_pre_hook(lambda module, arguments: seen.append(arguments[0]["surroundings"].clone()))
    for origin in (np.zeros(3), np.array([5e5, 4.5e6, 0.0])):  # as in a map's frame (UTM)
        pilot = Pilot(policy)
        for step in range(6):
            pose, goal = np.array([0.08 * step, 0.0, 0.0]), np.array([3.0, 0.0])
            pilot.command(np.full((64, 80), 1.5), pose + origin, goal + origin[:2])
    np.testing.assert_allclose(torch.cat(seen[:6]), torch.cat(seen[6:]), atol=1e-5)
    assert torch.cat(seen).min() < 1.3


def test_holes_are_filled_for_policies_that_were_trained_without_any(tmp_path):
    policy, seen = rl.load_policy("pretrained:I"), []
    policy.register_forward_pre_hook(lambda module, arguments: seen.append(arguments[0]["depth"][0, -1].numpy()))
    camera = policy.trained_as.camera
    holes = np.random.default_rng(0).random((64, 80)) < 0.3
    image = np.where(holes, np.nan, 2.0)

    def shown(pilot, depth):
        pilot.begin()
        pilot.command(depth, (0, 0, 0), (3, 0))
        return seen[-1]

    as_it_is, filled = camera.to_uint8(image), camera.to_uint8(fill_holes(image, camera))
    assert (as_it_is == 0).sum() > 1000 > (filled == 0).sum()
    np.testing.assert_array_equal(shown(Pilot(policy), image), filled)
    np.testing.assert_array_equal(shown(Pilot(policy, fill=False), image), as_it_is)
    np.testing.assert_array_equal(shown(Pilot(policy), as_it_is), as_it_is)  # counts are what the network is to get

    for sensor, expected in ((KINECT, as_it_is), (replace(KINECT, filled=True), filled)):
        run = Run.create(TrainConfig(sensor=sensor, out=tmp_path / str(sensor.filled)))
        run.save_policy("policy", make_actor(run.config).state_dict())
        other = load_policy(run.directory)
        other.register_forward_pre_hook(lambda module, arguments: seen.append(arguments[0]["depth"][0, -1].numpy()))
        np.testing.assert_array_equal(shown(Pilot(other), image), expected)


def test_images_may_be_flipped_and_read_only():
    counts = np.random.default_rng(0).integers(0, 256, (64, 80), np.uint8)
    counts.flags.writeable = False
    commands = []
    for image in (counts[::-1, ::-1], counts[::-1, ::-1].copy()):
        pilot = Pilot(rl.load_policy("pretrained:I"))
        commands.append(pilot.command(image, (0, 0, 0), (3, 0)))
    assert commands[0] == commands[1]
