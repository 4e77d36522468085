"""What becomes of a run that has come to its end; the whole line is in test_cli.py."""

from __future__ import annotations

import pytest
import torch
from rich.console import Console
from small_runs import tiny_config

import rl.finish
from rl.baselines import BASELINES, make_baseline
from rl.evaluation import evaluate
from rl.learner import make_actor
from rl.run import Run


class EnoughError(Exception):
    """Ends what is not looked at."""


def test_a_finished_run_is_evaluated_with_its_own_seed_and_settings(tmp_path, monkeypatch):
    run = Run.create(tiny_config(tmp_path / "run", seed=7))
    torch.manual_seed(0)
    for name in ("policy", "policy_last"):
        run.save_policy(name, make_actor(run.config).state_dict())
    told = {}

    def note(policy, config, worlds, **settings):
        told.update(settings, config=config, worlds=[world.name for world in worlds])
        raise EnoughError

    monkeypatch.setattr(rl.finish, "evaluate_as_trained", note)
    with pytest.raises(EnoughError):
        rl.finish.finish(run, Console(quiet=True))
    assert (told["seed"], told["name"], told["config"]) == (7, "D3QN-I", run.config)
    assert told["worlds"] == ["hall"]


@pytest.mark.parametrize("differ", [True, False])
def test_last_weights_stand_beside_the_best_where_they_are_others(tmp_path, monkeypatch, differ):
    run = Run.create(tiny_config(tmp_path / "run"))
    for name in ("policy_last", "policy"):
        torch.manual_seed(int(differ and name == "policy"))
        run.save_policy(name, make_actor(run.config).state_dict())
    driven = {}

    def drive(policy, config, worlds, *, name, **settings):
        driven[name] = policy
        return evaluate(make_baseline("straight"), "simple_eval", name=name, num_paths=1)

    monkeypatch.setattr(rl.finish, "evaluate_as_trained", drive)
    monkeypatch.setattr(rl.finish, "write_report", lambda run: tmp_path)
    rl.finish.finish(run, Console(quiet=True))
    assert list(driven) == ["D3QN-I", *(["D3QN-I last"] if differ else []), *BASELINES]
    assert {path.stem for path in (run.directory / "evaluation").glob("*.json")} == set(driven)
    for name, weights in (("D3QN-I", "policy"), ("D3QN-I last", "policy_last"))[: 1 + differ]:
        saved = torch.load(run.directory / f"{weights}.pt", weights_only=True)
        assert all(torch.equal(saved[key], value) for key, value in driven[name].state_dict().items())
