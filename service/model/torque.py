"""The forward prediction: the torque that a hypothesis expects along a recorded motion, and its slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.model.coulomb_viscous import mean_direction
from service.model.effects.base import on_joint
from service.model.effects.joint_elasticity import JointElasticity
from service.model.elastic import coupled
from service.model.hypothesis import Hypothesis, Term, inside_of
from service.model.scene import Scene
from service.model.signals import Band, delayed, lowpass

PART = 16  # columns that are filtered at a time: those of an arm at full rate are most of what a fit takes


def unreported(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
    """Torque (N, n) N m at the joints."""
    gears = [term for term in hypothesis.terms if swings(scene, term)]
    alone = [term for term in hypothesis.terms if not term.effect.measured and not swings(scene, term)]
    return scene.total + sum(added(scene, term) for term in alone) + together(scene, gears)


def swings(scene: Scene, term: Term) -> bool:
    """Whether an effect makes links swing that feel each other: those that all hang on one platform. Play
    does too, but less is left of its impacts where each joint is simulated by itself, in finer steps."""
    return isinstance(term.effect, JointElasticity) and scene.mechanism.closed


def together(scene: Scene, gears: Sequence[Term]) -> np.ndarray:
    """Torque (N, n) N m that effects add which make links swing."""
    return coupled(scene, inside_of(gears).two_masses) if gears else np.zeros((len(scene.time), scene.joints))


def added(scene: Scene, term: Term) -> np.ndarray:
    """Torque (N, n) N m that an effect adds at the joints."""
    return together(scene, [term]) if swings(scene, term) else _added(scene, term, [term.nonlinear])[..., 0]


def _added(scene: Scene, term: Term, points: Sequence[tuple[float, ...]]) -> np.ndarray:
    """The same (N, n, P) at P nonlinear parameters, by itself."""
    torque = np.zeros((len(scene.time), scene.joints, len(points)))
    for place, amplitude in zip(term.places, term.amplitude, strict=True):
        torque += term.effect.torques(scene, place, amplitude, points)
    return torque


def _own(
    scene: Scene, terms: Sequence[Term], moved: Sequence[Sequence[tuple[tuple[float, ...], float]]]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Torque (N, n) of the terms, and the change (N, n, P) of each at its points `moved`; of measured ones nothing."""
    gears = [term for term in terms if swings(scene, term)]
    torque, changes = together(scene, gears), []
    swinging = torque
    for term, points in zip(terms, moved, strict=True):
        if term.effect.measured:
            changes.append(np.zeros(0))
        elif swings(scene, term):
            others = [[replace(g, nonlinear=point) if g is term else g for g in gears] for point, _ in points]
            columns = [together(scene, other) - swinging for other in others]
            changes.append(np.stack(columns, axis=-1) if columns else np.zeros((*swinging.shape, 0)))
        else:
            torques = _added(scene, term, [term.nonlinear, *(point for point, _ in points)])
            torque = torque + torques[..., 0]
            changes.append(torques[..., 1:] - torques[..., :1])
    return torque, changes


def reported(scene: Scene, hypothesis: Hypothesis, torque: np.ndarray) -> np.ndarray:
    """What measured effects make of a joint torque (N, n, ...); linear in it."""
    for term in hypothesis.terms:
        if term.effect.measured:
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                torque = term.effect.report(scene, place, torque, amplitude, term.nonlinear)
    return torque


