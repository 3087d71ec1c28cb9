"""The live view as a client of the Foxglove WebSocket protocol sees it."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import re
import socket
import struct
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from drivers.bus import open_bus
from drivers.trace.tables import read_table
from drivers.view.foxglove_layout import layout
from drivers.view.viewer_scene import ViewerScene, transforms
from schemas.errors import BusError, TraceError
from schemas.messages import OF_DELTA, PAYLOAD, SAMPLE, TOPICS, PayloadEvent, Role, fields_of, set_stamp, topics_of
from schemas.robot import load_robot
from service.monitor.recording import RecordingWriter

COUNT = 400
PICK = 137


@pytest.mark.parametrize("theta", [[0.1, 0.2, 0.3], [-0.2, 0.6, 0.4]])
def test_arms_and_forearms_meet(theta: list[float]) -> None:
    robot = load_robot("d3-1200")
    parts = transforms(robot, np.array(theta))
    platform = parts["platform"][:3]
    assert platform[2] < -0.1  # it hangs below the base
    for joint, azimuth in enumerate(robot.arm_angles):
        out = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        ends = []
        for name, length in (
            ("arm", robot.geometry.active_link_length),
            ("forearm", robot.geometry.passive_link_length),
        ):
            part = parts[f"{name}{joint}"]
            ends.append(part[:3] + length * Rotation.from_quat(part[3:]).as_matrix()[:, 0])
        np.testing.assert_allclose(parts[f"arm{joint}"][:3], robot.geometry.base_radius * out, atol=1e-12)
        np.testing.assert_allclose(ends[0], parts[f"forearm{joint}"][:3], atol=1e-12)
        np.testing.assert_allclose(ends[1], platform + robot.geometry.platform_radius * out, atol=1e-9)
        down = parts[f"arm{joint}"][2] - ends[0][2]
        assert down == pytest.approx(robot.geometry.active_link_length * np.sin(theta[joint]))


def test_the_robot_is_told_in_messages_of_ros_2() -> None:
    """Names, texts, hashes and bytes against another implementation; every frame of the URDF has its transform."""
    store = get_typestore(Stores.ROS2_JAZZY)
    robot, sample = load_robot("d3-1200"), SAMPLE.empty(1)
    sample["position"], sample["torque"] = [0.1, 0.2, 0.3], [1.0, -2.0, 3.0]
    set_stamp(sample, 12_500_000_000)
    scene = ViewerScene(robot)
    told = dict([*scene.state(sample[0]), scene.shapes()])
    assert told.keys() == scene.topics.keys()
    read: dict[str, Any] = {}
    for topic, kind in scene.topics.items():
        assert store.hash_rihs01(kind.name) == kind.type_hash
        own = get_types_from_msg(kind.text, kind.name)
        assert {name: fields for name, (_, fields) in own.items()} == {name: store.fielddefs[name][1] for name in own}
        read[topic] = store.deserialize_cdr(told[topic], kind.name)
        assert bytes(store.serialize_cdr(read[topic], kind.name)) == told[topic]
    states = read["/deltatwin/d3_1200/joint_states"]
    assert (states.header.stamp.sec, states.header.stamp.nanosec) == (12, 500_000_000)
    assert states.name == ["d3_1200_arm0", "d3_1200_arm1", "d3_1200_arm2"]
    assert (states.position.tolist(), states.effort.tolist()) == ([0.1, 0.2, 0.3], [1.0, -2.0, 3.0])
    assert len(states.velocity) == 0
    shapes = ElementTree.fromstring(read["/deltatwin/d3_1200/robot_description"].data)
    frames = {transform.child_frame_id for transform in read["/tf"].transforms}
    assert {link.get("name") for link in shapes.iter("link")} == frames | {"d3_1200_base"}
    assert {transform.header.frame_id for transform in read["/tf"].transforms} == {"d3_1200_base"}
    sample["position"] = np.nan
    assert [topic for topic, _ in scene.state(sample[0])] == ["/deltatwin/d3_1200/joint_states"]


def test_a_recording_shows_what_the_live_view_shows(tmp_path: Path) -> None:
    """At 1 kHz for 2 s in batches of 20 ms: the robot 20 times a second, its shapes once, at the samples' times."""
    robot, samples = load_robot("d3-1200"), SAMPLE.empty(2000)
    samples["sequence"], samples["position"] = np.arange(2000), 0.2
    log = 1_790_000_000_000_000_000 + np.arange(2000) * 1_000_000
    set_stamp(samples, np.arange(2000) * 1_000_000)
    recording = RecordingWriter(tmp_path / "run.mcap", robot.name, ViewerScene(robot))
    for first in range(0, 2000, 20):
        recording.write("sample", samples[first : first + 20], log[first : first + 20])
    recording.close()
    with Reader(tmp_path / "run.mcap") as bag:
        counts = {topic: found.msgcount for topic, found in bag.topics.items()}
        drawn = [stamp for connection, stamp, _ in bag.messages() if connection.topic == "/tf"]
    assert counts["/tf"] == counts["/deltatwin/d3_1200/joint_states"] == len(drawn)
    assert 30 <= len(drawn) <= 40
    assert counts["/deltatwin/d3_1200/robot_description"] == 1
    assert set(drawn) <= set(log.tolist())
    with pytest.raises(TraceError, match=r"run\.mcap: a log of deltatwin already"):  # not 40 joint states for a log
        read_table(tmp_path / "run.mcap")
    panels = json.loads(layout(robot.name))["configById"]
    asked = {re.split(r"[.]", path["value"])[0] for panel in panels.values() for path in panel.get("paths", [])}
    asked |= {panels["3D!robot"]["layers"]["robot"]["topic"], panels["RawMessages!health"]["topicPath"]}
    assert asked <= counts.keys()


