"""Where time goes: seconds spent in named functions of a program that knows nothing of it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

Parts = Mapping[str, tuple[tuple[Any, str], ...]]
"""Functions, as their owner and their name, for each named part."""


@contextmanager
def stopwatch(parts: Parts, clock: Callable[[], float] = time.perf_counter) -> Iterator[dict[str, float]]:
    """Seconds spent in each part while the context lasts; time in a part that another one calls is the inner part's.

    Args:
        parts: what each part consists of.
        clock: tells seconds: by default those that pass, whatever else the machine does meanwhile.
    """
    spent: dict[str, float] = defaultdict(float)
    within: list[float] = []  # seconds spent in inner parts, for each part that is running

    def timed(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*args: Any, **kwargs: Any) -> Any:
            within.append(0.0)
            begin = clock()
            try:
                return function(*args, **kwargs)
            finally:
                seconds = clock() - begin
                spent[part] += seconds - within.pop()
                if within:
                    within[-1] += seconds

        return run

    with ExitStack() as stack:
        for part, functions in parts.items():
            for owner, name in functions:
                stack.enter_context(patch.object(owner, name, timed(part, getattr(owner, name))))
        yield spent
