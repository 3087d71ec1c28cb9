"""A stretch of recorded motion with everything that effects read from it, computed once."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from schemas.kernels import kernel
from service.model.coulomb_viscous import mean_direction
from service.model.mechanism import Arms, Delta, Mechanism, Rigid
from service.model.nominal import Correction
from service.model.signals import Segment

ANGLE_STEP, SPEED_STEP = 1e-5, 1e-3  # rad, rad/s, of the finite differences of the rigid torque
GEOMETRY_STEP = 5e-4  # m or rad, of the same by lengths and angles of the arms
GEOMETRY_KEPT = 6  # slopes by geometry of a recording: two parts on three arms are fitted together


@dataclass(frozen=True)
class Base:
    """The model without effects: k rigid coefficients and F frictions.

    transition: rad/s over which friction turns from one sign to the other, f_c tanh(theta_dot / transition), one for
    all or one (F,) each; 0: a jump. timing: s by which the torque is older than the position, a fraction of a sample.
    wanted: (k,) bool, coefficients that a fit moves; None: all. widest: (F,) rad/s that a fit may give each transition
    at most; None: `parameters.WIDE_TRANSITION`. band_hz: up to which the torque follows the motion as modelled; what
    the model says above it is cut off.
    """

    rigid: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    transition: float | np.ndarray = 0.0
    timing: float = 0.0
    wanted: np.ndarray | None = None
    widest: np.ndarray | None = None
    band_hz: float = np.inf


@dataclass(frozen=True)
class Recording:
    """One segment of a trace on a mechanism: what follows from the motion alone."""

    segment: Segment
    mechanism: Mechanism
    trace: int  # which of the traces the segment is from
    name: str

    @cached_property
    def rigid(self) -> Rigid:
        """Rigid torque and its columns."""
        return self.mechanism.rigid(self.segment.theta, self.segment.theta_dot, self.segment.theta_ddot)

    @cached_property
    def sliding(self) -> np.ndarray:
        """(N, F): speed of each friction; the first are those of the joints themselves."""
        theta_dot = self.segment.theta_dot
        shared = self.mechanism.rows[self.mechanism.joints :]
        return np.concatenate([theta_dot, theta_dot @ shared.T], axis=1) if len(shared) else theta_dot

    @cached_property
    def arms(self) -> Arms:
        """Kinematics of the Delta."""
        return self.delta.arms(self.segment.theta, self.segment.theta_dot, self.segment.theta_ddot)

    @property
    def delta(self) -> Delta:
        """The mechanism, where it is a Delta."""
        platform = self.mechanism.platform
        assert platform is not None
        return platform

    @cached_property
    def at_rest(self) -> Rigid:
        """The same in each pose without motion."""
        still = np.zeros_like(self.segment.theta)
        return self.mechanism.rigid(self.segment.theta, still, still)

    @cached_property
    def by_motion(self) -> np.ndarray:
        """(joint, N, n, 3, k + 1): slope of each column and, last, of the known torque with the angle, speed and
        acceleration of a joint."""
        motion, slopes = (self.segment.theta, self.segment.theta_dot, self.segment.theta_ddot), []
        for joint in np.eye(self.mechanism.joints):
            each = []
            for place, size in enumerate((ANGLE_STEP, SPEED_STEP, 1.0)):
                above, below = (
                    self.mechanism.rigid(*(x + step * joint if i == place else x for i, x in enumerate(motion)))
                    for step in (size, -size)
                )
                each.append((_stacked(above) - _stacked(below)) / (2 * size))
            slopes.append(np.stack(each, axis=2))
        return np.stack(slopes)

    def by_geometry(self, part: str, arm: int) -> tuple[np.ndarray, np.ndarray]:
        """(N, n, k + 1) twice: slope of each column and, last, of the known torque by a part of `Correction` at an arm,
        m or rad, and the slope of that. The last `GEOMETRY_KEPT` are kept."""
        if (part, arm) not in self._by_geometry:
            while len(self._by_geometry) >= GEOMETRY_KEPT:
                del self._by_geometry[next(iter(self._by_geometry))]
            motion = self.segment.theta, self.segment.theta_dot, self.segment.theta_ddot
            step = GEOMETRY_STEP * np.eye(3)[arm]
            above, below = (
                _stacked(self.delta.altered(Correction(**{part: way * step}), *motion)) for way in (1.0, -1.0)
            )
            middle = _stacked(self.rigid)
            self._by_geometry[part, arm] = (
                (above - below) / (2 * GEOMETRY_STEP),
                (above - 2 * middle + below) / GEOMETRY_STEP**2,
            )
        return self._by_geometry[part, arm]

    @cached_property
    def in_band(self) -> dict[Hashable, np.ndarray]:
        """What `torque` keeps from one operating point to the next."""
        return {}

    @cached_property
    def _by_geometry(self) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
        return {}


def _stacked(rigid: Rigid) -> np.ndarray:
    return np.concatenate([rigid.columns, rigid.known[..., None]], axis=-1)


@dataclass(frozen=True)
class Scene:
    """A recording seen from an operating point: `base` is where products of parameters are linearised.

    lean: (3,) m/s^2 of gravity beside the description's, which masses beside it feel too.
    """

    recording: Recording
    base: Base
    lean: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def segment(self) -> Segment:
        """Motion and torque."""
        return self.recording.segment

    @property
    def mechanism(self) -> Mechanism:
        """What moves."""
        return self.recording.mechanism

    @property
    def delta(self) -> Delta:
        """The mechanism, where it is a Delta."""
        return self.recording.delta

    @property
    def arms(self) -> Arms:
        """Kinematics of the Delta."""
        return self.recording.arms

    @property
    def time(self) -> np.ndarray:
        """(N,) s, on the clock of the log."""
        return self.segment.time

    @property
    def period(self) -> float:
        """s."""
        return self.segment.period

    @property
    def joints(self) -> int:
        """n."""
        return self.mechanism.joints

    @property
    def sliding(self) -> np.ndarray:
        """(N, F): speed of each friction."""
        return self.recording.sliding

    @cached_property
    def friction_direction(self) -> np.ndarray:
        """(N, F): direction in which each friction slides, in [-1, 1]."""
        return mean_direction(self.sliding, self.base.transition)

    @property
    def direction(self) -> np.ndarray:
        """(N, n): direction in which each joint moves, in [-1, 1]."""
        return self.friction_direction[:, : self.joints]

    @cached_property
    def load(self) -> np.ndarray:
        """(N, n) N m: torque through the gear, without friction."""
        return self.recording.rigid.torque(self.base.rigid)

    @cached_property
    def weight(self) -> np.ndarray:
        """(N, n) N m: `load` without motion."""
        if self.mechanism.direct is not None:
            still = np.zeros_like(self.segment.theta)
            return self.mechanism.direct.torque(self.segment.theta, still, still, self.base.rigid)
        return self.recording.at_rest.torque(self.base.rigid)

    @cached_property
    def total(self) -> np.ndarray:
        """(N, n) N m: the base model."""
        rubs = self.base.viscous * self.sliding + self.base.coulomb * self.friction_direction
        return self.load + self.at_joints(rubs)

    def at_joints(self, rubs: np.ndarray) -> np.ndarray:
        """(N, n) N m: what frictions of (N, F) are together at each joint."""
        n = self.joints
        shared = self.mechanism.rows[n:]
        return rubs[:, :n] + rubs[:, n:] @ shared if len(shared) else rubs

    def slopes(self, joint: int) -> np.ndarray:
        """(N, n, 3): of load and viscous friction with the joint's angle, speed and acceleration, N m/rad, N m s/rad,
        kg m^2."""
        if joint not in self._slopes:
            slopes = self._rigid_slopes(joint)
            rows = self.mechanism.rows
            slopes[..., 1] += (self.base.viscous * rows[:, joint]) @ rows
            self._slopes[joint] = slopes
        return self._slopes[joint]

    def _rigid_slopes(self, joint: int) -> np.ndarray:
        if self._direct_slopes is not None:
            return self._direct_slopes[joint]
        return np.tensordot(self.recording.by_motion[joint], np.append(self.base.rigid, 1.0), 1)

    @cached_property
    def _direct_slopes(self) -> np.ndarray | None:
        """(joint, N, n, 3): slopes of the rigid torque. With the many coefficients of an arm, or six axes with
        theirs, `by_motion` would take hundreds of megabytes."""
        if self.mechanism.direct is None:
            return None
        motion = self.segment
        return self.mechanism.direct.slopes(motion.theta, motion.theta_dot, motion.theta_ddot, self.base.rigid)

    @cached_property
    def _direct_load(self) -> np.ndarray:
        """`load`, by the algorithm that `moved` uses: their difference is of the motion alone."""
        assert self.mechanism.direct is not None
        motion = self.segment
        return self.mechanism.direct.torque(motion.theta, motion.theta_dot, motion.theta_ddot, self.base.rigid)

    def moved(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, n) N m: rigid torque along another motion, above that along the recorded one."""
        direct = self.mechanism.direct
        if direct is not None:
            return direct.torque(theta, theta_dot, theta_ddot, self.base.rigid) - self._direct_load
        return self.mechanism.rigid(theta, theta_dot, theta_ddot).torque(self.base.rigid) - self.load

    @cached_property
    def _slopes(self) -> dict[int, np.ndarray]:
        return {}

    def at_platform(self, force: np.ndarray) -> np.ndarray:
        """Joint torque (N, 3) that holds a force (N, 3) or (3,) N acting from the platform on its surroundings."""
        force = np.broadcast_to(force, (len(self.time), 3))
        return np.einsum("nai,na->ni", self.arms.jacobian, force)

    def by_geometry(self, part: str, arm: int) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) twice: first and second slope of the rigid torque by a part of `Correction` at an arm, m or rad."""
        weights = np.append(self.base.rigid, 1.0)
        first, second = self.recording.by_geometry(part, arm)
        return np.tensordot(first, weights, 1), np.tensordot(second, weights, 1)

    def perturbed(self, joint: int, angle: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """(N, n, L) N m: first-order changes of the base torque when `joint` moves differently.

        angle, speed, acceleration: (N, L) rad, rad/s, rad/s^2 more than recorded.
        """
        slopes = self.slopes(joint)
        torque = np.empty((*slopes.shape[:2], angle.shape[1]))
        _perturbed(slopes, angle, speed, acceleration, torque)
        return torque


@kernel(nogil=True)
def _perturbed(slopes, angle, speed, acceleration, torque):
    """One pass over (N, n, L): as products of whole arrays it takes several times as long."""
    count, joints, width = torque.shape
    for k in range(count):
        for j in range(joints):
            by_angle, by_speed, by_acceleration = slopes[k, j, 0], slopes[k, j, 1], slopes[k, j, 2]
            for i in range(width):
                torque[k, j, i] = by_angle * angle[k, i] + by_speed * speed[k, i] + by_acceleration * acceleration[k, i]
