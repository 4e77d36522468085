"""Small files that ask for much are refused in a sentence, or read, in under 2 s of processor time and 1 GB."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bombs
import pytest

MOST_SECONDS = 2.0
"""Of processor time."""
TRIALS = 5
"""Of a file that takes longer: where others keep the machine busy, processor time grows as well."""
MOST_MEMORY = 2**30
"""Bytes that the reading process, its imports included, has in memory at most."""
HUNG = 60.0
"""Seconds."""
LONGEST_SENTENCE = 1_000
"""Letters."""

COSTLY = {
    *(
        "30,000 small merges",
        "10^4 bodies of two links",
        "a spiral",
        "a spiral in fine cells",
        "20 polygons of 500 teeth",
    ),
    *("10^4 moving obstacles", "118,000 unknown keys", "a line of 10^4 corners", "10^4 circles that reach in"),
    *("10^5 includes of nothing", "10^5 bodies", "5000 bodies", "a large full map", "a large empty map"),
    *("a large map of one block", "10^4 robots with 10^4 goals", "10^5 corners", "many pieces of text"),
    *("10^4 obstacles of one name", "10^4 obstacles that stand apart", "a name of 10^7 letters"),
}
"""Those that take longest, and so have the narrowest margin on a busy machine: they are *slow* tests."""

SAID = {
    "60 polygons of 1000 teeth": "the file holds more than 120000 values; split it into several worlds",
    "an explicit key of 10^6 letters": "a key has at most 500 letters, not 1000000; shorten it",
    "larger than 16 MiB": "is larger than 16 MiB; split it into several worlds",
    "a distribution of 10^6 letters": "robot.distribution.name: is longer than 1000 characters; shorten it",
    "a key of 10^6 letters": "a key is longer than 1000 characters; shorten it",
    "a frame of 10^6 letters": "<placement_frame> is longer than 1000 characters; shorten it",
    "10^5 unknown keys": "is one more than the 10000 keys that may be in one place",
    "10^5 keys twice": "room.yaml:104:1: what follows is not read; put the mistakes before it right first",
    "118,000 keys without values": "what follows is not read; put the mistakes before it right first",
    "10^5 obstacles in one place": "obstacles[10000]: a list holds at most 10000 entries; leave some out",
    "9000 obstacles with ten mistakes each": "more mistakes are not told; put these right first",
    "10^4 obstacles of one name": "obstacles: more than 300000 pairs of them overlap",
    "a name of 10^7 letters": "name: must be at most 1000 letters long, not 10000000; shorten it",
    "2000 corners": "points: must be at most 1000 corners, not 2000; leave out those that matter least",
    "2000 starts and goals": "starts: must be at most 500 starts, not 2000; leave some of them out",
    "40 polygons of 900 corners": "obstacles: the polygons have 36000 corners in all, more than 20000",
    "301 moving obstacles": "obstacles[300].cylinder: is one more than the 300 obstacles of a world that may move",
    "a way of 2000 points": "motion.path: must be at most 1000 points, not 2001; leave some of them out",
    "a swing as long as a street": "motion: all ways together have more than 40000 pieces to be looked at",
    "a million attributes": "a tag is longer than 4096 bytes; leave attributes out",
    "a million elements": "holds more than 200000 elements and attributes; split it",
    "10^4 includes of other things": "more than 2000 different models and meshes are named; split the world",
    "a uri of 10^6 letters": "a <uri> is longer than 1000 characters; name a model or a mesh",
    "a list in itself": "lists and mappings are nested deeper than 50 levels; flatten them",
    "10^4 robots": "robots have more than 500 different states; leave some robots out",
    "10^4 circles that reach in": "outlines of more than 50000 corners reach out of the room; make it larger",
    "a PGM of 36 million pixels": "has 6000 x 6000 pixels, more than 16000000; scale it down",
    "a PGM of one endless comment": "says no width and height within its first 4096 bytes",
    "a checkerboard": "image: its occupied cells have borders of 8000000 corners, more than 200000",
    "a spiral": "image: its occupied cells wind round one another too often; clear the map up, or scale it down",
}
"""What is said of some, in any of the formats that have one of this name."""


class _Reader:
    """One process for many files: it has been below the limit of memory if it ends below it; if not, it is replaced."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, reader: str, path: Path) -> dict[str, Any]:
        """What became of a file."""
        if self._process is None:
            command = [sys.executable, str(Path(__file__).with_name("bomb_reader.py"))]
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{reader} {path}\n".encode())
        self._process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            ready = selector.select(timeout=HUNG)
        line = self._process.stdout.readline() if ready else b""
        answer: dict[str, Any] = json.loads(line) if line else {}
        if not answer or answer["peak"] >= MOST_MEMORY:
            self.end()
        assert ready, f"no answer within {HUNG:g} s"
        assert answer, "the process of the reader died"
        return answer

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@pytest.fixture(scope="module")
def reader() -> Iterator[_Reader]:
    process = _Reader()
    yield process
    process.end()


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where each file takes the place of the one before, for some are large."""
    path = tmp_path_factory.mktemp("bombs")
    yield path
    for file in path.iterdir():
        file.unlink()


def check(reader: _Reader, kind: str, path: Path, source: str, said: str = "") -> None:
    for _ in range(TRIALS):
        answer = reader.read(kind, path)
        if answer["seconds"] < MOST_SECONDS:
            break
        time.sleep(1.0)
    assert not answer["failure"], answer["failure"]
    assert any(said in problem for problem in answer["problems"] or [""]), answer["problems"]
    for problem in answer["problems"]:
        assert problem.startswith((source, "/dev/zero")), problem[:LONGEST_SENTENCE]
        assert "\n" not in problem, problem[:LONGEST_SENTENCE]
        assert len(problem) - len(source) <= LONGEST_SENTENCE, problem[:LONGEST_SENTENCE]
        assert "MemoryError" not in problem, problem
    assert answer["seconds"] < MOST_SECONDS
    assert answer["peak"] < MOST_MEMORY


def test_what_is_said_is_said_of_something():
    names = {*bombs.WORLDS, *bombs.SDF, *bombs.IRSIM, *bombs.MAPS}
    assert SAID.keys() <= names
    assert names >= COSTLY


def _names(files: dict[str, Any]) -> list[Any]:
    return [pytest.param(name, marks=pytest.mark.slow) if name in COSTLY else name for name in files]


def _write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("name", _names(bombs.WORLDS))
def test_world_files_that_ask_for_much(name, reader, directory):
    path = _write(directory / "room.yaml", bombs.WORLDS[name]())
    check(reader, "world", path, str(path), SAID.get(name, ""))


@pytest.mark.parametrize("name", _names(bombs.SDF))
def test_sdf_files_that_ask_for_much(name, reader, directory):
    path = _write(directory / "room.sdf", bombs.SDF[name]())
    check(reader, "sdf", path, str(path), SAID.get(name, ""))


@pytest.mark.slow
@pytest.mark.parametrize("name", bombs.LARGEST_WORLDS)
def test_world_files_as_large_as_may_be(name, reader, directory):
    path = _write(directory / "room.yaml", bombs.LARGEST_WORLDS[name]())
    check(reader, "world", path, str(path))


@pytest.mark.slow
@pytest.mark.parametrize("name", bombs.LARGEST_SDF)
def test_sdf_files_as_large_as_may_be(name, reader, directory):
    path = _write(directory / "room.sdf", bombs.LARGEST_SDF[name]())
    check(reader, "sdf", path, str(path))


@pytest.mark.parametrize("name", _names(bombs.IRSIM))
def test_irsim_files_that_ask_for_much(name, reader, directory):
    path = _write(directory / "irsim.yaml", bombs.IRSIM[name]())
    check(reader, "ir-sim", path, str(path), SAID.get(name, ""))


@pytest.mark.parametrize("name", _names(bombs.MAPS))
def test_ros_maps_that_ask_for_much(name, reader, directory):
    settings, picture = bombs.MAPS[name]()
    path = _write(directory / "map.yaml", settings)
    _write(directory / "map.pgm", picture)
    check(reader, "ros-map", path, str(directory), SAID.get(name, ""))


@pytest.mark.parametrize("source", bombs.SOURCES, ids=range(len(bombs.SOURCES)))
def test_sources_that_ask_for_much(source, reader, directory):
    path = _write(directory / "source", source)
    check(reader, "source", path, "")
