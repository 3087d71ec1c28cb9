"""What a catalogue explains beside something that it does not hold: rows in which far more than noise is left weigh
little, and all is searched again, under the same rules.

A stranger sits on one joint, acts in one place, or comes and goes. An effect of the catalogue is at work in the other
rows too, and what is left of them with it is noise. Which they are shows only once the effects are known: one by one,
that is added which does most for rows that weigh by what the others leave of them, and the rows are weighed again.

A stranger that pulls at the platform wherever it is leaves no such rows, and springs, weights and offsets stand in for
it. Then any torque that goes by the platform's place is left open, on each joint and run another: friction, delays,
ripple, inertia show beside it, what goes by the place alone cannot be told.

One that comes again along the platform's way is a torque of its own, which nothing else is: it is left open first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.diagnosis import Caution
from service.diagnosis.evidence.wave import Wave, wave_of
from service.diagnosis.fit.candidates import Regressors
from service.diagnosis.fit.selection import (
    FAR_ABOVE,
    LEAST_GAIN,
    LEAST_Z,
    MOST_EFFECTS,
    Scored,
    Selection,
    additions,
    score,
    z_score,
)
from service.diagnosis.fit.signature import of_place
from service.identification.fit import Problem, evaluate, fit
from service.identification.folds import Split, held_out
from service.model.effects.base import Effect
from service.model.parameters import Parameters
from service.model.signals import running_mean

WIDTH = 0.06  # s over which the level of what is left is taken
EVEN = 1.5  # level from which rows weigh less while effects are looked for, all that are above it alike
SETTLING = 3  # times that the rows are weighed by what is left and the parameters fitted to them
EVERYWHERE = 1.2  # times the noise, of what is left of the rows as they weigh: more, and no row is free of the stranger
FREED = 1.1  # times as many rows have to weigh, with a torque left open that goes by the platform's place
LESS = 0.9  # of a joint's rows: one that keeps more is not told as set aside


@dataclass(frozen=True)
class Quiet:
    """The rows of `whole` as they weigh beside a stranger: where it is at work the less, the more it leaves. left: rms
    in units of the noise, as they weigh, with what was added to find them. wave: of a pull that is left open. open:
    whether any torque by the platform's place is."""

    whole: Problem
    regressors: Regressors
    left: float
    wave: Wave | None = None
    open: bool = False

    @property
    def problem(self) -> Problem:
        """With these weights."""
        return self.regressors.problem

    @classmethod
    def beside(
        cls, regressors: Regressors, none: Scored, best: Scored, given: int, allows: Callable[[Effect, int], bool],
        progress: Callable[[str], None],
    ) -> Quiet:  # fmt: skip
        """none, best: the base model on rows that weigh alike, and the most that was found there. Where no row is free
        of the stranger, torque that goes by the platform's place is left open, if that frees some."""
        whole, split = regressors.problem, regressors.split
        asked, waves = whole, []
        if (wave := wave_of(whole, best.residuals)) is not None:
            waves = [_own(columns, fold) for columns, fold in zip(wave.fields(whole), split.fold, strict=True)]
            asked = replace(whole, fields=waves)
            none = score(fit(asked, none.hypothesis), split)
        found = replace(cls._settled_on(regressors, asked, none, given, allows, progress), wave=wave)
        if found.left <= EVERYWHERE:
            return found
        places = _by_place(whole, split)
        both = [np.concatenate(parts, axis=1) for parts in zip(places, waves, strict=True)] if waves else places
        field = replace(whole, fields=both)
        none = score(fit(field, none.hypothesis), split)
        freed = replace(cls._settled_on(regressors, field, none, given, allows, progress), wave=wave, open=True)
        return freed if freed.problem.count > FREED * found.problem.count else found

    @classmethod
    def _settled_on(
        cls, regressors: Regressors, asked: Problem, none: Scored, given: int, allows: Callable[[Effect, int], bool],
        progress: Callable[[str], None],
    ) -> Quiet:  # fmt: skip
        """Effects are added while that helps, none of them believed yet; what they leave far above the noise is the
        stranger's."""
        problem, best = _settled(asked, regressors.split, none, none.residuals)
        base = best
        for _ in range(MOST_EFFECTS):
            exact, fault = additions(regressors.weighing(problem), best, base, given, allows, progress)
            if not exact or fault is not None:
                break
            gain = float((best.blocks - exact[0].blocks).sum())
            if gain < LEAST_GAIN * problem.count or z_score(best.blocks, exact[0].blocks) < LEAST_Z:
                break
            problem, best = _settled(asked, regressors.split, exact[0], _unweighed(problem, exact[0].residuals))
        left = _unweighed(problem, best.residuals)
        weights = [np.where(level > FAR_ABOVE, 1.0 / level**2, 1.0) for level in _levels(asked, left)]
        weighed = replace(asked, weights=weights)
        square = sum(float(np.sum((r * weighed.pick(i, weights[i])) ** 2)) for i, r in enumerate(left))
        return cls(regressors.problem, regressors.weighing(weighed), (square / weighed.count) ** 0.5)

    def on_all(self, scored: Scored) -> Scored:
        """A hypothesis with all that it leaves, however little it weighs against it. Beside a torque that was left open
        its effects stay as they are and the base model is fitted to all that there is."""
        if not self.problem.fields:
            return replace(scored, residuals=_unweighed(self.problem, scored.residuals))
        parameters, every = Parameters(scored.hypothesis), evaluate(self.whole, scored.hypothesis)
        values = parameters.values[parameters.free]
        effects = parameters.among_free(slice(parameters.timing + 1, None))
        held = every.holding(effects, values[effects])
        step, fitted = held.stepped()
        values[fitted.free] += step
        residuals = held_out(fitted, self.regressors.split)
        return replace(scored, fitted=replace(fitted, hypothesis=parameters.at(values)), residuals=residuals)

    def selection_on_all(self, selection: Selection) -> Selection:
        """The same of a whole search."""
        seen: dict[int, Scored] = {}

        def see(scored: Scored) -> Scored:
            return seen.setdefault(id(scored), self.on_all(scored))

        path = [([see(one) for one in tried], taken and see(taken)) for tried, taken in selection.path]
        taken = [taken for _, taken in selection.path if taken is not None]
        trimmed = {id(see(one)): see(selection.after(one)) for one in taken}
        standings = {effect: replace(one, without=see(one.without)) for effect, one in selection.standings.items()}
        return Selection(see(selection.none), see(selection.best), path, trimmed, selection.fault, standings)

    def caution(self) -> Caution:
        """What was set aside."""
        if self.open:
            return Caution(code="by_place", advice="look_there")
        if self.wave is not None:
            return Caution(code="comes_again", pitch_m=round(self.wave.pitch, 4), advice="look_there")
        weights = zip(self.problem.weights, self.whole.rows, strict=True)
        weighs = np.sum([(weight**2 * rows).sum(axis=0) for weight, rows in weights], axis=0)
        every = np.sum([rows.sum(axis=0) for rows in self.whole.rows], axis=0)
        kept = np.where(every > 0, weighs / np.maximum(every, 1), 1.0)
        joints = [joint + 1 for joint, part in enumerate(kept) if part < max(LESS, kept.min() + 1e-9)]
        share = 1.0 - self.problem.count / self.whole.count
        return Caution(code="set_aside", joints=joints, share=round(share, 4), advice="look_there")


