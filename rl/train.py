"""The training loop: collect, learn, and now and then log, evaluate and save."""

from __future__ import annotations

import random
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import FrameType
from typing import Any

import torch
from rich.console import Console
from tensordict import TensorDictBase
from torchrl.checkpoint import Checkpoint, CheckpointRotation, GlobalRNGState
from torchrl.collectors import BaseCollector
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.record.loggers import TensorboardLogger

from navsim.world import World
from navsim.worldsource import worlds_from
from rl.collect import explorer, make_collector, make_env
from rl.config import TrainConfig
from rl.env import NavEnv
from rl.evaluation import Evaluation, evaluate, few_paths
from rl.learner import Learner, number_format
from rl.memory import keep_freed_memory
from rl.progress import Clock, TrainingProgress, progress_bar
from rl.replay import make_replay
from rl.run import Run, RunError
from rl.safe_loading import nothing_executed_from

_PROBE_STATES = 256
"""Fixed states whose mean greatest Q-value is logged, as in figure 6.3 of the thesis."""


def train(config: TrainConfig, *, resume: bool = False, console: Console | None = None) -> Run:
    """Trains a robot as the settings say.

    Args:
        config: the settings.
        resume: go on from the last checkpoint in ``config.directory`` instead of beginning there. Episodes that were
            under way begin anew.
        console: where progress is shown; standard output by default.

    Returns:
        the run, with its logs, weights and last checkpoint.

    Raises:
        RunError: if the directory holds a run already, or none to resume.
        navsim.WorldError: for a world file that cannot be used.
        rl.collect.CollectorError: if the process of an asynchronous collector has ended.
    """
    keep_freed_memory()
    torch.set_num_threads(config.learner_threads)
    torch.manual_seed(config.seed)
    random.seed(config.seed)
    if config.autocast == "auto":  # chosen by a stopwatch, so it is written down: a resumed run must not choose again
        config = replace(config, autocast="float32" if number_format("auto", config.device) is None else "bfloat16")
    eval_worlds = worlds_from(config.eval_world)
    with (console or Console()).status("arranging the rooms to train in"):
        env = make_env(config)
    learner = Learner(config)
    run = Run.open(config.directory) if resume else Run.create(config)

    replay = make_replay(
        capacity=config.replay_capacity,
        height=config.camera.height,
        width=config.camera.width,
        batch_size=config.batch_size,
        n_step=config.n_step,
        gamma=config.gamma,
        mirror=config.mirror,
        prioritized=config.prioritized,
    )
    policy = explorer(learner.actor, env, config)
    exploration = policy[-1]
    probe = _probe_states(env.simulator.worlds, config)
    progress = TrainingProgress(config.num_envs)
    logs = _Logs(run, config)
    checkpoint = Checkpoint(
        learner=learner,
        replay=replay,
        exploration=exploration,
        progress=progress,
        logs=logs,
        generators=GlobalRNGState(),
        format="archive",  # its checksums tell damage, which would else go unnoticed
    )
    rotation = CheckpointRotation(run.directory / "checkpoints", keep_last=1)
    if resume:
        _restore(checkpoint, rotation)
        env.set_seed(config.seed + progress.step)  # not once more the episodes that were played before
        logs.truncate_after(progress.step)
    clock = Clock(progress.seconds, progress.step)
    log_due, eval_due, checkpoint_due, handover_due = (
        _Every(interval, progress.step, config.total_steps)
        for interval in (
            config.log_interval,
            config.eval_interval,
            config.checkpoint_interval,
            config.steps_per_handover,
        )
    )
    collector = make_collector(
        env, policy, config, total_steps=config.total_steps - progress.step, seed=config.seed + progress.step
    )
    with _closing(collector), progress_bar(console) as bar, _interrupts_between_batches() as interrupts:
        shown = bar.add_task("", total=config.total_steps, completed=progress.step, status="", speed="")
        for batch in collector:
            replay.extend(batch)
            exploration.step()
            progress.count(batch)
            while learner.updates < learner.updates_due(progress.step):
                sample = replay.sample()
                loss = learner.update(sample)
                if config.prioritized:
                    replay.update_tensordict_priority(sample)
                progress.learnt(loss, sample["chosen_action_value"])
            if handover_due(progress.step):
                learner.hand_over()
                if config.collector == "async":
                    collector.update_policy_weights_()

            progress.seconds = clock.seconds
            speed = clock.tick(progress.step)
            status = f"{progress.status()}  ε {float(exploration.eps.mean()):.2f}"
            bar.update(shown, completed=progress.step, status=status, speed=f"{speed:,.0f} steps/s")
            if log_due(progress.step):
                logs.metrics(
                    progress.row()
                    | {
                        "steps_per_second": speed,
                        "max_q": _mean_max_q(learner, probe),
                        "epsilon": float(exploration.eps.mean()),
                        "learning_rate": learner.learning_rate,
                    }
                )
            if eval_due(progress.step):
                learner.hand_over()
                bar.update(shown, status="evaluating")
                logs.evaluation(_evaluate(learner, eval_worlds, config), learner, progress)
                bar.update(shown, status=status)
            if checkpoint_due(progress.step):
                learner.hand_over()
                run.save_policy("policy_last", learner.actor.state_dict())
                rotation.save(checkpoint, step=progress.step)
            if interrupts:
                raise KeyboardInterrupt
    return run


