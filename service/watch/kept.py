"""The newest minutes of samples, and when something was carried, in bounded memory."""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, grey_opening, maximum_filter1d, median_filter

from drivers.trace.quality import RowNames, check
from schemas.axes_description import Description
from schemas.messages import NANOSECONDS, OF_DELTA, OF_JOINTS, Gripper, SampleFlag, stamp_ns
from schemas.trace import Trace

KEEP_S = 180.0
MOST_ROWS = 1 << 20  # 71 MB; at 8 kHz the newest 131 s
CARRIED_KG = 0.06  # half of the least change that the estimator takes for a pick
TICK_S = 0.05  # that what the estimator sees is kept by
SPIKE, DOUBT = 5, 9  # ticks, of a median: a release swings below what is left, and is told with a great doubt
EARLY_S = 0.2  # a pick lasts that long at most before the estimator of a Delta sees it
EARLY_ARM_S = 1.5  # that of an arm: half a second agrees with another load, the next half confirms it
# Field with the standard deviation of the mass in each payload message, and how late that message may tell of a load.
_OF_LOAD = {OF_DELTA.payload: ("std_dev", EARLY_S), OF_JOINTS.payload: ("mass_random", EARLY_ARM_S)}
BAND_S = 0.05  # that the analysis band smears it over
LONGEST_PICK_S = 10.0  # a mass that stays for longer is no pick but the robot's
STRAY_S = 10.0  # from the middle of what came together: a stamp of another clock
_TICK = round(TICK_S * NANOSECONDS)


def _row(count: int) -> np.dtype:
    """A sample of `count` joints."""
    joints = [("position", "f8", (count,)), ("torque", "f4", (count,)), ("command", "f4", (count,))]
    return np.dtype([("time", "i8"), *joints, ("flags", "u4"), ("gripper", "u1")])


def flagged(trace: Trace, robot: Description) -> Trace:
    """What was kept, flagged like a log that is read.

    Raises:
        TraceError: nothing of it is of use.
    """
    return check(trace, RowNames("sample", np.arange(len(trace))), robot)


