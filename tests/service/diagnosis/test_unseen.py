"""The correction on a log that it had no part in: what is said of it against what was put there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.trace import Trace
from service.diagnosis.evidence.unseen import unseen
from tests.service.injected import INJECTED, reports
from tests.service.subject import Hypothesis
from tests.service.world import BASE, ROBOT, course, problem, stub

SECONDS, NOISE, KNOCK = 3.0, 0.3, 8.0  # s, N m, N m
BEAT, SHORT, FIRST = 0.3, 0.03, 0.3  # s between knocks, of one, of the first


@pytest.fixture(scope="module")
def findings():
    """A spring on the first joint, found exactly."""
    return stub(
        robot=ROBOT,
        problem=problem([course(1, 1.0)], [course(1, 1.0).torque]),
        reference=Hypothesis(BASE),
        best=stub(hypothesis=Hypothesis(BASE, (INJECTED["joint_spring"].term("joint_spring"),))),
        noise=np.full(3, NOISE),
    )


def trace(knock: float) -> tuple[Trace, np.ndarray]:
    """A log kept out, and the torque (N, 3) N m of what knocks at its second joint."""
    run = course(4, SECONDS)
    beat = (run.time - FIRST) % BEAT
    knocks = np.zeros_like(run.torque)
    knocks[:, 1] = knock * (beat < SHORT) * (run.time > FIRST) * (run.time < SECONDS - FIRST)
    noise = NOISE * np.random.default_rng(4).standard_normal(run.torque.shape)
    torque = reports("joint_spring", 4, SECONDS) + knocks + noise
    return Trace(Path("kept.csv"), run.time, run.motion[0], torque), knocks


def rms(findings, values: np.ndarray) -> np.ndarray:
    """(3,) of (N, 3), in the band, away from the ends."""
    return np.sqrt(np.mean(findings.problem.band(values)[50:-50] ** 2, axis=0))


def test_events_are_told_apart_from_what_the_correction_leaves(findings):
    log, knocks = trace(KNOCK)
    run = course(4, SECONDS)
    spring = reports("joint_spring", 4, SECONDS) - run.torque
    noise = log.torque - run.torque - spring - knocks
    found = unseen(findings, log)
    assert found.trace == "kept"
    assert found.whole.before_nm == pytest.approx(rms(findings, spring + knocks + noise), rel=0.06)
    assert found.whole.after_nm == pytest.approx(rms(findings, knocks + noise), rel=0.06)
    assert len(found.bursts) == round((SECONDS - 2 * FIRST) / BEAT)
    assert {burst.joint for burst in found.bursts} == {2}
    assert found.rhythm_s == pytest.approx(BEAT, rel=0.02)
    assert found.outside is not None
    assert found.outside.before_nm == pytest.approx(rms(findings, spring + noise), rel=0.15)
    assert found.outside.after_nm == pytest.approx(rms(findings, noise), rel=0.1)
    low, high = found.outside.shrink_ci95
    assert low < found.outside.shrink < high
    around = sum(burst.to_s - burst.from_s + 0.06 for burst in found.bursts) / (SECONDS - 2 * 0.1)
    assert found.outside_share == pytest.approx(1 - around, abs=0.05)


def test_a_log_without_events_has_nothing_outside_them(findings):
    log, _ = trace(0.0)
    found = unseen(findings, log)
    assert (found.outside, found.outside_share, found.rhythm_s, found.bursts) == (None, 1.0, None, [])
    assert found.whole.shrink > 0.5
    moved = found.simulated
    assert moved is not None
    assert moved.horizon_s == pytest.approx(0.2)
    assert moved.windows > 5
    before, after, floor = moved.platform_before_mm, moved.platform_after_mm, moved.platform_floor_mm
    assert before is not None
    assert after is not None
    assert floor is not None
    assert after < 0.5 * before
    assert after < 2 * floor
    assert moved.path_mm is not None
    assert moved.path_mm > 10 * before
