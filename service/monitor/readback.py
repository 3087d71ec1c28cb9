"""A recording read back: every topic as one array of records."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.summary import Summary

from drivers.trace.mcap_messages import Wanted, read_messages, read_summary
from schemas.errors import MessageError, StorageError, TraceError
from schemas.files import opened
from schemas.messages import OPTIONAL, TOPICS, Message, dtype_of


class Recorded(NamedTuple):
    """records: (N,) of the topic's dtype in the order written. arrival: (N,) int64 ns since 1970."""

    records: np.ndarray
    arrival: np.ndarray


def read_recording(path: Path) -> dict[str, Recorded]:
    """All of `schemas.messages.TOPICS` in a recording of the monitor; topics without messages are empty.

    `OPTIONAL` fields that the recording's own schema lacks, because an earlier version wrote it, are NaN.

    Raises:
        StorageError: not a whole MCAP file, or messages without a field that is not optional.
    """
    try:
        with opened(path, StorageError) as stream:
            summary = read_summary(stream, path)
            if summary is None:
                raise StorageError(f"{path}: its end is missing")
            topics = [(c.id, c.topic.rsplit("/", 1)[-1]) for c in summary.channels.values()]
            wanted, layouts = [], []
            for topic, message in TOPICS.items():
                channels = [number for number, name in topics if name == topic]
                layout = _layout(message, summary, channels)
                wanted.append(Wanted(topic, channels, layout.itemsize))
                layouts.append(layout)
            found = read_messages(stream, path, wanted)
    except OSError as error:
        raise StorageError(f"{path}: {error.strerror}") from error
    except TraceError as error:
        raise StorageError(str(error)) from error
    except (MessageError, StorageError) as error:
        raise StorageError(f"{path}: not a whole recording ({error}); deltatwin recover {path} OUT.mcap") from error
    return {
        topic: Recorded(_as_of_today(message, data.reshape(-1).view(layout)), log_time)
        for (topic, message), layout, (data, log_time) in zip(TOPICS.items(), layouts, found, strict=True)
    }


def _layout(message: Message, summary: Summary, channels: list[int]) -> np.dtype:
    """dtype of a topic's messages by the schema that they were written with.

    Raises:
        MessageError: a schema that cannot be read, or that lacks a field that is not optional.
    """
    schemas = [summary.schemas.get(summary.channels[number].schema_id) for number in channels]
    written = {schema.data for schema in schemas if schema is not None and schema.name == message.schema_name}
    if len(written) != 1:
        return message.dtype
    layout = dtype_of(written.pop().decode("utf-8", errors="replace"))
    missing = set(message.dtype.names or ()) - set(layout.names or ()) - OPTIONAL
    if missing:
        raise MessageError(f"{message.name} without {', '.join(sorted(missing))}")
    return layout


def _as_of_today(message: Message, records: np.ndarray) -> np.ndarray:
    if records.dtype == message.dtype:
        return records
    result = message.empty(len(records))
    for name in set(message.dtype.names or ()).intersection(records.dtype.names or ()):
        result[name] = records[name]
    return result
