"""What an identification, an evaluation or a payload estimation comes to, in a sentence or two.

The measure of a gap is the noise of the torque in the analysis band: a model that explains a log leaves no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.axes_description import Description
from schemas.diagnosis import named_joints
from schemas.messages import PayloadEvent
from schemas.words import percent
from service.identification.evaluation import Evaluation, pooled_by_model
from service.identification.fit import WITHIN_COLOURED
from service.identification.pooled import Plain
from service.model.description import in_units_of

if TYPE_CHECKING:
    from service.identification.log_load import Load
    from service.identification.weighed_picks import MassLevel  # with the estimator, which `identify` does without

AS_IDENTIFIED = (
    2.0  # times what a model left of the logs that it was identified on, from which these logs are unlike them
)


def explains(ratio: np.ndarray) -> bool:
    """Whether a model leaves no more than noise. ratio: (n,) rms residual over rms noise; NaN where a joint rests."""
    return not bool(np.nanmax(ratio, initial=0.0) > WITHIN_COLOURED)


def of_fit(fit: Plain) -> tuple[str, bool]:
    """The conclusion of an identification, and whether the model explains its logs."""
    held_out = bool(np.isfinite(fit.held_out).any())
    ratio = _rms(fit.held_out if held_out else fit.residual) / fit.noise_floor
    logs = "held-out logs" if held_out else "the log it was fitted to"
    return _over_noise(ratio, "The identified model", logs), explains(ratio)


def of_evaluation(robot: Description, results: Sequence[Evaluation]) -> tuple[str, bool]:
    """The conclusion of an evaluation, and whether the fullest model explains the logs; the stretches that stand far
    above the rest are left out."""
    if robot.identified is None:
        return f"{robot.name} was never identified: only the textbook model can be compared.", False
    name, moments = list(pooled_by_model(results, "calm").items())[-1]
    unit = in_units_of(robot, "N m")
    logs = "these logs outside the events" if any(result.events for result in results) else "these logs"
    noise = _noise(robot, results)
    if noise is None:
        left = f"The model '{name}' has a residual of {_each(moments.rms)} {unit} rms on {logs}"
        return f"{left}; the description does not contain the noise level to compare it with.", True
    ratio = moments.rms / noise
    said = _over_noise(ratio, f"The model '{name}'", logs)
    error = robot.model_error
    if error is not None:
        then = moments.rms / np.hypot(error.value, noise)
        if np.nanmax(then, initial=0.0) > AS_IDENTIFIED:
            said += (
                f" That is {_each(then)} times its residual on the logs it was identified on: the robot has changed "
                "since, carries a payload, or these logs are in other units."
            )
    return said, explains(ratio)


def of_payload(seen: Sequence[MassLevel]) -> str:
    """The conclusion of a payload estimation over all logs."""
    picks = [one for one in seen if one.event == PayloadEvent.PICK]
    if not picks:
        return "No pick was detected: no payload can be distinguished from the model's error."
    masses = [one.mass for one in picks]
    random = [one.random_std_dev for one in picks]
    found, whose = f"1 pick of {masses[0]:.3f} kg, known to ± {random[0]:.3f} kg", "its"
    if len(picks) > 1:
        found, whose = f"{len(picks)} picks of {min(masses):.3f} to {max(masses):.3f} kg, known to ± ", "their"
        found += f"{np.median(random):.3f} kg (median; the worst to ± {max(random):.3f} kg)"
    trusted = np.average([one.trusted for one in picks], weights=[one.end - one.begin + 1e-9 for one in picks])
    shares = [one.common_std_dev / max(one.mass, one.random_std_dev) for one in picks]
    common = " to ".join(dict.fromkeys(percent(extreme(shares), 1) for extreme in (min, max)))
    return (
        f"{found}, with a common error of {common} of the mass "
        f"(one standard deviation); trusted during {percent(trusted)} of {whose} time."
    )


def _over_noise(ratio: np.ndarray, model: str, logs: str) -> str:
    joints = named_joints([joint + 1 for joint in range(len(ratio))])
    said = f"{model} has a residual of {_each(ratio)} times the noise of the torque on {logs} ({joints})"
    if explains(ratio):
        return f"{said}: it explains them."
    causes = "a wrong geometry, mass or unit, a payload, an unmodelled effect"
    return f"{said}: it does not explain them. Possible causes: {causes}."


def _noise(robot: Description, results: Sequence[Evaluation]) -> np.ndarray | None:
    """(3,) N m, the part of a Delta's white torque noise that lies in the analysis band; None where it is not known."""
    told = robot.torque_noise
    if told is None:
        return None
    period = float(np.median([result.trace.period for result in results]))
    band = float(np.median([result.band_hz for result in results]))
    return np.array(told.value) * np.sqrt(min(1.0, 2 * band * period))


def _rms(values: np.ndarray) -> np.ndarray:
    """(n,) of (T, n) over the logs; a joint that moves in none has none."""
    known = np.isfinite(values)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.sqrt(np.nansum(values**2, axis=0) / count)


def _each(values: np.ndarray) -> str:
    told = ["-" if np.isnan(value) else f"{value:.2g}" for value in values]
    return told[0] if len(told) == 1 else f"{', '.join(told[:-1])} and {told[-1]}"


def of_load(one: Load) -> str:
    """The result of a log in a sentence, and what to do if a quantity is not identifiable."""
    if not one.seen:
        return (
            f"{one.trace}: no load was found on {one.frame}: {one.mass:.3f} ± {one.mass_error:.3f} kg; if there is "
            "one, log motion of joints that lift it"
        )
    said = f"{one.trace}: {one.mass:.3f} ± {one.mass_error:.3f} kg on {one.frame}"
    if not one.centre_told:
        return f"{said}; its centre is not identifiable: also turn the last joints with their axes horizontal"
    said += f", centre within {1e3 * one.centre_error.max():.1f} mm"
    if not one.inertia_told:
        return f"{said}; its inertia is not identifiable: turn the last joints faster"
    return f"{said}, inertia within {1e3 * one.inertia_error.max():.2g} g m^2"
