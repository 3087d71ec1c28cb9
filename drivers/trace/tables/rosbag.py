"""Bags of ROS and of Foxglove: the joints of their joint states, called `<joint>.position` and `<joint>.effort`.

Several publishers on one topic have each its own joints and stamps; a publisher may change the order of its joints.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from drivers.trace.tables import Table, padded
from drivers.trace.tables.bag_files import Choose, messages_of, parts_of
from drivers.trace.tables.foxglove import TYPE as FOXGLOVE
from drivers.trace.tables.foxglove import decode as _foxglove
from drivers.trace.tables.joint_state import TYPES, UNITS, JointState, decode
from schemas.errors import TraceError
from schemas.messages import NANOSECONDS


def read(path: Path, topic: str | None = None) -> Table:
    """topic: of the joint states, where the bag has several.

    Raises:
        TraceError: no bag, none or several topics of joint states in it, or a message that is not whole.
    """
    parts = parts_of(path)
    choose = _chooser(topic)
    read_parts = [_states(part, choose) for part in parts]
    if path.is_dir() and not (path / "metadata.yaml").exists():
        read_parts.sort(key=lambda part: part[0][0] if part else 0)
    states = [state for part in read_parts for state in part]
    if not states:
        raise TraceError(f"{path}: no message on its topic of joint states")
    unstamped = len({state.stamp for _, state in states}) == 1 < len(states)
    stamps = np.array([log if unstamped else state.stamp for log, state in states], np.int64)
    groups: dict[frozenset[str], list[int]] = {}
    for k, (_, state) in enumerate(states):
        groups.setdefault(frozenset(state.names), []).append(k)
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    time_of: dict[str, str] = {}
    for number, rows in enumerate(groups.values(), 1):
        clock = "time" if number == 1 else f"time {number}"
        columns[clock], units[clock] = (stamps[rows] - stamps[0]) / NANOSECONDS, "s"
        for name, values, unit in _joints([states[k][1] for k in rows]):
            own = next(n for n in (name, *(f"{name} ({k})" for k in range(2, 99))) if n not in columns)
            columns[own], units[own] = values, unit
            if len(groups) > 1:
                time_of[own] = clock
    kind = "bag of joint states" + (", with the recorder's stamps: the messages have none" if unstamped else "")
    kind += f", {len(groups)} publishers" if len(groups) > 1 else ""
    layout = {"topic": topic} if topic else {}
    return Table(path, kind, padded(columns), units, time_of, int(stamps[0]), layout)


def _states(part: Path, choose: Choose) -> list[tuple[int, JointState]]:
    found = []
    for number, message in enumerate(messages_of(part, choose), 1):
        try:
            state = (_foxglove if message.encoding in ("json", "protobuf") else decode)(message.data, message.encoding)
        except (struct.error, ValueError, UnicodeDecodeError) as error:
            raise TraceError(f"{part}: joint state {number} is not whole: {error}") from error
        if state.names:
            found.append((message.log_ns, state))
    return found


def _joints(states: list[JointState]) -> list[tuple[str, np.ndarray, str]]:
    """Columns of messages with the same joints, in the order of the first: name, values and unit. A field that a
    message leaves empty is NaN there, and no column where all do."""
    names = states[0].names
    order = {tuple(state.names): [state.names.index(name) for name in names] for state in states}
    found = []
    for k, (field, unit) in enumerate(UNITS.items()):
        block = np.full((len(states), len(names)), np.nan)
        for row, state in enumerate(states):
            if len(state.values[k]) == len(names):
                block[row] = state.values[k][order[tuple(state.names)]]
        if any(len(state.values[k]) for state in states):
            found += [
                (f"{name}.{field}", np.ascontiguousarray(block[:, joint]), unit) for joint, name in enumerate(names)
            ]
    return found


def _chooser(topic: str | None) -> Choose:
    def choose(kinds: dict[str, str], path: Path) -> str:
        found = [name for name, kind in kinds.items() if kind in (*TYPES, FOXGLOVE)]
        listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(kinds.items())) or "none"
        if topic is not None:
            if topic in found:
                return topic
            raise TraceError(f"{path}: no topic {topic!r} of {TYPES[0]}, or {FOXGLOVE}; topics: {listed}")
        if len(found) == 1:
            return found[0]
        if found:
            raise TraceError(
                f"{path}: {len(found)} topics of {TYPES[0]}: {', '.join(sorted(found))}; give one with --topic"
            )
        raise TraceError(f"{path}: no topic of {TYPES[0]}, or {FOXGLOVE}; topics: {listed}")

    return choose
