"""Pictures: the plan view of a world, robots' paths, depth images, and the animation of one episode.

Everything is drawn on the matplotlib objects it is given (or on figures of its own, without pyplot's global state), so
pictures may be made from threads, servers and notebooks alike.

>>> from navsim.draw import draw_world, new_figure, save_figure
>>> from navsim.world import World
>>> world = World.from_dict({"format": 1, "name": "hall", "size": [4, 3],
...     "obstacles": [{"box": {"at": [0, 0], "size": [0.6, 0.4], "height": 0.8}}],
...     "starts": [[-1.5, 0]], "goals": [[1.5, 0]]})
>>> figure = new_figure(5, 4)
>>> draw_world(figure.add_subplot(), world)
>>> len(figure.axes)  # the plan view and its colour bar
2
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.image import AxesImage
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Rectangle
from matplotlib.patches import Polygon as PolygonPatch

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.robot import TURTLEBOT2, Robot
from navsim.scan import metres, obstacle_depth, scan_points
from navsim.task import heading as heading_to
from navsim.world import Box, Cylinder, World

OUTCOME_COLOURS = {"success": "#0072B2", "collision": "#D55E00", "timeout": "#A0397B"}
"""Blue, vermilion and (darkened) purple after Okabe and Ito, which colour-blind readers tell apart."""
OUTCOME_LINES = {"success": "solid", "collision": (0, (5, 1.2)), "timeout": (0, (1.4, 0.9))}
OUTCOME_MARKERS = {"success": "o", "collision": "X", "timeout": "s"}

INK = "#22282f"
QUIET_INK = "#6b7480"
FLOOR = "#fbfaf8"
WALL = "#4a4742"
GOAL = "#007d5a"
START = INK
ROBOT = "#F0E442"
VIEW = "#56B4E9"
HEIGHT_COLOURS = LinearSegmentedColormap.from_list("heights", ["#e6dfd1", "#b3a793", "#7b7162", "#454039"])
DEPTH_COLOURS = "viridis_r"
NO_RETURN = "#d9dce0"

ACTION_LABELS = ("slow", "fast", "left π/4", "left π/8", "straight", "right π/8", "right π/4")
"""The seven actions of ``navsim.robot.ACTIONS`` in words."""


def new_figure(width: float, height: float, *, dpi: float = 110.0) -> Figure:
    """An empty figure of ``width`` × ``height`` inches on an Agg canvas, laid out by matplotlib's constrained layout."""
    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as the file's suffix says (.png, .svg, .pdf, …), making its directory; returns the path."""
    path = Path(path)
    supported = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in supported:
        raise ValueError(f"{path}: pictures are written as {', '.join('.' + s for s in sorted(supported))}")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def figure_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


# The plan view


