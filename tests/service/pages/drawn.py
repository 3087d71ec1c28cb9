"""Documents drawn at random, each consistent in itself as its maker leaves it, and their pages by the real writers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np

from schemas.diagnosis import Advice, CautionCode, Diagnosis, Provenance
from schemas.fleet_document import DayResult, Fleet, RobotHistory
from schemas.rollout_document import RolloutDocument
from service.diagnosis.documents.report import of_document, write_diagnosis
from service.diagnosis.fit.selection import WITHIN_NOISE
from service.diagnosis.sealed_cases import judged, summary
from service.diagnosis.sealed_page import write_page as write_blindtest
from service.experiment.live_loop import CORRECTED, FEEDBACK, RIGID, Tracking
from service.experiment.loop_page import page as loop_page
from service.experiment.loop_page import verdict_of_correction, verdict_of_models
from service.experiment.pictures import write_page as write_findings
from service.fleet.changes import changes
from service.fleet.page import write_page as write_fleet
from service.model.effects import CATALOGUE
from service.rollout.gap import REGIMES
from service.rollout.rollout_page import write_rollout

MADE = Provenance(at="2026-03-01T10:00:00+00:00", version="1.2.3", inputs={"pick.csv": "a" * 64})
UNITS = ("", "N m", "rad", "N m s/rad", "kg")


def share(rng: np.random.Generator) -> float:
    """From none to all, with both ends and what is near them."""
    return float(rng.choice([0.0, 1.0, 0.9999, 0.99996, 0.0004, 0.12345, round(float(rng.random()), 4)]))


def effects(rng: np.random.Generator, joints: int, most: int) -> list[dict[str, Any]]:
    """Named effects of the catalogue, all different, as a document has them."""
    drawn = []
    for number in rng.permutation(len(CATALOGUE))[: rng.integers(0, most + 1)]:
        effect = CATALOGUE[number]
        other = CATALOGUE[int(rng.integers(len(CATALOGUE)))]
        value, half = float(rng.normal() * 10.0 ** rng.integers(-4, 4)), float(10.0 ** rng.integers(-5, 3))
        estimate = {
            "value": value, "unit": str(rng.choice(UNITS)), "ci95": [value - half, value + half], "meaning": "amount"
        }  # fmt: skip
        on = sorted(int(one) + 1 for one in rng.permutation(joints)[: rng.integers(0, joints + 1)])
        drawn.append(
            {
                "name": effect.name, "title": effect.title, "means": effect.means, "joints": on,
                "probability": round(0.8 + 0.2 * float(rng.random()), 4), "parameters": {"amount": estimate},
                "gap_share": share(rng), "settles": effect.settles,
                "confusable_with": [other.name] if rng.random() < 0.3 and other.name != effect.name else [],
                "online": {"carried": True, "reason": "state"},
            }
        )  # fmt: skip
    return drawn


def gap_of(rng: np.random.Generator, named: bool, joints: int, unit: str) -> tuple[dict[str, Any], str]:
    """A gap and its verdict."""
    noise = 10.0 ** rng.uniform(-3, 1, joints)
    before = noise * np.sqrt(1.0 + 10.0 ** rng.uniform(-2, 3.5, joints)) if rng.random() < 0.85 else noise * 1.01
    after = before
    if named:
        after = np.maximum(noise, before * rng.uniform(0.0, 1.02)) if rng.random() < 0.7 else noise
    rms = [float(np.sqrt(np.mean(values**2))) for values in (before, after, noise)]
    shrink = 1.0 - rms[1] / rms[0]
    left = float(np.sqrt(np.mean((after / noise) ** 2)))
    words = ("explained", "partly_explained") if named else ("within_noise", "unexplained")
    above, wide = rms[0] ** 2 - rms[2] ** 2, float(rng.choice([1e-5, 0.05]))
    gap = {
        "unit": unit, "before_nm": before.tolist(), "after_nm": after.tolist(), "noise_floor_nm": noise.tolist(),
        "reversal_nm": [0.0] * joints, "torque_nm": (before * 10.0 ** rng.uniform(-0.2, 4)).tolist(), "shrink": shrink,
        "shrink_ci95": [shrink - wide, shrink + wide / 2], "band_hz": 40.0,
        "shrink_of_explainable": (rms[0] ** 2 - rms[1] ** 2) / above if above > 0 else None,
    }  # fmt: skip
    return gap, words[left > WITHIN_NOISE]


def diagnosis(rng: np.random.Generator, joints: int = 0) -> Diagnosis:
    """One robot's, of so many joints, or of any number."""
    joints, unit = joints or int(rng.choice([1, 2, 3, 6])), str(rng.choice(["N m", "N"]))
    named = effects(rng, joints, 3)
    gap, verdict = gap_of(rng, bool(named), joints, unit)
    others = [CATALOGUE[k].name for k in rng.permutation(len(CATALOGUE))[:4]]
    ranking = [{"name": one["name"], "joints": one["joints"], "probability": one["probability"]} for one in named]
    ranking += [
        {"name": name, "joints": [1], "probability": share(rng)}
        for name in others
        if name not in {one["name"] for one in named}
    ]
    worse = [0.0 if number < len(named) else float(rng.choice([0.0, 0.3])) for number in range(len(ranking))]
    ranking = [one | {"after_nm": 1.0, "shrink": share(rng) - less} for one, less in zip(ranking, worse, strict=True)]
    regime = {"regime": "slow motion", "share": share(rng), "of_time": share(rng)}
    where = []
    for joint in range(joints):
        before, after, noise = (gap[name][joint] ** 2 for name in ("before_nm", "after_nm", "noise_floor_nm"))
        budget = {"noise": min(noise, after), "unexplained": max(after - noise, 0.0)}
        budget |= {one["name"]: (before - after) / len(named) for one in named}
        bands = [{"from_hz": 0.0, "to_hz": 3.0, "share": share(rng)}]
        where.append(
            {"joint": joint + 1, "rows": 900, "budget_nm2": budget, "before": [regime], "after": [regime],
             "spectrum_before": bands, "spectrum_after": bands}
        )  # fmt: skip
    cautions = [
        {"code": str(code), "advice": str(rng.choice(get_args(Advice))), "joints": [1], "effect": others[0],
         "share": share(rng), "quantity": "rest_angle", "run": "pick", "gain": 3.0, "gain_most": 4.0,
         "held_s": 0.002}
        for code in rng.choice(get_args(CautionCode), int(rng.integers(0, 3)), replace=False)
    ]  # fmt: skip
    unknown = (1.0 + share(rng) * (1 if verdict in ("unexplained", "partly_explained") else -1)) / 2
    return Diagnosis.model_validate(
        {
            "schema": "deltatwin.diagnosis/2", "made": MADE, "robot": "d3", "traces": ["pick", "slow", "sweep"],
            "verdict": verdict, "effects": named, "cannot_tell": cautions, "ranking": ranking,
            "probability_none": share(rng), "probability_unknown": unknown, "plain": {}, "given": [], "gap": gap,
            "base": {"rho_1": {"value": 1.1, "unit": "", "ci95": [1.0, 1.2]}},
            "where": {"joints": where, "left_out_at_rest_and_ends": share(rng), "bursts": [], "bursts_rhythm_s": None,
                      "worst_runs": [{"run": "pick", "after_over_noise": 2.0}]},
            "frequency_response": [response(rng, joint + 1, unit) for joint in range(joints)],
        }
    )  # fmt: skip


