"""What a world is: a room, the obstacles in it, and the places where episodes begin and end.

The models below are the world file's format, key by key. Lengths are metres; the origin is the room's centre, x points
right on a plan, y up, z away from the floor.
"""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)
from typing_extensions import Self

from navsim.errors import Problem, WorldError, counted
from navsim.motion_rules import FASTEST
from navsim.polygon import convex_pieces, crossing_edges, signed_area
from navsim.prism import Prism, walls_around
from navsim.rules import broken_rules
from navsim.wording import EXAMPLES, Wording, shown

FORMAT = 1
"""The version of the world file format that this library reads."""
SMALLEST_LENGTH = 1e-6
"""Metres: what is shorter is taken for a slip of the pen."""
LARGEST_LENGTH = 10_000.0
"""Metres: what is longer is taken for a slip of the pen."""

MOST_OBSTACLES = 10_000
"""Of one world."""
MOST_CORNERS = 1_000
"""Of one polygon."""
MOST_CORNERS_IN_ALL = 20_000
"""Of all polygons of a world."""
MOST_PLACES = 500
"""Starts of one world, and goals."""
MOST_WAYPOINTS = 1_000
"""Of one obstacle's way."""
LONGEST_NAME = 1_000
"""Letters."""
MOST_TOLD = 100
"""Problems that are told at once."""

Length = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=SMALLEST_LENGTH, le=LARGEST_LENGTH)]
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST_LENGTH, le=LARGEST_LENGTH)]
Elevation = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=LARGEST_LENGTH)]
Degrees = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-360.0, le=360.0)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e6)]
Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=FASTEST)]
TurningSpeed = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=720.0)]
Friction = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=10.0)]
Point = tuple[Coordinate, Coordinate]
Name = Annotated[str, Field(strict=True, max_length=LONGEST_NAME)]


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    if not TYPE_CHECKING:  # type checkers know a model's arguments better without it

        def __init__(self, **settings: Any) -> None:
            try:
                super().__init__(**settings)
            except ValidationError as error:
                raise WorldError(_sentences(type(self), error, settings)) from None

        # pydantic's own mark of an __init__ that only validates: without it, reading a file would run this one, too.
        __init__.__pydantic_base_init__ = True

    def replace(self, **changes: Any) -> Self:
        """A copy with other values for some keys, checked.

        >>> Box(at=(1, 0), size=(0.5, 0.5), height=0.8).replace(at=(2, 0)).at
        (2.0, 0.0)

        Raises:
            WorldError: when the copy would break the rules of the format.
        """
        return type(self)(**{**{name: getattr(self, name) for name in type(self).model_fields}, **changes})


class Walls(_Settings):
    """The four walls of the room; they stand outside its ``size``."""

    height: Length = 2.0
    """Height of the walls, metres."""
    thickness: Length = 0.1
    """How far they reach outwards from the room's edge, metres."""


class Motion(_Settings):
    """How an obstacle moves: along straight lines from point to point, at a constant speed, without turning."""

    path: Annotated[tuple[Point, ...], Field(min_length=2, max_length=MOST_WAYPOINTS)]
    """Corners of the way, metres; the obstacle stands at the first of them where the file puts it."""
    speed: Speed
    """Metres per second."""
    repeat: Literal["there-and-back", "circuit"] = "there-and-back"
    """What follows the last point: the same way back, or straight on to the first point."""

    @field_validator("path")
    @classmethod
    def _leads_somewhere(cls, path: tuple[Point, ...]) -> tuple[Point, ...]:
        for i, (a, b) in enumerate(itertools.pairwise(path)):
            if math.dist(a, b) < SMALLEST_LENGTH:
                raise ValueError(f"points {i + 1} and {i + 2} are the same; leave one of them out")
        return path

    @property
    def rate(self) -> float:
        """Metres of the way per second."""
        return self.speed

    @property
    def is_circuit(self) -> bool:
        """Whether it goes round and round, not there and back."""
        return self.repeat == "circuit"

    def knots(self) -> np.ndarray:
        """``(C, 3)`` what it moves along, line by line: x, y (metres) and angle (radians); a circuit's ends meet."""
        points = np.array([*self.path, self.path[0]] if self.is_circuit else self.path)
        return np.column_stack([points, np.zeros(len(points))])


