"""What moves: the rigid-body torque of a mechanism, linear in its identified coefficients.

A mechanism gives a known torque, one column a coefficient, and - the Delta alone - the arms' kinematics that effects on
the platform and in the ball joints need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from schemas.axes import Axes, Description
from schemas.robot import Robot
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.kinematics import jacobian, motion
from service.model.nominal import DeltaModel, pack


class Rigid(NamedTuple):
    """known: (N, n) N m, free of coefficients. columns: (N, n, k) N m per unit of each coefficient."""

    known: np.ndarray
    columns: np.ndarray

    def torque(self, coefficients: np.ndarray) -> np.ndarray:
        """(N, n) N m."""
        return self.known + self.columns @ coefficients


class Coefficient(NamedTuple):
    """A coefficient's unit and the least that it can be."""

    unit: str
    low: float = 0.0


class Mechanism(Protocol):
    """n joints with k identified coefficients, by name."""

    @property
    def kind(self) -> str: ...
    @property
    def joints(self) -> int: ...
    @property
    def coefficients(self) -> dict[str, Coefficient]: ...
    @property
    def gear_ratio(self) -> np.ndarray: ...

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid: ...


class Arms(NamedTuple):
    """Kinematics of N poses, base frame. position, velocity (N, 3) m, m/s; jacobian (N, 3, 3): [axis, joint];
    payload (N, 3): torque per kg at the platform; slope, forearm, swing (N, arm, 3): dJ'_i/dtheta_i, s_i and its rate;
    axle (3, 3): row i, the unit vector that a positive turn of joint i is about."""

    position: np.ndarray
    velocity: np.ndarray
    jacobian: np.ndarray
    slope: np.ndarray
    forearm: np.ndarray
    swing: np.ndarray
    axle: np.ndarray


@dataclass(frozen=True)
class Delta:
    """A Delta robot at its described geometry."""

    model: DeltaModel
    gear_ratio: np.ndarray
    kind = "delta"
    joints = 3
    coefficients = {  # noqa: RUF012 - a constant of the class
        "rho_1": Coefficient(""),
        "rho_2": Coefficient(""),
        "forearm_inertia_kg": Coefficient("kg"),
    }

    @classmethod
    def of(cls, robot: Robot) -> Delta:
        """The mechanism of a description; effects it names are not in it."""
        return cls(pack(robot), np.full(3, robot.drive.gear_ratio))

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, 3) motions."""
        terms = torque_terms(self.model, theta, theta_dot, theta_ddot)
        return Rigid(terms[:, PLATFORM], np.stack([terms[:, INERTIA], terms[:, GRAVITY], terms[:, FOREARM]], axis=-1))

    def payload(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, 3) N m per kg at the platform."""
        return torque_terms(self.model, theta, theta_dot, theta_ddot)[:, PAYLOAD]

    def altered(self, length_error: np.ndarray, joint_offset: np.ndarray) -> Delta:
        """The same robot with active links longer by (3,) m and joint zeros moved by (3,) rad."""
        model = self.model
        length = model.active_length + length_error
        ratio = length / model.active_length
        return Delta(
            model._replace(
                active_length=length,
                joint_offset=model.joint_offset + joint_offset,
                inertia=model.inertia * ratio**2,
                gravity_torque=model.gravity_torque * ratio,
            ),
            self.gear_ratio,
        )

    def arms(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Arms:
        """Kinematics of (N, 3) motions."""
        model = self.model
        platform = motion(model, theta, theta_dot, theta_ddot)
        angle = theta + model.joint_offset
        cosine, sine, l1 = np.cos(angle), np.sin(angle), model.active_length
        outward = np.stack([model.azimuth_cos, model.azimuth_sin, np.zeros(3)], axis=1)
        up = np.array([0.0, 0.0, 1.0])
        elbow = (model.radius + l1 * cosine)[..., None] * outward - (l1 * sine)[..., None] * up
        slope = -(l1 * sine)[..., None] * outward - (l1 * cosine)[..., None] * up
        return Arms(
            position=platform.position,
            velocity=platform.velocity,
            jacobian=jacobian(model, theta),
            slope=slope,
            forearm=platform.position[:, None, :] - elbow,
            swing=platform.velocity[:, None, :] - slope * theta_dot[..., None],
            axle=np.cross(up, outward),
        )


@dataclass(frozen=True)
class DecoupledAxes:
    """n axes that do not feel each other: inertia and a constant load each."""

    gear_ratio: np.ndarray
    kind = "axes"

    @classmethod
    def of(cls, axes: Axes) -> DecoupledAxes:
        """The mechanism of a description."""
        return cls(np.array([axis.gear_ratio for axis in axes.axis]))

    @property
    def joints(self) -> int:
        """n."""
        return len(self.gear_ratio)

    @property
    def coefficients(self) -> dict[str, Coefficient]:
        """Inertias, then constant loads."""
        joints = range(1, self.joints + 1)
        inertias = {f"inertia_{j}": Coefficient("kg m^2") for j in joints}
        return inertias | {f"offset_{j}": Coefficient("N m", low=-np.inf) for j in joints}

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, n) motions."""
        eye = np.eye(self.joints)
        constant = np.broadcast_to(eye, (len(theta), self.joints, self.joints))
        return Rigid(np.zeros(theta.shape), np.concatenate([theta_ddot[..., None] * eye, constant], axis=-1))


def mechanism_of(robot: Description) -> Mechanism:
    """The mechanism of a description; effects it names are not in it."""
    return DecoupledAxes.of(robot) if isinstance(robot, Axes) else Delta.of(robot)
