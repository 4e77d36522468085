"""ROS maps: ``map.yaml`` with a picture, as map_server and nav2 read and write them. Flat, so heights are a setting.

https://wiki.ros.org/map_server
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Literal

import numpy as np

from navsim.convert.errors import ConversionError
from navsim.convert.images import read_image
from navsim.convert.raster import IntricateError, check_borders, fill_pockets, occupied_cells, outlines
from navsim.convert.scene import Room, Scene, Solid, world_of
from navsim.convert.yamlfile import Node, read_yaml
from navsim.files import atomic_write, write_text
from navsim.polygon import signed_area
from navsim.robot import TURTLEBOT2
from navsim.world import Walls, World

TOLERANCE = 0.75
"""Cells by which outlines may miss the cells' borders by default: √½ is what a straight wall at 45° takes."""
MOST_CELLS = 36_000_000
"""Of a map that is written."""
_OCCUPIED, _FREE = 0, 254
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = 0.65, 0.196


def load_ros_map(
    path: str | os.PathLike[str],
    *,
    wall_height: float = 2.0,
    unknown: Literal["free", "occupied"] = "free",
    tolerance: float | None = None,
    room: Room | None = None,
) -> tuple[World, list[str]]:
    """The world of a ROS map: its occupied cells as polygons of one height.

    The room is what the map knows: borders of unknown cells are cut off. A rim of occupied cells around it becomes the
    room's walls. A map that is turned (the third number of its ``origin``) is turned back: the world lies as its
    picture does.

    Args:
        path: a ``map.yaml``, which names its picture (.pgm, .png, …).
        wall_height: of everything in the world, metres; a map tells none.
        unknown: what to take cells for that the map does not know.
        tolerance: how far a polygon's outline may be from the cells' borders, metres; by default three quarters of a
            cell, which makes a slanting wall straight. 0 keeps to the cells exactly.
        room: starts, goals, and a size other than the map's.

    Raises:
        ConversionError: when the files cannot be used.
    """
    return world_of(read_ros_map(path, wall_height, unknown, tolerance), room)


def read_ros_map(
    path: str | os.PathLike[str],
    wall_height: float = 2.0,
    unknown: Literal["free", "occupied"] = "free",
    tolerance: float | None = None,
) -> Scene:
    """What a ROS map holds; :func:`load_ros_map` makes a world of it."""
    if not (math.isfinite(wall_height) and wall_height > 0.0):
        raise ValueError(f"wall_height must be greater than 0, in metres; got {wall_height!r}")
    if unknown not in ("free", "occupied"):
        raise ValueError(f"unknown must be 'free' or 'occupied'; got {unknown!r}")
    if tolerance is not None and not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise ValueError(f"tolerance must be finite and not negative, in metres; got {tolerance!r}")
    settings = read_yaml(path).mapping("a mapping with keys such as 'image' and 'resolution'")
    resolution = settings.need("resolution", "0.05").number()
    if not 1e-4 <= resolution <= 100.0:
        raise settings.need("resolution", "0.05").error(f"must be metres per cell, 0.0001 to 100, not {resolution:g}")
    origin = settings.get("origin")
    x, y, yaw = (*origin.numbers(2, 3), 0.0)[:3] if origin is not None else (0.0, 0.0, 0.0)
    if origin is not None and abs(yaw) > math.tau:
        raise origin.error(
            f"must be x and y in metres and a yaw in radians, from −2π to 2π; {yaw:g} looks like degrees"
        )
    image = settings.need("image", "map.pgm")
    occupied, known = _cells(settings, _picture(image, Path(path)))
    scene = Scene(str(path), Path(path).stem, built=Walls(height=wall_height))
    notes = scene.notes
    if not known.any():
        raise ConversionError(str(path), image.line, "the picture holds no cell that is known to be free or occupied")
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    corner = np.array([columns[0], rows[0]])
    strange = int(np.count_nonzero(~known[box]))
    occupied = occupied[box] | ~known[box] if unknown == "occupied" else occupied[box]
    if strange:
        notes.append(f"{strange} cells in the room are unknown: they count as {unknown} (--unknown says otherwise)")
    rim = _rim(occupied)
    if rim:
        occupied, corner = occupied[rim:-rim, rim:-rim], corner + rim
        scene.walls = Walls(height=wall_height, thickness=rim * resolution)
        notes.append(f"a rim of {rim} occupied cells became the walls of the room")
    in_cells = TOLERANCE if tolerance is None else tolerance / resolution
    try:
        check_borders(occupied)
        occupied, filled = fill_pockets(occupied, TURTLEBOT2.radius / resolution)
        found = list(outlines(occupied, in_cells))
    except IntricateError as error:
        raise image.error(f"its occupied cells {error}") from None
    if filled:
        notes.append(f"{filled} pockets of free cells, walled in and too small for the robot, are filled")
    height, width = occupied.shape
    scene.turned = yaw
    lower_left = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]) @ [x, y]

    def in_metres(cells: np.ndarray) -> np.ndarray:
        return (cells + corner) * resolution + lower_left

    scene.low, scene.high = (tuple(in_metres(np.array(cells)).tolist()) for cells in ([0, 0], [width, height]))
    for number, outline in enumerate(found, start=1):
        scene.add(_solid(f"patch {number}", in_metres(outline), wall_height))
    if len(scene.solids):
        notes.append(f"all {len(scene.solids)} obstacles are {wall_height:g} m high; a map tells no heights")
    return scene


