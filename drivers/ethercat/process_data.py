"""Process data to joint samples: which bytes are which object, which pass is believed, what the cycle's time is.

One kernel, `assemble`, serves the capture reader (a block of frames a call) and the live tap (one frame a call).

Which pass is believed. Every cyclic frame can be seen twice: as the master sent it, working counter 0, its input bytes
left over from the cycle before; and as it came back, with the inputs of this cycle. Only a returned frame gives inputs.
Commands are read from the same returned frame, unless inputs and outputs share logical addresses: there the inputs
have overwritten them, and they come from the sent frame of the same datagram index.

What tells the passes apart, in this order: a working counter above 0 is a returned frame; so is the source address with
the bit that the first slave sets, where the master's own address has it clear; so is a port of the analyzer that has
only ever seen answered frames; so is the second sight of one datagram index. Between two slaves both passes are
answered: there the port with the smaller working counter is the way out.

What a missing pass does. A sample's values depend on the frames of its own cycle alone, so two recordings of one bus
that miss different frames agree on every cycle both saw. Returned pass missing: no sample, GAP_BEFORE on the next one,
counted as lost. Sent pass missing: nothing where addresses are not shared; where they are, the sample has no command
(NaN, NO_COMMAND), never that of another cycle: an index comes again, so a sent frame counts for `_FLIGHT` of a cycle.

Time is the distributed clock's where the frame of the first cycle carries it, else the capture's own, of the returned
frame, for the whole stream. Cycles in which the clock's datagram is missing go on by the capture's clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from drivers.ethercat import cia402
from drivers.ethercat.capture import FrameFlag, Frames
from drivers.ethercat.cia402 import DriveState, Mode, scales
from drivers.ethercat.eni import MappedObject, Network, read_eni, slave_objects
from drivers.ethercat.frames import DC_SYSTEM_TIME, Command, Kind, find_datagrams, u16, u32
from schemas.errors import RobotError
from schemas.messages import NANOSECONDS, SAMPLE, SampleFlag
from schemas.robot import JointDrive, Robot

INPUTS = (
    cia402.STATUSWORD, cia402.POSITION_ACTUAL, cia402.VELOCITY_ACTUAL, cia402.TORQUE_ACTUAL, cia402.MODE_DISPLAY,
)  # fmt: skip
OUTPUTS = (
    cia402.CONTROLWORD, cia402.TARGET_POSITION, cia402.TARGET_TORQUE, cia402.TORQUE_OFFSET, cia402.MODE_OF_OPERATION,
)  # fmt: skip
REQUIRED = (cia402.POSITION_ACTUAL, cia402.TORQUE_ACTUAL)
_STATUS, _POSITION, _VELOCITY, _TORQUE, _MODE_DISPLAY = range(len(INPUTS))
_CONTROL, _TARGET_POSITION, _TARGET_TORQUE, _TORQUE_OFFSET, _MODE = range(len(OUTPUTS))
NOT_MAPPED = -1

STOPPED_CYCLES, STOPPED_NS = 20, 20_000_000  # without a frame for the longer of the two: they have stopped
GAP_PERIODS = 1.5  # a step of the stamps above this many cycles has lost cycles
_INTERVALS = 64  # cycles whose median step is the cycle time
_PERIOD_AFTER = 16  # cycles before the cycle time is known
_CATCH_UP = 64  # cycles after a gap in which late ones can turn out not to be lost
_PORT_AFTER = 16  # answered frames before a port is taken for the returning one
_BELIEVED_AFTER = 4  # cycles with one higher working counter before it is what is expected
_FLIGHT = 0.75  # of a cycle: a frame that was sent longer ago is not the one that comes back


class Layout(NamedTuple):
    """Where the objects lie and what their units are, as the kernel wants it.

    inputs, outputs: (3, 5) int64 logical byte address of each of INPUTS and OUTPUTS, NOT_MAPPED where it is not.
    input_bytes, output_bytes: (5, 2) int64 size in bytes, and 1 where signed. counters: (M, 3) int64 command, logical
    address and working counter that an ENI demands. zero_counts, radians_per_count, torque_nm_per_mille: (3,).
    shared: whether inputs and outputs share logical addresses.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    input_bytes: np.ndarray
    output_bytes: np.ndarray
    counters: np.ndarray
    zero_counts: np.ndarray
    radians_per_count: np.ndarray
    torque_nm_per_mille: np.ndarray
    shared: bool


