"""The training loop: collect, learn, and now and then log, evaluate and save."""

from __future__ import annotations

import os
import random
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import torch
import torchrl
from rich.console import Console
from tensordict import TensorDictBase
from torchrl.checkpoint import Checkpoint, GlobalRNGState
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.record.loggers import TensorboardLogger

from navsim.world import World
from navsim.worldsource import TRAINING_SEED, have_rooms_in_common, worlds_from
from rl.background import CollectorError, PersistentCollector
from rl.checkpoints import Checkpoints, StateFile, step_of
from rl.collect import ResumableCollector, explorer, make_collector, make_env
from rl.config import TrainConfig
from rl.env import NavEnv
from rl.evaluation import evaluate_as_trained
from rl.feasibility import check_feasible
from rl.learner import Learner
from rl.memory import keep_freed_memory
from rl.metrics import Evaluation
from rl.number_format import fastest_number_format
from rl.observation import keys_of
from rl.paths import few_paths
from rl.progress import Clock, TrainingProgress, progress_bar
from rl.replay import make_replay
from rl.run import Run, settings_of, writing
from rl.subnormals import subnormals_are_zero
from rl.watch import Watch

_PROBE_STATES = 256
"""Fixed states whose mean greatest Q-value is logged, as in figure 6.3 of the thesis."""


def train(config: TrainConfig, *, resume: bool = False, console: Console | None = None) -> Run:
    """Trains a robot as the settings say.

    Args:
        config: the settings.
        resume: go on from the newest intact checkpoint in ``config.directory`` instead of beginning there; where none
            has been written yet, begin anew. A synchronous run ends as if it had never been interrupted, bit for bit;
            in an asynchronous one, episodes that were under way begin anew.
        console: where progress is shown; standard output by default.

    Returns:
        the run, with its logs, weights and checkpoints.

    Raises:
        ConfigError: for a run that cannot be done on this machine, or with these worlds.
        RunError: if the directory holds a run already, or none to resume, or cannot be written to.
        navsim.WorldError: for a world file that cannot be used.
        rl.background.CollectorError: if the process of an asynchronous collector has failed again and again. What was
            learnt until then is in a checkpoint.
        rl.watch.NumbersError: for an observation, a loss, a gradient or a weight that is not finite.
    """
    console = console or Console()
    run = Run(config.directory)
    if resume:
        run = Run.open(config.directory)
        if config.autocast == "auto":  # chosen by a stopwatch when the run was begun, and written down
            config = replace(config, autocast=run.config.autocast)
        run.check_resumable(config)
    else:
        run.check_vacant()
    if not (resume and _nothing_is_left_to_train(run)):
        check_feasible(run.with_its_worlds(config) if resume else config, is_trained=resume and _is_trained(run))
    with run.claimed(), subnormals_are_zero():
        if resume and _nothing_is_left_to_train(run):
            return run
        return _train(config, run, resume, console)


def _nothing_is_left_to_train(run: Run) -> bool:
    """Whether a run has ended, and its checkpoints are not wanted any more."""
    return not Checkpoints(run.directory / "checkpoints", {}).paths() and run.has_ended


def _is_trained(run: Run) -> bool:
    """Whether the newest checkpoint has learnt all."""
    checkpoints = Checkpoints(run.directory / "checkpoints", {}).paths()
    return bool(checkpoints) and step_of(checkpoints[-1]) >= run.config.total_steps


