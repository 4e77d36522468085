"""The mirror image of what a robot sees and does: left and right swapped, a world is as good a world."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from navsim.robot import MIRRORED_ACTIONS

_ACTIONS = torch.tensor(MIRRORED_ACTIONS)
_COMMAND = torch.tensor([1.0, -1.0])

_MIRRORS: dict[str, Callable[[Tensor], Tensor]] = {
    "depth": lambda images: images.flip(-1),
    "heading": lambda headings: -headings,
    "command": lambda commands: commands * _COMMAND.to(commands.device),
    "surroundings": lambda distances: distances.flip(-1),
    "action": lambda actions: _ACTIONS.to(actions.device)[actions],
    "action_value": lambda values: values[..., _ACTIONS.to(values.device)],
}


def mirrored(key: str, values: Tensor) -> Tensor:
    """What would stand there in the mirror image of the world.

    Images and what is remembered around the robot are flipped, headings and turning speeds negated, and left turns
    become right turns.

    Args:
        key: ``"depth"``, ``"heading"``, ``"command"``, ``"surroundings"``, ``"action"``, indices of actions, or
            ``"action_value"``, one value for each of them along the last axis.
        values: of any batch size.

    Raises:
        KeyError: for another key.

    >>> mirrored("action", torch.tensor([0, 2])), mirrored("command", torch.tensor([0.5, 0.25]))
    (tensor([0, 6]), tensor([ 0.5000, -0.2500]))
    """
    return _MIRRORS[key](values)


class MirroredHalf(Transform):
    """Replaces half of each sample by its mirror image, whose best action is the mirrored one.

    Samples are drawn independently, so which half does not matter.
    """

    at_rest = False
    """While it is set, records pass unmirrored: those that are read by their index, see ``rl.replay``."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.at_rest or not tensordict.batch_dims:
            return tensordict
        half = len(tensordict) // 2
        for part in (tensordict, tensordict["next"]):
            part["depth"][:half] = mirrored("depth", part["depth"][:half])
            for key in ("heading", "command", "surroundings"):
                if key in part:
                    part[key] = _with_first_mirrored(key, part[key], half)
        tensordict["action"] = _with_first_mirrored("action", tensordict["action"], half)
        return tensordict


def _with_first_mirrored(key: str, values: Tensor, half: int) -> Tensor:
    return torch.cat([mirrored(key, values[:half]), values[half:]])
