"""How far a mass is off for what is not known of the effects in a description: by their standard errors."""

from __future__ import annotations

import numpy as np

from schemas.robot import EffectEntry, Robot
from service.estimator.left_out import swing
from service.model.description import torque_along
from service.model.dynamics import PAYLOAD, torque_terms
from service.model.nominal import pack

WEIGHED = 0.15  # s of motion, over which a torque is taken for a mass


def mass_error(robot: Robot) -> float:
    """Standard deviation, kg, of a mass that `robot` weighs, for the standard errors of its effects' parameters.

    Each parameter is put off by its standard error, and the torque that this makes along a motion amid the workspace is
    weighed as a load would be. The parameters count as independent, so what they share counts more than once.

    Raises:
        RobotError: an effect that is not known, or not described in full.
    """
    shaken = [other for k in range(len(robot.effect)) for other in _shaken(robot, k)]
    if not shaken:
        return 0.0
    motion = swing()
    path = motion.theta, motion.theta_dot, motion.theta_ddot
    load = torque_terms(pack(robot), *path)[:, PAYLOAD]
    expected = torque_along(robot, motion.time, *path)
    rows = max(1, round(WEIGHED / motion.period))
    square = 0.0
    for other in shaken:
        off = torque_along(other, motion.time, *path) - expected
        along, own = (_summed(load * torque, rows) for torque in (off, load))
        square += float(np.mean((along / own) ** 2))
    return square**0.5


def _shaken(robot: Robot, place: int) -> list[Robot]:
    """`robot` once for each parameter of the effect at `place` that has a standard error, off by that."""
    entry, found = robot.effect[place], []
    for name, parameter in entry.parameters.items():
        if parameter.std_error > 0.0:
            off = parameter.model_copy(update={"value": parameter.value + parameter.std_error})
            changed = EffectEntry(name=entry.name, joints=entry.joints, parameters={**entry.parameters, name: off})
            effects = [*robot.effect[:place], changed, *robot.effect[place + 1 :]]
            found.append(robot.model_copy(update={"effect": effects}))
    return found


def _summed(torque: np.ndarray, rows: int) -> np.ndarray:
    """Sums over all joints and each `rows` rows of (N, 3)."""
    whole = len(torque) // rows * rows
    return torque[:whole].sum(axis=1).reshape(-1, rows).sum(axis=1)
