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
from service.cli.main import app
from service.experiment.pictures import Figure, Line, Page, PageTable, Panel, write_page
from service.pages import LOOK, MOST_BYTES, PROGRAM, Headline, print_page
from tests.service.pages.browser import looked_at, picture_of, plots_of
from tests.service.pages.drawn import closed_loop
from tests.service.pages.kinds import PAGES, rollout, written

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


@pytest.mark.parametrize("kind", PAGES)
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


def many_curves(path: Path) -> None:
    """As many as no page has now, each as long as a log of 20 s."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 20.0, 1e-3)
    lines = tuple(Line(f"model {k}", time, rng.standard_normal(len(time))) for k in range(20))
    figures = tuple(Figure(f"f{k}", "Over time", "c", (Panel("time / s", "N m", lines),)) for k in range(6))
    write_page(Page("t", SAID, figures[0], (), figures), path)


def long_closed_loop(path: Path) -> None:
    closed_loop(np.random.default_rng(0), path, 1e-3, 10.5)


LARGE = {"many curves": many_curves, "closed loop of 10 s at 1 kHz": long_closed_loop}


@pytest.mark.parametrize("kind", [*PAGES, *LARGE])
def test_pages_are_small(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "page.html"
    LARGE[kind](path) if kind in LARGE else written(kind, path)
    assert path.stat().st_size <= MOST_BYTES == 1_500_000


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
