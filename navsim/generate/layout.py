"""What a generator hands over: where everything stands, or how far it came."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from navsim.generate.pieces import Part


@dataclass(frozen=True)
class Layout:
    """A furnished room, whose passages are still to be checked."""

    parts: Sequence[Part]
    walls: dict[str, float] | None = None
    """The room's walls, as a world file has them; None for the usual ones."""


@dataclass(frozen=True)
class Shortfall:
    """A room that was not finished: something found no place."""

    parts: Sequence[Part]
    """What had been placed by then."""


class ImpossibleError(ValueError):
    """Settings that no room fulfils; the message says why, and what to do."""
