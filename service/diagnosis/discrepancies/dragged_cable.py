"""A cable or hose that the platform drags along: friction against its way, which turns over only after some of it."""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike
from service.model.signals import recursion

WAYS = (0.01, 0.04, 0.15)  # m, over which the force turns over
STEP = 1e-3  # m of the way


class DraggedCable(Discrepancy):
    """N over the direction of the platform's way, across and along the vertical."""

    per_joint = False

    def process(self, seen: Seen, joint: int) -> Process:
        torque = []
        for scene in seen.scenes:
            forces = _against(scene.arms.position)  # (N, 3, K)
            jacobian = scene.arms.jacobian
            flat, up = (np.einsum("naj,nak->njk", jacobian[:, a], forces[:, a]) for a in (slice(2), slice(2, 3)))
            torque.append(np.concatenate([flat, up], axis=2))
        size = float(np.sqrt(np.mean(seen.size**2)))
        return self.at_platform(seen, ([part] for part in alike(torque, size)))


def _against(position: np.ndarray) -> np.ndarray:
    """(N, 3, K): mean direction of the way (N, 3) m before each sample, for each of `WAYS`."""
    steps = np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1)
    way = np.cumsum(steps)
    even = np.arange(0.0, way[-1] + 2 * STEP, STEP)
    along = np.stack([np.interp(even, way, axis) for axis in position.T], axis=1)
    direction = np.gradient(along, STEP, axis=0)
    result = []
    for length in WAYS:
        keep = np.exp(-STEP / length)
        mean = (1.0 - keep) * np.real(recursion(direction, keep))
        result.append(np.stack([np.interp(way, even, axis) for axis in mean.T], axis=1))
    return np.stack(result, axis=2)
