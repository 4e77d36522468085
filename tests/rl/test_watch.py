"""Numbers that are not finite, put in at every place where they may come up, and values that diverge."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console
from safetensors import safe_open
from safetensors.torch import load_file
from small_runs import HALL, tiny_config
from tensordict import TensorDict

from navsim.camera import DepthCamera
from navsim.task import Task
from rl.categorical import CategoricalD3QNLoss
from rl.cli import main
from rl.config import TrainConfig
from rl.env import NavEnv
from rl.learner import Learner
from rl.loss import D3QNLoss
from rl.run import Run
from rl.train import train
from rl.watch import NumbersError, return_bound

UPDATES_BEFORE = 5  # the fifth update is at step 224, as is the second checkpoint; the first is at step 128


def config(out: Path, **settings: Any) -> TrainConfig:
    own = {"warmup_steps": 64, "replay_capacity": 128, "eval_interval": 384, "checkpoint_interval": 112}
    return tiny_config(out, **{**own, **settings})


def ended_by_bad_numbers(settings: TrainConfig) -> str:
    with pytest.raises(NumbersError) as caught:
        train(settings, console=Console(quiet=True))
    return str(caught.value)


def checkpoint_and_batch_named_in(message: str) -> tuple[Path, Path]:
    checkpoint = re.search(r"the last good checkpoint is (\S+?),", message)
    batch = re.search(r"the batch at hand is in (\S+?);", message)
    assert checkpoint, message
    assert batch, message
    return Path(checkpoint[1]), Path(batch[1])


def assert_nothing_bad_was_kept(run: Run, *, remembers: bool = False) -> None:
    for path in [*(run.directory / "checkpoints").rglob("*.pt"), *run.directory.glob("*.pt")]:
        if remembers and path.parent.name.endswith("-collector"):
            continue  # what a robot remembers nothing of is infinitely far
        assert all(map(is_finite, tensors(torch.load(path, weights_only=True)))), path


def tensors(state: Any) -> list[torch.Tensor]:
    if isinstance(state, torch.Tensor):
        return [state]
    parts = state.values() if isinstance(state, dict) else state if isinstance(state, list | tuple) else ()
    return [tensor for part in parts for tensor in tensors(part)]


def is_finite(values: torch.Tensor) -> bool:
    return not values.is_floating_point() or bool(values.isfinite().all())


def spoil_loss(monkeypatch: pytest.MonkeyPatch, value: float) -> None:
    forward = CategoricalD3QNLoss.forward
    calls = []

    def spoilt(self: CategoricalD3QNLoss, tensordict: TensorDict) -> TensorDict:
        calls.append(None)
        found = forward(self, tensordict)
        return found.apply(lambda loss: loss * value) if len(calls) > UPDATES_BEFORE else found

    monkeypatch.setattr(CategoricalD3QNLoss, "forward", spoilt)


def spoil_after_an_update(monkeypatch: pytest.MonkeyPatch, spoil: Callable[[Learner], None]) -> None:
    update = Learner.update

    def spoilt(self: Learner, sample: TensorDict) -> torch.Tensor:
        loss = update(self, sample)
        if self.updates == UPDATES_BEFORE:
            spoil(self)
        return loss

    monkeypatch.setattr(Learner, "update", spoilt)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_ends_the_run_before_it_is_learnt_from(tmp_path, monkeypatch, value):
    spoil_loss(monkeypatch, value)
    message = ended_by_bad_numbers(config(tmp_path / "run"))
    assert message.startswith(f"step 256: the loss of 16 transitions is {value};")
    assert "begin anew (--out) with a smaller --learning-rate than 0.0005" in message
    checkpoint, batch = checkpoint_and_batch_named_in(message)
    assert checkpoint == max((tmp_path / "run" / "checkpoints").iterdir())
    assert checkpoint.name == "checkpoint-000000000224"
    assert batch.name == "bad_batch-256.safetensors"
    sample = TensorDict(load_file(batch), [16]).unflatten_keys(".")
    assert sample["next", "depth"].shape == (16, 4, 10, 14)
    with safe_open(batch, "pt") as file:
        assert file.metadata() == {"step": "256", "what": f"the loss of 16 transitions is {value}"}
    assert_nothing_bad_was_kept(Run.open(tmp_path / "run"))


@pytest.mark.parametrize(
    ("max_grad_norm", "parameter", "named"),
    [
        (10.0, "conv2.weight", "conv2.weight"),
        (10.0, "streams.weight", "streams.weight"),
        (None, "value.bias", "value.bias"),
        (None, "conv2.weight", "conv2.weight"),
    ],
)
def test_a_gradient_that_is_not_finite_is_named_and_changes_no_weight(
    tmp_path, monkeypatch, max_grad_norm, parameter, named
):
    seen: list[torch.Tensor] = []

    def spoil(learner: Learner) -> None:
        weights = dict(learner.actor.module[0].module.named_parameters())
        weights[parameter].register_hook(lambda gradient: gradient.clone().fill_(float("inf")))
        seen.append(torch.cat([weight.detach().flatten() for weight in weights.values()]))
        learners.append(learner)

    learners: list[Learner] = []
    spoil_after_an_update(monkeypatch, spoil)
    message = ended_by_bad_numbers(config(tmp_path / "run", max_grad_norm=max_grad_norm))
    assert message.startswith(f"step 256: the gradient of {named} is not finite;")
    assert ("--max-grad-norm 10" in message) == (max_grad_norm is None)
    checkpoint_and_batch_named_in(message)
    after = torch.cat([weight.detach().flatten() for weight in learners[0].actor.module[0].module.parameters()])
    assert (after == seen[0]).all()


def spoil_first(values: torch.Tensor, value: float) -> None:
    values[(0,) * values.ndim] = value


def weight(learner: Learner) -> torch.Tensor:
    return learner.actor.module[0].module.conv3.weight.data


def target_weight(learner: Learner) -> torch.Tensor:
    return learner.loss.target_value_network_params["module", "0", "module", "value", "bias"].data


def moment(learner: Learner) -> torch.Tensor:
    return learner.optimiser.state[learner.parameters[0]]["exp_avg_sq"]


@pytest.mark.parametrize(
    ("place", "named"),
    [
        (weight, "the weight conv3.weight"),
        (target_weight, "the target network's value.bias"),
        (moment, "Adam's exp_avg_sq of conv1.weight"),
    ],
)
def test_a_weight_that_is_not_finite_is_named_and_gets_into_no_checkpoint(tmp_path, monkeypatch, place, named):
    def spoil(learner: Learner) -> None:
        spoil_first(place(learner), float("inf"))

    spoil_after_an_update(monkeypatch, spoil)
    message = ended_by_bad_numbers(config(tmp_path / "run", log_interval=512))
    assert message.startswith(f"step 224: {named} holds inf;")
    checkpoint, _ = checkpoint_and_batch_named_in(message)
    assert checkpoint.name == "checkpoint-000000000128"
    assert_nothing_bad_was_kept(Run.open(tmp_path / "run"))


def test_a_weight_that_is_not_finite_is_found_where_it_would_be_logged_and_where_evaluated(tmp_path, monkeypatch):
    spoil_after_an_update(monkeypatch, lambda learner: spoil_first(weight(learner), float("nan")))
    never = {"checkpoint_interval": 512, "eval_interval": 512, "log_interval": 512}
    for name in ("eval_interval", "log_interval"):
        message = ended_by_bad_numbers(config(tmp_path / name, **never | {name: 224}))
        assert message.startswith("step 224: the weight conv3.weight holds nan;")
        assert "no checkpoint had been written" in message


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("key", ["heading", "reward", "command", "surroundings"])
def test_an_observation_that_is_not_finite_is_not_stored(tmp_path, monkeypatch, key, value):
    step, calls = NavEnv._step, []

    def spoilt(self: NavEnv, tensordict: TensorDict) -> TensorDict:
        found = step(self, tensordict)
        if self.batch_size[0] == 16:
            calls.append(None)
            if len(calls) == 18:  # the ninth batch's second step; robot 3
                found[key][3] = value
        return found

    monkeypatch.setattr("rl.train._probe_states", lambda worlds, config: probe)
    inputs = ("depth", "heading", "command", "surroundings")
    probe = NavEnv(str(HALL), 8, camera=DepthCamera(width=14, height=10), surroundings=True, seed=0).rollout(1)
    probe = probe.select(*inputs).reshape(-1)
    monkeypatch.setattr(NavEnv, "_step", spoilt)
    message = ended_by_bad_numbers(config(tmp_path / "run", inputs=inputs))
    assert message.startswith(f"step 276: the {key} of robot 3 is {value};")
    assert "please report it with that file" in message
    checkpoint, batch = checkpoint_and_batch_named_in(message)
    assert checkpoint.name == "checkpoint-000000000224"
    places = torch.nonzero(~load_file(batch)[f"next.{key}"].isfinite())
    assert set(map(tuple, places[:, :2].tolist())) == {(3, 1)}
    assert_nothing_bad_was_kept(Run.open(tmp_path / "run"), remembers=True)


def test_a_value_that_is_not_finite_is_laid_to_the_network_and_not_to_the_simulator(tmp_path, monkeypatch):
    spoil_after_an_update(monkeypatch, lambda learner: value_bias(learner).fill_(float("nan")))
    message = ended_by_bad_numbers(config(tmp_path / "run", checkpoint_interval=512, log_interval=512))
    assert re.match(r"step \d+: the (chosen_)?action_value of robot 0 is nan;", message), message
    assert "begin anew (--out) with a smaller --learning-rate" in message


def value_bias(learner: Learner) -> torch.Tensor:
    return learner.actor.module[0].module.value.bias.data


def test_the_command_ends_with_one_sentence_and_status_1(tmp_path, capfd):
    settings = ["--camera.width", "14", "--camera.height", "10", "--world", str(HALL), "--eval-world", str(HALL)]
    settings += ["--rearrangements", "0", "--total-steps", "512", "--warmup-steps", "64", "--num-threads", "1"]
    settings += ["--loss-function", "l2", "--learning-rate", "1e30", "--autocast", "float32"]
    assert main(["train", *settings, "--out", str(tmp_path / "run")]) == 1
    (sentence,) = capfd.readouterr().err.splitlines()
    assert re.match(r"step \d+: the loss of 64 transitions is (inf|nan); the run has ended", sentence)
    assert "a smaller --learning-rate than 1e+30" in sentence


def warned_of(settings: TrainConfig) -> list[str]:
    text = io.StringIO()
    run = train(settings, console=Console(file=text, width=1000))
    noted = run.directory / "warnings.txt"
    warnings = noted.read_text(encoding="utf-8").splitlines() if noted.exists() else []
    assert all(warning in text.getvalue() for warning in warnings)
    return warnings


def test_values_beyond_what_rewards_allow_are_warned_about_with_what_to_try(tmp_path):
    warnings = warned_of(config(tmp_path / "run", loss_function="l2", learning_rate=0.03, learning_rate_decay="none"))
    assert 1 <= len(warnings) <= 4
    told = re.match(r"step (\d+): a Q-value is (\S+), where rewards and --gamma 0.97 allow ±3: ", warnings[0])
    assert told, warnings
    assert abs(float(told[2])) > 6.0
    assert "learning diverges; try a smaller --learning-rate than 0.03" in warnings[0]


@pytest.mark.parametrize("loss_function", ["l2", "categorical"])
def test_a_run_whose_values_are_sound_is_not_warned_about(tmp_path, loss_function):
    assert not warned_of(config(tmp_path / "run", loss_function=loss_function))


def make_up_values(monkeypatch: pytest.MonkeyPatch, loss: type[D3QNLoss], values: Iterable[torch.Tensor]) -> None:
    made_up = iter(values)

    def forward(self: D3QNLoss, tensordict: TensorDict) -> TensorDict:
        tensordict.set("chosen_action_value", next(made_up).expand(16).unsqueeze(-1))
        return TensorDict({"loss": 0.0 * sum(weight.sum() for weight in self.parameters())})

    monkeypatch.setattr(loss, "forward", forward)


def test_values_are_warned_about_again_when_they_have_grown_tenfold(tmp_path, monkeypatch):
    values = [5.9, -6.1, -30.0, 60.0, 62.0, 3e5, 1.0, 1e6, 1e6, *[0.0] * 9]
    make_up_values(monkeypatch, D3QNLoss, map(torch.tensor, values))
    warnings = warned_of(config(tmp_path / "run", loss_function="l2", total_steps=512))
    assert [warning.split()[5] for warning in warnings] == ["-6.1,", "62,", "3e+05,"]


@pytest.mark.parametrize(
    ("of_sixteen", "value", "setting"),
    [(1, 2.4, None), (4, 2.4, "--greatest-return"), (4, -1.4, "--least-return"), (16, 2.2, None)],
)
def test_returns_that_are_cut_off_are_warned_about_once(tmp_path, monkeypatch, of_sixteen, value, setting):
    values = torch.zeros(16)
    values[:of_sixteen] = value
    make_up_values(monkeypatch, CategoricalD3QNLoss, itertools.repeat(values))
    warnings = warned_of(config(tmp_path / "run", steps_per_update=1, total_steps=256))
    assert len(warnings) == (setting is not None)
    if setting:
        assert (
            f"Q-values such as {value:g} pile up at an end of the returns that are told apart, -1.5 to 2.5"
            in warnings[0]
        )
        assert f"move {setting}" in warnings[0]


def test_the_bound_of_returns_is_that_of_the_best_and_the_worst_robot():
    task = Task(goal_reward=3.0, collision_reward=-2.0, progress_weight=5.0, step_penalty=0.02)
    away_forever = sum((-5.0 * 0.2 * 0.4 - 0.02) * 0.9**step for step in range(1000))
    assert return_bound(task, 0.9) == pytest.approx(-away_forever)
    assert return_bound(task, 0.1) == 3.0
    dear = replace(task, length_penalty=0.5)
    assert return_bound(dear, 0.9) == pytest.approx(-away_forever + 0.5 * 0.4 * 0.2 / (1.0 - 0.9))
    assert return_bound(replace(task, collision_reward=-7.0), 0.1) == 7.0
    assert return_bound(task, 1.0) == float("inf")
    still = Task(goal_reward=0.0, collision_reward=0.0, progress_weight=0.0, step_penalty=0.0)
    assert return_bound(still, 0.9) == float("inf")