def _train(config: TrainConfig, run: Run, resume: bool, console: Console) -> Run:
    if "RL_LOGGING_LEVEL" not in os.environ:
        torchrl.logger.setLevel("WARNING")  # it would tell of every buffer that it allocates
    keep_freed_memory()
    torch.set_num_threads(config.num_threads)
    if config.autocast == "auto":
        config = replace(config, autocast=fastest_number_format(config))
    torch.manual_seed(config.seed)
    random.seed(config.seed)
    seen = run.with_its_worlds(config) if resume else config
    eval_worlds = worlds_from(seen.eval_world)
    with console.status("arranging the rooms to train in"):
        env = make_env(seen)
    learner = Learner(config)
    if not resume:
        run = Run.create(config)

    checkpoints = Checkpoints(run.directory / "checkpoints", settings_of(config))
    begun = _checkpoint_to_resume(run, checkpoints, console) if resume else None
    if have_rooms_in_common(seen.world, [seen.eval_world], TRAINING_SEED + config.seed):
        sentence = f"{config.eval_world} is trained in as well: evaluations there do not tell of rooms never seen"
        console.print(sentence, soft_wrap=True, markup=False)
    skipped = step_of(begun) if begun is not None and config.collector == "async" else 0
    replay = make_replay(
        capacity=config.replay_capacity,
        height=config.camera.height,
        width=config.camera.width,
        batch_size=config.batch_size,
        n_step=config.n_step,
        gamma=config.gamma,
        mirror=config.mirror,
        prioritized=config.prioritized,
        inputs=config.inputs,
        frame_interval=config.frame_interval,
    )
    policy = explorer(learner.actor, env, config)
    exploration = policy[-1]
    probe = _probe_states(env.simulator.worlds, config)
    progress = TrainingProgress(config.num_envs)
    logs = _Logs(run, config)

    def warn(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False, highlight=False)
        run.note(text)

    def replaced(text: str) -> None:
        warn(f"step {progress.step:,}: {text}")
        progress.abandon_episodes()

    collector = make_collector(
        env,
        policy,
        config,
        total_steps=config.total_steps - skipped,
        seed=config.seed + skipped,
        replaced=replaced,
    )
    watch = Watch(run, config, learner, progress, warn)
    checkpoint = Checkpoint()
    parts = {
        "learner": learner,
        "replay": replay,
        "exploration": exploration,
        "progress": progress,
        "logs": logs,
        "generators": GlobalRNGState(),
    }
    if config.collector == "sync":
        parts["collector"] = collector
    for name, part in parts.items():
        checkpoint.register(name, part, adapter=StateFile(mapped=name == "replay"))

    saved = 0 if begun is None else step_of(begun)

    def save() -> None:
        nonlocal saved
        if saved == progress.step:
            return
        watch.check_weights()
        learner.hand_over()
        logs.flush()
        run.save_policy("policy_last", learner.actor.state_dict())
        keep_time()  # an evaluation at this step included
        checkpoints.save(checkpoint, progress.step, logs.take_score())
        saved = progress.step

    with _closing(collector), logs, progress_bar(console) as bar, _interrupts_between_batches() as interrupts:
        if begun is not None:
            checkpoints.load(checkpoint, begun)
            run.save_policy("policy_last", learner.actor.state_dict())
            if config.collector == "async":
                collector.update_policy_weights_()
                progress.abandon_episodes()
        logs.begin(progress)
        clock = Clock(progress, lambda: [process.pid for process in getattr(collector, "procs", ())])

        def keep_time() -> None:
            progress.seconds, progress.processor_seconds = clock.seconds, clock.processor_seconds

        log_due, eval_due, checkpoint_due, handover_due = (
            _Every(interval, progress.step, config.total_steps)
            for interval in (
                config.log_interval,
                config.eval_interval,
                config.checkpoint_interval,
                config.steps_per_handover,
            )
        )
        shown = bar.add_task("", total=config.total_steps, completed=progress.step, status="", speed="")
        for batch in _saving_at_its_failure(collector, save):
            watch.collected(batch)
            replay.extend(batch)
            exploration.step()
            progress.count(batch)
            while learner.updates < learner.updates_due(progress.step):
                sample = replay.sample()
                loss = watch.update(sample)
                if config.prioritized:
                    replay.update_tensordict_priority(sample)
                progress.learnt(loss, sample["chosen_action_value"])
            if handover_due(progress.step):
                learner.hand_over()
                if config.collector == "async":
                    collector.update_policy_weights_()

            keep_time()
            speed = clock.tick(progress.step)
            status = f"{progress.status()}  ε {float(exploration.eps.mean()):.2f}"
            bar.update(shown, completed=progress.step, status=status, speed=f"{speed:,.0f} steps/s")
            if log_due(progress.step):
                watch.check_weights()
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
                watch.check_weights()
                learner.hand_over()
                bar.update(shown, status="evaluating")
                logs.evaluation(_evaluate(learner, eval_worlds, config), learner, progress)
                bar.update(shown, status=status)
            if checkpoint_due(progress.step):
                save()
            if interrupts:
                bar.update(shown, status="interrupted: saving a checkpoint")
                save()
                raise KeyboardInterrupt
        if interrupts:  # since the last batch, or in a run that had none left
            raise KeyboardInterrupt
    return run


