"""D3QNLoss beside TorchRL's DQNLoss, and beside the target equation written out by hand."""

from __future__ import annotations

import copy
import math
import pickle

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical, OneHot
from torchrl.modules import GRUModule, QValueActor, set_recurrent_mode
from torchrl.objectives import DQNLoss, HardUpdate, SoftUpdate, ValueEstimators

from rl.loss import D3QNLoss, fastest_autocast
from rl.networks import D3QN, SameConv2d, make_q_actor

HEIGHT, WIDTH = 20, 30


def transitions(count: int) -> TensorDict:
    def observation() -> dict[str, torch.Tensor]:
        return {
            "depth": torch.randint(0, 256, (count, 4, HEIGHT, WIDTH), dtype=torch.uint8),
            "heading": (torch.rand(count, 1) * 2 - 1) * math.pi,
        }

    terminated, truncated = torch.rand(2, count, 1) < 0.3
    after = {
        **observation(),
        "reward": torch.randn(count, 1),
        "done": terminated | truncated,
        "terminated": terminated,
    }
    return TensorDict({**observation(), "action": torch.randint(0, 7, (count,)), "next": after}, [count])


def make_losses(model: str = "I", **settings) -> tuple[D3QNLoss, DQNLoss]:
    """Ours and TorchRL's around the same online network, and around equal target networks that differ from it."""
    torch.manual_seed(1)
    actor = make_q_actor(model, HEIGHT, WIDTH)
    ours = D3QNLoss(actor, gamma=0.9, **settings)
    torchrl = DQNLoss(actor, action_space="categorical", **{"double_dqn": True, **settings})
    torchrl.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    if ours.delay_value:
        for loss in (ours, torchrl):
            SoftUpdate(loss, tau=0.5)
            torch.manual_seed(2)
            for name, target in loss.target_value_network_params.items(True, True):
                if name[-1] in ("weight", "bias"):
                    target.data.add_(0.05 * torch.randn_like(target))
    return ours, torchrl


def gradients(loss: D3QNLoss | DQNLoss, value: torch.Tensor) -> list[torch.Tensor]:
    return list(torch.autograd.grad(value, [parameter for parameter in loss.parameters() if parameter.requires_grad]))


