"""Corridors: a maze of straight walls on a square grid, with more than one way around and doors here and there."""

from __future__ import annotations

import math

import numpy as np

from navsim.generate.layout import ImpossibleError, Layout, Shortfall
from navsim.generate.pieces import Part
from navsim.generate.placing import PASSAGE, SLACK

DENSITY = 0.07
"""Share of the floor that walls cover by default."""
CELL = (1.35, 1.9)
"""Metres, least and greatest distance between the middles of parallel walls."""
THICKNESS = (0.05, 0.35)
"""Metres, least and greatest thickness of a wall."""
_DOORS = 0.3  # share of the openings that are narrowed to a door, where cells are wide enough


def layout(generator: np.random.Generator, size: tuple[float, float], density: float | None) -> Layout | Shortfall:
    """A maze: the thickness and the number of its walls follow from ``density``."""
    density = DENSITY if density is None else density
    grids = [shape for shape in _shapes(size) if _density_range(size, shape)[0] <= density]
    able = [shape for shape in grids if density <= _density_range(size, shape)[1]]
    if not able:
        ranges = [_density_range(size, shape) for shape in _shapes(size)]
        if not ranges and min(size) >= 2 * CELL[0]:
            odd = next(length for length in size if not _counts(length))
            raise ImpossibleError(
                f"corridors in a room of {size[0]:g} by {size[1]:g} m: {odd:g} m cannot be divided into cells of "
                f"{CELL[0]:g} to {CELL[1]:g} m; choose up to {2 * CELL[1]:g} m, or {3 * CELL[0]:g} m and more"
            )
        if not ranges:
            raise ImpossibleError(
                f"corridors need a room of at least {2 * CELL[0]:g} by {2 * CELL[0]:g} m, not {size[0]:g} by "
                f"{size[1]:g} m; enlarge size"
            )
        low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
        raise ImpossibleError(
            f"corridors in a room of {size[0]:g} by {size[1]:g} m cover {math.ceil(1000 * low) / 1000:g} to "
            f"{math.floor(1000 * high) / 1000:g} of the floor, not {density:g}; choose a density between those"
        )
    shape = able[int(generator.integers(len(able)))]
    pitch = np.array(size) / shape
    is_open = _tree(generator, shape)
    edges = _edges(shape)
    closed = [edge for edge in edges if edge not in is_open]
    # One wall in five goes, which makes loops; more or fewer where walls would be too thin or too thick.
    order = generator.permutation(len(closed))
    keep = min(len(closed), max(1, math.ceil(0.8 * len(closed))))
    target = density * size[0] * size[1]
    counts = sorted(range(1, len(closed) + 1), key=lambda count: abs(count - keep))
    for count in counts:
        kept = [closed[i] for i in order[:count]]
        some = _doors(generator, [edge for edge in edges if edge not in kept], pitch)
        for doors in (some, {}):
            thickness = _thickness(kept, doors, shape, pitch, target)
            if thickness is not None:
                return Layout(_walls(kept, doors, shape, pitch, size, thickness, generator.uniform(1.2, 2.0)))
    return Shortfall([])


_Edge = tuple[int, int, int]
"""The side between cell (column, row) and its neighbour to the right (axis 0) or above (axis 1)."""


def _shapes(size: tuple[float, float]) -> list[tuple[int, int]]:
    """Grids whose cells are of a good size."""
    columns, rows = map(_counts, size)
    return [(column, row) for column in columns for row in rows]


def _counts(length: float) -> range:
    """Into how many cells of a good size a length may be divided."""
    return range(max(2, math.ceil(length / CELL[1] - 1e-9)), math.floor(length / CELL[0] + 1e-9) + 1)


def _edges(shape: tuple[int, int]) -> list[_Edge]:
    columns, rows = shape
    across = [(column, row, 0) for column in range(columns - 1) for row in range(rows)]
    return across + [(column, row, 1) for column in range(columns) for row in range(rows - 1)]


def _thickest(size: tuple[float, float], shape: tuple[int, int]) -> float:
    """Thickness, metres, at which the narrowest corridor is just a passage."""
    return min(THICKNESS[1], float(np.min(np.array(size) / shape)) - PASSAGE - 2 * SLACK)


def _density_range(size: tuple[float, float], shape: tuple[int, int]) -> tuple[float, float]:
    """Shares of the floor that walls may cover, on the safe side of the greatest."""
    pitch = np.array(size) / shape
    most = (shape[0] - 1) * (shape[1] - 1)
    thickest = _thickest(size, shape)
    length = float(pitch.min())
    return THICKNESS[0] * float(pitch.max()) / (size[0] * size[1]), most * thickest * (length - thickest) / (
        size[0] * size[1]
    )


