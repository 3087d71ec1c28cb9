"""Which reading of a foreign log's numbers: what they may be (candidates), how well each goes with the machine
(evidence, see there), and which is taken.

The first candidate is the log as it was recorded. Another is taken where it is `SURE` to be likelier; where nothing is
sure the log stays as recorded and it is said that it could not be told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from drivers.trace.quality import ANY_JOINT, MAX_SPEED
from drivers.trace.tables import Table
from schemas.axes_description import Axes, Description
from schemas.chain_description import Chain
from schemas.diagnosis import named_joints
from schemas.errors import DataError, RobotError
from schemas.robot import Robot
from schemas.units import (
    CONSTANTS,
    LINEAR,
    POSITION_SCALES,
    POSITION_UNITS,
    SHARES,
    TORQUE_SCALES,
    TORQUE_UNITS,
    tokens,
)
from service.identification.channels import WORDS, Channels
from service.identification.checks import SUSPECT
from service.identification.evidence import (
    AS_GIVEN,
    FLOOR,
    SURE,
    DeltaFit,
    Left,
    MachineSums,
    Run,
    delta_fits,
    log_odds,
    machine_sums,
    said,
)

POOR = 2 * SUSPECT  # share of the torque left by an arm's equations, from which something is wrong with them
HOPELESS = 0.5  # share of the torque left, from which nothing can be said
SAME = 1.25  # factor within which a torque's scale goes with the masses of the description
NO_ACCIDENT = 4.0  # gear ratio that no torque is off by for another reason, such as half of it being recorded
FASTEST = 1000.0  # rad/s, of a motor's own axis: no servo motor turns faster
BEYOND_LIMITS = 1.2  # times the span of a URDF's limits
FEW = 8  # different whole numbers: more, and nothing but these, are increments
OFTEN_WRONG = 0.25, 0.5, 2.0, 4.0  # times that a gear ratio or a number of increments is wrong
UR_JOINT = "shoulder_pan_joint"
UR_CURRENTS = ": the driver of Universal Robots publishes currents as effort; --torque-unit 'A CONSTANT,CONSTANT,...'"
WHENCE = "from the masses of the description; it is better to give the value of the data sheet with --torque-unit"


@dataclass(frozen=True)
class Stated:
    """What the user says; None where it is to be found. torque_unit: (unit, rated torques or constants, one or one a
    joint). torque_times: column that the torques are multiplied with. where: (column, value) of the rows that count.
    sign: of each torque."""

    time: str | None = None
    rate_hz: float | None = None
    position: Sequence[str] | None = None
    torque: Sequence[str] | None = None
    position_unit: str | None = None
    counts_per_rev: float | None = None
    torque_unit: tuple[str, float | Sequence[float] | None] | None = None
    torque_times: str | None = None
    where: tuple[str, float] | None = None
    counts_per_m: float | None = None
    sign: Sequence[int] | None = None


@dataclass(frozen=True)
class Lines:
    """What is told of the torques' signs. reasons: why they are so; doubts: what of it is not sure. unsure: joints,
    from 1, whose sign the log does not determine."""

    reasons: Sequence[str] = ()
    doubts: Sequence[str] = ()
    unsure: Sequence[int] = ()


@dataclass(frozen=True)
class Reading:
    """How the numbers are read. position, torque: keys of a column, but its name. left: of the torque, where it could
    be tried. reasons: why; doubts: what is not sure; of_signs: both, of the torques' signs, which a later choice may
    set anew."""

    position: dict[str, Any]
    torque: dict[str, Any]
    left: Left | None = None
    signs: Sequence[int] = ()
    torque_signs: Sequence[int] = ()
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    of_signs: Lines = Lines()

    @property
    def share(self) -> float:
        """Of the torque, rms, over all joints that move."""
        return float("inf") if self.left is None else self.left.overall


def named(position: Mapping[str, Any]) -> str:
    """A reading of positions in words."""
    unit = position["unit"] if isinstance(position["unit"], str) else ", ".join(position["unit"])
    return f"{unit} of the {'motor' if position.get('side') == 'motor' else 'joint'}"


def scale_of(position: Mapping[str, Any], gear: float | np.ndarray) -> Any:
    """rad (or m) of the joint per unit of a column, or (n,) where the joints' units differ."""
    if "counts_per_m" in position:
        return 1 / position["counts_per_m"]
    if "counts_per_rev" in position:
        scale: Any = 2 * np.pi / position["counts_per_rev"]
    elif isinstance(position["unit"], str):
        scale = POSITION_SCALES[position["unit"]]
    else:
        scale = np.array([POSITION_SCALES[unit] for unit in position["unit"]])
    return scale / gear if position.get("side") == "motor" else scale


