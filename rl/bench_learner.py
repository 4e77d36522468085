"""How fast the learner learns, beside TorchRL's ``DQNLoss``, Stable-Baselines3's DQN, and the processor's limit."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
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
from rl.learner import Learner
from rl.memory import keep_freed_memory
from rl.number_format import FORMATS, NumberFormat, random_sample
from rl.observation import NUM_FRAMES
from rl.run import processor
from rl.subnormals import subnormals_are_zero

CONFIG = dataclasses.replace(PRESETS["memoryless"], loss_function="smooth_l1")
"""TorchRL's ``DQNLoss`` has no distribution of returns, so neither has the learner that it is compared with."""
BATCH_SIZES = (8, 64)
_ROUNDS = 7
_SECONDS_A_ROUND = 0.4
_MATRIX = 1024
_STABLE_BASELINES = "SB3, float32"


class Measurement(NamedTuple):
    """Updates a second in one setting."""

    batch_size: int
    number_format: str
    ours: float
    """``D3QNLoss`` with ``make_q_actor``"""
    peer: float
    """TorchRL's ``DQNLoss`` with ``DuelingCnnDQNet``"""
    peer_in_float32: float
    """the same, whatever the format"""
    bound: float
    """if all operations of the peer's update ran as fast as a large product of matrices"""
    other_peers: dict[str, float]
    """of other libraries, in float32"""

    @property
    def roofline_share(self) -> float:
        """Share of the bound that is reached."""
        return self.ours / self.bound


def run(
    console: Console,
    *,
    num_threads: int = 1,
    peers: bool = False,
    height: int = 64,
    width: int = 80,
    seconds: float = _SECONDS_A_ROUND,
) -> list[Measurement]:
    """Prints updates a second: loss, gradients, Adam and soft target update, without the replay.

    Ours and the peers, in both formats, take turns, round by round, and medians are compared, so that a machine that
    gets busy meanwhile does not favour any.

    Args:
        console: where to.
        num_threads: CPU threads.
        peers: whether Stable-Baselines3 is measured, too, in float32.
        height: of the images, pixels.
        width: of the images, pixels.
        seconds: that each of the seven rounds takes, for each learner.
    """
    if num_threads < 1:
        raise ValueError(f"--num-threads must be positive; got {num_threads}")
    keep_freed_memory()
    torch.set_num_threads(num_threads)
    camera = DepthCamera(width=width, height=height)
    measured = []
    for size in track(BATCH_SIZES, "learning", console=console, transient=True, disable=not console.is_terminal):
        measured += _compare(size, seconds, camera, peers=peers)
    threads = "one thread" if num_threads == 1 else f"{num_threads} threads"
    console.print(f"[bold]updates a second[/bold] of model I, {width}x{height}, {threads}, {processor()}")
    console.print(_table(measured))
    console.print(
        "DQNLoss is TorchRL's, with a network written in the obvious way; in parentheses, D3QNLoss's ratio to it"
    )
    console.print(
        "roofline: share of the speed that the operations of DQNLoss's update would have at that of products of "
        f"{_MATRIX}x{_MATRIX} matrices, measured in turn with them"
    )
    as_they_are, as_zero = (1e3 * seconds for seconds in steps_of_faded_moments(CONFIG, seconds))
    console.print(
        f"a step of Adam, one thread, with a tenth of its moments subnormal: {as_they_are:.2f} ms as they are, "
        f"{as_zero:.2f} ms as zero, which they are while a robot trains"
    )
    return measured


def _compare(batch_size: int, seconds: float, camera: DepthCamera, *, peers: bool) -> list[Measurement]:
    config = dataclasses.replace(CONFIG, camera=camera)
    sample = random_sample(batch_size, camera)
    contestants: dict[tuple[str, str], Callable[[], object]] = {}
    for number_format in FORMATS:
        setting = dataclasses.replace(config, autocast=number_format)
        contestants["ours", number_format] = _updates(Learner(setting), sample)
        contestants["peer", number_format] = _updates(PeerLearner(setting), sample)
        contestants["product", number_format] = _product(number_format)
    if peers:
        contestants[_STABLE_BASELINES, "float32"] = stable_baselines_update(sample, config)
    for update in contestants.values():
        _rate(update, seconds)
    rounds = [[_rate(update, seconds) for update in contestants.values()] for _ in range(_ROUNDS)]
    rates = dict(zip(contestants, map(statistics.median, zip(*rounds, strict=True)), strict=True))
    products_an_update = PeerLearner(config).operations(sample) / (2.0 * _MATRIX**3)
    others = {_STABLE_BASELINES: rates[_STABLE_BASELINES, "float32"]} if peers else {}
    return [
        Measurement(
            batch_size,
            number_format,
            ours=rates["ours", number_format],
            peer=rates["peer", number_format],
            peer_in_float32=rates["peer", "float32"],
            bound=rates["product", number_format] / products_an_update,
            other_peers=others,
        )
        for number_format in FORMATS
    ]


