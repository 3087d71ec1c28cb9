"""Motion below 0.05 rad/s, where a gear rubs as it likes: gravity tells the mass, or it is said that it does not."""

import numpy as np
import pytest

from schemas.messages import Gripper, PayloadEvent, stamp_ns
from service.estimator import slow
from tests.service.estimator.test_departure import rubbed
from tests.service.estimator.test_trust import covered, weigh

PACE = 0.0085  # 0.039 rad/s at most
ON, OFF = 8.0, 20.0  # s


def slowly(robot, make, level=(0.0, 0.0, 0.0), mass=2.0):
    """30 s of slow motion with `mass` kg from ON to OFF, friction more by `level` of itself."""
    known = make(30.0, payload=lambda t: mass * ((t >= ON) & (t < OFF)), noise=0.25, pace=PACE)
    known.samples["torque"] += np.array(level) * rubbed(robot, known)
    return known.samples


def truth_of(time, mass=2.0):
    return mass * ((time >= ON) & (time < OFF))


@pytest.mark.parametrize(
    "level", [(0.0, 0.0, 0.0), (0.2, 0.2, 0.2), (0.2, -0.1, 0.25)], ids=["as identified", "more", "of each its own"]
)
def test_a_load_is_seen_and_weighed(robot, make, level):
    payload, time = weigh(robot, slowly(robot, make, level))
    inside, _ = covered(payload, time, truth_of(time), after=0.6)
    assert inside >= 0.95
    seen = payload["event"] != 0
    assert payload["event"][seen].tolist() == [PayloadEvent.PICK, PayloadEvent.RELEASE]
    assert (np.abs(time[seen] - [ON, OFF]) < 0.6).all()
    held = (time > ON + 2.0) & (time < OFF)
    assert np.abs(payload["mass"] - 2.0)[held].max() < 0.3


def test_what_friction_may_be_is_in_the_error(robot, make):
    """A load that hangs from the start, and friction that has departed as far as a gear does, another way on each
    joint: nothing but the way the weight changes with the pose tells the two apart."""
    known = make(10.0, payload=lambda t: 2.0 * np.ones_like(t), noise=0.25, pace=PACE)
    known.samples["torque"] += np.array([0.3, -0.3, 0.3]) * rubbed(robot, known)
    payload, time = weigh(robot, known.samples)
    inside, _ = covered(payload, time, 2.0 * np.ones_like(time))
    assert inside >= 0.95


def test_a_gripper_that_says_so_starts_a_mass_anew(robot, make):
    samples = slowly(robot, make)
    time = stamp_ns(samples) * 1e-9
    samples["gripper"] = np.where((time >= ON) & (time < OFF), Gripper.CLOSED, Gripper.OPEN)
    payload, time = weigh(robot, samples)
    kinds, at = payload["event"][payload["event"] != 0], time[payload["event"] != 0]
    assert kinds.tolist() == [PayloadEvent.PICK, PayloadEvent.RELEASE]
    assert (np.abs(at - [ON, OFF]) < [0.6, 0.02]).all()
    assert (payload["mass"][(time > OFF + 0.02)] == 0).all()


def test_nothing_is_seen_where_nothing_hangs(robot, make):
    payload, time = weigh(robot, slowly(robot, make, (0.2, -0.1, 0.25), mass=0.0))
    assert not payload["event"].any()
    inside, _ = covered(payload, time, np.zeros_like(time))
    assert inside >= 0.95


WIDEST, DRIFT, CYCLE = 4.0, np.array([0.3, 0.4, 0.5]), 0.01  # kg^2, N m, s


def least_squares(rows, before, slow_before, newest=1.0):
    """Mass and its variance by normal equations in m and three b. rows: newest last, (phi, residual, way, weight).
    newest: share that counts of what may contradict the others."""
    mass, variance = before
    levels, spreads = slow_before
    information = np.diag([1 / variance, *(1 / spreads)])
    moment = information @ [mass, *levels]
    for age, (phi, residual, way, weight) in enumerate(reversed(rows)):
        column = np.column_stack([phi, np.diag(way)])
        share = np.exp(-age * CYCLE / slow.MEMORY_TIME) - (1.0 - newest) * np.exp(-age * CYCLE / slow.NEWEST_TIME)
        fading = share * weight[:, None] * column
        information, moment = information + column.T @ fading, moment + fading.T @ residual
    covariance = np.linalg.inv(information)
    return covariance @ moment, covariance


def wander(rows):
    """kg^2, of levels that wander along the way."""
    fading = np.exp(-CYCLE / slow.MEMORY_TIME) ** np.arange(len(rows))[::-1, None]
    load, rubs = (
        np.sum(fading * [w * value**2 for value, w in zip(values, (r[3] for r in rows), strict=True)], axis=0)
        for values in ([r[0] for r in rows], [r[2] for r in rows])
    )
    return 1 / np.sum(load / rubs / (slow.WANDER_DRIFTS * DRIFT) ** 2)


def contradicted(rows, found, covariance):
    """Whether the mass of the newest is another than `found`, by more than either is unsure of."""
    fading = np.exp(-CYCLE / slow.NEWEST_TIME) ** np.arange(len(rows))[::-1, None]
    phi, residual, way, weight = (np.array(part) for part in zip(*rows, strict=True))
    load = np.sum(fading * weight * phi**2)
    step = np.sum(fading * weight * phi * (residual - way * found[1:] - phi * found[0])) / load
    rubs = np.sum(fading * weight * phi * way, axis=0) / load
    spread = 1 / load + rubs**2 @ np.diag(covariance)[1:] + covariance[0, 0]
    return abs(step) > max(slow.SMALLEST_STEP, slow.STEP_SIGMAS * spread**0.5)


