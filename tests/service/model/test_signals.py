"""The smoother against filterpy's and against a motion known in closed form; rest and segments against planted ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, decimate, lfilter, lsim, sosfiltfilt

from schemas.errors import DataError, TraceError
from schemas.messages import SampleFlag
from schemas.trace import Trace
from service.model import signals

PERIOD = 1e-3


def swing(count: int, period: float = PERIOD) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time and a motion of two joints with its exact derivatives."""
    time = np.arange(count) * period
    theta = theta_dot = theta_ddot = 0.0
    for amplitude, hz, phase in ((0.3, 1.3, 0.2), (0.05, 4.1, 1.0), (0.01, 12.0, 2.0)):
        w = 2 * np.pi * hz
        angle = w * time[:, None] + phase + np.array([0.0, 0.7])
        theta = theta + amplitude * np.sin(angle)
        theta_dot = theta_dot + amplitude * w * np.cos(angle)
        theta_ddot = theta_ddot - amplitude * w**2 * np.sin(angle)
    return time, np.asarray(theta), np.asarray(theta_dot), np.asarray(theta_ddot)


def white_jerk(bandwidth: float) -> KalmanFilter:
    """The smoother's model in filterpy, in units of 1 / bandwidth. bandwidth: rad a sample."""
    model = KalmanFilter(dim_x=3, dim_z=1)
    model.F = np.array([[1.0, bandwidth, bandwidth**2 / 2], [0.0, 1.0, bandwidth], [0.0, 0.0, 1.0]])
    model.H = np.array([[1.0, 0.0, 0.0]])
    model.Q = np.asarray(Q_continuous_white_noise(3, dt=bandwidth, spectral_density=1.0), np.float64)
    model.R = np.array([[1.0 / bandwidth]])
    model.P = np.diag([1.0 / bandwidth, signals.START_VARIANCE, signals.START_VARIANCE])
    return model


def filterpy_smooth(position: np.ndarray, period: float, bandwidth_hz: float) -> np.ndarray:
    """(N, 3) theta, theta_dot, theta_ddot of one joint by filterpy's filter and smoother, sample by sample."""
    bandwidth = 2 * np.pi * bandwidth_hz * period
    model = white_jerk(bandwidth)
    model.x = np.array([[position[0]], [0.0], [0.0]])
    means, covariances, _, _ = model.batch_filter(position, update_first=True)
    result = model.rts_smoother(means, covariances)[0][:, :, 0]
    return result * (bandwidth / period) ** np.arange(3)


@pytest.mark.parametrize(("period", "bandwidth_hz"), [(1e-3, 200.0), (2.5e-4, 200.0), (1e-3, 60.0)])
def test_smoother_equals_filterpy(period: float, bandwidth_hz: float) -> None:
    rng = np.random.default_rng(1)
    _, theta, _, _ = swing(1500, period)
    position = theta + 1e-5 * rng.standard_normal(theta.shape)
    ours = np.stack(signals.smooth(position, period, bandwidth_hz), axis=-1)
    for joint in range(2):
        reference = filterpy_smooth(position[:, joint], period, bandwidth_hz)
        scale = np.abs(reference).max(axis=0)
        assert np.max(np.abs(ours[:, joint] - reference) / scale) < 1e-9


def test_smoother_follows_the_motion() -> None:
    rng = np.random.default_rng(2)
    _, theta, theta_dot, theta_ddot = swing(4000)
    ours = signals.smooth(theta + 1e-7 * rng.standard_normal(theta.shape), PERIOD)
    inside = slice(100, -100)
    assert np.abs(ours[0] - theta)[inside].max() < 5e-7
    assert np.abs(ours[1] - theta_dot)[inside].max() < 5e-4
    assert np.std((signals.lowpass(ours[2] - theta_ddot, PERIOD))[inside]) < 1e-3 * np.std(theta_ddot)


