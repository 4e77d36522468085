"""From a layout to a room that keeps the format's rules: starts, goals, and a passage between every two of them."""

from __future__ import annotations

import difflib
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.camera import DepthCamera
from navsim.generate import blocks, clutter, corridors, forest, office, warehouse
from navsim.generate.layout import ImpossibleError, Layout, Shortfall
from navsim.generate.pieces import Part
from navsim.generate.placing import PASSAGE
from navsim.planner import FreeSpace
from navsim.raycast import Scene, nearest_depth
from navsim.robot import TURTLEBOT2
from navsim.task import Task
from navsim.world import FORMAT, Box, Cylinder, Obstacle, Walls, World

_Generator = Callable[[np.random.Generator, tuple[float, float], float | None], Layout | Shortfall]

_GENERATORS: dict[str, _Generator] = {
    "clutter": clutter.layout,
    "blocks": blocks.layout,
    "corridors": corridors.layout,
    "office": office.layout,
    "warehouse": warehouse.layout,
    "forest": forest.layout,
}
KINDS = tuple(_GENERATORS)
"""The kinds of rooms that can be generated."""

STARTS, GOALS = 5, 10
"""Places listed in a generated room, or fewer in a small or dense one."""
FEWEST_STARTS, FEWEST_GOALS = 2, 3
"""Places that a room must have space for."""
SMALLEST_SIZE, LARGEST_SIZE = 2.0, 60.0
"""Metres: the sides of a room."""
LARGEST_DENSITY = 0.6
"""Share of the floor beyond which no arrangement leaves passages."""

_ATTEMPTS = 40  # layouts before settings are called impossible
_PLACES_EACH_SQUARE_METRE = 5  # random ones that starts and goals are chosen from
_CONNECTED = 0.9  # share of the places with room for a passage that must be connected with each other
_SPARE_STARTS = 2  # chosen beyond those, as some have no free view
_STARTS_APART = 1.0  # metres
_TURNING_ROOM = 0.9  # metres free around a start, with which the robot can drive a circle and see nothing too near
_ROOMIEST = 0.15  # share of the places that starts are chosen from at least
_LONGEST_VIEW = 3.0  # metres, how far a start looks around
_GOALS_APART = 0.6  # metres
_START_TO_GOAL = 2.0 * Task.goal_radius + 0.2  # metres

_CAMERA = DepthCamera()
_YAWS_DEG = np.arange(-165.0, 181.0, 15.0)  # in which starts look around
SEEN_BELOW = _CAMERA.mount_z + Task.collision_depth * float(np.abs(_CAMERA.row_slopes).max())
"""Height, metres, up to which the camera sees things as near as the depth rule allows: what hangs higher never collides
by that rule."""


def generate_world(
    kind: str = "clutter",
    size: tuple[float, float] = (7.0, 7.0),
    density: float | None = None,
    seed: int = 0,
    index: int = 0,
) -> World:
    """A random room that a robot can drive through.

    Between every start and every goal there is a way whose passages are at least 1 m wide. The same arguments make the
    same room, byte for byte; rooms that differ in seed or index have nothing to do with each other.

    Args:
        kind: one of ``KINDS``.
        size: of the room, metres.
        density: share of the floor that is covered, seen from above, 0 to ``LARGEST_DENSITY``; by default the kind's
            own. ``clutter`` then counts obstacles: 24 in 49 m², a third of them lower than the camera or raised off
            the floor.
        seed: of the room, from 0 up.
        index: number of the room among those of its seed, from 0 up.

    Raises:
        ValueError: for settings that cannot be used, or that no room was found for.

    >>> world = generate_world("blocks", seed=3)
    >>> world == generate_world("blocks", seed=3)
    True
    >>> world.name
    'blocks-0001'
    """
    settings = RoomSettings(kind, size, density, seed)
    return settings.room(index)


def generate_worlds(
    kind: str = "clutter",
    size: tuple[float, float] = (7.0, 7.0),
    density: float | None = None,
    seed: int = 0,
    count: int = 1,
) -> Iterator[World]:
    """Rooms 0 to ``count`` − 1 of a seed, one after the other; see :func:`generate_world`.

    Raises:
        ValueError: as :func:`generate_world` does, and for a count that is negative.
    """
    settings = RoomSettings(kind, size, density, seed)
    if count < 0:
        raise ValueError(f"count must be at least 0; got {count!r}")
    return (settings.room(index) for index in range(count))


