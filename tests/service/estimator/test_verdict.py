"""What is said of a mass, rule by rule, each just inside and just outside of it."""

import numpy as np
import pytest

from schemas.messages import Gripper, PayloadEvent
from service.estimator.departure import COUNT
from service.estimator.payload import verdict
from service.estimator.payload.payload_state import COLOUR, LOADS, STATE, settings, start
from tests.service.estimator.test_departure import PRIOR as DRIFT

PERIOD = 1e-3
SETTINGS = settings(PERIOD, DRIFT, 6.0, 0.3 * np.ones(3), np.ones(3))[()]
NONE, PICK, RELEASE = PayloadEvent.NONE, PayloadEvent.PICK, PayloadEvent.RELEASE
TORQUE_SHARE = 0.035


def believing(mass, std_dev, **fields):
    """A state that has known `mass` for long; std_dev: kg, by its information."""
    states = np.zeros(1, STATE)
    start(states, DRIFT)
    (state,) = states
    state["information"][0, 0], state["moment"][0] = std_dev**-2, mass * std_dev**-2
    state["load"], state["untold"], state["quiet"] = mass, 0.0, 100_000
    state["last_event"], state["ground"] = PICK, 0.0
    for name, value in fields.items():
        state[name] = value
    state["raw_information"] = std_dev**-2 * state["inflation"]
    return state


def told(state, times=1):
    for _ in range(times - 1):
        verdict.conclude(SETTINGS, state)
    return verdict.conclude(SETTINGS, state)


@pytest.mark.parametrize("active", [1, LOADS])
@pytest.mark.parametrize("worse", [1.0, 2.0], ids=["as ever", "no longer fits"])
@pytest.mark.parametrize("excess", [0.9, 0.0])
@pytest.mark.parametrize(
    ("noise", "fields"),
    [
        (0.5, {"measured": 0.5}),
        (0.75, {"measured": 0.5, "commanded": 1}),
        (1.25, {"measured": 0.9, "commanded": 1}),
    ],
    ids=["reported", "commanded", "commanded, no more than what trust reckons with"],
)
def test_the_error_of_a_mass_is_all_that_is_not_known_of_it(active, worse, excess, noise, fields):
    random, state = np.random.default_rng(1), believing(2.0, 0.02, hidden=0.03**2, inflation=1.25, **fields)
    columns = 3.0 * random.standard_normal((60, active))
    information, drag = columns.T @ columns, columns.T @ random.standard_normal((60, COUNT))
    root = 0.1 * DRIFT[:, None] * random.standard_normal((COUNT, COUNT))
    state["active"], state["departure"]["covariance"], state["departure"]["delta"] = active, root @ root.T, root[0]
    state["information"][:active, :active], state["drag"][:active] = information, drag
    state["moment"][:active] = information @ np.array([2.0, 0.03, -0.02])[:active] + drag @ root[0]
    state["raw_information"] = information[0, 0] * 1.25 / (worse if worse > 1.0 else 0.3)
    state["excess"], state["judged"], state["leverage"] = excess, 0.6, 400.0
    assert told(state) == NONE
    inverse = np.linalg.inv(information)
    bias = verdict.BIAS_SHARE**2 * (SETTINGS["model_error"] + max(excess / 0.6, 0.25 / COLOUR)) * 0.6 / 400.0
    does = inverse[0] @ drag
    doubt = does @ root
    assert state["mass"] == pytest.approx(2.0)
    assert state["bias"] == pytest.approx(bias)
    square = worse * inverse[0, 0] + doubt @ doubt + bias + 0.03**2 + (TORQUE_SHARE * 2.0) ** 2
    assert state["std_dev"] ** 2 == pytest.approx(square)
    unlearnt = np.sum(np.square(root @ root.T @ does / DRIFT))
    assert 0.02 * doubt @ doubt < unlearnt < 0.98 * doubt @ doubt
    scattered = worse * inverse[0, 0] * noise / 1.25 + unlearnt + 0.03**2
    assert state["random_std_dev"] ** 2 == pytest.approx(scattered), "by the noise that is measured"
    assert state["common_std_dev"] == pytest.approx(TORQUE_SHARE * 2.0)
    state["leverage"] = 0.0
    told(state)
    assert state["std_dev"] ** 2 == pytest.approx(square - bias)


