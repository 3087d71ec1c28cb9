"""Live tap: frames off an interface, or out of a capture at its own pace, as samples. It never sends a frame.

A sample is published from the frame that completes its cycle, before the next frame is read. Stamps are the distributed
clock's where the bus carries one, else those of the network interface: its hardware's where that is switched on
(`hwstamp_ctl`), the kernel's otherwise.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from drivers.ethercat.capture import Capture
from drivers.ethercat.cia402 import DriveState, drive_state
from drivers.ethercat.declaration import FirstMotion
from drivers.ethercat.interface import open_interface
from drivers.ethercat.process_data.assembly import FRAME_BYTES, ONE_FRAME, Assembler, assemble_one
from drivers.ethercat.process_data.cycle_clock import STOPPED_CYCLES, STOPPED_NS
from drivers.ethercat.process_data.frame_state import COUNTS, counts_of
from drivers.ethercat.process_data.object_layout import STATUS, make_layout, mapped_inputs
from drivers.health import Health
from schemas.errors import BusError
from schemas.messages import NANOSECONDS, SAMPLE, HealthFlag, SampleFlag
from schemas.robot import Robot

RECEIVE_BYTES = 8 << 20  # of kernel buffer: 10 s of a busy bus
IDLE_NS = 5_000_000  # longest silence before the loop looks around
SILENT_NS = 2 * NANOSECONDS  # before a bus that has brought no sample yet is called quiet
MISSING_CYCLES = 3  # on their way at once; more are a fault of the bus
OVERDUE_NS = 20_000_000  # a health message waits that long for the pause behind a sample
FAULT_NS = NANOSECONDS  # that BUS_FAULT stands after what is over in a cycle
SAY_NS = NANOSECONDS // 5  # least time between two lines of what went wrong

_ETH_P_ALL = 0x0003
_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, _PACKET_STATISTICS, _PACKET_MR_PROMISC = 263, 1, 6, 1
_SO_RCVBUFFORCE, _SO_TIMESTAMPING = 33, 37
_RX_HARDWARE, _RX_SOFTWARE, _SOFTWARE, _RAW_HARDWARE = 1 << 2, 1 << 3, 1 << 4, 1 << 6
_THREE_TIMES = struct.Struct("@6q")  # software, unused, hardware: seconds and nanoseconds each
_ANCILLARY = socket.CMSG_SPACE(_THREE_TIMES.size)


class InterfaceSource:
    """Every frame that passes a network interface, both ways; listening only."""

    def __init__(self, interface: str) -> None:
        """
        Raises:
            BusError: no such interface, it is down, or reading frames is not allowed.
        """
        self.name = interface
        self.ended = False
        self._hardware = False
        self._socket = open_interface(interface, 0)
        try:
            self._reserve()
            stamping = _RX_HARDWARE | _RX_SOFTWARE | _SOFTWARE | _RAW_HARDWARE
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, stamping)
            promiscuous = struct.pack("IHH8s", socket.if_nametoindex(interface), _PACKET_MR_PROMISC, 0, b"")
            self._socket.setsockopt(_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, promiscuous)
            self._socket.bind((interface, _ETH_P_ALL))
            self._wait()
        except OSError as error:
            self._socket.close()
            raise BusError(f"{interface}: {error.strerror}") from error

    def _reserve(self) -> None:
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BYTES)  # over the system's limit
        except PermissionError:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)

    def _wait(self) -> None:
        """Let the kernel wait, not Python, which would ask it twice a frame."""
        self._socket.setblocking(True)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, IDLE_NS // 1000))

    def start(self) -> None:
        """Forget the frames that came while the process was getting ready.

        Raises:
            BusError: the interface went down or away.
        """
        self._socket.setblocking(False)
        try:
            while True:
                self._socket.recv(FRAME_BYTES)
        except BlockingIOError:
            self._wait()
        except OSError as error:
            raise BusError(f"{self.name}: {error.strerror}") from error
        self.dropped()

    def receive(self, buffer: memoryview) -> tuple[int, int, int] | None:
        """(bytes, time in ns, 1 for a frame this host sent) of the next frame; None after a silence.

        Raises:
            BusError: the interface went down or away.
        """
        try:
            size, ancillary, _, address = self._socket.recvmsg_into([buffer], _ANCILLARY)
        except BlockingIOError:
            return None
        except OSError as error:
            raise BusError(f"{self.name}: {error.strerror}") from error
        seconds, nanoseconds, _, _, hard_seconds, hard_nanoseconds = _THREE_TIMES.unpack(ancillary[0][2])
        outgoing = int(address[2] == socket.PACKET_OUTGOING)
        if hard_seconds:
            self._hardware = True
            return size, hard_seconds * NANOSECONDS + hard_nanoseconds, outgoing
        return size, seconds * NANOSECONDS + nanoseconds, outgoing

    def age(self, stamp: int) -> int:
        """Time since the kernel stamped a frame, ns; 0 where the stamp is of the hardware's own clock."""
        return 0 if self._hardware else time.time_ns() - stamp

    def dropped(self) -> int:
        """Frames that the kernel could not keep for us, since the last call."""
        return struct.unpack("II", self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]

    def close(self) -> None:
        self._socket.close()


