"""Collectors, in this process and in others."""

from __future__ import annotations

import gc
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing.synchronize import SemLock
from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navsim.camera import DepthCamera
from navsim.worldsource import worlds_from
from rl.background import MOST_REPLACEMENTS, BackgroundCollector, CollectorError, PersistentCollector
from rl.collect import explorer, make_collector, make_env, training_worlds
from rl.config import PRESETS
from rl.env import NavEnv
from rl.networks import make_q_actor

CAMERA = DepthCamera(width=20, height=12)
CONFIG = replace(
    PRESETS["memoryless"],
    world=("complex_train",),
    camera=CAMERA,
    num_envs=4,
    steps_per_batch=32,
    epsilon_steps=320,
    margin=0.0,
    rearrangements=0,
    epsilon_end=0.02,
    epsilon_least=None,
)


def test_batches_continue_from_one_to_the_next():
    env = make_env(CONFIG)
    batches = list(make_collector(env, explorer(make_q_actor("I", 12, 20), env, CONFIG), CONFIG, total_steps=128))
    assert [batch.shape for batch in batches] == [(4, 8)] * 4
    for earlier, later in itertools.pairwise(batches):
        goes_on = ~earlier["next", "done"][:, -1, 0]
        assert goes_on.any()
        assert (earlier["next", "depth"][goes_on, -1] == later["depth"][goes_on, 0]).all()


def test_the_share_of_random_actions_falls_linearly():
    env = make_env(CONFIG)
    policy = explorer(make_q_actor("I", 12, 20), env, CONFIG)
    exploration = policy[-1]
    state = env.reset()
    greedy = policy[0](state.clone())["action"]

    def share():
        with set_exploration_type(ExplorationType.RANDOM):
            return torch.stack([policy(state.clone())["action"] != greedy for _ in range(400)]).float().mean().item()

    torch.manual_seed(0)
    assert share() == pytest.approx(6 / 7, abs=0.05)  # one random action in seven is the greedy one
    for _ in range(5):
        exploration.step()
    assert exploration.eps.tolist() == pytest.approx([0.5 * (1.0 + CONFIG.epsilon_end)] * 4, abs=1e-6)
    for _ in range(20):
        exploration.step()
    assert exploration.eps.tolist() == pytest.approx([CONFIG.epsilon_end] * 4)
    assert share() < 0.06


def test_a_margin_makes_training_stricter_and_nothing_else():
    env = make_env(replace(CONFIG, margin=0.06))
    assert env.simulator.task == replace(CONFIG.task, collision_depth=0.46)
    assert env.simulator.robot == replace(CONFIG.robot, radius=CONFIG.robot.radius + 0.06)
    assert make_env(CONFIG).simulator.task == CONFIG.task


@pytest.mark.parametrize(("margin", "nearest"), [(0.0, 0.4), (0.1, 0.5)])
def test_with_a_margin_a_drive_ends_that_much_earlier(tmp_path, margin, nearest):
    """Straight at a wall, seen at depths 0.04 m apart: the last one beyond the limit is that near to it."""
    room = tmp_path / "room.yaml"
    room.write_text("format: 1\nname: room\nsize: [4, 4]\nstarts: [{at: [0, 0], yaw_deg: 0}]\ngoals: [[-1.5, 0]]\n")
    env = make_env(
        replace(CONFIG, world=(str(room),), random_paths=False, num_envs=1, steps_per_batch=32, margin=margin)
    )
    depths, state = [], env.reset()
    while not (depths and state["terminated"].item()):
        state = env.step(state.set("action", torch.tensor([4])))["next"]
        depths.append(state["depth"][0, -1].min().item() * CAMERA.max_range / 255.0)
    assert depths[-1] < nearest <= depths[-2] + 0.01 < nearest + 0.06  # depths are multiples of 0.02 m


def test_each_robot_may_end_at_a_share_of_its_own():
    config = replace(CONFIG, epsilon_end=0.8, epsilon_least=0.0008)
    env = make_env(config)
    policy = explorer(make_q_actor("I", 12, 20), env, config)
    for _ in range(10):
        policy[-1].step()
    assert policy[-1].eps.tolist() == pytest.approx([0.8, 0.08, 0.008, 0.0008], rel=1e-3)
    state = env.reset()
    greedy = policy[0](state.clone())["action"]
    torch.manual_seed(0)
    with set_exploration_type(ExplorationType.RANDOM):
        differs = torch.stack([policy(state.clone())["action"] != greedy for _ in range(600)]).float().mean(0)
    assert differs.tolist() == pytest.approx([0.8 * 6 / 7, 0.08 * 6 / 7, 0.008, 0.0], abs=0.05)


def test_training_paths_are_drawn_anywhere_unless_listed_ones_are_asked_for():
    def starts(config):
        return {tuple(pose[:2].tolist()) for _ in range(8) for pose in make_env(config, seed=_).reset()["pose"]}

    assert len(starts(CONFIG)) == 32
    assert len(starts(replace(CONFIG, random_paths=False))) <= 5


