"""One axis through `mujoco.sysid`: its parameters tuned until windows rolled out from the measured state end where the
axis did.

The model, the parameters, their bounds and the windows are our choice; the method and its settings are MuJoCo's.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import sysid

from schemas.trace import Trace
from service.model.prediction import motion

WINDOW = 0.2  # s
STEP = 1e-3  # s, of the simulation
GRAVITY = 9.81  # m/s^2
WEIGHT = 10.0  # kg, of a turning body whose centre is searched: its inertia is then little


def _spec(linear: bool) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = STEP, [0.0, 0.0, -GRAVITY]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    body = spec.worldbody.add_body(name="link")
    joint = body.add_joint(name="axis", axis=[1.0, 0.0, 0.0])
    joint.type = mujoco.mjtJoint.mjJNT_SLIDE if linear else mujoco.mjtJoint.mjJNT_HINGE
    joint.solref_friction, joint.solimp_friction = [2 * STEP, 1.0], [0.99, 0.99, 1e-3, 0.5, 2.0]
    body.explicitinertial = True
    body.mass, body.inertia, body.ipos = WEIGHT, [1e-9] * 3, [0.0, 0.0, 0.0]
    drive = spec.add_actuator(name="drive", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="axis")
    drive.set_to_motor()
    drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    joint_position = mujoco.mjtSensor.mjSENS_JOINTPOS
    spec.add_sensor(name="angle", type=joint_position, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname="axis")
    return spec


def _parameters(linear: bool, torque: float, speed: float, acceleration: float) -> sysid.ParameterDict:
    """What is searched, in terms of the log's own rms."""

    def one(name: str, nominal: float, low: float, high: float, put) -> sysid.Parameter:
        return sysid.Parameter(name, nominal, low, high, modifier=lambda spec, p: put(spec, float(p.value[0])))

    def joint(key: str):
        def put(spec: mujoco.MjSpec, value: float) -> None:
            part = spec.joint("axis")
            setattr(part, key, value if np.isscalar(getattr(part, key)) else [value, 0.0, 0.0])

        return put

    def bias(spec: mujoco.MjSpec, value: float) -> None:
        spec.actuator("drive").biasprm[0] = -value

    def centre(place: int):
        def put(spec: mujoco.MjSpec, value: float) -> None:
            spec.body("link").ipos[place] = value / (WEIGHT * GRAVITY)

        return put

    def mass(spec: mujoco.MjSpec, value: float) -> None:
        spec.body("link").mass = value

    inertia = torque / acceleration
    found = [
        one("inertia", inertia, 0.01 * inertia, 10 * inertia, mass if linear else joint("armature")),
        one("viscous", 0.3 * torque / speed, 0.0, 3 * torque / speed, joint("damping")),
        one("coulomb", 0.3 * torque, 0.0, 2 * torque, joint("frictionloss")),
        one("offset", 0.0, -2 * torque, 2 * torque, bias),
    ]
    if not linear:
        found += [
            one("sin", 0.5 * torque, -3 * torque, 3 * torque, lambda spec, value: centre(2)(spec, -value)),
            one("cos", 0.0, -3 * torque, 3 * torque, centre(1)),
        ]
    return sysid.ParameterDict({parameter.name: parameter for parameter in found})


def windows(trace: Trace) -> list[tuple[np.ndarray, ...]]:
    """Clock from 0, position (k, 1), torque (k, 1) and first speed of stretches in which an axis moves."""
    along = motion(trace)
    starts = np.searchsorted(trace.time, np.arange(trace.time[0], trace.time[-1] - WINDOW, WINDOW))
    result = []
    for start in starts.tolist():
        rows = np.flatnonzero((trace.time >= trace.time[start]) & (trace.time <= trace.time[start] + WINDOW))
        if along.moving[rows].all():
            clock = trace.time[rows] - trace.time[rows[0]]
            result.append((clock, trace.position[rows], trace.torque[rows], along.theta_dot[rows[0]]))
    return result


def tuned(traces: Sequence[Trace], linear: bool) -> np.ndarray:
    """Inertia, viscous and Coulomb friction, constant, weight as sine and cosine."""
    spec = _spec(linear)
    model = spec.compile()
    every = [window for trace in traces for window in windows(trace)]
    along = [motion(trace) for trace in traces]
    torque, speed, acceleration = (
        float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        for parts in (
            [trace.torque for trace in traces], [one.theta_dot for one in along], [one.theta_ddot for one in along]
        )
    )  # fmt: skip
    sequences = sysid.ModelSequences(
        "axis",
        spec,
        [str(number) for number in range(len(every))],
        [sysid.create_initial_state(model, position[0], speed) for _, position, _, speed in every],
        [sysid.TimeSeries.from_control_names(clock, torque, model) for clock, _, torque, _ in every],
        [sysid.TimeSeries.from_names(clock, position, model) for clock, position, _, _ in every],
    )
    start = _parameters(linear, torque, speed, acceleration)
    found, _ = sysid.optimize(start, sysid.build_residual_fn(models_sequences=[sequences]), verbose=False)
    values = found.as_vector()
    if linear:
        return np.r_[values, 0.0, 0.0]
    lever = np.hypot(values[4], values[5]) / (WEIGHT * GRAVITY)
    return np.r_[values[0] + WEIGHT * lever**2, values[1:]]
