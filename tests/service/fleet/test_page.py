"""The page of a fleet, where a full diagnosis would show no more."""

from __future__ import annotations

from pathlib import Path

from schemas.diagnosis import Provenance
from schemas.fleet_document import DayResult, Fleet, RobotHistory
from service.fleet.changes import changes
from service.fleet.page import headline, write_page
from service.pages import Headline
from tests.service.pages.browser import looked_at, plots_of


def test_the_colours_of_the_gap_begin_at_zero(tmp_path: Path) -> None:
    """A hundredth more is no dark day."""
    days = [
        DayResult(made_of="0", robot="cell", day=day, verdict="within_noise", gap_nm=gap, after_nm=gap, torque_nm=10.0)
        for day, gap in (("2026-01-30", 0.50), ("2026-01-31", 0.505))
    ]
    made = Provenance(at="2026-02-01T00:00:00+00:00", version="1", inputs={})
    robots = [RobotHistory(robot="cell", days=days)]
    write_page(Fleet(schema="deltatwin.fleet/1", made=made, robots=robots), tmp_path / "fleet.html")
    seen = looked_at(tmp_path / "fleet.html")
    assert seen["errors"] == seen["over"] == []
    (shown,) = (
        plot
        for figure in plots_of((tmp_path / "fleet.html").read_text(encoding="utf-8"))
        for plot in figure["data"]
        if plot["type"] == "heatmap"
    )
    assert (shown["zmin"], shown["zmax"]) == (0, 5.05)


def test_the_headline_follows_the_figures(tmp_path: Path) -> None:
    """Of a robot at 25 times its first day, of which no cause can be told."""
    first, last = (
        DayResult.model_validate(
            {"made_of": "0", "robot": "cell", "day": day, "verdict": verdict, "gap_nm": gap, "after_nm": gap,
             "torque_nm": 10.0}
        )
        for day, gap, verdict in (("2026-01-30", 0.1, "within_noise"), ("2026-01-31", 2.5, "cannot_tell"))
    )  # fmt: skip
    days = [first, last]
    made = Provenance(at="2026-02-01T00:00:00+00:00", version="1", inputs={})
    robots = [RobotHistory(robot="cell", days=days, changes=changes(days))]
    write_page(Fleet(schema="deltatwin.fleet/1", made=made, robots=robots), tmp_path / "fleet.html")
    text = (tmp_path / "fleet.html").read_text(encoding="utf-8")
    assert "Nothing has changed" not in text
    assert "cell: the gap to the reference day has risen, the cause is unknown" in text
    assert "Since 2026-01-31" in text


def test_no_change_is_said_of_robots_alone_that_were_compared() -> None:
    """A day that the reference was identified on has nothing to differ from."""

    def robot(name: str, *verdicts: str | None) -> RobotHistory:
        days = [
            DayResult.model_validate({"made_of": "0", "robot": name, "day": f"2026-01-{30 + k}", "verdict": verdict})
            for k, verdict in enumerate(verdicts)
        ]
        return RobotHistory(robot=name, reference_of="2026-01-30", days=days)

    made = Provenance(at="2026-02-01T00:00:00+00:00", version="1", inputs={})

    def said(*robots: RobotHistory) -> Headline:
        return headline(Fleet(schema="deltatwin.fleet/1", made=made, robots=list(robots)), Path())

    both = robot("a", "within_noise", "within_noise")
    alone, broken = robot("b", "within_noise", None), robot("c", None, None)
    assert (said(both).tone, said(both).answer) == ("good", "No change in 1 robot.")
    some = said(both, alone, broken)
    assert (some.tone, some.answer) == ("open", "No change in 1 of 3 robots; not compared: b, c.")
    assert "record a day of b, c" in some.step
    assert said(alone).answer == "No robot could be compared with its reference; not compared: b."
