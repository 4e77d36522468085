"""Depth images of cameras that look up or down: exactly, row by row.

A camera that is pitched about its left axis keeps that axis level. So a row's rays, (F, t, U) ahead, to the left and
upwards per unit of planar depth, share F and U: they lie in one plane, which cuts the floor plan where the level
distance is X = F Z and the height U Z. Columns do not: a column of the image is a plane through the optical centre and
the image's *own* upright, plumb in the middle column only, and its rays' azimuths t / F change from row to row.

So the image is solved by rows. In a row's plane a prism is a part of its footprint, those X at which the plane
runs between its base and top. A ray sees it where the ray enters that part: on a side face, or at the part's near
border, a line of constant X and so of constant depth, which is the top or the under face. On a side face the inverse
depth is linear in the image, 1/Z = (a F + b t), and where it is more than the near border's the border is what is seen.
A face's edges that stand plumb are straight lines in the image, t = s F. What a row sees of a face is thus a run of
columns from one closed formula, and an image is painted run by run; a pixel keeps the greatest inverse depth.

Neighbouring edges share a vertex, and a column belongs to an edge by a half-open comparison with it, as in the level
ray-caster: no column falls between two edges, none is counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.camera import DepthCamera
from navsim.view import NEAR, Edges, View, edges_of, expand


def inverse_depths(
    view: View, camera: DepthCamera, pitch: np.ndarray, advances: np.ndarray, climbs: np.ndarray, max_range: float
) -> np.ndarray:
    """What N cameras see of prisms, and of nothing else.

    Args:
        view: the prisms, with heights over the camera of the robot that sees them.
        camera: the image; its own mounting is left aside.
        pitch: ``(N,)`` radians downwards.
        advances, climbs: ``(N, H)``, F and U of every row, F > 0.
        max_range: planar depth up to which prisms are seen, metres.

    Returns:
        ``(N, H, W)`` float32, inverse planar depths, at least 1 / ``max_range``, 1/m; inf everywhere in a prism.
    """
    image = np.full((*advances.shape, camera.width), 1.0 / max_range, dtype=np.float32)
    pixels = image.reshape(-1)
    edges = edges_of(view, camera.column_slopes[0] / advances.min(axis=1)[view.robot])
    rows = _rows(view, camera, pitch, advances, climbs, max_range)
    for pixel, inverse in (
        _standing(view, edges, rows, camera),
        _hanging(view, edges, rows, camera),
        _circles(view, rows, camera),
    ):
        np.maximum.at(pixels, pixel, inverse.astype(np.float32))
    image[view.robot[_holds(view, edges) & ~view.hangs]] = np.inf
    return image


def _holds(view: View, edges: Edges) -> np.ndarray:
    """``(P,)`` bool, whether the camera is over, under or in the prism."""
    return np.where(view.radius > 0.0, np.hypot(view.forward, view.left) < view.radius, edges.holds)


class _Rows(NamedTuple):
    """Rows of images in which prisms may be seen, R in all, those of a pair one after the other."""

    first: np.ndarray  # (P,), the first of each pair
    number: np.ndarray  # (P,), of rows of each pair
    pair: np.ndarray  # (R,)
    row: np.ndarray  # (R,), robot * H + row
    advance: np.ndarray  # (R,), F
    least: np.ndarray  # (R,), inverse depth at the far border of what the row's plane cuts out of the prism
    most: np.ndarray  # (R,), inverse depth at its near border; inf for prisms across the camera's height


def _rows(
    view: View,
    camera: DepthCamera,
    pitch: np.ndarray,
    advances: np.ndarray,
    climbs: np.ndarray,
    max_range: float,
) -> _Rows:
    """The rows whose planes may meet a prism between its nearest and its farthest point."""
    near, far = view.forward - view.radius, view.forward + view.radius
    polygons = np.flatnonzero(view.radius == 0.0)
    first_corner = np.cumsum(view.corner_count) - view.corner_count
    if len(polygons):
        near[polygons] = np.minimum.reduceat(view.ahead, first_corner)
        far[polygons] = np.maximum.reduceat(view.ahead, first_corner)
    in_front = far > NEAR
    near, far = np.maximum(near, NEAR), np.maximum(far, NEAR)
    highest = np.arctan(view.top / np.where(view.top > 0.0, near, far))
    lowest = np.arctan(view.base / np.where(view.base < 0.0, near, far))
    begin, end = (
        np.floor(camera.height / 2 - 0.5 - camera.fy * np.tan(np.clip(angle + pitch[view.robot], -1.57, 1.57)))
        for angle in (highest, lowest)
    )
    begin = np.clip(begin, 0, camera.height).astype(np.intp)
    end = np.clip(end + 2, 0, camera.height).astype(np.intp)
    count = np.where(in_front, np.maximum(end - begin, 0), 0)
    pair, step = expand(count)
    row = (view.robot * camera.height + begin)[pair] + step

    climb, base, top = climbs.reshape(-1)[row], view.base[pair], view.top[pair]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # A base at the camera's very height, or a top, counts as one just below it, or above.
        at_base, at_top = climb / np.where(base == 0.0, -0.0, base), climb / np.where(top == 0.0, 0.0, top)
    above, below = base > 0.0, top < 0.0
    # A plane that rises is under a prism until it meets its base, and over it from its top on.
    least = np.where(above, at_top, np.where(below, at_base, np.fmax(at_base, at_top)))
    most = np.where(above, at_base, np.where(below, at_top, np.inf))
    unseen = most < 1.0 / max_range
    least = np.where(unseen, np.inf, np.fmax(least, 1.0 / max_range))
    return _Rows(np.cumsum(count) - count, count, pair, row, advances.reshape(-1)[row], least, most)


def _runs(
    begin: np.ndarray, end: np.ndarray, row: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of columns c with ``begin <= c < end`` in rows: run, step and pixel of each, and runs' first columns."""
    first = np.ceil(np.fmin(np.fmax(begin, 0.0), width))
    count = np.maximum(np.ceil(np.fmin(np.fmax(end, 0.0), width)) - first, 0.0).astype(np.intp)
    run, step = expand(count)
    return run, step, (row * width + first.astype(np.intp))[run] + step, first


