"""Pictures: the plan view of a world, robots' paths, depth images, and what a network makes of them.

Everything is drawn on the matplotlib objects it is given (or on figures of its own, without pyplot's global state), so
pictures may be made from threads, servers and notebooks alike.

>>> from navsim.draw import draw_world, figure_png, new_figure
>>> from navsim.world import World
>>> world = World.from_dict({"format": 1, "name": "hall", "size": [4, 3],
...     "obstacles": [{"box": {"at": [0, 0], "size": [0.6, 0.4], "height": 0.8}}],
...     "starts": [[-1.5, 0]], "goals": [[1.5, 0]]})
>>> figure = new_figure(5, 4)
>>> draw_world(figure.add_subplot(), world)
>>> figure_png(figure)[1:4]
b'PNG'
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, patheffects
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
from navsim.dynamics import dynamic_obstacles, placed
from navsim.files import atomic_write
from navsim.lettering import lettering
from navsim.polygon import signed_area
from navsim.robot import TURTLEBOT2, Robot
from navsim.scan import metres
from navsim.world import Box, Cylinder, Obstacle, Polygon, Start, Swing, World

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
MOTION = "#6a3d9a"
PUSHABLE = "#0b7285"
HEIGHT_COLOURS = LinearSegmentedColormap.from_list("heights", ["#e6dfd1", "#b3a793", "#7b7162", "#454039"])
DEPTH_COLOURS = "viridis_r"
PICTURE_SUFFIXES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps", ".ps", ".svgz")
"""Of the files that ``save_figure`` writes. Matplotlib has more: pixels without a header, and what takes TeX."""
NO_RETURN = "#d9dce0"

ACTION_LABELS = ("slow", "fast", "left π/4", "left π/8", "straight", "right π/8", "right π/4")
"""The seven actions of ``navsim.robot.ACTIONS`` in words."""


def new_figure(width: float, height: float, *, dpi: float = 110.0) -> Figure:
    """An empty figure of ``width`` × ``height`` inches on an Agg canvas, laid out without overlaps."""
    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as the file's suffix says (.png, .svg, .pdf, …), making its directory; returns the path."""
    path = check_picture(path)
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format=path.suffix[1:].lower())
    return path


