"""Pitched cameras against formulas, triangle meshes under Embree, MuJoCo's rays, and the level ray-caster."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from comparison import EYE, SMALL, Comparison, box, random_poses, random_room, world_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import MeshReference, MujocoReference, depth_image
from test_exactness import Scenery, loaded, sceneries, shipped

from navsim.camera import DepthCamera, Mounts
from navsim.errors import WorldError
from navsim.raycast import Scene, cast, nearest_depth, render_depth
from navsim.world import World

PITCHES_DEG = [-50.0, -12.0, -0.5, 1e-6, 3.0, 10.0, 22.5, 45.0, 66.0]


def at_camera(camera: DepthCamera, x: float, y: float) -> np.ndarray:
    return np.array([[x - camera.mount_x, y - camera.mount_y, 0.0]])


def room_of(rng: np.random.Generator) -> tuple[dict[str, Any], World]:
    """A random room whose polygons do not touch themselves."""
    while True:
        description = random_room(rng)
        try:
            return description, World.from_dict(description)
        except WorldError:
            continue


# ---- formulas


@pytest.mark.parametrize("pitch_deg", [-30.0, 15.0, 40.0])
def test_depth_of_a_wall_ahead_is_along_the_pitched_axis(pitch_deg):
    camera = DepthCamera(pitch_deg=pitch_deg, mount_x=0.0, mount_z=2.0, max_range=20.0)
    world = World.from_dict(world_of(box((3.05, 0), (0.1, 30), 60.0), size=40.0))
    image = render_depth(world, np.zeros((1, 3)), camera)[0]
    elevation = np.arctan(camera.row_slopes) - math.radians(pitch_deg)
    # The ray meets the wall 3 / cos(elevation) away, of which the cosine of its angle off the axis is depth.
    depth = 3.0 / np.cos(elevation) * np.cos(elevation + math.radians(pitch_deg))
    on_the_wall = 2.0 + 3.0 * np.tan(elevation) > 0.0
    assert on_the_wall.sum() >= 10
    np.testing.assert_allclose(image[on_the_wall], np.repeat(depth[on_the_wall, None], 80, axis=1), rtol=1e-6)


@pytest.mark.parametrize("pitch_deg", [-10.0, 15.0, 40.0, 66.0])
def test_the_floor_is_seen_where_rays_that_lean_down_meet_it(pitch_deg):
    camera = DepthCamera(pitch_deg=pitch_deg)
    image = render_depth(World.from_dict(world_of()), np.zeros((1, 3)), camera)[0]
    elevation = np.arctan(camera.row_slopes) - math.radians(pitch_deg)
    ray = np.where(elevation < 0.0, EYE / np.maximum(-np.sin(elevation), 1e-9), np.inf)
    depth = np.minimum(ray * np.cos(elevation + math.radians(pitch_deg)), 5.0)
    np.testing.assert_allclose(image, np.repeat(depth[:, None], 80, axis=1), rtol=1e-5)


def test_an_upright_edge_leans_in_a_pitched_image():
    """The issue's claim that columns stay plumb planes holds for the middle one only."""
    camera = DepthCamera(width=200, height=160, pitch_deg=30.0, mount_z=1.5, mount_x=0.0)
    world = World.from_dict(world_of(box((2.5, 1.6), (1.0, 2.0), 4.0)))  # its right side is at y = 0.6, 2 m ahead
    image = render_depth(world, np.zeros((1, 3)), camera)[0]
    advance = math.cos(math.radians(30.0)) + camera.row_slopes * math.sin(math.radians(30.0))
    edge = 200 / 2 - 0.5 - camera.fx * advance * 0.6 / 2.0  # columns; u = t F
    face = np.abs(image - (2.0 / advance)[:, None]) < 1e-4
    rows = np.flatnonzero(face.any(axis=1))
    assert len(rows) > 60
    rightmost = 199 - np.argmax(face[rows][:, ::-1], axis=1)
    np.testing.assert_array_equal(rightmost, np.ceil(edge[rows]) - 1)
    assert edge[rows[-1]] - edge[rows[0]] > 8.0


@pytest.mark.parametrize("camera", [DepthCamera(), SMALL, DepthCamera(depth="range")])
def test_a_pitch_that_vanishes_gives_the_level_image(camera):
    rng = np.random.default_rng(20)
    _, room = room_of(rng)
    poses = random_poses(rng, 40, (7.0, 7.0))
    level = render_depth(room, poses, camera)
    off = []
    for pitch_deg in (1e-2, 1e-5, 1e-8):
        image = render_depth(room, poses, replace(camera, pitch_deg=pitch_deg))
        off.append(np.mean(np.abs(image - level) > 1e-4))
    assert off[0] > off[1] >= off[2]
    assert off[2] < 2e-5  # but for pixels exactly on an edge


# ---- the references


@pytest.mark.parametrize("kind", [MeshReference, MujocoReference])
@pytest.mark.parametrize("name", ["complex_eval", "simple_train"])
def test_shipped_worlds_look_the_same_to_the_references(name, kind):
    description, world = shipped(name)
    rng, comparison = np.random.default_rng(21), Comparison()
    reference = kind(description, EYE) if kind is MeshReference else kind(description)
    for pitch_deg in rng.uniform(-40.0, 60.0, 12):
        camera = replace(SMALL, pitch_deg=float(pitch_deg))
        poses = random_poses(rng, 8, world.size)
        comparison.add(reference, camera, poses, render_depth(world, poses, camera))
    comparison.check(90)


