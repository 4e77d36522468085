"""A process that reads files it is told of, and tells what became of each: see ``test_bombs.py``.

A line of its input is a reader's name, a blank and a path; for each it writes a line of JSON.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import traceback
from pathlib import Path

from navsim.convert import ConversionError, load_irsim, load_ros_map, load_sdf
from navsim.errors import WorldError
from navsim.worldfile import load_world
from navsim.worldsource import parse_source

MOST_MEMORY = 2**30
"""Bytes of address space beyond what the imports take."""
READERS = {
    "world": load_world,
    "sdf": load_sdf,
    "ir-sim": load_irsim,
    "ros-map": load_ros_map,
    "source": lambda path: parse_source(path.read_text()),
}


def _peak() -> int:
    """Bytes that the process has had in memory at most."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _limit_addresses() -> None:
    """Lets what asks for too much fail, lest it take the machine down; where the system says what is in use."""
    used = Path("/proc/self/statm")
    if used.exists():
        limit = int(used.read_text().split()[0]) * resource.getpagesize() + MOST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _answer(reader: str, path: Path) -> dict[str, object]:
    problems: list[str] = []
    failure = ""
    begin = time.process_time()
    try:
        READERS[reader](path)
    except (WorldError, ConversionError) as error:
        problems = list(getattr(error, "problems", [str(error)]))
    except Exception:
        failure = traceback.format_exc()
    seconds = time.process_time() - begin
    return {"seconds": seconds, "peak": _peak(), "problems": problems, "failure": failure}


def main() -> None:
    _limit_addresses()
    for line in sys.stdin:
        reader, path = line.rstrip("\n").split(" ", 1)
        print(json.dumps(_answer(reader, Path(path))), flush=True)


if __name__ == "__main__":
    main()