def check_picture(path: str | Path) -> Path:
    """A picture's path, if ``save_figure`` can write it.

    Raises:
        ValueError: for a suffix that no picture has which matplotlib writes by itself, and for a directory.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ValueError(f"{path}: pictures are written as {', '.join(PICTURE_SUFFIXES)}")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; name the picture's file, such as {path / 'picture.png'}")
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
    dynamic: bool = True,
    camera: DepthCamera | None = None,
    robot: Robot = TURTLEBOT2,
) -> None:
    """Draw a world from above: floor, walls, obstacles coloured by the height of their tops, starts and goals.

    What a planar laser at the camera's height would miss is hatched: obstacles lower than the camera with slanted
    lines, those that the robot passes under with dots and a broken outline, those off the floor that it does not pass
    under with crossed lines. What moves is outlined in violet, with its way and, where that leads there and back, its
    outline at the other end; what can be pushed is outlined in dark cyan.

    Args:
        axes: where to draw; its limits, aspect and ticks are set.
        world: what to draw.
        names: write each obstacle's name on it.
        starts: mark the starts, numbered as in the file, with an arrow where the yaw is given.
        goals: mark the goals, numbered as in the file.
        colour_bar: add the scale of heights beside the axes.
        legend: explain the marks under the axes.
        dynamic: draw what moves or can be pushed, where the file puts it.
        camera: obstacles whose tops are under ``camera.mount_z`` are low.
        robot: obstacles whose bases are at ``robot.height`` or above are clear of it.
    """
    camera = camera or DepthCamera()
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

    heights = _heights(world)
    kinds = [_kind(obstacle, camera, robot) for obstacle in world.obstacles]
    most_arrows = MOST_ARROWS // max(1, sum(obstacle.motion is not None for obstacle in world.obstacles))
    for index in sorted(range(len(world.obstacles)), key=lambda index: world.obstacles[index].top):
        obstacle = world.obstacles[index]
        if not dynamic and (obstacle.motion is not None or obstacle.pushable is not None):
            continue
        axes.add_patch(obstacle_patch(obstacle, heights, kinds[index]))
        if obstacle.motion is not None:
            _draw_motion(axes, obstacle, most_arrows)
    if names:
        _draw_names(axes, world)
    if starts and not isinstance(world.starts, str):
        _draw_starts(axes, world.starts, robot)
    if goals and not isinstance(world.goals, str):
        for index, goal in enumerate(world.goals):
            draw_goal(axes, goal.at, str(index))

    axes.set_xlim(-half_x - margin, half_x + margin)
    axes.set_ylim(-half_y - margin, half_y + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x, m", fontsize=8, color=QUIET_INK)
    axes.set_ylabel("y, m", fontsize=8, color=QUIET_INK)
    axes.tick_params(labelsize=8, color=QUIET_INK, labelcolor=QUIET_INK)
    for spine in axes.spines.values():
        spine.set_visible(False)
    if colour_bar and world.obstacles:
        draw_scale(axes, ScalarMappable(heights, HEIGHT_COLOURS), "top of the obstacle, m")
    if legend:
        handles = _world_legend(world, kinds, starts=starts, goals=goals, camera=camera, robot=robot)
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


MOST_NAMES = 300
"""That are written on a plan: more cannot be read, and each takes its time to find a place."""
MOST_ARROWS = 600
"""That are drawn on the ways of moving obstacles, of all together."""
_NAME_SIZE = 6.5  # points
_ASIDE = tuple(_NAME_SIZE * np.array([(x, y) for y in (0, 1.3, -1.3, 2.6, -2.6) for x in (0, 2.5, -2.5)]))
"""Where a name may go instead of on the middle of its obstacle, points, in the order in which they are tried."""


def draw_title(axes: Axes, name: str, **settings: Any) -> None:
    """Write a name from a file over a plot, in whatever letters it is; ``settings`` are those of ``Axes.set_title``."""
    text, families = lettering(name)
    axes.set_title(text, fontfamily=families, parse_math=False, **settings)


def _draw_names(axes: Axes, world: World) -> None:
    """Writes obstacles' names on them, or beside them where another name is in the way: the ``MOST_NAMES`` largest."""
    room = axes.get_window_extent()
    points = 72.0 / axes.figure.dpi * float(min((room.width, room.height) / world.half_size)) / 2.0
    taken: list[tuple[float, float, float, float]] = []
    for obstacle in sorted(world.obstacles, key=_spread, reverse=True)[:MOST_NAMES]:
        middle = _middle(obstacle)
        half = 0.5 * _NAME_SIZE * np.array([0.58 * len(obstacle.name), 1.15])
        places = [(middle * points + aside, aside) for aside in _ASIDE]
        boxes = [((*(place - half), *(place + half)), aside) for place, aside in places]
        box, aside = min(boxes, key=lambda box: _overlap(box[0], taken))
        taken.append(box)
        name, families = lettering(obstacle.name)
        text = axes.annotate(
            name,
            (float(middle[0]), float(middle[1])),
            xytext=aside,
            textcoords="offset points",
            fontsize=_NAME_SIZE,
            fontfamily=families,
            ha="center",
            va="center",
            color=INK,
            zorder=6,
            annotation_clip=False,
            parse_math=False,
        )
        text.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="white")])


def _spread(obstacle: Obstacle) -> float:
    """Extent of the footprint, metres."""
    return max(float(np.ptp(vertices, axis=0).max()) + 2.0 * radius for vertices, radius in obstacle.footprints())


def _overlap(box: tuple[float, float, float, float], others: Sequence[tuple[float, float, float, float]]) -> float:
    """Area that a box (least x, least y, greatest x, greatest y) shares with others."""
    if not others:
        return 0.0
    low_x, low_y, high_x, high_y = np.array(others).T
    width = np.minimum(box[2], high_x) - np.maximum(box[0], low_x)
    height = np.minimum(box[3], high_y) - np.maximum(box[1], low_y)
    return float((np.maximum(width, 0.0) * np.maximum(height, 0.0)).sum())


