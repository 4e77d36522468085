"""The page of results tells what is in the files, and what is not there yet."""

from __future__ import annotations

import json

import pytest

import rl.results
from navsim.world import World
from navsim.worldfile import save_world
from rl.results import COMPLEX, SHORT_WAYS, UNSEEN, drive_baselines, results_page, write_results

BASELINES = {
    "straight": {COMPLEX: {"success_rate": 0.28, "spl": 0.25}, UNSEEN: {"success_rate": 0.4, "spl": 0.31}},
    "oracle": {COMPLEX: {"success_rate": 1.0, "spl": 0.94}, UNSEEN: {"success_rate": 0.5, "spl": 0.45}},
}


def run(row: str, seed: int, complex_rate: float, unseen_rate: float) -> dict:
    return {
        "row": row,
        "seed": seed,
        "steps": 100_000,
        "final": {
            COMPLEX: {"success_rate": complex_rate, "spl": 0.9 * complex_rate},
            UNSEEN: {"success_rate": unseen_rate, "spl": 0.8 * unseen_rate},
        },
        "curve": {"processor_seconds": [300.0, 600.0, 900.0], "success_rate": [0.5, 0.5 + 0.1 * (4 - seed), 0.9]},
    }


def rows(page: str, beginning: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in page.splitlines()
        if line.startswith(f"| {beginning}")
    ]


def test_means_seeds_and_times_are_those_of_the_runs():
    page = results_page([run("base", 1, 0.96, 0.901), run("base", 0, 0.90, 0.883)], BASELINES, "table 6.1")
    of_complex, of_unseen, beside_baselines = rows(page, "D3QN-I, depth and heading only")
    assert of_complex[2:] == ["88", "90", "97", "**93.0**", "90, 96", "3.0", "0.90"]
    assert of_unseen[2:] == ["–", "85", "95", "**89.2**", "88.3, 90.1", "0.9", "0.80"]
    assert beside_baselines[1:] == ["93.0 (2 seeds)", "0.84", "89.2 (2 seeds)", "0.71"]
    assert "D3QN-I 10, 15;" in page  # seed 0 has 90% after 600 s, seed 1 80%
    assert rows(page, "straight") == [["straight", "28.0", "0.25", "40.0", "0.31"]]
    assert "table 6.1" in page
    assert "has 0.94 in `complex_eval` and 0.90 in the unseen rooms" in page


def test_the_networks_of_symmetric_policies_are_told_alone_where_all_are_known():
    runs = [run("base", seed, 0.9, 0.95) for seed in (0, 1)] + [run("S", seed, 0.8, 0.9) for seed in (0, 1)]
    assert "weights alone" not in results_page(runs, BASELINES, "")
    for one, alone in zip(runs[:3], (0.86, 0.88, 0.5), strict=True):
        one["alone"] = run("", 0, alone, alone + 0.05)["final"]
    page = " ".join(results_page(runs, BASELINES, "").split())
    assert "alone reach, in percent: D3QN-I 87.0 in `complex_eval` and 92.0 in the unseen rooms. " in page


def test_short_ways_are_told_of_symmetric_policies():
    (_, of_image), (_, of_scalar) = SHORT_WAYS
    runs = [run(row, seed, 0.5, 0.5) for row, seed in ((of_image, 0), (of_image, 1), (of_scalar, 0))]
    assert "a metre costs" not in results_page(runs, BASELINES, "")
    for one, rate in zip(runs, (0.96, 1.0, 0.9), strict=True):
        one["symmetric"] = run("", 0, rate, rate - 0.01)["final"]
    page = " ".join(results_page(runs, BASELINES, "").split())
    assert (
        "have: D3QN-I 0.900 of 98.0% in `complex_eval` and 0.800 of 97.0% in the unseen rooms "
        f"(row `{of_image}`, 2 seeds); D3QN-S 0.900 of 90.0% in `complex_eval` and 0.800 of 89.0% in the unseen rooms "
        f"(row `{of_scalar}`, 1 seed)."
    ) in page


def test_what_was_not_run_is_said():
    page = results_page([], BASELINES, "table 6.1")
    assert rows(page, "D3QN-S, depth and heading only")[0][5:] == ["not run yet", "", "", ""]
    assert rows(page, "D3QN-I, heading only") == [["D3QN-I, heading only", "not run yet", "", "not run yet", ""]]


def test_baselines_are_driven_once(tmp_path, monkeypatch):
    world = World.from_dict(
        {"format": 1, "size": [5, 5], "starts": [{"at": [-1.5, 0], "yaw_deg": 0}], "goals": [[1.5, 0], [1.5, 1]]}
    )
    save_world(world, tmp_path / "hall.yaml")
    hall = str(tmp_path / "hall.yaml")
    monkeypatch.setattr(rl.results, "PLACES", {COMPLEX: (hall, None), UNSEEN: (hall, 1)})
    monkeypatch.setattr(rl.results, "BASELINES", ("straight", "oracle"))
    found = drive_baselines(tmp_path / "baselines.json")
    assert found["oracle"][UNSEEN]["success_rate"] == found["straight"][UNSEEN]["success_rate"] == 1.0
    assert found["oracle"][COMPLEX]["paths"] == 2
    monkeypatch.setattr(rl.results, "evaluate", pytest.fail)
    assert drive_baselines(tmp_path / "baselines.json") == found
    (tmp_path / "ablations").mkdir()
    (tmp_path / "ablations" / "base-seed0.json").write_text(json.dumps(run("base", 0, 0.5, 0.5)), encoding="utf-8")
    write_results(tmp_path, tmp_path / "results.md")
    page = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert "**50.0**" in page
    assert "Not run yet: `python scripts/reproduce.py`" in page

    (tmp_path / "baselines.json").write_text('{"straight": {}}', encoding="utf-8")
    with pytest.raises(ValueError, match=r"baselines\.json does not hold what the baselines reach; move it away"):
        drive_baselines(tmp_path / "baselines.json")
    (tmp_path / "baselines.json").write_text(json.dumps(found), encoding="utf-8")

    (tmp_path / "reproduce").mkdir()
    (tmp_path / "reproduce" / "tables.md").write_text("### Table 6.1", encoding="utf-8")
    (tmp_path / "reproduce" / "figure-6-04-max_q-complex.png").touch()
    write_results(tmp_path, tmp_path / "results.md")
    page = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert "Not run yet" not in page
    assert "### Table 6.1" in page
    assert (
        "Figure 6.4: greatest Q-values while training in the complex room: means over states of a random drive" in page
    )
