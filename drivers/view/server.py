"""The bus of one robot as a Foxglove WebSocket server: messages as they are, and the robot as a scene.

All topics have one clock, the time at which a message was put on the bus. Only `MOST_HZ` messages of a topic a second
are passed on, evenly chosen: who looks does not see more, and what runs beside it needs the processor.
"""

from __future__ import annotations

import time
from types import TracebackType

import foxglove
import numpy as np
from foxglove.channels import SceneUpdateChannel
from foxglove.messages import (
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    SceneEntity,
    SceneUpdate,
    Timestamp,
)

from drivers.bus import Bus, sending
from drivers.view.layout import scene_topic
from drivers.view.scene import skeleton
from schemas.errors import BusError, PoseError
from schemas.keys import topic_name
from schemas.messages import NANOSECONDS, TOPICS
from schemas.robot import Robot

PERIOD_S = 0.05  # between two looks at the bus
MOST_HZ = 200.0  # of a topic; a screen shows 60
BACKLOG = 4096  # messages kept for a client that is slow; the oldest go first
_EVENTS = "payload"  # picks and releases are never thinned out
_ARM, _PLATFORM = Color(r=0.25, g=0.45, b=0.85, a=1.0), Color(r=0.9, g=0.5, b=0.1, a=1.0)


class LiveView:
    """Serves what `bus` carries until it is closed. robot: its description. host, port: where; port 0 takes a free one.

    Raises:
        BusError: the port cannot be had.
    """

    def __init__(self, bus: Bus, robot: Robot, host: str, port: int) -> None:
        self._robot = robot
        self._inboxes = {topic: bus.subscribe(topic, clock=sending) for topic in TOPICS}
        self._context = context = foxglove.Context()  # channels do not keep it alive
        self._channels = {
            topic: foxglove.Channel(
                topic_name(robot.name, topic),
                message_encoding="cdr",
                schema=foxglove.Schema(name=message.schema_name, encoding="ros2msg", data=message.schema_text.encode()),
                context=context,
            )
            for topic, message in TOPICS.items()
        }
        self._scene = SceneUpdateChannel(scene_topic(robot.name), context=context)
        self.shown = 0
        try:
            self._server = foxglove.start_server(
                name=f"deltatwin {robot.name}", host=host, port=port, context=context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise BusError(f"{host}:{port}: {error}") from error

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
                self._draw(records[-1]["position"], int(times[-1]))

    def _draw(self, theta: np.ndarray, now: int) -> None:
        try:
            arms, platform = skeleton(self._robot, np.asarray(theta, np.float64))
        except PoseError:
            return  # a sample that is no pose has its flag; there is nothing to draw
        if not (np.isfinite(arms).all()):
            return
        lines = [_line(points[:3], 0.02, _ARM) for points in arms] + [_line(platform, 0.015, _PLATFORM)]
        stamp = Timestamp(now // NANOSECONDS, now % NANOSECONDS)
        entity = SceneEntity(timestamp=stamp, frame_id="base", id="robot", lines=lines)
        self._scene.log(SceneUpdate(entities=[entity]), log_time=now)

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.stop()


def run(view: LiveView) -> None:
    """Serve until interrupted."""
    while True:
        time.sleep(PERIOD_S)
        view.step()


def _line(points: np.ndarray, thickness: float, color: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        thickness=thickness,
        points=[Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in points],
        color=color,
    )
