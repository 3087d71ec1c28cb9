"""Fixed-size messages of an MCAP file in the order they stand there, within limits: no more memory than its size asks.

The mcap library reads the summary. Its messages come one by one as Python objects, and a chunk is unpacked to whatever
length it claims; here a thread unpacks chunks ahead, never beyond the length that was agreed to, and a kernel finds the
messages of a channel in them.

Source: the MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from schemas.errors import MessageError, StorageError, TraceError
from schemas.files import MIB, most_unpacked
from schemas.kernels import kernel

MAGIC = b"\x89MCAP0\r\n"
NOT_MCAP = "not an MCAP file: it does not start like one"
MAX_CHUNK_BYTES = 64 * MIB  # of one chunk, unpacked; writers in use make chunks of 1 to 8 MiB
MAX_SUMMARY_BYTES = 64 * MIB  # an hour of six topics in chunks of 1 MiB has 2 MB
# names that are no text and wrong checksums are a ValueError, lengths beyond all memory an OverflowError
LIBRARY_ERRORS = (McapError, ValueError, OverflowError, struct.error)
AHEAD = 3  # chunks being unpacked
_FOOTER_BYTES = 9 + 20 + len(MAGIC)
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = 22  # channel, sequence, log and publish time


class Wanted(NamedTuple):
    """A topic whose messages on the channels `ids` have `size` bytes each."""

    topic: str
    ids: Sequence[int]
    size: int


class Messages(NamedTuple):
    """N messages of one size. data: (N, size) uint8. log_time: (N,) int64 ns."""

    data: np.ndarray
    log_time: np.ndarray


def read_summary(stream: IO[bytes], path: Path) -> Summary | None:
    """Channels, schemas and statistics of the file; None where its writer did not come to write them.

    Raises:
        TraceError: not an MCAP file. StorageError: cut off, or a summary beyond `MAX_SUMMARY_BYTES`.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise TraceError(f"{path}: {NOT_MCAP}")
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(size - _FOOTER_BYTES, 0))
    footer = stream.read()
    if len(footer) != _FOOTER_BYTES or footer[0] != Opcode.FOOTER or not footer.endswith(MAGIC):
        raise StorageError(f"{path}: its end is missing")
    start = int.from_bytes(footer[9:17], "little")
    if start == 0:
        return None
    if not 0 <= size - start <= MAX_SUMMARY_BYTES:
        raise StorageError(f"{path}: a summary from byte {start} of {size}, at most {MAX_SUMMARY_BYTES} bytes are read")
    stream.seek(start)
    reader = StreamReader(io.BytesIO(stream.read()), skip_magic=True, emit_chunks=True, record_size_limit=size - start)
    summary = Summary()
    try:
        for record in reader.records:
            if isinstance(record, Channel):
                summary.channels[record.id] = record
            elif isinstance(record, Schema):
                summary.schemas[record.id] = record
            elif isinstance(record, Statistics):
                summary.statistics = record
    except LIBRARY_ERRORS as error:
        raise StorageError(f"{path}: a damaged summary: {error}") from error
    return summary


def read_messages(stream: IO[bytes], path: Path, wanted: Sequence[Wanted]) -> list[Messages]:
    """For each of `wanted` its messages as they stand in the file.

    Raises:
        StorageError: the file is damaged, or unpacks to more than its size allows.
        MessageError: a message is of another size.
    """
    found: list[list[Messages]] = [[] for _ in wanted]
    with ThreadPoolExecutor(1) as pool:
        waiting: deque[Future[list[tuple[Messages, int]]]] = deque()
        counts = [0] * len(wanted)

        def take() -> None:
            for number, (messages, wrong) in enumerate(waiting.popleft().result()):
                found[number].append(messages)
                counts[number] += len(messages.data)
                if wrong >= 0:
                    topic, _, size = wanted[number]
                    raise MessageError(
                        f"{path}: message {counts[number] + 1} on {topic} has {wrong} bytes, expected {size}"
                    )

        for block in _blocks(stream, path):
            waiting.append(pool.submit(_select, block, path, wanted))
            if len(waiting) > AHEAD:
                take()
        while waiting:
            take()
    return [
        Messages(np.concatenate([m.data for m in parts]), np.concatenate([m.log_time for m in parts]))
        if parts
        else Messages(np.empty((0, size), np.uint8), np.empty(0, np.int64))
        for parts, (*_, size) in zip(found, wanted, strict=True)
    ]


