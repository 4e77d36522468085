"""How long a large world takes to load, and robots to begin new episodes in it."""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from navsim.bench_camera import generated_room
from navsim.simulator import Simulator
from navsim.world import Goal, Start, World
from navsim.worldfile import load_world, save_world

NUM_OBSTACLES = 10_000
"""In a hall of one obstacle a square metre, starts and goals drawn at random."""
NUM_ROBOTS = 16
_ROUNDS = 7
_RESETS = 15
"""Resets in a round."""


class WorldTimes(NamedTuple):
    """Medians of processor time, seconds."""

    load: float
    """Reading and checking the world file."""
    first_reset: float
    """Making a simulator and beginning the first episodes, which works out what later ones need."""
    reset: float
    """Beginning new episodes with all robots: places drawn at random, and their images."""
    listed_reset: float
    """The same at starts and goals that the world lists."""


def benchmark_world(
    num_obstacles: int = NUM_OBSTACLES, num_robots: int = NUM_ROBOTS, rounds: int = _ROUNDS, resets: int = _RESETS
) -> WorldTimes:
    """Measures a hall of ``num_obstacles``, one a square metre, written to a file and read again in every round."""
    world = generated_room(np.random.default_rng(0), num_obstacles, size=num_obstacles**0.5)
    load, first, later, listed = [], [], [], []
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "hall.yaml"
        save_world(world, file)
        for seed in range(rounds):
            seconds, hall = _timed(lambda: load_world(file))
            load.append(seconds)
            seconds, simulator = _timed(lambda: _begun(Simulator(hall, num_robots, seed=seed)))  # noqa: B023
            first.append(seconds)
            later += [_timed(simulator.reset)[0] for _ in range(resets)]
            with_places = _begun(Simulator(_with_places(hall, simulator), num_robots, seed=seed))
            listed += [_timed(with_places.reset)[0] for _ in range(resets)]
    return WorldTimes(*(statistics.median(times) for times in (load, first, later, listed)))


def _with_places(world: World, simulator: Simulator) -> World:
    """The world with the starts and goals listed that its robots have."""
    starts = tuple(Start(at=(float(x), float(y)), yaw_deg=math.degrees(yaw)) for x, y, yaw in simulator.poses)
    goals = tuple(Goal(at=(float(x), float(y))) for x, y in simulator.goals)
    return world.model_copy(update={"starts": starts, "goals": goals})


def run(console: Console, *, num_obstacles: int = NUM_OBSTACLES) -> WorldTimes:
    """Prints what ``benchmark_world`` measures."""
    times = benchmark_world(num_obstacles)
    title = f"A world of {num_obstacles:,} obstacles, one a square metre, one thread, processor time"
    table = Table(title=title, title_justify="left")
    table.add_column("what")
    table.add_column("ms", justify="right")
    table.add_row("load and check its file", f"{1e3 * times.load:,.0f}")
    table.add_row(f"first reset of {NUM_ROBOTS} robots, simulator made", f"{1e3 * times.first_reset:,.0f}")
    table.add_row(f"every later reset of {NUM_ROBOTS} robots, starts and goals at random", f"{1e3 * times.reset:.1f}")
    table.add_row("the same, starts and goals listed", f"{1e3 * times.listed_reset:.1f}")
    console.print(table)
    return times


def _begun(simulator: Simulator) -> Simulator:
    simulator.reset()
    return simulator


def _timed(function: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.process_time()
    result = function()
    return time.process_time() - begin, result
