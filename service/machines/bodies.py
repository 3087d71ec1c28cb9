"""Bodies of an arm that can be and explain its identified parameters: what a URDF, a simulator and the forward motion
need, where the parameters alone may ask for less inertia than nothing."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from defusedxml.ElementTree import fromstring

from schemas.chain_description import Chain
from service.machines.consistent import Bodies, bodies_near
from service.model.arm import body_of, pseudo_inertia
from service.model.description import base_errors, base_of
from service.model.mechanism import SerialArm

FAR = 3.0  # standard errors that bodies may miss a parameter by, before it is said


@dataclass(frozen=True)
class IdentifiedBodies:
    """carriers: link of the URDF of each joint, in the log's order, that has its body's identified part. found: those
    bodies and the rotors. load: (n,) N m. weights: (10 n,) of the arm with them. differs: (n,) rms of the torque that
    they need less that of the parameters, over that of the parameters, at any poses, speeds and accelerations. missed:
    rms standard errors that they are off the parameters; lean: parameters that they miss, by how many."""

    carriers: tuple[str, ...]
    found: Bodies
    load: np.ndarray
    weights: np.ndarray
    differs: np.ndarray
    missed: float = 0.0
    lean: dict[str, float] = field(default_factory=dict)


def identified_bodies(chain: Chain) -> IdentifiedBodies:
    """Bodies near those of the URDF that explain the identified parameters, each on the heaviest link of its joint;
    what is fixed to it stays as described. Without parameters, and where the masses are known, those described."""
    mechanism, base = SerialArm.of(chain), base_of(chain)
    arm, turning = mechanism.arm, len(mechanism.frictions)
    carriers = _carriers(chain, mechanism)
    described = np.array([_described(chain, link) for link in carriers])
    told, weights = mechanism.told(base.rigid)
    values = np.array(list(told.values()))
    rotors, load = np.maximum(values[:turning], 0.0), values[turning:]
    if chain.identified is None or not mechanism.asked:
        found = Bodies(described, rotors, np.zeros(len(base.rigid)))
        return IdentifiedBodies(carriers, found, load, weights, np.zeros(chain.count))
    onto = np.hstack([arm.body_on(link) for link in carriers])  # (10 n, 10 n)
    links, names = mechanism.shares[:, -len(arm.weights) :], list(mechanism.coefficients)
    fixed = links @ (arm.weights - onto @ described.ravel())
    fixed += mechanism.shares[:, turning : turning + chain.count] @ load
    known = base_errors(chain)[: len(names)]
    errors = np.where(known > 0, known, np.inf)
    found = bodies_near(described, links @ onto, mechanism.shares[:, :turning], base.rigid - fixed, errors)
    weights = arm.weights + onto @ (found.bodies - described).ravel()
    made = mechanism.shares @ np.r_[found.rotors, load, weights]
    torque = mechanism.rigid(*arm.poses())
    off, needed = torque.columns @ (made - base.rigid), torque.torque(base.rigid)
    differs = np.sqrt(np.mean(off**2, axis=0) / np.mean(needed**2, axis=0))
    lean = {name: float(z) for name, z in zip(names, found.off, strict=True) if abs(z) > FAR}
    weights = weights + mechanism.known  # of a payload
    return IdentifiedBodies(carriers, found, load, weights, differs, float(np.sqrt(np.mean(found.off**2))), lean)


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
    root = fromstring(chain.arm.text)
    link = next(one for one in root.findall("link") if one.get("name") == name)
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(10)
    mass, inertia, origin = (inertial.find(key) for key in ("mass", "inertia", "origin"))
    if mass is None or inertia is None or float(mass.get("value", "0")) == 0.0:
        return np.zeros(10)
    place = np.zeros(3) if origin is None else _three(origin.get("xyz"))
    turned = np.eye(3) if origin is None else _turned(*_three(origin.get("rpy")))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    about = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
    placed = np.eye(4)
    placed[:3, 3] = place
    own = np.r_[float(mass.get("value", "0")), 0.0, 0.0, 0.0, about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    return body_of(placed @ pseudo_inertia(own) @ placed.T)


def _three(text: str | None) -> np.ndarray:
    return np.array([float(value) for value in (text or "0 0 0").split()])


def _turned(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(3, 3) of a URDF's angles, rad."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
