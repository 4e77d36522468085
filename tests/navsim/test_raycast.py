"""The ray-caster against formulas, triangle meshes under Embree, MuJoCo's rays, and itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import (
    MeshReference,
    MujocoReference,
    camera_position,
    depth_image,
    explained_by_silhouettes,
    extruded,
    on_a_surface,
    pixel_rays,
    solids,
)

import navsim.raycast
from navsim.camera import DepthCamera
from navsim.errors import WorldError
from navsim.raycast import Scene, cast, nearest_depth, render_depth
from navsim.world import World
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY, load_world, shipped_worlds

EYE = DepthCamera().mount_z
SHIPPED = sorted({"simple_train", "simple_eval", "complex_train", "complex_eval", *shipped_worlds()})
SMALL = DepthCamera(width=33, height=17)
POINT = DepthCamera(width=1, height=1)


def world_of(*obstacles: dict[str, Any], size: float = 20.0, walls: Any = "none") -> dict[str, Any]:
    return {"format": 1, "size": [size, size], "walls": walls, "obstacles": list(obstacles)}


def box(at: tuple[float, float], size: tuple[float, float], height: float, **more: float) -> dict[str, Any]:
    return {"box": {"at": list(at), "size": list(size), "height": height, **more}}


def image_from(world: dict[str, Any], camera: DepthCamera, x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    """The image of a camera at (x, y), wherever that puts the robot."""
    mount = complex(camera.mount_x, camera.mount_y) * complex(math.cos(yaw), math.sin(yaw))
    return render_depth(World.from_dict(world), np.array([[x - mount.real, y - mount.imag, yaw]]), camera)[0]


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
            points = at + rng.uniform(0.1, 0.6, (corners, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            points = np.clip(points, -0.5 * size, 0.5 * size)
            shape = {"points": points[:: rng.choice([-1, 1])].tolist()}
        entries.append({("box", "cylinder", "polygon")[kind]: {**shape, "base": base, "height": height}})
    return {"format": 1, "size": [size, size], "obstacles": entries}


def random_poses(rng: np.random.Generator, count: int, size: tuple[float, float]) -> np.ndarray:
    """All over the room and a little outside it; each fourth one looks exactly along an axis."""
    half = 0.5 * np.array(size) + 0.2
    poses = np.concatenate([rng.uniform(-half, half, (count, 2)), rng.uniform(-math.pi, math.pi, (count, 1))], axis=1)
    poses[::4, 2] = rng.choice([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], len(poses[::4]))
    return poses


class Comparison:
    """Images held against a reference: what was compared, and how many pixels are off by more than a millimetre."""

    def __init__(self) -> None:
        self.poses = self.pixels = self.off = 0

    def add(
        self, reference: MeshReference | MujocoReference, camera: DepthCamera, poses: np.ndarray, images: np.ndarray
    ) -> None:
        assert images.shape == (len(poses), camera.height, camera.width)
        assert images.dtype == np.float32
        for pose, image in zip(poses, images, strict=True):
            assert np.all((image >= 0.0) & (image <= np.float32(camera.max_range))), pose.tolist()
            if on_a_surface(reference, camera, pose):
                continue
            expected = depth_image(reference, camera, pose)
            rows, columns = np.nonzero(np.abs(image - expected) > 1e-3)
            self.poses += 1
            self.pixels += image.size
            self.off += len(rows)
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
        assert self.poses >= least_poses
        assert self.off < 0.001 * self.pixels, f"{self.off} of {self.pixels} pixels are off"


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


# ---- the references


@pytest.mark.parametrize("obstacle", random_room(np.random.default_rng(3), 12)["obstacles"])
def test_the_reference_meshes_are_closed_and_hold_the_right_volume(obstacle):
    (solid,) = solids(world_of(obstacle))
    mesh = extruded(solid.footprint, solid.base, solid.top, convex=solid.radius > 0.0)
    mesh.merge_vertices()
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(solid.footprint.area * (solid.top - solid.base), rel=1e-9)


def shipped(name: str) -> tuple[dict[str, Any], World]:
    """The dictionary in a shipped world's file, and the world that the library makes of it."""
    path = SHIPPED_WORLDS_DIRECTORY / f"{name}.yaml"
    return yaml.safe_load(path.read_text(encoding="utf-8")), load_world(name)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_look_the_same_to_embree(name):
    description, world = shipped(name)
    comparison, reference = Comparison(), MeshReference(description, EYE)
    for seed, camera in enumerate((DepthCamera(), SMALL)):
        poses = random_poses(np.random.default_rng(seed), 150, world.size)
        comparison.add(reference, camera, poses, render_depth(world, poses, camera))
    comparison.check(290)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_look_the_same_to_mujoco(name):
    description, world = shipped(name)
    comparison, reference = Comparison(), MujocoReference(description)
    poses = random_poses(np.random.default_rng(2), 50, world.size)
    comparison.add(reference, SMALL, poses, render_depth(world, poses, SMALL))
    comparison.check(48)