class Candidates:
    """What names, units that stand there and ranges let the numbers be."""

    def __init__(
        self, tables: Sequence[Table], channels: Channels, robot: Description | None, rate: float, stated: Stated
    ) -> None:
        self._table, self._channels, self._robot, self._rate = tables[0], channels, robot, rate
        self._stated = stated
        self._values = [np.column_stack([table.columns[name] for name in channels.position]) for table in tables]
        self._gear = robot.gear_ratios[0] if robot else 1.0

    def positions(self, reasons: list[str], doubts: list[str]) -> list[dict[str, Any]]:
        """What the positions may be, first as what they were recorded. An entry whose unit the file contradicts comes
        last.

        Raises:
            DataError: they are increments, and how many make a turn or a metre is not known; or in an unknown unit.
        """
        stated, robot = self._stated, self._robot
        said = self._said(self._channels.position, POSITION_UNITS, stated.position_unit, "--position-unit")
        if len(set(said)) > 1:
            return self._mixed(said, reasons)
        unit = said[0]
        if unit == "counts" or (unit is None and self._integers()):
            return self._increments(reasons)
        if robot is not None and robot.linear:
            return [{"unit": unit}] if unit else [{"unit": "mm" if self._farthest() > 10 else "m"}]
        others = [] if stated.position_unit else [one for one in ("rad", "deg") if one != unit]
        if unit is None and robot is not None and not robot.swings and not robot.travels:
            others.append("turns")  # nothing that is known of the joints tells them from radians
        elif unit is not None:
            others = others if robot is not None and unit in ("rad", "deg") else []
        units = [unit] if unit else []
        every = [entry for one in (*units, *others) for entry in self._sides({"unit": one})]
        if stated.position_unit:
            reasons.append(f"positions are {unit}: given by the user")
            return every
        if unit in ("rad", "turns") and self._integers():
            raise DataError(
                f"{self._table.path}: the file says that positions are {unit}, but they are whole numbers: increments? "
                "Give --position-unit counts and --counts-per-rev, or another --position-unit"
            )
        possible = [e for e in every if self._plausible(scale_of(e, self._gear))] or every[:1]
        if unit is not None and unit == possible[0]["unit"]:
            reasons.append(f"positions are {unit}: the file says so")
        elif unit is not None:
            doubts.append(
                f"positions are assumed to be {named(possible[0])}, although the file says {unit}: no joint moves that "
                "far or that fast; otherwise give --position-unit"
            )
        return possible

    def _said(
        self, names: Sequence[str], known: Mapping[str, str], stated: str | None, option: str
    ) -> list[str | None]:  # fmt: skip
        """The unit of each joint as the user or the file says it.

        Raises:
            DataError: the file says one that is not known.
        """
        if stated is not None:
            return [stated] * len(names)
        for name in names:
            if other := self._table.unknown_unit(name):
                raise DataError(f"{self._table.path}: {name!r} is in {other!r}, an unknown unit: give {option}")
        return [self._table.said_unit(name, known) for name in names]

    def _mixed(self, said: list[str | None], reasons: list[str]) -> list[dict[str, Any]]:
        """Positions of joints that are in several units, as the file says.

        Raises:
            DataError: of some it says none, or they are increments.
        """
        if None in said or "counts" in said:
            listed = ", ".join(f"{n}: {u or 'none'}" for n, u in zip(self._channels.position, said, strict=True))
            raise DataError(f"{self._table.path}: positions have several units ({listed}): give --position-unit")
        reasons.append(f"positions are {', '.join(map(str, said))}: the file says so")
        return self._sides({"unit": said})

    def _increments(self, reasons: list[str]) -> list[dict[str, Any]]:
        stated, robot = self._stated, self._robot
        if stated.counts_per_m is not None or (robot is not None and robot.linear):
            if stated.counts_per_m is None:
                raise DataError(
                    f"{self._table.path}: positions are increments of an axis in m: how many per metre? Give "
                    "--counts-per-m, or --position-unit"
                )
            reasons.append(f"positions are increments, {stated.counts_per_m:g} per metre")
            return [{"unit": "counts", "counts_per_m": stated.counts_per_m}]
        per_turn = stated.counts_per_rev or (robot and robot.counts_per_turn)
        if per_turn is None:
            raise DataError(
                f"{self._table.path}: positions are increments: how many per turn of the encoder? Give "
                "--counts-per-rev, or --position-unit"
            )
        reasons.append(f"positions are increments, {per_turn:g} per turn")
        return self._sides({"unit": "counts", "counts_per_rev": per_turn})

    def _farthest(self) -> float:
        return max(float(np.nanmax(np.abs(values))) for values in self._values)

    def _integers(self) -> bool:
        """Whether positions are increments: many whole numbers, or nothing but whole numbers and more than a few."""
        values = self._values[0][np.isfinite(self._values[0])]
        whole = values == np.round(values)
        if not len(values):
            return False
        many = np.ptp(values) > 1000 and np.mean(whole) > 0.1
        return bool(many or (whole.all() and len(np.unique(values)) > FEW))

    def _plausible(self, scale: float) -> bool:
        """Whether a joint could go so far and so fast."""
        robot = self._robot
        swings = robot is None or robot.swings
        fastest = MAX_SPEED if swings else FASTEST
        most = np.array([] if robot is None else [travel.high - travel.low for travel in robot.travels])
        for values in self._values:
            if np.nanquantile(np.abs(np.diff(values, axis=0)) * scale * self._rate, 0.99) > fastest:
                return False
            if swings and np.nanmax(np.abs(values) * scale) > ANY_JOINT:
                return False
            span = np.nanmax(values, axis=0) - np.nanmin(values, axis=0)
            if len(most) and (span * scale > BEYOND_LIMITS * most).any():
                return False
        return True

    def _sides(self, entry: dict[str, Any]) -> list[dict[str, Any]]:
        """The sides of the gear on which a joint could turn so far."""
        if self._gear == 1.0 or entry["unit"] in LINEAR:
            return [entry]
        both = [entry, entry | {"side": "motor"}]
        if self._robot is not None and not self._robot.swings:
            return both
        farthest = self._farthest()
        return [one for one in both if np.max(farthest * scale_of(one, self._gear)) <= ANY_JOINT] or [entry]

    def torque(self, reasons: list[str], doubts: list[str]) -> tuple[dict[str, Any], bool]:
        """Without a scale where it takes a constant that nobody has said; and whether the unit was said.

        Raises:
            DataError: it takes a constant that only a Delta's masses could tell.
        """
        names = self._channels.torque
        by_masses = self._robot is not None and self._robot.masses_scale_torque
        factor: float | Sequence[float] | None = None
        if self._stated.torque_unit is not None:
            unit, factor = self._stated.torque_unit
        else:
            said = self._said(names, TORQUE_UNITS, None, "--torque-unit")
            if len(set(said)) > 1:
                listed = ", ".join(f"{name}: {one or 'none'}" for name, one in zip(names, said, strict=True))
                raise DataError(f"{self._table.path}: torques have several units ({listed}): give --torque-unit")
            unit = said[0]
            if unit is not None and self._table.kind.startswith("bag"):
                line = f"torques are {unit} by the definition of the message, which not every driver follows"
                currents = any(UR_JOINT in name for name in names)
                (doubts if currents else reasons).append(line + UR_CURRENTS * currents)
            elif unit is not None:
                reasons.append(f"torques are {unit}: the file says so")
            elif all(WORDS["current"] & set(tokens(name)) for name in names):
                unit = "A"
                reasons.append("torques are currents by their names; the unit is assumed to be A")
        told = unit is not None
        if unit is None:
            unit = "N" if self._robot and self._robot.linear else "N m"
            if not by_masses:
                doubts.append(f"torques are assumed to be {unit}: the file does not say")
        entry: dict[str, Any] = {"unit": unit}
        if unit in SHARES:
            entry["rated"] = factor or (self._robot and self._robot.full_scale_nm)
        elif unit in CONSTANTS:
            entry["constant"] = factor
        missing = next((key for key in ("rated", "constant") if key in entry and entry[key] is None), None)
        if missing and not by_masses:
            what = "rated torque" if missing == "rated" else "torque per unit"
            raise DataError(
                f"{self._table.path}: torques are {unit}; the {what} is unknown: give --torque-unit '{unit} NUMBER'"
            )
        return entry, told


