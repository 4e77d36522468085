"""Numbers of a training run watched: what is not finite ends it, and values that no rewards allow are warned about."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import torch
from safetensors.torch import save
from tensordict import TensorDictBase
from torch import Tensor

from navsim.files import atomic_write
from navsim.robot import ACTIONS
from navsim.task import Task
from rl.config import TrainConfig
from rl.learner import Learner, name_in_network
from rl.progress import TrainingProgress
from rl.run import Run, writing

_OF_THE_NETWORK = ("action_value", "chosen_action_value")
"""What a collected batch holds that does not come from the simulator."""
_DIVERGED = 2.0
"""A Q-value so many times beyond what rewards and discount allow tells of divergence, not of an error of learning."""
_WARN_AGAIN = 10.0
"""Growth of the greatest Q-value since the last warning that is worth another one."""
_CUT_OFF_SHARE = 0.1
"""Share of Q-values at an end of a categorical loss's returns from which on these are too narrow."""
_END_OF_RANGE = 0.05
"""Share of a categorical loss's range of returns that counts as its end."""
_SHARE_UPDATES = 200.0
"""Updates over which shares are averaged."""


class NumbersError(ArithmeticError):
    """A training run has come to numbers that are not finite, and has ended before anything was made of them."""


class Watch:
    """Sees to it that a run neither learns from, nor saves, numbers that are not finite.

    Loss and gradient are checked in every update, before the weights change; all that a collected batch holds, before
    it is stored; weights and the optimiser's moments where they are logged, evaluated or saved.

    Args:
        run: whose directory a batch with bad numbers is saved in.
        config: the run's settings.
        learner: whose updates are watched.
        progress: tells the step.
        warn: is told of values that diverge, in one sentence.
    """

    def __init__(
        self, run: Run, config: TrainConfig, learner: Learner, progress: TrainingProgress, warn: Callable[[str], None]
    ) -> None:
        self._run, self._config, self._learner, self._progress, self._warn = run, config, learner, progress, warn
        self._sample: TensorDictBase | None = None
        self._bound = return_bound(config.task, config.gamma)
        self._warn_beyond = _DIVERGED
        self._share_at_end = 0.0

    def collected(self, batch: TensorDictBase) -> None:
        """Checks a collector's batch ``(N, T)``, which is not counted yet.

        Raises:
            NumbersError: for an observation, a reward or a Q-value that is not finite.
        """
        for key, values in batch.items(include_nested=True, leaves_only=True):
            if values.is_floating_point() and not _is_finite(values) and not bool(values.isfinite().all()):
                robot, time = torch.nonzero(~values.isfinite().flatten(2).all(-1))[0].tolist()
                value = values[robot, time][~values[robot, time].isfinite()][0].item()
                name = key if isinstance(key, str) else key[-1]
                of_the_simulator = "it comes from the simulator, so please report it with that file"
                self._end(
                    f"the {name} of robot {robot} is {value}",
                    batch,
                    self._learning_remedy() if name in _OF_THE_NETWORK else of_the_simulator,
                    step=self._progress.step + time * batch.shape[0] + robot + 1,
                )

    def update(self, sample: TensorDictBase) -> Tensor:
        """``Learner.update``, and a look at the Q-values.

        Raises:
            NumbersError: for a loss or a gradient that is not finite; the weights are as they were before.
        """
        self._sample = sample
        try:
            loss = self._learner.update(sample)
        except FloatingPointError as error:
            self._end(str(error), sample, self._learning_remedy())
        self._look_at_values(sample["chosen_action_value"])
        return loss

    def check_weights(self) -> None:
        """Checks everything that a checkpoint is made of and that learning changes.

        Raises:
            NumbersError: for a weight, or a moment of the optimiser, that is not finite.
        """
        for name, values in _learnt(self._learner):
            if not _is_finite(values) and not bool(values.isfinite().all()):
                value = values[~values.isfinite()].flatten()[0].item()
                self._end(f"{name} holds {value}", self._sample, self._learning_remedy())

    def _end(self, what: str, batch: TensorDictBase | None, remedy: str, step: int | None = None) -> NoReturn:
        step = self._progress.step if step is None else step
        saved = ""
        if batch is not None:
            path = self._run.directory / f"bad_batch-{step}.safetensors"
            with writing(path), atomic_write(path, "wb") as file:
                file.write(save(_tensors(batch), {"step": str(step), "what": what}))
            saved = f", and the batch at hand is in {path}"
        checkpoint = _last_checkpoint(self._run)
        kept = "no checkpoint had been written" if checkpoint is None else f"the last good checkpoint is {checkpoint}"
        raise NumbersError(
            f"step {step:,}: {what}; the run has ended before it could spoil more, {kept}{saved}; {remedy}"
        )

    def _learning_remedy(self) -> str:
        config = self._config
        tries = [f"a smaller --learning-rate than {config.learning_rate:g}"]
        if config.max_grad_norm is None:
            tries.append("--max-grad-norm 10")
        if config.autocast != "float32":
            tries.append("--autocast float32")
        return f"begin anew (--out) with {' or '.join(tries)}: going on from the checkpoint would lead there again"

    def _look_at_values(self, values: Tensor) -> None:
        least, greatest = (float(end) for end in torch.aminmax(values))
        if self._config.loss_function == "categorical":
            self._look_at_ends(values, least, greatest)
            return
        value = max(least, greatest, key=abs)
        beyond = abs(value) / self._bound
        if beyond >= self._warn_beyond:
            self._warn_beyond = _WARN_AGAIN * beyond
            config = self._config
            self._warn(
                f"step {self._progress.step:,}: a Q-value is {value:.4g}, where rewards and --gamma {config.gamma:g} "
                f"allow ±{self._bound:.4g}: learning diverges; try a smaller --learning-rate than "
                f"{config.learning_rate:g}, a slower target network (--tau {config.tau / 5:g}), or --loss-function "
                "categorical"
            )

    def _look_at_ends(self, values: Tensor, least: float, greatest: float) -> None:
        config = self._config
        margin = _END_OF_RANGE * (config.greatest_return - config.least_return)
        low, high = config.least_return + margin, config.greatest_return - margin
        share = 0.0
        if least < low or greatest > high:
            share = float(((values < low) | (values > high)).float().mean())
        self._share_at_end += (share - self._share_at_end) / _SHARE_UPDATES
        if self._share_at_end > _CUT_OFF_SHARE:
            self._share_at_end = -math.inf  # once is enough
            setting, value = ("--greatest-return", greatest) if greatest > high else ("--least-return", least)
            self._warn(
                f"step {self._progress.step:,}: Q-values such as {value:.4g} pile up at an end of the returns that are "
                f"told apart, {config.least_return:g} to {config.greatest_return:g}, and are cut off there; move "
                f"{setting}, or use a smaller --gamma than {config.gamma:g}"
            )


