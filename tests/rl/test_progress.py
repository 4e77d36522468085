"""Counting what a run has done."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from rl.progress import Clock, TrainingProgress


def batch(rewards, ends, successes):
    """Transitions (N, T); an end that is no success is a collision."""
    reward, done, success = (torch.tensor(values).unsqueeze(-1) for values in (rewards, ends, successes))
    following = {
        "reward": reward.float(),
        "done": done.bool(),
        "success": success.bool(),
        "collision": (done.bool() & ~success.bool()),
    }
    return TensorDict({"next": TensorDict(following, reward.shape[:2])}, reward.shape[:2])


def test_episodes_are_added_up_across_batches():
    progress = TrainingProgress(2)
    progress.count(batch([[1, 2], [10, 20]], [[0, 0], [0, 1]], [[0, 0], [0, 1]]))
    progress.count(batch([[4, 8], [100, 200]], [[1, 0], [0, 0]], [[0, 0], [0, 0]]))
    row = progress.row()
    assert (row["step"], row["episodes"]) == (8, 2)
    assert row["success_rate"] == row["collision_rate"] == 0.5
    assert row["timeout_rate"] == 0.0
    assert row["reward"] == pytest.approx((30 + 7) / 2)
    assert row["episode_length"] == pytest.approx((2 + 3) / 2)


def test_there_is_nothing_to_tell_before_the_first_end():
    row = TrainingProgress(1).row()
    assert row["success_rate"] is None
    assert row["loss"] is None
    assert TrainingProgress(1).status() == "filling the replay"


def test_it_goes_on_from_its_state():
    progress = TrainingProgress(2)
    progress.count(batch([[1, 2], [10, 20]], [[0, 1], [0, 1]], [[0, 0], [0, 1]]))
    progress.learnt(torch.tensor(0.5), torch.tensor([1.0, 3.0]))
    restored = TrainingProgress(2)
    restored.load_state_dict(progress.state_dict())
    assert restored.row() == progress.row()
    assert restored.status() == progress.status() == "success 50%  reward +16.50  loss 0.5000  Q +2.00"


def test_the_clock_counts_what_passed_before():
    assert 100.0 <= Clock(seconds=100.0, step=0).seconds < 101.0
    clock = Clock(seconds=100.0, step=500)
    assert clock.tick(600) > 0
