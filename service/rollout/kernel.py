"""The robot forward in time under a given torque, with everything its description carries: one compiled kernel.

Each step is one of Verwer's second-order Rosenbrock method with an inexact Jacobian (ROS2 as a W-method): two
evaluations of the dynamics, and only what is stiff is taken implicitly - friction by its secant, which never steps
over zero speed, and the spring and damper between motor and link. Without friction it is Heun's method.

A joint is one mass, or two with a spring or a gap between them: then friction and the torque act on the motor, whose
angle is measured, and the rigid body on the link.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel
from service.estimator.named_effects import EFFECT, MAX_EFFECTS, effects_kernel
from service.model.dynamics import TERMS
from service.model.effects.base import Instant
from service.model.effects.presliding_friction import slide_kernel
from service.model.forward import bias_kernel, mass_kernel, solve_kernel
from service.model.kinematics import POSE, REACHED
from service.model.nominal import MODEL

LONGEST_STEP = 0.25e-3  # s
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)  # of ROS2: what decays fast does so in one step
SHARPEST = 1e-4  # rad/s over which friction turns where the description has a jump
SLOW = 0.05  # rad/s below which friction is so steep that the effects' share in it counts
FARTHEST = 3.0  # rad from the angle that it started at: a robot that runs away

# what is divided by zero is no number, and ends a run: to ask each time would cost a fifth of the speed
_compiled = kernel(nogil=True, error_model="numpy")


# One robot. Three numbers are one a joint, in N m, rad and s.
FORWARD = np.dtype(
    [
        ("model", MODEL),
        ("rho_1", "f8", 3),
        ("rho_2", "f8", 3),
        ("forearm", "f8"),  # kg
        ("viscous", "f8", 3),
        ("coulomb", "f8", 3),
        ("transition", "f8"),  # rad/s
        ("gear_ratio", "f8"),
        ("at_joints", EFFECT, MAX_EFFECTS),  # the joints' own effects
        ("at_platform", EFFECT, MAX_EFFECTS),  # those that reach all joints
        ("rotor", "f8", 3),  # kg m^2 that effects add to a joint
        ("tool", "f8"),  # kg that effects add to the platform
        ("bristle", "f8", 3),
        ("distance", "f8", 3),
        ("motor", "f8", 3),  # kg m^2 of a motor that is a mass of its own, 0: one with its link
        ("stiffness", "f8", 3),
        ("damping", "f8", 3),
        ("half", "f8", 3),
    ],
    align=True,
)

# What one step works on.
SCRATCH = np.dtype(
    [
        ("pose", POSE),
        ("terms", "f8", (len(TERMS), 3)),
        ("bias", "f8", 3),
        ("mass", "f8", (3, 3)),  # kg m^2 of the links
        ("inertia", "f8", 3),  # of the motors
        ("payload", "f8"),  # kg
        ("guess", "f8", 3),  # rad/s^2, acceleration of the evaluation before: what the gears' load is for
        ("load", "f8", 3),
        ("direction", "f8", 3),
        ("own", "f8", 3),  # N m of the effects
        ("shared", "f8", 3),
        ("more", "f8", 3),
        ("right_link", "f8", 3),  # torque left over for acceleration
        ("right_motor", "f8", 3),
        ("contact", "f8", (2, 3)),  # stiffness and damping of flanks that are closed
        ("steep", "f8", 3),  # N m s/rad, secant of the friction
        ("state", "f8", (5, 3)),  # link, link speed, motor, motor speed, bristles
        ("middle", "f8", (5, 3)),
        ("first", "f8", (2, 3)),  # stage: acceleration of links and motors
        ("second", "f8", (2, 3)),
        ("kept_mass", "f8", (3, 3)),  # of the step's start, for both stages
        ("kept_inertia", "f8", 3),
        ("kept_steep", "f8", 3),
        ("kept_contact", "f8", (2, 3)),
        ("right", "f8", (2, 3)),
        ("matrix", "f8", (3, 3)),
        ("side", "f8", 3),
        ("still", "f8", 3),  # zero, no constant: its type would compile the effects anew
        ("before", "f8", 3),  # N m, torque at both ends of the step
        ("after", "f8", 3),
    ],
    align=True,
)


class Runs(NamedTuple):
    """W runs of S samples. start: (W, 5, 3) link, link speed, motor, motor speed, bristles. torque: (W, S, 3) N m at
    the joints, straight between samples; drives, where there are any, begin with the first. payload: (W,) kg. seconds:
    (W,) of the log's clock at the start."""

    start: np.ndarray
    torque: np.ndarray
    payload: np.ndarray
    seconds: np.ndarray


