r"""A forearm's true length differs from the description.

Physics: $$T = \tau(l_2 + e) - \tau(l_2)$$ The platform is elsewhere and its path is tilted, which every joint feels.
$\tau$ is the torque of the rigid-body model.
Implementation: the torque of the rigid-body model with a slightly changed geometry, to second order in $e$; the two
slopes are computed once per log. The forearm's mass stays the same.
Limitations: the same error on all arms is mostly a different height of the platform.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class ForearmLengthError(GeometryError):
    error: Amplitude = Amplitude("m", "true minus described length")
    name = "forearm_length_error"
    title = "A forearm's length differs from the description"
    means = "Measure this forearm between the centres of its ball joints and correct the description."
    part = "forearm"
    share_of = "passive_length"
    beyond_together = 0.05
    beyond = 0.1
    settles = "fast moves to all sides of the workspace"
