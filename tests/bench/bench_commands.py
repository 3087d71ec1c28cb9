"""Commands that measure the program themselves, run as a user runs them; what they say is stored.

uv run python -m tests.bench.bench_commands latency --store
uv run python -m tests.bench.bench_commands closed-loop --store
uv run python -m tests.bench.bench_commands blindtest --cases 120 --seed 31338 --store
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from docs.making.figures import store
from service.diagnosis.sealed_page import BOUNDS

COMMAND = Path(sys.executable).with_name("deltatwin")
MISSED = 3  # exit code where a bound does not hold: the figures are there
TRIPS = 40_000
Figures = dict[str, tuple[float | int | str, int | str | None, str | None]]


def said(*arguments: str) -> dict[str, Any]:
    """What a command says with --json."""
    done = subprocess.run([COMMAND, *arguments, "--json"], stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode not in (0, MISSED):
        sys.exit(f"{' '.join(arguments)}: exit code {done.returncode}")
    return json.loads(done.stdout)


def latency() -> Figures:
    """The estimator's round trip over that of a bare echo."""
    told: Figures = {}
    for key, rate in (("round_trip_4k", 4000), ("round_trip_8k", 8000)):
        found = said("latency", "--rate", str(rate), "--count", str(TRIPS))
        trips = found["round_trip_us"]
        ratio = {name: trips["estimator"][name] / trips["echo"][name] for name in ("median", "p99", "p99.9")}
        note = f"p99 {ratio['p99']:.2f}, p99.9 {ratio['p99.9']:.2f}; {found['lost']['estimator']} lost"
        told[key] = round(ratio["median"], 2), TRIPS, note
    return told


def closed_loop() -> Figures:
    """The tracking error with feedback alone over that with the feed-forward that knows the payload."""
    with tempfile.TemporaryDirectory() as folder:
        found = said("closed-loop", "--payload", "3.8", "--out", folder)
    if not found["counts"]:
        sys.exit("closed-loop: too many cycles were late")
    runs = {run["name"]: run["rms_rad"] for run in found["runs"]}
    return {"tracking": (round(runs["feedback alone"] / runs["full, payload-aware"]), 1, None)}


def blindtest(cases: int, seed: int) -> Figures:
    """The figures of cases that are sealed until all are answered."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["--cases", str(cases), "--seed", str(seed), "--out", f"{folder}/blind"]
        found = said("blindtest", *arguments)
    summary = found["summary"]
    return {key: (summary[key], summary["counts"][key], f"seed {seed}") for key in BOUNDS if summary[key] is not None}


def main() -> None:
    """Print what one of them says, and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("latency", "closed-loop", "blindtest"))
    parser.add_argument("--cases", type=int, default=120, help="of the blind test")
    parser.add_argument("--seed", type=int, default=1, help="of the blind test")
    parser.add_argument(
        "--store", action="store_true", help="put the figures into bus, control or blindtest of results/"
    )
    given = parser.parse_args()
    if given.command == "latency":
        told = latency()
        path = store("bus", told) if given.store else None
    elif given.command == "closed-loop":
        told = closed_loop()
        path = store("control", told) if given.store else None
    else:
        told = blindtest(given.cases, given.seed)
        path = store("blindtest", told) if given.store else None
    for key, (value, count, note) in told.items():
        print(f"{key}: {value} ({count}; {note})")
    if path is not None:
        print(f"kept in {path}")


if __name__ == "__main__":
    main()
