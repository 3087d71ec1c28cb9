"""The estimator of a described machine of any kind."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from schemas.axes_description import Description
from schemas.messages import HealthFlag
from schemas.robot import Robot
from service.estimator import left_out as of_delta
from service.estimator.estimator import Estimator, Result, compile_all


class Online(Protocol):
    """What the node asks of an estimator; see `Estimator`. payload, friction: None where there is none."""

    period: float
    stride: int
    feedforward: np.ndarray
    error: np.ndarray

    @property
    def payload(self) -> np.ndarray | None: ...
    @property
    def friction(self) -> np.ndarray | None: ...
    def step(self, message: bytes) -> int: ...
    def look_back(self) -> int: ...
    def run(self, samples: np.ndarray) -> Result: ...
    def plan(self, reference: np.void) -> None: ...
    def findings(self) -> HealthFlag: ...


def estimator_of(description: Description, period: float, stride: int = 1) -> Online:
    """The estimator of a machine, with its identified parameters.

    Raises:
        RobotError: an effect that is not known, or not described in full; a largest torque or speed of a joint of an
            arm or of axes is missing.
        DataError: an arm or axes that were never identified.
    """
    if isinstance(description, Robot):
        return Estimator(description, period, stride)
    from service.estimator.joints.joints_estimator import (
        JointEstimator,  # its model takes a library that a Delta has not
    )

    return JointEstimator(description, period, stride)


def left_out(description: Description, period: float) -> dict[str, str]:
    """Name -> why, of each effect of a description that the estimator does without at a sample every `period` s."""
    if isinstance(description, Robot):
        return of_delta.left_out(description, period)
    from service.estimator.joints import joints_state

    return joints_state.left_out(description)


def compile_estimator(description: Description) -> None:
    """Compile, so that the first live sample is not seconds late.

    Raises:
        RobotError, DataError: see `estimator_of`.
    """
    if isinstance(description, Robot):
        compile_all(description)
        return
    from service.estimator.joints.joints_estimator import JointEstimator

    JointEstimator(description, 1e-3).warm_up()
