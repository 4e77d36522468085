"""The dueling Q-networks of the thesis, D3QN-I and D3QN-S, at any image size.

Three convolutions with TensorFlow's "SAME" geometry look at the last four depth images; two streams of 512 units turn
what they see into a value V and seven advantages A, and Q = V + A − mean(A) (Wang et al. 2016, arXiv 1511.06581).
The models differ in how the heading θ of the goal enters, always as (θ + π) / 2π:

- **D3QN-I**: as a fifth image plane, the same number in every pixel.
- **D3QN-S**: appended to the flattened features, the input of both streams.

Variants see less or more (``inputs``): one of both inputs alone, which tells what the other is worth, or besides,
appended to the features, the robot's own command (v, ω) and the distances that it remembers around itself
(``rl.surroundings``). And depth may enter as it is or inverted (``depth_scale``). The thesis's networks see depth
divided by the greatest one, 5 m, so that the range that decides whether a robot collides, 0.4 to 1 m, is 12% of what
their first layer tells apart. Inverted, as stereo cameras and the Kinect itself measure it (disparity), it is 60%.

Some things are computed differently from how they are written above, and give the same numbers (the tests compare):

- Convolutions are products of matrices where these are faster, see ``rl.convolution``; features are flattened in the
  order row, column, channel, as in TensorFlow.
- The first layers of the two streams, 512 units each, are one matrix product of 1024 rows, written
  ``weights @ features.T``, which the BLAS does faster than its transpose.
- A constant plane is not convolved. A convolution is linear, so the plane contributes its number times the response of
  conv1's fifth channel to a plane of ones, which depends on the weights only.
- The images' division by 255 is done on conv1's weights, so that 8-bit images enter as they are; every value from 0 to
  255 is exact in bfloat16, too. Inverted depth is computed of a few images at a time, which are in the cache.
- ``rl.joint`` judges what an update of double Q-learning needs in fewer, larger operations.

docs/performance.md tells what each of these gives, and what was tried besides.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection
from typing import Any, NamedTuple, get_args

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F
from torchrl.data import Categorical
from torchrl.modules import QValueActor

from navsim.robot import ACTIONS, NUM_ACTIONS
from rl.convolution import Geometry, convolve, convolve_bytes
from rl.mirror import mirrored
from rl.observation import (
    DEPTH_AND_HEADING,
    NEAREST,
    NUM_FRAMES,
    DepthScale,
    HeadingInit,
    Input,
    Model,
    check_inputs,
    keys_of,
)
from rl.surroundings import SECTORS

_FASTEST = tuple(max(abs(command[axis] or 0.0) for command in ACTIONS) for axis in (0, 1))

_TOUCHING = 0.2
"""Metres from a robot's centre: what it remembers nearer counts 1, what is farther this over the distance."""

_MEAN_DEPTH: dict[DepthScale, float] = {"linear": 0.5, "inverse": 0.25}
"""Of the pixels that robots see in ``complex_train``, rounded: 0.49 and 0.26."""
_MEAN_HEADING = 0.5

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
    """A convolution with TensorFlow's "SAME" geometry for images of one size, best with the channels last.

    Args:
        in_channels: channels of the images.
        out_channels: channels of the output.
        kernel_size: (height, width).
        stride: of both axes.
        image_size: (height, width) of the images.

    Attributes:
        output_size: (height, width) of the output.
        geometry: where the kernel is put.
    """

    bias: Tensor

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: tuple[int, int],
        stride: int,
        image_size: tuple[int, int],
    ) -> None:
        super().__init__(in_channels, out_channels, kernel_size, stride)
        self.weight.data = self.weight.data.contiguous(memory_format=torch.channels_last)
        self.output_size = (math.ceil(image_size[0] / stride), math.ceil(image_size[1] / stride))
        rows, columns = (
            same_padding(size, kernel, stride) for size, kernel in zip(image_size, kernel_size, strict=True)
        )
        self.geometry = Geometry(kernel_size, stride, rows, columns, self.output_size)

    def forward(self, images: Tensor) -> Tensor:
        """``(B, out_channels, H', W')`` from ``images`` ``(B, in_channels, H, W)``, in the format of the images."""
        return convolve(images, self.weight.to(images.dtype), self.bias.to(images.dtype), self.geometry)


