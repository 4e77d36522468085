"""Distances to footprints and pairs of boxes, against shapely and brute force."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from random_shapes import ROUND, random_prisms, shape_of

from navsim.footprints import Footprints, overlapping_boxes
from navsim.prism import Prism


def signed_distance(shape: shapely.Geometry, points: shapely.Geometry) -> np.ndarray:
    outside = shapely.distance(shape, points)
    return np.where(outside > 0.0, outside, -shapely.distance(shape.exterior, points))


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_footprint_and_its_signed_distance_are_shapelys(seed):
    generator = np.random.default_rng(seed)
    prisms = random_prisms(generator, 25)
    points = generator.uniform(-4.0, 4.0, (300, 2))
    expected = np.array([signed_distance(shape_of(prism), shapely.points(points)) for prism in prisms])
    distance, index = Footprints.of(prisms).nearest(points)
    assert distance == pytest.approx(expected.min(axis=0), abs=ROUND)
    assert expected[index, np.arange(len(points))] == pytest.approx(expected.min(axis=0), abs=ROUND)


def test_a_point_level_with_a_lone_cylinder_has_a_distance():
    centre, radius = np.array([-0.47518304924715027, -1.1336024114775465]), 0.42789540982689017
    lone = Footprints.of([Prism("can", 0, 0.0, 1.0, centre[None], radius)])
    along = np.linspace(0.5, 6.0, 2000)[:, None] * np.array([[0.0, -1.0]])
    distance, index = lone.nearest(centre + along)
    np.testing.assert_allclose(distance, np.linspace(0.5, 6.0, 2000) - radius, atol=1e-12)
    assert (index == 0).all()


def test_without_footprints_everything_is_infinitely_far():
    distance, index = Footprints.of([]).nearest(np.zeros((2, 2)))
    assert np.isposinf(distance).all()
    assert (index == -1).all()
    clear = np.empty(0)
    assert Footprints.of([]).points_keep_clear(np.zeros((2, 2)), clear).all()
    assert Footprints.of([]).segments_keep_clear(np.zeros((2, 2)), np.ones((2, 2)), clear).all()


@pytest.mark.parametrize("seed", range(5))
def test_segment_distances_are_shapelys(seed):
    generator = np.random.default_rng(seed)
    prisms = random_prisms(generator, 20)
    starts, ends = generator.uniform(-4.0, 4.0, (2, 100, 2))
    ends[:10] = starts[:10]
    lines = shapely.linestrings(np.stack([starts, ends], axis=1))
    expected = np.array([shapely.distance(shape_of(prism), lines) for prism in prisms]).T
    segment, prism = np.divmod(np.arange(2000), 20)
    distance = Footprints.of(prisms).segment_distances(starts[segment], ends[segment], prism).reshape(100, 20)
    assert np.maximum(distance, 0.0) == pytest.approx(expected, abs=ROUND)
    assert (distance <= ROUND).tolist() == (expected <= ROUND).tolist()


@pytest.mark.parametrize("seed", range(5))
def test_keeping_clear_means_a_distance_of_at_least_that_much(seed):
    generator = np.random.default_rng(100 + seed)
    prisms = random_prisms(generator, int(generator.integers(1, 30)), half_size=6.0)
    starts, ends = generator.uniform(-6.0, 6.0, (2, 400, 2))
    ends[:200] = starts[:200] + generator.uniform(-1.0, 1.0, (200, 2))
    lines = shapely.linestrings(np.stack([starts, ends], axis=1))
    room = 0.2
    shapes = [shape_of(prism) for prism in prisms]
    line_room = np.min([shapely.distance(shape, lines) for shape in shapes], axis=0) - room
    point_room = np.min([shapely.distance(shape, shapely.points(starts)) for shape in shapes], axis=0) - room
    footprints = Footprints.of(prisms)
    clear = footprints.radius + room
    sure = np.abs(line_room) > ROUND
    assert (footprints.segments_keep_clear(starts, ends, clear) == (line_room > 0.0))[sure].all()
    sure = np.abs(point_room) > ROUND
    assert (footprints.points_keep_clear(starts, clear) == (point_room > 0.0))[sure].all()
    assert 0.0 < (line_room > 0.0).mean() < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_a_segment_enters_a_core_where_shapely_says(seed):
    generator = np.random.default_rng(seed)
    prisms = [prism for prism in random_prisms(generator, 40) if not prism.is_cylinder]
    starts, ends = generator.uniform(-3.0, 3.0, (2, 200, 2))
    segment, prism = np.divmod(np.arange(200 * len(prisms)), len(prisms))
    shares = Footprints.of(prisms).entry_shares(starts[segment], ends[segment], prism)
    for n in range(0, len(shares), 7):
        line = shapely.LineString([starts[segment[n]], ends[segment[n]]])
        inside = line.intersection(shape_of(prisms[prism[n]]))
        if inside.length > 1e-9:
            assert shares[n] * line.length == pytest.approx(line.project(shapely.Point(inside.coords[0])), abs=1e-9)
        elif inside.is_empty:
            assert shares[n] == np.inf


@st.composite
def boxes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    scale = draw(st.sampled_from([1e-3, 1.0, 1e4]))
    grid = st.integers(-4, 4)
    size = st.sampled_from([0.0, 0.001, 1.0, 3.0, 500.0])
    rows = draw(st.lists(st.tuples(grid, grid, size, size), max_size=12))
    array = np.array(rows, dtype=np.float64).reshape(-1, 4) * scale
    return array[:, :2], array[:, :2] + array[:, 2:]


@settings(max_examples=300, deadline=None)
@given(boxes(), boxes())
def test_overlapping_boxes_are_found_once_each_whatever_their_sizes(some, others):
    found = [
        pair for chunk in overlapping_boxes(*some, *others) for pair in zip(*map(np.ndarray.tolist, chunk), strict=True)
    ]
    (low, high), (other_low, other_high) = some, others
    expected = {
        (i, j)
        for i in range(len(low))
        for j in range(len(other_low))
        if (low[i] <= other_high[j]).all() and (high[i] >= other_low[j]).all()
    }
    assert len(found) == len(set(found))
    assert set(found) == expected
