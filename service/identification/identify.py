"""From traces to a robot description with an `[identified]` section, and the words to go with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from schemas.robot import Identified, JointParameter, Parameter, Robot
from service.identification import checks, paper, pooled
from service.identification.pooled import COULOMB, FOREARM_MASS, RHO_1, RHO_2, VISCOUS, Estimate, Fit
from service.identification.regression import Trajectory
from service.model.nominal import pack

Method = Literal["pooled", "paper"]


@dataclass(frozen=True)
class Identification:
    """robot: the description with what was found. fit: numbers and verdicts. warnings: what a user has to know."""

    robot: Robot
    fit: Fit
    warnings: tuple[str, ...]


def identify(robot: Robot, trajectories: Sequence[Trajectory], method: Method = "pooled") -> Identification:
    """Fit `robot` to `trajectories`, by pooled least squares or as in the paper.

    Raises:
        DataError: the data cannot give an answer, naming the log and the joint.
    """
    checks.check(trajectories, robot.drive.gear_ratio)
    transition = pooled.transition(trajectories) if method == "pooled" else 0.0
    trajectories = [trajectory.at(transition) for trajectory in trajectories]
    fit = pooled.fit(trajectories, robot.mass.passive_link)
    warnings = checks.check_fit(trajectories, fit, pack(robot).moving_mass)
    if method == "paper":
        fit = paper.refit(trajectories, fit)
    estimates = fit.estimates
    identified = Identified(
        method=method,
        rho_1=_parameter(estimates[RHO_1]),
        rho_2=_parameter(estimates[RHO_2]),
        viscous_friction_nms=_joints(estimates[VISCOUS]),
        coulomb_friction_nm=_joints(estimates[COULOMB]),
        forearm_inertia_kg=_parameter(estimates[FOREARM_MASS]),
        friction_transition_radps=transition,
        torque_noise_nm=JointParameter(value=[float(f"{noise:.4g}") for noise in fit.noise]),
        model_error_nm=JointParameter(value=[float(f"{error:.4g}") for error in fit.model_error]),
    )
    # what diagnose found on another base does not hold on this one
    return Identification(robot.model_copy(update={"identified": identified, "effect": []}), fit, tuple(warnings))


def _parameter(estimate: Estimate) -> Parameter:
    return Parameter.model_validate(
        {"value": _digits(estimate.value), "std_error": _digits(estimate.std_error), "verdict": estimate.verdict}
    )


def _joints(estimates: Sequence[Estimate]) -> JointParameter:
    return JointParameter.model_validate(
        {
            "value": [_digits(estimate.value) for estimate in estimates],
            "std_error": [_digits(estimate.std_error) for estimate in estimates],
            "verdict": [estimate.verdict for estimate in estimates],
        }
    )


def _digits(value: float) -> float:
    return float(f"{value:.6g}")
