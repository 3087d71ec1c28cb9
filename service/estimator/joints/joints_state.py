"""What the estimator of joints remembers, as one record that its kernels read and write in place.

Inside, a joint's position is in units of its unit speed times a second and its torque in units of its largest. So the
rules for jumps, holes and bounds, which know one speed and one peak, are those of a Delta (`stream`, `wanted`), and
radians and metres are alike.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.axes_description import Axes
from schemas.chain_description import Chain
from schemas.errors import DataError, RobotError
from schemas.messages import (
    JOINT_ERROR,
    JOINT_FEEDFORWARD,
    JOINT_REFERENCE,
    JOINT_SAMPLE,
    LOAD,
    MOST_JOINTS,
    FeedforwardSource,
)
from service.estimator import kalman, named_effects, stream
from service.estimator.bounds import REVERSAL_TIME, growth_share
from service.machines import machine_of
from service.machines.machine import MachineModel
from service.model.description import base_of, terms_of
from service.model.dynamics import REST_SPEED
from service.model.kinematics import POSE
from service.model.nominal import MODEL
from service.model.signals import LEVER

MOST_MOTORS = 2 * MOST_JOINTS  # joints, and motors that turn with several
# A joint is never twice as fast as its limit.
SPEED_MARGIN = 2.0
# Of the unit speed: in motion an arm is asked to reach its speed within 0.2 s, with an acceleration that turns over in
# some hundredths of a second; twice that leaves headroom.
EXPECTED_JERK = 100.0  # 1/s^2
# A fixed lag that smooths the acceleration of motion so slow; nobody waits for the load.
SMOOTHING_LAG = 0.025  # s
MOST_ACCELERATION = 1000.0  # 1/s of the speed limit: no drive reaches its speed within less than a millisecond
NO_FORM = "for arms and axes, the online model contains only effects that depend on the present motion of one joint"
POSES = 64  # at which the least inertia of a joint is looked for


def _of_many(dtype: np.dtype, *per_joint: str) -> np.dtype:
    """A record of `kalman` with the fields `per_joint` for as many joints as a message holds."""
    shapes = {name: dtype[name].shape for name in dtype.names or ()}
    shapes |= {name: (MOST_JOINTS, *shapes[name][1:]) for name in per_joint}
    return np.dtype([(name, dtype[name].base, shape) for name, shape in shapes.items()], align=True)


TRACK = _of_many(kalman.TRACK, "state", "scaled", "seen")
SLOT = _of_many(kalman.SLOT, "state", "scaled")
EFFECT = _of_many(named_effects.EFFECT, "joint", "amplitude")

SETTINGS = np.dtype(
    [
        ("motion", kalman.FILTER),
        ("joints", "i8"),
        ("period", "f8"),  # s
        ("stride", "i8"),  # sequence numbers from sample to sample
        ("unit", "f8", MOST_JOINTS),  # rad or m: what is one inside
        ("full", "f8", MOST_JOINTS),  # N m or N: what is one inside
        ("low", "f8", MOST_JOINTS),  # rad or m
        ("high", "f8", MOST_JOINTS),
        ("most", "f8", MOST_JOINTS),  # rad/s^2 or m/s^2 that a plan may ask for
        ("motors", "i8"),  # joints, and motors that turn with several
        ("rows", "f8", (MOST_MOTORS, MOST_JOINTS)),  # share of each joint's speed in the speed of each
        ("viscous", "f8", MOST_MOTORS),  # N m s/rad or N s/m
        ("coulomb", "f8", MOST_MOTORS),  # N m or N
        ("transition", "f8", MOST_MOTORS),  # rad/s or m/s
        ("effect", EFFECT, named_effects.MAX_EFFECTS),
        ("gear_ratio", "f8"),  # of all joints, where they have one
        ("model", MODEL),  # nothing: of a Delta, which forms of effects on its platform read
        ("late", "f8"),  # cycles that a torque is older than the position
        # inside
        ("range", "f8", 2),
        ("speed", "f8"),
        ("acceleration", "f8"),
        ("peak", "f8"),
        ("slope", "f8"),
        ("growth", "f8"),
        ("fade", "f8"),
    ],
    align=True,
)

_PAST = np.dtype(
    [
        ("torque", "f8", MOST_JOINTS),  # N m or N, reported
        ("usable", "i8"),
        ("stamp_sec", "i4"),
        ("stamp_nanosec", "u4"),
        ("sequence", "u8"),
        ("flags", "u4"),
        ("gripper", "u4"),
    ],
    align=True,
)

STATE = np.dtype(
    [
        *stream.fields(MOST_JOINTS, TRACK),
        ("slots", SLOT, kalman.MAX_LAG + 1),
        ("past", _PAST, kalman.MAX_LAG + 1),
        ("head", "i8"),
        ("filled", "i8"),
        ("unsettled", "i8"),  # samples until the newest hole is no longer felt in the smoothed motion
        ("unseen", "i8"),  # 1 where nobody saw what became of the load
        ("torque", "f8", MOST_JOINTS),  # last feed-forward
        ("climb", "f8", MOST_JOINTS),
        ("direction", "f8", MOST_JOINTS),  # Coulomb friction that is in what is wanted
        ("direction_before", "f8", MOST_JOINTS),
        ("turned", "f8", MOST_JOINTS),  # step of it
        ("wanted", "f8", MOST_JOINTS),
        ("source", "i8"),
        ("held", "i8"),
        ("faded", "f8"),
        ("fade_from", "f8", MOST_JOINTS),
        ("reference_sequence", "u8"),
        ("reference", "f8", (3, MOST_JOINTS)),
        ("reference_valid", "i8"),
        ("reference_faults", "i8"),
        # from the first half of a step to the second
        ("flags", "i8"),
        ("forward", "i8"),
        ("passed", "i8"),  # cycles since the last answer
        ("trajectory", "f8", (3, MOST_JOINTS)),
        ("motion", "f8", (3, MOST_JOINTS)),  # rad, rad/s, rad/s^2, or m
        ("rigid", "f8", MOST_JOINTS),  # N m or N, at that motion, of arm and load
        # of a look back
        ("looked", "f8", (3, MOST_JOINTS)),  # as `motion`
        ("reported", "f8", MOST_JOINTS),  # N m or N
        ("rubbed", "f8", MOST_JOINTS),  # N m or N, friction and effects
        ("sense", "f8", MOST_JOINTS),  # direction of motion
        ("doubt", "f8", MOST_JOINTS),  # nothing
        ("pose", POSE),  # nothing
        ("gripper", "i8"),
        ("votes", "i8"),  # whether motion and torque are good enough to tell the load
        ("adjoint", "f8", kalman.ORDER),
    ],
    align=True,
)

STEP = np.dtype(
    [
        ("settings", SETTINGS),
        ("state", STATE),
        ("given", JOINT_SAMPLE.dtype),
        ("sample", JOINT_SAMPLE.dtype),  # inside
        ("planned", JOINT_REFERENCE.dtype),
        ("reference", JOINT_REFERENCE.dtype),  # inside
        ("feedforward", JOINT_FEEDFORWARD.dtype),
        ("load", LOAD.dtype),
        ("error", JOINT_ERROR.dtype),
    ],
    align=True,
)


def left_out(description: Axes | Chain) -> dict[str, str]:
    """Name -> why, of each effect of a description that is not carried.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    several, found = len(set(description.gear_ratios)) > 1, {}
    for term in terms_of(description):
        if not named_effects.of_own_joint(term.effect):
            found[term.effect.name] = NO_FORM
        elif several and term.effect.of_motor_turns:
            found[term.effect.name] = "it depends on the motor's turns, and the joints differ in gear ratio"
    return found