def draw_world(
    axes: Axes,
    world: World,
    *,
    names: bool = False,
    starts: bool = True,
    goals: bool = True,
    colour_bar: bool = True,
    legend: bool = True,
    camera: DepthCamera = DepthCamera(),  # noqa: B008 - frozen
    robot: Robot = TURTLEBOT2,
) -> None:
    """Draw a world from above: floor, walls, obstacles coloured by the height of their tops, starts and goals.

    Obstacles lower than the camera are hatched with lines, those that the robot passes under with dots and a broken
    outline: a planar laser at the camera's height would miss both.

    Args:
        axes: where to draw; its limits, aspect and ticks are set.
        world: what to draw.
        names: write each obstacle's name on it.
        starts: mark the starts, numbered as in the file, with an arrow where the yaw is given.
        goals: mark the goals, numbered as in the file.
        colour_bar: add the scale of heights beside the axes.
        legend: explain the marks under the axes.
        camera: obstacles whose tops are under ``camera.mount_z`` are low.
        robot: obstacles whose bases are at ``robot.height`` or above are clear of it.
    """
    half_x, half_y = (float(half) for half in world.half_size)
    margin = 0.0
    if world.walls is not None:
        margin = world.walls.thickness
        axes.add_patch(
            Rectangle(
                (-half_x - margin, -half_y - margin), 2 * (half_x + margin), 2 * (half_y + margin), fc=WALL, ec="none"
            )
        )
    axes.add_patch(Rectangle((-half_x, -half_y), 2 * half_x, 2 * half_y, fc=FLOOR, ec="none"))

    heights = Normalize(0.0, max([1.0, *(obstacle.top for obstacle in world.obstacles)]))
    low = [obstacle.top <= camera.mount_z for obstacle in world.obstacles]
    raised = [obstacle.base >= robot.height for obstacle in world.obstacles]
    for index in sorted(range(len(world.obstacles)), key=lambda index: world.obstacles[index].top):
        obstacle = world.obstacles[index]
        colour = HEIGHT_COLOURS(heights(obstacle.top))
        axes.add_patch(_obstacle_patch(obstacle, colour, low=low[index], raised=raised[index]))
        if names:
            x, y = _middle(obstacle)
            text = axes.text(x, y, obstacle.name, fontsize=6.5, ha="center", va="center", color=INK, zorder=6)
            text.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="white")])

    if starts and world.starts != "random":
        _draw_starts(axes, world, robot)
    if goals and world.goals != "random":
        for index, goal in enumerate(world.goals):
            _draw_goal(axes, goal.at, str(index))

    axes.set_xlim(-half_x - margin, half_x + margin)
    axes.set_ylim(-half_y - margin, half_y + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x, m", fontsize=8, color=QUIET_INK)
    axes.set_ylabel("y, m", fontsize=8, color=QUIET_INK)
    axes.tick_params(labelsize=8, color=QUIET_INK, labelcolor=QUIET_INK)
    for spine in axes.spines.values():
        spine.set_visible(False)
    if colour_bar and world.obstacles:
        _draw_scale(axes, ScalarMappable(heights, HEIGHT_COLOURS), "top of the obstacle, m")
    if legend:
        handles = _world_legend(world, any(low), any(raised), starts=starts, goals=goals, camera=camera, robot=robot)
        if handles:
            axes.legend(
                handles=handles,
                loc="upper center",
                bbox_to_anchor=(0.5, -0.09),
                ncols=2 if len(handles) > 2 else len(handles),
                fontsize=8,
                frameon=False,
                labelcolor=INK,
            )


def _draw_scale(axes: Axes, mappable: ScalarMappable, label: str) -> None:
    """A colour bar as high as the axes, on their right."""
    bar = axes.figure.colorbar(mappable, cax=axes.inset_axes((1.025, 0.0, 0.03, 1.0)))
    bar.set_label(label, fontsize=8, color=QUIET_INK)
    bar.ax.tick_params(labelsize=8, color=QUIET_INK, labelcolor=QUIET_INK)
    bar.outline.set_visible(False)  # type: ignore[operator]


def _obstacle_patch(obstacle: Any, colour: Any, *, low: bool, raised: bool) -> Patch:
    style: dict[str, Any] = {"facecolor": colour, "edgecolor": INK, "linewidth": 0.7, "zorder": 2.0 + obstacle.top / 100}
    if low:
        style["hatch"] = "//////"
    if raised:
        style |= {"hatch": "...", "linestyle": (0, (3, 1.5)), "alpha": 0.75}
    style["hatch_linewidth"] = 0.5
    if isinstance(obstacle, Cylinder):
        return Circle(obstacle.at, obstacle.radius, **style)
    return PolygonPatch(_corners(obstacle), closed=True, joinstyle="miter", **style)


def _corners(obstacle: Any) -> np.ndarray:
    """Footprint (V, 2) of a box or a polygon, metres."""
    if isinstance(obstacle, Box):
        yaw = math.radians(obstacle.yaw_deg)
        half = 0.5 * np.asarray(obstacle.size) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        return half @ turn + np.asarray(obstacle.at)
    return np.asarray(obstacle.points, dtype=float)


def _middle(obstacle: Any) -> np.ndarray:
    return np.asarray(obstacle.at if hasattr(obstacle, "at") else _corners(obstacle).mean(axis=0), dtype=float)


def _draw_starts(axes: Axes, world: World, robot: Robot) -> None:
    for index, start in enumerate(world.starts):
        x, y = start.at  # type: ignore[union-attr]
        axes.add_patch(Circle((x, y), robot.radius, fc="white", ec=START, lw=1.1, zorder=5))
        if start.yaw_deg is not None:  # type: ignore[union-attr]
            yaw = math.radians(start.yaw_deg)  # type: ignore[union-attr]
            tip = (x + 0.42 * math.cos(yaw), y + 0.42 * math.sin(yaw))
            base = (x + robot.radius * math.cos(yaw), y + robot.radius * math.sin(yaw))
            axes.add_patch(
                FancyArrowPatch(base, tip, arrowstyle="-|>", mutation_scale=9, color=START, lw=1.2, shrinkA=0, zorder=5)
            )
        axes.text(x, y, str(index), fontsize=7, ha="center", va="center_baseline", color=START, zorder=6)


def _draw_goal(axes: Axes, at: Sequence[float], label: str = "") -> None:
    axes.plot(*at, marker="D", ms=6.5 if label else 7, mfc=GOAL, mec="white", mew=0.9, ls="none", zorder=5)
    if label:
        text = axes.annotate(
            label, at, xytext=(4.5, 3.5), textcoords="offset points", fontsize=7, color=GOAL, weight="bold", zorder=6
        )
        text.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="white")])


