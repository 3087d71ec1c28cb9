r"""An arm is mounted at another azimuth than described.

Physics: $$T = \tau(\alpha + e) - \tau(\alpha)$$ The plane of the arm is turned by $e$ about the axis of the base, at
base and platform alike. $\tau$ is the torque of the rigid-body model.
Implementation: the torque of the rigid-body model with a slightly changed geometry, to second order in $e$; the two
slopes are computed once per log.
Limitations: if all arms are turned by the same angle, the whole base is turned; no torque shows that if gravity is
along the axis.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class AzimuthError(GeometryError):
    error: Amplitude = Amplitude("rad", "true minus described azimuth")
    name = "azimuth_error"
    title = "An arm is mounted at a different angle round the base"
    means = "Measure the angles between the arms round the base's axis and correct the description."
    part = "azimuth"
    beyond_together = 0.1
    beyond = 0.3
    settles = "fast moves to all sides of the workspace"
