"""A proposal how to read a foreign table: units, signs and the side of the gear that make the torque what the motion
needs, and what cannot be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from drivers.trace.assembly import signed
from drivers.trace.quality import ANY_JOINT, MAX_SPEED
from drivers.trace.tables import Table
from schemas.axes import Description
from schemas.chain import Chain
from schemas.columns import CHANNELS
from schemas.diagnosis import named_joints
from schemas.errors import DataError, TraceError
from schemas.machine import Machine
from schemas.messages import SampleFlag
from schemas.robot import Robot
from schemas.trace import Trace
from service.identification.channels import (
    POSITION_UNITS,
    TORQUE_UNITS,
    Channels,
    guess,
    no_torque,
    rate_hz,
    said_unit,
    time_unit,
)
from service.identification.checks import SUSPECT, TorqueReading, best_reading
from service.identification.regression import summarise
from service.model.nominal import pack
from service.model.signals import lowpass

LONGEST = 10.0  # s of a log that are tried; a reading that is wrong shows at once
SHORTEST = 0.5  # s that each joint moves, without which nothing is tried
CLEAR = 0.6  # a reading is told from another that leaves this many times as much or more
# The same of a torque's scale. By the masses, 46 logs of free motion in N m left 0.94 and more of what they left as
# N m, four that carried products 0.86 and more; read at 1.5 times their scale 0.65 in the middle, further off less.
CLEAR_SCALE = 0.8
HOPELESS = 0.5  # share of the torque left, from which nothing can be said
LEAPS = 0.5  # of the way that readings go, that is left where their sign is put right
FOLLOWS_WITHIN = 2.0  # factor between the way of a command and that of what follows it
SAME = 1.25  # factor within which a torque's scale goes with the masses of the description
_WHENCE = "by the masses of the description; the data sheet is better: --torque-unit"
AS_GIVEN = (1, 1, 1)  # signs
SCALES = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi, "m": 1.0, "mm": 1e-3}


@dataclass(frozen=True)
class Stated:
    """What the user says; None where it is to be found. torque_unit: (unit, rated torque or constant). torque_times:
    column that the torques are multiplied with. where: (column, value) of the rows that count."""

    time: str | None = None
    rate_hz: float | None = None
    position: Sequence[str] | None = None
    torque: Sequence[str] | None = None
    position_unit: str | None = None
    counts_per_rev: float | None = None
    torque_unit: tuple[str, float | None] | None = None
    torque_times: str | None = None
    where: tuple[str, float] | None = None
    counts_per_m: float | None = None


@dataclass(frozen=True)
class Proposal:
    """columns: keys of `schemas.columns.Columns`. reasons: why. doubts: what cannot be told, and how it was taken."""

    columns: Mapping[str, Any]
    reasons: Sequence[str]
    doubts: Sequence[str]
    channels: Channels


def propose(table: Table, robot: Description | None, stated: Stated) -> Proposal:
    """
    Raises:
        DataError: it cannot be told which columns are meant, or how far apart its rows are in time, naming the option
            that says so.
    """
    joints = None if robot is None else robot.count
    channels = guess(table, joints, robot.joints if isinstance(robot, Chain) else ())
    channels = replace(
        channels,
        time=stated.time or (None if stated.rate_hz else channels.time),
        position=stated.position or channels.position,
        torque=stated.torque or channels.torque,
    )
    reasons, doubts = list(channels.reasons), []
    channels = _told_once(channels, doubts)
    _check(table, channels, stated, joints)
    if stated.position and stated.torque:
        reasons.clear()
    if not stated.position:
        reasons += channels.order
        doubts += channels.doubts
    layout: dict[str, Any] = dict(table.layout)
    if stated.where is not None:
        table = _stretch(table, *stated.where)
        layout["where"] = {"name": stated.where[0], "equals": stated.where[1]}
    table, readings = _readings(table, channels, stated.torque_times, reasons)
    time, rate = _time(table, channels, stated, reasons, doubts)
    if channels.time is not None:
        table = _on_one_clock(table, channels)
    units = _Units(table, channels, robot, rate, stated)
    positions, (torque, torque_said) = units.positions(reasons, doubts), units.torque(reasons, doubts)
    position = positions[0]
    if len(positions) == 1 and position.get("side") == "motor" and not any("positions" in doubt for doubt in doubts):
        reasons.append("positions are the motor's: no joint turns so far")
    signs: Sequence[int] = [1] * len(channels.position)
    torque_signs: Sequence[int] = [1] * len(channels.position)
    if isinstance(robot, Robot):
        found = [_by_delta(table, channels, robot, rate, position, torque, torque_said) for position in positions]
        best = min(found, key=lambda reading: reading.share)
        if len(found) > 1:
            others = [reading.share for reading in found if reading is not best]
            told_by = f"positions are {_named(best.position)}: the fit leaves {100 * best.share:.2g} % of the torque"
            clear = best.share < CLEAR * min(others)
            (reasons if clear else doubts).append(f"{told_by}, read otherwise {100 * min(others):.2g} %")
        position, signs, torque_signs = best.position, best.signs, best.torque_signs
        torque = _complete(best.torque, table)
        reasons += best.reasons
        doubts += best.doubts
    elif isinstance(robot, Machine):
        torque_signs = _by_axes(table, channels, rate, position, reasons, doubts)
    else:
        doubts.append("without --robot signs and the side of the gear cannot be checked")
    columns: dict[str, Any] = layout | {"time": time}
    for role in CHANNELS:
        names = getattr(channels, role)
        entry, sign = (torque, torque_signs) if role.startswith("torque") else (position, signs)
        if names and role.endswith("command"):
            units = TORQUE_UNITS if role.startswith("torque") else POSITION_UNITS
            measured = getattr(channels, role.removesuffix("_command"))
            meant = _as_measured(table, names, measured, entry, units, robot.gear_ratios[0] if robot else 1.0)
            if meant is None:
                doubts.append(f"{_listed(names)} are in another unit than what was measured: left out")
                channels = replace(channels, **{role: ()})
                continue
            if meant is not entry:
                reasons.append(f"{_listed(names)} are {_named(meant)}: so they go as far as what was measured")
                entry = meant
        if names:
            columns[role] = [
                _entry(table, channels, name, {**entry, **readings.get(name, {})}, s)
                for name, s in zip(names, sign, strict=True)
            ]
    return Proposal(columns, reasons, doubts, channels)


def _told_once(channels: Channels, doubts: list[str]) -> Channels:
    """The channels without a command that stands for what was measured."""
    if channels.torque_command and not channels.torque:
        doubts.append(
            f"{_listed(channels.torque_command)} are commands, and no torque was measured: what the controller asked "
            "for stands in for it, with the controller's lag"
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
    said = said_unit(table, names[0], units)
    same = said in (None, entry["unit"])
    if units is TORQUE_UNITS:  # a command may be a part of the torque, however large
        return entry if same else None
    way, wanted = (sum(np.nanvar(table.columns[name]) for name in columns) ** 0.5 for columns in (names, measured))
    wanted *= _scale(entry, gear)
    linear = entry["unit"] in ("m", "mm") or "counts_per_m" in entry
    others = [said] if said else ["m", "mm"] if linear else ["rad", "deg", "turns"]
    sides: list[dict[str, Any]] = [{}, {"side": "motor"}] if entry.get("side") == "motor" else [{}]
    readings = [entry] * same + [{"unit": unit} | side for unit in others if unit in SCALES for side in sides]
    near = (r for r in readings if wanted < FOLLOWS_WITHIN * way * _scale(r, gear) < FOLLOWS_WITHIN**2 * wanted)
    return next(near, None)


def _check(table: Table, channels: Channels, stated: Stated, joints: int | None) -> None:
    listed = ", ".join(list(table.columns)[:20])
    for role in ("position", "torque"):
        names = getattr(channels, role)
        for name in names:
            if name not in table.columns:
                raise DataError(f"{table.path}: no column {name!r}; it has: {listed}")
        if role == "torque" and (why := no_torque(table, names)):
            raise DataError(f"{table.path}: no torque was recorded: {why}; if one is all the same: --torque NAME")
        if not names or (joints and len(names) != joints):
            which = "column is the" if joints == 1 else f"{joints} columns are the" if joints else "columns are the"
            many, what = ("", "NAME") if joints == 1 else ("s", "NAME,NAME,...")
            raise DataError(
                f"{table.path}: which {which} {role}{many} cannot be told; say --{role} {what} (columns: {listed})"
            )
    if len(channels.position) != len(channels.torque):
        raise DataError(
            f"{table.path}: {len(channels.position)} positions ({', '.join(channels.position)}) with "
            f"{len(channels.torque)} torques ({', '.join(channels.torque)}); say --position and --torque"
        )
    if channels.time is None and stated.rate_hz is None:
        raise DataError(f"{table.path}: no column of stamps: say --rate HZ, or --time NAME (columns: {listed})")
    if channels.time is not None and channels.time not in table.columns:
        raise DataError(f"{table.path}: no column {channels.time!r}; it has: {listed}")
    for name in (stated.where and stated.where[0], stated.torque_times):
        if name is not None and name not in table.columns:
            raise DataError(f"{table.path}: no column {name!r}; it has: {listed}")


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
            reasons.append(f"{_listed(names)} are of {bits} bits without their sign: {2**bits - 1} stands for -1")
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
    (reasons if said or unit == "datetime" else doubts).append(line if said else f"{line}, by the rate alone")
    name = clock.rsplit(" (", 1)[0] if table.kind.startswith("TwinCAT") else clock
    return {"name": name, "unit": unit}, rate


def _on_one_clock(table: Table, channels: Channels) -> Table:
    """The table with positions and torques where they stand at the stamps of the first position."""
    clocks = {name: table.time_of.get(name, channels.time) for name in (*channels.position, *channels.torque)}
    base = clocks[channels.position[0]]
    brought = {}
    for name, clock in clocks.items():
        if clock is not None and base is not None and clock != base:
            own = table.columns[clock]
            known = np.isfinite(own)
            values = table.columns[name][known]
            brought[name] = np.interp(table.columns[base], own[known], values, left=np.nan, right=np.nan)
    return replace(table, columns={**table.columns, **brought})


def _entry(table: Table, channels: Channels, name: str, entry: Mapping[str, Any], sign: int) -> dict[str, Any]:
    found: dict[str, Any] = {"name": name, **entry}
    if sign < 0:
        found["sign"] = -1
    clock = table.time_of.get(name)
    if clock and clock != table.time_of.get(channels.position[0], channels.time) and not table.kind.startswith("Twin"):
        found["time"] = clock
    return found


class _Units:
    """Units that names, ranges and speeds tell."""

    def __init__(
        self, table: Table, channels: Channels, robot: Description | None, rate: float, stated: Stated
    ) -> None:
        self._table, self._channels, self._robot, self._rate = table, channels, robot, rate
        self._stated = stated
        self._values = np.column_stack([table.columns[name] for name in channels.position])
        self._gear = robot.gear_ratios[0] if robot else 1.0

    def positions(self, reasons: list[str], doubts: list[str]) -> list[dict[str, Any]]:
        """What the positions may be, the likeliest first."""
        stated, robot = self._stated, self._robot
        said = stated.position_unit or said_unit(self._table, self._channels.position[0], POSITION_UNITS)
        counts = said == "counts" or (said is None and self._integers())
        if counts and (stated.counts_per_m is not None or (robot is not None and robot.linear)):
            if stated.counts_per_m is None:
                raise DataError(
                    f"{self._table.path}: positions are increments, of an axis in m; how many make a metre? say "
                    "--counts-per-m"
                )
            reasons.append(f"positions are increments, {stated.counts_per_m:g} a metre")
            return [{"unit": "counts", "counts_per_m": stated.counts_per_m}]
        if counts:
            per_turn = stated.counts_per_rev or _counts(robot)
            if per_turn is None:
                raise DataError(
                    f"{self._table.path}: positions are increments; how many make a turn of the encoder's shaft? "
                    "say --counts-per-rev"
                )
            reasons.append(f"positions are increments, {per_turn:g} a turn")
            return self._sides({"unit": "counts", "counts_per_rev": per_turn}, 2 * np.pi / per_turn)
        if said is not None:
            reasons.append(f"positions are {said}: " + ("told" if stated.position_unit else "it stands there"))
            return self._sides({"unit": said}, SCALES[said])
        if robot is not None and robot.linear:
            unit = "mm" if np.nanmax(np.abs(self._values)) > 10 else "m"
            doubts.append(f"positions taken as {unit}, by their range")
            return [{"unit": unit}]
        found = [entry for unit in ("rad", "deg") for entry in self._sides({"unit": unit}, SCALES[unit])]
        found = [entry for entry in found if self._plausible(_scale(entry, self._gear))] or [{"unit": "rad"}]
        if not isinstance(robot, Robot) or len(found) == 1:
            doubts.append(f"positions taken as {_named(found[0])}, by their range and speed")
        return found

    def _integers(self) -> bool:
        values = self._values[np.isfinite(self._values)]
        return bool(np.ptp(values) > 1000 and np.mean(values == np.round(values)) > 0.1)

    def _plausible(self, scale: float) -> bool:
        speed = np.abs(np.diff(self._values, axis=0)) * scale * self._rate
        return bool(np.nanmax(np.abs(self._values)) * scale <= ANY_JOINT and np.nanquantile(speed, 0.99) <= MAX_SPEED)

    def _sides(self, entry: dict[str, Any], scale: float) -> list[dict[str, Any]]:
        """The sides of the gear on which a Delta's joint, or an axis, could turn so far."""
        if self._gear == 1.0 or "m" in entry["unit"] or isinstance(self._robot, Machine):
            return [entry]  # an axis may turn as far as it likes
        farthest = float(np.nanmax(np.abs(self._values))) * scale
        motor = entry | {"side": "motor"}
        return [entry] * (farthest <= ANY_JOINT) + [motor] * (farthest / self._gear <= ANY_JOINT) or [entry]

    def torque(self, reasons: list[str], doubts: list[str]) -> tuple[dict[str, Any], bool]:
        """Without a scale where it takes a constant that nobody has said; and whether the unit was said."""
        if self._stated.torque_unit is not None:
            unit, factor = self._stated.torque_unit
        else:
            unit, factor = said_unit(self._table, self._channels.torque[0], TORQUE_UNITS), None
            if unit is not None:
                reasons.append(f"torques are {unit}: it stands there")
        said = unit is not None
        if unit is None:
            unit = "N" if self._robot and self._robot.linear else "N m"
            if not isinstance(self._robot, Robot):
                doubts.append(f"torques taken as {unit}: nothing says so")
        entry: dict[str, Any] = {"unit": unit}
        if unit in ("percent", "permille"):
            entry["rated"] = factor or _rated(self._robot)
        elif unit in ("A", "V"):
            entry["constant"] = factor
        missing = next((key for key in ("rated", "constant") if key in entry and entry[key] is None), None)
        if missing and not isinstance(self._robot, Robot):
            what = "rated torque" if missing == "rated" else "N m a unit"
            raise DataError(
                f"{self._table.path}: torques are {unit}; the {what} is not known: say --torque-unit '{unit} NUMBER'"
            )
        return entry, said


