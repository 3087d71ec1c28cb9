"""One estimator step: a sample record in; feed-forward, payload and model-error records out.

Two branches leave the filters. The feed-forward branch is causal and waits for nothing: it takes the planned motion,
the commanded position or, failing both, the estimate. The payload branch looks at the sample a fixed lag ago with
smoothed motion, says what every model got wrong there, and feeds what is left to the payload estimate.

A sample that cannot be used (not finite, out of range, a jump, a repeat, out of order) is answered like any other, with
its flags set; the filters coast over it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from schemas.messages import CDR_LITTLE_ENDIAN, FeedforwardSource, PayloadEvent, SampleFlag
from service.estimator.effects import effects_kernel
from service.estimator.kalman import MAX_LAG, ORDER, predict_kernel, update_kernel
from service.estimator.payload import MODEL_SHARE, PRIOR_STD, RIGID, WEIGHT, payload_kernel
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, terms_kernel
from service.model.friction import direction, friction_kernel
from service.model.kinematics import REACHED

MAX_JOINT_SPEED = 40.0  # rad/s, no Delta joint is faster
COAST_TIME = 0.02  # s without a usable sample after which the filters start anew
STRAY_RUN = 3  # samples in a row that agree with each other but not with the stream: the stream itself is new
SETTLE_TIME = 0.02  # s after a start until velocity and acceleration are worth using
REFERENCE_AHEAD = 8  # cycles, planned motion further ahead is not for the next cycles
# Presliding and Stribeck effects live below this speed: the payload does not look at a joint there.
REVERSAL_SPEED = 0.05  # rad/s

_NAN, _RANGE, _GAP = SampleFlag.NOT_A_NUMBER.value, SampleFlag.OUT_OF_RANGE.value, SampleFlag.GAP_BEFORE.value
_REPEATED, _BACKWARDS = SampleFlag.REPEATED.value, SampleFlag.TIME_BACKWARDS.value
_JUMP, _NO_COMMAND = SampleFlag.JUMP.value, SampleFlag.NO_COMMAND.value
_UNUSABLE = _NAN | _RANGE | _REPEATED | _BACKWARDS | _JUMP | SampleFlag.BUS_FAULT.value
_ESTIMATE, _COMMAND = FeedforwardSource.ESTIMATE.value, FeedforwardSource.COMMAND.value
_REFERENCE, _NONE = FeedforwardSource.REFERENCE.value, FeedforwardSource.NONE.value
_CDR = np.frombuffer(CDR_LITTLE_ENDIAN, np.uint8).copy()


@njit(cache=True)
def _restart(state, sample):
    """Begin a stream at `sample`: at rest where it is, nothing settled."""
    state.started = 1
    state.stray = 0
    state.head = 0
    state.filled = 0
    state.settled = 0
    state.idle = 0
    state.command_settled = 0
    state.stamp_sec = sample.stamp_sec
    state.stamp_nanosec = sample.stamp_nanosec
    for i in range(3):
        state.measured[i, 0] = sample.position[i]
        for order in range(1, ORDER):
            state.measured[i, order] = 0.0


@njit(cache=True)
def _flags(settings, state, sample, gap):
    """What is wrong with `sample`, given the stream so far. gap: sequence minus the newest one's."""
    flags = np.int64(sample.flags)
    for i in range(3):
        if not (math.isfinite(sample.position[i]) and math.isfinite(sample.torque[i])):
            flags |= _NAN
        elif sample.position[i] < settings.range[0] or sample.position[i] > settings.range[1]:
            flags |= _RANGE
        if not math.isfinite(sample.position_command[i]):
            flags |= _NO_COMMAND
    if state.started == 0:
        return flags
    if gap == 0:
        flags |= _REPEATED
    elif gap < 0:
        flags |= _BACKWARDS
    else:
        if gap > 1:
            flags |= _GAP
        if flags & (_NAN | _RANGE) == 0:
            reach = MAX_JOINT_SPEED * settings.period * gap
            for i in range(3):
                if abs(sample.position[i] - state.measured[i, 0]) > reach:
                    flags |= _JUMP
    return flags


