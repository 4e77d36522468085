"""Convolutions: PyTorch's own, or formulated anew where a processor does those badly. All give the same numbers.

A convolution multiplies every *patch* of the images, the places under one position of its kernel, with the kernel's
weights. Here the patches are copied into the rows of a matrix (im2col: Chellapilla, Puri and Simard, *High Performance
Convolutional Neural Networks for Document Processing*, 2006) and the BLAS does the rest. oneDNN's own convolutions are
as fast forwards, but with AVX2 their weight gradients are not: for 64 samples of D3QN-I, conv1's takes 10.6 ms in place
of 3.3 + 1.5 ms for the patches, conv2's 2.4 in place of 1.4, conv3's 3.5 in place of 1.4 (one core of an EPYC "Milan",
torch 2.13). Images are laid out ``(B, H, W, C)``, so that a row of a patch lies in memory in one piece.

With AVX-512 it is the other way round, most of all in bfloat16: conv1 of 64 samples and its weight gradient take 2.9 ms
with oneDNN and 5.4 as products, conv3 with its gradients 1.7 and 2.8 (one core of an EPYC "Genoa").

With AMX, which multiplies bfloat16 matrices seven times as fast as AVX-512 does float32, a layer takes what reading and
arranging its numbers takes. Four channels are too few for it, so conv1's stride becomes channels ("space to depth",
PyTorch's ``pixel_unshuffle``): *blocks* of 8 x 8 pixels of four images are 256 channels, under a kernel of 2 x 2 of
them. With the weight gradient as one product it takes 3.8 ms for 64 samples, conversion from 8-bit images included, in
place of 8.9 (one core of a Xeon "Emerald Rapids"). The other layers' weight gradients are products of patches, their
images' gradients oneDNN's.

``convolve`` and ``convolve_bytes`` choose one of these ``Way``s by processor and number format, never by a stopwatch,
so that a run repeats itself bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

_ROWS = 640
"""Patches of 8-bit images that are copied at once: as many as stay in the processor's cache until they are used."""

_BLOCKS = 1600
"""Blocks of pixels of four images that are arranged at once, for the same reason."""

_BLOCK = 8
"""Pixels of a row of a block: the bytes of an int64, by which blocks are moved."""

Way = Literal["library", "products", "blocks"]
"""PyTorch's own; gradients as products of patches; for AMX, of 8-bit images in blocks."""


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


def fastest_way(device: torch.device, dtype: torch.dtype) -> Way:
    """How convolutions in that format are done there."""
    if device.type != "cpu":
        return "library"
    # Not every PyTorch that this works with can tell.
    capabilities: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    if dtype == torch.bfloat16 and capabilities.get("amx_bf16", False):
        return "blocks"
    return "library" if torch.backends.cpu.get_cpu_capability() == "AVX512" else "products"


def convolve(images: Tensor, weight: Tensor, bias: Tensor, geometry: Geometry) -> Tensor:
    """A convolution, ``(B, O, H', W')``.

    Args:
        images: ``(B, C, H, W)``, best with the channels last.
        weight: ``(O, C, height, width)``, in the format of the images.
        bias: ``(O,)``, likewise.
        geometry: for images of that size.
    """
    way = fastest_way(images.device, images.dtype)
    if way == "library":
        return convolution(images, weight, bias, geometry)
    return Convolution.apply(images, weight, bias, geometry, way)


def convolve_bytes(images: Tensor, weight: Tensor, geometry: Geometry, nearest: float | None = None) -> Tensor:
    """A convolution, without bias, of 8-bit images as they are stored, ``(B·H'·W', O)``.

    Args:
        images: ``(B, C, H, W)``, uint8.
        weight: ``(O, K)``, where K counts the kernel's places in the order row, column, channel; it may hold kernels
            of several networks. The result has its format.
        geometry: for images of that size.
        nearest: what is convolved of a pixel c is c itself or, given this number, ``nearest / max(c, nearest)``.
    """
    way = fastest_way(images.device, weight.dtype)
    if way == "products":
        return ByteConvolution.apply(images, weight, geometry, nearest)
    if way == "blocks" and geometry.stride == _BLOCK:
        return BlockConvolution.apply(images, weight, geometry, nearest)
    pixels = images.to(weight.dtype) if nearest is None else _inverse(images, nearest).to(weight.dtype)
    kernel = weight.view(len(weight), *geometry.kernel, images.shape[1]).permute(0, 3, 1, 2).contiguous()
    return convolution(pixels, kernel, None, geometry).permute(0, 2, 3, 1).reshape(-1, len(weight))


