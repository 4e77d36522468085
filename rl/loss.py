"""The double deep Q-learning loss, as TorchRL's and in less time."""

from __future__ import annotations

import contextlib
import copy
import math
import time
from typing import Any, Literal, TypeGuard

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor, nn
from torchrl.modules import QValueActor, set_recurrent_mode
from torchrl.objectives import DQNLoss, ValueEstimators, distance_loss

from rl.joint import hidden_of_update
from rl.networks import D3QN, SameConv2d


class D3QNLoss(DQNLoss):
    """TorchRL's ``DQNLoss`` for image networks on a CPU: the same numbers and keys, with less around them.

    For a transition (s, a, r, s'), where r may be the discounted sum of the k rewards between the two (``reward`` and
    ``steps_to_next_obs``, 1 if absent), with online network Q and target network Q⁻, the loss compares Q(s, a) with::

        r + γᵏ · (1 − terminated) · Q⁻(s', argmax_a Q(s', a))

    (van Hasselt et al. 2016, arXiv 1509.06461); without ``double_dqn``, with Q⁻'s own maximum. An episode that the time
    limit ended is ``truncated``, not ``terminated``, so its last observation is bootstrapped from.

    With a ``D3QN``, what ``DQNLoss`` spends beside the network (copies of tensordicts, ``step_mdp``, actions nobody
    reads, gradients through nothing) is gone, and ``rl.joint.hidden_of_update`` passes s and s' through it in fewer
    products. Networks of another kind are called as ``DQNLoss`` calls them, but for the state of recurrent ones: what
    they remember in s' is what was recorded under ``next``, each time, where ``DQNLoss`` makes a sequence of all s',
    across episodes' ends, and begins it with what the call for s has just written there. The s of a batch are a
    sequence to both, along its last dimension: transitions that do not follow one another are given as ``(B, 1)``.

    Like ``DQNLoss``, it writes the squared error into the tensordict as ``td_error``, ``(B, 1)``, the priority of
    prioritised replay, and weighs samples by their ``priority_weight`` if they have one. Unlike it, it also writes
    ``chosen_action_value``, ``(B, 1)``, the online network's Q(s, a).

    Args:
        q_actor: the policy to improve; it keeps sharing its weights with the loss.
        gamma: discount a step.

    Keyword Args:
        loss_function: of the difference: squared, or Huber's.
        double_dqn: whether the online network chooses the action in s'.
        delay_value: whether the target network has weights of its own, for ``SoftUpdate`` or ``HardUpdate`` to change.
        autocast: format that the networks multiply in, such as ``torch.bfloat16``; None for that of their weights.
            Q-values and loss stay in the format of the weights. See ``fastest_autocast``.
        reduction: how the samples' losses are combined.

    Raises:
        ValueError: for an actor other than a ``QValueActor`` with a categorical action space.

    >>> from torchrl.objectives import SoftUpdate
    >>> from rl.networks import make_q_actor
    >>> loss = D3QNLoss(make_q_actor("S", height=10, width=14))
    >>> target_update = SoftUpdate(loss, tau=0.001)
    >>> def observation():
    ...     return {"depth": torch.zeros(8, 4, 10, 14, dtype=torch.uint8), "heading": torch.zeros(8, 1)}
    >>> never = torch.zeros(8, 1, dtype=torch.bool)
    >>> after = {**observation(), "reward": torch.zeros(8, 1), "done": never, "terminated": never}
    >>> batch = TensorDict({**observation(), "action": torch.zeros(8, dtype=torch.int64), "next": after}, [8])
    >>> loss(batch)["loss"].shape
    torch.Size([])
    """

    SUPPORTED_VALUE_ESTIMATORS = (ValueEstimators.TD0,)

    value_network: QValueActor
    value_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

    def __init__(
        self,
        q_actor: QValueActor,
        gamma: float = 0.99,
        *,
        loss_function: Literal["l2", "smooth_l1"] = "l2",
        double_dqn: bool = True,
        delay_value: bool = True,
        autocast: torch.dtype | None = None,
        reduction: Literal["mean", "sum", "none"] = "mean",
    ) -> None:
        if not (isinstance(q_actor, QValueActor) and q_actor.module[1].action_space == "categorical"):
            raise ValueError(
                "D3QNLoss needs a QValueActor with a categorical action space, as make_q_actor returns it; got "
                f"{type(q_actor).__name__}"
            )
        super().__init__(
            q_actor,
            loss_function=loss_function,
            double_dqn=double_dqn,
            delay_value=delay_value,
            action_space="categorical",
            reduction=reduction,
        )
        self.autocast = autocast
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """The loss of a batch of transitions.

        Args:
            tensordict: observation, ``action`` and ``next``, as a replay yields it; ``td_error`` and
                ``chosen_action_value`` are written into it.

        Returns:
            a tensordict with ``loss``, a scalar unless the reduction is "none".
        """
        keys = self.tensor_keys
        action = tensordict.get(keys.action)
        with self._autocast(action.device.type):
            if self._is_of_d3qn and tensordict.ndim == 1:
                action_value, next_value = self._values(*self._observations(tensordict))
            else:
                action_value, next_value = self._values_of_actor(tensordict)
        if action.ndim < action_value.ndim:
            action = action.unsqueeze(-1)
        chosen_value = action_value.gather(-1, action)
        with torch.no_grad():
            wanted_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
            tensordict.set(keys.priority, (chosen_value - wanted_value).square())
            tensordict.set(keys.value, chosen_value.detach())

        loss = distance_loss(chosen_value.squeeze(-1), wanted_value.squeeze(-1), self.loss_function)
        weights = self._maybe_get_priority_weight(tensordict)
        loss = self._reduce_loss(loss, tensordict=tensordict, weights=weights)
        return TensorDict({"loss": loss})

    def _observations(self, tensordict: TensorDictBase) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """What the networks see of s and of s'."""
        keys, after = self.value_network.in_keys, tensordict.get("next")
        seen = tuple(tensordict.get(key) for key in keys), tuple(after.get(key) for key in keys)
        for values, place in zip(seen, ("its observation", '"next"'), strict=True):
            missing = [str(key) for key, value in zip(keys, values, strict=True) if value is None]
            if missing:
                raise ValueError(
                    f"the network sees {', '.join(missing)}, which the batch lacks in {place}: let the environment "
                    "give it, and the replay keep it (make_replay's inputs)"
                )
        return seen

    def _values(self, observation: tuple[Tensor, ...], next_observation: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
        """Online action values of s, ``(B, actions)``, and what s' is worth, ``(B, 1)``."""
        online, target = self._networks_of_weights()
        hidden, next_hidden, choosing_hidden = hidden_of_update(
            online, target, observation, next_observation, double=self.double_dqn
        )
        action_value = online.head(hidden)
        with torch.no_grad():
            target_value = target.head(next_hidden)
            choosing_value = online.head(choosing_hidden) if self.double_dqn else target_value
        return action_value, target_value.gather(-1, choosing_value.argmax(-1, keepdim=True))

    def _values_of_actor(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """The same of any actor, as DQNLoss has them: with the weights of one network put into it after the other."""
        actor, keys = self.value_network, self.tensor_keys
        before = tensordict.select(*actor.in_keys, strict=False)
        after = tensordict.get("next").select(*actor.in_keys, strict=False)
        chosen = after.copy()
        try:
            with self.value_network_params.to_module(actor, preserve_module_state=False):
                actor(before)
                if self.double_dqn:
                    with torch.no_grad(), set_recurrent_mode(False):
                        actor(chosen)
            target_weights = self.target_value_network_params.to_module(actor, preserve_module_state=False)
            with torch.no_grad(), set_recurrent_mode(False), target_weights:
                actor(after)
        except KeyError:
            self._observations(tensordict)  # tells what the network sees and the batch lacks
            raise
        target_value = after.get(keys.action_value)
        action = (chosen if self.double_dqn else after).get(keys.action)
        action = action.unsqueeze(-1) if action.ndim < target_value.ndim else action
        return before.get(keys.action_value), target_value.gather(-1, action)

    @property
    def _is_of_d3qn(self) -> bool:
        """Whether action values are those of a ``D3QN``'s head, and nothing else has a say in them."""
        network, values = self.value_network.module
        own = network.module if type(network) is TensorDictModule else None
        return own is not None and is_plain(own) and not network._kwargs and values.action_mask_key is None

    def _networks_of_weights(self) -> tuple[D3QN, D3QN]:
        """Two networks that hold the loss's online and target weights themselves, not copies.

        DQNLoss puts weights into one network before each call, and takes them out after it, which costs as much as a
        convolution. TorchRL drops what is named ``_cache...`` when a loss gets other tensors, such as on a GPU. As
        there, both have the settings of the actor's network, and train or evaluate as each of its modules does.
        """
        own = self.value_network.module[0].module
        if "_cache_networks" not in self.__dict__:
            networks, twins = [], []
            for weights in (self.value_network_params, self.target_value_network_params):
                network = copy.deepcopy(own)
                weights["module", "0", "module"].to_module(network)
                networks.append(network)
                pairs = zip(network.modules(), own.modules(), strict=True)
                twins += [(ours.__dict__, theirs.__dict__) for ours, theirs in pairs]
            self.__dict__["_cache_networks"] = (tuple(networks), twins)
        networks, twins = self.__dict__["_cache_networks"]
        for ours, theirs in twins:
            ours["training"] = theirs["training"]
        settings = {name: value for name, value in own.__dict__.items() if name not in _WEIGHTS}
        for network in networks:
            network.__dict__.update(settings)
        return networks

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_cache_networks"}  # a copy has its own

    def _autocast(self, device: str) -> contextlib.AbstractContextManager[object]:
        return contextlib.nullcontext() if self.autocast is None else torch.autocast(device, dtype=self.autocast)


_WEIGHTS = {"_parameters", "_buffers", "_modules"}
"""Where modules keep them."""


def is_plain(network: nn.Module) -> TypeGuard[D3QN]:
    """Whether a network's action values are its ``head`` of its ``hidden`` layers, which may then be made for s and s'
    together: those of a symmetric policy, of a subclass with a way of its own, or of one with hooks or other layers in
    the place of its convolutions, are not."""
    return (
        isinstance(network, D3QN)
        and not network.symmetric
        and type(network).forward is D3QN.forward
        and type(network).hidden is D3QN.hidden
        and not _is_hooked(network)
        and all(
            type(layer).forward is SameConv2d.forward and not _is_hooked(layer)
            for layer in (network.conv2, network.conv3)  # the others' weights are all that a D3QN reads of them
        )
    )


def _is_hooked(module: nn.Module) -> bool:
    """Whether calling a module does more, or something else, than its class's ``forward`` does."""
    hooks = (module._forward_hooks, module._forward_pre_hooks, module._backward_hooks, module._backward_pre_hooks)
    return any(hooks) or "forward" in module.__dict__


def fastest_autocast(device: str = "cpu") -> torch.dtype | None:
    """bfloat16 where matrices multiply clearly faster in it than in float32, else None.

    On a CPU this is measured, in some 30 ms, with matrices of the size of the networks' first fully connected layer:
    what the CPU says it supports does not tell. With AVX512-BF16 alone, one Xeon core multiplied 80 GFLOP/s in bfloat16
    and 150 in float32; with AMX, or on a Zen 4, it is the other way round.

    Args:
        device: ``"cpu"``, or ``"cuda"``, which gets bfloat16 if it supports it.
    """
    if device != "cpu":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    seconds = {torch.float32: math.inf, torch.bfloat16: math.inf}
    for _ in range(6):
        for dtype in seconds:
            weights, features = torch.ones(1024, 1280, dtype=dtype), torch.ones(1280, 64, dtype=dtype)
            start = time.perf_counter()
            weights @ features
            seconds[dtype] = min(seconds[dtype], time.perf_counter() - start)
    return torch.bfloat16 if 1.2 * seconds[torch.bfloat16] < seconds[torch.float32] else None
