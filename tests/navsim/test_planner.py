"""Clearance, connections, shortest paths and distance fields, against shapely and closed forms."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest
import shapely
from random_shapes import ROUND, random_prisms, shape_of
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from navsim import planner
from navsim.planner import (
    OPEN_FLOOR_MARGIN,
    DistanceField,
    clearance,
    connected,
    free_space,
    shortest_path,
    shortest_path_length,
)
from navsim.prism import Prism
from navsim.tangents import TangentGraph
from navsim.world import World

RADIUS = 0.1755
CIRCLE_POINTS = 720  # on the reference's goal circle; they lengthen a path of 0.2 m by less than 2e-5 m
SLACK = 2e-5


def make_world(*obstacles: dict, size: tuple[float, float] = (7.0, 7.0), **settings) -> World:
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def box(at: tuple[float, float], size: tuple[float, float], **settings) -> dict:
    return {"box": {"at": list(at), "size": list(size), "height": 1.0, **settings}}


def cylinder(at: tuple[float, float], radius: float, **settings) -> dict:
    return {"cylinder": {"at": list(at), "radius": radius, "height": 1.0, **settings}}


def random_world(seed: int, count: int, half: float = 2.2) -> World:
    """A room with obstacles of all kinds that may overlap, some of them too low or too high to count."""
    generator = np.random.default_rng(seed)
    obstacles: list[dict] = []
    for prism in random_prisms(generator, count, half):
        if prism.is_cylinder:
            obstacles.append(cylinder(tuple(prism.vertices[0]), prism.radius))
        elif (np.abs(prism.vertices) < half).all():
            obstacles.append({"polygon": {"points": prism.vertices.tolist(), "height": 1.0}})
    obstacles.append({"box": {"at": [0.0, 0.0], "size": [half, half], "base": 0.42, "height": 0.1}})
    return make_world(*obstacles, size=(2.0 * half, 2.0 * half))


def free_points(world: World, count: int, seed: int = 0) -> np.ndarray:
    """Places where the robot fits with a millimetre to spare."""
    points = np.random.default_rng(seed).uniform(-world.half_size, world.half_size, (20 * count, 2))
    return points[clearance(world.prisms, points, 0.0, 0.42) > RADIUS + 1e-3][:count]


class VisibilityGraph:
    """Shortest paths by another way: a visibility graph on polygons around or inside the grown obstacles, by shapely.

    Polygons inside round the arcs off too tightly and give a lower bound; polygons around them give an upper bound.
    """

    def __init__(self, world: World, *, outer: bool, quarter: int = 5) -> None:
        stretch = 1.0 / math.cos(math.pi / (4 * quarter)) if outer else 1.0
        grown = [self._grown(prism, stretch, quarter) for prism in world.prisms if prism.obstacle >= 0]
        room = shapely.box(*(RADIUS - world.half_size), *(world.half_size - RADIUS))
        free = room.difference(shapely.union_all([shape for shape in grown if shape is not None]))
        self.corners = np.unique(shapely.get_coordinates(free), axis=0)
        self.free = free.buffer(1e-9)
        shapely.prepare(self.free)
        self.first, self.second = np.triu_indices(len(self.corners), 1)
        seen = self._see(self.corners[self.first], self.corners[self.second])
        self.first, self.second = self.first[seen], self.second[seen]

    @staticmethod
    def _grown(prism: Prism, stretch: float, quarter: int) -> shapely.Geometry | None:
        if not prism.overlaps_heights(0.0, 0.42):
            return None
        if prism.is_cylinder:
            return shapely.Point(prism.vertices[0]).buffer((prism.radius + RADIUS) * stretch, quad_segs=quarter)
        return shapely.Polygon(prism.vertices).buffer(RADIUS * stretch, quad_segs=quarter)

    def _see(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        return shapely.covers(self.free, shapely.linestrings(np.stack([begin, end], axis=1)))

    def length(self, start: np.ndarray, goal: np.ndarray, goal_radius: float) -> float:
        angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
        ends = goal + goal_radius * np.column_stack([np.cos(angles), np.sin(angles)])
        ends = ends[shapely.covers(self.free, shapely.points(ends))]
        nodes = np.concatenate([self.corners, start[None]])
        last = len(self.corners)
        tail = np.concatenate([self.first, np.full(last, last), np.repeat(np.arange(last + 1), len(ends))])
        head = np.concatenate([self.second, np.arange(last), last + 1 + np.tile(np.arange(len(ends)), last + 1)])
        places = np.concatenate([nodes, ends])
        new = slice(len(self.first), None)
        seen = np.ones(len(tail), dtype=bool)
        seen[new] = self._see(places[tail[new]], places[head[new]])
        tail, head = tail[seen], head[seen]
        lengths = np.linalg.norm(places[head] - places[tail], axis=1)
        graph = coo_array((lengths, (tail, head)), shape=(len(places),) * 2).tocsr()
        return float(dijkstra(graph, directed=False, indices=last)[last + 1 :].min(initial=math.inf))


# Clearance


def test_clearance_is_shapelys_distance():
    world = random_world(3, 12)
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (200, 2))
    shapes = [shape_of(prism) for prism in world.prisms]
    expected = np.min([shapely.distance(shape, shapely.points(points)) for shape in shapes], axis=0)
    assert np.maximum(clearance(world.prisms, points), 0.0) == pytest.approx(expected, abs=ROUND)


def test_clearance_is_negative_inside_and_zero_on_the_edge():
    world = make_world(box((0, 0), (2, 2)), walls="none")
    distances = clearance(world.prisms, [[0.0, 0.0], [0.9, 0.0], [1.0, 0.5], [2.0, 2.0]])
    assert distances == pytest.approx([-1.0, -0.1, 0.0, math.sqrt(2.0)])


def test_clearance_counts_only_prisms_that_share_a_height():
    prisms = make_world(box((0, 0), (1, 1), base=0.5, height=0.5), walls="none").prisms
    points = [[1.0, 0.0]]
    assert clearance(prisms, points, 0.0, 0.5) == math.inf
    assert clearance(prisms, points, 1.0, 2.0) == math.inf
    assert clearance(prisms, points, 0.0, 0.51) == pytest.approx([0.5])
    assert clearance(prisms, points) == pytest.approx([0.5])


def test_clearance_of_nothing():
    assert clearance([], [[0.0, 0.0]]) == math.inf
    assert clearance(make_world().prisms, np.empty((0, 2))).shape == (0,)


# Shortest paths


@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.slow) for seed in (5, 6))])
def test_shortest_paths_are_those_of_a_visibility_graph(seed):
    world = random_world(seed, 4 + seed % 8)
    places = free_points(world, 6, seed)
    inner, outer = (VisibilityGraph(world, outer=outer) for outer in (False, True))
    for start, goal, goal_radius in zip(places[::2], places[1::2], (0.0, 0.5, 0.3), strict=False):
        length = shortest_path_length(world, start, goal, goal_radius=goal_radius)
        if np.linalg.norm(goal - start) <= goal_radius:
            assert length == 0.0
            continue
        least, most = (graph.length(start, goal, goal_radius) for graph in (inner, outer))
        assert least - SLACK <= length
        assert length <= most + SLACK


@pytest.mark.parametrize("seed", range(8))
def test_a_path_keeps_clear_and_is_as_long_as_is_said(seed):
    world = random_world(seed, 10)
    places = free_points(world, 20, seed)
    for start, goal in zip(places[::2], places[1::2], strict=True):
        path, length = shortest_path(world, start, goal), shortest_path_length(world, start, goal)
        if path is None:
            assert length == math.inf
            continue
        assert path[0] == pytest.approx(start)
        assert np.linalg.norm(path[-1] - goal) <= max(0.5, np.linalg.norm(start - goal)) + 1e-6
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert steps.sum() == pytest.approx(length, rel=1e-3)
        between = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(path)] or [path])
        assert clearance(world.prisms, between, 0.0, 0.42).min() >= RADIUS - 4e-4  # chords of arcs


def test_around_a_can_the_path_is_two_tangents_and_an_arc():
    world = make_world(cylinder((0, 0), 0.5))
    grown, away = 0.5 + RADIUS, 2.0
    expected = 2.0 * math.sqrt(away**2 - grown**2) + grown * (math.pi - 2.0 * math.acos(grown / away))
    assert shortest_path_length(world, (-2, 0), (2, 0), goal_radius=0.0) == pytest.approx(expected)


def test_a_path_ends_at_the_goals_circle_where_it_first_meets_it():
    assert shortest_path_length(make_world(), (-2, 0), (2, 0)) == pytest.approx(3.5)
    path = shortest_path(make_world(), (-2, 0), (2, 0))
    assert path == pytest.approx(np.array([[-2.0, 0.0], [1.5, 0.0]]))


def test_a_path_may_end_on_an_obstacles_corner_inside_the_goals_circle():
    # A long wall between the robot and the goal: the circle sticks out past its end, where the corner's arc meets it.
    world = make_world(box((-1.5, 0), (3.0, 0.1)))
    start, goal, goal_radius = np.array([-1.0, -0.5]), np.array([-0.1, 0.4]), 0.5
    least, most = (VisibilityGraph(world, outer=o).length(start, goal, goal_radius) for o in (False, True))
    length = shortest_path_length(world, start, goal, goal_radius=goal_radius)
    assert least - SLACK <= length <= most + SLACK
    end = shortest_path(world, start, goal, goal_radius=goal_radius)[-1]
    assert clearance(world.prisms[4:], end[None]) == pytest.approx(RADIUS, abs=1e-6)


def test_inside_the_goals_circle_there_is_no_way_to_go():
    assert shortest_path_length(make_world(), (0, 0), (0.3, 0.3)) == 0.0
    assert shortest_path(make_world(), (0, 0), (0.3, 0.3)).tolist() == [[0.0, 0.0]]


def test_there_is_no_path_through_a_closed_wall_or_from_inside_an_obstacle():
    world = make_world(box((0, 0), (0.1, 7.0)), box((2, 2), (0.5, 0.5)))
    for start in ((-2, 0), (2, 2)):
        assert shortest_path(world, start, (2, 0)) is None
        assert shortest_path_length(world, start, (2, 0)) == math.inf


def test_a_goal_behind_a_thin_wall_is_reached_through_it():
    # The distance to the goal ends an episode, whatever stands between.
    world = make_world(box((0, 0), (0.02, 7.0)))
    assert shortest_path_length(world, (-2, 0), (0.2, 0)) == pytest.approx(1.7)


def test_only_obstacles_as_high_as_the_robot_are_in_its_way():
    table = box((0, 0), (1, 7), base=0.5, height=0.1)
    beam = box((0, 0), (1, 7), base=0.41, height=0.1)
    assert shortest_path_length(make_world(table), (-2, 0), (2, 0)) == pytest.approx(3.5)
    assert shortest_path_length(make_world(beam), (-2, 0), (2, 0)) == math.inf
    assert shortest_path_length(make_world(beam), (-2, 0), (2, 0), robot_height=0.41) == pytest.approx(3.5)


def test_walls_keep_the_robot_in_and_an_open_floor_lets_it_out_by_a_margin():
    barrier = box((0, 0), (0.2, 7.0))
    assert shortest_path_length(make_world(barrier), (-2, 0), (2, 0)) == math.inf
    length = shortest_path_length(make_world(barrier, walls="none"), (-2, 0), (2, 0))
    to_corner = math.hypot(1.9, 3.5)
    turn = math.atan2(3.5, 1.9) + math.asin(RADIUS / to_corner)
    around = 2.0 * (math.sqrt(to_corner**2 - RADIUS**2) + RADIUS * turn) + 0.2
    assert length == pytest.approx(around - 0.5)
    assert shortest_path(make_world(barrier, walls="none"), (-2, 0), (2, 0))[:, 1].max() == pytest.approx(
        3.5 + RADIUS, abs=0.01
    )
    far = [box((0, y), (0.2, 0.5)) for y in np.linspace(-3.5, 3.5, 15)]
    wide = make_world(*far, walls="none", size=(7, 7))
    assert shortest_path_length(wide, (-2, 0), (2, 0)) < math.inf
    too_wide = OPEN_FLOOR_MARGIN + RADIUS + 0.01
    assert shortest_path_length(wide, (-2, 0), (2, 0), robot_radius=too_wide) == math.inf


@pytest.mark.parametrize(("gap", "passes"), [(2 * RADIUS + 1e-6, True), (2 * RADIUS - 1e-5, False)])
def test_a_gap_is_passed_when_it_is_as_wide_as_the_robot(gap, passes):
    half = 3.5 - gap / 2
    world = make_world(box((0, gap / 2 + half / 2), (0.5, half)), box((0, -gap / 2 - half / 2), (0.5, half)))
    assert math.isfinite(shortest_path_length(world, (-2, 0), (2, 0))) == passes
    assert connected(world, [[-2, 0]], [[2, 0]]).tolist() == [passes]


def test_boxes_side_by_side_are_one_obstacle_without_a_seam():
    flush = make_world(*(box((x, 0.0), (0.5, 0.5)) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)))
    whole = make_world(box((0, 0), (2.5, 0.5)))
    for start, goal in (((-2, 0), (2, 0)), ((0, -1), (0, 1)), ((-1, -1), (0.5, 0.9))):
        assert shortest_path_length(flush, start, goal) == pytest.approx(shortest_path_length(whole, start, goal))


def test_a_concave_obstacle_is_as_good_as_its_pieces():
    hook = [[-1, -1], [1, -1], [1, 1], [0.6, 1], [0.6, -0.6], [-1, -0.6]]
    world = make_world({"polygon": {"points": hook, "height": 1.0}})
    pieces = make_world(box((0, -0.8), (2.0, 0.4)), box((0.8, 0.2), (0.4, 1.6)))
    for start, goal in (((0, 0.2), (2, 0.2)), ((0.2, -0.2), (0, -2))):
        length = shortest_path_length(pieces, start, goal)
        assert shortest_path_length(world, start, goal) == pytest.approx(length)
        assert length > math.dist(start, goal) - 0.5 + 0.1


def test_beyond_the_exact_size_of_world_paths_stay_within_one_percent(monkeypatch):
    generator = np.random.default_rng(5)
    places = generator.uniform(-6.9, 6.9, (120, 2))
    world = make_world(*(cylinder(tuple(place), 0.15) for place in places), size=(14, 14))
    ends = free_points(world, 24)
    exact = [shortest_path_length(world, a, b) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    monkeypatch.setattr(planner, "EXACT_UP_TO", 20)
    again = make_world(*(cylinder(tuple(place), 0.15) for place in places), size=(14, 14))
    found = [shortest_path_length(again, a, b) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    assert np.isfinite(exact).all()
    assert found == pytest.approx(exact, rel=0.01)


def test_in_a_large_world_far_clusters_are_joined_and_closed_rooms_stay_closed(monkeypatch):
    cluster = [cylinder((x + dx, dy), 0.1) for x in (-28.0, 28.0) for dx in (0, 0.5) for dy in (-0.5, 0, 0.5)]
    ring = [box((0, s), (2.0, 0.1)) for s in (-0.95, 0.95)] + [box((s, 0), (0.1, 2.0)) for s in (-0.95, 0.95)]
    start, goal = (-29.5, 0.1), (29.5, 0.2)
    exact = shortest_path_length(make_world(*cluster, *ring, size=(60, 60)), start, goal)
    monkeypatch.setattr(planner, "EXACT_UP_TO", 5)
    monkeypatch.setattr(planner, "SIGHT_LINES", 0.01)
    world = make_world(*cluster, *ring, size=(60, 60))
    assert free_space(world, RADIUS, 0.42)._first_reach < 20.0
    assert shortest_path_length(world, start, goal) == pytest.approx(exact, rel=0.01)
    assert shortest_path_length(world, (0, 0), (10, 0)) == math.inf
    assert shortest_path_length(world, (0, 0), (1.1, 0)) == pytest.approx(0.6)


def test_short_tangents_follow_a_long_row_of_boxes_from_touch_to_touch():
    # Where one tangent ends and the next begins at one point of contact, rounding must not tell them apart.
    world = make_world(*(box((0.3 * i - 5.85, 0.1), (0.3, 0.3)) for i in range(40)), size=(14, 4))
    space = free_space(world, RADIUS, 0.42)
    start, goal = complex(-6.5, 0.3), complex(6.5, 0.3)
    short = TangentGraph(space.obstacles, RADIUS, space.half_extents, reach=1.0)
    length, _ = short.shortest_path(start, goal, 0.0)
    whole = make_world(box((0, 0.1), (12.0, 0.3)), size=(14, 4))
    assert length == pytest.approx(shortest_path_length(whole, (-6.5, 0.3), (6.5, 0.3), goal_radius=0.0))


# Connections


@pytest.mark.parametrize("seed", range(6))
def test_places_are_connected_when_there_is_a_path(seed):
    world = random_world(50 + seed, 14)
    places = free_points(world, 16, seed)
    starts, goals = places[::2], places[1::2]
    lengths = [shortest_path_length(world, a, b, goal_radius=0.0) for a, b in zip(starts, goals, strict=True)]
    assert connected(world, starts, goals).tolist() == np.isfinite(lengths).tolist()


def test_where_the_robot_does_not_fit_nothing_is_connected():
    world = make_world(box((0, 0), (1, 1)))
    assert connected(world, [[0, 0], [3.4, 0], [9, 9]], [[0, 0], [2, 0], [9, 9]]).tolist() == [False] * 3


# Distance fields


@pytest.mark.parametrize("seed", range(4))
def test_a_distance_field_agrees_with_shortest_paths(seed):
    world = random_world(20 + seed, 6)
    goal, *places = free_points(world, 40, seed)
    expected = np.array([shortest_path_length(world, place, goal) for place in places])
    found = DistanceField(world, goal, resolution=0.03)(np.array(places))
    sure = np.isfinite(expected) & np.isfinite(found)
    assert found[sure] == pytest.approx(expected[sure], rel=0.02, abs=0.03)
    assert (np.isfinite(expected) == np.isfinite(found)).mean() > 0.9  # a grid misses what fits by millimetres only


def test_a_distance_field_is_exact_in_sight_of_the_goal():
    field = DistanceField(make_world(), (1.0, 1.0))
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (100, 2))
    straight = np.maximum(np.linalg.norm(points - 1.0, axis=1) - 0.5, 0.0)
    assert field(points) == pytest.approx(straight, abs=5e-3)


def test_a_distance_field_is_infinite_where_the_robot_does_not_fit_or_get_through():
    world = make_world(box((0, 0), (0.1, 7.0)), box((2, 2), (0.5, 0.5)))
    field = DistanceField(world, (2, 0))
    blocked = field([[-2, 0], [2, 2], [2.3, 2.0], [3.4, 0], [9, 9]])
    assert np.isposinf(blocked).all()
    assert np.isfinite(field([[2.5, 1.0], [2.0, 0.0]])).all()


def test_a_distance_field_never_falls_below_the_straight_line():
    world = random_world(1, 8)
    goal, *places = free_points(world, 60)
    straight = np.linalg.norm(np.array(places) - goal, axis=1) - 0.5
    assert (DistanceField(world, goal)(places) >= straight - 1e-9).all()


def test_fields_of_one_world_share_their_grid():
    world = make_world(box((0, 0), (1, 1)))
    assert DistanceField(world, (2, 0))._grid is DistanceField(world, (-2, 0))._grid
    assert free_space(world, 0.2, 0.4) is free_space(world, 0.2, 0.4)
    assert free_space(world, 0.2, 0.4) is not free_space(world, 0.3, 0.4)


# What is asked for


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda w: clearance(w.prisms, [0.0, 1.0]), r"points must be finite numbers of shape \(K, 2\)"),
        (lambda w: clearance(w.prisms, [[0.0, math.nan]]), "points must be finite"),
        (lambda w: shortest_path(w, (0, 0, 0), (1, 1)), "start must be two finite numbers"),
        (lambda w: shortest_path_length(w, (0, 0), (math.inf, 1)), "goal must be two finite numbers"),
        (lambda w: shortest_path(w, (0, 0), (1, 1), robot_radius=0.0), "robot_radius must be a positive finite"),
        (lambda w: shortest_path(w, (0, 0), (1, 1), goal_radius=-1.0), "goal_radius must be a finite number"),
        (lambda w: DistanceField(w, (0, 0), resolution=-0.1), "resolution must be a positive finite"),
        (lambda w: DistanceField(w, (0, 0), resolution=1e-4), "resolution 0.0001 m is too fine"),
        (lambda w: connected(w, [[0, 0]], [[0, 0], [1, 1]]), "as many as each other"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(make_world())


def test_a_hundred_paths_in_a_room_take_seconds_not_minutes():
    world = random_world(2, 24, half=3.5)
    places = free_points(world, 25)
    begin = time.process_time()
    for start in places[:5]:
        for goal in places[5:]:
            shortest_path_length(world, start, goal)
    assert time.process_time() - begin < 10.0
