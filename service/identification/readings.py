"""Which reading of a foreign log's numbers: what they may be (candidates), how well each goes with the machine
(evidence, see there), and which is taken.

The first candidate is the log as it was recorded. Another is taken where it is `SURE` to be likelier; where nothing is
sure the log stays as recorded and it is said that it could not be told.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drivers.trace.quality import ANY_JOINT, MAX_SPEED
from drivers.trace.tables import Table
from schemas.axes import Description
from schemas.chain import Chain
from schemas.diagnosis import named_joints
from schemas.errors import DataError, RobotError
from schemas.machine import Machine
from schemas.robot import Robot
from service.identification.channels import POSITION_UNITS, TORQUE_UNITS, Channels, said_unit
from service.identification.checks import SUSPECT
from service.identification.evidence import (
    AS_GIVEN,
    FLOOR,
    SURE,
    DeltaFit,
    Left,
    Run,
    delta_fits,
    log_odds,
    machine_sums,
    said,
)

HOPELESS = 0.5  # share of the torque left, from which nothing can be said
SAME = 1.25  # factor within which a torque's scale goes with the masses of the description
NO_ACCIDENT = 4.0  # gear ratio that no torque is off by for another reason, such as half of it being recorded
FASTEST = 1000.0  # rad/s, of a motor's own axis: no servo motor turns faster
BEYOND_LIMITS = 1.2  # times the span of a URDF's limits
FEW = 8  # different whole numbers: more, and nothing but these, are increments
OFTEN_WRONG = 0.25, 0.5, 2.0, 4.0  # times that a gear ratio or a number of increments is wrong
UR_JOINT = "shoulder_pan_joint"
UR_CURRENTS = ": that of Universal Robots publishes currents as effort; --torque-unit 'A CONSTANT,CONSTANT,...'"
SCALES = {"rad": 1.0, "deg": np.pi / 180, "turns": 2 * np.pi, "m": 1.0, "mm": 1e-3}
WHENCE = "by the masses of the description; the data sheet is better: --torque-unit"


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
class Reading:
    """How the numbers are read. position, torque: keys of a column, but its name. told: why; doubts: what is not sure.
    left: of the torque, where it could be tried."""

    position: dict[str, Any]
    torque: dict[str, Any]
    left: Left | None = None
    signs: Sequence[int] = ()
    torque_signs: Sequence[int] = ()
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Of the torque, rms, over all joints that move."""
        if self.left is None or not self.left.pieces.any():
            return float("inf")
        return float(np.sqrt(np.average(self.left.share**2, weights=self.left.pieces)))


def named(position: Mapping[str, Any]) -> str:
    """A reading of positions in words."""
    return f"{position['unit']} of the {'motor' if position.get('side') == 'motor' else 'joint'}"


