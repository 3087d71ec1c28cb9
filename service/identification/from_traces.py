"""From traces to a robot description with an `[identified]` section, and the words to go with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from schemas.axes_description import Description
from schemas.errors import DataError
from schemas.fitted import JointParameter
from schemas.robot import Method, Robot
from service.identification import checks, paper_method, pooled
from service.identification.angle_unit import refuse_wrong_angles
from service.identification.held import told_of_held
from service.identification.loops import loops_of, told
from service.identification.pooled import Described, Identification, Plain
from service.identification.regression import PARAMETERS, NormalEquations
from service.model.description import identified_of
from service.model.nominal import pack
from service.model.parameters import TIMING_LIMIT
from service.model.scene import Base, Recording
from service.model.signals import one_period

MINIMUM_BLOCKS = 2 * PARAMETERS
AT_LIMIT = 1.0 - 1e-6  # of the timing within a sample: so near to its limit it stands there


def identify(robot: Robot, logs: Sequence[NormalEquations], method: Method = "pooled") -> Identification[Robot]:
    """Fit `robot` to `logs`, by pooled least squares or as in the paper.

    Raises:
        DataError: the data cannot give an answer, naming the log and the joint.
    """
    refuse(robot, logs)
    recordings = [replace(part, trace=number) for number, log in enumerate(logs) for part in log.recordings]
    fit = fit_to(robot, recordings, [log.name for log in logs])
    errors = [error for log in logs for error in log.position_errors]
    loops = loops_of(fit.problem, errors if len(errors) == len(recordings) else [], fit.fitted.residuals)
    base = fit.fitted.hypothesis.base
    held = told_of_held({log.name: log.held for log in logs})
    warnings = [*told(loops, robot), *held, *checks.check_fit(logs, fit, pack(robot).moving_mass)]
    if method == "paper":
        fit, base = paper_method.refit(logs, fit), replace(base, transition=0.0, timing=0.0)
        warnings = [*warnings, *paper_method.edges(logs)]
    more = {
        "method": method,
        "torque_noise_nm": JointParameter(value=[float(f"{noise:.4g}") for noise in fit.noise]),
        "model_error_nm": JointParameter(value=[float(f"{error:.4g}") for error in fit.model_error]),
        "torque_commanded": all(log.commanded for log in logs),
    }
    return written(robot, fit, base, warnings, more)


def refuse(robot: Robot, logs: Sequence[NormalEquations]) -> None:
    """
    Raises:
        DataError: `robot` cannot be fitted to `logs`, which shows before it is: naming the log and the joint.
    """
    one_period([(part.name, part.segment) for log in logs for part in log.recordings])
    checks.check(logs, robot.drive.gear_ratio)
    _enough(logs)


def fit_to(robot: Description, recordings: Sequence[Recording], names: Sequence[str]) -> Plain:
    """The plain model of `robot` on recordings of the logs `names`.

    Raises:
        DataError: logs of several rates, or the angles are no radians.
    """
    problem, noise = pooled.problem_of(recordings, bare=not recordings[0].mechanism.described_whole)
    fit = pooled.fit(problem, noise.sample, robot)
    refuse_wrong_angles(problem, ", ".join(names), fit.fitted)
    return fit


def written(
    robot: Described, fit: Plain, base: Base, warnings: Sequence[str], more: dict[str, Any] | None = None
) -> Identification[Described]:
    """`robot` with the figures of `fit`, `base` and `more` in its `[identified]` section, and no effects: what diagnose
    found on another base does not hold on this one."""
    figures = {estimate.name: (estimate.value, estimate.std_error) for estimate in fit.estimates}
    verdicts = {estimate.name: estimate.verdict for estimate in fit.estimates}
    identified = identified_of(robot, figures, base, verdicts).model_copy(update=more)
    if robot.effect:
        names = ", ".join(dict.fromkeys(effect.name for effect in robot.effect))
        said = f"{names}: from an earlier diagnosis, not used here; `diagnose` finds the effects that remain"
        carries = fit.problem.recordings[0].mechanism.platform is not None
        constants = ", `identify --carried` calibrates torque constants" if carries else ""
        warnings = [*warnings, said + constants]
    older, newer = ("torque", "position") if base.timing > 0 else ("position", "torque")
    if fit.problem.bare and abs(base.timing) > TIMING_LIMIT * fit.problem.recordings[0].segment.period:
        warnings = [
            *warnings,
            f"the {older} is {1e3 * abs(base.timing):.3g} ms older than the {newer}: the description contains that "
            "delay (torque_timing_s), but it is better to correct it in the drive or recorder",
        ]
    elif abs(base.timing) >= AT_LIMIT * fit.problem.apart * fit.problem.recordings[0].segment.period:
        said = (
            f"the {older} is {1e3 * abs(base.timing):.3g} ms older than the {newer}, {fit.problem.apart} of a sample. "
            "This is the fit's limit: the delay may be larger or due to another effect; `deltatwin diagnose` shows more"
        )
        warnings = [*warnings, said]
    return Identification(robot.model_copy(update={"identified": identified, "effect": []}), fit, tuple(warnings))


def _enough(logs: Sequence[NormalEquations]) -> None:
    seconds = np.concatenate([log.seconds for log in logs])
    if (seconds.sum(axis=1) > 0).sum() < MINIMUM_BLOCKS:
        raise DataError(
            f"{', '.join(t.name for t in logs)}: too little motion, {seconds.max(axis=1).sum():.1f} s; "
            f"nine parameters and their errors need {MINIMUM_BLOCKS / 2:.0f} s or more"
        )
