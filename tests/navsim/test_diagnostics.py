"""How a report is printed."""

from __future__ import annotations

import io
import time

from rich.console import Console

from navsim.check import check_text
from navsim.diagnostics import print_findings


def printed(text: str) -> str:
    output = io.StringIO()
    print_findings(check_text(text, "room.yaml"), Console(file=output, width=80))
    return output.getvalue()


def test_of_a_line_of_megabytes_what_is_at_fault_is_shown_at_once():
    begin = time.process_time()
    shown = printed(f"format: 1\nsize: [4, 4]\nname: {'a' * 3_000_000}\nheigth: 1\n{'b' * 1_000_000}: 2\n")
    assert time.process_time() - begin < 5.0  # it took minutes when every column was measured anew
    rows = [row for row in shown.splitlines() if "│" in row]
    assert rows
    assert all(len(row) <= 80 for row in rows)


def test_far_into_a_long_line_the_fault_is_underlined():
    shown = printed(f"{{format: 1, size: [4, 4], name: {'a' * 1_000}, heigth: 1}}\n")
    source, carets = (row for row in shown.splitlines() if "│" in row)
    assert source[carets.index("^") : carets.rindex("^") + 1] == "heigth"
    assert "│ …" in source