def draw_scale(axes: Axes, mappable: ScalarMappable, label: str) -> None:
    """Draw a colour bar as high as the axes, on their right."""
    bar = axes.figure.colorbar(mappable, cax=axes.inset_axes((1.025, 0.0, 0.03, 1.0)))
    bar.set_label(label, fontsize=8, color=QUIET_INK)
    bar.ax.tick_params(labelsize=8, color=QUIET_INK, labelcolor=QUIET_INK)
    bar.outline.set_visible(False)


_HATCHES = {"low": "//////", "clear": "...", "overhanging": "xxxx"}


def _kind(obstacle: Obstacle, camera: DepthCamera, robot: Robot) -> str:
    """ "low", "clear" (the robot passes under), "overhanging" (off the floor, it does not) or "plain"."""
    if obstacle.base >= robot.height:
        return "clear"
    if obstacle.top <= camera.mount_z:
        return "low"
    return "overhanging" if obstacle.base > 0.0 else "plain"


def _heights(world: World) -> Normalize:
    return Normalize(0.0, max([1.0, *(obstacle.top for obstacle in world.obstacles)]))


def dynamic_patches(world: World, camera: DepthCamera, robot: Robot = TURTLEBOT2) -> list[Patch]:
    """Patches of the world's ``navsim.dynamics.dynamic_obstacles``, in their order, where the file puts them."""
    obstacles, heights = [world.obstacles[one.index] for one in dynamic_obstacles(world)], _heights(world)
    return [obstacle_patch(obstacle, heights, _kind(obstacle, camera, robot)) for obstacle in obstacles]


def move_dynamic_patches(patches: Sequence[Patch], world: World, poses: np.ndarray) -> None:
    """Moves what :func:`dynamic_patches` made to poses ``(D, 3)``, as ``Simulator.obstacle_poses`` tells them."""
    for patch, one, pose in zip(patches, dynamic_obstacles(world), poses, strict=False):
        obstacle = world.obstacles[one.index]
        if isinstance(patch, Circle) and isinstance(obstacle, Cylinder):
            patch.center = tuple(placed(np.array([obstacle.at]) - one.reference, pose)[0])
        elif isinstance(patch, PolygonPatch) and not isinstance(obstacle, Cylinder):
            patch.set_xy(placed(_corners(obstacle) - one.reference, pose))


