"""What a master commands, cycle by cycle: from where the robot stands to a motion's start, then the motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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


def setpoints(start: np.ndarray, motion: Trajectory) -> Setpoints:
    """From rest at joint angles `start` (3,) rad through `motion`, with a pause before and after it."""
    period = motion.period
    approach = _approach(start, motion.position[0], period)
    pause = round(SETTLE / period)
    begin = len(approach[0]) + pause
    still = np.zeros((pause, 3))
    ends = motion.position[0] + still, motion.position[-1] + still
    grip = np.zeros(begin + len(motion.position) + pause, bool)
    for payload in motion.payloads:
        grip[begin + round(payload.pick / period) : begin + round(payload.release / period)] = True
    return Setpoints(
        np.concatenate((approach[0], ends[0], motion.position, ends[1])),
        np.concatenate((approach[1], still, motion.velocity, still)),
        np.concatenate((approach[2], still, motion.acceleration, still)),
        grip,
        begin,
    )


def _approach(start: np.ndarray, goal: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fifth-order polynomial, at rest at both ends (1.875 is its peak speed over its mean speed)."""
    distance = goal - start
    duration = max(SHORTEST_APPROACH, 1.875 * float(np.abs(distance).max()) / APPROACH_SPEED)
    count = math.ceil(duration / period)
    s = (np.arange(1, count + 1) / count)[:, None]
    rate = 1 / (count * period)
    return (
        start + distance * s**3 * (10 - 15 * s + 6 * s**2),
        distance * 30 * s**2 * (1 - s) ** 2 * rate,
        distance * 60 * s * (1 - s) * (1 - 2 * s) * rate**2,
    )