def test_rest_is_found_and_reversals_are_not_rest() -> None:
    time = np.arange(4000) * PERIOD
    theta = np.where(time < 1.0, 0.3 * np.sin(2 * np.pi * time) ** 2, 0.0)  # stops dead at 1 s ...
    theta = np.where(time > 3.0, 0.3 * np.sin(2 * np.pi * (time - 3.0)) ** 2, theta)  # ... and starts at 3 s
    mask = signals.moving(np.stack([theta, theta], axis=1), PERIOD)
    assert not mask[1050:2950].any()
    assert mask[400:600].all()  # the velocity passes zero at 0.5 s
    assert mask[3100:3950].all()


def test_rest_is_the_scorers(shared: Path) -> None:
    scorer: dict = {}
    text = (shared / "score_diagnosis.py").read_text(encoding="utf-8").split("def gap(")[0]
    exec(compile(text, "score_diagnosis.py", "exec"), scorer)
    for path in sorted((shared / "plant_logs").glob("case_00[0-3]/*.csv")):
        position = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(4, 5, 6))
        assert np.array_equal(signals.moving(position, PERIOD), scorer["moving"](position, 1 / PERIOD))


@pytest.mark.parametrize("samples", [0.3, 1.0, -0.75, 4.6, -3.2])
def test_a_delay_of_parts_of_a_sample_is_exact_on_a_cubic_and_holds_the_ends(samples: float) -> None:
    count = np.arange(60.0)
    cubic = np.stack([0.01 * (count - 20) ** 3 - count, 5.0 - 0.002 * (count - 40) ** 3], axis=1)
    found = signals.delayed(cubic, samples * PERIOD, PERIOD)
    earlier = count - samples
    expected = np.stack([0.01 * (earlier - 20) ** 3 - earlier, 5.0 - 0.002 * (earlier - 40) ** 3], axis=1)
    np.testing.assert_allclose(found[8:-8], expected[8:-8], atol=1e-9)
    if abs(samples) > 3:  # nothing but what is held
        end = 0 if samples > 0 else -1
        np.testing.assert_allclose(found[end], cubic[end])
    held = signals.delayed(np.ones((5, 1)), samples * PERIOD, PERIOD)
    np.testing.assert_allclose(held, 1.0)


@pytest.mark.parametrize("period", [1e-3, float(np.nextafter(1e-3, 1.0)), float(np.nextafter(1e-3, 0.0))])
def test_a_band_keeps_as_many_samples_whatever_the_last_digit_of_their_period(period: float) -> None:
    assert signals.Band.of(period).step == 5
    assert signals.Band.of(period, 125.0).step == 2


@pytest.mark.parametrize(("period", "cutoff", "step"), [(1e-3, 40.0, 5), (2.5e-4, 40.0, 20), (1e-2, 20.0, 1)])
def test_a_band_passes_what_its_filter_does_to_an_impulse(period: float, cutoff: float, step: int) -> None:
    band = signals.Band.of(period)
    assert (band.cutoff_hz, band.step) == (cutoff, step)
    impulse = np.zeros((2 * 8192, 1))
    impulse[8192] = 1.0
    answer = signals.lowpass(impulse, period, cutoff)[:, 0]
    frequency, share = band.passes
    power = np.abs(np.fft.rfft(answer))[:-1] ** 2
    np.testing.assert_allclose(np.fft.rfftfreq(len(answer), period)[:-1], frequency)
    np.testing.assert_allclose(power, share, atol=1e-6)
    assert np.interp(cutoff, frequency, share) == pytest.approx(0.25, rel=0.01)  # half the power, forward and back
    assert band.white_share == pytest.approx(np.sum(answer**2), rel=5e-3)
    many = np.random.default_rng(0).standard_normal((403, 3, 30))
    many[:, 1] = 0.0
    np.testing.assert_allclose(band(many), signals.lowpass(many, period, cutoff)[::step], atol=1e-12)


