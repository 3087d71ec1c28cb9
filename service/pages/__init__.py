"""What do the pages look like? One look for all of them; each is one file that needs no network."""

from __future__ import annotations

import gzip
import json
import os
import secrets
import shlex
import shutil
import subprocess
import tempfile
from base64 import b64encode
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from plotly.io import templates

from schemas.diagnosis import named_joints
from schemas.errors import StorageError
from schemas.files import make_folder, whole, write_text
from schemas.words import counted, fixed, interval, percent, significant, words
from service.pages.curves import WIDTH, reduced

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from jinja2 import Environment
    from markupsafe import Markup

CONFIG = {"responsive": True, "displaylogo": False}
BELOW = {"ticklabelstandoff": 4}  # px: in a corner ticks of two axes would meet
# Of plots that say nothing else.
LOOK = {"font": {"size": 12}, "margin": {"l": 60, "r": 20, "t": 40, "b": 45}, "xaxis": BELOW}
POWERS = range(-12, 13)  # of ten, that a logarithmic axis has ticks at
CLOSE = 3.0  # decades of an axis on which ticks at 1, 2 and 5 have room
NONCE = secrets.token_urlsafe(16)  # of this process's pages: a script that a log's text smuggles in does not have it
# What a page may do: run our scripts, draw, and nothing over a network.
POLICY = (
    f"default-src 'none'; script-src 'nonce-{NONCE}'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "base-uri 'none'; form-action 'none'"
)
LEGEND_Y = 34  # px below the upper edge of a plot, under Plotly's buttons
templates.default = None  # a figure gets its look when it is written: every one would copy and check Plotly's own
PROGRAM = "plotly-cartesian.min.js.gz"  # plotly.js with lines, bars and maps alone, a third of the whole (MIT licence)
MOST_BYTES = 1_500_000  # of a page: it is sent by mail, and opens at once
LEAST_WIDTH = 100  # px, for which curves are drawn at the coarsest
DEFAULT_HEIGHT = 450  # px, Plotly's
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")  # that print without a window
PRINTING_S = 120.0  # a page takes seconds


def logarithmic(figure: go.Figure, letter: Literal["x", "y"], row: int | None = None) -> None:
    """Make the x or y axes of a row of plots, or of all of them, logarithmic, with ticks that do not cover each other.

    Plotly itself would say 5 for 0.05.
    """
    drawn = [np.asarray(getattr(trace, letter), float) for trace in figure.select_traces(row=row)]
    values = np.concatenate([one[one > 0.0] for one in drawn])
    far = values.size > 0 and np.log10(values.max() / values.min()) > CLOSE
    ticks = [(digit, power) for power in POWERS for digit in ((1,) if far else (1, 2, 5))]
    axis = {
        "type": "log",
        "tickvals": [digit * 10.0**power for digit, power in ticks],
        "ticktext": [_magnitude(digit, power) for digit, power in ticks],
    }
    if letter == "x":
        figure.update_xaxes(axis, row=row)
    else:
        figure.update_yaxes(axis, row=row)


def _magnitude(digit: int, power: int) -> str:
    plain = f"{digit * 10.0**power:g}"
    if "e" not in plain:
        return plain
    return (f"{digit}×" if digit > 1 else "") + f"10<sup>{power}</sup>"


@dataclass(frozen=True)
class Headline:
    """What a page says first: the answer in a sentence, one number and what it is of, what to do next, and lines of
    more.

    tone: "good" needs nothing done, "bad" does, and of "open" the data cannot say; "told" judges nothing. command:
    words of the command that takes the step, behind `deltatwin`. own: a word of them, in capitals, in whose place the
    user puts something of his own, and what that is.
    """

    tone: Literal["good", "bad", "open", "told"]
    answer: str
    number: str
    of: str
    step: str
    lines: tuple[str, ...] = ()
    command: tuple[object, ...] = ()
    own: str = ""

    @property
    def following(self) -> str:
        """The command, as it is pasted."""
        return shlex.join(("deltatwin", *map(str, self.command))) if self.command else ""


