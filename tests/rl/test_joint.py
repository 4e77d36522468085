"""The networks' part of an update, beside what each network does alone."""

from __future__ import annotations

from typing import get_args

import pytest
import torch

from rl import convolution, joint
from rl.convolution import Way
from rl.joint import hidden_of_update
from rl.networks import D3QN

SIZES = [(64, 80), (10, 14), (61, 77), (33, 90)]
"""Heights and widths: one of the thesis's, the smallest, and two whose padding is not symmetric."""


@pytest.fixture(params=get_args(Way))
def change_way(request, monkeypatch):
    """Makes convolutions go a way that may not be this processor's."""

    def change():
        for module in (convolution, joint):
            monkeypatch.setattr(module, "fastest_way", lambda device, dtype: request.param)

    return change


def observation(height, width, command, count=11):
    depth = torch.randint(0, 256, (count, 4, height, width), dtype=torch.uint8)
    heading = (torch.rand(count, 1) * 2 - 1) * torch.pi
    return (depth, heading, torch.randn(count, 2)) if command else (depth, heading)


def gradients(network, hidden, weights):
    """Of all layers that ``hidden`` comes from."""
    layers = (network.conv1, network.conv2, network.conv3, network.streams)
    parameters = [parameter for layer in layers for parameter in layer.parameters()]
    return torch.autograd.grad((hidden.float() * weights).sum(), parameters)


def relative_error(values, reference):
    return float(((values - reference).norm() / reference.norm()).detach())


@pytest.mark.parametrize("model", ["I", "S"])
@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    ("command", "depth_scale", "centred"), [(False, "linear", False), (True, "inverse", False), (True, "linear", True)]
)
def test_an_update_sees_the_hidden_layers_that_each_network_would_have(
    change_way, model, double, height, width, command, depth_scale, centred
):
    torch.manual_seed(0)
    inputs = ("depth", "heading", "command") if command else ("depth", "heading")
    online, target = (D3QN(model, height, width, inputs, depth_scale, centred=centred) for _ in range(2))
    now, after = (observation(height, width, command) for _ in range(2))
    expected = online.hidden(*now), target.hidden(*after), online.hidden(*after)
    weights = torch.randn_like(expected[0])
    expected_gradients = gradients(online, expected[0], weights)

    change_way()
    results = hidden_of_update(online, target, now, after, double=double)

    for result, reference in zip(results, (*expected[:2], expected[1 + double]), strict=True):
        torch.testing.assert_close(result, reference, rtol=1e-4, atol=1e-5)
    assert not results[1].requires_grad
    assert not results[2].requires_grad
    for gradient, reference in zip(gradients(online, results[0], weights), expected_gradients, strict=True):
        torch.testing.assert_close(gradient, reference, rtol=1e-4, atol=1e-5 * float(reference.abs().max()))


@pytest.mark.parametrize("model", ["I", "S"])
def test_a_batch_may_be_of_one(change_way, model):
    torch.manual_seed(0)
    online, target = (D3QN(model) for _ in range(2))
    now, after = (observation(64, 80, command=False, count=1) for _ in range(2))
    expected = online.hidden(*now), target.hidden(*after), online.hidden(*after)
    expected_gradients = gradients(online, expected[0], torch.ones_like(expected[0]))
    change_way()
    results = hidden_of_update(online, target, now, after, double=True)
    for result, reference in zip(results, expected, strict=True):
        torch.testing.assert_close(result, reference, rtol=1e-4, atol=1e-5)
    own = gradients(online, results[0], torch.ones_like(expected[0]))
    for gradient, reference in zip(own, expected_gradients, strict=True):
        torch.testing.assert_close(gradient, reference, rtol=1e-4, atol=1e-5 * float(reference.abs().max()))


@pytest.mark.parametrize("model", ["I", "S"])
def test_in_bfloat16_hidden_layers_and_gradients_are_near_those_in_float32(change_way, model):
    torch.manual_seed(0)
    online, target = (D3QN(model, 61, 77) for _ in range(2))
    now, after = (observation(61, 77, command=False) for _ in range(2))
    exact = hidden_of_update(online, target, now, after, double=True)
    weights = torch.randn_like(exact[0])
    exact_gradients = gradients(online, exact[0], weights)

    change_way()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        results = hidden_of_update(online, target, now, after, double=True)

    assert all(result.dtype == torch.bfloat16 for result in results)
    assert all(relative_error(result, reference) < 0.01 for result, reference in zip(results, exact, strict=True))
    pairs = zip(gradients(online, results[0], weights), exact_gradients, strict=True)
    # Rectifiers that rounding opens or closes make 7% of them, layer by layer under autograd, too.
    assert all(relative_error(gradient, reference) < 0.12 for gradient, reference in pairs)
