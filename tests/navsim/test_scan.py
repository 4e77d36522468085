"""Depth images as planar scans: free columns, floor, what is low and what hangs above."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.scan import metres, obstacle_depth, scan_points
from navsim.world import World

CAMERA = DepthCamera()
AT_ORIGIN = np.zeros((1, 3))


def room(*obstacles: dict, size: float = 12.0) -> World:
    return World.from_dict({"format": 1, "size": [size, size], "obstacles": list(obstacles)})


def seen(world: World, camera: DepthCamera = CAMERA, pose: np.ndarray = AT_ORIGIN) -> np.ndarray:
    return camera.from_planar(render_depth(world, pose, camera))[0]


def test_the_bare_floor_is_no_obstacle():
    np.testing.assert_array_equal(obstacle_depth(seen(room()), CAMERA), CAMERA.max_range)
    np.testing.assert_array_equal(obstacle_depth(CAMERA.to_uint8(seen(room())), CAMERA), CAMERA.max_range)


def test_a_wall_ahead_has_its_distance_in_every_column():
    facing_east = np.array([[4.0, 0.0, 0.0]])  # the wall at x = 6 is 2 m ahead of the robot, 2.087 m of the camera
    np.testing.assert_allclose(obstacle_depth(seen(room(), pose=facing_east), CAMERA), 2.087, atol=1e-5)


@pytest.mark.parametrize(("height", "away"), [(0.07, 0.7), (0.14, 2.0), (0.2, 2.0), (1.0, 2.0)])
def test_a_box_on_the_floor_is_seen_however_low_it_is(height, away):
    world = room({"box": {"at": [away, 0.0], "size": [0.4, 0.8], "height": height}})
    scan = obstacle_depth(seen(world), CAMERA)
    front = away - 0.2 + 0.087  # metres from the camera, which sits behind the robot's centre
    lateral = front * CAMERA.column_slopes
    inside = np.abs(lateral) < 0.39
    np.testing.assert_allclose(scan[inside], front, atol=1e-5)
    assert (scan[np.abs(lateral) > 0.5] == CAMERA.max_range).all()


def test_a_table_top_above_the_robot_is_out_of_the_way_but_a_beam_in_front_of_it_is_not():
    top = room({"box": {"at": [1.5, 0.0], "size": [1.0, 1.0], "base": 0.7, "height": 0.04}})
    beam = room({"box": {"at": [1.5, 0.0], "size": [0.1, 1.0], "base": 0.35, "height": 0.05}})
    assert (seen(top) < CAMERA.max_range - 0.01)[:20].any()
    assert (obstacle_depth(seen(top), CAMERA) == CAMERA.max_range).all()
    assert obstacle_depth(seen(beam), CAMERA)[40] == pytest.approx(1.537, abs=1e-5)


def test_counts_agree_with_metres_to_one_count():
    world = room(
        {"box": {"at": [1.6, 0.4], "size": [0.3, 0.3], "height": 0.5, "yaw_deg": 30}},
        {"cylinder": {"at": [2.5, -0.8], "radius": 0.3, "height": 0.12}},
    )
    ideal = seen(world)
    exact, counted = obstacle_depth(ideal, CAMERA), obstacle_depth(CAMERA.to_uint8(ideal), CAMERA)
    assert np.abs(exact - counted).max() <= 0.5 * CAMERA.max_range / 255 + 1e-6


@pytest.mark.parametrize("camera", [CAMERA, DepthCamera(mount_z=0.6)], ids=["the robot's", "above it"])
def test_no_return_is_an_obstacle_in_the_blind_zone(camera):
    image = np.full((CAMERA.height, CAMERA.width), 255, dtype=np.uint8)
    image[30, 7] = 0
    scan = obstacle_depth(image, camera)
    assert scan[7] == 0.0
    assert (np.delete(scan, 7) == CAMERA.max_range).all()


def test_a_camera_that_measures_ranges_gives_the_same_scan():
    world = room({"box": {"at": [2.0, 0.5], "size": [0.4, 0.8], "height": 0.3}})
    ranging = DepthCamera(depth="range")
    np.testing.assert_allclose(
        obstacle_depth(seen(world, ranging), ranging), obstacle_depth(seen(world), CAMERA), rtol=1e-5
    )


def test_points_of_a_scan_lie_where_the_obstacle_is():
    world = room({"cylinder": {"at": [2.0, 0.3], "radius": 0.4, "height": 1.0}})
    scan = obstacle_depth(seen(world), CAMERA)
    points = scan_points(scan, CAMERA)[scan < CAMERA.max_range]
    assert len(points) > 10
    np.testing.assert_allclose(np.hypot(points[:, 0] - 2.0, points[:, 1] - 0.3), 0.4, atol=1e-4)


def test_scans_of_many_images_at_once_are_those_of_each():
    world = room({"box": {"at": [2.0, 0.0], "size": [0.4, 0.8], "height": 0.3}})
    poses = np.array([[0.0, 0.0, yaw] for yaw in np.linspace(-math.pi, math.pi, 5)])
    images = render_depth(world, poses, CAMERA).reshape(5, 1, CAMERA.height, CAMERA.width)
    together = obstacle_depth(images, CAMERA)
    assert together.shape == (5, 1, CAMERA.width)
    for image, scan in zip(images, together, strict=True):
        np.testing.assert_array_equal(obstacle_depth(image, CAMERA), scan)


def test_metres_leaves_floats_alone():
    assert metres(np.float32([1.25]), CAMERA).tolist() == [1.25]


@pytest.mark.parametrize("pitch_deg", [-8.0, 10.0, 18.0])
@pytest.mark.parametrize("depth", ["planar", "range"])
def test_a_pitched_camera_scans_what_a_level_one_does(pitch_deg, depth):
    """To within a column, and a count of depth; the floor stays out."""
    world = room(
        {"box": {"at": [2.0, 0.5], "size": [0.4, 0.4], "height": 1.0}},
        {"cylinder": {"at": [1.5, -0.4], "radius": 0.2, "height": 1.0}},
        {"box": {"at": [3.0, -0.2], "size": [0.3, 0.3], "height": 0.25}},
    )
    level, pitched = DepthCamera(depth=depth), DepthCamera(depth=depth, pitch_deg=pitch_deg)
    expected = obstacle_depth(seen(world, level), level)
    scan = obstacle_depth(seen(world, pitched), pitched)
    nearby = np.stack([np.roll(expected, shift) for shift in (-1, 0, 1)])
    assert np.all((scan > nearby.min(axis=0) - 0.02) & (scan < nearby.max(axis=0) + 0.02))
    np.testing.assert_array_equal(obstacle_depth(seen(room(), pitched), pitched), 5.0)


@pytest.mark.parametrize("nominal", [CAMERA, DepthCamera(pitch_deg=12.0), DepthCamera(depth="range")])
@pytest.mark.parametrize(("pitch", "lower"), [(3.0, 0.0), (-3.0, 0.0), (2.0, 0.02), (0.0, 0.03), (-2.0, -0.03)])
def test_the_floor_is_no_obstacle_to_a_camera_that_is_mounted_otherwise_than_it_knows(nominal, pitch, lower):
    tilted = replace(nominal, pitch_deg=nominal.pitch_deg + pitch, mount_z=nominal.mount_z - lower)
    scan = obstacle_depth(tilted.to_uint8(seen(room(), tilted)), nominal)
    np.testing.assert_array_equal(scan, nominal.max_range)


def test_no_return_is_nothing_in_rows_in_which_the_floor_is_in_the_blind_zone():
    low = DepthCamera(mount_z=0.15)
    image = low.to_uint8(seen(room(), low))
    assert (image[-1] == 0).all()
    assert (image[32] > 0).all()
    np.testing.assert_array_equal(obstacle_depth(image, low), low.max_range)
    image[20, 7] = 0  # something very near, as high as the camera
    scan = obstacle_depth(image, low)
    assert scan[7] == 0.0
    assert (np.delete(scan, 7) == low.max_range).all()


@given(
    mount_z=st.floats(0.05, 1.2),
    pitch=st.floats(-30.0, 30.0),
    share=st.floats(0.0, 0.95),
    above=st.floats(0.0, 0.8),
    lossy=st.booleans(),
    kind=st.sampled_from(["planar", "range"]),
    seed=st.integers(0, 1000),
)
def test_what_obstructs_is_found_pixel_by_pixel_too(mount_z, pitch, share, above, lossy, kind, seed):
    """Against each pixel's point in space, from the ray through it; images of one column, which no pitch bends."""
    camera = DepthCamera(width=1, height=24, mount_z=mount_z, pitch_deg=pitch, depth=kind)
    low, high = share * mount_z, share * mount_z + above
    image = np.random.default_rng(seed).uniform(0.41, 5.2, (24, 1)).astype(np.float32)
    image[image > 4.8] = 5.0
    image[np.random.default_rng(seed).permutation(24)[:3]] = 0.0
    expected = camera.max_range
    down = math.radians(pitch)
    for row in range(24):
        slope = (11.5 - row) * 2.0 * math.tan(math.radians(camera.vertical_fov_deg / 2.0)) / 24
        angle = math.atan(slope) - down  # of the ray, over the horizon

        def point(reading, slope=slope, angle=angle):
            along = reading if kind == "range" else reading * math.hypot(1.0, slope)
            return along * math.cos(angle), mount_z + along * math.sin(angle)

        def is_floor(reading, point=point):
            ahead, height = point(reading)
            return height <= low + math.tan(math.radians(3.0)) * ahead

        reading = float(image[row, 0])
        ahead, height = point(reading)
        limits = (low + math.tan(math.radians(3.0)) * ahead, high)
        assume(min(abs(height - limit) for limit in limits) > 1e-4)  # float32 may decide otherwise
        if reading == 0.0:
            in_the_way = not lossy and not is_floor(0.4)
        else:
            in_the_way = reading < camera.max_range and limits[0] < height < limits[1]
        if in_the_way:
            expected = min(expected, ahead if pitch else point(reading)[0])
    assert obstacle_depth(image, camera, low=low, high=high, lossy=lossy)[0] == pytest.approx(expected, abs=1e-4)
