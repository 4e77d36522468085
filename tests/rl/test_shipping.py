"""Policies are shipped with a card that tells what the packed file does."""

from __future__ import annotations

import re

import pytest
import torch
from small_runs import HALL, tiny_config

import rl.shipping
from navsim.randomization import Randomization
from navsim.sensor import KINECT
from navsim.task import Task
from rl.evaluation import evaluate
from rl.learner import make_actor
from rl.pretrained import read_policy
from rl.run import Run, RunError, processor
from rl.shipping import ship


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setattr(rl.shipping, "PLACES", (("the hall", str(HALL), None),))
    monkeypatch.setattr(rl.shipping, "arguments_of", lambda config: ["--model", config.model])
    run = Run.create(tiny_config(tmp_path / "run", model="S", inputs=("depth", "heading", "command"), frame_interval=3))
    torch.manual_seed(0)
    for name in ("policy", "policy_last"):
        run.save_policy(name, make_actor(run.config).state_dict())
    row = {"step": 18_000, "seconds": 500.0, "processor_seconds": 120.0, "world": "hall"}
    run.evaluations.append(row | dict.fromkeys(("success_rate", "collision_rate", "timeout_rate", "spl"), 0.5))
    return run


@pytest.mark.parametrize("weights", ["best", "last"])
def test_the_card_tells_what_the_packed_file_does(run, tmp_path, weights):
    card = ship(run, tmp_path / "shipped", "S", weights=weights).read_text(encoding="utf-8")
    policy, config = read_policy(tmp_path / "shipped" / "S.safetensors")
    packed = {name.split("module.")[-1]: value for name, value in policy.state_dict().items()}
    source = {"best": "policy", "last": "policy_last"}[weights]
    for name, value in run.load_policy(source).items():
        torch.testing.assert_close(packed[name.split("module.")[-1]], value.half().float())

    driven = evaluate(policy, str(HALL), camera=config.camera, frame_interval=3)
    (row,) = [line.split("|") for line in card.splitlines() if line.startswith("| the hall")]
    assert int(row[2]) == len(driven.paths)
    assert float(re.match(r" ([\d.]+) \(", row[3])[1]) == pytest.approx(100 * driven.success_rate, abs=0.06)
    assert float(row[4]) == pytest.approx(100 * driven.collision_rate, abs=0.06)
    assert float(row[6]) == pytest.approx(driven.spl, abs=0.006)

    assert "its own command" in card
    assert "it is 0.6 s" in card
    assert "navsim train --model S" in card
    assert f"18,000 steps (1 h of robot time) in 2 min of processor time ({processor()})" in card
    assert "four depth images, the goal's direction and its own command (v, ω);" in card
    assert "It remembers nothing but its four images" in card
    assert "It goes by the mean of its network's values for what it sees and for the mirror image" in card
    assert ("the last of the run" in card) == (weights == "last")
    for part in ("Trained", "Results", "Limits"):
        assert f"## {part}" in card


def test_a_policy_is_shipped_as_a_symmetric_one_or_not(run, tmp_path):
    assert run.config.symmetric
    for symmetric in (False, True, None):
        card = ship(run, tmp_path / "shipped", "S", symmetric=symmetric, chosen="The best of two.").read_text()
        assert "the last of the run. The best of two. " in card
        policy, config = read_policy(tmp_path / "shipped" / "S.safetensors")
        assert policy.module[0].module.symmetric == config.symmetric == (symmetric is not False)
        assert ("for the mirror image" in card) == config.symmetric


def test_the_card_of_a_robot_that_remembers_tells_what_that_needs(run, tmp_path):
    inputs = ("depth", "heading", "command", "surroundings")
    remembering = Run.create(tiny_config(tmp_path / "remembering", model="S", inputs=inputs, symmetric=False))
    remembering.save_policy("policy_last", make_actor(remembering.config).state_dict())
    remembering.evaluations.append(run.evaluations.rows()[0] | {"step": 256})  # of 512: it was interrupted
    (remembering.directory / "versions.json").write_text("{}")
    card = ship(remembering, tmp_path / "shipped", "S").read_text(encoding="utf-8")
    assert "its own command (v, ω) and what it remembers of what stood around it (odometry);" in card
    assert "It remembers what it has seen for 6 s," in card
    assert "nothing but its four images" not in card
    assert "mirror image" not in card
    assert "processor time (unknown)" in card
    assert "256 of these steps" in card


def test_a_run_without_an_evaluation_is_refused_before_anything_is_written(run, tmp_path):
    run.evaluations.path.unlink()
    with pytest.raises(RunError, match=r"has no evaluation yet, which the card tells of; train on"):
        ship(run, tmp_path / "shipped", "S")
    assert not (tmp_path / "shipped").exists()


def test_the_card_of_a_noisy_robot_tells_its_settings_and_where_it_did_best(tmp_path, monkeypatch):
    monkeypatch.setattr(rl.shipping, "PLACES", ())
    run = Run.create(tiny_config(tmp_path / "run", sensor=KINECT))
    run.save_policy("policy", make_actor(run.config).state_dict())
    row = {"step": 18_000, "seconds": 500.0, "processor_seconds": 120.0, "world": "hall"}
    run.evaluations.append(row | dict.fromkeys(("success_rate", "collision_rate", "timeout_rate", "spl"), 0.5))
    card = ship(run, tmp_path / "shipped", "S", weights="best").read_text(encoding="utf-8")
    assert f"--sensor.axial-noise {KINECT.axial_noise}" in card
    assert "a depth sensor that errs" in card
    assert f"those that did best in `{HALL}` during the run" in card


