"""Foreign files of known machines, imported, identified, and held against the truth.

    python -m tests.bench.bench_field [--cases 200] [--start 0] [--only NUMBER] [--kept FILE] [--store]

A case is drawn from its number: machine, format, unit, order, names, time base, fault (tests/bench/field_files.py).
Where a line asks for what a user knows (a torque constant, increments a turn, which column), the user answers it and
imports anew. A case is then

right    what import gives is what the machine did, and identify finds its parameters (of the machine of two axes);
asked    the same, after answers to what the lines asked for;
refused  the file holds no torque of a machine, and a line says so;
said     it could have been read, and is refused, or what came out wrong is marked as uncertain;
silent   it is read wrong, and nothing says so. Its number is printed, and the exit code is 1;
crash    a traceback, or an error of several lines.

--kept: outcomes by number, a line each; those that stand there are not tried again, so that a run can be stopped and
taken up, or be several with ranges of their own.
"""

from __future__ import annotations

import argparse
import json
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
from drivers.trace.tables import Table, read_table
from schemas.columns import Columns
from schemas.errors import DeltatwinError, TraceError
from schemas.robot import Robot
from schemas.toml import validate
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.identification.proposal import Proposal, propose
from service.identification.readings import Stated
from tests.bench.field_files import (
    BAGS,
    NO_TORQUE,
    TRUTH,
    Case,
    Written,
    answer_of,
    draw,
    names_of,
    stated_of,
    subject,
    write,
)

CLOSE = 0.05  # of a parameter, beside three of its standard errors
ABOUT = {"position": ("position", "increments"), "torque": ("torque", "force", "sign"), "time": ("stamps",)}
OUTCOMES = "right", "asked", "refused", "said", "silent", "crash"
TEXT_FORMS = "csv", "semicolon", "comma_decimal", "tab", "space", "gz"
MOST_ASKED = 4  # times that a user answers
ORDER = "joints are assigned by their order"


def judge(case: Case, folder: Path) -> tuple[str, str]:
    """The outcome of a case, and what there is to say."""
    made, given = write(case, folder), stated_of(case)
    outcome, why, table, lines = tried(case, made, given)
    asked = 0
    while outcome == "said" and table is not None and asked < MOST_ASKED:
        new = {key: value for key, value in answers_to(case, table, lines).items() if key not in given}
        if not new:
            break
        asked, given = asked + 1, given | new
        outcome, why, table, lines = tried(case, made, given)
    if case.fault in NO_TORQUE:
        return (
            ("silent", f"there is no torque in it; {why}")
            if outcome == "right"
            else ("refused" if outcome == "said" else outcome, why)
        )
    return ("asked" if asked and outcome == "right" else outcome), why


def tried(case: Case, made: Written, given: dict[str, Any]) -> tuple[str, str, Table | None, str]:
    """One import: the outcome, why, the table if it can be read, and all that was said."""
    robot, table = subject(case.machine).robot, None
    try:
        table = read_table(made.path)
        proposal = propose(table, robot, Stated(**given))
        columns = validate(Columns, dict(proposal.columns), made.path, TraceError)
        trace = read_trace(made.path, robot, columns)
    except DeltatwinError as error:
        several = "\n" in str(error)
        return "crash" if several else "said", str(error), table, str(error)
    except Exception:
        return "crash", traceback.format_exc(), None, ""
    lines = "; ".join([*proposal.doubts, *(finding.message for finding in trace.findings)])
    wrong = compared(case, made, trace)
    silent = [what for what in wrong if not doubted(what, proposal, trace)]
    if silent:
        return "silent", f"{', '.join(silent)} wrong; {_told(proposal)}", table, lines
    if wrong:
        said = [line for line in proposal.reasons if ORDER in line]
        return "said", lines, table, "; ".join([lines, *(said if "order" in wrong else [])])
    outcome, why = identified(trace) if case.machine == "axes" else ("right", "")
    return outcome, why, table, lines


def answers_to(case: Case, table: Table, lines: str) -> dict[str, Any]:
    """What a user who knows the machine says to the lines that ask."""
    found = {}
    if (
        "increments" in lines
        or "--position-unit" in lines
        or "positions are assumed to be" in lines
        or "this is ambiguous" in lines
    ):
        option = "counts_per_rev" if case.position == "counts" else "position_unit"
        found[option] = answer_of(case, option)
    if "--torque-unit" in lines or "assumed to be" in lines:
        found["torque_unit"] = answer_of(case, "torque_unit")
    if "--sign" in lines:
        found["sign"] = answer_of(case, "sign")
    if "--rate" in lines:
        found["rate_hz"] = answer_of(case, "rate_hz")
    if (ORDER in lines or "it is unclear which" in lines) and case.names != "none":
        for role, spelled in zip(("position", "torque"), zip(*names_of(case), strict=True), strict=True):
            columns = [next((c for c in table.columns if _plain(name) in _plain(c)), "") for name in spelled]
            if all(columns):
                found[role] = columns
    return found


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _told(proposal: Proposal) -> str:
    columns = {role: proposal.columns.get(role) for role in ("time", "position", "torque")}
    return f"{columns}; check: {list(proposal.doubts)}"


