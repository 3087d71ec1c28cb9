"""Frames that a capture has twice are one; the same cycle again and again is not the same frame."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.trace.capture_survey import survey_capture
from drivers.trace.capture_trace import CaptureReader, read_capture
from schemas.errors import TraceError
from schemas.messages import SampleFlag
from tests.drivers.ethercat.test_process_data import LOCAL, START, stream
from tests.drivers.ethercat.wire import cycle, passes, pcap, robot

COUNT = 200
US = 1000  # ns


def bridge(packets: list[tuple[int, bytes]], behind: int = 8 * US) -> list[tuple[int, bytes]]:
    return sorted(([*packets, *((t + behind, data) for t, data in packets)]), key=lambda packet: packet[0])


def mirror(packets: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The answers again, with the tag of the port's VLAN."""
    tagged = [(t + 3 * US, data[:12] + b"\x81\x00\x20\x05" + data[12:]) for t, data in packets[1::2]]
    return sorted([*packets, *tagged], key=lambda packet: packet[0])


def cooked(packets: list[tuple[int, bytes]], second: bool) -> list[tuple[int, bytes]]:
    """As Linux captures on `any`: of the master, and of the bridge it is a port of."""
    found = []
    for k, (t, data) in enumerate(packets):
        source, protocol, rest = data[6:12], data[12:14], data[14:]
        for later, port in ((0, 2), (4 * US, 3)):
            kind = 4 if k % 2 == 0 else 1
            head = (
                protocol + struct.pack(">HIHBB", 0, port, 1, kind, 6) + source + b"\0\0"
                if second
                else struct.pack(">HHH", kind, 1, 6) + source + b"\0\0" + protocol
            )
            found.append((t + later, head + rest))
    return sorted(found, key=lambda packet: packet[0])


@pytest.mark.parametrize("index", ["counted", "constant"])
@pytest.mark.parametrize("source", [None, LOCAL])
@pytest.mark.parametrize("kind", ["plain", "bridge", "mirror", "any", "any2"])
@pytest.mark.parametrize("moves", [True, False])
def test_each_cycle_is_one_sample(tmp_path: Path, kind: str, source: bytes | None, index: str, moves: bool) -> None:
    """Inputs, period and what inspect and convert say are those of the capture without doubles."""
    options: dict[str, Any] = {"source": source} if source else {}
    packets = []
    for number in range(COUNT):
        now, before = (cycle(number), cycle(number - 1)) if moves else (cycle(5), cycle(5))
        out, back = passes(now, before, index=number % 256 if index == "counted" else 7, **options)
        packets += [(START + number * 1000 * US, out), (START + number * 1000 * US + 30 * US, back)]
    made = {
        "plain": lambda: packets, "bridge": lambda: bridge(packets), "mirror": lambda: mirror(packets),
        "any": lambda: cooked(packets, False), "any2": lambda: cooked(packets, True),
    }[kind]()  # fmt: skip
    path = pcap(tmp_path / "log.pcap", made, link_type={"any": 113, "any2": 276}.get(kind, 1), nanoseconds=True)
    trace = read_capture(path, robot())
    np.testing.assert_allclose(np.diff(trace.time), 1e-3, atol=1e-9)
    assert len(trace) == COUNT
    if moves:
        assert (np.diff(trace.position, axis=0) > 0).all()
    assert not np.any(trace.flags & (SampleFlag.REPEATED | SampleFlag.GAP_BEFORE))
    figures = survey_capture(path, robot())
    doubles = len(made) - len(packets)
    assert figures["repeated_frames"] == doubles
    (entry,) = figures["cyclic"]
    assert (entry["sent"], entry["returned"], entry["lost_cycles"]) == (COUNT, COUNT, 0)
    assert entry["cycle_s"] == pytest.approx(1e-3)
    said = " ".join(finding.message for finding in trace.findings)
    assert ("cycle time 1 ms" in said, "lost" in said) == (True, False)
    assert (f"{doubles} frames captured twice" in said) == (doubles > 0)


def test_a_bridge_slower_than_the_bus_is_told_by_the_datagrams_numbers(tmp_path: Path) -> None:
    path = pcap(tmp_path / "log.pcap", bridge(stream(COUNT), behind=50 * US), nanoseconds=True)
    assert len(read_capture(path, robot())) == COUNT


def test_unanswered_cycles_of_a_master_with_a_local_address_are_no_doubles(tmp_path: Path) -> None:
    """They come back as they were sent."""
    packets = stream(COUNT, source=LOCAL)
    for number in (60, 61, 62):
        out, back = passes(cycle(number), cycle(number - 1), 0, index=number, source=LOCAL)
        assert out[14:] == back[14:]
        packets[2 * number : 2 * number + 2] = [(packets[2 * number][0], out), (packets[2 * number + 1][0], back)]
    trace = read_capture(pcap(tmp_path / "log.pcap", packets, nanoseconds=True), robot())
    assert np.flatnonzero(np.isnan(trace.position[:, 0])).tolist() == [60, 61, 62]


@pytest.mark.parametrize("spread", [0, 2 * US])
def test_stamps_of_a_card_that_collects_interrupts(tmp_path: Path, spread: int) -> None:
    """Four cycles come together. inspect and convert say the same: the cycle time by number, and no lost cycles."""
    packets = [(START + (n // 8 + 1) * 4000 * US + (n % 8) * spread, data) for n, (_, data) in enumerate(stream(COUNT))]
    path = pcap(tmp_path / "log.pcap", packets, nanoseconds=True)
    reader = CaptureReader(path, robot())
    assert sum(len(samples) for samples, _ in reader.blocks()) == COUNT
    said = " ".join(finding.message for finding in reader.findings())
    assert "stamps come in bunches" in said
    assert "cycles lost" not in said
    figures = survey_capture(path, robot())
    (entry,) = figures["cyclic"]
    assert entry["cycle_s"] == pytest.approx(1e-3, rel=0.03)  # of the last bunch only one end is known
    assert (entry["jitter_std_s"], entry["lost_cycles"]) == (None, None)
    assert any("stamps come in bunches" in finding for finding in figures["findings"])
    assert float(said.split("cycle time ")[1].split(" ms")[0]) == pytest.approx(1.0, rel=0.03)
    if not spread:
        with pytest.raises(TraceError, match=r"time does not rise .*; stamps come in bunches"):
            read_capture(path, robot())
        return
    told = " ".join(finding.message for finding in read_capture(path, robot()).findings)
    assert "ms missing: before" not in told
    assert "samples per second" not in told
    assert f"of {COUNT} cycles are flagged" in told
