"""The noise floor of torque whose noise has a memory, against the spectrum that it was made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from schemas.trace import Trace
from service.identification import pooled
from service.model.mechanism import mechanism_of
from service.model.scene import Recording
from service.model.signals import segments_of
from tests.service.diagnosis.test_diagnose_parts import ROBOT, log

PERIOD = 1e-3
MEMORY = 4.0  # samples
POLES = np.array([1.0, -np.exp(-1.0 / MEMORY)])
SECONDS = 12.0


def filtered(white: np.ndarray) -> np.ndarray:
    """Noise of first order, as a filter in a drive makes it."""
    return np.asarray(lfilter([1.0], POLES, white, axis=0))


def noisy(seed: int, more: float = 0.0, part: float = 1.0) -> Trace:
    """more: N m of a torque at 12 Hz that no model has, in that `part` of the log."""
    trace = log(seed, 0.0, SECONDS)
    random = np.random.default_rng([seed, 7])
    time = trace.time - trace.time[0]
    strange = more * np.sin(2 * np.pi * 12.0 * time) * (time < part * SECONDS)
    noise = filtered(0.1 * random.standard_normal(trace.torque.shape))
    return replace(trace, torque=trace.torque + noise + strange[:, None])


def floors(traces: list[Trace]) -> tuple[np.ndarray, np.ndarray, float]:
    """(n,) N m of the floor as it is first taken and as it is read in the band, and what it is."""
    mechanism = mechanism_of(ROBOT)
    recordings = [
        Recording(segment, mechanism, number, traces[number].name)
        for number, segments in enumerate(segments_of(traces))
        for segment in segments
    ]
    problem, first = pooled.problem_of(recordings)
    best = pooled.fit(problem, first.sample, ROBOT).fitted.hypothesis
    _, found = pooled.floor_in_band(problem, first, best)
    frequency = np.linspace(0.0, 0.5 / PERIOD, 20_000)
    density = np.abs(POLES[0] + POLES[1] * np.exp(-2j * np.pi * frequency * PERIOD)) ** -2.0
    share = float(np.sum(density[frequency < problem.band.cutoff_hz])) / len(frequency)
    return first.band, found.band, 0.1 * share**0.5


@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_that_of_the_spectrum(seed: int) -> None:
    _, found, true = floors([noisy(seed), noisy(seed + 10)])
    np.testing.assert_allclose(found, true, rtol=0.1)


def test_a_torque_that_no_model_has_for_a_part_of_the_time_does_not_raise_it() -> None:
    _, found, true = floors([noisy(1, 1.0, 0.4), noisy(2, 1.0, 0.4)])
    np.testing.assert_allclose(found, true, rtol=0.12)


def test_what_no_noise_of_first_order_would_be_is_none() -> None:
    """All the time and far above what noise is beyond the band: the floor stays as it was taken."""
    first, found, true = floors([noisy(1, 1.0), noisy(2, 1.0)])
    np.testing.assert_array_equal(found, first)
    assert (found < 2 * true).all()


def test_where_noise_is_white_it_stays() -> None:
    traces = [log(seed, 0.3, SECONDS) for seed in (1, 2)]
    first, found, _ = floors(traces)
    np.testing.assert_array_equal(found, first)
