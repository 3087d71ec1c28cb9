"""Frames to samples, one a cycle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from drivers.ethercat import cia402
from drivers.ethercat.capture import FrameFlag, Frames
from drivers.ethercat.cia402 import DriveState, Mode
from drivers.ethercat.frames import DC_SYSTEM_TIME, Command, Kind, find_datagrams, u16, u32
from drivers.ethercat.process_data.cycle_clock import distributed_clock_kernel, interval_kernel, stamp_kernel
from drivers.ethercat.process_data.frame_state import DISTRIBUTED_CLOCK, NEVER, STATE, new_state
from drivers.ethercat.process_data.object_layout import (
    DIGITAL_INPUTS,
    INPUT_SHAPE,
    LAYOUT,
    MODE,
    MODE_DISPLAY,
    NOT_MAPPED,
    POSITION,
    STATUS,
    TARGET_POSITION,
    TARGET_TORQUE,
    TORQUE,
    TORQUE_OFFSET,
)  # fmt: skip
from drivers.ethercat.process_data.passes import came_again, expected_kernel, is_returned, note_sent, on_its_way
from schemas.kernels import kernel
from schemas.messages import NANOSECONDS, SAMPLE, Gripper, SampleFlag

FRAME_BYTES = 2048  # more than an Ethernet frame with tags

_COUNTER_LOW, _COUNTER_ZERO = 1, 2
_FPWR = Command.FPWR.value
_NOT_BELIEVED = (FrameFlag.DAMAGED | FrameFlag.PSEUDO | FrameFlag.FOREIGN | FrameFlag.REPEATED).value


class Frame(NamedTuple):
    """data[offset : offset + length], and of it what `capture.Frames` says; of a block all but data are arrays."""

    data: np.ndarray
    offset: int | np.ndarray
    length: int | np.ndarray
    time: int | np.ndarray
    port: int | np.ndarray
    flags: int | np.ndarray


@kernel
def _value(data, at, size, signed):
    value = np.int64(0)
    for byte in range(size):
        value |= np.int64(data[at + byte]) << (8 * byte)
    if signed and value >> (8 * size - 1):
        value -= np.int64(1) << (8 * size)
    return value


@kernel
def _take(data, at, address, length, mapped, values, have, mark):
    """Objects that lie in the logical range [address, address + length), whose bytes are at `at`; how many joints.

    have: takes `mark` for each of them.
    """
    joints = 0
    for joint in range(3):
        found = False
        for item in range(mapped.place.shape[1]):
            place = mapped.place[joint, item]
            if place >= address and place + mapped.size[item] <= address + length:
                values[joint, item] = _value(data, at + place - address, mapped.size[item], mapped.signed[item])
                have[joint, item] = mark
                found = True
        joints += found
    return joints


@kernel
def _joints_within(address, length, mapped):
    joints = 0
    for joint in range(3):
        for item in range(mapped.place.shape[1]):
            if mapped.place[joint, item] >= address and mapped.place[joint, item] < address + length:
                joints += 1
                break
    return joints


@kernel
def _drive_flags(layout, inputs, counts):
    """Flags of the drives' states in the cycle in the making. inputs: values of INPUT_SHAPE."""
    enabled, fault = True, False
    for joint in range(3):
        if layout.inputs.place[joint, STATUS] != NOT_MAPPED:
            found = cia402.STATE_OF_BITS[inputs[joint, STATUS] & 0x7F]
            enabled &= found == DriveState.OPERATION_ENABLED.value
            fault |= found == DriveState.FAULT.value or found == DriveState.FAULT_REACTION_ACTIVE.value
    counts.not_enabled += not enabled
    counts.drive_faults += fault
    return 0 if enabled else SampleFlag.BUS_FAULT.value


@kernel
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