@pytest.mark.parametrize("shape", [(16, 2), (500,), (403, 3, 7), (900, 33)])
@pytest.mark.parametrize("cutoff", [2.0, 40.0, 180.0])
def test_the_low_pass_is_scipys(shape: tuple[int, ...], cutoff: float) -> None:
    values = np.random.default_rng(1).standard_normal(shape).cumsum(axis=0)
    theirs = sosfiltfilt(butter(signals.ANALYSIS_ORDER, 2.0 * cutoff * PERIOD, output="sos"), values, axis=0)
    np.testing.assert_allclose(signals.lowpass(values, PERIOD, cutoff), theirs, rtol=0, atol=1e-12 * np.ptp(values))


def seen(period: float, hz: float, noise: float, polled: float = 0.0) -> signals.Segment:
    """A segment of one joint swinging at `hz`, the first half of it said to rest, with `noise` rad of the positions."""
    time = np.arange(round(4.0 / period)) * period
    wave = 0.5 * np.sin(2 * np.pi * hz * time)[:, None]
    moving = np.arange(len(time))[:, None] >= len(time) // 2
    acceleration = -((2 * np.pi * hz) ** 2) * wave
    return signals.Segment(
        np.arange(len(time)), time, period, wave, wave, acceleration, wave, moving, np.array([noise]), polled or period
    )


@pytest.mark.parametrize(("rung", "share"), [(0, 0.1), (3, 0.97), (3, 1.03), (7, 0.97), (30, 1.0)])
@pytest.mark.parametrize("polled", [1e-3, 4e-3])
def test_the_band_ends_where_noise_of_the_positions_is_a_share_of_the_acceleration(
    rung: int, share: float, polled: float
) -> None:
    """By the integral of the noise's spectrum, white in the positions, twice differentiated: so much noise that at one
    of the cut-offs tried it is `share` of what may be. Two segments, one of twice the noise, weigh by their squares."""
    signal = 0.5 * (2 * np.pi * 2.0) ** 2 / 2**0.5
    steps = 40.0 / 1.25 ** np.arange(31)
    spread = []
    for cutoff in steps:
        frequency = np.linspace(0.0, cutoff, 4001)
        density = 2 * polled * (1 + 4) / 2 * (2 * np.pi * frequency) ** 4
        spread.append(np.trapezoid(density, frequency) ** 0.5)
    noise = share * signals.NOISY * signal / spread[rung]
    found = signals.resolved_hz([seen(1e-3, 2.0, noise, polled), seen(1e-3, 2.0, 2 * noise, polled)])
    assert found == pytest.approx(max(steps[rung if share < 1 else rung + 1 if rung < 30 else 30], signals.LEAST_HZ))


def test_the_noise_of_positions_is_told_from_spikes_and_from_the_steps_of_an_encoder() -> None:
    random, (_, theta, _, _) = np.random.default_rng(3), swing(20_000)
    noisy = theta + 1e-4 * random.standard_normal(theta.shape)
    noisy[::300] += 0.1
    np.testing.assert_allclose(signals.position_noise(noisy), 1e-4, rtol=0.1)
    still = np.where(np.arange(20_000) % 50 < 49, 0.0, 1e-3)[:, None]  # one in fifty off by a step
    expected = 1e-3 / 50**0.5
    np.testing.assert_allclose(signals.position_noise(still), expected, rtol=0.01)
    rounded = np.where(random.random(still.shape) < 0.5, 1.0 + 1e-16, 1.0 - 1e-16) * (1.0 + still)  # of other units
    np.testing.assert_allclose(signals.position_noise(rounded), expected, rtol=0.01)


@pytest.mark.parametrize("period", [2.5e-4, 2e-4, 1.25e-4])
def test_the_torque_is_thinned_as_scipy_does(period: float) -> None:
    part = seen(period, 0.5, 0.0)
    torque = np.random.default_rng(3).standard_normal((len(part.time), 2))
    expected = decimate(torque, round(1e-3 / period), ftype="fir", axis=0, zero_phase=True)
    np.testing.assert_allclose(signals.thin(replace(part, torque=torque)).torque, expected, atol=1e-12)


