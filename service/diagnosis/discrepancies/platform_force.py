"""A force on the platform that depends on its position: a hose, a magnet, a jet of air."""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, features

PARTS = 8  # in which columns are filtered: all at once take several times the memory of what is kept
WIDTH = 0.15  # of the platform's range, over which a force varies


class PlatformForce(Discrepancy):
    """N over m."""

    over, unit, per_joint, code = "platform", "m", False, "by_place"

    def process(self, seen: Seen, joint: int) -> Process:
        place = [scene.arms.position for scene in seen.scenes]
        levers = [-np.swapaxes(scene.arms.jacobian, 1, 2) for scene in seen.scenes]  # m, (N, joint, component)
        lever = float(np.sqrt(3.0 * np.mean(np.concatenate(levers) ** 2)))
        size = float(np.sqrt(np.mean(seen.size**2))) / lever
        values = [size * part for part in features(place, WIDTH)]
        torque = (
            (
                one[:, :, [component]] * some[:, None]
                for component in range(3)
                for some in np.array_split(part, PARTS, axis=1)
            )
            for one, part in zip(levers, values, strict=True)
        )
        return self.at_platform(seen, torque, place, values)