@dataclass(frozen=True)
class RoomSettings:
    """What a generated room follows from, but for its number.

    Raises:
        ValueError: for settings that cannot be used, each in one sentence.
    """

    kind: str = "clutter"
    size: tuple[float, float] = (7.0, 7.0)
    """Metres."""
    density: float | None = None
    """Share of the floor."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            meant = difflib.get_close_matches(str(self.kind).lower(), KINDS, n=1)
            remedy = f'did you mean "{meant[0]}"?' if meant else f"the kinds are {', '.join(KINDS)}"
            raise ValueError(f'"{self.kind}" is not a kind of room; {remedy}')
        if np.shape(self.size) != (2,) or not all(SMALLEST_SIZE <= length <= LARGEST_SIZE for length in self.size):
            shown = " by ".join(f"{length:g}" for length in self.size) if np.ndim(self.size) == 1 else self.size
            raise ValueError(
                f"size must be two lengths from {SMALLEST_SIZE:g} to {LARGEST_SIZE:g} m; got {shown}, choose others"
            )
        if self.density is not None and not 0.0 < self.density <= LARGEST_DENSITY:
            raise ValueError(
                f"density is the share of the floor that is covered, more than 0 and at most {LARGEST_DENSITY:g}; got "
                f"{self.density:g}"
            )
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise ValueError(f"seed must be a whole number, at least 0; got {self.seed!r}")
        object.__setattr__(self, "size", (float(self.size[0]), float(self.size[1])))

    def name(self, index: int) -> str:
        """What room number ``index``, from 0 up, is called."""
        return f"{self.kind}-{index + 1:04d}"

    def room(self, index: int = 0) -> World:
        """Room number ``index``, from 0 up."""
        if index < 0:
            raise ValueError(f"the number of a room must be at least 0; got {index!r}")
        sequence = np.random.SeedSequence(self.seed, spawn_key=(zlib.crc32(self.kind.encode()), index))
        generator = np.random.default_rng(sequence)
        most: Sequence[Part] = ()
        for _ in range(_ATTEMPTS):
            made = _GENERATORS[self.kind](generator, self.size, self.density)
            if isinstance(made, Layout):
                world = _checked(made, generator, self.size, self.name(index))
                if world is not None:
                    return world
            most = max(most, made.parts, key=_area)
        density = "" if self.density is None else f" with density {self.density:g}"
        floor = self.size[0] * self.size[1]
        raise ImpossibleError(
            f"no {self.kind}{density} was found for a room of {self.size[0]:g} by {self.size[1]:g} m that leaves "
            f"passages of {PASSAGE:g} m, in {_ATTEMPTS} tries, which covered up to {_area(most) / floor:.2f} of the "
            "floor; choose another density or a larger size"
        )


def _area(parts: Sequence[Part]) -> float:
    return sum(part.area for part in parts if not part.is_covered)


def _checked(layout: Layout, generator: np.random.Generator, size: tuple[float, float], name: str) -> World | None:
    """The layout as a world with starts and goals; None where passages do not connect them."""
    obstacles = tuple(_obstacle(part) for part in layout.parts)
    walls = Walls(**layout.walls) if layout.walls else Walls()
    room: dict[str, Any] = {"format": FORMAT, "name": name, "size": size, "walls": walls, "obstacles": obstacles}
    bare = World.model_construct(**room, starts="random", goals="random")  # not checked yet: it has no places
    # A disc as wide as a passage must find its way around all that the robot hits or sees too near.
    space = FreeSpace(bare, PASSAGE / 2, max(TURTLEBOT2.height, SEEN_BELOW))
    places = _connected_places(space, generator, size)
    starts, goals = _spread(places, space, generator, bare)
    if len(starts) < FEWEST_STARTS or len(goals) < FEWEST_GOALS:
        return None
    return World.model_validate({**room, "starts": starts, "goals": goals})


def _obstacle(part: Part) -> Obstacle:
    ((kind, settings),) = part.to_dict().items()
    return Box(**settings) if kind == "box" else Cylinder(**settings)


def _connected_places(space: FreeSpace, generator: np.random.Generator, size: tuple[float, float]) -> np.ndarray:
    """``(K, 2)`` places with room for a passage, all connected, metres; none where much of the floor is cut off."""
    count = math.ceil(_PLACES_EACH_SQUARE_METRE * size[0] * size[1])
    points = np.round(generator.uniform(-space.half_extents, space.half_extents, (count, 2)), 2)
    regions = space.regions(points)
    points, regions = points[regions >= 0], regions[regions >= 0]
    if not len(points):
        return points
    largest = int(np.bincount(regions).argmax())
    is_connected = regions == largest
    return points[is_connected] if is_connected.mean() >= _CONNECTED else points[:0]


def _spread(
    places: np.ndarray, space: FreeSpace, generator: np.random.Generator, world: World
) -> tuple[list[Any], list[Any]]:
    """Starts and goals among ``places`` ``(K, 2)``, as a world lists them, each far from those before it.

    The robot can neither stop nor reverse. Where it has room to turn around, it may face any way that has a free view;
    in a room that has few such places, it starts in the roomiest ones and faces where the view is longest, lest it
    begin before a dead end.
    """
    if not len(places):
        return [], []
    clear = _clearance(places, space, world)
    starts, yaws = _starts(places[clear >= _TURNING_ROOM], generator, world, Task.start_view)
    yaws[:] = np.nan
    if len(starts) < FEWEST_STARTS:
        starts, yaws = _starts(places[clear >= np.quantile(clear, 1.0 - _ROOMIEST)], generator, world, _LONGEST_VIEW)
    goals = places[:0]
    while len(starts):
        far = places[_nearest(places, starts) >= _START_TO_GOAL]
        goals = _scattered(far, starts, len(starts) + GOALS, _GOALS_APART)[len(starts) :]
        if len(goals) >= FEWEST_GOALS:
            break
        starts = starts[:-1]  # in a small room they leave no place for goals
    listed = [
        place if math.isnan(yaw) else {"at": place, "yaw_deg": yaw}
        for place, yaw in zip(starts.tolist(), yaws.tolist(), strict=False)
    ]
    return listed, goals.tolist()


def _starts(
    places: np.ndarray, generator: np.random.Generator, world: World, within: float
) -> tuple[np.ndarray, np.ndarray]:
    """Starts ``(S, 2)`` among ``places``, metres, and the yaw of the longest view of each ``(S,)``, degrees.

    Views of ``within``, metres, and longer ones count alike.
    """
    if not len(places):
        return places, np.empty(0)
    first = places[generator.integers(len(places))][None]
    starts = _scattered(places, first, STARTS + _SPARE_STARTS, _STARTS_APART)
    views, longest = _views(world, starts, within)
    usable = np.flatnonzero(views >= Task.start_view)[:STARTS]
    return starts[usable], longest[usable]


def _clearance(points: np.ndarray, space: FreeSpace, world: World) -> np.ndarray:
    """``(K,)`` metres from ``points`` to the nearest obstacle in the robot's way or wall."""
    return np.minimum(space.obstacles.nearest(points)[0], (world.half_size - np.abs(points)).min(axis=1))


