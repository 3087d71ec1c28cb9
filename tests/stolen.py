"""`python tests/stolen.py`: a line, CLOCK_MONOTONIC in s, whenever the hypervisor took a processor for `LEAST` s.

Which no real-time priority in this virtual machine can help. A process of its own: a thread beside a master under test
would be put aside by other work while it holds the interpreter, and the master would wait for it.
"""

from __future__ import annotations

import os
import time

LEAST = 0.03  # s within the `EVERY` between two looks: half of what the bus and its watchdogs stand
EVERY = 0.1  # s


def stolen() -> list[float]:
    """s that were taken from each processor so far."""
    with open("/proc/stat") as lines:
        processors = [line.split() for line in lines if line.startswith("cpu") and line[3] != " "]
    return [int(times[8]) / os.sysconf("SC_CLK_TCK") for times in processors]


if __name__ == "__main__":
    before, parent = stolen(), os.getppid()
    while os.getppid() == parent:
        time.sleep(EVERY)
        now = stolen()
        if max(new - old for old, new in zip(before, now, strict=True)) >= LEAST:
            print(time.monotonic(), flush=True)
        before = now
