"""Is the reported torque the commanded one, but for a sensor's white noise?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from schemas.trace import Trace
from service.model.effects.base import Readout
from service.model.signals import usable

BLOCK = 20  # samples, over which white noise averages and a drive that does something else does not
LEAST_BLOCKS = 50
SIGMAS = 5.0  # of the scatter of so many blocks' squares


def is_commanded(trace: Trace, reported: Callable[[np.ndarray], np.ndarray] = lambda torque: torque) -> bool:
    """Whether every joint's torque departs from what is `reported` of its command, (N, 3) N m of as many, by nothing
    but noise without memory.

    Of white noise the mean square of a block's sum, a sample, is half that of the difference of neighbours. A torque
    that is its command to the last digit was not measured, and says nothing.
    """
    if trace.torque_command is None:
        return False
    departure = _departure(trace, reported)
    blocks = len(departure) // BLOCK
    if blocks < LEAST_BLOCKS or not np.isfinite(departure).all():
        return False
    white = 0.5 * np.square(np.diff(departure, axis=0)).mean(axis=0)
    lasting = np.square(departure[: blocks * BLOCK].reshape(blocks, BLOCK, -1).sum(axis=1)).mean(axis=0) / BLOCK
    return bool((white > 0.0).all() and (lasting < (1.0 + SIGMAS * np.sqrt(2.0 / blocks)) * white).all())


def command_ahead(traces: Sequence[Trace], readout: Readout) -> float | None:
    """s by which the commanded torque is ahead of the reported one, if it is that and white noise behind the filter of
    `readout`; None if not. Looked for within a sample of `readout.late`, for positions may be late themselves."""
    if readout.follows > 0.0 or any(trace.torque_command is None for trace in traces):
        return None
    from scipy.optimize import minimize_scalar  # takes a while to import, for few logs

    def reported(late: float, trace: Trace) -> Callable[[np.ndarray], np.ndarray]:
        return partial(replace(readout, late=late).report, period=trace.period)

    def square(late: float) -> float:
        return sum(float(np.square(_departure(one, reported(late, one))).sum()) for one in traces)

    widest = max(trace.period for trace in traces)
    found: Any = minimize_scalar(square, bounds=(readout.late - widest, readout.late + widest), method="bounded")
    ahead = float(found.x)
    return ahead if all(is_commanded(one, reported(ahead, one)) for one in traces) else None


def _departure(trace: Trace, reported: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    assert trace.torque_command is not None
    return (trace.torque - reported(trace.torque_command))[usable(trace)]
