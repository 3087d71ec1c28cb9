"""The identified figures in the terms of a controller that has a rigid model of its own and takes no code.

Kinematic transformations of a Delta (TwinCAT's and others') take masses and inertias of its links for dynamic
pre-control; drives and CNC take inertia, Coulomb and viscous friction of each axis. rho_1 and rho_2 are what is missing
in the drawing: of rotor and gear, and of where an arm has its centre of mass.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from schemas.errors import RobotError
from schemas.robot import Identified, Robot
from schemas.trace import Trace
from service.estimator.bounds import ARM_ANGLES
from service.estimator.named_effects import corrected
from service.model.coulomb_viscous import mean_direction
from service.model.kinematics import jacobian
from service.model.nominal import DeltaModel, lengthened, pack
from service.model.prediction import FULL, error_in_band, motion, predict_along

# What a controller may be given, and the model of `prediction` that it then reckons with.
STAGES = {
    "no feed-forward": None,
    "inertia and friction of each axis": None,
    "masses as drawn": "M_KH",
    "and added inertia, added static moment": "M_Id",
    "and friction": "M_Id+F",
    "the whole model, as code": FULL,
}


def to_sheet(robot: Robot, traces: Sequence[Trace]) -> str:
    """A page of figures, and what is left of the torque along `traces`, held-out logs, as far as each is put in.

    Raises:
        RobotError: the robot was not identified. TraceError: a log is no motion of it.
    """
    if robot.identified is None:
        raise RobotError(f"{robot.origin}: identified: missing: run `deltatwin identify`")
    changed, ratio, _ = corrected(robot)
    model = pack(changed)
    rho_1, rho_2 = lengthened(robot.identified.rho_1.value, robot.identified.rho_2.value, ratio)
    axes = axis_inertia(model, rho_1)
    said = re.sub(r"[^A-Za-z0-9_. -]", "?", robot.name)
    lines = [
        f"# {said}: parameters for a controller's own model",
        "",
        f"By deltatwin {version('deltatwin')}. SI units.",
    ]
    lines += _masses(robot, changed) + _added(robot, model, rho_1, rho_2) + _axes(robot, robot.identified, axes)
    lines += _effects(robot)
    if traces:
        lines += _left(robot, traces, axes)
    return "\n".join([*lines, ""])


def axis_inertia(model: DeltaModel, rho_1: np.ndarray) -> np.ndarray:
    """(P, 3) kg m^2: what each axis turns by itself, the platform's share with it, at P places amid the workspace."""
    way = jacobian(model, np.repeat(ARM_ANGLES[:, None], 3, axis=1))
    return rho_1 * model.inertia + model.moving_mass * np.sum(way**2, axis=1)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def _masses(robot: Robot, changed: Robot) -> list[str]:
    geometry, mass = changed.geometry, robot.mass
    lengths = (geometry.active_link_length + np.array(geometry.active_link_length_error)).tolist()
    forearms = (geometry.passive_link_length + np.array(geometry.passive_link_length_error)).tolist()
    shaft = robot.fourth_axis.shaft_mass_kg if robot.fourth_axis else 0.0
    rows = [
        ("length of the active links", _each(lengths), "m"),
        ("length of the forearms", _each(forearms), "m"),
        ("base radius minus platform radius", f"{geometry.base_radius - geometry.platform_radius:.6g}", "m"),
        ("mass of an active link", f"{mass.active_link:.6g}", "kg"),
        ("mass of a forearm, both rods", f"{mass.passive_link:.6g}", "kg"),
        ("mass of the platform", f"{mass.platform:.6g}", "kg"),
        ("mass of the fourth axis' shaft, at the platform", f"{shaft:.6g}", "kg"),
    ]
    return ["", "## Kinematic transformation", "", *_table(("figure", "value", "unit"), rows)]


