"""Repair of an MCAP file whose writer was killed or whose disk was full: what can be read goes to a whole file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from drivers.trace.bag import RECORD
from drivers.trace.mcap_messages import MAGIC, NOT_MCAP, unpack
from schemas.errors import StorageError
from schemas.files import most_unpacked, whole
from schemas.ros2 import BagTopic, bag_metadata


@dataclass(frozen=True)
class Recovered:
    """What was saved. counts: messages by topic. span_s: log time, first to last. whole: nothing was wrong."""

    counts: dict[str, int]
    span_s: float
    bad_chunks: int
    whole: bool


def recover(source: Path, stream: IO[bytes], target: Path) -> Recovered:
    """Copy every readable message of `stream`, which is `source` opened, to the new file `target`.

    A chunk whose checksum is wrong is left out and counted; the copy ends where the records do.

    Raises:
        StorageError: not an MCAP file, nothing to save, `target` exists or cannot be written.
    """
    if target.exists():
        raise StorageError(f"{target}: exists already; give another name")
    with whole(target) as partial:
        with partial.open("wb") as out:
            copy = _Copy(Writer(out))
            copy.all(source, stream, target.name)
        if not copy.counts:
            raise StorageError(f"{source}: not one whole message in it")
    return Recovered(dict(copy.counts), (copy.last_ns - copy.first_ns) * 1e-9, copy.bad_chunks, copy.whole)


class _Copy:
    """Writes records to a new file under the channels they had."""

    def __init__(self, writer: Writer) -> None:
        self.counts: Counter[str] = Counter()
        self.first_ns = self.last_ns = 0
        self.bad_chunks = 0
        self.whole = False
        self._ended = False
        self._room = 0  # bytes that may still be unpacked
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._types: dict[int, str] = {}
        self._channels: dict[int, tuple[int, str]] = {}
        self._topics: dict[str, BagTopic] = {}

    def all(self, source: Path, stream: IO[bytes], name: str) -> None:
        self._writer.start(profile="ros2", library="deltatwin recover")
        limit = source.stat().st_size  # a length that was garbled must not be allocated
        self._room = most_unpacked(limit)
        broken = ""
        if stream.read(len(MAGIC)) != MAGIC:
            raise StorageError(f"{source}: {NOT_MCAP}")
        stream.seek(0)
        records = StreamReader(stream, emit_chunks=True, record_size_limit=limit).records
        while not broken:
            try:
                record = next(records)
            except StopIteration:
                break
            except OSError:
                raise
            except Exception as error:  # the library lets struct and its own errors through where the file breaks off
                broken = str(error) or "the file ends in the middle of a record"
            else:
                self._record(record)
        if broken and not self.counts:
            raise StorageError(f"{source}: nothing to save: {broken}")
        self.whole = self._ended and not broken and not self.bad_chunks
        topics = [topic._replace(messages=self.counts[topic.name]) for topic in self._topics.values()]
        self._writer.add_metadata(RECORD, bag_metadata(name, topics, self.first_ns, self.last_ns))
        self._writer.finish()

    def _record(self, record: McapRecord) -> None:
        if isinstance(record, Chunk):
            try:
                data = unpack(record, self._room)
                self._room -= len(data)
                inside = breakup_chunk(replace(record, compression="", data=data))
            except Exception:  # struct, the library's own, ours: this chunk is lost, the next may be good
                self.bad_chunks += 1
                return
            for one in inside:
                self._record(one)
        elif isinstance(record, Schema) and record.id not in self._schemas:
            self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)
            self._types[record.id] = record.name
        elif isinstance(record, Channel) and record.id not in self._channels and record.schema_id in self._schemas:
            schema = self._schemas[record.schema_id]
            channel = self._writer.register_channel(record.topic, record.message_encoding, schema, record.metadata)
            self._channels[record.id] = channel, record.topic
            kind, type_hash = self._types.get(record.schema_id, ""), record.metadata.get("topic_type_hash", "")
            self._topics[record.topic] = BagTopic(record.topic, kind, type_hash, 0)
        elif isinstance(record, Message) and record.channel_id in self._channels:
            self._message(record)
        elif isinstance(record, Metadata) and record.name != RECORD:  # which counts what this file has
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Footer):
            self._ended = True

    def _message(self, message: Message) -> None:
        channel, topic = self._channels[message.channel_id]
        self._writer.add_message(channel, message.log_time, message.data, message.publish_time, message.sequence)
        self.first_ns = min(self.first_ns, message.log_time) if self.counts else message.log_time
        self.last_ns = max(self.last_ns, message.log_time)
        self.counts[topic] += 1
