"""What an effect is: a dataclass of quantities with units, and the torque it adds.

Amplitudes enter the torque linearly and are found by least squares; shapes do not and are searched. An effect on single
joints has its own amplitudes a joint and shares its shapes; any other has one set for the whole robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from service.model.scene import Scene


@dataclass(frozen=True)
class Amplitude:
    """A quantity that the torque is proportional to. unit: SI. meaning: for the report."""

    unit: str
    meaning: str


@dataclass(frozen=True)
class Shape:
    """A quantity that is searched: tried at `grid`, refined between `low` and `high`, kept if `fixed`."""

    unit: str
    meaning: str
    grid: tuple[float, ...]
    low: float
    high: float
    fixed: bool = False


@dataclass(frozen=True)
class Effect(ABC):
    """One unmodelled effect. Fields of a subclass are its quantities, in the order of the documents.

    name: as in the catalogue. per_joint: sits on single joints. own_joint: adds torque to no other joint than its own.
    measured: alters the reported torque instead of adding to it. rough: its torque is no smooth function of its shapes,
    so they are kept when a part of the data is left out. own_shapes: each joint may have shapes of its own. kinds:
    mechanisms it makes sense for. settles: the motion that tells it from what it resembles.
    """

    name: ClassVar[str]
    per_joint: ClassVar[bool] = True
    own_joint: ClassVar[bool] = True
    measured: ClassVar[bool] = False
    rough: ClassVar[bool] = False
    own_shapes: ClassVar[bool] = False
    kinds: ClassVar[frozenset[str]] = frozenset({"delta", "axes"})
    settles: ClassVar[str]

    @property
    def amplitudes(self) -> dict[str, Amplitude]:
        """Linear quantities, name -> description."""
        return {f.name: f.default for f in fields(self) if isinstance(f.default, Amplitude)}

    @property
    def shapes(self) -> dict[str, Shape]:
        """Searched quantities, name -> description."""
        return {f.name: f.default for f in fields(self) if isinstance(f.default, Shape)}

    @abstractmethod
    def regressors(self, scene: Scene, joint: int, shape: tuple[float, ...]) -> np.ndarray:
        """Torque per unit of each amplitude at the operating point of `scene`.

        joint: from 0; ignored unless `per_joint`. Returns (N, k) on that joint where `own_joint`, else (N, n, k). Where
        an effect has no amplitude: its whole torque, k = 1.
        """

    def grid(self, scene: Scene) -> list[tuple[float, ...]]:
        """Shapes to try first."""
        import itertools

        return list(itertools.product(*(shape.grid for shape in self.shapes.values())))

    def starts(self, shape: tuple[float, ...]) -> list[tuple[float, ...]]:
        """Where the fit of the shapes starts; more than one where its neighbourhood is rough."""
        return [shape]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
        """Torque (N, n) N m that the effect adds; exact where `regressors` is a linearisation."""
        columns = self.regressors(scene, joint, shape)
        torque = columns @ amplitude if self.amplitudes else columns[..., 0]
        return on_joint(torque, joint, scene.joints) if self.own_joint else torque

    def report(self, scene: Scene, joint: int, torque: np.ndarray, amplitude: np.ndarray, shape: tuple[float, ...]):
        """What is reported of a true joint torque (..., n); only where `measured`."""
        raise NotImplementedError


def geometric(low: float, high: float, count: int) -> tuple[float, ...]:
    """A grid of equal ratios."""
    return tuple(float(value) for value in np.geomspace(low, high, count))


def on_joint(values: np.ndarray, joint: int, joints: int) -> np.ndarray:
    """(N, ...) on one joint of (N, n, ...)."""
    result = np.zeros((len(values), joints, *values.shape[1:]))
    result[:, joint] = values
    return result
