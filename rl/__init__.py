"""Deep Q-learning for ``navsim``, on TorchRL: environment, networks, loss, replay, training, evaluation, report."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rl.baselines import make_baseline
    from rl.collect import make_env
    from rl.config import PRESETS, TrainConfig
    from rl.env import NavEnv
    from rl.evaluation import evaluate
    from rl.loss import D3QNLoss
    from rl.metrics import Evaluation
    from rl.networks import make_q_actor, symmetric_policy
    from rl.pilot import Pilot
    from rl.policies import load_policy
    from rl.replay import make_replay
    from rl.run import RunError

__all__ = [
    "PRESETS",
    "D3QNLoss",
    "Evaluation",
    "NavEnv",
    "Pilot",
    "RunError",
    "TrainConfig",
    "evaluate",
    "load_policy",
    "make_baseline",
    "make_env",
    "make_q_actor",
    "make_replay",
    "symmetric_policy",
]

_MODULES = {
    "PRESETS": "rl.config",
    "D3QNLoss": "rl.loss",
    "Evaluation": "rl.metrics",
    "NavEnv": "rl.env",
    "Pilot": "rl.pilot",
    "RunError": "rl.run",
    "TrainConfig": "rl.config",
    "evaluate": "rl.evaluation",
    "load_policy": "rl.policies",
    "make_baseline": "rl.baselines",
    "make_env": "rl.collect",
    "make_q_actor": "rl.networks",
    "make_replay": "rl.replay",
    "symmetric_policy": "rl.networks",
}


def __getattr__(name: str) -> Any:
    """Imports what is asked for: torch takes seconds to import, and ``navsim --help`` does without it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(importlib.import_module(_MODULES[name]), name)
    return value
