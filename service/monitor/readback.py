"""A recording read back: every topic as one array of records."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from schemas.errors import StorageError
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
    data: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}
    arrival: dict[str, list[int]] = {topic: [] for topic in TOPICS}
    try:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                topic = channel.topic.rsplit("/", 1)[-1]
                data[topic].append(message.data)
                arrival[topic].append(message.log_time)
    except OSError as error:
        raise StorageError(f"{path}: {error.strerror}") from error
    except McapError as error:
        raise StorageError(f"{path}: not a whole recording ({error}); deltatwin recover {path} OUT.mcap") from error
    return {
        topic: Recorded(np.frombuffer(b"".join(data[topic]), message.dtype), np.array(arrival[topic], np.int64))
        for topic, message in TOPICS.items()
    }
