"""Loads by their normal equations, and whether they are others since some instant: each against matrices."""

import numpy as np
import pytest

from service.estimator.departure import COUNT
from service.estimator.payload import change
from service.estimator.payload.loads import fill_swing, locate
from service.estimator.payload.payload_state import (
    LOADS,
    OFFSET_STD,
    PRIOR_STD,
    SETTINGS,
    SMALLEST_CHANGE,
    STATE,
    WINDOW,
    start,
)
from tests.service.estimator.test_departure import PRIOR as DRIFT

OFFSETS = np.diag([0.0, OFFSET_STD**-2, OFFSET_STD**-2])  # what is known of a place beforehand
SHARED = np.array([0, 1, 0, 1, 2]), np.array([1, 1, 2, 2, 2])  # loads, in the order of what bins say of two of them


def believing(active, random, turns=False):
    """A state in which friction is known with some error."""
    states = np.zeros(1, STATE)
    start(states, DRIFT, turns)
    (state,) = states
    state["active"] = active
    np.testing.assert_allclose(state["information"], OFFSETS + np.diag([PRIOR_STD**-2, 0.0, 0.0]))
    root = 0.03 * random.standard_normal((COUNT, COUNT))
    state["departure"]["covariance"], state["departure"]["delta"] = root @ root.T, 0.1 * random.standard_normal(COUNT)
    return state


def fill(state, bins, load_of, random, clearly=1.0):
    """Bins of what samples say of `load_of` bin, and their sums. `state.head` ends on the newest."""
    active, delta = state["active"], state["departure"]["delta"]
    for n in range(bins):
        columns = clearly * random.standard_normal((6, active)) * [3.0, 20.0, 20.0][:active]
        slopes = random.standard_normal((6, COUNT))
        pulled = columns.T @ (columns @ load_of(n)[:active] + slopes @ delta + 0.3 * random.standard_normal(6))
        head = state["head"] = (state["head"] + 1) % WINDOW
        information, moment = (columns.T @ columns).astype("f4"), pulled.astype("f4")
        state["bin_information"][head], state["bin_moment"][head] = information[0, 0], moment[0]
        state["bin_drag"][head] = 0.0 if state["turns"] else columns[:, 0] @ slopes
        state["filling_drag"] = 0.0
        for load in range(0 if state["turns"] else 1, active):
            state["filling_drag"][load] = columns[:, load] @ slopes
        fill_swing(state, head)
        if active > 1:
            state["swing_information"][head], state["swing_moment"][head] = information[SHARED], moment[1:]
        for name, sums in zip(("information", "moment", "drag"), told_by(state, head, active), strict=True):
            state[name][(slice(active),) * (2 if name == "information" else 1)] += sums
    state["filled"] = bins


def swung(state):
    """(WINDOW, LOADS, COUNT), what friction does to loads in the bins of a robot with a fourth axis."""
    return state["swing_drag"] * state["swing_step"][..., None].astype(float)


def told_by(state, index, active):
    """Information, moment and drag of a bin."""
    information = np.full((active, active), state["bin_information"][index])
    moment, drag = np.full(active, state["bin_moment"][index]), np.zeros((active, COUNT))
    drag[:] = swung(state)[index][:active]
    if not state["turns"]:
        drag[0] = state["bin_drag"][index]
    if active > 1:
        information[SHARED] = information.T[SHARED] = state["swing_information"][index]
        moment[1:] = state["swing_moment"][index]
    return information, moment, drag


@pytest.mark.parametrize("active", [1, LOADS])
def test_loads_are_what_the_normal_equations_say(active):
    random = np.random.default_rng(3)
    state = believing(active, random)
    load = np.array([1.4, 0.05, -0.03])
    fill(state, 40, lambda n: load, random)
    expected = np.linalg.solve(
        state["information"][:active, :active], (state["moment"] - state["drag"] @ state["departure"]["delta"])[:active]
    )
    for _ in range(2):
        assert locate(state) == pytest.approx(expected[0], rel=1e-9)
    np.testing.assert_allclose(state["offset"][: active - 1], expected[1:], rtol=1e-9)
    np.testing.assert_allclose(
        state["inverse"][:active, :active], np.linalg.inv(state["information"][:active, :active]), rtol=1e-9
    )


