"""Cogging of many orders on one joint, made here: all of them are found, a high one too, in whatever band it lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.axes_description import Axes
from schemas.trace import Trace
from service.diagnosis.documents.document import document
from service.diagnosis.fit import orders
from service.diagnosis.pipeline import diagnose
from service.model import ripple
from service.model.effects import by_name, catalogue
from tests.service.world import stub

AXES = Axes.model_validate({"name": "motor", "kind": "axes", "axis": [{}]})
# order: amplitude N m, phase rad
RIPPLE = {7: (0.048, 0.3), 28: (0.031, 1.1), 14: (0.019, -2.0), 36: (0.016, 0.7)}
HIGH = 240
PERIOD = 1e-3


def turning(speed: float, seed: int, ripples: dict[int, tuple[float, float]]) -> Trace:
    """An axis of 3e-4 kg m^2 turned to and fro at `speed` rad/s."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(12_000)
    rate = 2 * np.pi / 11.3
    angle, bent = speed / rate * np.sin(rate * time), -speed * rate * np.sin(rate * time)
    velocity = speed * np.cos(rate * time)
    torque = 3e-4 * bent + 0.0093 * np.sign(velocity) + 1e-3 * velocity + rng.normal(0, 5e-4, len(time))
    for order, (size, phase) in ripples.items():
        torque += size * np.cos(order * angle - phase)
    return Trace(Path(f"turn_{seed}.csv"), time, angle[:, None], torque[:, None])


def found(ripples: dict[int, tuple[float, float]]) -> tuple[dict[float, float], float]:
    """Order -> amplitude of the one effect named, and the analysis band."""
    traces = [turning(speed, seed, ripples) for seed, speed in enumerate((0.9, 1.4, 2.0))]
    effects = by_name(catalogue())
    told = document(diagnose(AXES, traces, [effects[name] for name in ("cogging", "torque_filter", "joint_spring")]))
    (effect,) = told.effects
    assert (effect.name, effect.joints) == ("cogging", [1])
    values = {key: estimate.value for key, estimate in effect.parameters.items()}
    at = {key.removeprefix("order"): value for key, value in values.items() if key.startswith("order")}
    return {order: float(np.hypot(values[f"cosine{k}"], values[f"sine{k}"])) for k, order in at.items()}, (
        told.gap.band_hz
    )


def test_every_order_is_found() -> None:
    known, band = found(RIPPLE)
    assert sorted(known) == pytest.approx(sorted(RIPPLE), abs=0.01)
    for order, size in known.items():
        assert size == pytest.approx(RIPPLE[round(order)][0], rel=0.03)
    assert band == 40.0


def test_the_band_follows_an_order_above_it() -> None:
    known, band = found({HIGH: (0.03, 0.4)})
    assert band > HIGH * 1.4 / (2 * np.pi)
    assert list(known) == pytest.approx([HIGH], abs=0.05)
    assert list(known.values()) == pytest.approx([0.03], rel=0.03)


def test_noise_has_no_order() -> None:
    rng = np.random.default_rng(0)
    turns, noise = np.cumsum(rng.uniform(0, 0.01, 20_000)), rng.normal(size=20_000)
    assert ripple.standing_out(turns, noise) == []
    assert ripple.standing_out(turns, noise + 0.3 * np.cos(2 * np.pi * 83 * turns)) == [83]


def test_what_is_left_is_told_by_the_motors_turns_and_a_constant_is_no_order() -> None:
    """Joint 2 of two, behind a gear of 10, in a band that keeps every other row; the first half of them count."""
    theta = np.linspace(0.0, 30.0, 4000)
    rows = np.stack([np.ones(2000, bool), np.arange(2000) < 1000], axis=1)
    ripple_of = 0.1 + 0.1 * np.cos(4 * 10 * theta[::2])
    recording = stub(mechanism=stub(gear_ratio=[1.0, 10.0]), segment=stub(theta=np.stack([0 * theta, theta], axis=1)))
    joints = np.repeat([0, 1], rows.sum(axis=0))
    left = np.concatenate([np.zeros(2000), ripple_of[rows[:, 1]]])
    problem = stub(recordings=[recording], rows=[rows], joints_of_rows=[joints], band=stub(step=2))
    strength = orders._left(problem, stub(fitted=stub(residuals=[left])), 1)
    assert strength[0] == 0.0
    assert int(np.argmax(strength[:200])) == 4, "evenly turned, it comes again mirrored"
