"""Signals."""

from __future__ import annotations

import signal
from collections.abc import Callable


def terminate_as_interrupt() -> None:
    """Let SIGTERM end a command the way Ctrl-C does: files whole, counts reported."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with it ignored


def stop_requested() -> Callable[[], bool]:
    """A question that is answered True once Ctrl-C or SIGTERM came; for loops that must not be torn out of a step."""
    came: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _: came.append(received))
    return lambda: bool(came)
