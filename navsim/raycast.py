"""The depth ray-caster: ideal depth images of 2.5D worlds, exactly, for many robots in one call.

A pixel's ray is (1, t, m) per metre of planar depth Z: the slope t to the left depends on the column only, the
slope m upwards on the row only. So a column of the image is one planar ray, and every convex prism that it crosses
gives one interval [near, far] of Z. The prism's face at `near` covers the rows of slopes between base / near and
top / near (heights over the camera). A prism that hangs over the camera shows its under face above that, up to
the slope base / far, at Z = base / m; one that ends below the camera shows its top face likewise, upside down.

Nothing is searched for: footprints are projected into the image, edge by edge, and the heights of a crossing into
its column. Neighbouring edges share a vertex, whose projection is computed once, and a column belongs to an edge by a
half-open comparison with it: no column falls between two edges, none is counted twice. The work is proportional
to what is in view.

Most prisms stand across the camera's height. In the upper half of a column they cover every row from the slope of
their top down to the level row; in the lower half, from the slope of their base up to it. So the nearest of them in
every row is a running minimum from the image's border to its middle.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navsim.camera import DepthCamera, Mounts, tilted
from navsim.dynamics import Dynamics, MovingPrisms
from navsim.pitched import inverse_depths
from navsim.prism import Prism
from navsim.view import NEAR, Frames, View, edges_of, expand, frames_of, in_view
from navsim.world import World


class Scene:
    """The prisms of one or more worlds, packed into arrays for the ray-caster.

    Args:
        worlds: the worlds, each a ``World`` or a sequence of ``Prism``.
    """

    def __init__(self, worlds: Sequence[World | Sequence[Prism]]) -> None:
        tables = [world.prisms if isinstance(world, World) else tuple(world) for world in worlds]
        prisms = [prism for table in tables for prism in table]
        self.num_worlds = len(tables)
        self.first_prism = np.concatenate([[0], np.cumsum([len(table) for table in tables])]).astype(np.intp)
        self.base = np.array([prism.base for prism in prisms])
        self.top = np.array([prism.top for prism in prisms])
        self.radius = np.array([prism.radius for prism in prisms])
        vertex_counts = np.array([len(prism.vertices) for prism in prisms], dtype=np.intp)
        self.vertices = np.concatenate([prism.vertices for prism in prisms]) if prisms else np.zeros((0, 2))
        self.first_vertex = np.concatenate([[0], np.cumsum(vertex_counts)]).astype(np.intp)
        self.vertex_count = vertex_counts
        if prisms:
            low = np.minimum.reduceat(self.vertices, self.first_vertex[:-1])
            high = np.maximum.reduceat(self.vertices, self.first_vertex[:-1])
        else:
            low = high = np.zeros((0, 2))
        self.centre = 0.5 * (low + high)
        self.half_extent = 0.5 * (high - low)
        self.bounding_radius = np.hypot(*self.half_extent.T) + self.radius
        self._indices: dict[float, _CellIndex] = {}

    def candidates(self, world_index: np.ndarray, positions: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """The prisms that may lie within ``reach`` metres of each position, with no false negative.

        Args:
            world_index: ``(N,)``, each position's world.
            positions: ``(N, 2)``, metres.
            reach: metres.

        Returns:
            position and prism of each pair, both ``(M,)`` intp, ordered by position.
        """
        index = self._indices.get(reach)
        if index is None:
            index = self._indices[reach] = _CellIndex(self, reach)
        return index.lookup(world_index, positions)


class _CellIndex:
    """Which prisms lie within a given reach of each cell of a uniform grid, for every world of a scene.

    A world of few prisms is one cell: testing them all costs less than looking them up.
    """

    _SMALL = 64
    _CELL = 1.25  # metres; much smaller than the disc around a view, so that the lists hold little else
    _MOST_ENTRIES = 4_000_000  # of a world's cells and of their lists; cells are larger in a world that takes more

    def __init__(self, scene: Scene, reach: float) -> None:
        origins, shapes, sides, first_cells, starts, lists = [], [], [], [], [np.zeros(1, dtype=np.intp)], []
        cells_so_far = entries_so_far = 0
        for world in range(scene.num_worlds):
            begin, end = scene.first_prism[world], scene.first_prism[world + 1]
            extent = scene.half_extent[begin:end] + scene.radius[begin:end, None]
            low, high = scene.centre[begin:end] - extent, scene.centre[begin:end] + extent
            side = self._CELL
            if end - begin <= self._SMALL:
                origin, shape = np.zeros(2), np.ones(2, dtype=np.intp)
                counts, entries = np.array([end - begin]), np.arange(begin, end)
            else:
                # Cells reach over all that there is; a position outside falls into the nearest border cell, which
                # may be further away than its own distance: the border is padded by `reach` so that all are empty.
                while True:
                    origin = low.min(axis=0) - reach - side
                    shape = np.ceil((high.max(axis=0) + reach + side - origin) / side).astype(np.intp)
                    first = np.floor((low - reach - origin) / side).astype(np.intp)
                    span = np.floor((high + reach - origin) / side).astype(np.intp) - first + 1
                    entries_needed = max(int(np.prod(shape)), int(np.prod(span, axis=1).sum()))
                    if entries_needed <= self._MOST_ENTRIES or (shape <= 3).all():
                        break
                    side *= 2.0
                prism, inside = expand(span[:, 0] * span[:, 1])
                cell = (
                    (first[prism, 0] + inside // span[prism, 1]) * shape[1] + first[prism, 1] + inside % span[prism, 1]
                )
                order = np.argsort(cell, kind="stable")
                counts = np.bincount(cell, minlength=shape[0] * shape[1])
                entries = begin + prism[order]
            origins.append(origin)
            shapes.append(shape)
            sides.append(side)
            first_cells.append(cells_so_far)
            starts.append(entries_so_far + np.cumsum(counts))
            lists.append(entries)
            cells_so_far += len(counts)
            entries_so_far += len(entries)
        self._origin, self._shape, self._side = np.array(origins), np.array(shapes), np.array(sides)
        self._first_cell = np.array(first_cells, dtype=np.intp)
        self._start = np.concatenate(starts)
        self._entries = np.concatenate(lists).astype(np.intp)

    def lookup(self, world_index: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape = self._shape[world_index]
        cell = ((positions - self._origin[world_index]) / self._side[world_index, None]).astype(np.intp)
        cell = np.minimum(np.maximum(cell, 0), shape - 1)
        flat = self._first_cell[world_index] + cell[:, 0] * shape[:, 1] + cell[:, 1]
        start = self._start[flat]
        owner, inside = expand(self._start[flat + 1] - start)
        return owner, self._entries[start[owner] + inside]


def render_depth(
    worlds: World | Sequence[World],
    poses: np.ndarray,
    camera: DepthCamera | None = None,
    obstacle_poses: np.ndarray | None = None,
) -> np.ndarray:
    """Ideal planar depth images: what a perfect camera sees, without blind zone or noise.

    Args:
        worlds: one world for all poses, or one for each pose.
        poses: ``(N, 3)`` x, y (metres) and yaw (radians) of the robot.
        camera: image size, field of view, mounting and greatest depth; the Kinect at 80x64 by default.
        obstacle_poses: ``(N, D, 3)`` where the obstacles that move or can be pushed are in each image, as
            ``Simulator.obstacle_poses`` tells; by default where the world files put them.

    Returns:
        ``(N, H, W)`` float32, metres along the optical axis, at most ``camera.max_range``; 0 everywhere in an image
        taken inside an obstacle.

    Raises:
        ValueError: for poses of another shape or a number of worlds that does not match.

    >>> import numpy as np, navsim
    >>> world = navsim.World.from_dict({"format": 1, "size": [4, 4]})
    >>> image = navsim.render_depth(world, np.array([[0.0, 0.0, 0.0]]))
    >>> image.shape, f"{image[0, 32, 40]:.3f}"  # the wall is 2 m ahead of the robot, the camera 8.7 cm behind it
    ((1, 64, 80), '2.087')
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or not np.all(np.isfinite(poses)):
        raise ValueError(f"poses must be finite and of shape (N, 3): x, y, yaw; got shape {poses.shape}")
    if isinstance(worlds, World):
        distinct, world_index = [worlds], np.zeros(len(poses), dtype=np.intp)
    else:
        if len(worlds) != len(poses) or not worlds:
            raise ValueError(f"there must be one world, or one for each pose; got {len(worlds)} for {len(poses)} poses")
        positions = {id(world): position for position, world in reversed(list(enumerate(worlds)))}
        firsts = sorted(set(positions.values()))
        distinct = [worlds[first] for first in firsts]
        rank = {first: number for number, first in enumerate(firsts)}
        world_index = np.array([rank[positions[id(world)]] for world in worlds], dtype=np.intp)
    if obstacle_poses is None:
        return cast(Scene(distinct), world_index, poses, camera or DepthCamera())
    scene = Scene([world.fixed_prisms for world in distinct])
    dynamics = Dynamics(distinct)
    obstacle_poses = np.asarray(obstacle_poses, dtype=np.float64)
    count, most = len(poses), dynamics.most
    given = obstacle_poses.shape
    if len(given) != 3 or given[0] != count or given[1] < most or given[2] != 3:  # a simulator's other worlds have more
        raise ValueError(
            f"obstacle_poses must be of shape ({count}, {most}, 3): x, y, yaw of what moves or can be pushed; "
            f"got {given}"
        )
    moving = dynamics.prisms(world_index, obstacle_poses)
    return cast(scene, world_index, poses, camera or DepthCamera(), moving=moving)


