"""What a load off the fourth axis does to the joints while that axis turns.

A mass m whose centre lies d = (d_1, d_2) off the axis, in a frame that turns with it, is accelerated there by
R(psi) (psi_ddot S - psi_dot^2) d more than the platform, S a quarter turn. So m d adds to the joint torques what the
two columns here are per kg m. psi_dot and psi_ddot are those of a parabola through the angles around the instant.
"""

from __future__ import annotations

import math

from schemas.kernels import kernel
from service.estimator.kalman import MAX_LAG

LINE = 2 * MAX_LAG + 1  # samples


@kernel
def turn_kernel(state, angle, gap):
    """Take the angle of the newest cycle, rad, NaN where it is not known, `gap` cycles after the one before."""
    if not math.isfinite(angle):
        state.turn_known = 0
        return
    if gap != 1:
        state.turn_known = 0
    state.turn_head = (state.turn_head + 1) % LINE
    step = 0.0
    if state.turn_known > 0:
        step = angle - state.turn_read
        step -= 2.0 * math.pi * round(step / (2.0 * math.pi))  # drives count within one turn
        state.turn[state.turn_head] = state.turn[state.turn_head - 1] + step
    else:
        state.turn[state.turn_head] = angle
    state.turn_read = angle
    state.turn_known = min(state.turn_known + 1, LINE)


@kernel
def swing_kernel(settings, state, loads):
    """loads[:, 1:] (3, 2): N m per kg m on each joint, `lag` cycles ago, zero where the angle is not known all around.

    state.pose: of that cycle, as the terms kernel leaves it.
    """
    column, lever, lag = state.pose.column, state.pose.lever, settings.motion.lag
    loads[:, 1:] = 0.0
    if state.turn_known < 2 * lag + 1:
        return
    mean = lag * (lag + 1) / 3.0
    slope = bow = spread = squares = 0.0
    middle = state.turn[state.turn_head - lag]
    for k in range(-lag, lag + 1):
        angle = state.turn[state.turn_head - lag + k] - middle
        bend = k * k - mean
        slope += k * angle
        bow += bend * angle
        squares += k * k
        spread += bend * bend
    rate = slope / (squares * settings.period)
    growth = 2.0 * bow / (spread * settings.period * settings.period)
    cosine, sine = math.cos(middle), math.sin(middle)
    for k in range(2):
        x, y = (cosine, sine) if k == 0 else (-sine, cosine)  # R e_k
        push_x, push_y = -growth * y - rate * rate * x, growth * x - rate * rate * y
        for i in range(3):
            loads[i, k + 1] = settings.scale[i] * lever[i] * (column[i, 0] * push_x + column[i, 1] * push_y)