def test_generated_rooms_are_trained_in_beside_files():
    config = replace(CONFIG, world=("simple_train", "generate:blocks,density=0.06,count=3"), rearrangements=2)
    names = [world.name for world in training_worlds(config)]
    assert names == ["simple_train", "simple_train 1", "simple_train 2", "blocks-0001", "blocks-0002", "blocks-0003"]
    assert all(world.random_starts for world in training_worlds(config))
    listed = training_worlds(replace(config, random_paths=False, rearrangements=0))
    assert listed[1:] == worlds_from("generate:blocks,density=0.06,count=3,seed=1000")


def test_rooms_to_train_in_follow_the_seed_and_are_not_those_of_an_evaluation():
    source = "generate:forest,count=4"
    config = replace(CONFIG, world=(source,), random_paths=False)
    obstacles = [repr(world.obstacles) for world in training_worlds(config)]
    obstacles += [repr(world.obstacles) for world in training_worlds(replace(config, seed=1))]
    obstacles += [repr(world.obstacles) for world in worlds_from(source)]
    assert len(set(obstacles)) == 12
    named = replace(config, world=(f"{source},seed=3",), seed=1)
    assert training_worlds(named) == worlds_from(f"{source},seed=3")


def test_an_environment_takes_generated_rooms():
    env = NavEnv("generate:clutter,size=5x5,count=3", num_envs=4, camera=CAMERA, seed=0)
    assert len(env.simulator.worlds) == 3
    assert env.rollout(5, break_when_any_done=False).shape == (4, 5)


def test_the_plain_collector_takes_a_creator():
    collector = Collector(partial(NavEnv, "simple_train", 2, camera=CAMERA), None, frames_per_batch=20, total_frames=40)
    assert sum(batch.numel() for batch in collector) == 40


class FailingPolicy(TensorDictModuleBase):
    """Turns left, and fails at its hundredth call."""

    in_keys, out_keys = ("heading",), ("action",)

    def __init__(self) -> None:
        super().__init__()
        self.share = torch.nn.Parameter(torch.zeros(1))
        self.calls = 0

    def forward(self, tensordict):
        self.calls += 1
        if self.calls == 100:
            raise ArithmeticError("the hundredth call")
        return tensordict.set("action", torch.full(tensordict.batch_size, 2))


def test_a_background_collector_goes_on_by_itself_and_its_process_is_replaced_when_it_dies_or_hangs(monkeypatch):
    inputs = ("depth", "heading", "surroundings")
    config = replace(CONFIG, collector="async", inputs=inputs, epsilon_start=0.0, epsilon_end=0.0, worker_timeout=4.0)
    names: list[str] = []
    monkeypatch.setattr(SemLock, "_make_name", staticmethod(note_semaphores(names)))
    env = make_env(config)
    actor = make_q_actor("I", 12, 20, inputs)
    told: list[str] = []
    collector = make_collector(env, explorer(actor, env, config), config, total_steps=3200, replaced=told.append)
    (process,) = collector.procs
    lived = {os.getpid(), process.pid}
    try:
        batches = []
        for batch in itertools.islice(collector, 12):
            batches.append(batch)
            if len(batches) == 4:  # from now on, always the same turn
                with torch.no_grad():
                    actor.module[0].module.advantage.bias[6] += 1e3
                collector.update_policy_weights_()
        assert [batch.shape for batch in batches] == [(4, 8)] * 12
        for earlier, later in itertools.pairwise(batches):
            goes_on = ~earlier["next", "done"][:, -1, 0]
            for key in ("depth", "surroundings"):
                assert (earlier["next", key][goes_on, -1] == later[key][goes_on, 0]).all()
        assert not (batches[0]["action"] == 6).all()
        assert (batches[-1]["action"] == 6).all()
        process.kill()
        count, is_stopped = 12 * 32, False
        for batch in collector:
            count += batch.numel()
            lived |= {one.pid for one in collector.procs}
            if told and not is_stopped:
                os.kill(collector.procs[0].pid, signal.SIGSTOP)
                is_stopped = True
        assert count >= 3200
        assert len(told) == 2
        assert "ended by signal 9" in told[0]
        assert "hung: it gave no sign of life for 4 s (--worker-timeout)" in told[1]
        assert f"(2 of at most {MOST_REPLACEMENTS})" in told[1]
    finally:
        collector.shutdown(raise_on_error=False)
    assert not multiprocessing.active_children()
    del collector, process
    gc.collect()
    assert len(lived) == 4
    assert_no_shared_memory_is_left(names, *lived)