def _draw_motion(axes: Axes, obstacle: Obstacle, most_arrows: int) -> None:
    """Draw the way of a moving obstacle, with arrows in the middle of its lines, and the far end of what goes back."""
    motion = obstacle.motion
    assert motion is not None
    knots = motion.knots()
    if isinstance(motion, Swing):
        far = _outline(obstacle)
        middle = far.mean(axis=0) if len(far) > 1 else far[0]
        arm = float(np.hypot(*(far - motion.hinge).T).max())
        bearing = math.atan2(middle[1] - motion.hinge[1], middle[0] - motion.hinge[0])
        angles = bearing + np.linspace(knots[0, 2], knots[1, 2], 60)
        line = motion.hinge + arm * np.column_stack([np.cos(angles), np.sin(angles)])
        axes.plot(*motion.hinge, marker="o", ms=3, color=MOTION, zorder=5.2)
    else:
        line = knots[:, :2]
    axes.plot(*line.T, color=MOTION, lw=1.1, ls=(0, (4, 2)), zorder=2.95)
    if isinstance(motion, Swing):
        _draw_arrow(axes, line[len(line) // 2 - 1], line[len(line) // 2])
    else:
        for begin, end in itertools.islice(itertools.pairwise(line), most_arrows):
            _draw_arrow(axes, begin, end)
    if not motion.is_circuit:
        ends = knots[[0, -1]] if isinstance(motion, Swing) else knots[[-1]]
        for pose in ends:
            ghost = placed(_outline(obstacle) - knots[0, :2], pose)
            radius = obstacle.radius if isinstance(obstacle, Cylinder) else 0.0
            patch = Circle(tuple(ghost[0]), radius) if radius else PolygonPatch(ghost, closed=True)
            patch.set(fill=False, edgecolor=MOTION, linewidth=0.8, linestyle=(0, (2, 2)), zorder=2.95)
            axes.add_patch(patch)


def _outline(obstacle: Obstacle) -> np.ndarray:
    """Corners (V, 2), metres; the centre of a cylinder."""
    return np.array([obstacle.at]) if isinstance(obstacle, Cylinder) else _corners(obstacle)


def _draw_arrow(axes: Axes, begin: np.ndarray, end: np.ndarray) -> None:
    if (begin == end).all():  # what turns about its own middle goes nowhere
        return
    middle = 0.5 * (begin + end)
    tip = middle + 0.01 * (end - begin) / np.linalg.norm(end - begin)
    axes.annotate(
        "",
        tip,
        xytext=middle,
        arrowprops={"arrowstyle": "-|>", "color": MOTION, "shrinkA": 0, "shrinkB": 0},
        zorder=5.2,
    )


def obstacle_patch(obstacle: Obstacle, heights: Normalize, kind: str) -> Patch:
    """An obstacle as it is drawn on a plan view, coloured by the height of its top."""
    style: dict[str, Any] = {
        "facecolor": HEIGHT_COLOURS(heights(obstacle.top)),
        "edgecolor": INK,
        "linewidth": 0.7,
        "hatch": _HATCHES.get(kind),
        "hatch_linewidth": 0.5,
        "zorder": 2.0 + min(obstacle.top, 90.0) / 100.0,
    }
    if obstacle.motion is not None or obstacle.pushable is not None:
        style |= {"edgecolor": PUSHABLE if obstacle.motion is None else MOTION, "linewidth": 1.8}
    if kind == "clear":
        style |= {"linestyle": (0, (3, 1.5)), "alpha": 0.75}
    if isinstance(obstacle, Cylinder):
        return Circle(obstacle.at, obstacle.radius, **style)
    return PolygonPatch(_corners(obstacle), closed=True, joinstyle="miter", **style)


def _corners(obstacle: Box | Polygon) -> np.ndarray:
    """Outline (V, 2), metres. A concave polygon is drawn whole: the convex pieces it is cut into would show seams."""
    return obstacle.footprints()[0][0] if isinstance(obstacle, Box) else np.asarray(obstacle.points)


def _middle(obstacle: Obstacle) -> np.ndarray:
    """A point on the footprint, near its middle: a concave polygon's own may lie outside."""
    if not isinstance(obstacle, Polygon):
        return np.asarray(obstacle.at)
    largest = max(
        (vertices for vertices, _ in obstacle.footprints()), key=lambda vertices: signed_area(vertices.tolist())
    )
    return largest.mean(axis=0)


def _draw_starts(axes: Axes, starts: Sequence[Start], robot: Robot) -> None:
    for index, start in enumerate(starts):
        x, y = start.at
        axes.add_patch(Circle((x, y), robot.radius, fc="white", ec=START, lw=1.1, zorder=5))
        if start.yaw_deg is not None:
            yaw = math.radians(start.yaw_deg)
            tip = (x + 0.42 * math.cos(yaw), y + 0.42 * math.sin(yaw))
            base = (x + robot.radius * math.cos(yaw), y + robot.radius * math.sin(yaw))
            axes.add_patch(
                FancyArrowPatch(base, tip, arrowstyle="-|>", mutation_scale=9, color=START, lw=1.2, shrinkA=0, zorder=5)
            )
        axes.text(x, y, str(index), fontsize=7, ha="center", va="center_baseline", color=START, zorder=6)


def draw_goal(axes: Axes, at: tuple[float, float], label: str = "") -> Line2D:
    """Mark a goal at x, y, metres, on a plan view; returns the mark."""
    (mark,) = axes.plot(*at, marker="D", ms=6.5, mfc=GOAL, mec="white", mew=0.9, ls="none", zorder=5)
    if label:
        text = axes.annotate(
            label, at, xytext=(4.5, 3.5), textcoords="offset points", fontsize=7, color=GOAL, weight="bold", zorder=6
        )
        text.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="white")])
    return mark


