"""What a run of these tests tells at its end."""

from __future__ import annotations

import pytest
from comparison import LEDGER


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for name, total in sorted(LEDGER.items()):
        terminalreporter.write_line(
            f"depth compared with {name}: {total.poses:,} poses, {total.pixels:,} pixels, "
            f"{total.off / total.pixels:.4%} of them off by more than 1 mm"
        )
