"""Events: short stretches in which the gap stands far above the rest of its runs, and whether they keep a rhythm.

A model's own errors are slow or belong to a state; a knock, a slip, an injected pulse is fast and belongs to a moment.
So a running mean is taken out before the level of what is left is held against its median over all runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.diagnosis import Burst
from service.identification.fit import Problem
from service.model.signals import running_mean

SLOW = 0.12  # s of the running mean that is taken out
WIDTH = 0.06  # s over which the level is taken
RATIO = 3.5  # to the median of the level
JOIN = 0.06  # s: stretches nearer than this are one
PAD = 0.03  # s on both sides that an event may still touch
BREAK = 0.05  # s without a row end a run's stretch
FLOOR = 2.0  # times the noise that an event at least is
LEAST_BEATS = 6  # events that make a rhythm
IN_STEP = 0.8  # mean resultant of their phases, 1 where all keep it
FILLED = 0.5  # of its beats have to have an event


@dataclass(frozen=True)
class JointRun:
    """The rows of one joint (from 0) in one run while it moves. time: (R,) s, rising. error: (R,) N m or N."""

    name: str
    joint: int
    time: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Event:
    """A stretch of one run and joint (from 0). level: highest rms of the fast part of the gap in it, N m or N."""

    run: str
    joint: int
    start: float
    end: float
    level: float


def events(runs: Sequence[JointRun], floor: np.ndarray) -> list[Event]:
    """Events of all `runs`, in the order of time. floor: (n,) level a joint below which nothing is one."""
    found: list[Event] = []
    for joint in {run.joint for run in runs}:
        mine = [run for run in runs if run.joint == joint and len(run.time) > 1]
        levels = [_level(run) for run in mine]
        if not mine:
            continue
        limit = max(RATIO * float(np.median(np.concatenate(levels))), float(floor[joint]))
        for run, level in zip(mine, levels, strict=True):
            found += _stretches(run, level, limit)
    return sorted(found, key=lambda event: (event.run, event.start, event.joint))


def _level(run: JointRun) -> np.ndarray:
    """(R,) rms of the fast part of the error around each row."""
    period = float(np.median(np.diff(run.time)))
    parts = np.split(run.error, np.flatnonzero(np.diff(run.time) > BREAK) + 1)
    slow, width = max(1, round(SLOW / period)), max(1, round(WIDTH / period))
    fast = [part - running_mean(part, slow) for part in parts]
    squares = np.concatenate([running_mean(part**2, width) for part in fast])
    return np.sqrt(np.maximum(squares, 0.0))  # a running sum that rounds: below none behind a strong event


def _stretches(run: JointRun, level: np.ndarray, limit: float) -> list[Event]:
    hot = np.flatnonzero(level > limit)
    if not len(hot):
        return []
    parts = np.split(hot, np.flatnonzero(np.diff(run.time[hot]) > JOIN) + 1)
    return [
        Event(run.name, run.joint, float(run.time[part[0]]), float(run.time[part[-1]]), float(level[part].max()))
        for part in parts
    ]


def outside(run: str, time: np.ndarray, found: Sequence[Event]) -> np.ndarray:
    """(N,) bool: moments `time` (N,) s of `run` that no event touches, on whichever joint it was seen."""
    free = np.ones(len(time), bool)
    for event in found:
        if event.run == run:
            free &= (time < event.start - PAD) | (time > event.end + PAD)
    return free


def rhythm(found: Sequence[Event]) -> float | None:
    """Period in s that most events of one run keep, the longest there is; None where there is none."""
    moments = np.array([0.5 * (event.start + event.end) for event in found])
    if len(moments) < LEAST_BEATS:
        return None
    span = float(np.ptp(moments))
    most = len(moments) / FILLED / span  # beats a second
    periods = 1.0 / np.arange(LEAST_BEATS / 2 / span, most, 0.1 / span)
    together = np.abs(np.mean(np.exp(2j * np.pi * moments / periods[:, None]), axis=1))
    best = int(np.argmax(together > IN_STEP))  # the longest comes first
    if together[best] <= IN_STEP:
        return None
    near = slice(best, best + 8)
    return float(periods[near][np.argmax(together[near])])


def events_of(problem: Problem, residuals: Sequence[np.ndarray]) -> list[Event]:
    """Events in `residuals`, (R,) a recording, in units of the noise."""
    runs = []
    for recording, rows, residual, joints in zip(
        problem.recordings, problem.rows, residuals, problem.joints_of_rows, strict=True
    ):
        time = recording.segment.time[:: problem.band.step]
        for joint, sigma in enumerate(problem.sigma):
            runs.append(JointRun(recording.name, joint, time[rows[:, joint]], residual[joints == joint] * sigma))
    return events(runs, FLOOR * problem.sigma)


def bursts(problem: Problem, found: Sequence[Event]) -> list[Burst]:
    """Events as the documents say them."""
    return [
        Burst(
            run=event.run,
            joint=event.joint + 1,
            from_s=round(event.start, 3),
            to_s=round(event.end, 3),
            over_noise=round(event.level / float(problem.sigma[event.joint]), 2),
        )
        for event in found
    ]
