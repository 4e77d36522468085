"""Processes that work for another one: none outlives it, and the death of one is told."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

_PR_SET_PDEATHSIG = 1  # prctl(2)


class WorkerDeathError(ChildProcessError):
    """A process that was started to share the work has been killed, or has crashed."""


def end_with_parent(parent: int) -> None:
    """Has this process killed when the one that started it ends, by whatever means.

    On Linux the system does it, even to a process that is stopped or waits for a lock; the parent there is the thread
    that started this process. Elsewhere a thread of this process looks for the parent every second.

    Args:
        parent: the number of the process that started this one. If it has ended already, this one ends here.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    else:
        threading.Thread(target=_outlast, args=(parent,), daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def _outlast(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


@contextmanager
def deaths_told(what: str, remedy: str) -> Iterator[None]:
    """Tells in one sentence that a process of a pool has died.

    Args:
        what: the processes did, as in "that make rooms".
        remedy: what to do.

    Raises:
        WorkerDeathError: in place of ``BrokenProcessPool``.
    """
    try:
        yield
    except BrokenProcessPool as error:
        raise WorkerDeathError(
            f"one of the processes {what} was killed, perhaps because the memory was exhausted; {remedy}"
        ) from error


def processor_seconds(process: int) -> float | None:
    """Processor time that a process has used so far, all its threads together; None where the system does not tell."""
    try:
        with open(f"/proc/{process}/stat", encoding="ascii", errors="replace") as file:
            fields = file.read().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def family_processor_seconds(children: Iterable[int]) -> float:
    """Processor time of this process, of those it has started that have ended, and of those that are still at work.

    Args:
        children: the numbers of the latter.
    """
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + sum(processor_seconds(c) or 0.0 for c in children)
