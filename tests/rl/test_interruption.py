"""Runs that are killed, interrupted, damaged or out of disk: what is left, and how they go on."""

from __future__ import annotations

import errno
import hashlib
import io
import itertools
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from rich.console import Console
from small_runs import tiny_config
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchrl.checkpoint import Checkpoint

import rl.progress
import rl.train
from rl.background import COLLECTOR_SETTINGS, CollectorError
from rl.checkpoints import Checkpoints, StateFile, find_damage, step_of
from rl.cli import main
from rl.collect import ResumableCollector
from rl.config import ConfigError, TrainConfig
from rl.learner import Learner
from rl.run import FORMAT, Run, RunError, Table, settings_of, write_json
from rl.train import train

LATER_SETTINGS = ("depth_scale", "heading_init", "centred")
"""Settings that came when there were runs of the present format already."""
TIMES = ("seconds", "processor_seconds", "steps_per_second")


def config(out: Path, **settings: Any) -> TrainConfig:
    own = {"replay_capacity": 384, "eval_interval": 192, "checkpoint_interval": 96}
    return tiny_config(out, **{**own, **settings})


def said_by_training(settings: TrainConfig, **arguments: Any) -> str:
    """Trains, and returns what is printed, without what is drawn of the progress bar."""
    text = io.StringIO()
    train(settings, console=Console(file=text, width=1000), **arguments)
    return text.getvalue()


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Run:
    torch.set_num_threads(1)
    return train(config(tmp_path_factory.mktemp("runs") / "whole"), console=Console(quiet=True))


def assert_same(run: Run, other: Run) -> None:
    """Two runs have ended alike, bit for bit, but for the time that they took."""
    for name in ("policy", "policy_last"):
        assert_equal(run.load_policy(name), other.load_policy(name))
    for table, other_table in ((run.metrics, other.metrics), (run.evaluations, other.evaluations)):
        assert without_clock(table) == without_clock(other_table)
    ours, theirs = (sorted((each.directory / "checkpoints").iterdir()) for each in (run, other))
    assert ours[-1].name == theirs[-1].name
    for part in ("collector", "exploration", "generators", "learner", "replay"):
        (one,), (another,) = (list(each[-1].glob(f"components/*-{part}/state.pt")) for each in (ours, theirs))
        states = [torch.load(file, weights_only=True) for file in (one, another)]
        for state in states:
            state.pop("numpy", None)  # numpy's global generator, which nothing here uses or seeds
        assert_equal(*states)
    curves = EventAccumulator(str(run.directory / "tensorboard")).Reload()
    logged = [(event.step, event.value) for event in curves.Scalars("train/max_q")]
    assert logged == [(int(row["step"]), pytest.approx(float(row["max_q"]))) for row in run.metrics.rows()]


def assert_equal(one: Any, other: Any) -> None:
    if isinstance(one, torch.Tensor):
        assert torch.equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_equal(one[key], other[key])
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for ours, theirs in zip(one, other, strict=True):
            assert_equal(ours, theirs)
    else:
        assert one == other


def without_clock(table: Table) -> list[dict[str, str]]:
    return [{key: value for key, value in row.items() if key not in TIMES} for row in table.rows()]


def hidden_files(directory: Path) -> list[Path]:
    return list(directory.rglob(".*"))


# Killed


def killed_at_a_call(out: Path, resume: bool, call: int) -> None:
    """Trains, and is killed at the given one of the calls that make a file, a name, or the lack of them permanent."""
    torch.set_num_threads(1)
    left = call

    def counted(function):
        def fatal(*arguments, **settings):
            nonlocal left
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **settings)

        return fatal

    for module, names in ((os, ("replace", "fsync", "unlink", "rmdir")), (torch, ("save",))):
        for name in names:
            setattr(module, name, counted(getattr(module, name)))
    train(config(out), resume=resume, console=Console(quiet=True))


