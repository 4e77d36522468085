"""Nothing in a file that is loaded is executed, whatever the file is: each of these would leave a mark if it were."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pickle
import shutil
from pathlib import Path

import pytest
import torch
from rich.console import Console
from safetensors.torch import save_file
from small_runs import small_config
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint

from navsim.camera import DepthCamera
from rl.checkpoints import find_damage
from rl.config import ConfigError, TrainConfig
from rl.learner import shapes_of_weights
from rl.policies import find_policy, load_policy
from rl.pretrained import read_policy
from rl.run import Run, RunError, write_json
from rl.safe_loading import nothing_executed_from
from rl.train import train


class Mark:
    """Unpickled, it makes a directory."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.fixture
def hostile(tmp_path) -> bytes:
    content = pickle.dumps({"queue": Mark(tmp_path / "mark")})
    pickle.loads(content)
    (tmp_path / "mark").rmdir()  # raises unless the pickle does what it is to do
    return content


@pytest.fixture(autouse=True)
def no_mark(tmp_path):
    yield
    assert not (tmp_path / "mark").exists(), "something in a file was executed"


def refusal(load, *arguments) -> str:
    with pytest.raises(RunError) as caught:
        load(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.fixture
def run(tmp_path) -> Run:
    return Run.create(TrainConfig(camera=DepthCamera(width=20, height=12), out=tmp_path / "run"))


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    settings = small_config(tmp_path_factory.mktemp("trained") / "run", total_steps=160, eval_interval=160)
    return train(settings, console=Console(quiet=True)).directory


# Policies


@pytest.mark.parametrize("kind", ["pickle", "torch"])
@pytest.mark.parametrize("weights", ["best", "last"])
def test_a_pickle_in_place_of_a_policy_is_refused(run, tmp_path, hostile, kind, weights):
    path = run.directory / {"best": "policy.pt", "last": "policy_last.pt"}[weights]
    if kind == "torch":
        torch.save({"weight": Mark(tmp_path / "mark")}, path)
    else:
        path.write_bytes(hostile)
    message = refusal(lambda: load_policy(run.directory, weights=weights))
    assert message.startswith(f"{path} is damaged or not a file of weights")
    if weights == "best":
        assert refusal(find_policy, str(run.directory)) == message


def test_a_pickle_in_place_of_a_packed_policy_is_refused(tmp_path, hostile):
    path = tmp_path / "policy.safetensors"
    path.write_bytes(hostile)
    assert refusal(read_policy, path).startswith(f"{path} cannot be read as a packed policy")
    torch.save({"weight": Mark(tmp_path / "mark")}, path)
    assert refusal(read_policy, path).startswith(f"{path} cannot be read as a packed policy")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, "[1, 2]", "5", '{"camera": 5}', '{"camera": {"width": "x"}}', '{"world": 5}', "{", '"x"']
)
def test_settings_that_are_none_are_refused(run, tmp_path, text):
    (run.directory / "config.json").write_text(text)
    assert "cannot be used" in refusal(load_policy, run.directory)
    path = tmp_path / "policy.safetensors"
    save_file({"a": torch.zeros(1)}, path, metadata={"format": "1", "settings": text})
    assert "settings that cannot be used" in refusal(read_policy, path)


def test_settings_of_an_enormous_network_take_no_memory(run, tmp_path):
    # Of 4096 x 4096 pixels: the first fully connected layers alone would take 64 GB.
    settings = run.config.to_dict()
    settings["camera"]["width"] = settings["camera"]["height"] = 4096
    write_json(run.directory / "config.json", settings)
    torch.save({"a": torch.zeros(1)}, run.directory / "policy.pt")
    assert "does not fit" in refusal(load_policy, run.directory)
    path = tmp_path / "policy.safetensors"
    save_file({"a": torch.zeros(1)}, path, metadata={"format": "1", "settings": json.dumps(settings)})
    assert "do not fit" in refusal(read_policy, path)


def test_a_part_of_the_settings_that_is_no_mapping_is_told():
    with pytest.raises(ConfigError, match="settings of the camera cannot be used"):
        TrainConfig.from_dict({"camera": 5})


def test_shapes_are_those_of_the_weights():
    from rl.learner import make_actor

    settings = TrainConfig(camera=DepthCamera(width=20, height=12))
    weights = make_actor(settings).state_dict()
    assert {name: value.shape for name, value in shapes_of_weights(settings).items()} == {
        name: value.shape for name, value in weights.items()
    }


# Checkpoints


def resumed(directory: Path) -> Run:
    return train(Run.open(directory).config, resume=True, console=Console(quiet=True))


