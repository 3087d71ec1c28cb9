"""A proposal how to read a foreign table: which columns, how far apart its rows are in time, and of all readings of
their numbers the likeliest, with what cannot be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.trace.from_columns import on_other_rows, signed
from drivers.trace.tables import Table
from schemas.axes_description import Description
from schemas.columns import CHANNELS, TIME_UNITS
from schemas.diagnosis import named_joints
from schemas.errors import DataError
from schemas.units import LINEAR, POSITION_SCALES, POSITION_UNITS, TORQUE_UNITS
from service.identification.channels import (
    Channels,
    calls_itself_torque,
    guess,
    is_rate,
    no_torque,
    rate_hz,
    time_unit,
)
from service.identification.evidence import Run
from service.identification.readings import Candidates, Lines, Reading, Stated, judge, named, scale_of

LEAPS = 0.5  # of the way that readings go, that is left where their sign is put right
FOLLOWS_WITHIN = 2.0  # factor between the way of a command and that of what follows it


@dataclass(frozen=True)
class Proposal:
    """columns: keys of `schemas.columns.Columns`. reasons: why. doubts: what cannot be told, and how it was taken."""

    columns: Mapping[str, Any]
    reasons: Sequence[str]
    doubts: Sequence[str]
    channels: Channels


def propose(table: Table | Sequence[Table], robot: Description | None, stated: Stated) -> Proposal:
    """
    One mapping for a log, or for several runs of one machine whose tables have the same columns.

    Raises:
        DataError: it cannot be told which columns are meant, or how far apart its rows are in time, naming the option
            that says so.
    """
    runs = [table] if isinstance(table, Table) else list(table)
    first, reasons, doubts = runs[0], list[str](), list[str]()
    channels = _channels(first, robot, stated, reasons, doubts)
    layout: dict[str, Any] = dict(first.layout)
    day = layout.pop("date", None)
    if stated.where is not None:
        runs = [_stretch(run, *stated.where) for run in runs]
        layout["where"] = {"name": stated.where[0], "equals": stated.where[1]}
    read = [_readings(run, channels, stated.torque_times, reasons if run is runs[0] else []) for run in runs]
    runs, readings = [run for run, _ in read], read[0][1]
    time, rate = _time(runs[0], channels, stated, reasons, doubts)
    _refuse_other_clocks(runs, channels)
    if day is not None and time.get("unit") == "datetime":
        time["date"] = day
    if channels.time is not None:
        runs = [_on_one_clock(run, channels) for run in runs]
    found = _reading(runs, channels, robot, rate, stated, reasons, doubts)
    columns: dict[str, Any] = layout | {"time": time}
    for role in CHANNELS:
        names = getattr(channels, role)
        entry, sign = (found.torque, found.torque_signs) if role.startswith("torque") else (found.position, found.signs)
        if names and role.endswith("command"):
            units = TORQUE_UNITS if role.startswith("torque") else POSITION_UNITS
            measured = getattr(channels, role.removesuffix("_command"))
            meant = _as_measured(runs[0], names, measured, entry, units, robot.gear_ratios[0] if robot else 1.0)
            if meant is None:
                doubts.append(f"{_listed(names)} are not in the unit of the measured values: not used")
                channels = replace(channels, **{role: ()})
                continue
            if meant is not entry:
                reasons.append(f"{_listed(names)} are {named(meant)}: their range then matches the measured values")
                entry = meant
        if names:
            columns[role] = [
                _entry(runs[0], channels, name, {**_of_joint(entry, joint), **readings.get(name, {})}, s)
                for joint, (name, s) in enumerate(zip(names, sign, strict=True))
            ]
    return Proposal(columns, reasons, doubts, channels)


def _channels(
    table: Table, robot: Description | None, stated: Stated, reasons: list[str], doubts: list[str]
) -> Channels:
    """Which column is what.

    Raises:
        DataError: it cannot be told.
    """
    joints = None if robot is None else robot.count
    channels = guess(table, joints, () if robot is None else robot.joint_names)
    channels = replace(
        channels,
        time=stated.time or (None if stated.rate_hz else channels.time),
        position=stated.position or channels.position,
        torque=stated.torque or channels.torque,
    )
    channels = _told_once(channels, doubts)
    _check(table, channels, stated, joints, "" if robot is None else robot.at_rest)
    if not stated.torque:
        _refuse_rates(table, channels, doubts)
    if not (stated.position and stated.torque):
        reasons += channels.reasons
    if not stated.position:
        reasons += channels.order
        doubts += channels.doubts
    return channels


def _reading(
    runs: Sequence[Table], channels: Channels, robot: Description | None, rate: float, stated: Stated,
    reasons: list[str], doubts: list[str],
) -> Reading:  # fmt: skip
    """How the numbers are read.

    Raises:
        DataError: a constant is needed that nobody has said, or not as many signs or constants as joints are said.
    """
    count = len(channels.position)
    for what, given in (("--sign", stated.sign), ("--torque-unit", stated.torque_unit and stated.torque_unit[1])):
        if isinstance(given, Sequence) and len(given) not in (1, count):
            raise DataError(f"{runs[0].path}: {what} has {len(given)} numbers for {count} joints")
    own = [1] * count if stated.sign is None else [int(sign) for sign in stated.sign] * (count // len(stated.sign))
    candidates = Candidates(runs, channels, robot, rate, stated)
    positions, (torque, told) = candidates.positions(reasons, doubts), candidates.torque(reasons, doubts)
    if robot is None:
        found = Reading(positions[0], torque, None, [1] * count, [1] * count)
        found.doubts.append("signs and the side of the gear cannot be checked without --robot")
        if len(positions) > 1:
            found.doubts.append(f"positions are assumed to be {named(positions[0])}: the file does not say")
    else:
        unit = stated.position_unit or runs[0].said_unit(channels.position[0], POSITION_UNITS)
        logs = [_run(run, channels, own, stated.rate_hz) for run in runs]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # numbers of no machine are no evidence
            found = judge(robot, logs, positions, torque, (unit is not None, told))
        if robot.linear and unit is None:
            found.doubts.append(f"positions are assumed to be {positions[0]['unit']}, by their range")
    if None in found.torque.values():
        raise DataError(
            f"{runs[0].path}: torques are {found.torque['unit']}: how many N m per unit? Give it with --torque-unit"
        )
    signs = [int(a * b) for a, b in zip(own, found.torque_signs, strict=True)]
    if stated.sign is not None:
        found, signs = replace(found, of_signs=Lines(doubts=_of_stated(signs != own, found.of_signs.unsure))), own
    reasons += [*found.of_signs.reasons, *found.reasons]
    doubts += [*found.of_signs.doubts, *found.doubts]
    return replace(found, torque_signs=signs)


def _of_stated(against: bool, unconfirmed: Sequence[int]) -> list[str]:
    """What is told of signs that the user says."""
    if against:
        return ["the signs given by --sign contradict the motion"]
    if not unconfirmed:
        return []
    return [
        f"sign of the torque of {named_joints(unconfirmed)}: as --sign says; inertia and friction are too small in "
        "this log to confirm it"
    ]


def _run(table: Table, channels: Channels, signs: Sequence[int], rate: float | None) -> Run:
    """Positions and torques of a table as they stand there, and their stamps."""
    position, torque = (
        np.column_stack([table.columns[name] for name in names]) for names in (channels.position, channels.torque)
    )
    clock = table.time_of.get(channels.position[0], channels.time)
    if rate is not None or clock is None:
        return Run(position, torque * signs, rate or 1.0)
    time = table.columns[clock] / TIME_UNITS.get(time_unit(table, clock)[0], 1.0)
    return Run(position, torque * signs, rate_hz(table, clock), time)


def _of_joint(entry: Mapping[str, Any], joint: int) -> dict[str, Any]:
    """An entry with what of it is a list at this joint's value."""
    return {key: value[joint % len(value)] if isinstance(value, list) else value for key, value in entry.items()}


