"""A URDF, as far as a description of an arm needs it: read with care, since it comes from elsewhere, and held against
the joints that are logged. What it weighs and how it moves is Pinocchio's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import ParseError, tostring

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from schemas.errors import RobotError
from schemas.files import read_bytes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_BYTES = 4 << 20  # the longest in use, a humanoid with its meshes' names, has 300 kB
TURNS = ("revolute", "continuous")


@dataclass(frozen=True)
class Urdf:
    """text: the arm alone, every joint but the logged ones fixed. links: names. limits: (low, high) rad of each logged
    joint, most: its speed rad/s and torque N m, without end where it has none."""

    path: Path
    text: str
    links: tuple[str, ...]
    limits: tuple[tuple[float, float], ...]
    most: tuple[tuple[float, float], ...]


def read_urdf(path: Path, logged: Sequence[str], held: Sequence[str]) -> Urdf:
    """Read a URDF. logged: joints that a log has, in its order. held: joints that stood still at their zero.

    Raises:
        RobotError: it is no URDF; a joint that it does not have, that does not turn, that follows another or floats; a
            joint that moves and is neither logged nor held; a logged joint that nothing with a mass hangs on.
    """
    root = _root(path)
    joints = {_text(path, joint, "name"): joint for joint in root.findall("joint")}
    links = {_text(path, link, "name"): link for link in root.findall("link")}
    _check_ends(path, joints, links)
    _check_joints(path, joints, logged, held)
    _massive(path, joints, links, logged)
    most = tuple(_most(path, name, joints[name]) for name in logged)
    limits = tuple(_prepared(path, name, joints[name]) for name in logged)
    for name in held:
        joints[name].set("type", "fixed")
    for link in links.values():
        for part in ("visual", "collision"):
            for shape in link.findall(part):
                link.remove(shape)
    return Urdf(path, tostring(root, encoding="unicode"), tuple(links), limits, most)


def _check_ends(path: Path, joints: Mapping[str, Element], links: Mapping[str, Element]) -> None:
    for name, joint in joints.items():
        for end in ("parent", "child"):
            if _text(path, joint, "link", end) not in links:
                raise RobotError(f"{path}: joint {name!r}: its {end} {_text(path, joint, 'link', end)!r} is not a link")


def _check_joints(path: Path, joints: Mapping[str, Element], logged: Sequence[str], held: Sequence[str]) -> None:
    """Whether each joint is as its being logged, held or neither asks for."""
    moving = [name for name, joint in joints.items() if joint.get("type") != "fixed"]
    for name in (*logged, *held):
        if name not in joints:
            raise RobotError(f"{path}: no joint {name!r}; those that move: {', '.join(moving) or 'none'}")
    for name in moving:
        _check_moving(path, name, joints[name], name in logged)
    if loose := [name for name in moving if name not in logged and name not in held]:
        named = ", ".join(map(repr, loose))
        verb, it, was = ("moves", "it", "it was") if len(loose) == 1 else ("move", "them", "they were")
        raise RobotError(
            f"{path}: joint{'s' * (len(loose) > 1)} {named} {verb}, too: name {it} in `joints`, in the order of the "
            f"log, or in `held` if {was} at rest at zero"
        )
    for name in logged:
        if name not in moving:
            raise RobotError(f"{path}: joint {name!r} is fixed; those that move: {', '.join(moving) or 'none'}")


def _check_moving(path: Path, name: str, joint: Element, logged: bool) -> None:
    kind, follows = joint.get("type"), joint.find("mimic")
    if kind in ("floating", "planar"):
        raise RobotError(f"{path}: joint {name!r} is {kind}: the arm's base must be fixed")
    if logged and follows is not None:
        raise RobotError(
            f"{path}: joint {name!r} follows {follows.get('joint')!r} (mimic) and has no torque of its own: leave it "
            "out of `joints`"
        )
    if logged and kind not in TURNS:
        raise RobotError(f"{path}: joint {name!r} is {kind}; only joints that turn are supported")


def turning_joints(path: Path) -> list[str]:
    """Names of the joints of a URDF that turn and have a torque of their own, in its order.

    Raises:
        RobotError: it is no URDF.
    """
    joints = _root(path).findall("joint")
    return [_text(path, one, "name") for one in joints if one.get("type") in TURNS and one.find("mimic") is None]


def moving_joints(path: Path) -> list[str]:
    """Names of all joints of a URDF that move, in its order.

    Raises:
        RobotError: it is no URDF.
    """
    return [_text(path, one, "name") for one in _root(path).findall("joint") if one.get("type") != "fixed"]


def _root(path: Path) -> Element:
    try:
        root = fromstring(read_bytes(path, MAX_BYTES, RobotError), forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, RecursionError) as cause:
        raise RobotError(f"{path}: not a URDF: {cause}") from cause
    if root.tag != "robot":
        raise RobotError(f"{path}: not a URDF: it starts with <{root.tag}>, not with <robot>")
    return root


def _massive(path: Path, joints: dict[str, Any], links: dict[str, Any], logged: Sequence[str]) -> None:
    """Whether something with a mass hangs on each logged joint before the next."""
    below: dict[str, list[str]] = {}
    for name, joint in joints.items():
        if name not in logged:
            below.setdefault(_text(path, joint, "link", "parent"), []).append(_text(path, joint, "link", "child"))
    masses = {name: _mass(path, name, link) for name, link in links.items()}
    for name in logged:
        first = _text(path, joints[name], "link", "child")
        body, todo = set(), [first]
        while todo:
            link = todo.pop()
            if link not in body:
                body.add(link)
                todo += below.get(link, [])
        if not any(masses[link] > 0 for link in body):
            raise RobotError(f"{path}: link {first!r} moves with joint {name!r} and has no mass (<inertial>)")


def _mass(path: Path, name: str, link: Element) -> float:
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    mass = _number(path, inertial, "value", "mass", f"link {name!r}")
    if mass < 0:
        raise RobotError(f"{path}: link {name!r}: mass {mass:g} kg")
    for key in ("ixx", "iyy", "izz"):
        moment = _number(path, inertial, key, "inertia", f"link {name!r}")
        if moment < 0:
            raise RobotError(f"{path}: link {name!r}: {key} {moment:g} kg m^2")
    return mass


def _prepared(path: Path, name: str, joint: Element) -> tuple[float, float]:
    """The limits of a joint, whose type becomes revolute."""
    limit = joint.find("limit")
    endless = joint.get("type") == "continuous" or limit is None or not {"lower", "upper"} & set(limit.keys())
    joint.set("type", "revolute")
    if limit is None:
        limit = joint.makeelement("limit", {"effort": "0", "velocity": "0"})
        joint.append(limit)
    if endless:
        return -math.inf, math.inf
    low, high = (_number(path, joint, key, "limit", f"joint {name!r}", 0.0) for key in ("lower", "upper"))
    return low, high


def _most(path: Path, name: str, joint: Element) -> tuple[float, float]:
    """Speed and torque of a joint; none and zero, which some writers take for none, are without end."""
    found = (_number(path, joint, key, "limit", f"joint {name!r}", 0.0) for key in ("velocity", "effort"))
    speed, effort = (value if value > 0 else math.inf for value in found)
    return speed, effort


def _number(path: Path, element: Element, key: str, child: str, where: str, default: float | None = None) -> float:
    found = element.find(child)
    text = None if found is None else found.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotError(f"{path}: {where}: <{child} {key}> is {text!r}, a number is needed")
    return value


def _text(path: Path, element: Element, key: str, child: str = "") -> str:
    found = element.find(child) if child else element
    text = None if found is None else found.get(key)
    if not text:
        what = f"<{child}> of {element.get('name')!r}" if child else f"<{element.tag}>"
        raise RobotError(f"{path}: {what} has no {key!r}")
    return text