@kernel
def _emit(time, layout, state, sample, raw):
    """Write the complete cycle into `sample`, and its inputs as they stand into `raw`."""
    counts, passes = state.counts, state.passes
    inputs, outputs, have_outputs = state.raw_inputs, state.raw_outputs, state.have_outputs
    stamp = stamp_kernel(time, state.clock)
    fault = passes.fault
    flags = interval_kernel(stamp, state) | _drive_flags(layout, inputs, counts)
    if fault:
        counts.counter_faults += 1
        flags |= SampleFlag.BUS_FAULT.value
    if fault == _COUNTER_ZERO:
        counts.unanswered += 1
        flags |= SampleFlag.NOT_A_NUMBER.value
    sample.stamp_sec = stamp // NANOSECONDS
    sample.stamp_nanosec = stamp % NANOSECONDS
    sample.sequence = counts.samples
    for joint in range(3):
        scale, zero = layout.radians_per_count[joint], layout.zero_counts[joint]
        torque_scale = layout.torque_nm_per_mille[joint]
        position, torque, position_command = np.nan, np.nan, np.nan
        if fault != _COUNTER_ZERO:
            position = cia402.joint_angle(inputs[joint, POSITION], zero, scale)
            torque = inputs[joint, TORQUE] * torque_scale
        if have_outputs[joint, TARGET_POSITION]:
            position_command = cia402.joint_angle(outputs[joint, TARGET_POSITION], zero, scale)
        else:
            flags |= SampleFlag.NO_COMMAND.value
        sample.position[joint] = position
        sample.torque[joint] = torque
        sample.position_command[joint] = position_command
        displayed = layout.inputs.place[joint, MODE_DISPLAY] != NOT_MAPPED
        sample.torque_command[joint] = torque_scale * _torque_command(
            inputs[joint, MODE_DISPLAY] if displayed else outputs[joint, MODE],
            displayed or have_outputs[joint, MODE],
            outputs[joint, TARGET_TORQUE],
            have_outputs[joint, TARGET_TORQUE],
            outputs[joint, TORQUE_OFFSET],
            have_outputs[joint, TORQUE_OFFSET],
        )
    gripper = layout.gripper_joint
    if gripper != NOT_MAPPED and fault != _COUNTER_ZERO:
        word = inputs[gripper, DIGITAL_INPUTS]
        sample.gripper = cia402.gripper_state(word, layout.gripper_bit, layout.gripper_closed)
    else:
        sample.gripper = Gripper.UNKNOWN.value
    sample.flags = flags
    raw[:] = inputs
    counts.samples += 1
    passes.fault = 0
    state.have_inputs[:] = 0
    have_outputs[:] = 0
    passes.sent = counts.missing = 0


@kernel
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


@kernel
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
            place = layout.inputs.place[0, POSITION]
            if reads and place >= address and place < address + length:
                note_sent(index, time, state)
        if writes and not returned:
            _take(data, body, address, length, layout.outputs,
                  state.sent_outputs[index], state.outputs_at[index], time)  # fmt: skip
        elif returned and (reads or writes):
            state.sent_at[index] = NEVER
            joints_in = _joints_within(address, length, layout.inputs) if reads else 0
            joints_out = _joints_within(address, length, layout.outputs) if writes else 0
            if joints_in and _starts_again(address, length, layout.inputs, state.have_inputs):
                state.counts.incomplete += 1
                state.have_inputs[:] = 0
                state.passes.fault = 0
            if joints_in or joints_out:
                least = joints_in + joints_out * (2 if reads else 1)
                if counter < expected_kernel(command, address, least, counter, layout.counters, state.counters):
                    fault = _COUNTER_ZERO if counter == 0 and joints_in else _COUNTER_LOW
                    state.passes.fault = max(state.passes.fault, fault)
            if reads:
                _take(data, body, address, length, layout.inputs,
                      state.raw_inputs, state.have_inputs, 1)  # fmt: skip
            if writes and reads and layout.shared:
                _take_sent(index, time, state)
            elif writes:
                _take(data, body, address, length, layout.outputs,
                      state.raw_outputs, state.have_outputs, 1)  # fmt: skip
        elif returned and counter > 0 and length >= 4 and address >> 16 == DC_SYSTEM_TIME and command != _FPWR:
            state.clock.dc_now = distributed_clock_kernel(data, body, length, time, state.clock)
        more = head & 0x8000 != 0
        at = body + length + 2


@kernel
def _starts_again(address, length, mapped, have):
    """Whether this datagram brings an input that the cycle in the making has already."""
    for joint in range(3):
        for item in range(mapped.place.shape[1]):
            place = mapped.place[joint, item]
            if have[joint, item] and place >= address and place < address + length:
                return True
    return False


@kernel
def _take_sent(index, time, state):
    for joint in range(3):
        for item in range(state.raw_outputs.shape[1]):
            if on_its_way(state.outputs_at[index, joint, item], time, state.clock):
                state.raw_outputs[joint, item] = state.sent_outputs[index, joint, item]
                state.have_outputs[joint, item] = 1
            state.outputs_at[index, joint, item] = NEVER


