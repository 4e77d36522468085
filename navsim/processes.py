"""Processes that work for another one: none outlives it, and the death of one is told."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.pool import ExceptionWithTraceback  # type: ignore[attr-defined]
from typing import Any, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")

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


def map_in_processes(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    what: str,
    remedy: str,
    processes: int | None = None,
    at_once: int = 1,
) -> Iterator[Result]:
    """The function's results in the order of the items, from processes that share the work.

    Unlike ``concurrent.futures`` and ``multiprocessing.Pool``, whose processes share pipes and locks, it is never left
    waiting for a process that has been killed, even in the middle of a result (python/cpython#94777 is one such wait):
    each process has a connection of its own, which ends with it. The processes are fresh ones: one that is forked off
    a program with threads, as PyTorch's, may wait for a lock forever.

    Args:
        function: of a module that the processes can import.
        items: what it is called with; one after another, they go to the processes.
        what: the processes do, as in "that make rooms".
        remedy: what to do when one of them dies.
        processes: how many; by default one for each processor.
        at_once: items that go to a process together.

    Raises:
        WorkerDeathError: if a process has been killed, or has crashed; the others are ended first.
        Exception: what ``function`` raises.
    """
    parts = [items[begin : begin + at_once] for begin in range(0, len(items), at_once)]
    number = min(processes or os.cpu_count() or 1, len(parts))
    workers: list[_Worker] = []
    try:
        workers = [_Worker(function) for _ in range(number)]
        yield from _results(workers, parts)
    except _LostError as error:
        how = error.worker.death() or "has closed its connection"
        for worker in workers:
            worker.process.kill()
        raise WorkerDeathError(f"one of the processes {what} {how}; {remedy}") from error
    finally:
        for worker in workers:
            worker.connection.close()  # with its next look at it, the process ends
        for worker in workers:
            worker.process.join()


class _LostError(Exception):
    """A process's end of its connection is closed."""

    def __init__(self, worker: _Worker) -> None:
        super().__init__()
        self.worker = worker


class _Worker:
    """A process that calls a function, and this end of its connection."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(os.getpid(), function, theirs))
        self.process.start()
        theirs.close()  # nobody but the process holds it: what we read ends with the process

    def send(self, part: Sequence[Any]) -> None:
        """Gives the process something to do."""
        with self._losses_told():
            self.connection.send(part)

    def receive(self) -> list[Any]:
        """The results of what the process was given last; raises what the function has raised."""
        with self._losses_told():
            results, error = self.connection.recv()
        if error is not None:
            raise error
        return cast(list[Any], results)

    @contextmanager
    def _losses_told(self) -> Iterator[None]:
        try:
            yield
        except (EOFError, OSError) as error:  # an end in the middle of a message is an OSError without a number
            raise _LostError(self) from error

    def death(self) -> str | None:
        """What has ended the process, which lives no more or is just ending; None if it lives."""
        self.process.join(1.0)
        code = self.process.exitcode
        if code is None:
            return None
        if code == -signal.SIGKILL:
            return "was killed, perhaps because the memory was exhausted"
        return f"was ended by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"ended with code {code}"


def _results(workers: list[_Worker], parts: list[Sequence[Any]]) -> Iterator[Any]:
    """The results of all parts, in order, each part handed to the first process that has nothing to do."""
    waiting = list(enumerate(parts))[::-1]
    at_work: dict[_Worker, int] = {}
    finished: dict[int, list[Any]] = {}
    idle = list(workers)
    for due in range(len(parts)):
        while due not in finished:
            while idle and waiting:
                worker = idle.pop()
                at_work[worker], part = waiting.pop()
                worker.send(part)
            ready = wait([worker.connection for worker in at_work])
            for worker in [worker for worker in at_work if worker.connection in ready]:
                finished[at_work.pop(worker)] = worker.receive()
                idle.append(worker)
        yield from finished.pop(due)


def _work(parent: int, function: Callable[[Any], Any], connection: Connection) -> None:
    """What a process does until nobody holds the other end of its connection."""
    end_with_parent(parent)
    with contextlib.suppress(EOFError, ConnectionError, KeyboardInterrupt):
        while True:
            part = connection.recv()
            try:
                answer: tuple[Any, Any] = [function(item) for item in part], None
            except Exception as error:
                answer = None, ExceptionWithTraceback(error, error.__traceback__)
            connection.send(answer)


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
