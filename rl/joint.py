"""What an update of double Q-learning needs of the online and the target network, in few operations.

An update looks at s with the online network, and at s' with both. Beside the numbers it computes an operation costs
some 10 µs, and the networks are small: with eight samples, these costs are half of an update's time on a processor with
AMX. So here

- conv1 sees s' once, with both networks' kernels,
- the online network's other layers see s and s' together, and
- their gradients, through s only, are written out rather than recorded.

The numbers are those of ``D3QN.hidden``, which the tests compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from rl.convolution import Geometry, convolution, fastest_way, gradients
from rl.networks import D3QN


def hidden_of_update(
    online: D3QN,
    target: D3QN,
    observation: Sequence[Tensor],
    next_observation: Sequence[Tensor],
    *,
    double: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Hidden layers for an update of (double) Q-learning.

    The same as ``online.hidden(s)``, ``target.hidden(s')`` and ``online.hidden(s')``, of which only the first is
    differentiable.

    Args:
        online: the network that learns.
        target: the network that tells what s' is worth.
        observation: what they see of B states s, in the order of ``rl.observation.keys_of``.
        next_observation: of as many states s'.
        double: whether the online network judges s' as well.

    Returns:
        online of s, target of s' and, equal to the second unless ``double``, online of s', each ``(1024, B)``.
    """
    (depth, scalars), (next_depth, next_scalars) = online._flat(*observation), online._flat(*next_observation)
    kernel = online._byte_kernel()
    with torch.autocast(depth.device.type, enabled=False):  # what follows says itself in which format it multiplies
        offsets = online._offsets()
        geometries = online.conv2.geometry, online.conv3.geometry
        with torch.no_grad():
            next_maps = _maps_of_both(online, target, next_depth, next_scalars, kernel, offsets, double=double)
            next_appended = online._appended(next_scalars)
            weights = [weight.to(kernel.dtype) for weight in _weights(target)]
            next_hidden = _layers(next_maps[0].contiguous(), next_appended, weights, geometries).hidden
        hidden, choosing_hidden = _Online.apply(
            *(online._response(depth, kernel), offsets, online._shares(scalars), online._appended(scalars)),
            *(next_maps[1] if double else next_maps[0][:0], next_appended, geometries, *_weights(online)),
        )
    return hidden, next_hidden, choosing_hidden if double else next_hidden


def _maps_of_both(
    online: D3QN, target: D3QN, depth: Tensor, scalars: Tensor, kernel: Tensor, offsets: Tensor, *, double: bool
) -> Tensor:
    """What conv1 of the target network and, if ``double``, of the online network give: ``(1 or 2, B, H', W', 32)``."""
    kernels, all_offsets = [target._byte_kernel().to(kernel.dtype)], [target._offsets()]
    if double:
        kernels, all_offsets = [*kernels, kernel], [*all_offsets, offsets]
    channels = len(kernel)
    side_by_side = torch.cat([part.view(len(offsets), -1, channels) for part in all_offsets], dim=2).flatten(1)
    response = online._response(depth, torch.cat(kernels)).reshape(len(scalars), -1)
    maps = torch.addmm(response, online._shares(scalars).to(response.dtype), side_by_side.to(response.dtype)).relu_()
    return maps.view(len(scalars), *online.conv1.output_size, len(kernels), channels).permute(3, 0, 1, 2, 4)


def _weights(network: D3QN) -> tuple[Tensor, ...]:
    return tuple(
        weight for layer in (network.conv2, network.conv3, network.streams) for weight in (layer.weight, layer.bias)
    )


class _Activations(NamedTuple):
    second: Tensor
    """(B, 64, H'', W'')"""
    third: Tensor
    features: Tensor
    """``(B, n)``"""
    hidden: Tensor
    """``(1024, B)``"""


