"""docs/worlds.md: what it tells a reader to type does what it says."""

from __future__ import annotations

import doctest
import re
import shlex
from pathlib import Path

import pytest

from rl.cli import main

PAGE = Path(__file__).resolve().parents[1] / "docs" / "worlds.md"
TUTORIAL = PAGE.read_text(encoding="utf-8").partition("## What `check` tells")[0]
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TUTORIAL, flags=re.DOTALL | re.MULTILINE)


def write(block: str, file: Path) -> None:
    """A whole world, or one line instead of the one in the file that begins alike."""
    if block.startswith("format:"):
        file.write_text(block, encoding="utf-8")
        return
    beginning = block.partition(",")[0]
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    (place,) = [i for i, line in enumerate(lines) if line.startswith(beginning)]
    lines[place] = block
    file.write_text("".join(lines), encoding="utf-8")


def run_tutorial(capsys, with_training: bool) -> tuple[int, int]:
    """Follows the tutorial in the present directory; returns the numbers of commands run and of outputs compared."""
    ran = compared = 0
    for kind, block in BLOCKS:
        if kind == "yaml":
            write(block, Path("cafe.yaml"))
        elif kind == "sh":
            capsys.readouterr()
            for line in block.splitlines():
                program, *arguments = shlex.split(line)
                assert program == "navsim"
                if with_training or (arguments[0] == "world" and "--solve" not in arguments):
                    status = main(arguments)
                    ran += 1
        elif kind == "text":
            captured = capsys.readouterr()
            assert (captured.err + captured.out).strip() == block.strip()
            assert status == (2 if "error:" in block else 0)
            compared += 1
    return ran, compared


def test_the_tutorial_up_to_the_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert run_tutorial(capsys, with_training=False) == (5, 4)
    assert (tmp_path / "cafe.png").stat().st_size > 50_000


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_whole_tutorial_leads_to_a_trained_robot(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert run_tutorial(capsys, with_training=True) == (8, 4)
    assert (tmp_path / "runs" / "cafe" / "policy.pt").is_file()
    assert (tmp_path / "runs" / "cafe" / "report.html").is_file()


def test_the_examples_in_python():
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert (failed, tried > 8) == (0, True)
