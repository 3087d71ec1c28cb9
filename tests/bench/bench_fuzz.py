"""Mutated files of every format against their readers.

    uv run python -m tests.bench.bench_fuzz --mutations 1000000 [--start 0] [--processes 2] [--keep FOLDER]

A mutation is made from its number: a run goes on with --start. Findings are printed as they come, one of a kind, with
the number that makes them again; with --keep the file is kept too. One that ends the process ends the run.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

BATCH = 500  # mutations a task
_WARM: list[bool] = []  # in this process


def batch(kind: str, first: int, last: int, keep: Path | None, marks: Path) -> tuple[int, list[tuple[str, int, str]]]:
    """Mutations first to last of a format: how many, and the findings as (format, number, what). marks: a folder, in
    which a file of this process tells the one at work."""
    from tests.drivers.fuzz import finding, mutated, warm_up

    found, mark = [], marks / str(os.getpid())
    with tempfile.TemporaryDirectory(prefix="dt-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        if not _WARM:
            warm_up(Path(folder))
            _WARM.append(True)
        for number in range(first, last):
            mark.write_text(f"{kind} {number}")
            data = mutated(kind, number)
            what = finding(kind, data, Path(folder))
            if what:
                found.append((kind, number, what))
                if keep:
                    (keep / f"{kind}-{number}").write_bytes(data)
    mark.unlink()
    return last - first, found


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--mutations", type=int, default=1_000_000)
    arguments.add_argument("--start", type=int, default=0, help="number of the first mutation of each format")
    arguments.add_argument("--processes", type=int, default=2)
    arguments.add_argument("--keep", type=Path, help="folder for the files that made a finding")
    arguments.add_argument("--kinds", nargs="+", help="formats; default: all")
    given = arguments.parse_args()
    os.environ["POLARS_MAX_THREADS"] = "1"
    from tests.drivers.fuzz import ENDINGS

    kinds = given.kinds or list(ENDINGS)
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    each = -(-given.mutations // len(kinds))
    tasks = [
        (kind, first, min(first + BATCH, given.start + each), given.keep)
        for first in range(given.start, given.start + each, BATCH)
        for kind in kinds
    ]
    begin, done, seen = time.monotonic(), 0, Counter[str]()
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as marks, ProcessPoolExecutor(given.processes, spawn) as pool:
        for future in as_completed([pool.submit(batch, *task, Path(marks)) for task in tasks]):
            try:
                count, found = future.result()
            except BrokenProcessPool:
                sys.exit(f"\na process ended at {' or '.join(mark.read_text() for mark in Path(marks).iterdir())}")
            done += count
            for kind, number, what in found:
                seen[what.split(": ")[0]] += 1
                if seen[what.split(": ")[0]] == 1:
                    print(f"{kind} {number}: {what}", flush=True)
            rate = done / (time.monotonic() - begin)
            print(f"\r{done} of {each * len(kinds)}, {rate:.0f} a second", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(f"{done} mutations in {time.monotonic() - begin:.0f} s, {done / (time.monotonic() - begin):.0f} a second, "
          f"formats {', '.join(kinds)} from {given.start}")  # fmt: skip
    for what, count in seen.most_common():
        print(f"{count:>8}  {what}")
    sys.exit(1 if seen else 0)


if __name__ == "__main__":
    main()
