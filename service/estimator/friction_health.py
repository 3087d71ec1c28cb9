"""What is known of the machine now: how far its friction is from the identified one, and what health says of that."""

from __future__ import annotations

import math

from schemas.kernels import kernel
from schemas.messages import HealthFlag
from service.estimator.departure import BALLS, DRIFT_SPEED, SCALE, SMALLEST_DRIFT, place

_FRICTION, _SCALE = HealthFlag.FRICTION_DRIFT.value, HealthFlag.SCALE_DRIFT.value
_COMMAND, _LEFT_OUT = HealthFlag.COMMAND_REFUTED.value, HealthFlag.EFFECT_LEFT_OUT.value
_LEAST = SMALLEST_DRIFT[0]  # N m, of friction that a share is of


@kernel
def findings_kernel(steps) -> int:
    """Fill friction in `steps` (1,), records of STEP. Returns bits of HealthFlag."""
    settings, state, out = steps[0].settings, steps[0].state, steps[0].friction
    known = state.payload.departure
    flags = _LEFT_OUT if settings.left_out != 0 else 0
    if state.drive_torque.refuted != 0:
        flags |= _COMMAND
    for i in range(3):
        dry, viscous, offset = known.delta[place(i, 0)], known.delta[place(i, 1)], known.delta[place(i, 2)]
        out.coulomb[i], out.viscous[i], out.offset[i] = dry, viscous, offset
        out.scale[i] = known.delta[place(i, SCALE)]
        out.coulomb_std_dev[i], out.viscous_std_dev[i] = _std_dev(known, place(i, 0)), _std_dev(known, place(i, 1))
        out.offset_std_dev[i], out.scale_std_dev[i] = _std_dev(known, place(i, 2)), _std_dev(known, place(i, SCALE))
        # the larger of what friction at one speed and what the offset is off by, over friction there
        whole = settings.coulomb[i] + settings.viscous[i] * DRIFT_SPEED
        out.drift[i] = max(abs(dry + viscous * DRIFT_SPEED), abs(offset)) / max(whole, _LEAST)
        if out.drift[i] > settings.friction_drift:
            flags |= _FRICTION
        if abs(out.scale[i]) > settings.scale_drift:
            flags |= _SCALE
    out.ball_joints = known.delta[place(0, BALLS)]
    out.ball_joints_std_dev = _std_dev(known, place(0, BALLS))
    out.stamp_sec, out.stamp_nanosec, out.sequence = state.stamp_sec, state.stamp_nanosec, state.sequence
    return flags


@kernel
def _std_dev(known, part):
    return math.sqrt(max(known.covariance[part, part], 0.0))
