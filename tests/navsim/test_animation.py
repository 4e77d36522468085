"""The animation of an episode: its frames, and what moves in them."""

from __future__ import annotations

import math

import imageio.v3 as imageio
import numpy as np
import pytest
import shapely
from matplotlib.colors import to_rgb

from navsim.animation import _REMEMBERED, _arcs, animate_episode
from navsim.camera import DepthCamera
from navsim.draw import GOAL, OUTCOME_COLOURS, ROBOT, VIEW
from navsim.plan import views_of
from navsim.raycast import render_depth
from navsim.task import Task
from navsim.world import World

WORLD = World.from_dict(
    {
        "format": 1,
        "size": [6, 6],
        "obstacles": [{"box": {"at": [0.0, 1.5], "size": [0.6, 0.6], "height": 0.8}}],
        "starts": [[-2, 0]],
        "goals": [[2, 0]],
    }
)
DRIVE = np.stack([np.linspace(-2, 1.6, 10), np.zeros(10), np.zeros(10)], axis=1)
PLAN = (slice(10, 510), slice(10, 512))  # rows and columns of the plan view


def pixels(image, colour, tolerance=30):
    distance = np.abs(image.astype(int) - (255 * np.array(to_rgb(colour))).round().astype(int)).max(axis=-1)
    return np.argwhere(distance < tolerance)


@pytest.fixture(scope="module", params=[".gif", ".mp4"])
def film(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "made" / f"episode{request.param}"
    animate_episode(path, WORLD, DRIVE, (2.0, 0.0), actions=[1] * 9, outcome="success")
    return path


def test_an_animation_has_a_frame_for_each_pose_and_rests_on_the_last(film):
    frames = imageio.imread(film)
    assert frames.shape[1:] == (520, 960, 3)
    if film.suffix == ".mp4":
        assert len(frames) == 10 + 10  # twice real time: ten frames a second, the last for one more
    else:
        assert len(frames) == 10  # a GIF stores a rest as a duration
        durations = [imageio.immeta(film, index=index)["duration"] for index in (0, 9)]
        assert durations == [100, 1100]


def test_the_robot_drives_across_the_plan(film):
    frames = imageio.imread(film)
    columns = [pixels(frame[PLAN], ROBOT)[:, 1].mean() for frame in frames[:10]]
    steps = np.diff(columns)
    metre = 500 / 6.2  # the room with its walls fills the plan view
    np.testing.assert_allclose(steps, 0.4 * metre, atol=2.5)
    rows = pixels(frames[5][PLAN], ROBOT)[:, 0]
    assert rows.mean() == pytest.approx(250, abs=4)


def test_the_goal_and_at_the_end_the_outcome_are_shown(film):
    frames = imageio.imread(film)
    assert len(pixels(frames[0][PLAN], GOAL)) > 20
    verdict = (slice(460, 500), slice(700, 900))
    assert len(pixels(frames[-1][verdict], OUTCOME_COLOURS["success"], 60)) > 50
    assert len(pixels(frames[3][verdict], OUTCOME_COLOURS["success"], 60)) == 0


def test_the_depth_image_changes_as_the_robot_approaches_the_wall(film):
    frames = imageio.imread(film)
    sight = (slice(60, 300), slice(560, 860))
    assert frames[0][sight].astype(int).sum() < frames[9][sight].astype(int).sum()  # nearer is brighter


def test_the_view_ends_at_the_obstacles():
    camera = DepthCamera()
    pose = np.array([[0.5, 0.0, math.pi / 2]])
    eye, *outline = views_of(camera.to_uint8(render_depth(WORLD, pose, camera)), pose, camera)[0]
    np.testing.assert_allclose(eye, [0.5, -0.087], atol=1e-9)  # the camera is behind the robot's centre
    solid = shapely.union(shapely.box(-3, -3, 3, 3).exterior, shapely.box(-0.3, 1.2, 0.3, 1.8))
    for point, slope in zip(outline, camera.column_slopes, strict=True):
        ray = shapely.LineString([eye, eye + 9.0 * np.array([-slope, 1.0])])
        nearest = shapely.shortest_line(shapely.Point(eye), shapely.intersection(ray, solid)).coords[1]
        np.testing.assert_allclose(point, nearest, atol=0.015)


def test_the_task_sets_the_pace_and_the_goal_disc(tmp_path):
    path = tmp_path / "episode.gif"
    animate_episode(path, WORLD, DRIVE[:3], (2.0, 0.0), task=Task(control_period=0.5, goal_radius=1.0), speed=1.0)
    assert imageio.immeta(path, index=0)["duration"] == 500


def test_q_values_are_bars_and_the_greatest_is_in_colour(tmp_path):
    values = np.zeros((9, 7))
    values[:5, 1], values[5:, 6] = 1.0, 1.0
    path = animate_episode(tmp_path / "episode.gif", WORLD, DRIVE, (2.0, 0.0), q_values=values)
    frames = imageio.imread(path)
    bars = (slice(270, 348), slice(540, 942))
    for frame, action in ((frames[0], 1), (frames[6], 6)):
        columns = pixels(frame[bars], OUTCOME_COLOURS["success"])[:, 1]
        assert columns.mean() / 402 == pytest.approx((action + 0.7) / 7.4, abs=0.03)


def test_q_values_that_do_not_belong_to_the_poses_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"Q-values of shape \(10, 7\) do not belong to 10 poses: give \(9, 7\)"):
        animate_episode(tmp_path / "episode.gif", WORLD, DRIVE, (2.0, 0.0), q_values=np.zeros((10, 7)))