def test_layout_names_fields_that_the_messages_have() -> None:
    text = layout("d3-1200")
    paths = re.findall(r'"/deltatwin/d3_1200/(\w+)\.(\w+)', text)
    assert len(paths) >= 14
    for topic, field in paths:
        assert field in [one.name for one in fields_of(TOPICS[topic].text)]
    panels = json.loads(text)["configById"]
    assert set(re.findall(r'"((?:Plot|3D|RawMessages)!\w+)"', json.dumps(json.loads(text)["layout"]))) == set(panels)


def test_layout_has_the_settings_that_foxglove_has() -> None:
    """Against the builder of layouts in Foxglove's own SDK, where it knows the panels; titles are the app's key."""
    known = pytest.importorskip("foxglove.layouts")

    def check(found: dict[str, Any], kind: Any, but: tuple[str, ...] = ()) -> None:
        assert found.keys() - set(but) <= kind()._to_dict().keys()
        builder = {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", key).lower(): key for key in found}
        names = {field.name: str(field.type) for field in dataclasses.fields(kind)}
        for name, key in builder.items():
            choices = re.search(r"Literal\[(.*?)\]", names.get(name, ""), re.S)
            if choices and isinstance(found[key], str):
                assert f'"{found[key]}"' in choices[1].replace("'", '"'), key

    for name, panel in json.loads(layout("d3-1200"))["configById"].items():
        kind = {"Plot": known.PlotConfig, "3D": known.ThreeDeeConfig, "RawMessages": known.RawMessagesConfig}
        check(panel, kind[name.split("!")[0]], ("foxglovePanelTitle",))
        for series in panel.get("paths", []):
            check(series, known.PlotSeries)
        for layer in panel.get("layers", {}).values():
            check(layer, known.BaseRendererUrdfLayerSettings)
        if "cameraState" in panel:
            check(panel["cameraState"], known.ThreeDeeCameraState)


@pytest.mark.parametrize(
    ("host", "said"),
    [
        ("300.1.1.1", r"300.1.1.1:\d+: Name or service not known; --host takes an address of this machine$"),
        ("192.0.2.1", r"192.0.2.1:\d+: Cannot assign requested address; --host takes an address of this machine$"),
        ("127.0.0.1", r"127.0.0.1:\d+: Address already in use; --port 0 takes a free one$"),
    ],
)
def test_where_nobody_can_listen_is_told_as_the_system_does(
    bus_folder: Path, bench_robot: Path, host: str, said: str
) -> None:
    pytest.importorskip("foxglove")
    from drivers.view.server import LiveView

    robot = load_robot(bench_robot)
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        open_bus(robot.name, Role.OBSERVER) as bus,
        pytest.raises(BusError, match=f"^{said}"),
    ):
        LiveView(bus, robot, host, other.getsockname()[1])


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
        while len(channels) < len(topics_of(OF_DELTA)) + 3:
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
        # Both ends have come: a step may find that the bus still holds some back.
        last = {f"/deltatwin/{robot.name}/sample": samples, f"/deltatwin/{robot.name}/payload": payloads}
        while time.monotonic() < give_up and not (
            {"/tf", f"/deltatwin/{robot.name}/robot_description"} <= set(got)
            and all(records[-1].tobytes() in (data for _, data in got.get(t, [])) for t, records in last.items())
        ):
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
    assert channels["/tf"]["schemaName"] == "tf2_msgs/msg/TFMessage"
    poses: Any = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(got["/tf"][-1][1], "tf2_msgs/msg/TFMessage")
    assert len(poses.transforms) == 7
    assert abs(got["/tf"][-1][0] - got[sample][-1][0]) < 1e9
    assert b"<robot" in got[f"/deltatwin/{robot.name}/robot_description"][0][1]
