"""Cells to outlines and back; shapely says what they must be."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from navsim.convert import raster
from navsim.convert.raster import fill_pockets, occupied_cells
from navsim.polygon import crossing_edges
from navsim.prism import Prism
from navsim.world import MOST_CORNERS

grids = st.tuples(st.integers(1, 11), st.integers(1, 11)).flatmap(lambda shape: arrays(bool, shape))


def outlines(mask: np.ndarray, tolerance: float = 0.0) -> list[np.ndarray]:
    return list(raster.outlines(mask, tolerance))


def cells_of(mask: np.ndarray) -> shapely.Geometry:
    return shapely.union_all([shapely.box(x, y, x + 1, y + 1) for y, x in zip(*np.nonzero(mask), strict=True)])


def polygons_of(mask: np.ndarray, tolerance: float) -> list[shapely.Polygon]:
    found = outlines(mask, tolerance)
    for outline in found:
        assert crossing_edges([(float(x), float(y)) for x, y in outline]) is None
    polygons = [shapely.Polygon(outline) for outline in found]
    assert all(polygon.is_valid and polygon.exterior.is_ccw for polygon in polygons)
    return polygons


@settings(max_examples=50, deadline=None)
@given(grids)
def test_outlines_without_tolerance_are_the_cells_exactly_and_do_not_overlap(mask):
    polygons = polygons_of(mask, 0.0)
    assert sum(polygon.area for polygon in polygons) == mask.sum()
    assert shapely.union_all(polygons).symmetric_difference(cells_of(mask)).area < 1e-9


@settings(max_examples=50, deadline=None)
@given(grids, st.sampled_from([0.5, 0.75, 1.5]))
def test_simplified_outlines_stay_within_the_tolerance_of_the_cells(mask, tolerance):
    cells, union = cells_of(mask), shapely.union_all(polygons_of(mask, tolerance))
    assert union.difference(cells.buffer(tolerance + 1e-9)).area < 1e-9
    assert cells.difference(union.buffer(tolerance + 1e-9)).area < 1e-9


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 0.75, 1.5]))
def test_pieces_of_one_patch_keep_the_border_between_them(seed, tolerance):
    """Or else one could see through where a patch is cut."""
    mask = np.random.default_rng(seed).random((9, 9)) < 0.85
    exact, simple = polygons_of(mask, 0.0), polygons_of(mask, tolerance)
    for i, piece in enumerate(exact):
        for k in range(i + 1, len(exact)):
            common = shapely.get_parts(piece.boundary.intersection(exact[k].boundary))
            for line in common[shapely.length(common) > 0.0]:  # two pieces may also meet in a point
                assert simple[i].boundary.buffer(1e-9).contains(line)
                assert simple[k].boundary.buffer(1e-9).contains(line)


def test_a_ring_is_cut_so_that_no_piece_has_a_hole():
    mask = np.ones((5, 7), dtype=bool)
    mask[2, 2:5] = False
    assert len(outlines(mask)) == 2
    assert len(outlines(np.ones((5, 7), dtype=bool))) == 1


def test_a_patch_with_more_corners_than_a_polygon_may_have_is_cut():
    comb = np.zeros((4, 2400), dtype=bool)
    comb[0], comb[:, ::2] = True, True
    polygons = polygons_of(comb, 0.0)
    assert max(len(polygon.exterior.coords) - 1 for polygon in polygons) <= MOST_CORNERS
    assert sum(polygon.area for polygon in polygons) == comb.sum()
    assert shapely.union_all(polygons).symmetric_difference(cells_of(comb)).area < 1e-9


def test_corners_are_counted_as_outlines_have_them():
    mask = np.random.default_rng(3).random((40, 30)) < 0.3
    borders = shapely.union_all([shapely.box(x, y, x + 1, y + 1) for y, x in zip(*np.nonzero(mask), strict=True)])
    rings = [ring for one in shapely.get_parts(borders) for ring in (one.exterior, *one.interiors)]
    corners = sum(len(ring.simplify(0.0).coords) - 1 for ring in rings)
    assert raster.count_corners(mask) == pytest.approx(corners, abs=len(rings))  # a ring may begin on a straight line


def test_speckles_and_windings_without_end_are_refused(monkeypatch):
    with pytest.raises(raster.IntricateError, match="borders of 320000 corners, more than 200000"):
        raster.check_borders(np.indices((400, 400)).sum(axis=0) % 2 == 0)
    monkeypatch.setattr(raster, "MOST_CELLS", 100)
    rings = np.zeros((200, 200), dtype=bool)
    for i in range(0, 100, 2):
        rings[i : 200 - i, i : 200 - i] = True
        rings[i + 1 : 199 - i, i + 1 : 199 - i] = False
    with pytest.raises(raster.IntricateError, match="wind round one another"):
        outlines(rings)


def test_a_slanting_wall_becomes_straight():
    mask = np.zeros((60, 60), dtype=bool)
    for i in range(50):
        mask[i : i + 6, i : i + 4] = True
    assert len(outlines(mask)[0]) > 150
    (outline,) = outlines(mask, 0.75)
    assert len(outline) <= 10


def test_pockets_are_filled_if_nothing_of_that_radius_fits_into_them():
    mask = np.ones((40, 40), dtype=bool)
    mask[5:8, 5:8] = False
    mask[15:35, 15:35] = False
    mask[0:10, 30:34] = False
    filled, count = fill_pockets(mask, 5.0)
    assert count == 1
    assert filled[5:8, 5:8].all()
    assert not filled[15:35, 15:35].any()
    assert not filled[0:10, 30:34].any()  # a bay, not a pocket


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_cells_are_occupied_exactly_where_a_footprint_reaches_into_them(seed):
    generator = np.random.default_rng(seed)
    angles = np.sort(generator.uniform(0.0, 2.0 * np.pi, generator.integers(3, 8)))
    corners = generator.uniform(0.05, 1.2) * np.column_stack([np.cos(angles), np.sin(angles)])
    centre = generator.uniform(-1.0, 1.0, 2)
    radius = generator.uniform(0.02, 0.8)
    origin, cell, shape = np.array([-1.0, -0.9]), 0.13, (14, 16)
    squares = [[shapely.box(*(origin + cell * np.array([x, y])), *(origin + cell * np.array([x + 1, y + 1])))
                for x in range(shape[1])] for y in range(shape[0])]  # fmt: skip
    found = occupied_cells([Prism("p", 0, 0.0, 1.0, centre + corners)], origin, cell, shape)
    polygon = shapely.Polygon(centre + corners).convex_hull
    assert np.array_equal(found, shapely.area(shapely.intersection(polygon, np.array(squares))) > 1e-12)
    found = occupied_cells([Prism("c", 0, 0.0, 1.0, centre[None], radius)], origin, cell, shape)
    assert np.array_equal(found, shapely.distance(shapely.Point(centre), np.array(squares)) < radius)


def test_a_footprint_along_cell_borders_occupies_no_cell_more():
    square = np.array([[0.1, 0.2], [0.5, 0.2], [0.5, 0.6], [0.1, 0.6]])
    cells = occupied_cells([Prism("p", 0, 0.0, 1.0, square)], np.zeros(2), 0.1, (10, 10))
    assert cells.sum() == 16
    assert cells[2:6, 1:5].all()


def test_a_lone_cell_stays_a_square_whatever_the_tolerance():
    assert outlines(np.zeros((3, 3), dtype=bool)) == []
    assert shapely.Polygon(outlines(np.ones((1, 1), dtype=bool), 5.0)[0]).equals(shapely.box(0, 0, 1, 1))
