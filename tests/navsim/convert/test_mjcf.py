"""MuJoCo's own rays see in an exported world what the ray-caster sees in the world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from same_view import CAMERA, part_that_differs, poses_in, worlds

import navsim
from navsim.convert import save_mjcf, save_ros_map, save_sdf
from navsim.world import Motion, Pushable

mujoco = pytest.importorskip("mujoco")


def rendered_by_mujoco(model, poses: np.ndarray) -> np.ndarray:
    """``(N, H, W)`` planar depth, metres, by MuJoCo's rays."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    left, up = np.meshgrid(CAMERA.column_slopes, CAMERA.row_slopes)
    rays = np.stack([np.ones(left.size), left.ravel(), up.ravel()], axis=1)
    images = np.empty((len(poses), len(rays)))
    geoms = np.empty(len(rays), dtype=np.int32)
    for (x, y, yaw), image in zip(poses, images, strict=True):
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        eye = np.array([x, y, 0.0]) + np.array([CAMERA.mount_x, CAMERA.mount_y, CAMERA.mount_z]) @ turn
        mujoco.mj_multiRay(model, data, eye, (rays @ turn).ravel(), None, True, -1, geoms, image, None, len(rays), 1e3)
    images[images < 0.0] = CAMERA.max_range
    return np.minimum(images, CAMERA.max_range).reshape(len(poses), CAMERA.height, CAMERA.width)


def outside(world: navsim.World, poses: np.ndarray) -> np.ndarray:
    """The poses whose camera is in no obstacle: MuJoCo's rays see the inside of one from there."""
    return poses[navsim.render_depth(world, poses, CAMERA).max(axis=(1, 2)) > 0.0]


def assert_mujoco_sees_the_same(world: navsim.World, path, count: int) -> None:
    save_mjcf(world, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    poses = outside(world, poses_in(world, count))
    if len(poses):
        assert part_that_differs(navsim.render_depth(world, poses, CAMERA), rendered_by_mujoco(model, poses)) < 1e-3


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_shipped_worlds_look_the_same_to_mujoco(name, tmp_path):
    assert_mujoco_sees_the_same(navsim.load_world(name), tmp_path / "world.xml", 20)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(world=worlds())
def test_any_world_looks_the_same_to_mujoco(world, tmp_path):
    assert_mujoco_sees_the_same(world, tmp_path / "world.xml", 6)


def test_names_survive_and_concave_polygons_bump_as_they_look(tmp_path):
    shape = {"name": "the L", "points": [[0, 0], [2, 0], [2, 0.2], [0.2, 0.2], [0.2, 2], [0, 2]], "height": 0.5}
    world = navsim.World.from_dict(
        {"format": 1, "size": [6, 6], "starts": [{"at": [-2, -2], "yaw_deg": 90}], "goals": [[-2, 2]],
         "obstacles": [{"polygon": shape}, {"box": {"at": [-1, 0], "size": [0.2, 0.2], "height": 0.2}}]}
    )  # fmt: skip
    notes = save_mjcf(world, tmp_path / "world.xml")
    text = (tmp_path / "world.xml").read_text()
    ball = '<body pos="{} 0.25"><freejoint/><geom name="ball" type="sphere" size="0.1"/></body></worldbody>'
    touching = {}
    for at in ("1 1", "1 0.15", "0.15 1"):
        model = mujoco.MjModel.from_xml_string(text.replace("</worldbody>", ball.format(at)))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        names = [model.geom(geom).name for contact in data.contact for geom in contact.geom]
        touching[at] = sum(name.startswith("the L") for name in names)
    assert touching["1 1"] == 0  # in the bay of the L, which a hull would fill
    assert touching["1 0.15"]
    assert touching["0.15 1"]
    assert {model.geom(i).name for i in range(model.ngeom)} >= {"floor", "wall north", "the L", "box 2"}
    assert [model.site(i).name for i in range(model.nsite)] == ["start_1", "goal_1"]
    assert notes == ["starts and goals are written as sites, which nothing bumps into"]


def test_what_moves_or_can_be_pushed_is_written_where_it_stands_and_listed(tmp_path):
    world = navsim.load_world("simple_eval")
    moving = world.obstacles[0].model_copy(update={"motion": Motion(path=((0.0, 0.0), (1.0, 0.0)), speed=0.5)})
    loose = world.obstacles[1].model_copy(update={"pushable": Pushable(mass=0.5)})
    changed = world.model_copy(update={"obstacles": (moving, loose, *world.obstacles[2:])})
    for save, path in ((save_mjcf, "w.xml"), (save_sdf, "w.sdf"), (save_ros_map, "w.yaml")):
        notes = save(changed, tmp_path / path)
        assert [note for note in notes if moving.name in note] == [
            f"'{moving.name}' moves; it is written where the world file puts it, as something fixed"
        ]
        assert any(f"'{loose.name}' can be pushed" in note for note in notes)
        still = tmp_path / "still"
        still.mkdir(exist_ok=True)
        save(world, still / path)
        assert (still / path).read_text() == (tmp_path / path).read_text()
