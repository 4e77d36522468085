"""The scripts run as a user runs them."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import ReplayBuffer, TensorStorage
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from navsim import WorldError
from rl import D3QNLoss, NavEnv, make_q_actor, make_replay

REPOSITORY = Path(__file__).parents[1]


def run_script(name: str, *arguments: str, directory: Path) -> subprocess.CompletedProcess[str]:
    command, environment = command_of(name, *arguments)
    return subprocess.run(command, cwd=directory, env=environment, capture_output=True, text=True, timeout=120)


def command_of(name: str, *arguments: str) -> tuple[list[str], dict[str, str]]:
    paths = [str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
    return [sys.executable, str(REPOSITORY / "scripts" / name), *arguments], environment


def run_script_here(name: str, *arguments: str, directory: Path) -> None:
    """The same in this process, which has loaded already what takes a new one seconds to load."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *arguments])
        patch.chdir(directory)
        runpy.run_path(str(REPOSITORY / "scripts" / name), run_name="__main__")


@pytest.mark.parametrize("processes", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_collected_transitions_lie_on_disk_ready_for_a_replay(tmp_path, processes, capsys):
    options = ["--batches", "2", "--num-envs", "2", "--processes", str(processes), "--world", "simple_eval"]
    if processes:
        done = run_script("collect.py", "--out", "dataset", *options, directory=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "collecting" in done.stdout
    else:
        run_script_here("collect.py", "--out", "dataset", *options, directory=tmp_path)
        assert "collecting" in capsys.readouterr().out

    transitions = TensorDict.load_memmap(tmp_path / "dataset")
    per_batch = 16 * 2 * max(1, processes)
    assert transitions.batch_size == torch.Size([2 * per_batch])
    assert transitions["depth"].shape[1:] == (4, 64, 80)
    assert transitions["depth"].dtype == torch.uint8
    assert transitions["depth"].flatten(1).any(dim=1).all(), "every transition has been written"
    poses = transitions["pose"].view(-1, 16, 3)  # of each environment and robot, 16 steps
    assert poses[:, 0].unique(dim=0).shape[0] == len(poses), "no two robots drove the same way"
    goes_on = ~transitions["next", "done"].view(-1, 16)[:, 0]  # robots that began a new episode are elsewhere
    assert goes_on.any()
    after = transitions["next", "pose"].view(-1, 16, 3)[:, 0]
    torch.testing.assert_close(after[goes_on], poses[goes_on, 1])
    sample = ReplayBuffer(storage=TensorStorage(transitions), batch_size=8).sample()
    assert sample["next", "reward"].shape == (8, 1)


def test_a_dataset_is_never_half_and_never_overwritten(tmp_path, monkeypatch):
    script = runpy.run_path(str(REPOSITORY / "scripts" / "collect.py"))
    options = {"world": "simple_eval", "batches": 2, "num_envs": 2}

    def interrupted(batches, *_, **__):
        yield next(iter(batches))
        raise KeyboardInterrupt

    collect = script["collect"]
    with monkeypatch.context() as patch:
        patch.setitem(collect.__globals__, "track", interrupted)
        with pytest.raises(KeyboardInterrupt):
            collect(tmp_path / "new" / "dataset", **options)
    assert not list((tmp_path / "new").iterdir())
    (tmp_path / "dataset").mkdir()
    with pytest.raises(ValueError, match="dataset is there already; move it away"):
        collect(tmp_path / "dataset", **options)
    with pytest.raises(ValueError, match="--batches must be at least 1; got 0"):
        collect(tmp_path / "other", **options | {"batches": 0})
    with pytest.raises(ValueError, match="--seed must be at least 0; got -1"):
        collect(tmp_path / "other", **options | {"seed": -1})


def test_a_collection_that_is_told_to_end_leaves_nothing_half_done(tmp_path):
    command, environment = command_of("collect.py", "--out", "dataset", "--batches", "5000", "--num-envs", "1")
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as collecting:
        until = time.monotonic() + 60
        while not any(tmp_path.glob(".dataset.*/dataset")) and time.monotonic() < until:
            time.sleep(0.05)
        assert any(tmp_path.iterdir())
        collecting.terminate()
        assert collecting.communicate(timeout=60)[1].splitlines()[-1] == "interrupted; nothing is kept"
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("processes", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_seed_collects_the_same_again(tmp_path, processes):
    options = ["--batches", "2", "--num-envs", "2", "--processes", str(processes), "--world", "simple_eval"]
    for name, seed in (("one", "5"), ("again", "5"), ("other", "6")):
        if processes:
            run_script("collect.py", "--out", name, "--seed", seed, *options, directory=tmp_path).check_returncode()
        else:
            torch.seed()
            run_script_here("collect.py", "--out", name, "--seed", seed, *options, directory=tmp_path)
    one, again, other = (TensorDict.load_memmap(tmp_path / name) for name in ("one", "again", "other"))
    for key in ("pose", "action"):
        assert (one[key] == again[key]).all()
        assert (one[key] != other[key]).any()


def test_a_loop_of_ones_own_learns_and_leaves_its_weights(tmp_path, capsys, recwarn):
    rooms = ["--world", "simple_train", "--eval-world", "simple_eval"]
    try:
        run_script_here("own_loop.py", "--out", "new/own.pt", "--steps", "256", *rooms, directory=tmp_path)
    finally:
        torch.set_flush_denormal(False)
    assert "of goals reached in simple_eval" in capsys.readouterr().out
    assert not [str(one.message) for one in recwarn if one.category is not DeprecationWarning]  # not shown by default
    torch.manual_seed(0)
    actor = make_q_actor("I", depth_scale="inverse")  # as the loop's network began
    weights = torch.load(tmp_path / "new" / "own.pt", weights_only=True)
    assert all((value != weights[name]).any() for name, value in actor.state_dict().items())
    actor.load_state_dict(weights)


def test_a_network_and_a_loss_of_ones_own_fit_into_the_loop():
    class Network(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = torch.nn.Linear(4 * 64 * 80 + 1, 7)

        def forward(self, depth: torch.Tensor, heading: torch.Tensor) -> torch.Tensor:
            return self.layer(torch.cat([depth.flatten(-3) / 255.0, heading], dim=-1))

    env = NavEnv("simple_train", num_envs=4, seed=0)
    actor = QValueActor(Network(), in_keys=["depth", "heading"], spec=env.action_spec_unbatched)
    replay = make_replay(capacity=200, batch_size=8, n_step=3)
    replay.extend(env.rollout(20, actor, break_when_any_done=False))
    sample = replay.sample()
    ours = D3QNLoss(actor)
    theirs = DQNLoss(actor, double_dqn=True, delay_value=True, action_space="categorical")
    torch.testing.assert_close(ours(sample)["loss"], theirs(sample)["loss"])


@pytest.mark.parametrize("name", ["train.py", "evaluate.py"])
def test_a_thin_entry_point_is_the_command(tmp_path, name):
    done = run_script(name, "--help", directory=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: navsim {name.removesuffix('.py')}")


@pytest.mark.parametrize("name", ["own_loop.py", "collect.py"])
def test_a_misspelt_world_is_told_in_a_sentence(name, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [name, "--out", str(tmp_path / "own.pt"), "--world", "complex_trian"])
    with pytest.raises(
        SystemExit, match=r"^complex_trian: there is no such world file; did you mean 'complex_train'\?$"
    ):
        runpy.run_path(str(REPOSITORY / "scripts" / name), run_name="__main__")


def test_a_loop_of_ones_own_tells_before_it_learns_what_it_cannot_do(tmp_path, capsys):
    script = runpy.run_path(str(REPOSITORY / "scripts" / "own_loop.py"))
    with pytest.raises(WorldError, match="complex_evil: there is no such world file"):
        script["learn"](tmp_path / "own.pt", eval_world="complex_evil")
    for name, value, least in (("steps", 0, 1), ("num_envs", 0, 1), ("seed", -1, 0)):
        option = name.replace("_", "-")
        with pytest.raises(SystemExit, match=f"--{option} must be at least {least}; got {value}"):
            script["learn"](tmp_path / "own.pt", **{name: value})
    assert not list(tmp_path.iterdir())
    assert "learning" not in capsys.readouterr().out


def test_a_directory_is_no_file_for_weights(tmp_path):
    script = runpy.run_path(str(REPOSITORY / "scripts" / "own_loop.py"))
    with pytest.raises(SystemExit, match=r"is a directory; --out names the file to write weights to"):
        script["learn"](tmp_path)
