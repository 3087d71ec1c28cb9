"""Every effect of the catalogue put into the known robot by other code: the plant's own effects, held against the
exact motion one sample after another, MuJoCo's inverse dynamics where masses and lengths change, closed forms where a
drive lies. `INJECTED` says with which parameters the catalogue should answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from drivers.simulated.plant import effects as plant
from drivers.simulated.plant.effects import friction, mechanics, sensing
from drivers.simulated.plant.mujoco_delta import Design, build, close, dependence
from drivers.simulated.plant.plant import Friction
from tests.service.subject import EFFECTS, Term
from tests.service.world import (
    COULOMB,
    PERIOD,
    ROBOT,
    TRUTH,
    VISCOUS,
    Course,
    Motion,
    at_joints,
    course,
    direction,
    rigid_torque,
    sines,
    stub,
)

N = 2 * math.pi
RATIO = ROBOT.drive.gear_ratio


@dataclass(frozen=True)
class Injected:
    """joints from 0. amplitude: (max(J, 1), k). measured: what is reported along a course that starts at a time, s.

    close: rms difference to the catalogue's torque, of the effect's own rms, that the catalogue's approximations cost.
    """

    joints: tuple[int, ...]
    amplitude: list[list[float]]
    nonlinear: tuple[float, ...]
    measured: Callable[[Course, float], np.ndarray]
    close: float = 2e-3

    def term(self, name: str) -> Term:
        """As the catalogue says it."""
        return Term(EFFECTS[name], self.joints, np.array(self.amplitude), self.nonlinear)


def rubbing(effect: plant.PlantEffect, run: Course, start: float) -> np.ndarray:
    """Reported torque with a friction effect of the plant, taken through its hook sample by sample."""
    at = stub(step=PERIOD, time=0.0, motor=None, motor_dot=None, load=None)
    effect.start(at)
    theta, theta_dot, _ = run.motion
    sign = direction(theta_dot)
    load = run.torque - VISCOUS * theta_dot - COULOMB * sign
    # a Dahl contact is driven by travel: the way from sample to sample, which the plant reads as speed
    dahl = isinstance(effect, friction.PreslidingFriction)
    travel = np.diff(theta, axis=0, prepend=theta[:1]) / PERIOD if dahl else theta_dot
    result = load.copy()
    for k in range(len(theta)):
        at.time, at.motor, at.motor_dot, at.load = start + run.time[k], theta[k], travel[k], load[k]
        force = Friction(COULOMB.copy(), COULOMB.copy(), VISCOUS.copy(), np.zeros(3))
        effect.friction(at, force)
        dry = np.where(sign[k] > 0, force.forward, force.backward) * sign[k]
        result[k] += dry + force.viscous * theta_dot[k] - force.torque
    return result


def built(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """Reported torque with an effect that changes what is built."""
    theta, theta_dot, theta_ddot = run.motion
    changed = effect.shape(Design(TRUTH))
    offset = np.array(changed.truth.joint_offset_rad)
    return run.torque - plain(run) + rigid_torque(changed, (theta + offset, theta_dot, theta_ddot))


def plain(run: Course) -> np.ndarray:
    return rigid_torque(Design(TRUTH), run.motion)


@cache
def _platform(run_time: bytes, theta: bytes) -> np.ndarray:
    mechanism = build(Design(TRUTH), PERIOD)
    return close(mechanism, np.frombuffer(theta).reshape(-1, 3))[:, mechanism.platform]


def pushed(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """Reported torque with a force on the platform."""
    position = _platform(run.time.tobytes(), run.motion[0].tobytes())
    speed = np.gradient(position, PERIOD, axis=0, edge_order=2)
    force = [effect.platform_force(stub(platform=p, platform_dot=v)) for p, v in zip(position, speed, strict=True)]
    return run.torque + at_joints(run.motion, np.array(force))


def loaded(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """Reported torque with a torque on the links."""
    return run.torque - effect.joint_torque(stub(theta=run.motion[0]))


def driven(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """Reported torque where the motor makes another one of it: what has to be meant for the motion's torque to act."""
    meant, at = run.torque.copy(), stub(truth=TRUTH.model_copy(update={"gear_ratio": RATIO}), motor=run.motion[0])
    for _ in range(40):
        meant += run.torque - effect.motor_torque(at, meant)
    return meant


def misread(effect: plant.PlantEffect, run: Course, path: Callable[[np.ndarray], Motion]) -> np.ndarray:
    """Reported torque of the motion that the encoders take for `path`; its derivatives by differences."""
    at = stub(truth=TRUTH.model_copy(update={"gear_ratio": RATIO}), motor=None)

    def true(time: np.ndarray) -> np.ndarray:
        read = path(time)[0]
        at.motor = read
        for _ in range(30):
            at.motor = at.motor + read - effect.reading(at, at.motor)
        return at.motor

    h = 2e-4
    before, here, after = true(run.time - h), true(run.time), true(run.time + h)
    motion = here, (after - before) / (2 * h), (after - 2 * here + before) / h**2
    return rigid_torque(Design(TRUTH), motion) + VISCOUS * motion[1] + COULOMB * direction(run.motion[1])