def unpack(chunk: Chunk, limit: int) -> bytes:
    """The records of a chunk.

    Raises:
        StorageError: it claims or unpacks to more than `limit`, or is damaged.
    """
    size = chunk.uncompressed_size
    if size > min(limit, MAX_CHUNK_BYTES):
        raise StorageError(f"a chunk of {size} bytes, at most {min(limit, MAX_CHUNK_BYTES)} are unpacked")
    if chunk.compression == "zstd":
        data = _unzstd(chunk.data, size)
    elif chunk.compression == "lz4":
        try:
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        except (RuntimeError, EOFError) as error:
            raise StorageError(f"a damaged chunk: {error}") from error
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise StorageError(f"a chunk packed with {chunk.compression!r}, known are zstd and lz4")
    if len(data) != size:
        raise StorageError(f"a chunk that claims {size} bytes has {'more' if len(data) > size else len(data)}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise StorageError("a chunk whose checksum is wrong")
    return data


def _unzstd(data: bytes, size: int) -> bytes:
    try:
        if size and zstandard.frame_content_size(data) == size:
            return zstandard.ZstdDecompressor().decompress(data)
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            return reader.read(size + 1)
    except zstandard.ZstdError as error:
        raise StorageError(f"a damaged chunk: {error}") from error


def read_records(stream: IO[bytes], path: Path) -> Iterator[McapRecord]:
    """All records of the data, those of chunks among them.

    Raises:
        StorageError: the file is damaged, or unpacks to more than its size allows.
    """
    for block, room in _blocks(stream, path):
        data = _unpacked(block, room, path)
        plain = Chunk(
            compression="",
            data=data,
            message_start_time=0,
            message_end_time=0,
            uncompressed_crc=0,
            uncompressed_size=len(data),
        )
        try:
            yield from breakup_chunk(plain)
        except LIBRARY_ERRORS as error:
            raise StorageError(f"{path}: a damaged chunk: {error}") from error


def _unpacked(block: Chunk | bytes, room: int, path: Path) -> bytes:
    try:
        return block if isinstance(block, bytes) else unpack(block, room)
    except StorageError as error:
        raise StorageError(f"{path}: {error}") from error


def _blocks(stream: IO[bytes], path: Path) -> Iterator[tuple[Chunk | bytes, int]]:
    """Chunks with what they may unpack to, and messages outside of chunks, up to the end of the data."""
    size = stream.seek(0, io.SEEK_END)
    room, at = most_unpacked(size), stream.seek(len(MAGIC))
    loose = bytearray()
    while head := stream.read(_RECORD.size):
        opcode, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, size)
        at += _RECORD.size
        if length > size - at:
            raise StorageError(f"{path}: cut off at byte {at}")
        if loose and (opcode != Opcode.MESSAGE or len(loose) > MIB):
            yield bytes(loose), room
            loose.clear()
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode == Opcode.CHUNK:
            try:
                chunk = Chunk.read(ReadDataStream(io.BytesIO(stream.read(length))))
            except LIBRARY_ERRORS as error:
                raise StorageError(f"{path}: a damaged chunk at byte {at}: {error}") from error
            yield chunk, room
            room -= chunk.uncompressed_size
        elif opcode == Opcode.MESSAGE:
            loose += head + stream.read(length)
        else:
            stream.seek(length, io.SEEK_CUR)
        at += length
    raise StorageError(f"{path}: the end of its data is missing")


def _select(block: tuple[Chunk | bytes, int], path: Path, wanted: Sequence[Wanted]) -> list[tuple[Messages, int]]:
    data = np.frombuffer(_unpacked(*block, path), np.uint8)
    chosen = []
    for _, ids, size in wanted:
        most = len(data) // (_RECORD.size + _MESSAGE_HEAD + size)
        messages = Messages(np.empty((most, size), np.uint8), np.empty(most, np.int64))
        count, wrong = _find(data, np.array(ids, np.int64), *messages)
        if count < 0:
            raise StorageError(f"{path}: a damaged chunk: its records do not fit into it")
        chosen.append((Messages(*(column[:count] for column in messages)), wrong))
    return chosen


@kernel(nogil=True)
def _u64(data, at):
    value = np.uint64(0)
    for byte in range(8):
        value |= np.uint64(data[at + byte]) << np.uint64(8 * byte)
    return np.int64(value)


@kernel(nogil=True)
def _find(data, ids, out, log_time):
    """Copy the messages of channels `ids` to `out`: (how many, size of one that does not fit or -1); -1, -1: damage."""
    at, end, count, size = 0, len(data), 0, out.shape[1]
    while at < end:
        if at + 9 > end:
            return -1, -1
        length = _u64(data, at + 1)
        body = at + 9
        if length < 0 or length > end - body:
            return -1, -1
        if data[at] == 5:
            if length < 22:
                return -1, -1
            channel = np.int64(data[body]) | (np.int64(data[body + 1]) << 8)
            for one in ids:
                if one == channel:
                    if length - 22 != size:
                        return count, length - 22
                    log_time[count] = _u64(data, body + 6)
                    for byte in range(size):  # assigning a slice would cost three quarters of the time to compile
                        out[count, byte] = data[body + 22 + byte]
                    count += 1
        at = body + length
    return count, -1
