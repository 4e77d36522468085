"""The animation of one episode: the plan view beside the depth image that the robot sees."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as PolygonPatch
from PIL import Image

from navsim.camera import DepthCamera
from navsim.draw import (
    ACTION_LABELS,
    GOAL,
    INK,
    OUTCOME_COLOURS,
    QUIET_INK,
    draw_depth,
    draw_dial,
    draw_scale,
    masked_depth,
)
from navsim.files import atomic_write
from navsim.plan import Background, Plan, views_of
from navsim.raycast import render_depth
from navsim.robot import NUM_ACTIONS, TURTLEBOT2, Robot
from navsim.task import Task, goal_distance, heading
from navsim.world import World

ANIMATION_SUFFIXES = (".gif", ".mp4")
"""What :func:`animate_episode` writes."""

_SIZE, _DPI = (9.6, 5.2), 100  # inches and dots an inch: 960 x 520 pixels, both even as MP4 needs them
_OTHER_BARS = "#b9c0c8"
_REMEMBERED = "#c05621"
_MOST_GIF_FRAMES = 50.0  # a second
_SPEEDS = (0.01, 100.0)  # a GIF shows no picture for longer than 11 minutes, and nobody sees more in a second
_HOLD = 1.0  # seconds that the last frame stays


@dataclass(frozen=True)
class _Episode:
    world: World
    poses: np.ndarray
    goal: np.ndarray
    actions: Sequence[int] | np.ndarray
    outcome: str | None
    obstacle_poses: np.ndarray | None
    camera: DepthCamera
    task: Task
    robot: Robot
    images: np.ndarray | None
    q_values: np.ndarray | None
    remembered: np.ndarray | None


def animate_episode(
    path: str | Path,
    world: World,
    poses: np.ndarray,
    goal: Sequence[float] | np.ndarray,
    *,
    actions: Sequence[int] | np.ndarray = (),
    outcome: str | None = None,
    obstacle_poses: np.ndarray | None = None,
    camera: DepthCamera | None = None,
    task: Task | None = None,
    robot: Robot = TURTLEBOT2,
    images: np.ndarray | None = None,
    q_values: np.ndarray | None = None,
    remembered: np.ndarray | None = None,
    speed: float = 2.0,
) -> Path:
    """Write one episode as a GIF or an MP4: the plan view beside the depth image that the robot sees.

    Args:
        path: where to write; the suffix, ``.gif`` or ``.mp4``, chooses the format. Its directory is made.
        world: where the robot drives.
        poses: ``(K, 3)``, x, y, yaw at the start and after each step.
        goal: x, y, metres.
        actions: what was done at each pose, in words beside the picture; may be shorter than ``poses``.
        outcome: ``"success"``, ``"collision"`` or ``"timeout"``, shown on the last frame, which stays for a second.
        obstacle_poses: ``(K, D, 3)`` where what moves or can be pushed is at each time, as
            ``Simulator.obstacle_poses`` tells; by default where the world file puts it.
        camera: what the robot sees with.
        task: its goal radius and control period are shown.
        robot: drawn to scale.
        images: uint8 ``(K - 1, H, W)``, what the robot was shown at each pose but the last, where the last of them
            stays; by default what an ideal camera sees there.
        q_values: ``(K - 1, 7)``, what the network expects of each action at each pose but the last, drawn as bars.
        remembered: ``(K - 1, S)``, metres from the robot's centre to what it remembers in each of S equal directions,
            the first of which begins behind it, counterclockwise; drawn as arcs where it is finite.
        speed: how many times faster than real time it plays, 0.01 to 100.

    Returns:
        The path.

    Raises:
        ValueError: for a suffix that is neither of the two, a speed out of range, or poses, images, Q-values or
            what is remembered of another shape, or of another number of times.
    """
    path = Path(path)
    check_animation(path, speed)
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise ValueError(f"poses of shape {poses.shape} make no episode: give (K, 3), x, y and yaw at each time")
    camera = camera or DepthCamera()
    if images is not None:
        images = np.asarray(images)
        if images.shape != (len(poses) - 1, camera.height, camera.width) or images.dtype != np.uint8 or len(poses) == 1:
            raise ValueError(
                f"images of shape {images.shape} and {images.dtype} do not belong to {len(poses)} poses: give uint8 "
                f"({len(poses) - 1}, {camera.height}, {camera.width}), one for each pose but the last"
            )
    if q_values is not None:
        q_values = np.asarray(q_values, dtype=np.float64)
        if q_values.shape != (len(poses) - 1, NUM_ACTIONS):
            raise ValueError(
                f"Q-values of shape {q_values.shape} do not belong to {len(poses)} poses: give "
                f"({len(poses) - 1}, {NUM_ACTIONS}), one row for each pose but the last"
            )
    if remembered is not None:
        remembered = np.asarray(remembered, dtype=np.float64)
        if remembered.ndim != 2 or len(remembered) != len(poses) - 1:
            raise ValueError(
                f"what is remembered, of shape {remembered.shape}, does not belong to {len(poses)} poses: give "
                f"({len(poses) - 1}, S), distances in S directions for each pose but the last"
            )
    if obstacle_poses is not None and len(obstacle_poses) != len(poses):
        raise ValueError(f"there are obstacle_poses for {len(obstacle_poses)} times, but poses for {len(poses)}")
    episode = _Episode(
        world,
        poses,
        np.asarray(goal, dtype=np.float64),
        actions,
        outcome,
        obstacle_poses,
        camera,
        task or Task(),
        robot,
        images,
        q_values,
        remembered,
    )
    frame_rate = speed / episode.task.control_period
    frames = list(_frames(episode))
    frames += [frames[-1]] * round(_HOLD * frame_rate)
    film = _gif(frames, frame_rate) if path.suffix.lower() == ".gif" else _mp4(frames, frame_rate)
    with atomic_write(path, "wb") as file:
        file.write(film)
    return path


def check_animation(path: Path, speed: float) -> None:
    """Raises ValueError for a file name or a speed that :func:`animate_episode` has no use for."""
    if path.suffix.lower() not in ANIMATION_SUFFIXES:
        raise ValueError(f"{path}: animations are written as {' or '.join(ANIMATION_SUFFIXES)}")
    if not _SPEEDS[0] <= speed <= _SPEEDS[1]:
        raise ValueError(f"speed must lie between {_SPEEDS[0]:g} and {_SPEEDS[1]:g}; got {speed:g}")


def _frames(episode: _Episode) -> Iterator[np.ndarray]:
    """RGB images (h, w, 3) uint8, one a pose. What stands still is drawn once; each frame adds what moves."""
    stage = _Stage(episode)
    background = Background(stage.figure, stage.moving)
    for index in range(len(episode.poses)):
        stage.move_to(index)
        yield background.with_artists()


class _Stage:
    """The figure, with the artists that move in it."""

    def __init__(self, episode: _Episode) -> None:
        self._episode = episode
        camera, poses = episode.camera, episode.poses
        planar = render_depth(episode.world, poses, camera, episode.obstacle_poses)
        ideal = camera.to_uint8(camera.from_planar(planar))
        shown = episode.images
        self._depths = ideal if shown is None else np.concatenate([shown, shown[-1:]])
        self._headings = heading(poses, episode.goal)
        self._distances = goal_distance(poses, episode.goal)
        self._views = views_of(ideal, poses, camera)
        self.figure = Figure(figsize=_SIZE, dpi=_DPI, facecolor="white")
        self._lay_out()
        self.moving: tuple[Artist, ...] = (
            *self._plan.artists,
            self._memory,
            self._image,
            self._needle,
            self._words,
            self._verdict,
            *(self._bars.artists if self._bars else ()),
        )

    def _lay_out(self) -> None:
        episode = self._episode
        axes = self.figure.add_axes((0.01, 0.02, 0.525, 0.96))
        self._plan = Plan(
            axes,
            episode.world,
            camera=episode.camera,
            robot=episode.robot,
            goal_radius=episode.task.goal_radius,
            moves_obstacles=episode.obstacle_poses is not None,
        )
        axes.plot(*episode.poses[0, :2], marker="o", ms=5, mfc="white", mec=QUIET_INK, zorder=3)
        self._memory = axes.add_line(Line2D([], [], color=_REMEMBERED, lw=2.2))
        if episode.remembered is not None:
            self.figure.text(0.725, 0.03, "— what it remembers around it", fontsize=8.5, color=_REMEMBERED)

        shows_values = episode.q_values is not None
        sight = self.figure.add_axes((0.56, 0.55, 0.36, 0.38) if shows_values else (0.56, 0.37, 0.36, 0.56))
        self._image = draw_depth(sight, self._depths[0], episode.camera, colour_bar=False)
        draw_scale(sight, self._image, "depth, m")
        sight.set_title("what the camera sees", fontsize=10, color=INK, loc="left")

        self._bars = _Bars(self.figure.add_axes((0.56, 0.33, 0.42, 0.15))) if shows_values else None
        dial = self.figure.add_axes((0.555, 0.01, 0.14, 0.24) if shows_values else (0.555, 0.03, 0.15, 0.29))
        draw_dial(dial)
        self._needle = PolygonPatch(_needle(0.0), fc=GOAL, ec="none")
        dial.add_patch(self._needle)
        self._words = self.figure.text(0.725, 0.29, "", fontsize=10, color=INK, va="top", linespacing=1.7)
        self._verdict = self.figure.text(0.725, 0.09, "", fontsize=13, weight="bold", va="top")

    def move_to(self, index: int) -> None:
        """Moves every artist to where it is at one of the poses."""
        episode = self._episode
        self._plan.show(
            episode.poses[index],
            episode.goal,
            self._views[index],
            trail=episode.poses[: index + 1, :2],
            obstacle_poses=None if episode.obstacle_poses is None else episode.obstacle_poses[index],
        )
        self._image.set_data(masked_depth(self._depths[index], episode.camera))
        self._needle.set_xy(_needle(self._headings[index]))
        words = [
            f"time  {index * episode.task.control_period:.1f} s",
            f"distance to the goal  {self._distances[index]:.2f} m",
        ]
        if index < len(episode.actions):
            words.append(f"action  {ACTION_LABELS[int(episode.actions[index])]}")
        self._words.set_text("\n".join(words))
        if self._bars and episode.q_values is not None and index < len(episode.q_values):
            self._bars.show(episode.q_values[index])
        if episode.remembered is not None and index < len(episode.remembered):
            self._memory.set_data(*_arcs(episode.remembered[index], episode.poses[index]))
        if index == len(episode.poses) - 1 and episode.outcome is not None:
            for artist in (self._verdict, self._plan.trail):
                artist.set_color(OUTCOME_COLOURS[episode.outcome])
            self._verdict.set_text(episode.outcome)


class _Bars:
    """Q-values as bars that start below the least of them, since their differences are what decides."""

    _FOOT, _TOP = 0.15, 1.4  # height of the least bar, and of the picture; the greatest bar is 1 high

    def __init__(self, axes: Axes) -> None:
        self._bars = list(axes.bar(range(NUM_ACTIONS), [0.0] * NUM_ACTIONS, width=0.72))
        self._labels = [
            axes.text(action, 0.0, "", fontsize=7.5, ha="center", va="bottom", color=INK)
            for action in range(NUM_ACTIONS)
        ]
        axes.set_xticks(range(NUM_ACTIONS), ACTION_LABELS, fontsize=7.5, color=INK)
        axes.set(ylim=(0.0, self._TOP), yticks=[])
        axes.tick_params(axis="x", length=0)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.spines["bottom"].set_color(QUIET_INK)
        axes.set_title("what it expects of each action (Q-values)", fontsize=10, color=INK, loc="left")
        self.artists: tuple[Artist, ...] = (*self._bars, *self._labels)

    def show(self, q_values: np.ndarray) -> None:
        """Sets the bars to the values ``(7,)``; the greatest, which the robot acts on, is in colour."""
        best, least = int(q_values.argmax()), q_values.min()
        spread = max(float(np.ptp(q_values)), 1e-6)
        for action, (bar, label, value) in enumerate(zip(self._bars, self._labels, q_values, strict=True)):
            height = self._FOOT + (1.0 - self._FOOT) * float(value - least) / spread
            bar.set_height(height)
            bar.set_facecolor(OUTCOME_COLOURS["success"] if action == best else _OTHER_BARS)
            label.set_y(height + 0.04)
            label.set_text(f"{value:.3f}")
            label.set_fontweight("bold" if action == best else "normal")


def _needle(angle: float) -> np.ndarray:
    """An arrowhead (4, 2) in the unit circle that points ``angle`` radians to the left of upwards."""
    ahead = np.array([-math.sin(angle), math.cos(angle)])
    left = np.array([-ahead[1], ahead[0]])
    return np.stack([0.92 * ahead, 0.3 * ahead + 0.16 * left, 0.42 * ahead, 0.3 * ahead - 0.16 * left])


def _arcs(distances: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Where to draw ``(S,)`` distances around a pose, each across its direction: x and y, with gaps of NaN."""
    count = len(distances)
    angles = pose[2] + math.pi * (2.0 * (np.arange(count)[:, None] + np.linspace(0.0, 1.0, 5)) / count - 1.0)
    points = np.where(np.isfinite(distances), distances, np.nan)[:, None] * np.stack([np.cos(angles), np.sin(angles)])
    gaps = np.full((2, count, 1), np.nan)
    return np.concatenate([points + pose[:2, None, None], gaps], axis=2).reshape(2, -1)


def _mp4(images: list[np.ndarray], frame_rate: float) -> bytes:
    film = imageio.imwrite(
        "<bytes>",
        np.stack(images),
        extension=".mp4",
        fps=frame_rate,
        codec="libx264",
        macro_block_size=2,
        pixelformat="yuv420p",  # what browsers and phones play
    )
    assert film is not None
    return film


def _gif(images: list[np.ndarray], frame_rate: float) -> bytes:
    # A GIF counts hundredths of a second, and browsers play what lasts less than two of them slowly.
    every = max(1, math.ceil(frame_rate / _MOST_GIF_FRAMES - 1e-9))
    images, frame_rate = images[::-1][::every][::-1], frame_rate / every  # the last one stays
    # One palette for all frames: it is quick to apply, and what stands still stays the same from frame to frame, so
    # that a GIF stores only what changes.
    sample = np.concatenate(images[:: max(1, len(images) // 6)])
    palette = Image.fromarray(sample).quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    indexed = [Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = 10 * np.diff(np.rint(100.0 / frame_rate * np.arange(len(images) + 1)).astype(int))
    film = io.BytesIO()
    indexed[0].save(film, "GIF", save_all=True, append_images=indexed[1:], duration=durations.tolist(), loop=0)
    return film.getvalue()
