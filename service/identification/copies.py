"""Is a log given twice? A copy, whole or in part, is no second measurement: held out, it is not held out.

Asked of files that a user gives. A stretch of the bus may repeat: a log is played round and round.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from schemas.errors import DataError
from schemas.trace import Trace

PLACES = 25  # of a log that are looked for in another
LENGTH = 50  # samples there: noise does not repeat over as many
MOST = 0.5  # of the places, found again


def refuse_copies(traces: Sequence[Trace]) -> None:
    """
    Raises:
        DataError: half of a log or more is in another one, naming both.
    """
    for (first, rows), (second, others) in combinations(zip(traces, map(_rows, traces), strict=True), 2):
        if _are_copies(rows, others):
            raise DataError(f"{second.path}: the same motion and torque as {first.path}; give it only once")


def distinct(traces: Sequence[Trace]) -> list[Trace]:
    """Without those that `refuse_copies` refuses beside an earlier one."""
    kept: list[tuple[Trace, np.ndarray]] = []
    for trace in traces:
        rows = _rows(trace)
        if not any(_are_copies(before, rows) for _, before in kept):
            kept.append((trace, rows))
    return [trace for trace, _ in kept]


def _rows(trace: Trace) -> np.ndarray:
    return np.concatenate([trace.position, trace.torque], axis=1)


def _are_copies(one: np.ndarray, other: np.ndarray) -> bool:
    short, long = sorted((one, other), key=len)
    return _found_again(short, long) > MOST


def _found_again(part: np.ndarray, whole: np.ndarray) -> float:
    """Share of places of `part` (N, k), in motion, that are in `whole` (M, k), value for value."""
    if len(part) < LENGTH or part.shape[1] != whole.shape[1]:
        return 0.0
    places = np.linspace(0, len(part) - LENGTH, PLACES).astype(int)
    moving = [place for place in places if np.ptp(part[place : place + LENGTH], axis=0).all()]
    found = [_occurs(part[place : place + LENGTH], whole) for place in moving]
    return float(np.mean(found)) if found else 0.0


def _occurs(piece: np.ndarray, whole: np.ndarray) -> bool:
    begins = np.flatnonzero(whole[: len(whole) - len(piece) + 1, 0] == piece[0, 0])
    for row in range(1, len(piece)):
        if not len(begins):
            return False
        begins = begins[(whole[begins + row] == piece[row]).all(axis=1)]
    return len(begins) > 0
