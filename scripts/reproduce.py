"""The thesis's experiment: python scripts/reproduce.py --help

Runs {D3QN-I, D3QN-S} x {80x64, 160x128} x {simple, complex} x seeds with the preset "thesis", and writes the tables
and figures of the thesis. Afterwards scripts/results.py puts the tables into docs/results.md.
"""

import sys
from pathlib import Path
from typing import Literal

import tyro

from rl.reproduce import cells
from rl.reproduce import reproduce as run_matrix
from rl.series import SeriesError


def reproduce(
    models: tuple[Literal["I", "S"], ...] = ("I", "S"),
    sizes: tuple[Literal["80x64", "160x128"], ...] = ("80x64", "160x128"),
    rooms: tuple[Literal["simple", "complex"], ...] = ("simple", "complex"),
    seeds: tuple[int, ...] = (0, 1, 2),
    total_steps: int | None = None,
    runs: Path = Path("runs/reproduce"),
    results: Path = Path("docs/results/reproduce"),
) -> None:
    """Run the thesis's experiment, or a part of it, and write its tables 6.1 to 6.4 and figures 6.1 to 6.11.

    It may be interrupted at any point: what is finished is skipped, what is not goes on.

    With 80x64 images, two runs at once on two cores, a run takes an hour and a half of an EPYC "Genoa" (80 steps a
    second) and two to four of a "Naples" (26 to 34) or of a busy Xeon "Emerald Rapids" (30 to 57); with 160x128 images,
    ten of a "Naples" (10.8). So run two of these commands at once, such as --models I and --models S.

    Args:
        models: Networks to train.
        sizes: Depth images, columns x rows.
        rooms: Rooms to train in; each run is evaluated in both evaluation rooms.
        seeds: Seeds of each combination.
        total_steps: Transitions of each run, in place of the thesis's 400,000.
        runs: Directory of the runs, needed to go on with them.
        results: Directory of the JSON, tables and figures.
    """
    shapes = [tuple(int(side) for side in size.split("x")) for size in sizes]
    try:
        run_matrix(cells(models, shapes, rooms, seeds), runs=runs, results=results, total_steps=total_steps)
    except (SeriesError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    try:
        tyro.cli(reproduce)
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on")
