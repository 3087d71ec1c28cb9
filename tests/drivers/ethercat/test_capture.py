"""Captures against tshark's reading of the same files."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from drivers.ethercat.capture import Capture, FrameFlag
from drivers.ethercat.frames import Command, Kind, decode
from schemas.errors import TraceError
from tests.drivers.ethercat.wire import datagram, frame, gpio, netanalyzer, pcap, pcapng, tshark

NAMES = [
    "ethercat.pcapng", "own_three_drives_4khz.pcap", "replay-dc.pcapng", "replay-ek1100-el2828-el2889.pcapng",
    "soem-sdinfo-akd.pcapng", "twincat-akd-nc-mode.pcapng", "twincat-scan-boxes.pcapng",
]  # fmt: skip
CYCLE = frame(
    datagram(Command.LRW, 0x1000, bytes(range(20)), 9, index=7),
    datagram(Command.FRMW, 0x09101001, bytes(8), 3, index=7),
    returned=True,
)


def read(path: Path) -> tuple[Capture, dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """The whole file: capture, the frames' columns, datagrams with file-wide frame numbers from 1, kinds."""
    capture = Capture(path)
    columns: dict[str, list[np.ndarray]] = {"time": [], "length": [], "port": [], "flags": []}
    all_datagrams, all_kinds = [], []
    for block in capture.blocks():
        for name, values in columns.items():
            values.append(getattr(block, name).copy())
        datagrams, kinds = decode(block)
        datagrams = datagrams.copy()
        datagrams["frame"] += block.first
        all_datagrams.append(datagrams)
        all_kinds.append(kinds)
    return (
        capture,
        {name: np.concatenate(values) for name, values in columns.items()},
        np.concatenate(all_datagrams),
        np.concatenate(all_kinds),
    )


def numbers(text: str) -> list[int]:
    return [int(value, 0) for value in text.split(",") if value]


def judge(path: Path) -> None:
    """Everything we read of a capture equals what tshark reads: times, frames, datagrams and their fields."""
    capture, frames, datagrams, kinds = read(path)
    rows = tshark(
        path, "frame.time_epoch", "frame.cap_len", "ecatf.type", "ecat.cmd", "ecat.idx", "ecat.cnt",
        "ecat.lad", "ecat.adp", "ecat.ado", "ecat.subframe.length",
    )  # fmt: skip

    assert capture.frames == len(kinds) == len(rows)
    times = [int(Decimal(row[0]) * 10**9) for row in rows]
    np.testing.assert_array_equal(frames["time"], times)
    np.testing.assert_array_equal(kinds != Kind.OTHER, [bool(row[2]) for row in rows])
    for column, name in ((3, "command"), (4, "index"), (5, "working_counter"), (9, "length")):
        np.testing.assert_array_equal(datagrams[name], [v for row in rows for v in numbers(row[column])], name)
    logical = np.isin(datagrams["command"], [Command.LRD, Command.LWR, Command.LRW])
    np.testing.assert_array_equal(datagrams["address"][logical], [v for row in rows for v in numbers(row[6])])
    physical = datagrams["address"][~logical]
    np.testing.assert_array_equal(physical & 0xFFFF, [v for row in rows for v in numbers(row[7])])
    np.testing.assert_array_equal(physical >> 16, [v for row in rows for v in numbers(row[8])])


@pytest.mark.parametrize("name", NAMES)
def test_every_field_of_every_datagram_equals_tsharks(data: Path, name: str) -> None:
    judge(data / "captures" / name)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_pcap_of_either_byte_order_and_clock(tmp_path: Path, order: str, nanoseconds: bool) -> None:
    times = [1_700_000_000_123_456_000 + 250_000 * k + 7 * nanoseconds for k in range(50)]
    judge(pcap(tmp_path / "a.pcap", [(t, CYCLE) for t in times], order=order, nanoseconds=nanoseconds))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("resolution", [b"", b"\x06", b"\x09", b"\x03", b"\x94"])
def test_pcapng_of_either_byte_order_and_any_clock(tmp_path: Path, order: str, resolution: bytes) -> None:
    power = resolution[0] if resolution else 6
    per_second = 2 ** (power & 0x7F) if power & 0x80 else 10**power
    packets = [(0, 1_700_000_000 * per_second + 11 * k, CYCLE) for k in range(50)]
    judge(pcapng(tmp_path / "a.pcapng", packets, [(1, resolution)], order=order))


def test_interfaces_of_one_file_keep_their_own_clock_and_link_type(tmp_path: Path) -> None:
    packets = [
        (0, 1_700_000_000_000_000, CYCLE),
        (1, 1_700_000_000_000_000_123, netanalyzer(CYCLE, port=2)),
        (0, 1_700_000_000_000_250, CYCLE),
    ]
    path = pcapng(tmp_path / "a.pcapng", packets, [(1, b""), (240, b"\x09")])
    judge(path)
    capture, frames, _, _ = read(path)
    assert capture.link_types == {1, 240}
    assert frames["port"].tolist() == [0, 2, 0]
    assert frames["length"].tolist() == [len(CYCLE)] * 3


