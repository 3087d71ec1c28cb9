"""A forearm's true length differs from the description.

Physics: the platform is elsewhere and tilts its path; every joint feels it.
Implementation: as in `geometry`; the forearm's mass stays.
Limitations: the same on all arms is mostly another height of the platform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError
from service.model.mechanism import Delta, Mechanism


@dataclass(frozen=True)
class ForearmLengthError(GeometryError):
    error: Amplitude = Amplitude("m", "true minus described length")
    name = "forearm_length_error"
    title = "A forearm's length differs from the description"
    means = "Measure this forearm between the centres of its ball joints and correct the description."
    part = "forearm"
    beyond_together = 0.05
    beyond = 0.1
    settles = "fast moves to all sides of the workspace"

    def size(self, mechanism: Mechanism, amplitude: np.ndarray) -> float:
        """Share of the forearm's length."""
        assert isinstance(mechanism, Delta)
        return float(np.abs(amplitude).max(initial=0.0) / mechanism.model.passive_length[0])
