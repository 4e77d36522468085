"""What becomes of a run that has come to its end; the whole line is in test_cli.py."""

from __future__ import annotations

import pytest
import torch
from rich.console import Console
from small_runs import tiny_config

import rl.finish
from rl.learner import make_actor
from rl.run import Run


class EnoughError(Exception):
    """Ends what is not looked at."""


def test_a_finished_run_is_evaluated_with_its_own_seed_and_settings(tmp_path, monkeypatch):
    run = Run.create(tiny_config(tmp_path / "run", seed=7))
    torch.manual_seed(0)
    run.save_policy("policy", make_actor(run.config).state_dict())
    told = {}

    def note(policy, config, worlds, **settings):
        told.update(settings, config=config, worlds=[world.name for world in worlds])
        raise EnoughError

    monkeypatch.setattr(rl.finish, "evaluate_as_trained", note)
    with pytest.raises(EnoughError):
        rl.finish.finish(run, Console(quiet=True))
    assert (told["seed"], told["name"], told["config"]) == (7, "D3QN-I", run.config)
    assert told["worlds"] == ["hall"]