def factor_of(torque: Mapping[str, Any]) -> np.ndarray | None:
    """N m (or N) per unit of a column, () or one a joint (n,); None where it is not known."""
    unit = torque["unit"]
    per = TORQUE_SCALES[unit] if unit in TORQUE_SCALES else 1.0 / SHARES[unit]
    keys = [key for key in ("constant", "rated") if key in torque]
    if not keys:
        return np.array(per)
    return None if torque[keys[0]] is None else np.asarray(torque[keys[0]], float) * per


@dataclass(frozen=True)
class _Choice:
    """Of candidates in order: which is taken, the runner-up, how many times likelier (logarithm) the one that is taken
    is, negative where the runner-up is the likelier; and whether that decides."""

    taken: int
    second: int | None
    odds: float
    sure: bool


def choose(found: Sequence[Left]) -> _Choice:
    """The first, but where another is sure to be likelier. A reading that leaves no more than a machine's own effects
    may leave (`SUSPECT`) is never ruled out by another."""
    odds = [log_odds(one, found[0]) for one in found]
    best = int(np.argmax(odds))
    taken = best if odds[best] >= SURE and found[0].overall > SUSPECT else 0
    others = [k for k in range(len(found)) if k != taken]
    if not others:
        return _Choice(taken, None, np.inf, True)
    second = max(others, key=lambda k: odds[k])
    ahead = log_odds(found[taken], found[second])
    return _Choice(taken, second, ahead, ahead >= SURE and found[second].overall > SUSPECT)


