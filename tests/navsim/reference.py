"""Independent answers to what a depth camera sees, for the tests: triangle meshes under Embree, solids under MuJoCo.

Nothing here shares code with the ray-caster, nor with the loading of worlds: both references are built from a world
file's plain dictionary, and rays from the pinhole formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import shapely
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from shapely.geometry import Point, Polygon

from navsim.camera import DepthCamera

Cast = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From a ray's origin ``(3,)`` and directions ``(R, 3)`` to ``(R,)`` multiples of the direction; inf for nothing."""

_SAGITTA = 2e-6
"""How far a mesh's cylinder may stand away from the circle, metres; further only where that takes 3000 segments."""

_WINDOW = 15.0
"""Half side of the square around its centre that a mesh covers, metres: single precision is kept for what is near."""


@dataclass(frozen=True)
class Solid:
    """An extruded footprint: ``radius`` 0 for a polygon, whose ``footprint`` may be concave and may have a hole."""

    footprint: Polygon
    base: float
    top: float
    radius: float = 0.0
    box: tuple[float, float, float, float, float] | None = None  # x, y, length, width, yaw

    def holds(self, point: np.ndarray) -> bool:
        return self.base < point[2] < self.top and self.footprint.contains(Point(point[:2]))

    def surface_distance(self, point: np.ndarray) -> float:
        """Metres from the point to the solid's surface: never less than the truth for a point in a corner's shadow."""
        if self.radius:
            centre = self.footprint.centroid
            aside = abs(math.hypot(point[0] - centre.x, point[1] - centre.y) - self.radius)
        else:
            aside = self.footprint.boundary.distance(Point(point[:2]))
        within = self.base - 1e-9 <= point[2] <= self.top + 1e-9
        above = min(abs(point[2] - self.base), abs(point[2] - self.top))
        over = self.footprint.covers(Point(point[:2])) or aside < 1e-9
        return min(aside if within else math.inf, above if over else math.inf)


def solids(world: dict[str, Any]) -> list[Solid]:
    """The walls and obstacles of a world file's dictionary."""
    found = []
    walls = world.get("walls", {})
    if walls not in (None, "none"):
        length, width = (0.5 * side for side in world["size"])
        thickness = walls.get("thickness", 0.1)
        outer = shapely.box(-length - thickness, -width - thickness, length + thickness, width + thickness)
        ring = outer.difference(shapely.box(-length, -width, length, width))
        found.append(Solid(ring, 0.0, walls.get("height", 2.0)))
    for obstacle in world.get("obstacles", []):
        ((kind, shape),) = obstacle.items()
        base = float(shape.get("base", 0.0))
        top = base + shape["height"]
        if kind == "cylinder":
            x, y = shape["at"]
            radius = float(shape["radius"])
            segments = min(max(16, math.ceil(math.pi / math.sqrt(2.0 * _SAGITTA / radius))), 3000)
            angle = 2.0 * math.pi * np.arange(segments) / segments
            circle = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)
            found.append(Solid(Polygon(circle), base, top, radius))
        elif kind == "box":
            (x, y), (length, width), yaw = shape["at"], shape["size"], math.radians(shape.get("yaw_deg", 0.0))
            along = 0.5 * length * np.array([math.cos(yaw), math.sin(yaw)])
            across = 0.5 * width * np.array([-math.sin(yaw), math.cos(yaw)])
            corners = np.stack([along + across, across - along, -along - across, along - across])
            found.append(Solid(Polygon(corners + np.array([x, y])), base, top, box=(x, y, length, width, yaw)))
        else:
            found.append(Solid(shapely.geometry.polygon.orient(Polygon(shape["points"])), base, top))
    return found


def camera_position(camera: DepthCamera, pose: np.ndarray) -> np.ndarray:
    """``(3,)``, where the camera of a robot at x, y, yaw is."""
    heading = complex(math.cos(pose[2]), math.sin(pose[2]))
    place = complex(pose[0], pose[1]) + complex(camera.mount_x, camera.mount_y) * heading
    return np.array([place.real, place.imag, camera.mount_z])


