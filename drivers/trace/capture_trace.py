"""A capture as a trace: read whole, or streamed to an MCAP file in bounded memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.ethercat.capture import Capture, FrameFlag, Frames
from drivers.ethercat.declaration import Declaration
from drivers.ethercat.doubles import without_doubles
from drivers.ethercat.frames import Command, Kind, decode
from drivers.ethercat.process_data.assembly import Assembler
from drivers.ethercat.process_data.cycle_clock import BUNCHED, Bunches
from drivers.ethercat.process_data.object_layout import NOT_MAPPED, make_layout
from drivers.trace.mcap_file import to_trace, write_samples
from drivers.trace.quality import RowNames, check
from schemas.errors import TraceError
from schemas.files import whole
from schemas.messages import SampleFlag, stamp_ns
from schemas.robot import Robot
from schemas.trace import Finding, Trace


class CaptureReader:
    """The samples of one capture, block by block, and afterwards what there is to say about them."""

    def __init__(self, path: Path, robot: Robot) -> None:
        """
        Raises:
            RobotError: the robot description does not say how to read its bus.
        """
        self.capture = Capture(path)
        self.assembler = Assembler(make_layout(robot))
        self._declaration = Declaration(robot)
        self._kinds = np.zeros(len(Kind), np.int64)
        self._flagged = Counter[FrameFlag]()
        self._bunches = Bunches()
        self._seen: set[tuple[int, int, int]] = set()  # logical commands: command, address, length

    def blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(M,) records of SAMPLE and (M, 3, 6) int64 of their INPUTS in drive units, some at a time.

        Raises:
            TraceError: the file is no capture, or gives no sample; it says why.
        """
        made = 0
        for frames in without_doubles(self.capture.blocks()):
            samples, raw = self.assembler.samples(frames)
            self._flagged.update({flag: np.count_nonzero(frames.flags & flag) for flag in FrameFlag})
            if made == 0:
                self._look(frames)  # once samples come there is nothing to explain
            self._bunches.add(stamp_ns(samples))
            made += len(samples)
            self._declaration.add(samples, raw)
            if len(samples):
                yield samples, raw
        if made == 0:
            raise TraceError(f"{self.capture.path}: {self._why_nothing()}")

    @property
    def bunched(self) -> bool:
        """Whether a card that collects interrupts has made the stamps, once `blocks` has ended."""
        return self._bunches.period_ns is not None

    def findings(self) -> list[Finding]:
        """What is to be known about the bus and the declaration, once `blocks` has ended."""
        count, said = self.assembler.count, []
        clock = "the distributed clock" if self.assembler.distributed_clock else "the capture's clock, returned frames"
        bunched = self._bunches.period_ns
        said.append(f"stamps are those of {clock}; cycle time {(bunched or self.assembler.period_ns) / 1e6:.6g} ms")
        if bunched:
            said.append(BUNCHED)
        said += self.capture.findings
        for number, text in (
            (count("counter_faults"), "cycles with a working counter too low"),
            (count("unanswered"), "of them unanswered, their values are NaN"),
            (count("drive_faults"), "cycles with a drive in fault"),
            (count("not_enabled") - count("drive_faults"), "cycles with a drive not in operation"),
            (0 if bunched else count("lost"), "cycles lost"),
            (count("pauses"), "pauses in which the master sent no frames"),
            (count("incomplete"), "cycles of which a part is missing, left out"),
            (self._flagged[FrameFlag.DAMAGED], "frames left out that the analyzer marked as damaged"),
            (self._flagged[FrameFlag.SNAPPED], "frames snapped by the capture"),
            (
                self._flagged[FrameFlag.REPEATED],
                "frames captured twice (a bridge, a mirror port, every interface at once), left out",
            ),
            (self._flagged[FrameFlag.PSEUDO], "GPIO events of the analyzer, no frames"),
        ):
            if number:
                said.append(f"{number} {text}")
        if count("sent") == 0:
            said.append("only returned frames were captured")
        return [Finding.note(text) for text in said + self._declaration.findings()]

    def _look(self, frames: Frames) -> None:
        datagrams, kinds = decode(frames)
        self._kinds += np.bincount(kinds, minlength=len(Kind))
        logical = datagrams[np.isin(datagrams["command"], [Command.LRD, Command.LWR, Command.LRW])]
        self._seen.update(np.unique(logical[["command", "address", "length"]])[:20].tolist())

    def _why_nothing(self) -> str:
        capture, kinds = self.capture, self._kinds
        damage = "".join(f"; {text}" for text in capture.findings)
        if snapped := self._flagged[FrameFlag.SNAPPED]:
            damage += f"; {snapped} frames are snapped, so not whole: capture again without a snap length"
        if capture.frames == 0:
            return f"no frames{damage}"
        if self._flagged[FrameFlag.FOREIGN] == capture.frames:
            types = ", ".join(map(str, sorted(capture.link_types)))
            return f"link type {types} carries no Ethernet (1, 113, 276, 240 and 241 are read)"
        ethercat = int(kinds[1:].sum())
        if ethercat == 0:
            return f"no EtherCAT among {capture.frames} frames{damage}"
        if not self._seen:
            return f"no process data: none of {ethercat} EtherCAT frames has a logical command{damage}"
        seen = ", ".join(
            f"{Command(command).name} {address:#x} to {address + length - 1:#x}"
            for command, address, length in sorted(self._seen)
        )
        if self.assembler.count("returned") == 0 and self.assembler.count("sent"):
            return (
                f"no returned frame among {self.assembler.count('sent')} with process data: either only the way out "
                f"was captured, or no drive answered (working counter 0){damage}"
            )
        places = self.assembler.layout["inputs"]["place"][0]
        missing = [
            f"joint {joint + 1}"
            for joint in range(3)
            if not any(
                address <= place < address + length
                for place in places[joint][places[joint] != NOT_MAPPED]
                for _, address, length in self._seen
            )
        ]
        about = f" of {', '.join(missing)}" if missing else ""
        return f"the inputs{about} that the robot description maps were never complete; on the bus: {seen}{damage}"


