"""The documents that `fleet` writes: `day.json` of each robot and day, `fleet.json` over all of them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from schemas.diagnosis import DocumentPart, Moved, NamedEffect, Provenance, Verdict

ChangeKind = Literal["effect", "parameter", "unexplained", "risen"]


class LogResult(DocumentPart):
    """A log: rms a joint of measured minus predicted torque by the robot's reference, None for a joint at rest; or why
    it could not be used."""

    log: str
    rms_nm: list[float | None] = []
    error: str | None = None


class DayResult(DocumentPart):
    """A robot on a day. made_of: SHA-256 over all that went in. verdict: None where it could not be judged, for
    `error`. gap_nm, after_nm, torque_nm: rms over the joints, in `unit`, of the gap to the reference, of what the
    effects leave of it, and of the torque. The whole diagnosis is in diagnosis.json beside it."""

    made_of: str
    robot: str
    day: str
    logs: list[LogResult] = []
    error: str | None = None
    verdict: Verdict | Literal["cannot_tell"] | None = None
    effects: list[NamedEffect] = []
    moved: dict[str, Moved] = {}
    cannot_tell: list[str] = []
    gap_nm: float | None = None
    after_nm: float | None = None
    torque_nm: float | None = None
    unit: str = "N m"

    @property
    def judged(self) -> bool:
        """Whether it counts for or against anything."""
        return self.verdict not in (None, "cannot_tell")

    @property
    def gap_percent(self) -> float | None:
        """The gap, of the torque."""
        return 100 * self.gap_nm / self.torque_nm if self.gap_nm is not None and self.torque_nm else None


class Change(DocumentPart):
    """Something that a robot has and its reference has not, or that it has come further from it (`risen`). joints from
    1; empty where it sits on no single one.

    since: the first day on which it was found; not_on: the last judged day before, None where there is none: it may be
    as old as the robot. last: the last day with it; gone: it was judged again after that. days: how many have it, of:
    how many were judged from `since` on. first, now: how much there was on the first day and on the last.
    """

    kind: ChangeKind
    name: str
    title: str
    joints: list[int] = []
    since: str
    not_on: str | None
    last: str
    gone: bool
    days: int
    of: int
    first: list[str] = []
    now: list[str] = []
    means: str = ""


class RobotHistory(DocumentPart):
    """A robot over its days. reference: the description all days are judged against; reference_of: the day it was
    identified on, None where it was given. strays: logs whose day is not known. error: why nothing could be judged."""

    robot: str
    reference: str | None = None
    reference_of: str | None = None
    error: str | None = None
    strays: list[LogResult] = []
    days: list[DayResult] = []
    changes: list[Change] = []

    @property
    def compared(self) -> bool:
        """Whether a day other than that of its reference was judged: without one nothing can have changed."""
        return any(day.judged and day.day != self.reference_of for day in self.days)

    @property
    def unusable(self) -> list[tuple[str, str]]:
        """(log, day or robot; why) of all that could not be used."""
        days = [(f"{self.robot}, {day.day}", day.error) for day in self.days if day.error and not self.error]
        logs = [(log.log, log.error) for log in (*self.strays, *(log for day in self.days for log in day.logs))]
        return [(what, why) for what, why in [(self.robot, self.error), *days, *logs] if why]


class Fleet(DocumentPart):
    """All robots."""

    schema_: Literal["deltatwin.fleet/1"] = Field("deltatwin.fleet/1", alias="schema")
    made: Provenance
    robots: list[RobotHistory]
