"""Since when: what counts for, what against, what for nothing."""

from __future__ import annotations

from typing import Any

from schemas.diagnosis import Moved, NamedEffect, Online
from schemas.fleet_document import Change, DayResult
from service.fleet.changes import changes


def effect(name: str, *joints: int) -> NamedEffect:
    return NamedEffect(
        name=name, joints=list(joints), probability=1.0, parameters={}, gap_share=0.9, confusable_with=[],
        settles="", online=Online(carried=False, reason="no_online_form"),
    )  # fmt: skip


def day(number: int, *effects: NamedEffect, **other: Any) -> DayResult:
    known: dict[str, Any] = {"gap_nm": 1.0, "after_nm": 0.1, "torque_nm": 10.0}
    known["verdict"] = "explained" if effects else "within_noise"
    return DayResult(made_of="", robot="a", day=f"day {number}", effects=list(effects), **(known | other))


def told(found: list[Change]) -> list[tuple]:
    return [(one.name, one.joints, one.since, one.not_on, one.last, one.gone, one.days, one.of) for one in found]


def test_joints_of_one_time_go_together_others_apart() -> None:
    days = [day(1), day(2, effect("backlash", 1, 3)), day(3, effect("backlash", 1, 2, 3))]
    assert told(changes(days)) == [
        ("backlash", [1, 3], "day 2", "day 1", "day 3", False, 2, 2),
        ("backlash", [2], "day 3", "day 2", "day 3", False, 1, 1),
    ]


def test_days_on_which_nothing_can_be_told_count_for_nothing() -> None:
    lame = [day(2, verdict="cannot_tell"), day(3, verdict=None)]
    days = [day(1), *lame, day(4, effect("tool_mass")), *lame, day(5, effect("tool_mass")), *lame]
    assert told(changes(days)) == [("tool_mass", [], "day 4", "day 1", "day 5", False, 2, 2)]


def test_what_was_there_from_the_first_day_and_what_has_gone() -> None:
    days = [day(1, effect("cogging", 2)), day(2, effect("cogging", 2)), day(3), day(4)]
    assert told(changes(days)) == [("cogging", [2], "day 1", None, "day 2", True, 2, 4)]


def moved(after: float, error: float = 0.01) -> dict[str, Moved]:
    return {"f_c_2": Moved(before=3.0, before_error=0.01, after=after, after_error=error, unit="N m")}


def test_friction_that_moved_is_told_where_it_is_certain_and_the_base_fits() -> None:
    quiet = [day(2, moved=moved(3.2)), day(3, moved=moved(4.0, error=0.3)), day(4, moved=moved(4.0, error=0.0))]
    wrong = day(5, moved=moved(4.0), verdict="unexplained")
    days = [day(1), *quiet, day(6, moved=moved(4.0))]
    (change,) = changes(days)
    assert (change.kind, change.title, change.joints, change.since) == ("parameter", "Coulomb friction", [2], "day 6")
    assert change.now == ["3 → 4 N m (+33 %)"]
    assert [one.kind for one in changes([day(1), wrong])] == ["unexplained"]


def test_a_gap_that_has_risen_without_a_cause_is_told() -> None:
    """Whether or not the day could be judged; not where its cause is, nor by less than days differ."""
    lame = {"verdict": "cannot_tell", "cannot_tell": ["too little motion"]}
    days = [day(1), day(2, gap_nm=1.9), day(3, gap_nm=25.0, **lame), day(4, gap_nm=25.0), day(5, gap_nm=30.0, **lame)]
    (change,) = changes(days)
    assert change.kind == "risen"
    assert change.title == "the gap to the reference day has risen, the cause is unknown"
    assert told([change]) == [("", [], "day 3", "day 2", "day 5", False, 3, 3)]
    assert change.now == ["30 times that of day 1, 30 → 0.1 N m (300 % of the torque)"]
    assert [one.kind for one in changes([day(1), day(2, effect("backlash", 1), gap_nm=25.0)])] == ["effect"]
    assert changes([day(1, gap_nm=None), day(2)]) == []
    (gone,) = changes([day(1), day(2, gap_nm=9.0), day(3)])
    assert gone.gone
