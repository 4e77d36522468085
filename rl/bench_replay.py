"""What the replay costs, beside TorchRL's plain storage, its ``CatFrames`` on the way out, and Stable-Baselines3's."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer, TensorDictReplayBuffer
from torchrl.envs.transforms import CatFrames

from rl.memory import keep_freed_memory
from rl.observation import NUM_FRAMES
from rl.replay import make_replay
from rl.run import processor

SIZES = ((64, 80), (128, 160))
"""Heights and widths."""
BATCH_SIZE = 64
_ENVS, _STEPS = 16, 25
_SAMPLES, _LEAST_SAMPLES, _SECONDS = 200, 3, 2.0
_MEASURED_EXTENSIONS = 20


class Measurement(NamedTuple):
    """One way to store transitions of one image size."""

    name: str
    height: int
    width: int
    megabytes: float
    """of what is stored, once full"""
    microseconds_a_transition: float
    """to store one, from batches of 400"""
    milliseconds_a_sample: float
    """of 64 transitions, median; both are processor time"""


class Streams:
    """Batches ``(16, 25)`` of random transitions, as a collector yields them; a step in twenty-five ends an episode.

    Args:
        height: pixels.
        width: pixels.
    """

    def __init__(self, height: int, width: int) -> None:
        self._random = np.random.default_rng(0)
        self._shape = (height, width)
        self._stack = np.repeat(self._images((_ENVS, 1)), NUM_FRAMES, axis=1)
        self._heading = torch.rand(_ENVS, 1)

    def _images(self, shape: tuple[int, ...]) -> np.ndarray:
        return self._random.integers(0, 256, (*shape, *self._shape), np.uint8)

    def batch(self) -> TensorDict:
        """The next 400 transitions."""
        fresh = self._images((_ENVS, _STEPS))
        depth = np.empty((_ENVS, _STEPS, NUM_FRAMES, *self._shape), np.uint8)
        after = np.empty_like(depth)
        done = self._random.random((_ENVS, _STEPS)) < 0.04
        flag = torch.from_numpy(done).unsqueeze(-1)
        heading, heading_after = torch.rand(2, _ENVS, _STEPS, 1)
        for step in range(_STEPS):
            depth[:, step], heading[:, step] = self._stack, self._heading
            after[:, step, :-1], after[:, step, -1] = self._stack[:, 1:], fresh[:, step]
            self._stack = after[:, step].copy()
            ended = done[:, step]
            self._stack[ended] = np.repeat(self._images((int(ended.sum()), 1)), NUM_FRAMES, axis=1)
            self._heading = torch.where(flag[:, step], torch.rand(_ENVS, 1), heading_after[:, step])
        reward = torch.rand(_ENVS, _STEPS, 1)
        following = {"depth": torch.from_numpy(after), "heading": heading_after, "reward": reward}
        return TensorDict(
            {
                "depth": torch.from_numpy(depth),
                "heading": heading,
                "action": torch.randint(0, 7, (_ENVS, _STEPS)),
                "next": {**following, "done": flag, "terminated": flag.clone()},
            },
            [_ENVS, _STEPS],
        )


class _Contestant(NamedTuple):
    name: str
    extend: Callable[[TensorDict], Any]
    sample: Callable[[], Any]
    bytes: Callable[[], int]


def run(console: Console, *, peers: bool = False, capacity: int = 50_000) -> list[Measurement]:
    """Prints memory and time of every way to store transitions, full.

    Ways that need more memory than is free are left out, and it is said.

    Args:
        console: where to.
        peers: whether Stable-Baselines3 is measured, too.
        capacity: transitions.

    Raises:
        ValueError: for peers that are not installed, and a capacity below 400.
    """
    if capacity < _ENVS * _STEPS:
        raise ValueError(f"--capacity must be at least {_ENVS * _STEPS}, one batch; got {capacity}")
    if peers:
        _stable_baselines_buffer()  # before anything is measured that its absence would throw away
    keep_freed_memory()
    torch.set_num_threads(1)
    measured = []
    for height, width in SIZES:
        makers = [_ours, _ours_prioritized, _plain, _cat_frames, *([_stable_baselines] if peers else [])]
        for make in track(
            makers, f"{width}x{height}", console=console, transient=True, disable=not console.is_terminal
        ):
            needed = _bytes_needed(make, capacity, height, width)
            if needed > _available_memory():
                console.print(f"{make.__doc__}, {width}x{height}: left out, it needs {needed / 1e9:.1f} GB")
                continue
            measured.append(_measure(make(capacity, height, width), capacity, height, width))
    console.print(
        f"[bold]replays of {capacity:,} transitions[/bold], samples of {BATCH_SIZE}, one thread, {processor()}"
    )
    console.print(_table(measured))
    return measured


def _measure(contestant: _Contestant, capacity: int, height: int, width: int) -> Measurement:
    streams = Streams(height, width)
    batches = -(-capacity // (_ENVS * _STEPS)) + 2
    seconds = []
    for _ in range(batches):
        batch = streams.batch()
        begin = time.process_time()
        contestant.extend(batch)
        seconds.append(time.process_time() - begin)
    samples: list[float] = []
    while len(samples) < _LEAST_SAMPLES or (len(samples) < _SAMPLES and sum(samples) < _SECONDS):
        begin = time.process_time()
        contestant.sample()
        samples.append(time.process_time() - begin)
    return Measurement(
        contestant.name,
        height,
        width,
        contestant.bytes() / 1e6,
        1e6 * statistics.median(seconds[-_MEASURED_EXTENSIONS:]) / (_ENVS * _STEPS),
        1e3 * statistics.median(samples),
    )


def _ours(capacity: int, height: int, width: int, *, prioritized: bool = False) -> _Contestant:
    """frames once"""
    replay = make_replay(capacity, height, width, batch_size=BATCH_SIZE, prioritized=prioritized)

    def size() -> int:
        return len(replay.transform[0]._frames) * height * width + replay.storage.get(slice(None)).bytes()

    name = "frames once, prioritised" if prioritized else "frames once"
    return _Contestant(name, replay.extend, replay.sample, size)


def _ours_prioritized(capacity: int, height: int, width: int) -> _Contestant:
    """frames once, prioritised"""
    return _ours(capacity, height, width, prioritized=True)


def _plain(capacity: int, height: int, width: int) -> _Contestant:
    """TorchRL, stacks as they come"""
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(capacity), batch_size=BATCH_SIZE)
    return _Contestant(
        "TorchRL, stacks as they come",
        lambda batch: replay.extend(batch.reshape(-1)),
        replay.sample,
        lambda: replay.storage.get(slice(None)).bytes(),
    )


def _cat_frames(capacity: int, height: int, width: int) -> _Contestant:
    """TorchRL, newest frames, stacked by CatFrames"""
    # CatFrames' own recipe: it stores the newest frame of s and of s', and samples slices of four steps to stack.
    catframes = CatFrames(N=NUM_FRAMES, dim=-3, in_keys=["frame"], out_keys=["stack"], reset_key="_reset")
    transform, sampler = catframes.make_rb_transform_and_sampler(BATCH_SIZE, end_key=("next", "done"))
    replay = ReplayBuffer(
        storage=LazyTensorStorage(capacity), sampler=sampler, transform=transform, batch_size=BATCH_SIZE
    )

    def extend(batch: TensorDict) -> None:
        steps = batch.exclude("depth", ("next", "depth"))
        steps["next"] = batch["next"].exclude("depth")
        steps["frame"], steps["next", "frame"] = batch["depth"][:, :, -1:], batch["next", "depth"][:, :, -1:]
        done = steps["next", "done"].clone()
        done[:, -1] = True  # the next environment's steps follow in the storage
        steps["next", "done"] = done
        replay.extend(steps.reshape(-1))

    name = "TorchRL, newest frames, stacked by CatFrames"
    return _Contestant(name, extend, replay.sample, lambda: replay.storage.get(slice(None)).bytes())


def _stable_baselines_buffer() -> Any:
    try:
        from stable_baselines3.common.buffers import ReplayBuffer as StableBaselinesBuffer
    except ImportError as error:
        raise ValueError(f"--peers needs stable-baselines3: pip install 'navsim-rl[peers]' ({error})") from error
    return StableBaselinesBuffer


def _stable_baselines(capacity: int, height: int, width: int) -> _Contestant:
    """Stable-Baselines3"""
    buffer = _stable_baselines_buffer()
    import gymnasium  # which it comes with

    replay = buffer(
        capacity // _ENVS * _ENVS,
        gymnasium.spaces.Box(0, 255, (NUM_FRAMES, height, width), np.uint8),
        gymnasium.spaces.Discrete(7),
        device="cpu",
        n_envs=_ENVS,
    )

    def extend(batch: TensorDict) -> None:
        for step in batch.unbind(1):
            after = step["next"]
            replay.add(
                step["depth"].numpy(),
                after["depth"].numpy(),
                step["action"].numpy(),
                after["reward"].squeeze(-1).numpy(),
                after["done"].squeeze(-1).numpy(),
                [{}] * _ENVS,
            )

    return _Contestant(
        "Stable-Baselines3",
        extend,
        lambda: replay.sample(BATCH_SIZE),
        lambda: replay.observations.nbytes + replay.next_observations.nbytes,
    )


def _bytes_needed(make: Callable[..., _Contestant], capacity: int, height: int, width: int) -> float:
    frames = 1.1 if make in (_ours, _ours_prioritized) else 2.0 if make is _cat_frames else 2.0 * NUM_FRAMES
    return frames * capacity * height * width + 2e8


def _available_memory() -> float:
    with open("/proc/meminfo", encoding="ascii") as file:
        return next(1024.0 * int(line.split()[1]) for line in file if line.startswith("MemAvailable"))


def _table(measured: list[Measurement]) -> Table:
    table = Table()
    for heading in ("replay", "images", "MB", "store one, µs", f"sample {BATCH_SIZE}, ms"):
        table.add_column(heading, justify="left" if heading == "replay" else "right")
    for row in measured:
        table.add_row(
            row.name,
            f"{row.width}x{row.height}",
            f"{row.megabytes:,.0f}",
            f"{row.microseconds_a_transition:,.0f}",
            f"{row.milliseconds_a_sample:.2f}",
        )
    return table
