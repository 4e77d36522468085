"""What pitch, cameras that differ from robot to robot, and the sensor's faults cost, beside a level and ideal camera.

All of them take turns in one process, on one thread, on the same poses; medians of processor time are compared.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from navsim.bench_camera import SIZES, free_poses
from navsim.camera import DepthCamera
from navsim.raycast import Scene, cast
from navsim.sensor import KINECT, Sensor, SensorModel
from navsim.worldfile import load_world

_BATCHES = 4  # of poses, all of which are rendered when one's turn comes
PITCH_DEG = 10.0
"""Pitch that is measured, degrees."""

SENSORS = {
    "uint8 alone": SensorModel(),
    "axial noise": SensorModel(axial_noise=1.0),
    "lateral noise": SensorModel(lateral_noise=1.0),
    "steps of disparity": SensorModel(disparity_step=0.125),
    "shadows": SensorModel(shadows=True),
    "losses at edges": SensorModel(edge_loss=0.5),
    "grazing losses": SensorModel(grazing_loss=1.0),
    "a whole Kinect": KINECT,
    "a whole Kinect, holes filled": replace(KINECT, filled=True),
    "a whole Kinect, 2 steps late": replace(KINECT, latency=2),
}
"""What is measured of the sensor."""


class Cost(NamedTuple):
    """What one call for all robots takes."""

    name: str
    milliseconds: float
    """In the median round."""
    times: float
    """As much as the first one of its group."""


def benchmark_pitch(
    width: int, height: int, num_robots: int = 16, *, world: str = "complex_train", repeats: int = 31
) -> list[Cost]:
    """Ideal images of level cameras, of pitched ones, and of ones that each robot carries in its own way.

    Raises:
        WorldError: for a world file that cannot be used.
    """
    camera = DepthCamera(width=width, height=height)
    mounts = {
        "level": camera.mounts(num_robots),
        f"pitched {PITCH_DEG:g} deg down": replace(camera, pitch_deg=PITCH_DEG).mounts(num_robots),
        f"pitched {PITCH_DEG:g} deg up": replace(camera, pitch_deg=-PITCH_DEG).mounts(num_robots),
        "a height and pitch for each": camera.mounts(num_robots)._replace(
            z=np.linspace(0.27, 0.32, num_robots), pitch=np.radians(np.linspace(-5.0, 5.0, num_robots))
        ),
    }
    room = load_world(world)
    scene, index = Scene([room]), np.zeros(num_robots, dtype=np.intp)
    poses = free_poses(np.random.default_rng(0), room, _BATCHES * num_robots).reshape(_BATCHES, num_robots, 3)

    def rendering(name: str) -> Callable[[], None]:
        def render() -> None:
            for batch in poses:
                cast(scene, index, batch, camera, mounts=mounts[name])

        return render

    return _compare({name: rendering(name) for name in mounts}, repeats)


def benchmark_sensor(
    width: int, height: int, num_robots: int = 16, *, world: str = "complex_train", repeats: int = 31
) -> list[Cost]:
    """What the sensor makes of ideal images, fault by fault.

    Raises:
        WorldError: for a world file that cannot be used.
    """
    camera, room = DepthCamera(width=width, height=height), load_world(world)
    poses = free_poses(np.random.default_rng(0), room, _BATCHES * num_robots)
    ideal = cast(Scene([room]), np.zeros(len(poses), dtype=np.intp), poses, camera)
    batches = ideal.reshape(_BATCHES, num_robots, height, width)

    def exposing(model: SensorModel) -> Callable[[], None]:
        sensor = Sensor(camera, model, num_robots, model.latency)
        sensor.reseed(np.random.SeedSequence(0).spawn(num_robots))

        def expose() -> None:
            for images in batches:
                sensor.advance(images)
                _ = sensor.images

        return expose

    return _compare({name: exposing(model) for name, model in SENSORS.items()}, repeats)


def run(
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,
    num_robots: int = 16,
    world: str = "complex_train",
    repeats: int = 31,
    console: Console | None = None,
) -> None:
    """Prints what ``benchmark_pitch`` and ``benchmark_sensor`` measure.

    Raises:
        WorldError: for a world file that cannot be used.
    """
    console = console or Console()
    for title, benchmark in (("Ideal images", benchmark_pitch), ("What the sensor adds", benchmark_sensor)):
        table = Table(title=f"{title}, {num_robots} robots in {world}, one thread", title_justify="left")
        table.add_column("")
        columns = []
        for width, height in sizes:
            table.add_column(f"{width}x{height}, ms", justify="right")
            table.add_column("times", justify="right")
            columns.append(benchmark(width, height, num_robots, world=world, repeats=repeats))
        for row in zip(*columns, strict=True):
            table.add_row(
                row[0].name, *(text for cost in row for text in (f"{cost.milliseconds:.2f}", f"{cost.times:.1f}"))
            )
        console.print(table)


def _compare(measured: dict[str, Callable[[], None]], repeats: int) -> list[Cost]:
    seconds: dict[str, list[float]] = {name: [] for name in measured}
    for _ in range(repeats):
        for name, call in measured.items():
            start = time.process_time()
            call()
            seconds[name].append((time.process_time() - start) / _BATCHES)
    medians = {name: 1e3 * statistics.median(taken) for name, taken in seconds.items()}
    first = next(iter(medians.values()))
    return [Cost(name, median, median / first) for name, median in medians.items()]
