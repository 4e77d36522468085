"""How fast the learner learns, beside TorchRL's ``DQNLoss`` and beside what the processor could do at best."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode
from torchrl.modules import DuelingCnnDQNet, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate

from navsim.camera import DepthCamera
from navsim.robot import NUM_ACTIONS
from rl.config import PRESETS, TrainConfig
from rl.env import NUM_FRAMES
from rl.learner import Learner
from rl.run import processor

CONFIG = dataclasses.replace(PRESETS["fast"], loss_function="smooth_l1")
"""TorchRL's ``DQNLoss`` has no distribution of returns, so neither has the learner that it is compared with."""
BATCH_SIZES = (8, 64)
NumberFormat = Literal["float32", "bfloat16"]
FORMATS: tuple[NumberFormat, ...] = ("float32", "bfloat16")
_ROUNDS = 7
_SECONDS_A_ROUND = 0.4
_MATRIX = 1024


class Measurement(NamedTuple):
    """Updates a second in one setting."""

    batch_size: int
    number_format: str
    ours: float
    """``D3QNLoss`` with ``make_q_actor``"""
    peer: float
    """TorchRL's ``DQNLoss`` with ``DuelingCnnDQNet``"""
    bound: float
    """if all operations of the peer's update ran as fast as a large product of matrices"""


def run(console: Console, *, num_threads: int = 1, seconds: float = _SECONDS_A_ROUND) -> list[Measurement]:
    """Prints updates a second: loss, gradients, Adam and soft target update, without the replay.

    Ours and the peer take turns, round by round, and medians are compared, so that a machine that gets busy meanwhile
    does not favour either.

    Args:
        console: where to.
        num_threads: CPU threads.
        seconds: that each of the seven rounds takes, for each learner.
    """
    torch.set_num_threads(num_threads)
    settings = [(size, number_format) for size in BATCH_SIZES for number_format in FORMATS]
    peaks: dict[NumberFormat, float] = {
        number_format: _matmul_rate(number_format, seconds) for number_format in FORMATS
    }
    measured = []
    for size, number_format in track(
        settings, "learning", console=console, transient=True, disable=not console.is_terminal
    ):
        measured.append(_compare(size, number_format, peaks[number_format], seconds))
    threads = "one thread" if num_threads == 1 else f"{num_threads} threads"
    rates = ", ".join(f"{rate / 1e9:,.0f} GFLOP/s in {number_format}" for number_format, rate in peaks.items())
    console.print(f"[bold]updates a second[/bold] of model I, 80x64, {threads}, {processor()}")
    console.print(_table(measured))
    console.print(f"bound: the peer's operations at the speed of {_MATRIX}x{_MATRIX} matrix products here, {rates}")
    return measured


def _compare(
    batch_size: int, number_format: Literal["float32", "bfloat16"], peak: float, seconds: float
) -> Measurement:
    config = dataclasses.replace(CONFIG, autocast=number_format)
    sample = random_sample(batch_size, config.camera)
    learner, peer = Learner(config), PeerLearner(config)
    contestants: list[Callable[[], object]] = [
        lambda: learner.update(sample.copy()),
        lambda: peer.update(sample.copy()),
    ]
    for update in contestants:
        _rate(update, seconds)
    rates = [[_rate(update, seconds) for update in contestants] for _ in range(_ROUNDS)]
    ours, theirs = (statistics.median(column) for column in zip(*rates, strict=True))
    return Measurement(batch_size, number_format, ours, theirs, peak / peer.operations(sample))


def random_sample(batch_size: int, camera: DepthCamera) -> TensorDict:
    """Transitions ``(B,)`` as a replay with three-step returns gives them, with random content."""

    def observation() -> dict[str, Tensor]:
        return {
            "depth": torch.randint(0, 256, (batch_size, NUM_FRAMES, camera.height, camera.width), dtype=torch.uint8),
            "heading": torch.pi * (2.0 * torch.rand(batch_size, 1) - 1.0),
        }

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