def steps_of_faded_moments(config: TrainConfig, seconds: float) -> tuple[float, float]:
    """Seconds that a step of Adam takes where a tenth of its moments are subnormal numbers.

    They are what silent units leave behind (``rl.subnormals``); here they are drawn at random, and have no gradient.

    Args:
        config: whose network's weights are moved.
        seconds: that each of the seven rounds takes, for each of both.

    Returns:
        of processor time, medians: with subnormal numbers as they are, and with each of them zero.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # threads that run already keep the mode that they began with
    learner = Learner(config)
    optimiser, generator = learner.optimiser, torch.Generator().manual_seed(0)
    faded = [torch.rand(weights.shape, generator=generator) < 0.1 for weights in learner.parameters]
    gradients = [torch.randn(weights.shape, generator=generator) for weights in learner.parameters]
    for weights, gradient, without in zip(learner.parameters, gradients, faded, strict=True):
        weights.grad = gradient.masked_fill_(without, 0.0)
    optimiser.step()
    taken: tuple[list[float], list[float]] = ([], [])
    for _ in range(_ROUNDS):
        for times, as_zero in zip(taken, (False, True), strict=True):
            for weights, without in zip(learner.parameters, faded, strict=True):
                optimiser.state[weights]["exp_avg"][without] = 1e-40
            with subnormals_are_zero() if as_zero else nullcontext():
                optimiser.step()  # the first one makes zeros of them
                times.append(1.0 / _rate(optimiser.step, seconds))
    torch.set_num_threads(threads)
    return statistics.median(taken[0]), statistics.median(taken[1])


def _updates(learner: Learner | PeerLearner, sample: TensorDict) -> Callable[[], object]:
    return lambda: learner.update(sample.copy())


class PeerLearner:
    """The same algorithm out of TorchRL's own parts, as their documentation puts them together.

    The heading is a fifth image plane, the layers have the sizes of D3QN-I.

    Args:
        config: the run's settings.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.network = _DuelingNetwork(config.camera)
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
    def __init__(self, camera: DepthCamera) -> None:
        super().__init__()
        self.layers = DuelingCnnDQNet(
            NUM_ACTIONS,
            cnn_kwargs={
                "num_cells": [32, 64, 64],
                "kernel_sizes": [(10, 14), 4, 3],
                "strides": [8, 2, 1],
                "paddings": _paddings(camera),
                "activation_class": nn.ReLU,
            },
            mlp_kwargs={"depth": 1, "num_cells": 512, "activation_class": nn.ReLU},
        )

    def forward(self, depth: Tensor, heading: Tensor) -> Tensor:
        heading_plane = ((heading + torch.pi) / (2.0 * torch.pi))[..., None, None].expand(-1, 1, *depth.shape[-2:])
        return self.layers(torch.cat([depth / 255.0, heading_plane], dim=-3))


def _paddings(camera: DepthCamera) -> list[tuple[int, int]]:
    """Zeros on each side that make the layers as large as ours, whose odd zero goes to the end."""
    height, width = camera.height, camera.width
    paddings = []
    for (rows, columns), stride in (((10, 14), 8), ((4, 4), 2), ((3, 3), 1)):
        sides = [max((math.ceil(n / stride) - 1) * stride + k - n, 0) for n, k in ((height, rows), (width, columns))]
        paddings.append((math.ceil(sides[0] / 2), math.ceil(sides[1] / 2)))
        height, width = math.ceil(height / stride), math.ceil(width / stride)
    return paddings