def scale_of(position: Mapping[str, Any], gear: float | np.ndarray) -> Any:
    """rad (or m) of the joint per unit of a column."""
    if "counts_per_m" in position:
        return 1 / position["counts_per_m"]
    scale = 2 * np.pi / position["counts_per_rev"] if "counts_per_rev" in position else SCALES[position["unit"]]
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

    def positions(self, reasons: list[str]) -> list[dict[str, Any]]:
        """What the positions may be, first as what they were recorded. An entry whose unit the file contradicts comes
        last.

        Raises:
            DataError: they are increments, and how many make a turn or a metre is not known.
        """
        stated, robot = self._stated, self._robot
        unit = stated.position_unit or said_unit(self._table, self._channels.position[0], POSITION_UNITS)
        counts = unit == "counts" or (unit is None and self._integers())
        if counts and (stated.counts_per_m is not None or (robot is not None and robot.linear)):
            if stated.counts_per_m is None:
                raise DataError(
                    f"{self._table.path}: positions are increments, of an axis in m; how many make a metre? say "
                    "--counts-per-m, or --position-unit"
                )
            reasons.append(f"positions are increments, {stated.counts_per_m:g} a metre")
            return [{"unit": "counts", "counts_per_m": stated.counts_per_m}]
        if counts:
            per_turn = stated.counts_per_rev or _counts(robot)
            if per_turn is None:
                raise DataError(
                    f"{self._table.path}: positions are increments; how many make a turn of the encoder's shaft? "
                    "say --counts-per-rev, or --position-unit"
                )
            reasons.append(f"positions are increments, {per_turn:g} a turn")
            return self._sides({"unit": "counts", "counts_per_rev": per_turn})
        if robot is not None and robot.linear:
            return [{"unit": unit}] if unit else [{"unit": "mm" if self._farthest() > 10 else "m"}]
        others = [] if stated.position_unit else [one for one in ("rad", "deg") if one != unit]
        if unit is not None:
            reasons.append(f"positions are {unit}: " + ("told" if stated.position_unit else "it stands there"))
            others = others if robot is not None and unit in ("rad", "deg") else []
        units = [unit] if unit else []
        every = [entry for one in (*units, *others) for entry in self._sides({"unit": one})]
        if stated.position_unit:
            return every
        return [e for e in every if self._plausible(scale_of(e, self._gear))] or every[:1]

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
        delta = isinstance(self._robot, Robot) or self._robot is None
        fastest = MAX_SPEED if delta else FASTEST
        limits = np.array([high - low for low, high in self._robot.arm.limits]) if isinstance(self._robot, Chain) else 0
        for values in self._values:
            if np.nanquantile(np.abs(np.diff(values, axis=0)) * scale * self._rate, 0.99) > fastest:
                return False
            if delta and np.nanmax(np.abs(values)) * scale > ANY_JOINT:
                return False
            span = np.nanmax(values, axis=0) - np.nanmin(values, axis=0)
            if isinstance(self._robot, Chain) and (span * scale > BEYOND_LIMITS * limits).any():
                return False
        return True

    def _sides(self, entry: dict[str, Any]) -> list[dict[str, Any]]:
        """The sides of the gear on which a joint could turn so far."""
        if self._gear == 1.0 or "m" in entry["unit"]:
            return [entry]
        both = [entry, entry | {"side": "motor"}]
        if isinstance(self._robot, Machine):
            return both
        farthest = self._farthest()
        return [one for one in both if farthest * scale_of(one, self._gear) <= ANY_JOINT] or [entry]

    def torque(self, reasons: list[str], doubts: list[str]) -> tuple[dict[str, Any], bool]:
        """Without a scale where it takes a constant that nobody has said; and whether the unit was said.

        Raises:
            DataError: it takes a constant that only a Delta's masses could tell.
        """
        if self._stated.torque_unit is not None:
            unit, factor = self._stated.torque_unit
        else:
            unit, factor = said_unit(self._table, self._channels.torque[0], TORQUE_UNITS), None
            if unit is not None and self._table.kind.startswith("bag"):
                line = f"torques are {unit} by the definition of the message, which not every driver keeps to"
                currents = any(UR_JOINT in name for name in self._channels.torque)
                (doubts if currents else reasons).append(line + UR_CURRENTS * currents)
            elif unit is not None:
                reasons.append(f"torques are {unit}: it stands there")
        told = unit is not None
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
        return entry, told


def _counts(robot: Description | None) -> float | None:
    drives = robot.drive.joint if isinstance(robot, Robot) else None
    return float(drives[0].counts_per_turn) if drives else None


def _rated(robot: Description | None) -> float | None:
    drives = robot.drive.joint if isinstance(robot, Robot) else None
    return float(drives[0].torque.full_scale_nm) if drives else None


def factor_of(torque: Mapping[str, Any]) -> np.ndarray | None:
    """N m (or N) per unit of a column, () or one a joint (n,); None where it is not known."""
    per = {"percent": 100.0, "permille": 1000.0}.get(torque["unit"], 1.0)
    keys = [key for key in ("constant", "rated") if key in torque]
    if not keys:
        return np.array(1.0)
    return None if torque[keys[0]] is None else np.asarray(torque[keys[0]], float) / per


@dataclass(frozen=True)
class _Choice:
    """Of candidates in order: which is taken, the runner-up, and how many times likelier (logarithm) the one that is
    taken is; negative where the runner-up is the likelier and not sure enough."""

    taken: int
    second: int | None
    odds: float

    @property
    def sure(self) -> bool:
        return self.odds >= SURE


def choose(found: Sequence[Left]) -> _Choice:
    """The first, but where another is sure to be likelier."""
    odds = [log_odds(one, found[0]) for one in found]
    best = int(np.argmax(odds))
    taken = best if odds[best] >= SURE else 0
    others = [k for k in range(len(found)) if k != taken]
    if not others:
        return _Choice(taken, None, np.inf)
    second = max(others, key=lambda k: odds[k])
    return _Choice(taken, second, log_odds(found[taken], found[second]))


