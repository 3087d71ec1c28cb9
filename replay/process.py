"""Process replay: a trace through the estimator with no bus and no clock, as fast as it goes, to the same bits."""

from __future__ import annotations

import numpy as np

from schemas.axes_description import Description
from service.estimator.estimator import Result, rate_of
from service.estimator.online import estimator_of


def process(robot: Description, samples: np.ndarray) -> Result:
    """What the estimator node answers to `samples` ((N,) records of SAMPLE, or JOINT_SAMPLE), period read from the
    stamps as there.

    Raises:
        DataError: the stamps do not rise. Others as `estimator_of`.
    """
    return estimator_of(robot, *rate_of(samples)).run(samples)