def _tree(generator: np.random.Generator, shape: tuple[int, int]) -> set[_Edge]:
    """The sides that are open in a maze without loops, found by walking on at random and back from dead ends."""
    columns, rows = shape
    trail = [(int(generator.integers(columns)), int(generator.integers(rows)))]
    visited, is_open = set(trail), set()
    while trail:
        column, row = trail[-1]
        ways = [(column + dx, row + dy) for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        ways = [(c, r) for c, r in ways if 0 <= c < columns and 0 <= r < rows and (c, r) not in visited]
        if not ways:
            trail.pop()
            continue
        following = ways[int(generator.integers(len(ways)))]
        is_open.add((min(column, following[0]), min(row, following[1]), 0 if following[1] == row else 1))
        visited.add(following)
        trail.append(following)
    return is_open


def _doors(generator: np.random.Generator, openings: list[_Edge], pitch: np.ndarray) -> dict[_Edge, float]:
    """The openings that are narrowed, and the width of each door, metres."""
    chances = generator.random((len(openings), 2))
    doors = {}
    for edge, (chance, width) in zip(openings, chances.tolist(), strict=True):
        widest = float(pitch[1 - edge[2]]) - 0.5
        if chance < _DOORS and widest > PASSAGE + 2 * SLACK:
            doors[edge] = PASSAGE + 2 * SLACK + width * min(0.2, widest - PASSAGE - 2 * SLACK)
    return doors


def _posts(edge: _Edge) -> tuple[tuple[int, int], tuple[int, int]]:
    """The two ends of a side, as crossings of grid lines."""
    column, row, axis = edge
    return ((column + 1, row), (column + 1, row + 1)) if axis == 0 else ((column, row + 1), (column + 1, row + 1))


def _thickness(
    kept: list[_Edge], doors: dict[_Edge, float], shape: tuple[int, int], pitch: np.ndarray, target: float
) -> float | None:
    """The thickness, metres, at which the walls cover ``target``, m²; None where it is too little or too much.

    Sides without the posts at their ends cover (length − posts) · t, each post in the room t².
    """
    posts = {post for edge in (*kept, *doors) for post in _posts(edge) if _is_inside(post, shape)}
    linear, square = 0.0, float(len(posts))
    for edge in (*kept, *doors):
        linear += float(pitch[1 - edge[2]]) - doors.get(edge, 0.0)
        square -= 0.5 * sum(_is_inside(post, shape) for post in _posts(edge))
    root = linear * linear + 4.0 * square * target
    if root < 0.0 or linear + math.sqrt(root) <= 0.0:
        return None
    thickness = 2.0 * target / (linear + math.sqrt(root))
    thickest = min(THICKNESS[1], float(pitch.min()) - PASSAGE - 2 * SLACK)
    return thickness if THICKNESS[0] <= thickness <= thickest else None


def _is_inside(post: tuple[int, int], shape: tuple[int, int]) -> bool:
    return 0 < post[0] < shape[0] and 0 < post[1] < shape[1]


def _walls(
    kept: list[_Edge],
    doors: dict[_Edge, float],
    shape: tuple[int, int],
    pitch: np.ndarray,
    size: tuple[float, float],
    thickness: float,
    height: float,
) -> list[Part]:
    """Walls in a line are one box; what stands beside a door is a box of its own where it meets no other wall."""
    spans: dict[tuple[int, int], list[tuple[float, float]]] = {}  # by axis and line: where walls stand along it
    t = thickness
    for edge in (*kept, *doors):
        column, row, axis = edge
        line, cell = (column + 1, row) if axis == 0 else (row + 1, column)
        low, high = cell * float(pitch[1 - axis]), (cell + 1) * float(pitch[1 - axis])
        first, last = (_is_inside(post, shape) for post in _posts(edge))
        low, high = low - (0.5 * t if first else 0.0), high + (0.5 * t if last else 0.0)
        pieces = [(low, high)]
        if edge in doors:
            middle = 0.5 * (low + high)
            pieces = [(low, middle - 0.5 * doors[edge]), (middle + 0.5 * doors[edge], high)]
        spans.setdefault((axis, line), []).extend(pieces)
    parts: list[Part] = []
    for (axis, line), pieces in sorted(spans.items()):
        for low, high in _merged(pieces):
            low, high = max(low, 0.001), min(high, size[1 - axis] - 0.001)  # rounded to 1 mm, none sticks out
            along, across = 0.5 * (low + high) - 0.5 * size[1 - axis], line * float(pitch[axis]) - 0.5 * size[axis]
            at = (across, along) if axis == 0 else (along, across)
            extent = (t, high - low) if axis == 0 else (high - low, t)
            parts.append(Part(f"wall {len(parts) + 1}", at, height, size=extent))
    return parts


def _merged(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if merged and low <= merged[-1][1] + 1e-9:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return merged