@pytest.mark.parametrize(
    ("samples", "a_block", "share", "scatter", "lacking"),
    [
        (1000, 2499.75 / 50, verdict.BIAS_SHARE**2, 0.0, SETTINGS["model_error"] + 0.9 / 0.6),
        (1000, 2499.75 / 50, verdict.BIAS_SHARE**2, 3.0, 3.0 / 0.6 - 0.4),  # what is beyond white noise
        (200, 2499.75 / 10, 0.5, 0.0, SETTINGS["model_error"] + 0.9 / 0.6),
        (10, 400.0 / 0.6, verdict.BIAS_SHARE**2, 0.0, SETTINGS["model_error"] + 0.9 / 0.6),
    ],
    ids=["gentle", "and scattering", "short", "as ever"],
)
def test_what_the_model_lacks_counts_for_more_in_a_gentle_move(samples, a_block, share, scatter, lacking):
    """Of 0.02 kg known by so many samples, blocks of 20, beside the 400/kg^2 of the moves before."""
    state = believing(2.0, 0.02, excess=0.9, judged=0.6, leverage=400.0, told=samples, scatter=scatter)
    told(state)
    events = verdict.BIAS_SHARE**2 * (SETTINGS["model_error"] + 0.9 / 0.6) * 0.6 / 400.0
    assert state["bias"] == pytest.approx(events), "what events stand out of is that of all moves"
    assert state["std_dev"] ** 2 == pytest.approx(0.02**2 + share * lacking / a_block + (TORQUE_SHARE * 2.0) ** 2)


@pytest.mark.parametrize(
    ("mass", "std_dev", "fields", "trusted"),
    [
        (2.0, 0.229, {}, True), (2.0, 0.231, {}, False),  # a tenth of it and 30 g
        (0.05, 0.034, {}, True), (0.05, 0.036, {}, False),
        (2.0, 0.2, {"hidden": 0.1**2}, True), (2.0, 0.2, {"hidden": 0.12**2}, False),
        (2.0, 0.02, {"inflation": 11.9}, True), (2.0, 0.02, {"inflation": 12.1}, False),
        (2.0, 0.02, {"scatter": 0.74, "judged": 0.5, "inflation": 3.1}, True),
        (2.0, 0.02, {"scatter": 0.76, "judged": 0.5, "inflation": 3.1}, False),
        (2.0, 0.02, {"scatter": 0.76, "judged": 0.5, "inflation": 2.9}, True),
        (0.0, 0.02, {"scatter": 0.76, "judged": 0.5, "inflation": 3.1, "gripper": Gripper.OPEN}, True),
        (2.0, 0.02, {"untold": 0.001}, False),
        (2.0, 0.02, {"burst": 3.0 + 4e-3}, True), (2.0, 0.02, {"burst": 3.0 + 6e-3}, False),  # 5 a second leak away
        (6.08, 0.02, {}, True), (6.1, 0.02, {}, False),  # two standard deviations and 50 g above what is carried
        (-0.08, 0.02, {"load": 1.0}, True), (-0.1, 0.02, {"load": 1.0}, False),
        (2.0, 0.02, {"gripper": Gripper.CLOSED}, True), (2.0, 0.02, {"gripper": Gripper.CLOSED, "untold": 0.1}, False),
        (0.2, 0.02, {"gripper": Gripper.OPEN, "untold": 0.1, "hidden": 9.0}, True),
        (0.25, 0.02, {"gripper": Gripper.OPEN}, False),  # five standard deviations and 120 g
    ],
)  # fmt: skip
def test_a_mass_is_trusted_where_it_is_sure_and_can_be(mass, std_dev, fields, trusted):
    state = believing(mass, std_dev, **fields)
    told(state)
    assert state["trusted"] == trusted


