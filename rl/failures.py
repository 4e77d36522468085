"""The paths that a policy misses: what it ran into, whether it had seen it, and a picture of each."""

from __future__ import annotations

import os
import shlex
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.console import Console

from navsim.camera import DepthCamera
from navsim.draw import INK, OUTCOME_COLOURS, check_picture, draw_goal, draw_paths, draw_world, new_figure, save_figure
from navsim.files import atomic_write
from navsim.raycast import render_depth
from navsim.robot import TURTLEBOT2, Robot
from navsim.task import Task
from navsim.world import World
from navsim.worldsource import worlds_from
from rl.config import TrainConfig
from rl.evaluation import evaluate_as_trained
from rl.figures import describe
from rl.metrics import Evaluation, PathResult
from rl.observation import NUM_FRAMES
from rl.policies import find_policy

KINDS = {
    "unseen": "What came too near was in none of the four images that the robot had before: it turned into it, or "
    "passed it so closely that the camera, which sees 60°, had lost it.",
    "edge": "It came too near at the edge of the image, having been in view: a corner cut by centimetres.",
    "ahead": "It came too near in the middle of the image: the robot saw it and did not turn in time.",
    "touched": "The robot's body touched something that the camera did not see nearer than the limit: it is beside or "
    "behind the camera's view, or lower than it.",
    "timeout": "The time was over before the goal was reached.",
}
"""What a path can fail by."""
_EDGE = 0.1  # share of the image's columns, on each side
_SAME = 0.08  # metres: what is seen at about this depth is the same thing
_AS_NEAR = 0.01  # metres
_AROUND = 1.3  # metres of the room that are drawn around an end
_MOST_DRAWN = 24


class Failure(NamedTuple):
    """Why a path failed."""

    path: PathResult
    kind: str
    """One of ``KINDS``."""
    at: tuple[float, float] | None
    """What came too near, metres; None where nothing did."""
    seen: int
    """In how many of the last four images before it was in view."""
    ago: int | None = None
    """Steps from when it was last in view to the end; None where it never was."""


def explain(
    path: PathResult,
    world: World,
    camera: DepthCamera,
    frame_interval: int = 1,
    *,
    task: Task | None = None,
    robot: Robot = TURTLEBOT2,
) -> Failure:
    """Finds out what a path failed by.

    Args:
        path: one that has failed.
        world: where.
        camera: of the robot.
        frame_interval: of the policy's images.
        task: the rules that it was driven by; the defaults without one.
        robot: who drove.
    """
    if path.outcome == "timeout":
        return Failure(path, "timeout", None, 0)
    if not path.too_near:
        return Failure(path, "touched", None, 0)
    end, obstacles = path.trajectory[-1], path.obstacle_poses(world, task or Task(), robot)
    planar = render_depth(world, end[None], camera, None if obstacles is None else obstacles[-1:])[0]
    image = camera.from_planar(planar)
    rows, columns = np.nonzero(image < image.min() + _AS_NEAR)  # all of a wall is as near
    middlemost = np.abs(columns - 0.5 * (camera.width - 1)).argmin()
    row, column = rows[middlemost], columns[middlemost]
    depth = float(planar[row, column])
    ahead, left = depth * camera.row_advances[row], depth * camera.column_slopes[column]
    point = _to_world(end, np.array([ahead + camera.mount_x, left + camera.mount_y]))
    before = None if obstacles is None else obstacles[-2::-1]
    in_view = _in_view(point, path.trajectory[-2::-1], world, camera, before)  # the last image first
    seen = in_view[np.minimum(frame_interval * np.arange(NUM_FRAMES), len(in_view) - 1)]
    ago = int(in_view.argmax()) + 1 if in_view.any() else None
    from_side = min(column, camera.width - 1 - column)
    kind = "unseen" if not seen.any() else "edge" if from_side < _EDGE * camera.width else "ahead"
    return Failure(path, kind, (float(point[0]), float(point[1])), int(seen.sum()), ago)