@njit(cache=True)
def _gap(settings, state, sample):
    """Cycles since the newest sample: by sequence, and by time where a source leaves no hole in its sequence."""
    if state.started == 0:
        return np.int64(1)
    counted = np.int64(sample.sequence) - np.int64(state.sequence)
    seconds = np.int64(sample.stamp_sec) - state.stamp_sec
    elapsed = (seconds + (np.int64(sample.stamp_nanosec) - state.stamp_nanosec) * 1e-9) / settings.period
    return max(counted, np.int64(round(min(elapsed, 1e9)))) if counted > 0 else counted


@njit(cache=True)
def _is_new_stream(settings, state, sample):
    """Whether the strays of late, `sample` being one, continue each other: then the source started over elsewhere."""
    follows = state.stray > 0 and sample.sequence == state.stray_sequence + np.uint64(1)
    for i in range(3):
        if not abs(sample.position[i] - state.stray_position[i]) <= MAX_JOINT_SPEED * settings.period:
            follows = False
        state.stray_position[i] = sample.position[i]
    state.stray = state.stray + 1 if follows else 1
    state.stray_sequence = sample.sequence
    return state.stray >= STRAY_RUN


@njit(cache=True)
def _filter(settings, state, sample, usable, gap):
    """Move the filters on to `sample`; the innovations of the measured position go to the lag line."""
    gains = settings.filter
    for i in range(3):
        for _ in range(gap):
            predict_kernel(gains.transition, state.measured[i], state.predicted[i])
            for order in range(ORDER):
                state.measured[i, order] = state.predicted[i, order]
        innovation = sample.position[i] - state.measured[i, 0] if usable else 0.0
        update_kernel(gains.gain, state.predicted[i], innovation, state.measured[i])
        state.innovation[i] = innovation


@njit(cache=True)
def _follow_command(settings, state, sample, flags, gap):
    gains = settings.filter
    if flags & (_NO_COMMAND | _REPEATED | _BACKWARDS) != 0:
        state.command_settled = 0
        return
    if state.command_settled == 0 or gap > 1:
        state.command_settled = 0
        for i in range(3):
            state.commanded[i, 0] = sample.position_command[i]
            for order in range(1, ORDER):
                state.commanded[i, order] = state.measured[i, order]  # close, and right within a few samples
    else:
        for i in range(3):
            predict_kernel(gains.transition, state.commanded[i], state.predicted[i])
            innovation = sample.position_command[i] - state.predicted[i, 0]
            update_kernel(gains.gain, state.predicted[i], innovation, state.commanded[i])
    state.command_settled += 1


@njit(cache=True)
def _feedforward(settings, state, sample, flags, out):
    """Torque for the motion that the controller wants, or failing that for the motion there is."""
    settle = SETTLE_TIME / settings.period
    ahead = np.int64(state.reference_sequence) - np.int64(sample.sequence)
    out.target_sequence = sample.sequence
    if state.reference_valid != 0 and 0 < ahead <= REFERENCE_AHEAD:
        source = _REFERENCE
        out.target_sequence = state.reference_sequence
        for i in range(3):
            for order in range(3):
                state.motion[order, i] = state.reference[order, i]
    elif state.command_settled > settle:
        source = _COMMAND
        for i in range(3):
            for order in range(3):
                state.motion[order, i] = state.commanded[i, order]
    elif state.settled > settle and state.idle * settings.period <= COAST_TIME and flags & _UNUSABLE == 0:
        source = _ESTIMATE
        for i in range(3):
            for order in range(3):
                state.motion[order, i] = state.measured[i, order]
    else:
        source = _NONE
    status = REACHED
    if source != _NONE:
        status = terms_kernel(
            settings.model, state.motion[0], state.motion[1], state.motion[2], state.position, state.work, state.terms
        )
    if source == _NONE or status != REACHED:
        source = _NONE
        for i in range(3):
            out.torque[i] = 0.0
    else:
        mass = _usable_mass(state)
        _torque(settings, state, sample.stamp_sec + sample.stamp_nanosec * 1e-9)
        for i in range(3):
            out.torque[i] = state.full[i] + mass * _load(settings, state, state.believed, i)
    out.source = source


@njit(cache=True)
def _torque(settings, state, seconds):
    """state.full (3,): reported torque, N m, of the fullest model without payload, for state.motion and its terms."""
    terms, motion = state.terms, state.motion
    for i in range(3):
        state.load[i] = _grey(settings, terms, i) + settings.forearm * terms[FOREARM, i]
        state.way[i] = direction(motion[1, i], settings.transition)
        state.full[i] = state.load[i] + _friction(settings, state, i)
    effects_kernel(
        settings.effect, settings.model, settings.gear_ratio, settings.rho[1, 0], motion[0], motion[1], motion[2],
        state.way, state.load, seconds, state.position, state.work, state.full,
    )  # fmt: skip
    for i in range(3):
        state.full[i] *= settings.scale[i]


