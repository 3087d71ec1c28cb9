"""Elastic and loose gears of a Delta: the links' angles as states behind the motors', coupled through the mass matrix.

    M_l(theta_l) theta_l_ddot + h(theta_l, theta_l_dot) = -K e - D e_dot,   e = theta_l - theta_m, of joints that yield
    T = J_m theta_m_ddot - K e - D e_dot, before the motor's friction;      e = 0 and T the whole row, of stiff ones

M_l is the base model's mass matrix less what turns with the motors. `advance_kernel` takes one sample, online and in
the batch alike. The linear part is taken implicitly (the trapezoidal rule, which damps nothing of its own and is stable
for every stiffness), geometry and weight by a predictor and a corrector.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.model.dynamics import TERMS
from service.model.forward import bias_kernel, forward_dynamics, mass_kernel, solve_kernel
from service.model.kinematics import POSE, REACHED
from service.model.nominal import DeltaModel, record_of
from service.model.scene import Scene

MIDDLE = 0.4  # rad, angle of all joints at which a link has the inertia that its natural frequency is told for
TURN = 0.25  # rad of the fastest swing in a substep: its frequency is then half a percent off
LOST = 0.5  # rad of twist at which a gear has come apart
LEFT = 0.02  # of a joint's inertia that is left to the link, however much turns with the motor

# Three numbers are one a joint; of a stiff one all are zero.
GEARS = np.dtype(
    [
        ("stiffness", "f8", 3),  # N m/rad
        ("damping", "f8", 3),  # N m s/rad
        ("motor", "f8", 3),  # kg m^2 that turn with the motor
        ("half", "f8", 3),  # rad, lost motion to each side
        ("fastest", "f8"),  # rad/s, of the links' swings against held motors
    ],
    align=True,
)

# What is carried from sample to sample, and below `pose` what one works on. Three numbers are one a joint, N m and rad.
ELASTIC = np.dtype(
    [
        ("twist", "f8", 3),  # rad, link less motor
        ("rate", "f8", 3),  # rad/s
        ("change", "f8", 3),  # rad/s^2
        ("torque", "f8", 3),  # N m that the motors give, their friction apart
        ("mass", "f8", (3, 3)),  # kg m^2 of the links
        ("motor", "f8", 3),  # kg m^2 that turn with the motors there
        ("bias", "f8", 3),  # N m that the links take without acceleration
        ("demand", "f8", 3),  # N m that they take at the motors' acceleration
        ("pose", POSE),  # of the links
        ("terms", "f8", (len(TERMS), 3)),
        ("link", "f8", 3),
        ("link_dot", "f8", 3),
        ("before", "f8", 3),
        ("old_twist", "f8", 3),
        ("old_rate", "f8", 3),
        ("old_mass", "f8", (3, 3)),
        ("matrix", "f8", (3, 3)),
        ("side", "f8", 3),
        ("speed", "f8", 3),
        ("present", "f8", 3),
        ("closed", "i8", 3),
        ("flank", "f8", 3),
    ],
    align=True,
)


@kernel
def split_kernel(gears, s):
    """Take the motors off s.mass; what its pivots then lack stays with the link, so that it is a mass matrix."""
    mass, pivot = s.mass, s.side
    for i in range(3):
        whole = mass[i, i]
        s.motor[i] = 0.0
        if gears.stiffness[i] > 0.0:
            left = whole - gears.motor[i]
            for j in range(i):
                if gears.stiffness[j] > 0.0:
                    across = mass[i, j]
                    if i == 2 and j == 1 and gears.stiffness[0] > 0.0:
                        across -= mass[2, 0] * mass[1, 0] / pivot[0]
                    left -= across * across / pivot[j]
            pivot[i] = max(left, LEFT * whole)
            mass[i, i] = whole - gears.motor[i] + (pivot[i] - left)
            s.motor[i] = whole - mass[i, i]


@kernel
def _links_kernel(model, rho_1, rho_2, forearm, carried, gears, theta, theta_dot, theta_ddot, s):
    """Masses and torque of the links at their present twist. Returns a status."""
    for i in range(3):
        s.link[i] = theta[i] + s.twist[i]
        s.link_dot[i] = theta_dot[i] + s.rate[i]
    status = bias_kernel(model, rho_2, forearm, carried, s.link, s.link_dot, s.pose, s.terms, s.bias)
    if status != REACHED:
        return status
    mass_kernel(model, rho_1, forearm, carried, s.pose, s.mass)
    split_kernel(gears, s)
    for i in range(3):
        s.demand[i] = s.bias[i]
        for j in range(3):
            s.demand[i] += s.mass[i, j] * theta_ddot[j]
    return status


@kernel
def _passed(gears, i, twist, rate):
    """N m from motor to link; flanks push, they do not pull."""
    stiffness, damping, half = gears.stiffness[i], gears.damping[i], gears.half[i]
    if half == 0.0:
        return -stiffness * twist - damping * rate
    if twist > half:
        return min(0.0, -stiffness * (twist - half) - damping * rate)
    if twist < -half:
        return max(0.0, -stiffness * (twist + half) - damping * rate)
    return 0.0


@kernel
def _meet(gears, s, h):
    """s.closed of gears whose flanks touch or will within `h` s, and where: s.flank."""
    for i in range(3):
        half, twist = gears.half[i], s.twist[i]
        ahead = twist + h * s.rate[i]
        s.flank[i] = half if max(twist, ahead) > half else -half
        meets = half == 0.0 or max(abs(twist), abs(ahead)) > half
        s.closed[i] = 1 if meets and gears.stiffness[i] > 0.0 else 0


@kernel
def _part(gears, s, h):
    """Open closed gaps that would pull over a substep at s.speed. Returns whether there was one."""
    pulled = False
    for i in range(3):
        if s.closed[i] == 1 and gears.half[i] > 0.0:
            bent = s.twist[i] + 0.5 * h * s.speed[i] - s.flank[i]
            if (-gears.stiffness[i] * bent - gears.damping[i] * s.speed[i]) * s.flank[i] > 0.0:
                s.closed[i], pulled = 0, True
    return pulled


@kernel
def _mean_rate(gears, s, mass, demand, h):
    """s.speed: mean rate w over `h` s by the trapezoidal rule, (2 M / h + D + h K / 2) w = 2 M v / h - demand - K e."""
    matrix, side = s.matrix, s.side
    for i in range(3):
        yields = gears.stiffness[i] > 0.0
        side[i] = -demand[i] if yields else 0.0
        for j in range(3):
            matrix[i, j] = 2.0 / h * mass[i, j] if yields and gears.stiffness[j] > 0.0 else 0.0
            side[i] += matrix[i, j] * s.rate[j]
        if s.closed[i] == 1:
            matrix[i, i] += gears.damping[i] + 0.5 * h * gears.stiffness[i]
            side[i] -= gears.stiffness[i] * (s.twist[i] - s.flank[i])
        if not yields:
            matrix[i, i] = 1.0
    solve_kernel(matrix, side, s.speed)


@kernel
def _swing(gears, s, mass, before, after, period):
    """s.twist and s.rate `period` s on, with `mass` (3, 3) and a demand (3,) that goes straight from `before` to
    `after`."""
    substeps = max(1, math.ceil(period * gears.fastest / TURN))
    h = period / substeps
    for k in range(substeps):
        share = (k + 0.5) / substeps
        for i in range(3):
            s.present[i] = before[i] + share * (after[i] - before[i])
        _meet(gears, s, h)
        _mean_rate(gears, s, mass, s.present, h)
        while _part(gears, s, h):
            _mean_rate(gears, s, mass, s.present, h)
        for i in range(3):
            s.twist[i] += h * s.speed[i]
            s.rate[i] = 2.0 * s.speed[i] - s.rate[i]


@kernel
def _answer(gears, theta_ddot, s):
    """s.change and s.torque of where the links are. Springs take their torque from the twist; where there is play, see
    `_knock`."""
    matrix, side = s.matrix, s.side
    for i in range(3):
        yields = gears.stiffness[i] > 0.0
        for j in range(3):
            matrix[i, j] = s.mass[i, j] if yields and gears.stiffness[j] > 0.0 else 0.0
        passed = _passed(gears, i, s.twist[i], s.rate[i])
        side[i] = passed - s.demand[i] if yields else 0.0
        if not yields:
            matrix[i, i] = 1.0
        s.torque[i] = s.motor[i] * theta_ddot[i] + passed if yields else s.demand[i]
    solve_kernel(matrix, side, s.change)
    for i in range(3):
        if gears.stiffness[i] == 0.0:
            for j in range(3):
                s.torque[i] += s.mass[i, j] * s.change[j]


@kernel
def _knock(gears, theta_ddot, period, s):
    """Where there is play, s.change is the mean over the `period` s since the sample before and s.torque goes by it:
    flanks meet for less than that, and the motors take all of their push."""
    if gears.half[0] + gears.half[1] + gears.half[2] == 0.0:
        return
    for i in range(3):
        s.change[i] = (s.rate[i] - s.old_rate[i]) / period
    for i in range(3):
        s.torque[i] = s.demand[i] + s.motor[i] * theta_ddot[i]
        for j in range(3):
            s.torque[i] += s.mass[i, j] * s.change[j]


@kernel
def start_kernel(model, rho_1, rho_2, forearm, carried, gears, theta, theta_dot, theta_ddot, s):
    """Begin at a sample: the gears at rest under what the links take there. As `advance_kernel`, without a period."""
    for i in range(3):
        s.twist[i] = s.rate[i] = 0.0
    status = _links_kernel(model, rho_1, rho_2, forearm, carried, gears, theta, theta_dot, theta_ddot, s)
    if status != REACHED:
        return status
    for i in range(3):
        if gears.stiffness[i] > 0.0:
            s.twist[i] = -s.demand[i] / gears.stiffness[i] - math.copysign(gears.half[i], s.demand[i])
    _answer(gears, theta_ddot, s)
    return status


@kernel
def advance_kernel(model, rho_1, rho_2, forearm, carried, gears, theta, theta_dot, theta_ddot, period, s):
    """Go from the sample before, where `s` is, to the present one.

    model: MODEL record. rho_1, rho_2: (3,). forearm, carried: kg, of the rods and on the platform. gears: GEARS record
    (`gears_of`). theta, theta_dot, theta_ddot: (3,) rad, rad/s, rad/s^2 of the motors at the present sample, on the
    joint side; straight in between. period: s since the sample before.

    s: ELASTIC record, first filled by `start_kernel`, then carried along: twist, rate and change (3,) are the links'
    motion relative to the motors', rad, rad/s, rad/s^2; torque (3,) N m is what the motors give for this motion, their
    friction apart: it stands in for rho_1 inertia + rho_2 gravity + platform + m_f forearm of the rigid model; pose is
    of the links. Returns a status; the state is not to be used any more where it is not REACHED.
    """
    twist, rate = s.twist, s.rate
    for i in range(3):
        s.old_twist[i], s.old_rate[i], s.before[i] = twist[i], rate[i], s.demand[i]
        s.demand[i] = s.bias[i]
        for j in range(3):
            s.old_mass[i, j] = s.mass[i, j]
            s.demand[i] += s.mass[i, j] * theta_ddot[j]
    _swing(gears, s, s.old_mass, s.before, s.demand, period)
    status = _links_kernel(model, rho_1, rho_2, forearm, carried, gears, theta, theta_dot, theta_ddot, s)
    if status != REACHED:
        return status
    for i in range(3):
        twist[i], rate[i] = s.old_twist[i], s.old_rate[i]
        for j in range(3):
            s.old_mass[i, j] = 0.5 * (s.old_mass[i, j] + s.mass[i, j])
    _swing(gears, s, s.old_mass, s.before, s.demand, period)
    _answer(gears, theta_ddot, s)
    _knock(gears, theta_ddot, period, s)
    return status


@kernel(nogil=True)
def _elastic_batch(model, rho_1, rho_2, forearm, gears, theta, theta_dot, theta_ddot, period, relative, torque):
    states = np.zeros(1, ELASTIC)
    for n in range(len(theta)):
        s = states[0]
        if n == 0:
            status = start_kernel(model, rho_1, rho_2, forearm, 0.0, gears, theta[n], theta_dot[n], theta_ddot[n], s)
        else:
            status = advance_kernel(
                model, rho_1, rho_2, forearm, 0.0, gears, theta[n], theta_dot[n], theta_ddot[n], period, s
            )
        if status != REACHED:
            return n
        for i in range(3):
            relative[0, n, i], relative[1, n, i], relative[2, n, i] = s.twist[i], s.rate[i], s.change[i]
            torque[n, i] = s.torque[i]
    return len(theta)


class Elastic(NamedTuple):
    """Links behind recorded motors. twist, rate, change: (N, 3) rad, rad/s, rad/s^2 of the links relative to the
    motors. torque: (N, 3) N m that the motors give, their friction apart. reached: the first of the samples that is not
    filled, N where the links stay in the workspace."""

    twist: np.ndarray
    rate: np.ndarray
    change: np.ndarray
    torque: np.ndarray
    reached: int


def elastic_motion(
    model: DeltaModel, rigid: np.ndarray, gears: np.ndarray, motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    period: float,
) -> Elastic:  # fmt: skip
    """Links behind motors that go through `motion` (three of (N, 3) rad, rad/s, rad/s^2). rigid: rho_1, rho_2, forearm
    kg. gears: as of `gears_of`. period: s between samples."""
    theta, theta_dot, theta_ddot = (np.ascontiguousarray(signal) for signal in motion)
    relative, torque = np.zeros((3, *theta.shape)), np.zeros(theta.shape)
    rho_1, rho_2, forearm = (float(value) for value in rigid)
    reached = _elastic_batch(
        record_of(model), np.full(3, rho_1), np.full(3, rho_2), forearm, gears[0], theta, theta_dot, theta_ddot,
        period, relative, torque,
    )  # fmt: skip
    return Elastic(relative[0], relative[1], relative[2], torque, reached)


def gears_of(model: DeltaModel, rigid: np.ndarray, figures: Mapping[int, tuple[float, ...]]) -> np.ndarray:
    """(1,) GEARS record. figures: joint -> half the lost motion, rad; natural frequency, Hz, of the link against held
    motors, its damping ratio, and the share of the joint's inertia that turns with the motor. Inertias are those with
    all joints at `MIDDLE`.

    Raises:
        PoseError: the robot does not get there.
    """
    gears = np.zeros(1, GEARS)
    if not figures:
        return gears
    mass = _middle(model, rigid)
    inertia, most = shared_out(mass)
    for joint, told in figures.items():
        half, stiffness, damping, motor = train(inertia[joint], most, *told)
        gears["half"][0, joint], gears["motor"][0, joint] = half, motor
        gears["stiffness"][0, joint], gears["damping"][0, joint] = stiffness, damping
    gears["fastest"] = _fastest(mass, gears)
    return gears


def leads(figures: Mapping[int, tuple[float, ...]]) -> bool:
    """Whether planned motion is that of the links, and motors go ahead of it: gears of `figures`, as of `gears_of`,
    yield, and none is loose."""
    return bool(figures) and not any(half for half, *_ in figures.values())


def _middle(model: DeltaModel, rigid: np.ndarray) -> np.ndarray:
    """Mass matrix (3, 3) kg m^2 with all joints at `MIDDLE`."""
    pose = np.full((1, 3), MIDDLE)
    return forward_dynamics(model, rigid, pose, 0.0 * pose, 0.0 * pose)[1][0]


def inertias(model: DeltaModel, rigid: np.ndarray) -> tuple[np.ndarray, float]:
    """(3,) kg m^2 of the joints with all of them at `MIDDLE`, zero of a model that found none; and the share of all of
    them that may turn with the motors.

    Raises:
        PoseError: the robot does not get there.
    """
    return shared_out(_middle(model, rigid))


def shared_out(mass: np.ndarray) -> tuple[np.ndarray, float]:
    """The same of a mass matrix (3, 3): what each joint feels of the others' masses cannot turn with its motor."""
    inertia = np.maximum(np.diag(mass), 0.0)
    if not inertia.all():
        return inertia, 0.0
    size = np.sqrt(inertia)
    return inertia, max(float(np.linalg.eigvalsh(mass / np.outer(size, size))[0]) - LEFT, 0.0)