def read_capture(path: Path, robot: Robot) -> Trace:
    """A capture as a trace, in memory.

    Raises:
        TraceError: no capture, no EtherCAT, no process data, or not that of this robot.
        RobotError: the robot description does not say how to read its bus.
    """
    reader = CaptureReader(path, robot)
    samples = np.concatenate([samples for samples, _ in reader.blocks()])
    said = tuple(reader.findings())
    try:
        trace = check(to_trace(samples, path), RowNames("cycle", np.arange(1, len(samples) + 1)), robot)
    except TraceError as error:
        raise TraceError(f"{error}; {BUNCHED}") if reader.bunched else error from error
    found = _of_bunches(trace) if reader.bunched else trace.findings
    return replace(trace, findings=said + found)


def _of_bunches(trace: Trace) -> tuple[Finding, ...]:
    """Findings of a trace whose stamps come in bunches, without those that are made of its stamps: they contradict
    what is known of the cycle."""
    by_stamps = np.uint32(SampleFlag.GAP_BEFORE | SampleFlag.JUMP | SampleFlag.REPEATED)
    flagged = np.count_nonzero(trace.flags & by_stamps)
    kept = tuple(f for f in trace.findings if f.flag and not f.flag & by_stamps)
    line = (
        f"bunched stamps do not give a speed: {flagged} of {len(trace)} cycles are flagged, and left out of every fit"
    )
    return (*kept, Finding.note(line)) if flagged else kept


def convert_capture(
    path: Path, robot: Robot, target: Path, progress: Callable[[int, int], object]
) -> tuple[int, list[Finding]]:
    """Stream a capture into an MCAP file; (samples, findings). `progress` takes bytes read and the file's size.

    Raises:
        TraceError: see `read_capture`. StorageError: the target cannot be written.
        RobotError: the robot description does not say how to read its bus.
    """
    reader = CaptureReader(path, robot)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise TraceError(f"{path}: {error.strerror}") from error

    def blocks() -> Iterator[np.ndarray]:
        for samples, _ in reader.blocks():
            progress(reader.capture.bytes_read, size)
            yield samples

    with whole(target) as partial:
        made = write_samples(blocks(), partial, robot.name, path)
    return made, reader.findings()