def _counts(robot: Description | None) -> float | None:
    drives = robot.drive.joint if isinstance(robot, Robot) else None
    return float(drives[0].counts_per_turn) if drives else None


def _rated(robot: Description | None) -> float | None:
    drives = robot.drive.joint if isinstance(robot, Robot) else None
    return float(drives[0].torque.full_scale_nm) if drives else None


def _trial(table: Table, rate: float, position: np.ndarray, torque: np.ndarray) -> Trace:
    """The part of the log that moves most, evenly stamped."""
    length = min(len(position), int(LONGEST * rate))
    activity = np.concatenate([[0.0], np.cumsum(np.nansum(np.abs(np.diff(position, axis=0)), axis=1))])
    ends = activity[length - 1 :] - activity[: len(activity) - length + 1]
    start = int(np.argmax(ends))
    part = slice(start, start + length)
    bad = ~(np.isfinite(position[part]).all(axis=1) & np.isfinite(torque[part]).all(axis=1))
    return Trace(
        Path(table.path.name),
        np.arange(length) / rate,
        np.ascontiguousarray(position[part]),
        np.ascontiguousarray(torque[part]),
        flags=np.where(bad, np.uint32(SampleFlag.NOT_A_NUMBER), np.uint32(0)),
    )


@dataclass(frozen=True)
class _Reading:
    """One way to read a Delta's log. share: of the torque's rms, that the robot's equations leave."""

    position: dict[str, Any]
    torque: dict[str, Any]
    share: float = np.inf
    signs: Sequence[int] = AS_GIVEN
    torque_signs: Sequence[int] = AS_GIVEN
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)


