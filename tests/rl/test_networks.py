"""The Q-networks beside their plain definition, written out with loops, padding and a fifth image plane."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F
from torchrl.data import Categorical
from torchrl.modules import QValueActor

from rl.categorical import make_categorical_actor
from rl.networks import D3QN, SameConv2d, make_q_actor, same_padding, symmetric_policy

SIZES = [(64, 80), (10, 14), (61, 77), (33, 90)]
"""Heights and widths: one of the thesis's, the smallest, and two whose padding is not symmetric."""


def observations(*batch: int, height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    depth = torch.randint(0, 256, (*batch, 4, height, width), dtype=torch.uint8)
    return depth, (torch.rand(*batch, 1) * 2 - 1) * math.pi


def pad_as_tensorflow(images: torch.Tensor, kernel: tuple[int, int], stride: int) -> torch.Tensor:
    """ "SAME" as the TensorFlow guide defines it, with its two cases."""
    border = []
    for size, length in zip(images.shape[-2:], kernel, strict=True):
        rest = size % stride
        total = max(length - (rest or stride), 0)
        border.append((total // 2, total - total // 2))
    return F.pad(images, (*border[1], *border[0]))


def plain_action_values(
    network: D3QN, depth: torch.Tensor, heading: torch.Tensor, *others: torch.Tensor, first: list | None = None
) -> torch.Tensor:
    """Q as design and thesis define it: images from 0 to 1, a real heading plane, two separate streams."""
    images = depth.float() / 255
    if network.depth_scale == "inverse":
        images = 0.08 / images.clamp(min=0.08)
    if network.centred:
        images = images - {"linear": 0.5, "inverse": 0.25}[network.depth_scale]
    images = images * ("depth" in network.inputs)
    angle = (heading + math.pi) / (2 * math.pi) * ("heading" in network.inputs)
    if network.model == "I":
        plane = (angle - 0.5 * network.centred * ("heading" in network.inputs))[:, :, None, None]
        plane = plane.expand(-1, -1, *images.shape[-2:])
        images = torch.cat([images, plane], dim=1)
    for layer, kernel, stride in ((network.conv1, (10, 14), 8), (network.conv2, (4, 4), 2), (network.conv3, (3, 3), 1)):
        images = F.relu(F.conv2d(pad_as_tensorflow(images, kernel, stride), layer.weight, layer.bias, stride))
        if first is not None and layer is network.conv1:
            first.append(images)
    features = torch.stack([image.permute(1, 2, 0).flatten() for image in images])
    if network.model == "S":
        features = torch.cat([features, angle], dim=1)
    for other in others:
        scaled = other / torch.tensor([0.4, math.pi / 4]) if other.shape[1] == 2 else 0.2 / other.clamp(min=0.2)
        features = torch.cat([features, scaled], dim=1)
    weight, bias = network.streams.weight, network.streams.bias
    value = network.value(F.relu(F.linear(features, weight[:512], bias[:512])))
    advantage = network.advantage(F.relu(F.linear(features, weight[512:], bias[512:])))
    return value + advantage - advantage.mean(dim=1, keepdim=True)


@pytest.mark.parametrize("kernel", [3, 4, 10, 14])
@pytest.mark.parametrize("stride", [1, 2, 8])
def test_same_padding_gives_every_stride_an_output_and_the_odd_zero_to_the_end(kernel, stride):
    for size in range(1, 70):
        before, after = same_padding(size, kernel, stride)
        assert after - before in (0, 1)
        places = range(-before, size + after - kernel + 1, stride)
        assert len(places) == math.ceil(size / stride)
        if before + after:  # no zero too many: the last window ends with the padding
            assert places[-1] + kernel == size + after


@pytest.mark.parametrize("size", [(13, 17), (16, 24), (9, 20)])
def test_convolution_sums_the_windows_of_the_padded_image(size):
    layer = SameConv2d(2, 3, (4, 5), 3, size)
    image = torch.randn(1, 2, *size)
    padded = pad_as_tensorflow(image, (4, 5), 3)[0].numpy()
    weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
    expected = np.empty((3, *layer.output_size), np.float32)
    for row in range(layer.output_size[0]):
        for column in range(layer.output_size[1]):
            window = padded[:, 3 * row : 3 * row + 4, 3 * column : 3 * column + 5]
            expected[:, row, column] = (weight * window).sum(axis=(1, 2, 3)) + bias
    np.testing.assert_allclose(layer(image)[0].detach().numpy(), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "height", "width", "count"),
    [("I", 128, 160, 2_621_952), ("I", 64, 80, 655_872), ("S", 128, 160, 2_622_464), ("S", 64, 80, 656_384)],
)
def test_fully_connected_layers_have_as_many_parameters_as_in_the_thesis(model, height, width, count):
    network = D3QN(model, height, width)
    counts = network.parameter_counts()
    assert counts["value 1"] == counts["advantage 1"] == count
    assert counts["conv1"] == 32 * ((5 if model == "I" else 4) * 10 * 14 + 1)
    assert counts["conv2"] == 64 * (32 * 4 * 4 + 1)
    assert counts["conv3"] == 64 * (64 * 3 * 3 + 1)
    assert counts["value 2"] == 513
    assert counts["advantage 2"] == 7 * 513
    assert sum(counts.values()) == sum(parameter.numel() for parameter in network.parameters())


@pytest.mark.parametrize("model", ["I", "S"])
@pytest.mark.parametrize("depth_scale", ["linear", "inverse"])
@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_action_values_and_gradients_are_those_of_the_plain_definition(model, height, width, depth_scale, centred):
    torch.manual_seed(0)
    network = D3QN(model, height, width, depth_scale=depth_scale, centred=centred)
    for parameter in network.parameters():  # biases too
        parameter.data.add_(0.05 * torch.randn_like(parameter))
    depth, heading = observations(5, height=height, width=width)
    weights = torch.randn(5, 7)

    plain = plain_action_values(network, depth, heading)
    expected = torch.autograd.grad((plain * weights).sum(), list(network.parameters()))
    ours = network(depth, heading)
    gradients = torch.autograd.grad((ours * weights).sum(), list(network.parameters()))

    torch.testing.assert_close(ours, plain, rtol=1e-4, atol=1e-4)
    for gradient, reference in zip(gradients, expected, strict=True):
        torch.testing.assert_close(gradient, reference, rtol=1e-3, atol=1e-4 * float(reference.abs().max()))


@pytest.mark.parametrize("model", ["I", "S"])
@pytest.mark.parametrize(
    "inputs",
    [
        ("depth",),
        ("heading",),
        ("depth", "heading", "command"),
        ("heading", "command"),
        ("depth", "heading", "surroundings"),
        ("surroundings", "command", "depth", "heading"),
    ],
)
@pytest.mark.parametrize(("depth_scale", "centred"), [("linear", False), ("inverse", False), ("inverse", True)])
def test_variants_see_what_they_are_said_to(model, inputs, depth_scale, centred):
    torch.manual_seed(0)
    network = D3QN(model, 33, 90, inputs, depth_scale, centred=centred)
    for parameter in network.parameters():
        parameter.data.add_(0.05 * torch.randn_like(parameter))
    depth, heading = observations(5, height=33, width=90)
    command = torch.stack([torch.rand(5) * 0.4, (torch.rand(5) * 2 - 1) * math.pi / 4], dim=1)
    given = {"depth": depth, "heading": heading, "command": command, "surroundings": 2.0 * torch.rand(5, 36)}
    names = [name for name in given if name in inputs or name in ("depth", "heading")]
    seen = [given[name] for name in names]

    values = network(*seen)

    first = []
    torch.testing.assert_close(values, plain_action_values(network, *seen, first=first), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(network.first_maps(*seen).permute(0, 3, 1, 2), first[0], rtol=1e-4, atol=1e-5)
    for index, name in enumerate(names):
        changed = network(*(value.flip(0) if i == index else value for i, value in enumerate(seen)))
        assert torch.equal(changed, values) == (name not in inputs)
    actor = make_q_actor(model, 33, 90, inputs, depth_scale, centred=centred)
    out = actor(TensorDict(given, [5]))
    torch.testing.assert_close(out["action_value"], actor.module[0].module(*seen))


def test_a_missing_command_and_unknown_inputs_are_told():
    with pytest.raises(ValueError, match="sees depth, heading, command, in this order; got 2 of them"):
        D3QN("I", 10, 14, ("depth", "command"))(*observations(2, height=10, width=14))
    with pytest.raises(ValueError, match="sees depth, heading, in this order; got 3 of them"):
        D3QN("I", 10, 14)(*observations(2, height=10, width=14), torch.zeros(2, 36))
    for inputs in ((), ("command",), ("depth", "sonar")):
        with pytest.raises(ValueError, match="inputs must be some of depth, heading, command"):
            D3QN("I", 10, 14, inputs)


@pytest.mark.parametrize("model", ["I", "S"])
def test_heading_matters_and_enters_from_zero_to_one(model):
    network = D3QN(model, 10, 14)
    depth, _ = observations(3, height=10, width=14)
    heading = torch.tensor([[-math.pi], [0.0], [math.pi]])
    assert network._flat(depth, heading)[1].flatten().tolist() == pytest.approx([0.0, 0.5, 1.0])
    values = network(depth[:1].expand(3, -1, -1, -1), heading)
    assert not torch.allclose(values[0], values[1])
    assert not torch.allclose(values[1], values[2])


@pytest.mark.parametrize("model", ["I", "S"])
def test_any_batch_dimensions_are_kept(model):
    network = D3QN(model, 10, 14)
    depth, heading = observations(2, 3, height=10, width=14)
    values = network(depth, heading)
    assert values.shape == (2, 3, 7)
    torch.testing.assert_close(network(depth[1, 2], heading[1, 2]), values[1, 2])
    torch.testing.assert_close(network(depth[1], heading[1]), values[1])


@pytest.mark.parametrize("model", ["I", "S"])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("inputs", [("depth", "heading"), ("depth", "heading", "command", "surroundings")])
@pytest.mark.parametrize("make", [make_q_actor, make_categorical_actor])
def test_a_symmetric_policy_goes_by_the_mean_of_what_it_sees_and_of_its_mirror_image(model, batch, inputs, make):
    torch.manual_seed(0)
    alone = make(model, 33, 90, inputs)
    actor, plain = symmetric_policy(alone), alone.module[0].module
    depth, heading = observations(*batch, height=33, width=90)
    command = torch.rand(*batch, 2) - 0.5
    surroundings = 0.2 + 2.0 * torch.rand(*batch, 36)
    seen = {"depth": depth, "heading": heading, "command": command, "surroundings": surroundings}
    mirrored = {
        "depth": torch.from_numpy(depth.numpy()[..., ::-1].copy()),
        "heading": -heading,
        "command": torch.stack([command[..., 0], -command[..., 1]], dim=-1),
        "surroundings": torch.from_numpy(surroundings.numpy()[..., ::-1].copy()),
    }
    keys = list(seen)[: len(inputs)]
    straight, other = (plain(*(world[key] for key in keys)) for world in (seen, mirrored))
    turns_swapped = torch.stack([other[..., action] for action in (0, 1, 6, 5, 4, 3, 2)], dim=-1)
    assert not torch.allclose(straight, turns_swapped, atol=1e-3)
    chosen = actor(TensorDict(seen, batch))
    torch.testing.assert_close(chosen["action_value"], (straight + turns_swapped) / 2)
    in_the_mirror = actor(TensorDict(mirrored, batch))["action_value"]
    for action, opposite in enumerate((0, 1, 6, 5, 4, 3, 2)):
        torch.testing.assert_close(chosen["action_value"][..., action], in_the_mirror[..., opposite])
    assert (chosen["action"] == chosen["action_value"].argmax(-1)).all()
    assert torch.equal(alone(TensorDict(seen, batch))["action_value"], straight)


def test_memory_layout_of_the_images_does_not_matter():
    network = D3QN("I", 10, 14)
    depth, heading = observations(6, height=10, width=14)
    expected = network(depth, heading)
    torch.testing.assert_close(network(depth.contiguous(memory_format=torch.channels_last), heading), expected)
    torch.testing.assert_close(network(depth[::2], heading[::2]), expected[::2])


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_actor_takes_the_greedy_action(batch):
    actor = make_q_actor("I", 10, 14)
    depth, heading = observations(*batch, height=10, width=14)
    out = actor(TensorDict({"depth": depth, "heading": heading}, batch))
    assert out["action_value"].shape == (*batch, 7)
    assert out["action"].shape == batch
    assert actor.spec["action"].n == 7
    torch.testing.assert_close(out["action"], out["action_value"].argmax(-1))
    torch.testing.assert_close(out["chosen_action_value"], out["action_value"].amax(-1, keepdim=True))


def test_actor_survives_copying_and_pickling():
    actor = make_q_actor("I", 10, 14)
    depth, heading = observations(3, height=10, width=14)
    data = TensorDict({"depth": depth, "heading": heading}, [3])
    expected = actor(data.clone())["action_value"]
    for other in (copy.deepcopy(actor), pickle.loads(pickle.dumps(actor))):
        torch.testing.assert_close(other(data.clone())["action_value"], expected)
    fresh = make_q_actor("I", 10, 14)
    fresh.load_state_dict(actor.state_dict())
    torch.testing.assert_close(fresh(data.clone())["action_value"], expected)


@pytest.mark.parametrize("model", ["I", "S"])
def test_bfloat16_autocast_stays_near_float32_and_returns_float32(model):
    torch.manual_seed(0)
    network = D3QN(model, 64, 80)
    depth, heading = observations(4, height=64, width=80)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rounded = network(depth, heading)
    assert rounded.dtype == torch.float32
    torch.testing.assert_close(rounded, network(depth, heading), rtol=0.05, atol=0.02)


def test_new_weights_follow_glorot_for_each_stream():
    network = D3QN("S", 64, 80, heading_init="glorot")
    bound = math.sqrt(6 / (1281 + 512))
    for stream in network.streams.weight.split(512):
        assert 0.99 * bound < stream.abs().max() <= bound
    assert all(not parameter.any() for name, parameter in network.named_parameters() if name.endswith("bias"))


def test_the_heading_of_a_scalar_begins_spread_and_nothing_else_does():
    torch.manual_seed(0)
    spread = D3QN("S", 64, 80, ("depth", "heading", "command", "surroundings"))
    torch.manual_seed(0)
    glorot = D3QN("S", 64, 80, ("depth", "heading", "command", "surroundings"), heading_init="glorot")
    assert all(not bias.any() for name, bias in glorot.named_parameters() if name.endswith("bias"))
    heading = 1280  # after the features of the images, before the command
    for (name, ours), theirs in zip(spread.named_parameters(), glorot.parameters(), strict=True):
        same = ours == theirs
        if name == "streams.weight":
            assert not same[:, heading].any()
            same[:, heading] = True
        assert same.all() == (name != "streams.bias")
    slopes, biases = spread.streams.weight[:, heading].detach(), spread.streams.bias.detach()
    kinks = -biases / slopes  # headings, from 0 to 1, at which a unit that saw nothing else would begin to answer
    for values, low, high in ((slopes, -1.0, 1.0), (kinks, 0.0, 1.0)):
        counts = torch.histc(values, 8, low, high)
        assert counts.sum() == 1024
        assert counts.min() > 128 - 5 * math.sqrt(128)


@pytest.mark.parametrize("heading_init", ["spread", "glorot"])
def test_biases_of_a_heading_that_is_an_image_begin_at_zero(heading_init):
    network = D3QN("I", 64, 80, heading_init=heading_init)
    assert all(not bias.any() for name, bias in network.named_parameters() if name.endswith("bias"))


def test_images_in_metres_are_not_taken_for_counts():
    depth, heading = observations(2, height=10, width=14)
    with pytest.raises(ValueError, match=r"depth images are uint8, .* got torch.float32: DepthCamera.to_uint8 makes"):
        D3QN("I", 10, 14)(depth / 255.0, heading)


def test_settings_that_cannot_be_used_are_refused():
    with pytest.raises(ValueError, match="at least 14 x 10"):
        make_q_actor("I", height=9, width=80)
    with pytest.raises(ValueError, match="at least 14 x 10"):
        make_q_actor("S", height=64, width=13)
    with pytest.raises(ValueError, match="model must be"):
        make_q_actor("X")
    with pytest.raises(ValueError, match="depth_scale must be"):
        make_q_actor("I", depth_scale="logarithmic")
    with pytest.raises(ValueError, match="heading_init must be"):
        make_q_actor("S", heading_init="zero")
    network = D3QN("I", 64, 80)
    depth, heading = observations(2, height=80, width=64)
    with pytest.raises(ValueError, match=r"\(4, 64, 80\).*\(4, 80, 64\)"):
        network(depth, heading)


@pytest.mark.parametrize("model", ["I", "S"])
def test_a_batch_may_be_empty(model):
    network = D3QN(model, 12, 20)
    assert network(torch.zeros(0, 4, 12, 20, dtype=torch.uint8), torch.zeros(0, 1)).shape == (0, 7)
    assert network(torch.zeros(3, 0, 4, 12, 20, dtype=torch.uint8), torch.zeros(3, 0, 1)).shape == (3, 0, 7)


def test_networks_are_made_in_the_default_format():
    torch.set_default_dtype(torch.float64)
    try:
        network = D3QN("I", 12, 20)
        assert network(torch.zeros(2, 4, 12, 20, dtype=torch.uint8), torch.zeros(2, 1)).dtype == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)


def test_only_networks_with_a_mirror_image_have_symmetric_policies():
    actor = QValueActor(torch.nn.Linear(3, 7), in_keys=["x"], spec=Categorical(7))
    with pytest.raises(ValueError, match="needs an actor around a D3QN; got one around a Linear"):
        symmetric_policy(actor)


def test_weights_may_be_made_contiguous():
    network = D3QN("I", 12, 20)
    seen = (torch.randint(0, 256, (3, 4, 12, 20), dtype=torch.uint8), torch.randn(3, 1))
    before = network(*seen)
    with pytest.raises(RuntimeError, match="view"):
        torch.nn.utils.parameters_to_vector(network.parameters())
    network.to(memory_format=torch.contiguous_format)
    assert len(torch.nn.utils.parameters_to_vector(network.parameters())) == sum(network.parameter_counts().values())
    torch.testing.assert_close(network(*seen), before)
