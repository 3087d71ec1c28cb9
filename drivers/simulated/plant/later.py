"""Effects that come on while the simulated robot runs."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.simulated.plant.effects import EFFECTS, PlantEffect
from drivers.simulated.plant.plant import Plant
from drivers.simulated.plant.truth import PlantTruth
from schemas.errors import DataError

_LATER = re.compile(r"^(?P<name>\w+)(?:=(?P<value>[^@]+))?@(?P<at>[^@]+?)s?$")


@dataclass(frozen=True)
class Later:
    """An effect and the time, s of the run, from which it is at work."""

    effect: PlantEffect
    name: str
    at: float

    @property
    def in_words(self) -> str:
        """Name, time and figures."""
        return f"{self.name} from {self.at:g} s: {self.effect.in_words}"


def later(text: str, truth: PlantTruth, seed: int) -> Later:
    """Read `NAME@SECONDS` or `NAME=VALUE@SECONDS`, an `s` behind the seconds allowed.

    The figures are drawn from `seed` at the size of a fault that maintenance would want to know of; VALUE is what the
    first of them (on the joint where it is largest) shall be instead.

    Raises:
        DataError: not of that form, no such effect, or a value that is none.
    """
    found = _LATER.match(text)
    if found is None:
        raise DataError(f"--later {text!r}: give NAME@SECONDS or NAME=VALUE@SECONDS, such as stribeck_friction@60s")
    name = found["name"]
    if name not in EFFECTS:
        raise DataError(f"--later {text!r}: unknown effect {name!r}; known: {', '.join(EFFECTS)}")
    at = _number(text, found["at"])
    if at <= 0:
        raise DataError(f"--later {text!r}: {at:g} s: the time must be above zero")
    effect = EFFECTS[name].draw(np.random.default_rng([seed, 2]), truth, 1.0)
    if found["value"] is not None:
        effect = _sized(effect, _number(text, found["value"]))
    return Later(effect, name, at)


def changes(plant: Plant, seed: int, coming: Sequence[Later]) -> dict[int, Plant]:
    """Cycle -> the plant that goes on from there (`Plant.adopt`), built ahead of the run."""
    effects, made = plant.effects, {}
    for one in sorted(coming, key=lambda one: one.at):
        effects = (*effects, one.effect)
        made[round(one.at / plant.period)] = Plant(plant.robot, plant.described, effects, plant.period, seed)
    return made


def _number(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"--later {text!r}: {number!r} is not a number")
    return value


def _sized(effect: PlantEffect, value: float) -> PlantEffect:
    name, drawn = next(iter(effect.figures.items()))
    if not isinstance(drawn, list):
        return dataclasses.replace(effect, **{name: value})
    largest = max(drawn, key=abs)
    return dataclasses.replace(effect, **{name: [value * one / largest for one in drawn]})
