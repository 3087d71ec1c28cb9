"""A mass that hangs on the platform or carries the base by a spring: a sloshing load, a soft frame. The torque answers
the platform's acceleration with an oscillation."""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike
from service.model.signals import recursion

NATURAL_HZ = tuple(np.geomspace(1.5, 16.0, 12).tolist())  # of springs that may be there, each near the next
DAMPING = 0.1  # of critical


class HangingMass(Discrepancy):
    """N over the history of the platform's acceleration, across and along the vertical."""

    per_joint = False

    def process(self, seen: Seen, joint: int) -> Process:
        torque = []
        for scene in seen.scenes:
            arms, period = scene.arms, scene.segment.period
            forces = _springs(np.gradient(arms.velocity, period, axis=0), period)  # (N, 3, K)
            flat, up = (np.einsum("naj,nak->njk", arms.jacobian[:, a], forces[:, a]) for a in (slice(2), slice(2, 3)))
            torque.append(np.concatenate([flat, up], axis=2))
        size = float(np.sqrt(np.mean(seen.size**2)))
        return self.at_platform(seen, ([part] for part in alike(torque, size)))


def _springs(acceleration: np.ndarray, period: float) -> np.ndarray:
    """(N, 3, K): force of a mass of 1 on its spring, and that over a quarter of a turn, for each natural frequency.
    acceleration: (N, 3) of where the spring is fixed."""
    result = []
    for hertz in NATURAL_HZ:
        turn = 2.0 * np.pi * hertz
        pole = np.exp(turn * period * (-DAMPING + 1j * np.sqrt(1.0 - DAMPING**2)))
        swing = turn * period * recursion(acceleration, pole)
        result += [np.real(swing), np.imag(swing)]
    return np.stack(result, axis=2)
