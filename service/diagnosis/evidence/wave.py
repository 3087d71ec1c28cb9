"""A pull at the platform that comes again and again along its way: a toothed belt, a rack, a row of magnets.

Such a torque is one line in the spectrum over the platform's place. Friction, masses, lengths have broad spectra there,
and what happens at its own time, or in one place only, has none that stands out; so it can be told while everything
else is still unknown. It lies flat: lines across the vertical are not looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.identification.fit import Problem

PITCHES = (0.025, 0.12)  # m: below the band makes it noise, above it goes by the place as much else does
OVERSAMPLED = 2.0  # grid points over the width of a line
ALONE = 0.5  # of the line, that the next one reaches at most; 0.7 and more where there is none, 0.3 where there is one
SHARE = 0.2  # of what is left above the noise, that the line takes; 0.08 at most where there is none
LATE = (0.0, 0.003)  # s by which the torque may be older than the place; between them it is nearly a mean of theirs
ZOOM = (1.0, 0.25, 0.06)  # widths of a line, about the grid's best, over which it is looked for more closely


@dataclass(frozen=True)
class Wave:
    """wave: (2,) turns a metre along x and y of the platform."""

    wave: np.ndarray

    @property
    def pitch(self) -> float:
        """m."""
        return float(1.0 / np.hypot(*self.wave))

    def fields(self, problem: Problem) -> list[np.ndarray]:
        """(R, 12) a recording: torque of a force along x, y and z that comes again like that, reported late or not."""
        result = []
        for number, recording in enumerate(problem.recordings):
            turn = 2 * np.pi * (recording.arms.position[:, :2] @ self.wave)
            sides = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
            torque = np.swapaxes(recording.arms.jacobian, 1, 2)[..., None] * sides[:, None, None]
            torque = torque.reshape(*torque.shape[:2], -1)
            steps, row = [round(late / recording.segment.period) for late in LATE], np.arange(len(torque))
            late = np.concatenate([torque[np.maximum(row - step, 0)] for step in steps], axis=-1)
            result.append(problem.pick(number, problem.band(late)))
        return result


def wave_of(problem: Problem, residuals: Sequence[np.ndarray]) -> Wave | None:
    """The wave that stands out of (R,) residuals a recording, in units of the noise; None where none does."""
    spectrum = _Spectrum(problem, residuals)
    above = sum(float(r @ r) for r in residuals) - problem.count
    waves, power = spectrum.grid
    best = waves[np.argmax(power)]
    apart = np.minimum(np.hypot(*(waves - best).T), np.hypot(*(waves + best).T))
    if power.max() < SHARE * above or power[apart > 2.0 * spectrum.width].max(initial=0.0) > ALONE * power.max():
        return None
    for reach in ZOOM:
        steps = reach * spectrum.width * np.linspace(-1.0, 1.0, 9)
        around = best + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        best = around[np.argmax(spectrum.power(around))]
    return Wave(best)


class _Spectrum:
    """Of forces at the platform over its place, as far as residuals show them. width: of a line, turns a metre."""

    def __init__(self, problem: Problem, residuals: Sequence[np.ndarray]):
        step, gram = problem.band.step, np.zeros((3, 3))
        place, pull = [], []
        for recording, rows, residual in zip(problem.recordings, problem.rows, residuals, strict=True):
            left = np.zeros(rows.shape)
            left.T[rows.T] = residual
            jacobian = recording.arms.jacobian[::step] / problem.sigma
            pull.append(np.einsum("nai,ni->na", jacobian, left))
            gram += np.einsum("nai,nbi,ni->ab", jacobian, jacobian, rows)
            place.append(recording.arms.position[::step, :2])
        self.place, self.pull = np.concatenate(place), np.concatenate(pull)
        self.inverse, self.width = np.linalg.inv(gram), 1.0 / float(np.ptp(self.place, axis=0).max())

    def power(self, waves: np.ndarray) -> np.ndarray:
        """Squares that forces with each of the waves (G, 2) take."""
        return self._taken(self.pull.T @ np.exp(-2j * np.pi * self.place @ waves.T))

    @cached_property
    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Waves (G, 2) of half the plane (the other half is the same), and the power of each."""
        count = int(OVERSAMPLED / (self.width * PITCHES[0]))
        turns = np.arange(-count, count + 1) * self.width / OVERSAMPLED
        x, y = self.place.T
        across, along = np.exp(-2j * np.pi * np.outer(x, turns)), np.exp(-2j * np.pi * np.outer(y, turns[count:]))
        moments = np.stack([(across.T * force) @ along for force in self.pull.T])
        waves = np.stack(np.meshgrid(turns, turns[count:], indexing="ij"), axis=-1)
        pitch = 1.0 / np.maximum(np.linalg.norm(waves, axis=-1), 1e-9)
        asked = (pitch > PITCHES[0]) & (pitch < PITCHES[1])
        return waves[asked], self._taken(moments[:, asked])

    def _taken(self, moments: np.ndarray) -> np.ndarray:
        return 2.0 * np.einsum("ag,ab,bg->g", moments.conj(), self.inverse, moments).real
