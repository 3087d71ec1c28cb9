"""The estimator of a described machine of any kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from schemas.axes_description import Axes, Description
from schemas.chain_description import Chain
from schemas.messages import OF_DELTA, OF_JOINTS, HealthFlag, Topics
from schemas.robot import Robot
from service.estimator import left_out as of_delta
from service.estimator.bounds import assumed_limit
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


class _Ways(Protocol):
    """How machines whose samples come in messages of one kind are estimated; see the functions below."""

    @property
    def said(self) -> tuple[str, ...]: ...
    def estimator(self, description: Any, period: float, stride: int) -> Online: ...
    def left_out(self, description: Any, period: float) -> dict[str, str]: ...
    def compile(self, description: Any) -> None: ...
    def assumed(self, description: Any, file: Path) -> list[str]: ...


class _OfPlatforms:
    """Of a Delta, whose friction is learnt while it runs."""

    said = ("friction",)

    def estimator(self, description: Robot, period: float, stride: int) -> Online:
        return Estimator(description, period, stride)

    def left_out(self, description: Robot, period: float) -> dict[str, str]:
        return of_delta.left_out(description, period)

    def compile(self, description: Robot) -> None:
        compile_all(description)

    def assumed(self, description: Robot, file: Path) -> list[str]:
        said = []
        if description.identified is None:
            said.append(f"{file}: no [identified] parameters: friction is zero and rho 1; run `deltatwin identify`")
        if description.limits.peak_torque_nm is None:
            said.append(assumed_limit(file, description))
        return said


class _OfJoints:
    """Of arms and axes, whose model takes a library that a Delta has not, so that it is imported where it is needed.
    Nothing is assumed of them: what is missing is an error."""

    said = ()

    def estimator(self, description: Axes | Chain, period: float, stride: int) -> Online:
        from service.estimator.joints.joints_estimator import JointEstimator

        return JointEstimator(description, period, stride)

    def left_out(self, description: Axes | Chain, period: float) -> dict[str, str]:
        from service.estimator.joints import joints_state

        return joints_state.left_out(description)

    def compile(self, description: Axes | Chain) -> None:
        from service.estimator.joints.joints_estimator import JointEstimator

        JointEstimator(description, 1e-3).warm_up()

    def assumed(self, description: Axes | Chain, file: Path) -> list[str]:
        return []


_WAYS: dict[Topics, _Ways] = {OF_DELTA: _OfPlatforms(), OF_JOINTS: _OfJoints()}


def estimator_of(description: Description, period: float, stride: int = 1) -> Online:
    """The estimator of a machine, with its identified parameters.

    Raises:
        RobotError: an effect that is not known, or not described in full; a largest torque or speed of a joint of an
            arm or of axes is missing.
        DataError: an arm or axes that were never identified.
    """
    return _WAYS[description.topics].estimator(description, period, stride)


def left_out(description: Description, period: float) -> dict[str, str]:
    """Name -> why, of each effect of a description that the estimator does without at a sample every `period` s."""
    return _WAYS[description.topics].left_out(description, period)


def compile_estimator(description: Description) -> None:
    """Compile, so that the first live sample is not seconds late.

    Raises:
        RobotError, DataError: see `estimator_of`.
    """
    _WAYS[description.topics].compile(description)


def assumed(description: Description, file: Path) -> list[str]:
    """What the estimator assumes where the description in `file` does not say, a sentence each."""
    return _WAYS[description.topics].assumed(description, file)


def said_beside(description: Description) -> tuple[str, ...]:
    """Topics of what `Online.findings` fills, besides those that all kinds of machine have."""
    return _WAYS[description.topics].said
