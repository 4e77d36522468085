"""Failures explained: rooms in which it is known what a robot runs into, and whether it has seen it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.patches import Circle
from rich.console import Console
from tensordict import TensorDict

import rl.failures
from navsim.camera import DepthCamera
from navsim.robot import Robot
from navsim.task import Task
from navsim.world import World
from navsim.worldfile import save_world
from navsim.worldsource import worlds_from
from rl.evaluation import evaluate
from rl.failures import KINDS, _in_view, draw_failures, explain, write_failures
from rl.metrics import PathResult

CAMERA = DepthCamera()
LEFT, STRAIGHT = 2, 4


def room(*boxes: dict) -> World:
    return World.from_dict(
        {
            "format": 1,
            "size": [7, 7],
            "obstacles": [{"box": box} for box in boxes],
            "starts": [{"at": [-2.0, 0.0], "yaw_deg": 0}],
            "goals": [[2.5, 2.5]],
        }
    )


def driven(world: World, actions: list[int], task: Task | None = None, seed: int = 0) -> PathResult:
    """What becomes of a robot that takes these actions, and then goes on."""

    def policy(state: TensorDict) -> TensorDict:
        step = len(taken)
        taken.append(actions[min(step, len(actions) - 1)])
        state["action"] = np.full(len(state), taken[-1])
        return state

    taken: list[int] = []
    return evaluate(policy, world, camera=CAMERA, task=task, seed=seed).paths[0]


def test_what_was_ahead_all_the_time_was_seen():
    world = room({"at": [0.5, 0.0], "size": [0.3, 1.0], "height": 1.0})
    failure = explain(driven(world, [STRAIGHT]), world, CAMERA)
    assert failure.kind == "ahead"
    assert (failure.seen, failure.ago) == (4, 1)
    assert failure.at[0] == pytest.approx(0.35, abs=0.02)  # the box's near face
    assert abs(failure.at[1]) < 0.4


def test_what_a_robot_turns_into_was_unseen():
    """It drives past a pillar on its left and turns left: the pillar enters the image at its edge, too near."""
    world = room({"at": [-0.45, 0.45], "size": [0.2, 0.2], "height": 1.0})
    turning_at = (driven(world, [STRAIGHT] * step + [LEFT]) for step in range(25, 40))
    failures = [explain(path, world, CAMERA) for path in turning_at if path.too_near]
    failure = next(failure for failure in failures if failure.kind == "unseen")
    assert failure.seen == 0
    assert 4 < failure.ago < 20  # it left the view 30° to the side, and there is a turn between then and now
    np.testing.assert_allclose(failure.at, (-0.45, 0.45), atol=0.25)


def test_a_touch_beside_the_camera_s_view_and_a_timeout_are_their_own_kinds():
    grazing = room({"at": [-1.0, 0.22], "size": [0.3, 0.2], "height": 1.0})
    touched = driven(grazing, [STRAIGHT], Task(collision_depth=0.0))
    assert explain(touched, grazing, CAMERA).kind == "touched"
    slow = driven(room(), [STRAIGHT], Task(max_steps=3))
    assert explain(slow, room(), CAMERA) == (slow, "timeout", None, 0, None)


def test_images_further_apart_reach_further_back():
    """What has left the view more than four steps ago is in the images of a stack that reaches twelve steps back."""
    world = room({"at": [-0.45, 0.45], "size": [0.2, 0.2], "height": 1.0})
    paths = [driven(world, [STRAIGHT] * begin + [LEFT]) for begin in range(20, 45)]
    paths = [path for path in paths if path.too_near]
    seen = [[explain(path, world, CAMERA, interval).seen for path in paths] for interval in (1, 4)]
    assert any(later > soon == 0 for soon, later in zip(*seen, strict=True))


def test_the_page_counts_every_failure_and_explains_its_kind(tmp_path):
    world = room({"at": [0.0, 0.0], "size": [0.3, 3.0], "height": 1.0})
    save_world(world, tmp_path / "wall.yaml")
    page, picture = tmp_path / "docs" / "failures.md", tmp_path / "docs" / "images" / "failures.png"
    page.parent.mkdir()
    write_failures("straight", str(tmp_path / "wall.yaml"), page, picture, console=Console(quiet=True))
    text = page.read_text(encoding="utf-8")
    assert "0 of 1 goals reached" in text
    (row,) = [line for line in text.splitlines() if line.startswith("| ") and "paths" not in line]
    kind = row.split("|")[1].strip()
    assert row == f"| {kind} | 1 | 0.2 | {KINDS[kind]} |"
    assert "![the ends of the failed paths](images/failures.png)" in text
    assert picture.stat().st_size > 3_000


def test_the_page_of_some_paths_in_several_rooms_tells_how_to_see_them_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one", "other"):
        save_world(room({"at": [0.5, 0.0], "size": [0.3, 6.0], "height": 1.0}).replace(name=name), f"{name}.yaml")
    drawn = []
    monkeypatch.setattr(rl.failures, "save_figure", lambda figure, path: drawn.append(figure))
    monkeypatch.setattr(rl.failures, "worlds_from", lambda world: worlds_from(["one.yaml", "other.yaml"]))
    write_failures("straight", "rooms", tmp_path / "page.md", tmp_path / "page.png", num_paths=2)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert text.endswith("Made by `python scripts/failures.py straight --world rooms --num-paths 2`.\n")
    assert [axes.get_title().split("\n")[1].split(",")[0] for axes in drawn[0].axes] == ["one", "other"]


def test_a_policy_without_failures_has_a_page_without_a_picture(tmp_path):
    save_world(room(), tmp_path / "open.yaml")
    write_failures("straight", str(tmp_path / "open.yaml"), tmp_path / "page.md", tmp_path / "page.png")
    assert "1 of 1 goals reached" in (tmp_path / "page.md").read_text(encoding="utf-8")
    assert not (tmp_path / "page.png").exists()


def test_the_view_is_sixty_degrees_wide():
    """A thing at the same distance, just inside the edge of the view and just outside of it."""
    for angle, expected in ((27.0, 4), (40.0, 0)):
        bearing = math.radians(angle)
        at = [-2.0 + 1.2 * math.cos(bearing), 1.2 * math.sin(bearing)]
        world = room({"at": at, "size": [0.1, 0.1], "height": 1.0})
        seen = _in_view(np.array(at) - 0.05, np.array([[-2.0, 0.0, 0.0]] * 4), world, CAMERA)
        assert int(seen.sum()) == expected


def test_what_a_tilted_camera_sees_is_where_it_is():
    world = room({"at": [0.5, 0.0], "size": [0.3, 1.0], "height": 1.0})
    camera = DepthCamera(pitch_deg=-20.0)
    x = np.linspace(-1.0, -0.12, 12)  # straight towards the box's face at 0.35, by the depth rule's end
    poses = np.column_stack([x, np.zeros((12, 2))])
    path = PathResult(0, 0, (2.5, 2.5), "collision", 0.0, 3.0, poses, np.full(11, STRAIGHT), too_near=True)
    failure = explain(path, world, camera)
    assert failure.at[0] == pytest.approx(0.35, abs=1e-3)
    assert (failure.seen, failure.ago) == (4, 1)
    far = np.array([[-2.5, 0.0, 0.0]])
    assert _in_view(np.array([0.35, 0.0]), far, world, camera).all()
    assert not _in_view(np.array([0.15, 0.0]), far, world, camera).any()


def test_what_had_moved_into_the_way_is_where_it_was_at_the_end():
    motion = {"path": [[0.5, 2.0], [0.5, -2.0]], "speed": 0.3}
    world = room({"at": [0.5, 2.0], "size": [0.3, 1.0], "height": 1.0, "motion": motion})
    paths = [driven(world, [STRAIGHT], seed=seed) for seed in range(6)]
    near = [path for path in paths if path.too_near and path.trajectory[-1, 0] < 0.4]  # and not at the wall behind
    assert near
    for path in near:
        failure = explain(path, world, CAMERA)
        there = path.obstacle_poses(world, Task())[-1, 0]
        x, y = np.array(failure.at) - there[:2]
        assert max(abs(x) - 0.15, abs(y) - 0.5) == pytest.approx(0.0, abs=0.02)  # on the box's side
        assert failure.at[0] - path.trajectory[-1, 0] < 0.42


def test_the_robot_and_its_view_are_drawn_as_they_are():
    world = room({"at": [0.5, 0.0], "size": [0.3, 1.0], "height": 1.0})
    failure = explain(driven(world, [STRAIGHT]), world, CAMERA)
    camera, robot = DepthCamera(horizontal_fov_deg=90.0, mount_x=0.1), Robot(radius=0.25)
    (axes,) = draw_failures([failure], [world], camera, robot).axes
    x, y, yaw = failure.path.trajectory[-1]
    (body,) = [patch for patch in axes.patches if isinstance(patch, Circle) and patch.center == (x, y)]
    assert body.radius == 0.25
    edges = [line.get_xydata() for line in axes.lines if len(line.get_xdata()) == 2 and line.get_color() == "#2b6cb0"]
    eye = (x + 0.1 * math.cos(yaw), y + 0.1 * math.sin(yaw))
    assert sorted(round(math.degrees(math.atan2(*(to - begin)[::-1]) - yaw)) for begin, to in edges) == [-45, 45]
    np.testing.assert_allclose([edge[0] for edge in edges], [eye, eye])


def test_a_picture_that_cannot_be_written_is_refused_before_anything_is_driven(tmp_path):
    with pytest.raises(ValueError, match=r"a\.xyz: pictures are written as \.png"):
        write_failures("straight", "simple_eval", tmp_path / "page.md", tmp_path / "a.xyz")
    (tmp_path / "dir.png").mkdir()
    with pytest.raises(ValueError, match="is a directory; name the picture's file"):
        write_failures("straight", "simple_eval", tmp_path / "page.md", tmp_path / "dir.png")
    assert not (tmp_path / "page.md").exists()