def _world_legend(
    world: World, any_low: bool, any_raised: bool, *, starts: bool, goals: bool, camera: DepthCamera, robot: Robot
) -> list[Any]:
    handles: list[Any] = []
    middle = HEIGHT_COLOURS(0.3)
    if starts and world.starts != "random":
        handles.append(Line2D([], [], ls="none", marker="o", ms=8, mfc="white", mec=START, label="start"))
    if goals and world.goals != "random":
        handles.append(Line2D([], [], ls="none", marker="D", ms=6.5, mfc=GOAL, mec="white", label="goal"))
    if any_low:
        label = f"lower than the camera ({camera.mount_z:g} m)"
        handles.append(Patch(fc=middle, ec=INK, lw=0.7, hatch="//////", hatch_linewidth=0.5, label=label))
    if any_raised:
        label = f"the robot ({robot.height:g} m) fits under"
        handles.append(Patch(fc=middle, ec=INK, lw=0.7, hatch="...", hatch_linewidth=0.5, ls="--", label=label))
    return handles


def draw_paths(
    axes: Axes,
    trajectories: Sequence[np.ndarray],
    outcomes: Sequence[str],
    *,
    legend: bool = True,
    line_width: float = 1.1,
    alpha: float = 0.8,
) -> None:
    """Draw robots' paths on a plan view, coloured and dashed by how they ended, with a mark at each end.

    Args:
        axes: a plan view that :func:`draw_world` drew.
        trajectories: of each robot, ``(K, 2)`` positions or ``(K, 3)`` poses, metres.
        outcomes: of each robot, ``"success"``, ``"collision"`` or ``"timeout"``.
        legend: say above the axes how many ended each way.
        line_width: of the paths, points.
        alpha: opacity of the paths.

    Raises:
        ValueError: an outcome is none of the three, or the two sequences differ in length.
    """
    unknown = sorted(set(outcomes) - set(OUTCOME_COLOURS))
    if unknown:
        raise ValueError(f"outcome {unknown[0]!r}: a path ends in {', '.join(OUTCOME_COLOURS)}")
    if len(trajectories) != len(outcomes):
        raise ValueError(f"{len(trajectories)} trajectories with {len(outcomes)} outcomes: give one for each")
    handles = []
    # Failures are fewer and matter more: they are drawn over the successes.
    for order, (outcome, colour) in enumerate(OUTCOME_COLOURS.items()):
        lines = [np.asarray(path)[:, :2] for path, end in zip(trajectories, outcomes, strict=True) if end == outcome]
        if not lines:
            continue
        axes.add_collection(
            LineCollection(
                lines, colors=colour, linestyles=[OUTCOME_LINES[outcome]], lw=line_width, alpha=alpha, zorder=3 + order / 10
            ),
            autolim=False,
        )
        ends = np.array([line[-1] for line in lines])
        marker = OUTCOME_MARKERS[outcome]
        axes.scatter(*ends.T, s=16, marker=marker, fc=colour, ec="white", lw=0.4, alpha=alpha, zorder=4 + order / 10)
        handles.append(
            Line2D([], [], color=colour, ls=OUTCOME_LINES[outcome], lw=1.6, marker=marker, label=f"{len(lines)} {outcome}")
        )
    if legend and handles:
        # A second legend beside the plan view's; unclipped, or the layout would not make room for it.
        axes.add_artist(
            Legend(
                axes,
                handles,
                [handle.get_label() for handle in handles],
                loc="lower center",
                bbox_to_anchor=(0.5, 1.0),
                ncols=3,
                fontsize=8,
                frameon=False,
                labelcolor=INK,
                handlelength=3,
            )
        ).set_clip_on(False)


