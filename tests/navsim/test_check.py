"""Reports on world files: where findings are, what counts as odd, and what a room is like."""

from __future__ import annotations

import io
import itertools
import json
import math
import re

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console
from world_corpus import RICH, RIGHT, ROOM, WRONG_GEOMETRY, WRONG_STRUCTURE, WRONG_YAML

import navsim
from navsim.check import check_file, check_files, check_text, summarise, unsolved
from navsim.diagnostics import print_findings, print_reports
from navsim.errors import WorldError
from navsim.oddities import Equipment, oddities
from navsim.robot import Robot
from navsim.world import Box, Cylinder, Polygon, World
from navsim.worldfile import parse_text, text_lines


def marked(text: str) -> list[tuple[str, str, str]]:
    """Of each finding, severity, the text that it underlines, and what it says."""
    lines = text_lines(text)
    return [
        (one.severity, lines[one.line - 1][one.column - 1 : one.end_column - 1], one.text)
        for one in check_text(text).findings
    ]


@pytest.mark.parametrize("text", [*RIGHT.values(), *WRONG_STRUCTURE.values(), *WRONG_GEOMETRY.values()])
def test_errors_are_those_of_the_loader_at_the_same_places(text):
    try:
        parse_text(text)
        expected = []
    except WorldError as error:
        expected = list(error.problems)
    errors = check_text(text).errors
    assert [f"<text>:{one.line}:{one.column}: {one.text}" for one in errors] == expected


@pytest.mark.parametrize("text", [*WRONG_STRUCTURE.values(), *WRONG_GEOMETRY.values(), *WRONG_YAML.values(), "", "\t"])
def test_every_finding_lies_in_the_text(text):
    report = check_text(text)
    assert report.errors
    assert report.world is None
    assert report.summary is None
    lines = text_lines(text)
    for one in report.findings:
        assert 1 <= one.line <= len(lines)
        assert one.column < one.end_column <= max(len(lines[one.line - 1]), one.column) + 1


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_findings_lie_in_whatever_is_typed(data):
    text = RICH
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        text = text[:at] + data.draw(st.text("é\t\r\n :,[]{}#-x1'\"&*~\u2028", max_size=3)) + text[at + 2 :]
    lines = text_lines(text)
    for one in check_text(text).errors:
        assert 1 <= one.line <= len(lines)
        assert 1 <= one.column < one.end_column <= max(len(lines[one.line - 1]), one.column) + 1


@pytest.mark.parametrize(
    ("text", "underlined"),
    [
        ("wals: none  # oh", "wals"),
        ("name: 5 # five", "5"),
        ("walls: {hight: 1}", "hight"),
        ("walls:\n  height: [1, 2]  # m", "[1, 2]"),
        ("walls:\n  height: [1,\n   2]", "[1"),
        ("obstacles:\n  - cylinder: {at: [1, 1], height: 1}  # no radius", "{at: [1, 1], height: 1}"),
        ("obstacles:\n  - cylinder:\n      at: [1, 1]  # no radius\n      height: 1", "at: [1, 1]"),
        ("obstacles: [{box: {at: [1, 1], size: [1, -1], height: 1}}]", "-1"),
        ('name: "é\\n" # x\nstarts: [[9, 0]]', "[9, 0]"),
        ("goals: [[0, 0], &a [9, 9]]", "&a [9, 9]"),
        ("starts: anywhere", "anywhere"),
        ("name: *x", "*x"),
    ],
)
def test_what_is_at_fault_is_underlined(text, underlined):
    ((severity, shown, _),) = marked(f"{ROOM}{text}\n")
    assert (severity, shown) == ("error", underlined)


