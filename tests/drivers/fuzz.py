"""Mutations of small files of every format that is read, and what reading one may do: give an answer, or an error of
ours, in time and in little memory.

A mutation is a function of its format and number, so that a run can be taken up anywhere and a finding be made again.
"""

from __future__ import annotations

import gzip
import io
import json
import random
import re
import resource
import signal
import sqlite3
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import scipy.io
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from drivers.ethercat.eni import read_eni
from drivers.ethercat.process_data.object_layout import make_layout
from drivers.simulated.plant.truth import load_truth
from drivers.trace import read_trace
from drivers.trace.capture_survey import survey_capture
from drivers.trace.survey import survey
from drivers.trace.tables import read_table
from schemas.axes_description import load_description
from schemas.columns import Columns, load_columns
from schemas.errors import DeltatwinError
from schemas.messages import TOPICS
from schemas.robot import load_robot, save_robot
from schemas.toml import validate
from schemas.zenoh_keys import topic_key
from service.identification.proposal import propose
from service.identification.readings import Stated
from service.identification.weighed_picks import read_truth
from service.monitor.readback import read_recording
from service.monitor.repair import recover
from tests.drivers.ethercat import wire
from tests.drivers.ethercat.test_eni import ENI, with_eni
from tests.drivers.trace.headers import codesys_trace, kuka_header
from tests.drivers.trace.test_tables import joint_state

SECONDS = 5.0  # that reading one file may take
BYTES = 1 << 30  # more memory than before that it may take