def judge(
    robot: Description, runs: Sequence[Run], positions: Sequence[dict[str, Any]],
    torque: dict[str, Any], told: tuple[bool, bool],
) -> Reading:  # fmt: skip
    """The reading that is taken, with what speaks for it.

    runs: positions and torques as they stand in the log. told: whether the positions' unit and that of
    the torques were said by the file or the user.
    """
    way = _WAYS[type(robot)]
    found = [way.read(robot, runs, position, torque, told[1]) for position in positions]
    tried = [one.left or Left(np.array([np.inf]), np.array([0.0])) for one in found]
    choice = choose(tried)
    best = found[choice.taken]
    if len(positions) == 1 and best.position.get("side") == "motor" and best.left is not None:
        best.reasons.append("positions are of the motor: no joint turns that far")
    if len(positions) == 1 and best.position["unit"] == "deg" and not told[0]:
        best.reasons.append("positions are deg: as rad no joint moves that far or that fast")
    if choice.second is not None:
        _tell_choice(best, found[choice.second], choice, told[0], named(positions[0]))
    return way.settle(robot, runs, best, torque)


def _tell_choice(best: Reading, second: Reading, choice: _Choice, told: bool, recorded: str) -> None:
    line = f"positions are {named(best.position)}"
    shares = (
        f"{_percent(best.share)} of the torque remains unexplained on held-out rows, as {named(second.position)} "
        f"{_percent(second.share)}"
    )
    if best.left is None and second.left is None:
        best.doubts.append(f"{line}, as recorded: this log cannot separate it from {named(second.position)}")
    elif choice.taken and told:
        best.doubts.append(f"{line}, although the file says {recorded}: {shares} ({said(choice.odds)} times likelier)")
    elif choice.sure:
        best.reasons.append(f"{line}: {shares} ({said(choice.odds)} times likelier)")
    elif not told or named(second.position).split()[0] == recorded.split()[0]:
        best.doubts.append(f"{line}{'' if choice.taken else ', as recorded'}, but this is ambiguous: {shares}")


def _percent(share: float) -> str:
    return "all" if not np.isfinite(share) or share > 1 else f"{100 * share:.2g} %"


def _of_machine(
    robot: Axes | Chain, runs: Sequence[Run], position: dict[str, Any],
    torque: dict[str, Any], _told: bool,
) -> Reading:  # fmt: skip
    """Signs with which a machine's inertia and friction are not negative, each joint for itself: whatever its unit."""
    count = robot.count
    reading = Reading(position, torque, None, [1] * count, [1] * count)
    try:
        sums = machine_sums(robot, _at_joints(robot, runs, position, torque, reading.signs))
    except RobotError as error:  # an arm without the library that knows what it weighs
        reading.doubts.append(f"units and signs were not checked: {error}")
        return reading
    if sums is None:
        reading.doubts.append("hardly any joint moves: this log does not determine the signs")
        return reading
    signs, odds = _torque_signs(sums, count)
    return replace(reading, left=sums.left(signs), torque_signs=signs, of_signs=_of_signs(odds))


