"""What MkDocs calls: pages made from the code join those that are written, and every page has its place in the menu.

`docs/making` has nothing else that knows the site generator, as Material for MkDocs ends in May 2027: its successor,
Zensical, takes the same pages and configuration, and `made()` can as well be written to a folder for it.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # MkDocs runs this file by its path


def on_files(files: Files, config: Any) -> Files:
    """Add what is made from the code, and put what the menu does not name behind its section."""
    from docs.making.pages import made

    for path, text in made().items():
        files.append(File.generated(config, path, content=text))
    named = set(_named(config.nav))
    for section in config.nav:
        if isinstance(section, dict):
            for title, entries in section.items():
                section[title] = entries + _rest(files, entries, named)
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put figures in."""
    from docs.making.figures import filled

    return filled(markdown)


def _named(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    inner = nav.values() if isinstance(nav, dict) else nav
    return [path for entry in inner for path in _named(entry)]


def _rest(files: Files, entries: list[Any], named: set[str]) -> list[Any]:
    """Pages of the section's folder that stand nowhere; those of a folder inside it as a section of their own."""
    top = entries[0].split("/")[0]
    rest: list[Any] = []
    inner: dict[str, list[str]] = {}
    for file in files.documentation_pages():
        parts = file.src_uri.split("/")
        if parts[0] != top or file.src_uri in named:
            continue
        if len(parts) == 2:
            rest.append(file.src_uri)
        else:
            inner.setdefault(parts[1], []).append(file.src_uri)
    for folder, paths in inner.items():
        order = sorted(paths, key=lambda path: (not path.endswith("/index.md"), path))
        rest.append({re.sub("-", " ", folder).capitalize(): order})
    return rest