def _world_legend(
    world: World, kinds: Sequence[str], *, starts: bool, goals: bool, camera: DepthCamera, robot: Robot
) -> list[Any]:
    handles: list[Any] = []
    middle = HEIGHT_COLOURS(0.3)
    labels = {
        "low": f"lower than the camera ({camera.mount_z:g} m)",
        "clear": f"the robot ({robot.height:g} m) fits under",
        "overhanging": "off the floor, too low to pass",
    }
    for kind, label in labels.items():
        if kind in kinds:
            line = "dashed" if kind == "clear" else "solid"
            handles.append(
                Patch(fc=middle, ec=INK, lw=0.7, ls=line, hatch=_HATCHES[kind], hatch_linewidth=0.5, label=label)
            )
    if any(obstacle.motion is not None for obstacle in world.obstacles):
        handles.append(Line2D([], [], color=MOTION, lw=1.8, ls=(0, (4, 2)), label="moves, along this way"))
    if any(obstacle.pushable is not None for obstacle in world.obstacles):
        handles.append(Patch(fc=middle, ec=PUSHABLE, lw=1.8, label="can be pushed"))
    if starts and not world.random_starts:
        handles.append(Line2D([], [], ls="none", marker="o", ms=8, mfc="white", mec=START, label="start"))
    if goals and not world.random_goals:
        handles.append(Line2D([], [], ls="none", marker="D", ms=6.5, mfc=GOAL, mec="white", label="goal"))
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
                lines,
                colors=colour,
                linestyles=[OUTCOME_LINES[outcome]],
                lw=line_width,
                alpha=alpha,
                zorder=3 + order / 10,
            ),
            autolim=False,
        )
        ends = np.array([line[-1] for line in lines])
        marker = OUTCOME_MARKERS[outcome]
        axes.scatter(
            ends[:, 0],
            ends[:, 1],
            s=16,
            marker=marker,
            fc=colour,
            ec="white",
            lw=0.4,
            alpha=alpha,
            zorder=4 + order / 10,
        )
        handles.append(
            Line2D(
                [], [], color=colour, ls=OUTCOME_LINES[outcome], lw=1.6, marker=marker, label=f"{len(lines)} {outcome}"
            )
        )
    if legend and handles:
        # A second legend beside the plan view's; unclipped, or the layout would not make room for it.
        axes.add_artist(
            Legend(
                axes,
                handles,
                [str(handle.get_label()) for handle in handles],
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
    """Perceptually uniform colours of depth images, near bright and far dark, with "no return" set apart in grey."""
    return colormaps[DEPTH_COLOURS].with_extremes(bad=NO_RETURN)


def draw_depth(
    axes: Axes,
    depth: np.ndarray,
    camera: DepthCamera | None = None,
    *,
    colour_bar: bool = True,
) -> AxesImage:
    """Draw a depth image, 0 to ``camera.max_range`` metres, "no return" in grey; returns the image artist.

    Args:
        axes: where to draw; its ticks are removed.
        depth: ``(H, W)``, ``uint8`` counts as the networks get them or float metres; 0 is "no return".
        camera: gives the range of the scale.
        colour_bar: add the scale beside the axes.
    """
    camera = camera or DepthCamera()
    image = axes.imshow(
        masked_depth(depth, camera), cmap=depth_colours(), vmin=0.0, vmax=camera.max_range, interpolation="nearest"
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
        draw_scale(axes, image, "depth, m")
        if (np.asarray(depth) == 0).any():
            handle = Patch(fc=NO_RETURN, label="no return")
            axes.legend(
                handles=[handle],
                loc="upper right",
                bbox_to_anchor=(1.0, 0.0),
                fontsize=8,
                frameon=False,
                labelcolor=INK,
            )
    return image


def masked_depth(depth: np.ndarray, camera: DepthCamera) -> np.ma.MaskedArray:
    """Depth images of any shape in metres, with "no return" masked: what :func:`draw_depth`'s artist shows."""
    return np.ma.masked_equal(metres(depth, camera), 0.0)


def draw_depth_stack(
    figure: Figure | SubFigure,
    stack: np.ndarray,
    heading: float,
    q_values: Sequence[float] | np.ndarray,
    camera: DepthCamera | None = None,
    *,
    interval: float = 0.2,
) -> None:
    """Draw what a network sees and what it makes of it: four depth images, the goal's direction, and seven Q-values.

    Args:
        figure: an empty figure or subfigure.
        stack: ``(4, H, W)`` depth images, oldest first, ``uint8`` counts or float metres.
        heading: the goal's bearing in the robot's frame, radians, left positive.
        q_values: of the seven actions; the greatest is the action taken, drawn in colour.
        camera: gives the range of the depth scale.
        interval: time between the images, seconds.
    """
    stack, camera = np.asarray(stack), camera or DepthCamera()
    grid = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.25))
    images = grid[0].subgridspec(1, len(stack), wspace=0.03)
    for index, depth in enumerate(stack):
        axes = figure.add_subplot(images[index])
        image = draw_depth(axes, depth, camera, colour_bar=False)
        age = len(stack) - 1 - index
        axes.set_title("now" if age == 0 else f"{interval * age:.1f} s ago", fontsize=9, color=INK)
    draw_scale(axes, image, "depth, m")
    lower = grid[1].subgridspec(1, 2, width_ratios=(1.0, 2.6))
    draw_heading(figure.add_subplot(lower[0]), heading)
    draw_q_values(figure.add_subplot(lower[1]), q_values)


def draw_dial(axes: Axes) -> None:
    """Draw an empty dial of radius 1 around a robot that faces up the page, for a heading to be drawn in."""
    axes.add_patch(Circle((0, 0), 1.0, fc=FLOOR, ec=QUIET_INK, lw=0.8))
    for angle in np.deg2rad(np.arange(0, 360, 45)):
        outward = np.array([-math.sin(angle), math.cos(angle)])
        axes.plot(*np.stack([0.93 * outward, outward], axis=1), color=QUIET_INK, lw=0.8)
    axes.add_patch(Circle((0, 0), 0.2, fc=ROBOT, ec=INK, lw=1.0, zorder=3))
    axes.plot([0, 0], [0, 0.2], color=INK, lw=1.2, zorder=4)
    axes.text(0, 1.06, "ahead", fontsize=8, ha="center", va="bottom", color=QUIET_INK)
    axes.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.3), aspect="equal")
    axes.axis("off")


def draw_heading(axes: Axes, heading: float) -> None:
    """Draw the goal's direction, radians, left positive, as an arrow from a robot that faces up the page."""
    draw_dial(axes)
    tip = (-0.88 * math.sin(heading), 0.88 * math.cos(heading))
    axes.add_patch(
        FancyArrowPatch((0, 0), tip, arrowstyle="-|>", mutation_scale=16, lw=2.2, color=GOAL, shrinkA=0, zorder=2)
    )
    side = "left" if heading > 0 else "right"
    axes.set_title(f"goal: {abs(math.degrees(heading)):.0f}° to the {side}", fontsize=9, color=INK, y=-0.12)


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
        axes.text(
            index, value + 0.02 * spread, f"{value:.3f}", fontsize=8, ha="center", va="bottom", weight=weight, color=INK
        )
    axes.set_xticks(positions, ACTION_LABELS[: len(values)], fontsize=8, color=INK)
    axes.set_ylim(floor, float(values.max()) + 0.18 * spread)
    axes.set_ylabel("Q", fontsize=9, color=QUIET_INK)
    axes.tick_params(axis="y", labelsize=8, labelcolor=QUIET_INK, color=QUIET_INK)
    axes.tick_params(axis="x", length=0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(QUIET_INK)
