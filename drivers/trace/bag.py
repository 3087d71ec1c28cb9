"""An MCAP file of our messages being written as ROS 2 records them: `ros2 bag info` and `ros2 bag play` take it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
from mcap.writer import CompressionType, Writer

from schemas.files import name_of
from schemas.ros2 import BagTopic, RosType, bag_metadata

RECORD = "rosbag2"  # the name of the MCAP metadata record in which rosbag2 keeps its own


class BagWriter:
    """Writes the topics `types` to `stream`, the file `path` opened. Raises OSError where the disk refuses."""

    def __init__(self, stream: IO[bytes], path: Path, types: Mapping[str, RosType]) -> None:
        self._path, self._types, self._counts = path, dict(types), Counter[str]()
        self._span: tuple[int, int] | None = None  # ns, first and last log time
        self._writer = Writer(stream, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="deltatwin")
        self._channels = {}
        for topic, kind in self._types.items():
            schema = self._writer.register_schema(kind.name, "ros2msg", kind.text.encode())
            facts = {"offered_qos_profiles": "", "topic_type_hash": kind.type_hash}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema, facts)

    def add(self, topic: str, records: np.ndarray, log_ns: np.ndarray, publish_ns: np.ndarray) -> None:
        """Append (N,) records of `topic` at (N,) log and publish times, ns from zero on."""
        if not len(records):
            return
        channel, size, data = self._channels[topic], records.itemsize, records.tobytes()
        times = zip(log_ns.tolist(), publish_ns.tolist(), strict=True)
        sequences = records["sequence"].astype(np.uint32).tolist()
        for i, (log, stamp) in enumerate(times):
            self._writer.add_message(channel, log, data[i * size : (i + 1) * size], stamp, sequences[i])
        self._count(topic, len(records), int(log_ns.min()), int(log_ns.max()))

    def add_message(self, topic: str, data: bytes, log_ns: int, publish_ns: int) -> None:
        """Append one message of `topic`."""
        self._writer.add_message(self._channels[topic], log_ns, data, publish_ns)
        self._count(topic, 1, log_ns, log_ns)

    def note(self, name: str, facts: dict[str, str]) -> None:
        """Append an MCAP metadata record."""
        self._writer.add_metadata(name, facts)

    def flush(self) -> None:
        """Hand everything so far to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the end of the file."""
        first, last = self._span or (0, 0)
        topics = [BagTopic(name, kind.name, kind.type_hash, self._counts[name]) for name, kind in self._types.items()]
        self._writer.add_metadata(RECORD, bag_metadata(name_of(self._path), topics, first, last))
        self._writer.finish()

    def _count(self, topic: str, number: int, first: int, last: int) -> None:
        self._counts[topic] += number
        self._span = (min(first, self._span[0]), max(last, self._span[1])) if self._span else (first, last)
