"""The motion that is wanted or there is, and the bounds of the torque that is answered for it, for any joints."""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from schemas.messages import FeedforwardSource, SampleFlag
from service.estimator.kalman import ACCELERATION, POSITION, VELOCITY
from service.estimator.stream import COMMAND_ACCELERATION, coast_cycles, settled_cycles

REFERENCE_AHEAD = 8  # cycles, planned motion further ahead is not for the next cycles
REFERENCE_DISTANCE = 0.3  # rad, beyond what a joint moves until then: a plan for another place than the robot's

_LIMITED, _FADING = SampleFlag.LIMITED.value, SampleFlag.FADING.value
_COMMAND_RANGE, _COMMAND_JUMP = SampleFlag.COMMAND_OUT_OF_RANGE.value, SampleFlag.COMMAND_JUMP.value
ESTIMATE, COMMAND = FeedforwardSource.ESTIMATE.value, FeedforwardSource.COMMAND.value
REFERENCE, NONE = FeedforwardSource.REFERENCE.value, FeedforwardSource.NONE.value


@kernel
def choose_kernel(settings, state, sample, out):
    """Put the motion to answer for into state.trajectory. Returns (source, flags)."""
    coast, settled = coast_cycles(settings), settled_cycles(settings)
    motion = state.trajectory
    out.target_sequence = sample.sequence
    ahead = np.int64(state.reference_sequence - sample.sequence)
    flags = state.reference_faults
    state.reference_faults = 0
    if state.reference_valid != 0 and state.started != 0 and 0 < ahead <= REFERENCE_AHEAD * settings.stride:
        if _is_near(settings, state, ahead):
            out.target_sequence = state.reference_sequence
            for order in range(3):
                for i in range(len(state.torque)):
                    motion[order, i] = state.reference[order, i]
            return REFERENCE, flags
        flags |= _COMMAND_JUMP
    if state.commanded.used > settled and state.commanded.idle <= coast:
        take_kernel(state.commanded, motion)
        return COMMAND, flags
    if state.measured.used > settled and state.measured.idle <= coast:
        take_kernel(state.measured, motion)
        return ESTIMATE, flags
    return NONE, flags


@kernel
def take_kernel(track, motion):
    """The newest motion of `track` into motion (3, n)."""
    for order in range(3):
        for i in range(len(track.seen)):
            motion[order, i] = track.state[i, order]


@kernel
def _is_near(settings, state, ahead):
    """Whether the joints could be where the plan wants them by then."""
    reach = REFERENCE_DISTANCE + settings.speed * settings.period * (ahead + state.measured.idle)
    near = True
    for i in range(len(state.torque)):
        near &= abs(state.reference[POSITION, i] - state.measured.seen[i]) <= reach
    return near


@kernel
def stay_kernel(state):
    """Want what is there: of a motion that jumped, what it was before is as little known as where it leads."""
    for i in range(len(state.torque)):
        state.wanted[i] = state.torque[i]
        state.direction[i] = state.direction_before[i]


@kernel
def take_plan_kernel(settings, state, reference):
    """Take the planned motion `reference` if it is one; else the next answer says what is wrong with it."""
    flags = 0
    for i in range(len(state.torque)):
        position, velocity, acceleration = reference.position[i], reference.velocity[i], reference.acceleration[i]
        # written so that NaN fails
        if not (settings.range[0] <= position <= settings.range[1]):
            flags |= _COMMAND_RANGE
        if not (abs(velocity) <= settings.speed and abs(acceleration) <= COMMAND_ACCELERATION):
            flags |= _COMMAND_JUMP
    if flags == 0:
        state.reference_valid = 1
        state.reference_sequence = reference.sequence
        for i in range(len(state.torque)):
            state.reference[POSITION, i] = reference.position[i]
            state.reference[VELOCITY, i] = reference.velocity[i]
            state.reference[ACCELERATION, i] = reference.acceleration[i]
    state.reference_faults = flags


@kernel
def bound_kernel(settings, state, seconds, out):
    """out.torque: state.wanted, at most the peak, and from answer to answer at most the slope, which grows by so much a
    cycle and may end at once, but for a reversal of Coulomb friction, state.turned, which is a step by nature."""
    flags = 0
    growth = settings.growth * seconds / settings.period
    for i in range(len(state.torque)):
        turned = state.turned[i]
        step = max(settings.slope * seconds, abs(turned))
        least, most = min(0.0, state.climb[i] - growth) * seconds, max(0.0, state.climb[i] + growth) * seconds
        low = max(-settings.peak, state.torque[i] + max(-step, least - abs(turned)))
        high = min(settings.peak, state.torque[i] + min(step, most + abs(turned)))
        torque = min(max(state.wanted[i], low), high)
        if torque != state.wanted[i]:
            flags = _LIMITED
        state.climb[i] = min(max(torque - state.torque[i] - turned, least), most) / seconds
        out.torque[i] = torque
    state.faded = 0.0
    state.held = 0
    return flags


@kernel
def fade_kernel(settings, state, seconds, out):
    """out.torque: in a straight line from the last usable one to zero within the declared time."""
    if state.faded == 0.0:
        for i in range(len(state.torque)):
            state.fade_from[i] = state.torque[i]
    state.faded += seconds
    left = max(0.0, 1.0 - state.faded / settings.fade)
    flags = 0
    for i in range(len(state.torque)):
        out.torque[i] = left * state.fade_from[i]
        state.climb[i] = (out.torque[i] - state.torque[i]) / seconds
        if out.torque[i] != 0.0:
            flags = _FADING
        state.direction_before[i] = 0.0
    return flags
