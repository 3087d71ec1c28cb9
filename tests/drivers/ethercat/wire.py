"""Frames and captures written byte by byte for the tests; tshark is the judge that they are what they claim."""

from __future__ import annotations

import math
import shutil
import struct
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.robot import Robot

# joint radians and N m of one unit of the drives of `robot`
PER_COUNT = math.tau / (1 << 20) / 20
PER_MILLE = 1.5 * 20 / 1000

MASTER = bytes.fromhex("000105112233")


def datagram(command: int, address: int, data: bytes, working_counter: int = 0, index: int = 0) -> tuple[bytes, int]:
    """Header and data without the more-follows bit; the working counter apart."""
    return struct.pack("<BBIHH", command, index, address, len(data), 0) + data, working_counter


def frame(*datagrams: tuple[bytes, int], returned: bool = False, vlan: int = 0, source: bytes = MASTER) -> bytes:
    body = b""
    for number, (content, working_counter) in enumerate(datagrams):
        size = struct.unpack_from("<H", content, 6)[0] | (0x8000 if number + 1 < len(datagrams) else 0)
        body += content[:6] + struct.pack("<H", size) + content[8:] + struct.pack("<H", working_counter)
    address = bytes([source[0] | 2]) + source[1:] if returned else source
    tags = b"\x81\x00\x20\x05" * vlan
    return b"\xff" * 6 + address + tags + b"\x88\xa4" + struct.pack("<H", 0x1000 | len(body)) + body


def pcap(
    path: Path,
    packets: list[tuple[int, bytes]],
    link_type: int = 1,
    order: str = "<",
    nanoseconds: bool = False,
    snap: int = 1 << 18,
) -> Path:
    """packets: (time in ns, bytes)."""
    unit = 1 if nanoseconds else 1000
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, snap, link_type)]
    for time, data in packets:
        kept = data[:snap]
        parts += struct.pack(order + "IIII", time // 10**9, time % 10**9 // unit, len(kept), len(data)), kept
    path.write_bytes(b"".join(parts))
    return path


def pcapng(
    path: Path,
    packets: list[tuple[int, int, bytes]],
    interfaces: list[tuple[int, bytes]],
    order: str = "<",
) -> Path:
    """packets: (interface, ticks, bytes); interfaces: (link type, if_tsresol byte or nothing)."""

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = len(body) + 12
        return struct.pack(order + "II", kind, size) + body + struct.pack(order + "I", size)

    out = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    for link_type, resolution in interfaces:
        option = struct.pack(order + "HH", 9, 1) + resolution + bytes(3) + bytes(4) if resolution else b""
        out += block(1, struct.pack(order + "HHI", link_type, 0, 0) + option)
    for interface, ticks, data in packets:
        head = struct.pack(order + "IIIII", interface, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data))
        out += block(6, head + data)
    path.write_bytes(out)
    return path


def netanalyzer(data: bytes, port: int = 0, errors: int = 0, transparent: bool = False, preamble: int = 7) -> bytes:
    """A packet of link type 240 or 241: header, preamble where asked for, frame, FCS (not computed)."""
    body = (b"\x55" * preamble + b"\xd5" if transparent else b"") + data + b"\xde\xad\xbe\xef"
    return struct.pack("<I", errors | transparent << 9 | 1 << 10 | port << 14 | len(body) << 16) + body


def gpio(number: int = 0) -> bytes:
    """The pseudo frame of an event on one of the analyzer's digital inputs."""
    return struct.pack("<I", 1 << 8 | 1 << 10 | number << 14 | 2 << 16) + b"\x00\x00"