# Depth images


def depth_colours() -> Colormap:
    """The perceptually uniform colours of depth images, near bright and far dark, with "no return" set apart in grey."""
    from matplotlib import colormaps

    return colormaps[DEPTH_COLOURS].with_extremes(bad=NO_RETURN)


def draw_depth(
    axes: Axes, depth: np.ndarray, camera: DepthCamera = DepthCamera(), *, colour_bar: bool = True  # noqa: B008 - frozen
) -> AxesImage:
    """Draw a depth image, 0 to ``camera.max_range`` metres, "no return" in grey; returns the image artist.

    Args:
        axes: where to draw; its ticks are removed.
        depth: ``(H, W)``, ``uint8`` counts as the networks get them or float metres; 0 is "no return".
        camera: gives the range of the scale.
        colour_bar: add the scale beside the axes.
    """
    image = axes.imshow(
        _masked(depth, camera), cmap=depth_colours(), vmin=0.0, vmax=camera.max_range, interpolation="nearest"
    )
    # Pixels are stretched so that the picture has the shape of the field of view.
    half_width = math.tan(math.radians(camera.horizontal_fov_deg) / 2)
    half_height = math.tan(math.radians(camera.vertical_fov_deg) / 2)
    axes.set_aspect((half_height / depth.shape[0]) / (half_width / depth.shape[1]))
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    if colour_bar:
        _draw_scale(axes, image, "depth, m")
        if (np.asarray(depth) == 0).any():
            handle = Patch(fc=NO_RETURN, label="no return")
            axes.legend(
                handles=[handle], loc="upper right", bbox_to_anchor=(1.0, 0.0), fontsize=8, frameon=False, labelcolor=INK
            )
    return image


def _masked(depth: np.ndarray, camera: DepthCamera) -> np.ma.MaskedArray:
    return np.ma.masked_equal(metres(depth, camera), 0.0)


