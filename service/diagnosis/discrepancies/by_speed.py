"""A torque of one joint that depends on its speed."""

from __future__ import annotations

from service.diagnosis.discrepancies.by_angle import WIDTH
from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, features


class BySpeed(Discrepancy):
    """N m over rad/s."""

    over, unit = "speed", "rad/s"

    def process(self, seen: Seen, joint: int) -> Process:
        place = [scene.segment.theta_dot[:, [joint]] for scene in seen.scenes]
        values = [seen.size[joint] * part for part in features(place, WIDTH)]
        return self.on(seen, joint, values, place, values)
