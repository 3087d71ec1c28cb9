"""Frames that a capture has twice: on both ports of a bridge, on a mirror port, on every interface at once (`-i any`).

A frame is the same as another by what is in its datagrams, index, working counter and data, and by its direction,
whatever tags stand in front of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from drivers.ethercat.capture import FrameFlag, Frames
from drivers.ethercat.frames import Command, Kind, find_datagrams, u16
from schemas.kernels import kernel

WITHIN = 16  # frames: masters count datagrams in 16 numbers or more, and send and receive each
COUNTED = 4  # numbers of datagrams, from which on the master counts them
FEWEST = 8  # answered frames that tell
SHARE = 0.2  # of the answered frames that come again: of a mirror port's a half; a fault repeats few
FREQUENT = 0.9  # quantile of the time between frames of one datagram: those that wait for the next cycle

_SEEN = np.dtype([("hash", "i8"), ("head", "i8"), ("index", "i8"), ("time", "i8"), ("answered", "i8")])


@kernel
def _fingerprints(data, offset, length, seen):
    """Fill hash, head, index and answered of each frame; head -1: no process data."""
    for frame in range(len(offset)):
        row = seen[frame]
        row.head = -1
        kind, first, end = find_datagrams(data, offset[frame], length[frame])
        if kind != Kind.DATAGRAMS.value or first + 12 > end:
            continue
        command = data[first]
        if command != Command.LRD.value and command != Command.LWR.value and command != Command.LRW.value:
            continue
        value = np.int64(data[offset[frame] + 6] & 2)
        for at in range(first, end):
            value = (value ^ np.int64(data[at])) * np.int64(1099511628211)
        row.hash = value
        row.index = data[first + 1]
        row.head = np.int64(command) | (np.int64(row.index) << 8) | (u16(data, first + 2) << 16) | (end - first) << 32
        size = u16(data, first + 6) & 0x7FF
        row.answered = first + 12 + size <= end and u16(data, first + 10 + size) > 0


@kernel
def _repeats(seen, begin, counted, reference, repeated):
    """Mark what of seen[begin:] came before. counted: whether datagrams are numbered; reference: ns, a usual wait for
    the next cycle."""
    for k in range(begin, len(seen)):
        if seen[k].head < 0:
            continue
        for back in range(1, min(k, WITHIN) + 1):
            other = seen[k - back]
            if other.hash == seen[k].hash and other.head == seen[k].head:
                repeated[k - begin] = counted or 2 * (seen[k].time - other.time) < reference
                break
            if other.head == seen[k].head and not counted:
                break  # the datagram has gone on since: this is another cycle


def without_doubles(blocks: Iterable[Frames]) -> Iterator[Frames]:
    """The blocks, with `FrameFlag.REPEATED` set on frames that are there already."""
    before = np.zeros(0, _SEEN)
    for frames in blocks:
        now = np.zeros(len(frames), _SEEN)
        now["time"] = frames.time
        _fingerprints(frames.data, frames.offset, frames.length, now)
        now["head"][frames.flags != 0] = -1  # not whole, or not believed
        seen = np.concatenate([before, now])
        cyclic = now[now["head"] >= 0]
        answered = cyclic["answered"] != 0
        if np.count_nonzero(answered) >= FEWEST:
            counted = len(np.unique(cyclic["index"])) >= COUNTED
            order = np.argsort(cyclic["head"], kind="stable")
            waits = np.diff(cyclic["time"][order])[np.diff(cyclic["head"][order]) == 0]
            reference = float(np.quantile(waits, FREQUENT)) if len(waits) else 0.0
            repeated = np.zeros(len(frames), np.bool_)
            _repeats(seen, len(before), counted, reference, repeated)
            if np.mean(repeated[now["head"] >= 0][answered]) >= SHARE:
                frames.flags[repeated] |= np.uint8(FrameFlag.REPEATED)
        before = seen[-WITHIN:]
        yield frames
