"""Friction and torque scale that follow the machine: how far Coulomb, viscous friction, offset and scale are from the
identified ones, now.

Per joint i the torque residual of a sample is r_i = m_p phi_i + x_i delta_i + noise with x_i = (direction, speed, 1,
torque of the model): a torque constant that has changed does to every part of the torque the same. The payload is
eliminated from the mean over a short way: only the part of the residuals at right angles to phi, in the metric of the
noise, is looked at, so what hangs on the gripper, and when it was picked, need not be known. (Noise of the acceleration
turns a single sample's phi away from friction along it: where little moves, least squares would put the load down to
that, Fuller 1987.) What is left is linear least squares in thirteen numbers, with slow forgetting and the identified
values as the prior: the last is the dry friction of the forearms' ball joints, which looks much like a load where a
joint's own does not.

A scale is told from an inertia that is a little wrong by little: below `CHANGED_SCALE` it is taken for that, left out,
and all that it would change counts as error.

The feed-forward torque reckons with what is sure of it alone: friction made up for that is not there drives the joint.
"""

from __future__ import annotations

import numpy as np

from schemas.kernels import kernel

OWN = 4  # a joint's: Coulomb N m, viscous N m s/rad, offset N m, scale of the reported torque less one
SCALE = 3
BALLS = 4  # of the robot: dry friction of a forearm's ball joints at either end, N m
PARTS, COUNT = OWN + 1, 3 * OWN + 1
LOWER = np.tril_indices(COUNT)  # rows and columns of a symmetric matrix that are stored once, in the order of `below`
TRIANGLE = len(LOWER[0])

# One standard deviation of what a gear does from day to day, as a share of what was identified, and at least this.
DRIFT_SHARE = 0.15
SMALLEST_DRIFT = (0.15, 0.05, 0.15)  # N m, N m s/rad, N m
# The same of a torque constant: magnets lose 0.1 %/K, so 5 % are two of these.
SCALE_DRIFT = 0.03
# The same of ball joints, whose shells wear and whose springs tire.
BALLS_DRIFT = 0.1  # N m
DRIFT_SPEED = 1.0  # rad/s, at which two frictions are compared
# A scale is taken to have changed beyond this, where it is this many standard deviations, and until all are below that.
CHANGED_SCALE, CHANGED_SIGMAS, SAME_SCALE = 0.02, 3.0, 0.01
CHANGED_BALLS, SAME_BALLS = 0.03, 0.015  # N m, the same of ball joints: what a model lacks looks like so little
# No more than this many standard deviations are believed.
BOUND = 4.0
# Blocks within which a change of load that they may be spoilt by is found.
UNDONE = 5
# A gear warms within minutes.
MEMORY_TIME = 20.0  # s of motion

STATE = np.dtype(
    [
        ("information", "f8", (COUNT, COUNT)),
        ("moment", "f8", COUNT),
        ("sum_weight", "f8", 3),  # over some samples, and of weight times
        ("sum_load", "f8", 3),  # phi
        ("sum_pull", "f8", 3),  # residual
        ("sum_shape", "f8", (3, PARTS)),
        ("block_information", "f8", TRIANGLE),  # by `below`
        ("block_moment", "f8", COUNT),
        ("earlier_information", "f8", (2, TRIANGLE)),  # as they were UNDONE blocks ago at most, and at least
        ("earlier_moment", "f8", (2, COUNT)),
        ("since", "i8"),  # blocks since the first of these
        ("delta", "f8", COUNT),  # joint by joint
        ("sure", "f8", COUNT),  # of it, what is beyond one standard deviation
        ("held", "i8"),  # whether one of them is held at its bound
        ("changed", "i8"),  # whether a scale is taken to have
        ("worn", "i8"),  # whether the ball joints are
        ("covariance", "f8", (COUNT, COUNT)),
        ("root", "f8", (COUNT, COUNT)),  # scratch
        ("column", "f8", COUNT),  # scratch
        ("found", "f8", COUNT),  # with any scale and worn ball joints
    ],
    align=True,
)


