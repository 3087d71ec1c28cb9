"""A load that changes while nothing moves: a step of the torque on three joints, and what is no such step."""

import numpy as np
import pytest

from schemas.messages import Gripper, PayloadEvent
from service.estimator.departure import COUNT
from service.estimator.payload import payload_step, rest
from service.estimator.payload.payload_state import LEAST_TIME, LOADS, PRIOR_STD, STATE, settings, start
from tests.service.estimator.test_departure import PRIOR as DRIFT

PERIOD = 1e-3
SETTINGS = settings(PERIOD, DRIFT, 6.0, np.zeros(3), np.ones(3))[()]
PHI = np.array([-0.4, -3.0, -0.9])  # N m/kg
COULOMB = 4.0  # N m, by DRIFT's 15 %
NOISE = 0.2  # N m
AT = 60  # samples


def torques(*, kilograms=0.0, rise=1, noise=NOISE, aside=0.0, back_after=None, samples=150):
    """(samples, 3) N m at rest, `kilograms` more from AT on, within `rise` samples; aside: N m of it across PHI."""
    across = np.cross(PHI, [0.0, 0.0, 1.0])
    after = np.clip((np.arange(samples) - AT + 1) / rise, 0.0, 1.0)
    if back_after is not None:
        after[AT + back_after :] = 0.0
    whole = kilograms * PHI + aside * across / np.linalg.norm(across)
    return after[:, None] * whole + noise * np.random.default_rng(3).standard_normal((samples, 3))


def seen(residuals, moves_at=None):
    """Samples behind AT at which a step is seen, and the state then."""
    (state,) = np.zeros(1, rest.STATE)
    column = np.zeros((3, LOADS))
    column[:, 0] = PHI
    for n, residual in enumerate(residuals):
        if n == moves_at:
            rest.moved_kernel(state)
        elif rest.rest_kernel(SETTINGS, state, column, residual):
            return n + 1 - AT, state
    return None, state


@pytest.mark.parametrize("kilograms", [2.0, -3.8, 0.9])
def test_a_load_changed_at_rest_is_seen_within_its_error(kilograms):
    after, state = seen(torques(kilograms=kilograms))
    assert after is not None
    assert 2 * rest.STRETCH <= after <= 5 * rest.STRETCH, "some 24 ms of standing torque behind it"
    square = PHI @ PHI
    assert abs(state["step"] - kilograms) < 0.1 + 0.1 * abs(kilograms)
    rubbed = 2 / 3 * np.sum((PHI * COULOMB) ** 2) / square**2  # two torques that are anything within Coulomb's
    noise = 1.5 * NOISE**2 / (2 * rest.STRETCH) / square
    assert rubbed + 0.5 * noise < state["variance"] < 1.1 * rubbed


@pytest.mark.parametrize(
    "given",
    [
        {"kilograms": 0.0},
        {"kilograms": 0.3},  # what friction may do of itself
        {"kilograms": 2.0, "noise": 3.0},
        {"kilograms": 2.0, "aside": 4.0},  # not as a load pulls
        {"kilograms": 2.0, "rise": 60},  # a drive that settles
        {"kilograms": 2.0, "back_after": 12},  # a blow
        {"kilograms": 2.0, "moves_at": AT + 10},
        {"kilograms": 2.0, "moves_at": AT - 10},
    ],
)
def test_what_else_torque_does_at_rest_is_no_load(given):
    moves_at = given.get("moves_at")
    behind = 40 if moves_at is not None and moves_at < AT else 90
    residuals = torques(**{name: value for name, value in given.items() if name != "moves_at"})[: AT + behind]
    assert seen(residuals, moves_at)[0] is None


@pytest.mark.parametrize("apart", [30, 40, 60, 120, 300])  # ms, GRIPPER_TIME and more
@pytest.mark.parametrize("then", [2.0, -2.0])
def test_a_load_that_changes_again_is_seen_again(apart, then):
    residuals = torques(kilograms=2.0, samples=AT + apart + 80)
    residuals[AT + apart :] += then * PHI
    (state,), column = np.zeros(1, rest.STATE), np.zeros((3, LOADS))
    column[:, 0] = PHI
    steps = {n: state["step"] for n, one in enumerate(residuals) if rest.rest_kernel(SETTINGS, state, column, one)}
    assert list(steps.values()) == pytest.approx([2.0, then], abs=0.3)
    assert max(steps) - AT - apart <= 40


def known(**fields):
    """2 kg, known to 0.1 kg, of a robot that stands."""
    states = np.zeros(1, STATE)
    start(states, DRIFT)
    (state,) = states
    state["information"][0, 0], state["moment"][0], state["raw_information"] = 100.0, 200.0, 100.0
    state["bin_information"][:], state["bin_moment"][:] = 0.1, 0.2
    state["filled"], state["told"], state["untold"] = 150, 900.0, 0.0
    state["mass"] = state["load"] = 2.0
    state["std_dev"], state["quiet"], state["resting"] = 0.1, 100_000, 1
    for name, value in fields.items():
        state[name] = value
    return state


def stand(state, residuals, shaken=()):
    """Events by sample; shaken: samples in which something moves slowly."""
    events = {}
    for n, residual in enumerate(residuals):
        state["column"], state["weight"], state["residual"] = 0.0, 0.0, residual
        if shaken:
            state["resting"], state["slow"]["now"]["weight"] = n not in shaken, float(n in shaken)
        state["column"][:, 0] = PHI
        event = payload_step.payload_kernel(SETTINGS, state)
        if event:
            events[n] = event
    return events


