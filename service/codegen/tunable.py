"""Figures that a controller may load while it runs, and what no robot has of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from service.estimator.state import SETTINGS


class Loadable(NamedTuple):
    """name: of a field of the estimator's settings. low, high: beyond which a figure is refused."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float


# What follows from them is not loaded: filters, noise and what friction may drift by stay as they were identified.
LOADABLE = (
    Loadable("rho", "-", "rho_1 and rho_2 of each joint", 0.05, 50.0),
    Loadable("forearm", "kg", "forearm mass whose rod coupling is added", 0.0, 50.0),
    Loadable("viscous", "N m s/rad", "viscous friction of each joint", 0.0, 1e3),
    Loadable("coulomb", "N m", "Coulomb friction of each joint", 0.0, 1e4),
    Loadable("scale", "-", "reported over true torque of each joint", 0.2, 5.0),
    Loadable("peak", "N m", "largest feed-forward torque", 1e-3, 1e6),
    Loadable("slope", "N m/s", "largest slope of the feed-forward", 1e-3, 1e9),
    Loadable("fade", "s", "time in which the feed-forward fades to zero without usable motion", 1e-4, 100.0),
    Loadable("max_payload", "kg", "largest payload", 1e-3, 1e3),
)


def shape(one: Loadable) -> tuple[int, ...]:
    return SETTINGS[one.name].shape


def growth_share(settings: np.ndarray) -> float:
    """Of the slope, what it may grow by in one cycle (`bounds.growth_of`, which makes it a share of the slope)."""
    return float(settings["growth"][0] / settings["slope"][0])
