"""A torque of one joint that depends on its torque: a torque constant that saturates."""

from __future__ import annotations

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, features

WIDTH = 0.1  # of the range of the torque, over which what is added varies


class ByLoad(Discrepancy):
    """N m over N m."""

    def process(self, seen: Seen, joint: int) -> Process:
        parts = features([torque[:, [joint]] for torque in seen.torque], WIDTH)
        return self.on(seen, joint, [seen.size[joint] * part for part in parts])
