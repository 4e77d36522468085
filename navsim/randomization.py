"""Domain randomisation: what differs from one episode to the next, so that a policy learns to do without exactness.

Tobin et al., "Domain randomization for transferring deep neural networks from simulation to the real world", IROS 2017.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navsim.camera import DepthCamera
from navsim.sensor import LONGEST_LATENCY, SensorModel
from navsim.settings import is_of_kind
from navsim.task import Task


class Draw(NamedTuple):
    """What an episode got."""

    mount: tuple[float, float, float, float]
    """the camera's mount_x, mount_y and mount_z, metres, and its pitch, radians"""
    wheel_errors: tuple[float, float]
    """of the left and of the right wheel's speed, relative"""
    latency: int
    """steps, all in all"""
    noise_level: float
    """factor on the sensor's noise and losses"""


@dataclass(frozen=True)
class Randomization:
    """Ranges, least and greatest, from which every episode draws evenly; by default nothing differs.

    What is drawn comes on top of the camera's, the robot's and the sensor's own settings.
    """

    camera_height: tuple[float, float] = (0.0, 0.0)
    """Added to the height of the camera, metres."""
    camera_pitch_deg: tuple[float, float] = (0.0, 0.0)
    """Added to the camera's pitch, degrees; positive: it looks further down."""
    camera_forward: tuple[float, float] = (0.0, 0.0)
    """Added to where the camera sits ahead of the robot's centre, metres."""
    camera_left: tuple[float, float] = (0.0, 0.0)
    """Added to where the camera sits to the left of the robot's centre, metres."""
    wheel_speed_error: tuple[float, float] = (0.0, 0.0)
    """Share by which a wheel turns faster than it was told (negative: slower), drawn for each of the two."""
    latency: tuple[int, int] = (0, 0)
    """Added to the steps by which images are late."""
    noise_level: tuple[float, float] = (1.0, 1.0)
    """Factor on the sensor's axial and lateral noise and on its probabilities of loss."""
    start_distance: tuple[float, float] = (0.0, 0.0)
    """Distance from a listed start at which an episode begins instead, in any direction in which it can, metres."""
    start_turn_deg: tuple[float, float] = (0.0, 0.0)
    """Angle by which the robot is turned to the left at a listed start, degrees."""

    def __post_init__(self) -> None:
        for setting in dataclasses.fields(self):
            value = getattr(self, setting.name)
            if isinstance(value, list | np.ndarray):
                value = tuple(value)
                object.__setattr__(self, setting.name, value)
            if not (
                isinstance(value, tuple)
                and len(value) == 2
                and all(is_of_kind("float", bound) and math.isfinite(bound) for bound in value)
                and value[0] <= value[1]
            ):
                raise ValueError(
                    f"randomization {setting.name} must be two finite numbers, least and greatest; got {value!r}"
                )
        if not all(is_of_kind("int", steps) and 0 <= steps <= LONGEST_LATENCY for steps in self.latency):
            raise ValueError(
                f"randomization latency must be two whole numbers of steps, up to {LONGEST_LATENCY}; got "
                f"{self.latency!r}"
            )
        for name in ("noise_level", "start_distance"):
            if getattr(self, name)[0] < 0.0:
                raise ValueError(f"randomization {name} must not be negative; got {getattr(self, name)!r}")
        if self.wheel_speed_error[0] <= -1.0:
            raise ValueError(
                "randomization wheel_speed_error must be above -1, at which a wheel stands still; got "
                f"{self.wheel_speed_error!r}"
            )

    @property
    def moves_starts(self) -> bool:
        """Whether episodes begin elsewhere than at their listed starts."""
        return self.start_distance != (0.0, 0.0) or self.start_turn_deg != (0.0, 0.0)

    def check(self, camera: DepthCamera, task: Task, sensor: SensorModel) -> None:
        """Raises ValueError where something that may be drawn does not suit the camera, the task or the sensor."""
        lowest = camera.mount_z + self.camera_height[0]
        try:
            for pitch in self.camera_pitch_deg:
                tried = dataclasses.replace(camera, mount_z=lowest, pitch_deg=camera.pitch_deg + pitch)
                task.check_camera(tried)
        except ValueError as error:
            raise ValueError(
                f"randomization camera_height {self.camera_height} and camera_pitch_deg {self.camera_pitch_deg} go too "
                f"far: {error}"
            ) from error
        if self.noise_level != (1.0, 1.0) and not sensor.is_noisy:
            raise ValueError(
                f"randomization noise_level {self.noise_level} changes nothing without noise: set the sensor's, "
                "its axial_noise to 1 say"
            )

    def draw(self, generator: np.random.Generator, camera: DepthCamera, sensor: SensorModel) -> Draw:
        """What the next episode gets. A range that holds one number gives exactly that.

        Args:
            generator: the only source of chance.
            camera: what the camera's changes add to.
            sensor: what the latency adds to.
        """

        def of(limits: tuple[float, float]) -> float:
            return limits[0] + (limits[1] - limits[0]) * generator.random()

        mount = (
            camera.mount_x + of(self.camera_forward),
            camera.mount_y + of(self.camera_left),
            camera.mount_z + of(self.camera_height),
            math.radians(camera.pitch_deg + of(self.camera_pitch_deg)),
        )
        wheel_errors = of(self.wheel_speed_error), of(self.wheel_speed_error)
        least, greatest = self.latency
        latency = sensor.latency + least + int((greatest - least + 1) * generator.random())
        return Draw(mount, wheel_errors, latency, of(self.noise_level))

    def draw_offset(self, generator: np.random.Generator) -> np.ndarray:
        """``(3,)`` what to add to the x, y (metres) and yaw (radians) of a listed start."""
        least, greatest = self.start_distance
        distance = least + (greatest - least) * generator.random()
        direction = 2.0 * math.pi * generator.random()
        least, greatest = self.start_turn_deg
        turn = math.radians(least + (greatest - least) * generator.random())
        return np.array([distance * math.cos(direction), distance * math.sin(direction), turn])
