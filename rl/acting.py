"""Policies as those who drive robots with them see them: what they are wrapped in, where they are, what they answer."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase


def answered(answer: Any, count: int) -> TensorDictBase:
    """What a policy says of ``count`` robots; one that returns a tensor or an array alone returns actions."""
    if isinstance(answer, torch.Tensor | np.ndarray):
        answer = {"action": torch.as_tensor(answer)}
    if isinstance(answer, Mapping):
        answer = TensorDict(dict(answer), [count])
    if not isinstance(answer, TensorDictBase):
        raise ValueError(f"a policy must return a tensordict or the actions; got {type(answer).__name__}")
    return answer


@contextmanager
def one_thread() -> Iterator[None]:
    """Products are computed by one thread: shared out among others, their sums might differ in the last digit."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def seeded(device: torch.device, seed: int) -> Iterator[None]:
    """Seeds torch's generators of the CPU and of a policy's device for a while; no other device's is touched."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.default_generator.manual_seed(seed)
        if device.type == "cuda":
            with torch.cuda.device(device):
                torch.cuda.manual_seed(seed)
        yield


def of_policy(policy: object, name: str) -> Any:
    """An attribute of a policy, or of the module that it wraps, such as torch's ``AveragedModel`` does; else None."""
    while not hasattr(policy, name) and isinstance(inner := getattr(policy, "module", None), torch.nn.Module):
        policy = inner
    return getattr(policy, name, None)


def device_of(policy: object) -> torch.device:
    """Where a policy's weights are; the CPU if it has none."""
    if isinstance(policy, torch.nn.Module):
        for tensor in itertools.chain(policy.parameters(), policy.buffers()):
            return tensor.device
    return torch.device("cpu")


@contextmanager
def evaluation_mode(policy: Any) -> Iterator[None]:
    """Modules are switched to evaluation, and each back to what it was."""
    if not isinstance(policy, torch.nn.Module):
        yield
        return
    were_training = {module: module.training for module in policy.modules()}
    policy.eval()
    try:
        yield
    finally:
        for module, was_training in were_training.items():
            module.training = was_training
