"""What the exports of axes and arms have in common: text, figures beside it, joints in MuJoCo's terms.

Only what MuJoCo has a word for goes in; effects that it has none for are named.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from schemas.axes_description import Description
from service.model.description import base_errors, base_of, in_units_of, terms_of
from service.model.mechanism import mechanism_of
from service.model.parameters import base_parameters
from service.model.signals import time_constant

STEP = 0.5e-3  # s
# Friction of a joint is a soft constraint in MuJoCo: by its defaults a light joint has all of it only above 0.1 rad/s.
FIRM = [2 * STEP, 1.0]  # s, damping ratio: the fastest that a step resolves
FIRM_SHARE = [0.99, 0.99, 1e-3, 0.5, 2.0]  # of the force that would hold the joint, from the first micrometre on
NATIVE = ("drive_lag", "torque_offset", "joint_spring", "rotor_inertia")  # effects that MuJoCo has a word for


@dataclass
class MachineFile:
    """text: of the file. figures: JSON to go beside it. left_out: effect -> why the file has not got it. said: what a
    user has to know, a sentence each."""

    text: str
    figures: str
    left_out: dict[str, str] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)


def figures(robot: Description, more: dict[str, Any]) -> str:
    """Base parameters with standard errors, what the URDF or MJCF cannot say, and `more`, as JSON."""
    base, mechanism = base_of(robot), mechanism_of(robot)
    values = np.concatenate([base.rigid, base.viscous, base.coulomb])
    parameters = {
        known.name: {"value": float(value), "std_error": float(error), "unit": in_units_of(robot, known.unit)}
        for known, value, error in zip(base_parameters(mechanism), values, base_errors(robot), strict=True)
    }
    width = np.broadcast_to(base.transition, len(mechanism.frictions)).tolist()
    document = {
        "schema": "deltatwin.parameters/1",
        "robot": robot.name,
        "base_parameters": parameters,
        "friction_transition": dict(zip(mechanism.frictions, width, strict=True)),
        "torque_timing_s": base.timing,
        "effects": [entry.model_dump() for entry in robot.effect],
    }
    return json.dumps(document | more, indent=1) + "\n"


def finish(
    spec: mujoco.MjSpec, robot: Description, joints: list[str], rotors: np.ndarray, load: np.ndarray
) -> dict[str, str]:
    """Give the joints, in the log's order, their rotors (F,) kg m^2, friction, constant load (n,) N m and drives, and
    the model its step. A motor that turns with several joints is a tendon. Returns effects that are left out."""
    base, mechanism, terms = base_of(robot), mechanism_of(robot), terms_of(robot)
    spec.modelname, spec.option.timestep = robot.name, STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    push, lag = -load, np.zeros(len(joints))
    spring, rotors = np.zeros(len(joints)), rotors.copy()
    for term in terms:
        for joint, amplitude in zip(term.joints, term.amplitude, strict=True):
            one = dict(zip(term.effect.amplitudes, amplitude.tolist(), strict=True))
            if term.effect.name == "drive_lag":
                lag[joint] = time_constant(term.nonlinear[0])
            elif term.effect.name == "torque_offset":
                push[joint] -= one["offset"]
            elif term.effect.name == "rotor_inertia":
                rotors[joint] += one["delta_i"]
            elif term.effect.name == "joint_spring":
                spring[joint] += one["k"]
                push[joint] -= one["preload"]
    for number, name in enumerate(joints):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = rotors[number], base.coulomb[number]
        joint.solref_friction, joint.solimp_friction = FIRM, FIRM_SHARE
        _linear(joint, "damping", base.viscous[number])
        if spring[number] > 0:
            _linear(joint, "stiffness", spring[number])
        drive = spec.add_actuator(name=f"drive_{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        drive.set_to_motor()
        if push[number]:
            drive.biastype, drive.biasprm[0] = mujoco.mjtBias.mjBIAS_AFFINE, push[number]
        if lag[number]:
            drive.dyntype, drive.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag[number]
    for number, motor in enumerate(mechanism.frictions[len(joints) :], start=len(joints)):
        tendon = spec.add_tendon(name=motor)
        for name, turns in zip(joints, mechanism.rows[number], strict=True):
            if turns:
                tendon.wrap_joint(name, float(turns))
        tendon.armature, tendon.frictionloss = rotors[number], base.coulomb[number]
        tendon.solref_friction, tendon.solimp_friction = FIRM, FIRM_SHARE
        _linear(tendon, "damping", base.viscous[number])
    why = "MuJoCo cannot express it; `deltatwin rollout` contains it"
    return {term.effect.name: why for term in terms if term.effect.name not in NATIVE}


def _linear(part: Any, name: str, value: float) -> None:
    """Stiffness or damping, which MuJoCo 4 takes as a polynomial."""
    setattr(part, name, float(value) if np.isscalar(getattr(part, name)) else [float(value), 0.0, 0.0])
