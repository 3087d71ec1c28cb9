"""A description in a simulator's own terms: MuJoCo's closed chain, and the open chain of a URDF for viewers.

The forearm term of mass m_f is that of uniform rods of m_f; what point masses the base model has beyond them goes to
platform and active link, so that rho_1, rho_2 and forearm come out as they were identified:

    platform = M - 3/2 m_f,   about the joint: rho_1 I - m_f/2 l1^2,   first moment: rho_2 (m1/2 + m2) l1 - m_f/2 l1
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree as xml

import mujoco
import numpy as np

from drivers.simulated.plant.mujoco_delta import Design, build, centre_pose, close, specify
from drivers.simulated.plant.truth import PlantTruth
from drivers.view.viewer_scene import shape
from schemas.errors import RobotError
from schemas.robot import Robot
from service.estimator.named_effects import corrected
from service.model.description import base_of, terms_of
from service.model.effects.base import Effect, Inside
from service.model.elastic import gears_of
from service.model.hypothesis import Term, inside_of
from service.model.nominal import lengthened, pack
from service.model.signals import time_constant

STEP = 0.25e-3  # s
THICK, THIN = 0.02, 0.008  # m, half a disc's and a rod's radius, to look at
STEEL, LINK = [0.45, 0.47, 0.5, 1.0], [0.12, 0.44, 0.92, 1.0]  # red, green, blue, opacity
SMOOTH = 0.01  # rad/s over which the callback's friction turns, explicit as it is


@dataclass
class Export:
    """spec: the model. callback: Python that runs what MuJoCo has no word for, or None. by_callback: those effects.
    measured: those of them that are of the measurement. left_out: effect -> why neither has it."""

    spec: mujoco.MjSpec
    callback: str | None = None
    by_callback: list[str] = field(default_factory=list)
    measured: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def to_mjcf(robot: Robot) -> Export:
    """The closed chain of `robot` in MuJoCo's terms. Joints `arm<i>` turn as the encoders read, actuators `drive<i>`
    take the torque that a log reports, but for what the callback's `Measurement` does to both.

    Raises:
        RobotError: an effect that is not known, or parameters that no body can have.
    """
    terms, base = terms_of(robot), base_of(robot)
    changed, ratio, scale = corrected(robot)
    model, (rho_1, rho_2) = pack(changed), lengthened(base.rigid[0], base.rigid[1], ratio)
    amount = _amounts(terms)
    inside = inside_of(terms)
    forearm, length = float(base.rigid[2]), model.active_length
    more = amount("arm_mass", "delta_m")
    inertia = (
        rho_1 * model.inertia - forearm / 2 * length**2 + more * length**2 / 3 + amount("rotor_inertia", "delta_i")
    )
    moment = (rho_2 * model.link_mass * length) - forearm / 2 * length + more * length / 2
    platform = model.moving_mass - 1.5 * forearm + float(amount("tool_mass", "delta_m")[0])
    if platform <= 0 or (inertia <= 0).any():
        raise RobotError(
            f"robot {robot.name}: these values are physically impossible: platform {platform:.3g} kg, active links "
            f"{', '.join(f'{value:.3g}' for value in inertia)} kg m^2 about their joints"
        )
    gears = gears_of(model, base.rigid, inside.two_masses)[0]
    motor, stiffness, damping, half = (gears[name] for name in ("motor", "stiffness", "damping", "half"))
    drawn = np.maximum(robot.mass.active_link + more, 1e-3)
    link = np.where(motor > 0, inertia - motor, np.minimum(inertia, drawn * length**2 / 3))
    if (link <= 0).any():
        raise RobotError(f"robot {robot.name}: the motor has all of a joint's inertia: none remains for the link")
    mass = np.maximum(drawn, 2 * moment**2 / link)  # turning about a fixed axis, only moment and inertia are felt
    truth = PlantTruth.nominal(changed).model_copy(
        update={
            "active_link_kg": mass.tolist(),
            "active_link_centre_m": (moment / mass).tolist(),
            "active_link_inertia_kgm2": link.tolist(),
            "rotor_inertia_kgm2": np.maximum(inertia - link, 0.0).tolist(),
            "forearm_kg": [max(forearm, 1e-6)] * 3,
            "platform_kg": platform,
            "joint_offset_rad": [0.0, 0.0, 0.0],
        }
    )
    design = replace(Design(truth), drive_stiffness=tuple(np.where(motor > 0, np.maximum(stiffness, 1.0), 0.0)))
    spec = specify(design, STEP)
    spec.modelname = robot.name
    for i in range(3):
        turns = spec.joint(f"motor{i}" if motor[i] > 0 else f"arm{i}")
        turns.frictionloss = float(base.coulomb[i] - inside.bristle[i])
        _linear(turns, damping=float(base.viscous[i]))
        for name in {turns.name, f"arm{i}"}:
            spec.joint(name).ref = -float(model.joint_offset[i])
        if motor[i] > 0:
            _add_train(spec, i, float(stiffness[i]), float(damping[i]), float(half[i]))
        _add_drive(spec, i, turns, float(scale[i]), terms)
    _add_hose(spec, amount)
    _add_home(spec, design, model.joint_offset)
    _add_shapes(spec, truth)
    result = Export(spec)
    _callback(result, robot, terms, inside, max(SMOOTH, float(np.max(base.transition))))
    return result


def _add_drive(spec: mujoco.MjSpec, i: int, turns: mujoco.MjsJoint, scale: float, terms: tuple[Term, ...]) -> None:
    """The drive of motor i with what pulls at it: a spring of the joint, an offset of the torque, a lag."""
    amount = _amounts(terms)
    spring, preload = (float(amount("joint_spring", name)[i]) for name in ("k", "preload"))
    if spring > 0:
        _linear(turns, stiffness=spring)
        turns.springref = -preload / spring
    drive = spec.add_actuator(name=f"drive{i}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=turns.name)
    drive.set_to_motor()
    drive.gainprm[0] = 1.0 / scale
    push = -float(amount("torque_offset", "offset")[i]) - (preload if spring <= 0 else 0.0)
    if push:
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.biasprm[0] = push
    lag = sum(time_constant(term.nonlinear[0]) for term in terms if term.effect.name == "drive_lag")  # at most one
    if lag:
        drive.dyntype, drive.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag


def _add_hose(spec: mujoco.MjSpec, amount: Callable[[str, str], np.ndarray]) -> None:
    """A hose pulls at the platform as a spring with a pretension."""
    hose = amount("hose_spring", "k")[0]
    if hose > 0:
        for axis in "xyz":
            _linear(spec.joint(axis), stiffness=float(hose))
            spec.joint(axis).springref = float(-amount("hose_spring", f"force_{axis}")[0] / hose)


def _linear(part: mujoco.MjsJoint | mujoco.MjsTendon, **values: float) -> None:
    """Stiffness or damping, which MuJoCo 4 takes as a polynomial."""
    for name, value in values.items():
        setattr(part, name, value if np.isscalar(getattr(part, name)) else [value, 0.0, 0.0])


def _amounts(terms: tuple[Term, ...]):
    """(effect, amplitude) -> (3,) of the joints, or three times that of the whole robot; zero without the effect."""

    def amount(effect: str, name: str) -> np.ndarray:
        result = np.zeros(3)
        for term in terms:
            if term.effect.name == effect:
                column = list(term.effect.amplitudes).index(name)
                result[list(term.joints) or slice(None)] += term.amplitude[:, column]
        return result

    return amount


def _add_train(spec: mujoco.MjSpec, i: int, stiffness: float, damping: float, half: float) -> None:
    """A spring between motor and link, or the two ends of a gap."""
    train = spec.add_tendon(name=f"train{i}")
    train.wrap_joint(f"motor{i}", 1.0)
    train.wrap_joint(f"arm{i}", -1.0)
    if half > 0:
        train.limited, train.range = True, [-half, half]
        train.solref_limit = [2 * STEP, 1.0]
    else:
        _linear(train, stiffness=stiffness, damping=damping)
        train.springlength = [0.0, 0.0]


def _add_home(spec: mujoco.MjSpec, design: Design, offset: np.ndarray) -> None:
    """A keyframe with the links a little below the horizontal."""
    plain = build(design, STEP)
    pose = close(plain, centre_pose(design.truth)[None])[0]
    for i in range(3):
        pose[list({plain.arm[i], plain.motor[i]})] -= offset[i]
    spec.add_key(name="home", qpos=pose)


def _add_shapes(spec: mujoco.MjSpec, truth: PlantTruth) -> None:
    """What a viewer shows: links as rods, base and platform as discs, without mass or contact."""
    seen: dict[str, Any] = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 1}
    rod, disc = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER
    radius = float(np.mean(truth.base_radius_m))
    spec.worldbody.add_geom(name="base", type=disc, size=[radius, THICK, 0], rgba=STEEL, **seen)
    platform = spec.body("platform")
    platform.add_geom(name="platform", type=disc, size=[truth.platform_radius_m, THICK / 2, 0],
                      rgba=STEEL, **seen)  # fmt: skip
    for i in range(3):
        for body, length, size in (
            (f"arm{i}", truth.active_link_length_m[i], 2 * THIN),
            (f"rod{i}0", truth.passive_link_length_m[i], THIN),
            (f"rod{i}1", truth.passive_link_length_m[i], THIN),
        ):
            spec.body(body).add_geom(
                name=body, type=rod, fromto=[0, 0, 0, float(length), 0, 0], size=[size, 0, 0], rgba=LINK, **seen
            )


_HEAD = '''"""Effects of robot {name} that MuJoCo cannot express. Written by `deltatwin export`.

    effects = Effects(model)
    while ...:
        effects.apply(data)
        mujoco.mj_step(model, data)
