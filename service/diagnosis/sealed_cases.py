"""The diagnosis checked on cases whose answers are sealed until it has spoken.

The maker runs in a process of its own, on `drivers.simulated.plant`, which shares no effect code with the diagnosis. It
leaves the logs of each case in a folder and the answers, with a random nonce, in one key file beside them; the SHA-256
of that file is written down before the first log is read, the answers of the diagnosis before the key is opened.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from schemas.errors import DataError
from schemas.files import make_folder, write_text
from schemas.robot import load_robot

FINDABLE = 1.1  # lift from which an effect counts as findable
SURE = 0.9  # probability from which names are counted for calibration
MAKER = """
try:
    from service.diagnosis.sealed_cases import maker
    maker()
except KeyboardInterrupt:  # a terminal's Ctrl-C reaches both processes: who asked says so
    raise SystemExit(130)
"""


def make(out: Path, cases: int, seed: int, jobs: int, families: Sequence[str]) -> None:
    """The maker: simulate every case into `out`/cases and write `out`/sealed_key.json."""
    from drivers.simulated.plant.cases import simulate_case
    from drivers.simulated.plant.families import Draw, plan

    def one(number: int, draw: Draw) -> dict[str, Any]:
        name, refused = f"case_{number:03d}", []
        for attempt in range(3):  # drives that cannot hold a robot make no case
            try:
                key = simulate_case(out / "cases" / name, 1000 * seed + number + 500_000 * attempt, draw)
                return key | {"refused": refused + key["refused"]}
            except DataError as error:
                refused.append(str(error))
        return {"case": name, "effects": list(draw.effects), "refused": refused}

    work = [joblib.delayed(one)(i, draw) for i, draw in enumerate(plan(cases, seed, families))]
    keys: list[dict[str, Any]] = []
    for key in joblib.Parallel(n_jobs=jobs, return_as="generator")(work):
        assert key is not None
        keys.append(key)
        print("made", flush=True)
    text = json.dumps({"nonce": secrets.token_hex(16), "cases": keys}, default=_plain)
    write_text(out / "sealed_key.json", text)


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def made(out: Path, cases: int, seed: int, jobs: int, families: Sequence[str]) -> Iterator[None]:
    """Run the maker in its own process, yielding once a case.

    Raises:
        DataError: it failed.
    """
    import mujoco  # noqa: F401  # what the maker will need

    command = [sys.executable, "-c", MAKER]
    arguments = [str(out), str(cases), str(seed), str(jobs), ",".join(families)]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("made"):
                yield
    if process.returncode:
        raise DataError(f"the simulation of the cases failed (exit code {process.returncode})")


def maker() -> None:
    """Entry of the maker's process: out, cases, seed, jobs, families."""
    out, cases, seed, jobs, families = sys.argv[1:6]
    make(Path(out), int(cases), int(seed), int(jobs), families.split(","))


def seal(out: Path) -> str:
    """SHA-256 of the key file, also written to `out`/commitment.txt."""
    digest = hashlib.sha256((out / "sealed_key.json").read_bytes()).hexdigest()
    write_text(out / "commitment.txt", f"sha256 {digest}  sealed_key.json\n")
    return digest


def unseal(out: Path) -> list[dict[str, Any]]:
    """The answers.

    Raises:
        DataError: the key is not the one that was committed to.
    """
    content = (out / "sealed_key.json").read_bytes()
    if hashlib.sha256(content).hexdigest() not in (out / "commitment.txt").read_text(encoding="utf-8"):
        raise DataError(f"{out / 'sealed_key.json'}: changed after its hash was written")
    return json.loads(content)["cases"]


def refused(keys: list[dict[str, Any]]) -> list[str]:
    """A line for each case that was drawn in vain, as the drives did not hold the robot: what that happens to is rarer
    in the figures than it should be. keys: of the key file; one without a kind was given up.
    """
    lines = []
    for key in keys:
        if key["refused"]:
            what = f"{key['case']} ({', '.join(key['effects']) or 'no effect'})"
            end = "then another draw was used" if "kind" in key else "then the case was given up"
            lines.append(f"{what}: {len(key['refused'])} draws were refused, {end}; {key['refused'][-1]}")
    return lines


