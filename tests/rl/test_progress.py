"""Counting what a run has done."""

from __future__ import annotations

import subprocess
import sys
import time

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
    progress = TrainingProgress(1)
    progress.seconds, progress.processor_seconds, progress.step = 100.0, 150.0, 500
    clock = Clock(progress, list)
    assert 100.0 <= clock.seconds < 101.0
    assert 150.0 <= clock.processor_seconds < 151.0
    assert clock.tick(600) > 0


def test_processor_time_is_that_of_all_processes_and_of_their_work_alone():
    """Another process that is at work, and one that has ended, count; waiting does not."""
    at_work: list[int] = []
    clock = Clock(TrainingProgress(1), lambda: at_work)
    work = "import time\nwhile time.process_time() < 0.5: pass\nprint(flush=True)\ninput()"
    before = clock.processor_seconds
    other = subprocess.Popen([sys.executable, "-c", work], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    other.stdout.readline()
    time.sleep(0.5)
    assert clock.processor_seconds - before < 0.4
    at_work.append(other.pid)
    while_at_work = clock.processor_seconds - before
    assert 0.45 < while_at_work < 1.2
    at_work.clear()
    other.communicate(b"\n")
    assert 0.45 < clock.processor_seconds - before < 1.2
