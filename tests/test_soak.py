"""What the soak calls flat, and what it counts as memory."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from rl.background import CollectorError, PersistentCollector
from rl.run import Run

SCRIPT = Path(__file__).parents[1] / "scripts" / "soak.py"

if not Path("/proc/self/smaps_rollup").exists():
    pytest.skip("the soak looks into Linux's /proc", allow_module_level=True)


@pytest.fixture(scope="module")
def soak():
    specification = importlib.util.spec_from_file_location("soak", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def measured(memory=1.0, speed=1.0, files=0, machine=1.0, **left):
    """Two hours of which the last quarter has so much more memory and speed, and so many more files, than the rest.

    And in which the machine was so much faster at the same time.
    """
    seconds = np.arange(0.0, 7200.0, 5.0)
    late = seconds > 5400.0
    cpu = 1.3 * seconds
    step = np.cumsum(np.where(late, speed * machine, 1.0) * 5.0 * 200.0)
    samples = {
        "seconds": seconds,
        "step": 4000 * (step // 4000),  # as the log tells it
        "memory": np.where(late, memory, 1.0) * 1.6e9 + 1e8 * (seconds % 300.0 < 20.0),  # evaluations take some
        "files": np.where(late, 160 + files, 160),
        "cpu": cpu,
        "reference": 0.03 / np.where(late, machine, 1.0),
    }
    return {
        "replay_capacity": 50_000,
        "evaluation_interval": 12_500,
        "workers_replaced": 0,
        "processes_left": 0,
        "shared_memory_left": [],
        "samples": {key: values.tolist() for key, values in samples.items()},
        **left,
    }


@pytest.mark.parametrize(
    ("results", "failed"),
    [
        (measured(), set()),
        (measured(memory=1.018, speed=1.04), set()),
        (measured(memory=1.025), {"memory"}),
        (measured(memory=0.97), {"memory"}),
        (measured(speed=0.93), {"speed"}),
        (measured(speed=1.07), {"speed"}),
        (measured(machine=0.8), set()),
        (measured(machine=1.2, speed=0.93), {"speed"}),
        (measured(machine=0.8, speed=1 / 0.8), {"speed"}),
        (measured(files=1), {"files"}),
        (measured(files=-1), set()),
        (measured(workers_replaced=1), {"workers"}),
        (measured(processes_left=1), {"left"}),
        (measured(shared_memory_left=["torch_1_2"]), {"left"}),
    ],
)
def test_what_is_not_flat_fails(soak, results, failed):
    assert {name for name, verdict in soak.judge(results).items() if not verdict["passed"]} == failed


def test_replacements_are_those_that_the_run_has_noted(soak, tmp_path):
    assert soak.replacements(tmp_path) == 0
    told = []

    class Failing:
        procs = ()

        def __iter__(self):
            raise CollectorError("it has failed")

        def shutdown(self, **_):
            pass

    with pytest.raises(CollectorError):
        list(PersistentCollector(lambda seed, frames: Failing(), seed=0, total_frames=10, replaced=told.append))
    run = Run(tmp_path)
    for text in told:
        run.note(text)
    assert soak.replacements(tmp_path) == len(told) == 3


def test_what_was_measured_is_judged_and_drawn_again(soak, tmp_path, capsys):
    results, picture = tmp_path / "soak.json", tmp_path / "soak.png"
    for given, status, words in ((measured(), 0, "passed  memory"), (measured(memory=1.1), 1, "FAILED  memory")):
        results.write_text(json.dumps(given))
        with pytest.raises(SystemExit) as ended:
            soak.main(results=results, picture=picture, redraw=True)
        assert ended.value.code == status
        assert words in capsys.readouterr().out
        assert picture.stat().st_size > 10_000
        picture.unlink()


PROGRAM = """
import mmap, sys
with open(sys.argv[1], "rb") as file:
    library = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
library[::4096]
written = bytearray(b"1") * 64_000_000
print("written", flush=True)
input()
"""


def test_memory_is_what_the_run_has_written_to_and_no_other_program_changes_it(soak, tmp_path):
    file = tmp_path / "library"
    file.write_bytes(bytes(32_000_000))
    start = [sys.executable, "-c", PROGRAM, file]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(start, **pipes) as one, subprocess.Popen(start, **pipes) as other:
        try:
            assert one.stdout.readline() == other.stdout.readline() == "written\n"
            beside_another = soak.look_at(psutil.Process(one.pid), {})
            other.kill()
            other.wait()
            alone = soak.look_at(psutil.Process(one.pid), {})
            assert alone["memory"] == pytest.approx(beside_another["memory"], abs=2**20)
            assert 96e6 < alone["memory"] < 130e6
            assert alone["processes"] == 1
            assert alone["files"] == 4  # of the mapping, too
        finally:
            one.kill()
            other.kill()
