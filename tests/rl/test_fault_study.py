"""Faults that a policy does not know of: each is driven once a policy, and page, JSON and picture tell the same."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

import rl.fault_study
from navsim.randomization import Randomization
from navsim.sensor import KINECT
from navsim.world import World
from navsim.worldfile import save_world
from rl.fault_study import FAULTS, Outcome, Size, page_of, plot, run
from rl.metrics import wilson_interval

QUIET = Console(quiet=True)


def few_faults(monkeypatch):
    faults = {
        "wheels": (Size("0"), Size("40", Randomization(wheel_speed_error=(0.4, 0.4)))),
        "sensor": (Size("ideal"), Size("Kinect", sensor=KINECT)),
    }
    monkeypatch.setattr(rl.fault_study, "FAULTS", faults)


def test_page_json_and_picture_tell_what_was_driven(tmp_path, monkeypatch):
    few_faults(monkeypatch)
    driven = []
    evaluate = rl.fault_study.evaluate_as_trained

    def counted(policy, *arguments, **settings):
        driven.append((settings["sensor"], settings["randomization"]))
        return evaluate(policy, *arguments, **settings)

    monkeypatch.setattr(rl.fault_study, "evaluate_as_trained", counted)
    places = {"results": tmp_path / "f.json", "page": tmp_path / "f.md", "picture": tmp_path / "images" / "f.png"}
    outcomes = run(QUIET, policies=["straight", "reactive"], world="simple_eval", num_paths=6, **places)
    assert len(outcomes) == 8
    assert len(driven) == 6  # the harmless sizes of all faults are one drive
    told = json.loads(places["results"].read_text())
    assert [Outcome(**outcome) for outcome in told["outcomes"]] == outcomes
    assert told["command"] == "python scripts/faults.py --policies straight reactive --world simple_eval --num-paths 6"
    text = places["page"].read_text()
    assert text.endswith(f"Made by `{told['command']}`.\n")
    own = [outcome for outcome in outcomes if (outcome.fault, outcome.size) == ("sensor", "Kinect")]
    cells = []
    for outcome in own:
        low, high = wilson_interval(outcome.reached, 6)
        cells.append(f"{100 * outcome.reached / 6:.1f} ({100 * low:.0f}–{100 * high:.0f})")
    assert f"| sensor | Kinect | {cells[0]} | {cells[1]} |" in text
    assert "![goals reached against the size of each fault](images/f.png)" in text
    assert places["picture"].stat().st_size > 5_000


def test_the_picture_has_a_panel_for_each_fault_and_a_line_for_each_policy():
    outcomes = [
        Outcome(policy, fault, size.label, 100, 90 - place, 0.8)
        for policy in ("a", "b")
        for fault, sizes in FAULTS.items()
        for place, size in enumerate(sizes)
    ]
    panels = plot(outcomes).axes
    assert [panel.get_title() for panel in panels] == list(FAULTS)
    for panel, sizes in zip(panels, FAULTS.values(), strict=True):
        lines = [container.lines[0].get_ydata() for container in panel.containers]
        expected = 90.0 - np.arange(len(sizes))
        np.testing.assert_allclose(lines, [expected, expected])
    assert "| a | b |" in page_of(outcomes, "w", "c", "p.png")


def test_every_fault_has_one_size_that_is_none():
    for sizes in FAULTS.values():
        assert sum(size == replace(size, randomization=Randomization(), sensor=None) for size in sizes) >= 1
        assert len({size.label for size in sizes}) == len(sizes)


def test_mistakes_are_told_before_anything_is_driven(tmp_path):
    save_world(World.from_dict({"format": 1, "size": [5, 5]}), tmp_path / "w.yaml")
    places = {"results": tmp_path / "f.json", "page": tmp_path / "f.md", "picture": tmp_path / "f.png"}
    with pytest.raises(ValueError, match="name one policy or several different ones; got straight, straight"):
        run(QUIET, policies=["straight", "straight"], **places)
    with pytest.raises(ValueError, match="nobody"):
        run(QUIET, policies=["nobody"], **places)
    with pytest.raises(ValueError, match="xyz"):
        run(QUIET, policies=["straight"], **{**places, "picture": tmp_path / "f.xyz"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["w.yaml"]
