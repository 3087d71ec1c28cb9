"""The segment: three drives in line on one wire, the plant they move, and the frames that pass through them.

Each cyclic frame (logical read/write in OP) is one cycle: it brings the outputs, the sensors are read, the plant moves
on by one cycle. What was read goes out with the next frame, `INPUT_DELAY_CYCLES` later, as from a drive that is
synchronised to its sync manager. The distributed clock is the plant's clock: it
advances by exactly one cycle with each such frame, so that positions and their stamps belong together whatever the
host's scheduler does. When frames stay away the clock runs on by itself, as a drive would, and the watchdogs see it.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.ethercat import cia402
from drivers.ethercat.cia402 import Mode, Scale
from drivers.ethercat.frames import ETHERTYPE, AlState, Command
from drivers.ethercat.interface import open_interface
from drivers.ethercat.pdo import DIGITAL_OUTPUTS, GRIPPER, Pdo
from drivers.simulated.plant.plant import Plant, Target
from drivers.simulated.segment.drive import SimulatedDrive
from drivers.simulated.segment.esc import Mapping, SlaveController
from drivers.simulated.segment.sii import build_sii
from schemas.errors import BusError
from schemas.messages import SAMPLE, SampleFlag, set_stamp

INPUT_DELAY_CYCLES = 1
FOLLOWING_ERROR = 0.5  # rad
SILENCE = 0.02  # s without a frame after which the clock runs on by itself
REST = 0.5  # s for the arms to come to rest in their brakes
PAGE = 4096  # samples of the trace kept together
PRODUCT, REVISION = 0x00DE17A, 1

_READS = frozenset((Command.APRD, Command.APRW, Command.FPRD, Command.FPRW, Command.BRD, Command.BRW))
_WRITES = frozenset((Command.APWR, Command.APRW, Command.FPWR, Command.FPRW, Command.BWR, Command.BRW))
_BY_POSITION = frozenset((Command.APRD, Command.APWR, Command.APRW, Command.ARMW))
_BROADCAST = frozenset((Command.BRD, Command.BWR, Command.BRW))
_MULTIPLE = frozenset((Command.ARMW, Command.FRMW))
_LRD, _LWR, _LRW = int(Command.LRD), int(Command.LWR), int(Command.LRW)  # the hot path is spared the enumeration
_ETHERTYPE_BYTES = ETHERTYPE.to_bytes(2, "big")
_DATAGRAM = struct.Struct("<BBHHHH")
_WORKING_COUNTER = struct.Struct("<H")


@dataclass
class Switches:
    """Faults to play, settable from another thread while the segment runs."""

    broken_before: int = 0  # cable broken before this drive, 1..3; 0: whole
    silent: int = 0  # bit mask of drives that miss logical datagrams: the working counter falls short
    trip: int = 0  # bit mask of drives to trip once; cleared when done
    product: float = 0.0  # kg that hang on the platform while a drive's 0x60FE has the gripper's bit set


class _Station:
    """One drive on the wire: its controller, its process data, its servo."""

    def __init__(
        self, number: int, rx: Pdo, tx: Pdo, drive: SimulatedDrive, scale: Scale, clock: Callable[[], int]
    ) -> None:
        self.rx, self.tx, self.drive, self.scale = rx, tx, drive, scale
        self.controller = SlaveController(
            build_sii(f"deltatwin drive {number}", PRODUCT, REVISION, number, rx, tx), rx.size, tx.size, clock, False
        )
        control, position, torque, mode = rx.places(
            cia402.CONTROLWORD, cia402.TARGET_POSITION, cia402.TARGET_TORQUE, cia402.MODE_OF_OPERATION
        )
        ahead, offset, digital = rx.places(cia402.POSITION_OFFSET, cia402.TORQUE_OFFSET, DIGITAL_OUTPUTS)
        self._rx_places = (control, mode, position, torque, ahead, offset, digital)
        self._tx_places = tx.places(
            cia402.STATUSWORD,
            cia402.POSITION_ACTUAL,
            cia402.VELOCITY_ACTUAL,
            cia402.TORQUE_ACTUAL,
            cia402.MODE_DISPLAY,
            cia402.DIGITAL_INPUTS,
        )
        self._report = tx.blank()
        self.gripping = False

    def command(self, position: float, period: float) -> None:
        """Outputs to the servo. Without 0x6060 mapped the mode is CSP, as a drive set up by its start-up list."""
        values = self.rx.unpack(self.controller.outputs)
        control, mode, target, torque, ahead, offset, digital = self._rx_places
        wanted = (values[target] if target >= 0 else 0) + (values[ahead] if ahead >= 0 else 0)
        self.gripping = digital >= 0 and bool(values[digital] & GRIPPER)
        self.drive.receive(
            values[control],
            values[mode] if mode >= 0 else Mode.CSP,
            ((wanted + 2**31) & 0xFFFFFFFF) - 2**31,
            values[torque] if torque >= 0 else 0,
            values[offset] if offset >= 0 else 0,
            position,
            period,
        )

    def report(self, position: float, velocity: float, torque: float) -> None:
        """Servo and joint to inputs. A motor without current has no torque, whatever its brake holds."""
        scale, drive = self.scale, self.drive
        counts = round(position / scale.radians_per_count) + scale.zero_counts
        per_mille = round((torque if drive.enabled else 0.0) / scale.torque_nm_per_mille)
        speed = round(velocity / (scale.radians_per_s_per_unit or scale.radians_per_count))
        values = (
            drive.statusword(),
            ((counts + 2**31) & 0xFFFFFFFF) - 2**31,
            min(max(speed, -(2**31)), 2**31 - 1),
            min(max(per_mille, -32768), 32767),
            drive.mode,
            GRIPPER if self.gripping else 0,  # a switch on the gripper, wired to the input of the same number
        )
        for place, value in zip(self._tx_places, values, strict=True):
            if place >= 0:
                self._report[place] = value
        self.controller.inputs[:] = self.tx.pack(self._report)


class EthercatSegment:
    """Three drives and their plant. `exchange` passes a frame through, `advance` moves the plant on by a cycle."""

    def __init__(
        self,
        pdos: Sequence[tuple[Pdo, Pdo]],
        scales: Sequence[Scale],
        plant: Plant,
    ) -> None:
        """`pdos`: (outputs, inputs) of each drive. The plant's period is the cycle.

        Raises:
            RobotError: a drive maps neither control word nor status word, or no position to see it by.
        """
        for rx, tx in pdos:
            rx.require(cia402.CONTROLWORD)
            tx.require(cia402.STATUSWORD, cia402.POSITION_ACTUAL)
        self._plant, self._period = plant, plant.period
        self._period_ns = round(plant.period * 1e9)
        self._payload = 0.0
        self._gains = plant.tuning.velocity_gain.copy()
        self.switches = Switches()
        self._clock_ns = self._seen_ns = time.monotonic_ns()
        self._operating = False
        self.due = False  # a cyclic frame has passed and the plant has not moved on since
        self._wired = 0
        self._pages: list[np.ndarray] = []  # not one array that grows: copying it would hold the bus up
        self.cycles = 0
        self._position = plant.reading.copy()
        self._velocity = np.zeros(3)
        self._torque, self._feedforward = np.zeros(3), np.zeros(3)
        self._start = self._position
        self._stations = [
            _Station(number, rx, tx, SimulatedDrive(scale, FOLLOWING_ERROR, position), scale, lambda: self._clock_ns)
            for number, ((rx, tx), scale, position) in enumerate(
                zip(pdos, scales, self._position.tolist(), strict=True), start=1
            )
        ]
        self._settling = 0  # cycles that the brakes still need
        self._move()  # compiles what a cycle needs
        self._report()

    @property
    def trace(self) -> np.ndarray:
        """The plant's own account, records of `SAMPLE`, one a cycle, stamped with the distributed clock as the cycle
        began: sensors not rounded to the drives' units; the position the drives were heading through at that instant;
        the torque that the bus added. Cycles that no frame brought carry BUS_FAULT."""
        return np.concatenate([SAMPLE.empty(0), *self._pages])[: self.cycles]

    def exchange(self, frame: bytearray, size: int) -> bool:
        """Pass a frame through the drives in place; False when none comes back.

        frame: Ethernet header onwards, `size` bytes of it valid.
        """
        wired = self._wire()
        if not wired or size < 28 or frame[12:14] != _ETHERTYPE_BYTES:
            return False
        frame[6] |= 0x02  # the first slave marks the source address of frames on their way back
        self._tick()
        view = memoryview(frame)
        at, more = 16, True
        while more and at + 12 <= size:
            command, _index, position, offset, flags, _interrupt = _DATAGRAM.unpack_from(frame, at)
            start, end = at + 10, at + 10 + (flags & 0x07FF)
            more = bool(flags & 0x8000)
            if end + 2 > size:
                break
            counter = 0
            if _LRD <= command <= _LRW:
                counter = self._logical(wired, command, position | offset << 16, view[start:end])
            elif command != Command.NOP:
                counter, position = _physical(wired, command, position, offset, view[start:end])
                struct.pack_into("<H", frame, at + 2, position)
            if counter:
                counter += _WORKING_COUNTER.unpack_from(frame, end)[0]
                _WORKING_COUNTER.pack_into(frame, end, counter & 0xFFFF)
            at = end + 2
        return True

    def proceed(self) -> None:
        """What a frame that has gone back sets off."""
        if self.due:
            self.advance()
        self._look()
        self._settle()

    def advance(self) -> None:
        """One cycle: outputs to the drives, sensors are read, the plant moves, the clock goes on by the period."""
        flags = 0 if self.due else SampleFlag.BUS_FAULT
        self.due = False
        switches = self.switches
        for number, station in enumerate(self._stations):
            position = float(self._position[number])
            if switches.trip >> number & 1:
                switches.trip &= ~(1 << number)
                station.drive.trip(position)
            if station.controller.watchdog_expired():
                station.drive.trip(position)
            elif station.controller.state is not AlState.OP:
                station.drive.release(position)
            elif not flags:
                station.command(position, self._period)
        payload = switches.product if any(station.gripping for station in self._stations) else 0.0
        if payload != self._payload:
            self._plant.set_payload(payload)
            self._payload = payload
        self._move()
        self._record(flags)
        self._clock_ns += self._period_ns
        self._report()

    def idle(self) -> None:
        """No frame came for a while: let the cycles that have gone by happen without one."""
        now = time.monotonic_ns()
        while self._operating and now - self._seen_ns >= self._period_ns:
            self._seen_ns += self._period_ns
            self.advance()
            self._look()
        for _ in range(round(SILENCE / self._period)):
            self._settle()

    def _tick(self) -> None:
        """In operation the clock is the plant's, else the host's."""
        now = time.monotonic_ns()
        if not self._operating:
            self._clock_ns += now - self._seen_ns
        self._seen_ns = now

    def _look(self) -> None:
        operating = any(station.controller.state is AlState.OP for station in self._stations)
        if self._operating and not operating:
            for station, position in zip(self._stations, self._position.tolist(), strict=True):
                station.drive.release(position)
            self._settling = round(REST / self._period)
        self._operating = operating

    def _settle(self) -> None:
        """Out of operation: one cycle of coming to rest in the brakes. A cycle a frame, so that frames do not wait."""
        if self._settling and not self._operating:
            self._settling -= 1
            self._move()
            self._report()

    def _move(self) -> None:
        drives = [station.drive for station in self._stations]
        loops, gains = self._plant.drive, self._plant.tuning.velocity_gain
        for joint, drive in enumerate(drives):
            if drive.stiff and not gains[joint]:  # loops closed: they take over the torque that was there
                gains[joint], loops.integral[joint] = self._gains[joint], self._torque[joint] - drive.torque
            elif not drive.stiff:
                gains[joint] = loops.integral[joint] = 0.0
            elif not drive.enabled and self._feedforward[joint]:  # the brake takes over what the bus had added
                loops.integral[joint] += self._feedforward[joint]
            self._feedforward[joint] = drive.torque
        now = Target(np.array([d.start for d in drives]), np.array([d.start_velocity for d in drives]))
        end = Target(np.array([d.target for d in drives]), np.array([d.velocity for d in drives]))
        self._start = now.position
        measured = self._plant.latch(now, end, self._feedforward)
        self._velocity = (measured.position - self._position) / self._period
        self._position, self._torque = measured.position, measured.torque
        self._plant.run()

    def _report(self) -> None:
        for joint, station in enumerate(self._stations):
            station.report(float(self._position[joint]), float(self._velocity[joint]), float(self._torque[joint]))

    def _record(self, flags: int) -> None:
        page, row = divmod(self.cycles, PAGE)
        if page == len(self._pages):
            self._pages.append(SAMPLE.empty(PAGE))
        record = self._pages[page][row]
        set_stamp(record, self._stations[0].controller.system_time)
        record["sequence"] = self.cycles
        record["position"] = self._position
        record["torque"] = self._torque
        record["position_command"] = self._start
        record["torque_command"] = self._feedforward
        record["flags"] = flags
        self.cycles += 1

    def _wire(self) -> list[_Station]:
        broken = self.switches.broken_before
        reachable = broken - 1 if broken else len(self._stations)
        if reachable != self._wired:
            self._wired = reachable
            for number, station in enumerate(self._stations, start=1):
                station.controller.set_port(downstream=number < reachable)
        return self._stations[:reachable]

    def _logical(self, wired: list[_Station], command: int, address: int, data: memoryview) -> int:
        counter, end, silent = 0, address + len(data), self.switches.silent
        for number, station in enumerate(wired):
            controller = station.controller
            if silent >> number & 1 or controller.state < AlState.SAFEOP:
                continue
            if command != _LRD and _transfer(controller.output_mappings, address, end, data, controller.memory, True):
                counter += 2 if command == _LRW else 1
                controller.outputs_written()
                self.due |= controller.state is AlState.OP
            if command != _LWR and _transfer(controller.input_mappings, address, end, data, controller.memory, False):
                counter += 1
        return counter


def _transfer(
    mappings: tuple[Mapping, ...], start: int, end: int, data: memoryview, memory: bytearray, write: bool
) -> bool:
    """Move what FMMUs map of the logical bytes [start, end) between datagram and memory; whether there was any."""
    moved = False
    for mapping in mappings:
        first, last = max(mapping.start, start), min(mapping.end, end)
        if first < last:
            physical = mapping.physical + first - mapping.start
            if write:
                memory[physical : physical + last - first] = data[first - start : last - start]
            else:
                data[first - start : last - start] = memory[physical : physical + last - first]
            moved = True
    return moved


def _physical(wired: list[_Station], command: int, position: int, offset: int, data: memoryview) -> tuple[int, int]:
    """Register access: what it adds to the working counter, and the address field as the last slave leaves it."""
    counter = 0
    for station in wired:
        controller = station.controller
        if command in _BROADCAST:
            addressed, position = True, position + 1 & 0xFFFF
        elif command in _BY_POSITION:
            addressed, position = position == 0, position + 1 & 0xFFFF
        else:
            addressed = position == controller.station_address
        multiple = command in _MULTIPLE
        if not addressed and not multiple:
            continue
        incoming = bytes(data)
        if command in _READS or (multiple and addressed):
            content = controller.read(offset, len(data))
            if content is not None:
                counter += 1
                data[:] = content if command not in _BROADCAST else bytes(map(int.__or__, incoming, content))
        if (command in _WRITES or (multiple and not addressed)) and controller.write(offset, memoryview(incoming)):
            counter += 2 if command in _READS else 1
    return counter, position


def serve(interface: str, segment: EthercatSegment, stopping: Callable[[], bool]) -> None:
    """Be the segment at the far end of `interface` until `stopping`.

    Raises:
        BusError: the interface does not exist, is down, or may not be opened.
    """
    frame = bytearray(1600)
    view = memoryview(frame)
    with open_interface(interface, ETHERTYPE) as wire:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, round(SILENCE * 1e6)))
        while not stopping():
            try:
                size = wire.recv_into(frame)
            except BlockingIOError:
                segment.idle()
                continue
            except OSError as error:
                raise BusError(f"{interface}: {error.strerror}") from error
            if segment.exchange(frame, size):
                wire.send(view[:size])
            segment.proceed()