def draw_depth_stack(
    figure: Figure | SubFigure,
    stack: np.ndarray,
    heading: float,
    q_values: Sequence[float] | np.ndarray,
    camera: DepthCamera = DepthCamera(),  # noqa: B008 - frozen
) -> None:
    """Draw what a network sees and what it makes of it: four depth images, the goal's direction, and seven Q-values.

    Args:
        figure: an empty figure or subfigure.
        stack: ``(4, H, W)`` depth images, oldest first, ``uint8`` counts or float metres.
        heading: the goal's bearing in the robot's frame, radians, left positive.
        q_values: of the seven actions; the greatest is the action taken, drawn in colour.
        camera: gives the range of the depth scale.
    """
    stack = np.asarray(stack)
    grid = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.25))
    images = grid[0].subgridspec(1, len(stack), wspace=0.03)
    for index, depth in enumerate(stack):
        axes = figure.add_subplot(images[index])
        image = draw_depth(axes, depth, camera, colour_bar=False)
        age = len(stack) - 1 - index
        axes.set_title("now" if age == 0 else f"{0.2 * age:.1f} s ago", fontsize=9, color=INK)
    _draw_scale(axes, image, "depth, m")
    lower = grid[1].subgridspec(1, 2, width_ratios=(1.0, 2.6))
    draw_heading(figure.add_subplot(lower[0]), heading)
    draw_q_values(figure.add_subplot(lower[1]), q_values)


def draw_heading(axes: Axes, heading: float) -> None:
    """Draw the goal's direction, radians, left positive, as an arrow from a robot that faces up the page."""
    axes.add_patch(Circle((0, 0), 1.0, fc=FLOOR, ec=QUIET_INK, lw=0.8))
    for angle in np.arange(0, 360, 45):
        direction = np.array([-math.sin(math.radians(angle)), math.cos(math.radians(angle))])
        axes.plot(*np.stack([0.93 * direction, direction], axis=1), color=QUIET_INK, lw=0.8)
    axes.add_patch(Circle((0, 0), 0.2, fc=ROBOT, ec=INK, lw=1.0, zorder=3))
    axes.plot([0, 0], [0, 0.2], color=INK, lw=1.2, zorder=4)
    tip = (-0.85 * math.sin(heading), 0.85 * math.cos(heading))
    axes.add_patch(
        FancyArrowPatch((0, 0), tip, arrowstyle="-|>", mutation_scale=16, lw=2.2, color=GOAL, shrinkA=0, zorder=2)
    )
    axes.text(0, 1.1, "ahead", fontsize=8, ha="center", va="bottom", color=QUIET_INK)
    side = "left" if heading > 0 else "right"
    axes.set_title(f"goal: {abs(math.degrees(heading)):.0f}° to the {side}", fontsize=9, color=INK, y=-0.12)
    axes.set_xlim(-1.15, 1.15)
    axes.set_ylim(-1.15, 1.3)
    axes.set_aspect("equal")
    axes.axis("off")


