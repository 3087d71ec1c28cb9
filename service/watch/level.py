"""What the gap is expected to be: its mean square by kind of motion, so that a faster motion is no alarm.

A kind of motion is a joint's own speed and the greatest acceleration of any joint, each between two of a ladder of
edges. Motion of a kind that was never seen says nothing about a change: it is learnt, and counted as not known. A kind
that was seen for moments only, as the reversals of a fast motion are, has the level of those next to it.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import convolve1d

SPEED_EDGES = np.geomspace(0.1, 6.4, 7)  # rad/s, or a lever's of linear axes
ACCELERATION_EDGES = np.geomspace(
    1.0, 400.0, 14
)  # rad/s^2, or the same; narrow: what a wrong inertia leaves grows with its square
KINDS = (len(SPEED_EDGES) + 1) * (len(ACCELERATION_EDGES) + 1)
KNOWN_ROWS = 120  # rows of a kind from which its level is known; 0.6 s at the 200 Hz of the analysis band
SEEN_ROWS = 24  # rows of a kind from which its neighbours' level is its own, 0.12 s
NEIGHBOURS = (1, 2)  # steps of acceleration up and down that may stand in, the nearer ones first
FULL_ROWS = 600  # rows after which it is learnt no more


def kinds(theta_dot: np.ndarray, theta_ddot: np.ndarray) -> np.ndarray:
    """(N, n) kind of motion of every row and joint, 0 to KINDS - 1. theta_dot, theta_ddot: (N, n) rad/s, rad/s^2;
    those of linear axes over `LEVER`."""
    speed = np.searchsorted(SPEED_EDGES, np.abs(theta_dot))
    fastest = np.searchsorted(ACCELERATION_EDGES, np.abs(theta_ddot).max(axis=1))
    return speed * (len(ACCELERATION_EDGES) + 1) + fastest[:, None]


class Level:
    """Mean square of the gap, (N m)^2, by kind of motion and joint.

    floor: (n,) N m rms of the noise in the band, below which no level is.
    """

    def __init__(self, floor: np.ndarray) -> None:
        self._floor = floor**2
        self._square = np.zeros((KINDS, len(floor)))
        self._count = np.zeros((KINDS, len(floor)))
        self._settled = np.zeros((KINDS, len(floor)), bool)

    def learn(self, square: np.ndarray, count: np.ndarray) -> None:
        """Take rows of kinds that are not settled. square, count: (KINDS, n) sums over rows."""
        open_ = ~self._settled
        self._square[open_] += square[open_]
        self._count[open_] += count[open_]
        self._settled |= self._count >= FULL_ROWS

    def settle(self) -> None:
        """Learn the kinds that are known well by now no more."""
        self._settled |= self._count >= KNOWN_ROWS

    @property
    def known(self) -> np.ndarray:
        """(KINDS, n) bool."""
        return self._told()[1] >= KNOWN_ROWS

    @property
    def mean_square(self) -> np.ndarray:
        """(KINDS, n) (N m)^2; what is not known is the floor."""
        square, count = self._told()
        own = self._square / np.maximum(self._count, 1.0)  # a wrong inertia leaves more than its slower neighbours say
        mean = np.maximum(square / np.maximum(count, 1.0), own)
        return np.maximum(np.where(count >= KNOWN_ROWS, mean, 0.0), self._floor)

    def _told(self) -> tuple[np.ndarray, np.ndarray]:
        """(KINDS, n) sums over the rows that tell a kind's level: where its own are few, with its neighbours'."""
        square, count = self._square.copy(), self._count.copy()
        for reach in NEIGHBOURS:
            few = (count < KNOWN_ROWS) & (self._count >= SEEN_ROWS)
            for sums, own in ((square, self._square), (count, self._count)):
                sums[few] = _around(own, reach)[few]
        return square, count


def _around(sums: np.ndarray, reach: int) -> np.ndarray:
    """(KINDS, n) sums over the kinds of the same speed whose acceleration is up to `reach` steps away."""
    grid = sums.reshape(len(SPEED_EDGES) + 1, len(ACCELERATION_EDGES) + 1, -1)
    return convolve1d(grid, np.ones(2 * reach + 1), axis=1, mode="constant").reshape(sums.shape)
