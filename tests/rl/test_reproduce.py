"""The thesis's experiment as a matrix: what is run, what is skipped, and what is made of the results."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rich.console import Console

import rl.reproduce
from navsim.raycast import render_depth
from navsim.worldfile import load_world
from rl.config import PRESETS
from rl.metrics import Evaluation, PathResult
from rl.reproduce import HEADINGS, Cell, cells, reproduce, tables, write_up

QUIET = Console(quiet=True)


def evaluation(successes: int, paths: int = 10) -> Evaluation:
    trajectory = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    results = [
        PathResult(
            start_index=0,
            goal_index=index,
            goal=(1.4, 0.0),
            outcome="success" if index < successes else "collision",
            reward=1.0 if index < successes else -1.0,
            shortest_path_length=1.0,
            trajectory=trajectory,
            actions=np.array([index % 7]),
        )
        for index in range(paths)
    ]
    return Evaluation(policy="D3QN", world="complex_eval", seed=0, paths=tuple(results))


def result(cell: Cell, simple: int, complex_: int) -> dict:
    steps = [4000.0, 8000.0]
    return {
        **cell._asdict(),
        "steps": 8000,
        "settings": {"autocast": "float32"},
        "machine": "a machine",
        "training": {"step": steps, "seconds": [1.0, 2.0], "reward": [None, 0.5], "max_q": [0.1, 0.2]},
        "evaluations": {key: [0.1, 0.5] for key in ("success_rate", "spl", "reward")}
        | {"step": steps, "processor_seconds": [1800.0, 3600.0]},
        "final": {"simple": evaluation(simple).to_dict(), "complex": evaluation(complex_).to_dict()},
        "q_over_headings": {place: np.zeros((len(HEADINGS), 7)).tolist() for place in rl.reproduce.Q_PLACES},
    }


def test_the_matrix_is_the_thesis_s_with_small_images_and_first_seeds_first():
    matrix = cells()
    assert len(matrix) == len(set(matrix)) == 2 * 2 * 2 * 3
    assert {(cell.width, cell.height) for cell in matrix[:12]} == {(80, 64)}
    assert {cell.seed for cell in matrix[:4]} == {0}


def test_a_cell_is_the_preset_thesis_in_its_room(tmp_path):
    config = Cell("S", 160, 128, "simple", 2).config(tmp_path)
    assert (config.model, config.camera.width, config.camera.height, config.seed) == ("S", 160, 128, 2)
    assert (config.world, config.eval_world) == (("simple_train",), "simple_eval")
    changed = {"model", "camera", "seed", "world", "eval_world", "num_threads", "checkpoint_interval", "report", "out"}
    thesis, mine = PRESETS["thesis"].to_dict(), config.to_dict()
    assert {key for key in mine if mine[key] != thesis[key]} <= changed


def test_the_first_place_of_the_q_values_has_a_free_view_and_the_second_a_wall_ahead():
    camera = PRESETS["thesis"].camera
    for room in ("simple_eval", "complex_eval"):
        free, wall = (
            camera.from_planar(render_depth(load_world(room), np.array([pose]), camera))[0, :24, 36:44]
            for pose in rl.reproduce.Q_PLACES.values()
        )
        assert free.min() > 4.5
        assert wall.max() < 1.2


def test_a_table_pools_the_seeds_of_what_was_trained_in_a_room():
    text = tables([result(Cell("I", 80, 64, "complex", seed), 9, successes) for seed, successes in ((0, 8), (1, 10))])
    rows = [[field.strip() for field in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| c")]
    (to_simple, to_complex) = rows
    assert to_simple[:4] == ["complex", "simple", "90.0", "90, 90"]
    assert to_complex[:4] == ["complex", "complex", "90.0", "80, 100"]
    assert to_complex[4] == "70–97"  # Wilson's interval of 18 of 20
    assert to_complex[5] == "88"
    assert to_simple[5] == ""
    assert to_complex[6:] == ["+0.80", "0.90"]
    assert text.count("Not run yet.") == 3
    assert "8,000 steps in float32, 1.0 hours of processor time; a machine." in text


def test_all_figures_are_drawn_from_the_cells(tmp_path):
    (tmp_path / "cells").mkdir()
    for model in ("I", "S"):
        for room in ("simple", "complex"):
            cell = Cell(model, 80, 64, room, 0)
            (tmp_path / "cells" / f"{cell.name}.json").write_text(json.dumps(result(cell, 9, 8)))
    write_up(tmp_path)
    numbers = sorted(int(path.name.split("-")[2]) for path in tmp_path.glob("figure-6-*.png"))
    assert numbers == list(range(1, 12))
    assert (tmp_path / "tables.md").read_text().startswith("### Table 6.1: D3QN-I, 80x64")


@pytest.mark.slow
def test_a_short_cell_is_trained_evaluated_and_written_up(tmp_path):
    matrix = cells(models=("S",), sizes=[(80, 64)], rooms=("complex",), seeds=(0,))
    reproduce(matrix, runs=tmp_path / "runs", results=tmp_path / "results", total_steps=1_200, console=QUIET)
    stored = json.loads((tmp_path / "results" / "cells" / f"{matrix[0].name}.json").read_text())
    assert (stored["model"], stored["room"], stored["steps"], stored["settings"]["seed"]) == ("S", "complex", 1_200, 0)
    assert len(stored["final"]["complex"]["paths"]) == 100
    assert stored["training"]["step"][-1] == 1_200
    assert "D3QN-S, 80x64\n\n1,200 steps in" in (tmp_path / "results" / "tables.md").read_text()
    assert np.array(stored["q_over_headings"]["free way"]).shape == (73, 7)
