"""The gap as motion: how far simulated robots are from a log after a while under its torque.

A log is cut into windows. Each starts in the smoothed measured state with the mass on the platform that the log tells,
and is driven by the recorded torque alone; what is compared is the angle that the encoders would give, and the platform
that follows from it. The floor is what the same robot does when only the noise of the torque and of the start state is
laid over its own run.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from schemas.diagnosis import named_joints
from schemas.errors import DataError, NoWindowError, PoseError, TraceError
from schemas.robot import Robot, Servo
from schemas.trace import Trace
from service.estimator.bounds import bounds_of
from service.identification.noise import white_noise
from service.identification.weighed_picks import carried
from service.model import kinematics
from service.model.description import hypothesis_of
from service.model.dynamics import REST_SPEED
from service.model.mechanism import Delta
from service.model.nominal import DeltaModel
from service.model.scene import Recording
from service.model.signals import EDGE, LONGEST_STEP, Segment, one_period, segments_of, smooth
from service.model.torque import predict
from service.rollout.kernel import NO_DRIVES, SCRATCH, Drives, Pace, Runs, run_kernel
from service.rollout.packed import SeenStretch, stretch
from service.rollout.servo import commands_of, gains_of, identified

HORIZON = 0.2  # s
SHORTEST, LONGEST = 0.01, 5.0  # s of horizon that make sense
DRAWS = 4  # runs with noise a window, for the floor
SEED = 2026
PLAIN = "plain"
SLOW_SHARE = 0.5  # of a joint's rms speed, below which a window is slow for it
PARTS = ("angle", "platform", "path", "torque")  # of a `Deviation`, in its order
REGIMES = ("at rest", "reversal", "slow", "fast")
ASTRAY = 0.5  # of the way, from which a sign is asked for; one joint turned round leaves nine tenths of it
TURNED = 0.5  # share of the error that is left with the torque turned round, if its sign is wrong


@dataclass(frozen=True)
class Deviation:
    """One robot over W windows of S samples: angles (W, S, 3) rad, platform (W, S, 3) m and torque (W, S, 3) N m, each
    simulated less measured; NaN from where a run left the workspace. path: (W, S) m that the measured platform is from
    its start."""

    name: str
    angle: np.ndarray
    platform: np.ndarray
    path: np.ndarray
    torque: np.ndarray

    @property
    def torque_nm(self) -> np.ndarray:
        """(3,) rms over the windows."""
        return rms(self.torque[self.good].reshape(-1, 3))

    @property
    def good(self) -> np.ndarray:
        """(W,) windows that came to their end."""
        return np.isfinite(self.platform[:, -1, 0])

    @property
    def path_mm(self) -> float:
        """Rms way of the measured platform to the horizon: what a robot that stands still is off."""
        return 1e3 * float(rms(self.path[np.isfinite(self.path[:, -1]), -1]))

    @property
    def joint_mrad(self) -> np.ndarray:
        """(3,) rms at the horizon."""
        return 1e3 * rms(self.angle[self.good, -1])

    @property
    def platform_mm(self) -> float:
        """Rms distance at the horizon."""
        return 1e3 * float(np.sqrt(3.0) * rms(self.platform[self.good, -1].ravel()))

    @cached_property
    def growth_mm(self) -> np.ndarray:
        """(S,) rms distance of the platform."""
        return 1e3 * np.sqrt(np.mean(np.sum(self.platform[self.good] ** 2, axis=2), axis=0))


@dataclass(frozen=True)
class Windows:
    """W windows of a part: first samples (W,), how many samples each has, what is carried, (N,) kg, NaN where it cannot
    be told, and what drives the robot in them: the recorded torque, or drives."""

    segment: Segment
    starts: np.ndarray
    samples: int
    mass: np.ndarray
    drives: Drives = NO_DRIVES

    @property
    def payload(self) -> np.ndarray:
        """(W,) kg, one mass a window."""
        return self.mass[self.starts]

    def cut(self, values: np.ndarray) -> np.ndarray:
        """(W, S, ...) of (N, ...)."""
        return values[self.starts[:, None] + np.arange(self.samples)]

    def run(self, seen: SeenStretch, start: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles rad and torque N m, (W, S, 3) each, from `start` (W, 5, 3). torque: (N, 3) N m, of which the drives
        take the first in a window."""
        runs = Runs(start, self.cut(torque), self.payload, self.segment.time[self.starts])
        return run(seen, runs, self.segment.period, self.drives)


