"""Processes that share work: the same results, errors told, and no waiting for those that are dead."""

import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection

import pytest

from navsim.processes import WorkerDeathError, map_in_processes

TOLD = {"what": "that count", "remedy": "count again"}


def squared(number: int) -> tuple[int, int]:
    return number * number, os.getpid()


def fails_at_five(number: int) -> int:
    if number == 5:
        raise ConnectionResetError("no room for 5")
    return number


def dies_in_the_middle_of_its_answer(number: int) -> bytes:
    if number == 5:
        send = Connection._send

        def half(connection, message):
            send(connection, bytes(message[: len(message) // 2]))
            os.kill(os.getpid(), signal.SIGKILL)

        Connection._send = half
    return bytes(1000)


def leaves_at_five(number: int) -> int:
    if number == 5:
        os._exit(3)
    return number


def answers_much(number: int) -> bytes:
    return bytes([number]) * 5_000_000


@pytest.fixture(autouse=True)
def no_process_is_left():
    before = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) <= before


@pytest.mark.parametrize(("items", "at_once"), [(0, 1), (1, 3), (7, 1), (8, 3)])
def test_results_come_in_the_order_of_the_items(items, at_once):
    found = list(map_in_processes(squared, range(items), processes=2, at_once=at_once, **TOLD))
    assert [square for square, _ in found] == [number**2 for number in range(items)]
    assert os.getpid() not in {process for _, process in found}
    assert len({process for _, process in found}) <= 2


def test_an_error_is_raised_here_after_the_results_before_it():
    results = map_in_processes(fails_at_five, range(20), processes=1, **TOLD)
    assert [next(results) for _ in range(5)] == list(range(5))
    with pytest.raises(ConnectionResetError, match="no room for 5") as caught:  # no process's end, though
        next(results)
    assert "fails_at_five" in str(caught.value.__cause__)  # the traceback there


@pytest.mark.timeout(60)
def test_a_process_that_dies_in_the_middle_of_a_result_is_told():
    """``ProcessPoolExecutor`` waits forever for the rest, and its other processes for the lock that it held."""
    with pytest.raises(WorkerDeathError, match=r"^one of the processes that count was killed, .*; count again$"):
        list(map_in_processes(dies_in_the_middle_of_its_answer, range(200), processes=2, **TOLD))


@pytest.mark.timeout(60)
def test_a_process_that_ends_by_itself_is_told_with_its_code():
    with pytest.raises(WorkerDeathError, match=r"^one of the processes that count ended with code 3; count again$"):
        list(map_in_processes(leaves_at_five, range(20), processes=2, **TOLD))


@pytest.mark.timeout(60)
def test_who_takes_no_more_results_leaves_no_process():
    results = map_in_processes(answers_much, range(20), processes=2, **TOLD)
    assert next(results)[:1] == b"\0"
    time.sleep(0.5)  # both have more to say than the connection takes
    results.close()
