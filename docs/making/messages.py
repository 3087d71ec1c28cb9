"""Reference pages of the messages, flags and keys on the bus, from their definitions."""

from __future__ import annotations

import enum
import re
from collections.abc import Iterator
from typing import Any

from docs.making.markdown import cell, code, prose, table
from drivers.security.rights import readers, writers
from schemas import messages
from schemas.messages import SAMPLES, TOPICS, Message, Role

_FIELD = re.compile(r"^(?P<type>[\w/]+(?:\[\d+\])?)\s+(?P<name>[a-z]\w*)\s*(?:#\s*(?P<said>.*))?$")
_CONSTANT = re.compile(r"^\w+\s+(?P<name>[A-Z]\w*)\s*=\s*(?P<value>-?\d+)\s*(?:#\s*(?P<said>.*))?$")
ENUMS = (
    messages.SampleFlag, messages.HealthFlag, messages.StopReason, messages.Role, messages.Gripper,
    messages.FeedforwardSource, messages.PayloadEvent, messages.WatchState, messages.FindingVerdict,
)  # fmt: skip


def _matches(pattern: re.Pattern[str], text: str) -> Iterator[dict[str, Any]]:
    for line in text.splitlines():
        found = pattern.match(line.strip())
        if found:
            yield found.groupdict(default="")


def page(topic: str) -> str:
    """One topic: who writes and reads it, its fields, its constants, its definition."""
    message: Message = TOPICS[topic]
    first = message.text.splitlines()[0].lstrip("# ")
    write, read = (
        ", ".join(role.name.lower() for role in roles) for roles in (writers(topic, Role.TAP), readers(topic))
    )
    if topic in SAMPLES:
        write = "one of tap, player and robot"
    dtype = message.dtype
    rows = []
    for field in _matches(_FIELD, message.text):
        offset = dtype.fields[field["name"] if field["name"] != "header" else "stamp_sec"][1] if dtype.fields else 0
        rows.append([code(field["name"]), code(field["type"]), str(offset), cell(field["said"])])
    text = f"# {topic}\n\n{first}\n\n"
    text += table(
        ["", ""],
        [
            ["Key", code(f"deltatwin/<robot>/{topic}")], ["ROS 2 type", code(message.schema_name)],
            ["Size", f"{dtype.itemsize} bytes, CDR header included"], ["Written by", write], ["Read by", read],
        ],
    )  # fmt: skip
    text += "\n## Fields\n\n" + table(["Field", "Type", "Byte", "Meaning"], rows)
    constants = list(_matches(_CONSTANT, message.text))
    if constants:
        rows = [[code(one["name"]), one["value"], cell(one["said"])] for one in constants]
        text += "\n## Constants\n\n" + table(["Name", "Value", "Meaning"], rows)
    return text + f"\n## Definition\n\n`schemas/msg/{message.name}.msg`:\n\n```text\n{message.text}```\n"


def index() -> str:
    """All topics."""
    text = (
        "# Messages\n\nMessages are ROS 2 messages in CDR, on the bus and in the log. All begin with a "
        "`std_msgs/Header` whose stamp is bus time; `frame_id` is empty. [Flags and states](../flags.md) are constants "
        "of the messages.\n\n"
    )
    rows = [
        [f"[`{topic}`]({topic}.md)", code(message.schema_name), cell(message.text.splitlines()[0].lstrip("# "))]
        for topic, message in TOPICS.items()
    ]
    return text + table(["Topic", "Type", "Meaning"], rows)


def flags() -> str:
    """Every flag and state with its meaning."""
    import inspect

    text = ["# Flags and states\n", "Bits of `flags` add up: 20 is `GAP_BEFORE` (4) and `TIME_BACKWARDS` (16).\n"]
    for kind in ENUMS:
        said = _beside(inspect.getsource(kind))
        rows = [
            [code(member.name), str(int(member)), cell(said.get(str(member.name), ""))] for member in _members(kind)
        ]
        text.append(f"## {kind.__name__}\n\n{prose(kind.__doc__)}\n" + table(["Name", "Value", "Meaning"], rows))
    return "\n".join(text)


def _members(kind: type[enum.IntEnum] | type[enum.IntFlag]) -> list[Any]:
    return sorted(kind, key=int)


def _beside(source: str) -> dict[str, str]:
    found = re.findall(r"^ {4}([A-Z_]+) = \d+(?:  # (.*))?$", source, re.MULTILINE)
    return dict(found)