@dataclass(frozen=True)
class Interruption:
    """Where `run` has no samples that are of use, or none at all: s of its own clock."""

    run: str
    start: float
    stop: float


@dataclass(frozen=True)
class Cuts:
    """Logs in windows, a part without a fault each. period, horizon: s. untold: s left out as it could not be told what
    is carried. seconds: of the logs. lost: windows that `interruptions` cost."""

    parts: list[tuple[Trace, Windows]]
    period: float
    horizon: float
    untold: float
    seconds: float
    interruptions: list[Interruption]
    lost: int

    @cached_property
    def runs(self) -> list[str]:
        """(W,) log of each window."""
        return [trace.name for trace, cut in self.parts for _ in cut.starts]

    @cached_property
    def payload(self) -> np.ndarray:
        """(W,) kg that hangs on all robots, as the last of them weighs it."""
        return np.concatenate([cut.payload for _, cut in self.parts])

    @cached_property
    def regime(self) -> np.ndarray:
        """(W, 3) index into `REGIMES` of each window for each joint."""
        return np.concatenate([_regimes(cut) for _, cut in self.parts])


@dataclass(frozen=True)
class Rollout:
    """Robots against logs. deviations: one a robot, in the order given. floor: of the last of them. servo: of the
    drives, where commands went in."""

    cuts: Cuts
    deviations: tuple[Deviation, ...]
    floor: Deviation
    servo: Servo | None = None


def rms(values: np.ndarray) -> np.ndarray:
    """Over the first axis; NaN of nothing."""
    return np.sqrt(np.mean(np.square(values), axis=0)) if len(values) else np.full(values.shape[1:], np.nan)


def plain(robot: Robot) -> Robot:
    """The description as it was drawn up."""
    return robot.model_copy(update={"identified": None, "effect": []})


def rollout(
    robots: dict[str, Robot], cuts: Cuts, progress: Callable[[str], None] = lambda _: None, commands: bool = False
) -> Rollout:
    """Simulate the robots, by name, over `cuts`; the floor is the last one's. progress: told what is at hand.

    commands: the recorded position commands go in, not the torque, through the drives that the last robot's description
    has in [servo], or else those that the logs show.

    Raises:
        DataError: with commands that the logs do not hold, or torque that does not follow them.
        TraceError: positions that are no pose, naming the file. RobotError: an effect that is not known.
    """
    given, parts = list(robots.values())[-1], cuts.parts
    servo = None
    if commands:
        servo = given.servo or identified(
            [
                (trace, cut.segment, stretch(given, cut.segment, trace.position[cut.segment.rows]))
                for trace, cut in parts
            ]
        )
    gains = None if servo is None else gains_of(servo, bounds_of(given).peak_nm)
    deviations, floor = [], None
    for name, robot in robots.items():
        last = name == list(robots)[-1]
        of_parts, of_floor = [], []
        for trace, cut in parts:
            progress(f"{name}, {trace.name}")
            try:
                seen = stretch(robot, cut.segment, trace.position[cut.segment.rows])
                if gains is not None:
                    cut = replace(cut, drives=Drives(gains, cut.cut(commands_of(trace, cut.segment))))
                of_parts.append(_deviation(name, seen, cut))
                if last:
                    of_floor.append(_floor(robot, seen, trace, cut))
            except PoseError as error:
                raise TraceError(f"{trace.path}: {error}") from error
        deviations.append(_joined(name, of_parts))
        if last:
            floor = _joined("floor", of_floor)
    assert floor is not None
    return Rollout(cuts, tuple(deviations), floor, servo)


