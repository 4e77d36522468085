"""Worlds by their source: a file, the name of a shipped world, or rooms to be generated.

Wherever a world is asked for by name, ``generate:KIND`` with settings after it stands for generated rooms::

    generate:clutter                            one room of 24 obstacles
    generate:clutter,density=0.11,count=200     two hundred, as dense as complex_eval
    generate:office,size=8x6,seed=3             one office of 8 by 6 m
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from navsim.errors import WorldError
from navsim.generate import KINDS, ImpossibleError, RoomSettings
from navsim.world import World
from navsim.worldfile import load_world

PREFIX = "generate:"
"""What a source of generated rooms begins with."""
MOST_ROOMS = 100_000
"""That one source may stand for."""
LONGEST_SOURCE = 200
"""Characters of a source of generated rooms."""
TRAINING_SEED = 1000
"""Where the seeds of rooms to train in begin, unless a source names its ``seed``: the run's own seed is added to it.
Elsewhere such a source means seed 0, so that rooms to train in and rooms to evaluate in are others by default."""

WorldSource = World | str | os.PathLike[str]
"""A world, the path or name of a world file, or a source of generated rooms."""


@dataclass(frozen=True)
class GeneratedRooms:
    """What a source of generated rooms stands for: rooms 1 to ``count`` of some settings."""

    settings: RoomSettings
    count: int = 1

    def worlds(self) -> list[World]:
        """The rooms."""
        return [self.settings.room(index) for index in range(self.count)]


def is_generated(source: object) -> bool:
    """Whether a source stands for generated rooms."""
    return isinstance(source, str) and source.startswith(PREFIX)


def parse_source(text: str, default_seed: int = 0) -> GeneratedRooms:
    """What ``generate:KIND,key=value,…`` stands for; the keys are size, density, seed and count.

    Args:
        text: the source.
        default_seed: the seed of a source that names none.

    Raises:
        WorldError: for what cannot be understood or used, in one sentence.

    >>> parse_source("generate:clutter,density=0.3,count=200").count
    200
    """
    if len(text) > LONGEST_SOURCE:
        shown, limit = f"{text[:60]}…", f"at most {LONGEST_SOURCE} characters long, not {len(text)}"
        raise _error(shown, f"a source must be {limit}; name each setting once")
    kind, *settings = (part.strip() for part in text.removeprefix(PREFIX).split(","))
    values: dict[str, str] = {}
    for setting in settings:
        key, equals, value = (part.strip() for part in setting.partition("="))
        if key not in _READERS:
            raise _error(text, f'"{key}" is not a setting of generated rooms; {_meant(key, tuple(_READERS))}')
        if not equals or not value:
            raise _error(text, f'"{key}" has no value; write {_EXAMPLES[key]}')
        if key in values:
            raise _error(text, f'"{key}" is given twice; leave one of them out')
        values[key] = value
    if kind not in KINDS:
        raise _error(text, f'"{kind}" is not a kind of room; {_meant(kind, KINDS)}')
    read = {key: _READERS[key](text, value) for key, value in values.items()}
    count = int(read.pop("count", 1))
    if not 1 <= count <= MOST_ROOMS:
        raise _error(text, f"count must be from 1 to {MOST_ROOMS}; got {count}")
    try:
        return GeneratedRooms(RoomSettings(kind=kind, **{"seed": default_seed, **read}), count)
    except ValueError as error:
        raise _error(text, str(error)) from None


def worlds_from(source: WorldSource | Sequence[WorldSource], default_seed: int = 0) -> list[World]:
    """The worlds that one source or several stand for, in their order.

    Args:
        source: worlds, paths or names of world files, sources of generated rooms; or a sequence of these.
        default_seed: the seed of generated rooms whose source names none.

    Raises:
        WorldError: for a source that cannot be used.

    >>> [world.name for world in worlds_from(["simple_train", "generate:forest,count=2"])]
    ['simple_train', 'forest-0001', 'forest-0002']
    """
    return [world for entry in _listed(source) for world in _worlds_of(entry, default_seed)]


def world_from(source: WorldSource) -> World:
    """The one world that a source stands for.

    Raises:
        WorldError: for a source that cannot be used, or that stands for several worlds.
    """
    if is_generated(source):
        rooms = parse_source(str(source))
        if rooms.count > 1:
            raise _error(str(source), f"one world is wanted here, not {rooms.count}; leave count out")
    return worlds_from(source)[0]


def check_sources(source: WorldSource | Sequence[WorldSource]) -> None:
    """Raises :class:`WorldError` for generated rooms that are asked for wrongly; files are not looked at."""
    for entry in _listed(source):
        if is_generated(entry):
            parse_source(str(entry))


def have_rooms_in_common(
    sources: Iterable[WorldSource], others: Iterable[WorldSource], seed: int = 0, other_seed: int = 0
) -> bool:
    """Whether some world of ``sources`` is one of ``others``, whatever it is called and wherever its starts and goals
    are; files that are missing are none.

    Args:
        sources: paths, names, or sources of generated rooms.
        others: the same.
        seed: of generated rooms among ``sources`` that name none.
        other_seed: of those among ``others``.
    """
    return bool({_identity(entry, seed) for entry in sources} & {_identity(entry, other_seed) for entry in others})


def short_name(source: WorldSource) -> str:
    """A source's name as part of a file's name.

    >>> short_name("worlds/complex_train.yaml"), short_name("generate:clutter,density=0.11,count=200")
    ('complex_train', 'clutter,density=0.11,count=200')
    """
    if isinstance(source, World):
        return source.name
    if is_generated(source):
        return str(source).removeprefix(PREFIX).replace(" ", "")
    return os.path.splitext(os.path.basename(os.fspath(source)))[0]


def _identity(source: WorldSource, seed: int) -> object:
    # All rooms of the same settings count as the same: they share room 1, however many there are.
    if is_generated(source):
        return parse_source(str(source), seed).settings
    try:
        world = source if isinstance(source, World) else load_world(source)
    except WorldError:
        return source
    return world.model_copy(update={"name": "", "starts": "random", "goals": "random"})


def _listed(source: WorldSource | Sequence[WorldSource]) -> list[WorldSource]:
    return [source] if isinstance(source, World | str | os.PathLike) else list(source)


def _worlds_of(source: WorldSource, default_seed: int) -> list[World]:
    if isinstance(source, World):
        return [source]
    if not is_generated(source):
        return [load_world(source)]
    rooms = parse_source(str(source), default_seed)
    try:
        return rooms.worlds()
    except ImpossibleError as error:
        raise _error(str(source), str(error)) from None


def parse_size(text: str) -> tuple[float, float]:
    """The size of a room, metres, from ``7x6``, ``7,6`` or, for a square one, ``7``.

    Raises:
        ValueError: for other text.
    """
    sides = re.split("[x×,]", text.lower())
    try:
        x, y = (float(side) for side in (sides * 2 if len(sides) == 1 else sides))
    except ValueError:
        raise ValueError(f'size must be two lengths in metres, such as 7x6; got "{text}"') from None
    return x, y


def _read_size(text: str, value: str) -> tuple[float, float]:
    try:
        return parse_size(value)
    except ValueError as error:
        raise _error(text, str(error)) from None


def _read_density(text: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise _error(text, f'density must be a share of the floor, such as 0.11; got "{value}"') from None


def _read_whole(key: str):
    def read(text: str, value: str) -> int:
        try:
            return int(value)
        except ValueError:
            raise _error(text, f'{key} must be a whole number; got "{value}"') from None

    return read


_READERS = {"size": _read_size, "density": _read_density, "seed": _read_whole("seed"), "count": _read_whole("count")}
_EXAMPLES = {"size": "size=7x7", "density": "density=0.11", "seed": "seed=1", "count": "count=200"}


def _meant(word: str, known: Sequence[str]) -> str:
    meant = difflib.get_close_matches(word.lower(), known, n=1)
    return f'did you mean "{meant[0]}"?' if meant else f"there are {', '.join(known)}"


def _error(text: str, problem: str) -> WorldError:
    return WorldError([f"{text}: {problem}"])


__all__ = [
    "PREFIX",
    "TRAINING_SEED",
    "GeneratedRooms",
    "WorldSource",
    "check_sources",
    "have_rooms_in_common",
    "is_generated",
    "parse_size",
    "parse_source",
    "short_name",
    "world_from",
    "worlds_from",
]
