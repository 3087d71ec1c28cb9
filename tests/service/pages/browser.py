"""A page looked at in a real browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import StorageError
from service.pages import headless

# With all unfolded: every pair of texts of a plot, or of a text and the buttons above it, of a legend and a bar, or of
# two parts of the page, whose boxes cover each other by more than a pixel each way, every text that its plot's edge
# cuts off, and every console error.
LOOK = """
<script>
const errors=[];addEventListener('error',e=>errors.push(String(e.message)));
addEventListener('load',()=>drawn.then(()=>{unfold();setTimeout(()=>{
  const parts='h1,.headline,body>p,h2,.plot,table,.one,.muted';
  const boxes=[...document.querySelectorAll('svg text')].filter(t=>t.textContent.trim())
    .concat(...document.querySelectorAll('.modebar-group'))
    .concat(...document.querySelectorAll('.headline p'))
    .map(t=>[t.textContent||'buttons',t.getBoundingClientRect()]).filter(([,b])=>b.width&&b.height);
  const blocks=[...document.querySelectorAll(parts)].map(t=>[t.tagName+' '+t.textContent.slice(0,40),t,
    t.getBoundingClientRect()]).filter(([,,b])=>b.width&&b.height);
  const over=[];
  boxes.forEach(([a,p],i)=>boxes.slice(i+1).forEach(([b,q])=>{
    if(Math.min(p.right,q.right)-Math.max(p.left,q.left)>1&&Math.min(p.bottom,q.bottom)-Math.max(p.top,q.top)>1)
      over.push([a,b]);}));
  blocks.forEach(([a,s,p],i)=>blocks.slice(i+1).forEach(([b,t,q])=>{
    if(!s.contains(t)&&Math.min(p.right,q.right)-Math.max(p.left,q.left)>1
      &&Math.min(p.bottom,q.bottom)-Math.max(p.top,q.top)>1)over.push([a,b]);}));
  const legends=[...document.querySelectorAll('.legend .bg')].map(t=>t.getBoundingClientRect());
  document.querySelectorAll('.bars path,.modebar-group').forEach(t=>{const p=t.getBoundingClientRect();
    if(p.width&&legends.some(q=>q.width&&Math.min(p.right,q.right)-Math.max(p.left,q.left)>1
      &&Math.min(p.bottom,q.bottom)-Math.max(p.top,q.top)>1))over.push(['legend',t.getAttribute('class')||'bar']);});
  document.querySelectorAll('.plot').forEach(plot=>{const p=plot.getBoundingClientRect();
    plot.querySelectorAll('svg text').forEach(t=>{const q=t.getBoundingClientRect();
      if(q.width&&t.textContent.trim()&&(q.left<p.left-1||q.right>p.right+1||q.top<p.top-1||q.bottom>p.bottom+1))
        over.push(['edge of the plot',t.textContent]);});});
  const ticks=[...document.querySelectorAll('.ytick text')].map(t=>t.textContent);
  const root=document.documentElement, beyond=root.scrollWidth-root.clientWidth;
  if(beyond)document.querySelectorAll('body *').forEach(t=>{
    if(t.getBoundingClientRect().right>root.clientWidth+1&&!t.closest('table'))
      over.push(['window',t.tagName+' '+t.getAttribute('class')+' '+t.textContent.slice(0,30)]);});
  parent.postMessage(JSON.stringify({errors,over,ticks,beyond,texts:boxes.length}),'*');
},1000)}));
</script>
"""


BROWSER_TIME = 100  # s, several times what a page takes beside other tests
HEIGHT = 4000  # px of a window, and of a picture
# A window is at least 500 px wide, a frame in it as narrow as one likes.
FRAME = """<!doctype html><body style="margin:0"><iframe src="looked_at.html" width="{width}" height="{height}"
style="border:0"></iframe><script>addEventListener('message',({{data}})=>{{
const told=document.createElement('pre');
told.id='told';told.textContent=data;document.body.append(told);}});</script>"""


def looked_at(path: Path, width: int = 1200, dark: bool = False) -> dict[str, Any]:
    """`errors` of the console, pairs of texts `over` each other or an edge, number of `texts` in plots, `ticks` of
    upright axes, px by which the page is wider than its window (`beyond`), at a width of the window in px.

    Leaves a picture of it beside the page, `picture_of`. Skips without a browser.
    """
    try:
        browser = headless(path.parent / "profile")
    except StorageError as error:
        pytest.skip(str(error))
    if dark:
        browser.append("--blink-settings=preferredColorScheme=0")
    browser.append(f"--screenshot={picture_of(path, width, dark)}")
    text = path.read_text(encoding="utf-8")
    seen = path.with_name("looked_at.html")
    nonce = re.search(r"nonce-([\w-]+)", text)
    assert nonce, "a page without a policy of what it may do"
    look = LOOK.replace("<script>", f'<script nonce="{nonce[1]}">')
    seen.write_text(text.replace("<body>", f"{look}<body>", 1), encoding="utf-8")
    frame = path.with_name("frame.html")
    frame.write_text(FRAME.format(width=width, height=HEIGHT), encoding="utf-8")
    command = [*browser, f"--window-size={max(width, 500)},{HEIGHT}", "--dump-dom", frame.as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BROWSER_TIME, check=True)
    except subprocess.TimeoutExpired:  # seen where all processors are busy: it hangs before it has read the page
        done = subprocess.run(command, capture_output=True, text=True, timeout=BROWSER_TIME, check=True)
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-500:]
    return json.loads(unescape(found[1]))


def picture_of(path: Path, width: int, dark: bool = False) -> Path:
    """Where the picture of a page is, looked at with so wide a window."""
    return path.with_name(f"{path.stem}_{width}{'_dark' if dark else ''}.png")


def plots_of(page: str) -> list[dict[str, Any]]:
    """What `plots.js` draws on a page, which carries it packed."""
    packed = re.findall(r'<script type="text/plain" class="plot-data">(.*?)</script>', page)
    return [json.loads(gzip.decompress(base64.b64decode(one))) for one in packed]
