"""The learner: when it learns, how fast, and that it can go on."""

from __future__ import annotations

import math
import pickle
from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate

from navsim.camera import DepthCamera
from rl.config import PRESETS
from rl.learner import Learner, make_actor
from rl.loss import D3QNLoss
from rl.networks import make_q_actor, symmetric_policy
from rl.optimiser import ClippedAdam, SoftUpdateAtOnce

CONFIG = replace(
    PRESETS["memoryless"],
    camera=DepthCamera(width=20, height=12),
    total_steps=1_000,
    warmup_steps=200,
    steps_per_update=8.0,
)


def sample(seed: int = 0, batch_size: int = 16) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)

    def observation():
        return {
            "depth": torch.randint(0, 256, (batch_size, 4, 12, 20), dtype=torch.uint8, generator=generator),
            "heading": torch.rand(batch_size, 1, generator=generator) * 6 - 3,
        }

    following = {
        **observation(),
        "reward": torch.randn(batch_size, 1, generator=generator),
        "done": torch.ones(batch_size, 1, dtype=torch.bool),
        "terminated": torch.ones(batch_size, 1, dtype=torch.bool),
    }
    action = torch.randint(0, 7, (batch_size,), generator=generator)
    return TensorDict({**observation(), "action": action, "next": following}, [batch_size])


def test_updates_are_due_after_the_warm_up_at_a_fixed_ratio():
    learner = Learner(CONFIG)
    assert [learner.updates_due(step) for step in (0, 200, 207, 208, 1_000)] == [0, 0, 0, 1, 100]
    assert Learner(replace(CONFIG, steps_per_update=0.5)).updates_due(201) == 2


def test_the_learning_rate_falls_along_half_a_cosine():
    learner = Learner(CONFIG)
    rates = []
    for updates in (0, 50, 100):
        learner.updates = updates
        rates.append(learner.learning_rate)
    assert rates == pytest.approx([CONFIG.learning_rate, CONFIG.learning_rate / 2, 0.0], abs=1e-12)
    constant = Learner(replace(CONFIG, learning_rate_decay="none"))
    constant.updates = 100
    assert constant.learning_rate == CONFIG.learning_rate


@pytest.mark.parametrize("loss_function", ["categorical", "l2"])
@pytest.mark.parametrize("depth_scale", ["linear", "inverse"])
def test_the_network_is_the_one_that_the_settings_describe(loss_function, depth_scale):
    config = replace(
        CONFIG, model="S", inputs=("heading", "command"), loss_function=loss_function, depth_scale=depth_scale
    )
    network = Learner(config).actor.module[0].module
    assert (network.model, network.inputs, network.depth_scale) == ("S", {"heading", "command"}, depth_scale)
    assert (network.heading_init, network.centred) == ("spread", False)
    assert make_actor(replace(config, centred=True)).module[0].module.centred
    assert make_actor(replace(config, heading_init="glorot")).module[0].module.heading_init == "glorot"
    assert network.image_shape == (4, 12, 20)
    assert getattr(network, "support", torch.empty(0)).numel() == (config.atoms if loss_function != "l2" else 0)


@pytest.mark.parametrize("model", ["I", "S"])
def test_what_is_known_is_learnt(model):
    torch.manual_seed(0)
    settings = {"loss_function": "smooth_l1", "learning_rate_decay": "none", "learning_rate": 1e-3}
    learner = Learner(replace(CONFIG, model=model, **settings))
    batch = sample()
    losses = [float(learner.update(batch)) for _ in range(150)]
    assert losses[-1] < 0.02 * losses[0]
    values = learner.actor(batch.clone())["action_value"].gather(1, batch["action"].unsqueeze(1))
    assert (values - batch["next", "reward"]).abs().max() < 0.3


@pytest.mark.parametrize("loss_function", ["categorical", "l2"])
def test_a_symmetric_policy_is_of_the_actor_that_explores_and_learns(loss_function):
    torch.manual_seed(0)
    learner = Learner(replace(CONFIG, loss_function=loss_function, symmetric=True))
    plain = Learner(replace(CONFIG, loss_function=loss_function, symmetric=False))
    assert plain.policy is plain.actor
    batch = sample()
    before = learner.policy(batch.clone())["action_value"]
    learner.update(batch.clone())
    mirrored = batch.clone()
    mirrored["depth"], mirrored["heading"] = mirrored["depth"].flip(-1), -mirrored["heading"]
    straight, other = (learner.actor(seen)["action_value"] for seen in (batch.clone(), mirrored))
    values = learner.policy(batch.clone())["action_value"]
    torch.testing.assert_close(values, (straight + other[:, [0, 1, 6, 5, 4, 3, 2]]) / 2)
    assert not torch.allclose(values, straight, atol=1e-3)
    assert not torch.allclose(values, before, atol=1e-5)
    learner.load_state_dict(plain.state_dict())  # as from a checkpoint
    plain.policy = symmetric_policy(plain.actor)
    assert (learner.policy(batch.clone())["action_value"] == plain.policy(batch.clone())["action_value"]).all()


def target(learner: Learner) -> torch.Tensor:
    return torch.cat([value.flatten() for value in learner.loss.target_value_network_params.flatten_keys().values()])