def test_thinning_keeps_what_is_slow_of_the_torque() -> None:
    part = replace(seen(1.25e-4, 2.0, 0.0), torque=np.sin(2 * np.pi * 50 * np.arange(32000) * 1.25e-4)[:, None])
    ripple = np.sin(2 * np.pi * 1900 * part.time)[:, None]
    found = signals.thin(replace(part, torque=part.torque + ripple))
    assert found.period == pytest.approx(1e-3)
    for name in ("rows", "time", "theta", "theta_dot", "theta_ddot", "moving"):
        np.testing.assert_array_equal(getattr(found, name), getattr(part, name)[::8])
    assert np.abs(found.torque - part.torque[::8])[50:-50].max() < 0.02
    slow = seen(1e-3, 2.0, 0.0)
    assert signals.thin(slow) is slow


def held_log(every: int, late: int = 0, jitter: int = 0, steps: float = 0.0) -> tuple[signals.Segment, np.ndarray]:
    """Two joints whose noisy torque a drive makes anew after `every` samples, give or take `jitter`, joint 2 `late`
    samples after joint 1 and in steps of `steps` N m; and the torque (N, 2) that was there."""
    random, count = np.random.default_rng(5), 4000
    true = np.stack([np.sin(2 * np.pi * hz * np.arange(count) * PERIOD) for hz in (3.0, 5.0)], axis=1)
    seen = true + 0.02 * random.standard_normal(true.shape)
    seen = np.round(seen / steps) * steps if steps else seen
    torque = seen.copy()
    for joint, first in enumerate((1, 1 + late)):
        updates = first + np.cumsum(random.integers(every - jitter, every + jitter + 1, count))
        updates = np.r_[0, updates[updates < count]]
        torque[:, joint] = np.repeat(seen[updates, joint], np.diff(np.r_[updates, count]))
    part = seen_of(count)
    return replace(part, torque=torque), seen


def seen_of(count: int) -> signals.Segment:
    time, theta, theta_dot, theta_ddot = swing(count)
    moving = np.ones(theta.shape, bool)
    return signals.Segment(np.arange(count), time, PERIOD, theta, theta_dot, theta_ddot, theta, moving)


@pytest.mark.parametrize("every", [2, 4, 8, 20])
@pytest.mark.parametrize("steps", [0.0, 0.005])
def test_of_a_torque_that_is_held_the_samples_stay_at_which_it_came(every: int, steps: float) -> None:
    part, true = held_log(every, steps=steps)
    (found,) = signals.fresh([part])
    assert found.period == pytest.approx(every * PERIOD)
    assert found.held == pytest.approx(every * PERIOD)
    np.testing.assert_array_equal(found.rows % every, 1 % every)
    np.testing.assert_array_equal(found.torque[1:-1], true[found.rows][1:-1])
    for name in ("time", "theta", "theta_dot", "theta_ddot", "moving"):
        np.testing.assert_array_equal(getattr(found, name), getattr(part, name)[found.rows])


@pytest.mark.parametrize(("late", "jitter"), [(2, 0), (0, 2), (3, 2)])
def test_a_torque_that_comes_at_other_times_is_read_off_between_them(late: int, jitter: int) -> None:
    """Within its noise of 0.02 and the bend of 5 Hz in 6 ms; the stairs are off by 0.06 rms and late by 2.5 ms."""
    part, _ = held_log(6, late=late, jitter=jitter)
    true = np.stack([np.sin(2 * np.pi * hz * part.time) for hz in (3.0, 5.0)], axis=1)
    (found,) = signals.fresh([part])
    assert found.period == pytest.approx(6 * PERIOD)
    error = (found.torque - true[found.rows])[5:-5]
    assert error.std(axis=0).max() < 0.03
    rise = np.gradient(true[found.rows], found.period, axis=0)[5:-5]
    lag = -np.sum(error * rise, axis=0) / np.sum(rise**2, axis=0)
    np.testing.assert_allclose(lag, 0.0, atol=0.2e-3)


