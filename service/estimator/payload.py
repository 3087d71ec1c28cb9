"""Payload mass: scalar recursive least squares in information form, and a change detector for picks and releases.

The three torque residuals of a sample are r_i = m_p phi_i + noise, phi = J'(p_ddot + g) in N m/kg: the paper's three
Cartesian rows y = m_p X, brought to the joints, where the noise lives, so that each joint weighs by its own noise.

Change detection is a two-sample test: for every onset within the last window, is the mass since then another than
before? On a change the estimate starts anew from the samples since the onset, so it is at once as good as those samples
allow. Nothing is trusted before it is excited.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from schemas.messages import PayloadEvent

BIN_TIME = 0.002  # s, resolution of an onset
WINDOW = 150  # bins, how far back an onset is looked for
MEMORY_TIME = 3.0  # s, forgetting: longer than a carry, shorter than the drift of friction with temperature
# An unloaded gripper is the prior, within this; also the bound of the covariance when nothing excites.
PRIOR_STD = 2.0  # kg
# Smallest change that counts as a pick or release (friction and inertia errors imitate less than this), and the share
# of the load that a release must at least take off (less is the estimate settling).
SMALLEST_CHANGE, RELEASE_SHARE = 0.12, 0.5  # kg, -
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
# Trusted when one standard deviation is below share * mass + floor.
TRUST_SHARE, TRUST_FLOOR = 0.1, 0.025  # -, kg

STATE = np.dtype(
    [
        ("information", "f8"),  # kg^-2
        ("moment", "f8"),  # kg^-1
        ("bin_information", "f8", WINDOW),
        ("bin_moment", "f8", WINDOW),
        ("head", "i8"),  # bin that is being filled
        ("in_bin", "i8"),  # samples in it
        ("filled", "i8"),  # bins since the last change, at most WINDOW
        ("load", "f8"),  # kg, mass at the last event, then whenever it is trusted
        ("last_event", "i8"),
        ("quiet", "i8"),  # samples since then
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


def start(state: np.ndarray) -> None:
    """An empty gripper, nothing known."""
    state[:] = np.zeros((), STATE)
    state["information"] = PRIOR_STD**-2
    state["filled"] = 1


@njit(cache=True)
def payload_kernel(state, forgetting, bin_size, worth, phi, residual, weight):
    """Take one sample. Returns (mass kg, std_dev kg, trusted, event).

    phi: (3,) N m/kg. residual: (3,) N m, measured minus predicted without payload. weight: (3,) (N m)^-2, 0
    where a joint has nothing to say. bin_size: samples a bin. worth: share of a sample that is new information.
    """
    prior = PRIOR_STD**-2
    information = moment = 0.0
    for i in range(3):
        information += worth * weight[i] * phi[i] * phi[i]
        moment += worth * weight[i] * phi[i] * residual[i]
    state.information = prior + (state.information - prior) * forgetting + information
    state.moment = state.moment * forgetting + moment
    state.bin_information[state.head] += information
    state.bin_moment[state.head] += moment
    state.in_bin += 1
    if state.in_bin >= bin_size:
        state.in_bin = 0
        _find_change(state)
        state.head = (state.head + 1) % WINDOW
        state.filled = min(WINDOW, state.filled + 1)
        state.bin_information[state.head] = state.bin_moment[state.head] = 0.0
    mass = state.moment / state.information
    std_dev = 1.0 / math.sqrt(state.information)
    trusted = std_dev < TRUST_SHARE * abs(mass) + TRUST_FLOOR
    state.quiet += 1
    event = PayloadEvent.NONE.value
    if trusted or abs(mass - state.load) > CLEAR_STEP * std_dev:
        event = _event(state, mass, trusted, WINDOW * bin_size)
    return mass, std_dev, trusted, event


@njit(cache=True)
def _event(state, mass, trusted, refractory):
    """What a mass says beside the one believed so far. Another step the same way soon after only refines the event."""
    step = max(0.0, mass) - state.load
    event = PayloadEvent.NONE.value
    if step > SMALLEST_CHANGE:
        event = PayloadEvent.PICK.value
    elif step < -max(SMALLEST_CHANGE, RELEASE_SHARE * state.load):
        event = PayloadEvent.RELEASE.value
    if trusted or event != PayloadEvent.NONE.value:
        state.load = max(0.0, mass)
    if event == PayloadEvent.NONE.value or (event == state.last_event and state.quiet < refractory):
        return PayloadEvent.NONE.value
    state.last_event = event
    state.quiet = 0
    return event


@njit(cache=True)
def _find_change(state):
    """If the mass is another since some bin than before, start its estimate anew from that bin.

    With I, b the information and moment since the onset (1) and before (0), the step b1/I1 - b0/I0 has the variance
    1/I1 + 1/I0.
    """
    since_information = since_moment = 0.0
    best, best_count = CHANGE_THRESHOLD, 0
    best_information = best_moment = 0.0
    total_information, total_moment = state.information, state.moment
    index = state.head
    for n in range(state.filled):
        since_information += state.bin_information[index]
        since_moment += state.bin_moment[index]
        index = index - 1 if index > 0 else WINDOW - 1
        before_information = total_information - since_information
        if n + 1 < SHORTEST or since_information <= 0.0 or before_information <= 0.0:
            continue
        product = since_information * before_information
        # step * product, so that the loop needs no division but for a candidate
        scaled = since_moment * before_information - (total_moment - since_moment) * since_information
        if scaled * scaled > best * product * (since_information + before_information) and (
            abs(scaled) > SMALLEST_CHANGE * product
        ):
            best, best_count = scaled * scaled / (product * (since_information + before_information)), n + 1
            best_information, best_moment = since_information, since_moment
    if best_count > 0:
        state.information = best_information
        state.moment = best_moment
        state.filled = best_count
