"""Each robot's reference, each robot's day. A result carries a hash of all that went into it: what has one that still
holds is not worked out again, so that a run that was stopped goes on."""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from drivers.trace import find_columns, read_trace
from schemas.axes_description import Description, load_description, save_description
from schemas.diagnosis import Provenance
from schemas.errors import DataError, DeltatwinError, StorageError
from schemas.files import MIB, make_folder, opened, read_bytes, write_text
from schemas.fleet_document import DayResult, Fleet, LogResult, RobotHistory
from schemas.robot import robot_file
from schemas.trace import Trace
from service.diagnosis.documents.document import document
from service.diagnosis.documents.text import caution, unasked
from service.diagnosis.pipeline import diagnose
from service.fleet.changes import changes
from service.fleet.logs import Member
from service.identification.evaluation import evaluate
from service.identification.of_logs import identify_logs
from service.model.effects import catalogue

MOST_OF_A_DAY = 64 * MIB  # bytes of a day's result
NOT_PLACED = (
    "neither its name nor its stamps have a date, while other logs of this robot have one: when was it recorded?"
)


@dataclass(frozen=True)
class Settings:
    """What is the same for all robots. out: folder of the results. columns, effects: as for `diagnose`."""

    out: Path
    columns: str | None = None
    effects: Path | None = None

    def folder(self, robot: Member) -> Path:
        return self.out / "robots" / robot.name


def survey(robots: Sequence[Member], settings: Settings, done: Callable[[], None]) -> Fleet:
    """Judge all days of all robots, on the joblib backend in force. done: called after each robot's reference and each
    day. What fails is told in its place and ends nothing.

    Raises:
        StorageError: a result cannot be written.
    """

    def each(work: Iterable[Any]) -> Iterator[Any]:
        for result in joblib.Parallel(return_as="generator")(work) or ():
            done()
            yield result

    begun = list(each(joblib.delayed(_reference)(robot, settings) for robot in robots))
    pairs = list(zip(robots, begun, strict=True))
    for _ in each(joblib.delayed(_judge)(robot, day, known, settings) for robot, known in pairs for day in robot.days):
        pass
    made = Provenance(at=datetime.now(UTC).isoformat(timespec="seconds"), version=version("deltatwin"), inputs={})
    histories = [_history(robot, known, settings) for robot, known in pairs]
    return Fleet(schema="deltatwin.fleet/1", made=made, robots=histories)


def _history(robot: Member, known: RobotHistory, settings: Settings) -> RobotHistory:
    days = [day for label in robot.days if (day := _kept(settings.folder(robot) / label / "day.json"))]
    strays = [LogResult(log=str(log), error=NOT_PLACED) for log in robot.strays]
    return known.model_copy(update={"days": days, "changes": changes(days), "strays": strays})


def _reference(robot: Member, settings: Settings) -> RobotHistory:
    """The description as given where it carries figures, else identified on the first day on which that is possible."""
    try:
        path, day = _identified(robot, settings)
        return RobotHistory(robot=robot.name, reference=str(path), reference_of=day)
    except StorageError:
        raise
    except Exception as error:  # one robot must not lose the others
        return RobotHistory(robot=robot.name, error=_said(error))


def _identified(robot: Member, settings: Settings) -> tuple[Path, str | None]:
    if robot.description is None:
        raise DataError(f"{robot.name}: no robot.toml in its folder, and no --robot")
    description = load_description(robot.description, settings.effects)
    if description.identified is not None:
        return robot_file(robot.description), None
    folder = settings.folder(robot)
    path, note = folder / "identified.toml", folder / "reference.json"
    make_folder(folder)
    first, tried = "", list[Path]()
    for day, logs in robot.days.items():
        tried += logs
        state = {"made_of": _digest([*_sources(robot, settings), *tried]), "day": day}
        with suppress(StorageError, ValueError):
            if json.loads(read_bytes(note, MIB, StorageError)) == state | {"identified": _digest([path])}:
                return path, day
        try:
            read = list(_read(logs, description, settings.columns))
            traces = [one for one in read if isinstance(one, Trace)]
            if not traces:
                raise DataError(f"none of its {len(logs)} logs can be read; {read[0]}")
            found, _ = identify_logs(description, traces)
            save_description(found.robot, path, template=robot.description)
        except StorageError:
            raise
        except DeltatwinError as error:
            first = first or f"{day}: {error}"
            continue
        write_text(note, json.dumps(state | {"identified": _digest([path])}))
        return path, day
    raise DataError(f"{robot.name}: could not be identified on any day; {first}")


