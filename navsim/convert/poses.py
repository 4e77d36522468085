"""Rigid motions in space as 4x4 matrices, and the names by which an SDF file refers to them.

The semantics are those of SDFormat 1.7 and later, to which older files are a subset: a pose is relative to the frame
that ``relative_to`` (once ``frame``) names in the scope of its model, or else to its parent.
http://sdformat.org/tutorials?tut=pose_frame_semantics
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from navsim.convert.xmlfile import Element

_OWN = "__model__"


def pose_matrix(element: Element | None) -> np.ndarray:
    """``(4, 4)``: what a ``<pose>`` says, metres; the identity for none.

    Raises:
        ConversionError: for anything but six numbers (or seven, of which four are a quaternion).
    """
    matrix = np.eye(4)
    if element is None or not element.text.strip():
        return matrix
    style = element.attributes.get("rotation_format", "euler_rpy")
    if style == "quat_xyzw":
        x, y, z, *quaternion = element.numbers(7)
        norm = math.sqrt(sum(q * q for q in quaternion))
        if norm < 1e-6:
            raise element.error("<pose> holds a quaternion of length 0; write '0 0 0 1' for no rotation")
        matrix[:3, :3] = _from_quaternion(*(q / norm for q in quaternion))
    elif style == "euler_rpy":
        x, y, z, *angles = element.numbers(6)
        if element.truth(element.attributes.get("degrees", "false")):
            angles = [math.radians(angle) for angle in angles]
        matrix[:3, :3] = _from_angles(*angles)
    else:
        raise element.error(f"<pose> has the rotation format '{style}'; the known ones are euler_rpy and quat_xyzw")
    matrix[:3, 3] = x, y, z
    return matrix


def _from_angles(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """About the fixed axes x, y and z, in this order, radians."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def _from_quaternion(x: float, y: float, z: float, w: float) -> np.ndarray:
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def inverse(pose: np.ndarray) -> np.ndarray:
    """The rigid motion that undoes ``pose`` ``(4, 4)``."""
    undone = np.eye(4)
    undone[:3, :3] = pose[:3, :3].T
    undone[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return undone


@dataclass
class _Frame:
    pose: Element | None
    default: str
    """The frame that the pose is relative to when it does not say."""
    origin: Element
    """Where the frame is declared, for errors."""


@dataclass
class Scope:
    """The frames that can be named inside a world or a model; poses are told relative to the scope's own origin."""

    label: str
    outermost: bool = False
    """Whether its origin is the world's."""
    frames: dict[str, _Frame] = field(default_factory=dict)
    models: dict[str, tuple[Scope, _Frame, str]] = field(default_factory=dict)
    """Nested models, each with its pose and the frame of it that is placed there (its own origin: empty)."""
    merged: list[tuple[Scope, _Frame, str]] = field(default_factory=list)
    """Included models whose content counts as this model's own."""
    _open: set[str] = field(default_factory=set)
    _twins: Counter[str] = field(default_factory=Counter)
    _known: dict[str, np.ndarray] = field(default_factory=dict)

    def declare(self, element: Element, default: str = _OWN) -> None:
        """A link, joint or frame.

        Before version 1.7 they might share a name. As in libsdformat, joint or frame then get another one.
        """
        name = element.name
        while name in self.frames:
            name += f"_{element.tag}"
        self.frames[name] = _Frame(element.first("pose"), default, element)

    def free_label(self, name: str) -> str:
        """``name``, or for one that a nested model has already, one that none has."""
        label = name
        while label in self.models:
            self._twins[name] += 1
            label = f"{name}'{self._twins[name]}"
        return label

    def pose(self, element: Element | None, default: str = _OWN, origin: Element | None = None) -> np.ndarray:
        """``(4, 4)``: what a ``<pose>`` says, relative to the scope's origin.

        Raises:
            ConversionError: for a frame that does not exist, or that hangs on itself.
        """
        name = default
        if element is not None:
            name = element.attributes.get("relative_to") or element.attributes.get("frame") or default
        place = element or origin
        return self.find(name, place) @ pose_matrix(element)

    def find(self, name: str, place: Element | None) -> np.ndarray:
        """``(4, 4)``: a named frame, relative to the scope's origin."""
        if name in (_OWN, "") or (name == "world" and self.outermost):
            return np.eye(4)
        if name == "world":
            message = f"what is inside model '{self.label}' cannot be relative to the world; name a frame of the model"
            raise place.error(message) if place else ValueError(message)
        if name in self._known:
            return self._known[name]
        if name in self._open:
            message = f"the pose of '{name}' is relative to itself, by way of others; break the circle"
            raise place.error(message) if place else ValueError(message)
        self._open.add(name)
        try:
            found = self._found(name, place)
        finally:
            self._open.discard(name)
        if found is None:
            known = ", ".join(sorted([*self.frames, *self.models])[:8]) or "none"
            message = f"there is no frame '{name}' in {self.label}; it has {known}"
            raise place.error(message) if place else ValueError(message)
        self._known[name] = found
        return found

    def _found(self, name: str, place: Element | None) -> np.ndarray | None:
        if name in self.frames:
            frame = self.frames[name]
            return self.pose(frame.pose, frame.default, frame.origin)
        head, _, rest = name.partition("::")
        if head in self.models:
            scope = self.models[head][0]
            model = self.placed(*self.models[head])
            return model @ scope.find(rest, place) if rest else model
        for scope, frame, placement in self.merged:
            if head in scope.frames or head in scope.models:
                return self.placed(scope, frame, placement) @ scope.find(name, place)
        return None

    def placed(self, scope: Scope, frame: _Frame, placement: str) -> np.ndarray:
        """``(4, 4)``: where a nested model's origin is, relative to this scope's."""
        return self.pose(frame.pose, _OWN, frame.origin) @ inverse(scope.find(placement, frame.origin))


def frame_of(pose: Element | None, origin: Element) -> _Frame:
    """A frame whose pose is relative to its scope's origin, unless it says otherwise."""
    return _Frame(pose, _OWN, origin)
