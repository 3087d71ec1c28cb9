"""What was learnt of friction, kept in a file from one run of the estimator to the next.

It is a departure from what was identified, so it belongs to one description, and it was learnt at one sample rate. How
much it counts falls with its age: a gear that stood for hours is cold again, whatever it was when it was last heard.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from schemas.errors import StorageError
from schemas.files import check_folder, read_bytes, write_text
from schemas.robot import Identified, Robot
from schemas.toml import validate
from service.estimator.departure import COUNT, LOWER, aged, drift
from service.estimator.estimator import Estimator

MAX_BYTES = 64 << 10  # a whole one has 3 kB
WRITE_PERIOD = timedelta(minutes=1)  # a power cut costs no more of what was learnt
COOLING_TIME = timedelta(hours=1)  # in which 1/e is left of what was learnt
CLOCK_ERROR = timedelta(minutes=1)  # that a file may seem to come from the future by
SAME_PERIOD = 1e-3  # relative
SYMMETRY = 1e-6  # relative; a file that was written whole has none to speak of

_Row = Annotated[list[float], Field(min_length=COUNT, max_length=COUNT)]


class _Kept(BaseModel):
    """Joint by joint Coulomb N m, viscous N m s/rad, offset N m, scale, and last of ball joints N m: information in the
    inverse squares of these."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    schema_: Literal["deltatwin.friction/3"] = Field(alias="schema")
    robot: str
    description: str  # SHA-256 of what the departure is from
    written_at: AwareDatetime
    period_s: Annotated[float, Field(gt=0)]
    stride: Annotated[int, Field(ge=1)]
    information: Annotated[list[_Row], Field(min_length=COUNT, max_length=COUNT)]
    moment: _Row


class Keeper:
    """One file: read at the start, handed to the estimator once the sample rate is known, written while it runs."""

    def __init__(self, path: Path, robot: Robot) -> None:
        """
        Raises:
            StorageError: `path` is there and is not what this robot's estimator keeps, or its folder is not.
        """
        check_folder(path.parent)
        self._path, self._name, self._digest = path, robot.name, _digest(robot)
        identified = robot.identified or Identified()
        self._drift = drift(
            np.array(identified.viscous_friction_nms.value), np.array(identified.coulomb_friction_nm.value)
        )
        self._kept = _read(path, robot.name, self._digest) if path.exists() else None
        self._due = datetime.now(UTC) + WRITE_PERIOD
        self._writing: threading.Thread | None = None
        self._failed = False

    def begin(self, estimator: Estimator) -> str:
        """Let `estimator`, which has heard nothing, begin with what was kept. Returns what there is to say of it."""
        kept, self._kept = self._kept, None
        if kept is None:
            return f"{self._path}: learnt friction will be stored here"
        if kept.stride != estimator.stride or abs(kept.period_s / estimator.period - 1) > SAME_PERIOD:
            return (
                f"{self._path}: period_s {kept.period_s:g}, stride {kept.stride}, but samples come every "
                f"{estimator.period:g} s with stride {estimator.stride}: not used"
            )
        age = max(timedelta(0), datetime.now(UTC) - kept.written_at)
        left = math.exp(-age / COOLING_TIME)
        friction = estimator.state["payload"]["departure"]
        friction["information"], friction["moment"] = aged(
            np.array(kept.information), np.array(kept.moment), self._drift, left
        )
        friction["earlier_information"] = friction["information"][LOWER]
        friction["earlier_moment"] = friction["moment"]
        return f"{self._path}: friction learnt {age.total_seconds() / 60:.0f} min ago is used with weight {left:.0%}"

    def note(self, estimator: Estimator) -> None:
        """Write the file if that is due, beside the estimator, not in its way."""
        now = datetime.now(UTC)
        if now < self._due or (self._writing is not None and self._writing.is_alive()):
            return
        self._due = now + WRITE_PERIOD
        self._writing = threading.Thread(target=self._write_beside, args=(self._text(estimator, now),))
        self._writing.start()

    def close(self, estimator: Estimator) -> None:
        """Write the file.

        Raises:
            StorageError: it cannot be written.
        """
        if self._writing is not None:
            self._writing.join()
        write_text(self._path, self._text(estimator, datetime.now(UTC)))

    def _text(self, estimator: Estimator, now: datetime) -> str:
        friction = estimator.state["payload"]["departure"]
        kept = _Kept(
            schema="deltatwin.friction/3",
            robot=self._name,
            description=self._digest,
            written_at=now,
            period_s=estimator.period,
            stride=estimator.stride,
            information=friction["information"].tolist(),
            moment=friction["moment"].tolist(),
        )
        return kept.model_dump_json(by_alias=True)

    def _write_beside(self, text: str) -> None:
        if hasattr(os, "sched_setscheduler"):  # macOS has the constants alone
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # of this thread, whatever the estimator's has
        try:
            write_text(self._path, text)
        except StorageError as error:  # the robot needs its estimator more than this file
            if not self._failed:
                print(f"estimate: --keep: {error}", file=sys.stderr)
            self._failed = True


def _digest(robot: Robot) -> str:
    """Of all that decides what a departure of friction is from, defaults left out."""
    which = {"gravity_mps2", "geometry", "mass", "drive", "fourth_axis", "identified", "effect"}
    return hashlib.sha256(robot.model_dump_json(include=which, exclude_defaults=True).encode()).hexdigest()


def _read(path: Path, name: str, digest: str) -> _Kept:
    try:
        values = json.loads(read_bytes(path, MAX_BYTES, StorageError))
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: not what `estimate --keep` wrote: {error}") from None
    if not isinstance(values, dict):
        raise StorageError(f"{path}: not what `estimate --keep` wrote: {type(values).__name__}, not an object")
    kept = validate(_Kept, values, path, StorageError)
    again = "give another file, or remove it to start again"
    if kept.robot != name:
        raise StorageError(f"{path}: robot: kept for {kept.robot!r}, this is {name!r}; {again}")
    if kept.description != digest:
        raise StorageError(f"{path}: description: kept for another description or identification of {name!r}; {again}")
    if kept.written_at > datetime.now(UTC) + CLOCK_ERROR:
        raise StorageError(f"{path}: written_at: {kept.written_at.isoformat()} is in the future; {again}")
    information = np.array(kept.information)
    size = np.abs(information).max()
    if (information - information.T).max() > SYMMETRY * size:
        raise StorageError(f"{path}: information: not symmetric, but an information matrix has to be; {again}")
    if np.linalg.eigvalsh(information)[0] < -SYMMETRY * size:
        raise StorageError(f"{path}: information: not positive, but an information matrix has to be; {again}")
    return kept