def _layers(
    maps: Tensor, appended: Tensor, weights: Sequence[Tensor], geometries: tuple[Geometry, Geometry]
) -> _Activations:
    """All above conv1, of what it gives, ``(B, H', W', 32)``."""
    weight2, bias2, weight3, bias3, weight, bias = weights
    second = convolution(maps.permute(0, 3, 1, 2), weight2, bias2, geometries[0]).relu_()
    third = convolution(second, weight3, bias3, geometries[1]).relu_()
    features = third.permute(0, 2, 3, 1).flatten(1)
    if appended.shape[1]:
        features = torch.cat([features, appended.to(features.dtype)], dim=1)
    return _Activations(second, third, features, torch.addmm(bias.unsqueeze(1), weight, features.t()).relu_())


class _Online(torch.autograd.Function):
    """The online network's hidden layers for s and for s', of conv1's response to s and of what it gives for s'."""

    @staticmethod
    def forward(
        ctx: Any,
        response: Tensor,
        offsets: Tensor,
        shares: Tensor,
        appended: Tensor,
        next_maps: Tensor,
        next_appended: Tensor,
        geometries: tuple[Geometry, Geometry],
        *weights: Tensor,
    ) -> tuple[Tensor, Tensor]:
        batch, dtype = len(shares), response.dtype
        shares = shares.to(dtype)
        maps = response.new_empty(batch + len(next_maps), *next_maps.shape[1:])
        own = maps[:batch].view(batch, -1)
        torch.addmm(response.reshape(batch, -1), shares, offsets.to(dtype), out=own).relu_()
        maps[batch:] = next_maps
        if len(next_maps):
            appended = torch.cat([appended, next_appended])
        multiplied = [weight.to(dtype) for weight in weights]
        second, third, features, hidden = _layers(maps, appended, multiplied, geometries)
        chosen, choosing = hidden[:, :batch], hidden[:, batch:]
        ctx.mark_non_differentiable(choosing)
        ctx.set_materialize_grads(False)
        ctx.geometries, ctx.precision = geometries, offsets.dtype
        ctx.save_for_backward(
            *(shares, maps[:batch], second[:batch], third[:batch], features[:batch], chosen),
            *(multiplied[0], multiplied[2], multiplied[4]),
        )
        return chosen, choosing

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, _: Tensor | None) -> tuple[Tensor | None, ...]:
        shares, maps, second, third, features, hidden, weight2, weight3, weight = ctx.saved_tensors
        precision, way = ctx.precision, fastest_way(gradient.device, gradient.dtype)
        gradient = _where_positive(gradient, hidden)
        of_weight, of_bias = gradient @ features, gradient.sum(1, dtype=precision)
        # "weight.T @ gradient" would be the same, and with 8 samples takes MKL eight times as long on an AMD processor
        gradient = (gradient.t() @ weight)[:, : third[0].numel()]
        gradient = gradient.reshape(len(third), *third.shape[2:], -1).permute(0, 3, 1, 2)
        of_layers = []
        for images, kernel, result, geometry in (
            (second, weight3, third, ctx.geometries[1]),
            (maps.permute(0, 3, 1, 2), weight2, second, ctx.geometries[0]),
        ):
            gradient = _where_positive(gradient, result)
            of_layers.append(gradient.sum((0, 2, 3), dtype=precision))
            of_images, of_kernel = gradients(gradient, images, kernel, geometry, way)
            of_layers.append(of_kernel.to(precision))
            assert of_images is not None
            gradient = of_images
        of_bias3, of_weight3, of_bias2, of_weight2 = of_layers
        of_response = _where_positive(gradient.permute(0, 2, 3, 1), maps).reshape(len(maps), -1)
        of_offsets = (shares.t() @ of_response).to(precision)
        return (
            *(of_response.view(-1, maps.shape[-1]), of_offsets, None, None, None, None, None),
            *(of_weight2, of_bias2, of_weight3, of_bias3, of_weight.to(precision), of_bias),
        )


def _where_positive(gradient: Tensor, result: Tensor) -> Tensor:
    """A rectifier's gradient, of that of its result."""
    return torch.ops.aten.threshold_backward(gradient, result, 0.0)
