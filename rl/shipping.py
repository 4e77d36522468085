"""Makes the policies that come with the library: the packed file, and a model card with what that file does."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.console import Console

from navsim.dynamics import dynamic_obstacles
from navsim.files import atomic_write
from navsim.sensor import SensorModel
from navsim.worldsource import TRAINING_SEED, have_rooms_in_common, worlds_from
from rl.ablations import UNSEEN_PATHS, UNSEEN_ROOMS, arguments_of
from rl.baselines import make_baseline
from rl.checkpoints import Checkpoints, step_of
from rl.config import TrainConfig
from rl.evaluation import evaluate_as_trained
from rl.metrics import Evaluation
from rl.pretrained import pack_policy, read_policy
from rl.run import FORMAT, Run, RunError
from rl.surroundings import STEPS

PLACES: tuple[tuple[str, str, int | None], ...] = (
    ("`complex_eval`", "complex_eval", None),
    ("`simple_eval`", "simple_eval", None),
    (f"200 generated rooms, `{UNSEEN_ROOMS}`", UNSEEN_ROOMS, UNSEEN_PATHS),
)
"""Where a policy is measured: what the card calls it, the world, and how many of its paths; None: all."""

_SEES = {
    "depth": "four depth images",
    "heading": "the goal's direction",
    "command": "its own command (v, ω)",
    "surroundings": "what it remembers of what stood around it (odometry)",
}


def ship(
    run: Run,
    directory: Path,
    name: str,
    *,
    weights: Literal["best", "last"] = "last",
    symmetric: bool | None = None,
    chosen: str = "",
    console: Console | None = None,
) -> Path:
    """Packs a run's policy as ``NAME.safetensors`` and writes its card, ``NAME.md``, from what the packed file does.

    Args:
        run: the run.
        directory: where both files go.
        name: of the policy.
        weights: the last ones of the run, which nothing was chosen by, or those that did best in its evaluations.
        symmetric: whether it is to be a symmetric policy; by default, as its settings have it.
        chosen: a sentence for the card on how this run was chosen among others; readers may reckon with it.
        console: where progress is shown; nowhere by default.

    Returns:
        the card.

    Raises:
        RunError: for a run that lacks its weights, or has not been evaluated yet, or is too large to ship, or is of an
            earlier version.
    """
    if run.format < FORMAT:
        raise RunError(
            f"{run.directory} was written by an earlier version of navsim-rl, whose logs lack what the card tells of"
        )
    if not run.evaluations.rows():
        raise RunError(
            f"{run.directory} has no evaluation yet, which the card tells of; train on (navsim train --resume)"
        )
    with TemporaryDirectory() as elsewhere:  # an interrupted measurement leaves old weights with their card
        trial = Path(elsewhere) / f"{name}.safetensors"
        learnt = _learnt(run, weights)
        pack_policy(run, trial, weights=weights, symmetric=symmetric)
        policy, config = read_policy(trial)
        packed = trial.read_bytes()  # a run that trains on writes other weights meanwhile
    reactive = make_baseline("reactive", config.camera, config.sensor, config.robot)
    results = []
    for place, world, paths in PLACES:
        own, beside = (
            evaluate_as_trained(driver, config, world, num_paths=paths, console=console)
            for driver in (policy, reactive)
        )
        results.append((place, own, beside))
    card, text = directory / f"{name}.md", _card(run, name, config, learnt, results, chosen)
    with atomic_write(directory / f"{name}.safetensors", "wb") as file:
        file.write(packed)
    with atomic_write(card) as file:
        file.write(text)
    return card


class _Learnt(NamedTuple):
    """How far a run's weights are."""

    what: str
    steps: int
    processor_seconds: float


def _learnt(run: Run, weights: Literal["best", "last"]) -> _Learnt:
    evaluations = run.evaluations.rows()
    if weights == "best":  # the first of several
        best = max(evaluations, key=lambda row: (float(row["success_rate"]), float(row["spl"])))
        what = f"those that did best in `{run.config.eval_world}` during the run"
        return _Learnt(what, int(best["step"]), float(best["processor_seconds"]))
    checkpoints = Checkpoints(run.directory / "checkpoints", {}).paths()
    steps = step_of(checkpoints[-1]) if checkpoints else int(evaluations[-1]["step"])
    logged = (*run.metrics.rows(), *evaluations)
    spent = [float(row["processor_seconds"]) for row in logged if int(row["step"]) <= steps]
    return _Learnt("the last of the run", steps, max(spent, default=0.0))


def _card(
    run: Run,
    name: str,
    config: TrainConfig,
    learnt: _Learnt,
    results: list[tuple[str, Evaluation, Evaluation]],
    chosen: str,
) -> str:
    drawn = config.randomization
    ideal = config.sensor == SensorModel() and drawn.latency == (0, 0)
    seen = [_SEES[one] for one in config.inputs]
    own = run.with_its_worlds(run.config)  # the packed ones have file names only
    seed = TRAINING_SEED + config.seed
    rooms = worlds_from(own.world, default_seed=seed)
    sizes = sorted({world.size for world in rooms}, key=math.prod)
    trained_in = [place for place, world, _ in PLACES if have_rooms_in_common(own.world, [world], seed)]
    environment = Environment(
        loader=PackageLoader("rl", "."), undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False
    )
    return environment.get_template("card.md.jinja").render(
        name=name,
        config=config,
        sees=_listed(seen),
        sizes=" to ".join(f"{width:g} x {depth:g} m" for width, depth in dict.fromkeys((sizes[0], sizes[-1]))),
        still=not any(dynamic_obstacles(world) for world in rooms),
        trained_in=_listed(trained_in),
        exact_wheels=drawn.wheel_speed_error == (0.0, 0.0),
        command=f"navsim train {shlex.join(arguments_of(config))}",
        steps=learnt.steps,
        robot_hours=learnt.steps * config.task.control_period / 3600.0,
        minutes=learnt.processor_seconds / 60.0,
        processor=run.processor,
        weights=learnt.what,
        chosen=chosen,
        sensor="an ideal depth sensor" if ideal else "a depth sensor that errs",
        ideal=ideal,
        memory_seconds=STEPS * config.task.control_period,
        results=results,
    )


def _listed(names: Sequence[str]) -> str:
    """Names as a sentence lists them; "" for none."""
    return " and ".join([*([", ".join(names[:-1])] if names[1:] else []), *names[-1:]])
