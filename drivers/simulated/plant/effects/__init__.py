"""Physics that the robot description does not know of: every effect of the catalogue, and some that it lacks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, get_type_hints

import numpy as np
from pydantic import ConfigDict, ValidationError, create_model

from drivers.simulated.plant.effects import friction, mechanics, out_of_catalogue, sensing, two_mass_effects
from drivers.simulated.plant.effects.plant_effect import PlantEffect
from drivers.simulated.plant.truth import PlantTruth
from schemas.errors import DataError, RobotError
from schemas.toml import explain

CATALOGUE: dict[str, type[PlantEffect]] = {
    "stribeck_friction": friction.StribeckFriction,
    "asymmetric_friction": friction.AsymmetricFriction,
    "load_dependent_friction": friction.LoadDependentFriction,
    "nonlinear_viscous_friction": friction.NonlinearViscousFriction,
    "position_dependent_friction": friction.PositionDependentFriction,
    "warmup_friction": friction.WarmupFriction,
    "presliding_friction": friction.PreslidingFriction,
    "passive_joint_friction": friction.PassiveJointFriction,
    "shaft_friction": friction.ShaftFriction,
    "rotor_inertia": mechanics.RotorInertia,
    "arm_mass": mechanics.ArmMass,
    "tool_mass": mechanics.ToolMass,
    "base_tilt": mechanics.BaseTilt,
    "joint_spring": mechanics.JointSpring,
    "hose_spring": mechanics.HoseSpring,
    "air_drag": mechanics.AirDrag,
    "link_length_error": mechanics.LinkLengthError,
    "forearm_length_error": mechanics.ForearmLengthError,
    "base_radius_error": mechanics.BaseRadiusError,
    "azimuth_error": mechanics.AzimuthError,
    "joint_offset": mechanics.JointOffset,
    "angle_scale": sensing.AngleScale,
    "joint_elasticity": two_mass_effects.JointElasticity,
    "backlash": two_mass_effects.Backlash,
    "torque_scale": sensing.TorqueScale,
    "torque_offset": sensing.TorqueOffset,
    "torque_delay": sensing.TorqueDelay,
    "torque_filter": sensing.TorqueFilter,
    "drive_lag": sensing.DriveLag,
    "cogging": sensing.Cogging,
    "encoder_eccentricity": sensing.EncoderEccentricity,
}
# forearm_inertia, the catalogue's last, is in every plant: its forearms are rods

OUT_OF_CATALOGUE: dict[str, type[PlantEffect]] = {
    "contact_rail": out_of_catalogue.ContactRail,
    "stick_events": out_of_catalogue.StickEvents,
    "base_resonance": out_of_catalogue.BaseResonance,
    "torque_dropouts": out_of_catalogue.TorqueDropouts,
    "torque_constant_drift": out_of_catalogue.TorqueConstantDrift,
    "hose_jerk": out_of_catalogue.HoseJerk,
    "belt_tooth": out_of_catalogue.BeltTooth,
    "cable_memory": out_of_catalogue.CableMemory,
    "magnet": out_of_catalogue.Magnet,
}

EFFECTS = CATALOGUE | OUT_OF_CATALOGUE


def make_effects(entries: Sequence[Mapping[str, object]], where: str) -> tuple[PlantEffect, ...]:
    """Effects from the `[[effect]]` tables of a truth file: `name`, and the fields of its dataclass.

    Raises:
        RobotError: an unknown name, a missing, unknown or wrong parameter; names `where` and the key.
    """
    made = []
    for entry in entries:
        parameters = dict(entry)
        name = parameters.pop("name", None)
        if name not in EFFECTS:
            raise RobotError(f"{where}: effect.name: unknown effect {name!r}; known: {', '.join(EFFECTS)}")
        kind = EFFECTS[str(name)]
        hints = get_type_hints(kind)
        wanted: dict[str, Any] = {field.name: (hints[field.name], ...) for field in fields(kind) if field.init}
        try:
            checked = create_model(kind.__name__, __config__=ConfigDict(extra="forbid"), **wanted)(**parameters)
        except ValidationError as error:
            raise RobotError(f"{where}: effect {name}: {explain(error)}") from error
        made.append(kind(**checked.model_dump()))
    return tuple(made)


def draw_effect(text: str, truth: PlantTruth, seed: int) -> tuple[str, PlantEffect]:
    """Name and instance of the effect that `NAME` or `NAME:SEVERITY` stands for, drawn for a robot of this `truth`.

    Severity 1, the default, is a fault that maintenance would want to know of.

    Raises:
        DataError: no such effect in the catalogue, or a severity that is no number above zero.
    """
    name, colon, size = text.partition(":")
    if name not in CATALOGUE:
        raise DataError(f"--effect {text!r}: unknown effect {name!r}; known: {', '.join(CATALOGUE)}")
    try:
        severity = float(size) if colon else 1.0
    except ValueError:
        severity = math.nan
    if not (math.isfinite(severity) and severity > 0):
        raise DataError(
            f"--effect {text!r}: severity {size!r} is not a number above zero; give for example joint_elasticity:0.5"
        )
    return name, CATALOGUE[name].draw(np.random.default_rng([seed, 2]), truth, severity)