ROBOT = wire.robot()
FOREIGN = Columns.model_validate(
    {
        "separator": ";", "decimal": ",", "header_line": 2, "joints": 2, "time": {"name": "Zeit", "unit": "ms"},
        "position": {"name": "A{joint}", "unit": "counts", "counts_per_rev": 1048576, "side": "motor", "gear_ratio": 5},
        "torque": {"name": "M{joint}", "unit": "permille", "rated": 2.4, "time": "t2", "between": "hold"},
    }
)  # fmt: skip
WORDS = """nan inf -1 0 1e308 -1e308 1e-320 1e20 18446744073709551616 1_0 0x10 #x10 1970-01-01 true e + - . , ; = [ ] [[
{ } \\ # < > &amp; &x; <!DOCTYPE_a> <![CDATA[ <!-- a:b 2[ ../x time_s position_1_rad " ' \x1b[2J é€𝄞 \ufeff"""
RAW = (b"9" * 40, b"1" * 5000, b"\xff", b"\0", b"\r", b"\n", b"\r\n", b'"""', b" ")
TEXTS = [*(word.encode() for word in WORDS.split()), *RAW]
NUMBERS = (0, 1, 2, 3, 7, 8, 12, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 33, 1 << 62,
           (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
TOKEN = re.compile(rb"-?\d+(?:\.\d+)?|[A-Za-z_]+")


def _csv() -> list[bytes]:
    time = np.arange(30)
    own = "time_s," + ",".join(f"{n}_{j}_{u}" for n, u in (("position", "rad"), ("torque", "nm")) for j in (1, 2, 3))
    rows = [",".join([f"{t / 1000:.3f}", *(f"{np.sin(t / 9 + j):.6f}" for j in range(6))]) for t in time]
    epoch = [f"{1_700_000_000 + t / 1000:.9f}{row[5:]}" for t, row in zip(time, rows, strict=True)]
    linear = "time_s,position_1_m,torque_1_n,position_command_1_m\n" + "".join(f"{t},{t}e-3,{t},1\n" for t in time)
    foreign = "Scope;x\nZeit;A1;A2;t2;M1;M2\n" + "".join(f"{t},5;{t * 7};{t};{2 * t};{t},1;-3\n" for t in time)
    whole = "\n".join([own, *rows, ""]).encode()
    return [
        whole,
        "\n".join([own, *epoch, ""]).encode(),
        linear.encode(),
        foreign.encode(),
        gzip.compress(whole, mtime=0),
    ]


def _mcap() -> list[bytes]:
    made = []
    for kind, crcs, chunking in (
        (CompressionType.NONE, False, True), (CompressionType.ZSTD, True, True), (CompressionType.LZ4, False, True),
        (CompressionType.NONE, False, False),
    ):  # fmt: skip
        stream = io.BytesIO()
        writer = Writer(
            stream, compression=kind, enable_crcs=crcs, use_chunking=chunking, chunk_size=2000, enable_data_crcs=crcs
        )
        writer.start(profile="ros2", library="fuzz")
        for topic in ("sample", "payload", "health"):
            message = TOPICS[topic]
            schema = writer.register_schema(message.schema_name, "ros2msg", message.schema_text.encode())
            channel = writer.register_channel(topic_key("wired", topic), "cdr", schema)
            records = message.empty(12)
            records["sequence"] = np.arange(12)
            records["stamp_nanosec"] = np.arange(12) * 1_000_000
            for number, record in enumerate(records):
                writer.add_message(channel, number, record.tobytes(), number, number)
        writer.finish()
        made.append(stream.getvalue())
    return made


def _captures(folder: Path) -> tuple[list[bytes], list[bytes]]:
    drives = [wire.cycle(n) for n in range(6)]
    frames = []
    for number in range(1, 6):
        clock = (number * 1_000_000).to_bytes(8, "little")
        sent, back = wire.passes(drives[number], drives[number - 1], index=number, clock=clock)
        frames += [(number * 1_000_000, sent), (number * 1_000_000 + 20_000, back)]
    pcaps = [
        wire.pcap(folder / "a", frames).read_bytes(),
        wire.pcap(folder / "a", frames, order=">", nanoseconds=True).read_bytes(),
        wire.pcap(folder / "a", [(t, wire.netanalyzer(f)) for t, f in frames], link_type=240).read_bytes(),
    ]
    packets = [(n % 2, t // 1000, f) for n, (t, f) in enumerate(frames)]
    pcapngs = [
        wire.pcapng(folder / "a", packets, [(1, b""), (1, b"\x09")]).read_bytes(),
        wire.pcapng(folder / "a", packets, [(1, b"\x94"), (1, b"")], order=">").read_bytes(),
    ]
    return pcaps, pcapngs


def _toml() -> list[bytes]:
    here = Path(__file__).parents[2]
    files = [
        *sorted(here.glob("schemas/robots/*.toml")), *sorted(here.glob("drivers/simulated/plant/truths/*.toml")),
        *sorted(here.glob("drivers/trace/mappings/*.toml")), *sorted(here.glob("tests/drivers/ethercat/robots/*.toml")),
        here / "replay/demo/robot.toml",
    ]  # fmt: skip
    axes = b'name = "a"\nkind = "axes"\ncolumns = "emps"\n[[axis]]\nunit = "m"\n'
    joints = b"value = [1.0, 2.0, 3.0], std_error = [0.1, 0.1, 0.1]"
    identified = files[0].read_bytes() + b"\n[identified]\nrho_1 = {value = 1.1}\ntorque_noise_nm = {" + joints + b"}\n"
    effect = b'[[effect]]\nname = "backlash"\njoints = [1]\nparameters = {gap = {value = 0.1, unit = "rad"}}\n'
    return [path.read_bytes() for path in files] + [axes, identified + effect]


NAMES = ["t", "q1", "q2", "q3", "m1", "m2", "m3"]
TABLE = Columns.model_validate({"time": "t", "position": "q{joint}", "torque": "m{joint}"})
TIME = np.arange(20) / 500
BLOCK = np.column_stack([TIME, *(np.sin(40 * TIME + k) for k in range(6))])


def _saved(save: Callable[..., object], *arguments: object, **named: object) -> bytes:
    stream = io.BytesIO()
    save(stream, *arguments, **named)
    return stream.getvalue()


def _texts() -> list[bytes]:
    """Foreign tables: marks between thousands, day and time of day, two topics on one clock, units, TwinCAT's."""
    head, half = ";".join(NAMES), len(NAMES) // 2
    marked = [";".join(f"{1e6 * v:,.3f}".translate(str.maketrans(",.", ".,")) for v in row) for row in BLOCK]
    dated = [f"2026-11-26,23:59:59.{999 * k % 1000:03},{','.join(map(str, row[1:]))}" for k, row in enumerate(BLOCK)]
    apart = [
        ",".join([f"{row[0] + late:.4f}", *("" if (k < half) == late else f"{v:.6f}" for k, v in enumerate(row[1:]))])
        for row in BLOCK
        for late in (0, 1e-3)
    ]
    scope = "Name\tScope\nFile\tx\n\nName\t" + "\t".join(NAMES[1:]) + "\nSampleTime[ms]\t2\n\n"
    made = [
        "\n".join([head, "s;rad;rad;rad;Nm;Nm;Nm", *marked]),
        "\n".join(["Date,Time," + ",".join(NAMES[1:]), *dated]),
        "\n".join([",".join(NAMES), *apart]),
        scope + "\n".join("\t".join(f"{v:.6f}" for v in row) for row in BLOCK) + "\nEOF\n",
    ]
    return [text.encode() for text in made]


def _ros1(folder: Path) -> list[bytes]:
    made = []
    for number, chunk in enumerate((None, 700)):
        path = folder / f"{number}.bag"
        writer = Ros1Writer(path)
        if chunk:
            writer.set_compression(Ros1Writer.CompressionFormat.LZ4)
            writer.chunk_threshold = chunk
        with writer as bag:
            store = get_typestore(Stores.ROS1_NOETIC)
            kind = "sensor_msgs/msg/JointState"
            connection = bag.add_connection("/joint_states", kind, typestore=store)
            state, header = store.types[kind], store.types["std_msgs/msg/Header"]
            stamp = store.types["builtin_interfaces/msg/Time"]
            for k, row in enumerate(BLOCK):
                at = header(seq=k, stamp=stamp(sec=0, nanosec=round(row[0] * 1e9)), frame_id="base")
                message = state(header=at, name=NAMES[1:4], position=row[1:4], velocity=row[:0], effort=row[4:7])
                bag.write(connection, k, store.serialize_ros1(message, kind))
        made.append(path.read_bytes())
    return made


def _npz() -> list[bytes]:
    named = dict(zip(NAMES, BLOCK.T, strict=True))
    return [
        _saved(np.savez, **named),
        _saved(np.savez_compressed, **named, rate=500.0),
        _saved(np.savez, t=TIME, log=BLOCK),
    ]


def _mat() -> list[bytes]:
    named = dict(zip(NAMES, BLOCK.T, strict=True))
    date = b"MATLAB 5.0 MAT-file".ljust(116)  # stands where the date of saving does
    return [
        date + _saved(scipy.io.savemat, named)[116:],
        date + _saved(scipy.io.savemat, {"log": named, "note": "text"}, do_compression=True)[116:],
        date + _saved(scipy.io.savemat, {"log": named})[116:],
        _saved(scipy.io.savemat, named, format="4"),
    ]


def _json() -> list[bytes]:
    records = [dict(zip(NAMES, row, strict=True)) | {"on": True} for row in BLOCK.tolist()]
    lists = {name: BLOCK[:, k].tolist() for k, name in enumerate(NAMES)}
    return [json.dumps(one).encode() for one in (records, {"robot": "d3", "entries": records}, lists)] + [
        "\n".join(map(json.dumps, records)).encode()
    ]


def _kuka() -> list[bytes]:
    """Headers; `case.r64` beside them holds the numbers."""
    return [kuka_header(NAMES[1:], "t", "case.r64", 20).encode("latin-1")]


def _codesys() -> tuple[list[bytes], list[bytes]]:
    signals = {f"PLC.{name}": BLOCK[:, k].tolist() for k, name in enumerate(NAMES[1:], 1)}
    lines, xml = codesys_trace(signals, TIME)
    return [lines.encode()], [xml.encode(), xml.encode("utf-16")]


def _db3(folder: Path) -> list[bytes]:
    bag = sqlite3.connect(folder / "bag.db3")
    bag.execute("PRAGMA page_size = 512")
    bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
    bag.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    bag.execute("INSERT INTO topics VALUES (2, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')")
    for k, row in enumerate(BLOCK):
        bag.execute("INSERT INTO messages VALUES (?, 2, ?, ?)", (k, k, joint_state(row)))
    bag.commit()
    bag.close()
    return [(folder / "bag.db3").read_bytes()]


def _bag() -> list[bytes]:
    made = []
    for kind in (CompressionType.NONE, CompressionType.ZSTD):
        stream = io.BytesIO()
        writer = Writer(stream, compression=kind, chunk_size=1000)
        writer.start(profile="ros2", library="fuzz")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for k, row in enumerate(BLOCK):
            writer.add_message(channel, k, joint_state(row), k)
        writer.finish()
        made.append(stream.getvalue())
    return made


def _foxglove() -> list[bytes]:
    """Joint states in JSON and in protobuf, each message plain in the file so that mutations reach it."""
    made = []
    for encoding in ("json", "protobuf"):
        stream = io.BytesIO()
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/js", encoding, writer.register_schema("foxglove.JointStates", "", b""))
        for k, row in enumerate(BLOCK):
            writer.add_message(channel, k, _state(row, encoding), k)
        writer.finish()
        made.append(stream.getvalue())
    return made


def _state(row: np.ndarray, encoding: str) -> bytes:
    joints = list(zip(NAMES[1:4], row[1:4].tolist(), row[4:7].tolist(), strict=True))
    if encoding == "json":
        states = [{"name": name, "position": at, "effort": pushes} for name, at, pushes in joints]
        stamp = {"sec": 1, "nsec": round(row[0] * 1e9)}
        return json.dumps({"timestamp": stamp, "joints": states}).encode()
    inner = [
        b"\x0a\x02" + name.encode() + struct.pack("<Bd", 0x11, at) + struct.pack("<Bd", 0x29, pushes)
        for name, at, pushes in joints
    ]
    return b"\x0a\x02\x08\x01" + b"".join(b"\x12" + bytes([len(one)]) + one for one in inner)


@cache
def corpus() -> dict[str, list[bytes]]:
    """Small whole files by format."""
    with tempfile.TemporaryDirectory() as folder:
        pcaps, pcapngs = _captures(Path(folder))
        db3 = _db3(Path(folder))
        ros1 = _ros1(Path(folder))
    codesys_text, codesys_xml = _codesys()
    return {
        "csv": _csv(),
        "mcap": _mcap(),
        "pcap": pcaps,
        "pcapng": pcapngs,
        "eni": [ENI.encode(), f'<?xml version="1.0" encoding="utf-8"?>{ENI}'.encode()],
        "toml": _toml(),
        "npy": [_saved(np.save, BLOCK), _saved(np.save, BLOCK.T.astype(">f4"))],
        "npz": _npz(),
        "mat": _mat(),
        "json": _json(),
        "kuka": _kuka(),
        "codesys": codesys_text,
        "trace": codesys_xml,
        "db3": db3,
        "bag": _bag(),
        "foxglove": _foxglove(),
        "text": _texts(),
        "ros1": ros1,
        "packed": [zstandard.compress(db3[0])],
    }


def mutated(kind: str, number: int) -> bytes:
    """Mutation `number` of the corpus of `kind`."""
    draw = random.Random(f"{kind} {number}")
    seeds = corpus()[kind]
    data = bytearray(draw.choice(seeds))
    for _ in range(draw.choice((1, 1, 2, 4, 16))):
        draw.choice(_EDITS)(draw, data, seeds)
    if data[:2] != b"\x1f\x8b" and kind == "csv" and draw.random() < 0.02:
        return gzip.compress(bytes(data), 1, mtime=0)
    return bytes(data)


def _flip(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    if data:
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def _cut(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    at = draw.randrange(len(data) + 1)
    del data[at : at + draw.choice((1, 2, 4, 9, 100, len(data)))]


def _insert(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    at = draw.randrange(len(data) + 1)
    data[at:at] = draw.choice(TEXTS) * draw.choice((1, 1, 1, 2, 30))


def _repeat(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    at = draw.randrange(len(data) + 1)
    to = draw.randrange(len(data) + 1)
    data[to:to] = bytes(data[at : at + draw.choice((1, 8, 64, 512))]) * draw.choice((1, 2, 20))


def _integer(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    size = draw.choice((1, 2, 4, 8))
    at = draw.randrange(max(1, len(data) - size + 1))
    if draw.random() < 0.7:
        at -= at % size
    value = draw.choice(NUMBERS) % (1 << 8 * size)
    data[at : at + size] = value.to_bytes(size, draw.choice(("little", "big")))


def _splice(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    other = draw.choice(seeds)
    data[draw.randrange(len(data) + 1) :] = other[draw.randrange(len(other)) :]


def _token(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    found = [match.span() for match in TOKEN.finditer(data, draw.randrange(len(data) + 1), len(data))][:20]
    if found:
        begin, end = draw.choice(found)
        data[begin:end] = draw.choice(TEXTS)


def _noise(draw: random.Random, data: bytearray, seeds: list[bytes]) -> None:
    at = draw.randrange(len(data) + 1)
    data[at : at + 8] = draw.randbytes(8)


_EDITS: tuple[Callable[[random.Random, bytearray, list[bytes]], None], ...] = (
    _flip, _cut, _insert, _repeat, _integer, _integer, _splice, _token, _token, _noise,
)  # fmt: skip


def _read_csv(path: Path) -> None:
    _each(
        lambda: survey(read_trace(path)),
        lambda: read_trace(path, ROBOT, FOREIGN),
        lambda: read_truth(path),
    )


def _read_mcap(path: Path) -> None:
    def repair() -> None:
        target = path.with_name("repaired.mcap")
        target.unlink(missing_ok=True)
        with path.open("rb") as stream:
            recover(path, stream, target)

    _each(lambda: survey(read_trace(path)), lambda: read_recording(path), repair)


def _read_capture(path: Path) -> None:
    _each(lambda: read_trace(path, ROBOT), lambda: survey_capture(path, ROBOT))


def _read_eni(path: Path) -> None:
    _each(lambda: read_eni(path), lambda: make_layout(with_eni(path.parent, path.read_bytes())))


def _read_toml(path: Path) -> None:
    def again() -> None:
        save_robot(load_robot(path), path.with_name("again.toml"), template=path)
        load_robot(path.with_name("again.toml"))

    plain = load_robot("d3-1200")
    _each(
        lambda: load_description(path), lambda: load_columns(path), lambda: load_truth(path, plain), again
    )  # fmt: skip


def _read_table(path: Path) -> None:
    _each(lambda: read_table(path), lambda: read_trace(path, ROBOT, TABLE))


def _read_text(path: Path) -> None:
    """As it is found, and as `import` would have it read again."""

    def again() -> None:
        table = read_table(path)
        proposal = propose(table, None, Stated(rate_hz=500.0))
        read_trace(path, None, validate(Columns, dict(proposal.columns), path, DeltatwinError))

    _each(lambda: read_table(path), again)


def _read_kuka(path: Path) -> None:
    BLOCK[:, 1:].astype("<f8").tofile(path.with_name("case.r64"))
    _read_table(path)


def _each(*readers: Callable[[], object]) -> None:
    for reader in readers:
        try:
            reader()
        except DeltatwinError as error:
            line = str(error)
            assert line.isprintable(), f"control characters in the error {line!r}"


ENDINGS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "csv": (".csv", _read_csv),
    "mcap": (".mcap", _read_mcap),
    "pcap": (".pcap", _read_capture),
    "pcapng": (".pcapng", _read_capture),
    "eni": (".xml", _read_eni),
    "toml": (".toml", _read_toml),
    "npy": (".npy", _read_table),
    "npz": (".npz", _read_table),
    "mat": (".mat", _read_table),
    "json": (".json", _read_table),
    "kuka": (".dat", _read_kuka),
    "codesys": (".csv", _read_table),
    "trace": (".trace", _read_table),
    "db3": (".db3", _read_table),
    "bag": (".mcap", _read_table),
    "foxglove": (".mcap", _read_table),
    "text": (".txt", _read_text),
    "ros1": (".bag", _read_table),
    "packed": (".db3.zstd", _read_table),
}


class TooSlow(Exception):
    """Reading took longer than `SECONDS`."""


@contextmanager
def in_time() -> Iterator[None]:
    """
    Raises:
        TooSlow: what is within took more than `SECONDS` of this process's own time.
    """

    def late(*_: object) -> None:
        raise TooSlow(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def warm_up(folder: Path) -> None:
    """Read the corpus as it is: it must go well, and compiles what is compiled."""
    for kind, files in corpus().items():
        ending, read = ENDINGS[kind]
        for data in files:
            (folder / f"case{ending}").write_bytes(data)
            read(folder / f"case{ending}")


def finding(kind: str, data: bytes, folder: Path) -> str:
    """What reading `data` did that it must not; "" if nothing."""
    ending, read = ENDINGS[kind]
    path = folder / f"case{ending}"
    path.write_bytes(data)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                with in_time():
                    read(path)
            except TooSlow:  # once: a kernel may have been compiled
                with in_time():
                    read(path)
    except BaseException as error:  # what a panic in a library raises is no Exception
        if isinstance(error, KeyboardInterrupt):
            raise
        import traceback

        frames = traceback.extract_tb(error.__traceback__)
        ours = (f for f in reversed(frames) if "/tests/" not in f.filename and "site-packages" not in f.filename)
        where = next(ours, frames[-1])
        return f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {str(error)[:200]}"
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) << 10
    return f"{grown >> 20} MiB of memory" if grown > BYTES else ""
