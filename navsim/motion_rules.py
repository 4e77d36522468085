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
    from navsim.world import World

FASTEST = 10.0
"""Metres per second that no point of a moving obstacle may exceed."""
TOUCH = 1e-6
"""Metres: footprints that overlap by less only touch."""
SWING_STEP = 2e-3
"""Metres that the farthest point of a swinging obstacle moves between the angles that are looked at."""


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
    if (one.knots[:, 2] != 0.0).any():
        (x, y, begin), (_, _, end) = one.knots
        count = 1 + max(1, math.ceil(abs(end - begin) * one.reach / swing_step))
        return [
            Sweep(placed(part.vertices, np.array([x, y, angle])), part.radius, f"at {math.degrees(angle):.0f}°")
            for angle in np.linspace(begin, end, count)
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


def broken_rules_of_motion(world: World) -> list[Problem]:
    """Every rule that the moving and the pushable obstacles of ``world`` break."""
    if all(obstacle.motion is None and obstacle.pushable is None for obstacle in world.obstacles):
        return []
    return [*_contradictions(world), *_ways_that_are_not_free(world), *_cramped_pushables(world)]


def _contradictions(world: World) -> Iterator[Problem]:
    for i, obstacle in enumerate(world.obstacles):
        where: tuple[str | int, ...] = ("obstacles", i, obstacle.kind)
        if obstacle.motion is not None and obstacle.pushable is not None:
            text = "an obstacle that moves by itself cannot be pushed as well; leave 'pushable' or 'motion' out"
            yield Problem((*where, "pushable"), text, at_key=True)
        if obstacle.pushable is not None and obstacle.base > 0.0:
            yield Problem((*where, "base"), "what can be pushed slides on the floor; leave 'base' out")
        path, at = getattr(obstacle.motion, "path", None), getattr(obstacle, "at", None)
        if path is not None and at is not None and math.dist(path[0], at) > TOUCH:
            shown = f"[{at[0]:g}, {at[1]:g}]"
            yield Problem((*where, "motion", "path", 0), f"must be where the obstacle stands, 'at' {shown}")
    for one in dynamic_obstacles(world):
        if one.top_speed > FASTEST * (1.0 + 1e-9):
            text = f"its farthest point moves at {one.top_speed:.3g} m/s, faster than {FASTEST:g} m/s; lower the speed"
            yield Problem(_motion(world, one), text)


def _motion(world: World, one: DynamicObstacle) -> tuple[str | int, ...]:
    return ("obstacles", one.index, world.obstacles[one.index].kind, "motion")


def _ways_that_are_not_free(world: World) -> Iterator[Problem]:
    """One problem for each moving obstacle whose way leads out of the room or into something that stands."""
    half = world.half_size
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
        fixed = [p for p in world.fixed_prisms if p.obstacle >= 0 and p.overlaps_heights(one.base, one.top)]
        hits = _overlaps(floor, Footprints.of(fixed))
        if hits:
            sweep, prism = min(hits)
            text = f"carries it into '{fixed[prism].name}', {swept[sweep].where}; leave room for the whole of it"
            yield Problem(_motion(world, one), text)


def _cramped_pushables(world: World) -> Iterator[Problem]:
    """The pushable obstacles that reach out of the room or into something else from the beginning."""
    pushable = [one for one in dynamic_obstacles(world) if not one.moves]
    before: list[DynamicObstacle] = []
    for one in pushable:
        where = ("obstacles", one.index, world.obstacles[one.index].kind)
        own = _footprints_at_rest([one])
        if (np.maximum(-own.low, own.high) > world.half_size + TOUCH).any():
            yield Problem(where, "reaches out of the room, where nothing could push it; move it inside")
            continue
        fixed = [p for p in world.fixed_prisms if p.obstacle >= 0 and p.overlaps_heights(one.base, one.top)]
        names = [prism.name for prism in fixed]
        hits = _overlaps(own, Footprints.of(fixed))
        if not hits:
            names = [world.obstacles[other.index].name for other in before for _ in other.parts]
            hits = _overlaps(own, _footprints_at_rest(before))
        if hits:
            yield Problem(where, f"can be pushed, but stands inside '{names[min(hits)[1]]}'; move one of them away")
        before.append(one)


def _footprints_at_rest(obstacles: Sequence[DynamicObstacle]) -> Footprints:
    return Footprints.of(
        [
            Prism("", one.index, one.base, one.top, part.vertices + one.reference, part.radius)
            for one in obstacles
            for part in one.parts
        ]
    )


def _overlaps(first: Footprints, second: Footprints) -> list[tuple[int, int]]:
    """Every pair of a footprint and another that overlap by more than ``TOUCH``."""
    found: list[tuple[int, int]] = []
    if not len(first) or not len(second):
        return found
    shrunk = _shrunk(first)
    for a, b in overlapping_boxes(shrunk.low, shrunk.high, second.low, second.high):
        if not len(a):
            continue
        edge, pair, begin = shrunk.edges_of(a)
        gaps = second.segment_distances(shrunk.starts[edge], shrunk.ends[edge], b[pair]) - shrunk.radius[a][pair]
        holds = shrunk.point_distances(second.centre[b], a) <= 0.0
        meets = (np.minimum.reduceat(gaps, begin) <= 0.0) | holds
        found += zip(a[meets].tolist(), b[meets].tolist(), strict=True)
    return found


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
