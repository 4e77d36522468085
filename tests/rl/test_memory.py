"""The allocator keeps what was freed, seen from outside: by counting page faults."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

COUNT_PAGE_FAULTS = """
import resource, sys
import numpy as np
from rl.memory import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
def page_faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for repetition in range(8):
    if repetition == 2:
        before = page_faults()
    blocks = [np.full(300_000, 1, np.uint8) for _ in range(5)]
    del blocks
print(page_faults() - before)
"""


def page_faults(choice: str) -> int:
    command = [sys.executable, "-c", COUNT_PAGE_FAULTS, choice]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_freed_memory_is_used_again_without_page_faults():
    assert page_faults("keep") < 0.2 * page_faults("return")
