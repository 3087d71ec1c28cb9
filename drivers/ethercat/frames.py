"""EtherCAT frames: datagrams, addressing, working counter, and which pass of a frame was captured.

Source: IEC 61158-4-12 / ETG.1000.4, frame and datagram structure; ETG.1000.4 register map.
"""

from __future__ import annotations

import enum

import numpy as np

from drivers.ethercat.capture import Frames
from schemas.kernels import kernel

ETHERTYPE = 0x88A4
UDP_PORT = 0x88A4

AL_CONTROL = 0x0120
AL_STATUS = 0x0130
DC_SYSTEM_TIME = 0x0910
FMMU = 0x0600  # 16 registers of 16 bytes


class Command(enum.IntEnum):
    """Datagram commands. A: by position, F: by configured address, B: to all, L: by logical address."""

    NOP = 0
    APRD = 1
    APWR = 2
    APRW = 3
    FPRD = 4
    FPWR = 5
    FPRW = 6
    BRD = 7
    BWR = 8
    BRW = 9
    LRD = 10
    LWR = 11
    LRW = 12
    ARMW = 13
    FRMW = 14


class AlState(enum.IntEnum):
    """Application layer states, the low four bits of AL control and AL status."""

    INIT = 1
    PREOP = 2
    BOOT = 3
    SAFEOP = 4
    OP = 8


class Kind(enum.IntEnum):
    """What a captured frame is."""

    OTHER = 0  # not EtherCAT
    DATAGRAMS = 1  # EtherCAT, whole
    NOT_COMMANDS = 2  # EtherCAT, but mailbox gateway, network variables or an unknown type
    CUT = 3  # EtherCAT whose last datagram is not all there: snapped, or lengths that do not fit


DATAGRAM = np.dtype(
    [
        ("frame", np.int64),  # index in its block
        ("data", np.int64),  # offset of its data in the block's bytes
        ("address", np.uint32),  # logical, or position/station in the low and register in the high half
        ("length", np.uint16),
        ("working_counter", np.uint16),
        ("command", np.uint8),
        ("index", np.uint8),
        ("flags", np.uint8),  # DatagramFlag
    ]
)


class DatagramFlag(enum.IntFlag):
    CIRCULATING = 1
    CUT = 2  # its data or working counter are not all in the capture


_HEADER_BYTES = 10
_MORE = 0x8000


@kernel
def u16(data, at):
    """Little-endian 16 bits at `at`."""
    return np.int64(data[at]) | (np.int64(data[at + 1]) << 8)


@kernel
def u32(data, at):
    """Little-endian 32 bits at `at`."""
    return u16(data, at) | (u16(data, at + 2) << 16)


@kernel
def _ethertype(data, at):
    return (np.int64(data[at]) << 8) | data[at + 1]


@kernel
def find_datagrams(data, offset, length):
    """(kind, first, end): where the datagrams of the Ethernet frame at data[offset:offset + length] lie."""
    end = offset + length
    at = offset + 12
    if at + 2 > end:
        return Kind.OTHER.value, end, end
    kind = _ethertype(data, at)
    at += 2
    while kind in (0x8100, 0x88A8, 0x9100) and at + 4 <= end:  # VLAN tags, stacked or not
        kind = _ethertype(data, at + 2)
        at += 4
    if kind == 0x0800 and at + 20 <= end and data[at + 9] == 17 and data[at] >> 4 == 4:  # EtherCAT in UDP
        at += (np.int64(data[at]) & 15) * 4
        if at + 8 <= end and _ethertype(data, at + 2) == UDP_PORT:
            kind = ETHERTYPE
            at += 8
    if kind != ETHERTYPE:
        return Kind.OTHER.value, end, end
    if at + 2 > end:
        return Kind.CUT.value, end, end
    header = u16(data, at)
    at += 2
    if header >> 12 != 1:
        return Kind.NOT_COMMANDS.value, end, end
    return Kind.DATAGRAMS.value, at, min(end, at + (header & 0x7FF))


@kernel
def decode_kernel(data, offset, length, datagrams, kinds):
    """Fill `datagrams` and each frame's Kind from the frames of a block; (frames done, datagrams found)."""
    found = 0
    for frame in range(len(offset)):
        kind, at, end = find_datagrams(data, offset[frame], length[frame])
        start = found
        more = kind == Kind.DATAGRAMS.value
        while more:
            if found == len(datagrams):
                return frame, start
            if at + _HEADER_BYTES > end:
                kind = Kind.CUT.value
                break
            head = u16(data, at + 6)
            size = head & 0x7FF
            tail = at + _HEADER_BYTES + size
            row = datagrams[found]
            row.frame = frame
            row.command = data[at]
            row.index = data[at + 1]
            row.address = u32(data, at + 2)
            row.length = size
            row.data = at + _HEADER_BYTES
            row.flags = DatagramFlag.CIRCULATING.value if head & 0x4000 else 0
            row.working_counter = 0
            if tail + 2 > end:
                row.flags |= DatagramFlag.CUT.value
                kind = Kind.CUT.value
            else:
                row.working_counter = u16(data, tail)
            found += 1
            more = kind == Kind.DATAGRAMS.value and head & _MORE != 0
            at = tail + 2
        kinds[frame] = kind
    return len(offset), found


def decode(frames: Frames) -> tuple[np.ndarray, np.ndarray]:
    """(M,) DATAGRAM records and (N,) uint8 of Kind of N frames."""
    kinds = np.zeros(len(frames), np.uint8)
    datagrams = np.empty(max(64, 4 * len(frames)), DATAGRAM)
    while True:
        done, found = decode_kernel(frames.data, frames.offset, frames.length, datagrams, kinds)
        if done == len(frames):
            return datagrams[:found], kinds
        datagrams = np.empty(2 * len(datagrams), DATAGRAM)
