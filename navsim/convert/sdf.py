"""Gazebo worlds: SDFormat files in, worlds and remarks out; and back.

What can be extruded (boxes upright on any side, upright cylinders, polylines) becomes an obstacle; whatever else there
is, is named in the remarks. Geometry is that of collisions, which is what robots bump into and what is coarse enough.
http://sdformat.org/spec
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from navsim.convert.errors import ConversionError
from navsim.convert.meshes import MeshError, mesh_points
from navsim.convert.models import ModelFinder
from navsim.convert.poses import Scope, frame_of
from navsim.convert.scene import Place, Room, Scene, Solid, world_of
from navsim.convert.upright import Standing, box_around, prism_around, upright_box, upright_cylinder, upright_polygon
from navsim.convert.xmlfile import MOST_ELEMENTS, Element, XmlWriter, number, numbers, read_xml
from navsim.files import write_text
from navsim.polygon import Vertex
from navsim.world import LARGEST_LENGTH, SMALLEST_LENGTH, Box, Cylinder, Obstacle, Walls, World

VERSIONS = (4, 12)
"""Minor versions of SDFormat 1 that are read, first and last."""
WRITTEN = "1.9"
"""The version that is written: that of Gazebo Fortress and everything later."""
DEEPEST_INCLUDE = 16
"""Files that include one another."""
MOST_INCLUDES = 10_000
"""Models that one world includes, those of its models counted."""
LONGEST_URI = 1_000
"""Characters."""
MOST_URIS = 2_000
"""Different models and meshes that one world names: each is looked for in a dozen places."""
MOST_MERGED = 100
"""Models that one world or model includes as parts of itself."""
HEAVIEST = 5.0
"""Kilograms up to which a body that Gazebo lets move is something for the robot to push, of 6.3 kg itself."""
_DENSITY = 1000.0
"""Kilograms a cubic metre, of bodies whose mass is left to be computed and which tell none: SDFormat's default."""

Approximation = Literal["nothing", "bounding-box", "convex-hull"]

_NAMESPACE = "urn:navsim:world"
_WALLS = "walls"  # the model that the walls of a room become
_HARMLESS = {"ground plane", "ground_plane", "sun"}


def load_sdf(
    path: str | os.PathLike[str],
    *,
    model_paths: Sequence[str | os.PathLike[str]] = (),
    visual: bool = False,
    approximate: Approximation = "nothing",
    pushable: bool = False,
    room: Room | None = None,
) -> tuple[World, list[str]]:
    """The world of a Gazebo SDF file, and a remark for everything in it that could not be kept.

    Args:
        path: a ``.sdf`` or ``.world`` file of SDFormat 1.4 to 1.12, with a ``<world>`` or a ``<model>``.
        model_paths: directories in which included models are looked for, before those in Gazebo's environment
            variables and the directories around the file.
        visual: read what is seen instead of what is bumped into.
        approximate: what stands for a body that cannot be extruded, such as a mesh: ``"nothing"``; the upright prism
            around its ``"bounding-box"``; or the one over its ``"convex-hull"``, which is tighter.
        pushable: let the robot push what Gazebo lets move, if it is one light body; else it stands still.
        room: the room to put it into, where the file has no walls.

    Raises:
        ConversionError: when the file is not SDF, or what it holds makes no world.
    """
    return world_of(read_sdf(path, model_paths, visual, approximate, pushable), room)


def read_sdf(
    path: str | os.PathLike[str],
    model_paths: Sequence[str | os.PathLike[str]] = (),
    visual: bool = False,
    approximate: Approximation = "nothing",
    pushable: bool = False,
) -> Scene:
    """What an SDF file holds; :func:`load_sdf` makes a world of it."""
    if approximate not in get_args(Approximation):
        raise ValueError(f"approximate must be one of {', '.join(get_args(Approximation))}; got {approximate!r}")
    try:
        return _Reader(Path(path), ModelFinder(model_paths), visual, approximate, pushable).scene
    except RecursionError:
        raise ConversionError(str(path), 0, "models or poses hang on one another too deep; flatten them") from None


@dataclass
class _Body:
    """A model's solids and what they weigh, while it is decided what they are called and whether they can be pushed."""

    solids: list[tuple[Solid, str, str]]
    """Each with the names of its link and of its collision."""
    mass: float
    movable: bool


