"""The report of a run: one HTML file that holds everything, pictures and animation included."""

from __future__ import annotations

import base64
import importlib.resources
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import torch
from matplotlib.figure import Figure
from tensordict import TensorDict
from torchrl.modules import QValueActor

from navsim.animation import animate_episode
from navsim.draw import draw_depth_stack, figure_png, new_figure
from navsim.errors import counted
from navsim.files import atomic_write
from navsim.raycast import render_depth
from navsim.scan import obstacle_depth
from navsim.sensor import SensorModel
from navsim.task import heading
from navsim.world import World
from navsim.worldsource import TRAINING_SEED, have_rooms_in_common, short_name, worlds_from
from rl.baselines import BASELINES
from rl.config import TrainConfig
from rl.figures import (
    action_distribution,
    all_paths,
    choose_examples,
    describe,
    example_paths,
    training_curves,
)
from rl.metrics import OUTCOMES, Evaluation, PathResult
from rl.observation import NUM_FRAMES, history_length
from rl.policies import load_policy
from rl.run import Run, RunError
from rl.surroundings import remembered_at_end

LAST_WEIGHTS = " last"
"""Ends the name of the evaluation of a run's last weights, where these are not its best."""


def write_report(run: Run) -> Path:
    """Writes ``report.html`` and ``episode.mp4`` from a run's logs, weights and final evaluations.

    Args:
        run: a run whose ``evaluation/`` holds the evaluation of its policy, and perhaps those of the baselines.

    Returns:
        the report's path.

    Raises:
        RunError: for a run that lacks files.
        navsim.WorldError: for a world file that cannot be used.
    """
    config = run.config
    evaluations = _evaluations(run)
    page = _template().render(_contents(run, config, evaluations))
    path = run.directory / "report.html"
    with atomic_write(path) as file:
        file.write(page)
    return path


def _template() -> jinja2.Template:
    source = importlib.resources.files("rl").joinpath("report.html.jinja").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)


def _evaluations(run: Run) -> list[Evaluation]:
    """The final evaluations: the run's policy first, then its last weights, and the baselines in their usual order."""
    own = f"D3QN-{run.config.model}"
    files = {name: run.directory / "evaluation" / f"{name}.json" for name in (own, f"{own}{LAST_WEIGHTS}", *BASELINES)}
    if not files[own].is_file():
        again = shlex.join(["navsim", "train", "--resume", "--report", "--out", str(run.directory)])
        raise RunError(f"{run.directory} holds no evaluation of its policy; make it, and the report: {again}")
    return [Evaluation.load(file) for file in files.values() if file.is_file()]


def _contents(run: Run, config: TrainConfig, evaluations: Sequence[Evaluation]) -> dict[str, Any]:
    policy, versions = evaluations[0], _versions(run)
    # Of several worlds the first one is drawn.
    own = run.with_its_worlds(config)
    world, drawn = worlds_from(own.eval_world)[0], policy.by_world()[0]
    metrics, logged = run.metrics.rows(), run.evaluations.rows()
    low, high = (round(100 * bound) for bound in policy.interval("success"))
    unseen = not have_rooms_in_common(own.world, [own.eval_world], TRAINING_SEED + config.seed)
    trained_in = ", ".join(map(short_name, config.world))
    several = len(policy.worlds) > 1
    shown = [evaluation for evaluation in evaluations if not evaluation.policy.endswith(LAST_WEIGHTS)]
    return {
        "title": f"{run.directory.resolve().name}: {policy.success_rate:.0%} of {policy.world}",
        "run_name": run.directory.resolve().name,
        "headline": f"{policy.policy} reaches {policy.count('success')} of {len(policy.paths)} goals in {policy.world}"
        + (f", {_never_seen(several)}" if unseen else ""),
        "unseen": unseen,
        "several": several,
        "chosen": _how_chosen(policy, evaluations, len(logged)),
        "planned": any(evaluation.policy == "oracle" for evaluation in evaluations),
        "summary": f"Trained in {trained_in} with preset {config.preset}.",
        "facts": [
            (f"{policy.success_rate:.0%}", f"success ({low}–{high}%)"),
            (f"{policy.spl:.2f}", "SPL"),
            *_training_facts(metrics),
        ],
        "rows": [_row(evaluation) for evaluation in evaluations],
        "paths": counted(len(policy.paths), "path"),
        "world": policy.world,
        "control_period": f"{config.task.control_period:g}",
        "animation": _animation(run, config, world, drawn),
        "figures": list(_figures(run, config, world, drawn, shown, metrics, logged)),
        "seed": config.seed,
        "settings": list(_flat(config.to_dict())),
        "versions": list(_flat(versions)),
    }


