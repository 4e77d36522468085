"""Policies to compare with: random, straight at the goal, a reactive controller, and the planning oracle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from navsim.camera import DepthCamera
from navsim.oracle import Oracle
from navsim.robot import ACTIONS, NUM_ACTIONS, TURTLEBOT2, Robot, apply_actions, wrap_angle
from navsim.scan import clear_height, obstacle_depth, scan_points
from navsim.sensor import SensorModel
from navsim.task import Task
from navsim.world import World

_SPEEDS = np.array([action.linear or np.nan for action in ACTIONS])  # m/s that each action commands
_TURNS = np.array([np.nan if action.angular is None else action.angular for action in ACTIONS])  # rad/s
_SLOW, _FAST = int(np.nanargmin(_SPEEDS)), int(np.nanargmax(_SPEEDS))
_FAR = 1e3  # metres, where nothing is seen
_LEFT, _RIGHT = int(np.nanargmax(_TURNS)), int(np.nanargmin(_TURNS))


class RandomPolicy(TensorDictModuleBase):
    """One of the seven actions, evenly, whatever is seen; drawn from torch's generator."""

    name = "random"
    in_keys = ("heading",)
    out_keys = ("action",)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``, ``(...)`` int64."""
        tensordict["action"] = torch.randint(NUM_ACTIONS, tensordict.batch_size, device=tensordict.device)
        return tensordict


class _Driver(TensorDictModuleBase):
    """A policy that wants a speed and a turn.

    An action changes only one of the two. Braking comes first, then turning, then speeding up.
    """

    in_keys = ("depth", "heading", "command")
    out_keys = ("action",)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` ``(...)`` int64."""
        flat = tensordict.select(*self.in_keys, "direction", "is_init", strict=False).reshape(-1)
        headings = flat["heading"].squeeze(-1).cpu().numpy().astype(np.float64)
        commands = _exact(flat["command"].cpu().numpy())
        speed_actions, turn_actions = self._wanted(flat, headings, commands)
        _write(flat, "action", _one_of(commands, speed_actions, turn_actions))
        return tensordict.update(flat.select("action", "direction", strict=False).reshape(tensordict.batch_size))

    def _wanted(
        self, tensordict: TensorDictBase, headings: np.ndarray, commands: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The actions, both ``(N,)``, that command the wanted speeds and the wanted turns."""
        raise NotImplementedError


def _exact(commands: np.ndarray) -> np.ndarray:
    """``(N, 2)`` float64, the commands that float32 ones are: they are compared with those of actions."""
    axes = []
    for column, values in zip(commands.T, (_SPEEDS, _TURNS), strict=True):
        known = values[~np.isnan(values)]
        axes.append(known[np.abs(known - column[:, None]).argmin(axis=1)])
    return np.stack(axes, axis=1)


def _remembered(tensordict: TensorDictBase, key: str, initial: np.ndarray) -> np.ndarray:
    """What a policy wrote in the step before; at the beginning of an episode, and without memory, what is initial.

    ``is_init`` ``(N, 1)``, as TorchRL's ``InitTracker`` writes it, tells where an episode begins.
    """
    value = tensordict.get(key, None)
    if value is None:
        return initial
    memory = value.cpu().numpy()
    is_init = tensordict.get("is_init", None)
    if is_init is None:
        return memory
    begins = is_init.reshape(-1).cpu().numpy()
    return np.where(begins.reshape(-1, *[1] * (memory.ndim - 1)), initial, memory)


def _write(tensordict: TensorDictBase, key: str, value: np.ndarray) -> None:
    tensordict[key] = torch.from_numpy(value).to(tensordict["heading"].device)


def _one_of(commands: np.ndarray, speed_actions: np.ndarray, turn_actions: np.ndarray) -> np.ndarray:
    """``(N,)`` of two actions each, the one to take first from commands ``(N, 2)``."""
    speeds, turns = _SPEEDS[speed_actions], _TURNS[turn_actions]
    brakes = speeds < commands[:, 0]
    speeds_up = (speeds > commands[:, 0]) & (turns == commands[:, 1])
    return np.where(brakes | speeds_up, speed_actions, turn_actions)


def _turn_actions(rates: np.ndarray) -> np.ndarray:
    """``(N,)`` the actions whose turns are nearest to ``rates`` (N,), rad/s."""
    return np.nanargmin(np.abs(_TURNS - rates[:, None]), axis=1)


class StraightPolicy(_Driver):
    """Turns to the goal and drives at it, whatever stands in the way."""

    name = "straight"

    def _wanted(
        self, tensordict: TensorDictBase, headings: np.ndarray, commands: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return np.where(np.abs(headings) < np.pi / 4, _FAST, _SLOW), _turn_actions(headings)


class ReactivePolicy(_Driver):
    """Follows the gap in the newest depth image that costs least, in the manner of a vector field histogram.

    The image becomes a scan: the nearest thing in each column that is neither floor nor out of reach above. In each of
    55 directions a corridor as wide as the robot is followed until it meets the scan. A direction costs its angles to
    the goal, to straight ahead and to the direction chosen last, so that it does not waver, and it costs more the
    sooner its corridor ends. (Borenstein and Koren 1991, Ulrich and Borenstein 1998, without their map of what was
    seen before: like the networks, it forgets. Unlike them it sees one image only.) The robot cannot stop: when
    something comes near the depth that counts as a collision, it turns away from it as hard as it can.

    Its constants were tuned in ``complex_train`` and in rooms with its obstacles shuffled, never in evaluation rooms.

    Args:
        camera: whose images they are; by default the Kinect, at whatever size the images have.
        robot: that drives.
        lossy: whether its sensor loses returns, so that a pixel without one is no obstacle.
    """

    name = "reactive"

    _LOOK_AHEAD = 0.4
    """Seconds: distances are judged from where the robot will be by then, as actions come in one at a time."""
    _SPARE = 0.0945
    """Metres on either side of the robot in a corridor."""
    _FREE = 0.5
    """Corridors that stay free this far are as good as endless, metres."""
    _NEEDED = 0.6
    """A direction whose corridor ends sooner is for emergencies, metres."""
    _FAST = 0.3
    """Free way ahead at which the robot goes fast, metres."""
    _NEAR = 0.55
    """Planar depth at which it turns away from whatever is there, metres."""
    _AHEAD_WEIGHT = 0.4
    """Cost of the angle to straight ahead; that of the angle to the goal is 1."""
    _LAST_WEIGHT = 0.6
    """Cost of the angle to the direction chosen last."""
    _BLOCKED_WEIGHT = 5.0
    """Cost, in radians, of a corridor that ends at once; it falls to 0 over ``_FREE``."""
    _EMERGENCY_WEIGHT = 9.0
    """Cost, in radians, of a corridor shorter than ``_NEEDED``."""
    _GAIN = 0.8
    """Turn rate for each radian to the chosen direction, 1/s."""
    _SHARP = 1.2
    """Angle to the chosen direction beyond which it goes slowly, radians."""

    _DIRECTIONS = np.deg2rad(np.arange(-135.0, 136.0, 5.0))

    def __init__(self, camera: DepthCamera | None = None, *, robot: Robot = TURTLEBOT2, lossy: bool = False) -> None:
        super().__init__()
        self._camera, self._lossy = camera, lossy
        self._clear_height, self._half_width = clear_height(robot), robot.radius + self._SPARE

    def _wanted(
        self, tensordict: TensorDictBase, headings: np.ndarray, commands: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        images = tensordict["depth"][:, -1].cpu().numpy()
        camera = self._camera or replace(DepthCamera(), height=images.shape[1], width=images.shape[2])
        if images.shape[1:] != (camera.height, camera.width):
            raise ValueError(
                f"the reactive policy is for images of {camera.width}x{camera.height} pixels; it got "
                f"{images.shape[2]}x{images.shape[1]}: give make_baseline the camera that they come from"
            )
        last = _remembered(tensordict, "direction", headings)
        scan = obstacle_depth(images, camera, high=self._clear_height, lossy=self._lossy)
        free = self._free_distances(scan, camera, commands)
        directions, free_there = self._choose(free, headings, last)

        nearer, half = scan - (self._LOOK_AHEAD * commands[:, 0])[:, None], (camera.width + 1) // 2
        left, right = nearer[:, :half].min(axis=1), nearer[:, -half:].min(axis=1)  # of an odd width, the middle in both
        evades = np.minimum(left, right) < self._NEAR
        side = np.where(left == right, directions, left - right)
        side = np.where(side < 0.0, -1.0, 1.0)
        turns = np.where(evades, np.where(side > 0, _LEFT, _RIGHT), _turn_actions(self._GAIN * directions))
        # What it evades, it goes on to evade: a direction on the other side is forgotten.
        directions = np.where(evades & (np.sign(directions) != side), side * np.pi / 6, directions)
        free_ahead = free[:, len(self._DIRECTIONS) // 2]
        fast = ~evades & (np.minimum(free_ahead, free_there) > self._FAST) & (np.abs(directions) < self._SHARP)
        speeds = np.where(fast, _FAST, _SLOW)

        turned = apply_actions(commands, _one_of(commands, speeds, turns))[:, 1] * Task.control_period
        _write(tensordict, "direction", wrap_angle(directions - turned))
        return speeds, turns

    def _free_distances(self, scan: np.ndarray, camera: DepthCamera, commands: np.ndarray) -> np.ndarray:
        """``(N, D)`` metres that a corridor in each direction is free, from the robot's rim."""
        points = np.where((scan < camera.max_range)[..., None], scan_points(scan, camera), _FAR).astype(np.float32)
        points[..., 0] -= (self._LOOK_AHEAD * commands[:, 0])[:, None]
        forward = np.stack([np.cos(self._DIRECTIONS), np.sin(self._DIRECTIONS)]).astype(np.float32)
        leftward = np.stack([-forward[1], forward[0]])
        along, across = points @ forward, points @ leftward  # (N, W, D)
        met = (along > 0.0) & (np.abs(across) < self._half_width)
        return np.where(met, along, _FAR).min(axis=1) - self._half_width

    def _choose(self, free: np.ndarray, headings: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The directions that cost least, ``(N,)`` radians, and the free distances there, ``(N,)`` metres."""

        def angles_to(others: np.ndarray) -> np.ndarray:
            return np.abs(wrap_angle(self._DIRECTIONS - others[:, None]))

        costs = (
            angles_to(headings)
            + self._LAST_WEIGHT * angles_to(last)
            + self._AHEAD_WEIGHT * np.abs(self._DIRECTIONS)
            + self._BLOCKED_WEIGHT * (1.0 - np.clip(free / self._FREE, 0.0, 1.0))
            + self._EMERGENCY_WEIGHT * (free < self._NEEDED)
        )
        best = costs.argmin(axis=1)
        return self._DIRECTIONS[best], np.take_along_axis(free, best[:, None], axis=1)[:, 0]


class OraclePolicy:
    """The planning oracle: it knows the map, and shows what the rules allow. See ``navsim.oracle``."""

    name = "oracle"

    def plan(
        self,
        world: World,
        starts: np.ndarray,
        goals: np.ndarray,
        camera: DepthCamera,
        task: Task,
        robot: Robot,
        phases: np.ndarray,
    ) -> Iterator[np.ndarray | None]:
        """For each start pose ``(P, 3)`` and goal ``(P, 2)`` the actions, ``(K,)``, or None where it found no way.

        It also knows where what moves will be, from ``phases`` ``(P, D)``.
        """
        oracle = Oracle(world, camera, task, robot)
        for start, goal, own in zip(starts, goals, phases, strict=True):
            yield oracle.plan(start, goal, own)


Baseline = RandomPolicy | StraightPolicy | ReactivePolicy | OraclePolicy

_MAKERS: dict[str, Callable[[DepthCamera | None, SensorModel, Robot], Baseline]] = {
    "random": lambda camera, sensor, robot: RandomPolicy(),
    "straight": lambda camera, sensor, robot: StraightPolicy(),
    "reactive": lambda camera, sensor, robot: ReactivePolicy(camera, robot=robot, lossy=sensor.loses_returns),
    "oracle": lambda camera, sensor, robot: OraclePolicy(),
}

BASELINES = tuple(_MAKERS)
"""Names that :func:`make_baseline` knows."""


def make_baseline(
    name: str, camera: DepthCamera | None = None, sensor: SensorModel | None = None, robot: Robot = TURTLEBOT2
) -> Baseline:
    """A policy to compare with, to be evaluated with ``rl.evaluate``.

    All but the oracle are TensorDictModules, which work in TorchRL's collectors as well.

    Args:
        name: one of ``BASELINES``.
        camera: whose images it will see; by default the Kinect, at whatever size the images have.
        sensor: what it will see them through; by default an ideal one.
        robot: that it will drive.

    Raises:
        ValueError: for another name.
    """
    if name not in _MAKERS:
        raise ValueError(f'there is no baseline "{name}"; there are {", ".join(BASELINES)}')
    return _MAKERS[name](camera, sensor or SensorModel(), robot)
