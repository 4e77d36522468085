"""What is refused before a run begins, because it cannot be done here."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from navsim.camera import DepthCamera
from navsim.robot import Robot
from rl import feasibility
from rl.cli import main
from rl.config import LEAST_HEIGHT, LEAST_WIDTH, PRESETS, ConfigError, TrainConfig
from rl.networks import D3QN
from rl.train import train

MEMORYLESS = PRESETS["memoryless"]
GIB = 2**30


def obstacles(**settings) -> list[str]:
    return list(feasibility.obstacles(replace(MEMORYLESS, **settings)))


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("preset", PRESETS)
def test_the_presets_can_be_done(preset):
    feasibility.check_feasible(PRESETS[preset])


def test_worlds_that_are_not_there_are_named():
    missing, misspelt = obstacles(world=("complex_train", "rom.yaml"), eval_world="complex_evil")
    assert missing.startswith("rom.yaml: there is no such world file; name a file or one of the shipped worlds")
    assert misspelt == "complex_evil: there is no such world file; did you mean 'complex_eval'?"


def test_a_run_that_exceeds_the_memory_is_refused_with_both_numbers():
    problem = obstacles(replay_capacity=10**9, total_steps=10**9)[0]
    assert "the run takes about " in problem
    assert "GiB of memory, most of it for --replay-capacity (1000000000) images of 80x64 pixels" in problem
    assert "GiB are available; lower it, or make the images smaller" in problem


def test_memory_that_just_suffices_is_enough(tmp_path, monkeypatch):
    needed = feasibility.memory_needed(MEMORYLESS)
    monkeypatch.setattr(feasibility, "available_memory", lambda: needed)
    assert obstacles() == []
    monkeypatch.setattr(feasibility, "available_memory", lambda: needed - 1)
    assert len(obstacles()) == 1
    (tmp_path / "run" / "checkpoints" / "checkpoint-1").mkdir(parents=True)
    (problem,) = obstacles(out=tmp_path / "run")
    assert problem.endswith("GiB are available; end other programs"), "a run that goes on has the settings it has"
    monkeypatch.setattr(feasibility, "available_memory", lambda: None)  # a system that does not say
    assert obstacles() == []


# Greatest resident sizes, measured with `fast`'s settings but for these; docs/reliability.md has the table.
@pytest.mark.parametrize(
    ("camera", "capacity", "measured"),
    [((20, 12), 5_000, 0.439), ((80, 64), 20_000, 0.618), ((160, 128), 20_000, 1.109)],
)
def test_the_estimate_of_memory_is_a_little_above_what_was_measured(camera, capacity, measured):
    config = replace(MEMORYLESS, camera=DepthCamera(*camera), replay_capacity=capacity, num_envs=64)
    assert measured < feasibility.memory_needed(config) / GIB < 1.35 * measured


def test_images_far_apart_take_the_memory_of_those_between_them():
    """Greatest resident sizes of an evaluation of 100 robots: 0.40 GiB with neighbours, 1.83 GiB with 499 between."""
    near, far = (feasibility.memory_needed(replace(MEMORYLESS, frame_interval=interval)) for interval in (1, 500))
    assert 1.83 - 0.40 < (far - near) / GIB < 1.35 * (1.83 - 0.40)


def test_an_asynchronous_collector_takes_a_second_process():
    more = feasibility.memory_needed(replace(MEMORYLESS, collector="async")) - feasibility.memory_needed(MEMORYLESS)
    assert 0.4 * GIB < more < 0.8 * GIB


def test_a_control_group_limits_the_memory(tmp_path):
    own = tmp_path / "groups" / "slice" / "job"
    own.mkdir(parents=True)
    (own / "memory.max").write_text("max\n")
    for name, content in {"max": "3000", "current": "2500", "stat": "anon 2000\ninactive_file 400\n"}.items():
        (own.parent / f"memory.{name}").write_text(content)
    process = tmp_path / "cgroup"
    process.write_text("0::/slice/job\n")
    assert list(feasibility._left_in_groups(tmp_path / "groups", process)) == [900]


def test_a_control_group_of_the_first_version_limits_the_memory(tmp_path):
    group = tmp_path / "groups" / "memory"
    group.mkdir(parents=True)
    (group / "memory.limit_in_bytes").write_text("3000")
    (group / "memory.usage_in_bytes").write_text("2900")
    (group / "memory.stat").write_text("total_inactive_file 0\n")
    process = tmp_path / "cgroup"
    process.write_text("5:devices:/x\n4:cpu,memory:/the/host/calls/it/so\n")
    assert list(feasibility._left_in_groups(tmp_path / "groups", process)) == [100]


def test_a_disk_without_room_for_the_checkpoints_is_refused(tmp_path, monkeypatch):
    size = feasibility.checkpoint_size(MEMORYLESS)

    def free(count: int):
        return lambda place: SimpleNamespace(free=count)

    monkeypatch.setattr("rl.feasibility.shutil.disk_usage", free(4 * size))
    assert obstacles(out=tmp_path / "run") == []
    monkeypatch.setattr("rl.feasibility.shutil.disk_usage", free(4 * size - 1))
    (problem,) = obstacles(out=tmp_path / "run")
    assert problem.startswith(f"{tmp_path} has 2.31 GiB of free disk")
    assert "(3 are kept while another one is written, of 0.58 GiB each) still take 2.31 GiB; make room, " in problem
    for step in (1, 2, 3):  # a resumed run has most of them already
        (tmp_path / "run" / "checkpoints" / f"checkpoint-{step}").mkdir(parents=True)
    monkeypatch.setattr("rl.feasibility.shutil.disk_usage", free(size))
    assert obstacles(out=tmp_path / "run") == []
    monkeypatch.setattr("rl.feasibility.shutil.disk_usage", free(size - 1))
    (problem,) = obstacles(out=tmp_path / "run")
    assert problem.endswith("still take 0.58 GiB; make room"), "its settings are what they are"


def test_a_directory_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    (problem,) = obstacles(out=tmp_path / "file" / "run")
    assert problem.startswith(f"{tmp_path / 'file'} is a file, so {tmp_path / 'file' / 'run'} cannot be a run's")
    monkeypatch.setattr("rl.feasibility.os.access", lambda path, mode: False)  # root may write anywhere
    (problem,) = obstacles(out=tmp_path / "run")
    assert problem.startswith(f"{tmp_path} is not writable, so {tmp_path / 'run'} cannot be a run's directory")


def test_images_smaller_than_the_first_kernel_are_refused():
    D3QN(height=LEAST_HEIGHT, width=LEAST_WIDTH)
    with pytest.raises(ConfigError, match=r"--camera.width \(13\) and --camera.height \(10\) must be at least 14 and"):
        TrainConfig(camera=DepthCamera(width=LEAST_WIDTH - 1, height=LEAST_HEIGHT))
    with pytest.raises(ConfigError, match=r"--camera.height \(9\)"):
        TrainConfig(camera=DepthCamera(width=LEAST_WIDTH, height=LEAST_HEIGHT - 1))


def test_training_refuses_before_anything_is_written(tmp_path):
    with pytest.raises(ConfigError, match="complex_evil: there is no such world file"):
        train(replace(MEMORYLESS, eval_world="complex_evil", out=tmp_path / "run"))
    assert not any(tmp_path.iterdir())


def test_all_problems_are_told_together(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    (tmp_path / "file").touch()
    arguments = ["train", "--batch-size", "500", "--replay-capacity", "400", "--camera.height", "8", "--gamma", "2"]
    arguments += ["--eval-world", "complex_evil", "--out", str(tmp_path / "file" / "run"), "--device", "cuda"]
    arguments += ["--task.goal-radius", "-1", "--sensor.latency", "-1"]
    assert main(arguments) == 2
    problems = capsys.readouterr().err.splitlines()
    for told in (
        "--batch-size (500) must not exceed --replay-capacity (400)",
        "--warmup-steps (5000) must lie between",
        "--gamma must lie between 0 and 1; got 2.0",
        "--camera.height (8) must be at least",
        "complex_evil: there is no such world file",
        f"{tmp_path / 'file'} is a file",
        "--device cuda: PyTorch finds no such device here",
        "task goal_radius must be a positive finite number; got -1.0",
        "sensor latency must be",
    ):
        assert sum(told in problem for problem in problems) == 1, told
    assert len(problems) == 9


def test_settings_without_sense_are_told_as_such(tmp_path, capsys):
    arguments = ["--replay-capacity", "-1", "--num-envs", "0", "--atoms", "-3", "--out", str(tmp_path / "run")]
    assert main(["train", *arguments]) == 2
    told = capsys.readouterr().err
    for sentence in ("--replay-capacity must be positive; got -1", "--num-envs must be positive", "--atoms must be"):
        assert sentence in told
    assert "GiB" not in told


def test_listed_paths_that_the_margin_closes_are_refused_before_training(tmp_path):
    path = tmp_path / "gap.yaml"
    path.write_text(
        """
        format: 1
        size: [6, 4]
        obstacles:
          - box: {at: [0, 1.125], size: [0.2, 1.75], height: 1}
          - box: {at: [0, -1.125], size: [0.2, 1.75], height: 1}
        starts: [{at: [-2, 0], yaw_deg: 0}]
        goals: [[2, 0]]
        """
    )
    assert obstacles(world=(str(path),)) == [], "paths are drawn"
    (told,) = obstacles(world=(str(path),), random_paths=False, rearrangements=0)
    assert told == (
        f"{path}: no way from starts[0] to goals[0] is wide and high enough for this robot (--robot.radius 0.1755, "
        "--robot.height 0.42, --margin 0.1); lower the margin, or draw paths (--random-paths), or choose another room "
        "(--world)"
    )
    assert obstacles(world=(str(path),), random_paths=False, rearrangements=0, margin=0.0) == []


def test_a_room_that_is_too_narrow_for_the_robot_is_refused_before_training(tmp_path):
    path = tmp_path / "gap.yaml"
    walls = "{box: {at: [0, 1.75], size: [0.1, 3], height: 1}}, {box: {at: [0, -1.75], size: [0.1, 3], height: 1}}"
    places = "starts: [[-2, 0]]\ngoals: [[-2, 2], [2, 0]]"
    path.write_text(f"format: 1\nsize: [7, 6.5]\nobstacles: [{walls}]\n{places}\n")
    (told,) = obstacles(eval_world=str(path), robot=Robot(radius=0.3))
    assert told.startswith(f"{path}: no way from starts[0] to goals[1] is wide and high enough for this robot")
    assert "--robot.radius 0.3" in told
    assert obstacles(eval_world=str(path), robot=Robot(radius=0.2)) == []


def test_listed_starts_at_which_the_margin_ends_every_episode_are_refused(tmp_path):
    room = tmp_path / "room.yaml"
    text = "format: 1\nname: room\nsize: [6, 6]\ngoals: [[-2, -2]]\nstarts:\n  - {at: [2.6, 0], yaw_deg: 0}\n"
    room.write_text(text)
    settings = {"world": (str(room),), "random_paths": False, "rearrangements": 0}
    assert obstacles(**settings, margin=0.0) == []
    (problem,) = obstacles(**settings, margin=0.1)
    assert problem.startswith(f"{room}: starts[0]: facing 0°, the robot sees something 0.49 m away")
    assert problem.endswith("turn or move it, lower --margin (0.1), or draw paths (--random-paths)")
    assert obstacles(**{**settings, "random_paths": True}, margin=0.1) == []
    room.write_text(text + "  - {at: [0, 0], yaw_deg: 0}\n")  # episodes begin at the other one
    assert obstacles(**settings, margin=0.1) == []
