"""The dueling Q-networks of the thesis, D3QN-I and D3QN-S, at any image size.

Three convolutions with TensorFlow's "SAME" geometry look at the last four depth images; two streams of 512 units turn
what they see into a value V and seven advantages A, and Q = V + A − mean(A) (Wang et al. 2016, arXiv 1511.06581).
The models differ in how the heading θ of the goal enters, always as (θ + π) / 2π:

- **D3QN-I**: as a fifth image plane, the same number in every pixel.
- **D3QN-S**: appended to the flattened features, the input of both streams.

Some things are computed differently from how they are written above, and give the same numbers (the tests compare):

- The first layers of the two streams, 512 units each, are one matrix product of 1024 rows, written
  ``weights @ features.T``, which the BLAS does faster than its transpose: 8 samples in 0.4 instead of 0.6 ms.
- A constant plane is not convolved. A convolution is linear, so the plane contributes its number times the response of
  conv1's fifth channel to a plane of ones, which depends on the weights only.
- The images' division by 255 is done on conv1's weights, so that 8-bit images enter as they are; every value from 0 to
  255 is exact in bfloat16, too.
- Images travel with the channels last, and features are flattened in the order row, column, channel, as in
  TensorFlow. The gradient of conv1's weights, for one, takes 1.6 instead of 4.6 ms for 64 samples.

(One core of a Xeon with AVX-512, torch 2.13. ``torch.compile`` is not used: it needs a C++ compiler on the machine
that trains.)
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torchrl.data import Categorical
from torchrl.modules import QValueActor

from navsim.robot import NUM_ACTIONS

Model = Literal["I", "S"]
"""Where the heading enters: as an image plane, or as a scalar beside the features."""

NUM_FRAMES = 4
"""Depth images in an observation."""

STREAM_WIDTH = 512
"""Units in the hidden layer of each stream."""


class _Convolution(NamedTuple):
    kernel: tuple[int, int]
    stride: int
    channels: int


_CONVOLUTIONS = (
    _Convolution(kernel=(10, 14), stride=8, channels=32),
    _Convolution(kernel=(4, 4), stride=2, channels=64),
    _Convolution(kernel=(3, 3), stride=1, channels=64),
)


def same_padding(size: int, kernel: int, stride: int) -> tuple[int, int]:
    """Zeros that TensorFlow's "SAME" geometry puts before and after an axis; an odd one goes after.

    The output has ``ceil(size / stride)`` places.

    >>> same_padding(80, kernel=14, stride=8), same_padding(77, kernel=14, stride=8)
    ((3, 3), (4, 5))
    """
    total = max((math.ceil(size / stride) - 1) * stride + kernel - size, 0)
    return total // 2, total - total // 2


class SameConv2d(nn.Conv2d):
    """A convolution with TensorFlow's "SAME" geometry for images of one size.

    Args:
        in_channels: channels of the images.
        out_channels: channels of the output.
        kernel_size: (height, width).
        stride: of both axes.
        image_size: (height, width) of the images.

    Attributes:
        output_size: (height, width) of the output.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: tuple[int, int],
        stride: int,
        image_size: tuple[int, int],
    ) -> None:
        rows, columns = (
            same_padding(size, kernel, stride) for size, kernel in zip(image_size, kernel_size, strict=True)
        )
        symmetric = rows[0] == rows[1] and columns[0] == columns[1]
        super().__init__(
            in_channels, out_channels, kernel_size, stride, padding=(rows[0], columns[0]) if symmetric else 0
        )
        self.weight.data = self.weight.data.contiguous(memory_format=torch.channels_last)
        self.output_size = (math.ceil(image_size[0] / stride), math.ceil(image_size[1] / stride))
        self._border = None if symmetric else (*columns, *rows)

    def convolve(self, images: Tensor, weight: Tensor) -> Tensor:
        """The convolution of ``images`` ``(B, C, H, W)`` with a kernel that may differ from the layer's own."""
        if self._border is not None:
            images = F.pad(images, self._border)
        return self._conv_forward(images, weight, self.bias)

    def forward(self, images: Tensor) -> Tensor:
        return self.convolve(images, self.weight)


