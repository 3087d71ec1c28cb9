"""How far each model is off on a trace: mean and standard deviation of tau - tau_hat per joint."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.predict import error_in_band, motion, predict_along


@dataclass(frozen=True)
class Moments:
    """Sums over moving samples, per joint (3,): how many, of the error, N m, and of its square."""

    count: np.ndarray
    total: np.ndarray
    square: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return self.total / self.count

    @property
    def std(self) -> np.ndarray:
        return np.sqrt(np.maximum(self.square / self.count - self.mean**2, 0.0))

    @property
    def rms(self) -> np.ndarray:
        return np.sqrt(self.square / self.count)


@dataclass(frozen=True)
class Evaluation:
    """One trace. torque: model name -> (N, 3) N m, every row. errors: model name -> moments. unmeasured: rows left out
    for a fault; their motion is bridged and their torque predicted all the same."""

    trace: Trace
    torque: dict[str, np.ndarray]
    errors: dict[str, Moments]
    unmeasured: int


def evaluate(robot: Robot, trace: Trace) -> Evaluation:
    """Predict `trace` by every model that `robot` carries figures for and compare.

    Raises:
        TraceError: the trace cannot be used, naming the file.
        DataError: the robot carries an effect that is not known.
    """
    along = motion(trace)
    torque = predict_along(robot, trace, along)
    errors = {name: _moments(error_in_band(trace, along, values)) for name, values in torque.items()}
    return Evaluation(trace, torque, errors, int((~along.measured).sum()))


def pooled(moments: Iterable[Moments]) -> Moments:
    """All of `moments` as one."""
    parts = list(moments)
    return Moments(
        *(np.sum([getattr(part, field) for part in parts], axis=0) for field in ("count", "total", "square"))
    )


def _moments(error: np.ndarray) -> Moments:
    known = np.isfinite(error)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)  # a joint that only rests has no error
    return Moments(count, np.nansum(error, axis=0), np.nansum(error**2, axis=0))
