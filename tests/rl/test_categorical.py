"""The categorical head and its loss, against TorchRL's own and against the projection written out."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Categorical
from torchrl.modules import DistributionalQValueActor, QValueActor
from torchrl.objectives import DistributionalDQNLoss, SoftUpdate

from rl.categorical import CategoricalD3QN, CategoricalD3QNLoss, make_categorical_actor, project
from rl.networks import make_q_actor

HEIGHT, WIDTH = 12, 20
RANGE = (-1.0, 2.0)


def batch(size: int = 16) -> TensorDict:
    def observation():
        return {
            "depth": torch.randint(0, 256, (size, 4, HEIGHT, WIDTH), dtype=torch.uint8),
            "heading": torch.rand(size, 1) * 6 - 3,
        }

    after = {
        **observation(),
        "reward": torch.randn(size, 1),
        "done": torch.rand(size, 1) < 0.5,
        "terminated": torch.rand(size, 1) < 0.3,
    }
    return TensorDict(
        {
            **observation(),
            "action": torch.randint(0, 7, (size,)),
            "steps_to_next_obs": torch.randint(1, 4, (size, 1)),
            "next": after,
        },
        [size],
    )


def actor(model="I", atoms=11) -> QValueActor:
    return make_categorical_actor(model, HEIGHT, WIDTH, atoms=atoms, value_range=RANGE)


@pytest.mark.parametrize("model", ["I", "S"])
def test_values_are_the_means_of_the_distributions_and_streams_are_dueling(model):
    torch.manual_seed(0)
    network = CategoricalD3QN(model, HEIGHT, WIDTH, atoms=5, value_range=RANGE)
    seen = batch(3)
    logits = network.logits(seen["depth"], seen["heading"]).detach()
    assert logits.shape == (3, 7, 5)
    values = network(seen["depth"], seen["heading"]).detach().numpy()
    odds = np.exp(logits.numpy())
    expected = (odds * np.linspace(*RANGE, 5)).sum(-1) / odds.sum(-1)
    np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-5)

    hidden = network.hidden(seen["depth"], seen["heading"]).t()
    value = network.value(hidden[:, :512])
    torch.testing.assert_close(logits.mean(1), value.detach())  # what the advantages add is nothing on average


def test_leading_dimensions_are_kept():
    network = CategoricalD3QN("S", HEIGHT, WIDTH, atoms=5)
    seen = batch(6)
    flat = network(seen["depth"], seen["heading"])
    torch.testing.assert_close(
        network(seen["depth"].unflatten(0, (2, 3)), seen["heading"].unflatten(0, (2, 3))), flat.unflatten(0, (2, 3))
    )


@given(st.integers(0, 10_000), st.integers(2, 9))
def test_the_projection_keeps_probability_and_what_mean_lies_inside(seed, atoms):
    generator = np.random.default_rng(seed)
    support = np.linspace(-1, 2, atoms)
    probabilities = generator.dirichlet(np.ones(atoms), 4)
    returns = generator.uniform(-3, 4, (4, atoms))
    cast = project(*(torch.from_numpy(values) for values in (probabilities, returns, support))).numpy()

    expected = np.zeros_like(cast)
    for row in range(4):
        for probability, value in zip(probabilities[row], np.clip(returns[row], -1, 2), strict=True):
            place = (value + 1) / (support[1] - support[0])
            lower = min(int(np.floor(place)), atoms - 2)
            expected[row, lower] += probability * (lower + 1 - place)
            expected[row, lower + 1] += probability * (place - lower)
    np.testing.assert_allclose(cast, expected, atol=1e-9)
    np.testing.assert_allclose(cast.sum(1), 1.0)
    np.testing.assert_allclose(cast @ support, (probabilities * np.clip(returns, -1, 2)).sum(1), atol=1e-9)


class _TorchRLHead(nn.Module):
    """The same network as TorchRL's distributional loss wants it: (..., atoms, actions)."""

    def __init__(self, network: CategoricalD3QN) -> None:
        super().__init__()
        self.network = network

    def forward(self, depth, heading):
        return self.network.logits(depth, heading).transpose(-1, -2)


def test_the_loss_is_torchrls_distributional_loss():
    torch.manual_seed(0)
    ours = actor()
    network = ours.module[0].module
    theirs = DistributionalQValueActor(
        TensorDictModule(_TorchRLHead(network), in_keys=["depth", "heading"], out_keys=["action_value"]),
        in_keys=["depth", "heading"],
        support=network.support,
        action_space="categorical",
    )
    loss, reference = CategoricalD3QNLoss(ours, gamma=0.9), DistributionalDQNLoss(theirs, gamma=0.9, delay_value=True)
    for module in (loss, reference):  # targets that differ from the networks, equally
        for name, value in sorted(module.target_value_network_params.flatten_keys().items()):
            if "support" not in name and "coverage" not in name:
                value.data.mul_(1.3)
    data = batch(32)
    copy = data.clone()
    got, expected = loss(data)["loss"], reference(copy)["loss"]
    torch.testing.assert_close(got, expected)
    torch.testing.assert_close(data["td_error"], copy["td_error"])


