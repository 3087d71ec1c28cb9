"""A page looked at in a real browser."""

from __future__ import annotations

import json
import re
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import StorageError
from service.pages import headless

# Every pair of texts of a plot, or of a text and the buttons above it, whose boxes cover each other by more than a
# pixel each way, and every console error.
LOOK = """
<script>
const errors=[];addEventListener('error',e=>errors.push(String(e.message)));
addEventListener('load',()=>setTimeout(()=>{
  const boxes=[...document.querySelectorAll('svg text')].filter(t=>t.textContent.trim())
    .concat(...document.querySelectorAll('.modebar-group'))
    .map(t=>[t.textContent||'buttons',t.getBoundingClientRect()]).filter(([,b])=>b.width&&b.height);
  const over=[];
  boxes.forEach(([a,p],i)=>boxes.slice(i+1).forEach(([b,q])=>{
    if(Math.min(p.right,q.right)-Math.max(p.left,q.left)>1&&Math.min(p.bottom,q.bottom)-Math.max(p.top,q.top)>1)
      over.push([a,b]);}));
  const told=document.createElement('pre');told.id='told';
  const ticks=[...document.querySelectorAll('.ytick text')].map(t=>t.textContent);
  told.textContent=JSON.stringify({errors,over,ticks,texts:boxes.length});document.body.append(told);
},1000));
</script>
"""


def looked_at(path: Path) -> dict[str, Any]:
    """`errors` of the console, pairs of texts `over` each other, number of `texts` in plots, `ticks` of upright axes.

    Skips without a browser.
    """
    try:
        browser = headless(path.parent / "profile")
    except StorageError as error:
        pytest.skip(str(error))
    text = path.read_text(encoding="utf-8")
    seen = path.with_name("looked_at.html")
    nonce = re.search(r"nonce-([\w-]+)", text)
    assert nonce, "a page without a policy of what it may do"
    look = LOOK.replace("<script>", f'<script nonce="{nonce[1]}">')
    seen.write_text(text.replace("<body>", f"{look}<body>", 1), encoding="utf-8")
    done = subprocess.run(
        [*browser, "--window-size=1200,2000", "--dump-dom", seen.as_uri()],
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-500:]
    return json.loads(unescape(found[1]))