def judge(
    robot: Description, runs: Sequence[Run], positions: Sequence[dict[str, Any]],
    torque: dict[str, Any], told: tuple[bool, bool],
) -> Reading:  # fmt: skip
    """The reading that is taken, with what speaks for it.

    runs: positions and torques as they stand in the log. told: whether the positions' unit and that of
    the torques were said by the file or the user.
    """
    if isinstance(robot, Robot):
        found = [_of_delta(robot, runs, position, torque, told[1]) for position in positions]
    else:
        found = [_of_machine(robot, runs, position, torque) for position in positions]
    tried = [one.left or Left(np.array([np.inf]), np.array([0.0])) for one in found]
    choice = choose(tried)
    best = found[choice.taken]
    if len(positions) == 1 and best.position.get("side") == "motor" and best.left is not None:
        best.reasons.append("positions are the motor's: no joint turns so far")
    if choice.second is not None:
        _tell_choice(best, found[choice.second], choice, told[0], named(positions[0]))
    if isinstance(robot, Robot):
        _doubt_gear(robot, runs, best, torque)
    return best


def _tell_choice(best: Reading, second: Reading, choice: _Choice, told: bool, recorded: str) -> None:
    line = f"positions are {named(best.position)}"
    shares = (
        f"{_percent(best.share)} of the torque is left on rows left out, read as {named(second.position)} "
        f"{_percent(second.share)}"
    )
    if best.left is None and second.left is None:
        best.doubts.append(f"{line}, as recorded: nothing in this log tells {named(second.position)} from it")
    elif choice.taken and told:
        best.doubts.append(f"{line}, though the file says {recorded}: {shares} ({said(choice.odds)} times likelier)")
    elif choice.sure:
        best.reasons.append(f"{line}: {shares} ({said(choice.odds)} times likelier)")
    elif not told or named(second.position).split()[0] == recorded.split()[0]:
        best.doubts.append(f"{line}{'' if choice.taken else ', as recorded'}, and it cannot be told: {shares}")


def _percent(share: float) -> str:
    return "all" if not np.isfinite(share) or share > 1 else f"{100 * share:.2g} %"


def _of_machine(
    robot: Description, runs: Sequence[Run], position: dict[str, Any],
    torque: dict[str, Any],
) -> Reading:  # fmt: skip
    """Signs with which a machine's inertia and friction are not negative, each joint for itself."""
    assert not isinstance(robot, Robot)
    count = robot.count
    reading = Reading(position, torque, None, [1] * count, [1] * count)
    gear = np.array(robot.gear_ratios)
    factor = factor_of(torque)
    turned = []
    for run in runs:
        at_joint = run.position * scale_of(position, gear)
        if position.get("side") == "motor" and robot.coupling is not None:
            at_joint = at_joint @ np.linalg.inv(robot.motors).T
        scaled = run.torque * (1.0 if factor is None else factor)
        turned.append(replace(run, position=at_joint, torque=scaled))
    try:
        sums = machine_sums(robot, turned)
    except RobotError as error:  # an arm without the library that knows what it weighs
        reading.doubts.append(f"units and signs are not checked: {error}")
        return reading
    if sums is None:
        reading.doubts.append("hardly anything moves: signs cannot be told from this log")
        return reading
    signs, odds = [1] * count, np.zeros(count)
    for joint in range(count):
        other = [*signs[:joint], -signs[joint], *signs[joint + 1 :]]
        odds[joint] = log_odds(sums.left(signs), sums.left(other))
        if odds[joint] <= -SURE:
            signs = other
    _tell_signs(reading, odds)
    one = sums.torque_of_masses(signs)
    if one is not None and not 1 / SAME <= one <= SAME:
        reading.doubts.append(
            f"by the masses of the URDF one unit of torque is {one:.3g} N m of the joint: unit, constant, or the "
            "motor's side?"
        )
    return Reading(position, torque, sums.left(signs), [1] * count, signs, reading.reasons, reading.doubts)