def test_generated_rooms_look_the_same_to_embree_and_to_mujoco():
    rng, comparison = np.random.default_rng(22), Comparison()
    for pitch_deg in PITCHES_DEG:
        room, world = room_of(rng)
        camera = replace(SMALL, pitch_deg=pitch_deg, mount_z=float(rng.choice([EYE, 0.62, 1.1])), mount_y=0.05)
        poses = random_poses(rng, 24, room["size"])
        images = render_depth(world, poses, camera)
        comparison.add(MeshReference(room, camera.mount_z), camera, poses, images)
        comparison.add(MujocoReference(room), camera, poses[:8], images[:8])
    full = replace(DepthCamera(), pitch_deg=12.0)
    poses = random_poses(rng, 10, room["size"])
    comparison.add(MeshReference(room, full.mount_z), full, poses, render_depth(world, poses, full))
    comparison.check(280)


def compare_nasty_worlds(examples: int, derandomize: bool) -> None:
    embree, in_mujoco = Comparison(), Comparison()

    @settings(
        max_examples=examples,
        derandomize=derandomize,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(sceneries(), st.sampled_from(PITCHES_DEG) | st.floats(-60.0, 60.0))
    def compare(scenery: Scenery, pitch_deg: float) -> None:
        steepest = 89.0 - 0.5 * scenery.camera.vertical_fov_deg
        camera = replace(scenery.camera, pitch_deg=float(np.clip(pitch_deg, -steepest, steepest)))
        description, world = loaded(scenery.world)
        images = render_depth(world, scenery.poses, camera)
        embree.add(MeshReference(description, camera.mount_z), camera, scenery.poses, images)
        in_mujoco.add(MujocoReference(description), camera, scenery.poses, images)

    compare()
    embree.check(5 * examples)
    in_mujoco.check(5 * examples)


def test_nasty_worlds_look_the_same_to_embree_and_to_mujoco():
    compare_nasty_worlds(examples=25, derandomize=True)


@pytest.mark.slow
def test_other_nasty_worlds_each_time():
    compare_nasty_worlds(examples=800, derandomize=False)


# ---- the depth rule, and many cameras in one call


@pytest.mark.parametrize("within", [0.5, 5.0])
def test_nearest_depth_is_the_least_depth_of_an_image_without_the_floor(within):
    rng = np.random.default_rng(23)
    for pitch_deg in (-20.0, 8.0, 35.0):
        (room, world), camera = room_of(rng), replace(SMALL, pitch_deg=pitch_deg)
        poses = random_poses(rng, 25, room["size"])
        reference = MeshReference(room, EYE, floor=False)
        expected = [min(depth_image(reference, camera, pose).min(), within) for pose in poses]
        nearest = nearest_depth(Scene([world]), np.zeros(25, dtype=np.intp), poses, camera, within)
        assert nearest.dtype == np.float32
        np.testing.assert_allclose(nearest, expected, atol=1e-3)


def test_robots_that_carry_their_cameras_in_different_ways_see_what_each_would_alone():
    rng = np.random.default_rng(24)
    scene = Scene([room_of(rng)[1] for _ in range(3)])
    count = 18
    world_index, poses = rng.integers(3, size=count), random_poses(rng, count, (7.0, 7.0))
    pitch_deg = np.where(np.arange(count) % 3 == 0, 0.0, rng.uniform(-15.0, 30.0, count))
    height, ahead, left = rng.uniform(0.2, 0.6, count), rng.uniform(-0.1, 0.1, count), rng.uniform(-0.1, 0.1, count)
    mounts = Mounts(ahead, left, height, np.radians(pitch_deg))
    images = cast(scene, world_index, poses, SMALL, mounts=mounts)
    nearest = nearest_depth(scene, world_index, poses, SMALL, 5.0, mounts=mounts)
    for robot in range(count):
        alone = replace(
            SMALL,
            mount_x=float(ahead[robot]),
            mount_y=float(left[robot]),
            mount_z=float(height[robot]),
            pitch_deg=float(pitch_deg[robot]),
        )
        one = slice(robot, robot + 1)
        np.testing.assert_array_equal(images[robot], cast(scene, world_index[one], poses[one], alone)[0])
        assert nearest[robot] == nearest_depth(scene, world_index[one], poses[one], alone, 5.0)[0]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("pitch_deg", [-45.0, 20.0])
def test_an_open_floor_and_no_robots_can_be_looked_at(pitch_deg):
    camera = replace(SMALL, pitch_deg=pitch_deg)
    assert render_depth(World.from_dict(world_of()), np.zeros((2, 3)), camera).max() == 5.0
    assert render_depth(World.from_dict(world_of()), np.zeros((0, 3)), camera).shape == (0, 17, 33)


def test_inside_an_obstacle_there_is_zero_everywhere():
    camera = DepthCamera(pitch_deg=10.0)
    for obstacle in (box((0, 0), (0.6, 0.6), 0.6), {"cylinder": {"at": [0.0, 0], "radius": 0.3, "height": 0.6}}):
        assert not render_depth(World.from_dict(world_of(obstacle)), at_camera(camera, 0.05, -0.1), camera).any()


def test_a_low_box_under_a_camera_that_looks_down_is_seen_from_above():
    camera = DepthCamera(pitch_deg=60.0)
    image = render_depth(World.from_dict(world_of(box((0, 0), (3.0, 3.0), 0.25))), at_camera(camera, 0.0, 0.0), camera)
    drop = -(camera.row_slopes * math.cos(math.radians(60.0)) - math.sin(math.radians(60.0)))
    np.testing.assert_allclose(image[0], np.repeat(((EYE - 0.25) / drop)[:, None], 80, axis=1), rtol=1e-5)
