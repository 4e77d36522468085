"""Trains at full speed for hours and watches what must not grow: python scripts/soak.py --help

Samples the memory that ``navsim train`` and all its processes have written to, their open files, and how many
transitions they make a second of processor time; looks what is left in /dev/shm; then judges and draws all that. The
run is an ordinary one: it can be resumed, evaluated, and used.

A second of processor time is not always worth the same: other programs, and other virtual machines on the same host,
take caches, memory and clock rate. So speed is told in updates of a fixed network, written in plain PyTorch, that is
trained for a tenth of a second every five: a reference that slows down with the machine, and not with the run.
"""

from __future__ import annotations

import contextlib
import csv
import json
import platform
import shlex
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch
import tyro
from matplotlib.ticker import EngFormatter
from rich.console import Console

from navsim.draw import INK, QUIET_INK, new_figure, save_figure
from navsim.files import atomic_write
from rl.background import REPLACED
from rl.run import Run, processor, versions

SHARED_MEMORY = Path("/dev/shm")
SAMPLE_SECONDS = 5.0
"""Between two looks at the processes."""
REFERENCE_UPDATES = 8
"""Of the reference, at each look."""
SETTINGS = (
    *["--world", "generate:clutter,density=0.11,count=400", "--collector", "async", "--total-steps"],
    "10000000",
)
WINDOW = 600.0
"""Seconds whose median memory is compared with other such windows': evaluations and checkpoints come and go within."""
WARM_UP = 1.2
"""Times the replay's capacity, in transitions: by then all its memory has been written to."""
MOST_MEMORY_CHANGE = 0.02
MOST_SPEED_CHANGE = 0.05


def main(
    settings: tuple[str, ...] = SETTINGS,
    /,
    hours: float = 2.0,
    run: Path = Path("runs/soak"),
    results: Path = Path("docs/results/soak.json"),
    picture: Path = Path("docs/images/soak.png"),
    redraw: bool = False,
) -> None:
    """Train, watch, judge, draw.

    Args:
        settings: What "navsim train" takes besides, after a "--".
        hours: How long to watch; a run that is not finished by then is interrupted as by Ctrl-C, and can be resumed.
        run: Directory of the run; one that is there is gone on with.
        results: File for what was measured, JSON.
        picture: File for the picture.
        redraw: Judge and draw the file of results instead of training.
    """
    console = Console()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # either way the training is to be ended as well
    if redraw:
        measured = json.loads(results.read_text(encoding="utf-8"))
    else:
        measured = watch(hours, run, list(settings), console)
        results.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(results) as file:
            json.dump(measured, file)
    verdicts = judge(measured)
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(measured, verdicts, picture)
    for verdict in verdicts.values():
        console.print(f"{'passed' if verdict['passed'] else 'FAILED'}  {verdict['text']}", highlight=False)
    sys.exit(0 if all(verdict["passed"] for verdict in verdicts.values()) else 1)


