"""Everything there is to say about a world file: what is wrong, what is odd, and what the room is like.

>>> report = check_text("format: 1\\nsize: [4, 4]\\nwals: none\\n")
>>> report.ok
False
>>> [(finding.line, finding.column, finding.end_column, finding.text) for finding in report.findings]
[(3, 1, 5, "wals: is not a known key; did you mean 'walls'?")]
"""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from navsim.errors import Finding, Problem, WorldError
from navsim.oddities import MOST_PATHS, Equipment, oddities, outlines, passages_of, way_length
from navsim.passages import Passage
from navsim.task import NoFreeMomentError, Path
from navsim.world import MOST_TOLD, Goal, Start, World, parse_world
from navsim.worldfile import decoded, read_document, read_file

_TURNS = 8
"""Yaws that are tried of a start that leaves them open, and episodes where something moves."""
_Beginning = tuple[np.ndarray, np.ndarray | tuple[()]]
"""Of a try: the pose, and the phases of what moves."""

Progress = Callable[[Iterable[Any], int], Iterable[Any]]
"""Passes on what it is given, of that many, and shows how far it has come."""


@dataclass(frozen=True)
class PathSummary:
    """One pair of a start and a goal."""

    start: int
    """Index in ``starts``."""
    goal: int
    """Index in ``goals``."""
    length: float
    """Of the robot's shortest way to the disc around the goal that counts as reaching it, metres."""
    passage: Passage
    """The narrowest passage on the *widest* way, which may be another than the shortest."""


@dataclass(frozen=True)
class Summary:
    """What a world is like."""

    area: float
    """Of the floor, square metres."""
    obstacles: dict[str, int]
    """How many there are of each kind."""
    density: float
    """Share of the floor that the obstacles cover, seen from above, 0 to 1."""
    paths: tuple[PathSummary, ...]
    """The first ``MOST_PATHS`` pairs of a start and a goal; empty where either is random."""
    paths_left_out: int = 0
    """How many more pairs there are."""