def _picture(image: Node, beside: Path) -> tuple[np.ndarray, np.ndarray | None]:
    name = image.word()
    if not name.isprintable() or not name.strip():
        raise image.error("must name the picture, such as map.pgm")
    file = Path(name)
    return read_image(file if file.is_absolute() else beside.parent / file)


def _cells(settings: Node, picture: tuple[np.ndarray, np.ndarray | None]) -> tuple[np.ndarray, np.ndarray]:
    """Which cells are occupied, and which are known: ``(H, W)`` bool each, row 0 with the least y."""
    brightness, opacity = picture
    negate = settings.get("negate")
    mode = settings.get("mode") or Node("trinary", settings.file, settings.line, "mode")
    kind = mode.word()
    if kind not in ("trinary", "scale", "raw"):
        raise mode.error(f"must be trinary, scale or raw, not '{kind}'")
    thresholds = []
    for key, default in (("occupied_thresh", _OCCUPIED_THRESHOLD), ("free_thresh", _FREE_THRESHOLD)):
        entry = settings.get(key) or Node(default, settings.file, settings.line, key)
        value = entry.number()
        if not 0.0 <= value <= 1.0:
            raise entry.error(f"must lie between 0 and 1, not {value:g}")
        thresholds.append(value)
    occupied_from, free_to = thresholds
    if kind == "raw":
        value = np.rint(brightness) / 100.0
        known = value <= 1.0
        occupied = known & (value >= occupied_from)
    else:
        if opacity is not None and kind == "trinary":  # map_server averages alpha in, as if it were a colour
            brightness = 0.75 * brightness + 0.25 * opacity
        dark = brightness if negate is not None and negate.truth() else 255.0 - brightness
        occupancy = dark / 255.0
        occupied = occupancy > occupied_from
        if kind == "trinary":
            known = occupied | (occupancy < free_to)
        else:  # what lies between the thresholds is more or less likely occupied, and passable
            known = np.ones(occupied.shape, dtype=bool) if opacity is None else opacity >= 255.0
            occupied &= known
    return occupied[::-1], known[::-1]


def _rim(occupied: np.ndarray) -> int:
    """How many cells thick a closed rim of occupied ones is around the rest; 0 when there is no such rim."""
    most = (min(occupied.shape) - 1) // 2
    rim = 0
    while rim < most:
        inner = occupied[rim : occupied.shape[0] - rim, rim : occupied.shape[1] - rim]
        if not (inner[0].all() and inner[-1].all() and inner[:, 0].all() and inner[:, -1].all()):
            break
        rim += 1
    return rim if rim < most else 0