@pytest.mark.parametrize("kills", [4, pytest.param(30, marks=pytest.mark.slow)])
def test_a_killed_run_ends_as_if_it_had_never_been(tmp_path, uninterrupted, kills):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["rl.train"])
    generator = random.Random(kills)
    killed, attempt = 0, 0
    while killed < kills:
        attempt += 1
        out = tmp_path / f"run{attempt}"
        finished = False
        while not finished and killed < kills:
            by_the_clock = killed % 2
            call = 10**9 if by_the_clock else generator.randrange(1, 150)
            victim = context.Process(target=killed_at_a_call, args=(out, Run(out).exists, call))
            victim.start()
            victim.join(generator.uniform(0.3, 3.0) if by_the_clock else None)
            victim.kill()
            victim.join()
            finished = victim.exitcode == 0
            killed += not finished
            assert victim.exitcode in (0, -signal.SIGKILL)
        run = train(config(out), resume=Run(out).exists, console=Console(quiet=True))
        assert_same(run, uninterrupted)
        assert not hidden_files(out)


def test_a_run_killed_before_its_first_checkpoint_begins_anew(tmp_path, uninterrupted, monkeypatch):
    settings = config(tmp_path / "run")

    class Killed(BaseException):
        pass

    def save(self, name, state_dict):
        if name == "policy_last":
            raise Killed
        save_policy(self, name, state_dict)

    save_policy = Run.save_policy
    monkeypatch.setattr(Run, "save_policy", save)
    with pytest.raises(Killed):
        said_by_training(settings)
    monkeypatch.undo()
    assert Run(settings.directory).metrics.rows()

    said = said_by_training(settings, resume=True)
    assert f"{settings.directory} was interrupted before its first checkpoint: it begins anew\n" in said
    assert_same(Run(settings.directory), uninterrupted)


def test_a_run_killed_while_its_settings_are_written_can_be_begun(tmp_path):
    out = tmp_path / "run"
    (out / "worlds").mkdir(parents=True)
    (out / ".config.json.a1b2c3d4").write_text('{"preset": "fa')
    (out / "worlds" / ".hall.yaml.a1b2c3d4").write_text("form")
    assert not Run(out).exists
    run = Run.create(config(out))
    assert run.config == config(out)
    assert not hidden_files(out)


def test_a_row_that_is_half_written_is_no_row(tmp_path):
    table = Table(tmp_path / "table.csv", ["step", "loss"])
    rows = [table.append({"step": step, "loss": step / 3}) for step in (10, 200)]
    assert table.rows() == rows
    whole = table.path.read_bytes()
    for length in range(len(whole)):
        table.path.write_bytes(whole[:length])
        assert table.rows() == rows[: len(table.rows())]
    table.path.write_bytes(whole[:-4] + b"\0\0")
    assert table.rows() == rows[:1]


def test_only_one_process_trains_in_a_directory(tmp_path):
    with (
        Run(tmp_path / "run").claimed(),
        pytest.raises(RunError, match=r"another process is training in .*run; wait"),
        Run(tmp_path / "run").claimed(),
    ):
        pass
    with Run(tmp_path / "run").claimed():
        pass


def test_a_checkpoint_gets_its_name_when_all_of_it_is_on_the_disk(tmp_path, monkeypatch):
    checkpoints = Checkpoints(tmp_path / "checkpoints", {})
    flushed: set[str] = set()
    fsync, rename = os.fsync, os.replace

    def watched_fsync(handle):
        flushed.add(os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)

    def watched_rename(source, target):
        if Path(target).name == "checkpoint-000000000007":
            wanted = {source, *source.rglob("*")}
            assert {str(path) for path in wanted} <= flushed
            flushed.clear()
        rename(source, target)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("this system does not tell which file a handle is of")
    monkeypatch.setattr(os, "fsync", watched_fsync)
    monkeypatch.setattr(os, "replace", watched_rename)
    saved = checkpoints.save(Checkpoint().register("net", torch.nn.Linear(2, 3), adapter=StateFile()), 7, score=0.0)
    assert flushed == {str(tmp_path / "checkpoints")}  # and then the name
    assert find_damage(saved) == ""