def _judge(robot: Member, day: str, known: RobotHistory, settings: Settings) -> None:
    """Write `day.json` and `diagnosis.json` of a robot's day, where they are not there already."""
    folder, logs = settings.folder(robot) / day, robot.days[day]
    reference = Path(known.reference) if known.reference else None
    made_of = _digest([*_sources(robot, settings), *([reference] if reference else []), *logs])
    kept = _kept(folder / "day.json")
    if kept is not None and kept.made_of == made_of:
        return
    make_folder(folder)
    found: dict[str, Any] = {}
    try:
        if robot.description is None or reference is None:
            raise DataError(known.error or "no reference")
        description, identified = (load_description(p, settings.effects) for p in (robot.description, reference))
        found["logs"], traces = [], []
        for path, one in zip(logs, _read(logs, description, settings.columns), strict=True):
            result = _evaluated(path, identified, one)
            found["logs"].append(result)
            if isinstance(one, Trace) and result.error is None:
                traces.append(one)
        if not traces:
            raise DataError("none of its logs can be used")
        diagnosis = document(diagnose(description, traces, catalogue(settings.effects), baseline=identified))
        write_text(folder / "diagnosis.json", diagnosis.model_dump_json(indent=1, by_alias=True))
        gap = diagnosis.gap
        found |= {
            "verdict": "cannot_tell" if unasked(diagnosis) else diagnosis.verdict,
            "effects": diagnosis.effects, "moved": diagnosis.moved, "unit": gap.unit,
            "cannot_tell": [caution(one) for one in diagnosis.cannot_tell],
            "gap_nm": _rms(gap.before_nm), "after_nm": _rms(gap.after_nm), "torque_nm": _rms(gap.torque_nm),
        }  # fmt: skip
    except StorageError:
        raise
    except Exception as error:  # one broken day must not lose the others
        found["error"] = _said(error)
    result = DayResult(made_of=made_of, robot=robot.name, day=day, **found)
    write_text(folder / "day.json", result.model_dump_json(indent=1))
    _give_back()


def _give_back() -> None:
    """Free memory to the system: every thread's share of it is as large as its largest day, and the C library keeps it
    where it is not asked. Other systems' libraries cannot be asked."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _evaluated(path: Path, identified: Description, trace: Trace | Exception) -> LogResult:
    """How far the reference, in its fullest form, is off on a log."""
    try:
        if isinstance(trace, Exception):
            raise trace
        rms = list(evaluate(identified, trace).errors.values())[-1].rms
    except Exception as error:  # one broken log must not lose the others
        return LogResult(log=str(path), error=_said(error))
    return LogResult(log=str(path), rms_nm=[float(value) if np.isfinite(value) else None for value in rms])


def _read(logs: Sequence[Path], description: Description, columns: str | None) -> Iterator[Trace | Exception]:
    """Each log, or why there is none."""
    mapping = find_columns(columns) if columns else None
    for path in logs:
        try:
            yield read_trace(path, description, mapping)
        except Exception as error:  # whatever a foreign file does to a reader
            yield error


def _kept(path: Path) -> DayResult | None:
    with suppress(StorageError, ValueError):
        return DayResult.model_validate_json(read_bytes(path, MOST_OF_A_DAY, StorageError))
    return None


def _sources(robot: Member, settings: Settings) -> list[Path]:
    """Files that every result of a robot is made of, beside logs."""
    named = [robot.description and robot_file(robot.description), settings.effects]
    columns = [Path(settings.columns)] if settings.columns and Path(settings.columns).is_file() else []
    return [*filter(None, named), *columns]


def _digest(paths: Sequence[Path]) -> str:
    """Over names and contents, and the version that reads them; a file that cannot be read is one without content."""
    found = hashlib.sha256(version("deltatwin").encode())
    for path in paths:
        found.update(f"\0{path.name}\0".encode())
        with suppress(OSError, StorageError), opened(path, StorageError) as stream:
            found.update(hashlib.file_digest(stream, "sha256").digest())
    return found.hexdigest()


def _rms(values: Sequence[float]) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _said(error: Exception) -> str:
    return str(error) if isinstance(error, DeltatwinError) else f"{type(error).__name__}: {error}"