ODD = {
    "same names": (
        "obstacles:\n  - box: {name: a, at: [1, 1], size: [1, 1], height: 1}\n"
        "  - cylinder: {name: a, at: [-1, 1], radius: 0.1, height: 1}",
        ("a", "'a' is also the name of obstacles[0]; give each a name of its own"),
    ),
    "a default name taken": (
        "obstacles:\n  - box: {name: cylinder 2, at: [1, 1], size: [1, 1], height: 1}\n"
        "  - cylinder: {at: [-1, 1], radius: 0.1, height: 1}",
        ("{at: [-1, 1], radius: 0.1, height: 1}", "'cylinder 2' is also the name of obstacles[0]"),
    ),
    "reaching out": (
        "obstacles: [{box: {at: [3.4, 0], size: [0.5, 1], height: 1}}]",
        ("box", "reaches 0.15 m beyond the room; move it in or enlarge 'size'"),
    ),
    "reaching out, round": (
        "obstacles: [{cylinder: {at: [0, -3.4], radius: 0.2, height: 1}}]",
        ("cylinder", "reaches 0.1 m beyond the room"),
    ),
    "inside another": (
        "obstacles:\n  - polygon: {points: [[0, 0], [2, 0], [2, 2], [1, 2], [1, 1], [0, 1]], height: 1}\n"
        "  - cylinder: {at: [1.2, 0.9], radius: 0.15, height: 0.5, base: 0.2}",
        ("cylinder", "is wholly inside 'polygon 1' and changes nothing; move it or leave it out"),
    ),
    "twice": (
        "obstacles:\n  - box: {at: [1, 1], size: [1, 1], height: 1}\n  - box: {at: [1, 1], size: [1, 1], height: 1}",
        ("box", "is wholly inside 'box 1' and changes nothing; move it or leave it out"),
    ),
    "out of sight": (
        "obstacles: [{box: {at: [1, 1], size: [1, 1], base: 2.5, height: 1}}]",
        ("2.5", "hangs at 2.5 m, above the robot and above all that its camera sees (2.43 m at most)"),
    ),
    "reached at once": (
        "starts: [[0, 0]]\ngoals: [[0.3, 0.3]]",
        ("[0.3, 0.3]", "is 0.42 m from starts[0]: nearer than 0.5 m counts as reached"),
    ),
    "ended at once": (
        "starts: [{at: [3.2, 0], yaw_deg: 0}]",
        ("{at: [3.2, 0], yaw_deg: 0}", "facing 0°, the robot sees something 0.39 m away: the depth rule (0.4 m) ends"),
    ),
    "radians": (
        "obstacles: [{box: {at: [1, 1], size: [1, 0.5], height: 1, yaw_deg: 1.571}}]",
        ("1.571", "1.571 is 90 degrees in radians, and degrees are meant here; write 90?"),
    ),
    "radians of a start": (
        "starts: [{at: [0, 0], yaw_deg: -2.3562}]",
        ("-2.3562", "-2.3562 is -135 degrees in radians"),
    ),
    "a narrow way": (
        "obstacles:\n  - box: {name: n, at: [0, 2], size: [0.1, 3], height: 1}\n"
        "  - box: {name: s, at: [0, -1.8], size: [0.1, 3.4], height: 1}\nstarts: [[-2, 0], [-2, 2], [2, 2]]\n"
        "goals: [[2, 0]]",
        ("[2, 0]", "the widest way from starts[0] and starts[1] leads through a gap of 0.60 m between 'n' and 's'"),
    ),
}


@pytest.mark.parametrize(("text", "expected"), ODD.values(), ids=ODD)
def test_what_is_odd_is_told(text, expected):
    report = check_text(f"{ROOM}{text}\n")
    assert report.ok
    ((severity, underlined, message),) = marked(f"{ROOM}{text}\n")
    assert (severity, underlined) == ("warning", expected[0])
    assert expected[1] in message


@pytest.mark.parametrize(
    "text",
    [
        # beside one another, over one another, around a corner of a concave one, flush with the wall
        "obstacles:\n  - box: {at: [1, 1], size: [1, 1], height: 1}\n  - box: {at: [2, 1], size: [1, 1], height: 1}",
        "obstacles:\n  - box: {at: [1, 1], size: [1, 1], height: 1}\n"
        "  - box: {at: [1, 1], size: [0.5, 0.5], base: 0.9, height: 1}",
        "obstacles:\n  - polygon: {points: [[0, 0], [2, 0], [2, 2], [1, 2], [1, 1], [0, 1]], height: 1}\n"
        "  - cylinder: {at: [0.5, 1.5], radius: 0.2, height: 0.5}",
        "obstacles: [{box: {at: [3.25, 0], size: [0.5, 1], height: 1}}]",
        "obstacles: [{box: {at: [1, 1], size: [1, 1], base: 2.4, height: 1}}]",
        "starts: [{at: [3.2, 0], yaw_deg: 90}, [3.2, 1], {at: [0, 0], yaw_deg: 3}, {at: [0, 0], yaw_deg: 1.5}]",
        "obstacles:\n  - box: {at: [0, 2.1], size: [0.1, 2.8], height: 1}\n"
        "  - box: {at: [0, -1.8], size: [0.1, 3.4], height: 1}\nstarts: [[-2, 0]]\ngoals: [[2, 0]]",
    ],
)
def test_what_is_not_odd_is_not_told(text):
    assert marked(f"{ROOM}{text}\n") == []


