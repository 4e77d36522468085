"""Policies packed into one file, and those that come with the library."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from tensordict import TensorDict

import rl
from navsim.camera import DepthCamera
from rl.config import TrainConfig
from rl.learner import make_actor
from rl.pretrained import LARGEST_FILE, load_pretrained, pack_policy, pretrained_policies, read_policy
from rl.run import Run, RunError
from rl.surroundings import SECTORS

CAMERA = DepthCamera(width=14, height=10)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    torch.manual_seed(0)
    run = Run.create(TrainConfig(model="S", camera=CAMERA, out=tmp_path / "run"))
    run.save_policy("policy", make_actor(run.config).state_dict())
    return run


def observations(camera: DepthCamera, count: int = 32) -> TensorDict:
    depth = torch.randint(0, 256, (count, 4, camera.height, camera.width), dtype=torch.uint8)
    heading = torch.linspace(-3.0, 3.0, count).unsqueeze(-1)
    remembered = {"command": torch.zeros(count, 2), "surroundings": 2.0 * torch.rand(count, SECTORS)}
    return TensorDict({"depth": depth, "heading": heading, **remembered}, [count])


def test_a_packed_policy_is_the_run_s_but_for_half_precision(run, tmp_path):
    packed = tmp_path / "made" / "S.safetensors"
    pack_policy(run, packed)
    policy, config = read_policy(packed)
    seen = observations(CAMERA)
    expected = rl.load_policy(run.directory)(seen.clone())["action_value"]
    torch.testing.assert_close(policy(seen.clone())["action_value"], expected, atol=5e-3, rtol=0)
    assert config.camera == CAMERA
    assert config.model == "S"
    assert [path.name for path in packed.parent.iterdir()] == ["S.safetensors"], "no temporary file stays"


def test_a_packed_policy_does_not_tell_where_it_was_trained(run, tmp_path):
    pack_policy(run, tmp_path / "S.safetensors")
    assert str(tmp_path).encode() not in (tmp_path / "S.safetensors").read_bytes()


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:500])


def a_pickle(path: Path) -> None:
    torch.save({"weight": torch.zeros(1)}, path)


def without_settings(path: Path) -> None:
    save_file({"weight": torch.zeros(1)}, path)


def of_other_settings(path: Path) -> None:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    metadata["settings"] = json.dumps(json.loads(metadata["settings"]) | {"model": "I"})
    save_file(weights, path, metadata=metadata)


@pytest.mark.parametrize("damage", [truncated, a_pickle, without_settings, of_other_settings, Path.unlink])
def test_a_file_that_is_no_packed_policy_is_refused_in_a_sentence(run, tmp_path, damage):
    packed = tmp_path / "S.safetensors"
    pack_policy(run, packed)
    damage(packed)
    with pytest.raises(RunError, match=r"S\.safetensors") as refusal:
        read_policy(packed)
    assert "\n" not in str(refusal.value)


def test_a_policy_too_large_for_the_wheel_is_refused(tmp_path):
    run = Run.create(TrainConfig(camera=DepthCamera(width=160, height=128), out=tmp_path / "run"))
    run.save_policy("policy", make_actor(run.config).state_dict())
    with pytest.raises(RunError, match="4 MiB"):
        pack_policy(run, tmp_path / "I.safetensors")
    assert not (tmp_path / "I.safetensors").exists()


@pytest.mark.parametrize("name", pretrained_policies())
def test_a_policy_that_comes_with_the_library_acts_and_has_a_card(name):
    policy, config = load_pretrained(f"pretrained:{name}")
    directory = Path(rl.__file__).parent / "pretrained_policies"
    assert (directory / f"{name}.safetensors").stat().st_size <= LARGEST_FILE
    acted = policy(observations(config.camera))
    assert acted["action"].unique().numel() > 1
    card = (directory / f"{name}.md").read_text(encoding="utf-8")
    for part in ("Trained", "Results", "Limits"):
        assert f"## {part}" in card


def test_a_misspelt_name_is_told_in_a_sentence():
    with pytest.raises(RunError, match='no policy "pretrained:nonsense" comes with the library'):
        rl.load_policy("pretrained:nonsense")
