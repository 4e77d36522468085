"""Policies by name: what a run has learnt, and the baselines."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import Literal

from torchrl.modules import QValueActor

from rl.baselines import BASELINES, Baseline, make_baseline
from rl.config import TrainConfig
from rl.learner import make_actor, policy_of, shapes_of_weights
from rl.pretrained import PREFIX, load_pretrained, pretrained_policies
from rl.run import POLICY_FILES, Run, RunError
from rl.weights import misfit

Weights = Literal["best", "last"]


def find_policy(
    name: str, *, weights: Weights = "best", symmetric: bool | None = None
) -> tuple[QValueActor | Baseline, TrainConfig]:
    """A policy, and the settings whose camera, task and robot it is for.

    Args:
        name: a run's directory, ``pretrained:NAME`` for a policy that comes with the library, or one of
            ``rl.baselines.BASELINES``.
        weights: of a run: those that did best in its evaluations, or the last.
        symmetric: whether it goes by the mean of its values for what it sees and for the mirror image of that, see
            ``rl.networks.symmetric_policy``; None: as its settings say.

    Raises:
        RunError: if it is none of them, or a run that cannot be used; for last weights of what is no run, and symmetry,
            or its absence, of what is no network.
    """
    if weights != "best" and (name.startswith(PREFIX) or name in BASELINES):
        raise _no_last_weights(name)
    if name.startswith(PREFIX):
        policy, config = load_pretrained(name)
        return _symmetric(policy, config, symmetric), config
    if name in BASELINES:
        if symmetric is not None:
            raise RunError(f"{name} is a baseline, which has no network to ask twice: leave --symmetric out")
        config = TrainConfig()
        return make_baseline(name, config.camera), config
    if not Run(name).exists:
        shipped = pretrained_policies()
        runs = [str(path) for path in Path(name).parent.glob("*") if Run(path).exists]
        meant = difflib.get_close_matches(name, [*BASELINES, *shipped, *runs], n=1)
        if meant:
            remedy = f'did you mean "{PREFIX if meant[0] in shipped else ""}{meant[0]}"?'
        else:
            known = ", ".join([*(PREFIX + one for one in shipped), *BASELINES])
            remedy = f"name one, or a policy that comes with the library: {known}"
        raise RunError(f"{name} is not a run's directory; {remedy}")
    return load_policy(name, weights=weights, symmetric=symmetric), Run(name).config


def load_policy(
    run: str | os.PathLike[str], *, weights: Weights = "best", symmetric: bool | None = None
) -> QValueActor:
    """The policy that a run has learnt, acting greedily.

    It reads what its ``in_keys`` name: ``depth`` uint8 ``(..., 4, H, W)``, images of the size that it was trained with,
    and ``heading`` float32 ``(..., 1)``; if it sees them, ``command`` float32 ``(..., 2)`` and ``surroundings`` float32
    ``(..., 36)``, which ``NavEnv(..., surroundings=True)`` tells. It writes ``action``, ``action_value`` and
    ``chosen_action_value``. Nothing in the run's files is executed.

    Its attribute ``trained_as`` are the settings that it was trained with, whose camera, task, robot, sensor and frame
    interval ``rl.evaluate`` takes unless told otherwise.

    Args:
        run: the directory that ``navsim train`` wrote, or ``pretrained:NAME`` for a policy that comes with the library.
        weights: of a run: those that did best in its evaluations, or the last.
        symmetric: as for ``find_policy``.

    Raises:
        RunError: for a directory without a run, for last weights of what is no run, and for files that are missing,
            damaged or do not fit together, or for a symmetric policy whose camera sits to one side.
    """
    if str(run).startswith(PREFIX):
        if weights != "best":
            raise _no_last_weights(str(run))
        policy, config = load_pretrained(str(run))
        return _symmetric(policy, config, symmetric)
    opened = Run.open(Path(run))
    config = opened.config
    name = POLICY_FILES[weights]
    found = opened.load_policy(name)
    reason = misfit(shapes_of_weights(config), found)
    if reason:
        raise RunError(
            f"{opened.directory / name}.pt does not fit config.json beside it (model {config.model}, images of "
            f"{config.camera.width}x{config.camera.height}): {reason}; restore the file that belongs to the run"
        )
    actor = make_actor(config)
    actor.load_state_dict(found)
    policy = _symmetric(policy_of(actor.eval(), config), config, symmetric)
    policy.trained_as = config
    return policy


def _no_last_weights(name: str) -> RunError:
    return RunError(f"{name} is no run, which alone has last weights beside the best")


def _symmetric(policy: QValueActor, config: TrainConfig, wanted: bool | None) -> QValueActor:
    if wanted and config.sees_to_one_side:
        raise RunError(
            f"the camera is more to one side (camera.mount_y {config.camera.mount_y:g}, randomization.camera_left "
            f"{config.randomization.camera_left}), so that a mirror image is not what this robot sees: it cannot be "
            "symmetric"
        )
    if wanted is not None:
        policy.module[0].module.symmetric = wanted
    return policy
