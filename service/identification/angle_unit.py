"""Whether positions that are called radians are degrees, or the other way round: of a small motion every angle is one
that a joint can have, and masses of a 57th explain the torque. A Delta's geometry tells, an arm's masses by its URDF.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from schemas.errors import DataError
from schemas.words import percent
from service.identification import fit as solver
from service.identification.fit import Fit, Problem
from service.identification.pooled import start
from service.model.scene import Recording

CLEAR = 0.25  # of the squared residual that is left at most when read as degrees
WELL = 0.05  # of a Delta's torque, rms: so little is left by positions in radians alone
MOVES = 0.02  # rad of travel below which no joint of a Delta moves to speak of
FAIRLY = 0.2  # of the torque, rms, that positions in degrees leave at most: else neither fits


def refuse_wrong_angles(problem: Problem, files: str, fitted: Fit) -> None:
    """fitted: the plain model.

    Raises:
        DataError: no joint of a Delta moves to speak of, or the torque fits positions in degrees and not in radians.
    """
    mechanism, given = problem.recordings[0].mechanism, list(problem.recordings)
    torque = sum(float(np.sum(problem.select(n, target) ** 2)) for n, target in enumerate(problem.target))
    described = mechanism.as_described()
    if described is not None:
        given = [replace(recording, mechanism=described) for recording in given]
        radians, tells = _left(problem, given), "with the masses of the description "
    elif mechanism.closed:
        radians, tells = fitted.cost, ""
        travel = max(float(np.ptp(recording.segment.theta, axis=0).max()) for recording in given)
        if travel < MOVES:
            raise DataError(f"{files}: no joint moves further than {travel:.2g} rad: are positions in another unit?")
        if radians < WELL**2 * torque:
            return
    else:
        return
    degrees = _left(problem, [_as_degrees(recording) for recording in given])
    if degrees < min(CLEAR * radians, FAIRLY**2 * torque):
        share = (degrees / radians) ** 0.5
        raise DataError(
            f"{files}: {tells}the torque fits positions in degrees, not in rad (residual "
            f'{percent(share)} of that in rad): state unit = "deg" in the mapping'
        )


def _as_degrees(recording: Recording) -> Recording:
    segment = recording.segment
    angles = {name: np.radians(getattr(segment, name)) for name in ("theta", "theta_dot", "theta_ddot")}
    return replace(recording, segment=replace(segment, **angles))


def _left(problem: Problem, recordings: Sequence[Recording]) -> float:
    """Squared residual of friction, rotors and constant loads alone."""
    one = Problem(recordings, problem.band, problem.sigma, problem.target, problem.rows)
    return solver.fit(one, start(one), iterations=2).cost
