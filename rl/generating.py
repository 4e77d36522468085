"""What ``navsim world generate`` does and shows: rooms as files, a table of them, a sheet of their plans."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from navsim.difficulty import difficulty
from navsim.errors import counted
from navsim.generate import RoomSettings, floor_covered, write_rooms
from navsim.overview import save_overview
from navsim.world import World
from rl.baselines import OraclePolicy
from rl.evaluation import evaluate
from rl.metrics import Evaluation

MOST_ROWS = 24
"""Rooms that are listed one by one."""


def generate_files(
    settings: RoomSettings,
    directory: Path,
    *,
    count: int = 1,
    first: int = 1,
    overview: bool = True,
    solve: bool = False,
    console: Console | None = None,
) -> None:
    """Writes rooms as world files, and tells about them.

    Args:
        settings: of all the rooms.
        directory: where the files go.
        count: rooms to make.
        first: number of the first one, from 1 up.
        overview: whether to draw the first rooms on one sheet, ``overview.png``.
        solve: whether the planning oracle drives every path.
        console: where progress and results are shown.

    Raises:
        ValueError: for settings that cannot be used, files that are there already, and, once all is written, paths
            that the oracle did not solve.
    """
    console = console or Console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    rooms = write_rooms(settings, directory, count, first)
    worlds: list[World] = []
    begin = time.perf_counter()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        for world, _ in bar.track(rooms, total=count, description="generating"):
            worlds.append(world)
    seconds = time.perf_counter() - begin
    listed = worlds[:MOST_ROWS]
    solved = [evaluate(OraclePolicy(), world, console=console) for world in worlds] if solve else []
    difficulties = [difficulty(world) for world in listed]
    console.print(_table(listed, difficulties, solved))
    if len(worlds) > len(listed):
        console.print(f"… and {len(worlds) - len(listed)} more")
    console.print(
        f"{counted(count, 'room')} in {directory}: {seconds:.2f} s, {1000.0 * seconds / count:.0f} ms each; "
        f"difficulty {min(difficulties):.2f} to {max(difficulties):.2f}, on average {np.mean(difficulties):.2f}",
        highlight=False,
    )
    if overview:
        captions = [f"{w.name}  ({d:.2f})" for w, d in zip(listed, difficulties, strict=True)]
        console.print(str(save_overview(listed, directory / "overview.png", captions=captions)), highlight=False)
    _complain(solved)


def _table(worlds: Sequence[World], difficulties: Sequence[float], solved: Sequence[Evaluation]) -> Table:
    table = Table(
        box=SIMPLE_HEAD,
        padding=(0, 0, 0, 1),
        caption="difficulty: on how many paths a reactive robot should fail",
    )
    table.add_column("room", style="bold", no_wrap=True)
    for heading in ("obstacles", "floor covered %", "paths", "difficulty", *(["solved"] if solved else [])):
        table.add_column(heading, justify="right")
    for number, (world, value) in enumerate(zip(worlds, difficulties, strict=True)):
        row = [world.name, str(len(world.obstacles)), f"{100 * floor_covered(world):.1f}", str(len(world.paths))]
        row.append(f"{value:.2f}")
        if solved:
            row.append(f"{solved[number].count('success')}/{len(solved[number].paths)}")
        table.add_row(*row)
    return table


def _complain(solved: Sequence[Evaluation]) -> None:
    lines = [
        f"{evaluation.world}: the oracle found no way from starts[{path.start_index}] to goals[{path.goal_index}]"
        for evaluation in solved
        for path in evaluation.paths
        if path.outcome != "success"
    ]
    if lines:
        raise ValueError("\n".join(lines))