def convolution(images: Tensor, weight: Tensor, bias: Tensor | None, geometry: Geometry) -> Tensor:
    """PyTorch's own, where "SAME" borders may have an odd zero; arguments and result as for ``convolve``."""
    (top, bottom), (left, right) = geometry.rows, geometry.columns
    if top == bottom and left == right:
        return F.conv2d(images, weight, bias, geometry.stride, (top, left))
    return F.conv2d(F.pad(images, (left, right, top, bottom)), weight, bias, geometry.stride)


def _inverse(images: Tensor, nearest: float) -> Tensor:
    return images.float().clamp_(min=nearest).reciprocal_().mul_(nearest)


class Convolution(torch.autograd.Function):
    """``convolve`` with its own ``gradients``."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, weight: Tensor, bias: Tensor, geometry: Geometry, way: Way) -> Tensor:
        ctx.save_for_backward(images, weight)
        ctx.geometry, ctx.way = geometry, way
        return convolution(images, weight, bias, geometry)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        images, weight = ctx.saved_tensors
        of_images, of_weight = gradients(
            gradient, images, weight, ctx.geometry, ctx.way, of_images=ctx.needs_input_grad[0]
        )
        return of_images, of_weight, gradient.sum((0, 2, 3)), None, None


def gradients(
    gradient: Tensor, images: Tensor, weight: Tensor, geometry: Geometry, way: Way, *, of_images: bool = True
) -> tuple[Tensor | None, Tensor]:
    """Those of a convolution's images and weights.

    Args:
        gradient: of what comes out, ``(B, O, H', W')``.
        images: that went in, ``(B, C, H, W)``.
        weight: ``(O, C, height, width)``.
        geometry: for images of that size.
        way: to compute them.
        of_images: whether that of the images is needed.
    """
    if way == "library":
        return _gradients_of_library(gradient, images, weight, geometry, (of_images, True))
    image_gradient = None
    rows = gradient.permute(0, 2, 3, 1).reshape(-1, len(weight))
    if of_images and way == "products":
        kernel = weight.permute(0, 2, 3, 1).reshape(len(weight), -1)
        size = (len(images), *images.shape[2:], images.shape[1])
        image_gradient = sum_patches(rows @ kernel, geometry, size).permute(0, 3, 1, 2)
    elif of_images:
        image_gradient, _ = _gradients_of_library(gradient, images, weight, geometry, (True, False))
    of_weight = rows.t() @ patches(images.permute(0, 2, 3, 1), geometry, images.dtype)
    return image_gradient, of_weight.view(len(weight), *geometry.kernel, -1).permute(0, 3, 1, 2)


def _gradients_of_library(
    gradient: Tensor, images: Tensor, weight: Tensor, geometry: Geometry, wanted: tuple[bool, bool]
) -> tuple[Tensor, Tensor]:
    """PyTorch's own, those of images and weights that are wanted."""
    (top, bottom), (left, right) = geometry.rows, geometry.columns
    even = top == bottom and left == right
    padded = images if even else F.pad(images, (left, right, top, bottom))
    stride, padding, ones = [geometry.stride] * 2, [top, left] if even else [0, 0], [1, 1]
    of_images, of_weight, _ = torch.ops.aten.convolution_backward(
        gradient, padded, weight, None, stride, padding, ones, False, [0, 0], 1, [*wanted, False]
    )
    if of_images is not None and not even:
        of_images = of_images[..., top : top + images.shape[2], left : left + images.shape[3]]
    return of_images, of_weight


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
        return None, of_weight, None, None