def answer(folder: Path) -> dict[str, Any]:
    """Diagnose one case from its description and fit logs; then measure the gap on its test logs.

    Returns verdict, effects (name, joints), claimed and measured shrink, gaps in N m, seconds.
    """
    from drivers.trace import read_trace
    from service.diagnosis.documents.document import corrected, document
    from service.diagnosis.pipeline import diagnose
    from service.identification.from_traces import identify
    from service.identification.regression import summarise
    from service.model.effects import CATALOGUE
    from service.model.nominal import pack

    robot = load_robot(folder / "robot.toml")
    start, spent = time.monotonic(), time.process_time()
    traces = [read_trace(path, robot) for path in sorted(folder.glob("fit_*.csv"))]
    findings = diagnose(robot, traces, CATALOGUE)
    result = document(findings)
    seconds, spent = time.monotonic() - start, time.process_time() - spent
    model = pack(robot)
    base = identify(robot, [summarise(model, trace) for trace in traces]).robot
    tests = [read_trace(path, robot) for path in sorted(folder.glob("test_*.csv"))]
    before, after = measured_gap(base, tests), measured_gap(corrected(findings), tests)
    return {
        "case": folder.name,
        "verdict": result.verdict,
        "named": [
            {"name": e.name, "joints": e.joints, "probability": e.probability, "confusable": e.confusable_with}
            for e in result.effects
        ],
        "rivals": [rival.effects[-1].name for rival in result.rivals],
        "claimed": result.gap.shrink,
        "band_hz": result.gap.band_hz,
        "period_s": findings.problem.band.period,
        "shrink": 1.0 - after / before,
        "before_nm": before,
        "after_nm": after,
        "seconds": seconds,
        "cpu_seconds": spent,
    }


def measured_gap(robot: Any, traces: list[Any]) -> float:
    """rms of measured minus predicted torque over the moving rows of `traces`, N m, in the analysis band."""
    from service.model.prediction import error_in_band, motion, predict_along

    square, count = 0.0, 0
    for trace in traces:
        along = motion(trace)
        error = error_in_band(trace, along, predict_along(robot, trace, along)["full"])
        square += float(np.nansum(error**2))
        count += int(np.isfinite(error).sum())
    return (square / max(count, 1)) ** 0.5


def answers(out: Path, done: Callable[[], None]) -> list[dict[str, Any]]:
    """Diagnose all cases of `out` on the backend in force. A case that fails is an answer with an `error`.

    Each answer is kept in `out`/answers as it comes; a run that was interrupted goes on where it stopped.
    """
    kept = out / "answers"
    make_folder(kept)
    folders = sorted((out / "cases").glob("case_*"))
    open_ = [folder for folder in folders if not (kept / f"{folder.name}.json").exists()]
    for _ in range(len(folders) - len(open_)):
        done()
    for found in joblib.Parallel(return_as="generator_unordered")(joblib.delayed(_safe)(f) for f in open_):
        assert found is not None
        write_text(kept / f"{found['case']}.json", json.dumps(found, indent=1))
        done()
    return [json.loads((kept / f"{folder.name}.json").read_text(encoding="utf-8")) for folder in folders]


def _safe(folder: Path) -> dict[str, Any]:
    try:
        return answer(folder)
    except Exception as error:  # one broken case must not lose the others
        return {"case": folder.name, "error": f"{type(error).__name__}: {error}"}


def _same(name: str) -> set[str]:
    from service.model.effects import CATALOGUE, by_name

    known = by_name(CATALOGUE).get(name)
    return {name} | (known.same if known else frozenset())