@njit(cache=True)
def _friction(settings, state, i):
    """Coulomb and viscous friction of joint i, N m."""
    return friction_kernel(settings.viscous[i], settings.coulomb[i], state.motion[1, i], settings.transition)


@njit(cache=True)
def _grey(settings, terms, i):
    """M_Id of joint i, N m."""
    return settings.rho[0, i] * terms[INERTIA, i] + settings.rho[1, i] * terms[GRAVITY, i] + terms[PLATFORM, i]


@njit(cache=True)
def _load(settings, state, hypothesis, i):
    """Reported torque on joint i per kg of payload, N m/kg, for the pose last given to the terms kernel."""
    if hypothesis == RIGID:
        return settings.scale[i] * state.terms[PAYLOAD, i]
    # J[z, i] g: the kernel left column_i in work[1] and the levers in work[4, 0]
    return settings.scale[i] * state.work[1, i, 2] * state.work[4, 0, i] * settings.model.gravity


@njit(cache=True)
def _usable_mass(state):
    """The payload to reckon with, kg: the trusted one; an estimate not yet trusted may only make it lighter."""
    mass = state.mass if state.mass_trusted != 0 else min(state.mass, state.payload.load)
    return max(0.0, mass)


@njit(cache=True)
def _remember(settings, state, sample, flags):
    state.head = (state.head + 1) % (MAX_LAG + 1)
    if state.filled <= settings.filter.lag and state.settled * settings.period > SETTLE_TIME:
        state.filled += 1
    past = state.past[state.head]
    past.stamp_sec = sample.stamp_sec
    past.stamp_nanosec = sample.stamp_nanosec
    past.sequence = sample.sequence
    past.flags = flags
    for i in range(3):
        past.innovation[i] = state.innovation[i]
        past.torque[i] = sample.torque[i]
        for order in range(ORDER):
            past.filtered[i, order] = state.measured[i, order]


@njit(cache=True)
def _lagged(settings, state, payload_out, error_out):
    """Model errors and payload at the sample `lag` ago, with motion smoothed by what came since."""
    lag = settings.filter.lag
    index = (state.head - lag + MAX_LAG + 1) % (MAX_LAG + 1)
    past = state.past[index]
    event = PayloadEvent.NONE.value
    status = REACHED
    if past.flags & _UNUSABLE == 0:
        for i in range(3):
            for order in range(3):
                state.motion[order, i] = past.filtered[i, order]
            for n in range(lag):
                innovation = state.past[(index + n + 1) % (MAX_LAG + 1)].innovation[i]
                for order in range(3):
                    state.motion[order, i] += settings.filter.smoothing[n, order] * innovation
        status = terms_kernel(
            settings.model, state.motion[0], state.motion[1], state.motion[2], state.position, state.work, state.terms
        )
    if past.flags & _UNUSABLE != 0 or status != REACHED:
        for i in range(3):
            error_out.kh[i] = error_out.id[i] = error_out.id_friction[i] = error_out.full[i] = math.nan
        error_out.flags = past.flags | (_RANGE if status != REACHED else 0)
    else:
        _torque(settings, state, past.stamp_sec + past.stamp_nanosec * 1e-9)
        for i in range(3):
            terms, speed = state.terms, abs(state.motion[1, i])
            kh = terms[INERTIA, i] + terms[GRAVITY, i] + terms[PLATFORM, i]
            grey = _grey(settings, terms, i)
            friction = _friction(settings, state, i)
            error_out.kh[i] = past.torque[i] - kh
            error_out.id[i] = past.torque[i] - grey
            error_out.id_friction[i] = past.torque[i] - grey - friction
            state.residual[i] = past.torque[i] - state.full[i]
            state.phi[RIGID, i] = _load(settings, state, RIGID, i)
            state.phi[WEIGHT, i] = _load(settings, state, WEIGHT, i)
            doubt = MODEL_SHARE * (
                abs(terms[INERTIA, i]) + abs(terms[GRAVITY, i]) + abs(terms[PLATFORM, i]) + abs(friction)
            )
            # a resting joint's friction can be anything within Coulomb's bounds, the same for as long as it rests
            state.noise[i] = settings.variance[i] + doubt * doubt if speed > REVERSAL_SPEED else math.inf
        mass, std_dev, trusted, event = payload_kernel(
            state.payload, settings.forgetting, settings.bin_size, settings.worth,
            state.phi, state.residual, state.noise,
        )  # fmt: skip
        believed = state.payload.believed
        state.mass = mass
        state.std_dev = std_dev
        state.believed = believed
        state.mass_trusted = 1 if trusted else 0
        load = _usable_mass(state)
        for i in range(3):
            error_out.full[i] = state.residual[i] - load * state.phi[believed, i]
        error_out.flags = past.flags
    payload_out.mass = state.mass
    payload_out.std_dev = state.std_dev
    payload_out.excitation = state.payload.information[state.believed] - PRIOR_STD**-2
    payload_out.trusted = state.mass_trusted
    payload_out.weight_only = 1 if state.believed == WEIGHT else 0
    payload_out.event = event
    payload_out.stamp_sec = error_out.stamp_sec = past.stamp_sec
    payload_out.stamp_nanosec = error_out.stamp_nanosec = past.stamp_nanosec
    payload_out.sequence = error_out.sequence = past.sequence
    for n in range(4):
        payload_out.cdr_header[n] = error_out.cdr_header[n] = _CDR[n]


