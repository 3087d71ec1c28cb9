"""Friction in the joints beyond Coulomb and viscous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from service.diagnosis.effects.base import Amplitude, Effect, Shape
from service.diagnosis.scene import Scene


def _geometric(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(value) for value in np.geomspace(low, high, count))


@dataclass(frozen=True)
class StribeckFriction(Effect):
    """Extra breakaway friction that dies out with speed.

    Physics: at low speed the lubricant film does not carry; T = f_s exp(-(v / v_s)^2) sign v (Stribeck; Armstrong).
    Implementation: one regressor a joint, v_s shared by the joints and refined with all other parameters.
    Limitations: with no motion slower than v_s it is Coulomb friction; with none faster, a lower viscous friction.
    """

    f_s: Amplitude = Amplitude("N m", "breakaway friction above the Coulomb level")
    v_s: Shape = Shape("rad/s", "speed at which it has fallen to 37 %", _geometric(0.01, 1.0, 9), 0.005, 2.0)
    name = "stribeck_friction"
    own_shapes = True
    settles = "a slow sweep with reversals, 0.005 to 1 rad/s"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        speed = scene.segment.theta_dot[:, joint]
        return (scene.direction[:, joint] * np.exp(-((speed / shape[0]) ** 2)))[:, None]


@dataclass(frozen=True)
class AsymmetricFriction(Effect):
    """Coulomb and viscous levels differ between the two directions.

    Physics: one flank of a gear, one side of a screw rubs more; T = delta_c + delta_v |v| beside the symmetric part.
    Implementation: two regressors a joint; the friction forward is f + delta, backward f - delta.
    Limitations: delta_c alone is a constant torque offset, and no motion tells the two apart.
    """

    delta_c: Amplitude = Amplitude("N m", "half the difference of the Coulomb levels, forward minus backward")
    delta_v: Amplitude = Amplitude("N m s/rad", "half the difference of the viscous levels, forward minus backward")
    name = "asymmetric_friction"
    settles = "the same path at three speeds in both directions"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        speed = np.abs(scene.segment.theta_dot[:, joint])
        return np.stack([np.ones_like(speed), speed], axis=1)


@dataclass(frozen=True)
class LoadDependentFriction(Effect):
    """Gear friction that grows with the torque through it.

    Physics: tooth friction is proportional to the tooth force; T = mu |load| sign v.
    Implementation: load is the rigid-body torque of the base model at the operating point.
    Limitations: at a nearly constant load (gravity only) it is Coulomb friction.
    """

    mu: Amplitude = Amplitude("", "friction torque per torque through the gear")
    name = "load_dependent_friction"
    settles = "fast and slow runs of one path, or the same path with a payload"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (np.abs(scene.load[:, joint]) * scene.direction[:, joint])[:, None]


@dataclass(frozen=True)
class NonlinearViscousFriction(Effect):
    """Viscous friction that is not linear in speed.

    Physics: shear thinning, churning and turbulence; T = f |v|^p sign v beside the linear part.
    Implementation: p shared by the joints and refined; p = 1 is the base model and left out.
    Limitations: a small range of speeds leaves p open.
    """

    f: Amplitude = Amplitude("N m (s/rad)^p", "coefficient")
    p: Shape = Shape("", "exponent of speed", (0.35, 0.6, 1.5, 2.0, 3.0), 0.2, 4.0)
    name = "nonlinear_viscous_friction"
    own_shapes = True
    settles = "runs of one path at 10, 30, 60 and 100 % speed"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (scene.direction[:, joint] * np.abs(scene.segment.theta_dot[:, joint]) ** shape[0])[:, None]


@dataclass(frozen=True)
class PositionDependentFriction(Effect):
    """The Coulomb level varies with the joint angle.

    Physics: a bent shaft or a worn tooth: T = (a cos n theta + b sin n theta) sign v.
    Implementation: order n per joint angle, amplitude and phase as the two coefficients a and b.
    Limitations: one sine; a narrow rough spot is not one.
    """

    cosine: Amplitude = Amplitude("N m", "cosine part of the amplitude")
    sine: Amplitude = Amplitude("N m", "sine part of the amplitude")
    order: Shape = Shape("", "periods a turn of the joint", (1, 2, 3, 4, 5, 6, 8, 10, 12), 0.5, 40.0)
    name = "position_dependent_friction"
    settles = "a slow sweep over the whole angle in both directions"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 2)."""
        angle, sign = shape[0] * scene.segment.theta[:, joint], scene.direction[:, joint]
        return np.stack([np.cos(angle) * sign, np.sin(angle) * sign], axis=1)


