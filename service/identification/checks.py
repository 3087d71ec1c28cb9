"""Logs that are not what they should be: found from the sums, named by file and joint.

Errors where a fit would be worthless: torque swapped between joints, in the wrong sign, not multiplied by the gear
ratio; one log that no fit to the others explains; the same log twice. Warnings where a fit stands but says something
else than its user thinks: a payload on the platform, trajectories all alike, too few of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from schemas.diagnosis import named_joints
from schemas.errors import DataError
from schemas.words import part_of
from service.identification.fit import solve
from service.identification.folds import FOLDS
from service.identification.pooled import Plain
from service.identification.regression import (
    COLUMNS,
    PARAMETERS,
    PLATFORM_COLUMN,
    TORQUE_COLUMN,
    WEIGHT_COLUMN,
    NormalEquations,
    information,
    selection,
    target,
)

# Share of the torque's rms that a fit leaves: a real Delta's friction, elasticity and payload mass errors stay below.
SUSPECT = 0.1
HOPELESS = 0.5
FOREIGN_SHARE = 0.4  # of one log's torque, by the fit to the others: no other state of the same robot leaves as much
# Another reading of the torque is believed when it leaves less than this share of what the given one leaves.
BETTER = 0.5
# A log is foreign when the fit to the others leaves this many times what it leaves of the middle one of the others.
FOREIGN = 3.0
# Logs that shed this share of what is left above the noise when each is fitted alone are not of one robot.
FOREIGN_TOGETHER, FOREIGN_LEFT = 0.7, 2.0  # the second: times the noise that has to be left for the question to arise
PAYLOAD = 0.15  # kg against the other logs
STEADY = 0.7  # mean over rms of a log's masses: friction errors ask for weight in both directions, a payload in one
# Of what no fit to the others explains, squared, a payload takes more, with its weight and its inertia, even where
# gears give way beneath it; what fast motion wakes asks for weight that its inertia contradicts.
TAKEN = 0.5
ALIKE = 0.999  # cosine between the information of two trajectories

LEAST_TIMES = 2.0  # what is nearer to one than this may be a load or a warm gear as well as a unit or a gear ratio

ORDERS = tuple(permutations(range(3)))
SIGNS = tuple(product((1.0, -1.0), repeat=3))
_AS_GIVEN = ORDERS[0], SIGNS[0], 1.0


def check(logs: Sequence[NormalEquations], gear_ratio: float) -> None:
    """Refuse logs whose torque is not what the joints need.

    Raises:
        DataError: naming the logs, the joints and what is wrong with them.
    """
    _refuse_copies(logs)
    refuse_misread({log.name: log.gram for log in logs}, gear_ratio)


def refuse_misread(grams: Mapping[str, np.ndarray], gear_ratio: float, most: float = np.inf) -> None:
    """Refuse logs whose torque fits much better in another order, with another sign or on the other side of the gear.
    grams: (B, 3, COLUMNS, COLUMNS) by the name of the log, see `NormalEquations`. most: share of the torque's rms that
    the other reading may leave.

    Raises:
        DataError: naming the logs, the joints and what is wrong with them.
    """
    readings = {name: _reading(gram.sum(axis=0), gear_ratio, most) for name, gram in grams.items()}
    wrong = {name: reading for name, reading in readings.items() if reading}
    if wrong:
        first = next(iter(wrong.values()))
        names = ", ".join(wrong) if len(wrong) < len(readings) or len(wrong) < 3 else f"all {len(wrong)} logs"
        raise DataError(f"{names}: {first}")


def _refuse_copies(logs: Sequence[NormalEquations]) -> None:
    for later, log in enumerate(logs):
        for earlier in logs[:later]:
            if log.gram.shape == earlier.gram.shape and np.array_equal(log.gram, earlier.gram):
                raise DataError(f"{log.name}: the same motion and torque as {earlier.name}; give it only once")


class TorqueReading(NamedTuple):
    """A reading of the torque: that of joint j is `scale * signs[j] * torque[order[j]]`.

    share: of its rms, left by a fit.
    """

    share: float
    order: Sequence[int]
    signs: Sequence[float]
    scale: float


def best_reading(gram: np.ndarray, gear_ratio: float, free_scale: bool = False) -> TorqueReading:
    """The reading of one log's torque that makes most sense; the one given where it does. gram: (3, COLUMNS, COLUMNS).

    free_scale: the torque's unit is not known; its scale comes from the platform's mass.
    """
    if free_scale:
        options = [_scaled(gram, order, signs) for order, signs in product(ORDERS, SIGNS)]
        return min(options)
    given = TorqueReading(_left(gram, *_AS_GIVEN), *_AS_GIVEN)
    if given.share < SUSPECT:
        return given
    scales = (1.0, gear_ratio) if gear_ratio > LEAST_TIMES else (1.0,)
    best = min(TorqueReading(_left(gram, *option), *option) for option in product(ORDERS, SIGNS, scales))
    return best if best.share <= BETTER * given.share else given


def _scaled(gram: np.ndarray, order: Sequence[int], signs: Sequence[float]) -> TorqueReading:
    """The reading whose scale makes the platform's known torque as large as the fit wants it, beside the others' own.

    The torque is what is explained: among what explains it, its noise and what the model lacks would shrink its scale.
    """
    left = np.zeros((PARAMETERS + 1, PARAMETERS + 1))
    right = np.zeros(PARAMETERS + 1)
    square = 0.0
    for joint in range(3):
        platform, torque = np.zeros((COLUMNS, 1)), np.zeros(COLUMNS)
        platform[PLATFORM_COLUMN], torque[TORQUE_COLUMN + order[joint]] = 1.0, signs[joint]
        chosen = np.hstack([selection(joint), platform])
        left += chosen.T @ gram[joint] @ chosen
        right += chosen.T @ gram[joint] @ torque
        square += torque @ gram[joint] @ torque
    values = solve(left, right)
    if values[-1] <= 0:
        return TorqueReading(np.inf, order, signs, 1.0)
    share = np.sqrt(max(square - right @ values, 0.0) / max(square, 1e-12))
    return TorqueReading(float(share), order, signs, 1.0 / float(values[-1]))


def misread(order: Sequence[int], signs: Sequence[float]) -> list[str]:
    """What is wrong with torques that have to be read in another order, or with other signs."""
    faults = []
    if swapped := named_joints([joint + 1 for joint in range(3) if order[joint] != joint]):
        faults.append(f"the torques of {swapped} are swapped")
    if turned := named_joints([joint + 1 for joint in range(3) if signs[joint] < 0]):
        faults.append(f"the torque of {turned} has the wrong sign")
    return faults


def _reading(gram: np.ndarray, gear_ratio: float, most: float = np.inf) -> str:
    """How else the torque of one log makes sense, "" if it does as it is, or leaves more than `most` of it. gram: (3,
    COLUMNS, COLUMNS)."""
    given = _left(gram, *_AS_GIVEN)
    best, order, signs, scale = best_reading(gram, gear_ratio)
    if best == given or best > most:
        return ""
    faults = misread(order, signs)
    if scale != 1.0:
        faults.append(f"the torque is not multiplied by the gear ratio {gear_ratio:g}")
    shares = f"as given the model leaves {100 * given:.0f} % of it unexplained, corrected {100 * best:.1f} %"
    return f"{' and '.join(faults)}: {shares}"


def _left(gram: np.ndarray, order: Sequence[int], signs: Sequence[float], scale: float) -> float:
    """Share of the torque's rms that a fit leaves if joint j's torque is scale * signs[j] * torque[order[j]]."""
    left, right, square, torque = _sums(gram, order, signs, scale)
    values = solve(left, right)
    return float(np.sqrt(max(square - right @ values, 0.0) / max(torque, 1e-12)))


def _sums(
    gram: np.ndarray, order: Sequence[int], signs: Sequence[float], scale: float
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Normal equations of a reading, the square of what they are to explain, and that of the torque."""
    left = np.zeros((PARAMETERS, PARAMETERS))
    right = np.zeros(PARAMETERS)
    square = torque = 0.0
    for joint in range(3):
        chosen = selection(joint)
        wanted = np.zeros(COLUMNS)
        wanted[TORQUE_COLUMN + order[joint]], wanted[PLATFORM_COLUMN] = signs[joint] * scale, -1.0
        left += chosen.T @ gram[joint] @ chosen
        right += chosen.T @ gram[joint] @ wanted
        square += wanted @ gram[joint] @ wanted
        column = TORQUE_COLUMN + order[joint]
        torque += scale**2 * gram[joint, column, column]
    return left, right, square, torque


