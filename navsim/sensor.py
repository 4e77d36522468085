"""What a real depth sensor makes of ideal images: noise, lost returns, steps of disparity, and images that come late.

The Kinect's are modelled. It projects a pattern of infrared dots from a place 75 mm beside its camera and finds, pixel
by pixel, by how far the pattern has shifted: the disparity d = f b / z. What goes wrong goes wrong in three ways: the
match is a little off (`axial_noise`, `lateral_noise`, `disparity_step`), there is none (`shadows`, `edge_loss`,
`grazing_loss`), or it comes late (`latency`).

Order: the ideal image, which collision checks keep to; displacement sideways; noise along the axis; steps of disparity;
lost returns; the blind zone and saturation; ``uint8``; the delay. Readings that the camera's ``max_range`` has cut off
are no measurements, and stay at ``max_range``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.camera import DepthCamera
from navsim.holes import fill_holes
from navsim.settings import check_kinds

FOCAL_LENGTH = 580.0
"""Of the Kinect, in pixels of its 640x480, which figures in pixels are about."""
BASELINE = 0.075
"""From the Kinect's camera to its projector, metres."""
DISPARITY = FOCAL_LENGTH * BASELINE
"""Disparity times depth, pixels of 640 in a row times metres (K. Konolige and
P. Mihelich, "Technical description of Kinect calibration", ROS wiki 2010; K. Khoshelham and S. O. Elberink, "Accuracy
and resolution of Kinect depth data for indoor mapping applications", Sensors 12(2), 2012)."""
LONGEST_LATENCY = 100
"""Steps: every robot keeps so many images."""
EDGE = 2.0
"""Jump of disparity between two neighbouring pixels, beyond the slope of either side's surface, that makes an edge;
pixels of 640 in a row. At 1 m it is a step of 5 cm, at 3 m one of 41 cm."""
GRAZING_BEGINS, GRAZING_ENDS = math.radians(60.0), math.radians(80.0)
"""Angles between the ray and the surface's normal: from the first on Nguyen et al. find noise to grow steeply, beyond
the second they have no readings. Radians."""

_SMALLEST = np.float32(1e-3)  # metres; nearer readings are in the blind zone whatever happens to them


@dataclass(frozen=True)
class SensorModel:
    """What the depth sensor adds to and takes from ideal images; by default nothing. ``KINECT`` is a whole Kinect.

    Collisions by the depth rule are judged on the ideal, present image whatever is set here.
    """

    axial_noise: float = 0.0
    """Noise along the optical axis, in multiples of the Kinect's σ(z) = 0.0012 + 0.0019 (z - 0.4)², metres (C. V.
    Nguyen, S. Izadi, D. Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT
    2012). 1 is as measured."""
    lateral_noise: float = 0.0
    """Noise across it, in multiples of the Kinect's σ(θ) = 0.8 + 0.035 θ / (π/2 - θ) pixels of its 640x480 (same
    paper; θ is the angle between the surface's normal and the ray, here at most 80°). 1 is as measured: a tenth of a
    column of 80."""
    disparity_step: float = 0.0
    """Step to which disparity is rounded, pixels of 640 in a row; the Kinect's is 0.125 (Konolige and Mihelich 2010;
    Khoshelham and Elberink 2012). Depth then comes in steps of z²/348 m: 3 mm at 1 m, 7 cm at 5 m."""
    shadows: bool = False
    """Whether what the projector does not light returns nothing: the strip of the background along one side of
    everything nearer (Khoshelham and Elberink 2012). The Kinect's projector sits to the right of its camera, so that
    shadows lie to the left."""
    edge_loss: float = 0.0
    """Probability that a pixel beside an edge returns nothing, because the block that is matched, 9x9 of the Kinect's
    pixels, holds two depths (Konolige and Mihelich 2010)."""
    grazing_loss: float = 0.0
    """Probability that a surface seen at 80° or more from its normal returns nothing; it falls linearly to 0 at 60°
    (limits of the measurements of Nguyen et al. 2012)."""
    filled: bool = False
    """Whether what has no return shows what lies behind, as far as that can be told (``navsim.fill_holes``)."""
    latency: int = 0
    """Control periods by which images are late: what is seen is the image of so many steps ago, or an episode's first
    one until there is one that old."""

    def __post_init__(self) -> None:
        check_kinds(self, "sensor")
        for name in ("axial_noise", "lateral_noise", "disparity_step"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"sensor {name} must be a finite number, at least 0; got {value!r}")
        for name in ("edge_loss", "grazing_loss"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"sensor {name} must be a probability, from 0 to 1; got {getattr(self, name)!r}")
        if not 0 <= self.latency <= LONGEST_LATENCY:
            raise ValueError(f"sensor latency must be from 0 to {LONGEST_LATENCY} steps; got {self.latency!r}")

    @property
    def is_noisy(self) -> bool:
        """Whether anything is drawn at random."""
        return any(value > 0.0 for value in (self.axial_noise, self.lateral_noise, self.edge_loss, self.grazing_loss))

    @property
    def loses_returns(self) -> bool:
        """Whether pixels have no return for other reasons than what is nearer than the camera's blind zone."""
        return self.shadows or self.edge_loss > 0.0 or self.grazing_loss > 0.0

    @property
    def is_exact(self) -> bool:
        """Whether images are the ideal ones, be they late."""
        return not (self.is_noisy or self.shadows or self.filled or self.disparity_step > 0.0)


