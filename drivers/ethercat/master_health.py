"""What a master says of itself on the bus: its health, whenever that changes or is due."""

from __future__ import annotations

from collections.abc import Callable

from drivers.ethercat.soem_master import Master, OffsetRamp
from drivers.health import Health
from schemas.messages import NANOSECONDS, HealthFlag

FAULT_NS = NANOSECONDS  # that BUS_FAULT stands after the last fault, so that a fault of one cycle is seen


class Report:
    """Call it after each cycle; its last word, at the end of a `with` block, carries what was counted till then."""

    def __init__(
        self, health: Health | None, master: Master, offset: OffsetRamp, more: Callable[[], dict[str, int]] | None
    ) -> None:
        """health: None where there is no bus. more: further counts of the health message."""
        self._health, self._standing = health, HealthFlag(0) if health is None else health.flags
        self._master, self._offset, self._more = master, offset, more
        self._faulty_ns = -(1 << 62)  # when the last fault was

    def __call__(self) -> None:
        health, master = self._health, self._master
        if health is None:
            return
        flags = self._standing
        if master.in_trouble:
            self._faulty_ns = master.sent_ns
        if master.sent_ns - self._faulty_ns < FAULT_NS:
            flags |= HealthFlag.BUS_FAULT
        if self._offset.stale:
            flags |= HealthFlag.STALE_FEEDFORWARD
        if flags != health.flags:
            health.flags = flags
        if health.due:
            health.publish(**self._counts())

    def __enter__(self) -> Report:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._health:
            self()
            self._health.publish(**self._counts())  # the last word repeats these counts

    def _counts(self) -> dict[str, int]:
        counts = self._master.counts
        said = {"received": counts.cycles, "lost": counts.lost, "invalid": counts.faulty, "late": counts.missed}
        return said | (self._more() if self._more else {})