class Columns(NamedTuple):
    """The fields of SAMPLE records as arrays, (N,) or (N, 3), that look into the records' own bytes."""

    stamp_sec: np.ndarray
    stamp_nanosec: np.ndarray
    sequence: np.ndarray
    position: np.ndarray
    torque: np.ndarray
    position_command: np.ndarray
    torque_command: np.ndarray
    flags: np.ndarray


def columns_of(records: np.ndarray) -> Columns:
    """Views of (N,) records of SAMPLE; writing to them writes the records."""
    return Columns(*(records[name] for name in Columns._fields))


class Count(NamedTuple):
    """What `assemble` has counted since its state was made; indexes into `State.counts`."""

    samples: int = 0
    sent: int = 1  # frames with process data on their way out
    returned: int = 2
    counter_faults: int = 3  # cycles whose working counter was too low
    unanswered: int = 4  # of these: nobody answered
    not_enabled: int = 5  # cycles in which a drive was not in operation
    drive_faults: int = 6  # of these: in fault
    gaps: int = 7  # samples that came later than the next cycle
    lost: int = 8  # cycles missing in the gaps, without those that only were late
    incomplete: int = 9  # cycles of which a part never came
    damaged: int = 10  # frames left out: marked by the analyzer, snapped, or not as long as they say
    backwards: int = 11
    repeated: int = 12
    pauses: int = 13  # gaps in which the master sent nothing
    missing: int = 14  # cycles since the last sample that were sent and did not come back


COUNT = Count()


class State(NamedTuple):
    """What the kernel remembers from frame to frame."""

    counts: np.ndarray  # (len(Count),) int64
    clock: np.ndarray  # (18,) int64, by the names below
    intervals: np.ndarray  # (_INTERVALS,) int64, ns
    raw_inputs: np.ndarray  # (3, 5) int64 of the cycle in the making
    have_inputs: np.ndarray  # (3, 5) bool
    last_inputs: np.ndarray  # (3, 5) int64 of the cycle before
    raw_outputs: np.ndarray  # (3, 5) int64
    have_outputs: np.ndarray  # (3, 5) bool
    sent_outputs: np.ndarray  # (256, 3, 5) int64, by datagram index
    outputs_at: np.ndarray  # (256, 3, 5) int64, ns, when they were sent, _NEVER once they came back
    sent_at: np.ndarray  # (256,) int64, ns, by datagram index: when a frame was sent, _NEVER once it came back
    counters: (
        np.ndarray
    )  # (16, 5) int64: command, logical address, highest working counter seen; a higher one, how often
    ports: np.ndarray  # (256, 3) int64: answered frames, silent frames, highest working counter


(
    _LAST, _PERIOD, _DC_MODE, _DC_LAST, _DC_OFFSET, _DC_NOW, _PLAIN_SEEN, _FAULT, _HIGHEST, _OWED, _SLIP, _SINCE,
    _STEPS, _SENT, _SENT_INDEX, _SENT_NS,
    _BACK_INDEX, _BACK_NS,
) = range(18)  # fmt: skip
_UNDECIDED, _CAPTURE_CLOCK, _DISTRIBUTED_CLOCK = range(3)
_COUNTER_LOW, _COUNTER_ZERO = 1, 2
_NEVER = -(1 << 62)


def new_state() -> State:
    """A state that has seen nothing."""
    objects = (3, len(INPUTS))
    return State(
        counts=np.zeros(len(Count()), np.int64),
        clock=np.zeros(18, np.int64),
        intervals=np.zeros(_INTERVALS, np.int64),
        raw_inputs=np.zeros(objects, np.int64),
        have_inputs=np.zeros(objects, np.bool_),
        last_inputs=np.zeros(objects, np.int64),
        raw_outputs=np.zeros(objects, np.int64),
        have_outputs=np.zeros(objects, np.bool_),
        sent_outputs=np.zeros((256, *objects), np.int64),
        outputs_at=np.full((256, *objects), _NEVER, np.int64),
        sent_at=np.full(256, _NEVER, np.int64),
        counters=np.zeros((16, 5), np.int64),
        ports=np.zeros((256, 3), np.int64),
    )


