"""Our bytes against an independent CDR codec (mcap-ros2-support) through MCAP files, both ways."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer

from schemas.errors import MessageError
from schemas.messages import SEQUENCE_BYTES, TOPICS, Message, SampleFlag, fields_of, set_stamp, stamp_ns

COUNT = 50
HEADER = ("cdr_header", "stamp_sec", "stamp_nanosec", "frame_id")
ALL = pytest.mark.parametrize("message", TOPICS.values(), ids=TOPICS.keys())


def random_records(message: Message) -> np.ndarray:
    """Random bits in every field, so that a float may be any float, NaN with a payload included."""
    records = message.empty(COUNT)
    rng = np.random.default_rng(11)
    for name in message.dtype.names or ():
        if name not in ("cdr_header", "frame_id"):
            field = records[name]
            records[name] = np.frombuffer(rng.bytes(field.nbytes), field.dtype).reshape(field.shape)
    records["stamp_nanosec"] %= 1_000_000_000
    return records


def values(record: np.void) -> dict[str, object]:
    """A record as the plain Python values a ROS 2 program would set."""
    names = [n for n in record.dtype.names or () if n not in HEADER]
    stamp = {"sec": int(record["stamp_sec"]), "nanosec": int(record["stamp_nanosec"])}
    return {"header": {"stamp": stamp, "frame_id": ""}, **{n: record[n].tolist() for n in names}}


def bits(value: object) -> object:
    """Floats by their bits: NaN equals itself, 0.0 is not -0.0."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    return [bits(v) for v in value] if isinstance(value, (list, tuple)) else value


@ALL
def test_their_decoder_reads_our_bytes(message: Message) -> None:
    records = random_records(message)
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="ros2")
    schema = writer.register_schema(message.schema_name, "ros2msg", message.schema_text.encode())
    channel = writer.register_channel("topic", "cdr", schema)
    for i, record in enumerate(records):
        writer.add_message(channel, i, record.tobytes(), i)
    writer.finish()
    file.seek(0)

    decoded = [
        m.decoded_message for m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
    ]
    assert len(decoded) == COUNT
    for theirs, record in zip(decoded, records, strict=True):
        ours = values(record)
        stamp = {"sec": theirs.header.stamp.sec, "nanosec": theirs.header.stamp.nanosec}
        assert {"stamp": stamp, "frame_id": theirs.header.frame_id} == ours.pop("header")
        assert ours, "a message holds more than its stamp"
        for name, value in ours.items():
            found = getattr(theirs, name)
            assert bits(list(found) if isinstance(found, bytes) else found) == bits(value), name


@ALL
def test_their_writer_makes_our_bytes(message: Message) -> None:
    records = random_records(message)
    file = io.BytesIO()
    writer = Ros2Writer(file)
    schema = writer.register_msgdef(message.schema_name, message.schema_text)
    for i, record in enumerate(records):
        writer.write_message("topic", schema, values(record), log_time=i)
    writer.finish()
    file.seek(0)

    payloads = [m.data for _, _, m in make_reader(file).iter_messages()]
    for payload, record in zip(payloads, records, strict=True):
        assert payload.hex() == record.tobytes().hex()
        assert message.decode(payload).tobytes() == payload


@ALL
def test_layout(message: Message) -> None:
    """Stamp at 4, sequence at 20 of the bytes; every field on its own size counted from behind the header."""
    fields = message.dtype.fields or {}
    assert [fields[n][1] for n in (*HEADER, "sequence")] == [0, 4, 8, 12, 20]
    assert slice(20, 28) == SEQUENCE_BYTES
    for name, (dtype, offset, *_) in fields.items():
        assert name in ("cdr_header", "frame_id") or (offset - 4) % dtype.base.itemsize == 0
    last, offset = max((f[:2] for f in fields.values()), key=lambda f: f[1])
    assert message.dtype.itemsize == offset + last.itemsize  # CDR has no padding at the end


def test_sizes_are_what_is_on_the_wire() -> None:
    sizes = {topic: message.dtype.itemsize for topic, message in TOPICS.items()}
    vectors = {"sample": 4, "reference": 3, "feedforward": 2, "error": 4, "friction": 9}  # float64[3] in each
    for topic, count in vectors.items():
        tail = {"sample": 8 + 4 + 4, "reference": 0, "friction": 8 + 8, "feedforward": 8 + 4 + 4, "error": 4}[topic]
        assert sizes[topic] == 4 + 8 + 8 + 8 + 24 * count + tail


@ALL
@pytest.mark.parametrize("change", [-1, 1, -8, 4])
def test_a_wrong_size_names_both_sizes(message: Message, change: int) -> None:
    payload = (message.empty()[0].tobytes() + b"\0" * 8)[: message.dtype.itemsize + change]
    with pytest.raises(
        MessageError, match=f"^{message.name}: {len(payload)} bytes, expected {message.dtype.itemsize}$"
    ):
        message.decode(payload)
    with pytest.raises(MessageError, match=f"^{message.name}: 0 bytes"):
        message.decode(b"")


@ALL
@pytest.mark.parametrize("header", ["00000000", "00030000", "deadbeef"])  # big-endian, parameter list, garbage
def test_a_foreign_header_is_refused(message: Message, header: str) -> None:
    payload = bytes.fromhex(header) + message.empty()[0].tobytes()[4:]
    with pytest.raises(MessageError, match=f"CDR header {header}, expected 00010000"):
        message.decode(payload)


def test_decode_takes_what_zenoh_and_sockets_give() -> None:
    record = random_records(TOPICS["sample"])[0]
    for kind in (bytes, bytearray, memoryview):
        assert TOPICS["sample"].decode(kind(record.tobytes())).tobytes() == record.tobytes()


@pytest.mark.parametrize("time_ns", [0, 1, 999_999_999, 1_000_000_000, 1_795_000_000_123_456_789, -1, -1_500_000_000])
def test_stamps_keep_every_nanosecond(time_ns: int) -> None:
    record = TOPICS["sample"].empty()
    set_stamp(record, time_ns)
    assert stamp_ns(record)[0] == time_ns
    assert 0 <= record["stamp_nanosec"][0] < 1_000_000_000


def test_flags_fit_their_field() -> None:
    assert max(SampleFlag) < 2**32


@pytest.mark.parametrize("count", ["9" * 5000, "99999999"])
def test_a_foreign_message_of_endless_length_is_refused(count):
    with pytest.raises(MessageError, match=r"cannot read 'float64\[9+"):
        fields_of(f"float64[{count}] a")
