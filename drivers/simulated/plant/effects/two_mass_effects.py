"""Effects between motor and link: both become masses of their own, the encoder stays on the motor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from drivers.simulated.plant.effects.plant_effect import JointEffect, Size
from drivers.simulated.plant.mujoco_delta import Design

# Stiffness of a gear whose play is the point; its teeth bend some 0.5 mrad at 20 N m.
TOOTH_STIFFNESS = 4e4  # N m/rad
TOOTH_DAMPING_RATIO = 0.15


@dataclass
class JointElasticity(JointEffect):
    """Compliance of gear and coupling: spring and damper between rotor and link."""

    stiffness_nmprad: Annotated[list[float], Size(1500.0, 4000.0, "one", grows=-1)]  # 0: stiff
    damping_ratio: Annotated[float, Size(0.03, 0.10, grows=0)]

    def shape(self, design: Design) -> Design:
        return design.soften(self.stiffness_nmprad, self.damping_ratio)


@dataclass
class Backlash(JointEffect):
    """Lost motion: rotor and link touch only at the two ends of a gap, through teeth that are stiff but not rigid."""

    half_gap_rad: Annotated[list[float], Size(0.001, 0.0025, "one")]

    def shape(self, design: Design) -> Design:
        stiff = [TOOTH_STIFFNESS if gap else 0.0 for gap in self.half_gap_rad]
        return design.soften(stiff, TOOTH_DAMPING_RATIO).loosen(self.half_gap_rad)
