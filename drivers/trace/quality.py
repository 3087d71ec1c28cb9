"""What is wrong with recorded samples: found, counted, flagged. Nothing here changes a value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.axes_description import Description
from schemas.columns import implausible_rate
from schemas.errors import TraceError
from schemas.messages import SampleFlag
from schemas.robot import Geometry, Travel
from schemas.trace import Finding, Trace
from schemas.words import counted

EXACT_SECONDS = 1_000_000  # float64 seconds below this hold a nanosecond
GAP_PERIODS = 1.5  # a step of the stamps above this many periods has lost cycles
MAX_SPEED = 60.0  # rad/s at the joint of a Delta; fast ones reach about 20
# A servo motor's own axis turns at hundreds; faster than that is the log's motion or a burst in slow turns.
BURST = 3.0  # times the speed that 95 % of the samples keep below
MAX_ACCELERATION = 1e4  # rad/s^2 or m/s^2; fast Delta robots reach about 2e3 rad/s^2
NOISE_SIGMAS = 15.0  # a jump stands this far out of the velocity's own noise
ANY_JOINT = np.pi  # rad; no joint of a Delta turns further, whatever its robot's range
UNUSABLE_SHARE = 0.1  # of all samples beyond ANY_JOINT: the unit is wrong, not the sample
BEYOND_LIMITS = 1.2  # times the span of a URDF's limits, which are often drawn narrower than the stops
LARGEST = 1e12  # rad, m, N m or N: no reading of any machine
SHOWN = 5  # rows named in a message


@dataclass(frozen=True)
class RowNames:
    """How the rows of a trace are called in its file: `line 17` of a CSV, `message 17` of an MCAP."""

    word: str
    numbers: np.ndarray

    def name(self, rows: np.ndarray) -> str:
        """The first few of `rows`, as a reader of the file would look for them."""
        shown = ", ".join(str(n) for n in self.numbers[rows[:SHOWN]])
        plural = "s" if len(rows) > 1 else ""
        return f"{self.word}{plural} {shown}{', ...' if len(rows) > SHOWN else ''}"


def check(trace: Trace, rows: RowNames, robot: Description | None) -> Trace:
    """`trace` with every flag set and every finding added.

    Joint angles are held against the range of `robot`, without one against that of Delta robots in general.

    Raises:
        TraceError: not of as many joints, of the same kind, as described; fewer than two samples, stamps that mostly do
            not rise, or positions mostly outside the joint range.
    """
    if robot is not None:
        _as_described(trace, robot)
    if len(trace) < 2:
        raise TraceError(f"{trace.path}: {counted(len(trace), 'sample')}, at least 2 are needed")
    flags = np.zeros(len(trace), np.uint32) if len(trace.flags) == 0 else trace.flags.copy()
    findings = list(trace.findings)
    for finding in (*_stamps(trace, rows), *_values(trace, rows, robot), *_range(trace, rows, robot)):
        flags[finding.rows] |= np.uint32(finding.flag)
        findings.append(finding)
    return replace(trace, flags=flags, findings=tuple(findings))


def _as_described(trace: Trace, robot: Description) -> None:
    found = trace.position.shape[1]
    if found != robot.count:
        hint = robot.at_rest if found < robot.count else ""
        raise TraceError(f"{trace.path}: {counted(found, 'joint')}, {robot.name} is described with {robot.count}{hint}")
    if trace.angular != robot.angular:
        raise TraceError(
            f"{trace.path}: {'no' if trace.angular else 'an'} axis in m, {robot.name} is described otherwise"
        )


def _stamps(trace: Trace, rows: RowNames) -> Iterator[Finding]:
    step = np.diff(trace.time)
    rising = step > 0
    if np.count_nonzero(rising) < 0.5 * len(step):
        bad = np.flatnonzero(~rising)[:1] + 1
        raise TraceError(
            f"{trace.path}: time does not rise from row to row ({np.count_nonzero(~rising)} of {len(step)} steps; "
            f"first at {rows.name(bad)}: {trace.time[bad[0] - 1]:.9g} s, then {trace.time[bad[0]]:.9g} s)"
        )
    period = float(np.median(step[rising]))
    ahead = trace.time[1:] - np.maximum.accumulate(trace.time)[:-1]  # a step back makes no gap where time catches up
    back, repeated, gap = (np.flatnonzero(s) + 1 for s in (step < 0, step == 0, ahead > GAP_PERIODS * period))
    sequenced = None if trace.sequence is None else np.diff(trace.sequence.astype(np.int64))
    if sequenced is not None:
        gap = np.union1d(gap, np.flatnonzero(sequenced > 1) + 1)
        repeated = np.union1d(repeated, np.flatnonzero(sequenced == 0) + 1)
    if note := implausible_rate(period):
        yield Finding.note(note)
    if len(back):
        i = back[0]
        yield Finding(
            SampleFlag.TIME_BACKWARDS,
            f"time goes back {counted(len(back), 'time')}: {rows.name(back)} "
            f"({trace.time[i]:.9g} s after {trace.time[i - 1]:.9g} s)",
            back,
        )
    if len(repeated):
        yield Finding(
            SampleFlag.REPEATED,
            f"stamp or sequence number repeated {counted(len(repeated), 'time')}: {rows.name(repeated)} "
            f"({trace.time[repeated[0]]:.9g} s)",
            repeated,
        )
    if len(gap):
        lost = np.maximum(np.rint(ahead[gap - 1] / period) - 1, 0)
        if sequenced is not None:
            lost = np.maximum(lost, sequenced[gap - 1] - 1)
        cycles = "1 cycle" if lost.sum() == 1 else f"{lost.sum():.9g} cycles"  # of a stamp that is garbage: 1e150
        yield Finding(
            SampleFlag.GAP_BEFORE,
            f"{counted(len(gap), 'gap')}, {cycles} of {period * 1e3:.6g} ms missing: "
            f"before {rows.name(gap)} (longest {ahead[gap - 1].max() * 1e3:.6g} ms)",
            gap,
        )


def _values(trace: Trace, rows: RowNames, robot: Description | None) -> Iterator[Finding]:
    for name, values, flag in (
        ("position", trace.position, SampleFlag.NOT_A_NUMBER),
        ("torque", trace.torque, SampleFlag.NOT_A_NUMBER),
        ("position_command", trace.position_command, SampleFlag.NO_COMMAND),
        ("torque_command", trace.torque_command, SampleFlag.NO_COMMAND),
    ):
        if values is None:
            continue
        for joint in range(values.shape[1]):
            bad = np.flatnonzero(~(np.abs(values[:, joint]) <= LARGEST))
            if len(bad):
                what = f"{name} of joint {joint + 1}: {counted(len(bad), 'value')} missing or not finite"
                yield Finding(flag, f"{what}: {rows.name(bad)} ({values[bad[0], joint]})", bad)
    yield from _commanded(trace)
    yield from _jumps(trace, rows, 0.0 if robot is None or robot.swings else BURST)


def _commanded(trace: Trace) -> Iterator[Finding]:
    if trace.torque_command is None:
        return
    for joint, (torque, command) in enumerate(zip(trace.torque.T, trace.torque_command.T, strict=True), start=1):
        if np.ptp(torque) > 0 and np.array_equal(torque, command):
            message = f"torque of joint {joint} equals its torque_command to the last digit: it was not measured"
            yield Finding.note(message)


def _jumps(trace: Trace, rows: RowNames, burst: float) -> Iterator[Finding]:
    """burst: times the log's own speed that is believed beyond `MAX_SPEED`."""
    step = np.diff(trace.time)
    period = float(np.median(step[step > 0]))
    step = np.maximum(step, period)[:, None]  # repeated or falling stamps: one cycle has passed at least
    with np.errstate(invalid="ignore", over="ignore"):
        speed = np.diff(trace.position, axis=0) / step
    unknown = ~np.isfinite(speed)
    speed = np.where(unknown, 0.0, speed)
    beside = np.pad(speed, ((2, 2), (0, 0)), "symmetric")
    away = np.abs(speed - _middle(*(beside[late : late + len(speed)] for late in range(5))))
    noise = 1.4826 * np.median(away, axis=0)
    fastest = np.maximum(MAX_SPEED, burst * np.percentile(np.abs(speed), 95, axis=0))
    jumped = (np.abs(speed) > fastest) | (away > 2 * MAX_ACCELERATION * step + NOISE_SIGMAS * noise)
    for joint in range(speed.shape[1]):
        bad = np.flatnonzero(jumped[:, joint] & ~unknown[:, joint]) + 1
        if len(bad):
            before, after = trace.position[bad[0] - 1 : bad[0] + 1, joint]
            yield Finding(
                SampleFlag.JUMP,
                f"position of joint {joint + 1} jumps {counted(len(bad), 'time')}, further in one cycle than a joint "
                f"can: {rows.name(bad)} (from {before:.6g} to {after:.6g})",
                bad,
            )