def held_out_share(gram: np.ndarray, reading: TorqueReading) -> float:
    """Share of the torque's rms that a reading leaves of blocks left out, each fold by the fit to the others. gram:
    (B, 3, COLUMNS, COLUMNS)."""
    folds = min(FOLDS, len(gram))
    if folds < 2:
        return reading.share
    parts = [_sums(gram[fold::folds].sum(axis=0), *reading[1:]) for fold in range(folds)]
    left, right = (np.stack([part[k] for part in parts]) for k in (0, 1))
    values = solve(left.sum(axis=0) - left, right.sum(axis=0) - right)
    square = np.array([part[2] for part in parts]) - 2 * np.einsum("fp,fp->f", values, right)
    square += np.einsum("fp,fpq,fq->f", values, left, values)
    return float(np.sqrt(max(square.sum(), 0.0) / max(sum(part[3] for part in parts), 1e-12)))


def check_fit(logs: Sequence[NormalEquations], fit: Plain, moving_mass: float) -> list[str]:
    """Warnings about logs that stand out against the fit to the others. moving_mass: kg, what the platform terms carry.

    Raises:
        DataError: a log that the fit to the others does not explain at all, or no fit explains any.
    """
    share = _share(fit.residual, fit.torque)
    hints = _loads(logs, fit, moving_mass)
    warnings: list[str] = []
    if len(logs) > 2:
        held = _share(fit.held_out, fit.torque)
        worst = int(np.argmax(held))
        others = np.delete(fit.left(fit.without[worst]), worst, axis=0)
        typical = float(np.median(_share(others, np.delete(fit.torque, worst, axis=0))))
        if held[worst] > max(FOREIGN * typical, 2 * SUSPECT):
            name, joint = logs[worst].name, int(np.argmax(fit.held_out[worst] / fit.torque[worst]))
            stands_out = (
                f"{name}: does not match the other logs: the fit to those leaves {part_of(held[worst])} its "
                f"torque unexplained (of their own {100 * typical:.1f} %), most on joint {joint + 1}"
            )
            hint = hints.pop(name, "")
            if hint and _taken(logs[worst], fit.without[worst], fit.noise) > TAKEN:
                raise DataError(f"{stands_out}; {hint}")
            # Another robot's log is explained by a fit of its own; what a motion excites is not: no base model has it.
            own = _share(fit.alone, fit.torque)[worst]
            if held[worst] > FOREIGN_SHARE and held[worst] ** 2 - own**2 > FOREIGN_TOGETHER * held[worst] ** 2:
                raise DataError(f"{stands_out}; a fit of its own leaves {part_of(own)} it: is it of another robot?")
            warnings.append(
                f"{stands_out}; does this motion excite an unmodelled effect? `deltatwin diagnose` shows more"
            )
    if share.max() > HOPELESS:
        worst = int(np.argmax(share))
        raise DataError(
            f"{logs[worst].name}: the model leaves {part_of(share[worst])} the torque unexplained; "
            "are the robot description, the units and the joints right?"
        )
    warnings += [f"{name}: {hint} Identify on motion without payload" for name, hint in hints.items()]
    return warnings + _sameness(logs)


