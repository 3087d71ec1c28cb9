"""The parameters of a hypothesis in one order, and all that is known of each: everything that turns a hypothesis into
numbers and back, or puts a name, a limit or an error to a number, asks here.

Order: rigid coefficients of the mechanism, viscous and Coulomb friction joint by joint and of what else rubs,
transition (one, or one a friction), timing; then, effect by effect, amplitudes joint by joint and nonlinear parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from service.model.hypothesis import Hypothesis, Term
from service.model.mechanism import Mechanism

TIMING_LIMIT = 0.25  # samples: a shift below this is sampling, beyond it an effect
FILTERED_LIMIT = 0.5  # the same of a torque that went through a recorder's filter, which makes it late
LONGEST_DELAY = 0.02  # s that torque and position may be apart where no effect is looked for, as `torque_delay` has it
REACH, REACH_OF_RANGE = 0.5, 0.02  # of a value, of its range: further than both together a slope says nothing
TRANSITION = (2e-4, 2e-2)  # rad/s, limits of the speed over which Coulomb friction turns; beyond is an effect
WIDE_TRANSITION = 0.5  # rad/s, the upper limit where each friction has its own


@dataclass(frozen=True)
class Quantity:
    """One parameter. name: as in the documents; of an effect it ends in the joint where the effect has several.

    low, high: what it can be; the fit keeps it there. free: the fit moves it. rough: the torque is no smooth function
    of it. timing's limits are samples, not seconds.
    """

    name: str
    unit: str
    low: float = -np.inf
    high: float = np.inf
    free: bool = True
    rough: bool = False


class Parameters:
    """Parameters of `hypothesis`, P of them, F of which a fit moves."""

    def __init__(self, hypothesis: Hypothesis) -> None:
        self.hypothesis = hypothesis
        base = hypothesis.base
        k, n = len(base.rigid), len(base.viscous)
        self.rigid, self.viscous, self.coulomb = slice(0, k), slice(k, k + n), slice(k + n, k + 2 * n)
        count = np.size(base.transition)
        self.transition, self.timing = slice(k + 2 * n, k + 2 * n + count), k + 2 * n + count
        at = self.timing + 1
        self.terms: list[slice] = []
        for term in hypothesis.terms:
            count = term.amplitude.size + len(term.nonlinear)
            self.terms.append(slice(at, at + count))
            at += count

    @cached_property
    def values(self) -> np.ndarray:
        """(P,)."""
        base = self.hypothesis.base
        parts = [base.rigid, base.viscous, base.coulomb, np.atleast_1d(base.transition), [base.timing]]
        for term in self.hypothesis.terms:
            parts += [term.amplitude.ravel(), term.nonlinear]
        return np.concatenate([np.asarray(part, float) for part in parts])

    def at(self, free: np.ndarray) -> Hypothesis:
        """The hypothesis with its free parameters at (F,) other values."""
        values = self.values.copy()
        values[self.free] = free
        base = replace(
            self.hypothesis.base,
            rigid=values[self.rigid],
            viscous=values[self.viscous],
            coulomb=values[self.coulomb],
            transition=_like(self.hypothesis.base.transition, values[self.transition]),
            timing=float(values[self.timing]) if self.hypothesis.fits_timing else 0.0,
        )
        terms = []
        for term, mine in zip(self.hypothesis.terms, self.terms, strict=True):
            amplitude, nonlinear = np.split(values[mine], [term.amplitude.size])
            terms.append(
                replace(term, amplitude=amplitude.reshape(term.amplitude.shape), nonlinear=tuple(map(float, nonlinear)))
            )
        return replace(self.hypothesis, base=base, terms=tuple(terms))

    @cached_property
    def of_terms(self) -> list[list[Quantity]]:
        """The parameters of each effect."""
        return [parameters_of(term) for term in self.hypothesis.terms]

    @cached_property
    def free(self) -> np.ndarray:
        """(P,) bool: what a fit moves."""
        free = np.ones(len(self.values), bool)
        if self.hypothesis.base.wanted is not None:
            free[self.rigid] = self.hypothesis.base.wanted
        free[self.timing] = self.hypothesis.fits_timing
        for mine, parameters in zip(self.terms, self.of_terms, strict=True):
            free[mine] = [parameter.free for parameter in parameters]
        return free

    @cached_property
    def rough(self) -> np.ndarray:
        """(F,) bool: free parameters of which the torque is no smooth function."""
        rough = np.zeros(len(self.values), bool)
        for mine, parameters in zip(self.terms, self.of_terms, strict=True):
            rough[mine] = [parameter.rough for parameter in parameters]
        return rough[self.free]

    def limits(self, mechanism: Mechanism, period: float, apart: float = TIMING_LIMIT) -> tuple[np.ndarray, np.ndarray]:
        """(F,) lowest and highest values that a fit may give the free parameters. period: s between samples. apart:
        samples that torque and position may be."""
        low, high = np.full(len(self.values), -np.inf), np.full(len(self.values), np.inf)
        base = base_parameters(mechanism)
        low[: len(base)], high[: len(base)] = [known.low for known in base], [known.high for known in base]
        low[self.transition], high[self.transition] = TRANSITION
        if np.ndim(self.hypothesis.base.transition):
            widest = self.hypothesis.base.widest
            high[self.transition] = WIDE_TRANSITION if widest is None else widest
        low[self.timing], high[self.timing] = -apart * period, apart * period
        for mine, parameters in zip(self.terms, self.of_terms, strict=True):
            low[mine], high[mine] = [known.low for known in parameters], [known.high for known in parameters]
        return low[self.free], high[self.free]

    def reach(self, mechanism: Mechanism, period: float, apart: float = TIMING_LIMIT) -> tuple[np.ndarray, np.ndarray]:
        """(F,) steps down and up that a slope can be trusted over, inside the limits: without end where the torque is
        linear, `REACH` of a value where it is not."""
        low, high = self.limits(mechanism, period, apart)
        bent = np.zeros(len(self.values), bool)
        bent[self.transition] = True
        for term, mine in zip(self.hypothesis.terms, self.terms, strict=True):
            bent[mine.start + term.amplitude.size : mine.stop] = True
        bent, values = bent[self.free], self.values[self.free]
        far = np.where(bent, REACH * np.abs(values) + REACH_OF_RANGE * np.where(bent, high - low, 0.0), np.inf)
        return np.maximum(low - values, -far), np.minimum(high - values, far)

    def columns(self, number: int) -> np.ndarray:
        """Indices of effect `number`'s free parameters among the F."""
        return self.among_free(self.terms[number])

    def among_free(self, part: slice) -> np.ndarray:
        """Indices of the free parameters of `part` among the F."""
        mine = np.zeros(len(self.values), bool)
        mine[part] = True
        return np.flatnonzero(mine[self.free])

    def widened(self, columns: np.ndarray, count: int) -> np.ndarray:
        """(R, count) of the first parameters, of (R, F) columns of the free ones; zero for those that are held."""
        free = self.free[:count]
        result = np.zeros((len(columns), count))
        result[:, free] = columns[:, : np.count_nonzero(free)]
        return result

    def spread(self, free: np.ndarray) -> np.ndarray:
        """(P,) of (F,) figures of the free parameters, zero for the others."""
        result = np.zeros(len(self.values))
        result[self.free] = free
        return result


