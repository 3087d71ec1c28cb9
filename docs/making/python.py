"""The reference page of the package `deltatwin`: what its `__all__` promises, by mkdocstrings from the docstrings."""

from __future__ import annotations

import importlib
import importlib.util

OPTIONS = """
    options:
      heading_level: 3
      show_root_heading: true
      show_root_full_path: false
      show_source: false
      members_order: source
"""


def is_there() -> bool:
    """Whether there is such a package."""
    return importlib.util.find_spec("deltatwin") is not None


def page() -> str:
    """Functions, results, then errors."""
    package = importlib.import_module("deltatwin")
    functions = [name for name in package.__all__ if name[0].islower()]
    errors = [name for name in package.__all__ if name.endswith("Error")]
    classes = [name for name in package.__all__ if name not in functions and name not in errors]
    text = (
        "# Python\n\n`import deltatwin`: everything listed here keeps its meaning from one minor version to the next. "
        "How to use it: [Use it from Python](../how-to/from-python.md).\n"
    )
    for title, names in (("Functions", functions), ("Classes", classes), ("Errors", errors)):
        text += f"\n## {title}\n\n" + "\n".join(f"::: deltatwin.{name}{OPTIONS}" for name in names)
    return text
