"""Pacing to absolute deadlines: no error adds up, and a wake-up that comes late is caught up with, not passed on.

After a hold-up (the process was stopped, the host stood still) the loop catches up, but at `CATCH_UP` times its rate at
most: thousands of samples at once would cost everybody who listens what he has not taken yet.
"""

from __future__ import annotations

import time

CATCH_UP = 2
SPIN_NS = 100_000  # the last stretch before a deadline is spent awake: longer than a timer wakes late
SPIN_SHARE = 0.15  # of the time between two deadlines at most: at 8 kHz the processor is needed for the work


def wait_until(deadline_ns: int, spin_ns: int = SPIN_NS) -> int:
    """Return at `deadline_ns` of CLOCK_MONOTONIC, or at once when it has passed; how late, ns.

    Sleeps (`clock_nanosleep`, which is what `time.sleep` is) until `spin_ns` before, then spins.
    """
    now = time.monotonic_ns()
    if deadline_ns - now > spin_ns:
        time.sleep((deadline_ns - now - spin_ns) * 1e-9)
        now = time.monotonic_ns()
    while now < deadline_ns:
        now = time.monotonic_ns()
    return now - deadline_ns


class Pacer:
    """`wait_until` for rising deadlines, with a bound on how fast late ones follow each other."""

    def __init__(self) -> None:
        self._deadline_ns = self._at_ns = 0

    def __call__(self, deadline_ns: int) -> int:
        """Return at `deadline_ns` or, when it has passed, as soon as may be; how late, ns."""
        gap = deadline_ns - self._deadline_ns
        soonest = self._at_ns + gap // CATCH_UP if self._at_ns else 0
        self._at_ns = max(soonest, deadline_ns)
        self._at_ns += wait_until(self._at_ns, min(SPIN_NS, int(gap * SPIN_SHARE)))
        self._deadline_ns = deadline_ns
        return self._at_ns - deadline_ns
