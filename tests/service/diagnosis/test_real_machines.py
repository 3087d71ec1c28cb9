"""Real machines, imported from their original files and diagnosed: what is known of them is found, nothing else named.

What is known: the README beside each set of logs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.axes_description import load_axes
from schemas.chain_description import ChainIdentified
from service.cli.main import app

SURE = 0.9  # probability from which a name counts as given
TORQUE_CONSTANT = 8.27 / 150  # N m/A of the ODrive's motor
COUNTED = """joints = 1
time = "1"
position = { name = "2", unit = "counts", counts_per_rev = 8192 }
torque = { name = "3", unit = "A", constant = 0.055133 }
"""
STATIC = """joints = 1
time = {{ rate_hz = 160, backwards = {backwards} }}
position = {{ name = "row", unit = "counts", counts_per_rev = 8192 }}
torque = {{ name = "value", unit = "A", constant = 0.055133 }}
where = {{ name = "value", unlike = 0 }}
"""
# load: a share of 885, unsigned 16 bit, times the supply's volts. N m per volt: 0.0678 to 0.0877 by the published fits
PWM = """joints = 1
time = "timestamp"
where = { name = "torque_enable", equals = 1 }
position = "position"
position_command = "goal_position"
torque = { name = "load", bits = 16, times = "input_volts", unit = "V", constant = 8.43e-5 }
"""


def diagnosed(folder: Path, columns: str, logs: list[Path], axes: str = "[[axis]]\n") -> dict[str, Any]:
    """The document that the command writes of some logs."""
    (folder / "columns.toml").write_text(columns)
    (folder / "axes.toml").write_text('name = "real"\nkind = "axes"\ncolumns = "columns.toml"\n' + axes)
    return run(folder, logs)


def run(folder: Path, logs: list[Path]) -> dict[str, Any]:
    """The same with the description that stands in the folder."""
    arguments = ["diagnose", *logs, "--robot", folder / "axes.toml", "--out", folder / "out"]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads((folder / "out" / "diagnosis.json").read_text())


def sure(document: dict[str, Any]) -> set[str]:
    """Effects that are given as good as certain; nothing beside them may be what cannot be."""
    for key, estimate in document["base"].items():
        assert estimate["value"] >= 0 or key.startswith(("offset", "gravity")), key
    return {effect["name"] for effect in document["effects"] if effect["probability"] >= SURE}


def amperes_of(document: dict[str, Any]) -> dict[int, float]:
    """Order of the cogging -> its amplitude, A of the ODrive's motor."""
    (cogging,) = (effect["parameters"] for effect in document["effects"] if effect["name"] == "cogging")
    found = {}
    for key, order in cogging.items():
        if key.startswith("order"):
            parts = [cogging[key.replace("order", part)]["value"] for part in ("cosine", "sine")]
            found[round(order["value"])] = np.hypot(*parts) / TORQUE_CONSTANT
    return found


ORDERS = {7: 0.862, 28: 0.560, 14: 0.349, 36: 0.290, 12: 0.263}  # A of the ODrive's cogging, by its static map


def odrive(data: Path, folder: Path) -> dict[str, Any]:
    """What is diagnosed of its slow turns."""
    names = ("slow2/nocomp_0", "slow2/nocomp_1", "slow2/nocomp_2", "slow2_slower/nocomp_0")
    return diagnosed(folder, COUNTED, [data / "real" / "odrive_cogging" / f"{name}.npy" for name in names])


def test_cogging_of_many_orders_behind_a_filter(data: Path, tmp_path: Path) -> None:
    """ODrive: slow turns, reported through a low-pass of 1.27 Hz (by its setting) to 1.47 Hz (own fit beside the
    logs)."""
    document = odrive(data, tmp_path)
    assert sure(document) <= {"cogging", "torque_filter"}
    effects = {effect["name"]: effect["parameters"] for effect in document["effects"]}
    assert 1.27 / 1.05 < effects["torque_filter"]["cutoff"]["value"] < 1.47 * 1.05
    found = amperes_of(document)
    for order, amperes in ORDERS.items():
        assert found[order] == pytest.approx(amperes, rel=0.12), order
    assert all(found[order] < 0.15 for order in found.keys() - ORDERS.keys())