def _of_masses(robot: Chain, runs: Sequence[Run], taken: Reading) -> list[str]:
    """A doubt where the described masses' torque has another size than what was recorded."""
    sums = None
    if taken.left is not None:
        sums = machine_sums(robot, _at_joints(robot, runs, taken.position, taken.torque, taken.signs))
    one = None if sums is None else sums.torque_of_masses(taken.torque_signs)
    if one is None or 1 / SAME <= one <= SAME:
        return []
    return [
        f"according to the masses of the URDF, one unit of torque is {one:.3g} N m at the joint: is the unit or the "
        "constant wrong, or is it the motor's torque?"
    ]


def _at_joints(
    robot: Axes | Chain, runs: Sequence[Run], position: dict[str, Any], torque: dict[str, Any], signs: Sequence[int]
) -> list[Run]:
    """Runs in rad (or m) and N m (or N) of the joints. signs: of the positions."""
    factor = factor_of(torque)
    turned = []
    for run in runs:
        at_joint = run.position * scale_of(position, np.array(robot.gear_ratios)) * np.array(signs)
        if position.get("side") == "motor" and robot.coupling is not None:
            at_joint = at_joint @ np.linalg.inv(robot.motors).T
        scaled = run.torque * (1.0 if factor is None else factor)
        turned.append(replace(run, position=at_joint, torque=scaled))
    return turned


def _torque_signs(sums: MachineSums, count: int) -> tuple[list[int], np.ndarray]:
    """The sign of each joint's torque, and how much likelier (logarithm) the one as recorded is than the other."""
    signs, odds = [1] * count, np.zeros(count)
    for joint in range(count):
        other = [*signs[:joint], -signs[joint], *signs[joint + 1 :]]
        odds[joint] = log_odds(sums.left(signs), sums.left(other))
        if odds[joint] <= -SURE:
            signs = other
    return signs, odds


def _settle_arm(robot: Chain, runs: Sequence[Run], best: Reading, _torque: dict[str, Any]) -> Reading:
    """`best` as an arm's weight and the masses of its URDF settle it."""
    best = _of_arm(robot, runs, best)
    best.doubts.extend(_of_masses(robot, runs, best))
    return best


def _of_arm(robot: Chain, runs: Sequence[Run], best: Reading) -> Reading:
    """With the signs of positions under which an arm's equations hold: its links know up from down. One joint after
    the other, the likeliest first; two at once where none alone is likelier. What leaves much under any is said."""
    if best.left is None or best.left.overall <= FLOOR:
        return best
    recorded, left, flips, signs = best.left, best.left, [1] * robot.count, list(best.torque_signs)
    for _ in range(robot.count):
        for many in (1, 2):
            odds, other, turned, there = _flipped(robot, runs, best, (flips, signs, left), many)
            if odds >= SURE or left.overall <= SUSPECT:
                break
        if odds < SURE:
            break
        flips, signs, left = other, turned, there
    doubts = list(best.doubts)
    if -1 in flips:
        which = named_joints([joint + 1 for joint in range(robot.count) if flips[joint] < 0])
        line = (
            f"with the other sign of the position of {which}, {_percent(left.overall)} of the torque remains "
            f"unexplained, as recorded {_percent(recorded.overall)} ({said(log_odds(left, recorded))} times likelier)"
        )
        if recorded.overall > SUSPECT:
            doubts.append(f"{line}: the other sign is used")
            turned = [joint + 1 for joint in range(robot.count) if signs[joint] < 0]
            lines = Lines([f"the torque of {named_joints(turned)} has the other sign"] if turned else [])
            best = replace(best, left=left, signs=flips, torque_signs=signs, of_signs=lines)
        else:
            doubts.append(f"{line}: the sign is kept as recorded")
    if best.share > POOR:
        doubts.append(
            f"the equations of {robot.name} leave {_percent(best.share)} of the torque unexplained: are unit, "
            "side of the gear, sign, order and zero of the positions right, and does the URDF describe this arm?"
        )
    return replace(best, doubts=doubts)