def _fits(
    table: Table, robot: Robot, rate: float, positions: np.ndarray, torques: np.ndarray, known: bool, said: bool
) -> list[tuple[float, Sequence[int], TorqueReading, float]]:
    """(share left, signs of the positions, the torque's reading, its scale by the masses), the best first. positions:
    (N, 3) rad of the joints. torques: (N, 3), in N m if `known`; said: by the file or the user."""
    model, gear = pack(robot), robot.drive.gear_ratio

    def fitted(signs: Sequence[int]) -> tuple[TorqueReading, float] | None:
        try:
            log = summarise(model, _trial(table, rate, positions * np.array(signs), torques))
        except (TraceError, DataError):  # no pose of this robot
            return None
        if log.seconds.sum(axis=0).min() <= SHORTEST:
            return None
        sums = log.gram.sum(axis=0)
        free = best_reading(sums, gear, free_scale=True)
        named = best_reading(sums, gear) if known else free
        clear = not said and free.share < min(SUSPECT, CLEAR_SCALE * named.share)
        return free if clear else named, free.scale

    found = {AS_GIVEN: fitted(AS_GIVEN)}
    if (first := found[AS_GIVEN]) is None or first[0].share > SUSPECT:
        found |= {signs: fitted(signs) for signs in product((1, -1), repeat=3) if signs != AS_GIVEN}
    return sorted(((fit[0].share, signs, *fit) for signs, fit in found.items() if fit), key=lambda entry: entry[0])