def _checkpoint_to_resume(run: Run, checkpoints: Checkpoints, console: Console) -> Path | None:
    """The checkpoint to go on from, all that a killed process left half written having been removed."""
    run.remove_rubbish()
    checkpoints.remove_rubbish()
    say = partial(console.print, soft_wrap=True, markup=False)
    begun = checkpoints.newest_intact(say)
    if begun is None:
        say(f"{run.directory} was interrupted before its first checkpoint: it begins anew")
    return begun


def _saving_at_its_failure(
    collector: ResumableCollector | PersistentCollector, save: Callable[[], None]
) -> Iterator[TensorDictBase]:
    """The collector's batches; when there can be no more of them, what has been learnt from the others is saved."""
    try:
        yield from collector
    except CollectorError:
        save()
        raise


@contextmanager
def _closing(collector: ResumableCollector | PersistentCollector) -> Iterator[None]:
    """Ends a collector and its processes, whatever happens."""
    try:
        yield
    finally:
        collector.shutdown(raise_on_error=False)


@contextmanager
def _interrupts_between_batches() -> Iterator[list[int]]:
    """Collects Ctrl-C and SIGTERM for the loop to heed when nothing is half done; a second one ends it at once.

    SIGTERM is what a machine that shuts down, or a batch system whose time is up, sends first. An exception in the
    middle may be lost: where C code calls back, it is printed and forgotten.
    """
    interrupts: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield interrupts
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def put_back() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(number: int, _: FrameType | None) -> None:
        interrupts.append(number)
        put_back()

    for number in before:
        signal.signal(number, note)
    try:
        yield interrupts
    finally:
        put_back()


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
    """Writes rows to the run's tables and to TensorBoard, and keeps the weights of the best evaluation.

    All of it is part of every checkpoint, and written anew when a run is resumed: whatever a killed process had logged
    beyond its last checkpoint, or half logged, is gone then.
    """

    def __init__(self, run: Run, config: TrainConfig) -> None:
        self._run, self._config = run, config
        self._tensorboard: TensorboardLogger | None = None
        self._best = (-1.0, -1.0)
        self._best_weights: dict[str, torch.Tensor] = {}
        self._best_since_saved = (-1.0, 0.0)
        self._rows: dict[str, list[dict[str, str]]] = {"train": [], "evaluation": []}

    def __enter__(self) -> _Logs:
        # TensorBoard writes in a thread of its own. What goes wrong there is told where the next row is logged, or at
        # the next checkpoint, and need not be printed with a traceback as well.
        hook = self._hook = threading.excepthook

        def told_elsewhere(failure: threading.ExceptHookArgs) -> None:
            if failure.exc_type is None or not issubclass(failure.exc_type, OSError):
                hook(failure)

        threading.excepthook = told_elsewhere
        return self

    def __exit__(self, *_: object) -> None:
        if self._tensorboard is not None:
            with suppress(OSError):
                self._tensorboard.experiment.close()
        threading.excepthook = self._hook

    def take_score(self) -> float:
        """What the best evaluation since the last call has told: success, then shorter paths; −1 where there was none.

        So of all checkpoints the best is one that the best evaluation is of, or else the next one after it.
        """
        success_rate, spl = self._best_since_saved
        self._best_since_saved = (-1.0, 0.0)
        return success_rate + 1e-6 * spl

    def begin(self, progress: TrainingProgress) -> None:
        """Makes the files hold what has been logged so far: nothing, in a new run.

        Raises:
            RunError: if they cannot be written.
        """
        self._run.metrics.replace(self._rows["train"])
        self._run.evaluations.replace(self._rows["evaluation"])
        if self._best_weights:
            self._run.save_policy("policy", self._best_weights)
        else:
            self._run.remove_policy("policy")
        if progress.step == 0:
            self._run.remove_policy("policy_last")
        begun = time.time() - progress.seconds
        with writing(self._run.directory / "tensorboard"):
            shutil.rmtree(self._run.directory / "tensorboard", ignore_errors=True)
            self._tensorboard = TensorboardLogger("tensorboard", log_dir=str(self._run.directory))
            for group, rows in self._rows.items():
                for row in rows:
                    self._curves(group, row, begun + float(row["seconds"]))
        self.flush()

    def metrics(self, row: dict[str, Any]) -> None:
        text = self._run.metrics.append(row)
        self._rows["train"].append(text)
        self._curves("train", text, time.time())

    def evaluation(self, result: Evaluation, learner: Learner, progress: TrainingProgress) -> None:
        row = {
            "step": progress.step,
            "seconds": progress.seconds,
            "processor_seconds": progress.processor_seconds,
            "world": self._config.eval_world,
            "success_rate": result.success_rate,
            "collision_rate": result.collision_rate,
            "timeout_rate": result.timeout_rate,
            "spl": result.spl,
            "reward": result.mean_reward,
            "steps": result.mean_steps,
        }
        text = self._run.evaluations.append(row)
        self._rows["evaluation"].append(text)
        self._curves("evaluation", text, time.time())
        score = (result.success_rate, result.spl)
        self._best_since_saved = max(self._best_since_saved, score)
        # At equal success the shorter paths win; at equal paths the later weights.
        if score >= self._best:
            self._best = score
            self._best_weights = {name: weight.clone() for name, weight in learner.actor.state_dict().items()}
            self._run.save_policy("policy", self._best_weights)

    def _curves(self, group: str, row: dict[str, str], when: float) -> None:
        assert self._tensorboard is not None
        with writing(self._run.directory / "tensorboard"):
            for name, value in row.items():
                if value and name not in ("step", "world"):
                    self._tensorboard.experiment.add_scalar(f"{group}/{name}", float(value), int(row["step"]), when)

    def flush(self) -> None:
        """Has TensorBoard's curves written.

        Raises:
            RunError: if they cannot be.
        """
        assert self._tensorboard is not None
        with writing(self._run.directory / "tensorboard"):
            self._tensorboard.experiment.flush()

    def state_dict(self) -> dict[str, Any]:
        return {
            "best": list(self._best),
            "weights": self._best_weights,
            "rows": self._rows,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        success_rate, spl = state_dict["best"]
        self._best = (success_rate, spl)
        self._best_weights, self._rows = state_dict["weights"], state_dict["rows"]


def _evaluate(learner: Learner, worlds: Sequence[World], config: TrainConfig) -> Evaluation:
    return evaluate_as_trained(learner.policy, config, worlds, seed=config.seed, num_paths=few_paths(worlds))


def _probe_states(worlds: Sequence[World], config: TrainConfig) -> TensorDictBase:
    """States met by random driving, the same for every run in the same worlds."""
    env = NavEnv(
        worlds,
        config.num_envs,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        sensor=config.sensor,
        frame_interval=config.frame_interval,
        surroundings="surroundings" in config.inputs,
        seed=0,
    )
    with torch.random.fork_rng():
        torch.manual_seed(0)
        steps = 4 * _PROBE_STATES // config.num_envs + 1
        visited = env.rollout(steps, break_when_any_done=False).select(*keys_of(config.inputs)).reshape(-1)
        return visited[torch.randperm(len(visited))[:_PROBE_STATES]].clone()


@torch.no_grad()
def _mean_max_q(learner: Learner, probe: TensorDictBase) -> float:
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return float(learner.actor(probe.copy())["action_value"].max(dim=-1).values.mean())
