"""Feeds broken files to the readers and looks for anything but a world or a sentence.

Each target (``world``, ``use``, ``schema``, ``sdf``, ``ros-map``, ``ir-sim``, ``source``) runs in a process of its own,
one after the other, for its share of the time. An input is a finding when it ends in another exception than the
reader's own, takes more than 2 s of processor time or 1 GB of memory, or takes the process down. It is written to the
directory of findings, with the traceback beside it.

    python scripts/fuzz.py --minutes 30                          every target
    python scripts/fuzz.py sdf ros-map --minutes 10 --seed 3     two of them
    python scripts/fuzz.py sdf --replay findings/sdf-1f2e3d4c    one input again

With atheris (https://github.com/google/atheris) installed, coverage leads the way. Without it, files are mutated at
random, and those that are answered in a new way are mutated further.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "navsim")]

MOST_SECONDS = 2.0
"""Of processor time that an input may take."""
MOST_MEMORY = 2**30
"""Bytes that reading an input may add to the process."""
SILENCE = 120.0
"""Seconds without a sign of life after which a process counts as hung; instrumenting takes half a minute on its own."""
MOST_ADDRESSES = 6 * 2**30
"""Bytes of address space of a process, lest a finding take the machine down."""
LARGEST_INPUT = 64 * 2**10
"""Bytes."""
PICTURE = b"\n\0PICTURE\0\n"
"""What parts the two files of a map in an input."""

TOKENS = [
    *(
        b"0 -1 1e308 -1e308 1e-308 1e999 .nan .inf -.inf nan inf 1e9 1e4 10000 1e-6 0.1755 ~ null true random none"
    ).split(),
    *(b"[] {} &a *a <<: !!python/object:os.system !!binary !!set !!omap --- ... ? - : , # ' \" | > % @ `").split(),
    *(b"box: cylinder: polygon: at: size: points: height: base: radius: yaw_deg: motion: path: hinge:").split(),
    *(b"swing_deg: speed_deg: speed: pushable: mass: repeat: circuit starts: goals: walls: name: format:").split(),
    *(
        b"<model> </model> <link> <pose> </pose> <box> <include> <uri> <!DOCTYPE <!ENTITY &a; <![CDATA[ ]]> <!-- -->"
    ).split(),
    *(b"image: resolution: origin: negate: mode: scale raw occupied_thresh: free_thresh: P5 P2 P6 IHDR IDAT").split(),
    *(
        b"world: robot: obstacle: shape: linestring compound circle rectangle number: distribution: loop: behavior:"
    ).split(),
    *(
        b"generate: density= size= count= seed= 999999999999 1e400 \xef\xbb\xbf \xff \0 \r \xc2\x85 \xe2\x80\xa8"
    ).split(),
    b"9" * 400,
    b"[" * 60,
    b"<a>" * 120,
    b"\n",
    b"\n  ",
    b" ",
]
"""What mutations put in: the formats' words, and numbers at the edge of everything."""
_NUMBER = re.compile(rb"[-+]?[0-9]+(?:\.[0-9]*)?")


class Target(NamedTuple):
    """A reader, and files that it reads."""

    seeds: Callable[[], Iterable[bytes]]
    run: Callable[[bytes, Path], str]
    """Reads an input in a directory of its own; returns the refusal, empty for none. What it raises is a finding."""
    packages: tuple[str, ...]
    """Instrumented for coverage."""
    most_seconds: float = MOST_SECONDS


def _refusal(error: Exception) -> str:
    """The message of a documented error, once it is seen to be one sentence a problem."""
    message = str(error)
    problems = getattr(error, "problems", (message,))
    assert problems, "a refusal without a reason"
    for problem in problems:
        assert problem.strip(), "an empty refusal"
        assert "\n" not in problem, f"a refusal of several lines: {problem!r}"
        assert "Traceback" not in problem, problem
    return message


def _world_seeds() -> list[bytes]:
    import world_corpus

    shipped = [path.read_bytes() for path in sorted((ROOT / "worlds").glob("*.yaml"))]
    texts = [*world_corpus.RIGHT.values(), *world_corpus.WRONG_YAML.values(), *world_corpus.WRONG_GEOMETRY.values()]
    return [*(text.encode() for text in texts), *shipped]