def _how_chosen(policy: Evaluation, evaluations: Sequence[Evaluation], count: int) -> str:
    """A sentence on what the weights were chosen by, which makes their share of goals a little too good."""
    if count <= 1:
        return ""
    chosen = f"{policy.policy} has the weights of the best of {count} evaluations, which drove the same paths"
    beside = any(evaluation.policy.endswith(LAST_WEIGHTS) for evaluation in evaluations)
    return f"{chosen}; nothing chose the last ones." if beside else f"{chosen}."


def _never_seen(several: bool) -> str:
    return "rooms that it has never seen" if several else "a room that it has never seen"


def _training_facts(metrics: Sequence[Mapping[str, str]]) -> list[tuple[str, str]]:
    if not metrics:
        return []
    last = metrics[-1]
    steps, seconds = int(last["step"]), float(last["seconds"])
    return [
        (f"{steps:,}", f"environment steps, {int(last['episodes']):,} episodes"),
        (f"{seconds / 60:.1f} min", f"training, {steps / max(seconds, 1e-9):,.0f} steps/s"),
    ]


def _versions(run: Run) -> dict[str, Any]:
    path = run.directory / "versions.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{path} cannot be read: {error}") from error


def _row(evaluation: Evaluation) -> dict[str, Any]:
    rates = []
    for outcome in OUTCOMES:
        low, high = evaluation.interval(outcome)
        rates.append(
            {
                "outcome": outcome,
                "percent": round(100 * evaluation.rate(outcome)),
                "low": round(100 * low),
                "high": round(100 * high),
            }
        )
    return {
        "policy": evaluation.policy,
        "rates": rates,
        "spl": f"{evaluation.spl:.2f}",
        "steps": f"{evaluation.mean_steps:.0f}",
        "reward": f"{evaluation.mean_reward:+.2f}",
    }


def _animation(run: Run, config: TrainConfig, world: World, policy: Evaluation) -> dict[str, str]:
    """The success that took the longest way: an episode in which something happens."""
    shown = max(policy.paths, key=lambda path: (path.outcome == "success", path.shortest_path_length, path.steps))
    video = animate_episode(
        run.directory / "episode.mp4",
        world,
        shown.trajectory,
        shown.goal,
        actions=shown.actions,
        outcome=shown.outcome,
        obstacle_poses=shown.obstacle_poses(world, config.task, config.robot),
        camera=config.camera,
        task=config.task,
        robot=config.robot,
    )
    seen = "" if config.sensor == SensorModel() else " The images are ideal; it saw others."
    return {
        "source": _embedded(video.read_bytes(), "video/mp4"),
        "caption": f"{policy.policy} from {describe(shown)}: {shown.outcome} after {shown.steps} steps.{seen}",
    }


