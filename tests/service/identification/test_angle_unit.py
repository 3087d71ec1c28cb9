"""Whether angles are radians, each rule just inside and just outside of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from schemas.errors import DataError
from schemas.words import percent
from service.identification import angle_unit
from tests.service.subject import Hypothesis, fit
from tests.service.world import BASE, course, problem, stub

TORQUE = 1000.0  # squared, in units of the noise
ARM = stub(closed=False, as_described=lambda: "as described")
AXES = stub(closed=False, as_described=lambda: None)
DELTA = stub(closed=True, as_described=lambda: None)


@dataclass(frozen=True)
class Part:
    """A recording, as the rule sees it."""

    mechanism: Any
    segment: Any


def refused(
    monkeypatch: pytest.MonkeyPatch, radians: float, degrees: float, travel: float = 1.0, mechanism: Any = None
) -> str:
    """Why angles are refused that leave so much read as radians and as degrees; "": they are not."""
    segment = stub(theta=np.array([[0.0, 0.0], [0.0, travel]]))
    recordings = [Part(mechanism or DELTA, segment)] * 2

    def left(problem: Any, asked: list[Part]) -> float:
        if mechanism is ARM:
            assert [one.mechanism for one in asked] == ["as described"] * 2
        return degrees if asked[1].segment == "degrees" else radians

    monkeypatch.setattr(angle_unit, "_left", left)
    monkeypatch.setattr(angle_unit, "_as_degrees", lambda part: replace(part, segment="degrees"))
    half = np.full(5, np.sqrt(TORQUE / 10))
    made: Any = stub(recordings=recordings, target=[half, half], select=lambda number, values: values)
    fitted: Any = stub(cost=radians)
    try:
        angle_unit.refuse_wrong_angles(made, "a, b", fitted)
    except DataError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("radians", "degrees", "wrong"),
    [
        (100.0, 24.0, True), (100.0, 26.0, False),  # a quarter
        (900.0, 39.0, True), (900.0, 41.0, False),  # a fifth of the torque's rms
        (2.6, 0.1, True), (2.4, 0.1, False),  # a twentieth of it is left at most where radians fit
    ],
)  # fmt: skip
def test_degrees_are_told_by_what_each_reading_leaves(
    monkeypatch: pytest.MonkeyPatch, radians: float, degrees: float, wrong: bool
) -> None:
    told = refused(monkeypatch, radians, degrees)
    share = percent((degrees / radians) ** 0.5)
    words = f"a, b: the torque fits positions in degrees, not in rad (residual {share} of that in rad)"
    assert told.startswith(words) if wrong else told == ""


def test_an_arm_is_read_with_the_masses_of_its_description_and_axes_are_not_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However little is left, and however little it moves."""
    told = refused(monkeypatch, 2.4, 0.5, 0.01, ARM)
    assert told.startswith("a, b: with the masses of the description the torque fits positions in degrees")
    assert refused(monkeypatch, 2.4, 0.7, mechanism=ARM) == ""
    assert refused(monkeypatch, 900.0, 1.0, mechanism=AXES) == ""


def test_a_delta_has_to_move_a_fiftieth_of_a_radian(monkeypatch: pytest.MonkeyPatch) -> None:
    assert refused(monkeypatch, 100.0, 100.0, 0.019) == (
        "a, b: no joint moves further than 0.019 rad: are positions in another unit?"
    )
    assert refused(monkeypatch, 100.0, 100.0, 0.021) == ""


def test_what_friction_and_masses_leave_read_either_way() -> None:
    """Against the fit of the base model; of a motion given in degrees, that of the same in radians."""
    runs = [course(seed, 1.0) for seed in (1, 2)]
    made = problem(
        runs,
        [run.torque + np.random.default_rng(seed).standard_normal(run.torque.shape) for seed, run in enumerate(runs)],
    )
    cost = fit(made, Hypothesis(BASE, timed=False)).cost
    assert angle_unit._left(made, made.recordings) == pytest.approx(cost, rel=0.02)
    wrong = []
    for recording in made.recordings:
        segment = recording.segment
        angles = {name: np.degrees(getattr(segment, name)) for name in ("theta", "theta_dot", "theta_ddot")}
        wrong.append(replace(recording, segment=replace(segment, **angles)))
    again = [angle_unit._as_degrees(recording) for recording in wrong]
    assert angle_unit._left(made, again) == pytest.approx(angle_unit._left(made, made.recordings), rel=1e-6)