def compare(
    robots: dict[str, Robot],
    traces: Sequence[Trace],
    horizon: float = HORIZON,
    commands: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Rollout:
    """Cut up `traces`, simulate the robots over them, and see that the last one does not run away for a wrong sign.

    Raises:
        As `cut_up`, `rollout` and `check_sign`.
    """
    last = list(robots)[-1]
    # the sign of the torque is asked for with the torque going in, whatever goes in afterwards
    driven = {last: robots[last]} if commands else robots
    cuts = cut_up(robots, traces, horizon)
    found = rollout(driven, cuts, progress)
    check_sign(robots[last], cuts, found)
    return rollout(robots, cuts, progress, commands) if commands else found


def refuse_another_robot(robots: dict[str, Robot]) -> None:
    """
    Raises:
        DataError: one of `robots` differs from the first in what no identification changes.
    """
    first, given = next(iter(robots.items()))
    for name, robot in robots.items():
        for key in ("geometry", "mass", "drive"):
            if getattr(robot, key) != getattr(given, key):
                raise DataError(f"{name}: its [{key}] differs from that of {first}: compare descriptions of one robot")


def cut_up(robots: dict[str, Robot], traces: Sequence[Trace], horizon: float = HORIZON) -> Cuts:
    """Windows of `horizon` s in which a joint moves and what is carried stays, by the last of `robots`.

    Raises:
        NoWindowError: there is none. DataError: the horizon makes no sense, or logs of several rates.
        TraceError: a trace without a usable part, naming the file.
    """
    robot = list(robots.values())[-1]
    if not SHORTEST <= horizon <= LONGEST:
        raise DataError(f"horizon of {horizon:g} s: must be {SHORTEST:g} to {LONGEST:g} s")
    parts = list(zip(traces, segments_of(traces), strict=True))
    period = one_period([(str(trace.path), segment) for trace, whole in parts for segment in whole])
    samples = max(2, round(horizon / period)) + 1
    horizon = (samples - 1) * period
    result, interruptions, untold, lost = [], [], 0.0, 0
    for trace, whole in parts:
        masses = carried(robot, trace)
        for segment in whole:
            mass = masses[segment.rows]
            starts = _windows(segment, samples, mass)
            untold += period * int(np.sum(np.isnan(mass)))
            if len(starts):
                result.append((trace, Windows(segment, starts, samples, mass)))
        of_trace, fewer = _interrupted(trace, whole, horizon)
        interruptions += of_trace
        lost += fewer
    if not result:
        why = f" and the payload is known (unknown for {untold:.3g} s)" if untold else ""
        raise NoWindowError(f"{traces[0].path}: no window of {horizon:g} s between faults in which a joint moves{why}")
    seconds = float(sum(len(trace) * period for trace in traces))
    return Cuts(result, period, horizon, untold, seconds, interruptions, lost)


def _interrupted(trace: Trace, parts: Sequence[Segment], horizon: float) -> tuple[list[Interruption], int]:
    """Where `trace` is in none of its `parts`, and how many windows that costs."""
    time = trace.time[np.isfinite(trace.time)]
    ends = np.array([[part.time[0], part.time[-1]] for part in parts])
    around = np.concatenate([[time.min()], ends.ravel(), [time.max()]]).reshape(-1, 2)
    holes = around[np.diff(around)[:, 0] > LONGEST_STEP * parts[0].period]

    def room(span: np.ndarray) -> np.ndarray:
        return np.floor(np.maximum(span - 2 * EDGE, 0.0) / horizon + 1e-6).astype(int)

    lost = int(room(np.ptp(time)) - room(np.diff(ends)).sum())
    return [Interruption(trace.name, float(start), float(stop)) for start, stop in holes], lost


def _windows(segment: Segment, samples: int, mass: np.ndarray) -> np.ndarray:
    """(W,) first samples of windows one after the other in which some joint moves and `mass` (N,) kg stays."""
    edge, starts = round(EDGE / segment.period), []
    changes = np.flatnonzero(mass[1:] != mass[:-1]) + 1  # NaN is unlike itself
    for begin, end in itertools.pairwise([0, *changes, len(mass)]):
        starts += range(max(begin, edge), min(end, len(mass) - edge) - samples, samples - 1)
    return np.array([at for at in starts if segment.moving[at : at + samples].any()], np.int64)


def _regimes(cut: Windows) -> np.ndarray:
    """(W, 3) index into `REGIMES`."""
    segment, starts, samples = cut.segment, cut.starts, cut.samples
    usual = np.sqrt(np.mean(segment.theta_dot**2, axis=0))
    result = np.empty((len(starts), 3), np.int64)
    for number, at in enumerate(starts):
        speed = segment.theta_dot[at : at + samples]
        rests = ~segment.moving[at : at + samples].any(axis=0)
        turns = (speed.max(axis=0) > REST_SPEED) & (speed.min(axis=0) < -REST_SPEED)
        slow = np.sqrt(np.mean(speed**2, axis=0)) < SLOW_SHARE * usual
        result[number] = np.where(rests, 0, np.where(turns, 1, np.where(slow, 2, 3)))
    return result


def simulate(
    seen: SeenStretch,
    start: np.ndarray,
    torque: np.ndarray,
    clock: np.ndarray,
    period: float,
    payload: np.ndarray | None = None,
) -> np.ndarray:
    """Angles (W, S, 3) rad that the encoders give from `start` (W, 5, 3) under `torque` (W, S, 3); NaN once it ends.

    clock: (W,) s. payload: (W,) kg, None: nothing is carried.
    """
    payload = np.zeros(len(start)) if payload is None else payload
    runs = Runs(np.ascontiguousarray(start), np.ascontiguousarray(torque), payload, clock)
    return run(seen, runs, period, NO_DRIVES)[0]


def run(seen: SeenStretch, runs: Runs, period: float, drives: Drives) -> tuple[np.ndarray, np.ndarray]:
    """Angles that the encoders give, rad, and torque, N m, (W, S, 3) each, NaN once a run ends."""
    motor, pushed = np.empty(runs.torque.shape), np.empty(runs.torque.shape)
    run_kernel(seen.forward, np.zeros(1, SCRATCH), runs, drives, Pace.of(period), motor, pushed)
    return seen.measured(motor), pushed


def _deviation(name: str, seen: SeenStretch, windows: Windows) -> Deviation:
    angle, torque = windows.run(seen, seen.start[windows.starts], seen.torque)
    off = torque - windows.cut(seen.torque)
    return _compared(name, seen.model, angle, windows.cut(windows.segment.theta), off)


def _compared(name: str, model: DeltaModel, angle: np.ndarray, measured: np.ndarray, torque: np.ndarray) -> Deviation:
    reference = kinematics.forward(model, measured.reshape(-1, 3)).reshape(measured.shape)
    platform = _followed(model, angle)
    path = np.linalg.norm(reference - reference[:, :1], axis=2)
    return Deviation(name, angle - measured, platform - reference, path, torque)


def _followed(model: DeltaModel, angle: np.ndarray) -> np.ndarray:
    """Platform (W, S, 3) m of simulated angles (W, S, 3) rad, NaN once a run has ended; angles of a run out of reach
    are made NaN."""
    platform = np.full(angle.shape, np.nan)
    good = np.isfinite(angle[..., 0])
    for w in range(len(angle)):
        end = int(good[w].sum())
        try:
            platform[w, :end] = kinematics.forward(model, angle[w, :end])
        except PoseError:
            angle[w] = np.nan
    return platform


def _floor(robot: Robot, seen: SeenStretch, trace: Trace, windows: Windows) -> Deviation:
    """Runs of the same robot with noise over torque and start state, less the run without."""
    rng = np.random.default_rng(SEED)
    segment, starts = windows.segment, windows.starts
    torque_noise, angle_noise = noise_of(robot, trace, segment)
    clean, pushed = windows.run(seen, seen.start[starts], seen.torque)
    place = _followed(seen.model, clean)  # a model that is far off does not get through either
    path = np.linalg.norm(place - place[:, :1], axis=2)
    draws = []
    for _ in range(DRAWS):
        noise = torque_noise * rng.standard_normal(segment.torque.shape)
        disturbed = stretch(robot, replace(segment, torque=segment.torque + noise), trace.position[segment.rows])
        angle, speed, _ = smooth(angle_noise * rng.standard_normal(segment.theta.shape), segment.period)
        start = seen.start[starts].copy()
        for row, error in ((0, angle), (1, speed), (2, angle), (3, speed)):
            start[:, row] += error[starts]
        moved, driven = windows.run(seen, start, disturbed.torque)
        seen_off = driven - pushed if windows.drives is NO_DRIVES else driven - pushed + windows.cut(noise)
        off = _followed(seen.model, moved) - place
        draws.append(Deviation("floor", moved - clean, off, path, seen_off))
    # window by window, as the other deviations are
    of_parts = (np.stack([getattr(draw, part) for draw in draws], axis=1) for part in PARTS)
    return Deviation("floor", *(values.reshape(-1, *values.shape[2:]) for values in of_parts))


def noise_of(robot: Robot, trace: Trace, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    """White noise a sample of torque, (3,) N m, and of the angle, (3,) rad: what the motion's smoother takes away."""
    recording = Recording(segment, Delta.of(robot), 0, trace.name)
    hypothesis = hypothesis_of(robot)
    left = segment.torque - predict(hypothesis.seen(recording), hypothesis)
    torque = np.minimum(white_noise([recording]), white_noise([recording], [left]))
    white = np.random.default_rng(SEED).standard_normal((4096, 1))
    share = float(np.std(white - smooth(white, segment.period)[0]))
    rough = trace.position[segment.rows] - segment.theta
    angle = np.median(np.abs(rough - np.median(rough, axis=0)), axis=0) / 0.6745 / share
    return torque, angle


def _joined(name: str, deviations: Sequence[Deviation]) -> Deviation:
    return Deviation(name, *(np.concatenate([getattr(one, part) for one in deviations]) for part in PARTS))


def check_sign(robot: Robot, cuts: Cuts, found: Rollout) -> None:
    """See whether the last deviation of `found`, which is `robot`'s, runs away because of a torque's sign.

    Raises:
        DataError: the simulated robot does little better than one that stands still, and with some torque turned round
            it does.
    """
    deviation = found.deviations[-1]
    if deviation.good.all() and deviation.platform_mm < ASTRAY * deviation.path_mm:
        return
    parts = cuts.parts
    best, error = None, _typical(deviation)
    for signs in ((-1, -1, -1), (-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)):
        turned = []
        for trace, cut in parts:
            other = replace(cut.segment, torque=cut.segment.torque * signs)
            seen = stretch(robot, other, trace.position[other.rows])
            turned.append(_deviation("", seen, replace(cut, segment=other)))
        left = _typical(_joined("", turned))
        if left < TURNED * error:
            best, error = signs, left
    if best is not None:
        joints = named_joints([joint + 1 for joint in range(3) if best[joint] < 0])
        raise DataError(
            f"{parts[0][0].path}: the sign of the torque of {joints} is wrong: the simulated robot runs away "
            f"({_far(deviation)}), with the other sign it does not (off by {error:.3g} mm)"
        )


def _typical(deviation: Deviation) -> float:
    """Median distance at the horizon, mm, a run that left the workspace being farther than any."""
    distance = np.linalg.norm(deviation.platform[:, -1], axis=1)
    return 1e3 * float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def _far(deviation: Deviation) -> str:
    away, count = int(np.sum(~deviation.good)), len(deviation.good)
    if away:
        return f"it leaves the workspace in {away} of {count} windows"
    return f"off by {deviation.platform_mm:.3g} mm over a path of {deviation.path_mm:.3g} mm"