def test_netanalyzer_frames_lose_header_and_fcs_and_gpio_events_are_no_frames(tmp_path: Path) -> None:
    path = pcap(
        tmp_path / "a.pcap",
        [(0, netanalyzer(CYCLE, port=1)), (1000, gpio(3)), (2000, netanalyzer(CYCLE, errors=4)), (3000, b"\x00")],
        link_type=240,
    )
    _, frames, datagrams, kinds = read(path)

    assert frames["length"].tolist() == [len(CYCLE), 0, len(CYCLE), 0]
    assert frames["port"].tolist() == [1, 3, 0, 0]
    assert frames["flags"].tolist() == [0, FrameFlag.PSEUDO, FrameFlag.DAMAGED, FrameFlag.DAMAGED]
    assert kinds.tolist() == [Kind.DATAGRAMS, Kind.OTHER, Kind.DATAGRAMS, Kind.OTHER]
    rows = tshark(
        path, "netanalyzer.port", "netanalyzer.gpio_event.gpio_number", "netanalyzer.packetstatus", "ecat.cnt"
    )
    assert [row[3] for row in rows] == ["9,3", "", "9,3", ""]
    assert rows[0][:1] == ["1"]
    assert datagrams["working_counter"].tolist() == [9, 3, 9, 3]


@pytest.mark.parametrize("preamble", [7, 6, 12])
def test_transparent_mode_starts_at_the_frame_whatever_the_preamble(tmp_path: Path, preamble: int) -> None:
    path = pcap(tmp_path / "a.pcap", [(0, netanalyzer(CYCLE, transparent=True, preamble=preamble))], link_type=241)
    _, frames, datagrams, _ = read(path)

    assert frames["length"].tolist() == [len(CYCLE)]
    assert datagrams["address"].tolist() == [0x1000, 0x09101001]


def test_transparent_mode_without_a_start_of_frame_is_damage(tmp_path: Path) -> None:
    packet = netanalyzer(bytes(40), transparent=True).replace(b"\xd5", b"\x55")
    _, frames, _, kinds = read(pcap(tmp_path / "a.pcap", [(0, packet)], link_type=241))

    assert frames["flags"].tolist() == [FrameFlag.DAMAGED]
    assert kinds.tolist() == [Kind.OTHER]


@pytest.mark.parametrize("tags", [1, 2])
def test_vlan_tags_are_passed_over(tmp_path: Path, tags: int) -> None:
    tagged = frame(datagram(Command.LRW, 0, bytes(8), 3), vlan=tags)
    judge(pcap(tmp_path / "a.pcap", [(0, tagged)] * 3))


def test_a_capture_cut_anywhere_keeps_every_whole_frame(tmp_path: Path) -> None:
    whole = pcapng(tmp_path / "a.pcapng", [(0, k, CYCLE) for k in range(4)], [(1, b"")]).read_bytes()
    block = (len(whole) - 28 - 20) // 4
    for size in range(28, len(whole)):
        (tmp_path / "b.pcapng").write_bytes(whole[:size])
        capture = Capture(tmp_path / "b.pcapng")
        frames = sum(len(frames) for frames in capture.blocks())
        assert frames == max(0, size - 48) // block
        assert bool(capture.findings) == (size > 28 and (size < 48 or (size - 48) % block != 0))


def test_snapped_frames_are_flagged_and_their_last_datagram_is_not_whole(tmp_path: Path) -> None:
    _, frames, datagrams, kinds = read(pcap(tmp_path / "a.pcap", [(0, CYCLE)], snap=40))

    assert frames["flags"].tolist() == [FrameFlag.SNAPPED]
    assert kinds.tolist() == [Kind.CUT]
    assert len(datagrams) == 1


@pytest.mark.parametrize("content", [b"", b"\xd4\xc3\xb2\xa1", b"time_s,position_1_rad\n0,1\n", b"PK\x03\x04" * 10])
def test_what_is_no_capture_is_one_error_naming_the_file(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(content)
    with pytest.raises(TraceError, match=r"a\.pcap"):
        list(Capture(path).blocks())


def test_a_file_that_is_not_there_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"b\.pcap: No such file"):
        list(Capture(tmp_path / "b.pcap").blocks())


def test_a_damaged_record_ends_the_reading_and_says_where(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [(0, CYCLE)] * 3)
    data = bytearray(path.read_bytes())
    at = 24 + 16 + len(CYCLE)
    data[at + 8 : at + 12] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    capture = Capture(path)

    assert sum(len(frames) for frames in capture.blocks()) == 1
    assert capture.findings == [f"damaged at byte {at}: no packet follows frame 1"]


def test_more_frames_than_one_block_holds_come_out_in_order(tmp_path: Path) -> None:
    tiny = frame(datagram(Command.BRD, 0x01300000, bytes(2), 3))
    path = pcap(tmp_path / "a.pcap", [(1000 * k, tiny) for k in range(200_000)])
    capture = Capture(path)
    times = np.concatenate([frames.time.copy() for frames in capture.blocks()])

    np.testing.assert_array_equal(times, 1000 * np.arange(200_000))
    assert capture.findings == []
    assert capture.bytes_read == path.stat().st_size
