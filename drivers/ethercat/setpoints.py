"""What a master commands, cycle by cycle: from where the robot stands to a motion's start, then the motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from schemas.errors import BusError

if TYPE_CHECKING:
    from drivers.motion import Trajectory

APPROACH_SPEED = 0.8  # rad/s, fastest joint
SHORTEST_APPROACH = 0.5  # s
SETTLE = 0.2  # s to stand still before the motion and after it


@dataclass(frozen=True)
class Setpoints:
    """N cycles: joint position, velocity, acceleration, each (N, 3) in rad, rad/s, rad/s^2; grip: (N,) bool, whether
    the gripper holds; begin: the cycle at which the motion itself begins."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    grip: np.ndarray
    begin: int

    def __len__(self) -> int:
        return len(self.position)


class Answer(NamedTuple):
    """What is fed forward in a cycle: torque (3,) N m, and how far motors go before the links' planned positions where
    gears yield, (3,) rad."""

    torque: np.ndarray
    position_offset: np.ndarray


class SetpointPlan:
    """A motion between two pauses, with room before it for the way from where the drives hold to its start.

    Made before they are in operation: copying an hour of motion takes longer than their watchdogs wait.
    """

    def __init__(self, motion: Trajectory, joint_range: list[float]) -> None:
        """joint_range: rad, lower and upper end; the way is at most as far."""
        period = motion.period
        pause, self._room = round(SETTLE / period), _cycles(joint_range[1] - joint_range[0], period)
        self._pause, self._goal, self._period = pause, motion.position[0], period
        start, end = self._room + pause, self._room + pause + len(motion.position)
        self._position, self._velocity, self._acceleration = (np.zeros((end + pause, 3)) for _ in range(3))
        self._position[:start], self._position[end:] = motion.position[0], motion.position[-1]
        self._position[start:end], self._velocity[start:end] = motion.position, motion.velocity
        self._acceleration[start:end] = motion.acceleration
        self._grip = np.zeros(end + pause, bool)
        for payload in motion.payloads:
            self._grip[start + round(payload.pick / period) : start + round(payload.release / period)] = True

    def __len__(self) -> int:
        """Cycles at most."""
        return len(self._grip)

    def begin(self, start: np.ndarray) -> Setpoints:
        """From rest at joint angles `start` (3,) rad; good until the next call.

        Raises:
            BusError: they are further from the motion than the joint range is wide.
        """
        approach = _approach(start, self._goal, self._period)
        first = self._room - len(approach[0])
        if first < 0:
            at = ", ".join(f"{angle:.4g}" for angle in start)
            raise BusError(f"joints at {at} rad: further from the motion's start than geometry.joint_range_rad is wide")
        for whole, way in zip((self._position, self._velocity, self._acceleration), approach, strict=True):
            whole[first : self._room] = way
        return Setpoints(
            self._position[first:],
            self._velocity[first:],
            self._acceleration[first:],
            self._grip[first:],
            len(approach[0]) + self._pause,
        )


def _cycles(distance: float, period: float) -> int:
    return math.ceil(max(SHORTEST_APPROACH, 1.875 * distance / APPROACH_SPEED) / period)


def _approach(start: np.ndarray, goal: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fifth-order polynomial, at rest at both ends (1.875 is its peak speed over its mean speed)."""
    distance = goal - start
    count = _cycles(float(np.abs(distance).max()), period)
    s = (np.arange(1, count + 1) / count)[:, None]
    rate = 1 / (count * period)
    return (
        start + distance * s**3 * (10 - 15 * s + 6 * s**2),
        distance * 30 * s**2 * (1 - s) ** 2 * rate,
        distance * 60 * s * (1 - s) * (1 - 2 * s) * rate**2,
    )
