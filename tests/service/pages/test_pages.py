"""Pages in a real browser: nothing fetched, nothing lies over anything, foreign text stays text."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import StorageError
from service.experiment.pictures import Figure, Line, Page, Panel, Table, write_page

# Every pair of texts of a plot whose boxes cover each other by more than a pixel each way, and every console error.
LOOK = """
<script>
const errors=[];addEventListener('error',e=>errors.push(String(e.message)));
addEventListener('load',()=>setTimeout(()=>{
  const boxes=[...document.querySelectorAll('svg text')].filter(t=>t.textContent.trim())
    .map(t=>[t.textContent,t.getBoundingClientRect()]).filter(([,b])=>b.width&&b.height);
  const over=[];
  boxes.forEach(([a,p],i)=>boxes.slice(i+1).forEach(([b,q])=>{
    if(Math.min(p.right,q.right)-Math.max(p.left,q.left)>1&&Math.min(p.bottom,q.bottom)-Math.max(p.top,q.top)>1)
      over.push([a,b]);}));
  const told=document.createElement('pre');told.id='told';
  told.textContent=JSON.stringify({errors,over,texts:boxes.length});document.body.append(told);
},1000));
</script>
"""


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
        (Table("Errors", ("what", "N m"), (("<b>bold</b>", "1.0"),), "a note"), Figure("f", "Over time", "c", panels)),
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
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("chromium is not installed")
    path = tmp_path / "page.html"
    write_page(page, path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("<body>", f"{LOOK}<body>", 1), encoding="utf-8")
    done = subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--window-size=1200,2000", "--virtual-time-budget=10000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-500:]
    told = json.loads(unescape(found[1]))
    assert told["texts"] > 20  # the plots are drawn
    assert told["errors"] == []
    assert told["over"] == []


def test_a_page_that_cannot_be_written_is_named(page: Page, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file: File exists"):
        write_page(page, tmp_path / "file" / "page.html")
