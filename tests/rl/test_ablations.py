"""The table of ablations: each row is what its command says, and runs are trained once."""

from __future__ import annotations

import dataclasses
import io
import json
import shutil

import pytest
from rich.console import Console
from small_runs import HALL, tiny_config

import rl.ablations
import rl.series
from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.robot import Robot
from navsim.sensor import KINECT
from navsim.task import Task
from rl.ablations import ROWS, Row, arguments_of, curves, run
from rl.cli import main
from rl.config import PRESETS
from rl.evaluation import evaluate_as_trained

QUIET = Console(file=io.StringIO())


@pytest.mark.parametrize("name", ROWS)
def test_each_row_is_trained_by_the_command_that_the_page_gives(name, tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr("rl.train.train", lambda config, **_: trained.append(config))
    config = ROWS[name].config(name, seed=4, directory=tmp_path)
    assert main(["train", *arguments_of(config), "--out", str(config.out)]) == 0
    assert trained == [config]


def test_what_is_set_of_robot_camera_and_sensor_is_in_the_command(tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr("rl.train.train", lambda config, **_: trained.append(config))
    config = dataclasses.replace(
        PRESETS["fast"],
        camera=DepthCamera(width=40, pitch_deg=5.0, depth="range"),
        task=Task(pushing_is_collision=False, step_penalty=0.05),
        robot=Robot(radius=0.2, linear_acceleration=1.5),
        sensor=KINECT,
        randomization=Randomization(camera_left=(-0.01, 0.01), latency=(0, 2)),
        report=False,
        out=tmp_path / "run",
    )
    assert main(["train", *arguments_of(config), "--out", str(config.out)]) == 0
    assert trained == [config]


def test_rows_differ_from_the_base_in_what_they_say():
    for name, row in ROWS.items():
        base = Row("", {}, row.preset).config("base", 0, rl.ablations.Path("runs"))
        config = row.config(name, 0, rl.ablations.Path("runs"))
        changed = {field.name for field in dataclasses.fields(config)} - {"out"}
        changed = {key for key in changed if getattr(config, key) != getattr(base, key)}
        assert changed == set(row.changes)


def small_rows(monkeypatch, directory):
    """Rows of seconds, and few unseen paths in one small room."""
    changes = tiny_config(directory, total_steps=256, eval_interval=256, checkpoint_interval=256)
    settings = {
        field.name: getattr(changes, field.name)
        for field in dataclasses.fields(changes)
        if getattr(changes, field.name) != getattr(PRESETS["memoryless"], field.name) and field.name != "out"
    }
    monkeypatch.setattr(rl.ablations, "BASE", {**settings, "report": False})
    monkeypatch.setattr(rl.ablations, "ROWS", {"base": Row("base", {}), "S": Row("D3QN-S", {"model": "S"})})
    places = {rl.ablations.COMPLEX: (str(HALL), None), rl.ablations.UNSEEN: (str(HALL), 1)}
    monkeypatch.setattr(rl.ablations, "PLACES", places)
    monkeypatch.setattr(rl.ablations, "arguments_of", lambda config: ["--model", config.model])
    return {"runs": directory / "runs", "results": directory / "results", "page": directory / "page.md"}


@pytest.fixture
def small(monkeypatch, tmp_path):
    return small_rows(monkeypatch, tmp_path)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """What two seeds of row "base" have left."""
    directory = tmp_path_factory.mktemp("ablations")
    with pytest.MonkeyPatch.context() as patch:
        run(["base"], [0, 1], **small_rows(patch, directory), console=QUIET)
    return directory


@pytest.fixture
def begun(small, trained, tmp_path):
    """A table that has two seeds of row "base"."""
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    return small


def test_finished_runs_are_not_repeated_and_the_page_has_every_seed(begun, monkeypatch):
    first = {path.name: path.read_bytes() for path in begun["results"].glob("*.json")}
    assert sorted(first) == ["base-seed0.json", "base-seed1.json"]
    trained = []
    train = rl.series.train
    monkeypatch.setattr(rl.series, "train", lambda config, **kw: trained.append(config) or train(config, **kw))
    run(["S", "base"], [0], **begun, console=QUIET)
    assert [(config.model, config.seed) for config in trained] == [("S", 0)]
    assert all((begun["results"] / name).read_bytes() == content for name, content in first.items())

    page = begun["page"].read_text(encoding="utf-8")
    rates = [json.loads(first[f"base-seed{seed}.json"])["final"]["complex_eval"]["success_rate"] for seed in (0, 1)]
    table = [line for line in page.splitlines() if line.startswith("| base")]
    assert f"| {50 * sum(rates):.1f} | {100 * rates[0]:.0f}, {100 * rates[1]:.0f} |" in table[0]
    assert [line.split(" | ")[:2] for line in table[1:]] == [["| base", "2"]]
    assert page.index("| base") < page.index("| S |")
    assert "- S: `navsim train --model S`" in page
    assert (begun["results"] / "curves.png").stat().st_size > 10_000
    assert "](results/curves.png)" in page


def test_results_of_a_row_that_there_is_no_more_are_left_out(begun):
    results = json.loads((begun["results"] / "base-seed0.json").read_text(encoding="utf-8"))
    before = begun["page"].read_text(encoding="utf-8")
    (begun["results"] / "gone-seed0.json").write_text(json.dumps(results | {"row": "gone"}), encoding="utf-8")
    run(["base"], [0], **begun, console=QUIET)
    assert begun["page"].read_text(encoding="utf-8") == before


def test_a_file_of_something_else_is_named_before_anything_is_trained(begun, monkeypatch):
    monkeypatch.setattr(rl.series, "train", lambda *_, **__: pytest.fail("trained"))
    (begun["results"] / "half-seed0.json").write_text('{"steps": 512}', encoding="utf-8")
    with pytest.raises(ValueError, match=r"half-seed0\.json does not hold the results of a run; move it away"):
        run(["S"], [0], **begun, console=QUIET)


def test_minutes_of_different_machines_are_not_averaged_in_the_curves(begun):
    """Two runs at 10 minutes on one machine, one at 30 on another: the curve ends at 10."""
    ours = json.loads((begun["results"] / "base-seed0.json").read_text(encoding="utf-8"))
    runs = []
    for seed, (machine, minutes) in enumerate((("slow", 30), ("fast", 10), ("fast", 10))):
        seconds = [60.0 * minutes * step / ours["steps"] for step in ours["curve"]["step"]]
        curve = ours["curve"] | {"processor_seconds": seconds}
        runs.append(ours | {"seed": seed, "machine": machine, "curve": curve})
    by_steps, by_minutes = curves(runs).axes
    assert by_minutes.lines[0].get_xdata()[-1] == pytest.approx(10.0)
    assert by_steps.lines[0].get_xdata()[-1] == ours["steps"]


def test_the_page_tells_what_the_same_weights_do_symmetrically(begun):
    files = sorted(begun["results"].glob("*.json"))
    for file, alone, mean in zip(files, (0.8, 0.9), (0.9, 0.94), strict=True):
        results = json.loads(file.read_text(encoding="utf-8"))
        for kind, rate in (("alone", alone), ("symmetric", mean)):
            for place in results[kind].values():
                place["success_rate"] = rate
        file.write_text(json.dumps(results), encoding="utf-8")
    older = json.loads(files[0].read_text(encoding="utf-8")) | {"seed": 2}
    del older["symmetric"]
    (begun["results"] / "base-seed2.json").write_text(json.dumps(older), encoding="utf-8")
    run(["base"], [0], **begun, console=QUIET)
    (row,) = [line for line in begun["page"].read_text(encoding="utf-8").splitlines() if line.startswith("| base | 2")]
    told = ["85.0 → 92.0", "80 → 90, 90 → 94", "85.0 → 92.0", "80.0 → 90.0, 90.0 → 94.0"]
    assert row == f"| base | 2 | {' | '.join(told)} |"


def test_symmetric_policies_are_evaluated_beside_those_of_the_network_alone(small, monkeypatch):
    driven = []

    def evaluate(actor, *arguments, **settings):
        driven.append(actor.module[0].module.symmetric)
        return evaluate_as_trained(actor, *arguments, **settings)

    monkeypatch.setattr(rl.ablations, "evaluate_as_trained", evaluate)
    run(["base"], [0], **small, console=QUIET)
    assert driven == [False, False, True, True]
    results = json.loads((small["results"] / "base-seed0.json").read_text(encoding="utf-8"))
    assert results["final"] == results["symmetric"]  # which preset memoryless is


def test_the_page_may_lie_anywhere(begun, tmp_path):
    run(["base"], [0], **{**begun, "page": tmp_path / "elsewhere" / "page.md"}, console=QUIET)
    assert "](../results/curves.png)" in (tmp_path / "elsewhere" / "page.md").read_text(encoding="utf-8")


def test_a_row_that_there_is_not_is_named_before_anything_is_trained(small):
    with pytest.raises(ValueError, match="there is no row bse; there are: base, S"):
        run(["base", "bse"], [0], **small, console=QUIET)
    assert not small["runs"].exists()


def test_what_different_machines_took_is_no_mean_and_formats_that_differ_are_in_no_command(begun):
    one, other = (begun["results"] / f"base-seed{seed}.json" for seed in (0, 1))
    formats = {one: "--autocast float32 --no-report", other: "--autocast bfloat16 --no-report"}
    for file, minutes, machine in ((one, 10, "a slow one"), (other, 30, "a slow one"), (other, 30, "a fast one")):
        results = json.loads(file.read_text(encoding="utf-8")) | {"machine": machine}
        results["command"] = f"navsim train {formats[file] if machine == 'a fast one' else formats[one]}"
        results["curve"]["processor_seconds"][-1] = 60.0 * minutes
        file.write_text(json.dumps(results), encoding="utf-8")
        run(["base"], [0], **begun, console=QUIET)
        page = begun["page"].read_text(encoding="utf-8").splitlines()
        (row,) = [line for line in page if line.startswith("| base | base")]
        (command,) = [line for line in page if line.startswith("- base:")]
        if machine == "a fast one":
            assert row.endswith("| 10–30 |")
            assert command.startswith("- base: `navsim train --no-report` (a fast one, ")
            assert command.endswith("float32)")
        elif file == other:
            assert row.endswith("| 20 |")
            assert command.startswith("- base: `navsim train --autocast float32 --no-report` (a slow one, ")