def _tell_signs(reading: Reading, odds: np.ndarray) -> None:
    open_ones = [joint + 1 for joint in np.flatnonzero(np.abs(odds) < SURE).tolist()]
    for joint in np.flatnonzero(odds <= -SURE).tolist():
        reading.reasons.append(
            f"axis {joint + 1}: the torque pushes against the motion: the other sign ({said(odds[joint])} times "
            "likelier)"
        )
    if open_ones:
        most = said(float(odds[np.array(open_ones) - 1].min()))
        likelier = f"; the other is {most} times likelier" if odds[np.array(open_ones) - 1].min() < 0 else ""
        reading.doubts.append(
            f"sign of the torque of {named_joints(open_ones)}: neither inertia nor friction shows enough of itself to "
            f"tell it{likelier}; left as recorded, --sign says it"
        )


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
            f"read as {named(position)} the positions are no poses of {robot.name}, or hardly move: zero or geometry?"
        )
        return reading
    given = next((fit for fit in ranked if tuple(fit.signs) == AS_GIVEN), None)
    ordered = ranked if given is None else [given, *(fit for fit in ranked if fit is not given)]
    choice = choose([fit.left for fit in ordered])
    fit = ordered[choice.taken]
    line = f"with these readings the robot's equations leave {_percent(fit.share)} of the torque"
    if fit.share > HOPELESS:
        reading.doubts.append(f"{line}: signs and gear side cannot be told from this log")
        return Reading(position, torque, fit.left, AS_GIVEN, AS_GIVEN, [], reading.doubts)
    if choice.sure:
        reading.reasons.append(line)
    else:
        assert choice.second is not None
        reading.doubts.append(
            f"{line}, with other signs of the positions {_percent(ordered[choice.second].share)}: signs are not certain"
        )
    return _scaled(reading, robot, fit, known, told)


def _scaled(reading: Reading, robot: Robot, fit: DeltaFit, known: bool, told: bool) -> Reading:
    """With the torque's signs, side and scale as a fit has them."""
    reasons, doubts = reading.reasons, reading.doubts
    gear, reads, torque = robot.drive.gear_ratio, fit.torque, dict(reading.torque)
    if reads.order != (0, 1, 2):
        order = ", ".join(str(k + 1) for k in reads.order)
        doubts.append(f"the torques fit better in the order {order}: cables swapped? --torque says it otherwise")
        return Reading(reading.position, torque, fit.left, AS_GIVEN, AS_GIVEN, reasons, doubts)
    for what, which in (("torque", reads.signs), ("position", fit.signs)):
        turned = named_joints([j + 1 for j in range(3) if which[j] < 0])
        if turned:
            reasons.append(f"the {what} of {turned} has the other sign")
    side = next((s for s in (1.0, gear) if 1 / SAME <= reads.scale / s <= SAME), None) if known else None
    fits = fit.share < SUSPECT and 1 / SAME <= fit.by_masses / reads.scale <= SAME
    if side is None:
        per = {"percent": 100.0, "permille": 1000.0}.get(torque["unit"], 1.0)
        unknown = torque if not known else {"unit": "A", "constant": None}
        worth = float(f"{reads.scale * per:.4g}")
        torque = {key: worth if value is None else value for key, value in unknown.items()}
        what = "unit of torque" if known else torque["unit"]
        doubts.append(f"one {what} taken as {reads.scale:.4g} N m, {WHENCE}")
    elif side != 1.0:
        torque["side"] = "motor"
        line = f"torques are the motor's: times the gear of {gear:g} they fit"
        sure = fits and gear >= NO_ACCIDENT
        (reasons if sure else doubts).append(line if sure else f"{line}; so would torques in another unit")
    if side is not None and not (told and fits):
        why = "; the fit goes with it" if fits else f", and by the masses one would be {fit.by_masses / side:.3g} N m"
        why = ", and the fit is poor" if fit.share >= SUSPECT else why
        said_so = f"torques taken as N m: nothing says so{why}" if not told else f"torques are said to be N m{why}"
        if not told or fit.share < SUSPECT:
            (reasons if fits else doubts).append(said_so)
    signs = [int(sign) for sign in reads.signs]
    return Reading(reading.position, torque, fit.left, fit.signs, signs, reasons, doubts)


def _doubt_gear(robot: Robot, runs: Sequence[Run], best: Reading, torque: dict[str, Any]) -> None:
    """Say where another gear ratio, or another number of increments, is sure to be likelier than that described."""
    turns = best.position.get("side") == "motor" or "counts_per_rev" in best.position
    if best.left is None or not turns or best.share < FLOOR:
        return
    for times in OFTEN_WRONG:
        other = [replace(run, position=run.position / times) for run in runs]
        there = _of_delta(robot, other, best.position, torque, True)
        if there.left is not None and log_odds(there.left, best.left) >= SURE:
            best.doubts.append(
                f"with {times:g} times the gear ratio, or increments a turn, {_percent(there.share)} of the torque "
                f"would be left, not {_percent(best.share)}: are they right?"
            )
            return
