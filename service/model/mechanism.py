"""What moves: the rigid-body torque of a mechanism, linear in its identified coefficients.

A mechanism gives a known torque, one column a coefficient, and - the Delta alone - the arms' kinematics that effects on
the platform and in the ball joints need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from schemas.axes_description import Axes, Description
from schemas.chain_description import Chain
from schemas.robot import Robot
from service.model.arm import UNITS, Arm, Reduction
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, torque_terms
from service.model.kinematics import jacobian, motion
from service.model.nominal import Correction, DeltaModel, pack

TEXTBOOK = "M_KH"  # the paper's model before identification
URDF = "URDF"  # of an arm: its masses without friction


class Rigid(NamedTuple):
    """known: (N, n) N m, free of coefficients. columns: (N, n, k) N m per unit of each coefficient."""

    known: np.ndarray
    columns: np.ndarray

    def torque(self, coefficients: np.ndarray) -> np.ndarray:
        """(N, n) N m."""
        return self.known + np.tensordot(self.columns, coefficients, 1)  # `@` would be a product a sample


class Coefficient(NamedTuple):
    """A coefficient's unit and the least that it can be."""

    unit: str
    low: float = 0.0


class Direct(Protocol):
    """The torque of a mechanism, and its slopes, without the slopes of each column of `rigid`. instant: what gives the
    torque (n,) N m at one motion (3, n)."""

    def torque(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray: ...
    def slopes(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray: ...
    def instant(self, coefficients: np.ndarray) -> Callable[[np.ndarray], np.ndarray]: ...


class Mechanism(Protocol):
    """n joints with k identified coefficients, by name.

    frictions: what rubs, F of them, the joints' own first. rows: (F, n), share of each joint's speed in the speed of
    each. optional: coefficients that stand or fall together, and fall where the data do not want them. start: (k,)
    coefficients as described, zero where they are not; they stand where the data do not tell. links: (k,) bool, those
    that are of links whose masses are described. closed: all links hang on one platform, and feel each other's gears.
    own_transitions: each friction has one of its own. unidentified: coefficients (k,) of models that need no
    identification, by name. direct: of a mechanism whose columns are too many to take the slopes of each. decoupled:
    a joint's torque depends on its own motion, and on that of others only through a shared motor. described_whole: the
    description gives all geometry and masses, so that residual torque is a discrepancy and not an incomplete
    description. weighs: joints whose weight turns with them and is found from the log alone. platform, tree: the
    mechanism itself where its arms carry a platform, or where it is bodies of a URDF; else None.
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
    @property
    def start(self) -> np.ndarray: ...
    @property
    def links(self) -> np.ndarray: ...
    @property
    def closed(self) -> bool: ...
    @property
    def own_transitions(self) -> bool: ...
    @property
    def unidentified(self) -> Mapping[str, np.ndarray]: ...
    @property
    def direct(self) -> Direct | None: ...
    @property
    def decoupled(self) -> bool: ...
    @property
    def described_whole(self) -> bool: ...
    @property
    def weighs(self) -> tuple[int, ...]: ...
    @property
    def platform(self) -> Delta | None: ...
    @property
    def tree(self) -> SerialArm | None: ...

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid: ...
    def grey(self, coefficients: np.ndarray) -> np.ndarray: ...
    def as_described(self) -> Mechanism | None: ...


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
    start = np.zeros(3)  # a Delta's description is asked for by name, see `pooled.fit`
    links = np.zeros(3, bool)
    closed = True
    own_transitions = False
    unidentified = {TEXTBOOK: np.array([1.0, 1.0, 0.0])}  # noqa: RUF012 - a constant of the class
    direct = None
    decoupled = False
    described_whole = True
    weighs = ()
    tree = None
    coefficients = {  # noqa: RUF012 - a constant of the class
        "rho_1": Coefficient(""),
        "rho_2": Coefficient(""),
        "forearm_inertia_kg": Coefficient("kg"),
    }

    @classmethod
    def of(cls, robot: Robot) -> Delta:
        """The mechanism of a description; effects it names are not in it."""
        return cls(pack(robot), np.full(3, robot.drive.gear_ratio))

    @property
    def platform(self) -> Self:
        """Itself."""
        return self

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, 3) motions."""
        terms = torque_terms(self.model, theta, theta_dot, theta_ddot)
        known = terms[:, PLATFORM].copy()  # a view would keep all terms
        return Rigid(known, np.stack([terms[:, INERTIA], terms[:, GRAVITY], terms[:, FOREARM]], axis=-1))

    def grey(self, coefficients: np.ndarray) -> np.ndarray:
        """Those of M_Id, which has no forearm inertia."""
        return coefficients * self.unidentified[TEXTBOOK]

    def as_described(self) -> Mechanism | None:
        """Its masses are described as a whole, by the geometry."""
        return None

    def payload(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, 3) N m per kg at the platform."""
        return torque_terms(self.model, theta, theta_dot, theta_ddot)[:, PAYLOAD]

    def altered(
        self, correction: Correction, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray
    ) -> Rigid:
        """Torque of (N, 3) motions with another geometry."""
        altered = Delta(correction.altered(self.model), self.gear_ratio)
        known, columns = altered.rigid(theta, theta_dot, theta_ddot)
        # `nominal.lengthened`, as a known part and columns of rho
        ratio = self.model.active_length / altered.model.active_length
        for column, power in ((0, 2), (1, 1)):
            known = known + (1.0 - ratio**power) * columns[..., column]
            columns[..., column] *= ratio**power
        return Rigid(known, columns)

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
class _Servos:
    """n joints with a motor each. motors: row i, how far motor i turns for a turn of each joint; one that turns with
    several has inertia and friction of its own."""

    gear_ratio: np.ndarray
    motors: np.ndarray | None = None
    closed = False
    own_transitions = True
    described_whole = False
    platform = None

    @property
    def joints(self) -> int:
        """n."""
        return len(self.gear_ratio)

    def grey(self, coefficients: np.ndarray) -> np.ndarray:
        """All of them."""
        return coefficients

    @cached_property
    def shared(self) -> dict[str, np.ndarray]:
        """Motors that turn with several joints, by name."""
        rows = () if self.motors is None else enumerate(self.motors, start=1)
        return {f"motor_{number}": row for number, row in rows if np.count_nonzero(row) > 1}

    @property
    def frictions(self) -> tuple[str, ...]:
        """The joints, and the motors that turn with several."""
        return (*(str(joint + 1) for joint in range(self.joints)), *self.shared)

    @property
    def rows(self) -> np.ndarray:
        """(F, n)."""
        return np.stack([*np.eye(self.joints), *self.shared.values()])

    @property
    def direct(self) -> Self:
        """Itself."""
        return self

    def _rotors(self, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, n, F): torque per kg m^2 of what turns with each joint, and with each motor of several."""
        return np.stack([(theta_ddot @ row)[:, None] * row for row in self.rows], axis=-1)

    def _ones(self, count: int) -> np.ndarray:
        """(count, n, n): a torque of 1 N m on each joint."""
        return np.broadcast_to(np.eye(self.joints), (count, self.joints, self.joints))


@dataclass(frozen=True)
class DecoupledAxes(_Servos):
    """n axes that do not feel each other but through their motors: inertia, a constant load and a weight each.

    weighs: axes whose weight turns with them.
    """

    weighs: tuple[int, ...] = ()
    kind = "axes"
    decoupled = True
    tree = None
    unidentified = MappingProxyType[str, np.ndarray]({})

    @classmethod
    def of(cls, axes: Axes) -> DecoupledAxes:
        """The mechanism of a description."""
        weighs = tuple(number for number, axis in enumerate(axes.axis) if axis.weighs)
        return cls(np.array(axes.gear_ratios), axes.motors, weighs)

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

    @property
    def start(self) -> np.ndarray:
        """Nothing is described."""
        return np.zeros(len(self.coefficients))

    @property
    def links(self) -> np.ndarray:
        """None."""
        return np.zeros(len(self.coefficients), bool)

    def as_described(self) -> Mechanism | None:
        """No masses are described."""
        return None

    def torque(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """(N, n) N m along (N, n) motions."""
        return self.rigid(theta, theta_dot, theta_ddot).torque(coefficients)

    def slopes(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """(joint, N, n, 3): of that torque, with the angle, speed and acceleration of a joint."""
        n, weighs = self.joints, list(self.weighs)
        inertia, _, sine, cosine, shared = np.split(coefficients, np.cumsum([n, n, len(weighs), len(weighs)]))
        result = np.zeros((n, len(theta), n, 3))
        angle = theta[:, weighs]
        result[weighs, :, weighs, 0] = (sine * np.cos(angle) - cosine * np.sin(angle)).T
        rows = self.rows
        result[..., 2] = ((rows.T * [*inertia, *shared]) @ rows)[:, None]
        return result

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, n) motions."""
        weighs = list(self.weighs)
        angle, own = theta[:, None, weighs], np.eye(self.joints)[:, weighs]
        inertia, shared = np.split(self._rotors(theta_ddot), [self.joints], axis=-1)
        columns = [inertia, self._ones(len(theta)), np.sin(angle) * own, np.cos(angle) * own, shared]
        return Rigid(np.zeros(theta.shape), np.concatenate(columns, axis=-1))

    def instant(self, coefficients: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """What gives the torque (n,) N m at one motion (3, n)."""
        return lambda motion: self.rigid(*motion[:, None]).torque(coefficients)[0]


@dataclass(frozen=True, kw_only=True)
class SerialArm(_Servos):
    """An arm by its URDF: what motion can tell of its links' masses, rotors, constant loads and a payload.

    A coefficient `rotor_2` or `Izz_3` is that of a motor or of a link about its joint with whatever goes along with it
    in every motion (base parameters). known: (10 n,) weights that are not asked for. asked: whether those of the links
    are. payload: (10 n,) that a kilogram of an unknown payload adds, where there is one.
    """

    arm: Arm
    known: np.ndarray
    asked: bool = True
    payload: np.ndarray | None = None
    optional = ()
    kind = "chain"
    decoupled = False
    weighs = ()

    @classmethod
    def of(cls, chain: Chain) -> SerialArm:
        """The mechanism of a description.

        Raises:
            RobotError: Pinocchio is missing, or does not build the arm.
        """
        arm, load = Arm(chain.arm, chain.joints, chain.gravity_mps2), chain.payload
        asked = chain.masses == "identified"
        found = {} if chain.identified is None else chain.identified.rigid
        told = np.array([found[name].value if name in found else 0.0 for name in arm.names])
        if asked:
            known = np.zeros(len(arm.weights))
        else:  # those of [identified], or of the URDF where it has none
            known = told if any(name in found for name in arm.names) else arm.weights
        kilogram = None
        if load is not None:
            kilogram = arm.mass_on(load.frame, load.centre_m)
            if load.mass_kg is not None:
                known, kilogram = known + load.mass_kg * kilogram, None
        gear = np.array(chain.gear_ratios)
        return cls(gear_ratio=gear, motors=chain.motors, arm=arm, known=known, asked=asked, payload=kilogram)

    @cached_property
    def _candidates(self) -> dict[str, Coefficient]:
        """All that could be asked for, by name."""
        # What no URDF has comes first: a link's mass that goes along with it may then stay as described.
        names = {f"rotor_{j + 1}": Coefficient("kg m^2") for j in range(self.joints)}
        names |= {f"inertia_{motor}": Coefficient("kg m^2") for motor in self.shared}
        names |= {f"offset_{j + 1}": Coefficient("N m", -np.inf) for j in range(self.joints)}
        if self.asked:
            names |= {name: Coefficient(UNITS.get(name.split("_")[0], "kg m^2"), -np.inf) for name in self.arm.names}
        elif self.payload is not None:
            names |= {"payload": Coefficient("kg")}
        return names

    def _columns(self, links: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
        """(N, n, p) of the candidates. links: (N, n, 10 n)."""
        last = [links] if self.asked else [] if self.payload is None else [(links @ self.payload)[..., None]]
        return np.concatenate([self._rotors(theta_ddot), self._ones(len(links)), *last], axis=-1)

    @cached_property
    def _reduction(self) -> Reduction:
        poses = self.arm.poses()
        columns = self._columns(self.arm.columns(*poses), poses[2])
        return Reduction.of(columns.reshape(-1, columns.shape[-1]))

    @property
    def coefficients(self) -> dict[str, Coefficient]:
        """Those of the candidates that motion tells."""
        names = list(self._candidates.items())
        return dict(names[place] for place in self._reduction.kept)

    @property
    def links(self) -> np.ndarray:
        """(k,) bool: coefficients that are of the links alone, which the URDF has too."""
        return np.array([name in self.arm.names for name in self.coefficients])

    @property
    def tree(self) -> Self:
        """Itself."""
        return self

    @property
    def start(self) -> np.ndarray:
        """What the URDF says of the links, as far as they are asked for."""
        described = np.zeros(len(self._candidates))
        if self.asked:
            described[-len(self.arm.weights) :] = self.arm.weights
        return self._reduction.shares @ described

    @property
    def unidentified(self) -> dict[str, np.ndarray]:
        """The masses of the URDF, without friction."""
        return {URDF: self.start}

    def as_described(self) -> Mechanism:
        """The same arm with the masses of its links as they are described, not asked for."""
        return replace(self, asked=False, known=self.arm.weights) if self.asked else self

    def told(self, coefficients: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        """Rotors and constant loads by name, and the links' weights (10 n,) that `coefficients` are found of; what
        these leave open stays as described."""
        candidates = np.zeros(len(self._candidates))
        if self.asked:
            candidates[-len(self.arm.weights) :] = self.arm.weights
        reduction = self._reduction
        candidates[reduction.kept] += coefficients - reduction.shares @ candidates
        values = dict(zip(self._candidates, candidates.tolist(), strict=True))
        weights = self.known
        if self.asked:
            weights = weights + candidates[-len(self.arm.weights) :]
        elif self.payload is not None:
            weights = weights + values.pop("payload", 0.0) * self.payload
        return {name: value for name, value in values.items() if name not in self.arm.names}, weights

    @property
    def shares(self) -> np.ndarray:
        """(k, p): what rotors, constant loads and links' weights, as in `told`, are of the coefficients."""
        return self._reduction.shares

    def misplaced(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """(N, n, 6 n): as `Arm.misplaced`, of links that `coefficients` are found of.

        What they leave open of the links stays as described. It makes a difference that coefficients do not make up for
        only where a joint is turned so that motion would tell more of the links.
        """
        return self.arm.misplaced(theta, theta_dot, theta_ddot, self.told(coefficients)[1])

    def torque(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """(N, n) N m along (N, n) motions: that of `rigid`, without its columns."""
        values, weights = self.told(coefficients)
        load = np.array([values.get(f"offset_{joint + 1}", 0.0) for joint in range(self.joints)])
        return self.arm.torque(theta, theta_dot, theta_ddot, weights) + theta_ddot @ self._turning(values) + load

    def instant(self, coefficients: np.ndarray, more: np.ndarray | float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
        """What gives that torque (n,) N m at one motion (3, n). more: (10 n,) weights of the links beside."""
        values, weights = self.told(coefficients)
        load = np.array([values.get(f"offset_{joint + 1}", 0.0) for joint in range(self.joints)])
        links, turning = self.arm.instant(weights + more), self._turning(values)
        return lambda motion: links(motion) + turning @ motion[2] + load

    def regressor(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """What gives the columns (n, k) of `rigid` at one motion (3, n), and those (n, 10 n) of the links."""
        links, kept, turning = self.arm.regressor(), self._reduction.kept, len(self.frictions)
        rows, units = self.rows, np.eye(self.joints)
        of_links = kept[kept >= turning + self.joints] - turning - self.joints
        rotors, loads = kept[kept < turning], kept[(kept >= turning) & (kept < turning + self.joints)] - turning

        def at(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            every = links(motion)
            turns = (rows[rotors] * (rows[rotors] @ motion[2])[:, None]).T
            last = every[:, of_links] if self.asked or self.payload is None else (every @ self.payload)[:, None]
            return np.hstack([turns, units[:, loads], last]), every

        return at

    def slopes(
        self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """(joint, N, n, 3): of that torque, with the angle, speed and acceleration of a joint."""
        values, weights = self.told(coefficients)
        result = self.arm.slopes(theta, theta_dot, theta_ddot, weights)
        result[..., 2] += self._turning(values)[:, None]
        return result

    def _turning(self, values: Mapping[str, float]) -> np.ndarray:
        """(n, n) kg m^2: the mass matrix of rotors, in terms of `told`."""
        names = [f"rotor_{joint + 1}" for joint in range(self.joints)] + [f"inertia_{motor}" for motor in self.shared]
        return (self.rows.T * [values.get(name, 0.0) for name in names]) @ self.rows

    def rigid(self, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray) -> Rigid:
        """Torque of (N, n) motions."""
        links = self.arm.columns(theta, theta_dot, theta_ddot)
        return Rigid(links @ self.known, self._columns(links, theta_ddot)[..., self._reduction.kept])


MECHANISMS: dict[type, Callable[[Any], Mechanism]] = {  # a line a kind
    Robot: Delta.of,
    Axes: DecoupledAxes.of,
    Chain: SerialArm.of,
}


def mechanism_of(robot: Description) -> Mechanism:
    """The mechanism of a description; effects it names are not in it."""
    return MECHANISMS[type(robot)](robot)
