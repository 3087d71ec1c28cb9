"""The diagnosis on the second plant: another hand's robots, effects, disturbances and recorders, by families.

    python -m tests.bench.bench_diagnosis [--families single pair] [--cases 10] [--kept FILE] [--jobs 2] [--store]

none         nothing is wrong
single, pair, three: so many effects of the catalogue
disturbed    two effects together with a disturbance
outside      a disturbance alone, which no catalogue has
description  masses and lengths of the description are wrong, and of every other seed an effect is at work
production   one effect, and nothing but the work's motion
scope        one effect, recorded by a scope
gap_free     nothing is wrong, recorded by a scope or at work

Each case goes through `deltatwin identify` and `deltatwin diagnose`, and both descriptions through `deltatwin evaluate`
on logs that were kept out. Seeds are split once: below 10000 is `calibrate`, where anything may be chosen; from 10000
is `report`, on which nothing is ever chosen, and which alone is stored.

--kept: answers, a line of JSON each; those that stand there are not asked again, so that a run can be stopped and taken
up. An answer belongs to the code that gave it: after a change of the diagnosis take another file.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import butter, sosfiltfilt

from docs.making.figures import store
from schemas.errors import DeltatwinError, TraceError
from service.stopping import terminate_as_interrupt
from tests.bench import diagnosis_scores as scores
from tests.bench.diagnosis_scores import Answer, Measured
from tests.bench.second_plant.cases import BAND_HZ, FAMILIES, make

FIRST_REPORT = 10_000  # seed from which nothing is ever chosen
LONGEST_REST_S = 0.04  # a joint that stands longer is left out of the gap, with a margin
REST_RADPS, MARGIN_S, ENDS_S = 0.01, 0.015, 0.25
SPEED_HZ = 60.0  # below which the speed of a joint is looked at


def seeds_of(which: str, first: int, cases: int) -> range:
    """Seeds of `calibrate` or `report`, from the `first` of it.

    Raises:
        ValueError: that would go from the one into the other.
    """
    begin = first + (FIRST_REPORT if which == "report" else 0)
    if which == "calibrate" and begin + cases > FIRST_REPORT:
        raise ValueError(f"--first {first} --cases {cases}: seeds from {FIRST_REPORT} are of the set report")
    return range(begin, begin + cases)


def asked(family: str, seed: int) -> Answer:
    """One case made, diagnosed and measured; what fails is an answer that says so."""
    with tempfile.TemporaryDirectory(prefix="dt-") as folder:
        place = Path(folder)
        try:
            truth = make(family, seed, place)
        except ArithmeticError as error:
            return Answer(family, seed, {}, error=str(error))
        known = Answer(
            family, seed, {name: one["joints"] for name, one in truth["effects"].items()},
            list(truth["disturbances"]), list(truth["misdescribed"]), truth["lift"], floor=truth["noise_in_band_nm"],
        )  # fmt: skip
        row = scores.as_row(known)
        try:
            return scores.from_row(row | diagnosed(place))
        except DeltatwinError as error:
            return scores.from_row(row | {"error": str(error)})


def diagnosed(place: Path) -> dict[str, object]:
    """What the commands make of the case in a folder.

    Raises:
        DeltatwinError: one of them refuses it.
    """
    fit, test = (sorted(str(path) for path in place.glob(f"{kind}_*.csv")) for kind in ("fit", "test"))
    robot = ["--robot", str(place / "robot.toml")]
    begin, spent = time.monotonic(), time.process_time()
    command("identify", *fit, *robot, "--out", str(place / "base.toml"))
    said = json.loads(command("diagnose", *fit, *robot, "--out", str(place / "out"), "--json"))
    seconds, cpu = time.monotonic() - begin, time.process_time() - spent
    gaps = []
    for name, description in (("before", place / "base.toml"), ("after", place / "out" / "corrected.toml")):
        command("evaluate", *test, "--robot", str(description), "--predictions", str(place / name))
        gaps.append(gap(place, place / name))
    named = [{key: effect[key] for key in ("name", "joints", "probability")} for effect in said["effects"]]
    return {
        "named": named, "verdict": said["verdict"], "claimed": said["gap"]["shrink"], "before": gaps[0],
        "after": gaps[1], "seconds": seconds, "cpu_seconds": cpu,
    }  # fmt: skip


def command(*words: str) -> str:
    """Run a subcommand of `deltatwin` in this process; returns what it prints.

    Raises:
        DeltatwinError: what it refuses.
    """
    from service.cli.main import app

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        app(list(words), standalone_mode=False)
    return said.getvalue()


def gap(place: Path, predicted: Path) -> float:
    """Rms of measured less predicted torque, N m, on the logs kept out, moving joints pooled, below `BAND_HZ`."""
    square = count = 0.0
    for path in sorted(place.glob("test_*.csv")):
        log, model = table(path), table(predicted / path.name)
        period = float(np.median(np.diff(log["time_s"])))
        off = np.stack([log[f"torque_{j}_nm"] - model[f"torque_model_{j}_nm"] for j in (1, 2, 3)], axis=1)
        angle = np.stack([log[f"position_{j}_rad"] for j in (1, 2, 3)], axis=1)
        band = butter(4, BAND_HZ, fs=1 / period, output="sos")
        keep, ends = moving(angle, period), round(ENDS_S / period)
        counted = sosfiltfilt(band, off, axis=0)[ends:-ends][keep[ends:-ends]]
        square, count = square + float(np.sum(counted**2)), count + counted.size
    return float(np.sqrt(square / count))


def table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a CSV by name."""
    with path.open() as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def moving(angle: np.ndarray, period: float) -> np.ndarray:
    """(n, 3): False where a joint stands still for `LONGEST_REST_S` or longer, and shortly before and after."""
    low = butter(4, SPEED_HZ, fs=1 / period, output="sos")
    still = np.abs(np.gradient(sosfiltfilt(low, angle, axis=0), period, axis=0)) < REST_RADPS
    found, margin = np.ones(angle.shape, bool), round(MARGIN_S / period)
    for j in range(3):
        edges = np.flatnonzero(np.diff(np.r_[0, still[:, j].astype(int), 0]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if (end - begin) * period >= LONGEST_REST_S:
                found[max(0, begin - margin) : end + margin, j] = False
    return found


def kept_in(path: Path | None) -> dict[tuple[str, int], Answer]:
    """Answers that earlier runs have kept, by family and seed.

    Raises:
        TraceError: a line of the file is none.
    """
    found: dict[tuple[str, int], Answer] = {}
    if path is None or not path.exists():
        return found
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            answer = scores.from_row(json.loads(line))
        except (ValueError, TypeError, KeyError) as error:
            raise TraceError(f"{path}, line {number}: not an answer of this bench ({error}): {line[:60]}") from error
        found[answer.family, answer.seed] = answer
    return found


def keep(path: Path, answer: Answer) -> None:
    """Put an answer behind the others, in one write, so that the file is whole whenever this ends."""
    line = json.dumps(scores.as_row(answer)) + "\n"
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        os.write(handle, line.encode())
    finally:
        os.close(handle)


def told(answer: Answer) -> str:
    """A case in a line."""
    names = " + ".join(f"{name.name} {name.joints or ''} {name.probability:.2f}" for name in answer.named) or "nothing"
    truth = " + ".join([*answer.effects, *(f"({one})" for one in answer.disturbances)]) or "nothing"
    end = answer.error or (
        f"{names}; {answer.verdict}; gap {answer.before:.3f} to {answer.after:.3f} N m, floor {answer.floor:.3f}; "
        f"{answer.seconds:.0f} s"
    )
    return f"{answer.family} {answer.seed}: {truth}, lift {answer.lift:.2f}: {end}"


def by_family(answers: Sequence[Answer]) -> dict[str, dict[str, Measured]]:
    """The figures of each family that has cases."""
    grouped = {family: [answer for answer in answers if answer.family == family] for family in FAMILIES}
    return {family: scores.family_figures(some) for family, some in grouped.items() if some}


def overall(answers: Sequence[Answer]) -> dict[str, Measured]:
    """The figures over all families."""
    named = scores.reliability(answers)
    found = {f"decile_{decile}": one for decile, one in sorted(named.items())}
    for key, measured in (
        ("certain", scores.certain_true(answers)),
        ("claim_median", scores.quantile_of(answers, scores.claim_error, 0.5)),
        ("claim_most", scores.quantile_of(answers, scores.claim_error, 0.9)),
        ("seconds", scores.quantile_of(answers, lambda answer: answer.seconds, 0.5)),
        ("cpu_seconds", scores.quantile_of(answers, lambda answer: answer.cpu_seconds, 0.5)),
        ("failed", scores.share_of([bool(answer.error) for answer in answers])),
    ):
        if measured is not None:
            found[key] = measured
    return found


def shown(answers: Sequence[Answer]) -> str:
    """The figures as a table of Markdown, and a line for each that is of all families."""
    columns = ("first", "f1", "joints", "quiet", "verdict", "false")
    lines = ["| family | cases | " + " | ".join(columns) + " |", "|---" * (len(columns) + 2) + "|"]
    for family, found in by_family(answers).items():
        cells = [
            f"{found[key].value:.2f} ({found[key].low:.2f} to {found[key].high:.2f}) of {found[key].count}"
            if key in found else ""
            for key in columns
        ]  # fmt: skip
        count = sum(answer.family == family for answer in answers)
        lines.append(f"| {family} | {count} | " + " | ".join(cells) + " |")
    lines += [f"{key}: {one.value:.3f} of {one.count} ({one.interval})" for key, one in overall(answers).items()]
    return "\n".join(lines)


def figures(answers: Sequence[Answer]) -> dict[str, tuple[float | int | str, int | str | None, str | None]]:
    """What was measured, by the keys of results/diagnosis.json."""
    every = {f"{family}_{key}": one for family, found in by_family(answers).items() for key, one in found.items()}
    every |= overall(answers)
    return {key: (round(one.value, 3), one.count, one.interval) for key, one in every.items()}


def run(wanted: Sequence[tuple[str, int]], kept: Path | None, jobs: int) -> list[Answer]:
    """The answers to all `wanted`, those that are kept first, and each that is new kept at once."""
    known = kept_in(kept)
    missing = [case for case in wanted if case not in known]
    found = [known[case] for case in wanted if case in known]
    every: Any = Parallel(jobs, return_as="generator_unordered")(delayed(asked)(*case) for case in missing)
    answers: Iterator[Answer] = every
    for answer in answers:
        if kept is not None:
            keep(kept, answer)
        found.append(answer)
        print(f"{len(found)} of {len(wanted)}: {told(answer)}", flush=True)
    return found


def interrupted(error: BaseException | None) -> bool:
    """Whether it is Ctrl-C or SIGTERM, or what Numba makes of one that comes while it loads a kernel."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def main() -> None:
    """Ask, print the table, and store it."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES), metavar="NAME")
    arguments.add_argument("--cases", type=int, default=10, help="of each family")
    arguments.add_argument("--first", type=int, default=0, help="of the set's seeds, counted from 0")
    arguments.add_argument("--set", choices=("calibrate", "report"), default="report", dest="which")
    arguments.add_argument("--kept", type=Path, help="file of answers, to go on with")
    arguments.add_argument("--kept-only", action="store_true", help="ask nothing new: the figures of what --kept holds")
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--store", action="store_true", help="put the figures into results/diagnosis.json")
    given = arguments.parse_args()
    terminate_as_interrupt()
    if given.store and given.which != "report":
        arguments.error("--store: figures of the set report alone are stored")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes that are started, as the program does
    try:
        seeds = seeds_of(given.which, given.first, given.cases)
        wanted = [(family, seed) for seed in seeds for family in given.families]
        if given.kept_only:
            wanted = [case for case in wanted if case in kept_in(given.kept)]
        answers = run(wanted, given.kept, given.jobs)
    except (ValueError, DeltatwinError) as error:
        sys.exit(str(error))
    except (KeyboardInterrupt, SystemError) as error:
        if not interrupted(error):
            raise
        print("stopped" + ("" if given.kept is None else f"; what was answered is in {given.kept}"), file=sys.stderr)
        sys.exit(130)
    print(shown(answers))
    if given.store:
        print(f"stored in {store('diagnosis', figures(answers))}")


if __name__ == "__main__":
    main()
