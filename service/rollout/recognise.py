"""Is a log of the robot that a description was made on? By the torque that it left when it was identified."""

from __future__ import annotations

import numpy as np

from schemas.robot import Robot
from service.model.description import hypothesis_of
from service.model.mechanism import Delta
from service.model.scene import Recording
from service.model.signals import Band, resolved_hz
from service.model.torque import predict
from service.rollout.gap import Cuts, rms


def over_identified(robot: Robot, cuts: Cuts) -> np.ndarray | None:
    """(3,) rms of the torque that `robot` does not explain in logs, in the analysis band, moving and empty, over what
    it left of the logs that it was identified on; NaN: the joint never does. None: the description does not say.

    With something on the platform the error of its mass would count as well.

    Raises:
        RobotError: an effect that is not known. PoseError: a pose out of reach.
    """
    found = robot.identified
    if found is None or found.torque_noise_nm is None or found.model_error_nm is None:
        return None
    hypothesis = hypothesis_of(robot)
    band = Band.of(cuts.period, resolved_hz([cut.segment for _, cut in cuts.parts]))
    left: list[list[np.ndarray]] = [[], [], []]
    for trace, cut in cuts.parts:
        segment = cut.segment
        scene = hypothesis.seen(Recording(segment, Delta.of(robot), 0, trace.name))
        off = band(segment.torque - predict(scene, hypothesis))
        counts = segment.moving & (cut.mass == 0.0)[:, None]
        for joint, rows in enumerate(counts[:: band.step].T):
            left[joint].append(off[rows, joint])
    usual = np.hypot(np.array(found.torque_noise_nm.value) * band.white_share**0.5, found.model_error_nm.value)
    return np.array([rms(np.concatenate(parts)) for parts in left]) / np.maximum(usual, 1e-6)
