"""The feed-forward torque: for the motion that is wanted or there is, within its bounds, faded where there is none."""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel, part
from schemas.messages import FeedforwardSource, SampleFlag
from service.estimator import departure
from service.estimator.branch import ANSWERED, MEASURED, wake_kernel
from service.estimator.effects import effects_kernel, encoder_kernel, remembering_kernel
from service.estimator.kalman import ACCELERATION, POSITION, VELOCITY
from service.estimator.stream import COMMAND_ACCELERATION, STATE_NEW, coast_cycles, settled_cycles
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, terms_kernel
from service.model.effects.base import Instant
from service.model.forward import mass_kernel
from service.model.friction import ball_joint_kernel, direction, friction_kernel
from service.model.gears import advance_kernel, doubt_kernel, lead_kernel, release_kernel, through_kernel
from service.model.kinematics import REACHED

REFERENCE_AHEAD = 8  # cycles, planned motion further ahead is not for the next cycles
REFERENCE_DISTANCE = 0.3  # rad, beyond what a joint moves until then: a plan for another place than the robot's

_LIMITED, _FADING = SampleFlag.LIMITED.value, SampleFlag.FADING.value
_FRICTION_HELD = SampleFlag.FRICTION_HELD.value
LOAD_STEP = 1e-3  # N m of load, over which the slope of friction by it is taken
_COMMAND_RANGE, _COMMAND_JUMP = SampleFlag.COMMAND_OUT_OF_RANGE.value, SampleFlag.COMMAND_JUMP.value
_ESTIMATE, _COMMAND = FeedforwardSource.ESTIMATE.value, FeedforwardSource.COMMAND.value
_REFERENCE, _NONE = FeedforwardSource.REFERENCE.value, FeedforwardSource.NONE.value


@part
def feedforward_kernel(settings, state, sample, passed, out):
    """Fill torque, source and target of `out` for `sample`, `passed` cycles after the last answer. Returns flags."""
    source, flags = _choose(settings, state, sample, out)
    seconds = passed * settings.period
    branch, since = state.branch[ANSWERED], np.int64(0)
    if source == _NONE:
        branch.idle += passed
    else:
        since = wake_kernel(branch, passed, coast_cycles(settings))
        if since == 0 and settings.remembers != 0:
            flags |= STATE_NEW
    links = source == _REFERENCE and settings.leads != 0
    transition = settings.transition if source == _ESTIMATE else settings.wanted_transition
    if source != _NONE and _for_motion(settings, state, sample, since, links, transition):
        if (source == _COMMAND and state.command_stray > 0) or (source == _ESTIMATE and state.stray > 0):
            _stay(state)
        flags |= _within_bounds(settings, state, seconds, out)
        if state.payload.departure.held != 0:
            flags |= _FRICTION_HELD
    else:
        source = _NONE
        flags |= _fade(settings, state, seconds, out)
    _lead(settings, state, seconds, links and source != _NONE, out)
    for i in range(3):
        state.torque[i] = out.torque[i]
    out.source = state.source = source
    return flags


@kernel
def _lead(settings, state, seconds, wanted, out):
    """out.position_offset: from answer to answer by no more than the torque's bounds twist the gears; without a wanted
    path it goes back to none within the time in which a torque fades."""
    for i in range(3):
        out.position_offset[i] = 0.0
        if settings.leads == 0 or settings.gears.stiffness[i] <= 0.0:
            continue
        most, pace = settings.peak / settings.gears.stiffness[i], settings.slope / settings.gears.stiffness[i]
        if not wanted:
            pace = most / settings.fade
        goal = min(max(state.ahead[i], -most), most) if wanted else 0.0
        step = pace * seconds
        state.offset[i] = min(max(goal, state.offset[i] - step), state.offset[i] + step)
        out.position_offset[i] = state.offset[i]


@kernel
def _stay(state):
    """Want what is there: of a motion that jumped, what it was before is as little known as where it leads."""
    for i in range(3):
        state.wanted[i] = state.torque[i]
        state.direction[i] = state.direction_before[i]


