"""What ends a command: Ctrl-C, SIGTERM, a terminal that is closed."""

from __future__ import annotations

import signal
from collections.abc import Callable

ENDING = [number for name in ("SIGINT", "SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))]


def _handle(handler: Callable[..., object]) -> None:
    for number in ENDING:
        # a shell starts background jobs with SIGINT ignored; `nohup` means what it says
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def terminate_as_interrupt() -> None:
    """Let SIGTERM, and a terminal that is closed, end a command the way Ctrl-C does: files whole, counts reported."""
    _handle(signal.default_int_handler)


def stop_requested() -> Callable[[], bool]:
    """A question that is answered True once one of them came; for loops that must not be torn out of a step."""
    came: list[int] = []
    _handle(lambda received, _: came.append(received))
    return lambda: bool(came)
