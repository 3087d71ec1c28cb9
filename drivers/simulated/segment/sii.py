"""Slave information interface (SII): the EEPROM a master reads to learn what a slave is and what it maps.

Layout: ETG.1000.6 (category structure) and ETG.2010 (word addresses, checksum).
"""

from __future__ import annotations

import struct

from drivers.ethercat.cia402 import OBJECTS
from drivers.ethercat.pdo import Pdo

OUTPUT_ADDRESS = 0x1000
INPUT_ADDRESS = 0x1400
OUTPUT_CONTROL = 0x64  # three buffers, written by the master, interrupt and watchdog on
INPUT_CONTROL = 0x20  # three buffers, read by the master

_STRINGS, _GENERAL, _FMMU, _SYNC_MANAGER, _TX_PDO, _RX_PDO, _END = 10, 30, 40, 41, 50, 51, 0xFFFF
_FIRST_CATEGORY = 0x80  # byte address
_DATA_TYPES = {"u2": 0x06, "i2": 0x03, "u4": 0x07, "i4": 0x04, "i1": 0x02, "u1": 0x05}


def build_sii(name: str, product: int, revision: int, serial: int, rx: Pdo, tx: Pdo) -> bytes:
    """EEPROM of a slave without mailbox whose sync manager 0 takes `rx` and 1 gives `tx`."""
    header = bytearray(_FIRST_CATEGORY)
    struct.pack_into("<4H", header, 0, 0x0080, 0, 0, 0)
    header[14] = _checksum(header[:14])
    struct.pack_into("<4I", header, 16, 0, product, revision, serial)  # vendor 0: no vendor stands behind it
    struct.pack_into("<2H", header, 0x7C, 0x000F, 1)  # 16 kbit, version 1
    text = name.encode("ascii")
    general = bytearray(32)
    general[0], general[2], general[3] = 1, 1, 1  # group, order number and name: string 1
    sync_managers = struct.pack("<HHBBBB", OUTPUT_ADDRESS, rx.size, OUTPUT_CONTROL, 0, 1, 3)
    sync_managers += struct.pack("<HHBBBB", INPUT_ADDRESS, tx.size, INPUT_CONTROL, 0, 1, 4)
    return b"".join(
        (
            header,
            _category(_STRINGS, bytes((1, len(text))) + text),
            _category(_GENERAL, general),
            _category(_FMMU, bytes((1, 2))),  # FMMU 0 outputs, FMMU 1 inputs
            _category(_SYNC_MANAGER, sync_managers),
            _category(_TX_PDO, _pdo(0x1A00, tx, 1)),
            _category(_RX_PDO, _pdo(0x1600, rx, 0)),
            struct.pack("<H", _END),
        )
    )


def _category(kind: int, body: bytes | bytearray) -> bytes:
    body = bytes(body) + b"\x00" * (len(body) % 2)
    return struct.pack("<HH", kind, len(body) // 2) + body


def _pdo(index: int, pdo: Pdo, sync_manager: int) -> bytes:
    entries = b"".join(
        struct.pack("<HBBBBH", entry, 0, 0, _DATA_TYPES[OBJECTS[entry].str[1:]] if entry in OBJECTS else 0, bits, 0)
        for entry, bits in pdo.entries
    )
    return struct.pack("<HBBBBH", index, len(pdo.entries), sync_manager, 0, 0, 0) + entries


def _checksum(data: bytes | bytearray) -> int:
    """CRC-8 of ETG.2010: polynomial x^8 + x^2 + x + 1, initial value 0xFF."""
    value = 0xFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ 0x07 if value & 0x80 else value << 1) & 0xFF
    return value
