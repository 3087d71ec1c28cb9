"""The live view as a client of the Foxglove WebSocket protocol sees it."""

from __future__ import annotations

import asyncio
import json
import re
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from drivers.bus import open_bus
from drivers.view.layout import layout
from drivers.view.scene import skeleton
from schemas.messages import PAYLOAD, SAMPLE, TOPICS, PayloadEvent, Role, fields_of
from schemas.robot import load_robot

COUNT = 400
PICK = 137


def test_arms_and_forearms_have_their_lengths() -> None:
    robot = load_robot("d3-1200")
    for theta in ([0.1, 0.2, 0.3], [-0.2, 0.6, 0.4]):
        arms, platform = skeleton(robot, np.array(theta))
        lengths = np.linalg.norm(np.diff(arms, axis=1), axis=2)
        np.testing.assert_allclose(lengths[:, 0], robot.geometry.active_link_length)
        np.testing.assert_allclose(lengths[:, 1], robot.geometry.passive_link_length, rtol=1e-9)
        np.testing.assert_allclose(lengths[:, 2], robot.geometry.platform_radius)
        assert (arms[:, 3, 2] < -0.1).all()  # the platform hangs below the base
        np.testing.assert_array_equal(platform[0], platform[3])


def test_layout_names_fields_that_the_messages_have() -> None:
    text = layout("d3-1200")
    paths = re.findall(r'\\"/deltatwin/d3_1200/(\w+)\\"\.(\w+)', text)
    assert len(paths) >= 14
    for topic, field in paths:
        assert field in [one.name for one in fields_of(TOPICS[topic].text)]
    panels = json.loads(text)["configById"]
    assert set(re.findall(r'"((?:Plot|3D|RawMessages)!\w+)"', json.dumps(json.loads(text)["layout"]))) == set(panels)


def test_a_client_gets_the_messages_as_they_are_and_the_robot(bus_folder: Path, bench_robot: Path) -> None:
    pytest.importorskip("foxglove")
    from drivers.view.server import LiveView

    robot = load_robot(bench_robot)
    samples, payloads = SAMPLE.empty(COUNT), PAYLOAD.empty(COUNT)
    samples["sequence"] = payloads["sequence"] = np.arange(COUNT)
    samples["position"] = 0.2 + 0.1 * np.sin(np.arange(COUNT) / 50)[:, None]
    samples["torque"] = np.arange(COUNT)[:, None]
    payloads["event"][PICK] = PayloadEvent.PICK

    async def look(view: LiveView) -> tuple[dict[str, dict], dict[str, list[tuple[int, bytes]]]]:
        request = HTTPRequest(f"ws://127.0.0.1:{view.port}")
        client = await websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
        channels: dict[str, dict] = {}
        got: dict[str, list[tuple[int, bytes]]] = {}
        while len(channels) < len(TOPICS) + 1:
            message = await asyncio.wait_for(client.read_message(), 20)
            assert message is not None
            if isinstance(message, str) and json.loads(message)["op"] == "advertise":
                channels |= {channel["topic"]: channel for channel in json.loads(message)["channels"]}
        topics = {channel["id"]: topic for topic, channel in channels.items()}
        await client.write_message(
            json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in topics]})
        )
        await asyncio.sleep(0.5)
        for topic, records in (("sample", samples), ("payload", payloads)):
            publisher = publishers[topic]
            for k in range(COUNT):
                publisher.put(records[k : k + 1].tobytes())
        give_up = time.monotonic() + 20
        while time.monotonic() < give_up and not {"sample", "payload", "scene"} <= {t.split("/")[-1] for t in got}:
            view.step()
            try:
                message = await asyncio.wait_for(client.read_message(), 0.3)
            except TimeoutError:
                continue
            while message is not None:
                if isinstance(message, bytes) and message[0] == 1:
                    number, stamp = struct.unpack_from("<IQ", message, 1)
                    got.setdefault(topics[number], []).append((stamp, message[13:]))
                try:
                    message = await asyncio.wait_for(client.read_message(), 0.5)
                except TimeoutError:
                    break
        client.close()
        return channels, got

    with (
        open_bus(robot.name, Role.PLAYER) as player,
        open_bus(robot.name, Role.OBSERVER) as bus,
        LiveView(bus, robot, "127.0.0.1", 0) as view,
    ):
        publishers = {topic: player.publisher(topic) for topic in ("sample", "payload")}
        assert all(publisher.wait_until_heard(10.0) for publisher in publishers.values())
        channels, got = asyncio.run(look(view))
    sample = f"/deltatwin/{robot.name}/sample"
    assert channels[sample]["schemaEncoding"] == "ros2msg"
    assert channels[sample]["schema"] == SAMPLE.schema_text
    sent = {records.tobytes() for records in np.split(samples, COUNT)}
    assert {data for _, data in got[sample]} <= sent
    assert 5 <= len(got[sample]) < COUNT  # thinned
    assert all(abs(stamp - time.time_ns()) < 60e9 for stamp, _ in got[sample])
    events = [np.frombuffer(data, PAYLOAD.dtype)["event"][0] for _, data in got[f"/deltatwin/{robot.name}/payload"]]
    assert events.count(PayloadEvent.PICK) == 1
    assert channels[f"/deltatwin/{robot.name}/scene"]["schemaName"] == "foxglove.SceneUpdate"
    assert b"robot" in got[f"/deltatwin/{robot.name}/scene"][-1][1]
