"""What robots' cameras may see of which prisms: pairs of both, in the cameras' level frames."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from navsim.camera import Mounts

NEAR = 1e-9
"""Edges are cut off this far in front of the camera's plane, metres: what lies nearer projects outside any image.

Polygons this close to the camera hold it; lines this close to it are seen edge-on, which is not at all."""


def expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 0, 3): owners (0, 0, 2, 2, 2) and positions within them (0, 1, 0, 1, 2)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - first[owner]


class Prisms(Protocol):
    """Prisms packed into arrays: P of them, with V vertices in all."""

    @property
    def base(self) -> np.ndarray:
        """``(P,)`` metres above the floor"""

    @property
    def top(self) -> np.ndarray:
        """``(P,)`` metres above the floor"""

    @property
    def radius(self) -> np.ndarray:
        """``(P,)`` metres; 0 for polygons"""

    @property
    def centre(self) -> np.ndarray:
        """``(P, 2)`` metres, the middle of the footprint"""

    @property
    def bounding_radius(self) -> np.ndarray:
        """``(P,)`` metres from there"""

    @property
    def vertices(self) -> np.ndarray:
        """``(V, 2)`` metres"""

    @property
    def first_vertex(self) -> np.ndarray:
        """``(P,)`` or more, intp"""

    @property
    def vertex_count(self) -> np.ndarray:
        """``(P,)`` intp"""


class Frames(NamedTuple):
    """The cameras' frames."""

    position: np.ndarray  # (N, 2), metres
    cosine: np.ndarray  # (N,), of the yaw
    sine: np.ndarray

    def ahead(self, distance: float) -> np.ndarray:
        """``(N, 2)``, the points so many metres ahead of the cameras."""
        return self.position + distance * np.stack([self.cosine, self.sine], axis=1)

    def forward_and_left(self, points: np.ndarray, robot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates ``(K,)`` of ``points`` ``(K, 2)`` in the frames of ``robot`` ``(K,)``, metres."""
        offset = points - self.position[robot]
        cosine, sine = self.cosine[robot], self.sine[robot]
        return offset[:, 0] * cosine + offset[:, 1] * sine, offset[:, 1] * cosine - offset[:, 0] * sine


def frames_of(poses: np.ndarray, mounts: Mounts) -> Frames:
    """Where the cameras of robots at ``poses`` are."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    position = np.empty((len(poses), 2))
    position[:, 0] = poses[:, 0] + cosine * mounts.x - sine * mounts.y
    position[:, 1] = poses[:, 1] + sine * mounts.x + cosine * mounts.y
    return Frames(position, cosine, sine)


class View(NamedTuple):
    """What may be in view: P pairs of a robot and a prism, which has Q polygons among its prisms with E corners in all.

    Lengths are metres in the frame of the robot's camera, level whatever the camera's pitch.
    """

    robot: np.ndarray  # (P,)
    base: np.ndarray  # (P,), over the camera
    top: np.ndarray
    radius: np.ndarray  # (P,); 0 for polygons
    forward: np.ndarray  # (P,), of the middle of the footprint
    left: np.ndarray
    corner_count: np.ndarray  # (Q,), of each pair that is a polygon
    ahead: np.ndarray  # (E,), corners, counter-clockwise within each polygon
    aside: np.ndarray

    @property
    def hangs(self) -> np.ndarray:
        """``(P,)`` bool, whether the prism ends below the camera or begins above it."""
        return (self.base > 0.0) | (self.top < 0.0)


def in_view(
    prisms: Prisms,
    robot: np.ndarray,
    prism: np.ndarray,
    frames: Frames,
    mounts: Mounts,
    depth: np.ndarray | float,
    spread: np.ndarray | float,
) -> View:
    """Those pairs of robots and prisms, ``(M,)`` each, of which something may be in view.

    Args:
        prisms: the arrays that ``prism`` counts in.
        robot, prism: the pairs.
        frames, mounts: of the robots' cameras.
        depth: how far ahead they see, metres; one or ``(N,)``.
        spread: greatest slope to the left or right that they see; one or ``(N,)``.
    """
    forward, left = frames.forward_and_left(prisms.centre[prism], robot)
    reach = prisms.bounding_radius[prism]
    if isinstance(depth, np.ndarray) and isinstance(spread, np.ndarray):
        depth, spread = depth[robot], spread[robot]
    # The sides of the view are planes through the camera: compare distances from them.
    beyond = forward * spread + reach * np.hypot(1.0, spread)
    seen = np.flatnonzero((forward > -reach) & (forward < depth + reach) & (np.abs(left) < beyond))
    robot, prism = robot[seen], prism[seen]
    radius, eye = prisms.radius[prism], mounts.z[robot]
    polygons = np.flatnonzero(radius == 0.0)
    count = prisms.vertex_count[prism[polygons]]
    local, vertex = expand(count)
    pair = polygons[local]
    corners = prisms.vertices[prisms.first_vertex[prism[pair]] + vertex]
    ahead, aside = frames.forward_and_left(corners, robot[pair])
    return View(
        robot,
        prisms.base[prism] - eye,
        prisms.top[prism] - eye,
        radius,
        forward[seen],
        left[seen],
        count,
        ahead,
        aside,
    )


class Edges(NamedTuple):
    """The E edges of polygons, each from its corner to the one that follows it."""

    pair: np.ndarray  # (E,), that the edge is of
    following: np.ndarray  # (E,), the corner at its end
    normal_ahead: np.ndarray  # (E,), of the edge's line, normal . P = offset, out of the polygon, metres
    normal_aside: np.ndarray
    offset: np.ndarray  # negative for edges that face the camera
    edge_on: np.ndarray  # (E,) bool, whether the camera is within NEAR of the line
    holds: np.ndarray  # (P,) bool, whether the camera is in or on the polygon


def edges_of(view: View, spread: np.ndarray | float) -> Edges:
    """The edges of a view's polygons; ``spread`` is the greatest slope to the left or right, one or ``(P,)``."""
    ahead, aside, count = view.ahead, view.aside, view.corner_count
    polygons = np.flatnonzero(view.radius == 0.0)
    first = np.cumsum(count) - count
    following = np.arange(1, len(ahead) + 1)
    following[first + count - 1] = first
    pair = np.repeat(polygons, count)
    normal_ahead, normal_aside = aside[following] - aside, ahead - ahead[following]
    offset = normal_ahead * ahead + normal_aside * aside
    slope = spread[pair] if isinstance(spread, np.ndarray) else spread
    margin = NEAR * np.hypot(1.0, slope) * np.hypot(normal_ahead, normal_aside)
    holds = np.zeros(len(view.radius), dtype=bool)
    holds[polygons] = np.minimum.reduceat(offset + margin, first) >= 0.0
    return Edges(pair, following, normal_ahead, normal_aside, offset, np.abs(offset) <= margin, holds)
