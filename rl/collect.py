"""Environments and TorchRL collectors from a run's settings."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.modules import EGreedyModule

from navsim.rearrange import rearrange
from navsim.world import World
from navsim.worldsource import TRAINING_SEED, is_generated, worlds_from
from rl.background import COLLECTOR_SETTINGS, BackgroundCollector, PersistentCollector
from rl.config import TrainConfig
from rl.env import NavEnv


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
        task=config.training_task,
        robot=config.training_robot,
        sensor=config.sensor,
        randomization=config.randomization,
        frame_interval=config.frame_interval,
        surroundings="surroundings" in config.inputs,
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
    env: NavEnv,
    policy: TensorDictModuleBase,
    config: TrainConfig,
    *,
    total_steps: int,
    seed: int | None = None,
    replaced: Callable[[str], None] = lambda _: None,
) -> ResumableCollector | PersistentCollector:
    """A collector of batches ``(N, T)`` of ``config.steps_per_batch`` transitions.

    Args:
        env: the environment. An asynchronous collector makes another one in its own process, in the same worlds.
        policy: the exploring policy.
        config: the run's settings; ``config.collector`` chooses the kind.
        total_steps: transitions to collect before it ends, rounded up to whole batches.
        seed: of an asynchronous collector's environment and random actions; the settings' own by default.
        replaced: is told when the process of an asynchronous collector has failed and another one has taken its place,
            and its robots have begun new episodes.

    Raises:
        CollectorError: if the process of an asynchronous collector does not come to work.
    """
    total_frames = math.ceil(total_steps / config.steps_per_batch) * config.steps_per_batch
    if config.collector == "sync":
        return ResumableCollector(
            env, policy, frames_per_batch=config.steps_per_batch, total_frames=total_frames, **COLLECTOR_SETTINGS
        )

    def start(seed: int, frames: int) -> BackgroundCollector:
        return BackgroundCollector(
            env,
            policy,
            seed=seed,
            frames_per_batch=config.steps_per_batch,
            total_frames=frames,
            timeout=config.worker_timeout,
        )

    return PersistentCollector(
        start, seed=config.seed if seed is None else seed, total_frames=total_frames, replaced=replaced
    )


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
            environment=self.env.state_dict(),
            perceived=dict(self._carrier.flatten_keys(".").items()),
        )

    def load_state_dict(self, state_dict: OrderedDict, **kwargs: Any) -> None:
        """Goes on from ``state_dict``."""
        self._frames, self._iter = state_dict["frames"], state_dict["iter"]
        self.env.load_state_dict(state_dict["environment"])
        perceived = TensorDict(state_dict["perceived"], self.env.batch_size, device=self._carrier.device)
        self._carrier = perceived.unflatten_keys(".").clone()
