"""The README's examples do what it says they do."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from rl.cli import main

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
BLOCKS = {
    kind: re.findall(rf"^```{kind}\n(.*?)^```", README, re.MULTILINE | re.DOTALL) for kind in ("python", "sh", "yaml")
}
COMMANDS = [line for block in BLOCKS["sh"] for line in block.splitlines() if line.startswith("navsim ")]


@pytest.mark.parametrize("number", range(len(BLOCKS["python"])))
def test_python_examples_run(number):
    exec(compile(BLOCKS["python"][number], f"README.md, example {number + 1}", "exec"), {})


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_there_with_their_options(command, capsys):
    words = shlex.split(command, comments=True)[1:]
    options = [word for word in words if word.startswith("-")]
    assert main([*(word for word in words if word not in options), "--help"]) == 0
    told = capsys.readouterr().out
    assert f"usage: navsim {words[0]}" in told
    for option in options:
        assert re.search(rf"(?<![\w-]){option}(?![\w-])", told), f"{command}: there is no {option}"


def test_the_world_is_a_whole_one(tmp_path):
    (world,) = BLOCKS["yaml"]
    (tmp_path / "my_room.yaml").write_text(world, encoding="utf-8")
    assert main(["world", "check", str(tmp_path / "my_room.yaml")]) == 0


def test_links_lead_somewhere():
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", README)
    assert len(targets) > 5
    for target in targets:
        assert (Path(__file__).parent.parent / target).exists(), target
