"""The estimator as an object: a robot description, a sample period and the state, around one compiled step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.errors import DataError
from schemas.messages import FEEDFORWARD, MODEL_ERROR, PAYLOAD, SAMPLE, stamp_ns
from schemas.robot import Robot
from service.estimator import state
from service.estimator.step import run_kernel

# Samples from which the period is read. Stamps of a bus jitter; the median of this many does not.
PERIOD_SAMPLES = 16


class Result(NamedTuple):
    """Records of `schemas.messages`, oldest first: one `feedforward` a sample,
    `payload` and `error` a fixed lag later."""

    feedforward: np.ndarray
    payload: np.ndarray
    error: np.ndarray


class Estimator:
    """Consumes samples in the order they come; the same samples give the same bits, one by one or in any batches."""

    def __init__(self, robot: Robot, period: float) -> None:
        """robot: with its identified parameters. period: s between samples."""
        self.period = period
        self._settings = state.settings(robot, period)
        self._state = state.fresh()

    def run(self, samples: np.ndarray) -> Result:
        """Take (N,) records of SAMPLE."""
        count = len(samples)
        feedforward = np.empty(count, FEEDFORWARD.dtype)
        payload, error = np.empty(count, PAYLOAD.dtype), np.empty(count, MODEL_ERROR.dtype)
        lagged = run_kernel(self._settings, self._state, samples, feedforward, payload, error)
        return Result(feedforward, payload[:lagged], error[:lagged])

    def plan(self, reference: np.void) -> None:
        """Take one REFERENCE record: while it lies ahead, the feed-forward torque is for its motion."""
        self._state["reference_sequence"] = reference["sequence"]
        for row, name in enumerate(("position", "velocity", "acceleration")):
            self._state["reference"][0, row] = reference[name]
        self._state["reference_valid"] = np.isfinite(self._state["reference"]).all()

    def warm_up(self) -> None:
        """Compile, without touching the state, so that the first live sample is not seconds late."""
        run_kernel(
            self._settings,
            state.fresh(),
            SAMPLE.empty(1),
            np.empty(1, FEEDFORWARD.dtype),
            np.empty(1, PAYLOAD.dtype),
            np.empty(1, MODEL_ERROR.dtype),
        )


def period_of(samples: np.ndarray) -> float:
    """Sample period in s from the stamps and sequence numbers of the first samples, to the microsecond.

    Raises:
        DataError: the stamps do not rise.
    """
    first = samples[:PERIOD_SAMPLES]
    steps = np.diff(first["sequence"].astype(np.int64))
    rising = steps > 0
    if not rising.any():
        raise DataError(f"no sample period: {len(first)} samples with sequence numbers that do not rise")
    period = round(float(np.median(np.diff(stamp_ns(first))[rising] / steps[rising])) * 1e-3) * 1e-6
    if period <= 0:
        raise DataError(f"no sample period: the stamps of the first {len(first)} samples do not rise")
    return period