@pytest.mark.parametrize(
    ("mass", "fields", "held", "std_dev"),
    [
        (6.5, {}, 6.0, 0.5),
        (-0.3, {"load": 1.0}, 0.0, 0.3),
        (2.0, {"burst": 4.0}, 2.0, 0.02),
        (0.25, {"gripper": Gripper.OPEN}, 0.25, 0.25),
        (0.1, {"gripper": Gripper.OPEN}, 0.0, 0.0),
    ],
)
def test_what_cannot_be_is_held_to_what_can_and_off_by_the_rest(mass, fields, held, std_dev):
    state = believing(mass, 0.02, **fields)
    told(state)
    assert state["mass"] == pytest.approx(held)
    assert state["std_dev"] == pytest.approx(np.hypot(std_dev, TORQUE_SHARE * held))


@pytest.mark.parametrize(
    ("mass", "noise", "lacks", "event"),
    [
        (3.3, 0.3, 1.0, PICK), (3.1, 0.3, 1.0, NONE),  # four standard deviations: 3.22 kg
        (4.5, 0.6, 1.0, NONE),  # mostly noise
        (-3.3, 0.3, 1.0, RELEASE),
    ],
)  # fmt: skip
def test_a_step_that_stands_out_of_what_the_model_lacks_is_an_event(mass, noise, lacks, event):
    """0.55 kg by what was left over where the robot was identified: never trusted, and told all the same."""
    left = SETTINGS["model_error"]
    leverage = verdict.BIAS_SHARE**2 * (1.0 + lacks) * left / 0.55**2
    load = 0.5 if mass > 0 else 0.5 - mass
    state = believing(load + mass, noise, excess=lacks * left, judged=1.0, leverage=leverage)
    state["load"], state["load_variance"] = load, 0.55**2 - 0.05
    assert told(state) == event
    assert not state["trusted"]


@pytest.mark.parametrize(
    ("step", "bias", "fields", "event", "believed"),
    [
        (3.3, 0.55, {}, PICK, True), (-3.3, 0.55, {}, RELEASE, True),
        (3.0, 0.55, {}, NONE, False),  # four standard deviations: 3.2 kg
        (3.3, 0.55, {"filled": 145}, PICK, True),  # so much motion since its onset
        (3.3, 0.55, {"filled": 146}, NONE, True), (-3.3, 0.55, {"filled": 146}, NONE, True),
        (-3.3, 0.55, {"filled": 146, "gripper": Gripper.OPEN}, RELEASE, True),  # which is heard of
        (3.3, 0.55, {"untold": 0.002}, NONE, False),  # one odd stretch of torque
        (-3.3, 0.55, {"quiet": 148}, NONE, False), (-3.3, 0.55, {"quiet": 150}, RELEASE, True),
        (3.3, 0.55, {"filled": 146, "untold": 0.002}, NONE, False),
        (2.0, 0.119, {"load_variance": 0.0}, NONE, False), (2.0, 0.121, {"load_variance": 0.0}, PICK, True),
        (2.0, 0.119, {"load_variance": 0.0, "filled": 146}, NONE, False),
        (3.3, 0.119, {"load_variance": 0.0, "filled": 146}, PICK, True),  # which is sure
    ],
)  # fmt: skip
def test_where_the_model_lacks_more_than_it_did_a_change_is_told_at_once_or_not_at_all(
    step, bias, fields, event, believed
):
    """0.3 kg of noise and what three times of what was left then makes of the mass."""
    left = SETTINGS["model_error"]
    leverage = verdict.BIAS_SHARE**2 * 4.0 * left / bias**2
    load = 0.5 if step > 0 else 0.5 - step
    state = believing(load + step, 0.3, excess=3.0 * left, judged=1.0, leverage=leverage)
    state["load"], state["load_variance"] = load, 0.55**2 - 0.05
    for name, value in fields.items():
        state[name] = value
    assert told(state) == event
    after = 0.0 if "gripper" in fields else load + step
    assert state["load"] == pytest.approx(after if believed else load)