_Declared = tuple[Element, Scope, str, tuple[Path, ...], bool]
"""A model, its frames, its full name, the files that led to it, and whether it is static."""


class _Reader:
    def __init__(
        self, path: Path, finder: ModelFinder, visual: bool, approximate: Approximation, pushable: bool
    ) -> None:
        self._finder, self._approximate, self._pushable = finder, approximate, pushable
        self._geometry_tag = "visual" if visual else "collision"
        self._includes = self._elements = 0
        self._found: dict[tuple[str, Path], Path | None] = {}
        self._roots: dict[Path, Element] = {}
        self._meshes: dict[tuple[Path, str], np.ndarray] = {}
        self._floors: list[float] = []
        root = _root(path)
        top = root.first("world") or next(root.all("model", "include"), None)
        if top is None:
            holds = ", ".join(f"<{child.tag}>" for child in root.children[:5]) or "nothing"
            raise root.error(f"<sdf> holds {holds}, but no <world> or <model>; name a file with one")
        self.scene = Scene(str(path), top.attributes.get("name") or path.stem)
        self._notes = self.scene.notes
        others = [world.name for world in list(root.all("world"))[1:]]
        if others:
            self._notes.append(f"only the first of {len(others) + 1} worlds is read; left out: {', '.join(others[:5])}")
        scope = Scope(f"<{top.tag}> '{top.name}'", outermost=True)
        if top.tag == "world":
            self._read_world(top, scope)
        else:
            self._children(root, scope, np.eye(4), (path,), "", False)
        if self._floors:
            self.scene.floor = max(self._floors)
            if abs(self.scene.floor) > 1e-9:
                self._notes.append(f"the ground plane is at {self.scene.floor:g} m: heights are measured from there")

    def _read_world(self, world: Element, scope: Scope) -> None:
        for frame in world.all("frame"):
            scope.declare(frame, frame.attributes.get("attached_to") or "world")
        hint = world.first("navsim:room")
        if hint is not None:
            self._read_room(hint)
        self._children(world, scope, np.eye(4), (Path(world.file),), "", False)
        for frame in world.all("frame"):
            which = re.fullmatch(r"(start|goal)(_\d+)?", frame.name)
            if which:
                pose = scope.find(frame.name, frame)
                yaw = math.atan2(pose[1, 0], pose[0, 0])
                drawn = which[1] == "goal" or frame.attributes.get("navsim:yaw") == "drawn"
                place = Place(pose[0, 3], pose[1, 3], None if drawn else yaw)
                (self.scene.starts if which[1] == "start" else self.scene.goals).append(place)
        for tag, reason in _NOT_READ.items():
            found = [element.name for element in world.all(tag)]
            if found:
                self._notes.append(f"<{tag}> {', '.join(sorted(set(found))[:5])} is left out: {reason}")

    def _read_room(self, hint: Element) -> None:
        width, depth = hint.numbers_in(hint.attributes.get("size", ""), 2, "size of <navsim:room>")
        if min(width, depth) <= 0.0:
            raise hint.error("size of <navsim:room> must be two lengths greater than 0")
        self.scene.low, self.scene.high = (-0.5 * width, -0.5 * depth), (0.5 * width, 0.5 * depth)
        walls = hint.attributes.get("walls")
        if walls == "none":
            self.scene.walls = "none"
        elif walls is not None:
            height, thickness = hint.numbers_in(walls, 2, "walls of <navsim:room>")
            if not SMALLEST_LENGTH <= min(height, thickness) <= max(height, thickness) <= LARGEST_LENGTH:
                raise hint.error(
                    "walls of <navsim:room> must be none, or height and thickness, both from "
                    f"{SMALLEST_LENGTH:g} to {LARGEST_LENGTH:g} m"
                )
            self.scene.walls = Walls(height=height, thickness=thickness)

    def _children(
        self, parent: Element, scope: Scope, pose: np.ndarray, files: tuple[Path, ...], prefix: str, static: bool
    ) -> None:
        """Reads the models of a world or model, whose origin is at ``pose`` in the world."""
        nested: list[_Declared | None] = []
        for child in parent.all("model", "include"):
            if child.tag == "model":
                if parent.tag == "world" and child.name == _WALLS and isinstance(self.scene.walls, Walls):
                    continue
                nested.append(self._declare(child, child, scope, files, prefix, static))
            else:
                nested.append(self._included(child, scope, files, prefix, static))
        held = {
            link.partition("::")[0]
            for joint in parent.all("joint")
            for link in (joint.words("parent"), joint.words("child"))
        }
        for read in filter(None, nested):
            model, inner, name, inner_files, is_static = read
            is_static = is_static or inner.label in held
            own = scope.models.get(inner.label) or next(entry for entry in scope.merged if entry[0] is inner)
            self._read_model(model, inner, pose @ scope.placed(*own), inner_files, name, is_static)

    def _declare(
        self,
        model: Element,
        placed_by: Element,
        scope: Scope,
        files: tuple[Path, ...],
        prefix: str,
        static: bool,
    ) -> _Declared:
        """Makes a model's frames known; ``placed_by`` is the model itself or the include that overrides it."""
        own_name = placed_by.words("name") if placed_by.tag == "include" else ""
        name = own_name or model.name
        label = scope.free_label(name)
        inner = Scope(label)
        for link in model.all("link"):
            inner.declare(link)
        for frame in model.all("frame"):
            inner.declare(frame, frame.attributes.get("attached_to") or "__model__")
        for joint in model.all("joint"):
            inner.declare(joint, joint.words("child") or "__model__")
        pose = placed_by.first("pose") or model.first("pose")
        placement = placed_by.words("placement_frame") or model.attributes.get("placement_frame", "")
        entry = (inner, frame_of(pose, placed_by), placement)
        if placed_by.tag == "include" and placed_by.truth(placed_by.attributes.get("merge", "false")):
            if len(scope.merged) >= MOST_MERGED:
                raise placed_by.error(f"more than {MOST_MERGED} models are merged into one; leave some as they are")
            scope.merged.append(entry)
        else:
            scope.models[label] = entry
        is_static = static or placed_by.flag("static", model.flag("static"))
        if placed_by is not model and placed_by.first("plugin") is not None:
            self._notes.append(f"model '{name}' has a plugin: it is not run, and the model stands still as it is posed")
        full = name if prefix in ("", f"{name} ") else f"{prefix}{name}"
        return model, inner, full, files, is_static

    def _included(
        self, include: Element, scope: Scope, files: tuple[Path, ...], prefix: str, static: bool
    ) -> _Declared | None:
        uri = include.child("uri").text.strip()
        name = include.words("name") or uri.rstrip("/").rpartition("/")[2]
        self._includes += 1
        if self._includes > MOST_INCLUDES:
            raise include.error(f"more than {MOST_INCLUDES} models are included; split the world")
        file = self._find(include, uri, files[-1])
        if file is None:
            if name.lower() in _HARMLESS:
                self._notes.append(f"included model '{uri}' is left out: it is known to hold no obstacle")
            else:
                self._notes.append(
                    f"included model '{uri}' is left out: it is not on this machine where models are looked for; name "
                    "its directory with --model-path"
                )  # fmt: skip
            return None
        if len(files) >= DEEPEST_INCLUDE or any(file.resolve() == other.resolve() for other in files[1:]):
            raise include.error(f"'{uri}' is included by what it includes, or too deep; break the circle")
        root = self._roots.get(file) or _root(file)
        self._roots[file] = root
        self._elements += root.count
        if self._elements > MOST_ELEMENTS:
            raise include.error(f"more than {MOST_ELEMENTS} elements are included in all; split the world")
        model = root.first("model")
        if model is None:
            holds = ", ".join(f"<{child.tag}>" for child in root.children[:3]) or "nothing"
            self._notes.append(f"included '{uri}' is left out: it holds {holds} instead of a <model>")
            return None
        return self._declare(model, include, scope, (*files, file), prefix, static)

    def _find(self, element: Element, uri: str, beside: Path) -> Path | None:
        """The file that ``element`` in the file ``beside`` names, if there is one on this machine."""
        if len(uri) > LONGEST_URI:
            raise element.error(f"a <uri> is longer than {LONGEST_URI} characters; name a model or a mesh")
        key = uri, beside.parent
        if key not in self._found:
            if len(self._found) >= MOST_URIS:
                raise element.error(f"more than {MOST_URIS} different models and meshes are named; split the world")
            self._found[key] = self._finder.find(uri, beside)
        return self._found[key]

    def _read_model(
        self, model: Element, scope: Scope, pose: np.ndarray, files: tuple[Path, ...], name: str, static: bool
    ) -> None:
        self._children(model, scope, pose, files, f"{name} ", static)
        joints = list(model.all("joint"))
        moving = sorted({joint.attributes.get("type", "") for joint in joints} - {"fixed", ""})
        to_world = any("world" in (joint.words("parent"), joint.words("child")) for joint in joints)
        kinematic = any(link.flag("kinematic", False) for link in model.all("link"))
        body = _Body([], 0.0, not (static or moving or to_world or kinematic))
        for link in model.all("link"):
            inertial = link.first("inertial")
            weighed = inertial is not None and inertial.truth(inertial.attributes.get("auto", "false"))
            if not weighed:
                body.mass += inertial.number("mass", 1.0) if inertial is not None else 1.0
            for element in link.all(self._geometry_tag):
                at = pose @ scope.pose(element.first("pose"), link.name, element)
                solid = self._solid(element, name, at, files)
                if solid is not None:
                    body.solids.append((solid, link.name, element.name))
                    if weighed and inertial is not None:
                        density = element.number("density", inertial.number("density", _DENSITY))
                        body.mass += density * solid.volume
        if moving:
            self._notes.append(f"model '{name}' has joints ({', '.join(moving)}): it stands still as it is posed")
        if model.first("plugin") is not None:
            self._notes.append(f"model '{name}' has a plugin: it is not run, and the model stands still as it is posed")
        self._keep(body, name)

    def _keep(self, body: _Body, name: str) -> None:
        """Takes up a model's solids, named so that people find them in the file again."""
        links, pieces = {link for _, link, _ in body.solids}, Counter(piece for _, _, piece in body.solids)
        mass = None
        if body.movable and body.solids:
            if not self._pushable:
                self._notes.append(f"model '{name}' may move in Gazebo (it is not static); here it stands still")
            elif len(body.solids) > 1 or body.mass > HEAVIEST or body.mass <= 0.0:
                reason = "several bodies" if len(body.solids) > 1 else f"{body.mass:g} kg"
                self._notes.append(f"model '{name}' stands still: it is {reason}, no light single body to be pushed")
            else:
                mass = body.mass
        for solid, link, piece in body.solids:
            if len(body.solids) == 1:
                label = name
            elif len(links) > 1 and pieces[piece] > 1:
                label = f"{name} {link} {piece}"
            else:
                label = f"{name} {piece}"
            self.scene.add(replace(solid, name=label, mass=mass))

    def _solid(self, element: Element, model: str, pose: np.ndarray, files: tuple[Path, ...]) -> Solid | None:
        """The upright prism of a collision or visual whose origin is at ``pose`` in the world; None for none."""
        label = f"'{model} {element.name}'"
        geometry = element.first("geometry")
        kinds = [child for child in geometry.children if child.tag in _SHAPES] if geometry is not None else []
        if not kinds:
            unknown = geometry.children[0].tag if geometry is not None and geometry.children else "nothing"
            self._notes.append(f"{label} is left out: its geometry is <{unknown}>, which is not read")
            return None
        shape = kinds[0]
        name = element.name
        if shape.tag == "box":
            size = shape.child("size").numbers(3)
            if min(size) <= 0.0:
                raise shape.child("size").error(f"<size> must be three lengths greater than 0, not {numbers(*size)}")
            standing = upright_box(name, size, pose)
        elif shape.tag == "cylinder":
            standing = upright_cylinder(name, shape.length("radius"), shape.length("length"), pose)
        elif shape.tag == "polyline":
            outlines = [child for child in kinds if child.tag == "polyline"]
            standing = _polyline(name, outlines, pose)
        elif shape.tag == "plane":
            normal = np.array(shape.first("normal").numbers(3) if shape.first("normal") else (0.0, 0.0, 1.0))  # type: ignore[union-attr]
            length = float(np.linalg.norm(normal))
            if length < 1e-9:
                raise shape.error("the <normal> of a <plane> has length 0; write '0 0 1' for a floor")
            up = float((pose[:3, :3] @ normal)[2]) / length
            if up > math.cos(math.radians(0.25)):
                self._floors.append(float(pose[2, 3]))
                return None
            standing = Standing(None, "is a plane that is not the floor, and has no thickness")
        else:
            standing = Standing(None, _SHAPES[shape.tag])
        if standing.note:
            self._notes.append(f"{label} {standing.note}")
        if standing.solid is not None:
            return standing.solid
        if self._approximate != "nothing":
            return self._approximation(label, name, shape, standing.reason, pose, files)
        self._notes.append(f"{label} is left out: it {standing.reason}; --approximate puts a prism in its place")
        return None

    def _approximation(
        self, label: str, name: str, shape: Element, reason: str, pose: np.ndarray, files: tuple[Path, ...]
    ) -> Solid | None:
        around = box_around if self._approximate == "bounding-box" else prism_around
        try:
            points = self._points(shape, files)
        except MeshError as error:
            self._notes.append(f"{label} is left out: it {reason}, {error}")
            return None
        solid = None if points is None else around(name, points, pose)
        if solid is None:
            self._notes.append(f"{label} is left out: it {reason}, and there is no prism around it")
            return None
        what = "bounding box" if self._approximate == "bounding-box" else "convex hull, extruded"
        self._notes.append(f"{label} {reason}: its {what} stands in its place")
        return solid

    def _points(self, shape: Element, files: tuple[Path, ...]) -> np.ndarray | None:
        """``(K, 3)``: points whose hull holds a shape, in its own frame, metres; None for what has no bounds."""
        if shape.tag == "box":
            return 0.5 * np.array(shape.child("size").numbers(3)) * _CUBE
        if shape.tag in ("cylinder", "capsule", "cone"):
            radius = shape.length("radius")
            half = 0.5 * shape.length("length") + (radius if shape.tag == "capsule" else 0.0)
            return np.concatenate([_CIRCLE * [radius, radius, 0.0] + [0.0, 0.0, z] for z in (-half, half)])
        if shape.tag == "sphere":
            return shape.length("radius") * _BALL
        if shape.tag == "ellipsoid":
            return np.array(shape.child("radii").numbers(3)) * _BALL
        if shape.tag == "polyline":
            corners = np.array([point.numbers(2) for point in shape.all("point")]).reshape(-1, 2)
            if len(corners) < 3:
                return None
            ends = (0.0, shape.number("height", 1.0))
            return np.concatenate([np.column_stack([corners, np.full(len(corners), z)]) for z in ends])
        if shape.tag == "mesh":
            uri = (shape.first("uri") or shape.child("filename")).text.strip()
            file = self._find(shape, uri, files[-1])
            if file is None:
                raise MeshError(f"and its file '{uri}' is not found; name its directory with --model-path")
            submesh = shape.first("submesh")
            part = submesh.words("name") if submesh is not None else ""
            if (file, part) not in self._meshes:
                self._meshes[file, part] = mesh_points(file, part)
            points = self._meshes[file, part]
            if submesh is not None and submesh.flag("center"):
                points = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
            scale = shape.first("scale")
            return points * (scale.numbers(3) if scale is not None else [1.0, 1.0, 1.0])
        return None


