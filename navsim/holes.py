"""Depth images without a return here and there, filled in with what is beside, so that networks know what they see."""

from __future__ import annotations

import numpy as np

from navsim.camera import DepthCamera

LARGEST = 0.25
"""Share of the image's width, or height, up to which a hole is filled; a larger one is something too near for the
sensor."""


def fill_holes(depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Depth images whose pixels without a return show what lies behind.

    A structured-light or stereo camera loses the strip of the background that something nearer hides from its second
    eye, pixels along edges, and surfaces that it grazes, the floor above all. So a hole takes the farther of its two
    neighbours in the row, and then in the column what no row could fill; but nothing is seen beyond the floor, whose
    depth in each row follows from how the camera is mounted. Holes wider and higher than ``LARGEST`` stay.

    What is too near to be measured leaves a hole, too. Where it takes up less than ``LARGEST`` it disappears, so keep
    to other sensors for what must not be bumped into.

    Args:
        depth: ``(..., H, W)`` floats, metres; 0, NaN and what is negative are no return.
        camera: whose images they are.

    Returns:
        ``(..., H, W)`` float32, metres; 0 where there still is no return.

    Raises:
        ValueError: for images of another size than the camera's, and of other numbers than floats.

    >>> camera = DepthCamera(width=8, height=1)
    >>> fill_holes(np.array([[3.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 2.0]]), camera).tolist()
    [[3.0, 3.0, 3.0, 1.0, 1.0, 1.0, 1.0, 2.0]]
    """
    depth = np.asarray(depth)
    if depth.shape[-2:] != (camera.height, camera.width):
        raise ValueError(
            f"the camera's images have {camera.height} rows of {camera.width} pixels; got an array of {depth.shape}"
        )
    if not np.issubdtype(depth.dtype, np.floating):
        raise ValueError(f"holes are filled in metres, before they become counts; got {depth.dtype}")
    seen = np.where(depth > 0.0, depth, 0.0).astype(np.float32)  # NaN is not greater than anything
    for axis, size in ((-1, camera.width), (-2, camera.height)):
        holes = seen == 0.0
        if not holes.any():
            break
        beside = _farther_beside(seen, axis, max(1, int(LARGEST * size)))
        seen = np.where(holes, np.minimum(beside, camera.floor_depth), seen)
    return seen


def _farther_beside(seen: np.ndarray, axis: int, most: int) -> np.ndarray:
    """The farther of the returns before and after each pixel; 0 in holes of more than ``most`` pixels."""
    line = np.moveaxis(seen, axis, -1)
    count = line.shape[-1]
    at, valid = np.arange(count), line > 0.0
    before = np.maximum.accumulate(np.where(valid, at, -1), axis=-1)
    after = np.minimum.accumulate(np.where(valid, at, count)[..., ::-1], axis=-1)[..., ::-1]
    bordered = np.concatenate([line, np.zeros_like(line[..., :1])], axis=-1)  # its last is before the first, too
    farther = np.maximum(
        np.take_along_axis(bordered, before, axis=-1),
        np.take_along_axis(bordered, after, axis=-1),
    )
    return np.moveaxis(np.where(after - before - 1 <= most, farther, np.float32(0.0)), -1, axis)
