"""Real-time privileges for the process that calls. Before the Zenoh session opens: its threads inherit them."""

from __future__ import annotations

import ctypes
import gc
import os
import sys

from schemas.messages import HealthFlag

PRIORITY = 50  # SCHED_FIFO, above ordinary work and below the kernel's own threads

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29


def go_realtime(role: str, priority: int = PRIORITY) -> HealthFlag:
    """Take SCHED_FIFO, lock memory, 1 ns timer slack, no garbage collection; NO_REALTIME unless all of it was granted.

    Where the system refuses, one line on stderr says so and the process runs on with what it got. The collector is off
    for good: the loops of this project make no reference cycles.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "prctl"):  # Linux
        libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    gc.collect()
    gc.freeze()
    gc.disable()
    refused = []
    # Memory first: hundreds of MiB to fetch take 0.1 s, which others at this priority need not wait for.
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        refused.append(f"memory locking ({os.strerror(ctypes.get_errno())})")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # macOS knows neither function nor policy
        refused.append(f"SCHED_FIFO ({getattr(error, 'strerror', 'not on this system')})")
    if refused:
        print(
            f"{role}: no {' and no '.join(refused)}: timing is best effort; see 'Real time' in the documentation",
            file=sys.stderr,
        )
    return HealthFlag.NO_REALTIME if refused else HealthFlag(0)
