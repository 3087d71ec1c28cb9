"""What a run is to answer, and how well a motion would answer it.

What a motion shows is held as Gram matrices of its torque's slopes in the analysis band, in units of the noise: those
of runs, and of parts of a run, add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Protocol

import numpy as np

from drivers.motion import Trajectory
from schemas.diagnosis import placed
from schemas.errors import DataError
from schemas.robot import EffectEntry, Robot
from service.estimator.bounds import bounds_of
from service.identification.fit import within
from service.model.description import base_of, torque_along
from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import Mechanism, mechanism_of
from service.model.parameters import Parameters, base_parameters
from service.model.scene import Base, Recording, Scene
from service.model.signals import ANALYSIS_HZ, EDGE, Band, Segment, moving
from service.model.torque import tangent

PERIOD = 1e-3  # s, at which motions are weighed
SPARSE = 2  # samples of which one is looked at while a motion is sought
SHARPEST = 1e-4  # rad/s over which friction turns where the description has a jump: a jump has no slope
TOLD = 3.0  # standard errors from which two are told apart


class Question(Protocol):
    """Something that a run can answer."""

    def shown(self, motion: Trajectory, whole: bool = False) -> np.ndarray:
        """What a motion at `PERIOD` shows, to be added up. whole: as a log of its own, whose ends do not count."""
        ...

    def worth(self, shown: np.ndarray) -> float:
        """How well it is answered by what all motions together show."""
        ...


@dataclass(frozen=True)
class Pair:
    """Two rivals, in words, and by how many standard errors of the torque's noise they differ after a run."""

    one: str
    other: str
    errors: float

    @property
    def told(self) -> bool:
        """Whether the run is expected to tell them apart."""
        return self.errors >= TOLD


@dataclass(frozen=True)
class View:
    """How runs are looked at. sigma: (3,) N m, noise of the torque in the band. sparse: the band of every `SPARSE`-th
    sample. peak: N m that the drives give."""

    mechanism: Mechanism
    base: Base
    band: Band
    sparse: Band
    sigma: np.ndarray
    peak: float

    @classmethod
    def of(cls, robot: Robot, sigma: np.ndarray, cutoff_hz: float = ANALYSIS_HZ) -> View:
        """By the base model that a description carries."""
        band, sparse = Band.of(PERIOD, cutoff_hz), Band.of(SPARSE * PERIOD, cutoff_hz)
        base = base_of(robot)
        base = replace(base, transition=np.maximum(base.transition, SHARPEST))
        return cls(mechanism_of(robot), base, band, sparse, sigma, bounds_of(robot).peak_nm)

    def scene(self, motion: Trajectory, whole: bool) -> tuple[Scene, Band]:
        """A motion as effects see it: `whole`, or every `SPARSE`-th sample."""
        band = self.band if whole else self.sparse
        position, velocity, acceleration = (
            np.ascontiguousarray(values[:: 1 if whole else SPARSE])
            for values in (motion.position, motion.velocity, motion.acceleration)
        )
        counts = moving(position, band.period)
        if whole:
            edge = round(EDGE / PERIOD)
            counts[:edge] = counts[-edge:] = False
        rows = np.arange(len(position))
        still = np.zeros(position.shape)
        segment = Segment(rows, rows * band.period, band.period, position, velocity, acceleration, still, counts)
        return Scene(Recording(segment, self.mechanism, 0, "plan"), self.base), band

    def rows(self, scene: Scene, band: Band, values: np.ndarray) -> np.ndarray:
        """(R, ...) of (M, 3, ...) in the band where joints move, so scaled that noise has a mean square of 1 for each
        row that is worth one: the band keeps more rows than the noise in it is free."""
        free = min(1.0, band.white_share * band.step) ** 0.5
        scaled = values * (free / self.sigma).reshape(1, -1, *([1] * (values.ndim - 2)))
        return scaled[scene.segment.moving[:: band.step]]


