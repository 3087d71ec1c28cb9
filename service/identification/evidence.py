"""How likely a reading of a foreign log is: what the machine's equations then leave of the torque on rows left out.

Equations of a machine hold whatever the figures in them are: inertia, friction and damping are not negative, a weight
turns with the angle, a described mass weighs what it weighs. A reading under which they leave less of the torque is the
likelier one, and by how much is said as a ratio of likelihoods. Nothing of a machine is known better than to `FLOOR` of
its torque, so that a term of less decides nothing, and a log of hours says no more than one of `PIECES` stretches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from drivers.trace.quality import LARGEST
from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.errors import DataError, TraceError
from schemas.messages import SampleFlag
from schemas.robot import Robot
from schemas.trace import Trace
from schemas.words import counted, significant
from service.identification.checks import SUSPECT, TorqueReading, best_reading, held_out_share
from service.identification.fit import within
from service.identification.folds import BLOCK, FOLDS
from service.identification.regression import summarise
from service.model.coulomb_viscous import mean_direction
from service.model.mechanism import mechanism_of
from service.model.nominal import pack
from service.model.scene import Recording
from service.model.signals import Band, resolved_hz, segments, thin

LONGEST = 10.0  # s of a log that are tried; a reading that is wrong shows at once
SHORTEST = 0.5  # s that each joint moves, without which nothing is tried
FLOOR = 0.03  # of the torque, rms, by which no machine follows its equations
PIECES = 20  # independent stretches of `BLOCK` s a joint, beyond which a log says nothing new about its reading
SURE = math.log(1000.0)  # of a ratio of likelihoods, from which a reading is taken without being asked for
TURNS_OVER = 0.05  # of the speed, rms, over which friction turns
MOST_SAID = 1e6  # times as likely: beyond, no figure is worth its digits
AS_GIVEN = (1, 1, 1)  # signs
# By the masses, 46 logs of free motion in N m left 0.94 and more of what they left as N m, four that carried products
# 0.86 and more; read at 1.5 times their scale 0.65 in the middle, further off less.
CLEAR_SCALE = 0.8
MASSES = 0.2, 5.0  # times those of a URDF, between which an arm's weight is looked for


@dataclass(frozen=True)
class Run:
    """One log as some reading has it. position, torque: (N, n) rad or m and N m or N; rate: Hz; time: (N,) s, NaN where
    a row has no stamp, or None where rows are evenly apart."""

    position: np.ndarray
    torque: np.ndarray
    rate: float
    time: np.ndarray | None = None


@dataclass(frozen=True)
class Left:
    """What a reading leaves. share: (n,) of each joint's torque, rms, on rows left out; pieces: (n,) that say so."""

    share: np.ndarray
    pieces: np.ndarray

    @property
    def overall(self) -> float:
        """Share over all joints that move."""
        if not self.pieces.any():
            return float("inf")
        return float(np.sqrt(np.average(self.share**2, weights=self.pieces)))


def log_odds(better: Left, worse: Left) -> float:
    """Logarithm of how many times likelier the first is; without end where only the other is impossible."""
    impossible = np.isinf(better.share).any(), np.isinf(worse.share).any()
    if any(impossible):
        return float("inf") * (int(impossible[1]) - int(impossible[0])) if impossible[0] != impossible[1] else 0.0
    ratio = (worse.share**2 + FLOOR**2) / (better.share**2 + FLOOR**2)
    return float(0.5 * np.minimum(better.pieces, worse.pieces) @ np.log(ratio))


def said(log_ratio: float) -> str:
    """How many times likelier, in words."""
    ratio = math.exp(min(abs(log_ratio), 700.0))
    return f"over {MOST_SAID:,.0f}".replace(",", " ") if ratio > MOST_SAID else significant(ratio, 2)


def possible(values: np.ndarray) -> np.ndarray:
    """Values with NaN for what no machine has."""
    return np.where(np.abs(values) <= LARGEST, values, np.nan)


