"""Health: when it speaks, what stands in it, and that its last word arrives."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import open_bus
from drivers.health import _WINDOW, CHANGE_NS, PERIOD_NS, Health
from schemas.errors import BusError, DataError, StorageError
from schemas.messages import HealthFlag, Role, StopReason

Until = Callable[[Callable[[], bool]], None]


class Listener:
    """Everything that `health` said."""

    def __init__(self, bus, until: Until) -> None:
        self._inbox, self._until = bus.subscribe("health"), until
        self.said: list[np.void] = []

    def count(self) -> int:
        self.said += list(self._inbox.take()[0])
        return len(self.said)

    def wait_for(self, count: int) -> None:
        self._until(lambda: self.count() >= count)


def test_a_change_of_flags_is_told_at_once_and_a_flicker_is_not_missed(bus_folder: Path, until: Until) -> None:
    with open_bus("bench", Role.MONITOR) as bus:
        heard, health = Listener(bus, until), Health(bus, HealthFlag.NO_REALTIME)
        assert not health.due
        health.flags = HealthFlag.NO_REALTIME | HealthFlag.BUS_FAULT
        assert health.due
        health.publish(received=1)
        assert not health.due
        health.flags = HealthFlag.NO_REALTIME | HealthFlag.STALE_INPUT  # comes and goes before anybody publishes
        health.flags = HealthFlag.NO_REALTIME
        assert not health.due  # not more often than that
        time.sleep(CHANGE_NS * 1e-9)
        assert health.due
        health.publish(received=2)
        time.sleep(CHANGE_NS * 1e-9)
        assert health.due  # gone is a change too
        health.publish(received=3)
        assert not health.due
        assert health.due_ns > time.monotonic_ns() + PERIOD_NS // 2
        heard.wait_for(3)
    flags = [HealthFlag(int(said["flags"])) for said in heard.said]
    assert flags == [
        HealthFlag.NO_REALTIME | HealthFlag.BUS_FAULT,
        HealthFlag.NO_REALTIME | HealthFlag.STALE_INPUT,
        HealthFlag.NO_REALTIME,
    ]


def test_a_flag_that_flickers_all_the_time_does_not_flood_the_bus(bus_folder: Path) -> None:
    with open_bus("bench", Role.MASTER) as bus:
        health, published = Health(bus), list[int]()

        def flickered() -> bool:
            for flags in (HealthFlag.BUS_FAULT, HealthFlag(0)):
                health.flags = flags
                if health.due:
                    health.publish()
                    published.append(time.monotonic_ns())
            return len(published) >= 8

        while not flickered():
            assert time.monotonic_ns() < published[0] + 30 * PERIOD_NS
    assert published[-1] - published[0] >= 0.99 * (len(published) - 1) * CHANGE_NS


def test_duplicate_source_is_due_when_it_comes(bus_folder: Path, until: Until) -> None:
    with open_bus("bench", Role.MONITOR) as bus, open_bus("bench", Role.PLAYER):
        health = Health(bus)
        with open_bus("bench", Role.TAP):
            until(lambda: bus.duplicate_source)
            assert health.due
            health.publish()
            assert not health.due


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (None, StopReason.DONE),
        (KeyboardInterrupt(), StopReason.INTERRUPTED),
        (BusError("cable"), StopReason.BUS_FAULT),
        (StorageError("disk"), StopReason.DISK_ERROR),
        (DataError("else"), StopReason.ERROR),
    ],
)
def test_the_last_word_arrives_and_says_why(
    bus_folder: Path, until: Until, error: BaseException | None, reason: StopReason
) -> None:
    def role() -> None:
        with open_bus("bench", Role.PLAYER) as bus, Health(bus) as health:
            until(lambda: Role.OBSERVER in bus.alive)
            health.publish(published=7)
            if error is not None:
                raise error

    with open_bus("bench", Role.OBSERVER) as observer:
        heard = Listener(observer, until)
        if error is None:
            role()
        else:
            with pytest.raises(type(error)):
                role()
        heard.wait_for(2)
        until(lambda: observer.alive == {Role.OBSERVER})
    last = heard.said[-1]
    assert (last["flags"], last["reason"], last["published"]) == (HealthFlag.STOPPED, reason, 7)


def test_counts_stand_still_at_the_end_of_their_range(bus_folder: Path, until: Until) -> None:
    with open_bus("bench", Role.MONITOR) as bus:
        heard = Listener(bus, until)
        Health(bus).publish(lost=3 * 2**64, received=-5)
        heard.wait_for(1)
    assert (int(heard.said[0]["lost"]), heard.said[0]["received"]) == (2**64 - 1, 0)
    assert heard.said[0]["flags"] == HealthFlag(0)


def test_latencies_are_those_since_the_last_message(bus_folder: Path, until: Until) -> None:
    """Of more than are kept, the newest."""
    with open_bus("bench", Role.MONITOR) as bus:
        heard, health = Listener(bus, until), Health(bus)
        for latency in range(1, 150):
            health.time_one(latency * 1000)
        health.time_many(np.arange(150, 301) * 1000)
        health.publish()
        health.publish()
        health.time_many(np.full(1000, 10**9))
        for count in (9000, 9000):
            health.time_many(np.arange(count))
        health.publish()
        heard.wait_for(3)
    found = [[float(said[f"latency_{name}"]) for name in ("median", "p99", "max")] for said in heard.said]
    np.testing.assert_allclose(found[:2], [[151e-6, 298e-6, 300e-6], [0.0, 0.0, 0.0]])
    kept = np.sort(np.r_[np.arange(9000), np.arange(9000)[-(_WINDOW - 9000) :]]) * 1e-9
    np.testing.assert_allclose(found[2], [kept[_WINDOW // 2], kept[_WINDOW * 99 // 100], kept[-1]])