@pytest.mark.parametrize(("kilograms", "event"), [(2.0, PayloadEvent.PICK), (-1.8, PayloadEvent.RELEASE)])
def test_another_load_is_told_by_what_the_one_before_was(kilograms, event):
    state = known(drag=3.0, still=0.1)
    state["departure"]["delta"][0] = 0.5
    state["moment"][0] += 1.5
    state["slow"]["begun"], state["slow"]["level_variance"], state["slow"]["variance"] = 1, 1.0, 0.1
    events = stand(state, torques(kilograms=kilograms, samples=AT + 35))
    assert list(events.values()) == [event]
    assert state["mass"] == pytest.approx(2.0 + kilograms, abs=0.3)
    assert state["load"] == pytest.approx(state["mass"], abs=0.02)
    friction = np.sqrt(2 / 3 * np.sum((PHI * COULOMB) ** 2)) / (PHI @ PHI)
    assert np.sqrt(1.0 / state["information"][0, 0]) == pytest.approx(friction, rel=0.1)
    assert state["std_dev"] > 0.9 * friction
    assert not state["trusted"]
    np.testing.assert_allclose(state["drag"][0, 0] / state["information"][0, 0], 3.0 / 100.0, rtol=1e-2)
    assert state["raw_information"] == pytest.approx(state["information"][0, 0] * state["inflation"], rel=1e-3)
    assert state["filled"] == 1, "no onset is looked for in what was before"
    assert (state["told"], state["untold"]) == (0.0, LEAST_TIME), "20 ms of motion are to bear it out"
    assert state["still"] < 0.04, "what the rest before hid shows in the step"
    assert state["slow"]["variance"] == PRIOR_STD**2


@pytest.mark.parametrize(
    ("kilograms", "fields"),
    [
        (-9.0, {}),  # a brake that takes the weight
        (9.0, {}),  # and lets go
        (2.0, {"gripper": Gripper.CLOSED, "gripper_before": Gripper.CLOSED}),
        (2.0, {"active": LOADS, "turning": 10_000}),
        (2.0, {"resting": 0}),
    ],
)
def test_what_no_gripper_does_unheard_leaves_the_mass_alone(kilograms, fields):
    state = known(**fields)
    assert stand(state, torques(kilograms=kilograms)) == {}
    assert state["information"][0, 0] > 90.0
    assert state["rest"]["step"] == 0.0


@pytest.mark.parametrize(("jolt", "told"), [(25, True), (45, True), (60, False)])
def test_a_load_shakes_the_arms_it_comes_to(jolt, told):
    """Until the drives hold it, some ten milliseconds; what lasts longer is a motion."""
    state = known()
    residuals = torques(kilograms=2.0, samples=AT + jolt + 90)
    residuals[AT : AT + jolt] *= np.linspace(0.0, 1.5, jolt)[:, None]
    events = stand(state, residuals, range(AT, AT + jolt))
    assert list(events.values()) == [PayloadEvent.PICK] * told
    if told:
        assert state["mass"] == pytest.approx(2.0 + 2.0, abs=0.3)


@pytest.mark.parametrize(
    ("stood", "gripper", "unheard"), [(100, 0, False), (140, 0, True), (140, Gripper.CLOSED, False)]
)
def test_slow_motion_does_not_take_over_a_mass_from_before_a_rest(stood, gripper, unheard):
    """A gripper that nobody hears of may have let go, and friction hides it."""
    state = known(gripper=gripper, gripper_before=gripper, ground=0.0, crept=0.2 if unheard else 0.0)
    stand(state, torques(samples=stood))
    assert state["unheard"] == unheard
    state["resting"], state["slow"]["now"]["phi"] = 0, PHI
    state["shape"][:, 0] = np.sign(-PHI)
    for _ in range(320):
        state["column"], state["weight"], state["residual"] = 0.0, 0.0, 0.0
        state["column"][:, 0], state["slow"]["now"]["weight"] = PHI, 20.0
        payload_step.payload_kernel(SETTINGS, state)
    assert state["crept"] == pytest.approx(0.32 if unheard else 0.0)
    assert state["slow"]["mass_variance"] == (PRIOR_STD**2 if unheard else pytest.approx(0.1**2, rel=0.7))
    if unheard:
        assert abs(state["mass"]) < 2 * state["std_dev"]
        assert not state["trusted"]
    for _ in range(200):
        state["slow"]["now"]["weight"] = 20.0
        payload_step.payload_kernel(SETTINGS, state)
    assert not state["unheard"], "the motion has told it"


def test_a_mass_that_was_held_to_nothing_is_lifted_from_nothing():
    """-1 kg hang nowhere: the load that is picked is not a kilogram lighter for it."""
    state = known(mass=0.0, load=0.0, std_dev=1.0)
    state["moment"][0], state["bin_moment"][:] = -100.0, -0.1
    assert list(stand(state, torques(kilograms=2.0, samples=AT + 35)).values()) == [PayloadEvent.PICK]
    assert state["mass"] == pytest.approx(2.0, abs=0.3)
    assert state["drag"][0].tolist() == [0.0] * COUNT
