"""From traces to a robot description with an `[identified]` section, and the words to go with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from schemas.errors import DataError
from schemas.robot import Identified, JointParameter, Parameter, Robot
from service.identification import checks, paper, pooled
from service.identification.pooled import Identification, ParameterEstimate
from service.identification.regression import (
    COULOMB,
    FOREARM_MASS,
    PARAMETERS,
    RHO_1,
    RHO_2,
    VISCOUS,
    NormalEquations,
)
from service.identification.units import refuse_wrong_angles
from service.model.description import digits
from service.model.nominal import pack

Method = Literal["pooled", "paper"]
MINIMUM_BLOCKS = 2 * PARAMETERS


def identify(robot: Robot, logs: Sequence[NormalEquations], method: Method = "pooled") -> Identification[Robot]:
    """Fit `robot` to `logs`, by pooled least squares or as in the paper.

    Raises:
        DataError: the data cannot give an answer, naming the log and the joint.
    """
    checks.check(logs, robot.drive.gear_ratio)
    _enough(logs)
    recordings = [replace(part, trace=number) for number, log in enumerate(logs) for part in log.recordings]
    problem, noise = pooled.problem_of(recordings)
    fit = pooled.fit(problem, noise.sample, robot)
    refuse_wrong_angles(problem, ", ".join(log.name for log in logs), fit.fitted)
    transition = fit.fitted.hypothesis.base.transition
    warnings = checks.check_fit(logs, fit, pack(robot).moving_mass)
    if method == "paper":
        fit, transition = paper.refit(logs, fit), 0.0
        warnings = [*warnings, *paper.edges(logs)]
    estimates = fit.estimates
    identified = Identified(
        method=method,
        rho_1=_parameter(estimates[RHO_1]),
        rho_2=_parameter(estimates[RHO_2]),
        viscous_friction_nms=_joints(estimates[VISCOUS]),
        coulomb_friction_nm=_joints(estimates[COULOMB]),
        forearm_inertia_kg=_parameter(estimates[FOREARM_MASS]),
        friction_transition_radps=digits(float(transition)),
        torque_noise_nm=JointParameter(value=[float(f"{noise:.4g}") for noise in fit.noise]),
        model_error_nm=JointParameter(value=[float(f"{error:.4g}") for error in fit.model_error]),
        torque_commanded=all(log.commanded for log in logs),
    )
    # what diagnose found on another base does not hold on this one
    if robot.effect:
        names = ", ".join(dict.fromkeys(effect.name for effect in robot.effect))
        warnings = [
            *warnings,
            f"{names}: found on an earlier identification, left out of this one; `diagnose` says what still is there, "
            "`identify --carried` how far torque constants are off",
        ]
    return Identification(robot.model_copy(update={"identified": identified, "effect": []}), fit, tuple(warnings))


def _enough(logs: Sequence[NormalEquations]) -> None:
    seconds = np.concatenate([log.seconds for log in logs])
    if (seconds.sum(axis=1) > 0).sum() < MINIMUM_BLOCKS:
        raise DataError(
            f"{', '.join(t.name for t in logs)}: too little motion, {seconds.max(axis=1).sum():.1f} s; "
            f"nine parameters and their errors need {MINIMUM_BLOCKS / 2:.0f} s or more"
        )


def _parameter(estimate: ParameterEstimate) -> Parameter:
    return Parameter.model_validate(
        {"value": digits(estimate.value), "std_error": digits(estimate.std_error), "verdict": estimate.verdict}
    )


def _joints(estimates: Sequence[ParameterEstimate]) -> JointParameter:
    return JointParameter.model_validate(
        {
            "value": [digits(estimate.value) for estimate in estimates],
            "std_error": [digits(estimate.std_error) for estimate in estimates],
            "verdict": [estimate.verdict for estimate in estimates],
        }
    )
