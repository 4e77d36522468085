"""The rules of what moves and of what can be pushed: no way leads out of the room or through anything that stands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from navsim.dynamics import DynamicObstacle, dynamic_obstacles, placed
from navsim.errors import Problem
from navsim.footprints import Footprints, overlapping_boxes
from navsim.prism import Prism

if TYPE_CHECKING:
    from navsim.world import Obstacle, World

FASTEST = 10.0
"""Metres per second that no point of a moving obstacle may exceed."""
TOUCH = 1e-6
"""Metres: footprints that overlap by less only touch."""
SWING_STEP = 2e-3
"""Metres that the farthest point of a swinging obstacle moves between the angles that are looked at."""
MOST_MOVABLE = 300
"""Obstacles of one world that move or can be pushed."""
MOST_SWEEPS = 40_000
"""Of all moving obstacles together: convex pieces, each times the angles or lines of its way."""
MOST_PAIRS = 1_000_000
"""Pairs of a movable piece and another one whose bounding boxes meet, of all together."""


Outline = Sequence[tuple[np.ndarray, float]]
"""Convex pieces of a footprint: vertices ``(V, 2)`` and radius of each, metres."""


class Sweep(NamedTuple):
    """Floor that a convex piece of a moving obstacle covers on some part of its way."""

    vertices: np.ndarray
    """``(V, 2)`` metres, counter-clockwise and convex; two for a cylinder"""
    radius: float
    """Metres around them"""
    where: str
    """Which part of the way, in words."""


def sweeps(one: DynamicObstacle, swing_step: float = SWING_STEP) -> list[Sweep]:
    """The floor that an obstacle sweeps, all of it together.

    Args:
        one: an obstacle that moves by itself.
        swing_step: metres that its farthest point moves between two angles of a swing; straight ways are exact.
    """
    if one.swings:
        (x, y, begin), (_, _, end) = one.knots
        return [
            Sweep(placed(part.vertices, np.array([x, y, angle])), part.radius, f"at {math.degrees(angle):.0f}°")
            for angle in np.linspace(begin, end, _angles(one, swing_step))
            for part in one.parts
        ]
    found = []
    corners = len(one.knots) - one.is_circuit
    for i, (a, b) in enumerate(zip(one.knots[:-1, :2], one.knots[1:, :2], strict=True)):
        where = f"between points {i + 1} and {(i + 1) % corners + 1} of its path"
        for part in one.parts:
            both = np.concatenate([part.vertices + a, part.vertices + b])
            found.append(Sweep(both if part.radius > 0.0 else both[ConvexHull(both).vertices], part.radius, where))
    return found


def count_sweeps(one: DynamicObstacle, swing_step: float = SWING_STEP) -> int:
    """How many :func:`sweeps` has, without making them."""
    return len(one.parts) * (_angles(one, swing_step) if one.swings else len(one.knots) - 1)


def _angles(one: DynamicObstacle, swing_step: float) -> int:
    """Of a swing that are looked at, both ends included."""
    (_, _, begin), (_, _, end) = one.knots
    return 1 + max(1, math.ceil(abs(end - begin) * one.reach / swing_step))


class _CrowdedError(Exception):
    """Too many pairs of pieces to be looked at."""


def broken_rules_of_motion(world: World) -> list[Problem]:
    """Every rule that the moving and the pushable obstacles of ``world`` break."""
    movable = [i for i, one in enumerate(world.obstacles) if one.motion is not None or one.pushable is not None]
    if not movable:
        return []
    if len(movable) > MOST_MOVABLE:
        text = f"is one more than the {MOST_MOVABLE} obstacles of a world that may move or be pushed; let some stand"
        return [Problem(_where(world, movable[MOST_MOVABLE]), text)]
    total = 0
    for one in dynamic_obstacles(world):
        total += count_sweeps(one) if one.moves else 0
        if total > MOST_SWEEPS:
            text = f"all ways together have more than {MOST_SWEEPS} pieces to be looked at; shorten ways and swings"
            return [Problem(_motion(world, one), f"{text}, or give moving obstacles fewer corners")]
    try:
        return [*_contradictions(world), *_ways_that_are_not_free(world), *_cramped_pushables(world)]
    except _CrowdedError:
        text = f"more than {MOST_PAIRS} pieces stand beside the ways of moving and pushable obstacles; leave some out"
        return [Problem(("obstacles",), text)]


class _Standing:
    """What stands still in a world, for many questions about what overlaps it."""

    def __init__(self, prisms: Sequence[Prism]) -> None:
        self.prisms = prisms
        self._footprints = Footprints.of(prisms)
        self._base, self._top = np.array([(prism.base, prism.top) for prism in prisms]).reshape(-1, 2).T
        self._pairs = 0

    def overlaps(self, floor: Footprints, base: float, top: float) -> list[tuple[int, int]]:
        """Every pair of a piece of ``floor`` and of what stands at its heights, that overlap by more than ``TOUCH``."""
        return self._overlaps(floor, (self._base < top) & (self._top > base))

    def overlaps_of_earlier(self, floor: Footprints, index: int) -> list[tuple[int, int]]:
        """The same with the pieces of obstacles that come before ``index``, whatever their heights."""
        return self._overlaps(floor, np.array([prism.obstacle < index for prism in self.prisms], dtype=bool))

    def _overlaps(self, floor: Footprints, counts: np.ndarray) -> list[tuple[int, int]]:
        found: list[tuple[int, int]] = []
        if not len(floor) or not counts.any():
            return found
        shrunk, others = _shrunk(floor), self._footprints
        for a, b in overlapping_boxes(shrunk.low, shrunk.high, others.low, others.high):
            self._pairs += len(a)
            if self._pairs > MOST_PAIRS:
                raise _CrowdedError
            a, b = a[counts[b]], b[counts[b]]
            if not len(a):
                continue
            edge, pair, begin = shrunk.edges_of(a)
            gaps = others.segment_distances(shrunk.starts[edge], shrunk.ends[edge], b[pair])
            gaps = gaps - shrunk.radius[a][pair]
            holds = shrunk.point_distances(others.centre[b], a) <= 0.0
            meets = (np.minimum.reduceat(gaps, begin) <= 0.0) | holds
            found += zip(a[meets].tolist(), b[meets].tolist(), strict=True)
        return found


def meet(first: Outline, second: Outline) -> bool:
    """Whether two obstacles' footprints, wherever they are, overlap by more than ``TOUCH``."""
    ours, theirs = ([Prism("", 0, 0.0, 1.0, *piece) for piece in outline] for outline in (first, second))
    return bool(_Standing(theirs).overlaps(Footprints.of(ours), 0.0, 1.0))


