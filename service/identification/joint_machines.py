"""From traces of axes to their description with an `[identified]` section."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.errors import DataError, RobotError
from schemas.trace import Trace
from schemas.words import part_of, percent
from service.identification import checks
from service.identification.folds import BLOCK, Split, block_loss, held_out
from service.identification.from_traces import fit_to, written
from service.identification.held import held_s, told_of_held
from service.identification.loops import loops_of, position_errors, told
from service.identification.pooled import Identification, Plain, refuse_dead_torque
from service.identification.rigs import Rig, on_rig
from service.model.mechanism import Mechanism, mechanism_of
from service.model.parameters import base_parameters
from service.model.scene import Recording
from service.model.signals import Segment, one_period, segments_of, thin

MUCH = 0.2  # of an axis' torque, rms, that is left: more than friction of another kind does on most real arms
CLEARLY = 0.95  # of what the masses found leave of stretches left out; nearer than this both are as good
BLOCKS_PER_PARAMETER = 1  # a mass shows in the torque of several joints of an arm
BLOCKS_PER_DECOUPLED = 2  # of an axis, whose parameters show in its own torque alone


def identify_axes(
    axes: Axes | Chain, traces: Sequence[Trace], rigs: Sequence[Rig | None] = ()
) -> Identification[Axes | Chain]:
    """Fit axes to traces by pooled least squares. rigs: what an axis moves in each log alone.

    Raises:
        RobotError: a rig of an arm, or of an axis that there is not.
        TraceError: a trace without a usable part, naming the file.
        DataError: too little motion, or logs of several rates, naming them.
    """
    recordings, logs = recorded(axes, traces, rigs)
    fit = fit_to(axes, recordings, [trace.path.name for trace in traces])
    held = told_of_held({trace.path.name: held_s(parts) for trace, parts in zip(traces, logs, strict=True)})
    warnings = [*_commanded(axes, fit, traces), *held, *_warnings(fit, traces)]
    return written(axes, fit, fit.fitted.hypothesis.base, warnings)


def recorded(
    axes: Axes | Chain, traces: Sequence[Trace], rigs: Sequence[Rig | None] = ()
) -> tuple[list[Recording], Sequence[Sequence[Segment]]]:
    """What is fitted to, and the parts of each trace that it is made of.

    Raises:
        As `identify_axes`, for what shows before the fit.
    """
    mechanism = mechanism_of(axes)
    logs = segments_of(traces)
    recordings = [
        Recording(thin(part), _of_log(axes, mechanism, rig, trace.name), number, trace.name)
        for number, (trace, rig, parts) in enumerate(zip(traces, rigs or [None] * len(traces), logs, strict=True))
        for part in parts
    ]
    refuse_dead_torque(recordings)
    one_period([(recording.name, recording.segment) for recording in recordings])
    seconds = sum(r.segment.period * r.segment.moving.sum(axis=0) for r in recordings)
    blocks = BLOCKS_PER_DECOUPLED if mechanism.decoupled else BLOCKS_PER_PARAMETER
    least = blocks * BLOCK * len(base_parameters(mechanism)) / mechanism.joints
    if np.max(seconds) < least:
        names = ", ".join(trace.path.name for trace in traces)
        raise DataError(
            f"{names}: too little motion, at most {np.max(seconds):.1f} s per axis; at least {least:.0f} s are needed"
        )
    return recordings, logs


def _of_log(axes: Axes | Chain, mechanism: Mechanism, rig: Rig | None, log: str) -> Mechanism:
    if rig is None:
        return mechanism
    if axes.separate is None:
        raise RobotError(f"--rig {log}: {axes.name} is an arm: give its loads in the description, as payload")
    return on_rig(axes.separate, rig, log)


def _commanded(axes: Axes | Chain, fit: Plain, traces: Sequence[Trace]) -> list[str]:
    """Of torque that is the controller's answer to its position error."""
    errors = position_errors(fit.problem.recordings, traces)
    return told(loops_of(fit.problem, errors, fit.fitted.residuals), axes)


def _warnings(fit: Plain, traces: Sequence[Trace]) -> list[str]:
    share = fit.residual / np.maximum(fit.torque, 1e-12)
    log, axis = divmod(int(np.argmax(share)), share.shape[1])
    name, warnings = traces[log].path.name, []
    if share.max() > checks.HOPELESS:
        warnings.append(
            f"{name}: the model leaves {part_of(share.max())} the torque of axis {axis + 1} unexplained. Are "
            "units, order of joints, gear ratio and coupling right? `deltatwin diagnose` shows more"
        )
    else:
        warnings += _much_left(fit)
    together, alone = np.sum(fit.residual**2), np.sum(fit.alone**2)
    noise = len(traces) * np.sum(fit.noise_floor**2)
    if together > checks.FOREIGN_LEFT**2 * noise and together - alone > checks.FOREIGN_TOGETHER * (together - noise):
        worst = int(np.argmax(np.sum(fit.residual**2 - fit.alone**2, axis=1)))
        warnings.append(
            f"the model fits each log alone, but not all together; {traces[worst].path.name} differs most (with "
            f"each log fitted alone, the residual is {percent(np.sqrt(alone / together))} of that of the common fit): "
            "two robots, or two loads?"
        )
    warnings += _described_better(fit)
    if len(traces) == 1:
        warnings.append(f"{name}: a single log cannot be held out: nothing shows how well the fit generalises")
    return warnings


def _much_left(fit: Plain) -> list[str]:
    """Of axes whose torque on all logs together the model leaves much of."""
    share = np.sqrt(np.sum(fit.residual**2, axis=0) / np.maximum(np.sum(fit.torque**2, axis=0), 1e-12))
    told = [f"{part_of(share[axis])} the torque of axis {axis + 1}" for axis in np.flatnonzero(share > MUCH)]
    if not told:
        return []
    return [
        f"the model leaves {', '.join(told)} unexplained. Are order of joints, gear ratio and coupling right? "
        "`deltatwin diagnose` shows more"
    ]


def _described_better(fit: Plain) -> list[str]:
    """Whether an arm's stretches left out are better told by the masses of its URDF than by those that were found."""
    problem = fit.problem
    mechanism, split = problem.recordings[0].mechanism, Split.of(problem)
    if not mechanism.links.any():
        return []
    links = np.flatnonzero(mechanism.links)
    described = fit.fitted.holding(links, mechanism.start[links])
    torque = sum(float(np.sum(problem.select(i, target) ** 2)) for i, target in enumerate(problem.target))
    left = [np.sqrt(block_loss(held_out(one, split), split).sum() / torque) for one in (fit.fitted, described)]
    if left[1] > CLEARLY * left[0]:
        return []
    return [
        f"on held-out stretches the masses of the URDF leave {percent(left[1], 1)} of the torque unexplained, the "
        f'identified ones {percent(left[0], 1)}: keep those of the URDF with masses = "known", or log more motion'
    ]
