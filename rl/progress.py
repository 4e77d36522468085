"""What a training run has done so far: counters, and the rates and means that a person watches."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import torch
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text
from tensordict import TensorDictBase

from navsim.processes import family_processor_seconds

RECENT_EPISODES = 200
"""Finished episodes that rates and means are taken over."""


class TrainingProgress:
    """Counts transitions and episodes, and keeps the outcomes of the most recent ones.

    Args:
        num_envs: robots that are simulated together.
    """

    def __init__(self, num_envs: int) -> None:
        self.step = 0
        self.episodes = 0
        self.seconds = 0.0
        self.processor_seconds = 0.0
        self._reward = torch.zeros(num_envs)
        self._length = torch.zeros(num_envs)
        self._recent: deque[tuple[float, float, float, float]] = deque(maxlen=RECENT_EPISODES)
        self._losses: deque[float] = deque(maxlen=500)
        self._q: deque[float] = deque(maxlen=500)

    def count(self, batch: TensorDictBase) -> None:
        """Takes in a collector's batch ``(N, T)``."""
        following = batch["next"]
        columns = [following[key].squeeze(-1) for key in ("reward", "done", "success", "collision")]
        for reward, done, success, collision in zip(*(column.unbind(1) for column in columns), strict=True):
            self._reward += reward
            self._length += 1
            for robot in torch.nonzero(done).flatten().tolist():
                self._recent.append(
                    (
                        float(success[robot]),
                        float(collision[robot]),
                        float(self._reward[robot]),
                        float(self._length[robot]),
                    )
                )
                self.episodes += 1
            self._reward[done] = 0.0
            self._length[done] = 0.0
        self.step += batch.numel()

    def learnt(self, loss: torch.Tensor, chosen_q: torch.Tensor) -> None:
        """Takes in an update's loss and the Q-values ``(B,)`` of the actions in its batch."""
        self._losses.append(float(loss))
        self._q.append(float(chosen_q.mean()))

    def row(self) -> dict[str, Any]:
        """What there is to log; None where there is nothing yet."""
        success, collision, reward, length = self._means()
        return {
            "step": self.step,
            "episodes": self.episodes,
            "seconds": self.seconds,
            "processor_seconds": self.processor_seconds,
            "success_rate": success,
            "collision_rate": collision,
            "timeout_rate": None if success is None or collision is None else max(0.0, 1.0 - success - collision),
            "reward": reward,
            "episode_length": length,
            "loss": _mean(self._losses),
            "q_mean": _mean(self._q),
        }

    def status(self) -> str:
        """The same in a few words, for the progress bar."""
        row = self.row()
        parts = []
        if row["success_rate"] is not None:
            parts.append(f"success {row['success_rate']:.0%}  reward {row['reward']:+.2f}")
        if row["loss"] is not None:
            parts.append(f"loss {row['loss']:.4f}  Q {row['q_mean']:+.2f}")
        return "  ".join(parts) or "filling the replay"

    def _means(self) -> tuple[float | None, ...]:
        if not self._recent:
            return (None,) * 4
        return tuple(sum(column) / len(column) for column in zip(*self._recent, strict=True))

    def state_dict(self) -> dict[str, Any]:
        """Counters, recent outcomes, and what the episodes under way have come to."""
        return {
            "reward": self._reward.clone(),
            "length": self._length.clone(),
            "step": self.step,
            "episodes": self.episodes,
            "seconds": self.seconds,
            "processor_seconds": self.processor_seconds,
            "recent": list(self._recent),
            "losses": list(self._losses),
            "q": list(self._q),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``."""
        self.step, self.episodes = state_dict["step"], state_dict["episodes"]
        self.seconds, self.processor_seconds = state_dict["seconds"], state_dict["processor_seconds"]
        self._recent.extend(tuple(entry) for entry in state_dict["recent"])
        self._losses.extend(state_dict["losses"])
        self._q.extend(state_dict["q"])
        self._reward, self._length = state_dict["reward"].clone(), state_dict["length"].clone()

    def abandon_episodes(self) -> None:
        """Forgets the episodes under way: all robots begin new ones."""
        self._reward.zero_()
        self._length.zero_()


class Clock:
    """Seconds of a run, those before an interruption included, and its present speed.

    Args:
        progress: how far the run was before.
        children: yields the numbers of the processes that work for this one, as they are then.
    """

    def __init__(self, progress: TrainingProgress, children: Callable[[], Iterable[int]]) -> None:
        self._begin = time.perf_counter() - progress.seconds
        self._children = children
        self._processor_begin = family_processor_seconds(children()) - progress.processor_seconds
        self._marks: deque[tuple[float, int]] = deque([(progress.seconds, progress.step)], maxlen=64)

    @property
    def seconds(self) -> float:
        """Since the beginning of the run."""
        return time.perf_counter() - self._begin

    @property
    def processor_seconds(self) -> float:
        """Processor time of all the run's processes and their threads, which other programs do not lengthen."""
        return family_processor_seconds(self._children()) - self._processor_begin

    def tick(self, step: int) -> float:
        """Transitions a second, over the last few dozen ticks."""
        self._marks.append((self.seconds, step))
        (first_second, first_step), (last_second, last_step) = self._marks[0], self._marks[-1]
        return (last_step - first_step) / max(last_second - first_second, 1e-9)


class _StatusBelow(Progress):
    """A progress bar with its task's status on a line of its own, as one line has no room for both."""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        for task in self.tasks:
            yield Text(task.fields["status"])


def progress_bar(console: Console | None) -> Progress:
    """A bar with the share done, speed and time left; under it, what the learner is like."""
    return _StatusBelow(
        TextColumn("[bold]training"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f}%"),
        TextColumn("{task.fields[speed]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        refresh_per_second=2,
    )


def _mean(values: deque[float]) -> float | None:
    return sum(values) / len(values) if values else None
