"""The closed-chain Delta as a MuJoCo model: arms, two rods a forearm, a platform that only translates.

Each rod hangs on its elbow by a universal joint (a rod has no inertia about its own axis, so its spin is nobody's
business) and is closed onto the platform by a `connect` constraint. MuJoCo's constraints are soft; at impedance 0.9999
and a time constant of two steps the loops stay closed within a micrometre.

No rigid-body formula of `service.model` is used here, only its geometry, to start in a closed pose.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from drivers.simulated.plant.truth import ROD_SPACING, PlantTruth
from schemas.errors import PoseError
from service.model import kinematics
from service.model.nominal import DeltaModel

# What MuJoCo warns of (a mechanism torn apart) is an error of ours; by default it writes a log into the current folder.
mujoco.set_mju_user_warning(lambda message: None)

IMPEDANCE = 0.9999  # MuJoCo's upper bound: share of the constraint acceleration that is removed
SIDES = (-ROD_SPACING / 2, ROD_SPACING / 2)  # m, of a forearm's rods from its middle
THIN = 1e-7  # kg m^2 about a link's own axis: nothing, but MuJoCo wants it positive


@dataclass(frozen=True)
class BaseMode:
    """The base frame swings horizontally as one mass on a spring: mass kg, frequency Hz, damping ratio, azimuth rad."""

    mass: float
    frequency: float
    damping_ratio: float
    azimuth: float


@dataclass(frozen=True)
class Design:
    """What is built: the truth, and what effects put between its bodies.

    drive_stiffness: N m/rad a joint between motor and link; 0: they are one mass. drive_damping_ratio and half_gap
    (rad) go with it.
    """

    truth: PlantTruth
    drive_stiffness: tuple[float, ...] = (0.0, 0.0, 0.0)
    drive_damping_ratio: tuple[float, ...] = (0.0, 0.0, 0.0)
    half_gap: tuple[float, ...] = (0.0, 0.0, 0.0)
    base_mode: BaseMode | None = None

    @property
    def split(self) -> tuple[bool, ...]:
        """Joints whose motor is a mass of its own."""
        return tuple(value > 0 for value in self.drive_stiffness)

    def change(self, **fields: object) -> Design:
        """The same with fields of the truth changed."""
        return replace(self, truth=self.truth.model_copy(update=fields))

    def soften(self, stiffness: Sequence[float], damping_ratio: float) -> Design:
        """The same with a spring and damper between motor and link where `stiffness` (3,) N m/rad is not 0.

        A softer one that is already there stays. A motor without inertia is given a tenth of the active link's.
        """
        softest, ratio, rotor = list(self.drive_stiffness), list(self.drive_damping_ratio), []
        for i, value in enumerate(stiffness):
            if value > 0 and (softest[i] == 0 or value < softest[i]):
                softest[i], ratio[i] = value, damping_ratio
            inertia = self.truth.rotor_inertia_kgm2[i]
            rotor.append(inertia or (0.1 * self.truth.active_link_inertia_kgm2[i] if softest[i] else 0.0))
        changed = self.change(rotor_inertia_kgm2=rotor)
        return replace(changed, drive_stiffness=tuple(softest), drive_damping_ratio=tuple(ratio))

    def loosen(self, half_gap: Sequence[float]) -> Design:
        """The same with lost motion of +-`half_gap` (3,) rad between motor and link."""
        return replace(self, half_gap=tuple(a + b for a, b in zip(self.half_gap, half_gap, strict=True)))


class CompiledMechanism(NamedTuple):
    """A compiled model and where its coordinates lie."""

    model: mujoco.MjModel
    geometry: DeltaModel  # true geometry, angles at the link
    arm: np.ndarray  # (3,) address of each link's joint
    motor: np.ndarray  # (3,) address of each rotor, the link's own where motor and link are one
    platform: np.ndarray  # (3,) addresses of x, y, z
    platform_body: int


def true_geometry(truth: PlantTruth) -> DeltaModel:
    """The true lengths as the kinematics want them; angles are those of the links, so without encoder offset."""
    azimuth = np.radians(truth.arm_angles_deg)
    zero = np.zeros(3)
    return DeltaModel(
        azimuth_cos=np.cos(azimuth),
        azimuth_sin=np.sin(azimuth),
        joint_offset=zero,
        active_length=np.array(truth.active_link_length_m),
        passive_length=np.array(truth.passive_link_length_m),
        radius=np.array(truth.base_radius_m) - truth.platform_radius_m,
        inertia=zero,
        link_mass=0.0,
        moving_mass=0.0,
        gravity=zero,
    )


def build(design: Design, step: float) -> CompiledMechanism:
    """Compile `design` for an integration step of `step` s."""
    truth = design.truth
    model = specify(design, step).compile()
    address = {model.joint(i).name: i for i in range(model.njnt)}  # hinges and slides only: joint = coordinate = dof
    arm = np.array([address[f"arm{i}"] for i in range(3)])
    motor = np.array([address.get(f"motor{i}", arm[i]) for i in range(3)])
    platform = np.array([address[axis] for axis in "xyz"])
    return CompiledMechanism(model, true_geometry(truth), arm, motor, platform, model.body("platform").id)


def close(mechanism: CompiledMechanism, theta: np.ndarray) -> np.ndarray:
    """All coordinates (N, nq) of closed poses with the links at `theta` (N, 3) rad, rotors with them.

    Raises:
        PoseError: unreachable or singular.
    """
    geometry = mechanism.geometry
    theta = kinematics.rows(theta)
    platform = kinematics.forward(geometry, theta)
    coordinates = np.zeros((len(theta), mechanism.model.nq))
    coordinates[:, mechanism.motor] = theta
    coordinates[:, mechanism.arm] = theta
    coordinates[:, mechanism.platform] = platform
    for i in range(3):
        cosine, sine = geometry.azimuth_cos[i], geometry.azimuth_sin[i]
        radial = cosine * platform[:, 0] + sine * platform[:, 1] - geometry.radius[i]
        radial = radial - geometry.active_length[i] * np.cos(theta[:, i])
        lateral = -sine * platform[:, 0] + cosine * platform[:, 1]
        vertical = platform[:, 2] + geometry.active_length[i] * np.sin(theta[:, i])
        swing = np.unwrap(np.arctan2(-vertical, radial)) - theta[:, i]
        for rod in range(2):
            coordinates[:, mechanism.arm[i] + 1 + 2 * rod] = swing
            coordinates[:, mechanism.arm[i] + 2 + 2 * rod] = np.arcsin(lateral / geometry.passive_length[i])
    return coordinates


def dependence(mechanism: CompiledMechanism, theta: np.ndarray) -> np.ndarray:
    """d coordinates / d theta on the closed chain, (N, nv, 3), by central differences of `close`."""
    delta = 1e-5
    columns = []
    for i in range(3):
        shift = np.zeros(3)
        shift[i] = delta
        columns.append((close(mechanism, theta + shift) - close(mechanism, theta - shift)) / (2 * delta))
    return np.stack(columns, axis=2)


def required_torque(
    mechanism: CompiledMechanism, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray
) -> np.ndarray:
    """Joint torque (N, 3) N m that a motion of the closed chain takes, exactly: MuJoCo's inverse dynamics of the open
    tree, virtual work over the loops. Friction in the joints is not in it.

    theta, theta_dot, theta_ddot: (N, 3) rad, rad/s, rad/s^2 of the links.

    Raises:
        PoseError: unreachable or singular.
    """
    model = mechanism.model
    theta, theta_dot, theta_ddot = (kinematics.rows(value) for value in (theta, theta_dot, theta_ddot))
    position = close(mechanism, theta)
    partial = dependence(mechanism, theta)
    # d/dt along the motion of the dependence, from the motion a little earlier and later
    tiny = 1e-4
    later = dependence(mechanism, theta + theta_dot * tiny)
    earlier = dependence(mechanism, theta - theta_dot * tiny)
    change = (later - earlier) / (2 * tiny)
    velocity = np.einsum("nki,ni->nk", partial, theta_dot)
    acceleration = np.einsum("nki,ni->nk", partial, theta_ddot) + np.einsum("nki,ni->nk", change, theta_dot)
    data = mujoco.MjData(model)
    open_tree = np.empty_like(position)
    loops, friction = model.opt.disableflags, model.dof_frictionloss.copy()
    damping = model.dof_damping.copy()
    model.opt.disableflags = loops | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_damping[:] = 0.0
    try:
        for n in range(len(theta)):
            data.qpos[:], data.qvel[:], data.qacc[:] = position[n], velocity[n], acceleration[n]
            mujoco.mj_inverse(model, data)
            open_tree[n] = data.qfrc_inverse
    finally:
        model.opt.disableflags = loops
        model.dof_frictionloss[:], model.dof_damping[:] = friction, damping
    return np.einsum("nki,nk->ni", partial, open_tree)


def holding_torque(mechanism: CompiledMechanism, theta: np.ndarray) -> np.ndarray:
    """Joint torque (3,) N m that holds the links at `theta` (3,) rad."""
    zero = np.zeros((1, 3))
    return required_torque(mechanism, theta[None], zero, zero)[0]


def reflected_inertia(mechanism: CompiledMechanism, theta: np.ndarray) -> np.ndarray:
    """Diagonal (3,) kg m^2 of the joint-space inertia of the closed chain at `theta` (3,) rad."""
    three = np.repeat(theta[None], 3, axis=0)
    still = np.zeros((3, 3))
    return np.diag(required_torque(mechanism, three, still, np.eye(3)) - holding_torque(mechanism, theta))


def centre_pose(truth: PlantTruth) -> np.ndarray:
    """Joint angles (3,) of a pose in the middle of the workspace: links a little below the horizontal."""
    theta = np.full(3, 0.2)
    try:
        kinematics.forward(true_geometry(truth), theta)
    except PoseError as error:
        raise PoseError(f"the simulated robot cannot be assembled in the middle of its workspace: {error}") from error
    return theta


def specify(design: Design, step: float) -> mujoco.MjSpec:
    """`design` as an editable model, for an integration step of `step` s. Joints `arm<i>`, `motor<i>` where a motor is
    a mass of its own, `x`, `y`, `z` of the platform."""
    truth, spec = design.truth, mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.gravity = step, truth.gravity_mps2
    option.integrator, option.solver = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian, option.tolerance, option.iterations = mujoco.mjtJacobian.mjJAC_DENSE, 1e-12, 20
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    upper = spec.worldbody if design.base_mode is None else _swinging_base(spec, design.base_mode)
    for i in range(3):
        _add_arm(upper, design, i, step)
    for i in range(3):
        if design.split[i]:
            rotor = truth.rotor_inertia_kgm2[i]
            motor = _add_body(upper, f"motor{i}", 1.0, [0, 0, 0], [rotor] * 3, **_place(truth, i))
            _hinge(motor, f"motor{i}", step)
    platform = _add_body(spec.worldbody, "platform", truth.platform_kg, [0, 0, 0], [1e-3] * 3)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        platform.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    for i in range(3):
        azimuth = math.radians(truth.arm_angles_deg[i])
        cosine, sine = math.cos(azimuth), math.sin(azimuth)
        for rod, side in enumerate(SIDES):
            x = truth.platform_radius_m * cosine - side * sine
            y = truth.platform_radius_m * sine + side * cosine
            platform.add_site(name=f"foot{i}{rod}", pos=[x, y, 0.0])
            spec.add_equality(
                type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_SITE, name1=f"end{i}{rod}",
                name2=f"foot{i}{rod}", solref=[2 * step, 1.0], solimp=[IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0],
            )  # fmt: skip
    return spec


def _add_arm(upper: mujoco.MjsBody, design: Design, i: int, step: float) -> None:
    truth = design.truth
    length, mass, centre = truth.active_link_length_m[i], truth.active_link_kg[i], truth.active_link_centre_m[i]
    about_centre = max(truth.active_link_inertia_kgm2[i] - mass * centre**2, THIN)
    arm = _add_body(upper, f"arm{i}", mass, [centre, 0, 0], [THIN, about_centre, about_centre], **_place(truth, i))
    _hinge(arm, f"arm{i}", step).armature = 0.0 if design.split[i] else truth.rotor_inertia_kgm2[i]
    rod_mass, rod_length = truth.forearm_kg[i] / 2, truth.passive_link_length_m[i]
    across = rod_mass * rod_length**2 / 12
    for number, side in enumerate(SIDES):
        middle, inertia = [rod_length / 2, 0, 0], [min(THIN, across), across, across]
        rod = _add_body(arm, f"rod{i}{number}", rod_mass, middle, inertia, pos=[length, side, 0.0])
        rod.add_joint(name=f"swing{i}{number}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
        rod.add_joint(name=f"tilt{i}{number}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        rod.add_site(name=f"end{i}{number}", pos=[rod_length, 0, 0])


def _swinging_base(spec: mujoco.MjSpec, mode: BaseMode) -> mujoco.MjsBody:
    stiffness = mode.mass * (2 * math.pi * mode.frequency) ** 2
    base = _add_body(spec.worldbody, "base", mode.mass, [0, 0, 0], [1.0] * 3)
    base.add_joint(
        name="base", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[math.cos(mode.azimuth), math.sin(mode.azimuth), 0.0],
        stiffness=stiffness, damping=2 * mode.damping_ratio * math.sqrt(stiffness * mode.mass),
    )  # fmt: skip
    return base


def _add_body(
    parent: mujoco.MjsBody, name: str, mass: float, centre: Sequence[float], inertia: Sequence[float], **place: Any
) -> mujoco.MjsBody:
    return parent.add_body(name=name, mass=mass, ipos=centre, inertia=inertia, explicitinertial=True, **place)


def _place(truth: PlantTruth, i: int) -> dict[str, list[float]]:
    """Of a joint's axis on the base."""
    azimuth, radius = math.radians(truth.arm_angles_deg[i]), truth.base_radius_m[i]
    pos = [radius * math.cos(azimuth), radius * math.sin(azimuth), 0.0]
    return {"pos": pos, "quat": [math.cos(azimuth / 2), 0.0, 0.0, math.sin(azimuth / 2)]}


def _hinge(body: mujoco.MjsBody, name: str, step: float) -> mujoco.MjsJoint:
    friction = {"solref_friction": [2 * step, 1.0], "solimp_friction": [IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0]}
    return body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], **friction)
