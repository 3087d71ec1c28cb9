"""Regressors of the model and their sums over short blocks of a trajectory.

Everything `identify` answers follows from these sums: the fit, its standard errors (blocks left out in turn), the
cross-validation (trajectories left out in turn), the paper's grid, the checks of the data. The samples are passed over
once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from schemas.errors import PoseError, TraceError
from schemas.trace import Trace
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PLATFORM, torque_terms
from service.model.friction import mean_direction
from service.model.kinematics import jacobian
from service.model.nominal import DeltaModel
from service.model.signals import EDGE, Segment, lowpass, noise_density, segments, thin

# Columns of a joint's sums: what the parameters multiply, the platform's known torque, the weight of a kilogram on the
# platform, the torques of joints 1 to 3, and one.
COLUMNS = 11
INERTIA_COLUMN, GRAVITY_COLUMN, FOREARM_COLUMN, VISCOUS_COLUMN, COULOMB_COLUMN, PLATFORM_COLUMN = range(6)
WEIGHT_COLUMN = 6
TORQUE_COLUMN = 7
ONE_COLUMN = 10

# rad/s over which Coulomb friction may turn, to choose from; 0 is a jump. Below 0.5 mrad/s no log tells it from a jump.
TRANSITIONS = (0.0, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3)

BLOCK = 0.5  # s, many times the correlation time of the low-passed noise (12 ms) and about one stroke of a pick


@dataclass(frozen=True)
class Trajectory:
    """What one trace has to say, B blocks of 3 joints. Sums are over moving samples, times the sample time.

    gram: (B, 3, COLUMNS, COLUMNS) products of the low-passed columns. seconds: (B, 3) of motion. density: (3,)
    one-sided white noise of the torque, (N m)^2/Hz. period: s. forward, backward: (3,) s moved in each direction.
    travel: (3,) rad between the extreme angles. rows, unusable: counts. transition: rad/s, over which gram's Coulomb
    column turns. turning: (B, 3, len(TRANSITIONS), COLUMNS + 1), products of the Coulomb column at each of
    `TRANSITIONS` with gram's columns and, last, with itself.
    """

    name: str
    gram: np.ndarray
    seconds: np.ndarray
    density: np.ndarray
    period: float
    forward: np.ndarray
    backward: np.ndarray
    travel: np.ndarray
    rows: int
    unusable: int
    transition: float
    turning: np.ndarray

    def at(self, transition: float) -> Trajectory:
        """The same with Coulomb friction turning over another of `TRANSITIONS`, rad/s."""
        products = self.turning[:, :, TRANSITIONS.index(transition)]
        gram = self.gram.copy()
        gram[..., COULOMB_COLUMN, :] = gram[..., :, COULOMB_COLUMN] = products[..., :COLUMNS]
        gram[..., COULOMB_COLUMN, COULOMB_COLUMN] = products[..., COLUMNS]
        return replace(self, gram=gram, transition=transition)


def regressors(
    model: DeltaModel, theta: np.ndarray, theta_dot: np.ndarray, theta_ddot: np.ndarray, transition: float = 0.0
) -> np.ndarray:
    """(N, 3, 6): inertia, gravity, forearm, theta_dot, its direction and the platform's torque, not yet low-passed.

    transition: rad/s over which the direction turns; 0: sign theta_dot.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    terms = torque_terms(model, theta, theta_dot, theta_ddot)
    way = mean_direction(theta_dot, transition)
    return np.stack(
        [terms[:, INERTIA], terms[:, GRAVITY], terms[:, FOREARM], theta_dot, way, terms[:, PLATFORM]], axis=-1
    )


def summarise(model: DeltaModel, trace: Trace) -> Trajectory:
    """Pass over `trace` once.

    Raises:
        TraceError: nothing usable, or positions that are no pose of the robot, naming the file.
    """
    parts = segments(trace)
    grams: list[np.ndarray] = []
    turning: list[np.ndarray] = []
    for part in parts:
        try:
            gram, turned = _blocks(model, thin(part))
        except PoseError as error:
            raise TraceError(f"{trace.path}: {error}") from error
        grams.append(gram)
        turning.append(turned)
    longest = max(parts, key=lambda part: len(part.rows))
    theta = np.concatenate([part.theta for part in parts])
    theta_dot = np.concatenate([part.theta_dot * part.moving for part in parts])
    gram = np.concatenate(grams)
    return Trajectory(
        name=trace.path.name,
        gram=gram,
        seconds=gram[:, :, ONE_COLUMN, ONE_COLUMN],
        density=noise_density(_without_jumps(longest), longest.period),
        period=longest.period,
        forward=(theta_dot > 0).sum(axis=0) * longest.period,
        backward=(theta_dot < 0).sum(axis=0) * longest.period,
        travel=np.ptp(theta, axis=0),
        rows=len(trace),
        unusable=len(trace) - sum(len(part.rows) for part in parts),
        transition=0.0,
        turning=np.concatenate(turning),
    )


def _without_jumps(segment: Segment) -> np.ndarray:
    """Torque (M, 3) less Coulomb friction, which alone of the model reaches the band where noise is measured."""
    direction = np.sign(segment.theta_dot)
    step = np.diff(direction, axis=0)
    turns = np.maximum((step**2).sum(axis=0), 1.0)
    return segment.torque - direction * (np.diff(segment.torque, axis=0) * step).sum(axis=0) / turns


def _blocks(model: DeltaModel, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    count = len(segment.time)
    columns = np.empty((count, 3, COLUMNS))
    columns[:, :, :WEIGHT_COLUMN] = regressors(model, segment.theta, segment.theta_dot, segment.theta_ddot)
    columns[:, :, WEIGHT_COLUMN] = model.gravity * jacobian(model, segment.theta)[:, 2]
    columns[:, :, :TORQUE_COLUMN] = lowpass(columns[:, :, :TORQUE_COLUMN], segment.period)
    columns[:, :, TORQUE_COLUMN:ONE_COLUMN] = lowpass(segment.torque, segment.period)[:, None, :]
    columns[:, :, ONE_COLUMN] = 1.0
    ways = [lowpass(mean_direction(segment.theta_dot, transition), segment.period) for transition in TRANSITIONS[1:]]
    ways = np.stack([columns[:, :, COULOMB_COLUMN], *ways], axis=-1)
    edge = round(EDGE / segment.period)
    inner = count - 2 * edge
    blocks = max(1, round(inner * segment.period / BLOCK))
    bounds = edge + np.linspace(0, inner, blocks + 1).astype(int)
    gram = np.zeros((blocks, 3, COLUMNS, COLUMNS))
    turning = np.zeros((blocks, 3, len(TRANSITIONS), COLUMNS + 1))
    for block, (start, stop) in enumerate(pairwise(bounds)):
        for joint in range(3):
            moving = segment.moving[start:stop, joint]
            moved, way = columns[start:stop, joint][moving], ways[start:stop, joint][moving]
            gram[block, joint] = moved.T @ moved
            turning[block, joint, :, :COLUMNS] = way.T @ moved
            turning[block, joint, :, COLUMNS] = (way**2).sum(axis=0)
    return gram * segment.period, turning * segment.period