def swinging(effect: friction.PassiveJointFriction, run: Course) -> np.ndarray:
    """Reported torque with friction in the ball joints: MuJoCo's bodies, virtual work over the loops."""
    theta, theta_dot, _ = run.motion
    mechanism = build(Design(TRUTH), PERIOD)
    position, slope = close(mechanism, theta), dependence(mechanism, theta)
    velocity = np.einsum("nki,ni->nk", slope, theta_dot)
    data = mujoco.MjData(mechanism.model)  # pyright: ignore[reportAttributeAccessIssue]
    at = stub(mechanism=mechanism, data=data)
    effect.start(at)
    result = run.torque.copy()
    for k in range(len(theta)):
        data.qpos[:], data.qvel[:] = position[k], velocity[k]
        mujoco.mj_fwdPosition(mechanism.model, data)  # pyright: ignore[reportAttributeAccessIssue]
        mujoco.mj_fwdVelocity(mechanism.model, data)  # pyright: ignore[reportAttributeAccessIssue]
        data.xfrc_applied[:] = 0.0
        effect.act_on_bodies(at)
        force = np.zeros(mechanism.model.nv)
        for body in np.flatnonzero(data.xfrc_applied.any(axis=1)):
            mujoco.mj_applyFT(  # pyright: ignore[reportAttributeAccessIssue]
                mechanism.model, data, np.zeros(3), data.xfrc_applied[body, 3:], data.xipos[body], int(body), force
            )
        result[k] -= slope[k].T @ force
    return result


