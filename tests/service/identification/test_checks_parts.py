"""The checks of logs, each rule just inside and just outside of it, and masses against least squares over samples."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from schemas.errors import DataError
from service.identification import checks
from service.identification.regression import COLUMNS, PLATFORM_COLUMN, WEIGHT_COLUMN, rms_residual, selection, target
from tests.service.world import stub

NAMES = ("a", "b", "c", "d")


def told(
    monkeypatch: pytest.MonkeyPatch,
    held: float,
    others: float,
    share: float = 0.05,
    hint: str = "",
    count: int = 4,
    taken: float = 0.51,
    own: float = 0.0,
) -> list[str]:
    """Warnings about logs of 10 N m a joint. held: share of log b's torque that the fit to the others leaves, on joint
    3 only. others: of theirs, by that fit. share: of b's by the fit to all. hint: of a load on log b. taken: what that
    would explain. own: of b's by a fit of its own."""
    monkeypatch.setattr(checks, "_loads", lambda logs, fit, mass: {"b": hint} if hint else {})
    monkeypatch.setattr(checks, "_taken", lambda log, values, noise: taken if values == 1 else 9.0)
    monkeypatch.setattr(checks, "_sameness", lambda logs: ["alike"])
    torque, whole = np.full((count, 3), 10.0), 10.0 * 3**0.5
    residual, held_out, alone = (np.full((count, 3), 0.1) for _ in range(3))
    for left_of, part in ((residual, share), (held_out, held), (alone, own)):
        left_of[1] = [0.0, 0.0, part * whole]

    def left(values: np.ndarray) -> np.ndarray:
        assert values == 1, "the fit to the others of log b"
        return np.where(np.arange(count)[:, None] == 1, 99.0, others * 10.0) * np.ones(3)

    fit: Any = stub(
        residual=residual,
        torque=torque,
        held_out=held_out,
        alone=alone,
        without=np.arange(count),
        left=left,
        noise=None,
    )
    logs: Any = [stub(name=name) for name in NAMES[:count]]
    return checks.check_fit(logs, fit, 2.0)


OUT = "b: does not match the other logs: the fit to those leaves"


@pytest.mark.parametrize(
    ("held", "others", "says"),
    [
        (
            0.21,
            0.01,
            f"{OUT} 21 % of its torque unexplained (of their own 1.0 %), most on joint 3; does this motion excite",
        ),
        (0.19, 0.01, "alike"),
        (
            0.31,
            0.10,
            f"{OUT} 31 % of its torque unexplained (of their own 10.0 %), most on joint 3; does this motion excite",
        ),
        (0.29, 0.10, "alike"),
        (0.39, 0.10, f"{OUT} 39 %"),
    ],
)
def test_a_log_that_others_explain_three_times_worse_than_each_other_is_named(
    monkeypatch: pytest.MonkeyPatch, held: float, others: float, says: str
) -> None:
    found = told(monkeypatch, held, others)
    assert found[0].startswith(says)
    assert found[-1] == "alike"
    assert len(found) == 1 + (says != "alike")
    assert told(monkeypatch, held, others, count=2) == ["alike"], "of two logs neither is the other's judge"


def test_a_log_that_others_do_not_explain_or_that_no_fit_does_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    another = r"^b: does not match .* 41 % .* most on joint 3; a fit of its own leaves 22 % of it: is it of another"
    with pytest.raises(DataError, match=another):
        told(monkeypatch, 0.41, 0.1, own=0.22)  # of the square less than .3
    warning, alike = told(monkeypatch, 0.41, 0.1, own=0.23)
    assert re.match("b: does not match .* 41 % .* does this motion excite an unmodelled effect", warning)
    with pytest.raises(DataError, match=r"^b: does not match .* 21 % .*; a load$"):
        told(monkeypatch, 0.21, 0.01, hint="a load")
    warning, alike = told(monkeypatch, 0.21, 0.01, hint="a load", taken=0.49)
    assert re.match("b: does not match .* 21 % .* does this motion excite an unmodelled effect", warning)
    assert "load" not in warning + alike
    with pytest.raises(DataError, match=another):
        told(monkeypatch, 0.41, 0.1, hint="a load", taken=0.49, own=0.22)
    assert told(monkeypatch, 0.19, 0.01, hint="a load.") == ["b: a load. Identify on motion without payload", "alike"]
    assert told(monkeypatch, 0.1, 0.1, share=0.49) == ["alike"]
    with pytest.raises(DataError, match=r"^b: the model leaves 51 % of the torque unexplained; are the robot"):
        told(monkeypatch, 0.1, 0.1, share=0.51)


