"""Which bodies in space are upright prisms, once they are posed; and the upright prisms around those that are not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from navsim.convert.scene import Solid

LEVEL = 5e-4
"""Metres by which a tilt may move the corners of a body that still counts as upright."""
LARGEST_TILT = math.radians(0.25)
"""Radians up to which a tilt is taken for a rounded right angle and levelled, with a note."""

Points = Sequence[tuple[float, float]]


class Standing(NamedTuple):
    """An upright prism, or the reason why a body is none; and what else there is to say."""

    solid: Solid | None
    reason: str = ""
    note: str = ""


def upright_box(name: str, size: Sequence[float], pose: np.ndarray) -> Standing:
    """A cuboid of ``size`` (3 lengths) about its centre at ``pose`` ``(4, 4)``: upright on any of its sides."""
    rotation, extents = pose[:3, :3], np.asarray(size)
    vertical = int(np.argmax(np.abs(rotation[2])))
    tilt = math.acos(min(1.0, abs(float(rotation[2, vertical]))))
    moved = tilt * 0.5 * float(np.linalg.norm(extents))
    if moved > LEVEL and tilt > LARGEST_TILT:
        return Standing(None, f"is a box tilted by {math.degrees(tilt):.3g} degrees")
    first, second = (axis for axis in range(3) if axis != vertical)
    yaw = math.atan2(rotation[1, first], rotation[0, first])
    x, y, z = pose[:3, 3]
    half = 0.5 * extents[vertical]
    solid = Solid(
        name, "box", z - half, z + half, centre=(x, y), size=(float(extents[first]), float(extents[second])), yaw=yaw
    )
    return Standing(solid, note=_levelled(tilt, moved))


def upright_cylinder(name: str, radius: float, length: float, pose: np.ndarray) -> Standing:
    """A cylinder about its centre, with its axis along z, at ``pose`` ``(4, 4)``."""
    tilt = _tilt(pose)
    moved = tilt * math.hypot(radius, 0.5 * length)
    if moved > LEVEL and tilt > LARGEST_TILT:
        return Standing(None, f"is a cylinder tilted by {math.degrees(tilt):.3g} degrees")
    x, y, z = pose[:3, 3]
    solid = Solid(name, "cylinder", z - 0.5 * length, z + 0.5 * length, centre=(x, y), radius=radius)
    return Standing(solid, note=_levelled(tilt, moved))


def upright_polygon(name: str, points: Points, height: float, pose: np.ndarray) -> Standing:
    """A polygon in its plane z = 0, extruded to z = ``height``, at ``pose`` ``(4, 4)``."""
    tilt = _tilt(pose)
    corners = np.array(points, dtype=float)
    moved = tilt * math.hypot(float(np.abs(corners).max()), height)
    if moved > LEVEL and tilt > LARGEST_TILT:
        return Standing(None, f"is an extruded outline tilted by {math.degrees(tilt):.3g} degrees")
    placed = np.column_stack([corners, np.zeros(len(corners))]) @ pose[:3, :3].T + pose[:3, 3]
    ends = sorted((float(pose[2, 3]), float(pose[2, 3] + math.copysign(height, pose[2, 2]))))
    outline = tuple((float(x), float(y)) for x, y in placed[:, :2])
    return Standing(Solid(name, "polygon", ends[0], ends[1], points=outline), note=_levelled(tilt, moved))


def prism_around(name: str, points: np.ndarray, pose: np.ndarray) -> Solid | None:
    """The upright prism over the convex hull of ``points`` ``(K, 3)``, seen from above; None for what has no volume."""
    placed = points @ pose[:3, :3].T + pose[:3, 3]
    base, top = float(placed[:, 2].min()), float(placed[:, 2].max())
    try:
        hull = ConvexHull(placed[:, :2])
    except (QhullError, ValueError):
        return None
    outline = tuple((float(x), float(y)) for x, y in placed[hull.vertices, :2])
    return Solid(name, "polygon", base, top, points=outline) if top - base > 1e-6 else None


def box_around(name: str, points: np.ndarray, pose: np.ndarray) -> Solid | None:
    """The upright prism around the cuboid, along a body's own axes, that holds ``points`` ``(K, 3)``."""
    low, high = points.min(axis=0), points.max(axis=0)
    if (high - low).min() < 1e-6:
        high, low = np.maximum(high, low + 1e-3), low
    at_centre = pose.copy()
    at_centre[:3, 3] = pose[:3, :3] @ (0.5 * (low + high)) + pose[:3, 3]
    standing = upright_box(name, high - low, at_centre)
    if standing.solid is not None:
        return standing.solid
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return prism_around(name, corners, pose)


def _tilt(pose: np.ndarray) -> float:
    """The angle between a body's z axis, up or down, and the vertical, radians."""
    return math.acos(min(1.0, abs(float(pose[2, 2]))))


def _levelled(tilt: float, moved: float) -> str:
    if moved <= LEVEL:
        return ""
    return (
        f"was tilted by {math.degrees(tilt):.2g} degrees and is levelled, which moves it by up to {1e3 * moved:.2g} mm"
    )