def _read_world(data: bytes, directory: Path) -> str:
    from navsim.errors import WorldError
    from navsim.worldfile import dump_world, parse_text

    try:
        world = parse_text(data, source="room.yaml")
    except WorldError as error:
        return _refusal(error)
    assert parse_text(dump_world(world)) == world, "a saved world is not read back"
    return ""


def _use_world(data: bytes, directory: Path) -> str:
    """What ``navsim world check``, ``navsim world show`` and a simulator do with a file."""
    import numpy as np
    from rich.console import Console

    import navsim
    from navsim.check import check_text
    from navsim.diagnostics import print_reports
    from navsim.show import save_plan_view

    report = check_text(data, "room.yaml")
    quiet = Console(file=(directory / "report.txt").open("w"), width=100)
    print_reports([report], quiet, quiet, paths=True)
    if report.world is None:
        return "; ".join(finding.text for finding in report.errors)
    save_plan_view(report.world, directory / "plan.png")
    try:
        simulator = navsim.Simulator(report.world, num_robots=2, seed=0)
        simulator.reset()
        simulator.step(np.full(2, 1))
    except ValueError as error:  # that no place for a random start was found, say
        if "has no room for an episode" not in str(error):
            raise
        return _refusal(error)
    return ""


def _check_schema(data: bytes, directory: Path) -> str:
    """The schema holds what the loader accepts, and never fails."""
    import jsonschema

    from navsim.errors import WorldError
    from navsim.schema import world_schema
    from navsim.world import parse_world
    from navsim.worldfile import decoded, read_document

    try:
        document = read_document(decoded(data, "room.yaml"), "room.yaml")
    except WorldError as error:
        return _refusal(error)
    world, problems = parse_world(document.data)
    errors = list(jsonschema.Draft202012Validator(world_schema()).iter_errors(document.data))
    assert world is None or not errors, f"the schema refuses what the loader takes: {errors[0].message}"
    return "; ".join(problem.text for problem in problems)


def _sdf_seeds() -> list[bytes]:
    data = ROOT / "tests" / "navsim" / "convert" / "data"
    return [path.read_bytes() for path in (data / "lab.world", data / "models" / "shelf" / "shelf.sdf")]


def _read_sdf(data: bytes, directory: Path) -> str:
    from navsim.convert import ConversionError, load_sdf

    path = directory / "room.sdf"
    path.write_bytes(data)
    models = [ROOT / "tests" / "navsim" / "convert" / "data" / "models"]
    try:
        load_sdf(path, model_paths=models, approximate="convex-hull", pushable=True)
    except ConversionError as error:
        return _refusal(error)
    return ""


def _map_seeds() -> list[bytes]:
    import io

    import numpy as np
    from PIL import Image

    import navsim
    from navsim.convert import save_ros_map

    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "map.yaml"
        save_ros_map(navsim.load_world("simple_eval"), path, resolution=0.2)
        settings, picture = path.read_bytes(), path.with_suffix(".pgm").read_bytes()
    seeds = [settings + PICTURE + picture, settings.replace(b"trinary", b"scale") + PICTURE + picture]
    pixels = np.full((12, 14), 254, np.uint8)
    pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1], pixels[5:7, 6:9] = 0, 0, 0, 0, 205
    for kind in ("PNG", "BMP", "GIF", "TIFF", "JPEG"):
        content = io.BytesIO()
        Image.fromarray(pixels).save(content, kind)
        seeds.append(settings + PICTURE + content.getvalue())
    text = b"P2\n14 12\n255\n" + b" ".join(b"%d" % value for value in pixels.ravel())
    return [*seeds, settings + PICTURE + text]


def _read_map(data: bytes, directory: Path) -> str:
    from navsim.convert import ConversionError, load_ros_map

    settings, _, picture = data.partition(PICTURE)
    (directory / "map.yaml").write_bytes(settings)
    for name in ("map.pgm", "simple_eval.pgm"):
        (directory / name).write_bytes(picture)
    try:
        load_ros_map(directory / "map.yaml")
    except ConversionError as error:
        return _refusal(error)
    return ""


