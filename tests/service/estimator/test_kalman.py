"""The filter and the fixed-lag smoother against filterpy's own, and their stability whatever is lost."""

import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from filterpy.kalman import KalmanFilter

from service.estimator.kalman import (
    EXPECTED_JERK,
    FILTER,
    JERK_TIME,
    ORDER,
    SLOT,
    SMALLEST_VARIANCE,
    TRACK,
    acceleration_variance_kernel,
    coast_kernel,
    design,
    keep_kernel,
    largest_innovation,
    predict_kernel,
    restart_kernel,
    smooth_kernel,
    update_kernel,
)  # fmt: skip
from service.estimator.stream import COAST_TIME

RESOLUTION = 2.4e-7
PERIODS = [4e-3, 2e-3, 1e-3, 2.5e-4, 1.25e-4]


def settings(period):
    record = np.zeros(1, FILTER)
    for name, value in design(period, RESOLUTION)._asdict().items():
        record[name] = value
    return record[0]


def reference(motion):
    """The same model in filterpy."""
    kalman = KalmanFilter(dim_x=ORDER, dim_z=1)
    kalman.F, kalman.Q, kalman.P = motion["transition"].copy(), motion["noise"].copy(), motion["first"].copy()
    kalman.H, kalman.R = np.eye(1, ORDER), np.array([[RESOLUTION**2]])
    return kalman


def run(motion, measured, gaps):
    """Filter (N, 3) positions, the gap before each in cycles; N slots of what the smoother keeps."""
    track, slots = np.zeros(1, TRACK)[0], np.zeros(len(measured), SLOT)
    restart_kernel(motion, track, measured[0])
    keep_kernel(track, 1, slots[0])
    for n in range(1, len(measured)):
        predict_kernel(motion, track, gaps[n])
        if np.isnan(measured[n]).any():
            coast_kernel(track, gaps[n])
        else:
            update_kernel(motion, track, measured[n])
        keep_kernel(track, gaps[n], slots[n])
    return slots


@pytest.mark.parametrize("period", PERIODS)
def test_the_model_is_discretised_as_filterpy_does(period):
    motion = settings(period)
    drift = np.diag(np.ones(ORDER - 1), 1)
    drift[-1, -1] = -1.0 / JERK_TIME
    drive = np.eye(ORDER)[:, [-1]] * EXPECTED_JERK * np.sqrt(2.0 / JERK_TIME)
    transition, noise = van_loan_discretization(drift, drive, period)
    np.testing.assert_allclose(motion["transition"], transition, rtol=1e-12, atol=1e-30)
    np.testing.assert_allclose(motion["noise"], noise, rtol=1e-9, atol=1e-12 * noise.max())


@pytest.mark.parametrize("loss", [0.0, 0.3], ids=["all there", "30 % lost"])
@pytest.mark.parametrize("period", [1e-3, 1.25e-4])
def test_filter_and_smoother_are_filterpys(period, loss):
    """Lost cycles as gaps, broken samples as cycles without a position; filterpy sees both as a missing measurement."""
    random = np.random.default_rng(0)
    count = 600
    time = np.arange(count) * period
    wave = 0.3 * np.sin(2 * np.pi * 3 * time[:, None] + np.arange(3))
    positions = wave + RESOLUTION * random.standard_normal((count, 3))
    lost = random.random(count) < loss
    lost[:2] = lost[-1] = False
    broken = random.random(count) < loss / 3
    broken[0] = False

    motion = settings(period)
    kept = np.flatnonzero(~lost)
    measured = np.where(broken[:, None], np.nan, positions)[kept]
    slots = run(motion, measured, np.diff(kept, prepend=-1))

    for joint in range(3):
        kalman = reference(motion)
        kalman.x = np.array([[positions[0, joint]], [0.0], [0.0], [0.0]])
        means, covariances = [kalman.x], [kalman.P]
        for n in range(1, count):
            kalman.predict()
            kalman.update(None if lost[n] or broken[n] else positions[n, joint])
            means.append(kalman.x)
            covariances.append(kalman.P)
        means, covariances = np.array(means), np.array(covariances)
        scale = np.abs(means[:, :, 0]).max(axis=0)
        assert (np.abs(slots["state"][:, joint] - means[kept, :3, 0]).max(axis=0) < 1e-6 * scale[:3]).all()

        # the fixed-lag estimate at n is the Rauch-Tung-Striebel estimate at n of a record that ends a lag later
        lag, smoothed = int(motion["lag"]), np.empty((3, 3))
        for row in (200, 333, len(kept) - 1 - lag):
            n, end = kept[row], kept[row + lag] + 1
            expected, spread, *_ = kalman.rts_smoother(
                means[:end], covariances[:end], Fs=[kalman.F] * end, Qs=[kalman.Q] * end
            )
            smooth_kernel(motion["transition"], slots, row + lag, lag, np.empty(ORDER), smoothed)
            assert (np.abs(smoothed[:, joint] - expected[n, :3, 0]) < 1e-5 * scale[:3]).all()
            variance = acceleration_variance_kernel(motion, slots, row + lag, lag, np.empty(ORDER))
            assert variance == pytest.approx(spread[n, 2, 2], rel=1e-3)
            if loss == 0.0:
                steady = max(spread[n, 2, 2], SMALLEST_VARIANCE)
                assert motion["acceleration_variance"] == pytest.approx(steady, rel=1e-3)


