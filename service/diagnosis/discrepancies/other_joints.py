"""A torque of one joint that is a share of the others': crossed sensors, a coupling between the gears."""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike


class OtherJoints(Discrepancy):
    """N m over N m of each other joint."""

    def process(self, seen: Seen, joint: int) -> Process:
        others = [np.delete(torque, joint, axis=1) for torque in seen.torque]
        return self.on(seen, joint, alike(others, seen.size[joint]))
