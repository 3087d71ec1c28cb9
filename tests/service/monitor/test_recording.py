"""Recordings: read back by the mcap and mcap-ros2 libraries, broken in every way a file breaks, repaired."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader

from drivers.trace import read_trace, write_trace
from drivers.trace.mcap_file import read_samples
from schemas.errors import StorageError
from schemas.messages import OF_DELTA, PAYLOAD, SAMPLE, TOPICS, Message, dtype_of, set_stamp, topics_of
from schemas.robot import load_robot
from schemas.ros2 import type_hash
from service.monitor.readback import read_recording
from service.monitor.recording import RecordingWriter
from service.monitor.repair import Recovered, recover

OWN = topics_of(OF_DELTA)

WALL_NS = 1_790_000_000_000_000_000
FLUSHES = 10
PER_FLUSH = 200  # samples between two flushes, 1 kHz


def filled(message: Message, count: int, first: int = 0) -> np.ndarray:
    """`count` records with every field set to something of its own, drawn from the sequence number."""
    records = message.empty(count)
    generator = np.random.default_rng(first)
    for name in [name for name in message.dtype.names or () if name not in ("cdr_header", "frame_id")]:
        shape, kind = records[name].shape, records[name].dtype.kind
        records[name] = generator.normal(size=shape) if kind == "f" else generator.integers(0, 100, shape)
    records["sequence"] = np.arange(first, first + count)
    set_stamp(records, records["sequence"].astype(np.int64) * 1_000_000)
    return records


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A whole recording: 2000 samples in ten flushes, and ten of each other message."""
    recording = RecordingWriter(tmp_path / "run.mcap", "bench")
    for number in range(FLUSHES):
        first = number * PER_FLUSH
        log = WALL_NS + np.arange(first, first + PER_FLUSH) * 1_000_000
        recording.write("sample", filled(SAMPLE, PER_FLUSH, first), log)
        for topic, message in OWN.items():
            if topic != "sample":
                recording.write(topic, filled(message, 1, number), log[:1])
        recording.note("sequence_gap", {"topic": "sample", "missed": str(number)})
        recording.flush()
    recording.close()
    return tmp_path / "run.mcap"


def repaired(source: Path, target: Path) -> Recovered:
    with source.open("rb") as stream:
        return recover(source, stream, target)


def samples(path: Path) -> np.ndarray:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        data = [m.data for _, _, m in reader.iter_messages(["/deltatwin/bench/sample"], log_time_order=False)]
    return np.frombuffer(b"".join(data), SAMPLE.dtype)


EARLIER = PAYLOAD.text[: PAYLOAD.text.index("float64 random_std_dev")]  # as it was until 2026-11


def recording_by(path: Path, text: str) -> np.ndarray:
    """A recording of three payloads whose schema is `text`, and what was written."""
    layout = dtype_of(text)
    written = np.zeros(3, layout)
    for name in set(layout.names or ()) & set(PAYLOAD.dtype.names or ()):
        written[name] = filled(PAYLOAD, 3)[name]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(
            PAYLOAD.schema_name, "ros2msg", Message("Payload", text, layout).schema_text.encode()
        )
        channel = writer.register_channel("/deltatwin/bench/payload", "cdr", schema)
        for number, record in enumerate(written):
            writer.add_message(channel, WALL_NS + number, record.tobytes(), WALL_NS + number)
        writer.finish()
    return written


def test_a_recording_of_an_earlier_version_reads_what_it_does_not_have_as_nan(tmp_path: Path) -> None:
    written = recording_by(tmp_path / "old.mcap", EARLIER)
    read = read_recording(tmp_path / "old.mcap")["payload"].records
    assert read.dtype == PAYLOAD.dtype
    for name in ("mass", "std_dev", "trusted", "event", "sequence"):
        np.testing.assert_array_equal(read[name], written[name])
    assert np.isnan(read["random_std_dev"]).all()
    assert np.isnan(read["common_std_dev"]).all()


def test_a_recording_without_what_every_version_has_is_refused(tmp_path: Path) -> None:
    recording_by(tmp_path / "odd.mcap", EARLIER.replace("float64 mass ", "float64 weight "))
    with pytest.raises(StorageError, match="Payload without mass"):
        read_recording(tmp_path / "odd.mcap")


