"""The effect catalogue: one line an effect, and the user's own."""

from __future__ import annotations

import importlib.util
from importlib.metadata import entry_points
from pathlib import Path

from schemas.errors import RobotError
from service.diagnosis.effects import force, friction, geometry, mass, ripple, signal, transmission
from service.diagnosis.effects.base import Effect

CATALOGUE: tuple[Effect, ...] = (
    friction.StribeckFriction(),
    friction.AsymmetricFriction(),
    friction.LoadDependentFriction(),
    friction.NonlinearViscousFriction(),
    friction.PositionDependentFriction(),
    friction.WarmupFriction(),
    friction.PreslidingFriction(),
    friction.PassiveJointFriction(),
    mass.RotorInertia(),
    mass.ArmMass(),
    mass.ToolMass(),
    mass.BaseTilt(),
    force.JointSpring(),
    force.HoseSpring(),
    force.AirDrag(),
    geometry.LinkLengthError(),
    geometry.JointOffset(),
    transmission.JointElasticity(),
    transmission.Backlash(),
    signal.TorqueScale(),
    force.TorqueOffset(),
    signal.TorqueDelay(),
    signal.TorqueFilter(),
    ripple.Cogging(),
    ripple.EncoderEccentricity(),
)

ENTRY_POINTS = "deltatwin.effects"


def catalogue(extra: Path | None = None) -> tuple[Effect, ...]:
    """The effects above, those of installed packages (entry point group `deltatwin.effects`, an Effect each), and those
    of the Python file `extra`: every dataclass in it that derives from Effect.

    Raises:
        RobotError: the file or an entry point cannot be run, the file holds no effect, or a name is taken.
    """
    found = list(CATALOGUE)
    for point in entry_points(group=ENTRY_POINTS):
        try:
            found.append(point.load()())
        except Exception as error:
            raise RobotError(f"effect {point.name} = {point.value}: {type(error).__name__}: {error}") from error
    if extra is not None:
        found += _from_file(extra)
    names = [effect.name for effect in found]
    for name in names:
        if names.count(name) > 1:
            raise RobotError(f"{extra or ENTRY_POINTS}: effect {name!r} is defined twice")
    return tuple(found)


def by_name(effects: tuple[Effect, ...]) -> dict[str, Effect]:
    """name -> effect."""
    return {effect.name: effect for effect in effects}


def _from_file(path: Path) -> list[Effect]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise RobotError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise RobotError(f"{path}: {type(error).__name__}: {error}") from error
    kinds = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Effect) and kind.__module__ == module.__name__
    ]
    if not kinds:
        raise RobotError(f"{path}: no class derived from service.diagnosis.effects.base.Effect")
    return [kind() for kind in kinds]
