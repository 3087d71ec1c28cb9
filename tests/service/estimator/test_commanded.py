"""Weighing by the commanded torque: sooner where the drives do what they are told, never where they do not."""

import numpy as np
import pytest

from schemas.messages import stamp_ns
from schemas.robot import EffectEntry, EffectParameter
from service.estimator import commanded
from service.estimator.estimator import Estimator
from service.model.signals import lagging, leading
from tests.known import PERIOD
from tests.service.estimator.test_trust import PICKS, carried, covered

SECONDS, NOISE, LAG = 5.0, 1.0, 6


@pytest.fixture(scope="module")
def told(robot):
    """A robot of which `identify` found that its drives do what they are told, with a poor torque sensor."""
    noise = robot.identified.torque_noise_nm.model_copy(update={"value": [NOISE] * 3})
    found = robot.identified.model_copy(update={"torque_commanded": True, "torque_noise_nm": noise})
    return robot.model_copy(update={"identified": found})


@pytest.fixture(scope="module")
def known(make):
    return make(SECONDS, payload=carried, noise=NOISE)


def weigh(robot, known, command):
    samples = known.samples.copy()
    samples["torque_command"] = command
    payload = Estimator(robot, PERIOD).run(samples).payload
    return payload, stamp_ns(payload) * 1e-9 + LAG * PERIOD


def test_a_mass_is_known_sooner_by_what_the_drives_were_told(told, known):
    def error(command):
        payload, time = weigh(told, known, command)
        fresh = np.any([(time > edge + 0.1) & (time < edge + 0.2) for *edges, _ in PICKS for edge in edges], axis=0)
        return np.abs(payload["mass"] - carried(time))[fresh & (time < SECONDS)].max()

    assert error(np.nan) > 0.03, "too little noise to tell"
    assert error(known.torque) < 0.015


BEHIND = {
    "torque_delay": ("delay", 0.003, 0.003, lambda torque: np.concatenate([torque[:1].repeat(3, axis=0), torque[:-3]])),
    "torque_filter": ("cutoff", 50.0, 0.0, lambda torque: lagging(torque, 50.0, PERIOD)),
}


def behind(told, known, effect):
    """A robot whose report is behind its command by an effect, and its samples."""
    parameter, value, ahead, reported = BEHIND[effect]
    entry = EffectEntry(name=effect, joints=[], parameters={parameter: EffectParameter(value=value)})
    found = told.identified.model_copy(update={"torque_commanded": False, "torque_command_ahead_s": ahead})
    samples = known.samples.copy()
    samples["torque"] += reported(known.torque) - known.torque
    samples["torque_command"] = known.torque
    return told.model_copy(update={"identified": found, "effect": [entry]}), samples


@pytest.mark.parametrize("effect", BEHIND)
def test_a_mass_is_known_sooner_by_a_command_that_the_report_is_behind(told, known, effect):
    robot, samples = behind(told, known, effect)

    def error(samples):
        payload = Estimator(robot, PERIOD).run(samples).payload
        time = stamp_ns(payload) * 1e-9
        fresh = np.any([(time > edge + 0.09) & (time < edge + 0.19) for *edges, _ in PICKS for edge in edges], axis=0)
        return np.abs(payload["mass"] - carried(time))[fresh & (time > 0.5)].max()

    assert error(samples) < 0.015
    samples["torque_command"] = np.nan
    assert error(samples) > 0.03, "too little noise to tell"


@pytest.mark.parametrize("effect", BEHIND)
def test_a_command_is_refuted_where_the_report_is_not_behind_it_as_described(told, known, effect):
    robot, samples = behind(told, known, effect)
    estimator = Estimator(robot, PERIOD)
    samples["torque"][2000:] += samples["torque_command"][2000:] - BEHIND[effect][-1](known.torque)[2000:]
    estimator.run(samples[:2000])
    assert not estimator.state["drive_torque"]["refuted"]
    estimator.run(samples[2000:])
    assert estimator.state["drive_torque"]["refuted"]


def test_a_drive_that_follows_its_command_late_is_weighed_by_what_it_makes_of_it(told, known):
    """Command and report are what the drive is asked for, 8 ms ahead of what acts."""
    cutoff = 20.0
    lag = EffectEntry(name="drive_lag", joints=[], parameters={"cutoff": EffectParameter(value=cutoff)})
    asked = leading(known.torque, cutoff, PERIOD)
    samples = known.samples.copy()
    samples["torque"] += asked - known.torque
    samples["torque_command"] = asked
    payload = Estimator(told.model_copy(update={"effect": [lag]}), PERIOD).run(samples).payload
    time = stamp_ns(payload) * 1e-9
    settled = np.all([np.abs(time - edge - 0.075) > 0.08 for *edges, _ in PICKS for edge in edges], axis=0)
    assert np.abs(payload["mass"] - carried(time))[settled & (time > 0.3)].max() < 0.03


