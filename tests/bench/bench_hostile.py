"""Hostile messages on every topic of a running estimator, monitor, watch and robot, over Zenoh.

    python -m tests.bench.bench_hostile [--messages 1000000] [--rate 20000] [--seed 0]

Rounds of 20 000, each followed by good samples that have to be answered within 50 ms. At the end every role has to have
counted nearly all that it was sent, as its `health` tells; the watch, which runs on what the others leave, most of it.
14 000 messages a second on two busy cores: 10 million take twelve minutes and about 2 GB of disk. Exit code 1 where
anything was wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from docs.making.figures import store
from tests.service.attack import Attack

ROUND = 20_000
LEAST = {"estimator": 0.99, "monitor": 0.99, "robot": 0.99, "watch": 0.5}  # share of the messages it has to count


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--messages", type=int, default=1_000_000)
    arguments.add_argument("--rate", type=float, default=20_000.0, help="messages a second while it disturbs")
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--store", action="store_true", help="put the figures into results/bus.json")
    given = arguments.parse_args()
    sent = failures = 0
    with tempfile.TemporaryDirectory(prefix="dt-") as name, ExitStack() as stack:
        os.environ["XDG_RUNTIME_DIR"] = name
        attack = Attack(Path(name), stack)
        begin = time.monotonic()
        while sent < given.messages and not attack.dead():
            count = min(ROUND, given.messages - sent)
            wrong = attack.round(np.random.default_rng([given.seed, sent]), count, given.rate)
            sent += count
            failures += bool(wrong)
            for line in wrong:
                print(f"\nafter {sent} messages: {line}", flush=True)
            print(f"\r{sent} of {given.messages} messages, {failures} rounds with something wrong", end="", flush=True)
        seconds = time.monotonic() - begin
        wrong = attack.stop()
        arrived = attack.arrived()
    wrong += [
        f"{role} counted only {of.counted} of {of.sent}"
        for role, of in arrived.items()
        if of.counted < LEAST[role] * of.sent
    ]
    print("", *wrong, sep="\n")
    counted = ", ".join(f"{role} {of.counted} of {of.sent}" for role, of in arrived.items())
    print(
        f"{sent} messages in {seconds:.0f} s, {sent / seconds:.0f} a second, {failures} rounds with something wrong; "
        f"counted: {counted}"
    )
    if given.store:
        print(f"kept in {store('bus', {'hostile_bus': (failures + len(wrong), sent, None)})}")
    sys.exit(bool(failures or wrong))


if __name__ == "__main__":
    main()