def make_layout(robot: Robot) -> Layout:
    """The layout that a robot description declares, itself or by the ENI file it names.

    Raises:
        RobotError: a drive, its scaling or an object is not declared, or the ENI file is wrong.
    """
    scaling = scales(robot.drive)
    network = read_eni(robot.folder / robot.drive.eni) if robot.drive.eni else None
    inputs = np.full((3, len(INPUTS)), NOT_MAPPED, np.int64)
    outputs = np.full((3, len(OUTPUTS)), NOT_MAPPED, np.int64)
    for joint, drive in enumerate(robot.drive.joint):
        mapped_inputs, mapped_outputs = _mapped(drive, joint, network)
        for row, known, mapped in ((inputs[joint], INPUTS, mapped_inputs), (outputs[joint], OUTPUTS, mapped_outputs)):
            for mapped_object in mapped:
                if mapped_object.index in known:
                    row[known.index(mapped_object.index)] = _byte_address(mapped_object, joint)
        for index in REQUIRED:
            if inputs[joint, INPUTS.index(index)] == NOT_MAPPED:
                raise RobotError(f"drive.joint.{joint}.inputs: {index:#06x} is not mapped, a sample needs it")
    commands = () if network is None else network.commands
    counters = [(c.command, c.address, c.working_counter) for c in commands if c.working_counter is not None]
    return Layout(
        inputs=inputs,
        outputs=outputs,
        input_bytes=_sizes(INPUTS),
        output_bytes=_sizes(OUTPUTS),
        counters=np.array(counters, np.int64).reshape(-1, 3),
        zero_counts=np.array([scale.zero_counts for scale in scaling], np.int64),
        radians_per_count=np.array([scale.radians_per_count for scale in scaling]),
        torque_nm_per_mille=np.array([scale.torque_nm_per_mille for scale in scaling]),
        shared=_shared(inputs, outputs),
    )


def mapped_objects(layout: Layout) -> list[dict[str, int | str]]:
    """The objects of a layout in the order of their addresses: joint, object, direction, logical_address."""
    places = [
        (int(places[joint, item]), joint + 1, f"{index:#06x}", direction)
        for places, indexes, direction in ((layout.inputs, INPUTS, "input"), (layout.outputs, OUTPUTS, "output"))
        for item, index in enumerate(indexes)
        for joint in range(3)
        if places[joint, item] != NOT_MAPPED
    ]
    return [
        {"joint": joint, "object": index, "direction": direction, "logical_address": place}
        for place, joint, index, direction in sorted(places)
    ]


def _mapped(
    drive: JointDrive, joint: int, network: Network | None
) -> tuple[tuple[MappedObject, ...], tuple[MappedObject, ...]]:
    if drive.inputs_address is not None:
        return (
            _declared(drive.inputs, drive.inputs_address, f"drive.joint.{joint}.inputs"),
            _declared(drive.outputs, drive.outputs_address or 0, f"drive.joint.{joint}.outputs"),
        )
    if network is None:
        raise RobotError(
            f"drive.joint.{joint}.inputs: missing key: say what the drive maps, or name an ENI file in drive.eni"
        )
    slave = slave_objects(network, drive.station, f"drive.joint.{joint}.station")
    return slave.inputs, slave.outputs


def _declared(entries: list[str], address: int, key: str) -> tuple[MappedObject, ...]:
    objects, bit = [], address * 8
    for entry in entries:
        index, bits = cia402.parse_object(entry, key)
        objects.append(MappedObject(index, bits, bit))
        bit += bits
    return tuple(objects)


