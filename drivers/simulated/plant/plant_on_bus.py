"""The plant as a robot on the bus: publishes what it is about to do and what it measured, takes feed-forward torque.

In cycle k the robot publishes `reference` k + 1, then `sample` k, and adds the feed-forward torque meant for cycle k.
Where that did not come it holds the last one for `STALE_CYCLES`; after that the drives are on feedback alone, their
integrators taking over the torque that was, so that nothing jumps. By the position offset that comes with a torque the
motors go before the planned positions; without one they come back to them.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from drivers.bus import Bus
from drivers.health import Health
from drivers.inbox import Inbox
from drivers.motion import Trajectory
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.plant_trace import Course
from schemas.messages import FARTHEST_AHEAD, NANOSECONDS, REFERENCE, SAMPLE, HealthFlag, StopReason, set_stamp
from schemas.trace import Trace
from service.model import kinematics

STALE_CYCLES = 3
RETURN_SPEED = 0.2  # rad/s, at which motors come back that went before the planned positions
LEAD_NS = 20_000_000  # from the call to the first deadline
REMEMBERED = 300_000  # cycles kept of a run that goes on: the newest five minutes at 1 kHz, 48 MB
_CYCLE = np.dtype(
    [(name, "3f8") for name in ("position", "torque", "torque_command", "position_command", "feedforward", "platform")]
    + [("payload", "f8"), ("late", "i8"), ("held", "?")]
)

_NO_TORQUE = (np.nan, np.nan, np.nan)


class FeedforwardIntake:
    """Which feed-forward torque is in force in a cycle.

    limit: N m, joint side; more is cut off, what is not finite is refused.
    """

    def __init__(self, inbox: Inbox, limit: float):
        self.received = self._refused = 0
        self._inbox, self._limit = inbox, limit
        self._waiting: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._last: tuple[int, tuple[np.ndarray, np.ndarray]] | None = None
        self._in_force: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def newest(self) -> int | None:
        """Cycle that the torque was for which came last into force."""
        return None if self._last is None else self._last[0]

    @property
    def offset(self) -> np.ndarray | None:
        """(3,) rad, of the positions, which came with the torque that is in force; None as `at`."""
        return None if self._in_force is None else self._in_force[1]

    @property
    def refused(self) -> int:
        """Of those received, and what was no feed-forward at all."""
        return self._refused + self._inbox.rejected

    def at(self, cycle: int) -> np.ndarray | None:
        """Torque (3,) N m for `cycle`; None: none that is fresh enough."""
        records, _ = self._inbox.take()
        for record in records:
            target, torque = int(record["target_sequence"]), np.array(record["torque"])
            said = np.nan_to_num(record["position_offset"])  # NaN: none is said
            offset = np.clip(said, -FARTHEST_AHEAD, FARTHEST_AHEAD)
            self.received += 1
            # the far future is another run's
            if np.isfinite(torque).all() and cycle - STALE_CYCLES <= target <= cycle + 1000:
                self._waiting[target] = np.clip(torque, -self._limit, self._limit), offset
            else:
                self._refused += 1
        due = [target for target in self._waiting if target <= cycle]
        if due:
            newest = max(due)
            if self._last is None or newest >= self._last[0]:
                self._last = (newest, self._waiting[newest])
            for target in due:
                del self._waiting[target]
        stale = self._last is None or cycle - self._last[0] > STALE_CYCLES
        self._in_force = None if self._last is None or stale else self._last[1]
        return None if self._in_force is None else self._in_force[0]


@dataclass(frozen=True)
class LiveRun:
    """What happened in the newest N cycles: the trace, and the feed-forward torque and payload in force.

    feedforward (N, 3) N m, NaN where the drives were on feedback alone, held (N,) bool: it was for an earlier cycle;
    payload (N,) kg. astray (N, 3) m: where the platform truly is, relative to where motors on their command would put
    it through gears without compliance or play. cycles: of the whole run. late: how many of them began after the next
    was due; lateness (N,) ns. interrupted: ended by Ctrl-C.
    """

    trace: Trace
    feedforward: np.ndarray
    held: np.ndarray
    payload: np.ndarray
    astray: np.ndarray
    cycles: int
    late: int
    lateness: np.ndarray
    interrupted: bool = False


def run_live(
    plant: Plant,
    motion: Trajectory,
    bus: Bus,
    pace: Callable[[int], int],
    *,
    loops: int = 1,
    changes: Mapping[int, Plant] = MappingProxyType({}),
    standing: HealthFlag = HealthFlag(0),
    progress: Callable[[int], object] = lambda cycle: None,
    stop: Callable[[int], bool] = lambda cycle: False,
) -> LiveRun:
    """Run `motion` `loops` times (0: until Ctrl-C; it has to end where it starts) at the period of `plant`.

    changes: cycle -> the plant that goes on from there.
    standing: of the process, in every health message.
    pace: waits for a deadline, ns of CLOCK_MONOTONIC, and says how late it is (`replay.clock.wait_until`). stop: asked
    every cycle whether to end. Ctrl-C ends the run; the newest `REMEMBERED` cycles come back.
    """
    said = _Said(bus, motion, plant.period)
    intake = FeedforwardIntake(bus.subscribe("feedforward"), plant.truth.peak_torque_nm)
    health = Health(bus, standing | HealthFlag.STALE_FEEDFORWARD)
    period_ns = round(plant.period * NANOSECONDS)
    count = len(motion)
    course = Course(motion)
    rows = np.zeros(min(loops * count, REMEMBERED) if loops else REMEMBERED, _CYCLE)
    done = late_count = 0
    for changed in changes.values():
        changed.warm_up()
    plant.set_payload(0.0)
    plant.reset(motion.position[0])
    plant.warm_up()
    start = time.monotonic_ns() + LEAD_NS
    fed: np.ndarray | None = None
    ahead = np.zeros(3)
    with health:
        try:
            for cycle in range(loops * count) if loops else itertools.count():
                k = cycle % count
                late = pace(start + cycle * period_ns)
                late_count += late > period_ns
                if cycle in changes:
                    changes[cycle].adopt(plant)
                    plant = changes[cycle]
                fed_before, fed = fed, intake.at(cycle)
                if (fed is None) != (fed_before is None):
                    plant.take_over(fed_before, fed)
                    health.flags = standing if fed is not None else standing | HealthFlag.STALE_FEEDFORWARD
                ahead_before, ahead = ahead, _ahead(ahead, intake.offset, plant.period)
                measured = course.latch(plant, k, fed, ahead, ahead - ahead_before)
                platform = plant.platform.copy()  # physics moves it on
                said.put(cycle, k, measured)
                plant.run()
                held = fed is not None and intake.newest != cycle
                rows[cycle % len(rows)] = (
                    *measured, motion.position[k], _NO_TORQUE if fed is None else fed, platform, plant.payload, late,
                    held,
                )  # fmt: skip
                done = cycle + 1
                health.time_one(late)
                if health.due:
                    health.publish(
                        published=cycle + 1, received=intake.received, rejected=intake.refused, late=late_count
                    )
                progress(cycle)
                if stop(cycle):
                    break
        except KeyboardInterrupt:
            ended = StopReason.INTERRUPTED
        else:
            ended = StopReason.DONE
        health.stop(ended, published=done, received=intake.received, rejected=intake.refused, late=late_count)
    rows = rows[:done] if done <= len(rows) else np.roll(rows, -(done % len(rows)))
    return _remembered(rows, plant, done, late_count, ended is StopReason.INTERRUPTED)


class _Said:
    """What a cycle says on the bus: the planned motion of the next one, and the sample of its own."""

    def __init__(self, bus: Bus, motion: Trajectory, period: float) -> None:
        self._sample_out, self._reference_out = bus.publisher("sample"), bus.publisher("reference")
        self._sample, self._reference = SAMPLE.empty(1), REFERENCE.empty(1)
        self._motion, self._period_ns = motion, round(period * NANOSECONDS)
        self._epoch = time.time_ns()

    def put(self, cycle: int, k: int, measured: tuple[np.ndarray, ...]) -> None:
        """k: row of the motion. measured: position, torque and its command, (3,) each."""
        sample, reference, motion = self._sample, self._reference, self._motion
        stamp = self._epoch + cycle * self._period_ns
        set_stamp(reference, stamp + self._period_ns)
        reference["sequence"] = cycle + 1
        reference["position"], reference["velocity"] = motion.position[k + 1], motion.velocity[k + 1]
        reference["acceleration"] = motion.acceleration[k + 1]
        self._reference_out.put(reference.tobytes())
        set_stamp(sample, stamp)
        sample["sequence"] = cycle
        sample["position"], sample["torque"], sample["torque_command"] = measured
        sample["position_command"] = motion.position[k]
        self._sample_out.put(sample.tobytes())


def _remembered(rows: np.ndarray, plant: Plant, done: int, late_count: int, interrupted: bool) -> LiveRun:
    """The newest cycles, (N,) _CYCLE in their order, of `done`."""
    trace = Trace(
        path=Path("live"),
        time=np.arange(done - len(rows), done) * plant.period,
        position=rows["position"],
        torque=rows["torque"],
        position_command=rows["position_command"],
        torque_command=rows["torque_command"],
        flags=np.zeros(len(rows), np.uint32),
    )
    wanted = kinematics.forward(plant.mechanism.geometry, rows["position_command"] + plant.offset)
    return LiveRun(
        trace, rows["feedforward"], rows["held"], rows["payload"], rows["platform"] - wanted, done, late_count,
        rows["late"], interrupted,
    )  # fmt: skip


def _ahead(before: np.ndarray, offset: np.ndarray | None, period: float) -> np.ndarray:
    """(3,) rad, of the motors before the planned positions in this cycle."""
    if offset is None:
        return before - np.clip(before, -RETURN_SPEED * period, RETURN_SPEED * period)
    return offset