def _like(form: float | np.ndarray, values: np.ndarray) -> float | np.ndarray:
    return values if np.ndim(form) else float(values[0])


def parameters_of(term: Term) -> list[Quantity]:
    """An effect's parameters, amplitudes joint by joint, then nonlinear ones."""
    effect, result = term.effect, []
    for joint in term.joints or (None,):
        suffix = f"_{joint + 1}" if joint is not None and len(term.joints) > 1 else ""
        result += [Quantity(name + suffix, a.unit, a.low, a.high) for name, a in effect.amplitudes.items()]
    return result + [
        Quantity(name, s.unit, s.low, s.high, free=term.searched[name], rough=effect.rough)
        for name, s in effect.nonlinear.items()
    ]


def base_parameters(mechanism: Mechanism) -> list[Quantity]:
    """The base model's parameters that the torque is linear in, by name: coefficients and friction."""
    return [
        *(Quantity(name, c.unit, low=c.low) for name, c in mechanism.coefficients.items()),
        *(Quantity(f"f_v_{name}", "N m s/rad", low=0.0) for name in mechanism.frictions),
        *(Quantity(f"f_c_{name}", "N m", low=0.0) for name in mechanism.frictions),
    ]


def shown_parameters(mechanism: Mechanism) -> list[Quantity]:
    """The base model's parameters as far as documents show them: with the transitions, where each friction has one."""
    low, high = TRANSITION[0], WIDE_TRANSITION
    own = mechanism.frictions if mechanism.own_transitions else ()
    return base_parameters(mechanism) + [Quantity(f"transition_{name}", "rad/s", low, high) for name in own]