@pytest.mark.parametrize(("mass", "noise", "refined"), [(2.4, 0.4, True), (2.9, 0.4, False), (2.4, 0.61, False)])
def test_a_load_that_is_known_better_than_at_its_event_is_told_anew(mass, noise, refined):
    state = believing(mass, noise, load=2.0, load_variance=0.6**2)
    assert told(state) == NONE
    assert state["load"] == pytest.approx(mass if refined else 2.0)
    assert state["load_variance"] == pytest.approx((noise if refined else 0.6) ** 2)


def fallen_short(wrong, samples):
    """Closed form of what is remembered: it nears `wrong` over 0.3 s and is forgotten over 30 s."""
    keep = np.exp(-PERIOD / 30.0) * (1.0 - PERIOD / 0.3)
    return PERIOD / 0.3 * wrong * (1.0 - keep**samples) / (1.0 - keep)


def test_a_mass_that_cannot_be_counts_against_all_that_come_after():
    open_ = believing(-0.2, 0.02, gripper=Gripper.OPEN)
    told(open_, 100)
    assert open_["shortfall"] == pytest.approx(fallen_short(0.2 - 0.04 - 0.02, 100))
    unknown = believing(-0.2, 0.02, load=1.0)
    told(unknown, 295)
    assert unknown["shortfall"] == 0.0, "a release is not seen at once"
    unknown["moment"][0] *= -1
    told(unknown)
    unknown["moment"][0] *= -1
    told(unknown, 295)
    assert unknown["shortfall"] == 0.0, "nothing that lasts"
    told(unknown, 105)
    assert unknown["shortfall"] == pytest.approx(fallen_short(0.14, 100), rel=0.02)
    later = believing(2.0, 0.02, shortfall=0.1)
    told(later, 200)
    assert later["std_dev"] ** 2 == pytest.approx(0.02**2 + (0.1 * np.exp(-0.2 / 30)) ** 2 + (TORQUE_SHARE * 2.0) ** 2)


@pytest.mark.parametrize(("std_dev", "counts"), [(0.09, True), (0.11, False)])
def test_a_mass_that_is_not_sure_shows_no_shortfall(std_dev, counts):
    state = believing(-0.5, std_dev, gripper=Gripper.OPEN)
    told(state, 5)
    assert (state["shortfall"] > 0.0) == counts


@pytest.mark.parametrize(
    ("mass", "fields", "std_dev"),
    [
        (0.11, {"load": 0.0}, (0.11 - 0.02) / 2.0),  # so that nothing is within two of them and 20 g
        (0.11, {"load": 0.0, "shortfall": 0.2}, np.hypot(0.01, 0.2)),
        (0.11, {"load": 0.13}, 0.01),
        (0.13, {"load": 0.0}, 0.01),
        (0.11, {"load": 0.0, "gripper": Gripper.CLOSED}, 0.01),
    ],
)
def test_where_nothing_can_hang_what_is_weighed_is_error(mass, fields, std_dev):
    state = believing(mass, 0.01, **fields)
    told(state)
    assert state["std_dev"] == pytest.approx(np.hypot(std_dev, TORQUE_SHARE * mass), rel=1e-4)


