"""A fitted base model by the names of its parameters, as `[identified]` sections hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from schemas.toml import NotNegative, TomlTable

Verdict = Literal["identifiable", "weak", "not identifiable"]


class Parameter(TomlTable):
    """One identified value with its standard error in the same unit, and whether the data determine it."""

    value: float  # as fitted
    std_error: NotNegative = 0.0  # of `value`
    verdict: Verdict = "identifiable"  # whether the data determine it


class JointParameter(TomlTable):
    """The same with one value per joint."""

    value: list[float]  # as fitted, joint 1 first
    std_error: list[NotNegative] = []  # of each `value`
    verdict: list[Verdict] = []  # whether the data determine it


Figures = dict[str, tuple[float, float]]  # name -> value and standard error


def per_joint(name: str, given: JointParameter | None) -> Figures:
    """Those of the joints by name, which has {} for the number of the joint."""
    if given is None:
        return {}
    errors = given.std_error or [0.0] * len(given.value)
    both = zip(given.value, errors, strict=True)
    return {name.format(joint): figure for joint, figure in enumerate(both, start=1)}


def alone(given: Mapping[str, Parameter]) -> Figures:
    """Those of parameters that are of no joint, by name."""
    return {name: (parameter.value, parameter.std_error) for name, parameter in given.items()}


@dataclass(frozen=True)
class Fitted:
    """What was fitted to a machine of `count` joints, SI.

    verdicts: name -> whether the data determine it, empty where nobody asked. transition: one for all frictions, or one
    each. timing_s, band_hz: of the torque; None: no limit.
    """

    count: int
    figures: Figures
    verdicts: Mapping[str, str]
    transition: float | list[float]
    timing_s: float
    band_hz: float | None = None

    def one(self, name: str) -> dict[str, Any]:
        """A `Parameter`."""
        value, error = self.figures[name]
        return {"value": value, "std_error": error, "verdict": self.verdicts.get(name, "identifiable")}

    def joints(self, name: str) -> dict[str, Any] | None:
        """A `JointParameter`; name: with {} for the number of the joint. A joint without it has zero; None: all are."""
        keys = [name.format(number) for number in range(1, self.count + 1)]
        if not any(key in self.figures for key in keys):
            return None
        values, errors = ([self.figures.get(key, (0.0, 0.0))[part] for key in keys] for part in (0, 1))
        said = [self.verdicts.get(key, "identifiable") for key in keys] if self.verdicts else []
        return {"value": values, "std_error": errors, "verdict": said}
