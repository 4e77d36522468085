"""The settings of a run: presets, checks, and the way to JSON and back."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.sensor import KINECT
from rl.config import (
    DEFAULT_PRESET,
    PRESETS,
    Collection,
    ConfigError,
    Experiment,
    Exploration,
    Learning,
    Records,
    TrainConfig,
)


def test_thesis_preset_holds_the_numbers_of_section_5_3():
    thesis = PRESETS["thesis"]
    assert (thesis.gamma, thesis.n_step, thesis.batch_size, thesis.replay_capacity) == (0.99, 1, 8, 50_000)
    assert (thesis.epsilon_start, thesis.epsilon_end, thesis.epsilon_steps) == (1.0, 0.01, 50_000)
    assert (thesis.learning_rate, thesis.learning_rate_decay, thesis.loss_function) == (1e-4, "none", "l2")
    assert (thesis.target_update, thesis.tau, thesis.steps_per_update) == ("soft", 0.001, 1.0)
    assert thesis.total_steps == 400_000
    assert (thesis.inputs, thesis.depth_scale, thesis.frame_interval) == (("depth", "heading"), "linear", 1)
    assert (thesis.heading_init, thesis.symmetric) == ("glorot", False)
    assert (thesis.mirror, thesis.prioritized, thesis.random_paths) == (False, False, False)


def test_fast_is_the_default_and_sees_more_and_learns_shorter_than_memoryless():
    fast, memoryless = PRESETS[DEFAULT_PRESET], PRESETS["memoryless"]
    assert fast.preset == "fast"
    assert (fast.inputs, fast.depth_scale) == (("depth", "heading", "command", "surroundings"), "inverse")
    assert (memoryless.inputs, memoryless.depth_scale) == (("depth", "heading"), "linear")
    different = {name for name, value in fast.to_dict().items() if value != memoryless.to_dict()[name]}
    assert different == {
        *("preset", "inputs", "depth_scale", "symmetric", "n_step", "steps_per_update"),
        *("total_steps", "epsilon_end", "epsilon_steps", "eval_interval", "checkpoint_interval"),
    }
    updates = [config.total_steps / config.steps_per_update for config in (fast, memoryless)]
    assert updates == [12_500, 25_000]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_bears_its_own_name(name):
    assert PRESETS[name].preset == name


@pytest.mark.parametrize(
    "config",
    [
        *PRESETS.values(),
        TrainConfig(
            model="S",
            world=("a.yaml", "b.yaml"),
            out=Path("somewhere"),
            max_grad_norm=None,
            camera=DepthCamera(width=160, height=128, depth="range", pitch_deg=5.0),
            sensor=replace(KINECT, latency=2),
            randomization=Randomization(camera_pitch_deg=(-2.0, 2.0), latency=(0, 1), noise_level=(0.5, 1.5)),
        ),
    ],
    ids=[*PRESETS, "others"],
)
def test_settings_survive_json(config):
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_runs_from_before_there_was_a_margin_or_a_symmetric_policy_had_none():
    later = ("margin", "symmetric")
    written = {name: value for name, value in PRESETS["memoryless"].to_dict().items() if name not in later}
    assert PRESETS["memoryless"].margin > 0.0
    assert PRESETS["memoryless"].symmetric
    assert TrainConfig.from_dict(written) == replace(PRESETS["memoryless"], margin=0.0, symmetric=False)


def test_runs_whose_number_of_threads_was_left_open_have_the_default():
    written = PRESETS["fast"].to_dict() | {"num_threads": None}
    assert TrainConfig.from_dict(written) == PRESETS["fast"]


def test_every_setting_belongs_to_one_group_of_the_help():
    groups = [Experiment, Collection, Learning, Exploration, Records]
    grouped = [setting.name for group in groups for setting in dataclasses.fields(group)]
    assert len(grouped) == len(set(grouped))
    assert {setting.name for setting in dataclasses.fields(TrainConfig)} == {
        *grouped,
        "camera",
        "task",
        "robot",
        "sensor",
        "randomization",
    }


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"total_steps": 0}, "--total-steps must be positive"),
        ({"learning_rate": float("nan")}, "--learning-rate must be positive"),
        ({"gamma": 1.5}, "--gamma must lie between 0 and 1"),
        ({"seed": -1}, "--seed must lie between 0 and 4294967295; got -1"),
        ({"seed": 2**32}, "--seed must lie between 0 and 4294967295; got 4294967296"),
        ({"margin": -0.01}, "--margin must lie between 0 and 0.2 m; got -0.01"),
        ({"margin": 0.3}, "--margin must lie between 0 and 0.2 m; got 0.3"),
        ({"margin": math.nan}, "--margin must lie between 0 and 0.2 m; got nan"),
        (
            {"margin": 0.15, "camera": DepthCamera(pitch_deg=10.0)},
            "nearer than the task's collision_depth of 0.55 m",
        ),
        ({"world": ()}, "--world needs at least one"),
        ({"epsilon_start": 0.01, "epsilon_end": 0.02, "epsilon_least": None}, "--epsilon-end (0.02) must not exceed"),
        ({"epsilon_end": 0.1, "epsilon_least": 0.2}, "--epsilon-least (0.2) must lie between"),
        ({"loss_function": "categorical", "atoms": 1}, "--atoms must be at least 2"),
        ({"least_return": 1.0, "greatest_return": 1.0}, "--least-return (1.0) must be below"),
        ({"num_envs": 7, "steps_per_batch": 64}, "--steps-per-batch (64) must be a multiple of --num-envs (7)"),
        ({"batch_size": 60, "replay_capacity": 50}, "--batch-size (60) must not exceed --replay-capacity (50)"),
        ({"warmup_steps": 10, "batch_size": 64}, "--warmup-steps (10) must lie between --batch-size (64)"),
        (
            {"n_step": 12, "num_envs": 16, "steps_per_batch": 16, "warmup_steps": 143},
            "--warmup-steps (143) is too short: it takes more than --n-step (12) times --num-envs (16) transitions",
        ),
        (
            {"total_steps": 4_000, "warmup_steps": 5_000},
            "--total-steps (4000) must be at least --warmup-steps (5000) and --steps-per-update (16) together",
        ),
        ({"total_steps": 5_010}, "--total-steps (5010) must be at least --warmup-steps (5000) and --steps-per-update"),
        ({"steps_per_update": 1e9}, "nothing would be learnt"),
        ({"camera": DepthCamera(mount_y=0.1)}, "is not what this robot sees; add --no-mirror --no-symmetric"),
        (
            {"randomization": Randomization(camera_left=(0.0, 0.02)), "symmetric": False},
            "--randomization.camera-left (0.0 0.02) put the camera more to one side",
        ),
        (
            {"randomization": Randomization(camera_pitch_deg=(0.0, 40.0))},
            "randomization camera_height (0.0, 0.0) and camera_pitch_deg (0.0, 40.0) go too far: the camera sees",
        ),
        ({"randomization": Randomization(noise_level=(0.0, 2.0))}, "changes nothing without noise"),
        (
            {"randomization": Randomization(start_distance=(0.3, 0.5))},
            "move listed starts, and training draws starts anywhere; add --no-random-paths",
        ),
        ({"num_envs": 1, "epsilon_least": 0.001}, "and --num-envs is 1; set it to None"),
        ({"batch_size": 1}, "--mirror needs samples that can be halved, and --batch-size is 1"),
        ({"frame_interval": 0}, "--frame-interval must be positive"),
        (
            {"inputs": ()},
            "--inputs must be some of depth, heading, command, surroundings, depth or heading among them; got none",
        ),
        ({"inputs": ("command",)}, "depth or heading among them; got command"),
        ({"inputs": ("depth", "sonar")}, "--inputs must be some of depth, heading, command"),
        ({"max_grad_norm": -1.0}, "--max-grad-norm must be positive and finite, or None"),
        ({"max_grad_norm": float("inf")}, "--max-grad-norm must be positive and finite, or None"),
        ({"greatest_return": float("inf")}, "--greatest-return must be a finite number"),
        ({"least_return": float("-inf")}, "--least-return must be a finite number"),
    ],
)
def test_settings_that_cannot_work_are_refused_by_their_option(changes, named):
    with pytest.raises(ConfigError) as refusal:
        TrainConfig(**changes)
    assert named in str(refusal.value)


def test_a_camera_on_one_side_is_fine_without_mirror_images():
    sides = {"camera": DepthCamera(mount_y=0.1), "mirror": False, "symmetric": False}
    assert TrainConfig(**sides).camera.mount_y == 0.1
    assert TrainConfig(randomization=Randomization(camera_left=(-0.02, 0.02))).mirror


def test_all_problems_are_told_at_once():
    with pytest.raises(ConfigError) as refusal:
        TrainConfig(gamma=2.0, tau=-1.0, seed=-3)
    assert len(str(refusal.value).splitlines()) == 3


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"learning_rte": 1.0}, "learning_rte"),
        ({"camera": {"widht": 80}}, "camera"),
        ({"camera": {"width": -1}}, "width"),
        ({"sensor": {"axial_noise": -1}}, "settings of the sensor cannot be used: sensor axial_noise"),
        ({"randomization": {"latency": [2, 1]}}, "settings of the randomization cannot be used"),
        ({"gamma": 7}, "--gamma"),
        ({"model": "X"}, "--model must be one of I, S; got 'X'"),
        ({"heading_init": ["spread"]}, "--heading-init must be one of"),
        ({"warmup_steps": float("inf")}, "--warmup-steps must be a whole number; got inf"),
        ({"gamma": "high"}, "of another kind than its setting"),
        ({"world": 7}, "of another kind than its setting"),
    ],
)
def test_values_of_another_version_are_refused(values, named):
    with pytest.raises(ConfigError, match=named):
        TrainConfig.from_dict(values)


@pytest.mark.parametrize(
    ("settings", "directory"),
    [
        ({}, "runs/memoryless-I-seed0"),
        ({"model": "S", "seed": 3, "world": ("rooms/a.yaml", "b.yml")}, "runs/memoryless-S-a+b-seed3"),
        ({"world": ("generate:office, count=9",)}, "runs/memoryless-I-office,count=9-seed0"),
        ({"out": Path("elsewhere")}, "elsewhere"),
    ],
)
def test_a_run_is_kept_apart_from_runs_with_other_settings(settings, directory):
    assert TrainConfig(**settings).directory == Path(directory)


@pytest.mark.parametrize("setting", ["world", "eval_world"])
def test_generated_rooms_asked_for_wrongly_are_a_problem_of_the_settings(setting):
    value = "generate:clutter,densty=0.3"
    with pytest.raises(ConfigError, match='"densty" is not a setting of generated rooms; did you mean "density"'):
        TrainConfig(**{setting: (value,) if setting == "world" else value})


def test_generated_rooms_may_be_trained_in_on_their_listed_paths():
    config = TrainConfig(world=("generate:clutter,density=0.11,count=200",), random_paths=False)
    assert config.directory.name == "memoryless-I-clutter,density=0.11,count=200-seed0"
