"""The ``navsim`` command: the whole line in small, what help says, and how mistakes are told."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from importlib import metadata
from itertools import pairwise
from pathlib import Path

import pytest

from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.robot import Robot
from navsim.sensor import SensorModel
from navsim.task import Task
from rl.cli import SPINS, _training_settings, main
from rl.config import PRESETS, ConfigError, TrainConfig
from rl.evaluation import evaluate_as_trained
from rl.metrics import Evaluation
from rl.policies import load_policy
from rl.run import Run, RunError

REPOSITORY = Path(__file__).parents[2]
ROOM = """
format: 1
size: [4.0, 4.0]
obstacles:
  - box: {at: [0.0, 0.0], size: [0.4, 0.4], height: 0.8}
starts:
  - {at: [-1.5, -1.5], yaw_deg: 45}
goals:
  - [1.5, 1.5]
  - [-1.5, 1.5]
"""
SMALL = [
    *("--total-steps", "320", "--warmup-steps", "64", "--batch-size", "16", "--num-envs", "4"),
    *("--steps-per-batch", "32", "--eval-interval", "160", "--checkpoint-interval", "160", "--log-interval", "80"),
    *("--camera.width", "20", "--camera.height", "16", "--task.max-steps", "30"),
    *("--num-threads", "1", "--autocast", "float32", "--rearrangements", "2"),
]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small world file."""
    path = tmp_path_factory.mktemp("worlds") / "room.yaml"
    path.write_text(ROOM)
    return path


def training(room: Path, directory: Path) -> list[str]:
    return ["train", "--world", str(room), "--eval-world", str(room), "--out", str(directory), *SMALL]


@pytest.fixture(scope="module")
def finished(room: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a run that has come to its end."""
    directory = tmp_path_factory.mktemp("runs") / "finished"
    assert main(training(room, directory)) == 0
    return directory


def process(arguments: Sequence[str], directory: Path, **variables: str) -> subprocess.Popen[str]:
    paths = [str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "rl.cli", *arguments],
        cwd=directory,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"} | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_help_breaks_lines_where_the_terminal_ends_not_where_the_source_does(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["train", "--help"]) == 0
    lines = capsys.readouterr().out.partition("camera options")[0].splitlines()
    texts = [match[1] if (match := re.match(r". {7}(\S.*?) *.?$", line)) else "" for line in lines]
    assert len([text for text in texts if text]) > 50, lines
    for text, following in pairwise(texts):
        if text and following:
            assert len(text) + 1 + len(following.split()[0]) > 70, f"{text}|{following}"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["train", "--help"],
        ["world", "check", "complex_train"],
        ["evaluate", "straight", "--world", "simple_eval", "--num-paths", "2", "--json", "written.json"],
    ],
)
def test_a_reader_that_has_read_enough_is_no_mistake(arguments, tmp_path):
    """As "navsim train --help | head" does, whether the command still writes then, or only flushes."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "rl.cli", *arguments]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False, cwd=tmp_path)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
    if "--json" in arguments:
        assert len(Evaluation.load(tmp_path / "written.json").paths) == 2


def test_a_training_goes_on_without_a_reader(room, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "rl.cli", "train", *training(room, tmp_path / "run")[1:], "--no-report"]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "nobody reads the output any more: going on without it\n")
    assert Run(tmp_path / "run").has_ended


# The whole line


def test_training_ends_with_weights_evaluations_and_a_report(finished):
    names = {path.relative_to(finished).as_posix() for path in finished.rglob("*") if path.is_file()}
    assert {"config.json", "versions.json", "metrics.csv", "evaluations.csv", "policy.pt", "report.html"} <= names
    evaluated = {path.stem for path in (finished / "evaluation").glob("*.json")}
    assert evaluated - {"D3QN-I last"} == {"D3QN-I", "random", "straight", "reactive", "oracle"}
    assert [row.split(",")[0] for row in (finished / "evaluations.csv").read_text().split()[1:]] == ["160", "320"]


def test_settings_of_the_command_line_are_those_of_the_run(finished, room):
    settings = Run(finished).config
    assert settings == dataclasses.replace(
        PRESETS["fast"],
        world=(str(room),),
        eval_world=str(room),
        out=finished,
        total_steps=320,
        warmup_steps=64,
        batch_size=16,
        num_envs=4,
        steps_per_batch=32,
        eval_interval=160,
        checkpoint_interval=160,
        log_interval=80,
        num_threads=1,
        autocast="float32",
        rearrangements=2,
        camera=DepthCamera(width=20, height=16),
        task=Task(max_steps=30),
    )