def test_a_torque_that_moves_with_every_sample_or_by_single_steps_is_not_held() -> None:
    """Coarse steps without noise stand for several samples too, but rise by one of them at a time."""
    part, true = held_log(1)
    assert signals.held(true, PERIOD) == 1
    assert signals.fresh([part]) == [part]
    smooth = np.sin(2 * np.pi * 0.5 * part.time)[:, None]
    assert signals.held(np.round(smooth / 0.02) * 0.02, PERIOD) == 1
    slow, _ = held_log(25)  # longer than any drive takes
    assert signals.fresh([slow]) == [slow]
    one, _ = held_log(4)
    mixed = np.stack([one.torque[:, 0], true[:, 1]], axis=1)
    assert signals.held(mixed, PERIOD) == 1
    still = np.zeros(len(true))
    assert signals.held(np.stack([one.torque[:, 0], still], axis=1), PERIOD) == 4  # a joint says nothing
    assert signals.held(still[:, None], PERIOD) is None


def test_a_torque_of_which_one_change_in_ten_is_late_is_read_off_between_them() -> None:
    """3 Hz made anew every 4 ms: where a change is 2 ms late, what stands there is off by up to 7 %."""
    true, number = np.sin(2 * np.pi * 3 * np.arange(4000) * PERIOD), np.arange(1000)
    updates = [4 * number, 4 * number + 2 * (number % 10 == 9)]
    torque = np.stack([np.repeat(true[at], np.diff(np.r_[at, 4000])) for at in updates], axis=1)
    (found,) = signals.fresh([replace(seen_of(4000), torque=torque)])
    assert found.period == pytest.approx(4 * PERIOD)
    np.testing.assert_allclose(found.torque[2:-2, 1], true[found.rows][2:-2], atol=2e-3)