@dataclass(frozen=True)
class WarmupFriction(Effect):
    """Viscous friction falls as the gear warms.

    Physics: oil thins with temperature; T = f exp(-t / tau) v beside the level of the warm gear.
    Implementation: t is the clock of the log, taken as time since power-on; tau shared by the joints.
    Limitations: logs that all start warm, or on clocks of their own, do not show it.
    """

    f: Amplitude = Amplitude("N m s/rad", "viscous friction of the cold gear above the warm one")
    tau: Shape = Shape("s", "time constant of the warm-up", (3.0, 8.0, 20.0, 50.0, 150.0, 600.0), 1.0, 3600.0)
    name = "warmup_friction"
    settles = "one path, cold and after half an hour of running, on one clock"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        return (np.exp(-scene.time / shape[0]) * scene.segment.theta_dot[:, joint])[:, None]


@njit(cache=True, nogil=True)
def _dahl(theta, distance, state):
    """Relative bristle deflection z in [-1, 1]: dz / dtheta = (1 - z sign v) / distance, exact along each step."""
    z = 0.0  # where the bristles stand at the start is not in the log
    for k in range(len(theta)):
        step = theta[k] - theta[k - 1] if k > 0 else 0.0
        sign = 1.0 if step > 0.0 else -1.0
        z = sign + (z - sign) * np.exp(-abs(step) / distance)
        state[k] = z


@dataclass(frozen=True)
class PreslidingFriction(Effect):
    """Friction builds up over a small displacement: hysteresis at reversal.

    Physics: bristles bend before they slip; Dahl: dF/dtheta = sigma_0 (1 - F sign v / f_c), sigma_0 = f_c / distance.
    Implementation: the Dahl state is integrated along the recorded motion; its difference from sign v is the
    regressor, so an amplitude equal to f_c replaces all Coulomb friction. distance shared by the joints.
    Limitations: within the resolution of the encoder it is a jump; no velocity-dependent damping of the bristles.
    """

    f: Amplitude = Amplitude("N m", "part of the Coulomb friction that builds up over the distance")
    distance: Shape = Shape("rad", "displacement of the build-up", _geometric(3e-4, 0.1, 8), 2e-4, 0.3)
    name = "presliding_friction"
    own_shapes = True
    settles = "small reversals (0.001 to 0.05 rad) about several angles"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 1)."""
        motion = scene.segment
        state = np.empty(len(scene.time))
        _dahl(motion.theta[:, joint], shape[0], state)
        return (state - scene.direction[:, joint])[:, None]


@dataclass(frozen=True)
class PassiveJointFriction(Effect):
    """Friction in the forearms' ball joints.

    Physics: each forearm turns against the active link at its elbow and against the platform; dry friction loses
    T |omega|, viscous friction d omega^2.
    Implementation: omega of a forearm is s x s_dot / l2^2 (no spin about itself); joint torques by virtual power, both
    ends of all forearms with the same coefficients, per ball joint pair.
    Limitations: friction about the rod's own axis and unequal joints are left out.
    """

    dry_elbow: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the elbow")
    dry_platform: Amplitude = Amplitude("N m", "dry friction of one forearm's ball joints at the platform")
    viscous_elbow: Amplitude = Amplitude("N m s/rad", "viscous friction of one forearm's ball joints at the elbow")
    viscous_platform: Amplitude = Amplitude("N m s/rad", "viscous friction at the platform")
    name = "passive_joint_friction"
    per_joint = False
    own_joint = False
    kinds = frozenset({"delta"})
    settles = "long moves of the platform at several speeds, where a forearm swings while its own joint rests"

    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 4)."""
        arms, theta_dot = scene.arms, scene.segment.theta_dot
        length2 = scene.delta.model.passive_length**2
        swing_per_joint = np.repeat(arms.jacobian[:, None], 3, axis=1)  # (N, arm, axis, joint)
        for arm in range(3):
            swing_per_joint[:, arm, :, arm] -= arms.slope[:, arm]
        turn = np.cross(arms.forearm, arms.swing) / length2
        turn_per_joint = np.cross(arms.forearm[..., None], swing_per_joint, axisa=2, axisb=2, axisc=2) / length2
        bend = turn - arms.axle * theta_dot[..., None]
        bend_per_joint = turn_per_joint.copy()
        for arm in range(3):
            bend_per_joint[:, arm, :, arm] -= arms.axle[arm]
        columns = []
        smooth = max(scene.base.transition, 1e-3)
        for rate, per_joint in ((bend, bend_per_joint), (turn, turn_per_joint)):
            speed = np.sqrt(np.sum(rate**2, axis=-1, keepdims=True))
            unit = rate * np.tanh(speed / smooth) / np.maximum(speed, 1e-12)
            columns.append((unit, per_joint))
        for rate, per_joint in ((bend, bend_per_joint), (turn, turn_per_joint)):
            columns.append((rate, per_joint))
        return np.stack([np.einsum("nax,naxj->nj", rate, per) for rate, per in columns], axis=-1)