def _by_delta(
    table: Table, channels: Channels, robot: Robot, rate: float, position: dict[str, Any], torque: dict[str, Any],
    said: bool,
) -> _Reading:  # fmt: skip
    """Signs, side and scale with which the robot's equations explain the torque. said: whether its unit is known."""
    gear = robot.drive.gear_ratio
    positions = np.column_stack([table.columns[name] for name in channels.position]) * _scale(position, gear)
    given = np.column_stack([table.columns[name] for name in channels.torque])
    factor = torque.get("constant") or torque.get("rated")
    known = not ("constant" in torque or "rated" in torque) or factor is not None
    per = {"percent": 100.0, "permille": 1000.0}.get(torque["unit"], 1.0)
    ranked = _fits(table, robot, rate, positions, given * (factor / per if factor else 1.0), known, said)
    reading = _Reading(position, torque)
    reasons, doubts = reading.reasons, reading.doubts
    if not ranked:
        doubts.append(
            f"read as {_named(position)} the positions are no poses of {robot.name}, or hardly move: zero or geometry?"
        )
        return reading
    share, signs, fit, by_masses = ranked[0]
    reading = replace(reading, share=share)
    line = f"with these readings the robot's equations leave {100 * share:.2g} % of the torque"
    if share > HOPELESS:
        doubts.append(f"{line}: signs and gear side cannot be told from this log")
        return reading
    second = ranked[1][0] if len(ranked) > 1 else np.inf
    if share > CLEAR * second:
        doubts.append(f"{line}, with other signs of the positions {100 * second:.2g} %: signs are not certain")
    else:
        reasons.append(line)
    if fit.order != (0, 1, 2):
        order = ", ".join(str(k + 1) for k in fit.order)
        doubts.append(f"the torques fit better in the order {order}: cables swapped? --torque says it otherwise")
        return reading
    for what, which in (("torque", fit.signs), ("position", signs)):
        turned = named_joints([j + 1 for j in range(3) if which[j] < 0])
        if turned:
            reasons.append(f"the {what} of {turned} has the other sign")
    torque = dict(torque)
    side = next((s for s in (1.0, gear) if 1 / SAME <= fit.scale / s <= SAME), None) if known else None
    if side is None:
        torque = _known(torque if not known else {"unit": "A", "constant": None}, float(f"{fit.scale * per:.4g}"))
        doubts.append(
            f"one {torque['unit'] if not known else 'unit of torque'} taken as {fit.scale:.4g} N m, {_WHENCE}"
        )
    elif side != 1.0:
        torque["side"] = "motor"
        reasons.append(f"torques are the motor's: times the gear of {gear:g} they fit")
    if side is not None and not said:
        fits = share < SUSPECT and 1 / SAME <= by_masses / fit.scale <= SAME
        why = "; the fit goes with it" if fits else f", and by the masses one would be {by_masses / side:.3g} N m"
        why = ", and the fit is poor" if share >= SUSPECT else why
        (reasons if fits else doubts).append(f"torques taken as N m: nothing says so{why}")
    return replace(reading, signs=signs, torque=torque, torque_signs=[int(s) for s in fit.signs])