def _contradictions(world: World) -> Iterator[Problem]:
    for i, obstacle in enumerate(world.obstacles):
        where: tuple[str | int, ...] = ("obstacles", i, obstacle.kind)
        if obstacle.motion is not None and obstacle.pushable is not None:
            text = "an obstacle that moves by itself cannot be pushed as well; leave 'pushable' or 'motion' out"
            yield Problem((*where, "pushable"), text, at_key=True)
        if obstacle.pushable is not None and obstacle.base > 0.0:
            yield Problem((*where, "base"), "what can be pushed slides on the floor; leave 'base' out")
        yield from _contradictions_of_path(obstacle, where)
    for one in dynamic_obstacles(world):
        if one.top_speed > FASTEST * (1.0 + 1e-9):
            text = f"its farthest point moves at {one.top_speed:.3g} m/s, faster than {FASTEST:g} m/s; lower the speed"
            yield Problem(_motion(world, one), text)


def _contradictions_of_path(obstacle: Obstacle, where: tuple[str | int, ...]) -> Iterator[Problem]:
    path, at = getattr(obstacle.motion, "path", None), getattr(obstacle, "at", None)
    if path is None or obstacle.motion is None:
        return
    if at is not None and math.dist(path[0], at) > TOUCH:
        shown = f"[{at[0]:g}, {at[1]:g}]"
        yield Problem((*where, "motion", "path", 0), f"must be where the obstacle stands, 'at' {shown}")
    if obstacle.motion.is_circuit and math.dist(path[-1], path[0]) <= TOUCH:
        text = "is where the path begins, to which a circuit leads back by itself; leave it out"
        yield Problem((*where, "motion", "path", len(path) - 1), text)