class Swing(_Settings):
    """How an obstacle swings about a hinge, as a door does: from one angle to another and back, at a constant speed."""

    hinge: Point
    """What it turns about, metres."""
    swing_deg: tuple[Degrees, Degrees]
    """The two angles between which it swings, degrees, counter-clockwise from where the file puts it."""
    speed_deg: TurningSpeed
    """Degrees per second."""

    @field_validator("swing_deg")
    @classmethod
    def _turns(cls, swing_deg: tuple[float, float]) -> tuple[float, float]:
        if swing_deg[0] == swing_deg[1]:
            raise ValueError("both angles are the same; give two, such as [0, 90], or leave 'motion' out")
        return swing_deg

    @property
    def rate(self) -> float:
        """Radians per second."""
        return math.radians(self.speed_deg)

    @property
    def is_circuit(self) -> bool:
        """A swing always goes there and back."""
        return False

    def knots(self) -> np.ndarray:
        """``(2, 3)`` the poses between which it turns: the hinge's x and y (metres), and an angle (radians)."""
        return np.array([(*self.hinge, math.radians(angle)) for angle in self.swing_deg])


class Pushable(_Settings):
    """What makes an obstacle move when it is pushed."""

    mass: Positive
    """Kilograms."""
    friction: Friction = 0.4
    """Coefficient of friction with the floor: sliding, it slows down by ``friction`` times 9.81 m/s²."""


def _motion_kind(value: object) -> str:
    keys = value if isinstance(value, Mapping) else type(value).model_fields if isinstance(value, BaseModel) else ()
    return "a swing" if {"hinge", "swing_deg", "speed_deg"} & set(keys) else "a way"


_AnyMotion = Annotated[
    Annotated[Motion, Tag("a way")] | Annotated[Swing, Tag("a swing")],
    Discriminator(_motion_kind),
]


class _Obstacle(_Settings):
    kind: ClassVar[str]

    name: Name = ""
    """What the author calls it; ``"box 3"`` (kind and place in the list) when it is not given."""
    base: Elevation = 0.0
    """Height of the under side above the floor, metres."""
    height: Length
    """Extent above ``base``, metres."""
    motion: _AnyMotion | None = None
    """Moves it, whatever stands in its way; without it, the obstacle stands still."""
    pushable: Pushable | None = None
    """Lets it slide when it is pushed; without it, nothing moves the obstacle."""

    @property
    def top(self) -> float:
        """Height of the upper side above the floor, metres."""
        return self.base + self.height


class Box(_Obstacle):
    """A cuboid, turned about the vertical."""

    kind = "box"

    at: Point
    """Centre of the footprint: x and y, metres."""
    size: tuple[Length, Length]
    """Extents along its own x and y axes, metres."""
    yaw_deg: Degrees = 0.0
    """How far it is turned, degrees, counter-clockwise."""

    def points_in_room(self) -> list[tuple[tuple[str | int, ...], Point]]:
        """The points that must lie in the room, each with the keys that lead to it."""
        return [(("at",), self.at)]

    def footprints(self) -> list[tuple[np.ndarray, float]]:
        """Convex footprints: vertices ``(V, 2)``, metres, and radius, metres."""
        yaw = math.radians(self.yaw_deg)
        cos, sin = math.cos(yaw), math.sin(yaw)
        if self.yaw_deg % 90.0 == 0.0:
            cos, sin = float(round(cos)), float(round(sin))
        (x, y), (a, b) = self.at, (0.5 * self.size[0], 0.5 * self.size[1])
        corners = ((-a, -b), (a, -b), (a, b), (-a, b))
        return [(np.array([(x + u * cos - v * sin, y + u * sin + v * cos) for u, v in corners]), 0.0)]


class Cylinder(_Obstacle):
    """An upright cylinder."""

    kind = "cylinder"

    at: Point
    """Centre of the footprint: x and y, metres."""
    radius: Length
    """Radius of the footprint, metres."""

    def points_in_room(self) -> list[tuple[tuple[str | int, ...], Point]]:
        """The points that must lie in the room, each with the keys that lead to it."""
        return [(("at",), self.at)]

    def footprints(self) -> list[tuple[np.ndarray, float]]:
        """Convex footprints: vertices ``(V, 2)``, metres, and radius, metres."""
        return [(np.array([self.at]), self.radius)]