@kernel
def hold_kernel(settings, state, sample, out):
    """The answer to a repeated or late sample: that of before, for a stray one must not make the torque drop; once
    nothing else comes it fades."""
    out.target_sequence = sample.sequence
    state.held += 1
    flags = 0
    if state.held > coast_cycles(settings):
        state.source = _NONE
        flags = _fade(settings, state, settings.period, out)
        _lead(settings, state, settings.period, False, out)
    else:
        for i in range(3):
            out.torque[i] = state.torque[i]
            out.position_offset[i] = state.offset[i]
            state.climb[i] = 0.0
    for i in range(3):
        state.torque[i] = out.torque[i]
    out.source = state.source
    return flags


@kernel
def _choose(settings, state, sample, out):
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
                for i in range(3):
                    motion[order, i] = state.reference[order, i]
            return _REFERENCE, flags
        flags |= _COMMAND_JUMP
    if state.commanded.used > settled and state.commanded.idle <= coast:
        _take(state.commanded, motion)
        return _COMMAND, flags
    if state.measured.used > settled and state.measured.idle <= coast:
        _take(state.measured, motion)
        return _ESTIMATE, flags
    return _NONE, flags


@kernel
def _take(track, motion):
    for order in range(3):
        for i in range(3):
            motion[order, i] = track.state[i, order]


@kernel
def _is_near(settings, state, ahead):
    """Whether the joints could be where the plan wants them by then."""
    reach = REFERENCE_DISTANCE + settings.speed * settings.period * (ahead + state.measured.idle)
    near = True
    for i in range(3):
        near &= abs(state.reference[POSITION, i] - state.measured.seen[i]) <= reach
    return near


@kernel
def plan_kernel(steps):
    """Take the planned motion in `steps` (1,) if it is one; else the next answer says what is wrong with it."""
    settings, state, reference = steps[0].settings, steps[0].state, steps[0].reference
    flags = 0
    for i in range(3):
        position, velocity, acceleration = reference.position[i], reference.velocity[i], reference.acceleration[i]
        # written so that NaN fails
        if not (settings.range[0] <= position <= settings.range[1]):
            flags |= _COMMAND_RANGE
        if not (abs(velocity) <= settings.speed and abs(acceleration) <= COMMAND_ACCELERATION):
            flags |= _COMMAND_JUMP
    if flags == 0:
        state.reference_valid = 1
        state.reference_sequence = reference.sequence
        for i in range(3):
            state.reference[POSITION, i] = reference.position[i]
            state.reference[VELOCITY, i] = reference.velocity[i]
            state.reference[ACCELERATION, i] = reference.acceleration[i]
    state.reference_faults = flags


@part
def _for_motion(settings, state, sample, since, links, transition):
    """state.wanted (3,) N m: the torque for state.trajectory, `since` cycles after the last, with payload and friction
    of now; False where there is no pose for it. links: it is theirs, and state.ahead (3,) rad how far the motors are
    before them. transition: rad/s over which friction turns."""
    mass, branch, seconds = state.payload.usable, state.branch[ANSWERED], since * settings.period
    if links:
        placed = _place_links(settings, state, branch, mass)
    else:
        placed = place_kernel(settings, state, ANSWERED, seconds, mass) == REACHED
    if not placed:
        return False
    torque_kernel(settings, state, branch, sample.stamp_sec + sample.stamp_nanosec * 1e-9, mass, transition)
    finite = True
    for i in range(3):
        scale = 1.0 + state.payload.departure.sure[departure.place(i, departure.SCALE)]
        moved = state.full[i] + mass * load_kernel(settings, state, i)
        asked = state.wanted[i] = scale * moved + _learnt_friction(settings, state, i)
        if settings.readout.follows > 0.0 and since > 0:  # what acts is behind what is asked for by this
            state.wanted[i] += settings.readout.follows / seconds * (asked - branch.wanted[i])
        branch.wanted[i] = asked
        finite &= math.isfinite(state.wanted[i])
    return finite


