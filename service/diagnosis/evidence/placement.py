"""Whether what an effect takes goes as well with joints of a serial arm a little elsewhere than its URDF has them."""

from __future__ import annotations

import numpy as np

from service.diagnosis.fit.selection import Scored
from service.identification.fit import Problem, within
from service.identification.folds import Split, normal_equations
from service.model.mechanism import SerialArm

# One standard deviation that a joint of a URDF is off by: castings and tools of another series, rounded drawings.
OFF_M, OFF_RAD = 0.02, 0.02


class Placement:
    """Torque (R, 6 n) a recording, in units of the noise, of each joint's place one standard deviation off."""

    def __init__(self, problem: Problem, split: Split, model: Scored):
        self.split, self.columns = split, []
        unit = np.tile(np.repeat([OFF_M, OFF_RAD], 3), len(problem.sigma))
        for number, recording in enumerate(problem.recordings):
            arm, segment = recording.mechanism, recording.segment
            assert isinstance(arm, SerialArm)
            torque = arm.misplaced(segment.theta, segment.theta_dot, segment.theta_ddot, model.hypothesis.base.rigid)
            self.columns.append(problem.select(number, problem.band(torque * unit)))

    def beside(self, model: Scored, joint: int | None = None) -> float:
        """Squared residual of `model` on data left out, the place of `joint` or of all joints left open."""
        fitted, split = model.fitted, self.split
        asked = slice(None) if joint is None else slice(6 * joint, 6 * joint + 6)
        columns = [each[:, asked] for each in self.columns]
        tangents = [np.concatenate(parts, axis=1) for parts in zip(fitted.moving, columns, strict=True)]
        grams, moments = normal_equations(tangents, fitted.residuals, split)
        own, places = fitted.moving[0].shape[1], columns[0].shape[1]
        prior = np.diag(np.repeat([0.0, 1.0], [own, places]))
        far = np.full(places, np.inf)  # the slopes of the model's own parameters hold within reach
        low, high = (
            np.concatenate([reach[fitted.free], far * side]) for reach, side in zip(fitted.reach, (-1, 1), strict=True)
        )
        gram, moment = np.asarray(sum(grams)) + prior, np.asarray(sum(moments))
        loss = 0.0
        for number in range(split.folds):
            step = within(gram - grams[number], moment - moments[number], low, high)
            for residual, slope, fold in zip(fitted.residuals, tangents, split.fold, strict=True):
                loss += float(((residual - slope @ step)[fold == number] ** 2).sum())
        return loss