def compared(case: Case, made: Written, trace: Trace) -> list[str]:
    """What of a trace is not the machine's: position, torque, time, order, rows."""
    known = subject(case.machine)
    position, torque, close_torque = known.position, known.torque, 1e-3
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


def identified(trace: Trace) -> tuple[str, str]:
    """Whether identify finds what the machine of two axes has."""
    robot = subject("axes").robot
    assert not isinstance(robot, Robot)
    try:
        found = identify_axes(robot, [trace])
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
    arguments.add_argument("--kept", type=Path, help="file of outcomes, to go on with")
    arguments.add_argument("--said", action="store_true", help="print what is said, too")
    arguments.add_argument("--store", action="store_true", help="put the figures into results/field.json")
    given = arguments.parse_args()
    numbers = [given.only] if given.only is not None else range(given.start, given.start + given.cases)
    outcomes, begin = kept_in(given.kept), time.monotonic()
    for number in numbers:
        if number in outcomes and given.only is None:
            continue
        case = draw(number)
        with tempfile.TemporaryDirectory(prefix="dt-") as folder:
            outcomes[number], why = judge(case, Path(folder))
        if given.kept is not None:
            with given.kept.open("a") as file:
                file.write(json.dumps([number, outcomes[number]]) + "\n")
        if outcomes[number] in ("silent", "crash") or given.only is not None:
            print(f"\n{number}: {outcomes[number]}: {case}\n    {why}", flush=True)
        elif given.said and outcomes[number] == "said":
            print(f"{number}: {case}\n    {why}", flush=True)
        elif sys.stdout.isatty():
            print(f"\r{number - numbers[0] + 1} of {len(numbers)}", end="", flush=True)
    counts = Counter(outcomes[number] for number in numbers)
    print(f"\n{len(numbers)} files in {time.monotonic() - begin:.0f} s: {dict(counts)}")
    for what in ("machine", "form", "fault"):
        print(shown(what, {number: outcomes[number] for number in numbers}))
    if given.store:
        print(store("field", figures({number: outcomes[number] for number in numbers})))
    sys.exit(bool(counts["silent"] + counts["crash"]))


def kept_in(path: Path | None) -> dict[int, str]:
    """Outcomes by number that earlier runs have kept."""
    if path is None or not path.exists():
        return {}
    return {int(number): str(outcome) for number, outcome in map(json.loads, path.read_text().splitlines())}


def shown(what: str, outcomes: dict[int, str]) -> str:
    """Outcomes by a dimension, as a table of Markdown."""
    cells = Counter((getattr(draw(number), what), outcome) for number, outcome in outcomes.items())
    rows = [f"| {what} | " + " | ".join(OUTCOMES) + " |", "|---" * (1 + len(OUTCOMES)) + "|"]
    for value in sorted({value for value, _ in cells}):
        rows.append(f"| {value} | " + " | ".join(str(cells[value, outcome]) for outcome in OUTCOMES) + " |")
    return "\n".join(["", *rows])


def figures(outcomes: dict[int, str]) -> dict[str, tuple[float | int | str, int | str | None, str | None]]:
    """What was measured, by the keys of results/field.json: of files that hold a torque, and of all."""
    counts, total = Counter(outcomes.values()), len(outcomes)
    read = counts["right"] + counts["asked"]
    at_once = f"{counts['right']} at once, {counts['asked']} after an answer to what a line asks for"
    found: dict[str, tuple[float | int | str, int | str | None, str | None]] = {
        "silent": (counts["silent"], total, None),
        "crash": (counts["crash"], total, None),
        "right": (share(read, total - counts["refused"]), total - counts["refused"], at_once),
        "refused": (
            counts["refused"],
            total,
            f"with those read right {share(read + counts['refused'], total)} % of all",
        ),
        "said": (counts["said"], total, "refused, or marked as uncertain where it came out wrong"),
    }
    for key, what, values in (
        ("axes", "machine", ("axes",)), ("delta", "machine", ("delta",)), ("arm", "machine", ("arm",)),
        ("tables", "form", TEXT_FORMS), ("bags", "form", BAGS),
    ):  # fmt: skip
        some = Counter(outcome for number, outcome in outcomes.items() if getattr(draw(number), what) in values)
        holds = some.total() - some["refused"]
        found[key] = (share(some["right"] + some["asked"], holds), holds, f"{some['right']} at once")
    return found


def share(part: int, whole: int) -> float:
    """In percent."""
    return round(100 * part / max(whole, 1), 1)


if __name__ == "__main__":
    main()