def watch(hours: float, directory: Path, settings: list[str], console: Console) -> dict[str, Any]:
    """Starts training and samples its processes until it ends, or the time is over."""
    command = ["train", "--resume", "--no-report", "--out", str(directory), *settings]
    console.print(f"navsim {shlex.join(command)}", soft_wrap=True, highlight=False)
    samples: list[dict[str, float]] = []
    shared_before = set(SHARED_MEMORY.iterdir())
    replaced_before = replacements(directory)
    reference = Reference()
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen([sys.executable, "-m", "rl.cli", *command], stdout=output, stderr=subprocess.STDOUT)
        trainer = psutil.Process(process.pid)
        past: dict[int, float] = {}
        try:
            with console.status("starting") as status:
                while process.poll() is None:
                    seconds = time.monotonic() - begin
                    if seconds > 3600.0 * hours:
                        break
                    if sample := look_at(trainer, past):
                        step = last_step(directory)
                        samples.append({"seconds": seconds, "step": step} | sample | {"reference": reference.seconds()})
                        status.update(
                            f"{seconds / 60.0:.0f} of {60.0 * hours:.0f} min, step {step:,},"
                            f" {sample['memory'] / 2**20:.0f} MiB, {sample['files']} files"
                        )
                    time.sleep(SAMPLE_SECONDS)
        except KeyboardInterrupt:
            console.print("stopped: what was seen so far is judged; the run can be gone on with")
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait()
        if process.returncode not in (0, 128 + signal.SIGINT):
            output.seek(0)
            sys.exit(f"navsim train has failed, exit status {process.returncode}:\n{output.read()[-4000:]}")
    if not samples:
        sys.exit("navsim train ended before anything could be seen of it")
    left = still_alive([other for other in past if other != process.pid])
    return {
        "command": f"navsim {shlex.join(command)}",
        "machine": f"{processor()}, {psutil.cpu_count()} processors, {platform.system()}",
        "versions": versions(),
        "replay_capacity": Run(directory).config.replay_capacity,
        "evaluation_interval": Run(directory).config.eval_interval,
        "workers_replaced": replacements(directory) - replaced_before,
        "processes_left": len(left),
        "shared_memory_left": abandoned(shared_before),
        "samples": {key: [sample[key] for sample in samples] for key in samples[0]},
    }


class Reference:
    """Updates of a network of the size of the run's, none of whose code is the run's."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        nn = torch.nn
        self._network = nn.Sequential(
            *(nn.Conv2d(4, 32, (10, 14), 8, (3, 3)), nn.ReLU(), nn.Conv2d(32, 64, 4, 2, 1), nn.ReLU()),
            *(nn.Conv2d(64, 64, 3, 1, 1), nn.ReLU(), nn.Flatten(), nn.LazyLinear(1024), nn.ReLU(), nn.Linear(1024, 8)),
        )
        self._images = torch.rand(64, 4, 64, 80)
        self._network(self._images)
        self._optimiser = torch.optim.Adam(self._network.parameters(), fused=True)

    def seconds(self) -> float:
        """Processor time of an update, a mean; one before them, which finds the caches cold, does not count."""
        self._update()
        begin = time.process_time()
        for _ in range(REFERENCE_UPDATES):
            self._update()
        return (time.process_time() - begin) / REFERENCE_UPDATES

    def _update(self) -> None:
        with torch.autocast("cpu", torch.bfloat16):
            loss = self._network(self._images).square().mean()
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()


def look_at(trainer: psutil.Process, past: dict[int, float]) -> dict[str, float]:
    """Memory, open files and processor time of a process and its descendants; nothing if it is just ending.

    Memory is what they have written to, each page that they share counted once, and the programs and libraries of the
    one that has most of them in memory. (The system's own "proportional" size of libraries would change whenever
    another program begins or ends that uses the same ones: by 45 MiB with any other Python that imports PyTorch.)

    Args:
        trainer: the process.
        past: processor time by process, which is kept of those that have ended.
    """
    written = libraries = files = processes = 0
    try:
        family = [trainer, *trainer.children(recursive=True)]
    except psutil.NoSuchProcess:
        return {}
    for member in family:
        try:
            written += kibibytes(member.pid, "smaps_rollup", ("Pss_Anon:", "Pss_Shmem:"))
            libraries = max(libraries, kibibytes(member.pid, "status", ("RssFile:",)))
            files += member.num_fds()
            times = member.cpu_times()
        except (psutil.NoSuchProcess, psutil.AccessDenied, OSError):
            continue  # it has just ended
        processes += 1
        past[member.pid] = times.user + times.system
    if not written:
        return {}
    cpu = sum(past.values())
    return {"memory": 1024 * (written + libraries), "files": files, "processes": processes, "cpu": cpu}


def kibibytes(process: int, file: str, names: tuple[str, ...]) -> int:
    """The sum of these lines in a file of /proc."""
    lines = [line.split() for line in Path(f"/proc/{process}/{file}").read_text().splitlines()]
    return sum(int(line[1]) for line in lines if line[0] in names)


def still_alive(processes: list[int], patience: float = 15.0) -> list[int]:
    """Those that have not ended after so many seconds: they notice the end of their parent within a few."""
    deadline = time.monotonic() + patience
    while (left := [one for one in processes if psutil.pid_exists(one)]) and time.monotonic() < deadline:
        time.sleep(0.5)
    return left


def last_step(directory: Path) -> int:
    """Transitions that the run has logged."""
    try:
        with (directory / "metrics.csv").open(encoding="utf-8") as file:
            steps = [row["step"] for row in csv.DictReader(file)]
        return int(steps[-1]) if steps else 0
    except (OSError, ValueError, TypeError, KeyError):
        return 0  # not written yet, or just being written


def replacements(directory: Path) -> int:
    """Processes that have taken a failed one's place."""
    try:
        return (directory / "warnings.txt").read_text(encoding="utf-8").count(REPLACED)
    except FileNotFoundError:
        return 0