def cast(
    scene: Scene,
    world_index: np.ndarray,
    poses: np.ndarray,
    camera: DepthCamera,
    *,
    mounts: Mounts | None = None,
    moving: MovingPrisms | None = None,
) -> np.ndarray:
    """``render_depth`` on a scene that is compiled once.

    Args:
        scene: the worlds.
        world_index: ``(N,)``, each robot's world in the scene.
        poses: ``(N, 3)`` float64, robots' x, y (metres), yaw (radians).
        camera: the camera.
        mounts: how each robot carries it, where that is not as ``camera`` says.
        moving: what each robot sees beside its world in the scene.

    Returns:
        ``(N, H, W)`` float32, planar depth in metres, at most ``camera.max_range``.
    """
    mounts = camera.mounts(len(poses)) if mounts is None else mounts
    return _cast(_Subjects(scene, world_index, poses, mounts, moving), camera)


def nearest_depth(
    scene: Scene,
    world_index: np.ndarray,
    poses: np.ndarray,
    camera: DepthCamera,
    within: float = 0.5,
    *,
    mounts: Mounts | None = None,
    moving: MovingPrisms | None = None,
) -> np.ndarray:
    """The least depth, of the camera's kind, that any pixel sees of an obstacle or a wall, the floor left out.

    Args:
        scene, world_index, poses, camera, mounts, moving: as for ``cast``.
        within: how far to look, metres; a smaller figure is faster.

    Returns:
        ``(N,)`` float32, metres; ``within`` where nothing nearer is seen.
    """
    if within == 0.0:
        return np.zeros(len(poses), dtype=np.float32)
    mounts = camera.mounts(len(poses)) if mounts is None else mounts
    subjects = _Subjects(scene, world_index, poses, mounts, moving)
    nearest = np.empty(len(poses), dtype=np.float32)
    pitched = mounts.pitch != 0.0
    for find, some in ((_nearest_level, ~pitched), (_nearest_pitched, pitched)):
        if some.any():
            nearest[some] = find(subjects.of(some), camera, within)
    if camera.depth == "range" and (near := nearest < within).any():  # no ray is shorter than its planar depth
        nearest[near] = _nearest_range(subjects.of(near), camera, within)
    return nearest


