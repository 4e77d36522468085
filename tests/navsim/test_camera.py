"""The depth camera's settings, geometry, and what a network gets of its images."""

from __future__ import annotations

import dataclasses
import math
import pickle

import numpy as np
import pytest

from navsim.camera import DepthCamera


def test_vertical_field_of_view_is_that_of_square_pixels_at_640x480():
    assert DepthCamera().vertical_fov_deg == pytest.approx(46.8, abs=0.05)
    full = DepthCamera(width=640, height=480)
    assert full.fx == pytest.approx(full.fy)


@pytest.mark.parametrize(("width", "height"), [(80, 64), (160, 128), (33, 17), (1, 1)])
def test_focal_lengths_follow_the_size_of_the_image(width, height):
    camera = DepthCamera(width=width, height=height)
    assert camera.fx == pytest.approx(width / 2 / math.tan(math.radians(30)))
    assert camera.fy == pytest.approx(height / 2 / (0.75 * math.tan(math.radians(30))))


def test_slopes_run_from_upper_left_to_lower_right_half_a_pixel_inside_the_view():
    camera = DepthCamera(width=80, height=64)
    assert camera.column_slopes[0] == pytest.approx(math.tan(math.radians(30)) * 79 / 80)
    assert camera.column_slopes[-1] == -camera.column_slopes[0]
    assert camera.row_slopes[0] == pytest.approx(0.75 * math.tan(math.radians(30)) * 63 / 64)
    assert camera.row_slopes[-1] == -camera.row_slopes[0]
    assert np.all(np.diff(camera.column_slopes) < 0)
    assert np.all(np.diff(camera.row_slopes) < 0)


def test_the_default_is_the_kinect_of_a_turtlebot():
    camera = DepthCamera()
    assert (camera.width, camera.height, camera.horizontal_fov_deg) == (80, 64, 60.0)
    assert (camera.mount_x, camera.mount_y, camera.mount_z) == (-0.087, 0.0, 0.297)
    assert (camera.min_range, camera.max_range, camera.blind_zone, camera.depth) == (0.05, 5.0, 0.4, "planar")


def test_cameras_are_values():
    assert DepthCamera(width=33) == DepthCamera(width=33) != DepthCamera()
    camera = DepthCamera(height=17)
    assert camera.row_slopes.shape == (17,)
    assert pickle.loads(pickle.dumps(camera)) == camera
    assert hash(dataclasses.replace(camera, height=64)) == hash(DepthCamera())


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"width": 0}, "camera width must be a whole number of pixels, at least 1; got 0"),
        ({"width": 80.0}, "camera width must be a whole number of pixels, at least 1; got 80.0"),
        ({"height": -3}, "camera height must be a whole number of pixels, at least 1; got -3"),
        ({"width": 4097}, "camera width must be at most 4096 pixels; got 4097"),
        ({"height": True}, "camera height must be a whole number of pixels, at least 1; got True"),
        ({"horizontal_fov_deg": 180.0}, "camera horizontal_fov_deg must lie between 0 and 180 degrees; got 180.0"),
        ({"vertical_fov_deg": 0.0}, "camera vertical_fov_deg must lie between 0 and 180 degrees; got 0.0"),
        ({"vertical_fov_deg": math.nan}, "camera vertical_fov_deg must lie between 0 and 180 degrees; got nan"),
        ({"mount_x": math.inf}, "camera mount_x must be a finite number of metres; got inf"),
        ({"mount_y": math.nan}, "camera mount_y must be a finite number of metres; got nan"),
        ({"mount_z": 0.0}, "camera mount_z must be above the floor, in metres; got 0.0"),
        ({"mount_z": math.inf}, "camera mount_z must be above the floor, in metres; got inf"),
        (
            {"pitch_deg": 67.0},
            "camera pitch_deg must leave every pixel's view ahead of the robot, so that |pitch_deg| plus half of "
            "vertical_fov_deg (46.83) is under 90 degrees; got 67.0",
        ),
        (
            {"pitch_deg": math.nan},
            "camera pitch_deg must leave every pixel's view ahead of the robot, so that |pitch_deg| plus half of "
            "vertical_fov_deg (46.83) is under 90 degrees; got nan",
        ),
        ({"min_range": -0.1}, "camera ranges must satisfy 0 <= min_range < max_range; got -0.1 and 5.0"),
        ({"max_range": 0.05}, "camera ranges must satisfy 0 <= min_range < max_range; got 0.05 and 0.05"),
        ({"max_range": math.inf}, "camera ranges must satisfy 0 <= min_range < max_range; got 0.05 and inf"),
        ({"blind_zone": 5.0}, "camera blind_zone must lie between 0 and max_range (5.0 m); got 5.0"),
        ({"blind_zone": -0.4}, "camera blind_zone must lie between 0 and max_range (5.0 m); got -0.4"),
        ({"depth": "radial"}, 'camera depth must be "planar" or "range"; got \'radial\''),
    ],
)
def test_impossible_settings_are_refused_in_one_sentence(setting, message):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the whole sentence is compared below
        DepthCamera(**setting)
    assert str(refused.value) == message


def test_a_numpy_integer_is_a_size():
    assert DepthCamera(width=np.int64(33)).column_slopes.shape == (33,)


def test_to_uint8_gives_255_at_the_greatest_depth_and_one_count_every_196_tenths_of_a_millimetre():
    camera = DepthCamera()
    counts = np.arange(21, 256)  # from the blind zone on
    for shift in (-0.49, 0.0, 0.49):
        depth = np.minimum((counts + shift) * (5.0 / 255.0), 5.0).astype(np.float32)
        np.testing.assert_array_equal(camera.to_uint8(depth), counts)
    assert camera.to_uint8(np.float32([5.0])).dtype == np.uint8
    assert camera.max_range / 255 == pytest.approx(0.0196, abs=5e-5)