@pytest.mark.parametrize(
    ("mass", "spread", "others", "loaded"),
    [
        (0.16, 0.0, 0.01, True),
        (0.14, 0.0, 0.01, False),  # 0.15 kg
        (-0.16, 0.0, 0.01, True),
        (0.31, 0.0, 0.10, True),  # three times the middle one
        (0.29, 0.0, 0.10, False),
        (0.3, 0.29, 0.01, True),  # a mean of 0.7 of the rms
        (0.3, 0.32, 0.01, False),
    ],
)
def test_a_log_is_loaded_that_steadily_asks_for_more_than_the_others(
    monkeypatch: pytest.MonkeyPatch, mass: float, spread: float, others: float, loaded: bool
) -> None:
    """Masses of two blocks a log, weighed by how sure they are; the middle one of five logs is 0.5 kg."""
    by_log = {"a": (-others, 0.0), "b": (mass, spread), "c": (0.0, 0.0), "d": (others, 0.0), "e": (-others, 0.0)}
    if mass < 0:
        by_log = {name: (-m if name != "b" else m, s) for name, (m, s) in by_log.items()}

    def masses(log: Any, values: object, noise: object, moving: object) -> tuple[np.ndarray, np.ndarray]:
        middle, apart = by_log[log.name]
        return 0.5 + middle + np.array([2 * apart, -apart]), np.array([1.0, 2.0]) * np.sqrt(0.5)

    monkeypatch.setattr(checks, "_masses", masses)
    logs: Any = [stub(name=name) for name in by_log]
    fit: Any = stub(without=[None] * 5, noise=None)
    if spread:  # rms of 2 s, -s, -s is s sqrt 2
        by_log["b"] = mass, spread / 2**0.5
    found = checks._loads(logs, fit, 2.0)
    hint = f"its torque fits {mass:+.2f} kg on the platform compared with the other logs: a payload?"
    assert found == ({"b": hint} if loaded else {})


def test_what_a_payload_would_take_is_a_mass_a_block_by_weight_and_inertia() -> None:
    """Against least squares over the samples, joints by their noise; a block without motion has no say."""
    random = np.random.default_rng(1)
    noise, values = np.array([0.5, 1.0, 2.0]), random.standard_normal(9)
    columns = random.standard_normal((3, 3, 40, COLUMNS))
    columns[2] = 0.0
    log: Any = stub(gram=np.einsum("bjna,bjnc->bjac", columns, columns))
    before = after = 0.0
    for block in (0, 1):
        load, left = (np.concatenate(parts) for parts in zip(*(
            (own[:, PLATFORM_COLUMN] / s, own @ (target(j) - selection(j) @ values) / s)
            for j, (own, s) in enumerate(zip(columns[block], noise, strict=True))
        ), strict=True))  # fmt: skip
        mass = np.linalg.lstsq(load[:, None], left)[0]
        before, after = before + left @ left, after + ((left - load * mass) ** 2).sum()
    assert checks._taken(log, values, noise) == pytest.approx(1 - after / before)


@pytest.mark.parametrize("first", [0.5, 1e-5])
def test_a_blocks_mass_is_what_its_weight_asks_for_beside_its_inertia(first: float) -> None:
    """Against least squares over the samples; what is left of the torque by the others' fit is asked, joints by their
    noise, but none as if it had a thousandth of the most; a block that hardly shows weight has no say."""
    random = np.random.default_rng(0)
    moving, noise, values = 2.5, np.array([first, 1.0, 2.0]), random.standard_normal(9)
    columns = random.standard_normal((3, 3, 40, COLUMNS))
    columns[1, ..., WEIGHT_COLUMN] *= 0.3  # of the second block
    columns[2, ..., PLATFORM_COLUMN] = columns[2, ..., WEIGHT_COLUMN] * moving  # of the third: no acceleration
    log: Any = stub(gram=np.einsum("bjna,bjnc->bjac", columns, columns))
    masses, sure = checks._masses(log, values, noise, moving)
    expected, reckoned = [], np.maximum(noise, 2e-3)
    for block in (0, 2):
        weight, inertia, left = (np.concatenate(parts) for parts in zip(*(
            (own[:, WEIGHT_COLUMN] / s, (own[:, PLATFORM_COLUMN] / moving - own[:, WEIGHT_COLUMN]) / s,
             own @ (target(j) - selection(j) @ values) / s)
            for j, (own, s) in enumerate(zip(columns[block], reckoned, strict=True))), strict=True))  # fmt: skip
        ridge = np.sqrt(1e-3 * weight @ weight)
        rows = np.column_stack([np.r_[weight, 0.0], np.r_[inertia, ridge]])
        alone = rows[:, 0] - rows[:, 1] * (rows[:, 0] @ rows[:, 1]) / (rows[:, 1] @ rows[:, 1])
        expected.append((np.linalg.lstsq(rows, np.r_[left, 0.0], rcond=None)[0][0], alone @ alone))
    np.testing.assert_allclose(masses, [mass for mass, _ in expected], rtol=1e-5)
    np.testing.assert_allclose(sure, [one for _, one in expected], rtol=1e-5)


