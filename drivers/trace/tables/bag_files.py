"""Files of a recorded bag, in their order, and the messages of one topic in each: rosbag2 in SQLite or MCAP, packed or
not, and ROS 1.

A bag comes from anybody: limits stand before what they limit. A database is read only, from tables only, without a
function or a view, within seconds by its size; what unpacks to more than its size allows ends there.
"""

from __future__ import annotations

import bz2
import re
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import zstandard
from mcap.records import Message

from drivers.trace.mcap_messages import MAX_CHUNK_BYTES, read_records, read_summary
from schemas.errors import StorageError, TraceError
from schemas.files import MIB, most_unpacked, opened, read_bytes
from schemas.messages import SAMPLE

METADATA = "metadata.yaml"  # of a rosbag2, in its folder
ENDINGS = (".db3", ".mcap", ".bag", ".db3.zstd", ".mcap.zstd")
LEAST_SECONDS, BYTES_PER_SECOND = 2.0, 2 * MIB  # that reading a database may take; a slow disk gives ten times as much
ENCODINGS = {"ros": ("cdr", "ros1", "json"), "foxglove": ("protobuf", "json")}  # of joint states in MCAP
STEPS = 10_000  # of SQLite's machine between two looks at the clock: some tenths of a millisecond


class Stored(NamedTuple):
    """One message as it was recorded. log_ns: when the recorder had it. encoding: one of `ENCODINGS`."""

    log_ns: int
    data: bytes
    encoding: str


Choose = Callable[[dict[str, str], Path], str]  # the topic, of types by topic


def parts_of(bag: Path) -> list[Path]:
    """The files of a bag: its folder, the metadata.yaml in it, or one file. In the order of its metadata.yaml; without
    one by the numbers in their names.

    Raises:
        TraceError: there are none, or one that the metadata lists is missing.
    """
    if bag.name == METADATA:
        bag = bag.parent
    if not bag.is_dir():
        return [bag]
    if (bag / METADATA).exists():
        listed = [bag / Path(name.replace("\\", "/")).name for name in _listed(bag / METADATA)]
        if missing := [path.name for path in listed if not path.exists()]:
            raise TraceError(f"{bag / METADATA}: lists {', '.join(missing)}, which is not next to it")
        if listed:
            return listed
    parts = sorted((path for path in bag.iterdir() if path.name.endswith(ENDINGS)), key=_numbered)
    if not parts:
        raise TraceError(f"{bag}: a folder without .db3, .mcap or .bag is not a rosbag: give the logs in it")
    return parts