def _figures(
    run: Run,
    config: TrainConfig,
    world: World,
    drawn: Evaluation,
    evaluations: Sequence[Evaluation],
    metrics: Sequence[Mapping[str, str]],
    logged: Sequence[Mapping[str, str]],
) -> Iterator[dict[str, Any]]:
    examples = choose_examples(drawn)
    if metrics:
        yield _block(
            "Training",
            (
                training_curves(metrics, logged),
                f"Lines: while training, with exploration{_stricter(config)}. "
                f"Points: evaluations in {evaluations[0].world}, greedy.",
            ),
        )
    yield _block(
        "All paths",
        (all_paths(world, drawn), f"Every path of {drawn.policy} in {world.name}, by how it ended."),
        narrow=True,
    )
    yield _block(
        "Some of them",
        (
            example_paths(world, examples, config.task),
            "The longest successes from different starts, and a failure of each kind if there is any.",
        ),
        narrow=True,
    )
    yield _block(
        "Actions",
        (
            action_distribution(evaluations),
            "Share of each action over all steps. An action sets the speed or the turn; the other stays as it was.",
        ),
    )
    actor = load_policy(run.directory)
    moments = _telling_moments(world, examples[0], config)
    ideal = config.sensor == SensorModel()
    what_it_does = "; the greatest is what it does" if ideal else ". These images are ideal; it saw others"
    yield _block(
        "What the network sees and thinks",
        *(
            (
                _depth_stack(actor, config, world, examples[0], step),
                f"{when}, {step * config.task.control_period:.1f} s into the drive from {describe(examples[0])}: the "
                f"four depth images, the goal's direction and the seven Q-values{what_it_does}.",
            )
            for when, step in moments
        ),
    )


def _stricter(config: TrainConfig) -> str:
    return f", by rules {config.margin:g} m stricter" if config.margin > 0.0 else ""


def _block(heading: str, *figures: tuple[Figure, str], narrow: bool = False) -> dict[str, Any]:
    return {
        "heading": heading,
        "figures": [
            {"source": _embedded(figure_png(figure), "image/png"), "caption": caption, "narrow": narrow}
            for figure, caption in figures
        ],
    }


def _embedded(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _telling_moments(world: World, path: PathResult, config: TrainConfig) -> list[tuple[str, int]]:
    """The steps of a drive where the way ahead was freest and where it was most obstructed."""
    last = max(0, path.steps - 1)
    first = min(history_length(config.frame_interval) - 1, last)
    images = _ideal_images(config, world, path, np.arange(first, last + 1))
    middle = slice(config.camera.width // 3, -(config.camera.width // 3) or None)
    view = obstacle_depth(images, config.camera)[:, middle].mean(axis=1)
    return [("Free way", first + int(view.argmax())), ("Something ahead", first + int(view.argmin()))]


def _ideal_images(config: TrainConfig, world: World, path: PathResult, steps: np.ndarray) -> np.ndarray:
    """``(K, H, W)`` what the ideal sensor saw before some steps ``(K,)`` of a drive, metres."""
    obstacles = path.obstacle_poses(world, config.task, config.robot)
    seen = None if obstacles is None else obstacles[steps]
    return config.camera.from_planar(render_depth(world, path.trajectory[steps], config.camera, seen))


def _depth_stack(actor: QValueActor, config: TrainConfig, world: World, path: PathResult, step: int) -> Figure:
    camera = config.camera
    steps = np.maximum(step - config.frame_interval * np.arange(NUM_FRAMES - 1, -1, -1), 0)
    stack = camera.to_uint8(_ideal_images(config, world, path, steps))
    angle = float(heading(path.trajectory[step], np.array(path.goal)))
    observation = TensorDict(
        {
            "depth": torch.from_numpy(stack)[None],
            "heading": torch.tensor([[angle]], dtype=torch.float32),
            "command": torch.from_numpy(path.commands[step : step + 1].astype(np.float32)),
        },
        batch_size=[1],
    )
    if "surroundings" in config.inputs:
        driven = np.arange(step + 1)
        images = camera.to_uint8(_ideal_images(config, world, path, driven))
        remembered = remembered_at_end(images, path.trajectory[driven], camera, config.robot)
        observation["surroundings"] = torch.from_numpy(remembered)
    with torch.no_grad():
        q_values = actor(observation)["action_value"][0].numpy()
    figure = new_figure(10.0, 5.0)
    interval = config.frame_interval * config.task.control_period
    draw_depth_stack(figure, stack, angle, q_values, camera, interval=interval)
    return figure


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Settings as rows of text, those of a part as ``part.name``."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif isinstance(value, list | tuple):
            yield f"{prefix}{name}", ", ".join(str(entry) for entry in value)
        else:
            yield f"{prefix}{name}", f"{value:g}" if isinstance(value, float) else str(value)
