"""The benchmarks of environment and learner: what they compare is comparable, and their numbers add up."""

from __future__ import annotations

import io
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console

from navsim.camera import DepthCamera
from rl import bench_env, bench_learner, bench_learning, bench_replay, bench_train
from rl.ablations import COMPLEX, PLACES, UNSEEN
from rl.bench_learner import CONFIG, PeerLearner, stable_baselines_update
from rl.networks import make_q_actor
from rl.number_format import random_sample
from rl.run import versions
from rl.stopwatch import stopwatch


@pytest.fixture
def console() -> Console:
    return Console(file=io.StringIO(), width=120)


def printed(console: Console) -> str:
    return console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", [(80, 64), (160, 128), (77, 61)])
def test_the_peer_has_the_layers_of_model_i(size):
    camera = DepthCamera(width=size[0], height=size[1])
    ours = sum(p.numel() for p in make_q_actor("I", camera.height, camera.width).parameters())
    assert sum(p.numel() for p in PeerLearner(replace(CONFIG, camera=camera)).network.parameters()) == ours


def test_the_other_peer_has_convolutions_as_large_and_learns():
    pytest.importorskip("stable_baselines3")
    torch.manual_seed(0)
    sample = random_sample(8, CONFIG.camera)
    update = stable_baselines_update(sample, CONFIG)
    model = next(cell.cell_contents for cell in update.__closure__ if hasattr(cell.cell_contents, "q_net"))
    counts = [p.numel() for p in model.q_net.parameters()]
    ours = [p.numel() for p in PeerLearner(CONFIG).network.parameters()]
    assert counts[:6] == ours[:6]
    assert counts[6] == 1280 * 1024
    before = model.q_net.state_dict()["q_net.0.weight"].clone()
    target = model.q_net_target.state_dict()["q_net.0.weight"].clone()
    update()
    assert not torch.equal(model.q_net.state_dict()["q_net.0.weight"], before)
    assert not torch.equal(model.q_net_target.state_dict()["q_net.0.weight"], target)


def test_the_peer_learns():
    torch.manual_seed(0)
    peer, sample = PeerLearner(CONFIG), random_sample(16, CONFIG.camera)
    losses = [peer.update(sample.copy()).item() for _ in range(30)]
    assert losses[-1] < 0.5 * losses[0]


def test_operations_are_those_of_the_layers():
    """Multiplications and additions of an update, by hand: three evaluations, and two more for the gradients."""
    size = 4
    convolutions = [8 * 10 * 32 * (5 * 10 * 14), 4 * 5 * 64 * (32 * 4 * 4), 4 * 5 * 64 * (64 * 3 * 3)]
    streams = [2 * 1280 * 512, 512 * (1 + 7)]
    evaluation = 2 * size * sum(convolutions + streams)
    no_gradient_of_images = 2 * size * convolutions[0]
    peer = PeerLearner(CONFIG)
    counted = peer.operations(random_sample(size, CONFIG.camera))
    assert counted == 5 * evaluation - no_gradient_of_images


@pytest.mark.slow  # where the processor has no bfloat16, one such update takes seconds
def test_updates_a_second_are_told_for_each_setting(console):
    measured = bench_learner.run(console, seconds=0.01)
    assert [(row.batch_size, row.number_format) for row in measured] == [
        (8, "float32"),
        (8, "bfloat16"),
        (64, "float32"),
        (64, "bfloat16"),
    ]
    assert all(row.ours > 0 and row.peer > 0 and row.bound > 0 for row in measured)
    assert all(f"{row.ours:,.1f}" in printed(console) for row in measured)
    assert "a tenth of its moments subnormal" in printed(console)


def test_the_parts_of_a_step_add_up(console):
    rate = bench_env.run(console, world="simple_eval", steps=bench_env.BATCH)
    assert f"{rate:,.0f} transitions/s" in printed(console)
    shares = {}
    for line in printed(console).splitlines():
        cells = [cell.strip() for cell in line.strip("│ ").split("│")]
        if len(cells) == 3 and cells[1].endswith("%"):
            shares[cells[0]] = (int(cells[1][:-1]), float(cells[2]))
    percent, microseconds = shares.pop("all")
    assert percent == 100
    assert sum(share for share, _ in shares.values()) == pytest.approx(100, abs=len(shares))
    assert sum(part for _, part in shares.values()) == pytest.approx(microseconds, rel=0.01)
    assert shares["camera"][0] > 5
    assert shares["physics"][0] > 1


def test_a_stopwatch_counts_inner_parts_once():
    class Work:
        def outer(self):
            time.sleep(0.02)
            self.inner()

        def inner(self):
            time.sleep(0.05)

    with stopwatch({"outer": ((Work, "outer"),), "inner": ((Work, "inner"),)}) as spent:
        Work().outer()
    assert 0.02 <= spent["outer"] < 0.05 <= spent["inner"]
    assert not hasattr(Work.outer, "__wrapped__")


