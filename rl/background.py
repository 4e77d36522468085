"""Collecting in a process of its own: TorchRL's ``AsyncCollector``, watched, and replaced when it dies or hangs."""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import AsyncCollector, Collector
from torchrl.weight_update import SharedMemWeightSyncScheme

from navsim.processes import end_with_parent, processor_seconds
from rl.env import NavEnv
from rl.memory import keep_freed_memory

COLLECTOR_SETTINGS = {"track_traj_ids": False, "use_buffers": False, "auto_register_policy_transforms": False}
"""Of TorchRL's ``Collector``, wherever it runs: nothing of what they turn off is used here."""

MOST_REPLACEMENTS = 3
"""Processes that are started in place of failed ones, in one run: what fails a fourth time will fail again."""

REPLACED = "another one has taken its place"
"""Is said of each of them."""

_MOST_TEXT = 60_000  # bytes; a pipe that nobody reads takes 65,536 before it blocks who writes


class CollectorError(RuntimeError):
    """The collecting process has come to an end that it should not have."""


class PersistentCollector:
    """A ``BackgroundCollector`` that is replaced when its process dies or hangs.

    The new process goes on with the policy as it is then, other random numbers, and new episodes, for as many
    transitions as are still to be collected.

    Args:
        start: makes a collector of a seed and a number of transitions to collect.
        seed: of the first collector; those of its successors are derived from it.
        total_frames: transitions in all.
        replaced: is told of each replacement, when the new process is at work; the text may have many lines.

    Raises:
        CollectorError: if the first process does not come to work.
    """

    def __init__(
        self,
        start: Callable[[int, int], BackgroundCollector],
        *,
        seed: int,
        total_frames: int,
        replaced: Callable[[str], None],
    ) -> None:
        self._start, self._seed, self._total_frames, self._replaced = start, seed, total_frames, replaced
        self._frames, self._failed = 0, 0
        self._current = start(seed, total_frames)

    @property
    def procs(self) -> list[Any]:
        """The process, as the only one in a list, like TorchRL's collectors have it."""
        return self._current.procs

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Batches, in the order in which they were collected.

        Raises:
            CollectorError: if the process has failed once more than ``MOST_REPLACEMENTS``.
        """
        while self._frames < self._total_frames:
            try:
                for batch in self._current:
                    self._frames += batch.numel()
                    yield batch
            except CollectorError as error:
                self._replace(error)

    def _replace(self, error: CollectorError) -> None:
        while True:
            self._current.shutdown(raise_on_error=False)
            self._failed += 1
            if self._failed > MOST_REPLACEMENTS:
                raise CollectorError(f"{error}\nit is the {self._failed}th that has failed in this run") from error
            try:
                self._current = self._start(self._seed_of(self._failed), self._total_frames - self._frames)
            except CollectorError as another:
                error = another
            else:
                break
        self._replaced(f"{error}\n{REPLACED} ({self._failed} of at most {MOST_REPLACEMENTS})")

    def _seed_of(self, replacement: int) -> int:
        return int(np.random.SeedSequence((self._seed, replacement)).generate_state(1)[0])

    def update_policy_weights_(self) -> None:
        """Makes the process collect with the policy as it is now."""
        self._current.update_policy_weights_()

    def shutdown(self, *, raise_on_error: bool = True) -> None:
        """Ends the process."""
        self._current.shutdown(raise_on_error=raise_on_error)


class BackgroundCollector(AsyncCollector):
    """TorchRL's ``AsyncCollector``: one process that simulates the next batch while the learner works on the last one.

    Back-pressure goes both ways: the process waits when the learner has not taken its batch yet, so it is never more
    than two batches ahead, and the learner waits for batches, so that the ratio of updates to transitions is kept
    whatever their speeds. Policy and shares of random actions are those of the last ``update_policy_weights_``, which
    writes them where the process reads them.

    What is different from TorchRL's:

    - An exception in the process, or a crash, is told here, with its traceback, as well as its death at other hands.
    - A process that hangs is killed, and told with the place where it hung, if it can say. It hangs when it has taken
      no step of its environment, or while it starts has used no processor time, for ``timeout`` seconds in which the
      learner waited for it. These seconds are counted one by one, so that none pass while the machine sleeps, or while
      Ctrl-Z stops all processes; and a step takes milliseconds.
    - The process ends with its parent, whatever ends that, even when it hangs (``navsim.processes.end_with_parent``).
    - Ctrl-C and SIGTERM, which a terminal or a machine that shuts down sends to every process, are left to the learner
      to heed.

    Args:
        env: whose worlds, robots and sensors the process's own environment has.
        policy: the exploring policy.
        seed: of the process's environment and random actions.
        frames_per_batch: transitions in a batch.
        total_frames: transitions in all.
        timeout: seconds without a sign of life after which the process is killed.

    Raises:
        CollectorError: if the process does not come to work.
    """

    def __init__(
        self,
        env: NavEnv,
        policy: TensorDictModuleBase,
        *,
        seed: int,
        frames_per_batch: int,
        total_frames: int,
        timeout: float = 120.0,
    ) -> None:
        self._threads = torch.get_num_threads()
        context = multiprocessing.get_context("spawn")
        self._failures, failures = context.Pipe(duplex=False)
        self._steps = context.Value("Q", 0, lock=False)
        self._timeout = timeout
        self._is_at_work, self._is_awaited, self._hung = False, True, False
        self._weights = _UnacknowledgedWeights(sync=False)
        self._closing = threading.Event()
        threading.Thread(target=_watch, args=(weakref.ref(self), self._closing, timeout), daemon=True).start()
        simulator = env.simulator
        try:
            super().__init__(
                partial(
                    NavEnv,
                    simulator.worlds,
                    simulator.num_robots,
                    camera=simulator.camera,
                    task=simulator.task,
                    robot=simulator.robot,
                    sensor=simulator.sensor,
                    randomization=simulator.randomization,
                    frame_interval=env.frame_interval,
                    surroundings=env.surroundings is not None,
                    seed=seed,
                ),
                policy,
                frames_per_batch=frames_per_batch,
                total_frames=total_frames,
                num_threads=self._threads,
                collector_class=partial(_WorkerCollector, failures=failures, steps=self._steps, seed=seed),
                auto_register_policy_transforms=False,
                weight_sync_schemes={"policy": self._weights},
                init_fn=partial(_begin, os.getpid()),
            )
        except Exception as error:
            if not self._has_ended():
                raise  # it is not the process that has failed
            message = self._obituary(error)
            self.shutdown(raise_on_error=False)
            raise CollectorError(message) from error
        finally:
            failures.close()
        self._is_at_work, self._is_awaited = True, False
        # Nobody else must hold the end that the process writes to: else its death in the middle of a message would
        # leave the learner waiting for the rest.
        self.queue_out._writer.close()

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches, in the order in which they were collected.

        Raises:
            CollectorError: if the process has ended, or hangs.
        """
        try:
            yield from super().iterator()
        except (RuntimeError, OSError, EOFError, pickle.UnpicklingError) as error:
            raise CollectorError(self._obituary(error)) from error

    def _get_from_queue(self, timeout: float | None = None) -> tuple[int, int, TensorDictBase]:
        self._is_awaited = True
        try:
            return super()._get_from_queue(timeout=timeout)
        finally:
            self._is_awaited = False

    def _sign_of_life(self) -> float | None:
        """A number that grows as long as the process lives; None where there is none."""
        if self._is_at_work:
            return self._steps.value
        processes = getattr(self, "procs", ())
        return processor_seconds(processes[0].pid) if processes else None

    def _kill(self) -> None:
        """Ends a process that hangs, and has it say first where it does."""
        self._hung = True
        (process,) = self.procs
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGUSR1)
            process.join(1.0)
            os.kill(process.pid, signal.SIGKILL)
        process.join()

    def _has_ended(self) -> bool:
        processes = getattr(self, "procs", ())
        for process in processes:
            process.join(5.0)  # it says what has gone wrong shortly before it ends
        return bool(processes) and not any(process.is_alive() for process in processes)

    def _obituary(self, error: BaseException) -> str:
        (process,) = self.procs
        if not process._closed:
            process.join(5.0)
        text = self._last_words()
        if self._hung:
            how = f"hung: it gave no sign of life for {self._timeout:g} s (--worker-timeout) while it was waited for"
            return f"the collecting process {how}, and was killed" + (f"; it was here:\n{text}" if text else "")
        code = None if process._closed else process.exitcode
        if code is not None and code < 0:
            how = f"was ended by signal {-code} ({signal.Signals(-code).name})"
        elif code is None:  # it lives, but what it sends cannot be read
            how, text = "failed", text or str(error)
        elif text:
            how = "failed"
        else:
            how = f"ended with exit code {code}"
        if text:
            return f"the collecting process {how}:\n{text}"
        guess = "was it killed, or the memory exhausted?"
        if not self._is_at_work and code is not None and code > 0:  # the program it begins with has failed there
            guess = (
                "it imports your script; if that trains when it is imported, put what it does below "
                '`if __name__ == "__main__":`'
            )
        return f"the collecting process {how}, without saying why; {guess}"

    def _last_words(self) -> str:
        """What the process has written before it ended."""
        written = b""
        with contextlib.suppress(OSError):
            while self._failures.poll(0.2):
                part = os.read(self._failures.fileno(), _MOST_TEXT)
                if not part:
                    break
                written += part
        # Python's report of a crash ends with a list of all modules that are not written in Python.
        return written.decode(errors="replace").partition("\nExtension modules: ")[0].strip()

    def shutdown(self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True) -> None:
        """Ends the process, and lets go of everything that was shared with it."""
        super().shutdown(timeout=timeout, close_env=close_env, raise_on_error=raise_on_error)
        self._closing.set()
        self._failures.close()
        with contextlib.suppress(Exception):  # what TorchRL cannot close is closed with its last reference
            self._weights.shutdown()
        torch.set_num_threads(self._threads)  # TorchRL has set another number