@dataclass(frozen=True)
class Report:
    """What was found out about the text of a world file."""

    source: str
    """What the file is called."""
    text: str
    world: World | None
    """None when there are errors."""
    findings: tuple[Finding, ...]
    """Errors and warnings, in the order of the text. A world with errors is not looked at for what is odd."""
    equipment: Equipment

    @property
    def errors(self) -> tuple[Finding, ...]:
        """What the format forbids."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What is legal but odd."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")

    @property
    def ok(self) -> bool:
        """Whether the text is a world."""
        return self.world is not None

    @cached_property
    def summary(self) -> Summary | None:
        """What the world is like; None when there are errors. It is worked out when it is first asked for."""
        return None if self.world is None else summarise(self.world, self.equipment)

    def to_dict(self) -> dict[str, Any]:
        """The report as plain data for JSON; a width that nothing limits is null, and so is a way that there is not."""
        data: dict[str, Any] = {
            "file": self.source,
            "ok": self.ok,
            "findings": [{**one._asdict(), "where": list(one.where)} for one in self.findings],
            "summary": None,
        }
        if self.summary is not None:
            data["summary"] = asdict(self.summary)
            for told, path in zip(data["summary"]["paths"], self.summary.paths, strict=True):
                width, sides = path.passage
                told["passage"] = {"width": width if math.isfinite(width) else None, "sides": list(sides)}
                told["length"] = path.length if math.isfinite(path.length) else None
        return data


class UnreadableError(WorldError):
    """A world file that there is not, or that cannot be read.

    Args:
        source: the file.
        error: why.
    """

    def __init__(self, source: str, error: WorldError) -> None:
        super().__init__(error.problems, error.findings)
        self.source = source

    def to_dict(self) -> dict[str, Any]:
        """As :meth:`Report.to_dict`: the reasons are findings in line 1."""
        findings = self.findings or [Finding(1, 1, 2, problem) for problem in self.problems]
        told = [{**one._asdict(), "where": list(one.where)} for one in findings]
        return {"file": self.source, "ok": False, "findings": told, "summary": None}


def check_file(
    path: str | os.PathLike[str],
    *,
    equipment: Equipment | None = None,
    solve: bool = False,
    progress: Progress = lambda items, total: items,
) -> Report:
    """What there is to say about a world file, or about a shipped world by its name; see :func:`check_text`.

    Raises:
        WorldError: when there is no such file, or it cannot be read.
    """
    file, content = read_file(path)
    return check_text(content, str(file), file.stem, equipment=equipment, solve=solve, progress=progress)


def check_files(
    paths: Iterable[str | os.PathLike[str]], *, solve: bool = False, progress: Progress = lambda items, total: items
) -> Iterator[Report | UnreadableError]:
    """A report for each of ``paths``, or why it cannot be read; see :func:`check_text`."""
    for path in paths:
        try:
            yield check_file(path, solve=solve, progress=progress)
        except WorldError as error:
            yield UnreadableError(str(path), error)


def check_text(
    content: bytes | str,
    source: str = "<text>",
    default_name: str = "world",
    *,
    equipment: Equipment | None = None,
    solve: bool = False,
    progress: Progress = lambda items, total: items,
) -> Report:
    """What there is to say about the text of a world file.

    Args:
        content: the text, or its UTF-8 bytes.
        source: what the report calls it.
        default_name: name of a world whose text does not name it.
        equipment: robot, camera and task that the world is meant for.
        solve: have the planning oracle drive every path as well, which takes a second or so a path.
        progress: told of the oracle's paths.
    """
    equipment = equipment or Equipment()
    text = content if isinstance(content, str) else content.decode("utf-8-sig", errors="replace")
    try:
        if isinstance(content, bytes):
            text = decoded(content, source)
        document = read_document(text, source)
        world, problems = parse_world(document.data, default_name)
        if world is None or document.problems:
            document.refuse(problems)
    except WorldError as error:
        return Report(source, text, None, error.findings, equipment)
    odd = oddities(world, equipment)
    if len(odd) > MOST_TOLD:
        odd = [*odd[:MOST_TOLD], Problem((), f"{len(odd) - MOST_TOLD} more oddities are not told; look at these first")]
    if solve:
        odd += unsolved(world, equipment, progress)
    return Report(source, text, world, tuple(document.findings(odd, "warning")), equipment)


def unsolved(
    world: World, equipment: Equipment | None = None, progress: Progress = lambda items, total: items
) -> list[Problem]:
    """The paths that the planning oracle finds no way along, which knows the map and has the robot's own actions.

    A start without a yaw counts as solved when one of eight yaws leads to the goal; where something moves, a path does
    when one of eight episodes can be driven, and counts for nothing when none can begin.
    """
    from navsim.oracle import Oracle

    if isinstance(world.starts, str) or isinstance(world.goals, str):
        return []
    equipment = equipment or Equipment()
    oracle = Oracle(world, equipment.camera, equipment.task, equipment.robot)
    problems = []
    moves = any(one.motion is not None for one in world.obstacles)
    for i, j in progress(world.paths, len(world.paths)):
        start, goal = world.starts[i], world.goals[j]
        begun = _episodes(world, Path(i, j), equipment) if moves else _yaws_tried(start, goal)
        if begun and all(oracle.plan(pose, np.array(goal.at), phases) is None for pose, phases in begun):
            text = (
                f"the oracle, which knows the map, finds no way from starts[{i}] that can be driven in an episode; "
                "widen the gaps or move one of them"
            )
            problems.append(Problem(("goals", j), text))
    return problems


def _yaws_tried(start: Start, goal: Goal) -> list[_Beginning]:
    yaws = [start.yaw_deg or 0.0]
    if start.yaw_deg is None:
        bearing = math.degrees(math.atan2(goal.at[1] - start.at[1], goal.at[0] - start.at[0]))
        yaws = [bearing + 360.0 / _TURNS * turn for turn in sorted(range(1 - _TURNS // 2, _TURNS // 2 + 1), key=abs)]
    return [(np.array([*start.at, math.radians(yaw)]), ()) for yaw in yaws]


def _episodes(world: World, path: Path, equipment: Equipment) -> list[_Beginning]:
    generator, episodes = np.random.default_rng(0), equipment.episodes(world)
    try:
        drawn = [episodes.draw(generator, path) for _ in range(_TURNS)]
    except NoFreeMomentError:  # told as an oddity
        return []
    return [(episode.pose, episode.phases) for episode in drawn]


def summarise(world: World, equipment: Equipment | None = None) -> Summary:
    """What ``world`` is like."""
    equipment = equipment or Equipment()
    room = shapely.box(*-world.half_size, *world.half_size)
    covered = shapely.union_all(outlines(world.obstacles)).intersection(room).area
    paths = tuple(
        PathSummary(i, j, way_length(world, i, j, equipment), passage)
        for i, j, passage in itertools.islice(
            (
                (i, j, passage)
                for i, row in enumerate(passages_of(world, equipment.robot))
                for j, passage in enumerate(row)
            ),
            MOST_PATHS,
        )
    )
    kinds = Counter(obstacle.kind for obstacle in world.obstacles)
    left_out = len(world.paths) - len(paths)
    return Summary(room.area, dict(sorted(kinds.items())), covered / room.area, paths, left_out)