@pytest.mark.parametrize(
    ("load", "mass", "std_dev", "fields", "event"),
    [
        (0.0, 2.0, 0.05, {}, PICK), (2.0, 0.0, 0.02, {}, RELEASE),
        (0.0, 2.0, 0.19, {"inflation": 13.0}, PICK), (0.0, 2.0, 0.21, {"inflation": 13.0}, NONE),  # ten of them
        (2.0, 0.3, 0.16, {"inflation": 13.0}, RELEASE),
        (1.0, 1.13, 0.01, {}, PICK), (1.0, 1.11, 0.01, {}, NONE),
        (1.0, 0.87, 0.01, {}, RELEASE), (1.0, 0.89, 0.01, {}, NONE),
        # three of both
        (1.0, 1.41, 0.1, {"load_variance": 0.01}, NONE), (1.0, 1.44, 0.1, {"load_variance": 0.01}, PICK),
        # less than half of it, so soon, is the estimate settling
        (1.0, 0.6, 0.02, {"quiet": 148}, NONE), (1.0, 0.6, 0.02, {"quiet": 151}, RELEASE),
        (1.0, 0.49, 0.02, {"quiet": 148}, RELEASE),
        # another step the same way
        (1.0, 2.0, 0.02, {"quiet": 298}, NONE), (1.0, 2.0, 0.02, {"quiet": 301}, PICK),
        (1.0, 2.0, 0.02, {"quiet": 298, "sure_for": 0.099}, NONE),  # unless the mass was known meanwhile
        (1.0, 2.0, 0.02, {"quiet": 298, "sure_for": 0.101}, PICK),
        # no gripper lets go again so soon
        (2.0, 0.5, 0.02, {"quiet": 28}, NONE), (2.0, 0.5, 0.02, {"quiet": 31}, RELEASE),
        (2.0, 0.1, 0.01, {"quiet": 28}, RELEASE),
        (0.0, 1.5, 0.02, {"quiet": 28, "last_event": RELEASE, "load_before": 2.0}, NONE),
        (0.0, 1.93, 0.02, {"quiet": 28, "last_event": RELEASE, "load_before": 2.0}, PICK),
    ],
)  # fmt: skip
def test_a_change_of_load_is_an_event(load, mass, std_dev, fields, event):
    state = believing(mass, std_dev, load=load, untold=0.15, burst=1.0, **fields)
    quiet, before = state["quiet"], (state["last_event"], state["load_before"])
    sure = "inflation" not in fields
    assert told(state) == event
    assert state["load"] == pytest.approx(mass if event or sure else load)
    leaked = 1.0 - 5.0 * PERIOD
    if event:
        assert state["load_variance"] == pytest.approx(std_dev**2)
        assert (state["last_event"], state["load_before"], state["quiet"]) == (event, load, 0)
        assert (state["untold"], state["burst"]) == pytest.approx((0.02, leaked + 1.0)), "weighed anew"
    else:
        assert (state["last_event"], state["load_before"]) == before
        assert state["quiet"] == quiet + 1
        assert (state["untold"], state["burst"]) == pytest.approx((0.15, leaked))


@pytest.mark.parametrize(
    ("before", "inflation", "event"),
    [(1.0, 1.0, RELEASE), (0.0, 1.0, NONE), (1.0, 13.0, RELEASE), (0.0, 13.0, NONE)],
)
def test_what_friction_does_to_both_loads_is_no_doubt_of_the_step(before, inflation, event):
    """0.3 kg known to 0.2 kg are off 0.9 kg, known as badly; all but 20 g of it is the scale of the torque."""
    state = believing(0.3, 0.02, load=0.9, inflation=inflation)
    effect = np.zeros(COUNT)
    effect[3::4] = 0.2 / 0.03 / np.sqrt(3.0)  # kg, of each scale by one
    state["drag"][0], state["load_drag"] = effect / 0.02**2, before * effect
    assert told(state) == event
    assert state["std_dev"] == pytest.approx(0.2, rel=0.02)
    if event:
        np.testing.assert_allclose(state["load_drag"], effect)
        assert state["load_variance"] == pytest.approx(0.02**2)


@pytest.mark.parametrize(("quiet", "trusted", "load"), [(298, 0.0, 0.5), (298, 0.101, 1.0), (299, 0.0, 1.0)])
def test_the_rest_of_a_release_is_no_second_one(quiet, trusted, load):
    state = believing(0.5, 0.1, load=1.0, last_event=RELEASE, quiet=quiet, sure_for=trusted)
    assert told(state) == NONE
    assert state["load"] == pytest.approx(load)


LIGHTER, LEAVING = np.exp(-PERIOD / 0.05), np.exp(-PERIOD / 1.0)


@pytest.mark.parametrize(
    ("fields", "usable"),
    [
        ({}, 2.0),
        ({"hidden": 1.0}, 2.0 + LIGHTER),  # a change may hide: what is lighter leaves
        ({"hidden": 1.0, "usable": 1.0}, 1.0),
        ({"untold": 0.1}, LEAVING * (2.0 + LIGHTER)),
        ({"hidden": 1.0, "last_event": RELEASE, "quiet": 149}, 2.0),  # a step by nature
        ({"hidden": 1.0, "last_event": RELEASE, "quiet": 151}, 2.0 + LIGHTER),
        ({"hidden": 1.0, "quiet": 149}, 2.0 + LIGHTER),
    ],
)
def test_what_the_feed_forward_torque_reckons_with(fields, usable):
    state = believing(2.0, 0.02, **({"usable": 3.0} | fields))
    told(state)
    assert state["usable"] == pytest.approx(usable)