def response(rng: np.random.Generator, joint: int, unit: str) -> dict[str, Any]:
    """Of a joint: a few decades of magnitude, or many, as beyond what the drive follows."""
    hz, decades = np.geomspace(1.0, 500.0, 30), float(rng.uniform(0.5, 7.0))
    names = ("measured", "before", "after")
    fallen = {name: 0.2 * (hz / hz[0]) ** (-decades / 2.7) * rng.uniform(0.5, 2.0, len(hz)) for name in names}
    return {
        "joint": joint, "unit": f"rad/({unit} s)", "hz": hz.tolist(), "coherence": rng.uniform(size=len(hz)).tolist(),
        "magnitude": {name: values.tolist() for name, values in fallen.items()},
        "phase_deg": {name: rng.uniform(-180.0, 180.0, len(hz)).tolist() for name in names},
    }  # fmt: skip


def write_drawn_diagnosis(rng: np.random.Generator, path: Path) -> Diagnosis:
    """The page of one; what is drawn of its logs is left out."""
    document = diagnosis(rng)
    write_diagnosis(document, None, of_document(document), path)
    return document


def fleet(rng: np.random.Generator, path: Path) -> Fleet:
    """Robots over days, some with something new from some day on."""
    robots = []
    for number in range(int(rng.integers(1, 4))):
        days, found = [], diagnosis(rng)
        ill = int(rng.integers(0, 6))
        for day in range(int(rng.integers(1, 5))):
            known = {"made_of": "x", "robot": f"cell_{number}", "day": f"2026-03-0{day + 1}"}
            if rng.random() < 0.1:
                days.append(DayResult.model_validate(known | {"error": "pick.csv: no joint moves"}))
                continue
            named = found.effects if day >= ill else []
            gap = 10.0 ** float(rng.uniform(-2, 2)) if named else 0.1
            days.append(
                DayResult.model_validate(
                    known
                    | {"verdict": "explained" if named else "within_noise", "effects": named, "gap_nm": gap,
                       "after_nm": 0.1, "torque_nm": gap * 10.0 ** float(rng.uniform(-0.2, 3))}
                )
            )  # fmt: skip
        history = {"robot": f"cell_{number}", "reference": "r.toml", "days": days, "changes": changes(days)}
        robots.append(RobotHistory.model_validate(history))
    document = Fleet(schema="deltatwin.fleet/1", made=MADE, robots=robots)
    write_fleet(document, path)
    return document