def test_a_run_goes_on_with_the_format_that_was_chosen_and_may_get_its_report_later(finished):
    arguments = ["--out", str(finished), "--resume", "--autocast", "auto"]
    config, resume = _training_settings([*arguments, "--no-report"])
    assert resume
    assert (config.autocast, config.report) == ("float32", False)
    Run(finished).check_resumable(config)
    assert _training_settings(arguments)[0].report
    with pytest.raises(RunError, match="begun with other settings \\(autocast\\)"):
        _training_settings([*arguments, "--autocast", "bfloat16"])


def test_a_runs_own_settings_need_not_suit_its_preset(finished):
    steps = str(Run(finished).config.total_steps)  # too few for the preset's warm-up
    assert _training_settings(["--out", str(finished), "--resume", "--total-steps", steps])[1]
    with pytest.raises(RunError, match="begun with other settings \\(total_steps\\)"):
        _training_settings(["--out", str(finished), "--resume", "--total-steps", str(int(steps) + 8)])
    with pytest.raises(ConfigError, match="must be at least --warmup-steps"):
        _training_settings(["--out", str(finished / "none"), "--resume", "--total-steps", steps])


def test_a_run_has_its_name_from_inside_its_directory_too(finished, room, tmp_path, monkeypatch):
    monkeypatch.chdir(finished)
    assert main(["evaluate", ".", "--world", str(room), "--json", str(tmp_path / "result.json")]) == 0
    assert json.loads((tmp_path / "result.json").read_text())["policy"] == finished.name


def test_a_run_is_evaluated_with_its_own_camera_and_rules(finished, room, tmp_path, capsys):
    assert main(["evaluate", str(finished), "--world", str(room), "--json", str(tmp_path / "result.json")]) == 0
    assert "success" in capsys.readouterr().out
    result = json.loads((tmp_path / "result.json").read_text())
    assert len(result["paths"]) == 2
    assert all(path["steps"] <= 30 for path in result["paths"])
    # What a network does is decided by its weights alone: the run's own evaluation comes out again.
    own = finished / "evaluation" / "D3QN-I.json"
    assert json.loads(own.read_text())["paths"] == result["paths"]


def test_the_oracle_solves_what_the_straight_line_does_not(room, tmp_path):
    rates = {}
    for name in ("oracle", "straight"):
        assert main(["evaluate", name, "--world", str(room), "--json", str(tmp_path / name)]) == 0
        rates[name] = json.loads((tmp_path / name).read_text())["summary"]["success_rate"]
    assert rates == {"oracle": 1.0, "straight": 0.5}  # the box stands between the start and the first goal


def test_the_last_weights_of_a_run_can_be_evaluated_and_nothing_else_has_any(finished, room, tmp_path, capsys):
    run = tmp_path / "run"
    shutil.copytree(finished, run, ignore=shutil.ignore_patterns("checkpoints"))
    (run / "policy.pt").unlink()
    result = tmp_path / "result.json"
    assert main(["evaluate", str(run), "--world", str(room), "--weights", "last", "--json", str(result)]) == 0
    last = evaluate_as_trained(load_policy(finished, weights="last"), Run(finished).config, str(room))
    assert [path.actions.tolist() for path in Evaluation.from_json(result.read_text()).paths] == [
        path.actions.tolist() for path in last.paths
    ]
    capsys.readouterr()
    assert main(["evaluate", "oracle", "--world", str(room), "--weights", "last"]) == 2
    assert capsys.readouterr().err == "oracle is no run, which alone has last weights beside the best\n"


def test_a_world_with_random_paths_is_evaluated_on_as_many_as_asked_for(room, tmp_path):
    (tmp_path / "open.yaml").write_text(ROOM.split("starts:")[0] + "starts: random\ngoals: random\n")
    arguments = ["--world", str(tmp_path / "open.yaml"), "--num-paths", "3", "--json", str(tmp_path / "result")]
    assert main(["evaluate", "random", *arguments]) == 0
    assert len(json.loads((tmp_path / "result").read_text())["paths"]) == 3


def test_a_report_is_written_anew(finished, capsys):
    (finished / "report.html").unlink()
    assert main(["report", str(finished)]) == 0
    assert capsys.readouterr().out.strip() == str(finished / "report.html")
    assert "</html>" in (finished / "report.html").read_text()


