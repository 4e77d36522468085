"""The corners of mesh files, for the prisms around them; trimesh reads the files, if it is installed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from navsim.convert.errors import ConversionError
from navsim.convert.textfile import read_bytes

KINDS = ("dae", "glb", "obj", "off", "ply", "stl")
"""Suffixes of what is read: no archives, which may unfold to anything."""
LARGEST = 16 * 2**20
"""Bytes of a mesh file."""
INSTALL = 'pip install "navsim-rl[meshes]"'
"""What reading meshes takes."""


class MeshError(ValueError):
    """Why a mesh cannot be read, as the end of a sentence about it."""


def mesh_points(path: Path, submesh: str = "") -> np.ndarray:
    """``(K, 3)``: the corners of a mesh file, in its own unit, which is taken for metres where it does not say.

    As Gazebo does, COLLADA's unit is heeded, and its ``up_axis`` is not.

    Args:
        path: a file of one of ``KINDS``; .dae takes pycollada as well.
        submesh: the only part of it that counts.

    Raises:
        MeshError: when it cannot be read.
    """
    try:
        import trimesh
    except ImportError:
        raise MeshError(f"and reading meshes takes trimesh ({INSTALL})") from None
    kind = path.suffix.lower().lstrip(".")
    if kind not in KINDS:
        raise MeshError(f"and meshes of the kind .{kind} are not read ({', '.join(KINDS)} are)")
    try:
        content = read_bytes(path, LARGEST)
        if kind == "dae" and (b"<!DOCTYPE" in content or b"<!ENTITY" in content):
            raise MeshError("and its file holds a document type, which is not read")
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind)
        if submesh:
            named = {name: scene.geometry[name] for name in scene.geometry if submesh in name}
            if not named:
                raise MeshError(f"and its file has no part '{submesh}'")
            scene = trimesh.Scene(named)
        points = np.array(scene.to_mesh().vertices, dtype=np.float64).reshape(-1, 3)
        points *= _metres(scene.units)
    except MeshError:
        raise
    except ConversionError as error:
        raise MeshError(f"and {error}") from None
    except Exception as error:  # mesh files can be broken in more ways than there are kinds of exceptions
        needs = f"; .dae files need pycollada as well: {INSTALL}" if kind == "dae" else ""
        raise MeshError(f"and {path.name} cannot be read ({type(error).__name__}{needs})") from None
    if not len(points) or not np.isfinite(points).all():
        raise MeshError(f"and {path.name} holds no corners")
    return points


def _metres(unit: str | None) -> float:
    """Metres in a unit as trimesh names that of a COLLADA file.

    >>> _metres("0.0254 * meters"), _metres("meters"), _metres(None)
    (0.0254, 1.0, 1.0)
    """
    factor, _, of = (unit or "").partition(" * ")
    return float(factor) if of == "meters" else 1.0