class Kept:
    """Samples of `robot` in the last `KEEP_S`, `MOST_ROWS` at most. Time is bus time less that of the first sample."""

    def __init__(self, robot: Description) -> None:
        self._count, self._angular = robot.count, robot.angular
        self._row = _row(robot.count)
        self._doubt, self._early = _OF_LOAD[robot.topics.payload]
        self.epoch = 0  # bus time, ns, of the first sample
        self._parts: deque[np.ndarray] = deque()
        self._rows = 0
        self._seen: deque[tuple[int, float, float]] = deque()  # tick of bus time, kg, kg of standard deviation

    def add(self, samples: np.ndarray) -> bool:
        """Take (N,) records of samples in the order they came; whether the clock of the bus began anew."""
        stamps = stamp_ns(samples)
        middle = int(np.sort(stamps)[len(stamps) // 2])
        same = np.abs(stamps - middle) < STRAY_S * NANOSECONDS
        samples, stamps = samples[same], stamps[same]
        anew = bool(self._parts) and middle - self.epoch < self._parts[-1]["time"][0] - STRAY_S * NANOSECONDS
        if anew:
            self._parts.clear()
            self._seen.clear()
            self._rows = 0
        if not self._parts:
            self.epoch = int(stamps[0])
        rows = np.empty(len(samples), self._row)
        rows["time"] = stamps - self.epoch
        for name, said in (("position", "position"), ("torque", "torque"), ("command", "position_command")):
            rows[name] = samples[said][:, : self._count]
        rows["flags"], rows["gripper"] = samples["flags"], samples["gripper"]
        self._parts.append(rows)
        self._rows += len(rows)
        oldest = rows["time"][-1] - KEEP_S * NANOSECONDS
        while len(self._parts) > 1 and (self._rows > MOST_ROWS or self._parts[0]["time"][-1] < oldest):
            self._rows -= len(self._parts.popleft())
        return anew

    def carry(self, payload: np.ndarray) -> None:
        """Take (N,) PAYLOAD or LOAD records: what the estimator sees on platform or tool."""
        near = np.abs(stamp_ns(payload) - self.epoch - self.newest * NANOSECONDS) < STRAY_S * NANOSECONDS
        payload = payload[near & np.isfinite(payload["mass"]) & np.isfinite(payload[self._doubt])]
        ticks = stamp_ns(payload) // _TICK
        for k in np.flatnonzero(np.diff(ticks, append=-1)):  # the last of each tick
            while self._seen and self._seen[-1][0] >= ticks[k]:
                self._seen.pop()
            self._seen.append((int(ticks[k]), float(payload["mass"][k]), float(payload[self._doubt][k])))
        while self._seen and self._seen[-1][0] - self._seen[0][0] > KEEP_S / TICK_S:
            self._seen.popleft()

    @property
    def newest(self) -> float:
        """s."""
        return self._parts[-1]["time"][-1] / NANOSECONDS if self._parts else 0.0

    @property
    def oldest(self) -> float:
        """s."""
        return self._parts[0]["time"][0] / NANOSECONDS if self._parts else 0.0

    def trace(self, start: float, stop: float, name: str) -> Trace:
        """The samples from `start` to `stop`, s, as a trace, unchecked; flagged LOADED where something was carried."""
        first, last = start * NANOSECONDS, stop * NANOSECONDS
        parts = [part for part in self._parts if part["time"][-1] >= first and part["time"][0] <= last]
        rows = np.concatenate(parts) if parts else np.empty(0, self._row)
        rows = rows[(rows["time"] >= first) & (rows["time"] <= last)]
        command = rows["command"].astype(np.float64)
        return Trace(
            path=Path(name),
            time=rows["time"] / NANOSECONDS,
            position=rows["position"],
            torque=rows["torque"].astype(np.float64),
            position_command=command if len(rows) and np.isfinite(command).all() else None,
            flags=np.where(self._loaded(rows), rows["flags"] | np.uint32(SampleFlag.LOADED), rows["flags"]),
            epoch_ns=self.epoch,
            angular=self._angular,
        )

    def _loaded(self, rows: np.ndarray) -> np.ndarray:
        """(N,) bool. Where the gripper says what it holds nobody else is asked."""
        time = rows["time"] + self.epoch
        if rows["gripper"].any():
            width = 2 * int(BAND_S * NANOSECONDS / max(1.0, float(np.median(np.diff(time))))) + 1
            return maximum_filter1d(rows["gripper"] == Gripper.CLOSED, width)
        carried, first = self._carried()
        tick = np.clip(time // _TICK - first, 0, len(carried) - 1)
        return carried[tick]

    def _carried(self) -> tuple[np.ndarray, int]:
        """(T,) bool, tick by tick, and the first tick: whether the mass stands out of what stays for `LONGEST_PICK_S`,
        by more than the estimator's own doubt."""
        if not self._seen:
            return np.zeros(1, bool), 0
        told = np.array(self._seen)
        ticks = np.arange(told[0, 0], told[-1, 0] + 1)
        mass, doubt = told[np.searchsorted(told[:, 0], ticks, "right") - 1, 1:].T
        mass = median_filter(mass, SPIKE, mode="nearest")
        stays = grey_opening(mass, 2 * round(LONGEST_PICK_S / TICK_S / 2) + 1, mode="constant", cval=-np.inf)
        carried = mass - np.maximum(stays, 0.0) > CARRIED_KG + median_filter(doubt, DOUBT, mode="nearest")
        early, late = (math.ceil(seconds / TICK_S) for seconds in (self._early + BAND_S, BAND_S))
        return binary_dilation(carried, np.arange(-early, early + 1) <= late), int(ticks[0])