def _where(world: World, index: int) -> tuple[str | int, ...]:
    return ("obstacles", index, world.obstacles[index].kind)


def _motion(world: World, one: DynamicObstacle) -> tuple[str | int, ...]:
    return (*_where(world, one.index), "motion")


def _fixed(world: World) -> _Standing:
    return _Standing([prism for prism in world.fixed_prisms if prism.obstacle >= 0])


def _ways_that_are_not_free(world: World) -> Iterator[Problem]:
    """One problem for each moving obstacle whose way leads out of the room or into something that stands."""
    half, fixed = world.half_size, _fixed(world)
    for one in dynamic_obstacles(world):
        if not one.moves:
            continue
        swept = sweeps(one)
        floor = Footprints.of([Prism("", 0, 0.0, 1.0, sweep.vertices, sweep.radius) for sweep in swept])
        outside = np.flatnonzero((np.maximum(-floor.low, floor.high) > half + TOUCH).any(axis=1))
        if len(outside):
            x, y = half
            text = f"carries it out of the room, x from {-x:g} to {x:g} and y from {-y:g} to {y:g}"
            yield Problem(_motion(world, one), f"{text}, {swept[outside[0]].where}; keep all of it inside")
            continue
        hits = fixed.overlaps(floor, one.base, one.top)
        if hits:
            sweep, prism = min(hits)
            text = f"carries it into '{fixed.prisms[prism].name}', {swept[sweep].where}; leave room for the whole of it"
            yield Problem(_motion(world, one), text)


def _cramped_pushables(world: World) -> Iterator[Problem]:
    """The pushable obstacles that reach out of the room or into something else from the beginning."""
    pushable = [one for one in dynamic_obstacles(world) if not one.moves]
    fixed, others = _fixed(world), _Standing([prism for one in pushable for prism in _at_rest(world, one)])
    for one in pushable:
        where = _where(world, one.index)
        own = Footprints.of(_at_rest(world, one))
        if (np.maximum(-own.low, own.high) > world.half_size + TOUCH).any():
            yield Problem(where, "reaches out of the room, where nothing could push it; move it inside")
            continue
        standing, hits = fixed, fixed.overlaps(own, one.base, one.top)
        if not hits:
            standing, hits = others, others.overlaps_of_earlier(own, one.index)
        if hits:
            name = standing.prisms[min(hits)[1]].name
            yield Problem(where, f"can be pushed, but stands inside '{name}'; move one of them away")


def _at_rest(world: World, one: DynamicObstacle) -> list[Prism]:
    name = world.obstacles[one.index].name
    return [Prism(name, one.index, one.base, one.top, part.vertices + one.reference, part.radius) for part in one.parts]


def _shrunk(footprints: Footprints) -> Footprints:
    """Footprints that end ``TOUCH`` inside the given ones, so that what only touches those stays clear of these."""
    prisms = []
    for p, (begin, count) in enumerate(zip(footprints.first, footprints.count, strict=True)):
        vertices, radius = footprints.starts[begin : begin + count], footprints.radius[p]
        if radius > 0.0:
            radius = max(radius - TOUCH, 0.5 * radius)
        else:
            share = min(TOUCH / max(footprints.inner[p], TOUCH), 0.5)
            vertices = footprints.centre[p] + (1.0 - share) * (vertices - footprints.centre[p])
        prisms.append(Prism("", 0, 0.0, 1.0, vertices, float(radius)))
    return Footprints.of(prisms)
