"""The learner: one gradient step of dueling double deep Q-learning after another."""

from __future__ import annotations

import math
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.objectives import HardUpdate, SoftUpdate

from rl.config import TrainConfig
from rl.loss import D3QNLoss, fastest_autocast
from rl.networks import make_q_actor


class Learner:
    """Network, loss, optimiser and target network of one run.

    Args:
        config: the run's settings.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.actor = make_q_actor(config.model, config.camera.height, config.camera.width)
        self.loss = D3QNLoss(
            self.actor,
            gamma=config.gamma,
            loss_function=config.loss_function,
            autocast=number_format(config.autocast),
        )
        if config.target_update == "soft":
            self.target_updater = SoftUpdate(self.loss, tau=config.tau)
        else:
            # HardUpdate copies once its counter, which the copying call does not raise, has reached this number.
            interval = config.hard_update_interval - 1
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=interval)
        self.parameters = [parameter for parameter in self.loss.parameters() if parameter.requires_grad]
        self.optimiser = torch.optim.Adam(self.parameters, lr=config.learning_rate, fused=True)
        self.updates = 0

    def updates_due(self, step: int) -> int:
        """Gradient steps that ``step`` transitions call for."""
        return max(0, int((step - self.config.warmup_steps) / self.config.steps_per_update))

    @property
    def learning_rate(self) -> float:
        """The step size of the next update."""
        if self.config.learning_rate_decay == "none":
            return self.config.learning_rate
        progress = min(1.0, self.updates / self.updates_due(self.config.total_steps))
        return self.config.learning_rate * 0.5 * (1.0 + math.cos(math.pi * progress))

    def update(self, sample: TensorDictBase) -> torch.Tensor:
        """One gradient step on a batch of transitions, and the target network's update.

        Args:
            sample: a replay's sample, with the keys of ``D3QNLoss``; its priorities are written into it.

        Returns:
            the loss, a scalar.
        """
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate
        loss = self.loss(sample)["loss"]
        loss.backward()
        if self.config.max_grad_norm is not None:
            torch.nn.utils.clip_grad_norm_(self.parameters, self.config.max_grad_norm)
        self.optimiser.step()
        self.optimiser.zero_grad()
        self.target_updater.step()
        self.updates += 1
        return loss.detach()

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimiser and count of updates."""
        return {
            "loss": self.loss.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "target_updater": getattr(self.target_updater, "counter", 0),
            "updates": self.updates,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``."""
        self.loss.load_state_dict(state_dict["loss"])
        self.optimiser.load_state_dict(state_dict["optimiser"])
        if hasattr(self.target_updater, "counter"):
            self.target_updater.counter = state_dict["target_updater"]
        self.updates = state_dict["updates"]


def number_format(setting: str) -> torch.dtype | None:
    """What ``D3QNLoss`` takes for a run's ``autocast``: None is float32."""
    if setting == "auto":
        return fastest_autocast()
    return {"float32": None, "bfloat16": torch.bfloat16}[setting]