def _irsim_seeds() -> list[bytes]:
    return [(ROOT / "tests" / "navsim" / "convert" / "data" / "irsim.yaml").read_bytes()]


def _read_irsim(data: bytes, directory: Path) -> str:
    from navsim.convert import ConversionError, load_irsim

    path = directory / "irsim.yaml"
    path.write_bytes(data)
    try:
        load_irsim(path)
    except ConversionError as error:
        return _refusal(error)
    return ""


def _source_seeds() -> list[bytes]:
    return [f"generate:{kind},size=4x3,density=0.1,seed=2,count=1".encode() for kind in ("clutter", "blocks", "forest")]


def _read_source(data: bytes, directory: Path) -> str:
    from navsim.errors import WorldError
    from navsim.worldsource import PREFIX, parse_source

    try:
        parse_source(PREFIX + data.decode(errors="replace").removeprefix(PREFIX))
    except WorldError as error:
        return str(error)
    return ""


_YAML = ("navsim.worldfile", "navsim.world", "navsim.rules", "navsim.motion_rules", "navsim.polygon", "navsim.dynamics")
TARGETS = {
    "world": Target(_world_seeds, _read_world, _YAML),
    "use": Target(
        _world_seeds, _use_world, (*_YAML, "navsim.check", "navsim.oddities", "navsim.show", "navsim.task"), 10.0
    ),
    "schema": Target(_world_seeds, _check_schema, _YAML),
    "sdf": Target(_sdf_seeds, _read_sdf, ("navsim.convert", "navsim.polygon")),
    "ros-map": Target(_map_seeds, _read_map, ("navsim.convert", "navsim.polygon")),
    "ir-sim": Target(_irsim_seeds, _read_irsim, ("navsim.convert", "navsim.polygon")),
    "source": Target(_source_seeds, _read_source, ("navsim.worldsource", "navsim.generate.rooms")),
}


def mutated(data: bytes, others: list[bytes], generator: random.Random) -> bytes:
    """``data`` after a few random edits; pieces come from ``others`` as well."""
    for _ in range(generator.choice((1, 1, 2, 3, 6))):
        at = generator.randrange(len(data) + 1)
        end = min(len(data), at + generator.choice((0, 1, 2, 5, 20, 200)))
        kind = generator.randrange(8)
        numbers = list(_NUMBER.finditer(data)) if kind <= 1 else []
        if numbers:
            found = generator.choice(numbers)
            number = b"%g" % (generator.choice((-1, 1)) * 10.0 ** generator.uniform(-9, 9))
            token = generator.choice((number, *TOKENS[:20]))
            data = data[: found.start()] + token + data[found.end() :]
        elif kind == 2:
            data = data[:at] + generator.choice(TOKENS) + data[at:]
        elif kind == 3:
            data = data[:at] + data[end:]
        elif kind == 4:
            data = data[:at] + data[at:end] * generator.choice((2, 3, 50)) + data[end:]
        elif kind == 5:
            other = generator.choice(others)
            begin = generator.randrange(len(other) + 1)
            data = data[:at] + other[begin : begin + generator.choice((5, 50, 500))] + data[end:]
        elif kind == 6:
            lines = data.split(b"\n")
            i, j = generator.randrange(len(lines)), generator.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
            data = b"\n".join(lines)
        else:
            data = data[:at] + generator.randbytes(generator.randrange(1, 4)) + data[end:]
    return data[:LARGEST_INPUT]


