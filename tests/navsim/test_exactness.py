"""Depth against two independent references: triangle meshes under Embree, and MuJoCo's rays.

At least 2,000 poses are held against each: over the shipped worlds, over generated ones, and over nasty ones that
hypothesis makes. Less than a thousandth of the pixels may be off by more than a millimetre, and every one of those must
lie within one pixel of a silhouette of the reference. ``pytest -m slow`` compares many more.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely
import yaml
from comparison import EYE, SMALL, Comparison, box, random_poses, random_room, world_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import (
    MeshReference,
    MujocoReference,
    Solid,
    camera_position,
    extruded,
    pixel_rays,
    solids,
)

from navsim.bench_camera import generated_room
from navsim.camera import DepthCamera
from navsim.errors import WorldError
from navsim.raycast import render_depth
from navsim.world import World
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY, load_world, shipped_worlds

SHIPPED = sorted({"simple_train", "simple_eval", "complex_train", "complex_eval", *shipped_worlds()})

POSES = {
    "Embree": {"each shipped world": 200, "generated rooms": 700, "a generated hall": 55, "nasty worlds": 900},
    "MuJoCo": {"each shipped world": 150, "generated rooms": 500, "a generated hall": 55, "nasty worlds": 900},
}
"""How many poses each test compares at least; poses on a surface are not counted."""


@pytest.mark.parametrize("name", POSES)
def test_at_least_2000_poses_are_compared_with_each_reference(name):
    each, *others = POSES[name].values()
    assert 4 * each + sum(others) >= 2000


# ---- the references


@pytest.mark.parametrize("obstacle", random_room(np.random.default_rng(3), 12)["obstacles"])
def test_the_reference_meshes_are_closed_and_hold_the_right_volume(obstacle):
    (solid,) = solids(world_of(obstacle))
    mesh = extruded(solid.footprint, solid.base, solid.top, convex=solid.radius > 0.0)
    mesh.merge_vertices()
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(solid.footprint.area * (solid.top - solid.base), rel=1e-9)


def test_rays_of_the_references_are_those_of_the_design():
    """First pixel: half a pixel inside the upper left corner of the view."""
    camera = DepthCamera(width=80, height=64)
    ray = pixel_rays(camera, np.zeros(3), np.zeros(1), np.zeros(1))[0]
    fx, fy = 40 / math.tan(math.radians(30)), 32 / (math.tan(math.radians(30)) * 480 / 640)
    np.testing.assert_allclose(ray, [1.0, 39.5 / fx, 31.5 / fy])


def test_the_references_agree_with_each_other_where_no_silhouette_is():
    """Neither is right because the other is: that they agree is a check of both, without the ray-caster."""
    rng = np.random.default_rng(13)
    room = random_room(rng)
    embree, in_mujoco = MeshReference(room, EYE), MujocoReference(room)
    different = pixels = 0
    for pose in random_poses(rng, 30, room["size"]):
        rows, columns = (index.ravel().astype(np.float64) for index in np.mgrid[0:17, 0:33])
        rays = pixel_rays(SMALL, pose, rows, columns)
        origin = camera_position(SMALL, pose)
        if not any(solid.holds(origin) for solid in embree.solids):
            first, second = (np.minimum(reference.cast(origin, rays), 5.0) for reference in (embree, in_mujoco))
            different += np.count_nonzero(np.abs(first - second) > 1e-3)
            pixels += len(rays)
    assert pixels > 10_000
    assert different < 0.001 * pixels


# ---- shipped worlds


def shipped(name: str) -> tuple[dict[str, Any], World]:
    """The dictionary in a shipped world's file, and the world that the library makes of it."""
    path = SHIPPED_WORLDS_DIRECTORY / f"{name}.yaml"
    return yaml.safe_load(path.read_text(encoding="utf-8")), load_world(name)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_look_the_same_to_embree(name):
    compare_shipped_world(name, MeshReference(shipped(name)[0], EYE), large=70, small=140)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_look_the_same_to_mujoco(name):
    compare_shipped_world(name, MujocoReference(shipped(name)[0]), large=10, small=150)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_look_the_same_to_embree_and_to_mujoco_from_everywhere(name):
    description, _ = shipped(name)
    compare_shipped_world(name, MeshReference(description, EYE), large=1500, small=1500, seed=100)
    compare_shipped_world(name, MujocoReference(description), large=300, small=1500, seed=200)