_SHAPES = {
    "box": "", "cylinder": "", "polyline": "", "plane": "",
    "mesh": "is a mesh",
    "sphere": "is a sphere",
    "ellipsoid": "is an ellipsoid",
    "capsule": "is a capsule, which is round at its ends",
    "cone": "is a cone",
    "heightmap": "is a heightmap",
    "image": "is an image, extruded",
}  # fmt: skip
"""Geometries, and why those cannot be extruded that cannot."""
_NOT_READ = {
    "actor": "actors walk by scripts, which are not read; write a cylinder with 'motion' instead",
    "population": "populations are drawn by Gazebo",
    "road": "roads are flat",
    "state": "it is what Gazebo has saved of a simulation, and models stand where they were put",
}
_CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ANGLES = (np.arange(32) + 0.5) * math.tau / 32
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(32)]) / math.cos(math.pi / 32)
"""Around the circle of radius 1, and as wide as it along both axes."""
_BALL = np.concatenate([_CIRCLE * [1.0, 1.0, 0.0] + [0.0, 0.0, z] for z in (-1.0, 1.0)])
"""Around the ball of radius 1: an upright prism over a polygon around its outline."""


def _polyline(name: str, outlines: list[Element], pose: np.ndarray) -> Standing:
    if len(outlines) > 1:
        return Standing(None, "consists of several outlines, which may make holes")
    (outline,) = outlines
    points = [tuple(point.numbers(2)) for point in outline.all("point")]
    if len(points) < 3:
        raise outline.error(f"<polyline> has {len(points)} points; give it three or more")
    height = outline.number("height", 1.0)
    if height <= 0.0:
        raise outline.error(f"<height> must be greater than 0, not {height:g}")
    return upright_polygon(name, points, height, pose)  # type: ignore[arg-type]


