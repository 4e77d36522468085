"""Every setting of a training run, its unit, its presets and its checks. This dataclass *is* the command line."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field
from functools import cache
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from navsim.camera import DepthCamera
from navsim.errors import WorldError
from navsim.randomization import Randomization
from navsim.robot import Robot
from navsim.sensor import SensorModel
from navsim.task import Task
from navsim.worldsource import check_sources, is_generated, short_name
from rl.observation import DepthScale, HeadingInit, Input, Model, check_inputs

LEAST_WIDTH, LEAST_HEIGHT = 14, 10
"""Of images, pixels: the size of the networks' first kernel (``rl.networks``)."""


GREATEST_MARGIN = 0.2
"""Metres. Gaps in generated rooms are 1 m wide, and the depth rule makes a robot that turns effectively 0.8 m wide, or
1.2 m with this margin: with more, there would be little left to train in."""

GREATEST_SEED = 2**32 - 1

_BEFORE = {"margin": 0.0, "symmetric": False}
"""Settings that came later, as all runs from before them had it, where that is not the default."""

PARTS: dict[str, type] = {
    "camera": DepthCamera,
    "task": Task,
    "robot": Robot,
    "sensor": SensorModel,
    "randomization": Randomization,
}
"""Settings that are of the simulator's own kinds; ``--camera.width`` is one of the first's."""


class ConfigError(ValueError):
    """Settings that cannot be used; every problem has a line of its own.

    Args:
        message: the problems.
        config: the settings, where there are some.
    """

    def __init__(self, message: str, config: TrainConfig | None = None) -> None:
        super().__init__(message)
        self.config = config


@dataclass(frozen=True)
class Experiment:
    """What is trained, where, and for how long."""

    preset: Literal["fast", "memoryless", "thesis"] = "memoryless"
    """Where the other settings start from: "fast" reaches most goals soonest, with a robot that remembers what it has
    passed; "memoryless" learns longer, from the thesis's inputs alone; "thesis" is Weideman's experiment."""
    model: Model = "I"
    """How the network gets the heading: "I" as a fifth image plane, "S" as a scalar beside the image's features."""
    inputs: tuple[Input, ...] = ("depth", "heading")
    """What the network sees: the thesis's two, or one of them alone (what is the other worth?); besides them "command",
    the speeds (v, ω) that the robot was last told, and "surroundings", how near the last six seconds of images and the
    robot's odometry have things in 36 directions around it."""
    frame_interval: int = 1
    """Steps from one depth image of the stack to the next: 3 makes the four images reach back 1.8 s, not 0.6 s."""
    depth_scale: DepthScale = "linear"
    """How the network sees depth: "linear", as in the thesis, or "inverse", 0.4 m over depth, which magnifies what is
    near."""
    heading_init: HeadingInit = "spread"
    """How D3QN-S's weights for the heading begin: "spread", so that it matters from the first update on, or "glorot",
    as all other weights do."""
    centred: bool = False
    """Whether images and D3QN-I's heading plane are centred on zero before they enter the network, so that fewer of its
    first layer's kernels fall silent for ever."""
    symmetric: bool = True
    """Whether evaluations, and whoever loads the policy, go by the mean of the network's values for what it sees and
    for the mirror image of that (left and right swapped), each turn's with that of the turn the other way. Training is
    the same."""
    world: tuple[str, ...] = (
        "generate:clutter,density=0.11,count=100",
        "generate:clutter,density=0.17,count=100",
        "complex_train",
    )
    """Generated rooms to train in, so many of a kind, or world files, or names of shipped worlds such as
    "complex_train"; with several worlds, each episode draws one."""
    eval_world: str = "complex_eval"
    """World file, name of a shipped world, or generated rooms, that evaluations use. Nothing is trained there unless
    --world names it, too."""
    total_steps: int = 400_000
    """Environment steps (transitions) to collect in all; one is 0.2 s of one robot."""
    seed: int = 0
    """Seed of everything random. Same seed, machine, versions and --autocast: the same run."""
    out: Path | None = None
    """The run's directory; by default runs/PRESET-MODEL-seedSEED, with other worlds' names before the seed."""


