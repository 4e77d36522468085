"""What an imported file holds, on its way to a :class:`~navsim.World`: upright prisms, a room, remarks.

Every reader of a foreign format fills in a :class:`Scene` in the file's own coordinates, and :func:`world_of` makes a
world of it: finds or builds the four walls, moves the room's centre to the origin, and says what it did.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from navsim.convert.errors import ConversionError
from navsim.errors import Problem
from navsim.polygon import convex_pieces, crossing_edges, signed_area
from navsim.world import (
    LARGEST_LENGTH,
    MOST_CORNERS,
    MOST_CORNERS_IN_ALL,
    MOST_OBSTACLES,
    SMALLEST_LENGTH,
    Walls,
    World,
    parse_world,
)

DIGITS = 6
"""Decimals of imported lengths in metres, and of yaws in degrees: a micrometre."""
SAME = 5e-4
"""Metres within which walls count as flush, of the same height and of the same thickness."""
_OPTIONAL = ("motion", "pushable")
"""Settings that an obstacle can do without."""
MARGIN = 1.0
"""Metres of free floor around what a file holds that does not say how large its room is."""
_CLEARANCE = 0.5
"""Metres of free floor around a start or goal: a little more than the depth rule wants."""
MOST_SOLIDS = MOST_OBSTACLES
"""Obstacles of one imported file."""
MOST_CUT = 50_000
"""Corners of all outlines that are cut off at the border of the room."""
MOST_POINTS = 2 * MOST_CORNERS_IN_ALL
"""Corners of all outlines of one imported file, those that will be left out included."""


@dataclass(frozen=True)
class Room:
    """The room that an imported file is put into, where the file itself does not say.

    Coordinates are the file's own; what was found is moved so that the room's centre becomes the origin.
    """

    size: tuple[float, float] | None = None
    """Extents along x and y, metres; by default what the file says, or else what is in it with ``margin``."""
    margin: float | None = None
    """Free floor around what is in a file that does not say how large its room is, metres; 1 m by default."""
    walls: bool = True
    """Whether to build four walls, 2 m high, around a room that has none."""
    starts: tuple[tuple[float, float], ...] = ()
    """Where episodes begin, metres; by default what the file says, or else drawn each episode."""
    goals: tuple[tuple[float, float], ...] = ()
    """Where episodes are to end, metres; by default what the file says, or else drawn each episode."""

    def __post_init__(self) -> None:
        for name, values in (("size", self.size or ()), ("margin", () if self.margin is None else (self.margin,))):
            if not all(math.isfinite(value) and value >= 0.0 for value in values):
                raise ValueError(f"room {name} must be finite and not negative, in metres; got {getattr(self, name)!r}")
        if self.size is not None and not all(SMALLEST_LENGTH <= value <= LARGEST_LENGTH for value in self.size):
            raise ValueError(f"room size must be two lengths up to {LARGEST_LENGTH:g} m; got {self.size!r}")
        for name in ("starts", "goals"):
            if not all(math.isfinite(value) for place in getattr(self, name) for value in place):
                raise ValueError(f"room {name} must be finite, in metres; got {getattr(self, name)!r}")


class Place(NamedTuple):
    """A start or a goal, metres and radians."""

    x: float
    y: float
    yaw: float | None = None


@dataclass(frozen=True)
class Solid:
    """An upright prism, in a file's own coordinates: metres and radians."""

    name: str
    kind: Literal["box", "cylinder", "polygon"]
    base: float
    top: float
    centre: tuple[float, float] = (0.0, 0.0)
    """Of a box or cylinder."""
    size: tuple[float, float] = (0.0, 0.0)
    """Of a box, along its own axes."""
    yaw: float = 0.0
    """Of a box."""
    radius: float = 0.0
    """Of a cylinder."""
    points: tuple[tuple[float, float], ...] = ()
    """Corners of a polygon."""
    motion: dict[str, Any] | None = None
    """As in a world file, but for the origin."""
    mass: float | None = None
    """Of what can be pushed, kilograms."""

    def corners(self) -> Sequence[tuple[float, float]]:
        """The footprint's corners, or those of a cylinder's bounding square, metres."""
        if self.kind == "polygon":
            return self.points
        x, y = self.centre
        if self.kind == "cylinder":
            along, across = (self.radius, 0.0), (0.0, self.radius)
        else:
            cos, sin = 0.5 * math.cos(self.yaw), 0.5 * math.sin(self.yaw)
            along, across = (self.size[0] * cos, self.size[0] * sin), (-self.size[1] * sin, self.size[1] * cos)
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return [(x + a * along[0] + b * across[0], y + a * along[1] + b * across[1]) for a, b in signs]

    @property
    def volume(self) -> float:
        """Cubic metres."""
        area = {
            "box": self.size[0] * self.size[1],
            "cylinder": math.pi * self.radius**2,
            "polygon": abs(signed_area(self.points)) if self.points else 0.0,
        }[self.kind]
        return area * (self.top - self.base)

    def stands_in(self, low: Sequence[float], high: Sequence[float]) -> bool:
        """Whether all points that a world file wants inside the room are between two corners of a rectangle."""
        points = self.points if self.kind == "polygon" else [self.centre]
        return all(low[0] <= x <= high[0] and low[1] <= y <= high[1] for x, y in points)