def distances(state):
    """Squared distance of the loads since each onset from those before it, over its covariance, NaN where it is not
    looked for; the information since and before the last of them; and the change that may hide in the newest."""
    active, friction = state["active"], state["departure"]
    prior, before = OFFSETS[:active, :active], np.zeros(0)
    whole, index = state["information"][:active, :active], state["head"]
    since, pulled, dragged = prior.copy(), np.zeros(active), np.zeros((active, COUNT))
    result = np.full(state["filled"], np.nan)
    hidden = 0.0  # kg^2 of the mass alone, beyond noise and what the model lacks
    for n in range(state["filled"]):
        information, moment, drag = told_by(state, index, active)
        since, pulled, dragged = since + information, pulled + moment, dragged + drag
        index = index - 1 if index else WINDOW - 1
        if n + 1 < change.SHORTEST:
            continue
        before = whole - since + prior
        after, until = np.linalg.inv(since), np.linalg.inv(before)
        rest, dragged_before = state["moment"][:active] - pulled, state["drag"][:active] - dragged
        delta = friction["delta"]
        step = after @ (pulled - dragged @ delta) - until @ (rest - dragged_before @ delta)
        contrast = after @ dragged - until @ dragged_before
        spread = after + until + contrast @ friction["covariance"] @ contrast.T
        spread[0, 0] += 2 * state["bias"] * change.BIAS_SIGMAS**2 / change.CHANGE_THRESHOLD
        noise = after[0, 0] + until[0, 0]
        if active == 1 and step[0] ** 2 > change.HIDDEN_SIGMAS**2 * noise:
            beyond = step[0] ** 2 - change.HIDDEN_SIGMAS**2 * noise - change.BIAS_SIGMAS**2 * state["bias"]
            hidden = max(hidden, min(beyond, PRIOR_STD**2))
        large = abs(step[0]) >= SMALLEST_CHANGE or np.hypot(*[*step[1:], 0.0, 0.0][:2]) >= change.SMALLEST_OFFSET
        result[n] = step @ np.linalg.solve(spread, step) if large else 0.0
    return result, since, before, hidden


@pytest.mark.parametrize(
    ("load", "other", "bias", "onset", "told"),
    [
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, 47, {1, LOADS}),
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 47, {1, LOADS}),
        ((2.0, 0.0, 0.0), (1.6, 0.0, 0.0), 1e-3, 47, {1, LOADS}),
        ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), 0.0, change.SHORTEST, {1, LOADS}),
        ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), 0.0, change.SHORTEST - 1, {1, LOADS}),
        ((1.0, 0.02, 0.0), (1.0, 0.02, 0.1), 0.0, 47, {LOADS}),
        ((1.0, 0.0, 0.0), (1.11, 0.003, 0.0), 0.0, 47, set()),
        ((1.0, 0.0, 0.0), (1.3, 0.0, 0.0), 0.02, 47, set()),
    ],
    ids=["pick", "release", "part of it", "just now", "too soon", "another place", "too little", "of a bad model"],
)
@pytest.mark.parametrize("turns", [False, True], ids=["three axes", "a fourth axis"])
@pytest.mark.parametrize("active", [1, LOADS])
def test_an_onset_is_where_the_loads_differ_most_from_those_before(active, turns, load, other, bias, onset, told):
    """And from there on the estimate is that of the samples since."""
    random = np.random.default_rng(5)
    state = believing(active, random, turns)
    state["bias"], state["inflation"], state["head"] = bias, 1.3, -100 % WINDOW
    for name in ("since_drag", "since_moment", "since_information", "before_moment", "before_information", "hidden"):
        state[name] = 7.0  # left by the sample before
    clearly = 1.0 if told else 4.0  # no load, however sure
    fill(state, 120, lambda n: np.array(load if n < 120 - onset else other), random, clearly)
    state["filled"] = 100  # what is older has gone into the sums, and is not asked for
    expected, since, since_not, hidden = distances(state)
    best = int(np.nanargmax(expected)) + 1
    changes = np.nanmax(expected) > change.CHANGE_THRESHOLD
    assert changes == (active in told)
    kept = [(state["head"] - n) % WINDOW for n in range(best)]
    before = {name: state[name].copy() for name in ("information", "moment", "drag", "filled")}
    assert change.find_change(np.zeros((), SETTINGS), state) == (best if changes else 0)
    assert state["hidden"] == (0.0 if changes else pytest.approx(hidden, rel=1e-6, abs=1e-12))
    np.testing.assert_allclose(state["since_information"][:active, :active], since, rtol=1e-9)
    np.testing.assert_allclose(state["before_information"][:active, :active], since_not, rtol=1e-9)
    if not changes:
        assert all((state[name] == kept_).all() for name, kept_ in before.items())
        assert change._step_distance(state, 0.0) == pytest.approx(expected[-1], rel=1e-6)
        return
    assert abs(best - onset) <= 2
    information, moment, drag = (sum(sums) for sums in zip(*(told_by(state, n, active) for n in kept), strict=True))
    information = OFFSETS[:active, :active] + information
    np.testing.assert_allclose(state["information"][:active, :active], information, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state["moment"][:active], moment, atol=1e-9)
    np.testing.assert_allclose(state["drag"][:active], drag, atol=1e-9)
    assert state["filled"] == best
    assert state["raw_information"] == pytest.approx(1.3 * state["information"][0, 0])
