"""Cogging of many orders on one joint, made here: all of them are found, a high one too, in whatever band it lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.axes import Axes
from schemas.trace import Trace
from service.diagnosis.diagnose import diagnose
from service.diagnosis.documents.document import document
from service.model import ripple
from service.model.effects import by_name, catalogue

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
    orders = {key.removeprefix("order"): value for key, value in values.items() if key.startswith("order")}
    return {order: float(np.hypot(values[f"cosine{k}"], values[f"sine{k}"])) for k, order in orders.items()}, (
        told.gap.band_hz
    )


def test_every_order_is_found() -> None:
    orders, band = found(RIPPLE)
    assert sorted(orders) == pytest.approx(sorted(RIPPLE), abs=0.01)
    for order, size in orders.items():
        assert size == pytest.approx(RIPPLE[round(order)][0], rel=0.03)
    assert band == 40.0


def test_the_band_follows_an_order_above_it() -> None:
    orders, band = found({HIGH: (0.03, 0.4)})
    assert band > HIGH * 1.4 / (2 * np.pi)
    assert list(orders) == pytest.approx([HIGH], abs=0.05)
    assert list(orders.values()) == pytest.approx([0.03], rel=0.03)


def test_noise_has_no_order() -> None:
    rng = np.random.default_rng(0)
    turns, noise = np.cumsum(rng.uniform(0, 0.01, 20_000)), rng.normal(size=20_000)
    assert ripple.standing_out(turns, noise) == []
    assert ripple.standing_out(turns, noise + 0.3 * np.cos(2 * np.pi * 83 * turns)) == [83]
