"""Pacing to absolute deadlines: no error adds up, and a wake-up that comes late is caught up with, not passed on."""

from __future__ import annotations

import time

SPIN_NS = 100_000  # the last stretch before a deadline is spent awake: longer than a timer wakes late


def wait_until(deadline_ns: int) -> int:
    """Return at `deadline_ns` of CLOCK_MONOTONIC, or at once when it has passed; how late, ns.

    Sleeps (`clock_nanosleep`, which is what `time.sleep` is) until `SPIN_NS` before, then spins.
    """
    now = time.monotonic_ns()
    if deadline_ns - now > SPIN_NS:
        time.sleep((deadline_ns - now - SPIN_NS) * 1e-9)
        now = time.monotonic_ns()
    while now < deadline_ns:
        now = time.monotonic_ns()
    return now - deadline_ns
