"""What each part of learning is worth: python scripts/ablations.py --help

Trains rows that differ from a preset in what they name, evaluates them in rooms they have not seen, and writes
docs/ablations.md. It may be interrupted at any point: what is finished is skipped, what is not goes on.
"""

import sys
from pathlib import Path

import tyro

from rl.ablations import ROWS
from rl.ablations import run as run_rows
from rl.series import SeriesError


def main(
    rows: tuple[str, ...] = tuple(ROWS),
    seeds: tuple[int, ...] = (0, 1, 2),
    total_steps: int | None = None,
    runs: Path = Path("runs/ablations"),
    results: Path = Path("docs/results/ablations"),
    page: Path = Path("docs/ablations.md"),
) -> None:
    """Train and evaluate rows of the table of ablations, 7 to 60 minutes on one core for each seed of each row.

    Results that are in the directory of results, as this project's are, are not made again: to have your own, give
    others than the defaults.

    Args:
        rows: Names of rows; "base" is what the others are compared with. All together take days.
        seeds: Seeds of each row.
        total_steps: Transitions of each run, in place of its row's.
        runs: Directory of the runs, needed only to go on with them.
        results: Directory of the JSON and the figure.
        page: Markdown file with the table.
    """
    try:
        run_rows(rows, seeds, runs=runs, results=results, page=page, total_steps=total_steps)
    except (SeriesError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on")
