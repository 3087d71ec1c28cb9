"""A column mapping that contradicts the units that the file itself gives: read as mapped, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.trace import read_trace
from schemas.columns import Columns

ROWS = 50


def mapping(unit_row: bool, position: str, torque: str, time: str = "s", names: str = "q{}") -> Columns:
    return Columns.model_validate({
        "joints": 1,
        "data_line": 3 if unit_row else 2,
        "time": {"name": "t", "unit": time},
        "position": {"name": names.format(1), "unit": position},
        "torque": {"name": "m1", "unit": torque},
    })  # fmt: skip


def table(folder: Path, units: str, name: str = "q1") -> Path:
    path = folder / "log.csv"
    rows = [f"{0.001 * k:.3f},{0.1 * np.sin(0.1 * k):.6f},{np.cos(0.1 * k):.6f}" for k in range(ROWS)]
    path.write_text("\n".join([f"t,{name},m1", *([units] if units else []), *rows, ""]))
    return path


def notes(path: Path, columns: Columns) -> list[str]:
    return [finding.message for finding in read_trace(path, None, columns).findings]


def test_a_unit_of_the_file_that_the_mapping_contradicts_is_said(tmp_path: Path) -> None:
    path = table(tmp_path, "s,rad,Nm")
    assert notes(path, mapping(True, "rad", "N m")) == []
    (note,) = notes(path, mapping(True, "deg", "N m"))
    assert note == "position_1 ('q1'): the file says 'rad', the mapping 'deg'; read as deg"
    turned = read_trace(path, None, mapping(True, "deg", "N m")).position
    assert turned == pytest.approx(np.deg2rad(read_trace(path, None, mapping(True, "rad", "N m")).position))


@pytest.mark.parametrize(
    ("units", "said"),
    [("s,Furlong,Nm", "Furlong"), ("s,Nm,Nm", "Nm"), ("s,rpm,Nm", "rpm"), ("[s],[mrad],[Nm]", "mrad")],
)
def test_so_is_one_that_is_no_unit_of_a_position(tmp_path: Path, units: str, said: str) -> None:
    (note,) = notes(table(tmp_path, units), mapping(True, "deg", "N m"))
    assert f"the file says {said!r}" in note


def test_a_unit_in_a_columns_name_is_one_too(tmp_path: Path) -> None:
    path = table(tmp_path, "", "q1 [rad]")
    (note,) = notes(path, mapping(False, "deg", "N m", names="q{} [rad]"))
    assert "the file says 'rad'" in note
    assert notes(table(tmp_path, "", "axis 1"), mapping(False, "deg", "N m", names="axis {}")) == []


def test_stamps_have_a_unit_too(tmp_path: Path) -> None:
    (note,) = notes(table(tmp_path, "ms,deg,Nm"), mapping(True, "deg", "N m"))
    assert note == "time ('t'): the file says 'ms', the mapping 's'; read as s"


def test_a_table_of_another_format_says_it_as_well(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    rows = (f'{{"t": {0.001 * k}, "q1_deg": {np.sin(0.1 * k)}, "m1": {np.cos(0.1 * k)}}}' for k in range(ROWS))
    path.write_text("\n".join(rows))
    said = "position_1 ('q1_deg'): the file says 'deg', the mapping 'rad'; read as rad"
    assert said in notes(path, mapping(False, "rad", "N m", names="q{}_deg"))
    assert not any("mapping" in note for note in notes(path, mapping(False, "deg", "N m", names="q{}_deg")))
