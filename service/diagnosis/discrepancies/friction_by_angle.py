"""Friction of one joint that depends on its angle: a rough place in the gear."""

from __future__ import annotations

from service.diagnosis.discrepancies.by_angle import WIDTH
from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, features


class FrictionByAngle(Discrepancy):
    """N m against the motion, over rad."""

    over, unit = "friction_at_angle", "rad"

    def process(self, seen: Seen, joint: int) -> Process:
        place = [scene.segment.theta[:, [joint]] for scene in seen.scenes]
        values = [seen.size[joint] * part for part in features(place, WIDTH)]
        acting = [v * scene.direction[:, [joint]] for v, scene in zip(values, seen.scenes, strict=True)]
        return self.on(seen, joint, acting, place, values)
