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

_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
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


def outlines(occupied: np.ndarray, tolerance: float = 0.0) -> Iterator[np.ndarray]:
    """Simple polygons, counter-clockwise, whose union is the occupied cells: each ``(V, 2)``, x and y in cells.

    Args:
        occupied: ``(H, W)`` bool; row 0 is the one with the least y.
        tolerance: how far a polygon's border may be from that of the cells, in cells; 0 keeps to the cells exactly.
    """
    padded = np.pad(occupied, 1)
    for piece, offset in _pieces(occupied):
        height, width = piece.shape
        if piece.all():
            yield np.array([[0, 0], [width, 0], [width, height], [0, height]]) + offset
            continue
        x, y = offset.tolist()
        ring, shared = _ring(piece, padded[y : y + height + 2, x : x + width + 2])
        yield _simplified(ring, shared, tolerance) + offset


def _pieces(occupied: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """4-connected pieces without holes: mask ``(h, w)`` and the x and y of its corner ``(2,)``, cells."""
    waiting = [(occupied, np.zeros(2, dtype=np.intp))]
    while waiting:
        mask, corner = waiting.pop()
        labels, _ = ndimage.label(mask)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            piece = labels[box] == number
            offset = corner + np.array([box[1].start, box[0].start])
            cut = _cut_through_a_hole(piece)
            if cut is None:
                yield piece, offset
                continue
            axis, at = cut
            for part, start in zip(np.split(piece, [at], axis=axis), (0, at), strict=True):
                waiting.append((part, offset + np.array([0, start] if axis == 0 else [start, 0])))


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
    width = piece.shape[1]
    inner = padded[1:-1, 1:-1]
    span = width + 1
    following: dict[int, tuple[int, int, bool]] = {}
    # Bottom edges lead right, right edges up, top edges left, left edges down: the piece is on their left.
    for way, (rows, columns), (from_x, from_y) in (
        (0, (slice(0, -2), slice(1, -1)), (0, 0)),
        (1, (slice(1, -1), slice(2, None)), (1, 0)),
        (2, (slice(2, None), slice(1, -1)), (1, 1)),
        (3, (slice(1, -1), slice(0, -2)), (0, 1)),
    ):
        border = inner & ~padded[rows, columns]
        cell_y, cell_x = np.nonzero(border)
        shared = around[rows, columns][cell_y, cell_x]
        step = _STEPS[way][0] + span * _STEPS[way][1]
        begin = (cell_y + from_y) * span + cell_x + from_x
        following.update(
            zip(begin.tolist(), zip((begin + step).tolist(), [way] * len(begin), shared.tolist(), strict=True),
                strict=True)
        )  # fmt: skip
    first = min(following)
    corners: list[int] = []
    kinds: list[bool] = []
    at, before = first, (-1, False)
    while True:
        to, way, shared_edge = following[at]
        if (way, shared_edge) != before:
            corners.append(at)
            kinds.append(shared_edge)
        before, at = (way, shared_edge), to
        if at == first:
            break
    ring = np.array(corners)
    return np.column_stack([ring % span, ring // span]), np.array(kinds)


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
