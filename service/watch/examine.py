"""What has changed between two stretches of motion."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from drivers.trace import write_trace
from schemas.axes_description import Description, load_description
from schemas.diagnosis import NamedEffect, named_joints, placed
from schemas.files import make_folder, write_text
from schemas.finding import WatchFinding
from schemas.trace import Trace
from schemas.words import words
from service.diagnosis.documents.document import corrected, document
from service.diagnosis.documents.text import rms
from service.diagnosis.pipeline import diagnose
from service.identification.fit import evaluate
from service.model.effects import catalogue
from service.model.effects.base import Effect
from service.watch.changed_effect import changes
from service.watch.kept import flagged
from service.watch.state_machine import Rise

BEFORE_PARTS, AFTER_PARTS = 2, 3  # runs that each is taken for, one left out at a time
WORDS = 2  # quantities of an effect that the line tells
CLOCK_S = 1e9  # bus time above that is a date


def stand_back(niceness: int) -> None:
    """Of a process that examines: whatever is real time has the processor first, and Ctrl-C is its parent's."""
    os.nice(niceness)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def report(description: Path, effects: Path | None, folder: Path, rise: Rise) -> WatchFinding:
    """Examine, and leave the finding and the motion behind it in `folder`.

    Raises:
        DeltatwinError: a file cannot be written, or `examine` gave up.
    """
    robot = load_description(description, effects)
    make_folder(folder)
    for name, trace in (("before", rise.before), ("after", rise.after)):
        if trace is not None:
            write_trace(trace, folder / f"{name}.mcap", robot.name)
    finding = examine(robot, rise, catalogue(effects))
    write_text(folder / "finding.json", finding.model_dump_json(indent=1, by_alias=True))
    return finding


def examine(robot: Description, rise: Rise, effects: Sequence[Effect]) -> WatchFinding:
    """Find out which of `effects` came between before and after; where there is no before, what the description lacks.

    Raises:
        TraceError, DataError, PoseError: as `diagnose`.
    """
    parts, known, first = _parts(rise.after, AFTER_PARTS, robot), robot, 0
    if rise.before is not None:
        earlier, first = _parts(rise.before, BEFORE_PARTS, robot), BEFORE_PARTS
        known = standing(robot, earlier, effects)
        parts, effects = earlier + parts, changes(effects, first)
    found = diagnose(known, parts, effects)
    late = [int(recording.trace >= first) for recording in found.problem.recordings]
    best = found.best.hypothesis
    without = evaluate(found.problem, replace(best, terms=best.terms[: len(found.given)])).residuals
    epoch = rise.after.epoch_ns * 1e-9
    before_nm, after_nm = found.problem.rms(without, late)
    finding = WatchFinding(
        schema="deltatwin.finding/1",
        robot=robot.name,
        since_s=round(epoch + rise.since, 3),
        until_s=round(epoch + float(rise.after.time[-1]), 3),
        joints=(np.flatnonzero(rise.joints) + 1).tolist(),
        before_nm=_rounded(before_nm),
        after_nm=_rounded(after_nm),
        left_nm=_rounded(found.problem.rms(found.best.fitted.residuals, late)[1]),
        floor_nm=_rounded(found.problem.sigma),
        compared=rise.before is not None,
        text="",
        diagnosis=document(found),
    )
    return finding.model_copy(update={"text": in_words(finding)})


def standing(robot: Description, before: Sequence[Trace], effects: Sequence[Effect]) -> Description:
    """The description with what it lacked already: else something that came on would stand in for it.

    Raises:
        TraceError, DataError, PoseError: as `diagnose`.
    """
    if diagnose(robot, before, ()).verdict == "within_noise":
        return robot
    return corrected(diagnose(robot, before, effects))


def in_words(finding: WatchFinding) -> str:
    """The finding in one line."""
    rise = f"{finding.robot}: gap of {named_joints(finding.joints)} higher since {_when(finding.since_s)}"
    verdict, effects = finding.diagnosis.verdict, finding.diagnosis.effects
    if effects:
        after, left = rms(finding.after_nm), rms(finding.left_nm)  # as `diagnose` tells it of these stretches
        unit = finding.diagnosis.gap.unit
        rest = "" if verdict == "explained" else "; part of it remains unexplained"
        gap = f"the correction reduces the gap from {after:.3g} to {left:.3g} {unit} rms"
        return f"{rise}: {'; '.join(map(_effect, effects))}; {gap}{rest}"
    if verdict == "within_noise":
        return f"{rise}, but within the noise of the stretch examined"
    said = [words(caution.code) for caution in finding.diagnosis.cannot_tell]
    return f"{rise}: no effect of the catalogue explains it{f' ({said[0]})' if said else ''}"


def _when(seconds: float) -> str:
    if seconds < CLOCK_S:
        return f"{seconds:.0f} s of bus time"
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _effect(effect: NamedEffect) -> str:
    figures = [
        f"{words(name)} {one.value:.3g} ± {(one.ci95[1] - one.ci95[0]) / 2:.2g} {one.unit}"
        for name, one in list(effect.parameters.items())[:WORDS]
    ]
    doubt = f", or {' or '.join(map(words, effect.confusable_with))}" if effect.confusable_with else ""
    return f"{placed(effect.name, effect.joints)} ({', '.join(figures)}{doubt})"


def _parts(trace: Trace, count: int, robot: Description) -> list[Trace]:
    """`trace` as runs of equal length, named alike with a number, flagged as a log that is read."""
    trace = flagged(trace, robot)
    return [
        replace(
            trace,
            path=Path(f"{trace.name}_{number + 1}"),
            time=trace.time[rows],
            position=trace.position[rows],
            torque=trace.torque[rows],
            position_command=None if trace.position_command is None else trace.position_command[rows],
            flags=trace.flags[rows],
        )
        for number, rows in enumerate(np.array_split(np.arange(len(trace)), count))
    ]


def _rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.4g}") for value in values]
