"""The load that an arm carries all through a log: mass, centre of mass and inertia on a frame, from what it adds to the
torque of the identified arm. The fit is that of `machines.load`, in the band of the log, with effects and everything
else that a description says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from schemas.axes_description import Description
from schemas.errors import DataError
from schemas.trace import Trace
from service.identification.fit import Problem, evaluate
from service.identification.folds import Split
from service.machines import machine_of
from service.machines.load_fit import SCARCE, WIDEST, Blocks, Body, body_from, information_of
from service.model.description import hypothesis_of
from service.model.hypothesis import Hypothesis
from service.model.parameters import Parameters
from service.model.scene import Recording
from service.model.signals import Band, one_period, resolved_hz, segments_of, thin
from service.model.torque import reported

AXES = ("xx", "xy", "yy", "xz", "yz", "zz")


@dataclass(frozen=True, kw_only=True)
class Load(Body):
    """The load of a log. before, after: (n,) rms N m of the torque that is left in the analysis band without and with
    it, while a joint moves."""

    trace: str
    frame: str
    before: np.ndarray
    after: np.ndarray


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
    if robot.identified is None:
        raise DataError(
            f"robot {robot.name}: no [identified] parameters: run `deltatwin identify` on its logs without payload"
        )
    (parts,) = segments_of([trace])
    recordings = [Recording(thin(part), mechanism, 0, trace.name) for part in parts]
    period = one_period([(one.name, one.segment) for one in recordings])
    band = Band.of(period, resolved_hz([one.segment for one in recordings]))
    fitted = _Fit.of(robot, recordings, band, body)
    if len(fitted.blocks.grams) < SCARCE:
        raise DataError(f"{trace.path}: too little motion to estimate the payload: {len(fitted.blocks.grams) / 2:g} s")
    return fitted.load(trace.name, named)


@dataclass(frozen=True)
class _Fit:
    """Load and base parameters together, in units of what is left of each joint's torque."""

    problem: Problem
    columns: list[np.ndarray]
    residuals: list[np.ndarray]
    blocks: Blocks

    @classmethod
    def of(cls, robot: Description, recordings: list[Recording], band: Band, body: np.ndarray) -> _Fit:
        """Of a description's hypothesis on recordings. body: (10 n, 10)."""
        equal = cls._weighed(robot, recordings, band, body, np.ones(recordings[0].mechanism.joints))
        sigma = equal.left(equal.blocks.solved(*equal.blocks.whole))
        made = cls._weighed(robot, recordings, band, body, np.maximum(sigma, 1e-9))
        return replace(made, blocks=replace(made.blocks, memory=made.blocks.remembers()))

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
        blocks = Blocks(*_blocks(problem, columns, found.residuals), _prior(robot, hypothesis))
        return cls(problem, columns, found.residuals, blocks)

    def left(self, values: np.ndarray) -> np.ndarray:
        """(n,) N m rms."""
        return self.problem.rms([r - c @ values for r, c in zip(self.residuals, self.columns, strict=True)])[0]

    def load(self, trace: str, frame: str) -> Load:
        """The load and its errors."""
        blocks = self.blocks
        values, none = blocks.solved(*blocks.whole), np.zeros(len(blocks.prior))
        random, common = blocks.covariances(np.array(list(blocks.without_each())))
        body = body_from(values[:10], random[:10, :10], common[:10, :10])
        return Load(**vars(body), trace=trace, frame=frame, before=self.left(none), after=self.left(values))


def _of_load(recording: Recording, hypothesis: Hypothesis, band: Band, body: np.ndarray) -> np.ndarray:
    """(M, n, 10) torque a unit of each parameter of the load, as the log would show it."""
    segment, tree = recording.segment, recording.mechanism.tree
    assert tree is not None
    torque = tree.arm.columns(segment.theta, segment.theta_dot, segment.theta_ddot) @ body
    return band(reported(hypothesis.seen(recording), hypothesis, torque))


def _prior(robot: Description, hypothesis: Hypothesis) -> np.ndarray:
    """(10 + F,) information on load and free parameters; without end on what stands as it is."""
    parameters, known = Parameters(hypothesis), information_of(robot, hypothesis.base)
    every = np.full(len(parameters.values), np.inf)
    every[: len(known)] = known
    return np.r_[1.0 / WIDEST**2, every[parameters.free]]


def _blocks(problem: Problem, columns: list[np.ndarray], residuals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(B, p, p) and (B, p): normal equations of each block in which something moves."""
    split, grams, moments = Split.of(problem), [], []
    for slopes, residual, block in zip(columns, residuals, split.block, strict=True):
        for number in np.unique(block):
            mine = block == number
            grams.append(slopes[mine].T @ slopes[mine])
            moments.append(slopes[mine].T @ residual[mine])
    return np.array(grams), np.array(moments)
