"""What an effect explains is its own: by far more than its torque does at other times, given it."""

from __future__ import annotations

import numpy as np
import pytest

from service.diagnosis.fit.null import DRAWS, OWN, over_null
from service.diagnosis.fit.wide import Wide
from tests.service.injected import reports
from tests.service.subject import EFFECTS, Fit, Hypothesis, Problem, Term, evaluate, fit
from tests.service.world import BASE, PERIOD, course, problem

SECONDS, SEEDS, SIGMA = 3.0, (1, 2, 3), 0.2
SPRING = Term(EFFECTS["joint_spring"], (0,), np.zeros((1, 2)), ())
OFFSET = Term(EFFECTS["torque_offset"], (0,), np.zeros((1, 1)), ())
DELAY = Term(EFFECTS["torque_delay"], (), np.zeros((1, 0)), (0.002,))


def disturbance(seed: int, rows: int) -> np.ndarray:
    """(rows,) N m, 6 rms: a torque that nothing in the motion shows, of 1 to 5 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * PERIOD
    wave = np.sin(time[:, None] * 2 * np.pi * rng.uniform(1, 5, 6) + rng.uniform(0, 6, 6))
    return 6.0 * (2 / 6) ** 0.5 * wave.sum(axis=1)


def logs(name: str = "", add=lambda run, seed: 0.0) -> Problem:
    """Three runs, with an effect put in by other code and what `add` gives."""
    runs, torques = [course(seed, SECONDS) for seed in SEEDS], []
    for run, seed in zip(runs, SEEDS, strict=True):
        torque = reports(name, seed, SECONDS) if name else run.torque
        noise = SIGMA * np.random.default_rng(seed).standard_normal(torque.shape)
        torques.append(torque + noise + add(run, seed))
    return problem(runs, torques, SIGMA)


def on(joint: int, torque: np.ndarray) -> np.ndarray:
    return torque[:, None] * (np.arange(3) == joint)


def bare(fitted: Fit) -> Wide:
    """Without a discrepancy."""
    return Wide.of(fitted, [np.zeros((len(residual), 0)) for residual in fitted.residuals], 0.0)


def over(made: Problem, term: Term) -> float:
    fewer, best = (fit(made, Hypothesis(BASE, terms)) for terms in ((), (term,)))
    return over_null(made, bare(fewer), best, {term.effect}, made.level(best.residuals))


def test_a_spring_is_more_its_own_than_what_waves_on_its_joint_make_of_it():
    """And of a delay; also together with waves on another joint."""
    true = over(logs("joint_spring", lambda run, seed: on(2, disturbance(seed, len(run.torque)))), SPRING)
    waves = logs(add=lambda run, seed: on(0, disturbance(seed, len(run.torque))))
    assert max(over(waves, SPRING), over(waves, DELAY)) < 1.0 < 10.0 < true
    assert over(logs("joint_spring"), SPRING) > OWN


def test_a_constant_torque_has_no_null_and_one_that_is_nothing_explains_nothing():
    assert over(logs(add=lambda run, seed: on(0, np.full(len(run.torque), 3.0))), OFFSET) > OWN
    made = logs()
    still = evaluate(made, Hypothesis(BASE, (Term(EFFECTS["torque_delay"], (), np.zeros((1, 0)), (0.0,)),)))
    assert over_null(made, bare(fit(made, Hypothesis(BASE))), still, {EFFECTS["torque_delay"]}, np.ones(3)) == 0.0


@pytest.mark.parametrize("opened", [0, 2])
def test_the_ratio_by_least_squares(opened):
    """Each shifted torque beside the effect's own, all that the model can, and discrepancies with their priors."""
    made = logs("joint_spring", lambda run, seed: on(0, disturbance(seed, len(run.torque))))
    fewer, best = (fit(made, Hypothesis(BASE, terms)) for terms in ((), (SPRING,)))
    random, prior = np.random.default_rng(4), 30.0
    columns = [random.standard_normal((len(r), opened)) for r in fewer.residuals]
    shifts = np.random.default_rng(0)
    unit = np.array([3.0, 1.0, 2.0])
    weight = 1.0 / unit[np.concatenate(made.joints_of_rows)]

    def taken(*torques: np.ndarray) -> float:
        """Squares that are left given these."""
        own = np.concatenate(fewer.moving)
        whole = weight[:, None] * np.hstack([own, np.concatenate(columns), *torques])
        ridge = np.zeros((opened, whole.shape[1]))
        ridge[:, own.shape[1] : own.shape[1] + opened] = prior**0.5 * np.eye(opened)
        target = np.r_[weight * np.concatenate(fewer.residuals), np.zeros(opened)]
        scale = np.linalg.norm(whole, axis=0)
        step = np.linalg.lstsq(np.vstack([whole, ridge]) / scale, target, rcond=None)[0]
        left = target - np.vstack([whole, ridge]) / scale @ step
        return float(left @ left)

    spring = [tangent[:, -2:] for tangent in best.tangents]
    nothing, with_own = taken(), taken(np.concatenate(spring))
    most = 0.0
    for _ in range(DRAWS):
        late = []
        for rows, torque in zip(made.rows, spring, strict=True):
            count, along = int(rows[:, 0].sum()), np.zeros((len(rows), 2))
            along[rows[:, 0]] = torque[:count]
            along = np.roll(along, round(shifts.uniform(0.1, 0.9) * len(rows)), axis=0)
            late.append(np.vstack([along[rows[:, 0]], torque[count:]]))
        most = max(most, with_own - taken(np.concatenate(spring), np.concatenate(late)))
    found = over_null(made, Wide.of(fewer, columns, prior), best, {SPRING.effect}, unit)
    assert found == pytest.approx((nothing - with_own) / most, rel=1e-3)