def test_a_measurement_that_is_interrupted_leaves_the_old_weights_with_their_card(run, tmp_path, monkeypatch):
    card = ship(run, tmp_path, "S")
    before = {path: path.read_bytes() for path in (card, tmp_path / "S.safetensors")}
    run.save_policy("policy_last", {name: value + 1.0 for name, value in run.load_policy("policy").items()})

    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(rl.shipping, "evaluate_as_trained", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ship(run, tmp_path, "S")
    assert {path: path.read_bytes() for path in before} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["S.md", "S.safetensors", "run"]


@pytest.mark.parametrize("lively", [False, True])
def test_the_card_tells_of_the_rooms_and_the_wheels_that_it_was_trained_with(tmp_path, monkeypatch, lively):
    places = (("the hall", str(HALL), 1), ("a room", "simple_eval", 1))
    monkeypatch.setattr(rl.shipping, "PLACES", places)
    settings = {"world": ("generate:clutter,size=9x8,count=1", str(HALL))}
    if lively:
        wheels = Randomization(wheel_speed_error=(-0.1, 0.1))
        settings = {"world": ("crowded", "simple_eval"), "sensor": KINECT, "randomization": wheels}
    run = Run.create(tiny_config(tmp_path / "run", **settings))
    run.save_policy("policy_last", make_actor(run.config).state_dict())
    row = {"step": 18_000, "seconds": 500.0, "processor_seconds": 120.0, "world": "hall"}
    run.evaluations.append(row | dict.fromkeys(("success_rate", "collision_rate", "timeout_rate", "spl"), 0.5))
    card = " ".join(ship(run, tmp_path, "S").read_text(encoding="utf-8").split())
    assert f"Of the rooms below, it was trained in {'a room' if lively else 'the hall'}." in card
    assert ("whose furniture stands still. In larger rooms, among what moves, or" in card) != lively
    assert ("9 x 8 m whose" in card) != lively
    assert ("a depth sensor that errs and inexact wheels: for a robot with others train anew" in card) == lively
    assert ("an ideal depth sensor and exact wheels, which robots do not have: train anew" in card) != lively


def test_weights_that_a_training_writes_meanwhile_are_not_shipped(run, tmp_path, monkeypatch):
    measured = run.load_policy("policy_last")
    evaluate_as_trained = rl.shipping.evaluate_as_trained

    def evaluate_while_another_trains(*arguments, **settings):
        run.save_policy("policy_last", {name: value + 1.0 for name, value in measured.items()})
        return evaluate_as_trained(*arguments, **settings)

    monkeypatch.setattr(rl.shipping, "evaluate_as_trained", evaluate_while_another_trains)
    ship(run, tmp_path / "shipped", "S")
    policy, _ = read_policy(tmp_path / "shipped" / "S.safetensors")
    packed = {name.split("module.")[-1]: value for name, value in policy.state_dict().items()}
    for name, value in measured.items():
        torch.testing.assert_close(packed[name.split("module.")[-1]], value.half().float())


def test_the_card_tells_how_far_the_shipped_weights_are(run, tmp_path):
    """The last ones are of the newest checkpoint, the best ones of the first of the best evaluations."""
    row = run.evaluations.rows()[0]
    for step, minutes, success in ((36_000, 4, 0.9), (54_000, 6, 0.9), (72_000, 8, 0.7)):
        rates = {"processor_seconds": str(60.0 * minutes), "success_rate": str(success)}
        run.evaluations.append(row | {"step": str(step)} | rates)
    (run.directory / "checkpoints" / "checkpoint-000000060000").mkdir(parents=True)
    last, best = (ship(run, tmp_path / "shipped", "S", weights=weights).read_text() for weights in ("last", "best"))
    assert "60,000 steps (3 h of robot time) in 6 min of processor time" in last
    assert "36,000 steps (2 h of robot time) in 4 min of processor time" in best


def test_the_card_of_other_settings_says_what_is_true_of_them(tmp_path, monkeypatch):
    monkeypatch.setattr(rl.shipping, "PLACES", ())
    settings = {"inputs": ("depth", "heading", "surroundings"), "symmetric": False}
    settings |= {"task": Task(control_period=0.4), "randomization": Randomization(latency=(0, 3))}
    run = Run.create(tiny_config(tmp_path / "run", **settings))
    run.save_policy("policy_last", make_actor(run.config).state_dict())
    row = {"step": 512, "seconds": 500.0, "processor_seconds": 120.0, "world": "hall"}
    run.evaluations.append(row | dict.fromkeys(("success_rate", "collision_rate", "timeout_rate", "spl"), 0.5))
    card = ship(run, tmp_path / "shipped", "S").read_text(encoding="utf-8")
    assert "It remembers what it has seen for 12 s," in card
    assert "a depth sensor that errs" in card  # whose images are late
    assert f"--world {HALL.name} --eval-world {HALL.name} " in card
    assert str(HALL.parent) not in card


def test_a_run_of_an_earlier_version_is_refused_before_anything_is_measured(run, tmp_path, monkeypatch):
    monkeypatch.setattr(rl.shipping, "evaluate_as_trained", lambda *_, **__: pytest.fail("measured"))
    monkeypatch.setattr(Run, "format", 1)
    with pytest.raises(RunError, match="was written by an earlier version"):
        ship(run, tmp_path / "shipped", "S")