def _watch(reference: weakref.ref[BackgroundCollector], closing: threading.Event, timeout: float) -> None:
    """Kills a collector's process that hangs.

    It takes a thread: the learner may be in the middle of a message from the process, which will not go on.
    """
    sign, silent_seconds = None, 0.0
    while not closing.wait(1.0) and (collector := reference()) is not None:
        before, sign = sign, collector._sign_of_life()
        is_silent = collector._is_awaited and sign is not None and sign == before
        silent_seconds = silent_seconds + 1.0 if is_silent else 0.0
        if silent_seconds >= timeout:
            collector._kill()
            return
        del collector


class _UnacknowledgedWeights(SharedMemWeightSyncScheme):
    """Weights in shared memory, without acknowledgements.

    Without ``sync``, nobody reads the acknowledgements that TorchRL's sends all the same: after some 3,000 updates they
    would fill their pipe, and from then on the process's memory; and it would not end before they are read.
    """

    def _send_ack(self, message: str = "updated") -> None:
        pass


def _begin(parent: int) -> None:
    """The first thing that the process does."""
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


class _WorkerCollector(Collector):
    """The collector inside a ``BackgroundCollector``'s process."""

    def __init__(self, *args: Any, failures: Connection, steps: Any, seed: int, **settings: Any) -> None:
        keep_freed_memory()
        torch.manual_seed(seed)
        self._failures, self._steps = failures, steps
        faulthandler.enable(file=failures.fileno(), all_threads=False)
        faulthandler.register(signal.SIGUSR1, file=failures.fileno(), all_threads=False)
        with self._exceptions_told():
            super().__init__(*args, **{**settings, **COLLECTOR_SETTINGS})
        self.policy.register_forward_pre_hook(self._beat)

    def _beat(self, *_: object) -> None:
        self._steps.value += 1

    def rollout(self) -> TensorDictBase:
        with self._exceptions_told():
            return super().rollout()

    @contextlib.contextmanager
    def _exceptions_told(self) -> Iterator[None]:
        try:
            yield
        except Exception:
            text = traceback.format_exc().encode()[-_MOST_TEXT:]
            os.write(self._failures.fileno(), text)
            sys.exit(1)