def test_cogging_by_static_maps(data: Path, tmp_path: Path) -> None:
    """ODrive: the current that holds each 16th encoder count, forwards and in reverse, 0 where none was measured; read
    as a slow turn. Its own Fourier fit: 1.04, 0.56, 0.35, 0.29, 0.26 A; Coulomb friction 0.17 A."""
    folder = data / "real" / "odrive_cogging" / "coggingmap_0"
    for name, backwards in (("c_16", "false"), ("e_16r", "true")):
        mapping, log = tmp_path / "map.toml", tmp_path / f"{name}.csv"
        mapping.write_text(STATIC.format(backwards=backwards))
        source = folder / f"cogging_measure_final_{name}.npy"
        result = CliRunner().invoke(app, ["convert", str(source), str(log), "--columns", str(mapping)])
        assert "7680 of 8192 rows have 0 in column 'value' and were left out" in result.output
    (tmp_path / "axes.toml").write_text('name = "real"\nkind = "axes"\n[[axis]]\n')
    document = run(tmp_path, [tmp_path / "c_16.csv", tmp_path / "e_16r.csv"])
    assert sure(document) == {"cogging"}
    found = amperes_of(document)
    for order, amperes in {7: 1.04, 28: 0.56, 14: 0.35, 36: 0.29, 12: 0.264}.items():
        assert found[order] == pytest.approx(amperes, rel=0.04), order
    assert document["base"]["f_c_1"]["value"] / TORQUE_CONSTANT == pytest.approx(0.17, rel=0.05)


def xl330(data: Path, folder: Path) -> dict[str, Any]:
    """What is diagnosed of the logs whose torque is on all the time."""
    logs = sorted((data / "real" / "bam_xl330" / "raw").glob("*.json"))
    powered = [log for log in logs if log.stem[-8:] not in ("10h28m17", "10h29m21", "10h29m54")]
    return diagnosed(folder, PWM, powered)


def test_a_weight_is_neither_spring_nor_cogging_nor_filter(data: Path, tmp_path: Path) -> None:
    """Servo on a pendulum: m g l 0.4805 N m and 0.00654 kg m^2, of which the drive's constant is only known to a
    quarter; so their ratio is held against it. Friction takes 0.136 of the torque outside and 0.284 of the motor's: of
    a weight that is held 0.42."""
    document = xl330(data, tmp_path)
    assert sure(document) == {"load_dependent_friction"}
    lost = document["effects"][0]["parameters"]["mu"]
    assert lost["value"] == pytest.approx(0.136 + 0.284, rel=0.06)
    assert lost["ci95"][0] < 0.136 + 0.284 < lost["ci95"][1]
    (left,) = (one["share"] for one in document["cannot_tell"] if one["code"] == "much_beside")
    assert left == pytest.approx(0.264, abs=0.02), "a joint that sticks takes any torque; above 0.2 rad/s 0.16 is left"
    (loop,) = (one for one in document["cannot_tell"] if one["code"] == "closed_loop")
    assert loop["gain"] == pytest.approx(2.546 * 100 * 7.4 * 8.43e-5, rel=0.03), "the drive's at its lowest setting"
    assert loop["gain_most"] > 6 * loop["gain"], "8 times, but for the duty that ends at 885"
    base = {key: estimate["value"] for key, estimate in document["base"].items()}
    weight = np.hypot(base["gravity_sin_1"], base["gravity_cos_1"])
    assert base["inertia_1"] / weight == pytest.approx(0.00654 / 0.4805, rel=0.05)
    constant = 8.43e-5 * 885 * 0.4805 / weight  # N m per volt that makes the weight right
    assert 0.0678 < constant < 0.0877


