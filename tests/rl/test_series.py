"""Series of trainings: what is skipped, what goes on, and what becomes of those that fail."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from small_runs import tiny_config

import rl.series
from rl.run import Run, RunError, settings_of
from rl.series import Planned, SeriesError, run_series
from rl.watch import NumbersError


def planned(directory: Path, *names: str) -> list[Planned]:
    return [
        Planned(
            name=name,
            what=f"the run {name}",
            labels={"label": name},
            config=tiny_config(directory / name),
            results=directory / "results" / f"{name}.json",
        )
        for name in names
    ]


@pytest.fixture
def trained(monkeypatch):
    """Which runs were trained, and whether they were gone on with, by a ``train`` that only makes their directories."""
    calls = []

    def train(config, *, resume, console):
        calls.append((config.directory.name, resume))
        if config.directory.name == "broken":
            raise NumbersError("the loss is nan")
        run = Run(config.directory) if resume else Run.create(config)
        (run.directory / "checkpoints").mkdir()
        return run

    monkeypatch.setattr(rl.series, "train", train)
    return calls


def test_finished_runs_are_skipped_and_begun_ones_go_on(tmp_path, trained):
    finished, begun, fresh = series = planned(tmp_path, "finished", "begun", "fresh")
    finished.results.parent.mkdir()
    finished.results.write_text(json.dumps({"steps": finished.config.total_steps}))
    Run.create(begun.config)
    written = []

    def write_up():
        written.append(sorted(path.stem for path in (tmp_path / "results").iterdir()))

    said = io.StringIO()
    run_series(series, lambda run: {"of": run.directory.name}, write_up, Console(file=said))
    assert trained == [("begun", True), ("fresh", False)]
    both, all_three = ["begun", "finished"], ["begun", "finished", "fresh"]
    assert written == [["finished"], both, all_three, all_three]
    assert "[1/3] finished: finished before" in said.getvalue()
    assert "[3/3] fresh: the run fresh" in said.getvalue()
    results = json.loads(fresh.results.read_text())
    assert (results["label"], results["of"], results["steps"]) == ("fresh", "fresh", fresh.config.total_steps)
    assert results["settings"] == settings_of(fresh.config)
    assert {"machine", "versions"} < set(results)
    assert not (fresh.config.directory / "checkpoints").exists()

    trained.clear()
    run_series(series, lambda run: {}, write_up, Console(file=said))
    assert not trained


def test_what_fails_or_is_trained_by_another_process_does_not_end_the_others(tmp_path, trained, monkeypatch):
    broken, busy, last = series = planned(tmp_path, "broken", "busy", "last")
    train = rl.series.train

    def train_where_no_other_does(config, **settings):
        with Run(config.directory).claimed():
            return train(config, **settings)

    monkeypatch.setattr(rl.series, "train", train_where_no_other_does)
    said = io.StringIO()
    with Run(busy.config.directory).claimed(), pytest.raises(SeriesError, match="not finished: broken, busy;"):
        run_series(series, lambda run: {}, lambda: None, Console(file=said, width=200))
    assert "broken: the loss is nan" in said.getvalue()
    assert "busy: another process is training in" in said.getvalue()
    assert trained == [("broken", False), ("last", False)]
    assert last.results.exists()
    assert not broken.results.exists()


def test_results_of_another_length_are_refused_before_anything_is_trained(tmp_path, trained):
    one, other = planned(tmp_path, "one", "other")
    other.results.parent.mkdir()
    other.results.write_text(json.dumps({"steps": 5}))
    with pytest.raises(ValueError, match=r"other\.json has the results of 5 steps, .* move it and the run"):
        run_series([one, other], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert not trained


def test_results_of_other_settings_are_refused_before_anything_is_trained(tmp_path, trained):
    one, other = planned(tmp_path, "one", "other")
    settings = json.loads(json.dumps(settings_of(other.config)))
    older = {name: value for name, value in settings.items() if name != "centred"} | {"gone": 1}
    other.results.parent.mkdir()
    other.results.write_text(json.dumps({"steps": other.config.total_steps, "settings": older}))
    run_series([other], lambda run: {}, lambda: None, Console(file=io.StringIO()))  # older, and the same
    changed = settings | {"gamma": 0.5, "task": settings["task"] | {"max_steps": 7}}
    other.results.write_text(json.dumps({"steps": other.config.total_steps, "settings": changed}))
    told = r"other\.json has the results of other settings than those asked for \(gamma, task\.max_steps\); move it"
    with pytest.raises(ValueError, match=told):
        run_series([one, other], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    asked_for_any = [other._replace(config=replace(other.config, autocast="auto"))]
    other.results.write_text(json.dumps({"steps": other.config.total_steps, "settings": settings}))
    run_series(asked_for_any, lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert not trained


def test_results_that_cannot_be_read_are_told_before_anything_is_trained(tmp_path, trained):
    (one,) = planned(tmp_path, "one")
    one.results.parent.mkdir()
    for text in ("", "[]", '{"total_steps": 512}', '{"steps": "512"}', '{"steps": 512, "settings": null}'):
        one.results.write_text(text)
        with pytest.raises(ValueError, match=r"one\.json does not hold the results of a run; move it away"):
            run_series([one], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert not trained


def test_a_disk_that_is_full_when_results_are_written_does_not_end_the_others(tmp_path, trained, monkeypatch):
    series = planned(tmp_path, "one", "other")
    write_json = rl.series.write_json

    def write(path, value, **settings):
        if path.stem == "one":
            raise OSError(28, "No space left on device", str(path))
        write_json(path, value, **settings)

    monkeypatch.setattr(rl.series, "write_json", write)
    said = io.StringIO()
    with pytest.raises(SeriesError, match="not finished: one;"):
        run_series(series, lambda run: {}, lambda: None, Console(file=said, width=200))
    assert "one: [Errno 28] No space left on device" in said.getvalue()
    assert (series[0].config.directory / "checkpoints").exists()
    assert series[1].results.exists()


def test_what_another_process_has_finished_meanwhile_is_kept(tmp_path, trained, monkeypatch):
    (one,) = planned(tmp_path, "one")
    train = rl.series.train

    def slow_train(config, **settings):
        run = train(config, **settings)
        one.results.write_text('{"of": "the other"}')
        return run

    monkeypatch.setattr(rl.series, "train", slow_train)
    run_series([one], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert json.loads(one.results.read_text()) == {"of": "the other"}


def test_what_another_process_finishes_after_it_was_busy_here_is_finished(tmp_path, trained, monkeypatch):
    busy, last = series = planned(tmp_path, "busy", "last")
    train = rl.series.train

    def train_meanwhile(config, **settings):
        if config.directory.name == "busy":
            raise RunError("another process is training there")
        busy.results.write_text(json.dumps({"steps": busy.config.total_steps}))
        return train(config, **settings)

    monkeypatch.setattr(rl.series, "train", train_meanwhile)
    run_series(series, lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert last.results.exists()


@pytest.mark.parametrize("ended", [False, True])
def test_only_runs_that_have_ended_lose_their_checkpoints(tmp_path, trained, monkeypatch, ended):
    (one,) = planned(tmp_path, "one")
    one.results.parent.mkdir()
    one.results.write_text(json.dumps({"steps": one.config.total_steps}))  # which may be of another directory's run
    checkpoints = Run.create(one.config).directory / "checkpoints"
    checkpoints.mkdir()
    monkeypatch.setattr(Run, "has_ended", ended)
    with Run(one.config.directory).claimed():  # as by another process
        run_series([one], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert checkpoints.exists()
    run_series([one], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert checkpoints.exists() != ended


@pytest.mark.parametrize("breaks_after", [0, 1])
def test_a_page_that_cannot_be_written_is_told_first_and_ends_no_series_that_runs(tmp_path, trained, breaks_after):
    def write_up():
        if len(trained) == breaks_after:
            raise IsADirectoryError(21, "Is a directory", str(tmp_path / "page.md"))

    series, said = planned(tmp_path, "one", "other"), io.StringIO()
    if breaks_after == 0:
        with pytest.raises(ValueError, match=r"page\.md cannot be used: Is a directory$"):
            run_series(series, lambda run: {}, write_up, Console(file=said))
        assert not trained
    else:
        run_series(series, lambda run: {}, write_up, Console(file=said, width=200))
        assert "not written up: [Errno 21] Is a directory" in said.getvalue()
        assert len(trained) == 2


def test_a_file_where_results_are_to_lie_is_told_before_anything_is_trained(tmp_path, trained):
    (one,) = planned(tmp_path, "one")
    one.results.parent.write_text("in the way")
    with pytest.raises(ValueError, match="results cannot be used: File exists"):
        run_series([one], lambda run: {}, lambda: None, Console(file=io.StringIO()))
    assert not trained
