"""Random starts and goals: free, with a view, connected, drawn for many robots at a time.

Each robot draws from a generator of its own, always as many numbers a round, so that its places depend on nothing else.
Everything that costs time is then looked at for all of them together: in a world of ten thousand obstacles as in
a room, since only what is near a place is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from navsim.connectivity import Chains
from navsim.footprints import Footprints
from navsim.prism import Prism
from navsim.raycast import Scene

START_CLEARANCE = 0.05
"""Free space that a start needs around the robot's base, metres."""

_POINTS, _VIEWS, _ENDS = 12, 8, 2  # random places a round, how many of them are tried as starts, and how many as goals
_ROUNDS = 1000  # times that they are tried before a world is said to have no room
_ZOOMS = 8  # halvings of the room around a listed place, down to a closet in a building of 300 m
_PATIENCE = 100  # times after which a start need not have the wanted view any more, if only it does not collide


class RandomPlaces:
    """Draws starts and goals for each other.

    A place is one of the room where the robot fits, uniformly. A start has ``START_CLEARANCE`` to spare there, and a
    free view in the direction that is drawn with it. Starts and goals are at least ``apart`` from each other, and
    connected.

    Args:
        name: the world's, for errors.
        half_size: ``(2,)``, the room is ``-half_size <= (x, y) <= half_size``, metres.
        prisms: what stands in the robot's way, walls included.
        rim: what bounds a floor without walls, around which no way leads.
        robot_radius: metres.
        apart: least distance between a start and its goal, metres.
        views: from poses ``(K, 3)`` to the free view ``(K,)`` of each, metres.
        wanted_view: the free view that a start needs, metres.
        least_view: what is enough in a world where that is hard to find, metres.
    """

    def __init__(
        self,
        name: str,
        half_size: np.ndarray,
        prisms: Sequence[Prism],
        rim: Sequence[Prism] = (),
        *,
        robot_radius: float,
        apart: float,
        views: Callable[[np.ndarray], np.ndarray],
        wanted_view: float,
        least_view: float,
    ) -> None:
        self._name, self._half_size, self._prisms, self._rim = name, half_size, tuple(prisms), tuple(rim)
        self._robot_radius, self._apart = robot_radius, apart
        self._views, self._wanted_view, self._least_view = views, wanted_view, least_view

    def draw(
        self,
        generators: Sequence[np.random.Generator],
        starts: Sequence[np.ndarray | None],
        goals: Sequence[np.ndarray | None],
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """A start ``(3,)`` and a goal ``(2,)``, metres and radians, for each generator.

        Args:
            generators: ``N`` of them, each the only source of chance for its robot.
            starts: ``N`` starts to take, or None to draw one.
            goals: ``N`` goals to take, or None to draw one.

        Raises:
            ValueError: for a world without room.
        """
        found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        free: dict[int, np.ndarray] = {}  # the last place that each robot could start from
        waiting = list(range(len(generators)))
        for attempt in range(_ROUNDS):
            needs_start = np.array([starts[robot] is None for robot in waiting])
            known = np.full((len(waiting), 2), np.nan)
            for row, robot in enumerate(waiting):
                place = starts[robot] if goals[robot] is None else goals[robot]
                place = free.get(robot) if place is None else place
                if place is not None:
                    known[row] = place[:2]
            begins, ends = self._candidates([generators[robot] for robot in waiting], needs_start, known, attempt)
            for row, robot in enumerate(waiting):
                start, goal = starts[robot], goals[robot]
                if start is not None:
                    begins[row] = start
                if goal is not None:
                    ends[row], ends[row, 0] = np.nan, goal
                if not np.isnan(begins[row, 0]):
                    free[robot] = begins[row]
            connected = self._connected(begins, ends)
            for row in np.flatnonzero(connected.any(axis=1)).tolist():
                found[waiting[row]] = begins[row], ends[row, int(np.argmax(connected[row]))]
            waiting = [robot for robot in waiting if robot not in found]
            if not waiting:
                return [found[robot] for robot in range(len(generators))]
        raise ValueError(
            f'world "{self._name}" has no room for an episode: of thousands of random places none was '
            f"free for a start and connected with a goal at least {self._apart:g} m away; clear obstacles away, "
            "list its starts and goals, or make the goal smaller"
        )

    def suits(self, start: np.ndarray, goal: np.ndarray) -> bool:
        """Whether a start ``(2 or 3,)`` is one for a goal ``(2,)``, whatever its view."""
        inside = bool((np.abs(start[:2]) <= self._half_size).all())
        has_room = inside and self._room(start[None, :2])[0] >= START_CLEARANCE
        return bool(has_room and self._connected(start[None], goal[None, None])[0, 0])

    def _candidates(
        self, generators: Sequence[np.random.Generator], needs_start: np.ndarray, known: np.ndarray, attempt: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """A start ``(N, 3)`` and some goals ``(N, _ENDS, 2)`` for each generator; NaN where there are fewer.

        Starts are looked for where ``needs_start`` ``(N,)`` is set. ``known`` ``(N, 2)`` is the start or goal that is
        given, or where one could start, NaN where there is none: what it is connected with may be a closet of a large
        building, so that in the end places are drawn around it, nearer and less near.
        """
        drawn = np.stack([generator.uniform(-1.0, 1.0, (_POINTS, 3)) for generator in generators])
        points = drawn[..., :2] * self._half_size
        if attempt >= _PATIENCE:
            around = known[:, None] + points / 2 ** (attempt % _ZOOMS)
            points = np.where(np.isnan(around), points, around)
        inside = (np.abs(points) <= self._half_size).all(axis=-1)
        room = np.where(inside, self._room(points.reshape(-1, 2)).reshape(points.shape[:2]), -np.inf)
        place = (room >= START_CLEARANCE) & needs_start[:, None]
        place &= np.cumsum(place, axis=1) <= _VIEWS
        poses = np.concatenate([points, math.pi * drawn[..., 2:]], axis=2)
        wanted_view = self._wanted_view if attempt < _PATIENCE else self._least_view
        place[place] = self._views(poses[place]) >= wanted_view
        starts = np.where(place.any(axis=1)[:, None], poses[np.arange(len(poses)), np.argmax(place, axis=1)], np.nan)
        # The last ones, since the first may be the start itself or beside it.
        free = room[:, ::-1] >= 0.0
        order = np.argsort(~free, axis=1, kind="stable")[:, :_ENDS]
        rows = np.arange(len(points))[:, None]
        return starts, np.where(free[rows, order][..., None], points[:, ::-1][rows, order], np.nan)

    def _connected(self, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Whether each of ``goals`` ``(N, E, 2)`` can be the goal of its start ``(N, 3)``: ``(N, E)`` bool."""
        distance = np.hypot(*np.moveaxis(goals - starts[:, None, :2], 2, 0))
        able = distance >= self._apart  # false for NaN
        rows = np.flatnonzero(able.any(axis=1))
        regions = self._chains.regions(np.concatenate([starts[rows, :2], goals[able]]))
        region = np.full(len(starts), -1)
        region[rows] = regions[: len(rows)]
        able[able] = regions[len(rows) :] == np.repeat(region, np.count_nonzero(able, axis=1))
        return able

    def _room(self, points: np.ndarray) -> np.ndarray:
        """``(K,)`` metres between the robot's base and what is nearest to it, up to ``START_CLEARANCE`` exactly."""
        reach = self._robot_radius + START_CLEARANCE
        point, prism = self._near.candidates(np.zeros(len(points), dtype=np.intp), points, reach)
        at, footprints = points[point], self._footprints
        within = (footprints.low[prism] - reach <= at) & (at <= footprints.high[prism] + reach)
        near = np.flatnonzero(within[:, 0] & within[:, 1])
        point, prism, at = point[near], prism[near], at[near]
        room = np.full(len(points), np.inf)
        np.minimum.at(room, point, footprints.point_distances(at, prism))
        return room - self._robot_radius

    @cached_property
    def _near(self) -> Scene:
        return Scene([self._prisms])

    @cached_property
    def _footprints(self) -> Footprints:
        return Footprints.of(self._prisms)

    @cached_property
    def _chains(self) -> Chains:
        return Chains(Footprints.of((*self._prisms, *self._rim)), self._robot_radius)
