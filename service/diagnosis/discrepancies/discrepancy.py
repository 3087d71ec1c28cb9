"""What a discrepancy is: a torque that no effect of the catalogue adds, as a Gaussian process over something that the
logs know. One file each, and one line in the registry.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from schemas.diagnosis import Advice, CautionCode
from service.identification.fit import Problem
from service.model.hypothesis import Hypothesis
from service.model.scene import Scene
from service.model.torque import predict

Over = Literal["angle", "friction_at_angle", "speed", "platform"]

APART = 1.25  # widths between the points that carry a process: less adds columns and no detail
FAR = 1.5  # widths from any motion, from which such a point is left out


@dataclass(frozen=True)
class Seen:
    """What discrepancies read of the logs. scenes: a recording each. torque: (N, n) N m a recording, as the model
    expects it. size: (n,) N m, rms of each joint's residual above the noise, which a process has a priori."""

    problem: Problem
    scenes: list[Scene]
    torque: list[np.ndarray]
    size: np.ndarray

    @classmethod
    def of(cls, problem: Problem, hypothesis: Hypothesis, size: np.ndarray) -> Seen:
        """By this model."""
        scenes = problem.scenes(hypothesis)
        return cls(problem, scenes, [predict(scene, hypothesis) for scene in scenes], size)


@dataclass(frozen=True)
class Process:
    """A discrepancy on these logs. joint: from 0; None of one that acts at the platform. columns: (R, K) a recording,
    of one on a joint only the rows of that, torque in the band, in units of the noise, for weights of standard
    deviation 1. place: (M, d) a recording, SI, that it depends on; values: (M, K') a recording, of a weight of 1: N m
    of the joint, or N of each component of a force. Both empty where there is no place to tell. pitch: m of the
    platform's path, after which it repeats."""

    discrepancy: Discrepancy
    joint: int | None
    columns: list[np.ndarray]
    place: Sequence[np.ndarray] = ()
    values: Sequence[np.ndarray] = ()
    pitch: float | None = None


class Discrepancy(ABC):
    """A family of torques. over, unit: as the document says what it depends on; None where it is not told. per_joint:
    each joint has one of its own; else it acts at the platform of a Delta. code, advice: of the caution that says it is
    at work; None where none does.
    """

    over: ClassVar[Over | None] = None
    unit: ClassVar[str] = ""
    per_joint: ClassVar[bool] = True
    code: ClassVar[CautionCode | None] = None
    advice: ClassVar[Advice] = "look_there"

    @abstractmethod
    def process(self, seen: Seen, joint: int) -> Process:
        """On these logs, of `joint`."""

    def on(self, seen: Seen, joint: int, torque: Iterable[np.ndarray], place: Sequence[np.ndarray] = (),
           values: Sequence[np.ndarray] = ()) -> Process:  # fmt: skip
        """The process of (N, K) N m a recording on one joint."""
        problem = seen.problem
        columns = [_single(problem.of_joint(n, joint, problem.band(t))) for n, t in enumerate(torque)]
        return Process(self, joint, columns, _thinned(problem, place), _thinned(problem, values))

    def at_platform(self, seen: Seen, torque: Iterable[Iterable[np.ndarray]], place: Sequence[np.ndarray] = (),
                    values: Sequence[np.ndarray] = (), pitch: float | None = None) -> Process:  # fmt: skip
        """The process of (N, n, K) N m a recording, in parts that are large and kept one at a time."""
        problem = seen.problem
        columns = [
            np.concatenate([_single(problem.select(number, problem.band(part))) for part in parts], axis=1)
            for number, parts in enumerate(torque)
        ]
        return Process(self, None, columns, _thinned(problem, place), _thinned(problem, values), pitch)


def _thinned(problem: Problem, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Every sample of (N, ...) a recording that the band keeps."""
    return [part[:: problem.band.step].copy() for part in parts]


def _single(rows: np.ndarray) -> np.ndarray:
    """In single precision: columns are most of the memory of a diagnosis."""
    return rows.astype(np.float32)


def alike(parts: Sequence[np.ndarray], size: float) -> Iterator[np.ndarray]:
    """Columns (N, K) or (N, n, K) a recording so large that together, with weights of standard deviation 1, they have
    an rms of `size`."""
    square = sum(float(np.sum(part**2)) for part in parts) / sum(part[..., 0].size for part in parts)
    return (part * (size / max(square, 1e-300) ** 0.5) for part in parts)


def features(place: Sequence[np.ndarray], width: float) -> list[np.ndarray]:
    """(N, K) a recording, whose products with themselves are the squared-exponential covariance of a process over place
    (N, d). width: length over which it varies, of the largest range.

    Source: Williams, Seeger: Using the Nyström method to speed up kernel machines, 2001.
    """
    every = np.concatenate(place)
    low, ways = every.min(axis=0), np.ptp(every, axis=0)
    unit = width * max(float(ways.max()), 1e-9)
    axes = [np.linspace(0.0, way / unit, math.ceil(way / unit / APART) + 1) for way in ways]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(ways))
    visited = np.unique(np.round(2.0 * (every - low) / unit), axis=0) / 2.0
    carriers = grid[((grid[:, None] - visited[None]) ** 2).sum(axis=2).min(axis=1) < FAR**2]
    value, vector = np.linalg.eigh(_covariance(carriers, carriers))
    root = vector / np.sqrt(np.maximum(value, 1e-6 * value[-1]))
    return [_covariance((part - low) / unit, carriers) @ root for part in place]


def _covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N, K) of places (N, d) and (K, d) in widths."""
    square = sum((mine[:, None] - theirs) ** 2 for mine, theirs in zip(one.T, other.T, strict=True))
    return np.exp(-0.5 * np.asarray(square))