# Interrupted


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_saves_a_checkpoint_and_the_run_goes_on_from_it(tmp_path, uninterrupted, monkeypatch, number):
    settings = config(tmp_path / "run")
    interrupt_at(monkeypatch, update=9, number=number)
    with pytest.raises(KeyboardInterrupt):
        said_by_training(settings)
    monkeypatch.undo()
    newest = Checkpoints(settings.directory / "checkpoints", settings_of(settings)).paths()[-1]
    assert step_of(newest) == 128 + 9 * 32  # no multiple of the interval
    said_by_training(settings, resume=True)
    assert_same(Run(settings.directory), uninterrupted)


@pytest.mark.parametrize(
    "settings",
    [
        {"inputs": ("depth", "heading", "command", "surroundings"), "depth_scale": "inverse", "frame_interval": 3},
        {"prioritized": True, "target_update": "hard", "hard_update_interval": 4, "loss_function": "l2", "n_step": 1},
    ],
    ids=["what the robot remembers", "another way to learn"],
)
def test_a_run_of_other_settings_goes_on_as_if_it_had_not_been_interrupted(tmp_path, monkeypatch, settings):
    whole = train(config(tmp_path / "whole", **settings), console=Console(quiet=True))
    settings = config(tmp_path / "run", **settings)
    interrupt_at(monkeypatch, update=9)
    with pytest.raises(KeyboardInterrupt):
        said_by_training(settings)
    monkeypatch.undo()
    said_by_training(settings, resume=True)
    assert_same(Run(settings.directory), whole)


@pytest.mark.parametrize("batches", [5, 6])  # of 32 transitions; after six, a checkpoint is due
def test_what_was_learnt_is_saved_once_when_there_can_be_no_more_batches(
    tmp_path, uninterrupted, monkeypatch, capsys, batches
):
    class Failing(ResumableCollector):
        def __iter__(self):
            yield from itertools.islice(super().__iter__(), batches)
            raise CollectorError("it is the 4th that has failed in this run")

    def make_collector(env, policy, settings, *, total_steps, **_):
        return Failing(
            env, policy, frames_per_batch=settings.steps_per_batch, total_frames=total_steps, **COLLECTOR_SETTINGS
        )

    saved = []
    save = Checkpoints.save
    monkeypatch.setattr(
        Checkpoints,
        "save",
        lambda self, checkpoint, step, score: saved.append(step) or save(self, checkpoint, step, score),
    )
    monkeypatch.setattr("rl.train.make_collector", make_collector)
    settings = config(tmp_path / "run")
    monkeypatch.setattr("rl.cli._training_settings", lambda arguments: (settings, False))
    assert main(["train"]) == 1
    told = capsys.readouterr().err
    assert told.startswith("it is the 4th that has failed in this run\nto go on from the last checkpoint: navsim train")
    assert saved == {5: [96, 160], 6: [96, 192]}[batches]
    monkeypatch.undo()
    said_by_training(settings, resume=True)
    assert_same(Run(settings.directory), uninterrupted)


def interrupt_at(monkeypatch: pytest.MonkeyPatch, update: int, number: int = signal.SIGINT) -> None:
    learn = Learner.update

    def interrupted(self, sample):
        if self.updates + 1 == update:
            os.kill(os.getpid(), number)
        return learn(self, sample)

    monkeypatch.setattr(Learner, "update", interrupted)


def test_a_resumed_run_begins_with_the_weights_of_its_checkpoint(tmp_path, uninterrupted, monkeypatch):
    settings = config(tmp_path / "run")
    interrupt_at(monkeypatch, update=9)
    with pytest.raises(KeyboardInterrupt):
        said_by_training(settings)
    monkeypatch.undo()
    run = Run(settings.directory)
    weights = {name: run.load_policy(name) for name in ("policy", "policy_last")}
    for name in weights:  # as if the run had got further
        shutil.copy(uninterrupted.directory / f"{name}.pt", run.directory)

    def fails(self, sample):
        raise RuntimeError("as soon as it learns")

    monkeypatch.setattr(Learner, "update", fails)
    with pytest.raises(RuntimeError, match="as soon as it learns"):
        said_by_training(settings, resume=True)
    assert_equal({name: run.load_policy(name) for name in weights}, weights)


