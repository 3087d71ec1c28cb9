"""The feed-forward torque: for the motion that is wanted or there is, within its bounds, faded where there is none."""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel, part
from schemas.messages import SampleFlag
from service.estimator import departure
from service.estimator.branch import ANSWERED, MEASURED, wake_kernel
from service.estimator.kalman import ACCELERATION, POSITION, VELOCITY
from service.estimator.named_effects import effects_kernel, encoder_kernel, remembering_kernel
from service.estimator.stream import STATE_NEW, coast_cycles
from service.estimator.wanted import (
    COMMAND,
    ESTIMATE,
    NONE,
    REFERENCE,
    bound_kernel,
    choose_kernel,
    fade_kernel,
    stay_kernel,
    take_plan_kernel,
)
from service.model.coulomb_viscous import ball_joint_kernel, direction, friction_kernel
from service.model.dynamics import FOREARM, GRAVITY, INERTIA, PAYLOAD, PLATFORM, terms_kernel
from service.model.effects.base import Instant
from service.model.forward import mass_kernel
from service.model.gears import advance_kernel, doubt_kernel, lead_kernel, release_kernel, through_kernel
from service.model.kinematics import REACHED

_FRICTION_HELD = SampleFlag.FRICTION_HELD.value
LOAD_STEP = 1e-3  # N m of load, over which the slope of friction by it is taken


@part
def feedforward_kernel(settings, state, sample, passed, out):
    """Fill torque, source and target of `out` for `sample`, `passed` cycles after the last answer. Returns flags."""
    source, flags = choose_kernel(settings, state, sample, out)
    seconds = passed * settings.period
    branch, since = state.branch[ANSWERED], np.int64(0)
    if source == NONE:
        branch.idle += passed
    else:
        since = wake_kernel(branch, passed, coast_cycles(settings))
        if since == 0 and settings.remembers != 0:
            flags |= STATE_NEW
    links = source == REFERENCE and settings.leads != 0
    transition = settings.transition if source == ESTIMATE else settings.wanted_transition
    if source != NONE and _for_motion(settings, state, sample, since, links, transition):
        if (source == COMMAND and state.command_stray > 0) or (source == ESTIMATE and state.stray > 0):
            stay_kernel(state)
        _note_reversals(settings, state)
        flags |= bound_kernel(settings, state, seconds, out)
        if state.payload.departure.held != 0:
            flags |= _FRICTION_HELD
    else:
        source = NONE
        flags |= fade_kernel(settings, state, seconds, out)
    _lead(settings, state, seconds, links and source != NONE, out)
    for i in range(3):
        state.torque[i] = out.torque[i]
    out.source = state.source = source
    return flags


@kernel
def _note_reversals(settings, state):
    """state.turned (3,): step of the reported torque by reversals of Coulomb friction since the last answer, N m."""
    for i in range(3):
        dry = settings.coulomb[i] + state.payload.departure.sure[departure.place(i, 0)]
        state.turned[i] = settings.scale[i] * dry * (state.direction[i] - state.direction_before[i])
        state.direction_before[i] = state.direction[i]


@kernel
def plan_kernel(steps):
    """Take the planned motion in `steps` (1,) if it is one; else the next answer says what is wrong with it."""
    step = steps[0]
    take_plan_kernel(step.settings, step.state, step.reference)


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
def hold_kernel(settings, state, sample, out):
    """The answer to a repeated or late sample: that of before, for a stray one must not make the torque drop; once
    nothing else comes it fades."""
    out.target_sequence = sample.sequence
    state.held += 1
    flags = 0
    if state.held > coast_cycles(settings):
        state.source = NONE
        flags = fade_kernel(settings, state, settings.period, out)
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
