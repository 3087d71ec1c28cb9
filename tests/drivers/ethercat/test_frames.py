"""Frames that do not follow the standard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.ethercat.capture import Capture, Frames
from drivers.ethercat.frames import Command, DatagramFlag, Kind, decode
from drivers.ethercat.process_data.assembly import Assembler
from drivers.ethercat.process_data.object_layout import make_layout
from drivers.trace.capture_survey import Survey
from schemas.errors import TraceError
from schemas.robot import load_robot
from tests.drivers.ethercat.wire import datagram, frame

MUTANTS = 30_000


def frames_of(*packets: bytes) -> Frames:
    data = np.frombuffer(b"".join(packets), np.uint8)
    length = np.array([len(packet) for packet in packets], np.int64)
    zeros = np.zeros(len(packets), np.int64)
    return Frames(data, np.cumsum(length) - length, length, zeros, zeros.astype(np.uint8), zeros.astype(np.uint8))


def mutants(folder: Path, count: int) -> Frames:
    """`count` frames of the captures with bytes changed, bits flipped, tails cut off and runs overwritten."""
    random = np.random.default_rng(402)
    originals = []
    for path in sorted(folder.glob("*.pcap*")):
        for block in Capture(path).blocks():
            picked = random.choice(len(block), min(len(block), 3000), replace=False)
            originals += [block.data[block.offset[i] :][: block.length[i]].tobytes() for i in picked]
    packets = []
    for number in range(count):
        packet = bytearray(originals[number % len(originals)])
        for _ in range(random.integers(1, 6)):
            at = int(random.integers(min(len(packet), 64)))  # headers are at the front
            packet[at] = int(random.integers(256)) if number % 2 else packet[at] ^ 1 << int(random.integers(8))
        if number % 5 == 0:
            packet = packet[: random.integers(len(packet) + 1)]
        if number % 7 == 0 and len(packet) > 20:
            packet[14:20] = random.bytes(6)
        packets.append(bytes(packet))
    return frames_of(*packets)


@pytest.fixture(scope="module")
def mutated(data: Path) -> Frames:
    return mutants(data / "captures", MUTANTS)


def test_mutated_frames_are_decoded_within_their_own_bytes(mutated: Frames) -> None:
    frames = mutated
    datagrams, kinds = decode(frames)

    assert len(kinds) == MUTANTS
    assert set(kinds.tolist()) == set(Kind)  # the mutants reach every branch
    start = frames.offset[datagrams["frame"]]
    end = start + frames.length[datagrams["frame"]]
    whole = datagrams["flags"] & DatagramFlag.CUT == 0
    assert (datagrams["data"] >= start + 16).all()
    assert (datagrams["data"] <= end).all()
    assert (datagrams["data"] + datagrams["length"] + 2 <= end)[whole].all()
    assert (np.diff(datagrams["frame"]) >= 0).all()
    assert np.isin(datagrams["frame"][~whole], np.flatnonzero(kinds == Kind.CUT)).all()


def test_mutated_frames_give_samples_or_none_but_no_crash(mutated: Frames) -> None:
    robot = load_robot(Path(__file__).parent / "robots" / "own_three_drives.toml")
    samples, raw = Assembler(make_layout(robot)).samples(mutated)
    Survey().add(mutated)

    assert 1000 < len(samples) < MUTANTS  # many mutants leave the process data readable
    assert len(raw) == len(samples)
    assert (np.abs(raw) < 2**32).all()
    np.testing.assert_array_equal(samples["sequence"], np.arange(len(samples)))


def test_mutated_files_end_in_frames_or_one_error(data: Path, tmp_path: Path) -> None:
    random = np.random.default_rng(6)
    refused = []
    for number in range(300):
        name = ("ethercat.pcapng", "twincat-scan-boxes.pcapng", "own_three_drives_4khz.pcap")[number % 3]
        content = bytearray((data / "captures" / name).read_bytes()[:20_000])
        for _ in range(random.integers(1, 8)):
            content[int(random.integers(len(content) if number % 2 else 400))] = int(random.integers(256))
        path = tmp_path / name
        path.write_bytes(content[: random.integers(len(content))] if number % 4 == 0 else content)
        capture = Capture(path)
        try:
            for frames in capture.blocks():
                decode(frames)
                assert (frames.offset + frames.length <= len(frames.data)).all()
        except TraceError as error:
            refused.append(str(error).startswith(f"{path}: "))
    assert refused
    assert all(refused)


@pytest.mark.parametrize("size", range(0, 60))
def test_a_frame_cut_at_any_byte_is_never_read_past_it(size: int) -> None:
    whole = frame(datagram(Command.LRW, 0, bytes(20), 3), datagram(Command.BRD, 0x01300000, bytes(2), 3))
    frames = frames_of(whole[:size], b"\xff" * 64)
    datagrams, kinds = decode(frames)

    assert kinds[1] == Kind.OTHER
    assert kinds[0] == (Kind.OTHER if size < 14 else Kind.DATAGRAMS if size == len(whole) else Kind.CUT)
    assert (datagrams["data"] <= size).all()


def test_many_datagrams_a_frame() -> None:
    packet = frame(*(datagram(Command.FPRD, 0x01300000 | k, bytes(2), 1, index=k) for k in range(90)))
    datagrams, kinds = decode(frames_of(packet, packet))

    assert kinds.tolist() == [Kind.DATAGRAMS] * 2
    assert datagrams["index"].tolist() == list(range(90)) * 2
    assert datagrams["frame"].tolist() == [0] * 90 + [1] * 90


def test_ethercat_in_udp_is_found_and_other_udp_is_not() -> None:
    body = frame(datagram(Command.LRW, 0, bytes(4), 3))[14:]
    for port, kind in ((0x88A4, Kind.DATAGRAMS), (53, Kind.OTHER)):
        udp = b"\x88\xa4" + port.to_bytes(2, "big") + (len(body) + 8).to_bytes(2, "big") + bytes(2)
        packet = b"\xff" * 6 + b"\x02" * 6 + b"\x08\x00\x45" + bytes(8) + b"\x11" + bytes(10) + udp + body
        assert decode(frames_of(packet))[1].tolist() == [kind]


def test_types_other_than_commands_are_told_apart() -> None:
    packet = bytearray(frame(datagram(Command.LRW, 0, bytes(4), 3)))
    packet[15] = packet[15] & 0x0F | 0x40  # network variables
    assert decode(frames_of(bytes(packet)))[1].tolist() == [Kind.NOT_COMMANDS]
