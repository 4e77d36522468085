"""Which places are connected, against the pieces of shapely's free space."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from random_shapes import random_prisms, shape_of

from navsim.connectivity import Chains
from navsim.footprints import Footprints
from navsim.prism import Prism

RADIUS = 0.1755


def block(low: tuple[float, float], high: tuple[float, float]) -> Prism:
    return Prism("block", 0, 0.0, 1.0, np.array([low, (high[0], low[1]), high, (low[0], high[1])]))


def ring(half: float, gap: float = 0.0) -> list[Prism]:
    """Four thin walls around the origin, with a gap in the middle of the northern one."""
    walls = [block((-half, -half), (half, -half + 0.1)), block((-half, -half), (-half + 0.1, half))]
    walls.append(block((half - 0.1, -half), (half, half)))
    return [*walls, block((-half, half - 0.1), (-gap / 2, half)), block((gap / 2, half - 0.1), (half, half))]


def regions(prisms: list[Prism], points: list[tuple[float, float]]) -> list[int]:
    return Chains(Footprints.of(prisms), RADIUS).regions(np.array(points)).tolist()


def test_without_obstacles_everything_is_connected():
    assert len(set(regions([], [(0, 0), (5, 5)]))) == 1
    assert len(set(regions([block((0, 0), (1, 1))], [(-1, 0), (5, 5)]))) == 1


def test_a_closed_ring_cuts_its_inside_off():
    inside, outside = regions(ring(2.0), [(0, 0), (3, 0)])
    assert inside != outside


@pytest.mark.parametrize("gap", [2 * RADIUS - 1e-6, 2 * RADIUS + 1e-6])
def test_a_gap_lets_the_robot_through_when_it_is_as_wide_as_the_robot(gap):
    inside, outside = regions(ring(2.0, gap), [(0, 0), (3, 0)])
    assert (inside == outside) == (gap > 2 * RADIUS)


@pytest.mark.parametrize("gap", [2 * RADIUS - 1e-4, 2 * RADIUS + 1e-4])
def test_a_gap_from_corner_to_corner_is_measured_as_the_robot_passes_it(gap):
    reach = 2.0 - gap / math.sqrt(2.0)
    walls = [block((-2, 2), (reach, 2.1)), block((2, -2), (2.1, reach)), *ring(2.0)[:2]]
    inside, outside = regions(walls, [(0, 0), (3, 0)])
    assert (inside == outside) == (gap > 2 * RADIUS)


def test_rings_within_rings_are_told_apart():
    numbers = regions([*ring(1.0), *ring(2.0)], [(0, 0), (0.3, 0.2), (1.5, 0), (-1.5, 0), (4, 0), (-4, 1)])
    assert numbers[0] == numbers[1]
    assert numbers[2] == numbers[3]
    assert numbers[4] == numbers[5]
    assert len(set(numbers)) == 3


def test_two_rings_side_by_side_are_told_apart_though_each_is_surrounded_once():
    shifted = [Prism(p.name, 0, 0.0, 1.0, p.vertices + np.array([6.0, 0.0])) for p in ring(2.0)]
    assert len(set(regions([*ring(2.0), *shifted], [(0, 0), (6, 0), (3, 0)]))) == 3


def test_an_obstacle_inside_another_closes_nothing():
    nested = [block((0, 0), (2, 2)), block((0.5, 0.5), (1, 1)), Prism("can", 0, 0.0, 1.0, np.array([[1.5, 1.5]]), 0.1)]
    assert len(set(regions(nested, [(-1, 1), (3, 1), (1, -1), (1, 3)]))) == 1


@pytest.mark.parametrize("seed", range(40))
def test_regions_are_the_pieces_of_the_free_space(seed, monkeypatch):
    # Among many footprints only neighbours are compared, among few all of them: either way must find all links.
    monkeypatch.setattr("navsim.connectivity.COMPARED_WITH_ALL", 0 if seed % 2 else 1000)
    generator = np.random.default_rng(seed)
    half = 3.0
    prisms = random_prisms(generator, int(generator.integers(10, 30)))
    walls = [
        block((-half - 1, half), (half + 1, half + 1)),
        block((half, -half), (half + 1, half)),
        block((-half - 1, -half - 1), (half + 1, -half)),
        block((-half - 1, -half), (-half, half)),
    ]
    blocked = shapely.union_all([shape_of(prism).buffer(RADIUS, quad_segs=64) for prism in prisms])
    room = shapely.box(-half, -half, half, half).buffer(-RADIUS)
    pieces = [piece.buffer(1e-4) for piece in shapely.get_parts(room.difference(blocked))]
    footprints = Footprints.of([*prisms, *walls])
    points = generator.uniform(-half, half, (150, 2))
    points = points[footprints.nearest(points)[0] > RADIUS + 1e-3]
    expected = np.array([[piece.contains(shapely.Point(point)) for piece in pieces].index(True) for point in points])
    numbers = Chains(footprints, RADIUS).regions(points)
    assert ((numbers[:, None] == numbers) == (expected[:, None] == expected)).all()
