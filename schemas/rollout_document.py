"""The document of `rollout`: the gap as motion."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from schemas.diagnosis import DocumentPart
from schemas.robot import Servo


class Reached(DocumentPart):
    """Rms of simulated less measured motion of one robot over the windows that stayed in the workspace.

    joint_mrad, platform_mm: at the horizon. growth_mm: of the platform, at the document's `times_s`. ran_away: windows
    that left the workspace. left_out: effects of the description that the simulation does without. torque_nm: rms over
    the windows, where commands went in.
    """

    robot: str
    joint_mrad: list[float | None]
    platform_mm: float | None
    growth_mm: list[float | None]
    ran_away: int
    left_out: list[str]
    torque_nm: list[float | None] = []


class RegimeReached(DocumentPart):
    """Rms of a joint (from 1), mrad at the horizon, over the windows of one kind of its motion; one figure a robot."""

    joint: int
    regime: str
    windows: int
    joint_mrad: dict[str, float | None]


class LogInterruption(DocumentPart):
    """From when to when, s of its clock, a log has no samples, or none that are of use."""

    trace: str
    from_s: float
    until_s: float


class RolloutDocument(DocumentPart):
    """Simulated robots under recorded torque, or under recorded commands through the drives of `servo`.

    floor: what torque noise and start state make of the last robot alone.

    payload_kg: what hangs on all of them, one a window. untold_s: left out as that could not be told. windows_lost:
    what `interruptions` cost. path_mm: rms way of the measured platform. seconds: of the logs; used_s: in windows.
    over_identified: of the last robot, a joint, rms torque that it does not explain here, empty, over that of the
    logs it was identified on; null: the joint never moves so, or the description does not say.
    """

    schema_: Literal["deltatwin.rollout/1"] = Field("deltatwin.rollout/1", alias="schema")
    traces: list[str]
    horizon_s: float
    windows: int
    payload_kg: list[float]
    untold_s: float
    interruptions: list[LogInterruption]
    windows_lost: int
    seconds: float
    used_s: float
    path_mm: float
    over_identified: list[float | None] | None
    times_s: list[float]
    robots: list[Reached]
    floor: Reached
    regimes: list[RegimeReached]
    servo: Servo | None = None