class Polygon(_Obstacle):
    """An upright prism over a simple polygon, which may be concave."""

    kind = "polygon"

    points: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MOST_CORNERS)]
    """Corners of the footprint in order around it, either way, each as x and y, metres; edges do not cross."""

    @field_validator("points")
    @classmethod
    def _is_simple(cls, points: tuple[Point, ...]) -> tuple[Point, ...]:
        for i, (a, b) in enumerate(zip(points, (*points[1:], points[0]), strict=True)):
            if math.dist(a, b) < SMALLEST_LENGTH:
                raise ValueError(f"points {i + 1} and {(i + 1) % len(points) + 1} are the same; leave one of them out")
        crossing = crossing_edges(points)
        if crossing is not None:
            first, second = (f"{i + 1}-{(i + 1) % len(points) + 1}" for i in crossing)
            raise ValueError(
                f"the edges between points {first} and {second} cross or touch; list the corners in order around "
                "the outline"
            )
        if abs(signed_area(points)) < SMALLEST_LENGTH**2:
            raise ValueError("the points lie on one line; move one of them off it")
        return points

    def points_in_room(self) -> list[tuple[tuple[str | int, ...], Point]]:
        """The points that must lie in the room, each with the keys that lead to it."""
        return [(("points", i), point) for i, point in enumerate(self.points)]

    def footprints(self) -> list[tuple[np.ndarray, float]]:
        """Convex footprints: vertices ``(V, 2)``, metres, and radius, metres."""
        return [(np.array(piece), 0.0) for piece in convex_pieces(self.points)]


Obstacle = Box | Cylinder | Polygon
"""One shape with its settings."""

_SHAPES: dict[str, type[Obstacle]] = {shape.kind: shape for shape in (Box, Cylinder, Polygon)}


def _shape_of(entry: object) -> str | None:
    """The kind of an entry of ``obstacles``; None when its one key is not a shape."""
    if isinstance(entry, _Obstacle):
        return entry.kind
    if isinstance(entry, Mapping) and len(entry) == 1:
        (kind,) = entry
        return kind if kind in _SHAPES else None
    return None


def _shape_settings(entry: Any) -> object:
    return entry if isinstance(entry, _Obstacle) else next(iter(entry.values()))


def _point_as_settings(value: object) -> object:
    return {"at": value} if isinstance(value, (list, tuple, np.ndarray)) else value


class _Place(_Settings):
    at: Point
    """Where it is: x and y, metres."""


class Start(_Place):
    """Where an episode begins."""

    yaw_deg: Degrees | None = None
    """Where the robot faces, degrees, counter-clockwise from the x axis; without it, it is drawn each episode."""


class Goal(_Place):
    """Where an episode is to end."""


def _random_or_list(value: object) -> object:
    value = list(value) if isinstance(value, np.ndarray) and value.ndim else value
    if isinstance(value, str) and value != "random":
        raise ValueError(f"must be 'random' or a list of points, not {shown(value)}")
    if isinstance(value, (list, tuple)) and not value:
        raise ValueError("is empty; list at least one point such as [0.0, 0.0], or write 'random'")
    if isinstance(value, (list, tuple, str)):
        return value
    raise ValueError(f"must be 'random' or a list of points such as [[0.0, 0.0]], not {shown(value)}")


def _list_or_random(value: object) -> str:
    return "random" if isinstance(value, str) else "list"


_Starts = Annotated[
    Annotated[
        tuple[Annotated[Start, BeforeValidator(_point_as_settings)], ...], Field(max_length=MOST_PLACES), Tag("list")
    ]
    | Annotated[Literal["random"], Tag("random")],
    Discriminator(_list_or_random),
    BeforeValidator(_random_or_list),
]
_Goals = Annotated[
    Annotated[
        tuple[Annotated[Goal, BeforeValidator(_point_as_settings)], ...], Field(max_length=MOST_PLACES), Tag("list")
    ]
    | Annotated[Literal["random"], Tag("random")],
    Discriminator(_list_or_random),
    BeforeValidator(_random_or_list),
]
_Obstacles = Annotated[
    tuple[
        Annotated[
            Annotated[Box, BeforeValidator(_shape_settings), Tag("box")]
            | Annotated[Cylinder, BeforeValidator(_shape_settings), Tag("cylinder")]
            | Annotated[Polygon, BeforeValidator(_shape_settings), Tag("polygon")],
            Discriminator(_shape_of),
        ],
        ...,
    ],
    Field(max_length=MOST_OBSTACLES),
]