def test_a_goal_beyond_what_can_be_driven_in_an_episode_is_told():
    hall = "format: 1\nsize: [60, 8]\nstarts: [[-28, 0], [0, 0], [-28, 2]]\ngoals: [[28, 0]]\n"
    ((severity, underlined, message),) = marked(hall)
    assert (severity, underlined) == ("warning", "[28, 0]")
    assert "m from starts[0] (and 1 more) by the shortest way: the robot drives 40 m in the 500 steps" in message
    assert marked(hall.replace("[28, 0]", "[12.4, 0]")) == []  # 40.4 m, of which 0.5 m need not be driven


def test_a_way_longer_than_can_be_driven_in_an_episode_is_told():
    maze = "format: 1\nsize: [14, 16]\nobstacles:\n" + "".join(
        f"  - box: {{at: [{0.75 * (-1) ** (row + 1)}, {2 * row - 6}], size: [12.5, 0.1], height: 1}}\n"
        for row in range(7)
    )
    ((severity, underlined, message),) = marked(maze + "starts: [[-6, -7]]\ngoals: [[0, 7.2]]\n")
    assert (severity, underlined) == ("warning", "[0, 7.2]")
    assert re.search(r"is 8\d\.\d\d m from starts\[0\] by the shortest way: the robot drives 40 m", message)


WALKER = "{cylinder: {at: [-2.6, 0], radius: 0.2, height: 1, motion: {path: [[-2.6, 0], [-2.6, 3]], speed: 0.5}}}"


def test_what_moves_is_not_taken_for_what_stands():
    text = f"{ROOM}obstacles: [{WALKER}]\nstarts: [{{at: [-3, 0], yaw_deg: 0}}]\ngoals: [[-1, 0]]\n"
    assert check_text(text, solve=True).findings == ()


def test_a_start_that_is_never_free_is_told():
    place = "starts: [[-2.6, 0.3]]\ngoals: [[-1, 0]]\n"
    pacing = WALKER.replace("[-2.6, 3]", "[-2.6, 0.1]")
    ((severity, underlined, message),) = marked(f"{ROOM}obstacles: [{pacing}]\n{place}")
    assert (severity, underlined) == ("warning", "[-2.6, 0.3]")
    assert "no episode can begin here" in message


@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_shipped_worlds_are_not_odd(name):
    assert check_file(name).findings == ()


@pytest.mark.slow
def test_a_path_that_the_oracle_cannot_drive_is_told():
    # The robot fits through the slit, but any pixel nearer than 0.4 m ends an episode.
    text = ROOM.replace("7.0, 7.0", "4.0, 3.0") + (
        "obstacles:\n  - box: {name: n, at: [0, 0.85], size: [1.2, 1.3], height: 1}\n"
        "  - box: {name: s, at: [0, -0.85], size: [1.2, 1.3], height: 1}\n"
        "starts: [{at: [-1.4, 0], yaw_deg: 90}]\ngoals: [[-1.4, 0.9], [1.4, 0]]\n"
    )
    world = parse_text(text)
    told = []
    problems = unsolved(world, progress=lambda items, total: told.append(total) or items)
    assert told == [2]
    assert [problem.where for problem in problems] == [("goals", 1)]
    assert "finds no way from starts[0]" in problems[0].text


