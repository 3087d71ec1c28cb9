"""What a capture holds, with or without knowing the robot: slaves, cycle, working counters, states, mapping."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.ethercat.capture import Capture, FrameFlag, Frames
from drivers.ethercat.cia402 import DriveState, drive_state
from drivers.ethercat.doubles import without_doubles
from drivers.ethercat.frames import AL_STATUS, FMMU, AlState, Command, DatagramFlag, Kind, decode
from drivers.ethercat.process_data.cycle_clock import BUNCHED, GAP_PERIODS, Bunches, lost_cycles
from drivers.ethercat.process_data.object_layout import STATUS, mapped_inputs, mapped_objects
from drivers.trace.capture_trace import CaptureReader
from schemas.errors import TraceError
from schemas.messages import stamp_ns
from schemas.robot import Robot

LOGICAL = (Command.LRD, Command.LWR, Command.LRW)
_BROADCAST = (Command.BRD, Command.BWR, Command.BRW)
_CONFIGURED = (Command.FPRD, Command.FPWR, Command.FPRW)
CHANGES_SHOWN = 200
_NO_CYCLE: dict[str, Any] = {
    "cycle_s": None, "jitter_std_s": None, "jitter_p99_s": None, "jitter_max_s": None, "lost_cycles": None,
}  # fmt: skip


@dataclass
class _Cyclic:
    """One datagram that comes again and again: its times on the way out and back, its working counters."""

    times: tuple[list[np.ndarray], list[np.ndarray]] = field(default_factory=lambda: ([], []))
    counters: dict[int, int] = field(default_factory=dict)


class Survey:
    """Collects block by block; `figures` at the end. Times in s, JSON-ready."""

    def __init__(self) -> None:
        self._kinds = np.zeros(len(Kind), np.int64)
        self._flagged = Counter(dict.fromkeys(FrameFlag, 0))
        self._datagrams = 0
        self._first: int | None = None  # ns, of the first frame
        self._before = self._earliest = self._latest = 0  # of the frame before, and of all
        # number of a frame whose time is below that before, and how far, ns
        self._backwards: list[tuple[int, int]] = []
        self._slaves = 0
        self._stations: set[int] = set()
        self._plain = False
        self._cyclic: dict[tuple[int, int, int], _Cyclic] = {}
        self._states: dict[int, int] = {}
        self._changes: list[dict[str, Any]] = []
        self._fmmus: dict[tuple[int, int], dict[str, Any]] = {}

    def add(self, frames: Frames) -> None:
        """Count one block."""
        datagrams, kinds = decode(frames)
        datagrams = datagrams[frames.flags[datagrams["frame"]] & FrameFlag.REPEATED == 0]
        self._kinds += np.bincount(kinds, minlength=len(Kind))
        self._flagged.update({flag: np.count_nonzero(frames.flags & flag) for flag in FrameFlag})
        self._datagrams += len(datagrams)
        self._add_times(frames)
        if len(datagrams) == 0:
            return
        returned = self._returned(frames, datagrams)[datagrams["frame"]]
        answered = datagrams["working_counter"] > 0
        command = datagrams["command"]
        broadcast = np.isin(command, _BROADCAST) & answered
        if broadcast.any():  # each slave adds one to the position it passes on
            self._slaves = max(self._slaves, int((datagrams["address"][broadcast] & 0xFFFF).max()))
        configured = np.isin(command, _CONFIGURED) & answered
        self._stations |= {int(station) for station in np.unique(datagrams["address"][configured] & 0xFFFF)}
        self._add_cyclic(frames, datagrams, returned)
        self._add_states(frames, datagrams[answered])
        self._add_mapping(frames, datagrams[configured & (command == Command.FPWR)])

    def _add_times(self, frames: Frames) -> None:
        if self._first is None:
            self._first = self._before = self._earliest = self._latest = int(frames.time[0])
        self._earliest = min(self._earliest, int(frames.time.min()))
        self._latest = max(self._latest, int(frames.time.max()))
        steps = np.diff(frames.time, prepend=self._before)
        self._backwards += [(frames.first + int(at), int(-steps[at])) for at in np.flatnonzero(steps < 0)]
        self._before = int(frames.time[-1])

    def _returned(self, frames: Frames, datagrams: np.ndarray) -> np.ndarray:
        """(N,) bool a frame: on its way back."""
        answered = np.zeros(len(frames), np.bool_)
        answered[datagrams["frame"][datagrams["working_counter"] > 0]] = True
        holds = np.zeros(len(frames), np.bool_)
        holds[datagrams["frame"]] = True
        local = frames.data[np.where(holds, frames.offset + 6, 0)] & 2 != 0
        self._plain = self._plain or bool((holds & ~local & ~answered).any())
        return answered | (local & self._plain)

    def _add_cyclic(self, frames: Frames, datagrams: np.ndarray, returned: np.ndarray) -> None:
        logical = np.isin(datagrams["command"], LOGICAL)
        rows, back = datagrams[logical], returned[logical]
        for key in np.unique(rows[["command", "address", "length"]]):
            same = (rows["command"] == key[0]) & (rows["address"] == key[1]) & (rows["length"] == key[2])
            entry = self._cyclic.setdefault((int(key[0]), int(key[1]), int(key[2])), _Cyclic())
            for direction in (0, 1):
                of = same & (back == bool(direction))
                entry.times[direction].append(frames.time[rows["frame"][of]])
            whole = rows["flags"] & DatagramFlag.CUT == 0  # of the others it was not captured
            counters, counts = np.unique(rows["working_counter"][same & back & whole], return_counts=True)
            for counter, count in zip(counters.tolist(), counts.tolist(), strict=True):
                entry.counters[counter] = entry.counters.get(counter, 0) + count

    def _add_states(self, frames: Frames, answered: np.ndarray) -> None:
        reads = answered[
            np.isin(answered["command"], [Command.FPRD, Command.BRD])
            & (answered["address"] >> 16 == AL_STATUS)
            & (answered["length"] >= 2)
        ]
        states = frames.data[reads["data"]] & 0x1F
        stations = np.where(reads["command"] == Command.BRD, 0, reads["address"] & 0xFFFF)
        for row in np.flatnonzero(states != 0):
            station, state = int(stations[row]), int(states[row])
            if self._states.get(station) == state:
                continue
            self._states[station] = state
            if len(self._changes) < CHANGES_SHOWN:
                change = {
                    "frame": int(frames.first + reads["frame"][row]),
                    "time_s": (int(frames.time[reads["frame"][row]]) - (self._first or 0)) * 1e-9,
                    "station": station or None,
                    "state": _state_name(state),
                }
                if reads["length"][row] >= 6 and state & 0x10:
                    code = frames.data[reads["data"][row] + 4 :][:2]
                    change["al_status_code"] = int(code[0]) | int(code[1]) << 8
                self._changes.append(change)

    def _add_mapping(self, frames: Frames, writes: np.ndarray) -> None:
        register = writes["address"] >> 16
        for row in writes[(register >= FMMU) & (register < FMMU + 256) & (writes["length"] >= 16)]:
            for number in range(int(row["length"]) // 16):
                data = frames.data[row["data"] + 16 * number :][:16].tobytes()
                length, kind, active = int.from_bytes(data[4:6], "little"), data[11], data[12] & 1
                key = (int(row["address"]) & 0xFFFF, (int(row["address"]) >> 16) + 16 * number)
                if active and length:
                    self._fmmus[key] = {
                        "station": key[0],
                        "logical_address": int.from_bytes(data[:4], "little"),
                        "bytes": length,
                        "physical_address": int.from_bytes(data[8:10], "little"),
                        "direction": {1: "inputs", 2: "outputs", 3: "both"}.get(kind & 3, "none"),
                    }

    def figures(self, capture: Capture) -> dict[str, Any]:
        """Everything found; `capture` has been read to its end."""
        cyclic = [_cyclic_figures(key, entry) for key, entry in sorted(self._cyclic.items())]
        bunched = any(entry["cycle_s"] is not None and entry["jitter_std_s"] is None for entry in cyclic)
        return {
            "frames": capture.frames,
            "ethercat_frames": int(self._kinds[1:].sum()),
            "datagrams": self._datagrams,
            "cut_frames": int(self._kinds[Kind.CUT]),
            **{f"{str(flag.name).lower()}_frames": number for flag, number in self._flagged.items()},
            "link_types": sorted(capture.link_types),
            "duration_s": (self._latest - self._earliest) * 1e-9,
            "slaves": self._slaves,
            "stations": sorted(self._stations),
            "cyclic": cyclic,
            "state_changes": self._changes,
            "mapping": [self._fmmus[key] for key in sorted(self._fmmus)],
            "findings": [*capture.findings, *self._time_findings(), *([BUNCHED] if bunched else [])],
        }

    def _time_findings(self) -> list[str]:
        if not self._backwards:
            return []
        frame, step = self._backwards[0]
        return [
            f"time goes backwards at {len(self._backwards)} frames, first at frame {frame}, by {step * 1e-9:.6g} s: "
            "pieces that were joined, or several clocks; steps across it are left out of cycle and jitter"
        ]


def _state_name(state: int) -> str:
    """AL status in words; a broadcast reads the states of all slaves, or-ed together."""
    known = [s for s in AlState if s == state & 15] or [s for s in AlState if s & state & 15 == s]
    return "+".join(s.name for s in known) + (" with error" if state & 0x10 else "")


def _cyclic_figures(key: tuple[int, int, int], entry: _Cyclic) -> dict[str, Any]:
    command, address, length = key
    sent, back = (np.concatenate(times) for times in entry.times)
    usual = max(entry.counters, key=lambda counter: entry.counters[counter]) if entry.counters else None
    times = sent if len(sent) else back
    return {
        "command": Command(command).name,
        "logical_address": address,
        "bytes": length,
        "sent": len(sent),
        "returned": len(back),
        "working_counter": usual,
        "working_counter_faults": sum(n for c, n in entry.counters.items() if usual is not None and c < usual),
        "unanswered": entry.counters.get(0, 0),
        **_cycle_figures(times),
    }


def _cycle_figures(times: np.ndarray) -> dict[str, Any]:
    if len(times) < 3:
        return _NO_CYCLE
    bunches = Bunches()
    bunches.add(times)
    if bunches.period_ns is not None:
        return _NO_CYCLE | {"cycle_s": bunches.period_ns * 1e-9}
    steps = np.diff(times)
    steps = steps[steps >= 0]
    period = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps > GAP_PERIODS * period
    if gaps.all():
        return _NO_CYCLE
    off = np.abs(steps[~gaps] - period) * 1e-9
    return {
        "cycle_s": period * 1e-9,
        "jitter_std_s": float(np.std(steps[~gaps]) * 1e-9),
        "jitter_p99_s": float(np.percentile(off, 99)),
        "jitter_max_s": float(off.max()),
        "lost_cycles": lost_cycles(times),
    }


def survey_capture(path: Path, robot: Robot | None = None) -> dict[str, Any]:
    """What is in a capture, JSON-ready. With a robot also its objects, its samples and its drives' state changes.

    Raises:
        TraceError: the file cannot be read, is no capture or holds no frame.
        RobotError: the robot description does not say how to read its bus.
    """
    capture, survey = Capture(path), Survey()
    for frames in without_doubles(capture.blocks()):
        survey.add(frames)
    if capture.frames == 0:
        raise TraceError("; ".join((f"{path}: no frames", *capture.findings)))
    figures = {"path": str(path), **survey.figures(capture)}
    return figures if robot is None else figures | {"robot": _robot_figures(path, robot)}


def _robot_figures(path: Path, robot: Robot) -> dict[str, Any]:
    reader = CaptureReader(path, robot)
    layout = reader.assembler.layout
    samples, changes = 0, []
    states = np.full(3, -1, np.int64)
    try:
        for records, raw in reader.blocks():
            found = drive_state(raw[:, :, STATUS]).astype(np.int64)
            changed = np.diff(np.vstack([states, found]), axis=0) != 0
            for row, joint in np.argwhere(changed & mapped_inputs(layout)[:, STATUS]):
                if len(changes) < CHANGES_SHOWN:
                    changes.append(
                        {
                            "stamp_s": int(stamp_ns(records[row])) * 1e-9,
                            "joint": int(joint) + 1,
                            "state": DriveState(int(found[row, joint])).name.lower(),
                        }
                    )
            states = found[-1]
            samples += len(records)
    except TraceError as error:
        return {"objects": mapped_objects(layout), "error": str(error)}
    return {
        "samples": samples,
        "objects": mapped_objects(layout),
        "drive_state_changes": changes,
        "findings": [finding.message for finding in reader.findings()],
    }
