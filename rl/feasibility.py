"""Whether a run can be done here: its worlds, its directory, the memory and the disk that it takes."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import torch

from navsim.errors import WorldError
from navsim.oddities import Equipment, ended_at_once
from navsim.planner import shortest_path_length
from navsim.robot import TURTLEBOT2, Robot
from navsim.world import Goal, Start, World
from navsim.worldfile import load_world
from navsim.worldsource import is_generated
from rl.checkpoints import KEPT
from rl.config import ConfigError, TrainConfig
from rl.learner import NO_CUDA, shapes_of_weights
from rl.observation import NUM_FRAMES, history_length

_GIB = 2**30
_PROCESS = 0.55 * _GIB
"""A process that has imported everything, with its worlds; measured."""
_RECORD = 128
"""Bytes of a transition without its images, and of what the replay reckons with."""
_EVALUATED = 100
"""Robots that an evaluation drives together."""


def check_feasible(config: TrainConfig, *, is_trained: bool = False) -> None:
    """Raises :class:`ConfigError` with all that keeps a run from being done on this machine, one problem a line.

    Args:
        config: the settings.
        is_trained: whether all has been learnt, so that no checkpoint will be written any more.
    """
    problems = list(obstacles(config, is_trained=is_trained))
    if problems:
        raise ConfigError("\n".join(problems))


def obstacles(config: TrainConfig, *, is_trained: bool = False) -> Iterator[str]:
    """What keeps a run from being done on this machine, a sentence each; arguments as for ``check_feasible``."""
    for source in dict.fromkeys((*config.world, config.eval_world)):
        if not is_generated(source):
            try:
                world = load_world(source)
            except WorldError as error:
                yield str(error)
                continue
            if source == config.eval_world:
                yield from _way_that_is_too_narrow(world, source, config.robot, config, "--eval-world")
            if source in config.world and not config.random_paths:
                yield from _way_that_is_too_narrow(world, source, config.training_robot, config, "--world")
                yield from _no_start_that_lasts(world, source, config)
    if config.device == "cuda" and not torch.cuda.is_available():
        yield NO_CUDA
    directory = config.directory.absolute()
    place = next(path for path in (directory, *directory.parents) if path.exists())
    if not place.is_dir():
        yield f"{place} is a file, so {config.directory} cannot be a run's directory; choose another (--out)"
    elif not os.access(place, os.W_OK | os.X_OK):
        yield f"{place} is not writable, so {config.directory} cannot be a run's directory; choose another (--out)"
    try:
        needed, size = memory_needed(config), checkpoint_size(config)
    except (ValueError, ArithmeticError, RuntimeError):  # there is no such network, which its own check tells
        return
    checkpoints = len(list((directory / "checkpoints").glob("checkpoint-*")))  # then the run goes on as it was begun
    available = available_memory()
    if available is not None and needed > available:
        yield (
            f"the run takes about {needed / _GIB:.1f} GiB of memory, most of it for --replay-capacity "
            f"({config.replay_capacity}) images of {config.camera.width}x{config.camera.height} pixels, and "
            f"{available / _GIB:.1f} GiB are available; "
            + ("end other programs" if checkpoints else "lower it, or make the images smaller")
        )
    if place.is_dir() and not is_trained:
        wanted, free = max(1, KEPT + 1 - checkpoints) * size, shutil.disk_usage(place).free
        if wanted > free:
            yield (
                f"{place} has {free / _GIB:.2f} GiB of free disk, and the run's checkpoints ({KEPT} are kept while "
                f"another one is written, of {size / _GIB:.2f} GiB each) still take "
                f"{wanted / _GIB:.2f} GiB; make room"
                + (
                    ""
                    if checkpoints
                    else f", choose another directory (--out), or lower --replay-capacity ({config.replay_capacity})"
                )
            )


def _way_that_is_too_narrow(world: World, source: str, robot: Robot, config: TrainConfig, option: str) -> Iterator[str]:
    """The first path of a world along which a robot does not fit.

    World files are checked for the usual robot; training may be with a larger one, and with a margin around it.
    """
    if robot.radius <= TURTLEBOT2.radius and robot.height <= TURTLEBOT2.height:
        return
    for i, j in world.paths:
        start, goal = world.starts[i], world.goals[j]
        assert isinstance(start, Start)
        assert isinstance(goal, Goal)
        length = shortest_path_length(world, start.at, goal.at, robot.radius, robot.height, config.task.goal_radius)
        if not math.isfinite(length):
            size, remedy = f"--robot.radius {config.robot.radius:g}, --robot.height {robot.height:g}", "make it smaller"
            if robot.radius > config.robot.radius:
                size, remedy = f"{size}, --margin {config.margin:g}", "lower the margin, or draw paths (--random-paths)"
            yield (
                f"{source}: no way from starts[{i}] to goals[{j}] is wide and high enough for this robot ({size}); "
                f"{remedy}, or choose another room ({option})"
            )
            return


def _no_start_that_lasts(world: World, source: str, config: TrainConfig) -> Iterator[str]:
    """The first of a world's listed starts, if episodes end in the first step at all of them."""
    equipment = Equipment(config.training_robot, config.camera, config.training_task)
    ended = list(ended_at_once(world, equipment))
    if ended and len(ended) == len(world.starts):
        margin = f", lower --margin ({config.margin:g})" if config.margin else ""
        yield f"{source}: {ended[0]}{margin}, or draw paths (--random-paths)"