"""

import math
from types import SimpleNamespace

GEAR_RATIO = {gear_ratio!r}
SMOOTH = {smooth!r}  # rad/s over which friction changes sign
BRISTLE, DISTANCE = {bristle!r}, {distance!r}  # N m of friction that builds up, over rad


def at_platform(now, k, x, y, z):
    """Along axis k: forces act on the platform itself."""
    return (x, y, z)[k]


{forms}
AT_JOINTS = [{at_joints}]
BY_LOAD = [{by_load}]
AT_PLATFORM = [{at_platform}]


class Effects:
    """Sets data.qfrc_applied of the joints and the platform; add your own forces after it."""

    def __init__(self, model):
        self.joints = [model.joint(name) for name in {joints!r}]
        self.dry = model.dof_frictionloss
        self.platform = [model.joint(axis) for axis in "xyz"]
        self.bristle = [0.0, 0.0, 0.0]
        self.last = [None, None, None]

    def slide(self, i, q, distance):
        """Bristles between -1 and 1: they bend before they slip."""
        step = 0.0 if self.last[i] is None else q - self.last[i]
        self.last[i] = q
        sign = 1.0 if step > 0.0 else -1.0
        self.bristle[i] = sign + (self.bristle[i] - sign) * math.exp(-abs(step) / distance)
        return self.bristle[i]

    def apply(self, data):
        q, place = ([float(data.qpos[one.qposadr[0]]) for one in part] for part in (self.joints, self.platform))
        v, velocity = ([float(data.qvel[one.dofadr[0]]) for one in part] for part in (self.joints, self.platform))
        now = SimpleNamespace(
            theta=q, theta_dot=v, direction=[math.tanh(speed / SMOOTH) for speed in v], load=[0.0, 0.0, 0.0],
            seconds=data.time, gear_ratio=GEAR_RATIO, pose=SimpleNamespace(position=place, velocity=velocity),
        )
        for i, joint in enumerate(self.joints):
            dof = joint.dofadr[0]
            torque = BRISTLE[i] * self.slide(i, q[i], DISTANCE[i])
            torque += sum(form(effect, now, i) for form, effect in AT_JOINTS)
            for form, effect in BY_LOAD:
                # the gear transmits the rest of the drive's torque: the load, and the friction that it causes
                left = float(data.qfrc_actuator[dof] + data.qfrc_passive[dof])
                now.load[i] = left = left - self.dry[dof] * now.direction[i] - torque
                torque += form(effect, now, i) / (1.0 + form(effect, now, i) / left) if left else 0.0
            data.qfrc_applied[dof] = -torque
        for k, axis in enumerate(self.platform):
            data.qfrc_applied[axis.dofadr[0]] = -sum(form(effect, now, k) for form, effect in AT_PLATFORM)
'''
# What a log shows of it: drives' torque `now` and motor angles `angle`, three values each.
_MEASUREMENT = '''

class Measurement:
    """Turns true values into those that a log shows."""

    def __init__(self, model):
        self.step = model.opt.timestep
        self.smooth, self.past = None, []

    def torque(self, torque):
        """Of the drives' torque, three values; call it once a step."""
        now = [float(value) for value in torque]
{torque}        return now

    def angle(self, angle):
        """Of the angles of the motors, three values."""
        read = angle = [float(value) for value in angle]
        for _ in range(4):  # the error of the angle is periodic in the angle that is read
            off = [0.0, 0.0, 0.0]
            for i, cosine, sine, order in {wobble!r}:
                turn = order * GEAR_RATIO * read[i]
                off[i] += cosine * math.cos(turn) + sine * math.sin(turn)
            read = [value - error for value, error in zip(angle, off)]
        return read
