"""How sure: probabilities over rivals by block bootstrap, and which effects this data cannot tell apart."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from service.diagnosis.fit.selection import LEAST_GAIN, SIMPLER_SHARE, TOLD_APART, Scored, Selection, added, z_score
from service.identification.folds import Split

DRAWS = 1000
SURE = 0.9  # probability from which a name is not asked about again
SAME_SHARE = 0.95  # of an effect's gain: a rival that reaches it does the same on this data


@dataclass(frozen=True)
class ModelComparison:
    """One round of the search: each hypothesis's effect with its probability, and that of adding none to `before`."""

    before: Scored
    candidates: list[tuple[Scored, float]]
    none: float

    def probability(self, name: str) -> float:
        """Of an effect, 0 if it did not come into question."""
        return sum(p for scored, p in self.candidates if name in added(scored, self.before))


def comparisons(selection: Selection, split: Split, rows: int) -> list[ModelComparison]:
    """The rounds of a search, weighed on bootstrap draws of its blocks."""
    draw = np.random.default_rng(0).integers(0, split.blocks, (DRAWS, split.blocks))
    result = []
    for parent, tried, _ in selection.rounds():
        hypotheses = [*tried, parent]
        sizes = np.array([h.fitted.tangents[0].shape[1] for h in hypotheses])
        loss = np.stack([h.blocks[draw].sum(axis=1) for h in hypotheses]) + 2.0 * sizes[:, None]
        loss[-1] -= LEAST_GAIN * rows  # an addition has to be worth it
        gain = float(parent.blocks.sum() - tried[0].blocks.sum())
        loss[sizes > sizes[0]] += SIMPLER_SHARE * max(gain, 0.0)  # as the search weighs them
        wins = np.bincount(np.argmin(loss, axis=0), minlength=len(hypotheses)) / DRAWS
        result.append(ModelComparison(parent, list(zip(tried, wins[:-1].tolist(), strict=True)), float(wins[-1])))
    return result


def probability_of(rounds: list[ModelComparison], name: str) -> float:
    """Of an effect, in the round that speaks for it most."""
    return max((comparison.probability(name) for comparison in rounds), default=0.0)


def undecided(selection: Selection, rounds: list[ModelComparison]) -> ModelComparison | None:
    """The first round whose winner others might be as well; where there is none, the first of all."""
    for comparison, (_, taken) in zip(rounds, selection.path, strict=True):
        if taken is not None:
            for name in added(taken, comparison.before):
                if comparison.probability(name) < SURE or confusable(selection, name):
                    return comparison
    return rounds[0] if rounds else None


def confusable(selection: Selection, name: str) -> list[str]:
    """Effects that would have done as well as `name` when it was chosen, as far as this data can tell."""
    for before, tried, taken in selection.rounds():
        if taken is None:
            break
        if name in added(taken, before):
            gains = [float((before.blocks - scored.blocks).sum()) for scored in (taken, *tried)]
            rivals = [
                added(rival, before)
                for rival, gain in zip(tried, gains[1:], strict=True)
                if rival is not taken
                and (z_score(rival.blocks, taken.blocks) < TOLD_APART or gain > SAME_SHARE * gains[0])
                and gain > 0.5 * gains[0]
            ]
            return [rival for rival in dict.fromkeys(itertools.chain(*rivals)) if rival not in added(taken, before)]
    return []
