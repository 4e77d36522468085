"""Makes the policies that come with the library: the packed file, and a model card with what that file does."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.console import Console

from navsim.dynamics import dynamic_obstacles
from navsim.files import atomic_write
from navsim.sensor import SensorModel
from navsim.worldsource import TRAINING_SEED, have_rooms_in_common, worlds_from
from rl.ablations import UNSEEN_PATHS, UNSEEN_ROOMS, arguments_of
from rl.baselines import make_baseline
from rl.config import TrainConfig
from rl.evaluation import evaluate_as_trained
from rl.metrics import Evaluation
from rl.pretrained import pack_policy, read_policy
from rl.run import Run, RunError

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
    console: Console | None = None,
) -> Path:
    """Packs a run's policy as ``NAME.safetensors`` and writes its card, ``NAME.md``, from what the packed file does.

    Args:
        run: the run.
        directory: where both files go.
        name: of the policy.
        weights: the last ones of the run, which nothing was chosen by, or those that did best in its evaluations.
        console: where progress is shown; nowhere by default.

    Returns:
        the card.

    Raises:
        RunError: for a run that lacks its weights, or has not been evaluated yet, or is too large to ship.
    """
    if not run.evaluations.rows():
        raise RunError(
            f"{run.directory} has no evaluation yet, which the card tells of; train on (navsim train --resume)"
        )
    with TemporaryDirectory() as elsewhere:  # an interrupted measurement leaves old weights with their card
        trial = Path(elsewhere) / f"{name}.safetensors"
        pack_policy(run, trial, weights=weights)
        policy, config = read_policy(trial)
    reactive = make_baseline("reactive", config.camera, config.sensor)
    results = []
    for place, world, paths in PLACES:
        own, beside = (
            evaluate_as_trained(driver, config, world, num_paths=paths, console=console)
            for driver in (policy, reactive)
        )
        results.append((place, own, beside))
    card, text = directory / f"{name}.md", _card(run, name, config, weights, results)
    pack_policy(run, directory / f"{name}.safetensors", weights=weights)
    with atomic_write(card) as file:
        file.write(text)
    return card


def _card(
    run: Run, name: str, config: TrainConfig, weights: str, results: list[tuple[str, Evaluation, Evaluation]]
) -> str:
    last = run.evaluations.rows()[-1]
    seen = [_SEES[one] for one in config.inputs]
    own = run.with_its_worlds(config)
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
        exact_wheels=config.randomization.wheel_speed_error == (0.0, 0.0),
        command=f"navsim train {shlex.join(arguments_of(config))}",
        steps=int(last["step"]),
        robot_hours=int(last["step"]) * config.task.control_period / 3600.0,
        minutes=float(last["processor_seconds"]) / 60.0,
        processor=run.processor,
        chosen="the last of the run"
        if weights == "last"
        else f"those that did best in `{config.eval_world}` during the run",
        sensor="an ideal depth sensor" if (ideal := config.sensor == SensorModel()) else "a noisy depth sensor",
        ideal=ideal,
        results=results,
    )


def _listed(names: Sequence[str]) -> str:
    """Names as a sentence lists them; "" for none."""
    return " and ".join([*([", ".join(names[:-1])] if names[1:] else []), *names[-1:]])