def _to_world(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + np.array([[cosine, -sine], [sine, cosine]]) @ point


def _in_view(
    point: np.ndarray, poses: np.ndarray, world: World, camera: DepthCamera, obstacles: np.ndarray | None = None
) -> np.ndarray:
    """``(K,)`` bool: whether a camera at each pose ``(K, 3)`` sees something at ``point`` ``(2,)``."""
    away = point - poses[:, :2]
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead = cosine * away[:, 0] + sine * away[:, 1] - camera.mount_x
    left = cosine * away[:, 1] - sine * away[:, 0] - camera.mount_y
    slope = (left / np.maximum(ahead, 1e-6))[:, None] * camera.row_advances  # (K, H), sideways per depth
    slopes = camera.column_slopes
    column = np.abs(slopes - slope[..., None]).argmin(axis=-1)
    half_column = 0.5 * abs(float(slopes[1] - slopes[0]))
    within = (ahead > 0.0)[:, None] & (np.abs(slope) <= np.abs(slopes).max() + half_column)
    depths = np.take_along_axis(render_depth(world, poses, camera, obstacles), column[..., None], axis=-1)[..., 0]
    return (within & (np.abs(depths * camera.row_advances - ahead[:, None]) < _SAME)).any(axis=1)


def explain_all(evaluation: Evaluation, worlds: Sequence[World], config: TrainConfig) -> list[Failure]:
    """Every failure of an evaluation of a robot with these settings, by kinds in the order of ``KINDS``."""
    found = [
        explain(
            path,
            worlds[path.world_index],
            config.camera,
            config.frame_interval,
            task=config.task,
            robot=config.robot,
        )
        for path in evaluation.paths
        if path.outcome != "success"
    ]
    return sorted(found, key=lambda failure: list(KINDS).index(failure.kind))


def draw_failures(
    failures: Sequence[Failure],
    worlds: Sequence[World],
    camera: DepthCamera | None = None,
    robot: Robot = TURTLEBOT2,
) -> Figure:
    """The surroundings of each end: the way there, the robot, its view, and what came too near.

    What moves is drawn where world files put it.
    """
    camera = camera or DepthCamera()
    columns = min(4, len(failures))
    rows = -(-len(failures) // columns)
    figure = new_figure(2.6 * columns, 2.9 * rows)
    for index, failure in enumerate(failures):
        path = failure.path
        axes = figure.add_subplot(rows, columns, index + 1)
        draw_world(
            axes, worlds[path.world_index], starts=False, goals=False, colour_bar=False, legend=False, dynamic=False
        )
        draw_paths(axes, [path.trajectory], [path.outcome], legend=False, line_width=1.8, alpha=1.0)
        x, y, yaw = path.trajectory[-1]
        axes.add_patch(Circle((x, y), robot.radius, fc="#f4e04d", ec=INK, lw=1.0, zorder=6))
        eye = _to_world(path.trajectory[-1], np.array([camera.mount_x, camera.mount_y]))
        for side in (-0.5, 0.5):
            angle = yaw + side * np.radians(camera.horizontal_fov_deg)
            far = eye + np.array([np.cos(angle), np.sin(angle)])
            axes.plot([eye[0], far[0]], [eye[1], far[1]], color="#2b6cb0", lw=0.8, zorder=5)
        draw_goal(axes, path.goal)
        if failure.at is not None:
            axes.plot(*failure.at, marker="x", ms=9, mew=2.2, color=OUTCOME_COLOURS["collision"], zorder=7)
        axes.set_xlim(x - _AROUND, x + _AROUND)
        axes.set_ylim(y - _AROUND, y + _AROUND)
        axes.axis("off")
        place = f"{worlds[path.world_index].name}, " if len(worlds) > 1 else ""
        axes.set_title(f"{failure.kind}\n{place}{describe(path)}, step {path.steps}", fontsize=8, color=INK)
    return figure


def write_failures(
    policy: str, world: str, page: Path, picture: Path, *, num_paths: int | None = None, console: Console | None = None
) -> Evaluation:
    """Drives a world's paths, and writes a page on those that failed, with their picture.

    Args:
        policy: what ``rl.policies.find_policy`` takes.
        world: a world file, a shipped world's name, or generated rooms.
        page: Markdown file.
        picture: image file.
        num_paths: how many paths to drive; by default all, up to 1000 in several worlds.
        console: where progress is shown; nowhere by default.

    Raises:
        RunError: for a policy that there is not, or that cannot be used.
        navsim.WorldError: for a world that cannot be used.
        ValueError: for a picture that cannot be written, or a number of paths that there are not.
    """
    check_picture(picture)
    driver, config = find_policy(policy)
    worlds = worlds_from(world)
    result = evaluate_as_trained(driver, config, worlds, num_paths=num_paths, console=console)
    failures = explain_all(result, worlds, config)
    if failures:
        save_figure(draw_failures(failures[:_MOST_DRAWN], worlds, config.camera, config.robot), picture)
    with atomic_write(page) as file:
        file.write(
            _page(
                policy,
                world,
                num_paths,
                result,
                failures,
                os.path.relpath(picture, page.parent),
                config.task.control_period,
            )
        )
    return result


def _page(
    policy: str,
    world: str,
    num_paths: int | None,
    result: Evaluation,
    failures: Sequence[Failure],
    picture: str,
    period: float,
) -> str:
    low, high = result.interval("success")
    lines = [
        f"# What {policy} still misses",
        "",
        f"`{world}`: {len(result.paths) - len(failures):,} of {len(result.paths):,} goals reached "
        f"({100 * low:.0f}–{100 * high:.0f}% with 95% confidence), {len(failures)} paths failed.",
        "",
        "| kind | paths | last in view, s before the end: median | |",
        "|---|---|---|---|",
    ]
    for kind, sentence in KINDS.items():
        if own := [failure for failure in failures if failure.kind == kind]:
            ago = [period * failure.ago for failure in own if failure.ago is not None]
            lines.append(f"| {kind} | {len(own)} | {f'{statistics.median(ago):.1f}' if ago else ''} | {sentence} |")
    if failures:
        drawn = f"The first {_MOST_DRAWN} of them" if len(failures) > _MOST_DRAWN else "All of them"
        lines += [
            "",
            f"{drawn}: the way there, the robot at the end with the edges of its view (blue), and what came too near "
            "(cross).",
            "",
            f"![the ends of the failed paths]({picture})",
        ]
    told = ["python", "scripts/failures.py", policy, "--world", world]
    told += [] if num_paths is None else ["--num-paths", str(num_paths)]
    lines += ["", f"Made by `{shlex.join(told)}`."]
    return "\n".join(lines) + "\n"