def _faces(
    chosen: np.ndarray, view: View, edges: Edges, rows: _Rows, camera: DepthCamera
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What rows see of the faces over some edges, up to the far border of what they cut out of the prism.

    Returns:
        row entry, begin, end (columns, not rounded), and 1/Z = constant - slope * column of each run.
    """
    ahead, aside, following = view.ahead, view.aside, edges.following
    behind = ahead < NEAR
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossing = aside + (aside[following] - aside) * (NEAR - ahead) / (ahead[following] - ahead)
        at_corner, at_crossing = aside / ahead, crossing / NEAR
        slope_begin = np.where(behind, at_crossing, at_corner)
        slope_end = np.where(behind[following], at_crossing, at_corner[following])
        a, b = edges.normal_ahead / edges.offset, edges.normal_aside / edges.offset
    # Seen from outside, the edges of a counter-clockwise polygon that face the camera run to the right in the image.
    seen = chosen & ~(behind & behind[following]) & ~edges.edge_on & ~edges.holds[edges.pair]
    edge = np.flatnonzero(seen & (slope_begin > slope_end))
    owner, step = expand(rows.number[edges.pair[edge]])
    edge = edge[owner]
    entry = rows.first[edges.pair[edge]] + step
    advance, least = rows.advance[entry], rows.least[entry]
    middle, fx = camera.width / 2 - 0.5, camera.fx
    begin = middle - fx * advance * slope_begin[edge]
    end = middle - fx * advance * slope_end[edge]
    slope = b[edge] / fx
    constant = a[edge] * advance + slope * middle
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        cut = (constant - least) / slope
    begin = np.where(slope < 0.0, np.fmax(begin, cut), begin)
    end = np.where(slope > 0.0, np.fmin(end, cut), end)
    end = np.where((slope == 0.0) & (constant < least), begin, end)
    return entry, begin, end, constant, slope


def _standing(view: View, edges: Edges, rows: _Rows, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and inverse depths of polygonal prisms across the camera's height."""
    entry, begin, end, constant, slope = _faces(~view.hangs[edges.pair], view, edges, rows, camera)
    run, step, pixel, first = _runs(begin, end, rows.row[entry], camera.width)
    return pixel, (constant - slope * first)[run] - slope[run] * step


def _hanging(view: View, edges: Edges, rows: _Rows, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and inverse depths of polygonal prisms over the camera or under it."""
    left, right = _borders(view, edges, rows, camera)
    entry, begin, end, constant, slope = _faces(view.hangs[edges.pair], view, edges, rows, camera)
    # A camera over or under the prism sees its top or under face alone.
    over = np.flatnonzero((edges.holds & view.hangs)[rows.pair] & np.isfinite(rows.least))
    entry = np.concatenate([entry, over])
    begin = np.concatenate([np.fmax(begin, left[entry[: len(begin)]]), left[over]])
    end = np.concatenate([np.fmin(end, right[entry[: len(end)]]), right[over]])
    constant, slope = np.concatenate([constant, rows.most[over]]), np.concatenate([slope, np.zeros(len(over))])
    run, step, pixel, first = _runs(begin, end, rows.row[entry], camera.width)
    inverse = (constant - slope * first)[run] - slope[run] * step
    return pixel, np.minimum(inverse, rows.most[entry][run])


def _borders(view: View, edges: Edges, rows: _Rows, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Columns ``(R,)`` between which rows see polygonal prisms beyond the near border; inf, -inf for others."""
    left, right = np.full(len(rows.pair), np.inf), np.full(len(rows.pair), -np.inf)
    corner_count = np.zeros(len(view.radius), dtype=np.intp)
    corner_count[view.radius == 0.0] = view.corner_count
    first_corner = np.cumsum(corner_count) - corner_count
    entry = np.flatnonzero((corner_count > 0)[rows.pair] & view.hangs[rows.pair] & np.isfinite(rows.least))
    if not len(entry):
        return left, right
    count = corner_count[rows.pair[entry]]
    owner, step = expand(count)
    corner = first_corner[rows.pair[entry]][owner] + step
    following = edges.following[corner]
    ahead, ahead_1, aside, aside_1 = (
        view.ahead[corner],
        view.ahead[following],
        view.aside[corner],
        view.aside[following],
    )
    most, advance = rows.most[entry][owner], rows.advance[entry][owner]
    border = advance / most
    beyond, beyond_1 = ahead >= border, ahead_1 >= border
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at_corner = np.where(beyond, advance * aside / ahead, np.nan)
        crossing = aside + (aside_1 - aside) * (border - ahead) / (ahead_1 - ahead)
        at_border = np.where(beyond != beyond_1, most * crossing, np.nan)
    slopes = np.fmin(at_corner, at_border), np.fmax(at_corner, at_border)
    first = np.cumsum(count) - count
    middle, fx = camera.width / 2 - 0.5, camera.fx
    left[entry] = np.nan_to_num(middle - fx * np.fmax.reduceat(slopes[1], first), nan=np.inf)
    right[entry] = np.nan_to_num(middle - fx * np.fmin.reduceat(slopes[0], first), nan=-np.inf)
    return left, right


def _circles(view: View, rows: _Rows, camera: DepthCamera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and inverse depths of cylinders."""
    forward, left, radius = view.forward, view.left, view.radius
    # |left - s forward| = radius sqrt(1 + s^2) at the two tangents; a circle that reaches behind the camera may fill a
    # row to its border, which the discriminant below sorts out pixel by pixel.
    power = forward**2 + left**2 - radius**2
    ahead = (forward > radius) & (radius > 0.0)
    squared = np.where(ahead, forward**2 - radius**2, 1.0)
    root = radius * np.sqrt(np.maximum(power, 0.0))
    high = np.where(ahead, (left * forward + root) / squared, np.inf)
    low = np.where(ahead, (left * forward - root) / squared, -np.inf)
    entry = np.flatnonzero((radius > 0.0)[rows.pair] & np.isfinite(rows.least))
    pair, advance = rows.pair[entry], rows.advance[entry]
    middle, fx = camera.width / 2 - 0.5, camera.fx
    begin, end = middle - fx * advance * high[pair], middle - fx * advance * low[pair] + 1e-9
    run, step, pixel, first = _runs(begin, end, rows.row[entry], camera.width)
    pair = pair[run]
    slope = camera.column_slopes[first.astype(np.intp)[run] + step]
    along = (advance * forward[rows.pair[entry]])[run] + slope * left[pair]
    squared = (advance**2)[run] + slope**2
    discriminant = along**2 - squared * power[pair]
    # Beside the tangents of a circle ahead, rounding alone makes it negative.
    hit = (discriminant >= 0.0) | ahead[pair]
    root = np.sqrt(np.maximum(discriminant, 0.0))
    most = rows.most[entry][run]
    with np.errstate(divide="ignore"):
        inverse = squared / np.maximum(along - root, 0.0)
        inverse_far = squared / np.maximum(along + root, 0.0)
    hit &= (along + root > 0.0) & (inverse >= rows.least[entry][run]) & (inverse_far <= most)
    return pixel[hit], np.minimum(inverse, most)[hit]
