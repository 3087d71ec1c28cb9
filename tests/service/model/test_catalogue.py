"""What the catalogue says of its effects: units and bounds of every quantity, and what each effect is good for.

A bound is a promise to the reader of a document and a grid is how far the search sees: neither moves by accident.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.service.subject import CATALOGUE, EFFECTS

INF = math.inf
FLAGS = ("per_joint", "own_joint", "measured", "rough", "own_nonlinear", "directional", "takes_timing")

# name: flags, quantity -> (unit, low, high), what no motion tells it from, beyond any robot's (alone, together), kind
STATED = {
    "stribeck_friction": (
        "per_joint own_joint own_nonlinear directional",
        {"f_s": ("N m", 0.0, INF), "v_s": ("rad/s", 0.005, 2.0)},
        [],
        INF,
        INF,
        "",
    ),
    "asymmetric_friction": (
        "per_joint own_joint directional",
        {"delta_c": ("N m", -INF, INF), "delta_v": ("N m s/rad", -INF, INF)},
        ["torque_offset"],
        INF,
        INF,
        "",
    ),
    "load_dependent_friction": (
        "per_joint own_joint directional",
        {"mu": ("", 0.0, 1.0), "motor_share": ("", 0.0, 1.0, "fixed")},
        [],
        INF,
        INF,
        "",
    ),
    "nonlinear_viscous_friction": (
        "per_joint own_joint own_nonlinear directional",
        {"f": ("N m (s/rad)^p", 0.0, INF), "p": ("", 0.2, 4.0)},
        [],
        INF,
        INF,
        "",
    ),
    "position_dependent_friction": (
        "per_joint own_joint directional",
        {"cosine": ("N m", -INF, INF), "sine": ("N m", -INF, INF), "order": ("", 0.5, 40.0)},
        [],
        INF,
        INF,
        "",
    ),
    "warmup_friction": (
        "per_joint own_joint",
        {"f": ("N m s/rad", 0.0, INF), "tau": ("s", 1.0, 3600.0)},
        [],
        INF,
        INF,
        "",
    ),
    "presliding_friction": (
        "per_joint own_joint own_nonlinear directional",
        {"f": ("N m", 0.0, INF), "distance": ("rad", 0.0002, 0.2)},
        [],
        INF,
        INF,
        "",
    ),
    "passive_joint_friction": (
        "",
        {
            "dry_elbow": ("N m", 0.0, INF),
            "dry_platform": ("N m", 0.0, INF),
            "viscous_elbow": ("N m s/rad", 0.0, INF),
            "viscous_platform": ("N m s/rad", 0.0, INF),
        },
        [],
        INF,
        INF,
        "delta",
    ),
    "shaft_friction": ("", {"dry": ("N", 0.0, INF), "viscous": ("N s/m", 0.0, INF)}, [], INF, INF, "delta"),
    "rotor_inertia": ("per_joint own_joint", {"delta_i": ("kg m^2", 0.0, INF)}, [], INF, INF, ""),
    "arm_mass": ("per_joint own_joint", {"delta_m": ("kg", -INF, INF)}, [], INF, INF, "delta"),
    "tool_mass": ("", {"delta_m": ("kg", -INF, INF)}, [], INF, INF, "delta"),
    "base_tilt": ("", {"about_x": ("rad", -INF, INF), "about_y": ("rad", -INF, INF)}, [], 0.35, INF, "delta"),
    "joint_spring": (
        "per_joint own_joint directional",
        {"k": ("N m/rad", 0.0, INF), "preload": ("N m", -INF, INF)},
        [],
        INF,
        INF,
        "",
    ),
    "hose_spring": (
        "",
        {"k": ("N/m", 0.0, INF), "force_x": ("N", -INF, INF), "force_y": ("N", -INF, INF), "force_z": ("N", -INF, INF)},
        [],
        INF,
        INF,
        "delta",
    ),
    "air_drag": ("", {"c": ("N s^2/m^2", 0.0, INF)}, [], INF, INF, "delta"),
    "link_length_error": ("per_joint", {"error": ("m", -INF, INF)}, [], 0.2, 0.05, "delta"),
    "forearm_length_error": ("per_joint", {"error": ("m", -INF, INF)}, [], 0.1, 0.05, "delta"),
    "base_radius_error": ("per_joint", {"error": ("m", -INF, INF)}, [], 0.1, 0.05, "delta"),
    "azimuth_error": ("per_joint", {"error": ("rad", -INF, INF)}, [], 0.3, 0.1, "delta"),
    "joint_offset": ("per_joint", {"error": ("rad", -INF, INF)}, [], 0.3, 0.05, "delta"),
    "angle_scale": ("per_joint", {"epsilon": ("", -1.0, INF)}, [], 0.3, 0.05, "delta"),
    "joint_elasticity": (
        "per_joint rough",
        {"natural_hz": ("Hz", 2.0, 250.0), "damping_ratio": ("", 0.01, 2.0), "motor_share": ("", 0.02, 0.9)},
        [],
        INF,
        INF,
        "",
    ),
    "backlash": (
        "per_joint rough directional",
        {
            "half": ("rad", 0.0001, 0.02),
            "contact_hz": ("Hz", 5.0, 400.0, "late"),
            "contact_damping": ("", 0.02, 4.0, "late"),
            "motor_share": ("", 0.02, 0.9),
        },
        [],
        INF,
        INF,
        "",
    ),
    "torque_scale": ("per_joint own_joint measured", {"epsilon": ("", -1.0, INF)}, [], 0.5, INF, ""),
    "torque_offset": (
        "per_joint own_joint directional",
        {"offset": ("N m", -INF, INF)},
        ["asymmetric_friction"],
        INF,
        INF,
        "",
    ),
    "torque_delay": ("measured takes_timing", {"delay": ("s", -0.02, 0.02)}, [], INF, INF, ""),
    "torque_filter": ("measured", {"cutoff": ("Hz", 0.3, 300.0)}, [], INF, INF, ""),
    "drive_lag": ("measured", {"cutoff": ("Hz", 1.0, 300.0)}, [], INF, INF, ""),
    "cogging": (
        "per_joint own_joint",
        {"cosine": ("N m", -INF, INF), "sine": ("N m", -INF, INF), "order": ("", 0.5, 500.0)},
        [],
        INF,
        INF,
        "",
    ),
    "encoder_eccentricity": (
        "per_joint",
        {"cosine": ("rad", -INF, INF), "sine": ("rad", -INF, INF), "order": ("", 0.5, 20.0)},
        [],
        0.03,
        INF,
        "",
    ),
}
# largest ratio of neighbours on the grid of a parameter that spans ratios, largest step of one that spans steps
RATIOS = {
    ("stribeck_friction", "v_s"): 1.8,
    ("nonlinear_viscous_friction", "p"): 2.6,
    ("warmup_friction", "tau"): 4.1,
    ("presliding_friction", "distance"): 2.4,
    ("joint_elasticity", "natural_hz"): 1.4,
    ("joint_elasticity", "motor_share"): 2.8,
    ("backlash", "half"): 1.6,
    ("backlash", "motor_share"): 2.1,
    ("torque_filter", "cutoff"): 1.9,
    ("drive_lag", "cutoff"): 1.9,
}
SPANS = {
    ("stribeck_friction", "v_s"): (0.01, 1.0),
    ("nonlinear_viscous_friction", "p"): (0.35, 3.0),
    ("load_dependent_friction", "motor_share"): (0.0, 1.0),
    ("position_dependent_friction", "order"): (1, 12),
    ("warmup_friction", "tau"): (3.0, 600.0),
    ("presliding_friction", "distance"): (3e-4, 0.1),
    ("joint_elasticity", "natural_hz"): (4.0, 60.0),
    ("joint_elasticity", "damping_ratio"): (0.07, 0.07),
    ("joint_elasticity", "motor_share"): (0.13, 0.35),
    ("backlash", "half"): (0.0003, 0.005),
    ("backlash", "contact_hz"): (20.0, 120.0),
    ("backlash", "contact_damping"): (0.1, 2.0),
    ("backlash", "motor_share"): (0.1, 0.55),
    ("torque_delay", "delay"): (-0.003, 0.006),
    ("torque_filter", "cutoff"): (1.0, 120.0),
    ("drive_lag", "cutoff"): (3.0, 120.0),
    ("cogging", "order"): (1, 36),
    ("encoder_eccentricity", "order"): (1, 4),
}

REPEATS = {"cogging"}
DISSIPATES = {
    "asymmetric_friction",
    "load_dependent_friction",
    "nonlinear_viscous_friction",
    "position_dependent_friction",
    "stribeck_friction",
    "warmup_friction",
}


@pytest.mark.parametrize("name", STATED)
def test_an_effect_is_what_is_stated(name):
    flags, quantities, same, beyond, together, kind = STATED[name]
    effect = EFFECTS[name]
    assert {flag for flag in FLAGS if getattr(effect, flag)} == set(flags.split())
    found: dict[str, tuple] = {key: (a.unit, a.low, a.high) for key, a in effect.amplitudes.items()}
    for key, searched in effect.nonlinear.items():
        found[key] = (
            searched.unit, searched.low, searched.high, *(flag for flag in ("fixed", "late") if getattr(searched, flag))
        )  # fmt: skip
    assert found == {key: tuple(value) for key, value in quantities.items()}
    assert list(found) == list(quantities), "the order of the documents"
    assert sorted(effect.same) == same
    assert (effect.beyond, effect.beyond_together) == (beyond, together)
    assert effect.kinds == (frozenset({"delta"}) if kind else frozenset({"delta", "axes", "chain"}))
    assert effect.settles
    for quantity in (*effect.amplitudes.values(), *effect.nonlinear.values()):  # what a report calls it: no symbols
        assert not set("_=<>") & set(quantity.meaning)
        assert " -" not in f" {quantity.meaning}"


def test_nothing_is_in_the_catalogue_that_is_not_stated():
    assert [effect.name for effect in CATALOGUE] == [*STATED]


def test_what_may_be_at_work_twice_and_what_takes_energy():
    assert {effect.name for effect in CATALOGUE if effect.repeats} == REPEATS
    assert {effect.name for effect in CATALOGUE if effect.dissipates} == DISSIPATES


@pytest.mark.parametrize(("name", "key"), SPANS)
def test_a_grid_leaves_no_hole(name, key):
    grid = np.array(EFFECTS[name].nonlinear[key].grid)
    assert (grid.min(), grid.max()) == pytest.approx(SPANS[name, key])
    assert (np.diff(grid) > 0).all()
    if (name, key) in RATIOS:
        assert (grid[1:] / grid[:-1]).max() < RATIOS[name, key]
    elif key == "order":
        assert (grid == grid.astype(int)).all()
        assert (np.diff(grid) <= np.maximum(1, grid[:-1] / 3)).all()


def test_every_grid_is_looked_at():
    grids = {(effect.name, key) for effect in CATALOGUE for key in effect.nonlinear}
    assert grids == set(SPANS)


def test_a_delay_is_looked_for_beyond_a_fraction_of_a_sample_in_both_directions():
    grid = np.array(EFFECTS["torque_delay"].nonlinear["delay"].grid)
    assert np.abs(grid).min() > 2.5e-4
    assert (grid < 0).sum() == 2
    assert np.diff(grid[grid > 0]).max() <= 0.003
