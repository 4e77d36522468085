"""The benchmarks of environment and learner: what they compare is comparable, and their numbers add up."""

from __future__ import annotations

import io

import pytest
import torch
from rich.console import Console

from rl import bench_env, bench_learner
from rl.bench_learner import CONFIG, PeerLearner, random_sample
from rl.networks import make_q_actor


@pytest.fixture
def console() -> Console:
    return Console(file=io.StringIO(), width=120)


def printed(console: Console) -> str:
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_peer_has_the_layers_of_model_i():
    camera = CONFIG.camera
    ours = sum(p.numel() for p in make_q_actor("I", camera.height, camera.width).parameters())
    assert sum(p.numel() for p in PeerLearner(CONFIG).network.parameters()) == ours


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
