"""Environments and TorchRL collectors from a run's settings."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import signal
import traceback
from collections import OrderedDict
from collections.abc import Iterator
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch.utils._pytree import tree_map
from torchrl.collectors import AsyncCollector, BaseCollector, Collector
from torchrl.modules import EGreedyModule
from torchrl.weight_update import SharedMemWeightSyncScheme

from navsim.rearrange import rearrange
from navsim.world import World
from navsim.worldsource import TRAINING_SEED, is_generated, worlds_from
from rl.config import TrainConfig
from rl.env import NavEnv
from rl.memory import keep_freed_memory


def make_env(config: TrainConfig, *, seed: int | None = None) -> NavEnv:
    """The training environment of a run.

    Args:
        config: the run's settings.
        seed: in place of the settings' own.

    Raises:
        navsim.WorldError: for a world file that cannot be used.
    """
    return NavEnv(
        training_worlds(config),
        config.num_envs,
        camera=config.camera,
        task=config.task,
        robot=config.robot,
        sensor=config.sensor,
        randomization=config.randomization,
        seed=config.seed if seed is None else seed,
    )


def training_worlds(config: TrainConfig) -> list[World]:
    """The worlds to train in.

    With ``random_paths``, listed starts and goals are replaced by drawn ones; with ``rearrangements``, the world of
    each file is followed by so many that hold its furniture in other places, the same for the same seed. Generated
    rooms whose source names no seed are those of ``TRAINING_SEED`` and the run's seed together.
    """
    generators = np.random.default_rng(config.seed).spawn(len(config.world))
    rooms: list[World] = []
    for source, generator in zip(config.world, generators, strict=True):
        worlds = worlds_from(source, default_seed=TRAINING_SEED + config.seed)
        if config.random_paths:
            worlds = [world.model_copy(update={"starts": "random", "goals": "random"}) for world in worlds]
        rooms += worlds
        if not is_generated(source):
            rooms += rearrange(worlds[0], config.rearrangements, generator)
    return rooms


def explorer(actor: TensorDictModuleBase, env: NavEnv, config: TrainConfig) -> TensorDictSequential:
    """The policy that collects: greedy, but for a share of random actions.

    That share, ``eps`` of the last module, falls with every ``step`` of that module, once a batch. It is a number for
    each robot, ``(N,)``: with ``epsilon_least``, their descents end at different shares (Horgan et al. 2018, Ape-X,
    arXiv 1803.00933).
    """
    last = torch.full((config.num_envs,), config.epsilon_end)
    if config.epsilon_least is not None:
        last = torch.logspace(math.log10(config.epsilon_end), math.log10(config.epsilon_least), config.num_envs)
    exploration = EGreedyModule(
        env.action_spec,
        eps_init=float(config.epsilon_start),
        eps_end=float(config.epsilon_end),
        annealing_num_steps=max(1, round(config.epsilon_steps / config.steps_per_batch)),
    )
    exploration.eps_end = last
    exploration.eps_init = torch.full_like(last, config.epsilon_start)
    exploration.eps = exploration.eps_init.clone()
    return TensorDictSequential(actor, exploration)


def make_collector(
    env: NavEnv, policy: TensorDictModuleBase, config: TrainConfig, *, total_steps: int, seed: int | None = None
) -> BaseCollector:
    """A collector of batches ``(N, T)`` of ``config.steps_per_batch`` transitions.

    Args:
        env: the environment. An asynchronous collector makes another one in its own process, in the same worlds.
        policy: the exploring policy.
        config: the run's settings; ``config.collector`` chooses the kind.
        total_steps: transitions to collect before it ends, rounded up to whole batches.
        seed: of an asynchronous collector's environment and random actions; the settings' own by default.
    """
    frames = {
        "frames_per_batch": config.steps_per_batch,
        "total_frames": math.ceil(total_steps / config.steps_per_batch) * config.steps_per_batch,
    }
    if config.collector == "async":
        return BackgroundCollector(env, policy, seed=config.seed if seed is None else seed, **frames)
    return ResumableCollector(env, policy, **frames, **_COLLECTOR_SETTINGS)


_COLLECTOR_SETTINGS = {"track_traj_ids": False, "use_buffers": False, "auto_register_policy_transforms": False}


class ResumableCollector(Collector):
    """TorchRL's ``Collector`` over a ``NavEnv``, which goes on from a checkpoint as if nothing had happened.

    TorchRL's own ``state_dict`` leaves out the environment and the observation that the next action is for, because not
    every environment can tell its state; this one can. The policy is left out here, as it is saved elsewhere.
    """

    _carrier: TensorDictBase

    def state_dict(self) -> OrderedDict:
        """Counters, the environment's state, and what the robots perceive; tensors and plain values only."""
        return OrderedDict(
            frames=self._frames,
            iter=self._iter,
            environment=tree_map(_as_tensor, self.env.state_dict()),
            perceived=dict(self._carrier.flatten_keys(".").items()),
        )

    def load_state_dict(self, state_dict: OrderedDict, **kwargs: Any) -> None:
        """Goes on from ``state_dict``."""
        self._frames, self._iter = state_dict["frames"], state_dict["iter"]
        environment = state_dict["environment"]
        simulator = tree_map(_as_array, environment["simulator"])
        self.env.load_state_dict(environment | {"simulator": simulator})
        perceived = TensorDict(state_dict["perceived"], self.env.batch_size, device=self._carrier.device)
        self._carrier = perceived.unflatten_keys(".").clone()