def _flipped(
    robot: Chain, runs: Sequence[Run], best: Reading, now: tuple[list[int], list[int], Left], many: int
) -> tuple[float, list[int], list[int], Left]:
    """The likeliest of the readings with the other sign of so many more positions: how much likelier (logarithm) than
    that of now, signs of positions and torques, and what it leaves."""
    flips, signs, left = now
    found = [(0.0, flips, signs, left)]
    for joints in combinations(range(robot.count), many):
        other = [-sign if joint in joints else sign for joint, sign in enumerate(flips)]
        sums = machine_sums(robot, _at_joints(robot, runs, best.position, best.torque, other))
        if sums is not None:
            turned, _ = _torque_signs(sums, robot.count)
            there = sums.left(turned)
            found.append((log_odds(there, left), other, turned, there))
    return max(found, key=lambda one: one[0])


def _of_signs(odds: np.ndarray) -> Lines:
    """What is told of the torques' signs. odds: (n,), see `_torque_signs`."""
    open_ones = [joint + 1 for joint in np.flatnonzero(np.abs(odds) < SURE).tolist()]
    reasons = [
        f"axis {joint + 1}: as recorded, the torque pushes against the motion: the other sign is used "
        f"({said(odds[joint])} times likelier)"
        for joint in np.flatnonzero(odds <= -SURE).tolist()
    ]
    doubts = []
    if open_ones:
        most = said(float(odds[np.array(open_ones) - 1].min()))
        likelier = f"; the other is {most} times likelier" if odds[np.array(open_ones) - 1].min() < 0 else ""
        doubts.append(
            f"sign of the torque of {named_joints(open_ones)}: inertia and friction are too small in this log to "
            f"determine it{likelier}; left as recorded, set it with --sign"
        )
    return Lines(reasons, doubts, open_ones)


def _of_delta(
    robot: Robot, runs: Sequence[Run], position: dict[str, Any],
    torque: dict[str, Any], told: bool,
) -> Reading:  # fmt: skip
    """Signs, side and scale with which a Delta's equations explain the torque. told: whether its unit is known."""
    gear = robot.drive.gear_ratio
    factor = factor_of(torque)
    known = factor is not None
    scale, worth = scale_of(position, gear), 1.0 if factor is None else factor
    turned = [replace(run, position=run.position * scale, torque=run.torque * worth) for run in runs]
    ranked = delta_fits(robot, turned, known, told)
    reading = Reading(position, torque, None, AS_GIVEN, AS_GIVEN)
    if not ranked:
        reading.doubts.append(
            f"read as {named(position)}, the positions are not poses of {robot.name}, or hardly change: is the zero or "
            "the geometry wrong?"
        )
        return reading
    given = next((fit for fit in ranked if tuple(fit.signs) == AS_GIVEN), None)
    ordered = ranked if given is None else [given, *(fit for fit in ranked if fit is not given)]
    choice = choose([fit.left for fit in ordered])
    fit = ordered[choice.taken]
    line = f"read like this, the robot's equations leave {_percent(fit.share)} of the torque unexplained"
    if fit.share > HOPELESS:
        reading.doubts.append(f"{line}: this log does not determine signs and gear side")
        return Reading(position, torque, fit.left, AS_GIVEN, AS_GIVEN, [], reading.doubts)
    if choice.sure:
        reading.reasons.append(line)
    else:
        assert choice.second is not None
        reading.doubts.append(
            f"{line}, with other signs of the positions {_percent(ordered[choice.second].share)}: the signs are "
            "uncertain"
        )
    return _scaled(reading, robot, fit, known, told)


