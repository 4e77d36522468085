"""The depth camera: its geometry, its place on the robot, and what the sensor makes of ideal depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from navsim.settings import check_kinds

KINECT_VERTICAL_FOV_DEG = math.degrees(2.0 * math.atan(math.tan(math.radians(30.0)) * 480 / 640))
"""Vertical field of view of a 640x480 image of square pixels that is 60° wide, degrees (46.83)."""

LARGEST_SIDE = 4096
"""Pixels of an image's width or height; settings that come from a file may ask for anything."""


class Mounts(NamedTuple):
    """How the cameras of N robots are mounted; they may differ in nothing else."""

    x: np.ndarray
    """``(N,)`` metres ahead of each robot's centre"""
    y: np.ndarray
    """``(N,)`` metres to the left of it"""
    z: np.ndarray
    """``(N,)`` metres above the floor"""
    pitch: np.ndarray
    """``(N,)`` radians by which the optical axis points below the horizon"""

    def take(self, robots: np.ndarray) -> Mounts:
        """Those of some robots, by index or mask."""
        return Mounts(*(values[robots] for values in self))


def tilted(row_slopes: np.ndarray, pitch: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """How far rays of rows get ahead and upwards, level and plumb, per metre of planar depth.

    The camera turns about its left axis. So a pixel's ray, (1, t, m) along the optical axis, to the left and towards
    the image's upper border, is (cos p + m sin p, t, m cos p - sin p) ahead, to the left and upwards: the first and
    the last depend on the row alone.

    Args:
        row_slopes: m of each row.
        pitch: p, radians, positive downwards; of a shape that broadcasts with ``row_slopes``.

    Returns:
        two arrays of the broadcast shape; for a level camera ones, and ``row_slopes`` bit for bit.
    """
    sine, cosine = np.sin(pitch), np.cos(pitch)
    return cosine + row_slopes * sine, row_slopes * cosine - sine


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera on the robot; the defaults are the Kinect of a TurtleBot 2.

    Any image size can be asked for: the field of view stays, so pixels need not be square.

    >>> camera = DepthCamera(width=160, height=128)
    >>> round(camera.fx, 1), round(camera.fy, 1)
    (138.6, 147.8)
    """

    width: int = 80
    """Columns of the image, pixels."""
    height: int = 64
    """Rows of the image, pixels."""
    horizontal_fov_deg: float = 60.0
    """Horizontal field of view, degrees."""
    vertical_fov_deg: float = KINECT_VERTICAL_FOV_DEG
    """Vertical field of view, degrees; by default that of the Kinect's square pixels."""
    mount_x: float = -0.087
    """Where the camera sits ahead of the robot's centre, metres (negative: behind it)."""
    mount_y: float = 0.0
    """Where the camera sits to the left of the robot's centre, metres."""
    mount_z: float = 0.297
    """Height of the camera above the floor, metres."""
    pitch_deg: float = 0.0
    """Angle by which the camera looks down, degrees; negative: up. Depth is along the optical axis as it is pitched."""
    min_range: float = 0.05
    """Depth under which the sensor returns nothing, whatever its blind zone, metres."""
    max_range: float = 5.0
    """Depth at which readings saturate, metres."""
    blind_zone: float = 0.4
    """Depth under which a Kinect reads 0, "no return", metres. Collision checks see through it."""
    depth: Literal["planar", "range"] = "planar"
    """What a pixel holds: "planar" depth along the optical axis, as Kinect drivers publish, or the ray's length."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise ValueError(f"camera {name} must be a whole number of pixels, at least 1; got {value!r}")
            if value > LARGEST_SIDE:
                raise ValueError(f"camera {name} must be at most {LARGEST_SIDE} pixels; got {value!r}")
        check_kinds(self, "camera")
        for name in ("horizontal_fov_deg", "vertical_fov_deg"):
            if not 0.0 < getattr(self, name) < 180.0:
                raise ValueError(f"camera {name} must lie between 0 and 180 degrees; got {getattr(self, name)!r}")
        for name in ("mount_x", "mount_y"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"camera {name} must be a finite number of metres; got {getattr(self, name)!r}")
        if not (math.isfinite(self.mount_z) and self.mount_z > 0.0):
            raise ValueError(f"camera mount_z must be above the floor, in metres; got {self.mount_z!r}")
        steepest = abs(self.pitch_deg) + 0.5 * self.vertical_fov_deg
        if not steepest < 90.0:
            raise ValueError(
                "camera pitch_deg must leave every pixel's view ahead of the robot, so that |pitch_deg| plus half of "
                f"vertical_fov_deg ({self.vertical_fov_deg:.4g}) is under 90 degrees; got {self.pitch_deg!r}"
            )
        if not (0.0 <= self.min_range < self.max_range and math.isfinite(self.max_range)):
            raise ValueError(
                f"camera ranges must satisfy 0 <= min_range < max_range; got {self.min_range!r} and {self.max_range!r}"
            )
        if not 0.0 <= self.blind_zone < self.max_range:
            raise ValueError(
                f"camera blind_zone must lie between 0 and max_range ({self.max_range} m); got {self.blind_zone!r}"
            )
        if self.depth not in ("planar", "range"):
            raise ValueError(f'camera depth must be "planar" or "range"; got {self.depth!r}')

    @property
    def fx(self) -> float:
        """Focal length in columns."""
        return self.width / 2 / math.tan(math.radians(self.horizontal_fov_deg) / 2)

    @property
    def fy(self) -> float:
        """Focal length in rows."""
        return self.height / 2 / math.tan(math.radians(self.vertical_fov_deg) / 2)

    @cached_property
    def column_slopes(self) -> np.ndarray:
        """``(W,)`` metres to the left per metre of planar depth at the columns' centres, leftmost column first."""
        return (self.width / 2 - 0.5 - np.arange(self.width)) / self.fx

    @cached_property
    def row_slopes(self) -> np.ndarray:
        """``(H,)`` metres upwards per metre of planar depth, at the rows' centres; the first row is the top one."""
        return (self.height / 2 - 0.5 - np.arange(self.height)) / self.fy

    @cached_property
    def row_advances(self) -> np.ndarray:
        """``(H,)`` metres ahead, along the floor, per metre of planar depth at the rows' centres; 1 if level."""
        return tilted(self.row_slopes, math.radians(self.pitch_deg))[0]

    @cached_property
    def row_climbs(self) -> np.ndarray:
        """``(H,)`` metres upwards, plumb, per metre of planar depth at the rows' centres."""
        return tilted(self.row_slopes, math.radians(self.pitch_deg))[1]

    @property
    def floor_reach(self) -> float:
        """Metres along the floor that no ray gets further per metre of planar depth, at the centre of any pixel."""
        return math.hypot(float(self.row_advances.max()), float(self.column_slopes[0]))

    def mounts(self, count: int) -> Mounts:
        """This camera on each of ``count`` robots."""
        values = (self.mount_x, self.mount_y, self.mount_z, math.radians(self.pitch_deg))
        return Mounts(*(np.full(count, value) for value in values))

    @cached_property
    def inverse_row_slopes(self) -> np.ndarray:
        """``(H,)`` planar depth per metre of height; huge but finite for a level row, whose height never changes."""
        return 1.0 / np.where(np.abs(self.row_slopes) < 1e-12, 1e-12, self.row_slopes)

    @cached_property
    def ray_lengths(self) -> np.ndarray:
        """``(H, W)`` float32, length of a pixel's ray per metre of planar depth."""
        return np.sqrt(1.0 + self.column_slopes[None, :] ** 2 + self.row_slopes[:, None] ** 2).astype(np.float32)

    @cached_property
    def floor_depth(self) -> np.ndarray:
        """``(H, W)`` float32, what each pixel reads of the bare floor, metres (``max_range`` where it sees none)."""
        depth = np.full((self.height, self.width), np.inf, dtype=np.float32)
        down = self.row_climbs < 0
        depth[down] = (-self.mount_z / self.row_climbs[down])[:, None]
        return self.from_planar(depth)

    @property
    def least_floor_depth(self) -> float:
        """The least reading that the bare floor gives, metres (``max_range`` where no pixel sees it)."""
        return float(self.floor_depth.min())

    def from_planar(self, planar: np.ndarray) -> np.ndarray:
        """What the ideal sensor makes of planar ``(..., H, W)``, metres: ``depth``'s kind, at most ``max_range``."""
        seen = planar if self.depth == "planar" else planar * self.ray_lengths
        return np.minimum(seen, self.max_range)

    def to_uint8(self, ideal: np.ndarray) -> np.ndarray:
        """What a network gets for a sensor's ``(..., H, W)`` metres: uint8, 255 = ``max_range`` or more, 0 = no return.

        One count is ``max_range / 255``, 19.6 mm by default. Depth under the blind zone (or ``min_range``) becomes 0,
        and so does NaN.
        """
        scaled = np.multiply(ideal, np.float32(255.0 / self.max_range), dtype=np.float32)
        scaled += np.float32(0.5)
        # What is out of range would wrap around; fmin and fmax leave out NaN, which is no return below.
        counts = np.fmax(np.fmin(scaled, np.float32(255.0)), np.float32(0.0)).astype(np.uint8)
        threshold = np.float32(max(self.blind_zone, self.min_range))
        counts *= ideal >= threshold
        return counts
