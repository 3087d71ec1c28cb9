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

from schemas.messages import PayloadEvent
from service.estimator import friction

BIN_TIME = 0.002  # s, resolution of an onset
WINDOW = 150  # bins, how far back an onset is looked for
MEMORY_TIME = 3.0  # s, forgetting: longer than a carry, shorter than the drift of friction with temperature
# An unloaded gripper is the prior, within this; also the bound of the covariance when nothing excites.
PRIOR_STD = 2.0  # kg
# Smallest change that counts as a pick or release: friction and inertia errors imitate less than this.
SMALLEST_CHANGE = 0.12  # kg
# So soon after an event a smaller part of the load than this is the estimate settling, not the next event.
REFINING_TIME, REFINING_SHARE = 0.15, 0.5  # s, -
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
OUTLYING = 0.3  # of the scatter of a single block, which noise alone makes three times its mean now and then
# Trusted when one standard deviation is below share * mass + floor.
TRUST_SHARE, TRUST_FLOOR = 0.1, 0.025  # -, kg
# A mass below nothing shows a bias that other masses have too; it is remembered for this long.
SHORTFALL_TIME = 30.0  # s
# It counts where a mass is this sure, and shows for this long, by more than this: a release is not seen at once.
SHORTFALL_STD, SETTLING_TIME, SHORTFALL_FLOOR = 0.1, 0.3, 0.02  # kg, s, kg
# Beyond this many standard deviations and this much below nothing, or above the greatest payload, a mass is none.
CONTRADICTION, CONTRADICTION_FLOOR = 2.0, 0.05  # -, kg
# A gripper makes this many events a second at most; a burst of so many more is no gripper.
EVENT_RATE, EVENT_BURST = 5.0, 3.0  # 1/s, -

