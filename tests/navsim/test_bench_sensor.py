"""The benchmark of pitch and sensor: it measures everything it names, and prints it."""

from __future__ import annotations

from rich.console import Console

from navsim.bench_sensor import SENSORS, benchmark_pitch, benchmark_sensor, run


def test_everything_is_measured_beside_the_first():
    for costs in (benchmark_pitch(8, 8, 3, repeats=2), benchmark_sensor(8, 8, 3, repeats=2)):
        assert costs[0].times == 1.0
        assert all(cost.milliseconds > 0.0 for cost in costs)
        assert all(abs(cost.times * costs[0].milliseconds - cost.milliseconds) < 1e-9 for cost in costs)


def test_it_prints_what_it_measures():
    console = Console(record=True, width=120)
    run(sizes=[(8, 8), (12, 8)], num_robots=2, repeats=1, console=console)
    text = console.export_text()
    for word in (*SENSORS, "level", "pitched 10 deg down", "8x8, ms", "12x8, ms", "2 robots in complex_train"):
        assert word in text