class _Subjects(NamedTuple):
    """N robots' cameras and all that they may see."""

    scene: Scene
    world_index: np.ndarray  # (N,)
    poses: np.ndarray  # (N, 3)
    mounts: Mounts
    moving: MovingPrisms | None

    def of(self, robots: np.ndarray) -> _Subjects:
        """Those of the robots ``(N,)`` bool."""
        moving = None if self.moving is None else self.moving.of(robots)
        return _Subjects(self.scene, self.world_index[robots], self.poses[robots], self.mounts.take(robots), moving)

    def in_view(
        self,
        frames: Frames,
        ahead: float,
        reach: float,
        depth: np.ndarray | float,
        spread: np.ndarray | float,
    ) -> View:
        """What may be in view of what lies within ``reach`` metres of the points so far ``ahead``; see ``in_view``."""
        pairs = self.scene.candidates(self.world_index, frames.ahead(ahead), reach)
        view = in_view(self.scene, *pairs, frames, self.mounts, depth, spread)
        if self.moving is None:
            return view
        number = np.arange(len(self.moving.robot))
        others = in_view(self.moving, self.moving.robot, number, frames, self.mounts, depth, spread)
        return View(*(np.concatenate(both) for both in zip(view, others, strict=True)))


# ---- level cameras: column by column


