"""Polars as `pl`, without the handler of Ctrl-C that it brings.

It restarts what a signal interrupts: a main thread that waits for another would not hear Ctrl-C before that is done.
"""

import signal
from contextlib import suppress

_handler = signal.getsignal(signal.SIGINT)

import polars as pl  # noqa: E402

__all__ = ["pl"]

if _handler is not None:
    with suppress(ValueError):  # not in the main thread, which alone may
        signal.signal(signal.SIGINT, _handler)
