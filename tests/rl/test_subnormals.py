"""Subnormal numbers become zero while a robot trains, in every thread, and afterwards are what they were."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console
from small_runs import tiny_config

from rl.learner import Learner
from rl.optimiser import ClippedAdam
from rl.subnormals import subnormals_are_zero
from rl.train import train

IN_TWO_THREADS = """
import torch
from rl.subnormals import subnormals_are_zero
torch.set_num_threads(2)
with subnormals_are_zero():
    numbers = torch.full((4_000_000,), 1.5e-38)
    print(int(torch.count_nonzero(numbers * 0.1)))
print(int(torch.count_nonzero(numbers[:100] * 0.1)))
"""


def they_are_zero() -> bool:
    return bool((torch.full((8,), 1.5e-38) * 0.1 == 0.0).all())


def can_flush() -> bool:
    supported = torch.set_flush_denormal(True)
    torch.set_flush_denormal(False)
    return supported


pytestmark = pytest.mark.skipif(not can_flush(), reason="this processor cannot take subnormal numbers for zero")


def test_in_all_threads_and_not_afterwards():
    command = [sys.executable, "-c", IN_TWO_THREADS]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert [int(line) for line in printed.split()] == [0, 100]


def test_who_had_chosen_it_keeps_it():
    torch.set_flush_denormal(True)
    try:
        with subnormals_are_zero():
            assert they_are_zero()
        assert they_are_zero()
    finally:
        torch.set_flush_denormal(False)


def test_updates_of_a_training_are_done_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    seen = []
    update = Learner.update
    monkeypatch.setattr(Learner, "update", lambda self, sample: (seen.append(they_are_zero()), update(self, sample))[1])
    train(tiny_config(tmp_path / "run"), console=Console(quiet=True))
    assert seen
    assert all(seen)
    assert not they_are_zero()


def test_moments_of_what_has_no_gradient_fade_to_zero_and_weights_are_the_same():
    ours, plain = (torch.nn.Parameter(torch.linspace(-1.0, 1.0, 64)) for _ in range(2))
    optimisers = [ClippedAdam([ours], 1e-3, None), torch.optim.Adam([plain], lr=1e-3, fused=True)]
    random = np.random.default_rng(0)
    for step in range(2000):
        gradient = torch.from_numpy(random.normal(size=64).astype(np.float32))
        if step > 10:
            gradient[::2] = 0.0
        ours.grad, plain.grad = gradient.clone(), gradient.clone()
        with subnormals_are_zero():
            optimisers[0].step()
        optimisers[1].step()
    moments = [next(iter(optimiser.state.values()))["exp_avg"].abs() for optimiser in optimisers]
    smallest = torch.finfo(torch.float32).tiny
    assert [int(((moment > 0.0) & (moment < smallest)).sum()) for moment in moments] == [0, 32]
    assert torch.equal(ours, plain)