class DriveGains(NamedTuple):
    """(3,) each, as in `Servo`; per_time: 1/s, inverse of the integral time. peak: N m."""

    position: np.ndarray
    velocity: np.ndarray
    per_time: np.ndarray
    velocity_forward: np.ndarray
    acceleration_forward: np.ndarray
    peak: float


class Drives(NamedTuple):
    """What makes the torque of W runs of S samples. command: (W, S, 3, 3) angle, speed, acceleration, rad and s; of no
    runs where the torque is given."""

    gains: DriveGains
    command: np.ndarray


NO_DRIVES = Drives(DriveGains(*np.zeros((5, 3)), peak=0.0), np.zeros((0, 1, 3, 3)))


class Pace(NamedTuple):
    """period: s between samples. substeps: of each."""

    period: float
    substeps: int

    @classmethod
    def of(cls, period: float) -> Pace:
        """No step longer than `LONGEST_STEP`."""
        return cls(period, max(1, int(np.ceil(period / LONGEST_STEP - 1e-6))))


@_compiled
def _effects(f, s, effects, theta, theta_dot, seconds, torque):
    """torque (3,): of `effects` on motors or links, whose angles and speeds these are, at s.direction; what they take
    for acceleration is in the masses."""
    for i in range(3):
        torque[i] = 0.0
    now = Instant(
        model=f.model,
        gear_ratio=f.gear_ratio,
        theta=theta,
        theta_dot=theta_dot,
        theta_ddot=s.still,
        direction=s.direction,
        load=s.load,
        seconds=seconds,
        pose=s.pose,
        doubt=s.more,
    )
    effects_kernel(effects, now, torque)


@_compiled
def _evaluate(f, s, state, torque, seconds, step, implicit):
    """Masses and the torque left over for acceleration. Returns a status.

    step: s, ahead of which a flank that closes counts as closed. implicit: also fill `steep`.
    """
    link, link_dot, motor, motor_dot, bristle = state[0], state[1], state[2], state[3], state[4]
    status = bias_kernel(f.model, f.rho_2, f.forearm, s.payload, link, link_dot, s.pose, s.terms, s.bias)
    if status != REACHED:
        return status
    mass_kernel(f.model, f.rho_1, f.forearm, s.payload, s.pose, s.mass)
    for i in range(3):
        s.load[i] = s.bias[i] + s.mass[i, 0] * s.guess[0] + s.mass[i, 1] * s.guess[1] + s.mass[i, 2] * s.guess[2]
        s.direction[i] = math.tanh(motor_dot[i] / f.transition)
    _effects(f, s, f.at_joints, motor, motor_dot, seconds, s.own)
    _effects(f, s, f.at_platform, link, link_dot, seconds, s.shared)
    if implicit:
        _steepness(f, s, motor, motor_dot, seconds)
    for i in range(3):
        push = torque[i] - s.own[i] - f.viscous[i] * motor_dot[i] - f.coulomb[i] * s.direction[i]
        s.right_motor[i] = push - f.bristle[i] * (bristle[i] - s.direction[i])
        s.right_link[i] = -s.bias[i] - s.shared[i]
    if f.tool != 0.0:
        _hang(s, f.tool)
    for i in range(3):
        s.contact[0, i] = s.contact[1, i] = 0.0
        if f.motor[i] > 0.0:
            s.inertia[i] = f.motor[i] + f.rotor[i]
            s.mass[i, i] -= f.motor[i]
            passed = _passed(f, s, i, link[i] - motor[i], link_dot[i] - motor_dot[i], step)
            s.right_link[i] += passed
            s.right_motor[i] -= passed
        else:
            s.mass[i, i] += f.rotor[i]
            s.right_link[i] += s.right_motor[i]
    return status


@_compiled
def _hang(s, tool):
    """Add the inertia of `tool` kg on the platform to s.mass."""
    column, lever = s.pose.column, s.pose.lever
    for i in range(3):
        for j in range(i + 1):
            both = 0.0
            for axis in range(3):
                both += column[i, axis] * column[j, axis]
            more = tool * lever[i] * lever[j] * both
            s.mass[i, j] += more
            if i != j:
                s.mass[j, i] += more


