"""Convolutions: PyTorch's own, or as products of matrices, which processors without AVX-512 need for their gradients.

A convolution multiplies every *patch* of the images, the places under one position of its kernel, with the kernel's
weights. Here the patches are copied into the rows of a matrix (im2col: Chellapilla, Puri and Simard, *High Performance
Convolutional Neural Networks for Document Processing*, 2006) and the BLAS does the rest. oneDNN's own convolutions are
as fast forwards, but with AVX2 their weight gradients are not: for 64 samples of D3QN-I, conv1's takes 10.6 ms in place
of 3.3 + 1.5 ms for the patches, conv2's 2.4 in place of 1.4, conv3's 3.5 in place of 1.4 (one core of an EPYC "Milan",
torch 2.13). Images are laid out ``(B, H, W, C)``, so that a row of a patch lies in memory in one piece.

With AVX-512 it is the other way round, most of all in bfloat16: conv1 of 64 samples and its weight gradient take 2.9 ms
with oneDNN and 5.4 as products, conv3 with its gradients 1.7 and 2.8 (one core of an EPYC "Genoa"). So ``convolve`` and
``convolve_bytes`` choose by the processor; both ways give the same numbers, as the tests compare.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

_ROWS = 640
"""Patches of 8-bit images that are copied at once: as many as stay in the processor's cache until they are used."""


class Geometry(NamedTuple):
    """Where a kernel is put on images of one size."""

    kernel: tuple[int, int]
    """height, width"""
    stride: int
    rows: tuple[int, int]
    """zeros before the first row and after the last"""
    columns: tuple[int, int]
    output: tuple[int, int]
    """height and width of what comes out"""


def patches(images: Tensor, geometry: Geometry, dtype: torch.dtype) -> Tensor:
    """Copies of the places under the kernel.

    Args:
        images: ``(B, H, W, C)``.
        geometry: for images of that size.
        dtype: the copies' format; converting while copying costs nothing.

    Returns:
        ``(B·H'·W', kernel height · width · C)``, contiguous.
    """
    padded = F.pad(images, (0, 0, *geometry.columns, *geometry.rows)).contiguous()
    batch, _, _, channels = padded.shape
    (height, width), stride = geometry.kernel, geometry.stride
    image, row, column, _ = padded.stride()
    view = padded.as_strided(
        (batch, *geometry.output, height, width * channels), (image, stride * row, stride * column, row, 1)
    )
    return view.to(dtype, memory_format=torch.contiguous_format, copy=True).view(-1, height * width * channels)


def sum_patches(values: Tensor, geometry: Geometry, size: tuple[int, int, int, int]) -> Tensor:
    """The transpose of ``patches``: images of ``size`` ``(B, H, W, C)``; a pixel sums what lay over it."""
    batch, rows, columns, channels = size
    (height, width), stride = geometry.kernel, geometry.stride
    padded = values.new_zeros(batch, rows + sum(geometry.rows), columns + sum(geometry.columns), channels)
    image, row, column, _ = padded.stride()
    values = values.view(batch, *geometry.output, height, width, channels)
    for y in range(height):
        for x in range(0, width, stride):  # places that are nearer to each other than the stride do not overlap
            count = min(stride, width - x)
            view = padded.as_strided(
                (batch, *geometry.output, count, channels),
                (image, stride * row, stride * column, column, 1),
                y * row + x * column,
            )
            view += values[..., y, x : x + count, :]
    (top, _), (left, _) = geometry.rows, geometry.columns
    return padded[:, top : top + rows, left : left + columns]


def by_products(device: torch.device) -> bool:
    """Whether products of matrices are faster than PyTorch's own convolutions there."""
    return device.type == "cpu" and torch.backends.cpu.get_cpu_capability() != "AVX512"


def convolve(images: Tensor, weight: Tensor, bias: Tensor, geometry: Geometry) -> Tensor:
    """A convolution, ``(B, O, H', W')``.

    Args:
        images: ``(B, C, H, W)``, best with the channels last.
        weight: ``(O, C, height, width)``, in the format of the images.
        bias: ``(O,)``, likewise.
        geometry: for images of that size.
    """
    if by_products(images.device):
        return Convolution.apply(images, weight, bias, geometry)
    return _convolution(images, weight, bias, geometry)


