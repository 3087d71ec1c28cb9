"""Is the load another? A two-sample test: for every onset within the last window, is the mass since then another than
before? On a change the estimate starts anew from the samples since the onset, so it is at once as good as those samples
allow.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel
from service.estimator import departure
from service.estimator.payload.loads import bin_drag, corrected_moment, invert, pair, prior_of, swing_drag, weaken_drag
from service.estimator.payload.payload_state import LOADS, PRIOR_STD, SMALLEST_CHANGE, WINDOW

# Squared, normalised difference at which a change is believed: with some thousand onsets looked at a second, and model
# errors that are not white, 5 sigma would alarm every minute.
CHANGE_THRESHOLD = 45.0
SHORTEST = 3  # bins of motion since the onset
BIAS_SIGMAS = 3.0  # of a bias that a change stands out of: unlike noise it is not drawn anew for every onset
SMALLEST_OFFSET = 0.005  # kg m, change that counts as one
HIDDEN_SIGMAS = 5.0  # of noise beyond which a step that is not believed is a doubt of the mass


@kernel
def find_change(settings, state):
    """If the load is another since some bin than before, start its estimate anew from that bin.

    With I, b the information and moment since the onset (1) and before (0), the step b1/I1 - b0/I0 has the covariance
    1/I1 + 1/I0 of the noise, and what friction may do to the one and not to the other. Returns the bins since the
    onset, 0 where there is none.
    """
    active = state.active
    since, since_moment, since_drag = state.since_information, state.since_moment, state.since_drag
    before, before_moment = state.before_information, state.before_moment
    best, best_count = CHANGE_THRESHOLD, 0
    state.hidden = 0.0
    for p in range(active):
        since_moment[p] = 0.0
        state.pull[p] = corrected_moment(state, state.moment[p], state.drag[p])
        for q in range(active):
            since[p, q] = prior_of(p) if p == q and p > 0 else 0.0
        for a in range(departure.COUNT):
            since_drag[p, a] = 0.0
    index = state.head
    for n in range(state.filled):
        pulled = state.bin_moment[index]
        for a in range(departure.COUNT):
            dragged = bin_drag(state, index, a)
            since_drag[0, a] += dragged
            pulled -= dragged * state.departure.delta[a]
        since_moment[0] += pulled
        before_moment[0] = state.pull[0] - since_moment[0]
        since[0, 0] += state.bin_information[index]
        before[0, 0] = state.information[0, 0] - since[0, 0]
        if active > 1:
            _look_at_offsets(state, index)
        index = index - 1 if index > 0 else WINDOW - 1
        if n + 1 < SHORTEST or since[0, 0] <= 0.0 or before[0, 0] <= 0.0:
            continue
        if active == 1:  # without a division but for a candidate
            product = since[0, 0] * before[0, 0]
            scaled = since_moment[0] * before[0, 0] - before_moment[0] * since[0, 0]
            noise = product * (since[0, 0] + before[0, 0])
            square, likely = scaled * scaled, HIDDEN_SIGMAS * HIDDEN_SIGMAS * noise
            if square > likely:
                beyond = (square - likely) / (product * product) - BIAS_SIGMAS * BIAS_SIGMAS * state.bias
                state.hidden = max(state.hidden, min(beyond, PRIOR_STD * PRIOR_STD))
            if square <= best * noise:
                continue
        distance = _step_distance(state, best)
        if distance > best:
            best, best_count = distance, n + 1
    if best_count > 0:
        state.hidden = 0.0
        if state.behind != 0 and active == 1:
            _leave_old_load_out(settings, state, best_count)
        _start_anew(state, best_count)
    return best_count


@kernel
def _leave_old_load_out(settings, state, bins):
    """Of the newest `bins`, in which the load was another already, leave in only what they say of it: behind a low-pass
    of the report a share of each still is the load until then."""
    index = state.head
    for n in range(bins):
        gone = math.exp((n + 0.5 - bins) / settings.settling)
        here = 1.0 - gone
        state.bin_moment[index] = here * (state.bin_moment[index] - gone * state.mass * state.bin_information[index])
        state.bin_information[index] *= here * here
        weaken_drag(state, index, here)
        index = index - 1 if index > 0 else WINDOW - 1


@kernel
def _look_at_offsets(state, index):
    """Take what the bin says of the load's offset into the sums since an onset."""
    since, before = state.since_information, state.before_information
    _add_shared(state, index, since)
    for p in range(LOADS):
        for q in range(LOADS):
            if p > 0 or q > 0:
                before[p, q] = state.information[p, q] - since[p, q] + (prior_of(p) if p == q else 0.0)
    for p in range(1, LOADS):
        pulled = np.float64(state.swing_moment[index, p - 1])
        for a in range(departure.COUNT):
            dragged = swing_drag(state, index, p, a)
            state.since_drag[p, a] += dragged
            pulled -= dragged * state.departure.delta[a]
        state.since_moment[p] += pulled
        state.before_moment[p] = state.pull[p] - state.since_moment[p]