def write_page(template: str, path: Path, headline: Headline, **fields: Any) -> None:
    """Fill `templates/<template>.html` with `fields` and write it to `path`. Whatever is no markup is escaped. Curves
    have no more points than a screen shows, and so few that the page is not above `MOST_BYTES`.

    Raises:
        StorageError: it cannot be written.
    """
    page, width = _environment().get_template(f"{template}.html"), WIDTH
    text = page.render(fields, headline=headline, width=width)
    while len(text.encode()) > MOST_BYTES and width > LEAST_WIDTH:  # so many curves: each is drawn coarser
        width //= 2
        text = page.render(fields, headline=headline, width=width)
    make_folder(path.parent)
    write_text(path, text)


def under_buttons(height: float, titles: bool = False) -> dict[str, Any]:
    """Layout of a plot so high, px, with its legend in a row between Plotly's buttons and the axes, where nothing lies
    over it. titles: of subplots, which come between."""
    legend = {"orientation": "h", "yref": "container", "y": 1 - LEGEND_Y / height, "yanchor": "top", "x": 0}
    return {"height": height, "margin": {"t": 2 * LEGEND_Y + 22 * titles}, "legend": legend}


def browser() -> str:
    """What prints pages here.

    Raises:
        StorageError: there is none.
    """
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise StorageError(f"printing needs Chromium, Chrome or Edge: none of {', '.join(BROWSERS)} is on the path")
    return found


def headless(profile: Path) -> list[str]:
    """How a browser without a window is called, with what it keeps in the folder `profile`.

    Raises:
        StorageError: there is none.
    """
    kept = f"--user-data-dir={profile}"
    command = [browser(), "--headless=new", "--disable-gpu", "--virtual-time-budget=10000", kept]
    if getattr(os, "geteuid", lambda: 1)() == 0:
        command.append("--no-sandbox")  # without which it does not start for root; what it shows is ours
    return command


def print_page(page: Path, out: Path) -> None:
    """Print a page that was written as a PDF.

    Raises:
        StorageError: there is no browser, or it does not print.
    """
    with whole(out) as partial, tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [*headless(Path(profile)), "--no-pdf-header-footer", f"--print-to-pdf={partial.resolve()}"]
        command.append(page.resolve().as_uri())
        try:
            said = subprocess.run(command, capture_output=True, text=True, timeout=PRINTING_S, check=False).stderr
        except subprocess.TimeoutExpired:
            said = f"not done after {PRINTING_S:g} s"
        if not partial.is_file() or not partial.stat().st_size:
            raise StorageError(f"{out}: {command[0]} does not print: {said.strip()[-200:]}")


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader(__name__), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    for filter_ in (named_joints, words, counted, percent, significant, interval, fixed):
        environment.filters[filter_.__name__] = filter_
    environment.filters |= {"plot": _plot, "code": _code}
    environment.globals |= {"policy": POLICY, "nonce": NONCE}
    environment.globals["plotly"] = Markup(b64encode(files(__name__).joinpath(PROGRAM).read_bytes()).decode("ascii"))
    return environment


def _code(text: str) -> Markup:
    """A text with the commands in it, which stand between backquotes."""
    from markupsafe import Markup, escape

    parts = [escape(part) for part in text.split("`")]
    return Markup("").join(Markup("<code>{}</code>").format(part) if n % 2 else part for n, part in enumerate(parts))


def _plot(figure: go.Figure, width: int) -> Markup:
    """A place for the plot and, packed, what `plots.js` draws there. width: px, for which curves are drawn."""
    from markupsafe import Markup
    from plotly.utils import PlotlyJSONEncoder

    drawn: Any = figure.to_plotly_json()
    drawn["layout"]["template"] = _look()
    whole = {"data": reduced(drawn, width), "layout": drawn["layout"], "config": CONFIG}
    text = json.dumps(whole, cls=PlotlyJSONEncoder, separators=(",", ":"))
    packed = b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")
    height = drawn["layout"].get("height", DEFAULT_HEIGHT)
    place = f'<div class="plotly-graph-div" style="height:{height:g}px"></div>'
    return Markup(f'{place}<script type="text/plain" class="plot-data">{packed}</script>')


@cache
def _look() -> dict[str, Any]:
    """Plotly's white template with ours on top. From its file: Plotly would make objects of it, and check them, for
    longer than a page takes."""
    white = json.loads((files("plotly") / "package_data" / "templates" / "plotly_white.json").read_text("utf-8"))
    layout = white["layout"]
    return white | {"layout": layout | {key: layout.get(key, {}) | value for key, value in LOOK.items()}}
