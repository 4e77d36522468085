"""What all tests need."""

from __future__ import annotations

import gc
import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell that starts this in the background has it ignore Ctrl-C, and so all processes that the tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What is imported lives as long as the tests, and looking through it for garbage again and again took a tenth of their
# time.
gc.disable()


def pytest_collection_finish() -> None:
    """Only what tests make is garbage at some time."""
    gc.freeze()
    gc.enable()
