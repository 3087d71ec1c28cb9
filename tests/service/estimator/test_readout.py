"""A mass is told by the torque as the drive reports it: a fraction of a sample early or late, or behind a low-pass.

The reports are made by another hand: samples of a finer time base, and SciPy's filter on it.
"""

from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from schemas.robot import EffectEntry, EffectParameter
from service.estimator.estimator import Estimator
from tests.known import PERIOD

FINE = 4  # samples of the finer time base in one
NOISE = 0.25  # N m
PICK, RELEASE, MASS = 0.9, 1.4, 2.0  # s, s, kg


@pytest.fixture(scope="module")
def known(make):
    return make(2.0, period=PERIOD / FINE, pace=2.0, payload=lambda time: MASS * ((time >= PICK) & (time < RELEASE)))


def reported(known, torque):
    """Samples of the slow time base with the torque of the fine one, and noise; without commands."""
    samples = known.samples[::FINE].copy()
    samples["sequence"] = np.arange(len(samples))
    noise = np.random.default_rng(8).standard_normal((len(samples), 3))
    samples["torque"] = torque[::FINE] + NOISE * noise
    samples["position_command"] = np.nan
    return samples


def timed(robot, seconds):
    identified = robot.identified.model_copy(update={"torque_timing_s": seconds})
    return robot.model_copy(update={"identified": identified})


def filtered(robot, cutoff):
    entry = EffectEntry(name="torque_filter", joints=[], parameters={"cutoff": EffectParameter(value=cutoff)})
    return robot.model_copy(update={"effect": [entry]})


def late(known, samples):
    """The torque of so many fine samples ago."""
    return np.roll(known.torque, samples, axis=0)


def low_passed(known, cutoff):
    """The torque behind a first-order low-pass."""
    rate = 2 * np.pi * cutoff
    made: Any = cont2discrete(([rate], [1.0, rate]), PERIOD / FINE, method="foh")
    top, bottom = np.ravel(made[0]), np.ravel(made[1])
    start = known.torque[0]
    return start + lfilter(top, bottom, known.torque - start, axis=0)


def carried(robot, samples, delay):
    """Masses while the load is carried, from 0.15 s and `delay` s after it came, and events."""
    payload = Estimator(robot, PERIOD).run(samples).payload
    time = payload["sequence"] * PERIOD
    return payload["mass"][(time > PICK + 0.15 + delay) & (time < RELEASE)], time[payload["event"] != 0]


@pytest.mark.parametrize("samples", [-1, 1, 2])
def test_a_report_a_fraction_of_a_sample_late_or_early_puts_no_mass_off(robot, known, samples):
    report = reported(known, late(known, samples))
    mass, _ = carried(timed(robot, samples * PERIOD / FINE), report, 0.0)
    unaware, _ = carried(robot, report, 0.0)
    right, wrong = (np.sqrt(np.mean((found - MASS) ** 2)) for found in (mass, unaware))
    assert right < 0.01
    assert wrong > 2 * right


@pytest.mark.parametrize("cutoff", [30.0, 80.0])
def test_behind_a_low_pass_a_mass_comes_later_by_no_more_than_that(robot, known, cutoff):
    mass, events = carried(
        filtered(robot, cutoff), reported(known, low_passed(known, cutoff)), 1 / (2 * np.pi * cutoff)
    )
    assert np.abs(mass - MASS).max() < 0.05
    np.testing.assert_allclose(events, [PICK, RELEASE], atol=0.05)
    assert (events > [PICK, RELEASE]).all()
