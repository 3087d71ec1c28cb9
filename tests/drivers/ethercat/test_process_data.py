"""From captured frames to joint samples: which pass is believed, which cycle, which clock, and what goes wrong."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.ethercat.capture import Capture
from drivers.ethercat.process_data.assembly import Assembler
from drivers.ethercat.process_data.object_layout import make_layout
from schemas.errors import RobotError
from schemas.messages import SampleFlag, stamp_ns
from schemas.robot import Robot, load_robot
from tests.drivers.ethercat.wire import (
    PER_COUNT,
    PER_MILLE,
    Drive,
    cycle,
    datagram,
    frame,
    netanalyzer,
    of_cycles,
    passes,
    pcap,
    pcapng,
    robot,
    tshark,
)

START = 1_700_000_000_000_000_000
LOCAL = bytes.fromhex("7285c28dd3c4")  # a master whose own address has the bit set


def assembled(path: Path, description: Robot) -> tuple[np.ndarray, Assembler]:
    assembler = Assembler(make_layout(description))
    parts = [assembler.samples(frames)[0] for frames in Capture(path).blocks()]
    return np.concatenate(parts), assembler


def stream(count: int, period: int = 1_000_000, **options: Any) -> list[tuple[int, bytes]]:
    """Both passes of `count` cycles, the returned one 20 µs behind."""
    packets = []
    for number in range(count):
        out, back = passes(cycle(number), cycle(number - 1), index=number % 256, **options)
        packets += [(START + number * period, out), (START + number * period + 20_000, back)]
    return packets


@pytest.mark.parametrize("shared_addresses", [False, True])
@pytest.mark.parametrize("source", [None, LOCAL])
def test_the_returned_frame_carries_this_cycles_inputs(
    tmp_path: Path, shared_addresses: bool, source: bytes | None
) -> None:
    options: dict[str, Any] = {"shared": shared_addresses} | ({"source": source} if source else {})
    path = pcap(tmp_path / "a.pcap", stream(300, **options), nanoseconds=True)
    samples, assembler = assembled(path, robot(shared=shared_addresses))

    of_cycles(samples, range(300))
    assert not samples["flags"].any()
    assert samples["sequence"].tolist() == list(range(300))
    np.testing.assert_array_equal(stamp_ns(samples), START + 20_000 + 1_000_000 * np.arange(300))
    assert (assembler.count("sent"), assembler.count("returned")) == (300, 300)
    assert assembler.period_ns == 1_000_000


def test_only_returned_frames_give_the_same_samples_where_addresses_are_not_shared(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", stream(50)[1::2], nanoseconds=True)
    samples, assembler = assembled(path, robot())

    of_cycles(samples, range(50))
    assert assembler.count("sent") == 0


def test_only_returned_frames_have_no_command_where_inputs_overwrite_it(tmp_path: Path) -> None:
    samples, _ = assembled(pcap(tmp_path / "a.pcap", stream(50, shared=True)[1::2]), robot(shared=True))

    assert np.isnan(samples["position_command"]).all()
    assert (samples["flags"] == SampleFlag.NO_COMMAND).all()


def test_only_sent_frames_give_no_sample(tmp_path: Path) -> None:
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", stream(50)[::2]), robot())

    assert len(samples) == 0
    assert assembler.count("sent") == 50


def test_frames_that_overtake_each_other_keep_their_own_cycle(tmp_path: Path) -> None:
    packets = stream(200, shared=True)
    bunched = [
        packets[i] for first in range(0, 400, 8) for i in (*range(first, first + 8, 2), *range(first + 1, first + 8, 2))
    ]
    samples, _ = assembled(pcap(tmp_path / "a.pcap", bunched, nanoseconds=True), robot(shared=True))

    of_cycles(samples, range(200))


def test_between_two_slaves_the_way_out_is_told_by_its_smaller_working_counter(tmp_path: Path) -> None:
    packets = []
    for number in range(100):
        _, half = passes([*cycle(number)[:1], *cycle(number - 1)[1:]], working_counter=3, index=number)
        _, back = passes(cycle(number), index=number)
        packets += [
            (number * 1_000_000, netanalyzer(half, port=0)),
            (number * 1_000_000 + 9_000, netanalyzer(back, port=1)),
        ]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, link_type=240), robot())

    of_cycles(samples[-99:], range(1, 100))  # the first frame of all may be taken for a returned one
    assert assembler.count("sent") >= 99


def test_inputs_and_outputs_in_datagrams_and_frames_of_their_own(tmp_path: Path) -> None:
    packets = []
    for number in range(60):
        drives = cycle(number)
        outputs, inputs = b"".join(d.outputs for d in drives), [d.inputs for d in drives]
        for returned in (False, True):
            counter = int(returned)
            packets += [
                (number * 1000_000, frame(datagram(11, 0x1000, outputs, 3 * counter), returned=returned)),
                (
                    number * 1000_000 + 9000,
                    frame(
                        *(
                            datagram(10, 0x1000 + 36 + 14 * k, data if returned else bytes(14), counter)
                            for k, data in enumerate(inputs)
                        ),
                        returned=returned,
                    ),
                ),
            ]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets), robot())

    of_cycles(samples, range(60))
    assert not samples["flags"].any()
    assert assembler.count("incomplete") == 0


@pytest.mark.parametrize("shared_addresses", [False, True])
@pytest.mark.parametrize("source", [None, LOCAL])
@pytest.mark.parametrize("indexes", [256, 16, 1])
def test_recordings_that_miss_different_frames_agree_on_every_cycle_both_saw(
    tmp_path: Path, shared_addresses: bool, source: bytes | None, indexes: int
) -> None:
    options: dict[str, Any] = {"shared": shared_addresses} | ({"source": source} if source else {})
    packets = []
    for number in range(600):
        clock = struct.pack("<Q", 10**9 + 1_000_000 * number)
        pair = passes(cycle(number), cycle(number - 1), index=number % indexes, clock=clock, **options)
        packets += [(START + number * 1_000_000 + 20_000 * returned, data) for returned, data in enumerate(pair)]
    whole, _ = assembled(pcap(tmp_path / "whole.pcap", packets, nanoseconds=True), robot(shared=shared_addresses))
    rng = np.random.default_rng(7)
    for number in range(5):
        kept = rng.random(1200) > 0.1
        kept[:40] = True  # until the cycle time is known
        path = pcap(tmp_path / f"{number}.pcap", [p for p, k in zip(packets, kept, strict=True) if k], nanoseconds=True)
        samples, assembler = assembled(path, robot(shared=shared_addresses))

        seen = kept[1::2]
        assert stamp_ns(samples).tolist() == stamp_ns(whole[seen]).tolist()
        for name in ("position", "torque"):
            assert samples[name].tobytes() == whole[seen][name].tobytes()
        commanded = kept[::2][seen] | (not shared_addresses)
        for name in ("position_command", "torque_command"):
            assert samples[name][commanded].tobytes() == whole[seen][name][commanded].tobytes()
            assert np.isnan(samples[name][~commanded]).all()
        after_gap = np.diff(np.flatnonzero(seen), prepend=-1) > 1
        flags = np.where(after_gap, SampleFlag.GAP_BEFORE, 0) | np.where(commanded, 0, SampleFlag.NO_COMMAND)
        np.testing.assert_array_equal(samples["flags"], flags)
        assert assembler.count("lost") == len(seen) - seen[::-1].argmax() - seen.sum()  # behind the last one none shows


def test_a_short_clock_is_continued_over_a_pause_of_several_of_its_wraps(tmp_path: Path) -> None:
    numbers = [*range(50), *range(20_000, 20_050)]  # 20 s
    packets = [
        (START + k * 1_000_000, passes(cycle(k), index=k % 256, clock=struct.pack("<Q", (k + 1) * 1_000_000)[:4])[1])
        for k in numbers
    ]
    samples, _ = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    np.testing.assert_array_equal(stamp_ns(samples), 1_000_000 * (np.array(numbers) + 1))


@pytest.mark.parametrize("size", [8, 4])
def test_time_is_the_distributed_clocks_even_over_the_wrap_of_its_low_word(tmp_path: Path, size: int) -> None:
    first = (1 << 32) * 7 - 50 * 250_000  # wraps after 50 cycles
    packets = []
    for number in range(120):
        clock = struct.pack("<Q", first + 250_000 * number)[:size]
        out, back = passes(cycle(number), cycle(number - 1), index=number, clock=clock)
        jitter = 70_000 * (number % 3)
        packets += [(START + number * 250_000 + jitter, out), (START + number * 250_000 + jitter + 9_000, back)]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert assembler.distributed_clock
    stamps = stamp_ns(samples)
    np.testing.assert_array_equal(np.diff(stamps), 250_000)
    assert stamps[0] == (first if size == 8 else first % (1 << 32))
    assert not samples["flags"].any()


def test_a_cycle_without_clock_goes_on_by_the_captures(tmp_path: Path) -> None:
    packets = []
    for number in range(40):
        clock = b"" if number == 20 else struct.pack("<Q", 10**9 + 1_000_000 * number)
        _, back = passes(cycle(number), index=number, clock=clock)
        packets.append((START + number * 1_000_000, back))
    samples, _ = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    np.testing.assert_array_equal(stamp_ns(samples), 10**9 + 1_000_000 * np.arange(40))


def test_a_clock_that_stands_at_zero_is_not_believed(tmp_path: Path) -> None:
    packets = [(START + k * 1_000_000, passes(cycle(k), index=k, clock=bytes(8))[1]) for k in range(40)]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert not assembler.distributed_clock
    assert stamp_ns(samples)[0] == START


@pytest.mark.parametrize("source", [None, LOCAL])
def test_an_unanswered_cycle_is_a_flagged_sample_without_values(tmp_path: Path, source: bytes | None) -> None:
    options: dict[str, Any] = {"source": source} if source else {}
    packets = stream(100, **options)
    out, back = passes(cycle(50), working_counter=0, index=50, **options)
    packets[100:102] = [(packets[100][0], out), (packets[101][0], back)]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert len(samples) == 100
    assert np.isnan(samples["position"][50]).all()
    assert np.isnan(samples["torque"][50]).all()
    assert samples["flags"][50] == SampleFlag.BUS_FAULT | SampleFlag.NOT_A_NUMBER
    assert np.count_nonzero(samples["flags"]) == 1
    assert (assembler.count("counter_faults"), assembler.count("unanswered")) == (1, 1)


def test_a_missing_drive_is_a_flagged_sample(tmp_path: Path) -> None:
    packets = stream(100)
    packets[121] = (packets[121][0], passes(cycle(60), working_counter=6, index=60)[1])
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert np.flatnonzero(samples["flags"] & SampleFlag.BUS_FAULT).tolist() == [60]
    assert assembler.count("counter_faults") == 1


def test_a_working_counter_never_complete_is_a_fault_from_the_first_cycle(tmp_path: Path) -> None:
    samples, _ = assembled(pcap(tmp_path / "a.pcap", stream(30, working_counter=6)), robot())

    assert (samples["flags"] & SampleFlag.BUS_FAULT != 0).all()


def test_further_slaves_in_the_same_datagram_are_learned(tmp_path: Path) -> None:
    packets = stream(100, working_counter=11)
    packets[121] = (packets[121][0], passes(cycle(60), working_counter=10, index=60)[1])
    samples, _ = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert np.flatnonzero(samples["flags"]).tolist() == [60]


@pytest.mark.parametrize(("status", "fault"), [(0x08, 1), (0x0F, 1), (0x40, 0), (0x07, 0)])
def test_a_drive_that_is_not_in_operation_flags_its_cycle(tmp_path: Path, status: int, fault: int) -> None:
    packets = stream(40)
    drives = cycle(9)
    drives[1] = replace(drives[1], status=status)
    packets[19] = (packets[19][0], passes(drives, index=9)[1])
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert np.flatnonzero(samples["flags"]).tolist() == [9]
    assert samples["flags"][9] == SampleFlag.BUS_FAULT
    assert (assembler.count("not_enabled"), assembler.count("drive_faults")) == (1, fault)
    of_cycles(samples, range(40))


def test_lost_cycles_are_a_flag_and_a_count_and_no_hole_in_the_sequence(tmp_path: Path) -> None:
    packets = stream(100)
    del packets[120:126]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert np.flatnonzero(samples["flags"]).tolist() == [60]
    assert samples["flags"][60] == SampleFlag.GAP_BEFORE
    assert (assembler.count("gaps"), assembler.count("lost")) == (1, 3)
    assert samples["sequence"].tolist() == list(range(97))


STALL = [40.0 - k for k in range(40)]


@pytest.mark.parametrize("late", [[0.6], [0.7, 0.5, 0.3], [3.9, 2.9, 1.9, 0.9], STALL, [*STALL, 0, 0, *STALL]])
def test_a_late_cycle_that_is_caught_up_with_is_not_lost(tmp_path: Path, late: list[float]) -> None:
    packets = stream(200)
    for behind, share in enumerate(late):
        for both in (200 + 2 * behind, 201 + 2 * behind):
            packets[both] = (packets[both][0] + int(share * 1_000_000), packets[both][1])
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert assembler.count("lost") == 0
    assert assembler.period_ns == 1_000_000
    assert samples["flags"][100] == SampleFlag.GAP_BEFORE  # known only afterwards


def test_repeated_and_falling_stamps_are_flagged(tmp_path: Path) -> None:
    packets = stream(60)[1::2]
    packets[30] = (packets[29][0], packets[30][1])
    packets[40] = (packets[20][0], packets[40][1])
    samples, _ = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert samples["flags"][30] == SampleFlag.REPEATED
    assert samples["flags"][40] == SampleFlag.TIME_BACKWARDS


def test_damaged_and_snapped_frames_are_left_out_and_counted(tmp_path: Path) -> None:
    packets = [(t, netanalyzer(p, errors=4 * (k == 31))) for k, (t, p) in enumerate(stream(40))]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, link_type=240, nanoseconds=True), robot())
    of_cycles(samples, [k for k in range(40) if k != 15])
    assert assembler.count("damaged") == 1

    samples, assembler = assembled(pcap(tmp_path / "b.pcap", stream(40), snap=60), robot())
    assert len(samples) == 0
    assert assembler.count("damaged") == 80


def test_a_part_that_never_came_leaves_its_cycle_out(tmp_path: Path) -> None:
    packets = []
    for number in range(40):
        parts = [datagram(10, 0x1024 + 14 * k, d.inputs, 1) for k, d in enumerate(cycle(number))]
        packets += [
            (number * 1_000_000 + k, frame(part, returned=True))
            for k, part in enumerate(parts)
            if (number, k) != (20, 2)
        ]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets), robot())

    np.testing.assert_allclose(samples["position"][:, 0] / PER_COUNT, [1000 * n for n in range(40) if n != 20])
    assert assembler.count("incomplete") == 1


@pytest.mark.parametrize(("mode", "asked"), [(8, 5), (9, 5), (10, 105)])
def test_the_target_torque_counts_in_torque_mode_only(tmp_path: Path, mode: int, asked: int) -> None:
    drives = [Drive(mode=mode, target_torque=100, offset=5)] * 3
    packets = [(k * 1_000_000, passes(drives, index=k)[1]) for k in range(3)]
    samples, _ = assembled(pcap(tmp_path / "a.pcap", packets), robot())

    np.testing.assert_allclose(samples["torque_command"], asked * PER_MILLE)


def test_interfaces_with_clocks_of_their_own_join_into_one_stream(tmp_path: Path) -> None:
    packets = [(k % 2, (t // 1000 if k % 2 == 0 else t), p) for k, (t, p) in enumerate(stream(50, shared=True))]
    path = pcapng(tmp_path / "a.pcapng", packets, [(1, b"\x06"), (1, b"\x09")])
    samples, _ = assembled(path, robot(shared=True))

    of_cycles(samples, range(50))
    np.testing.assert_array_equal(np.diff(stamp_ns(samples)), 1_000_000)


def test_our_own_rig_against_tsharks_bytes(data: Path) -> None:
    path = data / "captures" / "own_three_drives_4khz.pcap"
    description = load_robot(Path(__file__).parent / "robots" / "own_three_drives.toml")
    samples, assembler = assembled(path, description)
    rows = tshark(path, "eth.src", "ecat.data", "frame.time_epoch", select="ecat.cmd == 0xc")
    images = [(row[0], bytes.fromhex(row[1].split(",")[0])) for row in rows]
    returned = [image for source, image in images if source.startswith("03")]
    drives = np.array([[struct.unpack_from("<Hiihb", image, 27 + 13 * k) for k in range(3)] for image in returned])
    targets = np.array([[struct.unpack_from("<Hihb", image, 9 * k)[1] for k in range(3)] for image in returned])

    assert len(samples) == len(returned) == 5021
    np.testing.assert_allclose(samples["position"], drives[:, :, 1] * math.tau / 131072, atol=1e-12)
    np.testing.assert_allclose(samples["position_command"], targets * math.tau / 131072, atol=1e-12)
    np.testing.assert_allclose(samples["torque"], drives[:, :, 3] * 2.4e-3, atol=1e-12)
    enabled = (drives[:, :, 0] & 0x6F == 0x27).all(axis=1)
    np.testing.assert_array_equal(samples["flags"] & SampleFlag.BUS_FAULT == 0, enabled)
    # the rig's drives follow at once: this cycle's inputs are this cycle's targets, and the sent frame has the last's
    np.testing.assert_array_equal(drives[enabled, :, 1], targets[enabled])
    sent = [image for source, image in images if source.startswith("01")]
    np.testing.assert_array_equal([image[27:] for image in sent[1:]], [image[27:] for image in returned[:-1]])
    assert assembler.count("sent") == 5021


def test_every_twincat_cycle_that_is_seen_twice_is_one_sample(data: Path) -> None:
    path = data / "captures" / "ethercat.pcapng"
    joints = [
        {"inputs_address": 0x1000000 + 6 * k, "inputs": ["0x6064", "0x6077"], "outputs": [], "outputs_address": None}
        for k in range(3)
    ]
    base = robot().model_dump(exclude_none=True)
    for joint, change in zip(base["drive"]["joint"], joints, strict=True):
        joint.update(change)
    samples, assembler = assembled(path, Robot.model_validate(base))
    rows = tshark(path, "eth.src", "ecat.sub2.data", "frame.time_epoch", select="ecat.lad == 0x1000000")
    returned = [row for row in rows if row[0].startswith("02")]
    values = np.array([struct.unpack("<" + 3 * "ih" + "2x", bytes.fromhex(row[1])) for row in returned])

    assert (assembler.count("sent"), assembler.count("returned")) == (14, 13)
    np.testing.assert_allclose(samples["position"], values[:, ::2] * PER_COUNT)
    np.testing.assert_allclose(samples["torque"], values[:, 1::2] * PER_MILLE)
    assert stamp_ns(samples).tolist() == [int(row[2].replace(".", "")) for row in returned]
    assert not (samples["flags"] & ~np.uint32(SampleFlag.NO_COMMAND)).any()
    assert assembler.period_ns == 0  # thirteen cycles are not enough to say


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": ["0x6064"]}, r"drive\.joint\.0\.inputs: 0x6077 is not mapped"),
        ({"inputs": ["0x6064", "0x2010"]}, "write .0x2010:bits"),
        ({"inputs": ["6064;"]}, "is not an object"),
        ({"inputs": ["0x6064:16"]}, "32 bits in CiA 402"),
        ({"inputs": [":4", "0x6064", "0x6077"]}, "bit 4 of a byte"),
        ({"inputs": [], "inputs_address": None}, "missing key"),
    ],
)
def test_a_mapping_that_cannot_be_is_one_error_naming_the_key(changes: dict, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        make_layout(robot(**changes))


def test_what_was_sent_and_did_not_come_back_is_missing_while_it_is(tmp_path: Path) -> None:
    packets = stream(100)
    cut = [packet for number, packet in enumerate(packets) if number < 120 or not number % 2]
    _, assembler = assembled(pcap(tmp_path / "a.pcap", cut, nanoseconds=True), robot())
    assert (assembler.count("lost"), assembler.count("missing")) == (0, 39)  # the last one may be on its way

    mended = [packet for number, packet in enumerate(packets) if not 120 <= number < 190 or not number % 2]
    samples, assembler = assembled(pcap(tmp_path / "b.pcap", mended, nanoseconds=True), robot())
    assert (assembler.count("lost"), assembler.count("missing"), assembler.count("pauses")) == (35, 0, 0)
    assert np.flatnonzero(samples["flags"]).tolist() == [60]


def test_a_master_that_sends_nothing_loses_nothing(tmp_path: Path) -> None:
    packets = stream(100)
    del packets[120:170]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert (assembler.count("gaps"), assembler.count("pauses"), assembler.count("lost")) == (1, 1, 0)
    assert samples["flags"][60] == SampleFlag.GAP_BEFORE

    returned = packets[1::2]  # one who hears the way back alone cannot tell that from a loss
    _, assembler = assembled(pcap(tmp_path / "b.pcap", returned, nanoseconds=True), robot())
    assert (assembler.count("pauses"), assembler.count("lost")) == (0, 25)


def test_one_corrupted_working_counter_does_not_make_every_later_one_wrong(tmp_path: Path) -> None:
    packets = []
    for number in range(60):
        pair = passes(cycle(number), cycle(number - 1), working_counter=265 if number == 30 else 9, index=number)
        packets += [(START + number * 1_000_000 + 20_000 * returned, data) for returned, data in enumerate(pair)]
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert not (samples["flags"][31:] & SampleFlag.BUS_FAULT).any()
    assert assembler.count("counter_faults") == 0


def test_a_returned_frame_that_comes_twice_is_one_sample_flagged_as_repeated(tmp_path: Path) -> None:
    packets = stream(60)
    time, data = packets[81]
    packets.insert(82, (time + 10_000, data))
    samples, assembler = assembled(pcap(tmp_path / "a.pcap", packets, nanoseconds=True), robot())

    assert np.flatnonzero(samples["flags"] & SampleFlag.REPEATED).tolist() == [41]
    assert assembler.count("repeated") == 1
    of_cycles(np.delete(samples, 41), range(60))
