"""The notebook of the documentation runs from its first cell to its last, and shows something in each."""

from __future__ import annotations

import ast
import json
from typing import Any

from tests.conftest import REPOSITORY

NOTEBOOK = REPOSITORY / "docs" / "how-to" / "notebook.ipynb"


def test_every_cell_runs_and_shows_something() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    shown, names = [], {}
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        assert not cell["outputs"], "kept without outputs"
        shown.append(last_value("".join(cell["source"]), names))
    assert len(shown) == 9
    assert all(value is not None for value in shown)
    found = names["diagnosis"].document
    assert found.gap.torque_nm
    assert names["picked"].levels


def last_value(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; what its last line gives, as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body.pop()
    assert isinstance(last, ast.Expr)
    exec(compile(tree, "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)