def test_paths_are_solved_when_asked_for_and_yaws_are_tried(monkeypatch):
    tried = []

    class Blind:
        def __init__(self, world, *_):
            pass

        def plan(self, pose, goal, phases):
            tried.append((*pose.tolist(), *goal.tolist()))
            return None if goal[0] > 0 or pose[2] < 1.0 else np.array([0])

    monkeypatch.setattr("navsim.oracle.Oracle", Blind)
    text = ROOM + "starts: [{at: [0, 0], yaw_deg: 90}, [0, -2]]\ngoals: [[2, 2], [-2, 0]]\n"
    report = check_text(text, solve=True)
    assert [(one.line, one.severity, one.text.split(";")[0]) for one in report.findings] == [
        (
            4,
            "warning",
            "goals[0]: the oracle, which knows the map, finds no way from starts[0] that can be driven in an episode",
        ),
        (
            4,
            "warning",
            "goals[0]: the oracle, which knows the map, finds no way from starts[1] that can be driven in an episode",
        ),
    ]
    assert len(tried) == 1 + 1 + 8 + 1
    assert check_text(text).findings == ()


def test_a_summary_counts_and_measures():
    world = World(
        size=(8, 5),
        obstacles=[
            Box(at=(0, 1), size=(1, 1), height=1, yaw_deg=30),
            Box(at=(0, 1), size=(1, 1), height=0.5, base=1),
            Cylinder(at=(2, -1), radius=0.5, height=1),
            Polygon(points=[(-3, -2), (-2, -2), (-2, -1)], height=1),
        ],
        starts=[(-3, 1), (3, 1)],
        goals=[(3, -2), (0, -2)],
    )
    summary = summarise(world)
    square = shapely.affinity.rotate(shapely.box(-0.5, 0.5, 0.5, 1.5), 30)
    both = square.union(shapely.box(-0.5, 0.5, 0.5, 1.5)).area
    assert summary.area == 40.0
    assert summary.obstacles == {"box": 2, "cylinder": 1, "polygon": 1}
    assert summary.density == pytest.approx((both + math.pi / 4 + 0.5) / 40, rel=1e-3)
    assert [(path.start, path.goal) for path in summary.paths] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert summary.paths[2].length == pytest.approx(navsim.planner.shortest_path_length(world, (3, 1), (3, -2)))
    assert summary.paths[2].passage.width == pytest.approx(1.5)
    assert set(summary.paths[2].passage.sides) == {"wall east", "cylinder 3"}


def test_a_summary_of_very_many_paths_tells_how_many_it_leaves_out(monkeypatch):
    monkeypatch.setattr("navsim.check.MOST_PATHS", 2)
    report = check_text(ROOM + "starts: [[-2, 0], [-2, 1]]\ngoals: [[2, 0], [2, 1]]\n")
    assert [(path.start, path.goal) for path in report.summary.paths] == [(0, 0), (0, 1)]
    assert report.summary.paths_left_out == 2
    console = Console(file=io.StringIO(), width=120, highlight=False)
    print_reports([report], console, console)
    assert "the first 2 of 4: " in console.file.getvalue()


def test_very_many_oddities_are_counted():
    inside = "  - box: {at: [0, 0], size: [1, 1], height: 1}\n" * 150
    text = ROOM + "obstacles:\n  - box: {at: [0, 0], size: [2, 2], height: 1}\n" + inside
    findings = check_text(text).findings
    assert len(findings) == 101
    assert any("50 more oddities are not told" in one.text for one in findings)


def test_a_report_is_plain_data_for_json():
    report = check_text(RICH, "room.yaml")
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["file"] == "room.yaml"
    assert data["ok"] is True
    assert data["summary"]["obstacles"] == {"box": 2, "cylinder": 3, "polygon": 1}
    assert len(data["summary"]["paths"]) == 6
    wrong = check_text(ROOM + "obstacles: [{box: {at: [1, 1], size: [1, 1]}}]\n").to_dict()
    assert (wrong["ok"], wrong["summary"], wrong["findings"][0]["where"]) == (False, None, ["obstacles", 0, "box"])


def test_a_robot_that_is_too_wide_does_not_fit():
    """The gap between the two boxes is 0.8 m wide."""
    boxes = ", ".join(f"{{box: {{at: [0, {y}], size: [0.4, 2.6], height: 1}}}}" for y in (-1.7, 1.7))
    text = f"format: 1\nsize: [6, 6]\nobstacles: [{boxes}]\nstarts: [[-2, 0]]\ngoals: [[2, 0]]\n"
    report = check_text(text, equipment=Equipment(robot=Robot(radius=0.45)))
    (finding,) = [one.text for one in report.findings if "gap of 0.80 m" in one.text]
    assert finding.endswith("the robot (0.90 m wide) does not fit")
    (path,) = json.loads(json.dumps(report.to_dict(), allow_nan=False))["summary"]["paths"]
    assert path["length"] is None


