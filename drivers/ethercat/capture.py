"""Captures as blocks of Ethernet frames: pcap and pcapng, link types of Ethernet, Linux (cooked) and netANALYZER, in
bounded memory.

dpkt reads the headers (byte order, link type, clock resolution, interfaces). It does not read the packets: it gives the
time as a float, 240 ns coarse in this century, and knows the first interface only. A kernel walks the packets instead
and keeps integer nanoseconds.

Sources: IETF draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng, tcpdump.org LINKTYPE_NETANALYZER (240, 241),
LINKTYPE_LINUX_SLL (113) and LINKTYPE_LINUX_SLL2 (276).
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Literal

import dpkt
import numpy as np

from schemas.errors import TraceError
from schemas.kernels import kernel

ETHERNET = 1
NETANALYZER = 240
NETANALYZER_TRANSPARENT = 241
LINUX_COOKED, LINUX_COOKED_2 = 113, 276  # of `-i any`: no destination address, protocol and source elsewhere

CHUNK_BYTES = 8 << 20  # read at once
MAX_BLOCK_BYTES = 16 << 20  # a longer pcapng block is damage, as it is to Wireshark
MAX_FRAME_BYTES = 1 << 18  # a longer packet record is damage: the largest snap length in use is 262144
MAX_INTERFACES = 256


class FrameFlag(enum.IntFlag):
    """What is particular about a captured frame."""

    SNAPPED = 1  # the capture kept less than the wire carried
    DAMAGED = 2  # the analyzer marked it: FCS, alignment, RX_ER, SFD or length error
    PSEUDO = 4  # no frame at all: a GPIO event of the analyzer
    FOREIGN = 8  # a link type that carries no Ethernet
    REPEATED = 16  # captured before: see `drivers.ethercat.doubles`


@dataclass(frozen=True)
class Frames:
    """N captured frames of one block, cut to their Ethernet part (from destination address, no FCS).

    data: (B,) uint8, the block. offset, length: (N,) int64, of the Ethernet frame in `data`. time: (N,) int64, ns of
    the capture's clock. port: (N,) uint8, analyzer port or capture interface. flags: (N,) uint8 of FrameFlag.
    first: number of the first frame in the file, from 1 as Wireshark counts.
    """

    data: np.ndarray
    offset: np.ndarray
    length: np.ndarray
    time: np.ndarray
    port: np.ndarray
    flags: np.ndarray
    first: int = 1

    def __len__(self) -> int:
        return len(self.offset)


# columns of the interface table: one tick of an interface's clock is multiply / divide / 2^shift ns
_LINK_TYPE, _SNAP_LENGTH, _MULTIPLY, _DIVIDE, _SHIFT, _OFFSET_NS = range(6)

# why a walk stopped: at a record that is not whole, at a header or with its columns full, at what is no record
_NEED_MORE, _AGAIN, _DAMAGED = range(3)
_SHB, _IDB, _PB, _SPB, _EPB = 0x0A0D0D0A, 1, 2, 3, 6

_FCS_BYTES = 4
_NETANALYZER_ERRORS = 0x1F  # RX_ER, alignment, FCS, too long, SFD: what is in the frame cannot be believed
_NETANALYZER_GPIO = 0x100
_SFD = 0xD5
_PREAMBLE_SEARCH = 32


@kernel
def _u32(data, at, big):
    if big:
        return (
            (np.int64(data[at]) << 24) | (np.int64(data[at + 1]) << 16) | (np.int64(data[at + 2]) << 8) | data[at + 3]
        )
    return (
        np.int64(data[at])
        | (np.int64(data[at + 1]) << 8)
        | (np.int64(data[at + 2]) << 16)
        | (np.int64(data[at + 3]) << 24)
    )


@kernel
def _cut_cooked(data, start, captured, flags, link_type, port):
    """Lay source address and protocol where an Ethernet frame has them; the block is ours."""
    header = 16 if link_type == LINUX_COOKED else 20
    if captured < header:
        return start, np.int64(0), port, flags | FrameFlag.DAMAGED.value
    offset = start + header - 14
    if link_type == LINUX_COOKED:
        for byte in range(5, -1, -1):
            data[offset + 6 + byte] = data[start + 6 + byte]
    else:
        data[offset + 12], data[offset + 13] = data[start], data[start + 1]
    return offset, captured - header + 14, port, flags


@kernel
def cut_link_layer(data, start, captured, snapped, link_type, port):
    """(offset, length, port, flags) of the Ethernet frame in a packet of `captured` bytes at `start`."""
    flags = FrameFlag.SNAPPED.value if snapped else 0
    if link_type == ETHERNET:
        return start, captured, port, flags
    if link_type in (LINUX_COOKED, LINUX_COOKED_2):
        return _cut_cooked(data, start, captured, flags, link_type, port)
    if link_type != NETANALYZER and link_type != NETANALYZER_TRANSPARENT:
        return start, np.int64(0), port, flags | FrameFlag.FOREIGN.value
    if captured < 4:
        return start, np.int64(0), port, flags | FrameFlag.DAMAGED.value
    header = _u32(data, start, False)
    port = (header >> 14) & 3
    if header & _NETANALYZER_GPIO:
        return start, np.int64(0), port, flags | FrameFlag.PSEUDO.value
    if header & _NETANALYZER_ERRORS:
        flags |= FrameFlag.DAMAGED.value
    offset, length = start + 4, captured - 4
    if not snapped:
        length = max(length - _FCS_BYTES, 0)
    if link_type == NETANALYZER_TRANSPARENT:
        preamble = np.int64(0)
        while preamble < min(length, _PREAMBLE_SEARCH) and data[offset + preamble] != _SFD:
            preamble += 1
        if preamble == min(length, _PREAMBLE_SEARCH):
            return offset, np.int64(0), port, flags | FrameFlag.DAMAGED.value
        offset, length = offset + preamble + 1, length - preamble - 1
    return offset, length, port, flags


@kernel
def _walk_pcap(data, big, nanoseconds, link_type, offset, length, time, port, flags):
    """Frames of the whole records in `data`: (frames, bytes used, why it stopped)."""
    at, count, end = np.int64(0), 0, len(data)
    while at + 16 <= end:
        if count == len(offset):
            return count, at, _AGAIN
        seconds, fraction = _u32(data, at, big), _u32(data, at + 4, big)
        captured, wire = _u32(data, at + 8, big), _u32(data, at + 12, big)
        if captured > MAX_FRAME_BYTES:
            return count, at, _DAMAGED
        if at + 16 + captured > end:
            break
        offset[count], length[count], port[count], flags[count] = cut_link_layer(
            data, at + 16, captured, captured < wire, link_type, np.int64(0)
        )
        time[count] = seconds * 1_000_000_000 + fraction * (1 if nanoseconds else 1000)
        count += 1
        at += 16 + captured
    return count, at, _NEED_MORE


@kernel
def _walk_pcapng(data, big, interfaces, interface_count, offset, length, time, port, flags):
    """The same for pcapng; it stops at section and interface headers. interfaces: (n, 6) table, columns as above."""
    at, count, end = np.int64(0), 0, len(data)
    while at + 12 <= end:
        if count == len(offset):
            return count, at, _AGAIN
        kind, size = _u32(data, at, big), _u32(data, at + 4, big)
        if kind == _SHB:
            return count, at, _AGAIN
        if size < 12 or size % 4 or size > MAX_BLOCK_BYTES:
            return count, at, _DAMAGED
        if at + size > end:
            break
        if kind == _IDB:
            return count, at, _AGAIN
        if kind in (_EPB, _PB, _SPB):
            number, ticks = np.int64(0), np.int64(0)
            if kind == _SPB:
                body, wire = at + 12, _u32(data, at + 8, big)
                captured = min(wire, size - 16)
            else:
                if size < 32:
                    return count, at, _DAMAGED
                number = _u32(data, at + 8, big)
                if kind == _PB:  # two 16-bit fields: interface, drops
                    number = number >> 16 if big else number & 0xFFFF
                ticks = (_u32(data, at + 12, big) << 32) | _u32(data, at + 16, big)
                body, captured, wire = at + 28, _u32(data, at + 20, big), _u32(data, at + 24, big)
            if number >= interface_count or body + captured + 4 > at + size:
                return count, at, _DAMAGED
            interface = interfaces[number]
            snap_length, shift = interface[_SNAP_LENGTH], interface[_SHIFT]
            if kind == _SPB and snap_length and captured > snap_length:
                captured = snap_length
            offset[count], length[count], port[count], flags[count] = cut_link_layer(
                data, body, captured, captured < wire, interface[_LINK_TYPE], number
            )
            whole, rest = ticks >> shift, ticks & ((np.int64(1) << shift) - 1)
            nanoseconds = whole * interface[_MULTIPLY] // interface[_DIVIDE] + ((rest * interface[_MULTIPLY]) >> shift)
            time[count] = nanoseconds + interface[_OFFSET_NS]
            count += 1
        at += size
    return count, at, _NEED_MORE


class _Pcap:
    """Packet records of a pcap file behind its file header."""

    def __init__(self, path: Path, header: bytes) -> None:
        magic = header[:4]
        big = magic in (b"\xa1\xb2\xc3\xd4", b"\xa1\xb2\x3c\x4d")
        if not big and magic[::-1] not in (b"\xa1\xb2\xc3\xd4", b"\xa1\xb2\x3c\x4d"):
            raise TraceError(f"{path}: not a capture: it starts with {magic.hex(' ') or 'nothing'}, no pcap or pcapng")
        self.header_bytes = 24
        if len(header) < self.header_bytes:
            raise TraceError(f"{path}: {len(header)} bytes, shorter than a pcap file header")
        self._big = big
        self._nanoseconds = b"\x3c" in magic
        fields: Any = dpkt.pcap.FileHdr(header) if big else dpkt.pcap.LEFileHdr(header)  # dpkt adds fields at run time
        self._link_type = fields.linktype & 0xFFFF  # above it: whether frames end with their FCS
        self.link_types = {self._link_type}

    def walk(self, data: np.ndarray, columns: tuple[np.ndarray, ...]) -> tuple[int, int, int]:
        count, used, why = _walk_pcap(data, self._big, self._nanoseconds, self._link_type, *columns)
        return count, int(used), why


class _Pcapng:
    """Blocks of a pcapng file, section by section."""

    def __init__(self) -> None:
        self._big = False
        self._interfaces = np.zeros((MAX_INTERFACES, 6), np.int64)
        self._count = 0
        self.link_types: set[int] = set()
        self.header_bytes = 0

    def walk(self, data: np.ndarray, columns: tuple[np.ndarray, ...]) -> tuple[int, int, int]:
        if len(data) >= 12:
            kind = int.from_bytes(data[:4].tobytes(), "big" if self._big else "little")
            if kind == _SHB:
                return self._section(data)
            if kind == _IDB:
                return self._interface(data)
        count, used, why = _walk_pcapng(data, self._big, self._interfaces, self._count, *columns)
        return count, int(used), why

    def _section(self, data: np.ndarray) -> tuple[int, int, int]:
        mark = int.from_bytes(data[8:12].tobytes(), "big")
        if mark not in (dpkt.pcapng.BYTE_ORDER_MAGIC, dpkt.pcapng.BYTE_ORDER_MAGIC_LE):
            return 0, 0, _DAMAGED
        self._big = mark == dpkt.pcapng.BYTE_ORDER_MAGIC
        self._count = 0
        return self._skip(data, least=28)

    def _interface(self, data: np.ndarray) -> tuple[int, int, int]:
        result = self._skip(data, least=20)
        if result[2] != _AGAIN:
            return result
        block = dpkt.pcapng.InterfaceDescriptionBlock if self._big else dpkt.pcapng.InterfaceDescriptionBlockLE
        try:
            header: Any = block(data[: result[1]].tobytes())
            self._interfaces[self._count] = _interface_row(header, "big" if self._big else "little")
        except (dpkt.Error, ValueError, IndexError):  # IndexError: more interfaces than the table holds
            return 0, 0, _DAMAGED
        self.link_types.add(header.linktype)
        self._count += 1
        return result

    def _skip(self, data: np.ndarray, least: int) -> tuple[int, int, int]:
        size = int.from_bytes(data[4:8].tobytes(), "big" if self._big else "little")
        if size < least or size % 4 or size > MAX_BLOCK_BYTES:
            return 0, 0, _DAMAGED
        return (0, size, _AGAIN) if size <= len(data) else (0, 0, _NEED_MORE)


def _interface_row(header: Any, order: Literal["big", "little"]) -> tuple[int, ...]:
    multiply, divide, shift, offset_ns = 1000, 1, 0, 0  # microseconds unless an option says otherwise
    for option in header.opts:
        if option.code == dpkt.pcapng.PCAPNG_OPT_IF_TSRESOL and len(option.data) == 1:
            exponent = option.data[0] & 0x7F
            if option.data[0] & 0x80:
                multiply, shift = 1_000_000_000, exponent
            else:
                multiply, divide = 10 ** max(9 - exponent, 0), 10 ** max(exponent - 9, 0)
            if shift > 33 or divide > 10**9:
                raise ValueError(f"clock resolution {option.data[0]:#x}")
        if option.code == dpkt.pcapng.PCAPNG_OPT_IF_TSOFFSET and len(option.data) == 8:
            offset_ns = int.from_bytes(option.data, order, signed=True) * 1_000_000_000
    if abs(offset_ns) >= 2**63:
        raise ValueError("clock offset")
    return header.linktype, header.snaplen, multiply, divide, shift, offset_ns


@dataclass
class Capture:
    """A capture file, read once from front to back by `blocks`.

    findings: what is wrong with the file itself, in words, complete once `blocks` has ended.
    """

    path: Path
    frames: int = 0
    bytes_read: int = 0
    link_types: set[int] = field(default_factory=set)
    findings: list[str] = field(default_factory=list)

    def blocks(self) -> Iterator[Frames]:
        """The file's frames, block by block; a block's arrays are valid until the next one is asked for.

        Raises:
            TraceError: the file cannot be read or is no capture.
        """
        try:
            with self.path.open("rb") as file:
                yield from self._read(file)
        except OSError as error:
            raise TraceError(f"{self.path}: {error.strerror}") from error

    def _read(self, file: BinaryIO) -> Iterator[Frames]:
        header = file.read(24)
        source = _Pcapng() if header.startswith(b"\x0a\x0d\x0d\x0a") else _Pcap(self.path, header)
        file.seek(source.header_bytes)
        self.bytes_read = source.header_bytes
        self.link_types = source.link_types
        buffer = np.empty(CHUNK_BYTES, np.uint8)
        columns = (*(np.empty(CHUNK_BYTES // 64, np.int64) for _ in range(3)),
                   *(np.empty(CHUNK_BYTES // 64, np.uint8) for _ in range(2)))  # fmt: skip
        held = 0
        while got := file.readinto(memoryview(buffer)[held:]):  # type: ignore[attr-defined]
            held += got
            at, why = 0, _AGAIN
            while why == _AGAIN:
                count, used, why = source.walk(buffer[at:held], columns)
                if count:
                    offset, length, time, port, flags = (column[:count] for column in columns)
                    yield Frames(buffer[at:held], offset, length, time, port, flags, self.frames + 1)
                self.frames += count
                self.bytes_read += used
                at += used
            if why == _DAMAGED:
                self.findings.append(f"damaged at byte {self.bytes_read}: no packet follows frame {self.frames}")
                return
            held -= at
            buffer[:held] = buffer[at : at + held].copy()
            if held == len(buffer):  # one block longer than the buffer
                buffer = np.concatenate([buffer, np.empty_like(buffer)])
        if held:
            self.findings.append(f"cut short: the file ends {held} bytes after frame {self.frames}")
