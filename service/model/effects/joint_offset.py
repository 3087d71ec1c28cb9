r"""Homing error of a joint's zero.

Physics: $$T = \tau(\theta + e) - \tau(\theta)$$ The true angle is the measured one plus a constant $e$. $\tau$ is the
torque of the rigid-body model.
Implementation: the torque of the rigid-body model with a slightly changed geometry, to second order in $e$; the two
slopes are computed once per log.
Limitations: mostly a shift of this joint's gravity torque; over few angles it mimics a spring or an offset.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.model.effects.base import Amplitude
from service.model.effects.geometry import GeometryError


@dataclass(frozen=True)
class JointOffset(GeometryError):
    error: Amplitude = Amplitude("rad", "true minus measured angle")
    name = "joint_offset"
    title = "The joint's zero is wrong"
    means = "Home this joint again against its mark or gauge and enter the new zero."
    part = "offset"
    beyond_together = 0.05
    beyond = 0.3
    settles = "slow sweeps over the whole workspace and fast moves"
