"""An arm as identified, as a URDF and in MuJoCo's terms: bodies that can be, which explain what was identified."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from defusedxml.ElementTree import fromstring

from schemas.chain import Chain
from schemas.errors import RobotError
from schemas.files import read_bytes
from schemas.urdf import MAX_BYTES
from service.machines.consistent import Bodies, bodies_near
from service.machines.files import MachineFile, figures, finish
from service.model.description import base_errors, base_of
from service.model.mechanism import SerialArm

if TYPE_CHECKING:
    import mujoco

FAR = 3.0  # standard errors that bodies may miss a parameter by, before it is said
THICK = 0.12  # of a link's length, its radius as drawn
THINNEST = 0.015  # m


@dataclass(frozen=True)
class Identified:
    """carriers: link of the URDF of each joint, in the log's order, that has its body's identified part. found: those
    bodies and the rotors. load: (n,) N m. differs: (n,) rms of the torque that these bodies need less that of the
    parameters, over that of the parameters, at any poses and speeds. lean: parameters that the bodies miss."""

    carriers: tuple[str, ...]
    found: Bodies
    load: np.ndarray
    differs: np.ndarray
    lean: dict[str, float]


def identified_bodies(chain: Chain) -> Identified:
    """Bodies near those of the URDF that explain the identified parameters, each on the heaviest link of its joint;
    what is fixed to it stays as described.

    Raises:
        RobotError: the URDF cannot be read.
    """
    mechanism, base = SerialArm.of(chain), base_of(chain)
    arm = mechanism.arm
    carriers = _carriers(chain, mechanism)
    described = np.array([_described(chain, link) for link in carriers])
    onto = np.hstack([arm.body_on(link) for link in carriers])  # (10 n, 10 n)
    names, turning = list(mechanism.coefficients), len(mechanism.frictions)
    if not mechanism.asked:  # the masses stand as described, only rotors and constant loads were identified
        told, _ = mechanism.told(base.rigid)
        values = np.array(list(told.values()))
        found = Bodies(described, np.maximum(values[:turning], 0.0), np.zeros(len(names)))
        return Identified(carriers, found, values[turning:], np.zeros(chain.count), {})
    shares = mechanism.shares
    links = shares[:, -len(arm.weights) :]
    others = links @ (arm.weights - onto @ described.ravel())
    offsets = shares[:, turning : turning + chain.count]
    told, _ = mechanism.told(base.rigid)
    load = np.array(list(told.values()))[turning:]
    errors = np.full(len(names), np.inf)
    known = base_errors(chain)[: len(names)]
    errors[known > 0] = known[known > 0]
    if chain.identified is None:  # the URDF's own
        errors[:] = 1e-6
    found = bodies_near(described, links @ onto, shares[:, :turning], base.rigid - others - offsets @ load, errors)
    made = shares @ np.r_[found.rotors, load, arm.weights + onto @ (found.bodies - described).ravel()]
    torque = mechanism.rigid(*arm.poses())
    off = torque.columns @ (made - base.rigid)
    needed = torque.torque(base.rigid)
    differs = np.sqrt(np.mean(off**2, axis=0) / np.mean(needed**2, axis=0))
    lean = {name: float(z) for name, z in zip(names, found.off, strict=True) if abs(z) > FAR}
    return Identified(carriers, found, load, differs, lean)


def to_urdf(chain: Chain) -> MachineFile:
    """The URDF of the description with identified bodies, damping and friction of its joints, all else as it was.

    Raises:
        RobotError: the URDF cannot be read.
    """
    bodies = identified_bodies(chain)
    root = fromstring(read_bytes(chain.arm.path, MAX_BYTES, RobotError), forbid_dtd=True)
    _write_into(root, chain, bodies)
    text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
    left_out = {entry.name: "a URDF has no word for it" for entry in chain.effect}
    return MachineFile(text, _figures(chain, bodies), left_out, _said(bodies))


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
        raise RobotError(f"{chain.arm.path}: MuJoCo does not take it: {cause}") from cause
    return MachineFile(spec.to_xml(), _figures(chain, bodies), left_out, _said(bodies))


def _carriers(chain: Chain, mechanism: SerialArm) -> tuple[str, ...]:
    """The heaviest link of each joint's body, in the log's order."""
    masses = {link: _described(chain, link)[0] for link in chain.arm.links}
    result = []
    for joint in range(chain.count):
        own = np.array([name.endswith(f"_{joint + 1}") for name in mechanism.arm.names])
        of_joint = [link for link in masses if mechanism.arm.body_on(link)[own].any()]
        result.append(max(of_joint, key=lambda link: masses[link]))
    return tuple(result)


def _described(chain: Chain, name: str) -> np.ndarray:
    """(10,) `A_LINK` about the frame of a link, as its <inertial> says."""
    import pinocchio

    root = fromstring(chain.arm.text)
    link = next(one for one in root.findall("link") if one.get("name") == name)
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(10)
    mass, inertia, origin = (inertial.find(key) for key in ("mass", "inertia", "origin"))
    if mass is None or inertia is None or float(mass.get("value", "0")) == 0.0:
        return np.zeros(10)
    place = np.zeros(3) if origin is None else _three(origin.get("xyz"))
    turned = np.eye(3) if origin is None else pinocchio.rpy.rpyToMatrix(*_three(origin.get("rpy")))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    about = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
    return pinocchio.Inertia(float(mass.get("value", "0")), place, about).toDynamicParameters()


def _three(text: str | None) -> np.ndarray:
    return np.array([float(value) for value in (text or "0 0 0").split()])


def _write_into(root: Any, chain: Chain, bodies: Identified) -> None:
    """Put bodies and friction into the links and joints of a URDF."""
    import pinocchio

    base = base_of(chain)
    links = {link.get("name"): link for link in root.findall("link")}
    for name, body in zip(bodies.carriers, bodies.found.bodies, strict=True):
        inertia = pinocchio.Inertia.FromDynamicParameters(body)
        for old in links[name].findall("inertial"):
            links[name].remove(old)
        written = ElementTree.SubElement(links[name], "inertial")
        xyz = " ".join(f"{value:.9g}" for value in inertia.lever)
        ElementTree.SubElement(written, "origin", {"xyz": xyz, "rpy": "0 0 0"})
        ElementTree.SubElement(written, "mass", {"value": f"{inertia.mass:.9g}"})
        about = inertia.inertia
        keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        ElementTree.SubElement(written, "inertia", {key: f"{about[place]:.9g}" for key, place in keys.items()})
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for number, name in enumerate(chain.joints):
        for old in joints[name].findall("dynamics"):
            joints[name].remove(old)
        friction = {"damping": f"{base.viscous[number]:.6g}", "friction": f"{base.coulomb[number]:.6g}"}
        ElementTree.SubElement(joints[name], "dynamics", friction)


def _figures(chain: Chain, bodies: Identified) -> str:
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


def _said(bodies: Identified) -> list[str]:
    """How near the bodies come, and what they miss."""
    worst = int(np.argmax(bodies.differs))
    said = [
        f"bodies on {', '.join(bodies.carriers)}: their torque differs from that of the identified parameters by "
        f"{100 * bodies.differs[worst]:.2g} % rms on joint {worst + 1}, less on the others"
    ]
    if bodies.lean:
        told = ", ".join(f"{name} by {abs(off):.1f}" for name, off in bodies.lean.items())
        said.append(f"no bodies have these parameters, the nearest miss {told} standard errors: log more motion")
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