def test_generated_rooms_look_the_same_to_embree():
    rng, comparison = np.random.default_rng(4), Comparison()
    for _ in range(20):
        room = random_room(rng)
        poses, reference = random_poses(rng, 40, room["size"]), MeshReference(room, EYE)
        comparison.add(reference, DepthCamera(), poses[:10], render_depth(World.from_dict(room), poses[:10]))
        comparison.add(reference, SMALL, poses[10:], render_depth(World.from_dict(room), poses[10:], SMALL))
    comparison.check(780)


def test_generated_rooms_look_the_same_to_mujoco():
    rng, comparison = np.random.default_rng(5), Comparison()
    for _ in range(10):
        room = random_room(rng)
        poses = random_poses(rng, 20, room["size"])
        comparison.add(MujocoReference(room), SMALL, poses, render_depth(World.from_dict(room), poses, SMALL))
    comparison.check(190)


@pytest.mark.parametrize(
    "camera",
    [
        DepthCamera(width=31, height=40, horizontal_fov_deg=110.0, vertical_fov_deg=100.0),
        DepthCamera(width=40, height=9, horizontal_fov_deg=20.0, vertical_fov_deg=3.0, max_range=8.0),
        DepthCamera(width=24, height=24, mount_x=0.1, mount_y=-0.07, mount_z=0.62, max_range=1.5),
        DepthCamera(width=1, height=40),
        DepthCamera(width=40, height=1),
        DepthCamera(width=1, height=1),
        DepthCamera(width=160, height=128),
    ],
    ids=lambda camera: f"{camera.width}x{camera.height}",
)
def test_any_camera_sees_what_embree_sees(camera):
    rng, comparison = np.random.default_rng(6), Comparison()
    room = random_room(rng)
    poses = random_poses(rng, 40, room["size"])
    reference = MeshReference(room, camera.mount_z)
    comparison.add(reference, camera, poses, render_depth(World.from_dict(room), poses, camera))
    comparison.check(38)


# ---- nasty worlds

ROUND = [-2.0, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 2.0]
coordinates = st.one_of(st.sampled_from(ROUND), st.floats(-2.5, 2.5))
places = st.tuples(coordinates, coordinates).map(list)
lengths = st.one_of(st.sampled_from([0.001, 0.01, 0.25, 0.5, 1.0, 3.0, 40.0]), st.floats(0.001, 3.0))
extents = st.sampled_from([0.001, 0.05, 0.25, EYE - 1e-3, EYE + 1e-3, 0.42, 2.0, 30.0])
bases = st.sampled_from([0.0, 0.0, 0.0, 0.001, 0.1, 0.25, EYE - 1e-3, EYE + 1e-3, 0.35, 1.0])
at_eye_level = st.just(EYE)
radii = st.one_of(st.sampled_from([0.001, 0.05, 0.25, 1.0, 20.0]), st.floats(0.001, 1.0))
angles_deg = st.one_of(st.sampled_from([0.0, 90.0, -90.0, 180.0, 45.0, 30.0, -60.0]), st.floats(-180.0, 180.0))
CONCAVE = [
    [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]],  # L
    [[0, 0], [3, 0], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]],  # U
    [[0, 0], [2, 0], [2, 2], [1.001, 2], [1.001, 0.1], [0.999, 0.1], [0.999, 2], [0, 2]],  # a slit of 2 mm, or less
    [[0, 0], [1, 0.05], [2, 0], [1.95, 1], [2, 2], [1, 1.95], [0, 2], [0.05, 1]],  # four shallow notches
    [[0, 0], [5, 0], [5, 4], [2, 4], [2, 2], [3, 2], [3, 3], [4, 3], [4, 1], [1, 1], [1, 4], [0, 4]],  # a spiral
    [[0, 0], [1, 0], [2, 0], [1, 0.001]],  # a sliver with a straight corner
]