def predict(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
    """Reported torque (N, n) N m that the hypothesis expects."""
    torque = _in_time(scene, hypothesis)
    if hypothesis.base.band_hz < 0.5 / scene.period:
        return lowpass(torque, scene.period, hypothesis.base.band_hz)
    return torque


def expected(scene: Scene, hypothesis: Hypothesis, band: Band) -> np.ndarray:
    """Prediction (M, n) in the band, as `tangent` has it."""
    return _narrowed(band, hypothesis)(_in_time(scene, hypothesis))


def _in_time(scene: Scene, hypothesis: Hypothesis) -> np.ndarray:
    """Reported torque (N, n) N m at the samples of the position, at all frequencies."""
    return delayed(reported(scene, hypothesis, unreported(scene, hypothesis)), hypothesis.base.timing, scene.period)


def _narrowed(band: Band, hypothesis: Hypothesis) -> Band:
    """The band as far as the torque follows the motion as modelled."""
    return replace(band, cutoff_hz=min(band.cutoff_hz, hypothesis.base.band_hz))


def tangent(scene: Scene, hypothesis: Hypothesis, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Prediction (M, n) and its derivative (M, n, F) by every free parameter of `Parameters`, in the band."""
    prediction, *slopes = tangent_in_parts(scene, hypothesis, band)
    return prediction, np.concatenate(slopes, axis=-1)


def tangent_in_parts(scene: Scene, hypothesis: Hypothesis, band: Band) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same with the derivatives in two parts, side by side: the first is kept with the recording, and large."""
    n = scene.joints
    moved = [_moved(term) for term in hypothesis.terms]
    own, changes = _own(scene, hypothesis.terms, moved)
    torque = scene.total + own
    base, rows = hypothesis.base, scene.mechanism.rows
    wider = mean_direction(scene.sliding, 1.05 * base.transition) - scene.friction_direction
    widening = base.coulomb * wider / (0.05 * base.transition)
    at_joint = [scene.friction_direction[:, None] * rows.T]
    each = np.ndim(base.transition) > 0
    at_joint.append(widening[:, None] * rows.T if each else scene.at_joints(widening)[..., None])
    if hypothesis.fits_timing:
        at_joint.append(-np.gradient(torque, scene.period, axis=0)[..., None])
    raw: dict[int, np.ndarray] = {}
    count = sum(part.shape[-1] for part in at_joint)
    for term, change, points in zip(hypothesis.terms, changes, moved, strict=True):
        if term.effect.amplitudes:
            for place, amplitude in zip(term.places, term.amplitude, strict=True):
                if term.effect.measured:
                    columns = on_joint(torque[:, [place]], place, n)
                elif term.effect.own_joint:
                    columns = on_joint(term.effect.regressors(scene, place, term.nonlinear), place, n)
                else:
                    columns = term.effect.slopes(scene, place, amplitude, term.nonlinear)
                at_joint.append(columns)
                count += columns.shape[-1]
        for number, (point, size) in enumerate(points):
            if term.effect.measured:
                other = replace(term, nonlinear=point)
                terms = tuple(other if t is term else t for t in hypothesis.terms)
                altered = reported(scene, replace(hypothesis, terms=terms), torque)
                raw[count] = (altered - reported(scene, hypothesis, torque)) / size
                at_joint.append(np.zeros((len(torque), n, 1)))
            else:
                at_joint.append((change[..., number] / size)[..., None])
            count += 1
    columns = reported(scene, hypothesis, np.concatenate([torque[..., None], *at_joint], axis=-1))
    columns[..., 0] = delayed(columns[..., 0], hypothesis.base.timing, scene.period)  # slopes can do without
    for index, values in raw.items():
        columns[..., index + 1] = values
    band = _narrowed(band, hypothesis)
    columns = band(columns)
    return columns[..., 0], _of_motion(scene, hypothesis, band), columns[..., 1:]


def _of_motion(scene: Scene, hypothesis: Hypothesis, band: Band) -> np.ndarray:
    """(M, n, k + F) in the band: slopes by the rigid coefficients that a fit moves and by viscous friction, which no
    parameter alters but those of what lies between torque and report. The last ones are kept with the recording."""
    measured = [term for term in hypothesis.terms if term.effect.measured]
    wanted = hypothesis.base.wanted
    places = [(term.effect, term.joints, term.amplitude.tobytes(), term.nonlinear) for term in measured]
    key = (band, None if wanted is None else wanted.tobytes(), *places)
    kept = scene.recording.in_band
    if (found := kept.get(key)) is None:
        kept.clear()  # before the next are made: they are large
        rigid = scene.recording.rigid.columns
        columns = [rigid if wanted is None else rigid[..., wanted], scene.sliding[:, None] * scene.mechanism.rows.T]
        parts = [part for one in columns for part in np.split(one, range(PART, one.shape[-1], PART), axis=-1)]
        found = kept[key] = np.concatenate([band(reported(scene, hypothesis, part)) for part in parts], axis=-1)
    return found


def _moved(term: Term) -> list[tuple[tuple[float, ...], float]]:
    """Nonlinear parameters with one of those that are searched a little larger, or smaller at its upper limit; by how
    much."""
    result = []
    for index, (name, limits) in enumerate(term.effect.nonlinear.items()):
        value = term.nonlinear[index]
        size = min(1e-2 * max(abs(value), 1e-3 * (limits.high - limits.low)), limits.most_step)
        if value + size > limits.high:
            size = -size
        if term.searched[name]:
            result.append((tuple(v + size if i == index else v for i, v in enumerate(term.nonlinear)), size))
    return result
