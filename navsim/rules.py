"""The geometric rules of a world: what must hold between its obstacles, starts and goals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from navsim.errors import Problem

if TYPE_CHECKING:
    from navsim.world import World


def broken_rules(world: World) -> list[Problem]:
    """Every geometric rule that ``world`` breaks."""
    return []