def convolve_bytes(images: Tensor, weight: Tensor, geometry: Geometry, nearest: float | None = None) -> Tensor:
    """A convolution, without bias, of 8-bit images as they are stored, ``(B·H'·W', O)``.

    Args:
        images: ``(B, C, H, W)``, uint8.
        weight: ``(O, K)``, where K counts the kernel's places in the order row, column, channel; it may hold kernels
            of several networks. The result has its format.
        geometry: for images of that size.
        nearest: what is convolved of a pixel c is c itself or, given this number, ``nearest / max(c, nearest)``.
    """
    if by_products(images.device):
        return ByteConvolution.apply(images, weight, geometry, nearest)
    pixels = images.to(weight.dtype) if nearest is None else _inverse(images, nearest).to(weight.dtype)
    kernel = weight.view(len(weight), *geometry.kernel, images.shape[1]).permute(0, 3, 1, 2).contiguous()
    return _convolution(pixels, kernel, None, geometry).permute(0, 2, 3, 1).reshape(-1, len(weight))


def _convolution(images: Tensor, weight: Tensor, bias: Tensor | None, geometry: Geometry) -> Tensor:
    """PyTorch's own, where "SAME" borders may have an odd zero."""
    (top, bottom), (left, right) = geometry.rows, geometry.columns
    if top == bottom and left == right:
        return F.conv2d(images, weight, bias, geometry.stride, (top, left))
    return F.conv2d(F.pad(images, (left, right, top, bottom)), weight, bias, geometry.stride)


def _inverse(images: Tensor, nearest: float) -> Tensor:
    return images.float().clamp_(min=nearest).reciprocal_().mul_(nearest)


class Convolution(torch.autograd.Function):
    """``convolve`` with products of matrices for its gradients."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, weight: Tensor, bias: Tensor, geometry: Geometry) -> Tensor:
        ctx.save_for_backward(images, weight)
        ctx.geometry = geometry
        return _convolution(images, weight, bias, geometry)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        images, weight = ctx.saved_tensors
        images, kernel = images.permute(0, 2, 3, 1), weight.permute(0, 2, 3, 1)
        gradient = gradient.permute(0, 2, 3, 1).reshape(-1, len(weight))
        of_weight = (gradient.t() @ patches(images, ctx.geometry, images.dtype)).view(kernel.shape)
        of_images = None
        if ctx.needs_input_grad[0]:
            of_images = sum_patches(gradient @ kernel.reshape(len(kernel), -1), ctx.geometry, images.shape)
            of_images = of_images.permute(0, 3, 1, 2)
        return of_images, of_weight.permute(0, 3, 1, 2), gradient.sum(0), None


class ByteConvolution(torch.autograd.Function):
    """``convolve_bytes`` as products of matrices.

    Patches, in ``weight``'s format, are many times as large as the images, so a few samples' are made at a time, which
    are still in the cache when they are multiplied.
    """

    @staticmethod
    def forward(ctx: Any, images: Tensor, weight: Tensor, geometry: Geometry, nearest: float | None = None) -> Tensor:
        ctx.portions = []
        ctx.precision = torch.promote_types(weight.dtype, torch.float32)
        result = weight.new_empty(len(images) * geometry.output[0] * geometry.output[1], len(weight))
        for place, rows in _portions(images, geometry, weight.dtype, nearest):
            torch.mm(rows, weight.t(), out=result[place])
            if ctx.needs_input_grad[1]:
                ctx.portions.append((place, rows))
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        of_weight = sum((gradient[place].t() @ rows).to(ctx.precision) for place, rows in ctx.portions)
        ctx.portions = []
        return None, of_weight, None, None


def _portions(
    images: Tensor, geometry: Geometry, dtype: torch.dtype, nearest: float | None
) -> Iterator[tuple[slice, Tensor]]:
    """Patches of a few images at a time, and which rows of the whole they are."""
    positions = geometry.output[0] * geometry.output[1]
    count = max(1, _ROWS // positions)
    for first in range(0, len(images), count):
        portion = torch.stack(images[first : first + count].unbind(1), dim=-1)  # faster than permute and contiguous
        if nearest is not None:
            portion = _inverse(portion, nearest)
        place = slice(first * positions, (first + len(portion)) * positions)
        yield place, patches(portion, geometry, dtype)
