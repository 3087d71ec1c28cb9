"""What Griffe is told of our docstrings: the section `Example:` holds code, as `Examples:` does."""

from __future__ import annotations

import re
from typing import Any

import griffe


class ExampleHoldsCode(griffe.Extension):
    """Without it a comparison in an example is taken for a link."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
