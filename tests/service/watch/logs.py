"""A robot whose description is right, moving as MuJoCo's inverse dynamics asks for, and what may come on."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from drivers.simulated.plant.effects import friction
from schemas.fitted import JointParameter, Parameter
from schemas.robot import Identified, Robot
from schemas.trace import Trace
from tests.service.injected import rubbing
from tests.service.world import BASE, COULOMB, ROBOT, TRANSITION, VISCOUS, Course, course

NOISE = 0.3  # N m a sample

KNOWN: Robot = ROBOT.model_copy(
    update={
        "identified": Identified(
            rho_1=Parameter(value=float(BASE.rigid[0])),
            rho_2=Parameter(value=1.0),
            viscous_friction_nms=JointParameter(value=VISCOUS.tolist()),
            coulomb_friction_nm=JointParameter(value=COULOMB.tolist()),
            forearm_inertia_kg=Parameter(value=float(BASE.rigid[2])),
            torque_noise_nm=JointParameter(value=[NOISE] * 3),
            friction_transition_radps=TRANSITION,
        )
    }
)


def rest_of(run: Course, start: float) -> Course:
    """A course from `start` s on."""
    rows = run.time >= start
    theta, theta_dot, theta_ddot = (signal[rows] for signal in run.motion)
    return Course(run.time[rows], (theta, theta_dot, theta_ddot), run.torque[rows])


@cache
def motion(seconds: float, fast: float = 8.0) -> Course:
    """Sines of 2 to `fast` rad/s."""
    return course(5, seconds, high=fast)


def log(run: Course, torque: np.ndarray, seed: int = 0) -> Trace:
    """A course as the bus carries it. torque: (N, 3) N m, without noise."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(torque.shape)
    return Trace(Path("bus"), run.time, run.motion[0], torque + noise, position_command=run.motion[0])


def stribeck(run: Course, start: float) -> np.ndarray:
    """Torque with breakaway friction on joint 2 from `start` s on."""
    effect = friction.StribeckFriction([0.0, 2.0, 0.0], 0.3)
    late = rest_of(run, start)
    return np.concatenate([run.torque[run.time < start], rubbing(effect, late, 0.0)])
