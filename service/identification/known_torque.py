"""Whether a log's torque is that of the robot that a description has identified: refused where it is not.

A fit cannot separate a log in another unit from another robot, as its masses are free; an identified model can.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from schemas.errors import DataError
from schemas.robot import Robot
from schemas.trace import Trace
from schemas.units import SHARES, TORQUE_SCALES
from schemas.words import percent
from service.identification.checks import (
    BETTER,
    HOPELESS,
    LEAST_TIMES,
    ORDERS,
    SIGNS,
    SUSPECT,
    misread,
)
from service.identification.folds import BLOCK
from service.model.dynamics import PAYLOAD, torque_terms
from service.model.nominal import pack
from service.model.prediction import Motion, error_in_band


def refuse_unlike(robot: Robot, trace: Trace, along: Motion, model: np.ndarray) -> None:
    """See that `trace` has the torque that `robot`, with any payload that it may carry, needs for its motion.

    Args:
        robot: As identified.
        trace: The log.
        along: Its smoothed motion.
        model: (N, 3) N m that the robot needs for that without a payload, by its fullest model.

    Raises:
        DataError: its torque fits in another order, with another sign or in another unit, or not at all.
    """
    grams = _grams(robot, trace, along, model)
    if not len(grams):
        return
    most = robot.limits.max_payload_kg
    given = _left(grams, ORDERS[0], SIGNS[0], 1.0, most)
    if given < SUSPECT:
        return
    options = product(ORDERS, SIGNS, (1.0, *_scales(robot.drive.gear_ratio)))
    best, order, signs, scale = min((_left(grams, *option, most), *option) for option in options)
    if best <= BETTER * given:
        faults = _faults(order, signs, scale)
        raise DataError(f"{trace.path}: {faults}: corrected, the model leaves {percent(best)} of it unexplained")
    if given > HOPELESS:
        raise DataError(
            f"{trace.path}: the model of {robot.name} leaves {percent(min(given, 1.0))} of its torque unexplained, "
            "whatever the payload: is it a log of another robot, or in another unit?"
        )


def _scales(gear_ratio: float) -> list[float]:
    """What a torque may be off by in its unit or the side of its gear."""
    times = {*TORQUE_SCALES.values(), SHARES["permille"] / SHARES["percent"], gear_ratio}
    return sorted({one for time in times for one in (time, 1 / time) if max(one, 1 / one) >= LEAST_TIMES})


def _grams(robot: Robot, trace: Trace, along: Motion, model: np.ndarray) -> np.ndarray:
    """(W, 3, 5, 5) products of the three torques with what joint j needs without a payload and for a kilogram, over
    windows of `BLOCK` in which all joints move, over which a payload is taken for one."""
    per_kg = torque_terms(pack(robot), along.theta, along.theta_dot, along.theta_ddot)[:, PAYLOAD]
    torque = error_in_band(trace, along, np.zeros_like(model))
    needed, load = (torque - error_in_band(trace, along, values) for values in (model, per_kg))
    rows = np.flatnonzero(np.isfinite(torque + needed + load).all(axis=1))
    windows = np.array_split(rows, max(1, round(len(rows) * trace.period / BLOCK))) if len(rows) else []
    columns = np.stack([np.column_stack([torque, needed[:, j], load[:, j]]) for j in range(3)])
    return np.array([np.einsum("jni,jnk->jik", columns[:, mine], columns[:, mine]) for mine in windows])


def _left(
    grams: np.ndarray, order: tuple[int, ...], signs: tuple[float, ...], scale: float, most: float
) -> float:  # fmt: skip
    """Share of the torque's rms, read like this, that the model leaves with the best payload of up to `most` kg in each
    window."""
    left = square = np.zeros(len(grams))
    along = against = np.zeros(len(grams))
    for joint in range(3):
        reading, without, load = np.zeros((3, 5))
        reading[order[joint]], without[3], load[4] = scale * signs[joint], 1.0, 1.0
        rest = reading - without
        gram = grams[:, joint]
        left, square = left + rest @ (gram @ rest).T, square + reading @ (gram @ reading).T
        along, against = along + load @ (gram @ rest).T, against + load @ (gram @ load).T
    mass = np.clip(along / np.maximum(against, 1e-12), 0.0, most)
    left = left - 2 * mass * along + mass**2 * against
    return float(np.sqrt(max(left.sum(), 0.0) / max(square.sum(), 1e-12)))


def _faults(order: tuple[int, ...], signs: tuple[float, ...], scale: float) -> str:
    faults = misread(order, signs)
    if scale != 1.0:
        faults.append(f"the torque is {1 / scale:.3g} times what it should be: wrong unit, or side of the gear")
    return " and ".join(faults)
