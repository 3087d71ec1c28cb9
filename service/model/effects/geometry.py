"""What the errors of an arm's geometry have in common.

The rigid-body model is evaluated with the arm a little otherwise; its first and second slope, computed once a log, are
the effect's torque. Millimetres and hundredths of a radian are small beside the arms: what is left out is the square of
their share, some ten-thousandths of the effect.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from service.model.effects.base import Effect
from service.model.mechanism import Mechanism
from service.model.nominal import Correction
from service.model.scene import Scene


class GeometryError(Effect):
    """part: of `Correction`, true minus described; the effect's one amplitude. share_of: length of the model that
    `beyond` is a share of; empty where it is the amplitude itself."""

    part: ClassVar[str]
    share_of: ClassVar[str] = ""
    own_joint = False
    kinds = frozenset({"delta"})

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        first, _ = scene.by_geometry(self.part, joint)
        return first[..., None]

    def slopes(self, scene: Scene, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3, 1)."""
        first, second = scene.by_geometry(self.part, joint)
        return (first + amplitude[0] * second)[..., None]

    def torque(self, scene: Scene, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, 3), to second order."""
        first, second = scene.by_geometry(self.part, joint)
        return amplitude[0] * (first + 0.5 * amplitude[0] * second)

    def correct(self, correction: Correction, joint: int, amplitude: np.ndarray) -> None:
        """The arm as it is."""
        getattr(correction, self.part)[joint] += amplitude[0]

    def size(self, mechanism: Mechanism, amplitude: np.ndarray) -> float:
        """Share of the length that it is measured by."""
        largest = super().size(mechanism, amplitude)
        if not self.share_of:
            return largest
        assert mechanism.platform is not None
        return largest / float(getattr(mechanism.platform.model, self.share_of)[0])
