"""The document of a finding, `finding.json`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from schemas.diagnosis import Diagnosis, DocumentPart


class WatchFinding(DocumentPart):
    """What has changed in a robot: since when, where, which effect, how much.

    since_s: s of bus time, 1970 where the bus keeps that. joints: from 1, in which the gap has risen. before_nm,
    after_nm, left_nm, floor_nm: rms in the analysis band, N m a joint: before, since, what the named effects leave, and
    the torque's noise. compared: whether there was motion from before to compare with; else the effects are what the
    description lacks. text: the finding in one line.
    """

    schema_: Literal["deltatwin.finding/1"] = Field("deltatwin.finding/1", alias="schema")
    robot: str
    since_s: float
    until_s: float
    joints: list[int]
    before_nm: list[float]
    after_nm: list[float]
    left_nm: list[float]
    floor_nm: list[float]
    compared: bool
    text: str
    diagnosis: Diagnosis