def rollout(rng: np.random.Generator, path: Path) -> RolloutDocument:
    """Two or three descriptions over a horizon."""
    times, windows = [0.01 * k for k in range(21)], int(rng.integers(1, 80))

    def reached(name: str, error: float | None) -> dict[str, Any]:
        grown = [None if error is None else error * (0.01 + time**2) / (0.01 + times[-1] ** 2) for time in times]
        return {"robot": name, "joint_mrad": [error] * 3, "platform_mm": error, "growth_mm": grown,
                "ran_away": windows if error is None else 0, "left_out": []}  # fmt: skip

    names = ["plain", "identified", "corrected"]
    errors = [None if rng.random() < 0.1 else float(10.0 ** rng.uniform(-2, 2.5)) for _ in names]
    robots, floor = [reached(*one) for one in zip(names, errors, strict=True)], reached("floor", 0.5)
    every = {one["robot"]: one["platform_mm"] for one in (*robots, floor)}
    document = RolloutDocument.model_validate(
        {
            "schema": "deltatwin.rollout/1", "traces": ["pick"], "horizon_s": 0.2, "windows": windows,
            "payload_kg": [0.0] * (windows - 1) + [1.5], "untold_s": 0.5, "interruptions": [], "windows_lost": 0,
            "seconds": 13.0, "used_s": 12.0, "path_mm": 60.0, "times_s": times, "robots": robots, "floor": floor,
            "over_identified": [float(10.0 ** rng.uniform(-0.3, 1)), None, 1.0] if rng.random() < 0.7 else None,
            "regimes": [{"joint": 1, "regime": name, "windows": 9, "joint_mrad": every} for name in REGIMES],
        }
    )  # fmt: skip
    write_rollout(document, path, {})
    return document


def blind_test(rng: np.random.Generator, path: Path) -> dict[str, Any]:
    """Cases and what was said of them; returns the figures."""
    rows, keys = [], []
    for number in range(int(rng.integers(1, 30))):
        truth, said = (CATALOGUE[int(k)].name for k in rng.integers(0, len(CATALOGUE), 2))
        kind = str(rng.choice(["catalogue", "null", "pair", "unknown", "three", "production"]))
        name = truth if rng.random() < 0.9 else said
        case = f"case_{number:03d}"
        true = [] if kind == "null" else [truth]
        keys.append({"case": case, "kind": kind, "effects": true, "wrong": "", "lift": float(rng.uniform(1, 6)),
                     "severity": 1.0, "noise": 0.5, "allowed": [], "joints": [[0]], "refused": []})  # fmt: skip
        if rng.random() < 0.05:
            rows.append({"case": case, "error": "no joint moves"})
            continue
        named = [] if kind == "null" else [{"name": name, "joints": [1], "probability": 0.95, "confusable": []}]
        shrink = float(rng.random())
        rows.append({"case": case, "verdict": "explained" if named else "within_noise", "named": named, "rivals": [],
                     "before_nm": 2.0, "after_nm": 2.0 * (1 - shrink), "claimed": shrink, "shrink": shrink,
                     "band_hz": 40.0, "period_s": 1e-3, "seconds": 2.0, "cpu_seconds": 2.0})  # fmt: skip
    found = judged(rows, keys)
    figures = summary(found)
    write_blindtest(found, figures, [], "sha256 0", path)
    return figures


def closed_loop(rng: np.random.Generator, path: Path, period: float = 1e-2, end: float = 3.0) -> list[Tracking]:
    """Runs with feedback alone, and with better and worse feed-forward."""
    time = np.arange(0.5, end, period)
    models = rng.random() < 0.5
    names = ["M_KH, m_p = 0", "M_Id, m_p = 0", "M_Id+F, m_p = 0", "full, m_p = 0", "full, payload-aware"]
    runs = []
    for name in [FEEDBACK, *(names if models else [RIGID, CORRECTED])]:
        size = float(10.0 ** rng.uniform(-4, -2))
        error = size * (1 + 0.2 * rng.normal(size=(len(time), 3)))
        missed = np.abs(error[:, 0])
        late = int(rng.integers(0, 3)) if rng.random() < 0.9 else 40
        runs.append(
            Tracking(name, time, error, np.sqrt(np.mean(error**2, axis=0)), missed, missed, float(error.max()),
                     1.0 - share(rng) * 1e-3, 0.0004, late)
        )  # fmt: skip
    said = verdict_of_models(runs) if models else verdict_of_correction(runs, "cogging in joint 1", [], (path, path))
    write_findings(loop_page("d3", "ideal", (1.0,), runs, runs, said), path)
    return runs


KINDS: dict[str, tuple[Callable[[np.random.Generator, Path], Any], int]] = {
    "diagnosis": (write_drawn_diagnosis, 100),
    "fleet": (fleet, 30),
    "rollout": (rollout, 30),
    "blind test": (blind_test, 20),
    "closed loop": (closed_loop, 20),
}  # writer, how many
