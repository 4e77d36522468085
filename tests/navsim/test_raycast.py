"""The ray-caster against formulas and itself; ``test_exactness.py`` holds it against the references."""

from __future__ import annotations

import math
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from comparison import EYE, POINT, SMALL, box, random_poses, random_room, world_of
from reference import MeshReference, depth_image

import navsim.raycast
from navsim.camera import DepthCamera
from navsim.raycast import Scene, cast, nearest_depth, render_depth
from navsim.world import World


def image_from(world: dict[str, Any], camera: DepthCamera, x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    """The image of a camera at (x, y), wherever that puts the robot."""
    mount = complex(camera.mount_x, camera.mount_y) * complex(math.cos(yaw), math.sin(yaw))
    return render_depth(World.from_dict(world), np.array([[x - mount.real, y - mount.imag, yaw]]), camera)[0]


# ---- formulas


def test_wall_ahead_is_seen_at_its_planar_depth_in_every_column():
    image = image_from(world_of(box((3.05, 0), (0.1, 10), 2.0)), DepthCamera(), 0.0, 0.0)
    np.testing.assert_allclose(image[:33], 3.0, atol=1e-6)


def test_floor_is_seen_at_the_height_of_the_camera_over_the_slope_of_the_row():
    camera = DepthCamera()
    image = image_from(world_of(), camera, 0.0, 0.0)
    slope = (camera.height / 2 - 0.5 - np.arange(camera.height)) / camera.fy
    expected = np.where(slope < 0, np.minimum(EYE / np.maximum(-slope, 1e-9), 5.0), 5.0)
    np.testing.assert_allclose(image, np.repeat(expected[:, None], camera.width, axis=1), rtol=1e-6)


def test_top_face_of_a_low_box_is_seen_from_above():
    camera = DepthCamera()
    image = image_from(world_of(box((1.5, 0), (1.0, 4.0), 0.2)), camera, 0.0, 0.0)
    slope = (camera.height / 2 - 0.5 - np.arange(camera.height)) / camera.fy
    top = (0.2 - EYE) / slope
    over_it = (slope < 0) & (top >= 1.0) & (top <= 2.0)
    on_the_front = (slope < 0) & (top < 1.0) & (-EYE / slope > 1.0)
    assert over_it.sum() >= 3
    assert on_the_front.sum() >= 5
    np.testing.assert_allclose(image[over_it], np.repeat(top[over_it, None], 80, axis=1), rtol=1e-6)
    np.testing.assert_allclose(image[on_the_front], 1.0, atol=1e-6)


def test_under_face_of_a_raised_box_is_seen_from_below():
    camera = DepthCamera()
    image = image_from(world_of(box((1.5, 0), (1.0, 4.0), 0.1, base=0.4)), camera, 0.0, 0.0)
    slope = (camera.height / 2 - 0.5 - np.arange(camera.height)) / camera.fy
    under = (0.4 - EYE) / slope
    below_it = (slope > 0) & (under >= 1.0) & (under <= 2.0)
    assert below_it.sum() >= 3
    np.testing.assert_allclose(image[below_it], np.repeat(under[below_it, None], 80, axis=1), rtol=1e-6)


def test_cylinder_is_seen_where_the_axis_meets_it():
    camera = DepthCamera(width=33, height=17)
    image = image_from(world_of({"cylinder": {"at": [2.0, 0.0], "radius": 0.25, "height": 1.0}}), camera, 0.0, 0.0)
    assert image[8, 16] == pytest.approx(1.75, abs=1e-6)


def test_low_box_under_the_camera_is_seen_from_depth_zero_on():
    camera = DepthCamera(vertical_fov_deg=170.0, height=65)
    image = image_from(world_of(box((0, 0), (2.0, 2.0), 0.25)), camera, 0.0, 0.0)
    steepest = (camera.height / 2 - 0.5) / camera.fy
    np.testing.assert_allclose(image[-1], (EYE - 0.25) / steepest, rtol=1e-5)


def test_raised_box_over_the_camera_is_seen_from_depth_zero_on():
    camera = DepthCamera(vertical_fov_deg=170.0, height=65)
    image = image_from(world_of(box((0, 0), (2.0, 2.0), 0.25, base=0.3)), camera, 0.0, 0.0)
    steepest = (camera.height / 2 - 0.5) / camera.fy
    np.testing.assert_allclose(image[0], (0.3 - EYE) / steepest, rtol=1e-5)


@pytest.mark.parametrize("camera", [DepthCamera(), SMALL, POINT])
@pytest.mark.parametrize(
    "obstacle",
    [
        box((0.1, 0), (0.6, 0.6), 0.6, yaw_deg=20),
        box((0.1, 0), (0.6, 0.6), 0.2, base=0.2),
        {"cylinder": {"at": [0.1, 0], "radius": 0.3, "height": 0.6}},
        {"polygon": {"points": [[-1, -1], [1, -1], [1, 1], [0.5, -0.5], [-1, 0.5]], "height": 0.6}},
    ],
)
def test_inside_an_obstacle_there_is_zero_everywhere(camera, obstacle):
    assert not image_from(world_of(obstacle), camera, 0.05, -0.25, 1.0).any()


@pytest.mark.parametrize("depth", [5.0 - 1e-3, 5.0 - 1e-6, 5.0, 5.0 + 1e-6, 5.0 + 1e-3])
def test_walls_about_the_greatest_depth_are_seen_or_not_without_a_jump(depth):
    image = image_from(world_of(box((depth + 0.5, 0), (1.0, 20.0), 5.0)), DepthCamera(), 0.0, 0.0)
    np.testing.assert_allclose(image[:30], min(depth, 5.0), atol=1e-6)


# ---- many worlds, many robots


def test_a_world_for_each_pose_gives_what_one_world_for_all_gives():
    rng = np.random.default_rng(7)
    rooms = [World.from_dict(random_room(rng)) for _ in range(3)]
    poses = random_poses(rng, 12, (7.0, 7.0))
    each = [rooms[number] for number in rng.integers(3, size=12)]
    mixed = render_depth(each, poses, SMALL)
    for room in rooms:
        mine = [other is room for other in each]
        np.testing.assert_array_equal(mixed[mine], render_depth(room, poses, SMALL)[mine])


@pytest.mark.parametrize("camera", [SMALL, DepthCamera()], ids=["33x17", "80x64"])
def test_an_image_does_not_depend_on_the_batch_that_it_is_in(camera):
    rng = np.random.default_rng(8)
    scene = Scene([World.from_dict(random_room(rng)) for _ in range(5)])
    world_index, poses = rng.integers(5, size=37), random_poses(rng, 37, (7.0, 7.0))
    together = cast(scene, world_index, poses, camera)
    nearest = nearest_depth(scene, world_index, poses, camera)
    order = rng.permutation(37)
    np.testing.assert_array_equal(cast(scene, world_index[order], poses[order], camera), together[order])
    np.testing.assert_array_equal(nearest_depth(scene, world_index[order], poses[order], camera), nearest[order])
    for size in (1, 2, 7, 16):
        parts = [slice(first, first + size) for first in range(0, 37, size)]
        images = [cast(scene, world_index[part], poses[part], camera) for part in parts]
        np.testing.assert_array_equal(np.concatenate(images), together)
        depths = [nearest_depth(scene, world_index[part], poses[part], camera) for part in parts]
        np.testing.assert_array_equal(np.concatenate(depths), nearest)


def test_an_image_does_not_depend_on_what_was_rendered_before_or_is_rendered_beside(monkeypatch):
    rng = np.random.default_rng(14)
    scene = Scene([World.from_dict(random_room(rng))])
    sizes = [(camera, count) for camera in (DepthCamera(), SMALL, POINT) for count in (40, 1, 16)]
    poses = random_poses(rng, 40, (7.0, 7.0))
    alone = []
    for camera, count in sizes:
        monkeypatch.setattr(navsim.raycast, "_kept", threading.local())
        alone.append(cast(scene, np.zeros(count, dtype=np.intp), poses[:count], camera))

    def all_again() -> list[np.ndarray]:
        return [cast(scene, np.zeros(count, dtype=np.intp), poses[:count], camera) for camera, count in sizes]

    with ThreadPoolExecutor(4) as pool:
        for images in pool.map(lambda _: all_again(), range(12)):
            for image, expected in zip(images, alone, strict=True):
                np.testing.assert_array_equal(image, expected)


def test_in_a_big_world_nothing_in_view_is_left_out(monkeypatch):
    rng = np.random.default_rng(9)
    room = random_room(rng, obstacles=600, size=40.0)
    room["obstacles"] += [box((5, 5), (30.0, 0.3), 0.2, yaw_deg=30), box((0, 0), (60.0, 60.0), 0.5, base=1.5)]
    poses = random_poses(rng, 150, (40.0, 40.0))
    poses[-10:, :2] *= 1.3  # outside
    poses[-1, :2] = (900.0, -900.0)
    every_world = [World.from_dict(room), World.from_dict(random_room(rng))]
    world_index = np.where(np.arange(150) % 3 == 0, 1, 0)
    through_the_grid = cast(Scene(every_world), world_index, poses, SMALL)
    monkeypatch.setattr(navsim.raycast._CellIndex, "_SMALL", 10**9)
    np.testing.assert_array_equal(through_the_grid, cast(Scene(every_world), world_index, poses, SMALL))
    assert through_the_grid[-1].max() == 5.0


def test_in_a_wide_world_cells_are_larger_and_nothing_in_view_is_left_out(monkeypatch):
    rng = np.random.default_rng(10)
    world = World.from_dict(random_room(rng, obstacles=300, size=40.0))
    poses = random_poses(rng, 60, (40.0, 40.0))
    small_cells = cast(Scene([world]), np.zeros(60, dtype=np.intp), poses, SMALL)
    monkeypatch.setattr(navsim.raycast._CellIndex, "_MOST_ENTRIES", 2_000)
    np.testing.assert_array_equal(small_cells, cast(Scene([world]), np.zeros(60, dtype=np.intp), poses, SMALL))


@pytest.mark.parametrize("camera", [DepthCamera(), SMALL, POINT], ids=["80x64", "33x17", "1x1"])
@pytest.mark.parametrize("base", [0.0, EYE])
@pytest.mark.filterwarnings("error")
def test_a_camera_in_the_plane_of_a_face_sees_something(camera, base):
    obstacles = [
        box((0, 0), (1.0, 1.0), EYE, base=base),
        {"cylinder": {"at": [0.2, 0], "radius": 0.5, "height": EYE, "base": base}},
    ]
    image = image_from(world_of(*obstacles), camera, 0.0, 0.0, 0.3)
    assert np.all((image >= 0.0) & (image <= 5.0))


@pytest.mark.parametrize("within", [0.5, 2.0, 5.0])
def test_nearest_depth_is_the_least_depth_of_an_image_without_the_floor(within):
    rng = np.random.default_rng(11)
    for _ in range(4):
        room = random_room(rng, obstacles=16)
        poses = random_poses(rng, 40, room["size"])
        reference = MeshReference(room, EYE, floor=False)
        expected = [min(depth_image(reference, SMALL, pose).min(), within) for pose in poses]
        nearest = nearest_depth(Scene([World.from_dict(room)]), np.zeros(40, dtype=np.intp), poses, SMALL, within)
        assert nearest.dtype == np.float32
        np.testing.assert_allclose(nearest, expected, atol=1e-3)


@pytest.mark.parametrize("height", [1, 2, 3])
def test_nearest_depth_leaves_out_what_the_floor_hides(height):
    camera = DepthCamera(width=5, height=height, mount_z=0.05, max_range=5.0)
    world = world_of(box((3.05, 0), (0.1, 10), 0.5))
    expected = depth_image(MeshReference(world, 0.05, floor=False), camera, np.zeros(3)).min()
    nearest = nearest_depth(Scene([World.from_dict(world)]), np.zeros(1, dtype=np.intp), np.zeros((1, 3)), camera, 5.0)
    assert nearest[0] == pytest.approx(expected, abs=1e-3)


def test_an_open_floor_without_obstacles_can_be_looked_at():
    world = World.from_dict(world_of())
    image = render_depth(world, np.zeros((2, 3)), SMALL)
    assert image.shape == (2, 17, 33)
    assert np.all(image[:, :9] == 5.0)
    assert render_depth(world, np.zeros((0, 3)), SMALL).shape == (0, 17, 33)


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (np.zeros(3), r"poses must be finite and of shape \(N, 3\).*got shape \(3,\)"),
        (np.zeros((2, 2)), r"got shape \(2, 2\)"),
        (np.array([[0.0, math.nan, 0.0]]), "must be finite"),
        (np.array([[math.inf, 0.0, 0.0]]), "must be finite"),
    ],
)
def test_poses_of_another_shape_are_refused(poses, message):
    with pytest.raises(ValueError, match=message):
        render_depth(World.from_dict(world_of()), poses)


def test_a_number_of_worlds_that_does_not_match_the_poses_is_refused():
    with pytest.raises(ValueError, match="one world, or one for each pose; got 2 for 3 poses"):
        render_depth([World.from_dict(world_of())] * 2, np.zeros((3, 3)))


def test_poses_of_obstacles_are_of_the_shape_that_simulators_tell():
    can = {"at": [1, 0], "radius": 0.2, "height": 0.5, "motion": {"path": [[1, 0], [1, 1]], "speed": 0.2}}
    world = World.from_dict({"format": 1, "size": [6, 6], "obstacles": [{"cylinder": can}]})
    poses = np.zeros((2, 3))
    there = np.array([[[1.0, 0.0, 0.0]]] * 2)
    assert np.array_equal(render_depth(world, poses, None, there), render_depth(world, poses))
    for wrong in (there[0], there[:1], np.concatenate([there, there]), there[..., :2], there[:, :0]):
        with pytest.raises(ValueError, match=r"obstacle_poses must be of shape \(2, 1, 3\)"):
            render_depth(world, poses, None, wrong)
    with pytest.raises(ValueError, match="there must be one world, or one for each pose; got 0 for 0 poses"):
        render_depth([], np.zeros((0, 3)))
