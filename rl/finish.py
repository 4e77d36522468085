"""The end of a run: its best policy beside the baselines in a room that it has never seen, and the report on it all.

The best weights are those of the best of the evaluations on the way, which drive the same paths. So the last weights,
which nothing was chosen by, stand beside them.
"""

from __future__ import annotations

from pathlib import Path

import torch
from rich.console import Console
from torchrl.modules import QValueActor

from navsim.worldsource import worlds_from
from rl.baselines import BASELINES, Baseline, make_baseline
from rl.evaluation import evaluate_as_trained
from rl.metrics import comparison_table
from rl.paths import few_paths
from rl.policies import load_policy
from rl.report import LAST_WEIGHTS, write_report
from rl.run import Run


def finish(run: Run, console: Console) -> Path:
    """Evaluates a run's best policy and the baselines, stores and prints what came out, and writes the report.

    Args:
        run: a run that has been evaluated at least once.
        console: where progress and results are shown.

    Returns:
        the report's path.

    Raises:
        RunError: for a run that lacks files.
        navsim.WorldError: for a world file that cannot be used.
    """
    config = run.config
    worlds = worlds_from(run.with_its_worlds(config).eval_world)
    own, last = f"D3QN-{config.model}", load_policy(run.directory, weights="last")
    best = load_policy(run.directory)
    policies: dict[str, QValueActor | Baseline] = {own: best}
    if not _are_the_same(best, last):
        policies[f"{own}{LAST_WEIGHTS}"] = last
    policies |= {name: make_baseline(name, config.camera, config.sensor, config.robot) for name in BASELINES}
    evaluations = []
    for name, policy in policies.items():
        result = evaluate_as_trained(
            policy, config, worlds, name=name, seed=config.seed, num_paths=few_paths(worlds), console=console
        )
        result.save(run.directory / "evaluation" / f"{name}.json")
        evaluations.append(result)
    console.print(comparison_table(evaluations))
    with console.status("writing the report"):
        report = write_report(run)
    console.print(f"report: {report}", markup=False)
    return report


def _are_the_same(policy: QValueActor, other: QValueActor) -> bool:
    weights, others = policy.state_dict(), other.state_dict()
    return all(torch.equal(weights[name], others[name]) for name in weights)
