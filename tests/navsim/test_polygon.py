"""Polygons: shapely says which ones are simple, and what their pieces must add up to."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from navsim.polygon import convex_pieces, crossing_edges, signed_area

L_SHAPE = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)]
COMB = [(0.0, 0.0), (5.0, 0.0), (5.0, 2.0), (4.0, 2.0), (4.0, 0.5), (3.0, 0.5), (3.0, 2.0), (2.0, 2.0), (2.0, 0.5)]
COMB += [(1.0, 0.5), (1.0, 2.0), (0.0, 2.0)]
WINDINGS = [0.4 * k for k in range(40)]
SPIRAL = [((1.0 + 0.3 * t) * math.cos(t), (1.0 + 0.3 * t) * math.sin(t)) for t in WINDINGS]
SPIRAL += [((0.6 + 0.3 * t) * math.cos(t), (0.6 + 0.3 * t) * math.sin(t)) for t in reversed(WINDINGS)]

grid_points = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=8)
distinct_grid_points = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=8, unique=True)
"""A third of them are simple, of ``grid_points`` a tenth, too few for Hypothesis to filter."""


@st.composite
def star_polygons(draw) -> list[tuple[float, float]]:
    """Simple polygons around the origin, most of them concave, in either winding."""
    radii = draw(st.lists(st.floats(0.2, 3.0), min_size=4, max_size=16))
    points = [
        (r * math.cos(math.tau * k / len(radii)), r * math.sin(math.tau * k / len(radii))) for k, r in enumerate(radii)
    ]
    return points[::-1] if draw(st.booleans()) else points


def number_of_reflex_corners(points) -> int:
    if not shapely.LinearRing(points).is_ccw:
        points = points[::-1]
    corners = np.asarray(points, dtype=float)
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    return int((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0.0).sum())


def assert_pieces_are_the_polygon(points) -> None:
    outline = shapely.Polygon(points)
    pieces = [shapely.Polygon(piece) for piece in convex_pieces(points)]
    assert sum(piece.area for piece in pieces) == pytest.approx(outline.area, rel=1e-9)
    assert shapely.union_all(pieces, grid_size=1e-9).symmetric_difference(outline).area < 1e-7 * outline.area
    for piece in pieces:
        assert piece.exterior.is_ccw
        assert piece.convex_hull.area == pytest.approx(piece.area, rel=1e-9)
        assert set(piece.exterior.coords) <= set(outline.exterior.coords)
    assert len(pieces) <= 2 * number_of_reflex_corners(points) + 1


@given(distinct_grid_points)
def test_signed_area_is_shapelys_with_the_sign_of_the_winding(points):
    ring = shapely.LinearRing(points)
    assume(ring.is_simple)
    assert signed_area(points) == (1 if ring.is_ccw else -1) * shapely.Polygon(points).area


@settings(max_examples=250, deadline=None)
@given(grid_points)
def test_a_polygon_is_simple_exactly_when_shapely_finds_it_valid(points):
    assume(all(a != b for a, b in zip(points, points[1:] + points[:1], strict=True)))
    outline = shapely.Polygon(points)
    assert (crossing_edges(points) is None) == (outline.is_valid and outline.area > 0.0)


@pytest.mark.parametrize(
    ("points", "edges"),
    [
        pytest.param([(0, 0), (2, 2), (2, 0), (0, 2)], (0, 2), id="a bow tie crosses"),
        pytest.param([(0, 0), (4, 0), (4, 2), (2, 0), (0, 2)], (0, 2), id="a corner touches an edge"),
        pytest.param([(0, 0), (4, 0), (2, 0), (2, 2)], (0, 1), id="an edge folds back"),
        pytest.param([(0, 0), (2, 0), (2, 1), (1, 0), (0, 0.5)], (0, 2), id="a corner rests on an edge"),
        pytest.param([(0, 0), (1, 1), (2, 0), (2, 2), (1, 1), (0, 2)], (0, 3), id="two corners coincide"),
    ],
)
def test_the_edges_that_meet_are_named(points, edges):
    assert crossing_edges(points) == edges


@pytest.mark.parametrize("points", [L_SHAPE, COMB, SPIRAL], ids=["L", "comb", "spiral"])
@pytest.mark.parametrize("turn", [1, -1], ids=["counter-clockwise", "clockwise"])
def test_concave_polygons_are_cut_into_convex_pieces(points, turn):
    assert crossing_edges(points) is None
    assert_pieces_are_the_polygon(points[::turn])


@settings(max_examples=80, deadline=None)
@given(star_polygons())
def test_any_star_shaped_polygon_is_the_union_of_its_pieces(points):
    assert_pieces_are_the_polygon(points)


@settings(max_examples=80, deadline=None)
@given(distinct_grid_points)
def test_polygons_with_straight_corners_and_parallel_edges_are_the_union_of_their_pieces(points):
    assume(shapely.Polygon(points).is_valid)
    assert_pieces_are_the_polygon([(float(x), float(y)) for x, y in points])


def test_a_convex_polygon_is_one_piece_without_its_straight_corners():
    assert convex_pieces([(0, 0), (0, 2), (2, 2), (2, 0), (1, 0)]) == [[(2, 0), (2, 2), (0, 2), (0, 0)]]


def test_an_l_shape_is_two_pieces():
    assert len(convex_pieces(L_SHAPE)) == 2
