"""D3QNLoss beside TorchRL's DQNLoss and beside the target equation written out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import OneHot
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, HardUpdate, SoftUpdate, ValueEstimators

from rl.loss import D3QNLoss, fastest_autocast
from rl.networks import make_q_actor

HEIGHT, WIDTH = 20, 30


def transitions(count: int, *, height: int = HEIGHT, width: int = WIDTH, ends: bool = True) -> TensorDict:
    def observation() -> dict[str, torch.Tensor]:
        return {
            "depth": torch.randint(0, 256, (count, 4, height, width), dtype=torch.uint8),
            "heading": (torch.rand(count, 1) * 2 - 1) * math.pi,
        }

    terminated = torch.rand(count, 1) < (0.3 if ends else 0.0)
    after = {
        **observation(),
        "reward": torch.randn(count, 1),
        "done": terminated | (torch.rand(count, 1) < (0.3 if ends else 0.0)),
        "terminated": terminated,
    }
    return TensorDict({**observation(), "action": torch.randint(0, 7, (count,)), "next": after}, [count])


def make_losses(model: str = "I", **settings) -> tuple[D3QNLoss, DQNLoss]:
    """Ours and TorchRL's on the same networks, of which the target's differs from the online one."""
    actor = make_q_actor(model, HEIGHT, WIDTH)
    ours = D3QNLoss(actor, gamma=0.9, **settings)
    torchrl = DQNLoss(actor, action_space="categorical", **{"double_dqn": True, **settings})
    torchrl.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    if settings.get("delay_value", True):
        for target, other in zip(
            ours.target_value_network_params.values(True, True),
            torchrl.target_value_network_params.values(True, True),
            strict=True,
        ):
            target.data.add_(0.05 * torch.randn_like(target))
            other.data.copy_(target.data)
        SoftUpdate(ours, tau=0.5).init_  # associates an updater, so that TorchRL does not warn of its absence
    return ours, torchrl