def test_what_parameters_leave_of_a_log_is_summed_over_its_motion() -> None:
    random = np.random.default_rng(1)
    columns, values = random.standard_normal((2, 3, 50, COLUMNS)), random.standard_normal(9)
    columns[..., -1] = 1.0
    columns[:, 2] = 0.0
    log: Any = stub(
        gram=1e-3 * np.einsum("bjna,bjnc->bjac", columns, columns), seconds=1e-3 * 50 * np.array([[1, 1, 0]] * 2)
    )
    left = [columns[:, j] @ (target(j) - selection(j) @ values) for j in range(3)]
    np.testing.assert_allclose(rms_residual(log, values), [np.sqrt(np.mean(part**2)) for part in left])


@pytest.mark.parametrize(("angle", "alike"), [(0.04, True), (0.05, False)])
def test_trajectories_are_alike_where_all_of_them_tell_the_same(
    monkeypatch: pytest.MonkeyPatch, angle: float, alike: bool
) -> None:
    """A cosine of 0.999 between what they tell, whatever the units and how long they are."""
    told = []
    for turned in (0.0, 0.0, angle):
        one = np.zeros((9, 9))
        one[0, 0], one[1, 1] = np.cos(np.pi / 4 + turned), np.sin(np.pi / 4 + turned)
        told.append(one)
    units = np.diag(np.r_[1e3, 1e-3, np.ones(7)])
    monkeypatch.setattr(checks, "information", lambda gram: units @ np.stack([5.0 * told[0], *told[1:]]) @ units)
    logs: Any = [stub(gram=np.zeros((2, 3, COLUMNS, COLUMNS)))] * 3
    assert bool(checks._sameness(logs)) is alike


def test_a_readings_share_is_what_least_squares_over_the_samples_leave() -> None:
    """Joint 1 has joint 2's torque with the other sign, all are a fifth of what they should be."""
    random = np.random.default_rng(2)
    columns = random.standard_normal((3, 60, COLUMNS))
    torque = random.standard_normal((60, 3))
    columns[:, :, 7:10] = torque
    gram = np.einsum("jna,jnc->jac", columns, columns)
    order, signs, scale = (1, 0, 2), (-1.0, 1.0, 1.0), 5.0
    whole = np.concatenate([columns[j] @ selection(j) for j in range(3)])
    meant = np.concatenate([scale * signs[j] * torque[:, order[j]] for j in range(3)])
    wanted = meant - columns[:, :, PLATFORM_COLUMN].ravel()
    left = wanted - whole @ np.linalg.lstsq(whole, wanted, rcond=None)[0]
    assert checks._left(gram, order, signs, scale) == pytest.approx(np.linalg.norm(left) / np.linalg.norm(meant))


