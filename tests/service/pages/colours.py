"""What the colours of a page's plots mean."""

from __future__ import annotations

from typing import Any

from service.pages.palette import Colour, faint
from tests.service.pages.browser import plots_of


def colours_of(plot: dict[str, Any]) -> dict[str, str]:
    """Colour of each named line or bar."""
    found = {}
    for trace in plot["data"]:
        mark = trace.get("marker", {}).get("color") or trace.get("line", {}).get("color")
        if trace.get("name") and mark and trace["type"] in ("bar", "scatter"):
            found[trace["name"]] = mark
    return found


def bands_of(plot: dict[str, Any]) -> set[str]:
    """Colours of the bands around lines."""
    return {trace["fillcolor"] for trace in plot["data"] if "fillcolor" in trace}


def meanings(page: str) -> dict[str, set[str]]:
    """Colours of each name on a page. All are of the palette, no plot has one twice, a band has that of its line."""
    meaning: dict[str, set[str]] = {}
    for plot in plots_of(page):
        colours = colours_of(plot)
        assert set(colours.values()) <= {str(colour) for colour in Colour}, colours
        assert len(set(colours.values())) == len(colours), colours
        assert bands_of(plot) <= {faint(Colour(colour)) for colour in colours.values()}, colours
        for name, colour in colours.items():
            meaning.setdefault(name, set()).add(colour)
    return meaning
