"""What episodes draw anew: ranges, reproducibility, and that nothing changes where nothing is drawn."""

from __future__ import annotations

import math
import pickle
from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from navsim.camera import DepthCamera
from navsim.footprints import Footprints
from navsim.randomization import Randomization
from navsim.raycast import nearest_depth
from navsim.robot import NUM_ACTIONS, TURTLEBOT2, follow_arc, with_wheel_errors
from navsim.sensor import SensorModel
from navsim.simulator import Simulator
from navsim.task import START_CLEARANCE, Path, Task
from navsim.world import World

SMALL = DepthCamera(width=20, height=16)
NOISE = SensorModel(axial_noise=1.0, latency=1)
WIDE = Randomization(
    camera_height=(-0.05, 0.1),
    camera_pitch_deg=(-3.0, 6.0),
    camera_forward=(-0.02, 0.03),
    camera_left=(-0.04, -0.01),
    wheel_speed_error=(-0.1, 0.05),
    latency=(0, 2),
    noise_level=(0.5, 2.0),
    start_distance=(0.0, 0.4),
    start_turn_deg=(-20.0, 40.0),
)
WORLD = World.from_dict(
    {
        "format": 1,
        "size": [7, 7],
        "obstacles": [
            {"box": {"at": [0.0, 0.6], "size": [0.4, 0.4], "height": 1.0}},
            {"cylinder": {"at": [-2.0, 0.6], "radius": 0.2, "height": 1.0}},
        ],
        "starts": [{"at": [-2.0, 0.0], "yaw_deg": 0}, {"at": [2.0, 2.0], "yaw_deg": 180}],
        "goals": [[2.0, -2.0], [-2.5, 2.5]],
    }
)


def simulator(count: int = 4, randomization: Randomization | None = WIDE, seed: int = 0, **settings) -> Simulator:
    settings = {"camera": SMALL, "task": Task(max_steps=10), "sensor": NOISE, **settings}
    return Simulator(WORLD, count, randomization=randomization, seed=seed, **settings)


def rollout(subject: Simulator, steps: int = 30) -> list[bytes]:
    generator, seen = np.random.default_rng(1), [b"".join(part.tobytes() for part in subject.reset())]
    for _ in range(steps):
        moved = subject.step(generator.integers(NUM_ACTIONS, size=subject.num_robots))
        seen.append(b"".join(part.tobytes() for part in moved))
        seen.append(b"".join(part.tobytes() for part in subject.reset(moved.terminated | moved.truncated)))
    return seen


def drawn(subject: Simulator, episodes: int) -> dict[str, np.ndarray]:
    """What so many episodes of every robot got, as what the settings call it."""
    kept: dict[str, list] = {setting.name: [] for setting in fields(Randomization)}
    camera = subject.camera
    for _ in range(episodes):
        subject.reset()
        starts = np.array([WORLD.starts[path.start_index].at for path in subject.paths])
        yaws = np.radians([WORLD.starts[path.start_index].yaw_deg for path in subject.paths])
        values = {
            "camera_height": subject.mounts.z - camera.mount_z,
            "camera_pitch_deg": np.degrees(subject.mounts.pitch) - camera.pitch_deg,
            "camera_forward": subject.mounts.x - camera.mount_x,
            "camera_left": subject.mounts.y - camera.mount_y,
            "wheel_speed_error": subject.wheel_errors.ravel(),
            "latency": subject._sensor.latency - subject.sensor.latency,
            "noise_level": subject._sensor.noise_level,
            "start_distance": np.hypot(*(subject.poses[:, :2] - starts).T),
            "start_turn_deg": np.degrees(np.angle(np.exp(1j * (subject.poses[:, 2] - yaws)))),
        }
        for name, value in values.items():
            kept[name].append(np.array(value))
    return {name: np.concatenate(values) for name, values in kept.items()}


def test_every_range_is_kept_and_filled():
    values = drawn(simulator(20), 15)
    for name, value in values.items():
        low, high = getattr(WIDE, name)
        assert value.min() >= low - 1e-6, name
        assert value.max() <= high + 1e-6, name
        assert value.min() < low + 0.1 * (high - low) + 1e-9, name
        assert value.max() > high - 0.1 * (high - low) - 1e-9, name
    even = ("camera_height", "camera_pitch_deg", "camera_forward", "camera_left", "wheel_speed_error", "noise_level")
    for name in even:
        low, high = getattr(WIDE, name)
        assert stats.kstest((values[name] - low) / (high - low), "uniform").pvalue > 1e-4, name
    assert set(np.unique(values["latency"])) == {0, 1, 2}
    assert np.abs(np.bincount(values["latency"].astype(int)) - 100).max() < 4.0 * math.sqrt(300 * 2 / 9)


