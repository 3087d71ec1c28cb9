"""A force on the platform that repeats along a horizontal direction: a toothed belt, a rack, a row of magnets.

Its direction and pitch are those of the largest line in the spectrum of the residual over the platform's position.
"""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike

PITCHES = (0.025, 0.12)  # m: less is outside the band at usual speeds, more is smooth, as what depends on the position
OVERSAMPLED = 2.0  # grid points over the width of a line
ZOOM = (1.0, 0.25, 0.06)  # widths of a line to either side, in which it is searched in more detail


class ToothedBelt(Discrepancy):
    """N over turns along the way."""

    per_joint, code = False, "comes_again"

    def process(self, seen: Seen, joint: int) -> Process:
        wave = _Spectrum.of(seen).line()
        torque = []
        for scene in seen.scenes:
            turn = 2.0 * np.pi * scene.arms.position[:, :2] @ wave
            sides = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
            levers = np.swapaxes(scene.arms.jacobian, 1, 2)
            torque.append((levers[..., None] * sides[:, None, None]).reshape(*levers.shape[:2], -1))
        size = float(np.sqrt(np.mean(seen.size**2)))
        return self.at_platform(seen, ([part] for part in alike(torque, size)), pitch=float(1.0 / np.hypot(*wave)))


class _Spectrum:
    """Of forces on the platform over its position, as far as a residual shows them. place: (N, 2) m. pull: (N, 3)
    residual as a force. gram: (3, 3) products of the levers. width: of a line, turns a metre."""

    def __init__(self, place: np.ndarray, pull: np.ndarray, gram: np.ndarray):
        self.place, self.pull, self.inverse = place, pull, np.linalg.inv(gram)
        self.width = 1.0 / float(np.ptp(place, axis=0).max())

    @classmethod
    def of(cls, seen: Seen) -> _Spectrum:
        """Of what the model leaves."""
        problem, place, pull, gram = seen.problem, [], [], np.zeros((3, 3))
        for number, (scene, torque) in enumerate(zip(seen.scenes, seen.torque, strict=True)):
            rows = problem.rows[number]
            left = np.where(rows, (problem.target[number] - problem.band(torque)) / problem.sigma, 0.0)
            levers = scene.arms.jacobian[:: problem.band.step] / problem.sigma  # m, (M, component, joint)
            place.append(scene.arms.position[:: problem.band.step, :2])
            pull.append(np.einsum("mai,mi->ma", levers, left))
            gram += np.einsum("mai,mbi,mi->ab", levers, levers, rows)
        return cls(np.concatenate(place), np.concatenate(pull), gram)

    def line(self) -> np.ndarray:
        """(2,) turns a metre along x and y of the force that explains most."""
        best = self._of_grid()
        for reach in ZOOM:
            steps = reach * self.width * np.linspace(-1.0, 1.0, 9)
            near = best + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
            best = near[np.argmax(self._explained(self.pull.T @ np.exp(-2j * np.pi * self.place @ near.T)))]
        return best

    def _of_grid(self) -> np.ndarray:
        """The same among those of half the plane: the others are the same again."""
        count = int(OVERSAMPLED / (self.width * PITCHES[0]))
        turns = np.arange(-count, count + 1) * self.width / OVERSAMPLED
        across, along = (
            np.exp(-2j * np.pi * np.outer(axis, mine))
            for axis, mine in zip(self.place.T, (turns, turns[count:]), strict=True)
        )
        moments = np.stack([(across.T * force) @ along for force in self.pull.T])
        waves = np.stack(np.meshgrid(turns, turns[count:], indexing="ij"), axis=-1)
        pitch = 1.0 / np.maximum(np.linalg.norm(waves, axis=-1), 1e-9)
        asked = (pitch > PITCHES[0]) & (pitch < PITCHES[1])
        return waves[asked][np.argmax(self._explained(moments[:, asked]))]

    def _explained(self, moments: np.ndarray) -> np.ndarray:
        """(G,) squares, of complex (3, G)."""
        return np.einsum("ag,ab,bg->g", moments.conj(), self.inverse, moments).real