class FileSource:
    """The frames of a capture at the times it gives them."""

    def __init__(self, path: Path, wait_until: Callable[[int], object], speed: float = 1.0) -> None:
        """wait_until: returns at a time of CLOCK_MONOTONIC, ns."""
        self.name = path.name
        self.ended = False
        self._due = 0
        self._frames = self._read(Capture(path))
        self._wait_until = wait_until
        self._speed = speed
        self._start: tuple[int, int] | None = None

    def start(self) -> None:
        """The first frame is due when it is asked for."""

    @staticmethod
    def _read(capture: Capture) -> Iterator[tuple[bytes, int, int]]:
        for frames in capture.blocks():
            for i in np.flatnonzero(frames.length):
                at = frames.offset[i]
                yield (
                    frames.data[at : at + frames.length[i]][:FRAME_BYTES].tobytes(),
                    int(frames.time[i]),
                    int(frames.port[i]),
                )

    def receive(self, buffer: memoryview) -> tuple[int, int, int] | None:
        """As `InterfaceSource.receive`; None at the end.

        Raises:
            TraceError: the file is no capture.
        """
        following = next(self._frames, None)
        if following is None:
            self.ended = True
            return None
        data, stamp, port = following
        if self._start is None:
            self._start = (time.monotonic_ns(), stamp)
        self._due = self._start[0] + int((stamp - self._start[1]) / self._speed)
        self._wait_until(self._due)
        buffer[: len(data)] = data
        return len(data), stamp, port

    def age(self, stamp: int) -> int:
        """Time since the last frame was due, ns."""
        return time.monotonic_ns() - self._due

    def dropped(self) -> int:
        """Frames lost on the way from a file: none."""
        return 0

    def close(self) -> None:
        pass


