"""Policies that come with the library: weights, and the settings that they were trained with, in one file each.

The files lie in ``rl/pretrained_policies``: ``NAME.safetensors`` (nothing in such a file is ever executed), weights in
half precision, settings as JSON in its header; and beside it ``NAME.md``, its model card.
"""

from __future__ import annotations

import difflib
import json
from pathlib import Path
from typing import Literal

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torchrl.modules import QValueActor

from navsim.files import atomic_write
from navsim.worldsource import is_generated
from rl.config import TrainConfig
from rl.learner import make_actor, policy_of, shapes_of_weights
from rl.run import POLICY_FILES, Run, RunError
from rl.weights import misfit

PREFIX = "pretrained:"
"""What a policy's name begins with that comes with the library."""
LARGEST_FILE = 4 * 2**20
"""Bytes that a packed policy may have: it travels inside the wheel."""

DIRECTORY = Path(__file__).parent / "pretrained_policies"


def pretrained_policies() -> list[str]:
    """Names of the policies that come with the library, as they follow ``pretrained:``."""
    return sorted(path.stem for path in DIRECTORY.glob("*.safetensors"))


def load_pretrained(name: str) -> tuple[QValueActor, TrainConfig]:
    """A policy that comes with the library, acting greedily, and the settings that it was trained with.

    Args:
        name: one of ``pretrained_policies()``, with or without ``pretrained:`` before it.

    Raises:
        RunError: for a name that there is not.
    """
    name = name.removeprefix(PREFIX)
    known = pretrained_policies()
    if name not in known:
        by_letters = {one.casefold(): one for one in known}
        meant = difflib.get_close_matches(name.casefold(), by_letters, n=1, cutoff=0.4)
        others = f"there are: {', '.join(known)}" if known else "this version has none: name a run's directory"
        remedy = f'did you mean "{PREFIX}{by_letters[meant[0]]}"?' if meant else others
        raise RunError(f'no policy "{PREFIX}{name}" comes with the library; {remedy}')
    return read_policy(DIRECTORY / f"{name}.safetensors")


def pack_policy(
    run: Run, path: Path, *, weights: Literal["best", "last"] = "best", symmetric: bool | None = None
) -> None:
    """Writes a run's policy as one file, in half precision.

    Args:
        run: a run that has been evaluated.
        path: to write; it appears when it is complete.
        weights: those that did best in the run's evaluations, or the last.
        symmetric: whether it is to be a symmetric policy; by default, as its settings have it. Training is the same.

    Raises:
        RunError: for a run that lacks its weights, or whose packed weights exceed ``LARGEST_FILE``.
    """
    halved = {name: weight.half().contiguous() for name, weight in run.load_policy(POLICY_FILES[weights]).items()}
    size = sum(weight.numel() * weight.element_size() for weight in halved.values())
    if size > LARGEST_FILE:
        raise RunError(f"{run.directory}: the packed policy has {size / 2**20:.1f} MiB, more than the 4 MiB allowed")
    config = run.config
    names = {
        source: source if is_generated(source) else Path(source).name for source in (*config.world, config.eval_world)
    }
    settings = config.to_dict() | {  # on whose disk it was trained is nobody's business
        "out": None,
        "world": [names[source] for source in config.world],
        "eval_world": names[config.eval_world],
        "symmetric": config.symmetric if symmetric is None else symmetric,
    }
    with atomic_write(path, "wb") as file:
        file.write(save(halved, metadata={"format": "1", "settings": json.dumps(settings)}))


def read_policy(path: Path) -> tuple[QValueActor, TrainConfig]:
    """The policy that :func:`pack_policy` wrote, acting greedily in single precision, and its settings.

    Raises:
        RunError: for a file that is missing, damaged, or not such a file.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            weights = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118 - not a dict
    except (OSError, SafetensorError) as error:
        raise RunError(f"{path} cannot be read as a packed policy: {error}") from error
    if metadata.get("format") != "1" or "settings" not in metadata:
        raise RunError(f"{path} holds no packed policy of format 1: it was not written by pack_policy")
    try:
        config = TrainConfig.from_dict(json.loads(metadata["settings"]))
    except (ValueError, TypeError, RecursionError) as error:
        raise RunError(f"{path} holds settings that cannot be used: {error}") from error
    reason = misfit(shapes_of_weights(config), weights)
    if reason:
        raise RunError(f"{path} holds weights that do not fit its settings: {reason}")
    actor = make_actor(config)
    actor.load_state_dict(weights)
    policy = policy_of(actor.eval(), config)
    policy.trained_as = config
    return policy, config
