"""What effects between motor and link have in common: the link is simulated behind the recorded motion."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from service.model.effects.base import Effect, Inside
from service.model.scene import Scene
from service.model.two_masses import two_masses


class Transmission(Effect):
    """Motor and link of a joint, each a mass. No amplitude: the torque follows from the nonlinear parameters."""

    own_joint = False
    rough = True

    @staticmethod
    @abstractmethod
    def figures(nonlinear: tuple[float, ...]) -> tuple[float, float, float, float]:
        """As of `two_masses`."""

    def regressors(self, scene: Scene, joint: int, nonlinear: tuple[float, ...]) -> np.ndarray:
        """(N, n, 1)."""
        return self.columns(scene, joint, [nonlinear])

    def columns(self, scene: Scene, joint: int, points: Sequence[tuple[float, ...]]) -> np.ndarray:
        """(N, n, P), simulated together."""
        return two_masses(scene, joint, [self.figures(point) for point in points])

    def torques(
        self, scene: Scene, joint: int, amplitude: np.ndarray, points: Sequence[tuple[float, ...]]
    ) -> np.ndarray:
        """(N, n, P), simulated together."""
        return self.columns(scene, joint, points)

    def put_inside(self, inside: Inside, joint: int, amplitude: np.ndarray, nonlinear: tuple[float, ...]) -> None:
        """The link and what is between; of play and a spring in one joint the softer has the other's gap."""
        own = self.figures(nonlinear)
        other = inside.two_masses.get(joint, own)
        _, natural_hz, damping_ratio, motor_share = min(own, other, key=lambda figures: figures[1])
        inside.two_masses[joint] = max(own[0], other[0]), natural_hz, damping_ratio, motor_share
