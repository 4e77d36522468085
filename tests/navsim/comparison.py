"""Depth images held against the references, and the rooms and poses that several tests look at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from reference import (
    MeshReference,
    MujocoReference,
    depth_image,
    explained_by_silhouettes,
    on_a_surface,
)

from navsim.camera import DepthCamera

EYE = DepthCamera().mount_z
SMALL = DepthCamera(width=33, height=17)
POINT = DepthCamera(width=1, height=1)

MILLIMETRE = 1e-3
"""Metres that a pixel may be off before it has to be at a silhouette."""
OFF_AT_MOST = 0.001
"""The share of such pixels."""


def world_of(*obstacles: dict[str, Any], size: float = 20.0, walls: Any = "none") -> dict[str, Any]:
    return {"format": 1, "size": [size, size], "walls": walls, "obstacles": list(obstacles)}


def box(at: tuple[float, float], size: tuple[float, float], height: float, **more: float) -> dict[str, Any]:
    return {"box": {"at": list(at), "size": list(size), "height": height, **more}}


def random_room(rng: np.random.Generator, obstacles: int = 24, size: float = 7.0) -> dict[str, Any]:
    """Boxes, cylinders and concave polygons of all heights, on the floor or above it, overlapping as they happen to."""
    entries: list[dict[str, Any]] = []
    for _ in range(obstacles):
        at = rng.uniform(-0.5 * size, 0.5 * size, 2)
        base = float(rng.choice([0.0, 0.0, rng.uniform(0.0, 0.8)]))
        height = float(rng.choice([rng.uniform(0.02, 0.28), rng.uniform(0.3, 2.0)]))
        kind = rng.integers(3)
        if kind == 0:
            shape = {"at": at.tolist(), "size": rng.uniform(0.05, 0.8, 2).tolist(), "yaw_deg": rng.uniform(-180, 180)}
        elif kind == 1:
            shape = {"at": at.tolist(), "radius": rng.uniform(0.02, 0.4)}
        else:
            corners = int(rng.integers(3, 9))
            angle = (np.arange(corners) + rng.uniform(0.0, 0.9, corners)) * 2.0 * math.pi / corners
            at = np.clip(at, 0.6 - 0.5 * size, 0.5 * size - 0.6)  # so that all corners are in the room
            points = at + rng.uniform(0.1, 0.6, (corners, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            shape = {"points": points[:: rng.choice([-1, 1])].tolist()}
        entries.append({("box", "cylinder", "polygon")[kind]: {**shape, "base": base, "height": height}})
    return {"format": 1, "size": [size, size], "obstacles": entries}


def random_poses(rng: np.random.Generator, count: int, size: tuple[float, float]) -> np.ndarray:
    """All over the room and a little outside it; each fourth one looks exactly along an axis."""
    half = 0.5 * np.array(size) + 0.2
    poses = np.concatenate([rng.uniform(-half, half, (count, 2)), rng.uniform(-math.pi, math.pi, (count, 1))], axis=1)
    poses[::4, 2] = rng.choice([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], len(poses[::4]))
    return poses


LEDGER: dict[str, Comparison] = {}
"""All that was compared with each reference since Python started: what the summary of a test run tells."""


class Comparison:
    """Images held against a reference: what was compared, and how many pixels are off by more than a millimetre.

    A pose from which the camera is within 10 µm of a surface is left out, and not counted: there, inside and outside
    are a matter of rounding.
    """

    def __init__(self) -> None:
        self.poses = self.pixels = self.off = 0

    def add(
        self, reference: MeshReference | MujocoReference, camera: DepthCamera, poses: np.ndarray, images: np.ndarray
    ) -> None:
        """Compares ``images`` ``(N, H, W)``; every pixel that is off must lie within a pixel of a silhouette."""
        assert images.shape == (len(poses), camera.height, camera.width)
        assert images.dtype == np.float32
        for pose, image in zip(poses, images, strict=True):
            assert np.all((image >= 0.0) & (image <= np.float32(camera.max_range))), pose.tolist()
            if on_a_surface(reference, camera, pose):
                continue
            expected = depth_image(reference, camera, pose)
            rows, columns = np.nonzero(np.abs(image - expected) > MILLIMETRE)
            for tally in (self, LEDGER.setdefault(reference.name, Comparison())):
                tally.poses += 1
                tally.pixels += image.size
                tally.off += len(rows)
            if len(rows):
                seen = image[rows, columns]
                explained = explained_by_silhouettes(reference.cast, camera, pose, rows, columns, seen)
                first = int(np.argmin(explained))
                assert explained.all(), (
                    f"{np.count_nonzero(~explained)} of {len(rows)} pixels off are not at a silhouette, pose "
                    f"{pose.tolist()}, first row {rows[first]} column {columns[first]}: "
                    f"{seen[first]} instead of {expected[rows[first], columns[first]]}"
                )

    def check(self, least_poses: int) -> None:
        """Asserts that so many poses were compared, and that less than a thousandth of their pixels is off."""
        assert self.poses >= least_poses, f"{self.poses} poses compared"
        assert self.off < OFF_AT_MOST * self.pixels, f"{self.off} of {self.pixels} pixels are off"