KINECT = SensorModel(
    axial_noise=1.0, lateral_noise=1.0, disparity_step=0.125, shadows=True, edge_loss=0.5, grazing_loss=1.0
)
"""A Kinect. Nguyen's axial noise was measured with the sensor's steps of disparity in it, so both together are a little
more than a Kinect has. A block of 9 pixels reaches half a column of 80 to either side, which an edge somewhere between
two columns falls into with a probability of one half."""
SENSORS = {"ideal": SensorModel(), "kinect": KINECT, "kinect-filled": replace(KINECT, filled=True)}
"""Sensors by name."""


def axial_sigma(depth: np.ndarray) -> np.ndarray:
    """σ(z) of Nguyen, Izadi and Lovell 2012 for depths of any shape, both metres."""
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2


def lateral_sigma(angle: np.ndarray) -> np.ndarray:
    """σ(θ) of Nguyen, Izadi and Lovell 2012 for angles of any shape, radians; in pixels of 640x480."""
    angle = np.minimum(angle, GRAZING_ENDS)
    return 0.8 + 0.035 * angle / (math.pi / 2 - angle)


def incidence(inverse: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Cosine of the angle between each pixel's ray and the normal of the surface that it meets.

    The inverse depth of a plane is linear over the image, w = a + b t + c m, where (a, b, c) is along its normal.
    Differences to the neighbours give b and c exactly; of the two in each direction the lesser is taken, which at an
    edge is the one on the pixel's own surface.

    Args:
        inverse: ``(..., H, W)`` inverse planar depth, 1/m.
        camera: whose image it is.

    Returns:
        ``(..., H, W)`` in (0, 1].
    """
    left = camera.column_slopes.astype(np.float32)
    up = camera.row_slopes.astype(np.float32)[:, None]
    by_left = _lesser_difference(inverse, -1) * np.float32(-camera.fx)
    by_up = _lesser_difference(inverse, -2) * np.float32(-camera.fy)
    along = inverse - left * by_left - up * by_up
    return inverse / (np.sqrt(along**2 + by_left**2 + by_up**2) * camera.ray_lengths)


def _lesser_difference(image: np.ndarray, axis: int) -> np.ndarray:
    """The lesser, in magnitude, of the differences to the pixels before and after; at the border the only one."""
    image = np.moveaxis(image, axis, -1)
    step = np.diff(image, axis=-1)
    if not step.shape[-1]:
        return np.moveaxis(np.zeros_like(image), -1, axis)
    before = np.concatenate([step[..., :1], step], axis=-1)
    after = np.concatenate([step, step[..., -1:]], axis=-1)
    return np.moveaxis(np.where(np.abs(before) < np.abs(after), before, after), -1, axis)


def in_shadow(inverse: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """``(..., H, W)`` bool: what a projector 75 mm to the camera's right does not light.

    The projector sees a pixel of column u at u - d, where d is its disparity in columns. Where something further right
    in the image comes to lie further left from there, it stands in the way; what the projector sees past the other side
    of something so narrow is taken for shadow as well.
    """
    seen_at = np.arange(camera.width, dtype=np.float32) - np.float32(camera.fx * BASELINE) * inverse
    nearest = np.minimum.accumulate(seen_at[..., ::-1], axis=-1)[..., ::-1]
    return seen_at > nearest


def beside_edge(inverse: np.ndarray) -> np.ndarray:
    """``(..., H, W)`` bool: pixels with an edge between them and one of their four neighbours; see ``EDGE``."""
    found = np.zeros(inverse.shape, dtype=bool)
    for axis in (-1, -2):
        image, marked = np.moveaxis(inverse, axis, -1), np.moveaxis(found, axis, -1)
        step = np.diff(image, axis=-1)
        if not step.shape[-1]:
            continue
        before = np.concatenate([step[..., :1] * 0, step[..., :-1]], axis=-1)
        after = np.concatenate([step[..., 1:], step[..., -1:] * 0], axis=-1)
        jump = np.minimum(np.abs(step - before), np.abs(step - after)) > np.float32(EDGE / DISPARITY)
        marked[..., :-1] |= jump
        marked[..., 1:] |= jump
    return found


class Sensor:
    """The depth sensors of N robots: what the networks get of ideal images, and when.

    Every robot's noise comes from a generator of its own, so that it does not depend on how many robots there are.

    Args:
        camera: the camera.
        model: what the sensor does to its images.
        num_robots: N.
        most_latency: the greatest latency that robots will be given, steps.

    Attributes:
        latency: ``(N,)`` intp, steps by which each robot's images are late.
        noise_level: ``(N,)`` float32, factor on each robot's axial and lateral noise and on its probabilities of loss.
    """

    def __init__(self, camera: DepthCamera, model: SensorModel, num_robots: int, most_latency: int) -> None:
        self._camera, self._model = camera, model
        self.latency = np.full(num_robots, model.latency, dtype=np.intp)
        self.noise_level = np.ones(num_robots, dtype=np.float32)
        # Newest image first.
        self._images = np.zeros((num_robots, most_latency + 1, camera.height, camera.width), dtype=np.uint8)
        self._generators: list[np.random.Generator] = []

    def reseed(self, sequences: Sequence[np.random.SeedSequence]) -> None:
        """Starts the noise of each robot afresh."""
        self._generators = [np.random.default_rng(sequence) for sequence in sequences]

    @property
    def images(self) -> np.ndarray:
        """``(N, H, W)`` uint8, what the networks get now; a copy."""
        return self._images[np.arange(len(self._images)), self.latency]

    def begin(self, robots: np.ndarray, ideal: np.ndarray) -> None:
        """Takes the first images of episodes, which are also what is seen until a late one arrives.

        Args:
            robots: ``(K,)`` indices of robots.
            ideal: ``(K, H, W)`` what the ideal sensor reads, metres.
        """
        self._images[robots] = self._expose(robots, ideal)[:, None]

    def advance(self, ideal: np.ndarray) -> None:
        """Takes the images ``(N, H, W)`` after a step of all robots, metres."""
        if self._images.shape[1] > 1:
            self._images[:, 1:] = self._images[:, :-1].copy()
        self._images[:, 0] = self._expose(np.arange(len(ideal)), ideal)

    def state_dict(self) -> dict[str, Any]:
        """All that later images depend on, one entry a robot."""
        return {
            "generators": [generator.bit_generator.state for generator in self._generators],
            "latency": self.latency.copy(),
            "noise_level": self.noise_level.copy(),
            "images": self._images.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from a ``state_dict`` of as many robots with the same settings; the simulator has checked them."""
        self._images = np.array(state["images"], dtype=np.uint8)
        self.latency = np.array(state["latency"], dtype=np.intp)
        self.noise_level = np.array(state["noise_level"], dtype=np.float32)
        for generator, generator_state in zip(self._generators, state["generators"], strict=True):
            generator.bit_generator.state = generator_state

    def _expose(self, robots: np.ndarray, ideal: np.ndarray) -> np.ndarray:
        """``(K, H, W)`` uint8, new images of some robots."""
        camera, model = self._camera, self._model
        if model.is_exact or not len(robots):
            return camera.to_uint8(ideal)
        planar, limit = ideal, np.float32(camera.max_range * (1.0 - 1e-6))
        if camera.depth == "range":  # what is out of range is a plane of its own, and no ball around the camera
            planar = np.where(ideal < limit, ideal / camera.ray_lengths, camera.max_range).astype(np.float32)
        inverse = np.reciprocal(np.maximum(planar, _SMALLEST))
        level = self.noise_level[robots, None, None]
        angle = None
        if model.lateral_noise > 0.0 or model.grazing_loss > 0.0:
            angle = np.arccos(np.minimum(incidence(inverse, camera), np.float32(1.0)))
        lost = self._lost(robots, inverse, angle, level)

        if model.lateral_noise > 0.0 and angle is not None:
            sigma = level * np.float32(model.lateral_noise) * lateral_sigma(angle)
            uniform = self._uniform(robots)
            along, across = (
                _displaced(inverse, self._normal(robots) * (sigma * np.float32(share)), uniform, axis)
                for axis, share in ((-1, camera.fx / FOCAL_LENGTH), (-2, camera.fy / FOCAL_LENGTH))
            )
            step = across - inverse
            inverse = np.where(np.abs(step) < np.float32(EDGE / DISPARITY), along + step, across)
        measured = np.reciprocal(inverse)
        # What is out of range is no measurement, and has no noise.
        beyond = camera.from_planar(measured) >= limit
        if model.axial_noise > 0.0:
            sigma = level * np.float32(model.axial_noise) * axial_sigma(measured)
            measured = np.maximum(measured + sigma * self._normal(robots), _SMALLEST)
        if model.disparity_step > 0.0:
            step = np.float32(model.disparity_step)
            steps = np.maximum(np.rint(np.float32(DISPARITY) / (step * measured)), np.float32(1.0))
            measured = np.float32(DISPARITY) / (step * steps)
        measured = np.where(beyond, np.float32(camera.max_range), camera.from_planar(measured))
        measured[lost] = 0.0
        if model.filled:
            measured[measured < max(camera.blind_zone, camera.min_range)] = 0.0
            measured = fill_holes(measured, camera)
        return camera.to_uint8(measured)

    def _lost(self, robots: np.ndarray, inverse: np.ndarray, angle: np.ndarray | None, level: np.ndarray) -> np.ndarray:
        """``(K, H, W)`` bool, the pixels that return nothing."""
        model = self._model
        lost = in_shadow(inverse, self._camera) if model.shadows else np.zeros(inverse.shape, dtype=bool)
        if model.edge_loss == model.grazing_loss == 0.0:
            return lost
        kept = np.ones(inverse.shape, dtype=np.float32)  # probability of a return
        if model.edge_loss > 0.0:
            kept -= beside_edge(inverse) * np.minimum(np.float32(model.edge_loss) * level, np.float32(1.0))
        if model.grazing_loss > 0.0 and angle is not None:
            share = (angle - np.float32(GRAZING_BEGINS)) / np.float32(GRAZING_ENDS - GRAZING_BEGINS)
            share = np.clip(share, 0.0, 1.0) * np.float32(model.grazing_loss) * level
            kept *= np.maximum(np.float32(1.0) - share, 0.0)
        return lost | (self._uniform(robots) >= kept)

    def _normal(self, robots: np.ndarray) -> np.ndarray:
        """``(K, H, W)`` float32, standard normal numbers of each robot."""
        drawn = np.empty((len(robots), self._camera.height, self._camera.width), dtype=np.float32)
        for image, robot in zip(drawn, robots.tolist(), strict=True):
            self._generators[robot].standard_normal(dtype=np.float32, out=image)
        return drawn

    def _uniform(self, robots: np.ndarray) -> np.ndarray:
        """``(K, H, W)`` float32, numbers of each robot, even between 0 and 1."""
        drawn = np.empty((len(robots), self._camera.height, self._camera.width), dtype=np.float32)
        for image, robot in zip(drawn, robots.tolist(), strict=True):
            self._generators[robot].random(dtype=np.float32, out=image)
        return drawn


def _displaced(inverse: np.ndarray, shift: np.ndarray, uniform: np.ndarray, axis: int) -> np.ndarray:
    """Inverse depths seen ``shift`` pixels further along an axis.

    Between two pixels of one surface inverse depth is interpolated, which is exact on planes. Between two surfaces one
    of both is seen, and the other with the probability of the remaining fraction of a pixel: somewhere between the
    pixels lies the silhouette, and anywhere with equal right.
    """
    last = inverse.shape[axis] - 1
    if last == 0:
        return inverse
    step = np.diff(inverse, axis=axis)
    border = np.zeros_like(inverse[..., :1] if axis == -1 else inverse[..., :1, :])
    ahead, behind = np.concatenate([step, border], axis=axis), np.concatenate([border, step], axis=axis)
    step = np.where(shift > 0.0, ahead, behind)
    seen = inverse + shift * step
    edge = np.flatnonzero(np.abs(step) >= np.float32(EDGE / DISPARITY))  # few, as are shifts of whole pixels
    moved = shift.reshape(-1)[edge]
    jump = (uniform.reshape(-1)[edge] < np.abs(moved)) * np.sign(moved) * step.reshape(-1)[edge]
    seen.reshape(-1)[edge] = inverse.reshape(-1)[edge] + jump
    if max(shift.max(initial=0.0), -shift.min(initial=0.0)) >= 1.0:
        far = np.nonzero(np.abs(shift) >= 1.0)
        whole = np.floor(shift[far])
        part = shift[far] - whole
        before = list(far)
        before[axis] = np.clip(far[axis] + whole.astype(np.intp), 0, last)
        after = list(far)
        after[axis] = np.clip(far[axis] + whole.astype(np.intp) + 1, 0, last)
        step = inverse[tuple(after)] - inverse[tuple(before)]
        share = np.where(np.abs(step) < np.float32(EDGE / DISPARITY), part, uniform[far] < part)
        seen[far] = inverse[tuple(before)] + share * step
    return seen
