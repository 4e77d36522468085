"""A replay of image transitions that stores every depth image once.

A transition holds two stacks of four images, but a step of the environment brings one new image: stored as they come,
50,000 transitions of 80 x 64 pixels take 2.0 GB, stored once they take 0.27 GB. ``make_replay`` builds TorchRL's replay
buffer from TorchRL's parts (storage, sampler, n-step returns, checkpoints) and ``SharedFrames``, the transform that
puts image numbers in place of images on the way in and looks the images up on the way out.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl import logger
from torchrl.data import LazyTensorStorage, PrioritizedSampler, RandomSampler, TensorDictReplayBuffer
from torchrl.data.replay_buffers.storages import Storage
from torchrl.envs.transforms import Compose, MultiStepTransform, Transform

from navsim.errors import counted
from rl.mirror import MirroredHalf
from rl.observation import DEPTH_AND_HEADING, NUM_FRAMES, Input, check_inputs, history_length, keys_of

PRIORITY_EXPONENT = 0.3
"""α of prioritised replay: 0.6 in Schaul et al. 2016 (arXiv 1511.05952), halved for squared errors."""

IMPORTANCE_EXPONENT = 0.4
"""β of prioritised replay, from the same article."""


def make_replay(
    capacity: int,
    height: int = 64,
    width: int = 80,
    *,
    batch_size: int,
    n_step: int = 1,
    gamma: float = 0.99,
    prioritized: bool = False,
    mirror: bool = False,
    inputs: Collection[Input] = DEPTH_AND_HEADING,
    frame_interval: int = 1,
    generator: torch.Generator | None = None,
) -> TensorDictReplayBuffer:
    """TorchRL's replay buffer for ``NavEnv``'s transitions, with shared images.

    ``extend`` takes what one collector yields, batches ``(N, T)`` of the same N environments and T steps, in order (not
    those of TorchRL's ``MultiAsyncCollector``, whose workers take turns; ``MultiSyncCollector``'s are, which
    ``Collector(..., num_collectors=n)`` is with ``sync=True``, with ``cat_results`` "stack" or 0); ``sample``
    returns ``batch_size`` transitions with the keys ``depth``, ``heading``, ``action``, ``steps_to_next_obs``,
    ``index`` and ``next``: ``depth``, ``heading``, ``reward``, ``done``, ``terminated``; what ``inputs`` names besides,
    of both states; if prioritised, also ``priority_weight``. The last ``n_step`` steps of each environment wait until
    the steps after them are known.

    Args:
        capacity: transitions kept; a new one replaces the oldest.
        height: of the depth images, pixels.
        width: of the depth images, pixels.

    Keyword Args:
        batch_size: of a sample.
        n_step: rewards summed into one, as far as the episode goes; ``next`` is the observation after the last of them.
        gamma: discount of the sum, a step.
        prioritized: whether large errors are sampled more often (``update_tensordict_priority`` after the loss).
        mirror: whether half of each sample is mirrored, see ``rl.mirror.MirroredHalf``.
        inputs: what the network sees; what is among them besides depth and heading is kept, too.
        frame_interval: of the environments: steps from one image of a stack to the next.
        generator: of the sampled indices; by default, one seeded from torch's global generator.

    Raises:
        ValueError: for a capacity, batch size, number of steps or interval below 1, for inputs that there are not, and
            for half a sample of one.

    Sampling from another thread than the one that extends (TorchRL's ``prefetch``) is not supported, and neither are
    several processes that write to it (``replay_buffer=`` of TorchRL's multi-process collectors): extend it with what
    they yield.

    >>> replay = make_replay(100, height=10, width=14, batch_size=8)
    >>> stack = torch.zeros(2, 5, 4, 10, 14, dtype=torch.uint8)
    >>> seen, flag = {"depth": stack, "heading": torch.zeros(2, 5, 1)}, torch.zeros(2, 5, 1, dtype=torch.bool)
    >>> after = {**seen, "reward": torch.zeros(2, 5, 1), "done": flag, "terminated": flag}
    >>> batch = TensorDict({**seen, "action": torch.zeros(2, 5, dtype=torch.int64), "next": after}, [2, 5])
    >>> indices = replay.extend(batch)
    >>> replay.sample()["next", "depth"].shape
    torch.Size([8, 4, 10, 14])
    """
    for name, value in (
        ("capacity", capacity),
        ("batch_size", batch_size),
        ("n_step", n_step),
        ("frame_interval", frame_interval),
    ):
        if value < 1:
            raise ValueError(f"{name} of a replay must be at least 1; got {value}")
    check_inputs(inputs)
    if mirror and batch_size < 2:
        raise ValueError(f"half of each sample cannot be mirrored where it is of {batch_size}; use mirror=False")
    if generator is None:
        generator = torch.Generator().manual_seed(int(torch.randint(2**63 - 1, ())))
    storage = _ZeroedStorage(capacity)
    frames = SharedFrames(
        storage, height, width, n_step=n_step, gamma=gamma, inputs=inputs, frame_interval=frame_interval
    )
    transforms: list[Transform] = [frames]
    if mirror:
        transforms.append(MirroredHalf())
    return _StreamReplay(
        storage=storage,
        sampler=ArrayPrioritizedSampler(capacity) if prioritized else RandomSampler(),
        transform=Compose(*transforms),
        batch_size=batch_size,
        generator=generator,
    )


class _StreamReplay(TensorDictReplayBuffer):
    """For streams of steps, some of which wait in its first transform, ``SharedFrames``."""

    def add(self, data: TensorDictBase) -> int:
        """Raises ValueError: a step alone has no place in a stream."""
        raise ValueError(
            "a replay of streams is fed by batches (N, T): extend(step.unsqueeze(-1)) for one step of N robots"
        )

    def __getitem__(self, index: Any) -> Any:
        """What is stored, as it was; only samples are mirrored."""
        mirrors = [transform for transform in self._transform if isinstance(transform, MirroredHalf)]
        for mirror in mirrors:
            mirror.at_rest = True
        try:
            return super().__getitem__(index)
        finally:
            for mirror in mirrors:
                mirror.at_rest = False

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``.

        Raises:
            ValueError: for the state of a replay that was made with other arguments; then nothing is changed.
        """
        self._transform[0].refuse_another(state_dict["_transforms"]["transforms.0._extra_state"])  # as modules name it
        super().load_state_dict(state_dict)

    def empty(self, empty_write_count: bool = True) -> None:
        """Forgets all transitions, and the steps that wait for their n-step return."""
        super().empty(empty_write_count)
        self._transform[0].forget()


class _ZeroedStorage(LazyTensorStorage):
    """Begins with zeros in place of whatever the memory held, which checkpoints would keep."""

    def _init(self, *args: Any, **settings: Any) -> None:
        super()._init(*args, **settings)
        self._storage.zero_()


class FrameStore:
    """Numbered images, and room made by forgetting those whose numbers nobody holds any more.

    Memory is reserved for ``most`` images, but the operating system provides it only where it is written to, and low
    numbers are given first, so what is used is what is needed.

    Args:
        expected: images to have room for before the first sweep.
        most: images to reserve memory for; more are possible, at the price of a copy of all.
        height: pixels.
        width: pixels.
    """

    def __init__(self, expected: int, most: int, height: int, width: int) -> None:
        self._slack = max(16, expected // 32)
        self._images = np.empty((max(most, expected + self._slack), height, width), np.uint8)
        self._free = np.empty(0, np.int32)
        self._size = 0
        self._grow(expected + self._slack)

    def __len__(self) -> int:
        """Images that there is room for."""
        return self._size

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width."""
        return self._images.shape[1], self._images.shape[2]

    def reserve(self, count: int, held: Callable[[], Iterable[np.ndarray]]) -> np.ndarray:
        """Numbers for new images.

        Args:
            count: how many.
            held: yields, in arrays of any shape, the numbers that are still in use; asked only if room runs out.

        Returns:
            ``(count,)`` int32.
        """
        if count > len(self._free):
            unused = np.ones(self._size, bool)
            for numbers in held():
                unused[numbers] = False
            self._free = np.flatnonzero(unused)[::-1].astype(np.int32)
            self._grow(count + self._slack - len(self._free))  # else the next sweep would come too soon
        keep = len(self._free) - count
        numbers, self._free = self._free[keep:], self._free[:keep]
        return numbers

    def _grow(self, count: int) -> None:
        if count <= 0:
            return
        size = self._size + count
        if size > len(self._images):
            larger = np.empty((size + size // 4, *self._images.shape[1:]), np.uint8)
            larger[: self._size] = self._images[: self._size]
            self._images = larger
        self._free = np.concatenate([np.arange(self._size, size, dtype=np.int32)[::-1], self._free])
        self._size = int(size)

    def __setitem__(self, numbers: np.ndarray, images: np.ndarray) -> None:
        """Puts images, ``(..., H, W)``, under numbers ``(...)``."""
        self._images[numbers] = images

    def __getitem__(self, numbers: np.ndarray) -> np.ndarray:
        """The images, ``(..., H, W)``, under numbers ``(...)``; a copy."""
        return np.take(self._images, numbers, axis=0)  # faster than indexing, and than torch.index_select

    def state_dict(self) -> dict[str, Any]:
        """Everything to go on from; the images are not copied."""
        written = 1 + int(np.setdiff1d(np.arange(self._size), self._free, assume_unique=True).max(initial=-1))
        return {
            "images": torch.from_numpy(self._images[:written]),
            "free": torch.from_numpy(self._free.copy()),
            "size": self._size,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``.

        Raises:
            ValueError: if its images are of another size.
        """
        images, size = state_dict["images"].numpy(), state_dict["size"]
        if images.shape[1:] != self._images.shape[1:]:
            raise ValueError(
                f"the saved replay holds images of {images.shape[2]} x {images.shape[1]} pixels, this one is for"
                f" {self._images.shape[2]} x {self._images.shape[1]}; use the saved run's image size"
            )
        if size > len(self._images):
            self._images = np.empty((size, *images.shape[1:]), np.uint8)
        self._images[: len(images)] = images
        self._free, self._size = state_dict["free"].numpy().copy(), size


class SharedFrames(MultiStepTransform):
    """TorchRL's n-step returns over transitions whose images are stored once.

    On the way in, stacks of images become stacks of numbers of images in a ``FrameStore``: every step brings one new
    image, the newest of ``next``; an episode's first step also its first. On the way out, numbers become images again.
    An image is forgotten once no transition holds its number, neither in the storage nor waiting for its n-step return.

    A step continues the one before it if its images and heading are the other's next ones, byte for byte. Where a
    stream of steps breaks without ``done`` (a collector was reset, or a run resumed from a checkpoint), it counts as
    cut off there by a time limit: n-step returns stop, and bootstrap from the last observation.

    ``MultiStepTransform`` itself keeps ``done`` and ``terminated`` of the first of the n steps, so that a return which
    reaches a terminal step is bootstrapped from beyond it; here they are those of the last step. It also leaves the
    steps that wait out of checkpoints; here they are in.

    Args:
        storage: of the replay buffer that this transform belongs to, one-dimensional.
        height: of the images, pixels.
        width: of the images, pixels.
        n_step: rewards summed into one.
        gamma: discount a step.
        inputs: what is kept besides depth and heading.
        frame_interval: steps from one image of a stack to the next. From 2 on, where a stream of steps begins or
            breaks, all images of the stack must be the same one, as ``NavEnv`` has them at an episode's beginning:
            those in between are not known.
    """

    requires_shared_write_state = True  # TorchRL then refuses to have several processes write to it

    def __init__(
        self,
        storage: Storage,
        height: int,
        width: int,
        *,
        n_step: int,
        gamma: float,
        inputs: Collection[Input] = DEPTH_AND_HEADING,
        frame_interval: int = 1,
    ) -> None:
        super().__init__(n_step, gamma, done_keys=[])
        observed = keys_of(inputs)
        self._keys = (*observed, "action", *(("next", key) for key in (*observed, "reward", "done", "terminated")))
        self._interval = frame_interval
        self._storage = storage
        self._frames = FrameStore(storage.max_size, 2 * storage.max_size, height, width)
        self._made_with = {
            "capacity": storage.max_size,
            "height": height,
            "width": width,
            "n_step": n_step,
            "gamma": float(gamma),
            "inputs": list(observed),
            "frame_interval": frame_interval,
        }
        self._current: np.ndarray | None = None
        self._running: np.ndarray | None = None
        self._times_lost = 0
        """Batches in a row that went on with no episode of the one before."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Looks up the images of records that were read from the storage."""
        tensordict = tensordict.copy()  # what is read as a whole is the storage itself
        for key in ("depth", ("next", "depth")):
            tensordict.set(key, torch.from_numpy(self._frames[tensordict.get(key).numpy()]))
        # As rewards have it, which losses of several values a state raise discounts for.
        tensordict.set("steps_to_next_obs", tensordict.get("steps_to_next_obs").unsqueeze(-1))
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase | None:
        """Records, one-dimensional and oldest first, of the steps whose n-step return is known by now."""
        self._refuse_misfits(tensordict)
        steps = tensordict.select(*self._keys).to("cpu")
        steps = steps.reshape(-1, steps.shape[-1])
        depth, next_depth = steps.pop("depth"), steps.pop(("next", "depth"))
        # A copy, as collectors may write their next batch into the same memory; and no lazy stack, of which a part that
        # is written to is a copy, too.
        steps = steps.clone() if isinstance(steps, TensorDict) else steps.to_tensordict()
        done = steps["next", "done"].squeeze(-1).numpy()
        headings = steps["heading"].numpy(), steps["next", "heading"].numpy()
        numbers, next_numbers = self._number(depth.numpy(), next_depth.numpy(), *headings, done)
        steps.set("depth", torch.from_numpy(numbers))
        steps.set(("next", "depth"), torch.from_numpy(next_numbers))
        records = super()._inv_call(steps)
        if records is None:
            return None
        records = records.select(*self._keys, "steps_to_next_obs").transpose(0, 1).reshape(-1)
        return records[-self._storage.max_size :]

    def forget(self) -> None:
        """Begins anew: what comes next continues nothing."""
        self._buffer = self._current = self._running = None

    def _refuse_misfits(self, steps: TensorDictBase) -> None:
        """Raises ValueError for what is no batch of streams of transitions with images of the replay's size."""
        if not steps.ndim:
            raise ValueError("a transition alone has no place in a stream; give batches (N, T), or (T,), to extend")
        if -1 in steps.shape:  # a lazy stack of different ones
            raise ValueError(
                f"of a batch of shape {tuple(steps.shape)} not all parts are alike: let each of a collector's "
                "environments have as many robots (num_envs) as the others, or extend a replay of its own with each"
            )
        mask = steps.get(("collector", "mask"), None)
        if mask is not None and not mask.all():
            raise ValueError(
                f"of {mask.numel()} steps {mask.numel() - int(mask.sum())} are padding after episodes' ends, no "
                "transitions: have the collector yield batches (N, T) as they come, without split_trajs and "
                "preemptive_threshold, and give one with trajs_per_batch this replay (replay_buffer=)"
            )
        if missing := [key for key in self._keys if key not in steps.keys(include_nested=True)]:
            raise ValueError(f"transitions need {missing[0]!r}; a collector leaves it out with compact_obs=True")
        depth, wanted = steps["depth"], (NUM_FRAMES, *self._frames.image_shape)
        if depth.dtype != torch.uint8:
            raise ValueError(
                f"the replay stores depth as the environment gives it, uint8; got {depth.dtype}: divide by 255 in the "
                "network, in place of a transform"
            )
        if depth.shape[-3:] != wanted:
            raise ValueError(
                f"the replay is for depth images of shape {wanted} (frames, height, width); got "
                f"{tuple(depth.shape[-3:])}: give make_replay the height and width of the environment's camera"
            )
        if steps.shape[-1] > 1:
            _refuse_other_orders(steps)

    def _number(
        self,
        depth: np.ndarray,
        next_depth: np.ndarray,
        heading: np.ndarray,
        next_heading: np.ndarray,
        done: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stores the new images of a batch, and marks in ``done`` where its streams break.

        Args:
            depth: ``(N, T, 4, H, W)``.
            next_depth: ``(N, T, 4, H, W)``.
            heading: ``(N, T, 1)``.
            next_heading: ``(N, T, 1)``.
            done: ``(N, T)``, changed in place.

        Returns:
            numbers of the images in ``depth`` and ``next_depth``, ``(N, T, 4)`` int32.
        """
        n, t = done.shape
        is_first = self._current is None
        if self._current is None or self._running is None:
            self._current, self._running = np.zeros((n, history_length(self._interval)), np.int32), np.zeros(n, bool)
        if n != len(self._current):
            raise ValueError(
                f"a replay is fed by one collector; it knows {len(self._current)} environments, and now got {n}"
            )
        continues = np.empty((n, t), bool)
        # Images may go on where an episode has ended: a collector has called it truncated, and not begun another.
        continues[:, 0] = _same(depth[:, 0], self._frames[self._seen(self._current)], leading=1) & (not is_first)
        if self._buffer is not None:
            continues[:, 0] &= _same(heading[:, 0], self._buffer["next", "heading"][:, -1].numpy(), leading=1)
        self._mark_cut(self._running & ~continues[:, 0])
        lost = self._running.any() and not continues[:, 0].any()
        continues[:, 1:] = _same(depth[:, 1:], next_depth[:, :-1], leading=2)
        continues[:, 1:] &= _same(heading[:, 1:], next_heading[:, :-1], leading=2)
        done[:, :-1] |= ~continues[:, 1:]

        starts = depth[~continues]
        fresh = np.ones(starts.shape[:2], bool)  # an episode's first stack is one image, repeated
        fresh[:, 1:] = ~_same(starts[:, 1:], starts[:, :-1], leading=2)
        if self._interval > 1 and fresh[:, 1:].any():
            raise ValueError(
                f"a stream of steps begins with images that differ, and what lies between them, with {self._interval} "
                "steps from one to the next, is not known; begin with an episode's first step, and give a collector "
                "of several processes sync=True, else they take turns"
            )
        # Once, after a collector's reset or a run's interruption, is what may be.
        self._times_lost = self._times_lost + 1 if lost and fresh[:, 1:].any() else 0
        if self._times_lost == 2:
            warnings.warn(
                "two batches in a row begin in the midst of episodes that are not those of the batch before, so that "
                "every batch's end cuts returns off; if a collector of several processes makes them, give it sync=True",
                stacklevel=2,
            )
        new = self._frames.reserve(n * t + np.count_nonzero(fresh), self._held)
        newest, first = new[: n * t].reshape(n, t), new[n * t :]
        self._frames[newest] = next_depth[:, :, -1]
        self._frames[first] = starts[fresh]

        current = self._current
        begun = np.zeros((n, t, current.shape[1]), np.int32)
        begun[~continues] = first[np.cumsum(fresh) - 1].reshape(fresh.shape)[
            :, np.arange(current.shape[1]) // self._interval
        ]
        numbers = np.empty((n, t, depth.shape[2]), np.int32)
        next_numbers = np.empty_like(numbers)
        for step in range(t):
            current = np.where(continues[:, step, None], current, begun[:, step])
            numbers[:, step] = self._seen(current)
            current = np.concatenate([current[:, 1:], newest[:, step, None]], axis=1)
            next_numbers[:, step] = self._seen(current)
        if not np.array_equal(self._frames[next_numbers[:, :, :-1]], next_depth[:, :, :-1]):
            raise ValueError(
                f'("next", "depth") must be "depth" moved on by one step, the newest image last, with {self._interval} '
                "steps from one image to the next (frame_interval)"
            )
        self._current, self._running = current, ~done[:, -1]
        return numbers, next_numbers

    def _seen(self, history: np.ndarray) -> np.ndarray:
        """Of a history ``(N, K)`` those that are in the stack, ``(N, 4)``."""
        return history[:, :: self._interval]

    def _mark_cut(self, cut: np.ndarray) -> None:
        """Ends the streams ``(N,)`` at their last step, which waits for its n-step return."""
        if self._buffer is not None:
            self._buffer["next", "done"][:, -1, 0] |= torch.from_numpy(cut)

    def _held(self) -> Iterator[np.ndarray]:
        """Numbers of all images that are still needed."""
        if self._current is not None:
            yield self._current
        for records in (self._buffer, self._storage.get(slice(None)) if len(self._storage) else None):
            if records is not None:
                yield records["depth"].numpy()
                yield records["next", "depth"].numpy()

    def get_extra_state(self) -> dict[str, Any]:
        """The images, and what is known of the environments' present steps."""
        return {
            "made_with": dict(self._made_with),
            "frames": self._frames.state_dict(),
            "current": None if self._current is None else torch.from_numpy(self._current),
            "running": None if self._running is None else torch.from_numpy(self._running),
            "waiting": None if self._buffer is None else dict(self._buffer.flatten_keys(".").items()),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Goes on from ``get_extra_state``.

        Raises:
            ValueError: for a replay's that was made with other arguments.
        """
        self.refuse_another(state)
        self._frames.load_state_dict(state["frames"])
        self._current, self._running = (
            None if state[name] is None else state[name].numpy().copy() for name in ("current", "running")
        )
        waiting = state["waiting"]
        self._buffer = None
        if waiting is not None:
            self._buffer = TensorDict(waiting, waiting["action"].shape).unflatten_keys(".").clone()

    def refuse_another(self, state: dict[str, Any]) -> None:
        """Raises ValueError for the state of a replay that was made with other arguments."""
        made_with = state.get("made_with", {})  # earlier versions do not tell
        for name, own in self._made_with.items():
            if name in made_with and made_with[name] != own:
                raise ValueError(
                    f"the saved replay was made with {name}={made_with[name]!r}, and this one with {own!r}; make it "
                    "with the same arguments"
                )


def _refuse_other_orders(steps: TensorDictBase) -> None:
    """Raises ValueError for steps ``(T,)`` of which none goes on where the one before it, or an episode, ended, and for
    those ``(..., N, T)`` of which this is so as well, and which do so in the order of N."""
    if _go_on(steps).any():
        return
    if steps.ndim == 1:
        raise ValueError(
            f"of {len(steps)} steps in a row none goes on where the one before it ended: they look like one step of "
            f"{len(steps)} environments; give batches (N, T), this one as extend(step.unsqueeze(-1))"
        )
    if steps.shape[-2] > 1 and _go_on(steps.transpose(-1, -2)).all():
        raise ValueError(
            f"a batch of shape {tuple(steps.shape)} looks like {counted(steps.shape[-2], 'step')} of "
            f"{counted(steps.shape[-1], 'environment')}: give batches (N, T), as torch.stack(steps, -1) makes them"
        )


def _go_on(steps: TensorDictBase) -> Tensor:
    """Which steps ``(..., T)`` go on where those before them ended, or follow an episode's end: ``(..., T - 1, 1)``."""
    headings, next_headings = steps["heading"], steps["next", "heading"]
    return (headings[..., 1:, :] == next_headings[..., :-1, :]) | steps["next", "done"][..., :-1, :]


def _same(one: np.ndarray, other: np.ndarray, leading: int) -> np.ndarray:
    """Whether two arrays are equal, for every place of their first ``leading`` axes."""
    return (one == other).all(axis=tuple(range(leading, one.ndim)))


class ArrayPrioritizedSampler(PrioritizedSampler):
    """TorchRL's proportional prioritised sampler, with plain arrays for its compiled segment trees.

    TorchRL's trees work only with the version of PyTorch they were compiled for. Summing an array takes longer than
    climbing a tree, but not long: 0.1 ms a sample from 50,000 transitions.

    Args:
        capacity: of the storage.
    """

    def __init__(self, capacity: int) -> None:
        disabled, logger.disabled = logger.disabled, True  # it would warn of the missing trees
        super().__init__(capacity, PRIORITY_EXPONENT, IMPORTANCE_EXPONENT)
        logger.disabled = disabled

    def _init(self) -> None:
        self._sum_tree = _SumArray(self._max_capacity)
        self._min_tree = _MinArray(self._max_capacity)
        self._max_priority = None

    def state_dict(self) -> dict[str, Any]:
        """TorchRL's, with tensors in place of objects, which nothing is loaded of that executes no code."""
        state = super().state_dict()
        return state | {name: state[name].values.clone() for name in _TREES}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``."""
        trees = {name: getattr(self, name) for name in _TREES}
        for name, tree in trees.items():
            tree.values.copy_(state_dict[name])
        super().load_state_dict({**state_dict, **trees})


_TREES = ("_sum_tree", "_min_tree")


class _Array:
    """The part of a compiled segment tree's interface that ``PrioritizedSampler`` uses, on an array."""

    neutral: float

    def __init__(self, size: int) -> None:
        self.values = torch.full((size,), self.neutral, dtype=torch.float64)

    def __getitem__(self, index: Tensor | int) -> Tensor | float:
        return self.values[index].float() if isinstance(index, Tensor) else self.values[index].item()

    def __setitem__(self, index: Tensor | int, value: Tensor | float) -> None:
        self.values[index] = torch.as_tensor(value, dtype=torch.float64)


class _SumArray(_Array):
    neutral = 0.0

    def query(self, first: int, last: int) -> float:
        return self.values[first:last].sum().item()

    def scan_lower_bound(self, mass: Tensor) -> Tensor:
        return torch.searchsorted(self.values.cumsum(0), mass.double(), right=True)


class _MinArray(_Array):
    neutral = math.inf

    def query(self, first: int, last: int) -> float:
        return self.values[first:last].min().item()
