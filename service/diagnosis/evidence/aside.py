"""What a catalogue explains beside something that it does not hold: rows in which far more than noise is left are set
aside, and the others are searched again, under the same rules.

A stranger sits on one joint, or comes and goes. An effect of the catalogue is at work in the quiet rows too, and what
is left of them with it is noise. A joint of which most is set aside is asked for no effect of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from schemas.diagnosis import Caution
from service.diagnosis.fit.selection import FAR_ABOVE, Scored, Selection
from service.identification.fit import Problem, evaluate
from service.identification.folds import Split, block_loss, held_out
from service.model.effects.base import Effect

WIDTH = 0.06  # s over which the level of what is left is taken
ONE_JOINT = 0.6  # of what is left above the noise, from which it is a matter of one joint
QUIET = 0.6  # of the rows that are searched again at least, where it is not
OWN = 0.2  # of the rows of such a joint that stay at least: its friction has to be told
ASKED = 0.5  # of a joint's rows that an effect on it has to be asked of
WEIGHED = 3.0  # times the level that is still quiet: what is left beyond says no more against a hypothesis


@dataclass(frozen=True)
class Quiet:
    """The rows of `whole` that are searched. problem, split: of them alone. kept: (n,) share a joint. limit: (n,) level
    in units of the noise up to which they are. explained: with what was found no more than noise is left of them."""

    whole: Problem
    whole_split: Split
    problem: Problem
    split: Split
    kept: np.ndarray
    limit: np.ndarray
    explained: bool = False
    _seen: dict[int, Scored] = field(default_factory=dict)

    @classmethod
    def of(cls, whole: Problem, split: Split, residuals: Sequence[np.ndarray]) -> Quiet:
        """Where `residuals`, (R,) a recording, in units of the noise, are low."""
        levels = [_levels(whole, number, residual) for number, residual in enumerate(residuals)]
        rows = [mask.sum(axis=0) for mask in whole.rows]
        above = np.sum([np.nansum(level**2, axis=0) for level in levels], axis=0) - np.sum(rows, axis=0)
        limit = np.full(len(whole.sigma), np.inf)
        if above.max() > ONE_JOINT * above.clip(0.0).sum():
            joint = int(np.argmax(above))
            own = np.concatenate([level[:, joint] for level in levels])
            limit[joint] = max(FAR_ABOVE, float(np.nanquantile(own, OWN)))
        else:
            limit[:] = max(FAR_ABOVE, float(np.nanquantile(np.concatenate([level.ravel() for level in levels]), QUIET)))
        quiet = replace(whole, rows=[mask & (level <= limit) for mask, level in zip(whole.rows, levels, strict=True)])
        every, quiet_rows = np.sum(rows, axis=0), np.sum([mask.sum(axis=0) for mask in quiet.rows], axis=0)
        kept = np.where(every > 0, quiet_rows / np.maximum(every, 1), 1.0)  # of a joint at rest nothing is set aside
        return cls(whole, split, quiet, Split.of(quiet, split.mixed), kept, limit)

    def allows(self, effect: Effect, joint: int) -> bool:
        """Whether `effect` may be looked for on `joint`."""
        return not effect.per_joint or bool(self.kept[joint] >= ASKED)

    def on_all(self, scored: Scored) -> Scored:
        """A hypothesis fitted to the quiet rows, on all: what is left out is predicted by quiet rows of the rest.

        Where they are explained, the stranger's own size is left out of what weighs: however violent it is, the rest
        tells one hypothesis from another.
        """
        if id(scored) not in self._seen:
            fitted = evaluate(self.whole, scored.hypothesis)
            residuals = held_out(fitted, self.whole_split, (scored.fitted, self.split))
            high = WEIGHED * self.limit if self.explained else np.full(len(self.limit), np.inf)
            most = [high[joints] for joints in self.whole.joints_of_rows]
            weighed = [np.clip(r, -m, m) for r, m in zip(residuals, most, strict=True)]
            self._seen[id(scored)] = Scored(fitted, residuals, block_loss(weighed, self.whole_split))
        return self._seen[id(scored)]

    def selection_on_all(self, selection: Selection) -> Selection:
        """The same of a whole search."""
        see = self.on_all
        path = [([see(one) for one in tried], taken and see(taken)) for tried, taken in selection.path]
        taken = [taken for _, taken in selection.path if taken is not None]
        trimmed = {id(see(one)): see(selection.after(one)) for one in taken}
        without = {effect: see(one) for effect, one in selection.without.items()}
        return Selection(see(selection.none), see(selection.best), path, trimmed, selection.fault, without)

    def caution(self) -> Caution:
        """What was set aside."""
        joints = [joint + 1 for joint, kept in enumerate(self.kept) if kept < 1.0]
        share = 1.0 - self.problem.count / self.whole.count
        return Caution(code="set_aside", joints=joints, share=round(share, 4), advice="look_there")


def _levels(problem: Problem, number: int, residual: np.ndarray) -> np.ndarray:
    """(M, n) rms around each row of recording `number`, NaN where there is none."""
    rows, joints = problem.rows[number], problem.joints_of_rows[number]
    square = np.zeros(rows.shape)
    for joint in range(rows.shape[1]):
        square[rows[:, joint], joint] = residual[joints == joint] ** 2
    width = max(1, round(WIDTH / (problem.band.period * problem.band.step)))
    mean, filled = (uniform_filter1d(x, width, axis=0, mode="constant") for x in (square, rows.astype(float)))
    return np.where(rows, np.sqrt(mean.clip(0.0) / np.maximum(filled, 1.0 / width)), np.nan)
