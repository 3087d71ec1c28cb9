"""The filter and the fixed-lag smoother against filterpy's own."""

import numpy as np
import pytest

from service.estimator.kalman import ORDER, design, filter_model, predict_kernel, update_kernel

RESOLUTION = 2.4e-7


@pytest.mark.parametrize("period", [1e-3, 2.5e-4, 1.25e-4])
def test_steady_state_filter_and_smoother_are_filterpys(period):
    random = np.random.default_rng(0)
    time = np.arange(600) * period
    measured = 0.3 * np.sin(2 * np.pi * 3 * time) + RESOLUTION * random.standard_normal(len(time))

    reference = filter_model(period, RESOLUTION)
    reference.x = np.array([[measured[0]], [0.0], [0.0], [0.0]])
    means, covariances, _, _ = reference.batch_filter(measured)

    gains = design(period, RESOLUTION)
    state, predicted = np.zeros(ORDER), np.zeros(ORDER)
    state[0] = measured[0]
    filtered, innovations = np.empty((len(time), ORDER)), np.empty(len(time))
    for n, value in enumerate(measured):
        predict_kernel(gains.transition, state, predicted)
        innovations[n] = value - predicted[0]
        update_kernel(gains.gain, predicted, innovations[n], state)
        filtered[n] = state
    scale = np.abs(filtered).max(axis=0)
    assert (np.abs(filtered - means[:, :, 0]).max(axis=0) < 1e-9 * scale).all()

    # the fixed-lag estimate at n is the Rauch-Tung-Striebel estimate at n of a record that ends a lag later
    lag = gains.lag
    for n in (200, 333, 500):
        end = n + lag + 1
        smoothed, *_ = reference.rts_smoother(means[:end], covariances[:end])
        ours = filtered[n] + gains.smoothing[:lag].T @ innovations[n + 1 : end]
        assert (np.abs(ours - smoothed[n, :, 0]) < 1e-7 * scale).all()


def test_smoothing_halves_the_error_of_the_acceleration(make, robot):
    """What the lag buys, on motion that is not the filter's own model."""
    known = make(2.0)
    gains = design(1e-3, robot.drive.position_resolution_rad)
    state, predicted = np.zeros(ORDER), np.zeros(ORDER)
    state[0] = known.samples["position"][0, 2]
    filtered, innovations = np.empty((len(known.theta), ORDER)), np.empty(len(known.theta))
    for n, value in enumerate(known.samples["position"][:, 2]):
        predict_kernel(gains.transition, state, predicted)
        innovations[n] = value - predicted[0]
        update_kernel(gains.gain, predicted, innovations[n], state)
        filtered[n] = state
    smoothed = np.array(
        [
            filtered[n] + gains.smoothing[: gains.lag].T @ innovations[n + 1 : n + 1 + gains.lag]
            for n in range(200, 1900)
        ]
    )
    true = known.theta_ddot[200:1900, 2]
    assert np.std(smoothed[:, 2] - true) < 0.5 * np.std(filtered[200:1900, 2] - true)


def test_gains_are_the_steady_state(robot):
    """One more Riccati step changes nothing."""
    kalman = filter_model(1e-3, RESOLUTION)
    before = kalman.P.copy()
    kalman.predict()
    kalman.update(kalman.H @ kalman.x)
    np.testing.assert_allclose(kalman.P, before, rtol=1e-9, atol=1e-12 * np.abs(before).max())
