"""The named effects of a robot description inside the online step: those whose torque follows from the present sample.

The physics of each is told where it is diagnosed (`service/model/effects`); here is its causal form. What needs the
past of the motor (backlash, elasticity, presliding) or belongs to the measurement alone (delay, filter of the reported
torque) is not carried: `carried` says which are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from schemas.errors import RobotError
from schemas.robot import Effect, Robot

MAX_EFFECTS = 12
_AMPLITUDES, _SHAPES = 4, 2

# name -> amplitudes, shapes; the position in this table is the number the kernel knows an effect by
_TABLE: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "stribeck_friction": (("f_s",), ("v_s",)),
    "asymmetric_friction": (("delta_c", "delta_v"), ()),
    "load_dependent_friction": (("mu",), ()),
    "nonlinear_viscous_friction": (("f",), ("p",)),
    "position_dependent_friction": (("cosine", "sine"), ("order",)),
    "warmup_friction": (("f",), ("tau",)),
    "rotor_inertia": (("delta_i",), ()),
    "arm_mass": (("delta_m",), ()),
    "tool_mass": (("delta_m",), ()),
    "base_tilt": (("about_x", "about_y"), ()),
    "joint_spring": (("k", "preload"), ()),
    "hose_spring": (("k", "force_x", "force_y", "force_z"), ()),
    "air_drag": (("c",), ()),
    "torque_offset": (("offset",), ()),
    "torque_scale": (("epsilon",), ()),
    "cogging": (("cosine", "sine"), ("order",)),
    "link_length_error": (("error",), ()),
    "joint_offset": (("error",), ()),
}
_WHOLE_ROBOT = frozenset({"tool_mass", "base_tilt", "hose_spring", "air_drag"})
# these change the model itself: `corrected` and `scales` put them into the settings, the kernel has nothing to add
_IN_SETTINGS = frozenset({"link_length_error", "joint_offset", "torque_scale"})
_NUMBER = {name: number for number, name in enumerate(_TABLE)}
(
    _STRIBECK, _ASYMMETRIC, _LOAD, _NONLINEAR, _POSITION, _WARMUP, _ROTOR, _ARM, _TOOL, _TILT, _SPRING, _HOSE, _DRAG,
    _OFFSET,
) = range(14)  # fmt: skip
_COGGING = _NUMBER["cogging"]

EFFECT = np.dtype(
    [
        ("number", "i8"),
        ("joint", "i8", 3),  # 1 where it acts
        ("amplitude", "f8", (3, _AMPLITUDES)),  # row 0 where it is of the whole robot
        ("shape", "f8", _SHAPES),
    ],
    align=True,
)


def carried(name: str) -> bool:
    """Whether the online model has the effect of this name."""
    return name in _TABLE


def pack_effects(effects: Sequence[Effect]) -> np.ndarray:
    """(MAX_EFFECTS,) EFFECT records, the unused ones with number -1.

    Raises:
        RobotError: more effects than fit, a parameter is missing, or a joint that is none.
    """
    records = np.zeros(MAX_EFFECTS, EFFECT)
    records["number"] = -1
    kept = [effect for effect in effects if carried(effect.name) and effect.name not in _IN_SETTINGS]
    if len(kept) > MAX_EFFECTS:
        raise RobotError(f"effect: {len(kept)} tables, the online model has room for {MAX_EFFECTS}")
    for record, effect in zip(records, kept, strict=False):
        amplitudes, shapes = _TABLE[effect.name]
        record["number"] = _NUMBER[effect.name]
        record["shape"][: len(shapes)] = [_value(effect, name) for name in shapes]
        if effect.name in _WHOLE_ROBOT:
            record["amplitude"][0, : len(amplitudes)] = [_value(effect, name) for name in amplitudes]
            continue
        for joint, values in by_joint(effect).items():
            record["joint"][joint] = 1
            record["amplitude"][joint, : len(amplitudes)] = values
    return records


def corrected(robot: Robot) -> tuple[Robot, np.ndarray]:
    """`robot` with the geometry its effects say it has, and by how much each active link is longer, (3,) true / drawn.

    Raises:
        RobotError: a parameter is missing, or a joint that is none.
    """
    geometry = robot.geometry
    length, offset = np.array(geometry.active_link_length_error), np.array(geometry.joint_offset_rad)
    drawn = geometry.active_link_length + length
    for effect in robot.effect:
        target = {"link_length_error": length, "joint_offset": offset}.get(effect.name)
        if target is not None:
            for joint, (error,) in by_joint(effect).items():
                target[joint] += error
    errors = {"active_link_length_error": length.tolist(), "joint_offset_rad": offset.tolist()}
    ratio = (geometry.active_link_length + length) / drawn
    return robot.model_copy(update={"geometry": geometry.model_copy(update=errors)}), ratio


def scales(robot: Robot) -> np.ndarray:
    """Reported over true torque of each joint, (3,).

    Raises:
        RobotError: a parameter is missing, or a joint that is none.
    """
    scale = np.ones(3)
    for effect in robot.effect:
        if effect.name == "torque_scale":
            for joint, (epsilon,) in by_joint(effect).items():
                scale[joint] += epsilon
    return scale


def by_joint(effect: Effect) -> dict[int, list[float]]:
    """Joint from 0 -> amplitudes of an effect on single joints; their keys end in the joint where there are several."""
    if any(joint > 3 for joint in effect.joints):
        raise RobotError(f"effect {effect.name}: joints {effect.joints}, a Delta has 1 to 3")
    several = len(effect.joints) > 1
    return {
        joint - 1: [_value(effect, f"{name}_{joint}" if several else name) for name in _TABLE[effect.name][0]]
        for joint in effect.joints
    }


def _value(effect: Effect, key: str) -> float:
    if key not in effect.parameters:
        raise RobotError(f"effect {effect.name}: parameter {key!r} is missing")
    return effect.parameters[key].value


@njit(cache=True)
def effects_kernel(
    effects, model, gear_ratio, rho_2, theta, theta_dot, theta_ddot, way, load, seconds, position, work, torque
):
    """Add the effects' torque to `torque` (3,), N m, which holds the base model's.

    way: (3,) direction of motion in [-1, 1]. load: (3,) rigid torque through the gears. seconds: of the bus clock.
    position, work: as the terms kernel left them for this motion.
    """
    for n in range(MAX_EFFECTS):
        effect = effects[n]
        number = effect.number
        if number < 0:
            break
        if number in (_TOOL, _TILT, _HOSE, _DRAG):
            _platform(effect, number, model, rho_2, position, work, torque)
            continue
        for i in range(3):
            if effect.joint[i] == 0:
                continue
            a, b = effect.amplitude[i, 0], effect.amplitude[i, 1]
            speed = theta_dot[i]
            if number == _STRIBECK:
                torque[i] += a * way[i] * math.exp(-((speed / effect.shape[0]) ** 2))
            elif number == _ASYMMETRIC:
                torque[i] += a + b * abs(speed)
            elif number == _LOAD:
                torque[i] += a * abs(load[i]) * way[i]
            elif number == _NONLINEAR:
                torque[i] += a * way[i] * abs(speed) ** effect.shape[0]
            elif number == _POSITION:
                angle = effect.shape[0] * theta[i]
                torque[i] += (a * math.cos(angle) + b * math.sin(angle)) * way[i]
            elif number == _WARMUP:
                torque[i] += a * math.exp(-seconds / effect.shape[0]) * speed
            elif number == _ROTOR:
                torque[i] += a * theta_ddot[i]
            elif number == _ARM:
                length = model.active_length[i]
                cosine = math.cos(theta[i] + model.joint_offset[i])
                torque[i] += a * (length * length / 3.0 * theta_ddot[i] - model.gravity * length / 2.0 * cosine)
            elif number == _SPRING:
                torque[i] += a * theta[i] + b
            elif number == _OFFSET:
                torque[i] += a
            elif number == _COGGING:
                angle = effect.shape[0] * gear_ratio * theta[i]
                torque[i] += a * math.cos(angle) + b * math.sin(angle)


@njit(cache=True)
def _platform(effect, number, model, rho_2, position, work, torque):
    """Effects that push the platform (and, for a tilted base, the active links)."""
    column, elbow, lever, velocity, acceleration = work[1], work[2], work[4, 0], work[4, 1], work[4, 2]
    fx = fy = fz = 0.0
    a = effect.amplitude[0]
    if number == _TOOL:
        fx, fy, fz = a[0] * acceleration[0], a[0] * acceleration[1], a[0] * (acceleration[2] + model.gravity)
    elif number == _TILT:  # gravity leans by two small angles: its reaction is g (-y, x, 1)
        fx, fy = -a[1] * model.gravity, a[0] * model.gravity
        for i in range(3):
            link = rho_2 * model.gravity_torque[i] / (model.gravity * model.active_length[i])
            torque[i] += link * (elbow[i, 0] * fx + elbow[i, 1] * fy)
        fx *= model.moving_mass
        fy *= model.moving_mass
    elif number == _HOSE:
        fx, fy, fz = a[0] * position[0] + a[1], a[0] * position[1] + a[2], a[0] * position[2] + a[3]
    elif number == _DRAG:
        speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
        fx, fy, fz = a[0] * speed * velocity[0], a[0] * speed * velocity[1], a[0] * speed * velocity[2]
    for i in range(3):
        torque[i] += lever[i] * (column[i, 0] * fx + column[i, 1] * fy + column[i, 2] * fz)