@dataclass(frozen=True)
class Collection:
    """How transitions are collected, and how many for each gradient step."""

    num_envs: int = 16
    """Robots simulated together."""
    random_paths: bool = True
    """Whether training draws starts and goals anywhere in the room, not only where the world file lists them."""
    margin: float = 0.1
    """Metres by which training is stricter than evaluations: it ends where something is seen nearer than
    --task.collision-depth and so much, and where a robot with that much more radius would touch something. So robots
    learn to keep away from what has left their view. Shares of success in the log are by the stricter rules."""
    rearrangements: int = 200
    """Rooms to train in beside each world file: its furniture in so many random arrangements. Generated rooms have
    none: --world says how many there are."""
    steps_per_batch: int = 64
    """Transitions collected between two visits to the learner, all robots together."""
    steps_per_update: float = 16.0
    """Transitions collected for each gradient step."""
    warmup_steps: int = 5_000
    """Transitions collected before the first gradient step."""
    collector: Literal["sync", "async"] = "sync"
    """Whether collecting and learning take turns, bit-reproducibly and with both cores for learning, or run at once in
    two processes, which pays where simulating takes long."""
    steps_per_handover: int = 64
    """Transitions between two handovers of the network to an asynchronous collector, or from a GPU."""
    worker_timeout: float = 120.0
    """Seconds without a sign of life after which the process of an asynchronous collector is replaced."""


@dataclass(frozen=True)
class Exploration:
    """Random actions: their share falls linearly as training goes on."""

    epsilon_start: float = 1.0
    """Share of random actions at the beginning."""
    epsilon_end: float = 0.1
    """Share of random actions at the end of the descent."""
    epsilon_least: float | None = 0.001
    """Least share at the end, where robots differ: spread by equal factors from here to --epsilon-end. None: alike."""
    epsilon_steps: int = 50_000
    """Transitions over which the share of random actions falls linearly."""


@dataclass(frozen=True)
class Learning:
    """Double deep Q-learning from the replay."""

    gamma: float = 0.97
    """Discount of a reward one step later."""
    n_step: int = 12
    """Rewards summed before the value of the state reached is added. What a robot without a memory runs into has left
    its view seconds before: returns that reach as far need no value in between, which could not tell that it is there.
    """
    batch_size: int = 64
    """Transitions a gradient step learns from."""
    replay_capacity: int = 100_000
    """Transitions kept for replay."""
    prioritized: bool = False
    """Whether transitions are sampled by their last error (Schaul et al. 2016) instead of evenly."""
    mirror: bool = True
    """Whether half of each batch is mirrored: image flipped, heading negated, left and right turns swapped."""
    learning_rate: float = 5e-4
    """Adam's step size."""
    learning_rate_decay: Literal["none", "cosine"] = "cosine"
    """How the learning rate falls over the run: not at all, or to zero along half a cosine."""
    loss_function: Literal["l2", "smooth_l1", "categorical"] = "categorical"
    """Penalty: mean squared error, Huber's, or cross-entropy of a predicted distribution of returns (C51, --atoms)."""
    atoms: int = 51
    """Returns that a categorical loss tells apart."""
    least_return: float = -1.5
    """The least of them: the collision's reward and some to spare."""
    greatest_return: float = 2.5
    """The greatest of them: 1/(1 - gamma) times the reward of a step at full speed towards the goal, about."""
    max_grad_norm: float | None = 10.0
    """Norm that gradients are clipped to; None leaves them."""
    target_update: Literal["soft", "hard"] = "soft"
    """How the target network follows: a little at every gradient step, or by a copy now and then."""
    tau: float = 0.005
    """Share of the online network taken at each soft update."""
    hard_update_interval: int = 1_000
    """Gradient steps between two hard copies."""
    autocast: Literal["auto", "float32", "bfloat16"] = "auto"
    """Number format of the networks' multiplications; "auto" measures in which an update is faster here, and writes the
    answer into config.json."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the learner's networks are; robots are simulated, and their policy evaluated, on the CPU."""
    num_threads: int = 2
    """CPU threads for the learner's networks; an asynchronous collector has one of its own besides; 1 is the
    faster where another program keeps a core busy."""


@dataclass(frozen=True)
class Records:
    """What is kept of a run, and how often."""

    eval_interval: int = 50_000
    """Transitions between two evaluations; the best one's weights are kept."""
    log_interval: int = 4_000
    """Transitions between two rows of the log."""
    checkpoint_interval: int = 50_000
    """Transitions between two checkpoints, from which a run can be resumed."""
    report: bool = True
    """Whether a finished run is evaluated beside the baselines and written up as an HTML report."""


@dataclass(frozen=True)
class TrainConfig(Records, Learning, Exploration, Collection, Experiment):
    """Every setting of a run. The parts it is made of are the groups of ``navsim train --help``.

    The fields' own defaults are the preset "memoryless"; ``PRESETS`` has the others, and ``navsim train`` starts from
    ``DEFAULT_PRESET``.

    Raises:
        ConfigError: for settings that cannot be used.
    """

    camera: DepthCamera = field(default_factory=DepthCamera)
    """The depth camera."""
    task: Task = field(default_factory=Task)
    """Rewards, ends and time limit."""
    robot: Robot = field(default_factory=Robot)
    """The robot."""
    sensor: SensorModel = field(default_factory=SensorModel)
    """What the depth sensor makes of ideal images, in training and in evaluations."""
    randomization: Randomization = field(default_factory=Randomization)
    """What differs from one episode to the next, in training."""

    def __post_init__(self) -> None:
        problems = list(self._of_another_kind()) or list(self._problems())
        if problems:
            raise ConfigError("\n".join(problems), self)

    def _of_another_kind(self):
        for name, hint in _hints().items():
            value = getattr(self, name)
            if get_origin(hint) is Literal and value not in get_args(hint):
                yield f"--{_flag(name)} must be one of {', '.join(map(str, get_args(hint)))}; got {value!r}"
            elif hint is int and not isinstance(value, Integral):
                yield f"--{_flag(name)} must be a whole number; got {value!r}"

    def _problems(self):
        positive = (
            "total_steps num_envs steps_per_batch steps_per_update n_step batch_size replay_capacity learning_rate"
            " hard_update_interval steps_per_handover worker_timeout epsilon_steps eval_interval log_interval"
            " checkpoint_interval frame_interval num_threads"
        )
        for name in positive.split():
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                yield f"--{_flag(name)} must be positive; got {value}"
        if not 0.0 <= self.margin <= GREATEST_MARGIN:
            yield f"--margin must lie between 0 and {GREATEST_MARGIN} m; got {self.margin}"
        for name in ("gamma", "epsilon_start", "epsilon_end", "tau"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                yield f"--{_flag(name)} must lie between 0 and 1; got {getattr(self, name)}"
        if not 0 <= self.seed <= GREATEST_SEED:
            yield f"--seed must lie between 0 and {GREATEST_SEED}; got {self.seed}"
        if not self.world:
            yield "--world needs at least one world file or name"
        for source in (*self.world, self.eval_world):
            try:
                check_sources(source)
            except WorldError as error:
                yield str(error)
        try:
            check_inputs(self.inputs)
        except ValueError as error:
            yield f"--{error}"
        if self.rearrangements < 0:
            yield f"--rearrangements must not be negative; got {self.rearrangements}"
        if self.rearrangements and not self.random_paths and not all(map(is_generated, self.world)):
            yield (
                f"--rearrangements ({self.rearrangements}) needs --random-paths: listed starts and goals do not fit "
                "rooms whose furniture was moved; set it to 0 to train on the listed ones"
            )
        if self.random_paths and self.randomization.moves_starts:
            yield (
                "--randomization.start-distance and --randomization.start-turn-deg move listed starts, and training "
                "draws starts anywhere; add --no-random-paths, or leave them out"
            )
        if self.epsilon_end > self.epsilon_start:
            yield f"--epsilon-end ({self.epsilon_end}) must not exceed --epsilon-start ({self.epsilon_start})"
        if self.epsilon_least is not None and not 0.0 < self.epsilon_least <= self.epsilon_end:
            yield (
                f"--epsilon-least ({self.epsilon_least}) must lie between 0 and --epsilon-end ({self.epsilon_end}), "
                "or be None"
            )
        if self.epsilon_least is not None and self.num_envs == 1:
            yield (
                f"--epsilon-least ({self.epsilon_least}) spreads shares of random actions over several robots, and "
                f"--num-envs is 1; set it to None, and --epsilon-end ({self.epsilon_end}) to the share that is wanted"
            )
        if self.mirror and self.batch_size == 1:
            yield "--mirror needs samples that can be halved, and --batch-size is 1; make it larger, or add --no-mirror"
        if self.loss_function == "categorical" and self.atoms < 2:
            yield f"--atoms must be at least 2; got {self.atoms}"
        for name in ("least_return", "greatest_return"):
            if not math.isfinite(getattr(self, name)):
                yield f"--{_flag(name)} must be a finite number; got {getattr(self, name)}"
        if not self.least_return < self.greatest_return:
            yield f"--least-return ({self.least_return}) must be below --greatest-return ({self.greatest_return})"
        if self.steps_per_batch % max(self.num_envs, 1):
            yield (
                f"--steps-per-batch ({self.steps_per_batch}) must be a multiple of --num-envs ({self.num_envs}): "
                "the robots move together"
            )
        if self.batch_size > self.replay_capacity:
            yield f"--batch-size ({self.batch_size}) must not exceed --replay-capacity ({self.replay_capacity})"
        if not self.batch_size <= self.warmup_steps <= self.replay_capacity:
            yield (
                f"--warmup-steps ({self.warmup_steps}) must lie between --batch-size ({self.batch_size}) and "
                f"--replay-capacity ({self.replay_capacity})"
            )
        if self.batch_size <= self.warmup_steps and self._first_update <= self.n_step * self.num_envs:
            yield (
                f"--warmup-steps ({self.warmup_steps}) is too short: it takes more than --n-step ({self.n_step}) "
                f"times --num-envs ({self.num_envs}) transitions until a return is known that can be learnt from"
            )
        if self.warmup_steps + self.steps_per_update > self.total_steps:
            yield (
                f"--total-steps ({self.total_steps}) must be at least --warmup-steps ({self.warmup_steps}) and "
                f"--steps-per-update ({self.steps_per_update:g}) together: nothing would be learnt"
            )
        mirroring = [f"--no-{name}" for name in ("mirror", "symmetric") if getattr(self, name)]
        left, right = self.randomization.camera_left
        if mirroring and self.sees_to_one_side:
            yield (
                f"--camera.mount-y ({self.camera.mount_y}) and --randomization.camera-left ({left} {right}) put the "
                f"camera more to one side, so that a mirror image is not what this robot sees; add "
                f"{' '.join(mirroring)}"
            )
        if self.camera.width < LEAST_WIDTH or self.camera.height < LEAST_HEIGHT:
            yield (
                f"--camera.width ({self.camera.width}) and --camera.height ({self.camera.height}) must be at least "
                f"{LEAST_WIDTH} and {LEAST_HEIGHT} pixels: the networks' first kernel is that large"
            )
        if 0.0 <= self.margin <= GREATEST_MARGIN:
            try:
                self.training_task.check_camera(self.camera)
                self.randomization.check(self.camera, self.training_task, self.sensor)
            except ValueError as error:
                yield str(error)
        if self.max_grad_norm is not None and not (math.isfinite(self.max_grad_norm) and self.max_grad_norm > 0):
            yield f"--max-grad-norm must be positive and finite, or None; got {self.max_grad_norm}"

    @property
    def _first_update(self) -> float:
        """Transitions collected before it, in whole batches."""
        if not (self.steps_per_batch > 0 and math.isfinite(self.steps_per_update)):
            return math.inf  # which is told for itself
        return self.steps_per_batch * math.ceil((self.warmup_steps + self.steps_per_update) / self.steps_per_batch)

    @property
    def training_task(self) -> Task:
        """The rules that training goes by: ``task``, stricter by ``margin``."""
        return dataclasses.replace(self.task, collision_depth=self.task.collision_depth + self.margin)

    @property
    def training_robot(self) -> Robot:
        """The robot that trains: ``robot``, wider by ``margin``."""
        return dataclasses.replace(self.robot, radius=self.robot.radius + self.margin)

    @property
    def directory(self) -> Path:
        """Where the run's files go."""
        if self.out is not None:
            return self.out
        named: list[str] = [self.preset, self.model]
        if self.world != PRESETS[self.preset].world:
            named.append("+".join(map(short_name, self.world)))
        return Path("runs") / "-".join([*named, f"seed{self.seed}"])

    @property
    def sees_to_one_side(self) -> bool:
        """Whether the camera is more to one side, so that the mirror image of what it sees is none that it sees."""
        left, right = self.randomization.camera_left
        return self.camera.mount_y != 0.0 or left != -right

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain values, for JSON."""
        return json.loads(json.dumps(dataclasses.asdict(self), default=str))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TrainConfig:
        """The inverse of ``to_dict``, also of what earlier versions wrote.

        Raises:
            ConfigError: for keys that are not settings, or values that cannot be used.
        """
        values = _BEFORE | values
        unknown = sorted(set(values) - {setting.name for setting in dataclasses.fields(cls)})
        if unknown:
            raise ConfigError(f"unknown settings: {', '.join(unknown)}; was this written by another version?")
        try:
            for name, part in PARTS.items():
                if name in values:
                    values[name] = part(**{key: _untied(value) for key, value in values[name].items()})
        except (AttributeError, TypeError, ValueError) as error:  # no mapping at all, unknown keys, wrong values
            raise ConfigError(f"settings of the {name} cannot be used: {error}") from error
        if "num_threads" in values and values["num_threads"] is None:  # earlier versions' way to say what is default
            del values["num_threads"]
        try:
            for name in ("world", "inputs"):
                if name in values:
                    values[name] = tuple(values[name])
            if values.get("out") is not None:
                values["out"] = Path(values["out"])
            return cls(**values)
        except (ArithmeticError, AttributeError, TypeError) as error:  # an infinite number of steps, a list as a number
            raise ConfigError(f"a value is of another kind than its setting: {error}") from error


@cache
def _hints() -> dict[str, Any]:
    """What kind of value each setting is."""
    return get_type_hints(TrainConfig)


def _untied(value: Any) -> Any:
    """A setting as JSON gives it back, whose tuples have become lists."""
    return tuple(value) if isinstance(value, list) else value


def _flag(name: str) -> str:
    return name.replace("_", "-")


DEFAULT_PRESET = "fast"
"""What ``navsim train`` starts from."""

PRESETS: dict[str, TrainConfig] = {
    "fast": TrainConfig(
        preset="fast",
        inputs=("depth", "heading", "command", "surroundings"),
        depth_scale="inverse",
        symmetric=False,
        total_steps=100_000,
        steps_per_update=8.0,
        epsilon_end=0.3,
        epsilon_steps=25_000,
        n_step=5,
        eval_interval=12_500,
        checkpoint_interval=25_000,
    ),
    "memoryless": TrainConfig(),
    # Section 5.3 of the thesis; what it leaves open is listed in docs/thesis.md.
    "thesis": TrainConfig(
        preset="thesis",
        heading_init="glorot",
        symmetric=False,
        world=("complex_train",),
        num_envs=8,
        random_paths=False,
        margin=0.0,
        rearrangements=0,
        steps_per_batch=8,
        steps_per_update=1.0,
        warmup_steps=1_000,
        gamma=0.99,
        n_step=1,
        batch_size=8,
        replay_capacity=50_000,
        mirror=False,
        learning_rate=1e-4,
        learning_rate_decay="none",
        loss_function="l2",
        max_grad_norm=None,
        tau=0.001,
        epsilon_end=0.01,
        epsilon_least=None,
        eval_interval=25_000,
    ),
}