def test_what_terminates_is_not_bootstrapped_and_what_is_truncated_is():
    torch.manual_seed(0)
    loss = CategoricalD3QNLoss(actor(), reduction="none")
    data = batch(8)
    for terminated, same in ((True, True), (False, False)):
        data["next", "done"][:] = True
        data["next", "terminated"][:] = terminated
        before = loss(data)["loss"]
        changed = data.clone()
        changed["next", "depth"] = torch.randint(0, 256, changed["next", "depth"].shape, dtype=torch.uint8)
        after = loss(changed)["loss"]
        assert torch.allclose(before, after) is same


def test_known_returns_are_learnt():
    torch.manual_seed(0)
    policy = actor(atoms=31)
    loss = CategoricalD3QNLoss(policy)
    parameters = [parameter for parameter in loss.parameters() if parameter.requires_grad]
    optimiser, target = torch.optim.Adam(parameters, lr=1e-3), SoftUpdate(loss, tau=0.1)
    data = batch(16)
    data["next", "terminated"][:] = True
    data["next", "reward"].clamp_(*RANGE)
    for _ in range(150):
        loss(data)["loss"].backward()
        optimiser.step()
        optimiser.zero_grad()
        target.step()
    values = policy(data.clone())["action_value"].gather(1, data["action"].unsqueeze(1))
    assert (values - data["next", "reward"]).abs().max() < 0.15
    assert data["chosen_action_value"].shape == (16, 1)


def test_impossible_heads_are_refused():
    with pytest.raises(ValueError, match="at least 2 atoms"):
        CategoricalD3QN(atoms=1)
    with pytest.raises(ValueError, match="from less to more"):
        CategoricalD3QN(value_range=(1.0, 1.0))
    with pytest.raises(ValueError, match="needs a CategoricalD3QN"):
        CategoricalD3QNLoss(make_q_actor("I", HEIGHT, WIDTH))


@pytest.mark.parametrize("shape", [(2, 8), (16, 1), (1, 16)])
def test_batches_of_any_shape_are_learnt_from(shape):
    torch.manual_seed(0)
    loss = CategoricalD3QNLoss(actor(), gamma=0.9)
    flat = batch(16)
    flat["priority_weight"] = torch.rand(16)
    shaped = flat.reshape(*shape).clone()
    torch.testing.assert_close(loss(shaped)["loss"], loss(flat)["loss"])
    for key in ("td_error", "chosen_action_value"):
        assert shaped[key].shape == (*shape, 1)
        torch.testing.assert_close(shaped[key].reshape(16, 1), flat[key])


def test_a_network_whose_values_are_not_the_means_is_refused():
    symmetric = actor()
    symmetric.module[0].module.symmetric = True
    with pytest.raises(ValueError, match="this network is symmetric; give a policy that goes on learning symmetric=F"):
        CategoricalD3QNLoss(symmetric)

    class Bolder(CategoricalD3QN):
        def forward(self, *observation):
            return 2.0 * super().forward(*observation)

    network = Bolder("I", HEIGHT, WIDTH)
    with pytest.raises(ValueError, match=r"\(Bolder\) makes them in another way"):
        CategoricalD3QNLoss(QValueActor(network, in_keys=["depth", "heading"], spec=Categorical(7)))
    masked = QValueActor(
        CategoricalD3QN("I", HEIGHT, WIDTH),
        in_keys=["depth", "heading"],
        spec=Categorical(7),
        action_mask_key="action_mask",
    )
    with pytest.raises(ValueError, match="knows no action masks"):
        CategoricalD3QNLoss(masked)


def test_values_have_the_digits_of_the_weights_under_autocast():
    seen = batch(4)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        values = actor()(seen.clone())["action_value"]
    assert values.dtype == torch.float32
    assert not torch.equal(values, values.bfloat16().float())


@pytest.mark.parametrize("number_format", [torch.float64, torch.bfloat16, torch.float16])
def test_weights_and_rewards_may_have_any_format(number_format):
    """The loss of weights rounded to half precision is near, and that of rewards in double precision the same."""
    torch.manual_seed(0)
    loss, samples = CategoricalD3QNLoss(actor()), batch()
    expected = loss(samples.clone())["loss"]
    if number_format == torch.float64:
        samples["next", "reward"] = samples["next", "reward"].double()
        torch.testing.assert_close(loss(samples)["loss"], expected)
        loss = loss.double()
    found = loss.to(number_format)(samples.clone())["loss"]
    found.backward()
    tolerance = 1e-5 if number_format == torch.float64 else 0.05
    torch.testing.assert_close(found.detach().float(), expected.detach(), rtol=tolerance, atol=0.0)
