"""A depth image reduced to a planar scan: how far each column sees before something stands in the way."""

from __future__ import annotations

import numpy as np

from navsim.camera import DepthCamera
from navsim.robot import TURTLEBOT2, Robot

FLOOR_TOLERANCE = 0.03
"""Metres above the floor below which a pixel counts as floor: more than one ``uint8`` count at any range."""
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
    what hangs above ``high``. "No return" (0) is something nearer than the camera's blind zone, and its depth 0; where
    a sensor loses returns as well, it tells nothing.

    A column is one of a level camera's, whatever the camera's pitch. What a pitched camera sees there lies along a line
    of its image that leans: in each row the pixel nearest to it is taken. Depth is along the floor.

    Args:
        depth: ``(..., H, W)``, ``uint8`` as the networks get it or float metres.
        camera: whose images they are; H and W are its height and width.
        low: metres above the floor; lower pixels are floor.
        high: metres above the floor; higher pixels are out of the way.
        lossy: whether the sensor loses returns, see ``navsim.sensor.SensorModel.loses_returns``.

    Returns:
        ``(..., W)`` float32, metres ahead; ``camera.max_range`` where the column is free.
    """
    reading = metres(depth, camera)
    forward = reading if camera.depth == "planar" else reading / camera.ray_lengths
    height = np.float32(camera.mount_z) + camera.row_climbs.astype(np.float32)[:, None] * forward
    obstructs = (reading < camera.max_range) & (height > low) & (height < high)
    obstructs = obstructs & (reading > 0.0) if lossy else obstructs | (reading == 0.0)
    if camera.pitch_deg:
        columns, inside = _columns_of_level_camera(camera)
        obstructs = np.take_along_axis(obstructs, _like(columns, obstructs), axis=-1) & inside
        forward = np.take_along_axis(forward, _like(columns, forward), axis=-1)
        forward = forward * camera.row_advances.astype(np.float32)[:, None]
    return np.where(obstructs, forward, np.float32(camera.max_range)).min(axis=-2)


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
