"""Pages in a real browser: nothing fetched, nothing lies over anything, foreign text stays text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import StorageError
from service.experiment.pictures import Figure, Line, Page, PageTable, Panel, write_page
from tests.service.pages.browser import looked_at


@pytest.fixture
def page() -> Page:
    time = np.linspace(0, 10, 50)
    panels = tuple(
        Panel("time / s", "error / mrad", (Line("measured", time, np.sin(time + joint)),), f"joint {joint + 1}")
        for joint in range(3)
    )
    return Page(
        "Loop of <script>alert(1)</script>",
        ("A lead & more.",),
        (
            PageTable("Errors", ("what", "N m"), (("<b>bold</b>", "1.0"),), "a note"),
            Figure("f", "Over time", "c", panels),
        ),
    )


def test_foreign_text_stays_text_and_nothing_is_fetched(page: Page, tmp_path: Path) -> None:
    write_page(page, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    outside = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)  # plotly itself names addresses
    assert "Loop of &lt;script&gt;alert(1)&lt;/script&gt;" in outside
    assert "&lt;b&gt;bold&lt;/b&gt;" in outside
    assert "A lead &amp; more." in outside
    assert not re.search(r"\b(src|href)\s*=|@import|url\(", outside)
    assert not re.search(r"<script[^>]*\bsrc=", text)


def test_no_text_lies_over_text(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(page, path)
    told = looked_at(path)
    assert told["texts"] > 20  # the plots are drawn
    assert told["errors"] == []
    assert told["over"] == []


def test_a_page_that_cannot_be_written_is_named(page: Page, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file: File exists"):
        write_page(page, tmp_path / "file" / "page.html")