def _middle(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, e: np.ndarray) -> np.ndarray:
    """The median of five, entry by entry: by comparisons of whole arrays, an eighth of the time of `np.median`."""
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))  # at least two of the four are no more
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(e, np.maximum(low, high)))


def _spans(trace: Trace, travels: Sequence[Travel]) -> None:
    """
    Raises:
        TraceError: a joint moves further than it is said to between its ends.
    """
    for joint, (low, high, stated) in enumerate(travels):
        least, most = np.nanmin(trace.position[:, joint]), np.nanmax(trace.position[:, joint])
        if most - least > BEYOND_LIMITS * (high - low):
            degrees = np.radians(most - least) <= high - low
            hint = "degrees for radians" if degrees else "a wrong unit or gear ratio"
            raise TraceError(
                f"{trace.path}: position of joint {joint + 1} goes from {least:.4g} to {most:.4g} rad, "
                f"{stated} from {low:.4g} to {high:.4g} rad: {hint}?"
            )


def _range(trace: Trace, rows: RowNames, robot: Description | None) -> Iterator[Finding]:
    if robot is not None:
        _spans(trace, robot.travels)
        between = robot.joint_range
    else:
        of_delta = trace.position.shape[1] == 3
        between = Geometry.model_fields["joint_range_rad"].default if of_delta else None
    if between is None or not trace.angular:
        return
    low, high = between
    for joint in range(trace.position.shape[1]):
        position = trace.position[:, joint]
        bad = np.flatnonzero((position < low) | (position > high))
        if len(bad) == 0:
            continue
        span = f"{np.nanmin(position):.6g} to {np.nanmax(position):.6g} rad, joint range {low:.4g} to {high:.4g} rad"
        impossible = np.flatnonzero(np.abs(position) > ANY_JOINT)
        if len(impossible) > UNUSABLE_SHARE * len(position):
            degrees = np.mean((np.radians(position) >= low) & (np.radians(position) <= high)) > 0.95
            hint = "degrees for radians" if degrees else "a wrong unit, gear ratio, sign or zero"
            raise TraceError(
                f"{trace.path}: position of joint {joint + 1}: {len(bad)} of {len(position)} samples out of range, "
                f"{hint}? ({span}; first at {rows.name(bad[:1])}: {position[bad[0]]:.6g}); state the unit in [columns]"
            )
        yield Finding(
            SampleFlag.OUT_OF_RANGE,
            f"position of joint {joint + 1}: {counted(len(bad), 'sample')} out of range: {rows.name(bad)} ({span})",
            bad,
        )