def _by_place(problem: Problem, split: Split) -> list[np.ndarray]:
    """(R, K) a recording: torque that goes by the platform's place, on each fold with figures of its
    own."""
    result = []
    for number, recording in enumerate(problem.recordings):
        place = recording.arms.position - recording.arms.position.mean(axis=0)
        columns = problem.band(of_place(place / np.abs(place).max()))
        rows = problem.pick(number, np.repeat(columns[:, None], len(problem.sigma), axis=1))
        result.append(_own(rows, split.fold[number]))
    return result


def _own(columns: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Columns (R, K) with figures of their own on each fold (R,)."""
    return np.concatenate([np.where(fold[:, None] == one, columns, 0.0) for one in np.unique(fold)], axis=1)


def _settled(whole: Problem, split: Split, best: Scored, left: Sequence[np.ndarray]) -> tuple[Problem, Scored]:
    """`best` fitted to rows that weigh by what it leaves of them. left: that, (R,) a recording, in units of the
    noise."""
    problem = whole
    for _ in range(SETTLING):
        problem = replace(whole, weights=[1.0 / np.maximum(level / EVEN, 1.0) for level in _levels(whole, left)])
        best = score(fit(problem, best.hypothesis, iterations=2), split)
        left = _unweighed(problem, best.residuals)
    return problem, best


def _unweighed(problem: Problem, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [r / problem.pick(number, problem.weights[number]) for number, r in enumerate(residuals)]


def _levels(problem: Problem, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """(M, n) a recording: rms around each row, of the rows there are; 1 where there are none."""
    result = []
    width = max(1, round(WIDTH / (problem.band.period * problem.band.step)))
    for rows, joints, residual in zip(problem.rows, problem.joints_of_rows, residuals, strict=True):
        square = np.zeros(rows.shape)
        for joint in range(rows.shape[1]):
            square[rows[:, joint], joint] = residual[joints == joint] ** 2
        mean, filled = (running_mean(x, width, "constant") for x in (square, rows.astype(float)))
        result.append(np.where(rows, np.sqrt(mean.clip(0.0) / np.maximum(filled, 1.0 / width)), 1.0))
    return result
