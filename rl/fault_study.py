"""What faults that a policy does not know of cost it: a camera mounted otherwise, unequal wheels, late or noisy images.

Every fault is driven alone, at several sizes; the policy acts and remembers as if there were none.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Console
from rich.table import Table

from navsim.draw import INK, check_picture, new_figure, save_figure
from navsim.files import atomic_write
from navsim.randomization import Randomization
from navsim.sensor import KINECT, SENSORS, SensorModel
from navsim.worldsource import worlds_from
from rl.ablations import UNSEEN_ROOMS
from rl.evaluation import evaluate_as_trained
from rl.metrics import wilson_interval
from rl.policies import find_policy

POLICIES = ("pretrained:I", "pretrained:S", "pretrained:I-memoryless", "reactive")
NUM_PATHS = 400
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B58900", "#56B4E9")


@dataclass(frozen=True)
class Size:
    """A fault of some size."""

    label: str
    randomization: Randomization = field(default_factory=Randomization)
    sensor: SensorModel | None = None
    """None: the sensor that the policy was trained with."""


FAULTS: dict[str, tuple[Size, ...]] = {
    "camera pitched down, degrees": tuple(
        Size(f"{pitch:+d}" if pitch else "0", Randomization(camera_pitch_deg=(pitch, pitch))) for pitch in range(-3, 4)
    ),
    "camera higher, cm": tuple(
        Size(f"{up:+d}" if up else "0", Randomization(camera_height=(0.01 * up, 0.01 * up)))
        for up in (-5, -3, -1, 0, 1, 3, 5)
    ),
    "each wheel off by up to, %": tuple(
        Size(f"{percent}", Randomization(wheel_speed_error=(-0.01 * percent, 0.01 * percent)))
        for percent in (0, 2, 5, 10)
    ),
    "images late by, steps of 0.2 s": tuple(
        Size(f"{steps}", Randomization(latency=(steps, steps))) for steps in (0, 1, 2)
    ),
    "sensor": (
        Size("ideal"),
        Size("axial noise", sensor=SensorModel(axial_noise=1.0)),
        Size("twice that", sensor=SensorModel(axial_noise=2.0)),
        Size("Kinect", sensor=KINECT),
        Size("Kinect, filled", sensor=SENSORS["kinect-filled"]),
    ),
}
"""Every fault, in growing sizes; one of them is none."""


@dataclass(frozen=True)
class Outcome:
    """How a policy did with a fault."""

    policy: str
    fault: str
    size: str
    paths: int
    reached: int
    spl: float


def drive(policies: Sequence[str], world: str, num_paths: int, console: Console) -> Iterator[Outcome]:
    """Drives the same paths with each policy, fault and size.

    Raises:
        RunError: for a policy that there is not, or that cannot be used.
        navsim.WorldError: for a world that cannot be used.
    """
    drivers = {name: find_policy(name) for name in policies}
    worlds = worlds_from(world)
    for name, (policy, config) in drivers.items():
        unharmed: tuple[int, int, float] | None = None
        for fault, sizes in FAULTS.items():
            for size in sizes:
                told = unharmed
                if told is None or size.sensor is not None or size.randomization != Randomization():
                    console.print(f"{name}: {fault}: {size.label}", style="dim")
                    result = evaluate_as_trained(
                        policy,
                        config,
                        worlds,
                        sensor=size.sensor,
                        randomization=size.randomization,
                        num_paths=num_paths,
                        console=console,
                    )
                    reached = sum(path.outcome == "success" for path in result.paths)
                    told = len(result.paths), reached, result.spl
                    if size.sensor is None and size.randomization == Randomization():
                        unharmed = told
                yield Outcome(name, fault, size.label, *told)


def plot(outcomes: Sequence[Outcome]) -> Figure:
    """Goals reached against the size of each fault, with 95% intervals (Wilson)."""
    policies = list(dict.fromkeys(outcome.policy for outcome in outcomes))
    faults = list(dict.fromkeys(outcome.fault for outcome in outcomes))
    figure = new_figure(2.9 * len(faults), 3.4)
    shares = [outcome.reached / outcome.paths for outcome in outcomes]
    for panel, fault in enumerate(faults):
        axes = figure.add_subplot(1, len(faults), panel + 1)
        for number, policy in enumerate(policies):
            own = [outcome for outcome in outcomes if (outcome.policy, outcome.fault) == (policy, fault)]
            share = np.array([outcome.reached / outcome.paths for outcome in own])
            bounds = np.array([wilson_interval(outcome.reached, outcome.paths) for outcome in own])
            at = np.arange(len(own)) + 0.08 * (number - 0.5 * (len(policies) - 1))
            axes.errorbar(
                at,
                100.0 * share,
                100.0 * np.stack([share - bounds[:, 0], bounds[:, 1] - share]).clip(0.0),
                fmt="o-",
                ms=4,
                lw=1.4,
                elinewidth=0.8,
                color=_COLOURS[number % len(_COLOURS)],
                label=policy,
            )
        axes.set_xticks(range(len(own)), [outcome.size.replace(" ", "\n") for outcome in own], fontsize=8)
        axes.set_title(fault, fontsize=9, color=INK)
        axes.set_ylim(100.0 * max(0.0, min(shares) - 0.08), 101.0)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis="y", color="#dddddd", lw=0.6)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        if panel == 0:
            axes.set_ylabel("goals reached, %", color=INK)
            axes.legend(fontsize=8, frameon=False, loc="lower center")
    return figure


def run(
    console: Console,
    *,
    policies: Sequence[str] = POLICIES,
    world: str = UNSEEN_ROOMS,
    num_paths: int = NUM_PATHS,
    results: Path,
    page: Path,
    picture: Path,
) -> list[Outcome]:
    """Drives, writes ``results`` (JSON), ``page`` (Markdown) and ``picture``, and prints the table.

    Raises:
        RunError: for a policy that there is not, or that cannot be used.
        navsim.WorldError: for a world that cannot be used.
        ValueError: for a picture that cannot be written, a number of paths that there are not, policies named twice.
    """
    check_picture(picture)
    if not policies or len(set(policies)) < len(policies):
        raise ValueError(f"name one policy or several different ones; got {', '.join(policies) or 'none'}")
    outcomes = list(drive(policies, world, num_paths, console))
    command = _command(policies, world, num_paths)
    with atomic_write(results) as file:
        file.write(_json(command, world, outcomes))
    save_figure(plot(outcomes), picture)
    with atomic_write(page) as file:
        file.write(page_of(outcomes, world, command, os.path.relpath(picture, page.parent)))
    table = Table("fault", "size", *policies)
    for fault, size, cells in _rows(outcomes):
        table.add_row(fault, size, *cells)
    console.print(table)
    return outcomes


def page_of(outcomes: Sequence[Outcome], world: str, command: str, picture: str) -> str:
    """The Markdown page."""
    policies = list(dict.fromkeys(outcome.policy for outcome in outcomes))
    lines = [
        "# What unknown faults cost",
        "",
        f"Goals reached on {outcomes[0].paths:,} paths of `{world}`, %, with 95% intervals (Wilson). Each fault is "
        "there alone, and the policy does not know of it: it acts as if there were none, and remembers what it has "
        "seen as if its camera sat where it should. Odometry is exact. Pixels without a return are left out of what is "
        "remembered; to the networks, and to *reactive*, they are something very near.",
        "",
        f"![goals reached against the size of each fault]({picture})",
        "",
        f"| fault | | {' | '.join(policies)} |",
        "|---|" + "---|" * (len(policies) + 1),
        *(f"| {fault} | {size} | {' | '.join(cells)} |" for fault, size, cells in _rows(outcomes)),
        "",
        "*Kinect* is noise, steps of disparity and lost returns all together; *filled* is the same with the holes of "
        "its images filled in (`navsim.fill_holes`), as `rl.Pilot` does for policies that were trained without holes.",
        "",
        "A fault that is known costs less: `--camera.*` and `--sensor.*` train with it, `--randomization.*` with "
        "whatever lies in a range ([simulator.md](simulator.md#what-differs-from-one-episode-to-the-next)).",
        "",
        f"Made by `{command}`.",
    ]
    return "\n".join(lines) + "\n"


def _rows(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, str, list[str]]]:
    """Fault, size, and a cell for each policy."""
    by_place: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        by_place.setdefault((outcome.fault, outcome.size), []).append(outcome)
    for (fault, size), own in by_place.items():
        yield fault, size, [_cell(outcome) for outcome in own]


def _cell(outcome: Outcome) -> str:
    low, high = wilson_interval(outcome.reached, outcome.paths)
    return f"{100 * outcome.reached / outcome.paths:.1f} ({100 * low:.0f}–{100 * high:.0f})"


def _command(policies: Sequence[str], world: str, num_paths: int) -> str:
    told = ["python", "scripts/faults.py"]
    told += [] if tuple(policies) == POLICIES else ["--policies", *policies]
    told += [] if world == UNSEEN_ROOMS else ["--world", world]
    told += [] if num_paths == NUM_PATHS else ["--num-paths", str(num_paths)]
    return shlex.join(told)


def _json(command: str, world: str, outcomes: Sequence[Outcome]) -> str:
    """JSON with one outcome a line."""
    told: dict[str, Any] = {"command": command, "world": world, "outcomes": []}
    lines = ",\n".join("    " + json.dumps(vars(outcome), allow_nan=False) for outcome in outcomes)
    return json.dumps(told, indent=2).replace('"outcomes": []', f'"outcomes": [\n{lines}\n  ]') + "\n"