def pixel_rays(camera: DepthCamera, pose: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """``(..., 3)`` rays of unit planar depth through points of the image; (0, 0) is the centre of its first pixel."""
    left = (1.0 - (2.0 * columns + 1.0) / camera.width) * math.tan(math.radians(0.5 * camera.horizontal_fov_deg))
    up = (1.0 - (2.0 * rows + 1.0) / camera.height) * math.tan(math.radians(0.5 * camera.vertical_fov_deg))
    forward = np.array([math.cos(pose[2]), math.sin(pose[2]), 0.0])
    leftward = np.array([-math.sin(pose[2]), math.cos(pose[2]), 0.0])
    pitch, plumb = math.radians(camera.pitch_deg), np.array([0.0, 0.0, 1.0])
    axis = math.cos(pitch) * forward - math.sin(pitch) * plumb
    upward = math.sin(pitch) * forward + math.cos(pitch) * plumb
    return axis + left[..., None] * leftward + up[..., None] * upward


def extruded(footprint: Polygon, base: float, top: float, convex: bool = False) -> trimesh.Trimesh:
    """A closed mesh of an extruded polygon, its caps triangulated by GEOS without new vertices, or as fans."""
    if convex:
        around = shapely.get_coordinates(footprint.exterior)[:-1]
        caps = np.stack([np.broadcast_to(around[0], (len(around) - 2, 2)), around[1:-1], around[2:]], axis=1)
    else:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(footprint))
        caps = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    along, aside = caps[:, 1] - caps[:, 0], caps[:, 2] - caps[:, 0]
    left_turn = along[:, 0] * aside[:, 1] > along[:, 1] * aside[:, 0]
    caps = np.where(left_turn[:, None, None], caps, caps[:, ::-1])
    soup = [_at_height(caps[:, ::-1], base), _at_height(caps, top)]
    for is_hole, ring in enumerate((footprint.exterior, *footprint.interiors)):
        corners = shapely.get_coordinates(ring)
        if ring.is_ccw == bool(is_hole):
            corners = corners[::-1]
        low, high = _at_height(corners, base), _at_height(corners, top)
        soup.append(np.stack([low[:-1], low[1:], high[1:]], axis=1))
        soup.append(np.stack([low[:-1], high[1:], high[:-1]], axis=1))
    vertices = np.concatenate(soup).reshape(-1, 3)
    return trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3), process=False)


def _at_height(points: np.ndarray, height: float) -> np.ndarray:
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height)], axis=-1)


class MeshReference:
    """A world as triangle meshes under Embree, in its watertight mode.

    Embree computes in single precision, so everything is moved to where the camera is before it is rounded:
    heights are exact relative to the camera's, and x and y are good for poses within a few metres of ``centre``.
    """

    name = "Embree"

    def __init__(
        self, world: dict[str, Any], eye: float, centre: tuple[float, float] = (0.0, 0.0), floor: bool = True
    ) -> None:
        self.solids = solids(world)
        self._shift = np.array([*centre, eye])
        window = shapely.box(*(np.array(centre) - _WINDOW), *(np.array(centre) + _WINDOW))
        meshes = []
        for solid in self.solids:
            seen = solid.footprint
            if not window.contains(seen):
                seen = seen.intersection(window)
            for part in shapely.get_parts(seen):
                if isinstance(part, Polygon) and part.area > 0.0:
                    meshes.append(extruded(part, solid.base, solid.top, convex=solid.radius > 0.0))
        if floor:
            # Turned, so that its diagonal falls on no axis.
            angle = 0.3 + 0.5 * math.pi * np.arange(4)
            corners = 1.5 * _WINDOW * np.stack([np.cos(angle), np.sin(angle)], axis=1) + np.array(centre)
            meshes.append(trimesh.Trimesh(_at_height(corners, 0.0), [[0, 1, 2], [0, 2, 3]], process=False))
        self._scene = EmbreeScene(robust=True)
        if meshes:
            mesh = trimesh.util.concatenate(meshes)
            TriangleMesh(
                self._scene,
                np.ascontiguousarray(mesh.vertices - self._shift, dtype=np.float32),
                np.ascontiguousarray(mesh.faces, dtype=np.int32),
            )
        self._empty = not meshes

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        if self._empty:
            return np.full(len(directions), np.inf)
        origins = np.broadcast_to((origin - self._shift).astype(np.float32), directions.shape)
        along = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions, dtype=np.float32), query="DISTANCE"
        ).astype(np.float64)
        return np.where(along > 1e6, np.inf, along)


