"""Loading what a run has learnt, and what is said of runs that cannot be loaded."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navsim.camera import DepthCamera
from rl.config import TrainConfig
from rl.learner import make_actor, policy_of
from rl.networks import make_q_actor
from rl.policies import find_policy, load_policy
from rl.run import FORMAT, Run, RunError, write_json

CAMERA = DepthCamera(width=14, height=10)


@pytest.fixture(params=["l2", "categorical"])
def run(tmp_path: Path, request: pytest.FixtureRequest) -> Run:
    """A run with weights, as if it had been evaluated."""
    torch.manual_seed(0)
    run = Run.create(TrainConfig(model="S", camera=CAMERA, loss_function=request.param, out=tmp_path / "run"))
    run.save_policy("policy", make_actor(run.config).state_dict())
    return run


def observations(count: int) -> TensorDict:
    depth = torch.randint(0, 256, (count, 4, CAMERA.height, CAMERA.width), dtype=torch.uint8)
    return TensorDict({"depth": depth, "heading": torch.linspace(-3.0, 3.0, count).unsqueeze(-1)}, [count])


def test_a_robot_whose_camera_sits_to_one_side_is_not_symmetric(tmp_path):
    config = TrainConfig(
        model="S", camera=replace(CAMERA, mount_y=0.1), mirror=False, symmetric=False, out=tmp_path / "run"
    )
    run = Run.create(config)
    run.save_policy("policy", make_actor(config).state_dict())
    assert not load_policy(run.directory, symmetric=False).module[0].module.symmetric
    for load in (load_policy, lambda directory, **settings: find_policy(str(directory), **settings)):
        with pytest.raises(RunError, match=r"camera\.mount_y 0\.1.*it cannot be symmetric"):
            load(run.directory, symmetric=True)


def test_the_policy_is_the_one_that_was_saved(run):
    saved = make_actor(run.config)
    saved.load_state_dict(torch.load(run.directory / "policy.pt", weights_only=True))
    saved = policy_of(saved, run.config)
    seen = observations(5)
    torch.testing.assert_close(
        load_policy(run.directory)(seen.clone())["action_value"], saved(seen.clone())["action_value"]
    )


@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
def test_the_policy_takes_the_action_of_the_greatest_value(run, exploration):
    policy = load_policy(str(run.directory))
    assert not policy.training
    with set_exploration_type(exploration):
        chosen = policy(observations(32))
    assert (chosen["action"] == chosen["action_value"].argmax(dim=-1)).all()


def test_a_policy_is_as_symmetric_as_its_settings_or_whoever_loads_it_wants(run):
    seen = observations(5)
    mirrored = TensorDict({"depth": seen["depth"].flip(-1), "heading": -seen["heading"]}, [5])
    straight, other = (
        load_policy(run.directory, symmetric=False)(world.clone())["action_value"] for world in (seen, mirrored)
    )
    mean = (straight + other[:, [0, 1, 6, 5, 4, 3, 2]]) / 2
    assert not torch.allclose(straight, mean, atol=1e-4)
    settings = run.config.to_dict()
    for trained_for in (False, True):
        write_json(run.directory / "config.json", {"format": FORMAT, **settings, "symmetric": trained_for})
        for wanted in (None, False, True):
            expected = mean if (trained_for and wanted is None) or wanted else straight
            for policy in (
                load_policy(run.directory, symmetric=wanted),
                find_policy(str(run.directory), symmetric=wanted)[0],
            ):
                torch.testing.assert_close(policy(seen.clone())["action_value"], expected)


def test_shipped_policies_can_be_made_symmetric_and_baselines_cannot():
    for name, as_shipped in (("pretrained:I", False), ("pretrained:S", True)):
        for wanted in (None, False, True):
            for policy in (load_policy(name, symmetric=wanted), find_policy(name, symmetric=wanted)[0]):
                assert policy.module[0].module.symmetric == (as_shipped if wanted is None else wanted)
    for wanted in (True, False):
        with pytest.raises(RunError, match=r"reactive is a baseline, .*: leave --symmetric out"):
            find_policy("reactive", symmetric=wanted)


@pytest.mark.parametrize("load", [load_policy, find_policy])
def test_a_shipped_policy_has_no_last_weights(load):
    with pytest.raises(RunError, match="pretrained:I is no run, which alone has last weights"):
        load("pretrained:I", weights="last")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("I", 'did you mean "pretrained:I"?'),
        ("pretrained:i", 'did you mean "pretrained:I"?'),
        ("oracel", 'did you mean "oracle"?'),
        ("runs/fast-I-cafe", 'did you mean "runs/fast-I-cafe-seed0"?'),
        ("nonsense", "comes with the library: pretrained:I, pretrained:I-memoryless, pretrained:S, random, straight"),
    ],
)
def test_what_there_is_is_named_beside_what_there_is_not(tmp_path, monkeypatch, name, told):
    monkeypatch.chdir(tmp_path)
    Run.create(TrainConfig(out=tmp_path / "runs" / "fast-I-cafe-seed0"))
    with pytest.raises(RunError) as refusal:
        find_policy(name)
    assert told in str(refusal.value)


def test_a_directory_without_a_run_is_named(tmp_path):
    with pytest.raises(RunError, match=r"empty is not a run's directory: it has no config\.json"):
        load_policy(tmp_path / "empty")


def test_missing_weights_are_named(run):
    (run.directory / "policy.pt").unlink()
    with pytest.raises(RunError, match=r"policy\.pt is missing"):
        load_policy(run.directory)


def truncated(weights: Path) -> None:
    weights.write_bytes(weights.read_bytes()[:1000])


def another_kind_of_file(weights: Path) -> None:
    weights.write_text("nonsense")


def a_lone_tensor(weights: Path) -> None:
    torch.save(torch.zeros(3), weights)


def of_another_model(weights: Path) -> None:
    torch.save(make_q_actor("I", CAMERA.height, CAMERA.width).state_dict(), weights)


def of_another_image_size(weights: Path) -> None:
    torch.save(make_q_actor("S", 2 * CAMERA.height, 2 * CAMERA.width).state_dict(), weights)


def with_a_weight_left_out(weights: Path) -> None:
    kept = dict(list(torch.load(weights, weights_only=True).items())[1:])
    torch.save(kept, weights)


def with_a_weight_too_many(weights: Path) -> None:
    torch.save(torch.load(weights, weights_only=True) | {"surplus": torch.zeros(1)}, weights)


def with_a_weight_that_is_no_number(weights: Path) -> None:
    found = torch.load(weights, weights_only=True)
    name = next(iter(found))
    torch.save(found | {name: torch.full_like(found[name], math.nan)}, weights)


def with_a_sparse_weight(weights: Path) -> None:
    found = torch.load(weights, weights_only=True)
    name = next(iter(found))
    torch.save(found | {name: found[name].to_sparse()}, weights)


@pytest.mark.parametrize(
    "damage",
    [
        with_a_weight_that_is_no_number,
        with_a_sparse_weight,
        truncated,
        another_kind_of_file,
        a_lone_tensor,
        of_another_model,
        of_another_image_size,
        with_a_weight_left_out,
        with_a_weight_too_many,
    ],
)
def test_weights_that_cannot_be_used_are_refused_in_a_sentence(run, damage):
    damage(run.directory / "policy.pt")
    with pytest.raises(RunError) as refusal:
        load_policy(run.directory)
    assert "policy.pt" in str(refusal.value)
    assert "\n" not in str(refusal.value)


class Intruder:
    def __reduce__(self):
        return (Path.touch, (Path("intruded"),))


def test_nothing_in_a_file_of_weights_is_executed(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"weight": Intruder()}, run.directory / "policy.pt")
    with pytest.raises(RunError, match="damaged"):
        load_policy(run.directory)
    assert not Path("intruded").exists()


@pytest.mark.parametrize(
    "content",
    [
        *("", "[1, 2]", "\x00\xff"),
        *('{"preset": "fast", "gamma": "high"}', '{"gama": 0.9}', '{"model": "X"}', '{"depth_scale": []}'),
        *('{"warmup_steps": Infinity}', '{"atoms": Infinity}', '{"world": 7}'),
    ],
)
def test_settings_that_cannot_be_used_are_refused_in_a_sentence(run, content):
    (run.directory / "config.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(RunError, match=r"config\.json cannot be used"):
        load_policy(run.directory)


def test_settings_of_a_camera_that_cannot_be_are_refused(run):
    path = run.directory / "config.json"
    settings = json.loads(path.read_text())
    settings["camera"]["width"] = -3
    path.write_text(json.dumps(settings))
    with pytest.raises(RunError, match=r"config\.json cannot be used.*width"):
        load_policy(run.directory)