'''
_TORQUE_SHOWN = {
    "torque_filter": """        keep = math.exp(-2.0 * math.pi * {cutoff} * self.step)  # torque_filter
        last = now if self.smooth is None else self.smooth
        now = self.smooth = [keep * a + (1.0 - keep) * b for a, b in zip(last, now)]
""",
    "torque_delay": """        late = {delay} / self.step  # torque_delay
        self.past = [now, *self.past[: int(late) + 1]]
        k = min(int(late), len(self.past) - 1)
        before = self.past[min(k + 1, len(self.past) - 1)]
        now = [a + (late - int(late)) * (b - a) for a, b in zip(self.past[k], before)]
""",
}
_IN_THE_MODEL = {
    "rotor_inertia", "arm_mass", "tool_mass", "base_tilt", "joint_spring", "hose_spring", "link_length_error",
    "forearm_length_error", "base_radius_error", "azimuth_error", "joint_offset", "joint_elasticity", "backlash",
    "torque_scale", "torque_offset", "drive_lag",
}  # fmt: skip


def _form(effect: Effect) -> str:
    """The source of an effect's online form under the effect's name, with the constants of its file in it."""
    function: Any = getattr(effect.online, "py_func", None)
    text = inspect.getsource(function).partition("\n")[2].replace("_online(", f"{effect.name}(")  # without @kernel
    for name in function.__code__.co_names:
        if isinstance(value := function.__globals__.get(name), float):
            text = re.sub(rf"\b{name}\b", repr(value), text)
    return f"{text}\n"


def _is_free(form: str) -> bool:
    """Whether a form asks no more of a pose than where the platform is and how fast."""
    return set(re.findall(r"pose\.(\w+)", form)) <= {"position", "velocity"}


def _wobble(terms: tuple[Term, ...]) -> list[tuple[int, float, float, float]]:
    """Joint, cosine, sine, rad, and order of each encoder that runs out of centre."""
    return [
        (place, float(cosine), float(sine), term.nonlinear[0])
        for term in terms
        if term.effect.name == "encoder_eccentricity"
        for place, (cosine, sine) in zip(term.places, term.amplitude, strict=True)
    ]


def _callback(result: Export, robot: Robot, terms: tuple[Term, ...], inside: Inside, smooth: float) -> None:
    """Fill callback, by_callback, measured and left_out of `result`. smooth: rad/s over which friction turns."""
    forms: dict[str, str] = {}
    at: dict[str, list[str]] = {"at_joints": [], "by_load": [], "at_platform": []}
    torque = ""
    for term in terms:
        effect, name = term.effect, term.effect.name
        if name in _IN_THE_MODEL:
            continue
        if effect.online is not None and not effect.memory and _is_free(form := _form(effect)):
            forms[name] = form
            amplitude = np.zeros((3, len(effect.amplitudes)))
            amplitude[list(term.places)] = term.amplitude
            figures = {place: float(value) for place, value in np.ndenumerate(amplitude)}
            where = "by_load" if "now.load" in forms[name] else "at_joints"
            at[where if effect.own_joint else "at_platform"].append(
                f"({name}, SimpleNamespace(amplitude={figures!r}, nonlinear={term.nonlinear!r}))"
            )
        elif name == "torque_delay" and term.nonlinear[0] < 0:
            result.left_out[name] = "the log shows the torque early: shift the data that you compare with by this time"
            continue
        elif name in _TORQUE_SHOWN or name == "encoder_eccentricity":
            torque += _TORQUE_SHOWN.get(name, "").format(**dict(zip(effect.nonlinear, term.nonlinear, strict=True)))
            result.measured.append(name)
        elif name != "presliding_friction":
            result.left_out[name] = "neither MuJoCo nor the callback can express it"
            continue
        result.by_callback.append(name)
    if result.by_callback:
        split = {joint.name for joint in result.spec.joints if joint.name.startswith("motor")}
        head = _HEAD.format(
            name=robot.name,
            gear_ratio=robot.drive.gear_ratio,
            smooth=smooth,
            joints=[f"motor{i}" if f"motor{i}" in split else f"arm{i}" for i in range(3)],
            bristle=inside.bristle.tolist(),
            distance=inside.distance.tolist(),
            forms="\n".join(forms.values()),
            **{where: ", ".join(entries) for where, entries in at.items()},
        )
        result.callback = head + (_MEASUREMENT.format(torque=torque, wobble=_wobble(terms)) if result.measured else "")


def to_urdf(robot: Robot) -> str:
    """The actuated part of `robot` for viewers, base and active links: URDF knows no closed chain."""
    changed, _, _ = corrected(robot)
    model = pack(changed)
    root = xml.Element("robot", name=robot.name)
    geometry, limits = robot.geometry, robot.limits
    shape(root, "base", geometry.base_radius, 0.02)
    low, high = geometry.joint_range_rad
    for i in range(3):
        azimuth, length = robot.arm_angles[i], float(model.active_length[i])
        place = geometry.base_radius * np.array([np.cos(azimuth), np.sin(azimuth)])
        shape(root, f"arm{i}", 0.02, length, along_x=True)
        joint = _joint(root, f"arm{i}", "revolute", "base", f"arm{i}", (*place, 0.0), (0.0, 0.0, azimuth))
        xml.SubElement(joint, "axis", xyz="0 1 0")
        torque = limits.peak_torque_nm or PlantTruth.nominal(robot).peak_torque_nm
        bounds = {"lower": low, "upper": high, "effort": torque, "velocity": limits.joint_speed_radps}
        xml.SubElement(joint, "limit", {key: f"{value:.6g}" for key, value in bounds.items()})
    xml.indent(root)
    return xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _joint(root: xml.Element, name: str, kind: str, parent: str, child: str, xyz, rpy) -> xml.Element:
    joint = xml.SubElement(root, "joint", name=name, type=kind)
    xml.SubElement(joint, "parent", link=parent)
    xml.SubElement(joint, "child", link=child)
    xml.SubElement(joint, "origin", xyz=" ".join(f"{v:.6g}" for v in xyz), rpy=" ".join(f"{v:.6g}" for v in rpy))
    return joint