@kernel
def _complete(mapped, have):
    for joint in range(3):
        for item in range(mapped.place.shape[1]):
            if mapped.place[joint, item] != NOT_MAPPED and not have[joint, item]:
                return False
    return True


@kernel
def frame_kernel(frame, layout, state, sample, raw):
    """Take one Frame; whether it ends a cycle, whose sample is then in `sample`.

    raw: int64 of INPUT_SHAPE, takes the INPUTS of that sample as they stood in the frame.
    """
    data, time, counts = frame.data, frame.time, state.counts
    if frame.flags & _NOT_BELIEVED:
        counts.damaged += frame.flags & FrameFlag.DAMAGED.value != 0
        return False
    kind, first, end = find_datagrams(data, frame.offset, frame.length)
    if kind != Kind.DATAGRAMS.value:
        counts.damaged += kind == Kind.CUT.value
        return False
    whole, carries, answered, highest, index = _scan(data, first, end, layout.inputs, layout.outputs)
    if not whole:
        counts.damaged += 1
        return False
    if not carries:
        return False
    outstanding = on_its_way(state.sent_at[index], time, state.clock)
    returned = is_returned(
        data[frame.offset + 6], frame.port, outstanding, answered, highest, state.passes, state.ports
    )
    counts.returned += returned
    counts.sent += not returned
    _read_frame(data, first, end, returned, time, layout, state)
    if not returned or not _complete(layout.inputs, state.have_inputs):
        return False
    again = came_again(index, time, state)
    _emit(time, layout, state, sample, raw)
    if again and sample.flags & SampleFlag.REPEATED.value == 0:
        sample.flags |= SampleFlag.REPEATED.value
        counts.repeated += 1
    return True


@kernel
def assemble(block, layouts, states, samples, raw):
    """Samples of the cycles that end in the N frames of `block`, a Frame of arrays; how many.

    layouts, states: (1,) records of LAYOUT and STATE. samples: at least N records of SAMPLE. raw: int64, at least N of
    INPUT_SHAPE.
    """
    layout, state, made = layouts[0], states[0], 0
    for n in range(len(block.offset)):
        frame = Frame(block.data, block.offset[n], block.length[n], block.time[n], block.port[n], block.flags[n])
        made += frame_kernel(frame, layout, state, samples[made], raw[made])
    return made


# All that the live tap reads and writes: a compiled function takes one array a good deal faster than ten.
ONE_FRAME = np.dtype(
    [
        ("layout", LAYOUT),
        ("state", STATE),
        ("data", "u1", FRAME_BYTES),
        ("length", "i8"),
        ("time", "i8"),  # ns
        ("port", "i8"),
        ("sample", SAMPLE.dtype),
        ("raw", "i8", INPUT_SHAPE),
    ],
    align=True,
)


@kernel
def assemble_one(frames):
    """The frame in `frames` (1,), records of ONE_FRAME; whether it ended a cycle."""
    one = frames[0]
    frame = Frame(data=one.data, offset=0, length=one.length, time=one.time, port=one.port, flags=0)
    return frame_kernel(frame, one.layout, one.state, one.sample, one.raw)


@dataclass
class Assembler:
    """Turns blocks of frames into samples; remembers what it has to from block to block.

    Attributes: layout, state: (1,) records of LAYOUT and STATE.
    """

    layout: np.ndarray
    state: np.ndarray = field(default_factory=new_state)

    def samples(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """(M,) records of SAMPLE and (M, 3, 6) int64 of their INPUTS in drive units, from N frames, M <= N."""
        records = SAMPLE.empty(len(frames))
        raw = np.empty((len(frames), *INPUT_SHAPE), np.int64)
        block = Frame(frames.data, frames.offset, frames.length, frames.time, frames.port, frames.flags)
        made = assemble(block, self.layout, self.state, records, raw)
        return records[:made], raw[:made]

    def count(self, name: str) -> int:
        """One of the fields of COUNTS."""
        return int(self.state["counts"][name][0])

    @property
    def period_ns(self) -> int:
        """Cycle time, ns: median of the last cycles; 0 while unknown."""
        return int(self.state["clock"]["period"][0])

    @property
    def distributed_clock(self) -> bool:
        """Whether the stamps are the distributed clock's."""
        return bool(self.state["clock"]["mode"][0] == DISTRIBUTED_CLOCK)
