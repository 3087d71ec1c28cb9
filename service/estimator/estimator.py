"""The estimator as an object: a robot description, a sample period and the state, around one compiled step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.errors import DataError
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, REFERENCE, SAMPLE, stamp_ns
from schemas.robot import Robot
from service.estimator import state
from service.estimator.feedforward import plan_kernel
from service.estimator.step import run_kernel

# Samples from which the period is read. Stamps of a bus jitter; the median of this many does not.
PERIOD_SAMPLES = 16
SHORTEST_PERIOD = 2e-5  # s, below it there is no drive's cycle
LONGEST_PERIOD = 0.1  # s, above it there is no motion to follow
# This share of the steps in sequence must be a multiple of a stride; of random losses far less are.
STRIDE_SHARE = 0.8


class Result(NamedTuple):
    """Records of `schemas.messages`, oldest first: one `feedforward` a sample,
    `payload` and `error` a fixed lag later."""

    feedforward: np.ndarray
    payload: np.ndarray
    error: np.ndarray


class Rate(NamedTuple):
    """period: s between samples. stride: sequence numbers between them, more than 1 where every n-th was kept."""

    period: float
    stride: int


class Estimator:
    """Consumes samples in the order they come; the same samples give the same bits, one by one or in any batches."""

    def __init__(self, robot: Robot, period: float, stride: int = 1) -> None:
        """robot: with its identified parameters. period, stride: of its samples, as `rate_of` reads them."""
        self.period, self.stride = period, stride
        self._settings = state.settings(robot, period, stride)
        self._state = state.fresh(self._settings)

    def run(self, samples: np.ndarray) -> Result:
        """Take (N,) records of SAMPLE."""
        count = len(samples)
        feedforward = np.empty(count, FEEDFORWARD.dtype)
        payload, error = np.empty(count, PAYLOAD.dtype), np.empty(count, MODEL_ERROR.dtype)
        lagged = run_kernel(self._settings, self._state, samples, feedforward, payload, error)
        return Result(feedforward, payload[:lagged], error[:lagged])

    def plan(self, reference: np.void) -> None:
        """Take one REFERENCE record: while it lies ahead, the feed-forward torque is for its motion.

        One that no joint could follow is not taken, and the next feed-forward says so in its flags.
        """
        plan_kernel(self._settings[0], self._state[0], reference)

    @property
    def state(self) -> np.void:
        """The STATE record: everything that is remembered from sample to sample."""
        return self._state[0]

    def warm_up(self) -> None:
        """Compile, without touching the state, so that the first live sample is not seconds late."""
        fresh = state.fresh(self._settings)
        plan_kernel(self._settings[0], fresh[0], REFERENCE.empty(1)[0])
        run_kernel(
            self._settings,
            fresh,
            SAMPLE.empty(1),
            np.empty(1, FEEDFORWARD.dtype),
            np.empty(1, PAYLOAD.dtype),
            np.empty(1, MODEL_ERROR.dtype),
        )


def rate_of(samples: np.ndarray) -> Rate:
    """Sample period, to the microsecond, and stride from the stamps and sequence numbers of the first samples.

    Raises:
        DataError: the stamps do not rise, or faster than any drive, or slower than any controller.
    """
    first = samples[:PERIOD_SAMPLES]
    steps = np.diff(first["sequence"]).astype(np.int64)  # modulo 2^64
    rising = steps > 0
    if not rising.any():
        raise DataError(f"no sample period: {len(first)} samples with sequence numbers that do not rise")
    steps = steps[rising]
    stride = max([1, *(int(step) for step in set(steps) if np.mean(steps % step == 0) >= STRIDE_SHARE)])
    period = round(float(np.median(np.diff(stamp_ns(first))[rising] / steps) * stride) * 1e-3) * 1e-6
    if period <= 0:
        raise DataError(f"no sample period: the stamps of the first {len(first)} samples do not rise")
    if period < SHORTEST_PERIOD:
        raise DataError(f"sample period {period * 1e6:g} us: no drive is faster than {SHORTEST_PERIOD * 1e6:g} us")
    if period > LONGEST_PERIOD:
        raise DataError(f"sample period {period:g} s: no controller is slower than {LONGEST_PERIOD:g} s")
    return Rate(period, stride)