def checkpoint_size(config: TrainConfig) -> int:
    """Bytes of a checkpoint of a full replay, at most."""
    # Weights: online, target, two of Adam's, the best.
    return int(_replay_size(config) + 5 * _weights_size(config) + 2 * 2**20)


def memory_needed(config: TrainConfig) -> int:
    """Bytes that a run's processes use together when the replay is full; within a third, as measured."""
    pixels = config.camera.width * config.camera.height
    stack = NUM_FRAMES * pixels
    weights = (6 if config.device == "cpu" else 7) * _weights_size(config)  # as in a checkpoint, and gradients
    batches = 8 * stack * config.steps_per_batch + 24 * stack * config.batch_size
    # Images between those of a stack are kept, too, and histories copied at each step.
    between = 2 * (history_length(config.frame_interval) - NUM_FRAMES) * pixels
    evaluation = (12 * stack + between) * _EVALUATED
    batches += between * config.num_envs
    total = _PROCESS + _replay_size(config) + weights + batches + evaluation
    if config.collector == "async":
        total += _PROCESS + _weights_size(config) + batches
    return int(total)


def available_memory() -> int | None:
    """Bytes that processes started now may use; None where the system does not say.

    The least of what the machine has left and of what each control group that this process is in has left.
    """
    found = [left for left in (_left_on_machine(), *_left_in_groups()) if left is not None]
    return min(found, default=None)


def _left_on_machine() -> int | None:
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            fields = dict(line.split(":", 1) for line in file)
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return None


def _left_in_groups(root: Path = Path("/sys/fs/cgroup"), process: Path = Path("/proc/self/cgroup")) -> Iterator[int]:
    """What is left under each limit of a control group, of either version, that holds for this process."""
    try:
        lines = process.read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if controllers == "":
            top, limit, usage, cache = root, "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            top, limit, usage, cache = (
                root / "memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
                "total_inactive_file",
            )
        else:
            continue
        # In a container the group's path is often the host's, and the limit stands at the top.
        own = top / group.lstrip("/")
        for place in dict.fromkeys((own, *own.parents)):
            if place == top or top in place.parents:
                left = _left_in_group(place, limit, usage, cache)
                if left is not None:
                    yield left


def _left_in_group(place: Path, limit: str, usage: str, cache: str) -> int | None:
    try:
        most, used = (int((place / name).read_text()) for name in (limit, usage))
        statistics = dict(line.split() for line in (place / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):  # no such file, or "max": no limit
        return None
    return max(0, most - used + int(statistics.get(cache, 0)))  # what is cached is given up when asked for


def _replay_size(config: TrainConfig) -> int:
    transitions = min(config.replay_capacity, config.total_steps)
    # A step brings one image, an episode's first step another one; room for a 32nd more is made at a time.
    images = 1.12 * transitions * config.camera.width * config.camera.height
    return int(images + _RECORD * transitions)


def _weights_size(config: TrainConfig) -> int:
    return sum(weight.numel() * weight.element_size() for weight in shapes_of_weights(config).values())
