"""The effect catalogue: one file and one line per effect, and the user's own."""

from __future__ import annotations

import importlib
import sys
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from schemas.errors import RobotError
from service.model.effects.base import Effect

NAMES = (
    "stribeck_friction",
    "asymmetric_friction",
    "load_dependent_friction",
    "nonlinear_viscous_friction",
    "position_dependent_friction",
    "warmup_friction",
    "presliding_friction",
    "passive_joint_friction",
    "shaft_friction",
    "rotor_inertia",
    "arm_mass",
    "tool_mass",
    "base_tilt",
    "joint_spring",
    "hose_spring",
    "air_drag",
    "link_length_error",
    "forearm_length_error",
    "base_radius_error",
    "azimuth_error",
    "joint_offset",
    "angle_scale",
    "joint_elasticity",
    "backlash",
    "torque_scale",
    "torque_offset",
    "torque_delay",
    "torque_filter",
    "drive_lag",
    "cogging",
    "encoder_eccentricity",
)
ENTRY_POINTS = "deltatwin.effects"


def catalogue(extra: Path | None = None) -> tuple[Effect, ...]:
    """The effects above, those of installed packages (entry point group `deltatwin.effects`, an Effect each), and those
    of the Python file `extra`: every dataclass in it that derives from Effect.

    Raises:
        RobotError: the file or an entry point cannot be run, the file holds no effect, or a name is taken.
    """
    found = [*CATALOGUE, *_installed(tuple(sys.path))]
    if extra is not None:
        if not extra.is_file():
            raise RobotError(f"{extra}: no such file; a Python file with effects is needed")
        found += _from_file(extra.resolve(), extra.stat().st_mtime_ns)
    names = [effect.name for effect in found]
    for name in names:
        if names.count(name) > 1:
            raise RobotError(f"{extra or ENTRY_POINTS}: effect {name!r} is defined twice")
    return tuple(found)


@lru_cache
def _installed(path: tuple[str, ...]) -> tuple[Effect, ...]:
    """Those of packages on `path`, which is searched once: that takes 20 ms.

    Raises:
        RobotError: an entry point cannot be run.
    """
    found = []
    for point in entry_points(group=ENTRY_POINTS):
        try:
            found.append(_made(point.load()))
        except Exception as error:
            raise RobotError(f"effect {point.name} = {point.value}: {type(error).__name__}: {error}") from error
    return tuple(found)


def by_name(effects: tuple[Effect, ...]) -> dict[str, Effect]:
    """name -> effect."""
    return {effect.name: effect for effect in effects}


@lru_cache(maxsize=8)
def _from_file(path: Path, changed: int) -> list[Effect]:
    """Effects of a file that was last changed at `changed` ns; run once, so that they stay equal to themselves."""
    name = f"deltatwin_effects_{path.stem}_{changed}"
    module = sys.modules[name] = ModuleType(name)  # dataclasses look their module up
    try:
        # not by the import system: its cache takes a file of one size, changed twice in a second, for the old one
        exec(compile(path.read_bytes(), path, "exec"), vars(module))
        found = _effects(module)
    except Exception as error:
        del sys.modules[name]
        raise RobotError(f"{path}: {type(error).__name__}: {error}") from error
    if not found:
        raise RobotError(f"{path}: no class derived from deltatwin.effects.Effect")
    return found


def _effects(module: ModuleType) -> list[Effect]:
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, Effect)]
    return [_made(kind) for kind in kinds if kind.__module__ == module.__name__]


def _made(kind: type[Effect]) -> Effect:
    """One of it, with what has no default."""
    effect = kind()
    for key in ("name", "settles"):
        if not isinstance(getattr(effect, key, None), str):
            raise TypeError(f"class {kind.__name__} has no text {key!r}")
    return effect


CATALOGUE = tuple(effect for name in NAMES for effect in _effects(importlib.import_module(f"{__name__}.{name}")))