def test_every_field_of_every_message_decodes_as_ros2(run: Path) -> None:
    counts: Counter[str] = Counter()
    with run.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, raw, decoded in reader.iter_decoded_messages():
            assert schema is not None
            topic = channel.topic.removeprefix("/deltatwin/bench/")
            record = TOPICS[topic].decode(raw.data)
            counts[topic] += 1
            assert raw.log_time >= WALL_NS
            if topic != "health":  # put on the samples' clock
                assert raw.publish_time == decoded.header.stamp.sec * 1_000_000_000 + decoded.header.stamp.nanosec
            assert raw.sequence == decoded.sequence
            for name in record.dtype.names[1:]:  # pyright: ignore[reportOptionalSubscript]
                if name != "frame_id" and not name.startswith("stamp_"):
                    told = getattr(decoded, name)  # bytes where it is uint8[]
                    assert np.array_equal(record[name], list(told) if isinstance(told, bytes) else told), (topic, name)
    assert counts == {topic: PER_FLUSH * FLUSHES if topic == "sample" else FLUSHES for topic in OWN}


def test_health_is_on_the_clock_of_the_samples(tmp_path: Path) -> None:
    """Data at 0 to 2 s, replayed now: health from before the first sample on as well; without samples its own stamp."""
    for replayed, expected in ((True, [0, 480, 980]), (False, [77, 577, 1077])):
        path = tmp_path / f"{replayed}.mcap"
        recording = RecordingWriter(path, "bench")
        for number, ms in enumerate((80, 580, 1080)):
            sent = np.array([WALL_NS + ms * 1_000_000])
            health = filled(TOPICS["health"], 1, number)
            set_stamp(health, sent - 3_000_000)
            recording.write("health", health, sent)
            if replayed:
                sample = filled(SAMPLE, 1, ms - 80)  # stamped with its number in ms, sent 20 ms after health
                recording.write("sample", sample, sent + 20_000_000)
        recording.close()
        with path.open("rb") as stream:
            found = [m.publish_time for _, c, m in make_reader(stream).iter_messages() if c.topic.endswith("health")]
        start = 0 if replayed else WALL_NS
        assert found == [start + ms * 1_000_000 for ms in expected]


def test_samples_come_back_bit_for_bit_and_as_a_trace(run: Path) -> None:
    expected = np.concatenate([filled(SAMPLE, PER_FLUSH, n * PER_FLUSH) for n in range(FLUSHES)])
    assert samples(run).tobytes() == expected.tobytes()
    trace = read_trace(run)
    assert np.array_equal(trace.position, expected["position"])
    assert np.allclose(trace.time, np.arange(2000) * 1e-3, rtol=0, atol=1e-12)


def test_whole_file_is_copied_whole(run: Path, tmp_path: Path) -> None:
    saved = repaired(run, tmp_path / "copy.mcap")
    assert saved.whole
    assert saved.bad_chunks == 0
    assert saved.span_s == pytest.approx(1.999)
    assert saved.counts == {
        f"/deltatwin/bench/{topic}": PER_FLUSH * FLUSHES if topic == "sample" else FLUSHES for topic in OWN
    }
    assert samples(tmp_path / "copy.mcap").tobytes() == samples(run).tobytes()
    with (tmp_path / "copy.mcap").open("rb") as stream:
        names = Counter(record.name for record in make_reader(stream).iter_metadata())
    assert names == {"sequence_gap": FLUSHES, "rosbag2": 1}


