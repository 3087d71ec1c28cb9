"""What was picked in a trace: the estimator's events and masses beside the paper's recursion, and beside the truth."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from replay.process import process
from schemas.errors import DataError, TraceError
from schemas.files import MIB, read_bytes
from schemas.messages import Gripper, PayloadEvent, SampleFlag, stamp_ns
from schemas.robot import Robot
from schemas.trace import Trace
from service.estimator.payload.payload_state import SMALLEST_CHANGE, UNCALIBRATED
from service.estimator.payload.verdict import EVENT_SIGMAS
from service.estimator.recursion import FORGETTING, fixed_forgetting
from service.identification.known_torque import refuse_unlike
from service.model import kinematics
from service.model.nominal import pack
from service.model.prediction import FULL, Motion, motion, predict_along
from service.model.signals import moving

BEFORE_SEEN = 0.25  # s of motion before an event is seen in which what it is about may have happened

# What "found" means: within the larger of the two of the truth, and staying there to the release.
BOUND_SHARE, BOUND_KG = 0.05, 0.05

MAX_TRUTH_BYTES = 16 * MIB  # some hundred thousand picks


@dataclass(frozen=True)
class Weighed:
    """Payload over a trace, as known after each of N samples. time: s, bus. mass, std_dev: kg. random_std_dev,
    common_std_dev: kg, of the error that differs from one mass to the next, and of that which all masses of the robot
    have in common. trusted: bool. event: PayloadEvent."""

    time: np.ndarray
    mass: np.ndarray
    std_dev: np.ndarray
    random_std_dev: np.ndarray
    common_std_dev: np.ndarray
    trusted: np.ndarray
    event: np.ndarray

    def held(self, truth: Pick) -> np.ndarray:
        """(N,) bool: while `truth` was on the platform."""
        return (self.time >= truth.begin) & (self.time < truth.end)


@dataclass(frozen=True)
class PayloadHistory(Weighed):
    """recursion: (N,) kg, the paper's at a fixed forgetting factor on M_Id+F."""

    recursion: np.ndarray


@dataclass(frozen=True)
class Pick:
    """A pick: begin, end s, mass kg; of the truth, or as the estimator saw it."""

    begin: float
    end: float
    mass: float


@dataclass(frozen=True)
class MassLevel:
    """What hangs on the platform for a time: begin, end s, mass kg, standard deviations kg as `Weighed` has them, the
    share of that time in which the mass was trusted, and the event that it begins with, NONE where nobody saw when it
    came to hang there."""

    begin: float
    end: float
    mass: float
    std_dev: float
    random_std_dev: float
    common_std_dev: float
    trusted: float
    event: PayloadEvent


@dataclass(frozen=True)
class CommonError:
    """What all masses of a robot are off by alike, for its torque constants: one standard deviation as a share of the
    mass, and whether a known load has calibrated them."""

    share: float
    calibrated: bool


@dataclass(frozen=True)
class Score:
    """How a true pick was found: delays in s (NaN: never), the mass at its end in kg, by estimator and recursion."""

    truth: Pick
    seen: float
    released: float
    settled: float
    mass: float
    settled_recursion: float
    mass_recursion: float


def common_error(robot: Robot) -> CommonError:
    """The common error of the masses of `robot`."""
    known = None if robot.identified is None else robot.identified.torque_constant_error
    return CommonError(UNCALIBRATED, False) if known is None else CommonError(known, True)


def weighed(robot: Robot, trace: Trace) -> Weighed:
    """Run the online estimator over `trace`.

    Raises:
        TraceError: the trace cannot be used, naming the file.
        DataError: its stamps do not rise, or the robot was never identified.
    """
    if robot.identified is None:
        raise DataError(
            f"{robot.name} was never identified, so no payload can be estimated: first run `deltatwin identify`"
        )
    samples = trace.samples()
    return as_known(samples, process(robot, samples).payload)


def as_known(samples: np.ndarray, result: np.ndarray) -> Weighed:
    """What was known after each of (N,) SAMPLE records, from the PAYLOAD records that the estimator answered."""
    lag = len(samples) - len(result)

    def known(values: np.ndarray) -> np.ndarray:
        shifted = np.zeros(len(samples), values.dtype)
        shifted[lag:] = values
        return shifted

    return Weighed(
        time=stamp_ns(samples) * 1e-9,
        mass=known(result["mass"]),
        std_dev=known(result["std_dev"]),
        random_std_dev=known(result["random_std_dev"]),
        common_std_dev=known(result["common_std_dev"]),
        trusted=known(result["trusted"]) != 0,
        event=known(result["event"]),
    )


