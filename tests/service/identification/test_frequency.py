"""Frequency response from torque to speed: SciPy's estimate, and a machine whose response is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import coherence, csd, lfilter

from service.identification.frequency import EDGES, MEASURED, cross_density, responses, spectra_of

PERIOD, INERTIA, VISCOUS = 1e-3, 0.02, 0.5


def driven(seed: int, noise: float = 0.0, inertia: float = INERTIA) -> tuple[np.ndarray, np.ndarray]:
    """(N, 1) torque and the speed of J v_dot + f v under it, by the exact step of a held torque."""
    torque = np.random.default_rng(seed).normal(0, 1, 20_000)
    keep = np.exp(-VISCOUS / inertia * PERIOD)
    speed = lfilter([0, (1 - keep) / VISCOUS], [1, -keep], torque)
    speed += noise * np.random.default_rng(seed + 100).normal(0, 1, len(torque))
    return torque[:, None], speed[:, None]


def test_the_cross_spectrum_is_scipys() -> None:
    torque, speed = driven(1, 0.1)
    for window in (512, 501):
        frequency, density = cross_density(torque, speed, PERIOD, window)
        expected = csd(torque, speed, 1 / PERIOD, nperseg=window, noverlap=window // 2, axis=0)
        np.testing.assert_allclose(frequency, expected[0])
        np.testing.assert_allclose(density, expected[1], rtol=1e-9, atol=1e-15)


def test_the_response_of_a_known_machine_and_of_a_model_that_is_too_heavy() -> None:
    """The logs have a hold's half sample of delay, which the phase shows too."""
    logs = [driven(seed) for seed in range(3)]
    measured = [spectra_of(*log, PERIOD) for log in logs]
    heavy = [spectra_of(*driven(seed, inertia=2 * INERTIA), PERIOD) for seed in range(3)]
    (found,) = responses(measured, {"heavy": heavy}, "rad/(N m s)")
    hertz = np.array(found.hz)
    inside = hertz < 100.0
    expected = 1.0 / (1j * 2 * np.pi * hertz * INERTIA + VISCOUS)
    np.testing.assert_allclose(np.array(found.magnitude[MEASURED])[inside], np.abs(expected)[inside], rtol=0.06)
    held = np.angle(expected, deg=True) - 360 * hertz * PERIOD / 2
    np.testing.assert_allclose(np.array(found.phase_deg[MEASURED])[inside], held[inside], atol=4.0)
    assert min(np.array(found.coherence)[inside]) > 0.97
    ratio = np.array(found.magnitude["heavy"]) / np.array(found.magnitude[MEASURED])
    heavier = np.abs(1.0 / (1j * 2 * np.pi * hertz * 2 * INERTIA + VISCOUS))
    np.testing.assert_allclose(ratio[inside], (heavier / np.abs(expected))[inside], atol=0.06)


def test_coherence_tells_where_noise_is_as_loud_as_the_motion() -> None:
    torque, speed = driven(2, noise=0.05)
    (found,) = responses([spectra_of(torque, speed, PERIOD)], {}, "rad/(N m s)")
    frequency, expected = coherence(torque[:, 0], speed[:, 0], 1 / PERIOD, nperseg=1000, noverlap=500)
    for hertz, told in zip(found.hz, found.coherence, strict=True):
        low, high = EDGES[np.searchsorted(EDGES, hertz) - 1], EDGES[np.searchsorted(EDGES, hertz)]
        mine = (frequency >= low) & (frequency < high)
        assert told == pytest.approx(float(np.mean(expected[mine])), abs=0.12)
    assert found.coherence[0] > 0.9
    assert found.coherence[-1] < 0.3


def test_a_stretch_shorter_than_a_window_and_a_joint_at_rest_have_none() -> None:
    torque, speed = driven(1)
    short = spectra_of(torque[:500], speed[:500], PERIOD)
    assert responses([short], {}, "") == []
    both = spectra_of(np.repeat(torque, 2, axis=1), np.column_stack([speed, 0 * speed]), PERIOD)
    assert [one.joint for one in responses([both], {}, "")] == [1]
