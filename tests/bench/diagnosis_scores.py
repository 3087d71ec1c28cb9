"""How answers of the diagnosis are scored against the truth: plain functions of what `bench_diagnosis` keeps of a case.

An answer is right by its names. Names that no motion separates count as one. Where the description is wrong, the effect
that says so counts neither for nor against an answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.stats import beta, binomtest, chi2

SAME = ({"asymmetric_friction", "torque_offset"},)  # a constant and a friction that differs between the directions
CORRECTS = {
    "active_link": (), "passive_link": ("tool_mass",), "platform": ("tool_mass",),  # the base model takes up the first
    "active_link_length": ("link_length_error",), "passive_link_length": ("forearm_length_error",),
    "base_radius": ("base_radius_error",),
}  # fmt: skip
FINDABLE = 1.1  # times the noise that the gap must be for its cause to count as findable
CERTAIN = 0.9  # probability from which a name counts as certain
DECILES = 10


@dataclass(frozen=True)
class Name:
    """An effect that was named. joints: from 1; empty where it sits on no single joint."""

    name: str
    joints: list[int]
    probability: float


@dataclass(frozen=True)
class Answer:
    """What is kept of a case. effects: name -> joints at work. before, after, floor: N m, rms of the gap on logs kept
    out of everything, measured by the bench. cpu_seconds: of the processor, of identification and diagnosis."""

    family: str
    seed: int
    effects: dict[str, list[int]]
    disturbances: list[str] = field(default_factory=list)
    misdescribed: list[str] = field(default_factory=list)
    lift: float = 0.0
    named: list[Name] = field(default_factory=list)
    verdict: str = ""
    claimed: float = 0.0
    before: float = 0.0
    after: float = 0.0
    floor: float = 0.0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    error: str = ""

    @property
    def findable(self) -> bool:
        """Whether something is at work that stands out of the noise."""
        return bool(self.effects) and self.lift >= FINDABLE

    @property
    def measured(self) -> float:
        """Shrink of the gap on the logs kept out."""
        return 1 - self.after / self.before


def as_row(answer: Answer) -> dict[str, Any]:
    """For a line of JSON."""
    return asdict(answer)


def from_row(row: dict[str, Any]) -> Answer:
    """Of a line of JSON.

    Raises:
        TypeError: it has other keys than an answer.
    """
    return Answer(**{**row, "named": [Name(**name) for name in row["named"]]})


def counted(answer: Answer) -> list[Name]:
    """Its names but those that correct the description where it is wrong."""
    excused = {name for key in answer.misdescribed for name in CORRECTS[key]} - set(answer.effects)
    return [name for name in answer.named if name.name not in excused]


def is_true(name: str, answer: Answer) -> bool:
    """Whether `name` is at work, or one that nobody can separate from it."""
    alike = {name}.union(*(group for group in SAME if name in group))
    return bool(alike.intersection(answer.effects))


def first_right(answer: Answer) -> bool:
    """Whether the first name is true."""
    names = counted(answer)
    return bool(names) and is_true(names[0].name, answer)


def false_names(answer: Answer) -> int:
    """Number of names that are not at work."""
    return sum(not is_true(name.name, answer) for name in counted(answer))


def f1(answer: Answer) -> float:
    """2 true / (2 true + false + missed), of effects; 1 where nothing is at work and nothing named."""
    names = [name.name for name in counted(answer)]
    found = sum(any(is_true(name, _only(effect)) for name in names) for effect in answer.effects)
    missed, false = len(answer.effects) - found, false_names(answer)
    return 2 * found / (2 * found + false + missed) if found + false + missed else 1.0


def _only(effect: str) -> Answer:
    return Answer("", 0, {effect: []})


def joints_right(answer: Answer) -> list[bool]:
    """Of each true name whose effect sits on joints: whether these are all and no others."""
    return [
        sorted(name.joints) == sorted(answer.effects[name.name])
        for name in counted(answer)
        if answer.effects.get(name.name)
    ]


def verdict_right(answer: Answer) -> bool:
    """Whether the verdict says how far effects of the catalogue explain the gap.

    A disturbance is at work: not all is explained. Nothing is: the gap is within the noise, or was in the description.
    Effects alone: explained.
    """
    if answer.disturbances:
        return answer.verdict in ("partly_explained", "unexplained")
    if answer.effects:
        return answer.verdict == "explained"
    return answer.verdict in ("within_noise", *(("explained",) if answer.misdescribed else ()))


def proportion(right: int, count: int) -> tuple[float, float]:
    """95 % interval of a share of independent cases (Clopper and Pearson, which covers at least as often).

    >>> [round(bound, 3) for bound in proportion(9, 10)]
    [0.555, 0.997]
    """
    interval = binomtest(right, count).proportion_ci(method="exact") if count else None
    return (0.0, 1.0) if interval is None else (float(interval.low), float(interval.high))


def rate(events: int, count: int) -> tuple[float, float]:
    """95 % interval of events a case (Poisson, exact)."""
    if not count:
        return 0.0, float("inf")
    low = chi2.ppf(0.025, 2 * events) / 2 if events else 0.0
    return float(low) / count, float(chi2.ppf(0.975, 2 * events + 2)) / 2 / count


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """95 % interval of a mean of values between 0 and 1: that of a share with the same sum, since of all such values
    zeros and ones scatter most. Of equal values, where a bootstrap has no width, it has that of their number."""
    total, count = float(np.sum(values)), len(values)
    low = beta.ppf(0.025, total, count - total + 1) if total > 0 else 0.0
    high = beta.ppf(0.975, total + 1, count - total) if total < count else 1.0
    return float(low), float(high)


@dataclass(frozen=True)
class Measured:
    """A figure of some cases: value, how many it is of, 95 % interval."""

    value: float
    count: int
    low: float
    high: float

    @property
    def interval(self) -> str:
        """In words."""
        return f"95 %: {self.low:.3g} to {self.high:.3g}"


def share_of(hits: Sequence[bool]) -> Measured | None:
    """The share that is true; None of nothing."""
    return Measured(sum(hits) / len(hits), len(hits), *proportion(sum(hits), len(hits))) if hits else None


def family_figures(answers: Sequence[Answer]) -> dict[str, Measured]:
    """Figures of one family; those of which it has no case are absent."""
    good = [answer for answer in answers if not answer.error]
    findable = [answer for answer in good if answer.findable]
    quiet = [answer for answer in good if not answer.effects]
    scores, false = [f1(answer) for answer in findable], sum(map(false_names, good))
    found = {
        "first": share_of([first_right(answer) for answer in findable]),
        "f1": Measured(float(np.mean(scores)), len(scores), *mean_interval(scores)) if scores else None,
        "joints": share_of([hit for answer in findable for hit in joints_right(answer)]),
        "quiet": share_of([not counted(answer) for answer in quiet]),
        "verdict": share_of([verdict_right(answer) for answer in good]),
        "false": Measured(false / len(good), len(good), *rate(false, len(good))) if good else None,
    }
    return {key: value for key, value in found.items() if value is not None}


def reliability(answers: Sequence[Answer]) -> dict[int, Measured]:
    """By decile of the probability (0: below 0.1, 9: from 0.9): the share of names that are true."""
    hits: dict[int, list[bool]] = {}
    for answer in answers:
        for name in counted(answer):
            decile = min(int(name.probability * DECILES), DECILES - 1)
            hits.setdefault(decile, []).append(is_true(name.name, answer))
    return {
        decile: Measured(float(np.mean(one)), len(one), *proportion(sum(one), len(one))) for decile, one in hits.items()
    }


def certain_true(answers: Sequence[Answer]) -> Measured | None:
    """Of the names at `CERTAIN` or more, the share that is true."""
    return share_of(
        [is_true(name.name, answer) for answer in answers for name in counted(answer) if name.probability >= CERTAIN]
    )


def quantile_of(answers: Sequence[Answer], of: Callable[[Answer], float], at: float) -> Measured | None:
    """A quantile over cases that ended, with its bootstrap interval."""
    values = np.array([of(answer) for answer in answers if not answer.error])
    if not len(values):
        return None
    rng = np.random.default_rng(0)
    drawn = np.quantile(values[rng.integers(len(values), size=(2000, len(values)))], at, axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Measured(float(np.quantile(values, at)), len(values), float(low), float(high))


def claim_error(answer: Answer) -> float:
    """How far the claimed shrink is from the measured one."""
    return abs(answer.claimed - answer.measured)