@pytest.mark.slow
def test_an_asynchronous_run_goes_on(tmp_path, monkeypatch):
    settings = config(tmp_path / "run", collector="async")
    interrupt_at(monkeypatch, update=9)
    with pytest.raises(KeyboardInterrupt):
        said_by_training(settings)
    monkeypatch.undo()
    rows = Run(settings.directory).metrics.rows()
    assert rows
    assert rows[-1]["step"] != "512"
    said_by_training(settings, resume=True)
    steps = [int(row["step"]) for row in Run(settings.directory).metrics.rows()]
    assert steps == list(range(64, 513, 64))
    assert Run(settings.directory).metrics.rows()[: len(rows)] == rows


@pytest.mark.slow
def test_an_asynchronous_run_whose_process_is_killed_goes_on_with_another(tmp_path, monkeypatch):
    made, make_collector, learn = [], rl.train.make_collector, Learner.update

    def noted_collector(*arguments, **settings):
        made.append(make_collector(*arguments, **settings))
        return made[0]

    def fatal_update(self, sample):
        if self.updates == 5:
            made[0].procs[0].kill()
        return learn(self, sample)

    monkeypatch.setattr(rl.train, "make_collector", noted_collector)
    monkeypatch.setattr(Learner, "update", fatal_update)
    settings = config(tmp_path / "run", collector="async")
    said = said_by_training(settings)
    run = Run(settings.directory)
    warnings = (run.directory / "warnings.txt").read_text()
    assert "the collecting process was ended by signal 9 (SIGKILL)" in warnings
    assert "another one has taken its place (1 of at most 3)" in warnings
    assert "another one has taken its place" in said
    assert run.metrics.rows()[-1]["step"] == "512"
    assert not multiprocessing.active_children()


@pytest.mark.slow
def test_a_script_that_trains_wherever_it_is_imported_is_told_how_to_be_written(tmp_path):
    """The collector's process imports the script, as every process does that is not forked."""
    script = tmp_path / "script.py"
    script.write_text(
        "from rl.background import BackgroundCollector\n"
        "from rl.env import NavEnv\n"
        "from rl.networks import make_q_actor\n"
        "env, policy = NavEnv('complex_train', 1), make_q_actor()\n"
        "BackgroundCollector(env, policy, seed=0, frames_per_batch=1, total_frames=1)\n"
    )
    finished = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert finished.returncode == 1
    last = finished.stderr.splitlines()[-1]
    assert last.startswith("rl.background.CollectorError: the collecting process ended with exit code 1")
    assert 'put what it does below `if __name__ == "__main__":`' in last


def test_a_finished_run_whose_checkpoints_were_removed_stays_as_it_is(tmp_path, uninterrupted):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    shutil.rmtree(out / "checkpoints")
    before = {path: path.stat().st_mtime_ns for path in sorted(out.rglob("*")) if path.is_file()}
    said_by_training(config(out), resume=True)
    assert {path: path.stat().st_mtime_ns for path in sorted(out.rglob("*")) if path.is_file()} == before


def test_ctrl_c_is_heeded_where_no_batch_is_left(tmp_path, uninterrupted, monkeypatch):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    begin = rl.train._Logs.begin

    def interrupted(logs, progress):
        begin(logs, progress)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(rl.train._Logs, "begin", interrupted)
    with pytest.raises(KeyboardInterrupt):
        said_by_training(config(out), resume=True)


def test_a_resumed_run_has_spent_the_time_of_the_evaluation_at_its_checkpoint(tmp_path, monkeypatch):
    settings = config(tmp_path / "run")
    evaluate, now, waited = rl.train._evaluate, time.perf_counter, 0.0

    def slowly(*arguments):
        nonlocal waited
        waited += 1_000.0
        return evaluate(*arguments)

    monkeypatch.setattr(rl.train, "_evaluate", slowly)
    monkeypatch.setattr(rl.progress.time, "perf_counter", lambda: now() + waited)
    with monkeypatch.context() as patch:
        interrupt_at(patch, update=9)
        with pytest.raises(KeyboardInterrupt):
            said_by_training(settings)
    checkpoints = Checkpoints(settings.directory / "checkpoints", settings_of(settings)).paths()
    evaluated = [int(row["step"]) for row in Run(settings.directory).evaluations.rows()]
    shutil.rmtree(checkpoints[-1])  # as if it had been killed
    assert step_of(checkpoints[-2]) in evaluated
    said_by_training(settings, resume=True)
    rows = Run(settings.directory).evaluations.rows()
    assert [round(float(row["seconds"]), -3) for row in rows] == [1_000.0 * number for number in range(len(rows))]


