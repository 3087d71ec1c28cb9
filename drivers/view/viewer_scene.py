"""The robot for viewers as ROS 2 has it: joint states, the transforms of its parts and their shapes as a URDF.

The same messages in the live view and in recordings, so that both show the robot, in RViz too. URDF knows no closed
chain: forearms and platform float, and stand where their transforms say.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as xml
from collections.abc import Iterator

import numpy as np

from schemas.errors import PoseError
from schemas.messages import CDR_LITTLE_ENDIAN, NESTED, SAMPLE
from schemas.robot import Robot
from schemas.ros2 import RosType
from schemas.zenoh_keys import robot_key
from service.model.kinematics import forward
from service.model.nominal import pack

TRANSFORMS = "/tf"  # one topic for all robots: its frames carry the robot's name


def _with(text: str, **inside: str) -> str:
    parts = {name.replace("__", "/"): part for name, part in inside.items()} | NESTED
    return text + "".join(f"{'=' * 80}\nMSG: {name}\n{part}" for name, part in parts.items())


JOINT_STATE = RosType(
    "sensor_msgs/msg/JointState",
    _with("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"),
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
)
TF_MESSAGE = RosType(
    "tf2_msgs/msg/TFMessage",
    _with(
        "geometry_msgs/TransformStamped[] transforms\n",
        geometry_msgs__TransformStamped=(
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        ),
        geometry_msgs__Transform="geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        geometry_msgs__Vector3="float64 x\nfloat64 y\nfloat64 z\n",
        geometry_msgs__Quaternion="float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    ),
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)
STRING = RosType(
    "std_msgs/msg/String", "string data\n", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)


class ViewerScene:
    """What a viewer has to be told of `robot`. topics: the name of each topic and what its messages are."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._frame = f"{robot_key(robot.name)}_"
        own = f"/deltatwin/{robot_key(robot.name)}"
        self._states, self._shapes = f"{own}/joint_states", f"{own}/robot_description"
        self.topics = {self._states: JOINT_STATE, TRANSFORMS: TF_MESSAGE, self._shapes: STRING}
        for _ in self.state(SAMPLE.empty(1)[0]):  # what is compiled takes a second to load: not behind the first sample
            pass

    def shapes(self) -> tuple[str, bytes]:
        """Topic and message of the URDF; who comes later needs it again."""
        return self._shapes, _Cdr().text(urdf(self._robot)).data()

    def state(self, sample: np.void) -> Iterator[tuple[str, bytes]]:
        """Topics and messages of one SAMPLE; without transforms where it is no pose of the robot."""
        stamp = int(sample["stamp_sec"]), int(sample["stamp_nanosec"])
        cdr = _Cdr().header(stamp, "").number(3)
        for joint in range(3):
            cdr.text(f"{self._frame}arm{joint}")
        for values in (sample["position"], (), sample["torque"]):
            cdr.number(len(values)).floats(values)
        yield self._states, cdr.data()
        try:
            parts = transforms(self._robot, np.asarray(sample["position"], np.float64))
        except PoseError:
            return
        cdr = _Cdr().number(len(parts))
        for name, place in parts.items():
            cdr.header(stamp, f"{self._frame}base").text(f"{self._frame}{name}").floats(place)
        yield TRANSFORMS, cdr.data()


def transforms(robot: Robot, theta: np.ndarray) -> dict[str, np.ndarray]:
    """Where the parts stand in the base frame at (3,) rad: x, y, z in m and quaternion x, y, z, w of each.

    arm: at the hip, x along it. forearm: at the elbow, x towards the wrist. platform: its centre.

    Raises:
        PoseError: no pose of the robot.
    """
    platform = forward(pack(robot), theta[None])[0]
    if not np.isfinite(platform).all():
        raise PoseError(f"no pose at {theta}")
    arms, forearms = {}, {}
    for joint, azimuth in enumerate(robot.arm_angles):
        angle = theta[joint] + robot.geometry.joint_offset_rad[joint]
        length = robot.geometry.active_link_length + robot.geometry.active_link_length_error[joint]
        out, down = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([0.0, 0.0, -1.0])
        hip = robot.geometry.base_radius * out
        elbow = hip + length * (np.cos(angle) * out + np.sin(angle) * down)
        arms[f"arm{joint}"] = np.concatenate([hip, _turn(azimuth, angle)])
        x, y, z = platform + robot.geometry.platform_radius * out - elbow
        turn = _turn(np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y)))
        forearms[f"forearm{joint}"] = np.concatenate([elbow, turn])
    return arms | forearms | {"platform": np.array([*platform, 0.0, 0.0, 0.0, 1.0])}


def urdf(robot: Robot) -> str:
    """Shapes of all parts of `robot`: base and platform discs, arms and forearms bars along x."""
    frame, geometry = f"{robot_key(robot.name)}_", robot.geometry
    root = xml.Element("robot", name=robot_key(robot.name))
    bars = {"arm": (geometry.active_link_length, 0.02), "forearm": (geometry.passive_link_length, 0.008)}
    shape(root, f"{frame}base", geometry.base_radius, 0.02)
    shape(root, f"{frame}platform", geometry.platform_radius, 0.02)
    for joint in range(3):
        for name, (length, radius) in bars.items():
            shape(root, f"{frame}{name}{joint}", radius, length, along_x=True)
    for link in [element.get("name", "") for element in root.iter("link")][1:]:
        floating = xml.SubElement(root, "joint", name=link, type="floating")
        xml.SubElement(floating, "parent", link=f"{frame}base")
        xml.SubElement(floating, "child", link=link)
    return xml.tostring(root, encoding="unicode")


def shape(root: xml.Element, name: str, radius: float, length: float, along_x: bool = False) -> None:
    """Add a link that is a cylinder, m, along x from the link's origin, or upright about it."""
    visual = xml.SubElement(xml.SubElement(root, "link", name=name), "visual")
    turn, middle = ("0 1.5707963 0", f"{length / 2:.6g} 0 0") if along_x else ("0 0 0", "0 0 0")
    xml.SubElement(visual, "origin", xyz=middle, rpy=turn)
    xml.SubElement(xml.SubElement(visual, "geometry"), "cylinder", radius=f"{radius:.6g}", length=f"{length:.6g}")


def _turn(azimuth: float, angle: float) -> np.ndarray:
    """Quaternion x, y, z, w: `angle` about y, down from the horizontal, then `azimuth` about z."""
    (a, b), (c, d) = ((np.cos(half), np.sin(half)) for half in (azimuth / 2, angle / 2))
    return np.array([-b * d, a * d, b * c, a * c])


class _Cdr:
    """Bytes of a message as CDR has them, little-endian, put in one by one."""

    def __init__(self) -> None:
        self._body = bytearray()

    def number(self, value: int) -> _Cdr:
        self._align(4)
        self._body += struct.pack("<I", value)
        return self

    def text(self, value: str) -> _Cdr:
        encoded = value.encode() + b"\0"
        self.number(len(encoded))
        self._body += encoded
        return self

    def floats(self, values: np.ndarray | tuple[float, ...]) -> _Cdr:
        if len(values):
            self._align(8)
            self._body += struct.pack(f"<{len(values)}d", *values)
        return self

    def header(self, stamp: tuple[int, int], frame: str) -> _Cdr:
        self._align(4)
        self._body += struct.pack("<iI", *stamp)
        return self.text(frame)

    def data(self) -> bytes:
        return CDR_LITTLE_ENDIAN + bytes(self._body)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
