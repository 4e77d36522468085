"""The examples of docs/own_code.md run, one after the other, and do what the page says."""

from __future__ import annotations

import math
import re
from pathlib import Path

import torch
from torchrl.objectives import DQNLoss

from navsim.robot import ACTIONS

PAGE = Path(__file__).parents[1] / "docs" / "own_code.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    filmed = {}  # drawing films takes long, and is tested where it is
    monkeypatch.setattr("rl.drive.animate_episode", lambda path, world, poses, goal, **_: filmed.update(path=path))
    torch.manual_seed(0)
    names: dict = {}
    blocks = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 7
    for number, block in enumerate(blocks):
        exec(compile(block, f"{PAGE.name}, example {number + 1}", "exec"), names)
    told = capsys.readouterr().out
    assert "torch.Size([4, 10, 4, 64, 80])" in told
    assert "torch.Size([4, 10, 1])" in told
    assert "torch.Size([4, 20, 160, 160, 3])" in told
    assert Path("logs/own/videos/plan_0.pt").is_file()
    assert "torch.Size([2, 4, 1, 181])" in told
    assert filmed == {"path": Path("own.gif")}
    assert names["forward"] in (0.2, 0.4)

    turned = names["turned"]
    speed = turned["next", "command"][..., 0]
    cost = turned["next", "reward"][..., 0] + 0.01 - 0.2 * speed * turned["next", "heading"][..., 0].cos()
    driven = ~turned["next", "terminated"][..., 0]
    turn = (turned["next", "pose"] - turned["pose"])[..., 2]
    turn = torch.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
    torch.testing.assert_close(cost[driven], -0.1 * turn[driven].abs() / 0.2, atol=1e-5, rtol=1e-4)
    assert cost[driven].min() < -0.07

    sample = names["replay"].sample()
    torchrl = DQNLoss(names["actor"], double_dqn=True, delay_value=True, action_space="categorical")
    torchrl.make_value_estimator(gamma=0.97)  # as the comment has it
    torch.testing.assert_close(names["D3QNLoss"](names["actor"], gamma=0.97)(sample)["loss"], torchrl(sample)["loss"])


def test_the_actions_are_those_of_the_table():
    (row,) = re.findall(r"^\| sets \|(.*)\|$", TEXT, re.MULTILINE)
    units = {"m/s": "linear", "rad/s": "angular"}
    for cell, action in zip(row.split("|"), ACTIONS, strict=True):
        value, unit = cell.split()
        number = eval(value.replace("π", str(math.pi)).replace("−", "-"))
        assert getattr(action, units[unit]) == number
        assert sum(one is not None for one in action) == 1


def test_links_lead_somewhere():
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", TEXT)
    assert targets
    assert all((PAGE.parent / target).exists() for target in targets)
