"""The depth ray-caster: ideal depth images of 2.5D worlds, exactly, for many robots in one call.

A pixel's ray is (1, t, m) per metre of planar depth Z: the slope t to the left depends on the column only, the
slope m upwards on the row only. So a column of the image is one planar ray, and every convex prism that it crosses
gives one interval [Z_in, Z_out]. Within a row, a ray is between the prism's base and top for another interval of Z;
the prism is seen where the two overlap, at the greater of their lower ends. That single rule covers side faces, top
faces, under faces, and a camera that starts inside a footprint.

Columns are not searched for what they might hit: footprints are projected into the image instead. An edge of a
footprint covers the columns between the projections of its two ends, so the work is proportional to what is in view.
Neighbouring edges share a vertex, whose projection is computed once, and a column belongs to an edge by a half-open
comparison with it: no column falls between two edges, none is counted twice.

In each column, the nearest prism that covers every row hides all behind it; only what stands before it is worked out
row by row.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navsim.camera import DepthCamera
from navsim.prism import Prism
from navsim.world import World

_NEAR = 1e-9
"""Edges are cut off this far in front of the camera's plane, metres: what lies nearer projects outside any image."""


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
    _CELL = 2.5  # metres; a robot moves through a cell in seconds, and a cell's list is short beside a 5 m view

    def __init__(self, scene: Scene, reach: float) -> None:
        origins, shapes, first_cells, starts, lists = [], [], [], [np.zeros(1, dtype=np.intp)], []
        cells_so_far = entries_so_far = 0
        for world in range(scene.num_worlds):
            begin, end = scene.first_prism[world], scene.first_prism[world + 1]
            extent = scene.half_extent[begin:end] + scene.radius[begin:end, None]
            low, high = scene.centre[begin:end] - extent, scene.centre[begin:end] + extent
            if end - begin <= self._SMALL:
                origin, shape = np.zeros(2), np.ones(2, dtype=np.intp)
                counts, entries = np.array([end - begin]), np.arange(begin, end)
            else:
                # Cells reach over all that there is; a position outside falls into the nearest border cell, which
                # may be further away than its own distance: the border is padded by `reach` so that all are empty.
                origin = low.min(axis=0) - reach - self._CELL
                shape = np.ceil((high.max(axis=0) + reach + self._CELL - origin) / self._CELL).astype(np.intp)
                first = np.floor((low - reach - origin) / self._CELL).astype(np.intp)
                last = np.floor((high + reach - origin) / self._CELL).astype(np.intp)
                span = last - first + 1
                prism, inside = _expand(span[:, 0] * span[:, 1])
                cell = (
                    (first[prism, 0] + inside // span[prism, 1]) * shape[1] + first[prism, 1] + inside % span[prism, 1]
                )
                order = np.argsort(cell, kind="stable")
                counts = np.bincount(cell, minlength=shape[0] * shape[1])
                entries = begin + prism[order]
            origins.append(origin)
            shapes.append(shape)
            first_cells.append(cells_so_far)
            starts.append(entries_so_far + np.cumsum(counts))
            lists.append(entries)
            cells_so_far += len(counts)
            entries_so_far += len(entries)
        self._origin, self._shape = np.array(origins), np.array(shapes)
        self._first_cell = np.array(first_cells, dtype=np.intp)
        self._start = np.concatenate(starts)
        self._entries = np.concatenate(lists).astype(np.intp)

    def lookup(self, world_index: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape = self._shape[world_index]
        cell = ((positions - self._origin[world_index]) / self._CELL).astype(np.intp)
        cell = np.minimum(np.maximum(cell, 0), shape - 1)
        flat = self._first_cell[world_index] + cell[:, 0] * shape[:, 1] + cell[:, 1]
        start = self._start[flat]
        owner, inside = _expand(self._start[flat + 1] - start)
        return owner, self._entries[start[owner] + inside]


def render_depth(worlds: World | Sequence[World], poses: np.ndarray, camera: DepthCamera | None = None) -> np.ndarray:
    """Ideal planar depth images: what a perfect camera sees, without blind zone or noise.

    Args:
        worlds: one world for all poses, or one for each pose.
        poses: ``(N, 3)`` x, y (metres) and yaw (radians) of the robot.
        camera: image size, field of view, mounting and greatest depth; the Kinect at 80x64 by default.

    Returns:
        ``(N, H, W)`` float32, metres along the optical axis, at most ``camera.max_range``; 0 everywhere in an image
        taken inside an obstacle.

    Raises:
        ValueError: for poses of another shape or a number of worlds that does not match.

    >>> import numpy as np, navsim
    >>> world = navsim.World.from_dict({"format": 1, "size": [4, 4]})
    >>> image = navsim.render_depth(world, np.array([[0.0, 0.0, 0.0]]))
    >>> image.shape, float(image[0, 32, 40].round(3))  # the wall is 2 m ahead of the robot, the camera 8.7 cm behind it
    ((1, 64, 80), 2.087)
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or not np.all(np.isfinite(poses)):
        raise ValueError(f"poses must be finite and of shape (N, 3): x, y, yaw; got shape {poses.shape}")
    if isinstance(worlds, World):
        distinct, world_index = [worlds], np.zeros(len(poses), dtype=np.intp)
    else:
        if len(worlds) != len(poses):
            raise ValueError(f"there must be one world, or one for each pose; got {len(worlds)} for {len(poses)} poses")
        positions = {id(world): position for position, world in reversed(list(enumerate(worlds)))}
        firsts = sorted(set(positions.values()))
        distinct = [worlds[first] for first in firsts]
        rank = {first: number for number, first in enumerate(firsts)}
        world_index = np.array([rank[positions[id(world)]] for world in worlds], dtype=np.intp)
    return cast(Scene(distinct), world_index, poses, camera or DepthCamera())


def cast(scene: Scene, world_index: np.ndarray, poses: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """``render_depth`` on a scene that is compiled once.

    Args:
        scene: the worlds.
        world_index: ``(N,)``, each robot's world in the scene.
        poses: ``(N, 3)`` float64, robots' x, y (metres), yaw (radians).
        camera: the camera.

    Returns:
        ``(N, H, W)`` float32, planar depth in metres, at most ``camera.max_range``.
    """
    num_robots, width = len(poses), camera.width
    slopes = camera.inverse_row_slopes
    climbing = int(np.count_nonzero(slopes > 0))
    image = np.empty((num_robots, camera.height, width), dtype=np.float32)
    traced = _trace_columns(scene, world_index, poses, camera, camera.max_range)
    for half, rows in zip(traced, (slice(0, climbing), slice(climbing, camera.height)), strict=True):
        inverse = slopes[rows]
        floor = np.where(inverse < 0, np.minimum(-camera.mount_z * inverse, camera.max_range), camera.max_range)
        columns = np.minimum(half.cover.astype(np.float32)[:, None], floor.astype(np.float32))  # (N*W, rows)
        _paint(columns, half, inverse)
        image[:, rows] = columns.reshape(num_robots, width, len(inverse)).swapaxes(1, 2)
    return image


def nearest_depth(
    scene: Scene, world_index: np.ndarray, poses: np.ndarray, camera: DepthCamera, within: float = 0.5
) -> np.ndarray:
    """The least planar depth that any pixel sees of an obstacle or a wall, the floor left out.

    Args:
        scene, world_index, poses, camera: as for ``cast``.
        within: how far to look, metres; a smaller figure is faster.

    Returns:
        ``(N,)`` float32, metres; ``within`` where nothing nearer is seen.
    """
    slopes = camera.inverse_row_slopes
    climbing = int(np.count_nonzero(slopes > 0))
    nearest = np.full(len(poses), within, dtype=np.float32)
    traced = _trace_columns(scene, world_index, poses, camera, within)
    for half, inverse in zip(traced, (slopes[:climbing], slopes[climbing:]), strict=True):
        if len(inverse):
            cover = half.cover.reshape(len(poses), camera.width).min(axis=1).astype(np.float32)
            # What fills falling rows may stand where the last of them has already met the floor.
            farthest = -camera.mount_z * inverse[0] if inverse[0] < 0 else np.inf
            np.minimum(nearest, cover, out=nearest, where=cover <= farthest)
            if len(half.column):
                np.minimum.at(nearest, half.column // camera.width, _depth_by_row(half, inverse).min(axis=1))
    return nearest


class _Half(NamedTuple):
    """What the climbing (or the falling) rows of every column can see of the prisms.

    ``cover`` is ``(N*W,)``: the depth, metres, of the nearest prism that fills all these rows of a column
    (the greatest depth where there is none). The other arrays have one entry for each stretch of a column's planar ray
    through a prism that fills these rows only partly and stands before the cover.
    """

    cover: np.ndarray
    column: np.ndarray  # robot * W + column
    near: np.ndarray  # depth at which the ray enters the footprint, metres
    far: np.ndarray  # depth at which it leaves the footprint; inf where no row could tell
    enter: np.ndarray  # height over the camera at which these rows enter the prism, metres: its base for climbing rows
    leave: np.ndarray  # height over the camera at which they leave it, metres: its top for climbing rows


def _expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 0, 3): owners (0, 0, 2, 2, 2) and positions within them (0, 1, 0, 1, 2)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - first[owner]


def _trace_columns(
    scene: Scene, world_index: np.ndarray, poses: np.ndarray, camera: DepthCamera, max_range: float
) -> tuple[_Half, _Half]:
    """What the climbing and what the falling rows of every column can see, up to ``max_range`` metres."""
    width, fx, eye = camera.width, camera.fx, camera.mount_z
    slopes = camera.column_slopes
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    cameras = poses[:, :2] + np.stack(
        [cosine * camera.mount_x - sine * camera.mount_y, sine * camera.mount_x + cosine * camera.mount_y], axis=1
    )
    half_width = math.tan(math.radians(camera.horizontal_fov_deg) / 2)
    robot, prism = scene.candidates(world_index, cameras, max_range * math.hypot(1.0, half_width))

    # In the camera's frame: forward and left.
    offset = scene.centre[prism] - cameras[robot]
    c, s = cosine[robot], sine[robot]
    forward = offset[:, 0] * c + offset[:, 1] * s
    left = offset[:, 1] * c - offset[:, 0] * s
    reach = scene.bounding_radius[prism]
    # The sides of the view are planes through the camera: compare distances from them.
    beyond = forward * half_width + reach * math.hypot(1.0, half_width)
    seen = np.flatnonzero((forward > -reach) & (forward < max_range + reach) & (np.abs(left) < beyond))
    robot, prism, forward, left, c, s = robot[seen], prism[seen], forward[seen], left[seen], c[seen], s[seen]
    base, top = scene.base[prism], scene.top[prism]
    # The top or the under face can be seen only by a camera above or below it; else the far side does not matter.
    needs_far = (top < eye) | (base > eye)
    pieces: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []  # pair, column, near, far

    round_ = scene.radius[prism] > 0
    which = np.flatnonzero(round_)
    if len(which):
        pieces.append(_trace_circles(which, forward[which], left[which], scene.radius[prism[which]], camera))
    which = np.flatnonzero(~round_)
    if len(which):
        local, vertex = _expand(scene.vertex_count[prism[which]])
        pair = which[local]
        corner = scene.vertices[scene.first_vertex[prism[pair]] + vertex] - cameras[robot[pair]]
        ahead = corner[:, 0] * c[pair] + corner[:, 1] * s[pair]
        aside = corner[:, 1] * c[pair] - corner[:, 0] * s[pair]
        pieces.append(_trace_polygons(which, pair, ahead, aside, needs_far, slopes, fx, width))
    if pieces:
        pair, column, near, far = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    else:
        pair, column, near, far = np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0), np.zeros(0)
    key = robot[pair] * width + column
    base, top = base[pair] - eye, top[pair] - eye
    num_columns = len(poses) * width
    # A prism is in the way of climbing rows if it reaches above the camera, of falling rows if it reaches below it;
    # the floor takes the place of whatever part of a prism is missing under it.
    return (
        _split(
            (top >= 0.0),
            (base <= 0.0) & (top >= camera.row_slopes[0] * near),
            num_columns,
            max_range,
            key,
            near,
            far,
            base,
            top,
        ),
        _split(
            (base < 0.0),
            (top >= 0.0) & (base <= np.maximum(-eye, camera.row_slopes[-1] * near)),
            num_columns,
            max_range,
            key,
            near,
            far,
            top,
            base,
        ),
    )


def _split(
    in_the_way: np.ndarray,
    fills: np.ndarray,
    num_columns: int,
    max_range: float,
    key: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    enter: np.ndarray,
    leave: np.ndarray,
) -> _Half:
    """Sorts crossings into the nearest that fills all of a column's rows, and those before it that do not."""
    cover = np.full(num_columns, max_range)
    np.minimum.at(cover, key[fills], near[fills])
    keep = np.flatnonzero(in_the_way & ~fills & (near < cover[key]))
    return _Half(cover, key[keep], near[keep], far[keep], enter[keep], leave[keep])


def _paint(columns: np.ndarray, half: _Half, inverse_slopes: np.ndarray) -> None:
    """Draws the partly filled stretches over ``columns`` ``(N*W, rows)``: a pixel keeps the least depth."""
    if not len(half.column) or not len(inverse_slopes):
        return
    order = np.argsort(half.column, kind="stable")
    column = half.column[order]
    first = np.flatnonzero(np.diff(column, prepend=-1))
    rank = np.arange(len(column)) - np.repeat(first, np.diff(first, append=len(column)))
    depth = _depth_by_row(half, inverse_slopes)
    # The k-th stretches of all columns together: no column twice, so that plain indexing may write.
    for k in range(int(rank.max()) + 1):
        chosen = order[rank == k]
        into = half.column[chosen]
        columns[into] = np.minimum(columns[into], depth[chosen])


def _depth_by_row(half: _Half, inverse_slopes: np.ndarray) -> np.ndarray:
    """``(S, rows)`` float32, the depth at which each row's ray meets each stretch's prism; inf where it does not."""
    inverse = inverse_slopes.astype(np.float32)
    depth = half.enter.astype(np.float32)[:, None] * inverse
    np.maximum(depth, half.near.astype(np.float32)[:, None], out=depth)
    leave = half.leave.astype(np.float32)[:, None] * inverse
    np.minimum(leave, half.far.astype(np.float32)[:, None], out=leave)
    np.copyto(depth, np.float32(np.inf), where=depth > leave)
    return depth


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
    owner, inside = _expand(count)
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


def _trace_polygons(
    polygons: np.ndarray,
    pair: np.ndarray,
    ahead: np.ndarray,
    aside: np.ndarray,
    needs_far: np.ndarray,
    slopes: np.ndarray,
    fx: float,
    width: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns' rays through convex polygons: pair, column, near, far of each crossing.

    Args:
        polygons: pairs that are polygons.
        pair: ``(E,)`` each vertex's pair, ordered; vertices counter-clockwise within it.
        ahead, aside: ``(E,)`` each vertex in the camera's frame, metres.
        needs_far: by pair, whether the depth at which rays leave matters.
        slopes, fx, width: the camera's columns.
    """
    last = np.append(pair[1:] != pair[:-1], True)
    first_vertex = np.flatnonzero(np.append(True, last[:-1]))
    following = np.arange(1, len(pair) + 1)
    following[last] = first_vertex
    ahead_1, aside_1 = ahead[following], aside[following]
    # The edge's line: normal . P = offset; negative offsets for edges that face the camera.
    normal_ahead, normal_aside = aside_1 - aside, ahead - ahead_1
    offset = normal_ahead * ahead + normal_aside * aside
    # So near to a polygon that what is in view may be cut off below counts as inside it.
    margin = _NEAR * math.hypot(1.0, slopes[0]) * np.hypot(normal_ahead, normal_aside)
    inside = np.zeros(len(needs_far), dtype=bool)
    inside[polygons] = np.minimum.reduceat(offset + margin, first_vertex) >= 0.0

    behind = ahead < _NEAR
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = width / 2 - 0.5 - fx * aside / ahead
        crossing = aside + (aside_1 - aside) * (_NEAR - ahead) / (ahead_1 - ahead)
    u_crossing = width / 2 - 0.5 - fx * crossing / _NEAR
    behind_1 = behind[following]
    u_0 = np.where(behind, u_crossing, u)
    u_1 = np.where(behind_1, u_crossing, u[following])
    visible = ~(behind & behind_1)
    shallow, deep = np.maximum(np.minimum(ahead, ahead_1), 0.0), np.maximum(ahead, ahead_1)

    def depth_on(edge: np.ndarray, column: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = offset[edge] / (normal_ahead[edge] + normal_aside[edge] * slopes[column])
        # A column's ray along an edge meets it anywhere, and rounding could make that a place beyond its ends.
        return np.fmin(np.fmax(depth, shallow[edge]), deep[edge])

    # Seen from outside, the edges of a counter-clockwise polygon that face the camera run to the right in the image.
    front = np.flatnonzero(visible & (u_1 > u_0) & ~inside[pair])
    column_first, count = _columns_between(u_0[front], u_1[front], width)
    owner, step = _expand(count)
    edge, column = front[owner], column_first[owner] + step
    near = depth_on(edge, column)
    front_pair = pair[edge]

    back = np.flatnonzero(visible & (u_0 > u_1) & (needs_far | inside)[pair])
    column_first, count = _columns_between(u_1[back], u_0[back], width)
    owner, step = _expand(count)
    edge, back_column = back[owner], column_first[owner] + step
    back_far = depth_on(edge, back_column)
    back_pair = pair[edge]

    far_of = np.full(len(needs_far) * width, np.nan)
    far_of[back_pair * width + back_column] = back_far
    far = far_of[front_pair * width + column]
    far = np.where(np.isnan(far), np.where(needs_far[front_pair], near, np.inf), far)
    within = inside[back_pair]
    return (
        np.concatenate([front_pair, back_pair[within]]),
        np.concatenate([column, back_column[within]]),
        np.concatenate([near, np.zeros(int(within.sum()))]),
        np.concatenate([far, back_far[within]]),
    )
