"""How a :class:`navsim.check.Report` reads in a terminal: like a compiler's messages, then what the room is like."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from json import dumps as json_text

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from navsim.check import PathSummary, Report, Summary, UnreadableError
from navsim.errors import Finding, counted
from navsim.passages import Passage
from navsim.worldfile import text_lines

_STYLES = {"error": "bold red", "warning": "bold yellow"}
_MARGIN = 6  # columns of a terminal before the text of a line


USAGE_ERROR, ODD = 2, 1
"""Exit statuses: for a file that breaks the rules, and for one that is odd where that is not good enough."""


def print_reports(
    reports: Iterable[Report | UnreadableError],
    console: Console,
    errors: Console,
    *,
    paths: bool = False,
    json: bool = False,
    strict: bool = False,
) -> int:
    """Prints reports as they come, and returns the exit status: 0, ``ODD`` or ``USAGE_ERROR``.

    Args:
        reports: one for each file, or why it could not be read.
        console: where summaries go, or the JSON document.
        errors: where findings go.
        paths: add a table of the paths to each summary.
        json: print a list of :meth:`navsim.check.Report.to_dict` instead.
        strict: warnings count as well.
    """
    status, documents = 0, []
    for report in reports:
        if isinstance(report, UnreadableError):
            status = USAGE_ERROR
            documents.append(report.to_dict())
            if not json:
                errors.print(Text(str(report), "bold"), soft_wrap=True)
            continue
        if report.errors:
            status = USAGE_ERROR
        elif strict and report.warnings:
            status = max(status, ODD)
        if json:
            documents.append(report.to_dict())
        else:
            print_findings(report, errors)
            print_summary(report, console, paths)
    if json:
        console.out(json_text(documents, indent=2, ensure_ascii=False), highlight=False)
    return status


def print_findings(report: Report, console: Console) -> None:
    """Prints each finding with its place, the line it is in, and what is at fault in it underlined."""
    lines = text_lines(report.text)
    for finding in report.findings:
        place = f"{report.source}:{finding.line}:{finding.column}: "
        message = Text.assemble(
            (place, "bold"), (finding.severity, _STYLES[finding.severity]), (f": {finding.text}", "bold")
        )
        console.print(message, soft_wrap=True)
        if finding.line <= len(lines) and lines[finding.line - 1].strip():
            for line in _underlined(lines[finding.line - 1], finding, console.width):
                console.print(line, soft_wrap=True)


def _underlined(line: str, finding: Finding, width: int) -> tuple[Text, Text]:
    """A line of the file with its number, and a line of carets below what is at fault; both fit into the terminal."""
    begin, end = finding.column - 1, max(finding.end_column - 1, finding.column)
    room = max(20, width - _MARGIN - 3)
    # A line may be megabytes long; further away than this, nothing is shown.
    start = max(0, begin - 4 * room)
    line = "".join(one if one.isprintable() else " " for one in line[start : begin + 4 * room])
    begin, end = begin - start, end - start
    first = 0
    while cell_len(line[first : min(end, begin + room // 2)]) > room - 2:
        first += 1
    shown = "…" + line[first + 1 :] if first or start else line
    if cell_len(shown) > room:
        while cell_len(shown) > room - 1:
            shown = shown[:-1]
        shown += "…"
    end = min(end, first + len(shown))
    before = cell_len(shown[: begin - first])
    carets = max(1, cell_len(shown[begin - first : end - first]))
    return (
        Text.assemble((f"{finding.line:>{_MARGIN - 2}} │ ", "dim"), shown),
        Text.assemble((f"{'':>{_MARGIN - 2}} │ ", "dim"), " " * before, ("^" * carets, _STYLES[finding.severity])),
    )


def print_summary(report: Report, console: Console, paths: bool = False) -> None:
    """Prints what the world of ``report`` is like: nothing for one with errors.

    Args:
        report: what was found out.
        console: where to print.
        paths: add a table with a row for each path.
    """
    summary = report.summary
    if summary is None:
        return
    told = f", {counted(len(report.warnings), 'warning')}" if report.warnings else ""
    console.print(
        Text.assemble((f"{report.source}: ", "bold"), ("ok", "bold green"), told, f", {report.world!r}"), soft_wrap=True
    )
    goal_radius = report.equipment.task.goal_radius
    for label, text in (
        ("floor", _floor(summary)),
        ("passages", _narrowest(summary.paths)),
        ("shortest paths", _lengths(summary, goal_radius)),
    ):
        if text:
            console.print(Text.assemble((f"  {label:<15}", "dim"), text), soft_wrap=True)
    if paths and summary.paths:
        console.print(_table(summary.paths, goal_radius))


def _floor(summary: Summary) -> str:
    kinds = ", ".join(counted(count, kind) for kind, count in summary.obstacles.items())
    covered = f"{summary.density:.1%} covered by {kinds}" if kinds else "nothing on it"
    return f"{summary.area:.4g} m², {covered}"


def _narrowest(paths: Sequence[PathSummary]) -> str:
    if not paths:
        return ""
    path = min(paths, key=lambda path: path.passage.width)
    if math.isinf(path.passage.width):
        return "nothing narrows the ways"
    where = f"{_between(path.passage)}, from starts[{path.start}] to goals[{path.goal}]"
    return f"{path.passage.width:.2f} m at the narrowest {where} (on the widest way)"


def _lengths(summary: Summary, goal_radius: float) -> str:
    if not summary.paths:
        return ""
    lengths = [path.length for path in summary.paths]
    mean = sum(lengths) / len(lengths)
    spread = f"{min(lengths):.2f} to {max(lengths):.2f} m, {mean:.2f} m on average"
    count, beyond = len(lengths), summary.paths_left_out
    counted = f"the first {count} of {count + beyond}" if beyond else f"{count}"
    return f"{counted}: {spread} (to {goal_radius:g} m from the goal)"


def _between(passage: Passage) -> str:
    left, right = passage.sides
    return f"between '{left}' and '{right}'" if left != right else f"within '{left}'"


def _table(paths: Sequence[PathSummary], goal_radius: float) -> Table:
    table = Table()
    for heading in (
        "start",
        "goal",
        f"shortest way, m,\nto {goal_radius:g} m from the goal",
        "narrowest of the\nwidest way, m",
    ):
        table.add_column(heading, justify="right")
    table.add_column("between")
    for path in paths:
        width, sides = path.passage
        passage = (f"{width:.2f}", " – ".join(sides)) if math.isfinite(width) else ("wide open", "")
        table.add_row(str(path.start), str(path.goal), f"{path.length:.2f}", *passage)
    return table
