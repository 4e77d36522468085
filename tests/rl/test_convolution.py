"""Convolutions as products of matrices, beside PyTorch's own."""

from __future__ import annotations

from typing import get_args

import pytest
import torch
from torch.nn import functional as F

from rl import convolution
from rl.convolution import Geometry, Way, convolve, convolve_bytes, patches, sum_patches

GEOMETRIES = [
    ((9, 11), Geometry((4, 4), 2, (1, 1), (1, 1), (4, 5))),
    ((9, 11), Geometry((4, 5), 3, (0, 1), (1, 1), (3, 3))),
    ((4, 5), Geometry((3, 3), 1, (1, 1), (1, 1), (4, 5))),
    ((12, 20), Geometry((10, 14), 8, (3, 3), (1, 1), (2, 2))),
]


@pytest.fixture(params=get_args(Way))
def _way(request, monkeypatch):
    """Every way, whatever this processor's is."""
    monkeypatch.setattr(convolution, "fastest_way", lambda device, dtype: request.param)


def padded(images: torch.Tensor, geometry: Geometry) -> torch.Tensor:
    return F.pad(images, (*geometry.columns, *geometry.rows))


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize(("size", "geometry"), GEOMETRIES)
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_convolution_and_its_gradients_are_those_of_pytorch(size, geometry, layout):
    images = torch.randn(3, 2, *size).contiguous(memory_format=layout).requires_grad_()
    weight, bias = torch.randn(6, 2, *geometry.kernel, requires_grad=True), torch.randn(6, requires_grad=True)
    ours = convolve(images, weight, bias, geometry)
    expected = F.conv2d(padded(images, geometry), weight, bias, geometry.stride)
    torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-4)
    upstream = torch.randn_like(expected)
    inputs = (images, weight, bias)
    for gradient, reference in zip(
        torch.autograd.grad(ours, inputs, upstream), torch.autograd.grad(expected, inputs, upstream), strict=True
    ):
        torch.testing.assert_close(gradient, reference, rtol=1e-4, atol=1e-4)


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize(("size", "geometry"), GEOMETRIES)
@pytest.mark.parametrize(("batch", "nearest"), [(1, None), (1300, None), (1300, 20.4)])
def test_images_of_bytes_are_convolved(size, geometry, batch, nearest):
    images = torch.randint(0, 256, (batch, 4, *size), dtype=torch.uint8)
    weight = torch.randn(5, 4, *geometry.kernel, requires_grad=True)
    flat = weight.permute(0, 2, 3, 1).flatten(1)
    ours = convolve_bytes(images, flat, geometry, nearest).view(batch, *geometry.output, 5).permute(0, 3, 1, 2)
    pixels = images.float() if nearest is None else nearest / images.clamp(min=nearest)
    expected = F.conv2d(padded(pixels, geometry), weight, None, geometry.stride)
    torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-4 * float(expected.detach().abs().max()))
    upstream = torch.randn_like(expected)
    (gradient,), (reference,) = (torch.autograd.grad(result, weight, upstream) for result in (ours, expected))
    torch.testing.assert_close(gradient, reference, rtol=1e-3, atol=1e-4 * float(reference.abs().max()))


@pytest.mark.parametrize(("size", "geometry"), GEOMETRIES)
def test_summing_patches_is_the_transpose_of_taking_them(size, geometry):
    images = torch.randn(2, *size, 3, dtype=torch.float64)
    taken = patches(images, geometry, torch.float64)
    values = torch.randn_like(taken)
    summed = sum_patches(values, geometry, tuple(images.shape))
    torch.testing.assert_close((taken * values).sum(), (images * summed).sum())


@pytest.mark.parametrize(
    ("capability", "amx", "in_float32", "in_bfloat16"),
    [
        ("AVX512", True, "library", "blocks"),
        ("AVX512", False, "library", "library"),
        ("AVX2", False, "products", "products"),
        ("DEFAULT", False, "products", "products"),
    ],
)
def test_the_way_is_chosen_by_the_processor(monkeypatch, capability, amx, in_float32, in_bfloat16):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"amx_bf16": amx}, raising=False)
    processor, gpu = torch.device("cpu"), torch.device("cuda")
    assert convolution.fastest_way(processor, torch.float32) == in_float32
    assert convolution.fastest_way(processor, torch.bfloat16) == in_bfloat16
    assert convolution.fastest_way(gpu, torch.bfloat16) == "library"


def test_a_pytorch_that_does_not_tell_of_amx_convolves_without_blocks(monkeypatch):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    monkeypatch.delattr(torch.cpu, "get_capabilities", raising=False)
    assert convolution.fastest_way(torch.device("cpu"), torch.bfloat16) == "library"


@pytest.mark.usefixtures("_way")
def test_gradients_can_be_asked_for_twice():
    size, geometry = GEOMETRIES[0]
    images = torch.randint(0, 256, (3, 4, *size), dtype=torch.uint8)
    weight = torch.randn(5, 4 * geometry.kernel[0] * geometry.kernel[1], requires_grad=True)
    value = convolve_bytes(images, weight, geometry).square().sum()
    (one,) = torch.autograd.grad(value, weight, retain_graph=True)
    (other,) = torch.autograd.grad(value, weight)
    assert torch.equal(one, other)