def _root(path: Path) -> Element:
    root = read_xml(path)
    if root.tag not in ("sdf", "gazebo"):
        raise root.error(f"the file is <{root.tag}>, not <sdf>; name a Gazebo world or model")
    version = root.attributes.get("version", "")
    match = re.fullmatch(r"1\.(\d{1,3})", version.strip())
    if not match or not VERSIONS[0] <= int(match[1]) <= VERSIONS[1]:
        said = f"version '{version}'" if version else "no version"
        raise root.error(
            f"<sdf> has {said}; versions 1.{VERSIONS[0]} to 1.{VERSIONS[1]} are read ('gz sdf -p FILE' converts others)"
        )
    return root


# ---- writing


def save_sdf(world: World, path: str | os.PathLike[str]) -> list[str]:
    """Writes a world as a Gazebo world of SDFormat 1.9, at one stroke.

    Boxes and cylinders stay what they are, polygons become polylines, walls a model of four boxes. Starts and goals are
    frames, and what Gazebo has no word for is told in elements of a namespace of our own, which it skips;
    :func:`load_sdf` reads them all.

    Returns:
        a remark for everything that could not be kept.
    """
    text, notes = sdf_text(world)
    write_text(path, text)
    return notes


def sdf_text(world: World) -> tuple[str, list[str]]:
    """The text of :func:`save_sdf`'s file, and its remarks."""
    xml, notes = XmlWriter(), moving_notes(world)
    xml.open("sdf", **{"version": WRITTEN, "xmlns:navsim": _NAMESPACE})
    xml.open("world", name=world.name.replace("::", ":"))
    walls = "none" if world.walls is None else numbers(world.walls.height, world.walls.thickness)
    xml.leaf("navsim:room", size=numbers(*world.size), walls=walls)
    xml.open("light", type="directional", name="sun")
    xml.leaf("pose", "0 0 10 0 0 0")
    xml.leaf("cast_shadows", "true")
    xml.leaf("diffuse", "0.9 0.9 0.9 1")
    xml.leaf("specular", "0.2 0.2 0.2 1")
    xml.leaf("direction", "-0.5 0.2 -0.9")
    xml.close()
    _ground(xml, world)
    taken = {"ground_plane", "sun", _WALLS, "world"}
    for key, places in (("start", world.starts), ("goal", world.goals)):
        for i, place in enumerate(() if isinstance(places, str) else places, start=1):
            taken.add(f"{key}_{i}")
            yaw_deg = getattr(place, "yaw_deg", None)
            drawn = {"navsim:yaw": "drawn"} if key == "start" and yaw_deg is None else {}
            xml.open("frame", name=f"{key}_{i}", **drawn)
            xml.leaf("pose", numbers(*place.at, 0.0, 0.0, 0.0, math.radians(yaw_deg or 0.0)))
            xml.close()
    if world.walls is not None:
        _write_walls(xml, world)
    for obstacle in world.obstacles:
        name = unused(obstacle.name.replace("::", ":"), taken)
        if name != obstacle.name:
            notes.append(f"'{obstacle.name}' is called '{name}', since SDF reserves its name or has it twice")
        _write_model(xml, obstacle, name)
    xml.close(2)
    return xml.text, notes


