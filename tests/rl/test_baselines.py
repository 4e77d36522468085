"""The baselines: what each does with what it sees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import chisquare
from tensordict import TensorDict

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.robot import INITIAL_COMMAND, MIRRORED_ACTIONS, TURTLEBOT2, Robot, apply_actions
from navsim.sensor import SensorModel
from navsim.task import Task
from navsim.world import World
from rl.baselines import BASELINES, make_baseline
from rl.env import NavEnv
from rl.evaluation import evaluate

CAMERA = DepthCamera()
LEFT, RIGHT = 2, 6
OPEN = World.from_dict(
    {
        "format": 1,
        "size": [7, 7],
        "starts": [{"at": [0, 0], "yaw_deg": yaw} for yaw in (-150, -60, 0, 100, 180)],
        "goals": [[2.5, 2.5], [-2.5, 0.5]],
    }
)
BLOCKED = World.from_dict(
    {
        "format": 1,
        "size": [7, 7],
        "obstacles": [
            {"box": {"at": [0.3, 0.1], "size": [0.5, 1.0], "height": 0.8}},
            {"cylinder": {"at": [0.3, -2.4], "radius": 0.3, "height": 0.2}},
        ],
        "starts": [{"at": [-2.5, 0], "yaw_deg": 0}, {"at": [-2.5, -2.4], "yaw_deg": 0}],
        "goals": [[2.5, 0], [2.5, -2.4]],
    }
)


def observe(world: World, poses, headings, camera: DepthCamera = CAMERA, **others) -> TensorDict:
    poses = np.asarray(poses, dtype=float).reshape(-1, 3)
    images = camera.to_uint8(camera.from_planar(render_depth(world, poses, camera)))
    depth = torch.from_numpy(images).unsqueeze(1).repeat(1, 4, 1, 1)
    heading = torch.tensor(headings, dtype=torch.float32).reshape(-1, 1)
    command = torch.tensor([INITIAL_COMMAND] * len(poses))
    return TensorDict({"depth": depth, "heading": heading, "command": command, **others}, batch_size=[len(poses)])


def test_every_name_makes_a_baseline_of_that_name():
    assert BASELINES == ("random", "straight", "reactive", "oracle")
    assert [make_baseline(name).name for name in BASELINES] == list(BASELINES)


def test_an_unknown_baseline_names_those_that_there_are():
    with pytest.raises(ValueError, match='no baseline "clever"; there are random, straight, reactive, oracle'):
        make_baseline("clever")


def test_random_takes_all_actions_evenly():
    torch.manual_seed(0)
    actions = make_baseline("random")(TensorDict({"heading": torch.zeros(7000, 1)}, batch_size=[7000]))["action"]
    assert actions.dtype == torch.int64
    assert chisquare(np.bincount(actions.numpy(), minlength=7)).pvalue > 0.01


@pytest.mark.parametrize(
    ("command", "heading", "action"),
    [
        ((0.2, 0.0), 0.0, 1),  # speed up: the goal is ahead
        ((0.4, 0.0), 0.0, 4),
        ((0.4, 0.0), 0.7, 2),
        ((0.2, 0.0), 0.35, 3),
        ((0.2, 0.0), -0.35, 5),
        ((0.4, 0.0), math.pi, 0),  # brake before turning round
        ((0.2, 0.0), -3.0, 6),
        ((0.4, math.pi / 4), 0.0, 4),  # enough turned
    ],
)
def test_straight_turns_to_the_goal_and_brakes_before_sharp_turns(command, heading, action):
    state = TensorDict({"heading": torch.tensor([[heading]]), "command": torch.tensor([command])}, batch_size=[1])
    assert make_baseline("straight")(state)["action"].tolist() == [action]


@pytest.mark.parametrize("name", ["straight", "reactive"])
def test_in_an_open_room_every_goal_is_reached(name):
    evaluation = evaluate(make_baseline(name), OPEN)
    assert evaluation.success_rate == 1.0
    assert evaluation.spl > 0.75


def test_reactive_goes_round_what_straight_runs_into():
    straight, reactive = (evaluate(make_baseline(name), BLOCKED) for name in ("straight", "reactive"))
    assert [straight.paths[index].outcome for index in (0, 3)] == ["collision"] * 2
    assert [path.outcome for path in reactive.paths] == ["success"] * 4


def test_reactive_drives_under_a_table_top_but_not_over_a_plank():
    def ahead_of(robot: Robot = TURTLEBOT2, x: float = 0.5, **box) -> int:
        room = World.from_dict({"format": 1, "size": [9, 9], "obstacles": [{"box": {"at": [x, 0.02], **box}}]})
        moving = torch.tensor([[0.4, 0.0]])
        state = observe(room, [0, 0, 0], [0.0], command=moving)
        return int(make_baseline("reactive", CAMERA, robot=robot)(state)["action"])

    assert ahead_of(size=[0.3, 1.2], base=0.7, height=0.03) == 4
    assert ahead_of(size=[0.3, 1.2], base=0.7, height=0.03, x=1.0) == 4
    assert ahead_of(size=[0.3, 1.2], base=0.7, height=0.03, x=1.0, robot=Robot(height=0.9)) != 4
    assert ahead_of(size=[0.3, 1.2], height=0.15) != 4


@pytest.mark.parametrize("width", [80, 81, 1])
def test_reactive_does_the_mirror_image_in_the_mirror_image(width):
    camera = replace(CAMERA, width=width)
    generator = np.random.default_rng(5)
    poses = np.column_stack([generator.uniform(-3, 3, (60, 2)), generator.uniform(-math.pi, math.pi, 60)])
    headings = generator.uniform(-math.pi, math.pi, 60)
    state = observe(BLOCKED, poses, headings, camera=camera)
    mirrored = state.clone()
    mirrored["depth"], mirrored["heading"] = state["depth"].flip(-1), -state["heading"]
    reactive = make_baseline("reactive", camera)
    actions = reactive(state)["action"]
    assert len(actions.unique()) > 3
    assert reactive(mirrored)["action"].tolist() == [MIRRORED_ACTIONS[action] for action in actions.tolist()]


def test_reactive_sees_the_newest_image_alone():
    state = observe(BLOCKED, [[-1, 0, 0], [0, -1.5, 2]], [0.3, -0.4])
    older = state.clone()
    older["depth"][:, :3] = 77
    reactive = make_baseline("reactive", CAMERA)
    torch.testing.assert_close(reactive(state)["action"], reactive(older)["action"])


def test_reactive_takes_images_of_any_size_unless_it_is_told_the_camera():
    large = DepthCamera(width=160, height=128)
    state = observe(BLOCKED, [-1, 0, 0], [0.3], large)
    unasked, told = make_baseline("reactive"), make_baseline("reactive", large)
    torch.testing.assert_close(unasked(state.clone())["action"], told(state.clone())["action"])
    with pytest.raises(ValueError, match="images of 80x64 pixels; it got 160x128"):
        make_baseline("reactive", CAMERA)(state)


def test_reactive_is_not_frightened_by_returns_that_its_sensor_loses():
    lost = SensorModel(grazing_loss=1.0)
    frightened, told = make_baseline("reactive", CAMERA), make_baseline("reactive", CAMERA, lost)
    frightened, told = (evaluate(policy, BLOCKED, sensor=lost, num_paths=4) for policy in (frightened, told))
    assert told.success_rate == 1.0
    assert frightened.success_rate < 1.0


def test_memory_begins_anew_where_an_episode_does():
    """Before an obstacle whose way round is shorter on the right, a robot that has begun to go left goes on so."""
    state = observe(BLOCKED, [[-0.8, 0, 0]] * 2, [0.0, 0.0], is_init=torch.tensor([[True], [False]]))
    state["direction"] = torch.full((2,), 0.6, dtype=torch.float64)
    assert make_baseline("reactive", CAMERA)(state)["action"].tolist() == [RIGHT, LEFT]


def test_reactive_reaches_most_goals_of_the_cluttered_room():
    assert evaluate(make_baseline("reactive"), "complex_eval", num_paths=30).success_rate > 0.75


def test_what_a_robot_is_told_stays_in_its_data():
    """``command`` is the environment's: the one in force before the action, as for any other policy."""
    env = NavEnv(OPEN, num_envs=2, seed=0)
    rollout = env.rollout(6, make_baseline("straight"), break_when_any_done=False)
    np.testing.assert_allclose(rollout["command"][:, 0], [(0.2, 0.0)] * 2)
    told = rollout["command"][:, 0].double().numpy()
    for step in range(6):
        np.testing.assert_allclose(rollout["command"][:, step], told, rtol=1e-6)
        told = apply_actions(told, rollout["action"][:, step].numpy())