class Watch:
    """Runs inputs of one target, and keeps those that are findings."""

    def __init__(self, name: str, findings: Path, directory: Path) -> None:
        self.name, self.target = name, TARGETS[name]
        self.executions = 0
        self._findings, self._directory, self._known = findings, directory, set[str]()
        self._told = time.monotonic()
        self.target.run(next(iter(self.target.seeds())), directory)  # imports what it needs, which is not measured

    def run(self, data: bytes) -> str | None:
        """What the reader said about an input; None for a finding."""
        (self._directory / "current").write_bytes(data)
        peak, held = _peak_memory(), psutil.Process().memory_info().rss
        begin = time.process_time()
        found = ""
        try:
            answer = self.target.run(data, self._directory)
        except Exception as error:
            answer, found = None, "".join(traceback.format_exception(error))
            self._keep(data, _signature(error), found)
        seconds, memory = time.process_time() - begin, _peak_memory()
        if seconds > self.target.most_seconds:
            answer = None
            self._keep(data, "slow", f"took {seconds:.1f} s of processor time\n")
        if memory > peak and memory - held > MOST_MEMORY:  # atheris takes more and more itself, a gigabyte in minutes
            answer = None
            self._keep(data, "memory", f"took {(memory - held) / 2**20:.0f} MiB\n")
        self.executions += 1
        if time.monotonic() - self._told > 1.0:
            self.tell()
        return answer

    def tell(self) -> None:
        """Writes a line for the process that watches this one."""
        self._told = time.monotonic()
        print(json.dumps({"executions": self.executions}), flush=True)

    def _keep(self, data: bytes, signature: str, text: str) -> None:
        if signature in ("slow", "memory") and f"{signature} 10" in self._known:
            return
        if signature in ("slow", "memory"):
            signature = f"{signature} {sum(known.startswith(signature) for known in self._known) + 1}"
        if signature in self._known:
            return
        self._known.add(signature)
        keep(self._findings, self.name, data, f"{signature}\n\n{text}")


def keep(findings: Path, target: str, data: bytes, text: str) -> None:
    """Writes an input and what it did."""
    findings.mkdir(parents=True, exist_ok=True)
    path = findings / f"{target}-{hashlib.sha256(data).hexdigest()[:8]}"
    path.write_bytes(data)
    path.with_suffix(".txt").write_text(text, encoding="utf-8")


def _signature(error: Exception) -> str:
    """What two findings of the same cause have in common: the kind, and the last places in this project's code."""
    frames: list[str] = []
    step: TracebackType | None = error.__traceback__
    while step is not None:
        file = Path(step.tb_frame.f_code.co_filename)
        if ROOT in file.parents:
            frames.append(f"{file.name}:{step.tb_lineno}")
        step = step.tb_next
    return f"{type(error).__name__} at {' '.join(frames[-2:])}"


def _peak_memory() -> int:
    """Bytes that the process has had in memory at most."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def work(name: str, minutes: float, seed: int, engine: str, findings: Path, directory: Path) -> None:
    """Feeds one target for some time; the other process watches."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    if engine == "atheris":
        _work_with_atheris(name, minutes, seed, findings, directory)
        return
    watch = Watch(name, findings, directory)
    generator = random.Random(seed)
    corpus = list(watch.target.seeds())
    answers = {_answer_kind(watch.run(data)) for data in corpus}
    deadline = time.monotonic() + 60.0 * minutes
    while time.monotonic() < deadline:
        data = mutated(generator.choice(corpus), corpus, generator)
        answer = _answer_kind(watch.run(data))
        if answer not in answers and len(data) < 20_000:
            answers.add(answer)
            corpus.append(data)
    watch.tell()


def _answer_kind(answer: str | None) -> str:
    """An answer without what differs from file to file."""
    return re.sub(r"'[^']*'|[-+0-9.e]+", "#", answer or "")[:80]


def _work_with_atheris(name: str, minutes: float, seed: int, findings: Path, directory: Path) -> None:
    import atheris

    with atheris.instrument_imports(include=list(TARGETS[name].packages)):
        watch = Watch(name, findings, directory)  # nothing may be imported before, or it stays without instruments
    corpus = directory / "corpus"
    corpus.mkdir(exist_ok=True)
    seeds = list(watch.target.seeds())
    for i, data in enumerate(seeds):
        (corpus / f"seed{i}").write_bytes(data)
    dictionary = directory / "tokens"
    dictionary.write_text("".join(f'"{_escaped(token)}"\n' for token in TOKENS if len(token) < 60))

    def mutate(data: bytes, most: int, number: int) -> bytes:
        generator = random.Random(number)
        if generator.random() < 0.5:
            return atheris.Mutate(data, most)
        return mutated(data, seeds, generator)[:most]

    def one_input(data: bytes) -> None:
        watch.run(data)

    options = [f"-max_total_time={_whole_seconds(60.0 * minutes)}", f"-seed={seed + 1}", f"-max_len={LARGEST_INPUT}"]
    options += [
        "-timeout=600",
        "-rss_limit_mb=0",
        "-print_final_stats=0",
        "-verbosity=0",
        f"-dict={dictionary}",
        f"-artifact_prefix={directory}/",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], one_input, custom_mutator=mutate)
    atheris.Fuzz()


