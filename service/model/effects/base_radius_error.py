r"""A joint's axis is nearer to the centre, or farther from it, than described.

Physics: $$T = \tau(r + e) - \tau(r)$$ The closed chain depends on $r$, base radius minus platform radius, only. $\tau$
is the torque of the rigid-body model.
Implementation: the torque of the rigid-body model with a slightly changed geometry, to second order in $e$; the two
slopes are computed once per log.
Limitations: no torque separates base radius and platform radius.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class BaseRadiusError(GeometryError):
    error: Amplitude = Amplitude("m", "true minus described value of base radius minus platform radius")
    name = "base_radius_error"
    title = "Base or platform radius differs from the description"
    means = (
        "Measure at this arm the distance of the joint's axis from the centre of the base, and of the ball joints from "
        "the centre of the platform (torque shows only the difference of the two). Correct the description."
    )
    part = "radius"
    share_of = "passive_length"
    beyond_together = 0.05
    beyond = 0.1
    settles = "fast moves to all sides of the workspace"