def test_what_has_been_learnt_needs_no_room_for_checkpoints(tmp_path, uninterrupted, monkeypatch):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    said_by_training(config(out), resume=True)
    shutil.rmtree(Checkpoints(out / "checkpoints", {}).paths()[-1])
    with pytest.raises(ConfigError, match=r"0\.00 GiB of free disk"):
        said_by_training(config(out), resume=True)


# Damaged


@pytest.mark.parametrize("content", [b"\0" * 40, b"step,seconds\ngarbage,1\n"])
def test_a_damaged_table_is_written_anew_from_a_checkpoint(tmp_path, uninterrupted, content):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    (out / "evaluations.csv").write_bytes(content + b"\n")
    said_by_training(config(out), resume=True)
    assert_same(Run(out), uninterrupted)
    shutil.rmtree(out / "checkpoints")
    (out / "evaluations.csv").write_bytes(content + b"\n")
    with pytest.raises(RunError, match=r"evaluations\.csv is damaged \(.*\); restore it"):  # and not trained anew
        said_by_training(config(out), resume=True)


@pytest.fixture
def two_checkpoints(tmp_path, uninterrupted) -> tuple[Path, Path]:
    shutil.copytree(uninterrupted.directory / "checkpoints", tmp_path / "original")
    older, newer = sorted((tmp_path / "original").iterdir())[-2:]
    return older, newer


def damaged_copies(checkpoint: Path, generator: random.Random, count: int) -> Iterator[tuple[str, bytes]]:
    """Names of files, and contents that are not theirs: cut off at any byte, or with one byte changed."""
    files = [file for file in sorted(checkpoint.rglob("*")) if file.is_file()]
    for number in range(count):
        file = generator.choice(files)
        content = bytearray(file.read_bytes())
        place = generator.randrange(len(content))
        if number % 2:
            content[place] ^= generator.randrange(1, 256)
        else:
            del content[place:]
        yield file.relative_to(checkpoint).as_posix(), bytes(content)


def test_a_damaged_checkpoint_is_told_and_the_one_before_it_taken(tmp_path, two_checkpoints):
    older, newer = two_checkpoints
    for number, (name, content) in enumerate(damaged_copies(newer, random.Random(0), 200)):
        directory = tmp_path / f"copy{number}"
        for checkpoint in two_checkpoints:
            shutil.copytree(checkpoint, directory / checkpoint.name, copy_function=os.link)
        (directory / newer.name / name).unlink()
        (directory / newer.name / name).write_bytes(content)
        said: list[str] = []
        found = Checkpoints(directory, {}).newest_intact(said.append)
        assert found == directory / older.name
        (sentence,) = said
        assert sentence.startswith(f"{directory / newer.name} is damaged (")
        assert sentence.endswith(f": it is removed, and the run goes on from {older.name}")
        assert "\n" not in sentence
        assert [path.name for path in Checkpoints(directory, {}).paths()] == [older.name]
        shutil.rmtree(directory)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda path: (path / "SHA256SUMS").unlink(), "SHA256SUMS cannot be read"),
        (lambda path: (path / "SHA256SUMS").write_text(""), "SHA256SUMS does not name components/0000"),
        (lambda path: (path / "manifest.json").unlink(), "manifest.json is missing"),
        (lambda path: (path / "more").write_text(""), "SHA256SUMS does not name more"),
        (lambda path: [shutil.rmtree(path), path.mkdir()], "SHA256SUMS cannot be read"),
    ],
)
def test_files_that_are_missing_or_added_are_damage(two_checkpoints, change, told):
    _, newer = two_checkpoints
    assert find_damage(newer) == ""
    change(newer)
    assert told in find_damage(newer)