def test_the_images_that_the_robot_was_shown_are_in_the_film(tmp_path):
    camera, poses = DepthCamera(width=20, height=12), DRIVE[[*range(9), 8]]  # it ends where it was
    ideal = camera.to_uint8(camera.from_planar(render_depth(WORLD, poses[:9], camera)))
    others = np.full((9, 12, 20), 255, dtype=np.uint8)
    others[4:, :, :10] = 20  # near, on the left
    films = [
        imageio.imread(animate_episode(tmp_path / name, WORLD, poses, (2.0, 0.0), camera=camera, images=images))
        for name, images in {"a.gif": None, "b.gif": ideal, "c.gif": others}.items()
    ]
    by_default, same, other = films
    np.testing.assert_array_equal(by_default, same)
    left, right = other[:, 60:300, 570:710].astype(int), other[:, 60:300, 740:880].astype(int)
    differs = np.abs(left.mean((1, 2)) - right.mean((1, 2))).max(axis=1) > 60
    assert differs.tolist() == [False] * 4 + [True] * 6, "the last image stays"
    in_view = 0.3 * np.array(to_rgb(VIEW)) + 0.7
    of_other, of_ideal = (len(pixels(film[6][PLAN], in_view, 12)) for film in (other, same))
    assert of_other == pytest.approx(of_ideal, rel=0.05), "what is in view does not depend on what was shown of it"
    assert of_ideal > 3000


@pytest.mark.parametrize(
    "images",
    [np.zeros((10, 64, 80), np.uint8), np.zeros((9, 80, 64), np.uint8), np.zeros((9, 64, 80))],
    ids=["one-too-many", "another-size", "metres"],
)
def test_images_that_do_not_belong_to_the_poses_are_refused(tmp_path, images):
    with pytest.raises(ValueError, match=r"do not belong to 10 poses: give uint8 \(9, 64, 80\)"):
        animate_episode(tmp_path / "episode.gif", WORLD, DRIVE, (2.0, 0.0), images=images)


@pytest.mark.parametrize(
    ("name", "poses", "message"),
    [
        ("episode.avi", DRIVE, r"episode\.avi: animations are written as \.gif or \.mp4"),
        ("episode.gif", DRIVE[:, :2], r"poses of shape \(10, 2\)"),
        ("episode.gif", DRIVE[:0], r"poses of shape \(0, 3\)"),
    ],
)
def test_an_animation_that_cannot_be_made_says_why(tmp_path, name, poses, message):
    with pytest.raises(ValueError, match=message):
        animate_episode(tmp_path / name, WORLD, poses, (2.0, 0.0))


def test_what_is_remembered_is_drawn_where_it_is():
    distances = np.full(36, np.inf)
    distances[[9, 18]] = 0.5, 1.0  # to the right, and ahead
    x, y = _arcs(distances, np.array([1.0, 2.0, math.pi / 2]))  # facing up the plan
    np.testing.assert_allclose(np.hypot(x - 1.0, y - 2.0)[np.isfinite(x)], np.repeat([0.5, 1.0], 5))
    bearings = np.degrees(np.arctan2(y - 2.0, x - 1.0))[np.isfinite(x)]
    np.testing.assert_allclose(bearings, [*np.linspace(0, 10, 5), *np.linspace(90, 100, 5)], atol=1e-9)


def test_a_film_shows_what_is_remembered(tmp_path):
    remembered = np.where(np.arange(36) == 27, 0.8, np.inf)[None].repeat(9, axis=0)
    with_memory, without = tmp_path / "a.gif", tmp_path / "b.gif"
    animate_episode(with_memory, WORLD, DRIVE, (2.0, 0.0), remembered=remembered)
    animate_episode(without, WORLD, DRIVE, (2.0, 0.0))
    first, last = imageio.imread(with_memory)[[0, 8]]
    drawn = [pixels(frame[PLAN], _REMEMBERED, 60) for frame in (first, last)]
    metre = 500 / 6.2
    for found, robot in zip(drawn, (-2.0, DRIVE[8, 0]), strict=True):
        assert len(found) > 10
        assert np.median(found[:, 0]) == pytest.approx(250 - 0.8 * metre, abs=4)  # to the left of a robot driving right
        assert np.median(found[:, 1]) == pytest.approx(250 + robot * metre, abs=8)
    assert len(pixels(imageio.imread(without)[0], _REMEMBERED, 60)) == 0


@pytest.mark.parametrize("shape", [(10, 36), (8, 36), (9,)])
def test_a_memory_of_another_shape_is_refused(tmp_path, shape):
    with pytest.raises(ValueError, match="what is remembered, of shape"):
        animate_episode(tmp_path / "a.gif", WORLD, DRIVE, (2.0, 0.0), remembered=np.ones(shape))


@pytest.mark.parametrize("speed", [7.0, 30.0])
def test_a_gif_lasts_as_long_as_its_speed_says_and_no_frame_is_too_short_for_browsers(tmp_path, speed):
    drive = np.stack([np.linspace(-2, 1.6, 31), np.zeros(31), np.zeros(31)], axis=1)
    path = animate_episode(tmp_path / "a.gif", WORLD, drive, (2.0, 0.0), speed=speed)
    count = len(imageio.imread(path))
    durations = [imageio.immeta(path, index=index)["duration"] for index in range(count)]
    assert min(durations) >= 20
    assert sum(durations) == pytest.approx(1000.0 * 31 * 0.2 / speed + 1000.0, abs=60)
    assert pixels(imageio.imread(path)[-1][PLAN], ROBOT)[:, 1].mean() > 370  # the end of the drive is there
