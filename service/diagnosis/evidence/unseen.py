"""The correction on logs kept out of everything: how far the gap shrinks there, with events and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from schemas.diagnosis import Shrunk, Simulated, Unseen
from schemas.errors import NoWindowError
from schemas.questions import Question
from schemas.trace import Trace
from service.diagnosis.evidence import statistics
from service.diagnosis.findings import Findings
from service.identification.events import Event, bursts, events_of, outside, rhythm
from service.identification.fit import Problem, evaluate
from service.identification.folds import Split
from service.model.description import described, digits
from service.model.hypothesis import Hypothesis
from service.model.parameters import Parameters
from service.model.scene import Recording
from service.model.signals import Band, fresh, segments


def kept_out(known: Problem, trace: Trace) -> Problem:
    """A log as rows to compare, in the units of `known`, which it had no part in.

    Raises:
        TraceError: no usable part, naming the file.
    """
    mechanism = known.recordings[0].mechanism
    parts = [Recording(part, mechanism, 0, trace.name) for part in fresh(segments(trace))]
    return Problem.of(parts, Band.of(parts[0].segment.period, known.band.cutoff_hz), known.sigma)


def without_events(problem: Problem, found: Sequence[Event]) -> Problem:
    """The rows that no event touches."""
    rows = [
        rows & outside(part.name, part.segment.time[:: problem.band.step], found)[:, None]
        for part, rows in zip(problem.recordings, problem.rows, strict=True)
    ]
    return replace(problem, rows=rows)


def unseen(findings: Findings, trace: Trace) -> Unseen:
    """The models of `findings`, as they stand, on `trace`.

    Raises:
        TraceError: no usable part, naming the file. PoseError: positions that are no pose of the robot.
    """
    problem, corrected = kept_out(findings.problem, trace), findings.best.hypothesis
    found = events_of(problem, evaluate(problem, corrected).residuals)
    calm = without_events(problem, found)
    return Unseen(
        trace=trace.name,
        whole=_shrunk(problem, findings.reference, corrected),
        bursts=bursts(problem, found),
        rhythm_s=rhythm(found),
        outside=_shrunk(calm, findings.reference, corrected) if found and calm.count else None,
        outside_share=round(calm.count / max(problem.count, 1), 4),
        simulated=_simulated(findings, trace),
    )


def _simulated(findings: Findings, trace: Trace) -> Simulated | None:
    """The models before and after in the simulator, under the trace's torque."""
    from service.rollout.gap import cut_up, rollout
    from service.rollout.packed import left_out
    from service.rollout.rollout_page import reached

    robot = findings.robot.answering(Question.COMMANDS)
    if robot is None:
        return None
    robots = {}
    for name, hypothesis in (("before", findings.reference), ("after", findings.best.hypothesis)):
        robots[name] = described(robot, hypothesis, np.zeros(len(Parameters(hypothesis).values)), findings.noise)
    try:
        found = rollout(robots, cut_up(robots, [trace]))
    except NoWindowError:  # there is nothing to simulate
        return None
    before, after, floor = (reached(deviation) for deviation in (*found.deviations, found.floor))
    return Simulated(
        horizon_s=found.cuts.horizon,
        windows=len(found.cuts.runs),
        path_mm=round(found.floor.path_mm, 3),
        platform_before_mm=before.platform_mm,
        platform_after_mm=after.platform_mm,
        platform_floor_mm=floor.platform_mm,
        joint_before_mrad=before.joint_mrad,
        joint_after_mrad=after.joint_mrad,
        left_out=left_out(robots["after"]),
    )


def _shrunk(problem: Problem, reference: Hypothesis, corrected: Hypothesis) -> Shrunk:
    split = Split.of(problem)
    before, after = (evaluate(problem, hypothesis).residuals for hypothesis in (reference, corrected))
    shrink = statistics.shrink(
        statistics.pooled_squares(problem, before, split), statistics.pooled_squares(problem, after, split)
    )
    return Shrunk(
        before_nm=[digits(value) for value in statistics.rms_per_joint(problem, before)],
        after_nm=[digits(value) for value in statistics.rms_per_joint(problem, after)],
        shrink=shrink.value,
        shrink_ci95=(shrink.low, shrink.high),
    )
