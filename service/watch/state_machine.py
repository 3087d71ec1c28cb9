"""The watch: a state machine over samples. It measures the gap once a second, knows what it should be, and says when it
has risen and what to look at.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

from drivers.motion import HOME
from schemas.axes_description import Description
from schemas.errors import DataError, TraceError
from schemas.messages import NANOSECONDS, TOPICS, WatchState, set_stamp, stamp_ns
from schemas.trace import Trace
from service.model.signals import EDGE, segments, thin
from service.watch.kept import KEEP_S, Kept, flagged
from service.watch.level import Level
from service.watch.live_gap import Measure, Stretch

EVERY_S = 1.0  # between two looks
BEFORE_S = 1.0  # of motion before what counts, for effects with a memory
BEHIND_S = 0.3  # by which a pick is told late, and the filters' end
WINDOW = 10  # looks that the gap is told over
OFTEN, OFTEN_WINDOW = 5, 20  # looks of so many, that what is not in most has to stand in; two collisions are in four
LESSON = 600  # looks that is learnt from what `OFTEN` of them reach
DELAY_S = 25.0  # before new motion is learnt: by then a change that came on in it has raised the alarm
LEAST_S = 0.15  # of motion of a joint in a look, that it takes to tell
LEAST_KNOWN = 0.5  # of that motion whose level has to be known
RISEN, FALLEN = 1.25, 1.12  # gap over level from which it has risen, and to which it has to fall again
HOLD = 5  # looks with enough known motion that it takes to tell
MARGIN_S = 1.0  # left out around the rise
BEFORE_MOST_S, BEFORE_LEAST_S = 30.0, 8.0  # of time before the rise, which the diagnosis compares with
AGAIN_S = 600.0  # between two diagnoses
TREND_LOOKS = 30  # that it takes to tell one


@dataclass(frozen=True)
class Patience:
    """learn: s of motion that the level is learnt from. after: s from the rise to the diagnosis."""

    learn: float = 30.0
    after: float = 28.0


@dataclass(frozen=True)
class Look:
    """One second. ratio: (n,) root mean of every row's square over its level's, NaN where too little is known."""

    time: float
    stretch: Stretch
    ratio: np.ndarray


@dataclass(frozen=True)
class Rise:
    """What to diagnose. since: s, when the gap rose; joints: (n,) bool, where. before, after: the motion around."""

    since: float
    joints: np.ndarray
    before: Trace | None
    after: Trace


class Watch:
    """Give it samples as they come; it gives a GAP record a second, and a `Rise` when there is one to diagnose."""

    def __init__(self, robot: Description, patience: Patience | None = None) -> None:
        self._robot, self._patience = robot, patience or Patience()
        self.state = WatchState.LEARNING
        self.diagnosing = False
        self._kept = Kept(robot)
        self._measure: Measure | None = None
        self._level: Level | None = None
        self.learnt = 0.0  # s of free motion that the level is from
        self._lesson: deque[Stretch] = deque(maxlen=LESSON)
        self._usual = np.full(robot.count, np.nan)  # the most that `_often` was while the level was learnt
        self._looks: deque[Look] = deque(maxlen=round(KEEP_S / EVERY_S))
        self._due = BEFORE_S + EVERY_S + 2 * EDGE
        self._new: deque[Look] = deque()  # not learnt yet
        self._calm = True
        self._high = np.zeros(robot.count, bool)  # joints in which the gap has risen
        self._sequence = 0
        self._told_at: float | None = None  # when a rise was last given

    @property
    def robot(self) -> Description:
        """What is watched."""
        return self._robot

    @property
    def raised(self) -> bool:
        """Whether the gap is higher than it should be."""
        return self.state in (WatchState.RAISED, WatchState.DIAGNOSING)

    def warm_up(self) -> None:
        """Compile, without touching the state: a first look that compiles would take longer than a Ctrl-C may wait."""
        time = np.arange(0.0, 2.0 * self._due, 1e-3)
        swing = HOME + 0.1 * np.sin(2.0 * np.pi * time)
        motion = np.tile(swing[:, None], (1, self._robot.count))
        made_up = Trace(Path("made-up swing"), time, motion, np.zeros_like(motion))
        Watch(self._robot).add(made_up.samples(TOPICS[self._robot.topics.sample]))

    def learn(self, trace: Trace, payload: np.ndarray) -> None:
        """Take the level from a log. payload: (M,) PAYLOAD or LOAD records of it. Call `settle` after the last.

        Raises:
            DataError: nothing in it tells the gap, naming the file.
        """
        samples = trace.samples(TOPICS[self._robot.topics.sample])
        stamps, learnt = stamp_ns(payload), self.learnt
        self._patience, given = Patience(np.inf), self._patience
        for k in range(0, len(samples), step := max(1, round(EVERY_S / trace.period))):
            some = samples[k : k + step]
            begin, end = np.searchsorted(stamps, stamp_ns(some[[0, -1]]))
            self.add(some, payload[begin : end + 1])
        self._patience = given
        self._anew()
        self._kept = Kept(self._robot)
        if self.learnt == learnt:
            raise DataError(f"{trace.path}: contains no free motion of {self._robot.name} from which to learn the gap")

    def settle(self) -> None:
        """What was learnt is the level."""
        if self._level is not None and self.learnt > 0.0:
            self._level.settle()
            ratios = np.array([self._ratio(stretch) for stretch in self._lesson])
            windows = [ratios[k : k + OFTEN_WINDOW] for k in range(max(1, len(ratios) - OFTEN_WINDOW + 1))]
            self._usual = np.fmax.reduce([_often(window) for window in windows])
            self.state = WatchState.WATCHING

    @property
    def beyond_description(self) -> np.ndarray:
        """(n,) gap of what was learnt over what the description left when it was made; NaN: it does not say."""
        error = self._robot.model_error
        if error is None or self._measure is None or not self._lesson:
            return np.full(self._robot.count, np.nan)
        total = reduce(add, self._lesson)
        left = np.hypot(self._measure.floor, error.value)
        return _rms(total.square.sum(axis=0), total.count.sum(axis=0)) / left

    def add(self, samples: np.ndarray, payload: np.ndarray | None = None) -> list[np.ndarray]:
        """Take (N,) records of samples and (M,) of payloads or loads; those of the gap, (1,) each, that became due."""
        if len(samples) and self._kept.add(samples):
            self._anew()
        if payload is not None:
            self._kept.carry(payload)
        told, newest = [], self._kept.newest
        while newest >= self._due:
            stop = self._due - EDGE - BEHIND_S
            self._due += EVERY_S
            if newest > self._due + WINDOW * EVERY_S:  # a leap of the clock: nothing to look at in between
                self._due = newest
            told.append(self._look(stop))
        return told

    def _anew(self) -> None:
        """The clock of the bus began anew."""
        self._looks.clear()
        self._new.clear()
        self._due, self._told_at, self._calm = BEFORE_S + EVERY_S + 2 * EDGE, None, True
        if self.state != WatchState.LEARNING:
            self.state = WatchState.IDLE

    def rise(self) -> Rise | None:
        """What to diagnose now, once for a rise."""
        if self.state != WatchState.RAISED or self.diagnosing:
            return None
        now = self._kept.newest
        if self._told_at is not None and now - self._told_at < AGAIN_S:
            return None
        joints = self._risen(self._looks[-1].time) > FALLEN
        if not joints.any() or now - (since := self._since(joints)) < self._patience.after:
            return None
        self._told_at, self.diagnosing = now, True
        begin = max(self._kept.oldest, since - BEFORE_MOST_S)
        before = None
        if since - MARGIN_S - begin >= BEFORE_LEAST_S:
            before = self._kept.trace(begin, since - MARGIN_S, "before")
        return Rise(since, joints, before, self._kept.trace(since + MARGIN_S, now - BEHIND_S, "after"))

    def _look(self, stop: float) -> np.ndarray:
        stretch = self._stretch(stop - EVERY_S, stop)
        if stretch is not None and self._level is not None:
            self._looks.append(Look(stop, stretch, self._ratio(stretch)))
            if self.state != WatchState.LEARNING:
                self._learn_late(stop)
            else:
                self._level.learn(stretch.square, stretch.count)
                self._lesson.append(stretch)
                self.learnt += float(stretch.seconds.mean())
                if self.learnt >= self._patience.learn:
                    self.settle()
        window = [look for look in self._looks if look.time > stop - WINDOW * EVERY_S]
        ratio = self._risen(stop)
        message = self._message(stop, reduce(add, (look.stretch for look in window)) if window else None, ratio)
        if self.state != WatchState.LEARNING:
            moves, before = bool(window) and window[-1].time == stop, self.raised
            self._judge(ratio, moves and float(message["known"][0]) < LEAST_KNOWN)
            if self.raised and not before:
                self._look_back(stop)
        message["state"] = self.state
        return message

    def _learn_late(self, stop: float) -> None:
        """Learn motion of `DELAY_S` before `stop`, if nothing has risen since."""
        assert self._level is not None
        if self.raised:
            self._new.clear()
        elif self._calm:
            self._new.append(self._looks[-1])
        while self._new and self._new[0].time <= stop - DELAY_S:
            stretch = self._new.popleft().stretch
            self._level.learn(stretch.square, stretch.count)

    def _look_back(self, stop: float) -> None:
        """Look again at the time before `stop` in which a mass that stays was taken for a pick: since when is asked."""
        count = round(BEFORE_MOST_S / EVERY_S)
        earlier = [look for look in self._looks if look.time < stop - (count - 0.5) * EVERY_S]
        again = []
        for time in stop - EVERY_S * np.arange(count)[::-1]:
            stretch = self._stretch(time - EVERY_S, time)
            if stretch is not None:
                again.append(Look(float(time), stretch, self._ratio(stretch)))
        self._looks = deque([*earlier, *again], self._looks.maxlen)

    def _stretch(self, start: float, stop: float) -> Stretch | None:
        trace = self._kept.trace(start - BEFORE_S - EDGE, stop + EDGE, "bus")
        try:
            parts = [thin(part) for part in segments(flagged(trace, self._robot))]
        except TraceError:
            return None
        if self._measure is None and any(part.moving.any() for part in parts):
            self._measure = Measure(self._robot, parts)
            self._level = Level(self._measure.floor)
        return None if self._measure is None else self._measure(parts, start, stop)

    def _risen(self, stop: float) -> np.ndarray:
        """(n,) how far the gap stands above its level at `stop`, s: in most looks, or again and again in some."""
        ratios = {
            count: np.array([one.ratio for one in self._looks if one.time > stop - count * EVERY_S]).reshape(
                -1, self._robot.count
            )
            for count in (WINDOW, OFTEN_WINDOW)
        }
        return np.fmax(_typical(ratios[WINDOW]), _often(ratios[OFTEN_WINDOW]) / self._usual)

    def _ratio(self, stretch: Stretch) -> np.ndarray:
        """(n,) root mean over the rows whose level is known of square over level; NaN where they are too few."""
        assert self._level is not None
        assert self._measure is not None
        known = self._level.known
        count = np.where(known, stretch.count, 0.0).sum(axis=0)
        excess = np.where(known, stretch.square / self._level.mean_square, 0.0).sum(axis=0)
        least = LEAST_S / (self._measure.period * self._measure.band.step)
        told = (count >= least) & (count >= LEAST_KNOWN * stretch.count.sum(axis=0))
        return np.where(told, np.sqrt(excess / np.maximum(count, 1.0)), np.nan)

    def _judge(self, ratio: np.ndarray, new: bool) -> None:
        """new: whether the motion is mostly of kinds whose level is not known."""
        above = ratio > (FALLEN if self.raised else RISEN)
        self._high = np.where(np.isnan(ratio), self._high & self.raised, above)  # at rest nothing tells that it fell
        if np.isnan(ratio).all():
            if not self.raised:
                self.state = WatchState.NEW_MOTION if new else WatchState.IDLE
            return
        self._calm = float(np.nanmax(ratio)) < FALLEN
        if self._high.any():
            self.state = WatchState.DIAGNOSING if self.diagnosing else WatchState.RAISED
        else:
            self.state = WatchState.WATCHING

    def _since(self, joints: np.ndarray) -> float:
        """When the gap rose: where the logarithms of the looks' ratios fall best into two levels."""
        looks = [look for look in self._looks if np.isfinite(look.ratio[joints]).any()]
        values = np.array([np.nanmean(np.log(look.ratio[joints])) for look in looks])
        spread = [values[k:].var() * (len(values) - k) + values[:k].var() * k for k in range(1, len(values))]
        return looks[int(np.argmin(spread)) + 1].time - EVERY_S

    def _message(self, stop: float, total: Stretch | None, ratio: np.ndarray) -> np.ndarray:
        message, own = TOPICS[self._robot.topics.gap].empty(1), slice(self._robot.count)
        set_stamp(message, round(stop * NANOSECONDS) + self._kept.epoch)
        message["sequence"], self._sequence = self._sequence, self._sequence + 1
        if "joints" in (message.dtype.names or ()):
            message["joints"] = self._robot.count
        message["ratio"][:, own], message["share"] = ratio, np.nan
        for name in ("gap", "floor", "level", "trend"):
            message[name][:, own] = np.nan
        if self._measure is not None:
            message["floor"][:, own] = self._measure.floor
        if total is None or self._level is None:
            return message
        count = total.count.sum(axis=0)
        message["gap"][:, own] = _rms(total.square.sum(axis=0), count)
        known = np.where(self._level.known, total.count, 0.0)
        message["known"] = known.sum() / max(float(count.sum()), 1.0)
        message["moving"] = total.seconds.mean()
        if self.state != WatchState.LEARNING:
            message["level"][:, own] = _rms((known * self._level.mean_square).sum(axis=0), known.sum(axis=0))
        if len(self._looks) >= TREND_LOOKS:
            time = np.array([look.time for look in self._looks])
            rms = [_rms(look.stretch.square.sum(axis=0), look.stretch.count.sum(axis=0)) for look in self._looks]
            message["trend"][:, own] = [_slope(time, column) * 60.0 for column in np.transpose(rms)]
        message["share"] = np.clip((total.without - total.energy) / max(total.bare, 1e-12), 0.0, 1.0)
        return message


def _typical(ratios: np.ndarray) -> np.ndarray:
    """(n,) median of looks' ratios (M, n), which a collision or a stop in one of them does not move; NaN of few."""
    told = np.isfinite(ratios)
    return np.array([np.median(r[t]) if t.sum() >= HOLD else np.nan for r, t in zip(ratios.T, told.T, strict=True)])


def _often(ratios: np.ndarray) -> np.ndarray:
    """(n,) what looks' ratios (M, n) reach `OFTEN` times; NaN of few. Friction at reversals is not in every look."""
    if len(ratios) < 2 * OFTEN:
        return np.full(ratios.shape[1], np.nan)
    told = np.isfinite(ratios)
    largest = np.sort(np.where(told, ratios, -np.inf), axis=0)[-OFTEN]
    return np.where(told.sum(axis=0) >= 2 * OFTEN, largest, np.nan)


def _rms(square: np.ndarray, count: np.ndarray) -> np.ndarray:
    return np.where(count > 0, np.sqrt(square / np.maximum(count, 1.0)), np.nan)


def _slope(time: np.ndarray, values: np.ndarray) -> float:
    told = np.isfinite(values)
    return float(np.polyfit(time[told], values[told], 1)[0]) if told.sum() >= TREND_LOOKS else np.nan