def train(inertia: float, most: float, half, natural_hz, damping_ratio, motor_share):
    """Half the lost motion rad, stiffness N m/rad, damping N m s/rad, and kg m^2 that turn with the motor, of figures
    as of `gears_of`, four numbers or arrays. most: share of the inertia that may turn with the motor."""
    motor = np.minimum(motor_share, most) * inertia
    link = np.maximum(inertia - motor, LEFT * inertia)
    stiffness = link * (2 * np.pi * natural_hz) ** 2
    return half, stiffness, 2 * damping_ratio * np.sqrt(stiffness * link), motor


def _fastest(mass: np.ndarray, gears: np.ndarray) -> float:
    """rad/s of the fastest swing of links on their springs."""
    some = np.flatnonzero(gears["stiffness"][0])
    if not len(some):
        return 0.0
    links = (mass - np.diag(gears["motor"][0]))[np.ix_(some, some)]
    least = LEFT * np.diag(mass)[some].min()
    values, vectors = np.linalg.eigh(links)
    links = (vectors * np.maximum(values, least)) @ vectors.T
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(links, np.diag(gears["stiffness"][0, some]))).real.max()))


def coupled(scene: Scene, figures: Mapping[int, tuple[float, float, float, float]]) -> np.ndarray:
    """Torque (N, 3) N m that gears with `figures`, as of `gears_of`, add to the rigid torque of a Delta; none at all
    where the links leave the workspace or come apart."""
    motion = scene.segment.theta, scene.segment.theta_dot, scene.segment.theta_ddot
    gears = gears_of(scene.delta.model, scene.base.rigid, figures)
    found = elastic_motion(scene.delta.model, scene.base.rigid, gears, motion, scene.period)
    if found.reached < len(scene.time) or not np.abs(found.twist).max() < LOST:
        return np.zeros_like(found.torque)
    return found.torque - scene.load
