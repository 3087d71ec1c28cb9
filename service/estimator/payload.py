"""Payload mass: scalar least squares in information form, with what is not known of friction, and a change detector.

The three torque residuals of a sample are r_i = m_p phi_i + x_i delta_i + noise, phi = J'(p_ddot + g) in N m/kg: the
paper's three Cartesian rows y = m_p X, brought to the joints, where the noise lives, so that each joint weighs by its
own noise. delta is friction's departure from the identified one (`friction`): its estimate is taken off, its covariance
counts in the mass's (a consider state, Schmidt 1966).

How far the noise may be believed is read off the residuals at right angles to phi, which no payload can cause: in the
mean over stretches of a move they show what the model lacks, and the mass is as much less certain.

Change detection is a two-sample test: for every onset within the last window, is the mass since then another than
before? On a change the estimate starts anew from the samples since the onset, so it is at once as good as those samples
allow. Nothing is trusted before it is excited, nor while it contradicts what a gripper can do.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from schemas.messages import Gripper, PayloadEvent
from service.estimator import friction, slow

BIN_TIME = 0.002  # s, resolution of an onset
WINDOW = 150  # bins, how far back an onset is looked for
MEMORY_TIME = 3.0  # s, forgetting: longer than a carry, shorter than the drift of friction with temperature
# An unloaded gripper is the prior, within this; also the bound of the covariance when nothing excites.
PRIOR_STD = 2.0  # kg
# Smallest change that counts as a pick or release: friction and inertia errors imitate less than this.
SMALLEST_CHANGE = 0.12  # kg
# So soon after an event a smaller part of the load than this is the estimate settling, not the next event.
REFINING_TIME, REFINING_SHARE = 0.15, 0.5  # s, -
GRIPPER_TIME = 0.03  # s, no gripper lets go again sooner
EVENT_SIGMAS = 3.0  # standard deviations of now and then that a change of load stands out of
# A pick or release is reported once its step stands out of one standard deviation this many times, which for a heavy
# load is well before its mass is trusted.
CLEAR_STEP = 10.0
# Squared, normalised difference at which a change is believed: with some thousand onsets looked at a second, and model
# errors that are not white, 5 sigma would alarm every minute.
CHANGE_THRESHOLD = 45.0
SHORTEST = 3  # bins of motion since the onset
# The rigid-body terms are known to about this share of themselves after identification.
MODEL_SHARE = 0.01
# Torque noise and small errors are alike for about this long, so a sample is worth period / this time; what a model
# with unmodelled effects leaves over lasts as long as a stretch of a move.
CORRELATION_TIME, MODEL_ERROR_TIME = 0.003, 0.015  # s
# Residuals are averaged over blocks of this length; what then stands out of the noise lasts longer by this factor.
BLOCK_TIME, COLOUR = 0.02, 3.0  # s, -
# Blocks with motion over which their scatter is averaged, and the newest few that may already speak for more of it.
BLOCKS, NEWEST, NEWEST_SHARE = 16, 4, 0.6
# Noise that is white from sample to sample averages better than CORRELATION_TIME says, down to this.
LEAST_INFLATION = 0.4
# What the model lacks is this many times the noise: what it says of the mass is not to be used.
FOREIGN = 12.0
# What the model lacks over some seconds of motion comes again with every move: this share of it, brought to the
# platform, does not average out of the mass.
BIAS_SHARE, BIAS_TIME = 0.5, 3.0  # -, s
BIAS_SIGMAS = 3.0  # of it that a change stands out of: unlike noise it is not drawn anew for every onset
OUTLYING = 0.3  # of the scatter of a single block, which noise alone makes three times its mean now and then
# Torque constants hold to some 5 %, two of these, and without a known load nothing shows by how much a mass is off.
TORQUE_SHARE = 0.025
# Trusted when one standard deviation is below share * mass + floor.
TRUST_SHARE, TRUST_FLOOR = 0.1, 0.025  # -, kg
# A mass below nothing, or of nothing, shows a bias that other masses have too; it is remembered for this long.
SHORTFALL_TIME = 30.0  # s
# It counts where a mass is this sure, and shows for this long, by more than this: a release is not seen at once.
SHORTFALL_STD, SETTLING_TIME, SHORTFALL_FLOOR = 0.1, 0.3, 0.02  # kg, s, kg
# Beyond this many standard deviations and this much below nothing, or above the greatest payload, a mass is none.
CONTRADICTION, CONTRADICTION_FLOOR = 2.0, 0.05  # -, kg
# A gripper makes this many events a second at most; a burst of so many more is no gripper.
EVENT_RATE, EVENT_BURST = 5.0, 3.0  # 1/s, -

UNKNOWN, OPEN = Gripper.UNKNOWN.value, Gripper.OPEN.value
EMPTY_SIGMAS = 5.0  # by which a mass contradicts an open gripper
WEIGHT, RESIDUAL, COLUMN = range(3)  # of a joint's sums over a block
ONSET_DOUBT = 3  # bins by which an onset is found too late
PENDING = 5  # newest blocks that a change not yet found may lie in
LOADS = 3  # m and, where the fourth axis turns, the m d_1 and m d_2 of `turning`
OFFSET_MEMORY = 5.0  # memory times after which nothing is left of what a turn said
# One standard deviation of m d: 4 kg at 50 mm.
OFFSET_STD = 0.2  # kg m
SMALLEST_OFFSET = 0.005  # kg m, change that counts as one

STATE = np.dtype(
    [
        ("information", "f8", (LOADS, LOADS)),
        ("moment", "f8", LOADS),
        ("drag", "f8", (LOADS, friction.COUNT)),  # sum of weight column x: what delta adds to the moment
        ("bin_information", "f8", (WINDOW, LOADS, LOADS)),
        ("bin_moment", "f8", (WINDOW, LOADS)),
        ("bin_drag", "f8", (WINDOW, LOADS, friction.COUNT)),
        ("active", "i8"),  # loads to be found: the mass alone, or all where the fourth axis turns
        ("turning", "i8"),  # samples for which they still are
        ("offset", "f8", 2),  # kg m, of the load from the fourth axis
        ("head", "i8"),  # bin that is being filled
        ("in_bin", "i8"),  # samples in it
        ("filled", "i8"),  # bins since the last change, at most WINDOW
        ("load", "f8"),  # kg, mass at the last event, then whenever it is trusted
        ("load_std", "f8"),  # kg, its standard deviation then
        ("load_before", "f8"),  # kg, the same before the last event
        ("last_event", "i8"),
        ("quiet", "i8"),  # samples since then
        ("burst", "f8"),  # events of late, leaking
        ("blocks", "f8", BLOCKS),  # squared residuals at right angles to phi over what the noise explains, a ring
        ("block", "i8"),  # the next to be written
        ("inflation", "f8"),  # of the variance of the noise, of now
        ("raw_information", "f8"),  # information without inflation
        ("excess", "f8"),  # of the blocks' scatter over the noise, over BIAS_TIME
        ("leverage", "f8"),  # kg^-2, what a block says of the mass, over the same
        ("judged", "f8"),  # share of BIAS_TIME that the two have been averaged over so far
        ("bias", "f8"),  # kg^2, variance of what the model's error does to a mass for good
        ("wrong_for", "f8"),  # s
        ("shortfall", "f8"),  # kg, how far below nothing masses have been of late, or off it where nothing hung
        ("in_block", "i8"),
        ("clock", "i8"),  # samples taken
        ("ended", "i8", BLOCKS),  # when each block did
        ("fresh", "i8"),  # blocks since the last change, as far as they are kept
        ("sums", "f8", (BLOCKS, 3, COLUMN + LOADS)),  # of each block, a joint: weight, residual and loads times weight
        ("friction", friction.STATE),
        ("slow", slow.STATE),
        # scratch: sums since an onset and before it, of all loads and of the mass alone
        ("since_information", "f8", (LOADS, LOADS)),
        ("since_moment", "f8", LOADS),
        ("since_drag", "f8", (LOADS, friction.COUNT)),
        ("before_information", "f8", (LOADS, LOADS)),
        ("before_moment", "f8", LOADS),
        ("pull", "f8", LOADS),
        ("found", "f8", LOADS),
        ("step", "f8", LOADS),
        ("inverse", "f8", (LOADS, LOADS)),
        ("inverse_before", "f8", (LOADS, LOADS)),
        ("inverse_spread", "f8", (LOADS, LOADS)),
        ("spread", "f8", (LOADS, LOADS)),
        ("contrast", "f8", (LOADS, friction.COUNT)),
        ("known", "f8", 3),  # of this sample, N m: of the load's offset
        ("shape", "f8", (3, friction.PARTS)),  # of this sample: direction, speed, 1
        ("column", "f8", (3, LOADS)),  # of this sample: what each load does, phi N m/kg and swing N m/(kg m)
        ("residual", "f8", 3),  # of this sample, N m, measured minus predicted without payload
        ("weight", "f8", 3),  # of this sample, (N m)^-2, 0 where a joint has nothing to say
        ("slow_weight", "f8", 3),  # the same of a joint too slow for Coulomb's law
        ("remains", "f8", 3),  # of the residual, learnt friction taken off
        ("gripper", "i8"),  # of this sample, schemas.messages.Gripper
        ("gripper_before", "i8"),
        ("mass", "f8"),  # kg
        ("std_dev", "f8"),  # kg
        ("trusted", "i8"),
    ],
    align=True,
)

SETTINGS = np.dtype(
    [
        ("forgetting", "f8"),
        ("friction_forgetting", "f8"),
        ("prior", "f8", friction.COUNT),
        ("bin_size", "i8"),  # samples
        ("block_size", "i8"),
        ("remember", "f8"),  # per sample, of the shortfall
        ("model_error", "f8"),  # squared, over the noise of a block
        ("worth", "f8"),  # share of a sample that is new information
        ("period", "f8"),  # s
        ("max_payload", "f8"),  # kg
    ],
    align=True,
)


def sample_variance(noise: np.ndarray, model_error: np.ndarray) -> np.ndarray:
    """Variance (3,) (N m)^2 to weigh a torque sample with, from rms (3,) N m of white noise and of what the model left.

    A model error well below the noise is told from the noise's own colour by nothing, so it counts for less.
    """
    square = np.square(model_error)
    shown = square / np.maximum(square + np.square(noise), 1e-12)
    return np.square(noise) + shown * square * MODEL_ERROR_TIME / CORRELATION_TIME


def settings(
    period: float, prior: np.ndarray, max_payload: float, model_error: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """One SETTINGS record. period: s. prior: (9,) of friction. max_payload: kg. model_error: (3,) N m rms that the
    model left where it was identified. variance: (3,) (N m)^2, as `sample_variance`."""
    record = np.zeros((), SETTINGS)
    for name, time in (("bin_size", BIN_TIME), ("block_size", BLOCK_TIME)):
        record[name] = max(1, round(time / period))
    record["forgetting"] = np.exp(-period / MEMORY_TIME)
    record["remember"] = np.exp(-period / SHORTFALL_TIME)
    record["friction_forgetting"] = np.exp(-record["block_size"] * period / friction.MEMORY_TIME)
    record["worth"] = min(1.0, period / CORRELATION_TIME)
    record["model_error"] = record["block_size"] * record["worth"] * np.mean(np.square(model_error) / variance)
    record["prior"], record["period"], record["max_payload"] = prior, period, max_payload
    return record


def start(state: np.ndarray, prior: np.ndarray) -> None:
    """An empty gripper, nothing known; prior: (9,) of friction."""
    state[:] = np.zeros((), STATE)
    state["information"][..., range(LOADS), range(LOADS)] = [PRIOR_STD**-2, OFFSET_STD**-2, OFFSET_STD**-2]
    state["active"] = state["filled"] = 1
    state["blocks"] = state["inflation"] = 1.0
    state["raw_information"] = PRIOR_STD**-2
    state["std_dev"] = PRIOR_STD
    friction.start(state["friction"], prior)


@njit(cache=True)
def payload_kernel(settings, state):
    """Take the sample in state.column, residual, weight, shape. Filled: mass, std_dev, trusted. Returns an event."""
    column, residual, weight, shape, head = state.column, state.residual, state.weight, state.shape, state.head
    if state.gripper != state.gripper_before:
        _grip(state)
    for i in range(3):
        weight[i] *= settings.worth
    _note_turning(settings, state)
    _scatter(settings, state)
    raw = 0.0
    for i in range(3):
        raw += weight[i] * column[i, 0] * column[i, 0]
        weight[i] /= state.inflation
    for p in range(state.active):
        prior = _prior(p)
        for q in range(state.active):
            own = prior if p == q else 0.0
            gained = 0.0
            for i in range(3):
                gained += weight[i] * column[i, p] * column[i, q]
            state.information[p, q] = own + (state.information[p, q] - own) * settings.forgetting + gained
            state.bin_information[head, p, q] += gained
        gained = 0.0
        for i in range(3):
            pull = weight[i] * column[i, p]
            gained += pull * residual[i]
            for a in range(friction.PARTS):
                at = friction.PARTS * i + a
                state.drag[p, at] = state.drag[p, at] * settings.forgetting + pull * shape[i, a]
                state.bin_drag[head, p, at] += pull * shape[i, a]
        state.moment[p] = state.moment[p] * settings.forgetting + gained
        state.bin_moment[head, p] += gained
    state.raw_information = _prior(0) + (state.raw_information - _prior(0)) * settings.forgetting + raw
    if raw > 0.0:
        slow.fast_kernel(state.slow)
    elif state.active == 1:
        _weigh_slowly(settings, state)
    state.in_bin += 1
    if state.in_bin >= settings.bin_size:
        state.in_bin = 0
        onset = _find_change(state)
        head = state.head = (head + 1) % WINDOW
        state.filled = min(WINDOW, state.filled + 1)
        for p in range(LOADS):
            state.bin_moment[head, p] = 0.0
            for q in range(LOADS):
                state.bin_information[head, p, q] = 0.0
            for a in range(friction.COUNT):
                state.bin_drag[head, p, a] = 0.0
        if onset > 0 and state.active > 1:
            _part_blocks(settings, state, onset * settings.bin_size)
    return _conclude(settings, state)


@njit(cache=True)
def _weigh_slowly(settings, state):
    """Where nothing moves fast: take what gravity says for all that is known of the mass."""
    for i in range(3):
        first = friction.PARTS * i
        state.known[i] = settings.prior[first]
        state.remains[i] = state.residual[i]
        for a in range(friction.PARTS):
            state.remains[i] -= state.shape[i, a] * state.friction.delta[first + a]
        state.slow_weight[i] *= settings.worth
    told = slow.slow_kernel(
        state.slow, state.column, state.remains, state.shape[:, 0], state.slow_weight, settings.period, state.known,
        state.mass, state.std_dev * state.std_dev, PRIOR_STD * PRIOR_STD,
    )  # fmt: skip
    if told:
        state.information[0, 0] = 1.0 / state.slow.variance
        state.moment[0] = state.slow.mass / state.slow.variance
        state.raw_information = state.information[0, 0] * state.inflation
        for a in range(friction.COUNT):
            state.drag[0, a] = 0.0


@njit(cache=True)
def _grip(state):
    """The gripper opened or closed: what hangs on it is another from here on."""
    if state.gripper_before != UNKNOWN and state.gripper != UNKNOWN:
        for n in range(WINDOW):
            state.bin_information[n] = 0.0
            state.bin_moment[n] = 0.0
            state.bin_drag[n] = 0.0
        state.in_bin = 0
        state.filled = 1
        state.information[:] = 0.0
        for p in range(LOADS):
            state.information[p, p] = _prior(p)
            state.moment[p] = 0.0
            state.drag[p] = 0.0
        state.raw_information = _prior(0)
        slow.grip_kernel(state.slow, PRIOR_STD * PRIOR_STD)
    state.gripper_before = state.gripper


@njit(cache=True)
def _prior(load):
    return PRIOR_STD**-2 if load == 0 else OFFSET_STD**-2


@njit(cache=True)
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
                    state.information[p, q] = state.information[q, p] = _prior(p) if p == q else 0.0
                for a in range(friction.COUNT):
                    state.drag[p, a] = 0.0


@njit(cache=True)
def _invert(information, active, inverse):
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


@njit(cache=True)
def _scatter(settings, state):
    """Average of what the residuals of a block show at right angles to phi, friction and offset taken off, over their
    noise."""
    delta, sums = state.friction.delta, state.sums[state.block]
    for i in range(3):
        state.known[i] = state.column[i, 1] * state.offset[0] + state.column[i, 2] * state.offset[1]
        rubbed = 0.0
        for a in range(friction.PARTS):
            rubbed += state.shape[i, a] * delta[friction.PARTS * i + a]
        weight = state.weight[i]
        sums[i, WEIGHT] += weight
        sums[i, RESIDUAL] += weight * (state.residual[i] - rubbed)
        for p in range(LOADS):
            sums[i, COLUMN + p] += weight * state.column[i, p]
    friction.gather_kernel(state.friction, state.column, state.residual, state.known, state.weight, state.shape)
    state.in_block += 1
    state.clock += 1
    if state.in_block < settings.block_size:
        return
    state.in_block = 0
    own, leverage = _misfit(sums, state.offset)
    if own >= 0.0:
        oldest = (state.block + 1) % BLOCKS
        share = settings.block_size * settings.period / BIAS_TIME
        state.excess += share * (max(0.0, state.blocks[oldest] - 1.0) - state.excess)
        state.leverage += share * (leverage - state.leverage)
        state.judged += share * (1.0 - state.judged)
        state.blocks[state.block], state.ended[state.block] = own, state.clock
        if state.active > 1:
            _look_again(state)
            state.fresh = min(BLOCKS - 2, state.fresh + 1)
        _inflate(state)
        # friction is not to learn from what it cannot be: the block itself has a say
        doubtful = max(state.inflation, _inflation(OUTLYING * own))
        friction.learn_kernel(state.friction, settings.prior, settings.friction_forgetting, doubtful)
        state.block = oldest
    state.sums[state.block] = 0.0


@njit(cache=True)
def _misfit(sums, offset):
    """What a block's mean residuals show at right angles to phi, a degree of freedom, over their noise; -1: nothing is
    known. And what the block says of the mass, kg^-2."""
    along = leverage = total = 0.0
    moving = 0
    for i in range(3):
        weight = sums[i, WEIGHT]
        if weight > 0.0:
            moving += 1
            left = sums[i, RESIDUAL] - sums[i, COLUMN + 1] * offset[0] - sums[i, COLUMN + 2] * offset[1]
            along += sums[i, COLUMN] * left / weight
            leverage += sums[i, COLUMN] * sums[i, COLUMN] / weight
            total += left * left / weight
    if moving < 2 or leverage <= 0.0:
        return -1.0, 0.0
    return max(0.0, total - along * along / leverage) / (moving - 1), leverage


@njit(cache=True)
def _inflate(state):
    """state.inflation from the blocks of late."""
    average = newest = 0.0
    # where a load swings, a change shows here before it is found; it is not to hide itself
    fresh = PENDING if state.active > 1 else 0
    for n in range(fresh, BLOCKS):
        average += state.blocks[(state.block - n + BLOCKS) % BLOCKS] / (BLOCKS - fresh)
    for n in range(fresh, fresh + NEWEST):
        newest += state.blocks[(state.block - n + BLOCKS) % BLOCKS] / NEWEST
    state.inflation = _inflation(max(average, NEWEST_SHARE * newest))


@njit(cache=True)
def _look_again(state):
    """Judge the blocks since the last change anew, by the offset of now."""
    index = state.block
    for _ in range(state.fresh):
        index = index - 1 if index > 0 else BLOCKS - 1
        state.blocks[index] = max(0.0, _misfit(state.sums[index], state.offset)[0])


@njit(cache=True)
def _part_blocks(settings, state, samples):
    """A load changed `samples` ago: the block in which it did says nothing of the model."""
    begun = state.clock - samples
    if begun > state.clock - state.in_block:
        state.in_block = 0
        state.sums[state.block] = 0.0
    state.fresh = 0
    index = state.block
    for _ in range(BLOCKS - 1):
        index = index - 1 if index > 0 else BLOCKS - 1
        if state.ended[index] - settings.block_size >= begun:
            state.fresh += 1
        elif state.ended[index] > begun - ONSET_DOUBT * settings.bin_size:
            state.blocks[index] = 1.0
        else:
            break


@njit(cache=True)
def _inflation(scatter):
    """How much less a sample says than its noise allows, for blocks that scatter so."""
    return max(LEAST_INFLATION, scatter + (COLOUR - 1.0) * max(0.0, scatter - 1.0))


@njit(cache=True)
def _conclude(settings, state):
    """Mass, standard deviation and trust of now. Returns the event that they amount to."""
    active, inverse, drag = state.active, state.inverse, state.contrast[0]
    mass = _locate(state)
    for a in range(friction.COUNT):
        drag[a] = 0.0
        for p in range(active):
            drag[a] += inverse[0, p] * state.drag[p, a]
    doubt = friction.covariance_kernel(state.friction, drag, drag)
    # what was learnt while the model fitted says less once it no longer does
    worse = max(1.0, state.inflation * state.information[0, 0] / state.raw_information)
    state.shortfall *= settings.remember
    state.bias = 0.0
    if state.leverage > 0.0:  # averages that are not full yet are judged by what is in them
        lacking = settings.model_error + max(state.excess / state.judged, (state.inflation - 1.0) / COLOUR)
        state.bias = BIAS_SHARE * BIAS_SHARE * lacking * state.judged / state.leverage
    std_dev = math.sqrt(worse * inverse[0, 0] + doubt + state.bias)
    known_empty = state.gripper == OPEN
    contradicted = known_empty and mass > EMPTY_SIGMAS * std_dev + SMALLEST_CHANGE
    # what hangs on nothing is an error too, whichever way
    empty = known_empty or (state.gripper == UNKNOWN and state.load < SMALLEST_CHANGE and mass < SMALLEST_CHANGE)
    wrong = (abs(mass) if empty else -mass) - CONTRADICTION * std_dev - SHORTFALL_FLOOR
    lasting = std_dev < SHORTFALL_STD and wrong > state.shortfall
    state.wrong_for = state.wrong_for + settings.period if lasting else 0.0
    if state.wrong_for > (0.0 if known_empty else SETTLING_TIME):
        state.shortfall += settings.period / SETTLING_TIME * (wrong - state.shortfall)
    std_dev = math.hypot(std_dev, max(state.shortfall, wrong) if empty else state.shortfall)
    trusted = std_dev < TRUST_SHARE * abs(mass) + TRUST_FLOOR and state.inflation < FOREIGN
    state.quiet += 1
    state.burst = max(0.0, state.burst - EVENT_RATE * settings.period)
    margin = CONTRADICTION * std_dev + CONTRADICTION_FLOOR
    if mass < -margin or mass > settings.max_payload + margin or state.burst > EVENT_BURST:
        trusted = False
        std_dev = max(std_dev, abs(mass - min(max(mass, 0.0), settings.max_payload)))
    held = min(max(mass, 0.0), settings.max_payload)
    if contradicted:  # the gripper says one thing, the torque another
        trusted, std_dev = False, max(std_dev, held)
    elif known_empty:
        trusted, held, std_dev = True, 0.0, 0.0
    event = PayloadEvent.NONE.value
    if state.last_event == PayloadEvent.RELEASE.value and state.quiet < WINDOW * settings.bin_size:
        state.load = min(state.load, held)  # the rest of a release is no second one
    if trusted or abs(held - state.load) > CLEAR_STEP * std_dev:
        event = _event(settings, state, held, std_dev, trusted)
    state.mass = held
    state.std_dev = math.hypot(std_dev, TORQUE_SHARE * held)
    state.trusted = 1 if trusted else 0
    return event


@njit(cache=True)
def _event(settings, state, mass, std_dev, trusted):
    """What a mass says beside the one believed so far. Another step the same way soon after only refines the event."""
    step = mass - state.load
    soon = state.quiet < WINDOW * settings.bin_size
    since = state.quiet * settings.period
    small = abs(step) < REFINING_SHARE * state.load and since < REFINING_TIME
    way = 1.0 if state.last_event == PayloadEvent.PICK.value else -1.0
    small |= since < GRIPPER_TIME and way * (mass - state.load_before) > SMALLEST_CHANGE
    event = PayloadEvent.NONE.value
    least = max(SMALLEST_CHANGE, EVENT_SIGMAS * math.hypot(std_dev, state.load_std))
    if step > least:
        event = PayloadEvent.PICK.value
    elif step < -least:
        event = PayloadEvent.RELEASE.value
    before = state.load
    if trusted or event != PayloadEvent.NONE.value:
        state.load, state.load_std = mass, std_dev
    if event == PayloadEvent.NONE.value or small or (event == state.last_event and soon):
        return PayloadEvent.NONE.value
    state.load_before = before
    state.last_event = event
    state.quiet = 0
    state.burst += 1.0
    return event


@njit(cache=True)
def _corrected(state, moment, drag, load):
    """moment of `load`, what friction did to it taken off."""
    left = moment[load]
    for a in range(friction.COUNT):
        left -= drag[load, a] * state.friction.delta[a]
    return left


@njit(cache=True)
def _locate(state):
    """The mass, kg, which it returns, and state.offset, by the normal equations; their inverse is in state.inverse."""
    active, inverse, found = state.active, state.inverse, state.found
    _invert(state.information, active, inverse)
    for p in range(active):
        state.pull[p] = _corrected(state, state.moment, state.drag, p)
    for p in range(active):
        found[p] = 0.0
        for q in range(active):
            found[p] += inverse[p, q] * state.pull[q]
    for p in range(1, active):
        state.offset[p - 1] = found[p]
    return found[0]


@njit(cache=True)
def _find_change(state):
    """If the load is another since some bin than before, start its estimate anew from that bin.

    With I, b the information and moment since the onset (1) and before (0), the step b1/I1 - b0/I0 has the covariance
    1/I1 + 1/I0 of the noise, and what friction may do to the one and not to the other. Returns the bins since the
    onset, 0 where there is none.
    """
    active = state.active
    since, since_moment, since_drag = state.since_information, state.since_moment, state.since_drag
    before, before_moment = state.before_information, state.before_moment
    best, best_count = CHANGE_THRESHOLD, 0
    for p in range(active):
        since_moment[p] = 0.0
        state.pull[p] = _corrected(state, state.moment, state.drag, p)
        for q in range(active):
            since[p, q] = _prior(p) if p == q and p > 0 else 0.0
        for a in range(friction.COUNT):
            since_drag[p, a] = 0.0
    index = state.head
    for n in range(state.filled):
        for p in range(active):
            since_moment[p] += _corrected(state, state.bin_moment[index], state.bin_drag[index], p)
            before_moment[p] = state.pull[p] - since_moment[p]
            for q in range(active):
                since[p, q] += state.bin_information[index, p, q]
                before[p, q] = state.information[p, q] - since[p, q] + (_prior(p) if p == q and p > 0 else 0.0)
            for a in range(friction.COUNT):
                since_drag[p, a] += state.bin_drag[index, p, a]
        index = index - 1 if index > 0 else WINDOW - 1
        if n + 1 < SHORTEST or since[0, 0] <= 0.0 or before[0, 0] <= 0.0:
            continue
        if active == 1:  # without a division but for a candidate
            product = since[0, 0] * before[0, 0]
            scaled = since_moment[0] * before[0, 0] - before_moment[0] * since[0, 0]
            if scaled * scaled <= best * product * (since[0, 0] + before[0, 0]):
                continue
        distance = _step_distance(state, best)
        if distance > best:
            best, best_count = distance, n + 1
    if best_count > 0:
        _start_anew(state, best_count)
    return best_count


@njit(cache=True)
def _step_distance(state, least):
    """Squared distance of the loads since an onset from those before it, over its covariance; 0 where it is below
    `least` or too small to be a load."""
    active, contrast, step, spread = state.active, state.contrast, state.step, state.spread
    after, until = state.inverse, state.inverse_before
    _invert(state.since_information, active, after)
    _invert(state.before_information, active, until)
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
        for a in range(friction.COUNT):
            contrast[p, a] = 0.0
            for q in range(active):
                drag = state.since_drag[q, a]
                contrast[p, a] += after[p, q] * drag - until[p, q] * (state.drag[q, a] - drag)
    for p in range(active):
        for q in range(p + 1):
            spread[p, q] += friction.covariance_kernel(state.friction, contrast[p], contrast[q])
            spread[q, p] = spread[p, q]
    spread[0, 0] += 2.0 * state.bias * BIAS_SIGMAS * BIAS_SIGMAS / CHANGE_THRESHOLD  # another one in either
    return _squared(state, step, spread)


@njit(cache=True)
def _squared(state, step, spread):
    """step' inverse(spread) step."""
    active, inverse = state.active, state.inverse_spread
    _invert(spread, active, inverse)
    total = 0.0
    for p in range(active):
        for q in range(active):
            total += step[p] * inverse[p, q] * step[q]
    return total


@njit(cache=True)
def _start_anew(state, bins):
    """Take only the newest `bins` into the estimate."""
    active = state.active
    for p in range(active):
        state.moment[p] = 0.0
        for q in range(active):
            state.information[p, q] = _prior(p) if p == q and p > 0 else 0.0
        for a in range(friction.COUNT):
            state.drag[p, a] = 0.0
    index = state.head
    for _ in range(bins):
        for p in range(active):
            state.moment[p] += state.bin_moment[index, p]
            for q in range(active):
                state.information[p, q] += state.bin_information[index, p, q]
            for a in range(friction.COUNT):
                state.drag[p, a] += state.bin_drag[index, p, a]
        index = index - 1 if index > 0 else WINDOW - 1
    state.filled = bins
    state.raw_information = state.information[0, 0] * state.inflation