def _cast(subjects: _Subjects, camera: DepthCamera) -> np.ndarray:
    pitched = subjects.mounts.pitch != 0.0
    if not pitched.any():
        return _cast_level(subjects, camera)
    if pitched.all():
        return _cast_pitched(subjects, camera)
    image = np.empty((len(pitched), camera.height, camera.width), dtype=np.float32)
    for cast_some, some in ((_cast_level, ~pitched), (_cast_pitched, pitched)):
        image[some] = cast_some(subjects.of(some), camera)
    return image


def _nearest_range(subjects: _Subjects, camera: DepthCamera, within: float) -> np.ndarray:
    """What ``nearest_depth`` tells of a camera that measures along its rays: their pixels are looked at one by one."""
    image = _cast(subjects, camera)
    nothing = subjects._replace(scene=Scene([()]), world_index=np.zeros(len(image), dtype=np.intp), moving=None)
    ranges = np.where(image < _cast(nothing, camera), image * camera.ray_lengths, np.float32(np.inf))
    return np.minimum(ranges.min(axis=(1, 2)), np.float32(within))


def _cast_level(subjects: _Subjects, camera: DepthCamera) -> np.ndarray:
    num_robots, height, width = len(subjects.poses), camera.height, camera.width
    half = (height + 1) // 2
    standing, hanging = _trace(subjects, camera, camera.max_range)
    rows = _blank_rows(half, 2 * num_robots * width, camera.max_range)
    _paint_standing(rows, standing, camera)
    floor = camera.inverse_row_slopes[:half, None] * subjects.mounts.z
    lower = rows[:, num_robots * width :].reshape(half, num_robots, width)
    np.minimum(lower, floor.astype(np.float32)[:, :, None], out=lower)
    _paint_hanging(rows, hanging, camera)

    upper, lower = rows.reshape(half, 2, num_robots, width).transpose(1, 2, 0, 3)
    image = np.empty((num_robots, height, width), dtype=np.float32)
    image[:, ::-1][:, :half] = lower
    image[:, :half] = upper
    return image


_kept = threading.local()
_KEPT_AT_MOST = 2**22  # pixels


def _blank_rows(count: int, size: int, depth: float) -> np.ndarray:
    """``(count, size)`` float32, all of ``depth``, in memory that each thread keeps for its next call.

    The C library returns so large an array to the operating system when it is freed; to find and clear the pages of a
    new one took 40% of the time of an image.
    """
    pixels = getattr(_kept, "pixels", None)
    if pixels is None or len(pixels) < count * size:
        pixels = np.empty(count * size, dtype=np.float32)
        if len(pixels) <= _KEPT_AT_MOST:
            _kept.pixels = pixels
    rows = pixels[: count * size].reshape(count, size)
    rows.fill(depth)
    return rows


