"""The robot: a differential-drive disc, the TurtleBot 2's numbers, and the seven actions that drive it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navsim.settings import check_kinds


@dataclass(frozen=True)
class Robot:
    """A differential-drive robot with a round base; the defaults are a TurtleBot 2 on a Kobuki base."""

    radius: float = 0.1755
    """Radius of the base, metres (Kobuki: 351.5 mm across)."""
    height: float = 0.42
    """Height of the topmost plate above the floor, metres (TurtleBot 2 data sheet)."""
    mass: float = 6.3
    """Mass, kilograms (TurtleBot 2 data sheet)."""
    max_linear_speed: float = 0.65
    """Greatest forward speed, metres per second (TurtleBot 2 data sheet)."""
    max_angular_speed: float = math.pi
    """Greatest turning speed, radians per second (Kobuki: 180 degrees per second)."""
    linear_acceleration: float | None = None
    """Greatest change of the forward speed, m/s²; None reaches any command within one physics substep."""
    angular_acceleration: float | None = None
    """Greatest change of the turning speed, rad/s²; None reaches any command within one physics substep."""

    def __post_init__(self) -> None:
        check_kinds(self, "robot")
        for name in ("radius", "height", "mass", "max_linear_speed", "max_angular_speed"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"robot {name} must be a positive finite number; got {value!r}")
        for name in ("linear_acceleration", "angular_acceleration"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"robot {name} must be positive and finite, or None for no limit; got {value!r}")


TURTLEBOT2 = Robot()
"""The robot of the thesis."""


class Action(NamedTuple):
    """One discrete action: a new linear *or* angular command; None leaves that command as it was."""

    linear: float | None
    """m/s"""
    angular: float | None
    """rad/s, positive to the left"""


WHEEL_SEPARATION = 0.23
"""Distance between the Kobuki's two driven wheels, metres (Kobuki user guide: wheelbase 230 mm)."""

ACTIONS: tuple[Action, ...] = (
    Action(0.2, None),
    Action(0.4, None),
    Action(None, math.pi / 4),
    Action(None, math.pi / 8),
    Action(None, 0.0),
    Action(None, -math.pi / 8),
    Action(None, -math.pi / 4),
)
"""The thesis's seven actions (its section 4.2): two speeds, then five turns from left to right."""

NUM_ACTIONS = len(ACTIONS)

INITIAL_COMMAND = (0.2, 0.0)
"""The command, m/s and rad/s, with which an episode begins."""

MIRRORED_ACTIONS = (0, 1, 6, 5, 4, 3, 2)
"""``MIRRORED_ACTIONS[a]`` does in the mirror image (left and right swapped) what action ``a`` does."""

_VALUES = np.array([[action.linear or 0.0, action.angular or 0.0] for action in ACTIONS])
_CHANGES = np.array([[action.linear is not None, action.angular is not None] for action in ACTIONS])


def apply_actions(commands: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """The commands after one action each.

    Args:
        commands: ``(N, 2)`` linear (m/s) and angular (rad/s) commands in force.
        actions: ``(N,)`` integers, indices into ``ACTIONS``.

    Returns:
        ``(N, 2)`` float64, a new array.

    >>> apply_actions(np.array([[0.2, 0.0], [0.2, 0.0]]), np.array([1, 2])).round(3).tolist()
    [[0.4, 0.0], [0.2, 0.785]]
    """
    return np.where(_CHANGES[actions], _VALUES[actions], commands)


def with_wheel_errors(commands: np.ndarray, errors: np.ndarray, separation: float = WHEEL_SEPARATION) -> np.ndarray:
    """What a robot does whose two wheels each turn a share faster or slower than they are told.

    Wheels at v - ω s/2 (left) and v + ω s/2 (right) for a separation s carry the robot at the mean of both, and turn it
    at their difference over s.

    Args:
        commands: ``(N, 2)`` linear (m/s) and angular (rad/s) commands.
        errors: ``(N, 2)`` shares, of the left and of the right wheel; 0 gives the command bit for bit.
        separation: of the wheels, metres.

    Returns:
        ``(N, 2)`` linear (m/s) and angular (rad/s) speeds.

    >>> with_wheel_errors(np.array([[0.4, 0.0]]), np.array([[0.0, 0.05]])).round(4).tolist()  # the right one is fast
    [[0.41, 0.087]]
    """
    both, apart = 0.5 * (errors[:, 0] + errors[:, 1]), errors[:, 1] - errors[:, 0]
    linear, angular = commands[:, 0], commands[:, 1]
    return np.stack(
        [
            linear + both * linear + 0.25 * separation * apart * angular,
            angular + both * angular + apart * linear / separation,
        ],
        axis=1,
    )


def wrap_angle(angle: np.ndarray) -> np.ndarray:
    """Angles of any shape, radians, wrapped to (−π, π].

    >>> wrap_angle(np.array([-math.pi, 1.5 * math.pi])).round(4).tolist()
    [3.1416, -1.5708]
    """
    wrapped = angle - 2.0 * np.pi * np.ceil((angle - np.pi) / (2.0 * np.pi))
    return np.where(wrapped > -np.pi, np.minimum(wrapped, np.pi), np.pi)  # rounding may end just outside


def follow_arc(poses: np.ndarray, commands: np.ndarray, duration: float) -> np.ndarray:
    """Where robots end that hold one command each on a free floor: on a circle's arc, or a line, in closed form.

    The chord of an arc that turns by ``w·t`` points half that turn away from the heading and is
    ``v·t·sinc(w·t/2)`` long, which needs no special case for a straight line.

    Args:
        poses: ``(..., 3)`` x, y (metres) and yaw (radians).
        commands: ``(..., 2)`` linear (m/s) and angular (rad/s) speeds.
        duration: seconds.

    Returns:
        ``(..., 3)`` float64 poses, yaw in (−π, π].

    >>> follow_arc(np.array([0.0, 0.0, 0.0]), np.array([0.4, math.pi / 4]), 2.0).round(4).tolist()
    [0.5093, 0.5093, 1.5708]
    """
    turn = commands[..., 1] * duration
    length = commands[..., 0] * duration * np.sinc(turn / (2.0 * np.pi))
    direction = poses[..., 2] + 0.5 * turn
    return np.stack(
        [
            poses[..., 0] + length * np.cos(direction),
            poses[..., 1] + length * np.sin(direction),
            wrap_angle(poses[..., 2] + turn),
        ],
        axis=-1,
    )