@pytest.mark.parametrize("newest", [0, 3, 7, 63])
def test_the_lag_line_is_a_ring(newest):
    """Wherever its newest cycle lies, what is smoothed is the same; some cycles came behind a gap."""
    motion, random = settings(1e-3), np.random.default_rng(5)
    gaps = random.choice([1, 1, 1, 2, 4], 64)
    slots = run(motion, 1e-2 * np.cumsum(random.standard_normal((64, 3)), axis=0), gaps)
    lag = int(motion["lag"])
    expected, smoothed = np.empty((3, 3)), np.empty((3, 3))
    smooth_kernel(motion["transition"], slots, 63, lag, np.empty(ORDER), expected)
    variance = acceleration_variance_kernel(motion, slots, 63, lag, np.empty(ORDER))
    turned = np.roll(slots, newest + 1)
    smooth_kernel(motion["transition"], turned, newest, lag, np.empty(ORDER), smoothed)
    np.testing.assert_array_equal(smoothed, expected)
    assert acceleration_variance_kernel(motion, turned, newest, lag, np.empty(ORDER)) == variance


def test_the_largest_innovation_is_filterpys_in_units_of_its_spread():
    motion, random = settings(1e-3), np.random.default_rng(1)
    measured = 1e-3 * np.cumsum(random.standard_normal((40, 3)), axis=0)
    track, joints = np.zeros(1, TRACK)[0], [reference(motion) for _ in range(3)]
    restart_kernel(motion, track, measured[0])
    for joint, kalman in enumerate(joints):
        kalman.x = np.array([[measured[0, joint]], [0.0], [0.0], [0.0]])
    for row in measured[1:]:
        predict_kernel(motion, track, 1)
        update_kernel(motion, track, row)
        for kalman, value in zip(joints, row, strict=True):
            kalman.predict()
            kalman.update(value)
        expected = max(abs(kalman.y[0, 0]) / kalman.S[0, 0] ** 0.5 for kalman in joints)
        assert largest_innovation(motion, track) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("period", "lag"), [(1e-3, 6), (1.25e-4, 48), (5e-5, 64), (0.02, 1)])
def test_the_jerk_is_expected_to_be_so_large_for_so_long(period, lag):
    """As a process that has run for ever: its variance, and what is left of it from sample to sample."""
    motion = design(period, RESOLUTION)
    kept = motion.transition[3, 3]
    assert kept == pytest.approx(np.exp(-period / JERK_TIME))
    assert motion.noise[3, 3] / (1 - kept**2) == pytest.approx(EXPECTED_JERK**2, rel=1e-6)
    assert (motion.lag, motion.resolution) == (lag, RESOLUTION)


def closed_loops(period, gaps, every=1):
    """Error from sample to sample, (I - K H) F^n, along a sequence of gaps, and the covariance after each `every`."""
    motion, track = settings(period), np.zeros(1, TRACK)[0]
    restart_kernel(motion, track, np.zeros(3))
    for number, gap in enumerate(gaps, 1):
        predict_kernel(motion, track, gap)
        update_kernel(motion, track, np.zeros(3))
        if number % every == 0:
            carried = np.linalg.matrix_power(motion["transition"], gap)
            yield (np.eye(ORDER) - np.outer(track["gain"], np.eye(ORDER)[0])) @ carried, track["covariance"].copy()


@pytest.mark.parametrize("period", PERIODS)
def test_every_gap_up_to_the_restart_is_stable(period):
    """Spectral radius of the steady state of every gap, below one by more than rounding."""
    for gap in range(1, int(COAST_TIME / period) + 2):
        count = 50 + 350 // gap
        ((closed, _),) = closed_loops(period, [gap] * count, count)
        assert np.abs(np.linalg.eigvals(closed)).max() < 0.999, gap


@pytest.mark.parametrize("period", PERIODS)
def test_any_sequence_of_gaps_forgets_its_errors(period):
    """Products of closed loops over random gaps: bounded all the way and gone in the end; covariance stays one."""
    random = np.random.default_rng(1)
    longest = int(COAST_TIME / period) + 1
    unit = np.sqrt(np.diag(settings(period)["first"]))
    for share in (0.01, 0.2, 0.5, 0.9):
        gaps = np.minimum(random.geometric(1 - share, 1500), longest)
        gaps[::50] = random.integers(1, longest + 1, len(gaps[::50]))
        product, largest = np.eye(ORDER), 0.0
        for closed, covariance in closed_loops(period, gaps):
            product = closed @ product
            largest = max(largest, np.abs(product / unit[:, None] * unit).max())
            deviation = np.sqrt(np.diag(covariance))
            assert np.linalg.eigvalsh(covariance / deviation[:, None] / deviation).min() > -1e-9
        assert largest < 1e6
        assert np.abs(product / unit[:, None] * unit).max() < 1e-6


def test_the_gain_of_one_cycle_diverges_over_a_gap():
    """What this filter must not do, and the test of it that fails: the gain of no gap applied after one."""
    ((closed, _),) = closed_loops(1e-3, [1] * 400, 400)
    transition = settings(1e-3)["transition"]
    assert np.abs(np.linalg.eigvals(closed @ transition)).max() > 3.0


def test_smoothing_halves_the_error_of_the_acceleration(make):
    """What the lag buys, on motion that is not the filter's own model."""
    known = make(2.0)
    motion = settings(1e-3)
    slots = run(motion, known.samples["position"], np.ones(2000, int))
    lag, smoothed = int(motion["lag"]), np.empty((1700, 3, 3))
    for n in range(1700):
        smooth_kernel(motion["transition"], slots, 200 + n + lag, lag, np.empty(ORDER), smoothed[n])
    true = known.theta_ddot[200:1900, 2]
    assert np.std(smoothed[:, 2, 2] - true) < 0.5 * np.std(slots["state"][200:1900, 2, 2] - true)
