"""Generated rooms as world files in a directory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from navsim.files import write_text
from navsim.generate.rooms import RoomSettings
from navsim.processes import map_in_processes
from navsim.world import World
from navsim.worldfile import dump_world

_WORTH_PROCESSES = 64
"""Rooms from which on every processor makes some: it takes a second to begin."""


def write_rooms(
    settings: RoomSettings, directory: str | os.PathLike[str], count: int = 1, first: int = 1
) -> Iterator[tuple[World, Path]]:
    """Writes rooms as ``DIRECTORY/KIND-0001.yaml`` and so on, and hands over each room with its file as it is written.

    The bytes of a file follow from the settings and the room's number alone.

    Args:
        settings: of all the rooms.
        directory: made if it is not there.
        count: rooms to write.
        first: number of the first one, from 1 up.

    Raises:
        ValueError: for numbers that cannot be used, files that are there already, and settings that no room was found
            for.
        navsim.processes.WorkerDeathError: if one of the processes that make many rooms is killed.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1; got {count}")
    if first < 1:
        raise ValueError(f"first must be at least 1, the number of the first room; got {first}")
    files = [Path(directory) / f"{settings.name(index)}.yaml" for index in range(first - 1, first - 1 + count)]
    there = next((file for file in files if file.exists()), None)
    if there is not None:
        raise ValueError(f"{there} is there already; remove it, or choose another directory")
    Path(directory).mkdir(parents=True, exist_ok=True)
    return _written(settings, files, first - 1)


def _written(settings: RoomSettings, files: list[Path], first: int) -> Iterator[tuple[World, Path]]:
    write, rooms = partial(_write_room, settings), list(enumerate(files, first))
    if len(rooms) < _WORTH_PROCESSES:
        yield from map(write, rooms)
        return
    remedy = f"remove the rooms in {files[0].parent}, make sure of memory, and run the command again"
    yield from map_in_processes(write, rooms, what="that make rooms", remedy=remedy, at_once=8)


def _write_room(settings: RoomSettings, room: tuple[int, Path]) -> tuple[World, Path]:
    index, file = room
    world = settings.room(index)
    write_text(file, room_text(settings, index, world))
    return world, file


def room_text(settings: RoomSettings, index: int, world: World) -> str:
    """The world file of room ``index``, with the command that makes it in the first line."""
    density = "" if settings.density is None else f" --density {_exact(settings.density)}"
    command = (
        f"navsim world generate --kind {settings.kind} --size {','.join(map(_exact, settings.size))}{density} "
        f"--seed {settings.seed} --first {index + 1}"
    )
    return f"# {command}\n\n{dump_world(world)}"


def _exact(number: float) -> str:
    """Its shortest text that reads as the same number."""
    short = f"{number:g}"
    return short if float(short) == number else repr(float(number))
