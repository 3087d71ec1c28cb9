"""What do the pages look like? One look for all of them; each is one file that needs no network."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.diagnosis import named_joints
from schemas.files import make_folder, write_text

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from jinja2 import Environment
    from markupsafe import Markup

CONFIG = {"responsive": True, "displaylogo": False}


def write_page(template: str, path: Path, **fields: Any) -> None:
    """Fill `templates/<template>.html` with `fields` and write it to `path`. Whatever is no markup is escaped.

    Raises:
        StorageError: it cannot be written.
    """
    text = _environment().get_template(f"{template}.html").render(fields)
    make_folder(path.parent)
    write_text(path, text)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    environment = Environment(
        loader=PackageLoader(__name__), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"plot": _plot, "named_joints": named_joints}
    environment.globals["plotly"] = Markup(get_plotlyjs())
    return environment


def _plot(figure: go.Figure) -> Markup:
    from markupsafe import Markup

    return Markup(figure.to_html(full_html=False, include_plotlyjs=False, config=CONFIG))
