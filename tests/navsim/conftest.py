"""What a run of these tests tells at its end, whether it ran in one process or in several."""

from __future__ import annotations

from typing import Any

import pytest
from comparison import LEDGER, Comparison


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):  # of pytest-xdist, for the process that tells
        session.config.workeroutput["depth"] = {name: vars(total) for name, total in LEDGER.items()}


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    for name, counted in getattr(node, "workeroutput", {}).get("depth", {}).items():
        total = LEDGER.setdefault(name, Comparison())
        for what, count in counted.items():
            setattr(total, what, getattr(total, what) + count)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for name, total in sorted(LEDGER.items()):
        terminalreporter.write_line(
            f"depth compared with {name}: {total.poses:,} poses, {total.pixels:,} pixels, "
            f"{total.off / total.pixels:.4%} of them off by more than 1 mm"
        )
