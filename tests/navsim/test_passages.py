"""Narrowest passages, against the free space that shapely makes by growing the obstacles."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from navsim.passages import WIDEST_GAP, Passage, narrowest_passages
from navsim.planner import clearance
from navsim.world import Box, Cylinder, Polygon, World


def joined(world: World, width: float, start: np.ndarray, goal: np.ndarray) -> bool:
    """Whether a disc of that diameter gets from start to goal."""
    half = world.half_size
    room = shapely.box(*-half, *half).buffer(-width / 2, join_style="mitre")
    shapes = []
    for obstacle in world.obstacles:
        if obstacle.base < 0.42:
            shape = (
                shapely.Point(obstacle.at).buffer(obstacle.radius, quad_segs=64)
                if isinstance(obstacle, Cylinder)
                else shapely.Polygon(obstacle.footprints()[0][0] if isinstance(obstacle, Box) else obstacle.points)
            )
            shapes.append(shape.buffer(width / 2, quad_segs=64))
    free = room.difference(shapely.union_all(shapes))
    parts = [part for part in shapely.get_parts(free) if part.intersects(shapely.Point(start))]
    return any(part.intersects(shapely.Point(goal)) for part in parts)


def has_room(world: World, width: float, point: np.ndarray) -> bool:
    return joined(world, width, point, point)


def random_world(rng: np.random.Generator) -> World:
    obstacles: list = []
    for _ in range(rng.integers(9, 15)):
        at = rng.uniform(-3.0, 3.0, 2).tolist()
        base = 0.0 if rng.random() < 0.85 else 0.7
        kind = rng.integers(3)
        if kind == 0:
            size = rng.uniform(0.1, 2.0, 2).tolist()
            obstacles.append(Box(at=at, size=size, yaw_deg=float(rng.uniform(0, 90)), height=1, base=base))
        elif kind == 1:
            obstacles.append(Cylinder(at=at, radius=float(rng.uniform(0.05, 0.6)), height=1, base=base))
        else:
            corner = np.array([(0, 0), (1.5, 0), (1.5, 1.5), (1.2, 1.5), (1.2, 0.3), (0, 0.3)]) + np.multiply(at, 0.6)
            obstacles.append(Polygon(points=corner.tolist(), height=1, base=base))
    return World(size=(7, 7), obstacles=obstacles)


def roomy_points(world: World, rng: np.random.Generator) -> np.ndarray:
    """Places ``(8, 2)`` around which there is more room than at most: what is near the ends hides no passage."""
    candidates = rng.uniform(-3.3, 3.3, (400, 2))
    blocking = [prism for prism in world.prisms if prism.base < 0.42]
    chosen: list[np.ndarray] = []
    for point in candidates[np.argsort(-clearance(blocking, candidates))]:
        if all(np.linalg.norm(point - other) > 1.0 for other in chosen):
            chosen.append(point)
    return np.array(chosen[:8])


@pytest.mark.parametrize("seed", range(7))
def test_a_disc_gets_through_exactly_when_it_is_narrower_than_the_passage(seed):
    rng = np.random.default_rng([seed, 3])
    world = random_world(rng)
    points = roomy_points(world, rng)
    found = narrowest_passages(world, points[:4], points[4:])
    compared = 0
    for i, start in enumerate(points[:4]):
        for j, goal in enumerate(points[4:]):
            width = found[i][j].width
            if not math.isfinite(width) or width < 0.02:
                continue
            wide, narrow = width + 2e-3, width - 2e-3
            if has_room(world, wide, start) and has_room(world, wide, goal):
                assert joined(world, narrow, start, goal)
                assert not joined(world, wide, start, goal)
                compared += 1
    assert compared >= 2


def test_a_gap_between_two_boxes_has_its_width_and_its_sides():
    world = World(
        size=(7, 7),
        obstacles=[
            Box(name="left", at=(0, 2.05), size=(0.2, 2.9), height=1),
            Box(name="right", at=(0, -1.95), size=(0.2, 3.1), height=1),
            Box(name="beam", at=(0, 0.2), size=(0.2, 0.5), base=0.42, height=1),
        ],
    )
    ((passage,),) = narrowest_passages(world, np.array([(-2, 0)]), np.array([(2, 1)]))
    assert passage.width == pytest.approx(1.0)
    assert set(passage.sides) == {"left", "right"}
    taller = narrowest_passages(world, np.array([(-2, 0)]), np.array([(2, 1)]), robot_height=0.5)[0][0]
    assert taller.width == pytest.approx(0.35)
    assert set(taller.sides) == {"right", "beam"}


def test_of_two_ways_the_wider_one_counts():
    posts = [
        Cylinder(name=f"post {y}", at=(0, y), radius=0.1, height=1) for y in (-2.9, -2.3, -1.0, 0.6, 1.4, 2.4, 3.3)
    ]
    ((passage,),) = narrowest_passages(World(size=(7, 7), obstacles=posts), np.array([(-2, 0)]), np.array([(2, 0)]))
    assert passage == Passage(pytest.approx(1.4), ("post -1.0", "post 0.6"))


def test_a_goal_beside_a_wall_is_behind_no_passage():
    found = narrowest_passages(World(size=(7, 7)), np.array([(0, 0)]), np.array([(3.3, 0), (0, -3.3)]))
    assert min(passage.width for passage in found[0]) >= 7.0


def test_on_an_open_floor_the_way_leads_around():
    wall = [Box(at=(0, 0), size=(0.1, 7), height=1)]
    closed = World(size=(7, 7), obstacles=wall, starts=[(-1, 0)], walls=None)
    ((passage,),) = narrowest_passages(closed, np.array([(-1, 0)]), np.array([(1, 0)]))
    assert passage.width == pytest.approx(2.0)
    assert "the edge of the open floor" in passage.sides


def test_large_worlds_know_gaps_up_to_a_limit():
    rng = np.random.default_rng(5)
    posts = [Cylinder(at=tuple(at), radius=0.1, height=1) for at in rng.uniform(-24, 24, (400, 2)).tolist()]
    fence = [Cylinder(name=f"f{i}", at=(0, y), radius=0.1, height=1) for i, y in enumerate(np.arange(-24.6, 24.9, 0.8))]
    world = World(size=(50, 50), obstacles=[*posts, *fence])
    ((passage,),) = narrowest_passages(world, np.array([(-20, 0.1)]), np.array([(20, 0.1)]))
    assert passage.width == pytest.approx(0.7)
    assert passage.sides == ("wall north", "f61")
    assert narrowest_passages(world, np.array([(1, 0.1)]), np.array([(20, 0.1)]))[0][0].width > WIDEST_GAP - 1.0