class MujocoReference:
    """A world as MuJoCo geoms: boxes, cylinders, a plane, and meshes for polygons that are not rectangles."""

    name = "MuJoCo"

    def __init__(self, world: dict[str, Any]) -> None:
        self.solids = solids(world)
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        for number, solid in enumerate(self.solids):
            middle, half = 0.5 * (solid.base + solid.top), 0.5 * (solid.top - solid.base)
            if solid.radius:
                centre = solid.footprint.centroid
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[centre.x, centre.y, middle], size=[solid.radius, half, 0]
                )
            elif solid.box:
                x, y, length, width, yaw = solid.box
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=[x, y, middle],
                    size=[0.5 * length, 0.5 * width, half],
                    quat=[math.cos(0.5 * yaw), 0, 0, math.sin(0.5 * yaw)],
                )
            else:
                mesh = extruded(solid.footprint, solid.base, solid.top)
                spec.add_mesh(
                    name=f"mesh {number}",
                    uservert=mesh.vertices.ravel(),
                    userface=mesh.faces.ravel(),
                    inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
                )
                spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh {number}")
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        count = len(directions)
        geoms, along = np.empty(count, dtype=np.int32), np.empty(count)
        vectors = np.ascontiguousarray(directions, dtype=np.float64).ravel()
        mujoco.mj_multiRay(
            self._model, self._data, origin, vectors, None, True, -1, geoms, along, None, count, mujoco.mjMAXVAL
        )
        return np.where(along < 0.0, np.inf, along)


def depth_image(reference: MeshReference | MujocoReference, camera: DepthCamera, pose: np.ndarray) -> np.ndarray:
    """``(H, W)`` ideal planar depth, metres: zero everywhere inside an obstacle."""
    origin = camera_position(camera, pose)
    if any(solid.holds(origin) for solid in reference.solids):
        return np.zeros((camera.height, camera.width))
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    directions = pixel_rays(camera, pose, rows.ravel(), columns.ravel())
    return np.minimum(reference.cast(origin, directions), camera.max_range).reshape(rows.shape)


def on_a_surface(reference: MeshReference | MujocoReference, camera: DepthCamera, pose: np.ndarray) -> bool:
    """Whether the camera is so close to a surface (10 µm) that inside and outside cannot be told apart."""
    origin = camera_position(camera, pose)
    return any(solid.surface_distance(origin) < 1e-5 for solid in reference.solids)


_DIRECTIONS = np.array([[-1, -1], [-1, 0], [-1, 1], [0, -1], [0, 1], [1, -1], [1, 0], [1, 1]], dtype=np.float64)
_NEARBY = np.concatenate([_DIRECTIONS * length for length in (1.0, 0.1, 0.01, 0.001)])  # pixels


def explained_by_silhouettes(
    cast: Cast, camera: DepthCamera, pose: np.ndarray, rows: np.ndarray, columns: np.ndarray, depth: np.ndarray
) -> np.ndarray:
    """``(K,)`` bool: whether each depth is one that the reference sees beyond a silhouette within one pixel.

    From the pixel's centre to points up to a pixel away in eight directions, the largest jump of the reference's depth
    is cornered by bisection. A silhouette is where a jump of over half a millimetre remains within a
    ten-thousandth of a pixel; the depth must lie between those that were met on the way to it.
    """
    origin = camera_position(camera, pose)

    def at(places: np.ndarray) -> np.ndarray:
        directions = pixel_rays(camera, pose, places[..., 0].ravel(), places[..., 1].ravel())
        return np.minimum(cast(origin, directions), camera.max_range).reshape(places.shape[:-1])

    here = np.stack([rows, columns], axis=1).astype(np.float64)[:, None, :]
    start = np.broadcast_to(here, (len(rows), len(_NEARBY), 2)).copy()
    end = here + _NEARBY
    depth_start, depth_end = at(start), at(end)
    low, high = np.minimum(depth_start, depth_end), np.maximum(depth_start, depth_end)
    for _ in range(14):
        middle = 0.5 * (start + end)
        depth_middle = at(middle)
        np.minimum(low, depth_middle, out=low)
        np.maximum(high, depth_middle, out=high)
        first_half = np.abs(depth_middle - depth_start) >= np.abs(depth_end - depth_middle)
        end = np.where(first_half[..., None], middle, end)
        depth_end = np.where(first_half, depth_middle, depth_end)
        start = np.where(first_half[..., None], start, middle)
        depth_start = np.where(first_half, depth_start, depth_middle)
    jumps = np.abs(depth_end - depth_start) > 5e-4
    between = (low - 1e-3 < depth[:, None]) & (depth[:, None] < high + 1e-3)
    return np.any(jumps & between, axis=1)