def compare_shipped_world(
    name: str, reference: MeshReference | MujocoReference, *, large: int, small: int, seed: int = 0
) -> None:
    """From ``large`` poses at 80x64 and ``small`` ones at 33x17."""
    comparison, world = Comparison(), load_world(name)
    for number, (camera, count) in enumerate(((DepthCamera(), large), (SMALL, small))):
        poses = random_poses(np.random.default_rng(seed + number), count, world.size)
        comparison.add(reference, camera, poses, render_depth(world, poses, camera))
    comparison.check(POSES[reference.name]["each shipped world"])


# ---- generated worlds


def compare_generated_rooms(
    kind: type[MeshReference | MujocoReference], rooms: int, large: int, small: int, seed: int, least: int
) -> None:
    """Rooms with everything in them, and every third like those that the benchmark is run in."""
    rng, comparison = np.random.default_rng(seed), Comparison()
    for number in range(rooms):
        room = random_room(rng) if number % 3 else generated_room(rng).to_dict()
        world = World.from_dict(room)
        reference = kind(room, EYE) if kind is MeshReference else kind(room)
        for camera, count in ((DepthCamera(), large), (SMALL, small)):
            poses = random_poses(rng, count, world.size)
            comparison.add(reference, camera, poses, render_depth(world, poses, camera))
    comparison.check(least)


def test_generated_rooms_look_the_same_to_embree():
    least = POSES["Embree"]["generated rooms"]
    compare_generated_rooms(MeshReference, rooms=18, large=6, small=36, seed=4, least=least)


def test_generated_rooms_look_the_same_to_mujoco():
    least = POSES["MuJoCo"]["generated rooms"]
    compare_generated_rooms(MujocoReference, rooms=14, large=1, small=38, seed=5, least=least)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_many_generated_rooms_look_the_same_to_embree_and_to_mujoco():
    compare_generated_rooms(MeshReference, rooms=150, large=20, small=80, seed=400, least=14_000)
    compare_generated_rooms(MujocoReference, rooms=150, large=4, small=40, seed=500, least=6_000)


@pytest.mark.parametrize("kind", [MeshReference, MujocoReference])
def test_a_generated_hall_looks_the_same_everywhere(kind):
    rng, comparison = np.random.default_rng(10), Comparison()
    room = random_room(rng, obstacles=300, size=40.0)
    world = World.from_dict(room)
    in_mujoco = MujocoReference(room)
    for x, y in ((-18.0, -18.0), (0.5, 0.5), (17.5, 3.0)):
        poses = random_poses(rng, 20, (4.0, 4.0)) + np.array([x, y, 0.0])
        reference = MeshReference(room, EYE, (x, y)) if kind is MeshReference else in_mujoco
        comparison.add(reference, SMALL, poses, render_depth(world, poses, SMALL))
    comparison.check(POSES[kind.name]["a generated hall"])


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

