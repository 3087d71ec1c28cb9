"""The site is built without a warning, and a reader's browser fetches nothing for it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.errors import StorageError
from service.pages import headless
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.timeout(1500)  # on a busy machine
pytest.importorskip("mkdocs", reason="needs the dependency group docs: uv sync --group docs")
FETCHED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=[\"']?(?:https?:)?//[^>]*>")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=1200, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_nothing_is_fetched(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 100
    for page in pages:
        found = [tag for tag in FETCHED.findall(page.read_text(encoding="utf-8")) if 'rel="canonical"' not in tag]
        assert found == [], page.name
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import\s+)[\"']?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name


@pytest.mark.slow
def test_nothing_is_escaped_that_a_reader_sees(site: Path) -> None:
    """A backslash before what Markdown would have read is not part of the text."""
    seen = re.compile(r".{0,30}\\(?:[|_*\[\]<>]|&lt;|&gt;).{0,15}")
    for page in sorted(site.rglob("*.html")):
        text = re.sub(r"<pre.*?</pre>|<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert seen.findall(text) == [], page.name


@pytest.mark.slow
def test_every_page_is_in_the_menu_of_the_first(site: Path) -> None:
    menu = (site / "index.html").read_text(encoding="utf-8")
    for page in ("reference/effects/backlash.html", "reference/commands/diagnose.html", "how-to/faults.html"):
        assert page in menu
    assert not list(site.rglob("*.py"))


@pytest.mark.slow
def test_search_works_from_a_folder(site: Path, tmp_path: Path) -> None:
    try:
        browser = headless(tmp_path)
    except StorageError as error:
        pytest.skip(str(error))
    done = subprocess.run(
        [*browser, "--virtual-time-budget=10000", "--dump-dom", f"{(site / 'index.html').as_uri()}?q=backlash"],
        capture_output=True, text=True, timeout=200, check=True,
    )  # fmt: skip
    assert 'href="reference/effects/backlash.html' in done.stdout.split("md-search-result__list", 1)[1]