class D3QN(nn.Module):
    """Dueling Q-network over four depth images and the heading of the goal.

    Args:
        model: ``"I"``, the heading as an image plane, or ``"S"``, as a scalar beside the features.
        height: of the depth images, pixels; at least 10, the height of the first kernel.
        width: of the depth images, pixels; at least 14.

    Attributes:
        conv1, conv2, conv3: the convolutions; the fifth input channel of D3QN-I's ``conv1`` is the heading's.
        streams: the first layers of both streams, value before advantage.
        value, advantage: the streams' last layers.

    Raises:
        ValueError: for another model, or images smaller than the first kernel.

    Weights begin as in TensorFlow, the thesis's framework: Glorot's uniform distribution (2010), for each stream of its
    own, and biases of zero.

    >>> network = D3QN("S", height=64, width=80)
    >>> network(torch.zeros(2, 4, 64, 80, dtype=torch.uint8), torch.zeros(2, 1)).shape
    torch.Size([2, 7])
    """

    _coverage: Tensor

    def __init__(self, model: Model = "I", height: int = 64, width: int = 80) -> None:
        super().__init__()
        if model not in get_args(Model):
            raise ValueError(
                f'model must be "I" (heading as an image plane) or "S" (heading as a scalar); got {model!r}'
            )
        least = _CONVOLUTIONS[0].kernel
        if height < least[0] or width < least[1]:
            raise ValueError(
                f"depth images of {width} x {height} pixels are smaller than the network's first kernel;"
                f" use at least {least[1]} x {least[0]}"
            )
        self.model = model
        self.image_shape = (NUM_FRAMES, height, width)

        channels, size = NUM_FRAMES + (model == "I"), (height, width)
        layers = []
        for convolution in _CONVOLUTIONS:
            layer = SameConv2d(channels, convolution.channels, convolution.kernel, convolution.stride, size)
            channels, size = convolution.channels, layer.output_size
            layers.append(layer)
        self.conv1, self.conv2, self.conv3 = layers
        self.streams = nn.Linear(channels * size[0] * size[1] + (model == "S"), 2 * STREAM_WIDTH)
        self.value = nn.Linear(STREAM_WIDTH, 1)
        self.advantage = nn.Linear(STREAM_WIDTH, NUM_ACTIONS)
        self.reset_parameters()

        if model == "I":
            self.register_buffer("_coverage", _coverage(_CONVOLUTIONS[0], height, width), persistent=False)

    def reset_parameters(self) -> None:
        """Draws new weights from torch's global generator."""
        for layer in (self.conv1, self.conv2, self.conv3, self.value, self.advantage):
            nn.init.xavier_uniform_(layer.weight)
        for stream in self.streams.weight.data.split(STREAM_WIDTH):
            nn.init.xavier_uniform_(stream)
        for name, parameter in self.named_parameters():
            if name.endswith("bias"):
                nn.init.zeros_(parameter)

    def parameter_counts(self) -> dict[str, int]:
        """Weights and biases of each layer as a table of the network lists them, one stream beside the other.

        "value 1" and "advantage 1" are the fully connected layers of tables 4.1 and 4.2 of the thesis, and agree with
        them. Its count of conv1, 4,512, is for one input channel; here it is 22,432 (I, five) or 17,952 (S, four).
        """
        counts = {
            name: sum(parameter.numel() for parameter in getattr(self, name).parameters())
            for name in ("conv1", "conv2", "conv3", "streams", "value", "advantage")
        }
        first = counts.pop("streams") // 2
        return {
            **{name: counts[name] for name in ("conv1", "conv2", "conv3")},
            "value 1": first,
            "value 2": counts["value"],
            "advantage 1": first,
            "advantage 2": counts["advantage"],
        }

    def prepare(self, depth: Tensor, heading: Tensor) -> tuple[Tensor, Tensor]:
        """What ``forward`` does before it uses a weight, for observations that several sets of weights shall judge.

        Args:
            depth: uint8 ``(..., 4, H, W)``.
            heading: float32 ``(..., 1)``, radians.

        Returns:
            floating-point ``depth``, still from 0 to 255, and ``heading`` from 0 to 1, both ready for ``forward``.

        Raises:
            ValueError: for images of another size.
        """
        if depth.shape[-3:] != self.image_shape:
            raise ValueError(
                f"the network is for depth images of shape {self.image_shape} (frames, height, width);"
                f" got {tuple(depth.shape[-3:])}"
            )
        device = depth.device.type
        dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else self.conv1.weight.dtype
        channels_last = torch.stack(depth.unbind(-3), dim=-1)  # faster than contiguous(memory_format=...) on 8 bits
        return channels_last.to(dtype).movedim(-1, -3), (heading + math.pi) / (2.0 * math.pi)

    def forward(self, depth: Tensor, heading: Tensor) -> Tensor:
        """Action values, ``(..., 7)``.

        Args:
            depth: uint8 ``(..., 4, H, W)``, oldest image first; 255 is the camera's greatest range.
            heading: float32 ``(..., 1)``, radians in (−π, π].

        Both may come from ``prepare`` instead.
        """
        if not depth.is_floating_point():
            depth, heading = self.prepare(depth, heading)
        leading = depth.shape[:-3]
        hidden = self._hidden(depth.reshape(-1, *depth.shape[-3:]), heading.reshape(-1, 1))
        with torch.autocast(hidden.device.type, enabled=False):  # Q-values need more than bfloat16's three digits
            hidden = hidden.to(self.value.weight.dtype)
            value = torch.addmm(self.value.bias.unsqueeze(1), self.value.weight, hidden[:STREAM_WIDTH])
            advantage = torch.addmm(self.advantage.bias.unsqueeze(1), self.advantage.weight, hidden[STREAM_WIDTH:])
            action_values = value + advantage - advantage.mean(0, keepdim=True)
        return action_values.t().reshape(*leading, NUM_ACTIONS)

    def _hidden(self, depth: Tensor, heading: Tensor) -> Tensor:
        """The hidden layers of both streams, one sample a column: ``(1024, B)``."""
        features = self.conv1.convolve(depth, self.conv1.weight[:, :NUM_FRAMES] * (1.0 / 255.0))
        if self.model == "I":
            plane = self._plane_response()
            features = torch.addcmul(features, heading.to(features.dtype)[..., None, None], plane.to(features.dtype))
        features = F.relu_(self.conv2(F.relu_(features)))
        features = F.relu_(self.conv3(features)).permute(0, 2, 3, 1).flatten(1)
        if self.model == "S":
            features = torch.cat([features, heading.to(features.dtype)], dim=1)
        return F.relu_(torch.addmm(self.streams.bias.unsqueeze(1), self.streams.weight, features.t()))

    def _plane_response(self) -> Tensor:
        """Response of conv1's heading channel to a plane of ones, ``(1, 32, H', W')`` with the channels last."""
        kernel = self.conv1.weight[:, NUM_FRAMES].flatten(1)
        response = self._coverage @ kernel.t()
        return response.view(1, *self.conv1.output_size, -1).permute(0, 3, 1, 2)