@pytest.mark.parametrize("kind", ["monitor", "recover", "convert"])
def test_another_reader_of_bags_takes_it(run: Path, tmp_path: Path, kind: str) -> None:
    """As `ros2 bag info` would, from the file alone, and from what it keeps of itself as metadata.yaml."""
    path, count = tmp_path / f"{kind}.mcap", {topic: FLUSHES for topic in OWN} | {"sample": PER_FLUSH * FLUSHES}
    if kind == "monitor":
        path = run
    elif kind == "recover":
        repaired(run, path)
    else:
        write_trace(read_trace(run), path, "bench")
        count = {"sample": count["sample"]}
    with path.open("rb") as stream:
        (own,) = [record.metadata for record in make_reader(stream).iter_metadata() if record.name == "rosbag2"]
    folder = tmp_path / "bag"
    folder.mkdir()
    path.rename(folder / path.name)
    (folder / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": json.loads(*own.values())}))
    for source in (folder / path.name, folder):
        with Reader(source) as bag:
            assert bag.message_count == sum(count.values())
            assert {topic: found.msgcount for topic, found in bag.topics.items()} == {
                f"/deltatwin/bench/{topic}": number for topic, number in count.items()
            }
            first = 0 if kind == "convert" else WALL_NS
            assert (bag.start_time, bag.end_time) == (first, first + 1_999_000_001)  # theirs is behind the last
            connections = {connection.topic: connection for connection in bag.connections}
            for topic in count:
                connection = connections[f"/deltatwin/bench/{topic}"]
                assert connection.msgtype == TOPICS[topic].schema_name
                assert source.is_file() or connection.digest == type_hash(TOPICS[topic])


def test_a_recording_from_before_the_header_is_read(tmp_path: Path) -> None:
    """A stamp without header, no gripper, no slash in front, and the robot's own name."""
    text = "\n".join(line for line in SAMPLE.text.splitlines() if "GRIPPER" not in line)
    text = text.replace("std_msgs/Header header", "builtin_interfaces/Time stamp")
    expected, path = filled(SAMPLE, 100), tmp_path / "old.mcap"
    old = np.zeros(100, dtype_of(text))
    assert old.itemsize == SAMPLE.dtype.itemsize - 8 - 4
    for name in old.dtype.names or ():
        old[name] = expected[name]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(SAMPLE.schema_name, "ros2msg", f"{text}\n{'=' * 80}\nMSG: x/Y\nz".encode())
        channel = writer.register_channel("deltatwin/d3-1200/sample", "cdr", schema)
        other = writer.register_channel("deltatwin/other/sample", "cdr", schema)
        writer.add_message(other, 0, old[0].tobytes(), 0)
        for number, record in enumerate(old):
            writer.add_message(channel, number, record.tobytes(), number)
        writer.finish()
    expected["gripper"] = 0
    with path.open("rb") as stream:
        assert read_samples(stream, path, load_robot("d3-1200")).tobytes() == expected.tobytes()


@pytest.mark.parametrize("part", [0.15, 0.3, 0.5, 0.7, 0.9, 0.999])
def test_cut_file_keeps_every_whole_chunk_before_the_cut(run: Path, tmp_path: Path, part: float) -> None:
    content = run.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(len(content) * part)])
    flushed = 0  # chunks that end before the cut, by the index of the whole file
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    flushed = sum(c.chunk_start_offset + c.chunk_length <= len(content) * part for c in summary.chunk_indexes)
    saved = repaired(cut, tmp_path / "out.mcap")
    assert not saved.whole
    assert saved.counts["/deltatwin/bench/sample"] == flushed * PER_FLUSH > 0
    assert samples(tmp_path / "out.mcap")["sequence"].tolist() == list(range(flushed * PER_FLUSH))


def test_damaged_chunk_is_left_out_and_the_rest_saved(run: Path, tmp_path: Path) -> None:
    content = bytearray(run.read_bytes())
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[4]
    content[chunk.chunk_start_offset + chunk.chunk_length - 10] ^= 0x55
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    saved = repaired(bad, tmp_path / "out.mcap")
    assert (saved.bad_chunks, saved.whole) == (1, False)
    kept = [n for n in range(2000) if n // PER_FLUSH != 4]
    assert samples(tmp_path / "out.mcap")["sequence"].tolist() == kept


def test_tail_of_zeros_as_after_a_power_cut_is_passed_over(run: Path, tmp_path: Path) -> None:
    content = run.read_bytes()
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content[: len(content) // 2] + bytes(5000))
    saved = repaired(bad, tmp_path / "out.mcap")
    assert saved.counts["/deltatwin/bench/sample"] >= 3 * PER_FLUSH
    with (tmp_path / "out.mcap").open("rb") as stream:
        assert list(StreamReader(stream, validate_crcs=True).records)


MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not an MCAP file: it does not start like one"),
        (b"time_s,position_1_rad\n0,0\n" * 9, "not an MCAP file: it does not start like one"),
        (MAGIC + bytes(4000), "nothing to save: ."),
        (MAGIC, "nothing to save: ."),
    ],
)
def test_what_is_no_recording_is_refused_and_nothing_is_left_behind(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(StorageError, match=rf"x\.mcap: {says}"):
        repaired(path, tmp_path / "out.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.mcap"]


def test_existing_files_are_never_overwritten(run: Path) -> None:
    with pytest.raises(StorageError, match=r"run\.mcap: exists already"):
        repaired(run, run)
    with pytest.raises(StorageError, match=r"run\.mcap: cannot record: File exists"):
        RecordingWriter(run, "bench")
