"""Simple polygons: whether they cross themselves, and their cut into convex pieces.

Points are tuples of floats, not arrays: a footprint has a handful of corners, and a world may hold thousands.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import mapbox_earcut
import numpy as np

Vertex = tuple[float, float]
_PAIRS_A_CHUNK = 2**18
"""Pairs of edges that are looked at together."""


def signed_area(points: Sequence[Vertex]) -> float:
    """The area that ``points`` enclose, in the square of their unit: positive when they run counter-clockwise.

    >>> signed_area([(0, 0), (2, 0), (2, 1), (0, 1)])
    2.0
    """
    origin_x, origin_y = points[0]
    total = 0.0
    for (ax, ay), (bx, by) in itertools.pairwise(points[1:]):
        total += (ax - origin_x) * (by - origin_y) - (bx - origin_x) * (ay - origin_y)
    return 0.5 * total


def crossing_edges(points: Sequence[Vertex]) -> tuple[int, int] | None:
    """Two edges of the closed polygon that meet where they should not; None for a simple polygon.

    Edge ``i`` runs from point ``i`` to the next one. Neighbouring edges meet where they should, unless the second
    one folds back onto the first. Edges that touch without crossing count: the polygon's inside would be pinched.

    >>> crossing_edges([(0, 0), (1, 1), (1, 0), (0, 1)])
    (0, 2)
    """
    count = len(points)
    following = [*points[1:], points[0]]
    for i in range(count):
        a, b, c = points[i], following[i], following[(i + 1) % count]
        if _turn(a, b, c) == 0.0 and (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]) <= 0.0:
            return i, (i + 1) % count
    starts: np.ndarray = np.asarray(points, dtype=np.float64)
    ends: np.ndarray = np.asarray(following, dtype=np.float64)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    rows = max(1, _PAIRS_A_CHUNK // count)
    for begin in range(0, count, rows):
        near = np.tri(min(rows, count - begin), count, begin + 1, dtype=bool)  # edges before it, itself, the next one
        np.logical_not(near, out=near)
        for axis in (0, 1):
            near &= low[:, axis] <= high[begin : begin + rows, axis, None]
            near &= high[:, axis] >= low[begin : begin + rows, axis, None]
        if begin == 0:
            near[0, -1] = False  # the last edge and the first are neighbours
        row, other = np.nonzero(near)
        one = begin + row
        meets = _touching(starts[one].T, ends[one].T, starts[other].T, ends[other].T)
        if meets.any():
            first = int(np.argmax(meets))
            return int(one[first]), int(other[first])
    return None


def convex_pieces(points: Sequence[Vertex]) -> list[list[Vertex]]:
    """Convex polygons, counter-clockwise and without straight corners, whose union is the simple polygon ``points``.

    Ear clipping (mapbox earcut) gives triangles; each diagonal that no piece needs to stay convex is then dropped
    again, which leaves at most four times the fewest pieces possible (Hertel and Mehlhorn, 1983). Every corner of a
    piece is one of ``points``, so the union is exact.

    >>> len(convex_pieces([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]))
    2
    """
    corners = _without_straight_corners(points if signed_area(points) > 0.0 else points[::-1])
    if _is_convex(corners):
        return [corners]
    ends = np.array([len(corners)], dtype=np.uint32)
    triangles = mapbox_earcut.triangulate_float64(np.array(corners), ends).reshape(-1, 3).tolist()
    oriented = (t if _turn(corners[t[0]], corners[t[1]], corners[t[2]]) > 0.0 else t[::-1] for t in triangles)
    pieces = _merge_pieces([piece for piece in oriented if signed_area([corners[i] for i in piece]) > 0.0], corners)
    trimmed = [_without_straight_corners([corners[i] for i in piece]) for piece in pieces]
    # A sliver as thin as rounding has an area from one corner, and straight corners from another: it encloses nothing.
    return [piece for piece in trimmed if len(piece) >= 3]


def _merge_pieces(pieces: list[list[int]], corners: Sequence[Vertex]) -> list[list[int]]:
    """The pieces, lists of indices of ``corners``, after dropping every diagonal that can go; longest ones first."""
    owner = {(a, b): k for k, piece in enumerate(pieces) for a, b in zip(piece, piece[1:] + piece[:1], strict=True)}
    merged: list[list[int] | None] = list(pieces)
    diagonals = [(a, b) for a, b in owner if a < b and (b, a) in owner]

    def squared_length(edge: tuple[int, int]) -> float:
        (ax, ay), (bx, by) = corners[edge[0]], corners[edge[1]]
        return (ax - bx) ** 2 + (ay - by) ** 2

    for a, b in sorted(diagonals, key=squared_length, reverse=True):
        left, right = owner[a, b], owner[b, a]
        first, second = merged[left], merged[right]
        if first is None or second is None or left == right:
            continue
        at, back = first.index(b), second.index(a)
        joined = first[at:] + first[:at] + (second[back:] + second[:back])[1:-1]
        if all(_turn(*(corners[joined[i + k]] for k in (-1, 0, 1 - len(joined)))) >= 0.0 for i in _ends(joined, a, b)):
            merged[left], merged[right] = joined, None
            for edge in zip(joined, joined[1:] + joined[:1], strict=True):
                owner[edge] = left
    return [piece for piece in merged if piece is not None]


def _ends(piece: list[int], a: int, b: int) -> tuple[int, int]:
    return piece.index(a), piece.index(b)


def _without_straight_corners(points: Sequence[Vertex]) -> list[Vertex]:
    count = len(points)
    return [points[i] for i in range(count) if _turn(points[i - 1], points[i], points[(i + 1) % count]) != 0.0]


def _is_convex(points: Sequence[Vertex]) -> bool:
    """Whether a simple, counter-clockwise polygon has no reflex corner."""
    count = len(points)
    return all(_turn(points[i - 1], points[i], points[(i + 1) % count]) >= 0.0 for i in range(count))


def _turn(a: Any, b: Any, c: Any) -> Any:
    """Twice the area of the triangle a, b, c: positive for a left turn at ``b``."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _touching(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether segments a-b and c-d, each ``(2, K)``, whose bounding boxes overlap, have a point in common."""
    apart = (_turn(a, b, c) * _turn(a, b, d) > 0.0) | (_turn(c, d, a) * _turn(c, d, b) > 0.0)
    return ~apart
