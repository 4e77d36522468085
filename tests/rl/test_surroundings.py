"""What robots remember around them: beside plain loops, exact distances, and mirrored drives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.robot import MIRRORED_ACTIONS, Robot
from navsim.scan import obstacle_depth
from navsim.sensor import SensorModel
from navsim.simulator import Simulator
from navsim.world import World
from rl.env import NavEnv
from rl.evaluation import evaluate
from rl.surroundings import REACH, SECTORS, STEPS, Surroundings, remembered_at_end

CAMERA = DepthCamera(width=24, height=16)
"""No column is in the middle, on the edge of two sectors: what is remembered is symmetric."""


def plain_nearest(images: list[np.ndarray], poses: list[np.ndarray]) -> np.ndarray:
    """``Surroundings`` of one robot, with loops and angles in degrees."""
    nearest = [REACH] * SECTORS
    x, y, yaw = poses[-1]
    for image, (from_x, from_y, from_yaw) in list(zip(images, poses, strict=True))[-STEPS:]:
        scan = obstacle_depth(image, CAMERA)
        for column in range(CAMERA.width):
            from_side = min(column, CAMERA.width - 1 - column)
            if from_side % 2 or scan[column] >= CAMERA.max_range:
                continue
            ahead = scan[column] + CAMERA.mount_x
            left = scan[column] * CAMERA.column_slopes[column]
            there_x = from_x + ahead * math.cos(from_yaw) - left * math.sin(from_yaw)
            there_y = from_y + ahead * math.sin(from_yaw) + left * math.cos(from_yaw)
            bearing = math.degrees(math.atan2(there_y - y, there_x - x) - yaw)
            sector = int(((bearing + 180.0) % 360.0) // (360.0 / SECTORS))
            nearest[sector] = min(nearest[sector], math.hypot(there_x - x, there_y - y))
    return np.array(nearest)


def drives(seed: int, robots: int = 3, steps: int = 45) -> tuple[Simulator, list, list]:
    """Images and poses of robots that drive at random, finished or not."""
    simulator = Simulator(World.from_dict(ROOM), robots, camera=CAMERA, seed=seed)
    random = np.random.default_rng(seed)
    images, poses = [simulator.reset().depth], [simulator.poses.copy()]
    for _ in range(steps):
        moved = simulator.step(random.integers(0, 7, robots))
        images.append(moved.depth)
        poses.append(simulator.poses.copy())
        ended = moved.terminated | moved.truncated
        if ended.any():
            break
    return simulator, images, poses


ROOM = {
    "format": 1,
    "size": [7, 7],
    "obstacles": [
        {"box": {"at": [1.4, 0.5], "size": [0.4, 0.4], "height": 1.0, "yaw_deg": 20}},
        {"cylinder": {"at": [-1.2, -1.0], "radius": 0.2, "height": 0.3}},
        {"box": {"at": [-1.0, 1.6], "size": [0.8, 0.3], "height": 0.6}},
    ],
    "starts": "random",
    "goals": "random",
}


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_it_is_what_loops_over_the_last_images_give(seed):
    _, images, poses = drives(seed)
    memory = Surroundings(3, CAMERA)
    memory.begin(images[0], poses[0])
    for image, pose in zip(images[1:], poses[1:], strict=True):
        memory.see(image, pose)
    ours = memory.nearest(poses[-1])
    assert ours.dtype == np.float32
    for robot in range(3):
        own = [image[robot] for image in images], [pose[robot] for pose in poses]
        expected = plain_nearest(*own)
        differs = np.abs(ours[robot] - expected) > 1e-3
        # Rounding may move a point that lies on the edge of a sector: one loses it, its neighbour gains it.
        assert np.count_nonzero(differs) <= 2
        again = remembered_at_end(np.array(own[0]), np.array(own[1]), CAMERA)
        np.testing.assert_allclose(again[0], ours[robot], atol=1e-4)


def test_what_was_driven_past_is_remembered_where_it_is_and_then_forgotten():
    box = {"at": [1.0, 0.7], "size": [0.3, 0.3], "height": 1.0}
    world = World.from_dict({"format": 1, "size": [12, 6], "obstacles": [{"box": box}]})
    shape = shapely.box(0.85, 0.55, 1.15, 0.85)
    camera = DepthCamera()
    memory = Surroundings(1, camera)
    poses = np.array([[-1.0 + 0.08 * step, 0.0, 0.0] for step in range(STEPS + 28)])
    images = camera.to_uint8(camera.from_planar(render_depth(world, poses, camera)))
    memory.begin(images[:1], poses[:1])
    for step in range(1, len(poses)):
        memory.see(images[step : step + 1], poses[step : step + 1])
        x = poses[step, 0]
        distance, bearing = shape.distance(shapely.Point(x, 0.0)), math.atan2(0.7, 1.0 - x)
        sector = int((bearing / (2 * math.pi) + 0.5) * SECTORS)
        told = memory.nearest(poses[step : step + 1])[0, sector - 2 : sector + 3].min()
        if 0.2 < x < 1.4:  # it has been in view within a few steps, or is still; and in the end is behind
            assert told == pytest.approx(distance, abs=0.08)
            if x > 0.8:
                assert obstacle_depth(images[step], camera).min() > 1.0  # the image no longer tells of it
    assert x > 3.0
    assert memory.nearest(poses[-1:]).min() == REACH


def test_mirrored_drives_are_remembered_mirrored():
    turned = {**ROOM, "starts": [{"at": [-2.5, 0.2], "yaw_deg": 10}], "goals": [[3, 3]]}
    flipped = {
        **turned,
        "obstacles": [
            {"box": {"at": [1.4, -0.5], "size": [0.4, 0.4], "height": 1.0, "yaw_deg": -20}},
            {"cylinder": {"at": [-1.2, 1.0], "radius": 0.2, "height": 0.3}},
            {"box": {"at": [-1.0, -1.6], "size": [0.8, 0.3], "height": 0.6}},
        ],
        "starts": [{"at": [-2.5, -0.2], "yaw_deg": -10}],
        "goals": [[3, -3]],
    }
    one, other = (
        NavEnv(World.from_dict(world), 1, camera=CAMERA, surroundings=True, seed=0) for world in (turned, flipped)
    )
    state, mirrored = one.reset(), other.reset()
    for action in [1, 2, 2, 3, 0, 6, 6, 2, 4]:
        state["action"], mirrored["action"] = torch.tensor([action]), torch.tensor([MIRRORED_ACTIONS[action]])
        state, mirrored = one.step(state)["next"], other.step(mirrored)["next"]
        assert not state["done"].any()
        torch.testing.assert_close(mirrored["heading"], -state["heading"], atol=1e-5, rtol=0)
        torch.testing.assert_close(mirrored["surroundings"], state["surroundings"].flip(-1), atol=1e-3, rtol=0)
    assert (state["surroundings"] < REACH).any()


def test_an_environment_tells_what_evaluations_tell():
    seen = []

    class Look:
        in_keys = ("depth", "surroundings")

        def __call__(self, state):
            seen.append(state["surroundings"].clone())
            return state.set("action", torch.full(state.batch_size, 3))

    world = World.from_dict({**ROOM, "starts": [{"at": [-2.5, 0.2], "yaw_deg": 10}], "goals": [[3, 3]]})
    path = evaluate(Look(), world, camera=CAMERA).paths[0]
    env = NavEnv(world, 1, camera=CAMERA, surroundings=True, seed=0)
    state = env.reset()
    for step in range(path.steps):
        assert torch.equal(seen[step], state["surroundings"])
        state = env.step(state.set("action", torch.tensor([3])))["next"]


def test_robots_that_begin_anew_forget_and_the_others_do_not():
    _, images, poses = drives(5)
    memory, alone = Surroundings(3, CAMERA), Surroundings(3, CAMERA)
    memory.begin(images[0], poses[0])
    for step in (1, 2, 3):
        memory.see(images[step], poses[step])
    before = memory.nearest(poses[3])
    memory.begin(images[4], poses[4], np.array([False, True, False]))
    alone.begin(images[4], poses[4])
    kept, anew = memory.nearest(np.where([[0], [1], [0]], poses[4], poses[3])), alone.nearest(poses[4])
    np.testing.assert_array_equal(kept[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(kept[1], anew[1])
    some = memory.take(np.array([True, False, True]))
    np.testing.assert_array_equal(some.nearest(poses[3][[0, 2]]), kept[[0, 2]])
    some.see(images[5][[0, 2]], poses[5][[0, 2]])
    memory.see(images[5], poses[5])
    np.testing.assert_array_equal(some.nearest(poses[5][[0, 2]]), memory.nearest(poses[5])[[0, 2]])
    np.testing.assert_array_equal(some.state_dict()["points"], memory.state_dict()["points"][[0, 2]])


def test_a_robot_that_is_left_out_of_steps_forgets_as_if_they_had_not_been():
    generator = np.random.default_rng(0)
    shape = (STEPS + 20, 2, CAMERA.height, CAMERA.width)
    images = np.repeat(generator.uniform(0.5, 1.5, (*shape[:2], 1, shape[3])), shape[2], axis=2).astype(np.float32)
    poses = generator.uniform(-0.5, 0.5, (len(images), 2, 3))
    memory, alone = Surroundings(2, CAMERA), Surroundings(1, CAMERA)
    memory.begin(images[0], poses[0])
    alone.begin(images[0, 1:], poses[0, 1:])
    for step in range(1, len(images)):
        for _ in range(step % 3):
            memory.see(images[step - 1], poses[step - 1], np.array([True, False]))
        memory.see(images[step], poses[step])
        alone.see(images[step, 1:], poses[step, 1:])
        np.testing.assert_array_equal(memory.nearest(poses[step])[1:], alone.nearest(poses[step, 1:]))


def test_what_is_free_is_not_remembered():
    """Neither as far as the camera sees, nor of the episode before."""
    shortsighted = DepthCamera(width=23, height=16, max_range=1.5)
    pose, near = np.zeros((1, 3)), np.full((1, 16, 23), 1.0, np.float32)
    memory = Surroundings(1, shortsighted)
    memory.begin(near, pose)
    memory.see(near, pose)
    assert memory.nearest(pose).min() < 1.0
    memory.begin(np.full_like(near, 1.5), pose)
    assert memory.nearest(pose).min() == REACH


def test_pixels_whose_return_was_lost_are_no_obstacles():
    """With a sensor that loses returns, nothing is remembered where an ideal one remembers nothing, and little else
    than it does."""
    sensor = SensorModel(grazing_loss=1.0, edge_loss=0.5)
    ideal, lossy = (NavEnv("complex_train", 4, surroundings=True, sensor=each, seed=2) for each in (None, sensor))
    expected, told = ideal.reset(), lossy.reset()
    remembered = []
    for _ in range(12):
        action = torch.full((4,), 3)
        expected = ideal.step(expected.set("action", action))["next"]
        told = lossy.step(told.set("action", action))["next"]
        assert (told["pose"] == expected["pose"]).all()
        assert (told["surroundings"] > expected["surroundings"] - 0.15).all()
        remembered.append((told["surroundings"] < REACH).sum() / (expected["surroundings"] < REACH).sum())
    assert min(remembered) > 0.7


def test_late_images_are_remembered_where_they_were_taken():
    late = NavEnv("complex_train", 4, camera=CAMERA, surroundings=True, sensor=SensorModel(latency=2), seed=2)
    state = late.reset()
    poses = [late.simulator.poses.copy()]
    for action in [1, 2, 3, 3, 2, 5, 5, 0]:
        state = late.step(state.set("action", torch.full((4,), action)))["next"]
        poses.append(late.simulator.poses.copy())
    shown = [poses[max(step - 2, 0)] for step in range(len(poses))]
    for robot in range(4):
        taken = np.array([pose[robot] for pose in shown])
        world = late.simulator.worlds[late.simulator.world_index[robot]]
        images = CAMERA.to_uint8(CAMERA.from_planar(render_depth(world, taken, CAMERA)))
        memory = Surroundings(1, CAMERA)
        memory.begin(images[:1], taken[:1])
        for step in range(1, len(taken)):
            memory.see(images[step : step + 1], taken[step : step + 1])
        told = memory.nearest(poses[-1][robot : robot + 1])[0]
        np.testing.assert_allclose(state["surroundings"][robot], told, atol=1e-5)
    again = NavEnv("complex_train", 4, camera=CAMERA, surroundings=True, sensor=SensorModel(latency=2), seed=9)
    again.reset()
    again.load_state_dict(late.state_dict())
    np.testing.assert_array_equal(again.simulator.image_poses, shown[-1])


def test_only_the_robots_that_begin_anew_forget_in_an_environment():
    env = NavEnv(World.from_dict(ROOM), 3, camera=CAMERA, surroundings=True, seed=1)
    state = env.reset()
    for _ in range(3):
        state = env.step(state.set("action", torch.tensor([2, 2, 2])))["next"]
    before, told = env.surroundings.state_dict()["points"], state["surroundings"].clone()
    state["_reset"] = torch.tensor([[False], [True], [False]])
    assert torch.equal(env.reset(state)["surroundings"][[0, 2]], told[[0, 2]])
    after = env.surroundings.state_dict()["points"]
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    images = np.isfinite(after).any(axis=(2, 3)).sum(axis=1)
    assert images[[0, 2]].min() > images[1] == 1


def test_a_robot_keeps_its_memory_when_others_have_finished():
    """Driven together or alone, it is told the same."""
    seen = {}

    class Look:
        in_keys = ("depth", "surroundings")

        def __call__(self, state):
            seen.setdefault(len(state), []).append(state["surroundings"].clone())
            return state.set("action", torch.full(state.batch_size, 4))

    near, far = {"at": [2.2, -2.5], "yaw_deg": 0}, {"at": [-2.5, 0.2], "yaw_deg": 10}  # the first hits the wall soon
    for starts in ([near, far], [far]):
        world = World.from_dict({**ROOM, "starts": starts, "goals": [[3, 3]]})
        paths = evaluate(Look(), world, camera=CAMERA).paths
    assert 0 < len(seen[2]) < paths[0].steps
    alone = seen[1][-paths[0].steps :]  # of the second evaluation
    after_the_end_of_the_other = seen[1][: -paths[0].steps]
    assert len(seen[2]) + len(after_the_end_of_the_other) == len(alone)
    together = [state[1:] for state in seen[2]] + after_the_end_of_the_other
    for one, other in zip(together, alone, strict=True):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=0)


def test_what_is_too_near_to_be_measured_is_remembered_ahead():
    """Its depth, "no return", is that of the camera itself, which sits behind the robot's centre."""
    memory, pose = Surroundings(1, CAMERA), np.zeros((1, 3))
    near = np.full((1, CAMERA.height, CAMERA.width), CAMERA.max_range)
    near[..., CAMERA.width // 2 + 1] = 0.0  # of the columns that are remembered
    memory.begin(near, pose)
    told = memory.nearest(pose)[0]
    assert np.flatnonzero(told < REACH).tolist() in ([SECTORS // 2 - 1], [SECTORS // 2])
    assert told.min() == pytest.approx(CAMERA.blind_zone + CAMERA.mount_x, abs=0.01)


@pytest.mark.parametrize(("height", "is_in_the_way"), [(0.42, False), (1.0, True)])
def test_what_hangs_over_one_robot_is_in_the_way_of_a_taller_one(height, is_in_the_way):
    beam = {"box": {"at": [0.5, 0.0], "size": [0.2, 3.0], "base": 0.6, "height": 0.2}}
    world = World.from_dict({**ROOM, "obstacles": [beam], "starts": [{"at": [-1.0, 0.0], "yaw_deg": 0}]})
    env = NavEnv(world, 1, camera=CAMERA, surroundings=True, robot=Robot(height=height))
    state = env.reset()
    for _ in range(4):
        state = env.step(state.set("action", torch.tensor([4])))["next"]
    ahead = state["surroundings"][0, SECTORS // 2 - 1 : SECTORS // 2 + 1]
    gap = 0.4 - float(state["pose"][0, 0])
    assert (ahead < REACH).any() == is_in_the_way
    if is_in_the_way:
        assert ahead.min() == pytest.approx(gap, abs=0.03)