@pytest.mark.parametrize("known", [(0.5, 0.09), (1.0, 1e-9), (0.5, 50.0)], ids=["so far", "too well", "not at all"])
def test_slow_motion_is_least_squares_in_a_mass_and_three_levels(known):
    """First with what was known before; then, the load another, anew from there with what was found of the levels."""
    random, state = np.random.default_rng(2), np.zeros(1, slow.STATE)[0]
    level = np.array([0.2, -0.3, 0.4])

    def take(mass):
        phi, way = random.uniform(2.0, 4.0, 3), random.choice([-1.0, -0.7, 0.6, 1.0], 3)
        weight = random.uniform(20.0, 40.0, 3)
        residual = mass * phi + level * way + random.standard_normal(3) / np.sqrt(weight)
        now["phi"], now["residual"], now["way"], now["weight"] = phi, residual, way, weight
        told = slow.slow_kernel(state, CYCLE, WIDEST)
        return told, (phi, residual, way, weight)

    now = state["now"]
    now["drift"], now["mass"], now["variance"] = DRIFT, *known
    assert not slow.slow_kernel(state, CYCLE, WIDEST)
    assert state["lasted"] == 0, "nothing moves"
    early = [take(1.0)[0] for _ in range(round(slow.BEGIN_TIME / CYCLE) - 1)]
    assert not any(early), "what sets out or stops is through it in less"
    rows = []
    for _ in range(100):
        told, row = take(1.0)
        assert told
        rows.append(row)
    before = (known[0], np.clip(known[1], slow.LEAST_STD**2, WIDEST)), (np.zeros(3), (slow.LEVEL_DRIFTS * DRIFT) ** 2)
    found, covariance = least_squares(rows, *before)
    np.testing.assert_allclose(state["mass"], found[0], rtol=1e-9)
    np.testing.assert_allclose(state["variance"], covariance[0, 0] + wander(rows), rtol=1e-9)

    while True:  # until the step is seen, and all begins anew
        rows.append(take(3.0)[1])
        found, covariance = least_squares(rows, *before)
        assert (state["variance"] == WIDEST) == contradicted(rows, found, covariance)
        if state["variance"] == WIDEST:
            break
        assert len(rows) < 130
    found, covariance = least_squares(rows, *before, newest=0.0)  # in which the step is, that friction did not make
    anew = (found[0], WIDEST), (found[1:], np.diag(covariance)[1:])
    rows = [take(3.0)[1] for _ in range(40)]
    found, covariance = least_squares(rows, *anew)
    np.testing.assert_allclose(state["mass"], found[0], rtol=1e-9)
    assert abs(found[0] - 3.0) < 0.15

    slow.grip_kernel(state, WIDEST)
    assert (state["mass"], state["variance"]) == (pytest.approx(found[0]), WIDEST), "another mass, not yet known"
    assert take(3.0)[0]
    now["weight"] = 0.0
    assert not slow.slow_kernel(state, CYCLE, WIDEST)
    setting_out = [take(3.0)[0] for _ in range(round(slow.BEGIN_TIME / CYCLE))]
    assert not any(setting_out[:-1]), "behind a stop as behind what was fast"
    assert setting_out[-1]
    slow.fast_kernel(state)
    assert not take(3.0)[0], "what was slow says nothing any more"
    now["mass"], now["variance"] = 3.0, 0.01
    while not take(3.0)[0]:
        pass
    assert not state["level_before"].any(), "nor of friction"


@pytest.mark.parametrize(("sigmas", "told"), [(4.95, False), (5.05, True), (-4.95, False), (-5.05, True)])
def test_the_newest_contradict_by_five_of_what_is_not_known_of_them(sigmas, told):
    """Of what friction is taken to be with the mass found from all, of the newest's noise, and of that mass."""
    random, state = np.random.default_rng(6), np.zeros(1, slow.STATE)[0]
    for _ in range(10):
        for sums, count in (("whole", 300), ("newest", 40)):
            phi, way, weight = random.uniform(1, 4, (count, 3)), random.uniform(-1, 1, (count, 3)), random.random(3)
            sums = state[sums]
            sums["load"], sums["cross"] = weight * np.sum(phi**2, axis=0), weight * np.sum(phi * way, axis=0)
            sums["way"] = weight * np.sum(way**2, axis=0)
        state["whole"]["rub"] = random.normal(0.0, 50.0, 3)
        state["level_before"], state["level_variance"] = random.normal(0.0, 2.0, 3), random.uniform(0.01, 0.1, 3)
        state["mass"], state["variance"] = random.uniform(1.5, 4.0), random.uniform(1e-3, 2e-3)
        whole, newest = state["whole"], state["newest"]
        sure = whole["way"] + 1 / state["level_variance"]
        rubbed = whole["rub"] + state["level_before"] / state["level_variance"]
        level = (rubbed - whole["cross"] * state["mass"]) / sure
        spread = 1 / sure + (whole["cross"] / sure) ** 2 * state["variance"]
        load = newest["load"].sum()
        doubt = 1 / load + newest["cross"] ** 2 @ spread / load**2 + state["variance"]
        step = sigmas * doubt**0.5
        assert abs(step) > slow.SMALLEST_STEP
        newest["pull"] = level * newest["cross"] + (state["mass"] + step) * newest["load"]
        assert slow._contradicted(state) == told
    state["newest"]["load"] = 0.0
    assert not slow._contradicted(state), "nothing newest, nothing said"
