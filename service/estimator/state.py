"""What the estimator remembers, as one record that the kernel reads and writes in place.

One structured array instead of many arguments: handing thirty arrays to a compiled function costs more than running it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from schemas.messages import FEEDFORWARD, FRICTION, MODEL_ERROR, PAYLOAD, REFERENCE, SAMPLE, FeedforwardSource
from schemas.robot import Robot
from service.estimator import commanded, departure, kalman, named_effects, readout, stream, turning
from service.estimator.bounds import acceleration_of, bounds_of, growth_of
from service.estimator.branch import BRANCH
from service.estimator.left_out import left_out, torque_left_out
from service.estimator.payload import payload_state as payload
from service.estimator.unsure import mass_error
from service.model.description import base_of, terms_of
from service.model.dynamics import REST_SPEED, TERMS
from service.model.elastic import GEARS, gears_of, leads
from service.model.hypothesis import inside_of
from service.model.kinematics import POSE
from service.model.nominal import MODEL, lengthened, pack, record_of

# Per sample, when `identify` has not measured it.
DEFAULT_TORQUE_NOISE = 0.5  # N m
CRITICAL = 1.0  # damping ratio from which nothing rings

SETTINGS = np.dtype(
    [
        ("model", MODEL),
        ("motion", kalman.FILTER),
        ("period", "f8"),  # s
        ("stride", "i8"),  # sequence numbers from sample to sample, more than one of a decimated stream
        ("range", "f8", 2),  # rad
        ("speed", "f8"),  # rad/s, no joint is faster
        ("acceleration", "f8"),  # rad/s^2, no joint has more
        ("peak", "f8"),  # N m
        ("slope", "f8"),  # N m/s
        ("growth", "f8"),  # N m/s in one cycle, of the slope
        ("fade", "f8"),  # s
        ("max_payload", "f8"),  # kg
        ("rho", "f8", (2, 3)),
        ("forearm", "f8"),  # kg
        ("viscous", "f8", 3),  # N m s/rad
        ("coulomb", "f8", 3),  # N m
        ("transition", "f8"),  # rad/s over which friction turns, 0: within the rest speed
        ("wanted_transition", "f8"),  # rad/s, the same of a motion that is commanded or planned
        ("effect", named_effects.EFFECT, named_effects.MAX_EFFECTS),
        ("remembers", "i8"),  # whether an effect carries a state
        ("encoded", "i8"),  # whether an effect corrects the angles
        ("by_load", "i8"),  # whether an effect depends on the load of the gears
        ("geared", "i8"),  # whether a gear yields or is loose
        ("leads", "i8"),  # whether gears yield, and none is loose: planned motion is that of the links
        ("gears", GEARS),
        ("readout", readout.SETTINGS),
        ("scale", "f8", 3),  # reported over true torque
        ("gear_ratio", "f8"),
        ("variance", "f8", 3),  # (N m)^2 of a torque sample, worth CORRELATION_TIME
        ("drive_torque", commanded.SETTINGS),
        ("payload", payload.SETTINGS),
        ("friction_drift", "f8"),  # share of the identified friction beyond which health says so
        ("scale_drift", "f8"),  # the same of the torque, by its own size
        ("left_out", "i8"),  # whether the description names an effect that the online model does without
    ],
    align=True,
)

# One cycle in the lag line, beside what the smoother keeps of it.
_PAST = np.dtype(
    [
        ("acting", "f8", 3),  # N m, as reported, or behind a drive that follows what is reported
        ("torque_command", "f8", 3),
        ("commanded", "i8"),  # whether there was one
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
        *stream.fields(3, kalman.TRACK),
        ("slots", kalman.SLOT, kalman.MAX_LAG + 1),
        ("past", _PAST, kalman.MAX_LAG + 1),
        ("newest_torque", "f8", 3),  # N m, reported
        ("newest_command", "f8", 3),  # N m, the same where there is none
        ("head", "i8"),
        ("filled", "i8"),
        ("unsettled", "i8"),  # samples until the newest hole is no longer felt in the smoothed motion
        ("unexpected", "i8"),  # the same of motion behind it that the filter did not expect
        ("turn", "f8", turning.LINE),  # rad, angles of the fourth axis, a ring
        ("turn_head", "i8"),
        ("turn_known", "i8"),  # how many in a row
        ("turn_read", "f8"),  # rad, the newest as it was read
        ("drive_torque", commanded.STATE),
        ("payload", payload.STATE),
        ("branch", BRANCH, 2),  # MEASURED, ANSWERED
        ("readout", readout.STATE),
        ("torque", "f8", 3),  # N m, last feed-forward
        ("climb", "f8", 3),  # N m/s that it was on, reversals of Coulomb friction apart
        ("direction_before", "f8", 3),  # direction of motion that it was for
        ("source", "i8"),
        ("held", "i8"),  # answers in a row that only repeated it
        ("faded", "f8"),  # s since the last usable motion
        ("fade_from", "f8", 3),  # N m
        ("reference_sequence", "u8"),
        ("reference", "f8", (3, 3)),  # position, velocity, acceleration
        ("reference_valid", "i8"),
        ("reference_faults", "i8"),  # flags of a refused one, for the next answer
        # scratch of one step
        ("trajectory", "f8", (3, 3)),  # position, velocity, acceleration that the terms are for
        ("adjoint", "f8", kalman.ORDER),
        ("pose", POSE),
        ("terms", "f8", (len(TERMS), 3)),
        ("direction", "f8", 3),
        ("turned", "f8", 3),  # N m, step by reversals of Coulomb friction
        ("balls", "f8", 3),  # torque per N m of dry friction in the forearms' ball joints
        ("load", "f8", 3),
        ("push", "f8", 3),  # N m/kg, of the payload
        ("share", "f8", 3),
        ("mass", "f8", (3, 3)),  # kg m^2
        ("models", "f8", (readout.MODELS, 3)),  # N m
        ("told", "f8", (readout.TOLD, 3)),  # what the payload is told by, see `step`
        ("acting", "f8", 3),  # N m
        ("reported", "f8", 3),  # N m
        ("by_command", "i8"),  # whether the former is a command that the latter is behind
        ("command", "f8", (1, 3)),  # N m, as it would be reported
        ("full", "f8", 3),
        ("wanted", "f8", 3),
        ("ahead", "f8", 3),  # rad, wanted of the motors before the planned positions
        ("offset", "f8", 3),  # rad, last said of that
    ],
    align=True,
)

# All that one step reads and writes: a compiled function takes one address in 0.6 µs, six arrays in 1.8 µs.
STEP = np.dtype(
    [
        ("settings", SETTINGS),
        ("state", STATE),
        ("sample", SAMPLE.dtype),
        ("reference", REFERENCE.dtype),
        ("feedforward", FEEDFORWARD.dtype),
        ("payload", PAYLOAD.dtype),
        ("error", MODEL_ERROR.dtype),
        ("friction", FRICTION.dtype),
    ],
    align=True,
)


def settings(robot: Robot, period: float, stride: int) -> np.ndarray:
    """Everything the kernel needs to know of `robot` at one sample every `period` s, as one SETTINGS record."""
    record = np.zeros(1, SETTINGS)
    terms, described = terms_of(robot), robot
    robot, ratio, scale = named_effects.corrected(robot)
    identified = robot.identified
    record["model"] = record_of(pack(robot))
    without = left_out(robot, period)
    kept = [term for term in terms if term.effect.name not in without]
    ahead = None if identified is None or without else identified.torque_command_ahead_s
    reading = readout.settings(named_effects.readout_of(described, kept), period, ahead)
    motion = kalman.design(period, robot.drive.position_resolution_rad, readout.newest(reading))
    for name in motion._fields:
        record["motion"][name] = getattr(motion, name)
    record["period"] = period
    record["stride"] = stride
    record["range"] = robot.geometry.joint_range_rad
    bounds = bounds_of(robot)
    record["speed"], record["max_payload"] = robot.limits.joint_speed_radps, robot.limits.max_payload_kg
    record["peak"], record["slope"], record["fade"] = bounds.peak_nm, bounds.slope_nmps, robot.limits.torque_fade_s
    record["growth"], record["acceleration"] = growth_of(robot, period), acceleration_of(robot)
    record["rho"] = 1.0
    noise, left_over, is_commanded = np.full(3, DEFAULT_TORQUE_NOISE), np.zeros(3), False
    calibrated = None if identified is None else identified.torque_constant_error
    if identified is not None:
        record["rho"] = lengthened(identified.rho_1.value, identified.rho_2.value, ratio)
        turning = identified.friction_transition_radps
        # sharper than this it would chatter with the noise of a joint at rest
        record["transition"] = turning if turning > 0.5 * REST_SPEED else 0.0
        if turning > 0.0:  # what is commanded does not chatter at rest, and creeps as well as its filter tells
            record["wanted_transition"] = max(turning, min(kalman.speed_deviation(motion), REST_SPEED))
        record["forearm"] = identified.forearm_inertia_kg.value
        record["viscous"] = identified.viscous_friction_nms.value
        record["coulomb"] = identified.coulomb_friction_nm.value
        if identified.torque_noise_nm is not None:
            noise = np.array(identified.torque_noise_nm.value)
            is_commanded = identified.torque_commanded
        if identified.model_error_nm is not None:
            left_over = np.array(identified.model_error_nm.value)
    if without:
        left_over = np.hypot(left_over, torque_left_out(described, period))
    record["effect"] = named_effects.pack_effects(terms)
    record["remembers"], record["by_load"] = named_effects.remembers(terms), named_effects.goes_by_load(terms)
    record["encoded"], record["readout"] = named_effects.has_encoders(terms), reading
    figures = inside_of(terms).two_masses
    record["geared"] = bool(figures)
    record["gears"] = gears_of(pack(robot), base_of(described).rigid, _without_ringing(figures))
    record["leads"] = leads(figures)
    record["scale"] = scale
    record["gear_ratio"] = robot.drive.gear_ratio
    record["variance"] = payload.sample_variance(noise, left_over)
    record["drive_torque"] = commanded.settings(noise, is_commanded or bool(reading["ahead"]), period)
    prior = departure.drift(record["viscous"][0], record["coulomb"][0])
    limit, variance = robot.limits.max_payload_kg, record["variance"][0]
    record["payload"] = payload.settings(
        period, prior, limit, left_over, variance, calibrated, mass_error(described), robot.fourth_axis is not None,
        float(reading["lag"]),
    )  # fmt: skip
    record["friction_drift"] = robot.limits.friction_drift
    record["scale_drift"] = robot.limits.torque_scale_drift
    record["left_out"] = bool(without)
    return record


def _without_ringing(figures: Mapping[int, tuple[float, ...]]) -> dict[int, tuple[float, ...]]:
    """Gears as of `gears_of` whose flanks are damped at least critically: how they ring goes by the instant of their
    strike, which no sample tells, and by a payload that is not known yet."""
    return {
        joint: (half, natural_hz, max(damping_ratio, CRITICAL) if half > 0.0 else damping_ratio, motor_share)
        for joint, (half, natural_hz, damping_ratio, motor_share) in figures.items()
    }


def fresh(record: np.ndarray) -> np.ndarray:
    """One STEP record of an estimator with these SETTINGS that has seen nothing."""
    step = np.zeros(1, STEP)
    step["settings"] = record
    step["feedforward"], step["payload"], step["error"] = FEEDFORWARD.empty(), PAYLOAD.empty(), MODEL_ERROR.empty()
    step["friction"] = FRICTION.empty()
    weighing = record["payload"][0]
    payload.start(step["state"]["payload"], weighing["prior"], bool(weighing["turns"]))
    step["state"]["source"] = FeedforwardSource.NONE
    return step
