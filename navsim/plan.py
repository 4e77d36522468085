"""A robot in its world, seen from above: what stands still is drawn once, and what moves is put where it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patches import Polygon as PolygonPatch

from navsim.camera import DepthCamera
from navsim.draw import (
    GOAL,
    INK,
    OUTCOME_COLOURS,
    ROBOT,
    VIEW,
    draw_goal,
    draw_world,
    dynamic_patches,
    move_dynamic_patches,
)
from navsim.robot import Robot
from navsim.scan import obstacle_depth, scan_points
from navsim.simulator import Simulator
from navsim.world import World

_DPI = 100


class Plan:
    """The plan of a world, with the robot, its goal, its view and its trail as artists that move.

    Args:
        axes: what it is drawn on.
        world: where the robot drives.
        camera: what the robot sees with.
        robot: drawn to scale.
        goal_radius: of the disc around the goal, metres.
        moves_obstacles: whether :meth:`show` is told where what moves or can be pushed is; else it stands where the
            world file puts it.

    Attributes:
        artists: all that moves, in the order in which it is to be drawn over the rest.
        trail: the line behind the robot.
    """

    def __init__(
        self,
        axes: Axes,
        world: World,
        *,
        camera: DepthCamera,
        robot: Robot,
        goal_radius: float,
        moves_obstacles: bool,
    ) -> None:
        self._world, self._robot = world, robot
        draw_world(
            axes,
            world,
            starts=False,
            goals=False,
            colour_bar=False,
            legend=False,
            dynamic=not moves_obstacles,
            camera=camera,
            robot=robot,
        )
        axes.axis("off")
        self._obstacles = dynamic_patches(world, camera, robot) if moves_obstacles else []
        self._view = PolygonPatch(np.zeros((3, 2)), fc=VIEW, ec=VIEW, lw=0.8, alpha=0.3)
        self._disc = Circle((0, 0), goal_radius, fc=GOAL, ec=GOAL, alpha=0.25)
        self._star = draw_goal(axes, (0.0, 0.0))
        self._halo = axes.add_line(Line2D([], [], color="white", lw=3.4, alpha=0.8))
        self.trail = axes.add_line(Line2D([], [], color=OUTCOME_COLOURS["success"], lw=1.8))
        self._body = Circle((0, 0), robot.radius, fc=ROBOT, ec=INK, lw=1.1)
        self._nose = axes.add_line(Line2D([], [], color=INK, lw=1.4))
        for patch in (*self._obstacles, self._disc, self._view, self._body):
            axes.add_patch(patch)
        self.artists: tuple[Artist, ...] = (
            *self._obstacles,
            self._disc,
            self._view,
            self._star,
            self._halo,
            self.trail,
            self._body,
            self._nose,
        )

    def show(
        self,
        pose: np.ndarray,
        goal: np.ndarray,
        view: np.ndarray,
        *,
        trail: np.ndarray | None = None,
        obstacle_poses: np.ndarray | None = None,
    ) -> None:
        """Puts everything where it is.

        Args:
            pose: ``(3,)`` x, y, yaw of the robot.
            goal: ``(2,)`` metres.
            view: ``(K, 2)`` corners of what it sees, as :func:`views_of` gives them.
            trail: ``(T, 2)`` where it has been, metres.
            obstacle_poses: ``(D, 3)`` of what moves or can be pushed.
        """
        if obstacle_poses is not None:
            move_dynamic_patches(self._obstacles, self._world, obstacle_poses)
        x, y, yaw = pose.tolist()
        self._disc.center = tuple(goal.tolist())
        self._star.set_data(goal[:1], goal[1:])
        self._view.set_xy(view)
        self._body.center = (x, y)
        radius = self._robot.radius
        self._nose.set_data([x, x + radius * math.cos(yaw)], [y, y + radius * math.sin(yaw)])
        if trail is not None:
            for line in (self._halo, self.trail):
                line.set_data(*trail.T)


class Background:
    """A figure's pixels without the artists that move in it, onto which those are drawn time after time.

    Args:
        figure: drawn once, here.
        moving: what is drawn at each time, in this order.
    """

    def __init__(self, figure: Figure, moving: Sequence[Artist]) -> None:
        self._figure, self._moving = figure, moving
        for artist in moving:
            artist.set_animated(True)
        self._canvas = FigureCanvasAgg(figure)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)

    def with_artists(self) -> np.ndarray:
        """RGB ``(h, w, 3)`` uint8, the figure as it is now."""
        self._canvas.restore_region(self._still)
        for artist in self._moving:
            (artist.axes or self._figure).draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


class PlanPictures:
    """Pictures of a simulator's robots in their worlds, seen from above.

    Args:
        simulator: whose robots are drawn.
        size: pixels of a side; each world is as large as fits.
    """

    def __init__(self, simulator: Simulator, size: int) -> None:
        if size < 1:
            raise ValueError(f"a picture must have a side of at least 1 pixel; got {size}")
        self._simulator, self.size = simulator, size
        self._drawn: dict[int, tuple[Plan, Background]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_drawn": {}}  # a canvas cannot be copied; the copy draws its own

    def draw(self, images: np.ndarray) -> np.ndarray:
        """One picture of each robot, as it is now.

        Args:
            images: ``(N, H, W)`` uint8, what the robots are shown, which outlines their views.

        Returns:
            RGB, uint8 ``(N, size, size, 3)``.
        """
        simulator = self._simulator
        worlds = simulator.world_index.tolist()
        # Plans of worlds that nobody drives in any more would only fill the memory.
        self._drawn = {world: drawn for world, drawn in self._drawn.items() if world in worlds}
        views = self._views(images)
        pictures = np.empty((simulator.num_robots, self.size, self.size, 3), dtype=np.uint8)
        for i, world in enumerate(worlds):
            if world not in self._drawn:
                self._drawn[world] = self._begin(simulator.worlds[world])
            plan, background = self._drawn[world]
            plan.show(simulator.poses[i], simulator.goals[i], views[i], obstacle_poses=simulator.obstacle_poses[i])
            pictures[i] = background.with_artists()
        return pictures

    def _views(self, images: np.ndarray) -> np.ndarray:
        """``(N, W + 1, 2)``: as :func:`views_of`, of cameras that are mounted as their episodes have drawn it."""
        simulator = self._simulator
        poses, lossy = simulator.image_poses, simulator.sensor.loses_returns
        views = np.empty((len(images), simulator.camera.width + 1, 2))
        each = np.stack(simulator.mounts, axis=1)
        for mount in np.unique(each, axis=0):
            robots = (each == mount).all(axis=1)
            x, y, z, pitch = mount.tolist()
            camera = replace(simulator.camera, mount_x=x, mount_y=y, mount_z=z, pitch_deg=math.degrees(pitch))
            views[robots] = views_of(images[robots], poses[robots], camera, lossy=lossy)
        return views

    def _begin(self, world: World) -> tuple[Plan, Background]:
        simulator = self._simulator
        figure = Figure(figsize=(self.size / _DPI,) * 2, dpi=_DPI, facecolor="white")
        plan = Plan(
            figure.add_axes((0.0, 0.0, 1.0, 1.0)),
            world,
            camera=simulator.camera,
            robot=simulator.robot,
            goal_radius=simulator.task.goal_radius,
            moves_obstacles=True,
        )
        return plan, Background(figure, plan.artists)


def views_of(images: np.ndarray, poses: np.ndarray, camera: DepthCamera, *, lossy: bool = False) -> np.ndarray:
    """The parts of the floor plan that images see as free.

    Args:
        images: ``(K, H, W)`` uint8.
        poses: ``(K, 3)``, where they were taken.
        camera: what they were taken with.
        lossy: whether the sensor loses returns; then a pixel without one hides nothing.

    Returns:
        ``(K, W + 1, 2)`` corners, metres in the world's frame.
    """
    seen = scan_points(obstacle_depth(images, camera, lossy=lossy), camera)
    eye = np.broadcast_to([camera.mount_x, camera.mount_y], (len(poses), 1, 2))
    x, y = np.moveaxis(np.concatenate([eye, seen], axis=1), -1, 0)
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + poses[:, None, :2]