class SleepyPolicy(FailingPolicy):
    """Turns left, and falls asleep at its hundredth call."""

    def forward(self, tensordict):
        try:
            return super().forward(tensordict)
        except ArithmeticError:
            return self.fall_asleep()

    def fall_asleep(self):
        time.sleep(600)


def end_of(policy: TensorDictModuleBase) -> str:
    """What is told of a collecting process that comes to an end by its policy."""
    collector = BackgroundCollector(
        make_env(CONFIG), policy, seed=0, frames_per_batch=32, total_frames=3200, timeout=3.0
    )
    try:
        with pytest.raises(CollectorError) as told:
            for _ in collector:
                pass
    finally:
        collector.shutdown(raise_on_error=False)
    assert not multiprocessing.active_children()
    return str(told.value)


def test_a_background_collector_that_hangs_is_told_with_the_place_where_it_does():
    told = end_of(SleepyPolicy())
    assert "hung: it gave no sign of life for 3 s" in told
    assert "it was here:" in told
    assert "in fall_asleep" in told


def test_an_exception_in_a_background_collector_is_told_with_its_traceback():
    told = end_of(FailingPolicy())
    assert "Traceback" in told
    assert "ArithmeticError: the hundredth call" in told


ORPHAN = """
if __name__ == "__main__":
    import time
    from test_collect import CONFIG, SemLock, explorer, make_collector, make_env, make_q_actor, note_semaphores, replace

    names = []
    SemLock._make_name = staticmethod(note_semaphores(names))
    config = replace(CONFIG, collector="async")
    env = make_env(config)
    collector = make_collector(env, explorer(make_q_actor("I", 12, 20), env, config), config, total_steps=10**6)
    next(iter(collector))
    print(collector.procs[0].pid, *names, flush=True)
    time.sleep(600)
"""


def test_a_process_ends_with_the_one_that_was_killed_even_when_it_hangs(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    paths = [str(Path(__file__).parent), *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with subprocess.Popen([sys.executable, script], env=environment, stdout=subprocess.PIPE, text=True) as parent:
        child, *names = parent.stdout.readline().split()
        child = int(child)
        assert not has_ended(child)
        os.kill(child, signal.SIGSTOP)
        parent.kill()
    deadline = time.monotonic() + 15.0
    while not has_ended(child) and time.monotonic() < deadline:
        time.sleep(0.1)
    ended = has_ended(child)
    if not ended:
        os.kill(child, signal.SIGKILL)
    assert ended
    assert_no_shared_memory_is_left(names, parent.pid, child)


SHARED_MEMORY = Path("/dev/shm")


def note_semaphores(names: list[str]) -> Callable[[], str]:
    """A ``SemLock._make_name`` that notes the names; those of tests that run at the same time are not among them."""
    make_name = SemLock._make_name

    def noted() -> str:
        names.append("sem." + make_name().removeprefix("/"))
        return "/" + names[-1].removeprefix("sem.")

    return noted


def assert_no_shared_memory_is_left(names: list[str], *processes: int) -> None:
    """Of the semaphores ``names``, and of PyTorch's files, which bear the number of the process that made them."""
    deadline = time.monotonic() + 15.0
    while (left := shared_memory_left(names, processes)) and time.monotonic() < deadline:
        time.sleep(0.1)  # the resource tracker clears up when the last process has gone
    assert not left


def shared_memory_left(names: list[str], processes: tuple[int, ...]) -> list[str]:
    assert names
    torchs = [file.name for process in processes for file in SHARED_MEMORY.glob(f"torch_{process}_*")]
    return torchs + [name for name in names if (SHARED_MEMORY / name).exists()]


def has_ended(process: int) -> bool:
    """Whether a process is gone, or only waits for its new parent to ask for its status."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


class FailingCollector:
    """Yields a batch of ten, and fails; or fails at once when it is made."""

    def __init__(self, at_once: bool) -> None:
        self.is_shut_down = False
        if at_once:
            raise CollectorError("it does not come to work")

    def __iter__(self):
        yield torch.zeros(10)
        raise CollectorError("it has failed")

    def shutdown(self, **_) -> None:
        self.is_shut_down = True


def test_what_fails_again_and_again_is_given_up():
    started, told = [], []

    def start(seed: int, frames: int) -> FailingCollector:
        started.append((seed, frames))
        collector = FailingCollector(at_once=len(started) == 3)
        collectors.append(collector)
        return collector

    collectors: list[FailingCollector] = []
    collector = PersistentCollector(start, seed=5, total_frames=100, replaced=told.append)
    batches = []
    with pytest.raises(CollectorError, match="it is the 4th that has failed in this run"):
        batches.extend(collector)
    assert len(batches) == 3
    assert [frames for _, frames in started] == [100, 90, 80, 80]
    assert started[0][0] == 5
    assert len({seed for seed, _ in started}) == 4
    assert len(told) == 2
    assert "it does not come to work" in told[1]
    assert all(one.is_shut_down for one in collectors)
