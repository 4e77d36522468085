"""The picture of a world that its author looks at: plan view, shortest paths, the names of things."""

from __future__ import annotations

import itertools
from pathlib import Path

from matplotlib.collections import LineCollection

from navsim.draw import VIEW, draw_world, new_figure, save_figure
from navsim.planner import shortest_path
from navsim.world import World


def save_plan_view(world: World, path: str | Path) -> Path:
    """Writes a plan view with the TurtleBot 2's shortest path between every start and goal, where both are listed.

    Args:
        world: what to draw.
        path: of the picture; its suffix says the format.

    Returns:
        ``path``.

    Raises:
        ValueError: for a format that is not supported.
    """
    figure = new_figure(8.0, 8.0)
    axes = figure.add_subplot()
    draw_world(axes, world, names=True)
    if not isinstance(world.starts, str) and not isinstance(world.goals, str):
        pairs = itertools.product(world.starts, world.goals)
        paths = [shortest_path(world, start.at, goal.at, goal_radius=0.0) for start, goal in pairs]
        lines = [path for path in paths if path is not None]
        axes.add_collection(LineCollection(lines, colors=VIEW, lw=0.8, alpha=0.5, zorder=2.9), autolim=False)
    axes.set_title(world.name)
    return save_figure(figure, path)
