"""Where a column mapping says another unit than the file itself: the mapping is what is read, and that is said."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.trace.from_columns import Plan
from schemas.columns import Columns, GripperColumn, TorqueColumn
from schemas.trace import Finding
from schemas.units import CLOCK_UNITS, POSITION_UNITS, TORQUE_UNITS, is_unit, said_unit, unit_texts, unknown_unit

NOT_COUNTED = ("datetime", "filetime")  # stamps that tell by themselves what they are


def contradictions(wanted: Plan, columns: Columns, stated: Mapping[int, str]) -> list[Finding]:
    """A note for each unit of `columns` that the file, or a column's name, gives otherwise.

    stated: units that the file gives, by the index of the column.

    Example: a mapping with `unit = "deg"` for a column under which the file says `rad`.
    """
    labels: dict[tuple[str, str], list[str]] = {}
    for channel in wanted.channels:
        column = channel.column
        if isinstance(column, GripperColumn) or channel.times_index is not None:
            continue
        known = TORQUE_UNITS if isinstance(column, TorqueColumn) else POSITION_UNITS
        if other := _other(column.name, stated.get(channel.index, ""), column.unit, known):
            labels.setdefault((other, column.unit), []).append(channel.label)
    time = columns.time
    stated_of_time = stated.get(wanted.times[0], "") if wanted.times else ""
    counted = wanted.times and time.unit not in NOT_COUNTED
    if counted and (other := _other(time.name, stated_of_time, time.unit, CLOCK_UNITS)):
        labels.setdefault((other, time.unit), []).append(f"time ({time.name!r})")
    return [
        Finding.note(f"{', '.join(names)}: the file says {other!r}, the mapping {unit!r}; read as {unit}")
        for (other, unit), names in labels.items()
    ]


def _other(name: str, stated: str, unit: str, known: Mapping[str, str]) -> str | None:
    """The unit that the file or the name gives where that is not `unit`; None where it is, or none is given."""
    if said := said_unit(name, stated, known):
        return None if said == unit else said
    of_nothing = unknown_unit(name, stated) if stated else None  # between brackets of a name anything may stand
    return of_nothing or next(filter(is_unit, unit_texts(name, stated)), None)
