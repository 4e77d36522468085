"""Settings of another kind than they are declared to be are refused, whatever they look like."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.robot import Robot
from navsim.sensor import SensorModel
from navsim.settings import is_of_kind
from navsim.simulator import Simulator
from navsim.task import Task
from navsim.worldfile import load_world


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DepthCamera(mount_z="0.3"), "camera mount_z must be a number; got '0.3'"),
        (lambda: DepthCamera(pitch_deg=None), "camera pitch_deg must be a number; got None"),
        (lambda: Robot(radius="0.2"), "robot radius must be a number; got '0.2'"),
        (lambda: Task(control_period="0.2"), "task control_period must be a number; got '0.2'"),
        (lambda: Task(goal_radius=True), "task goal_radius must be a number; got True"),
        (lambda: Task(max_steps=1.5), "task max_steps must be a whole number; got 1.5"),
        (lambda: SensorModel(axial_noise="1"), "sensor axial_noise must be a number; got '1'"),
        (lambda: SensorModel(shadows="no"), "sensor shadows must be true or false; got 'no'"),
        (
            lambda: Randomization(camera_height=("a", "b")),
            "randomization camera_height must be two finite numbers, least and greatest; got ('a', 'b')",
        ),
        (
            lambda: Randomization(latency=(0, 10**9)),
            "randomization latency must be two whole numbers of steps, up to 100; got (0, 1000000000)",
        ),
        (
            lambda: Simulator(load_world("simple_eval"), 1.5),
            "a simulator needs a whole number of robots, at least one; got num_robots = 1.5",
        ),
        (
            lambda: Simulator(load_world("simple_eval"), True),
            "a simulator needs a whole number of robots, at least one; got num_robots = True",
        ),
        (lambda: Simulator(load_world("simple_eval"), seed=-1), "a seed must be a whole number, at least 0; got -1"),
        (
            lambda: Simulator(load_world("simple_eval")).load_state_dict({}),
            "this is no state of a simulator: it has no 'steps'",
        ),
    ],
)
def test_another_kind_is_refused_in_one_sentence(make, message):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the whole sentence is compared below
        make()
    assert str(refused.value) == message


def test_numbers_of_numpy_are_numbers():
    assert DepthCamera(width=np.int32(40), mount_z=np.float32(0.5)).width == 40
    assert SensorModel(shadows=np.bool_(True), axial_noise=1).shadows
    assert Randomization(camera_height=np.array([0.0, 0.1], dtype=np.float32)).camera_height[1] > 0.0
    assert is_of_kind("float", np.float16(1.0))
    assert is_of_kind("int", np.int64(1))
    assert not is_of_kind("int", np.float64(1.0))
    assert not is_of_kind("float", np.bool_(True))
