"""The first screen of the report: what, where, how much, what to do, in words; the page as a browser draws it."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from schemas.diagnosis import Caution, Estimate, Simulated
from service.diagnosis.documents.document import made_from
from service.diagnosis.documents.headline import Given, headline
from service.diagnosis.documents.over_time import _short, worst_second
from service.diagnosis.documents.report import write_diagnosis, write_report
from service.diagnosis.documents.text import ADVICE, PLANNED, _forward, answer, caution, paragraphs
from service.model.effects import CATALOGUE
from tests.service.diagnosis.said import sentences
from tests.service.pages.browser import looked_at, picture_of
from tests.service.subject import document


def test_every_effect_says_what_it_is_and_what_to_do():
    for effect in CATALOGUE:
        assert effect.title, effect.name
        assert effect.means.endswith("."), effect.name
        assert "_" not in effect.title + effect.means, effect.name
    assert len({effect.title for effect in CATALOGUE}) == len(CATALOGUE)


def test_the_box_says_what_where_how_much_and_what_to_do(findings):
    found = document.document(findings)
    said = answer(found)
    assert [cause.what for cause in said.causes] == [
        "Stribeck friction in joints 1, 2 and 3",
        "Cogging in joint 2",
    ]
    assert said.causes[0].title == "More friction at low speed (sticking)"
    assert said.causes[0].how_much[0].startswith("breakaway friction above the Coulomb level, joint 1 = ")
    assert said.causes[0].how_much[0].endswith(" N m")
    assert said.causes[0].surety == "Probability 100 %, by bootstrap over blocks of the data."
    assert said.check == []
    first, *others = found.effects
    open_ = first.model_copy(update={"probability": 0.8, "confusable_with": ["backlash"]})
    said_open = answer(found.model_copy(update={"effects": [open_, *others]}))
    assert said_open.causes[0].surety == (
        "Probability 80 %, by bootstrap over blocks of the data. The data cannot separate it from backlash."
    )
    assert said_open.check == ["To be sure, record a slow sweep with reversals, 0.005 to 1 rad/s.", PLANNED]
    assert "relubricate" in said.causes[0].means
    cosine, sine = (found.effects[1].parameters[name].value for name in ("cosine", "sine"))
    amplitude = re.match(r"amplitude, joint side = ([\d.]+) ± [\d.]+ N m$", said.causes[1].how_much[0])
    assert amplitude
    assert float(amplitude[1]) == pytest.approx((cosine**2 + sine**2) ** 0.5, rel=0.05)
    shares = [float(share) for share in re.findall(r"\(([\d.]+) % of the torque", said.gap)]
    before = sum(value**2 for value in found.gap.before_nm) / sum(value**2 for value in found.gap.torque_nm)
    assert shares[0] == pytest.approx(100 * before**0.5, rel=0.06)
    assert shares[1] < shares[0]


def test_a_page_says_the_figures_in_its_box_and_not_again_below(findings):
    found = document.document(findings)
    terminal, page = ([line for group in paragraphs(found, figures) for line in group] for figures in (True, False))
    start = "Most likely cause: stribeck friction in joints 1, 2 and 3 (probability "
    (said,), (below,) = ([line for line in lines if line.startswith(start)] for lines in (terminal, page))
    assert "breakaway friction above the Coulomb level, joint 1 = " in said
    assert "breakaway" not in below
    assert "of the gap above the noise" in below


def test_where_no_name_is_earned_the_box_says_what_to_check(findings):
    nothing = document.document(findings).model_copy(update={"effects": [], "verdict": "unexplained"})
    said = answer(nothing)
    assert said.causes == []
    assert said.check == [ADVICE["check_description"], ADVICE["record_more"], PLANNED]
    assert answer(nothing.model_copy(update={"verdict": "within_noise"})).check == []
    short = Caution(code="too_little_motion", advice="record_runs")
    said = answer(nothing.model_copy(update={"cannot_tell": [short]}))
    assert said.verdict == [caution(short)]
    assert said.check == [PLANNED], "what to record is said in the verdict already"


def test_a_long_name_keeps_its_ends_on_the_axis():
    assert _short("fit_a_pick") == "fit_a_pick"
    assert _short("export_of_monday_morning_fit_a_pick") == "export_of_mo…g_fit_a_pick"


def test_a_gap_hardly_above_the_noise_is_said_to_be_one(findings):
    found = document.document(findings)
    gap = found.gap.model_copy(update={"shrink": 0.09})
    assert "hardly above the noise" not in " ".join(sentences(found))
    assert "hardly above the noise" in " ".join(sentences(found.model_copy(update={"gap": gap})))
    partly = found.model_copy(update={"gap": gap, "verdict": "partly_explained"})
    assert "hardly above the noise" not in " ".join(sentences(partly))


def test_the_simulators_error_is_told_in_millimetres_or_that_it_left_the_workspace():
    found = Simulated(
        horizon_s=0.2, windows=9, path_mm=80.0, platform_before_mm=None, platform_after_mm=0.153,
        platform_floor_mm=0.07, joint_before_mrad=[1.0] * 3, joint_after_mrad=[1.0] * 3, left_out=["torque_delay"],
    )  # fmt: skip
    said = _forward(found)
    assert "from beyond the workspace to 0.15 mm; noise alone gives 0.07 mm" in said
    assert "In the simulator without torque delay, " in said
    assert "after 0.2 s" in said


def test_the_first_plot_is_the_second_with_the_largest_gap(findings):
    """Of all seconds of all logs, by a sum of its own; measured less predicted is the gap."""
    problem = findings.problem
    found = worst_second(findings)
    assert found
    title, figure = found[0], cast(Any, found[1])  # Plotly's attributes are made as they are asked for
    most = (0.0, "", 0.0)
    for index, recording in enumerate(problem.recordings):
        clock = recording.segment.time[:: problem.band.step]
        at = np.concatenate([clock[mine] for mine in problem.rows[index].T])
        for begin in clock[::5]:
            inside = (at >= begin) & (at < begin + 1.0)
            most = max(most, (float(np.sum(findings.after[index][inside] ** 2)), recording.name, float(begin)))
    first, last = figure.layout.xaxis.range
    assert last - first == pytest.approx(1.0)
    assert most[1] in title
    assert first == pytest.approx(most[2], abs=6 * problem.band.period * problem.band.step)
    lines = {trace.name: np.asarray(trace.y, float) for trace in figure.data[:3]}
    assert set(lines) == {"measured", "before", "after"}
    gap = lines["measured"] - lines["after"]
    index = next(k for k, one in enumerate(problem.recordings) if one.name in title)
    mine = problem.rows[index][:, 0]
    expected = findings.after[index][problem.joints_of_rows[index] == 0] * problem.sigma[0]
    np.testing.assert_allclose(gap[mine], expected, atol=2e-4)
    assert np.isnan(gap[~mine]).all()
    shown = {trace.name: np.asarray(trace.y, float) for trace in figure.data[3:5]}
    np.testing.assert_allclose(shown["after"][mine], expected, atol=1e-12)
    np.testing.assert_allclose(shown["before"], lines["measured"] - lines["before"], atol=1e-12)
    zoomed = np.asarray(figure.layout.yaxis2.range)
    assert np.ptp(zoomed) < 0.5 * np.ptp(np.asarray(figure.layout.yaxis.range)), "the gap has a scale of its own"


def test_the_next_step_finds_the_correction_and_reads_logs_as_these_were_read(findings, tmp_path: Path):
    found = document.document(findings)
    given = Given(Path("my cell/corrected.toml"), [Path("fit.csv")], [], ("--columns", "scope.toml"))
    said = headline(found, given)
    assert said.following == "deltatwin evaluate fit.csv --robot 'my cell/corrected.toml' --columns scope.toml"
    write_report(findings, found, tmp_path / "report.html", said)
    assert "<code>deltatwin evaluate fit.csv --robot &#39;my cell/corrected.toml&#39; --columns scope.toml</code>" in (
        tmp_path / "report.html"
    ).read_text("utf-8")
    tested = headline(found, replace(given, tests=[Path("other day.csv")]))
    assert tested.following.startswith("deltatwin evaluate 'other day.csv' --robot ")
    none = headline(found)
    assert none.following == "deltatwin evaluate LOG --robot corrected.toml"
    assert none.own.startswith("LOG: ")


def test_the_page_says_of_which_runs_a_gap_is_and_one_share_of_it(findings, tmp_path: Path):
    found = document.document(findings)
    for slow, said in (([], "<b>Gap:</b>"), (["sweep"], "<b>Gap over all runs:</b>")):
        levels = {"slow_runs": slow, "work_before_nm": found.gap.before_nm, "work_after_nm": found.gap.after_nm}
        gap = found.gap.model_copy(update=levels | {"shrink_of_explainable": 0.99})
        write_diagnosis(found.model_copy(update={"gap": gap}), None, {}, tmp_path / "report.html")
        page = (tmp_path / "report.html").read_text("utf-8")
        assert said in page
        assert ("<th>rms on held-out data, N m; all runs</th>" in page) == bool(slow)
        assert "<th>friction reversals, N m</th>" in page
        assert "Friction reversals: " in page
        assert "99 % of the energy" not in page, "of the gap above the noise another share is told above"


def test_a_fixed_value_has_no_interval():
    assert Estimate(value=120.0, unit="Hz", ci95=(120.0, 120.0)).fixed
    assert not Estimate(value=120.0, unit="Hz", ci95=(119.0, 121.0)).fixed


def test_the_page_is_drawn_without_error_and_no_text_lies_over_text(findings, tmp_path: Path):
    source = tmp_path / "log.csv"
    source.write_bytes(b"time_s\n")
    made = made_from([source, Path("d3-1200")])
    assert made.inputs == {"log.csv": hashlib.sha256(b"time_s\n").hexdigest()}
    write_report(findings, document.document(findings, made=made), tmp_path / "report.html")
    text = re.sub(r"<(script|style).*?</\1>", "", (tmp_path / "report.html").read_text("utf-8"), flags=re.DOTALL)
    assert made.inputs["log.csv"][:12] in text
    assert made.version in text
    box = re.search(r'<section class="headline bad">(.*?)</section>', text, re.DOTALL)
    assert box
    assert "_" not in re.sub(r"<[^>]*>", "", box[1])
    told = looked_at(tmp_path / "report.html")
    assert picture_of(tmp_path / "report.html", 1200).stat().st_size > 10_000
    assert told["texts"] > 50
    assert told["errors"] == []
    assert told["over"] == []
