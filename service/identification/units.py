"""Whether positions that are called radians are degrees: of a small motion every angle is one that a joint can have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from schemas.errors import DataError
from service.identification import fit as solver
from service.identification.checks import FOREIGN_LEFT
from service.identification.fit import Problem
from service.identification.pooled import Plain, start

CLEAR = 0.25  # of the squared residual that is left at most when read as degrees


def refuse_degrees(plain: Plain, files: str) -> None:
    """
    Raises:
        DataError: the arm's torque fits positions that are taken for degrees, and not as they are.
    """
    problem = plain.problem
    if problem.recordings[0].mechanism.kind != "chain" or not _suspect(plain):
        return
    scaled = [
        replace(
            recording,
            segment=replace(
                recording.segment,
                theta=np.radians(recording.segment.theta),
                theta_dot=np.radians(recording.segment.theta_dot),
                theta_ddot=np.radians(recording.segment.theta_ddot),
            ),
        )
        for recording in problem.recordings
    ]
    smaller = Problem(scaled, problem.band, problem.sigma, problem.target, problem.rows)
    costs = [solver.fit(one, start(one), iterations=2).cost for one in (problem, smaller)]
    if costs[1] < CLEAR * costs[0]:
        share = 100 * (costs[1] / costs[0]) ** 0.5
        raise DataError(
            f"{files}: the arm's torque fits positions in degrees, not in rad: {share:.0f} % of what is left in rad; "
            'say unit = "deg" in the mapping'
        )


def _suspect(plain: Plain) -> bool:
    return bool(np.mean(plain.residual**2 / plain.noise_floor**2) > FOREIGN_LEFT**2)
