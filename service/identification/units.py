"""Whether positions that are called radians are degrees: of a small motion every angle is one that a joint can have,
and masses of a 57th explain the torque. The masses of the URDF tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from schemas.errors import DataError
from service.identification import fit as solver
from service.identification.fit import Problem
from service.identification.pooled import start
from service.model.mechanism import SerialArm
from service.model.scene import Recording

CLEAR = 0.25  # of the squared residual that is left at most when read as degrees


def refuse_degrees(problem: Problem, files: str) -> None:
    """
    Raises:
        DataError: with the masses of its URDF the arm's torque fits positions in degrees, and not in radians.
    """
    mechanism = problem.recordings[0].mechanism
    if not isinstance(mechanism, SerialArm):
        return
    described = replace(mechanism, asked=False, known=mechanism.arm.weights)
    given = [replace(recording, mechanism=described) for recording in problem.recordings]
    radians, degrees = (_left(problem, one) for one in (given, [_as_degrees(recording) for recording in given]))
    if degrees < CLEAR * radians:
        share = (degrees / radians) ** 0.5
        raise DataError(
            f"{files}: with the masses of the URDF the torque fits positions in degrees, not in rad ({share:.0%} is "
            'left of what is left in rad): say unit = "deg" in the mapping'
        )


def _as_degrees(recording: Recording) -> Recording:
    segment = recording.segment
    angles = {name: np.radians(getattr(segment, name)) for name in ("theta", "theta_dot", "theta_ddot")}
    return replace(recording, segment=replace(segment, **angles))


def _left(problem: Problem, recordings: Sequence[Recording]) -> float:
    """Squared residual of friction, rotors and constant loads alone."""
    one = Problem(recordings, problem.band, problem.sigma, problem.target, problem.rows)
    return solver.fit(one, start(one), iterations=2).cost
