"""The difficulty of a world: what raises it, and that it tells where the reactive baseline failed."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from navsim import World, difficulty, generate_world, load_world
from navsim.difficulty import COEFFICIENTS, LONGEST_DETOUR, Measures, measure, predicted
from navsim.planner import shortest_path_length

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "difficulty.json"
EMPTY = {"format": 1, "size": [6, 6], "starts": [[-2, 0]], "goals": [[2, 0]]}


def wall(length: float) -> dict:
    return {"box": {"at": [0, 0], "size": [0.2, length], "height": 1}}


def test_an_empty_room_has_no_detours():
    assert measure(World.from_dict(EMPTY)).detour == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("length", [1.0, 2.0, 3.0])
def test_detours_are_those_of_the_exact_planner(length):
    world = World.from_dict(EMPTY | {"obstacles": [wall(length)]})
    exact = shortest_path_length(world, (-2, 0), (2, 0), robot_radius=0.4, goal_radius=0.0) / 4.0
    # Ways over the grid turn in eighths of a circle: up to 8% longer, as is what they are compared with.
    assert math.exp(measure(world).detour) == pytest.approx(exact, rel=0.09)


def test_a_way_too_narrow_for_the_depth_rule_counts_as_the_longest_detour():
    parts = [{"box": {"at": [0, side * 1.8], "size": [0.2, 2.4 + 0.4], "height": 1}} for side in (-1, 1)]
    narrow = World.from_dict(EMPTY | {"obstacles": parts})  # 0.8 m between them, none beside the walls
    assert measure(narrow).detour == pytest.approx(math.log(LONGEST_DETOUR))


def test_what_the_robot_passes_under_is_not_in_the_way():
    table = {"box": {"at": [0, 0], "size": [1.0, 2.0], "base": 0.7, "height": 0.03}}
    assert measure(World.from_dict(EMPTY | {"obstacles": [table]})) == measure(World.from_dict(EMPTY))


def test_narrowness_is_the_mean_over_the_free_floor():
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (200_000, 2))
    clear = 3.0 - np.abs(points).max(axis=1)
    free = clear[clear > 0.1755]
    expected = np.maximum(0.0, 1.0 - free).mean()
    assert measure(World.from_dict(EMPTY)).narrow == pytest.approx(expected, abs=0.015)


def test_open_starts_and_goals_are_drawn_the_same_each_time():
    world = load_world("complex_eval").model_copy(update={"starts": "random", "goals": "random"})
    assert difficulty(world) == difficulty(world.model_copy())
    assert 0.03 < difficulty(world) < 0.6


def test_denser_rooms_and_mazes_are_harder():
    def mean(kind, density):
        return np.mean([difficulty(generate_world(kind, density=density, seed=8, index=i)) for i in range(4)])

    assert mean("blocks", 0.04) < mean("blocks", 0.25)
    assert mean("blocks", 0.1) < mean("corridors", 0.1)


def test_it_rises_with_each_measure():
    lower, higher = Measures(0.1, 0.3), Measures(0.2, 0.4)
    assert predicted(lower) < predicted(lower._replace(detour=higher.detour)) < predicted(higher)


def test_the_published_drives_bear_out_the_coefficients():
    values = json.loads(RESULTS.read_text())
    assert values["coefficients"] == list(COEFFICIENTS)
    assert pytest.approx(values["fitted_anew"], abs=0.01) == COEFFICIENTS
    judged = [room for room in values["rooms"] if room["index"] % 2]
    told = [predicted(Measures(*room["measures"])) for room in judged]
    rates = [room["failures"] / room["paths"] for room in judged]
    assert spearmanr(told, rates).statistic == pytest.approx(values["judged"]["spearman"], abs=1e-6)
    assert values["judged"]["low"] > 0.7
    # The rooms that were driven in are those that the generator makes.
    room = judged[17]
    world = generate_world(room["kind"], density=room["density"], seed=room["seed"], index=room["index"])
    assert measure(world) == pytest.approx(room["measures"], abs=1e-6)