def test_a_command_is_proved_before_it_is_used(told, known):
    (before, time), (after, _) = weigh(told, known, np.nan), weigh(told, known, known.torque)
    early = time < 0.2
    np.testing.assert_array_equal(before[early], after[early])
    assert (before[time < 0.5] != after[time < 0.5]).any()


def test_a_command_that_knows_nothing_of_the_load_is_refuted_by_it(told, known, make):
    """A feed-forward offset of a perfect model beside the position loop of a drive: all that is missing is the mass."""
    light = [(on + 0.5, off + 0.5, 0.25 * mass) for on, off, mass in PICKS]
    loaded = make(SECONDS, payload=lambda time: carried(time, light), noise=NOISE)
    payload, time = weigh(told, loaded, make(SECONDS).torque)
    truth = carried(time, light)
    inside, trusted = covered(payload, time, truth)
    assert inside >= 0.95
    assert trusted > 0.2
    changes = [edge for pick in light for edge in pick[:2]]  # which either may see a sample sooner
    late = (time > 2.0) & np.all([np.abs(time - edge - 0.1) > 0.1 for edge in changes], axis=0)
    np.testing.assert_allclose(payload["mass"][late], weigh(told, loaded, np.nan)[0]["mass"][late], atol=0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda torque: np.roll(torque, 1, axis=0),
        lambda torque: 0.9 * torque,
        lambda torque: np.clip(torque, -12.0, 12.0),
        lambda torque: torque * [1.0, 1.0, np.nan],
    ],
    ids=["late", "of another scale", "held at a limit", "of two joints"],
)
def test_what_a_drive_does_not_do_is_not_used(told, known, wrong):
    payload, time = weigh(told, known, wrong(known.torque))
    expected, _ = weigh(told, known, np.nan)
    np.testing.assert_array_equal(payload[time > 2.0], expected[time > 2.0])


def taken(departures, noise=NOISE, known=True):
    """What comparing says of each, N m off on joint 2, the others as told, and whether the command is used then."""
    settings = commanded.settings(np.array([NOISE, noise, NOISE]), known, PERIOD)[()]
    state = np.zeros(1, commanded.STATE)[0]
    told = np.array([5.0, -3.0, 1.0])
    for departure in departures:
        refuted = commanded.compare_kernel(settings, state, told + [0.0, departure, 0.0], told, PERIOD)
        yield refuted, commanded.is_used(settings, state)


@pytest.mark.parametrize(("times", "refuted"), [(0.99, False), (1.01, True), (-1.01, True)])
def test_a_command_is_refuted_at_once_by_what_is_no_noise(times, refuted):
    """Of seven standard deviations, once it is used, that is after 0.2 s."""
    for noise in (0.5, 2.0):
        odd = times * commanded.REFUTATION**0.5 * noise
        said = list(taken([0.0] * 250 + [odd, 0.0], noise))
        assert said[198] == (False, False)
        assert said[201] == (False, True)
        assert said[250:] == [(refuted, not refuted), (False, not refuted)]
        early = list(taken([0.0] * 50 + [odd] + [0.0] * 300, noise))
        assert not any(again for again, _ in early), "it was not used yet"
        assert early[-1][1] is not refuted
    assert not any(any(each) for each in taken([0.0] * 300, known=False))


@pytest.mark.parametrize(("size", "memory"), [(3.0, 0.02), (-3.0, 0.02), (0.6, 0.5)])
def test_a_command_is_refuted_by_what_lasts(size, memory):
    """A mean over so long of white noise scatters by (1 - keep) / (1 + keep) of it."""
    keep = np.exp(-PERIOD / memory)
    spread = ((1 - keep) / (1 + keep)) ** 0.5 * NOISE
    count = np.arange(1, 2000)
    first = count[np.abs(size) * (1 - keep**count) > commanded.REFUTATION**0.5 * spread][0]
    said = [refuted for refuted, _ in taken([0.0] * 250 + [size] * 1999)]
    assert np.flatnonzero(said).tolist() == [249 + first]


@pytest.mark.parametrize("effect", [None, *BEHIND])
def test_a_mass_says_whether_it_is_told_by_a_command(told, known, effect):
    robot, samples = (told, known.samples.copy()) if effect is None else behind(told, known, effect)
    samples["torque_command"] = known.torque
    estimator = Estimator(robot, PERIOD)
    estimator.run(samples[:2000])
    assert estimator.state["payload"]["commanded"] == 1
    samples["torque_command"] = np.nan
    estimator.run(samples[2000:2100])
    assert estimator.state["payload"]["commanded"] == 0


def test_a_mass_behind_a_filtered_report_is_told_by_the_report_whatever_the_command(told, known):
    robot, samples = behind(told, known, "torque_filter")
    robot = robot.model_copy(update={"identified": told.identified})
    samples["torque_command"] = lagging(known.torque, 50.0, PERIOD)
    estimator = Estimator(robot, PERIOD)
    estimator.run(samples[:2000])
    assert estimator.state["drive_torque"]["refuted"] == 0
    assert (estimator.state["payload"]["behind"], estimator.state["payload"]["commanded"]) == (1, 0)
