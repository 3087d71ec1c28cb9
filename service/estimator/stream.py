"""A sample in its stream: how many cycles it closes, what is wrong with it, and where a stream begins anew.

Sequence numbers are serial numbers modulo 2^64 (as RFC 1982 reckons them): one follows another if the difference, taken
modulo 2^64, is below 2^63.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.kernels import kernel
from schemas.messages import SampleFlag
from service.estimator.kalman import (
    ORDER,
    coast_kernel,
    keep_kernel,
    largest_innovation,
    predict_kernel,
    predicted_variance_kernel,
    restart_kernel,
    update_kernel,
)  # fmt: skip

# s without a usable sample for which the motion may be extrapolated. Behind a longer hole a jump and a motion look
# alike: the filters start anew, since a derivative across a jump is none.
COAST_TIME = 0.02
STRAY_RUN = 3  # samples in a row that agree with each other but not with the stream: the stream itself is new
STRAY_STEP = 8  # cycles between two of them at most
FAR = 1_000_000_000  # cycles, any more are as many
SETTLE_TIME = 0.02  # s after a start until velocity and acceleration are worth using
# No command asks this of a joint: a platform at 10 g needs 300 to 500 rad/s^2.
COMMAND_ACCELERATION = 5000.0  # rad/s^2
# Standard deviations that a position may be off what is expected: at rest, its resolution for the command's rounding.
EXPECTED = 8.0
LATCHED = 0.25  # cycles that a position may be read early or late where the drives keep no common clock
# Standard deviations of an innovation behind a hole beyond which the motion is not what the filter expects: drives that
# stood without commands and start again.
UNEXPECTED = 4.0
# In a shorter hole the load is taken to stay; what it did shows as soon as it is weighed again.
UNSEEN_TIME = 0.5  # s
# A torque sensor that reads beyond this many peak torques is broken.
TORQUE_SENSE = 10.0

NAN, RANGE, GAP = SampleFlag.NOT_A_NUMBER.value, SampleFlag.OUT_OF_RANGE.value, SampleFlag.GAP_BEFORE.value
REPEATED, BACKWARDS = SampleFlag.REPEATED.value, SampleFlag.TIME_BACKWARDS.value
JUMP, NO_COMMAND = SampleFlag.JUMP.value, SampleFlag.NO_COMMAND.value
COMMAND_RANGE, COMMAND_JUMP = SampleFlag.COMMAND_OUT_OF_RANGE.value, SampleFlag.COMMAND_JUMP.value
STATE_NEW = SampleFlag.STATE_NEW.value
NOT_NEW = REPEATED | BACKWARDS
UNUSABLE = NAN | RANGE | NOT_NEW | JUMP | SampleFlag.BUS_FAULT.value
NOT_FOLLOWED = NO_COMMAND | COMMAND_RANGE | COMMAND_JUMP


def fields(joints: int, track: np.dtype) -> list[tuple[Any, ...]]:
    """Fields that a stream has in the state of an estimator of so many joints. track: record of its filters."""
    return [
        ("started", "i8"),
        ("sequence", "u8"),
        ("stamp_sec", "i8"),
        ("stamp_nanosec", "i8"),
        ("stray", "i8"),  # samples in a row that continue each other but not the stream
        ("stray_sequence", "u8"),
        ("stray_position", "f8", joints),
        ("measured", track),
        ("commanded", track),
        ("command_stray", "i8"),  # the same of commands
        ("command_stray_position", "f8", joints),
    ]


@kernel
def restart(settings, state, sample):
    """Begin a stream at `sample`: at rest where it is, nothing settled."""
    state.started = 1
    state.stray = 0
    state.command_stray = 0
    state.filled = 0
    state.commanded.used = 0
    state.stamp_sec = sample.stamp_sec
    state.stamp_nanosec = sample.stamp_nanosec
    restart_kernel(settings.motion, state.measured, sample.position)


@kernel
def coast_cycles(settings):
    """Cycles that the filters coast over; at least one sample is let pass at any rate."""
    return max(np.int64(1), np.int64(COAST_TIME / settings.period))


@kernel
def settled_cycles(settings):
    """Positions since the start of a filter beyond which its motion is worth using: none is known from fewer than it
    has states, however slow they come."""
    return max(np.float64(ORDER), SETTLE_TIME / settings.period)


@kernel
def restart_cycles(settings):
    """Longest gap that the filters close."""
    return coast_cycles(settings) + 1


@kernel
def cycles_since(settings, state, sample):
    """Cycles since the newest sample, below 1 for a repeated or late one.

    By sequence; by time where a source leaves no hole in its sequence, if the motion bears it out: stamps jitter too.
    """
    if state.started == 0:
        return np.int64(1)
    counted = np.int64(sample.sequence - state.sequence)  # modulo 2^64
    if counted <= 0:
        return counted
    counted = max(np.int64(1), (min(counted, FAR) + settings.stride // 2) // settings.stride)
    seconds = np.int64(sample.stamp_sec) - state.stamp_sec
    elapsed = seconds + (np.int64(sample.stamp_nanosec) - state.stamp_nanosec) * 1e-9
    timed = np.int64(round(min(elapsed / settings.period, float(FAR))))
    if timed <= counted:
        return counted
    if timed > restart_cycles(settings):
        return timed
    by_count = by_time = 0.0
    for i in range(len(sample.position)):
        by_count += abs(sample.position[i] - _ahead(state.measured, i, counted * settings.period))
        by_time += abs(sample.position[i] - _ahead(state.measured, i, timed * settings.period))
    return timed if by_time < by_count else counted


@kernel
def _ahead(track, i, seconds):
    """Position of joint i, rad, `seconds` after the newest cycle, at the speed and acceleration of now."""
    return track.state[i, 0] + seconds * (track.state[i, 1] + 0.5 * seconds * track.state[i, 2])


@kernel
def faults(settings, state, sample, gap):
    """What is wrong with `sample` and its command, given the stream so far. gap: cycles since the newest sample."""
    flags = np.int64(sample.flags)
    for i in range(len(sample.position)):
        if not (math.isfinite(sample.position[i]) and math.isfinite(sample.torque[i])):
            flags |= NAN
        elif (
            sample.position[i] < settings.range[0]
            or sample.position[i] > settings.range[1]
            or abs(sample.torque[i]) > TORQUE_SENSE * settings.peak
        ):
            flags |= RANGE
        if math.isnan(sample.position_command[i]):
            flags |= NO_COMMAND
        elif sample.position_command[i] < settings.range[0] or sample.position_command[i] > settings.range[1]:
            flags |= COMMAND_RANGE
    if state.started == 0:
        return flags
    if gap == 0:
        flags |= REPEATED
    elif gap < 0:
        flags |= BACKWARDS
    else:
        if gap > 1:
            flags |= GAP
        if flags & (NAN | RANGE) == 0 and _is_torn(
            settings, state.measured, sample.position, gap, state.stray, LATCHED
        ):
            flags |= JUMP
        if flags & (NO_COMMAND | COMMAND_RANGE) == 0 and _is_no_motion(settings, state, sample.position_command, gap):
            flags |= COMMAND_JUMP
    return flags


@kernel
def _is_torn(settings, track, position, gap, strays, latched):
    """Whether no joint could have come to `position` in `gap` cycles: by its speed from where the track last saw it, or
    by its acceleration from where the track expects it.

    strays: how many came since that continue each other. latched: cycles that the position may be early or late.
    """
    farthest = settings.speed * settings.period * (track.idle + gap)
    reach = _reach(settings, track, gap, strays)
    torn = False
    for i in range(len(track.seen)):
        torn |= abs(position[i] - track.seen[i]) > farthest
        late = latched * settings.period * abs(track.state[i, 1])
        torn |= abs(position[i] - _ahead(track, i, gap * settings.period)) > reach + late
    return torn


@kernel
def _reach(settings, track, gap, strays):
    """rad that a joint can be off what the track expects `gap` cycles on: by an acceleration turned from one end to the
    other since it was last seen, and by what the track does not know.

    Both grow with the time until any jump would pass as motion. So they do not where strays came meanwhile: a sample is
    then one that takes the motion up as if there had been none, or one more of them.
    """
    cycles, motion, period = track.idle + gap, settings.motion, settings.period
    if cycles > restart_cycles(settings):
        return math.inf
    deviation = motion.resolution
    if strays > 0:
        cycles = gap
    else:
        deviation = math.sqrt(predicted_variance_kernel(motion, track, gap * period))
    turned = 2.0 * settings.acceleration * (motion.behind + 0.5 * (cycles * cycles - 1) * period * period)
    return turned + EXPECTED * deviation


@kernel
def _is_no_motion(settings, state, command, gap):
    """Whether no joint could follow from the commands so far to `command`, by its speed or its acceleration."""
    track = state.commanded
    if track.used == 0 or track.idle + gap > restart_cycles(settings):
        return False
    return _is_torn(settings, track, command, gap, state.command_stray, 0.0)


@kernel
def is_new_stream(settings, state, sample):
    """Whether the strays of late, `sample` being one, continue each other: then the source started over elsewhere."""
    step = np.int64(sample.sequence - state.stray_sequence) // settings.stride
    follows = state.stray > 0 and 0 < step <= STRAY_STEP
    for i in range(len(sample.position)):
        follows &= abs(sample.position[i] - state.stray_position[i]) <= settings.speed * settings.period * step
        state.stray_position[i] = sample.position[i]
    state.stray = state.stray + 1 if follows else 1
    state.stray_sequence = sample.sequence
    return state.stray >= STRAY_RUN


@kernel
def is_new_command(settings, state, sample, gap):
    """The same for commands that jumped: they may go on from where they jumped to."""
    follows = state.command_stray > 0
    for i in range(len(sample.position)):
        step = abs(sample.position_command[i] - state.command_stray_position[i])
        follows &= step <= settings.speed * settings.period * gap
        state.command_stray_position[i] = sample.position_command[i]
    state.command_stray = state.command_stray + 1 if follows else 1
    return state.command_stray >= STRAY_RUN


@kernel
def judge_kernel(settings, state, sample, gap):
    """What `sample`, `gap` cycles on, is to the stream: its flags; whether the stream begins at it, and that elsewhere
    than it was; whether the stream goes on with it."""
    flags = faults(settings, state, sample, gap)
    begins = elsewhere = False
    if flags & (NAN | RANGE) == 0:
        if state.started == 0:
            begins = flags & UNUSABLE == 0
        elif flags & (NOT_NEW | JUMP) == 0:
            state.stray = 0
            begins = flags & UNUSABLE == 0 and state.measured.idle + gap > restart_cycles(settings)
        elif is_new_stream(settings, state, sample):
            begins = elsewhere = True
            flags = (flags & ~(REPEATED | BACKWARDS | JUMP)) | GAP
    # a broken sample may not carry the sequence away with it
    forward = (state.started != 0 or begins) and flags & NOT_NEW == 0
    forward &= flags & UNUSABLE == 0 or gap <= restart_cycles(settings)
    return flags, begins, elsewhere, forward


@kernel
def track_kernel(settings, state, sample, flags, gap):
    """Move the filter of the measured position on to `sample`, `gap` cycles on."""
    track = state.measured
    if track.idle + gap <= restart_cycles(settings):  # beyond that the state is of no use, and must not grow
        predict_kernel(settings.motion, track, gap)
    if flags & UNUSABLE == 0:
        _update(settings, track, sample.position, gap)
    else:
        coast_kernel(track, gap)


@kernel
def _update(settings, track, position, gap):
    """Take `position`, `gap` cycles on. Behind a hole it may be one that the joints were put to: if it is not expected,
    their speed is not known until the filter has settled again."""
    behind_hole = track.idle + gap > 1
    update_kernel(settings.motion, track, position)
    if behind_hole and largest_innovation(settings.motion, track) > UNEXPECTED:
        track.used = 1


@kernel
def track_command_kernel(settings, state, sample, flags, gap):
    """Move the filter of the commanded position on to `sample`."""
    track, command, longest = state.commanded, sample.position_command, restart_cycles(settings)
    if flags & NOT_FOLLOWED == COMMAND_JUMP and is_new_command(settings, state, sample, gap):  # a source may set flags
        track.used = 0
    elif flags & NOT_FOLLOWED != 0:
        if track.used > 0:
            if track.idle + gap <= longest:
                predict_kernel(settings.motion, track, gap)
            coast_kernel(track, gap)
        return
    state.command_stray = 0
    if track.used == 0 or track.idle + gap > longest:
        restart_kernel(settings.motion, track, command)
        for i in range(len(track.seen)):
            for order in range(1, 3):
                track.state[i, order] = state.measured.state[i, order]  # close, and right within a few samples
    else:
        predict_kernel(settings.motion, track, gap)
        _update(settings, track, command, gap)


@kernel
def remember_kernel(settings, state, flags, gap):
    """Put the newest cycle into the lag line, whose head it becomes."""
    state.head = (state.head + 1) % len(state.slots)
    if state.filled <= settings.motion.lag and state.measured.used * settings.period > SETTLE_TIME:
        state.filled += 1
    keep_kernel(state.measured, gap, state.slots[state.head])
    if gap > 1 or flags & UNUSABLE != 0:
        state.unsettled = settings.motion.lag + np.int64(SETTLE_TIME / settings.period)
    elif state.unsettled > 0:
        state.unsettled -= 1
