"""What a residual follows, against residuals made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.trace import Trace
from service.diagnosis.evidence.follows import follows
from tests.service.subject import Split
from tests.service.world import course, direction, problem

RUNS = [course(seed, 2.0) for seed in (1, 2, 3)]
LOGS = problem(RUNS, [run.torque for run in RUNS])
JOINT = 1  # whose residual it is


def error(run):
    """(N,) rad, of the joint's drive: nothing that moves."""
    return 1e-3 * np.sin(2 * np.pi * 3.3 * run.time + 1.0)


def traces(commanded: bool = True) -> list[Trace]:
    commands = []
    for run in RUNS:
        command = run.motion[0].copy()
        command[:, JOINT] += error(run)
        commands.append(command if commanded else None)
    return [Trace(Path("run"), r.time, r.motion[0], r.torque, c) for r, c in zip(RUNS, commands, strict=True)]


CAUSES = {
    ("motion", 1): lambda run: run.motion[2][:, 0],
    ("motion", 3): lambda run: direction(run.motion[1], 0.01)[:, 2],
    ("sine_of_angle", None): lambda run: np.sin(run.motion[0][:, JOINT]),
    ("position_error", None): error,
}


def residuals(cause, energy: float, share: float) -> list[np.ndarray]:
    """In units of the noise: of the joint noise of 1, and `energy` above it, of which `share` follows `cause` and the
    rest nothing; of the other joints noise alone, and a constant."""
    random, masks = np.random.default_rng(7), [mask[:, JOINT] for mask in LOGS.rows]
    told = [LOGS.band(cause(run)[:, None])[mask, 0] for run, mask in zip(RUNS, masks, strict=True)]
    mean, std = np.mean(np.concatenate(told)), np.std(np.concatenate(told))
    result = []
    for part, joints in zip(told, LOGS.joints_of_rows, strict=True):
        residual = random.choice([-1.0, 1.0], len(joints)) + 2.0 * (joints != JOINT)
        rest = (1 - share) ** 0.5 * random.choice([-1.0, 1.0], len(part))
        residual[joints == JOINT] += energy**0.5 * (share**0.5 * (part - mean) / std + rest)
        result.append(residual)
    return result


def asked(cause, energy: float, share: float, **changed):
    of = {"traces": traces(), "angular": True} | changed
    return follows(LOGS, Split.of(LOGS), residuals(cause, energy, share), of["traces"], of["angular"])


@pytest.mark.parametrize("what", CAUSES)
def test_what_a_gap_follows_is_told_with_its_share(what):
    first, *others = asked(CAUSES[what], 3.0, 0.7)
    assert (first.joint, first.what, first.other) == (JOINT + 1, *what)
    assert first.share == pytest.approx(0.7, abs=0.06)  # two standard deviations of what chance does
    assert all(one.joint == JOINT + 1 and one.share < first.share for one in others)


def test_the_strongest_comes_first():
    """A fifth of it the position error, the rest the motion."""

    def cause(run):
        return run.motion[2][:, 0] / 15.0 + 700.0 * error(run)

    shares = [one.share for one in asked(cause, 3.0, 0.9)]
    assert len(shares) > 1
    assert shares == sorted(shares, reverse=True)


def test_little_is_not_told_and_neither_is_what_noise_alone_could_be():
    cause = CAUSES["motion", 1]
    assert ("motion", 1) in [(one.what, one.other) for one in asked(cause, 3.0, 0.09)]
    assert ("motion", 1) not in [(one.what, one.other) for one in asked(cause, 3.0, 0.02)]
    assert asked(cause, 0.3, 1.0)
    assert asked(cause, 0.1, 1.0) == []


def test_what_cannot_be_asked_is_not():
    """An axis that slides has no sine; a log without commands no error."""
    assert "sine_of_angle" not in [one.what for one in asked(CAUSES["sine_of_angle", None], 3.0, 0.7, angular=False)]
    assert asked(error, 3.0, 0.7, traces=traces(commanded=False)) == []
    some = [*traces()[:2], traces(commanded=False)[2]]
    assert asked(error, 3.0, 0.7, traces=some) == [], "nor one of which a log has none"