class D3QN(nn.Module):
    """Dueling Q-network over four depth images and the heading of the goal.

    Args:
        model: ``"I"``, the heading as an image plane, or ``"S"``, as a scalar beside the features.
        height: of the depth images, pixels; at least 10, the height of the first kernel.
        width: of the depth images, pixels; at least 14.
        inputs: what it sees. Images or headings that are not among them are zeros to it, whatever it is given.
        depth_scale: what becomes of a depth d between 0 and 1, of the greatest: ``"linear"``, d itself, or
            ``"inverse"``, 0.08 / max(d, 0.08). It is no weight, and a state dict does not tell it.
        heading_init: how D3QN-S's weights for the heading begin; D3QN-I has none of its own.
        centred: whether what conv1 sees, images and D3QN-I's heading, is lessened by what it is on average, so that it
            is negative as often as positive.

    Attributes:
        symmetric: whether calling it gives the mean of its values for what it sees and for the mirror image of that,
            see ``symmetric_policy``.
        conv1, conv2, conv3: the convolutions; the fifth input channel of D3QN-I's ``conv1`` is the heading's.
        streams: the first layers of both streams, value before advantage.
        value, advantage: the streams' last layers.

    Raises:
        ValueError: for another model, scale or beginning, no or unknown inputs, or images smaller than the first
            kernel.

    Weights begin as in TensorFlow, the thesis's framework: Glorot's uniform distribution (2010), for each stream of its
    own, and biases of zero. For the heading of D3QN-S that is too little: it is one of 1,281 inputs of the streams,
    with weights of 0.03 and its units' kinks all at θ = −π, and takes tens of thousands of transitions to be heard. So
    these weights begin *spread*: uniform in (−1, 1), with biases that put each unit's kink at a heading of its own.

    The convolutions' weights lie in memory with their channels last, in which order they are multiplied. What takes
    contiguous ones alone, such as safetensors, ``parameters_to_vector`` and ``torch.optim.LBFGS``, gets them by
    ``network.to(memory_format=torch.contiguous_format)``, which changes no number.

    >>> network = D3QN("S", height=64, width=80)
    >>> network(torch.zeros(2, 4, 64, 80, dtype=torch.uint8), torch.zeros(2, 1)).shape
    torch.Size([2, 7])
    """

    _coverage: Tensor
    _fastest: Tensor

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
    ) -> None:
        super().__init__()
        if model not in get_args(Model):
            raise ValueError(
                f'model must be "I" (heading as an image plane) or "S" (heading as a scalar); got {model!r}'
            )
        if depth_scale not in get_args(DepthScale):
            raise ValueError(f'depth_scale must be "linear" or "inverse"; got {depth_scale!r}')
        if heading_init not in get_args(HeadingInit):
            raise ValueError(f'heading_init must be "spread" or "glorot"; got {heading_init!r}')
        check_inputs(inputs)
        least = _CONVOLUTIONS[0].kernel
        if height < least[0] or width < least[1]:
            raise ValueError(
                f"depth images of {width} x {height} pixels are smaller than the network's first kernel;"
                f" use at least {least[1]} x {least[0]}"
            )
        self.model = model
        self.inputs = frozenset(inputs)
        self.depth_scale = depth_scale
        self.heading_init = heading_init
        self.centred = centred
        self.symmetric = False
        self.image_shape = (NUM_FRAMES, height, width)

        channels, size = NUM_FRAMES + (model == "I"), (height, width)
        layers = []
        for convolution in _CONVOLUTIONS:
            layer = SameConv2d(channels, convolution.channels, convolution.kernel, convolution.stride, size)
            channels, size = convolution.channels, layer.output_size
            layers.append(layer)
        self.conv1, self.conv2, self.conv3 = layers
        self._features_of_images = channels * size[0] * size[1]
        appended = (model == "S") + 2 * ("command" in self.inputs) + SECTORS * ("surroundings" in self.inputs)
        self.streams = nn.Linear(self._features_of_images + appended, 2 * STREAM_WIDTH)
        self.value = nn.Linear(STREAM_WIDTH, 1)
        self.advantage = nn.Linear(STREAM_WIDTH, NUM_ACTIONS)
        self.reset_parameters()

        if "command" in self.inputs:
            self.register_buffer("_fastest", torch.tensor(_FASTEST), persistent=False)
        if model == "I" or centred:
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
        if self.model == "S" and self.heading_init == "spread":
            slopes = torch.empty(2 * STREAM_WIDTH).uniform_(-1.0, 1.0)
            kinks = torch.rand(2 * STREAM_WIDTH)  # where slope · heading + bias is zero, for headings from 0 to 1
            self.streams.weight.data[:, self._features_of_images] = slopes
            self.streams.bias.data.copy_(-slopes * kinks)

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

    def forward(self, depth: Tensor, heading: Tensor, *others: Tensor) -> Tensor:
        """Action values, ``(..., 7)``.

        Args:
            depth: uint8 ``(..., 4, H, W)``, oldest image first; 255 is the camera's greatest range.
            heading: float32 ``(..., 1)``, radians in (−π, π].
            others: what the network sees besides, in this order: the command in force, float32 ``(..., 2)``, m/s and
                rad/s; distances remembered around the robot, float32 ``(..., 36)``, metres.

        Raises:
            ValueError: for images of another size or format, or if there is more or less than the network sees.
        """
        observation: tuple[Tensor, ...] = (depth, heading, *others)
        if self.symmetric:
            named = self._named(observation)
            observation = tuple(torch.stack([seen, mirrored(key, seen)]) for key, seen in named.items())
        values = self.head(self.hidden(*observation)).reshape(*observation[0].shape[:-3], NUM_ACTIONS)
        return (values[0] + mirrored("action_value", values[1])) / 2.0 if self.symmetric else values

    def hidden(self, depth: Tensor, heading: Tensor, *others: Tensor) -> Tensor:
        """The hidden layers of both streams, one sample a column: ``(1024, B)``; arguments as for ``forward``."""
        depth, scalars = self._flat(depth, heading, *others)
        return self._streams(self._features(self._response(depth, self._byte_kernel()), scalars))

    def first_maps(self, depth: Tensor, heading: Tensor, *others: Tensor) -> Tensor:
        """What conv1 gives, rectified, ``(B, H', W', 32)``; arguments as for ``forward``.

        A kernel that is zero everywhere, whatever the network sees, learns nothing any more.
        """
        images, scalars = self._flat(depth, heading, *others)
        return self._maps(self._response(images, self._byte_kernel()), scalars)

    def head(self, hidden: Tensor) -> Tensor:
        """Action values, ``(B, 7)``, of hidden layers ``(1024, B)``."""
        with torch.autocast(hidden.device.type, enabled=False):  # Q-values need more than bfloat16's three digits
            hidden = hidden.to(self.value.weight.dtype)
            value = torch.addmm(self.value.bias.unsqueeze(1), self.value.weight, hidden[:STREAM_WIDTH])
            advantage = torch.addmm(self.advantage.bias.unsqueeze(1), self.advantage.weight, hidden[STREAM_WIDTH:])
            return (value + advantage - advantage.mean(0, keepdim=True)).t()

    def _named(self, observation: tuple[Tensor, ...]) -> dict[str, Tensor]:
        """What the network is called with, by its keys."""
        keys = keys_of(self.inputs)
        if len(observation) != len(keys):
            raise ValueError(f"the network sees {', '.join(keys)}, in this order; got {len(observation)} of them")
        return dict(zip(keys, observation, strict=True))

    def _flat(self, depth: Tensor, heading: Tensor, *others: Tensor) -> tuple[Tensor, Tensor]:
        """Images ``(B, 4, H, W)``, and numbers ``(B, n)``: heading and closeness from 0 to 1, command from −1 to 1."""
        if depth.shape[-3:] != self.image_shape:
            raise ValueError(
                f"the network is for depth images of shape {self.image_shape} (frames, height, width);"
                f" got {tuple(depth.shape[-3:])}"
            )
        if depth.dtype != torch.uint8:
            raise ValueError(
                f"depth images are uint8, 0 at the camera and 255 at its greatest range; got {depth.dtype}:"
                " DepthCamera.to_uint8 makes them of metres"
            )
        depth, scalars = depth.reshape(-1, *self.image_shape), ((heading + math.pi) / (2.0 * math.pi)).reshape(-1, 1)
        if "heading" not in self.inputs:
            scalars = torch.zeros_like(scalars)
        seen = self._named((depth, heading, *others))
        if "command" in seen:
            scalars = torch.cat([scalars, seen["command"].reshape(-1, 2) / self._fastest], dim=1)
        if "surroundings" in seen:
            closeness = _TOUCHING / seen["surroundings"].reshape(-1, SECTORS).clamp(min=_TOUCHING)
            scalars = torch.cat([scalars, closeness], dim=1)
        return depth, scalars

    def _byte_kernel(self) -> Tensor:
        """conv1's weights for what ``_response`` convolves, ``(32, 560)``, in the format that networks multiply in."""
        share = (1.0 if self.depth_scale == "inverse" else 1.0 / 255.0) * ("depth" in self.inputs)
        weight = self.conv1.weight[:, :NUM_FRAMES].permute(0, 2, 3, 1).flatten(1) * share
        device = weight.device.type
        return weight.to(torch.get_autocast_dtype(device)) if torch.is_autocast_enabled(device) else weight

    def _response(self, depth: Tensor, kernels: Tensor) -> Tensor:
        """What 8-bit images ``(B, 4, H, W)`` give with the kernels of one or more networks, ``(B·H'·W', 32 each)``."""
        nearest = 255.0 * NEAREST if self.depth_scale == "inverse" else None
        return convolve_bytes(depth, kernels, self.conv1.geometry, nearest)

    def _features(self, response: Tensor, scalars: Tensor) -> Tensor:
        """What the streams see, ``(B, n)``, of conv1's ``response`` to the images, ``(B·H'·W', 32)`` without bias."""
        maps = self._maps(response, scalars).permute(0, 3, 1, 2)
        features = F.relu_(self.conv3(F.relu_(self.conv2(maps)))).permute(0, 2, 3, 1).flatten(1)
        appended = self._appended(scalars)
        return torch.cat([features, appended.to(features.dtype)], dim=1) if appended.shape[1] else features

    def _maps(self, response: Tensor, scalars: Tensor) -> Tensor:
        """What conv1 gives, ``(B, H', W', 32)``, of its ``response`` to the images without bias."""
        batch, dtype = len(scalars), response.dtype
        offsets = self._offsets().to(dtype)
        maps = torch.addmm(response.reshape(batch, offsets.shape[1]), self._shares(scalars).to(dtype), offsets)
        return F.relu_(maps).view(batch, *self.conv1.output_size, _CONVOLUTIONS[0].channels)

    def _offsets(self) -> Tensor:
        """What conv1's response lacks, ``(n, H'·W'·32)``, to be added in these ``_shares``: its bias, less what centred
        images are lessened by, and, for D3QN-I, its heading channel's response to a plane of ones."""
        rows, columns = self.conv1.output_size
        bias = self.conv1.bias.expand(1, rows * columns, -1)
        if self.centred and "depth" in self.inputs:
            of_images = self._coverage @ self.conv1.weight[:, :NUM_FRAMES].sum(1).flatten(1).t()
            bias = bias - _MEAN_DEPTH[self.depth_scale] * of_images
        if self.model == "S":
            return bias.flatten(1)
        of_plane = self._coverage @ self.conv1.weight[:, NUM_FRAMES].flatten(1).t()
        return torch.cat([bias, of_plane.unsqueeze(0)]).flatten(1)

    def _shares(self, scalars: Tensor) -> Tensor:
        """How much of each of the ``_offsets`` there is, ``(B, n)``."""
        ones = scalars.new_ones(len(scalars), 1)
        if self.model == "S":
            return ones
        mean = _MEAN_HEADING if self.centred and "heading" in self.inputs else 0.0
        return torch.cat([ones, scalars[:, :1] - mean], dim=1)

    def _appended(self, scalars: Tensor) -> Tensor:
        """What the streams see beside the images' features, ``(B, n)``."""
        return scalars if self.model == "S" else scalars[:, 1:]

    def _streams(self, features: Tensor) -> Tensor:
        weight, bias = self.streams.weight.to(features.dtype), self.streams.bias.to(features.dtype)
        return F.relu_(_Streams.apply(features, weight, bias))


