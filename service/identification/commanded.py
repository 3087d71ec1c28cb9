"""Is the reported torque the commanded one, but for a sensor's white noise?"""

from __future__ import annotations

import numpy as np

from schemas.trace import Trace
from service.model.signals import usable

BLOCK = 20  # samples, over which white noise averages and a drive that does something else does not
LEAST_BLOCKS = 50
SIGMAS = 5.0  # of the scatter of so many blocks' squares


def is_commanded(trace: Trace) -> bool:
    """Whether every joint's torque departs from its command by nothing but noise without memory.

    Of white noise the mean square of a block's sum, a sample, is half that of the difference of neighbours. A torque
    that is its command to the last digit was not measured, and says nothing.
    """
    if trace.torque_command is None:
        return False
    departure = (trace.torque - trace.torque_command)[usable(trace)]
    blocks = len(departure) // BLOCK
    if blocks < LEAST_BLOCKS or not np.isfinite(departure).all():
        return False
    white = 0.5 * np.square(np.diff(departure, axis=0)).mean(axis=0)
    lasting = np.square(departure[: blocks * BLOCK].reshape(blocks, BLOCK, -1).sum(axis=1)).mean(axis=0) / BLOCK
    return bool((white > 0.0).all() and (lasting < (1.0 + SIGMAS * np.sqrt(2.0 / blocks)) * white).all())
