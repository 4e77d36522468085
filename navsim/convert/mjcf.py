"""Worlds for MuJoCo: MJCF files of fixed geoms, a plane and a light.

Boxes and cylinders are MuJoCo's own; a polygon is one mesh for each of its convex pieces, because MuJoCo takes the
hull of a mesh for its contacts. https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

import numpy as np

from navsim.convert.sdf import moving_notes, unused
from navsim.convert.xmlfile import XmlWriter, number, numbers
from navsim.files import write_text
from navsim.prism import Prism
from navsim.world import Box, Cylinder, World


def save_mjcf(world: World, path: str | os.PathLike[str]) -> list[str]:
    """Writes a world as an MJCF model for MuJoCo, at one stroke.

    Returns:
        a remark for everything that could not be kept.
    """
    text, notes = mjcf_text(world)
    write_text(path, text)
    return notes


def mjcf_text(world: World) -> tuple[str, list[str]]:
    """The text of :func:`save_mjcf`'s file, and its remarks."""
    notes = moving_notes(world)
    if not isinstance(world.starts, str) or not isinstance(world.goals, str):
        notes.append("starts and goals are written as sites, which nothing bumps into")
    xml, taken = XmlWriter(), {"floor"}
    pieces = [(unused(prism.name, taken), prism) for prism in world.prisms if _is_mesh(world, prism)]
    extent = max(world.size)
    xml.open("mujoco", model=world.name)
    xml.leaf("compiler", angle="radian", autolimits="true")
    xml.leaf("statistic", center="0 0 0", extent=number(extent))
    if pieces:
        xml.open("asset")
        for name, prism in pieces:
            xml.leaf("mesh", name=name, inertia="shell", **_mesh(prism))
        xml.close()
    xml.open("worldbody")
    xml.leaf("light", directional="true", pos=numbers(0.0, 0.0, extent), dir="-0.3 0.2 -1")
    xml.leaf("geom", name="floor", type="plane", size="0 0 1", rgba="0.8 0.8 0.8 1")
    for side, prism in zip(("north", "east", "south", "west"), _walls(world), strict=False):
        low, high = prism.vertices.min(axis=0), prism.vertices.max(axis=0)
        _geom(xml, unused(f"wall {side}", taken), "box", "0.6 0.6 0.6 1",
              pos=[*0.5 * (low + high), 0.5 * (prism.base + prism.top)],
              size=[*0.5 * (high - low), 0.5 * (prism.top - prism.base)])  # fmt: skip
    for obstacle in world.obstacles:
        middle = 0.5 * (obstacle.base + obstacle.top)
        if isinstance(obstacle, Box):
            yaw = math.radians(obstacle.yaw_deg)
            _geom(xml, unused(obstacle.name, taken), "box", pos=[*obstacle.at, middle], euler=[0.0, 0.0, yaw],
                  size=[0.5 * obstacle.size[0], 0.5 * obstacle.size[1], 0.5 * obstacle.height])  # fmt: skip
        elif isinstance(obstacle, Cylinder):
            _geom(xml, unused(obstacle.name, taken), "cylinder", pos=[*obstacle.at, middle],
                  size=[obstacle.radius, 0.5 * obstacle.height])  # fmt: skip
    for name, prism in pieces:
        x, y = _origin(prism)
        xml.leaf("geom", name=name, type="mesh", mesh=name, pos=numbers(x, y, prism.base), rgba="0.4 0.4 0.4 1")
    for key, places in (("start", world.starts), ("goal", world.goals)):
        for i, place in enumerate(() if isinstance(places, str) else places, start=1):
            yaw = math.radians(getattr(place, "yaw_deg", None) or 0.0)
            xml.leaf(
                "site", name=unused(f"{key}_{i}", taken), pos=numbers(*place.at, 0.0), euler=numbers(0.0, 0.0, yaw)
            )
    xml.close(2)
    return xml.text, notes


def _geom(xml: XmlWriter, name: str, kind: str, rgba: str = "0.4 0.4 0.4 1", **vectors: list[float]) -> None:
    xml.leaf("geom", name=name, type=kind, **{key: numbers(*value) for key, value in vectors.items()}, rgba=rgba)


def _walls(world: World) -> Iterator[Prism]:
    return (prism for prism in world.prisms if prism.obstacle < 0)


def _is_mesh(world: World, prism: Prism) -> bool:
    return prism.obstacle >= 0 and not isinstance(world.obstacles[prism.obstacle], (Box, Cylinder))


def _origin(prism: Prism) -> np.ndarray:
    """``(2,)``: where a piece has its origin, so that its corners are small numbers in MuJoCo's single precision."""
    return np.round(0.5 * (prism.vertices.min(axis=0) + prism.vertices.max(axis=0)), 6)


def _mesh(prism: Prism) -> dict[str, str]:
    """Corners and triangles, outward, of a convex piece, relative to its origin on its under side."""
    around = prism.vertices - _origin(prism)
    count = len(around)
    corners = [*((x, y, 0.0) for x, y in around), *((x, y, prism.top - prism.base) for x, y in around)]
    triangles = []
    for i in range(count):
        j = (i + 1) % count
        triangles += [(i, j, count + j), (i, count + j, count + i)]
    for i in range(1, count - 1):
        triangles += [(0, i + 1, i), (count, count + i, count + i + 1)]
    return {
        "vertex": numbers(*(value for corner in corners for value in corner)),
        "face": " ".join(str(corner) for triangle in triangles for corner in triangle),
    }