def _nearest_level(subjects: _Subjects, camera: DepthCamera, within: float) -> np.ndarray:
    standing, hanging = _trace(subjects, camera, within)
    nearest = np.full(2 * len(subjects.poses), within, dtype=np.float32)
    seen = _row_under(standing.top, standing.near, camera) < (camera.height + 1) // 2
    np.minimum.at(nearest, standing.column[seen] // camera.width, standing.near[seen].astype(np.float32))
    first, count = _rows_of(hanging, camera)
    seen = count > 0
    depth = np.maximum(hanging.near[seen], hanging.base[seen] * camera.inverse_row_slopes[first[seen]])
    np.minimum.at(nearest, hanging.column[seen] // camera.width, depth.astype(np.float32))
    return nearest.reshape(2, -1).min(axis=0)


# ---- cameras that look up or down: row by row


def _inverse_depths(subjects: _Subjects, camera: DepthCamera, max_range: float) -> np.ndarray:
    """``(N, H, W)`` inverse depths of all but the floor; 1 / ``max_range`` for nothing, inf inside an obstacle."""
    pitch = subjects.mounts.pitch
    half_width = math.tan(math.radians(camera.horizontal_fov_deg) / 2)
    half_height = math.tan(math.radians(camera.vertical_fov_deg) / 2)
    # No ray of that depth is longer, whatever the pitch: the scene keeps an index for this reach.
    reach = max_range * math.hypot(1.0, half_width, half_height)
    advances, climbs = tilted(camera.row_slopes, pitch[:, None])
    depth, spread = max_range * advances.max(axis=1), half_width / advances.min(axis=1)
    view = subjects.in_view(frames_of(subjects.poses, subjects.mounts), 0.0, reach, depth, spread)
    return inverse_depths(view, camera, pitch, advances, climbs, max_range)


def _cast_pitched(subjects: _Subjects, camera: DepthCamera) -> np.ndarray:
    inverse = _inverse_depths(subjects, camera, camera.max_range)
    _, climbs = tilted(camera.row_slopes, subjects.mounts.pitch[:, None])
    floor = (-climbs / subjects.mounts.z[:, None]).astype(np.float32)
    np.maximum(inverse, floor[:, :, None], out=inverse)
    return np.minimum(np.reciprocal(inverse, out=inverse), np.float32(camera.max_range), out=inverse)


def _nearest_pitched(subjects: _Subjects, camera: DepthCamera, within: float) -> np.ndarray:
    inverse = _inverse_depths(subjects, camera, within)
    return np.minimum(np.reciprocal(inverse.max(axis=(1, 2))), np.float32(within))


# ---- what columns see


class _Standing(NamedTuple):
    """What columns see of prisms that stand across the camera's height, one crossing an entry of each array ``(S,)``.

    The lower halves of images are upper halves of the world turned upside down about the camera: columns are those of N
    upper halves, then of N lower ones, whose rows run from the border to the middle of the image.
    """

    column: np.ndarray  # robot * W + column; N*W more in lower halves
    near: np.ndarray  # depth at which the ray enters the footprint, metres
    top: np.ndarray  # height over the camera, metres


class _Hanging(NamedTuple):
    """What columns see of prisms that hang over the camera, which those under it do in the lower halves."""

    column: np.ndarray
    near: np.ndarray
    far: np.ndarray  # depth at which the ray leaves the footprint, metres
    base: np.ndarray  # height over the camera, metres
    top: np.ndarray


def _row_under(height: np.ndarray, depth: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """First row of a half that passes under ``height`` (metres over the camera) at ``depth``; their number for none."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        row = camera.height / 2 - 0.5 - camera.fy * height / depth
    return np.ceil(np.fmin(np.fmax(row, 0.0), (camera.height + 1) // 2)).astype(np.intp)


def _rows_of(hanging: _Hanging, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """First row and number of rows that see a prism: its face at ``near``, then its under face as far as ``far``."""
    first = _row_under(hanging.top, hanging.near, camera)
    return first, np.maximum(_row_under(hanging.base, hanging.far, camera) - first, 0)


def _paint_standing(rows: np.ndarray, standing: _Standing, camera: DepthCamera) -> None:
    """Draws into ``rows`` ``(R, 2*N*W)``, where a pixel keeps the least depth."""
    first = _row_under(standing.top, standing.near, camera)
    seen = np.flatnonzero(first < len(rows))
    pixel = first[seen] * rows.shape[1] + standing.column[seen]
    np.minimum.at(rows.reshape(-1), pixel, standing.near[seen].astype(np.float32))
    for row, next_row in itertools.pairwise(rows):
        np.minimum(row, next_row, out=next_row)


def _paint_hanging(rows: np.ndarray, hanging: _Hanging, camera: DepthCamera) -> None:
    """Draws into ``rows`` ``(R, 2*N*W)``, where a pixel keeps the least depth, after all that stands."""
    first, count = _rows_of(hanging, camera)
    pixels, row_size = rows.reshape(-1), rows.shape[1]
    pixel = first * row_size + hanging.column
    # What stands before it in the first of its rows stands before it in all of them.
    shown = np.flatnonzero(count)
    shown = shown[hanging.near[shown] < pixels[pixel[shown]]]
    owner, step = expand(count[shown])
    owner = shown[owner]
    depth = np.maximum(hanging.near[owner], hanging.base[owner] * camera.inverse_row_slopes[first[owner] + step])
    np.minimum.at(pixels, pixel[owner] + step * row_size, depth.astype(np.float32))


def _disc_around_view(half_width: float, max_range: float) -> tuple[float, float]:
    """The least disc that holds the triangle seen from above: how far ahead its centre is, and its radius, metres.

    Args:
        half_width: of the view, metres per metre ahead.
        max_range: how far ahead the triangle ends, metres.
    """
    if half_width > 1.0:  # an obtuse triangle's least disc has its longest side for a diameter
        return max_range, max_range * half_width
    radius = 0.5 * max_range * (1.0 + half_width**2)
    return radius, radius


def _trace(subjects: _Subjects, camera: DepthCamera, max_range: float) -> tuple[_Standing, _Hanging]:
    """What all columns of level cameras can see up to ``max_range`` metres."""
    frames = frames_of(subjects.poses, subjects.mounts)
    half_width = math.tan(math.radians(camera.horizontal_fov_deg) / 2)
    middle, reach = _disc_around_view(half_width, max_range)
    view = subjects.in_view(frames, middle, reach, max_range, half_width)
    robot, base, top, radius, hangs = view.robot, view.base, view.top, view.radius, view.hangs
    circles = np.flatnonzero(radius > 0.0)
    parts = (
        _trace_circles(circles, view.forward[circles], view.left[circles], radius[circles], camera),
        _trace_polygons(view, camera),
    )
    pair, column, near, far = (np.concatenate(both) for both in zip(*parts, strict=True))
    column += (robot * camera.width)[pair]
    in_range, hangs = near < max_range, hangs[pair]

    lower = len(subjects.poses) * camera.width
    index = np.flatnonzero(in_range & ~hangs)
    pair_of, near_of, column_of = pair[index], near[index], column[index]
    standing = _Standing(
        np.concatenate([column_of, column_of + lower]),
        np.concatenate([near_of, near_of]),
        np.concatenate([top[pair_of], -base[pair_of]]),
    )
    index = np.flatnonzero(in_range & hangs)
    base, top = base[pair[index]], top[pair[index]]
    above = base > 0.0
    hanging = _Hanging(
        column[index] + np.where(above, 0, lower),
        near[index],
        far[index],
        np.where(above, base, -top),
        np.where(above, top, -base),
    )
    return standing, hanging


def _columns_between(u_first: np.ndarray, u_last: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """First column and number of columns c with ``u_first <= c < u_last``, inside the image."""
    first = np.ceil(np.minimum(np.maximum(u_first, 0.0), width))
    last = np.ceil(np.minimum(np.maximum(u_last, 0.0), width))
    return first.astype(np.intp), np.maximum(last - first, 0.0).astype(np.intp)


def _trace_circles(
    pair: np.ndarray, forward: np.ndarray, left: np.ndarray, radius: np.ndarray, camera: DepthCamera
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns' rays through circles with centres (forward, left): pair, column, near, far of each crossing."""
    width = camera.width
    # |left - t forward| = radius sqrt(1 + t^2) at the two tangents; a circle that reaches behind the camera's plane may
    # fill the image to its border, which the discriminant below sorts out column by column.
    power = forward**2 + left**2 - radius**2
    ahead = forward > radius
    squared = np.where(ahead, forward**2 - radius**2, 1.0)
    root = radius * np.sqrt(np.maximum(power, 0.0))
    high = np.where(ahead, (left * forward + root) / squared, np.inf)
    low = np.where(ahead, (left * forward - root) / squared, -np.inf)
    first, count = _columns_between(width / 2 - 0.5 - high * camera.fx, width / 2 - 0.5 - low * camera.fx + 1e-9, width)
    owner, inside = expand(count)
    column = first[owner] + inside
    slope = camera.column_slopes[column]
    along = forward[owner] + slope * left[owner]
    squared = 1.0 + slope**2
    discriminant = along**2 - squared * power[owner]
    # Beside the tangents of a circle ahead, rounding alone makes it negative.
    hit = (discriminant >= 0.0) | ahead[owner]
    root = np.sqrt(np.maximum(discriminant, 0.0))
    near, far = (along - root) / squared, (along + root) / squared
    hit &= far > 0.0
    return pair[owner[hit]], column[hit], np.maximum(near[hit], 0.0), far[hit]


def _trace_polygons(view: View, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns' rays through convex polygons: pair, column, near, far of each crossing.

    The depth at which rays leave matters for prisms over or under the camera; for others ``far`` is ``near``.
    """
    width, fx = camera.width, camera.fx
    ahead, aside, hangs = view.ahead, view.aside, view.hangs
    edges = edges_of(view, camera.column_slopes[0])
    pair, following, offset = edges.pair, edges.following, edges.offset

    behind = ahead < NEAR
    behind_1 = behind[following]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = width / 2 - 0.5 - fx * aside / ahead
        crossing = aside + (aside[following] - aside) * (NEAR - ahead) / (ahead[following] - ahead)
        u_crossing = width / 2 - 0.5 - fx * crossing / NEAR
        # Depth along an edge is the inverse of a line over the columns.
        inverse_slope = -edges.normal_aside / (fx * offset)
        inverse_start = edges.normal_ahead / offset - inverse_slope * (width / 2 - 0.5)
    begin, end = (
        np.ceil(np.fmin(np.fmax(end_of_edge, 0.0), width))
        for end_of_edge in (np.where(behind, u_crossing, u), np.where(behind_1, u_crossing, u[following]))
    )
    # Seen from outside, the edges of a counter-clockwise polygon that face the camera run to the right in the image.
    runs = np.where((behind & behind_1) | edges.edge_on, 0.0, end - begin)

    def columns_of(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pair, column and depth of each crossing of these edges."""
        owner, step = expand(np.abs(runs[chosen]).astype(np.intp))
        edge = chosen[owner]
        column = np.minimum(begin, end)[chosen].astype(np.intp)[owner] + step
        return pair[edge], column, 1.0 / (inverse_start[edge] + inverse_slope[edge] * column)

    holds = edges.holds[pair]
    entered, column, near = columns_of(np.flatnonzero(np.where(holds, runs < 0.0, runs > 0.0)))
    near[edges.holds[entered]] = 0.0
    left, left_column, left_far = columns_of(np.flatnonzero((runs < 0.0) & hangs[pair]))
    number = np.cumsum(hangs) - 1  # of pairs that hang
    far_of = np.zeros(np.count_nonzero(hangs) * width)
    far_of[number[left] * width + left_column] = left_far
    far = near.copy()
    hanging = np.flatnonzero(hangs[entered])
    far[hanging] = np.maximum(near[hanging], far_of[number[entered[hanging]] * width + column[hanging]])
    return entered, column, near, far