class _Streams(torch.autograd.Function):
    """``weight @ features.T + bias``."""

    @staticmethod
    def forward(ctx: Any, features: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(features, weight)
        return torch.addmm(bias.unsqueeze(1), weight, features.t())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        features, weight = ctx.saved_tensors
        # "weight.T @ gradient" would be the same, and with 8 samples takes MKL eight times as long on an AMD processor
        return gradient.t() @ weight, gradient @ features, gradient.sum(1)


def _coverage(convolution: _Convolution, height: int, width: int) -> Tensor:
    """Which places of a kernel lie inside the image: ``(H'·W', places of the kernel)``, 1 inside, 0 over the border."""
    axes = []
    for size, kernel in zip((height, width), convolution.kernel, strict=True):
        first = torch.arange(math.ceil(size / convolution.stride)) * convolution.stride
        place = first.unsqueeze(1) - same_padding(size, kernel, convolution.stride)[0] + torch.arange(kernel)
        axes.append(((place >= 0) & (place < size)).to(torch.get_default_dtype()))
    return torch.kron(*axes)


def make_q_actor(
    model: Model = "I",
    height: int = 64,
    width: int = 80,
    inputs: Collection[Input] = DEPTH_AND_HEADING,
    depth_scale: DepthScale = "linear",
    *,
    heading_init: HeadingInit = "spread",
    centred: bool = False,
) -> QValueActor:
    """The greedy policy of a new network.

    It reads ``depth``, ``heading`` and, if it sees them, ``command`` and ``surroundings``, and writes ``action_value``,
    ``action`` and ``chosen_action_value``.

    Args:
        model: ``"I"`` or ``"S"``; see ``D3QN``.
        height: of the depth images, pixels.
        width: of the depth images, pixels.
        inputs: what it sees.
        depth_scale: how; see ``D3QN``.
        heading_init: see ``D3QN``.
        centred: see ``D3QN``.

    Returns:
        a TorchRL actor with a categorical action space, for tensordicts of any batch size.

    Raises:
        ValueError: as ``D3QN``.
    """
    network = D3QN(model, height, width, inputs, depth_scale, heading_init=heading_init, centred=centred)
    return QValueActor(network, in_keys=keys_of(inputs), spec=Categorical(NUM_ACTIONS))


def symmetric_policy(actor: QValueActor) -> QValueActor:
    """The greedy policy that goes by what a network says of its world and of the mirror image of it.

    Each action's value is the mean of its own for what is seen and the mirrored action's for the mirror image, so that
    in a mirrored world the policy does the mirrored action, which learning from mirrored samples makes likely but not
    certain. Two opinions for twice the computing: what the network has not learnt alike for left and right cancels out.

    Args:
        actor: from ``make_q_actor`` or ``rl.load_policy``. It stays as it is; the weights are shared.

    Raises:
        ValueError: for an actor around a network that is no ``D3QN``.
    """
    network = copy.copy(actor.module[0].module)
    if not isinstance(network, D3QN):
        raise ValueError(f"a symmetric policy needs an actor around a D3QN; got one around a {type(network).__name__}")
    network.symmetric = True
    policy = QValueActor(network, in_keys=keys_of(network.inputs), spec=Categorical(NUM_ACTIONS)).train(actor.training)
    if hasattr(actor, "trained_as"):
        policy.trained_as = actor.trained_as
    return policy
