"""The loads, a mass and where the fourth axis turns its offset, by their normal equations."""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel
from service.estimator import departure
from service.estimator.payload.payload_state import FINEST, LOADS, OFFSET_STD, PRIOR_STD


@kernel
def prior_of(load):
    return PRIOR_STD**-2 if load == 0 else OFFSET_STD**-2


@kernel
def invert(information, active, inverse):
    """inverse (LOADS, LOADS) of a symmetric `information` of the first `active` loads, which are one or all."""
    if active == 1:
        inverse[0, 0] = 1.0 / information[0, 0]
        return
    a, b, c = information[0, 0], information[0, 1], information[0, 2]
    d, e, f = information[1, 1], information[1, 2], information[2, 2]
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * first + b * second + c * third
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = first / whole, (a * f - c * c) / whole, (a * d - b * b) / whole
    inverse[0, 1] = inverse[1, 0] = second / whole
    inverse[0, 2] = inverse[2, 0] = third / whole
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) / whole


@kernel
def pair(one, other):
    """Where a bin has what two loads share, `one` no later than `other`, not both the mass."""
    return other * (other + 1) // 2 + one - 1


@kernel
def swing_drag(state, index, load, at):
    """What friction's part `at` does to the moment of `load` in a bin that is full."""
    return state.swing_drag[index, load, at] * np.float64(state.swing_step[index, load])


@kernel
def bin_drag(state, index, at):
    """The same of the mass."""
    return swing_drag(state, index, 0, at) if state.turns != 0 else state.bin_drag[index, at]


@kernel
def weaken_drag(state, index, keep):
    """Leave a share of what friction does to the moment of the mass in a bin that is full."""
    if state.turns == 0:
        for a in range(departure.COUNT):
            state.bin_drag[index, a] *= keep
    else:
        state.swing_step[index, 0] *= keep


@kernel
def fill_swing(state, index):
    """Store what friction did in the bin that is full now, in steps of 1 / FINEST of a load's largest."""
    for load in range(LOADS):
        largest = 0.0
        for a in range(departure.COUNT):
            largest = max(largest, abs(state.filling_drag[load, a]))
        state.swing_step[index, load] = largest / FINEST
        step = np.float64(state.swing_step[index, load])
        for a in range(departure.COUNT):
            steps = state.filling_drag[load, a] / step if step > 0.0 else 0.0
            state.swing_drag[index, load, a] = round(max(-FINEST, min(FINEST, steps)))


@kernel
def corrected_moment(state, moment, drag):
    """A load's moment, what friction did to it taken off. drag: (COUNT,)."""
    left = moment
    for a in range(departure.COUNT):
        left -= drag[a] * state.departure.delta[a]
    return left


@kernel
def begin_whole(state):
    """From here on the whole of what tells the mass is what is known of it now."""
    state.whole_information, state.whole_moment = state.information[0, 0], state.moment[0]
    for a in range(departure.COUNT):
        state.whole_drag[a] = state.drag[0, a]


@kernel
def weigh_whole(state):
    """The mass, kg, by all that told it since the last change."""
    return corrected_moment(state, state.whole_moment, state.whole_drag) / state.whole_information


@kernel
def locate(state):
    """The mass, kg, which it returns, and state.offset, by the normal equations; their inverse is in state.inverse."""
    active, inverse, found = state.active, state.inverse, state.found
    invert(state.information, active, inverse)
    for p in range(active):
        state.pull[p] = corrected_moment(state, state.moment[p], state.drag[p])
    for p in range(active):
        found[p] = 0.0
        for q in range(active):
            found[p] += inverse[p, q] * state.pull[q]
    for p in range(1, active):
        state.offset[p - 1] = found[p]
    return found[0]