@_compiled
def _steepness(f, s, motor, motor_dot, seconds):
    """s.steep: secant of everything that turns with the direction of motion."""
    slow = False
    for i in range(3):
        s.steep[i] = f.coulomb[i] - f.bristle[i]
        slow |= abs(motor_dot[i]) < SLOW
    if slow:
        for i in range(3):
            s.direction[i] += 1.0
        _effects(f, s, f.at_joints, motor, motor_dot, seconds, s.more)
        for i in range(3):
            s.direction[i] -= 1.0
            s.steep[i] += s.more[i] - s.own[i]
    for i in range(3):
        secant = s.direction[i] / motor_dot[i] if abs(motor_dot[i]) > 1e-9 else 1.0 / f.transition
        s.steep[i] = max(0.0, f.viscous[i] + s.steep[i] * secant)


@_compiled
def _passed(f, s, i, twist, speed, step):
    """Torque from motor to link, N m. twist: link less motor. A flank that is closed or will be goes to s.contact."""
    half, stiffness, damping = f.half[i], f.stiffness[i], f.damping[i]
    if half == 0.0:
        s.contact[0, i], s.contact[1, i] = stiffness, damping
        return -stiffness * twist - damping * speed
    if abs(twist + step * speed) > half or abs(twist) > half:
        s.contact[0, i], s.contact[1, i] = stiffness, damping
    if twist > half:  # flanks push, they do not pull
        return min(0.0, -stiffness * (twist - half) - damping * speed)
    if twist < -half:
        return max(0.0, -stiffness * (twist + half) - damping * speed)
    return 0.0


@_compiled
def _solve(f, s, mass, inertia, steep, contact, weight, right, result):
    """result (2, 3), links and motors, of the implicit equations. weight: gamma h, 0 for the explicit ones.

    (inertia + weight steep + g) motor - g link = right[1],   g = weight damping + weight^2 stiffness
    mass link + g (link - motor) = right[0]                   of a joint of two masses
    """
    matrix, side = s.matrix, s.side
    for i in range(3):
        for j in range(3):
            matrix[i, j] = mass[i, j]
        side[i] = right[0, i]
        if f.motor[i] > 0.0:
            g = weight * contact[1, i] + weight * weight * contact[0, i]
            own = inertia[i] + weight * steep[i] + g
            matrix[i, i] += g - g * g / own
            side[i] += g / own * right[1, i]
        else:
            matrix[i, i] += weight * steep[i]
    solve_kernel(matrix, side, result[0])
    for i in range(3):
        result[1, i] = result[0, i]
        if f.motor[i] > 0.0:
            g = weight * contact[1, i] + weight * weight * contact[0, i]
            result[1, i] = (right[1, i] + g * result[0, i]) / (inertia[i] + weight * steep[i] + g)


@_compiled
def step_kernel(f, s, seconds, h):
    """s.state `h` s on under torque that goes from s.before to s.after. Returns a status."""
    weight = GAMMA * h
    state, middle, first, second, right = s.state, s.middle, s.first, s.second, s.right
    mass, inertia, steep, contact = s.kept_mass, s.kept_inertia, s.kept_steep, s.kept_contact
    status = _evaluate(f, s, state, s.before, seconds, h, True)
    if status != REACHED:
        return status
    for i in range(3):
        inertia[i], steep[i] = s.inertia[i], s.steep[i]
        contact[0, i], contact[1, i] = s.contact[0, i], s.contact[1, i]
        for j in range(3):
            mass[i, j] = s.mass[i, j]
        pull = weight * contact[0, i] * (state[3, i] - state[1, i])
        right[0, i], right[1, i] = s.right_link[i] + pull, s.right_motor[i] - pull
    _solve(f, s, mass, inertia, steep, contact, weight, right, first)
    for i in range(3):
        for mine in range(2):
            place, speed = 2 * mine, 2 * mine + 1
            middle[place, i] = state[place, i] + h * (state[speed, i] + weight * first[mine, i])
            middle[speed, i] = state[speed, i] + h * first[mine, i]
        if f.bristle[i] != 0.0:
            middle[4, i] = slide_kernel(state[4, i], middle[2, i] - state[2, i], f.distance[i])
        s.guess[i] = first[0, i]
    status = _evaluate(f, s, middle, s.after, seconds + h, h, False)
    if status != REACHED:
        return status
    for i in range(3):
        right[0, i], right[1, i] = s.right_link[i], s.right_motor[i]
    _solve(f, s, s.mass, s.inertia, steep, contact, 0.0, right, second)
    for i in range(3):
        s.guess[i] = second[0, i]
        for mine in range(2):
            second[mine, i] -= 2.0 * first[mine, i]
            # from here on `middle` holds the second stage's share of the speeds
            speed = 2 * mine + 1
            middle[2 * mine, i] = middle[speed, i] - 2.0 * (state[speed, i] + weight * first[mine, i])
    for i in range(3):
        pull = weight * contact[0, i] * (middle[2, i] - middle[0, i])
        right[0, i] = mass[i, 0] * second[0, 0] + mass[i, 1] * second[0, 1] + mass[i, 2] * second[0, 2] + pull
        right[1, i] = inertia[i] * second[1, i] - pull
    _solve(f, s, mass, inertia, steep, contact, weight, right, second)
    for i in range(3):
        turned = state[2, i]
        for mine in range(2):
            place, speed = 2 * mine, 2 * mine + 1
            state[place, i] += 1.5 * h * (state[speed, i] + weight * first[mine, i])
            state[place, i] += 0.5 * h * (middle[place, i] + weight * second[mine, i])
            state[speed, i] += h * (1.5 * first[mine, i] + 0.5 * second[mine, i])
        if f.bristle[i] != 0.0:
            state[4, i] = slide_kernel(state[4, i], state[2, i] - turned, f.distance[i])
    return status


