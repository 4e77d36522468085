"""In which format an update is faster is measured with the run's own updates."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console
from small_runs import HALL, small_config, tiny_config

from rl import number_format
from rl.env import NavEnv
from rl.learner import Learner
from rl.number_format import fastest_number_format, random_sample
from rl.train import train

CONFIG = tiny_config(Path("unused"), autocast="auto")


@pytest.fixture
def multiplies_faster_in_bfloat16(monkeypatch):
    monkeypatch.setattr(number_format, "fastest_autocast", lambda device: torch.bfloat16)


def with_times(monkeypatch, float32: Iterable[float], bfloat16: Iterable[float]) -> list[tuple[str, int, int]]:
    """A stopwatch that shows these seconds, again and again, and keeps what it has timed."""
    times, timed = {"float32": itertools.cycle(float32), "bfloat16": itertools.cycle(bfloat16)}, []

    def seconds(learner: Learner, sample: object, updates: int) -> float:
        timed.append((learner.config.autocast, len(sample), updates))  # type: ignore[arg-type]
        return next(times[learner.config.autocast])

    monkeypatch.setattr(number_format, "_seconds", seconds)
    return timed


@pytest.mark.usefixtures("multiplies_faster_in_bfloat16")
@pytest.mark.parametrize(
    ("float32", "bfloat16", "expected"),
    [([1.0], [0.5], "bfloat16"), ([1.0], [1.1], "float32"), ([1.0], [0.97], "float32"), ([1.0], [0.9], "bfloat16")],
    ids=["twice-as-fast", "slower", "hardly-faster", "faster"],
)
def test_the_format_whose_updates_are_clearly_faster_is_chosen(monkeypatch, float32, bfloat16, expected):
    timed = with_times(monkeypatch, float32, bfloat16)
    assert fastest_number_format(CONFIG) == expected
    assert {one[:2] for one in timed} == {("float32", CONFIG.batch_size), ("bfloat16", CONFIG.batch_size)}
    assert [one[0] for one in timed[2:6]] == ["float32", "bfloat16"] * 2, "they take turns"


@pytest.mark.usefixtures("multiplies_faster_in_bfloat16")
def test_a_moment_in_which_others_use_the_processor_decides_nothing(monkeypatch):
    with_times(monkeypatch, [1.0, 1.0, 9.0], [1.2])  # each third time that of float32
    assert fastest_number_format(CONFIG) == "float32"


def test_nothing_is_measured_where_matrices_are_no_faster_in_bfloat16(monkeypatch):
    monkeypatch.setattr(number_format, "fastest_autocast", lambda device: None)
    timed = with_times(monkeypatch, [1.0], [0.1])
    assert fastest_number_format(CONFIG) == "float32"
    assert not timed


@pytest.mark.usefixtures("multiplies_faster_in_bfloat16")
@pytest.mark.parametrize(
    "settings",
    [
        {"model": "S", "loss_function": "l2", "max_grad_norm": None},
        {"inputs": ("depth", "heading", "command", "surroundings"), "target_update": "hard"},
    ],
    ids=["S-squared-error", "more-inputs"],
)
def test_updates_of_any_settings_can_be_measured(settings):
    assert fastest_number_format(replace(CONFIG, **settings)) in ("float32", "bfloat16")


def test_a_random_sample_is_shaped_like_what_robots_see():
    env = NavEnv(str(HALL), num_envs=3, seed=0, surroundings=True)
    seen = env.reset()
    inputs = ("depth", "heading", "command", "surroundings")
    sample = random_sample(5, env.simulator.camera, inputs)
    for key in inputs:
        for drawn in (sample[key], sample["next", key]):
            assert (drawn.dtype, drawn.shape[1:]) == (seen[key].dtype, seen[key].shape[1:])


def test_choosing_a_format_leaves_the_run_as_it_is_with_that_format_named(tmp_path, monkeypatch):
    def choose(config: object) -> str:
        torch.rand(7)  # networks are drawn for it
        return "float32"

    monkeypatch.setattr("rl.train.fastest_number_format", choose)
    runs = [
        train(small_config(tmp_path / setting, total_steps=256, autocast=setting), console=Console(quiet=True))
        for setting in ("auto", "float32")
    ]
    assert [run.config.autocast for run in runs] == ["float32", "float32"]
    chosen, named = (run.load_policy("policy_last") for run in runs)
    assert all((chosen[name] == named[name]).all() for name in named)