def test_random_streams_for_the_replay_are_those_of_an_environment():
    streams = bench_replay.Streams(10, 14)
    first, second = streams.batch(), streams.batch()
    depth = torch.cat([first["depth"], second["depth"]], dim=1)
    after = torch.cat([first["next", "depth"], second["next", "depth"]], dim=1)
    done = torch.cat([first["next", "done"], second["next", "done"]], dim=1).squeeze(-1)[:, :-1]
    assert torch.equal(after[:, :, :-1], depth[:, :, 1:])
    same = (after[:, :-1] == depth[:, 1:]).flatten(2).all(-1)
    assert torch.equal(same, ~done)


def test_ways_to_store_transitions_are_compared(console, monkeypatch):
    monkeypatch.setattr(bench_replay, "SIZES", ((10, 14),))
    rows = {row.name: row for row in bench_replay.run(console, capacity=2_000)}
    ours, plain = rows["frames once"], rows["TorchRL, stacks as they come"]
    assert ours.megabytes < 0.5 * plain.megabytes
    assert plain.megabytes == pytest.approx(2_000 * (8 * 140 + 26) / 1e6, rel=0.1)
    assert all(row.name in printed(console) for row in rows.values())
    with pytest.raises(ValueError, match="at least 400"):
        bench_replay.run(console, capacity=399)


@pytest.mark.slow
def test_a_training_is_taken_apart_once(console, tmp_path):
    out = tmp_path / "train.json"
    first = bench_train.run(console, steps=768, collectors=("sync",), out=out)
    (result,) = first["runs"].values()
    parts = result["parts"]
    assert set(parts) <= set(bench_train.PARTS)
    assert sum(parts.values()) == pytest.approx(result["seconds"])
    assert parts["update"] > parts["target network"] > 0
    assert parts["collect"] > 0
    assert result["peak_megabytes"] > 100
    assert bench_train.run(console, steps=768, collectors=("sync",), out=out) == first
    assert json.loads(out.read_text()) == first


def measured(**changes) -> dict:
    """An entry of the file, with other settings than the benchmark's."""
    config = replace(bench_train.settings("sync", steps=768, exact=False, out=Path("run")), **changes)
    numbers = dict.fromkeys(("seconds", "steady_steps_per_second", "thesis_seconds", "peak_megabytes"), 1.0)
    return numbers | {"parts": {"update": 1.0}, "settings": config.to_dict()}


def test_a_file_that_cannot_be_written_is_told_before_anything_is_trained(console, tmp_path, monkeypatch):
    monkeypatch.setattr(bench_train, "map_in_processes", lambda *_, **__: pytest.fail("trained"))
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"file/train\.json cannot be written .*; choose another file"):
        bench_train.run(console, steps=768, collectors=("sync",), out=tmp_path / "file" / "train.json")


def test_peers_that_are_missing_are_told_before_anything_is_measured(console, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.buffers", None)
    monkeypatch.setattr(bench_replay, "_measure", lambda *_: pytest.fail("measured"))
    with pytest.raises(ValueError, match="--peers needs stable-baselines3"):
        bench_replay.run(console, peers=True, capacity=400)


def test_files_of_other_benchmarks_and_machines_are_left_alone(console, tmp_path):
    out = tmp_path / "train.json"
    for text, reason in (
        ("[]", "does not hold results of this benchmark"),
        (
            json.dumps({"runs": {}, "versions": {"processor": "an abacus"}}),
            "on another machine, an abacus, not .*; choose another",
        ),
        (
            json.dumps({"runs": {}, "versions": versions() | {"torch": "0.1"}}),
            "with another torch, 0.1, not .*; choose another",
        ),
        (
            json.dumps({"runs": {"batch64-sync-768": {}}, "versions": versions()}),
            "does not hold results of this benchmark",
        ),
        (
            json.dumps({"runs": {"batch64-sync-768": measured(learning_rate=0.9)}, "versions": versions()}),
            r"other settings than this benchmark's \(learning_rate\); choose another",
        ),
    ):
        out.write_text(text)
        with pytest.raises(ValueError, match=reason):
            bench_train.run(console, steps=768, collectors=("sync",), out=out)
        assert out.read_text() == text


@pytest.mark.slow
def test_what_collectors_learn_is_compared_and_finished_runs_are_kept(console, tmp_path, monkeypatch):
    monkeypatch.setitem(PLACES, UNSEEN, ("generate:clutter,count=3", 20))
    small = {
        "camera": DepthCamera(width=20, height=12),
        "eval_world": "simple_eval",
        "rearrangements": 0,
        "num_envs": 4,
        "steps_per_batch": 32,
        "warmup_steps": 128,
        "batch_size": 16,
        "replay_capacity": 512,
    }

    def compare():
        return bench_learning.run(
            console, results=tmp_path / "results", runs=tmp_path, seeds=(0,), steps=512, formats=("float32",), **small
        )

    results = compare()
    assert [(one["collector"], one["settings"]["collector"]) for one in results] == [("sync",) * 2, ("async",) * 2]
    assert all(one["curve"]["step"] == [128, 256, 384, 512] for one in results)
    assert all([one["final"][place]["paths"] for place in (COMPLEX, UNSEEN)] == [100, 20] for one in results)
    changed = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/policy_last.pt")}
    assert len(changed) == 2
    assert compare() == results
    assert changed == {path: path.stat().st_mtime_ns for path in changed}
