"""The messages as ROS 2 has them, by another implementation of its type system and encoding (rosbags)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import schemas
from schemas.messages import TOPICS, set_stamp

FOLDER = Path(schemas.__file__).parent


@pytest.mark.parametrize("topic", TOPICS)
def test_bytes_are_what_ros_2_writes(topic: str) -> None:
    message = TOPICS[topic]
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg((FOLDER / "msg" / f"{message.name}.msg").read_text(), message.schema_name))
    record = message.empty(1)
    rng = np.random.default_rng(1)
    for name in record.dtype.names or ():
        if name not in ("cdr_header", "sec", "nanosec") and record[name].dtype.kind in "uf":
            record[name] = rng.integers(1, 100, record[name].shape)
    set_stamp(record, np.array([1_700_000_000_123_456_789]))
    theirs: Any = store.deserialize_cdr(record.tobytes(), message.schema_name)
    assert theirs.stamp.sec == 1_700_000_000
    for name in record.dtype.names or ():
        if hasattr(theirs, name):
            np.testing.assert_array_equal(getattr(theirs, name), record[name][0], err_msg=name)
    assert bytes(store.serialize_cdr(theirs, message.schema_name)) == record.tobytes()


def test_package_is_one_that_colcon_finds() -> None:
    package = ElementTree.parse(FOLDER / "package.xml").getroot()
    assert package.findtext("name") == "deltatwin_msgs" == TOPICS["sample"].schema_name.split("/")[0]
    assert "builtin_interfaces" in [node.text for node in package.iter("depend")]
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    assert "project(deltatwin_msgs)" in (FOLDER / "CMakeLists.txt").read_text()
    assert {path.stem for path in (FOLDER / "msg").glob("*.msg")} == {message.name for message in TOPICS.values()}
