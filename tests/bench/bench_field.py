"""Foreign files of one known machine, imported and identified, held against the truth.

    python -m tests.bench.bench_field [--cases 200] [--start 0] [--only NUMBER] [--out results/field.json]

A case is drawn from its number: format, unit, order, names, time base, fault (tests/bench/field_files.py). It is right
where import and identify give what the machine has; said where they refuse, or doubt what came out wrong, in a line;
silently wrong otherwise, which is printed with its number. Exit code 1 where one is.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from docs.making.figures import store
from drivers.trace import read_trace
from drivers.trace.tables import read_table
from schemas.columns import Columns
from schemas.errors import DeltatwinError, TraceError
from schemas.toml import validate
from schemas.trace import Trace
from service.identification.axes import identify_axes
from service.identification.proposal import Proposal, propose
from service.identification.readings import Stated
from tests.bench.field_files import ROBOT, TRUTH, Case, Written, draw, stated_of, tells_enough, truth, write

CLOSE = 0.05  # of a parameter, beside three of its standard errors
ABOUT = {"position": ("position", "increments"), "torque": ("torque", "force", "sign"), "time": ("stamps",)}
OUTCOMES = "right", "said", "silent", "crash"
ORDER = "joints by their place"


def judge(case: Case, folder: Path) -> tuple[str, str]:
    """right, said, silent or crash; and what there is to say."""
    made = write(case, folder)
    try:
        table = read_table(made.path)
        proposal = propose(table, ROBOT, Stated(**stated_of(case)))
        columns = validate(Columns, dict(proposal.columns), made.path, TraceError)
        trace = read_trace(made.path, ROBOT, columns)
    except DeltatwinError as error:
        return ("crash", f"of several lines: {error}") if "\n" in str(error) else ("said", str(error))
    except Exception:
        return "crash", traceback.format_exc()
    wrong = compared(case, made, trace)
    silent = [what for what in wrong if not doubted(what, proposal, trace)]
    if made.refuse and case.fault == "no_torque":
        return "silent", "no torque is in the file"
    if silent:
        return "silent", f"{', '.join(silent)} wrong; {_told(proposal)}"
    if wrong:
        return "said", "; ".join(proposal.doubts)
    if case.fault == "still_torque":
        return "silent", "the torque stands still"
    return identified(case, trace)


def _told(proposal: Proposal) -> str:
    columns = {role: proposal.columns.get(role) for role in ("time", "position", "torque")}
    return f"{columns}; check: {list(proposal.doubts)}"


def compared(case: Case, made: Written, trace: Trace) -> list[str]:
    """What of a trace is not the machine's: position, torque, time, order, rows."""
    _, position, _, torque = truth()
    close_torque = 1e-3
    if case.fault == "two_topics":  # a millisecond later, brought to the positions' stamps by straight lines
        close_torque, torque = 2.0, torque - 0.25 * np.gradient(torque, axis=0)
    count = len(trace)
    if not len(made.rows) - 1 <= count <= len(made.rows):
        return ["rows"]
    rows, lacks = made.rows[:count], made.lacks[:count]
    found = []
    for what, expected, values, close in (
        ("position", position, trace.position, 1e-4), ("torque", torque, trace.torque, close_torque),
    ):  # fmt: skip
        wanted = np.where(lacks, np.nan, expected[rows])
        if case.fault == "two_topics":  # before its first row a topic has no value
            wanted, values = wanted[1:], values[1:]
        if np.allclose(values, wanted, atol=close, equal_nan=True):
            continue
        turned = np.allclose(values[:, ::-1], wanted, atol=close, equal_nan=True)
        found.append("order" if turned else what)
    if not np.allclose(np.diff(trace.time), np.diff(made.time[:count]), atol=2e-5):
        found.append("time")
    return found


def doubted(what: str, proposal: Proposal, trace: Trace) -> bool:
    """Whether what came out wrong was said to be uncertain."""
    lines = [*proposal.doubts, *(finding.message for finding in trace.findings)]
    if what == "order":
        return any(ORDER in line for line in (*lines, *proposal.reasons))
    if what == "rows":
        return any("left out" in line for line in lines)
    return any(word in line for line in lines for word in ABOUT[what])


def identified(case: Case, trace: Trace) -> tuple[str, str]:
    """Whether identify finds what the machine has."""
    try:
        found = identify_axes(ROBOT, [trace])
    except DeltatwinError as error:
        return "said", str(error)
    except Exception:
        return "crash", traceback.format_exc()
    assert found.robot.identified is not None
    wrong = []
    for name, wanted in TRUTH.items():
        one: Any = getattr(found.robot.identified, name)
        for joint in range(2):
            value, error = one.value[joint], one.std_error[joint] if one.std_error else 0.0
            verdict = one.verdict[joint] if one.verdict else "identifiable"
            if abs(value - wanted[joint]) > CLOSE * max(wanted) + 3 * error and verdict == "identifiable":
                wrong.append(f"{name} {joint + 1}: {value:.3g} for {wanted[joint]:.3g}")
    if not wrong:
        return "right", ""
    told = [line for line in found.warnings if "cannot be held out" not in line]
    return ("said", "; ".join(told)) if told else ("silent", "; ".join(wrong))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--cases", type=int, default=200)
    arguments.add_argument("--start", type=int, default=0, help="number of the first")
    arguments.add_argument("--only", type=int, help="one case, and all that is said of it")
    arguments.add_argument("--said", action="store_true", help="print what is said, too")
    arguments.add_argument("--store", action="store_true", help="put the figures into results/field.json")
    given = arguments.parse_args()
    numbers = [given.only] if given.only is not None else range(given.start, given.start + given.cases)
    counts, by_form, begin = Counter[str](), Counter[tuple[str, str]](), time.monotonic()
    for number in numbers:
        case = draw(number)
        with tempfile.TemporaryDirectory(prefix="dt-") as folder:
            outcome, why = judge(case, Path(folder))
        counts[outcome] += 1
        counts["enough"] += tells_enough(case)
        counts["right of enough"] += tells_enough(case) and outcome == "right"
        by_form[case.form, outcome] += 1
        if outcome in ("silent", "crash") or given.only is not None:
            print(f"\n{number}: {outcome}: {case}\n    {why}", flush=True)
        elif given.said and outcome == "said":
            print(f"{number}: {case}\n    {why}", flush=True)
        elif sys.stdout.isatty():
            print(f"\r{number} of {len(numbers)}: {dict(counts)}", end="", flush=True)
    total = sum(counts[outcome] for outcome in OUTCOMES)
    print(f"\n{total} files in {time.monotonic() - begin:.0f} s: {dict(counts)}")
    for form in sorted({form for form, _ in by_form}):
        print(f"  {form:14}" + "".join(f"  {one} {by_form[form, one]}" for one in OUTCOMES))
    if given.store:
        print(store("field", figures(counts)))
    sys.exit(bool(counts["silent"] + counts["crash"]))


def figures(counts: Counter[str]) -> dict[str, tuple[float | int | str, int | str | None, str | None]]:
    """What was measured, by the keys of results/field.json."""
    total = sum(counts[outcome] for outcome in OUTCOMES)
    enough = round(100 * counts["right of enough"] / max(counts["enough"], 1), 1)
    return {
        "silent": (counts["silent"], total, None),
        "crash": (counts["crash"], total, None),
        "right": (enough, counts["enough"], f"of all files {100 * counts['right'] / total:.0f} %"),
        "said": (counts["said"], total, "refused, or doubted where it came out wrong"),
    }


if __name__ == "__main__":
    main()