@pytest.mark.parametrize(
    ("model", "settings", "extras"),
    [
        ("I", {}, ()),
        ("S", {"loss_function": "smooth_l1"}, ("steps_to_next_obs",)),
        ("I", {"double_dqn": False}, ("steps_to_next_obs", "priority_weight")),
        ("I", {"double_dqn": False, "delay_value": False}, ()),
        ("S", {"reduction": "none"}, ("priority_weight",)),
    ],
)
def test_loss_priorities_and_gradients_are_those_of_torchrl(model, settings, extras):
    ours, torchrl = make_losses(model, **settings)
    data = transitions(12)
    if "steps_to_next_obs" in extras:
        data["steps_to_next_obs"] = torch.randint(1, 4, (12,))
    if "priority_weight" in extras:
        data["priority_weight"] = torch.rand(12)
    reference = data.clone()

    loss, expected = ours(data)["loss"], torchrl(reference)["loss"]

    torch.testing.assert_close(loss, expected, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(data["td_error"], reference["td_error"], rtol=1e-4, atol=1e-5)
    pairs = zip(gradients(ours, loss.sum()), gradients(torchrl, expected.sum()), strict=True)
    for gradient, other in pairs:
        torch.testing.assert_close(gradient, other, rtol=1e-3, atol=1e-5 * float(other.abs().max()))


def test_target_is_the_equation_of_double_q_learning():
    ours, _ = make_losses("I", reduction="none")
    data = transitions(16)
    data["steps_to_next_obs"] = torch.randint(1, 4, (16,))
    online = make_q_actor("I", HEIGHT, WIDTH).module[0].module
    target = make_q_actor("I", HEIGHT, WIDTH).module[0].module
    for network, parameters in (
        (online, ours.value_network_params),
        (target, ours.target_value_network_params),
    ):
        network.load_state_dict(
            {name: parameters["module", "0", "module"][tuple(name.split("."))] for name in network.state_dict()}
        )

    loss = ours(data)["loss"].tolist()

    for i, step in enumerate(data.unbind(0)):
        after = step["next"]
        with torch.no_grad():
            best = online(after["depth"], after["heading"]).argmax()
            bootstrap = 0.0 if after["terminated"] else float(target(after["depth"], after["heading"])[best])
            chosen = float(online(step["depth"], step["heading"])[step["action"]])
        wanted = float(after["reward"]) + 0.9 ** int(step["steps_to_next_obs"]) * bootstrap
        assert loss[i] == pytest.approx((wanted - chosen) ** 2, rel=1e-3, abs=1e-5)
        assert float(data["td_error"][i]) == pytest.approx((wanted - chosen) ** 2, rel=1e-3, abs=1e-5)
        assert float(data["chosen_action_value"][i]) == pytest.approx(chosen, rel=1e-4, abs=1e-5)


def test_time_limit_bootstraps_and_an_end_does_not():
    ours, _ = make_losses("S", reduction="none")
    data = transitions(2)[:1].expand(3).clone()
    data["next", "terminated"] = torch.tensor([[False], [False], [True]])
    data["next", "done"] = torch.tensor([[False], [True], [True]])
    running, truncated, terminated = ours(data)["loss"]
    torch.testing.assert_close(truncated, running)
    assert not torch.isclose(terminated, running)
    chosen, reward = data["chosen_action_value"][2], data["next", "reward"][2]
    torch.testing.assert_close(terminated, (chosen - reward).square().squeeze())


def test_soft_update_moves_the_target_by_tau():
    loss = D3QNLoss(make_q_actor("I", HEIGHT, WIDTH))
    updater = SoftUpdate(loss, tau=0.25)
    weight = loss.value_network_params["module", "0", "module", "value", "weight"]
    target = loss.target_value_network_params["module", "0", "module", "value", "weight"]
    before = target.clone()
    weight.data.add_(1.0)
    updater.step()
    torch.testing.assert_close(target, before + 0.25)
    updater.step()
    torch.testing.assert_close(target, before + 1.0 - 0.75**2)


def test_hard_update_copies_the_online_network():
    loss = D3QNLoss(make_q_actor("I", HEIGHT, WIDTH))
    updater = HardUpdate(loss, value_network_update_interval=3)
    weight = loss.value_network_params["module", "0", "module", "value", "weight"]
    target = loss.target_value_network_params["module", "0", "module", "value", "weight"]
    before = target.clone()
    weight.data.add_(1.0)
    copied = []
    for _ in range(4):
        updater.step()
        copied.append(torch.equal(target, weight))
        assert copied[-1] or torch.equal(target, before)
    assert copied[0] is False
    assert copied[-1] is True


def test_optimiser_on_the_loss_improves_the_actor():
    torch.manual_seed(0)
    actor = make_q_actor("I", HEIGHT, WIDTH)
    loss = D3QNLoss(actor)
    SoftUpdate(loss, tau=0.001)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3, fused=True)
    data = transitions(16)
    data["next", "terminated"] = torch.ones(16, 1, dtype=torch.bool)  # the rewards are fixed targets
    first = None
    for _ in range(60):
        value = loss(data)["loss"]
        first = first or value.item()
        value.backward()
        optimiser.step()
        optimiser.zero_grad()
    assert loss(data)["loss"].item() < 0.05 * first
    chosen = actor(data.select("depth", "heading"))["action_value"].gather(1, data["action"].unsqueeze(1))
    assert (chosen - data["next", "reward"]).abs().mean() < 0.2


