"""Gears that yield or are loose, one sample at a time: links behind motors whose motion is known.

With the link's twist e = link - motor angle of each joint whose gear is no rigid one, M the mass matrix of the links
(the motors' inertia taken off) with the payload on the platform, and `load` the torque that the rigid robot would take
at the links' angles and speeds and the motors' acceleration:

    M e_ddot + D e_dot + K (e - flank) = -(load - I_m theta_ddot)        K, D = 0 while the flanks are apart

The joints swing together, for M couples them through forearms and platform. The torque of each motor is then

    load + M e_ddot          which on a joint with a gear is I_m theta_ddot - D e_dot - K (e - flank)

Both are linear in the load: a second twist, per kilogram of payload, runs along under the same M, so that a payload is
seen through the gears as it is felt there. Newmark's method with constant mean acceleration (Newmark 1959): no step
makes it unstable, however stiff a gear is; so many substeps that a flank's impact is met in time.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.kernels import kernel
from service.model.elastic import LOST, split_kernel

SUBSTEPS_PER_SECOND = 8_000.0

# Rows: of the robot without payload, per kg of payload.
TWIST = np.dtype(
    [
        ("started", "i8"),
        ("angle", "f8", (2, 3)),
        ("speed", "f8", (2, 3)),
        ("change", "f8", (2, 3)),
        (
            "felt",
            "f8",
            (2, 3),
        ),  # of it at the motors: behind a loose gear a mean, for impacts are shorter than a sample
        ("shaken", "f8", 3),  # (N m)^2, of impacts of late
        ("force", "f8", (2, 3)),  # N m, on the links at the end of the last step
        ("swing", "f8", 3),  # (N m)^2, of the torque of a swing that nobody knows, as far as it has not died out
        ("flank", "i8", 3),  # that is closed: -1, 1; 0: none, or a gear without lost motion
        # scratch
        ("mass", "f8", (3, 3)),
        ("matrix", "f8", (3, 3)),
        ("inverse", "f8", (3, 3)),
        ("now", "f8", (2, 3)),
        ("right", "f8", 3),
        ("side", "f8", 3),
        ("motor", "f8", 3),  # kg m^2 that turn with the motors there
    ],
    align=True,
)


# A measured acceleration smears a strike of the flanks over about this long.
STRIKE_TIME = 0.006  # s


@kernel
def invert_kernel(m, result):
    """result (3, 3): inverse of m, symmetric and positive, by cofactors."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    x, y, z = d * f - e * e, c * e - b * f, b * e - c * d
    over = 1.0 / (a * x + b * y + c * z)
    result[0, 0], result[1, 1], result[2, 2] = over * x, over * (a * f - c * c), over * (a * d - b * b)
    result[0, 1] = result[1, 0] = over * y
    result[0, 2] = result[2, 0] = over * z
    result[1, 2] = result[2, 1] = over * (b * c - a * e)


@kernel
def release_kernel(twist):
    """Begin anew with the next sample; until then the links stand where their motors do, and the robot is rigid."""
    twist.started = 0
    for i in range(3):
        twist.shaken[i] = 0.0
        for row in range(2):
            twist.angle[row, i] = twist.speed[row, i] = twist.felt[row, i] = 0.0


@kernel
def _begin(gears, twist, carried):
    """At rest under the load of now, on the flank that it presses."""
    for i in range(3):
        twist.flank[i] = 0
        twist.shaken[i] = 0.0
        for row in range(2):
            force = twist.now[row, i]
            twist.angle[row, i] = force / gears.stiffness[i] if gears.stiffness[i] > 0.0 else 0.0
            twist.speed[row, i] = twist.change[row, i] = twist.felt[row, i] = 0.0
            twist.force[row, i] = force
        twist.swing[i] = twist.force[0, i] ** 2
        if gears.half[i] > 0.0:
            twist.flank[i] = 1 if twist.now[0, i] + carried * twist.now[1, i] > 0.0 else -1
            twist.angle[0, i] += twist.flank[i] * gears.half[i]
    twist.started = 1


