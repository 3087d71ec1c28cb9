"""A serial arm by Pinocchio (extra `chain`): joint torque per unit of every link's mass, first and second moments, and
which combinations of them motion can tell.

Source: Gautier, Numerical calculation of the base inertial parameters of robots, 1991; Carpentier et al., The Pinocchio
C++ library, 2019 (doi 10.1109/SII.2019.8700380).
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from schemas.errors import RobotError
from schemas.urdf import Urdf

A_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")  # Pinocchio's order, about the joint's frame
UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}  # the rest kg m^2
# What stands for a combination is the first of it: what turns, before what weighs.
FIRST = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m")
DEPENDENT = 1e-4  # of a column's length that the columns before it leave: angles in a URDF are written to four digits
NOTHING = 1e-6  # of the longest column: what an angle written to six digits makes of none at all
POSES = 400  # random, that tell dependent columns
STEP = 1e-6  # m or rad, of finite differences by a joint's place
LEAST_MASS = 1e-3  # kg: a body of less has no centre that could carry its first moments
NO_MASS = 1e-9  # kg
SPEED, ACCELERATION = 3.0, 10.0  # rad/s, rad/s^2, of them


def pinocchio(asks: str) -> Any:
    """The library.

    Raises:
        RobotError: it is not installed; `asks` says what for.
    """
    try:
        return importlib.import_module("pinocchio")
    except ImportError as cause:
        raise RobotError(
            f"{asks}: Pinocchio is not installed ({cause}): pip install 'deltatwin[chain]' (not on Windows)"
        ) from cause


class Arm:
    """An arm of n joints that turn, logged in the order of `joints`.

    names: (10 n) of what its links weigh, `Izz_2`, in the order of `FIRST`. weights: (10 n,) as the URDF has them, SI.
    """

    def __init__(self, urdf: Urdf, joints: Sequence[str], gravity: Sequence[float]) -> None:
        library = pinocchio(str(urdf.path))
        try:
            self._model = library.buildModelFromXML(urdf.text)
        except (ValueError, RuntimeError) as cause:
            raise RobotError(f"{urdf.path}: not a URDF that Pinocchio builds: {cause}") from cause
        self._model.gravity.linear = np.array(gravity)
        self._library, self._urdf = library, urdf
        self._numbers = [self._model.getJointId(name) for name in joints]
        self._order = np.array([self._model.joints[number].idx_v for number in self._numbers])
        # (10 n,) where the URDF's body of each joint stands among Pinocchio's columns
        own = [A_LINK.index(name) for name in FIRST]
        self._columns = np.concatenate([10 * (number - 1) + np.array(own) for number in self._numbers])
        self.names = tuple(f"{name}_{joint}" for joint in range(1, len(joints) + 1) for name in FIRST)
        self.weights = self._parameters([inertia.toDynamicParameters() for inertia in self._model.inertias[1:]])

    @property
    def joints(self) -> int:
        """n."""
        return len(self._order)

    def _parameters(self, bodies: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(bodies)[self._columns]

    def mass_on(self, frame: str, centre: Sequence[float]) -> np.ndarray:
        """(10 n,): what a kilogram with its centre at (3,) m in the frame of a link adds to the weights."""
        point = self._library.Inertia(1.0, np.array(centre, float), np.zeros((3, 3)))
        return self.body_on(frame) @ point.toDynamicParameters()

    def body_on(self, frame: str) -> np.ndarray:
        """(10 n, 10): what a body of (10,) `A_LINK` about the frame of a link adds to the weights; none on the base."""
        found = self._model.frames[self._model.getFrameId(frame)]
        result = np.zeros((10 * (self._model.njoints - 1), 10))
        if found.parentJoint:
            own = slice(10 * (found.parentJoint - 1), 10 * found.parentJoint)
            moved = found.placement.homogeneous
            result[own] = np.array([body_of(moved @ pseudo_inertia(unit) @ moved.T) for unit in np.eye(10)]).T
        return result[self._columns]

    @property
    def tool(self) -> str:
        """The last link of the URDF that moves with the last joint."""
        model = self._model
        named = {name: model.frames[model.getFrameId(name)].parentJoint for name in self._urdf.links}
        return [name for name, joint in named.items() if joint == max(named.values())][-1]

    def place(self, frame: str, theta: np.ndarray) -> np.ndarray:
        """(N, 3) m of the frame of a link at (N, n) angles, in the base frame."""
        data, number = self._model.createData(), self._model.getFrameId(frame)
        angles, result = np.empty(theta.shape), np.empty((len(theta), 3))
        angles[:, self._order] = theta
        for row, pose in enumerate(angles):
            self._library.framesForwardKinematics(self._model, data, pose)
            result[row] = data.oMf[number].translation
        return result

    def dynamics(self, weights: np.ndarray) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Mass matrices (N, n, n) kg m^2 and the torque (N, n) N m of speed and weight at (N, n) angles and speeds, of
        links of `weights` (10 n,)."""
        library, model, order = self._library, self._weighing(weights), self._order
        data, block = model.createData(), np.ix_(order, order)

        def at(theta: np.ndarray, theta_dot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            state = np.empty((2, *theta.shape))
            state[:, :, order] = theta, theta_dot
            mass, bias = np.empty((*theta.shape, theta.shape[1])), np.empty(theta.shape)
            for row, (angle, speed) in enumerate(zip(*state, strict=True)):
                upper = np.triu(library.crba(model, data, angle))
                mass[row] = (upper + np.triu(upper, 1).T)[block]
                bias[row] = library.nonLinearEffects(model, data, angle, speed)[order]
            return mass, bias

        return at

    def _weighing(self, weights: np.ndarray) -> Any:
        """The model with links of `weights` (10 n,)."""
        model = self._model.copy()
        bodies = np.zeros(10 * (model.njoints - 1))
        bodies[self._columns] = weights
        for number, body in enumerate(bodies.reshape(-1, 10), start=1):
            mass = body[0] if abs(body[0]) > LEAST_MASS else LEAST_MASS
            model.inertias[number] = self._library.Inertia.FromDynamicParameters(np.r_[mass, body[1:]])
        return model

    def columns(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, n, 10 n): torque along (N, n) motions, N m per unit of each weight."""
        data, compute = self._model.createData(), self._library.computeJointTorqueRegressor
        angles, speeds, accelerations = self._in_order(theta, theta_dot, theta_ddot)
        result, block = np.empty((len(theta), self.joints, len(self._columns))), np.ix_(self._order, self._columns)
        for row in range(len(theta)):
            result[row] = compute(self._model, data, angles[row], speeds[row], accelerations[row])[block]
        return result

    def instant(self, weights: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """What gives the torque (n,) N m at one motion (3, n) - angles, speeds, accelerations - of links of `weights`
        (10 n,), without making anything anew."""
        model, compute, order = self._weighing(weights), self._library.rnea, self._order
        data, state = model.createData(), np.empty((3, self.joints))

        def at(motion: np.ndarray) -> np.ndarray:
            state[:, order] = motion
            return compute(model, data, state[0], state[1], state[2])[order]

        return at

    def regressor(self) -> Callable[[np.ndarray], np.ndarray]:
        """The same of `columns`: (n, 10 n) at one motion (3, n)."""
        model, compute, order = self._model, self._library.computeJointTorqueRegressor, self._order
        data, state, block = model.createData(), np.empty((3, self.joints)), np.ix_(self._order, self._columns)

        def at(motion: np.ndarray) -> np.ndarray:
            state[:, order] = motion
            return compute(model, data, state[0], state[1], state[2])[block]

        return at

    def _in_order(self, *motion: np.ndarray) -> np.ndarray:
        """(m, N, n) of m parts (N, n) of a motion, joints as Pinocchio has them."""
        result = np.empty((len(motion), *motion[0].shape))
        result[:, :, self._order] = motion
        return result

    def torque(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """(N, n) N m along (N, n) motions, of links of `weights` (10 n,)."""
        return self._torque(self._weighing(weights), self._in_order(theta, theta_dot, theta_ddot))

    def _torque(self, model: Any, motions: np.ndarray) -> np.ndarray:
        """(N, n) N m along (3, N, n) motions in Pinocchio's order."""
        result = np.empty(motions.shape[:0:-1], order="F")
        if hasattr(self._library, "rneaInParallel"):  # all rows in one call, a third of the time of one call per row
            pool = self._library.ModelPool(model, 1)
            self._library.rneaInParallel(1, pool, *(np.asfortranarray(part.T) for part in motions), result)
        else:  # Pinocchio for macOS is built without OpenMP
            data = model.createData()
            for row in range(motions.shape[1]):
                result[:, row] = self._library.rnea(model, data, *motions[:, row])
        return result.T[:, self._order]

    def slopes(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """(joint, N, n, 3): of the same torque, with the angle, speed and acceleration of a joint."""
        model = self._weighing(weights)
        angles, speeds, accelerations = self._in_order(theta, theta_dot, theta_ddot)
        data, compute = model.createData(), self._library.computeRNEADerivatives
        by_angle, by_speed, mass = result = np.empty((3, *theta.shape, self.joints))
        for row in range(len(theta)):
            compute(model, data, angles[row], speeds[row], accelerations[row])
            by_angle[row], by_speed[row], mass[row] = data.dtau_dq, data.dtau_dv, data.M
        below = np.tril_indices(self.joints, -1)
        mass[:, *below] = mass[:, *below[::-1]]  # of the mass matrix Pinocchio fills what is above the diagonal
        return np.ascontiguousarray(result[:, :, self._order][..., self._order].transpose(3, 1, 2, 0))

    def misplaced(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """(N, n, 6 n): torque along (N, n) motions that links of `weights` (10 n,) ask for beside that of the URDF, N m
        per m and per rad that each joint is off in the link before it, along and about its own axes there."""
        library, model = self._library, self._weighing(weights)
        motions = self._in_order(theta, theta_dot, theta_ddot)
        described, result = self._torque(model, motions), np.empty((*theta.shape, 6 * self.joints))
        for place, number in enumerate(self._numbers):
            placed = model.jointPlacements[number].copy()
            for along in range(6):
                model.jointPlacements[number] = placed * library.exp6(STEP * np.eye(6)[along])
                result[..., 6 * place + along] = (self._torque(model, motions) - described) / STEP
            model.jointPlacements[number] = placed
        return result

    def poses(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(POSES, n) of motions that show all that can be told: any pose within the limits, any speed."""
        draw = np.random.default_rng(0)
        low, high = np.clip(np.array(self._urdf.limits).T, -math.pi, math.pi)
        size = (POSES, self.joints)
        return (
            draw.uniform(np.minimum(low, high), np.maximum(low, high), size),
            draw.uniform(-SPEED, SPEED, size),
            draw.uniform(-ACCELERATION, ACCELERATION, size),
        )


@dataclass(frozen=True)
class Reduction:
    """Columns that motion tells from those before them. kept: (b,) indices. shares: (b, p), by which a value of each of
    p columns is part of what is found in the place of the kept ones."""

    kept: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, columns: np.ndarray) -> Reduction:
        """Of (R, p) columns, in order."""
        basis = np.zeros((len(columns), 0))
        kept, longest = [], np.linalg.norm(columns, axis=0).max()
        for number, column in enumerate(columns.T):
            size = np.linalg.norm(column)
            rest = column - basis @ (basis.T @ column)
            rest -= basis @ (basis.T @ rest)  # once more: the first leaves rounding of the size that is asked for
            left = np.linalg.norm(rest)
            if left > max(DEPENDENT * size, NOTHING * longest):
                kept.append(number)
                basis = np.column_stack([basis, rest / left])
        chosen = columns[:, kept]
        shares = np.linalg.lstsq(chosen, columns, rcond=None)[0]
        return cls(np.array(kept, int), np.where(np.abs(shares) < DEPENDENT, 0.0, shares))


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """(4, 4) pseudo-inertia of (10,) `A_LINK`: second moments, first moments, mass. It moves as a congruence."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = parameters
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    result = np.empty((4, 4))
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = x, y, z
    result[3, 3] = m
    return result


def body_of(pseudo: np.ndarray) -> np.ndarray:
    """(10,) `A_LINK` of a pseudo-inertia."""
    second = pseudo[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
    return np.array([pseudo[3, 3], *pseudo[:3, 3], xx, xy, yy, xz, yz, zz])


def about_centre(body: np.ndarray) -> np.ndarray:
    """(10,) of (10,) `A_LINK`: mass, place of its centre, and inertia about that instead of about the frame."""
    mass = body[0] if abs(body[0]) > NO_MASS else NO_MASS
    moved = np.eye(4)
    moved[:3, 3] = -body[1:4] / mass
    return np.r_[body[0], body[1:4] / mass, body_of(moved @ pseudo_inertia(body) @ moved.T)[4:]]
