"""Linear least squares small enough to check by hand: hypotheses that are nothing but columns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from tests.service.subject import Fit, Scored, Split, selection
from tests.service.world import stub


@cache
def named(name: str) -> Any:
    """An effect that is nothing but a name, the same each time."""
    return type("Named", (), {"name": name})()


def split_of(recordings: int, rows: int, blocks: int) -> Split:
    """A fold a recording, each in `blocks` blocks."""
    fold = [np.full(rows, number) for number in range(recordings)]
    block = [number * blocks + np.arange(rows) * blocks // rows for number in range(recordings)]
    return Split(fold, block, recordings, recordings * blocks)


def scored(columns: Sequence[np.ndarray], target: Sequence[np.ndarray], split: Split, *names: str) -> Scored:
    """The fit of `columns` (R, P) a recording to `target` (R,), with the effects it is called after."""
    whole, wanted = np.concatenate(columns), np.concatenate(target)
    best = np.linalg.lstsq(whole, wanted, rcond=None)[0]
    residuals = [values - part @ best for part, values in zip(columns, target, strict=True)]
    every = np.ones(whole.shape[1], bool)
    terms = tuple(stub(effect=stub(name=name), joints=(0,)) for name in names)
    far = np.full(whole.shape[1], np.inf)
    fitted = Fit(stub(terms=terms), residuals, list(columns), every, every, (-far, far))  # pyright: ignore[reportArgumentType]
    return selection.score(fitted, split)


def left_out(
    columns: Sequence[np.ndarray], target: Sequence[np.ndarray], out: Sequence[int] = (), positive: int = 0
) -> list[np.ndarray]:
    """Residuals of each recording under the fit to all others but it and `out`. positive: last columns of which a
    weight cannot be below zero."""
    result = []
    for mine in range(len(columns)):
        others = [k for k in range(len(columns)) if k != mine and k not in out]
        whole, wanted = np.concatenate([columns[k] for k in others]), np.concatenate([target[k] for k in others])
        weight = np.linalg.lstsq(whole, wanted, rcond=None)[0]
        if positive and (weight[-positive:] < 0).any():
            low = np.r_[np.full(whole.shape[1] - positive, -np.inf), np.zeros(positive)]
            weight = lsq_linear(whole, wanted, (low, np.inf), tol=1e-14).x
        result.append(target[mine] - columns[mine] @ weight)
    return result
