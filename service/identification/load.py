"""The load that an arm carries all through a log: mass, centre of mass and inertia on a frame, from what it adds to the
torque of the identified arm.

What the description knows of the arm is known within its standard errors: that is the prior of a least-squares fit of
base parameters and load together. A base parameter and the load may ask for the same torque, as on the last link; then
the prior is what tells them apart, and its error is in the load's. Friction grows with what a gear carries, so that of
the joints may move by `FRICTION` of its value. Standard errors come from leaving out blocks, as in `pooled`.

Source: Khalil, Gautier, Lemoine, Identification of the payload inertial parameters of industrial manipulators, ICRA
2007 (doi 10.1109/ROBOT.2007.364241).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from schemas.axes import Description
from schemas.errors import DataError
from schemas.trace import Trace
from service.identification.fit import Problem, evaluate
from service.identification.folds import Split
from service.identification.pooled import NOT_IDENTIFIABLE
from service.machines import machine_of
from service.model.arm import about_centre, pseudo_inertia
from service.model.description import base_errors, hypothesis_of
from service.model.hypothesis import Hypothesis
from service.model.mechanism import SerialArm
from service.model.parameters import Parameters
from service.model.scene import Recording
from service.model.signals import Band, one_period, resolved_hz, segments_of, thin
from service.model.torque import reported

FRICTION = 0.3  # of its value, one standard deviation: what a load makes of a joint's friction
WIDEST = np.array([100.0] + 3 * [30.0] + 6 * [10.0])  # kg, kg m, kg m^2, one standard deviation before any data
SCARCE = 4  # blocks of motion: fewer give no error
SEEN = 3.0  # standard errors of its mass, from which there is a load
AXES = ("xx", "xy", "yy", "xz", "yz", "zz")
STEP = 1e-6  # of a parameter's unit, of finite differences


@dataclass(frozen=True)
class Load:
    """A load on a frame. mass: kg. centre: (3,) m, in the frame. inertia: (6,) kg m^2 as `AXES`, about the centre, in
    the frame's axes. Each with its standard error. before, after: (n,) rms N m of the torque that is left in the
    analysis band without and with the load, while a joint moves."""

    trace: str
    frame: str
    mass: float
    mass_error: float
    centre: np.ndarray
    centre_error: np.ndarray
    inertia: np.ndarray
    inertia_error: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def seen(self) -> bool:
        """Whether there is a load at all."""
        return self.mass > SEEN * self.mass_error

    @property
    def centre_told(self) -> bool:
        """Whether the motion tells the centre."""
        return self.seen and bool(self.centre_error.max() < 1.0 / NOT_IDENTIFIABLE * self.reach)

    @property
    def reach(self) -> float:
        """m, what the centre's error is held against: the lever of a body of this mass and 1000 kg/m^3."""
        return float(np.cbrt(max(self.mass, 1e-3) / 1000.0))

    @property
    def inertia_told(self) -> bool:
        """Whether the motion tells the inertia: within half of its largest moment, and it is that of a body."""
        moments = self.inertia[[0, 2, 5]]
        possible = bool(np.linalg.eigvalsh(pseudo_inertia(np.r_[1.0, 0, 0, 0, self.inertia])[:3, :3])[0] > 0)
        return self.centre_told and possible and bool(self.inertia_error.max() < NOT_IDENTIFIABLE * moments.max())


def load_on(robot: Description, trace: Trace, frame: str | None = None) -> Load:
    """The load that `robot` carries on a frame, by default its tool, all through `trace`.

    Raises:
        UnansweredError: the machine has no frame. RobotError: it has no such frame. TraceError: the log is unusable.
        DataError: the robot was never identified; the log has too little motion.

    Example:
        >>> load_on(load_description("identified.toml"), read_trace(Path("carried.csv")), "tool0").mass  # kg
    """
    machine = machine_of(robot)
    named, body = machine.load(frame)
    mechanism = machine.mechanism
    assert isinstance(mechanism, SerialArm)
    if robot.identified is None:
        raise DataError(
            f"robot {robot.name}: no [identified] parameters: run `deltatwin identify` on its logs without payload"
        )
    (parts,) = segments_of([trace])
    recordings = [Recording(thin(part), mechanism, 0, trace.name) for part in parts]
    period = one_period([(one.name, one.segment) for one in recordings])
    band = Band.of(period, resolved_hz([one.segment for one in recordings]))
    fitted = _Fit.of(robot, recordings, band, body)
    if len(fitted.grams) < SCARCE:
        raise DataError(f"{trace.path}: too little motion to estimate the payload: {len(fitted.grams) / 2:g} s")
    return fitted.load(trace.name, named)