def _added(robot: Robot, model: DeltaModel, rho_1: np.ndarray, rho_2: np.ndarray) -> list[str]:
    gear = np.array(robot.gear_ratios)
    inertia = (rho_1 - 1.0) * model.inertia
    moment = (rho_2 - 1.0) * model.link_mass * model.active_length
    rows = [
        ("added inertia, joint side", *(f"{value:.5g}" for value in inertia), "kg m^2"),
        ("the same at the motor", *(f"{value:.5g}" for value in inertia / gear**2), "kg m^2"),
        ("added static moment of the arm", *(f"{value:.5g}" for value in moment), "kg m"),
    ]
    text = [
        "", "## Additions to the drawing", "",
        "The added inertia is that of rotor and gear, and of arms that are not uniform rods: enter it as inertia of",
        "the motor or the gear. The added static moment is mass times the distance of its centre from the joint.",
        "If the controller has no such parameter, shift the arm's centre of mass by the moment over the arm's mass.",
        "",
    ]  # fmt: skip
    return [*text, *_table(("figure", "axis 1", "axis 2", "axis 3", "unit"), rows)]


def _axes(robot: Robot, found: Identified, axes: np.ndarray) -> list[str]:
    gear = np.array(robot.gear_ratios)
    viscous, coulomb = np.array(found.viscous_friction_nms.value), np.array(found.coulomb_friction_nm.value)
    errors = [found.viscous_friction_nms.std_error, found.coulomb_friction_nm.std_error]
    spread = [one or [0.0] * 3 for one in errors]
    mean = axes.mean(axis=0)
    rows = [
        ("inertia, mean in the middle of the workspace", *(f"{value:.5g}" for value in mean), "kg m^2"),
        ("its range there", *(f"{low:.4g} to {high:.4g}" for low, high in zip(axes.min(0), axes.max(0), strict=True)),
         "kg m^2"),
        ("inertia at the motor", *(f"{value:.5g}" for value in mean / gear**2), "kg m^2"),
        ("Coulomb friction", *_with_error(coulomb, spread[1]), "N m"),
        ("the same at the motor", *(f"{value:.5g}" for value in coulomb / gear), "N m"),
        ("viscous friction", *_with_error(viscous, spread[0]), "N m s/rad"),
        ("the same at the motor", *(f"{value:.5g}" for value in viscous / gear**2), "N m s/rad"),
    ]  # fmt: skip
    return ["", "## Each axis", "", *_table(("figure", "axis 1", "axis 2", "axis 3", "unit"), rows)]


def _with_error(values: np.ndarray, errors: Sequence[float]) -> list[str]:
    return [f"{value:.5g}" + (f" +- {error:.2g}" if error else "") for value, error in zip(values, errors, strict=True)]


def _effects(robot: Robot) -> list[str]:
    if not robot.effect:
        return []
    names = ", ".join(re.sub(r"[^a-z0-9_]", "?", entry.name) for entry in robot.effect)
    return [
        "",
        f"Effects that no parameter here contains, except changed lengths: {names}. The code (`--to c`) contains them.",
    ]


def _left(robot: Robot, traces: Sequence[Trace], axes: np.ndarray) -> list[str]:
    left: dict[str, list[np.ndarray]] = {stage: [] for stage in STAGES}
    for trace in traces:
        along = motion(trace)
        predicted = predict_along(robot, trace, along)
        for stage, name in STAGES.items():
            torque = np.zeros_like(along.theta) if name is None else predicted[name]
            if stage == "inertia and friction of each axis":
                torque = _of_axes(robot, along.theta_dot, along.theta_ddot, axes.mean(axis=0))
            left[stage].append(error_in_band(trace, along, torque))
    rows = []
    for stage, errors in left.items():
        rms = np.sqrt(np.nanmean(np.concatenate(errors) ** 2, axis=0))
        rows.append((stage, *(f"{value:.3g}" for value in rms)))
    count = sum(int(np.isfinite(error).any(axis=1).sum()) for error in left["masses as drawn"])
    text = (
        f"N m rms of the torque, while moving, over {count} samples of {len(traces)} logs; payloads are not subtracted."
    )
    head = ("included", "axis 1", "axis 2", "axis 3")
    return ["", "## Residual torque", "", text, "", *_table(head, rows)]


def _of_axes(robot: Robot, theta_dot: np.ndarray, theta_ddot: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    found = robot.identified
    assert found is not None
    direction = mean_direction(theta_dot, found.friction_transition_radps)
    viscous, coulomb = np.array(found.viscous_friction_nms.value), np.array(found.coulomb_friction_nm.value)
    return inertia * theta_ddot + viscous * theta_dot + coulomb * direction


def _each(values: Sequence[float]) -> str:
    """One figure where all are the same."""
    shown = [f"{value:.6g}" for value in values]
    return shown[0] if len(set(shown)) == 1 else ", ".join(shown)