def _as_tensor(value: Any) -> Any:
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else value


def _as_array(value: Any) -> Any:
    return value.numpy() if isinstance(value, torch.Tensor) else value


class CollectorError(RuntimeError):
    """The collecting process has come to an end that it should not have."""


class BackgroundCollector(AsyncCollector):
    """TorchRL's ``AsyncCollector``: one process that simulates the next batch while the learner works on the last one.

    Back-pressure goes both ways: the process waits when the learner has not taken its batch yet, so it is never more
    than two batches ahead, and the learner waits for batches, so that the ratio of updates to transitions is kept
    whatever their speeds. Policy and shares of random actions are those of the last ``update_policy_weights_``, which
    writes them where the process reads them.

    What is different from TorchRL's: an exception in the process is told here, with its traceback, as well as its death
    at any other hands; and Ctrl-C, which a terminal sends to every process, is left to the learner to heed.

    Args:
        env: whose worlds, robots and sensors the process's own environment has.
        policy: the exploring policy.
        seed: of the process's environment and random actions.
        frames_per_batch: transitions in a batch.
        total_frames: transitions in all.
    """

    def __init__(
        self, env: NavEnv, policy: TensorDictModuleBase, *, seed: int, frames_per_batch: int, total_frames: int
    ) -> None:
        threads = torch.get_num_threads()
        context = multiprocessing.get_context("spawn")
        self._failures, failures = context.Pipe(duplex=False)
        simulator = env.simulator
        super().__init__(
            partial(
                NavEnv,
                simulator.worlds,
                simulator.num_robots,
                camera=simulator.camera,
                task=simulator.task,
                robot=simulator.robot,
                seed=seed,
            ),
            policy,
            frames_per_batch=frames_per_batch,
            total_frames=total_frames,
            num_threads=threads,
            collector_class=partial(_WorkerCollector, failures=failures, seed=seed),
            auto_register_policy_transforms=False,
            weight_sync_schemes={"policy": SharedMemWeightSyncScheme(sync=False)},
        )
        failures.close()

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches, in the order in which they were collected.

        Raises:
            CollectorError: if the process has ended.
        """
        try:
            yield from super().iterator()
        except RuntimeError as error:
            raise CollectorError(self._obituary()) from error

    def _obituary(self) -> str:
        with contextlib.suppress(EOFError, OSError):
            if self._failures.poll(1.0):
                return f"the collecting process failed:\n{self._failures.recv()}"
        (process,) = self.procs
        code = None if process._closed else process.exitcode
        how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
        return f"the collecting process ended {how}, without saying why; was it killed, or the memory exhausted?"


class _WorkerCollector(Collector):
    """The collector inside a ``BackgroundCollector``'s process."""

    def __init__(self, *args: Any, failures: Connection, seed: int, **settings: Any) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        keep_freed_memory()
        torch.manual_seed(seed)
        self._failures = failures
        super().__init__(*args, **{**settings, **_COLLECTOR_SETTINGS})

    def rollout(self) -> TensorDictBase:
        try:
            return super().rollout()
        except Exception:
            self._failures.send(traceback.format_exc())
            raise