GREATEST = DepthCamera().max_range
ROUND = [-2.0, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 2.0]
coordinates = st.one_of(st.sampled_from(ROUND), st.floats(-2.5, 2.5))
places = st.tuples(coordinates, coordinates).map(list)
round_places = st.tuples(st.sampled_from(ROUND), st.sampled_from(ROUND)).map(list)
lengths = st.one_of(st.sampled_from([0.001, 0.01, 0.25, 0.5, 1.0, 3.0, 40.0]), st.floats(0.001, 3.0))
extents = st.sampled_from([0.001, 0.05, 0.25, EYE - 1e-3, EYE + 1e-3, 0.42, 2.0, 30.0])
bases = st.sampled_from([0.0, 0.0, 0.0, 0.001, 0.1, 0.25, EYE - 1e-3, EYE + 1e-3, 0.35, 1.0])
at_eye_level = st.just(EYE)
radii = st.one_of(st.sampled_from([0.001, 0.05, 0.25, 1.0, 20.0]), st.floats(0.001, 1.0))
angles_deg = st.one_of(st.sampled_from([0.0, 90.0, -90.0, 180.0, 45.0, 30.0, -60.0]), st.floats(-180.0, 180.0))
axes = st.sampled_from([0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi])
yaws = st.one_of(axes, st.sampled_from([0.25 * math.pi, math.pi / 6, -math.pi / 3]), st.floats(-math.pi, math.pi))
CONCAVE = [
    [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]],  # L
    [[0, 0], [3, 0], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]],  # U
    [[0, 0], [2, 0], [2, 2], [1.001, 2], [1.001, 0.1], [0.999, 0.1], [0.999, 2], [0, 2]],  # a slit of 2 mm, or less
    [[0, 0], [1, 0.05], [2, 0], [1.95, 1], [2, 2], [1, 1.95], [0, 2], [0.05, 1]],  # four shallow notches
    [[0, 0], [5, 0], [5, 4], [2, 4], [2, 2], [3, 2], [3, 3], [4, 3], [4, 1], [1, 1], [1, 4], [0, 4]],  # a spiral
    [[0, 0], [1, 0], [2, 0], [1, 0.001]],  # a sliver with a straight corner
]
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
def outlines(draw: st.DrawFn) -> list[list[float]]:
    points = np.array(draw(st.sampled_from(CONCAVE)), dtype=np.float64) * draw(st.sampled_from([0.1, 0.25, 1.0]))
    turn = complex(*{0: (1, 0), 1: (0, 1), 2: (-1, 0), 3: (0.6, 0.8)}[draw(st.integers(0, 3))])
    rotated = (points[:, 0] + 1j * points[:, 1]) * turn
    moved = np.stack([rotated.real, rotated.imag], axis=1) + draw(places)
    return moved[:: draw(st.sampled_from([1, -1]))].tolist()


def shapes(camera: DepthCamera) -> st.SearchStrategy[dict[str, Any]]:
    # A face in the plane of the level row, which an odd number of rows has, is a silhouette along all of it.
    level = camera.height % 2 == 1
    height, base = (extents, bases) if level else (extents | at_eye_level, bases | at_eye_level)
    high = {"height": height, "base": base}
    return st.one_of(
        st.fixed_dictionaries({"at": places, "size": st.tuples(lengths, lengths), "yaw_deg": angles_deg, **high}).map(
            lambda shape: {"box": shape}
        ),
        st.fixed_dictionaries({"at": places, "radius": radii, **high}).map(lambda shape: {"cylinder": shape}),
        st.fixed_dictionaries({"points": outlines(), **high}).map(lambda shape: {"polygon": shape}),
    )


@st.composite
def couples(draw: st.DrawFn) -> list[dict[str, Any]]:
    """Two boxes of which the second touches the first, stands in it, or overlaps it; faces and corners may coincide."""
    at, (length, width) = draw(round_places), draw(st.tuples(*[st.sampled_from([0.25, 0.5, 1.0])] * 2))
    heights = st.sampled_from([0.25, 0.5, 2.0])
    first = box((at[0], at[1]), (length, width), draw(heights))
    relation = draw(st.sampled_from(["touches", "touches at a corner", "stands in", "overlaps", "stands upon"]))
    beside, aside, scale, base = {
        "touches": (length, 0.0, 1.0, 0.0),
        "touches at a corner": (length, width, 1.0, 0.0),
        "stands in": (0.0, 0.0, 0.5, 0.0),
        "overlaps": (0.5 * length, 0.25 * width, 1.0, 0.0),
        "stands upon": (0.0, 0.0, 0.5, first["box"]["height"]),
    }[relation]
    place = (at[0] + beside, at[1] + aside)
    return [first, box(place, (scale * length, scale * width), draw(heights), base=base)]


