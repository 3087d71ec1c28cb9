"""A URDF that does not fit: one line that names file, joint and what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.axes_description import load_axes, save_description
from schemas.chain_description import Chain
from schemas.errors import RobotError
from tests.service import arm


def changed(old: str, new: str) -> Callable[[Path], Path]:
    """A description and its URDF, one text in either replaced."""

    def write(folder: Path) -> Path:
        path = arm.write(folder)
        for file in (path, folder / "small.urdf"):
            text = file.read_text()
            file.write_text(text.replace(old, new, 1))
        return path

    return write


L2 = arm.LINK.format(name="l2", xyz="0.15 0.01 0.02", mass=3, ixx=0.01, iyy=0.04, izz=0.04)


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (changed('"j1", "j2", "j3"', '"j1", "j2", "j4"'), "no joint 'j4'; those that move: j1, j2, j3, grip"),
        (changed('joints = ["j1", "j2", "j3"]', 'joints = ["j1", "j2"]'), "joint 'j3' moves, too: name it in `joints`"),
        (changed('held = ["grip"]', ""), "joint 'grip' moves, too"),
        (changed('"j2", "j3"]\nheld = ["grip"]', '"j2"]'), "joints 'j3', 'grip' move, too: name them in `joints`"),
        (
            changed('joints = ["j1", "j2", "j3"]', ""),
            "joints: missing key; joints of small.urdf that turn: j1, j2, j3",
        ),
        (changed('"j3"]', '"j3", "mount"]'), "joint 'mount' is fixed"),
        (changed('"j3"]', '"j3", "j1"]'), "joints: 'j1' is named twice"),
        (changed(L2, '<link name="l2"/>'), "link 'l2' moves with joint 'j2' and has no mass"),
        (changed('mass value="3"', 'mass value="0"'), "link 'l2' moves with joint 'j2' and has no mass"),
        (changed('mass value="3"', 'mass value="-3"'), "link 'l2': mass -3 kg"),
        (changed('mass value="3"', 'mass value="heavy"'), "link 'l2': <mass value> is 'heavy', a number is needed"),
        (changed('name="j1" type="revolute"', 'name="j1" type="floating"'), "joint 'j1' is floating"),
        (changed('name="j3" type="revolute"', 'name="j3" type="prismatic"'), "joint 'j3' is prismatic"),
        (changed('<origin xyz="0.3 0 0"', '<mimic joint="j2"/><origin xyz="0.3 0 0"'), r"'j3' follows 'j2' \(mimic\)"),
        (changed('<child link="l3"/>', '<child link="l9"/>'), "joint 'j3': its child 'l9' is not a link"),
        (changed('<robot name="small">', "<arm>"), "not a URDF"),
        (changed("<robot", '<!DOCTYPE x [<!ENTITY a "b">]><robot'), "not a URDF"),
        (changed("small.urdf", "other.urdf"), "other.urdf: No such file"),
        (changed("held =", 'payload = { frame = "flange", mass_kg = 1 }\nheld ='), "no link 'flange'"),
        (changed("held =", 'payload = { frame = "tool" }\nheld ='), "payload: its mass is not separable"),
        (changed("held =", "gear_ratio = [1, 2]\nheld ="), "gear_ratio: 2 values for 3 joints"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(tmp_path: Path, write: Callable[[Path], Path], words: str) -> None:
    with pytest.raises(RobotError, match=words) as told:
        load_axes(write(tmp_path))
    assert "\n" not in str(told.value)
    assert str(tmp_path) in str(told.value)


def test_a_file_written_elsewhere_finds_its_urdf_and_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arm.write(tmp_path, more='columns = "names.toml"\n')
    (tmp_path / "names.toml").write_text('joints = 3\nposition = "q{joint}"\ntorque = "y{joint}"\n')
    monkeypatch.chdir(tmp_path)
    description = load_axes("small.toml")
    (tmp_path / "out").mkdir()
    save_description(description, Path("out/again.toml"))
    again = load_axes(Path("out/again.toml"))
    assert isinstance(again, Chain)
    assert isinstance(description, Chain)
    assert again.arm.text == description.arm.text
    assert again.mapping is not None
    assert Path(again.mapping).samefile(tmp_path / "names.toml")
