"""Which sight of a frame is believed: sent and returned, and the working counter it should have."""

from __future__ import annotations

from drivers.ethercat.process_data.frame_state import NEVER
from schemas.kernels import kernel

_PORT_AFTER = 16  # answered frames before a port is taken for the returning one
_BELIEVED_AFTER = 4  # cycles with one higher working counter before it is what is expected
_FLIGHT = 0.75  # of a cycle: a frame that was sent longer ago is not the one that comes back


@kernel
def is_returned(source, port, outstanding, answered, highest, passes, ports):
    """Whether a frame with process data is on its way back, and what it teaches about telling that.

    source: first byte of the source address. outstanding: whether a datagram of this index is on its way.
    """
    seen = ports[port]
    if answered:
        seen.answered += 1
        seen.highest = max(seen.highest, highest)
        passes.highest = max(passes.highest, highest)
        return seen.highest == passes.highest
    local = source & 2 != 0
    returned = local and (passes.plain_seen == 1 or (seen.answered >= _PORT_AFTER and seen.silent == 0) or outstanding)
    if not local:
        passes.plain_seen = 1
    if not returned:
        seen.silent += 1
    return returned


@kernel
def on_its_way(sent_at, time, clock):
    """Whether what was sent at `sent_at` and has not come back can come back at `time`, both ns of the capture."""
    return sent_at != NEVER and (clock.period == 0 or time - sent_at < _FLIGHT * clock.period)


@kernel
def expected_kernel(command, address, least, counter, declared, seen):
    """Working counter this datagram should have: at least what the drives add, an ENI's, and the highest seen.

    That one some times in a row: a single one may be a corrupted frame's, and would be missed ever after.
    """
    for known in declared:
        if known.command == 0:
            break
        if known.command == command and known.address == address:
            return known.expected
    for known in seen:
        if known.expected == 0 or (known.command == command and known.address == address):
            known.command, known.address, known.expected = command, address, max(known.expected, least)
            if counter > known.expected:
                known.run = known.run + 1 if counter == known.higher else 1
                known.higher = counter
                if known.run >= _BELIEVED_AFTER:
                    known.expected = counter
            else:
                known.run = 0
            return known.expected
    return least


@kernel
def note_sent(index, time, state):
    """A cycle is on its way out. What was out before it and brings no sample is missing; a frame seen twice is one."""
    passes, counts = state.passes, state.counts
    if passes.sent > 0 and index == passes.sent_index and on_its_way(passes.sent_ns, time, state.clock):
        return
    counts.missing = passes.sent
    passes.sent += 1
    passes.sent_index, passes.sent_ns = index, time


@kernel
def came_again(index, time, state):
    """Whether the frame of the last cycle has come back twice: same index and inputs, too soon to be the next."""
    passes, clock = state.passes, state.clock
    again = index == passes.back_index and on_its_way(passes.back_ns, time, clock) and clock.period > 0
    for joint in range(3):
        for item in range(state.raw_inputs.shape[1]):
            again &= state.raw_inputs[joint, item] == state.last_inputs[joint, item]
            state.last_inputs[joint, item] = state.raw_inputs[joint, item]
    passes.back_index, passes.back_ns = index, time
    return again