def _told_once(channels: Channels, doubts: list[str]) -> Channels:
    """The channels without a command that stands for what was measured."""
    if channels.torque_command and not channels.torque:
        doubts.append(
            f"no torque was measured: the commands {_listed(channels.torque_command)} are used instead, with the "
            "controller's lag"
        )
        return replace(channels, torque=channels.torque_command, torque_command=())
    twice = {
        f"{role}_command": () for role in ("position", "torque")
        if set(getattr(channels, role)) & set(getattr(channels, f"{role}_command"))
    }  # fmt: skip
    return replace(channels, **twice)


def _as_measured(
    table: Table, names: Sequence[str], measured: Sequence[str], entry: dict[str, Any], units: Mapping[str, str],
    gear: float,
) -> dict[str, Any] | None:  # fmt: skip
    """How commands are to be read so that they go as far as what was measured, which `entry` says; None where no unit
    is known in which they do."""
    if not isinstance(entry["unit"], str):  # a unit a joint
        return entry if [table.said_unit(name, units) for name in names] == entry["unit"] else None
    said = table.said_unit(names[0], units)
    same = said in (None, entry["unit"])
    if units is TORQUE_UNITS:  # a command may be a part of the torque, however large
        return entry if same else None
    way, wanted = (sum(np.nanvar(table.columns[name]) for name in columns) ** 0.5 for columns in (names, measured))
    wanted *= scale_of(entry, gear)
    linear = entry["unit"] in LINEAR or "counts_per_m" in entry
    others = [said] if said else ["m", "mm"] if linear else ["rad", "deg", "turns"]
    sides: list[dict[str, Any]] = [{}, {"side": "motor"}] if entry.get("side") == "motor" else [{}]
    readings = [entry] * same + [{"unit": unit} | side for unit in others if unit in POSITION_SCALES for side in sides]
    near = (r for r in readings if wanted < FOLLOWS_WITHIN * way * scale_of(r, gear) < FOLLOWS_WITHIN**2 * wanted)
    return next(near, None)


