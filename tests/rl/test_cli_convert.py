"""``navsim world import`` and ``export``: from another program's file to a trained robot; how mistakes are told."""

from __future__ import annotations

from pathlib import Path

import pytest

import navsim
import navsim.convert
import navsim.worldfile
from rl.cli import main

DATA = Path(__file__).parents[1] / "navsim" / "convert" / "data"
BRIEF = [
    *("--total-steps", "64", "--warmup-steps", "32", "--batch-size", "16", "--num-envs", "4"),
    *("--steps-per-batch", "32", "--eval-interval", "64", "--checkpoint-interval", "64", "--log-interval", "32"),
    *("--camera.width", "20", "--camera.height", "16", "--task.max-steps", "20"),
    *("--num-threads", "1", "--autocast", "float32", "--rearrangements", "0", "--no-report"),
]


def run(*arguments: object) -> int:
    return main(["world", *map(str, arguments)])


def test_a_gazebo_world_is_imported_and_trains(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    models = DATA / "models"
    places = ["--starts", -0.5, 1, "--goals", 4, 2]  # or else a hundred drawn paths would be driven
    assert run("import", DATA / "lab.world", "--model-path", models, "--approximate", "bounding-box", *places) == 0
    printed = capsys.readouterr().out
    assert "- 'island shade' is a sphere: its bounding box stands in its place" in printed
    assert printed.splitlines()[-1].startswith("lab.yaml: World('lab', 6 x 5 m")
    text = (tmp_path / "lab.yaml").read_text()
    assert text.startswith("# Imported from lab.world by 'navsim world import'.\n# - ")
    assert "# - 'island shade' is a sphere" in text
    assert navsim.load_world("lab.yaml").walls.height == 0.5
    assert (
        main(["train", "--world", "lab.yaml", "--eval-world", "lab.yaml", "--out", str(tmp_path / "run"), *BRIEF]) == 0
    )
    assert (tmp_path / "run" / "policy.pt").exists()


def test_settings_of_the_room_are_passed_on(tmp_path):
    target = tmp_path / "room.yaml"
    options = ["--starts", -0.5, 1, "--goals", 4, 1, 4, 5, "--size", 7, 6, "--open-floor"]
    assert run("import", DATA / "lab.world", "-o", target, "--model-path", DATA / "models", *options) == 0
    world = navsim.load_world(target)
    assert (world.size, world.walls) == ((7.0, 6.0), None)
    assert [start.at for start in world.starts] == [(-2.5, -2.0)]
    assert [goal.at for goal in world.goals] == [(2.0, -2.0), (2.0, 2.0)]


@pytest.mark.parametrize("suffix", [".sdf", ".world", ".xml", ".yaml"])
def test_worlds_are_exported_in_the_format_of_the_suffix(tmp_path, suffix, capsys):
    target = tmp_path / f"out{suffix}"
    assert run("export", "complex_eval", "-o", target) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[-1] == str(target)
    assert ("'table top' is not on the map" in "\n".join(printed)) == (suffix == ".yaml")
    if suffix != ".xml":
        assert run("import", target, "-o", tmp_path / "back.yaml") == 0
        assert navsim.load_world(tmp_path / "back.yaml").size == (7.0, 7.0)
    assert {path.name for path in tmp_path.iterdir()} <= {target.name, "out.pgm", "back.yaml"}


def test_the_format_of_a_file_is_told_by_its_content(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("import", DATA / "irsim.yaml", "--height", 1) == 0
    assert navsim.load_world("irsim.yaml").obstacles[0].height == 1.0
    assert run("import", "irsim.yaml") == 2
    assert "is a world file already" in capsys.readouterr().err


def test_what_is_imported_by_default_replaces_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    navsim.convert.save_ros_map(navsim.load_world("simple_eval"), "map.yaml")
    before = Path("map.yaml").read_text()
    assert run("import", "map.yaml") == 0
    assert Path("map.yaml").read_text() == before
    assert navsim.load_world("map_world.yaml").size == (7.0, 7.0)
    assert run("import", "map.yaml") == 2
    assert "exists already; name the file to write with -o" in capsys.readouterr().err


def test_nothing_is_written_over_what_is_read(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("room.yaml").write_text(navsim.worldfile.dump_world(navsim.load_world("simple_eval")))
    navsim.convert.save_ros_map(navsim.load_world("simple_eval"), "map.yaml")
    Path("link.yaml").symlink_to("room.yaml")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for arguments in (
        ["export", "room.yaml", "-o", tmp_path / "room.yaml"],
        ["export", "room.yaml", "-o", "link.yaml"],
        ["import", "map.yaml", "-o", "map.yaml"],
    ):
        assert run(*arguments) == 2
        message = capsys.readouterr().err
        assert message == f"{arguments[-1]}: is the file that is read; name another one to write with -o\n"
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["schema"], "world.json"),
        (["export", "simple_eval"], "room.sdf"),
        (["export", "simple_eval"], "room.yaml"),
        (["import", DATA / "irsim.yaml"], "room.yaml"),
    ],
)
def test_directories_are_made(arguments, name, tmp_path):
    target = tmp_path / "new" / "rooms" / name
    assert run(*arguments, "-o", target) == 0
    assert target.is_file()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["import", "none.sdf"], "none.sdf: cannot be read"),
        (["import", DATA / "lab.world", "--unknown", "free"], "unknown is not a setting of the format sdf"),
        (["import", DATA / "irsim.yaml", "--approximate", "convex-hull"], "not a setting of the format ir-sim"),
        (["import", DATA / "irsim.yaml", "--height", "-1"], "height must be greater than 0, in metres; got -1"),
        (["import", DATA / "irsim.yaml", "--format", "sdf"], "not XML"),
        (["import", DATA / "lab.world", "--format", "ros-map"], "is XML, and so no file of the format ros-map"),
        (["import", DATA / "irsim.yaml", "--margin", "2"], "says how large its room is; give a size"),
        (["export", "complex_eval", "-o", Path(__file__) / "a" / "room.sdf"], "is a file where a directory is needed"),
        (["import", DATA / "lab.world", "--margin", "nan"], "room margin must be finite"),
        (["import", DATA / "models" / "crate" / "pyramid.png"], "name the map.yaml"),
        (["export", "complex_eval", "-o", "room.obj"], "the suffix says no format"),
        (["export", "complex_evl", "-o", "room.sdf"], "did you mean 'complex_eval'?"),
        (["export", "complex_eval", "-o", "room.sdf", "--resolution", "0.1"], "settings of ROS maps"),
        (["schema", "-o", "."], ".: Is a directory"),
    ],
)
def test_mistakes_are_told_in_a_sentence(arguments, part, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    message = capsys.readouterr().err.strip()
    assert part in message
    assert len(message.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
