"""Whole runs, very small ones."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console
from small_runs import HALL, small_config, tiny_config

from navsim.camera import DepthCamera
from rl.config import PRESETS
from rl.evaluation import evaluate_as_trained
from rl.policies import load_policy
from rl.run import EVALUATIONS, METRICS, Run, RunError
from rl.train import train

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    return train(small_config(tmp_path_factory.mktemp("runs") / "first"), console=QUIET)


def weights(run: Run, name: str = "policy_last") -> torch.Tensor:
    return torch.cat([value.flatten() for value in run.load_policy(name).values()])


def test_a_run_leaves_what_it_promises(run):
    assert [row["step"] for row in run.metrics.rows()] == ["256", "512", "768"]
    assert [row["step"] for row in run.evaluations.rows()] == ["384", "768"]
    assert list(run.metrics.rows()[-1]) == METRICS
    assert list(run.evaluations.rows()[-1]) == EVALUATIONS
    assert all(row["loss"] for row in run.metrics.rows()[1:])
    names = {path.name for path in run.directory.iterdir()}
    assert {"config.json", "versions.json", "policy.pt", "policy_last.pt", "checkpoints", "tensorboard"} <= names
    assert list((run.directory / "tensorboard").rglob("events.out.tfevents*"))
    assert run.config == small_config(run.directory)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {
            "prioritized": True,
            "inputs": ("depth", "heading", "command", "surroundings"),
            "frame_interval": 3,
        },
    ],
    ids=["memoryless", "prioritized-and-more-inputs"],
)
def test_the_same_seed_gives_the_same_run(tmp_path, settings):
    first, second, other = (
        train(small_config(tmp_path / name, total_steps=384, seed=seed, **settings), console=QUIET)
        for name, seed in (("first", 0), ("second", 0), ("other", 1))
    )
    assert (weights(first) == weights(second)).all()
    assert not (weights(first) == weights(other)).all()
    kept = ["loss", "q_mean", "max_q", "reward"]
    assert [[row[key] for key in kept] for row in first.metrics.rows()] == [
        [row[key] for key in kept] for row in second.metrics.rows()
    ]


@pytest.mark.parametrize("symmetric", [False, True])
def test_evaluations_drive_by_what_is_loaded_afterwards(tmp_path, monkeypatch, symmetric):
    driven = []

    def evaluate(policy, *arguments, **settings):
        driven.append(policy.module[0].module.symmetric)
        return evaluate_as_trained(policy, *arguments, **settings)

    monkeypatch.setattr("rl.train.evaluate_as_trained", evaluate)
    run = train(tiny_config(tmp_path / "run", symmetric=symmetric), console=Console(quiet=True))
    assert driven
    assert set(driven) == {symmetric} == {load_policy(run.directory).module[0].module.symmetric}


def test_a_finished_run_is_not_overwritten(run):
    with pytest.raises(RunError, match="already holds a run"):
        train(small_config(run.directory), console=QUIET)


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    from rl.learner import Learner

    settings = small_config(tmp_path / "run")
    due = 28  # updates before step 576, between the checkpoint at 384 and the end
    update = Learner.update

    def interrupted(self, sample):
        if self.updates == due:
            raise KeyboardInterrupt
        return update(self, sample)

    monkeypatch.setattr(Learner, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(settings, console=QUIET)
    monkeypatch.setattr(Learner, "update", update)
    assert [row["step"] for row in Run.open(tmp_path / "run").metrics.rows()] == ["256", "512"]

    run = train(settings, resume=True, console=QUIET)
    rows = run.metrics.rows()
    assert [row["step"] for row in rows] == ["256", "512", "768"]
    assert [row["step"] for row in run.evaluations.rows()] == ["384", "768"]
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == sorted(seconds)


def test_resuming_a_finished_run_changes_nothing(run):
    before = weights(run), run.metrics.rows(), run.evaluations.rows()
    train(small_config(run.directory), resume=True, console=QUIET)
    assert (weights(run) == before[0]).all()
    assert run.metrics.rows() == before[1]
    assert run.evaluations.rows() == before[2]


def test_the_thesis_preset_trains(tmp_path):
    settings = replace(
        PRESETS["thesis"],
        camera=DepthCamera(width=20, height=12),
        model="S",
        world=("simple_train",),
        eval_world=str(HALL),
        total_steps=192,
        warmup_steps=64,
        num_threads=1,
        out=tmp_path / "run",
    )
    run = train(settings, console=QUIET)
    assert run.metrics.rows()[-1]["loss"]
    assert (run.directory / "policy.pt").exists()


def processes_of(directory: Path) -> list[int]:
    """Living processes whose command line, or whose parent's, names ``directory``."""
    named = set()
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if str(directory) in (path / "cmdline").read_text() or parent in named:
                named.add(int(path.name))
    return sorted(named)


def shared_memory_of(processes: list[int]) -> set[str]:
    """Files in /dev/shm that processes have mapped."""
    lines = [line for process in processes for line in Path(f"/proc/{process}/maps").read_text().splitlines()]
    return {line.split()[5] for line in lines if "/dev/shm/" in line}


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_asynchronous_run_leaves_no_process_and_no_shared_memory(tmp_path, number):
    command = [sys.executable, "-m", "rl.cli", "train", "--collector", "async", "--out", str(tmp_path / "run")]
    small = [
        "--world",
        "complex_train",
        "--rearrangements",
        "0",
        "--camera.width",
        "20",
        "--camera.height",
        "12",
        "--log-interval",
        "64",
    ]
    small += ["--warmup-steps", "64", "--autocast", "float32"]
    with subprocess.Popen(command + small, stderr=subprocess.PIPE, start_new_session=True, text=True) as process:
        deadline = time.monotonic() + 240
        while len(Run(tmp_path / "run").metrics.rows()) < 3 and time.monotonic() < deadline:
            time.sleep(0.2)
        family = processes_of(tmp_path)
        shared = shared_memory_of(family)
        assert len(family) >= 2
        os.killpg(process.pid, number) if number != signal.SIGKILL else process.kill()
        _, errors = process.communicate(timeout=120)
    if number != signal.SIGKILL:
        assert "stopped; to go on from the last checkpoint" in errors
        assert process.returncode == 130
    left = [*family, *shared]
    while left and time.monotonic() < deadline:  # they notice the end of their parent within seconds
        time.sleep(0.2)
        left = [*filter(is_alive, family), *filter(os.path.exists, shared)]
    assert not left