def test_rooms_are_generated_listed_and_drawn(tmp_path, capsys):
    arguments = ["world", "generate", "--kind", "blocks", "--size", "5,4", "--density", "0.08", "--count", "2"]
    assert main([*arguments, "--seed", "3", "--out", str(tmp_path / "rooms")]) == 0
    told = capsys.readouterr().out
    assert "blocks-0001" in told
    assert "blocks-0002" in told
    assert "difficulty" in told
    names = sorted(path.name for path in (tmp_path / "rooms").iterdir())
    assert names == ["blocks-0001.yaml", "blocks-0002.yaml", "overview.png"]
    assert (tmp_path / "rooms" / "overview.png").read_bytes()[1:4] == b"PNG"
    assert main([*arguments, "--seed", "3", "--out", str(tmp_path / "rooms")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main([*arguments[:-2], "--seed", "3", "--first", "2", "--no-overview", "--out", str(tmp_path / "one")]) == 0
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["blocks-0002.yaml"]
    same = [(tmp_path / place / "blocks-0002.yaml").read_bytes() for place in ("rooms", "one")]
    assert same[0] == same[1]


def test_the_oracle_checks_generated_rooms_on_request(tmp_path, capsys, monkeypatch):
    arguments = ["world", "generate", "--kind", "blocks", "--size", "3.4", "--density", "0.05", "--no-overview"]
    assert main([*arguments, "--solve", "--out", str(tmp_path / "rooms")]) == 0
    solved, paths = re.search(r"(\d+)/(\d+)", capsys.readouterr().out).groups()
    assert solved == paths
    monkeypatch.setattr("rl.baselines.Oracle.plan", lambda self, start, goal, phases: None)
    assert main([*arguments, "--solve", "--out", str(tmp_path / "more")]) == 2
    assert "blocks-0001: the oracle found no way from starts[0] to goals[0]" in capsys.readouterr().err
    assert (tmp_path / "more" / "blocks-0001.yaml").is_file()


def test_a_robot_is_trained_in_generated_rooms_and_evaluated_in_others(tmp_path, capsys):
    directory = tmp_path / "run"
    worlds = ["--world", "generate:blocks,size=4,density=0.06,count=3", "generate:forest,size=4,count=2"]
    evaluated = ["--eval-world", "generate:blocks,size=4,density=0.06,count=2"]
    assert main(["train", *worlds, *evaluated, "--out", str(directory), "--no-report", *SMALL]) == 0
    assert (directory / "policy.pt").is_file()
    rows = (directory / "evaluations.csv").read_text().splitlines()
    assert len(rows) == 3
    capsys.readouterr()
    arguments = ["evaluate", str(directory), "--world", evaluated[1], "--num-paths", "4"]
    assert main([*arguments, "--json", str(tmp_path / "result.json")]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["worlds"] == ["blocks-0001", "blocks-0002"]
    assert [path["world_index"] for path in result["paths"]] == [0, 0, 1, 1]
    assert main(["evaluate", "reactive", "--world", "generate:blocs"]) == 2
    assert capsys.readouterr().err == 'generate:blocs: "blocs" is not a kind of room; did you mean "blocks"?\n'


# Going on with a run


def test_a_directory_with_a_run_is_not_trained_over(finished, room, capsys):
    before = (finished / "metrics.csv").read_text()
    assert main(training(room, finished)) == 2
    assert "already holds a run" in told(capsys)
    assert (finished / "metrics.csv").read_text() == before


def test_a_finished_run_is_only_reported_again(finished, monkeypatch):
    reported = []
    monkeypatch.setattr("rl.finish.finish", lambda run, console: reported.append(run.directory))
    before = (finished / "metrics.csv").read_text()
    assert main(["train", "--resume", "--out", str(finished)]) == 0
    assert (finished / "metrics.csv").read_text() == before
    assert reported == [finished]


def test_what_is_only_to_be_reported_needs_no_room_to_train(finished, tmp_path, monkeypatch):
    copy = shutil.copytree(finished, tmp_path / "copy")
    shutil.rmtree(copy / "checkpoints")
    monkeypatch.setattr("rl.feasibility.available_memory", lambda: 0)
    monkeypatch.setattr("rl.finish.finish", lambda run, console: None)
    assert main(["train", "--resume", "--out", str(copy)]) == 0
    assert main(["train", "--resume", "--out", str(finished)]) == 2, "it has checkpoints to go on from"


def test_a_run_keeps_its_settings(finished, capsys):
    assert main(["train", "--resume", "--out", str(finished), "--gamma", "0.5", "--model", "S"]) == 2
    assert "begun with other settings (model, gamma)" in told(capsys)


def test_an_interrupted_run_says_how_to_go_on(room, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def interrupt() -> None:
        wait_for(lambda: any((tmp_path / "run" / "checkpoints").glob("*")), 200)
        os.kill(os.getpid(), signal.SIGINT)

    user = threading.Thread(target=interrupt)
    user.start()
    endless = [*training(room, Path("run")), "--total-steps", "1000000", "--no-report"]
    assert main(endless) == 130
    user.join()
    said = capsys.readouterr().err
    assert "navsim train --resume --out run" in said
    assert "Traceback" not in said


def test_resuming_goes_on_with_the_settings_that_a_run_was_begun_with(finished, monkeypatch):
    trained = []
    monkeypatch.setattr("rl.train.train", lambda config, **named: trained.append((config, named["resume"])))
    monkeypatch.setattr("rl.finish.finish", lambda run, console: None)
    assert main(["train", "--resume", "--out", str(finished), "--batch-size", "16"]) == 0
    ((config, resume),) = trained
    assert resume
    assert config == Run(finished).config


def test_resuming_begins_a_run_where_there_is_none(tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr("rl.train.train", lambda config, **named: trained.append((config, named["resume"])))
    assert main(["train", "--preset", "thesis", "--resume", "--no-report", "--out", str(tmp_path / "new")]) == 0
    assert trained == [(dataclasses.replace(PRESETS["thesis"], report=False, out=tmp_path / "new"), False)]


def wait_for(condition, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


# Worlds


def test_good_worlds_are_described(room, capsys):
    assert main(["world", "check", str(room), "complex_eval"]) == 0
    out = capsys.readouterr().out
    first, second = (line for line in out.splitlines() if not line.startswith(" "))
    assert first.startswith(f"{room}: ok")
    assert "1 obstacle, 1 start, 2 goals" in first
    assert "5 starts, 20 goals" in second
    assert "49 m², 11.3% covered by 18 boxes, 16 cylinders" in out
    assert "1.00 m at the narrowest between 'sofa' and 'carton B'" in out


def test_everything_that_is_wrong_with_worlds_is_told_with_its_place(room, tmp_path, capsys):
    bad = tmp_path / "bad.yaml"
    bad.write_text("format: 1\nsize: [4, -4]\nobstacles:\n  - box: {at: [0, 0], size: [1, 1], hight: 1}\n")
    assert main(["world", "check", str(bad), str(room), "missing.yaml"]) == 2
    stdout, stderr = capsys.readouterr()
    assert stdout.startswith(f"{room}: ")
    assert f"{bad}:2:" in stderr
    assert "obstacles[0].box" in stderr
    assert "missing.yaml" in stderr
    assert "Traceback" not in stderr


def test_warnings_fail_only_when_they_are_meant_to(tmp_path, capsys):
    odd = tmp_path / "odd.yaml"
    odd.write_text("format: 1\nsize: [4, 4]\nobstacles:\n  - box: {at: [2, 0], size: [1, 1], height: 1}\n")
    assert main(["world", "check", str(odd)]) == 0
    assert f"{odd}:4:5: warning: obstacles[0].box: reaches 0.5 m beyond the room" in capsys.readouterr().err
    assert main(["world", "check", "--strict", str(odd)]) == 1
    capsys.readouterr()
    assert main(["world", "check", "--json", str(odd)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert json.loads(out)[0]["findings"][0]["severity"] == "warning"


def test_the_schema_is_printed_or_written(tmp_path, capsys):
    assert main(["world", "schema"]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed)["$schema"].endswith("2020-12/schema")
    assert main(["world", "schema", "-o", str(tmp_path / "world.schema.json")]) == 0
    assert (tmp_path / "world.schema.json").read_text() == printed
    capsys.readouterr()
    assert main(["world", "schema", "--markdown"]) == 0
    assert "| `yaw_deg` | −360 to 360 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "picture"),
    [
        ([], "room.png"),
        (["-o", "plans/plan.svg"], "plans/plan.svg"),
        (["--camera", "-1,0.5,90", "--no-names"], "room.png"),
    ],
)
def test_a_world_is_drawn_where_it_says(room, tmp_path, monkeypatch, capsys, options, picture):
    monkeypatch.chdir(tmp_path)
    assert main(["world", "show", str(room), *options]) == 0
    assert capsys.readouterr().out.strip() == picture
    assert (tmp_path / picture).stat().st_size > 10_000


def test_the_picture_of_a_world_is_called_like_its_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hall.yaml").write_text("format: 1\nname: ../elsewhere/east\nsize: [3, 3]\n")
    assert main(["world", "show", "hall.yaml"]) == 0
    assert capsys.readouterr().out == "hall.png\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hall.png", "hall.yaml"]


# Benchmarks


@pytest.mark.parametrize(
    ("arguments", "module", "passed"),
    [
        (["camera", "--peers"], "navsim.bench_camera", {"peers": True}),
        (["sensor", "--world", "simple_eval"], "navsim.bench_sensor", {"world": "simple_eval"}),
        (["env", "--world", "simple_eval"], "rl.bench_env", {"world": "simple_eval"}),
        (["learner", "--num-threads", "2"], "rl.bench_learner", {"num_threads": 2}),
    ],
)
def test_a_benchmark_is_run(monkeypatch, arguments, module, passed):
    calls = []
    monkeypatch.setattr(f"{module}.run", lambda *positional, **named: calls.append(named))
    assert main(["bench", *arguments]) == 0
    (named,) = calls
    assert {key: named[key] for key in passed} == passed


# Help


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    asked = capsys.readouterr().out
    assert all(command in asked for command in ("train", "evaluate", "report", "world", "bench"))
    assert main([]) == 0
    assert capsys.readouterr().out == asked


def test_help_explains_every_setting_of_a_training(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["train", "--help"]) == 0
    text = re.sub(r"[\s│╭╰╮╯─]+", " ", capsys.readouterr().out)
    flags = ["resume"]
    parts = {"camera": DepthCamera, "task": Task, "robot": Robot, "sensor": SensorModel, "randomization": Randomization}
    for prefix, part in (("", TrainConfig), *((f"{name}.", part) for name, part in parts.items())):
        names = [setting.name for setting in dataclasses.fields(part) if setting.name not in parts]
        flags += [prefix + name.replace("_", "-") for name in names]
    for flag in flags:
        explained = re.search(rf"--{re.escape(flag)}[ ,](.*?)\(default: ", text)
        assert explained, flag
        assert re.search(r"[A-Z].+[.;] ?$", explained[1]), f"--{flag} is not explained: {explained[1]}"


def test_help_shows_the_values_of_the_preset(capsys):
    assert main(["train", "--preset", "thesis", "--help"]) == 0
    assert re.search(r"--batch-size INT[^(]*\(default:\s+8\)", capsys.readouterr().out)


def test_help_does_without_what_takes_long_to_import():
    code = "import sys; from rl.cli import main; main(['--help']); print({'torch', 'pydantic'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert done.stdout.splitlines()[-1] == "set()"


@pytest.mark.parametrize(("chosen", "spins"), [({}, SPINS), ({"OMP_WAIT_POLICY": "PASSIVE"}, "0")])
def test_threads_of_pytorch_do_not_wait_long_for_one_another_unless_told_otherwise(
    room, tmp_path, monkeypatch, chosen, spins
):
    for name in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY"):
        monkeypatch.delenv(name, raising=False)
    arguments = ["evaluate", "straight", "--world", str(room)]
    command = process(arguments, tmp_path, OMP_DISPLAY_ENV="verbose", **chosen)
    told = command.communicate()[1]
    if "GOMP_" not in told:
        pytest.skip("PyTorch's threads are not GNU's here, and do not tell how long they spin")
    assert f"GOMP_SPINCOUNT = '{spins}'" in told
    assert command.returncode == 0


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"navsim \S.*\n", capsys.readouterr().out)


def test_the_installed_command_is_this_one():
    try:
        scripts = metadata.distribution("navsim-rl").entry_points
    except metadata.PackageNotFoundError:
        pytest.skip("the package is not installed")
    assert scripts["navsim"].load() is main


# Mistakes


def told(capsys) -> str:
    """What was printed on standard error; a mistake prints nothing on standard output and no traceback."""
    stdout, stderr = capsys.readouterr()
    assert not stdout
    assert "Traceback" not in stderr
    return re.sub(r"[\s│]+", " ", stderr)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("trian", "Available subcommands: train, evaluate"),
        ("train --gama 0.9", "--gamma FLOAT"),
        ("train --model X", "--model"),
        ("train --preset fastest", "--preset"),
        ("train --preset", "--preset"),
        ("train --total-steps many", "--total-steps"),
        ("train --warmup-steps 3 --gamma 2", "--warmup-steps (3) must lie between"),
        ("train --camera.width 0", "camera width must be a whole number of pixels"),
        ("train --camera.vertical-fov-deg 120 --out run", "the camera sees the floor"),
        ("train --world complex_trian --out run", "did you mean 'complex_train'?"),
        ("train --eval-world nowhere --out run", "nowhere: there is no such world file"),
        ("evaluate random", "--world"),
        ("train --camera.pitch-deg 25 --out run", "tilt it up (pitch_deg)"),
        ("train --randomization.noise-level 0 2 --out run", "changes nothing without noise"),
        ("evaluate random --world complex_eval --randomized", "trained without randomization"),
        ("evaluate random --world complex_evl", "did you mean 'complex_eval'?"),
        ("evaluate randm --world complex_eval", 'did you mean "random"?'),
        ("evaluate random --world complex_eval --num-paths 101", "num_paths asks for 101"),
        ("report nowhere", "nowhere is not a run's directory"),
        ("world", "Expected one of {check"),
        ("world edit simple_train", "simple_train: is a shipped world; edit a copy"),
        ("world show simple_eval --camera 1,2", "'1,2' is not a place to look from; write three numbers x,y,yaw"),
        ("world show simple_eval --camera 1,2,inf", "is not a place to look from"),
        ("world show nowhere", "nowhere: there is no such world file"),
        ("world show simple_eval -o plan.docx", "plan.docx: pictures are written as"),
        ("bench env --world nowhere", "nowhere: there is no such world file"),
    ],
)
def test_a_mistake_is_told_in_a_sentence(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == 2
    assert sentence in told(capsys)
    assert not any(tmp_path.iterdir()), "a refused command leaves nothing behind"


def test_a_mistake_ends_the_process_with_status_2(tmp_path):
    refused = process(["world", "show", "complex_evil"], tmp_path)
    stdout, stderr = refused.communicate(timeout=200)
    assert (refused.returncode, stdout) == (2, "")
    assert stderr == "complex_evil: there is no such world file; did you mean 'complex_eval'?\n"


def test_a_file_that_cannot_be_written_is_named(room, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main(["world", "show", str(room), "-o", str(tmp_path / "file" / "plan.png")]) == 2
    assert str(tmp_path / "file") in told(capsys)


def test_damaged_files_of_a_run_are_named(room, tmp_path, capsys):
    directory = tmp_path / "run"
    assert main([*training(room, directory), "--no-report"]) == 0
    capsys.readouterr()
    (directory / "policy.pt").write_bytes(b"")
    assert main(["evaluate", str(directory), "--world", str(room)]) == 2
    assert "policy.pt is damaged" in told(capsys)
    checkpoints = sorted((directory / "checkpoints").iterdir())
    for checkpoint in checkpoints:
        (checkpoint / "SHA256SUMS").write_text("")
    assert main(["train", "--resume", "--out", str(directory)]) == 2
    problem = told(capsys)
    assert f"every checkpoint in {directory / 'checkpoints'} is damaged" in problem
    assert all(checkpoint.name in problem for checkpoint in checkpoints)


def test_a_mistake_of_the_library_keeps_its_traceback(monkeypatch, room):
    import numpy as np

    def broken(*_, **__):
        return np.zeros(3) + np.zeros(4)

    monkeypatch.setattr("navsim.show.save_plan_view", broken)
    with pytest.raises(ValueError, match="broadcast"):
        main(["world", "show", str(room)])


def test_ctrl_c_ends_with_status_130(monkeypatch, room, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("navsim.show.save_plan_view", interrupted)
    assert main(["world", "show", str(room)]) == 130
    assert told(capsys).strip() == "interrupted"


def test_a_policy_is_evaluated_with_another_sensor(tmp_path, capsys):
    reached = {}
    for sensor in ("ideal", "kinect", "kinect-filled"):
        told = tmp_path / f"{sensor}.json"
        arguments = ["evaluate", "pretrained:S", "--world", "complex_eval", "--num-paths", "12", "--json", str(told)]
        assert main([*arguments, "--sensor", sensor]) == 0
        reached[sensor] = json.loads(told.read_text())["summary"]["success_rate"]
    assert reached["kinect"] < 0.75 < 0.9 < reached["kinect-filled"]
    assert reached["ideal"] > 0.9