@st.composite
def outlines(draw: st.DrawFn) -> list[list[float]]:
    points = np.array(draw(st.sampled_from(CONCAVE)), dtype=np.float64) * draw(st.sampled_from([0.1, 0.25, 1.0]))
    turn = complex(*{0: (1, 0), 1: (0, 1), 2: (-1, 0), 3: (0.6, 0.8)}[draw(st.integers(0, 3))])
    rotated = (points[:, 0] + 1j * points[:, 1]) * turn
    moved = np.stack([rotated.real, rotated.imag], axis=1) + draw(places)
    return moved[:: draw(st.sampled_from([1, -1]))].tolist()


@st.composite
def worlds(draw: st.DrawFn, camera: DepthCamera) -> dict[str, Any]:
    # A face in the plane of the level row, which an odd number of rows has, is a silhouette along all of it.
    level = camera.height % 2 == 1
    height, base = (extents, bases) if level else (extents | at_eye_level, bases | at_eye_level)
    high = {"height": height, "base": base}
    boxes = st.fixed_dictionaries({"at": places, "size": st.tuples(lengths, lengths), "yaw_deg": angles_deg, **high})
    cylinders = st.fixed_dictionaries({"at": places, "radius": radii, **high})
    polygons = st.fixed_dictionaries({"points": outlines(), **high})
    shapes = st.one_of(
        boxes.map(lambda shape: {"box": shape}),
        cylinders.map(lambda shape: {"cylinder": shape}),
        polygons.map(lambda shape: {"polygon": shape}),
    )
    size = draw(st.sampled_from([5.0, 6.0, 10.0]))
    walls = draw(st.sampled_from(["none", {"height": 0.25}, {"height": 2.0, "thickness": 0.001}]))
    obstacles = draw(st.lists(shapes, min_size=1, max_size=8))
    return {"format": 1, "size": [size, size], "walls": walls, "obstacles": obstacles}


yaws = st.one_of(
    st.sampled_from([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi, 0.25 * math.pi, math.pi / 6, -math.pi / 3]),
    st.floats(-math.pi, math.pi),
)
cameras = st.sampled_from(
    [
        DepthCamera(width=33, height=17),
        DepthCamera(width=32, height=16, mount_x=0.0),
        DepthCamera(width=1, height=1, mount_x=0.0),
        DepthCamera(width=5, height=64),
        DepthCamera(width=81, height=3, mount_y=0.05),
        DepthCamera(width=40, height=30, horizontal_fov_deg=90.0),
    ]
)


@st.composite
def poses_of(draw: st.DrawFn, camera: DepthCamera, count: int) -> np.ndarray:
    """Poses that put the camera where ``places`` are, so that it stands exactly in line with edges."""
    chosen = []
    for x, y, yaw in draw(st.lists(st.tuples(coordinates, coordinates, yaws), min_size=count, max_size=count)):
        offset = camera_position(camera, np.array([0.0, 0.0, yaw]))
        chosen.append([x - offset[0], y - offset[1], yaw])
    return np.array(chosen)


def loaded(description: dict[str, Any]) -> tuple[dict[str, Any], World]:
    """The world, in a larger room where the obstacles leave the robot no place in theirs, or lie outside it."""
    try:
        return description, World.from_dict(description)
    except WorldError:
        larger = {**description, "size": [60.0, 60.0]}
        return larger, World.from_dict(larger)


