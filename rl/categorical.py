"""A distribution of returns in place of their mean (C51): the dueling network's categorical head, and its loss.

Bellemare, Dabney and Munos, *A Distributional Perspective on Reinforcement Learning*, 2017 (arXiv 1707.06887): the
network tells, for each action, the probabilities of a fixed row of returns, the *atoms*. Its Q-value is their mean.
The target distribution is moved by the reward, shrunk by the discount, and cast back onto the atoms; the loss is the
cross-entropy with it. Classifying returns gives gradients that do not grow with the error, which the blunt values that
a squared error leaves beside obstacles profit from.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor, nn
from torchrl.data import Categorical
from torchrl.modules import QValueActor

from navsim.robot import NUM_ACTIONS
from rl.joint import hidden_of_update
from rl.loss import D3QNLoss, is_plain
from rl.networks import D3QN, STREAM_WIDTH
from rl.observation import DEPTH_AND_HEADING, DepthScale, HeadingInit, Input, Model, keys_of


class CategoricalD3QN(D3QN):
    """``D3QN`` whose streams end in distributions over returns; it is called like ``D3QN`` and yields Q-values.

    Args:
        model: ``"I"`` or ``"S"``, see ``D3QN``.
        height: of the depth images, pixels.
        width: of the depth images, pixels.
        inputs: what it sees, see ``D3QN``.
        depth_scale: how, see ``D3QN``.
        heading_init: see ``D3QN``.
        centred: see ``D3QN``.
        atoms: returns that are told apart, at least 2.
        value_range: the least and the greatest of them; they are evenly spaced.

    Raises:
        ValueError: as ``D3QN``, and for fewer than two atoms or an empty range.

    >>> network = CategoricalD3QN("S", height=10, width=14, atoms=5, value_range=(-1.0, 1.0))
    >>> network.logits(torch.zeros(2, 4, 10, 14, dtype=torch.uint8), torch.zeros(2, 1)).shape
    torch.Size([2, 7, 5])
    """

    support: Tensor

    def __init__(
        self,
        model: Model = "I",
        height: int = 64,
        width: int = 80,
        inputs: Collection[Input] = DEPTH_AND_HEADING,
        depth_scale: DepthScale = "linear",
        *,
        heading_init: HeadingInit = "spread",
        centred: bool = False,
        atoms: int = 51,
        value_range: tuple[float, float] = (-1.5, 2.5),
    ) -> None:
        if atoms < 2 or not value_range[0] < value_range[1]:
            raise ValueError(
                f"a categorical head needs at least 2 atoms in a range of returns from less to more; got {atoms} atoms "
                f"from {value_range[0]} to {value_range[1]}"
            )
        super().__init__(model, height, width, inputs, depth_scale, heading_init=heading_init, centred=centred)
        self.value = nn.Linear(STREAM_WIDTH, atoms)
        self.advantage = nn.Linear(STREAM_WIDTH, NUM_ACTIONS * atoms)
        self.reset_parameters()
        self.register_buffer("support", torch.linspace(*value_range, atoms), persistent=False)

    def logits(self, depth: Tensor, heading: Tensor, *others: Tensor) -> Tensor:
        """Unnormalised logarithms of the probabilities, ``(..., 7, atoms)``, for what ``forward`` takes."""
        return self._logits(self.hidden(depth, heading, *others)).reshape(*depth.shape[:-3], NUM_ACTIONS, -1)

    def _logits(self, hidden: Tensor) -> Tensor:
        """``(B, 7, atoms)`` of hidden layers ``(1024, B)``."""
        with torch.autocast(hidden.device.type, enabled=False):
            hidden = hidden.to(self.value.weight.dtype).t()
            value = self.value(hidden[:, :STREAM_WIDTH]).unsqueeze(1)
            advantage = self.advantage(hidden[:, STREAM_WIDTH:]).unflatten(1, (NUM_ACTIONS, -1))
            return value + advantage - advantage.mean(1, keepdim=True)

    def expectation(self, logits: Tensor) -> Tensor:
        """Q-values ``(..., 7)`` of ``logits`` ``(..., 7, atoms)``."""
        with torch.autocast(logits.device.type, enabled=False):  # as for ``D3QN``'s
            return logits.softmax(-1) @ self.support

    def head(self, hidden: Tensor) -> Tensor:
        """Action values, ``(B, 7)``, of hidden layers ``(1024, B)``."""
        return self.expectation(self._logits(hidden))


def make_categorical_actor(
    model: Model = "I",
    height: int = 64,
    width: int = 80,
    inputs: Collection[Input] = DEPTH_AND_HEADING,
    depth_scale: DepthScale = "linear",
    *,
    heading_init: HeadingInit = "spread",
    centred: bool = False,
    atoms: int = 51,
    value_range: tuple[float, float] = (-1.5, 2.5),
) -> QValueActor:
    """``rl.make_q_actor`` with a categorical head; arguments and errors as for ``CategoricalD3QN``."""
    network = CategoricalD3QN(
        *(model, height, width, inputs, depth_scale),
        heading_init=heading_init,
        centred=centred,
        atoms=atoms,
        value_range=value_range,
    )
    return QValueActor(network, in_keys=keys_of(inputs), spec=Categorical(NUM_ACTIONS))


def project(probabilities: Tensor, returns: Tensor, support: Tensor) -> Tensor:
    """Casts distributions back onto the atoms: each return's probability is shared between its two neighbours.

    Equation 7 of Bellemare et al. 2017, as the overlap of triangles.

    Args:
        probabilities: ``(B, K)``.
        returns: ``(B, K)``, where the probabilities lie; beyond the support, they are put on its ends.
        support: ``(K,)``, evenly spaced and rising.

    Returns:
        ``(B, K)`` probabilities of the atoms.

    >>> project(torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([[0.25, 1.0, 2.0]]), torch.tensor([0.0, 1.0, 2.0]))
    tensor([[0.7500, 0.2500, 0.0000]])
    """
    spacing = support[1] - support[0]
    distance = returns.clamp(support[0], support[-1]).unsqueeze(-1) - support
    shares = (1.0 - distance.abs() / spacing).clamp_min(0.0)
    return (probabilities.unsqueeze(1) @ shares).squeeze(1)


class CategoricalD3QNLoss(D3QNLoss):
    """The cross-entropy of C51 for a ``CategoricalD3QN``, double and with all that ``D3QNLoss`` does around it.

    TorchRL's ``DistributionalDQNLoss`` computes the same number (a test compares them) from another kind of actor; here
    the actor stays a ``QValueActor``, so that everything else of ``D3QNLoss`` and of this library fits it.

    ``td_error``, the priority of prioritised replay, is the cross-entropy, as in TorchRL's.

    Args:
        q_actor: a ``QValueActor`` around a ``CategoricalD3QN``.
        gamma: discount a step.

    Keyword Args: as for ``D3QNLoss``, without ``loss_function``.

    Raises:
        ValueError: for an actor around another network, or one whose action values are not the means of its
            distributions.
    """

    def __init__(self, q_actor: QValueActor, gamma: float = 0.99, **settings: Any) -> None:
        super().__init__(q_actor, gamma, **settings)
        network = q_actor.module[0].module
        if not isinstance(network, CategoricalD3QN):
            raise ValueError(f"CategoricalD3QNLoss needs a CategoricalD3QN in its actor; got {type(network).__name__}")
        if q_actor.module[1].action_mask_key is not None:
            raise ValueError("CategoricalD3QNLoss knows no action masks; give the actor none, or use D3QNLoss")
        self._check(network)

    @staticmethod
    def _check(network: CategoricalD3QN) -> None:
        if not is_plain(network):
            kind = "is symmetric" if network.symmetric else f"({type(network).__name__}) makes them in another way"
            raise ValueError(
                "CategoricalD3QNLoss teaches the distributions whose means are the action values, and this network "
                f"{kind}; give a policy that goes on learning symmetric=False, and a network of your own to D3QNLoss"
            )

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """The loss of a batch of transitions; see ``D3QNLoss.forward``."""
        keys = self.tensor_keys
        self._check(self.value_network.module[0].module)  # a hook may have come to it since
        observation, next_observation = self._observations(tensordict)
        online, target = self._networks_of_weights()
        assert isinstance(online, CategoricalD3QN)
        assert isinstance(target, CategoricalD3QN)
        with self._autocast(observation[0].device.type):
            hidden, next_hidden, choosing_hidden = hidden_of_update(
                online, target, observation, next_observation, double=self.double_dqn
            )
            logits = online._logits(hidden)
            with torch.no_grad():
                target_logits = target._logits(next_hidden)
                choosing_logits = online._logits(choosing_hidden) if self.double_dqn else target_logits

        rows, batch = torch.arange(len(logits), device=logits.device), tensordict.batch_size
        action = tensordict.get(keys.action).reshape(-1)
        with torch.no_grad():
            best = online.expectation(choosing_logits).argmax(-1)
            reward = tensordict.get(("next", keys.reward)).reshape(-1, 1)
            terminated = tensordict.get(("next", keys.terminated)).reshape(-1, 1)
            steps = tensordict.get("steps_to_next_obs", torch.ones_like(reward)).reshape(-1, 1)
            discount = self.value_estimator.gamma**steps * ~terminated
            # In single precision at least, whatever the formats of weights and rewards.
            support = online.support.to(torch.promote_types(online.support.dtype, torch.float32))
            returns = (reward + discount * support).to(support.dtype)
            wanted = project(target_logits[rows, best].softmax(-1).to(support.dtype), returns, support)
            tensordict.set(keys.value, online.expectation(logits)[rows, action].reshape(*batch, 1))

        cross_entropy = -(wanted * logits[rows, action].log_softmax(-1)).sum(-1).reshape(batch)
        tensordict.set(keys.priority, cross_entropy.detach().unsqueeze(-1))
        weights = self._maybe_get_priority_weight(tensordict)
        return TensorDict({"loss": self._reduce_loss(cross_entropy, tensordict=tensordict, weights=weights)})
