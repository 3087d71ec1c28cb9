"""The notebooks of the documentation run from the first cell to the last, and show something in each."""

from __future__ import annotations

import ast
import json
from typing import Any

import pytest

from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "docs" / "how-to"


def run(name: str) -> dict[str, Any]:
    """The names that a notebook leaves, each of whose cells shows something."""
    cells = json.loads((FOLDER / name).read_text(encoding="utf-8"))["cells"]
    shown, names = [], {}
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        assert not cell["outputs"], "kept without outputs"
        shown.append(last_value("".join(cell["source"]), names))
    assert shown
    assert all(value is not None for value in shown)
    return names


def test_every_cell_runs_and_shows_something() -> None:
    names = run("notebook.ipynb")
    assert names["diagnosis"].document.gap.torque_nm
    assert names["picked"].levels


def test_the_servo_axis_is_the_published_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Janot, Gautier, Brunot 2019: 95.1089 kg; 166.7 and 240.3 N s/m by direction."""
    monkeypatch.chdir(FOLDER)
    names = run("servo-axis.ipynb")
    assert names["known"].robot.identified.inertia.value == pytest.approx([95.1089], rel=0.01)
    (effect,) = names["diagnosis"].document.effects
    viscous, more = names["diagnosis"].document.base["f_v_1"].value, effect.parameters["delta_v"].value
    assert (viscous + more, viscous - more) == pytest.approx((166.7, 240.3), rel=0.01)


def last_value(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; what its last line gives, as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body.pop()
    assert isinstance(last, ast.Expr)
    exec(compile(tree, "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)
