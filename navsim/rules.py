"""The geometric rules of a world: what must hold between its room, obstacles, starts and goals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import shapely

from navsim.errors import Problem, key_path
from navsim.footprints import Footprints
from navsim.motion_rules import broken_rules_of_motion
from navsim.planner import CONTACT, FreeSpace, free_space
from navsim.robot import TURTLEBOT2

if TYPE_CHECKING:
    from navsim.world import World

START_CLEARANCE = TURTLEBOT2.radius + 0.05
"""Metres from a start to the nearest obstacle or wall."""
GOAL_CLEARANCE = TURTLEBOT2.radius
"""Metres from a goal to the nearest obstacle or wall."""
SHORTEST_TRIP = 0.5
"""Metres between a start and a goal when either is drawn at random."""
MOST_PLACES = 20_000
"""Places that are tried for a random start or goal before a room is said to have none."""
MOST_OVERLAPS = 300_000
"""Pairs of obstacles, or convex pieces of such, whose bounding boxes overlap."""
_BOXES_A_CHUNK = 200
MOST_NAMED = 20
"""Starts that a message names."""

_Place = tuple[str, int]
"""Where a start or a goal stands in the file, such as ``("starts", 0)``."""


def broken_rules(world: World) -> list[Problem]:
    """Every geometric rule that ``world`` breaks.

    Everything is inside the room; what moves stays in it and runs into nothing that stands; what can be pushed stands
    free; starts and goals have clearance; every pair of them is connected; and there is room for those that are drawn
    at random.
    """
    if _is_too_crowded(world):  # most of what follows takes time by the pair
        text = f"more than {MOST_OVERLAPS} pairs of them overlap, or of the pieces that polygons are cut into"
        return [Problem(("obstacles",), f"{text}; leave out those that are inside others")]
    problems = [*_obstacles_outside(world), *broken_rules_of_motion(world)]
    space = free_space(world, TURTLEBOT2.radius, TURTLEBOT2.height)
    listed = _listed(world, "starts"), _listed(world, "goals")
    clear: list[dict[_Place, tuple[float, float]]] = []
    for places, needed in zip(listed, (START_CLEARANCE, GOAL_CLEARANCE), strict=True):
        cramped = dict(_cramped(world, space, places, needed))
        problems += [Problem(where, text) for where, text in cramped.items()]
        clear.append({where: point for where, point in places.items() if where not in cramped})
    starts, goals = clear
    if world.random_starts and world.random_goals:
        return problems + _no_room_to_drive(space)
    if world.random_starts or world.random_goals:
        return problems + _no_random_counterpart(space, {**starts, **goals}, world.random_starts)
    return problems + _cut_off(space, starts, goals)


def _is_too_crowded(world: World) -> bool:
    prisms = [prism for prism in world.prisms if prism.obstacle >= 0]
    if len(prisms) ** 2 <= MOST_OVERLAPS:
        return False
    pieces = Footprints.of(prisms)
    boxes = shapely.box(*pieces.low.T, *pieces.high.T)
    tree = shapely.STRtree(boxes)
    pairs = 0
    for begin in range(0, len(boxes), _BOXES_A_CHUNK):
        first, second = tree.query(boxes[begin : begin + _BOXES_A_CHUNK])
        pairs += int(np.count_nonzero(begin + first < second))
        if pairs > MOST_OVERLAPS:
            return True
    return False


def _listed(world: World, key: str) -> dict[_Place, tuple[float, float]]:
    places = world.starts if key == "starts" else world.goals
    return {} if isinstance(places, str) else {(key, i): place.at for i, place in enumerate(places)}


def _obstacles_outside(world: World) -> Iterator[Problem]:
    for i, obstacle in enumerate(world.obstacles):
        for keys, point in obstacle.points_in_room():
            if not _is_inside(world, point):
                yield Problem(("obstacles", i, obstacle.kind, *keys), _outside(world, point))


def _cramped(
    world: World, space: FreeSpace, places: dict[_Place, tuple[float, float]], needed: float
) -> Iterator[tuple[_Place, str]]:
    """The places outside the room, or with less clearance than ``needed``, metres, and what is wrong with each."""
    if not places:
        return
    points = np.array(list(places.values()))
    distances, prisms = space.obstacles.nearest(points)
    for where, point, distance, prism in zip(places, points, distances.tolist(), prisms.tolist(), strict=True):
        if not _is_inside(world, point):
            yield where, _outside(world, tuple(point.tolist()))
            continue
        nearest = space.blocking[prism].name if prism >= 0 else ""
        if world.walls is not None:
            to_walls = np.concatenate([world.half_size - point, world.half_size + point])
            side = int(np.argmin(to_walls))
            if to_walls[side] < distance:
                distance, nearest = float(to_walls[side]), f"wall {('east', 'north', 'west', 'south')[side]}"
        if distance < needed - CONTACT:
            is_at = f"is {distance:.3f} m from" if distance > 0.0 else "is inside"
            yield where, f"{is_at} '{nearest}'; move it until {needed:.4g} m around it are free"


def _cut_off(
    space: FreeSpace, starts: dict[_Place, tuple[float, float]], goals: dict[_Place, tuple[float, float]]
) -> list[Problem]:
    """The goals that some start is not connected with."""
    if not starts or not goals:
        return []
    regions = space.regions(np.array([*starts.values(), *goals.values()]))
    names, own = list(starts), regions[: len(starts)]
    problems = []
    for where, region in zip(goals, regions[len(starts) :], strict=True):
        lost = np.flatnonzero(own != region).tolist()
        if lost:
            shown = [key_path(names[i]) for i in lost[:MOST_NAMED]]
            shown += [f"{len(lost) - MOST_NAMED} more"] if len(lost) > MOST_NAMED else []
            which = "any start" if len(lost) == len(starts) else " and ".join(shown)
            problems.append(Problem(where, f"is cut off from {which}; {_open_a_gap()}"))
    return problems


def _no_random_counterpart(
    space: FreeSpace, listed: dict[_Place, tuple[float, float]], random_starts: bool
) -> list[Problem]:
    """The listed places that nothing at random can be paired with."""
    points = np.array(list(listed.values())).reshape(-1, 2)
    paired = np.zeros(len(points), dtype=bool)
    room = START_CLEARANCE - TURTLEBOT2.radius if random_starts else 0.0
    for places in _lattices(space):
        if paired.all():
            return []
        places = places[space.fits(places) & space.fits_with_room(places, room)]
        regions = space.regions(np.concatenate([points, places]))
        own, others = np.split(regions, [len(points)])
        for i in np.flatnonzero(~paired):
            apart = np.hypot(*(places - points[i]).T) >= SHORTEST_TRIP
            paired[i] = ((others == own[i]) & apart).any()
    wanted = "start" if random_starts else "goal"
    text = f"no place for a random {wanted} is connected with it; {_open_a_gap()}"
    return [Problem(where, text) for where, mated in zip(listed, paired, strict=True) if not mated]


def _no_room_to_drive(space: FreeSpace) -> list[Problem]:
    """A problem, unless the robot can drive the shortest trip straight ahead from some start."""
    angles = np.arange(16) * math.pi / 8.0
    trips = SHORTEST_TRIP * np.column_stack([np.cos(angles), np.sin(angles)])
    for places in _lattices(space):
        places = places[space.fits(places) & space.fits_with_room(places, START_CLEARANCE - TURTLEBOT2.radius)]
        begins, ends = np.repeat(places, len(trips), axis=0), (places[:, None] + trips).reshape(-1, 2)
        inside = space.fits(ends)
        if space.passes(begins[inside], ends[inside]).any():
            return []
    text = "there is no room for a random start; clear obstacles away, enlarge 'size', or list starts and goals"
    return [Problem(("starts",), text)]


def _lattices(space: FreeSpace) -> Iterator[np.ndarray]:
    """Places all over a space, ``(K, 2)``, metres: a few, then more and more."""
    step = float(space.half_extents.max()) / 8.0
    while space.half_extents.min() > 0.0:
        x, y = (np.arange(-half + 0.5 * min(step, half), half, step) for half in space.half_extents)
        yield np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if 4 * len(x) * len(y) > MOST_PLACES:
            return
        step *= 0.5


def _open_a_gap() -> str:
    return f"leave a gap of at least {2.0 * TURTLEBOT2.radius:.4g} m, the robot's width, between the obstacles there"


def _is_inside(world: World, point: tuple[float, float]) -> bool:
    return 2.0 * abs(point[0]) <= world.size[0] and 2.0 * abs(point[1]) <= world.size[1]


def _outside(world: World, point: tuple[float, float]) -> str:
    x, y = 0.5 * world.size[0], 0.5 * world.size[1]
    shown = f"[{point[0]:g}, {point[1]:g}]"
    return f"{shown} is outside the room, x from {-x:g} to {x:g} and y from {-y:g} to {y:g}; move it or enlarge 'size'"
