"""Between occupancy grids and outlines: occupied cells to simple polygons, and footprints to occupied cells.

World files know no holes. So a patch of occupied cells that encloses free ones is cut, along cell borders, until no
piece of it does: then its border is one ring that never touches itself. Neighbouring pieces keep the border between
them as it is, whatever is simplified elsewhere, so that nothing can be seen between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import ndimage

from navsim.polygon import crossing_edges, signed_area
from navsim.prism import Prism
from navsim.world import MOST_CORNERS as MOST_CORNERS_OF_A_POLYGON

MOST_CORNERS = 200_000
"""Of the borders of all occupied cells of a grid: what its outlines take to be found."""
MOST_CELLS = 30_000_000
"""Cells that are looked at to find outlines, or six times those of the grid if that is more: those of each patch's
bounding box, for each cut through its holes."""

_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
_LONGEST_RING = 4 * MOST_CORNERS_OF_A_POLYGON
"""Corners up to which a border is worth being simplified as a whole."""
_FEW_HOLES = 8
"""In a piece of up to so many, the largest is opened first, where the cut is shortest: that takes the fewest cuts."""
_TOUCH = 1e-9
"""Part of a cell by which a footprint must reach into it to occupy it."""


def fill_pockets(occupied: np.ndarray, radius: float) -> tuple[np.ndarray, int]:
    """``occupied`` without the free pockets that no disc of ``radius`` (cells) fits into, and how many those were.

    A pocket is enclosed on all sides: nothing gets in or sees in, so filling it changes nothing outside.

    Args:
        occupied: ``(H, W)`` bool.
        radius: cells.
    """
    free, count = ndimage.label(np.pad(~occupied, 1, constant_values=True))
    if count <= 1:
        return occupied, 0
    room = ndimage.distance_transform_edt(free > 0)
    widest = ndimage.maximum(room, free, np.arange(count + 1))
    # The centre of a cell is at most 0.71 cells from any point in it, and as far from the border as `room` says.
    narrow = widest + 1.0 < radius
    narrow[[0, free[0, 0]]] = False
    return occupied | narrow[free][1:-1, 1:-1], int(narrow.sum())


class IntricateError(ValueError):
    """Cells whose outlines take too long to be found; the message says how many, to be read after "its cells"."""


class _Work:
    """Counts the cells that are looked at."""

    def __init__(self, occupied: np.ndarray) -> None:
        self._left = max(MOST_CELLS, 6 * occupied.size)

    def on(self, cells: np.ndarray) -> None:
        self._left -= cells.size
        if self._left < 0:
            raise IntricateError("wind round one another too often; clear the map up, or scale it down")


def count_corners(occupied: np.ndarray) -> int:
    """Corners of the borders between occupied cells ``(H, W)`` and free ones; where two cells touch, two."""
    padded = np.pad(occupied, 1)
    a, b, c, d = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    odd = a ^ b ^ c ^ d
    touching = (a == d) & (b == c) & (a != b)
    return int(np.count_nonzero(odd)) + 2 * int(np.count_nonzero(touching))


def check_borders(occupied: np.ndarray) -> None:
    """Raises :class:`IntricateError` for cells ``(H, W)`` whose borders have more than ``MOST_CORNERS`` corners."""
    corners = count_corners(occupied)
    if corners > MOST_CORNERS:
        raise IntricateError(
            f"have borders of {corners} corners, more than {MOST_CORNERS}; clear the map of speckles, or scale it down"
        )


def outlines(occupied: np.ndarray, tolerance: float = 0.0) -> Iterator[np.ndarray]:
    """Simple polygons, counter-clockwise, whose union is the occupied cells: each ``(V, 2)``, x and y in cells.

    Args:
        occupied: ``(H, W)`` bool; row 0 is the one with the least y.
        tolerance: how far a polygon's border may be from that of the cells, in cells; 0 keeps to the cells exactly.

    Raises:
        IntricateError: when more than ``MOST_CELLS`` would have to be looked at.
    """
    padded, work = np.pad(occupied, 1), _Work(occupied)
    waiting = [(occupied, np.zeros(2, dtype=np.intp))]
    while waiting:
        mask, corner = waiting.pop()
        for piece, inside in _pieces(mask, work):
            work.on(piece)
            offset = corner + inside
            height, width = piece.shape
            if piece.all():
                yield np.array([[0, 0], [width, 0], [width, height], [0, height]]) + offset
                continue
            if count_corners(piece) <= _LONGEST_RING:
                x, y = offset.tolist()
                ring, shared = _ring(piece, padded[y : y + height + 2, x : x + width + 2])
                outline = _simplified(ring, shared, tolerance)
                if len(outline) <= MOST_CORNERS_OF_A_POLYGON:
                    yield outline + offset
                    continue
            axis = int(np.argmax(piece.shape))
            waiting += _halves(piece, axis, piece.shape[axis] // 2, offset)


def _halves(mask: np.ndarray, axis: int, at: int, corner: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """What lies before and behind index ``at`` of an axis, each with its corner."""
    behind = np.array([0, at] if axis == 0 else [at, 0])
    first, second = np.split(mask, [at], axis=axis)
    return [(first, corner), (second, corner + behind)]


def _pieces(occupied: np.ndarray, work: _Work) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """4-connected pieces without holes: mask ``(h, w)`` and the x and y of its corner ``(2,)``, cells."""
    waiting = [(occupied, np.zeros(2, dtype=np.intp))]
    while waiting:
        mask, corner = waiting.pop()
        work.on(mask)
        labels, _ = ndimage.label(mask)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            piece = labels[box] == number
            work.on(piece)
            offset = corner + np.array([box[1].start, box[0].start])
            cut = _cut_through_a_hole(piece)
            if cut is None:
                yield piece, offset
                continue
            waiting += _halves(piece, *cut, offset)


def _cut_through_a_hole(piece: np.ndarray) -> tuple[int, int] | None:
    """Axis and index at which to cut a piece so that a hole of its opens; None when it has none."""
    free, count = ndimage.label(np.pad(~piece, 1, constant_values=True))
    if count <= 1:
        return None
    holes = [box for number, box in enumerate(ndimage.find_objects(free), start=1) if number != free[0, 0]]
    if len(holes) <= _FEW_HOLES:
        rows, columns = max(holes, key=lambda hole: math.prod(side.stop - side.start for side in hole))
    else:  # halves keep the work in bounds, whatever holes there are
        middle = [0.5 * side for side in piece.shape]
        rows, columns = min(
            holes,
            key=lambda hole: sum(
                abs(0.5 * (side.start + side.stop) - at) for side, at in zip(hole, middle, strict=True)
            ),
        )
    at = ((rows.start + rows.stop) // 2 - 1, (columns.start + columns.stop) // 2 - 1)
    crossed = (
        np.count_nonzero(piece[at[0]]) + (0 if at[0] else piece.shape[1]),
        np.count_nonzero(piece[:, at[1]]) + (0 if at[1] else piece.shape[0]),
    )
    axis = int(np.argmin(crossed)) if len(holes) <= _FEW_HOLES else int(np.argmax(piece.shape))
    if not at[axis]:
        axis = 1 - axis
    return axis, at[axis]


def _ring(piece: np.ndarray, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The border of a piece ``(h, w)``, counter-clockwise: its corners, and which of its edges are shared.

    Args:
        piece: 4-connected and without holes.
        around: ``(h + 2, w + 2)``, what is occupied there, a cell more on each side.

    Returns:
        corners ``(V, 2)``, cells, and whether another piece is beyond the edge that begins at each ``(V,)``.
    """
    padded = np.pad(piece, 1)
    span = piece.shape[1] + 1
    # By the place of a cell's corner: 0, or 1 + 2 * way + shared of the edge that begins there, and that ends there.
    leaving = np.zeros((piece.shape[0] + 1) * span, dtype=np.int8)
    arriving = np.zeros_like(leaving)
    # Bottom edges lead right, right edges up, top edges left, left edges down: the piece is on their left.
    for way, (rows, columns), (from_x, from_y) in (
        (0, (slice(0, -2), slice(1, -1)), (0, 0)),
        (1, (slice(1, -1), slice(2, None)), (1, 0)),
        (2, (slice(2, None), slice(1, -1)), (1, 1)),
        (3, (slice(1, -1), slice(0, -2)), (0, 1)),
    ):
        cell_y, cell_x = np.nonzero(piece & ~padded[rows, columns])
        kind = 1 + 2 * way + around[rows, columns][cell_y, cell_x]
        begin = (cell_y + from_y) * span + cell_x + from_x
        leaving[begin] = kind
        arriving[begin + _STEPS[way][0] + span * _STEPS[way][1]] = kind
    # Without holes no cells of a piece touch at a corner only, so the border passes every place once at most: from a
    # corner, it leads to the next one in its row or column.
    corners = np.flatnonzero(leaving != arriving)
    index = np.arange(len(corners))
    by_column = np.argsort(corners % span, kind="stable")
    rank = np.argsort(by_column)
    ways, shared = np.divmod(leaving[corners] - 1, 2)
    neighbours = [np.roll(index, -1), by_column[(rank + 1) % len(rank)], np.roll(index, 1), by_column[rank - 1]]
    following = np.choose(ways, neighbours).tolist()
    order = [0]
    while following[order[-1]]:
        order.append(following[order[-1]])
    ring = corners[order]
    return np.column_stack([ring % span, ring // span]), shared[order].astype(bool)


def _simplified(ring: np.ndarray, shared: np.ndarray, tolerance: float) -> np.ndarray:
    """The ring with as few corners as the tolerance allows, and shared edges as they are; a simple polygon still."""
    while tolerance > 0.05:
        kept = ring[_kept(ring.astype(float), shared, tolerance)]
        points = [(float(x), float(y)) for x, y in kept]
        if len(points) >= 3 and signed_area(points) > 0.0 and crossing_edges(points) is None:
            return kept
        tolerance *= 0.5
    straight = shared == np.roll(shared, 1)
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    flat = before[:, 0] * after[:, 1] == before[:, 1] * after[:, 0]
    return ring[~(flat & straight)] if not (flat & straight).all() else ring


def _kept(ring: np.ndarray, shared: np.ndarray, tolerance: float) -> np.ndarray:
    """Which corners stay, ``(K,)``: Douglas and Peucker's, and all that a shared edge ends in."""
    count = len(ring)
    fixed = np.flatnonzero(shared | np.roll(shared, 1)).tolist()
    if not fixed:
        farthest = int(np.argmax(((ring - ring[0]) ** 2).sum(axis=1)))
        fixed = [0, farthest]
    elif len(fixed) == 1:
        fixed = sorted({fixed[0], int(np.argmax(((ring - ring[fixed[0]]) ** 2).sum(axis=1)))})
    keep = np.zeros(count, dtype=bool)
    keep[fixed] = True
    waiting = [
        (begin, end if end > begin else end + count) for begin, end in zip(fixed, [*fixed[1:], fixed[0]], strict=True)
    ]
    while waiting:
        begin, end = waiting.pop()
        if end - begin < 2:
            continue
        between = ring[np.arange(begin + 1, end) % count]
        a, b = ring[begin % count], ring[end % count]
        distance = _distance_to_segment(between, a, b)
        worst = int(np.argmax(distance))
        if distance[worst] > tolerance:
            middle = begin + 1 + worst
            keep[middle % count] = True
            waiting += [(begin, middle), (middle, end)]
    return np.flatnonzero(keep)


def _distance_to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = b - a
    squared = float(along @ along)
    part = np.clip((points - a) @ along / squared, 0.0, 1.0) if squared else np.zeros(len(points))
    return np.hypot(*(points - (a + part[:, None] * along)).T)


def occupied_cells(
    prisms: Sequence[Prism], origin: np.ndarray, resolution: float, shape: tuple[int, int]
) -> np.ndarray:
    """``shape`` bool: the cells that some footprint reaches into. Exact.

    Args:
        prisms: footprints, convex or round.
        origin: ``(2,)``, corner of the grid with the least x and y, metres.
        resolution: side of a cell, metres.
        shape: rows and columns; row 0 is the one with the least y.
    """
    cells = np.zeros(shape, dtype=bool)
    for prism in prisms:
        vertices = (prism.vertices - origin) / resolution
        radius = prism.radius / resolution
        low = np.maximum(np.floor(vertices.min(axis=0) - radius + _TOUCH).astype(int), 0)
        high = np.minimum(np.ceil(vertices.max(axis=0) + radius - _TOUCH).astype(int), [shape[1], shape[0]])
        if (high <= low).any():
            continue
        x = np.arange(low[0], high[0]) + 0.5
        y = np.arange(low[1], high[1]) + 0.5
        if prism.is_cylinder:
            beside = (
                np.maximum(np.abs(axis - at) - 0.5, 0.0) for axis, at in ((x, vertices[0, 0]), (y, vertices[0, 1]))
            )
            across, along = beside
            inside = across[None, :] ** 2 + along[:, None] ** 2 < (radius - _TOUCH) ** 2
        else:
            # Two convex shapes are apart when some edge's line parts them: the box's own are met by `low` and `high`.
            inside = np.ones((len(y), len(x)), dtype=bool)
            edges = np.roll(vertices, -1, axis=0) - vertices
            for corner, (along_x, along_y) in zip(vertices, edges, strict=True):
                outward = along_y * (x[None, :] - corner[0]) - along_x * (y[:, None] - corner[1])
                inside &= outward < 0.5 * (abs(along_x) + abs(along_y)) - _TOUCH * math.hypot(along_x, along_y)
        cells[low[1] : high[1], low[0] : high[0]] |= inside
    return cells
