"""What moves: the rigid-body torque of a mechanism, linear in its identified coefficients.

A mechanism gives a known torque, one column a coefficient, and - the Delta alone - the arms' kinematics that effects on
the platform and in the ball joints need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
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
    """n joints with k identified coefficients, by name.

    frictions: what rubs, F of them, the joints' own first. rows: (F, n), share of each joint's speed in the speed of
    each. optional: coefficients that stand or fall together, and fall where the data do not want them.
    """

    @property
    def kind(self) -> str: ...
    @property
    def joints(self) -> int: ...
    @property
    def coefficients(self) -> dict[str, Coefficient]: ...
    @property
    def gear_ratio(self) -> np.ndarray: ...
    @property
    def frictions(self) -> tuple[str, ...]: ...
    @property
    def rows(self) -> np.ndarray: ...
    @property
    def optional(self) -> Sequence[tuple[str, ...]]: ...

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
    frictions = ("1", "2", "3")
    rows = np.eye(3)
    optional = ()
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
    """n axes that do not feel each other but through their motors: inertia, a constant load and a weight each.

    weighs: axes whose weight turns with them. motors: row i, how far motor i turns for a turn of each axis; one that
    turns with several has inertia and friction of its own.
    """

    gear_ratio: np.ndarray
    weighs: tuple[int, ...] = ()
    motors: np.ndarray | None = None
    kind = "axes"

    @classmethod
    def of(cls, axes: Axes) -> DecoupledAxes:
        """The mechanism of a description."""
        weighs = tuple(number for number, axis in enumerate(axes.axis) if axis.weighs)
        return cls(np.array([axis.gear_ratio for axis in axes.axis]), weighs, axes.motors)

    @property
    def joints(self) -> int:
        """n."""
        return len(self.gear_ratio)

    @cached_property
    def shared(self) -> dict[str, np.ndarray]:
        """Motors that turn with several axes, by name."""
        rows = () if self.motors is None else enumerate(self.motors, start=1)
        return {f"motor_{number}": row for number, row in rows if np.count_nonzero(row) > 1}

    @property
    def frictions(self) -> tuple[str, ...]:
        """The axes, and the motors that turn with several."""
        return (*(str(axis + 1) for axis in range(self.joints)), *self.shared)

    @property
    def rows(self) -> np.ndarray:
        """(F, n)."""
        return np.stack([*np.eye(self.joints), *self.shared.values()])

    @property
    def coefficients(self) -> dict[str, Coefficient]:
        """Inertias, constant loads, weights as sine and cosine of the angle, inertias of shared motors."""
        joints = range(1, self.joints + 1)
        names = {f"inertia_{j}": Coefficient("kg m^2") for j in joints}
        names |= {f"offset_{j}": Coefficient("N m", low=-np.inf) for j in joints}
        for part in ("sin", "cos"):
            names |= {f"gravity_{part}_{j + 1}": Coefficient("N m", low=-np.inf) for j in self.weighs}
        return names | {f"inertia_{motor}": Coefficient("kg m^2") for motor in self.shared}

    @property
    def optional(self) -> list[tuple[str, ...]]:
        """Weights, axis by axis."""
        return [(f"gravity_sin_{j + 1}", f"gravity_cos_{j + 1}") for j in self.weighs]

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, n) motions."""
        eye = np.eye(self.joints)
        weighs = list(self.weighs)
        angle, own = theta[:, None, weighs], eye[:, weighs]
        columns = [theta_ddot[..., None] * eye, np.broadcast_to(eye, (len(theta), *eye.shape))]
        columns += [np.sin(angle) * own, np.cos(angle) * own]
        columns += [(theta_ddot @ row)[:, None, None] * row[:, None] for row in self.shared.values()]
        return Rigid(np.zeros(theta.shape), np.concatenate(columns, axis=-1))


def mechanism_of(robot: Description) -> Mechanism:
    """The mechanism of a description; effects it names are not in it."""
    return DecoupledAxes.of(robot) if isinstance(robot, Axes) else Delta.of(robot)
