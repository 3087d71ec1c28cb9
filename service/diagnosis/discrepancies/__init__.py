"""Discrepancies: torques that no effect of the catalogue adds. One file and one line here each."""

from service.diagnosis.discrepancies.by_angle import ByAngle
from service.diagnosis.discrepancies.by_load import ByLoad
from service.diagnosis.discrepancies.by_speed import BySpeed
from service.diagnosis.discrepancies.discrepancy import Discrepancy
from service.diagnosis.discrepancies.dragged_cable import DraggedCable
from service.diagnosis.discrepancies.drifting_scale import DriftingScale
from service.diagnosis.discrepancies.friction_by_angle import FrictionByAngle
from service.diagnosis.discrepancies.hanging_mass import HangingMass
from service.diagnosis.discrepancies.other_joints import OtherJoints
from service.diagnosis.discrepancies.platform_force import PlatformForce
from service.diagnosis.discrepancies.toothed_belt import ToothedBelt

DISCREPANCIES: tuple[Discrepancy, ...] = (
    PlatformForce(), HangingMass(), DraggedCable(), ByAngle(), FrictionByAngle(), BySpeed(), ByLoad(), DriftingScale(),
    OtherJoints(), ToothedBelt(),
)  # fmt: skip