def test_checksums_are_what_sha256sum_checks(two_checkpoints):
    if shutil.which("sha256sum") is None:
        pytest.skip("sha256sum is not installed")
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=two_checkpoints[1], check=True)


def test_a_run_goes_on_from_before_a_damaged_checkpoint_to_the_same_end(tmp_path, uninterrupted):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    # The end of the run is damaged, and policy.pt and the tables are from then.
    newest = sorted((out / "checkpoints").iterdir())[-1]
    largest = max(newest.rglob("state.pt"), key=lambda file: file.stat().st_size)
    os.truncate(largest, 1000)
    with (out / "metrics.csv").open("a") as file:
        file.write("544,1")
    said = said_by_training(config(out), resume=True)
    assert f"{newest} is damaged (components/0003-learner/state.pt does not have the checksum" in said
    assert_same(Run(out), uninterrupted)


@pytest.mark.parametrize("kind", ["file", "link"])
def test_what_is_no_checkpoint_but_has_the_name_of_one_is_passed_over(tmp_path, uninterrupted, kind):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    impostor = out / "checkpoints" / "checkpoint-000000000999"
    if kind == "file":
        impostor.write_bytes(b"anything")
    else:
        (tmp_path / "elsewhere").mkdir()
        impostor.symlink_to(tmp_path / "elsewhere")
    said = said_by_training(config(out), resume=True)
    assert f"{impostor} is damaged (SHA256SUMS cannot be read): it is removed" in said
    assert not impostor.is_symlink()
    assert not impostor.exists()
    assert (tmp_path / "elsewhere").exists() == (kind == "link")
    assert_same(Run(out), uninterrupted)


def test_a_run_whose_checkpoints_are_all_damaged_is_left_alone(tmp_path, uninterrupted):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    for manifest in out.glob("checkpoints/*/manifest.json"):
        manifest.write_text("{}")
    before = {path: path.stat().st_mtime_ns for path in sorted(out.rglob("*"))}
    with pytest.raises(RunError, match=r"every checkpoint in .* is damaged \(.*restore one, or delete that directory"):
        said_by_training(config(out), resume=True)
    assert {path: path.stat().st_mtime_ns for path in sorted(out.rglob("*"))} == before


def test_the_last_two_checkpoints_and_the_best_are_kept(uninterrupted):
    steps = [step_of(path) for path in Checkpoints(uninterrupted.directory / "checkpoints", {}).paths()]
    rows = uninterrupted.evaluations.rows()
    best = max(rows, key=lambda row: (float(row["success_rate"]), float(row["spl"]), int(row["step"])))
    assert steps == sorted({480, 512, int(best["step"])})


def test_the_checkpoint_after_the_best_evaluation_is_kept(tmp_path, monkeypatch):
    rates = iter([0.9, 0.1, 0.2, 0.5, 0.1, 0.1, 0.1, 0.1])  # every 64 transitions; checkpoints are every 128

    def evaluate(*_):
        rate = next(rates)
        others = {"collision_rate": 0.0, "timeout_rate": 0.0, "spl": 0.0, "mean_reward": 0.0, "mean_steps": 0.0}
        return SimpleNamespace(success_rate=rate, **others)

    monkeypatch.setattr("rl.train._evaluate", evaluate)
    run = train(config(tmp_path / "run", eval_interval=64, checkpoint_interval=128), console=Console(quiet=True))
    steps = [step_of(path) for path in Checkpoints(run.directory / "checkpoints", {}).paths()]
    assert steps == [128, 384, 512]