TX40_GEARS, TX40_SIGNS = (32, 32, 45, 48, 45, 32), (1, 1, 1, -1, 1, 1)
TX40_ZEROS = (0, 16 * np.pi, -22.5 * np.pi, 0, 0, 0)  # at the motor, where the URDF's joint is at zero


def tx40_columns() -> tuple[str, str]:
    """The mapping of the TX40's logs, and its coupling: motor 6 turns with joints 5 and 6."""
    rows = [
        f'{{ name = "{name}{j + 1}", side = "motor", gear_ratio = {TX40_GEARS[j]}, '
        f"sign = {TX40_SIGNS[j]}, zero = {zero} }}"
        for name, starts in (("Joint_", TX40_ZEROS), ("curr_data:Joint_", (0,) * 6))
        for j, zero in enumerate(starts)
    ]
    coupling = np.eye(6, dtype=int).tolist()
    coupling[5][4] = 1
    columns = (
        f'joints = 6\nbeside = ["curr_data.csv"]\ntime = {{ rate_hz = 5000 }}\n'
        f"position = [{', '.join(rows[:6])}]\ntorque = [{', '.join(rows[6:])}]\n"
    )
    return columns, f"coupling = {coupling}\n"


def test_a_coupled_wrist_has_its_own_friction_and_a_coupled_arm_no_names(data: Path, tmp_path: Path) -> None:
    """Staubli TX40 as axes that share motor 6: its friction 0.61 N m s/rad and rotor 0.0094 kg m^2, axis 4 1.11 N m
    s/rad and 2.48 N m. Axes 1 to 3 feel each other's weight and inertia: the base is called wrong, nothing named."""
    columns, coupling = tx40_columns()
    logs = [data / "real" / "tx40" / "pos_read_data.csv"]
    document = diagnosed(tmp_path, columns, logs, coupling + "[[axis]]\n" * 6)
    assert not sure(document)
    codes = {caution["code"] for caution in document["cannot_tell"]}
    assert codes & {"sine_of_angle", "other_joints"}, "what the gap follows, not only how much is left"
    base = {key: estimate["value"] for key, estimate in document["base"].items()}
    assert base["f_v_motor_6"] == pytest.approx(0.613, rel=0.05)
    assert base["inertia_motor_6"] == pytest.approx(0.0094, rel=0.26)  # the published standard error
    assert base["f_v_4"] == pytest.approx(1.11, rel=0.05)


TX40_VISCOUS, TX40_WRIST = (8.05, 5.53, 1.97, 1.11, 1.86, 0.65), 0.616  # published, N m s/rad: axes, motor 6 alone
TX40_COULOMB_1 = 7.14  # published of axis 1, N m


def tx40(data: Path, folder: Path) -> tuple[ChainIdentified, str]:
    """What is identified of it as a chain, and what the command says."""
    columns, coupling = tx40_columns()
    (folder / "columns.toml").write_text(columns)
    names, logs = [f"joint_{joint}" for joint in range(1, 7)], data / "real" / "tx40"
    (folder / "tx40.toml").write_text(
        f'name = "tx40"\nkind = "chain"\nurdf = "{logs}/tx40_mdh_modified.urdf"\njoints = {names}\n'
        f'columns = "columns.toml"\n{coupling}'
    )
    arguments = ["identify", logs / "pos_read_data.csv", "--robot", folder / "tx40.toml"]
    arguments += ["--out", folder / "found.toml"]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    found = load_axes(folder / "found.toml").identified
    assert isinstance(found, ChainIdentified)
    return found, result.output


def tx40_viscous(found: ChainIdentified) -> tuple[np.ndarray, float]:
    """Viscous friction as it is published, N m s/rad: that of the wrist's axes holds their shared motor's; and that
    motor's own."""
    assert found.motor_viscous_friction is not None
    wrist = found.motor_viscous_friction.value[5]
    viscous = np.array(found.viscous_friction.value)
    viscous[4:] += wrist
    return viscous, wrist


