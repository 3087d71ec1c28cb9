"""Polars as `pl`, without the handler of Ctrl-C that it brings.

It restarts what a signal interrupts: a main thread that waits for another would not hear Ctrl-C before that is done.
One that comes while Polars is loaded waits until our handler is back.
"""

import signal
from contextlib import suppress

_handler = signal.getsignal(signal.SIGINT)
_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None

import polars as pl  # noqa: E402

__all__ = ["pl"]

if _handler is not None:
    with suppress(ValueError):  # not in the main thread, which alone may
        signal.signal(signal.SIGINT, _handler)
if _mask is not None:
    signal.pthread_sigmask(signal.SIG_SETMASK, _mask)
