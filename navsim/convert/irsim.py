"""IR-SIM worlds: the YAML files of https://github.com/hanruihua/ir-sim, of its version 2.

IR-SIM is flat, so heights are a setting. Obstacles that go round by themselves get a ``motion``; what is drawn at
random when IR-SIM starts cannot be had again, and is named in the remarks.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from navsim.convert.images import read_image
from navsim.convert.raster import IntricateError, check_borders, fill_pockets, outlines
from navsim.convert.scene import Place, Room, Scene, Solid, world_of
from navsim.convert.yamlfile import Node, read_yaml
from navsim.errors import counted
from navsim.robot import TURTLEBOT2
from navsim.world import MOST_PLACES, Walls, World

LINE_THICKNESS = 0.02
"""Metres: what lines become, which have none."""
MOST_OBJECTS = 10_000
"""Obstacles or robots of one entry."""

Pose = tuple[float, float, float]
_NO_POSE: Pose = (0.0, 0.0, 0.0)


def load_irsim(
    path: str | os.PathLike[str], *, wall_height: float = 2.0, room: Room | None = None
) -> tuple[World, list[str]]:
    """The world of an IR-SIM file: obstacles, and the robots' states and goals as starts and goals.

    Args:
        path: the YAML file.
        wall_height: of everything in the world, metres; IR-SIM tells none.
        room: starts, goals, and a size other than the file's.

    Raises:
        ConversionError: when the file cannot be used.
    """
    return world_of(read_irsim(path, wall_height), room)


def read_irsim(path: str | os.PathLike[str], wall_height: float = 2.0) -> Scene:
    """What an IR-SIM file holds; :func:`load_irsim` makes a world of it."""
    if not (math.isfinite(wall_height) and wall_height > 0.0):
        raise ValueError(f"wall_height must be greater than 0, in metres; got {wall_height!r}")
    root = read_yaml(path).mapping("a mapping with keys such as 'world', 'robot' and 'obstacle'")
    if not any(root.get(key) for key in ("world", "robot", "obstacle")):
        raise root.error("has none of the keys 'world', 'robot' and 'obstacle'; name an IR-SIM file")
    return _Reader(root, Path(path), wall_height).scene


_LUMINANCE = (0.2989, 0.5870, 0.1140)  # of red, green and blue, by which IR-SIM tells a picture's free floor


class _Reader:
    def __init__(self, root: Node, path: Path, height: float) -> None:
        self.scene = Scene(str(path), path.stem, built=Walls(height=height))
        self._height, self._notes = height, self.scene.notes
        world = root.get("world")
        if world is not None:
            world.mapping("settings such as {height: 10, width: 10}")
        self._width, self._depth = (_length(world, key, 10.0) for key in ("width", "height"))
        offset = world.get("offset") if world is not None else None
        x, y = offset.numbers(2, 2) if offset is not None else (0.0, 0.0)
        self._offset = (x, y)
        self.scene.low, self.scene.high = (x, y), (x + self._width, y + self._depth)
        if world is not None and world.get("obstacle_map") is not None:
            self._read_map(world, path)
        for key, read in (("obstacle", self._obstacles), ("robot", self._robots)):
            group = root.get(key)
            for i, entry in enumerate(group.entries if group is not None else [], start=1):
                read(entry.mapping("settings such as {shape: {name: circle, radius: 0.2}, state: [1, 1, 0]}"), i)
        if self.scene.solids:
            self._notes.append(f"obstacles are {height:g} m high (--height changes that); IR-SIM tells no heights")

    def _read_map(self, world: Node, path: Path) -> None:
        image = world.need("obstacle_map", "map.png")
        if isinstance(image.value, dict):  # what a name alone is short for
            kind = image.get("name")
            if kind is None or kind.value != "image":
                self._notes.append("the generated obstacle_map is left out: only pictures are read")
                return
            image = image.need("path", "map.png")
        if not isinstance(image.value, str):
            raise image.error("must be the name of a picture, such as map.png")
        file = path.parent / image.value if "\0" not in image.value else path.parent / "map.png"
        brightness, _ = read_image(file, _LUMINANCE)
        step = world.get("mdownsample") or Node(1, world.file, world.line, "mdownsample")
        every = int(step.number())
        if every < 1:
            raise step.error(f"must be at least 1, not {every}")
        occupied = (brightness < 127.5)[::-1][::every, ::every]
        cell = np.array([self._width / occupied.shape[1], self._depth / occupied.shape[0]])
        try:
            check_borders(occupied)
            occupied, filled = fill_pockets(occupied, TURTLEBOT2.radius / cell.min())
            found = list(outlines(occupied, 0.75))
        except IntricateError as error:
            raise image.error(f"its occupied cells {error}") from None
        if filled:
            self._notes.append(
                f"{filled} pockets of the obstacle map, walled in and too small for the robot, are filled"
            )
        for number, outline in enumerate(found, start=1):
            points = tuple((float(x), float(y)) for x, y in outline * cell + self._offset)
            self.scene.add(Solid(f"patch {number}", "polygon", 0.0, self._height, points=points))

    def _obstacles(self, entry: Node, number: int) -> None:
        for i, (state, goals, count) in enumerate(self._states(entry, f"obstacle {number}")):
            label = f"obstacle {number}" if count == 1 else f"obstacle {number}.{i + 1}"
            passable = _nth(entry, "unobstructed", i)
            if passable is not None and passable.truth():
                self._notes.append(f"'{label}' is left out: it is unobstructed, so nothing bumps into it")
                continue
            name = _nth(entry, "name", i)
            if name is not None and isinstance(name.value, str):
                label = name.value
            motion = self._motion(entry, i, label, state, goals)
            for solid in self._solids(_nth(entry, "shape", i), entry, label, state):
                if motion is not None:
                    dx, dy = (a - b for a, b in zip(_middle(solid), state, strict=False))
                    path = [(x + dx, y + dy) for x, y in motion[0]]
                    described = {"path": path, "speed": motion[1]}
                    if len(path) > 2:
                        described["repeat"] = "circuit"
                    solid = Solid(**{**vars(solid), "motion": described})
                self.scene.add(solid)

    def _robots(self, entry: Node, number: int) -> None:
        for state, goals, _ in self._states(entry, f"robot {number}"):
            start = Place(state[0], state[1], state[2])
            if start not in self.scene.starts:
                self.scene.starts.append(start)
            for x, y in goals:
                if Place(x, y) not in self.scene.goals:
                    self.scene.goals.append(Place(x, y))
            for key, places in (("state", self.scene.starts), ("goal", self.scene.goals)):
                if len(places) > MOST_PLACES:
                    where = entry.get(key) or entry
                    raise where.error(f"robots have more than {MOST_PLACES} different {key}s; leave some robots out")

    def _states(self, entry: Node, label: str) -> Iterator[tuple[Pose, list[tuple[float, float]], int]]:
        """State, goals and number of the objects of an entry; none of those that IR-SIM draws at random."""
        count_entry = entry.get("number")
        count = int(count_entry.number()) if count_entry is not None else 1
        if count_entry is not None and not 0 <= count <= MOST_OBJECTS:
            raise count_entry.error(f"must lie between 0 and {MOST_OBJECTS}, not {count}")
        distribution = entry.get("distribution")
        if distribution is not None:
            distribution.mapping("settings such as {name: manual}")
        how = distribution.get("name") if distribution is not None else None
        how = how or Node("manual", entry.file, entry.line, "distribution.name")
        kind = how.word()
        if kind == "random":
            self._notes.append(
                f"'{label}' is left out: IR-SIM draws its {counted(count, 'object')} anew each time "
                "(distribution random)"
            )
            return
        if kind == "circle" and distribution is not None:
            yield from self._circle(distribution, count)
            return
        if kind != "manual":
            raise how.error(f"must be manual, circle or random, not '{kind}'")
        for i in range(count):
            state = _nth(entry, "state", i)
            x, y, yaw = (*(state.numbers(2, 6) if state is not None else (1.0, 1.0, 0.0)), 0.0)[:3]
            goal = _nth(entry, "goal", i)
            goals: list[tuple[float, float]] = []
            if goal is not None:
                # One goal, or a list of them on the way.
                for place in [goal] if goal.is_numbers() else goal.entries:
                    gx, gy, *_ = place.numbers(2, 6)
                    goals.append((gx, gy))
            yield (x, y, yaw), goals, count

    def _circle(self, distribution: Node, count: int) -> Iterator[tuple[Pose, list[tuple[float, float]], int]]:
        """Evenly around a circle, each facing its goal on the other side."""
        entry = distribution.get("radius")
        radius = entry.number() if entry is not None else min(self._width, self._depth) / 2.0 - 0.5
        entry = distribution.get("center")
        middle = (self._offset[0] + 0.5 * self._width, self._offset[1] + 0.5 * self._depth)
        x, y = entry.numbers(2, 3)[:2] if entry is not None else middle
        for i in range(count):
            angle = math.tau * i / count
            dx, dy = radius * math.cos(angle), radius * math.sin(angle)
            yield (x + dx, y + dy, angle - math.pi), [(x - dx, y - dy)], count

    def _motion(
        self, entry: Node, i: int, label: str, state: Pose, goals: list[tuple[float, float]]
    ) -> tuple[list[tuple[float, float]], float] | None:
        """Way and speed of an obstacle that goes round for ever; None for one that stands still here."""
        behaviour, kinematics = _nth(entry, "behavior", i), _nth(entry, "kinematics", i)
        moves = kinematics is not None and isinstance(kinematics.value, dict) and kinematics.get("name") is not None
        if not moves or kinematics is None or kinematics.need("name", "omni").value == "static":
            return None
        if behaviour is None or not isinstance(behaviour.value, dict):
            return None
        flags = {key: behaviour.get(key) for key in ("loop", "wander")}
        if flags["wander"] is not None and flags["wander"].truth():
            self._notes.append(f"'{label}' stands still: IR-SIM draws its goals at random (wander)")
            return None
        if not goals or flags["loop"] is None or not flags["loop"].truth():
            self._notes.append(f"'{label}' stands still: it goes somewhere once, and a 'motion' is for ever (no loop)")
            return None
        kind = behaviour.get("name")
        if kind is None or kind.value != "dash":
            self._notes.append(f"'{label}' follows its goals in straight lines and makes way for nobody")
        path = [(state[0], state[1])]
        path += [goal for before, goal in zip([path[0], *goals], goals, strict=False) if math.dist(before, goal) > 1e-6]
        if len(path) < 2:
            return None
        fastest = _nth(entry, "vel_max", i)
        speed = abs(fastest.numbers(1, 3)[0]) if fastest is not None else 1.0
        if speed < 1e-6:
            return None
        if math.dist(path[-1], path[0]) <= 1e-6:
            path.pop()  # a circuit leads back by itself
        elif len(goals) > 1:
            self._notes.append(f"'{label}' passes its first place on every round, as it does not in IR-SIM")
        return path, speed

    def _solids(self, shape: Node | None, entry: Node, label: str, state: Pose, depth: int = 0) -> Iterator[Solid]:
        """The prisms of a shape at a state."""
        kind = "circle"
        if shape is not None:
            kind = shape.mapping("settings such as {name: circle, radius: 0.2}").need("name", "circle").word()
            drawn = shape.get("random_shape")
            if drawn is not None and drawn.truth():
                self._notes.append(f"'{label}' is left out: IR-SIM draws its shape anew each time (random_shape)")
                return
        x, y, yaw = state
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])

        def placed(points: object) -> tuple[tuple[float, float], ...]:
            return tuple((float(a), float(b)) for a, b in np.asarray(points, dtype=float) @ turn + [x, y])

        wheelbase = shape.get("wheelbase") if shape is not None else None
        if kind == "circle":
            middle = shape.get("center") if shape is not None else None
            cx, cy = middle.numbers(2, 2) if middle is not None else (0.0, 0.0)
            cx += 0.5 * wheelbase.number() if wheelbase is not None else 0.0
            centre = placed([(cx, cy)])[0]
            radius = _length(shape, "radius", 0.2)
            yield Solid(label, "cylinder", 0.0, self._height, centre=centre, radius=radius)
        elif kind == "rectangle":
            length, width = _length(shape, "length", 1.0), _length(shape, "width", 1.0)
            ahead = 0.5 * wheelbase.number() if wheelbase is not None else 0.0
            yield Solid(label, "box", 0.0, self._height, placed([(ahead, 0.0)])[0], (length, width), yaw)
        elif kind == "polygon":
            corners = shape.get("vertices") if shape is not None else None
            square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            points = [tuple(corner.numbers(2, 2)) for corner in corners.entries] if corners is not None else square
            yield Solid(label, "polygon", 0.0, self._height, points=placed(points))
        elif kind == "linestring" and shape is not None:
            corners = shape.need("vertices", "[[0, 0], [1, 0]]")
            line = placed([corner.numbers(2, 2) for corner in corners.entries])
            self._notes.append(f"'{label}' is a line: it becomes {1e3 * LINE_THICKNESS:g} mm thick")
            for number, (a, b) in enumerate(itertools.pairwise(line), start=1):
                along = (b[0] - a[0], b[1] - a[1])
                length = math.hypot(*along)
                if length > 1e-6:
                    yield Solid(
                        f"{label} {number}" if len(line) > 2 else label,
                        "box",
                        0.0,
                        self._height,
                        (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])),
                        (length + LINE_THICKNESS, LINE_THICKNESS),
                        math.atan2(along[1], along[0]),
                    )
        elif kind == "compound" and shape is not None and depth == 0:
            for number, part in enumerate(shape.need("parts", "[{name: circle, radius: 0.2}]").entries, start=1):
                pose = part.mapping("a shape such as {name: circle, radius: 0.2}").get("pose")
                px, py, turned = pose.numbers(3, 3) if pose is not None else _NO_POSE
                at = placed([(px, py)])[0]
                yield from self._solids(part, entry, f"{label} {number}", (*at, yaw + turned), depth + 1)
        else:
            self._notes.append(f"'{label}' is left out: its shape '{kind}' is not known")


def _middle(solid: Solid) -> tuple[float, float]:
    if solid.kind != "polygon":
        return solid.centre
    x, y = np.mean(solid.points, axis=0).tolist()
    return x, y


def _length(settings: Node | None, key: str, default: float) -> float:
    entry = settings.get(key) if settings is not None else None
    if entry is None:
        return default
    value = entry.number()
    if value <= 0.0:
        raise entry.error(f"must be greater than 0, not {value:g}")
    return value


def _nth(entry: Node, key: str, i: int) -> Node | None:
    """A setting of an entry's i-th object, as IR-SIM deals them out: one for all, or a list whose last goes on."""
    found = entry.get(key)
    if found is None or not isinstance(found.value, list) or found.is_numbers():
        return found
    entries = found.value
    return entries[min(i, len(entries) - 1)] if entries else None
