"""The learner: one gradient step of dueling double deep Q-learning after another."""

from __future__ import annotations

import math
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.modules import QValueActor
from torchrl.objectives import HardUpdate

from rl.categorical import CategoricalD3QNLoss, make_categorical_actor
from rl.config import TrainConfig
from rl.loss import D3QNLoss, fastest_autocast
from rl.networks import make_q_actor, symmetric_policy
from rl.optimiser import ClippedAdam, SoftUpdateAtOnce

NO_CUDA = "--device cuda: PyTorch finds no such device here; use --device cpu"


class Learner:
    """Network, loss, optimiser and target network of one run.

    Args:
        config: the run's settings.

    Attributes:
        actor: the greedy policy, on the CPU. With ``--device cuda`` it is a copy of the one that learns, as old as the
            last ``hand_over``. It explores, too.
        policy: what ``actor`` has learnt as it is evaluated: the same, unless the settings make it symmetric.

    Raises:
        ValueError: for a device that is not there.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.actor = make_actor(config)
        self.loss = make_loss(self.actor, config)
        self._learning: QValueActor | None = None
        if config.device != "cpu":
            if not torch.cuda.is_available():
                raise ValueError(NO_CUDA)
            self._learning = make_actor(config).to(config.device)
            self._learning.load_state_dict(self.actor.state_dict())
            self.loss = make_loss(self._learning, config)
        self.policy = policy_of(self.actor, config)
        if config.target_update == "soft":
            self.target_updater = SoftUpdateAtOnce(self.loss, tau=config.tau)
        else:
            # HardUpdate copies once its counter, which the copying call does not raise, has reached this number.
            interval = config.hard_update_interval - 1
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=interval)
        self.parameters = [parameter for parameter in self.loss.parameters() if parameter.requires_grad]
        self.optimiser = ClippedAdam(self.parameters, config.learning_rate, config.max_grad_norm)
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

        Raises:
            FloatingPointError: for a loss or a gradient that is not finite; nothing has been learnt.
        """
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate
        seen = sample if self._learning is None else sample.to(self.config.device)
        loss = self.loss(seen)["loss"]
        if not math.isfinite(value := float(loss.detach())):
            raise FloatingPointError(f"the loss of {sample.numel()} transitions is {value}")
        loss.backward()
        try:
            self.optimiser.step()
        except FloatingPointError as error:
            raise FloatingPointError(self._where_gradient_is_not_finite() or str(error)) from error
        finally:
            self.optimiser.zero_grad()
        self.target_updater.step()
        self.updates += 1
        if seen is not sample:
            sample.update(seen.select("td_error", "chosen_action_value").cpu())
        return loss.detach()

    def _where_gradient_is_not_finite(self) -> str:
        names = [
            name_in_network(name)
            for name, parameter in self.loss.named_parameters()
            if parameter.grad is not None and not parameter.grad.isfinite().all()
        ]
        others = f" and {len(names) - 1} other parameters" if len(names) > 1 else ""
        return f"the gradient of {names[0]}{others} is not finite" if names else ""

    def hand_over(self) -> None:
        """Makes ``actor`` what has been learnt."""
        if self._learning is not None:
            self.actor.load_state_dict(self._learning.state_dict())

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
        self.hand_over()
        self.optimiser.load_state_dict(state_dict["optimiser"])
        if hasattr(self.target_updater, "counter"):
            self.target_updater.counter = state_dict["target_updater"]
        self.updates = state_dict["updates"]


def make_actor(config: TrainConfig) -> QValueActor:
    """A new network as the settings describe it, as a greedy policy."""
    height, width = config.camera.height, config.camera.width
    if config.loss_function == "categorical":
        returns = (config.least_return, config.greatest_return)
        return make_categorical_actor(
            *(config.model, height, width, config.inputs, config.depth_scale),
            heading_init=config.heading_init,
            centred=config.centred,
            atoms=config.atoms,
            value_range=returns,
        )
    return make_q_actor(
        *(config.model, height, width, config.inputs, config.depth_scale),
        heading_init=config.heading_init,
        centred=config.centred,
    )


def policy_of(actor: QValueActor, config: TrainConfig) -> QValueActor:
    """What an actor from ``make_actor`` is once it is trained, and in evaluations; it shares the weights."""
    return symmetric_policy(actor) if config.symmetric else actor


def name_in_network(name: str) -> str:
    """A parameter's name in its network, of its name in a loss, such as ``value_network_params.module.0.module.``."""
    return name.rpartition("module.")[2]


def shapes_of_weights(config: TrainConfig) -> dict[str, torch.Tensor]:
    """The weights of ``make_actor`` without their memory, for settings that a stranger may have made enormous."""
    with torch.device("meta"):
        return make_actor(config).state_dict()


def make_loss(actor: QValueActor, config: TrainConfig) -> D3QNLoss:
    """The loss that the settings name, for an actor from ``make_actor``."""
    autocast = number_format(config.autocast, config.device)
    if config.loss_function == "categorical":
        return CategoricalD3QNLoss(actor, config.gamma, autocast=autocast)
    return D3QNLoss(actor, config.gamma, loss_function=config.loss_function, autocast=autocast)


def number_format(setting: str, device: str = "cpu") -> torch.dtype | None:
    """What ``D3QNLoss`` takes for a run's ``autocast``: None is float32."""
    if setting == "auto":
        return fastest_autocast(device)
    return {"float32": None, "bfloat16": torch.bfloat16}[setting]