def test_what_is_drawn_is_drawn_for_each_episode_and_kept_through_it():
    subject = simulator(3)
    subject.reset()
    first = [values.copy() for values in (*subject.mounts, subject.wheel_errors)]
    subject.step(np.array([1, 2, 3]))
    for before, after in zip(first, (*subject.mounts, subject.wheel_errors), strict=True):
        np.testing.assert_array_equal(before, after)
    subject.reset(np.array([True, False, False]))
    for before, after in zip(first, (*subject.mounts, subject.wheel_errors), strict=True):
        assert np.all(before[0] != after[0])
        np.testing.assert_array_equal(before[1:], after[1:])


def test_the_same_seed_draws_the_same_whoever_else_is_there():
    assert rollout(simulator(seed=5)) == rollout(simulator(seed=5))
    assert rollout(simulator(seed=5)) != rollout(simulator(seed=6))
    few, many = drawn(simulator(2, seed=5), 3), drawn(simulator(6, seed=5), 3)
    for name, values in few.items():
        per_robot = 2 if name == "wheel_speed_error" else 1
        np.testing.assert_array_equal(
            values.reshape(3, 2 * per_robot), many[name].reshape(3, 6 * per_robot)[:, : 2 * per_robot]
        )


@pytest.mark.parametrize("sensor", [SensorModel(), NOISE])
def test_ranges_that_hold_nothing_give_the_bytes_of_none(sensor):
    nothing = Randomization()
    assert not nothing.moves_starts
    assert rollout(simulator(randomization=nothing, sensor=sensor)) == rollout(
        simulator(randomization=None, sensor=sensor)
    )


def test_randomising_the_camera_leaves_episodes_as_they_are():
    plain, tilted = simulator(randomization=None), simulator(randomization=Randomization(camera_pitch_deg=(0.0, 5.0)))
    for _ in range(5):
        np.testing.assert_array_equal(plain.reset().pose, tilted.reset().pose)
        assert plain.paths == tilted.paths


def test_every_robot_sees_with_its_own_camera():
    subject = simulator(5)
    subject.reset()
    for robot in range(5):
        camera = DepthCamera(
            width=20,
            height=16,
            mount_x=float(subject.mounts.x[robot]),
            mount_y=float(subject.mounts.y[robot]),
            mount_z=float(subject.mounts.z[robot]),
            pitch_deg=math.degrees(subject.mounts.pitch[robot]),
        )
        alone = Simulator(WORLD, 1, camera=camera)
        alone.reset(paths=[Path(0, 0)])
        alone._physics.place([0], 0, subject.poses[robot])
        np.testing.assert_allclose(alone._look(np.array([0]))[0], subject.ideal_depth[robot], atol=1e-5)


def test_starts_move_with_clearance_view_and_a_way_to_the_goal():
    far = Randomization(start_distance=(0.0, 2.5), start_turn_deg=(-180.0, 180.0))
    subject = simulator(30, randomization=far, sensor=SensorModel())
    footprints = Footprints.of(list(WORLD.prisms))
    moved = 0
    for _ in range(4):
        subject.reset()
        room = footprints.nearest(subject.poses[:, :2])[0] - TURTLEBOT2.radius
        assert np.all(room >= START_CLEARANCE - 1e-9)
        assert np.all(np.abs(subject.poses[:, :2]) <= 3.5)
        views = nearest_depth(
            subject._scene, subject.world_index, subject.poses, SMALL, within=1.0, mounts=subject.mounts
        )
        assert np.all(views >= subject.task.collision_depth)
        starts = np.array([WORLD.starts[path.start_index].at for path in subject.paths])
        moved += np.count_nonzero(np.hypot(*(subject.poses[:, :2] - starts).T) > 0.5)
    assert moved > 60


def test_a_start_that_cannot_move_stays():
    cramped = World.from_dict(
        {
            "format": 1,
            "size": [0.47, 4.0],
            "starts": [{"at": [0.0, -1.5], "yaw_deg": 90}],
            "goals": [[0.0, 1.5]],
        }
    )
    subject = Simulator(cramped, 3, randomization=Randomization(start_distance=(1.0, 1.0)), seed=0)
    for _ in range(5):
        poses = subject.reset().pose
        # It fits straight ahead alone, a way that is hardly ever drawn.
        assert np.all(np.abs(poses[:, 0]) < 0.02)
        assert np.isin(np.round(poses[:, 1], 2), [-1.5, -0.5]).all()


