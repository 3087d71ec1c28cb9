"""The correction on logs kept out of everything: how far the gap shrinks there, with events and without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from schemas.diagnosis import Shrunk, Simulated, Unseen
from schemas.robot import Robot
from schemas.trace import Trace
from service.diagnosis.evidence import statistics
from service.diagnosis.findings import Findings
from service.identification.events import bursts, events_of, outside, rhythm
from service.identification.fit import Problem, evaluate
from service.identification.folds import Split
from service.model.description import described, digits
from service.model.hypothesis import Hypothesis
from service.model.parameters import Parameters
from service.model.scene import Recording
from service.model.signals import Band, segments, thin
from service.rollout.document import reached
from service.rollout.gap import has_windows, rollout
from service.rollout.robot import left_out


def unseen(findings: Findings, trace: Trace) -> Unseen:
    """The models of `findings`, as they stand, on `trace`.

    Raises:
        TraceError: no usable part, naming the file. PoseError: positions that are no pose of the robot.
    """
    known, corrected = findings.problem, findings.best.hypothesis
    mechanism = known.recordings[0].mechanism
    parts = [Recording(thin(part), mechanism, 0, trace.name) for part in segments(trace)]
    problem = Problem.of(parts, Band.of(parts[0].segment.period, known.band.cutoff_hz), known.sigma)
    found = events_of(problem, evaluate(problem, corrected).residuals)
    calm = replace(
        problem,
        rows=[
            rows & outside(part.name, part.segment.time[:: problem.band.step], found)[:, None]
            for part, rows in zip(parts, problem.rows, strict=True)
        ],
    )
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
    robot = findings.robot
    if not isinstance(robot, Robot) or not has_windows([trace]):
        return None
    robots = {}
    for name, hypothesis in (("before", findings.reference), ("after", findings.best.hypothesis)):
        robots[name] = described(robot, hypothesis, np.zeros(len(Parameters(hypothesis).values)), findings.noise)
    found = rollout(robots, [trace])
    before, after, floor = (reached(course) for course in (*found.courses, found.floor))
    return Simulated(
        horizon_s=found.horizon,
        windows=len(found.runs),
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