@st.composite
def before(draw: st.DrawFn, eye: tuple[float, float, float]) -> dict[str, Any]:
    """A box that stands in a special way to a camera at x and y that looks along an axis."""
    x, y, yaw = eye
    ahead = np.array([round(math.cos(yaw)), round(math.sin(yaw))])
    left = np.array([-ahead[1], ahead[0]])
    length, width = draw(st.sampled_from([0.25, 0.5, 2.0])), draw(st.sampled_from([0.5, 1.0, 4.0]))
    forward, aside, high = {
        "its face is where the view ends": (GREATEST + 0.5 * length, 0.0, {"height": 2.0}),
        "its side is edge-on": (0.75 + 0.5 * length, 0.5 * width * draw(st.sampled_from([-1, 1])), {"height": 1.0}),
        "the camera is in it": (0.125 * length, 0.125 * width, {"height": 1.0}),
        "the camera is under it": (0.125 * length, 0.125 * width, {"base": 0.4, "height": 0.5}),
        "the camera is over it": (0.125 * length, 0.125 * width, {"height": 0.2}),
    }[
        draw(
            st.sampled_from(
                [
                    "its face is where the view ends",
                    "its side is edge-on",
                    "the camera is in it",
                    "the camera is under it",
                    "the camera is over it",
                ]
            )
        )
    ]
    centre = np.array([x, y]) + forward * ahead + aside * left
    extent = length * np.abs(ahead) + width * np.abs(left)
    return box((float(centre[0]), float(centre[1])), (float(extent[0]), float(extent[1])), **high)


class Scenery(NamedTuple):
    """What hypothesis makes."""

    camera: DepthCamera
    world: dict[str, Any]
    poses: np.ndarray


@st.composite
def sceneries(draw: st.DrawFn) -> Scenery:
    camera = draw(cameras)
    eyes = draw(st.lists(st.tuples(coordinates, coordinates, yaws), min_size=9, max_size=9))
    special = draw(st.tuples(st.sampled_from(ROUND), st.sampled_from(ROUND), axes))
    obstacles = draw(st.lists(shapes(camera), min_size=1, max_size=5))
    for couple in draw(st.lists(couples(), max_size=2)):
        obstacles += couple
    obstacles += draw(st.lists(before(special), max_size=2))
    size = draw(st.sampled_from([5.0, 6.0, 10.0]))
    walls = draw(st.sampled_from(["none", {"height": 0.25}, {"height": 2.0, "thickness": 0.001}]))
    poses = []
    for x, y, yaw in (*eyes, special):  # the camera's, so that it stands exactly in line with edges
        offset = camera_position(camera, np.array([0.0, 0.0, yaw]))
        poses.append([x - offset[0], y - offset[1], yaw])
    world = {"format": 1, "size": [size, size], "walls": walls, "obstacles": obstacles}
    return Scenery(camera, world, np.array(poses))


def loaded(description: dict[str, Any]) -> tuple[dict[str, Any], World]:
    """The world, in a larger room where the obstacles leave the robot no place in theirs, or lie outside it."""
    try:
        return description, World.from_dict(description)
    except WorldError:
        larger = {**description, "size": [60.0, 60.0]}
        return larger, World.from_dict(larger)