def _check(table: Table, channels: Channels, stated: Stated, joints: int | None, at_rest: str) -> None:
    """at_rest: how joints that the log does not have are described."""
    listed = ", ".join(list(table.columns)[:20])
    for role in ("position", "torque"):
        names = getattr(channels, role)
        for name in names:
            if name not in table.columns:
                raise DataError(f"{table.path}: no column {name!r}; it has: {listed}")
        if role == "torque" and (why := no_torque(table, names)):
            raise DataError(f"{table.path}: no torque was recorded: {why}; if a column is a torque, give --torque NAME")
        if not names or (joints and len(names) != joints):
            which = "column is the" if joints == 1 else f"{joints} columns are the" if joints else "columns are the"
            many, what = ("", "NAME") if joints == 1 else ("s", "NAME,NAME,...")
            said = f"{table.path}: it is unclear which {which} {role}{many}; give --{role} {what} (columns: {listed})"
            raise DataError(said + (at_rest if joints and len(names) < joints else ""))
    if len(channels.position) != len(channels.torque):
        raise DataError(
            f"{table.path}: {len(channels.position)} positions ({', '.join(channels.position)}) with "
            f"{len(channels.torque)} torques ({', '.join(channels.torque)}); give --position and --torque"
        )
    if channels.time is None and stated.rate_hz is None:
        raise DataError(f"{table.path}: no column of time stamps: give --rate HZ, or --time NAME (columns: {listed})")
    if channels.time is not None and channels.time not in table.columns:
        raise DataError(f"{table.path}: no column {channels.time!r}; it has: {listed}")
    for name in (stated.where and stated.where[0], stated.torque_times):
        if name is not None and name not in table.columns:
            raise DataError(f"{table.path}: no column {name!r}; it has: {listed}")


def _refuse_rates(table: Table, channels: Channels, doubts: list[str]) -> None:
    """Of what was taken for torques and follows from the positions: a doubt where its name says that it is one.

    Raises:
        DataError: nothing says so.
    """
    clock = table.time_of.get(channels.position[0], channels.time)
    for at, name in zip(channels.position, channels.torque, strict=True):
        if table.said_unit(name, TORQUE_UNITS) is None and is_rate(table, name, at, clock):
            line = f"{name!r} is the speed or acceleration of {at!r}"
            if not calls_itself_torque(name):
                raise DataError(f"{table.path}: no torque was recorded: {line}; if it is a torque, give --torque NAME")
            doubts.append(f"{line}, although its name says torque")


