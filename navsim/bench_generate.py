"""How fast rooms are generated: placed, checked for passages, validated by the format's rules, and written as text."""

from __future__ import annotations

import time

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from navsim.generate import KINDS, RoomSettings, room_text


def run(console: Console, *, rooms: int = 100) -> None:
    """Prints a table of the processor time that each kind of room takes.

    Args:
        console: where to.
        rooms: rooms to make of each kind.

    Raises:
        ValueError: without rooms.
    """
    if rooms < 1:
        raise ValueError(f"rooms must be at least 1; got {rooms}")
    table = Table(title="generated rooms of 7 by 7 m, one core", box=SIMPLE_HEAD)
    table.add_column("kind", style="bold")
    for heading in ("obstacles", "ms a room", "a thousand, s", "and as YAML, s"):
        table.add_column(heading, justify="right")
    with console.status("generating"):
        for kind in KINDS:
            settings = RoomSettings(kind)
            begin = time.process_time()
            worlds = [settings.room(index) for index in range(rooms)]
            made = (time.process_time() - begin) / rooms
            for index, world in enumerate(worlds):
                room_text(settings, index, world)
            written = (time.process_time() - begin) / rooms
            obstacles = sum(len(world.obstacles) for world in worlds) / rooms
            table.add_row(kind, f"{obstacles:.0f}", f"{1e3 * made:.1f}", f"{1e3 * made:.1f}", f"{1e3 * written:.1f}")
    console.print(table)
