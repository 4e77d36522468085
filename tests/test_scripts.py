"""The scripts run as a user runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import ReplayBuffer, TensorStorage

REPOSITORY = Path(__file__).parents[1]


def run_script(name: str, *arguments: str, directory: Path) -> subprocess.CompletedProcess[str]:
    paths = [str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts" / name), *arguments],
        cwd=directory,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("processes", [0, 2])
def test_collected_transitions_lie_on_disk_ready_for_a_replay(tmp_path, processes):
    options = ["--batches", "2", "--num-envs", "2", "--processes", str(processes), "--world", "simple_eval"]
    done = run_script("collect.py", "--out", "dataset", *options, directory=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "collecting" in done.stdout

    transitions = TensorDict.load_memmap(tmp_path / "dataset")
    per_batch = 16 * 2 * max(1, processes)
    assert transitions.batch_size == torch.Size([2 * per_batch])
    assert transitions["depth"].shape[1:] == (4, 64, 80)
    assert transitions["depth"].flatten(1).any(dim=1).all(), "every transition has been written"
    poses = transitions["pose"].view(-1, 16, 3)  # of each environment and robot, 16 steps
    assert poses[:, 0].unique(dim=0).shape[0] == len(poses), "no two robots drove the same way"
    goes_on = ~transitions["next", "done"].view(-1, 16)[:, 0]  # robots that began a new episode are elsewhere
    assert goes_on.any()
    after = transitions["next", "pose"].view(-1, 16, 3)[:, 0]
    torch.testing.assert_close(after[goes_on], poses[goes_on, 1])
    sample = ReplayBuffer(storage=TensorStorage(transitions), batch_size=8).sample()
    assert sample["next", "reward"].shape == (8, 1)


@pytest.mark.parametrize("name", ["train.py", "evaluate.py"])
def test_a_thin_entry_point_is_the_command(tmp_path, name):
    done = run_script(name, "--help", directory=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: navsim {name.removesuffix('.py')}")