@kernel
def _touch(gears, twist, i, carried):
    """twist.flank of joint i: the one that pushes. Returns whether that has changed."""
    half, before = gears.half[i], twist.flank[i]
    angle = twist.angle[0, i] + carried * twist.angle[1, i]
    speed = twist.speed[0, i] + carried * twist.speed[1, i]
    flank = 0
    if angle > half and gears.stiffness[i] * (angle - half) + gears.damping[i] * speed > 0.0:
        flank = 1
    elif angle < -half and gears.stiffness[i] * (angle + half) + gears.damping[i] * speed < 0.0:
        flank = -1
    twist.flank[i] = flank
    return flank != before


@kernel
def _is_closed(gears, twist, i):
    return gears.stiffness[i] > 0.0 and (gears.half[i] == 0.0 or twist.flank[i] != 0)


@kernel
def _prepare(gears, twist, h):
    """twist.inverse for a step of h s with the flanks of now."""
    for i in range(3):
        for j in range(3):
            coupled = gears.stiffness[i] > 0.0 and gears.stiffness[j] > 0.0
            twist.matrix[i, j] = twist.mass[i, j] if coupled else (1.0 if i == j else 0.0)
        if _is_closed(gears, twist, i):
            twist.matrix[i, i] += 0.5 * h * gears.damping[i] + 0.25 * h * h * gears.stiffness[i]
    invert_kernel(twist.matrix, twist.inverse)


@kernel
def _step(gears, twist, row, share, h):
    """Move the twist `row` on by h s to where `share` of the sample's interval is over."""
    angle, speed, change, right = twist.angle[row], twist.speed[row], twist.change[row], twist.right
    for i in range(3):
        right[i] = 0.0
        if gears.stiffness[i] > 0.0:
            right[i] = twist.force[row, i] + share * (twist.now[row, i] - twist.force[row, i])
        if _is_closed(gears, twist, i):
            rest = twist.flank[i] * gears.half[i] if row == 0 else 0.0
            ahead = angle[i] + h * (speed[i] + 0.25 * h * change[i]) - rest
            right[i] -= gears.stiffness[i] * ahead + gears.damping[i] * (speed[i] + 0.5 * h * change[i])
    for i in range(3):
        found = twist.inverse[i, 0] * right[0] + twist.inverse[i, 1] * right[1] + twist.inverse[i, 2] * right[2]
        angle[i] += h * (speed[i] + 0.25 * h * (change[i] + found))
        speed[i] += 0.5 * h * (change[i] + found)
        change[i] = found


@kernel
def _weigh(gears, twist, mass):
    """twist.mass and twist.motor of `mass` (3, 3) kg m^2, with motors and payload."""
    for i in range(3):
        for j in range(3):
            twist.mass[i, j] = mass[i, j]
    split_kernel(gears, twist)


@kernel
def advance_kernel(gears, twist, mass, load, payload, theta_ddot, carried, elapsed):
    """The twist `elapsed` s on. mass: (3, 3) kg m^2 with motors and payload. load, payload: (3,) N m, N m/kg, of the
    rigid robot at the links' place. theta_ddot: (3,) rad/s^2 of the motors. carried: kg."""
    _weigh(gears, twist, mass)
    for i in range(3):
        geared = gears.stiffness[i] > 0.0
        twist.now[0, i] = twist.motor[i] * theta_ddot[i] - load[i] if geared else 0.0
        twist.now[1, i] = -payload[i] if geared else 0.0
    if twist.started == 0 or elapsed <= 0.0:
        _begin(gears, twist, carried)
        return
    for row in range(2):
        for i in range(3):
            twist.felt[row, i] = -twist.speed[row, i]
    count = max(1, math.ceil(elapsed * SUBSTEPS_PER_SECOND - 1e-6))
    h = elapsed / count
    _prepare(gears, twist, h)
    for n in range(count):
        changed = False
        for i in range(3):
            if gears.half[i] > 0.0:
                changed |= _touch(gears, twist, i, carried)
        if changed:
            _prepare(gears, twist, h)
        for row in range(2):
            _step(gears, twist, row, (n + 1) / count, h)
    apart = False
    for i in range(3):
        twist.swing[i] *= math.exp(-elapsed * gears.damping[i] / twist.mass[i, i])
        for row in range(2):
            twist.force[row, i] = twist.now[row, i]
            mean = (twist.felt[row, i] + twist.speed[row, i]) / elapsed
            twist.felt[row, i] = mean if gears.half[i] > 0.0 else twist.change[row, i]
        apart |= not abs(twist.angle[0, i] + carried * twist.angle[1, i]) < LOST  # also when NaN
    if apart:
        release_kernel(twist)
    else:
        _shake(gears, twist, carried, elapsed)