def drift(viscous: np.ndarray, coulomb: np.ndarray) -> np.ndarray:
    """(COUNT,) prior standard deviations for identified friction (3,) N m s/rad and (3,) N m."""
    found = np.stack([np.abs(coulomb), np.abs(viscous), np.zeros(3)], axis=1)
    own = np.column_stack([np.maximum(DRIFT_SHARE * found, SMALLEST_DRIFT), np.full(3, SCALE_DRIFT)])
    return np.append(own, BALLS_DRIFT)


def start(state: np.ndarray, prior: np.ndarray) -> None:
    """Nothing is known but the prior (COUNT,)."""
    state[:] = np.zeros((), STATE)
    state["covariance"] = np.diag(prior**2)


def aged(information: np.ndarray, moment: np.ndarray, prior: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Information (COUNT, COUNT) and moment (COUNT,) of a departure that comes back to none, of which `share` is left:
    its mean shrinks by that, its covariance grows towards that of the prior (COUNT,), a Gauss-Markov process."""
    known = np.diag(1.0 / prior**2)
    covariance = np.linalg.inv(information + known)
    later = np.linalg.inv(share**2 * covariance + (1.0 - share**2) * np.diag(prior**2))
    below_diagonal = np.tril(later - known, -1)  # which the other half is, to the bit
    return below_diagonal + below_diagonal.T + np.diag(np.diag(later - known)), later @ (share * (covariance @ moment))


@kernel
def place(joint, part):
    """Where a part of a joint's shape has its departure."""
    return COUNT - 1 if part == BALLS else OWN * joint + part


@kernel
def below(row, column):
    """Where a symmetric matrix that is stored once has `column` of `row`, no later than it."""
    return row * (row + 1) // 2 + column


@kernel
def gather_kernel(state, column, residual, known, weight, shape):
    """Take one sample. column[:, 0]: phi, N m/kg. residual, known, weight: (3,) N m, N m of it that is known not to be
    friction, (N m)^-2. shape: (3, PARTS), x_i."""
    for i in range(3):
        state.sum_weight[i] += weight[i]
        state.sum_load[i] += weight[i] * column[i, 0]
        state.sum_pull[i] += weight[i] * (residual[i] - known[i])
        for a in range(PARTS):
            state.sum_shape[i, a] += weight[i] * shape[i, a]


@kernel
def eliminate_kernel(state):
    """Take what the mean of the samples since the last time says at right angles to phi into the block."""
    weight, across, load = state.sum_weight, state.sum_load, 0.0
    for i in range(3):
        if weight[i] > 0.0:
            load += across[i] * across[i] / weight[i]
    if load > 0.0:
        for i in range(3):
            for j in range(3):
                if weight[i] <= 0.0 or weight[j] <= 0.0:
                    continue
                part = ((weight[i] if i == j else 0.0) - across[i] * across[j] / load) / (weight[i] * weight[j])
                for a in range(PARTS):
                    at, pull = place(i, a), state.sum_shape[i, a] * part
                    state.block_moment[at] += pull * state.sum_pull[j]
                    for b in range(PARTS):
                        to = place(j, b)
                        if to <= at:
                            state.block_information[below(at, to)] += pull * state.sum_shape[j, b]
    _clear_sums(state)


@kernel
def _clear_sums(state):
    for i in range(3):
        state.sum_weight[i] = state.sum_load[i] = state.sum_pull[i] = 0.0
        for a in range(PARTS):
            state.sum_shape[i, a] = 0.0


@kernel
def covariance_kernel(state, one, other):
    """Covariance of two sums that friction enters with `one` and `other`, both (COUNT,)."""
    total = 0.0
    for a in range(COUNT):
        for b in range(COUNT):
            total += one[a] * state.covariance[a, b] * other[b]
    return total


@kernel
def doubt_kernel(state, prior, drag):
    """Variance of a sum that friction enters with `drag`, and the part of it that comes of a departure of which nothing
    is learnt yet; the rest is the error of what was learnt. drag, prior: (COUNT,).

    With the covariance P, the prior's P0 and the information I = inverse(P) - inverse(P0), the error of delta is
    -P inverse(P0) delta of the true one and P times the noise of what was seen: P = P inverse(P0) P + P I P.
    """
    whole = unlearnt = 0.0
    for a in range(COUNT):
        pulled = 0.0
        for b in range(COUNT):
            pulled += state.covariance[a, b] * drag[b]
        whole += drag[a] * pulled
        beyond = pulled / prior[a]
        unlearnt += beyond * beyond
    return whole, min(whole, unlearnt)


@kernel
def learn_kernel(state, prior, forgetting, inflation):
    """Take the block, whose residuals scatter `inflation` times as much as their weights say. prior: (COUNT,)."""
    state.since += 1
    if state.since >= UNDONE:
        state.since = 0
        for n in range(TRIANGLE):
            state.earlier_information[1, n] = state.earlier_information[0, n]
        for a in range(COUNT):
            state.earlier_moment[1, a] = state.earlier_moment[0, a]
        _note_earlier(state)
    for a in range(COUNT):
        state.moment[a] = state.moment[a] * forgetting + state.block_moment[a] / inflation
        state.block_moment[a] = 0.0
        for b in range(a + 1):
            known = state.information[a, b] * forgetting + state.block_information[below(a, b)] / inflation
            state.information[a, b] = state.information[b, a] = known
            state.block_information[below(a, b)] = 0.0
    _solve(state, prior)


@kernel
def unlearn_kernel(state, prior):
    """Nothing is known of the newest UNDONE blocks, nor of some before."""
    for a in range(COUNT):
        state.moment[a] = state.earlier_moment[1, a]
        for b in range(a + 1):
            state.information[a, b] = state.information[b, a] = state.earlier_information[1, below(a, b)]
    _note_earlier(state)
    state.since = 0
    _clear_sums(state)
    state.block_moment[:] = 0.0
    state.block_information[:] = 0.0
    _solve(state, prior)


@kernel
def _note_earlier(state):
    """Keep what is known now as what was before the blocks to come."""
    for a in range(COUNT):
        state.earlier_moment[0, a] = state.moment[a]
        for b in range(a + 1):
            state.earlier_information[0, below(a, b)] = state.information[a, b]


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
                state.found[a] = state.delta[a] = column[a]
            else:
                state.covariance[a, b] = column[a]
    _note_change(state)
    _leave_out(state)
    for a in range(COUNT):
        believed = state.delta[a]
        state.delta[a] = max(-BOUND * prior[a], min(BOUND * prior[a], believed))
        state.held |= state.delta[a] != believed
        beyond = max(0.0, abs(state.delta[a]) - np.sqrt(max(state.covariance[a, a], 0.0)))
        state.sure[a] = np.copysign(beyond, state.delta[a])


@kernel
def _note_change(state):
    """state.changed and state.worn, from what is found of the scales and the ball joints."""
    least = SAME_SCALE if state.changed != 0 else CHANGED_SCALE
    state.changed = 0
    for i in range(3):
        state.changed |= _stands_out(state, place(i, SCALE), least)
    state.worn = _stands_out(state, COUNT - 1, SAME_BALLS if state.worn != 0 else CHANGED_BALLS)


@kernel
def _stands_out(state, k, least):
    size = abs(state.found[k])
    return size > least and size > CHANGED_SIGMAS * np.sqrt(max(state.covariance[k, k], 0.0))


@kernel
def _leave_out(state):
    """state.delta where the ball joints and every scale are what was identified, unless they have changed, by
    conditioning on them one by one; and what the scales found would make of it, squared, beside the covariance."""
    left = state.root
    for a in range(COUNT):
        for b in range(COUNT):
            left[a, b] = state.covariance[a, b]
    for n in range(-1, 3):
        k = place(n, SCALE) if n >= 0 else COUNT - 1
        if (state.changed if n >= 0 else state.worn) != 0:
            continue
        for a in range(COUNT):
            state.column[a] = left[k, a]
        variance = max(state.column[k], 1e-12)
        wrong = state.delta[k] / variance
        for a in range(COUNT):
            state.delta[a] -= state.column[a] * wrong
            for b in range(COUNT):
                left[a, b] -= state.column[a] * state.column[b] / variance
            if n < 0:
                state.found[a] = state.delta[a]
    for a in range(COUNT):
        for b in range(COUNT):
            state.covariance[a, b] += (state.found[a] - state.delta[a]) * (state.found[b] - state.delta[b])