def _views(world: World, starts: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray]:
    """How far the camera sees nothing in the way, at most ``within``, in the best direction, and that direction.

    Returns:
        ``(S,)`` metres; ``(S,)`` degrees.
    """
    count = len(_YAWS_DEG)
    yaws = np.tile(np.deg2rad(_YAWS_DEG), len(starts))
    poses = np.column_stack([np.repeat(starts, count, axis=0), yaws])
    index = np.zeros(len(poses), dtype=np.intp)
    depth = nearest_depth(Scene([world]), index, poses, _CAMERA, within=within).reshape(-1, count)
    return depth.max(axis=1), _YAWS_DEG[depth.argmax(axis=1)]


def _scattered(places: np.ndarray, chosen: np.ndarray, count: int, apart: float) -> np.ndarray:
    """``chosen`` ``(C, 2)`` and further ``places``, each as far from those before it as can be, up to ``count``.

    Fewer where none is left that is ``apart``, metres, from all of them.
    """
    distance = _nearest(places, chosen)
    while len(chosen) < count and len(places) and distance.max() >= apart:
        chosen = np.vstack([chosen, places[distance.argmax()]])
        distance = np.minimum(distance, _nearest(places, chosen[-1:]))
    return chosen


def _nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """``(K,)`` metres from each of ``points`` to the nearest of ``others``."""
    offset = points[:, None] - others
    return np.hypot(offset[..., 0], offset[..., 1]).min(axis=1)