@kernel
def _shake(gears, twist, carried, elapsed):
    """twist.shaken: what links that fly or strike do to each motor; the sample does not know the moment of a strike."""
    for i in range(3):
        torque = 0.0
        for j in range(3):
            if gears.half[j] > 0.0:
                torque += twist.mass[i, j] * (twist.felt[0, j] + carried * twist.felt[1, j])
        twist.shaken[i] = max(torque * torque, twist.shaken[i] * math.exp(-2.0 * elapsed / STRIKE_TIME))


@kernel
def observe_kernel(gears, twist, residual, payload, sticks, elapsed):
    """Draw the twists of springs after the torque that is measured: a swing that the model gets wrong, as behind a pick
    whose mass is not known yet, would last for as long as the link does.

    residual: (3,) N m, measured less what the robot takes without payload; payload: (3,) N m/kg of it. Both twists are
    drawn alike, so that what a payload does to the residual stays known (Friedland 1969); a steady load is left whole
    in it. The rate is that of the swing itself, which damps what is wrong by half. sticks: (3,) N m that friction of a
    joint at rest takes up as it likes, and which is drawn into the twist as if it were a swing.
    """
    for i in range(3):
        if gears.stiffness[i] > 0.0 and gears.half[i] == 0.0:
            calm = math.exp(-elapsed * math.sqrt(gears.stiffness[i] / twist.mass[i, i]))
            share = (1.0 - calm) / gears.stiffness[i]
            twist.angle[0, i] -= share * residual[i]
            twist.angle[1, i] += share * payload[i]
            twist.swing[i] = max(calm * twist.swing[i], sticks[i] * sticks[i])


@kernel
def lead_kernel(gears, twist, mass, load, payload, theta_ddot, carried, ahead):
    """Fill ahead (3,) rad: how far the motors are before links that are to move on a wanted path, which twist the gears
    by what they take (the inverse dynamics of a flexible joint, Spong 1987, without its damper). mass: (3, 3) kg m^2,
    with motors and payload. load, payload: (3,) N m, N m/kg, of the rigid robot on that path; theta_ddot: (3,) rad/s^2
    of it; carried: kg."""
    _weigh(gears, twist, mass)
    for i in range(3):
        taken = load[i] + carried * payload[i] - twist.motor[i] * theta_ddot[i]
        ahead[i] = taken / gears.stiffness[i] if gears.stiffness[i] > 0.0 else 0.0


@kernel
def begin_swing_kernel(gears, twist, step):
    """Another load, by `step` kg, hangs there since a while: the gears swing as if it had hung there ever since, by as
    much as it pulls. Returns the pace of the slowest swing, rad/s, infinite without any."""
    slowest = math.inf
    for i in range(3):
        twist.swing[i] += (step * twist.force[1, i]) ** 2
        if gears.stiffness[i] > 0.0 and gears.half[i] == 0.0:
            slowest = min(slowest, math.sqrt(gears.stiffness[i] / twist.mass[i, i]))
    return slowest


@kernel
def doubt_kernel(twist, doubt):
    """Add to doubt (3,), (N m)^2: swings that nobody knows, and strikes."""
    for i in range(3):
        doubt[i] += twist.swing[i] + twist.shaken[i]


@kernel
def through_kernel(gears, twist, row, strikes, torque):
    """Add to torque (3,), the rigid robot's, what the twist `row` changes of it at the motors. strikes: also that of
    flanks that strike; no drive is asked for their blow."""
    for j in range(3):
        if strikes or gears.half[j] == 0.0 or twist.flank[j] == 0:
            for i in range(3):
                torque[i] += twist.mass[i, j] * twist.felt[row, j]
