"""What a motion leaves open is said to be open; friction that turns over slowly is not taken for viscous."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import Axes
from schemas.trace import Trace
from service.identification.joint_machines import identify_axes
from service.identification.pooled import ParameterEstimate, _structure
from tests.service.world import stub

PERIOD = 2e-3
NOISE = 1e-4  # rad, of a position
TIME = PERIOD * np.arange(5000)


def swing(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, speed, acceleration (N,) of three sines, the fastest of 0.1 of `size`."""
    waves = [np.array([(1j * rate) ** n * part * np.exp(1j * rate * TIME) for n in range(3)])
             for part, rate in ((0.7, 1.3), (0.2, 4.4), (0.1, 11.9))]  # fmt: skip
    angle, speed, acceleration = size * np.sum(waves, axis=0).imag
    return angle, speed, acceleration


def found(axes: Axes, position: np.ndarray, torque: np.ndarray) -> dict[str, ParameterEstimate]:
    """What is identified of one log with 0.01 N m of noise."""
    noise = 0.01 * np.random.default_rng(1).standard_normal(torque.shape)
    log = Trace(Path("log.csv"), TIME, position, torque + noise)
    return {estimate.name: estimate for estimate in identify_axes(axes, [log]).fit.estimates}


def test_frictions_that_always_turn_together_are_not_told_apart() -> None:
    """Motor 2 turns with both axes; while axis 1 rests, its friction is as much axis 2's own."""
    axes = Axes.model_validate(
        {"name": "wrist", "kind": "axes", "coupling": [[1, 0], [1, 1]], "axis": [{"gravity": False}] * 2}
    )
    angle, speed, acceleration = swing(1.0)
    torque = 0.2 * acceleration + 0.5 * speed + 1.5 * np.sign(speed)
    rest = np.zeros_like(angle)
    known = found(axes, np.column_stack([rest, angle]), np.column_stack([rest, torque]))
    for name, whole in (("f_v", 0.5), ("f_c", 1.5)):
        own, motor = known[f"{name}_2"], known[f"{name}_motor_2"]
        (open_,) = (one for one in (own, motor) if one.verdict == "not identifiable")
        assert open_.reason == "on these logs it cannot be separated from the other parameters; 0 assumed"
        assert own.value + motor.value == pytest.approx(whole, rel=0.02)
    assert known["f_v_1"].reason.startswith("joint 1 never moves")


def test_a_joint_that_only_quivers_has_no_friction() -> None:
    axes = Axes.model_validate({"name": "two", "kind": "axes", "axis": [{"gravity": False}] * 2})
    angle, speed, acceleration = swing(1.0)
    quiver = 4e-4 * np.array([np.sin(30 * TIME), 30 * np.cos(30 * TIME)])
    seen = quiver[0] + 5e-5 * np.random.default_rng(2).standard_normal(len(TIME))
    torque = 0.2 * acceleration + 0.5 * speed + 1.5 * np.sign(speed)
    known = found(axes, np.column_stack([angle, seen]), np.column_stack([torque, 1.5 * np.sign(quiver[1])]))
    for name in ("f_v_2", "f_c_2"):
        assert (known[name].value, known[name].reason) == (0.0, "joint 2 never moves; 0 assumed")
    assert known["f_c_1"].value == pytest.approx(1.5, rel=0.02)


@pytest.mark.parametrize("width", [0.05, 0.4])
def test_friction_that_turns_over_slowly_is_found_from_a_start_far_off(width: float) -> None:
    axes = Axes.model_validate({"name": "servo", "kind": "axes", "axis": [{"gravity": False}]})
    angle, speed, acceleration = swing(0.6)
    torque = 0.05 * acceleration + 0.2 * speed + 1.5 * np.tanh(speed / width)
    known = found(axes, angle[:, None], torque[:, None])
    assert known["f_c_1"].value == pytest.approx(1.5, rel=0.1)
    assert known["f_v_1"].value == pytest.approx(0.2, rel=0.3)


def reasons(*shares: float, travel: float = 1.0) -> dict[str, str]:
    """Of one joint; each run goes forward for a share of its time."""
    segments = []
    for share in shares:
        forward = np.arange(1000) < 1000 * share
        theta = np.linspace(0, travel, 1000)[:, None]
        speed = np.where(forward, 1.0, -1.0)[:, None]
        noise = np.array([NOISE])
        segments.append(stub(theta=theta, theta_dot=speed, moving=np.ones((1000, 1), bool), period=1e-3, noise=noise))
    return _structure(stub(recordings=[stub(segment=segment) for segment in segments]))


def test_a_joint_reverses_if_a_twentieth_of_its_time_goes_the_other_way() -> None:
    assert reasons(0.94) == reasons(0.06) == reasons(1.0, 0.0) == {}
    assert reasons(0.96) == reasons(0.04) == {"f_c_1": "joint 1 never reverses"}


def test_a_joint_moves_if_it_travels_fifty_times_the_noise_of_its_position() -> None:
    assert reasons(0.5, travel=51 * NOISE) == {}
    assert reasons(0.5, travel=49 * NOISE) == {"f_v_1": "joint 1 never moves", "f_c_1": "joint 1 never moves"}


def test_effects_of_an_earlier_identification_are_left_out_and_said_to_be() -> None:
    cogging = {"name": "cogging", "joints": [1], "parameters": {}}
    axes = Axes.model_validate({"name": "one", "kind": "axes", "axis": [{"gravity": False}], "effect": [cogging]})
    angle, speed, acceleration = swing(1.0)
    log = Trace(Path("log.csv"), TIME, angle[:, None], (0.2 * acceleration + 0.5 * speed)[:, None])
    found = identify_axes(axes, [log])
    assert found.robot.effect == []
    assert any(line.startswith("cogging: from an earlier diagnosis") for line in found.warnings)
