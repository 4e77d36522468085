"""Measures how well a room's difficulty tells where the reactive baseline fails (a quarter of an hour on one core).

Writes docs/results/difficulty.json and docs/images/difficulty.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro
from rich.console import Console

from rl.difficulty_study import run


def main(rooms_each: int = 16, paths_each: int = 12, redraw: bool = False) -> None:
    """Drive, judge and draw.

    Args:
        rooms_each: Rooms of each kind and density.
        paths_each: Paths driven in each room.
        redraw: Judge and draw what the JSON file holds instead of driving again.
    """
    docs = Path(__file__).resolve().parent.parent / "docs"
    results, picture = docs / "results" / "difficulty.json", docs / "images" / "difficulty.png"
    try:
        run(Console(), results=results, picture=picture, rooms_each=rooms_each, paths_each=paths_each, redraw=redraw)
    except ValueError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    tyro.cli(main)
