"""A run's directory: what lies in it, and runs of other versions."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import rl.run
from navsim.camera import DepthCamera
from navsim.worldfile import load_world
from rl.cli import main
from rl.config import PRESETS, TrainConfig
from rl.learner import make_actor
from rl.policies import load_policy
from rl.run import FORMAT, Run, RunError, write_json

HALL = Path(__file__).with_name("hall.yaml")


def config(out: Path, **settings) -> TrainConfig:
    return replace(PRESETS["memoryless"], camera=DepthCamera(width=20, height=12), out=out, **settings)


@pytest.fixture
def run(tmp_path) -> Run:
    run = Run.create(config(tmp_path / "run"))
    torch.manual_seed(0)
    run.save_policy("policy", make_actor(run.config).state_dict())
    return run


def test_a_run_says_its_format_settings_and_versions(run):
    values = json.loads((run.directory / "config.json").read_text())
    assert values.pop("format") == FORMAT == run.format
    assert TrainConfig.from_dict(values) == run.config == config(run.directory)
    assert {"python", "torch", "torchrl", "pymunk", "navsim-rl"} <= set(
        json.loads((run.directory / "versions.json").read_text())
    )


def test_a_run_keeps_the_worlds_that_it_was_begun_with(tmp_path):
    room = tmp_path / "rooms" / "hall.yaml"
    room.parent.mkdir()
    room.write_bytes(HALL.read_bytes())
    world = ("complex_train", str(HALL), "generate:clutter,count=2")
    settings = config(tmp_path / "run", world=world, eval_world=str(room))
    run = Run.create(settings)
    original = load_world(room)
    room.unlink()  # whatever becomes of it
    own = run.with_its_worlds(settings)
    worlds = run.directory / "worlds"
    assert own.world == (str(worlds / "complex_train.yaml"), str(worlds / "hall.yaml"), "generate:clutter,count=2")
    assert own.eval_world == str(worlds / "2" / "hall.yaml")
    assert load_world(own.world[0]) == load_world("complex_train")
    assert load_world(own.eval_world) == original
    assert own.directory == settings.directory
    (worlds / "hall.yaml").unlink()
    with pytest.raises(RunError, match=r"worlds/hall.yaml is missing, the run's copy of a world file; restore it"):
        run.with_its_worlds(settings)


@pytest.mark.parametrize("name", ["policy.pt", "metrics.csv", "evaluation/a.json", "tensorboard/a", "checkpoints/a"])
def test_what_is_in_a_directory_that_holds_no_run_is_not_overwritten(tmp_path, name):
    file = tmp_path / "own" / name
    file.parent.mkdir(parents=True)
    file.write_text("mine")
    with pytest.raises(RunError, match=rf"own is not a run's directory, .* holds {name.split('/')[0]}, which a run"):
        Run.create(config(tmp_path / "own"))
    assert file.read_text() == "mine"


@pytest.mark.parametrize("name", ["versions.json", "worlds/complex_eval.yaml"])
def test_a_run_begins_where_one_was_killed_before_it_began_but_not_over_other_files(run, name):
    (run.directory / "policy.pt").unlink()
    (run.directory / "config.json").unlink()
    assert Run.create(config(run.directory)).exists
    (run.directory / "config.json").unlink()
    file = run.directory / name
    file.write_text("mine")
    with pytest.raises(RunError, match=f"holds {name}, which a run there would overwrite; choose another directory"):
        Run.create(config(run.directory))
    assert file.read_text() == "mine"


def test_only_what_a_run_had_begun_to_write_is_rubbish(run):
    (run.directory / "evaluation").mkdir()
    rubbish = [
        ".config.json.abcdefgh",
        ".policy.pt.a_b1c2d3",
        "worlds/.hall.yaml.abcdefgh",
        "evaluation/.a.json.aaaaaaaa",
    ]
    others = [".env.template", ".zshrc.original", ".policy.pt", "worlds/.git.abcdefgh", ".hall.yaml.abcdefgh"]
    for name in (*rubbish, *others):
        (run.directory / name).write_text("")
    run.remove_rubbish()
    assert [name for name in (*rubbish, *others) if (run.directory / name).exists()] == others


@pytest.mark.parametrize("format_", [0, 1])
def test_a_run_of_an_earlier_version_can_be_used_but_not_gone_on_with(run, capsys, format_):
    kept = run.with_its_worlds(run.config)
    later = ("inputs", "depth_scale", "heading_init", "centred", "frame_interval", "sensor", "randomization")
    settings = {name: value for name, value in run.config.to_dict().items() if name not in later}
    write_json(run.directory / "config.json", ({"format": format_} if format_ else {}) | settings)
    assert run.format == format_
    load_policy(run.directory)
    assert run.with_its_worlds(run.config) == (run.config if format_ == 0 else kept)
    assert main(["train", "--resume", "--out", str(run.directory)]) == 2
    told = capsys.readouterr().err
    assert told == (
        f"{run.directory} was written by an earlier version of navsim-rl, whose runs can be evaluated but not gone on "
        "with; choose another directory (--out) to begin anew\n"
    )


@pytest.mark.parametrize("newer", [FORMAT + 1, "2.0"])
def test_a_run_of_a_later_version_says_what_to_install(run, capsys, newer):
    write_json(run.directory / "config.json", {"format": newer, **run.config.to_dict(), "setting_to_come": 1})
    for command in (["train", "--resume", "--out"], ["report"], ["evaluate", "--world", str(HALL), "--run"]):
        arguments = [*command[:-1], str(run.directory)] if command[-1] == "--run" else [*command, str(run.directory)]
        assert main(arguments) == 2
        told = capsys.readouterr().err
        assert f"{run.directory / 'config.json'} is of format {newer!r}, and this version of navsim-rl reads" in told
        assert "install the version that versions.json beside it names, or a newer one" in told
        assert len(told.splitlines()) == 1


def test_processes_evaluate_a_policy_alike_to_the_byte(run, tmp_path):
    (tmp_path / "open.yaml").write_text(HALL.read_text().split("starts:")[0] + "starts: random\ngoals: random\n")
    commands = {}
    for place in ("here", "elsewhere"):
        own = ["evaluate", str(run.directory), "--json", str(tmp_path / f"{place}-listed.json"), "--world", str(HALL)]
        drawn = ["--num-paths", "20", "--world", str(tmp_path / "open.yaml")]
        commands[place] = [own, [*own[:2], "--json", str(tmp_path / f"{place}-drawn.json"), *drawn]]
    script = f"from rl.cli import main\nfor arguments in {commands['elsewhere']}: main(arguments)"
    surroundings = {**os.environ, "PYTHONHASHSEED": "1", "OMP_NUM_THREADS": str(torch.get_num_threads() + 1)}
    with subprocess.Popen([sys.executable, "-c", script], env=surroundings, stdout=subprocess.DEVNULL) as elsewhere:
        assert [main(arguments) for arguments in commands["here"]] == [0, 0]
        assert elsewhere.wait(200) == 0
    for kind in ("listed", "drawn"):
        first, second = ((tmp_path / f"{place}-{kind}.json").read_bytes() for place in commands)
        assert json.loads(first)["paths"]
        assert first == second


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            "processor\t: 0\nmodel\t\t: 17\nmodel name\t: AMD EPYC\ncpu family\t: 25\n\nprocessor\t: 1\nmodel\t: 1\n",
            "AMD EPYC (family 25, model 17)",
        ),
        ("processor\t: 0\nCPU architecture: 8\n", platform.processor() or platform.machine()),  # as on ARM
    ],
)
def test_the_processor_is_told_with_its_generation_where_the_system_knows(monkeypatch, content, expected):
    monkeypatch.setattr(rl.run.Path, "read_text", lambda path, encoding: content)
    assert rl.run.processor() == expected