def tshark(path: Path, *fields: str, select: str = "frame") -> list[list[str]]:
    """One row a frame, one string a field, several values of a field separated by commas."""
    if shutil.which("tshark") is None:
        pytest.skip("needs tshark, the independent reading of a capture")
    command = ["tshark", "-r", str(path), "-Y", select, "-T", "fields", "-E", "aggregator=,", "-t", "e"]
    for name in fields:
        command += ["-e", name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return [line.split("\t") for line in done.stdout.splitlines()]


@dataclass(frozen=True)
class Drive:
    """What one drive says and hears in a cycle: TxPDO 6041 6064 606C 6077 6061, RxPDO 6040 607A 6071 60B2 6060."""

    position: int = 0
    velocity: int = 0
    torque: int = 0
    status: int = 0x27
    mode: int = 8
    target: int = 0
    target_torque: int = 0
    offset: int = 0

    @property
    def inputs(self) -> bytes:
        return struct.pack("<HiihbB", self.status, self.position, self.velocity, self.torque, self.mode, 0)

    @property
    def outputs(self) -> bytes:
        return struct.pack("<HihhbB", 15, self.target, self.target_torque, self.offset, self.mode, 0)


INPUTS = ["0x6041", "0x6064", "0x606C", "0x6077", "0x6061", ":8"]
OUTPUTS = ["0x6040", "0x607A", "0x6071", "0x60B2", "0x6060", ":8"]
INPUT_BYTES, OUTPUT_BYTES = 14, 12
INPUTS_AT = 0x1000 + 3 * OUTPUT_BYTES


def robot(shared: bool = False, drive: dict[str, Any] | None = None, **joint_changes: Any) -> Robot:
    """A robot whose drives map what `Drive` packs: outputs from 0x1000, inputs behind them or over them."""
    inputs_at = 0x1000 if shared else INPUTS_AT
    joints = [
        {
            "station": 0x1001 + number, "counts_per_turn": 1 << 20, "sign": 1, "zero_counts": 0,
            "torque": {"reference": "rated_torque", "rated_torque_nm": 1.5},
            "velocity_unit_counts_per_s": 1.0,
            "outputs_address": 0x1000 + number * OUTPUT_BYTES, "outputs": OUTPUTS,
            "inputs_address": inputs_at + number * INPUT_BYTES, "inputs": INPUTS,
            **joint_changes,
        }
        for number in range(3)
    ]  # fmt: skip
    return Robot.model_validate(
        {
            "name": "wired",
            "geometry": {
                "active_link_length": 0.35,
                "passive_link_length": 0.8,
                "base_radius": 0.2,
                "platform_radius": 0.06,
            },
            "mass": {"active_link": 1.0, "passive_link": 0.4, "platform": 0.8},
            "drive": {"gear_ratio": 20.0, "joint": joints, **(drive or {})},
        }
    )


def passes(
    drives: Sequence[Drive],
    before: Sequence[Drive] | None = None,
    working_counter: int = 9,
    index: int = 0,
    clock: bytes = b"",
    shared: bool = False,
    source: bytes = MASTER,
) -> tuple[bytes, bytes]:
    """One cycle as it is sent (inputs of the cycle before) and as it comes back."""
    outputs, inputs = b"".join(d.outputs for d in drives), b"".join(d.inputs for d in drives)
    old = b"".join(d.inputs for d in before or drives)
    if shared:
        sent, back = outputs.ljust(len(inputs), b"\0"), inputs
    else:
        sent, back = outputs + old, outputs + inputs
    if working_counter == 0:
        back = sent
    times = [(datagram(14, 0x09101001, bytes(len(clock)), index=index), 0)] if clock else []
    answers = [(datagram(14, 0x09101001, clock, index=index), 3)] if clock else []
    out = frame(datagram(12, 0x1000, sent, index=index), *(d for d, _ in times), source=source)
    answered = [(d[0], w if working_counter else 0) for d, w in answers]
    return out, frame(datagram(12, 0x1000, back, working_counter, index=index), *answered, returned=True, source=source)


def cycle(number: int) -> list[Drive]:
    """Drives whose every value tells cycle and drive apart."""
    return [
        Drive(
            position=1000 * number + drive,
            velocity=-number,
            torque=number % 900 - 300 * drive,
            target=1000 * number + drive + 7,
            offset=number % 500 + drive,
        )
        for drive in range(3)
    ]


def of_cycles(samples: np.ndarray, numbers: Sequence[int]) -> None:
    """Every sample holds the values of its own cycle."""
    n = np.asarray(numbers)[:, None]
    drive = np.arange(3)
    np.testing.assert_allclose(samples["position"], (1000 * n + drive) * PER_COUNT, atol=1e-12)
    np.testing.assert_allclose(samples["torque"], (n % 900 - 300 * drive) * PER_MILLE, atol=1e-12)
    np.testing.assert_allclose(samples["position_command"], (1000 * n + drive + 7) * PER_COUNT, atol=1e-12)
    np.testing.assert_allclose(samples["torque_command"], (n % 500 + drive) * PER_MILLE, atol=1e-12)
