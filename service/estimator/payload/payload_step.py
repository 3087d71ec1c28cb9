"""One sample into the payload estimate."""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel, part
from schemas.messages import Gripper
from service.estimator import departure, slow
from service.estimator.payload.change import find_change
from service.estimator.payload.loads import begin_whole, corrected_moment, fill_swing, pair, prior_of, weaken_drag
from service.estimator.payload.payload_state import (
    LEAST_TIME,
    LOADS,
    MEMORY_TIME,
    PRIOR_STD,
    STILL_TIME,
    TELLING_TIME,
    WINDOW,
)
from service.estimator.payload.rest import jolt_kernel, moved_kernel, rest_kernel
from service.estimator.payload.scatter import part_blocks, scatter_kernel
from service.estimator.payload.verdict import CONTRADICTION, CONTRADICTION_FLOOR, conclude, is_sure, lacks_a_load

UNKNOWN = Gripper.UNKNOWN.value
# What the model lacks is this many times the variance of the noise in what is remembered, where it forbids trust.
MEMORY_WORTH = 4.0
OFFSET_MEMORY = 5.0  # memory times after which nothing is left of what a turn said


@kernel
def payload_kernel(settings, state):
    """Take the sample in state.column, residual, weight, shape. Filled: mass, std_dev, trusted. Returns an event."""
    column, weight, head = state.column, state.weight, state.head
    state.changed = 0
    if state.gripper != state.gripper_before:
        _grip(state)
    for i in range(3):
        weight[i] *= settings.information_weight
    _note_turning(settings, state)
    scatter_kernel(settings, state)
    raw = 0.0
    for i in range(3):
        raw += weight[i] * column[i, 0] * column[i, 0]
        weight[i] /= state.inflation if state.creeps[i] == 0 else max(state.inflation, state.breakaway)
    _gather_information(settings, state)
    for p in range(state.active):
        _gather_moment(settings, state, p)
    state.raw_information = prior_of(0) + (state.raw_information - prior_of(0)) * settings.forgetting + raw
    _gather_whole(settings, state)
    told = raw > 0.0
    state.told *= settings.forgetting
    if told:
        state.told += 1.0
        state.bin_told[head] += 1.0
        slow.fast_kernel(state.slow)
    elif state.active == 1:
        told = _weigh_slowly(settings, state)
    _note_rest(settings, state, told)
    _weigh_at_rest(settings, state, raw > 0.0)
    state.in_bin += 1
    if state.in_bin >= settings.bin_size:
        state.in_bin = 0
        if state.active > 1 or state.bin_told[head] > 0.0:  # a doubt that rest does not settle is not to run out in it
            _close_bin(settings, state)
    return conclude(settings, state)


@kernel
def _gather_information(settings, state):
    """What the sample says of the loads, into all that is remembered and into the bin."""
    column, weight = state.column, state.weight
    for p in range(state.active):
        for q in range(state.active):
            own = prior_of(p) if p == q else 0.0
            gained = 0.0
            for i in range(3):
                gained += weight[i] * column[i, p] * column[i, q]
            state.information[p, q] = own + (state.information[p, q] - own) * settings.forgetting + gained
            if q == 0 and p == 0:
                state.bin_information[state.head] += gained
            elif p <= q:
                state.swing_information[state.head, pair(p, q)] += gained


@kernel
def _gather_moment(settings, state, load):
    """The same of the moment of `load`, and of what friction does to it."""
    head, gained = state.head, 0.0
    for a in range(departure.COUNT):
        state.drag[load, a] *= settings.forgetting
    for i in range(3):
        pull = state.weight[i] * state.column[i, load]
        gained += pull * state.residual[i]
        for a in range(departure.PARTS):
            at, dragged = departure.place(i, a), pull * state.shape[i, a]
            state.drag[load, at] += dragged
            if load == 0 and state.turns == 0:
                state.bin_drag[head, at] += dragged
            else:
                state.filling_drag[load, at] += dragged
    state.moment[load] = state.moment[load] * settings.forgetting + gained
    if load == 0:
        state.bin_moment[head] += gained
    else:
        state.swing_moment[head, load - 1] += gained