@pytest.mark.parametrize("model", ["I", "S"])
def test_action_values_of_a_toy_problem_are_learnt(model):
    """Dark room: action 3 opens the door to the bright room, others stay. Bright room: ahead (2, 3, 4) is the goal."""
    torch.manual_seed(0)
    gamma = 0.5
    loss = D3QNLoss(make_q_actor(model, HEIGHT, WIDTH), gamma=gamma)
    target_update = SoftUpdate(loss, tau=0.05)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3, fused=True)

    rooms = torch.stack([torch.full((4, HEIGHT, WIDTH), shade, dtype=torch.uint8) for shade in (40, 220)])
    room, action = torch.arange(14) // 7, torch.arange(14) % 7
    goal = (room == 1) & (action >= 2) & (action <= 4)
    next_room = torch.where((room == 0) & (action == 3), 1, room)
    data = TensorDict(
        {
            "depth": rooms[room],
            "heading": torch.zeros(14, 1),
            "action": action,
            "next": {
                "depth": rooms[next_room],
                "heading": torch.zeros(14, 1),
                "reward": goal.float().unsqueeze(1),
                "done": goal.unsqueeze(1),
                "terminated": goal.unsqueeze(1),
            },
        },
        [14],
    )
    for _ in range(250):
        loss(data)["loss"].backward()
        optimiser.step()
        optimiser.zero_grad()
        target_update.step()

    dark = [gamma * gamma] * 7
    dark[3] = gamma
    bright = [gamma, gamma, 1.0, 1.0, 1.0, gamma, gamma]
    learnt = loss.value_network.module[0].module(rooms, torch.zeros(2, 1))
    torch.testing.assert_close(learnt, torch.tensor([dark, bright]), rtol=0, atol=0.05)


def test_autocast_changes_the_numbers_little_and_keeps_their_format():
    torch.manual_seed(0)
    actor = make_q_actor("I", HEIGHT, WIDTH)
    data = transitions(16)
    losses = []
    for autocast in (None, torch.bfloat16):
        loss = D3QNLoss(actor, autocast=autocast)
        SoftUpdate(loss, tau=0.001)
        losses.append(loss(data)["loss"])
        assert losses[-1].dtype == data["td_error"].dtype == torch.float32
        assert all(gradient.dtype == torch.float32 for gradient in gradients(loss, losses[-1]))
    torch.testing.assert_close(losses[1], losses[0], rtol=0.05, atol=0.0)
    assert losses[1] != losses[0]


def test_tensors_may_be_passed_by_name():
    ours, _ = make_losses("S")
    data = transitions(4)
    flat = {key if isinstance(key, str) else "_".join(key): value for key, value in data.items(True, True)}
    torch.testing.assert_close(ours(**flat), ours(data)["loss"])


def test_state_dict_restores_online_and_target_network():
    ours, _ = make_losses("I")
    other = D3QNLoss(make_q_actor("I", HEIGHT, WIDTH), gamma=0.9)
    SoftUpdate(other, tau=0.5)
    other.load_state_dict(ours.state_dict())
    data = transitions(8)
    torch.testing.assert_close(other(data.clone())["loss"], ours(data)["loss"])