class Census:
    """How often each kind of nastiness occurs, by shapely: so that no change of the strategies loses one unseen."""

    KINDS = (
        "touching",
        "nested",
        "overlapping",
        "thin",
        "tiny",
        "huge",
        "raised",
        "concave",
        "edge-on",
        "axis-aligned",
        "camera inside",
        "camera under",
        "camera over",
        "5 m exactly",
    )

    def __init__(self) -> None:
        self.count: Counter[str] = Counter()

    def add(self, scenery: Scenery) -> None:
        obstacles = solids({**scenery.world, "walls": "none"})
        kinds = {kind for solid in obstacles for kind in self._of_solid(solid)}
        for first, second in itertools.permutations(obstacles, 2):
            if first.base < second.top and second.base < first.top:
                a, b = first.footprint, second.footprint
                kinds |= {"touching"} if a.touches(b) else {"nested"} if a.contains_properly(b) else set()
                kinds |= {"overlapping"} if a.overlaps(b) else set()
        self.count.update(kinds)
        for pose in scenery.poses:
            self.count.update({kind for solid in obstacles for kind in self._of_pose(solid, scenery.camera, pose)})

    @staticmethod
    def _of_solid(solid: Solid) -> set[str]:
        longest = float(np.ptp(shapely.get_coordinates(solid.footprint), axis=0).max())
        area = solid.footprint.area
        return {
            kind
            for kind, holds in {
                "thin": area < 0.002 * longest or solid.top - solid.base < 0.002,
                "tiny": longest < 0.02,
                "huge": longest > 15.0,
                "raised": solid.base > 0.0,
                "concave": not solid.radius and area < 0.999 * solid.footprint.convex_hull.area,
            }.items()
            if holds
        }

    @staticmethod
    def _of_pose(solid: Solid, camera: DepthCamera, pose: np.ndarray) -> set[str]:
        eye = camera_position(camera, pose)
        corners = shapely.get_coordinates(solid.footprint) - eye[:2]
        ahead = corners @ [math.cos(pose[2]), math.sin(pose[2])]
        along = np.diff(corners, axis=0)
        aside = np.abs(corners[:-1, 0] * along[:, 1] - corners[:-1, 1] * along[:, 0]) / np.linalg.norm(along, axis=1)
        over_the_footprint = solid.footprint.contains(shapely.Point(eye[:2]))
        beside = np.maximum(ahead[:-1], ahead[1:]) > 0.0
        parallel = np.abs(ahead[1:] - ahead[:-1]) < 1e-9
        level = min(abs(eye[2] - solid.base), abs(eye[2] - solid.top)) < 1e-9
        is_polygon = not solid.radius
        return {
            kind
            for kind, holds in {
                "edge-on": level or (is_polygon and bool(np.any((aside < 1e-9) & beside))),
                "axis-aligned": is_polygon
                and bool(np.any(parallel))
                and round(pose[2] / math.pi * 2.0, 9) % 1.0 == 0.0,
                "camera inside": solid.holds(eye),
                "camera under": over_the_footprint and eye[2] < solid.base,
                "camera over": over_the_footprint and eye[2] > solid.top,
                "5 m exactly": is_polygon and bool(np.any(parallel & (np.abs(ahead[1:] - GREATEST) < 1e-9))),
            }.items()
            if holds
        }


def compare_nasty_worlds(examples: int, derandomize: bool) -> tuple[Comparison, Comparison, Census]:
    embree, in_mujoco, census = Comparison(), Comparison(), Census()

    @settings(
        max_examples=examples,
        derandomize=derandomize,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(sceneries())
    def compare(scenery: Scenery) -> None:
        camera, poses = scenery.camera, scenery.poses
        description, world = loaded(scenery.world)
        images = render_depth(world, poses, camera)
        embree.add(MeshReference(description, camera.mount_z), camera, poses, images)
        in_mujoco.add(MujocoReference(description), camera, poses, images)
        census.add(scenery)

    compare()
    return embree, in_mujoco, census


def test_nasty_worlds_look_the_same_to_embree_and_to_mujoco():
    embree, in_mujoco, census = compare_nasty_worlds(examples=130, derandomize=True)
    embree.check(POSES["Embree"]["nasty worlds"])
    in_mujoco.check(POSES["MuJoCo"]["nasty worlds"])
    rare = {kind: census.count[kind] for kind in Census.KINDS if census.count[kind] < 10}
    assert not rare, f"hardly any world or pose is nasty in these ways: {rare}"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_other_nasty_worlds_each_time():
    embree, in_mujoco, _ = compare_nasty_worlds(examples=1500, derandomize=False)
    embree.check(10_000)
    in_mujoco.check(10_000)


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