def _named(position: Mapping[str, Any]) -> str:
    return f"{position['unit']} of the {'motor' if position.get('side') == 'motor' else 'joint'}"


def _complete(torque: Mapping[str, Any], table: Table) -> dict[str, Any]:
    """The torque as the likeliest reading has it.

    Raises:
        DataError: its unit takes a constant that nobody has said and the equations do not tell.
    """
    if None in torque.values():
        raise DataError(f"{table.path}: torques are {torque['unit']}: how many N m each? say --torque-unit")
    return dict(torque)


def _known(torque: Mapping[str, Any], scale: float) -> dict[str, Any]:
    return {key: scale if value is None else value for key, value in torque.items()}


def _scale(position: Mapping[str, Any], gear: float) -> float:
    if "counts_per_m" in position:
        return 1 / position["counts_per_m"]
    scale = 2 * np.pi / position["counts_per_rev"] if "counts_per_rev" in position else SCALES[position["unit"]]
    return scale / gear if position.get("side") == "motor" else scale


def _by_axes(
    table: Table, channels: Channels, rate: float, position: Mapping[str, Any], reasons: list[str], doubts: list[str]
) -> list[int]:
    """Signs with which more acceleration takes more torque, each axis for itself."""
    signs = []
    for number, (name, force) in enumerate(zip(channels.position, channels.torque, strict=True), 1):
        x, y = table.columns[name], table.columns[force]
        good = np.isfinite(x) & np.isfinite(y)
        if good.sum() < 100:
            signs.append(1)
            continue
        x = lowpass(x[good][:, None] * _scale(position, 1.0), 1 / rate)[:, 0]
        y = lowpass(y[good][:, None], 1 / rate)[:, 0]
        v = np.gradient(x) * rate
        a = np.gradient(v) * rate
        moved = np.abs(v) > 0.05 * np.abs(v).max()
        columns = np.column_stack([a, v, np.sign(v), np.sin(x), np.cos(x), np.ones_like(x)])[moved]
        values, *_ = np.linalg.lstsq(columns, y[moved], rcond=1e-9)
        left = y[moved] - columns @ values
        worth = np.array([abs(values[k]) * np.std(columns[:, k]) for k in (0, 2)])
        if worth.max() < 0.1 * np.std(left):
            doubts.append(f"axis {number}: neither inertia nor friction shows in {force!r}: its sign cannot be told")
            signs.append(1)
            continue
        against = values[(0, 2)[int(np.argmax(worth))]] < 0
        signs.append(-1 if against else 1)
        if against:
            reasons.append(f"axis {number}: {force!r} pushes against the motion: the other sign")
    return signs