def _byte_address(mapped: MappedObject, joint: int) -> int:
    size = cia402.OBJECTS[mapped.index].itemsize * 8
    if mapped.address_bits % 8 or mapped.bits != size:
        raise RobotError(
            f"drive.joint.{joint}: {mapped.index:#06x} is mapped with {mapped.bits} bits at bit "
            f"{mapped.address_bits % 8} of a byte; {size} whole bits are needed"
        )
    return mapped.address_bits // 8


def _sizes(indexes: tuple[int, ...]) -> np.ndarray:
    types = [cia402.OBJECTS[index] for index in indexes]
    return np.array([(kind.itemsize, kind.kind == "i") for kind in types], np.int64)


def _shared(inputs: np.ndarray, outputs: np.ndarray) -> bool:
    taken: list[set[int]] = []
    for addresses, indexes in ((inputs, INPUTS), (outputs, OUTPUTS)):
        sizes = _sizes(indexes)[:, 0]
        taken.append(
            {int(a) + k for row in addresses for a, n in zip(row, sizes, strict=True) if a >= 0 for k in range(n)}
        )
    return bool(taken[0] & taken[1])


@njit(cache=True)
def _value(data, at, size, signed):
    value = np.int64(0)
    for byte in range(size):
        value |= np.int64(data[at + byte]) << (8 * byte)
    if signed and value >> (8 * size - 1):
        value -= np.int64(1) << (8 * size)
    return value


@njit(cache=True)
def _take(data, at, address, length, places, sizes, values, have, mark):
    """Objects that lie in the logical range [address, address + length), whose bytes are at `at`; how many joints.

    have: takes `mark` for each of them.
    """
    joints = 0
    for joint in range(3):
        found = False
        for item in range(places.shape[1]):
            place = places[joint, item]
            if place >= address and place + sizes[item, 0] <= address + length:
                values[joint, item] = _value(data, at + place - address, sizes[item, 0], sizes[item, 1] == 1)
                have[joint, item] = mark
                found = True
        joints += found
    return joints


@njit(cache=True)
def _joints_within(address, length, places):
    joints = 0
    for joint in range(3):
        for item in range(places.shape[1]):
            if places[joint, item] >= address and places[joint, item] < address + length:
                joints += 1
                break
    return joints


@njit(cache=True)
def _expected(command, address, least, counter, declared, seen):
    """Working counter this datagram should have: at least what the drives add, an ENI's, and the highest seen.

    That one some times in a row: a single one may be a corrupted frame's, and would be missed ever after.
    """
    for row in range(len(declared)):
        if declared[row, 0] == command and declared[row, 1] == address:
            return declared[row, 2]
    for row in range(len(seen)):
        if seen[row, 2] == 0 or (seen[row, 0] == command and seen[row, 1] == address):
            seen[row, 0], seen[row, 1], seen[row, 2] = command, address, max(seen[row, 2], least)
            if counter > seen[row, 2]:
                seen[row, 4] = seen[row, 4] + 1 if counter == seen[row, 3] else 1
                seen[row, 3] = counter
                if seen[row, 4] >= _BELIEVED_AFTER:
                    seen[row, 2] = counter
            else:
                seen[row, 4] = 0
            return seen[row, 2]
    return least


@njit(cache=True)
def _is_returned(source, port, outstanding, answered, highest, ports, clock):
    """Whether a frame with process data is on its way back, and what it teaches about telling that.

    source: first byte of the source address. outstanding: whether a datagram of this index is on its way.
    """
    if answered:
        ports[port, 0] += 1
        ports[port, 2] = max(ports[port, 2], highest)
        clock[_HIGHEST] = max(clock[_HIGHEST], highest)
        return ports[port, 2] == clock[_HIGHEST]
    local = source & 2 != 0
    returned = local and (
        clock[_PLAIN_SEEN] == 1 or (ports[port, 0] >= _PORT_AFTER and ports[port, 1] == 0) or outstanding
    )
    if not local:
        clock[_PLAIN_SEEN] = 1
    if not returned:
        ports[port, 1] += 1
    return returned