@kernel
def _gather_whole(settings, state):
    """The sample into the whole of what tells the mass."""
    gained = pull = 0.0
    for a in range(departure.COUNT):
        state.whole_drag[a] *= settings.forgetting
    for i in range(3):
        push = state.weight[i] * state.column[i, 0]
        gained += push * state.column[i, 0]
        pull += push * state.residual[i]
        for a in range(departure.PARTS):
            state.whole_drag[departure.place(i, a)] += push * state.shape[i, a]
    state.whole_moment = state.whole_moment * settings.forgetting + pull
    prior = prior_of(0)
    state.whole_information = prior + (state.whole_information - prior) * settings.forgetting + gained


@part
def _close_bin(settings, state):
    """Look whether the load has changed, and begin the next bin."""
    if state.turns != 0 or state.active > 1:
        fill_swing(state, state.head)
    _forget_beyond_bias(state)
    onset = find_change(settings, state)
    head = state.head = (state.head + 1) % WINDOW
    state.filled = min(WINDOW, state.filled + 1)
    _empty_bin(state, head)
    if onset > 0:
        begin_whole(state)
        samples = state.changed = onset * settings.bin_size
        state.untold = max(0.0, LEAST_TIME - samples * settings.period)
        if state.active > 1 or state.behind != 0:
            part_blocks(settings, state, samples)


@kernel
def _empty_bin(state, index):
    state.bin_information[index] = 0.0
    state.bin_moment[index] = 0.0
    state.bin_told[index] = 0.0
    if state.turns == 0:
        state.bin_drag[index] = 0.0
    if state.turns != 0 or state.active > 1:
        state.swing_information[index] = 0.0
        state.swing_moment[index] = 0.0
        state.swing_drag[index] = 0
        state.swing_step[index] = 0.0
        state.filling_drag[:] = 0.0


@kernel
def _forget_beyond_bias(state):
    """Noise averages out, what the model lacks does not: where that alone forbids trust, older samples add nothing, and
    keep a change that may hide in it from showing."""
    if state.active > 1 or is_sure(math.sqrt(state.bias), state.mass):
        return
    keep = MEMORY_WORTH / (state.bias * state.information[0, 0])
    if keep >= 1.0:
        return
    prior = prior_of(0)
    state.information[0, 0] = prior + (state.information[0, 0] - prior) * keep
    state.raw_information = prior + (state.raw_information - prior) * keep
    state.moment[0] *= keep
    state.told *= keep
    for a in range(departure.COUNT):
        state.drag[0, a] *= keep
    index = state.head
    for _ in range(state.filled):
        state.bin_information[index] *= keep
        state.bin_moment[index] *= keep
        state.bin_told[index] *= keep
        weaken_drag(state, index, keep)
        index = index - 1 if index > 0 else WINDOW - 1


@kernel
def _note_rest(settings, state, told):
    """Count time without motion that tells the mass, and behind a rest the motion that has told it."""
    if told:
        state.untold = max(0.0, state.untold - settings.period)
        if state.untold == 0.0:
            state.unheard = 0
    if told or state.gripper != UNKNOWN:
        state.still = 0.0
        return
    state.still += settings.period
    if state.still > STILL_TIME:
        if state.still - settings.period <= STILL_TIME and state.active == 1 and lacks_a_load(settings, state):
            loosen_kernel(state, PRIOR_STD * PRIOR_STD)
        state.untold = TELLING_TIME


@kernel
def _weigh_at_rest(settings, state, fast):
    """Where nothing moves and nobody hears of the gripper: what was known of the mass is known of another, by the step
    of the torque, unless no gripper could make it (a brake that closes). fast: whether something moves so."""
    rest, slowly = state.rest, False
    rest.step = 0.0
    for i in range(3):
        slowly |= state.slow.now.weight[i] > 0.0
    if fast or state.gripper != UNKNOWN or state.active > 1 or (state.resting == 0 and not slowly):
        moved_kernel(rest)
        return
    if state.resting == 0:
        state.crept += settings.period if state.unheard != 0 else 0.0
        jolt_kernel(settings, rest)
        return
    stepped = rest_kernel(settings, rest, state.column, state.residual)
    if state.unheard == 0 and rest.stood > STILL_TIME:
        state.unheard, state.crept = 1, 0.0
        slow.grip_kernel(state.slow, PRIOR_STD * PRIOR_STD)
    if not stepped:
        return
    mass, variance = state.mass + rest.step, rest.variance + state.std_dev * state.std_dev
    margin = CONTRADICTION * math.sqrt(variance) + CONTRADICTION_FLOOR
    if mass < -margin or mass > settings.max_payload + margin:
        rest.step = 0.0
        return
    state.moment[0] += state.information[0, 0] * mass - corrected_moment(state, state.moment[0], state.drag[0])
    loosen_kernel(state, rest.variance)
    state.still = 0.0
    state.untold = LEAST_TIME


