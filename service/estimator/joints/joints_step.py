"""The compiled halves of one step of joints: before the torque of the mechanism is known, and after; and the look back.

Stream, filters, choice of the motion and bounds are those of a Delta, on scaled records (see `state`). Between the
halves the caller asks the mechanism for the torque at state.motion and puts it into state.rigid.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel
from service.estimator.kalman import MAX_LAG, largest_innovation, smooth_kernel
from service.estimator.named_effects import effects_kernel
from service.estimator.stream import (
    COMMAND_RANGE,
    NAN,
    RANGE,
    UNEXPECTED,
    UNSEEN_TIME,
    UNUSABLE,
    coast_cycles,
    cycles_since,
    judge_kernel,
    remember_kernel,
    restart,
    track_command_kernel,
    track_kernel,
)
from service.estimator.wanted import COMMAND, ESTIMATE, NONE, bound_kernel, choose_kernel, fade_kernel, stay_kernel
from service.estimator.wanted import take_plan_kernel as plan_inside
from service.model.effects.base import Instant

KNOWN_FLAGS = (1 << 16) - 1
FINITE = 1e9  # N m: a torque beyond it is none


@kernel
def _scale(settings, given, sample):
    """The sample `given` on the bus into what is scaled; what no joint can be is flagged."""
    sample.stamp_sec, sample.stamp_nanosec, sample.sequence = given.stamp_sec, given.stamp_nanosec, given.sequence
    sample.gripper = given.gripper
    flags = np.int64(given.flags) & KNOWN_FLAGS
    if given.joints != settings.joints:
        flags |= NAN
    for i in range(len(sample.position)):
        sample.position[i] = sample.torque[i] = sample.position_command[i] = 0.0
    for i in range(settings.joints):
        position, command = given.position[i], given.position_command[i]
        sample.position[i] = position / settings.unit[i]
        sample.torque[i] = given.torque[i] / settings.full[i]
        sample.position_command[i] = command / settings.unit[i]
        if position < settings.low[i] or position > settings.high[i]:
            flags |= RANGE
        if command < settings.low[i] or command > settings.high[i] or math.isinf(command):
            flags |= COMMAND_RANGE
    sample.flags = flags


@kernel
def begin_kernel(steps):
    """Take `given`. Returns whether state.motion is one to answer for: then state.rigid is needed."""
    step = steps[0]
    settings, state, sample = step.settings, step.state, step.sample
    _scale(settings, step.given, sample)
    gap = cycles_since(settings, state, sample)
    flags, begins, elsewhere, forward = judge_kernel(settings, state, sample, gap)
    state.forward, state.flags = 1 if forward else 0, flags
    if not forward:
        return False
    state.held = 0
    state.passed = max(gap, np.int64(1))
    if begins:
        if elsewhere or (state.measured.idle + gap) * settings.period > UNSEEN_TIME:
            state.unseen = 1
        gap = 1
        restart(settings, state, sample)
    else:
        track_kernel(settings, state, sample, flags, gap)
    track_command_kernel(settings, state, sample, flags, gap)
    state.sequence, state.stamp_sec, state.stamp_nanosec = sample.sequence, sample.stamp_sec, sample.stamp_nanosec
    _remember(settings, state, step.given, flags, gap)
    source, more = choose_kernel(settings, state, sample, step.feedforward)
    state.flags |= more
    state.source = source
    if source == NONE:
        return False
    _unscale(settings, state.trajectory, state.motion)
    return True


@kernel
def _unscale(settings, inside, motion):
    for order in range(3):
        for i in range(settings.joints):
            motion[order, i] = inside[order, i] * settings.unit[i]


@kernel
def _remember(settings, state, given, flags, gap):
    """Put the newest cycle into the lag line."""
    settling = state.unsettled > 0 and gap <= 1 and flags & UNUSABLE == 0
    remember_kernel(settings, state, flags, gap)
    if settling and largest_innovation(settings.motion, state.measured) > UNEXPECTED:
        state.unsettled = 2 * settings.motion.lag
    past = state.past[state.head]
    past.stamp_sec, past.stamp_nanosec, past.sequence = given.stamp_sec, given.stamp_nanosec, given.sequence
    past.flags, past.gripper = flags, given.gripper
    past.usable = 1 if flags & UNUSABLE == 0 and gap == 1 else 0
    for i in range(settings.joints):
        past.torque[i] = given.torque[i] if past.usable != 0 else 0.0


@kernel
def friction_kernel(settings, speed, rubbed, dry):
    """Friction (n,) of the joints at speeds (n,), and Coulomb's part of it."""
    for i in range(settings.joints):
        rubbed[i] = dry[i] = 0.0
    for f in range(settings.motors):
        sliding = 0.0
        for i in range(settings.joints):
            sliding += settings.rows[f, i] * speed[i]
        coulomb = settings.coulomb[f] * math.tanh(sliding / settings.transition[f])
        for i in range(settings.joints):
            rubbed[i] += settings.rows[f, i] * (settings.viscous[f] * sliding + coulomb)
            dry[i] += settings.rows[f, i] * coulomb


@kernel
def _effects(settings, state, motion, seconds, torque):
    """Add the effects' torque (n,) at a motion (3, n)."""
    if settings.effect[0].number < 0:
        return
    for i in range(settings.joints):
        state.sense[i] = math.tanh(motion[1, i] / settings.transition[i])
    now = Instant(
        model=settings.model,
        gear_ratio=settings.gear_ratio,
        theta=motion[0],
        theta_dot=motion[1],
        theta_ddot=motion[2],
        direction=state.sense,
        load=state.rigid,
        seconds=max(0.0, seconds),
        pose=state.pose,
        doubt=state.doubt,
    )
    effects_kernel(settings.effect, now, torque)


