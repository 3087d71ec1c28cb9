"""One gear of the online step against the closed form of a damped oscillator."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from service.model.elastic import GEARS
from service.model.gears import TWIST, advance_kernel, through_kernel

INERTIA, MOTOR = 0.5, 0.1  # kg m^2 of the joint, and of it what turns with the motor
LOAD, PAYLOAD = 12.0, 3.0  # N m, N m/kg
RATES = (250.0, 1000.0, 8000.0)


def loaded(
    natural_hz: float, damping_ratio: float, rate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Three swings after a load that comes at once on joint 2, whose gear alone yields: time (N,), twists (N, 2) rad of
    the load and per kg of payload, torque (N, 3) N m at the motors, and the closed form (N,) of the first twist."""
    omega, link = 2 * np.pi * natural_hz, INERTIA - MOTOR
    gears, twist = np.zeros((), GEARS), np.zeros(1, TWIST)[0]
    gears["stiffness"][1], gears["motor"][1] = link * omega**2, MOTOR
    gears["damping"][1] = 2 * damping_ratio * omega * link
    gears, mass, still = np.array([gears])[0], np.diag([1.0, INERTIA, 1.0]), np.zeros(3)
    advance_kernel(gears, twist, mass, still, still, still, 0.0, 0.0)
    load, payload = np.array([0.0, LOAD, 0.0]), np.array([0.0, PAYLOAD, 0.0])
    twist["force"][:, 1] = -LOAD, -PAYLOAD  # at once, not over the first sample
    twist["change"][:, 1] = -LOAD / link, -PAYLOAD / link
    time = np.arange(1, round(3.0 / natural_hz * rate) + 1) / rate
    angles, torques = np.empty((len(time), 2)), np.empty((len(time), 3))
    for n in range(len(time)):
        advance_kernel(gears, twist, mass, load, payload, still, 0.0, 1.0 / rate)
        angles[n] = twist["angle"][:, 1]
        torques[n] = load
        through_kernel(gears, twist, 0, True, torques[n])
    decay, swing = damping_ratio * omega, omega * np.sqrt(1 - damping_ratio**2)
    wave = np.cos(swing * time) + decay / swing * np.sin(swing * time)
    return time, angles, torques, -LOAD / (link * omega**2) * (1 - np.exp(-decay * time) * wave)


@pytest.mark.parametrize(("natural_hz", "rate"), list(itertools.product((2.0, 20.0, 250.0), RATES)))
def test_a_link_swings_as_a_damped_oscillator(natural_hz, rate):
    _, angles, torques, expected = loaded(natural_hz, 0.1, rate)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(angles[:, 0], expected, atol=0.03 * largest)
    np.testing.assert_allclose(angles[:, 1] * LOAD / PAYLOAD, angles[:, 0], rtol=1e-9)
    # the motor stands: its torque is what the spring and its damper take
    speed = np.gradient(expected, 1.0 / rate, edge_order=2)
    link, omega = INERTIA - MOTOR, 2 * np.pi * natural_hz
    if rate > 20 * natural_hz:
        passed = -link * (omega**2 * expected + 0.2 * omega * speed)
        np.testing.assert_allclose(torques[:, 1], passed, atol=0.1 * LOAD)
    np.testing.assert_array_equal(torques[:, [0, 2]], 0.0)


@pytest.mark.parametrize("rate", RATES)
def test_a_swing_without_a_damper_neither_grows_nor_dies(rate):
    _, angles, _, expected = loaded(20.0, 0.0, rate)
    per_swing = round(rate / 20.0)
    first, last = (np.ptp(part) for part in (angles[:per_swing, 0], angles[-per_swing:, 0]))
    assert last == pytest.approx(first, rel=0.02)
    assert first == pytest.approx(np.abs(expected).max(), rel=0.02)  # from rest to twice the load's own twist
