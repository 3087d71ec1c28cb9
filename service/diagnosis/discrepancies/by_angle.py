"""A torque of one joint that depends on its angle: a cable, a stop, a counterbalance."""

from __future__ import annotations

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, features

WIDTH = 0.05  # of the range of an angle or a speed, over which a torque varies


class ByAngle(Discrepancy):
    """N m over rad."""

    over, unit = "angle", "rad"

    def process(self, seen: Seen, joint: int) -> Process:
        place = [scene.segment.theta[:, [joint]] for scene in seen.scenes]
        values = [seen.size[joint] * part for part in features(place, WIDTH)]
        return self.on(seen, joint, values, place, values)
