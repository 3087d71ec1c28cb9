r"""An active link's true length differs from the description.

Physics: $$T = \tau(l_1 + e) - \tau(l_1)$$ The platform is elsewhere, and levers and inertia change, which every joint
feels. $\tau$ is the torque of the rigid-body model.
Implementation: the torque of the rigid-body model with a slightly changed geometry, to second order in $e$; the two
slopes are computed once per log. The link's mass stays the same.
Limitations: the same error on all arms is largely absorbed by $\rho_1$ and $\rho_2$.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class LinkLengthError(GeometryError):
    error: Amplitude = Amplitude("m", "true minus described length")
    name = "link_length_error"
    title = "An arm's length differs from the description"
    means = "Measure this arm between its axes and correct the description."
    part = "length"
    share_of = "active_length"
    beyond_together = 0.05
    beyond = 0.2
    settles = "fast moves to all sides of the workspace"
