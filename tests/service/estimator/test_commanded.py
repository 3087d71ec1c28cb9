"""Weighing by the commanded torque: sooner where the drives do what they are told, never where they do not."""

import numpy as np
import pytest

from schemas.messages import stamp_ns
from service.estimator.estimator import Estimator
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