def online(learner: Learner) -> torch.Tensor:
    return torch.cat([value.flatten() for value in learner.loss.value_network_params.data.flatten_keys().values()])


def test_the_soft_target_takes_a_share_of_the_network_at_each_update():
    learner = Learner(replace(CONFIG, tau=0.25))
    before = target(learner).clone()
    learner.update(sample())
    torch.testing.assert_close(target(learner), 0.75 * before + 0.25 * online(learner))


def test_the_hard_target_is_a_copy_now_and_then():
    learner = Learner(replace(CONFIG, target_update="hard", hard_update_interval=3))
    before, equal = target(learner).clone(), []
    for seed in range(7):
        learner.update(sample(seed))
        equal.append(bool((target(learner) == online(learner)).all()))
    assert equal == [False, False, True, False, False, True, False]
    assert not (target(learner) == before).all()


@pytest.mark.parametrize("target_update", ["soft", "hard"])
def test_it_goes_on_from_its_state_bit_for_bit(target_update):
    config = replace(CONFIG, target_update=target_update, hard_update_interval=4)
    torch.manual_seed(0)
    learner = Learner(config)
    for seed in range(3):
        learner.update(sample(seed))
    restored = Learner(config)
    restored.load_state_dict(deepcopy(learner.state_dict()))  # an optimiser keeps the tensors that it is given
    for seed in range(3, 6):
        assert learner.update(sample(seed)) == restored.update(sample(seed))
    assert (online(learner) == online(restored)).all()
    assert (target(learner) == target(restored)).all()


@pytest.mark.parametrize("max_grad_norm", [1e-3, 1e6, None])
def test_steps_are_those_of_pytorch_on_clipped_gradients(max_grad_norm):
    torch.manual_seed(0)
    config = replace(CONFIG, max_grad_norm=max_grad_norm, learning_rate_decay="none")
    learner, plain = Learner(config), Learner(config)
    plain.load_state_dict(deepcopy(learner.state_dict()))
    optimiser = torch.optim.Adam(plain.parameters, lr=config.learning_rate)
    for seed in range(3):
        learner.update(sample(seed))
        plain.loss(sample(seed))["loss"].backward()
        norm = torch.nn.utils.clip_grad_norm_(plain.parameters, max_grad_norm or math.inf)
        assert 1e-3 < norm < 1e6
        optimiser.step()
        optimiser.zero_grad()
        super(SoftUpdateAtOnce, plain.target_updater).step()
    torch.testing.assert_close(online(learner), online(plain), rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(target(learner), target(plain), rtol=1e-5, atol=1e-7)
    for ours, theirs in zip(learner.optimiser.state.values(), optimiser.state.values(), strict=True):
        torch.testing.assert_close(ours["exp_avg"], theirs["exp_avg"], rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("copied", [deepcopy, lambda optimiser: pickle.loads(pickle.dumps(optimiser))])
def test_a_copied_optimiser_clips_as_the_original_does(copied):
    results = []
    for copies in (False, True):
        weight = torch.nn.Parameter(torch.ones(5))
        optimiser = ClippedAdam([weight], lr=0.1, max_norm=1.0)
        for scale in (100.0, 0.1):
            if copies:
                optimiser = copied(optimiser)
                (weight,) = optimiser.param_groups[0]["params"]
            weight.grad = scale * torch.arange(1.0, 6.0)
            optimiser.step()
        results.append(weight.detach().clone())
    torch.testing.assert_close(*results, rtol=0.0, atol=0.0)


def test_a_device_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="--device cuda: PyTorch finds no such device here; use --device cpu"):
        Learner(replace(CONFIG, device="cuda"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_learner_on_a_gpu_learns_what_one_on_the_cpu_does():
    torch.manual_seed(0)
    config = replace(CONFIG, autocast="float32")
    cpu, gpu = Learner(config), Learner(replace(config, device="cuda"))
    gpu.load_state_dict(deepcopy(cpu.state_dict()))
    for seed in range(3):
        one, other = sample(seed), sample(seed)
        torch.testing.assert_close(gpu.update(other).cpu(), cpu.update(one), rtol=1e-3, atol=1e-4)
        torch.testing.assert_close(other["td_error"], one["td_error"], rtol=1e-2, atol=1e-3)
    gpu.hand_over()
    for name, weight in cpu.actor.state_dict().items():
        torch.testing.assert_close(gpu.actor.state_dict()[name], weight, rtol=1e-2, atol=1e-3)


def test_a_soft_update_follows_a_loss_to_other_tensors():
    actor = make_q_actor("I", 12, 20)
    targets = []
    for update_class in (SoftUpdateAtOnce, SoftUpdate):
        loss = D3QNLoss(deepcopy(actor))
        update = update_class(loss, tau=0.5)
        loss.double()
        for parameter in loss.value_network_params.values(True, True):
            parameter.data.add_(1.0)
        update.step()
        targets.append(loss.target_value_network_params.data.flatten_keys("."))
    for name, value in targets[1].items():
        torch.testing.assert_close(targets[0][name], value)
    assert targets[0]["module.0.module.value.bias"].item() == 0.5
