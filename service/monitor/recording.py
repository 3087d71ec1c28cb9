"""One MCAP file being written: CDR messages as they came, readable by anything that reads ROS 2 logs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from drivers.trace.bag import BagWriter
from drivers.view.viewer_scene import ViewerScene
from schemas.errors import StorageError
from schemas.messages import OF_DELTA, SAMPLES, Topics, stamp_ns, topics_of
from schemas.ros2 import ros_type
from schemas.zenoh_keys import topic_name

WAITING = 600  # batches of health, ten minutes at one a second
DRAW_NS = 50_000_000  # between two states of the robot for viewers
SHAPE_NS = 10_000_000_000  # between two of its shapes, for who begins to look in the middle


class RecordingWriter:
    """An MCAP file with a channel for every topic of `robot`. Log time is sending, publish time bus time: of the
    samples' clock on every topic, so health, which is stamped in wall time, is put beside the sample sent before it.
    Health from before the first sample waits for that, `WAITING` messages at most.

    What `flush` has returned from survives the death of the process; a file without its end is repaired by `recover`.
    """

    def __init__(self, path: Path, robot: str, scene: ViewerScene | None = None, topics: Topics = OF_DELTA) -> None:
        """scene: of the robot, drawn every `DRAW_NS`. topics: of the kind of machine.

        Raises:
            StorageError: the file exists or cannot be made.
        """
        self.path = path
        self.written = 0
        self._bus_less_sending: int | None = None  # ns, of the newest sample
        self._waiting: list[tuple[np.ndarray, np.ndarray]] = []  # health from before the first sample
        try:
            self._stream = path.open("xb")
        except OSError as error:
            raise StorageError(f"{path}: cannot record: {error.strerror}") from error
        self._names = {topic: topic_name(robot, topic) for topic in topics_of(topics)}
        self._scene, self._draw_at, self._shape_at = scene, 0, 0  # ns, log time
        types = {self._names[topic]: ros_type(message) for topic, message in topics_of(topics).items()}
        self._bag = BagWriter(self._stream, path, types | (scene.topics if scene else {}))

    def write(self, topic: str, records: np.ndarray, log_ns: np.ndarray) -> None:
        """Append (N,) records that were sent at (N,) `log_ns`, ns since 1970.

        Raises:
            StorageError: the disk refuses.
        """
        stamps = stamp_ns(records)
        if topic in SAMPLES and len(records):
            self._bus_less_sending = int(stamps[-1]) - int(log_ns[-1])
            self._write_waiting()
        elif topic == "health":
            if self._bus_less_sending is None:
                self._waiting.append((records, log_ns))
                if len(self._waiting) > WAITING:
                    self._write_waiting()
                return
            stamps = log_ns + self._bus_less_sending
        self._append(topic, records, log_ns, stamps)

    def _write_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        shift = self._bus_less_sending
        for records, log_ns in waiting:
            self._append("health", records, log_ns, stamp_ns(records) if shift is None else log_ns + shift)

    def _append(self, topic: str, records: np.ndarray, log_ns: np.ndarray, publish_ns: np.ndarray) -> None:
        with self._disk():
            self._bag.add(self._names[topic], records, log_ns, np.maximum(publish_ns, 0))
            if self._scene and topic == "sample" and len(records) and log_ns[-1] >= self._draw_at:
                self._draw(self._scene, records[-1], int(log_ns[-1]), max(int(publish_ns[-1]), 0))
        self.written += len(records)

    def _draw(self, scene: ViewerScene, sample: np.void, log_ns: int, publish_ns: int) -> None:
        if log_ns >= self._shape_at:
            self._shape_at = log_ns + SHAPE_NS
            self._bag.add_message(*scene.shapes(), log_ns, publish_ns)
        self._draw_at = log_ns + DRAW_NS
        for topic, data in scene.state(sample):
            self._bag.add_message(topic, data, log_ns, publish_ns)

    def note(self, name: str, facts: dict[str, str]) -> None:
        """Append an MCAP metadata record.

        Raises:
            StorageError: the disk refuses.
        """
        with self._disk():
            self._bag.note(name, facts)

    def flush(self) -> None:
        """Hand everything so far to the operating system.

        Raises:
            StorageError: the disk refuses.
        """
        with self._disk():
            self._bag.flush()

    def close(self) -> None:
        """Write the end of the file and close it.

        Raises:
            StorageError: the disk refuses.
        """
        self._write_waiting()
        with self._disk():
            self._bag.finish()
            self._stream.close()

    def abandon(self) -> None:
        """Close after the disk refused: what was flushed stays, without an end."""
        with suppress(OSError):  # it tries once more to write what the disk refused, and closes all the same
            self._stream.close()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            how = f"to save the data on disk: deltatwin recover {self.path} OUT.mcap"
            raise StorageError(f"{self.path}: recording stopped: {error.strerror}; {how}") from error