@njit(cache=True)
def _stamp(time, clock):
    """Bus time of the cycle that this frame completes, ns; `time` is the capture's."""
    ticks = clock[_DC_NOW]
    clock[_DC_NOW] = 0
    if clock[_DC_MODE] == _UNDECIDED:
        clock[_DC_MODE] = _DISTRIBUTED_CLOCK if ticks != 0 else _CAPTURE_CLOCK
    if clock[_DC_MODE] == _CAPTURE_CLOCK:
        return time
    if ticks != 0 and ticks != clock[_DC_LAST]:
        clock[_DC_LAST] = ticks
        clock[_DC_OFFSET] = ticks - time
    return time + clock[_DC_OFFSET]


@njit(cache=True)
def _on_its_way(sent_at, time, clock):
    """Whether what was sent at `sent_at` and has not come back can come back at `time`, both ns of the capture."""
    return sent_at != _NEVER and (clock[_PERIOD] == 0 or time - sent_at < _FLIGHT * clock[_PERIOD])


@njit(cache=True)
def _distributed_clock(data, at, length, time, clock):
    """System time of the reference clock, ns since 2000; 32-bit clocks are continued over their wraps.

    time: ns of the capture, whose clock tells how often a 32-bit one has wrapped since it was last read.
    """
    low = u32(data, at)
    high = u32(data, at + 4) if length >= 8 else 0
    if high or not clock[_DC_LAST]:
        return low | (high << 32)
    expected = time + clock[_DC_OFFSET]
    return expected + ((low - expected + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)


@njit(cache=True)
def _interval_flags(stamp, clock, counts, intervals):
    """Flags of the step from the last stamp to this one; keeps the cycle time."""
    flags = 0
    number = counts[COUNT.samples]
    step = stamp - clock[_LAST]
    clock[_LAST] = stamp
    if number == 0:
        return flags
    if step < 0:
        counts[COUNT.backwards] += 1
        return SampleFlag.TIME_BACKWARDS.value
    period = clock[_PERIOD]
    catching_up = clock[_OWED] > 0 and number - clock[_SINCE] < _CATCH_UP
    if period > 0 and step > GAP_PERIODS * period:
        flags = SampleFlag.GAP_BEFORE.value
        lost = max((step + period // 2) // period - 1, 1)
        counts[COUNT.gaps] += 1
        if counts[COUNT.sent] > 0 and step >= max(STOPPED_CYCLES * period, STOPPED_NS):  # what was sent tells
            unanswered = min(max(clock[_SENT] - 1, 0), lost)
            counts[COUNT.pauses] += lost - unanswered >= STOPPED_CYCLES
            counts[COUNT.lost] += unanswered
            return flags
        counts[COUNT.lost] += lost
        if not catching_up:
            clock[_OWED], clock[_SLIP] = 0, 0
        clock[_OWED] += lost
        clock[_SLIP] += step - (lost + 1) * period
        clock[_SINCE] = number
    elif catching_up:
        clock[_SLIP] += step - period
        if 2 * clock[_SLIP] < -period:  # nothing was lost: that cycle was late, and those behind it caught up
            clock[_SLIP] += period
            clock[_OWED] -= 1
            counts[COUNT.lost] -= 1
    if step == 0:
        counts[COUNT.repeated] += 1
        return SampleFlag.REPEATED.value
    if not catching_up or 2 * step > period:  # cycles that run after a stall say nothing of the cycle time
        steps = clock[_STEPS]
        intervals[steps % _INTERVALS] = step
        clock[_STEPS] = steps + 1
        if (steps + 1) % _PERIOD_AFTER == 0:
            clock[_PERIOD] = np.int64(np.median(intervals[: min(steps + 1, _INTERVALS)]))
    return flags


@njit(cache=True)
def _follow(times, clock, counts, intervals):
    for time in times:
        _interval_flags(time, clock, counts, intervals)
        counts[COUNT.samples] += 1


def lost_cycles(times: np.ndarray) -> int:
    """Cycles missing among (N,) int64 ns of one cyclic frame, without those that only were late."""
    state = new_state()
    _follow(times, state.clock, state.counts, state.intervals)
    return int(state.counts[COUNT.lost])


@njit(cache=True)
def _drive_flags(places, inputs, counts):
    """Flags of the drives' states in the cycle in the making. places: `Layout.inputs`; inputs: (3, 5) values."""
    enabled, fault = True, False
    for joint in range(3):
        if places[joint, _STATUS] != NOT_MAPPED:
            found = cia402.STATE_OF_BITS[inputs[joint, _STATUS] & 0x7F]
            enabled &= found == DriveState.OPERATION_ENABLED.value
            fault |= found == DriveState.FAULT.value or found == DriveState.FAULT_REACTION_ACTIVE.value
    counts[COUNT.not_enabled] += not enabled
    counts[COUNT.drive_faults] += fault
    return 0 if enabled else SampleFlag.BUS_FAULT.value


@njit(cache=True)
def _torque_command(mode, has_mode, target, has_target, offset, has_offset):
    """Torque the master asks of a drive, in 0.1 % units, NaN where it asks for none.

    The target torque counts in torque mode only; the offset counts in every cyclic mode.
    """
    asked = np.nan
    if has_target and (not has_mode or mode == Mode.CST.value):
        asked = float(target)
    if has_offset:
        asked = float(offset) if np.isnan(asked) else asked + offset
    return asked


@njit(cache=True)
def _emit(time, layout, state, samples, raw, row):
    """Write the complete cycle into row `row` of `samples` and its inputs as they stand into that of `raw`."""
    counts, clock = state.counts, state.clock
    inputs, outputs, have_outputs = state.raw_inputs, state.raw_outputs, state.have_outputs
    stamp = _stamp(time, clock)
    fault = clock[_FAULT]
    flags = _interval_flags(stamp, clock, counts, state.intervals) | _drive_flags(layout.inputs, inputs, counts)
    if fault:
        counts[COUNT.counter_faults] += 1
        flags |= SampleFlag.BUS_FAULT.value
    if fault == _COUNTER_ZERO:
        counts[COUNT.unanswered] += 1
        flags |= SampleFlag.NOT_A_NUMBER.value
    samples.stamp_sec[row] = stamp // NANOSECONDS
    samples.stamp_nanosec[row] = stamp % NANOSECONDS
    samples.sequence[row] = counts[COUNT.samples]
    for joint in range(3):
        scale, zero = layout.radians_per_count[joint], layout.zero_counts[joint]
        torque_scale = layout.torque_nm_per_mille[joint]
        position, torque, position_command = np.nan, np.nan, np.nan
        if fault != _COUNTER_ZERO:
            position = cia402.joint_angle(inputs[joint, _POSITION], zero, scale)
            torque = inputs[joint, _TORQUE] * torque_scale
        if have_outputs[joint, _TARGET_POSITION]:
            position_command = cia402.joint_angle(outputs[joint, _TARGET_POSITION], zero, scale)
        else:
            flags |= SampleFlag.NO_COMMAND.value
        samples.position[row, joint] = position
        samples.torque[row, joint] = torque
        samples.position_command[row, joint] = position_command
        displayed = layout.inputs[joint, _MODE_DISPLAY] != NOT_MAPPED
        samples.torque_command[row, joint] = torque_scale * _torque_command(
            inputs[joint, _MODE_DISPLAY] if displayed else outputs[joint, _MODE],
            displayed or have_outputs[joint, _MODE],
            outputs[joint, _TARGET_TORQUE],
            have_outputs[joint, _TARGET_TORQUE],
            outputs[joint, _TORQUE_OFFSET],
            have_outputs[joint, _TORQUE_OFFSET],
        )
    samples.flags[row] = flags
    raw[row] = inputs
    counts[COUNT.samples] += 1
    clock[_FAULT] = 0
    state.have_inputs[:] = False
    have_outputs[:] = False
    clock[_SENT] = counts[COUNT.missing] = 0


@njit(cache=True)
def _note_sent(index, time, state):
    """A cycle is on its way out. What was out before it and brings no sample is missing; a frame seen twice is one."""
    clock, counts = state.clock, state.counts
    if clock[_SENT] > 0 and index == clock[_SENT_INDEX] and _on_its_way(clock[_SENT_NS], time, clock):
        return
    counts[COUNT.missing] = clock[_SENT]
    clock[_SENT] += 1
    clock[_SENT_INDEX], clock[_SENT_NS] = index, time


@njit(cache=True)
def _scan(data, first, end, inputs, outputs):
    """(whole, process data inside, answered, highest working counter of it, first index) of a frame's datagrams."""
    at, more = first, True
    carries, answered, highest, index = False, False, np.int64(0), np.int64(-1)
    while more:
        if at + 10 > end:
            return False, carries, answered, highest, index
        head = u16(data, at + 6)
        tail = at + 10 + (head & 0x7FF)
        if tail + 2 > end:
            return False, carries, answered, highest, index
        counter = u16(data, tail)
        answered |= counter > 0
        command = data[at]
        if command == Command.LRD.value or command == Command.LWR.value or command == Command.LRW.value:
            address, length = u32(data, at + 2), head & 0x7FF
            if _joints_within(address, length, inputs) or _joints_within(address, length, outputs):
                if not carries:
                    index = np.int64(data[at + 1])
                carries = True
                highest = max(highest, counter)
        more = head & 0x8000 != 0
        at = tail + 2
    return True, carries, answered, highest, index


@njit(cache=True)
def _read_frame(data, first, end, returned, time, layout, state):
    """Take the objects of one whole frame, captured at `time`, ns, into the cycle in the making."""
    at, more = first, True
    while more:
        head = u16(data, at + 6)
        length = head & 0x7FF
        command, index, body = data[at], data[at + 1], at + 10
        counter = u16(data, body + length)
        address = u32(data, at + 2)
        reads = command == Command.LRD.value or command == Command.LRW.value
        writes = command == Command.LWR.value or command == Command.LRW.value
        if (reads or writes) and not returned:
            state.sent_at[index] = time
            place = layout.inputs[0, _POSITION]
            if reads and place >= address and place < address + length:
                _note_sent(index, time, state)
        if writes and not returned:
            _take(data, body, address, length, layout.outputs, layout.output_bytes,
                  state.sent_outputs[index], state.outputs_at[index], time)  # fmt: skip
        elif returned and (reads or writes):
            state.sent_at[index] = _NEVER
            joints_in = _joints_within(address, length, layout.inputs) if reads else 0
            joints_out = _joints_within(address, length, layout.outputs) if writes else 0
            if joints_in and _starts_again(address, length, layout.inputs, state.have_inputs):
                state.counts[COUNT.incomplete] += 1
                state.have_inputs[:] = False
                state.clock[_FAULT] = 0
            if joints_in or joints_out:
                least = joints_in + joints_out * (2 if reads else 1)
                if counter < _expected(command, address, least, counter, layout.counters, state.counters):
                    fault = _COUNTER_ZERO if counter == 0 and joints_in else _COUNTER_LOW
                    state.clock[_FAULT] = max(state.clock[_FAULT], fault)
            if reads:
                _take(data, body, address, length, layout.inputs, layout.input_bytes,
                      state.raw_inputs, state.have_inputs, True)  # fmt: skip
            if writes and reads and layout.shared:
                _take_sent(index, time, state)
            elif writes:
                _take(data, body, address, length, layout.outputs, layout.output_bytes,
                      state.raw_outputs, state.have_outputs, True)  # fmt: skip
        elif returned and counter > 0 and length >= 4 and address >> 16 == DC_SYSTEM_TIME and command != _FPWR:
            state.clock[_DC_NOW] = _distributed_clock(data, body, length, time, state.clock)
        more = head & 0x8000 != 0
        at = body + length + 2


_FPWR = Command.FPWR.value


@njit(cache=True)
def _starts_again(address, length, places, have):
    """Whether this datagram brings an input that the cycle in the making has already."""
    for joint in range(3):
        for item in range(places.shape[1]):
            place = places[joint, item]
            if have[joint, item] and place >= address and place < address + length:
                return True
    return False


@njit(cache=True)
def _take_sent(index, time, state):
    for joint in range(3):
        for item in range(state.raw_outputs.shape[1]):
            if _on_its_way(state.outputs_at[index, joint, item], time, state.clock):
                state.raw_outputs[joint, item] = state.sent_outputs[index, joint, item]
                state.have_outputs[joint, item] = True
            state.outputs_at[index, joint, item] = _NEVER


@njit(cache=True)
def _complete(places, have):
    for joint in range(3):
        for item in range(places.shape[1]):
            if places[joint, item] != NOT_MAPPED and not have[joint, item]:
                return False
    return True


@njit(cache=True)
def _came_again(index, time, state):
    """Whether the frame of the last cycle has come back twice: same index and inputs, too soon to be the next."""
    clock = state.clock
    again = index == clock[_BACK_INDEX] and _on_its_way(clock[_BACK_NS], time, clock) and clock[_PERIOD] > 0
    for joint in range(3):
        for item in range(state.raw_inputs.shape[1]):
            again &= state.raw_inputs[joint, item] == state.last_inputs[joint, item]
            state.last_inputs[joint, item] = state.raw_inputs[joint, item]
    clock[_BACK_INDEX], clock[_BACK_NS] = index, time
    return again


@njit(cache=True)
def assemble(data, offset, length, time, port, flags, layout, state, samples, raw):
    """Samples of the cycles that end in these frames; how many.

    data, offset, length, time, port, flags: as in `capture.Frames`, N frames. samples: `Columns` of at
    least N rows. raw: at least (N, 3, 5) int64, INPUTS of each sample as they stood in the frame.
    """
    made = 0
    for frame in range(len(offset)):
        if flags[frame] & _NOT_BELIEVED:
            state.counts[COUNT.damaged] += flags[frame] & FrameFlag.DAMAGED.value != 0
            continue
        kind, first, end = find_datagrams(data, offset[frame], length[frame])
        if kind != Kind.DATAGRAMS.value:
            state.counts[COUNT.damaged] += kind == Kind.CUT.value
            continue
        whole, carries, answered, highest, index = _scan(data, first, end, layout.inputs, layout.outputs)
        if not whole:
            state.counts[COUNT.damaged] += 1
            continue
        if not carries:
            continue
        outstanding = _on_its_way(state.sent_at[index], time[frame], state.clock)
        returned = _is_returned(
            data[offset[frame] + 6], port[frame], outstanding, answered, highest, state.ports, state.clock
        )
        state.counts[COUNT.returned if returned else COUNT.sent] += 1
        _read_frame(data, first, end, returned, time[frame], layout, state)
        if returned and _complete(layout.inputs, state.have_inputs):
            again = _came_again(index, time[frame], state)
            _emit(time[frame], layout, state, samples, raw, made)
            if again and samples.flags[made] & SampleFlag.REPEATED.value == 0:
                samples.flags[made] |= SampleFlag.REPEATED.value
                state.counts[COUNT.repeated] += 1
            made += 1
    return made


_NOT_BELIEVED = (FrameFlag.DAMAGED | FrameFlag.PSEUDO | FrameFlag.FOREIGN).value


@dataclass
class Assembler:
    """Turns blocks of frames into samples; remembers what it has to from block to block."""

    layout: Layout
    state: State = field(default_factory=new_state)

    def samples(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """(M,) records of SAMPLE and (M, 3, 5) int64 of their INPUTS in drive units, from N frames, M <= N."""
        records = SAMPLE.empty(len(frames))
        raw = np.empty((len(frames), 3, len(INPUTS)), np.int64)
        made = assemble(
            frames.data, frames.offset, frames.length, frames.time, frames.port, frames.flags,
            self.layout, self.state, columns_of(records), raw,
        )  # fmt: skip
        return records[:made], raw[:made]

    def count(self, name: str) -> int:
        """One of the fields of `Count`."""
        return int(self.state.counts[getattr(COUNT, name)])

    @property
    def period_ns(self) -> int:
        """Cycle time, ns: median of the last cycles; 0 while unknown."""
        return int(self.state.clock[_PERIOD])

    @property
    def distributed_clock(self) -> bool:
        """Whether the stamps are the distributed clock's."""
        return bool(self.state.clock[_DC_MODE] == _DISTRIBUTED_CLOCK)
