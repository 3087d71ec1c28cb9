"""A torque constant of one joint that is another in each log and changes evenly as the log goes on: a warm motor."""

from __future__ import annotations

import numpy as np

from service.diagnosis.discrepancies.discrepancy import Discrepancy, Process, Seen, alike


class DriftingScale(Discrepancy):
    """Share of the torque over s, in each log with values of its own."""

    code, advice = "by_scale", "log_warm"

    def process(self, seen: Seen, joint: int) -> Process:
        logs = np.unique(seen.problem.logs)
        parts = []
        for log, torque in zip(seen.problem.logs, seen.torque, strict=True):
            along = torque[:, [joint]] * np.stack([np.ones(len(torque)), np.linspace(-1.0, 1.0, len(torque))], axis=1)
            parts.append(np.concatenate([along * (log == one) for one in logs], axis=1))
        return self.on(seen, joint, alike(parts, seen.size[joint]))