@dataclass
class Scene:
    """What was read from a file."""

    source: str
    """The file's name, for errors."""
    name: str
    solids: list[Solid] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What could not be kept as it was, one sentence each."""
    starts: list[Place] = field(default_factory=list)
    goals: list[Place] = field(default_factory=list)
    floor: float = 0.0
    """Height of the floor, metres."""
    low: tuple[float, float] | None = None
    """Corner of the room with the least x and y, metres, if the file says."""
    high: tuple[float, float] | None = None
    """The opposite corner."""
    walls: Walls | Literal["none", "unsaid"] = "unsaid"
    """What stands around the room, if the file says."""
    turned: float = 0.0
    """Radians by which everything here is turned, clockwise about the origin, against the file's own coordinates, so
    that the room lies along the axes."""
    built: Walls = field(default_factory=Walls)
    """The walls to build around a room without any."""
    corners: int = 0
    """Of all outlines together."""

    def add(self, solid: Solid) -> None:
        """Takes up a solid.

        Raises:
            ConversionError: when there are too many.
        """
        if len(self.solids) >= MOST_SOLIDS:
            raise ConversionError(self.source, 0, f"holds more than {MOST_SOLIDS} obstacles; split it")
        self.corners += len(solid.points)
        if self.corners > MOST_POINTS:
            raise ConversionError(self.source, 0, f"holds outlines of more than {MOST_POINTS} corners; split it")
        self.solids.append(solid)


def world_of(scene: Scene, room: Room | None = None) -> tuple[World, list[str]]:
    """The world that a scene makes, and everything that is worth knowing about how it came to be.

    Raises:
        ConversionError: when it makes none that keeps the rules of world files.
    """
    room = room or Room()
    data, notes = data_of(scene, room)
    world, problems = parse_world(data)
    if world is None and all(_can_be_spared(problem, room, data) for problem in problems):
        notes += [f"left out, because a world file cannot have it so: {problem}" for problem in problems]
        world, problems = parse_world(_without(data, problems))
    if world is None:
        first, others = problems[0], len(problems) - 1
        more = f" (and {others} more like it)" if others else ""
        settings = "size or margin" if scene.low is None else "size"
        raise ConversionError(
            scene.source, 0, f"what it holds makes no world that can be used: {first}{more}; give the room another "
            f"{settings}, or name starts and goals that are free"
        )  # fmt: skip
    return world, notes


def _can_be_spared(problem: Problem, room: Room, data: dict[str, Any]) -> bool:
    """Whether a problem is with something that moves or can be pushed, which may stand still instead, or with a place
    that nobody has asked for: the file's own robots' it is."""
    what, *more = problem.where or ("",)
    if what in ("starts", "goals"):
        return bool(more) and not getattr(room, what)
    if what != "obstacles" or not more:
        return False
    return any(key in settings for settings in data["obstacles"][more[0]].values() for key in _OPTIONAL)


def _without(data: dict[str, Any], problems: list[Problem]) -> dict[str, Any]:
    """``data`` without the starts, goals and motions that have ``problems``."""
    rest = dict(data)
    for key in ("starts", "goals"):
        faulty = {problem.where[1] for problem in problems if problem.where[0] == key}
        if faulty:
            rest[key] = [place for i, place in enumerate(data[key]) if i not in faulty] or "random"
    still = {problem.where[1] for problem in problems if problem.where[0] == "obstacles"}
    rest["obstacles"] = [
        {kind: {key: value for key, value in settings.items() if i not in still or key not in _OPTIONAL}}
        for i, entry in enumerate(data["obstacles"])
        for kind, settings in entry.items()
    ]
    return rest


def data_of(scene: Scene, room: Room) -> tuple[dict[str, Any], list[str]]:
    """What a world file of the scene holds, and the notes."""
    notes = list(scene.notes)
    solids = _above_the_floor(_sound(scene.solids, notes), scene.floor, notes)
    low, high, walls, solids = _room_around(scene, solids, room, notes)
    centre = 0.5 * (low + high)
    if scene.turned:
        x, y = _rotated(centre, scene.turned)
        notes.append(
            f"the file is turned by {math.degrees(scene.turned):.4g} degrees: the world is turned back by as much, and "
            f"its origin is the room's centre, ({x:g}, {y:g}) in the file"
        )
    elif np.abs(centre).max() > 10.0**-DIGITS:
        notes.append(
            f"the room's centre, ({centre[0]:g}, {centre[1]:g}) in the file, is the origin of the world: everything is "
            f"moved by ({_plain(-centre[0]):g}, {_plain(-centre[1]):g}) m"
        )
    size = [_rounded(side) for side in high - low]
    half = 0.5 * np.array(size)
    larger = "--size or --margin make" if scene.low is None else "--size makes"
    inside: list[dict[str, Any]] = []
    least, most = (centre - half - 10.0**-DIGITS).tolist(), (centre + half + 10.0**-DIGITS).tolist()
    cut = 0
    for solid in solids:
        if solid.stands_in(least, most):
            inside.append(_obstacle(solid, centre, half))
            continue
        pieces: list[Solid] = []
        if not solid.motion and _reaches_into(solid, centre - half, centre + half):
            outline = _outline(solid)
            cut += len(outline)
            if cut > MOST_CUT:
                text = f"outlines of more than {MOST_CUT} corners reach out of the room; make it larger with --size"
                raise ConversionError(scene.source, 0, text)
            pieces = _cut_to(solid, outline, centre - half, centre + half)
        inside += [_obstacle(piece, centre, half) for piece in pieces]
        what = "reaches out of the room and is cut off there" if pieces else "stands outside the room and is left out"
        notes.append(f"'{solid.name}' {what}; {larger} the room larger")
    data: dict[str, Any] = {"format": 1, "name": scene.name or "world", "size": size}
    if walls is None:
        data["walls"] = "none"
    else:
        data["walls"] = {"height": _rounded(walls.height), "thickness": _rounded(walls.thickness)}
    data["obstacles"] = inside
    data["starts"] = _places(room.starts, scene.turned, scene.starts, centre)
    data["goals"] = _places(room.goals, scene.turned, scene.goals, centre)
    for key in ("starts", "goals"):
        if data[key] == "random":
            notes.append(f"{key} are drawn at random each episode; --{key} X Y lists them")
    return data, notes


def _sound(solids: list[Solid], notes: list[str]) -> list[Solid]:
    """The solids that a world file can hold, each with a name of its own."""
    names = Counter(solid.name for solid in solids)
    number: Counter[str] = Counter()
    sound = []
    for solid in solids:
        name = own = " ".join(solid.name.split()) or solid.kind
        if names[solid.name] > 1:
            while name == own or name in names:
                number[solid.name] += 1
                name = f"{own} {number[solid.name]}"
        flaw = _flaw(solid)
        if flaw:
            notes.append(f"'{name}' {flaw}; it is left out")
        else:
            yaw = _snapped(solid.yaw, max(solid.size))
            sound.append(replace(solid, name=name, yaw=yaw, points=_without_repeats(solid.points)))
    return sound


def _flaw(solid: Solid) -> str:
    """Why a world file cannot hold ``solid``; empty when it can."""
    lengths = {"box": solid.size, "cylinder": (solid.radius,), "polygon": ()}[solid.kind]
    values = [*lengths, *itertools.chain(*solid.corners()), solid.base, solid.top]
    if not all(math.isfinite(value) and abs(value) <= LARGEST_LENGTH for value in values):
        return f"is larger or farther away than {LARGEST_LENGTH:g} m"
    if any(length < 10.0**-DIGITS for length in (*lengths, solid.top - solid.base)):
        return "is thinner than a micrometre"
    if solid.kind == "polygon":
        points = _without_repeats(solid.points)
        if len(points) > MOST_CORNERS:
            return f"has an outline of {len(points)} corners, more than {MOST_CORNERS}"
        if len(points) < 3 or abs(signed_area(points)) < 10.0**-DIGITS * 10.0**-DIGITS:
            return "has an outline without an inside"
        if crossing_edges(points) is not None:
            return "has an outline that crosses or touches itself"
    return ""


def _without_repeats(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """The corners of an outline, rounded, without those that repeat the one before; the last may repeat the first."""
    rounded = [(round(x, DIGITS + 3), round(y, DIGITS + 3)) for x, y in points]
    return tuple(
        point for i, point in enumerate(rounded) if math.dist(point, rounded[i - 1]) >= 2.0 * 10.0**-DIGITS
    )  # fmt: skip


def _above_the_floor(solids: list[Solid], floor: float, notes: list[str]) -> list[Solid]:
    """The solids with heights over the floor, without what lies under it."""
    standing, sunk, cut = [], [], []
    for solid in solids:
        base, top = solid.base - floor, solid.top - floor
        if top <= (1e-3 if base < -1e-9 else 1e-9):
            sunk.append(solid.name)
            continue
        if base < -1e-3:
            cut.append(solid.name)
        base = base if base > 1e-9 else 0.0
        standing.append(solid if (base, top) == (solid.base, solid.top) else replace(solid, base=base, top=top))
    if sunk:
        notes.append(f"what lies under the floor is left out: {_listed(sunk)}")
    if cut:
        notes.append(f"what reaches under the floor is cut off there: {_listed(cut)}")
    return standing


def _room_around(
    scene: Scene, solids: list[Solid], room: Room, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, Walls | None, list[Solid]]:
    """Corners ``(2,)`` of the room in the file's coordinates, its walls, and the solids that are not its walls."""
    found = _enclosure(solids) if scene.walls == "unsaid" else None
    if found is not None and room.size is not None:
        notes.append(
            f"{_listed([solid.name for solid in found.walls])} enclose a room of {found.size[0]:g} x {found.size[1]:g} "
            f"m, and are obstacles, since --size asks for another; leave it out and they become the walls"
        )
    elif found is not None:
        notes.append(
            f"{_listed([solid.name for solid in found.walls])} enclose a room of {found.size[0]:g} x {found.size[1]:g} "
            f"m: they became its walls"
        )
        if found.open_corners:
            notes.append("those walls do not meet in all corners; they do in the world")
        rest = [solid for solid in solids if not any(solid is wall for wall in found.walls)]
        return found.low, found.high, Walls(height=found.height, thickness=found.thickness), rest
    if scene.low is not None and scene.high is not None:
        low, high = np.array(scene.low), np.array(scene.high)
        if room.size is not None:
            centre = 0.5 * (low + high)
            low, high = centre - 0.5 * np.array(room.size), centre + 0.5 * np.array(room.size)
    elif not solids and room.size is None:
        text = "holds nothing that can stand in a room; --approximate may help, and --size makes an empty room"
        lost = next((note for note in notes if "left out" in note), "")
        raise ConversionError(scene.source, 0, f"{text} ({lost})" if lost else text)
    else:
        corners = np.array([corner for solid in solids for corner in solid.corners()] or [(0.0, 0.0)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        if room.size is None:
            places = [*(room.starts or scene.starts), *(room.goals or scene.goals)]
            around = np.array([place[:2] for place in places]).reshape(-1, 2)
            margin = MARGIN if room.margin is None else room.margin
            clearance = min(margin, _CLEARANCE)
            low = np.min([low - margin, *(around - clearance)], axis=0)
            high = np.max([high + margin, *(around + clearance)], axis=0)
            notes.append(
                f"no four walls enclose a room: it holds what there is and {margin:g} m around, {clearance:g} m "
                "around starts and goals; --margin or --size change that"
            )
        else:
            centre = 0.5 * (low + high)
            low, high = centre - 0.5 * np.array(room.size), centre + 0.5 * np.array(room.size)
    if (high - low).max() > LARGEST_LENGTH:
        raise ConversionError(scene.source, 0, f"needs a room larger than {LARGEST_LENGTH:g} m; give --size")
    if isinstance(scene.walls, Walls):
        return low, high, scene.walls, solids
    if scene.walls == "none" or not room.walls:
        return low, high, None, solids
    notes.append(
        f"the file has no walls around its room: four of {scene.built.height:g} m height are built; "
        "--open-floor leaves them out"
    )
    return low, high, scene.built, solids


class _Enclosure(NamedTuple):
    """Four boxes that are a room's walls."""

    walls: tuple[Solid, ...]
    low: np.ndarray
    high: np.ndarray
    height: float
    thickness: float
    open_corners: bool

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low


def _enclosure(solids: list[Solid]) -> _Enclosure | None:
    """Four boxes that enclose all else: as high and as thick as each other, along the axes, and nothing beside them."""
    if len(solids) < 4:
        return None
    boxes = [solid for solid in solids if solid.kind == "box" and solid.base <= SAME and solid.mass is None]
    boxes = [box for box in boxes if box.motion is None]
    upright: list[tuple[Solid, np.ndarray, np.ndarray]] = []
    for box in boxes:
        corners = np.array(box.corners())
        low, high = corners.min(axis=0), corners.max(axis=0)
        if box.yaw == 0.5 * math.pi * round(box.yaw / (0.5 * math.pi)):
            upright.append((box, low, high))
    if len(upright) < 4:
        return None
    # Whatever encloses everything reaches farthest out.
    all_corners = np.array([corner for solid in solids for corner in solid.corners()])
    outer_low, outer_high = all_corners.min(axis=0), all_corners.max(axis=0)
    candidates = [
        [entry for entry in upright if abs(entry[2][1] - outer_high[1]) <= SAME],
        [entry for entry in upright if abs(entry[2][0] - outer_high[0]) <= SAME],
        [entry for entry in upright if abs(entry[1][1] - outer_low[1]) <= SAME],
        [entry for entry in upright if abs(entry[1][0] - outer_low[0]) <= SAME],
    ]
    if any(len(entries) > 8 for entries in candidates):
        return None
    for four in itertools.product(*candidates):
        found = _enclosed_by(four, outer_low, outer_high)
        if found is None:
            continue
        rest = [solid for solid in solids if not any(solid is wall for wall in found.walls)]
        low, high = (found.low - SAME).tolist(), (found.high + SAME).tolist()
        if all(solid.stands_in(low, high) for solid in rest):
            return found
    return None


def _enclosed_by(four: tuple[Any, ...], outer_low: np.ndarray, outer_high: np.ndarray) -> _Enclosure | None:
    """The room between a north, an east, a south and a west wall, if that is what these boxes are."""
    (north, north_low, north_high), (east, east_low, east_high), (south, south_low, south_high), west_entry = four
    west, west_low, west_high = west_entry
    if len({id(north), id(east), id(south), id(west)}) < 4:
        return None
    low = np.array([west_high[0], south_high[1]])
    high = np.array([east_low[0], north_low[1]])
    if (high - low).min() <= 0.1:
        return None
    thicknesses = (outer_high[1] - high[1], outer_high[0] - high[0], low[1] - outer_low[1], low[0] - outer_low[0])
    heights = [box.top for box in (north, east, south, west)]
    if max(heights) - min(heights) > SAME or max(thicknesses) - min(thicknesses) > SAME:
        return None
    spans = (
        (north_low[0], north_high[0], low[0], high[0]),
        (south_low[0], south_high[0], low[0], high[0]),
        (east_low[1], east_high[1], low[1], high[1]),
        (west_low[1], west_high[1], low[1], high[1]),
    )
    if any(begin > inner_begin + SAME or end < inner_end - SAME for begin, end, inner_begin, inner_end in spans):
        return None
    t = float(np.mean(thicknesses))
    across = (north_low[0], south_low[0], north_high[0], south_high[0])
    along = (west_low[1], east_low[1], west_high[1], east_high[1])
    corners = [  # of the ring: closed by the one wall or the other
        across[0] <= low[0] - t + SAME or along[2] >= high[1] + t - SAME,
        across[1] <= low[0] - t + SAME or along[0] <= low[1] - t + SAME,
        across[2] >= high[0] + t - SAME or along[3] >= high[1] + t - SAME,
        across[3] >= high[0] + t - SAME or along[1] <= low[1] - t + SAME,
    ]
    return _Enclosure((north, east, south, west), low, high, float(np.mean(heights)), t, not all(corners))


def _obstacle(solid: Solid, centre: np.ndarray, half: np.ndarray) -> dict[str, Any]:
    """An entry of ``obstacles``."""
    # Half of an odd number of micrometres is none, and would be rounded to outside.
    middle, limits = centre.tolist(), (np.floor(half * 10**DIGITS + 1e-3) / 10**DIGITS).tolist()

    def moved(point: Sequence[float]) -> list[float]:
        return [_rounded(min(max(p - c, -h), h)) for p, c, h in zip(point, middle, limits, strict=True)]

    settings: dict[str, Any] = {"name": solid.name}
    if solid.kind == "polygon":
        settings["points"] = [moved(point) for point in solid.points]
    else:
        settings["at"] = moved(solid.centre)
    if solid.kind == "box":
        settings["size"] = [_rounded(solid.size[0]), _rounded(solid.size[1])]
        yaw = _rounded(math.degrees(solid.yaw))
        if yaw:
            settings["yaw_deg"] = yaw
    if solid.kind == "cylinder":
        settings["radius"] = _rounded(solid.radius)
    base = _rounded(solid.base)
    if base:
        settings["base"] = base
    settings["height"] = max(_rounded(solid.top - base), 10.0**-DIGITS)
    if solid.motion is not None:
        path = [[_rounded(x - centre[0]), _rounded(y - centre[1])] for x, y in solid.motion["path"]]
        settings["motion"] = {**solid.motion, "path": path}
    if solid.mass is not None:
        settings["pushable"] = {"mass": _rounded(solid.mass)}
    return {solid.kind: settings}


def _reaches_into(solid: Solid, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether the upright rectangle around ``solid`` overlaps the one between two corners ``(2,)``."""
    corners = np.array(solid.corners())
    return bool((corners.min(axis=0) < high).all() and (corners.max(axis=0) > low).all())


def _outline(solid: Solid) -> np.ndarray:
    """``(V, 2)``: the corners of the footprint; of a cylinder, those of a polygon within ``SAME`` of it."""
    if solid.kind != "cylinder":
        return np.array(solid.corners())
    count = 4 * math.ceil(0.5 * math.pi * math.sqrt(solid.radius / (2.0 * SAME)) + 2.0)
    angles = np.arange(count) * math.tau / count
    circle: np.ndarray = solid.centre + solid.radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return circle


def _cut_to(solid: Solid, outline: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[Solid]:
    """The convex pieces of what ``solid`` has between two corners ``(2,)`` of a rectangle, as polygons."""
    convex_outlines = [outline] if solid.kind == "cylinder" else convex_pieces(outline.tolist())
    pieces: list[Solid] = []
    for convex in convex_outlines:
        corners = np.array(convex)
        for axis, bound, sign in ((0, low[0], 1.0), (0, high[0], -1.0), (1, low[1], 1.0), (1, high[1], -1.0)):
            corners = _cut_at(corners, sign * (corners[:, axis] - bound)) if len(corners) else corners
        points = _without_repeats(tuple((float(x), float(y)) for x, y in corners))
        name = solid.name if not pieces else f"{solid.name} piece {len(pieces) + 1}"
        piece = Solid(name, "polygon", solid.base, solid.top, points=points, mass=solid.mass)
        if len(points) >= 3 and not _flaw(piece):
            pieces.append(piece)
    return pieces


def _cut_at(corners: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """A convex polygon where ``inside`` ``(V,)``, linear over the plane, is not negative (Sutherland and Hodgman)."""
    next_inside = np.roll(inside, -1)
    crosses = inside * next_inside < 0.0
    share = inside / np.where(crosses, inside - next_inside, 1.0)
    crossings = corners + share[:, None] * (np.roll(corners, -1, axis=0) - corners)
    return np.stack([corners, crossings], axis=1)[np.column_stack([inside >= 0.0, crosses])]


def _snapped(yaw: float, extent: float) -> float:
    """``yaw``, or the multiple of a right angle that its author has rounded; within (−π, π], radians."""
    right = 0.5 * math.pi
    nearest = right * round(yaw / right)
    if abs(yaw - nearest) * extent <= 1e-4:
        yaw = nearest
    wrapped = math.remainder(yaw, math.tau)
    return math.pi if wrapped <= -math.pi + 1e-12 else wrapped


def _rotated(place: Sequence[float] | np.ndarray, angle: float) -> tuple[float, float]:
    """A place turned counterclockwise about the origin."""
    (x, y), cosine, sine = place, math.cos(angle), math.sin(angle)
    return float(cosine * x - sine * y), float(sine * x + cosine * y)


def _places(asked: tuple[tuple[float, float], ...], turned: float, found: list[Place], centre: np.ndarray) -> Any:
    """What ``starts`` or ``goals`` of a world file hold: what is ``asked`` for in the file's own coordinates, or else
    what is ``found`` in the scene's."""
    places = [Place(*_rotated(place, -turned)) for place in asked] or found
    if not places:
        return "random"
    entries: list[Any] = []
    for place in places:
        at = [_rounded(place.x - centre[0]), _rounded(place.y - centre[1])]
        yaw = None if place.yaw is None else _rounded(math.degrees(math.remainder(place.yaw, math.tau)))
        entries.append(at if yaw is None else {"at": at, "yaw_deg": yaw})
    return entries


def _rounded(value: float) -> float:
    return _plain(round(float(value), DIGITS))


def _plain(value: float) -> float:
    """``value`` without a negative zero."""
    return value + 0.0


def _listed(names: list[str], most: int = 5) -> str:
    """``names`` as they read in a sentence."""
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown
