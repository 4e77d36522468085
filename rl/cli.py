"""The ``navsim`` command: what can be typed, and how mistakes are told. Each command calls one part of the library.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads those of ``_training_settings``, some of which are local to it.
"""

import argparse
import dataclasses
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TextIO, TypeVar, get_type_hints

import tyro
from docstring_parser import parse_from_object
from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitArgPrefixes, Positional, PositionalMetavarFromFieldName, arg
from tyro.extras import SubcommandApp

from rl.cli_world import world_commands
from rl.console import LastingOutput, Output, busy

if TYPE_CHECKING:
    from rl.config import TrainConfig

FAILURE = 1
USAGE_ERROR = 2
INTERRUPTED = 130
BROKEN_PIPE = 141
"""128 and the number of SIGPIPE, which ends other programs then."""

SPINS = "1000"
"""How often PyTorch's threads look whether the others are done before they sleep, some 0.05 ms, in place of 300,000
times: beside another program they would keep from its core the very thread that they wait for (docs/performance.md)."""

_DESCRIPTION = """Train and evaluate robots that find their way by depth images.

Type "navsim COMMAND --help" for all that a command takes, and "navsim --version" for the version."""

_PATHS_HINT = "(default: all, up to 1000 in several worlds; 100 where the world leaves starts or goals open)"

_navsim, _bench = SubcommandApp(), SubcommandApp()


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: what follows ``navsim`` on the command line; by default the process's own arguments.

    Returns:
        the exit status: 0, or 2 for what the user can put right (told in a sentence on standard error), or 1 for what
        has gone wrong on the way (told likewise: a process killed, numbers that are not finite), or 130 after Ctrl-C,
        or 141 if nobody reads on (``navsim train --help | head``). Mistakes of this library leave as exceptions.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # TorchRL would tell of every buffer that it allocates
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    try:
        status = _status_of(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        if not _is_unread(sys.stdout):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more as it ends
        return BROKEN_PIPE
    return status


def _status_of(arguments: list[str]) -> int:
    try:
        _dispatch(arguments)
    except SystemExit as end:  # tyro has printed help, or what is wrong with the arguments
        return end.code if isinstance(end.code, int) else USAGE_ERROR
    except KeyboardInterrupt as interruption:
        print(str(interruption) or "interrupted", file=sys.stderr)
        return INTERRUPTED
    except ChildProcessError as error:  # navsim.processes.WorkerDeathError, without what takes long to import
        print(error, file=sys.stderr)
        return FAILURE
    except (ValueError, OSError) as error:
        if not _is_for_the_user(error):
            raise
        print(f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else error, file=sys.stderr)
        return USAGE_ERROR
    return 0


def _dispatch(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"navsim {_version()}")
    elif arguments[:1] == ["train"]:
        train(*arguments[1:])
    else:
        _navsim.cli(
            prog="navsim",
            description=_DESCRIPTION,
            args=arguments or ["--help"],
            config=(PositionalMetavarFromFieldName, DisallowNone),
        )


def _is_unread(stream: TextIO) -> bool:
    """Whether what is written there has no reader any more."""
    try:
        stream.write("\n")
        stream.flush()
    except BrokenPipeError:
        return True
    return False


def _is_for_the_user(error: ValueError | OSError) -> bool:
    """Whether an error is about a file that the system refuses, or a value that this library itself refuses.

    A ``ValueError`` that comes out of numpy or torch is our own mistake.
    """
    if isinstance(error, OSError):
        return error.filename is not None
    *_, (innermost, _) = traceback.walk_tb(error.__traceback__)
    return innermost.f_globals["__name__"].partition(".")[0] in ("navsim", "rl", "__main__")


def _version() -> str:
    try:
        return metadata.version("navsim-rl")
    except metadata.PackageNotFoundError:
        return "(not installed: running from its source)"


@_navsim.command
def train(*arguments: str) -> None:
    """Train a robot, evaluate it in a room it has never seen, and write a report."""
    config, resume = _training_settings(arguments)
    from rl.background import CollectorError
    from rl.finish import finish
    from rl.run import Run
    from rl.train import train
    from rl.watch import NumbersError

    console = LastingOutput()
    again = shlex.join(["navsim", "train", "--resume", "--out", str(config.directory)])
    try:
        run = train(config, resume=resume, console=console)
        if config.report:
            finish(run, console)
    except CollectorError as error:
        print(f"{error}\nto go on from the last checkpoint: {again}", file=sys.stderr)
        raise SystemExit(FAILURE) from error
    except NumbersError as error:
        print(error, file=sys.stderr)
        raise SystemExit(FAILURE) from error
    except KeyboardInterrupt:
        if not Run(config.directory).exists:
            raise
        raise KeyboardInterrupt(f"stopped; to go on from the last checkpoint: {again}") from None


@_navsim.command
def evaluate(
    run: Positional[str],
    world: Annotated[tuple[str, ...], arg(metavar="WORLD [WORLD ...]")],
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(optional)")] = None,
    seed: int = 0,
    num_paths: Annotated[int | None, arg(help_behavior_hint=_PATHS_HINT)] = None,
    weights: Literal["best", "last"] = "best",
    symmetric: Annotated[Literal["yes", "no"] | None, arg(help_behavior_hint="(default: as it was trained)")] = None,
    sensor: Literal["trained", "ideal", "kinect", "kinect-filled"] = "trained",
    randomized: FlagCreatePairsOff[bool] = False,
) -> None:
    """Drive the paths of a world, or of several, with a trained policy or a baseline, and print how that went.

    Args:
        run: Directory of a run, pretrained:NAME, or one of the baselines random, straight, reactive, oracle.
        world: World files, names of shipped worlds, or generated rooms such as
            generate:clutter,size=7x7,density=0.11,seed=1,count=200 (see "navsim world generate --help").
        json: File to write every path and all the numbers to.
        seed: Seed of whatever the worlds leave open: yaws of starts, starts, goals, which paths of several worlds.
        num_paths: Paths to drive: the first that the world lists, or this many if it leaves starts or goals open; of
            several worlds this many together, evenly shared out.
        weights: Of a run: those that did best in its evaluations, or the last, which nothing was chosen by.
        symmetric: Whether to go by the mean of the network's values for what it sees and for the mirror image of that,
            whatever it was trained for.
        sensor: What makes the images: what it was trained with, nothing (ideal ones), a Kinect with its noise and lost
            returns, or one with the holes that these leave filled in.
        randomized: Draw camera, wheels, sensor and starts for each path, from the ranges the run was trained with.
    """
    from navsim.randomization import Randomization
    from navsim.sensor import SENSORS
    from rl.evaluation import evaluate_as_trained
    from rl.metrics import comparison_table
    from rl.policies import find_policy

    console = Output()
    if json is not None and json.is_dir():
        raise ValueError(f"{json} is a directory; --json names the file to write, such as {json / 'evaluation.json'}")
    policy, config = find_policy(run, weights=weights, symmetric=None if symmetric is None else symmetric == "yes")
    if randomized and config.randomization == Randomization():
        raise ValueError(
            f"{run} was trained without randomization, so there is nothing to draw: leave --randomized out"
        )
    result = evaluate_as_trained(
        policy,
        config,
        world,
        name=(Path(run).resolve() if Path(run).is_dir() else Path(run)).name,
        sensor=SENSORS.get(sensor),
        randomization=config.randomization if randomized else None,
        seed=seed,
        num_paths=num_paths,
        console=console,
    )
    if json is not None:
        result.save(json)  # first: nobody may read the table any more
    console.print(comparison_table([result]))
    if json is not None:
        console.print(f"written to {json}", markup=False)


@_navsim.command
def drive(
    policy: Positional[str],
    world: Annotated[str, arg(metavar="WORLD")],
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")] = Path("drive.mp4"),
    start: Annotated[int | None, arg(help_behavior_hint="(default: the first)")] = None,
    goal: Annotated[int | None, arg(help_behavior_hint="(default: the farthest from a listed start)")] = None,
    seed: int = 0,
    speed: float = 2.0,
    weights: Literal["best", "last"] = "best",
    symmetric: Annotated[Literal["yes", "no"] | None, arg(help_behavior_hint="(default: as it was trained)")] = None,
    sensor: Literal["trained", "ideal", "kinect", "kinect-filled"] = "trained",
) -> None:
    """Film one drive: plan view, depth image, the goal's direction, and the Q-values as bars.

    Args:
        policy: Directory of a run, pretrained:NAME, or one of the baselines random, straight, reactive, oracle.
        world: World file, name of a shipped world, or a generated room such as generate:clutter,density=0.11,seed=3.
        output: Film to write: .mp4 or .gif.
        start: Which of the world's starts, counted from 0 as in pictures and reports.
        goal: Which of the world's goals, counted from 0 as in pictures and reports.
        seed: Seed of whatever the world leaves open: yaws of starts, starts, goals.
        speed: How many times faster than real time the film plays, 0.01 to 100.
        weights: Of a run: those that did best in its evaluations, or the last, which nothing was chosen by.
        symmetric: Whether to go by the mean of the network's values for what it sees and for the mirror image of that,
            whatever it was trained for.
        sensor: What makes the images: what it was trained with, nothing (ideal ones), a Kinect with its noise and lost
            returns, or one with the holes that these leave filled in.
    """
    from navsim.sensor import SENSORS
    from rl.drive import drive as film

    with busy("driving and filming"):
        result = film(
            policy,
            world,
            output,
            start=start,
            goal=goal,
            seed=seed,
            speed=speed,
            weights=weights,
            symmetric=None if symmetric is None else symmetric == "yes",
            sensor=SENSORS.get(sensor),
        )
    print(f"{output}: {result.outcome} after {result.steps} steps, {result.path_length:.1f} m")


@_navsim.command
def report(run: Positional[Path]) -> None:
    """Write a run's HTML report anew, from its logs and evaluations.

    Args:
        run: Directory of the run.
    """
    from rl.report import write_report
    from rl.run import Run

    with busy("writing the report"):
        path = write_report(Run.open(run))
    print(path)


_navsim.command(world_commands, name="world", help="Check, draw, edit, generate, import and export world files.")
_navsim.command(_bench, name="bench", help="Measure how fast this machine simulates and learns.")


@_bench.command(name="camera")
def bench_camera(peers: FlagCreatePairsOff[bool] = False) -> None:
    """Depth images a second of the ray-caster.

    Args:
        peers: Measure other renderers of the same scenes as well, those that are installed.
    """
    from navsim.bench_camera import run

    with busy("rendering"):
        run(peers=peers, console=Output())


@_bench.command(name="world")
def bench_world() -> None:
    """Time to load a world of 10,000 obstacles, and to reset robots in it."""
    from navsim.bench_world import run
    from rl.memory import keep_freed_memory

    keep_freed_memory()  # as training does
    with busy("loading"):
        run(Output())


@_bench.command(name="sensor")
def bench_sensor(world: str = "complex_train") -> None:
    """What a pitched camera and the sensor's noise, losses and latency cost.

    Args:
        world: World file, or name of a shipped world.
    """
    from navsim.bench_sensor import run
    from rl.memory import keep_freed_memory

    keep_freed_memory()  # as training does
    with busy("rendering"):
        run(world=world, console=Output())


@_bench.command(name="env")
def bench_env(world: str = "complex_train") -> None:
    """Transitions a second of the environment, and where their time goes.

    Args:
        world: World file, or name of a shipped world.
    """
    from rl.bench_env import run

    run(Output(), world=world)


@_bench.command(name="generate")
def bench_generate(rooms: int = 100) -> None:
    """Rooms a second of each generator, checked and written as text.

    Args:
        rooms: Rooms to make of each kind.
    """
    from navsim.bench_generate import run

    run(Output(), rooms=rooms)


@_bench.command(name="learner")
def bench_learner(
    num_threads: int = 1, peers: FlagCreatePairsOff[bool] = False, height: int = 64, width: int = 80
) -> None:
    """Updates a second of the learner, beside TorchRL's own loss and the processor's limit.

    Args:
        num_threads: CPU threads.
        peers: Measure Stable-Baselines3's DQN with the same layers as well.
        height: Pixels of an image.
        width: Pixels of an image.
    """
    from rl.bench_learner import run

    run(Output(), num_threads=num_threads, peers=peers, height=height, width=width)


@_bench.command(name="replay")
def bench_replay(peers: FlagCreatePairsOff[bool] = False, capacity: int = 50_000) -> None:
    """Memory and time of the replay, beside TorchRL's own ways to store stacks of images.

    Args:
        peers: Measure Stable-Baselines3's ReplayBuffer as well.
        capacity: Transitions that each replay holds.
    """
    from rl.bench_replay import run

    run(Output(), peers=peers, capacity=capacity)


@_bench.command(name="train")
def bench_train(
    steps: int = 400_000,
    exact: FlagCreatePairsOff[bool] = False,
    collector: Annotated[Literal["both", "sync", "async"], arg(help="Kinds of collector to measure.")] = "both",
    out: Annotated[Path, arg(metavar="FILE")] = Path("bench_train.json"),
) -> None:
    """Seconds in each part of a whole training at the thesis's volume, and memory, with collectors of both kinds.

    Args:
        steps: Transitions in all; with fewer than the thesis's 400,000, its time is extrapolated from the steady rate.
        exact: Batches of 8 and an update a transition, as in the thesis, in place of 64 and an update every 8.
        out: JSON file; what it holds already, measured with the same settings, is not measured again.
    """
    from rl.bench_train import run

    kinds: dict[str, tuple[Literal["sync", "async"], ...]] = {"both": ("sync", "async")}
    kinds |= {"sync": ("sync",), "async": ("async",)}
    run(Output(), steps=steps, exact=exact, collectors=kinds[collector], out=out)


@_bench.command(name="learning")
def bench_learning(
    steps: int = 100_000,
    seeds: tuple[int, ...] = (0, 1, 2),
    collectors: tuple[Literal["sync", "async"], ...] = ("sync", "async"),
    formats: Annotated[
        tuple[Literal["float32", "bfloat16"], ...] | None,
        arg(
            metavar="{float32,bfloat16} [...]",
            help_behavior_hint="(default: both where this processor is faster in bfloat16, else float32)",
        ),
    ] = None,
    num_threads: int = 2,
    runs: Annotated[Path, arg(metavar="DIR")] = Path("runs/bench_learning"),
    results: Annotated[Path, arg(metavar="DIR")] = Path("bench_learning"),
) -> None:
    """Train with each collector and number format, and compare what they learn. Interrupted: run it again.

    Args:
        steps: Transitions in each run.
        seeds: Of the runs with each setting.
        collectors: Kinds of collector to compare.
        formats: Number formats to compare.
        num_threads: CPU threads of each learner. With 1, two of these commands, of different seeds, can run at once.
        runs: Directory for the runs, needed only to go on with them.
        results: Directory for a JSON file of each run, which is not trained again.
    """
    from rl.bench_learning import run
    from rl.series import SeriesError

    try:
        run(
            Output(),
            results=results,
            runs=runs,
            seeds=seeds,
            steps=steps,
            collectors=collectors,
            formats=formats,
            num_threads=num_threads,
        )
    except SeriesError as error:
        print(error, file=sys.stderr)
        raise SystemExit(FAILURE) from None


_Part = TypeVar("_Part")


def _training_settings(arguments: Sequence[str]) -> tuple["TrainConfig", bool]:
    """The settings that the arguments ask for, and whether they are a begun run's, to be gone on with.

    Raises:
        ConfigError: for settings that cannot be used.
        RunError: if they are not those of the run that is to be gone on with.
    """
    from rl.config import DEFAULT_PRESET, PRESETS, ConfigError

    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--preset", nargs="?")
    preset = finder.parse_known_args(arguments)[0].preset
    from rl.run import Run

    try:
        config, resume = _parse(arguments, PRESETS.get(preset, PRESETS[DEFAULT_PRESET]))
    except ConfigError as error:
        if error.config is None:
            raise
        if "--resume" not in arguments or not Run(error.config.directory).exists:
            from rl.feasibility import obstacles

            raise ConfigError("\n".join([str(error), *obstacles(error.config)])) from None
        config, resume = error.config, True  # what the preset has may not suit, but the run's own settings
    run = Run(config.directory)
    if not (resume and run.exists):
        return config, False
    begun = dataclasses.replace(run.config, out=config.directory)
    asked, _ = _parse(arguments, begun)
    if asked.autocast == "auto":  # which has been decided
        asked = dataclasses.replace(asked, autocast=begun.autocast)
    run.check_resumable(asked)
    return asked, True


def _parse(arguments: Sequence[str], default: "TrainConfig") -> tuple["TrainConfig", bool]:
    from navsim.camera import DepthCamera
    from navsim.randomization import Randomization
    from navsim.robot import Robot
    from navsim.sensor import SensorModel
    from navsim.task import Task
    from rl.config import PARTS, Collection, ConfigError, Experiment, Exploration, Learning, Records, TrainConfig

    def part(kind: type[_Part]) -> _Part:
        names = [setting.name for setting in dataclasses.fields(kind)]  # type: ignore[arg-type]
        return kind(**{name: getattr(default, name) for name in names})

    def documented(kind: type) -> Any:
        return arg(constructor=_documented(kind))

    def unchecked(kind: type) -> Any:
        return arg(constructor=_documented(kind, __post_init__=lambda _: None))

    def settings(
        experiment: OmitArgPrefixes[Annotated[Experiment, documented(Experiment)]] = part(Experiment),  # noqa: B008 - frozen
        collection: OmitArgPrefixes[Annotated[Collection, documented(Collection)]] = part(Collection),  # noqa: B008
        learning: OmitArgPrefixes[Annotated[Learning, documented(Learning)]] = part(Learning),  # noqa: B008
        exploration: OmitArgPrefixes[Annotated[Exploration, documented(Exploration)]] = part(Exploration),  # noqa: B008
        records: OmitArgPrefixes[Annotated[Records, documented(Records)]] = part(Records),  # noqa: B008
        camera: Annotated[DepthCamera, unchecked(DepthCamera)] = default.camera,
        task: Annotated[Task, unchecked(Task)] = default.task,
        robot: Annotated[Robot, unchecked(Robot)] = default.robot,
        sensor: Annotated[SensorModel, unchecked(SensorModel)] = default.sensor,
        randomization: Annotated[Randomization, unchecked(Randomization)] = default.randomization,
        resume: FlagCreatePairsOff[bool] = False,
    ) -> tuple[TrainConfig, bool]:
        groups: list[Any] = [experiment, collection, learning, exploration, records]
        values = {name: value for group in groups for name, value in vars(group).items()}
        problems = []
        for (name, kind), given in zip(PARTS.items(), (camera, task, robot, sensor, randomization), strict=True):
            try:
                values[name] = kind(**{field.name: getattr(given, field.name) for field in dataclasses.fields(kind)})
            except ValueError as error:
                problems.append(str(error))
                values[name] = getattr(default, name)
        if problems:  # what is at odds with defaults that take the place of refused values is no problem
            values["randomization"] = default.randomization
        try:
            config = TrainConfig(**values)
        except ConfigError as error:
            raise ConfigError("\n".join([*problems, str(error)]), error.config) from None
        if problems:
            raise ConfigError("\n".join(problems), config)
        return config, resume

    settings.__doc__ = f"""{train.__doc__}

    Args:
        resume: Go on with the run in the run's directory, as it was begun, if there is one.
    """
    return tyro.cli(settings, prog="navsim train", args=arguments)


def _documented(kind: type[_Part], **others: Any) -> type[_Part]:
    """The dataclass with each field's docstring as its help in one piece; tyro keeps the source's line breaks.

    Args:
        kind: the dataclass.
        others: attributes of the class in place of its own.
    """
    hints = get_type_hints(kind, include_extras=True)
    told = {field.arg_name: " ".join((field.description or "").split()) for field in parse_from_object(kind).params}
    fields: list[Any] = [
        (setting.name, Annotated[hints[setting.name], arg(help=told[setting.name])], setting)
        for setting in dataclasses.fields(kind)  # type: ignore[arg-type]
    ]
    namespace = {"__doc__": kind.__doc__, **others}
    return dataclasses.make_dataclass(kind.__name__, fields, bases=(kind,), namespace=namespace, frozen=True)


if __name__ == "__main__":
    sys.exit(main())