@pytest.mark.parametrize(
    ("fields", "ground", "trusted"),
    [
        ({"last_event": RELEASE}, 2.0, False),
        ({}, 0.0, True),  # after a pick
        ({"last_event": RELEASE, "grounded": 1, "ground": 0.1}, 0.1, True),  # less than a load
        ({"last_event": RELEASE, "grounded": 1, "ground": 1.0}, 1.0, False),
        ({"last_event": RELEASE, "grounded": 1, "ground": 2.5}, 2.0, False),
        ({"grounded": 1, "ground": 0.2}, 0.2, True),
        ({"last_event": RELEASE, "hidden": 1.0}, 0.0, False),  # what is not sure is no ground
        ({"gripper": Gripper.OPEN, "grounded": 1, "ground": 1.0}, 1.0, False),  # which says what the mass is
    ],
)
def test_the_least_that_ever_hung_there_may_be_a_tool(fields, ground, trusted):
    state = believing(2.0, 0.02, **fields)
    told(state)
    assert state["ground"] == pytest.approx(ground, rel=1e-4)
    assert bool(state["trusted"]) == trusted
    if "gripper" not in fields and "hidden" not in fields:
        known = verdict.TOOL_SHARE * ground + TORQUE_SHARE * 2.0
        assert state["std_dev"] == pytest.approx(np.hypot(0.02, known), rel=1e-4)
    if "hidden" not in fields and "gripper" not in fields:
        assert state["usable"] == pytest.approx(2.0), "the feed-forward torque accelerates a tool too"


@pytest.mark.parametrize(("more", "step", "event"), [(8.9, 0.5, PICK), (8.9, -0.5, RELEASE), (9.1, 0.5, NONE),
                                                     (9.1, -0.5, NONE)])  # fmt: skip
def test_where_the_model_lacks_ten_times_what_it_did_a_step_at_rest_is_believed_and_no_event(more, step, event):
    """Soft gears settle. more: what it lacks beside what was left when it was identified, over that, squared."""
    left = SETTINGS["model_error"]
    state = believing(1.0 + step, 0.3, excess=more * left, judged=1.0, leverage=verdict.BIAS_SHARE**2 * left / 0.5**2)
    state["load"], state["rest"]["step"] = 1.0, step
    assert told(state) == event
    assert state["load"] == pytest.approx(1.0 + step)
    assert state["last_event"] == (event or PICK)


def test_a_known_load_takes_the_common_error_of_all_masses_away():
    calibrated = settings(PERIOD, DRIFT, 6.0, 0.3 * np.ones(3), np.ones(3), 0.004)[()]
    for mass in (1.0, 3.0):
        state = believing(mass, 0.02)
        verdict.conclude(calibrated, state)
        assert state["common_std_dev"] == pytest.approx(0.004 * mass)
        assert state["std_dev"] == pytest.approx(np.hypot(0.02, 0.004 * mass))


def test_an_open_gripper_carries_nothing_without_an_error():
    state = believing(0.01, 0.02, gripper=Gripper.OPEN)
    told(state)
    assert state["trusted"]
    assert (state["std_dev"], state["random_std_dev"], state["common_std_dev"]) == (0.0, 0.0, 0.0)


def test_before_the_first_release_a_tool_that_nobody_has_seen_is_in_the_error_of_every_mass():
    states = np.zeros(1, STATE)
    start(states, DRIFT)
    state = believing(2.0, 0.02, ground=states["ground"][0])
    told(state)
    assert state["std_dev"] == pytest.approx(np.hypot(0.02, verdict.TOOL_SHARE * 0.12 + TORQUE_SHARE * 2.0), rel=1e-4)
    assert state["trusted"], "so little is no reason to say nothing"
    state["moment"][0], state["load"] = 0.05 / 0.02**2, 0.05
    told(state)
    assert state["ground"] == pytest.approx(0.05), "no more than what hangs there"
    state["moment"][0], state["load"], state["last_event"] = 0.5 / 0.02**2, 0.5, RELEASE
    told(state)
    assert state["ground"] == pytest.approx(0.5), "what hangs there after a release, however much"