STATE = np.dtype(
    [
        ("information", "f8"),  # kg^-2
        ("moment", "f8"),  # kg^-1
        ("drag", "f8", friction.COUNT),  # sum of weight phi x: what delta adds to the moment
        ("bin_information", "f8", WINDOW),
        ("bin_moment", "f8", WINDOW),
        ("bin_drag", "f8", (WINDOW, friction.COUNT)),
        ("head", "i8"),  # bin that is being filled
        ("in_bin", "i8"),  # samples in it
        ("filled", "i8"),  # bins since the last change, at most WINDOW
        ("load", "f8"),  # kg, mass at the last event, then whenever it is trusted
        ("last_event", "i8"),
        ("quiet", "i8"),  # samples since then
        ("burst", "f8"),  # events of late, leaking
        ("blocks", "f8", BLOCKS),  # squared residuals at right angles to phi over what the noise explains, a ring
        ("block", "i8"),  # the next to be written
        ("inflation", "f8"),  # of the variance of the noise, of now
        ("raw_information", "f8"),  # information without inflation
        ("excess", "f8"),  # of the blocks' scatter over the noise, over BIAS_TIME
        ("leverage", "f8"),  # kg^-2, what a block says of the mass, over the same
        ("shortfall", "f8"),  # kg, how far below nothing masses have been of late
        ("in_block", "i8"),
        ("block_weight", "f8", 3),
        ("block_phi", "f8", 3),
        ("block_residual", "f8", 3),
        ("friction", friction.STATE),
        ("since_drag", "f8", friction.COUNT),  # scratch
        ("contrast", "f8", friction.COUNT),  # scratch
        ("shape", "f8", (3, friction.PARTS)),  # of this sample: direction, speed, 1
        ("phi", "f8", 3),  # of this sample, N m/kg
        ("residual", "f8", 3),  # of this sample, N m, measured minus predicted without payload
        ("weight", "f8", 3),  # of this sample, (N m)^-2, 0 where a joint has nothing to say
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


def settings(period: float, prior: np.ndarray, max_payload: float) -> np.ndarray:
    """One SETTINGS record. period: s. prior: (9,) of friction. max_payload: kg."""
    record = np.zeros((), SETTINGS)
    for name, time in (("bin_size", BIN_TIME), ("block_size", BLOCK_TIME)):
        record[name] = max(1, round(time / period))
    record["forgetting"] = np.exp(-period / MEMORY_TIME)
    record["remember"] = np.exp(-period / SHORTFALL_TIME)
    record["friction_forgetting"] = np.exp(-record["block_size"] * period / friction.MEMORY_TIME)
    record["worth"] = min(1.0, period / CORRELATION_TIME)
    record["prior"], record["period"], record["max_payload"] = prior, period, max_payload
    return record


def start(state: np.ndarray, prior: np.ndarray) -> None:
    """An empty gripper, nothing known; prior: (9,) of friction."""
    state[:] = np.zeros((), STATE)
    state["information"] = PRIOR_STD**-2
    state["filled"] = 1
    state["blocks"] = state["inflation"] = 1.0
    state["raw_information"] = PRIOR_STD**-2
    state["std_dev"] = PRIOR_STD
    friction.start(state["friction"], prior)


@njit(cache=True)
def payload_kernel(settings, state):
    """Take the sample in state.phi, residual, weight, shape. Filled: state.mass, std_dev, trusted. Returns an event."""
    prior, worth = PRIOR_STD**-2, settings.worth
    phi, residual, weight = state.phi, state.residual, state.weight
    information = moment = raw = 0.0
    for a in range(friction.COUNT):
        state.drag[a] *= settings.forgetting
    for i in range(3):
        weight[i] *= worth
    _scatter(settings, state)
    for i in range(3):
        raw += weight[i] * phi[i] * phi[i]
        weight[i] /= state.inflation
        pull = weight[i] * phi[i]
        information += pull * phi[i]
        moment += pull * residual[i]
        for a in range(friction.PARTS):
            state.drag[friction.PARTS * i + a] += pull * state.shape[i, a]
            state.bin_drag[state.head, friction.PARTS * i + a] += pull * state.shape[i, a]
    state.information = prior + (state.information - prior) * settings.forgetting + information
    state.raw_information = prior + (state.raw_information - prior) * settings.forgetting + raw
    state.moment = state.moment * settings.forgetting + moment
    state.bin_information[state.head] += information
    state.bin_moment[state.head] += moment
    state.in_bin += 1
    if state.in_bin >= settings.bin_size:
        state.in_bin = 0
        _find_change(state)
        state.head = (state.head + 1) % WINDOW
        state.filled = min(WINDOW, state.filled + 1)
        state.bin_information[state.head] = state.bin_moment[state.head] = 0.0
        for a in range(friction.COUNT):
            state.bin_drag[state.head, a] = 0.0
    return _conclude(settings, state)


@njit(cache=True)
def _scatter(settings, state):
    """Average of what the residuals of a block show at right angles to phi, friction taken off, over their noise."""
    delta = state.friction.delta
    for i in range(3):
        known = 0.0
        for a in range(friction.PARTS):
            known += state.shape[i, a] * delta[friction.PARTS * i + a]
        state.block_weight[i] += state.weight[i]
        state.block_phi[i] += state.weight[i] * state.phi[i]
        state.block_residual[i] += state.weight[i] * (state.residual[i] - known)
    friction.gather_kernel(state.friction, state.phi, state.residual, state.weight, state.shape)
    state.in_block += 1
    if state.in_block < settings.block_size:
        return
    state.in_block = 0
    along = across = total = 0.0
    active = 0
    for i in range(3):
        if state.block_weight[i] > 0.0:
            active += 1
            along += state.block_phi[i] * state.block_residual[i] / state.block_weight[i]
            across += state.block_phi[i] * state.block_phi[i] / state.block_weight[i]
            total += state.block_residual[i] * state.block_residual[i] / state.block_weight[i]
        state.block_weight[i] = state.block_phi[i] = state.block_residual[i] = 0.0
    if active > 1 and across > 0.0:
        own = max(0.0, total - along * along / across) / (active - 1)
        state.blocks[state.block] = own
        state.block = (state.block + 1) % BLOCKS
        share = settings.block_size * settings.period / BIAS_TIME
        state.excess += share * (max(0.0, own - 1.0) - state.excess)
        state.leverage += share * (across - state.leverage)
        average = newest = 0.0
        for n in range(BLOCKS):
            average += state.blocks[n] / BLOCKS
        for n in range(NEWEST):
            newest += state.blocks[(state.block - 1 - n + BLOCKS) % BLOCKS] / NEWEST
        state.inflation = _inflation(max(average, NEWEST_SHARE * newest))
        # friction is not to learn from what it cannot be: the block itself has a say
        doubtful = max(state.inflation, _inflation(OUTLYING * own))
        friction.learn_kernel(state.friction, settings.prior, settings.friction_forgetting, doubtful)


@njit(cache=True)
def _inflation(scatter):
    """How much less a sample says than its noise allows, for blocks that scatter so."""
    return max(LEAST_INFLATION, scatter + (COLOUR - 1.0) * max(0.0, scatter - 1.0))


@njit(cache=True)
def _conclude(settings, state):
    """Mass, standard deviation and trust of now. Returns the event that they amount to."""
    covariance = state.friction.covariance
    corrected, doubt = state.moment, 0.0
    for a in range(friction.COUNT):
        corrected -= state.drag[a] * state.friction.delta[a]
        for b in range(friction.COUNT):
            doubt += state.drag[a] * covariance[a, b] * state.drag[b]
    mass = corrected / state.information
    # what was learnt while the model fitted says less once it no longer does
    worse = max(1.0, state.inflation * state.information / state.raw_information)
    state.shortfall *= settings.remember
    bias = BIAS_SHARE * BIAS_SHARE * state.excess / state.leverage if state.leverage > 0.0 else 0.0
    std_dev = math.sqrt(worse / state.information + doubt / (state.information * state.information) + bias)
    below = -mass - CONTRADICTION * std_dev - SHORTFALL_FLOOR
    if std_dev < SHORTFALL_STD and below > state.shortfall:
        state.shortfall += settings.period / SETTLING_TIME * (below - state.shortfall)
    std_dev = math.hypot(std_dev, state.shortfall)
    trusted = std_dev < TRUST_SHARE * abs(mass) + TRUST_FLOOR and state.inflation < FOREIGN
    state.quiet += 1
    state.burst = max(0.0, state.burst - EVENT_RATE * settings.period)
    margin = CONTRADICTION * std_dev + CONTRADICTION_FLOOR
    if mass < -margin or mass > settings.max_payload + margin or state.burst > EVENT_BURST:
        trusted = False
        std_dev = max(std_dev, abs(mass - min(max(mass, 0.0), settings.max_payload)))
    held = min(max(mass, 0.0), settings.max_payload)
    event = PayloadEvent.NONE.value
    if state.last_event == PayloadEvent.RELEASE.value and state.quiet < WINDOW * settings.bin_size:
        state.load = min(state.load, held)  # the rest of a release is no second one
    if trusted or abs(held - state.load) > CLEAR_STEP * std_dev:
        event = _event(settings, state, held, trusted)
    state.mass = held
    state.std_dev = std_dev
    state.trusted = 1 if trusted else 0
    return event


@njit(cache=True)
def _event(settings, state, mass, trusted):
    """What a mass says beside the one believed so far. Another step the same way soon after only refines the event."""
    step = mass - state.load
    soon = state.quiet < WINDOW * settings.bin_size
    small = abs(step) < REFINING_SHARE * state.load and state.quiet * settings.period < REFINING_TIME
    event = PayloadEvent.NONE.value
    if step > SMALLEST_CHANGE:
        event = PayloadEvent.PICK.value
    elif step < -SMALLEST_CHANGE:
        event = PayloadEvent.RELEASE.value
    if trusted or event != PayloadEvent.NONE.value:
        state.load = mass
    if event == PayloadEvent.NONE.value or small or (event == state.last_event and soon):
        return PayloadEvent.NONE.value
    state.last_event = event
    state.quiet = 0
    state.burst += 1.0
    return event


@njit(cache=True)
def _find_change(state):
    """If the mass is another since some bin than before, start its estimate anew from that bin.

    With I, b the information and moment since the onset (1) and before (0), the step b1/I1 - b0/I0 has the variance
    1/I1 + 1/I0 of the noise, and what friction may do to the one and not to the other.
    """
    delta, since_drag = state.friction.delta, state.since_drag
    since_information = since_moment = 0.0
    best, best_count = CHANGE_THRESHOLD, 0
    total_information, total_moment = state.information, state.moment
    for a in range(friction.COUNT):
        since_drag[a] = 0.0
        total_moment -= state.drag[a] * delta[a]
    index = state.head
    for n in range(state.filled):
        since_information += state.bin_information[index]
        since_moment += state.bin_moment[index]
        for a in range(friction.COUNT):
            since_drag[a] += state.bin_drag[index, a]
            since_moment -= state.bin_drag[index, a] * delta[a]
        index = index - 1 if index > 0 else WINDOW - 1
        before_information = total_information - since_information
        if n + 1 < SHORTEST or since_information <= 0.0 or before_information <= 0.0:
            continue
        product = since_information * before_information
        # step * product, so that the loop needs no division but for a candidate
        scaled = since_moment * before_information - (total_moment - since_moment) * since_information
        spread = product * (since_information + before_information)
        if scaled * scaled > best * spread and abs(scaled) > SMALLEST_CHANGE * product:
            spread += _confusion(state, since_information, before_information) * product * product
            if scaled * scaled > best * spread:
                best, best_count = scaled * scaled / spread, n + 1
    if best_count > 0:
        state.information = state.moment = 0.0
        for a in range(friction.COUNT):
            state.drag[a] = 0.0
        index = state.head
        for _ in range(best_count):
            state.information += state.bin_information[index]
            state.moment += state.bin_moment[index]
            for a in range(friction.COUNT):
                state.drag[a] += state.bin_drag[index, a]
            index = index - 1 if index > 0 else WINDOW - 1
        state.filled = best_count
        state.raw_information = state.information * state.inflation


@njit(cache=True)
def _confusion(state, since, before):
    """Variance, kg^2, of a step in mass by what is not known of friction."""
    covariance, contrast = state.friction.covariance, state.contrast
    for a in range(friction.COUNT):
        contrast[a] = state.since_drag[a] / since - (state.drag[a] - state.since_drag[a]) / before
    total = 0.0
    for a in range(friction.COUNT):
        for b in range(friction.COUNT):
            total += contrast[a] * covariance[a, b] * contrast[b]
    return total
