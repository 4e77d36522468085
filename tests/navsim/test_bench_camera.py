"""The camera's benchmark: that what it compares is the same picture, and that it prints what it measures."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from rich.console import Console

from navsim import bench_camera
from navsim.bench_camera import benchmark_camera, benchmark_scaling, free_poses, generated_room, run
from navsim.camera import DepthCamera
from navsim.raycast import render_depth


def test_peers_render_the_same_scenes():
    rows = benchmark_camera(40, 32, num_robots=4, peers=True, repeats=1)
    assert {row.world for row in rows} == {"generated room", "complex_train", "complex_eval"}
    measured = [row for row in rows if not row.missing]
    assert {"navsim", "Embree (embreex)", "MuJoCo (mj_multiRay)"} <= {row.renderer for row in measured}
    for row in measured:
        assert row.agreement > 0.98, row
        assert row.images_per_second > 0.0
        assert (row.times_slower == 1.0) == (row.renderer == "navsim")


def test_without_peers_only_the_ray_caster_is_measured():
    rows = benchmark_camera(8, 8, num_robots=2, repeats=1, worlds=["simple_train"])
    assert [(row.world, row.renderer) for row in rows] == [("generated room", "navsim"), ("simple_train", "navsim")]


def test_a_peer_that_is_not_installed_is_named(monkeypatch):
    original = builtins.__import__

    def without_peers(name, *args, **kwargs):
        if name.split(".")[0] in ("embreex", "mujoco", "pybullet", "pyglet"):
            raise ModuleNotFoundError(name, name=name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_peers)
    monkeypatch.setattr(bench_camera, "benchmark_scaling", lambda num_robots: bench_camera.Scaling(0.1, 0.12))
    console = Console(record=True, width=160)
    run(sizes=[(8, 8)], num_robots=2, peers=True, repeats=1, worlds=[], console=console)
    text = console.export_text()
    assert text.count("is not installed") == len(bench_camera._PEERS)
    assert text.count('pip install "navsim-rl[peers]"') == len(bench_camera._PEERS)
    assert "1.20 times" in text


def test_a_system_without_opengl_is_told_in_one_sentence(monkeypatch):
    def without_opengl(world, camera):
        raise ImportError('Library "EGL" not found.')

    monkeypatch.setattr(bench_camera, "_PEERS", {"Miniworld (Mesa)": without_opengl})
    monkeypatch.setattr(bench_camera, "benchmark_scaling", lambda num_robots: bench_camera.Scaling(0.1, 0.12))
    console = Console(record=True, width=200)
    run(sizes=[(8, 8)], num_robots=2, peers=True, repeats=1, worlds=[], console=console)
    assert 'Miniworld (Mesa) was left out: the system lacks what it needs (Library "EGL" not found.)' in (
        console.export_text()
    )


def test_free_poses_see_nothing_near_and_lie_in_the_room():
    rng = np.random.default_rng(0)
    room = generated_room(rng)
    poses = free_poses(rng, room, 50)
    assert poses.shape == (50, 3)
    assert np.all(np.abs(poses[:, :2]) < 3.5)
    camera = DepthCamera()
    assert render_depth(room, poses, camera).min() >= 0.4


def test_generated_rooms_hold_low_and_raised_things():
    obstacles = generated_room(np.random.default_rng(0), num_obstacles=24).obstacles
    assert len(obstacles) == 24
    assert sum(obstacle.top < 0.297 or obstacle.base > 0.0 for obstacle in obstacles) == 8


@pytest.mark.slow
def test_an_image_costs_little_more_in_a_hall_of_ten_thousand_obstacles():
    assert benchmark_scaling().ratio <= 1.5
