"""Friction that follows the machine: how far Coulomb, viscous friction and offset are from the identified ones, now.

Per joint i the torque residual of a sample is r_i = m_p phi_i + x_i delta_i + noise with x_i = (direction, speed, 1).
The payload is eliminated sample by sample: only the part of the residuals at right angles to phi, in the metric of the
noise, is looked at, so what hangs on the gripper, and when it was picked, need not be known. What is left is linear
least squares in nine numbers, with slow forgetting and the identified values as the prior.

The feed-forward torque reckons with what is sure of it alone: friction made up for that is not there drives the joint.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel

PARTS = 3  # Coulomb N m, viscous N m s/rad, offset N m
COUNT = 3 * PARTS

# One standard deviation of what a gear does from day to day, as a share of what was identified, and at least this.
DRIFT_SHARE = 0.15
SMALLEST_DRIFT = (0.15, 0.05, 0.15)  # N m, N m s/rad, N m
DRIFT_SPEED = 1.0  # rad/s, at which two frictions are compared
# No more than this many standard deviations are believed.
BOUND = 4.0
# A gear warms within minutes.
MEMORY_TIME = 20.0  # s of motion

STATE = np.dtype(
    [
        ("information", "f8", (COUNT, COUNT)),
        ("moment", "f8", COUNT),
        ("block_information", "f8", (COUNT, COUNT)),
        ("block_moment", "f8", COUNT),
        ("delta", "f8", COUNT),  # joint by joint
        ("sure", "f8", COUNT),  # of it, what is beyond one standard deviation
        ("held", "i8"),  # whether one of them is held at its bound
        ("covariance", "f8", (COUNT, COUNT)),
        ("root", "f8", (COUNT, COUNT)),  # scratch
        ("column", "f8", COUNT),  # scratch
    ],
    align=True,
)


def drift(viscous: np.ndarray, coulomb: np.ndarray) -> np.ndarray:
    """(9,) prior standard deviations for identified friction (3,) N m s/rad and (3,) N m."""
    found = np.stack([np.abs(coulomb), np.abs(viscous), np.zeros(3)], axis=1)
    return np.maximum(DRIFT_SHARE * found, SMALLEST_DRIFT).ravel()


def start(state: np.ndarray, prior: np.ndarray) -> None:
    """Nothing is known but the prior (9,)."""
    state[:] = np.zeros((), STATE)
    state["covariance"] = np.diag(prior**2)


def aged(information: np.ndarray, moment: np.ndarray, prior: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Information (9, 9) and moment (9,) of a departure that comes back to none, of which `share` is left: its mean
    shrinks by that, and its covariance grows towards that of the prior (9,), a Gauss-Markov process."""
    known = np.diag(1.0 / prior**2)
    covariance = np.linalg.inv(information + known)
    later = np.linalg.inv(share**2 * covariance + (1.0 - share**2) * np.diag(prior**2))
    return later - known, later @ (share * (covariance @ moment))


def learnt(state: np.void) -> tuple[np.ndarray, np.ndarray]:
    """Departure from the identified friction and its standard deviation, (3, PARTS) each: joints, parts."""
    spread = np.sqrt(np.maximum(np.diag(state["covariance"]), 0.0))
    return state["delta"].reshape(3, PARTS).copy(), spread.reshape(3, PARTS)


def drift_share(departure: np.ndarray, identified: np.ndarray) -> np.ndarray:
    """(3,): the larger of what friction at `DRIFT_SPEED` and what the offset departs by, over friction there.

    departure: (3, PARTS), as `learnt`. identified: (3, 2) N m, N m s/rad.
    """
    moving = departure[:, 0] + departure[:, 1] * DRIFT_SPEED
    whole = identified[:, 0] + identified[:, 1] * DRIFT_SPEED
    return np.maximum(np.abs(moving), np.abs(departure[:, 2])) / np.maximum(whole, SMALLEST_DRIFT[0])


@kernel
def gather_kernel(state, column, residual, known, weight, shape):
    """Take one sample into the block. column[:, 0]: phi, N m/kg. residual, known, weight: (3,) N m, N m of it that is
    known not to be friction, (N m)^-2. shape: (3, 3), x_i."""
    load = 0.0
    for i in range(3):
        load += weight[i] * column[i, 0] * column[i, 0]
    if load <= 0.0:
        return
    for i in range(3):
        if weight[i] <= 0.0:
            continue
        for j in range(3):
            part = -weight[i] * column[i, 0] * column[j, 0] * weight[j] / load
            if i == j:
                part += weight[i]
            for a in range(PARTS):
                state.block_moment[PARTS * i + a] += shape[i, a] * part * (residual[j] - known[j])
                for b in range(PARTS):
                    state.block_information[PARTS * i + a, PARTS * j + b] += shape[i, a] * part * shape[j, b]


@kernel
def covariance_kernel(state, one, other):
    """Covariance of two sums that friction enters with `one` and `other`, both (9,)."""
    total = 0.0
    for a in range(COUNT):
        for b in range(COUNT):
            total += one[a] * state.covariance[a, b] * other[b]
    return total


@kernel
def learn_kernel(state, prior, forgetting, inflation):
    """Take the block, whose residuals scatter `inflation` times as much as their weights say. prior: (9,), as drift."""
    for a in range(COUNT):
        state.moment[a] = state.moment[a] * forgetting + state.block_moment[a] / inflation
        state.block_moment[a] = 0.0
        for b in range(COUNT):
            state.information[a, b] = state.information[a, b] * forgetting + state.block_information[a, b] / inflation
            state.block_information[a, b] = 0.0
    _solve(state, prior)


@kernel
def _solve(state, prior):
    """What is known of friction from the information, by Cholesky; the prior weighs in undiminished."""
    root, column = state.root, state.column
    state.held = 0
    for a in range(COUNT):
        for b in range(a + 1):
            total = state.information[a, b]
            if a == b:
                total += 1.0 / (prior[a] * prior[a])
            for k in range(b):
                total -= root[a, k] * root[b, k]
            if a == b:
                root[a, a] = np.sqrt(max(total, 1e-12))
            else:
                root[a, b] = total / root[b, b]
    for b in range(COUNT + 1):
        for a in range(COUNT):
            total = state.moment[a] if b == COUNT else (1.0 if a == b else 0.0)
            for k in range(a):
                total -= root[a, k] * column[k]
            column[a] = total / root[a, a]
        for a in range(COUNT - 1, -1, -1):
            total = column[a]
            for k in range(a + 1, COUNT):
                total -= root[k, a] * column[k]
            column[a] = total / root[a, a]
        for a in range(COUNT):
            if b == COUNT:
                state.delta[a] = max(-BOUND * prior[a], min(BOUND * prior[a], column[a]))
                state.held |= state.delta[a] != column[a]
            else:
                state.covariance[a, b] = column[a]
    for a in range(COUNT):
        beyond = max(0.0, abs(state.delta[a]) - np.sqrt(max(state.covariance[a, a], 0.0)))
        state.sure[a] = np.copysign(beyond, state.delta[a])