def moving_notes(world: World) -> list[str]:
    """A remark for each obstacle that moves or can be pushed, which stands still in other formats."""
    notes = []
    for obstacle in world.obstacles:
        if obstacle.motion is not None:
            notes.append(f"'{obstacle.name}' moves; it is written where the world file puts it, as something fixed")
        if obstacle.pushable is not None:
            notes.append(f"'{obstacle.name}' can be pushed; it is written as something fixed, without its mass")
    return notes


def unused(name: str, taken: set[str]) -> str:
    """``name``, or one like it that is not ``taken``; which it is from now on."""
    plain = re.sub(r"^__(.*)__$", r"\1", name) or "obstacle"
    candidate, count = plain, 1
    while candidate in taken:
        count += 1
        candidate = f"{plain}_{count}"
    taken.add(candidate)
    return candidate


def _ground(xml: XmlWriter, world: World) -> None:
    xml.open("model", name="ground_plane")
    xml.leaf("static", "true")
    xml.open("link", name="link")
    extent = 2.0 * max(world.size)
    for tag in ("collision", "visual"):
        xml.open(tag, name=tag)
        xml.open("geometry")
        xml.open("plane")
        xml.leaf("normal", "0 0 1")
        xml.leaf("size", numbers(extent, extent))
        xml.close(2)
        if tag == "visual":
            _material(xml, 0.8)
        xml.close()
    xml.close(2)


