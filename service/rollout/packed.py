"""A description as the forward kernel wants it, and a recorded stretch as that robot sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from schemas.robot import Robot
from service.estimator.named_effects import carried, corrected, has_encoders, pack_effects, true_angles
from service.model.description import base_of, terms_of
from service.model.effects.base import Effect
from service.model.effects.presliding_friction import deflection
from service.model.elastic import elastic_motion, gears_of
from service.model.hypothesis import Term, inside_of
from service.model.mechanism import Delta
from service.model.nominal import DeltaModel, lengthened, pack, record_of
from service.model.signals import Segment, delayed, smooth
from service.rollout.kernel import FORWARD, SHARPEST


def simulated(effect: Effect) -> bool:
    """Whether the simulation has the effect."""
    kind = type(effect)
    return carried(effect) or kind.put_inside is not Effect.put_inside or kind.restore is not Effect.restore


def left_out(robot: Robot) -> list[str]:
    """Effects of a description that have no form forward in time."""
    return [term.effect.name for term in terms_of(robot) if not simulated(term.effect)]


@dataclass(frozen=True)
class SeenStretch:
    """N samples between two faults, as one description understands them.

    model: its geometry. forward: (1,) FORWARD record. start: (N, 5, 3) state at each sample - link, link speed, motor,
    motor speed, bristles. motion: (N, 3) rad, smoothed, what the encoders give. torque: (N, 3) N m at the joints, what
    the measurement does to it undone. encoders: effects that make true angles of measured ones; None: there is none.
    """

    model: DeltaModel
    forward: np.ndarray
    start: np.ndarray
    motion: np.ndarray
    torque: np.ndarray
    encoders: np.ndarray | None
    gear_ratio: float

    def measured(self, angle: np.ndarray) -> np.ndarray:
        """What the encoders give at true angles (..., 3) of the motors, rad."""
        result = angle
        if self.encoders is not None:
            for _ in range(4):  # the error is some thousandths of the angle: a few rounds are exact
                result = angle - (true_angles(self.encoders, self.gear_ratio, result) - result)
        return result


def stretch(robot: Robot, segment: Segment, position: np.ndarray) -> SeenStretch:
    """`segment` with raw `position` (N, 3) rad as `robot` sees it.

    Raises:
        RobotError: an effect that is not known, or not described in full. PoseError: a pose out of reach.
    """
    terms, base = terms_of(robot), base_of(robot)
    changed, ratio, _ = corrected(robot)
    inside = inside_of(terms)
    measured, encoders = segment.theta, None
    if has_encoders(terms):
        encoders = pack_effects([term for term in terms if term.effect.encoder is not None])
        angles = true_angles(encoders, robot.drive.gear_ratio, position)
        theta, theta_dot, theta_ddot = smooth(angles, segment.period)
        segment = replace(segment, theta=theta, theta_dot=theta_dot, theta_ddot=theta_ddot)
    torque = true_torque(terms, base.timing, segment.torque, segment.period)
    mechanism = Delta.of(changed)
    start = np.stack([segment.theta, segment.theta_dot, segment.theta, segment.theta_dot, np.zeros_like(torque)], 1)
    gears = gears_of(mechanism.model, base.rigid, inside.two_masses)
    if inside.two_masses:
        link = elastic_motion(
            mechanism.model, base.rigid, gears, (segment.theta, segment.theta_dot, segment.theta_ddot), segment.period
        )
        start[:, 0] += link.twist
        start[:, 1] += link.rate
    for joint in np.flatnonzero(inside.bristle):
        start[:, 4, joint] = deflection(segment.theta[:, joint], inside.distance[joint])
    forward, model = np.zeros(1, FORWARD), pack(changed)
    forward["model"] = record_of(model)
    forward["rho_1"], forward["rho_2"] = lengthened(base.rigid[0], base.rigid[1], ratio)
    forward["forearm"] = base.rigid[2]
    forward["viscous"], forward["coulomb"] = base.viscous, base.coulomb
    forward["transition"] = max(float(np.max(base.transition)), SHARPEST)
    forward["gear_ratio"] = robot.drive.gear_ratio
    # bristles are a state of the run itself
    acting = [term for term in terms if not term.effect.memory]
    at_joints = [term for term in acting if term.effect.own_joint]
    at_platform = [term for term in acting if not term.effect.own_joint]
    forward["at_joints"], forward["at_platform"] = pack_effects(at_joints), pack_effects(at_platform)
    forward["rotor"], forward["tool"] = inside.rotor, inside.tool
    forward["rotor"] += inside.arm * model.active_length**2 / 3
    forward["bristle"], forward["distance"] = inside.bristle, inside.distance
    for name in ("motor", "stiffness", "damping", "half"):
        forward[name] = gears[name]
    return SeenStretch(model, forward, start, measured, torque, encoders, robot.drive.gear_ratio)


def true_torque(terms: tuple[Term, ...], timing: float, torque: np.ndarray, period: float) -> np.ndarray:
    """Joint torque (N, 3) N m of a reported one. timing: s by which the torque is older than the position."""
    torque = delayed(torque, -timing, period)
    for term in reversed(terms):
        if term.effect.measured:
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                torque = term.effect.restore(torque, period, place, amplitude, term.nonlinear)
    return torque
