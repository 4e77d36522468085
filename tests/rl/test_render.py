"""Pictures of an environment's robots from above."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose
from torchrl.record import CSVLogger, PixelRenderTransform, VideoRecorder

from navsim.draw import GOAL, ROBOT, VIEW
from navsim.randomization import Randomization
from navsim.sensor import KINECT
from navsim.world import World
from rl.env import NavEnv

SIDE = 200
ROOM = World.from_dict({"format": 1, "size": [6, 6], "walls": {"thickness": 0.1}})
MOVING = World.from_dict(
    {
        "format": 1,
        "size": [6, 6],
        "obstacles": [
            {"box": {"at": [0, 0], "size": [1, 1], "height": 1, "motion": {"path": [[0, 0], [2, 2]], "speed": 0.5}}}
        ],
    }
)


def pixel(picture: np.ndarray, x: float, y: float) -> np.ndarray:
    """The colour at a place of a room of 6 m with walls of 0.1 m, which fills the picture."""
    scale = SIDE / 6.2
    return picture[int(SIDE / 2 - y * scale), int(SIDE / 2 + x * scale)]


def test_each_robot_is_drawn_where_it_is_with_its_goal():
    env = NavEnv(ROOM, 3, seed=0)
    env.rollout(5, break_when_any_done=False)
    pictures = env.render(SIDE)
    assert pictures.shape == (3, SIDE, SIDE, 3)
    assert pictures.dtype == np.uint8
    for picture, pose, goal in zip(pictures, env.simulator.poses, env.simulator.goals, strict=True):
        behind = pose[:2] - 0.08 * np.array([np.cos(pose[2]), np.sin(pose[2])])  # its nose is drawn ahead
        np.testing.assert_allclose(pixel(picture, *behind), 255 * np.array(to_rgb(ROBOT)), atol=2)
        np.testing.assert_allclose(pixel(picture, *goal), 255 * np.array(to_rgb(GOAL)), atol=2)


def test_what_moves_is_drawn_where_it_is_for_each_robot():
    env = NavEnv(MOVING, 2, seed=0)
    env.reset()
    pictures = env.render(SIDE)
    places = env.simulator.obstacle_poses[:, 0, :2]
    assert np.abs(places[0] - places[1]).max() > 0.2  # else both pictures would be alike
    free = np.array([251, 249, 247])
    for picture, place in zip(pictures, places, strict=True):
        assert np.abs(pixel(picture, *place).astype(int) - free).max() > 30


def test_pictures_follow_the_worlds_of_the_episodes():
    env = NavEnv([ROOM, MOVING], 4, seed=1)
    env.reset()
    env.render(SIDE)
    for _ in range(3):
        env.reset()
        fresh = NavEnv([ROOM, MOVING], 4, seed=1)
        fresh.load_state_dict(env.state_dict())
        np.testing.assert_array_equal(env.render(SIDE), fresh.render(SIDE))


@pytest.mark.parametrize(
    "settings",
    [
        {"sensor": KINECT},
        {"randomization": Randomization(camera_pitch_deg=(8.0, 8.0), camera_forward=(0.1, 0.1))},
    ],
)
def test_views_are_as_wide_with_worse_sensors_and_cameras_that_hang_otherwise(settings):
    def viewed(env: NavEnv) -> np.ndarray:
        env.reset()
        seen = 0.3 * 255 * np.array(to_rgb(VIEW)) + 0.7 * np.array([251, 249, 247])
        return (np.abs(env.render(SIDE) - seen).max(axis=-1) < 12).mean(axis=(1, 2))

    ideal, other = (viewed(NavEnv("complex_eval", 8, seed=1, **given)) for given in ({}, settings))
    assert ideal.min() > 0.01
    np.testing.assert_allclose(other, ideal, rtol=0.2, atol=0.01)


def test_torchrl_films_it(tmp_path):
    recorder = VideoRecorder(CSVLogger("own", log_dir=str(tmp_path)), tag="plan")
    env = TransformedEnv(NavEnv(ROOM, 2, seed=0), Compose(PixelRenderTransform(size=64), recorder))
    pixels = env.rollout(4, break_when_any_done=False)["pixels"]
    assert pixels.shape == (2, 4, 64, 64, 3)
    assert (pixels[:, 0] != pixels[:, 3]).any()
    env.transform.dump()
    film = torch.load(tmp_path / "own" / "videos" / "plan_0.pt")
    assert film.shape[-1] > 64  # the two robots side by side


def test_a_copy_of_an_environment_draws_its_own_pictures():
    env = NavEnv(ROOM, 1, seed=0)
    env.reset()
    before = env.render(SIDE)
    other = copy.deepcopy(env)
    other.rollout(3)
    assert (other.render(SIDE) != before).any()
    np.testing.assert_array_equal(env.render(SIDE), before)


def test_a_picture_has_a_side():
    env = NavEnv(ROOM, 1, seed=0)
    env.reset()
    with pytest.raises(ValueError, match="a picture must have a side of at least 1 pixel; got 0"):
        env.render(0)