def _share(residual: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return np.sqrt((residual**2).sum(axis=1) / np.maximum((torque**2).sum(axis=1), 1e-12))


def _loads(logs: Sequence[NormalEquations], fit: Plain, moving_mass: float) -> dict[str, str]:
    """Logs whose torque asks for more or less on the platform than the others', by name."""
    masses = [_masses(t, values, fit.noise, moving_mass) for t, values in zip(logs, fit.without, strict=True)]
    middle = float(np.median([np.median(mass) for mass, _ in masses]))
    mean = np.array([np.average(mass - middle, weights=sure) for mass, sure in masses])
    rms = np.array([np.sqrt(np.average((mass - middle) ** 2, weights=sure)) for mass, sure in masses])
    loaded = (
        (np.abs(mean) > PAYLOAD) & (np.abs(mean) > FOREIGN * np.median(np.abs(mean))) & (np.abs(mean) > STEADY * rms)
    )
    return {
        log.name: f"its torque fits {mean[t]:+.2f} kg on the platform compared with the other logs: a payload?"
        for t, log in enumerate(logs)
        if loaded[t]
    }


def _taken(log: NormalEquations, values: np.ndarray, noise: np.ndarray) -> float:
    """Share of the square of what `values` leave of a log that a payload would take, another in each block."""
    weight = _weight(noise)
    remains = np.stack([target(joint) - selection(joint) @ values for joint in range(3)])
    load = np.zeros(COLUMNS)
    load[PLATFORM_COLUMN] = 1.0  # by its weight and its inertia, which are as much apart as the platform's own
    square = np.einsum("j,ja,bjac,jc->", weight, remains, log.gram, remains, optimize=True)
    along = np.einsum("j,a,bjac,jc->b", weight, load, log.gram, remains, optimize=True)
    own = np.einsum("j,a,bjac,c->b", weight, load, log.gram, load, optimize=True)
    return float((along[own > 0] ** 2 / own[own > 0]).sum() / square)


def _weight(noise: np.ndarray) -> np.ndarray:
    """Of a joint's squared torque, (3,) (N m)^-2, for `noise` (3,) N m."""
    return 1.0 / np.maximum(noise, 1e-3 * noise.max() + 1e-9) ** 2


def _masses(
    log: NormalEquations, values: np.ndarray, noise: np.ndarray, moving_mass: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mass on the platform, kg, that each block of a log asks for by its weight, what it asks for by its inertia being
    free; and how sure each is, kg^-2."""
    weight = _weight(noise)
    remains = np.stack([target(joint) - selection(joint) @ values for joint in range(3)])
    chosen = np.zeros((COLUMNS, 2))
    chosen[WEIGHT_COLUMN] = 1.0, -1.0
    chosen[PLATFORM_COLUMN, 1] = 1.0 / moving_mass  # the platform's torque per kg less its weight: its acceleration
    left = np.einsum("j,ap,bjac,cq->bpq", weight, chosen, log.gram, chosen, optimize=True)
    right = np.einsum("j,ap,bjac,jc->bp", weight, chosen, log.gram, remains, optimize=True)
    used = left[:, 0, 0] > 0.2 * left[:, 0, 0].max()
    left, right = left[used], right[used]
    left[:, 1, 1] += 1e-3 * left[:, 0, 0]  # slow motion has no inertia to speak of
    mass = np.linalg.solve(left, right[..., None])[:, 0, 0]
    return mass, left[:, 0, 0] - left[:, 0, 1] ** 2 / left[:, 1, 1]


def _sameness(logs: Sequence[NormalEquations]) -> list[str]:
    if len(logs) == 1:
        return [f"{logs[0].name}: a single log cannot be held out: nothing shows how well the fit generalises"]
    left = information(np.stack([t.gram.sum(axis=0) for t in logs]))
    scale = np.sqrt(np.einsum("pp->p", left.sum(axis=0)))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = (left / scale[:, None] / scale).reshape(len(left), -1)
    unit = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    if (unit @ unit.T).min() > ALIKE:
        return ["the trajectories are too similar: held-out residuals only show how well this one motion repeats"]
    return []
