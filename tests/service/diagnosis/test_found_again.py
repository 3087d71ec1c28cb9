"""Every effect of the catalogue, put into logs of a few seconds by other code, is found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.diagnosis.fit.completed import completed
from tests.service.axis import AXIS, SINGLE, Axis, loose_axis, spring_axis
from tests.service.injected import INJECTED, reports
from tests.service.subject import (
    CATALOGUE,
    EFFECTS,
    Band,
    Hypothesis,
    Problem,
    Recording,
    Regressors,
    Split,
    selection,
    statistics,
)
from tests.service.world import BASE, COULOMB, PERIOD, course, problem

SECONDS = 3.0
RUNS = (1, 2, 3)
STARTS = (0.0, 9.0, 40.0)  # s since power-on
NOISE = 0.2  # N m a sample
RIVALS = tuple(effect for effect in CATALOGUE if not effect.rough)


@pytest.mark.parametrize("name", INJECTED)
def test_it_is_found_again_with_its_parameters_inside_their_intervals(name):
    injected = INJECTED[name]
    courses = [course(seed, SECONDS) for seed in RUNS]
    random = np.random.default_rng(7)
    torques = [
        reports(name, seed, SECONDS, start) + NOISE * random.standard_normal((len(run.time), 3))
        for seed, run, start in zip(RUNS, courses, STARTS, strict=True)
    ]
    logs = problem(courses, torques, NOISE, STARTS)
    split = Split.of(logs)
    start = replace(BASE, rigid=BASE.rigid * 0.9, viscous=0 * COULOMB, coulomb=0 * COULOMB)
    found = selection.search(Regressors(logs, split, RIVALS, Hypothesis(start)), lambda _: None)
    assert found.best.names == (name,)
    (term,) = found.best.hypothesis.terms
    assert set(term.joints) == set(injected.joints)
    assert found.best.fitted.cost / logs.count < 1.1
    errors = statistics.standard_errors(found.best.fitted, split)[11:]
    values = np.concatenate([term.amplitude.ravel(), term.nonlinear])
    truth = np.concatenate([np.array(injected.amplitude).ravel(), injected.nonlinear])
    assert (np.abs(values - truth) <= 3.0 * errors).all()


CASES = [
    ("joint_elasticity", spring_axis, (14.0, 0.12, 0.3)),
    ("backlash", loose_axis, (0.0023, 120.0, 2.0, 0.25)),
    ("backlash", loose_axis, (0.0023, 47.0, 0.15, 0.25)),  # flanks that ring
]


@pytest.mark.parametrize(("name", "make", "nonlinear"), CASES)
def test_a_link_behind_a_gear_is_found_again(name, make, nonlinear):
    random = np.random.default_rng(3)
    band, noise = Band.of(PERIOD), 0.3
    recordings = []
    axis = make(6.0, *nonlinear)
    for number in range(3):
        part = slice(2000 * number, 2000 * (number + 1))
        one = Axis(axis.time[part], tuple(signal[part] for signal in axis.motion), axis.extra[part])  # pyright: ignore
        clean = one.scene().segment
        moving = clean.moving.copy()
        moving[:600] = moving[-100:] = False  # until the start is forgotten
        noisy = clean.torque + noise * random.standard_normal(clean.torque.shape)
        recordings.append(Recording(replace(clean, torque=noisy, moving=moving), AXIS, number, f"run_{number}"))
    logs = Problem.of(recordings, band, np.array([noise * band.white_share**0.5]))
    split = Split.of(logs)
    rivals = [e for e in EFFECTS.values() if e.name not in ("cogging", "encoder_eccentricity")]
    found = selection.search(Regressors(logs, split, rivals, Hypothesis(SINGLE)), lambda _: None, grow=completed)
    assert found.best.names[0] == name
    term = found.best.hypothesis.terms[0]
    errors = statistics.standard_errors(found.best.fitted, split)[6:]
    # 125 us a step of the catalogue's integration bias damping and share of the motor by 3 %, which no interval covers
    assert (np.abs(np.array(term.nonlinear) - nonlinear) <= 3.0 * errors + 0.03 * np.array(nonlinear)).all()