def _coverage(convolution: _Convolution, height: int, width: int) -> Tensor:
    """Which places of a kernel lie inside the image: ``(H'·W', places of the kernel)``, 1 inside, 0 over the border."""
    axes = []
    for size, kernel in zip((height, width), convolution.kernel, strict=True):
        first = torch.arange(math.ceil(size / convolution.stride)) * convolution.stride
        place = first.unsqueeze(1) - same_padding(size, kernel, convolution.stride)[0] + torch.arange(kernel)
        axes.append(((place >= 0) & (place < size)).float())
    return torch.kron(*axes)


def make_q_actor(model: Model = "I", height: int = 64, width: int = 80) -> QValueActor:
    """The greedy policy of a new network.

    It reads ``depth`` and ``heading``, and writes ``action_value``, ``action`` and ``chosen_action_value``.

    Args:
        model: ``"I"`` or ``"S"``; see ``D3QN``.
        height: of the depth images, pixels.
        width: of the depth images, pixels.

    Returns:
        a TorchRL actor with a categorical action space, for tensordicts of any batch size.

    Raises:
        ValueError: for another model, or images smaller than the network's first kernel.
    """
    return QValueActor(D3QN(model, height, width), in_keys=["depth", "heading"], spec=Categorical(NUM_ACTIONS))
