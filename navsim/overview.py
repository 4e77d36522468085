"""Many worlds in one picture: a contact sheet of plan views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from navsim.draw import draw_title, draw_world, new_figure, save_figure
from navsim.world import World

MOST_WORLDS = 24
"""On one sheet."""


def save_overview(
    worlds: Sequence[World], path: str | Path, *, captions: Sequence[str] | None = None, columns: int | None = None
) -> Path:
    """Writes the plan views of some worlds, side by side, with their names.

    Args:
        worlds: at least one; of more than ``MOST_WORLDS`` the first ones.
        path: of the picture; its suffix says the format.
        captions: over each plan view; by default the worlds' names.
        columns: plan views in a row; by default as many as rows, or up to two more.

    Returns:
        ``path``.

    Raises:
        ValueError: without worlds, and for a format that is not supported.
    """
    if not worlds:
        raise ValueError("an overview needs at least one world; got none")
    shown = list(worlds)[:MOST_WORLDS]
    captions = [world.name for world in shown] if captions is None else list(captions)[: len(shown)]
    columns = columns or min(len(shown), math.ceil(math.sqrt(1.5 * len(shown))))
    rows = math.ceil(len(shown) / columns)
    figure = new_figure(2.5 * columns, 2.7 * rows, dpi=100.0)
    for number, (world, caption) in enumerate(zip(shown, captions, strict=True)):
        axes = figure.add_subplot(rows, columns, number + 1)
        draw_world(axes, world, colour_bar=False, legend=False)
        axes.set_axis_off()
        draw_title(axes, caption, fontsize=9)
    return save_figure(figure, path)
