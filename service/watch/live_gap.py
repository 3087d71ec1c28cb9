"""The gap of a stretch of motion in the band: how much by kind of motion, and what the carried effects take away."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from schemas.axes_description import Description
from schemas.errors import PoseError
from schemas.messages import GAP
from service.identification.noise import white_noise
from service.model.description import hypothesis_of
from service.model.hypothesis import Hypothesis
from service.model.mechanism import mechanism_of
from service.model.scene import Recording, Scene
from service.model.signals import LEVER, Band, Segment, resolved_hz
from service.model.torque import predict
from service.watch.level import KINDS, kinds

SHARES = GAP.dtype["share"].shape[0]  # effects whose share is told


@dataclass(frozen=True)
class Stretch:
    """Sums over the rows of a stretch that count. square, count: (KINDS, n), (N m)^2 and rows, by kind of motion.

    energy: sum of squares over all joints; without: (SHARES,) the same without one carried effect, NaN where there is
    none; bare: without any. seconds: (n,) s of motion.
    """

    square: np.ndarray
    count: np.ndarray
    energy: float
    without: np.ndarray
    bare: float
    seconds: np.ndarray

    def __add__(self, other: Stretch) -> Stretch:
        return Stretch(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


class Measure:
    """Measures stretches of `robot` in one band, which is that of the first motion seen. Floor: (n,) N m rms in it."""

    def __init__(self, robot: Description, first: list[Segment]) -> None:
        self._mechanism = mechanism_of(robot)
        self._hypothesis = hypothesis_of(robot)
        self._unit = LEVER if robot.linear else 1.0
        self.period = first[0].period
        self.band = Band.of(self.period, resolved_hz(first))
        told = robot.torque_noise
        noise = white_noise([self._recording(part) for part in first]) if told is None else np.array(told.value)
        self.floor = np.maximum(noise, 1e-6) * self.band.white_share**0.5
        terms = self._hypothesis.terms
        self._fewer = [
            replace(self._hypothesis, terms=tuple(other for other in terms if other is not term))
            for term in terms[:SHARES]
        ]
        self._bare = replace(self._hypothesis, terms=())

    def _recording(self, part: Segment) -> Recording:
        return Recording(part, self._mechanism, 0, "")

    def __call__(self, parts: list[Segment], start: float, stop: float) -> Stretch | None:
        """Rows from `start` to `stop`, s, of the parts of a trace; None: none of them moves, or no pose of the robot.

        What comes before `start` is for filters and for effects with a memory.
        """
        total: Stretch | None = None
        for part in parts:
            rows = part.moving & ((part.time > start) & (part.time <= stop))[:, None]
            if abs(part.period / self.period - 1.0) > 0.1 or not rows.any():
                continue
            try:
                one = self._one(part, rows[:: self.band.step])
            except PoseError:
                continue
            total = one if total is None else total + one
        return total

    def _one(self, part: Segment, rows: np.ndarray) -> Stretch:
        scene = Scene(self._recording(part), self._hypothesis.base)
        every = self.band.step
        which = kinds(part.theta_dot[::every] / self._unit, part.theta_ddot[::every] / self._unit)
        target = self.band(part.torque)

        def left(hypothesis: Hypothesis) -> np.ndarray:
            return np.where(rows, target - self.band(predict(scene, hypothesis)), 0.0) ** 2

        square = left(self._hypothesis)
        sums, count = np.zeros((2, KINDS, rows.shape[1]))
        for joint in range(rows.shape[1]):
            sums[:, joint] = np.bincount(which[:, joint], square[:, joint], KINDS)
            count[:, joint] = np.bincount(which[:, joint], rows[:, joint], KINDS)
        without = np.full(SHARES, np.nan)
        without[: len(self._fewer)] = [left(fewer).sum() for fewer in self._fewer]
        bare = float(left(self._bare).sum()) if self._fewer else float(square.sum())
        seconds = rows.sum(axis=0) * part.period * every
        return Stretch(sums, count, float(square.sum()), without, bare, seconds)