@kernel
def end_kernel(steps, answers):
    """Fill `feedforward`; `answers`: whether state.rigid is there. Returns the answer's flags, and whether there is a
    sample to look back on."""
    step = steps[0]
    settings, state, out = step.settings, step.state, step.feedforward
    flags = np.int64(state.flags)
    if state.forward == 0:
        flags |= _hold(settings, state, step.sample, out)
    else:
        seconds = state.passed * settings.period
        if answers and _want(settings, state, step.sample):
            source = state.source
            if (source == COMMAND and state.command_stray > 0) or (source == ESTIMATE and state.stray > 0):
                stay_kernel(state)
            for i in range(len(state.turned)):
                state.turned[i] = state.direction[i] - state.direction_before[i]
                state.direction_before[i] = state.direction[i]
            flags |= bound_kernel(settings, state, seconds, out)
        else:
            state.source = NONE
            flags |= fade_kernel(settings, state, seconds, out)
        for i in range(len(state.torque)):
            state.torque[i] = out.torque[i]
    for i in range(len(state.torque)):
        out.torque[i] = state.torque[i] * settings.full[i] if i < settings.joints else 0.0
    out.source = state.source
    out.stamp_sec, out.stamp_nanosec = step.given.stamp_sec, step.given.stamp_nanosec
    out.sequence, out.flags = step.given.sequence, flags
    return flags, bool(state.forward != 0 and state.filled > settings.motion.lag)


@kernel
def _want(settings, state, sample):
    """state.wanted and state.direction, scaled, from state.rigid, friction and effects. Returns whether they are
    finite."""
    friction_kernel(settings, state.motion[1], state.wanted, state.direction)
    _effects(settings, state, state.motion, sample.stamp_sec + sample.stamp_nanosec * 1e-9, state.wanted)
    finite = True
    for i in range(settings.joints):
        state.wanted[i] = (state.wanted[i] + state.rigid[i]) / settings.full[i]
        state.direction[i] /= settings.full[i]
        finite &= abs(state.wanted[i]) < FINITE  # written so that NaN fails
    return finite


@kernel
def _hold(settings, state, sample, out):
    """The answer to a repeated or late sample: that of before; once nothing else comes it fades."""
    out.target_sequence = sample.sequence
    state.held += 1
    flags = np.int64(0)
    if state.held > coast_cycles(settings):
        state.source = NONE
        flags |= fade_kernel(settings, state, settings.period, out)
        for i in range(len(state.torque)):
            state.torque[i] = out.torque[i]
    else:
        for i in range(len(state.climb)):
            state.climb[i] = 0.0
    return flags


@kernel
def look_kernel(steps):
    """Fill state.looked, reported, rubbed, gripper, votes of the sample a lag ago. Returns whether it is usable."""
    step = steps[0]
    settings, state, lag = step.settings, step.state, step.settings.motion.lag
    index = (state.head - lag + MAX_LAG + 1) % (MAX_LAG + 1)
    past, error, load = state.past[index], step.error, step.load
    error.stamp_sec, error.stamp_nanosec, error.sequence = past.stamp_sec, past.stamp_nanosec, past.sequence
    load.stamp_sec, load.stamp_nanosec, load.sequence = past.stamp_sec, past.stamp_nanosec, past.sequence
    error.flags = past.flags
    state.votes, state.gripper = 0, past.gripper
    if past.flags & UNUSABLE != 0:
        return False
    smooth_kernel(settings.motion.transition, state.slots, state.head, lag, state.adjoint, state.trajectory)
    _unscale(settings, state.trajectory, state.looked)
    friction_kernel(settings, state.looked[1], state.rubbed, state.wanted)
    _effects(settings, state, state.looked, past.stamp_sec + past.stamp_nanosec * 1e-9, state.rubbed)
    if _read(settings, state, index) and state.unsettled == 0:
        state.votes = 1
    return True


@kernel
def _read(settings, state, index):
    """state.reported: the torque that was reported for the motion at the slot `index`, which is `late` cycles later.
    Returns whether it is there."""
    first = math.floor(settings.late)
    share = settings.late - first
    one = state.past[(index + np.int64(first) + MAX_LAG + 1) % (MAX_LAG + 1)]
    other = state.past[(index + np.int64(first) + 1 + MAX_LAG + 1) % (MAX_LAG + 1)]
    for i in range(settings.joints):
        state.reported[i] = (1.0 - share) * one.torque[i] + share * other.torque[i]
    return one.usable != 0 and (other.usable != 0 or share == 0.0)


@kernel
def plan_kernel(steps):
    """Take the motion in `planned` if it is one; else the next answer says what is wrong with it."""
    step = steps[0]
    settings, planned, reference = step.settings, step.planned, step.reference
    reference.sequence = planned.sequence
    for i in range(len(reference.position)):
        reference.position[i] = reference.velocity[i] = reference.acceleration[i] = 0.0
    for i in range(settings.joints):
        position, acceleration = planned.position[i], planned.acceleration[i]
        reference.position[i] = reference.acceleration[i] = math.nan
        if settings.low[i] <= position <= settings.high[i] and math.isfinite(position):
            reference.position[i] = position / settings.unit[i]
        reference.velocity[i] = planned.velocity[i] / settings.unit[i]
        if abs(acceleration) <= settings.most[i]:
            reference.acceleration[i] = acceleration / settings.unit[i]
    plan_inside(settings, step.state, reference)
