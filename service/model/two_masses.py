"""Two masses a joint: the motor, whose angle is measured, and the link behind a compliant or loose gear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.model.elastic import inertias, train
from service.model.gears import SUBSTEPS_PER_SECOND
from service.model.scene import Scene

LOST = 0.5  # rad of relative motion at which a two-mass simulation has come apart
SLIGHT = 0.01  # rad of relative motion up to which its square is below a thousandth of the torque


class Link(NamedTuple):
    """What the link takes, (N,) each. demand: N m without its own acceleration. inertia, the motor's with it, drag,
    spring: N m per rad/s^2, rad/s, rad of its motion relative to the motor."""

    demand: np.ndarray
    inertia: np.ndarray
    drag: np.ndarray
    spring: np.ndarray


class Gears(NamedTuple):
    """Between motor and link, L of them. half: rad, lost motion to each side. stiffness, damping: of closed flanks,
    N m/rad, N m s/rad. motor: kg m^2 that turn with the motor."""

    half: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    motor: np.ndarray


@kernel
def _of_link(inertia, motor):
    """Inertia behind the gear; where most of it turns with the motor, something is left."""
    return max(inertia - motor, 0.02 * inertia)


@kernel(nogil=True, error_model="numpy")  # as a division that may raise is none that runs for all gears at once
def _two_masses(acceleration, link, gears, step, substeps, angle, speed, change):
    """Link minus motor angle along a recorded motor motion, semi-implicit Euler, for L gears at once.

    acceleration: (N,) rad/s^2, of the motor. step: s between samples. Filled: angle, speed, change (N, L): rad, rad/s,
    rad/s^2 of the link relative to the motor, the last as a mean over the step; all zero where the simulation comes
    apart.
    """
    demand, whole, drag, spring = link
    half, stiffness, damping, motor = gears
    count, width = angle.shape
    e, v, total, light = np.empty(width), np.zeros(width), np.empty(width), np.empty(width)  # light: one over inertia
    lost = np.zeros(width, np.bool_)
    for i in range(width):
        need = _of_link(whole[0], motor[i]) * acceleration[0] + demand[0]
        e[i] = -need / stiffness[i] - (half[i] if need > 0.0 else -half[i])
    fine = step / substeps
    for k in range(count):
        following = min(k + 1, count - 1)
        spring_now, drag_now = spring[k], drag[k]
        for i in range(width):
            angle[k, i], speed[k, i], total[i] = e[i], v[i], 0.0
            light[i] = 1.0 / _of_link(whole[k], motor[i])
        for s in range(substeps):
            share = s / substeps
            a = acceleration[k] * (1.0 - share) + acceleration[following] * share
            h = demand[k] * (1.0 - share) + demand[following] * share
            for i in range(width):
                one = stiffness[i] * (-e[i] - half[i]) - damping[i] * v[i]  # of each flank, were it closed
                other = stiffness[i] * (-e[i] + half[i]) - damping[i] * v[i]
                contact = one if (half[i] == 0.0) | ((-e[i] > half[i]) & (one > 0.0)) else 0.0
                contact = other if (half[i] != 0.0) & (-e[i] < -half[i]) & (other < 0.0) else contact
                relative = (contact - h - spring_now * e[i] - drag_now * v[i]) * light[i] - a
                total[i] += relative
                v[i] += relative * fine
                e[i] += v[i] * fine
        for i in range(width):
            change[k, i] = total[i] / substeps
            lost[i] |= not abs(e[i]) < LOST
    for i in range(width):
        if lost[i]:
            for k in range(count):
                angle[k, i], speed[k, i], change[k, i] = 0.0, 0.0, 0.0


class Relative(NamedTuple):
    """The link relative to a recorded motor, behind L gears. angle, speed, change: (N, L) rad, rad/s, rad/s^2, zero
    where it came apart."""

    angle: np.ndarray
    speed: np.ndarray
    change: np.ndarray
    gears: Gears


def relative_motion(scene: Scene, joint: int, figures: Sequence[tuple[float, float, float, float]]) -> Relative:
    """Link behind the recorded motor of `joint`, for L `figures` as of `two_masses`."""
    spring, drag, whole = scene.slopes(joint)[:, joint].T.copy()
    if scene.mechanism.closed:
        all_of_them, most = inertias(scene.delta.model, scene.base.rigid)
        inertia = all_of_them[joint]
    else:  # a base model that found no inertia has no link that could swing
        inertia, most = max(float(np.mean(whole)), 0.0), 1.0
    gears = Gears(*train(inertia, most, *np.array(figures, float).T))
    acceleration = np.ascontiguousarray(scene.segment.theta_ddot[:, joint])
    demand = scene.load[:, joint] - whole * acceleration
    angle, speed, change = np.empty((3, len(demand), len(gears.half)))
    substeps = max(1, round(SUBSTEPS_PER_SECOND * scene.period))
    drag -= scene.base.viscous[joint]  # the gear's own friction stays with the motor
    link = Link(demand, whole, drag, spring)
    _two_masses(acceleration, link, gears, scene.period, substeps, angle, speed, change)
    return Relative(angle, speed, change, gears)


def two_masses(scene: Scene, joint: int, figures: Sequence[tuple[float, float, float, float]]) -> np.ndarray:
    """Torque (N, n, L) N m that a two-mass joint adds to the rigid one, for each of L `figures`.

    figures: half the lost motion, rad; natural frequency, Hz, of the link against a held motor; its damping ratio;
    share of the joint's mean inertia that sits on the motor. The link's torque is taken to first order in its relative
    motion where that stays below `SLIGHT`. Three take little longer than one.
    """
    motion = scene.segment
    angle, speed, change, gears = relative_motion(scene, joint, figures)
    torque = scene.perturbed(joint, angle, speed, change)
    torque[:, joint] -= scene.base.viscous[joint] * speed + gears.motor * change
    for i in np.flatnonzero(np.abs(angle).max(axis=0) >= SLIGHT):
        moved = [signal.copy() for signal in (motion.theta, motion.theta_dot, motion.theta_ddot)]
        for signal, relative in zip(moved, (angle, speed, change), strict=True):
            signal[:, joint] += relative[:, i]
        torque[..., i] = scene.moved(*moved)
        torque[:, joint, i] -= gears.motor[i] * change[:, i]
    return torque
