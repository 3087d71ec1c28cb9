r"""Friction builds up over a small displacement: hysteresis at reversal.

Physics: bristles bend before they slip. By Dahl's model, $$\frac{\mathrm{d}F}{\mathrm{d}\theta} = \frac{f_c}{s} \left(1
- \frac{F}{f_c} \operatorname{sign}\dot\theta\right)$$ with the Coulomb friction $f_c$ and the displacement $s$ over
which it builds up.
Implementation: the state of Dahl's model is integrated along the recorded motion. Its difference from the sign of the
speed is the regressor, so that an amplitude equal to $f_c$ replaces all Coulomb friction. The displacement is shared by
the joints.
Limitations: below the resolution of the encoder it is a jump; no velocity-dependent damping of the bristles. Friction
that builds up over more than 0.2 rad is not a contact: a creeping cable looks like that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.kernels import kernel
from service.model.effects.base import Amplitude, Effect, Inside, Nonlinear, geometric
from service.model.scene import Scene


@kernel
def slide_kernel(z, travel, distance):
    """Relative bristle deflection in [-1, 1] after `travel` rad: dz / dtheta = (1 - z sign v) / distance, exactly."""
    sign = 1.0 if travel > 0.0 else -1.0
    return sign + (z - sign) * math.exp(-abs(travel) / distance)


_STARTED, _ANGLE, _DEFLECTION, _UNKNOWN = range(4)  # of the memory; the last: share that the start still has in it


@kernel
def _online(effect, now, i, memory):
    angle, distance, level = now.theta[i], effect.nonlinear[0], effect.amplitude[i, 0]
    if memory[_STARTED] == 0.0:  # where the bristles stand at the start nobody has seen
        memory[_STARTED], memory[_ANGLE], memory[_UNKNOWN] = 1.0, angle, 1.0
    travel = angle - memory[_ANGLE]
    memory[_ANGLE] = angle
    memory[_DEFLECTION] = slide_kernel(memory[_DEFLECTION], travel, distance)
    memory[_UNKNOWN] *= math.exp(-abs(travel) / distance)
    now.doubt[i] += (level * memory[_UNKNOWN]) ** 2
    return level * (memory[_DEFLECTION] - now.direction[i])


@kernel(nogil=True)
def _dahl(theta, distance, state):
    """Fill state (N,) along theta (N,) rad."""
    z = 0.0  # where the bristles stand at the start is not in the log
    for k in range(len(theta)):
        z = slide_kernel(z, theta[k] - theta[k - 1] if k > 0 else 0.0, distance)
        state[k] = z


def deflection(theta: np.ndarray, distance: float) -> np.ndarray:
    """(N,) relative deflection in [-1, 1] of bristles along angles (N,) rad, from 0."""
    state = np.empty(len(theta))
    _dahl(theta, distance, state)
    return state


@dataclass(frozen=True)
class PreslidingFriction(Effect):
    f: Amplitude = Amplitude("N m", "part of the Coulomb friction that builds up over the distance", low=0.0)
    distance: Nonlinear = Nonlinear("rad", "displacement of the build-up", geometric(3e-4, 0.1, 8), 2e-4, 0.2)
    name = "presliding_friction"
    title = "Friction builds up over a small distance"
    means = (
        "Bearings, seals and grease deform before they slip. This is normal for a gear: include it in the model if "
        "small reversals matter."
    )
    directional = True
    online = staticmethod(_online)
    memory = 4
    own_nonlinear = True
    settles = "small reversals (0.001 to 0.05 rad) about several angles"

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (deflection(scene.segment.theta[:, joint], nonlinear[0]) - scene.direction[:, joint])[:, None]

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """Bristles."""
        inside.bristle[joint] += amplitude[0]
        inside.distance[joint] = nonlinear[0]
