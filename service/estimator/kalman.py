"""Joint motion from joint position: a steady-state Kalman filter a joint, with a fixed-lag smoother on the same gains.

State: position, velocity, acceleration and jerk. The jerk is a first-order Markov process, which is what "expected
jerk" means physically: of a given rms, changing over a given time. filterpy designs the filter (van Loan
discretisation, Riccati recursion to the steady state); the kernel here only runs it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from filterpy.common import van_loan_discretization
from filterpy.kalman import KalmanFilter
from numba import njit

ORDER = 4  # position, velocity, acceleration, jerk

# A pick-and-place at 10 g asks 1000 to 1500 rad/s^3 rms of a joint, with peaks of 8000; twice that leaves headroom.
EXPECTED_JERK = 3000.0  # rad/s^3
# Motion profiles change their jerk within some hundredths of a second.
JERK_TIME = 0.02  # s

# A fixed lag behind the newest sample at which a smoothed acceleration is worth more than a fresh one: the payload
# branch can wait for it, the feed-forward torque cannot.
SMOOTHING_LAG = 0.006  # s
MAX_LAG = 64  # samples; 8 kHz x 6 ms = 48


class MotionFilter(NamedTuple):
    """Steady-state gains at one sample rate.

    transition: (4, 4). gain: (4,) on the innovation. smoothing: (MAX_LAG, 4), row n is what the innovation n + 1
    samples later adds to a filtered state. lag: samples. variance: (4,) steady-state variance of the filtered state.
    """

    transition: np.ndarray
    gain: np.ndarray
    smoothing: np.ndarray
    lag: int
    variance: np.ndarray


def filter_model(period: float, resolution: float) -> KalmanFilter:
    """The filterpy filter of one joint, with steady-state covariance.

    period: s. resolution: rad, one encoder count at the joint, taken as the standard deviation of a position sample
    (quantisation is 0.29 of it; the rest is the encoder's own noise).
    """
    drift = np.zeros((ORDER, ORDER))
    drift[0, 1] = drift[1, 2] = drift[2, 3] = 1.0
    drift[3, 3] = -1.0 / JERK_TIME
    drive = np.zeros((ORDER, 1))
    drive[3, 0] = EXPECTED_JERK * np.sqrt(2.0 / JERK_TIME)
    transition, noise = van_loan_discretization(drift, drive, period)
    kalman = KalmanFilter(dim_x=ORDER, dim_z=1)
    kalman.F = np.asarray(transition, np.float64)
    kalman.Q = np.asarray(noise, np.float64)
    kalman.H = np.eye(1, ORDER)
    kalman.R = np.array([[resolution**2]])
    kalman.P = np.diag(np.array([resolution, 1.0, 10.0, EXPECTED_JERK]) ** 2)
    for _ in range(10_000):
        before = kalman.P
        kalman.predict()
        kalman.update(kalman.H @ kalman.x)
        if np.abs(kalman.P - before).max() <= 1e-14 * np.abs(kalman.P).max() and np.allclose(
            np.diag(kalman.P), np.diag(before), rtol=1e-13
        ):
            break
    return kalman


def design(period: float, resolution: float) -> MotionFilter:
    """Gains for samples every `period` s of an encoder with `resolution` rad at the joint."""
    kalman = filter_model(period, resolution)
    kalman.predict()
    gain = (kalman.P_prior @ kalman.H.T / (kalman.H @ kalman.P_prior @ kalman.H.T + kalman.R)).ravel()
    spread = float((kalman.H @ kalman.P_prior @ kalman.H.T + kalman.R).item())
    closed = kalman.F @ (np.eye(ORDER) - np.outer(gain, kalman.H))  # error of one prediction to the next
    lag = max(1, min(MAX_LAG, round(SMOOTHING_LAG / period)))
    smoothing = np.zeros((MAX_LAG, ORDER))
    # cov(filtered state, innovation n + 1 later) / var(innovation)
    carried = kalman.P_post @ kalman.F.T
    for n in range(lag):
        smoothing[n] = (carried @ kalman.H.T).ravel() / spread
        carried = carried @ closed.T
    return MotionFilter(kalman.F.copy(), gain, smoothing, lag, np.diag(kalman.P_post).copy())


@njit(cache=True)
def predict_kernel(transition, state, predicted):
    """predicted = transition @ state, both (4,)."""
    for row in range(ORDER):
        total = 0.0
        for column in range(ORDER):
            total += transition[row, column] * state[column]
        predicted[row] = total


@njit(cache=True)
def update_kernel(gain, predicted, innovation, state):
    """state = predicted + gain * innovation."""
    for row in range(ORDER):
        state[row] = predicted[row] + gain[row] * innovation
