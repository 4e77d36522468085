"""Which format a file has, and the one door to all of them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from navsim.convert.errors import ConversionError
from navsim.convert.irsim import load_irsim
from navsim.convert.mjcf import save_mjcf
from navsim.convert.ros_map import load_ros_map, save_ros_map
from navsim.convert.scene import Room
from navsim.convert.sdf import Approximation, load_sdf, save_sdf
from navsim.convert.textfile import read_bytes
from navsim.convert.yamlfile import read_yaml
from navsim.files import write_text
from navsim.world import World
from navsim.worldfile import dump_world, parse_text, read_file

Source = Literal["sdf", "ros-map", "ir-sim"]
Target = Literal["sdf", "mjcf", "ros-map"]

_TARGETS: dict[str, Target] = {
    ".sdf": "sdf",
    ".world": "sdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
    ".yaml": "ros-map",
    ".yml": "ros-map",
}


def import_world(
    path: str | os.PathLike[str],
    format: Source | None = None,
    *,
    room: Room | None = None,
    model_paths: Sequence[str | os.PathLike[str]] = (),
    visual: bool = False,
    approximate: Approximation = "nothing",
    pushable: bool = False,
    height: float | None = None,
    unknown: Literal["free", "occupied"] | None = None,
    tolerance: float | None = None,
) -> tuple[World, list[str]]:
    """The world of a file of another program, and a remark for everything in it that could not be kept.

    Args:
        path: the file.
        format: of the file; by default what its name and content say.
        room: the room to put it into, where the file does not say.
        model_paths, visual, approximate, pushable: as for :func:`~navsim.convert.load_sdf`.
        height: of everything in a ROS map or IR-SIM file, metres; 2 by default.
        unknown, tolerance: as for :func:`~navsim.convert.load_ros_map`.

    Raises:
        ConversionError: when the file cannot be used.
        ValueError: for settings that its format has no use for.
    """
    kind = format or format_of(path)
    if height is not None and not (math.isfinite(height) and height > 0.0):
        raise ValueError(f"height must be greater than 0, in metres; got {height!r}")
    if kind in ("ros-map", "ir-sim") and _is_xml(path):
        raise ConversionError(str(path), 1, f"is XML, and so no file of the format {kind}; leave the format out")
    if kind in ("ros-map", "ir-sim") and room is not None and room.margin is not None:
        raise ValueError(f"{path}: a file of the format {kind} says how large its room is; give a size, not a margin")
    own: dict[str, dict[str, Any]] = {
        "sdf": {
            "model_paths": tuple(model_paths),
            "visual": visual or None,
            "approximate": None if approximate == "nothing" else approximate,
            "pushable": pushable or None,
        },
        "ros-map": {"wall_height": height, "unknown": unknown, "tolerance": tolerance},
        "ir-sim": {"wall_height": height},
    }
    if kind not in own:
        raise ValueError(f"format must be one of {', '.join(own)}; got {kind!r}")
    for settings in own.values():
        for key, value in settings.items():
            if value not in (None, ()) and key not in own[kind]:
                shown = {"model_paths": "model path", "wall_height": "height"}.get(key, key)
                raise ValueError(f"{path}: {shown} is not a setting of the format {kind}; leave it out")
    loaders: dict[str, Any] = {"sdf": load_sdf, "ros-map": load_ros_map, "ir-sim": load_irsim}
    return loaders[kind](path, room=room, **{key: value for key, value in own[kind].items() if value is not None})


def export_world(
    world: World,
    path: str | os.PathLike[str],
    format: Target | None = None,
    *,
    resolution: float | None = None,
    heights: tuple[float, float] | None = None,
) -> list[str]:
    """Writes a world for another program; returns a remark for everything that could not be kept.

    Args:
        world: the world.
        path: the file to write; a ROS map's picture lies beside it.
        format: of the file; by default what its suffix says: .sdf and .world, .xml (MJCF), .yaml (ROS map).
        resolution: side of a ROS map's cell, metres; 0.05 by default.
        heights: lowest and highest height that a ROS map tells of, metres; those of the robot by default.

    Raises:
        ValueError: for a suffix that says nothing, and for settings that the format has no use for.
    """
    kind = format or _TARGETS.get(Path(path).suffix.lower())
    if kind is None:
        known = ", ".join(_TARGETS)
        raise ValueError(f"{path}: the suffix says no format ({known}); choose another, or give --format")
    if kind != "ros-map" and (resolution is not None or heights is not None):
        raise ValueError(f"{path}: resolution and heights are settings of ROS maps, not of the format {kind}")
    if kind == "ros-map":
        low_high = {} if heights is None else {"low": heights[0], "high": heights[1]}
        return save_ros_map(world, path, **({} if resolution is None else {"resolution": resolution}), **low_high)
    writers = {"sdf": save_sdf, "mjcf": save_mjcf}
    if kind not in writers:
        raise ValueError(f"format must be one of {', '.join((*writers, 'ros-map'))}; got {kind!r}")
    return writers[kind](world, path)


def export_file(
    world: str | os.PathLike[str], output: str | os.PathLike[str], format: Target | None = None, **settings: Any
) -> list[str]:
    """What ``navsim world export`` does: :func:`export_world` for a world file, or the name of a shipped world.

    Raises:
        WorldError: as ``load_world``.
        ValueError: as :func:`export_world`, and for a file that would be written over itself.
    """
    source, content = read_file(world)
    loaded = parse_text(content, str(source), source.stem)
    _refuse_to_replace(source, Path(output))
    return export_world(loaded, output, format, **settings)


def _refuse_to_replace(source: Path, target: Path) -> None:
    if target.exists() and target.samefile(source):
        raise ConversionError(str(target), 0, "is the file that is read; name another one to write with -o")


def format_of(path: str | os.PathLike[str]) -> Source:
    """The format of a file, from its suffix and, where that is not enough, its content.

    Raises:
        ConversionError: when it is none that is read.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".sdf", ".world"):
        return "sdf"
    if suffix in (".pgm", ".png", ".bmp"):
        raise ConversionError(str(path), 0, "is the picture of a map; name the map.yaml that says its resolution")
    if _is_xml(path):
        return "sdf"
    root = read_yaml(path)
    if root.get("image") is not None and root.get("resolution") is not None:
        return "ros-map"
    if any(root.get(key) is not None for key in ("robot", "obstacle", "world")):
        return "ir-sim"
    if root.get("format") is not None:
        raise ConversionError(str(path), 1, "is a world file already; 'navsim world check' reads it")
    raise ConversionError(str(path), 1, "is no SDF file, ROS map or IR-SIM world; --format says what it is")


def _is_xml(path: str | os.PathLike[str]) -> bool:
    return read_bytes(path).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


def import_file(path: str | os.PathLike[str], output: Path | None, **settings: Any) -> tuple[Path, World, list[str]]:
    """What ``navsim world import`` does: reads a file, writes a world file that begins with the remarks.

    Args:
        path: the file to read.
        output: the world file to write; by default the file's name with ``.yaml``, here, unless there is one.
        settings: those of :func:`import_world`.

    Returns:
        the world file, its world, and the remarks.
    """
    world, notes = import_world(path, **settings)
    target = output or Path(f"{Path(path).stem}.yaml")
    if output is None and target.exists():
        target = Path(f"{Path(path).stem}_world.yaml")
        if target.exists():
            raise ConversionError(str(target), 0, "exists already; name the file to write with -o")
    _refuse_to_replace(Path(path), target)
    header = [
        f"# Imported from {Path(path).name} by 'navsim world import'.",
        *(f"# - {_one_line(note)}" for note in notes),
    ]
    write_text(target, "\n".join(header) + "\n\n" + dump_world(world))
    return target, world, notes


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
