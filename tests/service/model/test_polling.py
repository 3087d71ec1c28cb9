"""Logs that were polled, and positions of a coarse encoder: what the motion is made of then."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from schemas.axes_description import Axes
from schemas.errors import DataError
from schemas.messages import SampleFlag
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.model import signals
from service.model.prediction import motion
from service.model.signals import resolved_hz, segments, segments_of

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


def jittering(count: int, spread: float, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Samples taken evenly, 5 ms apart, and stamps with `spread` of that from the 5 % shortest to the 5 % longest."""
    even = 5e-3 * np.arange(count)
    steps = np.random.default_rng(seed).uniform(1 - spread / 1.8, 1 + spread / 1.8, count)
    return even, np.cumsum(5e-3 * steps)


@pytest.mark.parametrize(
    ("every", "hole", "told"),
    [(900, 3.0, True), (1100, 3.0, False), (900, 1.6, True), (900, 5.9, True), (900, 6.1, False), (20, 6.1, False)],
)
def test_a_log_with_more_than_a_hole_in_a_thousand_steps_was_polled(every: int, hole: float, told: bool) -> None:
    """Though its motion is smoother without the stamps; what lasts longer is a fault of its own."""
    even, stamps = jittering(4501, 0.3)
    late = np.zeros(4501)
    late[450::every] = (hole - 1.0) * 5e-3
    stamps[450::every] = stamps[449::every][: len(stamps[450::every])] + 5e-3  # so that each is of its length
    assert signals._polled(stamps + np.cumsum(late), 0.9 * np.sin(RATE * even)[:, None]) == told


@pytest.mark.parametrize(
    ("count", "spread", "told"), [(100, 0.5, True), (99, 0.5, False), (4000, 0.12, True), (4000, 0.08, False)]
)
def test_few_samples_or_steady_ones_were_not_polled(count: int, spread: float, told: bool) -> None:
    """Of samples that were taken when their stamps say."""
    _, stamps = jittering(count, spread)
    for joints in (1, 2):  # one that moves is enough
        position = 0.9 * np.sin(RATE * stamps)[:, None] * np.eye(1, joints)
        assert signals._polled(stamps, position) == told


def test_polled_samples_go_straight_to_the_clock_of_a_preferred_rate() -> None:
    """Two parts, as far as six steps between them go; one hole of five is bridged."""
    _, stamps = jittering(1200, 0.4)
    stamps[300:] += 4.0 * 5e-3
    stamps[700:] += 6.5 * 5e-3
    stamps *= 1.07  # of 187 Hz, beside the preferred 200
    log = trace(stamps, stamps)
    parts = segments(log)
    assert len(parts) == 2
    for part, mine in zip(parts, (slice(0, 700), slice(700, 1200)), strict=True):
        at, position, torque = stamps[mine], log.position[mine], log.torque[mine]
        assert (part.period, part.sampled) == (pytest.approx(5.011872e-3, rel=1e-6), part.period)
        clock = at[0] + part.period * np.arange(len(part.time))
        np.testing.assert_allclose(part.time, clock)
        assert abs(clock[-1] - at[-1]) <= part.period / 2
        expected = [next((row for row, t in enumerate(at) if t >= time), len(at) - 1) for time in clock]
        np.testing.assert_array_equal(part.rows, mine.start + np.array(expected))
        straight = make_interp_spline(at, np.hstack([position, torque]), k=1)(np.minimum(clock, at[-1]))
        np.testing.assert_allclose(part.torque, straight[:, 1:])
        np.testing.assert_allclose(part.theta, signals.smooth(straight[:, :1], part.period)[0])


def test_logs_of_one_recorder_come_to_one_clock() -> None:
    """Read by a coarse encoder at 188 Hz, one log shows that it was polled and another does not: 5 ms and 5.3."""
    draw = np.random.default_rng(8)
    stamps = [np.cumsum(draw.uniform(0.9, 1.1, 3000) / 188) for _ in range(2)]
    fine, coarse = trace(stamps[0], stamps[0]), trace(stamps[1], stamps[1], 16 * STEP)
    alone = [segments(log)[0].period for log in (fine, coarse)]
    assert alone == pytest.approx([5e-3, 1 / 188], rel=0.01), "each by itself"
    periods = [parts[0].period for parts in segments_of([fine, coarse])]
    assert periods == pytest.approx([alone[0]] * 2, rel=1e-6)
    axes = Axes.model_validate({"name": "a", "kind": "axes", "axis": [{}]})
    found = {e.name: e.value for e in identify_axes(axes, [fine, coarse]).fit.estimates}
    assert found["inertia_1"] == pytest.approx(INERTIA, rel=0.02)
    other = trace(2 * stamps[0], 2 * stamps[0])
    with pytest.raises(DataError, match="give logs with the same sample rate"):
        identify_axes(axes, [fine, other])