@_compiled
def _set_out(s, start, payload):
    """Begin a run in `start` (5, 3) with `payload` kg on the platform."""
    s.payload = payload
    for i in range(3):
        s.guess[i] = 0.0
        for row in range(5):
            s.state[row, i] = start[row, i]


@_compiled
def _is_near(s, start):
    """Whether the motors are where a run from `start` may be."""
    near = True
    for i in range(3):
        near &= abs(s.state[2, i] - start[2, i]) < FARTHEST  # also when NaN
    return near


@_compiled
def _drive(gains, state, command, later, integral, i):
    """Torque of drive i, within its peak and without, and its push, N m, `later` s after a sample's command (3, 3)."""
    place = command[0, i] + later * (command[1, i] + 0.5 * later * command[2, i])
    speed = command[1, i] + later * command[2, i]
    slip = gains.velocity_forward[i] * speed - state[3, i]
    push = gains.velocity[i] * (slip + gains.position[i] * (place - state[2, i]))
    free = push + integral[i] + gains.acceleration_forward[i] * command[2, i]
    return min(max(free, -gains.peak), gains.peak), free, push


@_compiled
def run_kernel(forward, scratch, runs, drives, pace, motor, pushed):
    """`Runs`, each from its own start, under the torque given or what `drives` make of their commands.

    forward, scratch: one record each. Filled: motor, pushed (W, S, 3), angle and torque, NaN from where a run left the
    workspace.
    """
    f, s, torque, command, gains = forward[0], scratch[0], runs.torque, drives.command, drives.gains
    period, substeps = pace.period, pace.substeps
    h = period / substeps
    driven = len(command) > 0
    integral = np.zeros(3)
    count = torque.shape[1]
    for w in range(len(runs.start)):
        _set_out(s, runs.start[w], runs.payload[w])
        if driven:
            for i in range(3):
                integral[i] = 0.0
                integral[i] = torque[w, 0, i] - _drive(gains, s.state, command[w, 0], 0.0, integral, i)[1]
        sound = True
        for k in range(count):
            sound &= _is_near(s, runs.start[w])
            for i in range(3):
                now = _drive(gains, s.state, command[w, k], 0.0, integral, i)[0] if driven else torque[w, k, i]
                motor[w, k, i] = s.state[2, i] if sound else np.nan
                pushed[w, k, i] = now if sound else np.nan
            if not sound or k == count - 1:
                continue
            for part in range(substeps):
                for i in range(3):
                    if driven:
                        limited, free, push = _drive(gains, s.state, command[w, k], part * h, integral, i)
                        if limited == free:
                            integral[i] += push * h * gains.per_time[i]
                        s.before[i] = s.after[i] = limited
                    else:
                        change = torque[w, k + 1, i] - torque[w, k, i]
                        s.before[i] = torque[w, k, i] + change * part / substeps
                        s.after[i] = torque[w, k, i] + change * (part + 1) / substeps
                sound = step_kernel(f, s, runs.seconds[w] + k * period + part * h, h) == REACHED
                if not sound:
                    break
