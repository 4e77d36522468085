"""The picture of a world that its author looks at: plan view, shortest paths, names, what the robot sees somewhere."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.patches import Polygon as PolygonPatch

from navsim.camera import DepthCamera
from navsim.draw import (
    GOAL,
    INK,
    QUIET_INK,
    ROBOT,
    VIEW,
    draw_depth,
    draw_title,
    draw_world,
    figure_png,
    new_figure,
    save_figure,
)
from navsim.errors import WorldError
from navsim.planner import shortest_path
from navsim.raycast import render_depth
from navsim.robot import TURTLEBOT2
from navsim.scan import obstacle_depth, scan_points
from navsim.task import Task
from navsim.world import World

MOST_PATHS = 400
"""Pairs of a start and a goal whose shortest paths are drawn."""
_PATH = "#3b7ea8"
_SHARP = DepthCamera(width=320, height=256)


def parse_pose(text: str) -> tuple[float, float, float]:
    """A pose x, y (metres) and yaw (radians) of ``"x,y,yaw"``, with the yaw in degrees.

    >>> parse_pose("1, -2.5, 90")[:2]
    (1.0, -2.5)

    Raises:
        WorldError: when ``text`` is not three finite numbers.
    """
    try:
        x, y, yaw = (float(part) for part in text.split(","))
        if not all(map(math.isfinite, (x, y, yaw))):
            raise ValueError
    except ValueError:
        example = "three numbers x,y,yaw (metres and degrees), such as 1,-2.5,90"
        raise WorldError([f"{text!r} is not a place to look from; write {example}"]) from None
    return x, y, math.radians(yaw)


def save_plan_view(
    world: World, path: str | Path, *, names: bool = True, pose: tuple[float, float, float] | None = None
) -> Path:
    """Writes a plan view with the TurtleBot 2's shortest path between every start and goal, where both are listed.

    Args:
        world: what to draw.
        path: of the picture; its suffix says the format.
        names: write the obstacles' names on them.
        pose: x, y, metres, and yaw, radians, of a robot whose view is drawn beside the plan.

    Returns:
        ``path``.

    Raises:
        ValueError: for a format that is not supported.
    """
    return save_figure(_plan_view(world, names, pose), path)


def plan_png(world: World) -> bytes:
    """A small plan view as the bytes of a PNG file, for notebooks; without paths, names and legends, to be quick."""
    width, height = _extents(world)
    scale = 4.2 / max(width, height)
    size = np.array([0.75 + scale * width, 0.8 + scale * height])  # inches, with room for a title and for ticks
    figure = new_figure(*size, dpi=80.0)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.6 / size[0], 0.45 / size[1], scale * width / size[0], scale * height / size[1]))
    draw_world(axes, world, colour_bar=False, legend=False)
    draw_title(axes, world.name, fontsize=10, color=INK)
    return figure_png(figure)


def _extents(world: World) -> tuple[float, float]:
    """Of the room with its walls, metres, but no less than a quarter of one another."""
    margin = 0.0 if world.walls is None else 2.0 * world.walls.thickness
    width, height = world.size[0] + margin, world.size[1] + margin
    return max(width, 0.25 * height), max(height, 0.25 * width)


def _plan_view(world: World, names: bool, pose: tuple[float, float, float] | None) -> Figure:
    width, height = _extents(world)
    scale = 7.2 / max(width, height)
    plan_width, plan_height = 1.6 + scale * width, 1.9 + scale * height
    if pose is None:
        figure = new_figure(plan_width, plan_height, dpi=130.0)
        axes = figure.add_subplot()
    else:
        figure = new_figure(plan_width + 5.6, max(plan_height, 5.4), dpi=130.0)
        axes, beside = figure.subplots(1, 2, width_ratios=(plan_width, 5.6))
        _draw_view(axes, beside, world, pose)
    draw_world(axes, world, names=names)
    handles: list[Line2D | Patch] = [*_draw_goal_discs(axes, world), *_draw_paths(axes, world)]
    if pose is not None:
        handles += [
            Line2D([], [], ls="none", marker="o", ms=8, mfc=ROBOT, mec=INK, label="the robot"),
            Patch(fc=VIEW, alpha=0.35, label="floor in its view"),
        ]
    _add_to_legend(axes, handles)
    draw_title(axes, world.name, fontsize=13, color=INK, pad=10)
    return figure


def _draw_goal_discs(axes: Axes, world: World) -> list[Patch]:
    """The floor around each goal where it counts as reached."""
    if isinstance(world.goals, str):
        return []
    radius = Task().goal_radius
    style: dict[str, Any] = {"fc": GOAL, "ec": GOAL, "lw": 0.6, "alpha": 0.13}
    for goal in world.goals:
        axes.add_patch(Circle(goal.at, radius, zorder=1.8, **style))
    return [Patch(label=f"goal reached (within {radius:g} m)", **style)]


def _draw_paths(axes: Axes, world: World) -> list[Line2D]:
    if isinstance(world.starts, str) or isinstance(world.goals, str):
        return []
    pairs = [(world.starts[i].at, world.goals[j].at) for i, j in world.paths[:MOST_PATHS]]
    paths = [shortest_path(world, start, goal, goal_radius=0.0) for start, goal in pairs]
    lines = [path for path in paths if path is not None]
    faint = 0.75 if len(lines) <= 12 else 0.4
    axes.add_collection(LineCollection(lines, colors=_PATH, lw=0.9, alpha=faint, zorder=2.95), autolim=False)
    told = "shortest paths" if len(world.paths) <= MOST_PATHS else f"shortest paths (the first {MOST_PATHS})"
    return [Line2D([], [], color=_PATH, lw=1.4, label=told)]


def _draw_view(axes: Axes, beside: Axes, world: World, pose: tuple[float, float, float]) -> None:
    """What the robot sees at ``pose``, in ``beside``; where it stands and the floor that it sees, on the plan."""
    x, y, yaw = pose
    image = render_depth(world, np.array([pose]), _SHARP)[0]
    points = scan_points(obstacle_depth(image, _SHARP), _SHARP)
    outline = np.concatenate([[(_SHARP.mount_x, _SHARP.mount_y)], points])
    turn = np.array([(math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))])
    axes.add_patch(PolygonPatch(outline @ turn + (x, y), fc=VIEW, ec=VIEW, lw=0.8, alpha=0.35, zorder=1.9))
    axes.add_patch(Circle((x, y), TURTLEBOT2.radius, fc=ROBOT, ec=INK, lw=1.1, zorder=5.5))
    nose = (x + TURTLEBOT2.radius * math.cos(yaw), y + TURTLEBOT2.radius * math.sin(yaw))
    axes.plot((x, nose[0]), (y, nose[1]), color=INK, lw=1.6, solid_capstyle="round", zorder=5.6)
    draw_depth(beside, image, _SHARP)
    beside.set_anchor("N")
    beside.set_title(f"seen from ({x:g}, {y:g}), facing {math.degrees(yaw):g}°", fontsize=11, color=INK, pad=10)
    nearest = float(image.min())
    told = "inside an obstacle" if nearest <= 0.0 else f"nearest: {nearest:.2f} m"
    beside.set_xlabel(told, fontsize=9, color=QUIET_INK)


def _add_to_legend(axes: Axes, handles: list[Line2D | Patch]) -> None:
    before = axes.get_legend()
    every = [*(before.legend_handles if before else ()), *handles]
    if every:
        axes.legend(
            handles=every,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.065),
            ncols=min(3, len(every)),
            fontsize=8,
            frameon=False,
            labelcolor=INK,
        )