class _BrokenRulesError(ValueError):
    """Carries the problems of :func:`navsim.rules.broken_rules` through pydantic."""

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("; ".join(map(str, problems)))
        self.problems = problems


class World(_Settings):
    """A room with obstacles, starts and goals: a world file's content, checked.

    Read one with :func:`navsim.load_world` or :meth:`from_yaml`, or build one of its parts. Worlds are immutable,
    compare by content, hash cheaply and pickle; what changes a world returns another one, which is checked as well.

    >>> world = World(size=(4, 4), obstacles=[Cylinder(at=(0, 0), radius=0.2, height=0.5)],
    ...               starts=[(-1.5, 0)], goals=[Goal(at=(1.5, 0))])
    >>> world
    World('world', 4 x 4 m, 2 m walls, 1 obstacle, 1 start, 1 goal)
    >>> [prism.name for prism in world.prisms]
    ['wall north', 'wall east', 'wall south', 'wall west', 'cylinder 1']
    >>> world.add(Box(name="chest", at=(0, 1.5), size=(0.8, 0.5), height=0.8)).without("cylinder 1")
    World('world', 4 x 4 m, 2 m walls, 1 obstacle, 1 start, 1 goal)

    Raises:
        WorldError: when it would break the rules of the format, with a sentence for every problem.
    """

    format: int = FORMAT
    """Version of the format; this library reads version 1. Files must say it."""
    name: Annotated[str, Field(strict=True, min_length=1, max_length=LONGEST_NAME)] = "world"
    """What the world is called; a file's own name when it is not given."""
    size: tuple[Length, Length]
    """Extents of the room along x and y, metres; the origin is its centre."""
    walls: Walls | None = Walls()
    """The four walls; ``none`` leaves the floor open."""
    obstacles: _Obstacles = ()
    """What stands in the room, hangs over the floor or moves: a list with one shape an entry."""
    starts: _Starts = "random"
    """Where episodes begin: a list of places, or ``random`` to draw one each episode."""
    goals: _Goals = "random"
    """Where episodes are to end: a list of places, or ``random`` to draw one each episode."""

    @field_validator("format", mode="before")
    @classmethod
    def _format_is_known(cls, value: object) -> object:
        if isinstance(value, bool) or value != FORMAT:
            raise ValueError(f"must be {FORMAT}, the one format that this version reads, not {shown(value)}")
        return FORMAT

    @field_validator("walls", mode="before")
    @classmethod
    def _none_is_a_word(cls, value: object) -> object:
        if isinstance(value, str):
            if value != "none":
                raise ValueError(f"must be 'none' or settings such as {EXAMPLES['walls']}, not {shown(value)}")
            return None
        return value

    @field_validator("obstacles", mode="before")
    @classmethod
    def _is_a_list(cls, value: object) -> object:
        if not isinstance(value, (list, tuple)):
            raise ValueError(f"must be a list with one shape an entry, such as {EXAMPLES['obstacles']}")
        return value

    @field_validator("obstacles")
    @classmethod
    def _have_few_corners(cls, obstacles: tuple[Obstacle, ...]) -> tuple[Obstacle, ...]:
        corners = sum(len(obstacle.points) for obstacle in obstacles if isinstance(obstacle, Polygon))
        if corners > MOST_CORNERS_IN_ALL:
            raise ValueError(
                f"the polygons have {corners} corners in all, more than {MOST_CORNERS_IN_ALL}; leave out those that "
                "matter least, or split the world into several"
            )
        return obstacles

    @field_validator("obstacles")
    @classmethod
    def _have_names(cls, obstacles: tuple[Obstacle, ...]) -> tuple[Obstacle, ...]:
        return tuple(
            obstacle if obstacle.name else obstacle.model_copy(update={"name": _default_name(obstacle.kind, i)})
            for i, obstacle in enumerate(obstacles)
        )

    @model_validator(mode="after")
    def _keeps_the_rules(self) -> Self:
        problems = broken_rules(self)
        if problems:
            raise _BrokenRulesError(problems)
        return self

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> World:
        """The world that ``data`` describes: what a world file holds, as dicts, lists, numbers and strings.

        Raises:
            WorldError: with every problem of ``data``, each named by its key.
        """
        world, problems = parse_world(data)
        if world is None:
            raise WorldError([str(problem) for problem in problems])
        return world

    @classmethod
    def from_yaml(cls, text: str) -> World:
        """The world that the text of a world file describes.

        Raises:
            WorldError: with every problem of ``text``, each with its line and column.
        """
        from navsim.worldfile import parse_text

        return parse_text(text)

    def to_yaml(self) -> str:
        """The text of a world file; :meth:`from_yaml` reads it back.

        >>> print(World(name="hall", size=(4, 3), goals=[(1, 0)]).to_yaml())
        format: 1
        name: hall
        size: [4.0, 3.0]
        <BLANKLINE>
        obstacles: []
        starts: random
        <BLANKLINE>
        goals:
          - [1.0, 0.0]
        <BLANKLINE>
        """
        from navsim.worldfile import dump_world

        return dump_world(self)

    def add(self, *obstacles: Obstacle) -> Self:
        """This world with more obstacles; those without a name get the first one that is free, such as ``"box 3"``.

        Raises:
            WorldError: when the new world would break the rules, because an obstacle covers a start, say.
        """
        taken = {obstacle.name for obstacle in self.obstacles} | {obstacle.name for obstacle in obstacles}
        added: list[Obstacle] = []
        for place, obstacle in enumerate(obstacles, len(self.obstacles)):
            names = (_default_name(obstacle.kind, number) for number in itertools.count(place))
            name = obstacle.name or next(name for name in names if name not in taken)
            taken.add(name)
            added.append(obstacle.replace(name=name))
        return self.replace(obstacles=(*self.obstacles, *added))

    def without(self, *names: str) -> Self:
        """This world without the obstacles of these names.

        Raises:
            WorldError: when no obstacle has such a name.
        """
        for name in names:
            self._obstacles_called(name)
        return self.replace(obstacles=[obstacle for obstacle in self.obstacles if obstacle.name not in names])

    def change(self, name: str, /, **changes: Any) -> Self:
        """This world with other values for some keys of the obstacle that is called ``name``.

        >>> world = World(size=(4, 4), obstacles=[Box(at=(1, 0), size=(0.5, 0.5), height=0.8)])
        >>> world.change("box 1", at=(1, 1), yaw_deg=30).obstacles[0].at
        (1.0, 1.0)

        Raises:
            WorldError: when no obstacle has that name, or the new world would break the rules.
        """
        changed = {id(obstacle): obstacle.replace(**changes) for obstacle in self._obstacles_called(name)}
        return self.replace(obstacles=[changed.get(id(obstacle), obstacle) for obstacle in self.obstacles])

    def _obstacles_called(self, name: str) -> list[Obstacle]:
        found = [obstacle for obstacle in self.obstacles if obstacle.name == name]
        if not found:
            names = list(dict.fromkeys(obstacle.name for obstacle in self.obstacles))
            meant = difflib.get_close_matches(str(name), names, n=1)
            remedy = (
                f"did you mean {meant[0]!r}?" if meant else f"there are {shown(names)}" if names else "there are none"
            )
            raise WorldError([f"no obstacle is called {shown(name)}; {remedy}"])
        return found

    def _repr_png_(self) -> bytes:
        """How a notebook shows it: the plan view."""
        from navsim.show import plan_png

        return plan_png(self)

    def to_dict(self) -> dict[str, Any]:
        """What a world file holds, without the settings that equal their defaults; :meth:`from_dict` reads it."""
        data: dict[str, Any] = {"format": self.format, "name": self.name, "size": list(self.size)}
        if self.walls != Walls():
            data["walls"] = "none" if self.walls is None else _plain(self.walls)
        data["obstacles"] = [
            {obstacle.kind: _plain(obstacle, without_name=obstacle.name == _default_name(obstacle.kind, i))}
            for i, obstacle in enumerate(self.obstacles)
        ]
        for key, places in (("starts", self.starts), ("goals", self.goals)):
            if isinstance(places, str):
                data[key] = places
            else:
                settings = [_plain(place) for place in places]
                data[key] = [place["at"] if place.keys() == {"at"} else place for place in settings]
        return data

    @cached_property
    def fingerprint(self) -> str:
        """Tells apart worlds in which anything but the name differs, by more than rounding on another machine."""
        data = self.to_dict()
        del data["name"]
        return hashlib.sha256(json.dumps(_rounded(data), sort_keys=True).encode()).hexdigest()

    @cached_property
    def prisms(self) -> tuple[Prism, ...]:
        """Walls first (north, east, south, west), then the obstacles; a concave polygon is several prisms."""
        prisms = [*self._wall_prisms()]
        for i, obstacle in enumerate(self.obstacles):
            for vertices, radius in obstacle.footprints():
                vertices.flags.writeable = False
                prisms.append(Prism(obstacle.name, i, obstacle.base, obstacle.top, vertices, radius))
        return tuple(prisms)

    @cached_property
    def fixed_prisms(self) -> tuple[Prism, ...]:
        """Those of ``prisms`` that neither move nor can be pushed."""
        return tuple(prism for prism in self.prisms if not self._can_move(prism, with_pushable=True))

    @cached_property
    def standing_prisms(self) -> tuple[Prism, ...]:
        """Those of ``prisms`` that do not move by themselves; pushable ones stand where the file puts them."""
        return tuple(prism for prism in self.prisms if not self._can_move(prism, with_pushable=False))

    def _can_move(self, prism: Prism, with_pushable: bool) -> bool:
        if prism.obstacle < 0:
            return False
        obstacle = self.obstacles[prism.obstacle]
        return obstacle.motion is not None or (with_pushable and obstacle.pushable is not None)

    def _wall_prisms(self) -> Iterable[Prism]:
        return () if self.walls is None else walls_around(self.half_size, self.walls.height, self.walls.thickness)

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What other modules work out of this world once and keep with it; neither compared nor pickled."""
        return {}

    @property
    def half_size(self) -> np.ndarray:
        """``(2,)``: the room is ``-half_size <= (x, y) <= half_size``, metres."""
        return 0.5 * np.array(self.size)

    @property
    def random_starts(self) -> bool:
        """Whether each episode draws its start."""
        return isinstance(self.starts, str)

    @property
    def random_goals(self) -> bool:
        """Whether each episode draws its goal."""
        return isinstance(self.goals, str)

    @property
    def paths(self) -> tuple[tuple[int, int], ...]:
        """Every pair (index in ``starts``, index in ``goals``); empty when either is drawn at random."""
        if isinstance(self.starts, str) or isinstance(self.goals, str):
            return ()
        return tuple((i, j) for i in range(len(self.starts)) for j in range(len(self.goals)))

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with the fields of ``update``, unchecked; derived values are left behind, for they may differ."""
        copied = super().model_copy(update=update, deep=deep)
        for key in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[key]
        return copied

    def __hash__(self) -> int:
        return hash((self.name, self.size, len(self.obstacles), self.obstacles[:1]))

    def __getstate__(self) -> dict[Any, Any]:
        """Leaves derived values behind: they are cheaper to make again than to send to another process."""
        state = super().__getstate__()
        fields = {key: value for key, value in state["__dict__"].items() if key in type(self).model_fields}
        return {**state, "__dict__": fields}

    def __repr__(self) -> str:
        walls = "open floor" if self.walls is None else f"{self.walls.height:g} m walls"
        starts = "random starts" if isinstance(self.starts, str) else counted(len(self.starts), "start")
        goals = "random goals" if isinstance(self.goals, str) else counted(len(self.goals), "goal")
        size = f"{self.size[0]:g} x {self.size[1]:g} m"
        return f"World({self.name!r}, {size}, {walls}, {counted(len(self.obstacles), 'obstacle')}, {starts}, {goals})"

    __str__ = __repr__