@pytest.mark.filterwarnings("error")
def test_what_is_out_of_range_is_free_or_no_return_and_nothing_in_between():
    depth = np.float32([5.0, 5.0098, 5.05, 6.0, 9.9, 1e9, np.inf, 0.0, -0.02, -3.0, -np.inf, np.nan])
    np.testing.assert_array_equal(DepthCamera().to_uint8(depth), [255] * 7 + [0] * 5)
    np.testing.assert_array_equal(DepthCamera(blind_zone=0.0, min_range=0.0).to_uint8(depth[-5:]), [0] * 5)


def test_the_blind_zone_reads_zero_and_its_end_does_not():
    depth = np.float32([0.0, 0.05, 0.2, 0.3999, 0.4, 0.41])
    np.testing.assert_array_equal(DepthCamera().to_uint8(depth), [0, 0, 0, 0, 20, 21])


def test_the_least_range_holds_without_a_blind_zone():
    depth = np.float32([0.0, 0.0499, 0.05, 0.2])
    np.testing.assert_array_equal(DepthCamera(blind_zone=0.0).to_uint8(depth), [0, 0, 3, 10])


def test_counts_follow_the_greatest_depth():
    depth = np.float32([2.5, 5.0, 10.0])
    np.testing.assert_array_equal(DepthCamera(max_range=10.0).to_uint8(depth), [64, 128, 255])


def test_to_uint8_takes_any_leading_shape_and_leaves_its_argument_alone():
    depth = np.full((2, 3, 4, 5), 2.0, dtype=np.float32)
    assert DepthCamera(width=5, height=4).to_uint8(depth).shape == (2, 3, 4, 5)
    assert np.all(depth == 2.0)


def test_planar_depth_is_what_a_planar_camera_publishes():
    depth = np.float32([[1.0, 5.0], [0.1, 2.0]])
    np.testing.assert_array_equal(DepthCamera(width=2, height=2).from_planar(depth), depth)


def test_range_is_the_length_of_the_ray():
    camera = DepthCamera(width=33, height=17, depth="range")
    rows, columns = np.mgrid[0:17, 0:33]
    left = 2.0 * (1.0 - (2.0 * columns + 1.0) / 33) * math.tan(math.radians(30))
    up = 2.0 * (1.0 - (2.0 * rows + 1.0) / 17) * math.tan(math.radians(0.5 * camera.vertical_fov_deg))
    expected = np.linalg.norm(np.stack([np.full_like(left, 2.0), left, up]), axis=0)
    np.testing.assert_allclose(camera.from_planar(np.full((17, 33), 2.0, dtype=np.float32)), expected, rtol=1e-6)
    assert camera.from_planar(np.full((17, 33), 2.0, dtype=np.float32))[8, 16] == pytest.approx(2.0)


def test_range_saturates_at_the_greatest_depth():
    camera = DepthCamera(depth="range")
    assert camera.from_planar(np.full((64, 80), 4.9, dtype=np.float32)).max() == 5.0


@pytest.mark.parametrize("depth", ["planar", "range"])
def test_least_floor_depth_is_where_the_lowest_row_meets_the_floor(depth):
    camera = DepthCamera(depth=depth)
    slope = 0.75 * math.tan(math.radians(30)) * 63 / 64
    length = 1.0 if depth == "planar" else math.sqrt(1.0 + slope**2 + (math.tan(math.radians(30)) / 80) ** 2)
    assert camera.least_floor_depth == pytest.approx(0.297 / slope * length)


def test_a_camera_that_looks_over_the_floor_sees_it_nowhere():
    assert DepthCamera(height=1).least_floor_depth == 5.0


@pytest.mark.parametrize("pitch_deg", [-40.0, -5.0, 0.0, 12.0, 60.0])
def test_rows_of_a_pitched_camera_lead_ahead_and_up_by_their_elevation(pitch_deg):
    camera = DepthCamera(pitch_deg=pitch_deg)
    off_axis = np.arctan(camera.row_slopes)
    length = 1.0 / np.cos(off_axis)  # of the ray in the middle column, per metre of planar depth
    elevation = off_axis - math.radians(pitch_deg)
    np.testing.assert_allclose(camera.row_advances, length * np.cos(elevation), atol=1e-12)
    np.testing.assert_allclose(camera.row_climbs, length * np.sin(elevation), atol=1e-12)
    assert camera.floor_reach >= math.hypot(camera.row_advances.max(), camera.column_slopes[0]) - 1e-12


def test_a_level_camera_leads_ahead_exactly():
    camera = DepthCamera()
    np.testing.assert_array_equal(camera.row_advances, 1.0)
    np.testing.assert_array_equal(camera.row_climbs, camera.row_slopes)


def test_least_floor_depth_of_a_pitched_camera_is_along_its_axis():
    camera = DepthCamera(pitch_deg=20.0)
    below = math.atan(0.75 * math.tan(math.radians(30)) * 63 / 64) + math.radians(20.0)
    ray = 0.297 / math.sin(below)
    assert camera.least_floor_depth == pytest.approx(ray * math.cos(below - math.radians(20.0)))
    assert camera.least_floor_depth < DepthCamera().least_floor_depth < DepthCamera(pitch_deg=-10.0).least_floor_depth


def test_mounts_are_those_of_the_camera():
    mounts = DepthCamera(pitch_deg=30.0).mounts(3)
    np.testing.assert_array_equal(mounts.pitch, [math.radians(30.0)] * 3)
    np.testing.assert_array_equal(mounts.take(np.array([0, 2])).x, [-0.087, -0.087])
