"""Robot descriptions: what is wrong is named by file, key and value; what a user wrote survives a save."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from schemas.errors import RobotError, StorageError
from schemas.fitted import JointParameter, Parameter
from schemas.robot import EffectEntry, EffectParameter, Identified, Robot, load_robot, save_robot

TEXT = """# line 3, cell B
name = "d3-1200" # as on the type plate
gravity_mps2 = 9.81

[geometry] # metres
active_link_length = 0.38 # measured 2024
passive_link_length = 0.86
base_radius = 0.22
platform_radius = 0.05

# kilograms, from the CAD
[mass]
active_link = 2.6
passive_link = 0.6 # both rods
platform = 1.4

[drive]
gear_ratio = 5 # Wittenstein
"""


def load(tmp_path: Path, text: str) -> Robot:
    (tmp_path / "r.toml").write_text(text, encoding="utf-8")
    return load_robot(tmp_path / "r.toml")


def test_a_plain_robot(tmp_path: Path) -> None:
    robot = load(tmp_path, TEXT)
    assert (robot.name, robot.drive.gear_ratio, robot.mass.passive_link) == ("d3-1200", 5.0, 0.6)
    assert robot.arm_angles == pytest.approx([0, 2 * math.pi / 3, 4 * math.pi / 3])
    assert robot.identified is None


def test_every_robot_of_the_recorded_cases_loads(data: Path) -> None:
    paths = [*data.glob("p*_logs/*/robot.toml")]
    assert len(paths) == 12
    assert all(load_robot(path).geometry.active_link_length > 0 for path in paths)


ONE, TWO = (f"\n[identified]\ntorque_noise_nm = {{value = {v}}}\n#" for v in ([1], [1, 2]))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("base_radius = 0.22", "base_radious = 0.22", r"geometry\.base_radious: unknown key \(value 0\.22\)"),
        ("platform_radius = 0.05", "platform_radius = 0.05\nrod = 1.5", r"geometry\.rod: unknown key \(value 1\.5\)"),
        ("[drive]", "colour = 'red'\n[drive]", r"mass\.colour: unknown key \(value 'red'\)"),
        ("[drive]", "[drives]", r"drives: unknown key \(value \{'gear_ratio': 5\}\)"),
        ("platform = 1.4\n", "", r"mass\.platform: missing key"),
        ('name = "d3-1200"', "", r"name: missing key"),
        ("[geometry] # metres", "[mass2]", r"geometry: missing key|mass2: unknown key"),
        ("0.86", '"long"', r"geometry\.passive_link_length: .*valid number.*\(got 'long'\)"),
        ("0.86", "[0.86]", r"geometry\.passive_link_length: .*\(got \[0\.86\]\)"),
        ("0.86", "0x" + 5000 * "f", r"geometry\.passive_link_length: .*\(got a number of thousands of digits\)"),
        ("0.86", repr(1000 * "x"), r"geometry\.passive_link_length: .*\(got 'x{99}\.\.\.\)"),
        ("0.86", "nan", r"geometry\.passive_link_length: .*\(got nan\)"),
        ("9.81", "inf", r"gravity_mps2: .*\(got inf\)"),
        ("9.81", "-9.81", r"gravity_mps2: .*greater than 0.*\(got -9\.81\)"),
        ("9.81", "[0, 9.81]", r"gravity_mps2: .*at least 3 items.*\(got \[0, 9\.81\]\)"),
        ("9.81", "[0, 0, 0.0]", r"gravity_mps2: must have a direction"),
        ("9.81", "true", r"gravity_mps2: .*list.*\(got True\)"),
        ("platform = 1.4", "platform = 0", r"mass\.platform: .*greater than 0.*\(got 0\)"),
        ("active_link = 2.6", "active_link = -2.6", r"mass\.active_link: .*greater than or equal to 0.*\(got -2\.6\)"),
        ("gear_ratio = 5", 'gear_ratio = "5"', r"drive\.gear_ratio: .*valid number.*\(got '5'\)"),
        ("gear_ratio = 5", "gear_ratio = true", r"drive\.gear_ratio: .*valid number.*\(got True\)"),
        ("gear_ratio = 5", "gear_ratio = 0", r"drive\.gear_ratio: .*greater than 0.*\(got 0\)"),
        ("0.86", "0.5", r"geometry: passive_link_length 0\.5 m does not reach the axis: it must exceed .* = 0\.55 m"),
        ("base_radius = 0.22", "base_radius = 2.2", r"geometry: passive_link_length 0\.86 m does not reach"),
        ("0.86", "860", r"geometry\.passive_link_length: .*860 m: .*lengths are in metres \(is it 0\.86 m\?\)"),
        ("[mass]", "arm_angles_deg = [0, 120]\n[mass]", r"geometry\.arm_angles_deg: .*at least 3"),
        ("[mass]", "arm_angles_deg = [0, 5, 240]\n[mass]", r"geometry: arm_angles_deg \[0\.0, 5\.0, 240\.0\]: arms"),
        ("[mass]", "arm_angles_deg = [0, 60, 120]\n[mass]", r".*not all on one side"),
        ("[mass]", "joint_range_rad = [1.0, -1.0]\n[mass]", r"geometry: joint_range_rad \[1\.0, -1\.0\]"),
        ('"d3-1200"', '"d3/1200"', r"name: robot name 'd3/1200'|name: .*'d3/1200'"),
        ('"d3-1200"', '"*"', r"name: .*'\*'"),
        ('"d3-1200"', '""', r"name: .*''"),
        ('"d3-1200"', '"d3\\n"', r"name: .*d3"),
        ("# Witt", TWO, r"identified\.torque_noise_nm\.value: 2 values for 3"),
        ("# Witt", ONE, r"identified\.torque_noise_nm\.value: 1 values for 3"),
        ("# Witt", "\n[identified]\nrho_2 = {value = -5}\n#", r"identified\.rho_2\.value: -5: the weight times"),
        ("# Witt", "\n[[effect]]\nname = 'x'\njoints = [4]\nparameters = {}\n#", r"effect x: joint 4 of 3"),
        ("gear_ratio = 5", "gear_ratio = 5\n[columns]\nheader_line = 1e20", r"columns\.header_line: .*got 1e\+20"),
        ("gravity_mps2 = 9.81", 'kind = "scara"', 'kind = "scara": a Delta robot is needed'),
        ("gravity_mps2 = 9.81", "gravity_mps2 = ", r"not TOML: .*line 3"),
        ("gravity_mps2 = 9.81", 'name = "twice"', r"line \d+: name is there a second time"),
        ("gear_ratio = 5", "gear_ratio = 5\n[columns]\nseparator = ';;'", r"columns\.separator: .*\(got ';;'\)"),
        ("# Witt", "\n[[effect]]\nname = 'x'\njoints = [0]\nparameters = {}\n#", r"effect\.0\.joints\.0: .*got 0"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(RobotError, match=rf"r\.toml: (?:{message})") as caught:
        load(tmp_path, TEXT.replace(old, new, 1))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = 1\nb = 2\na = 3\n", "line 3: a is there"),
        ("a = 1\n\na = 3", "line 3: a is there"),
        ("[x]\nb = 1\n[y]\n[x]\n", "line 4: x is there"),
        ("[x.y]\n[[x.y]]\n", r"line 2: \[\[x\.y\]\] is there"),
        ("a = 1\na = {b = 1, b = 2}\n", "line 2: b is there"),
        ("a = 1\na = [\n1,\n]\n", "line 4: a key is there"),
    ],
)
def test_a_key_that_is_there_twice_is_named_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "r.toml").write_text(text, encoding="utf-8")
    with pytest.raises(RobotError, match=rf"r\.toml: {said} a second time"):
        load_robot(tmp_path / "r.toml")


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"\xff\xfe\x00", r"r\.toml: not a text file \(byte 0 is not UTF-8\)"), (b"", r"r\.toml: name: missing key")],
)
def test_files_that_are_no_robot(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "r.toml").write_bytes(content)
    with pytest.raises(RobotError, match=message):
        load_robot(tmp_path / "r.toml")


def test_a_byte_order_mark_is_no_part_of_a_description(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    robot = load_robot(path)
    assert robot == load(tmp_path, TEXT)
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    save_robot(robot, tmp_path / "again.toml", template=path)
    assert (tmp_path / "again.toml").read_text(encoding="utf-8") == TEXT


def test_no_such_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"none\.toml: No such file or directory"):
        load_robot(tmp_path / "none.toml")
    with pytest.raises(RobotError, match="Is a directory"):
        load_robot(tmp_path)


def found(robot: Robot) -> Robot:
    """`robot` with everything that `identify` and `diagnose` write."""
    three = JointParameter(value=[1.5, 2.5, 3.5], std_error=[0.1, 0.2, 0.3], verdict=["identifiable", "weak", "weak"])
    return robot.model_copy(
        update={
            "identified": Identified(
                rho_1=Parameter(value=1.1, std_error=0.01),
                rho_2=Parameter(value=0.9, std_error=0.02, verdict="weak"),
                viscous_friction_nms=three,
                coulomb_friction_nm=three,
                forearm_inertia_kg=Parameter(value=0.6),
            ),
            "effect": [
                EffectEntry(
                    name="backlash",
                    joints=[2],
                    parameters={"gap": EffectParameter(value=0.002, unit="rad", std_error=1e-4)},
                ),
                EffectEntry(
                    name="air_drag",
                    joints=[1, 2, 3],
                    parameters={"c": EffectParameter(value=0.3, unit="N s^2/m^2"), "d": EffectParameter(value=1.0)},
                ),
            ],
        }
    )


def test_round_trip_without_a_template(tmp_path: Path) -> None:
    robot = found(load(tmp_path, TEXT))
    save_robot(robot, tmp_path / "out" / "s.toml")
    assert (
        load_robot(tmp_path / "out" / "s.toml").model_dump() == robot.model_dump()
    )  # but for the folder it was read from


def test_a_save_keeps_comments_order_and_layout(tmp_path: Path) -> None:
    robot = load(tmp_path, TEXT)
    save_robot(robot, tmp_path / "same.toml", template=tmp_path / "r.toml")
    assert (tmp_path / "same.toml").read_text() == TEXT
    save_robot(found(robot), tmp_path / "s.toml", template=tmp_path / "r.toml")
    assert load_robot(tmp_path / "s.toml") == found(robot)
    assert (tmp_path / "s.toml").read_text().startswith(TEXT.rstrip("\n"))  # all of it, then what is new


def test_a_second_save_changes_only_what_differs(tmp_path: Path) -> None:
    robot = found(load(tmp_path, TEXT))
    save_robot(robot, tmp_path / "s.toml", template=tmp_path / "r.toml")
    before = (tmp_path / "s.toml").read_text().splitlines()
    identified = robot.identified
    assert identified is not None
    changed = robot.model_copy(
        update={"identified": identified.model_copy(update={"rho_1": Parameter(value=1.25, std_error=0.01)})}
    )
    save_robot(changed, tmp_path / "t.toml", template=tmp_path / "s.toml")
    after = (tmp_path / "t.toml").read_text().splitlines()
    assert load_robot(tmp_path / "t.toml") == changed
    assert [(a, b) for a, b in zip(before, after, strict=True) if a != b] == [
        ("rho_1 = {value = 1.1, std_error = 0.01}", "rho_1 = {value = 1.25, std_error = 0.01}")
    ]


def test_a_save_drops_what_the_robot_no_longer_has(tmp_path: Path) -> None:
    """A template that was diagnosed before must not hand its old effects to a robot that has none."""
    robot = load(tmp_path, TEXT)
    save_robot(found(robot), tmp_path / "s.toml", template=tmp_path / "r.toml")
    save_robot(robot, tmp_path / "t.toml", template=tmp_path / "s.toml")
    assert load_robot(tmp_path / "t.toml") == robot
    fewer = found(robot).model_copy(update={"effect": found(robot).effect[:1]})
    save_robot(fewer, tmp_path / "u.toml", template=tmp_path / "s.toml")
    assert load_robot(tmp_path / "u.toml") == fewer


def test_a_value_put_back_to_its_default_is_saved(tmp_path: Path) -> None:
    robot = load(tmp_path, TEXT)
    plain = robot.model_copy(
        update={"gravity_mps2": [0.0, 0.0, -9.81], "drive": robot.drive.model_copy(update={"gear_ratio": 1.0})}
    )
    save_robot(plain, tmp_path / "s.toml", template=tmp_path / "r.toml")
    assert load_robot(tmp_path / "s.toml") == plain


def test_a_mapping_in_the_robot_is_left_as_it_was_written(tmp_path: Path) -> None:
    text = TEXT + (
        '\n[columns] # the analyser\'s export\nseparator = ";"\ntime = "t"\n'
        'position = { name = "q{joint}", unit = "deg", sign = 1 } # motor side? no\ntorque = "m{joint}"\n'
    )
    robot = load(tmp_path, text)
    save_robot(robot, tmp_path / "s.toml", template=tmp_path / "r.toml")
    assert (tmp_path / "s.toml").read_text() == text
    save_robot(robot, tmp_path / "bare.toml")
    assert load_robot(tmp_path / "bare.toml") == robot


def test_a_save_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    robot = load(tmp_path, TEXT)
    (tmp_path / "folder").mkdir()
    with pytest.raises(StorageError, match="folder: exists and is not a file"):
        save_robot(robot, tmp_path / "folder")
    with pytest.raises(RobotError, match=r"none\.toml: No such file"):
        save_robot(robot, tmp_path / "s.toml", template=tmp_path / "none.toml")
    assert not (tmp_path / "s.toml").exists()
    assert not list(tmp_path.glob(".part*"))