@contextmanager
def _closing(collector: BaseCollector) -> Iterator[None]:
    """Ends a collector and its processes, whatever happens."""
    try:
        yield
    finally:
        collector.shutdown(raise_on_error=False)


@contextmanager
def _interrupts_between_batches() -> Iterator[list[int]]:
    """Collects Ctrl-C for the loop to heed when nothing is half done; a second one interrupts at once.

    An exception in the middle may be lost: where C code calls back, it is printed and forgotten.
    """
    interrupts: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield interrupts
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, _: FrameType | None) -> None:
        interrupts.append(number)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, before)


def _restore(checkpoint: Checkpoint, rotation: CheckpointRotation) -> None:
    """Goes back to the last checkpoint; without one, nothing changes."""
    files = sorted(rotation.directory.glob("checkpoint-*"))
    if not files:
        return
    try:
        with nothing_executed_from(files[-1]):
            checkpoint.load(files[-1])
    except RunError:
        raise
    except Exception as error:  # a damaged file raises as many types as there are formats in it
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RunError(
            f"{files[-1]} is damaged ({reason}); restore it, or delete it to train from the beginning"
        ) from error


class _Every:
    """Tells when the next multiple of an interval, or the end, has been reached."""

    def __init__(self, interval: int, step: int, end: int) -> None:
        self._interval, self._end = interval, end
        self._next = (step // interval + 1) * interval

    def __call__(self, step: int) -> bool:
        due = step >= min(self._next, self._end)
        if due:
            self._next = (step // self._interval + 1) * self._interval
        return due


class _Logs:
    """Writes rows to the run's tables and to TensorBoard, and keeps the weights of the best evaluation."""

    def __init__(self, run: Run, config: TrainConfig) -> None:
        self._run, self._config = run, config
        self._tensorboard = TensorboardLogger("tensorboard", log_dir=str(run.directory))
        self._best = (-1.0, -1.0)

    def metrics(self, row: dict[str, Any]) -> None:
        self._run.metrics.append(row)
        self._curves("train", row)

    def evaluation(self, result: Evaluation, learner: Learner, progress: TrainingProgress) -> None:
        row = {
            "step": progress.step,
            "seconds": progress.seconds,
            "world": self._config.eval_world,
            "success_rate": result.success_rate,
            "collision_rate": result.collision_rate,
            "timeout_rate": result.timeout_rate,
            "spl": result.spl,
            "reward": result.mean_reward,
            "steps": result.mean_steps,
        }
        self._run.evaluations.append(row)
        self._curves("evaluation", row)
        # At equal success the shorter paths win; at equal paths the later weights.
        if (result.success_rate, result.spl) >= self._best:
            self._best = (result.success_rate, result.spl)
            self._run.save_policy("policy", learner.actor.state_dict())

    def _curves(self, group: str, row: dict[str, Any]) -> None:
        for name, value in row.items():
            if isinstance(value, float):
                self._tensorboard.log_scalar(f"{group}/{name}", value, step=row["step"])

    def truncate_after(self, step: int) -> None:
        self._run.metrics.truncate_after(step)
        self._run.evaluations.truncate_after(step)

    def state_dict(self) -> dict[str, Any]:
        return {"best": list(self._best)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        success_rate, spl = state_dict["best"]
        self._best = (success_rate, spl)


def _evaluate(learner: Learner, worlds: Sequence[World], config: TrainConfig) -> Evaluation:
    return evaluate(
        learner.actor,
        worlds,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        sensor=config.sensor,
        seed=config.seed,
        num_paths=few_paths(worlds),
    )


def _probe_states(worlds: Sequence[World], config: TrainConfig) -> TensorDictBase:
    """States met by random driving, the same for every run in the same worlds."""
    env = NavEnv(
        worlds,
        config.num_envs,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        sensor=config.sensor,
        seed=0,
    )
    with torch.random.fork_rng():
        torch.manual_seed(0)
        steps = 4 * _PROBE_STATES // config.num_envs + 1
        visited = env.rollout(steps, break_when_any_done=False).select("depth", "heading").reshape(-1)
        return visited[torch.randperm(len(visited))[:_PROBE_STATES]].clone()


@torch.no_grad()
def _mean_max_q(learner: Learner, probe: TensorDictBase) -> float:
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return float(learner.actor(probe.copy())["action_value"].max(dim=-1).values.mean())
