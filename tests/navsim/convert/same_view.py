"""Whether two worlds look the same to the depth camera: what round trips are judged by."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

import navsim
from navsim.camera import DepthCamera

CAMERA = DepthCamera(width=60, height=48)
MILLIMETRE = 1e-3


def poses_in(world: navsim.World, count: int, seed: int = 0) -> np.ndarray:
    """``(count, 3)``: anywhere in the room, facing anywhere."""
    generator = np.random.default_rng(seed)
    half = world.half_size
    return np.column_stack([generator.uniform(-half, half, (count, 2)), generator.uniform(-np.pi, np.pi, count)])


def part_that_differs(images: np.ndarray, others: np.ndarray, by: float = MILLIMETRE) -> float:
    """The part of the pixels that differ by more than ``by`` metres, once edges may be off by a ray.

    A pixel whose ray grazes an edge may see either side of it.
    """
    low, high = (f(images, size=(1, 3, 3)) for f in (minimum_filter, maximum_filter))
    assert ((others >= low - by) & (others <= high + by)).mean() > 0.9999
    return float((np.abs(images - others) > by).mean())


def assert_same_view(world: navsim.World, other: navsim.World, count: int = 60, by: float = MILLIMETRE) -> None:
    poses = poses_in(world, count)
    images, others = (navsim.render_depth(each, poses, CAMERA) for each in (world, other))
    assert part_that_differs(images, others, by) < 2e-4


def _decimals(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False).map(lambda value: round(value, 4))


@st.composite
def obstacles(draw: st.DrawFn) -> dict:
    """An entry of ``obstacles`` near the middle of a room of 8 x 6 m, standing or hanging; polygons may be concave."""
    at = [draw(_decimals(-2.5, 2.5)), draw(_decimals(-1.5, 1.5))]
    settings: dict = {"height": draw(_decimals(0.02, 1.5))}
    if draw(st.booleans()):
        settings["base"] = draw(_decimals(0.01, 0.8))
    kind = draw(st.sampled_from(["box", "cylinder", "polygon"]))
    if kind == "box":
        settings |= {"at": at, "size": [draw(_decimals(0.02, 1.2)), draw(_decimals(0.02, 1.2))]}
        settings["yaw_deg"] = draw(_decimals(-180, 180))
    elif kind == "cylinder":
        settings |= {"at": at, "radius": draw(_decimals(0.02, 0.5))}
    else:
        radii = draw(st.lists(_decimals(0.1, 0.9), min_size=4, max_size=10))
        angles = np.arange(len(radii)) * np.pi * 2.0 / len(radii)
        points = [
            [round(at[0] + r * np.cos(a), 4), round(at[1] + r * np.sin(a), 4)]
            for r, a in zip(radii, angles, strict=True)
        ]
        settings["points"] = points[::-1] if draw(st.booleans()) else points
    return {kind: settings}


@st.composite
def worlds(draw: st.DrawFn) -> navsim.World:
    """Rooms of 8 x 6 m with up to six obstacles, with walls or without."""
    walls = draw(st.sampled_from(["none", {"height": 1.0, "thickness": 0.2}, {"height": 2.0, "thickness": 0.1}]))
    shapes = draw(st.lists(obstacles(), max_size=6))
    return navsim.World.from_dict({"format": 1, "size": [8.0, 6.0], "walls": walls, "obstacles": shapes})