def test_an_arm_by_its_urdf_has_the_friction_that_is_published(data: Path, tmp_path: Path) -> None:
    """Staubli TX40 as a chain, friction as published with it; that of axes 1 and 2 turns over slowly, which `sign` has
    not: what both models have in common is friction at a speed."""
    pytest.importorskip("pinocchio")
    found, said = tx40(data, tmp_path)
    assert found.motor_coulomb_friction is not None
    viscous, wrist = tx40_viscous(found)
    assert viscous == pytest.approx(TX40_VISCOUS, rel=0.05)
    assert wrist == pytest.approx(TX40_WRIST, rel=0.05)
    coulomb, widths = np.array(found.coulomb_friction.value), np.array(found.friction_transition)[:6]
    assert coulomb[2:5] == pytest.approx([6.34, 2.48, 3.03], rel=0.05)
    assert coulomb[5] == pytest.approx(0.282, abs=0.03), "not what the wrist's motor has"
    at_one = viscous + coulomb * np.tanh(1.0 / widths)  # N m at 1 rad/s
    assert at_one[0] == pytest.approx(TX40_VISCOUS[0] + TX40_COULOMB_1, rel=0.08)
    assert at_one[1] == pytest.approx(5.53 + 8.26, rel=0.05)
    assert found.motor_coulomb_friction.value[5] == pytest.approx(1.95, rel=0.05)
    assert found.rigid["inertia_motor_6"].value == pytest.approx(0.0096, abs=0.0033)
    assert found.torque_timing_s == pytest.approx(-2.4e-3, abs=4e-4)
    assert "the position is 2" in " ".join(said.split())


UR10_FRICTION = np.array([14.45, 14.22, 7.73, 3.55, 2.64, 2.78]) + [
    13.93,
    17.17,
    9.37,
    2.63,
    2.80,
    3.52,
]  # N m at 1 rad/s


def ur10(data: Path, folder: Path) -> dict[str, Any]:
    """What is diagnosed of it as a chain."""
    logs = data / "real" / "ur10_unisa"
    names = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
    position, torque = (", ".join(f'"{name}.{what}"' for name in names) for what in ("position", "effort"))
    (folder / "columns.toml").write_text(f'joints = 6\ntime = "time"\nposition = [{position}]\ntorque = [{torque}]\n')
    (folder / "axes.toml").write_text(
        f'name = "ur10"\nkind = "chain"\nurdf = "{logs}/ur10_robot.urdf"\njoints = {names}\ncolumns = "columns.toml"\n'
    )
    return run(folder, [logs / "ur10_exciting_trajectory.db3"])


def ur10_friction(document: dict[str, Any]) -> np.ndarray:
    """N m at 1 rad/s."""
    base = {key: estimate["value"] for key, estimate in document["base"].items()}
    return np.array([base[f"f_v_{j}"] + base[f"f_c_{j}"] for j in range(1, 7)])


def test_a_smoothed_log_of_an_arm_leaves_what_is_known_and_gets_no_name(data: Path, tmp_path: Path) -> None:
    """UR10 as a chain: everything was smoothed to below 5 Hz after the recording, which is no filter of the drive, and
    what sits at reversals is the smoothing. Published: 3 to 13 % left, axis 6 20 to 29 %; friction at 1 rad/s."""
    pytest.importorskip("pinocchio")
    document = ur10(data, tmp_path)
    assert not [effect["name"] for effect in document["effects"] if effect["probability"] >= SURE]
    left = np.array(document["gap"]["before_nm"]) / document["gap"]["torque_nm"]
    assert max(left[:5]) < 0.13
    assert left[5] < 0.29
    friction, published = ur10_friction(document), UR10_FRICTION
    assert friction[[0, 2, 3, 4, 5]] == pytest.approx(published[[0, 2, 3, 4, 5]], rel=0.06)
    assert friction[1] == pytest.approx(published[1], rel=0.16), "its gravity is 143 N m"
