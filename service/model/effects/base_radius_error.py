"""A joint's axis is nearer to the centre, or farther from it, than described.

Physics: base radius less platform radius is what the closed chain knows.
Implementation: as in `geometry`.
Limitations: base and platform radius are not told apart, neither here nor in any torque.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class BaseRadiusError(GeometryError):
    error: Amplitude = Amplitude("m", "true minus described base radius, less that of the platform radius")
    name = "base_radius_error"
    title = "Base or platform radius differs from the description"
    means = (
        "Measure at this arm how far the joint's axis is from the base's centre and the ball joints' from the "
        "platform's (torque shows the difference of the two alone), and correct the description."
    )
    part = "radius"
    share_of = "passive_length"
    beyond_together = 0.05
    beyond = 0.1
    settles = "fast moves to all sides of the workspace"
