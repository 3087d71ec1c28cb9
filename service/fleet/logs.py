"""Whose logs are these, and of which day?

A robot is a folder: the nearest with a `robot.toml`, else the first below the folder given whose name has no date.
Folders with a date in their names are days. Where recordings in one folder are of several robots, each is one.

The day of a log is the date in its name (2026-01-31, 20260131), in that of a folder, or in the stamps of a recording
(UTC). Where no log of a robot has any, folders below the robot's, or else logs, are its days, in the order of their
names. A log without a date among others that have one has no place.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from drivers.trace import CAPTURE_ENDINGS, CSV_ENDINGS
from drivers.trace.mcap_file import robots_and_start
from schemas.errors import DataError
from schemas.messages import NANOSECONDS

DESCRIPTION = "robot.toml"
ENDINGS = (*CSV_ENDINGS, ".mcap", *CAPTURE_ENDINGS)  # looked for in folders
EARLIEST_NS = 978_307_200 * NANOSECONDS  # 2001: stamps below count from a robot's power-on
_DATE = re.compile(r"(?<!\d)(20\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)(?!\d)")


@dataclass(frozen=True)
class Member:
    """A robot of the fleet. description: its file, None where there is none. days: its logs by day, in order. strays:
    logs whose day is not known."""

    name: str
    description: Path | None
    days: dict[str, list[Path]]
    strays: list[Path]


def members(paths: Sequence[Path], description: Path | None = None) -> list[Member]:
    """The robots whose logs are in `paths`, files and folders. description: of those that have no file of their own.

    Raises:
        DataError: a path that does not exist, a folder without logs.
    """
    found: dict[Path, tuple[Path, list[Path]]] = {}
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: no such file or folder")
        for log in _inside(path) if path.is_dir() else [path]:
            folder = _robot_folder(
                log.absolute(), _undated(path.absolute() if path.is_dir() else path.absolute().parent)
            )
            key = Path(*(part for part in folder.parts if _date(part) is None))
            logs = found.setdefault(key, (folder, []))[1]
            if log not in logs:
                logs.append(log)
    top = Path(os.path.commonpath(found))
    result = []
    for key, (folder, logs) in found.items():
        name = key.relative_to(top).as_posix() if key != top else key.name
        own = folder / DESCRIPTION
        given = own if own.is_file() else description
        result += [_member(*robot, folder, given) for robot in _apart(name or "robot", logs)]
    return sorted(result, key=lambda member: natural(member.name))


def natural(text: str) -> list[tuple[int, int, str]]:
    """A key to sort by: day_2 before day_10."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part]


def _inside(folder: Path) -> list[Path]:
    logs = sorted(path for path in folder.rglob("*") if path.name.endswith(ENDINGS) and path.is_file())
    logs = [path for path in logs if not path.name.startswith(".")]
    if not logs:
        raise DataError(f"{folder}: no logs in it ({', '.join(ENDINGS)})")
    return logs


def _robot_folder(log: Path, root: Path) -> Path:
    for folder in log.parents:
        if (folder / DESCRIPTION).is_file():
            return folder
        if folder == root:
            break
    names = [name for name in log.parent.relative_to(root).parts if _date(name) is None]
    return root / names[0] if names else root


def _undated(folder: Path) -> Path:
    return next((one for one in (folder, *folder.parents) if _date(one.name) is None), folder)


def _apart(name: str, logs: list[Path]) -> list[tuple[str, list[Path], dict[Path, int]]]:
    """(name, logs, start of recordings in ns) of each robot among the logs of a folder."""
    told = {log: robots_and_start(log) or ([], 0) for log in logs if log.name.endswith(".mcap")}
    starts = {log: start for log, (_, start) in told.items()}
    if len({robot for robots, _ in told.values() for robot in robots}) < 2:
        return [(name, logs, starts)]
    each: dict[str, list[Path]] = {}
    for log in logs:
        robots, _ = told.get(log, ([], 0))
        own = re.sub(r"^\.+|[^\w.+-]", "_", robots[0]) if len(robots) == 1 else ""
        each.setdefault(f"{name}/{own}" if own else name, []).append(log)
    return [(robot, own, starts) for robot, own in each.items()]


def _member(name: str, logs: list[Path], starts: dict[Path, int], folder: Path, description: Path | None) -> Member:
    dated = {log: _day(log, starts.get(log, 0)) for log in logs}
    if any(dated.values()):
        strays = [log for log in logs if dated[log] is None]
        labels = {log: day for log, day in dated.items() if day is not None}
    else:
        strays, labels = [], {log: _place(log.absolute(), folder) for log in logs}
    days: dict[str, list[Path]] = {}
    for log in sorted(labels, key=lambda log: (natural(labels[log]), natural(str(log)))):
        days.setdefault(labels[log], []).append(log)
    return Member(name, description, days, strays)


def _day(log: Path, start_ns: int) -> str | None:
    for name in reversed(log.parts):
        found = _date(name)
        if found is not None:
            return found.isoformat()
    if start_ns > EARLIEST_NS:
        return datetime.fromtimestamp(start_ns / NANOSECONDS, UTC).date().isoformat()
    return None


def _place(log: Path, folder: Path) -> str:
    if log.parent != folder and folder in log.parents:
        return log.parent.relative_to(folder).as_posix()
    return log.name.partition(".")[0]


def _date(name: str) -> date | None:
    for year, month, day in _DATE.findall(name):
        with suppress(ValueError):
            return date(int(year), int(month), int(day))
    return None