def parse_world(data: object, default_name: str = "world") -> tuple[World | None, list[Problem]]:
    """The world that ``data`` describes, or None with every problem of it.

    Args:
        data: what a world file holds.
        default_name: name of a world that ``data`` does not name.
    """
    if not isinstance(data, Mapping):
        return None, [Problem((), f"a world is a mapping with keys such as 'format', not {shown(data)}")]
    lacking = [] if "format" in data else [{"type": "missing", "loc": ("format",), "input": data}]
    try:
        world = World.model_validate({"name": default_name, **data})
    except ValidationError as error:
        details = error.errors(include_url=False)
    else:
        return (None, _WORDING.problems(lacking, data)) if lacking else (world, [])
    broken = details[0].get("ctx", {}).get("error")
    if isinstance(broken, _BrokenRulesError):
        return None, [*_WORDING.problems(lacking, data), *broken.problems]
    problems = _WORDING.problems([*lacking, *details[:MOST_TOLD]], data)
    if len(details) > MOST_TOLD:
        text = f"{len(details) - MOST_TOLD} more mistakes are not told; put these right first"
        return None, [*problems, Problem(problems[-1].where if problems else (), text)]
    return None, problems + _rules_broken_by_the_rest(data, problems)


def _sentences(model: type[_Settings], error: ValidationError, settings: Mapping[str, Any]) -> list[str]:
    """What is wrong with the arguments of a model, as for a world file that holds them."""
    details = error.errors(include_url=False)
    broken = details[0].get("ctx", {}).get("error")
    if isinstance(broken, _BrokenRulesError):
        return [str(problem) for problem in broken.problems]
    if issubclass(model, World):
        return [str(problem) for problem in _WORDING.problems(details, settings)]
    name = model.__name__.lower()
    inside = [{**detail, "loc": (name, *detail["loc"])} for detail in details]
    return [str(problem) for problem in _WORDING.problems(inside, {name: settings})]