def _numbered(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _listed(path: Path) -> list[str]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    raw = read_bytes(path, MIB, TraceError)
    try:
        facts = YAML(typ="safe").load(raw.decode("utf-8"))["rosbag2_bagfile_information"]
        return [str(name) for name in facts.get("relative_file_paths") or []]
    except (YAMLError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        what = str(error).splitlines()[0] if str(error) else ""
        raise TraceError(f"{path}: not the metadata of a rosbag2: {type(error).__name__} {what}") from error


def messages_of(path: Path, choose: Choose) -> list[Stored]:
    """The messages of one topic in a file of a bag, as they stand there.

    Raises:
        TraceError: the file cannot be read, is damaged, or unpacks to more than its size allows.
    """
    with _unpacked(path) as (plain, ending):
        if ending == ".mcap":
            return _from_mcap(plain, path, choose)
        return _from_ros1(plain, path, choose) if ending == ".bag" else _from_sqlite(plain, path, choose)


@contextmanager
def _unpacked(path: Path) -> Iterator[tuple[Path, str]]:
    """The file without its compression, for as long as it is read, and what kind it is."""
    if path.suffix != ".zstd":
        yield path, path.suffix.lower()
        return
    with opened(path, TraceError) as packed, tempfile.TemporaryDirectory(prefix="deltatwin-") as folder:
        plain = Path(folder) / path.stem
        room = most_unpacked(path.stat().st_size)
        try:
            with plain.open("wb") as out, zstandard.ZstdDecompressor().stream_reader(packed) as reader:
                while block := reader.read(MIB):
                    room -= len(block)
                    if room < 0:
                        raise TraceError(f"{path}: unpacks to more than {most_unpacked(path.stat().st_size)} bytes")
                    out.write(block)
        except zstandard.ZstdError as error:
            raise TraceError(f"{path}: damaged compression: {error}") from error
        yield plain, plain.suffix.lower()


def _allowed(action: int, first: str | None, second: str | None, database: str | None, inner: str | None) -> int:
    """SQLite's question before each thing a query would do: reading columns of tables, counted once, is all."""
    del second, database
    reads = action in (sqlite3.SQLITE_READ, sqlite3.SQLITE_SELECT) and inner is None
    named = first in (None, "", "topics", "messages", "sqlite_master", "sqlite_schema")
    return sqlite3.SQLITE_OK if reads and named else sqlite3.SQLITE_DENY


class _Clock:
    """Asked every `STEPS`: ends a query whose time is over, or when the process is to stop."""

    def __init__(self, seconds: float) -> None:
        self.stop: BaseException | None = None
        self._end = time.monotonic() + seconds

    def __call__(self) -> int:
        try:
            return int(time.monotonic() > self._end)
        except BaseException as stop:  # Ctrl-C is heard in here, and SQLite would swallow it
            self.stop = stop
            return 1


def _from_sqlite(plain: Path, path: Path, choose: Choose) -> list[Stored]:
    opened(plain, TraceError).close()
    size = plain.stat().st_size
    seconds = LEAST_SECONDS + size / BYTES_PER_SECOND
    clock = _Clock(seconds)
    bag: sqlite3.Connection | None = None
    try:
        bag = sqlite3.connect(f"{plain.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(MIB, min(size, 1 << 30)))
        bag.set_progress_handler(clock, STEPS)
        bag.set_authorizer(_allowed)
        return _rows(bag, size, path, choose)
    except (sqlite3.Error, ValueError, TypeError, OverflowError, MemoryError) as error:
        if clock.stop is not None:
            raise clock.stop from None
        over = f"it would take more than {seconds:.3g} s" if "interrupted" in str(error) else str(error)
        if isinstance(error, MemoryError):  # SQLite's answer to a damaged length
            over = "a row of it says that it is longer than memory"
        raise TraceError(f"{path}: not a rosbag2 database: {over}") from error
    finally:
        if bag is not None:
            bag.close()


def _rows(bag: sqlite3.Connection, size: int, path: Path, choose: Choose) -> list[Stored]:
    kinds = bag.execute("SELECT name, type, sql FROM sqlite_master WHERE name IN ('topics', 'messages')").fetchmany(3)
    plain = {name for name, kind, sql in kinds if kind == "table" and str(sql).split()[1:2] != ["VIRTUAL"]}
    if plain != {"topics", "messages"}:
        told = ", ".join(f"{name} is a {kind}" for name, kind, _ in kinds) or "none of them is there"
        raise ValueError(f"topics and messages should be two tables: {told}")
    topics = bag.execute("SELECT id, name, type FROM topics").fetchmany(10_000)
    topic = choose({name: kind for _, name, kind in topics}, path)
    (number,) = (number for number, name, _ in topics if name == topic)
    found: list[Stored] = []
    room = size
    for stamp, data in bag.execute("SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY id", (number,)):
        found.append(Stored(int(stamp), bytes(data), "cdr"))
        room -= len(data)
        if room < 0:
            raise ValueError(f"its messages have more bytes than the file, {size}")
    return found


def _from_mcap(plain: Path, path: Path, choose: Choose) -> list[Stored]:
    remedy = f"deltatwin recover {path.name} {path.stem}-whole.mcap"
    try:
        with opened(plain, TraceError) as stream:
            summary = read_summary(stream, path)
            if summary is None:
                raise TraceError(f"{path}: the MCAP summary is missing (its writer was killed?): {remedy}")
            kinds = {
                channel.topic: summary.schemas[channel.schema_id].name
                for channel in summary.channels.values()
                if channel.schema_id in summary.schemas
            }
            if SAMPLE.schema_name in kinds.values():  # its joint states are for viewers, a few of many samples
                raise TraceError(f"{path}: a log of deltatwin already; every command reads it as it is")
            topic = choose(kinds, path)
            channels = {c.id: c.message_encoding for c in summary.channels.values() if c.topic == topic}
            read = ENCODINGS["foxglove" if kinds[topic].startswith("foxglove") else "ros"]
            if unread := set(channels.values()) - {*read}:
                raise TraceError(f"{path}: {topic} is in {', '.join(sorted(unread))}; {', '.join(read)} are read")
            stream.seek(0)
            return [
                Stored(record.log_time, record.data, channels[record.channel_id])
                for record in read_records(stream, path)
                if isinstance(record, Message) and record.channel_id in channels
            ]
    except StorageError as error:
        raise TraceError(f"{error}; a recording that was cut off: {remedy}") from error


def _from_ros1(plain: Path, path: Path, choose: Choose) -> list[Stored]:
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import Chunk

    opened(plain, TraceError).close()
    room = most_unpacked(plain.stat().st_size)

    def limited(unpack: Callable[[bytes, int], bytes]) -> Callable[[bytes], bytes]:
        def within(data: bytes) -> bytes:
            nonlocal room
            found = unpack(data, min(room, MAX_CHUNK_BYTES) + 1)
            room -= len(found)
            if room < 0 or len(found) > MAX_CHUNK_BYTES:
                raise TraceError(f"{path}: unpacks to more than its size allows")
            return found

        return within

    try:
        with Reader(plain) as bag:
            bag.chunks = {
                at: Chunk(chunk.datasize, chunk.datapos, limited(_unpacker(chunk.decompressor)))
                for at, chunk in bag.chunks.items()
            }
            topic = choose({c.topic: c.msgtype for c in bag.connections}, path)
            chosen = [c for c in bag.connections if c.topic == topic]
            found: list[Stored] = []
            taken = 0
            for _, stamp, data in bag.messages(chosen):
                found.append(Stored(stamp, data, "ros1"))
                taken += len(data)
                if taken > most_unpacked(plain.stat().st_size):
                    raise TraceError(f"{path}: its messages have more bytes than its size allows")
            return found
    except TraceError:
        raise
    except Exception as error:  # the library raises whatever comes of damaged bytes, an AssertionError too
        raise TraceError(f"{path}: not a whole ROS 1 bag (rosbag reindex?): {type(error).__name__} {error}") from error


def _unpacker(known: Any) -> Callable[[bytes, int], bytes]:
    """The library's way to unpack a chunk, to a length at most."""
    from rosbags.rosbag1.reader import decompressors

    kind = next(name for name, unpack in decompressors.items() if unpack is known)
    if kind == "bz2":
        return lambda data, most: bz2.BZ2Decompressor().decompress(data, most)
    if kind == "lz4":
        return lambda data, most: lz4.frame.LZ4FrameDecompressor().decompress(data, most)
    return lambda data, most: data