def printed(text: str, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width, highlight=False)
    print_findings(check_text(text, "room.yaml"), console)
    return console.file.getvalue()


def test_findings_read_like_a_compilers():
    assert printed(ROOM + "walls: {hight: 1}\n") == (
        "room.yaml:3:9: error: walls.hight: is not a known key; did you mean 'height'?\n"
        "   3 │ walls: {hight: 1}\n"
        "     │         ^^^^^\n"
    )


@pytest.mark.parametrize("before", ["x" * 300, "宽" * 150, ""])
def test_long_lines_are_cut_so_that_the_fault_is_seen(before):
    text = ROOM + f"walls: {{height: 1, {before or 'a'}: 1, hight: 2, {'y' * 300}: 2}}\n"
    for width in (40, 80):
        rows = printed(text, width).splitlines()
        carets = [(source, row) for source, row in itertools.pairwise(rows) if "^" in row and "│" in row]
        assert len(carets) == 3
        source, row = carets[1]
        assert cell_len(source) <= width
        at = cell_len(row[: row.index("^")])
        position = next(i for i in range(len(source)) if cell_len(source[:i]) == at)
        assert source[position:].startswith("hight")


def statuses(texts: list[str], tmp_path, **options) -> tuple[int, str, str]:
    paths = []
    for i, text in enumerate(texts):
        paths.append(tmp_path / f"{i}.yaml")
        paths[-1].write_text(text)
    out, err = (Console(file=io.StringIO(), width=80, highlight=False) for _ in range(2))
    status = print_reports(check_files(paths), out, err, **options)
    return status, out.file.getvalue(), err.file.getvalue()


def test_the_exit_status_tells_errors_from_warnings(tmp_path):
    odd = ROOM + ODD["reaching out"][0]
    assert statuses([ROOM], tmp_path)[0] == 0
    assert statuses([odd], tmp_path)[0] == 0
    assert statuses([ROOM, odd, ROOM], tmp_path, strict=True)[0] == 1
    assert statuses([odd, ROOM + "name: 5\n", odd], tmp_path, strict=True)[0] == 2
    out, err = (Console(file=io.StringIO()) for _ in range(2))
    assert print_reports(check_files([tmp_path / "none.yaml"]), out, err) == 2


def test_json_is_one_document_and_nothing_else(tmp_path):
    status, out, err = statuses([ROOM, ROOM + "name: 5\n"], tmp_path, json=True)
    assert (status, err) == (2, "")
    assert [report["ok"] for report in json.loads(out)] == [True, False]


def test_json_tells_which_file_could_not_be_read(tmp_path):
    out, err = (Console(file=io.StringIO(), width=80, highlight=False) for _ in range(2))
    (tmp_path / "room.yaml").write_text(ROOM)
    files = [tmp_path / "none.yaml", tmp_path / "room.yaml"]
    assert print_reports(check_files(files), out, err, json=True) == 2
    missing, sound = json.loads(out.file.getvalue())
    assert missing.keys() == sound.keys()
    assert (missing["file"], missing["ok"], missing["summary"]) == (str(files[0]), False, None)
    (finding,) = missing["findings"]
    assert "there is no such world file" in finding["text"]
    assert (finding["line"], finding["severity"]) == (1, "error")


def test_a_table_has_a_row_for_each_path(tmp_path):
    _, out, _ = statuses([RICH], tmp_path, paths=True)
    assert out.count("│") >= 6 * 4
    assert np.isclose(float(out.split("shortest paths")[1].split()[1]), 1.0, atol=5)


def test_what_only_a_camera_that_looks_up_sees_is_not_out_of_sight():
    high = Box(at=(3.5, 0), size=(0.5, 2), base=2.6, height=0.3)
    world = World(size=(12, 7), obstacles=[high], starts=[(-1, 0)], goals=[(2, 2)])
    looking_up = navsim.DepthCamera(pitch_deg=-25)
    assert (navsim.render_depth(world, np.array([[-1.0, 0, 0]]), looking_up) < 5.0).any()
    told = [problem.text for problem in oddities(world, Equipment(camera=looking_up))]
    assert not any("it changes nothing" in text for text in told)
    assert any("it changes nothing" in problem.text for problem in oddities(world))