def payload_history(robot: Robot, trace: Trace) -> PayloadHistory:
    """What `weighed` says of `trace`, and the paper's recursion.

    Raises:
        TraceError, DataError: as `weighed`, and `refuse_unlike`.
    """
    found, along = weighed(robot, trace), motion(trace)
    torque = predict_along(robot, trace, along)
    refuse_unlike(robot, trace, along, torque[FULL])
    return PayloadHistory(**vars(found), recursion=recursion(robot, trace, along, torque["M_Id+F"]))


def carried(robot: Robot, trace: Trace) -> np.ndarray:
    """(N,) kg on the platform at each row of `trace`, one mass from event to event; NaN where it cannot be told: about
    to change, never trusted, or of unknown mass by a flag.

    It is told up to `BEFORE_SEEN` of motion before an event, or before the end of a trace with events: while the robot
    stands, a mass may change unseen. Of one that did, it is told up to where the mass was trusted last. A robot that
    was never identified weighs nothing, and carries nothing but where its gripper is closed.

    Raises:
        TraceError, DataError: as `weighed`.
    """
    unknown = (trace.flags & np.uint32(SampleFlag.LOADED)) != 0
    mass: np.ndarray = np.where(unknown, np.nan, 0.0)
    if robot.identified is None:
        if trace.gripper is not None:
            mass[np.flatnonzero(trace.gripper == Gripper.CLOSED)] = np.nan
        return mass
    found = weighed(robot, trace)
    events = np.flatnonzero(found.event != PayloadEvent.NONE)
    changed = unseen(found)
    if not len(events) and not changed:
        return mass
    moves = np.any(moving(trace.position, trace.period), axis=1)
    for level in levels(found):
        rows = (found.time >= level.begin) & (found.time <= level.end)
        hangs = level.mass if level.mass > 2 * level.std_dev else 0.0
        mass[rows] += hangs if level.trusted else np.nan
    for row in [*events, len(mass)]:
        moved = np.cumsum(moves[:row][::-1]) * trace.period
        mass[row - int(np.searchsorted(moved, BEFORE_SEEN)) : row] = np.nan
    for gone, back in changed:
        mass[gone:back] = np.nan
    return mass


def recursion(
    robot: Robot,
    trace: Trace,
    along: Motion,
    torque: np.ndarray,
    forgetting: float = FORGETTING,
    rest_votes: bool = True,
) -> np.ndarray:
    """The paper's recursion: payload mass (N,), kg, after each row of `trace`.

    along: its smoothed motion. torque: (N, 3) N m, what the model says without payload. forgetting: factor a
    millisecond. rest_votes: rows in which a joint rests count too, as in the paper.
    """
    model = pack(robot)
    platform = kinematics.motion(model, along.theta, along.theta_dot, along.theta_ddot)
    x = platform.acceleration - model.gravity
    jacobian = kinematics.jacobian(model, along.theta)
    y = np.linalg.solve(np.swapaxes(jacobian, 1, 2), (trace.torque - torque)[..., None])[..., 0]
    y[~along.measured] = np.nan
    if not rest_votes:
        y[~along.moving.all(axis=1)] = np.nan
    return fixed_forgetting(y, x, forgetting ** (trace.period / 1e-3))


def picks(found: Weighed) -> list[Pick]:
    """Picks as the estimator saw them; the mass is the one just before the release, or at the end of the trace."""
    starts = np.flatnonzero(found.event == PayloadEvent.PICK)
    releases = np.flatnonzero(found.event == PayloadEvent.RELEASE)
    result = []
    for start in starts:
        later = releases[releases > start]
        # the estimator sees a release a little late: the last mass it had before is that of the row before
        end = int(later[0]) - 1 if len(later) else len(found.time) - 1
        held = found.mass[start : end + 1]
        result.append(Pick(float(found.time[start]), float(found.time[end]), float(np.median(held))))
    return result


