"""The format that a run's networks multiply in: that in which its own updates take less time here.

How fast a processor multiplies matrices in bfloat16 does not tell. An update of a few samples mostly reads weights and
starts operations, and to multiply in bfloat16 the weights have to be converted and more operations started: with AMX,
which multiplies matrices seven times as fast in it, an update of 8 samples of D3QN-I takes 15.9 ms in bfloat16 and 13.9
in float32, one of 64 samples 34 and 43 (docs/performance.md).
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Collection
from typing import Literal

import torch
from tensordict import TensorDict
from torch import Tensor

from navsim.camera import DepthCamera
from navsim.robot import NUM_ACTIONS
from rl.config import TrainConfig
from rl.learner import Learner
from rl.loss import fastest_autocast
from rl.observation import DEPTH_AND_HEADING, NUM_FRAMES, Input
from rl.surroundings import SECTORS

NumberFormat = Literal["float32", "bfloat16"]
FORMATS: tuple[NumberFormat, ...] = ("float32", "bfloat16")

_WARM_UP = 3  # updates, in which memory is allocated and oneDNN prepares its convolutions
_UPDATES = 3
"""Of one format at a time."""
_LEAST_ROUNDS, _MOST_ROUNDS = 3, 9
_SECONDS = 2.0
"""After which no further round is begun."""
_CLEARLY = 1.05
"""How many times as fast bfloat16 has to be: its numbers have three digits, and a stopwatch errs."""


def fastest_number_format(config: TrainConfig) -> NumberFormat:
    """The format in which updates of these settings are fastest on this machine, with the threads that PyTorch has.

    It takes a second or two on a processor that multiplies faster in bfloat16, and next to nothing on others and on
    a GPU. Networks are drawn for it from PyTorch's global generator.

    Args:
        config: the settings; ``autocast`` among them does not matter.

    Returns:
        float32 unless bfloat16 is clearly faster.
    """
    if fastest_autocast(config.device) is None:
        return "float32"
    if config.device != "cpu":
        return "bfloat16"
    sample = random_sample(config.batch_size, config.camera, config.inputs)
    learners = [Learner(dataclasses.replace(config, autocast=number_format)) for number_format in FORMATS]
    for learner in learners:
        _seconds(learner, sample, _WARM_UP)
    ratios: list[float] = []
    begun = time.perf_counter()
    while len(ratios) < _LEAST_ROUNDS or (len(ratios) < _MOST_ROUNDS and time.perf_counter() - begun < _SECONDS):
        in_float32, in_bfloat16 = (_seconds(learner, sample, _UPDATES) for learner in learners)
        ratios.append(in_float32 / in_bfloat16)
    return "bfloat16" if statistics.median(ratios) > _CLEARLY else "float32"


def _seconds(learner: Learner, sample: TensorDict, updates: int) -> float:
    begun = time.perf_counter()
    for _ in range(updates):
        learner.update(sample.copy())
    return time.perf_counter() - begun


def random_sample(batch_size: int, camera: DepthCamera, inputs: Collection[Input] = DEPTH_AND_HEADING) -> TensorDict:
    """Transitions ``(B,)`` as a replay with three-step returns gives them, with random content.

    Args:
        batch_size: B.
        camera: whose images they have.
        inputs: what a network sees of them.
    """

    def observation() -> dict[str, Tensor]:
        content = {
            "depth": torch.randint(0, 256, (batch_size, NUM_FRAMES, camera.height, camera.width), dtype=torch.uint8),
            "heading": torch.pi * (2.0 * torch.rand(batch_size, 1) - 1.0),
        }
        if "command" in inputs:
            content["command"] = torch.rand(batch_size, 2)
        if "surroundings" in inputs:
            content["surroundings"] = camera.max_range * torch.rand(batch_size, SECTORS)
        return content

    terminated = torch.rand(batch_size, 1) < 0.05
    return TensorDict(
        {
            **observation(),
            "action": torch.randint(0, NUM_ACTIONS, (batch_size,)),
            "steps_to_next_obs": torch.full((batch_size, 1), 3),
            "next": {
                **observation(),
                "reward": torch.randn(batch_size, 1),
                "done": terminated,
                "terminated": terminated.clone(),
            },
        },
        batch_size=[batch_size],
    )
