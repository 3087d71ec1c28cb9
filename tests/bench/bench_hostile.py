"""Hostile messages on every topic of a running estimator, monitor and robot, over Zenoh.

    python -m tests.bench.bench_hostile [--messages 1000000] [--seed 0]

Rounds of 10 000, each followed by good samples that have to be answered within 50 ms. About 3 000 messages a second.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from tests.service.attack import Attack

ROUND = 10_000


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--messages", type=int, default=1_000_000)
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    sent = failures = 0
    with tempfile.TemporaryDirectory(prefix="dt-") as name, ExitStack() as stack:
        os.environ["XDG_RUNTIME_DIR"] = name
        attack = Attack(Path(name), stack)
        while sent < given.messages and not attack.dead():
            count = min(ROUND, given.messages - sent)
            wrong = attack.round(np.random.default_rng([given.seed, sent]), count)
            sent += count
            failures += bool(wrong)
            for line in wrong:
                print(f"\nafter {sent} messages: {line}", flush=True)
            print(f"\r{sent} of {given.messages} messages, {failures} rounds with something wrong", end="", flush=True)
        wrong = attack.stop()
    print("", *wrong, sep="\n")
    sys.exit(bool(failures or wrong))


if __name__ == "__main__":
    main()
