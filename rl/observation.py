"""What a network can see: depth images some steps apart, the goal's heading, the robot's command and surroundings."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Literal, get_args

if TYPE_CHECKING:  # settings are checked before what takes long to import is imported
    from torch import Tensor

Model = Literal["I", "S"]
"""Where the heading enters: as an image plane, or as a scalar beside the features."""

Input = Literal["depth", "heading", "command", "surroundings"]
"""Depth images, the heading of the goal, the command (v, ω) in force, and what the robot remembers of what stood around
it (``rl.surroundings``)."""

DepthScale = Literal["linear", "inverse"]
"""How depth enters the first convolution: as a share of the greatest depth, or ``NEAREST`` over it."""

HeadingInit = Literal["spread", "glorot"]
"""How weights for a heading that is a scalar begin: as large as makes it matter, or as all others do."""

NEAREST = 0.08
"""Share of the greatest depth, 0.4 m of 5 m, up to which the inverse scale is 1: there, depth ends an episode."""

DEPTH_AND_HEADING: tuple[Input, ...] = ("depth", "heading")
"""The inputs of the thesis."""

NUM_FRAMES = 4
"""Depth images in an observation."""


def check_inputs(inputs: Collection[str]) -> None:
    """Raises :class:`ValueError` unless a network can see these, in one sentence."""
    known = get_args(Input)
    if isinstance(inputs, str):
        raise ValueError(f"inputs must be several names, such as ({inputs!r},); got the text {inputs!r}")
    if set(inputs) - set(known) or not {"depth", "heading"} & set(inputs):
        raise ValueError(
            f"inputs must be some of {', '.join(known)}, depth or heading among them; got {', '.join(inputs) or 'none'}"
        )


def keys_of(inputs: Collection[Input]) -> list[str]:
    """What a network with these inputs is called with, in order; images or heading that are not among them are ignored.

    >>> keys_of(["heading", "surroundings"])
    ['depth', 'heading', 'surroundings']
    """
    return ["depth", "heading", *(key for key in ("command", "surroundings") if key in inputs)]


def history_length(interval: int) -> int:
    """Images to keep for a stack whose images are ``interval`` steps apart, the current one included.

    >>> history_length(1), history_length(3)
    (4, 10)
    """
    return (NUM_FRAMES - 1) * interval + 1


def stack_of(history: Tensor) -> Tensor:
    """The stack, ``(N, 4, H, W)``, in a history ``(N, history_length(interval), H, W)``; oldest first.

    A copy: whoever gets an observation may write into it, and what is seen next is made of the history.
    """
    return history[:, :: (history.shape[1] - 1) // (NUM_FRAMES - 1)].clone()
