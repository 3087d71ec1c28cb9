"""One estimator step: a sample record in; feed-forward, payload and model-error records out.

Two branches leave the filters. The feed-forward branch is causal and waits for nothing: it takes the planned motion,
the commanded position or, failing both, the estimate. The payload branch looks at the sample a fixed lag ago with
smoothed motion, says what every model got wrong there, and feeds what is left to the payload estimate.

A sample that cannot be used (not finite, out of range, a jump, a repeat, out of order) is answered like any other, with
its flags set; the filters coast over it. So is a command that cannot be followed.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from schemas.kernels import kernel, part
from schemas.messages import PayloadEvent
from service.estimator.branch import ANSWERED, MEASURED, forget_kernel, wake_kernel
from service.estimator.commanded import PROOF_TIME, compare_kernel, is_used
from service.estimator.departure import BALLS, PARTS, SCALE, place
from service.estimator.feedforward import (
    dry_and_viscous,
    feedforward_kernel,
    grey_kernel,
    hold_kernel,
    load_kernel,
    place_kernel,
    torque_kernel,
    weight_kernel,
)  # fmt: skip
from service.estimator.kalman import (
    MAX_LAG,
    VELOCITY,
    acceleration_variance_kernel,
    largest_innovation,
    smooth_kernel,
)
from service.estimator.payload.payload_state import LOADS, PRIOR_STD
from service.estimator.payload.payload_step import loosen_kernel, payload_kernel, unseen_kernel, weigh_anew_kernel
from service.estimator.readout import (
    COMMAND,
    TOLD,
    follow_kernel,
    keep_load_kernel,
    lag_kernel,
    weigh_reports_kernel,
)
from service.estimator.stream import (
    RANGE,
    STATE_NEW,
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
)  # fmt: skip
from service.estimator.turning import swing_kernel, turn_kernel
from service.model.dynamics import GRAVITY, INERTIA, PLATFORM, REST_SPEED
from service.model.gears import begin_swing_kernel, observe_kernel
from service.model.kinematics import REACHED
from service.model.signals import ramp

# Presliding and Stribeck effects live below this speed: the payload looks at a joint there where nothing is faster.
REVERSAL_SPEED = 0.05  # rad/s
# And die out below this one, in gears that lubricant keeps apart; whether they do is seen (`scatter`).
CREEPING_SPEED = 0.4  # rad/s
# Variance of an acceleration, over that of one with all samples around it, beyond which it says nothing of the mass: at
# the edge of a hole it is guessed, and a torque sample is not.
LOOSE_ACCELERATION = 1.5
# The rigid-body terms are known to about this share of themselves after identification.
MODEL_SHARE = 0.01


@kernel
def _remember(settings, state, sample, flags, gap):
    """Put the newest cycle into the lag line."""
    remember_kernel(settings, state, flags, gap)
    state.unexpected = max(np.int64(0), state.unexpected - 1)
    if state.unsettled > 0 and largest_innovation(settings.motion, state.measured) > UNEXPECTED:
        state.unexpected = 2 * settings.motion.lag
    turn_kernel(state, sample.fourth_position, gap)
    past = state.past[state.head]
    past.stamp_sec = sample.stamp_sec
    past.stamp_nanosec = sample.stamp_nanosec
    past.sequence = sample.sequence
    past.flags = flags
    past.gripper = sample.gripper
    past.commanded = 1 if flags & UNUSABLE == 0 else 0
    for i in range(3):
        if not math.isfinite(sample.torque_command[i]):
            past.commanded = 0
    for i in range(3):
        state.newest_torque[i] = past.acting[i] = sample.torque[i] if flags & UNUSABLE == 0 else 0.0
        state.newest_command[i] = sample.torque_command[i] if past.commanded != 0 else state.newest_torque[i]
        past.torque_command[i] = state.newest_command[i]
    if settings.readout.follows > 0.0 and flags & UNUSABLE == 0:
        follow_kernel(settings.readout, state.readout.report, past.acting, gap * settings.period)
        follow_kernel(settings.readout, state.readout.command, past.torque_command, gap * settings.period)


@part
def lagged_kernel(settings, state, payload_out, error_out):
    """Model errors and payload at the sample `lag` ago, with motion smoothed by what came since."""
    lag, motion, weighed, branch = settings.motion.lag, state.trajectory, state.payload, state.branch[MEASURED]
    index = (state.head - lag + MAX_LAG + 1) % (MAX_LAG + 1)
    past, cycles = state.past[index], state.slots[index].gap
    event = PayloadEvent.NONE.value
    flags = past.flags
    if settings.readout.ahead == 0 and state.past[state.head].commanded != 0:
        _compare(settings, state, state.newest_torque, state.newest_command)
    carried = min(max(weighed.mass, 0.0), settings.max_payload)
    since = np.int64(0)
    if flags & UNUSABLE == 0:
        smooth_kernel(settings.motion.transition, state.slots, state.head, lag, state.adjoint, motion)
        since = wake_kernel(branch, cycles, coast_cycles(settings))
        if since == 0 and settings.remembers != 0:
            flags |= STATE_NEW
        if place_kernel(settings, state, MEASURED, since * settings.period, carried) != REACHED:
            flags |= RANGE
    else:
        branch.idle += cycles
    if flags & UNUSABLE != 0:
        for i in range(3):
            error_out.kh[i] = error_out.id[i] = error_out.id_friction[i] = error_out.full[i] = math.nan
    else:
        told = _read_out(settings, state, index, past, since)
        swing_kernel(settings, state, weighed.column)
        torque_kernel(settings, state, branch, past.stamp_sec + past.stamp_nanosec * 1e-9, carried, settings.transition)
        _tell(settings, state, _is_loose(settings, state) or not told, since)
        weighed.gripper = past.gripper
        if settings.geared != 0 and told:
            left, sticks = state.models[0], state.models[1]
            for i in range(3):
                left[i] = (state.acting[i] - state.full[i]) / settings.scale[i]
                sticks[i] = settings.coulomb[i] if weighed.weight[i] <= 0.0 else 0.0
            observe_kernel(settings.gears, branch.twist, left, state.push, sticks, since * settings.period)
        event = payload_kernel(settings.payload, weighed)
        if weighed.behind != 0 and weighed.changed > 0:
            keep_load_kernel(settings.readout, state.readout, carried, state.told[1], weighed.changed * settings.period)
        if settings.geared != 0 and weighed.changed > 0:
            _swing_anew(settings, state, carried)
        _errors(settings, state, since, error_out)
    error_out.flags = flags
    payload_out.mass = weighed.mass
    payload_out.std_dev = weighed.std_dev
    payload_out.random_std_dev = weighed.random_std_dev
    payload_out.common_std_dev = weighed.common_std_dev
    payload_out.excitation = weighed.information[0, 0] - PRIOR_STD**-2
    payload_out.trusted = weighed.trusted
    payload_out.event = event
    payload_out.stamp_sec = error_out.stamp_sec = past.stamp_sec
    payload_out.stamp_nanosec = error_out.stamp_nanosec = past.stamp_nanosec
    payload_out.sequence = error_out.sequence = past.sequence


@part
def _swing_anew(settings, state, carried):
    """The gears swing since a change of load that this sample shows. carried: kg, until then. What was told since, told
    it as of a load that hangs there since ever, and is in doubt by what a swing leaves of its mean."""
    weighed, branch = state.payload, state.branch[MEASURED]
    step, seconds = weighed.mass - carried, weighed.changed * settings.period
    swings = begin_swing_kernel(settings.gears, branch.twist, step) * seconds
    loosen_kernel(weighed, 0.5 * step * step / max(1.0, swings * swings))


@kernel
def _compare(settings, state, torque, command):
    """Compare a command (3,) with the torque (3,) that was reported, N m."""
    if compare_kernel(settings.drive_torque, state.drive_torque, torque, command, settings.period):
        weigh_anew_kernel(state.payload)  # it was by what was no torque


@part
def _compare_behind(settings, state, since):
    """The same of the one in state.command, which the report is behind, `since` cycles after the last, 0 where one of
    the two is not known."""
    reading, command, known = state.readout, state.command, since > 0
    if settings.readout.lag > 0.0:
        lag_kernel(settings.readout, reading, command, COMMAND, since * settings.period)
        reading.awake = reading.awake + settings.period if since == 1 else 0.0
        known = reading.awake > PROOF_TIME  # until when it may be behind another torque
    if known:
        _compare(settings, state, state.reported, command[0])


@part
def _read_out(settings, state, index, past, since):
    """state.reported (3,) and state.acting (3,), N m: report and torque that acts at the slot `index`, `since` cycles
    after the last. Returns whether the reports that tell it are there."""
    state.by_command = 0
    commanded = past.commanded != 0 and is_used(settings.drive_torque, state.drive_torque)
    state.payload.commanded = 1 if commanded else 0
    if settings.readout.active == 0:
        drive = past.torque_command if commanded else past.acting
        for i in range(3):  # no drive follows here: what acts is what is reported
            state.reported[i], state.acting[i] = past.acting[i], drive[i]
        return True
    reading, first = settings.readout, settings.readout.first
    whole = weigh_reports_kernel(reading.shift, first, state.past, index, UNUSABLE, False, state.reported)
    if reading.ahead != 0:
        command = state.command[0]
        there = weigh_reports_kernel(
            reading.command, reading.first_command, state.past, index, UNUSABLE, True, state.acting
        )
        for i in range(3):
            command[i] = state.acting[i]
        _compare_behind(settings, state, since if whole and there else np.int64(0))
        commanded = there and is_used(settings.drive_torque, state.drive_torque)
        state.payload.commanded = 1 if commanded else 0
        if commanded:
            state.by_command = 1
            return True
    return weigh_reports_kernel(reading.acting, first, state.past, index, UNUSABLE, commanded, state.acting)


@kernel
def _is_loose(settings, state):
    """Whether the acceleration of now is guessed."""
    loose = state.unexpected > 0
    if state.unsettled > 0 and not loose:
        lag = settings.motion.lag
        variance = acceleration_variance_kernel(settings.motion, state.slots, state.head, lag, state.adjoint)
        loose = variance > LOOSE_ACCELERATION * settings.motion.acceleration_variance
    return loose


@kernel
def _tell(settings, state, loose, since):
    """What the sample, `since` cycles after the last, says of the payload, into state.payload. loose: nothing."""
    terms, motion, weighed = state.terms, state.trajectory, state.payload
    weighed.resting = 0 if loose else 1
    for i in range(3):
        speed = abs(motion[VELOCITY, i])
        friction = dry_and_viscous(settings, state, i)
        # the load's share of a changed scale is the mass's by what is known of it, else the scale's
        scale, load = weighed.departure.delta[place(i, SCALE)], load_kernel(settings, state, i)
        carried = weighed.mass * load
        state.told[0, i] = state.full[i] - scale * carried
        weighed.column[i, 0] = load
        for p in range(LOADS):
            weighed.column[i, p] *= 1.0 + scale
        weighed.shape[i, 0] = settings.scale[i] * state.direction[i]
        weighed.shape[i, 1] = settings.scale[i] * motion[VELOCITY, i]
        weighed.shape[i, 2] = 1.0
        weighed.shape[i, SCALE] = state.full[i] + carried
        weighed.shape[i, BALLS] = settings.scale[i] * state.balls[i]
        doubt = MODEL_SHARE * (
            abs(terms[INERTIA, i]) + abs(terms[GRAVITY, i]) + abs(terms[PLATFORM, i]) + abs(friction)
        )
        # a resting joint's friction can be anything within Coulomb's bounds, the same for as long as it rests
        unsure = doubt * doubt + state.branch[MEASURED].doubt[i]
        weight = 0.0 if loose else 1.0 / (settings.variance[i] + unsure)
        weighed.weight[i] = weight if speed > REVERSAL_SPEED else 0.0
        weighed.creeps[i] = 1 if REVERSAL_SPEED < speed <= CREEPING_SPEED else 0
        if speed > REST_SPEED:
            weighed.resting = 0
        weighed.slow.now.phi[i] = (1.0 + scale) * weight_kernel(settings, state, i)
        weighed.slow.now.weight[i] = weight if REST_SPEED < speed <= REVERSAL_SPEED else 0.0
    if settings.readout.lag > 0.0 and state.by_command == 0:
        _tell_as_reported(settings, state, since * settings.period if weighed.behind != 0 else 0.0)
        weighed.behind = 1
        weighed.commanded = 0
    else:
        weighed.behind = 0
    for i in range(3):
        measured = state.reported[i] if weighed.behind != 0 else state.acting[i]
        weighed.residual[i] = measured - state.told[0, i]


@part
def _tell_as_reported(settings, state, elapsed):
    """Put what the payload is told by behind the low-pass of the report, `elapsed` s after the last. The load until the
    last change is still in what is reported now, and what is left of it there is no part of the one of now."""
    told, weighed, reading = state.told, state.payload, state.readout
    for i in range(3):
        for p in range(LOADS):
            told[1 + p, i] = weighed.column[i, p]
        for a in range(PARTS):
            told[1 + LOADS + a, i] = weighed.shape[i, a]
    lag_kernel(settings.readout, reading, told, 0, elapsed)
    keep = ramp(elapsed / settings.readout.lag)[0] if elapsed > 0.0 else 0.0
    for i in range(3):
        reading.remains[i] *= keep
        told[0, i] += reading.load_before * reading.remains[i]
        for p in range(LOADS):
            weighed.column[i, p] = told[1 + p, i]
        weighed.column[i, 0] -= reading.remains[i]
        for a in range(PARTS):
            weighed.shape[i, a] = told[1 + LOADS + a, i]


@kernel
def _errors(settings, state, since, error_out):
    """Reported torque less what each model would have reported, `since` cycles after the last."""
    usable = state.payload.usable
    for i in range(3):
        grey, friction = grey_kernel(settings, state.terms, i), dry_and_viscous(settings, state, i)
        rigid = state.terms[INERTIA, i] + state.terms[GRAVITY, i] + state.terms[PLATFORM, i]
        carried = usable * load_kernel(settings, state, i)
        error_out.kh[i] = state.reported[i] - rigid
        error_out.id[i] = state.reported[i] - grey
        error_out.id_friction[i] = state.reported[i] - grey - friction
        error_out.full[i] = state.reported[i] - state.full[i] - carried
        models = state.models
        models[0, i], models[1, i], models[2, i] = rigid, grey, grey + friction
        models[3, i] = state.full[i] + carried
    if settings.readout.lag > 0.0:
        _behind(settings, state, since, error_out)


@kernel
def _behind(settings, state, since, error_out):
    """Give the errors what the report's low-pass leaves out of each model's torque."""
    models = state.models
    for i in range(3):
        error_out.kh[i] += models[0, i]
        error_out.id[i] += models[1, i]
        error_out.id_friction[i] += models[2, i]
        error_out.full[i] += models[3, i]
    lag_kernel(settings.readout, state.readout, models, TOLD, since * settings.period)
    for i in range(3):
        error_out.kh[i] -= models[0, i]
        error_out.id[i] -= models[1, i]
        error_out.id_friction[i] -= models[2, i]
        error_out.full[i] -= models[3, i]


@part
def step_kernel(settings, state, sample, feedforward):
    """One sample. Fills `feedforward`. Returns whether there is a sample the fixed lag ago, to look back on."""
    gap = cycles_since(settings, state, sample)
    flags, begins, elsewhere, forward = judge_kernel(settings, state, sample, gap)
    if forward:
        state.held = 0
        passed = max(gap, np.int64(1))  # none, where a source started over
        if begins:
            if elsewhere or (state.measured.idle + gap) * settings.period > UNSEEN_TIME:
                unseen_kernel(state.payload)
                state.drive_torque.proved = 0.0
            gap = 1
            restart(settings, state, sample)
            forget_kernel(state.branch[MEASURED])
            forget_kernel(state.branch[ANSWERED])
            state.readout.report.started = state.readout.command.started = 0
        else:
            track_kernel(settings, state, sample, flags, gap)
        track_command_kernel(settings, state, sample, flags, gap)
        state.sequence = sample.sequence
        state.stamp_sec = sample.stamp_sec
        state.stamp_nanosec = sample.stamp_nanosec
        _remember(settings, state, sample, flags, gap)
        flags |= feedforward_kernel(settings, state, sample, passed, feedforward)
    else:
        flags |= hold_kernel(settings, state, sample, feedforward)
    feedforward.stamp_sec = sample.stamp_sec
    feedforward.stamp_nanosec = sample.stamp_nanosec
    feedforward.sequence = sample.sequence
    feedforward.flags = flags
    return bool(forward and state.filled > settings.motion.lag)


@kernel
def answer_kernel(steps) -> tuple[int, bool]:
    """Answer the one sample in `steps` (1,), records of STEP. Returns the answer's flags, and as `step_kernel`."""
    step = steps[0]
    lagged = step_kernel(step.settings, step.state, step.sample, step.feedforward)
    return int(step.feedforward.flags), bool(lagged)


@kernel
def look_back_kernel(steps) -> int:
    """Fill payload and error in `steps` (1,) after `answer_kernel`. Returns the payload event."""
    step = steps[0]
    lagged_kernel(step.settings, step.state, step.payload, step.error)
    return int(step.payload.event)


def compile_beside_payload(step: np.void) -> None:
    """Compile what `look_back_kernel` calls beside the payload. step: a STEP record."""
    settings, state, error = (numba.typeof(step[name]) for name in ("settings", "state", "error"))
    _is_loose.inside.compile((settings, state))
    _tell.inside.compile((settings, state, numba.boolean, numba.int64))
    _errors.inside.compile((settings, state, numba.int64, error))


@kernel
def run_kernel(steps, samples, feedforward, payload_out, error_out):
    """Samples in order. Returns how many of `payload_out` and `error_out` are filled, from the front."""
    step, lagged = steps[0], 0
    for n in range(len(samples)):
        if step_kernel(step.settings, step.state, samples[n], feedforward[n]):
            lagged_kernel(step.settings, step.state, payload_out[lagged], error_out[lagged])
            lagged += 1
    return lagged