def levels(found: Weighed) -> list[MassLevel]:
    """Every level that the estimator saw, by an event or by a mass that was another when it was trusted again; its
    figures are those of its later half."""
    starts = sorted([*np.flatnonzero(found.event != PayloadEvent.NONE), *(back for _, back in unseen(found))])
    result = []
    for start, stop in pairwise([*starts, len(found.time)]):
        last = int(stop) - 1
        late = slice(start + (stop - start) // 2, stop)  # when most is known of it
        result.append(
            MassLevel(
                begin=float(found.time[start]),
                end=float(found.time[last]),
                mass=float(np.median(found.mass[late])),
                std_dev=float(np.median(found.std_dev[late])),
                random_std_dev=float(np.median(found.random_std_dev[late])),
                common_std_dev=float(np.median(found.common_std_dev[late])),
                trusted=float(found.trusted[start:stop].mean()),
                event=PayloadEvent(int(found.event[start])),
            )
        )
    return result


def unseen(found: Weighed) -> list[tuple[int, int]]:
    """Changes that no event tells, for nobody knows when they were (`FRESH_TIME`): the last row in which the mass of
    before was trusted, and the first in which another was. Before the first row nothing hangs there."""
    edges = np.flatnonzero(np.diff(found.trusted.astype(np.int8), prepend=0, append=0))
    happened = np.cumsum(found.event != PayloadEvent.NONE)
    result, gone, known, spread = [], 0, 0.0, 0.0
    for start, stop in edges.reshape(-1, 2):
        late = slice(start + (stop - start) // 2, stop)
        mass, variance = float(np.median(found.mass[late])), float(np.median(found.std_dev[late]) ** 2)
        least = max(SMALLEST_CHANGE, EVENT_SIGMAS * math.sqrt(variance + spread))
        if happened[stop - 1] == happened[gone] and abs(mass - known) > least:
            result.append((gone, int(start)))
        gone, known, spread = int(stop) - 1, mass, variance
    return result


def score(found: PayloadHistory, truth: Pick) -> Score:
    """Hold what was found against one true pick."""
    held = found.held(truth)
    return Score(
        truth=truth,
        seen=delay(found, PayloadEvent.PICK, truth.begin, truth.end),
        released=delay(found, PayloadEvent.RELEASE, truth.end, truth.end + (truth.end - truth.begin)),
        settled=settled(found.time, found.mass, truth),
        mass=float(found.mass[held][-1]),
        settled_recursion=settled(found.time, found.recursion, truth),
        mass_recursion=float(found.recursion[held][-1]),
    )


def delay(found: Weighed, event: PayloadEvent, since: float, until: float) -> float:
    """s from `since` to the first such event before `until`; NaN: there is none."""
    rows = np.flatnonzero((found.event == event) & (found.time >= since) & (found.time < until))
    return float(found.time[rows[0]] - since) if len(rows) else np.nan


def settled(time: np.ndarray, mass: np.ndarray, truth: Pick) -> float:
    """s after the pick from which on `mass` (N,), kg, stays within the bound to the release; NaN: it never does.

    time: (N,) s, as `truth` counts.
    """
    held = (time >= truth.begin) & (time < truth.end)
    off = np.flatnonzero(np.abs(mass[held] - truth.mass) > max(BOUND_SHARE * truth.mass, BOUND_KG))
    if len(off) == 0:
        return 0.0
    return float(time[held][off[-1] + 1] - truth.begin) if off[-1] + 1 < held.sum() else np.nan


def read_truth(path: Path) -> list[Pick]:
    """True picks from a CSV with the columns `from_s, until_s, mass_kg`.

    Raises:
        TraceError: naming file, line and value.
    """
    try:
        text = read_bytes(path, MAX_TRUTH_BYTES, TraceError).decode("utf-8")
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise TraceError(f"{path}: not a text table: {error}") from error
    result = []
    for line, row in enumerate(rows, start=2):
        try:
            pick = Pick(float(row["from_s"]), float(row["until_s"]), float(row["mass_kg"]))
        except (KeyError, TypeError, ValueError) as error:
            raise TraceError(f"{path}:{line}: expected from_s, until_s, mass_kg as numbers, got {row}") from error
        if not all(map(math.isfinite, (pick.begin, pick.end, pick.mass))):
            raise TraceError(f"{path}:{line}: expected from_s, until_s, mass_kg as numbers, got {row}")
        result.append(pick)
    return result
