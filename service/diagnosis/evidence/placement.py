"""Whether what an effect takes goes as well with joints of a serial arm a little elsewhere than its URDF has them."""

from __future__ import annotations

import numpy as np

from service.diagnosis.fit.selection import Scored
from service.diagnosis.fit.wide import Wide
from service.identification.fit import Problem
from service.identification.folds import Split

# One standard deviation that a joint of a URDF is off by: castings and tools of another series, rounded drawings.
OFF_M, OFF_RAD = 0.02, 0.02


class Placement:
    """Torque (R, 6 n) a recording, in units of the noise, of each joint's place one standard deviation off."""

    def __init__(self, problem: Problem, split: Split, model: Scored):
        self.split, self.columns = split, []
        unit = np.tile(np.repeat([OFF_M, OFF_RAD], 3), len(problem.sigma))
        for number, recording in enumerate(problem.recordings):
            tree, segment = recording.mechanism.tree, recording.segment
            assert tree is not None
            torque = tree.misplaced(segment.theta, segment.theta_dot, segment.theta_ddot, model.hypothesis.base.rigid)
            self.columns.append(problem.select(number, problem.band(torque * unit)))

    def beside(self, model: Scored, joint: int | None = None) -> float:
        """Squared residual of `model` on data left out, the place of `joint` or of all joints left open."""
        asked = slice(None) if joint is None else slice(6 * joint, 6 * joint + 6)
        left = Wide.of(model.fitted, [each[:, asked] for each in self.columns], 1.0).held_out(self.split)
        return sum(float(residual @ residual) for residual in left)
