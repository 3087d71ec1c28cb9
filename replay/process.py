"""Process replay: a trace through the estimator with no bus and no clock, as fast as it goes, to the same bits."""

from __future__ import annotations

import numpy as np

from schemas.robot import Robot
from service.estimator.estimator import Estimator, Result, rate_of


def process(robot: Robot, samples: np.ndarray) -> Result:
    """What the estimator node answers to `samples` ((N,) records of SAMPLE), period read from the stamps as there.

    Raises:
        DataError: the stamps do not rise.
    """
    return Estimator(robot, *rate_of(samples)).run(samples)