def check(description: Axes | Chain) -> MachineModel:
    """The machine, if it can be followed online.

    Raises:
        RobotError: more joints than a message holds; no largest torque or speed of a joint.
        DataError: it was never identified.
    """
    count, origin = description.count, description.origin
    if count > MOST_JOINTS:
        raise RobotError(f"{origin}: {count} joints: the estimator supports at most {MOST_JOINTS}")
    if description.identified is None:
        raise DataError(f"{origin}: no [identified] parameters: run `deltatwin identify` on its logs first")
    machine = machine_of(description)
    limits = machine.limits()
    for name, values, unit in (("torque", limits.torque, "N m or N"), ("speed", limits.speed, "rad/s or m/s")):
        for joint in np.flatnonzero(~np.isfinite(values) | (values <= 0)):
            raise RobotError(
                f"{origin}: limits.{name}: none for joint {joint + 1}: the estimator needs the largest {name} of each "
                f"joint, {unit}: [limits] {name} = [...]"
            )
    return machine


def settings(description: Axes | Chain, period: float, stride: int) -> np.ndarray:
    """Everything the kernels need to know of a machine at one sample every `period` s, as one SETTINGS record.

    Raises:
        RobotError, DataError: see `check`.
    """
    machine = check(description)
    mechanism, base, limits = machine.mechanism, base_of(description), machine.limits()
    count, motors = mechanism.joints, len(mechanism.frictions)
    record: Any = np.zeros(1, SETTINGS)
    one = record[0]
    unit = SPEED_MARGIN * limits.speed
    one["joints"], one["motors"], one["period"], one["stride"] = count, motors, period, stride
    one["unit"], one["full"], one["low"], one["high"], one["most"] = 1.0, 1.0, -np.inf, np.inf, np.inf
    one["unit"][:count], one["full"][:count] = unit, limits.torque
    one["low"][:count], one["high"][:count] = limits.low, limits.high
    acceleration = _accelerations(machine, limits.torque)
    one["most"][:count] = acceleration
    one["rows"][:motors, :count] = mechanism.rows
    one["viscous"][:motors], one["coulomb"][:motors] = base.viscous, base.coulomb
    rest = REST_SPEED * (LEVER if description.linear else 1.0)
    one["transition"][:] = np.maximum(base.transition if np.ndim(base.transition) == 0 else 0.0, 0.5 * rest)
    if np.ndim(base.transition):
        one["transition"][:motors] = np.maximum(base.transition, 0.5 * rest)
    left = left_out(description)
    kept = [term for term in terms_of(description) if term.effect.name not in left]
    one["effect"] = named_effects.pack_effects(kept, EFFECT)
    one["gear_ratio"] = description.gear_ratios[0]
    one["late"] = base.timing / period
    resolution = description.limits.position_resolution / float(unit.min())
    lag = max(math.ceil(one["late"]) + 1, min(kalman.LONGEST_SMOOTHING, round(SMOOTHING_LAG / period)))
    motion = kalman.design(period, resolution, lag, EXPECTED_JERK)
    for name in motion._fields:
        one["motion"][name] = getattr(motion, name)
    one["range"] = -np.inf, np.inf
    one["speed"], one["peak"], one["slope"] = 1.0, 1.0, 2.0 / REVERSAL_TIME
    one["acceleration"] = float((acceleration / unit).max())
    one["growth"] = one["slope"] * growth_share(period)
    one["fade"] = description.limits.torque_fade_s
    return record