def test_between_late_changes_a_torque_bends_and_beyond_them_it_stands() -> None:
    """20 Hz made anew every 6 ms, where a straight line between would be off by 7 % of it; the first second is rest."""
    time = np.arange(4000) * PERIOD
    true = np.where(time < 1.0, 0.0, np.sin(2 * np.pi * 20 * (time - 1.0)))
    torque = np.stack([true[np.arange(4000) // 6 * 6], true[(np.arange(4000) - 3) // 6 * 6 + 3]], axis=1)
    (found,) = signals.fresh([replace(seen_of(4000), torque=torque)])
    assert found.period == pytest.approx(6 * PERIOD)
    assert (found.rows % 6 == 3).all(), "when that of joint 2 comes"
    error = found.torque[:, 0] - true[found.rows]
    moves = (found.time > 1.05) & (found.time < 3.95)
    assert np.abs(error[moves]).max() < 0.02
    assert np.abs(found.torque).max() < 1.1


def test_what_is_fresh_is_thinned_as_all_is() -> None:
    part = seen(1.25e-4, 2.0, 0.0)
    noisy = replace(part, torque=np.random.default_rng(2).standard_normal((len(part.time), 1)))
    (found,) = signals.fresh([noisy])
    assert found.period == pytest.approx(1e-3)
    assert found.held == 0.0


def stairs(gaps: Sequence[int], sizes: Sequence[float] = (1.0, 2.0, 2.0)) -> np.ndarray:
    """(N, 1) N m that stands for so many samples each and then goes up and down by `sizes` in turn."""
    change = np.resize(sizes, len(gaps)) * np.resize([1.0, -1.0], len(gaps))
    return np.repeat(np.r_[0.0, np.cumsum(change)], [4, *gaps])[:, None]


@pytest.mark.parametrize(
    ("gaps", "sizes", "samples"),
    [
        ([4] * 20, (1.0, 2.0, 2.0), 4),
        ([4] * 19, (1.0, 2.0, 2.0), None),  # too few to tell
        ([4] * 20, (1.0, 1.6, 1.6), 4),
        ([4] * 20, (1.0, 1.4, 1.4), 1),  # by single steps
        ([4] * 20, (1.0, 1.0, 9.0), 1),  # mostly
        (([4] * 98 + [1] * 2) * 3, (1.0, 2.0, 2.0), 4),
        (([4] * 97 + [1] * 3) * 3, (1.0, 2.0, 2.0), 1),  # some follow each other at once
        (([4] * 4 + [2]) * 8, (1.0, 2.0, 2.0), 4),  # unevenly
        (([4] * 9 + [150]) * 4, (1.0, 2.0, 2.0), 4),  # at rest for a while
        ([20] * 20, (1.0, 2.0, 2.0), 20),
        ([21] * 20, (1.0, 2.0, 2.0), 1),
    ],
)
def test_a_torque_is_held_by_the_rhythm_and_the_size_of_its_changes(gaps, sizes, samples) -> None:
    assert signals.held(stairs(gaps, sizes), PERIOD) == samples


def test_the_joint_whose_torque_stands_shortest_tells() -> None:
    slow, quick = stairs([8] * 40), stairs([4] * 80)
    for both in ([slow, quick], [quick, slow]):
        assert signals.held(np.concatenate(both, axis=1), PERIOD) == 4


def test_a_joint_whose_torque_hardly_changes_is_read_as_it_stands() -> None:
    """No curve goes through a handful of changes at other times; the clock is that of most changes."""
    part, _ = held_log(4)
    rare = np.repeat([0.0, 1.0, 3.0, 2.0], [2, 999, 1000, 1999])
    part = replace(part, torque=np.stack([rare, part.torque[:, 1]], axis=1))
    (found,) = signals.fresh([part])
    assert found.period == pytest.approx(4 * PERIOD)
    assert found.rows[0] == 1
    np.testing.assert_array_equal(found.torque[:, 0], rare[found.rows])


def test_segments_of_a_machine_are_held_alike_or_none_is() -> None:
    """Those in which nothing changes go along; where some have it otherwise, the clock of most is for all."""
    one, _ = held_log(4)
    other, true = held_log(6)
    still = replace(one, torque=np.zeros(true.shape))
    assert [part.period for part in signals.fresh([one, still])] == pytest.approx([4 * PERIOD] * 2)
    assert [part.period for part in signals.fresh([one, other, other])] == pytest.approx([6 * PERIOD] * 3)
    assert [part.period for part in signals.fresh([one, one, other])] == pytest.approx([4 * PERIOD] * 3)
    plain = replace(one, torque=true)
    assert signals.fresh([one, plain, still]) == [one, plain, still]
    assert signals.fresh([still]) == [still]


def trace(count: int = 3000) -> Trace:
    time, theta, theta_dot, _ = swing(count)
    return Trace(Path("log.csv"), time, theta, theta_dot, flags=np.zeros(count, np.uint32))


def test_faults_and_gaps_split_a_trace() -> None:
    log = trace()
    log.flags[1000] |= SampleFlag.NOT_A_NUMBER
    log.flags[2000] |= SampleFlag.NO_COMMAND  # no harm
    log.position[1000] = np.nan
    log.time[2200:] += 0.01
    parts = signals.segments(log)
    assert [(part.rows[0], part.rows[-1]) for part in parts] == [(0, 999), (1001, 2199), (2200, 2999)]
    assert all(np.isfinite(part.theta_ddot).all() for part in parts)
    assert not parts[1].moving[:100].any()


@pytest.mark.parametrize("back", [0.0012, 0.1, 2.5])
def test_a_clock_that_is_set_back_splits_a_trace(back: float) -> None:
    """Wherever the stamps behind it fall: among those before, where they end, or before the first."""
    log = trace()
    log.time[1500:] -= back
    log.flags[1500] |= SampleFlag.TIME_BACKWARDS
    parts = signals.segments(log)
    assert [(part.rows[0], part.rows[-1]) for part in parts] == [(0, 1499), (1501, 2999)]
    for part in parts:
        expected = signals.smooth(log.position[part.rows], PERIOD)
        np.testing.assert_allclose(part.theta_ddot, expected[2])


def test_one_stamp_that_is_wrong_does_not_split_a_trace_in_two() -> None:
    log = trace()
    log.time[1500] -= 0.3
    log.flags[1500] |= SampleFlag.TIME_BACKWARDS
    assert [len(part.rows) for part in signals.segments(log)] == [1500, 1499], "as where any row is left out"
    log.time[1500] = log.time[1499] - 0.1 * PERIOD
    log.time[1501:] -= PERIOD  # two stamps changed places: nothing is missing
    assert [len(part.rows) for part in signals.segments(log)] == [2999]


def test_repeated_rows_are_left_out_without_a_cut() -> None:
    log = trace()
    keep = np.insert(np.arange(3000), 1500, 1499)
    log = Trace(log.path, log.time[keep], log.position[keep], log.torque[keep], flags=np.zeros(3001, np.uint32))
    log.flags[1500] |= SampleFlag.REPEATED
    (part,) = signals.segments(log)
    assert len(part.rows) == 3000
    assert 1500 not in part.rows


def test_nothing_usable_names_the_file() -> None:
    log = trace(1000)
    log.flags[::100] |= np.uint32(SampleFlag.BUS_FAULT)
    with pytest.raises(TraceError, match=r"log\.csv: the longest part without a fault lasts 0\.099 s"):
        signals.segments(log)


def test_a_joint_rests_where_it_stands_for_so_long_and_a_little_around() -> None:
    """Stops of 20 to 300 ms, run by run: slow for 40 ms or more, and 15 ms on both sides."""
    random = np.random.default_rng(7)
    speed, stands = [], []
    for duration in (20, 30, 38, 39, 40, 41, 42, 50, 80, 300) * 2:
        speed += [random.choice([-0.05, 0.05]) * np.ones(random.integers(200, 300)), np.zeros(duration)]
    speed = np.concatenate([*speed, 0.05 * np.ones(200)])
    position = np.stack([np.cumsum(speed), np.cumsum(speed[::-1])], axis=1) * PERIOD
    found = signals.moving(position, PERIOD)
    sections = butter(4, 60.0, fs=1 / PERIOD, output="sos")
    slow = np.abs(np.gradient(sosfiltfilt(sections, position, axis=0), PERIOD, axis=0)) < 0.01
    for joint in range(2):
        runs = [(rests, len(list(run))) for rests, run in groupby(slow[:, joint].tolist())]
        still = [n for rests, length in runs for n in [rests and length >= 40] * length]
        stands.append(sum(rests and length >= 40 for rests, length in runs))
        expected = [not any(still[max(0, n - 15) : n + 16]) for n in range(len(still))]
        np.testing.assert_array_equal(found[:, joint], expected)
    assert min(stands) > 3
    assert max(stands) < 18
    assert signals.moving(0.05 * np.arange(900.0)[:, None], 1e-2).all(), "samples too few for 60 Hz"


@pytest.mark.parametrize(("period", "cutoff"), [(1e-3, 12.0), (4e-3, 40.0)])
def test_a_lag_is_a_low_pass_of_straight_lines_and_a_lead_undoes_it(period: float, cutoff: float) -> None:
    time, theta, _, _ = swing(800, period)
    values = 3.0 + np.stack([theta, np.abs(theta)], axis=1)
    found = signals.lagging(values, cutoff, period)
    corner = 2 * np.pi * cutoff
    for place in np.ndindex(values.shape[1:]):
        column = values[:, *place]
        _, expected, _ = lsim(([corner], [1.0, corner]), column - column[0], time)
        np.testing.assert_allclose(found[:, *place] - column[0], expected, atol=1e-9)
    smooth = np.stack([theta, -theta], axis=1)
    back = signals.leading(signals.lagging(smooth, cutoff, period), cutoff, period)
    np.testing.assert_allclose(back[20:-20], smooth[20:-20], atol=3e-3 if period > 1e-3 else 2e-4)
    line = np.arange(50.0)[:, None]
    np.testing.assert_allclose(signals.leading(line, cutoff, period)[2:-2], line[2:-2] + 1 / (corner * period))


def test_a_part_counts_from_four_filters_ends_on_and_its_own_ends_do_not() -> None:
    log = trace(2200)
    cuts = [400, 801, 1201]  # parts of 400, 400, 399 rows and the rest
    log.flags[cuts] = SampleFlag.JUMP
    parts = signals.segments(log)
    assert [(part.rows[0], len(part.rows)) for part in parts] == [(0, 400), (401, 400), (1202, 998)]
    for part in parts:
        assert not part.moving[:100].any()
        assert part.moving[100:-100].all()
        assert not part.moving[-100:].any()
        assert (part.period, part.sampled) == (pytest.approx(PERIOD), part.period)
        np.testing.assert_allclose(part.time, log.time[part.rows])
        np.testing.assert_array_equal(part.torque, log.torque[part.rows])
        assert part.noise is not None
        np.testing.assert_allclose(part.noise, signals.position_noise(log.position[part.rows]))
        expected = signals.smooth(log.position[part.rows], PERIOD)
        for name, values in zip(("theta", "theta_dot", "theta_ddot"), expected, strict=True):
            np.testing.assert_allclose(getattr(part, name), values)


@pytest.mark.parametrize(("step", "count"), [(1.45, 1), (1.55, 2)])
def test_a_gap_is_more_than_half_a_sample_too_much(step: float, count: int) -> None:
    log = trace(1500)
    log.time[700:] += (step - 1) * PERIOD
    assert len(signals.segments(log)) == count


def test_one_usable_row_is_no_motion() -> None:
    log = trace(1000)
    log.flags[2:] = SampleFlag.OUT_OF_RANGE
    with pytest.raises(TraceError, match=r"log\.csv: the longest part"):
        signals.segments(log)
    log.flags[1:] = SampleFlag.OUT_OF_RANGE
    with pytest.raises(TraceError, match=r"log\.csv: 1 usable rows of 1000"):
        signals.segments(log)
    assert len(signals.segments(replace(log, flags=np.zeros(0, np.uint32)))) == 1, "a log without flags has none"


def test_logs_of_several_rates_are_named() -> None:
    one, other = seen(1e-3, 2.0, 0.0), seen(1.019e-3, 2.0, 0.0)
    assert signals.one_period([("a", one), ("b", other)]) == 1e-3
    with pytest.raises(DataError, match=r"c: 1.02 ms between samples, a has 1 ms"):
        signals.one_period([("a", one), ("b", other), ("c", seen(1.021e-3, 2.0, 0.0))])
    with pytest.raises(DataError, match=r"c: 0\.979 ms"):
        signals.one_period([("a", one), ("c", seen(0.979e-3, 2.0, 0.0))])


@pytest.mark.parametrize("width", [1, 2, 7, 30, 101])
@pytest.mark.parametrize(("ends", "reference"), [("edge", "nearest"), ("constant", "constant")])
def test_a_running_mean_is_that_of_scipy(width: int, ends: Literal["edge", "constant"], reference: str) -> None:
    values = np.random.default_rng(3).standard_normal((60, 2)) + 5.0
    expected = uniform_filter1d(values, width, axis=0, mode=reference)
    np.testing.assert_allclose(signals.running_mean(values, width, ends), expected, atol=1e-12)
    np.testing.assert_allclose(signals.running_mean(values[:, 1], width, ends), expected[:, 1], atol=1e-12)


@pytest.mark.parametrize("keep", [0.9, 0.99 * np.exp(0.05j)])
def test_a_recursion_is_scipys(keep):
    values = np.random.default_rng(5).normal(size=(400, 3))
    expected = lfilter([1.0], [1.0, -keep], values.astype(complex), axis=0)
    np.testing.assert_allclose(signals.recursion(values, keep), expected, rtol=1e-10, atol=1e-12)