@part
def _place_links(settings, state, branch, mass):
    """As `place_kernel`, where state.trajectory is that of the links. mass: kg carried. Returns whether there is a pose
    for it."""
    terms, motion = state.terms, state.trajectory
    release_kernel(branch.twist)  # behind commands of motors gears begin anew
    if settings.encoded != 0:
        encoder_kernel(settings.effect, settings.gear_ratio, motion)
    status = terms_kernel(settings.model, motion[POSITION], motion[VELOCITY], motion[ACCELERATION], state.pose, terms)
    if status != REACHED:
        return False
    _weigh_terms(settings, state)
    mass_kernel(settings.model, settings.rho[0], settings.forearm, mass, state.pose, state.mass)
    lead_kernel(
        settings.gears, branch.twist, state.mass, state.load, state.push, motion[ACCELERATION], mass, state.ahead
    )
    return True


@kernel
def _weigh_terms(settings, state):
    """state.load, N m, of the rigid robot, and state.push, N m/kg, of a payload."""
    for i in range(3):
        state.load[i] = grey_kernel(settings, state.terms, i) + settings.forearm * state.terms[FOREARM, i]
        state.push[i] = state.terms[PAYLOAD, i]


@kernel
def place_kernel(settings, state, number, elapsed, mass):
    """Rigid terms for state.trajectory, which becomes that of the true angles, with the gears of the branch `number`
    `elapsed` s on; 0: they start over. Filled: state.pose, terms, load, push. mass: kg carried. Returns a status."""
    branch = state.branch[number]
    terms, motion, place = state.terms, state.trajectory, state.trajectory
    if settings.encoded != 0:
        encoder_kernel(settings.effect, settings.gear_ratio, motion)
    if settings.geared != 0:
        place = branch.link
        twist = branch.twist
        for i in range(3):
            place[POSITION, i] = motion[POSITION, i] + twist.angle[0, i] + mass * twist.angle[1, i]
            place[VELOCITY, i] = motion[VELOCITY, i] + twist.speed[0, i] + mass * twist.speed[1, i]
            place[ACCELERATION, i] = motion[ACCELERATION, i]
    status = terms_kernel(settings.model, place[POSITION], place[VELOCITY], place[ACCELERATION], state.pose, terms)
    if status != REACHED:
        release_kernel(branch.twist)  # it may be the twist that leads out of the workspace
        return status
    _weigh_terms(settings, state)
    if settings.geared != 0:
        twist = branch.twist
        mass_kernel(settings.model, settings.rho[0], settings.forearm, mass, state.pose, state.mass)
        advance_kernel(settings.gears, twist, state.mass, state.load, state.push, motion[ACCELERATION], mass, elapsed)
        through_kernel(settings.gears, twist, 0, number == MEASURED, state.load)
        through_kernel(settings.gears, twist, 1, number == MEASURED, state.push)
    return status


@kernel
def torque_kernel(settings, state, branch, seconds, mass, transition):
    """After `place_kernel`: state.full (3,), reported torque, N m, of the fullest model without payload, and
    state.share (3,), of the payload's torque, what friction by the load adds. mass: kg, that this friction is for.
    transition: rad/s over which friction turns."""
    motion = state.trajectory
    for i in range(3):
        state.direction[i] = direction(motion[VELOCITY, i], transition)
        state.full[i] = state.load[i] + dry_and_viscous(settings, state, i)
        state.load[i] += mass * state.push[i]
        state.share[i] = branch.doubt[i] = 0.0
    ball_joint_kernel(settings.model, motion[VELOCITY], state.pose, state.balls)
    now = Instant(
        model=settings.model,
        gear_ratio=settings.gear_ratio,
        theta=motion[POSITION],
        theta_dot=motion[VELOCITY],
        theta_ddot=motion[ACCELERATION],
        direction=state.direction,
        load=state.load,
        seconds=max(0.0, seconds),
        pose=state.pose,
        doubt=branch.doubt,
    )
    effects_kernel(settings.effect, now, state.full)
    if settings.by_load != 0:
        _slope_by_load(settings, state, now, mass)
    if settings.remembers != 0:
        remembering_kernel(settings.effect, now, branch.memory, state.full)
        if settings.geared != 0:
            doubt_kernel(branch.twist, branch.doubt)
    for i in range(3):
        state.full[i] *= settings.scale[i]


