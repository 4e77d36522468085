"""The evaluation: that every path is driven as it would be alone, and kept as it was driven."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from rich.console import Console
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.data import Categorical
from torchrl.modules import EGreedyModule, LSTMModule

from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.sensor import KINECT, SensorModel
from navsim.simulator import Simulator
from navsim.task import Path, Task
from navsim.world import World
from navsim.worldfile import load_world
from rl.baselines import make_baseline
from rl.config import TrainConfig
from rl.evaluation import evaluate
from rl.learner import make_actor
from rl.metrics import Evaluation
from rl.networks import symmetric_policy
from rl.policies import load_policy
from rl.run import Run

CAMERA = DepthCamera(width=20, height=16)
TASK = Task(max_steps=60)
ROOM = World.from_dict(
    {
        "format": 1,
        "name": "room",
        "size": [6, 6],
        "obstacles": [{"box": {"at": [1.0, 1.5], "size": [0.4, 0.4], "height": 0.8}}],
        "starts": [{"at": [-2, 0], "yaw_deg": 0}, {"at": [-2, 1.5], "yaw_deg": 0}],
        "goals": [[0.5, 0], [2.3, 1.5], [-2.2, -2.2]],
    }
)
OPEN_YAWS = World.from_dict({"format": 1, "size": [6, 6], "starts": [[0, 0], [1, 1]], "goals": [[2, 2], [-2, 2]]})


def ahead(state):
    """Fast, always straight on."""
    state["action"] = torch.ones(state.batch_size, dtype=torch.int64)
    return state


def circling(state):
    state["action"] = torch.full(state.batch_size, 2)
    return state


def drive(policy, world=ROOM, **options) -> Evaluation:
    return evaluate(policy, world, **{"camera": CAMERA, "task": TASK, **options})


def test_every_path_is_driven_once_in_the_order_of_the_world():
    evaluation = drive(ahead)
    assert [(path.start_index, path.goal_index) for path in evaluation.paths] == list(ROOM.paths)
    assert [path.goal for path in evaluation.paths] == [ROOM.goals[goal].at for _, goal in ROOM.paths]
    assert [path.outcome for path in evaluation.paths] == ["success", *["collision"] * 5]
    assert evaluation.world == "room"


@pytest.mark.parametrize(("collision_depth", "bumper"), [(0.4, False), (0.0, True)])
def test_collisions_by_the_bumper_and_by_the_depth_rule_are_reported_apart(collision_depth, bumper):
    evaluation = evaluate(ahead, ROOM, camera=CAMERA, task=Task(collision_depth=collision_depth))
    collided = [path for path in evaluation.paths if path.outcome == "collision"]
    assert collided
    assert all((path.bumper, path.too_near) == (bumper, not bumper) for path in collided)
    share = len(collided) / len(evaluation.paths)
    summary = evaluation.to_dict()["summary"]
    assert (summary["bumper_rate"], summary["too_near_rate"]) == ((share, 0.0) if bumper else (0.0, share))
    again = Evaluation.from_json(evaluation.to_json())
    assert [(path.bumper, path.too_near, path.phases) for path in again.paths] == [
        (path.bumper, path.too_near, path.phases) for path in evaluation.paths
    ]


def test_obstacles_of_an_evaluated_path_are_where_they_were():
    world = load_world("crowded")
    evaluation = evaluate(ahead, world, camera=CAMERA, task=TASK, num_paths=2)
    simulator = Simulator(world, 2, camera=CAMERA, task=TASK, seed=0)
    simulator.reset(paths=[Path(0, 0), Path(0, 1)])
    for robot, path in enumerate(evaluation.paths):
        np.testing.assert_array_equal(path.phases, simulator.phases[robot])
        poses = path.obstacle_poses(world, TASK)
        assert len(poses) == path.steps + 1
        np.testing.assert_array_equal(poses[0], simulator.obstacle_poses[robot])


def test_what_was_pushed_is_where_wheels_that_err_have_pushed_it():
    can = {"cylinder": {"at": [-1.4, 0.0], "radius": 0.1, "height": 0.2, "pushable": {"mass": 1.0}}}
    start = {"at": [-2.0, 0.0], "yaw_deg": 0}
    world = World.from_dict({"format": 1, "size": [6, 6], "obstacles": [can], "starts": [start], "goals": [[2.5, 2.5]]})
    settings = {
        "task": replace(TASK, pushing_is_collision=False, collision_depth=0.0),
        "randomization": Randomization(wheel_speed_error=(-0.08, 0.08)),
    }
    evaluation = drive(ahead, world, **settings, seed=1)
    (path,) = evaluation.paths
    simulator = Simulator(world, camera=CAMERA, seed=1, **settings)
    simulator.reset(paths=[Path(0, 0)])
    assert path.wheel_errors == tuple(simulator.wheel_errors[0])
    for action in path.actions:
        simulator.step(np.array([action]))
    driven = simulator.obstacle_poses[0]
    assert np.hypot(*(driven[0, :2] - (-1.4, 0.0))) > 0.3
    (read,) = Evaluation.from_dict(json.loads(json.dumps(evaluation.to_dict()))).paths
    for told, tolerance in ((path, 0.0), (read, 1e-3)):
        np.testing.assert_allclose(told.obstacle_poses(world, settings["task"])[-1], driven, rtol=0, atol=tolerance)


@pytest.mark.parametrize("policy", [ahead, circling])
def test_a_path_is_driven_as_it_would_be_alone(policy):
    for path in drive(policy).paths:
        simulator = Simulator(ROOM, camera=CAMERA, task=TASK)
        simulator.reset(paths=[Path(path.start_index, path.goal_index)])
        poses, rewards = [simulator.poses[0].copy()], []
        for step, action in enumerate(path.actions):
            moved = simulator.step(np.array([action]))
            poses.append(simulator.poses[0].copy())
            rewards.append(moved.reward[0])
            assert (moved.terminated[0] or moved.truncated[0]) == (step == path.steps - 1)
        ended = {"success": moved.success[0], "collision": moved.collision[0], "timeout": moved.truncated[0]}
        assert [outcome for outcome, happened in ended.items() if happened] == [path.outcome]
        np.testing.assert_array_equal(path.trajectory, poses)
        assert path.reward == pytest.approx(np.sum(rewards), abs=1e-5)


def test_a_robot_that_never_arrives_times_out():
    open_floor = World.from_dict(
        {"format": 1, "size": [20, 20], "starts": [{"at": [0, 0], "yaw_deg": 0}], "goals": [[8, 8]]}
    )
    (path,) = drive(circling, open_floor).paths
    assert (path.outcome, path.steps, len(path.trajectory)) == ("timeout", 60, 61)


def test_lengths_of_a_straight_drive():
    path = drive(ahead).paths[0]
    assert path.shortest_path_length == pytest.approx(2.5 - 0.5, rel=0.01)
    assert path.path_length == pytest.approx(path.trajectory[-1, 0] + 2.0, abs=1e-6)
    assert path.spl == pytest.approx(path.shortest_path_length / path.path_length, abs=1e-9)


@pytest.mark.parametrize("interval", [1, 3])
def test_policies_see_the_last_four_images_and_what_begins(interval):
    seen = []

    def look(state):
        seen.append(state.select("depth", "heading", "command", "pose", "is_init").clone())
        return ahead(state)

    path = drive(look, num_paths=1, frame_interval=interval).paths[0]
    first, second, fifth = seen[0], seen[1], seen[1 + 3 * interval]
    np.testing.assert_allclose(torch.cat([state["command"] for state in seen]), path.commands[:-1], rtol=1e-6)
    assert path.commands[:2].tolist() == [[0.2, 0.0], [0.4, 0.0]]
    assert first["depth"].shape == (1, 4, 16, 20)
    assert first["depth"].dtype == torch.uint8
    assert first["heading"].shape == (1, 1)
    for frame in range(4):
        torch.testing.assert_close(first["depth"][:, frame], first["depth"][:, 3])
    torch.testing.assert_close(fifth["depth"][:, 0], second["depth"][:, 3])
    assert not torch.equal(second["depth"][:, 3], fifth["depth"][:, 3])
    assert [bool(state["is_init"]) for state in seen[:5]] == [True, False, False, False, False]


def test_policies_see_through_the_sensor_of_each_robot_to_the_end():
    """Noise, latency and what was randomised stay with a robot when others have finished."""
    settings = {
        "sensor": replace(KINECT, latency=2),
        "randomization": Randomization(camera_pitch_deg=(0.0, 5.0), wheel_speed_error=(-0.05, 0.05), latency=(0, 1)),
    }
    seen = []

    def look(state):
        seen.append(state["depth"][-1, -1].numpy().copy())
        return ahead(state)

    first, last = drive(look, num_paths=2, **settings).paths
    assert first.steps < last.steps
    simulator = Simulator(ROOM, 2, camera=CAMERA, task=TASK, seed=0, **settings)
    expected = [simulator.reset(paths=[Path(0, goal) for goal in (0, 1)]).depth[1]]
    while len(expected) < last.steps:
        moved = simulator.step(np.ones(2, dtype=np.int64))
        expected.append(moved.depth[1])
        ended = moved.terminated | moved.truncated
        simulator.reset(ended, paths=[Path(0, 0)] * 2)
    np.testing.assert_array_equal(seen, expected)


def test_memory_stays_with_its_robot_when_others_have_finished():
    batches = []

    def remember(state):
        if state["is_init"].all():
            state["home"] = state["pose"].clone()
            state["age"] = torch.zeros(state.batch_size, dtype=torch.int64)
        state["age"] = state["age"] + 1
        batches.append((state["home"][:, 1] - state["pose"][:, 1], state["age"]))
        return ahead(state)  # nobody leaves the line on which it began

    drive(remember)
    assert len({len(offsets) for offsets, _ in batches}) > 1
    for step, (offsets, ages) in enumerate(batches):
        assert offsets.abs().max() < 1e-5
        assert (ages == step + 1).all()


def test_torchrls_recurrent_modules_remember():
    torch.manual_seed(0)
    memory = LSTMModule(input_size=1, hidden_size=4, in_key="heading", out_key="features")
    seen, told = [], []

    def remember(state):
        seen.append(state["heading"][-1].clone())
        state = memory(state)
        told.append(state["features"][-1].clone())
        return circling(state)

    drive(remember)
    assert len(seen) > 10
    with torch.no_grad():
        expected, _ = memory.lstm(torch.stack(seen).unsqueeze(0))  # the whole drive at once
    torch.testing.assert_close(torch.stack(told), expected[0])


def test_a_policy_is_told_what_it_sees_where_its_weights_are():
    class Elsewhere(torch.nn.Module):
        """Its weights are on the only device but the CPU that every machine has, where nothing can be computed."""

        def __init__(self):
            super().__init__()
            self.weight = torch.nn.Parameter(torch.zeros(1, device="meta"))

        def forward(self, state):
            assert {value.device.type for value in state.values()} == {"meta"}
            return TensorDict({"action": torch.ones(state.batch_size, dtype=torch.int64)}, state.batch_size)

    assert drive(Elsewhere()).to_dict()["paths"] == drive(ahead).to_dict()["paths"]


def test_a_policy_that_was_trained_is_evaluated_as_it_was_trained(tmp_path):
    noisy = replace(KINECT, latency=2)
    settings = {"camera": CAMERA, "task": TASK, "sensor": noisy, "frame_interval": 3, "loss_function": "l2"}
    config = TrainConfig(**settings, preset="thesis", inputs=("depth", "heading"), out=tmp_path / "run")
    run = Run.create(config)
    torch.manual_seed(0)
    run.save_policy("policy", make_actor(config).state_dict())
    policy = load_policy(run.directory)
    assert policy.trained_as == config
    as_trained = drive(policy, sensor=noisy, frame_interval=3)
    assert evaluate(policy, ROOM).to_json() == as_trained.to_json()
    assert evaluate(policy, ROOM, sensor=SensorModel()).to_json() != as_trained.to_json()
    assert symmetric_policy(policy).trained_as == config


def test_start_yaws_depend_on_the_seed_and_not_on_the_policy():
    def yaws(policy, seed):
        return [path.trajectory[0, 2] for path in drive(policy, OPEN_YAWS, seed=seed).paths]

    assert yaws(ahead, 1) == yaws(circling, 1)
    assert yaws(ahead, 1) != yaws(ahead, 2)


def test_a_policy_that_draws_is_reproducible_and_leaves_the_generator_alone():
    def random(state):
        state["action"] = torch.randint(7, state.batch_size)
        return state

    before = torch.get_rng_state()
    first, second = drive(random, seed=3), drive(random, seed=3)
    assert torch.equal(before, torch.get_rng_state())
    assert first.to_json() == second.to_json()
    assert first.to_json() != drive(random, seed=4).to_json()


def test_exploration_is_off_and_modules_are_in_evaluation_mode():
    modes = []

    class Fast(torch.nn.Module):
        def forward(self, heading):
            modes.append(self.training)
            return torch.ones(heading.shape[0], dtype=torch.int64)

    greedy = TensorDictModule(Fast(), in_keys=["heading"], out_keys=["action"])
    explorer = EGreedyModule(Categorical(7), eps_init=1.0, eps_end=1.0)
    policy = TensorDictSequential(greedy, explorer).train()
    evaluation = drive(policy)
    assert (np.concatenate([path.actions for path in evaluation.paths]) == 1).all()
    assert not any(modes)
    assert policy.training


def test_modules_that_were_frozen_while_others_train_stay_so():
    class Fast(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.frozen, self.other = torch.nn.Dropout(), torch.nn.Dropout()

        def forward(self, heading):
            return torch.ones(heading.shape[0], dtype=torch.int64)

    policy = TensorDictModule(Fast(), in_keys=["heading"], out_keys=["action"]).train()
    policy.module.frozen.eval()
    drive(policy)
    assert (policy.training, policy.module.other.training, policy.module.frozen.training) == (True, True, False)


class Map:
    """Plans: straight on for the first path, nothing for the second, too little for the third."""

    name = "map"

    def plan(self, world, starts, goals, camera, task, robot, phases):
        assert (world, camera, task) == (ROOM, CAMERA, TASK)
        plans = [np.full(30, 1), None, np.array([1])]
        yield from plans[: len(starts)]


def test_a_planner_is_driven_without_looking():
    evaluation = drive(Map(), num_paths=3)
    planned, unplanned, short = evaluation.paths
    assert evaluation.policy == "map"
    assert planned.outcome == "success"
    assert set(planned.actions) == {1}
    assert (unplanned.outcome, unplanned.steps, unplanned.trajectory.shape) == ("timeout", 0, (1, 3))
    assert short.actions[:3].tolist() == [1, 4, 4]
    assert short.outcome == "collision"


def test_a_planner_gets_each_world_with_its_own_paths():
    plans = {}

    class Recorder:
        name = "recorder"

        def plan(self, world, starts, goals, camera, task, robot, phases):
            plans.setdefault(world.name, []).extend(goals.tolist())
            return [np.array([1, 4, 4])] * len(starts)

    evaluation = drive(Recorder(), [ROOM, OTHER_ROOM])
    assert {name: len(goals) for name, goals in plans.items()} == {"room": 6, "other": 4}
    assert [list(path.goal) for path in evaluation.paths] == plans["room"] + plans["other"]


def test_only_some_paths_or_more_than_there_are():
    assert [(path.start_index, path.goal_index) for path in drive(ahead, num_paths=2).paths] == list(ROOM.paths[:2])
    with pytest.raises(ValueError, match='"room" has 6 paths; num_paths asks for 7'):
        drive(ahead, num_paths=7)
    with pytest.raises(ValueError, match="at least 1; got 0"):
        drive(ahead, num_paths=0)


def test_random_worlds_have_as_many_paths_as_wanted():
    world = World.from_dict({"format": 1, "size": [6, 6], "starts": [[0, 0], [1, 1]], "goals": "random"})
    evaluation = drive(ahead, world, num_paths=5)
    assert [path.start_index for path in evaluation.paths] == [0, 1, 0, 1, 0]
    assert len({path.goal for path in evaluation.paths}) == 5


OTHER_ROOM = ROOM.model_copy(update={"name": "other", "obstacles": (), "goals": ROOM.goals[:2]})


@pytest.mark.parametrize("policy", [ahead, circling])
def test_paths_of_several_worlds_are_driven_as_in_each_world_alone(policy):
    together = drive(policy, [ROOM, OTHER_ROOM, ROOM])
    assert together.worlds == ("room", "other", "room")
    assert together.world == "room, other, room"
    assert len(together.paths) == 6 + 4 + 6
    for part, world in zip(together.by_world(), [ROOM, OTHER_ROOM, ROOM], strict=True):
        assert part.to_json() == drive(policy, world).to_json()


def test_many_paths_are_driven_in_parts_that_keep_worlds_whole(monkeypatch):
    whole = drive(ahead, [ROOM, OTHER_ROOM, ROOM])
    monkeypatch.setattr("rl.evaluation._TOGETHER", 5)
    assert drive(ahead, [ROOM, OTHER_ROOM, ROOM]).to_json() == whole.to_json()


def test_a_number_of_paths_is_shared_out_evenly_among_worlds():
    worlds = [ROOM, OTHER_ROOM, ROOM]
    some = drive(ahead, worlds, num_paths=8)
    assert [sum(path.world_index == index for path in some.paths) for index in range(3)] == [3, 3, 2]
    pairs = [(path.world_index, path.start_index, path.goal_index) for path in some.paths]
    assert len(set(pairs)) == 8
    assert pairs == sorted(pairs)
    # Another seed takes others: which ones are driven is drawn, not always the first.
    drawn = {
        tuple((path.start_index, path.goal_index) for path in drive(ahead, worlds, num_paths=8, seed=seed).paths)
        for seed in range(3)
    }
    assert len(drawn) > 1
    # A world that has too few leaves the rest to the others.
    assert [len(part.paths) for part in drive(ahead, worlds, num_paths=15).by_world()] == [6, 4, 5]


def test_several_worlds_have_a_thousand_paths_at_most_unless_asked_for_more(monkeypatch):
    monkeypatch.setattr("rl.paths.MOST_PATHS", 7)
    assert len(drive(ahead, [ROOM, OTHER_ROOM]).paths) == 7
    assert len(drive(ahead, [ROOM, OTHER_ROOM], num_paths=9).paths) == 9


def test_paths_that_several_worlds_do_not_have_are_refused():
    with pytest.raises(ValueError, match="the 2 worlds have 10 paths together; num_paths asks for 11"):
        drive(ahead, [ROOM, OTHER_ROOM], num_paths=11)
    with pytest.raises(ValueError, match=r"num_paths \(1\) must be at least 1 in each of the 2 worlds"):
        drive(ahead, [ROOM, OTHER_ROOM], num_paths=1)
    with pytest.raises(ValueError, match="needs at least one world"):
        drive(ahead, [])


def test_generated_rooms_are_evaluated_by_their_source():
    source = "generate:blocks,size=4x4,density=0.06,seed=2,count=3"
    evaluation = drive(ahead, source, num_paths=6)
    assert evaluation.world == source
    assert evaluation.worlds == ("blocks-0001", "blocks-0002", "blocks-0003")
    assert [path.world_index for path in evaluation.paths] == [0, 0, 1, 1, 2, 2]
    one = "generate:blocks,size=4x4,density=0.06,seed=2"
    assert drive(ahead, one, num_paths=2).world == one


def test_worlds_survive_json_and_older_files_have_one(tmp_path):
    evaluation = drive(ahead, [ROOM, OTHER_ROOM], num_paths=4)
    again = Evaluation.from_json(evaluation.to_json())
    assert again.worlds == evaluation.worlds == ("room", "other")
    assert [path.world_index for path in again.paths] == [path.world_index for path in evaluation.paths] == [0, 0, 1, 1]
    values = drive(ahead).to_dict()
    del values["worlds"]
    for path in values["paths"]:
        del path["world_index"]
    assert Evaluation.from_dict(values).worlds == ("room",)
    values["paths"][0]["world_index"] = 1
    with pytest.raises(ValueError, match="a path lies in a world that it does not name"):
        Evaluation.from_dict(values)


def test_seeds_are_not_negative():
    with pytest.raises(ValueError, match="seed must lie between 0 and 4294967295; got -1"):
        drive(ahead, seed=-1)


def test_json_round_trip(tmp_path):
    evaluation = drive(ahead)
    summary = json.loads(evaluation.to_json())["summary"]
    assert summary["success_rate"] == evaluation.success_rate
    assert summary["success_interval"] == list(evaluation.interval("success"))
    assert summary["spl"] == evaluation.spl
    evaluation.save(tmp_path / "made" / "evaluation.json")
    read = Evaluation.load(tmp_path / "made" / "evaluation.json")
    assert read.spl == pytest.approx(evaluation.spl, abs=1e-4)
    for before, after in zip(evaluation.paths, read.paths, strict=True):
        np.testing.assert_allclose(after.trajectory, before.trajectory, atol=1e-4)
        np.testing.assert_array_equal(after.actions, before.actions)
        assert (after.outcome, after.goal, after.reward) == (before.outcome, before.goal, before.reward)


def test_progress_is_shown_on_a_console():
    screen = Console(file=io.StringIO(), width=100, force_terminal=True)
    drive(ahead, console=screen)
    assert "evaluating in room" in screen.file.getvalue()
    assert "6/6" in screen.file.getvalue()


def test_policies_may_return_their_action_alone_or_nothing():
    straight = make_baseline("straight")

    def alone(state):
        return TensorDict({"action": straight(state.clone())["action"]}, state.batch_size)

    def nothing(state):
        state["action"] = straight(state.clone())["action"]

    def tensor(state):
        return straight(state.clone())["action"]

    def mapping(state):
        return {"action": tensor(state)}

    def array(state):
        return tensor(state).numpy()

    expected = evaluate(straight, "simple_eval", num_paths=4).paths
    for policy in (alone, nothing, tensor, mapping, array):
        for path, other in zip(evaluate(policy, "simple_eval", num_paths=4).paths, expected, strict=True):
            np.testing.assert_array_equal(path.trajectory, other.trajectory)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("pretrained:I", r"evaluate takes a policy; got 'pretrained:I': give rl\.load_policy"),
        (lambda state: None, 'the policy gave no "action", only depth, heading, command, pose, is_init$'),
        (lambda state: 1, "a policy must return a tensordict or the actions; got int"),
        (
            lambda state: torch.nn.functional.one_hot(torch.zeros(len(state), dtype=torch.int64), 7),
            r"the policy gave actions of shape \(\d+, 7\) for \d+ robots?; an action is one integer",
        ),
    ],
)
def test_what_is_no_policy_is_told_so(policy, message):
    with pytest.raises(ValueError, match=message):
        evaluate(policy, ROOM, camera=CAMERA, num_paths=2)


def test_a_wrapped_policy_is_evaluated_as_it_was_trained():
    policy = load_policy("pretrained:I")
    averaged = torch.optim.swa_utils.AveragedModel(policy)
    own, wrapped = (evaluate(one, "simple_eval", num_paths=3).paths for one in (policy, averaged))
    for path, other in zip(own, wrapped, strict=True):
        np.testing.assert_array_equal(path.trajectory, other.trajectory)


def test_generators_of_devices_that_a_policy_is_not_on_are_left_alone(monkeypatch):
    seeded = []
    monkeypatch.setattr(torch.cuda, "manual_seed_all", seeded.append)
    before = torch.get_rng_state()
    first, again = (evaluate(make_baseline("random"), "simple_eval", num_paths=2, seed=3) for _ in range(2))
    assert [path.actions.tolist() for path in first.paths] == [path.actions.tolist() for path in again.paths]
    assert torch.equal(torch.get_rng_state(), before)
    assert not seeded
