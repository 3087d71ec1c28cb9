"""The writer thread: takes batches off a queue and puts them on disk, so that no disk ever holds up the bus."""

from __future__ import annotations

import queue
import sys
import threading
import time
from pathlib import Path

import numpy as np

from drivers.view.viewer_scene import ViewerScene
from schemas.errors import StorageError
from schemas.messages import OF_DELTA, Topics
from service.monitor.recording import RecordingWriter

FLUSH_S = 0.2  # what a kill -9 can cost, together with the node's cycle
QUEUED = 3000  # batches that wait for a stalled disk before they are dropped: a minute of the node's cycles

Batch = tuple[dict[str, tuple[np.ndarray, np.ndarray]], list[dict[str, str]]]  # topic -> (records, log_ns); gaps


class WriterThread:
    """Writes batches to `path` until `close`. When the disk refuses it says so once, and goes on without recording."""

    def __init__(self, path: Path, robot: str, scene: ViewerScene | None = None, topics: Topics = OF_DELTA) -> None:
        """Raises StorageError: the file exists, cannot be made, or the disk refuses from the start."""
        self.failed = False
        self.dropped = 0  # messages that could not wait any longer
        self._recording = RecordingWriter(path, robot, scene, topics)
        try:
            self._recording.flush()
        except StorageError:
            self._recording.abandon()
            path.unlink(missing_ok=True)
            raise
        self._queue: queue.Queue[Batch | None] = queue.Queue(QUEUED)
        self._thread = threading.Thread(target=self._run, name="writer")
        self._thread.start()

    @property
    def written(self) -> int:
        """Messages handed to the file."""
        return self._recording.written

    def put(self, batch: Batch) -> None:
        """Queue a batch; never waits."""
        try:
            self._queue.put_nowait(batch)
        except queue.Full:
            self.dropped += sum(len(records) for records, _ in batch[0].values())

    def close(self) -> None:
        """Write what is queued and end the file."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._record(self._recording)
        except StorageError as error:
            self.failed = True
            print(f"deltatwin: {error}", file=sys.stderr, flush=True)
            self._recording.abandon()
            while self._queue.get() is not None:  # the bus goes on
                pass

    def _record(self, recording: RecordingWriter) -> None:
        flush_at = time.monotonic() + FLUSH_S
        while True:
            try:
                batch = self._queue.get(timeout=max(0.0, flush_at - time.monotonic()))
            except queue.Empty:
                batch = ({}, [])
            if batch is None:
                recording.close()
                return
            for topic, (records, log_ns) in batch[0].items():
                recording.write(topic, records, log_ns)
            for gap in batch[1]:
                recording.note("sequence_gap", gap)
            if time.monotonic() >= flush_at:
                recording.flush()
                flush_at = time.monotonic() + FLUSH_S
