"""What runs on the bus, as tables that are drawn again and again: a robot's joints and payload, and its roles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from schemas.words import words
from service.cli.output import Table, table

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from rich.console import Group

    from drivers.bus import Bus
    from schemas.axes_description import Description

MOST_EVENTS = 4  # listed
ERRORS = {"M_KH": "kh", "M_Id+F": "id_friction", "rigid": "rigid", "with friction": "friction", "full": "full"}
PAYLOAD = ("", "estimate", "standard deviations", "")
WINDOW_NS = 1_000_000_000  # of what the errors are an rms of


class Joints:
    """The newest of every joint, the model errors of the last second, the payload and its last events."""

    def __init__(self, bus: Bus, description: Description) -> None:
        self._topics, self._count = description.topics, description.count
        self._units = (
            ("m", "N") if description.linear else ("rad", "N m") if description.angular else ("rad, m", "N m, N")
        )
        self._inboxes = {topic: bus.subscribe(topic) for topic in self._topics if topic != self._topics.reference}
        self._newest: dict[str, np.ndarray] = {}
        self._events: list[str] = []

    def picture(self, title: str) -> Group:
        """What is known by now, the payload in a table of its own; what never came is left out."""
        from rich.console import Group

        self._take()
        payload = self._newest.get(self._topics.payload)
        load = [] if payload is None else ["", table(PAYLOAD, list(_payload(payload[-1])), figures=slice(1, 2))]
        return Group(self._table(title), *load)

    def _take(self) -> None:
        import numpy as np

        from schemas.messages import PayloadEvent, stamp_ns

        for topic, inbox in self._inboxes.items():
            records, _ = inbox.take()
            if len(records):
                kept = np.concatenate([self._newest.get(topic, records[:0]), records])
                self._newest[topic] = kept[stamp_ns(kept) > stamp_ns(kept[-1]) - WINDOW_NS]
        for record in self._newest.get(self._topics.payload, []):
            if record["event"]:
                event = PayloadEvent(int(record["event"])).name.lower()
                line = f"{float(stamp_ns(record)) * 1e-9:.2f} s {event}"
                self._events = [*self._events, line][-MOST_EVENTS:] if line not in self._events else self._events

    def _table(self, title: str) -> Table:
        from schemas.messages import stamp_ns

        shown = table(("", *(f"joint {joint + 1}" for joint in range(self._count))), list(self._rows()), title)
        if self._topics.sample in self._newest:
            clock = float(stamp_ns(self._newest[self._topics.sample][-1])) * 1e-9
            shown.caption = f"bus time {clock:.1f} s   {'   '.join(self._events)}"
        return shown

    def _rows(self) -> Iterator[tuple[str, ...]]:
        import numpy as np

        (way, torque), topics = self._units, self._topics
        newest = {topic: records[-1] for topic, records in self._newest.items()}
        for label, topic, field, form in (
            (f"position, {way}", topics.sample, "position", "+8.3f"),
            (f"torque measured, {torque}", topics.sample, "torque", "+8.2f"),
            (f"torque feed-forward, {torque}", topics.feedforward, "torque", "+8.2f"),
        ):
            if topic in newest:
                yield label, *(format(value, form) for value in newest[topic][field][: self._count])
        for label, field in ERRORS.items():
            if topics.error in newest and field in (newest[topics.error].dtype.names or ()):
                values = self._newest[topics.error][field][:, : self._count]
                known = np.isfinite(values).sum(axis=0)
                rms = np.sqrt(np.nansum(values**2, axis=0) / np.maximum(known, 1))
                told = (format(value, "8.2f") if count else "at rest" for value, count in zip(rms, known, strict=True))
                yield f"error {label}, rms {torque}", *told


def _payload(payload: np.void) -> Iterator[tuple[str, str, str, str]]:
    """Rows under `PAYLOAD`: mass, and of an arm's load centre and inertia, as far as they are known."""
    import numpy as np

    trust = "trusted" if payload["trusted"] else "not yet trusted"
    if "centre" not in (payload.dtype.names or ()):
        errors = f"± {payload['random_std_dev']:.3f} random, ± {payload['common_std_dev']:.3f} common"
        yield "payload, kg", f"{payload['mass']:.3f}", errors, trust
        return
    for name, label, known in (
        ("mass", "load, kg", True), ("centre", "centre, mm", payload["centre_trusted"]),
        ("inertia", "inertia, g m^2", payload["inertia_trusted"]),
    ):  # fmt: skip
        if not (known and np.isfinite(payload["mass"])):
            yield label, "not yet", "", ""
            continue
        values, random, common = (1e3**(name != "mass") * np.atleast_1d(payload[f"{name}{part}"])
                                  for part in ("", "_random", "_common"))  # fmt: skip
        digits = 3 if name == "mass" else 1
        told = ", ".join(f"{value:.{digits}f}" for value in values)
        errors = f"± {random.max():.{digits}f} random, ± {common.max():.{digits}f} common"
        yield label, told, errors, trust if name == "mass" else ""


class Roles:
    """What each role said of itself last."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._inbox = bus.subscribe("health")
        self._newest: dict[int, np.void] = {}

    def table(self) -> Table:
        """A row a role that is here, or said that it has ended."""
        for record in self._inbox.take()[0]:
            self._newest[int(record["role"])] = record
        head = ("role", "state", "messages in, out", "lost", "latency, median, p99, max", "status")
        return table(head, list(self._rows()), figures=slice(2, 5))

    def _rows(self) -> Iterator[tuple[str, ...]]:
        from schemas.messages import HealthFlag, Role

        alive = {int(role) for role in self._bus.alive} - {int(self._bus.role)}
        for number in sorted(alive | set(self._newest)):
            said: Any = self._newest.get(number)
            name = Role(number).name.lower()
            if said is None:
                yield name, "alive", "", "", "", "no health message yet"
                continue
            flags = HealthFlag(int(said["flags"]))
            ended = bool(flags & HealthFlag.STOPPED)
            state = "[yellow]ended[/yellow]" if ended else "runs" if number in alive else "[red]gone[/red]"
            told = [words(flag.name.lower()) for flag in HealthFlag if flags & flag and flag.name]
            latency = [f"{1e6 * said[key]:.0f}" for key in ("latency_median", "latency_p99", "latency_max")]
            yield (
                name, state, f"{said['received']}, {said['published']}", str(said["lost"]),
                f"{', '.join(latency)} µs" if said["latency_max"] > 0 else "", ", ".join(told) or "ok",
            )  # fmt: skip
