"""Slow motion, in which gravity alone tells the mass and a gear rubs as it likes.

Below the speed at which Coulomb's law holds, friction is a level b_i of its own on each joint, against the motion: some
share of the Coulomb friction more or less than it, the same for as long as nothing fast happens. So

    r_i = m phi_i + b_i way_i + noise

with phi of the weight alone (of a slow acceleration the noise is more than the acceleration, and it is in r_i too) is
least squares in m and three b_i, each known beforehand to what a gear may depart by. Three things tell them apart:
the mass that was known when the motion became slow, turns of direction, and steps, for b does not step when something
is picked. A step is found where the newest samples contradict those before; then m starts anew, and b is kept.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel

MEMORY_TIME, NEWEST_TIME = 3.0, 0.3  # s, of what is averaged, and of what may contradict it
BEGIN_TIME = 0.3  # s of slow motion, nothing fast nor a stop between: what sets out or stops is through it in less
LEVEL_DRIFTS = 2.0  # standard deviations of a gear's drift, which one of b is: breakaway friction comes on top
WANDER_DRIFTS = 1 / 3  # of the same; b may wander by so much along the way
LEAST_STD = 0.01  # kg, no mass is known better beforehand
STEP_SIGMAS, SMALLEST_STEP = 5.0, 0.12  # of the newest against those before; kg

_SUMS = np.dtype([("load", "f8", 3), ("cross", "f8", 3), ("way", "f8", 3), ("pull", "f8", 3), ("rub", "f8", 3)])
# One sample, and what is believed beside: a joint where it is three.
_NOW = np.dtype(
    [
        ("phi", "f8", 3),  # N m/kg, of a mass that nothing accelerates
        ("residual", "f8", 3),  # N m
        ("way", "f8", 3),
        ("weight", "f8", 3),  # (N m)^-2, 0 where a joint rests
        ("drift", "f8", 3),  # N m, one standard deviation of a gear's
        ("mass", "f8"),  # kg
        ("variance", "f8"),  # kg^2
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("now", _NOW),
        ("lasted", "f8"),  # s of slow motion since anything fast or a stop
        ("begun", "i8"),
        ("whole", _SUMS),  # of weight times phi^2, phi way, way^2, phi r, way r, a joint
        ("newest", _SUMS),
        ("mass_before", "f8"),  # kg, what m is taken to be beforehand
        ("mass_variance", "f8"),  # kg^2
        ("level_before", "f8", 3),  # N m, the same of b
        ("level_variance", "f8", 3),
        ("mass", "f8"),  # kg
        ("variance", "f8"),  # kg^2
    ],
    align=True,
)


@kernel
def slow_kernel(slow, period, widest):
    """Take the sample in slow.now, without anything fast. Returns whether slow.mass and slow.variance say what hangs
    there. widest: kg^2, of a mass of which nothing is known."""
    now, moving = slow.now, False
    for i in range(3):
        moving |= now.weight[i] > 0.0
    if not moving:
        slow.lasted = 0.0
        return False
    slow.lasted += period
    if slow.lasted < BEGIN_TIME:
        return False
    if slow.begun == 0:
        slow.begun = 1
        slow.mass_before, slow.mass_variance = now.mass, max(LEAST_STD**2, min(now.variance, widest))
        for i in range(3):
            slow.level_before[i] = 0.0
            slow.level_variance[i] = (LEVEL_DRIFTS * now.drift[i]) ** 2
        _clear(slow.whole)
        _clear(slow.newest)
    _add(slow.whole, now, math.exp(-period / MEMORY_TIME))
    _add(slow.newest, now, math.exp(-period / NEWEST_TIME))
    _solve(slow)
    if _contradicted(slow):
        _leave_newest_out(slow)
        _start_anew(slow, widest)
    wander = 0.0
    for i in range(3):
        if slow.whole.way[i] > 0.0:
            wander += slow.whole.load[i] / slow.whole.way[i] / (WANDER_DRIFTS * now.drift[i]) ** 2
    if wander > 0.0:
        slow.variance = min(slow.variance + 1.0 / wander, widest)
    return True


@kernel
def fast_kernel(slow):
    """Something fast moves: what friction was in slow motion says nothing of it."""
    slow.lasted = 0.0
    slow.begun = 0


@kernel
def grip_kernel(slow, widest):
    """The gripper opened or closed: another mass from here on, the same friction."""
    if slow.begun != 0:
        _start_anew(slow, widest)


@kernel
def _start_anew(slow, widest):
    """Nothing is known of m, and of b what was found; what was summed up may be half of before, half of after."""
    for i in range(3):
        slow.level_before[i], slow.level_variance[i] = _level(slow, i)
    slow.mass_before, slow.mass_variance, slow.variance = slow.mass, widest, widest
    _clear(slow.whole)
    _clear(slow.newest)


@kernel
def _leave_newest_out(slow):
    """The step is in the newest samples, which would put it down to friction."""
    whole, newest = slow.whole, slow.newest
    for i in range(3):
        whole.load[i] -= newest.load[i]
        whole.cross[i] -= newest.cross[i]
        whole.way[i] -= newest.way[i]
        whole.pull[i] -= newest.pull[i]
        whole.rub[i] -= newest.rub[i]
    _solve(slow)


@kernel
def _clear(sums):
    for i in range(3):
        sums.load[i] = sums.cross[i] = sums.way[i] = sums.pull[i] = sums.rub[i] = 0.0


@kernel
def _add(sums, now, forgetting):
    for i in range(3):
        phi, way, residual, weight = now.phi[i], now.way[i], now.residual[i], now.weight[i]
        sums.load[i] = sums.load[i] * forgetting + weight * phi * phi
        sums.cross[i] = sums.cross[i] * forgetting + weight * phi * way
        sums.way[i] = sums.way[i] * forgetting + weight * way * way
        sums.pull[i] = sums.pull[i] * forgetting + weight * phi * residual
        sums.rub[i] = sums.rub[i] * forgetting + weight * way * residual


@kernel
def _solve(slow):
    """slow.mass and its variance by the normal equations, each b eliminated."""
    sums = slow.whole
    information, moment = 1.0 / slow.mass_variance, slow.mass_before / slow.mass_variance
    for i in range(3):
        known = 1.0 / slow.level_variance[i]
        share = sums.cross[i] / (sums.way[i] + known)
        information += sums.load[i] - share * sums.cross[i]
        moment += sums.pull[i] - share * (sums.rub[i] + known * slow.level_before[i])
    slow.mass, slow.variance = moment / information, 1.0 / information


@kernel
def _level(slow, i):
    """b of joint i and its variance, at the mass that was found."""
    sums, known = slow.whole, 1.0 / slow.level_variance[i]
    sure = sums.way[i] + known
    level = (sums.rub[i] + known * slow.level_before[i] - sums.cross[i] * slow.mass) / sure
    return level, 1.0 / sure + (sums.cross[i] / sure) ** 2 * slow.variance


@kernel
def _contradicted(slow):
    """Whether the newest samples ask for another mass than all do."""
    newest = slow.newest
    load = pull = spread = 0.0
    for i in range(3):
        level, variance = _level(slow, i)
        load += newest.load[i]
        pull += newest.pull[i] - level * newest.cross[i] - slow.mass * newest.load[i]
        spread += newest.cross[i] ** 2 * variance
    if load <= 0.0:
        return False
    step, doubt = pull / load, 1.0 / load + spread / (load * load) + slow.variance
    return abs(step) > SMALLEST_STEP and step * step > STEP_SIGMAS * STEP_SIGMAS * doubt