class Apart:
    """Which of several models is true?

    Of each two, the expected torque of the one is held against the other, refitted with all of its parameters: what
    stays, over the noise, is how far they differ.
    """

    def __init__(self, view: View, rivals: Sequence[tuple[Term, ...]]) -> None:
        self.view = view
        self.rivals = [Hypothesis(view.base).carrying(terms) for terms in rivals]
        self.reach = [Parameters(one).reach(view.mechanism, PERIOD) for one in self.rivals]
        self.pairs = [
            (one, other) for one, other in permutations(range(len(rivals)), 2) if not _same(rivals[one], rivals[other])
        ]

    def shown(self, motion: Trajectory, whole: bool = False) -> np.ndarray:
        """(pairs, F + 1, F + 1): slopes of the one that is refitted and, last, the difference; filled up with zeros.

        Raises:
            DataError: a rival asks for more torque than the drives give: what production shows of it in slow motion may
                grow out of all bounds in a fast one.
        """
        (scene, band), found = self.view.scene(motion, whole), []
        for hypothesis in self.rivals:  # their bases differ in timing alone, which a scene does not have
            prediction, slopes = tangent(scene, hypothesis, band)
            if (most := float(np.abs(prediction).max())) > self.view.peak:
                raise DataError(f"{_in_words(hypothesis)} needs {most:.4g} N m, the drives give {self.view.peak:.4g}")
            found.append((self.view.rows(scene, band, prediction), self.view.rows(scene, band, slopes)))
        grams = [slopes.T @ slopes for _, slopes in found]
        size = max(len(gram) for gram in grams) + 1
        result = np.zeros((len(self.pairs), size, size))
        for number, (one, other) in enumerate(self.pairs):
            difference, slopes = found[one][0] - found[other][0], found[other][1]
            count = slopes.shape[1]
            result[number, :count, :count] = grams[other]
            result[number, :count, -1] = result[number, -1, :count] = slopes.T @ difference
            result[number, -1, -1] = difference @ difference
        return result

    def squares(self, shown: np.ndarray) -> np.ndarray:
        """(pairs,) squared difference after the refit, each parameter within its limits and its slope's reach."""
        result = np.empty(len(self.pairs))
        for number, (_, other) in enumerate(self.pairs):
            low, high = self.reach[other]
            count = len(low)
            own, moment = shown[number, :count, :count], shown[number, :count, -1]
            step = within(own, moment, low, high)
            result[number] = shown[number, -1, -1] - 2 * step @ moment + step @ own @ step
        return np.maximum(result, 0.0)

    def worth(self, shown: np.ndarray) -> float:
        """More for each pair, less so the farther it is apart already."""
        return float(np.mean(np.log1p(self.squares(shown) / TOLD**2)))

    def learned(self, shown: np.ndarray) -> list[Pair]:
        """Each two, the worse way round, the least apart first."""
        errors = dict(zip(self.pairs, np.sqrt(self.squares(shown)).tolist(), strict=True))
        found = [
            Pair(_in_words(self.rivals[one]), _in_words(self.rivals[other]), min(value, errors[other, one]))
            for (one, other), value in errors.items()
            if one < other
        ]
        return sorted(found, key=lambda pair: pair.errors)


class Figures:
    """Which base parameters has the robot?"""

    def __init__(self, view: View) -> None:
        self.view = view
        self.known = base_parameters(view.mechanism)
        self.hypothesis = Hypothesis(view.base, timed=False)

    def shown(self, motion: Trajectory, whole: bool = False) -> np.ndarray:
        """(P, P) of the parameters that the torque is linear in."""
        scene, band = self.view.scene(motion, whole)
        slopes = self.view.rows(scene, band, tangent(scene, self.hypothesis, band)[1])[:, : len(self.known)]
        return slopes.T @ slopes

    def worth(self, shown: np.ndarray) -> float:
        """Log det of the information, each parameter known to one of its SI unit before."""
        return float(np.linalg.slogdet(shown + np.eye(len(shown)))[1])

    def learned(self, shown: np.ndarray) -> dict[str, tuple[float, str]]:
        """Name -> standard error by the torque's noise, unit."""
        errors = np.sqrt(np.diag(np.linalg.inv(shown + np.eye(len(shown)))))
        return {known.name: (float(error), known.unit) for known, error in zip(self.known, errors, strict=True)}


def expected(robot: Robot, effects: Sequence[EffectEntry], motion: Trajectory) -> np.ndarray:
    """Torque (N + 1, 3) N m that `robot` with `effects` is expected to take."""
    time = np.arange(len(motion.position)) * motion.period
    carrying = robot.model_copy(update={"effect": list(effects)})
    return torque_along(carrying, time, motion.position, motion.velocity, motion.acceleration)


def _same(one: tuple[Term, ...], other: tuple[Term, ...]) -> bool:
    """Whether no motion tells them apart."""
    first, second = one[-1].effect, other[-1].effect
    return second.name in first.same or first.name in second.same


def _in_words(hypothesis: Hypothesis) -> str:
    term = hypothesis.terms[-1]
    return placed(term.effect.name, [joint + 1 for joint in term.joints])
