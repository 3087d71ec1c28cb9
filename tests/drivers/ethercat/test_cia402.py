"""CiA 402 units and states against the standard's tables and hand calculation."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.ethercat.cia402 import Control, DriveState, Scale, drive_state, scales
from schemas.errors import RobotError
from schemas.robot import Drive, Robot, load_robot

RATED = {"reference": "rated_torque", "rated_torque_nm": 1.27}


def joint(**changes: Any) -> dict[str, Any]:
    return {"counts_per_turn": 1 << 20, "sign": 1, "zero_counts": 0, "torque": RATED, **changes}


def driven(gear_ratio: float, *joints: dict[str, Any]) -> Robot:
    drive = Drive.model_validate({"gear_ratio": gear_ratio, "joint": joints})
    return load_robot("d3-1200").model_copy(update={"drive": drive})


def one_scale(gear_ratio: float = 10.0, **changes: Any) -> Scale:
    return scales(driven(gear_ratio, joint(**changes), joint(), joint()))[0]


@pytest.mark.parametrize(
    ("pattern", "state"),
    [
        ("x0xx0000", DriveState.NOT_READY_TO_SWITCH_ON),
        ("x1xx0000", DriveState.SWITCH_ON_DISABLED),
        ("x01x0001", DriveState.READY_TO_SWITCH_ON),
        ("x01x0011", DriveState.SWITCHED_ON),
        ("x01x0111", DriveState.OPERATION_ENABLED),
        ("x00x0111", DriveState.QUICK_STOP_ACTIVE),
        ("x0xx1111", DriveState.FAULT_REACTION_ACTIVE),
        ("x0xx1000", DriveState.FAULT),
    ],
)
def test_every_status_word_of_the_standards_table_is_decoded(pattern: str, state: DriveState) -> None:
    matches = re.compile(pattern.replace("x", "[01]"))
    words = np.array([w for w in range(1 << 16) if matches.fullmatch(f"{w & 0xFF:08b}")], np.uint16)

    assert len(words) >= 256
    assert set(drive_state(words).tolist()) == {int(state)}


def test_a_status_word_outside_the_table_is_unknown() -> None:
    assert drive_state(np.array([0x0001, 0x0047], np.uint16)).tolist() == [DriveState.UNKNOWN] * 2


def test_the_control_words_set_the_standards_bits() -> None:
    assert [Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE_OPERATION, Control.FAULT_RESET] == [6, 7, 15, 128]


def test_a_motor_turn_is_a_turn_over_the_gear_ratio_with_sign_and_zero() -> None:
    scale = one_scale(gear_ratio=8.0, sign=-1, zero_counts=500)

    np.testing.assert_allclose(scale.position(500 + (1 << 20)), -math.tau / 8)
    np.testing.assert_allclose(scale.position(500), 0.0)


def test_the_gear_ratio_of_a_drive_overrides_the_robots() -> None:
    scale = scales(driven(8.0, joint(gear_ratio=5.0), joint(), joint()))

    np.testing.assert_allclose([s.position(1 << 20) for s in scale], [math.tau / 5, math.tau / 8, math.tau / 8])
    np.testing.assert_allclose([s.torque(1000) for s in scale], [1.27 * 5, 1.27 * 8, 1.27 * 8])


def test_an_encoder_that_wraps_near_zero_gives_one_continuous_angle() -> None:
    scale = one_scale(zero_counts=2**31 - 10)
    counts = np.array([2**31 - 20, 2**31 - 1, -(2**31), -(2**31) + 5], np.int64)

    np.testing.assert_allclose(scale.position(counts) / scale.radians_per_count, [-10, 9, 10, 15])


@pytest.mark.parametrize(
    ("torque", "full_scale"),
    [
        (RATED, 1.27),
        ({"reference": "standstill_torque", "standstill_torque_nm": 2.0}, 2.0),
        (("rms", "rms"), 6.0),
        (("peak", "peak"), 6.0),
        (("rms", "peak"), 6.0 * math.sqrt(2)),
        (("peak", "rms"), 6.0 / math.sqrt(2)),
    ],
)
def test_per_mille_of_each_reference_is_torque_at_the_joint(torque: Any, full_scale: float) -> None:
    if isinstance(torque, tuple):
        torque = {
            "reference": "rated_current", "rated_current_a": 3.0, "rated_current_form": torque[0],
            "torque_constant_nmpa": 2.0, "torque_constant_form": torque[1],
        }  # fmt: skip
    scale = one_scale(torque=torque, sign=-1)

    np.testing.assert_allclose(scale.torque(np.array([500, -1000])), [-0.5 * full_scale * 10, full_scale * 10])


def test_units_come_back_within_half_a_unit_and_are_held_at_the_objects_limits() -> None:
    scale = one_scale(sign=-1, zero_counts=-123456)
    counts = np.random.default_rng(1).integers(-(2**31), 2**31, 10_000)
    per_mille = np.random.default_rng(2).integers(-(2**15), 2**15, 10_000)

    np.testing.assert_array_equal(scale.counts(scale.position(counts)), counts)
    np.testing.assert_array_equal(scale.per_mille(scale.torque(per_mille)), per_mille)
    assert scale.per_mille(np.array([1e9, -1e9])).tolist() == [-32768, 32767]


def test_the_velocity_unit_is_only_known_where_it_is_declared() -> None:
    assert one_scale().radians_per_s_per_unit is None
    assert one_scale(velocity_unit_counts_per_s=(1 << 20) / 60).radians_per_s_per_unit == pytest.approx(math.tau / 600)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"torque": {"reference": "rated_torque"}}, "rated_torque_nm"),
        ({"torque": {"reference": "guess", "nm": 1}}, "reference"),
        ({"sign": 0}, "sign"),
        ({"counts_per_turn": 0}, "counts_per_turn"),
        ({"outputs": ["0x6040"]}, "outputs_address"),
        ({"station": 0x1002}, "station"),
    ],
)
def test_an_incomplete_or_impossible_declaration_names_its_key(changes: dict[str, Any], message: str) -> None:
    joints = [joint(**changes), joint(station=0x1002), joint()]
    with pytest.raises(ValidationError, match=message):
        Drive.model_validate({"joint": joints})


def test_two_drives_are_not_a_delta_robot() -> None:
    with pytest.raises(ValidationError, match="2 drives"):
        Drive.model_validate({"joint": [joint(), joint()]})


def test_scaling_is_never_guessed() -> None:
    with pytest.raises(RobotError, match=r"^\S+d3-1200\.toml: drive\.joint: missing key: "):
        scales(driven(10.0))
