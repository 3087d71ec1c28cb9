"""One sample into the payload estimate, against sums by matrices."""

from functools import partial

import numpy as np
import pytest

from schemas.messages import Gripper
from service.estimator import slow
from service.estimator.departure import COUNT, OWN, PARTS
from service.estimator.payload import payload_step
from service.estimator.payload.loads import pair, weigh_whole
from service.estimator.payload.payload_state import (
    FINEST,
    LOADS,
    OFFSET_STD,
    PRIOR_STD,
    STATE,
    sample_variance,
    settings,
    start,
)
from tests.service.estimator.test_change import swung
from tests.service.estimator.test_departure import PRIOR as DRIFT
from tests.service.estimator.test_departure import slopes_of

PERIOD = 1e-3
SETTINGS = settings(PERIOD, DRIFT, 6.0, np.zeros(3), np.ones(3))[()]
POOR = settings(PERIOD, DRIFT, 6.0, np.full(3, 0.6**0.5), np.ones(3))[()]  # 1.1 kg, as events see it
PRIOR = np.diag([PRIOR_STD**-2, OFFSET_STD**-2, OFFSET_STD**-2])


def fresh(**fields):
    states = np.zeros(1, STATE)
    start(states, DRIFT)
    (state,) = states
    for name, value in fields.items():
        state[name] = value
    return state


def rest(state, times=1, model=SETTINGS):
    """Samples that say nothing."""
    for _ in range(times):
        state["weight"], state["column"], state["residual"] = 0.0, 0.0, 0.0
        payload_step.payload_kernel(model, state)


@pytest.mark.parametrize(
    ("period", "bins", "block", "worth"), [(1e-3, 2, 20, 1 / 3), (2.5e-4, 8, 80, 1 / 12), (5e-3, 1, 4, 1.0)]
)
def test_times_become_samples(period, bins, block, worth):
    """2 and 20 ms, what is forgotten a sample or a block, and the share of a sample that is news."""
    found = settings(period, DRIFT, 5.0, np.array([0.1, 0.2, 0.4]), np.array([0.01, 0.08, 0.04]))
    assert (found["bin_size"], found["block_size"]) == (bins, block)
    forgotten = {"forgetting": 3.0, "remember": 30.0, "lighten": 0.05, "leave": 1.0}
    assert [-np.log(found[name]) for name in forgotten] == pytest.approx([period / t for t in forgotten.values()])
    assert -np.log(found["departure_forgetting"]) == pytest.approx(block * period / 20.0)
    assert found["information_weight"] == pytest.approx(worth)
    assert found["model_error"] == pytest.approx(block * worth * (1.0 + 0.5 + 4.0) / 3)
    assert (found["period"], found["max_payload"]) == (period, 5.0)
    np.testing.assert_array_equal(found["prior"], DRIFT)


def test_what_a_model_left_counts_for_as_long_as_it_lasts_where_it_stands_out():
    """Five times as long as noise; 0.4 beside 0.3 N m shows to 0.64."""
    found = sample_variance(np.array([0.3, 0.0, 0.2]), np.array([0.4, 0.5, 0.0]))
    assert found == pytest.approx([0.09 + 0.64 * 0.16 * 5, 0.25 * 5, 0.04])