def trial(run: Run, angular: bool = True) -> Trace:
    """The part of a log that moves most. A clock that stands still or goes back breaks it as a gap does. angular:
    positions are rad, not m."""
    position, torque, rate = run.position, run.torque, run.rate
    clock = np.arange(len(position)) / rate if run.time is None else run.time
    stamped = np.isfinite(clock)
    position, torque, clock = possible(position[stamped]), possible(torque[stamped]), clock[stamped]
    if len(clock) < 2 or not rate > 0:
        raise TraceError(f"{counted(len(clock), 'row')} with a stamp")
    length = min(len(position), int(LONGEST * rate))
    activity = np.concatenate([[0.0], np.cumsum(np.nansum(np.abs(np.diff(position, axis=0)), axis=1))])
    ends = activity[length - 1 :] - activity[: len(activity) - length + 1]
    start = int(np.argmax(ends))
    part = slice(start, start + length)
    bad = ~(np.isfinite(position[part]).all(axis=1) & np.isfinite(torque[part]).all(axis=1))
    step = np.diff(clock[part], prepend=clock[start] - 1 / rate)
    flags = np.where(bad, np.uint32(SampleFlag.NOT_A_NUMBER), np.uint32(0))
    flags |= np.where(step == 0, np.uint32(SampleFlag.REPEATED), np.uint32(0))
    flags |= np.where(step < 0, np.uint32(SampleFlag.TIME_BACKWARDS), np.uint32(0))
    return Trace(
        Path("log"),
        clock[part] - clock[start],
        np.ascontiguousarray(position[part]),
        np.ascontiguousarray(torque[part]),
        flags=flags,
        angular=angular,
    )


@dataclass(frozen=True)
class MachineSums:
    """Products of what a machine's torque is made of, the torque last: (FOLDS, n, P + 1, P + 1).

    square: (n,) of the torque about its mean. low, high: (P,) of the figures. pieces: (n,). masses: place of the
    described masses' torque; None: none are.
    """

    gram: np.ndarray
    square: np.ndarray
    low: np.ndarray
    high: np.ndarray
    pieces: np.ndarray
    masses: int | None

    def left(self, signs: Sequence[int]) -> Left:
        """What is left on each fold by figures of the others where the torques have these signs."""
        turned, weight = self._turned(signs), self._weight
        remains = np.zeros(len(weight))
        for fold, mine in enumerate(turned):
            figures = np.append(self._figures(np.delete(turned, fold, axis=0).sum(axis=0), weight), -1.0)
            remains += np.einsum("p,jpq,q->j", figures, mine, figures)
        return Left(np.sqrt(np.maximum(remains, 0.0) * weight), self.pieces)

    def torque_of_masses(self, signs: Sequence[int]) -> float | None:
        """N m that one unit of the torque is by the described masses; None where there are none."""
        if self.masses is None:
            return None
        share = self._figures(self._turned(signs).sum(axis=0), self._weight)[self.masses]
        return None if share in (self.low[self.masses], self.high[self.masses]) else 1.0 / float(share)

    def _turned(self, signs: Sequence[int]) -> np.ndarray:
        """The products where the torques have these signs."""
        turned, sign = self.gram.copy(), np.asarray(signs, float)[:, None]
        turned[:, :, -1, :-1] *= sign
        turned[:, :, :-1, -1] *= sign
        return turned

    @property
    def _weight(self) -> np.ndarray:
        return 1.0 / np.where(self.square > 0, self.square, np.inf)

    def _figures(self, gram: np.ndarray, weight: np.ndarray) -> np.ndarray:
        whole = np.einsum("j,jpq->pq", weight, gram)
        return within(whole[:-1, :-1], whole[:-1, -1], self.low, self.high)


def machine_sums(robot: Axes | Chain, runs: Sequence[Run]) -> MachineSums | None:
    """None where no run has a part that can be used, or no joint moves long enough."""
    mechanism = mechanism_of(robot)
    described = mechanism.as_described()
    mechanism, masses = described or mechanism, described is not None
    try:
        parts = [[thin(part) for part in segments(trial(run, not robot.linear))] for run in runs]
    except TraceError:
        return None
    flat = [part for of_run in parts for part in of_run]
    cutoff = resolved_hz(flat)
    grams, seconds = 0.0, np.zeros(mechanism.joints)
    for part in flat:
        grams = grams + _gram(Recording(part, mechanism, 0, ""), Band.of(part.period, cutoff))
        seconds += part.period * part.moving.sum(axis=0)
    rows = np.concatenate([np.where(part.moving, part.torque, np.nan) for part in flat])
    if seconds.max() <= SHORTEST:
        return None
    rubs = 2 * len(mechanism.frictions)
    low = [coefficient.low for coefficient in mechanism.coefficients.values()]
    low += [0.0] * rubs + [-np.inf] * mechanism.joints + [MASSES[0]] * masses
    high = [np.inf] * (len(low) - masses) + [MASSES[1]] * masses
    pieces = np.minimum(seconds / BLOCK, PIECES)
    gram = np.asarray(grams)
    about = [
        np.nanvar(column) / max(np.nanmean(column**2), 1e-300) if np.isfinite(column).any() else 0.0
        for column in rows.T
    ]
    square = gram[:, :, -1, -1].sum(axis=0) * about
    return MachineSums(gram, square, np.array(low), np.array(high), pieces, len(low) - 1 if masses else None)