def test_random_starts_are_not_moved():
    world = WORLD.model_copy(update={"starts": "random", "goals": "random"})
    settings = {"camera": SMALL, "seed": 3}
    plain = Simulator(world, 4, **settings)
    moving = Simulator(world, 4, randomization=Randomization(start_distance=(0.1, 0.3)), **settings)
    np.testing.assert_array_equal(plain.reset().pose, moving.reset().pose)


# ---- wheels


@pytest.mark.parametrize("command", [(0.4, 0.0), (0.2, math.pi / 4), (0.0, 0.5)])
@pytest.mark.parametrize("errors", [(0.0, 0.0), (0.1, 0.1), (-0.2, 0.05)])
def test_wheel_errors_act_on_the_speeds_of_the_wheels(command, errors):
    (linear, angular) = with_wheel_errors(np.array([command]), np.array([errors]))[0]
    left, right = (
        (command[0] + side * command[1] * 0.23 / 2) * (1.0 + error) for side, error in zip((-1, 1), errors, strict=True)
    )
    assert linear == pytest.approx((left + right) / 2, abs=1e-12)
    assert angular == pytest.approx((right - left) / 0.23, abs=1e-12)


def test_a_robot_with_a_fast_wheel_drives_a_curve_and_is_paid_for_its_command():
    error = Randomization(wheel_speed_error=(0.04, 0.04))
    subject, plain = simulator(1, randomization=error), simulator(1, randomization=None)
    begun = subject.reset(paths=[Path(0, 0)]).pose[0].astype(float)
    plain.reset(paths=[Path(0, 0)])
    moved, usual = subject.step(np.array([1])), plain.step(np.array([1]))
    np.testing.assert_allclose(moved.pose[0], follow_arc(begun, np.array([0.416, 0.0]), 0.2), atol=1e-6)
    assert moved.reward[0] == pytest.approx(usual.reward[0], abs=2e-3)
    np.testing.assert_array_equal(subject.commands, plain.commands)


# ---- states and mistakes


def test_a_randomised_run_resumes_from_its_state_bit_for_bit():
    original = simulator(seed=2)
    rollout(original, 12)
    resumed = simulator(seed=77)
    resumed.load_state_dict(pickle.loads(pickle.dumps(original.state_dict())))
    np.testing.assert_array_equal(resumed.ideal_depth, original.ideal_depth)
    for actions in np.random.default_rng(2).integers(NUM_ACTIONS, size=(40, 4)):
        one, other = original.step(actions), resumed.step(actions)
        ended = one.terminated | one.truncated
        for got, expected in zip((*other, *resumed.reset(ended)), (*one, *original.reset(ended)), strict=True):
            assert got.tobytes() == expected.tobytes()


def test_ranges_may_be_lists():
    assert Randomization(noise_level=[1.0, 1.0], latency=[0, 2]) == Randomization(latency=(0, 2))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"camera_height": (0.1, 0.0)}, "randomization camera_height must be two finite numbers, least and greatest"),
        ({"camera_left": (math.nan, 0.0)}, "randomization camera_left must be two finite numbers"),
        ({"camera_left": (0.1,)}, "randomization camera_left must be two finite numbers"),
        ({"camera_left": 0.1}, "randomization camera_left must be two finite numbers"),
        ({"latency": (0, 1.5)}, "randomization latency must be two whole numbers of steps"),
        ({"latency": (-1, 2)}, "randomization latency must be two whole numbers of steps"),
        ({"noise_level": (-0.5, 1.0)}, "randomization noise_level must not be negative"),
        ({"start_distance": (-0.5, 1.0)}, "randomization start_distance must not be negative"),
        ({"wheel_speed_error": (-1.0, 0.0)}, "randomization wheel_speed_error must be above -1"),
    ],
)
def test_impossible_ranges_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Randomization(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"camera_pitch_deg": (0.0, 30.0)}, "go too far: the camera sees the floor .* nearer than"),
        ({"camera_height": (-0.2, 0.0)}, "go too far: the camera sees the floor"),
        ({"camera_height": (-0.3, 0.0)}, "go too far: camera mount_z must be above the floor"),
        ({"camera_pitch_deg": (-80.0, 0.0)}, "go too far: camera pitch_deg must leave every pixel's view ahead"),
        ({"noise_level": (0.0, 2.0)}, "changes nothing without noise"),
    ],
)
def test_ranges_that_do_not_suit_the_camera_or_the_sensor_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        simulator(randomization=Randomization(**settings), sensor=SensorModel())
