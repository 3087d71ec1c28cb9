"""Pages in a real browser: nothing fetched, nothing lies over anything, foreign text stays text."""

from __future__ import annotations

import gzip
import re
import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from plotly.graph_objs.layout import Template
from plotly.io import templates
from plotly.offline import get_plotlyjs
from typer.testing import CliRunner

from schemas.errors import StorageError
from schemas.messages import MODEL_ERROR, PAYLOAD, SAMPLE, set_stamp
from schemas.robot import Servo
from schemas.rollout_document import Reached, RegimeReached, RolloutDocument
from service.cli.main import app
from service.experiment.pictures import Figure, Line, Page, PageTable, Panel, write_page
from service.monitor.readback import Recorded
from service.monitor.recording_picture import picture
from service.pages import LOOK, PROGRAM, Headline, print_page
from service.pages import write_page as write_any_page
from service.rollout.gap import REGIMES
from service.rollout.rollout_page import write_rollout
from tests.service.pages.browser import looked_at, picture_of, plots_of
from tests.service.pages.drawn import KINDS

SAID = Headline("open", "Nothing is known <yet>.", "0 %", "of it", "look again.")


@pytest.fixture
def page() -> Page:
    time = np.linspace(0, 10, 50)
    panels = tuple(
        Panel("time / s", "error / mrad", (Line("measured", time, np.sin(time + joint)),), f"joint {joint + 1}")
        for joint in range(3)
    )
    first = Figure("f", "Over time", "c", panels)
    table = PageTable("Errors", ("what", "N m"), (("<b>bold</b>", "1.0"),), "a note")
    return Page("Loop of <script>alert(1)</script>", SAID, first, ("A lead & more.",), (table, first))


def test_foreign_text_stays_text_and_nothing_is_fetched(page: Page, tmp_path: Path) -> None:
    write_page(page, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    outside = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)  # plotly itself names addresses
    assert "Loop of &lt;script&gt;alert(1)&lt;/script&gt;" in outside
    assert "&lt;b&gt;bold&lt;/b&gt;" in outside
    assert "A lead &amp; more." in outside
    assert not re.search(r"\b(src|href)\s*=|@import|url\(", outside)
    assert not re.search(r"<script[^>]*\bsrc=", text)