class BlockConvolution(torch.autograd.Function):
    """``convolve_bytes`` of blocks of pixels."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, weight: Tensor, geometry: Geometry, nearest: float | None = None) -> Tensor:
        blocks = _blocks(images, geometry, weight.dtype, nearest)
        if ctx.needs_input_grad[1]:
            ctx.save_for_backward(blocks)
        ctx.geometry = geometry
        kernel = _kernel_of_blocks(weight, geometry, images.shape[1])
        return F.conv2d(blocks.permute(0, 3, 1, 2), kernel).permute(0, 2, 3, 1).reshape(-1, len(weight))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (blocks,) = ctx.saved_tensors
        batch, rows, columns, pixels = blocks.shape
        height, width = ctx.geometry.output
        down, right = rows - height + 1, columns - width + 1
        kernels = gradient.shape[1]
        # What each block is multiplied with under each of the kernel's blocks, side by side: one product for all.
        spread = gradient.new_zeros(batch, rows, columns, down, right, kernels)
        for y in range(down):
            for x in range(right):
                spread[:, y : y + height, x : x + width, y, x] = gradient.view(batch, height, width, kernels)
        of_kernel = spread.view(-1, down * right * kernels).t() @ blocks.view(-1, pixels)
        of_kernel = of_kernel.view(down, right, kernels, -1, _BLOCK, _BLOCK).permute(2, 0, 4, 1, 5, 3)
        of_kernel = of_kernel.reshape(kernels, down * _BLOCK, right * _BLOCK, -1)
        (kernel_height, kernel_width), _, _, _, _ = ctx.geometry
        return None, of_kernel[:, :kernel_height, :kernel_width].flatten(1), None, None


def _blocks(images: Tensor, geometry: Geometry, dtype: torch.dtype, nearest: float | None) -> Tensor:
    """Blocks of pixels of all channels, ``(B, rows, columns, C·8·8)``, with the zeros of the borders."""
    _, channels, height, width = images.shape
    rows, columns = _counts_of_blocks(geometry)
    (top, _), (left, _) = geometry.rows, geometry.columns
    result = images.new_empty(len(images), rows, columns, channels * _BLOCK * _BLOCK, dtype=dtype)
    count = max(1, min(len(images), _BLOCKS // (rows * columns)))
    padded = images.new_zeros(count, channels, rows * _BLOCK, columns * _BLOCK)
    inside = padded[..., top : top + height, left : left + width]
    in_order = padded.view(torch.int64).view(count, channels, rows, _BLOCK, columns).permute(0, 2, 4, 1, 3)
    if nearest is not None:  # a border's zero shall stay one
        inside.fill_(1)
        numerators = in_order[:1].contiguous().view(torch.uint8).view(1, *result.shape[1:]) * nearest
    for first in range(0, len(images), count):
        portion = result[first : first + count]
        inside[: len(portion)] = images[first : first + count]
        blocks = in_order[: len(portion)].contiguous().view(torch.uint8).view(portion.shape)
        if nearest is not None:
            blocks = blocks.float().clamp_(min=nearest)
            torch.div(numerators, blocks, out=blocks)
        portion.copy_(blocks)
    return result


def _counts_of_blocks(geometry: Geometry) -> tuple[int, int]:
    """Rows and columns of blocks under the kernel at all of its places."""
    rows, columns = (
        output + math.ceil(kernel / _BLOCK) - 1 for output, kernel in zip(geometry.output, geometry.kernel, strict=True)
    )
    return rows, columns


def _kernel_of_blocks(weight: Tensor, geometry: Geometry, channels: int) -> Tensor:
    """A kernel for blocks, ``(O, C·8·8, rows, columns)``, of one for pixels as ``convolve_bytes`` takes it."""
    height, width = geometry.kernel
    down, right = math.ceil(height / _BLOCK), math.ceil(width / _BLOCK)
    kernel = weight.view(len(weight), height, width, channels)
    kernel = F.pad(kernel, (0, 0, 0, right * _BLOCK - width, 0, down * _BLOCK - height))
    kernel = kernel.view(-1, down, _BLOCK, right, _BLOCK, channels).permute(0, 1, 3, 5, 2, 4)
    return kernel.reshape(len(weight), down, right, -1).permute(0, 3, 1, 2)


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
