"""What a robot remembers of what stood around it: what its own depth images showed, where its wheels have taken it.

The camera sees 60°. Half of the collisions of a trained network are with things that it has driven past, and turned
into one to three seconds after they had left its last four images. A robot that knows its odometry can do what every
navigation stack does, and keep what it has seen in a small map around itself: here, the distance of the nearest thing
in each of 36 directions, as the last six seconds of images showed it. It is a memory of the robot's own images, no map
of the room, and nothing is known of directions that it has not looked into.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from navsim.camera import DepthCamera
from navsim.robot import TURTLEBOT2, Robot
from navsim.scan import clear_height, obstacle_depth, scan_points

SECTORS = 36
"""Directions that are told apart; the first begins behind the robot, and they go on counterclockwise."""
REACH = 2.0
"""Metres; what is farther away counts as free."""
STEPS = 30
"""Images that are remembered, one a step of 0.2 s."""


class Surroundings:
    """The memories of N robots.

    Odometry is exact here, as it is over a few seconds on a robot: places are relative to the robot's present pose.
    What moves is remembered where it was last seen.

    Args:
        num_robots: N.
        camera: whose images are remembered.
        robot: whose way what is seen may be in; it passes below the rest.
        lossy: whether its sensor loses returns, so that a pixel without one is no obstacle.

    >>> memory = Surroundings(1, DepthCamera(width=1, height=1))
    >>> pose = np.zeros((1, 3))
    >>> memory.begin(np.array([[[1.087]]]), pose)  # one metre ahead of the robot's centre
    >>> memory.nearest(pose)[0, 17:19].round(3).tolist(), memory.nearest(pose)[0].argmin()
    ([2.0, 1.0], np.int64(18))
    >>> behind = np.array([[1.5, 0.0, 0.0]])  # it has driven through: the thing is half a metre behind
    >>> memory.nearest(behind)[0].argmin(), round(float(memory.nearest(behind).min()), 3)
    (np.int64(0), 0.5)
    """

    def __init__(self, num_robots: int, camera: DepthCamera, *, robot: Robot = TURTLEBOT2, lossy: bool = False) -> None:
        self._camera, self._robot, self._lossy = camera, robot, lossy
        self._columns = _remembered_columns(camera.width)
        self._points = np.full((num_robots, STEPS, len(self._columns), 2), np.inf, dtype=np.float32)
        self._latest = 0

    def begin(self, depth: np.ndarray, poses: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Forgets what was before an episode, and looks.

        Args:
            depth: ``(N, H, W)`` as the networks get it.
            poses: ``(N, 3)`` x, y, yaw, where the images were taken.
            mask: ``(N,)`` bool, the robots whose episode begins; all by default.
        """
        begun = slice(None) if mask is None else np.flatnonzero(mask)
        self._points[begun] = np.inf
        self._points[begun, self._latest] = self._places(depth[begun], poses[begun])

    def see(self, depth: np.ndarray, poses: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Adds what robots see after a step, and forgets their oldest image.

        Args:
            depth: ``(N, H, W)`` as the networks get it.
            poses: ``(N, 3)`` x, y, yaw, where the images were taken.
            mask: ``(N,)`` bool, the robots that made a step; all by default. The others' memories stay as they are.
        """
        self._latest = (self._latest + 1) % STEPS
        if mask is None:
            self._points[:, self._latest] = self._places(depth, poses)
            return
        self._points[~mask] = np.roll(self._points[~mask], 1, axis=1)  # as old as they were, counted from the latest
        self._points[mask, self._latest] = self._places(depth[mask], poses[mask])

    def nearest(self, poses: np.ndarray) -> np.ndarray:
        """``(N, SECTORS)`` float32, metres from the robots' centres to what they remember, at most ``REACH``."""
        away = (self._points - poses[:, None, None, :2].astype(np.float32)).reshape(-1, 2)
        squared = np.square(away[:, 0]) + np.square(away[:, 1])
        near = np.flatnonzero(squared < REACH**2)
        robot = near // (self._points.shape[1] * self._points.shape[2])
        direction = np.arctan2(away[near, 1], away[near, 0]) - poses[robot, 2].astype(np.float32)
        sector = np.floor(direction * np.float32(SECTORS / (2.0 * np.pi)) + SECTORS // 2).astype(np.intp) % SECTORS
        nearest = np.full(len(poses) * SECTORS, REACH**2, dtype=np.float32)
        np.minimum.at(nearest, robot * SECTORS + sector, squared[near])
        return np.sqrt(nearest).reshape(-1, SECTORS)

    def _places(self, depth: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """``(N, columns, 2)`` float32, where columns of images see something; infinitely far where they do not."""
        ahead = obstacle_depth(depth, self._camera, high=clear_height(self._robot), lossy=self._lossy)
        # What is too near to be measured is somewhere ahead of the camera, not in it: at most this far.
        ahead = np.where(ahead == 0.0, np.float32(max(self._camera.blind_zone, self._camera.min_range)), ahead)
        x, y = np.moveaxis(scan_points(ahead, self._camera)[:, self._columns], -1, 0)
        cosine, sine = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
        places = np.stack([poses[:, 0:1] + cosine * x - sine * y, poses[:, 1:2] + sine * x + cosine * y], axis=-1)
        places[ahead[:, self._columns] >= self._camera.max_range] = np.inf
        return places.astype(np.float32)

    def take(self, kept: np.ndarray) -> Surroundings:
        """The memories of those robots alone that ``kept`` ``(N,)`` bool names."""
        smaller = Surroundings(0, self._camera, robot=self._robot, lossy=self._lossy)
        smaller._points, smaller._latest = self._points[kept], self._latest
        return smaller

    def state_dict(self) -> dict[str, Any]:
        """Everything to go on from."""
        return {"points": self._points.copy(), "latest": self._latest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from ``state_dict``."""
        self._points, self._latest = np.array(state_dict["points"], dtype=np.float32), int(state_dict["latest"])


def _remembered_columns(width: int) -> np.ndarray:
    """Every other column from the sides inwards: of a mirrored image, they are the mirrored ones."""
    from_side = np.arange(0, (width + 1) // 2, 2)
    return np.union1d(from_side, width - 1 - from_side)


def remembered_at_end(
    images: np.ndarray, poses: np.ndarray, camera: DepthCamera, robot: Robot = TURTLEBOT2
) -> np.ndarray:
    """``(1, SECTORS)`` float32, what a robot remembers at the end of a drive; see ``Surroundings``.

    Args:
        images: ``(K, H, W)`` uint8, from the episode's first on.
        poses: ``(K, 3)``, where they were taken.
        camera: whose they are.
        robot: that drives.
    """
    memory = Surroundings(1, camera, robot=robot)
    memory.begin(images[:1], poses[:1])
    for step in range(1, len(poses)):
        memory.see(images[step : step + 1], poses[step : step + 1])
    return memory.nearest(poses[-1:])
