"""A log of a simulated machine: drives follow a motion, the description is what it really is.

Each drive adds a rigid feed-forward to position and speed feedback, as a tuned servo does. Friction acts in the
simulation itself; effects of the description add what they do to the torque along the simulated motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.errors import DataError
from service.machines.forward_runs import run
from service.machines.joint_motions import JointMotion
from service.machines.machine import MachineModel
from service.model.description import base_of, torque_along
from service.model.signals import smooth

BANDWIDTH_HZ, DAMPING = 12.0, 0.8  # of the drives' position loop, on the inertia that each joint has in the middle
NOISE = 0.005  # of each joint's largest torque, white, a sample
RESOLUTION = 2 * np.pi / 2**20  # rad, or m over a lead of 2 pi: of the encoders


@dataclass(frozen=True)
class SimulatedLog:
    """(N,) s; positions as encoders give them, commands and torque, (N, n)."""

    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    torque: np.ndarray


def simulate(machine: MachineModel, motion: JointMotion, rng: np.random.Generator) -> SimulatedLog:
    """Run a motion.

    Raises:
        DataError: axes that were never identified; drives that lose the motion. RobotError: an effect that is not
            known.
    """
    robot = machine.description
    if not robot.predicts:
        raise DataError(f"{robot.name}: no [identified] parameters to simulate: run `deltatwin identify`")
    base, mechanism = base_of(robot), machine.mechanism
    forward = mechanism.rigid(motion.theta, motion.theta_dot, motion.theta_ddot).torque(base.rigid)
    middle = motion.theta.mean(axis=0)[None]
    inertia = np.diagonal(machine.dynamics(base)(middle, np.zeros_like(middle))[0][0])
    rate = 2 * np.pi * BANDWIDTH_HZ
    stiff, damped = rate**2 * inertia, 2 * DAMPING * rate * inertia
    pushed = np.empty_like(motion.theta)

    def drive(k: int, share: float, _: np.ndarray, theta: np.ndarray, theta_dot: np.ndarray) -> np.ndarray:
        plan = (motion.theta, motion.theta_dot, forward)
        angle, speed, torque = (values[k] + share * (values[k + 1] - values[k]) for values in plan)
        torque = torque + stiff * (angle - theta) + damped * (speed - theta_dot)
        pushed[k] = torque
        return torque

    angles, _ = run(machine, base, (motion.theta[:1], motion.theta_dot[:1]), drive, len(motion.theta), motion.period)
    if not np.isfinite(angles).all():
        raise DataError(
            f"{robot.name}: the simulated drives lose the motion: its parameters are not those of a real machine"
        )
    pushed[-1] = pushed[-2]
    torque = (pushed + np.vstack([pushed[:1], pushed[:-1]])) / 2  # at the samples, not between them
    if robot.effect:
        moved = smooth(angles[0], motion.period)
        bare = robot.model_copy(update={"effect": []})
        torque = torque + torque_along(robot, motion.time, *moved) - torque_along(bare, motion.time, *moved)
    torque = torque + NOISE * np.abs(torque).max(axis=0) * rng.standard_normal(torque.shape)
    return SimulatedLog(motion.time, np.round(angles[0] / RESOLUTION) * RESOLUTION, motion.theta, torque)
