"""A trained policy at the wheel of one robot, of which there need be no simulator: images in, commands out."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import QValueActor

from navsim.camera import DepthCamera
from navsim.holes import fill_holes
from navsim.robot import INITIAL_COMMAND, apply_actions
from navsim.task import heading
from rl.config import TrainConfig
from rl.observation import history_length, stack_of
from rl.surroundings import Surroundings

_FARTHEST = 100.0
"""Metres: an image of which all is farther away than this, and than the camera sees, is not in metres."""


class Pilot:
    """Gives a robot's command for the next control period, 0.2 s, from what its camera and its odometry tell.

    It keeps what the policy needs besides: the last images, the command in force, and what stood around the robot. It
    neither stops nor reverses, and nothing in it keeps the robot from colliding: that is for the robot's own safety
    functions.

    Args:
        policy: as ``rl.load_policy`` returns it.
        fill: whether images in metres have their holes filled in (``navsim.fill_holes``); by default they have for a
            policy that was not trained with holes. Images in counts are taken as they are.

    Attributes:
        camera: the camera that the robot must have: its field of view, its place on the robot, its range.
        period: seconds from one call to the next.

    Raises:
        ValueError: for a policy that does not know how it was trained.

    >>> import rl
    >>> pilot = Pilot(rl.load_policy("pretrained:I"))
    >>> metres = np.full((64, 80), 3.0)
    >>> forward, turning = pilot.command(metres, pose=(0.0, 0.0, 0.0), goal=(3.0, 0.0))
    >>> forward in (0.2, 0.4), abs(turning) < 0.8
    (True, True)
    """

    def __init__(self, policy: QValueActor, *, fill: bool | None = None) -> None:
        config = getattr(policy, "trained_as", None)
        if not isinstance(config, TrainConfig):
            raise ValueError(
                "a Pilot needs a policy that knows how it was trained, as rl.load_policy returns it: its attribute "
                "trained_as says what camera and what inputs it is for"
            )
        self.camera: DepthCamera = config.camera
        self.period: float = config.task.control_period
        self._policy, self._config = policy, config
        self._fill = config.sensor.filled or not config.sensor.loses_returns if fill is None else fill
        self.begin()

    def begin(self) -> None:
        """Forgets all images: the next one is the first of a new drive, which begins at 0.2 m/s straight on."""
        self._command = np.array([INITIAL_COMMAND])
        self._images: torch.Tensor | None = None
        lossy = self._config.sensor.loses_returns
        self._memory = Surroundings(1, self.camera, robot=self._config.robot, lossy=lossy)
        self._origin: np.ndarray | None = None

    def command(
        self, depth: ArrayLike, pose: ArrayLike, goal: ArrayLike, image_pose: ArrayLike | None = None
    ) -> tuple[float, float]:
        """The speeds to drive with until the next call.

        Args:
            depth: ``(H, W)``, the newest image: metres, with NaN or 0 for no return and anything beyond the camera's
                range for free; or uint8 as ``DepthCamera.to_uint8`` makes it.
            pose: ``(3,)`` x, y (metres), yaw (radians) of the robot now, in any frame that stays, such as odometry's.
            goal: ``(2,)`` metres, in the same frame.
            image_pose: ``(3,)``, where the image was taken, if that is not here.

        Returns:
            Forward speed, m/s, and turning speed, rad/s, positive to the left.

        Raises:
            ValueError: for an image of another size or unit, and for what is no pose and no goal.
        """
        image = self._counts(np.asarray(depth))
        here, there = _numbers("pose", pose, 3), _numbers("goal", goal, 2)
        taken = here if image_pose is None else _numbers("image_pose", image_pose, 3)
        if self._origin is None:
            self._origin = here * [1.0, 1.0, 0.0]
        # What is remembered is in single precision, too little for the millions of metres of a map's frame.
        here, taken, there = here - self._origin, taken - self._origin, there - self._origin[:, :2]
        if self._images is None:
            self._images = torch.from_numpy(image).repeat(1, history_length(self._config.frame_interval), 1, 1)
            self._memory.begin(image[None], taken)
        else:
            self._images = torch.cat([self._images[:, 1:], torch.from_numpy(image)[None, None]], dim=1)
            self._memory.see(image[None], taken)
        seen = TensorDict(
            {
                "depth": stack_of(self._images),
                "heading": torch.from_numpy(heading(here, there).astype(np.float32)).unsqueeze(-1),
                "command": torch.from_numpy(self._command.astype(np.float32)),
                "surroundings": torch.from_numpy(self._memory.nearest(here)),
            },
            [1],
        )
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            action = self._policy(seen)["action"].numpy()
        self._command = apply_actions(self._command, action)
        return float(self._command[0, 0]), float(self._command[0, 1])

    def _counts(self, depth: np.ndarray) -> np.ndarray:
        wanted = (self.camera.height, self.camera.width)
        if depth.shape != wanted:
            raise ValueError(f"the policy is for depth images of shape {wanted}; got {depth.shape}: resize them")
        if depth.dtype == np.uint8:
            return depth.copy()  # torch takes neither a flipped nor a read-only one
        if not np.issubdtype(depth.dtype, np.floating):
            raise ValueError(
                f"a depth image is in metres, or uint8 counts; got {depth.dtype}: divide millimetres by 1000"
            )
        measured = depth[np.isfinite(depth) & (depth > 0.0)]
        if measured.size and measured.min() > max(_FARTHEST, self.camera.max_range):
            raise ValueError(
                f"a depth image is in metres, and in this one nothing is nearer than {measured.min():g}: divide "
                "millimetres by 1000"
            )
        return self.camera.to_uint8(fill_holes(depth, self.camera) if self._fill else depth.astype(np.float32))


def _numbers(name: str, values: ArrayLike, count: int) -> np.ndarray:
    """``(1, count)`` float64."""
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{name} must be {count} finite numbers; got {values!r}")
    return numbers[None]