def test_a_run_begun_when_there_were_fewer_settings_goes_on(tmp_path, uninterrupted):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    newest = sorted((out / "checkpoints").iterdir())[-1]
    shutil.rmtree(newest)
    settings = {name: value for name, value in config(out).to_dict().items() if name not in LATER_SETTINGS}
    write_json(out / "config.json", {"format": FORMAT, **settings})
    for manifest in out.glob("checkpoints/*/manifest.json"):
        content = json.loads(manifest.read_text())
        for name in LATER_SETTINGS:
            del content["metadata"]["settings"][name]
        manifest.write_text(json.dumps(content))
        sums = manifest.with_name("SHA256SUMS")
        lines = [line for line in sums.read_text().splitlines() if not line.endswith("  manifest.json")]
        lines.append(f"{hashlib.sha256(manifest.read_bytes()).hexdigest()}  manifest.json")
        sums.write_text("\n".join(lines) + "\n")
    said_by_training(config(out), resume=True)
    assert_same(Run(out), uninterrupted)


def test_a_checkpoint_of_other_settings_is_refused(tmp_path, uninterrupted):
    out = tmp_path / "run"
    shutil.copytree(uninterrupted.directory, out)
    with pytest.raises(RunError, match=r"was begun with other settings \(batch_size\)"):
        said_by_training(config(out, batch_size=32), resume=True)
    write_json(out / "config.json", {"format": FORMAT, **config(out, batch_size=32).to_dict()})
    with pytest.raises(RunError, match=r"written with other settings than .*config.json holds \(batch_size\)"):
        said_by_training(config(out, batch_size=32), resume=True)


# Out of disk


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system of 64 MiB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here: that takes root's rights")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


def fill(place: Path, left: int) -> None:
    """Takes all but ``left`` bytes of a file system."""
    with (place / "filler").open("wb") as file:
        file.write(bytes(shutil.disk_usage(place).free - left))


# A checkpoint has 9 MB, policy_last.pt before it 2 MB, of which the old one has its place already.
@pytest.mark.parametrize("left", [0, 3_000_000, pytest.param(6_000_000, marks=pytest.mark.slow)])
def test_a_full_disk_ends_a_run_which_goes_on_when_there_is_room(small_disk, uninterrupted, monkeypatch, capfd, left):
    settings = config(small_disk / "run")
    learn = Learner.update

    def on_a_disk_that_fills_up(self, sample):
        if self.updates == 6:
            fill(small_disk, left)
        return learn(self, sample)

    monkeypatch.setattr(Learner, "update", on_a_disk_that_fills_up)
    with pytest.raises(RunError) as refusal:
        said_by_training(settings)
    monkeypatch.undo()
    assert not capfd.readouterr().err
    message = str(refusal.value)
    assert message.startswith(str(settings.directory))
    assert "could not be written (" in message
    assert "MiB are free there): the run has stopped" in message
    assert message.endswith("make room, then go on with --resume")
    assert not hidden_files(settings.directory)
    kept = Checkpoints(settings.directory / "checkpoints", settings_of(settings)).paths()
    assert kept
    assert [find_damage(path) for path in kept] == [""] * len(kept)

    (small_disk / "filler").unlink()
    said_by_training(settings, resume=True)
    assert_same(Run(settings.directory), uninterrupted)


def test_a_checkpoint_whose_checksums_do_not_fit_on_the_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("rl.checkpoints._seal", full)
    checkpoint = Checkpoint().register("net", torch.nn.Linear(2, 3), adapter=StateFile())
    with pytest.raises(RunError, match=r"checkpoint-000000000007 could not be written \(No space left on device"):
        Checkpoints(tmp_path, {}).save(checkpoint, 7, score=0.0)
    assert not any(tmp_path.iterdir())


def test_a_file_that_may_not_grow_is_told_like_a_full_disk(tmp_path, uninterrupted, monkeypatch):
    settings = config(tmp_path / "run")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    learn = Learner.update

    def limited(self, sample):
        if self.updates == 6:
            resource.setrlimit(resource.RLIMIT_FSIZE, (4_000_000, limits[1]))
        return learn(self, sample)

    monkeypatch.setattr(Learner, "update", limited)
    try:
        with pytest.raises(RunError, match=r"checkpoint-\d+ could not be written \(.*MiB are free there\): the run"):
            said_by_training(settings)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    monkeypatch.undo()
    assert not hidden_files(settings.directory)
    said_by_training(settings, resume=True)
    assert_same(Run(settings.directory), uninterrupted)