def stable_baselines_update(sample: TensorDict, config: TrainConfig) -> Callable[[], object]:
    """An update of Stable-Baselines3's DQN with the layers of D3QN-I, on a sample that is always the same.

    Its DQN is neither double nor dueling: s' is seen once, not twice, and 1,024 units lead to seven values. Its time is
    that of ``DQN.train`` and ``polyak_update``, which belongs to its step of the environment.

    Raises:
        ValueError: if it is not installed.
    """
    try:
        import gymnasium
        from stable_baselines3 import DQN
        from stable_baselines3.common.logger import configure
        from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
        from stable_baselines3.common.type_aliases import ReplayBufferSamples
        from stable_baselines3.common.utils import polyak_update
    except ImportError as error:
        raise ValueError(f"--peers needs stable-baselines3: pip install 'navsim-rl[peers]' ({error})") from error

    camera = config.camera
    space = gymnasium.spaces.Box(0, 255, (NUM_FRAMES + 1, camera.height, camera.width), np.uint8)

    class Features(BaseFeaturesExtractor):
        def __init__(self, observation_space: gymnasium.Space) -> None:
            layers: list[nn.Module] = []
            channels = NUM_FRAMES + 1
            shapes = ((32, (10, 14), 8), (64, (4, 4), 2), (64, (3, 3), 1))
            for (width, kernel, stride), padding in zip(shapes, _paddings(camera), strict=True):
                layers += [nn.Conv2d(channels, width, kernel, stride, padding), nn.ReLU()]
                channels = width
            network = nn.Sequential(*layers, nn.Flatten())
            size = network(torch.zeros(1, *space.shape)).shape[1]
            super().__init__(observation_space, size)
            self.network = network

        def forward(self, observations: Tensor) -> Tensor:
            return self.network(observations)

    class Room(gymnasium.Env):
        observation_space, action_space = space, gymnasium.spaces.Discrete(NUM_ACTIONS)

    def images(part: TensorDict) -> Tensor:
        plane = ((part["heading"] + torch.pi) / (2.0 * torch.pi) * 255).to(torch.uint8)[..., None, None]
        return torch.cat([part["depth"], plane.expand(-1, 1, *part["depth"].shape[-2:])], dim=1)

    model = DQN(
        "CnnPolicy",
        Room(),
        buffer_size=1,
        batch_size=len(sample),
        learning_rate=config.learning_rate,
        max_grad_norm=config.max_grad_norm or math.inf,
        policy_kwargs={"features_extractor_class": Features, "net_arch": [1024]},
    )
    model.set_logger(configure(None, []))
    after = sample["next"]
    discounts = torch.full_like(after["reward"], config.gamma**3)
    fixed = ReplayBufferSamples(
        images(sample),
        sample["action"].unsqueeze(1),
        images(after),
        after["terminated"].float(),
        after["reward"],
        discounts,
    )
    setattr(model.replay_buffer, "sample", lambda *_, **__: fixed)  # noqa: B010 - it is a method

    def update() -> None:
        model.train(gradient_steps=1, batch_size=len(sample))
        polyak_update(model.q_net.parameters(), model.q_net_target.parameters(), config.tau)

    return update


def _rate(function: Callable[[], object], seconds: float) -> float:
    """Calls a second: of processor time with one thread, which other programs disturb less, else by the clock."""
    clock = time.process_time if torch.get_num_threads() == 1 else time.perf_counter
    calls, begin = 0, clock()
    while (passed := clock() - begin) < seconds or not calls:
        function()
        calls += 1
    return calls / max(passed, 1e-9)


def _product(number_format: NumberFormat) -> Callable[[], object]:
    """A product of large square matrices."""
    a, b = torch.randn(2, _MATRIX, _MATRIX).to(getattr(torch, number_format)).unbind()
    return lambda: a @ b


def _table(measured: list[Measurement]) -> Table:
    others = sorted({name for row in measured for name in row.other_peers})
    table = Table()
    for heading in ("batch", "format", "D3QNLoss", "roofline", "DQNLoss", "DQNLoss, float32", *others):
        table.add_column(heading, justify="left" if heading == "format" else "right")
    for row in measured:
        peers = [row.peer, row.peer_in_float32, *(row.other_peers[name] for name in others)]
        table.add_row(
            str(row.batch_size),
            row.number_format,
            f"{row.ours:,.1f}",
            f"{row.roofline_share:.0%}" if row.number_format == "float32" else "",
            *(f"{rate:,.1f} ({row.ours / rate:.2f})" for rate in peers),
        )
    return table