def compare_nasty_worlds(examples: int, derandomize: bool) -> None:
    embree, in_mujoco = Comparison(), Comparison()

    @settings(
        max_examples=examples,
        derandomize=derandomize,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def compare(data: st.DataObject) -> None:
        camera = data.draw(cameras)
        description, world = loaded(data.draw(worlds(camera)))
        poses = data.draw(poses_of(camera, 8))
        images = render_depth(world, poses, camera)
        embree.add(MeshReference(description, camera.mount_z), camera, poses, images)
        in_mujoco.add(MujocoReference(description), camera, poses, images)

    compare()
    embree.check(6 * examples)
    in_mujoco.check(6 * examples)


def test_nasty_worlds_look_the_same_to_embree_and_to_mujoco():
    compare_nasty_worlds(examples=120, derandomize=True)


@pytest.mark.slow
def test_other_nasty_worlds_each_time():
    compare_nasty_worlds(examples=1500, derandomize=False)


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


def test_a_big_world_looks_the_same_to_embree_everywhere():
    rng, comparison = np.random.default_rng(10), Comparison()
    room = random_room(rng, obstacles=300, size=40.0)
    world = World.from_dict(room)
    for x, y in ((-18.0, -18.0), (0.5, 0.5), (17.5, 3.0)):
        poses = random_poses(rng, 20, (4.0, 4.0)) + np.array([x, y, 0.0])
        comparison.add(MeshReference(room, EYE, (x, y)), SMALL, poses, render_depth(world, poses, SMALL))
    comparison.check(58)


def test_a_face_along_a_column_of_the_image_is_seen_beside_it_or_not_at_all():
    rng, comparison = np.random.default_rng(12), Comparison()
    for _ in range(500):
        yaw = rng.choice([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi, 0.25 * math.pi, rng.uniform(-math.pi, math.pi)])
        x, y = rng.choice([0.0, 1.5, -2.25, rng.uniform(-2.0, 2.0)], 2)
        column = (1.0 - (2.0 * rng.integers(SMALL.width) + 1.0) / SMALL.width) * math.tan(math.radians(30.0))
        direction = yaw + math.atan(column)
        length, width = rng.choice([0.01, 0.5, 1.0, 3.0]), rng.choice([0.001, 0.5, 1.0])
        ahead, aside = 0.5 * length + rng.choice([-0.2, 0.0, 0.5, 1.0, 2.0]), rng.choice([-0.5, 0.5]) * width
        at_x = x + ahead * math.cos(direction) - aside * math.sin(direction)
        at_y = y + ahead * math.sin(direction) + aside * math.cos(direction)
        high = {"height": float(rng.choice([0.2, 1.0])), "base": float(rng.choice([0.0, 0.35]))}
        turned = float(np.clip(math.degrees(direction), -360.0, 360.0))
        world = world_of(box((float(at_x), float(at_y)), (float(length), float(width)), yaw_deg=turned, **high))
        pose = np.array([x, y, yaw]) - camera_position(SMALL, np.array([0.0, 0.0, yaw])) * [1.0, 1.0, 0.0]
        images = render_depth(World.from_dict(world), pose[None], SMALL)
        comparison.add(MujocoReference(world), SMALL, pose[None], images)
    assert comparison.poses >= 400
    assert comparison.off < 0.01 * comparison.pixels  # each of these images holds a column that is nothing but edge


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


def test_rays_of_the_references_are_those_of_the_design():
    """First pixel: half a pixel inside the upper left corner of the view."""
    camera = DepthCamera(width=80, height=64)
    ray = pixel_rays(camera, np.zeros(3), np.zeros(1), np.zeros(1))[0]
    fx, fy = 40 / math.tan(math.radians(30)), 32 / (math.tan(math.radians(30)) * 480 / 640)
    np.testing.assert_allclose(ray, [1.0, 39.5 / fx, 31.5 / fy])
