"""The motion that answers a question best: stretches of sines, at rest at both ends, one after the other.

What stretches show adds up, so each is sought in turn, by differential evolution, as the one that adds most to what the
others show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import differential_evolution

from drivers.motion import HOME, REST_AFTER, REST_BEFORE, Planner, Trajectory
from drivers.motion_file import resampled
from schemas.errors import DataError, PoseError
from service.identification.fit import THREADS
from service.planning.question import Question

SHORTEST, LONGEST = 5.0, 15.0  # s
STRETCH = 2.5  # s
HARMONICS = 3
FREQUENCY = (0.2, 1.8)  # Hz of the first; the drives follow what the third asks for
SHARE = (0.03, 1.0)  # of the limits
FARTHEST = 0.7  # of a swing, that its middle may be off
SLOPE = 2.0  # power of the order that harmonics fall with, at most
ROUNDS = 2
MEMBERS, GENERATIONS = 12, 3  # of the population

# A stretch is a point of the unit cube: frequency, share, slope, size of each joint, its middle, its phases.
DIMENSIONS = 3 + 2 * 3 + 3 * HARMONICS


def evaluations(duration: float) -> int:
    """How many stretches `plan` tries, at most."""
    return ROUNDS * _count(duration) * MEMBERS * (GENERATIONS + 1)


def plan(
    planner: Planner,
    question: Question,
    duration: float,
    progress: Callable[[], None] = lambda: None,
    seed: int = 0,
) -> Trajectory:
    """A motion of `duration` s at `PERIOD`, within the limits of `planner`, whose period that is.

    progress: called after each stretch tried.

    Raises:
        DataError: the limits leave no motion.
    """
    limits, home = planner.limits, np.full((1, 3), HOME)
    held = float(np.abs(planner.torque(home, 0 * home, 0 * home)).max())
    if held > limits.torque:
        raise DataError(
            f"a torque limit of {limits.torque:.4g} N m allows no motion: holding the robot needs {held:.4g} N m"
        )
    count = _count(duration)
    length = (duration - REST_BEFORE - REST_AFTER) / count
    best: list[np.ndarray | None] = [None] * count
    shown: list[np.ndarray | float] = [0.0] * count
    for turn in range(ROUNDS):
        for place in range(count):
            others = sum(part for number, part in enumerate(shown) if number != place)

            def cost(point: np.ndarray, others: np.ndarray | float = others) -> float:
                try:
                    return -question.worth(others + question.shown(stretch(planner, point, length)))
                except (DataError, PoseError):
                    return 0.0
                finally:
                    progress()

            rng = np.random.default_rng([seed, turn, place])
            members = rng.random((MEMBERS, DIMENSIONS))
            members[::2, 1] = 1.0 - 0.1 * members[::2, 1]  # every other one as large as it may be, in all joints
            members[::2, 3:6] = 1.0 - 0.4 * members[::2, 3:6]
            if (known := best[place]) is not None:
                members[1] = known
            found = differential_evolution(
                cost, [(0.0, 1.0)] * DIMENSIONS, maxiter=GENERATIONS, tol=0.0, init=members, rng=rng,  # pyright: ignore[reportArgumentType]
                polish=False, updating="deferred", workers=THREADS.map,  # pyright: ignore[reportArgumentType]
            )  # fmt: skip
            best[place] = found.x
            try:
                shown[place] = question.shown(stretch(planner, found.x, length))
            except DataError as error:
                given = f"{limits.speed:.4g} rad/s, {limits.acceleration:.4g} rad/s^2 and {limits.torque:.4g} N m"
                raise DataError(f"limits of {given} allow no motion of {length:.2g} s: {error}") from error
    return joined([stretch(planner, point, length) for point in best if point is not None])


def stretch(planner: Planner, point: np.ndarray, length: float) -> Trajectory:
    """The stretch of `length` s at a point of the unit cube.

    Raises:
        DataError: the limits leave none.
    """
    frequency, share = (low * (high / low) ** u for u, (low, high) in zip(point[:2], (FREQUENCY, SHARE), strict=True))
    size = np.maximum(1.25 * point[3:6] - 0.25, 0.0)  # a fifth of the way a joint stands still
    middle = FARTHEST * (2.0 * point[6:9] - 1.0)
    phase = 2 * math.pi * point[9:].reshape(3, HARMONICS)
    weight = size[:, None] * np.arange(1, HARMONICS + 1) ** (1.0 - SLOPE * point[2])
    if not weight.any():
        raise DataError("no joint moves")
    return planner.swing(length, float(frequency), weight, phase, size * middle, float(share))


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """One after the other, at rest before and after."""
    period = parts[0].period
    before, after = (np.zeros((round(rest / period), 3)) for rest in (REST_BEFORE, REST_AFTER))

    def chain(of: Callable[[Trajectory], np.ndarray], ends: float) -> np.ndarray:
        return np.concatenate([before + ends, *(of(part)[:-1] for part in parts), of(parts[-1])[-1:], after + ends])

    position = chain(lambda part: part.position, HOME)
    velocity = chain(lambda part: part.velocity, 0.0)
    return Trajectory(period, position, velocity, chain(lambda part: part.acceleration, 0.0))


def at_rate(motion: Trajectory, period: float) -> Trajectory:
    """The same motion with instants `period` s apart."""
    instants = np.arange(int(motion.duration / period + 1e-6) + 1) * period
    return resampled(np.arange(len(motion.position)) * motion.period, motion.position, instants, period)


def _count(duration: float) -> int:
    return max(2, round(duration / STRETCH))
