"""Two masses a joint: the motor, whose angle is measured, and the link behind a compliant or loose gear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.model.scene import Scene

SUBSTEPS_PER_SECOND = 8_000.0
LOST = 0.5  # rad of relative motion at which a two-mass simulation has come apart
SLIGHT = 0.01  # rad of relative motion up to which its square is below a thousandth of the torque


class Link(NamedTuple):
    """What the link takes, (N,) each. demand: N m without its own acceleration. inertia, drag, spring: N m per rad/s^2,
    rad/s, rad of its motion relative to the motor."""

    demand: np.ndarray
    inertia: np.ndarray
    drag: np.ndarray
    spring: np.ndarray


class Gear(NamedTuple):
    """Between motor and link. half: rad, lost motion to each side. stiffness, damping: of closed flanks, N m/rad,
    N m s/rad."""

    half: float
    stiffness: float
    damping: float


@kernel(nogil=True)
def _two_masses(acceleration, link, gear, step, substeps, angle, speed, change):
    """Link minus motor angle along a recorded motor motion, semi-implicit Euler.

    acceleration: (N,) rad/s^2, of the motor. step: s between samples. Filled: angle, speed, change (N,): rad, rad/s,
    rad/s^2 of the link relative to the motor, the last as a mean over the step; all zero where the simulation comes
    apart.
    """
    demand, inertia, drag, spring = link
    half, stiffness, damping = gear
    need = inertia[0] * acceleration[0] + demand[0]
    e = -need / stiffness - (half if need > 0.0 else -half)
    v = 0.0
    fine = step / substeps
    count = len(acceleration)
    for k in range(count):
        following = min(k + 1, count - 1)
        angle[k], speed[k] = e, v
        mean = 0.0
        for s in range(substeps):
            share = s / substeps
            a = acceleration[k] * (1.0 - share) + acceleration[following] * share
            h = demand[k] * (1.0 - share) + demand[following] * share
            contact = 0.0
            if -e > half:
                contact = max(0.0, stiffness * (-e - half) - damping * v)
            elif -e < -half:
                contact = min(0.0, stiffness * (-e + half) - damping * v)
            if half == 0.0:
                contact = -stiffness * e - damping * v
            relative = (contact - h - spring[k] * e - drag[k] * v) / inertia[k] - a
            mean += relative / substeps
            v += relative * fine
            e += v * fine
        change[k] = mean
        if not abs(e) < LOST:
            angle[:], speed[:], change[:] = 0.0, 0.0, 0.0
            return


class Relative(NamedTuple):
    """The link relative to a recorded motor. angle, speed, change: (N,) rad, rad/s, rad/s^2, zero where it came apart.
    motor: kg m^2 that turn with the motor."""

    angle: np.ndarray
    speed: np.ndarray
    change: np.ndarray
    motor: float
    gear: Gear


def relative_motion(
    scene: Scene, joint: int, half: float, natural_hz: float, damping_ratio: float, motor_share: float
) -> Relative:
    """Link behind the recorded motor of `joint`; arguments as of `two_masses`."""
    whole = scene.inertia[:, joint, joint]
    motor = motor_share * float(np.mean(whole))
    inertia = np.maximum(whole - motor, 0.02 * whole)
    mean = float(np.mean(inertia))
    if mean <= 0.0:  # a base model that found no inertia has no link that could swing
        still = np.zeros(len(whole))
        return Relative(still, still, still, motor, Gear(half, 0.0, 0.0))
    stiffness = mean * (2 * np.pi * natural_hz) ** 2
    gear = Gear(half, stiffness, float(2 * damping_ratio * np.sqrt(stiffness * mean)))
    acceleration = np.ascontiguousarray(scene.segment.theta_ddot[:, joint])
    demand = scene.load[:, joint] - whole * acceleration
    angle, speed, change = np.empty_like(demand), np.empty_like(demand), np.empty_like(demand)
    substeps = max(1, round(SUBSTEPS_PER_SECOND * scene.period))
    drag = scene.damping[:, joint, joint] - scene.base.viscous[joint]  # the gear's own friction stays with the motor
    link = Link(demand, inertia, drag, np.ascontiguousarray(scene.stiffness[:, joint, joint]))
    _two_masses(acceleration, link, gear, scene.period, substeps, angle, speed, change)
    return Relative(angle, speed, change, motor, gear)


def two_masses(
    scene: Scene, joint: int, half: float, natural_hz: float, damping_ratio: float, motor_share: float
) -> np.ndarray:
    """Torque (N, n) N m that a two-mass joint adds to the rigid one.

    motor_share: of the joint's mean inertia that sits on the motor. natural_hz: of the link against a held motor.
    The link's torque is taken to first order in its relative motion where that stays below `SLIGHT`.
    """
    motion = scene.segment
    angle, speed, change, motor, *_ = relative_motion(scene, joint, half, natural_hz, damping_ratio, motor_share)
    if not angle.any():
        return np.zeros(scene.load.shape)
    if np.max(np.abs(angle)) < SLIGHT:
        torque = scene.perturbed(joint, angle, speed, change)
        torque[:, joint] -= scene.base.viscous[joint] * speed + motor * change
        return torque
    moved = [signal.copy() for signal in (motion.theta, motion.theta_dot, motion.theta_ddot)]
    for signal, relative in zip(moved, (angle, speed, change), strict=True):
        signal[:, joint] += relative
    torque = scene.mechanism.rigid(*moved).torque(scene.base.rigid) - scene.load
    torque[:, joint] -= motor * change
    return torque
