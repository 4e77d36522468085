"""Policies by name: what a run has learnt, and the baselines."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

import torch
from torchrl.modules import QValueActor

from rl.baselines import BASELINES, Baseline, make_baseline
from rl.config import TrainConfig
from rl.learner import make_actor
from rl.run import Run, RunError


def find_policy(name: str) -> tuple[QValueActor | Baseline, TrainConfig]:
    """A policy, and the settings whose camera, task and robot it is for.

    Args:
        name: a run's directory, or one of ``rl.baselines.BASELINES``.

    Raises:
        RunError: if it is neither, or a run that cannot be used.
    """
    if name in BASELINES:
        config = TrainConfig()
        return make_baseline(name, config.camera), config
    if not Run(name).exists:
        meant = difflib.get_close_matches(name, BASELINES, n=1)
        remedy = f'did you mean "{meant[0]}"?' if meant else f"name one, or a baseline: {', '.join(BASELINES)}"
        raise RunError(f"{name} is not a run's directory; {remedy}")
    return load_policy(name), Run(name).config


def load_policy(run_directory: str | os.PathLike[str]) -> QValueActor:
    """The policy that a run ended with: the weights that did best in its evaluations, acting greedily.

    It reads ``depth`` uint8 ``(..., 4, H, W)`` and ``heading`` float32 ``(..., 1)``, images of the size that it was
    trained with, and writes ``action``, ``action_value`` and ``chosen_action_value``. Nothing in the run's files is
    executed.

    Args:
        run_directory: what ``navsim train`` wrote.

    Raises:
        RunError: for a directory without a run, and for files that are missing, damaged or do not fit together.
    """
    run = Run.open(Path(run_directory))
    config = run.config
    actor = make_actor(config)
    weights = run.load_policy("policy")
    misfit = _misfit(actor.state_dict(), weights)
    if misfit:
        raise RunError(
            f"{run.directory / 'policy.pt'} does not fit config.json beside it (model {config.model}, images of "
            f"{config.camera.width}x{config.camera.height}): {misfit}; restore the file that belongs to the run"
        )
    actor.load_state_dict(weights)
    return actor.eval()


def _misfit(wanted: dict[str, torch.Tensor], found: object) -> str:
    """The first thing that is wrong with ``found`` as the weights ``wanted``; empty where nothing is."""
    if not isinstance(found, dict):
        return f"it holds a {type(found).__name__}, not weights by name"
    for name, weight in wanted.items():
        if not isinstance(found.get(name), torch.Tensor):
            return f'weight "{name}" is missing'
        if found[name].shape != weight.shape:
            return f'weight "{name}" has shape {tuple(found[name].shape)}, not {tuple(weight.shape)}'
    unknown = [name for name in found if name not in wanted]
    return f'weight "{unknown[0]}" is unknown' if unknown else ""
