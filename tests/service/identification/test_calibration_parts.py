"""What a known load puts right, each rule just inside and just outside of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import DataError
from schemas.robot import Robot
from service.identification import calibration
from service.identification.calibration import Calibration, calibrate
from tests.service.world import stub


def put_right(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, values: tuple[float, ...], errors: tuple[float, ...]
) -> tuple[list[bool], Calibration]:
    """Which of three scales and the platform's mass are put right where a fit finds these values of them, the mass as
    kg more, with these errors; and what comes of it."""
    asked: list[tuple[list[bool], list[float]]] = []

    def solved(logs: object, masses: np.ndarray, moving: float, noise: object, free: np.ndarray) -> Any:
        asked.append((free[:4].tolist(), (moving * (masses - 1.0)).tolist()))
        return np.array([*values, *[1.0] * 9]), np.array([*errors, *[0.0] * 9])

    for name, part in {
        "summarise": lambda model, trace: stub(recordings=[]), "white_noise": lambda recordings: np.ones(3),
        "_check": lambda *parts: None, "_solve": solved,
    }.items():  # fmt: skip
        monkeypatch.setattr(calibration, name, part)
    monkeypatch.setattr(calibration.checks, "check", lambda logs, gear: None)
    logs: Any = [stub(path=Path("a.csv"))] * 2
    made = calibrate(robot, logs[:1], [(2.5, logs[1])])
    assert asked[0][0] == [True] * 4
    for _, loads in asked:
        np.testing.assert_allclose(loads, [0.0, 2.5], atol=1e-12)
    return asked[1][0], made


@pytest.mark.parametrize(
    ("change", "error", "right"),
    [
        (0.011, 0.003, True), (0.009, 0.0, False), (-0.011, 0.003, True),  # a hundredth
        (0.061, 0.020, True), (0.059, 0.020, False),  # three standard errors
        (0.2, 0.029, True), (0.2, 0.031, False),  # an error of three hundredths
    ],
)  # fmt: skip
def test_a_scale_is_put_right_where_it_stands_out(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, change: float, error: float, right: bool
) -> None:
    off, made = put_right(monkeypatch, robot, (1.0, 1.0 + change, 1.0, 0.0), (0.001, error, 0.001, 0.001))
    assert off == [False, right, False, False]
    assert made.figures[1].changed is right
    assert (made.effect is not None) is right
    (line,) = made.warnings or [""]
    assert line.startswith(
        "joint 2: with the known load, the drive reports"
        if right
        else "joint 2: the known load determines"
        if error > 0.03
        else ""
    )
    assert bool(line) is (right or error > 0.03)


@pytest.mark.parametrize(
    ("change", "error", "right"),
    [(0.021, 0.005, True), (-0.019, 0.005, False), (0.061, 0.020, True), (0.059, 0.020, False)],
)
def test_a_platform_is_put_right_where_it_stands_out(
    monkeypatch: pytest.MonkeyPatch, robot: Robot, change: float, error: float, right: bool
) -> None:
    """Twenty grams, three standard errors; a scale whose error is large is another matter."""
    off, made = put_right(monkeypatch, robot, (1.0, 1.0, 1.0, change), (0.001, 0.001, 0.001, error))
    assert off == [False, False, False, right]
    assert [figure.changed for figure in made.figures] == off
    assert made.figures[3].value == pytest.approx(1.3 + change)
    assert made.robot.mass.platform == pytest.approx(1.3 + change)
    assert [line[:22] for line in made.warnings] == [f"mass.platform: {1.3 + change:.3f} ±"] * right


def test_a_platform_of_nothing_is_refused(monkeypatch: pytest.MonkeyPatch, robot: Robot) -> None:
    with pytest.raises(DataError, match=r"a\.csv: a platform of -0\.01 kg is impossible; is the stated"):
        put_right(monkeypatch, robot, (1.0, 1.0, 1.0, -1.31), (0.001,) * 4)
    put_right(monkeypatch, robot, (1.0, 1.0, 1.0, -1.29), (0.001,) * 4)


@pytest.mark.parametrize(("share", "refused"), [(0.099, False), (0.101, True)])
def test_a_log_with_a_load_that_leaves_a_tenth_of_its_torque_is_refused(share: float, refused: bool) -> None:
    """Of two blocks and three joints of samples; each joint by its own scale and friction."""
    random = np.random.default_rng(0)
    values = np.array([1.1, 0.9, 1.2, 0.3, 1.5, 1.2, 0.6, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    mass, moving = 1.7, 2.4
    columns = random.standard_normal((2, 3, 50, 11))
    inertia, gravity, forearm, speed, sign, platform = np.moveaxis(columns[..., :6], -1, 0)
    true = 1.5 * inertia + 1.2 * gravity + 0.6 * forearm + (mass + 0.3 / moving) * platform
    scale, viscous, coulomb = (values[None, k : k + 3, None] for k in (0, 7, 10))
    told = scale * true + viscous * speed + coulomb * sign
    rest = random.standard_normal(told.shape)
    along = float(np.sum(rest * told) / np.sum(told**2))
    rest = rest - along * told  # the torque's square is that of both
    rest *= np.linalg.norm(told) / np.linalg.norm(rest) * share / np.sqrt(1 - share**2)
    for joint in range(3):
        columns[:, joint, :, 7 + joint] = (told + rest)[:, joint]
    log: Any = stub(name="log", gram=np.einsum("bjna,bjnc->bjac", columns, columns))

    def check() -> None:
        calibration._check([log], np.array([2.0]), np.array([mass]), moving, values, np.zeros(13))

    if refused:
        with pytest.raises(DataError, match=r"log: with 2 kg on the platform the model leaves 10 %"):
            check()
    else:
        check()


@pytest.mark.parametrize(
    ("scale", "error", "refused"),
    [(1.31, 0.0, True), (1.29, 0.0, False), (0.69, 0.0, True), (1.37, 0.02, True), (1.35, 0.02, False)],
)
def test_no_torque_constant_is_a_third_off(scale: float, error: float, refused: bool) -> None:
    values, errors = calibration._nominal(), np.zeros(13)
    values[1], errors[1] = scale, error
    assert values.tolist() == [1.0, scale, 1.0, 0.0, 1.0, 1.0, *[0.0] * 7]
    log: Any = stub(name="log", gram=np.zeros((1, 3, 11, 11)))

    def check() -> None:
        calibration._check([log], np.array([2.0]), np.array([1.0]), 2.4, values, errors)

    if refused:
        with pytest.raises(DataError, match=rf"log \(2 kg\): joint 2 would report {scale:.2f} times"):
            check()
    else:
        check()
