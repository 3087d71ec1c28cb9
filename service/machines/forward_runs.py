"""The forward motion of a machine under joint torque: many runs at once, friction by a linearly implicit step.

A step of h s solves (M + h D) a = tau - bias - friction, D being the slope of friction with speed, at the place that
the run would be at half a step on. So Coulomb friction that turns over a small speed needs no smaller step.

Source: Hairer, Wanner, Solving Ordinary Differential Equations II, 1996, IV.7 (linearly implicit methods).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from service.machines.machine import MachineModel
from service.model.scene import Base

LONGEST_STEP = 1e-3  # s
SHARPEST = 1e-4  # rad/s or m/s over which friction turns at least
FARTHEST, FASTEST = 50.0, 500.0  # rad or m from its start, rad/s or m/s, at which a run has run away
NO_INERTIA = 1e-9  # kg m^2 or kg: a description may have a joint with none, which runs away

# k, share s, runs (L,), theta (L, n), theta_dot (L, n): torque (L, n) at share s between samples k and k + 1
Drive = Callable[[int, float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def run(
    machine: MachineModel,
    base: Base,
    start: tuple[np.ndarray, np.ndarray],
    drive: Drive,
    samples: int,
    period: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and speeds (W, S, n) of W runs from `start`, (W, n) each; NaN once a run is lost.

    drive: torque at the joints, without friction. samples: S, `period` s apart.
    """
    dynamics, rows = machine.dynamics(base), machine.mechanism.rows
    width = np.maximum(np.broadcast_to(base.transition, base.coulomb.shape), SHARPEST)
    steps = math.ceil(period / LONGEST_STEP - 1e-9)
    h = period / steps
    massless = NO_INERTIA * np.eye(machine.mechanism.joints)
    theta, theta_dot = (np.array(part, float) for part in start)
    first = theta.copy()
    change = np.zeros_like(theta)
    angles, speeds = (np.full((len(theta), samples, theta.shape[1]), np.nan) for _ in range(2))
    live = np.arange(len(theta))
    for k in range(samples):
        angles[live, k], speeds[live, k] = theta[live], theta_dot[live]
        for part in range(steps if k + 1 < samples else 0):
            if not len(live):
                break
            q, v = theta[live], theta_dot[live]
            middle = q + 0.5 * h * v, v + 0.5 * h * change[live]
            mass, bias = dynamics(*middle)
            sliding = v @ rows.T
            turned = np.tanh(sliding / width)
            friction = base.viscous * sliding + base.coulomb * turned
            # half a step of what is linear is exact to second order; what turns over within a step needs all of it
            slope = 0.5 * base.viscous + base.coulomb * (1.0 - turned**2) / width
            torque = drive(k, (part + 0.5) / steps, live, *middle) - bias - friction @ rows
            implicit = mass + massless + h * np.einsum("fi,wf,fj->wij", rows, slope, rows)
            a = np.linalg.solve(implicit, torque[..., None])[..., 0]
            theta[live], theta_dot[live], change[live] = q + h * v + 0.5 * h**2 * a, v + h * a, a
            near = np.abs(theta[live] - first[live]) < FARTHEST
            live = live[(near & (np.abs(theta_dot[live]) < FASTEST)).all(axis=1)]
    return angles, speeds