@njit(cache=True)
def step_kernel(settings, state, sample, feedforward, payload_out, error_out):
    """One sample. Fills `feedforward`; once the lag line is full also `payload_out` and `error_out`, returning True."""
    gap = _gap(settings, state, sample)
    flags = _flags(settings, state, sample, gap)
    if state.started == 0 and flags & _UNUSABLE == 0:
        _restart(state, sample)
    elif flags & (_REPEATED | _BACKWARDS | _JUMP) != 0 and flags & (_NAN | _RANGE) == 0:
        if _is_new_stream(settings, state, sample):
            _restart(state, sample)
            flags = (flags & ~(_REPEATED | _BACKWARDS | _JUMP)) | _GAP
            gap = 1
    elif flags & (_NAN | _RANGE) == 0:
        state.stray = 0

    forward = state.started != 0 and flags & (_REPEATED | _BACKWARDS) == 0
    if forward:
        usable = flags & _UNUSABLE == 0
        if (gap - 1) * settings.period > COAST_TIME and usable:
            _restart(state, sample)
            gap = 1
        elif gap > 1:
            state.filled = 0  # the smoother's weights hold for unbroken samples
        _filter(settings, state, sample, usable, min(gap, np.int64(COAST_TIME / settings.period) + 1))
        state.idle = 0 if usable else state.idle + gap
        state.settled = state.settled + 1 if usable else state.settled
        _follow_command(settings, state, sample, flags, gap)
        state.sequence = sample.sequence
        state.stamp_sec = sample.stamp_sec
        state.stamp_nanosec = sample.stamp_nanosec
        _remember(settings, state, sample, flags)

    if flags & (_REPEATED | _BACKWARDS) == 0:
        _feedforward(settings, state, sample, flags, feedforward)
        for i in range(3):
            state.torque[i] = feedforward.torque[i]
        state.source = feedforward.source
    else:  # hold: a stray sample must not make the torque drop for a cycle
        feedforward.target_sequence = sample.sequence
        feedforward.source = state.source
        for i in range(3):
            feedforward.torque[i] = state.torque[i]
    for n in range(4):
        feedforward.cdr_header[n] = _CDR[n]
    feedforward.stamp_sec = sample.stamp_sec
    feedforward.stamp_nanosec = sample.stamp_nanosec
    feedforward.sequence = sample.sequence
    feedforward.flags = flags
    if not forward or state.filled <= settings.filter.lag:
        return False
    _lagged(settings, state, payload_out, error_out)
    return True


@njit(cache=True)
def run_kernel(settings, state, samples, feedforward, payload_out, error_out):
    """Samples in order. Returns how many of `payload_out` and `error_out` are filled, from the front."""
    lagged = 0
    for n in range(len(samples)):
        if step_kernel(settings[0], state[0], samples[n], feedforward[n], payload_out[lagged], error_out[lagged]):
            lagged += 1
    return lagged
