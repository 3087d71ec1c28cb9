"""The player: what goes out, in which order, with which stamps, at which times it is planned."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from drivers.health import Health
from drivers.sequence import SequenceCounter
from replay.clock import SPIN_NS, Pacer, wait_until
from replay.player import Played, Schedule, play, schedule
from schemas.errors import TraceError
from schemas.messages import HEALTH, SAMPLE, HealthFlag, Role, StopReason, stamp_ns
from schemas.trace import Trace


def trace(count: int, rate: float, first: float = 12.5) -> Trace:
    position, torque = np.random.default_rng(1).normal(size=(2, count, 3))
    return Trace(Path("made.csv"), first + np.arange(count) / rate, position, torque)


def sent(plan: Schedule) -> tuple[np.ndarray, Played]:
    payloads: list[bytes] = []
    played = play(plan, payloads.append, None, lambda _: None)
    return np.frombuffer(b"".join(payloads), SAMPLE.dtype), played


def test_one_pass_sends_the_samples_of_the_trace_bit_for_bit() -> None:
    made = trace(300, 4000.0)
    records, played = sent(schedule(made))
    assert records.tobytes() == made.samples().tobytes()
    assert (played.sent, played.planned, len(played.lateness)) == (300, 300, 300)
    assert played.lateness.min() >= 0  # nothing goes out before its time


def test_loops_go_on_in_time_and_sequence() -> None:
    made = trace(50, 1000.0)
    records, played = sent(schedule(made, speed=20.0, loops=3))
    assert played.sent == 150
    assert records["sequence"].tolist() == list(range(150))
    assert np.all(np.diff(stamp_ns(records)) == 1_000_000)
    assert stamp_ns(records)[0] == 12_500_000_000
    assert np.array_equal(records["position"], np.tile(made.position, (3, 1)))


def test_sequence_of_the_source_is_kept_holes_and_all() -> None:
    made = trace(4, 1000.0)
    made = Trace(made.path, made.time, made.position, made.torque, sequence=np.array([100, 101, 105, 106], np.uint64))
    records, _ = sent(schedule(made, loops=2))
    assert records["sequence"].tolist() == [100, 101, 105, 106, 107, 108, 112, 113]


@pytest.mark.parametrize(
    ("options", "due_ms"),
    [
        ({}, [0, 1, 2, 3]),
        ({"speed": 2.0}, [0, 0.5, 1, 1.5]),
        ({"rate": 500.0}, [0, 2, 4, 6]),
        ({"rate": 500.0, "speed": 4.0}, [0, 0.5, 1, 1.5]),
    ],
)
def test_rate_and_speed_lay_down_the_deadlines(options: dict, due_ms: list[float]) -> None:
    plan = schedule(trace(4, 1000.0), **options)
    assert (plan.due * 1e-6).tolist() == due_ms
    assert plan.due_span * 1e-6 == due_ms[-1] + due_ms[1]  # the next loop is one period behind


def test_gap_in_the_trace_is_played_as_a_gap_and_time_going_back_in_order() -> None:
    made = trace(5, 1000.0)
    moved = Trace(made.path, np.array([0.0, 0.001, 0.050, 0.049, 0.051]), made.position, made.torque)
    plan = schedule(moved)
    assert (plan.due * 1e-6).tolist() == [0, 1, 50, 50, 51]
    records, _ = sent(plan)
    assert records["sequence"].tolist() == [0, 1, 2, 3, 4]
    assert (stamp_ns(records) * 1e-6).tolist() == [0, 1, 50, 49, 51]


def test_start_and_stop_cut_the_trace() -> None:
    plan = schedule(trace(1000, 1000.0), start=0.1, stop=0.2)
    assert plan.sequence.tolist() == list(range(100, 201))
    assert plan.due[0] == 0  # no wait for what was cut off
    with pytest.raises(TraceError, match=r"made\.csv: 0 samples from 5 s to the end; it lasts 0\.999 s"):
        schedule(trace(1000, 1000.0), start=5.0)


def test_first_samples_keep_their_distance() -> None:
    instants: list[int] = []
    play(schedule(trace(20, 200.0)), lambda _: instants.append(time.monotonic_ns()), None, lambda _: None)
    assert instants[-1] - instants[0] > 19 * 5_000_000 / 2 - 10_000_000  # were the first held up, the rest would hurry


def test_held_up_samples_are_counted_and_follow_in_order_at_twice_the_rate_at_most() -> None:
    payloads: list[bytes] = []
    instants: list[int] = []

    def put(payload: bytes) -> None:
        payloads.append(payload)
        instants.append(time.monotonic_ns())
        if len(payloads) == 10:
            time.sleep(0.05)

    played = play(schedule(trace(200, 1000.0)), put, None, lambda _: None)
    records = np.frombuffer(b"".join(payloads), SAMPLE.dtype)
    assert records["sequence"].tolist() == list(range(200))
    assert played.late >= 40
    catching_up = np.diff(instants[10:60])
    assert np.quantile(catching_up, 0.1) >= 400_000  # half a period; a flood would be a hundred times as fast
    assert played.lateness.max() >= 45_000_000


def test_interrupt_ends_it_with_what_was_sent() -> None:
    payloads: list[bytes] = []

    def put(payload: bytes) -> None:
        payloads.append(payload)
        if len(payloads) == 70:
            raise KeyboardInterrupt

    played = play(schedule(trace(50, 4000.0), loops=0), put, None, lambda _: None)
    assert (played.sent, played.planned) == (69, None)


def test_pacer_is_on_time_again_after_a_hold_up() -> None:
    """In the end, where other tests run beside it."""
    pace, begin = Pacer(), time.monotonic_ns() + 1_000_000
    deadlines = [begin + n * 1_000_000 for n in range(1000)]
    for deadline in deadlines[:20]:
        assert pace(deadline) >= 0
    time.sleep(0.05)
    late = [pace(deadline) for deadline in deadlines[20:]]
    assert late[0] > 45_000_000
    assert min(late[100:]) < 1_000_000
    assert time.monotonic_ns() >= deadlines[-1]


def test_wait_until_never_returns_early() -> None:
    for ahead in (-1000, 0, SPIN_NS // 2, 3 * SPIN_NS):
        deadline = time.monotonic_ns() + ahead
        late = wait_until(deadline)
        assert late >= 0
        assert time.monotonic_ns() >= deadline + late


@pytest.mark.parametrize("rate", [1000.0, 4000.0])
def test_nothing_is_lost_on_the_bus(bus_folder: Path, rate: float, until: Callable[[Callable[[], bool]], None]) -> None:
    count = int(2 * rate)
    with open_bus("bench", Role.PLAYER) as player, open_bus("bench", Role.MONITOR) as monitor:
        inbox, told = monitor.subscribe("sample"), monitor.subscribe("health")
        publisher = player.publisher("sample")
        until(lambda: publisher.heard)
        made = trace(count // 2, rate)
        play(schedule(made, loops=2), publisher.put, Health(player, HealthFlag.NO_REALTIME), lambda _: None)
        taken: list[np.ndarray] = []
        until(lambda: bool(taken.append(inbox.take()[0]) or sum(map(len, taken)) >= count))
        records = np.concatenate(taken)
        said: list[np.ndarray] = []
        until(lambda: bool(said.append(told.take()[0]) or np.concatenate(said)["reason"].any()))
        health = np.concatenate(said)
    counter = SequenceCounter()
    counter.update_many(records["sequence"])
    assert records["sequence"].tolist() == list(range(count))
    assert (counter.lost, counter.repeated, counter.out_of_order, inbox.rejected) == (0, 0, 0, 0)
    assert np.array_equal(records["position"][: count // 2], made.position)
    assert health.dtype == HEALTH.dtype
    assert len(health) >= 4  # at the start, after each second, at the end
    assert np.all(health["role"] == Role.PLAYER)
    assert np.all(health["flags"][:-1] == HealthFlag.NO_REALTIME)
    assert health["flags"][-1] == HealthFlag.NO_REALTIME | HealthFlag.STOPPED
    assert health["reason"].tolist() == [StopReason.RUNNING] * (len(health) - 1) + [StopReason.DONE]