def copied(trained: Path, to: Path) -> tuple[Path, Path]:
    """A copy of a run, and its checkpoint."""
    directory = Path(shutil.copytree(trained, to))
    settings = json.loads((directory / "config.json").read_text())
    write_json(directory / "config.json", settings | {"out": str(directory)})
    (checkpoint,) = (directory / "checkpoints").glob("checkpoint-*")
    return directory, checkpoint


def tampered(checkpoint: Path, component: str, members: dict[str, bytes]) -> None:
    """Puts files in place of those of a component, and writes manifest and checksums that belong to them."""
    manifest = json.loads((checkpoint / "manifest.json").read_text())
    record = manifest["components"][component]
    shutil.rmtree(checkpoint / record["path"])
    for name, content in members.items():
        file = checkpoint / record["path"] / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    if "files" in record:
        record["files"] = sorted(members)
    write_json(checkpoint / "manifest.json", manifest)
    sums = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(checkpoint).as_posix()}"
        for file in sorted(checkpoint.rglob("*"))
        if file.is_file() and file.name != "SHA256SUMS"
    ]
    (checkpoint / "SHA256SUMS").write_text("\n".join(sums) + "\n")
    assert not find_damage(checkpoint)


COMPONENTS = ["collector", "exploration", "generators", "learner", "logs", "progress", "replay"]
STACK = json.dumps({"_type": "<class 'tensordict.tensorclass.NonTensorStack'>", "data": "pickle.pkl", "device": None})
DATA = json.dumps({"_type": "<class 'tensordict.tensorclass.NonTensorData'>"})


def test_these_are_the_components(trained):
    (checkpoint,) = (trained / "checkpoints").glob("checkpoint-*")
    assert sorted(Checkpoint.manifest(checkpoint)["components"]) == COMPONENTS


@pytest.mark.parametrize("way", ["torch", "pickle", "stack", "data"])
@pytest.mark.parametrize("component", COMPONENTS)
def test_a_pickle_in_a_component_of_a_checkpoint_is_refused(tmp_path, trained, hostile, component, way):
    directory, checkpoint = copied(trained, tmp_path / "run")
    torch.save({"a": Mark(tmp_path / "mark")}, tmp_path / "saved")
    members = {
        "torch": {"state.pt": (tmp_path / "saved").read_bytes()},
        "pickle": {"state.pt": hostile},
        "stack": {"state/meta.json": STACK.encode(), "state/pickle.pkl": hostile},
        "data": {"state/meta.json": DATA.encode(), "state/other.pickle": hostile},
    }[way]
    tampered(checkpoint, component, members)
    assert refusal(resumed, directory).startswith(str(checkpoint))


def test_a_pickle_in_place_of_a_checkpoint_is_refused(tmp_path, trained, hostile):
    directory, checkpoint = copied(trained, tmp_path / "run")
    shutil.rmtree(checkpoint)
    checkpoint.write_bytes(hostile)
    assert "damaged" in refusal(resumed, directory)


def test_a_file_that_names_modules_to_import_is_refused(tmp_path, trained):
    directory, checkpoint = copied(trained, tmp_path / "run")
    tampered(checkpoint, "learner", {"state.tdc": b"anything"})
    assert "state.tdc" in refusal(resumed, directory)


def test_an_honest_checkpoint_is_loaded(tmp_path, trained):
    directory, _ = copied(trained, tmp_path / "run")
    resumed(directory)


@pytest.mark.parametrize("way", ["stack", "data"])
def test_what_tensordict_would_unpickle_is_refused(tmp_path, hostile, way):
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "meta.json").write_text({"stack": STACK, "data": DATA}[way])
    (tmp_path / "state" / {"stack": "pickle.pkl", "data": "other.pickle"}[way]).write_bytes(hostile)

    def load() -> None:
        with nothing_executed_from(tmp_path):
            TensorDict.load_memmap(tmp_path / "state")

    assert "would execute posix.mkdir" in refusal(load)


def test_pickles_of_plain_data_are_loaded(tmp_path):
    with nothing_executed_from(tmp_path):
        assert pickle.loads(pickle.dumps({"a": [1, "b"]})) == {"a": [1, "b"]}


def test_pickles_elsewhere_are_none_of_its_business(tmp_path):
    with pytest.raises(RunError, match="would execute"), nothing_executed_from(tmp_path):
        pickle.loads(pickle.dumps(Path("x")))
    assert pickle.loads(pickle.dumps(Path("x"))) == Path("x")


def test_what_is_swallowed_on_the_way_is_refused_all_the_same(tmp_path, hostile):
    def load() -> None:
        with nothing_executed_from(tmp_path), contextlib.suppress(RuntimeError):
            pickle.loads(hostile)

    assert "would execute" in refusal(load)