class Tap:
    """The loop from frame to published sample, and what it has to say of itself."""

    def __init__(self, source: InterfaceSource | FileSource, robot: Robot, say: Callable[[str], object]) -> None:
        """say: takes a line for the user.

        Raises:
            RobotError: the robot description does not say how to read its bus.
        """
        self.assembler = Assembler(make_layout(robot))
        self._source = source
        self._say = say
        self._frame = np.zeros(1, ONE_FRAME)
        self._frame["layout"], self._frame["state"] = self.assembler.layout, self.assembler.state
        self._frame["sample"] = SAMPLE.empty(1)
        self.assembler.state = self._frame["state"]
        self._record, self._raw = self._frame["sample"], self._frame["raw"]
        self._states = np.full(3, DriveState.UNKNOWN, np.uint16)
        self._standing = HealthFlag(0)  # of the process: real time, declaration
        self._reported = _Reported(self.assembler)
        self._declaration = FirstMotion(robot)
        assemble_one(self._frame)  # a frame of no bytes: the kernel is compiled before the bus is looked at

    def run(
        self,
        put: Callable[[bytes], object],
        health: Health,
        count: int = 0,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        """Publish with `put` until `count` samples are out (0: without end), a capture ends, `stopped`, or Ctrl-C.

        Raises:
            BusError: the interface went down or away.
            TraceError: the file is no capture.
        """
        frame = self._frame
        view, counts, flags = frame["data"][0].data, counts_of(self.assembler.state), self._record["flags"]
        length, at, port = frame["length"], frame["time"], frame["port"]  # to write by name costs three times as much
        self._standing = health.flags
        self._source.start()
        self._reported.sample_ns = time.monotonic_ns()
        health.time_one(0)
        self._tell(health)  # what is called for the first time is slow
        while not (self._source.ended or stopped()):
            got = self._source.receive(view)
            now = time.monotonic_ns()
            if got is not None:
                length[0], at[0], port[0] = got
                if assemble_one(frame):
                    put(self._record.tobytes())
                    health.time_one(self._source.age(got[1]))
                    self._declaration.add(self._record, self._raw)
                    self._reported.sample_ns, self._reported.faulty = now, flags[0] & _FAULT != 0
                    if counts[_SAMPLES] == count:
                        break
                elif now < health.due_ns + OVERDUE_NS and counts[_MISSING] <= MISSING_CYCLES:
                    continue  # its cycle's sample is still to come: all else waits until that is out
            self._judge(health, now)
            if health.due:
                self._tell(health)
            elif now >= self._reported.said_ns + SAY_NS:
                self._say_changes()
        self._tell(health, ended=True)

    def _judge(self, health: Health, now: int) -> None:
        """What stands now; a change is published at once."""
        reported, counts = self._reported, counts_of(self.assembler.state)
        missing = counts[_MISSING] > MISSING_CYCLES
        troubles = int(counts.take(_TROUBLE_COUNTS).sum())
        if troubles > reported.troubles:
            reported.trouble_ns = now
        reported.troubles = troubles
        period = self.assembler.period_ns
        limit = max(STOPPED_CYCLES * period, STOPPED_NS) if period else SILENT_NS
        reported.quiet = now - reported.sample_ns > limit
        standing = int(self._standing)
        if reported.faulty or missing or now < reported.trouble_ns + FAULT_NS:
            standing |= _BUS_FAULT
        if reported.quiet:
            standing |= _STALE_INPUT
        if standing != health.flags:
            health.flags = HealthFlag(standing)

    def _tell(self, health: Health, ended: bool = False) -> None:
        """Publish the state of the bus, and tell the user what has changed."""
        for line in self._declaration.news(ended):
            self._standing |= HealthFlag.WRONG_DECLARATION
            health.flags |= HealthFlag.WRONG_DECLARATION
            self._say(line)
        news = self.assembler.count
        health.publish(
            received=news("sent") + news("returned"),
            published=news("samples"),
            lost=news("lost") + news("missing"),
            repeated=news("repeated"),
            out_of_order=news("backwards"),
            rejected=news("damaged"),
            invalid=news("unanswered"),
        )
        self._say_changes()

    def _say_changes(self) -> None:
        news, reported = self.assembler.count, self._reported
        fresh = {name: news(name) - reported.counts[name] for name in reported.counts}
        reported.counts = {name: news(name) for name in reported.counts}
        reported.said_ns = time.monotonic_ns()
        troubles = [f"{fresh[name]} {text}" for name, text in _TROUBLES.items() if fresh[name] > 0]
        if troubles:
            self._say(f"{self._source.name}: {', '.join(troubles)}")
        dropped = self._source.dropped()
        if dropped:
            self._say(f"{self._source.name}: the kernel dropped {dropped} frames")
        if fresh["samples"]:
            mapped = mapped_inputs(self.assembler.layout)[:, STATUS]
            states = drive_state(self._raw[0, :, STATUS])
            for joint in np.flatnonzero(mapped & (states != self._states)):
                self._say(f"joint {joint + 1}: {DriveState(int(states[joint])).name.lower().replace('_', ' ')}")
            self._states = states
        if reported.quiet and not reported.quiet_said:
            if news("missing") > MISSING_CYCLES:
                why = "frames with process data go out, but none comes back"
            else:
                why = "the frames have stopped" if news("samples") else "no process data of this robot"
            self._say(
                f"{self._source.name}: no sample for {(reported.said_ns - reported.sample_ns) / 1e6:.0f} ms: {why}"
            )
        reported.quiet_said = reported.quiet


_FAULT = SampleFlag.BUS_FAULT.value
_BUS_FAULT, _STALE_INPUT = int(HealthFlag.BUS_FAULT), int(HealthFlag.STALE_INPUT)
_TROUBLES = {
    "counter_faults": "cycles with a working counter too low",
    "lost": "cycles lost",
    "pauses": "pause of the master",
    "incomplete": "cycles incomplete",
    "damaged": "frames damaged",
    "drive_faults": "cycles with a drive in fault",
}


_NAMES = tuple(COUNTS.fields or ())
_SAMPLES, _MISSING = _NAMES.index("samples"), _NAMES.index("missing")
_TROUBLE_COUNTS = np.array([_NAMES.index(name) for name in _TROUBLES if name != "pauses"])


class _Reported:
    """What is known of the bus now, and what of it the user knows already."""

    def __init__(self, assembler: Assembler) -> None:
        self.counts = {name: assembler.count(name) for name in ("samples", *_TROUBLES)}
        self.said_ns = self.sample_ns = time.monotonic_ns()
        self.faulty = self.quiet = self.quiet_said = False
        self.troubles, self.trouble_ns = 0, -FAULT_NS  # how many, and when the last one was
