"""An arm as identified, as a URDF and in MuJoCo's terms: bodies that can be, which explain what was identified."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from defusedxml.ElementTree import fromstring

from schemas.chain_description import Chain
from schemas.errors import RobotError
from schemas.files import read_bytes
from schemas.urdf import MAX_BYTES
from service.machines.bodies import IdentifiedBodies, identified_bodies
from service.machines.exported import MachineFile, figures, finish
from service.model.arm import about_centre
from service.model.description import base_of
from service.model.mechanism import SerialArm

if TYPE_CHECKING:
    import mujoco

THICK = 0.12  # of a link's length, its radius as drawn
THINNEST = 0.015  # m


def to_urdf(chain: Chain) -> MachineFile:
    """The URDF of the description with identified bodies, damping and friction of its joints, all else as it was.

    Raises:
        RobotError: the URDF cannot be read.
    """
    bodies = identified_bodies(chain)
    root = fromstring(read_bytes(chain.arm.path, MAX_BYTES, RobotError), forbid_dtd=True)
    _write_into(root, chain, bodies)
    text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
    left_out = {entry.name: "a URDF cannot express it" for entry in chain.effect}
    return MachineFile(text, _figures(chain, bodies), left_out, _said(chain, bodies))


def to_mjcf(chain: Chain) -> MachineFile:
    """The arm in MuJoCo's terms: joints as in the URDF, actuators `drive_<joint>` that take the torque of a log.

    Raises:
        RobotError: MuJoCo does not take the URDF.
    """
    import mujoco

    bodies = identified_bodies(chain)
    root = fromstring(chain.arm.text)
    _write_into(root, chain, bodies)
    for joint in root.findall("joint"):
        for dynamics in joint.findall("dynamics"):  # given below, with what a URDF has no word for
            joint.remove(dynamics)
    options = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    options.attrib |= {"fusestatic": "false", "balanceinertia": "false", "discardvisual": "false"}
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        _draw(spec)
        spec.option.gravity = chain.gravity_mps2
        left_out = finish(spec, chain, chain.joints, bodies.found.rotors, bodies.load)
        spec.compile()
    except ValueError as cause:
        raise RobotError(f"{chain.arm.path}: MuJoCo does not accept it: {cause}") from cause
    return MachineFile(spec.to_xml(), _figures(chain, bodies), left_out, _said(chain, bodies))


def _write_into(root: Any, chain: Chain, bodies: IdentifiedBodies) -> None:
    """Put bodies and friction into the links and joints of a URDF."""
    base = base_of(chain)
    links = {link.get("name"): link for link in root.findall("link")}
    for name, body in zip(bodies.carriers, bodies.found.bodies, strict=True):
        mass, x, y, z, *about = about_centre(body).tolist()
        for old in links[name].findall("inertial"):
            links[name].remove(old)
        written = ElementTree.SubElement(links[name], "inertial")
        ElementTree.SubElement(written, "origin", {"xyz": f"{x:.9g} {y:.9g} {z:.9g}", "rpy": "0 0 0"})
        ElementTree.SubElement(written, "mass", {"value": f"{mass:.9g}"})
        moments = zip(("ixx", "ixy", "iyy", "ixz", "iyz", "izz"), about, strict=True)
        ElementTree.SubElement(written, "inertia", {key: f"{value:.9g}" for key, value in moments})
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for number, name in enumerate(chain.joints):
        for old in joints[name].findall("dynamics"):
            joints[name].remove(old)
        friction = {"damping": f"{base.viscous[number]:.6g}", "friction": f"{base.coulomb[number]:.6g}"}
        ElementTree.SubElement(joints[name], "dynamics", friction)


def _figures(chain: Chain, bodies: IdentifiedBodies) -> str:
    mechanism = SerialArm.of(chain)
    motors = [f"rotor_{number}" for number in range(1, chain.count + 1)] + [f"inertia_{m}" for m in mechanism.shared]
    more = {
        "rotor_inertia_kgm2": dict(zip(motors, bodies.found.rotors.tolist(), strict=True)),
        "constant_load_nm": dict(zip(chain.joints, bodies.load.tolist(), strict=True)),
        "bodies_on_links": list(bodies.carriers),
        "torque_of_bodies_differs": dict(zip(chain.joints, bodies.differs.tolist(), strict=True)),
        "missed_std_errors": bodies.lean,
    }
    return figures(chain, more)


def _said(chain: Chain, bodies: IdentifiedBodies) -> list[str]:
    """How near the bodies come, and what they miss."""
    said = [
        f"bodies on {', '.join(bodies.carriers)} explain the identified parameters within {bodies.missed:.2g} standard "
        "errors rms"
    ]
    if chain.payload is not None:
        said.append(f"the payload on {chain.payload.frame} is not in the file")
    if bodies.lean:
        told = ", ".join(f"{name} by {abs(off):.1f}" for name, off in bodies.lean.items())
        said.append(
            f"no physical bodies have these parameters; the nearest ones differ in {told} standard errors: record more "
            "motion"
        )
    return said


def _draw(spec: mujoco.MjSpec) -> None:
    """A capsule from each joint to the next, which touches nothing."""
    import mujoco

    for body in spec.bodies[1:]:
        ends = [np.array(child.pos) for child in body.bodies] or [np.nan_to_num(body.ipos)]  # a frame has no centre
        for end in ends:
            length = float(np.linalg.norm(end))
            shape = body.add_geom(mass=0.0, contype=0, conaffinity=0)
            shape.size = [max(THICK * length, THINNEST), 0.0, 0.0]
            if length > THINNEST:
                shape.type, shape.fromto = mujoco.mjtGeom.mjGEOM_CAPSULE, [0.0, 0.0, 0.0, *end]
            else:
                shape.type = mujoco.mjtGeom.mjGEOM_SPHERE