def _accelerations(machine: MachineModel, torque: np.ndarray) -> np.ndarray:
    """(n,) that no joint exceeds: its largest torque on the least inertia that it has in any pose."""
    mechanism, limits = machine.mechanism, machine.limits()
    coefficients = base_of(machine.description).rigid
    count = mechanism.joints
    low, high = np.clip(limits.low, -np.pi, np.pi), np.clip(limits.high, -np.pi, np.pi)
    theta = np.random.default_rng(0).uniform(np.minimum(low, high), np.maximum(low, high), (POSES, count))
    still = np.zeros_like(theta)
    rest = mechanism.rigid(theta, still, still).torque(coefficients)
    result = np.empty(count)
    for joint, unit in enumerate(np.eye(count)):
        inertia = (mechanism.rigid(theta, still, still + unit).torque(coefficients) - rest)[:, joint].min()
        result[joint] = torque[joint] / inertia if inertia > 0 else np.inf
    return np.minimum(result, MOST_ACCELERATION * limits.speed)


def fresh(record: np.ndarray) -> np.ndarray:
    """One STEP record of an estimator with these SETTINGS that has seen nothing."""
    step = np.zeros(1, STEP)
    step["settings"] = record
    for name, message in (("feedforward", JOINT_FEEDFORWARD), ("load", LOAD), ("error", JOINT_ERROR)):
        step[name] = message.empty()
    for name in ("feedforward", "error"):
        step[name]["joints"] = record["joints"]
    step["state"]["source"] = FeedforwardSource.NONE
    return step
