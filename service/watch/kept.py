"""The newest minutes of samples, and when something was carried, in bounded memory."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter1d

from drivers.trace.quality import RowNames, check
from schemas.messages import NANOSECONDS, Gripper, SampleFlag, stamp_ns
from schemas.robot import Robot
from schemas.trace import Trace

KEEP_S = 180.0
MOST_ROWS = 1 << 20  # 71 MB; at 8 kHz the newest 131 s
CARRIED_KG = 0.06  # half of the least change that the estimator takes for a pick
EARLY_S = 0.2  # a pick lasts that long at most before the estimator sees it
BAND_S = 0.05  # that the analysis band smears it over
LONGEST_PICK_S = 10.0  # a mass that stays for longer is no pick but the robot's
STRAY_S = 10.0  # from the middle of what came together: a stamp of another clock
_ROW = np.dtype(
    [("time", "i8"), ("position", "3f8"), ("torque", "3f4"), ("command", "3f4"), ("flags", "u4"), ("gripper", "u1")]
)


def flagged(trace: Trace, robot: Robot) -> Trace:
    """What was kept, flagged like a log that is read.

    Raises:
        TraceError: nothing of it is of use.
    """
    return check(trace, RowNames("sample", np.arange(len(trace))), robot)


class Kept:
    """Samples of the last `KEEP_S`, `MOST_ROWS` at most. Time is bus time less that of the first sample."""

    def __init__(self) -> None:
        self.epoch = 0  # bus time, ns, of the first sample
        self._parts: deque[np.ndarray] = deque()
        self._rows = 0
        self._picks: deque[tuple[int, int]] = deque(maxlen=1024)  # from, until, ns of bus time
        self._picked: int | None = None

    def add(self, samples: np.ndarray) -> bool:
        """Take (N,) SAMPLE records in the order they came; whether the clock of the bus began anew."""
        stamps = stamp_ns(samples)
        middle = int(np.sort(stamps)[len(stamps) // 2])
        same = np.abs(stamps - middle) < STRAY_S * NANOSECONDS
        samples, stamps = samples[same], stamps[same]
        anew = bool(self._parts) and middle - self.epoch < self._parts[-1]["time"][0] - STRAY_S * NANOSECONDS
        if anew:
            self._parts.clear()
            self._picks.clear()
            self._rows, self._picked = 0, None
        if not self._parts:
            self.epoch = int(stamps[0])
        rows = np.empty(len(samples), _ROW)
        rows["time"] = stamps - self.epoch
        rows["position"], rows["torque"] = samples["position"], samples["torque"]
        rows["command"], rows["flags"], rows["gripper"] = (
            samples["position_command"], samples["flags"], samples["gripper"]
        )  # fmt: skip
        self._parts.append(rows)
        self._rows += len(rows)
        oldest = rows["time"][-1] - KEEP_S * NANOSECONDS
        while len(self._parts) > 1 and (self._rows > MOST_ROWS or self._parts[0]["time"][-1] < oldest):
            self._rows -= len(self._parts.popleft())
        return anew

    def carry(self, payload: np.ndarray) -> None:
        """Take (N,) PAYLOAD records: what the estimator sees on the platform."""
        stamps, carried = stamp_ns(payload), payload["mass"] > CARRIED_KG
        for k in np.flatnonzero(np.diff(carried, prepend=self._picked is not None)):
            if self._picked is None:
                self._picked = int(stamps[k])
            else:
                self._picks.append((self._picked, int(stamps[k])))
                self._picked = None

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
        rows = np.concatenate(parts) if parts else np.empty(0, _ROW)
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
        )

    def _loaded(self, rows: np.ndarray) -> np.ndarray:
        """(N,) bool. Where the gripper says what it holds nobody else is asked."""
        time, loaded = rows["time"] + self.epoch, np.zeros(len(rows), bool)
        if rows["gripper"].any():
            width = 2 * int(BAND_S * NANOSECONDS / max(1.0, float(np.median(np.diff(time))))) + 1
            return maximum_filter1d(rows["gripper"] == Gripper.CLOSED, width)
        newest = int(self.newest * NANOSECONDS) + self.epoch
        for begin, end in (*self._picks, *([(self._picked, newest)] if self._picked is not None else [])):
            if end - begin < LONGEST_PICK_S * NANOSECONDS:
                first = np.searchsorted(time, begin - (EARLY_S + BAND_S) * NANOSECONDS)
                loaded[first : np.searchsorted(time, end + BAND_S * NANOSECONDS)] = True
        return loaded
