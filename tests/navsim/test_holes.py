"""Holes in depth images: what they are filled with, against each pixel's own search, and against what is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navsim.camera import DepthCamera
from navsim.generate import generate_world
from navsim.holes import fill_holes
from navsim.raycast import render_depth
from navsim.sensor import KINECT, SensorModel
from navsim.simulator import Simulator
from navsim.world import World

CAMERA = DepthCamera()
AHEAD = np.zeros((1, 3))


def seen(*obstacles: dict, camera: DepthCamera = CAMERA) -> np.ndarray:
    world = World.from_dict({"format": 1, "size": [6, 6], "obstacles": list(obstacles)})
    return camera.from_planar(render_depth(world, AHEAD, camera))[0]


def filled_one_by_one(image: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Pixel by pixel: along the row, then along the column."""
    image = np.where(np.isnan(image) | (image < 0.0), 0.0, image)
    for lines, most in ((image, camera.width // 4), (None, camera.height // 4)):
        current = image if lines is not None else image.T
        found = current.copy()
        for row, line in enumerate(current):
            for column in np.flatnonzero(line == 0.0):
                left, right = column, column
                while left >= 0 and line[left] == 0.0:
                    left -= 1
                while right < len(line) and line[right] == 0.0:
                    right += 1
                ends = [line[end] for end in (left, right) if 0 <= end < len(line)]
                if ends and right - left - 1 <= most:
                    found[row, column] = max(ends)
        found = found if lines is not None else found.T
        image = np.where(image == 0.0, np.minimum(found, camera.floor_depth), image)
    return image


@given(
    seed=st.integers(0, 10_000),
    share=st.floats(0.0, 0.9),
    pitch=st.sampled_from([0.0, -7.0, 12.0]),
    kind=st.sampled_from(["planar", "range"]),
)
def test_each_hole_takes_the_farther_neighbour_up_to_the_floor(seed, share, pitch, kind):
    camera = DepthCamera(width=12, height=16, pitch_deg=pitch, depth=kind)
    generator = np.random.default_rng(seed)
    images = generator.uniform(0.4, 5.0, (3, 16, 12)).astype(np.float32)
    images[generator.random(images.shape) < share] = 0.0
    filled = fill_holes(images, camera)
    for image, found in zip(images, filled, strict=True):
        np.testing.assert_allclose(found, filled_one_by_one(image, camera), rtol=1e-6)
    np.testing.assert_array_equal(filled[images > 0.0], images[images > 0.0])


@pytest.mark.parametrize("camera", [CAMERA, DepthCamera(pitch_deg=10.0), DepthCamera(depth="range", mount_z=0.5)])
def test_lost_floor_is_floor_again(camera):
    ideal = seen(camera=camera)
    floor = ideal < camera.max_range - 1e-3
    floor &= np.isclose(ideal, camera.floor_depth, rtol=1e-5)
    holes = floor & (np.random.default_rng(0).random(ideal.shape) < 0.6)
    filled = fill_holes(np.where(holes, np.nan, ideal), camera)
    restored = filled[holes] > 0.0
    assert restored.mean() > 0.99
    # In rows in which the wall begins, a neighbour may be the wall, which is nearer than the floor would be.
    assert np.isclose(filled[holes][restored], ideal[holes][restored], rtol=0.02).mean() > 0.98


def test_a_shadow_shows_what_lies_behind():
    post = {"cylinder": {"at": [1.2, 0.0], "radius": 0.1, "height": 1.5}}
    ideal = seen(post)
    shadows = np.zeros_like(ideal, dtype=bool)
    edge = int(np.flatnonzero(ideal[10] < 2.0)[0])
    shadows[:40, edge - 4 : edge] = True
    filled = fill_holes(np.where(shadows, 0.0, ideal), CAMERA)
    np.testing.assert_allclose(filled[:32], ideal[:32], rtol=1e-5)


def test_a_hole_as_wide_and_high_as_something_very_near_stays():
    image = np.full((64, 80), 3.0)
    image[:20, 30:51] = 0.0
    assert (fill_holes(image, CAMERA)[:20, 30:51] == 0.0).all()
    image[:20, 30] = 3.0
    assert (fill_holes(image, CAMERA)[:20, 31:51] == 3.0).all()


def test_a_kinects_images_are_nearly_the_ideal_ones_again():
    """Where they show something at all, and apart from noise; see docs/faults.md for what that is worth."""
    losses = replace(KINECT, axial_noise=0.0, lateral_noise=0.0, disparity_step=0.0)
    depths = {}
    for name, sensor in {"ideal": SensorModel(), "lossy": losses, "filled": replace(losses, filled=True)}.items():
        simulator = Simulator(generate_world("clutter", seed=3), 40, sensor=sensor, seed=1)
        depths[name] = simulator.reset().depth.astype(int)
    lost = (depths["lossy"] == 0) & (depths["ideal"] > 0)
    assert lost.mean() > 0.05
    off = np.abs(depths["filled"] - depths["ideal"]) * CAMERA.max_range / 255.0
    assert (depths["filled"][lost] == 0).mean() < 0.05
    assert np.median(off[lost]) < 0.05
    np.testing.assert_array_equal(depths["filled"][~lost], depths["lossy"][~lost])


def test_what_cannot_be_filled_is_told():
    with pytest.raises(ValueError, match=r"64 rows of 80 pixels; got an array of \(80, 64\)"):
        fill_holes(np.zeros((80, 64)), CAMERA)
    with pytest.raises(ValueError, match="before they become counts; got uint8"):
        fill_holes(np.zeros((64, 80), dtype=np.uint8), CAMERA)
