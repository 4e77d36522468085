"""The geometric rules of a world: clearance, connections, room for what is drawn at random."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.errors import WorldError
from navsim.planner import clearance, shortest_path_length
from navsim.rules import GOAL_CLEARANCE, START_CLEARANCE
from navsim.world import World

WIDTH = 0.351  # of the robot, metres


def problems_of(*obstacles: dict, **settings) -> list[str]:
    """What is wrong with a room of 4 x 4 m; an empty list for a good one."""
    try:
        World.from_dict({"format": 1, "size": [4.0, 4.0], "obstacles": list(obstacles), **settings})
    except WorldError as error:
        return list(error.problems)
    return []


def box(at: tuple[float, float], size: tuple[float, float], **settings) -> dict:
    return {"box": {"at": list(at), "size": list(size), "height": 1.0, **settings}}


def ring(half: float, gap: float = 0.0, thickness: float = 0.1) -> list[dict]:
    """Walls around the origin, with a gap in the eastern one."""
    length = 2.0 * half + thickness
    sides = [box((0, y), (length, thickness)) for y in (-half, half)] + [box((-half, 0), (thickness, length))]
    if not gap:
        return [*sides, box((half, 0), (thickness, length))]
    part = (length - gap) / 2.0
    return [*sides, *(box((half, s * (gap + part) / 2.0), (thickness, part)) for s in (-1, 1))]


def test_an_empty_room_keeps_the_rules():
    assert problems_of() == []
    assert problems_of(starts=[[0, 0]], goals=[[1, 1], [-1, 1]]) == []


@pytest.mark.parametrize(("away", "needed"), [("starts", START_CLEARANCE), ("goals", GOAL_CLEARANCE)])
@pytest.mark.parametrize("obstacle", [box((0, 0), (1, 1)), {"cylinder": {"at": [0, 0], "radius": 0.5, "height": 0.2}}])
def test_starts_and_goals_need_their_clearance_from_obstacles(obstacle, away, needed):
    other = {"starts": "goals", "goals": "starts"}[away]
    for distance, is_enough in ((needed + 1e-4, True), (needed - 1e-3, False)):
        problems = problems_of(obstacle, **{away: [[0.5 + distance, 0.0]], other: [[-1.5, -1.5]]})
        assert (problems == []) == is_enough
        if not is_enough:
            (problem,) = problems
            kind = next(iter(obstacle))
            expected = f"is {distance:.3f} m from '{kind} 1'; move it until {needed:.4g} m around it are free"
            assert problem == f"{away}[0]: {expected}"


@pytest.mark.parametrize(
    ("start", "wall"), [((1.9, 0), "east"), ((0.3, 1.9), "north"), ((-1.9, 0), "west"), ((0, -1.9), "south")]
)
def test_starts_need_their_clearance_from_walls_if_there_are_any(start, wall):
    (problem,) = problems_of(starts=[list(start)], goals=[[1, 1]])
    assert problem.startswith(f"starts[0]: is 0.100 m from 'wall {wall}'; move it")
    assert problems_of(starts=[list(start)], goals=[[1, 1]], walls="none") == []


def test_what_the_robot_passes_under_or_over_needs_no_clearance():
    table = box((0, 0), (1, 1), base=0.42, height=0.03)
    assert problems_of(table, starts=[[0, 0]], goals=[[1, 1]]) == []
    beam = box((0, 0), (1, 1), name="beam", base=0.41, height=0.03)
    assert problems_of(beam, starts=[[0, 0]], goals=[[1, 1]]) == [
        "starts[0]: is inside 'beam'; move it until 0.2255 m around it are free"
    ]


def test_points_outside_the_room_are_refused_whatever_they_belong_to():
    problems = problems_of(
        box((2.1, 0), (0.1, 0.1)),
        {"cylinder": {"at": [0, -3], "radius": 0.1, "height": 1}},
        {"polygon": {"points": [[0, 0], [1, 0], [1, 2.5]], "height": 1}},
        box((2.0, 2.0), (0.2, 0.2)),
        starts=[[-5, 0], [-1, -1]],
        goals=[[-1, 1], [0, 9]],
    )
    where = [problem.split(": ")[0] for problem in problems]
    polygon = "obstacles[2].polygon.points[2]"
    assert where == ["obstacles[0].box.at", "obstacles[1].cylinder.at", polygon, "starts[0]", "goals[1]"]
    assert problems[0].endswith(
        "[2.1, 0] is outside the room, x from -2 to 2 and y from -2 to 2; move it or enlarge 'size'"
    )


@pytest.mark.parametrize(("gap", "passes"), [(WIDTH - 1e-4, False), (WIDTH + 1e-4, True)])
def test_every_start_must_be_connected_with_every_goal(gap, passes):
    problems = problems_of(*ring(1.0, gap), starts=[[0, 0]], goals=[[0.5, 0.5], [1.5, 0]])
    expected = f"goals[1]: is cut off from any start; leave a gap of at least {WIDTH} m, the robot's width, between"
    assert [problem.startswith(expected) for problem in problems] == ([] if passes else [True])


def test_a_goal_that_some_starts_do_not_reach_names_them():
    (problem,) = problems_of(*ring(1.0), starts=[[0, 0], [1.5, 0], [-0.5, 0.2]], goals=[[1.5, 1.5]])
    assert problem.startswith("goals[0]: is cut off from starts[0] and starts[2]; leave a gap")


def test_a_row_of_posts_cuts_the_room_where_the_robot_does_not_fit_between():
    for spacing, passes in ((0.4, False), (0.8, True)):
        posts = [{"cylinder": {"at": [0, y], "radius": 0.05, "height": 1}} for y in np.arange(-1.95, 2.0, spacing)]
        problems = problems_of(*posts, starts=[[-1, 0]], goals=[[1, 0]])
        assert (problems == []) == passes


def test_random_starts_need_room():
    assert problems_of(box((0, 0), (3.9, 3.9))) == [
        "starts: there is no room for a random start; clear obstacles away, enlarge 'size', or list starts and goals"
    ]
    assert problems_of(box((0.4, 0), (3.2, 4.0))) == []
    assert problems_of(size=[0.3, 5.0]) != []


def test_a_random_start_is_found_in_the_last_free_corner():
    # A free lane of 0.5 m: there is a centimetre or two for the robot's centre with the clearance of a start.
    assert problems_of(box((-0.25, 0), (3.5, 4.0))) == []


def test_a_random_start_is_clear_of_walls_too():
    assert problems_of(box((-0.2, 0), (3.6, 4.0))) != []  # a lane of 0.4 m
    assert problems_of(size=[7.0, 0.42]) != []
    assert problems_of(size=[7.0, 0.42], walls="none") == []


@pytest.mark.parametrize(("listed", "wanted"), [("goals", "start"), ("starts", "goal")])
def test_listed_places_need_something_at_random_to_go_with(listed, wanted):
    assert problems_of(*ring(1.0), **{listed: [[0, 0], [1.5, 0]]}) == []
    (problem,) = problems_of(*ring(0.35), **{listed: [[1.5, 0], [0, 0]]})
    assert problem.startswith(f"{listed}[1]: no place for a random {wanted} is connected with it; leave a gap")


def test_rules_are_checked_beside_other_mistakes_and_keep_their_place():
    problems = problems_of(
        box((0, 0), (1, -1)),
        box((0, 1), (0.5, 0.5)),
        starts=[[0, "x"], [0, 1.4]],
        goals=[[1.5, 1.5], [0, 1]],
    )
    assert problems == [
        "obstacles[0].box.size[1]: must be greater than 0, not -1",
        "starts[0][1]: must be a number, not 'x'",
        "starts[1]: is 0.150 m from 'box 2'; move it until 0.2255 m around it are free",
        "goals[1]: is inside 'box 2'; move it until 0.1755 m around it are free",
    ]


@pytest.mark.parametrize("seed", range(30))
def test_a_world_is_accepted_exactly_when_its_pairs_have_room_and_a_path(seed):
    generator = np.random.default_rng(seed)
    places, yaws = generator.uniform(-2.0, 2.0, (7, 2)), generator.uniform(0.0, 180.0, 7)
    walls = [box(tuple(at), (0.1, 2.5), yaw_deg=yaw) for at, yaw in zip(places, yaws, strict=True)]
    starts, goals = generator.uniform(-1.7, 1.7, (2, 2, 2))
    world = World.from_dict({"format": 1, "size": [4, 4], "obstacles": walls})
    has_room = (clearance(world.prisms, starts, 0, 0.42) >= START_CLEARANCE).all()
    has_room &= (clearance(world.prisms, goals, 0, 0.42) >= GOAL_CLEARANCE).all()
    paths = [shortest_path_length(world, start, goal, goal_radius=0.0) for start in starts for goal in goals]
    accepted = problems_of(*walls, starts=starts.tolist(), goals=goals.tolist()) == []
    assert accepted == bool(has_room and np.isfinite(paths).all())


@pytest.mark.parametrize("size", [[0.351, 2.0], [0.351, 0.351], [2.0, 0.3511]])
def test_a_room_just_as_wide_as_the_robot_has_no_room_for_a_start(size):
    with pytest.raises(WorldError, match="starts: there is no room for a random start"):
        World.from_dict({"format": 1, "size": size})