def test_every_plot_has_the_look(tmp_path: Path) -> None:
    panel = Panel("time / s", "error / mrad", (Line("measured", np.arange(3.0), np.arange(3.0)),))
    figures = tuple(Figure(f"f{k}", "Over time", "c", (panel,)) for k in range(2))
    write_page(Page("t", SAID, figures[0], (), figures), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    looks = [plot["layout"]["template"] for plot in plots_of(text)]
    assert len(looks) == text.count('class="plotly-graph-div"') == 2
    for look in looks:
        assert look["layout"]["paper_bgcolor"] == "white"
        assert all(look["layout"][part].items() >= ours.items() for part, ours in LOOK.items())
        assert look == templates.merge_templates("plotly_white", Template(layout=LOOK)).to_plotly_json()


def test_no_text_lies_over_text(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(page, path)
    told = looked_at(path)
    assert told["texts"] > 20  # the plots are drawn
    assert told["errors"] == []
    assert told["over"] == []


def rollout(path: Path) -> None:
    times, regimes = [0.01 * k for k in range(21)], []

    def reached(robot: str, error: float) -> Reached:
        grown: list[float | None] = [error * (0.01 + time**2) for time in times]
        return Reached(
            robot=robot, joint_mrad=[error] * 3, platform_mm=error, growth_mm=grown, ran_away=0, left_out=[],
            torque_nm=[1.0, 2.0, 3.0],
        )  # fmt: skip

    *robots, floor = (reached(name, error) for name, error in (("plain", 9.0), ("corrected", 1.0), ("floor", 0.8)))
    errors = {robot.robot: robot.platform_mm for robot in (*robots, floor)}
    for joint in (1, 2, 3):
        regimes += [RegimeReached(joint=joint, regime=name, windows=9, joint_mrad=errors) for name in REGIMES]
    three = [20.0, 21.0, 22.0]
    document = RolloutDocument(
        schema="deltatwin.rollout/1", traces=["pick", "slow"], horizon_s=0.2, windows=60, payload_kg=[0.0, 1.2],
        untold_s=0.8, interruptions=[], windows_lost=0, seconds=13.0, used_s=12.0, path_mm=60.0,
        over_identified=[4.0, None, 1.0], times_s=times, robots=robots, floor=floor, regimes=regimes,
        servo=Servo(position_gain_ps=three, velocity_gain_nms=three),
    )  # fmt: skip
    write_rollout(document, path, {})
    text = path.read_text(encoding="utf-8")
    assert "driven by the recorded position commands alone" in text
    assert "<td>1, 2, 3</td>" in text
    assert "In 1 of 60 windows every simulated robot carries 1.2 kg" in text
    assert "corrected leaves 4, -, 1 times as much torque unexplained" in text


def recording(path: Path) -> None:
    records = [dtype.empty(1000) for dtype in (SAMPLE, MODEL_ERROR, PAYLOAD)]
    for k, some in enumerate(records):
        set_stamp(some, 1_000_000 * np.arange(1000))
        some["sequence"] = np.arange(1000)
        for name in (("torque",), ("kh", "full"), ("mass", "std_dev"))[k]:
            some[name] = 3.0 * np.sin(np.arange(1000) / 50).reshape(-1, *[1] * (some[name].ndim - 1))
    recorded = {
        topic: Recorded(some, np.arange(1000))
        for topic, some in zip(("sample", "error", "payload"), records, strict=True)
    }
    said = Headline("told", "A log of one second.", "3 N m", "of torque", "`deltatwin inspect` it.")
    write_any_page("recording", path, said, title="pick.mcap replayed", figure=picture(recorded))


def written(kind: str, path: Path) -> None:
    """A page of each kind; those with plots of logs, the diagnosis and the paper's, have tests of their own."""
    if kind in KINDS:
        KINDS[kind][0](np.random.default_rng(11), path)
    else:
        {"recording": recording, "rollout of commands": rollout}[kind](path)


@pytest.mark.parametrize("kind", [*KINDS, "recording", "rollout of commands"])
@pytest.mark.parametrize(
    ("width", "dark"),
    [
        (1000, False),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in ((390, False), (1400, False), (1000, True))),
    ],
)
def test_pages_are_clear(tmp_path: Path, kind: str, width: int, dark: bool) -> None:
    path = tmp_path / f"{kind.replace(' ', '_')}.html"
    written(kind, path)
    told = looked_at(path, width, dark)
    assert told["texts"] > 8
    assert told["errors"] == []
    assert told["over"] == []
    assert told["beyond"] <= 0
    assert picture_of(path, width, dark).stat().st_size > 10_000  # to be looked at


@pytest.mark.parametrize("kind", [*KINDS, "recording", "rollout of commands"])
def test_pages_are_small(tmp_path: Path, kind: str) -> None:
    written(kind, tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size < 1_500_000


def test_the_plotting_program_is_that_of_the_library(tmp_path: Path) -> None:
    """What Plotly of Python describes a newer program draws; an older one may not know all of it."""
    ours, theirs = gzip.decompress(files("service.pages").joinpath(PROGRAM).read_bytes()).decode(), get_plotlyjs()
    versions = [re.search(r"plotly\.js (?:\(.*?\) )?v(\d+)\.(\d+)", text) for text in (ours[:200], theirs[:200])]
    assert versions[0]
    assert versions[1]
    assert [int(part) for part in versions[0].groups()] >= [int(part) for part in versions[1].groups()]


def test_an_axis_of_magnitudes_says_its_figures_whole(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    rollout(path)
    ticks = np.array([float(tick) for tick in looked_at(path)["ticks"]])
    assert len(ticks) > 8
    assert (np.diff(ticks) <= 0).sum() <= 1  # upwards, but from one plot to the next


def test_a_page_is_printed_where_there_is_a_browser(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_page(page, tmp_path / "page.html")
    if shutil.which("chromium"):
        print_page(tmp_path / "page.html", tmp_path / "page.pdf")
        printed = (tmp_path / "page.pdf").read_bytes()
        assert printed.startswith(b"%PDF-")
        assert len(printed) > 10_000  # plots are on it
        with pytest.raises(StorageError, match=r"no/page\.pdf"):
            print_page(tmp_path / "page.html", tmp_path / "no" / "page.pdf")
    monkeypatch.setenv("PATH", "")
    done = CliRunner().invoke(app, ["diagnose", "none.csv", "--robot", "d3-1200", "--out", str(tmp_path), "--pdf"])
    assert "printing needs Chromium, Chrome or Edge" in str(done.exception)  # and not that there is no log


def test_a_page_that_cannot_be_written_is_named(page: Page, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file: File exists"):
        write_page(page, tmp_path / "file" / "page.html")


def test_a_script_that_text_smuggles_in_does_not_run_and_nothing_is_sent(page: Page, tmp_path: Path) -> None:
    """Even where something was not escaped."""
    write_page(page, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]+)">', text)
    assert "default-src &#39;none&#39;" in policy
    assert "connect-src" not in policy
    smuggled = "<script>throw Error('smuggled in')</script><img src=x onerror=\"throw Error('handled')\">"
    bad = tmp_path / "bad.html"
    bad.write_text(text.replace("</h1>", f"</h1>{smuggled}", 1), encoding="utf-8")
    seen = looked_at(bad)
    assert seen["texts"] > 5
    assert not any("smuggled" in error or "handled" in error for error in seen["errors"])