def abandoned(before: set[Path]) -> list[str]:
    """What is in /dev/shm that was not there before, and that no living process, of whatever program, has mapped."""
    new = {}
    for path in set(SHARED_MEMORY.iterdir()) - before:
        with contextlib.suppress(OSError):  # another program has just removed it
            new[path.name] = path.stat().st_ino
    held: set[int] = set()  # numbers: glibc maps a semaphore under another name, which it then takes away
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            lines = [line.split() for line in maps.read_text().splitlines()]
            held |= {int(line[4]) for line in lines if len(line) > 5 and line[5].startswith(str(SHARED_MEMORY))}
    return sorted(name for name, number in new.items() if number not in held and (SHARED_MEMORY / name).exists())


def judge(measured: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What must be flat, and whether it is."""
    seconds, step, memory, files, cpu, reference = (
        np.array(measured["samples"][key], float) for key in ("seconds", "step", "memory", "files", "cpu", "reference")
    )
    warm = step >= step[0] + WARM_UP * measured["replay_capacity"]
    if np.count_nonzero(warm) < 4 or seconds[-1] - seconds[warm][0] < 2 * WINDOW:
        sys.exit("the run was too short to judge: its replay must be full, and 20 minutes more")
    medians = window_medians(seconds[warm], memory[warm])
    memory_change = (medians.max() - medians.min()) / np.median(medians)
    first, last = (np.max(part) for part in np.array_split(files[warm], 4)[::3])
    updates = np.cumsum(np.diff(cpu[warm], prepend=cpu[warm][0]) / reference[warm])  # in the run's processor time
    speeds, plain_speeds = (window_speeds(seconds[warm], step[warm], per) for per in (updates, cpu[warm]))
    speed_change, plain_change = (np.abs(each / np.median(each) - 1.0).max() for each in (speeds, plain_speeds))
    return {
        "memory": {
            "passed": bool(memory_change <= MOST_MEMORY_CHANGE),
            "text": f"memory: medians of {len(medians)} windows of {WINDOW / 60:.0f} min differ by "
            f"{memory_change:.1%} ({np.median(medians) / 2**20:.0f} MiB; greatest {memory.max() / 2**20:.0f} MiB); "
            f"{MOST_MEMORY_CHANGE:.0%} are allowed",
        },
        "files": {
            "passed": bool(last <= first),
            "text": f"open files: at most {first:.0f} in the first quarter after warm-up, {last:.0f} in the last",
        },
        "speed": {
            "passed": bool(speed_change <= MOST_SPEED_CHANGE),
            "text": f"speed: {np.median(speeds):.1f} transitions in the processor time of a reference update; "
            f"{len(speeds)} windows of {WINDOW / 60:.0f} min differ from it by at most {speed_change:.1%}; "
            f"{MOST_SPEED_CHANGE:.0%} are allowed ({np.median(plain_speeds):.0f} a second of processor time, within "
            f"{plain_change:.1%})",
        },
        "workers": {
            "passed": measured["workers_replaced"] == 0,
            "text": f"processes that had to be replaced: {measured['workers_replaced']}",
        },
        "left": {
            "passed": measured["processes_left"] == 0 and not measured["shared_memory_left"],
            "text": f"left behind: {measured['processes_left']} processes, "
            f"{len(measured['shared_memory_left'])} files in {SHARED_MEMORY}",
        },
    }


def window_medians(seconds: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Medians of windows of ``WINDOW``; an incomplete one at the end is left out."""
    number = ((seconds - seconds[0]) // WINDOW).astype(int)
    return np.array([np.median(values[number == window]) for window in range(max(1, number[-1]))])


def window_speeds(seconds: np.ndarray, step: np.ndarray, spent: np.ndarray) -> np.ndarray:
    """Transitions for each unit of what was spent, in windows of ``WINDOW``, without an incomplete one at the end."""
    new = np.flatnonzero(np.diff(step, prepend=step[0]) > 0)  # between these, nobody knows how many there were
    marks = np.arange(seconds[new[0]], seconds[new[-1]] + 1.0, WINDOW)
    steps, at = (np.interp(marks, seconds[new], values[new]) for values in (step, spent))
    return np.diff(steps) / np.diff(at)


def draw(measured: dict[str, Any], verdicts: dict[str, dict[str, Any]], path: Path) -> None:
    """Memory, files and speed over the hours."""
    samples = {key: np.array(values, float) for key, values in measured["samples"].items()}
    minutes = samples["seconds"] / 60.0
    warm = samples["step"] >= samples["step"][0] + WARM_UP * measured["replay_capacity"]
    figure = new_figure(9.0, 7.0)
    memory, files, speed = figure.subplots(3, 1, sharex=True)
    memory.plot(minutes, samples["memory"] / 2**20, color="#2b6cb0", lw=0.8)
    memory.set_ylim(0, 1.15 * samples["memory"].max() / 2**20)
    memory.set_ylabel("memory, MiB")
    files.plot(minutes, samples["files"], color="#2b6cb0", lw=0.8)
    files.set_ylim(0, 1.3 * samples["files"].max())
    files.set_ylabel("open files")
    width = measured["evaluation_interval"]
    new = np.flatnonzero(np.diff(samples["step"], prepend=samples["step"][0]) > 0)
    marks = np.arange(samples["step"][new[0]], samples["step"][new[-1]] + 1, width)
    at, when = (np.interp(marks, samples["step"][new], values[new]) for values in (samples["cpu"], minutes))
    spent = np.cumsum(np.diff(samples["cpu"], prepend=samples["cpu"][0]) / samples["reference"])
    updates = np.interp(marks, samples["step"][new], spent[new])
    median = np.median(np.diff(at) / np.diff(updates))  # a reference update's processor time
    corrected = width / np.diff(updates) / median
    speed.step(when[1:], width / np.diff(at), where="pre", color="#9aa3ad", lw=0.8, label="as it was")
    speed.step(when[1:], corrected, where="pre", color="#2b6cb0", lw=1.2, label="beside the reference")
    speed.legend(fontsize=7, frameon=False, loc="lower right", ncols=2, labelcolor=QUIET_INK)
    speed.set_ylim(bottom=0)
    speed.set_ylabel("transitions / s of\nprocessor time")
    speed.set_xlabel("minutes")
    for axes, name in ((memory, "memory"), (files, "files"), (speed, "speed")):
        axes.axvspan(0, minutes[warm][0], color="#eef1f4", lw=0)
        axes.set_title(textwrap.fill(verdicts[name]["text"], 140), fontsize=8, loc="left", color=INK)
        axes.tick_params(labelsize=8, colors=QUIET_INK)
        axes.yaxis.label.set_size(8)
        axes.yaxis.set_major_formatter(EngFormatter())
        axes.spines[["top", "right"]].set_visible(False)
    memory.text(minutes[warm][0] / 2, memory.get_ylim()[1] * 0.06, "warm-up", ha="center", fontsize=8, color=QUIET_INK)
    save_figure(figure, path)


if __name__ == "__main__":
    tyro.cli(main)
