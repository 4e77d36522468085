"""How well :func:`navsim.difficulty` tells where the reactive baseline fails: rooms, drives, correlation, a picture.

Rooms with an even number are what the model's coefficients are fitted to, the others are what it is judged by.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import spearmanr

from navsim.camera import DepthCamera
from navsim.difficulty import COEFFICIENTS, Measures, measure
from navsim.draw import INK, QUIET_INK, new_figure, save_figure
from navsim.files import atomic_write
from navsim.generate import KINDS, RoomSettings
from rl.baselines import make_baseline
from rl.evaluation import evaluate
from rl.metrics import wilson_interval

DENSITIES = {
    "clutter": (0.05, 0.11, 0.2),
    "blocks": (0.05, 0.1, 0.2),
    "corridors": (0.03, 0.06, 0.1),
    "office": (0.06, 0.1, 0.16),
    "warehouse": (0.1, 0.2, 0.28),
    "forest": (0.02, 0.05, 0.09),
}
"""Shares of the floor that rooms of each kind are made with."""
COLOURS = dict(zip(KINDS, ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B58900", "#56B4E9"), strict=True))
"""After Okabe and Ito, which colour-blind readers tell apart."""
_SEED = 1
_GROUP = 6  # rooms driven in at a time
_BOOTSTRAPS = 5_000


@dataclass(frozen=True)
class Room:
    """A generated room, and what became of the reactive baseline there."""

    kind: str
    density: float
    seed: int
    index: int
    measures: Measures
    paths: int
    failures: int

    @property
    def is_fitted_to(self) -> bool:
        """Whether the model's coefficients come from this room and others like it."""
        return self.index % 2 == 0


def drive(rooms_each: int, paths_each: int, console: Console) -> Iterator[Room]:
    """Makes ``rooms_each`` rooms of every kind and density, and drives ``paths_each`` paths in each of them."""
    policy = make_baseline("reactive", DepthCamera())
    remaining = [
        (RoomSettings(kind, (7.0, 7.0), density, _SEED), index)
        for index in range(rooms_each)
        for kind, densities in DENSITIES.items()
        for density in densities
    ]
    for begin in track(range(0, len(remaining), _GROUP), "driving", console=console, disable=not console.is_terminal):
        group = remaining[begin : begin + _GROUP]
        worlds = [settings.room(index) for settings, index in group]
        paths = sum(min(paths_each, len(world.paths)) for world in worlds)
        evaluation = evaluate(policy, worlds, seed=_SEED, num_paths=paths)
        for number, ((settings, index), world) in enumerate(zip(group, worlds, strict=True)):
            outcomes = [path.outcome for path in evaluation.paths if path.world_index == number]
            yield Room(
                kind=settings.kind,
                density=settings.density or 0.0,
                seed=_SEED,
                index=index,
                measures=measure(world),
                paths=len(outcomes),
                failures=sum(outcome != "success" for outcome in outcomes),
            )


def fit(rooms: Sequence[Room]) -> tuple[float, ...]:
    """The coefficients under which the failures in ``rooms`` are likeliest: those of ``navsim.difficulty``."""
    measures, failures, paths = _columns(rooms)

    def surprise(coefficients: np.ndarray) -> float:
        share = np.clip(expit(coefficients[0] + measures @ coefficients[1:]), 1e-9, 1.0 - 1e-9)
        return -float((failures * np.log(share) + (paths - failures) * np.log1p(-share)).sum())

    return tuple(minimize(surprise, np.zeros(1 + measures.shape[1])).x.tolist())


def predictions(rooms: Sequence[Room], coefficients: Sequence[float] = COEFFICIENTS) -> np.ndarray:
    """``(R,)`` the difficulty of each room."""
    measures, _, _ = _columns(rooms)
    return expit(coefficients[0] + measures @ np.asarray(coefficients[1:]))


def correlation(rooms: Sequence[Room]) -> dict[str, float]:
    """Spearman's rank correlation of difficulty and share of failures, and its 95% interval by bootstrap over rooms.

    Raises:
        ValueError: where the baseline fails as often in every room.
    """
    difficulty, rates = predictions(rooms), _rates(rooms)
    if len(set(rates.tolist())) < 2:
        raise ValueError(f"{len(rooms)} rooms with failures alike show no correlation; drive in more rooms, more paths")
    generator = np.random.default_rng(0)
    drawn = generator.integers(len(rooms), size=(_BOOTSTRAPS, len(rooms)))
    differs = [index for index in drawn if len(set(rates[index].tolist())) > 1]
    bootstrap = [spearmanr(difficulty[index], rates[index]).statistic for index in differs]
    low, high = np.quantile(bootstrap, (0.025, 0.975))
    return {
        "rooms": len(rooms),
        "spearman": float(spearmanr(difficulty, rates).statistic),
        "low": float(low),
        "high": float(high),
    }


