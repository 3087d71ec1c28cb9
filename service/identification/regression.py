"""Sums of a log's torque and of what the plain model's parameters multiply, over short blocks: what the checks of the
data and the paper's grid need. The samples are passed over once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from schemas.errors import PoseError, TraceError
from schemas.trace import Trace
from service.identification.folds import BLOCK
from service.identification.held import held_s
from service.identification.loops import position_errors
from service.identification.torque_source import is_commanded
from service.model.kinematics import jacobian
from service.model.mechanism import Delta
from service.model.nominal import DeltaModel
from service.model.scene import Recording
from service.model.signals import EDGE, lowpass, segments, thin

# Columns of a joint's sums: what the parameters multiply, the platform's known torque, the weight of a kilogram on the
# platform, the torques of joints 1 to 3, and one.
COLUMNS = 11
INERTIA_COLUMN, GRAVITY_COLUMN, FOREARM_COLUMN, VISCOUS_COLUMN, COULOMB_COLUMN, PLATFORM_COLUMN = range(6)
WEIGHT_COLUMN = 6
TORQUE_COLUMN = 7
ONE_COLUMN = 10

# of a Delta's parameters, in the order of `base_parameters`
PARAMETERS = 9
RHO_1, RHO_2, FOREARM_MASS = range(3)
VISCOUS, COULOMB = slice(3, 6), slice(6, 9)


@dataclass(frozen=True)
class NormalEquations:
    """What one trace has to say, B blocks of 3 joints. Sums are over moving samples, times the sample time.

    gram: (B, 3, COLUMNS, COLUMNS) products of the low-passed columns. recordings: the parts that no fault interrupts.
    commanded: whether the reported torque is the commanded one and white noise. position_errors: (N, 3) rad a
    recording, none without commands. held: s for which each torque stood in the log, 0 where it did not.
    """

    name: str
    gram: np.ndarray
    recordings: list[Recording]
    commanded: bool = False
    position_errors: Sequence[np.ndarray] = ()
    held: float = 0.0

    @property
    def seconds(self) -> np.ndarray:
        """(B, 3) s of motion."""
        return self.gram[:, :, ONE_COLUMN, ONE_COLUMN]


def summarise(model: DeltaModel, trace: Trace) -> NormalEquations:
    """Pass over `trace` once.

    Raises:
        TraceError: nothing usable, or positions that are no pose of the robot, naming the file.
    """
    mechanism = Delta(model, np.ones(3))
    parts = segments(trace)
    recordings = [Recording(thin(part), mechanism, 0, trace.path.name) for part in parts]
    try:
        gram = products(model, recordings)
    except PoseError as error:
        raise TraceError(f"{trace.path}: {error}") from error
    errors = position_errors(recordings, [trace])
    return NormalEquations(trace.path.name, gram, recordings, is_commanded(trace), errors, held_s(parts))


def regressors(recording: Recording) -> np.ndarray:
    """(N, 3, 6): inertia, gravity, forearm, theta_dot, its sign and the platform's torque, not yet low-passed.

    Raises:
        PoseError: unreachable or singular, naming the angles.
    """
    speed, rigid = recording.segment.theta_dot[..., None], recording.rigid
    return np.concatenate([rigid.columns, speed, np.sign(speed), rigid.known[..., None]], axis=-1)


def products(model: DeltaModel, recordings: Sequence[Recording]) -> np.ndarray:
    """(B, 3, COLUMNS, COLUMNS) of a log, see `NormalEquations`.

    Raises:
        PoseError: positions that are no pose of the robot.
    """
    return np.concatenate([_blocks(model, recording) for recording in recordings])


def _blocks(model: DeltaModel, recording: Recording) -> np.ndarray:
    segment = recording.segment
    count = len(segment.time)
    columns = np.empty((count, 3, COLUMNS))
    columns[:, :, :WEIGHT_COLUMN] = regressors(recording)
    columns[:, :, WEIGHT_COLUMN] = -model.gravity @ jacobian(model, segment.theta)
    columns[:, :, :TORQUE_COLUMN] = lowpass(columns[:, :, :TORQUE_COLUMN], segment.period)
    columns[:, :, TORQUE_COLUMN:ONE_COLUMN] = lowpass(segment.torque, segment.period)[:, None, :]
    columns[:, :, ONE_COLUMN] = 1.0
    edge = round(EDGE / segment.period)
    inner = count - 2 * edge
    blocks = max(1, round(inner * segment.period / BLOCK))
    bounds = edge + np.linspace(0, inner, blocks + 1).astype(int)
    gram = np.zeros((blocks, 3, COLUMNS, COLUMNS))
    for block, (start, stop) in enumerate(pairwise(bounds)):
        for joint in range(3):
            moved = columns[start:stop, joint][segment.moving[start:stop, joint]]
            gram[block, joint] = moved.T @ moved
    return gram * segment.period


def selection(joint: int) -> np.ndarray:
    """(COLUMNS, 9): the columns of `joint` that each parameter multiplies."""
    chosen = np.zeros((COLUMNS, PARAMETERS))
    for column, parameter in (
        (INERTIA_COLUMN, RHO_1),
        (GRAVITY_COLUMN, RHO_2),
        (FOREARM_COLUMN, FOREARM_MASS),
        (VISCOUS_COLUMN, VISCOUS.start + joint),
        (COULOMB_COLUMN, COULOMB.start + joint),
    ):
        chosen[column, parameter] = 1.0
    return chosen


def target(joint: int) -> np.ndarray:
    """(COLUMNS,): torque less the platform's."""
    chosen = np.zeros(COLUMNS)
    chosen[TORQUE_COLUMN + joint], chosen[PLATFORM_COLUMN] = 1.0, -1.0
    return chosen


def information(gram: np.ndarray) -> np.ndarray:
    """(..., 9, 9) of grams (..., 3, COLUMNS, COLUMNS), joints weighing alike."""
    chosen = np.stack([selection(joint) for joint in range(3)])
    return np.einsum("jap,...jab,jbq->...pq", chosen, gram, chosen, optimize=True)


def rms_residual(log: NormalEquations, parameters: np.ndarray) -> np.ndarray:
    """(3,) N m rms of what `parameters` (9,) leave of a trajectory's moving samples, friction turning in a jump."""
    left = np.stack([target(joint) - selection(joint) @ parameters for joint in range(3)])
    squares = np.maximum(np.einsum("ja,jab,jb->j", left, log.gram.sum(axis=0), left), 0.0)
    seconds = log.seconds.sum(axis=0)
    return np.sqrt(squares / np.where(seconds > 0, seconds, np.inf))