def _stretch(table: Table, name: str, equals: float) -> Table:
    """The longest run of rows that count.

    Raises:
        DataError: no such row.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], table.columns[name] == equals, [False]]).astype(int)))
    if not len(edges):
        raise DataError(f"{table.path}: no row has {equals:g} in column {name!r}")
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    rows = slice(edges[2 * longest], edges[2 * longest + 1])
    return replace(table, columns={name: values[rows] for name, values in table.columns.items()})


def _readings(
    table: Table, channels: Channels, times: str | None, reasons: list[str]
) -> tuple[Table, dict[str, dict[str, Any]]]:
    """The table with torques as they are meant, and keys of the columns whose readings are not that."""
    meant, readings = dict(table.columns), {}
    for role in ("torque", "torque_command"):
        names = getattr(channels, role)
        bits = next((b for b in (8, 16, 32) if any(_without_sign(meant[name], b) for name in names)), None)
        for name in names:
            keys = {"bits": bits, "times": times if role == "torque" else None}
            readings[name] = {key: value for key, value in keys.items() if value is not None}
            meant[name] = signed(meant[name], bits) * (1.0 if keys["times"] is None else meant[keys["times"]])
        if bits:
            reasons.append(f"{_listed(names)} are {bits}-bit numbers read without sign: {2**bits - 1} means -1")
    return replace(table, columns=meant), readings


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names))


def _without_sign(values: np.ndarray, bits: int) -> bool:
    """Whether whole numbers that fit so many bits leap from one end to the other, and hardly with their sign."""
    known = values[np.isfinite(values)]
    if not len(known) or known.min() < 0 or known.max() >= 2.0**bits or (known != np.round(known)).any():
        return False
    way, way_with_sign = (np.abs(np.diff(read)).sum() for read in (known, signed(known, bits)))
    return bool(way_with_sign < LEAPS * way)


def _time(
    table: Table, channels: Channels, stated: Stated, reasons: list[str], doubts: list[str]
) -> tuple[dict[str, Any], float]:
    if channels.time is None:
        assert stated.rate_hz is not None
        return {"rate_hz": stated.rate_hz}, stated.rate_hz
    unit, said = time_unit(table, channels.time)
    clock = table.time_of.get(channels.position[0], channels.time)
    rate = rate_hz(table, clock)
    line = f"stamps in {channels.time!r} are {unit}: {rate:.6g} Hz"
    (reasons if said or unit == "datetime" else doubts).append(line if said else f"{line}, judged by the rate alone")
    name = clock.rsplit(" (", 1)[0] if table.kind.startswith("TwinCAT") else clock
    return {"name": name, "unit": unit}, rate


def _refuse_other_clocks(runs: Sequence[Table], channels: Channels) -> None:
    """
    Raises:
        DataError: a run's stamps are in another unit than those of the first, by what it says or by their rate.
    """
    if channels.time is None:
        return
    first = time_unit(runs[0], channels.time)[0]
    for run in runs[1:]:
        if (other := time_unit(run, channels.time)[0]) != first:
            raise DataError(
                f"{run.path}: stamps in {channels.time!r} are {other}, those of {runs[0].path.name} {first}: import it "
                "separately"
            )


def _on_one_clock(table: Table, channels: Channels) -> Table:
    """The table with positions and torques where they stand at the stamps of the first position."""
    names = (*channels.position, *channels.torque)
    clocks = {name: table.time_of.get(name, channels.time) for name in names}
    first = channels.position[0]
    base, here = clocks[first], np.isfinite(table.columns[first])
    brought, apart = {}, False
    for name, clock in clocks.items():
        known = np.isfinite(table.columns[name])
        other = on_other_rows(known, here)
        apart |= other
        if clock is not None and base is not None and (clock != base or other):
            own = table.columns[clock]
            known = np.isfinite(own) & (known | (not other))
            values = table.columns[name][known]
            brought[name] = np.interp(table.columns[base], own[known], values, left=np.nan, right=np.nan)
    rows = here if apart else slice(None)
    return replace(table, columns={name: values[rows] for name, values in {**table.columns, **brought}.items()})


def _entry(table: Table, channels: Channels, name: str, entry: Mapping[str, Any], sign: int) -> dict[str, Any]:
    found: dict[str, Any] = {"name": name, **entry}
    if sign < 0:
        found["sign"] = -1
    clock = table.time_of.get(name)
    if clock and clock != table.time_of.get(channels.position[0], channels.time) and not table.kind.startswith("Twin"):
        found["time"] = clock
    return found