def _solid(name: str, outline: np.ndarray, height: float) -> Solid:
    """A box where four corners make one, else a polygon."""
    if len(outline) == 4:
        sides = np.roll(outline, -1, axis=0) - outline
        lengths = np.hypot(*sides.T)
        if np.allclose(sides[0], -sides[2], atol=1e-9) and abs(sides[0] @ sides[1]) <= 1e-12 * lengths[0] * lengths[1]:
            centre = outline.mean(axis=0)
            yaw = math.atan2(sides[0, 1], sides[0, 0])
            size = (float(lengths[0]), float(lengths[1]))
            return Solid(name, "box", 0.0, height, (float(centre[0]), float(centre[1])), size, yaw)
    points = tuple((float(x), float(y)) for x, y in outline)
    assert signed_area(points) > 0.0
    return Solid(name, "polygon", 0.0, height, points=points)


def save_ros_map(
    world: World,
    path: str | os.PathLike[str],
    *,
    resolution: float = 0.05,
    low: float = 0.0,
    high: float = TURTLEBOT2.height,
) -> list[str]:
    """Writes a world as a ROS map: ``path`` (a ``.yaml``) and a picture beside it (``.pgm``), each at one stroke.

    A cell is occupied when some obstacle or wall reaches into it at a height in the open range (``low``, ``high``): the
    heights of the robot by default; a laser scanner's are closer together. So nothing thin is lost, and nothing grows
    by a whole cell.

    Args:
        world: what to draw.
        path: of the ``.yaml``.
        resolution: side of a cell, metres.
        low, high: heights that count, metres.

    Returns:
        a remark for everything that could not be kept.

    Raises:
        ValueError: for settings that make no map.
    """
    target = Path(path)
    if target.suffix.lower() not in (".yaml", ".yml"):
        raise ValueError(f"{path}: a ROS map is a .yaml file with a picture beside it; name it 'map.yaml'")
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise ValueError(f"resolution must be greater than 0, in metres a cell; got {resolution!r}")
    if not 0.0 <= low < high:
        raise ValueError(f"heights must satisfy 0 <= low < high, in metres; got {low!r} and {high!r}")
    thickness = world.walls.thickness if world.walls is not None else 0.0
    # The borders of cells meet the inner sides of the walls in the west and south.
    rim = math.ceil(thickness / resolution - 1e-9)
    counts = rim + np.ceil((np.array(world.size) + thickness) / resolution - 1e-9)
    if counts.max() > 1e6 or math.prod(counts) > MOST_CELLS:
        raise ValueError(
            f"a map of {world.name} at {resolution:g} m a cell takes more than {MOST_CELLS} cells; coarsen it"
        )
    columns, rows = counts.astype(int).tolist()
    origin = -world.half_size - rim * resolution
    prisms = [prism for prism in world.prisms if prism.overlaps_heights(low, high)]
    cells = occupied_cells(prisms, origin, resolution, (rows, columns))
    picture = target.with_suffix(".pgm")
    pixels = np.where(cells[::-1], _OCCUPIED, _FREE).astype(np.uint8)
    with atomic_write(picture, "wb") as file:
        file.write(f"P5\n{columns} {rows}\n255\n".encode() + pixels.tobytes())
    write_text(
        target,
        f"image: {_quoted(picture.name)}\nmode: trinary\nresolution: {resolution:.10g}\n"
        f"origin: [{origin[0]:.10g}, {origin[1]:.10g}, 0.0]\n"
        f"negate: 0\noccupied_thresh: {_OCCUPIED_THRESHOLD}\nfree_thresh: {_FREE_THRESHOLD}\n",
    )
    return _lost(world, low, high, resolution)


def _quoted(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _lost(world: World, low: float, high: float, resolution: float) -> list[str]:
    from navsim.convert.sdf import moving_notes

    notes = moving_notes(world)
    for obstacle in world.obstacles:
        if not (obstacle.base < high and obstacle.top > low):
            notes.append(f"'{obstacle.name}' is not on the map: nothing of it is between {low:g} and {high:g} m")
    walls = world.walls
    if walls is not None and walls.height <= low:
        notes.append(f"the walls are not on the map: nothing of them is between {low:g} and {high:g} m")
    notes.append(f"a map tells neither heights, starts nor goals, and outlines to a cell of {resolution:g} m")
    return notes
