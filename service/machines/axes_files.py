"""Servo axes in MuJoCo's terms: each a pendulum or a carriage of its own, motors that turn with several as tendons."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import mujoco
import numpy as np

from schemas.axes_description import Axes
from schemas.errors import RobotError
from service.machines.exported import MachineFile, figures, finish
from service.model.description import base_of
from service.model.mechanism import DecoupledAxes

GRAVITY = 9.81  # m/s^2, downwards
IN_BODY = 0.5  # of an axis' inertia that its body has at most, the rest turns with the motor
APART = 0.5  # m between axes, to be looked at
NOTHING = 1e-9  # kg and kg m^2: of a body whose inertia is its rotor's


def to_mjcf(axes: Axes) -> MachineFile:
    """The axes as identified: `axis_1` takes the torque of actuator `drive_axis_1`.

    Raises:
        RobotError: an axis without inertia; one with a weight whose motor turns with another axis.
    """
    mechanism, base = DecoupledAxes.of(axes), base_of(axes)
    found = dict(zip(mechanism.coefficients, base.rigid.tolist(), strict=True))
    spec, rotors = mujoco.MjSpec(), []
    parent = spec.worldbody
    for number in range(1, axes.count + 1):
        inertia = found[f"inertia_{number}"]
        if inertia <= 0:
            raise RobotError(f"robot {axes.name}: axis {number} has an impossible inertia of {inertia:g}")
        weight = np.array([found.get(f"gravity_cos_{number}", 0.0), -found.get(f"gravity_sin_{number}", 0.0)])
        if mechanism.shared and weight.any():
            raise RobotError(
                f"robot {axes.name}: axis {number} bears a weight and {', '.join(mechanism.shared)} turns with several "
                "axes: MuJoCo cannot express both together"
            )
        body = parent.add_body(name=f"body_{number}", pos=[0.0, APART * min(number - 1, 1), float(number == 1)])
        if mechanism.shared:
            parent = body  # MuJoCo couples joints of one tree alone; what has no mass couples no more than that
        elif number > 1:
            body.pos = [0.0, APART * (number - 1), 1.0]
        linear = axes.axis[number - 1].unit == "m"
        alone = linear and not mechanism.shared  # a carriage, which carries no other axis
        rotors.append(_add_axis(body, number, linear, inertia, weight / GRAVITY, inertia if alone else NOTHING))
    rotors += [found[f"inertia_{motor}"] for motor in mechanism.shared]
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    load = np.array([found[f"offset_{number}"] for number in range(1, axes.count + 1)])
    names = [f"axis_{number}" for number in range(1, axes.count + 1)]
    left_out = finish(spec, axes, names, np.array(rotors), load)
    spec.compile()
    return MachineFile(spec.to_xml(), figures(axes, {}), left_out)


def _add_axis(
    body: mujoco.MjsBody, number: int, linear: bool, inertia: float, moment: np.ndarray, mass: float
) -> float:
    """Give a body its joint and its weight; the inertia, kg m^2 or kg, that is left for the rotor. moment: (2,) kg m,
    mass times the place of its centre along y and z: the torque s sin q + c cos q is that of m g (c, -s). mass: kg,
    without a weight. Of a linear axis it is the inertia: MuJoCo measures friction by the mass of bodies alone."""
    joint = body.add_joint(name=f"axis_{number}", axis=[1.0, 0.0, 0.0])
    joint.type = mujoco.mjtJoint.mjJNT_SLIDE if linear else mujoco.mjtJoint.mjJNT_HINGE
    size = float(np.linalg.norm(moment))
    mass = size**2 / (IN_BODY * inertia) if size else mass
    centre = moment / mass
    body.explicitinertial, body.mass, body.ipos, body.inertia = True, mass, [0.0, *centre], [NOTHING] * 3
    shape = body.add_geom(mass=0.0, contype=0, conaffinity=0)
    if linear:
        shape.type, shape.size = mujoco.mjtGeom.mjGEOM_BOX, [0.1, 0.1, 0.05]
    else:
        tip = centre if size else (0.0, -0.2)
        shape.type, shape.fromto, shape.size = (
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            [0.0, 0.0, 0.0, 0.0, *tip],
            [0.02, 0.0, 0.0],
        )
    return inertia - (mass if linear else mass * float(centre @ centre))