@pytest.mark.parametrize("name", ["random", "straight", "reactive"])
def test_baselines_drive_the_environment(name):
    env = NavEnv(OPEN, num_envs=3, seed=0)
    rollout = env.rollout(8, make_baseline(name), break_when_any_done=False)
    assert rollout["action"].shape == (3, 8)
    assert ((rollout["action"] >= 0) & (rollout["action"] < 7)).all()


def test_the_oracle_reaches_goals_behind_obstacles():
    evaluation = evaluate(make_baseline("oracle"), BLOCKED, num_paths=2, task=Task(max_steps=200))
    assert [path.outcome for path in evaluation.paths] == ["success"] * 2
    assert evaluation.spl > 0.8


@pytest.mark.parametrize("name", ["random", "straight", "reactive"])
@pytest.mark.parametrize("shape", [(), (4,), (2, 2)])
def test_states_may_have_any_number_of_batch_dimensions(name, shape):
    env = NavEnv("complex_train", 4, seed=0)
    state = env.rollout(3, break_when_any_done=False)[:, -1]["next"].select("depth", "heading", "command")
    torch.manual_seed(0)
    expected = make_baseline(name)(state.clone())["action"][: 1 if not shape else 4]
    torch.manual_seed(0)
    given = state[0].clone() if not shape else state.clone().reshape(shape)
    policy = make_baseline(name)
    answer = policy(given)
    assert answer["action"].shape == torch.Size(shape)
    if name != "random":
        assert answer["action"].flatten().tolist() == expected.tolist()
        policy(answer)  # with what it wrote, as in a next step
