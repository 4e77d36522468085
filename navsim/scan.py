"""A depth image reduced to a planar scan: how far each column sees before something stands in the way."""

from __future__ import annotations

import math

import numpy as np

from navsim.camera import DepthCamera
from navsim.robot import TURTLEBOT2, Robot

FLOOR_TOLERANCE = 0.03
"""Metres above the floor below which a pixel counts as floor."""
TILT_TOLERANCE_DEG = 3.0
"""Degrees by which that limit rises away from the camera: of a camera (or a robot) tilted by so much more than is
known, the floor stays floor. What is lower than the limit where it is far away shows when it comes nearer."""
_CLEARANCE = 0.06
"""Metres above a robot from which on things are out of its way."""


def clear_height(robot: Robot) -> float:
    """Metres above which a pixel is out of the way: of the TurtleBot above all that its camera sees within 0.4 m.

    >>> clear_height(TURTLEBOT2)
    0.48
    """
    return robot.height + _CLEARANCE


def metres(depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Depth in metres, float32, of images that may be ``uint8`` counts as the networks get them; floats pass through.

    >>> metres(np.array([0, 51, 255], dtype=np.uint8), DepthCamera()).tolist()
    [0.0, 1.0, 5.0]
    """
    depth = np.asarray(depth)
    if depth.dtype == np.uint8:
        return depth.astype(np.float32) * np.float32(camera.max_range / 255.0)
    return depth.astype(np.float32, copy=False)


def obstacle_depth(
    depth: np.ndarray,
    camera: DepthCamera,
    *,
    low: float = FLOOR_TOLERANCE,
    high: float = clear_height(TURTLEBOT2),
    lossy: bool = False,
) -> np.ndarray:
    """Least planar depth of each column over the pixels that show something between two heights.

    A pixel's height above the floor follows from its depth and its row, so the floor drops out by geometry and so does
    what hangs above ``high``. "No return" (0) is something nearer than the camera's blind zone, and its depth 0. It
    tells nothing in rows in which the bare floor is as near as that, and where a sensor loses returns as well.

    A column is one of a level camera's, whatever the camera's pitch. What a pitched camera sees there lies along a line
    of its image that leans: in each row the pixel nearest to it is taken. Depth is along the floor.

    Args:
        depth: ``(..., H, W)``, ``uint8`` as the networks get it or float metres.
        camera: whose images they are; H and W are its height and width.
        low: metres above the floor at the camera; lower pixels are floor, and so are those lower than a plane that
            rises from there at ``TILT_TOLERANCE_DEG``.
        high: metres above the floor; higher pixels are out of the way.
        lossy: whether the sensor loses returns, see ``navsim.sensor.SensorModel.loses_returns``.

    Returns:
        ``(..., W)`` float32, metres ahead; ``camera.max_range`` where the column is free.
    """
    reading = metres(depth, camera)
    forward = reading if camera.depth == "planar" else reading / camera.ray_lengths
    nearest, farthest, floor = _limits(camera, low, high)
    obstructs = (forward > nearest) & (forward < farthest) & (reading < camera.max_range) & (reading > 0.0)
    if not lossy:
        seen_floor = floor if camera.depth == "planar" else floor * camera.ray_lengths
        obstructs |= (reading == 0.0) & (seen_floor >= max(camera.blind_zone, camera.min_range))
    if camera.pitch_deg:
        columns, inside = _columns_of_level_camera(camera)
        obstructs = np.take_along_axis(obstructs, _like(columns, obstructs), axis=-1) & inside
        forward = np.take_along_axis(forward, _like(columns, forward), axis=-1)
        forward = forward * camera.row_advances.astype(np.float32)[:, None]
    return np.where(obstructs, forward, np.float32(camera.max_range)).min(axis=-2)


def _limits(camera: DepthCamera, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planar depths ``(H, 1)`` float32 between which a row's pixels are in the way, and from which on they are floor.

    A pixel of depth f is in the way where mount_z + climb f is over low + tan(tilt) advance f, and under high.
    """
    tilt = math.tan(math.radians(TILT_TOLERANCE_DEG))
    over = _where_positive(camera.mount_z - low, camera.row_climbs - tilt * camera.row_advances)
    under = _where_positive(high - camera.mount_z, -camera.row_climbs)
    limits = np.maximum(over[0], under[0]), np.minimum(over[1], under[1]), over[1]
    return tuple(limit.astype(np.float32)[:, None] for limit in limits)  # type: ignore[return-value]


def _where_positive(at_zero: float, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds ``(H,)`` of the f for which ``at_zero`` + slope f > 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.where(slopes == 0.0, np.inf if at_zero > 0.0 else -np.inf, -at_zero / slopes)
    return np.where(slopes > 0.0, root, -np.inf), np.where(slopes > 0.0, np.inf, root)


def _columns_of_level_camera(camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Column ``(H, W)`` in each row that looks where a level camera's columns do, and whether there is one."""
    middle = camera.width / 2 - 0.5
    column = np.rint(middle + (np.arange(camera.width) - middle) * camera.row_advances[:, None])
    inside = (column >= 0) & (column < camera.width)
    return np.clip(column, 0, camera.width - 1).astype(np.intp), inside


def _like(columns: np.ndarray, images: np.ndarray) -> np.ndarray:
    return np.broadcast_to(columns, images.shape)


def scan_points(column_depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Points of a scan on the floor plane in the robot's frame (x forward, y left).

    Args:
        column_depth: ``(..., W)`` metres ahead.
        camera: whose columns and mounting they are.

    Returns:
        ``(..., W, 2)`` metres from the robot's centre.
    """
    x = column_depth + camera.mount_x
    y = column_depth * camera.column_slopes + camera.mount_y
    return np.stack([x, y], axis=-1)