def _escaped(token: bytes) -> str:
    return "".join(chr(b) if 32 <= b < 127 and b not in b'"\\' else f"\\x{b:02x}" for b in token)


def _whole_seconds(value: float) -> int:
    """The least whole number that is not below ``value``, and at least 1: libFuzzer takes 0 for no limit."""
    return max(1, -int(-value // 1))


def fuzz(name: str, minutes: float, seed: int, engine: str, findings: Path) -> int:
    """Lets processes feed one target until the time is over, and returns the number of inputs that they ran."""
    begin, executions = time.monotonic(), 0
    while (left := 60.0 * minutes - (time.monotonic() - begin)) > 0.0:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as directory:
            arguments = ["--worker", directory, "--minutes", str(left / 60.0), "--seed", str(seed)]
            command = [sys.executable, __file__, name, "--engine", engine, "--findings", str(findings), *arguments]
            log = Path(directory) / "log"
            with log.open("wb") as errors:
                process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors)
            ran = _followed(process, name, executions, begin, minutes, findings)
            executions += ran
            current = Path(directory) / "current"
            if process.returncode != 0 and current.exists():
                said = log.read_text(errors="replace")[-4000:]
                keep(findings, name, current.read_bytes(), f"the process ended with {process.returncode}\n\n{said}")
            elif process.returncode != 0:
                raise SystemExit(f"the process of {name} could not start:\n{log.read_text(errors='replace')}")
        if time.monotonic() - begin >= 60.0 * minutes - 1.0:
            break
        seed += 1  # not the same inputs once more
    print()
    return executions


def _followed(
    process: subprocess.Popen[bytes], name: str, before: int, begin: float, minutes: float, findings: Path
) -> int:
    """Shows what a process does, ends it if it falls silent, and returns the number of inputs that it ran."""
    import selectors

    executions = 0
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while True:
            if not selector.select(timeout=SILENCE):
                process.kill()
                break
            line = process.stdout.readline()
            if not line:
                break
            if line.startswith(b"{"):
                executions = json.loads(line)["executions"]
            spent = time.monotonic() - begin
            count = len(list(findings.glob(f"{name}-*.txt")))
            text = f"{name:8} {spent / 60.0:5.1f} of {minutes:.1f} min {before + executions:>9} inputs {count} findings"
            print(f"\r{text}", end="", flush=True)
    process.wait()
    process.stdout.close()
    return executions


def main() -> None:
    """Reads the arguments; exits with 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "targets", nargs="*", choices=[[], *TARGETS], metavar="TARGET", help=f"by default all: {', '.join(TARGETS)}"
    )
    parser.add_argument("--minutes", type=float, default=5.0, help="in all, evenly shared out (default 5)")
    parser.add_argument("--findings", type=Path, default=Path("findings"), metavar="DIR", help="(default findings)")
    parser.add_argument("--engine", choices=("auto", "atheris", "mutation"), default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--replay", type=Path, metavar="FILE", help="run this one input of the target and tell")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    names = options.targets or list(TARGETS)
    engine = options.engine
    if engine == "auto":
        import importlib.util

        engine = "atheris" if importlib.util.find_spec("atheris") else "mutation"
    if options.worker is not None:
        work(names[0], options.minutes, options.seed, engine, options.findings, options.worker)
        return
    if options.replay is not None:
        with tempfile.TemporaryDirectory() as directory:
            begin = time.process_time()
            answer = TARGETS[names[0]].run(options.replay.read_bytes(), Path(directory))
            print(f"{time.process_time() - begin:.2f} s, {_peak_memory() / 2**20:.0f} MiB: {answer or 'taken'}")
        return
    total = sum(fuzz(name, options.minutes / len(names), options.seed, engine, options.findings) for name in names)
    found = sorted(options.findings.glob("*.txt"))
    print(f"{total} inputs with {engine}, {len(found)} findings" + (f" in {options.findings}" if found else ""))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