def return_bound(task: Task, gamma: float) -> float:
    """The greatest size of a discounted return that the rules allow, whatever the robot does.

    That is driving towards its goal or away from it forever, at full speed, or an end at once: anything else is a mean
    of these.

    Args:
        task: the rules.
        gamma: discount a step. Infinite with 1, and where there are no rewards: nothing can be said then.

    >>> return_bound(Task(), 0.8), round(return_bound(Task(), 0.99), 9)
    (1.0, 9.0)
    """
    if gamma >= 1.0:
        return math.inf
    fastest = max(abs(action.linear or 0.0) for action in ACTIONS)
    metre = abs(task.progress_weight) + abs(task.length_penalty)
    step = metre * task.control_period * fastest + abs(task.step_penalty)
    return max(step / (1.0 - gamma), abs(task.goal_reward), abs(task.collision_reward)) or math.inf


def _is_finite(values: Tensor) -> bool:
    """Whether all values are finite: the cheapest test, which takes a sum that overflows for one that is not."""
    return math.isfinite(float(values.sum()))


def _learnt(learner: Learner) -> Iterator[tuple[str, Tensor]]:
    for name, values in learner.loss.state_dict().items():
        if values.is_floating_point():
            network = "the target network's" if name.startswith("target") else "the weight"
            yield f"{network} {name_in_network(name)}", values
    for name, parameter in learner.loss.named_parameters():
        for moment, values in learner.optimiser.state.get(parameter, {}).items():
            yield f"Adam's {moment} of {name_in_network(name)}", values


def _tensors(batch: TensorDictBase) -> dict[str, Tensor]:
    return {name: values.contiguous() for name, values in batch.cpu().flatten_keys(".").items()}


def _last_checkpoint(run: Run) -> Path | None:
    return max((run.directory / "checkpoints").glob("checkpoint-*"), default=None)