@pytest.mark.parametrize("turns", [0, 1], ids=["three axes", "a fourth axis"])
@pytest.mark.parametrize("active", [1, LOADS])
def test_every_sample_adds_what_it_says_and_the_past_fades(active, turns):
    """Seven of them, two a bin, in the metric of noise that scatters 1.7 times as much as it should, 2.9 where a joint
    creeps."""
    random, state = np.random.default_rng(1), fresh(inflation=1.7, breakaway=2.9, creeps=[0, 1, 0], turns=turns)
    information, moment, drag, raw = PRIOR[:active, :active], np.zeros(active), np.zeros((active, COUNT)), PRIOR[0, 0]
    bins = np.zeros((4, active, active + 1 + COUNT))
    fade = np.exp(-PERIOD / 3.0)
    for n in range(7):
        column = random.standard_normal((3, active)) * [3.0, 20.0, 20.0][:active]
        state["shape"] = random.standard_normal((3, PARTS))
        slopes = slopes_of(state["shape"])
        weight = random.uniform(0.2, 2.0, 3)
        residual = column @ [0.5, 0.02, 0.01][:active] + 0.01 * random.standard_normal(3)
        state["column"][:, :active], state["residual"], state["weight"] = column, residual, weight
        payload_step.payload_kernel(SETTINGS, state)
        worth = np.diag(weight) * PERIOD / 0.003  # noise is alike for 3 ms
        raw = PRIOR[0, 0] + fade * (raw - PRIOR[0, 0]) + column[:, 0] @ worth @ column[:, 0]
        worth = worth / [1.7, 2.9, 1.7]
        gained, pulled, dragged = column.T @ worth @ column, column.T @ worth @ residual, column.T @ worth @ slopes
        information = PRIOR[:active, :active] * (1 - fade) + fade * information + gained
        moment, drag = fade * moment + pulled, fade * drag + dragged
        bins[n // 2] += np.hstack([gained, pulled[:, None], dragged])
    assert (state["head"], state["filled"], state["in_bin"], state["active"]) == (3, 4, 1, active)
    assert state["inflation"] == 1.7
    np.testing.assert_allclose(state["information"][:active, :active], information)
    np.testing.assert_allclose(state["moment"][:active], moment)
    np.testing.assert_allclose(state["drag"][:active], drag)
    np.testing.assert_allclose(state["raw_information"], raw)
    assert state["untold"] == pytest.approx(0.02 - 7 * PERIOD)
    assert state["turning"] == (15_000 if active > 1 else 0), "samples of 5 times 3 s"
    np.testing.assert_allclose(state["bin_information"][:4], bins[:, 0, 0])
    np.testing.assert_allclose(state["bin_moment"][:4], bins[:, 0, active])
    nearly, drag = partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-5), bins[:, :, active + 1 :]
    swings = slice(0 if turns else 1, active)
    finest = np.abs(drag[:3, swings]).max(axis=2, keepdims=True, initial=0.0) / FINEST
    assert (np.abs(swung(state)[:3, swings] - drag[:3, swings]) <= 0.51 * finest).all(), "to the nearest step"
    np.testing.assert_allclose(state["filling_drag"][swings], drag[3, swings])
    if not turns:
        np.testing.assert_allclose(state["bin_drag"][:4], drag[:, 0])
    assert state["bin_drag" if turns else "swing_drag"][:, :1].any() == 0
    if active == 1:
        assert not any(state[name].any() for name in ("swing_information", "swing_moment"))
        return
    nearly(state["swing_moment"][:4], bins[:, 1:, active])
    for n, (p, q) in enumerate([(0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]):
        assert pair(p, q) == n
        nearly(state["swing_information"][:4, n], bins[:, p, q])


@pytest.mark.parametrize("turns", [0, 1], ids=["three axes", "a fourth axis"])
@pytest.mark.parametrize(
    ("bias", "fields", "keep"),
    [
        (0.3, {}, 4.0 / (0.3 * 50.25)),
        (0.05, {}, 1.0),  # 50 kg^-2 is less than four times as sure
        (0.3, {"mass": 5.2}, 1.0),  # 0.55 kg: sure enough of a mass like that
        (0.3, {"active": LOADS, "turning": 9}, 1.0),
    ],
)
def test_where_what_the_model_lacks_forbids_trust_noise_is_averaged_no_longer(bias, fields, keep, turns):
    """Newer samples weigh as much as they tell: the past fades, in the window of onsets too."""
    state = fresh(bias=bias, moment=10.0, drag=2.0, raw_information=30.25, told=100.0, turns=turns, **fields)
    state["information"][0, 0], state["filled"] = 50.25, 2
    kept_in = ("bin_information", "bin_moment", "swing_drag" if turns else "bin_drag", "bin_told")
    for name in (*kept_in, "swing_step"):
        state[name][[0, -1]] = 1.0
    state["filling_drag"] = 1.0
    state["in_bin"] = 1
    rest(state)
    fade = np.exp(-PERIOD / 3.0)
    kept = (keep if keep == 1.0 else 4.0 / (bias * (0.25 + 50.0 * fade))) * fade
    assert state["information"][0, 0] == pytest.approx(0.25 + 50.0 * kept)
    assert state["raw_information"] == pytest.approx(0.25 + 30.0 * kept)
    assert (state["moment"][0], state["drag"][0, 0], state["told"]) == pytest.approx((10 * kept, 2 * kept, 100 * kept))
    for name in kept_in:
        found = swung(state) if name == "swing_drag" else state[name]
        assert found.reshape(150, -1)[[0, -1], 0] == pytest.approx(kept / fade)


def tell(state, times):
    """Samples that say next to nothing."""
    for _ in range(times):
        state["weight"], state["column"], state["residual"] = 1e-9, 0.0, 0.0
        state["column"][:, : state["active"]] = 1.0
        payload_step.payload_kernel(SETTINGS, state)


@pytest.mark.parametrize(("turns", "active"), [(0, 1), (0, LOADS), (1, 1), (1, LOADS)])
def test_a_bin_that_comes_round_again_starts_at_nothing(turns, active):
    kept = ["bin_information", "bin_moment", "swing_drag" if turns else "bin_drag"]
    kept += ["swing_information", "swing_moment", "swing_drag"] if active > 1 else []
    ones = dict.fromkeys([*kept, "swing_step", "filling_drag"], 1.0)
    state = fresh(head=148, filled=149, turns=turns, active=active, turning=1000, **ones)
    tell(state, 2)
    assert (state["head"], state["filled"], state["in_bin"]) == (149, 150, 0)
    tell(state, 2)
    assert (state["head"], state["filled"]) == (0, 150)
    for name in kept:
        found = swung(state) if name == "swing_drag" else state[name]
        empty = (np.abs(found.reshape(150, -1)) < 1e-6).all(axis=1)
        np.testing.assert_array_equal(np.flatnonzero(empty), [0, 149])


@pytest.mark.parametrize("active", [1, LOADS])
def test_a_change_that_may_have_happened_is_doubted_through_a_rest(active):
    """A minute of it: nothing has told that it did not."""
    state = fresh(hidden=0.3**2, filled=40, head=40, active=active, turning=100_000)
    rest(state, 60_000)
    if active == 1:
        assert (state["hidden"], state["filled"], state["head"]) == (0.3**2, 40, 40)
        assert state["std_dev"] > 0.3
    else:
        assert state["filled"] == 150, "where blocks are parted by the time that has passed"
    payload_step.weigh_anew_kernel(state)
    assert state["hidden"] == 0.0


def test_a_move_there_and_back_is_averaged_where_each_way_is_off_by_a_load():
    """4.2 kg on the way up, 1.8 on the way down."""
    state, column = fresh(untold=0.0), np.array([-0.4, -3.0, -0.9])

    def weigh(mass, samples=600):
        for _ in range(samples):
            state["column"][:, 0], state["residual"], state["weight"] = column, mass * column, 0.015  # 1/kg^2 a block
            state["judged"] = state["leverage"] = 1.0
            payload_step.payload_kernel(POOR, state)

    weigh(4.2)
    assert state["mass"] == pytest.approx(4.2, abs=0.05)
    weigh(1.8)
    assert state["mass"] == pytest.approx(2.8, abs=0.1), "a little nearer to what is newer"
    assert state["moment"][0] / state["information"][0, 0] == pytest.approx(1.8, abs=0.2), "the newest, for events"
    assert state["std_dev"] ** 2 > state["bias"] / 0.55**2, "in one place and direction, all that the model lacks"
    weigh(4.2)
    weigh(-1.0, 100)
    assert state["mass"] < 0.1, "beyond three standard deviations it is another load, event or none"
    assert weigh_whole(state) < 1.0, "and the average begins with it"
    payload_step.weigh_anew_kernel(state)
    weigh(2.0, 40)
    assert state["mass"] == pytest.approx(2.0, abs=0.15), "nothing of what was before"


def test_learnt_friction_is_taken_off_the_average_too():
    state = fresh(whole_information=50.0, whole_moment=100.0, whole_drag=3.0)
    state["departure"]["delta"] = np.arange(COUNT)
    assert weigh_whole(state) == pytest.approx((100.0 - 3.0 * np.arange(COUNT).sum()) / 50.0)


@pytest.mark.parametrize(("model", "active"), [(POOR, 1), (POOR, LOADS), (SETTINGS, 1)])
def test_a_rest_may_have_changed_the_load_where_a_model_that_lacks_as_much_would_not_see_it(model, active):
    """As much when it was identified, that is: both lack it now."""
    state = fresh(excess=4.0, judged=1.0, leverage=1.0, untold=0.0, active=active, turning=100_000, mass=2.0, load=2.0)
    state["information"][0, 0], state["moment"][0], state["raw_information"] = 3.0, 6.0, 3.0
    rest(state, 119, model)
    assert state["information"][0, 0] > 2.5
    rest(state, 3, model)
    if model is POOR and active == 1:
        assert state["information"][0, 0] == PRIOR[0, 0]
        assert state["mass"] == pytest.approx(2.0, abs=0.3)
        assert state["std_dev"] > 2.0
    else:
        assert state["information"][0, 0] > 2.5


def test_what_a_rest_hides_takes_motion_to_be_known_again():
    state = fresh(untold=0.0)
    rest(state, 119)
    assert state["untold"] == 0.0
    rest(state, 2)
    assert state["untold"] == 0.15
    known = fresh(untold=0.0, gripper=Gripper.CLOSED)
    rest(known, 200)
    assert (known["untold"], known["still"]) == (0.0, 0.0), "a gripper that says so"
    for _ in range(2):
        state["weight"], state["column"][:, 0] = 1.0, 1.0
        payload_step.payload_kernel(SETTINGS, state)
    assert (state["untold"], state["still"]) == (pytest.approx(0.15 - 2 * PERIOD), 0.0)


@pytest.mark.parametrize(
    ("before", "now", "anew"),
    [
        (Gripper.OPEN, Gripper.CLOSED, True),
        (Gripper.CLOSED, Gripper.OPEN, True),
        (Gripper.UNKNOWN, Gripper.CLOSED, False),
        (Gripper.CLOSED, Gripper.UNKNOWN, False),
        (Gripper.CLOSED, Gripper.CLOSED, False),
    ],
)
def test_what_hangs_on_a_gripper_that_worked_is_another(before, now, anew):
    kept = ("information", "moment", "drag", "bin_information", "bin_moment", "bin_drag")
    state = fresh(gripper_before=before, gripper=now, filled=80, untold=0.0, raw_information=900.0)
    for name in kept:
        state[name] += 7.0
    state["slow"]["begun"], state["slow"]["level_variance"], state["slow"]["variance"] = 1, 1.0, 0.1
    rest(state)
    assert state["gripper_before"] == now
    assert (state["filled"] == 1) == anew
    assert state["slow"]["variance"] == (PRIOR_STD**2 if anew else 0.1)
    if anew:
        np.testing.assert_allclose(state["information"], PRIOR)
        assert not any(state[name].any() for name in kept[1:3])
        assert not any(state[name][state["head"]].any() for name in kept[3:])
        assert (state["in_bin"], state["untold"]) == (1, 0.02)
        assert state["raw_information"] == pytest.approx(PRIOR[0, 0])
    else:
        assert (state["moment"] > 6.0).all()
        assert (state["bin_drag"] == 7.0).all()


def test_what_nobody_saw_the_gripper_do_is_not_known():
    state = fresh(mass=2.0, std_dev=0.1, trusted=1, usable=2.0, moment=9.0)
    payload_step.unseen_kernel(state)
    assert [state[name] for name in ("mass", "std_dev", "trusted", "usable")] == [0.0, PRIOR_STD, 0, 0.0]
    assert not state["moment"].any()


def test_a_place_on_the_axis_is_forgotten_some_time_after_it_turned():
    state = fresh(active=LOADS, turning=2, offset=0.1)
    for name in ("moment", "drag"):
        state[name] = 3.0
    state["information"] = np.diag([50.0, 60.0, 70.0]) + 1.0
    rest(state)
    assert (state["active"], state["turning"]) == (LOADS, 1)
    assert (state["moment"] > 2.9).all()
    rest(state)
    assert state["active"] == 1
    expected = PRIOR.copy()
    expected[0, 0] = PRIOR[0, 0] + (51.0 - PRIOR[0, 0]) * np.exp(-2 * PERIOD / 3.0)
    np.testing.assert_allclose(state["information"], expected)
    for left in (state["moment"][1:], state["offset"], state["drag"][1:]):
        assert not left.any()
    assert state["moment"][0] == pytest.approx(3.0 * np.exp(-2 * PERIOD / 3.0))
    rest(state)
    assert state["turning"] == 0


def test_slow_motion_hands_on_what_gravity_says():
    """The sample as the slow branch takes it, its friction taken off, and all that is known replaced by its answer."""
    random, state = np.random.default_rng(2), fresh(inflation=1.5, mass=1.0, std_dev=0.4, drag=2.0, in_bin=0)
    delta = 0.2 * random.standard_normal(COUNT)
    state["departure"]["delta"] = delta
    expected, said = state["slow"].copy(), False
    slowly = 2.5e-3  # s, the fewer samples it takes
    rule = settings(slowly, DRIFT, 6.0, np.zeros(3), np.ones(3))[()]
    for _ in range(140):
        phi, shape, weight = (
            random.uniform(1.0, 3.0, 3),
            random.choice([-1.0, 1.0], (3, PARTS)),
            random.uniform(1.0, 2.0, 3),
        )
        residual = 1.2 * phi + 0.1 * random.standard_normal(3)
        mass, variance = state["mass"], state["std_dev"] ** 2
        state["column"], state["weight"], state["residual"], state["shape"] = 0.0, 0.0, residual, shape
        state["column"][:, 0] = 0.9 * phi  # with an acceleration in it, that slow motion does not look at
        state["slow"]["now"]["phi"], state["slow"]["now"]["weight"] = phi, weight
        payload_step.payload_kernel(rule, state)
        now = expected["now"]
        now["phi"], now["way"], now["drift"], now["weight"] = phi, shape[:, 0], DRIFT[:-1:OWN], weight * slowly / 0.003
        now["residual"] = residual - slopes_of(shape) @ delta
        now["mass"], now["variance"] = mass, variance
        said = slow.slow_kernel(expected, slowly, PRIOR_STD**2)
    assert said
    assert state["information"][0, 0] == pytest.approx(1.0 / expected["variance"])
    assert state["moment"][0] == pytest.approx(expected["mass"] / expected["variance"])
    assert state["raw_information"] == pytest.approx(1.5 / expected["variance"])
    assert not state["drag"][0].any()
    assert state["untold"] == 0.0, "it is told"
    assert state["mass"] == pytest.approx(1.2, abs=0.2)
    state["weight"] = 1.0
    payload_step.payload_kernel(rule, state)
    assert state["slow"]["lasted"] == 0.0, "something fast ends it"


@pytest.mark.parametrize("active", [1, LOADS])
def test_behind_a_change_a_mass_and_the_models_error_are_told_anew(active):
    random, state = np.random.default_rng(4), fresh(untold=0.15, fresh=9, block=10, active=active, turning=1000)
    state["departure"]["covariance"] = 0.0
    for n in range(60):
        state["column"][:, :active] = random.standard_normal((3, active)) * [3.0, 20.0, 20.0][:active]
        state["residual"] = state["column"][:, 0] * 2.0 * (n >= 31) + 0.05 * random.standard_normal(3)
        state["weight"], state["in_block"] = 100.0, 3
        before = state["filled"]
        payload_step.payload_kernel(SETTINGS, state)
        if state["filled"] < before:
            break
        state["untold"] = 0.15
    since = 2 * (state["filled"] - 1)
    assert since == 6, "samples; no change is looked for in fewer than three bins"
    assert state["untold"] == pytest.approx(0.02 - since * PERIOD)
    assert state["fresh"] == (0 if active > 1 else 9)


@pytest.mark.parametrize("load", [1, 2])
def test_an_axis_turns_whichever_way_its_load_pulls(load):
    state = fresh()
    state["column"][2, load], state["weight"] = 0.1, 1.0
    payload_step.payload_kernel(SETTINGS, state)
    assert (state["active"], state["turning"]) == (LOADS, 15_000)
