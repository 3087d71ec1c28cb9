"""How far each model is off on a trace: mean and standard deviation of tau - tau_hat per joint."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from schemas.axes_description import Description
from schemas.messages import PayloadEvent
from schemas.questions import Question
from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.events import Event, JointRun, events, outside
from service.identification.frequency import MEASURED, Spectra, spectra_of
from service.identification.held import held_s
from service.model.dynamics import PAYLOAD, torque_terms
from service.model.nominal import pack
from service.model.prediction import FULL, Motion, error_in_band, motion, predict_along, rows_of
from service.model.signals import between

WITH_PAYLOAD = "full, m_p estimated"


@dataclass(frozen=True)
class Moments:
    """Sums over moving samples, per joint (n,): how many, of the error, N m or N, and of its square."""

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
    """One trace. torque: model name -> (N, n) N m, every row. errors: model name -> moments. unmeasured: rows left out
    for a fault; their motion is bridged and their torque predicted all the same. Where something was picked, `errors`
    has one more entry, WITH_PAYLOAD: the fullest model with the payload mass as the estimator knew it at each sample.
    events: of the last of `errors`. calm: as `errors`, outside them. held: s for which each torque stood in the trace,
    0 where it did not. band_hz: below which errors count. spectra: measured, and by
    model name, over all parts between faults.
    """

    trace: Trace
    torque: dict[str, np.ndarray]
    errors: dict[str, Moments]
    unmeasured: int
    events: list[Event]
    calm: dict[str, Moments]
    held: float
    band_hz: float
    spectra: dict[str, Spectra]

    @property
    def calm_share(self) -> float:
        """Of the motion, what lies outside events."""
        whole, free = (next(iter(moments.values())).count for moments in (self.errors, self.calm))
        return float(np.nansum(free) / np.nansum(whole))


def evaluate(robot: Description, trace: Trace) -> Evaluation:
    """Predict `trace` by every model that `robot` carries figures for and compare.

    Raises:
        TraceError: the trace cannot be used, naming the file.
        DataError: the robot carries an effect that is not known, or describes axes without figures.
    """
    along = motion(trace)
    torque = predict_along(robot, trace, along)
    errors = {name: error_in_band(trace, along, values) for name, values in torque.items()}
    carried = None
    picking = robot.answering(Question.PICKS)
    if picking is not None and robot.identified is not None:
        carried = _carried(picking, trace, along)
    if carried is not None:
        errors[WITH_PAYLOAD] = error_in_band(trace, along, torque[FULL] + carried)
    # a model without friction misses every reversal: those are no events
    found = _events(trace, list(errors.values())[-1]) if robot.identified is not None else []
    free = outside(trace.name, trace.time, found)[:, None]
    return Evaluation(
        trace,
        torque,
        {name: _moments(error) for name, error in errors.items()},
        int((~along.measured).sum()),
        found,
        {name: _moments(np.where(free, error, np.nan)) for name, error in errors.items()},
        held_s(along.parts),
        along.band_hz,
        _spectra(trace, along, torque),
    )


def _spectra(trace: Trace, along: Motion, torque: dict[str, np.ndarray]) -> dict[str, Spectra]:
    found: dict[str, Spectra] = {}
    for part in along.parts:
        rows = rows_of(part, trace)
        at = {name: between(part.time, trace.time[rows], values[rows]) for name, values in torque.items()}
        for name, values in ({MEASURED: part.torque} | at).items():
            mine = spectra_of(values, part.theta_dot, part.period)
            found[name] = found[name] + mine if name in found else mine
    return found


def _events(trace: Trace, error: np.ndarray) -> list[Event]:
    known = np.isfinite(error)
    runs = [JointRun(trace.name, j, trace.time[known[:, j]], error[known[:, j], j]) for j in range(error.shape[1])]
    return events(runs, np.zeros(error.shape[1]))


def _carried(robot: Robot, trace: Trace, along: Motion) -> np.ndarray | None:
    """Torque (N, 3), N m, of the payload as the online estimator weighs it; None where it saw no pick."""
    from service.identification.weighed_picks import weighed  # and the estimator with it, which `identify` does without

    found = weighed(robot, trace)
    if not (found.event == PayloadEvent.PICK).any():
        return None
    newest = np.maximum.accumulate(np.where(found.trusted, np.arange(len(found.mass)), -1))
    held = np.where(newest >= 0, found.mass[newest], 0.0)
    mass = np.minimum(held, found.mass)  # trusted once, and not lighter since: as tau_FF reckons with it
    terms = torque_terms(pack(robot), along.theta, along.theta_dot, along.theta_ddot)
    return mass[:, None] * terms[:, PAYLOAD]


def pooled(moments: Iterable[Moments]) -> Moments:
    """All of `moments` as one."""
    parts = list(moments)
    return Moments(
        *(np.sum([getattr(part, field) for part in parts], axis=0) for field in ("count", "total", "square"))
    )


def pooled_by_model(results: Sequence[Evaluation], which: Literal["errors", "calm"] = "errors") -> dict[str, Moments]:
    """The moments of each model over all `results`: of all their rows, or of those outside events."""
    figures: list[dict[str, Moments]] = [getattr(result, which) for result in results]
    names = dict.fromkeys(name for errors in figures for name in errors)
    # a trace without a pick has no entry with a payload: there the fullest model stands for itself
    return {
        name: pooled(errors.get(name, errors.get(FULL, next(iter(errors.values())))) for errors in figures)
        for name in names
    }


def _moments(error: np.ndarray) -> Moments:
    known = np.isfinite(error)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)  # a joint that only rests has no error
    return Moments(count, np.nansum(error, axis=0), np.nansum(error**2, axis=0))