@kernel
def loosen_kernel(state, variance):
    """The mass is another by nobody knows what of `variance`, kg^2."""
    known = state.information[0, 0]
    left = max(prior_of(0), known / (1.0 + known * variance))
    state.moment[0] *= left / known
    for a in range(departure.COUNT):
        state.drag[0, a] *= left / known
    state.information[0, 0] = left
    state.raw_information = left * state.inflation
    state.told = 0.0
    begin_whole(state)
    _forget_bins(state)
    slow.grip_kernel(state.slow, PRIOR_STD * PRIOR_STD)


@part
def _weigh_slowly(settings, state):
    """Where nothing moves fast: take what gravity says for all that is known of the mass. Returns whether it says
    anything."""
    now = state.slow.now
    for i in range(3):
        now.drift[i], now.way[i] = settings.prior[departure.place(i, 0)], state.shape[i, 0]
        now.residual[i] = state.residual[i]
        for a in range(departure.PARTS):
            now.residual[i] -= state.shape[i, a] * state.departure.delta[departure.place(i, a)]
        now.weight[i] *= settings.information_weight
    now.mass, now.variance = state.mass, PRIOR_STD * PRIOR_STD if state.unheard != 0 else state.std_dev * state.std_dev
    told = slow.slow_kernel(state.slow, settings.period, PRIOR_STD * PRIOR_STD)
    if told:
        state.information[0, 0] = 1.0 / state.slow.variance
        state.moment[0] = state.slow.mass / state.slow.variance
        state.raw_information = state.information[0, 0] * state.inflation
        state.told = 0.0
        for a in range(departure.COUNT):
            state.drag[0, a] = 0.0
        begin_whole(state)
        _forget_bins(state)
    return told


@kernel
def _grip(state):
    """The gripper opened or closed: what hangs on it is another from here on."""
    if state.gripper_before != UNKNOWN and state.gripper != UNKNOWN:
        weigh_anew_kernel(state)
    state.gripper_before = state.gripper


@kernel
def weigh_anew_kernel(state):
    """Nothing is known of what hangs there."""
    _forget_bins(state)
    state.information[:] = 0.0
    for p in range(LOADS):
        state.information[p, p] = prior_of(p)
        state.moment[p] = 0.0
        state.drag[p] = 0.0
    state.raw_information = prior_of(0)
    state.told = 0.0
    begin_whole(state)
    state.untold = LEAST_TIME
    slow.grip_kernel(state.slow, PRIOR_STD * PRIOR_STD)


@kernel
def _forget_bins(state):
    """What was told before is of no use to find a change by."""
    _empty_bin(state, state.head)
    state.in_bin, state.filled, state.hidden = 0, 1, 0.0


@kernel
def unseen_kernel(state):
    """Nobody saw what the gripper did."""
    weigh_anew_kernel(state)
    state.mass, state.trusted, state.usable = 0.0, 0, 0.0
    state.std_dev, state.random_std_dev, state.common_std_dev = PRIOR_STD, PRIOR_STD, 0.0


@kernel
def _note_turning(settings, state):
    """Look for the load's offset while the fourth axis turns, and for as long after as is remembered of it."""
    turns = False
    for i in range(3):
        for p in range(1, LOADS):
            turns |= state.column[i, p] != 0.0
    if turns:
        state.turning = np.int64(OFFSET_MEMORY * MEMORY_TIME / settings.period)
        state.active = LOADS
    elif state.active > 1:
        state.turning -= 1
        if state.turning <= 0:
            state.active = 1
            for p in range(1, LOADS):
                state.moment[p] = state.offset[p - 1] = 0.0
                for q in range(LOADS):
                    state.information[p, q] = state.information[q, p] = prior_of(p) if p == q else 0.0
                for a in range(departure.COUNT):
                    state.drag[p, a] = 0.0