def summary(rooms: Sequence[Room]) -> dict[str, Any]:
    """Everything, as plain values for JSON."""
    judged = [room for room in rooms if not room.is_fitted_to]
    fitted_to = [room for room in rooms if room.is_fitted_to]
    return {
        "command": "python scripts/difficulty.py",
        "coefficients": list(COEFFICIENTS),
        "fitted_anew": list(fit(fitted_to)),
        "judged": correlation(judged),
        "fitted_to": correlation(fitted_to),
        "judged_by_kind": {kind: correlation([room for room in judged if room.kind == kind]) for kind in KINDS},
        "rooms": [asdict(room) | {"measures": list(room.measures)} for room in rooms],
    }


def rooms_of(values: dict[str, Any]) -> list[Room]:
    """The rooms of a ``summary``."""
    return [Room(**{**room, "measures": Measures(*room["measures"])}) for room in values["rooms"]]


def plot(rooms: Sequence[Room]) -> Figure:
    """Difficulty against the share of failures: each room that the model was not fitted to, and eighths of them all."""
    judged = [room for room in rooms if not room.is_fitted_to]
    told = correlation(judged)
    figure = new_figure(7.0, 5.4)
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [0.0, 1.0], color=QUIET_INK, lw=0.8, ls=(0, (4, 3)), zorder=1)
    jitter = np.random.default_rng(0).uniform(-0.012, 0.012, len(judged))
    difficulty, rates = predictions(judged), _rates(judged)
    for kind in KINDS:
        own = np.array([room.kind == kind for room in judged])
        axes.scatter(
            difficulty[own], (rates + jitter)[own], s=20, fc=COLOURS[kind], ec="white", lw=0.4, alpha=0.8, label=kind
        )
    for part in np.array_split(np.argsort(difficulty), 8):
        failures, paths = (sum(getattr(judged[i], name) for i in part) for name in ("failures", "paths"))
        low, high = wilson_interval(failures, paths)
        middle = failures / paths
        axes.errorbar(
            difficulty[part].mean(), middle, [[middle - low], [high - middle]], fmt="s", color=INK, ms=5, capsize=2.5
        )
    axes.plot([], [], "s", color=INK, ms=5, label="an eighth of the rooms, 95% interval")
    axes.set_xlabel("difficulty", color=INK)
    axes.set_ylabel("share of paths on which the reactive baseline fails", color=INK)
    axes.set_title(
        f"{told['rooms']} rooms that the model was not fitted to: Spearman {told['spearman']:.2f} "
        f"({told['low']:.2f} to {told['high']:.2f})",
        fontsize=10,
        color=INK,
    )
    top = float(max(rates.max(), difficulty.max())) + 0.05
    axes.set_xlim(0.0, min(1.02, float(difficulty.max()) + 0.05))
    axes.set_ylim(-0.03, min(1.03, top))
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure


def run(
    console: Console, *, results: Path, picture: Path, rooms_each: int = 16, paths_each: int = 12, redraw: bool = False
) -> None:
    """Drives, judges, writes ``results`` (JSON) and ``picture``, and prints what came out.

    Args:
        console: where progress and results are shown.
        results: JSON to write, or with ``redraw`` to read the drives from.
        picture: of the correlation.
        rooms_each: rooms of each kind and density.
        paths_each: paths driven in each room.
        redraw: judge and draw what ``results`` holds instead of driving again.

    Raises:
        ValueError: for less than two rooms of a kind, and with ``redraw`` for a file that holds no such results.
    """
    if rooms_each < 2 and not redraw:
        raise ValueError(
            f"rooms_each must be 2 or more, got {rooms_each}: half of them are fitted to, the others judged"
        )
    if redraw:
        try:
            rooms = rooms_of(json.loads(results.read_text(encoding="utf-8")))
        except (KeyError, OSError, TypeError, ValueError) as error:
            raise ValueError(f"{results} cannot be read as results of this study: {error}") from error
    else:
        rooms = list(drive(rooms_each, paths_each, console))
    told = summary(rooms)
    with atomic_write(results) as file:
        file.write(_compact(told))
    save_figure(plot(rooms), picture)
    console.print(f"coefficients: {', '.join(f'{value:.2f}' for value in told['coefficients'])}")
    console.print(f"fitted anew to the even rooms: {', '.join(f'{value:.2f}' for value in told['fitted_anew'])}")
    for name in ("fitted_to", "judged"):
        entry = told[name]
        console.print(
            f"{name.replace('_', ' ')}: Spearman {entry['spearman']:.3f} ({entry['low']:.3f} to {entry['high']:.3f}) "
            f"in {entry['rooms']} rooms"
        )
    for kind, entry in told["judged_by_kind"].items():
        console.print(f"  {kind}: {entry['spearman']:.2f} ({entry['low']:.2f} to {entry['high']:.2f})")


def _columns(rooms: Sequence[Room]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.array([room.measures for room in rooms]),
        np.array([room.failures for room in rooms]),
        np.array([room.paths for room in rooms]),
    )


def _rates(rooms: Sequence[Room]) -> np.ndarray:
    _, failures, paths = _columns(rooms)
    return failures / paths


def _compact(told: dict[str, Any]) -> str:
    """JSON with one room a line."""
    rooms = ",\n".join("    " + json.dumps(room, allow_nan=False) for room in told["rooms"])
    head = json.dumps({**told, "rooms": []}, indent=2, allow_nan=False)
    return head.replace('"rooms": []', f'"rooms": [\n{rooms}\n  ]') + "\n"