@dataclass(frozen=True)
class _Fit:
    """Normal equations of load (10) and base parameters (P) together, in units of what is left of each joint's torque.

    grams, moments: (B, 10 + P, 10 + P) and (B, 10 + P) of blocks. prior: (10 + P,) 1 over standard deviation squared.
    memory: how many times fewer samples there are for their likeness to their neighbours.
    """

    problem: Problem
    columns: list[np.ndarray]
    residuals: list[np.ndarray]
    grams: np.ndarray
    moments: np.ndarray
    prior: np.ndarray
    memory: float

    @classmethod
    def of(cls, robot: Description, recordings: list[Recording], band: Band, body: np.ndarray) -> _Fit:
        """Of a description's hypothesis on recordings. body: (10 n, 10)."""
        equal = cls._weighed(robot, recordings, band, body, np.ones(recordings[0].mechanism.joints))
        sigma = equal.left(equal.solved(equal.grams.sum(axis=0), equal.moments.sum(axis=0)))
        made = cls._weighed(robot, recordings, band, body, np.maximum(sigma, 1e-9))
        return replace(made, memory=made.remembers())

    @classmethod
    def _weighed(
        cls, robot: Description, recordings: list[Recording], band: Band, body: np.ndarray, sigma: np.ndarray
    ) -> _Fit:
        """Each joint weighing by 1 over `sigma` (n,) N m."""
        hypothesis = hypothesis_of(robot)
        problem = Problem.of(recordings, band, sigma)
        found = evaluate(problem, hypothesis)
        columns = [
            np.hstack([problem.select(i, _of_load(recording, hypothesis, band, body)), tangent])
            for i, (recording, tangent) in enumerate(zip(recordings, found.tangents, strict=True))
        ]
        prior = _prior(robot, Parameters(hypothesis))
        return cls(problem, columns, found.residuals, *_blocks(problem, columns, found.residuals), prior, 1.0)

    def solved(self, gram: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """(10 + P,) load, and changes of the base parameters; what no prior lets move stands."""
        free = np.isfinite(self.prior)
        result = np.zeros(len(self.prior))
        information = gram[np.ix_(free, free)] / self.memory + np.diag(self.prior[free])
        scale = 1.0 / np.sqrt(np.diag(information))
        result[free] = scale * np.linalg.solve(information * np.outer(scale, scale), scale * moment[free] / self.memory)
        return result

    def left(self, values: np.ndarray) -> np.ndarray:
        """(n,) N m rms."""
        return self.problem.rms([r - c @ values for r, c in zip(self.residuals, self.columns, strict=True)])[0]

    def remembers(self) -> float:
        """Variance of the blocks' moments over that of samples without memory, over the parameters' mean."""
        values = self.solved(self.grams.sum(axis=0), self.moments.sum(axis=0))
        scores = self.moments - self.grams @ values
        alone = np.einsum("bpp->p", self.grams)
        return max(1.0, float(np.mean((np.sum(scores**2, axis=0) / np.maximum(alone, 1e-300))[alone > 0])))

    def load(self, trace: str, frame: str) -> Load:
        """The load and its errors."""
        whole = self.grams.sum(axis=0), self.moments.sum(axis=0)
        values, count = self.solved(*whole), len(self.grams)
        without = [self.solved(whole[0] - g, whole[1] - m) for g, m in zip(self.grams, self.moments, strict=True)]
        off = np.array(without) - np.mean(without, axis=0)
        covariance = (count - 1) / count * off.T @ off + self._of_prior(whole[0])
        shown, slopes = about_centre(values[:10]), np.empty((10, 10))
        for place, unit in enumerate(np.eye(10)):
            slopes[:, place] = (about_centre(values[:10] + STEP * unit) - shown) / STEP
        errors = np.sqrt(np.diag(slopes @ covariance[:10, :10] @ slopes.T))
        none = np.zeros(len(values))
        return Load(
            trace, frame, float(shown[0]), float(errors[0]), shown[1:4], errors[1:4], shown[4:], errors[4:],
            self.left(none), self.left(values),
        )  # fmt: skip

    def _of_prior(self, gram: np.ndarray) -> np.ndarray:
        """(10 + P, 10 + P) covariance that the prior's own errors leave."""
        free = np.isfinite(self.prior)
        result = np.zeros((len(free), len(free)))
        inverse = np.linalg.inv(gram[np.ix_(free, free)] / self.memory + np.diag(self.prior[free]))
        result[np.ix_(free, free)] = inverse @ (self.prior[free, None] * inverse)
        return result


def _of_load(recording: Recording, hypothesis: Hypothesis, band: Band, body: np.ndarray) -> np.ndarray:
    """(M, n, 10) torque a unit of each parameter of the load, as the log would show it."""
    segment, mechanism = recording.segment, recording.mechanism
    assert isinstance(mechanism, SerialArm)
    torque = mechanism.arm.columns(segment.theta, segment.theta_dot, segment.theta_ddot) @ body
    return band(reported(hypothesis.seen(recording), hypothesis, torque))


def _prior(robot: Description, parameters: Parameters) -> np.ndarray:
    """(10 + F,) information on load and free parameters; without end on what stands as it is."""
    known = base_errors(robot)
    rubs = np.abs(parameters.values[: len(known)])
    rubs[: len(parameters.hypothesis.base.rigid)] = 0.0
    errors = np.zeros(len(parameters.values))
    errors[: len(known)] = np.hypot(known, FRICTION * rubs)
    errors = np.r_[WIDEST, errors[parameters.free]]
    return np.divide(1.0, errors**2, out=np.full(len(errors), np.inf), where=errors > 0)


def _blocks(problem: Problem, columns: list[np.ndarray], residuals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(B, p, p) and (B, p): normal equations of each block in which something moves."""
    split, grams, moments = Split.of(problem), [], []
    for slopes, residual, block in zip(columns, residuals, split.block, strict=True):
        for number in np.unique(block):
            mine = block == number
            grams.append(slopes[mine].T @ slopes[mine])
            moments.append(slopes[mine].T @ residual[mine])
    return np.array(grams), np.array(moments)