def said(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """What the bus reports of the true torque, cycle by cycle."""
    effect.start(stub(load=run.torque[0], step=PERIOD))
    return np.array([effect.report(stub(step=PERIOD), torque) for torque in run.torque])


def drawn_out(effect: plant.PlantEffect, run: Course) -> np.ndarray:
    """The same where torque goes on between two cycles: the middle of every eighth of one, after which it is read."""
    fine, last = 8, len(run.time) - 1
    at = (np.arange(last * fine) + 0.5) / fine
    between = np.stack([np.interp(at, np.arange(last + 1), column) for column in run.torque.T], axis=1)
    effect.start(stub(load=run.torque[0]))
    said = [effect.report(stub(step=PERIOD / fine), torque) for torque in between]
    return np.array([run.torque[0], *said[fine - 1 :: fine]])


def asked(hertz: float, run: Course) -> np.ndarray:
    """What a drive of first order has to be asked for so that the true torque comes of it."""
    return run.torque + np.gradient(run.torque, PERIOD, axis=0) / (2 * math.pi * hertz)


def rub(effect: Callable[[], plant.PlantEffect]) -> Callable[[Course, float], np.ndarray]:
    return lambda run, start: rubbing(effect(), run, start)


DELAY = 0.00237
ORDER, PHASE = 3.0, 0.8
WAVE = [math.sin(PHASE), math.cos(PHASE)]  # cosine and sine part of sin(x + PHASE)
OFF = 1.2e-4  # rad of the encoder, joint side
HOSE = [0.25, -0.12, -0.35]

INJECTED: dict[str, Injected] = {
    "stribeck_friction": Injected(
        (0, 1, 2), [[2.0], [1.6], [2.4]], (0.25,), rub(lambda: friction.StribeckFriction([2.0, 1.6, 2.4], 0.25))
    ),
    "asymmetric_friction": Injected(
        (1,), [[0.7, 0.15]], (), rub(lambda: friction.AsymmetricFriction([0.0, 1.4, 0.0], [0.0, 0.3, 0.0])), 0.03
    ),
    "load_dependent_friction": Injected(
        (0, 1, 2), [[0.06], [0.05], [0.08]], (0.0,), rub(lambda: friction.LoadDependentFriction([0.06, 0.05, 0.08]))
    ),
    "nonlinear_viscous_friction": Injected(
        (0, 1, 2),
        [[0.12], [0.15], [0.1]],
        (2.0,),
        rub(lambda: friction.NonlinearViscousFriction([0.12, 0.15, 0.1])),
    ),
    "position_dependent_friction": Injected(
        (2,),
        [[1.5 * part for part in WAVE]],
        (ORDER,),
        rub(lambda: friction.PositionDependentFriction([0.0, 0.0, 1.5], ORDER, PHASE)),
    ),
    "warmup_friction": Injected(
        (0, 1, 2),
        (VISCOUS[:, None] * [0.8]).tolist(),
        (12.0,),
        rub(lambda: friction.WarmupFriction([0.8] * 3, 12.0)),
    ),
    "presliding_friction": Injected(
        (0, 1, 2),
        COULOMB[:, None].tolist(),
        (0.02,),
        rub(lambda: friction.PreslidingFriction((COULOMB / 0.02).tolist())),
        0.01,
    ),
    "passive_joint_friction": Injected(
        (),
        [[0.4, 0.4, 0.06, 0.06]],
        (),
        lambda run, _: swinging(friction.PassiveJointFriction(0.2, 0.03), run),
        0.03,
    ),
    "shaft_friction": Injected((), [[5.0, 3.0]], (), lambda run, _: pushed(friction.ShaftFriction(5.0, 3.0), run)),
    "rotor_inertia": Injected((1,), [[0.03]], (), lambda run, _: built(mechanics.RotorInertia([0.0, 0.03, 0.0]), run)),
    "arm_mass": Injected((2,), [[0.4]], (), lambda run, _: built(mechanics.ArmMass([0.0, 0.0, 0.4]), run)),
    "tool_mass": Injected((), [[0.3]], (), lambda run, _: built(mechanics.ToolMass(0.3), run)),
    "base_tilt": Injected((), [[0.03, -0.04]], (), lambda run, _: built(mechanics.BaseTilt(0.03, -0.04), run), 0.03),
    "joint_spring": Injected(
        (0,), [[3.0, -0.9]], (), lambda run, _: loaded(mechanics.JointSpring([3.0, 0.0, 0.0], [0.3, 0.0, 0.0]), run)
    ),
    "hose_spring": Injected(
        (), [[20.0, *(-20.0 * x for x in HOSE)]], (), lambda run, _: pushed(mechanics.HoseSpring(20.0, HOSE), run)
    ),
    "air_drag": Injected((), [[1.1]], (), lambda run, _: pushed(mechanics.AirDrag(1.1), run)),
    "link_length_error": Injected(
        (2,), [[0.008]], (), lambda run, _: built(mechanics.LinkLengthError([0.0, 0.0, 0.008]), run)
    ),
    "forearm_length_error": Injected(
        (0,), [[-0.006]], (), lambda run, _: built(mechanics.ForearmLengthError([-0.006, 0.0, 0.0]), run)
    ),
    "base_radius_error": Injected(
        (1,), [[0.012]], (), lambda run, _: built(mechanics.BaseRadiusError([0.0, 0.012, 0.0]), run)
    ),
    "azimuth_error": Injected((2,), [[0.03]], (), lambda run, _: built(mechanics.AzimuthError([0.0, 0.0, 0.03]), run)),
    "joint_offset": Injected((0,), [[-0.03]], (), lambda run, _: built(mechanics.JointOffset([-0.03, 0.0, 0.0]), run)),
    "angle_scale": Injected(
        (1,), [[0.02]], (), lambda run, _: misread(sensing.AngleScale([0.0, 0.02, 0.0]), run, path_of(run)), 0.03
    ),
    "torque_scale": Injected((0,), [[0.05]], (), lambda run, _: driven(sensing.TorqueScale([0.05, 0.0, 0.0]), run)),
    "torque_offset": Injected((1,), [[0.9]], (), lambda run, _: driven(sensing.TorqueOffset([0.0, 0.9, 0.0]), run)),
    "torque_delay": Injected((), [[]], (DELAY,), lambda run, _: said(sensing.TorqueDelay(DELAY), run), 0.01),
    "torque_filter": Injected((), [[]], (35.0,), lambda run, _: drawn_out(sensing.TorqueFilter(35.0), run)),
    "drive_lag": Injected((), [[]], (35.0,), lambda run, _: asked(35.0, run), 0.005),
    "cogging": Injected(
        (1,),
        [[-1.1 * part for part in WAVE]],
        (2.0,),
        lambda run, _: driven(sensing.Cogging([0.0, 1.1, 0.0], 2.0, PHASE), run),
    ),
    "encoder_eccentricity": Injected(
        (0,),
        [[-OFF * part for part in WAVE]],
        (2.0,),
        lambda run, _: misread(sensing.EncoderEccentricity([OFF, 0.0, 0.0], 2.0, PHASE), run, path_of(run)),
        0.03,
    ),
}
BY_TWO_MASSES = ("joint_elasticity", "backlash")  # `test_two_masses.py`


def path_of(run: Course) -> Callable[[np.ndarray], Motion]:
    """The motion of one of the courses of the first seeds, at any time."""
    return next(sines(seed) for seed in range(20) if np.array_equal(sines(seed)(run.time[:1])[0], run.motion[0][:1]))


@cache
def reports(name: str, seed: int, seconds: float, start: float = 0.0) -> np.ndarray:
    """(N, 3) N m reported along `course(seed, seconds)` with an effect at work, without noise."""
    return INJECTED[name].measured(course(seed, seconds), start)
