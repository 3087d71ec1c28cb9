"""What callers hand over: a wrong kind of thing is one line, like anything else that is wrong."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import schemas.trace as recorded
from schemas.errors import DataError
from schemas.robot import Described

Traces = recorded.Trace | Iterable[recorded.Trace]
_Kind = TypeVar("_Kind", bound=Described)


def as_path(path: Any) -> Path:
    """
    Raises:
        DataError: it is no path.
    """
    if not isinstance(path, str | Path):
        raise DataError(f"{_shown(path)}: a path is needed, as a str or a Path")
    return Path(path)


def described(robot: _Kind, what: str = "robot") -> _Kind:
    """
    Raises:
        DataError: it is no description.
    """
    if not isinstance(robot, Described):
        raise DataError(f"{what}: {_shown(robot)} is not a description; read it with deltatwin.load_robot")
    return robot


def as_list(traces: Traces, least: int = 1) -> list[recorded.Trace]:
    """One trace, or several, as a list.

    Raises:
        DataError: fewer than `least`, or what is no trace, naming it.
    """
    found: list[recorded.Trace] = []
    for one in traces if isinstance(traces, Iterable) else [traces]:
        if not isinstance(one, recorded.Trace):
            raise DataError(f"{_shown(one)} is not a trace; read it with deltatwin.read_trace")
        found.append(one)
    if len(found) < least:
        raise DataError("no trace is given")
    return found


def logs_of(robot: Described, traces: Traces, least: int = 1) -> list[recorded.Trace]:
    """Traces of the machine that `robot` describes, as a list.

    Raises:
        DataError: as `as_list`; one with another number of joints, or in m where these turn.
    """
    found = as_list(traces, least)
    for one in found:
        joints = one.position.shape[1]
        if joints != robot.count or one.angular != robot.angular:
            unit = {True: "rad", False: "m"}
            raise DataError(
                f"{one.path}: {joints} joints in {unit[one.angular]}, but {robot.name} has {robot.count} in "
                f"{unit[robot.angular]}"
            )
    return found


def _shown(thing: object) -> str:
    text = repr(thing)
    return text if len(text) < 80 else f"a {type(thing).__name__}"