@pytest.mark.parametrize(("mass", "trusted"), [(0.08, True), (-0.08, True), (0.13, False)])
def test_what_is_off_nothing_after_a_release_is_in_the_error_of_every_mass(mass, trusted):
    """As a wrong torque constant makes it, which scales the others the same way."""
    state = believing(mass, 0.02, last_event=RELEASE)
    told(state)
    assert state["ground"] == pytest.approx(abs(mass))
    assert bool(state["trusted"]) == trusted
    least = np.hypot(0.02, verdict.TOOL_SHARE * abs(mass) + TORQUE_SHARE * max(mass, 0.0))
    assert state["std_dev"] >= least * (1 - 1e-9)
    state["last_event"], state["moment"][0] = PICK, 3.0 / 0.02**2
    told(state)
    assert state["std_dev"] == pytest.approx(np.hypot(0.02, verdict.TOOL_SHARE * abs(mass) + 0.105), rel=2e-3)


def test_a_tool_is_forgotten_within_ten_minutes_or_so():
    state = believing(2.0, 0.02, grounded=1, ground=0.5)
    told(state, 100)
    assert state["ground"] == pytest.approx(0.5 + 1.5 * 100 * PERIOD / 600.0, rel=1e-6)


def test_a_mass_is_sure_for_as_long_as_it_was_since_its_event():
    state = believing(2.0, 0.02, sure_for=0.5)
    told(state, 100)
    assert state["sure_for"] == pytest.approx(0.5 + 100 * PERIOD)
    state["hidden"] = 1.0  # not trusted
    told(state, 100)
    assert state["sure_for"] == pytest.approx(0.5 + 100 * PERIOD)
    state["load"], state["hidden"] = 0.5, 0.0
    assert told(state) == PICK
    assert state["sure_for"] <= PERIOD


@pytest.mark.parametrize(
    ("crept", "gripper", "event"),
    [(0.28, Gripper.UNKNOWN, PICK), (0.30, Gripper.UNKNOWN, NONE), (0.30, Gripper.CLOSED, PICK)],
)
def test_who_sets_out_slowly_from_a_rest_tells_no_event_of_what_came_to_hang_there(crept, gripper, event):
    """But where it is heard of. What is told by then is believed, and the next change is an event again."""
    state = believing(0.5, 0.02, load=0.0, crept=crept, unheard=0, gripper=gripper, gripper_before=gripper)
    assert told(state) == event
    assert state["load"] == pytest.approx(0.5)
    assert state["crept"] == (crept if event == PICK else 0.0)
    unsure = believing(0.5, 0.02, load=0.0, crept=0.30, unheard=1)
    assert told(unsure, 3) == NONE
    assert unsure["crept"] == 0.30, "what a rest may hide is not known yet"


@pytest.mark.parametrize(
    ("mass", "fields", "event"),
    [
        (1.52, {}, NONE),  # of 3 kg
        (1.48, {}, RELEASE),  # less than two and a half times what always hangs there
        (4.48, {}, NONE),
        (4.52, {}, PICK),
        (1.52, {"grounded": 0}, RELEASE),  # nothing was ever let go
        (1.52, {"gripper": Gripper.CLOSED, "gripper_before": Gripper.CLOSED}, RELEASE),
        (1.19, {"load": 2.6}, RELEASE),  # down to what always hangs there
        (1.21, {"load": 2.6}, NONE),
    ],
)
def test_what_hangs_there_after_every_release_may_turn_round_and_is_no_event(mass, fields, event):
    given = {"load": 3.0, "ground": 0.6, "grounded": 1, "sure_for": 1.0} | fields
    assert told(believing(mass, 0.02, **given)) == event