def test_copies_and_conversions_keep_weights_and_loss_together():
    ours, _ = make_losses("I")
    data = transitions(8)
    expected = ours(data)["loss"]
    for other in (copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))):
        torch.testing.assert_close(other(data)["loss"], expected)
        for weights in (other.value_network_params, other.target_value_network_params):
            weights["module", "0", "module", "advantage", "bias"].data.add_(torch.arange(7.0))
            changed = other(data)["loss"]
            assert not torch.isclose(changed, expected)
        torch.testing.assert_close(ours(data)["loss"], expected)
    torch.testing.assert_close(ours.double()(data)["loss"].float(), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_loss_on_a_gpu_is_that_on_the_cpu():
    ours, _ = make_losses("I")
    data = transitions(8)
    expected = ours(data)["loss"]
    torch.testing.assert_close(ours.to("cuda")(data.to("cuda"))["loss"].cpu(), expected, rtol=1e-3, atol=1e-4)


def test_actors_that_are_not_q_networks_with_categorical_actions_are_refused():
    with pytest.raises(ValueError, match=r"categorical action space.*got Linear"):
        D3QNLoss(nn.Linear(3, 7))
    with pytest.raises(ValueError, match="categorical action space"):
        D3QNLoss(QValueActor(nn.Linear(3, 7), in_keys=["depth"], spec=OneHot(7)))


def test_fastest_autocast_is_a_format_for_the_loss():
    assert fastest_autocast() in (None, torch.bfloat16)


@pytest.mark.parametrize("kind", ["subclass", "symmetric", "hook", "layer", "wrapped"])
def test_a_network_with_a_way_of_its_own_learns_by_it(kind):
    class Tenfold(D3QN):
        def forward(self, *observation):
            return 10.0 * super().forward(*observation)

    class Half(SameConv2d):
        def forward(self, images):
            return 0.5 * super().forward(images)

    network = Tenfold("I", HEIGHT, WIDTH) if kind == "subclass" else D3QN("I", HEIGHT, WIDTH)
    network.symmetric = kind == "symmetric"
    if kind == "hook":
        network.conv3.register_forward_hook(lambda layer, images, result: 0.5 * result)
    if kind == "layer":
        network.conv2.__class__ = Half
    if kind == "wrapped":
        network.conv3 = nn.Sequential(network.conv3, nn.LeakyReLU(0.3))
    actor = QValueActor(network, in_keys=["depth", "heading"], spec=Categorical(7))
    batch = transitions(12)
    ours, torchrl = D3QNLoss(actor), DQNLoss(actor, action_space="categorical", double_dqn=True)
    one, other = ours(batch)["loss"], torchrl(batch.clone())["loss"]
    torch.testing.assert_close(one, other)
    for gradient, reference in zip(gradients(ours, one), gradients(torchrl, other), strict=True):
        torch.testing.assert_close(gradient, reference, rtol=1e-4, atol=1e-5)
    expected = actor(batch.select("depth", "heading"))["action_value"].gather(-1, batch["action"].unsqueeze(-1))
    torch.testing.assert_close(batch["chosen_action_value"], expected)


def test_modules_train_and_evaluate_as_the_actors_do():
    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.norm, self.layer = nn.BatchNorm1d(1), nn.Linear(1, 7)

        def forward(self, depth: torch.Tensor, heading: torch.Tensor) -> torch.Tensor:
            return self.layer(self.norm(heading))

    actor = QValueActor(Network(), in_keys=["depth", "heading"], spec=Categorical(7))
    ours, data = D3QNLoss(actor), transitions(8)
    theirs = DQNLoss(actor, double_dqn=True, delay_value=True, action_space="categorical")
    theirs.make_value_estimator(ValueEstimators.TD0, gamma=0.99)
    for mode in (False, True, False, True):
        actor.train(mode)
        torch.testing.assert_close(ours(data.clone())["loss"], theirs(data.clone())["loss"])


class Flat(nn.Module):
    """A network of one's own, with what changes while it learns."""

    def __init__(self, outputs: int = 1) -> None:
        super().__init__()
        self.layer, self.drop, self.scale, self.outputs = nn.Linear(WIDTH + 1, 7), nn.Dropout(0.5), 1.0, outputs

    def forward(self, depth: torch.Tensor, heading: torch.Tensor) -> torch.Tensor | tuple[torch.Tensor, ...]:
        seen = torch.cat([depth[..., -1, 8, :] / 255.0, heading], dim=-1)
        values = self.scale * self.drop(self.layer(seen))
        return values if self.outputs == 1 else (values, seen)


def masked(network: Flat) -> QValueActor:
    return QValueActor(network, in_keys=["depth", "heading"], spec=Categorical(7), action_mask_key="action_mask")


def by_keyword(network: Flat) -> QValueActor:
    keys = {"heading": "heading", "depth": "depth"}
    return QValueActor(TensorDictModule(network, in_keys=keys, out_keys=["action_value"]), spec=Categorical(7))


def encoder_and_head(network: Flat) -> QValueActor:
    encoder = TensorDictModule(
        lambda depth, heading: torch.cat([depth[..., -1, 8, :] / 255.0, heading], dim=-1),
        in_keys=["depth", "heading"],
        out_keys=["seen"],
    )
    head = TensorDictModule(network.layer, in_keys=["seen"], out_keys=["action_value"])
    return QValueActor(TensorDictSequential(encoder, head), spec=Categorical(7))


def with_another_output(network: Flat) -> QValueActor:
    network.outputs = 2
    module = TensorDictModule(network, in_keys=["depth", "heading"], out_keys=["action_value", "seen"])
    return QValueActor(module, spec=Categorical(7))


@pytest.mark.parametrize("double_dqn", [True, False])
@pytest.mark.parametrize("make", [masked, by_keyword, encoder_and_head, with_another_output])
def test_any_actor_learns_as_with_torchrl(make, double_dqn):
    torch.manual_seed(0)
    network = Flat()
    actor, data = make(network), transitions(12)
    data["action_mask"], data["next", "action_mask"] = torch.rand(2, 12, 7) < 0.5
    data["action_mask"][:, 0] = data["next", "action_mask"][:, 0] = True
    data["action"] = torch.zeros(12, dtype=torch.int64)
    ours = D3QNLoss(actor, gamma=0.9, double_dqn=double_dqn)
    torchrl = DQNLoss(actor, action_space="categorical", double_dqn=double_dqn, delay_value=True)
    torchrl.make_value_estimator(ValueEstimators.TD0, gamma=0.9)
    for loss in (ours, torchrl):
        SoftUpdate(loss, tau=0.5)
    for change in ({}, {"scale": 5.0}, {"p": 0.0}):  # in the middle of learning
        network.scale = change.get("scale", network.scale)
        network.drop.p = change.get("p", network.drop.p)
        values = []
        for loss in (ours, torchrl):
            torch.manual_seed(1)
            values.append(loss(data.clone())["loss"])
        torch.testing.assert_close(*values)


def test_what_a_network_lacks_is_named():
    actor = make_q_actor("I", HEIGHT, WIDTH, inputs=["depth", "heading", "command"])
    with pytest.raises(ValueError, match="sees command, which the batch lacks in its observation: let the env"):
        D3QNLoss(actor)(transitions(8))
    data = transitions(8)
    data["command"] = torch.zeros(8, 2)
    with pytest.raises(ValueError, match='sees command, which the batch lacks in "next"'):
        D3QNLoss(actor)(data)


def test_what_a_network_of_ones_own_lacks_is_named():
    layer = nn.Linear(3, 7)
    network = TensorDictModule(
        lambda heading, command: layer(torch.cat([heading, command], dim=-1)), ["heading", "command"], ["action_value"]
    )
    with pytest.raises(ValueError, match="sees command, which the batch lacks in its observation"):
        D3QNLoss(QValueActor(network, spec=Categorical(7)))(transitions(8))


def test_what_a_recurrent_network_remembers_in_the_next_state_is_what_was_recorded_there():
    torch.manual_seed(0)
    memory = GRUModule(input_size=1, hidden_size=7, in_key="heading", out_key="action_value")
    actor = QValueActor(TensorDictSequential(memory), spec=Categorical(7))
    data, gamma = transitions(3 * 6).reshape(3, 6), 0.9  # of which a third have ended an episode
    data["is_init"] = torch.zeros(3, 6, 1, dtype=torch.bool)
    data["is_init"][:, 1:] = data["next", "done"][:, :-1]
    data["next", "is_init"] = torch.zeros(3, 6, 1, dtype=torch.bool)
    for state in (data, data["next"]):
        state["recurrent_state"] = torch.randn(3, 6, 1, 7)

    def alone(state):
        """Of each state by itself, with what was recorded in it."""
        seen = state.select("heading", "is_init", "recurrent_state").reshape(-1).clone()
        return actor(seen)["action_value"].reshape(3, 6, 7)

    after = data["next"]
    with torch.no_grad():
        worth = alone(after).max(-1, keepdim=True).values  # both networks are the same one
        wanted = after["reward"] + gamma * (~after["terminated"]) * worth
        with set_recurrent_mode(True):
            values = actor(data.clone())["action_value"]  # a sequence, with memory that each episode begins anew
    chosen = values.gather(-1, data["action"].unsqueeze(-1))
    told = data.clone()
    D3QNLoss(actor, gamma=gamma)(told)
    torch.testing.assert_close(told["td_error"], (chosen - wanted).square())


def test_a_symmetry_that_is_switched_on_counts_at_once():
    actor = make_q_actor("I", HEIGHT, WIDTH)
    ours, data = D3QNLoss(actor), transitions(8)
    alone = ours(data)["loss"].item()
    actor.module[0].module.symmetric = True
    assert ours(data)["loss"].item() == pytest.approx(D3QNLoss(actor)(data)["loss"].item(), rel=1e-5)
    assert ours(data)["loss"].item() != pytest.approx(alone, rel=1e-3)


def test_hooks_of_the_network_are_called():
    actor = make_q_actor("I", HEIGHT, WIDTH)
    ours, seen = D3QNLoss(actor), []
    ours(transitions(8))
    actor.module[0].module.register_forward_hook(lambda module, inputs, output: seen.append(output.shape))
    ours(transitions(8))
    assert seen == [torch.Size([8, 7])] * 3
