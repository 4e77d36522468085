"""Depth images as planar scans: free columns, floor, what is low and what hangs above."""

from __future__ import annotations

import math

import numpy as np
import pytest

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


@pytest.mark.parametrize("height", [0.08, 0.2, 1.0])
def test_a_box_on_the_floor_is_seen_however_low_it_is(height):
    world = room({"box": {"at": [2.0, 0.0], "size": [0.4, 0.8], "height": height}})
    scan = obstacle_depth(seen(world), CAMERA)
    lateral = 1.887 * CAMERA.column_slopes  # its front face is 1.8 m ahead of the robot, 1.887 m of the camera
    inside = np.abs(lateral) < 0.39
    np.testing.assert_allclose(scan[inside], 1.887, atol=1e-5)
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
