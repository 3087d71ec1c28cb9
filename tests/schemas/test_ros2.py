"""The messages as ROS 2 has them, by another implementation of its type system and encoding (rosbags)."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

import schemas
from schemas.messages import (
    TOPICS,
    FeedforwardSource,
    FindingVerdict,
    Gripper,
    HealthFlag,
    Message,
    PayloadEvent,
    Role,
    SampleFlag,
    StopReason,
    WatchState,
    fields_of,
    set_stamp,
)
from schemas.ros2 import type_hash
from schemas.zenoh_keys import topic_name

FOLDER = Path(schemas.__file__).parent


ENUMS = {  # message, prefix of its constants: what it is in Python
    ("Sample", "FLAG_"): SampleFlag,
    ("Sample", "GRIPPER_"): Gripper,
    ("Feedforward", "SOURCE_"): FeedforwardSource,
    ("Payload", "EVENT_"): PayloadEvent,
    ("Health", "ROLE_"): Role,
    ("Health", "FLAG_"): HealthFlag,
    ("Health", "REASON_"): StopReason,
    ("Gap", "STATE_"): WatchState,
    ("Finding", "VERDICT_"): FindingVerdict,
}


def typestore(message: Message) -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg((FOLDER / "msg" / f"{message.name}.msg").read_text(), message.schema_name))
    return store


@pytest.mark.parametrize("message", TOPICS.values(), ids=TOPICS.keys())
def test_constants_are_the_enumerations(message: Message) -> None:
    constants = {name: value for name, _, value in typestore(message).fielddefs[message.schema_name][0]}
    expected = {
        f"{prefix}{one.name}": one.value
        for (name, prefix), enum in ENUMS.items()
        if name == message.name
        for one in enum
    }
    assert constants == expected


@pytest.mark.parametrize("message", TOPICS.values(), ids=TOPICS.keys())
def test_type_hash_is_that_of_another_implementation(message: Message) -> None:
    assert type_hash(message) == typestore(message).hash_rihs01(message.schema_name)
    longer = replace(message, text=f"{message.text}uint32 more\n")
    assert type_hash(longer) != type_hash(message) == type_hash(replace(message, text=f"# more\n{message.text}"))


@pytest.mark.parametrize("topic", TOPICS)
def test_bytes_are_what_ros_2_writes(topic: str) -> None:
    message = TOPICS[topic]
    store = typestore(message)
    record = message.empty(1)
    rng = np.random.default_rng(1)
    for name in record.dtype.names or ():
        if name not in ("cdr_header", "frame_id") and record[name].dtype.kind in "uf":
            record[name] = rng.integers(1, 100, record[name].shape)
    set_stamp(record, np.array([1_700_000_000_123_456_789]))
    theirs: Any = store.deserialize_cdr(record.tobytes(), message.schema_name)
    assert theirs.header.frame_id == ""
    assert theirs.header.stamp.sec == 1_700_000_000
    for name in record.dtype.names or ():
        if hasattr(theirs, name):
            np.testing.assert_array_equal(getattr(theirs, name), record[name][0], err_msg=name)
    assert bytes(store.serialize_cdr(theirs, message.schema_name)) == record.tobytes()


def test_package_is_one_that_colcon_finds() -> None:
    package = ElementTree.parse(FOLDER / "package.xml").getroot()
    assert package.findtext("name") == "deltatwin_msgs" == TOPICS["sample"].schema_name.split("/")[0]
    used = {field.type.split("/")[0] for message in TOPICS.values() for field in fields_of(message.text)} & {"std_msgs"}
    assert used == {node.text for node in package.iter("depend")}
    build = (FOLDER / "CMakeLists.txt").read_text()
    assert all(f"find_package({name} REQUIRED)" in build and f"DEPENDENCIES {name}" in build for name in used)
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    assert "project(deltatwin_msgs)" in build
    assert {path.stem for path in (FOLDER / "msg").glob("*.msg")} == {message.name for message in TOPICS.values()}


@pytest.mark.parametrize(
    ("robot", "topic"),
    [("d3", "d3"), ("d3-1200", "d3_1200"), ("a.-b-", "a_b"), ("3d", "robot_3d"), ("rl5__6kg", "rl5_6kg")],
)
def test_topics_are_names_that_ros_2_takes(robot: str, topic: str) -> None:
    name = topic_name(robot, "sample")
    assert name == f"/deltatwin/{topic}/sample"
    assert re.fullmatch(r"(/[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*)+", name)  # rmw_validate_full_topic_name, no "__"