def test_a_torque_of_unknown_scale_is_explained_by_the_platforms_beside_all_others() -> None:
    """Joint 1 has joint 2's torque with the other sign, all are a fifth of what they should be, with noise: scale and
    share as least squares over the samples have them; no other order or sign does as well."""
    random = np.random.default_rng(3)
    columns, values = random.standard_normal((3, 60, COLUMNS)), np.r_[random.uniform(1.0, 2.0, 8), -1.5]
    true = np.stack([columns[j] @ selection(j) @ values + columns[j, :, PLATFORM_COLUMN] for j in range(3)], axis=1)
    torque = 0.2 * np.column_stack([true[:, 1], -true[:, 0], true[:, 2]]) + 0.05 * random.standard_normal((60, 3))
    columns[:, :, 7:10] = torque
    whole = np.concatenate([np.column_stack([c @ selection(j), c[:, PLATFORM_COLUMN]]) for j, c in enumerate(columns)])
    meant = np.concatenate([-torque[:, 1], torque[:, 0], torque[:, 2]])
    found = np.linalg.lstsq(whole, meant, rcond=None)[0]
    reading = checks.best_reading(np.einsum("jna,jnc->jac", columns, columns), 25.0, free_scale=True)
    assert (tuple(reading.order), tuple(reading.signs)) == ((1, 0, 2), (-1.0, 1.0, 1.0))
    assert reading.scale == pytest.approx(1.0 / found[-1])
    assert reading.scale == pytest.approx(5.0, rel=0.1)
    assert reading.share == pytest.approx(np.linalg.norm(meant - whole @ found) / np.linalg.norm(meant))
    against = checks._scaled(np.einsum("jna,jnc->jac", columns, columns), (1, 0, 2), (1.0, -1.0, -1.0))
    assert (against.share, against.scale) == (np.inf, 1.0), "a platform of negative mass"


@pytest.mark.parametrize(
    ("order", "signs", "scale", "gear", "told"),
    [
        ((2, 1, 0), (1, 1, 1), 1.0, 25.0, "the torques of joints 1 and 3 are swapped: as given"),
        ((1, 2, 0), (1, -1, -1), 1.0, 25.0, "the torques of joints 1, 2 and 3 are swapped and the torque of joints 2 "
                                            "and 3 has the wrong sign: as given"),
        ((0, 1, 2), (1, 1, 1), 25.0, 25.0, "the torque is not multiplied by the gear ratio 25: as given"),
        ((0, 1, 2), (1, 1, 1), 2.1, 2.1, "the torque is not multiplied by the gear ratio 2.1: as given"),
        ((0, 1, 2), (1, 1, 1), 1.9, 1.9, ""),  # hardly a gear
        ((0, 1, 2), (1, 1, 1), 1.0, 25.0, ""),
    ],
)  # fmt: skip
def test_how_else_a_torque_makes_sense_is_said(
    order: tuple[int, ...], signs: tuple[int, ...], scale: float, gear: float, told: str
) -> None:
    """Of a torque whose parameters explain all but five hundredths of it."""
    random = np.random.default_rng(4)
    columns, values = random.standard_normal((3, 60, COLUMNS)), random.uniform(1.0, 2.0, 9)
    true = np.stack([columns[j] @ selection(j) @ values + columns[j, :, PLATFORM_COLUMN] for j in range(3)], axis=1)
    true += 0.05 * true.std() * random.standard_normal(true.shape)
    for joint in range(3):
        columns[:, :, 7 + order[joint]] = true[:, joint] / signs[joint] / scale
    gram = np.einsum("jna,jnc->jac", columns, columns)
    said = checks._reading(gram, gear)
    assert said.startswith(told) if told else said == ""
    reading = checks.best_reading(gram, gear)
    if told:
        assert (tuple(reading.order), tuple(reading.signs), reading.scale) == (order, signs, scale)
        left, right = (100 * share for share in (checks._left(gram, *checks._AS_GIVEN), reading.share))
        assert said.endswith(f"leaves {left:.0f} % of it unexplained, corrected {right:.1f} %")
    else:
        assert reading[1:] == checks._AS_GIVEN


@pytest.mark.parametrize(
    ("better", "given", "taken"), [(0.049, 0.101, True), (0.051, 0.101, False), (0.001, 0.099, False)]
)
def test_another_reading_is_believed_where_it_leaves_half_and_the_given_a_tenth(
    monkeypatch: pytest.MonkeyPatch, better: float, given: float, taken: bool
) -> None:
    def left(gram: object, order: tuple[int, ...], signs: tuple[float, ...], scale: float) -> float:
        return given if (order, signs, scale) == checks._AS_GIVEN else better if signs == (1.0, -1.0, 1.0) else 0.9

    monkeypatch.setattr(checks, "_left", left)
    assert checks.best_reading(np.zeros((3, COLUMNS, COLUMNS)), 1.0).share == (better if taken else given)
