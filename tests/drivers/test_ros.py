"""The bus in the keys of ROS 2 (rmw_zenoh), heard and spoken to by a node whose keys, tokens and attachments another
implementation makes, through a router as ROS 2 has one."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drivers import bus as bus_module
from drivers.bus import Publisher, open_bus
from drivers.security.certificates import make_keys, parse_hosts
from schemas.errors import BusError
from schemas.messages import FEEDFORWARD, REFERENCE, SAMPLE, Role, set_stamp

attachment = pytest.importorskip("zenoh_ros2_sdk.attachment")
entity, keyexpr, qos = (pytest.importorskip(f"zenoh_ros2_sdk.{name}") for name in ("entity", "keyexpr", "qos"))

ROBOT, DOMAIN = "d3-1200", 7


def until(done: Callable[[], object], longest: float = 20.0) -> None:
    end = time.monotonic() + longest
    while not done():
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.01)


def session(mode: str, listen: str, connect: list[str]) -> zenoh.Session:
    """As rmw_zenoh's own configurations have it: no multicast, gossip, a router that passes nothing on by itself."""
    settings = {
        "mode": mode,
        "listen": {"endpoints": [listen]},
        "connect": {"endpoints": connect},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "routing": {"router": {"peers_failover_brokering": False}},
        "timestamping": {"enabled": True},
        "transport": {"shared_memory": {"enabled": False}},  # takes the right to lock memory
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


@pytest.fixture
def node(bus_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[zenoh.Session]:
    """The session of a ROS 2 node, beside a router on a free port of loopback which the bus knows."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        router = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setattr(bus_module, "ROUTER", router)
    with session("router", router, []), session("peer", "tcp/127.0.0.1:0", [router]) as made:
        yield made


def names(topic: str, message: Any) -> tuple[str, str, str]:
    """ROS 2 name, DDS type and type hash of a topic."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(message.text, message.schema_name))
    kind = f"deltatwin_msgs::msg::dds_::{message.name}_"
    return f"/deltatwin/d3_1200/{topic}", kind, store.hash_rihs01(message.schema_name)


def test_a_node_hears_and_is_heard(node: zenoh.Session) -> None:
    samples, references = SAMPLE.empty(5), REFERENCE.empty(5)
    samples["sequence"] = references["sequence"] = np.arange(5)
    set_stamp(samples, np.arange(5) * 1_000_000)
    heard = node.declare_subscriber(
        keyexpr.topic_keyexpr(DOMAIN, *names("sample", SAMPLE)), zenoh.handlers.FifoChannel(99)
    )
    asks = node.declare_publisher(keyexpr.topic_keyexpr(DOMAIN, *names("reference", REFERENCE)))
    with (
        open_bus(ROBOT, Role.PLAYER, ros_domain=DOMAIN) as player,
        open_bus(ROBOT, Role.ESTIMATOR, ros_domain=DOMAIN) as estimator,
    ):
        publisher, inbox = player.publisher("sample"), estimator.subscribe("reference")
        own = estimator.subscribe("sample")
        until(lambda: publisher.heard and Publisher(asks).heard)
        until(lambda: Role.ESTIMATOR in player.alive)
        before = time.time_ns()
        for sample, reference in zip(samples, references, strict=True):
            publisher.put(sample.tobytes())
            asks.put(reference.tobytes(), attachment=attachment.Attachment(1, before, bytes(16)).to_bytes())
        got = [heard.recv() for _ in samples]
        assert [sample.payload.to_bytes() for sample in got] == [sample.tobytes() for sample in samples]
        attached = [sample.attachment.to_bytes() for sample in got if sample.attachment]
        notes = [attachment.Attachment.from_bytes(data) for data in attached]
        assert [note.to_bytes() for note in notes] == attached
        assert [note.sequence_id for note in notes] == [1, 2, 3, 4, 5]
        assert all(before <= note.timestamp_ns <= time.time_ns() for note in notes)
        assert {len(note.gid) for note in notes} == {16}
        assert len({note.gid for note in notes}) == 1
        taken: list[bytes] = []
        until(lambda: taken.extend(record.tobytes() for record in inbox.take()[0]) or len(taken) == 5)
        assert taken == [reference.tobytes() for reference in references]
        until(lambda: own.wait(0.1))
        assert inbox.rejected == own.rejected == 0


def test_the_graph_sees_roles_with_their_topics(node: zenoh.Session) -> None:
    def tokens() -> set[str]:
        found = node.liveliness().get(f"@ros2_lv/{DOMAIN}/**", timeout=1.0)
        return {str(reply.ok.key_expr) for reply in found if reply.ok}

    with open_bus(ROBOT, Role.ESTIMATOR, ros_domain=DOMAIN) as bus:
        bus.publisher("feedforward")
        bus.subscribe("sample")
        zid = str(bus._session.info.zid())
        own = entity.NodeEntity(DOMAIN, zid, 0, "estimator", "/deltatwin/d3_1200")
        quality = qos.QosProfile().encode()
        ends = [
            entity.EndpointEntity(own, 1, entity.EntityKind.PUBLISHER, *names("feedforward", FEEDFORWARD), quality),
            entity.EndpointEntity(own, 2, entity.EntityKind.SUBSCRIPTION, *names("sample", SAMPLE), quality),
        ]
        expected = {keyexpr.node_liveliness_keyexpr(own)} | {keyexpr.endpoint_liveliness_keyexpr(end) for end in ends}
        until(lambda: tokens() == expected)
    until(lambda: not tokens())


def test_keys_for_our_own_topics_are_refused(bus_folder: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", parse_hosts("127.0.0.1"), "bench", Role.TAP)
    config = next((tmp_path / "keys").rglob("estimator.json5"))
    with pytest.raises(BusError, match=r"estimator\.json5: its access control is for the keys of deltatwin, not for"):
        open_bus("bench", Role.ESTIMATOR, config, ros_domain=DOMAIN)
