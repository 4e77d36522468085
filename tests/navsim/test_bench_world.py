"""The benchmark of large worlds: that it measures what it says, and tells what it measured."""

from __future__ import annotations

from rich.console import Console

from navsim import bench_world
from navsim.bench_world import run


def test_what_was_measured_is_told(monkeypatch):
    monkeypatch.setattr(bench_world, "_ROUNDS", 1)
    console = Console(record=True, width=120)
    times = run(console, num_obstacles=40)
    text = console.export_text()
    assert "A world of 40 obstacles" in text
    assert f"{1e3 * times.reset:.1f}" in text
    assert f"{1e3 * times.listed_reset:.1f}" in text
    assert 0.0 < times.reset < times.first_reset