class PeerLearner:
    """The same algorithm out of TorchRL's own parts, as their documentation puts them together.

    The heading is a fifth image plane, the layers have the sizes of D3QN-I.

    Args:
        config: the run's settings.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.network = _DuelingNetwork()
        self._evaluate(random_sample(1, config.camera))  # sizes the lazy layers
        module = TensorDictModule(self.network, in_keys=["depth", "heading"], out_keys=["action_value"])
        actor = QValueActor(module, in_keys=["depth", "heading"], action_space="categorical")
        self.loss = DQNLoss(
            actor, loss_function=config.loss_function, delay_value=True, double_dqn=True, action_space="categorical"
        )
        self.loss.make_value_estimator(gamma=config.gamma)
        self.target_updater = SoftUpdate(self.loss, tau=config.tau)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate)
        self.max_grad_norm = config.max_grad_norm
        self.autocast = config.autocast == "bfloat16"

    def update(self, sample: TensorDict) -> Tensor:
        """One gradient step; returns the loss."""
        with torch.autocast("cpu", torch.bfloat16, enabled=self.autocast):
            loss = self.loss(sample)["loss"]
        self.optimiser.zero_grad()
        loss.backward()
        if self.max_grad_norm is not None:
            nn.utils.clip_grad_norm_(self.loss.parameters(), self.max_grad_norm)
        self.optimiser.step()
        self.target_updater.step()
        return loss.detach()

    def operations(self, sample: TensorDict) -> int:
        """Floating point operations of an update: s with gradients, s' with both networks."""
        with FlopCounterMode(display=False) as counter:
            self._evaluate(sample).sum().backward()
            with torch.no_grad():
                self._evaluate(sample)
                self._evaluate(sample)
        return counter.get_total_flops()

    def _evaluate(self, sample: TensorDict) -> Tensor:
        return self.network(sample["depth"], sample["heading"])


class _DuelingNetwork(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layers = DuelingCnnDQNet(
            NUM_ACTIONS,
            cnn_kwargs={
                "num_cells": [32, 64, 64],
                "kernel_sizes": [(10, 14), 4, 3],
                "strides": [8, 2, 1],
                "paddings": [(1, 3), 1, 1],
                "activation_class": nn.ReLU,
            },
            mlp_kwargs={"depth": 1, "num_cells": 512, "activation_class": nn.ReLU},
        )

    def forward(self, depth: Tensor, heading: Tensor) -> Tensor:
        heading_plane = ((heading + torch.pi) / (2.0 * torch.pi))[..., None, None].expand(-1, 1, *depth.shape[-2:])
        return self.layers(torch.cat([depth / 255.0, heading_plane], dim=-3))


def _rate(function: Callable[[], object], seconds: float) -> float:
    """Calls a second."""
    calls, begin = 0, time.perf_counter()
    while (passed := time.perf_counter() - begin) < seconds or not calls:
        function()
        calls += 1
    return calls / passed


def _matmul_rate(number_format: NumberFormat, seconds: float) -> float:
    """Floating point operations a second in products of large square matrices."""
    a, b = torch.randn(2, _MATRIX, _MATRIX, dtype=getattr(torch, number_format)).unbind()
    return 2.0 * _MATRIX**3 * max(_rate(lambda: a @ b, seconds / 2) for _ in range(4))


def _table(measured: list[Measurement]) -> Table:
    table = Table()
    for heading in ("batch", "format", "D3QNLoss", "TorchRL's DQNLoss", "ratio", "bound"):
        table.add_column(heading, justify="left" if heading == "format" else "right")
    for row in measured:
        table.add_row(
            str(row.batch_size),
            row.number_format,
            f"{row.ours:,.1f}",
            f"{row.peer:,.1f}",
            f"{row.ours / row.peer:.2f}",
            f"{row.bound:,.0f}",
        )
    return table