def _rules_broken_by_the_rest(data: Mapping[str, Any], problems: list[Problem]) -> list[Problem]:
    """The geometric rules that ``data`` breaks even without its faulty parts, so that an author sees all at once."""
    faulty = {problem.where[:2] for problem in problems}
    rest = {key: value for key, value in data.items() if (key,) not in faulty}
    kept: dict[str, list[int]] = {}
    for key in ("obstacles", "starts", "goals"):
        entries = rest.get(key)
        if isinstance(entries, (list, tuple)):
            kept[key] = [i for i in range(len(entries)) if (key, i) not in faulty]
            rest[key] = [_named(entries[i], i) if key == "obstacles" else entries[i] for i in kept[key]]
            if not kept[key] and key != "obstacles":
                return []
        elif key in data and key not in rest and key != "obstacles":
            return []
    try:
        World.model_validate(rest)
    except ValidationError as error:
        broken = error.errors(include_url=False)[0].get("ctx", {}).get("error")
        if isinstance(broken, _BrokenRulesError):
            return [problem._replace(where=_renumbered(problem.where, kept)) for problem in broken.problems]
    return []


def _named(entry: Any, position: int) -> object:
    """An entry of ``obstacles`` that keeps its default name when entries before it are left out."""
    if isinstance(entry, _Obstacle):
        return entry.model_copy(update={"name": entry.name or _default_name(entry.kind, position)})
    ((kind, settings),) = entry.items()
    return {kind: {"name": _default_name(kind, position), **settings}}


def _renumbered(where: tuple[str | int, ...], kept: Mapping[str, list[int]]) -> tuple[str | int, ...]:
    if len(where) > 1 and isinstance(where[0], str) and isinstance(where[1], int) and where[0] in kept:
        return (where[0], kept[where[0]][where[1]], *where[2:])
    return where


def _default_name(kind: str, position: int) -> str:
    return f"{kind} {position + 1}"


def _plain(settings: BaseModel, without_name: bool = False) -> dict[str, Any]:
    return settings.model_dump(mode="json", exclude_defaults=True, exclude={"name"} if without_name else None)


def _rounded(data: Any) -> Any:
    """Plain data whose numbers have nine digits."""
    if isinstance(data, dict):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_rounded(value) for value in data]
    return float(f"{data:.9g}") + 0.0 if isinstance(data, float) else data


_WORDING = Wording(
    {
        "": World,
        **_SHAPES,
        "walls": Walls,
        "starts": Start,
        "start": Start,
        "goals": Goal,
        "goal": Goal,
        "swing": Swing,
        "motion": Motion,
        "pushable": Pushable,
    },
    list(_SHAPES),
)
