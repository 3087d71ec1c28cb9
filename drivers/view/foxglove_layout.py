"""The Foxglove layout of one robot: torques, model errors, payload, the robot, health. Live and for recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence

from schemas.zenoh_keys import robot_key, topic_name

SECONDS = 10.0  # that the live plots show


def layout(robot: str) -> str:
    """A layout file, JSON, for the topics of `robot`."""

    def path(topic: str, field: str) -> str:
        return f"{topic_name(robot, topic)}.{field}"

    panels = {
        "3D!robot": _scene(robot),
        "Plot!torque": _plot(
            "torque / N m",
            *((path("sample", f"torque[{j}]"), f"measured {j + 1}") for j in range(3)),
            *((path("feedforward", f"torque[{j}]"), f"feed-forward {j + 1}") for j in range(3)),
        ),
        "Plot!error": _plot("torque less model / N m", *((path("error", f"full[{j}]"), str(j + 1)) for j in range(3))),
        "Plot!payload": _plot(
            "payload / kg", (path("payload", "mass"), "mass"), (path("payload", "trusted"), "trusted (1)")
        ),
        "Plot!position": _plot(
            "position / rad", *((path("sample", f"position[{j}]"), f"joint {j + 1}") for j in range(3))
        ),
        "RawMessages!health": {"topicPath": topic_name(robot, "health")},
    }
    return json.dumps(
        {
            "configById": panels,
            "globalVariables": {},
            "userNodes": {},
            "playbackConfig": {"speed": 1},
            "layout": _split(
                "row",
                _split("column", "3D!robot", "RawMessages!health"),
                _split("column", "Plot!torque", "Plot!error", "Plot!payload", "Plot!position"),
            ),
        },
        indent=1,
    )


def _scene(robot: str) -> dict[str, object]:
    """The robot as its URDF shows it."""
    shapes = {
        "instanceId": "robot",
        "layerId": "foxglove.Urdf",
        "label": robot,
        "visible": True,
        "sourceType": "topic",
        "topic": f"/deltatwin/{robot_key(robot)}/robot_description",
        "controlMode": "transforms",
    }
    frame = f"{robot_key(robot)}_base"
    return {
        "followTf": frame,
        "fixedFrame": frame,
        "followMode": "follow-none",
        "layers": {"robot": shapes},
        "cameraState": {
            "perspective": True,
            "distance": 3.0,
            "phi": 75.0,
            "thetaOffset": 30.0,
            "targetOffset": [0.0, 0.0, -0.5],
        },
    }


def _plot(title: str, *paths: tuple[str, str]) -> dict[str, object]:
    """paths: where the values are, and their label."""
    series = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime"} for value, label in paths
    ]
    return {
        "foxglovePanelTitle": title,
        "paths": series,
        "xAxisVal": "timestamp",
        "showLegend": True,
        "isSynced": True,
        "timeWindowMode": "sliding",
        "followingViewWidth": SECONDS,
    }


def _split(direction: str, *parts: object) -> object:
    """Parts beside or below each other, equal in size, as nested pairs."""
    first, *rest = parts
    if not rest:
        return first
    others: Sequence[object] = rest
    return {
        "direction": direction,
        "first": first,
        "second": _split(direction, *others),
        "splitPercentage": 100 / len(parts),
    }
