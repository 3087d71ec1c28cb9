"""Logs that were polled, and positions of a coarse encoder: what the motion is made of then."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.axes import Axes
from schemas.messages import SampleFlag
from schemas.trace import Trace
from service.identification.axes import identify_axes
from service.model.prediction import motion
from service.model.signals import resolved_hz, segments

RATE = 6.0  # rad/s, of the motion
INERTIA, WEIGHT, STEP = 0.4, 2.0, 2 * np.pi / 4096


def trace(sampled: np.ndarray, stamps: np.ndarray, step: float = 0.0) -> Trace:
    """An axis that swings, sampled at `sampled` s, stamped `stamps`, by an encoder of `step` rad."""
    angle = 0.9 * np.sin(RATE * sampled) + 0.3 * np.sin(2.7 * RATE * sampled + 1.0)
    bent = -(RATE**2) * (0.9 * np.sin(RATE * sampled) + 0.3 * 2.7**2 * np.sin(2.7 * RATE * sampled + 1.0))
    torque = INERTIA * bent + WEIGHT * np.sin(angle)
    angle = np.round(angle / step) * step if step else angle
    return Trace(Path("polled.json"), stamps, angle[:, None], torque[:, None])


@pytest.fixture
def uneven() -> np.ndarray:
    """Instants 5 ms apart, a fifth more or less, and now and then 20 ms without any."""
    steps = 5e-3 * np.random.default_rng(3).uniform(0.8, 1.2, 1600)
    steps[::97] = 20e-3
    return np.cumsum(steps)


def test_polled_samples_come_to_an_even_clock(uneven: np.ndarray) -> None:
    log = trace(uneven, uneven)
    (part,) = segments(log)
    assert np.ptp(np.diff(part.time)) < 1e-9
    assert part.period == pytest.approx(5e-3, rel=0.01), "a preferred rate"
    true = 0.9 * RATE * np.cos(RATE * part.time) + 0.3 * 2.7 * RATE * np.cos(2.7 * RATE * part.time + 1.0)
    inner = part.moving[:, 0]
    assert np.abs(part.theta_dot[inner, 0] - true[inner]).max() < 0.5, (
        "of 10 rad/s, half-way in a hole; as if even it is 2 rad/s"
    )
    along = motion(log)
    assert along.measured.all()
    speed = 0.9 * RATE * np.cos(RATE * uneven) + 0.3 * 2.7 * RATE * np.cos(2.7 * RATE * uneven + 1.0)
    told = along.moving[:, 0]
    assert np.abs(along.theta_dot[told, 0] - speed[told]).max() < 0.5, "row by row of the log"


def test_stamps_that_jitter_are_not_believed(uneven: np.ndarray) -> None:
    even = 5e-3 * np.arange(1600)
    log = trace(even, even + np.random.default_rng(4).uniform(-1e-3, 1e-3, len(even)))
    (part,) = segments(log)
    assert np.array_equal(part.rows, np.arange(1600))
    assert np.array_equal(part.torque, log.torque)


def test_a_coarse_encoder_narrows_the_band_and_leaves_the_inertia() -> None:
    clock = 2e-3 * np.arange(5000)
    fine, coarse = trace(clock, clock), trace(clock, clock, 4 * STEP)
    assert resolved_hz(segments(fine)) == 40.0
    assert 5.0 < resolved_hz(segments(coarse)) < 25.0
    axes = Axes.model_validate({"name": "a", "kind": "axes", "axis": [{}]})
    found = {e.name: e.value for e in identify_axes(axes, [coarse]).fit.estimates}
    assert found["inertia_1"] == pytest.approx(INERTIA, rel=0.01)
    assert found["gravity_sin_1"] == pytest.approx(WEIGHT, rel=0.03)


def test_what_carries_a_load_is_not_told_of_the_arm_alone() -> None:
    clock = 2e-3 * np.arange(2000)
    flags = np.zeros(2000, np.uint32)
    flags[900:1100] = SampleFlag.LOADED
    (part,) = segments(replace(trace(clock, clock), flags=flags))
    assert not part.moving[900:1100].any()
    assert part.moving[600:900].mean() > 0.9