def _scaled(reading: Reading, robot: Robot, fit: DeltaFit, known: bool, told: bool) -> Reading:
    """With the torque's signs, side and scale as a fit has them."""
    reasons, doubts = reading.reasons, reading.doubts
    gear, reads, torque = robot.drive.gear_ratio, fit.torque, dict(reading.torque)
    if reads.order != (0, 1, 2):
        order = ", ".join(str(k + 1) for k in reads.order)
        doubts.append(f"the torques fit better in the order {order}: are cables swapped? Set the order with --torque")
        return Reading(reading.position, torque, fit.left, AS_GIVEN, AS_GIVEN, reasons, doubts)
    of_torque, of_position = (
        [f"the {what} of {turned} has the other sign"]
        if (turned := named_joints([j + 1 for j in range(3) if which[j] < 0]))
        else []
        for what, which in (("torque", reads.signs), ("position", fit.signs))
    )
    reasons += of_position
    side = next((s for s in (1.0, gear) if 1 / SAME <= reads.scale / s <= SAME), None) if known else None
    fits = fit.share < SUSPECT and 1 / SAME <= fit.by_masses / reads.scale <= SAME
    if side is None:
        per = SHARES[torque["unit"]] if torque["unit"] in SHARES else 1.0 / TORQUE_SCALES[torque["unit"]]
        unknown = torque if not known else {"unit": "A", "constant": None}
        worth = float(f"{reads.scale * per:.4g}")
        torque = {key: worth if value is None else value for key, value in unknown.items()}
        what = "unit of torque" if known else torque["unit"]
        of_motor = f" ({reads.scale / gear:.4g} N m of the motor)" if gear != 1.0 else ""
        doubts.append(f"one {what} is assumed to be {reads.scale:.4g} N m at the joint{of_motor}, {WHENCE}")
    elif side != 1.0:
        torque["side"] = "motor"
        line = f"torques are of the motor: they fit when multiplied by the gear ratio {gear:g}"
        sure = fits and gear >= NO_ACCIDENT
        (reasons if sure else doubts).append(line if sure else f"{line}; torques in another unit would fit, too")
    elif gear != 1.0 and torque["unit"] in SHARES:  # CiA 402, object 0x6077
        doubts.append(
            f"torques in {torque['unit']} of {torque['rated']:g} N m fit at the joint, and a drive reports those of "
            f"the motor, {gear:g} times less: is the rated torque right?"
        )
    if side is not None and not told:
        why = "; the fit confirms it" if fits else f"; from the masses one unit would be {fit.by_masses / side:.3g} N m"
        why = "; the fit is poor" if fit.share >= SUSPECT else why
        (reasons if fits else doubts).append(f"torques are assumed to be N m: the file does not say{why}")
    elif side is not None and fit.share < SUSPECT and not fits:
        doubts.append(
            f"read as {_unit_in_words(torque)}, the torques are {side / fit.by_masses:.3g} times those that the masses "
            "need: is the gear ratio, the unit or rated torque, or a mass wrong?"
        )
    signs = [int(sign) for sign in reads.signs]
    return Reading(reading.position, torque, fit.left, fit.signs, signs, reasons, doubts, Lines(of_torque))


def _unit_in_words(torque: Mapping[str, Any]) -> str:
    """The unit of torques in words, with what one of it stands for."""
    if (rated := torque.get("rated")) is not None:
        return f"{torque['unit']} of {rated:g} N m"
    constant = torque.get("constant")
    return torque["unit"] if constant is None else f"{torque['unit']} with {constant:g} N m per {torque['unit']}"


def _doubt_gear(robot: Robot | Axes, runs: Sequence[Run], best: Reading, torque: dict[str, Any]) -> Reading:
    """`best`, with a doubt where another gear ratio, or another number of increments, is sure to be likelier than that
    described."""
    turns = best.position.get("side") == "motor" or "counts_per_rev" in best.position
    if best.left is None or not turns or best.share < FLOOR:
        return best
    for times in OFTEN_WRONG:
        other = [replace(run, position=run.position / times) for run in runs]
        there = _WAYS[type(robot)].read(robot, other, best.position, torque, True)
        if there.left is None or there.share > HOPELESS:  # it explains as little
            continue
        if log_odds(there.left, best.left) >= SURE:
            best.doubts.append(
                f"with {times:g} times the gear ratio or increments per turn, {_percent(there.share)} of the torque "
                f"would remain unexplained instead of {_percent(best.share)}: are they right?"
            )
            break
    return best


class _Way(NamedTuple):
    """How a kind of machine judges a reading of its log. read: (description, runs, position, torque, whether its unit
    was said) to what that leaves. settle: (description, runs, the likeliest reading, torque as recorded) to the final
    one."""

    read: Callable[[Any, Sequence[Run], dict[str, Any], dict[str, Any], bool], Reading]
    settle: Callable[[Any, Sequence[Run], Reading, dict[str, Any]], Reading]


_WAYS: dict[type, _Way] = {  # a line a kind
    Robot: _Way(_of_delta, _doubt_gear),
    Axes: _Way(_of_machine, _doubt_gear),
    Chain: _Way(_of_machine, _settle_arm),
}
