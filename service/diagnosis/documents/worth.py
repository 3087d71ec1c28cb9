"""What a correction is worth to the estimator: identified and corrected description side by side, by process replay.

Where no logs with known loads are given, loads are simulated on a log as it was recorded: while all joints rest a mass
comes or goes, and the torque that the corrected model expects of it, measurement included, is added to the log's own.
So motion, friction, noise and everything that no model knows are the robot's, and the masses are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest

import numpy as np

from schemas.diagnosis import OnlineFigures, OnlineTrial
from schemas.errors import TraceError
from schemas.messages import PayloadEvent, SampleFlag
from schemas.questions import Question, as_delta
from schemas.robot import Robot
from schemas.trace import Trace
from service.diagnosis.documents.document import corrected, identified
from service.diagnosis.findings import Findings
from service.estimator.estimator import Estimator, Result, rate_of
from service.estimator.named_effects import carried
from service.identification.weighed_picks import BOUND_KG, BOUND_SHARE, Pick, Weighed, as_known
from service.model.description import digits, torque_along
from service.model.hypothesis import Hypothesis, inside_of
from service.model.mechanism import Mechanism, mechanism_of
from service.model.prediction import Motion, error_in_band, motion
from service.model.scene import Recording
from service.model.signals import ANALYSIS_HZ, delayed
from service.model.torque import reported

IN_TIME = 0.15  # s after a change from which on the mass has to be right
SEEN = 0.4  # s after a change in which an event is the change's; and the shortest time that a simulated load hangs
START = 0.5  # s at the beginning in which nothing changes: the filters settle
LOADS = (1 / 6, 1 / 2)  # of the greatest payload that the description allows, in turn
MOST_SAMPLES = 12_000  # replayed: a third of a second, with the smoothing and the loads
LATE = ("torque_delay", "torque_filter")  # of the reported torque alone: what is fed forward is for the drive, at once


@dataclass(frozen=True)
class Loaded:
    """A log in which the load is known. along: its smoothed motion. bare: the log before loads were simulated on it."""

    trace: Trace
    along: Motion
    mechanism: Mechanism
    picks: tuple[Pick, ...]
    bare: Trace | None

    @property
    def changes(self) -> list[tuple[float, float, float]]:
        """From a change to the next, s, and the mass there, kg; those at the very end are not judged."""
        end = float(self.trace.time[-1])
        edges = sorted({time for pick in self.picks for time in (pick.begin, pick.end) if time < end - SEEN})
        return [(start, stop, self._mass(start)) for start, stop in pairwise([*edges, end])]

    def _mass(self, time: float) -> float:
        return sum(pick.mass for pick in self.picks if pick.begin <= time < pick.end)


def online_trial(
    findings: Findings, logs: Sequence[Trace], tests: Sequence[Trace], loaded: Sequence[tuple[Trace, list[Pick]]] = ()
) -> OnlineTrial | None:
    """The trial; None of what no estimator is for. logs: of the fit. tests: logs kept out of everything; loads are
    simulated on one of them where there are any. loaded: logs in which it is known what was carried.

    Raises:
        TraceError: a log of `loaded` cannot be used, naming the file.
    """
    better = corrected(findings).answering(Question.PICKS)
    if better is None:
        return None
    terms = findings.best.hypothesis.terms
    if left_out := sorted({term.effect.name for term in terms if not carried(term.effect)}):
        return OnlineTrial(reason="not_carried", left_out=left_out)
    mechanism = mechanism_of(better)
    cases = [Loaded(trace, motion(trace), mechanism, tuple(picks), None) for trace, picks in loaded]
    if not cases:
        cases = _simulated(better, mechanism, tests or logs)
    if not any(case.changes for case in cases):
        return OnlineTrial(reason="no_rest")
    if not loaded and inside_of(terms).two_masses:  # a pick makes links swing, which only a robot does
        cases = [replace(case, trace=case.bare or case.trace, bare=None, picks=()) for case in cases]
    known = as_delta(identified(findings), Question.PICKS)
    best, floor = findings.best.hypothesis, _floor(findings)
    late = replace(best, terms=tuple(term for term in terms if term.effect.name in LATE))
    figures = [_figures(description, cases, late, floor) for description in (known, better)]
    return OnlineTrial(
        traces=[case.trace.name for case in cases],
        simulated=not loaded,
        held_out=bool(loaded or tests),
        seconds=digits(sum(float(case.trace.time[-1] - case.trace.time[0]) for case in cases)),
        changes=sum(len(case.changes) for case in cases),
        identified=figures[0],
        corrected=figures[1],
    )


def _simulated(robot: Robot, mechanism: Mechanism, traces: Sequence[Trace]) -> list[Loaded]:
    """Loads on the logs that have most rests for them, and none in which something is carried already."""
    found: list[tuple[list[float], Trace, Motion]] = []
    for trace in traces:
        try:
            along = motion(trace)
        except TraceError:
            continue
        if len(rests := _rests(trace, along)) > 1:
            found.append((rests, trace, along))
    masses = [share * robot.limits.max_payload_kg for share in LOADS]
    cases: list[Loaded] = []
    for rests, trace, along in sorted(found, key=lambda one: -len(one[0])):
        if cases and sum(len(case.trace) for case in cases) + len(trace) > MOST_SAMPLES:
            break
        picks = tuple(
            Pick(begin, end, masses[number % len(masses)])
            for number, (begin, end) in enumerate(zip_longest(rests[::2], rests[1::2], fillvalue=np.inf))
        )
        cases.append(Loaded(carrying(robot, trace, along, picks), along, mechanism, picks, trace))
    return cases


def _rests(trace: Trace, along: Motion) -> list[float]:
    """Times, s, at which all joints rest, far enough apart to tell what hangs there between them."""
    if (trace.flags & np.uint32(SampleFlag.LOADED)).any():
        return []
    still = ~along.moving.any(axis=1) & along.measured
    edges = np.flatnonzero(np.diff(still.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    found: list[float] = []
    for first, after in edges:
        middle = float(trace.time[(first + after - 1) // 2])
        soonest = found[-1] + SEEN if found else float(trace.time[0]) + START
        if soonest <= middle < float(trace.time[-1]) - SEEN:
            found.append(middle)
    return found


def carrying(robot: Robot, trace: Trace, along: Motion, picks: Sequence[Pick]) -> Trace:
    """`trace` as it would have been with `picks` on the platform: the torque of a heavier platform by the model of
    `robot`, effects and measurement included, less that of its own."""

    def torque(mass: float) -> np.ndarray:
        heavier = robot.mass.model_copy(update={"platform": robot.mass.platform + mass})
        carrier = robot.model_copy(update={"mass": heavier})
        return torque_along(carrier, trace.time, along.theta, along.theta_dot, along.theta_ddot)

    empty, load = torque(0.0), np.zeros(trace.torque.shape)
    for mass in {pick.mass for pick in picks}:
        more = torque(mass) - empty
        for pick in picks:
            if pick.mass == mass:
                rows = (trace.time >= pick.begin) & (trace.time < pick.end)
                load[rows] += more[rows]
    command = None if trace.torque_command is None else trace.torque_command + load
    return replace(trace, torque=trace.torque + load, torque_command=command)


def _floor(findings: Findings) -> float:
    """Rms of the noise in the band in which errors of feed-forward are taken, all joints, N m."""
    band = findings.problem.band.cutoff_hz
    return float(np.sqrt(np.mean(findings.problem.sigma**2) * ANALYSIS_HZ / band))


def _figures(robot: Robot, cases: Sequence[Loaded], late: Hypothesis, floor: float) -> OnlineFigures:
    """late: how the torque was measured."""
    right = false = known = trusted = 0
    squares = count = 0.0
    for case in cases:
        samples, result = _answered(robot, case, case.trace)
        found = as_known(samples, result.payload)
        clock = found.time - found.time[0] + case.trace.time[0]  # as the picks have it
        empty = clock < (case.changes[0][0] if case.changes else np.inf)
        for start, stop, mass in case.changes:
            rows = (clock >= start + IN_TIME) & (clock < stop)
            right += bool(np.all(np.abs(found.mass[rows] - mass) <= max(BOUND_SHARE * mass, BOUND_KG)))
            trusted, known = trusted + int(found.trusted[rows].sum()), known + int(rows.sum())
            empty |= rows & (mass == 0.0)
        false += _false_events(found, clock, case)
        if case.bare is not None:  # a load that was only added swings no link
            samples, result = _answered(robot, case, case.bare)
            empty[:] = True
        error = _feedforward_error(case, late, samples, result)[empty & case.along.measured]
        squares, count = squares + float(np.nansum(error**2)), count + float(np.isfinite(error).sum())
    error = float(np.sqrt(squares / count)) if count else np.nan
    return OnlineFigures(
        right=right, trusted=round(trusted / max(known, 1), 4), false_events=false,
        feedforward_nm=digits(error), feedforward_over_noise=digits(error / floor),
    )  # fmt: skip


def _false_events(found: Weighed, clock: np.ndarray, case: Loaded) -> int:
    """Events that no change shortly before explains."""
    changes = np.array([time for pick in case.picks for time in (pick.begin, pick.end)])
    events = clock[found.event != PayloadEvent.NONE]
    return int(sum(not np.any((events_at >= changes) & (events_at <= changes + SEEN)) for events_at in events))


def _answered(robot: Robot, case: Loaded, trace: Trace) -> tuple[np.ndarray, Result]:
    """Samples of `trace`, commanded to go where they went, and what the estimator answers to them."""
    samples = trace.samples()
    samples["position_command"] = case.along.theta
    return samples, Estimator(robot, *rate_of(samples)).run(samples)


def _feedforward_error(case: Loaded, late: Hypothesis, samples: np.ndarray, result: Result) -> np.ndarray:
    """(N, 3) N m in the band, NaN at rest: what was measured less what was fed forward for that cycle, as it would have
    been measured."""
    trace = case.bare or case.trace
    fed = trace.torque.copy()
    rows = np.searchsorted(samples["sequence"], result.feedforward["target_sequence"])
    there = rows < len(samples)
    there[there] &= samples["sequence"][rows[there]] == result.feedforward["target_sequence"][there]
    fed[rows[there]] = result.feedforward["torque"][there]
    scene = late.seen(Recording(case.along.parts[0], case.mechanism, 0, case.trace.name))
    fed = delayed(reported(scene, late, fed), late.base.timing, scene.period)
    return error_in_band(trace, case.along, fed)