@part
def _slope_by_load(settings, state, now, mass):
    """Fill state.share, and take from state.full what it makes of `mass`."""
    for i in range(3):
        now.load[i] += LOAD_STEP
    effects_kernel(settings.effect, now, state.share)
    for i in range(3):
        now.load[i] -= LOAD_STEP
        state.share[i] = -state.share[i]
    effects_kernel(settings.effect, now, state.share)
    for i in range(3):
        state.share[i] /= -LOAD_STEP
        state.full[i] -= mass * state.share[i] * state.push[i]


@kernel
def dry_and_viscous(settings, state, i):
    """Coulomb and viscous friction of joint i, N m, at state.trajectory and state.direction."""
    return friction_kernel(settings.viscous[i], settings.coulomb[i], state.trajectory[VELOCITY, i], state.direction[i])


@kernel
def _learnt_friction(settings, state, i):
    """Reported torque on joint i, N m, of what friction surely is beside the identified one."""
    sure, first = state.payload.departure.sure, departure.place(i, 0)
    dry, viscous, offset = sure[first], sure[first + 1], sure[first + 2]
    rubbed = dry * state.direction[i] + viscous * state.trajectory[VELOCITY, i]
    return settings.scale[i] * (rubbed + sure[departure.place(i, departure.BALLS)] * state.balls[i]) + offset


@kernel
def grey_kernel(settings, terms, i):
    """M_Id of joint i, N m."""
    return settings.rho[0, i] * terms[INERTIA, i] + settings.rho[1, i] * terms[GRAVITY, i] + terms[PLATFORM, i]


@kernel
def load_kernel(settings, state, i):
    """Reported torque on joint i per kg of payload, N m/kg, after `torque_kernel`."""
    return settings.scale[i] * (1.0 + state.share[i]) * state.push[i]


@kernel
def weight_kernel(settings, state, i):
    """The same of a payload that nothing accelerates."""
    pose, gravity, weight = state.pose, settings.model.gravity, 0.0
    for axis in range(3):
        weight -= pose.column[i, axis] * pose.lever[i] * gravity[axis]
    return settings.scale[i] * (1.0 + state.share[i]) * weight


@kernel
def _within_bounds(settings, state, seconds, out):
    """out.torque: what is wanted, at most the peak, and from answer to answer at most the slope, which grows by so much
    a cycle and may end at once, but for a reversal of Coulomb friction, which is a step by nature."""
    flags = 0
    growth = settings.growth * seconds / settings.period
    for i in range(3):
        dry = settings.coulomb[i] + state.payload.departure.sure[departure.place(i, 0)]
        turned = settings.scale[i] * dry * (state.direction[i] - state.direction_before[i])
        step = max(settings.slope * seconds, abs(turned))
        least, most = min(0.0, state.climb[i] - growth) * seconds, max(0.0, state.climb[i] + growth) * seconds
        low = max(-settings.peak, state.torque[i] + max(-step, least - abs(turned)))
        high = min(settings.peak, state.torque[i] + min(step, most + abs(turned)))
        torque = min(max(state.wanted[i], low), high)
        if torque != state.wanted[i]:
            flags = _LIMITED
        state.climb[i] = min(max(torque - state.torque[i] - turned, least), most) / seconds
        out.torque[i] = torque
        state.direction_before[i] = state.direction[i]
    state.faded = 0.0
    state.held = 0
    return flags


@kernel
def _fade(settings, state, seconds, out):
    """out.torque: in a straight line from the last usable one to zero within the declared time."""
    if state.faded == 0.0:
        for i in range(3):
            state.fade_from[i] = state.torque[i]
    state.faded += seconds
    left = max(0.0, 1.0 - state.faded / settings.fade)
    flags = 0
    for i in range(3):
        out.torque[i] = left * state.fade_from[i]
        state.climb[i] = (out.torque[i] - state.torque[i]) / seconds
        if out.torque[i] != 0.0:
            flags = _FADING
        state.direction_before[i] = 0.0
    return flags