def _material(xml: XmlWriter, grey: float) -> None:
    xml.open("material")
    xml.leaf("ambient", numbers(grey, grey, grey, 1.0))
    xml.leaf("diffuse", numbers(grey, grey, grey, 1.0))
    xml.close()


def _write_walls(xml: XmlWriter, world: World) -> None:
    xml.open("model", name=_WALLS)
    xml.leaf("static", "true")
    xml.open("link", name="link")
    for prism in world.prisms[:4]:
        low, high = prism.vertices.min(axis=0), prism.vertices.max(axis=0)
        centre, size = 0.5 * (low + high), high - low
        for tag in ("collision", "visual"):
            xml.open(tag, name=prism.name.removeprefix("wall ") + ("" if tag == "collision" else "_visual"))
            xml.leaf("pose", numbers(*centre, 0.5 * (prism.base + prism.top), 0.0, 0.0, 0.0))
            xml.open("geometry")
            xml.open("box")
            xml.leaf("size", numbers(*size, prism.top - prism.base))
            xml.close(2)
            if tag == "visual":
                _material(xml, 0.6)
            xml.close()
    xml.close(2)


def _write_model(xml: XmlWriter, obstacle: Obstacle, name: str) -> None:
    xml.open("model", name=name)
    xml.leaf("static", "true")
    middle = 0.5 * (obstacle.base + obstacle.top)
    if isinstance(obstacle, Box):
        yaw = math.radians(obstacle.yaw_deg)
        xml.leaf("pose", numbers(*obstacle.at, middle, 0.0, 0.0, yaw))
    elif isinstance(obstacle, Cylinder):
        xml.leaf("pose", numbers(*obstacle.at, middle, 0.0, 0.0, 0.0))
    else:
        xml.leaf("pose", numbers(*outline_origin(obstacle.points), obstacle.base, 0.0, 0.0, 0.0))
    xml.open("link", name="link")
    for tag in ("collision", "visual"):
        xml.open(tag, name=tag)
        xml.open("geometry")
        if isinstance(obstacle, Box):
            xml.open("box")
            xml.leaf("size", numbers(*obstacle.size, obstacle.height))
        elif isinstance(obstacle, Cylinder):
            xml.open("cylinder")
            xml.leaf("radius", number(obstacle.radius))
            xml.leaf("length", number(obstacle.height))
        else:
            x, y = outline_origin(obstacle.points)
            xml.open("polyline")
            for point in obstacle.points:
                xml.leaf("point", numbers(point[0] - x, point[1] - y))
            xml.leaf("height", number(obstacle.height))
        xml.close(2)
        if tag == "visual":
            _material(xml, 0.4)
        xml.close()
    xml.close(2)


def outline_origin(points: Sequence[Vertex]) -> Vertex:
    """Where the model of a polygon has its origin: the middle of its bounding box, metres."""
    x, y = zip(*points, strict=True)
    return round(0.5 * (min(x) + max(x)), 6), round(0.5 * (min(y) + max(y)), 6)
