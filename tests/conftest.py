"""What all tests need."""

from __future__ import annotations

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell that starts this in the background has it ignore Ctrl-C, and so all processes that the tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