def judged(rows: list[dict[str, Any]], keys: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Answers with the truth beside them. hit: first name true; told: or the truth among its rivals; both: all named;
    extra: names that are not true; false_sure, sure: of those given with `SURE` or more; f1: of what is in the
    catalogue; joint_ok: where it sits on one."""
    from drivers.simulated.plant.families import KNOWN

    truth = {key["case"]: key for key in keys}
    result = []
    for row in rows:
        key = truth[row["case"]]
        effects = key["effects"]
        floor = key["noise"] * (2 * row["band_hz"] * row["period_s"]) ** 0.5 if "error" not in row else None
        judged_row = row | {
            "kind": key["kind"], "truth": effects or [key["wrong"]] * bool(key["wrong"]), "lift": key["lift"],
            "severity": key["severity"], "floor_nm": floor,
        }  # fmt: skip
        if "error" not in row:
            named = [effect["name"] for effect in row["named"]]
            real = set().union(*map(_same, effects))
            true = real | set(key["allowed"])
            judged_row["first"] = named[0] if named else ("none" if row["verdict"] == "within_noise" else "unknown")
            judged_row["hit"] = bool(named) and named[0] in real
            rivals = row["named"][0]["confusable"] if named else row["rivals"]
            judged_row["told"] = judged_row["hit"] or bool(set(rivals) & real)
            judged_row["both"] = all(set(named) & _same(name) for name in effects)
            judged_row["extra"] = sum(name not in true for name in named)
            sure = [effect["name"] for effect in row["named"] if effect["probability"] >= SURE]
            judged_row["sure"], judged_row["false_sure"] = len(sure), sum(name not in true for name in sure)
            judged_row["f1"] = _f1(named, [name for name in effects if name in KNOWN])
            if judged_row["hit"] and key["kind"] == "catalogue" and len(key["joints"][0]) == 1:
                judged_row["joint_ok"] = row["named"][0]["joints"] == [joint + 1 for joint in key["joints"][0]]
        result.append(judged_row)
    return result


def _f1(named: list[str], effects: list[str]) -> float:
    """Harmonic mean of precision and recall."""
    found = sum(bool(set(named) & _same(name)) for name in effects)
    wrong = sum(not any(name in _same(true) for true in effects) for name in named)
    return 2 * found / max(2 * found + wrong + len(effects) - found, 1)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of merit over judged rows, and by the same keys in `counts` of how many values each is."""
    good = [row for row in rows if "error" not in row]
    values = {key: (statistic, figures) for key, statistic, figures in _measured(good)}
    sure = sum(row["sure"] for row in good)
    return {
        "cases": len(rows),
        "failed": len(rows) - len(good),
        "findable_single": len(values["right_first"][1]),
        **{key: _digits(key, statistic(figures)) if figures else None for key, (statistic, figures) in values.items()},
        "sure_names": sure,
        "calibration": round(1 - sum(row["false_sure"] for row in good) / sure, 3) if sure else None,
        "counts": {key: len(figures) for key, (_, figures) in values.items()} | {"calibration": sure},
    }


def _digits(key: str, value: float) -> float:
    return round(float(value), 1 if "seconds" in key else 3)


def _measured(good: list[dict[str, Any]]) -> Iterator[tuple[str, Callable[..., Any], list[Any]]]:
    """Key of a figure of merit, the statistic, and what it is of: a value a case, of the cases that it concerns."""
    unexplained = ("unexplained", "partly_explained")
    most = partial(np.quantile, q=0.9)

    def of(*kinds: str, findable: bool = False) -> list[dict[str, Any]]:
        return [row for row in good if row["kind"] in kinds and (not findable or row["lift"] >= FINDABLE)]

    single, known = of("catalogue", findable=True), of("null", "catalogue", "pair", "unknown")
    picks, scope = of("production", findable=True), of("scope", findable=True)
    three, outside = of("three"), of("outside")
    errors = [abs(row["claimed"] - row["shrink"]) for row in known]
    yield "right_first", np.mean, [row["hit"] for row in single]
    yield "right_joint", np.mean, [row["joint_ok"] for row in single if "joint_ok" in row]
    yield "extra_per_case", np.mean, [row["extra"] for row in of("null", "catalogue", "pair")]
    yield "null_clean", np.mean, [row["verdict"] == "within_noise" and not row["named"] for row in of("null")]
    yield "unknown_said", np.mean, [row["verdict"] in unexplained for row in of("unknown", findable=True)]
    yield "pair_both", np.mean, [row["both"] for row in of("pair")]
    yield "after_over_floor_median", np.median, [row["after_nm"] / row["floor_nm"] for row in of("catalogue", "null")]
    yield "claim_error_median", np.median, errors
    yield "claim_error_p90", most, errors
    yield "three_f1", np.mean, [row["f1"] for row in three]
    yield "three_first", np.mean, [row["hit"] for row in three]
    yield "three_extra", np.mean, [row["extra"] for row in three]
    yield "outside_f1", np.mean, [row["f1"] for row in outside]
    yield "outside_said", np.mean, [row["verdict"] in unexplained for row in outside]
    yield "outside_extra", np.mean, [row["extra"] for row in outside]
    yield "description_right", np.mean, [row["extra"] == 0 for row in of("description")]
    yield "description_extra", np.mean, [row["extra"] for row in of("description")]
    yield "production_told", np.mean, [row["told"] for row in picks]
    yield "production_first", np.mean, [row["hit"] for row in picks]
    yield "scope_first", np.mean, [row["hit"] for row in scope]
    yield "scope_explained", np.mean, [row["verdict"] == "explained" for row in scope]
    yield "seconds_median", np.median, [row["seconds"] for row in good]
    yield "cpu_seconds_median", np.median, [row["cpu_seconds"] for row in good]


def confusion(rows: list[dict[str, Any]]) -> tuple[list[str], list[str], np.ndarray]:
    """Truth, first answer, counts: findable single effects, effects out of catalogue, and gap-free logs."""
    single = [r for r in rows if "error" not in r and r["kind"] in ("catalogue", "unknown", "null")]
    single = [r for r in single if r["kind"] == "null" or r["lift"] >= FINDABLE]
    label = [r["truth"][0] if r["truth"] else "none" for r in single]
    outside = {r["truth"][0] for r in single if r["kind"] == "unknown"}
    truth = sorted(set(label) - outside - {"none"}) + sorted(outside) + ["none"]
    named = {r["first"] for r in single} | (set(truth) - outside)
    answer_ = sorted(named, key=lambda name: (name in ("unknown", "none"), name))
    table = np.zeros((len(truth), len(answer_)), int)
    for row, name in zip(single, label, strict=True):
        if name in truth:
            table[truth.index(name), answer_.index(row["first"])] += 1
    return truth, answer_, table
