"""A recording read back: every topic as one array of records."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.trace.mcap_messages import Wanted, read_messages, read_summary
from schemas.errors import MessageError, StorageError
from schemas.files import opened
from schemas.messages import TOPICS


class Recorded(NamedTuple):
    """records: (N,) of the topic's dtype in the order written. arrival: (N,) int64 ns since 1970."""

    records: np.ndarray
    arrival: np.ndarray


def read_recording(path: Path) -> dict[str, Recorded]:
    """All of `schemas.messages.TOPICS` in a recording of the monitor; topics without messages are empty.

    Raises:
        StorageError: not a whole MCAP file.
    """
    try:
        with opened(path, StorageError) as stream:
            summary = read_summary(stream, path)
            if summary is None:
                raise StorageError(f"{path}: its end is missing")
            topics = [(c.id, c.topic.rsplit("/", 1)[-1]) for c in summary.channels.values()]
            wanted = [
                Wanted(topic, [number for number, name in topics if name == topic], message.dtype.itemsize)
                for topic, message in TOPICS.items()
            ]
            found = read_messages(stream, path, wanted)
    except OSError as error:
        raise StorageError(f"{path}: {error.strerror}") from error
    except (MessageError, StorageError) as error:
        raise StorageError(f"{path}: not a whole recording ({error}); deltatwin recover {path} OUT.mcap") from error
    return {
        topic: Recorded(data.reshape(-1).view(message.dtype), log_time)
        for (topic, message), (data, log_time) in zip(TOPICS.items(), found, strict=True)
    }