def _gram(recording: Recording, band: Band) -> np.ndarray:
    """(FOLDS, n, P + 1, P + 1) of one part: rigid columns, friction, a spring, described masses, torque.

    The spring is what nobody asks about: of a small motion a weight is a straight line in any unit.
    """
    segment, mechanism = recording.segment, recording.mechanism
    rigid, joints = recording.rigid, mechanism.joints
    sliding = recording.sliding
    turns = np.maximum(TURNS_OVER * np.sqrt(np.mean(sliding**2, axis=0)), 1e-12)
    dry = mean_direction(sliding, turns)
    rubs = [rate[:, None, :] * mechanism.rows.T[None] for rate in (sliding, dry)]
    spring = segment.theta[:, :, None] * np.eye(joints)
    known = [rigid.known[..., None]] if mechanism.as_described() is not None else []
    columns = np.concatenate([rigid.columns, *rubs, spring, *known, segment.torque[..., None]], axis=-1)
    columns = band(columns)
    fold = _folds(len(columns), band.period * band.step)
    moving = segment.moving[:: band.step]
    gram = np.zeros((FOLDS, joints, columns.shape[-1], columns.shape[-1]))
    for number in range(FOLDS):
        for joint in range(joints):
            mine = columns[(fold == number) & moving[:, joint], joint]
            gram[number, joint] = mine.T @ mine
    return gram


def _folds(rows: int, period: float) -> np.ndarray:
    """(rows,) which of the folds takes a row: stretches of `BLOCK` in turn."""
    return np.arange(rows) // max(1, round(BLOCK / period)) % FOLDS


@dataclass(frozen=True)
class DeltaFit:
    """One way to read a Delta's log: signs of the positions, reading of the torques, and their scale by the masses."""

    left: Left
    signs: Sequence[int]
    torque: TorqueReading
    by_masses: float

    @property
    def share(self) -> float:
        """Of the torque's rms, left on rows left out."""
        return float(self.left.share[0])


def delta_fits(robot: Robot, runs: Sequence[Run], known: bool, told: bool) -> list[DeltaFit]:
    """Ways to read a Delta's positions and torques, the best first; none where they are no poses, or hardly move.

    known: whether the torques are N m, if they are the joints'; told: by the file or the user.
    """
    model, gear = pack(robot), robot.drive.gear_ratio

    def fitted(signs: Sequence[int]) -> DeltaFit | None:
        try:
            turned = [replace(run, position=run.position * np.array(signs)) for run in runs]
            logs = [summarise(model, trial(run)) for run in turned]
        except (TraceError, DataError):  # no pose of this robot
            return None
        gram = np.concatenate([log.gram for log in logs])
        seconds = np.concatenate([log.seconds for log in logs]).sum(axis=0)
        if seconds.min() <= SHORTEST:
            return None
        sums = gram.sum(axis=0)
        free = best_reading(sums, gear, free_scale=True)
        named = best_reading(sums, gear) if known else free
        clear = not told and free.share < min(SUSPECT, CLEAR_SCALE * named.share)
        reading = free if clear else named
        pieces = min(float(np.sum(seconds)) // BLOCK, PIECES)
        left = Left(np.array([held_out_share(gram, reading)]), np.array([pieces]))
        return DeltaFit(left, signs, reading, free.scale)

    found = {AS_GIVEN: fitted(AS_GIVEN)}
    if (first := found[AS_GIVEN]) is None or first.share > SUSPECT:
        found |= {signs: fitted(signs) for signs in product((1, -1), repeat=3) if signs != AS_GIVEN}
    return sorted((fit for fit in found.values() if fit), key=lambda fit: fit.share)
