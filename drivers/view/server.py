"""The bus of one robot as a Foxglove WebSocket server: messages as they are, and the robot as a scene.

All topics have one clock, the time at which a message was put on the bus. Only `MOST_HZ` messages of a topic a second
are passed on, evenly chosen: who looks does not see more, and what runs beside it needs the processor.
"""

from __future__ import annotations

import errno
import socket
import time
from collections.abc import Callable

import foxglove
import numpy as np

from drivers.bus import Bus
from drivers.inbox import sending
from drivers.view.viewer_scene import ViewerScene
from schemas.errors import BusError
from schemas.messages import OF_DELTA, topics_of
from schemas.robot import Robot
from schemas.ros2 import RosType, ros_type
from schemas.zenoh_keys import topic_name

PERIOD_S = 0.05  # between two looks at the bus
MOST_HZ = 200.0  # of a topic; a screen shows 60
SHAPE_NS = 1_000_000_000  # between two messages with the shapes: who connects waits no longer for the robot
BACKLOG = 4096  # messages kept for a client that is slow; the oldest go first
_EVENTS = "payload"  # picks and releases are never thinned out


class LiveView:
    """Serves what `bus` carries until it is closed. robot: its description. host, port: where; port 0 takes a free one.

    Raises:
        BusError: the port cannot be had.
    """

    def __init__(self, bus: Bus, robot: Robot, host: str, port: int) -> None:
        self._inboxes = {topic: bus.subscribe(topic, clock=sending) for topic in topics_of(OF_DELTA)}
        self._context = context = foxglove.Context()  # channels do not keep it alive

        def channel(name: str, kind: RosType) -> foxglove.Channel:
            schema = foxglove.Schema(name=kind.name, encoding="ros2msg", data=kind.text.encode())
            return foxglove.Channel(name, message_encoding="cdr", schema=schema, context=context)

        self._channels = {
            topic: channel(topic_name(robot.name, topic), ros_type(message))
            for topic, message in topics_of(OF_DELTA).items()
        }
        self._scene, self._shape_at = ViewerScene(robot), 0
        self._drawn = {name: channel(name, kind) for name, kind in self._scene.topics.items()}
        self.shown = 0
        try:
            self._server = foxglove.start_server(
                name=f"deltatwin {robot.name}", host=host, port=port, context=context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise BusError(f"{host}:{port}: {_why_not(host, port) or error}") from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def step(self) -> None:
        """Pass on what came since the last call."""
        for topic, inbox in self._inboxes.items():
            records, times = inbox.take()
            if not len(records):
                continue
            stride = max(1, round(len(records) / (MOST_HZ * PERIOD_S)))
            chosen = np.arange(len(records) - 1, -1, -stride)[::-1]
            if topic == _EVENTS:
                chosen = np.union1d(chosen, np.flatnonzero(records["event"]))
            for k in chosen:
                self._channels[topic].log(records[k : k + 1].tobytes(), log_time=int(times[k]))
            self.shown += len(chosen)
            if topic == "sample":
                self._draw(records[-1], int(times[-1]))

    def _draw(self, sample: np.void, now: int) -> None:
        messages = list(self._scene.state(sample))
        if now >= self._shape_at:
            self._shape_at = now + SHAPE_NS
            messages.append(self._scene.shapes())
        for name, data in messages:
            self._drawn[name].log(data, log_time=now)

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *raised: object) -> None:
        self._server.stop()


def _why_not(host: str, port: int) -> str:
    """Why the system lets nobody listen there; empty where it does."""
    try:
        kind, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(kind, socket.SOCK_STREAM) as tried:
            tried.bind(place)
    except OSError as error:
        of_port = error.errno in (errno.EADDRINUSE, errno.EACCES)
        remedy = "--port 0 takes a free one" if of_port else "--host takes an address of this machine"
        return f"{error.strerror}; {remedy}"
    return ""


def run(view: LiveView, stopped: Callable[[], bool]) -> None:
    """Serve until `stopped` or Ctrl-C."""
    while not stopped():
        time.sleep(PERIOD_S)
        view.step()