@kernel
def _add_shared(state, index, information):
    """Add what the bin says of the offset, and of it together with the mass."""
    for q in range(1, LOADS):
        for p in range(q + 1):
            information[p, q] += np.float64(state.swing_information[index, pair(p, q)])
            information[q, p] = information[p, q]


@kernel
def _step_distance(state, least):
    """Squared distance of the loads since an onset from those before it, over its covariance; 0 where it is below
    `least` or too small to be a load."""
    active, contrast, step, spread = state.active, state.contrast, state.step, state.spread
    after, until = state.inverse, state.inverse_before
    invert(state.since_information, active, after)
    invert(state.before_information, active, until)
    for p in range(active):
        step[p] = 0.0
        for q in range(active):
            step[p] += after[p, q] * state.since_moment[q] - until[p, q] * state.before_moment[q]
            spread[p, q] = after[p, q] + until[p, q]
    small = abs(step[0]) < SMALLEST_CHANGE
    if active > 1:
        small &= math.hypot(step[1], step[2]) < SMALLEST_OFFSET
    if small or _squared(state, step, spread) <= least:
        return 0.0
    for p in range(active):
        for a in range(departure.COUNT):
            contrast[p, a] = 0.0
            for q in range(active):
                drag = state.since_drag[q, a]
                contrast[p, a] += after[p, q] * drag - until[p, q] * (state.drag[q, a] - drag)
    for p in range(active):
        for q in range(p + 1):
            spread[p, q] += departure.covariance_kernel(state.departure, contrast[p], contrast[q])
            spread[q, p] = spread[p, q]
    spread[0, 0] += 2.0 * state.bias * BIAS_SIGMAS * BIAS_SIGMAS / CHANGE_THRESHOLD  # another one in either
    return _squared(state, step, spread)


@kernel
def _squared(state, step, spread):
    """step' inverse(spread) step."""
    active, inverse = state.active, state.inverse_spread
    invert(spread, active, inverse)
    total = 0.0
    for p in range(active):
        for q in range(active):
            total += step[p] * inverse[p, q] * step[q]
    return total


@kernel
def _start_anew(state, bins):
    """Take only the newest `bins` into the estimate."""
    active = state.active
    state.told = 0.0
    for p in range(active):
        state.moment[p] = 0.0
        for q in range(active):
            state.information[p, q] = prior_of(p) if p == q and p > 0 else 0.0
        for a in range(departure.COUNT):
            state.drag[p, a] = 0.0
    index = state.head
    for _ in range(bins):
        state.told += state.bin_told[index]
        state.moment[0] += state.bin_moment[index]
        state.information[0, 0] += state.bin_information[index]
        for a in range(departure.COUNT):
            state.drag[0, a] += bin_drag(state, index, a)
        if active > 1:
            _add_shared(state, index, state.information)
            for p in range(1, LOADS):
                state.moment[p] += np.float64(state.swing_moment[index, p - 1])
                for a in range(departure.COUNT):
                    state.drag[p, a] += swing_drag(state, index, p, a)
        index = index - 1 if index > 0 else WINDOW - 1
    state.filled = bins
    state.raw_information = state.information[0, 0] * state.inflation