def draw_q_values(axes: Axes, q_values: Sequence[float] | np.ndarray) -> None:
    """Draw the seven Q-values as bars from the least of them; the greatest, the greedy action, in colour."""
    values = np.asarray(q_values, dtype=float)
    best = int(values.argmax())
    spread = max(float(np.ptp(values)), 1e-6)
    floor = float(values.min()) - 0.25 * spread
    positions = np.arange(len(values))
    colours = [OUTCOME_COLOURS["success"] if index == best else "#b9c0c8" for index in positions]
    axes.bar(positions, values - floor, bottom=floor, color=colours, width=0.72)
    for index, value in enumerate(values):
        weight = "bold" if index == best else "normal"
        axes.text(index, value + 0.02 * spread, f"{value:.3f}", fontsize=8, ha="center", va="bottom", weight=weight, color=INK)
    axes.set_xticks(positions, ACTION_LABELS[: len(values)], fontsize=8, color=INK)
    axes.set_ylim(floor, float(values.max()) + 0.18 * spread)
    axes.set_ylabel("Q", fontsize=9, color=QUIET_INK)
    axes.tick_params(axis="y", labelsize=8, labelcolor=QUIET_INK, color=QUIET_INK)
    axes.tick_params(axis="x", length=0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(QUIET_INK)


# The animation of one episode

ANIMATION_SUFFIXES = (".gif", ".mp4")


def animate_episode(
    path: str | Path,
    world: World,
    poses: np.ndarray,
    goal: Sequence[float],
    *,
    actions: Sequence[int] | np.ndarray | None = None,
    outcome: str | None = None,
    camera: DepthCamera = DepthCamera(),  # noqa: B008 - frozen
    robot: Robot = TURTLEBOT2,
    goal_radius: float = 0.5,
    control_period: float = 0.2,
    speed: float = 2.0,
) -> Path:
    """Write one episode as a GIF or an MP4: the plan view beside the depth image that the robot sees.

    Args:
        path: where to write; the suffix, ``.gif`` or ``.mp4``, chooses the format. Its directory is made.
        world: where the robot drives.
        poses: ``(K, 3)``, x, y, yaw at the start and after each step.
        goal: x, y, metres.
        actions: the action taken at each of the K − 1 steps, written under the depth image.
        outcome: ``"success"``, ``"collision"`` or ``"timeout"``, shown on the last frame, which stays for a second.
        camera: what the robot sees with.
        robot: drawn to scale.
        goal_radius: of the disc that counts as the goal, metres.
        control_period: time between poses, seconds.
        speed: how many times faster than real time it plays.

    Returns:
        The path.

    Raises:
        ValueError: the suffix is neither of the two, or there are no poses.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATION_SUFFIXES:
        raise ValueError(f"{path}: animations are written as {' or '.join(ANIMATION_SUFFIXES)}")
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise ValueError(f"poses have the shape {poses.shape}: give (K, 3), x, y, yaw at each of K times")
    frames_per_second = speed / control_period
    frames = _episode_frames(
        world,
        poses,
        np.asarray(goal, dtype=float),
        actions,
        outcome,
        camera,
        robot,
        goal_radius,
        control_period,
        hold=round(frames_per_second),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".gif":
        _write_gif(path, list(frames), frames_per_second)
    else:
        images = np.stack(list(frames))
        # yuv420p is what browsers and phones play; it needs even sides, which the figure has.
        imageio.imwrite(path, images, fps=frames_per_second, codec="libx264", macro_block_size=2, pixelformat="yuv420p")
    return path


def _episode_frames(
    world: World,
    poses: np.ndarray,
    goal: np.ndarray,
    actions: Sequence[int] | np.ndarray | None,
    outcome: str | None,
    camera: DepthCamera,
    robot: Robot,
    goal_radius: float,
    control_period: float,
    hold: int,
) -> Iterator[np.ndarray]:
    """RGB frames (h, w, 3) uint8: the background is drawn once, each frame only redraws what moves."""
    depths = camera.to_uint8(render_depth(world, poses, camera))
    headings = heading_to(poses, np.broadcast_to(goal, (len(poses), 2)))
    view = _view_polygons(depths, poses, camera)

    figure = Figure(figsize=(9.6, 5.2), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    plan = figure.add_axes((0.01, 0.02, 0.525, 0.96))
    draw_world(plan, world, starts=False, goals=False, colour_bar=False, legend=False, camera=camera, robot=robot)
    plan.axis("off")
    plan.add_patch(Circle(tuple(goal), goal_radius, fc=GOAL, ec=GOAL, alpha=0.25, zorder=1.5))
    _draw_goal(plan, goal)
    plan.plot(*poses[0, :2], marker="o", ms=5, mfc="white", mec=QUIET_INK, zorder=3)

    sight = figure.add_axes((0.56, 0.37, 0.36, 0.56))
    image = draw_depth(sight, depths[0], camera, colour_bar=False)
    sight.set_title("what the camera sees", fontsize=10, color=INK, loc="left")
    _draw_scale(sight, image, "depth, m")
    dial = figure.add_axes((0.555, 0.03, 0.15, 0.29))
    dial.add_patch(Circle((0, 0), 1.0, fc=FLOOR, ec=QUIET_INK, lw=0.8))
    dial.add_patch(Circle((0, 0), 0.2, fc=ROBOT, ec=INK, lw=1.0, zorder=3))
    dial.plot([0, 0], [0, 0.2], color=INK, lw=1.2, zorder=4)
    dial.text(0, 1.06, "ahead", fontsize=7, ha="center", va="bottom", color=QUIET_INK)
    dial.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.3), aspect="equal")
    dial.axis("off")

    trail_halo = Line2D([], [], color="white", lw=3.4, alpha=0.8, zorder=3.2)
    trail = Line2D([], [], color=OUTCOME_COLOURS["success"], lw=1.8, zorder=3.3)
    cone = PolygonPatch(view[0], closed=True, fc=VIEW, ec=VIEW, lw=0.8, alpha=0.3, zorder=3.1)
    body = Circle(tuple(poses[0, :2]), robot.radius, fc=ROBOT, ec=INK, lw=1.1, zorder=4)
    nose = Line2D([], [], color=INK, lw=1.4, zorder=4.1)
    needle = PolygonPatch(_needle(headings[0]), closed=True, fc=GOAL, ec="none")
    words = figure.text(0.725, 0.29, "", fontsize=10, color=INK, va="top", linespacing=1.7)
    verdict = figure.text(0.725, 0.09, "", fontsize=13, weight="bold", va="top")
    for patch in (cone, body):
        plan.add_patch(patch)
    for line in (trail_halo, trail, nose):
        plan.add_line(line)
    dial.add_patch(needle)
    moving = (cone, trail_halo, trail, body, nose, image, needle, words, verdict)
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    for index, (x, y, yaw) in enumerate(poses):
        last = index == len(poses) - 1
        cone.set_xy(view[index])
        for line in (trail_halo, trail):
            line.set_data(*poses[: index + 1, :2].T)
        body.center = (x, y)
        nose.set_data([x, x + robot.radius * math.cos(yaw)], [y, y + robot.radius * math.sin(yaw)])
        image.set_data(_masked(depths[index], camera))
        needle.set_xy(_needle(headings[index]))
        action = "" if actions is None or index >= len(actions) else ACTION_LABELS[int(actions[index])]
        distance = math.hypot(*(goal - poses[index, :2]))
        words.set_text(f"time {index * control_period:5.1f} s\nto the goal {distance:.2f} m\n{action and 'action: ' + action}")
        if last and outcome is not None:
            verdict.set_text(outcome)
            verdict.set_color(OUTCOME_COLOURS[outcome])
            trail.set_color(OUTCOME_COLOURS[outcome])
        canvas.restore_region(background)  # type: ignore[no-untyped-call]
        for artist in moving:
            artist.axes.draw_artist(artist) if artist.axes is not None else figure.draw_artist(artist)
        frame = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        for _ in range(hold if last else 1):
            yield frame


def _needle(heading: float) -> np.ndarray:
    """A slim arrow (4, 2) from the middle of the unit circle towards a heading, radians; ahead is up."""
    ahead = np.array([-math.sin(heading), math.cos(heading)])
    left = np.array([-ahead[1], ahead[0]])
    return np.stack([0.92 * ahead, 0.3 * ahead + 0.16 * left, 0.42 * ahead, 0.3 * ahead - 0.16 * left])


def _view_polygons(depths: np.ndarray, poses: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """What the camera sees of the floor plane in each frame, (K, W + 1, 2) metres in the world's frame."""
    ahead = scan_points(obstacle_depth(depths, camera), camera)
    eye = np.broadcast_to((camera.mount_x, camera.mount_y), (*ahead.shape[:-2], 1, 2))
    outline = np.concatenate([eye, ahead], axis=-2)
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = outline[..., 0], outline[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + poses[:, None, :2]


def _write_gif(path: Path, frames: list[np.ndarray], frames_per_second: float) -> None:
    from PIL import Image

    # One palette for all frames: quick to apply, and still areas stay still, so that only changes are stored.
    sample = np.concatenate(frames[:: max(1, len(frames) // 6)], axis=0)
    palette = Image.fromarray(sample).quantize(colors=256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    indexed = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = round(1000.0 / frames_per_second)
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=duration, loop=0, optimize=False)
