"""Environments and TorchRL collectors from a run's settings."""

from __future__ import annotations

import math

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import BaseCollector, Collector
from torchrl.modules import EGreedyModule

from navsim.rearrange import rearrange
from navsim.world import World
from navsim.worldsource import TRAINING_SEED, is_generated, worlds_from
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
    env: NavEnv, policy: TensorDictModuleBase, config: TrainConfig, *, total_steps: int
) -> BaseCollector:
    """An in-process collector of batches ``(N, T)`` of ``config.steps_per_batch`` transitions.

    Args:
        env: the environment.
        policy: the exploring policy.
        config: the run's settings.
        total_steps: transitions to collect before it ends, rounded up to whole batches.
    """
    batches = math.ceil(total_steps / config.steps_per_batch)
    return Collector(
        env,
        policy,
        frames_per_batch=config.steps_per_batch,
        total_frames=batches * config.steps_per_batch,
        track_traj_ids=False,
        use_buffers=False,
        auto_register_policy_transforms=False,
    )
