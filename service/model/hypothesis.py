"""A hypothesis: the base model and some effects with their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.model.effects.base import Effect, Inside, Readout
from service.model.nominal import Correction, leaning
from service.model.scene import Base, Recording, Scene


@dataclass(frozen=True)
class Term:
    """One effect at work. joints from 0, empty unless the effect sits on joints. amplitude: (max(J, 1), k). found: more
    than a candidate, so that all its quantities are fitted, late ones too."""

    effect: Effect
    joints: tuple[int, ...]
    amplitude: np.ndarray
    nonlinear: tuple[float, ...]
    found: bool = False

    @property
    def searched(self) -> dict[str, bool]:
        """Whether the fit moves each nonlinear parameter, by name."""
        known = self.effect.nonlinear.items()
        return {name: not one.fixed and (self.found or not one.late) for name, one in known}

    @property
    def places(self) -> tuple[int, ...]:
        """Joints to evaluate the effect on; 0 stands for the whole robot."""
        return self.joints or (0,)

    @classmethod
    def blank(cls, effect: Effect, joints: tuple[int, ...], nonlinear: tuple[float, ...]) -> Term:
        """At amplitude zero."""
        return cls(effect, joints, np.zeros((max(1, len(joints)), len(effect.amplitudes))), nonlinear)


@dataclass(frozen=True)
class Hypothesis:
    """Base model and effects. timed: False holds torque and position to one instant."""

    base: Base
    terms: tuple[Term, ...] = ()
    timed: bool = True

    def seen(self, recording: Recording) -> Scene:
        """A recording from this operating point."""
        platform = recording.mechanism.platform
        if platform is None:
            return Scene(recording, self.base)
        return Scene(recording, self.base, leaning(platform.model.gravity, correction_of(self.terms).tilt))

    @property
    def fits_timing(self) -> bool:
        """A delay effect takes the place of the timing within a sample."""
        return self.timed and not any(term.effect.takes_timing for term in self.terms)

    def carrying(self, terms: tuple[Term, ...]) -> Hypothesis:
        """The same with other effects."""
        other = replace(self, terms=terms)
        return other if other.fits_timing else replace(other, base=replace(self.base, timing=0.0))


def correction_of(terms: Sequence[Term]) -> Correction:
    """What effects change in the model itself."""
    correction = Correction()
    for term in terms:
        for place, amplitude in zip(term.places, term.amplitude, strict=True):
            term.effect.correct(correction, place, amplitude)
    return correction


def read_out(terms: Sequence[Term], late: float) -> Readout:
    """What lies between the torque that acts and the reported one. late: s, of the report without effects."""
    readout = Readout(late=late)
    for term in terms:
        term.effect.read_out(readout, term.nonlinear)
    return readout


def inside_of(terms: Sequence[Term]) -> Inside:
    """What effects put inside the robot that only a simulation carries."""
    inside = Inside()
    for term in terms:
        for place, amplitude in zip(term.places, term.amplitude, strict=True):
            term.effect.put_inside(inside, place, amplitude, term.nonlinear)
    return inside
