"""Signals."""

from __future__ import annotations

import signal


def terminate_as_interrupt() -> None:
    """Let SIGTERM end a command the way Ctrl-C does: files whole, counts reported."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with it ignored
